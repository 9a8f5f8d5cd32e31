"""Friction that sticks with a damping of its own: a bead on a swinging rod, and what it holds."""

from math import sqrt

import numpy as np
import pytest
from derivatives import difference
from scenes import clamped_bar, guided_body, held_body, hinged_body
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import fx_beam as fb

MU, GRAVITY, PLACE, SWING, RATE, END = 0.4, 9.81, 0.5, 0.7, 4.0, 2.5
BEAM = fb.Section(EA=1e5, GA=4e4, EI=10.0, rhoA=1.0, rhoI=1e-3)


def angle(t):
    """Of the rod, which swings about the horizontal; its rate and acceleration."""
    s, c, of_rate = np.sin(RATE * t), np.cos(RATE * t), 3 * SWING * RATE
    return SWING * s**3, of_rate * s**2 * c, of_rate * RATE * s * (2 * c**2 - s**2)


def forces(t, r, rate=0.0):
    """On a bead of 1 kg along the rod, without friction, and the largest friction."""
    turn, spin, bend = angle(t)
    across = r * bend + 2 * rate * spin + GRAVITY * np.cos(turn)
    return r * spin**2 - GRAVITY * np.sin(turn), MU * abs(across)


def slip(t, r, end):
    """Places and speeds from a time at which the bead begins to slip, until it stops."""
    sign = np.sign(forces(t, r)[0])

    def rates(t, y):
        force, most = forces(t, *y)
        return y[1], force - sign * most

    def stops(t, y):
        return sign * y[1] + 1e-12

    stops.terminal, stops.direction = True, -1
    options = {"rtol": 1e-10, "atol": 1e-13, "events": stops, "dense_output": True}
    return solve_ivp(rates, (t, end), [r, 0.0], **options)


def exact(times):
    """Places of the bead at some times with rigid friction, and how often it begins to slip."""

    def beyond(t, r):
        along, most = forces(t, r)
        return abs(along) - most

    t, r, slips, places = 0.0, PLACE, 0, np.full(len(times), PLACE)
    while t < times[-1]:
        grid = np.linspace(t, times[-1], 100_001)
        out = np.flatnonzero(beyond(grid, r) > 0)
        if not len(out):
            break
        if out[0]:
            t = brentq(beyond, grid[out[0] - 1], grid[out[0]], args=(r,), xtol=1e-14)
        part, slips = slip(t, r, times[-1]), slips + 1
        inside = (times >= t) & (times <= part.t[-1])
        if inside.any():
            places[inside] = part.sol(times[inside])[0]
        t, r = part.t[-1], part.y[0, -1]
        places[times > t] = r
    return places, slips


def bead(stiffness, **damping):
    scene, rod = held_body((0, 0), 1.0, 1.0, "x", "y", gravity=(0, -GRAVITY))
    scene.prescribe(rod, rotation=lambda t: angle(t)[0])
    bead = scene.add_body((PLACE, 0), mass=1.0, inertia=1e-3).centre
    friction = fb.Coulomb(MU, stiffness, **damping)
    return scene, scene.add_joint(fb.Prismatic(rod, bead, axis=(1, 0), friction=friction))


def error(dt, scheme, stiffness=1e5, **damping):
    """Largest error of the place of the bead [m], and the solution."""
    scene, rail = bead(stiffness, **damping)
    solution = fb.simulate(scene, scheme, dt=dt, t_end=END)
    places, slips = exact(solution.t)
    assert slips == 6
    return abs(solution.joint(rail).slide - places).max(), solution


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying()], ids=str)
def test_short_steps_leave_no_error_but_that_of_the_bristle(scheme):
    soft, solution = error(2.5e-4, scheme)
    assert soft < 3.5e-4
    assert error(2.5e-4, scheme, 1e6)[0] < soft / 4
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-8


def test_a_bristle_vibrates_as_a_damped_spring_with_errors_of_second_order():
    w, zeta, speed, t = sqrt(1e4), 0.2, 0.01, 0.05
    free = w * sqrt(1 - zeta**2)
    expected = speed / free * np.exp(-zeta * w * t) * np.sin(free * t)
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        friction = fb.Coulomb(MU, 1e4, damping=2 * zeta / w)
        scene, block, _ = guided_body((0, 0), 1.0, 0.1, friction=friction, gravity=(0, -GRAVITY))
        scene.set_velocity(block, (speed, 0.0))
        solution = fb.simulate(scene, dt=dt, t_end=t)
        errors.append(abs(solution.displacement(block)[-1, 0] - expected))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2, abs=0.1)
    values = np.linalg.eigvals(fb.linearise(scene, state=solution).A)
    assert abs(values - (-zeta * w + 1j * free)).min() < 1e-6 * w


def test_critical_damping_is_that_of_the_mass_which_the_spring_holds():
    law = fb.Coulomb(0.3, 1e4, radius=0.02)
    scene, bob, pin = hinged_body(
        (0.5, 0), 2.0, 0.05, {"pin": (0, 0)}, friction=law, gravity=(0, -GRAVITY)
    )
    cart = scene.add_body((3, 0), mass=5.0, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, cart, axis=(1, 0)))
    rider = scene.add_body((3, 0), mass=3.0, inertia=0.1).centre
    rail = fb.Prismatic(cart, rider, axis=(0, 1), friction=fb.Coulomb(0.3, 1e4))
    rail = scene.add_joint(rail)
    ball = scene.add_body((6, 1), mass=4.0, inertia=0.1).centre
    hit = fb.Coulomb(0.3, 1e4)
    scene.add_contact(ball, fb.Circle(cart, 0.1), stiffness=1e4, friction=hit)
    friction = fb.Coulomb(0.3, 1e4, damping=0.125)
    scene.add_contact(ball, fb.Line((0, -9), (0, 1)), stiffness=1e4, friction=friction)
    bed = scene.add_beam([(8, 0), (9, 0)], BEAM, elements=4)
    scene.clamp(bed.start)
    scene.add_contact(ball, bed, stiffness=1e4, radius=(0.0, 0.2), friction=hit)
    damping = fb.simulate(scene, dt=1e-3, t_end=2e-3).stats.friction_damping
    # The rider moves with the cart along x; of a cart and a ball the reduced mass counts.
    masses = [2.0 * 0.5**2 + 0.05, 3.0, 1 / (1 / 4.0 + 1 / 8.0), 1e4 * 0.125**2 / 4, 4.0]
    expected = [2 * sqrt(mass / 1e4) for mass in masses]
    assert [low for low, _ in damping.values()] == pytest.approx(expected, rel=1e-12)
    joints = [f"joint {pin.number} rotation", f"joint {rail.number} slide"]
    assert [*damping] == [*joints, *map(str, scene.contacts)]


def test_critical_damping_does_not_depend_on_the_order_of_bodies_and_joints():
    """Of two free bodies on a slide, with its reduced mass, and of loops, free or grounded."""
    corners = [(0, 0), (0.2, 0.6), (1.1, 0.8), (1.0, 0)]
    places = {"first": (0, 1), "middle": (1, 2), "last": (2, 3), "base": (0, 3)}

    def loop(names, joints, free):
        scene, bars, number = fb.Scene(gravity=(0, -GRAVITY)), {}, {}
        for name in names:
            a, b = (corners[k] for k in places[name])
            centre = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2 - 0.1)
            points = {"a": a, "b": b}
            if free or name != "base":
                bars[name] = scene.add_body(centre, len(name), inertia=0.1, points=points)
        base = bars.get("base", dict.fromkeys("ab", fb.GROUND))
        first, middle, last = bars["first"], bars["middle"], bars["last"]
        every = [(base["a"], first["a"]), (first["b"], middle["a"])]
        every += [(middle["b"], last["a"]), (base["b"], last["b"])]
        for k in joints:
            pin = fb.Revolute(*every[k], friction=fb.Coulomb(0.1, 1e4, radius=0.1))
            number[f"joint {scene.add_joint(pin).number} rotation"] = k
        ground, friction = fb.Line((0, -9), (0, 1)), fb.Coulomb(0.1, 1e4)
        scene.add_contact(first.centre, ground, 1e4, friction=friction)
        scene.add_force(last.centre, (3.0, 1.0))
        damping = fb.simulate(scene, dt=1e-4, t_end=1e-4).stats.friction_damping
        return [damping[key][0] for key in sorted(damping, key=lambda key: number.get(key, 9))]

    orders = [[0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]]
    for free in (False, True):
        ways = [loop([[*places][k] for k in order], order[::-1], free) for order in orders]
        assert ways[1:] == [pytest.approx(ways[0], rel=1e-9)] * 2
    for masses in ((1.0, 5.0), (5.0, 1.0)):
        scene = fb.Scene(gravity=(0, -GRAVITY))
        a, b = (scene.add_body((0, 0), mass, inertia=0.1).centre for mass in masses)
        scene.add_joint(fb.Prismatic(a, b, axis=(1, 0), friction=fb.Coulomb(0.3, 1e4)))
        ((damping, _),) = fb.simulate(scene, dt=1e-3, t_end=1e-3).stats.friction_damping.values()
        assert damping == pytest.approx(2 * sqrt(5 / 6 / 1e4), rel=1e-12)


def test_critical_damping_is_the_same_in_all_directions():
    """A node on a guide that is turned, and stopped by a line along it."""
    damping = []
    for turn in (0.0, 0.7, np.pi / 4):
        along, across = (np.cos(turn), np.sin(turn)), (-np.sin(turn), np.cos(turn))
        scene, body, _ = guided_body((0, 0), 2.0, 0.1, axis=along)
        line = fb.Line((0, 0), across)
        scene.add_contact(body, line, stiffness=1e5, friction=fb.Coulomb(0.3, 1e4))
        damping.append(fb.simulate(scene, dt=1e-3, t_end=1e-3).stats.friction_damping)
    values = [next(iter(values_of_scene.values())) for values_of_scene in damping]
    assert values[1:] == [pytest.approx(values[0], rel=1e-12)] * 2


@pytest.mark.parametrize("stiffness", [1e5, 1e7])
def test_gradients_by_a_mass_see_its_critical_damping_on_members(stiffness):
    """Of a ball that slides on a beam. The numbers of a contact have different units."""

    def build(x):
        section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-3)
        scene, bed = clamped_bar([(-0.5, 0), (0.5, 0)], section, elements=10, gravity=(0.0, -9.81))
        scene.clamp(bed.end)
        ball = scene.add_body((0.02, 0.02), mass=0.2 * x[0], inertia=1e-4).centre
        scene.fix(ball, "rotation")
        scene.add_force(ball, lambda t: (1.5 * np.sin(300 * t), -20.0))
        friction = fb.Coulomb(0.9, stiffness)
        scene.add_contact(ball, bed, stiffness, radius=(0.01, 0.01), friction=friction)
        return scene, {"x": fb.Output("velocity", ball, "x")}

    run = fb.Response(build, dt=2e-4, t_end=0.02)
    run([1.0])
    J = run.jacobian()["x"][:, 0]
    expected = difference(lambda step: run([1.0 + step])[1]["x"], 1e-4)
    assert abs(J - expected).max() < 5e-3 * abs(expected).max()
