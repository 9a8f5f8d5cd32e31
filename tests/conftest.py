"""Shared set-up: a quick compiler with a cache of its own, groups of tests, other roundings."""

import gc
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "core")]
os.umask(0o022)  # folders that a group may write are no caches, and are tested on purpose alone
# Also for the processes that tests start. What it compiles is not for users: the cache is another.
os.environ["CC"] = str(HERE / "quick_cc")
_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute()
if _cache.name != "fx_beam_tests":  # not yet, as in the processes of pytest-xdist
    os.environ["XDG_CACHE_HOME"] = str(_cache / "fx_beam_tests")

from fx_beam import c_library, errors, library_cache  # noqa: E402
from fx_beam.step import program  # noqa: E402
from fx_beam.step.stepper import CompiledLoop  # noqa: E402

# Pictures without a display, as `./run` has it.
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")

# The first example of a run compiles forms, which is no reason to fail.
settings.register_profile("fx_beam", deadline=None, max_examples=25)
settings.load_profile("fx_beam")

# UFL makes many small objects: with Python's own thresholds garbage collection takes an eighth of
# the time.
gc.set_threshold(20_000, 20, 50)

# Another rounding of each motion: its step is multiplied by 1 + k 2e-15. What a test says about a
# long motion must not depend on it. Tests of exact times, or of loads that jump with a step, are
# marked.
_STRETCH = 1 + 2e-15 * int(os.environ.get("FX_BEAM_ROUNDING", "0"))


if _STRETCH != 1:
    _take = CompiledLoop.take_steps

    def _stretched(loop, steps, recorder):
        """Equal steps whose length is multiplied by `_STRETCH`; their times are as they were."""
        length = steps.dt * (_STRETCH if steps.control is None else 1)
        return _take(loop, steps._replace(dt=length), recorder)

    CompiledLoop.take_steps = _stretched


@pytest.fixture(autouse=True)
def warnings_come_again():
    """A message that is said once in a process is said once in a test."""
    errors.warn_once.cache_clear()
    with np.errstate():  # an interrupt inside NumPy may leave another behind
        yield


@pytest.fixture
def no_libraries(monkeypatch, tmp_path):
    """An empty cache for the loop and its libraries; forms come from where they always are."""

    def in_own_folder(function):
        def wrapper(*arguments):
            with monkeypatch.context() as patch:
                patch.setattr(library_cache, "folder", lambda: tmp_path / "libraries")
                return function(*arguments)

        return wrapper

    own = {name: in_own_folder(getattr(library_cache, name)) for name in ("loaded", "folder")}
    monkeypatch.setattr(c_library, "library_cache", SimpleNamespace(**own))
    # A thread that patches beside this one, or after it, would leave its folder to later tests.
    monkeypatch.setattr(c_library, "begin_to_build", lambda *library: None)
    # Structs of models that are kept have the types of these declarations.
    types = {key: ffi for key, ffi in c_library._things.items() if key[0] is c_library.declared}
    monkeypatch.setattr(c_library, "_things", types)
    # A program has its libraries: what is compiled would depend on the tests before, also where
    # their garbage is collected late.
    gc.collect()
    program.PROGRAMS.clear()
    yield


_DEMOS = {path.stem for path in (Path(__file__).parents[1] / "demos").glob("*.py")}
# Groups that take longest, which start first: otherwise one process would end with them alone.
_SLOWEST = (
    "test_steps_by_dolfinx",
    "test_stability_report",
    "demo: gears",
    "demo: clamped_beam",
    "demo: gripper",
    "demo: cart_pole",
    "test_periodic",
    "test_sweep",
    "test_sliders",
    "test_loop",
    "test_docs",
    "test_step_control",
    "test_events",
    "test_hinges",
    "test_versions",
    "test_reports",
    "test_corners",
    "test_interrupts",
    "test_chains",
    "test_library_cache",
    "demo: pendulum",
    "test_modes",
    "demo: multibody",
    "test_continuation",
    "demo: parallelogram",
    "demo: moving_mass",
    "demo: whip_stop",
    "demo: damping_scan",
    "demo: three_bar_swing",
    "demo: lee_frame",
)


def group(nodeid):
    """Tests that share what is slow to make: of a file, on a scene of the core, of a demo's run."""
    path, _, test = nodeid.partition("::")
    file, case = Path(path).stem, test.partition("[")[2].removesuffix("]")
    if file in ("test_invariants", "test_derivatives"):
        return f"core: {case}"
    if file.startswith("test_demo") or file == "test_paper":
        for demo in _DEMOS.intersection(case.split("-")):
            return f"demo: {demo}"
    return file


def pytest_collection_modifyitems(items):
    """The slowest groups start first; with other roundings, tests of exact times are left out."""
    if _STRETCH != 1:
        items[:] = [item for item in items if item.get_closest_marker("exact_times") is None]
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
