"""Long chains and loops of rigid bodies: cost in proportion to the bodies, the same mechanics."""

import gc
import tracemalloc

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from jointed import chain as links
from plain_step import assert_balanced

import fx_beam as fb
from fx_beam.step.program import PROGRAMS

MASS, LENGTH, GRAVITY = 2.0, 0.1, 10.0
SOFT = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)


def add_link(scene, start, end, inertia):
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    return scene.add_body(middle, MASS, inertia, points={"start": start, "end": end})


def chain(n, direction=(1.0, 0.0), inertia=1e-3, hang=True, joint=fb.Revolute, **options):
    """A chain of links from the origin, with the points at its end."""
    scene, last, ends = fb.Scene(gravity=(0, -GRAVITY) if hang else (0, 0)), None, []
    step = LENGTH * np.array(direction)
    for k in range(n):
        link = add_link(scene, tuple(k * step), tuple((k + 1) * step), inertia)
        if last is not None:
            scene.add_joint(joint(last, link["start"], **options))
        elif hang:
            scene.pin(link["start"])
        last = link["end"]
        ends.append(last)
    return scene, ends


def ring(n, inertia=1e-3, spin=0.0):
    """A closed ring of links that hangs on one of its hinges, and turns about it."""
    scene, radius = fb.Scene(gravity=(0, -GRAVITY)), n * LENGTH / 6
    angles = 2 * np.pi * np.arange(n) / n
    corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    links = [add_link(scene, tuple(corners[k - 1]), tuple(corners[k]), inertia) for k in range(n)]
    scene.pin(links[0]["start"])
    for k in range(n):
        scene.add_joint(fb.Revolute(links[k - 1]["end"], links[k]["start"]))
    for body in scene.bodies:
        for node in body.nodes:
            arm = np.array([node.x, node.y]) - corners[-1]
            scene.set_velocity(node, (-spin * arm[1], spin * arm[0]), spin=spin)
    return scene


def accelerations(angles, rates, inertia):
    """Of a chain of links that hangs on a pin, from Lagrange's equations for its angles."""
    n, length = len(angles), LENGTH
    i = np.arange(n)
    # Mass that follows the end of link max(i, j), and half of that link's own.
    coupled = MASS * length**2 * (n - np.maximum.outer(i, i) - 0.5)
    np.fill_diagonal(coupled, MASS * length**2 * (n - i - 0.75) + inertia)
    off = np.subtract.outer(angles, angles)
    torque = -(coupled * np.sin(off)) @ rates**2
    torque -= MASS * GRAVITY * length * (n - i - 0.5) * np.cos(angles)
    return np.linalg.solve(coupled * np.cos(off), torque)


@pytest.mark.parametrize("inertia", [2e-3, 0.0])
def test_a_long_chain_starts_with_the_accelerations_of_lagrange(inertia):
    n, rates = 40, np.random.default_rng(0).uniform(-1, 1, 40)
    scene, _ = chain(n, direction=(0.6, 0.8), inertia=inertia)
    start = np.zeros(2)
    for body, rate in zip(scene.bodies, rates, strict=True):
        step = LENGTH * rate * np.array([-0.8, 0.6])
        for node, part in ((body.centre, 0.5), (body["start"], 0.0), (body["end"], 1.0)):
            scene.set_velocity(node, tuple(start + part * step), spin=rate)
        start = start + step
    solution = fb.simulate(scene, dt=1e-4, t_end=1e-4)
    centres = [body.centre.number for body in scene.bodies]
    angles = np.full(n, np.arctan2(0.8, 0.6))
    expected = accelerations(angles, rates, inertia)
    assert solution.a[0, centres, 2] == pytest.approx(expected, abs=1e-6 * abs(expected).max())


def test_a_long_chain_moves_as_lagrange_says():
    n, t_end, inertia = 20, 0.2, 2e-3
    scene, _ = chain(n, inertia=inertia)

    def rates(t, z):
        return np.append(z[n:], accelerations(z[:n], z[n:], inertia))

    start, tight = np.zeros(2 * n), {"rtol": 1e-11, "atol": 1e-12}
    exact = scipy.integrate.solve_ivp(rates, (0, t_end), start, "DOP853", **tight)
    centres = [body.centre.number for body in scene.bodies]
    solution = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.002, t_end=t_end)
    assert "sparse" in solution.stats.solver
    assert solution.q[-1, centres, 2] == pytest.approx(exact.y[:n, -1], abs=1e-7)
    assert abs(solution.energy.balance_error).max() < 1e-11 * MASS * n * GRAVITY * LENGTH


def four_bars(n):
    """Mechanisms of three links and the ground, beside each other."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    for k in range(n):
        x = 0.5 * k
        corners = [(x, 0), (x + 0.03, 0.1), (x + 0.2, 0.12), (x + 0.2, 0)]
        links = [add_link(scene, *corners[i : i + 2], 1e-3) for i in range(3)]
        scene.pin(links[0]["start"])
        for one, other in zip(links[:-1], links[1:], strict=True):
            scene.add_joint(fb.Revolute(one["end"], other["start"]))
        scene.add_joint(fb.Revolute(links[2]["end"], fb.GROUND))
    return scene


def ladder(n):
    """Two chains side by side with a rung at each hinge: loops with two links in common."""
    scene, ends = fb.Scene(gravity=(0, -GRAVITY)), [None, None]
    for x in LENGTH * np.arange(n):
        for side, y in enumerate((0.0, LENGTH)):
            link = add_link(scene, (x, y), (x + LENGTH, y), 1e-3)
            scene.add_joint(fb.Revolute(ends[side], link["start"])) if x else scene.pin(
                link["start"]
            )
            ends[side] = link["end"]
        rung = add_link(scene, (x + LENGTH, 0.0), (x + LENGTH, LENGTH), 1e-3)
        scene.add_joint(fb.Revolute(ends[0], rung["start"]))
        scene.add_joint(fb.Revolute(ends[1], rung["end"]))
    return scene


def chain_with_a_bead(n):
    """A long chain that ends in a beam, on which a mass slides, beside a four-bar."""
    scene = chain(n)[0]
    end = scene.bodies[-1].nodes[-1]
    beam = scene.add_beam([end, (end.x + 2.0, end.y)], SOFT, elements=12)
    place = end.x + 0.6
    bead = scene.add_beam([(place, end.y), (place, end.y + 0.3)], SOFT, elements=1)
    scene.add_mass(bead.start, 0.5, inertia=0.05)
    scene.add_joint(fb.Sleeve(beam, bead.start))
    bars = links(scene, [(5, 0), (5, 0.2), (5.3, 0.2), (5.3, 0)])
    scene.pin(bars[0]["a"])
    scene.add_joint(fb.Revolute(fb.GROUND, bars[-1]["b"]))
    return scene


HELD = {"spring": fb.Spring(1e3), "damper": fb.Damper(1.0)}
MADE = {
    "chain": lambda n: chain(n)[0],
    "telescope": lambda n: chain(n, joint=fb.Prismatic, axis=(1, 0), **HELD)[0],
    "driven": lambda n: chain(n, motor=lambda t: 0.1 * t**2)[0],
    "ring": lambda n: ring(n, spin=1.5),
    "four-bars": four_bars,
    "ladder": ladder,
    "bead": chain_with_a_bead,
}


@pytest.mark.parametrize("made", MADE)
def test_long_chains_and_loops_are_in_balance_and_stay_together(made):
    n = 12 if made in ("ring", "four-bars", "ladder") else 25
    scene = MADE[made](n)
    run = {"dt": 0.005, "t_end": 0.05}
    assert_balanced(scene, **run)
    solution = fb.simulate(scene, **run)
    assert solution.stats.newton_iterations <= 4.5 * 10
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * max(energy.kinetic.max(), 1.0)
    assert max(solution.joint(joint).gap.max() for joint in scene.joints) < 1e-13


def memory(scene):
    """Largest memory in use in a run of two steps [B]."""
    gc.collect()
    tracemalloc.start()
    fb.simulate(scene, dt=0.001, t_end=0.002)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


@pytest.mark.parametrize(
    ("made", "n"), [("chain", 60), ("telescope", 60), ("ring", 60), ("bead", 60), ("four-bars", 15)]
)
def test_the_memory_for_long_chains_and_loops_grows_in_proportion_to_the_bodies(
    made, n, monkeypatch
):
    # In proportion it doubles; with sums over all links it is eightfold. The first fills caches.
    monkeypatch.setattr(PROGRAMS, "size", 0)  # each scene is set up anew
    fb.simulate(MADE[made](n), dt=0.001, t_end=0.002)
    few, many = (memory(MADE[made](k)) for k in (n, 2 * n))
    assert many < 3 * few


def test_the_tangent_of_long_loops_is_regular_without_rotary_inertia():
    scene = ring(12, inertia=0.0)
    solution = fb.simulate(scene, dt=0.005, t_end=0.1)
    assert "sparse" in solution.stats.solver and not solution.stats.halvings
    assert abs(solution.energy.balance_error).max() < 1e-11 * solution.energy.kinetic.max()
    assert max(abs(solution.joint(joint).gap).max() for joint in scene.joints) < 1e-14


def spring_chain(n):
    """Links with springs in their hinges, behind one that is clamped."""
    scene, ends = chain(n, hang=False, spring=fb.Spring(40.0))
    scene.clamp(scene.bodies[0]["start"])
    return scene, ends


@pytest.mark.parametrize("options", [{}, {"continuation": "arc-length"}])
def test_springs_of_a_long_chain_carry_the_moments_of_its_load(options):
    scene, ends = spring_chain(20)
    scene.add_force(ends[-1], (0.0, -10.0))
    solution = fb.static(scene, load_steps=10, **options)
    turns = solution.q[-1, [body.centre.number for body in scene.bodies], 2]
    across = np.array([solution.position(end)[-1, 0] for end in ends])
    assert turns[-1] < -0.3
    assert 40.0 * np.diff(turns) == pytest.approx(-10.0 * (across[-1] - across[:-1]), abs=1e-7)


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_a_long_driven_chain_hangs_with_its_centre_below_the_pin(continuation):
    scene = MADE["driven"](25)
    hanging = fb.static(scene, t=1.0, continuation=continuation)
    centres = hanging.q[-1, [body.centre.number for body in scene.bodies]]
    centres[:, :2] += [(body.centre.x, body.centre.y) for body in scene.bodies]
    assert np.diff(centres[:, 2]) == pytest.approx(0.1, abs=1e-12)
    assert abs(centres[:, 0].mean()) < 1e-9 and centres[:, 1].mean() < -0.3


@pytest.mark.parametrize("n", [8, 9, 12, 13, 16, 19])
def test_rings_of_any_number_of_links_move_wherever_they_are_cut(n):
    """At the cut the gap may be that of auxiliary unknowns alone."""
    cut = ring(n)
    joints = [joint for joint in cut.joints if joint.kind == "Revolute"]
    cut.remove(*joints)
    cut.free(joints[0].b)
    cut.add_joint(fb.Revolute(fb.GROUND, joints[0].b))
    for joint in (*joints[1:], joints[0]):
        cut.add_joint(fb.Revolute(joint.a, joint.b))
    solution, expected = (fb.simulate(scene, dt=0.005, t_end=0.05) for scene in (cut, ring(n)))
    assert abs(solution.q - expected.q).max() < 1e-9
    assert abs(solution.energy.balance_error).max() < 1e-11


@pytest.mark.parametrize("lightest", [1.0, 1e-6])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_small_vibrations_of_a_long_hanging_chain(unit, lightest):
    # T = sum m |v|^2 / 2 + J w^2 / 2 and V = sum m g L (1 - cos) in the angles from the vertical.
    n, g, length = 40, 9.81, unit
    masses = np.where(np.arange(n) % 2, lightest, 1.0)
    inertia = 0.1 * masses * length**2
    scene, last = fb.Scene(gravity=(0, -g)), None
    for k, (mass, J) in enumerate(zip(masses, inertia, strict=True)):
        y = -k * length
        points = {"top": (0, y), "end": (0, y - length)}
        link = scene.add_body((0, y - length / 2), mass, J, points=points)
        if last is None:
            scene.pin(link["top"])
        else:
            scene.add_joint(fb.Revolute(last["end"], link["top"]))
        last = link
    # Of the centre of each link by the angles of the links above it.
    arms = length * (np.tri(n) - np.eye(n) / 2)
    M = arms.T @ (masses[:, None] * arms) + np.diag(inertia)
    K = g * np.diag(masses @ arms)
    lowest = fb.modes(scene, fb.static(scene, load_steps=1), n=5)
    squares = scipy.linalg.eigh(K, M, eigvals_only=True)[:5]
    assert lowest.angular_frequencies == pytest.approx(np.sqrt(squares), rel=1e-9)
