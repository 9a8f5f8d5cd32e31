"""Drag on the beams of a scene, as data of its form."""

from __future__ import annotations

import numpy as np

from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import PARTS_OF_DRAG
from fx_beam.scene.scene import Scene

from .fields import Data, cell_data
from .mesh import Mesh


def coefficients(scene: Scene, mesh: Mesh) -> dict[str, Data]:
    """Coefficients of `drag_work` on all beams, those that there are, behind "drag "."""
    rows: dict[str, np.ndarray] = {}
    on_beams = ((drag, drag.target) for drag in scene.drags if isinstance(drag.target, Beam))
    for drag, beam in on_beams:
        for name in PARTS_OF_DRAG:
            value = getattr(drag, name)
            if value.any():
                key = f"drag {name}" if len(value) == 1 else f"drag {name} along and across"
                of_beams = rows.setdefault(key, np.zeros((len(scene.beams), len(value))))
                of_beams[scene.beams.index(beam)] += value
    return {
        name: cell_data(mesh, row if "across" in name else row[:, 0]) for name, row in rows.items()
    }
