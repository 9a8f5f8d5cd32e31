"""Wheels, balls and thick members that roll and slip on members, against closed forms."""

import json

import numpy as np
import pytest
from scenes import assert_refused
from scipy.special import ellipk

import fx_beam as fb

G, MASS = 9.81, 2.0
STIFF = fb.Section(EA=1e8, GA=1e8, EI=1e6, rhoA=10.0)
LIGHT = fb.Section(EA=1e8, GA=1e8, EI=1e6, rhoA=1e-9)
FLEXIBLE = fb.Section(EA=1e4, GA=4e3, EI=50.0, rhoA=2.0, rhoI=1e-2)


def held_deck(scene, axis, **size):
    """A member whose nodes are clamped."""
    deck = scene.add_beam(axis, STIFF, **size)
    for node in deck.nodes:
        scene.clamp(node)
    return deck


def wheel_at(scene, place, R):
    """A disc of 2 kg."""
    return scene.add_body(place, MASS, MASS * R**2 / 2).centre


def last_acceleration(values, t):
    """Slopes (k,) of the lines that fit the second half of values (n, k)."""
    half = len(t) // 2
    return np.polyfit(t[half:], values[half:], 1)[0]


# -- On members that are held ---------------------------------------------------------------------


@pytest.mark.parametrize("drawn", [1, -1])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("mu", "thickness"), [(0.6, 1e-9), (0.6, 0.1), (0.05, 1e-9), (0.05, 0.1)])
def test_a_wheel_rolls_or_slips_down_a_member_as_a_rigid_one(mu, thickness, side, drawn):
    """g sin / (1 + J/m R^2), or g (sin - mu cos); on both sides, drawn either way."""
    R, r, slope, inertia = 0.2, thickness / 2, 0.3, MASS * 0.2**2 / 2
    scene = fb.Scene(gravity=(G * np.sin(slope), -side * G * np.cos(slope)))
    wheel = wheel_at(scene, (0, side * (R + r + 1e-9)), R)
    deck = held_deck(scene, [(-0.5, 0), (3, 0)][::drawn], elements=20)
    scene.add_contact(wheel, deck, 1e8, radius=(R, r), friction=fb.Coulomb(mu, 1e8))
    motion = fb.simulate(scene, dt=2e-3, t_end=0.5)
    along = G * np.sin(slope) / (1 + inertia / (MASS * R**2))
    spins = along / R
    if mu < 0.1:
        normal = MASS * G * np.cos(slope)
        along, spins = G * (np.sin(slope) - mu * np.cos(slope)), mu * normal * R / inertia
    gains = last_acceleration(motion.v[:, wheel.number], motion.t)[[0, 2]]
    assert gains == pytest.approx([along, -side * spins], rel=1e-4)
    assert abs(motion.energy.balance_error).max() < 1e-12 * motion.energy.kinetic[-1]


def test_a_wheel_on_a_member_moves_as_on_a_line():
    def moved(on_line):
        scene = fb.Scene(gravity=(2.0, -G))
        wheel = wheel_at(scene, (0, 0.2 + 2e-9), 0.2)
        law = {"stiffness": 1e7, "friction": fb.Coulomb(0.4, 1e7, damping=1e-3)}
        if on_line:
            scene.add_contact(wheel, fb.Line((0, 0), (0, 1)), radius=0.2, **law)
        else:
            deck = held_deck(scene, [(-1, 0), (3, 0)], elements=20)
            scene.add_contact(wheel, deck, radius=(0.2, 1e-9), **law)
        scene.set_velocity(wheel, (0.5, 0.0), spin=20.0)
        return fb.simulate(scene, dt=1e-3, t_end=0.6).q[:, wheel.number]

    assert moved(on_line=False) == pytest.approx(moved(on_line=True), rel=1e-4, abs=5e-6)


def bowl(amplitude, stiffness=1e7, elements=40):
    """A disc in a bowl of radius 1 m, and the length of the pendulum that swings like it."""
    R, r, turn = 0.2, 0.02, 1.6
    scene = fb.Scene(gravity=(0, -G))
    far = (1 + r) / np.cos(turn / elements)  # the member runs through the middles of elements
    angle = turn * np.linspace(-1, 1, elements + 1)
    points = far * np.column_stack([np.sin(angle), -np.cos(angle)])
    deck = held_deck(scene, points, elements=elements)
    place = (1 - R - 1e-6) * np.array([np.sin(amplitude), -np.cos(amplitude)])
    wheel = wheel_at(scene, place, R)
    law = {"radius": (R, r), "friction": fb.Coulomb(2.0, stiffness)}
    scene.add_contact(wheel, deck, stiffness, **law)
    return scene, wheel, (1 - R) * 1.5


def test_a_disc_rolls_in_a_bowl_as_a_pendulum():
    """(Rb - R) (1 + J/m R^2); it turns by (Rb - R)/R times the angle."""
    errors = []
    for dt in (0.01, 0.005):
        scene, disc, length = bowl(0.8)
        half = 2 * np.sqrt(length / G) * ellipk(np.sin(0.4) ** 2)
        motion = fb.simulate(scene, dt=dt, t_end=1.6 * half)
        x, y = motion.position(disc).T
        angle = np.arctan2(x, -y)
        before = np.flatnonzero(np.diff(np.sign(angle)))
        share = angle[before] / (angle[before] - angle[before + 1])
        first, last = motion.t[before] + share * dt
        errors.append((last - first) / half - 1)
        turn = motion.rotation(disc)
        assert turn == pytest.approx(-0.8 / 0.2 * (angle - angle[0]), abs=3e-3)
    assert abs(errors[0]) < 1e-4
    assert abs(errors[1]) < 3e-5


def test_small_motions_of_a_disc_in_a_bowl_are_those_of_the_pendulum():
    scene, _, length = bowl(0.0, elements=120)
    state = fb.static(scene)
    w = np.sqrt(G / length)
    assert fb.modes(scene, state=state, n=1).angular_frequencies[0] == pytest.approx(w, rel=2e-4)
    values = np.linalg.eigvals(fb.linearise(scene, state=state).A)
    assert abs(values - 1j * w).min() < 2e-4 * w


@pytest.mark.parametrize("kind", [fb.EnergyMomentum(), fb.EnergyDecaying(), fb.HHT(-0.1)])
def test_a_platen_on_two_rollers_has_the_mass_of_rolling(kind):
    """P / (M + 2 (m/4 + J/4R^2)): rollers move half as far; both touch members on both sides."""
    R, M, push = 0.1, 5.0, 3.0
    scene = fb.Scene(gravity=(0, -G))
    deck = held_deck(scene, [(-0.5, 0), (1.5, 0)], elements=20)
    platen = scene.add_body((0.5, 2 * R + 4e-9), M, 1.0).centre
    plate = scene.add_beam([(0, 2 * R + 4e-9), (1, 2 * R + 4e-9)], LIGHT, elements=10)
    scene.fix(platen, "rotation")
    for node in plate.nodes:
        scene.add_joint(fb.Rigid(platen, node, offset=(node.x - 0.5, 0)))
    law = {"stiffness": 1e7, "radius": (R, 1e-9), "friction": fb.Coulomb(0.8, 1e7)}
    rollers = [wheel_at(scene, (x, R + 2e-9), R) for x in (0.25, 0.75)]
    for roller in rollers:
        scene.add_contact(roller, deck, **law)
        scene.add_contact(roller, plate, **law)
    scene.add_force(platen, (push, 0.0))
    motion = fb.simulate(scene, kind, dt=2e-3, t_end=0.6)
    gain = push / (M + 2 * (MASS / 4 + MASS / 8))
    speeds = motion.v[:, [platen.number, rollers[0].number], :]
    gains = [last_acceleration(speeds[:, k], motion.t)[c] for k, c in ((0, 0), (1, 0), (1, 2))]
    assert gains == pytest.approx([gain, gain / 2, -gain / (2 * R)], rel=1e-3)


def test_in_equilibrium_a_wheel_that_sticks_turns_against_a_spring():
    """A moment M turns it on a deck, a spring k holds its centre: M = k x R, and x = -R psi."""
    R, k, moment = 0.2, 500.0, 4.0
    scene = fb.Scene(gravity=(0, -G))
    wheel = wheel_at(scene, (0, R + 1e-9), R)
    deck = held_deck(scene, [(-0.5, 0), (0.5, 0)], elements=10)
    scene.add_contact(wheel, deck, 1e8, radius=(R, 1e-9), friction=fb.Coulomb(3.0, 1e9))
    scene.add_spring(wheel, x=fb.Spring(k))
    scene.add_moment(wheel, moment)
    state = fb.static(scene, load_steps=4)
    x, psi = state.displacement(wheel)[-1, 0], state.rotation(wheel)[-1]
    assert [x, psi] == pytest.approx([-moment / (k * R), moment / (k * R**2)], rel=1e-5)


def test_the_surface_of_a_thick_member_turns_with_its_sections():
    """A bar turns about its middle by phi below a block that is held: the slip is r sin phi."""
    r, R, phi = 0.05, 0.02, 0.1
    scene = fb.Scene()
    bar = scene.add_beam([(-0.5, 0), (0.5, 0)], STIFF, elements=8)
    scene.pin(bar.node(0.5))
    for node in bar.nodes:
        scene.prescribe(node, rotation=lambda t: phi * np.sin(np.pi * t / 2))
    block = scene.add_body((0, R + r - 1e-9), MASS, 1.0).centre
    scene.clamp(block)
    law = {"radius": (R, r), "friction": fb.Coulomb(0.5, 1e4, damping=0.0)}
    contact = scene.add_contact(block, bar, 1e4, **law)
    rubs = fb.simulate(scene, dt=0.01, t_end=1.0).contact(contact)
    assert rubs.normal.max() > 1.0
    way = (rubs.slip + rubs.stretch)[-1, 0]
    assert way == pytest.approx(-r * np.sin(phi), rel=1e-3)  # to the right


# -- On members that move -------------------------------------------------------------------------


def on_a_beam(ball_at, rates, law, drawn=1, free=False, gravity=-G):
    """A ball of radius 0.2 m on a flexible beam that is 0.1 m thick, and their contact."""
    scene = fb.Scene(gravity=None if free else (0, gravity))
    beam = scene.add_beam([(0, 0), (2, 0)][::drawn], FLEXIBLE, elements=8)
    if not free:
        scene.pin(beam.start)
        scene.pin(beam.end)
    ball = wheel_at(scene, ball_at, 0.2)
    (vx, vy, spin), (k, mu) = rates, law
    contact = scene.add_contact(ball, beam, k, radius=(0.2, 0.05), friction=fb.Coulomb(mu, 2e4))
    scene.set_velocity(ball, (vx, vy), spin=spin)
    return scene, ball, contact


def dropped(side=1, mu=0.4, **options):
    """A ball that spins, and hits the beam from one side."""
    rates = 1.0, -2.0 * side, 8.0 * side
    return on_a_beam((0.8, 0.26 * side), rates, (2e4, mu), gravity=-G * side, **options)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("mu", [0.1, 5.0])
def test_a_ball_and_a_free_beam_keep_energy_and_both_momenta(mu, side):
    """Energy with what friction takes."""
    scene, _, contact = dropped(side=side, free=True, mu=mu)
    motion = fb.simulate(scene, dt=2e-3, t_end=0.3)
    assert motion.contact(contact).normal.max() > 10
    assert abs(motion.contact(contact).tangential).max() > 1
    energy = motion.energy.kinetic[0]
    assert abs(motion.energy.balance_error).max() < 1e-12 * energy
    assert np.diff(motion.energy.dissipated).min() > -1e-13 * energy
    assert np.ptp(motion.linear_momentum, axis=0).max() < 1e-12 * abs(motion.linear_momentum).max()
    assert np.ptp(motion.angular_momentum) < 1e-11 * np.ptp(motion.q[:, -1])


@pytest.mark.parametrize("side", [1, -1])
def test_a_ball_rolls_over_a_beam_alike_however_it_is_drawn(side):
    ends = [fb.simulate(dropped(side, drawn=drawn)[0], dt=2e-3, t_end=0.4) for drawn in (1, -1)]
    balls = [motion.q[:, -1] for motion in ends]
    assert balls[1] == pytest.approx(balls[0], rel=1e-9, abs=1e-10)


def test_rolling_over_a_flexible_beam_has_order_two():
    """A ball of radius 0.2 m, over half of the elements of a beam on pins."""

    def ends(dt):
        scene, ball, _ = on_a_beam((0.4, 0.25 + 1e-9), (2.0, 0.0, -10.0), (2e3, 5.0))
        motion = fb.simulate(scene, dt=dt, t_end=0.4)
        middle = scene.beams[0].nodes[4]
        return np.concatenate([motion.q[-1, ball.number], motion.displacement(middle)[-1]])

    rows = [ends(dt) for dt in (8e-3, 4e-3, 2e-3, 1e-3)]
    changes = abs(np.diff(rows, axis=0)).max(axis=1)
    assert rows[-1][0] > 0.6
    assert np.log2(changes[0] / changes[2]) / 2 > 1.8


def test_a_file_of_version_1_1_has_no_slip_along_members(tmp_path):
    """It had the slip along the member as it is drawn."""
    scene, _, contact = dropped()
    fb.simulate(scene, dt=2e-3, t_end=0.1).save(tmp_path / "new.npz")
    assert fb.load(tmp_path / "new.npz").contact(contact).slip.any()
    with np.load(tmp_path / "new.npz") as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    del meta["turns_of_line"]
    np.savez(tmp_path / "old.npz", **arrays | {"meta": np.array(json.dumps(meta))})
    old = fb.load(tmp_path / "old.npz")
    assert_refused(
        "only one of a version before 1.2", lambda: old.contact(contact).slip, error=ValueError
    )
    assert_refused("no last state", fb.simulate, scene, start=old, dt=2e-3, t_end=0.2)
