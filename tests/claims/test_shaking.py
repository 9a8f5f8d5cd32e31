"""Accelerations of the base and gravity over time, against closed forms and moved supports."""

import copy
import pickle

import numpy as np
import pytest
import scipy.linalg
from scenes import clamped_bar, held_body

import fx_beam as fb

M, K, C = 3.0, 300.0, 4.0
RECORD = np.array([0, 0.1, 0.3, 0.5, 0.9, 1.2]), np.array([0, 3.0, -5.0, 2.0, 4.0, 0.0])


def oscillator(**shaking):
    scene, body = held_body((0, 0), M, 1.0, "rotation")
    for way in "xy":
        scene.add_spring(body, **{way: [fb.Spring(K), fb.Damper(C)]})
    scene.shake(**shaking)
    return scene, body


def by_pieces(times, accelerations, t, k=K, c=C, m=M):
    """The relative motion under straight pieces of acceleration (Nigam and Jennings 1969)."""
    state, motion = np.zeros(2), []
    for start, end in zip(t[:-1], t[1:], strict=True):
        a0, a1 = np.interp([start, end], times, accelerations, left=0, right=0)
        A = np.array([[0, 1, 0, 0], [-k / m, -c / m, -1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
        x = np.array([*state, a0, (a1 - a0) / (end - start)])
        state = (scipy.linalg.expm(A * (end - start)) @ x)[:2]
        motion.append(state[0])
    return np.array([0.0, *motion])


@pytest.mark.parametrize(("scheme", "order"), [(None, 2), (fb.EnergyMomentum(order=4), 4)])
@pytest.mark.parametrize("way", "xy")
def test_an_oscillator_on_a_harmonic_base_has_its_closed_form(scheme, order, way):
    w, a, errors = 7.0, 3.0, []
    scene, body = oscillator(**{way: lambda t: a * np.sin(w * t)})
    for dt in (0.02, 0.01):
        motion = fb.simulate(scene, scheme, dt=dt, t_end=2.0)
        # x'' + 2 d x' + p^2 x = -a sin(w t), from rest.
        d, p2 = C / (2 * M), K / M
        steady = -a / (p2 - w**2 + 2j * d * w)
        u0, v0 = -steady.imag, -(1j * w * steady).imag
        q, t = np.sqrt(p2 - d**2), motion.t
        free = np.exp(-d * t) * (u0 * np.cos(q * t) + (v0 + d * u0) / q * np.sin(q * t))
        exact = (steady * np.exp(1j * w * t)).imag + free
        errors.append(abs(motion.displacement(body)[:, "xy".index(way)] - exact).max())
        assert abs(motion.energy.balance_error).max() < 1e-13
        assert abs(motion.energy.work[-1]) > 0.1  # of the base
    assert errors[0] < 2e-2 * abs(exact).max()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


def test_a_record_is_straight_between_its_times_and_zero_outside():
    scene, body = oscillator(x=RECORD)
    errors = []
    for dt in (0.01, 0.005, 0.0025):  # kinks of the record are at ends of steps
        motion = fb.simulate(scene, dt=dt, t_end=2.0)
        exact = by_pieces(*RECORD, motion.t)
        errors.append(abs(motion.displacement(body)[:, 0] - exact).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2, 2], abs=0.05)
    fine = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.01, t_end=2.0)
    assert fine.displacement(body)[:, 0] == pytest.approx(exact[::4], abs=2e-7)


def test_steps_between_the_times_of_a_record_have_order_two_and_adaptive_ones_its_tolerance():
    scene, body = oscillator(x=RECORD)
    errors = []
    for dt in (0.032, 0.016, 0.008, 0.004):
        motion = fb.simulate(scene, dt=dt, t_end=1.6)
        exact = by_pieces(*RECORD, np.union1d(RECORD[0], motion.t))
        exact = exact[np.searchsorted(np.union1d(RECORD[0], motion.t), motion.t)]
        errors.append(abs(motion.displacement(body)[:, 0] - exact).max())
    assert np.log2(errors[0] / errors[-1]) / 3 == pytest.approx(2, abs=0.3)
    motion = fb.simulate(scene, dt=0.01, t_end=1.6, tolerance=1e-5)
    exact = by_pieces(*RECORD, np.union1d(RECORD[0], motion.t))
    exact = exact[np.searchsorted(np.union1d(RECORD[0], motion.t), motion.t)]
    assert abs(motion.displacement(body)[:, 0] - exact).max() < 1e-3 * abs(exact).max()
    assert abs(motion.energy.balance_error).max() < 1e-13


@pytest.mark.parametrize(("order", "tolerance"), [(2, 1e-2), (4, 1e-2), (4, 1e-3)])
def test_steps_by_a_tolerance_know_all_samples_of_a_record(order, tolerance):
    """Of a slow oscillator, over whose time many samples go; at half of them at most."""
    times = np.arange(0, 5.001, 0.02)
    record = np.random.default_rng(2).standard_normal(len(times)) * times * np.exp(-times / 2)
    record *= 10 / abs(record).max()
    scene, body = oscillator(x=(times, record))
    run = fb.simulate(scene, fb.EnergyMomentum(order=order), t_end=6.0, tolerance=tolerance)
    t = np.union1d(times, run.t)
    exact = by_pieces(times, record, t)[np.searchsorted(t, run.t)]
    assert abs(run.displacement(body)[:, 0] - exact).max() < tolerance
    assert run.stats.steps < (2 * len(times) if order == 2 else len(times))
    assert abs(run.energy.balance_error).max() < 1e-12 * run.energy.kinetic.max()


def test_the_force_of_a_step_is_the_mean_of_a_record_over_it_whatever_the_samples_inside():
    """The impulse on a free body, in sub-steps that go back as well."""
    scene, body = held_body((0, 0), M, 1.0, "rotation")
    times, record = np.array([0.1, 0.15, 0.15, 0.3, 0.7]), np.array([1.0, 9.0, -4.0, 2.0, 6.0])
    scene.shake(x=(times, record))
    total = -np.sum(np.diff(times) * (record[1:] + record[:-1]) / 2)
    for order in (2, 4):
        run = fb.simulate(scene, fb.EnergyMomentum(order=order), dt=0.5, t_end=1.0)
        assert run.velocity(body)[-1, 0] == pytest.approx(total, rel=1e-12)


def test_newmarks_rule_by_a_tolerance_takes_no_step_over_samples_of_a_record():
    times = np.arange(0, 5.001, 0.02)
    record = 10 * np.random.default_rng(2).standard_normal(len(times))
    scene, body = oscillator(x=(times, record))
    run = fb.simulate(scene, fb.Newmark(), t_end=5.0, tolerance=1e-2)
    assert np.diff(run.t).max() < 0.02 * (1 + 1e-9)


def test_section_forces_balance_the_mean_of_a_record_over_steps():
    """A rigid column in one step over all samples: Q at its foot is minus its mass times a."""
    section = fb.Section(EA=1e10, GA=1e10, EI=1e10, rhoA=2.0, rhoI=0.0)
    scene, beam = clamped_bar((0, 3), section, elements=2)
    scene.shake(x=RECORD)
    run = fb.simulate(scene, dt=1.2, t_end=1.2)
    mean = np.sum(np.diff(RECORD[0]) * (RECORD[1][1:] + RECORD[1][:-1]) / 2) / 1.2
    assert abs(run.resultants(beam).at(0.0).Q[-1]) == pytest.approx(6.0 * abs(mean), rel=1e-2)


def test_a_free_body_stays_behind_by_the_integrals_of_a_record_that_jumps():
    scene, body = held_body((0, 0), mass=M, inertia=1.0)
    scene.shake(y=([0.1, 0.3, 0.3, 0.5], [2.0, 2.0, -1.0, -1.0]))
    motion = fb.simulate(scene, dt=0.05, t_end=1.0)
    v = -np.interp(motion.t, [0.1, 0.3, 0.5], [0, 0.4, 0.2])
    assert motion.velocity(body)[:, 1] == pytest.approx(v, abs=1e-14)
    # Mean rates, which are exact for these straight pieces.
    fallen = np.append(0, np.cumsum((v[1:] + v[:-1]) / 2 * 0.05))
    assert motion.displacement(body)[:, 1] == pytest.approx(fallen, abs=1e-14)


def frame(scene):
    """Two columns with a girder, on two supports, and a pendulum that starts aslant."""
    section = fb.Section(EA=2e5, GA=2e5, EI=60.0, rhoA=1.5, rhoI=1e-3, retardation=1e-3)
    left = scene.add_beam([(0, 0), (0, 1)], section, elements=3)
    girder = scene.add_beam([left.end, (1.5, 1.1)], section, elements=3)
    right = scene.add_beam([girder.end, (1.5, 0)], section, elements=3)
    hung = scene.add_body((0.8, 0.6), 0.8, 0.02, points={"hook": (1.5, 1.1)})
    scene.add_joint(fb.Revolute(girder.end, hung["hook"]))
    return left.start, right.end, girder.end, hung.centre


def test_a_frame_with_a_turning_body_moves_as_on_supports_that_are_moved():
    def ground(t):  # the base starts at rest
        return 0.05 * (1 - np.cos(11 * t)), 0.03 * (1 - np.cos(8 * t))

    def acceleration(t):
        return 0.05 * 121 * np.cos(11 * t), 0.03 * 64 * np.cos(8 * t)

    differences = []
    for dt in (4e-3, 2e-3):
        shaken, moved = (fb.Scene(gravity=(0, -9.81)) for _ in range(2))
        *supports, corner, hung = frame(shaken)
        for node in supports:
            shaken.clamp(node)
        shaken.shake(x=lambda t: acceleration(t)[0], y=lambda t: acceleration(t)[1])
        relative = fb.simulate(shaken, dt=dt, t_end=1.0)
        *supports, corner_there, hung_there = frame(moved)
        for node in supports:
            moved.fix(node, "rotation")
            moved.prescribe(node, x=lambda t: ground(t)[0], y=lambda t: ground(t)[1])
        absolute = fb.simulate(moved, dt=dt, t_end=1.0)
        base = np.transpose(ground(relative.t))
        pairs = (corner, corner_there), (hung, hung_there)
        differences.append(
            max(
                abs(relative.displacement(a) + base - absolute.displacement(b)).max()
                for a, b in pairs
            )
        )
        turned = absolute.rotation(hung_there)
        assert np.ptp(turned) > 0.5
        assert abs(relative.rotation(hung) - turned).max() < 0.05
        energy = relative.energy
        assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic.max()
    assert differences[1] < 2e-4
    assert np.log2(differences[0] / differences[1]) == pytest.approx(2, abs=0.3)


def test_shaking_is_gravity_that_changes_the_other_way():
    scene, body = oscillator(x=lambda t: 2 * np.sin(t), y=lambda t: 3.0 * t)
    other, _ = oscillator(x=0.0)
    other.gravity = lambda t: (-2 * np.sin(t), -3.0 * t)
    one, two = (fb.simulate(each, dt=0.01, t_end=1.0) for each in (scene, other))
    assert one.q == pytest.approx(two.q, abs=1e-15)
    assert one.energy.work == pytest.approx(two.energy.work, abs=1e-15)
    rest = fb.static(scene, t=0.5)
    assert rest.displacement(body)[-1] == pytest.approx([-2 * np.sin(0.5) * M / K, -1.5 * M / K])
    other.gravity = (0.0, -9.81)
    assert fb.static(other).displacement(body)[-1] == pytest.approx([0, -9.81 * M / K])


def test_a_linear_system_has_the_base_as_an_input_and_is_the_frequency_response():
    scene, body = oscillator(x=fb.Input("quake"))
    system = fb.linearise(scene, outputs={"x": fb.Output("displacement", body, "x")})
    assert system.inputs == ("quake",)
    f = np.array([0.2, 1.5, 4.0])
    w, eye = 2j * np.pi * f, np.eye(len(system.A))
    transfer = [(system.C @ np.linalg.solve(s * eye - system.A, system.B))[0, 0] for s in w]
    assert transfer == pytest.approx(-1 / (w**2 + C / M * w + K / M), rel=1e-12)
    seen = fb.frequency_response(scene, at=body, frequencies=f, base=(1, 0)).component("x")
    assert (seen - 1) / w**2 == pytest.approx(np.array(transfer), rel=1e-12)
    driven = fb.simulate(scene, dt=0.01, t_end=1.0, inputs={"quake": lambda t: 2.0 * t})
    other, _ = oscillator(x=lambda t: 2.0 * t)
    assert driven.q == pytest.approx(fb.simulate(other, dt=0.01, t_end=1.0).q, abs=1e-14)


def test_derivatives_by_the_values_of_a_record_add_up_to_the_motion():
    """An oscillator is linear in its record: x(t) = sum of dx/da a."""

    def build(a):
        scene, body = oscillator(x=(RECORD[0], a))
        return scene, {"x": fb.Output("displacement", body, "x")}

    run = fb.Response(build, dt=0.01, t_end=1.5)
    computed = run(RECORD[1])[1]
    assert run.jacobian()["x"] @ RECORD[1] == pytest.approx(computed["x"], abs=1e-14)
    gradient = run.vjp({"x": np.ones_like(computed["x"])})
    assert gradient == pytest.approx(run.jacobian()["x"].sum(axis=0), rel=1e-10)


def test_shakings_add_up_are_copied_changed_and_removed():
    scene, body = oscillator(x=RECORD)
    once = fb.simulate(scene, dt=0.01, t_end=1.0).q
    more = scene.shake(x=(RECORD[0], 2 * RECORD[1]))
    thrice = fb.simulate(scene, dt=0.01, t_end=1.0).q
    assert thrice == pytest.approx(3 * once, abs=1e-14)
    twin = pickle.loads(pickle.dumps(copy.deepcopy(scene)))
    assert np.array_equal(fb.simulate(twin, dt=0.01, t_end=1.0).q, thrice)
    scene.change(more.x, lambda t: np.interp(t, *RECORD, left=0, right=0))
    assert fb.simulate(scene, dt=0.01, t_end=1.0).q == pytest.approx(2 * once, abs=1e-14)
    scene.remove(scene.loads[-1])
    assert fb.simulate(scene, dt=0.01, t_end=1.0).q == pytest.approx(once, abs=1e-15)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_a_large_structure_in_any_units(unit):
    """1000 elements under a slow push of the base bend as under their weight."""
    a, L, EI, rhoA = 1e-3, 2.0 * unit, 1e3 * unit**3, 1.3 / unit
    data = {"EA": 1e9 * unit, "GA": 1e9 * unit, "rhoI": 0.0}
    scene, beam = clamped_bar((L, 0), fb.Section(EI=EI, rhoA=rhoA, **data), elements=1000)
    scene.shake(y=a * unit)
    sunk = fb.static(scene, load_steps=1).displacement(beam.end)[-1, 1]
    assert sunk == pytest.approx(-rhoA * a * unit * L**4 / (8 * EI), rel=1e-4)


def test_a_base_without_masses_on_it_is_warned_of(caplog):
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=1)
    scene.shake(x=3.0)
    fb.static(scene)
    assert "shaking along x acts on no mass" in caplog.text
