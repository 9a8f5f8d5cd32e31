"""Shared set-up: the tests' own helpers can be imported, and hypothesis knows no deadline."""

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


@pytest.fixture
def unoptimised(monkeypatch):
    """Forms compiled in half the time, where they are evaluated a few times only."""
    monkeypatch.setitem(dolfinx_api._JIT, "cffi_extra_compile_args", ["-O0", "-g0"])
