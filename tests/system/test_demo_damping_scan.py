"""The numbers of demos/damping_scan.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def scanned(example, scheme):
    """When runs were lost, by step."""
    found = numbers("damping_scan")[example][scheme]
    return {float(dt.removeprefix("dt ")): run["lost at"] for dt, run in found.items()}


def test_no_step_of_any_example_is_lost_by_the_schemes_that_keep_energy():
    for example, by_scheme in numbers("damping_scan").items():
        for scheme in ("EnergyMomentum", "ModifiedMidPoint"):
            assert set(scanned(example, scheme).values()) == {None}, example
        for run in by_scheme["EnergyMomentum"].values():
            assert run["lowest energy ratio"] == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize(
    ("example", "steps"),
    [
        ("Pendulum", (0.2, 0.1, 0.05, 0.02, 0.01)),
        ("Three-bar swing", (4e-3,)),
        ("Multi-body system", (0.01, 0.005, 0.0025)),
        ("Pinned beam", (0.02, 0.01)),
    ],
)
def test_newmark_loses_every_example_at_these_steps(example, steps):
    lost = scanned(example, "HHT, alpha = 0")
    assert all(lost[dt] is not None for dt in steps)


def test_hht_postpones_the_loss_of_the_pendulum_the_more_the_more_it_damps():
    lost = {alpha: scanned("Pendulum", f"HHT, alpha = {alpha}") for alpha in ("0", "-0.05", "-0.1")}
    assert lost["0"][0.1] == pytest.approx(1.4, abs=0.11)
    assert lost["-0.05"][0.1] == pytest.approx(2.2, abs=0.11)
    assert lost["-0.1"][0.1] is None
    assert lost["0"][0.2] < lost["-0.05"][0.2] < lost["-0.1"][0.2] < 5
    assert lost["-0.05"][0.01] is None


def test_damping_that_never_loses_a_motion_loses_much_of_its_energy():
    least = {"Pendulum": 0.3, "Three-bar swing": 0.2, "Multi-body system": 0.4, "Pinned beam": 0.3}
    for example, loss in least.items():
        runs = numbers("damping_scan")[example]["HHT, alpha = -0.33"].values()
        assert all(run["lost at"] is None for run in runs)
        assert min(run["lowest energy ratio"] for run in runs) < 1 - loss


def test_the_two_families_meet_where_both_damp_by_a_half():
    for by_scheme in numbers("damping_scan").values():
        hht, generalized = by_scheme["HHT, alpha = -0.33"], by_scheme["Generalized alpha, 0.5"]
        for dt in list(hht)[-1:]:
            assert hht[dt]["lost at"] == generalized[dt]["lost at"]
