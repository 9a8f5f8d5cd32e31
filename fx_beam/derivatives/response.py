"""A motion as a function of parameters: a scene is built for each, and only its data are set."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from fx_beam.dual import Dual, floats
from fx_beam.equilibria.statics import LoadPath
from fx_beam.errors import SceneError, array_of, check_takes, is_one_of, positive, require, shown
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.initial_state import rates_with_slopes
from fx_beam.motions.motion_series import MotionSeries
from fx_beam.motions.numbers import numbers_in_steps, numbers_of_state, observed_numbers_of
from fx_beam.motions.options import Options
from fx_beam.motions.prepared import Prepared
from fx_beam.motions.run import Run
from fx_beam.results.records import stats_unchanged
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.outputs import Output, check_output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record
from fx_beam.step.tape import LIMIT, Part, Tape
from fx_beam.step.tape_derivatives import TapeDerivatives, Weights

from .built_scenes import refuse_others
from .differentiable import Differentiable, one_call
from .gradient import along
from .local_outputs import observes_start
from .objectives import Cost, Misfit, Objective
from .observation import Observation, check_outputs, observes_rates, rates_at, read_entries, summed
from .output_values import Wanted, recorded, row_values, values_of
from .short_reversals import warn_of_short_reversals
from .static_derivatives import StaticDerivatives, why_no_sums, why_not

_log = logging.getLogger("fx_beam")
# Growth of derivatives towards the start above which they say little about the motion.
_USEFUL_GROWTH = 1e6
_CHAOTIC = (
    "Response.vjp: towards the start the derivatives grow %.1e times: the motion is chaotic, or "
    "has vibrations that the step does not resolve. They are exact for these steps, but tell only "
    "of tiny changes. Use a shorter time, or EnergyDecaying"
)
# Length of the step that tells the accelerations at the start, relative to the others: its mean
# loads are those just after the start, which accelerations have.
_INSTANT = 2e-12
#: A function of parameters (m,) that gives a scene and its outputs by name.
Build = Callable[[np.ndarray], tuple[Scene, Mapping[str, Wanted]]]


class Response(Differentiable):
    """The motion of a scene as a function of parameters.

    ``t, y = run(x)`` builds the scene of the parameters x and simulates it. The first call sets the
    scene up; the next ones only set the data: all that is given as a number, a position, or a
    function of time or place. Results are those of `simulate`, to the last digit unless functions
    round otherwise for arrays, or for dual numbers (after a call with derivatives). A scene with
    other beams, elements, joints, supports or kinds of loads is set up anew, and so is one whose
    functions in UFL give other expressions, in which a `Parameter` is no number;
    ``run.stats.setup_reason`` says why.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene and its outputs, a dict by names: each an `Output`, or a
        function of the `Solution` that gives a number or an array, such as
        ``lambda solution: solution.energy.total``.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    t_end : float
        End of the simulation [s].
    dt : float, optional
        Time step [s]; optional with a tolerance.
    tolerance, dt_max, breaks : optional
        Steps that are chosen by their errors, as in `simulate`. Different parameters then have
        different times; `record` with `times` gives the outputs at the same ones.
    start : Solution or callable, optional
        Solution whose end is the initial state; or ``start(scene)``, which computes it, such as
        ``lambda scene: fb.static(scene)``.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_halvings : int
        How often a failing step is halved.
    record : Record, optional
        Rows of the outputs, by `every` or `times`; by default all steps. What the outputs do not
        need is not recorded in any case. Velocities at `times` are those of polynomials, their
        derivatives those of the steps.
    inputs : dict, optional
        Functions of time of the inputs of the scene, as in `simulate`.
    memory : float
        Memory for the steps that derivatives follow [bytes]. If a motion needs more, only states at
        some steps are kept, and increments in half of the memory. Derivatives repeat the steps
        between, to the last digit, those with increments without iterations.

    Attributes
    ----------
    stats : Stats
        Statistics of the last run.

    Raises
    ------
    SceneError
        If `build` is no function; in a call if x are not finite numbers, or if `build` does not
        give a scene with outputs of the same names as before.

    Examples
    --------
    The end of a pendulum that is an elastic bar, for two stiffnesses.

    >>> import fx_beam as fb
    >>> def build(x):
    ...     scene = fb.Scene(gravity=(0, -9.81))
    ...     section = fb.Section(EA=x[0], GA=x[0], EI=1.0, rhoA=x[1], rhoI=1e-4)
    ...     bar = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    ...     scene.pin(bar.start)
    ...     return scene, {"end": fb.Output("position", bar.end)}
    >>> run = fb.Response(build, dt=0.01, t_end=0.5)
    >>> t, y = run([1e3, 1.0])
    >>> y["end"].shape, run.stats.setup_reason
    ((51, 2), 'the first scene')
    >>> t, y = run([2e3, 1.1])
    >>> run.stats.setup_reason
    ''
    """

    def __init__(
        self,
        build: Build,
        scheme: Scheme | None = None,
        *,
        t_end: float,
        dt: float | None = None,
        tolerance: float | None = None,
        dt_max: float | None = None,
        breaks: Sequence[float] = (),
        start: Solution | Callable[[Scene], Solution] | None = None,
        newton: NewtonOptions | None = None,
        max_halvings: int = 12,
        record: Record | None = None,
        inputs: Mapping[str, Any] | None = None,
        memory: float = LIMIT,
    ):
        check_takes(build, "x", "Response: build")
        if callable(start):
            check_takes(start, "scene", "Response: start")
        self._memory = positive(memory, "Response: memory", "a positive number of bytes")
        self._build, self._start = build, start
        self._options = Options.among(locals(), what="Response", progress=False)
        if self._options.record.file is not None:
            raise SceneError("Response: a record to a file is not possible; use simulate")
        self._begin()

    #: Memory for the steps that derivatives follow [bytes].
    _memory = LIMIT
    #: What is asked for; a static one asks for nothing.
    _options = Options()

    def _begin(self) -> None:
        super()._begin()
        self._record = self._options.record
        self._outputs: dict[str, Wanted] = {}
        #: Names of the outputs, from the first scene on.
        self._names: list[str] = []
        # Several processes have no derivatives.
        self._series = MotionSeries(self._memory)
        self._of_tape: TapeDerivatives | None = None
        # Whether there was a warning of friction that reverses in too few steps.
        self._warned = False
        # The last run whose rows only this object has.
        self._last_run: Run | None = None
        # The equilibrium from which the last motion started, if it was computed for it.
        self._path: LoadPath | None = None

    def _at(self, x: Any) -> tuple[Scene, dict[str, Wanted]]:
        """The scene of parameters, and its outputs; SceneError if `build` gives something else."""
        built = self._built(x)
        ok = isinstance(built, tuple) and len(built) == 2
        if not ok or not isinstance(built[0], Scene) or not isinstance(built[1], Mapping):
            raise SceneError(f"Response: build must give a scene and outputs, not {shown(built)}")
        scene, outputs = built[0], dict(built[1])
        require(bool(outputs), "Response: outputs", outputs, "at least one output by name")
        for name, output in outputs.items():
            what = f"Response: the output {name!r}"
            if isinstance(output, Output):
                check_output(scene, output, what)
                if isinstance(output.of, ForceBetween):
                    raise SceneError(
                        f"{what}, {output}, has no derivatives: take positions of its points, of "
                        "which its force is a function, or the spring_energy of the scene"
                    )
            else:
                expected = "an fx_beam.Output, or a function of the solution"
                require(callable(output), what, output, expected)
                check_takes(output, "solution", what)
        self._names = self._names or list(outputs)
        expected = f"as in the first call, {self._names}"
        require(list(outputs) == self._names, "Response: outputs", list(outputs), expected)
        return scene, outputs

    def _scene_at(self, x: Any) -> Scene:
        return self._at(x)[0]

    @one_call
    def __call__(self, x: Sequence[float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Simulate the scene of some parameters.

        Parameters
        ----------
        x : (m,) float
            The parameters that `build` takes.

        Returns
        -------
        t : (n,) float
            Times [s].
        y : dict of (n, ...) float
            The outputs by name.
        """
        given = self._begin_call(x)
        t, y = self._run(given)
        self._shapes = {name: rows.shape for name, rows in y.items()}
        self._x = given
        return t, y

    def _run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        # Functions of the user's, which have read a scene before, may take plain floats alone.
        plain = callable(self._start) or any(map(callable, self._outputs.values()))
        return self._motion(self._scenes.serve(x, self._begun, not plain))

    def _begun(self, x: Any = None) -> Run:
        """A run of the scene of x, or of the last one, that is to take its steps."""
        if x is not None:
            self._scene, self._outputs = self._at(x)
        scene, last = self._scene, self._options.record
        if (record := recorded(self._record, last, self._outputs)) is not last:
            self._options = replace(self._options, record=record)
        over, self._last_run = self._last_run, None
        return self._series.begun(scene, self._options, self._start_of(scene), over)

    def _motion(self, run: Run) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        read = run.take_steps(lambda: self._rows_of(run) or run.solution())
        self.stats = run.prepared.stats
        if self._series.tape is not None:
            self._series.tape.last = run.recorder.end
        if isinstance(read, Solution):
            self._t = read.t
            return self._t, self._read_all(read)
        run.lease.end()
        self._last_run, self._t = run, run.recorder.t
        return self._t.copy(), read

    def _rows_of(self, run: Run) -> dict[str, np.ndarray]:
        """The outputs from the rows of a run; empty if these are not all, or places need a look."""
        options, looks = self._options, self._scene.contacts or run.prepared.model.has_contact
        if looks or options.tolerance is not None or options.record.times is not None:
            return {}
        of_run = run.prepared.model, run.recorder
        every = {name: row_values(*of_run, output) for name, output in self._outputs.items()}
        y = {name: rows for name, rows in every.items() if rows is not None}
        return y if len(y) == len(every) else {}

    def _read_all(self, solution: Solution) -> dict[str, np.ndarray]:
        return {name: self._values_of(solution, of, name) for name, of in self._outputs.items()}

    def _values_of(self, solution: Solution, of: Wanted, name: str) -> np.ndarray:
        """Values of an output in a solution."""
        return values_of(solution, of, name)

    def _start_of(self, scene: Scene) -> Solution | None:
        self._path = None
        if not callable(self._start):
            return self._start
        clock, solution = perf_counter(), self._start(scene)
        path = getattr(solution, "load_path", None)
        if path is not None and path.scene is scene and path.began >= clock:
            self._path = path
        return solution

    @one_call
    def vjp(self, weights: Mapping[str, np.ndarray]) -> np.ndarray:
        """Derivatives of a sum of weights times outputs of the last call, by all parameters.

        They are those of the steps as they were taken, to round-off (adjoint method), times those
        of the scene's data, by dual numbers in `build`, without a motion; see
        `stats.difference_reason`. Where slip with `Coulomb` friction reverses in a few steps, those
        of the time when it does take their place. The first call of `vjp` repeats the motion; later
        ones find what motions have left for them.

        Parameters
        ----------
        weights : dict of (n, ...) float
            Weights by the names of outputs, of the shapes that the outputs have.

        Returns
        -------
        (m,) float
            The sum over t of weights times dy/dx.

        Raises
        ------
        SceneError
            Before the first call of the response; for weights of other names or shapes; for an
            output, a scheme or a part of the scene that has no derivatives.
        """
        given = self._checked_weights(weights)
        singles = self._of_singles(given)
        by_x = sum((given.pop(name) * of for name, of in singles.items()), np.zeros(len(self._x)))
        if singles and not given:
            return by_x
        outputs = self._differentiable(given, "Response.vjp: weights")
        tape, derivatives, changes, observe, entries = self._begin_derivatives("vjp", outputs)
        boundaries, changing = self._boundaries(tape), {*self._scenes.changing, "hold"}
        changing &= changes.keys()
        by_numbers = {name: np.zeros(changes[name].shape[1:]) for name in changing}
        counting = np.zeros(len(self._t), dtype=bool)  # others need no states, nor fitted rates
        for values in given.values():
            counting |= values.reshape(len(values), -1).any(axis=1)

        def weights_of(part: Part) -> Weights:
            inside, after = part.of_boundaries(boundaries), boundaries > part.end
            inside = inside[counting[inside]]
            later = {name: float(given[name][after].sum()) for name in summed(outputs)}
            wanted = dict(outputs) if len(inside) else {name: outputs[name] for name in later}
            if not (len(inside) or any(later.values())):
                return {}, boundaries[:0], boundaries[:0]
            observed = observe(wanted, boundaries[inside])
            of_part = {name: given[name][inside] for name in wanted}
            of_state = observed.vjp(of_part, later, by_numbers)
            return of_state, observed.boundaries, observed.sub_steps

        of_steps = derivatives.vjp(tape, weights_of, changing, entries)
        self.stats.gradient_growth = growth = derivatives.growth
        if growth > _USEFUL_GROWTH:
            _log.warning(_CHAOTIC, growth)
        for name, by in of_steps.items():
            by_numbers[name] += by.reshape(by_numbers[name].shape)
        return sum((along(changes[name], by) for name, by in by_numbers.items()), by_x)

    @one_call
    def jacobian(self, *names: str) -> dict[str, np.ndarray]:
        """Derivatives of outputs of the last call by all parameters, at all times.

        They are those of the steps as they were taken, to round-off (forward sensitivities), times
        those of the scene's data, by one call of `build` with dual numbers, without a motion. Slip
        that reverses in a few steps has those of its time, as in `vjp`.

        Parameters
        ----------
        *names : str
            Names of outputs; by default all.

        Returns
        -------
        dict of (n, ..., m) float
            dy/dx by the names of the outputs.

        Raises
        ------
        SceneError
            As of `vjp`.
        """
        wanted = self._differentiable(names or self._names, "Response.jacobian: names")
        singles = self._of_singles(wanted)
        outputs = {name: output for name, output in wanted.items() if name not in singles}
        if singles and not outputs:
            return singles
        tape, derivatives, changes, observe, entries = self._begin_derivatives("jacobian", outputs)
        boundaries, parts = self._boundaries(tape), list[dict[str, np.ndarray]]()
        before = {name: np.zeros(len(self._x)) for name in summed(outputs)}
        observed: Observation

        def rows_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
            nonlocal observed
            inside = boundaries[part.of_boundaries(boundaries)]
            wanted = dict(outputs) if len(inside) else {name: outputs[name] for name in before}
            observed = observe(wanted, inside)
            return observed.boundaries, observed.sub_steps

        for of_state in derivatives.jvp_parts(tape, changes, rows_of, entries):
            rows = observed.jvp(of_state, changes, before)
            if rows.keys() == outputs.keys():
                parts.append(rows)
        of_rows = {name: np.concatenate([rows[name] for rows in parts]) for name in outputs}
        return {name: (singles | of_rows)[name] for name in wanted}

    def _of_singles(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Derivatives (m,) of those outputs that are a single number of the whole."""
        return {}

    def objective(self, function: Cost) -> Objective:
        """A number of the whole motion as a function of x, with its derivatives by x.

        For ``scipy.optimize.minimize(run.objective(function), x, jac=True)``.

        Parameters
        ----------
        function : callable
            ``function(t, y)`` gives a number, and its derivatives by the outputs on which it
            depends: a dict of arrays by their names, as for `vjp`.

        Returns
        -------
        callable
            A function of x (m,) that gives the number and its derivatives (m,).

        Raises
        ------
        SceneError
            In its calls, if the function gives anything else; as of `vjp`.

        Examples
        --------
        The force on a body by which it is at a place at the end.

        >>> import numpy as np, fx_beam as fb
        >>> from scipy.optimize import minimize
        >>> def build(x):
        ...     scene = fb.Scene()
        ...     body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
        ...     scene.add_force(body.centre, x)
        ...     return scene, {"place": fb.Output("position", body.centre)}
        >>> run = fb.Response(build, dt=0.1, t_end=1.0)
        >>> def distance(t, y):
        ...     weights = np.zeros_like(y["place"])
        ...     weights[-1] = gap = y["place"][-1] - (1.0, 2.0)
        ...     return gap @ gap / 2, {"place": weights}
        >>> minimize(run.objective(distance), [0.0, 0.0], jac=True).x.round(6)
        array([2., 4.])
        """
        return Objective(self, function)

    def misfit(self, measured: Mapping[str, Any], scatter: Any = 1.0) -> Misfit:
        """Outputs less what was measured, as a function of x for least squares.

        For ``scipy.optimize.least_squares(misfit, x, jac=misfit.jacobian)``.

        Parameters
        ----------
        measured : dict of (n, ...) float
            Measured values by the names of outputs; NaN, or masked, where there are none.
        scatter : float or dict, optional
            Standard deviation of what was measured, or that of each by name: a number or an array.

        Returns
        -------
        callable
            A function of x (m,) that gives all deviations over their standard deviations (k,), with
            a method ``jacobian(x)`` (k, m).

        Raises
        ------
        SceneError
            For other names or shapes than those of the outputs, or a scatter that is not positive.

        Examples
        --------
        The mass of a body that is pushed.

        >>> import fx_beam as fb
        >>> from scipy.optimize import least_squares
        >>> def build(x):
        ...     scene = fb.Scene()
        ...     body = scene.add_body((0, 0), mass=x[0], inertia=1.0)
        ...     scene.add_force(body.centre, (1.0, 0.0))
        ...     return scene, {"place": fb.Output("position", body.centre)}
        >>> run = fb.Response(build, dt=0.1, t_end=1.0)
        >>> misfit = run.misfit({"place": run([2.0])[1]["place"]}, scatter=1e-3)
        >>> least_squares(misfit, [1.0], jac=misfit.jacobian).x.round(6)
        array([2.])
        """
        return Misfit(self, measured, scatter)

    def _begin_derivatives(self, what: str, outputs: Mapping[str, Output]) -> tuple[Any, ...]:
        """The tape of the last call, its derivatives, and those of all numbers by x.

        And what observes outputs at boundaries, and the only entries of states that these read.
        """
        model, tape, derivatives = self._followed(what)
        check_outputs(model, tape, outputs, why_no_sums(self._path))
        changes, entries = self._changes(), read_entries(model, outputs)
        self._warned = self._warned or warn_of_short_reversals(model, tape)
        # Forms are compiled beside the library, for which names wait.
        by_places = "X" in self._scenes.changing
        derivatives.set_slopes(by_places)
        refuse_others(changes, derivatives.names, "Response")
        forces = functools.partial(derivatives.constraint_forces, tape)
        given = model, tape, forces, entries, by_places
        observe = functools.partial(Observation, *given)
        return tape, derivatives, changes, observe, entries

    def _followed(self, what: str) -> tuple[Model, Tape, TapeDerivatives]:
        """The model of the last call, its tape, and the derivatives of this."""
        series = self._series
        if not series.tapes or series.tape is None:
            series.tapes = True
            self._motion(self._begun())
        prepared, tape = series.prepared, series.tape
        if prepared is None or tape is None:
            raise SceneError(
                f"Response.{what}: the steps of this motion were not compiled "
                f"({self.stats.solver}), and have no derivatives"
            )
        loop = prepared.loop
        assert loop is not None  # only it has a tape
        if self._of_tape is None or self._of_tape.problem is not loop.problem:
            way = "JVP" if what == "jacobian" else "VJP"
            self._of_tape = TapeDerivatives(loop.problem, way)
        return prepared.model, tape, self._of_tape

    def _boundaries(self, tape: Tape) -> np.ndarray:
        """Numbers of sub-steps before the rows of the last call."""
        return tape.boundaries(self._t)

    def _checked_weights(self, weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        what = "Response.vjp: weights"
        require(isinstance(weights, Mapping), what, weights, "a dict by names of outputs")
        given = {}
        for name in self._differentiable(weights, what):
            of, shape = f"{what}[{name!r}]", self._shapes[name]
            given[name] = values = array_of(weights[name], of)
            require(values.shape == shape, of, values.shape, f"of the shape {shape}")
            if not (is_finite := np.isfinite(values)).all():
                wrong = np.argwhere(~is_finite)[0]
                at = "".join(f"[{i}]" for i in wrong)
                when = f", at t = {self._t[wrong[0]]:.6g}" if shape else ""  # or a single number
                raise SceneError(
                    f"{of}{at} is no finite number{when}. Give rows without one, such as those "
                    "that were not measured, the weight 0"
                )
        return given

    def _differentiable(self, names: Iterable[str], what: str) -> dict[str, Output]:
        """Outputs by names; SceneError for functions."""
        given = list(names)
        ok = all(is_one_of(name, self._outputs) for name in given)
        require(ok, what, given, f"names of outputs, of {self._names}")
        outputs: dict[str, Output] = {}
        for name in given:
            output = self._outputs[name]
            if not isinstance(output, Output):
                raise SceneError(
                    f"{what}: the output {name!r} is a function of the solution, which has no "
                    "derivatives; take an fx_beam.Output"
                )
            outputs[name] = output
        return outputs

    # -- Differences of the numbers of scenes -----------------------------------------------------

    def _changes_by_x(self) -> dict[str, np.ndarray]:
        tape, start = self._series.tape, None
        assert tape is not None  # `_followed` comes first
        # Without derivatives of the equilibrium before, differences compute it for other x.
        if self._path is not None and not why_not(self._path):
            start = StaticDerivatives(self._path).change_of_end(self._derivatives, "Response")
        first = self._options.dt if self._options.tolerance is None else tape.first_length
        given = tape, first, start, self._accelerations_by_x(first)
        return self._derivatives(functools.partial(self._numbers_of, *given))

    def _accelerations_by_x(self, first: float) -> np.ndarray | None:
        """Changes (m, size) of those at the start, by a very short step; None if not from rest."""
        (model, _, derivatives), prepared = self._followed("vjp"), self._series.prepared
        moving = model.scene.velocities, model.couplings.driven, self._start is not None
        other_steps = self._options.tolerance is not None or len(model.scheme.fractions) > 1
        of = [output for output in self._outputs.values() if isinstance(output, Output)]
        # Round-off of the rates of natural strains would be large in such a step.
        unfit = any(moving) or other_steps or model.natural
        if unfit or not any(map(observes_start, of)):
            return None
        assert prepared is not None  # it has the model
        tape, short = Tape(derivatives.problem), _INSTANT * first
        with stats_unchanged(prepared.stats):
            state = prepared.first_state(short, None, accelerations=False)
            if prepared.stepper.trial(state, state.t + short, tape=tape).state is None:
                return None  # such a step may fail with unknowns that have no mass
        of_step = functools.partial(self._numbers_of_steps, tape, short, None, False)
        changes = self._derivatives(lambda *given: of_step(*given)[2])
        rates = derivatives.jvp(tape, changes, np.ones(1, int))["v"][0]
        return np.where(model.massless, 2, 1) * rates / short  # those are means

    def _numbers_of_steps(
        self, tape: Tape, first: float, start: Any, at_start: bool, given: Scene, change: Any
    ) -> tuple[Prepared, State, dict[str, Any]]:
        """Another scene, prepared, with its first state; numbers of the steps and of this state."""
        other, t0 = self._prepared(given, change), tape.times.starts
        model, t1 = other.model, tape.times.ends
        if start is None:
            before = self._start_of(given)
            if isinstance(change, Dual) and other.smooths_start(before):
                raise TypeError("a start that is found by a step has no slopes")
            state = other.first_state(first, before, at_start)
        else:
            state = other.state_from(start.at(model.data, floats(change)), first, at_start)
        numbers: dict[str, Any] = numbers_in_steps(model, model.data, state, t0, t1)
        if self._start is None and isinstance(change, Dual):
            if model.natural:
                numbers["natural"] = model.natural.numbers_at(state.t)
            numbers["v"] = rates_with_slopes(
                model, other.forcing, state, first, numbers, change.count
            )
        if start is not None and isinstance(change, Dual):
            changed = numbers_of_state(model.data, start.at(model.data, change))
            for name, values in changed.items():
                if isinstance(values, Dual):
                    numbers[name] = Dual(floats(numbers[name]), values.slopes)
        return other, state, numbers

    def _numbers_of(
        self, tape: Tape, first: float, start: Any, a_by_x: Any, given: Scene, change: Any
    ) -> dict[str, Any]:
        """Numbers of steps and state for another scene, and of outputs that have rates.

        Accelerations have the changes `a_by_x` (m, size) as their slopes.
        """
        of = [output for output in self._outputs.values() if isinstance(output, Output)]
        at_start = any(map(observes_start, of))
        other, state, numbers = self._numbers_of_steps(tape, first, start, at_start, given, change)
        if not any(observes_rates(other.model, output) for output in of):
            return numbers
        rates = rates_at(tape, np.arange(len(tape) + 1))
        numbers |= observed_numbers_of(other.model, other.model.data, state, *rates, at_start)
        if a_by_x is not None and isinstance(change, Dual):
            # Nodes without mass have none by definition, but those that others carry.
            has = ~other.model.massless | (state.a != 0)
            numbers["a"] = Dual(state.a, a_by_x.T * has[:, None])
        return numbers

    def _prepared(self, given: Scene, change: Any) -> Prepared:
        """What is prepared as the motion is, with the numbers of another scene, but no loop.

        Of the last scene it is that of the motion, if it has slopes.
        """
        # Without slopes it may be a scene that all calls share, with other numbers since.
        same = given is self._scene and isinstance(change, Dual)
        if same and (last := self._series.prepared):
            return last
        scene = with_functions(given, self._options.inputs, "Response: inputs")
        return self._series.alike(scene, self._options)
