"""The motion of a scene that changes: from change to change, as one solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

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

from .motion_series import MotionSeries
from .options import Options

# Changes that are so near to their limits when another one happens happen with it, as those of a
# symmetric scene: relative to the force, to the size of the scene, or 1 rad.
_TOGETHER = 1e-9
# Of a step, or of a thousandth of the time: what is left after the last change is no motion.
_NOTHING = 1e-6


class ChangingScene:
    """A scene with changes that are still to come, by names."""

    def __init__(self, scene: Scene, changes: Mapping[str, Latch | Fuse], options: Options):
        self._scene, self._options = scene, options
        self._until, self._outputs = options.until or {}, options.outputs or {}
        self._changes = checked_changes(scene, changes)
        for name in self._changes:
            if name in self._until or name in self._outputs:
                raise SceneError(
                    f"simulate: {name!r} in `changes` is a name in `until` or `outputs` as well. "
                    "Use two names"
                )
        record = options.record
        if record.file is not None:
            raise SceneError("simulate: a Record with a file is not possible with until or changes")
        if not (record.motion and record.forces and record.times is None):
            raise SceneError(
                "simulate: `changes` need rows at the ends of steps, with motion and forces. Omit "
                "times, motion=False and forces=False in Record"
            )

    def motion(self, series: MotionSeries, start: Solution | None) -> Solution:
        """The motion to its end, in parts between changes."""
        whole: Solution | None = None
        t_end, dt = self._options.t_end, self._options.dt
        while True:
            try:
                run = series.motion(self._scene, self._options_of_part(), start)
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

    def _options_of_part(self) -> Options:
        """Those of the next part: the next change ends it as well."""
        conditions = {
            name: lambda t, y, name=name, change=change: excess(change, y[name])
            for name, change in self._changes.items()
        }
        needed = {name: output_of(change) for name, change in self._changes.items()}
        until = {**self._until, **conditions} or None
        outputs = {**self._outputs, **needed} if until else None
        return replace(self._options, until=until, outputs=outputs)

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
