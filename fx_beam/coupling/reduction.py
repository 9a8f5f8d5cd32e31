"""From all degrees of freedom to the unknowns: supports, and joints without multipliers.

The nodal vector x is a function g of the columns z, unknowns first, with T = dg/dz. Virtual
displacements are dx = Tv dz. Newton's method solves Tv^T r(g(z)) = 0; the
tangent is Tv^T K T + (dTv/dz)^T r.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.fem.compiled_points import CompiledPoints
from fx_beam.laws.rates import UpdateRule

from .graph import Auxiliaries, Couplings
from .joint_maps import JointMaps
from .joints_in_c import JointsInC
from .reduced_tangent import ReducedTangent, reduced_tangent

if TYPE_CHECKING:
    from .loops import Loops
    from .sliders import Sliders


class Reduction:
    """Unknowns of a scene, and the reduction of vectors and matrices to them.

    `matrix` has the sparsity of the full tangent; entries that are not `used()` remain zero. In the
    linear system an auxiliary unknown is two unknowns, its displacement u and the force on what it
    follows, and a closure of a loop is one, its force.
    """

    #: Why no step can begin here; empty if it can.
    singularity = ""
    # The reduction of the program, which has the tables of the tangent for its runs.
    _pattern: Reduction | None = None

    def __init__(
        self,
        *,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        compiled_points: CompiledPoints,
        rates: UpdateRule,
        matrix: scipy.sparse.csr_matrix,
        used: Callable[[], np.ndarray],
        sliders: Sliders | None = None,
        loops: Loops | None = None,
    ):
        #: Nodes that slide on beams, where there are some or loops; else nothing asks for them.
        self.sliders: Any = sliders
        self.loops, self.couplings, self.auxiliaries = loops, couplings, auxiliaries
        #: Number of unknowns, of driven columns (prescribed, motors), and of all columns.
        self.free, self.driven = couplings.free, couplings.driven
        self.columns = couplings.columns
        #: For each force that closes a loop an unknown on which it acts. In C the forces are
        #: unknowns, too, behind all others.
        self.forces = np.empty(0, dtype=int) if loops is None else loops.acts_on
        self._compiled_points, self._matrix, self._used = compiled_points, matrix, used
        #: The joints in C.
        self.joints = JointsInC(couplings, auxiliaries, sliders, loops, rates, matrix.shape[0])
        #: Small changes at the last configuration.
        self.maps = JointMaps(self.joints, compiled_points)

    def in_block(self, block: Any, compiled_points: CompiledPoints) -> Reduction:
        """The reduction of a run, whose joints are in its block."""
        if self.couplings.is_selection and compiled_points is self._compiled_points:
            return self  # nothing of it changes
        other = shallow_copy(self)
        other._pattern, other._compiled_points, other.singularity = self, compiled_points, ""
        other.joints = self.joints.in_block(block)
        other.maps = self.maps.on(other.joints, compiled_points)
        return other

    @property
    def tangent(self) -> ReducedTangent:
        """How the reduced tangent is made of the full one."""
        return self._tangent if self._pattern is None else self._pattern.tangent

    @cached_property
    def _tangent(self) -> ReducedTangent:
        return reduced_tangent(
            *(self.couplings, self.auxiliaries, self.sliders, self.loops),
            *(self._compiled_points.points.columns, self._matrix, self._used()),
        )

    def forget_tangent(self) -> None:
        """Free the tables of the tangent of a large scene, which are found again if asked for."""
        self.__dict__.pop("_tangent", None)

    # -- A step -----------------------------------------------------------------------------------

    def set_start(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step, q and slides, and choose the unknowns that close loops."""
        if self.couplings.is_selection:
            return
        regular = self.joints.configuration.set_start(q, slides)
        self.singularity = "" if regular or self.loops is None else self.loops.singularity
        self.closures_at(np.zeros(self.free), np.zeros(self.driven))

    def in_columns(self, y: np.ndarray, driven: Any = ()) -> np.ndarray:
        """Increments (columns,) from y of the unknowns and from driven columns; else zero."""
        fixed = np.zeros(self.columns - self.free - len(driven))
        return np.concatenate([y, driven, fixed])

    def increment(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Increment (size,) of all degrees of freedom by unknowns y and driven columns: g.

        From now on T and Tv belong to this configuration. Unknowns that close loops are corrected
        in y; the increment is not finite if no correction closes them.
        """
        if self.couplings.is_selection:
            return self.in_columns(y, driven)[self.couplings.column]
        self.maps.forget()
        configuration = self.joints.configuration
        closed = configuration.expand(y, driven, True)
        self._compiled_points.evaluate_slides(configuration.z[: self.columns])
        return configuration.D.copy() if closed else np.full(self.joints.size, np.nan)

    def closures_at(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Closures (closures,) at increments of unknowns that need not close the loops [m]."""
        self.maps.forget()
        self.joints.configuration.expand(y, driven, False)
        return self.joints.configuration.closure

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        return self.joints.independent

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        return self.joints.following

    def fault(self, arcs: Sequence[tuple[float, float]] | None = None) -> tuple[str, str] | None:
        """Kind and reason of a step in which a node leaves the beam on which it slides; or None.

        `arcs` are the arc lengths of all nodes at both ends, by default of the last step.
        """
        if not self.couplings.sliding:
            return None
        return self.sliders.fault(self.joints.configuration.arcs if arcs is None else arcs)

    def reach(self, slides: np.ndarray, z: np.ndarray) -> float:
        """How often columns z can be added to `slides` before a node slides off its element."""
        return self.sliders.reach(slides, z) if self.sliders else np.inf
