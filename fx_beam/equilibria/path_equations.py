"""The equations of an equilibrium path, on which the load factor is one more unknown.

With the residual R of the unknowns y at the load factor l, a tangent (y', l') of the path solves

    dR/dy y' + dR/dl l' = 0,    and bordered by a row n:   n . (y', l') = 1.

Bordered by the tangent itself, the determinant changes its sign at a bifurcation, but not at a
limit point, nor at a corner: where a point begins to flow, dR/dy changes by a matrix of rank one
along the normal of its yield surface, and this leaves the tangent's component across that surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import Interval
from fx_beam.results.state import ARRAYS, NUMBERS, State
from fx_beam.scene.beam import lagrange
from fx_beam.step.equations import Residual
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.step_failures import StepFailed

from .bordered_lu import BorderedLU

# Change of the load factor by which derivatives are found as differences.
_APART = 1e-5


@dataclass
class Tangent:
    """Unit tangent of the path: of the unknowns, of all degrees of freedom, of the load factor."""

    y: np.ndarray
    D: np.ndarray
    load: float
    #: Sign of the determinant of the equations' derivative bordered by the tangent.
    sense: float = 1.0

    def __neg__(self) -> Tangent:
        return Tangent(-self.y, -self.D, -self.load, -self.sense)


class PathEquations:
    """The equations R(y, l) = 0 of a step in its unknowns y (free,) and the load factor l.

    The inner product of increments is that of load factors plus the mean over the nodes, in units.
    """

    def __init__(self, loop: LoadLoop):
        self.loop, self.model = loop, loop.model
        self._reduction = self.model.reduction
        #: Forces (free,) that hold the start besides its loads, and fade as those of now rise.
        self.held = np.zeros(self._reduction.free)
        #: Weights (size,) of the degrees of freedom in the inner product.
        self.weight = 1 / (self.model.units.nodes**2 * len(self.model.mesh.turns))
        #: Whether unknowns follow others: what is eliminated with them fills the tangent.
        self._fills = bool(self.model.couplings.closures)

    @cached_property
    def bordered(self) -> BorderedLU:
        """The factors of the last tangent."""
        return self._bordered(*self._reduction.tangent.pattern)

    def _bordered(self, indptr: np.ndarray, indices: np.ndarray) -> BorderedLU:
        reduction = self._reduction
        unit = self.model.units.unknowns[reduction.independent]
        return BorderedLU(
            (indptr, indices), unit, None if self._fills else reduction.auxiliaries.dependent
        )

    def set_start(self, start: State) -> None:
        """Set the state at the start of a step. No time passes for internal variables."""
        self._start = start
        self.loop.equations.set_start(Interval(start.t, start.t), start)

    def expand(self, y: np.ndarray, load: float) -> np.ndarray:
        """Increment D (size,) of all degrees of freedom by increments y and l."""
        return self._reduction.increment(y, self._driven(load))

    def _driven(self, load: float) -> np.ndarray:
        forcing = self.loop.forcing
        return forcing.positions(self._start.t + load) - forcing.current(self._start)

    def spread(self, dy: np.ndarray, dload: float) -> np.ndarray:
        """Small change dD (size,) of all degrees of freedom: T (dy, dl)."""
        reduction = self._reduction
        return reduction.maps.to_nodes(reduction.in_columns(dy, dload * self.loop.forcing.goal))

    def balance(self, y: np.ndarray, load: float) -> tuple[Residual, np.ndarray, np.ndarray]:
        """R(y, l), and the derivatives by l of forces (size,) at nodes, and (free,) of R."""
        model, forcing, reduction = self.model, self.loop.forcing, self._reduction
        if (
            model.forms.has_added
            or model.data.natural
            or (model.scene.joints and forcing.goal.any())
        ):
            # Driven motion rotates the joints, and with them the directions of their forces.
            load_slopes, column = self._differences(y, load, _APART)
            balance = self._evaluate(y, load)
        else:
            balance = self._evaluate(y, load)
            moved = self.spread(np.zeros_like(y), 1.0)
            load_slopes = self.loop.equations.change(moved) - forcing.rise
            if forcing.turning is not None:
                load_slopes -= forcing.turning.force(self._start.q + balance.D)
            column = reduction.maps.reduced_force(load_slopes)
            column -= reduction.maps.reduced_force(np.zeros_like(load_slopes))
        balance.residual[: len(y)] -= (1 - self._start.t - load) * self.held
        return balance, load_slopes, column[: reduction.free] + self.held

    def _differences(self, y: np.ndarray, load: float, apart: float) -> list[np.ndarray]:
        """Derivatives by l of forces (size,) and of the residual, from values at l +- apart."""
        numbers, ends = self.model.points.inputs.copy(), []
        for side in (apart, -apart):
            balance = self._evaluate(y.copy(), load + side)
            ends.append((balance.r.copy(), balance.residual.copy()))
        self.model.points.inputs[:] = numbers  # laws remember iterations, not what is beside them
        return [(ahead - back) / (2 * apart) for ahead, back in zip(*ends, strict=True)]

    def disturbance(self, apart: float) -> np.ndarray:
        """Derivative (free,) of R by l in the start, from values at l +- apart."""
        y = np.zeros(self._reduction.free)
        return self._differences(y, 0.0, apart)[1][: len(y)] + self.held

    def _evaluate(self, y: np.ndarray, load: float) -> Residual:
        factor = self._start.t + load
        self.loop.equations.end_at(factor)
        return self.loop.equations.evaluate(y, self._driven(load), self.loop.forcing.dead(factor))

    def solve(
        self, column: np.ndarray, normal: Tangent, residual: np.ndarray, last: float
    ) -> tuple[np.ndarray, float]:
        """Changes (dy, dl) with K dy + column dl = residual and <normal, (dy, dl)> = last.

        K is the tangent of the last balance.
        """
        reduction, free, equations = self._reduction, self._reduction.free, self.loop.equations
        independent, moved = reduction.independent, slice(free, free + reduction.driven)
        model, fills = self.model, self._fills
        if fills or model.couplings.sliding or model.points.members is not None:
            # Its sparsity may have changed.
            A = equations.tangent() if fills else equations.system()
            A = _with_diagonal(A, len(independent))
            A.sort_indices()
            self.bordered, values = self._bordered(A.indptr, A.indices), A.data
        else:
            values = equations.values
        goal, row = self.loop.forcing.goal, reduction.maps.coupling().T @ (self.weight * normal.D)
        corner = normal.load + row[moved] @ goal
        if not np.isfinite(values).all():  # against an infinite stiffness nothing moves
            nowhere = np.full(model.size, np.nan)
            raise StepFailed("singular", "a stiffness is not finite", nowhere)
        self.bordered.factorise(values, column[independent], row[independent], corner)
        dy, dload = self.bordered.solve(np.append(residual[independent], last))
        w = np.zeros(reduction.columns)
        w[independent], w[moved] = dy, dload * goal
        return reduction.maps.with_dependent(w)[:free], dload

    def tangent(self, y: np.ndarray, load: float, previous: Tangent) -> Tangent:
        """Unit tangent after increments, in the direction of a previous one."""
        _, _, column = self.balance(y, load)
        dy, dload = self.solve(column, previous, 0 * y, 1.0)
        D = self.spread(dy, dload)
        length = self.length(D, dload)
        if not np.isfinite(length):
            raise StepFailed("singular", "the bordered tangent is singular", D)
        return Tangent(dy / length, D / length, dload / length, self.bordered.sign)

    def with_the_load(self, y: np.ndarray, load: float) -> Tangent:
        """Unit tangent after increments, in the direction of rising load."""
        return self.tangent(y, load, Tangent(0 * y, np.zeros(self.model.size), 1.0))

    # -- Measures of increments -------------------------------------------------------------------

    def along(self, tangent: Tangent, D: np.ndarray, load: float) -> float:
        """Inner product of a tangent and an increment."""
        return float(tangent.D @ (self.weight * D)) + tangent.load * load

    def length(self, D: np.ndarray, load: float) -> float:
        """Length of an increment."""
        return float(np.sqrt(D @ (self.weight * D) + load**2))

    def size(self, D: np.ndarray) -> float:
        """Root mean square of an increment D (size,) over the nodes, in units of the scene."""
        scaled = D / self.model.units.nodes
        return math.sqrt(scaled @ scaled / len(self.model.mesh.turns))

    def is_still(self, D: np.ndarray) -> bool:
        """Whether an increment D (size,) is zero within the tolerance of Newton's method."""
        return self.size(D) <= self.loop.failures.options.tolerance


def between(states: list[State], points: np.ndarray, place: float) -> State:
    """The state at a place on the path, by polynomials through states at other points of it."""
    (weights,), values = lagrange(points, np.array([place])), dict[str, object]()
    for name in (*ARRAYS, *NUMBERS, "motors"):
        parts = [getattr(state, name) for state in states]
        if parts[0] is not None:
            values[name] = sum(w * part for w, part in zip(weights, parts, strict=True))
    values["t"] = float(values["t"])  # type: ignore[arg-type]
    return replace(states[0], **values, unstable_modes=None, negative_pivots=None)  # type: ignore[arg-type]


def _with_diagonal(A: scipy.sparse.csr_matrix, count: int) -> scipy.sparse.csr_matrix:
    """A matrix with places for the diagonal of its first rows, also where it is exactly zero."""
    entries, diagonal = A.tocoo(), np.arange(count)
    places = np.append(entries.row, diagonal), np.append(entries.col, diagonal)
    return scipy.sparse.csr_matrix((np.append(entries.data, np.zeros(count)), places), A.shape)
