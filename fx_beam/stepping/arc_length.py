"""Arc-length continuation: equilibrium paths through limit points, with an unknown load factor.

Keller's pseudo-arclength method: the predictor is a step of length ds along the unit tangent
(D', l') of the path. The corrector stays in the plane normal to it,

    R(y, l) = 0,    <D', D> + l' (l - l0) = ds,    <A, B> = mean over the nodes of A.B in units.

The system bordered by this plane is regular at limit points. The angle between the tangents of two
successive steps is acute; this gives the direction of a tangent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam.errors import Failure, StepError
from fx_beam.mechanics.interval import Interval
from fx_beam.model.equations import Balance
from fx_beam.results.state import State

from .load_steps import LoadStepper
from .newton import ENERGY_FLOOR, StepFailed, StepSolution

# Target deviation of a step from its tangent, relative to its length, for few load steps; on a
# circle it is half the angle of the step. A step is rejected at the given multiple of the target.
_TARGET, _REJECTED = 0.1, 4.0
# Target number of corrections in a step.
_CORRECTIONS = 10
# Load factor at which a path is abandoned. Of 43 arches that snap through, three reached load
# factors between -1 and -1.5 before their full load.
_LOWEST = -10.0
# Tolerance for the position of a limit point, relative to the step. Its load factor is far more
# accurate, since it is an extremum.
_PLACE = 1e-5


@dataclass
class Tangent:
    """Unit tangent of the path: of the unknowns, of all degrees of freedom, of the load factor."""

    y: np.ndarray
    D: np.ndarray
    load: float


class ArcLength:
    """Follows the equilibrium path of a scene.

    Keller (1977), Numerical solution of bifurcation and nonlinear eigenvalue problems.
    """

    def __init__(self, stepper: LoadStepper):
        self.stepper, self.model = stepper, stepper.model
        self._newton, self._forcing = stepper.single.newton, stepper.forcing
        self._equations = stepper.single.equations
        self._reduction = self.model.reduction
        #: Weights of the degrees of freedom in the inner product.
        self._weight = 1 / (self.model.unit**2 * len(self.model.turns))
        #: Rows and columns of the entries of the tangent and of the bordering column and row.
        self._places = self._bordered()
        rows, columns = (part.astype(np.int32) for part in self._places)
        #: The order of these entries by columns; then their rows, and where each column starts.
        self._order = order = np.lexsort((rows, columns))
        ends = np.arange(len(self._reduction.pattern[0]) + 1, dtype=np.int32)
        self._by_columns = rows[order], np.searchsorted(columns[order], ends).astype(np.int32)

    def follow(self, states: list[State], steps: int, max_cuts: int, max_steps: int) -> None:
        """Append the states on the path from the last one to load factor 1.

        `steps` limits the length and the turn of a step; a step is halved at most `max_cuts` times.
        """
        stats = self.stepper.stats
        # The error of the work is then of second order in the steps.
        target = min(_TARGET, 1 / steps)
        tangent = self._tangent(states[-1], None)
        ds, rising, cuts = 1 / (steps * tangent.load), 1.0, 0
        while states[-1].t < 1 and stats.steps < max_steps:
            try:
                state, ahead = self._step(states[-1], tangent, ds)
                corrections = self.stepper.iterations
                off = self._turn(states[-1], state, tangent, ahead, ds)
                if off > _REJECTED * target:
                    D = state.q - states[-1].q
                    raise StepFailed(
                        "off the path", "the path deviates too far from its tangent", D, []
                    )
                turns = ahead.load * rising < 0
                if turns:
                    state, ahead = self._limit_point(states[-1], tangent, ds, ahead)
                if state.t >= 1:
                    state = self._last_step(states[-1], tangent)
                elif turns:
                    rising = -rising
                    stats.limit_points.append(state.t)
            except StepFailed as failure:
                if cuts == max_cuts:
                    raise self._error(states[-1], failure, cuts) from failure
                ds, cuts = ds / 2, cuts + 1
                stats.halvings += 1
                continue
            states.append(state)
            stats.steps += 1
            if state.t < _LOWEST:
                raise self._lost(state)
            tangent, cuts = ahead, 0
            ratio = min(target / max(off, 1e-6), _CORRECTIONS / corrections)
            ds *= min(2.0, max(0.5, ratio))
            # The load factor changes at most as much as in a load step.
            ds = min(ds, 1 / (steps * max(abs(tangent.load), 1e-6)))

    # -- Steps ----------------------------------------------------------------------------------

    def _step(self, state: State, tangent: Tangent, ds: float) -> tuple[State, Tangent]:
        """State after an arc-length step ds along a tangent, and the tangent there."""
        step, load = self._correct(state, tangent, ds, tangent, ds)
        new = self._finish(state, state.t + load, step)
        return new, self._tangent(new, tangent)

    def _turn(self, old: State, new: State, tangent: Tangent, ahead: Tangent, ds: float) -> float:
        """Turn of the path in a step, estimated from the tangents at its start and end."""
        if self.stepper.is_still(D := new.q - old.q):
            return 0.0
        gap = self.stepper.size(D - ds / 2 * (tangent.D + ahead.D)) / self.stepper.size(D)
        return max(self.stepper.deviation, 2 * gap)

    def _limit_point(
        self, state: State, tangent: Tangent, ds: float, ahead: Tangent
    ) -> tuple[State, Tangent]:
        """Limit point in a step: its state and the tangent there."""
        if tangent.load * ahead.load > 0:
            raise StepFailed(
                "off the path", "the step contains two limit points", ds * tangent.D, []
            )
        slopes = {0.0: tangent.load, ds: ahead.load}
        found: dict[float, tuple[State, Tangent]] = {}

        def slope(length: float) -> float:
            if length not in slopes:
                found[length] = self._step(state, tangent, length)
                slopes[length] = found[length][1].load
            return slopes[length]

        # Imported here: most paths have no limit point, and the import takes time.
        from scipy.optimize import brentq

        root = brentq(slope, 0.0, ds, xtol=_PLACE * ds)
        return found.get(root) or self._step(state, tangent, root)

    def _last_step(self, state: State, tangent: Tangent) -> State:
        """State at load factor 1, from the last state before it."""
        missing = 1 - state.t
        level = Tangent(np.zeros_like(tangent.y), np.zeros_like(tangent.D), 1.0)
        step, _ = self._correct(state, tangent, missing / tangent.load, level, missing)
        return self._finish(state, 1.0, step)

    def _finish(self, state: State, t1: float, step: StepSolution) -> State:
        self.stepper.note(step)
        interval, forcing = Interval(state.t, t1), self._forcing
        forces, positions = forcing.forces(interval), forcing.positions(t1)
        return self.stepper.single.finish(state, interval, step, forces, positions)

    def _correct(
        self, state: State, tangent: Tangent, along: float, normal: Tangent, distance: float
    ) -> tuple[StepSolution, float]:
        """Corrector: increments to the point where the path meets <normal, increment> = distance.

        The predictor is a length `along` the tangent. StepFailed if it does not converge.
        """
        newton, free = self._newton, self._reduction.free
        self._equations.begin(Interval(state.t, state.t), state)
        y, load, predicted = along * tangent.y, along * tangent.load, along * tangent.D
        residuals: list[float] = []
        previous = np.inf
        for iteration in range(1, newton.options.max_iterations + 1):
            (D, f, r, residual), per_load, column = self._balance(state, y, load)
            residual = residual[:free]
            residuals.append(abs(residual).max(initial=0.0))
            missing = normal.D @ (self._weight * D) + normal.load * load - distance
            dy, dload = self._solve(r, column, normal, -np.append(residual, missing))
            correction = self._spread(dy, dload)
            factor = newton.shortening(correction)
            y, load = y + factor * dy, load + factor * dload
            size = max((abs(correction) / self.model.unit).max(), abs(dload))
            newton.check_finite(size, residuals)
            D = self._expand(state, y, load)
            newton.check_turn(D, residuals)
            work, energy = residual @ dy, abs(f) @ abs(D)
            stuck = size > 0.5 * previous and abs(work) <= ENERGY_FLOOR * energy
            if size <= newton.options.tolerance or stuck:
                r = r + self.model.forms.stiffness @ self._spread(dy, 0.0) + dload * per_load
                newton.check_slides(D, residuals)
                ended_by = "round-off" if stuck else "increment"
                return StepSolution(D, y, r, iteration, ended_by, predicted), load
            previous = size
        reason = f"no convergence in {newton.options.max_iterations} iterations"
        raise StepFailed("no convergence", reason, D, residuals)

    def _tangent(self, state: State, previous: Tangent | None) -> Tangent:
        """Unit tangent at a state, in the direction of the previous tangent or of rising load."""
        zero = np.zeros(self._reduction.free)
        normal = previous or Tangent(zero, np.zeros(self.model.size), 1.0)
        self._equations.begin(Interval(state.t, state.t), state)
        balance, _, column = self._balance(state, zero, 0.0)
        dy, dload = self._solve(balance.r, column, normal, np.append(zero, 1.0))
        D = self._spread(dy, dload)
        length = np.sqrt(D @ (self._weight * D) + dload**2)
        if not np.isfinite(length):
            raise StepFailed("singular", "the bordered tangent is singular", D, [])
        return Tangent(dy / length, D / length, dload / length)

    # -- Equations ------------------------------------------------------------------------------

    def _expand(self, state: State, y: np.ndarray, load: float) -> np.ndarray:
        """Increment of all degrees of freedom."""
        return self._reduction.expand(y, self._driven(state, load))

    def _driven(self, state: State, load: float) -> np.ndarray:
        return self._forcing.positions(state.t + load) - self._forcing.current(state)

    def _spread(self, dy: np.ndarray, dload: float) -> np.ndarray:
        """Small change of all degrees of freedom."""
        fixed = np.zeros(self._reduction.columns - self._reduction.free - self._reduction.driven)
        return self._reduction.spread(np.concatenate([dy, dload * self._forcing.goal, fixed]))

    def _balance(
        self, state: State, y: np.ndarray, load: float
    ) -> tuple[Balance, np.ndarray, np.ndarray]:
        """The equations, and their derivative with respect to the load factor: full and reduced."""
        forms, forcing, reduction = self.model.forms, self._forcing, self._reduction
        forms.load_factor.value = state.t + load
        force = (state.t + load) * forcing.full
        balance = self._equations.at(y, self._driven(state, load), force)
        per_load = forms.stiffness @ self._spread(np.zeros_like(y), 1.0) - forcing.full
        if forcing.turning is not None:
            per_load -= forcing.turning.force(state.q + balance.D)
        if forms.has_added:
            per_load -= forms.added_per_load()
        column = reduction.project(per_load) - reduction.project(np.zeros_like(per_load))
        if self.model.scene.joints and forcing.goal.any():
            # Driven motion rotates the joints, and with them the directions of their forces.
            h = 1e-6
            for sign in (1, -1):
                self._expand(state, y, load + sign * h)
                column += sign / (2 * h) * reduction.project(balance.r)
            self._expand(state, y, load)
        return balance, per_load, column[: reduction.free]

    def _bordered(self) -> tuple[np.ndarray, np.ndarray]:
        indptr, indices = self._reduction.pattern
        n = len(indptr) - 1
        each, last = np.arange(n), np.full(n, n)
        rows = np.repeat(each, np.diff(indptr)), each, last, [n]
        return np.concatenate(rows), np.concatenate([indices, last, each, [n]])

    def _solve(
        self, r: np.ndarray, column: np.ndarray, normal: Tangent, b: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Solution of the tangent system bordered by the load column and the plane's row."""
        reduction, free = self._reduction, self._reduction.free
        values = np.empty(len(reduction.pattern[1]))
        self._equations.fill_tangent(r, values)
        across = reduction.coupling().T @ (self._weight * normal.D)
        corner = normal.load + across[free : free + reduction.driven] @ self._forcing.goal
        # Scaled by the units of the scene: the pivots do not depend on the user's units.
        n, (at_row, at_column) = len(reduction.pattern[0]) - 1, self._places
        unit, zero = np.append(self.model.unit_of_unknowns, np.ones(n - free)), np.zeros(n - free)
        column, across_all = np.append(column, zero), np.append(across[:free], zero)
        values *= unit[at_row[: len(values)]] * unit[at_column[: len(values)]]
        size = abs(values).max(initial=0.0) or 1.0
        b = np.concatenate([unit[:free] * b[:free] / size, zero, b[free:]])
        entries = np.concatenate([values / size, unit * column / size, across_all * unit, [corner]])
        entries = entries[self._order], *self._by_columns
        bordered = scipy.sparse.csc_matrix(entries, (n + 1, n + 1))
        try:
            x = scipy.sparse.linalg.splu(bordered).solve(b)
        except RuntimeError:  # exactly singular
            x = np.full(n + 1, np.nan)
        return unit[:free] * x[:free], float(x[n])

    def _error(self, state: State, failure: StepFailed, cuts: int) -> StepError:
        return self.stepper.single.error(
            f"the step along the arc length from load factor {state.t:.6g} failed",
            cuts,
            state.t,
            failure,
            "Try more steps or more cuts (max_cuts). If this does not help, check the units of "
            "loads and stiffnesses",
        )

    def _lost(self, state: State) -> StepError:
        turned = ", ".join(f"{point:.6g}" for point in self.stepper.stats.limit_points)
        return StepError(
            Failure(
                "off the path",
                "static: the path does not return to load factor 1: after limit points at "
                f"{turned} it has reached {state.t:.6g}",
                state.t,
                advice="The path so far is in the error's `solution`. There may be equilibria at "
                "load factor 1 on other paths: try a simulation with dampers, or apply the loads "
                "in other proportions",
            )
        )
