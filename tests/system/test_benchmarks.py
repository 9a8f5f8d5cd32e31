"""Scripts of measurements find all that they measure."""

import pytest
from scenes import BENCHMARKS, benchmark


@pytest.mark.parametrize("name", sorted(path.stem for path in BENCHMARKS.glob("*.py")))
def test_a_benchmark_finds_what_it_imports(name):
    if name == "exudyn_pendulum":
        pytest.importorskip("exudyn")
    assert benchmark(name).__doc__
