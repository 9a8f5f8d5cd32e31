"""Friction that follows the force of its joint: exact solutions, invariants, bad input."""

from math import cos, sin

import numpy as np
import pytest

import fx_beam as fb

SOLVERS = pytest.mark.parametrize("solver", ["compiled", "petsc"])
GRAVITY = 9.81
BEAM = fb.Section(EA=1e5, GA=1e5, EI=1e3, rhoA=1.0, rhoI=0.1)


def block(friction, axis=(1, 0), load=None, velocity=(3.0, 0.0)):
    """A block of 2 kg on a rail of the ground."""
    scene = fb.Scene(gravity=None if load else (0, -GRAVITY))
    centre = scene.add_body((0, 0), mass=2.0, inertia=0.1).centre
    rail = scene.add_joint(fb.Prismatic(fb.GROUND, centre, axis=axis, friction=friction))
    if load:
        scene.add_force(centre, load)
    scene.set_velocity(centre, velocity)
    return scene, centre, rail


def pendulum(mu, radius=0.05):
    """A body of 2 kg and 0.05 kg m^2 that hangs by a pin with friction, at first level with it."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    body = scene.add_body((0.5, 0), mass=2.0, inertia=0.05, points={"pin": (0, 0)})
    friction = fb.Coulomb(mu, 1e4, radius=radius)
    pin = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"], friction=friction))
    return scene, body.centre, pin


def swing(mu, radius, t_end, dt=1e-3):
    """Angle and spin of the pendulum before it first stops: by the rule of Runge and Kutta."""

    def rates(state):
        angle, spin = state
        spin_rate = 0.0
        for _ in range(30):  # the force depends on the acceleration
            x = -0.5 * (sin(angle) * spin_rate + cos(angle) * spin**2)
            y = 0.5 * (cos(angle) * spin_rate - sin(angle) * spin**2)
            moment = mu * radius * 2.0 * np.hypot(x, y + GRAVITY)  # the spin is negative
            spin_rate = (moment - 2.0 * GRAVITY * 0.5 * cos(angle)) / (0.05 + 2.0 * 0.25)
        return np.array([spin, spin_rate])

    state = np.zeros(2)
    for _ in range(round(t_end / dt)):
        k1 = rates(state)
        k2 = rates(state + dt / 2 * k1)
        k3 = rates(state + dt / 2 * k2)
        state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rates(state + dt * k3))
    return state


@SOLVERS
def test_a_block_on_a_rail_is_braked_by_its_weight(solver):
    scene, centre, rail = block(fb.Coulomb(0.2, 1e5))
    solution = fb.simulate(scene, dt=0.01, t_end=2.0, solver=solver)
    place = solution.position(centre)[:, 0]
    assert place[-1] == pytest.approx(3.0**2 / (2 * 0.2 * GRAVITY), rel=2e-3)
    v = solution.velocity(centre)[:, 0]
    assert (v[100] - v[0]) / solution.t[100] == pytest.approx(-0.2 * GRAVITY, rel=1e-4)
    assert np.ptp(place[-20:]) < 1e-10
    assert solution.stats.halvings == 0
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert solution.joint(rail).force[50, 1] == pytest.approx(2.0 * GRAVITY)


@SOLVERS
def test_the_friction_is_mu_times_the_force_of_the_same_step(solver):
    """Also in the steps behind a jump of the load."""

    def load(t):
        return (0.0, -10 - 8 * sin(5 * t) - 20 * (t > 0.405))

    scene, _, rail = block(fb.Coulomb(0.2, 1e5), load=load)
    solution = fb.simulate(scene, dt=0.01, t_end=0.6, solver=solver)
    along, across = abs(solution.joint(rail).force[1:, :2].T)
    assert np.ptp(across) > 20
    assert along == pytest.approx(0.2 * across, rel=1e-12)


def wedge(mu, speed, mass):
    """A block on an inclined rail of a cart of 1 kg that moves freely on the ground."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    axis = (cos(0.7), -sin(0.7))
    cart = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    block = scene.add_body((0, 0), mass=mass, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, cart, axis=(1, 0)))
    slide = fb.Prismatic(cart, block, axis=axis, friction=fb.Coulomb(mu, 1e6))
    rail = scene.add_joint(slide)
    scene.set_velocity(block, (speed * axis[0], speed * axis[1]))
    return scene, cart, rail


@SOLVERS
@pytest.mark.parametrize(("mu", "speed"), [(0.5, 1.0), (0.3, -3.0), (1.5, -3.0)])
def test_a_force_that_its_own_friction_changes_has_the_exact_acceleration(mu, speed, solver):
    """On a light cart, where the friction changes the normal force up to 1.3 times as much."""
    mass, s, c = 10.0, sin(0.7), cos(0.7)
    scene, cart, rail = wedge(mu, speed, mass)
    solution = fb.simulate(scene, dt=2e-3, t_end=0.1, solver=solver)
    signed = mu * np.sign(speed)
    normal = mass * GRAVITY * c / (1 - mass * s * (signed * c - s))
    gains = normal * (signed * c - s)
    force = solution.joint(rail).force[1:, :2]
    assert solution.stats.halvings == 0
    assert abs(force @ (s, c)) == pytest.approx(normal, rel=1e-9)
    bends = np.diff(solution.position(cart)[:, 0], 2) / 2e-3**2
    assert bends == pytest.approx(np.full(len(bends), gains), rel=1e-9)
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-10
    assert np.ptp(solution.linear_momentum[:, 0]) < 1e-10


def test_friction_that_follows_a_changing_force_is_of_second_order():
    errors = []
    exact = 3.0 - 0.2 / 2.0 * (10 * 0.8 + 8 / 5 * (1 - cos(5 * 0.8)))
    for dt in (0.02, 0.01, 0.005):
        scene, centre, _ = block(fb.Coulomb(0.2, 1e5), load=lambda t: (0, -10 - 8 * sin(5 * t)))
        solution = fb.simulate(scene, dt=dt, t_end=0.8)
        errors.append(abs(solution.velocity(centre)[-1, 0] - exact))
    assert errors[-1] < 1e-4
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2, abs=0.2)


@pytest.mark.parametrize("part", [0.9, 1.05])
def test_a_block_on_a_steep_rail_rests_or_slides(part):
    axis, mu = (cos(0.3), sin(0.3)), part * np.tan(0.3)
    scene, centre, _ = block(fb.Coulomb(mu, 1e5), axis, velocity=(0, 0))
    solution = fb.simulate(scene, dt=5e-3, t_end=2.0)
    place, v = solution.displacement(centre) @ axis, solution.velocity(centre) @ axis
    if part > 1:
        assert np.ptp(place[-100:]) < 1e-9
    else:
        slides = GRAVITY * (mu * cos(0.3) - sin(0.3))
        assert (v[-1] - v[100]) / 1.5 == pytest.approx(slides, rel=1e-9)


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_a_pin_brakes_by_mu_times_its_radius_times_its_force(dt):
    scene, centre, pin = pendulum(0.3)
    solution = fb.simulate(scene, dt=dt, t_end=0.8)
    angle, spin = swing(0.3, 0.05, 0.8)
    free_angle, _ = swing(0.0, 0.05, 0.8)
    assert abs(free_angle - angle) > 0.05
    assert solution.joint(pin).angle[-1] == pytest.approx(angle, abs=5 * dt**2)
    assert solution.v[-1, centre.number, 2] == pytest.approx(spin, abs=40 * dt**2)
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_a_pin_between_free_bodies_keeps_both_momenta():
    scene = fb.Scene()
    one = scene.add_body((0, 0), mass=1.0, inertia=0.1, points={"pin": (0.5, 0)})
    other = scene.add_body((1, 0.1), mass=2.0, inertia=0.2, points={"pin": (0.5, 0)})
    friction = fb.Coulomb(0.5, 1e4, radius=0.1)
    scene.add_joint(fb.Revolute(one["pin"], other["pin"], friction=friction))
    scene.set_velocity(one, (0, 0.5), spin=1.0)
    scene.set_velocity(other, (0, 1.0), spin=3.0)
    scene.make_velocities_compatible()
    runs = [fb.simulate(scene, dt=0.01, t_end=2.0, solver=s) for s in ("compiled", "petsc")]
    solution = runs[0]
    assert solution.energy.dissipated[-1] > 0.02
    assert abs(solution.energy.balance_error).max() < 1e-12
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-12
    assert np.ptp(solution.angular_momentum) < 1e-12
    assert solution.q == pytest.approx(runs[1].q, abs=1e-9)


def on_a_beam(kind, mu, angle=0.3):
    """A body of 2 kg that slides down a straight, clamped beam."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    down = -np.array([cos(angle), sin(angle)])
    beam = scene.add_beam([(0, 0), tuple(8 * down)], BEAM, elements=4)
    for node in beam.nodes:
        scene.clamp(node)
    body = scene.add_body(tuple(down), mass=2.0, inertia=0.1).centre
    joint = scene.add_joint(kind(beam, body, friction=fb.Coulomb(mu, 1e5)))
    return scene, joint


@SOLVERS
@pytest.mark.parametrize("kind", [fb.Slider, fb.Sleeve])
@pytest.mark.parametrize("part", [0.9, 1.05])
def test_a_node_on_a_steep_beam_rests_or_slides(kind, part, solver):
    mu = part * np.tan(0.3)
    scene, joint = on_a_beam(kind, mu)
    solution = fb.simulate(scene, dt=5e-3, t_end=1.0, solver=solver)
    s = solution.slide(joint)
    if part > 1:
        assert np.ptp(s[-60:]) < 1e-9
    else:
        slides = GRAVITY * (sin(0.3) - mu * cos(0.3))
        bends = np.diff(s[50:], 2) / 5e-3**2
        assert bends == pytest.approx(np.full(len(bends), slides), rel=1e-6)
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-10


@pytest.mark.parametrize("kind", [fb.Slider, fb.Sleeve])
def test_friction_on_a_free_beam_keeps_both_momenta(kind):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (2, 0)], BEAM, elements=4)
    bead = scene.add_body((0.8, 0), mass=1.0, inertia=0.05).centre
    joint = scene.add_joint(kind(beam, bead, friction=fb.Coulomb(0.3, 1e4)))
    scene.set_velocity(bead, (1.0, 0.0), spin=2.0 if kind is fb.Sleeve else 0.0)
    for node in beam.nodes:
        scene.set_velocity(node, (0.0, 2.0 * (node.x - 0.8)), spin=2.0)
    solution, other = (
        fb.simulate(scene, dt=5e-3, t_end=0.5, solver=solver) for solver in ("compiled", "petsc")
    )
    assert np.ptp(solution.slide(joint)) > 0.2
    assert solution.energy.dissipated[-1] > 0.05
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert abs(solution.energy.balance_error).max() < 1e-10
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-11
    assert np.ptp(solution.angular_momentum) < 1e-11
    assert solution.q == pytest.approx(other.q, abs=1e-8)


def test_a_block_on_a_spring_turns_and_stops_where_it_should():
    """Half periods of pi / w, each with 2 mu N / k less; at rest below mu N / k."""
    scene = fb.Scene(gravity=(0, -GRAVITY))
    centre = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    spring, friction = fb.Spring(100.0, rest=-0.2), fb.Coulomb(0.3, 1e6)
    scene.add_joint(fb.Prismatic(fb.GROUND, centre, axis=(1, 0), spring=spring, friction=friction))
    solution = fb.simulate(scene, dt=5e-4, t_end=1.5)
    x, v, t = solution.position(centre)[:, 0] + 0.2, solution.velocity(centre)[:, 0], solution.t
    lost = 2 * 0.3 * GRAVITY / 100
    turns = np.flatnonzero(np.sign(v[1:-1]) * np.sign(v[2:]) < 0)[:2] + 1
    assert t[turns] == pytest.approx([np.pi / 10, 2 * np.pi / 10], abs=1e-3)
    assert x[turns] == pytest.approx([-(0.2 - lost), 0.2 - 2 * lost], abs=1e-5)
    assert x[-1] == pytest.approx(-(0.2 - 3 * lost), abs=3e-5)
    sticks = t[np.flatnonzero(abs(v) > 0.01)[-1]]
    assert sticks == pytest.approx(3 * np.pi / 10, abs=0.01)


def test_what_does_not_fit_is_named():
    node = fb.Scene().add_body((0, 0), 1.0).centre
    with pytest.raises(fb.SceneError, match="needs the radius of the pin"):
        fb.Revolute(fb.GROUND, node, friction=fb.Coulomb(0.3, 1e4))
    with pytest.raises(fb.SceneError, match="friction of a slide has no radius"):
        fb.Prismatic(fb.GROUND, node, axis=(1, 0), friction=fb.Coulomb(0.3, 1e4, 0.1))
    beam = fb.Scene().add_beam([(0, 0), (1, 0)], BEAM)
    with pytest.raises(fb.SceneError, match="Slider: friction of a slide has no radius"):
        fb.Slider(beam, node, friction=fb.Coulomb(0.3, 1e4, 0.1))
    with pytest.raises(fb.SceneError, match="radius = -1 must be finite and positive"):
        fb.Coulomb(0.3, 1e4, radius=-1)
    with pytest.raises(fb.SceneError, match=r"an fx_beam.Friction or an fx_beam.Coulomb"):
        fb.Revolute(fb.GROUND, node, friction=0.3)
    scene = fb.Scene()
    balls = [scene.add_body((x, 0), 1.0).centre for x in (0, 1)]
    with pytest.raises(fb.SceneError, match="needs a normal force"):
        scene.add_force_between(*balls, friction=fb.Coulomb(0.3, 1e4))
    floor = fb.Line((0, -1), (0, 1))
    with pytest.raises(fb.SceneError, match="has the radius of a pin"):
        scene.add_contact(balls[0], floor, stiffness=1.0, friction=fb.Coulomb(0.3, 1e4, 0.1))


def test_what_friction_of_joints_cannot_do_is_said():
    held = fb.Scene()
    slide = {"axis": (1, 0), "spring": fb.Spring(1e3), "friction": fb.Coulomb(0.2, 1e5)}
    held.add_joint(fb.Prismatic(fb.GROUND, held.add_body((0, 0), 1.0, 0.1).centre, **slide))
    with pytest.raises(fb.SceneError, match="arc-length steps do not find the force of a joint"):
        fb.static(held, continuation="arc-length")
    scene, _, _ = pendulum(0.3)
    with pytest.raises(fb.SceneError, match="goes back in time"):
        fb.simulate(scene, dt=0.01, t_end=0.1, scheme=fb.EnergyMomentum(order=4))


def test_single_steps_and_steps_of_a_tolerance_follow_the_force_as_well():
    scene, centre, _ = pendulum(0.3)
    solution = fb.simulate(scene, dt=0.01, t_end=0.3)
    motion = fb.Motion(scene, dt=0.01)
    motion.run(0.3)
    assert motion.q == pytest.approx(solution.q[-1], abs=1e-12)
    chosen = fb.simulate(scene, t_end=0.8, tolerance=1e-5)
    angle, _ = swing(0.3, 0.05, 0.8)
    assert chosen.rotation(centre)[-1] == pytest.approx(angle, abs=2e-3)
    assert abs(chosen.energy.balance_error).max() < 1e-10
