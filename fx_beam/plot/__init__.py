"""Pictures of solutions: shapes, animations, modes, and curves over time or frequency."""

from __future__ import annotations

from fx_beam.errors import answer_in_module

from . import backend  # noqa: F401  # before all that draws
from .animations import animate
from .browser_page import Page, interactive
from .charts import (
    curves,
    equilibrium_paths,
    figure,
    frequency_response,
    quantities,
    response,
    save,
    style,
)
from .drawing import axis
from .live_page import LiveView, live
from .scene_drawing import scene
from .shape_pictures import diagrams, modes, shapes

__all__ = ["LiveView", "Page", "animate", "axis", "curves", "diagrams", "equilibrium_paths"]
__all__ += ["figure", "frequency_response", "interactive", "live", "modes", "quantities"]
__all__ += ["response", "save", "scene", "shapes", "style"]
answer_in_module(globals())
