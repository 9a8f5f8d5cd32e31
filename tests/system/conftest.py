"""For each demo a fixture of its name: the numbers that it returns."""

import pytest
from scenes import DEMOS


def _numbers_of(name):
    # The parameter gives the test the demo's name, by which `group` of tests/conftest.py finds it.
    @pytest.fixture(name=name, params=[name], scope="session")
    def numbers(request):
        from demo_runs import numbers

        return numbers(request.param)

    return numbers


globals().update({f"_{name}": _numbers_of(name) for name in DEMOS})
