"""Changes of a scene while something that was made of it is in use."""

from __future__ import annotations

from fx_beam.errors import SceneError

from .scene import Scene

# Kinds of parts of a scene that may become longer.
_LISTS = list, dict, set


class Watch:
    """Notices whether something was added to a scene, removed from it or changed."""

    def __init__(self, scene: Scene):
        self._scene = scene
        self._parts = [part for part in vars(scene).values() if isinstance(part, _LISTS)]
        self._counts = self._now()

    def _now(self) -> tuple[int, ...]:
        """Lengths of lists and counts of changes: a change of the scene changes one of them."""
        return *map(len, self._parts), self._scene.changes, self._scene.parameters.changes

    @property
    def has_changed(self) -> bool:
        """Whether the scene has changed since the start."""
        return self._now() != self._counts

    def check(self, caller: str) -> None:
        """SceneError if the scene was changed while an analysis ran."""
        if self.has_changed:
            raise SceneError(
                f"{caller}: the scene was changed while it was computed, as by a load function "
                "that adds a beam. Change it before, or by latches and fuses (changes=...)"
            )
