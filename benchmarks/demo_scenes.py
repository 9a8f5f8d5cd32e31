"""The demos as modules: benchmarks use their scenes."""

import functools
import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "demos"))  # what demos share, and demos that use others


@functools.cache
def demo(name):
    """A demo as a module, such as demo("pendulum")."""
    spec = importlib.util.spec_from_file_location(f"demo_{name}", ROOT / "demos" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def scene(name, *arguments, **keywords):
    """Scene of a demo, without the beams or nodes that its function returns as well."""
    made = demo(name).scene(*arguments, **keywords)
    return made[0] if isinstance(made, tuple) else made
