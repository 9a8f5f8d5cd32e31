"""Scripts of measurements find all that they measure."""

import pytest
from scenes import BENCHMARKS, benchmark


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_a_benchmark_finds_what_it_imports(name):
    if name == "exudyn_pendulum":
        pytest.importorskip("exudyn")
    assert benchmark(name).__doc__


def test_derivatives_of_a_run_are_measured():
    script = benchmark("derivatives")
    times = script.measured(lambda: script.pinned(8), 1e-3, 20, 1)
    assert len(times) == len(script.NUMBERS) + 4
    assert min(times) > 0


def test_the_parts_of_a_scene_of_a_sweep_are_measured():
    rows = benchmark("sweep").times_by_part(3, 2)
    assert rows.shape == (2, 5)
    assert rows.min() > 0
