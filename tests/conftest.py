"""Shared set-up: the tests' own helpers can be imported, and hypothesis knows no deadline."""

import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from fx_beam.fem import dolfinx_api

sys.path.insert(0, str(Path(__file__).parent))

# Pictures without a display, as `./run` has it.
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")

# The first example of a run compiles forms, which is no reason to fail.
settings.register_profile("fx_beam", deadline=None, max_examples=25)
settings.load_profile("fx_beam")

# UFL makes many small objects: with Python's own thresholds garbage collection takes an eighth of
# the time.
gc.set_threshold(20_000, 20, 50)

# Files whose tests share the runs of the demos, and the slowest of the other files.
_OF_DEMOS = "test_demos", "test_paper"
_LONG = *_OF_DEMOS, "test_stability"


@pytest.fixture
def unoptimised(monkeypatch):
    """Forms compiled in half the time, where they are evaluated a few times only."""
    monkeypatch.setitem(dolfinx_api._JIT, "cffi_extra_compile_args", ["-O0", "-g0"])


def pytest_collection_modifyitems(items):
    """Tests that share runs stay in one process; the slowest files start first."""
    items.sort(key=lambda item: item.path.stem not in _LONG)
    for item in items:
        name = item.path.stem
        item.add_marker(pytest.mark.xdist_group("demos" if name in _OF_DEMOS else name))
