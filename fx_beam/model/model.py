"""A scene and a scheme as compiled forms, constant matrices and lists of unknowns."""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse

from fx_beam.coupling.graph import couple, motors
from fx_beam.coupling.index_reduction import IndexReduction, Reduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.mechanism_check import check_no_massless_mechanism
from fx_beam.coupling.spring_dampers import Actuators
from fx_beam.fem.dead_loads import Loads
from fx_beam.fem.forms import Forms
from fx_beam.fem.mass import Mass
from fx_beam.fem.mesh import build_mesh
from fx_beam.mechanics.schemes import Scheme
from fx_beam.scene.scene import Scene


class Model:
    """Everything of a scene that stays the same from step to step.

    Nothing is compiled or assembled that the scene does not have. Vectors run over all degrees of
    freedom; `mesh.dofs` finds those of a node. `mobile`: parts with mass may move freely at rest.
    """

    def __init__(self, scene: Scene, scheme: Scheme, mobile: bool = False):
        self.scene = scene
        self.scheme = scheme
        self.mesh = build_mesh(scene)
        self.forms = Forms(scene, scheme, self.mesh)
        self.size, self.turns = self.forms.size, self.forms.turns
        #: Size of a unit increment: the size of the scene for displacements, 1 for rotations.
        self.unit = np.full(self.size, self.mesh.size)
        self.unit[self.turns] = 1.0
        self._mass = Mass(scene, self.mesh, self.forms)
        #: Names of the compiled forms and of the assembled matrices and vectors.
        self.compiled, self.assembled = self.forms.names, self._mass.assembled
        self.loads = Loads(scene, self.mesh, self.forms)
        self.assembled += [str(load) for load in scene.loads]
        #: Weight (size,) of every mass [N], or none.
        self.weight = self._mass.weight
        self._build_reduction()
        if not scene.virtual_works:
            mass = None if scheme.rates.at_rest and not mobile else self.mass
            check_no_massless_mechanism(scene, self.mesh, self.forms.stiffness, mass)

    @property
    def mass(self) -> scipy.sparse.csr_matrix:
        """The constant mass matrix, assembled when it is first asked for."""
        return self._mass.matrix

    @functools.cached_property
    def massless(self) -> np.ndarray:
        """Whether each degree of freedom (size,) is without mass."""
        return self.mass.diagonal() == 0

    @functools.cached_property
    def unit_of_unknowns(self) -> np.ndarray:
        """Size of a unit increment of each unknown (free,), as `unit` is for the nodes."""
        unit = np.full(self.couplings.columns, self.mesh.size)
        turning = [entry[0] for dof in self.turns for entry in self.couplings.entries[dof]]
        unit[turning] = 1.0
        return unit[: self.couplings.free]

    def _build_reduction(self) -> None:
        """Unknowns: what supports and joints leave."""
        scene, dofs, matrix = self.scene, self.mesh.dofs, self.forms.stiffness
        self.couplings = couple(scene, self.mesh)
        #: Joints with a motor, and on which coordinate.
        self.motors = motors(scene)
        self.prescribed = np.array([dofs[key] for key in scene.prescribed], dtype=int)
        counts = self.couplings.free, self.couplings.driven, self.couplings.columns
        keys = [*scene.prescribed, *sorted(scene.fixed)]
        motors_between = np.arange(len(keys)) >= len(scene.prescribed)
        #: Supported nodes, components, and places among the driven and fixed columns.
        self.supports = (
            np.array([node for node, _ in keys], dtype=int),
            np.array([component for _, component in keys], dtype=int),
            np.arange(len(keys)) + motors_between * len(self.motors),
        )
        self.actuators = Actuators(scene.joints, self.couplings, self.scheme.rates, dofs)
        self.reduction: Reduction
        if self.couplings.is_index and not self.actuators:
            column = np.array([own[0][0] for own in self.couplings.entries])
            self.reduction = IndexReduction(column, *counts, matrix)
        else:
            self.reduction = JointReduction(
                self.couplings, self.actuators, self.scheme.rates, dofs, matrix
            )
            self.assembled.append("joints")

    # -- Numbering ------------------------------------------------------------------------------

    def to_nodes(self, vector: np.ndarray) -> np.ndarray:
        """Values (n_node, 3) of a vector (size,) at the nodes."""
        return self.mesh.to_nodes(vector)

    def from_nodes(self, values: np.ndarray) -> np.ndarray:
        """Vector (size,) of values (n_node, 3) at the nodes."""
        return self.mesh.from_nodes(values)
