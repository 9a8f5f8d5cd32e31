"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import ast
import importlib
import importlib.util
from pathlib import Path

if importlib.util.find_spec("ffcx") is None:
    raise ImportError(
        "fx_beam needs FEniCSx, of which FFCx 0.5, 0.9, 0.10 or 0.11 is enough: "
        "pip install fenics-ffcx, or Debian's python3-ffcx with its /usr/bin/python3, or see "
        "https://fenicsproject.org/download",
        name="ffcx",
    )

__version__ = "1.2.0"

# The file of each name, by the stub for type checkers: it is loaded when the name is first used.
_HOMES = {
    alias.name: f"{__name__}.{node.module or alias.name}"
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
__all__ = [name for name in _HOMES if name not in ("materials", "plot")]


def __getattr__(name: str):
    from .errors import answering_keywords, hint

    if name not in _HOMES:
        more = "" if name.startswith("_") else hint(__name__, name, __all__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{more}")
    module = importlib.import_module(_HOMES[name])
    value = globals()[name] = answering_keywords(getattr(module, name, module), __name__)
    return value


def __dir__():
    return sorted({*_HOMES, *(name for name in globals() if name.startswith("__"))})
