"""The numbers of the demos of equilibria, vibrations and cycles."""

import itertools

import numpy as np
import pytest
from pytest import approx
from scenes import demo

pytestmark = pytest.mark.slow


# -- clamped_beam


def test_the_backbone_is_a_little_softer_than_that_of_a_single_mode(clamped_beam):
    assert clamped_beam["frequency of small vibrations over w0"] == approx(1, abs=1e-3)
    names = "amplitude", "frequency", "of a single mode"
    a, f, single = (np.array(clamped_beam[name]) for name in names)
    assert (np.diff(a) > 0).all() and (np.diff(f) > 0).all() and a[-1] > 7
    small = a < 6
    assert (f[small] < single[small]).all()
    assert f[small] == approx(single[small], rel=4e-3)


def test_the_shape_changes_with_the_square_of_a_small_amplitude(clamped_beam):
    a, change = np.array(clamped_beam["amplitude"]), np.array(clamped_beam["change of shape"])
    assert (np.diff(change) > 0).all()
    low, high = np.searchsorted(a, (1.0, 1.5))
    order = np.log(change[high] / change[low]) / np.log(a[high] / a[low])
    assert order == approx(2, abs=0.2)


def test_motions_are_unstable_where_the_second_mode_grows_by_hills_equation(clamped_beam):
    a, stable = np.array(clamped_beam["amplitude"]), np.array(clamped_beam["stable"])
    low, high = clamped_beam["second mode grows"]
    assert not stable.all()
    away = a[~stable]
    assert low - 0.5 < away.min() and away.max() < high + 0.5
    assert stable[a < low - 0.5].all()


def test_the_tongue_leads_to_the_third_mode_at_a_fifth_of_its_frequency(clamped_beam):
    assert clamped_beam["fifth harmonic on the curve"] < 0.02
    assert clamped_beam["fifth harmonic in the tongue"] > 1
    third = clamped_beam["a fifth of that of the third mode"]
    assert clamped_beam["frequency in the tongue"] == approx(third, rel=2e-3)


# -- column_between_walls


def test_the_force_on_the_wall_is_that_of_small_deflections_where_the_walls_are_near(
    column_between_walls,
):
    wide, middle, narrow = column_between_walls["difference from the theory"][
        "force on the wall"
    ].values()
    assert narrow < 5e-4
    # Of second order in the deflection, but for what the springs of the walls give way.
    assert wide / middle > 3.5 and middle / narrow > 2.5


def test_the_column_lies_flat_from_four_times_its_buckling_load_on(column_between_walls):
    # Where the flat part begins rows lie anywhere, and its ends are as sharp as the walls' springs.
    _, flat = column_between_walls["the same by the theory"]
    module = demo("column_between_walls")
    spread = (module.EI / module.STIFFNESS) ** 0.25
    largest = max(column_between_walls["difference from the theory"]["flat length"].values())
    assert largest < spread / flat
    assert column_between_walls["flat length at the end"] == approx(flat, rel=2e-3)
    assert column_between_walls["moment in the middle at 4 P1 over that at 2 P1"] < 0.05


def test_the_forces_across_the_column_are_in_balance(column_between_walls):
    assert column_between_walls["forces across, out of balance"] < 1e-12


# -- driven_cycle


def test_newtons_method_finds_the_cycle(driven_cycle):
    assert driven_cycle["distance of the states after a cycle"] < 1e-9
    assert driven_cycle["iterations"] <= 10 and driven_cycle["stable"]
    assert abs(driven_cycle["work of the motor over the loss, less 1"]) < 1e-6


def test_a_simulation_decays_to_it_by_the_largest_multiplier(driven_cycle):
    decay = driven_cycle["decay of the simulation in a turn"]
    assert decay == approx(driven_cycle["largest multiplier"], abs=1e-3)
    assert driven_cycle["turns until 1e-9"] > 1000


# -- gripper


def test_the_least_friction_by_trials_is_that_of_the_forces_in_a_lift(gripper):
    apart = gripper["least friction, by trials"] - gripper["least friction, by the forces"]
    assert abs(apart) < 2 * gripper["between two trials"]


def test_the_fingers_carry_the_weight_and_press_as_bent_strips_do(gripper):
    assert gripper["force of the fingers at rest"] == approx(gripper["weight"], rel=1e-3)
    small = gripper["the same for small rotations"]
    assert gripper["normal force of a finger"] == approx(small, rel=0.03)
    assert gripper["rise of the disc"] == approx(0.1, rel=2e-3)
    assert gripper["energy balance"] < 1e-10


# -- lee_frame


def test_lee_frame_has_the_limit_loads_of_the_literature_and_of_shooting(lee_frame):
    shot = lee_frame["limit loads by shooting"]
    assert 18.5e3 < shot[0] < 18.6e3 and -9.5e3 < shot[1] < -9.3e3
    for name, loads in lee_frame["limit loads"].items():
        assert len(loads) == 2, name
        if name != "degree 1, 10 elements":
            assert loads == approx(shot, rel=0.015), name
    assert lee_frame["limit loads"]["degree 2, 20 elements"] == approx(shot, rel=2e-5)
    assert lee_frame["limit loads"]["degree 3, 10 elements"] == approx(shot, rel=1e-6)


def test_lee_frame_snaps_back_and_is_followed_to_its_full_load(lee_frame):
    assert lee_frame["load at the end"] == 20e3
    assert lee_frame["largest way back of the loaded point"] > 5
    assert lee_frame["steps"] < 60
    assert 0.99 < lee_frame["load steps alone end at"] / lee_frame["limit loads by shooting"][0] < 1


# -- parametric_resonance


def test_the_column_is_unstable_where_mathieus_equation_is(parametric_resonance):
    ends = {}
    for kind, by_pulse in parametric_resonance["boundaries"].items():
        for pulse, (computed, exact) in by_pulse.items():
            assert computed == approx(exact, rel=1e-4)
            ends[kind, pulse] = len(exact)
    ends = [ends[k, f"P1 = {p}"] for k in ("period doubling", "fold") for p in (0.1, 0.4)]
    assert ends == [2, 2, 0, 2]


def test_a_pushed_column_grows_by_the_multiplier(parametric_resonance):
    multipliers = parametric_resonance["multipliers"]
    doubling, fold = (multipliers[kind] for kind in ("period doubling", "fold"))
    assert doubling < -1.3 and fold > 1.15
    growth = parametric_resonance["growth in a period"]
    assert growth["period doubling"] == approx(-doubling, rel=1e-4)
    assert growth["fold"] == approx(fold, rel=1e-4)


def test_the_column_has_the_frequency_and_the_buckling_load_of_theory(parametric_resonance):
    assert parametric_resonance["buckling load"] == approx(1.0, abs=2e-3)
    theory = parametric_resonance["the same by theory [rad/s]"]
    assert parametric_resonance["natural frequency under P0 [rad/s]"] == approx(theory, rel=2e-3)


# -- plasticity


def test_the_loops_of_the_bar_are_exact(plasticity):
    for bar in plasticity["bar"].values():
        assert bar["error of the moment"] < 1e-12
        assert bar["least loss of a step"] >= 0


def test_the_frame_carries_its_limit_load(plasticity):
    frame = plasticity["frame"]
    over = {int(count): run["relative to limit"] - 1 for count, run in frame.items()}
    for count, excess in over.items():
        # Hinges are in the middle of elements; the small hardening adds less than 1 %.
        assert 0.8 / count < excess < 1.4 / count + 0.01
    assert over[80] < over[40] < over[20]
    assert 2 * over[80] - over[40] == approx(0, abs=0.01)
    assert all(run["relative balance error"] < 1e-11 for run in frame.values())


def test_the_frame_on_hinges_carries_its_limit_load_without_mesh_error(plasticity):
    frame = plasticity["frame on hinges"]
    # What is left is of second order in the displacements.
    assert abs(frame["1"]["relative to limit"] - 1) < 4e-3
    assert abs(frame["10"]["relative to limit"] - 1) < 4e-4
    for run in frame.values():
        assert run["relative balance error"] < 1e-11
        foot, left, middle, right, other = run["plastic angles"]
        assert foot < 0 < middle and right < 0 < other
        assert abs(left) < 1e-12  # the left corner has no hinge in the mechanism


def test_the_ring_stays_bent(plasticity):
    ring = plasticity["ring"]
    low, high = ring["plastic curvatures"]
    assert low < -3 and high > 3
    assert 0.9 < ring["dissipated"] < 1
    assert ring["least loss of a step"] > -1e-12
    assert ring["relative balance error"] < 1e-11


# -- pull_in


def test_equilibria_under_a_magnet_are_those_by_hand_until_they_end(pull_in):
    assert pull_in["equilibrium at 0.99"] and not pull_in["equilibrium at 1.01"]
    # The formula is for small deflections: its error is the square of their slope.
    for strength, ratio in pull_in["strength / exact"].items():
        slope = 1.5 * pull_in["deflection / gap"][strength] * 0.02 / 0.25
        assert ratio == approx(1, abs=1e-5 + slope**2)
    assert 0.28 < pull_in["deflection / gap"]["0.99"] < 1 / 3


def test_frequencies_fall_as_the_magnet_softens_the_strip(pull_in):
    ratios = pull_in["frequency / exact"]
    assert len(ratios) == 7
    for strength, ratio in ratios.items():
        assert ratio == approx(1, abs=0.01 if strength == "0.99" else 0.003)


def test_a_sudden_field_snaps_the_strip_from_27_32_of_the_strength(pull_in):
    assert pull_in["snaps from"] == approx(27 / 32, abs=2e-3)
    swings, snaps = pull_in["largest deflection / gap"].values()
    assert swings < 0.5 and snaps > 0.9


def test_the_energy_of_magnet_and_stop_is_conserved(pull_in):
    assert max(pull_in["relative energy error"].values()) < 1e-9


# -- relaxation


def test_relaxation_and_creep_converge_with_second_order(relaxation):
    assert len(relaxation) == 4
    for run in relaxation.values():
        assert run["errors"][-1] < 1e-4
        assert run["orders"][-1] == approx(2, abs=0.05)


def test_the_closed_solutions_satisfy_their_equations():
    # d/dt of M = EI kappa + EI_1 (kappa - a) with da/dt = (kappa - a) / tau.
    material, t, h = demo("relaxation"), 0.7, 1e-4
    EI, EI_1, tau, c = material.EI, material.EI_1, material.TAU, material.RATE

    def rate(function):
        return (function(t + h) - function(t - h)) / (2 * h)

    for kappa, M, kappa_t, M_t in (
        (c * t, material.moment(t), c, rate(material.moment)),
        (material.curvature(t), c * t, rate(material.curvature), c),
    ):
        assert tau * M_t + M == approx(EI * kappa + tau * (EI + EI_1) * kappa_t, rel=1e-7)


# -- ring


@pytest.mark.parametrize(
    ("degree", "meshes", "tolerance", "order"), [(1, (32, 64), 0.04, 2), (2, (16, 32), 2e-3, 4)]
)
def test_ring_has_the_exact_frequencies_with_the_order_of_its_elements(
    degree, meshes, tolerance, order, ring
):
    runs = [ring["meshes"][f"degree {degree}, {n} elements"] for n in meshes]
    assert all(run["rigid modes"] == 3 for run in runs)
    assert all(run["largest split of a pair"] < 1e-6 for run in runs)
    coarse, fine = (abs(np.array(run["relative errors"])) for run in runs)
    assert fine.max() < tolerance
    assert (np.log2(coarse / fine) > order - 0.3).all()


def test_ring_is_exact_by_cubic_elements_and_hardly_stretches_if_thin(ring):
    errors = ring["meshes"]["degree 3, 24 elements"]["relative errors"]
    assert max(map(abs, errors)) < 1e-4
    assert ring["exact"] == approx(ring["inextensional"], rel=5e-4)


def test_ring_keeps_energy_and_momenta_in_flight(ring):
    for dt in (2e-3, 1e-3):
        run = ring["schemes"]["EnergyMomentum"][f"dt {dt:g}"]
        assert run["failure"] is None and run["steps"] == round(1 / dt)
        for name in ("energy", "angular momentum", "linear momentum"):
            assert run[f"{name} drift"] < 1e-11


def test_ring_is_squeezed_far_and_other_schemes_gain_or_lose_energy_by_it(ring):
    assert ring["diameter"][0] < 0.6 and ring["diameter"][1] > 1.2
    newmark, hht = (ring["schemes"][name]["dt 0.002"] for name in ("Newmark", "HHT"))
    assert newmark["failed at"] < 1 and newmark["highest energy ratio"] > 10
    assert hht["failure"] is None and hht["lowest energy ratio"] < 0.99


# -- roll_up


@pytest.mark.parametrize(
    ("name", "turns", "steps", "close"), [("once", 1, 10, 1e-6), ("twice", 2, 20, 1e-5)]
)
def test_roll_up_is_the_circle(name, turns, steps, close, roll_up):
    run = roll_up[name]
    assert (run["load steps"], run["cuts"]) == (steps, 0)
    assert run["turns of the tip"] == approx(turns, rel=1e-12)
    assert run["tip off at the end / L"] < 1e-12
    assert run["tip off on the way / L"] < close
    assert run["strain energy / exact"] == approx(1, rel=1e-12)
    assert run["relative balance error"] < 1e-12


def test_roll_up_converges_with_twice_the_degree(roll_up):
    assert [*roll_up["orders"].values()] == approx([2, 4, 6], abs=0.1)


def test_roll_up_let_go_keeps_its_energy(roll_up):
    free = roll_up["let go"]
    assert free["energy at the start"] == approx(2 * np.pi**2 * 500 / 10, rel=1e-12)
    assert free["relative energy error"] < 1e-11
    assert free["largest kinetic energy"] > 0.5 * free["energy at the start"]


# -- shallow_arch


def test_arches_snap_and_sway_near_the_loads_of_shallow_arch_theory(shallow_arch):
    for name, loads in shallow_arch["loads"].items():
        limit, sway = shallow_arch["theory"][name]
        assert loads["limit point"] == approx(limit, rel=4e-4), name
        assert loads["bifurcation"] == (None if sway is None else approx(sway, rel=4e-4))
    assert list(shallow_arch["first"].values()) == ["limit point", "limit point", "bifurcation"]


def test_the_sway_branch_has_the_thrust_of_a_column_with_two_half_waves(shallow_arch):
    assert shallow_arch["branches"] == 4 and shallow_arch["stable rows of branches"] == 0
    assert shallow_arch["largest v"] == approx(shallow_arch["largest v by theory"], rel=4e-3)
    assert shallow_arch["error of v^2"] < 0.006


# -- snapping_chain


def test_each_cell_of_the_chain_snaps_at_its_limit_load(snapping_chain):
    assert snapping_chain["kinds"] == ["limit point"]
    assert snapping_chain["limit loads"] == approx(snapping_chain["limit loads of cells"], rel=1e-4)


def test_the_path_of_the_chain_counts_through_all_states(snapping_chain):
    states = snapping_chain["states without load"]
    counting = [tuple(reversed(state)) for state in itertools.product((1, -1), repeat=3)]
    assert [tuple(state) for state in states] == counting


def test_the_energy_barrier_is_that_of_a_flat_cell(snapping_chain):
    of_a_cell = snapping_chain["barrier of the first cell"]
    assert snapping_chain["barrier"] == approx(of_a_cell, rel=1e-3)


def test_more_of_the_path_is_stable_under_a_displacement(snapping_chain):
    under_load, driven = (
        snapping_chain[f"limit points under a {control}"] for control in ("load", "displacement")
    )
    assert 0 < driven < under_load
    shares = [
        snapping_chain[f"stable part under a {control}"] for control in ("load", "displacement")
    ]
    assert shares[0] < shares[1] < 1
