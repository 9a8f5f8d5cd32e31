"""Periodic motions as a function of parameters, with derivatives."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable

import numpy as np
import scipy.linalg

from fx_beam.dual import Dual, dual_array, floats
from fx_beam.equilibria.statics import path_of
from fx_beam.errors import SceneError, check_takes, is_whole, require
from fx_beam.fem.functions_of_time import before
from fx_beam.motions.dynamics import MotionSeries
from fx_beam.motions.motion_setup import OF_STEPS, numbers_in_steps, observed_numbers_of
from fx_beam.orbits.periodic_family import without_trivial
from fx_beam.orbits.shooting import (
    NO_SHIFT,
    ROUND_OFF,
    Directions,
    Period,
    Shooting,
    least_squares,
    slope,
    turning_point,
)
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import PeriodicMotion
from fx_beam.scene.outputs import PERIOD, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.tape import LIMIT, Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import Analysis, StaticDerivatives, prepared_for
from .observation import rates_at
from .output_kinds import energy_blocks, needs_of
from .parametrised import DualArrays, NumbersOf, Parametrised, jvp, one_call, refuse_others
from .response import Response
from .row_output import SubSteps

# -- Derivatives of a periodic motion: its start and period follow from the equations of a period


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
            differs = abs(later - changes[name])
            differs = differs > _REPEATS * abs(changes[name]).max(initial=0.0)
            if differs.any():
                number = np.flatnonzero(differs.reshape(len(differs), -1).any(axis=1))[0]
                raise SceneError(
                    f"{WHAT}: x[{number}] changes the period of loads, or of driven motions, which "
                    "must be the same for all x. A frequency is found by build(x, f)"
                )
    return changes


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


# -- Periodic motions as a function of parameters, with derivatives -----------------------------


class PeriodicResponse(Response):
    r"""A periodic motion as a function of parameters.

    ``t, y = run(x)`` builds the scene of the parameters x and finds a motion that repeats itself.
    The rows of the outputs are those at the ends of its steps, over one period. The output "period"
    of the scene is a single number. Derivatives, by ``run.vjp(weights)``, ``run.jacobian()`` and
    ``run.multipliers()``, are those of the computed motion: with the state y at its start, its
    period T and the state S(y, T, x) after a period, :math:`(S_y - 1) \mathrm{d}y + S_T \mathrm{d}T
    = -S_x \mathrm{d}x`, together with the condition that gives the phase, energy or amplitude. No
    other motion is searched for. Several threads may call it, and `map`, as with `Response`.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene and its outputs, as in `Response`. If the frequency f [Hz] of
        its loads is unknown as well, it is ``build(x, f)``.
    motion : callable
        ``motion(scene)`` finds the motion, such as ``lambda scene: fb.periodic(scene, mode=0,
        amplitude=0.1)``. Functions of time of forced motions must keep their period for all x. If
        `build` takes a frequency, the argument of `motion` is the scene as a function of the
        frequency: ``lambda build: fb.forced_response(build, (1, 2)).critical[0].motion`` finds the
        motion at a fold, where only the output "period" has derivatives.

    Attributes
    ----------
    motion : PeriodicMotion
        The motion of the last call.
    stats : Stats
        Statistics of the steps of this motion.

    Raises
    ------
    SceneError
        In the cases of `Response` and `periodic`; if `motion` does not give a periodic motion. In
        derivatives for motions that are not isolated, such as free motions whose energy or
        amplitude is not given, and for motions of a `backbone`; for parameters that change the
        period of loads.

    Examples
    --------
    A mass on a hardening spring: the period, and its derivative by the linear stiffness, are those
    of Duffing's equation.

    >>> import fx_beam as fb
    >>> def build(x):
    ...     scene = fb.Scene()
    ...     body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    ...     spring = fb.Spring(stiffness=x[0], strain_energy=lambda s: s**4 / 4)
    ...     scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    ...     return scene, {"period": fb.Output("period", scene)}
    >>> run = fb.PeriodicResponse(build, lambda scene: fb.periodic(scene, mode=0, amplitude=1.0))
    >>> t, y = run([1.0])
    >>> round(float(y["period"]), 3), run.jacobian()["period"].round(3)
    (4.769, array([-1.384]))
    """

    _analysis: PeriodicAnalysis

    def __init__(self, build: Callable[..., tuple], motion: Callable[..., PeriodicMotion]):
        require(callable(build), f"{WHAT}: build", build, "a function of (x) or of (x, f)")
        needed = inspect.signature(build).parameters.values()
        finds = sum(argument.default is inspect.Parameter.empty for argument in needed) > 1
        check_takes(build, "x, f" if finds else "x", f"{WHAT}: build")
        check_takes(motion, "scene", f"{WHAT}: motion")
        self._begin(build, functools.partial(PeriodicAnalysis, motion, finds))

    @property
    def motion(self) -> PeriodicMotion:
        """The motion of the last call."""
        return self._state()._analysis.motion

    @one_call
    def multipliers(self, n: int = 1) -> tuple[np.ndarray, np.ndarray]:
        r"""The largest Floquet multipliers, with their derivatives by all parameters.

        The derivatives are :math:`\psi.(\mathrm{d}S_y) \phi / \psi.\phi` with the left and right
        eigenvectors :math:`\psi, \phi` of :math:`S_y`; :math:`(\mathrm{d}S_y) \phi` is found by
        central differences along :math:`\phi`.

        Parameters
        ----------
        n : int
            Number of multipliers. Multipliers that are 1 in any case, for shifts in time and for
            the energy of a family of motions, are left out.

        Returns
        -------
        multipliers : (n,) complex
            As `PeriodicMotion.multipliers`; of a complex pair only the one with positive imaginary
            part.
        derivatives : (n, m) complex
            d multipliers/dx.

        Raises
        ------
        SceneError
            Before the first call, for scenes without derivatives, for motions that have no other
            multipliers, for equal multipliers, and at a fold.
        """
        return self._analysis.multipliers(n)


class PeriodicAnalysis(Analysis):
    """Motions that repeat themselves, and how they follow from the equations of a period.

    If it `finds_frequency`, `motion_of` gets the scene as a function of that of the loads.
    """

    single = PERIOD
    forwards = True  # the monodromy matrix takes most of the time
    motion: PeriodicMotion
    #: Gives the scene of the last parameters for a frequency of its loads [Hz].
    _scene_of: Callable[[float], Scene]

    def __init__(
        self,
        motion_of: Callable[..., PeriodicMotion],
        finds_frequency: bool,
        parameters: Parametrised,
    ):
        super().__init__(parameters)
        self._motion_of, self._finds_frequency = motion_of, finds_frequency
        self._series = MotionSeries(LIMIT)
        self._period_derivatives: PeriodDerivatives | None = None

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times and outputs of the motion for parameters."""
        parameters, self._period_derivatives = self.parameters, None
        # The motion computes its rows when they are read, perhaps after a call for another x.
        self._scene_of = lambda frequency: parameters.build_at(x, frequency)[0]
        source = self._scene_of if self._finds_frequency else parameters.build_and_keep(x)
        self.motion = motion = self._motion_of(source)
        is_motion = isinstance(motion, PeriodicMotion)
        require(is_motion, f"{WHAT}: motion", motion, "a PeriodicMotion")
        cycle = motion.cycle
        if self._finds_frequency:
            parameters.more = (cycle.period.parameter,)
            parameters.build_and_keep(x)
        self._shooting = Shooting(parameters.scene, cycle.options, self._series.prepare)
        ok = len(cycle.period.start.q) == self._shooting.model.size
        require(ok, f"{WHAT}: motion", motion, "that of the scene, or of the build, given")
        #: The motion; its parameter is its length here.
        self._period = cycle.period._replace(parameter=cycle.period.length)
        solution = self._shooting.solution(self._period)
        self._series.is_kept = any(map(callable, self.outputs.values()))
        parameters.stats, self.t = solution.stats, solution.t[1:]
        return self.t.copy(), self.read(solution)

    def value(self, solution: Solution, name: str) -> np.ndarray:
        """As of `Analysis`, at the ends of the steps; its period."""
        output = self.outputs[name]
        if not isinstance(output, Output):
            return super().value(solution, name)
        if output.quantity == PERIOD:
            return np.array(np.ptp(solution.t))
        return super().value(solution, name)[1:]

    # -- Derivatives ------------------------------------------------------------------------------

    @property
    def _derivatives(self) -> PeriodDerivatives:
        """Derivatives of the start and the period of the last motion."""
        if self._period_derivatives is None:
            self._period_derivatives = PeriodDerivatives(
                self.parameters, self.motion, self._shooting, self._numbers_of, self._scene_of
            )
        return self._period_derivatives

    def of_single(self) -> np.ndarray:
        """As of `Analysis`, of the period."""
        return self._period.length * self._derivatives.period

    def multipliers(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """The n largest multipliers (n,), and their derivatives (n, m)."""
        self._check_rows()
        return self._derivatives.multipliers(n)

    def _check_rows(self) -> None:
        """SceneError for motions whose rows have no derivatives."""
        if self.motion.cycle.chosen_by == "fold":
            raise SceneError(
                f"{WHAT}: at a fold only the output 'period' has derivatives: the motion changes "
                "along the curve of folds, which needs second derivatives"
            )

    def of_length(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """As of `Analysis`, by the period at the same start."""
        derivatives, period, names = self._derivatives, self._period, list(names)
        if not derivatives.period.any():
            return {}

        def longer(change: float) -> list[np.ndarray]:
            length = period.length * (1 + change)
            solution = self._shooting.solution(period._replace(length=length, parameter=length))
            return [self.value(solution, name) for name in names]

        pairs = zip(names, longer(-CHANGE), longer(CHANGE), strict=True)
        slopes = {
            name: (longer_rows - shorter_rows) / (2 * CHANGE)
            for name, shorter_rows, longer_rows in pairs
        }
        derivatives.lay()
        return {name: rows[..., None] * derivatives.period for name, rows in slopes.items()}

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """As of `Analysis`."""
        shooting = self._shooting
        return shooting.model, shooting.tape, shooting.derivatives

    def changes(self) -> dict[str, np.ndarray]:
        """As of `Analysis`, with the changes of the start of the motion."""
        self._check_rows()
        return self._derivatives.changes  # which have the steps of the motion on the tape

    def _numbers_of(self, scene: Scene, change: np.ndarray | Dual) -> DualArrays:
        """Numbers of the steps of this motion for another scene, from the same state."""
        tape, start, period = self._shooting.tape, self._period.start, self._period.length
        options = self._shooting.prepared.options
        other = prepared_for(self._series, options, self.parameters.scene, scene, change)
        t0, t1 = tape.times.starts, tape.times.ends
        model, data = other.model, other.model.data
        numbers: DualArrays = {**numbers_in_steps(model, data, start, t0, t1)}
        later = numbers_in_steps(model, data, start, t0 + period, t1 + period)
        numbers |= {name + LATER: later[name] for name in OF_STEPS & later.keys()}
        numbers[AT_START] = dual_array(other.forcing.series(t0[:1])[0])
        if natural := data.natural:
            numbers["natural"] = natural.numbers_at(float(before(start.t)))
        if needs_of(model, self.measured).rates:
            times, lengths = rates_at(tape, np.arange(len(tape) + 1))
            numbers |= observed_numbers_of(model, data, start, times, lengths, False)
        return numbers
