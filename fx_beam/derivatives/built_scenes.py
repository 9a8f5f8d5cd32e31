"""The scenes that a function builds of numbers, and derivatives of what they are made of."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, all_of, check_takes, numbers, require, shown
from fx_beam.motions.numbers import OF_STEPS
from fx_beam.scene.outputs import Output, check_output
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .output_values import Wanted

#: A function of numbers (m,) that gives a scene and its outputs by name.
Build = Callable[[np.ndarray], tuple[Scene, Mapping[str, Wanted]]]
#: Arrays by name, of a scene with a change of x[i]: a function of the scene, i and the change.
NumbersOf = Callable[[Scene, int, float], dict[str, np.ndarray]]

_log = logging.getLogger("fx_beam")
_INACCURATE = (
    "Response: derivatives by x[%d] at %s may have errors of %.1g of their size: two steps of the "
    "differences of `build` differ by so much in %r of the scene. Look there for values that jump, "
    "have kinks, or are known to a few digits only"
)
# Exponent of the step in differences of `build`, relative to a number: wide, to keep round-off
# small. On a line two numbers are enough; else four are combined, with an error of fourth order.
_STEP = -12
# A smaller number counts as zero, whose step is that of one.
_ZERO = 1e-100
# Difference relative to a derivative that half of the step may make before the step is shortened;
# the error is about its square. How often it is shortened, and by which exponent at most.
_BENT, _TRIES, _SHORTER = 1e-5, 8, 6
# Round-off of numbers, relative to the largest of a name. Those that are themselves solutions or
# differences have more of it: the step is not shortened for these alone.
_NOISE, _COMPUTED = 1e-12, {"a", "v", "driven rates", "forces of columns", "forces of joints"}
# Error of numbers that depend on x along a line, relative to them.
_ROUNDING = 8 * np.finfo(float).eps
# Largest difference of the numbers of two scenes at the same x, relative to them.
_SAME = 1e-9


def checked_numbers(x: Any) -> np.ndarray:
    """Numbers (m,) of a scene; SceneError for others."""
    values = numbers(x)
    fits = values.ndim == 1 and values.size > 0 and all_of(np.isfinite(values))
    require(fits, "Response: x", x, "a sequence of finite numbers")
    return values


class BuiltScenes:
    """The scenes of a function, all of which have outputs of the same names."""

    def __init__(self, build: Build):
        self._build = build
        #: Names of the outputs, from the first scene on.
        self.names: list[str] = []
        # Numbers of which it was said that differences of `build` are inaccurate.
        self._told: set[int] = set()

    def at(self, x: np.ndarray) -> tuple[Scene, dict[str, Wanted]]:
        """The scene of numbers, and its outputs; SceneError if `build` gives something else."""
        built = self._build(x)
        fits = isinstance(built, tuple) and len(built) == 2
        if not fits or not isinstance(built[0], Scene) or not isinstance(built[1], Mapping):
            raise SceneError(
                f"Response: build must give a scene and a dict of outputs, not {shown(built)}"
            )
        scene, outputs = built[0], dict(built[1])
        require(bool(outputs), "Response: outputs", outputs, "at least one output by name")
        for name, output in outputs.items():
            what = f"Response: the output {name!r}"
            if isinstance(output, Output):
                check_output(scene, output, what)
            else:
                wanted = "an fx_beam.Output, or a function of the solution"
                require(callable(output), what, output, wanted)
                check_takes(output, "solution", what)
        self.names = self.names or list(outputs)
        wanted = f"as in the first call, {self.names}"
        require(list(outputs) == self.names, "Response: outputs", list(outputs), wanted)
        return scene, outputs

    def derivatives(
        self, x: np.ndarray, known: Scene, numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes; `known` is that at x."""
        before, here = numbers_of(known, 0, 0.0), self._numbers(x, 0, 0.0, numbers_of)
        _check_same(before, here)
        by_name = {name: np.zeros((len(x), *values.shape)) for name, values in here.items()}
        for i in range(len(x)):
            for name, values in self._derivative(x, i, here, numbers_of):
                by_name[name][i] = values
        return by_name

    def _derivative(
        self, x: np.ndarray, i: int, here: dict[str, np.ndarray], numbers_of: NumbersOf
    ) -> Iterator[tuple[str, np.ndarray]]:
        """Derivatives (...) by x[i] of those numbers that depend on it."""
        size = x[i] if abs(x[i]) > _ZERO else 1.0
        h = 2.0 ** (np.frexp(size)[1] + _STEP)  # x + h is exact
        low, above = (self._numbers(x, i, change, numbers_of) for change in (-h, h / 2))
        depend = [
            name
            for name, values in here.items()
            if not (all_of(low[name] == values) and all_of(above[name] == values))
        ]
        if all(_on_a_line(name, low[name], here[name], above[name]) for name in depend):
            for name in depend:
                yield name, (above[name] - low[name]) / (1.5 * h)
        else:
            yield from self._of_bent(x, i, h, depend, (low, above), numbers_of)

    def _of_bent(
        self,
        x: np.ndarray,
        i: int,
        h: float,
        depend: list[str],
        ends: tuple[dict[str, np.ndarray], dict[str, np.ndarray]],
        numbers_of: NumbersOf,
    ) -> Iterator[tuple[str, np.ndarray]]:
        """The same of numbers on no line, from those at -h and h / 2; h is shortened if need be."""
        low, above = ends
        best: dict[str, tuple[float, np.ndarray]] = {}
        sizes, worse, bent = dict.fromkeys(depend, np.zeros(())), 0, dict[str, float]()
        for _ in range(_TRIES):
            below, high = (self._numbers(x, i, change, numbers_of) for change in (-h / 2, h))
            for name in depend:
                if name in best and best[name][0] <= _BENT:
                    continue
                narrow, wide = (above[name] - below[name]) / h, (high[name] - low[name]) / (2 * h)
                sizes[name] = np.maximum(sizes[name], _size(name, wide))
                gap = np.maximum(abs(narrow - wide) - _NOISE * abs(above[name]).max() / h, 0.0)
                bend, flat = _largest(gap, sizes[name]), not (narrow.any() or wide.any())
                if name not in best or (bend < best[name][0] and not flat):  # flat between jumps
                    best[name] = bend, narrow + (narrow - wide) / 3
            before, bent = bent, {name: error for name, (error, _) in best.items() if error > _BENT}
            for name in _COMPUTED & bent.keys():
                del bent[name]
            worse = worse + 1 if bent == before else 0
            if not bent or worse == 2:
                break  # all is well, or round-off grows
            h *= 2.0 ** -int(np.clip(np.log2(max(bent.values()) / _BENT) / 2 + 1, 1, _SHORTER))
            low, above = (self._numbers(x, i, change, numbers_of) for change in (-h, h / 2))
        if bent and i not in self._told:
            self._told.add(i)
            name = max(bent, key=bent.__getitem__)
            _log.warning(_INACCURATE, i, shown(x[i]), bent[name], name)
        for name, (_, values) in best.items():
            yield name, values

    def _numbers(
        self, x: np.ndarray, i: int, change: float, numbers_of: NumbersOf
    ) -> dict[str, np.ndarray]:
        """Numbers of the scene with a change of x[i]."""
        moved, here = x.copy(), shown(x[i])
        moved[i] += change
        there = shown(moved[i])
        try:
            scene, _ = self.at(moved)
        except SceneError as error:
            raise SceneError(
                f"Response: no derivatives by x[{i}] at {here}, since there is no scene at "
                f"{there}: {error}"
            ) from error
        try:
            return numbers_of(scene, i, change)
        except OtherStructureError as other:
            raise SceneError(
                f"Response: the scene at x[{i}] = {there} has another structure than at {here}: "
                f"{other}. There are no derivatives at {here}"
            ) from None


def _check_same(before: dict[str, np.ndarray], here: dict[str, np.ndarray]) -> None:
    for name, values in here.items():
        gap, size = abs(values - before[name]).max(initial=0.0), abs(values).max(initial=0.0)
        if gap > _SAME * size:
            raise SceneError(
                f"Response: build gives other numbers than before at the same x: {name!r} of the "
                f"scene differs by {gap:.2g}. They must depend on x alone"
            )


def _size(name: str, values: np.ndarray) -> np.ndarray:
    """Sizes of derivatives, over time the largest, and none far below the largest of all."""
    of = abs(values)
    if name in OF_STEPS:
        of = of.max(axis=0)
    return np.maximum(of, 1e-3 * of.max(initial=0.0))


def _largest(gaps: np.ndarray, sizes: np.ndarray) -> float:
    """The largest of some gaps relative to sizes; these are zero only where both are."""
    part = np.zeros(gaps.shape)
    np.divide(gaps, sizes, out=part, where=sizes > 0)
    return float(part.max(initial=0.0))


def _on_a_line(name: str, low: np.ndarray, here: np.ndarray, above: np.ndarray) -> bool:
    """Whether numbers at x - h, x and x + h / 2 are those of a line, up to round-off."""
    size = np.maximum(abs(low), abs(above))
    if name in OF_STEPS:  # round-off is that of the largest value over time
        size = size.max(axis=0)
    return all_of(abs((low - here) + 2 * (above - here)) <= _ROUNDING * size)
