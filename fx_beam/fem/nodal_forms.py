"""What forms are for a scene without beams: only terms at its nodes, and no mesh."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.mechanics.interval import Interval
from fx_beam.scene.scene import Scene

from .forms import Forms
from .free_nodes import with_blocks


class NodalForms(Forms):
    """Forces at the nodes of a scene without beams: follower forces, and drag on nodes."""

    def _build_forms(self, scene: Scene) -> None:
        if scene.virtual_works:
            raise SceneError("add_virtual_work acts on beams, but the scene has none. Add a beam")
        self.fields: Any = SimpleNamespace(degree=1)
        self._weak: Any = SimpleNamespace(
            width=0, added=None, evolution=None, needs_rates=False, needs_before=False
        )
        self.needs_before = self.resultants_need_rates = self.resultants_move = False
        self.load_factor: Any = SimpleNamespace(value=1.0)
        self.load_increment: Any = SimpleNamespace(value=0.0)
        self._tags, self._losses = np.empty(0, int), [None] * 3
        none = np.empty(0, dtype=np.int32)
        self.stiffness = with_blocks(np.empty(0), none, np.zeros(1, np.int32), self.size)
        self._force = np.zeros(self.size)

    @property
    def moving(self) -> list:
        """Nothing."""
        return []

    def _set_start(self, interval: Interval, q: np.ndarray) -> None:
        self._q = q

    def _set_increment(self, D: np.ndarray) -> None:
        self._D = D

    def internal_force(self, D: np.ndarray) -> np.ndarray:
        """Drag minus follower forces (size,) [N, N m]."""
        self._D = D
        self._force[:] = 0.0
        self._add_at_nodes()
        return self._force

    def assemble_stiffness(self) -> None:
        """Set `stiffness` at the increment of the last `internal_force`."""
        self.stiffness.data[:] = 0.0
        self._add_tangent_at_nodes()

    def strain_energy(self, q: np.ndarray, internal: np.ndarray | None = None) -> float:
        """None is stored."""
        return 0.0

    def bind_facing(self) -> None:
        """There is no section."""

    def faces_backwards(self, q: np.ndarray) -> bool:
        """There is no section."""
        return False
