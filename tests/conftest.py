"""Shared set-up: the tests' own helpers can be imported, and hypothesis knows no deadline."""

import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from fx_beam.fem import intervals

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

# A form compiled without optimisation takes a fifth less time. The compiled loop stays optimised.
intervals.JIT["cffi_extra_compile_args"] = ["-O0", "-g0"]

_DEMOS = {path.stem for path in (Path(__file__).parents[1] / "demos").glob("*.py")}
# Groups that take longest, which start first: otherwise one process would end with them alone.
_SLOWEST = (
    "test_stability_report",
    "test_loop",
    "test_demo_damping_scan",
    "test_start",
    "test_reports",
    "test_demo_lee_frame",
    "test_demo_multibody",
)


def group(nodeid):
    """Tests that share what is slow to make: those of a file, and all about the run of a demo."""
    path, _, test = nodeid.partition("::")
    file, demo = Path(path).stem, test.partition("[")[2].removesuffix("]")
    of_demo = file in ("test_demos", "test_paper") and demo in _DEMOS
    return f"test_demo_{demo}" if of_demo else file


def pytest_collection_modifyitems(items):
    """The slowest groups start first."""
    order = {name: place for place, name in enumerate(_SLOWEST)}
    items.sort(key=lambda item: order.get(group(item.nodeid), len(order)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """The tests of a group run in one process; groups start in the order of collection.

    The group is found from a test's id, as pytest-xdist 3.8 loses its own marks with pytest 9.2.
    """
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group(nodeid)

    return Groups(config, log)
