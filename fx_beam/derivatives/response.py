"""A motion as a function of parameters, with derivatives, costs and misfits."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import (
    SceneError,
    all_of,
    array_of,
    check_takes,
    is_one_of,
    is_whole,
    positive,
    real_array,
    require,
    shown,
)
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.motion_setup import Options
from fx_beam.results.solution import Solution
from fx_beam.scene.coordinate import SmoothFriction
from fx_beam.scene.outputs import Measured, Output, Read, check_differentiable, check_output
from fx_beam.scene.scene import Scene
from fx_beam.step.interrupts import Threads
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record
from fx_beam.step.tape import LIMIT, Part, Tape
from fx_beam.step.tape_derivatives import Weights

from .analysis import Analysis, MotionAnalysis, why_no_sums
from .observation import (
    Observation,
    Outputs,
    Wanted,
    check_outputs,
    is_at_node,
    read_entries,
    summed,
)
from .parametrised import ParameterFunction, Parametrised, along, one_call, refuse_others

# -- Costs and misfits as functions of parameters, with derivatives, for optimisers -------------


#: ``function(t, y)`` gives a value, and its derivatives by outputs, by name.
Cost = Callable[[np.ndarray, dict[str, np.ndarray]], tuple[float, Mapping[str, np.ndarray]]]


class Objective:
    """A number of a whole motion, and its derivatives by x."""

    def __init__(self, run: Response, function: Cost):
        check_takes(function, "t, y", "objective: function")
        self._run, self._function = run, function

    def __call__(self, x: ArrayLike) -> tuple[float, np.ndarray]:
        """The value, and its derivatives (m,) by x."""
        result = self._function(*self._run(x))
        ok = isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Mapping)
        if not ok or real_array(result[0]).shape:
            raise SceneError(
                "objective: function(t, y) must give a number and its derivatives by outputs, a "
                f"dict of arrays by names, not {shown(result)}"
            )
        return float(result[0]), self._run.vjp(result[1])


def _measured(rows: ArrayLike, name: str) -> np.ndarray:
    if isinstance(rows, np.ma.MaskedArray):
        rows = np.ma.filled(rows.astype(float), np.nan)
    values = array_of(rows, name)
    require(not np.isinf(values).any(), name, rows, "finite, or NaN where nothing was measured")
    return values


def _scatter(scatter: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    values = array_of(scatter, name)
    require(bool((np.isfinite(values) & (values > 0)).all()), name, scatter, "positive")
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        raise SceneError(
            f"{name} has the shape {values.shape}, which does not fit {shape}"
        ) from None


class Misfit:
    """Outputs less what was measured, over the scatter of this, as one vector."""

    def __init__(
        self,
        run: Response,
        last_x: Callable[[], np.ndarray],
        measured: Mapping[str, ArrayLike],
        scatter: ArrayLike | Mapping[str, ArrayLike],
    ):
        subject = "misfit: measured"
        ok = isinstance(measured, Mapping) and len(measured) > 0
        require(ok, subject, measured, "a dict of arrays by names of outputs")
        self._run, self._last_x, pairs = run, last_x, measured.items()
        self._measured = {name: _measured(rows, f"{subject}[{name!r}]") for name, rows in pairs}
        scatters = scatter if isinstance(scatter, Mapping) else dict.fromkeys(measured, scatter)
        same_names = scatters.keys() == measured.keys()
        require(same_names, "misfit: scatter", scatter, f"a number, or for each of {[*measured]}")
        self._scatter = {
            name: _scatter(scatters[name], rows.shape, f"misfit: scatter of {name!r}")
            for name, rows in self._measured.items()
        }

    def __call__(self, x: ArrayLike) -> np.ndarray:
        """Deviations (n,); zero where nothing was measured, which is NaN."""
        (_, y), parts = self._run(x), list[np.ndarray]()
        self._check_shapes(y)
        for name, rows in self._measured.items():
            deviations = (y[name] - rows) / self._scatter[name]
            parts.append(np.where(np.isnan(rows), 0.0, deviations).ravel())
        return np.concatenate(parts)

    def jacobian(self, x: ArrayLike) -> np.ndarray:
        """Derivatives (n, m) of deviations by x; without a motion if the last one was that of x."""
        if not np.array_equal(self._last_x(), x):
            self(x)
        J, parts = self._run.jacobian(*self._measured), []
        self._check_shapes({name: slopes[..., 0] for name, slopes in J.items()})
        for name, rows in self._measured.items():
            scaled = J[name] * np.where(np.isnan(rows), 0.0, 1 / self._scatter[name])[..., None]
            parts.append(scaled.reshape(-1, scaled.shape[-1]))
        return np.concatenate(parts)

    def _check_shapes(self, y: Mapping[str, np.ndarray]) -> None:
        """SceneError if outputs have other names or shapes than what was measured."""
        for name, rows in self._measured.items():
            require(name in y, "misfit: measured", [*self._measured], f"names of {[*y]}")
            ok = rows.shape == y[name].shape
            require(ok, f"misfit: measured[{name!r}]", rows.shape, f"of shape {y[name].shape}")


# -- Warning of friction whose rate reverses in too few steps, which their derivatives do not see


_log = logging.getLogger("fx_beam")
# Steps with a smaller rate than this part of the speed that derivatives need.
_NEEDED, _SMALL = 3, 2.0
# Configurations that are looked at together.
_AT_ONCE = 2**12


def warn_of_short_reversals(model: Model, tape: Tape) -> bool:
    """Warn of the first reversal of smooth friction in too few steps; whether there is one.

    Friction that sticks knows the times of its reversals (step/tape_derivatives.py).
    """
    first = min(_first_reversals(model, tape), default=None)
    if first is None:
        return False
    step, slow_steps, owner, speed = first
    _log.warning(
        "Response: SmoothFriction of %s: at t = %.6g its rate reverses with %d steps below %g "
        "times its speed %g. Derivatives behind are those of these steps and depend on where they "
        "fall, by up to their own size, if there are less than %d. Take shorter steps, a larger "
        "speed, or Coulomb friction, whose derivatives know the times of reversals",
        *(owner, tape.times.ends[step], slow_steps, _SMALL, speed, _NEEDED),
    )
    return True


def _first_reversals(model: Model, tape: Tape) -> Iterator[tuple[int, int, str, float]]:
    """For each friction: last step before a reversal, number of slow steps, name, and speed."""
    frictions, X = [*_frictions(model.scene)], model.mesh.X.reshape(-1)
    present, lengths = tape.present, tape.times.lengths
    if model.scheme.rates.at_rest or not (frictions and tape.is_whole and len(lengths)):
        return
    paths = []
    for first in range(present.first, present.end, _AT_ONCE):
        rows = np.arange(first, min(first + _AT_ONCE, present.end) + 1)
        states = tape.states(rows, "q", "slides")

        def read(array: str, entries: np.ndarray, states: dict = states) -> np.ndarray:
            return X[entries] if array == "X" else states[array][:, entries]

        coordinates = [friction.coordinate(read) for friction in frictions]
        paths.append(np.diff(coordinates, axis=1))
    rates = np.concatenate(paths, axis=1) / lengths
    for friction, rate in zip(frictions, rates, strict=True):
        fast = np.flatnonzero(abs(rate) > _SMALL * friction.speed)
        a, b = fast[:-1], fast[1:]
        short = (rate[a] * rate[b] < 0) & (b - a <= _NEEDED)
        for i in np.flatnonzero(short)[:1]:
            yield int(a[i]), int(b[i] - a[i] - 1), friction.owner, friction.speed


class _Friction(NamedTuple):
    """Friction with the smooth sign of a rate: below the speed it is viscous."""

    #: What of the scene it belongs to, as text.
    owner: str
    speed: float
    #: Its coordinate, as a sum of outputs with weights.
    terms: list[tuple[float, Measured]]

    def coordinate(self, read: Read) -> np.ndarray:
        """Values (n,) of the coordinate in n states."""
        return sum(weight * measured.values(read) for weight, measured in self.terms)


def _frictions(scene: Scene) -> Iterator[_Friction]:
    """All friction with the smooth sign of a rate."""
    quantities = {"slide": "slide", "rotation": "angle"}
    for joint in scene.joints:
        for name, coordinate in joint.coordinates.items():
            if isinstance(friction := coordinate.friction, SmoothFriction):
                terms = [(1.0, Measured(Output(quantities[name], joint)))]
                yield _Friction(f"joint {joint.number} {name}", float(friction.speed), terms)
    for gear in scene.gears:
        if isinstance(friction := gear.friction, SmoothFriction):
            outputs = [(term, Output(quantities[term.name], term.joint)) for term in gear.terms]
            terms = [(float(term.weight), Measured(output)) for term, output in outputs]
            yield _Friction(str(gear), float(friction.speed), terms)
    for line in scene.forces_between:
        if isinstance(friction := line.on.friction, SmoothFriction):
            terms = [(1.0, Measured(Output("length", line)))]
            yield _Friction(str(line), float(friction.speed), terms)


# -- A motion as a function of parameters: a scene is built for each, and only its data are set -


# Growth of derivatives towards the start above which they say little about the motion.
_USEFUL_GROWTH = 1e6
_CHAOTIC = (
    "Response.vjp: towards the start the derivatives grow %.1e times: the motion is chaotic, or "
    "has vibrations that the step does not resolve. They are exact for these steps, but tell only "
    "of tiny changes. Use a shorter time, or EnergyDecaying"
)
# Largest number of threads.
_MOST = 1000
#: Times or load factors (n,), and outputs (n, ...) by name.
Rows = tuple[np.ndarray, dict[str, np.ndarray]]
#: A function of parameters (m,) that gives a scene and its outputs by name.
Build = Callable[[np.ndarray], tuple[Scene, Mapping[str, Wanted]]]


class Response(ParameterFunction):
    """The motion of a scene as a function of parameters.

    ``t, y = run(x)`` builds the scene of the parameters x and simulates it. The first call sets the
    scene up; the next calls only set its data: all that is given as a number, a position, or a
    function of time or place. Results are those of `simulate` to the last digit, unless your
    functions round differently for arrays or, after derivatives, for dual numbers. A scene with
    other beams, elements, joints, supports or kinds of loads is set up anew, and so is a scene
    whose functions in UFL give another expression; the value of a `Parameter` does not change an
    expression. ``run.stats.setup_reason`` says why.

    Several threads may call a response, also through its objectives. Derivatives and `stats` are
    those of the last call in the same thread, whatever other threads call meanwhile. A thread that
    has made no call reads those of the thread that made the first call of all, and waits while that
    thread uses the response. The threads call `build`, and the functions of its scenes, at the same
    time. `map` does this for a table of parameters.

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
        Steps that are chosen by their errors, as in `simulate`. Each call then has times of its
        own; `record` with `times` gives the outputs at the same times in each call.
    start : Solution or callable, optional
        Solution whose end is the initial state; or ``start(scene)``, which computes it, such as
        ``lambda scene: fb.static(scene)``.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_halvings : int
        How often a failing step is halved.
    record : Record, optional
        Rows of the outputs, by `every` or `times`; by default all steps. Quantities that no output
        needs are not recorded. Velocities at `times` are interpolated by polynomials; their
        derivatives are those of the steps.
    inputs : dict, optional
        Functions of time of the inputs of the scene, as in `simulate`.
    memory : float
        Memory for the steps that derivatives follow [bytes]. If a motion needs more, only the
        states at some steps are stored, and increments in half of the memory. Derivatives then
        repeat the other steps to the last digit, without iterations where the increment is stored.
        Each thread uses this memory.

    Attributes
    ----------
    stats : Stats
        Statistics of the last run.

    Raises
    ------
    SceneError
        If `build` is no function; in a call if x has values that are not finite, or if `build` does
        not give a scene with outputs of the same names as before.

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
        inputs: Mapping[str, object] | None = None,
        memory: float = LIMIT,
    ):
        check_takes(build, "x", "Response: build")
        if callable(start):
            check_takes(start, "scene", "Response: start")
        memory = positive(memory, "Response: memory", "a positive number of bytes")
        options = Options.among(locals(), what="Response", progress=False)
        if options.record.file is not None:
            raise SceneError("Response: a record to a file is not possible; use simulate")
        self._begin(build, functools.partial(MotionAnalysis, options, start, memory))

    #: What a call gives, for messages.
    _gives = "motion"

    def _begin(self, build: Callable, analysis: Callable[[Parametrised], Analysis]) -> None:
        """Know of no call yet; copies and pickles begin with the same arguments."""
        super()._begin(build, analysis)
        self._parameters = Parametrised(
            build,
            self._read,
            self._gives,
            lambda *numbers: self._analysis.numbers_of_outputs(*numbers),
        )
        self._analysis = analysis(self._parameters)
        #: Names of the outputs, from the first scene on.
        self._names: list[str] = []
        self._changes: dict[str, np.ndarray] | None = None
        # Whether there was a warning of friction that reverses in too few steps.
        self._warned = False

    def _read(self, built: Any) -> tuple[Scene, dict[str, Wanted]]:
        """The scene and its outputs that `build` gave; SceneError if it gave something else."""
        ok = isinstance(built, tuple) and len(built) == 2
        if not ok or not isinstance(built[0], Scene) or not isinstance(built[1], dict | Mapping):
            raise SceneError(f"Response: build must give a scene and outputs, not {shown(built)}")
        scene, outputs = built[0], dict(built[1])
        names = [*outputs]
        require(bool(names), "Response: outputs", outputs, "at least one output by name")
        for name, output in outputs.items():
            if is_at_node(output, scene):
                continue
            subject = f"Response: the output {name!r}"
            if isinstance(output, Output):
                check_output(scene, output, subject)
                check_differentiable(output, subject)
            else:
                expected = "an fx_beam.Output, or a function of the solution"
                require(callable(output), subject, output, expected)
                check_takes(output, "solution", subject)
        self._names = self._names or names
        if names != self._names:
            require(False, "Response: outputs", names, f"as in the first call, {self._names}")
        return scene, outputs

    @one_call
    def __call__(self, x: ArrayLike) -> Rows:
        """Run the scene of some parameters.

        Parameters
        ----------
        x : (m,) float
            The parameters that `build` takes.

        Returns
        -------
        t : (n,) float
            Times [s], or load factors.
        y : dict of (n, ...) float
            The outputs by name.
        """
        values, self._changes = self._parameters.check_x(x), None
        t, y = self._analysis.run(values)
        self._shapes = {name: rows.shape for name, rows in y.items()}
        self._parameters.x = values
        return t, y

    def map(self, X: ArrayLike, threads: int | None = None) -> list[Rows | Exception]:
        """Run the scenes of many parameters, several at a time.

        All cases share one compiled program, and each thread has memory of its own. If the response
        was not called before, the first case runs alone, as it compiles for all. Derivatives and
        `stats` remain those of the last call of the response.

        Parameters
        ----------
        X : (k, m) float
            The parameters of each case.
        threads : int, optional
            Number of threads of this process; by default all cases run in the calling thread. The
            threads call `build`, and functions of the scenes, at the same time.

        Returns
        -------
        list of (t, y), or exceptions
            The result of a call for each case, in the order of `X`; for a case that fails its
            exception.

        Raises
        ------
        SceneError
            If `X` is no table of numbers, or `threads` no whole number from 1 on.
        KeyboardInterrupt
            If interrupted, after the cases that were running have ended.

        Examples
        --------
        Where a body is after a second, by its mass; a mass below zero is refused.

        >>> import fx_beam as fb
        >>> def build(x):
        ...     scene = fb.Scene()
        ...     body = scene.add_body((0, 0), mass=x[0], inertia=1.0)
        ...     scene.add_force(body.centre, (1.0, 0.0))
        ...     return scene, {"place": fb.Output("position", body.centre, "x")}
        >>> run = fb.Response(build, dt=0.1, t_end=1.0)
        >>> *cases, failed = run.map([[1.0], [2.0], [-1.0]], threads=2)
        >>> [round(float(y["place"][-1]), 3) for t, y in cases], type(failed).__name__
        ([0.5, 0.25], 'SceneError')
        """
        cases = array_of(X, "Response.map: X")
        require(cases.ndim == 2, "Response.map: X", X, "a table (k, m), a row for each case")
        ok = threads is None or is_whole(threads, 1, _MOST)
        require(ok, "Response.map: threads", threads, f"a whole number from 1 to {_MOST}")
        first = 0 if len(self._last_x()) else 1
        call = functools.partial(_called, self._twin())
        results = [call(x) for x in (cases if threads is None else cases[:first])]
        if threads is not None:
            with Threads(int(threads)) as executor:
                results += executor.map(call, cases[first:])
        return results

    @one_call
    def vjp(self, weights: Mapping[str, np.ndarray]) -> np.ndarray:
        """Derivatives of a sum of weights times outputs of the last call, by all parameters.

        By the adjoint method: the derivatives of the computed steps by the data of the scene, exact
        to round-off, times the derivatives of these data by x, which `build` gives for dual
        numbers, or differences of `build` (`stats.difference_reason` says why). Where slip with
        `Coulomb` friction reverses within a few steps, the derivative of the time of the reversal
        is used in the place of that of the steps. No motion is repeated.

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
        subject, analysis = "Response.vjp: weights", self._analysis
        require(isinstance(weights, Mapping), subject, weights, "a dict by names of outputs")
        singles, outputs = self._chosen(weights, subject)
        checked = {name: self._checked(weights, name) for name in (*singles, *outputs)}
        gradient = np.zeros(len(self._parameters.x))
        forwards = [*checked] if analysis.forwards else singles
        for name, rows in self.jacobian(*forwards).items() if forwards else ():
            gradient += np.tensordot(checked[name], rows, checked[name].ndim)
        if analysis.forwards or not outputs:
            return gradient
        tape, derivatives, changes, observe, entries = self._begin_derivatives("vjp", outputs)
        boundaries = analysis.boundaries(tape)
        changing = {*self._parameters.scenes.changing, "hold"} & changes.keys()
        # In an order that all processes share: so do the last digits of sums.
        number_slopes = {name: np.zeros(changes[name].shape[1:]) for name in sorted(changing)}
        counting = np.zeros(len(analysis.t), dtype=bool)  # others need no states, nor fitted rates
        for name in outputs:
            counting |= checked[name].reshape(len(counting), -1).any(axis=1)

        def weights_of(part: Part) -> Weights:
            inner, is_later = part.of_boundaries(boundaries), boundaries > part.end
            inner = inner[counting[inner]]
            later = {name: float(checked[name][is_later].sum()) for name in summed(outputs)}
            if not (len(inner) or any(later.values())):
                return {}, boundaries[:0], boundaries[:0]
            chosen = dict(outputs) if len(inner) else {name: outputs[name] for name in later}
            observed = observe(chosen, boundaries[inner])
            part_weights = {name: checked[name][inner] for name in chosen}
            state_slopes = observed.vjp(part_weights, later, number_slopes)
            return state_slopes, observed.boundaries, observed.sub_steps

        step_slopes = derivatives.vjp(tape, weights_of, changing, entries)
        self.stats.gradient_growth = growth = derivatives.growth
        if growth > _USEFUL_GROWTH:
            _log.warning(_CHAOTIC, growth)
        for name, slopes in step_slopes.items():
            number_slopes[name] += slopes.reshape(number_slopes[name].shape)
        parts = (along(changes[name], slopes) for name, slopes in number_slopes.items())
        return sum(parts, gradient)

    @one_call
    def jacobian(self, *names: str) -> dict[str, np.ndarray]:
        """Derivatives of outputs of the last call by all parameters, at all times.

        By forward sensitivities: the derivatives of the computed steps by the data of the scene,
        exact to round-off, times the derivatives of these data by x, which one call of `build` with
        dual numbers gives. Slip that reverses within a few steps is treated as in `vjp`.

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
        names, analysis = names or tuple(self._names), self._analysis
        singles, outputs = self._chosen(names, "Response.jacobian: names")
        jacobian = dict.fromkeys(singles, analysis.of_single()) if singles else {}
        if not outputs:
            return jacobian
        tape, derivatives, changes, observe, entries = self._begin_derivatives("jacobian", outputs)
        boundaries, parts = analysis.boundaries(tape), list[dict[str, np.ndarray]]()
        earlier = {name: np.zeros(len(self._parameters.x)) for name in summed(outputs)}
        observed: Observation

        def rows_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
            nonlocal observed
            inner = boundaries[part.of_boundaries(boundaries)]
            chosen = dict(outputs) if len(inner) else {name: outputs[name] for name in earlier}
            observed = observe(chosen, inner)
            return observed.boundaries, observed.sub_steps

        for state_changes in derivatives.jvp_parts(tape, changes, rows_of, entries):
            rows = observed.jvp(state_changes, changes, earlier)
            if rows.keys() == outputs.keys():
                parts.append(rows)
        jacobian |= {name: np.concatenate([rows[name] for rows in parts]) for name in outputs}
        for name, length_slopes in analysis.of_length(outputs).items():
            jacobian[name] += length_slopes
        return {name: jacobian[name] for name in names}

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
            When it is called, if the function does not give a number and a dict; and in the cases
            of `vjp`.

        Examples
        --------
        The force by which a body arrives at a given place at the end.

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
            Standard deviation of the measured values, for all outputs or by their names: a number
            or an array.

        Returns
        -------
        callable
            A function of x (m,) that gives all deviations over their standard deviations (k,), with
            a method ``jacobian(x)`` (k, m).

        Raises
        ------
        SceneError
            For names or shapes that the outputs do not have, or a scatter that is not positive.

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
        return Misfit(self, self._last_x, measured, scatter)

    def _begin_derivatives(self, method: str, outputs: Outputs) -> tuple[Any, ...]:
        """The tape of the last call, the derivatives of its steps, and of all numbers by x.

        Also a function that observes outputs at boundaries, and the only entries that it reads.
        """
        model, tape, derivatives = self._analysis.tape_of_last_run(method)
        check_outputs(model, tape, outputs, why_no_sums(self._analysis.path))
        if self._changes is None:
            self._changes = self._analysis.changes()
        changes, entries = self._changes, read_entries(model, outputs)
        self._warned = self._warned or warn_of_short_reversals(model, tape)
        # Forms are compiled beside the library, for which names wait.
        has_places = "X" in self._parameters.scenes.changing
        derivatives.set_slopes(has_places)
        refuse_others(changes, derivatives.names, "Response")
        forces = functools.partial(derivatives.constraint_forces, tape)
        numbers = self._analysis.known_numbers()
        observe = functools.partial(Observation, model, tape, forces, entries, has_places, numbers)
        return tape, derivatives, changes, observe, entries

    def _checked(self, weights: Mapping[str, np.ndarray], name: str) -> np.ndarray:
        """The weights of an output, finite and of its shape; SceneError otherwise."""
        entry, shape = f"Response.vjp: weights[{name!r}]", self._shapes[name]
        values = array_of(weights[name], entry)
        require(values.shape == shape, entry, values.shape, f"of the shape {shape}")
        if not all_of(is_finite := np.isfinite(values)):
            index = np.argwhere(~is_finite)[0]
            place = "".join(f"[{i}]" for i in index)
            # A single number has no time.
            time_text = f", at t = {self._analysis.t[index[0]]:.6g}" if shape else ""
            raise SceneError(
                f"{entry}{place} is no finite number{time_text}. Give rows without one, such "
                "as those that were not measured, the weight 0"
            )
        return values

    def _chosen(self, names: Iterable[str], subject: str) -> tuple[list[str], dict[str, Measured]]:
        """Names of single numbers, and the other outputs by names; SceneError for functions."""
        names, known, analysis = list(names), self._analysis.outputs, self._analysis
        are_known = all(is_one_of(name, known) for name in names)
        require(are_known, subject, names, f"names of outputs, of {self._names}")
        singles, outputs = list[str](), dict[str, Measured]()
        for name in names:
            output = known[name]
            if not isinstance(output, Output):
                raise SceneError(
                    f"{subject}: the output {name!r} is a function of the solution, which has no "
                    "derivatives; take an fx_beam.Output"
                )
            if output.quantity == analysis.single:
                singles.append(name)
            else:
                outputs[name] = analysis.measured_by_name[name]
        return singles, outputs


def _called(run: Response, x: np.ndarray) -> Rows | Exception:
    """What a response gives for some parameters, or why it fails."""
    try:
        return run(x)
    except Exception as error:  # noqa: BLE001  # a case that fails is alone
        return error
