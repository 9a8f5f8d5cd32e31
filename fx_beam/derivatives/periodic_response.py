"""Periodic motions as a function of parameters, with derivatives."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from fx_beam.content_cache import cached_property
from fx_beam.dual import dual_array, floats
from fx_beam.errors import SceneError, check_takes, is_whole, require
from fx_beam.fem.parameter_values import before
from fx_beam.motions.numbers import OF_STEPS, numbers_in_steps, observed_numbers_of
from fx_beam.motions.options import Options
from fx_beam.motions.prepared import Prepared
from fx_beam.motions.set_ups import Lease
from fx_beam.orbits.closing import NO_SHIFT, ROUND_OFF, ROUNDING, turning_point
from fx_beam.orbits.periodic_family import without_trivial
from fx_beam.orbits.shooting import Period, Shooting
from fx_beam.orbits.variables import Directions, slope
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import PeriodicMotion
from fx_beam.scene.outputs import PERIOD, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .built_scenes import refuse_others
from .differentiable import one_call
from .energy_outputs import EnergyOutput
from .gradient import jvp
from .observation import observes_rates, rates_at
from .output_values import Wanted
from .response import Response
from .static_derivatives import StaticDerivatives
from .sub_steps import SubSteps

_WHAT = "PeriodicResponse"
# Relative changes of the period, and of a state along a deviation, for central differences.
_CHANGE, _DEVIATION = 1e-5, 1e-4
# Singular values of the equations that are zero, relative to the largest.
_SINGULAR = 1e-9
# Multipliers that differ by less, relative to them, are equal.
_TWICE = 1e-6
# Changes of functions of time that differ by less after a period, relative to the largest, repeat.
_REPEATS = 1e-6
_LATER = " a period later"
_AT_START = "driven at the start"


class _Slopes(NamedTuple):
    """Derivatives by the parameters x of what is unknown of a periodic motion."""

    #: Those (m, n) of its start, in its directions, and (m,) of the logarithm of its period.
    start: np.ndarray
    period: np.ndarray
    #: These directions, and the monodromy matrix in them.
    by: Directions
    monodromy: np.ndarray


class PeriodicResponse(Response):
    r"""A periodic motion as a function of parameters.

    ``t, y = run(x)`` builds the scene of the parameters x and finds a motion that repeats itself.
    The rows of the outputs are those at the ends of its steps, over one period. The output "period"
    of the scene is a single number. Derivatives, by ``run.vjp(weights)``, ``run.jacobian()`` and
    ``run.multipliers()``, are those of the motion as it is found: with the state y at its start,
    its period T and the state S(y, T, x) after it, :math:`(S_y - 1) \mathrm{d}y + S_T \mathrm{d}T =
    -S_x \mathrm{d}x`, besides the phase, energy or amplitude that is given. No other motion is
    searched for.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene and its outputs, as in `Response`; ``build(x, f)``, if the
        frequency f [Hz] of its loads is looked for as well.
    motion : callable
        ``motion(scene)`` finds the motion, such as ``lambda scene: fb.periodic(scene, mode=0,
        amplitude=0.1)``. Functions of time of forced motions must keep their period for all x. If
        `build` takes a frequency, ``motion(build)`` gets it as a function of this: ``lambda build:
        fb.forced_response(build, (1, 2)).critical[0].motion`` is the motion at a fold, of which
        the output "period" alone has derivatives.

    Attributes
    ----------
    motion : PeriodicMotion
        The motion of the last call.
    stats : Stats
        Statistics of its steps.

    Raises
    ------
    SceneError
        As of `Response` and `periodic`; if `motion` gives something else. In derivatives for
        motions that are not isolated, such as free ones whose energy or amplitude is not given,
        and for those of a `backbone`; for parameters that change a period of loads.

    Examples
    --------
    A mass on a spring that hardens: by the stiffness of its linear part the period changes as that
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

    def __init__(self, build: Callable[..., tuple], motion: Callable[[Any], PeriodicMotion]):
        require(callable(build), f"{_WHAT}: build", build, "a function of (x) or of (x, f)")
        self._build, self._motion_of = build, motion
        needed = inspect.signature(build).parameters.values()
        self._finds_frequency = sum(of.default is inspect.Parameter.empty for of in needed) > 1
        check_takes(build, "x, f" if self._finds_frequency else "x", f"{_WHAT}: build")
        check_takes(motion, "scene", f"{_WHAT}: motion")
        self._begin()

    def _begin(self) -> None:
        super()._begin()
        self._frequency = 0.0
        self.motion: PeriodicMotion
        self._shooting: Shooting

    def _built(self, *given: Any) -> Any:
        return super()._built(*given, *([self._frequency] if self._finds_frequency else []))

    def _scene_of(self, frequency: float) -> Scene:
        """The scene of the last parameters for a frequency of its loads."""
        self._frequency = frequency
        return self._scene_at(self._given)

    def _run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        self._given = x
        vars(self).pop("_slopes", None)
        if self._finds_frequency:
            self.motion = self._motion_of(self._scene_of)
        else:
            self._scene, self._outputs = self._at(x)
            self.motion = self._motion_of(self._scene)
        is_motion = isinstance(self.motion, PeriodicMotion)
        require(is_motion, f"{_WHAT}: motion", self.motion, "a PeriodicMotion")
        self._cycle = cycle = self.motion.cycle
        if self._finds_frequency:
            self._frequency = cycle.period.parameter
            self._scene, self._outputs = self._at(x)
        leases = list[Lease]()

        def prepare(scene: Scene, options: Options) -> Prepared:
            leases.append(self._series.lease(scene, options))
            return leases[0].set_up

        self._shooting = Shooting(self._scene, cycle.options, prepare)
        self._options = self._shooting.prepared.options
        ok = len(cycle.period.start.q) == self._shooting.model.size
        require(ok, f"{_WHAT}: motion", self.motion, "that of the scene, or of the build, given")
        #: The motion; its parameter is its length here.
        self._period = cycle.period._replace(parameter=cycle.period.length)
        solution = self._shooting.solution(self._period)
        solution.resultants_of_beam = leases[0].reads(solution.resultants_of_beam)
        self.stats, self._t = solution.stats, solution.t[1:]
        return self._t.copy(), self._read_all(solution)

    def _values_of(self, solution: Solution, of: Wanted, name: str) -> np.ndarray:
        if _is_period(of):
            return np.array(np.ptp(solution.t))
        rows = super()._values_of(solution, of, name)
        return rows[1:] if isinstance(of, Output) else rows

    def __call__(self, x: Sequence[float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Find the periodic motion of the scene of some numbers.

        Parameters
        ----------
        x : (m,) float
            The parameters that `build` takes.

        Returns
        -------
        t : (n,) float
            Times [s] of the ends of its steps.
        y : dict of (n, ...) float
            The outputs by name, a period as a single number.
        """
        return super().__call__(x)

    # -- Derivatives ------------------------------------------------------------------------------

    @one_call
    def vjp(self, weights: Mapping[str, np.ndarray]) -> np.ndarray:
        """As `Response.vjp`, by the Jacobian: the monodromy matrix takes most of the time."""
        given = self._checked_weights(weights)
        jacobian = self.jacobian(*given)
        parts = [np.tensordot(of, jacobian[name], of.ndim) for name, of in given.items()]
        return sum(parts, np.zeros(len(self._x)))

    @one_call
    def jacobian(self, *names: str) -> dict[str, np.ndarray]:
        """As `Response.jacobian`; that of an output "period" has the shape (m,)."""
        jacobian = super().jacobian(*names)
        others = [name for name in jacobian if not _is_period(self._outputs[name])]
        for name, rows in self._by_period(others).items():
            jacobian[name] = jacobian[name] + rows[..., None] * self._slopes.period
        return jacobian

    def _of_singles(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        periods = [name for name in names if _is_period(self._outputs[name])]
        return {name: self._period.length * self._slopes.period for name in periods}

    @one_call
    def multipliers(self, n: int = 1) -> tuple[np.ndarray, np.ndarray]:
        r"""The largest Floquet multipliers, with their derivatives by all numbers.

        They are :math:`\psi.(\mathrm{d}S_y) \phi / \psi.\phi` with the left and right eigenvectors
        of :math:`S_y`: central differences of derivatives along the right one.

        Parameters
        ----------
        n : int
            How many, without those that are 1 for shifts in time and the energy of a family.

        Returns
        -------
        multipliers : (n,) complex
            As `PeriodicMotion.multipliers`; of a complex pair the one with the positive imaginary
            part, once.
        derivatives : (n, m) complex
            d multipliers/dx.

        Raises
        ------
        SceneError
            Before the first call, for scenes without derivatives, for motions without others than
            these, for multipliers that are equal, and at a fold.
        """
        self._check_rows()
        known = without_trivial(self.motion.multipliers, self._cycle.trivial)
        known = known[known.imag >= 0]
        if not len(known):
            raise SceneError(f"{_WHAT}.multipliers: all are 1, for shifts in time and the energy")
        ok = is_whole(n, 1, len(known))
        require(ok, f"{_WHAT}.multipliers: n", n, f"a whole number from 1 to {len(known)}")
        values, left, right = scipy.linalg.eig(self._slopes.monodromy, left=True, right=True)
        derivatives = np.zeros((n, len(self._x)), dtype=complex)
        for i, value in enumerate(known[:n]):
            k = int(np.argmin(abs(values - value)))
            apart = np.delete(abs(values - values[k]), k).min(initial=np.inf)
            if apart < _TWICE * abs(value):
                raise SceneError(f"{_WHAT}: the double multiplier {value:.4g} has no derivatives")
            to = left[:, k].conj() / (left[:, k].conj() @ right[:, k])
            for factor, along in ((1.0, right[:, k].real), (1j, right[:, k].imag)):
                if along.any():
                    derivatives[i] += factor * (to @ self._of_deviation(along))
        self._lay()
        return known[:n].astype(complex), derivatives

    def _of_deviation(self, deviation: np.ndarray) -> np.ndarray:
        """Derivatives (n, m) by x of what becomes of a deviation (n,) of the start in a period."""
        shooting, period, slopes = self._shooting, self._period, self._slopes
        by, of_numbers = slopes.by, super()._changes()
        unit = by.matrix[by.independent]

        def beside(change: float) -> np.ndarray:
            start = shooting.variables.moved(period.start, by, change * deviation)
            shooting.run(start, period.parameter)
            # The same change of independent variables, whose others follow from another state.
            there = shooting.variables.directions(start, period.length)
            amounts = np.linalg.solve(there.matrix[by.independent], unit @ slopes.start.T).T
            changes = _added(of_numbers, there, amounts)
            return shooting.slopes(changes, period)[0][by.independent]

        def longer(change: float) -> np.ndarray:
            shooting.run(period.start, period.parameter * (1 + change))
            return shooting.slopes(along, period)[0][by.independent]

        size = period.size if period.moves else 1.0
        rows = slope(beside, _DEVIATION * size / abs(deviation).max())
        if slopes.period.any():
            along = {name: np.tensordot(deviation[None], of, 1) for name, of in by.changes.items()}
            rows += slope(longer, _CHANGE) * slopes.period
        return np.linalg.solve(unit, rows)

    def _check_rows(self) -> None:
        """SceneError for motions whose rows have no derivatives."""
        if self._cycle.chosen_by == "fold":
            raise SceneError(
                f"{_WHAT}: at a fold only the output 'period' has derivatives: the motion changes "
                "along the curve of folds, which needs second derivatives"
            )

    @cached_property
    def _slopes(self) -> _Slopes:
        """Derivatives of the start and of the period, from the equations of the motion."""
        shooting, period, cycle = self._shooting, self._period, self._cycle
        error = self._lay().error
        if error > max(10 * self.motion.error, ROUND_OFF):
            raise SceneError(
                f"{_WHAT}: the motion does not repeat itself in the scene that build gives: the "
                f"states before and after the period are {error:.1e} of it apart. motion(scene) "
                "must find the motion of this scene"
            )
        changes = super()._changes()
        refuse_others(changes, shooting.derivatives.names, _WHAT)
        by = shooting.variables.directions(period.start, period.length)
        independent, n = by.independent, by.matrix.shape[1]
        unit = by.matrix[independent]
        after, _ = shooting.slopes(by.changes, period)
        monodromy = np.linalg.solve(unit, after[independent])
        rows = [after[independent] - unit]
        right = [shooting.slopes(changes, period)[0][independent]]
        if cycle.chosen_by == "fold":
            none = np.zeros((len(self._x), n))
            return _Slopes(none, self._of_fold(rows[0], right[0], by), by, monodromy)
        of_parameter = np.zeros((len(unit), 0))
        if cycle.free and cycle.chosen_by != "period":
            of_parameter = shooting.by_parameter(period)[independent, None]
        rows[0] = np.hstack([rows[0], of_parameter])
        more = of_parameter.shape[1]
        for slopes, by_x in self._conditions(by, changes):
            rows.append(slopes[None, : n + more])
            right.append(by_x[None])
        matrix, sides = np.vstack(rows), np.vstack(right)
        sizes = np.linalg.svd(matrix, compute_uv=False)
        if cycle.free and sizes[n + more - 1] < _SINGULAR * sizes[0]:
            raise SceneError(
                f"{_WHAT}: the motion is one of a family of the same scene, and nothing chooses "
                "it. Give periodic the energy or the amplitude"
            )
        solved = -scipy.linalg.lstsq(matrix, sides, ROUNDING, lapack_driver="gelsy")[0].T
        self._lay()
        of_period = solved[:, n] if more else np.zeros(len(self._x))
        return _Slopes(solved[:, :n], of_period, by, monodromy)

    def _conditions(
        self, by: Directions, changes: dict[str, np.ndarray]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """What chooses the motion: derivatives by its start and period, and by x."""
        cycle, shooting, period = self._cycle, self._shooting, self._period
        if cycle.chosen_by not in ("", "period", "frequency", "energy", "amplitude"):
            raise SceneError(
                f"{_WHAT}: this motion of a family has no derivatives. Find it by periodic, with "
                "an energy, an amplitude or a period"
            )
        nothing = np.zeros(len(self._x))
        held = list[tuple[np.ndarray, np.ndarray]]()
        if cycle.free:
            phase = NO_SHIFT
            if cycle.chosen_by in ("energy", "amplitude"):
                phase = turning_point(shooting, period)
            held.append((phase.slopes(period, by), nothing))
        if cycle.chosen_by == "energy":
            slopes = np.append(shooting.variables.slope_of_energy(period.start, by), 0.0)
            size = np.linalg.norm(slopes)
            held.append((slopes / size, self._energy_by_x(changes) / size))
        elif cycle.chosen_by == "amplitude":
            unit = shooting.model.unit[cycle.held]
            slopes = np.append(by.changes["q"][:, cycle.held], 0.0)
            place = self._start_by_x(changes)["q"][0, :, cycle.held]
            held.append((slopes / unit, (place - self._rest_by_x()) / unit))
        return held

    def _start_by_x(self, changes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Derivatives (1, m, ...) of the start, of which the independent variables are held.

        Others follow them by joints, whose shape depends on x.
        """
        self._lay()
        return self._shooting.derivatives.jvp(self._shooting.tape, changes, np.zeros(1, dtype=int))

    def _rest_by_x(self) -> np.ndarray:
        """Derivatives (m,) of what the amplitude is measured from."""
        cycle = self._cycle
        if cycle.state is None:
            return np.zeros(len(self._x))
        path = cycle.state.load_path
        if path is None or path.scene is not self._scene:
            raise SceneError(
                f"{_WHAT}: an amplitude about a state has derivatives if motion(scene) computes "
                "this by static(scene). Or give the energy"
            )
        at_rest = StaticDerivatives(path).change_of_end(self._derivatives, _WHAT).of_nodes
        return at_rest[:, cycle.held]

    def _energy_by_x(self, changes: dict[str, np.ndarray]) -> np.ndarray:
        """Derivatives (m,) of the energy of the start, of which the variables are held."""
        model, tape, none = self._shooting.model, self._shooting.tape, np.zeros(1, dtype=int)
        held, of = self._start_by_x(changes), SubSteps(model, tape, none)
        output = EnergyOutput(of, "energy of steps", none)
        by_x = jvp(output.blocks(none), (1,), held, changes)[0]
        if model.loads.constant and model.loads.functions:
            loads, q = model.loads.unit_loads, self._period.start.q
            factors = floats(model.loads.series(np.zeros(1)))[0]
            columns = np.repeat(np.arange(loads.shape[1]), np.diff(loads.indptr))
            by_x = by_x - changes["columns"] @ (q[loads.indices] * factors[columns])
            of_factors = changes["loads"].reshape(len(self._x), -1, loads.shape[1])[:, 0]
            by_x = by_x - of_factors @ (loads.T @ q) - held["q"][0] @ (loads @ factors)
        return by_x

    def _of_fold(self, matrix: np.ndarray, right: np.ndarray, by: Directions) -> np.ndarray:
        """Those (m,) of the period: the left vector of S_y - 1 leaves the frequency alone."""
        period, frequency = self._period, self._frequency
        vector = np.linalg.svd(matrix)[0][:, -1]

        def gap(change: float) -> np.ndarray:
            other = Shooting(self._scene_of(frequency * (1 + change)), self._cycle.options)
            return other.run(period.start, period.length / (1 + change)).gap

        of_frequency = slope(gap, _CHANGE)[by.independent]
        self._frequency = frequency
        self._lay()
        return (vector @ right) / (vector @ of_frequency)  # of the period, the inverse

    def _by_period(self, names: list[str]) -> dict[str, np.ndarray]:
        """Derivatives of outputs by the logarithm of the period, at the same start."""
        if not self._slopes.period.any():
            return {}
        period, of = self._period, {name: self._outputs[name] for name in names}

        def longer(change: float) -> list[np.ndarray]:
            length = period.length * (1 + change)
            solution = self._shooting.solution(period._replace(length=length, parameter=length))
            return [self._values_of(solution, of[name], name) for name in names]

        ends = zip(longer(-_CHANGE), longer(_CHANGE), strict=True)
        slopes = {name: (b - a) / (2 * _CHANGE) for name, (a, b) in zip(names, ends, strict=True)}
        self._lay()
        return slopes

    def _lay(self) -> Period:
        """Have the steps of the motion on the tape."""
        return self._shooting.run(self._period.start, self._period.parameter)

    def _followed(self, what: str) -> tuple[Model, Tape, TapeDerivatives]:
        shooting = self._shooting
        return shooting.model, shooting.tape, shooting.derivatives

    def _changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) of all numbers by x, those of the start of the motion among them.

        As of `Response`, they have the independent variables of the start held.
        """
        self._check_rows()
        slopes = self._slopes  # which have the steps of the motion on the tape
        return _added(super()._changes(), slopes.by, slopes.start)

    def _changes_by_x(self) -> dict[str, np.ndarray]:
        changes, model = self._derivatives(self._numbers_of_scene), self._shooting.model
        at_start, prescribed = changes.pop(_AT_START), len(model.prescribed)
        changes["q"] = changes["q"].copy()
        changes["q"][:, model.prescribed] = at_start[:, :prescribed]
        changes["motors"] = at_start[:, prescribed:]
        for name in OF_STEPS & changes.keys():
            if (later := changes.pop(name + _LATER, None)) is not None:
                _check_repeats(changes[name], later)
        return changes

    def _numbers_of_scene(self, scene: Scene, change: Any) -> dict[str, Any]:
        """Numbers of the steps of this motion for another scene, from the same state."""
        tape, start, period = self._shooting.tape, self._period.start, self._period.length
        other = self._prepared(scene, change)
        t0, t1 = tape.times.starts, tape.times.ends
        of_scene = other.model, other.model.data, start
        numbers: dict[str, Any] = numbers_in_steps(*of_scene, t0, t1)
        later = numbers_in_steps(*of_scene, t0 + period, t1 + period)
        numbers |= {name + _LATER: later[name] for name in OF_STEPS & later.keys()}
        numbers[_AT_START] = dual_array(other.forcing.series(t0[:1])[0])
        if natural := other.model.natural:
            numbers["natural"] = natural.numbers_at(float(before(start.t)))
        of = [output for output in self._outputs.values() if isinstance(output, Output)]
        if any(observes_rates(other.model, output) for output in of):
            rates = rates_at(tape, np.arange(len(tape) + 1))
            numbers |= observed_numbers_of(*of_scene, *rates, False)
        return numbers


def _check_repeats(changes: np.ndarray, later: np.ndarray) -> None:
    """Refuse numbers that change functions of time (m, ...) in another way after a period."""
    wrong = abs(later - changes) > _REPEATS * abs(changes).max(initial=0.0)
    if wrong.any():
        number = np.flatnonzero(wrong.reshape(len(wrong), -1).any(axis=1))[0]
        raise SceneError(
            f"{_WHAT}: x[{number}] changes the period of loads, or of driven motions, which must "
            "be the same for all x. A frequency is found by build(x, f)"
        )


def _is_period(output: Wanted) -> bool:
    return isinstance(output, Output) and output.quantity == PERIOD


def _added(
    changes: dict[str, np.ndarray], by: Directions, amounts: np.ndarray
) -> dict[str, np.ndarray]:
    """Changes of numbers with those of the start, amounts (m, n) of its directions."""
    total = dict(changes)
    for name, of in by.changes.items():
        more = amounts @ of.reshape(len(of), -1)
        known = total.get(name)
        total[name] = more if known is None else known + more.reshape(known.shape)
    return total
