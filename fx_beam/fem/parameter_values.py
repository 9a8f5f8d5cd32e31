"""The parameters of a scene at one time: one array, which forms and laws read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fx_beam.content_cache import shallow_copy
from fx_beam.dual import MaybeDual
from fx_beam.errors import SceneError
from fx_beam.scene.functions import Signal, evaluate
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError


class ParameterFunctions:
    """The parameters of a scene as functions of time, in its order."""

    def __init__(self, scene: Scene):
        functions = scene.parameters.functions
        self.names, self.functions = [*functions], [*functions.values()]
        self._arrays = scene.array_calls

    def check(self, other: ParameterFunctions) -> None:
        """OtherStructureError if others vary that do not here, or conversely."""
        pairs = zip(self.functions, other.functions, strict=True)
        if any([a.is_constant != b.is_constant for a, b in pairs]):
            raise OtherStructureError("parameters that were constant vary in time, or conversely")

    def values_at(self, t: float) -> np.ndarray:
        """The values (n,) at a time [s]; StepError if a function fails."""
        pairs = zip(self.functions, self.names, strict=True)
        return np.array([evaluate(f, t, f"parameter {name!r}")[0] for f, name in pairs])

    def series(self, times: np.ndarray) -> MaybeDual:
        """Values (times, n) at some times [s]."""
        pairs = zip(self.functions, self.names, strict=True)
        rows = [f.series(times, f"parameter {name!r}", self._arrays) for f, name in pairs]
        return np.hstack(rows) if rows else np.empty((len(times), 0))

    def over_steps(self, t0: np.ndarray, t1: np.ndarray, level: float) -> MaybeDual:
        """Values (steps, 2, n) at the level of steps and at their ends."""
        return np.stack([self.series(t0 + level * (t1 - t0)), self.series(before(t1))], axis=1)


class ParameterValues:
    """Present values of all parameters of a scene; forms and laws are told of changes."""

    def __init__(self, signals: ParameterFunctions):
        self.signals, self.names = signals, signals.names
        #: Present values (n,).
        self.values = np.zeros(len(self.names))
        self._readers: list[Callable[[np.ndarray], None]] = []
        #: Whether stored energies depend on values that vary.
        self.energies_vary = False
        self._held = False
        self.set_functions(signals)

    def set_functions(self, signals: ParameterFunctions) -> None:
        """Take the values of the same parameters of a scene, by their functions of time."""
        if self.names:
            self.signals, self._held = signals, False
            self.use(self.values_at(0.0))

    def in_block(self, block: Any) -> ParameterValues:
        """Parameters whose values are in the block of a run; what reads them is to be added."""
        if not self.names:
            return self
        other = shallow_copy(self)
        other.values, other._readers = block.view(self.values), []
        return other

    def __len__(self):
        return len(self.names)

    @property
    def functions(self) -> list[Signal]:
        """Their functions of time."""
        return self.signals.functions

    @property
    def vary(self) -> bool:
        """Whether any changes in time."""
        return not (self._held or all(f.is_constant for f in self.functions))

    def check_constant(self, name: str, subject: str) -> None:
        """SceneError if there is no such parameter, or if it varies in time."""
        value = dict(zip(self.names, self.functions, strict=True)).get(name)
        if value is None or not value.is_constant:
            lacks = "is not in the scene" if value is None else "varies in time"
            raise SceneError(
                f"{subject}: the parameter {name!r} {lacks}. Give it a number by "
                f"scene.add_parameter(fx_beam.Parameter({name!r}, ...))"
            )

    def indices(self, names: Sequence[str]) -> list[int]:
        """Indices of some parameters."""
        return [self.names.index(name) for name in names]

    def add_energies(self, names: Sequence[str]) -> None:
        """Note the parameters on which some stored energies depend."""
        varies = (self.functions[i] for i in self.indices(names))
        self.energies_vary |= not all(function.is_constant for function in varies)

    def add_reader(self, read: Callable[[np.ndarray], None]) -> None:
        """Add a function of the values (n,), which is called after each change of them."""
        if self.names:
            self._readers.append(read)
            read(self.values)

    def hold(self, t: float) -> None:
        """Keep the values at a time [s], as in statics."""
        if self.names:
            self.use(self.signals.values_at(t))
            self._held = True

    def set_step_values(self, level: float, values: np.ndarray | None = None) -> None:
        """Set the values of a step: at the time of its level [s], or `values` (n,)."""
        self.use(self.values_at(level) if values is None else values)

    def use(self, values: np.ndarray | None) -> None:
        """Set the values (n,)."""
        if self.names:
            self.values[:] = values
            for reader in self._readers:
                reader(self.values)

    def values_at(self, t: float) -> np.ndarray:
        """The values (n,) at a time [s]; StepError if a function fails."""
        return self.values.copy() if self._held else self.signals.values_at(t)

    def at_times(self, times: np.ndarray) -> MaybeDual:
        """The values (times, n) at some times [s]."""
        if self._held or not self.names:
            return np.tile(self.values, (len(times), 1))
        return self.signals.series(times)


def before(t):
    """Times just before some [s], but not before 0: a jump at that very time has yet to come."""
    return np.maximum(t - 4 * np.spacing(t), np.minimum(t, 0.0))
