"""Scenes as functions of parameters: how they are built, and derivatives by their numbers."""

from __future__ import annotations

import copy
import functools
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from threading import Lock, RLock, local
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.dual import Dual, LinearChanges, LostSlopesError, changes_of, floats, slopes_by
from fx_beam.errors import SceneError, all_of, any_of, real_array, require, shown
from fx_beam.motions.motion_setup import OF_STEPS, are_of_outputs
from fx_beam.results.records import Stats
from fx_beam.scene.functions import BUILDING, ArrayCalls
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.fitted_rates import Arrays

# -- Local derivatives of outputs: followed backwards and forwards by the same blocks -----------


#: Arrays by name, some of which may have slopes.
DualArrays = dict[str, np.ndarray | Dual]
#: Entries of an array, or places of rows in it.
Chosen = slice | np.ndarray


class DerivativeBlock(NamedTuple):
    """Derivatives (k, e) of an output in rows (k,) by entries of states, forces or numbers."""

    name: str
    #: The entries of each state, or of all numbers of the name, flat: a slice or an array (e,).
    entries: Chosen
    #: Rows of the output in their order.
    rows: np.ndarray
    derivatives: np.ndarray
    #: Places (k,) among the states, forces or sub-steps, each at most once; None for numbers that
    #: do not have a row for each sub-step.
    places: Chosen | None = None
    #: The component that depends on the entries, or (e,) that on each of them, or their slice.
    part: int | Chosen = 0

    def times(self, factor: float) -> DerivativeBlock:
        """Block of a multiple of the output."""
        return self if factor == 1 else self._replace(derivatives=factor * self.derivatives)


def of_rows(
    name: str, rows: np.ndarray, values: np.ndarray, places: Chosen | None = None, first: int = 0
) -> DerivativeBlock:
    """Derivatives (k, ...) of rows by all entries of states, or of numbers, from the `first` on."""
    slopes = values.reshape(len(rows), -1)
    return DerivativeBlock(name, slice(first, first + slopes.shape[1]), rows, slopes, places)


def of_names(rows: np.ndarray, derivatives: Mapping[str, np.ndarray]) -> Iterator[DerivativeBlock]:
    """Blocks of derivatives (k, ...) of rows by all entries, by name."""
    return (of_rows(name, rows, values) for name, values in derivatives.items() if values.size)


def vjp(blocks: Iterable[DerivativeBlock], weights: np.ndarray, gradient: Gradient) -> None:
    """Add the derivatives of the sum of weights (n, ...) times an output."""
    weights = weights[:, None] if weights.ndim == 1 else weights
    for name, entries, rows, derivatives, places, part in blocks:
        weight_rows = rows if isinstance(part, slice) else rows[:, None]
        gradient.add(name, entries, places, weights[weight_rows, part] * derivatives)


def jvp(
    blocks: Iterable[DerivativeBlock],
    shape: tuple[int, ...],
    state_changes: Arrays,
    changes: Arrays,
) -> np.ndarray:
    """Changes (*shape, m) of an output from those of states (n, m, ...) and numbers (m, ...)."""
    count = len(changes["X"])
    total = np.zeros((shape[0], *(shape[1:] or (1,)), count))
    for name, entries, rows, derivatives, places, part in blocks:
        if places is None:
            change = changes[name].reshape(count, -1)[:, entries]
            if not any_of(change):
                continue
        else:  # without states, numbers with a row for each sub-step
            change = state_changes[name] if name in state_changes else changes[name].swapaxes(0, 1)
            change = change.reshape(len(change), count, -1)[..., entries][places]
        if isinstance(part, int):  # row by row: to the last digit the same, however many there are
            values = (change @ derivatives[..., None])[..., 0]
        else:
            values = (change * derivatives[:, None]).swapaxes(1, 2)
        if any_of(rows[1:] == rows[:-1]):
            first = np.flatnonzero(np.diff(rows, prepend=-1))
            rows, values = rows[first], np.add.reduceat(values, first)
        total[rows[:, None] if isinstance(part, np.ndarray) else rows, part] += values
    return total.reshape(*shape, count)


class Gradient:
    """Derivatives by states and forces of a run, and by numbers of its scene.

    `sizes` has the numbers of states or forces, and of the values in each, by name. Derivatives by
    numbers are added to those of other parts of the run, `number_slopes`; others are left out.
    """

    def __init__(self, sizes: Mapping[str, tuple[int, ...]], number_slopes: Arrays):
        self._sizes, self._number_slopes = sizes, number_slopes
        #: Derivatives by states and forces (n, size), by name.
        self.state_slopes: dict[str, np.ndarray] = {}

    def derivative_by(self, name: str) -> np.ndarray:
        """Derivatives by all states or forces of a name, to which one adds."""
        if name not in self.state_slopes:
            self.state_slopes[name] = np.zeros(self._sizes[name])
        return self.state_slopes[name]

    def add(self, name: str, entries: Chosen, places: Chosen | None, values: np.ndarray) -> None:
        """Add derivatives (k, e) by entries, as those of a `DerivativeBlock`."""
        if places is not None and name in self._sizes:
            target = self.derivative_by(name)
        elif name in self._number_slopes:
            target = self._number_slopes[name]
        else:
            return
        if places is None:
            target.reshape(-1)[entries] += values.sum(axis=0)
        elif isinstance(entries, slice):
            target.reshape(len(target), -1)[:, entries][places] += values
        else:
            rows = np.arange(len(target))[places]
            target.reshape(len(target), -1)[rows[:, None], entries] += values


def along(changes: np.ndarray | LinearChanges, gradient: np.ndarray) -> np.ndarray:
    """Products (m,) of changes (m, ...) and a gradient."""
    if isinstance(changes, LinearChanges):
        return changes.along(np.ravel(gradient))
    # Without a copy where slopes are side by side, as of dual numbers.
    slopes = changes.transpose(*range(1, changes.ndim), 0)
    return np.ravel(gradient) @ slopes.reshape(-1, len(changes))


# -- The scenes that a function builds of numbers, and derivatives of what they are made of -----


#: Arrays by name, some of which may be dual: a function of the scene, and of the change of x (m,).
NumbersOf = Callable[[Scene, Any], dict[str, Any]]
_Result = TypeVar("_Result")

_log = logging.getLogger("fx_beam")
_INACCURATE = (
    "Response: derivatives by x[%d] at %s may have errors of %.1g of their size: two steps of the "
    "differences of `build` differ by so much in %r of the scene. Look there for values that jump, "
    "have kinks, or are known to a few digits only"
)
# Exponent of the step in differences of `build`, relative to a number: wide, to keep round-off
# small. On a line two numbers are enough; else four are combined, with an error of fourth order.
_STEP = -12
# A smaller number counts as zero, with the step of the number 1.
_ZERO = 1e-100
# Half of the step may change a derivative by this part of it, else the step is shortened; the error
# is about the square. How often it is shortened, and by which power of two at most.
_BENT, _TRIES, _SHORTER = 1e-5, 8, 6
# Outputs at the start, which have slopes or differences by all of x.
_AT_START = {"a", "forces of columns", "forces of joints", "forces of lines"}
# Round-off of numbers, relative to them. Those that are themselves solutions or differences have
# more of it: for these the step is shortened only if the difference is larger.
_NOISE, _COMPUTED = 1e-12, _AT_START | {"v", "driven rates"}
_MORE_NOISE, _MORE_BENT = 1e-9, 1e-2
# Differences of places have the round-off of places, however small they are: parts without mass
# find their balance beside a damper where they are. Of places, directions and what is computed the
# largest of a name tells the round-off; other numbers of one name may have different units.
_FROM_PLACES = {"offset", "rest", "slides", "q", "q previous"}
_ALIKE = _FROM_PLACES | _COMPUTED | {"X", "axis"}
# Error of numbers that depend on x along a line, relative to them.
_ROUNDING = 8 * np.finfo(float).eps
# Largest difference of the numbers of two scenes at the same x, relative to them.
_SAME = 1e-9
# Step of the difference by which slopes are checked, relative to x; errors of it, relative to the
# sizes of all terms; and round-off of numbers, relative to their size.
_CHECK_STEP, _AGREE, _FEW_DIGITS = 2.0**-20, 1e-4, 64 * np.finfo(float).eps
# Calls in which slopes are compared again: those that are lost may be zero at first.
_CHECKED = {3, 9, 65}


def refuse_others(changes: Mapping[str, np.ndarray], known: Set[str], subject: str) -> None:
    """SceneError if numbers change (m, ...) of which there are no derivatives."""
    for name in changes.keys() - known:
        if are_of_outputs([name]):
            continue
        changing = np.flatnonzero(changes[name].reshape(len(changes[name]), -1).any(axis=1))
        if len(changing):
            raise SceneError(
                f"{subject}: x[{changing[0]}] changes {name!r} of the scene, by which motions have "
                "no derivatives"
            )


class SceneGradient:
    """The scenes that a function gives for numbers, and derivatives of what they are made of."""

    def __init__(self, scene_at: Callable[[Any], Scene]):
        self._scene_at = scene_at
        # Numbers of which it was said that differences of `build` are inaccurate.
        self._told: set[int] = set()
        #: Why there are differences by some of the numbers, by their indices.
        self.reasons: dict[int, str] = {}
        # Names of the only numbers, which steps do not read, that have differences by some of x.
        self._names: dict[int, list[str]] = {}
        #: Names of the numbers of which the last derivatives are not all zero.
        self.changing: set[str] = set()
        # Whether derivatives were asked for after the last call; whether its scene has slopes.
        self._asked = self._is_dual = False
        # Shapes of all numbers, by name, and which of x were zero, for which slopes were checked.
        self._checked: list[tuple[dict[str, tuple[int, ...]], list[bool]]] = []
        # At how many x derivatives were asked for, and the last of them.
        self._calls, self._last_x = 0, np.empty(0)

    def serve(self, x: np.ndarray, compute: Callable[[Any], _Result], dual: bool) -> _Result:
        """Result of a function of the scene of x.

        The scene has slopes, and serves derivatives as well, if it may be `dual` and derivatives
        were asked for after the last call.
        """
        self._is_dual, self._asked = dual and self._asked and not self.reasons, False
        if self._is_dual:
            try:
                return compute(slopes_by(x))
            except Exception:  # noqa: BLE001  # whatever takes floats, and what is wrong with both
                self._is_dual = False
        return compute(x)

    @property
    def reason(self) -> str:
        """By which parameters derivatives are differences of `build`, and why; empty if by none."""
        return "; ".join(f"x[{i}]: {self.reasons[i]}" for i in sorted(self.reasons))

    def derivatives(
        self, x: np.ndarray, known: Scene, numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes; `known` is that at x."""
        self._calls += x is not self._last_x
        self._last_x = x
        # Before other scenes are built, which may change parts that they share with this one.
        earlier = {} if self._checked or self._is_dual else numbers_of(known, np.zeros(len(x)))
        values_at_x, by_name = self._slopes(x, known, numbers_of)
        for name, values in earlier.items():
            gap = abs(values_at_x[name] - values).max(initial=0.0)
            if gap > _SAME * abs(values).max(initial=0.0):
                raise SceneError(
                    f"Response: build gives other numbers than before at the same x: {name!r} of "
                    f"the scene differs by {gap:.2g}. They must depend on x alone"
                )
        kind = {name: values.shape for name, values in values_at_x.items()}, (x == 0).tolist()
        if kind not in self._checked or self._calls in _CHECKED:
            self._checked.append(kind)
            lost = {
                name for name in _AT_START & values_at_x.keys() if values_at_x[name].any()
            } - self.changing
            slopes_to_check = {name: by_name[name] for name in by_name.keys() - lost}
            self._check(x, values_at_x, slopes_to_check, numbers_of)
            for i in self._with_slopes(x) if lost else ():
                self.reasons.setdefault(i, f"the start has no slopes of {', '.join(sorted(lost))}")
                self._names[i] = sorted(lost.union(self._names.get(i, ())))
        for i in sorted(self.reasons):
            names = by_name.keys() & self._names.get(i, by_name.keys())
            differences = self._derivative(x, i, values_at_x, numbers_of) if names else {}
            self.changing |= differences.keys()
            for name in names:
                by_name[name] = rows = by_name[name].copy()  # which others may read
                rows[i] = differences.get(name, 0.0)
        self._asked = True
        return by_name

    def _with_slopes(self, x: np.ndarray) -> list[int]:
        """The parameters that have slopes, but for outputs."""
        return sorted({*range(len(x))} - (self.reasons.keys() - self._names.keys()))

    # -- By dual numbers ---------------------------------------------------------------------------

    def _slopes(
        self, x: np.ndarray, known: Scene, numbers_of: NumbersOf
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """The numbers of a scene, and slopes (m, ...) by those of x that have no `reasons`."""
        while len(lost := self.reasons.keys() - self._names.keys()) < len(x):
            try:
                dual = slopes_by(x, constant=lost)
                change = Dual(np.zeros(len(x)), dual.slopes)
                numbers = numbers_of(known if self._is_dual else self._scene_at(dual), change)
                break
            except Exception as error:  # noqa: BLE001  # whatever a function does that takes floats
                self._learn(error, {*range(len(x))} - lost)
                self._is_dual = False
        else:
            numbers = numbers_of(self._scene_at(x), np.zeros(len(x)))
        self.changing = {name for name, values in numbers.items() if isinstance(values, Dual)}
        by_name = {name: changes_of(values, len(x)) for name, values in numbers.items()}
        return {name: floats(values) for name, values in numbers.items()}, by_name

    def _learn(self, error: BaseException | None, parameters: set[int]) -> None:
        """Take differences by those parameters that an error says to have no slopes, or by all."""
        text = repr(error)
        while error is not None and not isinstance(error, LostSlopesError):
            error = error.__cause__ or error.__context__
        if isinstance(error, LostSlopesError) and error.numbers & parameters:
            text, parameters = str(error), error.numbers & parameters
        for i in parameters:
            self._names.pop(i, None)
            self.reasons.setdefault(i, text)

    def _check(
        self,
        x: np.ndarray,
        numbers: dict[str, np.ndarray],
        by_name: dict[str, np.ndarray],
        numbers_of: NumbersOf,
    ) -> None:
        """Take differences by x[i] from now on, where its slopes disagree with one difference.

        One difference along a change of all parameters shows whether there are any.
        """
        steps = _CHECK_STEP * np.where(abs(x) > _ZERO, x, 1.0)
        slope_indices = self._with_slopes(x)
        change, size = np.zeros(len(x)), np.random.default_rng(0).uniform(0.5, 1, len(x))
        change[slope_indices] = (size * steps)[slope_indices] * (-1.0) ** np.arange(
            len(slope_indices)
        )
        try:
            ends = [numbers_of(self._scene_at(x + step), step) for step in (-change, change)]
        except (SceneError, OtherStructureError):  # that of one number says it better
            ends = []
        if ends and not _wrong(change, ends, numbers, by_name):
            return
        for i in slope_indices:
            change = steps * (np.arange(len(x)) == i)
            ends = [self._moved(x, i, step, numbers_of) for step in (-steps[i], steps[i])]
            if wrong_names := _wrong(change, ends, numbers, by_name):
                text = ", ".join(map(repr, wrong_names))
                self.reasons[i] = f"it changes {text} of the scene in a way that has no slopes"
                self._names.pop(i, None)
                if are_of_outputs(wrong_names):
                    self._names[i] = wrong_names

    # -- By differences ----------------------------------------------------------------------------

    def _derivative(
        self, x: np.ndarray, i: int, numbers: dict[str, np.ndarray], numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Derivatives (...) by x[i] of those numbers that depend on it.

        If they are on no line, by four differences, whose step is shortened if need be.
        """
        size = x[i] if abs(x[i]) > _ZERO else 1.0
        h = 2.0 ** (np.frexp(size)[1] + _STEP)  # x + h is exact
        best: dict[str, tuple[float, np.ndarray]] = {}
        most = {name: _MORE_BENT if name in _COMPUTED else _BENT for name in numbers}
        sizes, worse, bent = dict[str, np.ndarray](), 0, dict[str, float]()
        for attempt in range(_TRIES):
            low, ahead = (self._moved(x, i, step, numbers_of) for step in (-h, h / 2))
            if not attempt:
                depend = [
                    name
                    for name, values in numbers.items()
                    if not (all_of(low[name] == values) and all_of(ahead[name] == values))
                ]
                if all(_on_a_line(name, low[name], numbers[name], ahead[name]) for name in depend):
                    return {name: (ahead[name] - low[name]) / (1.5 * h) for name in depend}
            back, high = (self._moved(x, i, step, numbers_of) for step in (-h / 2, h))
            for name in depend:
                if name in best and best[name][0] <= _BENT:
                    continue
                narrow, wide = (ahead[name] - back[name]) / h, (high[name] - low[name]) / (2 * h)
                sizes[name] = np.maximum(sizes.get(name, 0.0), _size(name, wide))
                noise = (_MORE_NOISE if name in _COMPUTED else _NOISE) * _values_of(name, ahead)
                gap = np.maximum(abs(narrow - wide) - noise / h, 0.0)
                bend, flat = _largest(gap, sizes[name]), not (narrow.any() or wide.any())
                if name not in best or (bend < best[name][0] and not flat):  # flat between jumps
                    best[name] = bend, narrow + (narrow - wide) / 3
            bent_before = bent
            bent = {name: bend for name, (bend, _) in best.items() if bend > most[name]}
            worse = worse + 1 if bent == bent_before else 0
            if not bent or worse == 2:
                break  # all is well, or round-off grows
            h *= 2.0 ** -int(np.clip(np.log2(max(bent.values()) / _BENT) / 2 + 1, 1, _SHORTER))
        if bent and i not in self._told:
            self._told.add(i)
            name = max(bent, key=bent.__getitem__)
            _log.warning(_INACCURATE, i, shown(x[i]), bent[name], name)
        return {name: values for name, (_, values) in best.items()}

    def _moved(
        self, x: np.ndarray, i: int, step: float, numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Numbers of the scene with a change of x[i]."""
        change = step * (np.arange(len(x)) == i)
        x_text, moved_text = shown(x[i]), shown(x[i] + step)
        try:
            scene = self._scene_at(x + change)
        except SceneError as error:
            raise SceneError(
                f"Response: no derivatives by x[{i}] at {x_text}, since there is no scene at "
                f"{moved_text}: {error}"
            ) from error
        try:
            return numbers_of(scene, change)
        except OtherStructureError as other:
            raise SceneError(
                f"Response: the scene at x[{i}] = {moved_text} has another structure than at "
                f"{x_text}: {other}. There are no derivatives at {x_text}"
            ) from None


def _wrong(
    change: np.ndarray,
    ends: list[dict[str, np.ndarray]],
    numbers: dict[str, np.ndarray],
    by_name: dict[str, np.ndarray],
) -> list[str]:
    """Names of numbers whose difference between the `ends` of a change disagrees with slopes."""
    wrong_names = []
    for name, slopes in by_name.items():
        known, sizes = np.tensordot(change, slopes, 1), np.tensordot(abs(change), np.abs(slopes), 1)
        error = abs((ends[1][name] - ends[0][name]) / 2 - known)
        if name in _AT_START:  # loads have begun in the short step that tells their slopes
            error = np.where(ends[1][name] == ends[0][name], 0.0, error)
        round_off = (1e4 if name in _COMPUTED else 1.0) * _FEW_DIGITS * _values_of(name, numbers)
        if not all_of(error <= _AGREE * _largest_over_time(name, sizes) + round_off):
            wrong_names.append(name)
    return sorted(wrong_names)


def _values_of(name: str, numbers: dict[str, np.ndarray]) -> np.ndarray:
    """Sizes of values that have the round-off of those of a name."""
    if name not in _ALIKE:
        return _largest_over_time(name, abs(numbers[name]))
    alike = [name, "X"] if name in _FROM_PLACES else [name]
    return np.max([abs(numbers[key]).max(initial=0.0) for key in alike])


def _largest_over_time(name: str, sizes: np.ndarray) -> np.ndarray:
    """Largest sizes over time of functions of it, and sizes of other numbers."""
    return sizes.max(axis=0) if name in OF_STEPS else sizes


def _size(name: str, values: np.ndarray) -> np.ndarray:
    """Sizes of derivatives, over time the largest, and none far below the largest of all."""
    sizes = _largest_over_time(name, abs(values))
    return np.maximum(sizes, 1e-3 * sizes.max(initial=0.0))


def _largest(gaps: np.ndarray, sizes: np.ndarray) -> float:
    """The largest of some gaps relative to sizes; these are zero only where both are."""
    part = np.divide(gaps, sizes, out=np.zeros(gaps.shape), where=sizes > 0)
    return float(part.max(initial=0.0))


def _on_a_line(name: str, low: np.ndarray, numbers: np.ndarray, ahead: np.ndarray) -> bool:
    """Whether numbers at x - h, x and x + h / 2 are those of a line, up to round-off."""
    size = _largest_over_time(name, np.maximum(abs(low), abs(ahead)))  # which tells the round-off
    return all_of(abs((low - numbers) + 2 * (ahead - numbers)) <= _ROUNDING * size)


# -- Scenes as a function of parameters: what all responses have, and their states by threads ---


_Method = TypeVar("_Method", bound=Callable)


def one_call(method: _Method) -> _Method:
    """A method of the state of its thread; all but `__call__` need a call before."""
    name = method.__name__
    begins = name == "__call__"

    @functools.wraps(method)
    def call(self, *arguments, **named):
        state = self._state(begins)
        with state._alone:
            if not begins:
                parameters, subject = state._parameters, f"{type(self).__name__}.{name}"
                expected = "called after run(x) without an error"
                require(len(parameters.x) > 0, subject, f"no {parameters.gives} yet", expected)
            return method(state, *arguments, **named)

    return call  # type: ignore[return-value]


class Parametrised:
    """Scenes that `build` gives for parameters x, and derivatives of their numbers by x.

    `read` takes the scene, and all else, from what `build` gives; SceneError if this is wrong.
    `numbers_of` gives numbers of all else in a scene, by that of the last call.
    """

    def __init__(
        self,
        build: Callable,
        read: Callable[[Any], tuple[Scene, Any]],
        gives: str,
        numbers_of: Callable[[Scene, Any, Any], DualArrays] = lambda *_: {},
    ):
        self._built, self._numbers_of = lambda *values: read(build(*values)), numbers_of
        # The scene that `build` gave last, and what it gave besides.
        self._last: tuple[Scene, Any]
        #: What a call gives, for messages.
        self.gives = gives
        #: What is known of functions of the scenes.
        self.array_calls = ArrayCalls()
        #: Arguments of `build` after x.
        self.more: tuple[float, ...] = ()
        #: The parameters of the last call; empty until it succeeds.
        self.x = np.empty(0)
        #: Its scene, what `build` gave besides, and its statistics.
        self.scene: Scene
        self.besides: Any = None
        self.stats: Stats
        self.scenes = SceneGradient(lambda x: self.build_at(x)[0])

    def check_x(self, x: ArrayLike) -> np.ndarray:
        """The parameters of a call, which are checked; there are none until it succeeds."""
        self.x = np.empty(0)
        values = real_array(x)
        is_right = values.ndim == 1 and values.size > 0 and all_of(np.isfinite(values))
        require(is_right, "Response: x", x, "a sequence of finite numbers")
        return values

    def build_at(self, x: np.ndarray | Dual, *extra: float) -> tuple[Scene, Any]:
        """The scene that `build` makes of a copy of x, and the rest of its result."""
        own_x = x if isinstance(x, Dual) else x.copy()
        building = BUILDING.set(self.array_calls)
        try:
            scene, besides = self._built(own_x, *(extra or self.more))
        finally:
            BUILDING.reset(building)
        scene.array_calls, self._last = self.array_calls, (scene, besides)
        return scene, besides

    def build_and_keep(self, x: np.ndarray | Dual) -> Scene:
        """Take the scene of x as that of this call."""
        self.scene, self.besides = self.build_at(x)
        return self.scene

    def derivatives(self, numbers_of: NumbersOf) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes at the last x."""

        def every(scene: Scene, change: np.ndarray | Dual) -> DualArrays:
            last, besides = self._last
            besides = besides if scene is last else self.besides
            extra = self._numbers_of(scene, besides, self.besides)
            return numbers_of(scene, change) | extra

        changes = self.scenes.derivatives(self.x, self.scene, every)
        self.stats.difference_reason = self.scenes.reason
        return changes


class ParameterFunction:
    """A function of parameters x; copies know of no call.

    The first thread that calls it has this object as its state, each other one a copy of its own.
    """

    _parameters: Parametrised

    def _begin(self, *arguments) -> None:
        """Know of no call yet; copies and pickles begin with the same arguments."""
        self._arguments = arguments
        # Held while this state is used, and by the first thread for good; states of other threads.
        self._alone, self._first, self._of_thread = RLock(), Lock(), local()

    def _state(self, begins: bool = False) -> Self:
        """The state of this thread; this object if the thread has none, and does not begin one."""
        states = self._of_thread.__dict__
        if begins and "state" not in states:
            states["state"] = None if self._first.acquire(blocking=False) else self._twin()
        return states.get("state") or self

    def _twin(self) -> Self:
        """A copy that calls functions of scenes with arrays where this object does."""
        twin = copy.copy(self)
        twin._parameters.array_calls = self._parameters.array_calls
        return twin

    def _last_x(self) -> np.ndarray:
        """The parameters of the last call in this thread; empty if it failed, or made none."""
        has_called = "state" in self._of_thread.__dict__
        return self._state()._parameters.x if has_called else np.empty(0)

    def __getstate__(self):
        return self._arguments

    def __setstate__(self, arguments):
        self._begin(*arguments)

    @property
    def stats(self) -> Stats:
        """Statistics of the last call."""
        return self._state()._parameters.stats
