"""The demos as modules: benchmarks use their scenes."""

import importlib
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))


def demo(name):
    """A demo as a module, such as demo("pendulum")."""
    return importlib.import_module(name)


def scene(name, *arguments, **keywords):
    """Scene of a demo, without the beams or nodes that its function returns as well."""
    made = demo(name).scene(*arguments, **keywords)
    return made[0] if isinstance(made, tuple) else made
