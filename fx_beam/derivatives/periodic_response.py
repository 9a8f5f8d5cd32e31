"""Periodic motions as a function of parameters, with derivatives."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable

import numpy as np

from fx_beam.dual import Dual, dual_array
from fx_beam.errors import SceneError, check_takes, require
from fx_beam.fem.parameter_values import before
from fx_beam.motions.motion_series import MotionSeries
from fx_beam.motions.numbers import OF_STEPS, numbers_in_steps, observed_numbers_of
from fx_beam.orbits.shooting import Shooting
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import PeriodicMotion
from fx_beam.scene.outputs import PERIOD, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.tape import LIMIT, Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import Analysis
from .gradient import DualArrays
from .motion_analysis import prepared_for
from .observation import rates_at
from .output_kinds import needs_of
from .parametrised import Parametrised, one_call
from .period_derivatives import AT_START, CHANGE, LATER, WHAT, PeriodDerivatives
from .response import Response


class PeriodicResponse(Response):
    r"""A periodic motion as a function of parameters.

    ``t, y = run(x)`` builds the scene of the parameters x and finds a motion that repeats itself.
    The rows of the outputs are those at the ends of its steps, over one period. The output "period"
    of the scene is a single number. Derivatives, by ``run.vjp(weights)``, ``run.jacobian()`` and
    ``run.multipliers()``, are those of the motion as it is found: with the state y at its start,
    its period T and the state S(y, T, x) after it, :math:`(S_y - 1) \mathrm{d}y + S_T \mathrm{d}T =
    -S_x \mathrm{d}x`, besides the phase, energy or amplitude that is given. No other motion is
    searched for. Threads may call it at once, and by `map`, as a `Response`.

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
