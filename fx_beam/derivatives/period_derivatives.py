"""Derivatives of a periodic motion: its start and period follow from the equations of a period."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from fx_beam.dual import floats
from fx_beam.equilibria.statics import path_of
from fx_beam.errors import SceneError, is_whole, require
from fx_beam.motions.numbers import OF_STEPS
from fx_beam.orbits.closing import NO_SHIFT, ROUND_OFF, least_squares, turning_point
from fx_beam.orbits.periodic_family import without_trivial
from fx_beam.orbits.shooting import Period, Shooting
from fx_beam.orbits.variables import Directions, slope
from fx_beam.results.state import State
from fx_beam.results.vibrations import PeriodicMotion
from fx_beam.scene.scene import Scene

from .built_scenes import NumbersOf, refuse_others
from .energy_outputs import energy_blocks
from .gradient import jvp
from .parametrised import Parametrised
from .static_derivatives import StaticDerivatives
from .sub_steps import SubSteps

WHAT = "PeriodicResponse"
#: Relative change of the period for central differences,
# and of a state along a deviation.
CHANGE, _DEVIATION = 1e-5, 1e-4
# Singular values of the equations that are zero, relative to the largest.
_SINGULAR = 1e-9
# Multipliers that differ by less, relative to them, are equal.
_TWICE = 1e-6
# Changes of functions of time that differ by less after a period, relative to the largest, repeat.
_REPEATS = 1e-6
LATER = " a period later"
AT_START = "driven at the start"


class PeriodDerivatives:
    """Derivatives by the parameters x of the start of a periodic motion, and of its period.

    `numbers_of` gives the numbers of the steps for other scenes, with those of functions of time
    `LATER`, and what is driven `AT_START`; `scene_of` the scene of a frequency of the loads.
    """

    def __init__(
        self,
        parameters: Parametrised,
        motion: PeriodicMotion,
        shooting: Shooting,
        numbers_of: NumbersOf,
        scene_of: Callable[[float], Scene],
    ):
        self._parameters, self._motion, self._shooting = parameters, motion, shooting
        self._cycle, self._scene_of = motion.cycle, scene_of
        #: The motion; its parameter is its length here.
        self._period = self._cycle.period._replace(parameter=self._cycle.period.length)
        error = self.lay().error
        if error > max(10 * motion.error, ROUND_OFF):
            raise SceneError(
                f"{WHAT}: the motion does not repeat itself in the scene that build gives: the "
                f"states before and after the period are {error:.1e} of it apart. motion(scene) "
                "must find the motion of this scene"
            )
        #: Derivatives (m, ...) of all numbers; the unknowns of the start are held.
        self._held_changes = _held(parameters.derivatives(numbers_of), shooting.model.prescribed)
        refuse_others(self._held_changes, shooting.derivatives.names, WHAT)
        #: The same; only independent variables of the start are held.
        self._scene_changes = self._closed(self._held_changes, self._period.start)
        #: Directions (n) of the start, and derivatives (m, n) of the start along them by x.
        self._directions = shooting.variables.directions(self._period.start, self._period.length)
        self._start = np.zeros((len(parameters.x), self._directions.matrix.shape[1]))
        #: Derivatives (m,) of the logarithm of the period.
        self.period = np.zeros(len(parameters.x))
        self._solve()

    def _closed(self, changes: dict[str, np.ndarray], start: State) -> dict[str, np.ndarray]:
        """Changes (m, ...), and those of unknowns that close loops, in the start of the tape."""
        shooting = self._shooting
        if shooting.model.reduction.loops is None:
            return changes
        gaps = shooting.derivatives.closures_at_start(shooting.tape, changes)
        following = shooting.variables.closing(start, gaps)
        return changes | {name: changes.get(name, 0.0) + rows for name, rows in following.items()}

    @property
    def changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) of all numbers of the scene and of the start."""
        return _added(self._scene_changes, self._directions, self._start)

    def _solve(self) -> None:
        """Find derivatives of the start and of the period, from the equations of the motion."""
        shooting, period, cycle, basis = self._shooting, self._period, self._cycle, self._directions
        independent, n = basis.independent, basis.matrix.shape[1]
        unit = basis.matrix[independent]
        end_slopes, _ = shooting.slopes(basis.changes, period)
        #: The monodromy matrix in these directions.
        self._monodromy = np.linalg.solve(unit, end_slopes[independent])
        rows = [end_slopes[independent] - unit]
        right = [shooting.slopes(self._scene_changes, period)[0][independent]]
        if cycle.chosen_by == "fold":
            self.period = self._of_fold(rows[0], right[0])
            return
        parameter_slope = np.zeros((len(unit), 0))
        if cycle.free and cycle.chosen_by != "period":
            parameter_slope = shooting.parameter_slope(period)[independent, None]
        rows[0] = np.hstack([rows[0], parameter_slope])
        parameter_count = parameter_slope.shape[1]
        for slopes, side in self._conditions():
            rows.append(slopes[None, : n + parameter_count])
            right.append(side[None])
        matrix, sides = np.vstack(rows), np.vstack(right)
        sizes = np.linalg.svd(matrix, compute_uv=False)
        if cycle.free and sizes[n + parameter_count - 1] < _SINGULAR * sizes[0]:
            raise SceneError(
                f"{WHAT}: the motion is one of a family of the same scene, and nothing chooses "
                "it. Give periodic the energy or the amplitude"
            )
        solved = -least_squares(matrix, sides).T
        self.lay()
        self._start = solved[:, :n]
        if parameter_count:
            self.period = solved[:, n]

    def _conditions(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Conditions that choose the motion: derivatives by its start and period, and by x."""
        cycle, shooting, period, basis = self._cycle, self._shooting, self._period, self._directions
        if cycle.chosen_by not in ("", "period", "frequency", "energy", "amplitude"):
            raise SceneError(
                f"{WHAT}: this motion of a family has no derivatives. Find it by periodic, with "
                "an energy, an amplitude or a period"
            )
        nothing = np.zeros(len(self._parameters.x))
        conditions = list[tuple[np.ndarray, np.ndarray]]()
        if cycle.free:
            phase = NO_SHIFT
            if cycle.chosen_by in ("energy", "amplitude"):
                phase = turning_point(shooting, period)
            conditions.append((phase.slopes(period, basis), nothing))
        if cycle.chosen_by == "energy":
            slopes = np.append(shooting.variables.slope_of_energy(period.start, basis), 0.0)
            size = np.linalg.norm(slopes)
            conditions.append((slopes / size, self._energy_by_x() / size))
        elif cycle.chosen_by == "amplitude":
            unit = shooting.model.units.nodes[cycle.held]
            slopes = np.append(basis.changes["q"][:, cycle.held], 0.0)
            place = self._start_by_x()["q"][0, :, cycle.held]
            conditions.append((slopes / unit, (place - self._rest_by_x()) / unit))
        return conditions

    def _start_by_x(self) -> dict[str, np.ndarray]:
        """Derivatives (1, m, ...) of the start, of which the independent variables are held.

        Others follow them by joints, whose shape depends on x.
        """
        self.lay()
        none = np.zeros(1, dtype=int)
        return self._shooting.derivatives.jvp(self._shooting.tape, self._scene_changes, none)

    def _rest_by_x(self) -> np.ndarray:
        """Derivatives (m,) of what the amplitude is measured from."""
        cycle = self._cycle
        if cycle.state is None:
            return np.zeros(len(self._parameters.x))
        if (path := path_of(cycle.state, self._parameters.scene)) is None:
            raise SceneError(
                f"{WHAT}: an amplitude about a state has derivatives if motion(scene) computes "
                "this by static(scene). Or give the energy"
            )
        end = StaticDerivatives(path).change_of_end(self._parameters.derivatives, WHAT)
        return end.node_changes[:, cycle.held]

    def _energy_by_x(self) -> np.ndarray:
        """Derivatives (m,) of the energy of the start, of which the variables are held."""
        model, tape, none = self._shooting.model, self._shooting.tape, np.zeros(1, dtype=int)
        changes, at_start = self._scene_changes, self._start_by_x()
        steps = SubSteps(model, tape, none)
        blocks = energy_blocks(steps, "energy of steps", none, none)
        slopes = jvp(blocks, (1,), at_start, changes)[0]
        if model.data.loads.constant and model.data.loads.functions:
            loads, q = model.data.loads.unit_loads, self._period.start.q
            factors = floats(model.data.loads.series(np.zeros(1)))[0]
            columns = np.repeat(np.arange(loads.shape[1]), np.diff(loads.indptr))
            slopes = slopes - changes["columns"] @ (q[loads.indices] * factors[columns])
            factor_changes = changes["loads"].reshape(len(slopes), -1, loads.shape[1])[:, 0]
            slopes = slopes - factor_changes @ (loads.T @ q) - at_start["q"][0] @ (loads @ factors)
        return slopes

    def _of_fold(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Derivatives (m,) of the period: the left vector of S_y - 1 leaves the frequency alone."""
        period, frequency = self._period, self._cycle.period.parameter
        vector = np.linalg.svd(matrix)[0][:, -1]

        def gap(change: float) -> np.ndarray:
            other = Shooting(self._scene_of(frequency * (1 + change)), self._cycle.options)
            return other.run(period.start, period.length / (1 + change)).gap

        frequency_slope = slope(gap, CHANGE)[self._directions.independent]
        self.lay()
        return (vector @ right) / (vector @ frequency_slope)  # of the period, the inverse

    def multipliers(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """The n largest multipliers (n,), and their derivatives (n, m)."""
        known = without_trivial(self._motion.multipliers, self._cycle.trivial)
        known = known[known.imag >= 0]
        if not len(known):
            raise SceneError(f"{WHAT}.multipliers: all are 1, for shifts in time and the energy")
        ok = is_whole(n, 1, len(known))
        require(ok, f"{WHAT}.multipliers: n", n, f"a whole number from 1 to {len(known)}")
        values, left, right = scipy.linalg.eig(self._monodromy, left=True, right=True)
        derivatives = np.zeros((n, len(self._parameters.x)), dtype=complex)
        for i, value in enumerate(known[:n]):
            k = int(np.argmin(abs(values - value)))
            apart = np.delete(abs(values - values[k]), k).min(initial=np.inf)
            if apart < _TWICE * abs(value):
                raise SceneError(f"{WHAT}: the double multiplier {value:.4g} has no derivatives")
            left_vector = left[:, k].conj() / (left[:, k].conj() @ right[:, k])
            for factor, vector_part in ((1.0, right[:, k].real), (1j, right[:, k].imag)):
                if vector_part.any():
                    derivatives[i] += factor * (left_vector @ self._of_deviation(vector_part))
        self.lay()
        return known[:n].astype(complex), derivatives

    def _of_deviation(self, deviation: np.ndarray) -> np.ndarray:
        """Derivatives (n, m) by x of what becomes of a deviation (n,) of the start in a period."""
        shooting, period, basis = self._shooting, self._period, self._directions
        unit = basis.matrix[basis.independent]

        def beside(change: float) -> np.ndarray:
            start = shooting.variables.moved(period.start, basis, change * deviation)
            shooting.run(start, period.parameter)
            # The same change of independent variables; dependent ones follow from the moved state.
            moved = shooting.variables.directions(start, period.length)
            amounts = np.linalg.solve(moved.matrix[basis.independent], unit @ self._start.T).T
            changes = _added(self._closed(self._held_changes, start), moved, amounts)
            return shooting.slopes(changes, period)[0][basis.independent]

        def longer(change: float) -> np.ndarray:
            shooting.run(period.start, period.parameter * (1 + change))
            return shooting.slopes(changes_along, period)[0][basis.independent]

        size = period.size if period.moves else 1.0
        rows = slope(beside, _DEVIATION * size / abs(deviation).max())
        if self.period.any():
            changes_along = {
                name: np.tensordot(deviation[None], x, 1) for name, x in basis.changes.items()
            }
            rows += slope(longer, CHANGE) * self.period
        return np.linalg.solve(unit, rows)

    def lay(self) -> Period:
        """Have the steps of the motion on the tape."""
        return self._shooting.run(self._period.start, self._period.parameter)


def _held(changes: dict[str, np.ndarray], prescribed: np.ndarray) -> dict[str, np.ndarray]:
    """Changes of numbers of steps, and of driven positions in the start.

    SceneError if functions of time do not repeat themselves after a period for other x.
    """
    at_start, changes["q"] = changes.pop(AT_START), changes["q"].copy()
    changes["q"][:, prescribed], changes["motors"] = np.split(at_start, [len(prescribed)], axis=1)
    for name in OF_STEPS & changes.keys():
        if (later := changes.pop(name + LATER, None)) is not None:
            _check_repeats(changes[name], later)
    return changes


def _check_repeats(changes: np.ndarray, later: np.ndarray) -> None:
    """Refuse numbers that change functions of time (m, ...) in another way after a period."""
    differs = abs(later - changes) > _REPEATS * abs(changes).max(initial=0.0)
    if differs.any():
        number = np.flatnonzero(differs.reshape(len(differs), -1).any(axis=1))[0]
        raise SceneError(
            f"{WHAT}: x[{number}] changes the period of loads, or of driven motions, which must "
            "be the same for all x. A frequency is found by build(x, f)"
        )


def _added(
    changes: dict[str, np.ndarray], basis: Directions, amounts: np.ndarray
) -> dict[str, np.ndarray]:
    """Sum of `changes` and of those with the start, by `amounts` (m, n) of the directions."""
    total = dict(changes)
    for name, values in basis.changes.items():
        added = amounts @ values.reshape(len(values), -1)
        known = total.get(name)
        total[name] = added if known is None else known + added.reshape(known.shape)
    return total
