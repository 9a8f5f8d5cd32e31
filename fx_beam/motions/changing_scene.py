"""The motion of a scene that changes: from change to change, as one solution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.scene.changes import (
    Fuse,
    Latch,
    apply_change,
    checked_changes,
    excess,
    is_over,
    output_of,
)
from fx_beam.scene.scene import Scene
from fx_beam.step.recorder import Record

from .ending import Condition

# Changes that are so near to their limits when another one happens happen with it, as those of a
# symmetric scene: relative to the force, to the size of the scene, or 1 rad.
_TOGETHER = 1e-9
# Of a step, or of a thousandth of the time: what is left after the last change is no motion.
_NOTHING = 1e-6


class ChangingScene:
    """A scene with changes that are still to come, by names."""

    def __init__(
        self,
        scene: Scene,
        changes: Mapping[str, Latch | Fuse],
        until: Mapping[str, Condition],
        outputs: Mapping[str, Any],
        record: Record | None,
    ):
        self._scene, self._until, self._outputs = scene, until, outputs
        self._changes = checked_changes(scene, changes)
        for name in self._changes:
            if name in until or name in outputs:
                raise SceneError(
                    f"simulate: {name!r} in `changes` is a name in `until` or `outputs` as well. "
                    "Use two names"
                )
        whole = record is None or (record.motion and record.forces and record.times is None)
        if not whole:
            raise SceneError(
                "simulate: `changes` need rows at the ends of steps, with motion and forces. Omit "
                "times, motion=False and forces=False in Record"
            )

    def motion(
        self, part: Callable[..., Solution], start: Solution | None, t_end: float, dt: float | None
    ) -> Solution:
        """The motion to the time t_end [s]; `part` gives one by `start`, `until` and `outputs`."""
        whole: Solution | None = None
        while True:
            try:
                run = part(start=start, **self._conditions())
            except BaseException as stop:
                if whole is not None:
                    last = getattr(stop, "solution", None)
                    stop.solution = whole if last is None else whole.then(last)  # type: ignore[attr-defined]
                raise
            name, t = run.stats.until, float(run.t[-1])
            happened = self._apply(self._happened(run)) if name in self._changes else []
            times = dict.fromkeys(happened, t)
            run.stats = replace(run.stats, until="" if happened else name, changes=times)
            whole = run if whole is None else whole.then(run)
            if not happened or t_end - t <= _NOTHING * (dt or 1e-3 * abs(t_end)):
                return whole
            start = run

    def _conditions(self) -> dict[str, Any]:
        """Conditions that end the next part, and what they need."""
        conditions = {
            name: lambda t, y, name=name, change=change: excess(change, y[name])
            for name, change in self._changes.items()
        }
        needed = {name: output_of(change) for name, change in self._changes.items()}
        until = {**self._until, **conditions}
        return {"until": until, "outputs": {**self._outputs, **needed}} if until else {}

    def _apply(self, names: list[str]) -> list[str]:
        """Change the scene, but not what another change has held or taken away; those that did."""
        applied = []
        for name in names:
            if name not in self._changes:
                continue
            done = self._changes[name]
            apply_change(self._scene, done)
            applied.append(name)
            left = self._changes.items()
            self._changes = {other: one for other, one in left if not is_over(one, done)}
        return applied

    def _happened(self, run: Solution) -> list[str]:
        """Names of the changes at the end of a part."""
        near = [
            name
            for name, change in self._changes.items()
            if abs(self._relative_excess(run, change)) < _TOGETHER
        ]
        return [run.stats.until, *(name for name in near if name != run.stats.until)]

    def _relative_excess(self, run: Solution, change: Latch | Fuse) -> float:
        of = run.joint(change.joint)
        if isinstance(change, Fuse):
            return excess(change, of.force[-1]) / change.force
        slides = output_of(change).quantity == "slide"
        beyond = excess(change, float((of.slide if slides else of.angle)[-1]))
        return beyond / (float(abs(run.X - run.X.mean(axis=0)).max()) or 1.0) if slides else beyond
