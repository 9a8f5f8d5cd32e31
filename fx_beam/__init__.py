"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import ast
import importlib
import importlib.util
import warnings
from pathlib import Path

if importlib.util.find_spec("ffcx") is None:
    raise ImportError(
        "fx_beam needs FEniCSx, of which FFCx 0.5, 0.9 or 0.11 is enough: pip install fenics-ffcx, "
        "or Debian's python3-ffcx with its /usr/bin/python3, or see "
        "https://fenicsproject.org/download",
        name="ffcx",
    )

__version__ = "1.0.0"

# The stub, which type checkers read, tells the file that is loaded when a name is first asked for.
_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
_IMPORTS = [node for node in _STUB.body if isinstance(node, ast.ImportFrom)]
_HOMES = {
    a.name: f"{__name__}.{node.module}" for node in _IMPORTS if node.level for a in node.names
}
# Materials and pictures; the studies, which are a package of their own.
_ROOMS = {
    a.name: f"{node.module}.{a.name}" for node in _IMPORTS if not node.level for a in node.names
}

__all__ = [*_HOMES]


def __getattr__(name: str):
    if name in _ROOMS:
        if _ROOMS[name].startswith("fx_beam_studies"):
            what = f"fx_beam.{name} is now {_ROOMS[name]}; the old name goes in version 1.2"
            warnings.warn(what, FutureWarning, stacklevel=2)
        return importlib.import_module(_ROOMS[name])
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def __dir__():
    return sorted({*__all__, *_ROOMS, *(name for name in globals() if name.startswith("__"))})
