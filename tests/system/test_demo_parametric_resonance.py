"""The numbers of demos/parametric_resonance.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "kind, pulse, ends",
    [("period doubling", 0.1, 2), ("period doubling", 0.4, 2), ("fold", 0.1, 0), ("fold", 0.4, 2)],
)
def test_the_column_is_unstable_where_mathieus_equation_is(kind, pulse, ends):
    found, exact = numbers("parametric_resonance")["boundaries"][kind][f"P1 = {pulse:g}"]
    assert len(exact) == ends
    assert found == pytest.approx(exact, rel=1e-4)


def test_a_pushed_column_grows_by_the_multiplier():
    found = numbers("parametric_resonance")
    doubling, fold = (found["multipliers"][kind] for kind in ("period doubling", "fold"))
    assert doubling < -1.3 and fold > 1.15
    growth = found["growth in a period"]
    assert growth["period doubling"] == pytest.approx(-doubling, rel=1e-4)
    assert growth["fold"] == pytest.approx(fold, rel=1e-4)


def test_the_column_has_the_frequency_and_the_buckling_load_of_theory():
    found = numbers("parametric_resonance")
    assert found["buckling load"] == pytest.approx(1.0, abs=2e-3)
    theory = found["the same by theory [rad/s]"]
    assert found["natural frequency under P0 [rad/s]"] == pytest.approx(theory, rel=2e-3)
