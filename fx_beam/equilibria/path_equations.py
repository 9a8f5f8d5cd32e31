"""The equations of an equilibrium path, on which the load factor is one more unknown.

With the residual R of the unknowns y at the load factor l, a tangent (y', l') of the path solves

    dR/dy y' + dR/dl l' = 0,    and bordered by a row n:   n . (y', l') = 1.

Bordered by the tangent itself, the determinant changes its sign at a bifurcation, but not at a
limit point, nor at a corner: where a point begins to flow, dR/dy changes by a matrix of rank one
along the normal of its yield surface, and this leaves the tangent's component across that surface.

At a limit point the tangent K is singular. But K + b e e^T is not, where the unit vector e is that
of the unknown that moves most along the path. With its factors

    [K + b e e^T  c  -b e] [x]   [f]
    [n^T          d    0 ] [l] = [g]
    [e^T          0   -1 ] [w]   [0]

gives the solution x, l of the bordered system, and its determinant with the opposite sign.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import Interval
from fx_beam.results.state import ARRAYS, NUMBERS, State
from fx_beam.scene.beam import lagrange
from fx_beam.step.equations import Balance
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.sparse_lu import LU, Pattern
from fx_beam.step.step_failures import StepFailed


class BorderedLU:
    """Factors of bordered matrices of one pattern; `unit` (free,) are the sizes of unit unknowns.

    The pattern may have more rows, behind those of the unknowns: they are zero on the right side.
    With auxiliary unknowns, `dependent` is that of `Reduction`.
    """

    def __init__(self, pattern: Pattern, unit: np.ndarray, dependent: np.ndarray | None = None):
        indptr, indices = pattern
        n, self._free, self._unit = len(indptr) - 1, len(unit), unit
        self._matrix = csr_matrix((np.zeros(len(indices)), indices, indptr), (n, n))
        rows = np.repeat(np.arange(n), np.diff(indptr))
        #: Places of the diagonal of the unknowns.
        self._diagonal = np.flatnonzero((rows == indices) & (rows < len(unit)))
        if self._free:
            self._lu = LU(pattern, dependent)
        #: Sign of the determinant.
        self.sign = 0.0

    @property
    def values(self) -> np.ndarray:
        """Values of the last matrix, without its bordering row."""
        return self._matrix.data

    def factorise(
        self, values: np.ndarray, column: np.ndarray, row: np.ndarray, corner: float
    ) -> None:
        """Factorise a matrix bordered by a column and a row (free,), and their corner."""
        self._corner, self._regular = corner, True
        if not self._free:
            self.sign = float(np.sign(corner))
            return
        self._matrix.data = values
        diagonal, n = values[self._diagonal], self._matrix.shape[0]
        self._most = most = int(np.argmax(abs(row * self._unit)))
        # The amount of this unknown is one of two numbers in a small system; its pivots are alike.
        self._size = unit = self._unit[most]
        largest = abs(diagonal * self._unit**2).max() / unit**2
        # A negative one changes its sign: with its size alone it would vanish.
        added = max(diagonal[most], -2 * diagonal[most]) or largest or 1.0
        changed = values.copy()
        changed[self._diagonal[most]] += added
        self._regular = self._lu.factorise(changed)
        if not self._regular:
            self.sign = 0.0
            return
        self._column, self._row, one = np.zeros((3, n))
        self._column[: self._free], self._row[: self._free], one[most] = column, row, -added * unit
        self._forced = np.array([self._lu.solve(self._column), self._lu.solve(one)])
        rows = np.array([self._forced @ self._row, self._forced[:, most] / unit])
        self._small = np.diag([corner, -1.0]) - rows
        negative = self._lu.negative_pivots() % 2
        self.sign = float(np.sign(np.linalg.det(self._small))) * (1 if negative else -1)

    def negative_eigenvalues(self) -> int | None:
        """Their number, for the last matrix without its bordering row; None if it is singular.

        The matrix must be symmetric. An eigenvalue of K + b e e^T that K has below zero: det K is
        det(K + b e e^T) (1 - e . (K + b e e^T)^-1 b e).
        """
        if not self._free:
            return 0
        if not self._regular:
            return None
        return self._lu.negative_pivots() + int(self._small[1, 1] > 0)

    def solve(self, b: np.ndarray) -> tuple[np.ndarray, float]:
        """Solution (free,) and that of the bordering row, for a right side (free + 1,).

        Not finite if the bordered matrix is singular.
        """
        if not self._free:
            return b[:-1], b[-1] / self._corner
        if not self._regular:
            return np.full(self._free, np.nan), np.nan
        right = np.zeros_like(self._column)
        right[: self._free] = b[:-1]
        x, load = self._once(right, b[-1])
        # Again, for the rounding errors of an elimination without exchange of rows.
        rest = right - self._matrix @ x - load * self._column
        more, load_more = self._once(rest, b[-1] - self._row @ x - self._corner * load)
        return (x + more)[: self._free], load + load_more

    def _once(self, right: np.ndarray, last: float) -> tuple[np.ndarray, float]:
        x = self._lu.solve(right)
        given = np.array([last - self._row @ x, -x[self._most] / self._size])
        try:
            parts = np.linalg.solve(self._small, given)
        except np.linalg.LinAlgError:
            # At a bifurcation of a straight path the equations have solutions; the shortest one.
            parts = np.linalg.lstsq(self._small, given, rcond=None)[0]
            if not np.allclose(self._small @ parts, given, rtol=1e-12, atol=0.0):
                parts = np.full(2, np.nan)
        return x - parts @ self._forced, float(parts[0])


# Change of the load factor by which derivatives are found as differences.
_APART = 1e-5
# Largest part of an increment beside the two tangents of a corner.
_BESIDE = 0.1


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
    """The equations of a step in terms of the unknowns and the load factor.

    The inner product of increments is that of load factors plus the mean over the nodes, in units.
    """

    def __init__(self, loop: LoadLoop):
        self._loop, self._forcing, self.model = loop, loop.forcing, loop.model
        self._reduction = self.model.reduction
        #: Forces (free,) that hold the start besides its loads, and fade as those of now rise.
        self.held = np.zeros(self._reduction.free)
        #: Weights of the degrees of freedom in the inner product.
        self.weight = 1 / (self.model.unit**2 * len(self.model.turns))
        #: Whether unknowns follow others: what is eliminated with them fills the tangent.
        self._fills = bool(self.model.couplings.closures or self.model.couplings.sliding)

    @cached_property
    def bordered(self) -> BorderedLU:
        """The factors of the last tangent."""
        return self._bordered(*self._reduction.tangent.pattern)

    def _bordered(self, indptr: np.ndarray, indices: np.ndarray) -> BorderedLU:
        reduction = self._reduction
        unit = self.model.unit_of_unknowns[reduction.independent]
        given = None if self._fills else reduction.dependent
        return BorderedLU((indptr, indices), unit, given)

    def begin(self, start: State) -> None:
        """Set the state at the start of a step. No time passes for internal variables."""
        self._start = start
        self._loop.equations.begin(Interval(start.t, start.t), start)

    def expand(self, y: np.ndarray, load: float) -> np.ndarray:
        """Increment of all degrees of freedom."""
        return self._reduction.increment(y, self._driven(load))

    def _driven(self, load: float) -> np.ndarray:
        return self._forcing.positions(self._start.t + load) - self._forcing.current(self._start)

    def spread(self, dy: np.ndarray, dload: float) -> np.ndarray:
        """Small change of all degrees of freedom."""
        reduction = self._reduction
        return reduction.to_nodes(reduction.in_columns(dy, dload * self._forcing.goal))

    def balance(self, y: np.ndarray, load: float) -> tuple[Balance, np.ndarray, np.ndarray]:
        """The equations, and their derivative with respect to the load factor: full and reduced."""
        model, forcing, reduction = self.model, self._forcing, self._reduction
        if model.forms.has_added or model.natural or (model.scene.joints and forcing.goal.any()):
            # Driven motion rotates the joints, and with them the directions of their forces.
            per_load, column = self._differences(y, load, _APART)
            balance = self._evaluate(y, load)
        else:
            balance = self._evaluate(y, load)
            moved = self.spread(np.zeros_like(y), 1.0)
            per_load = self._loop.equations.change(moved) - forcing.rise
            if forcing.turning is not None:
                per_load -= forcing.turning.force(self._start.q + balance.D)
            column = reduction.reduced_force(per_load)
            column -= reduction.reduced_force(np.zeros_like(per_load))
        balance.residual[: len(y)] -= (1 - self._start.t - load) * self.held
        return balance, per_load, column[: reduction.free] + self.held

    def _differences(self, y: np.ndarray, load: float, apart: float) -> list[np.ndarray]:
        """The derivative by the load factor, from values so far apart."""
        given = self.model.points.given.copy()
        ends = [self._at(y.copy(), load + side) for side in (apart, -apart)]
        self.model.points.given[:] = given  # laws remember iterations, not what is beside them
        return [np.subtract(*of) / (2 * apart) for of in zip(*ends, strict=True)]

    def disturbance(self, apart: float) -> np.ndarray:
        """Change (free,) of forces in the start with the load factor, from others so far apart."""
        y = np.zeros(self._reduction.free)
        return self._differences(y, 0.0, apart)[1][: len(y)] + self.held

    def _evaluate(self, y: np.ndarray, load: float) -> Balance:
        at = self._start.t + load
        self._loop.equations.end_at(at)
        return self._loop.equations.at(y, self._driven(load), self._forcing.dead(at))

    def _at(self, y: np.ndarray, load: float) -> tuple[np.ndarray, np.ndarray]:
        balance = self._evaluate(y, load)
        return balance.r.copy(), balance.residual.copy()

    def solve(
        self, column: np.ndarray, normal: Tangent, residual: np.ndarray, last: float
    ) -> tuple[np.ndarray, float]:
        """Small changes of unknowns and load for right sides, by the last balance and a plane."""
        reduction, free = self._reduction, self._reduction.free
        independent, moved = reduction.independent, slice(free, free + reduction.driven)
        if self._fills or self.model.points.members is not None:  # its sparsity may have changed
            A = self._loop.equations.tangent() if self._fills else self._loop.equations.system()
            self.bordered, values = self._bordered(A.indptr, A.indices), A.data
        else:
            values = self._loop.equations.values
        across = reduction.coupling().T @ (self.weight * normal.D)
        corner = normal.load + across[moved] @ self._forcing.goal
        self.bordered.factorise(values, column[independent], across[independent], corner)
        dy, dload = self.bordered.solve(np.append(residual[independent], last))
        w = np.zeros(reduction.columns)
        w[independent], w[moved] = dy, dload * self._forcing.goal
        return reduction.with_dependent(w)[:free], dload

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

    def length(self, D: np.ndarray, load: float) -> float:
        """Length of an increment."""
        return float(np.sqrt(D @ (self.weight * D) + load**2))

    def legs(self, D: np.ndarray, load: float, *tangents: Tangent) -> np.ndarray | None:
        """Lengths (2,) along two tangents of which an increment consists; None if it does not.

        Only paths of scenes in which forces may have kinks have such corners.
        """
        if not self.model.nonsmooth:
            return None
        # Imported here: most paths have no corner, and the import takes time.
        from scipy.optimize import nnls

        root = np.append(np.sqrt(self.weight), 1.0)
        both = np.column_stack([root * np.append(t.D, t.load) for t in tangents])
        step = root * np.append(D, load)
        legs, _ = nnls(both, step)
        beside = step - both @ legs
        # Displacements alone as well: those of stiff scenes are small beside the load factor.
        fit = [np.linalg.norm(beside[:n]) <= _BESIDE * np.linalg.norm(step[:n]) for n in (-1, None)]
        return legs if all(fit) else None


# States between others, by polynomials in the distance along the path.


def between(states: list[State], points: np.ndarray, place: float) -> State:
    """The state at a place by the polynomials through others at points."""
    (weights,), values = lagrange(points, np.array([place])), dict[str, object]()
    for name in (*ARRAYS, *NUMBERS, "motors"):
        parts = [getattr(state, name) for state in states]
        if parts[0] is not None:
            values[name] = sum(w * part for w, part in zip(weights, parts, strict=True))
    values["t"] = float(values["t"])  # type: ignore[arg-type]
    return replace(states[0], **values, unstable_modes=None, negative_pivots=None)  # type: ignore[arg-type]
