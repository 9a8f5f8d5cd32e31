"""Pictures of solutions: shapes, animations, modes, and curves over time or frequency."""

from __future__ import annotations

import os

# Without a display VTK would search for one and print a warning: select EGL as the default.
if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

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
from .force_diagrams import diagrams
from .scene_drawing import scene
from .shape_pictures import modes, shapes

__all__ = ["Page", "animate", "axis", "curves", "diagrams", "equilibrium_paths", "figure"]
__all__ += ["frequency_response", "interactive", "modes", "quantities", "response", "save"]
__all__ += ["scene", "shapes", "style"]
