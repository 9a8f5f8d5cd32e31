"""Needs of pictures on the system: packages, and a library with which VTK draws."""

from __future__ import annotations

import ctypes
import importlib.util
import os

_MISSING = [name for name in ("matplotlib", "PIL", "pyvista") if not importlib.util.find_spec(name)]
if _MISSING:
    names = ", ".join(_MISSING)
    raise ImportError(
        f"pictures need {names}, not installed here: in a clone pip install '.[plot]'",
        name=_MISSING[0],
    )

# Without a display VTK would search for one and print a warning: select EGL as the default.
if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


def check_renderer() -> None:
    """Refuse to draw without EGL: VTK would end the process with a segmentation fault."""
    if os.environ.get("VTK_DEFAULT_OPENGL_WINDOW") != "vtkEGLRenderWindow":
        return
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError as error:
        raise RuntimeError(
            "VTK cannot draw the shapes: this system has no libEGL.so.1. As root: apt-get install "
            "libegl1 libgl1-mesa-dri. Or give thickness=1.0 or a colour, which matplotlib draws"
        ) from error
