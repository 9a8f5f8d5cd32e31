"""Length, rate, energy and power of forces between points and of springs to the ground."""

import ufl

import numpy as np
import pytest
from derivatives import assert_derivatives, assert_orbit_slopes
from scenes import held_body, one_bar

import fx_beam as fb


def pair(law=None):
    """A body that swings on a spring to another one, which a spring and a damper hold."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    a = scene.add_body((0.0, 0.0), mass=2.0, inertia=0.1, name="a").centre
    b = scene.add_body((0.8, -0.6), mass=1.0, inertia=0.1, name="b").centre
    spring = fb.Spring(300.0, rest=0.9) if law is None else law
    line = scene.add_force_between(a, b, spring=spring, damper=fb.Damper(0.4))
    held = scene.add_spring(
        a, x=fb.Spring(500.0), y=[fb.Spring(400.0), fb.Damper(3.0)], rotation=fb.Spring(2.0)
    )
    scene.set_velocity(b, (1.0, 0.5), spin=0.3)
    scene.set_velocity(a, (0.0, 0.2), spin=9.0)
    return scene, line, held


def test_outputs_of_lines_are_those_of_their_nodes():
    scene, line, held = pair()
    a, b = (scene.bodies[k].centre for k in (0, 1))
    outputs = {
        "length": fb.Output("length", line),
        "rate": fb.Output("rate", line),
        "force": fb.Output("force", line),
        "sag": fb.Output("length", held.y),
        "turn": fb.Output("length", held.rotation),
        "spin": fb.Output("rate", held.rotation),
    }
    motion = fb.Motion(scene, dt=0.01, outputs=outputs, record=fb.Record())
    rows = [motion.step() for _ in range(200)]
    solution = motion.solution()
    computed = {name: np.array([row[name] for row in rows]) for name in outputs}
    apart = solution.position(b) - solution.position(a)
    moves = solution.velocity(b) - solution.velocity(a)
    distance = np.hypot(*apart.T)
    rate = np.sum(apart * moves, axis=1) / distance
    assert computed["length"] == pytest.approx(distance[1:], abs=1e-13)
    assert computed["rate"] == pytest.approx(rate[1:], abs=1e-12)
    assert computed["sag"] == pytest.approx(solution.displacement(a)[1:, 1], abs=1e-14)
    assert computed["turn"] == pytest.approx(solution.rotation(a)[1:], abs=1e-13)
    assert computed["spin"] == pytest.approx(solution.spin(a)[1:], abs=1e-13)
    assert abs(computed["turn"]).max() > 0.5
    histories = solution.joint(line)
    assert histories.rate == pytest.approx(rate, abs=1e-14)
    np.testing.assert_array_equal(solution.joint(held.rotation).rate, solution.spin(a))


@pytest.mark.parametrize("own", [False, True])
def test_energies_and_powers_of_all_lines_are_those_of_the_scene(own):
    """Energy that lines store is that of springs; what they take beyond it is dissipated."""
    law = fb.Spring(3.0, strain_energy=lambda x: 120.0 * (x - 0.9) ** 4) if own else None
    scene, line, held = pair(law=law)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    lines = [solution.joint(one) for one in (line, *held)]
    stored, energy = sum(one.energy for one in lines), solution.energy
    assert stored == pytest.approx(energy.springs, abs=1e-12 * energy.springs.max())
    taken = 0.01 * np.cumsum(sum(one.power for one in lines))
    growth = energy.springs - energy.springs[0] + energy.dissipated
    assert energy.dissipated[-1] > 0.1
    assert taken == pytest.approx(growth, abs=1e-9 * growth.max())


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8)])
def test_powers_add_up_to_second_order_where_forces_are_not_those_of_the_middle(scheme):
    errors = []
    for dt in (0.01, 0.005):
        scene, line, held = pair()
        solution = fb.simulate(scene, scheme, dt=dt, t_end=0.5)
        lines, energy = [solution.joint(one) for one in (line, *held)], solution.energy
        growth = energy.springs[-1] - energy.springs[0] + energy.dissipated[-1]
        errors.append(abs(dt * sum(one.power.sum() for one in lines) - growth))
    assert errors[1] < min(0.35 * errors[0], 2e-3 * growth)


def test_an_equilibrium_has_no_power():
    scene, line, _ = pair()
    scene.fix(scene.bodies[1].centre, "rotation")
    motion = fb.static(scene).joint(line)
    with pytest.raises(ValueError, match="power: no time passes in a static solution"):
        motion.power  # noqa: B018


def test_the_energy_of_a_bed_and_of_a_stop_is_that_of_springs():
    scene, beam = one_bar((2, 0), fb.Section(EA=1e5, GA=1e5, EI=20.0), elements=8)
    scene.fix(beam.start, "x")
    bed = scene.add_bed(beam, normal=500.0, pushes_only=True)
    scene.add_force(beam.node(0.25), (0.0, -20.0))
    scene.add_force(beam.node(0.75), (0.0, -20.0))
    solution = fb.static(scene)
    computed = solution.joint(bed.normal).energy
    assert computed[-1] > 0 and computed == pytest.approx(solution.energy.springs, rel=1e-12)


def test_beds_have_rates_and_power():
    """Energy of a bed on which its beam falls is stored; rates are those of its nodes."""
    section = fb.Section(EA=1e5, GA=1e5, EI=20.0, rhoA=2.0, rhoI=1e-4)
    scene, beam = one_bar((1.6, 1.2), section, elements=6, gravity=(0, -9.81))
    bed = scene.add_bed(beam, normal=500.0, tangential=80.0)
    for node in beam.nodes:
        scene.set_velocity(node, (0.3, 0.0))
    solution = fb.simulate(scene, dt=0.005, t_end=0.2)
    across, along = (solution.joint(one) for one in bed)
    v = np.array([solution.velocity(node) for node in beam.nodes])
    assert across.rate == pytest.approx((v @ (-0.6, 0.8)).T, abs=1e-13)
    assert along.rate == pytest.approx((v @ (0.8, 0.6)).T, abs=1e-13)
    taken = 0.005 * np.cumsum(across.power + along.power)
    energy = solution.energy
    assert energy.springs.max() > 0.1
    assert taken == pytest.approx(energy.springs - energy.springs[0], abs=1e-12)
    # The work of the mean forces of all nodes, which share the length.
    path = np.diff(across.length, axis=0)
    middle = (across.length[1:] + across.length[:-1]) / 2
    work = 500 * (middle * path) @ bed.normal.lengths
    assert 0.005 * across.power[1:] == pytest.approx(work, abs=1e-12)


KINDS = {
    "points": lambda a, b: [(0.0, 0.5), a, (0.4, 0.3), b],
    "pulleys": lambda a, b: [a, fb.Pulley((0.4, 0.3), 0.1, side="right"), b],
    "drum": lambda a, b: [fb.Pulley(a, 0.1), b],
}


def roped(x, kind, laws=None):
    """Two bodies on springs, and a rope over them; x scales a mass, a place and the stiffness."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    a = scene.add_body((0.0, 0.0), mass=2.0 * x[0], inertia=0.1, name="a").centre
    b = scene.add_body((0.8, -0.1 * x[1]), mass=1.0, inertia=0.1, name="b").centre
    points = KINDS[kind](a, b)
    if laws is None:
        rope = scene.add_rope(points, spring=fb.Spring(200.0 * x[2]), length=0.95)
    else:
        k = fb.Parameter("k", 100.0 * x[2])
        scene.add_parameter(k)
        rope = scene.add_force_between(a, b, **laws(k))
    for node in (a, b):
        each = fb.Spring(90.0)
        scene.add_spring(node, x=each, y=[each, fb.Damper(0.5)], rotation=fb.Spring(5.0))
    held = scene.add_spring(b, y=fb.Spring(30.0 * x[2], rest=0.02))
    names = "force", "energy", "length", "rate"
    outputs = {name: fb.Output(name, rope) for name in names}
    outputs |= {f"{name} of y": fb.Output(name, held.y) for name in names}
    return scene, outputs


def own_laws(k):
    """A force between points of all kinds, by functions, too."""
    return {
        "spring": fb.Spring(strain_energy=lambda d: k * (d - 0.7) ** 4, stiffness=3.0),
        "damper": fb.Damper(0.3),
        "friction": fb.SmoothFriction(0.4, speed=0.2),
        "stop": fb.Stop(None, 0.81, 4e3),
        "force": lambda d, rate, t: 2.0 * d + 0.1 * rate + ufl.sin(t),
    }


X = np.array([1.0, 1.0, 1.0])


@pytest.mark.parametrize("kind", KINDS)
def test_ropes_have_derivatives_in_motion_and_at_rest(kind):
    assert_derivatives(fb.Response(lambda x: roped(x, kind), dt=0.01, t_end=0.15), X)
    assert_derivatives(fb.StaticResponse(lambda x: roped(x, kind), load_steps=3), X)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying(), fb.MidPoint()])
def test_all_laws_of_a_line_have_derivatives(scheme):
    """Springs, dampers, friction, stops and functions, also by schemes that damp."""
    build = lambda x: roped(x, "points", own_laws)  # noqa: E731
    assert_derivatives(fb.Response(build, scheme, dt=0.01, t_end=0.15), X)


def test_a_motion_from_an_equilibrium_starts_with_its_pull():
    """Of one that is the same for all x, and of one that depends on them."""

    def build(x):
        return roped((x[0], 1.0, x[1]), "points")

    for start in (fb.static(build(X)[0]), fb.static):
        assert_derivatives(fb.Response(build, dt=0.01, t_end=0.05, start=start), X[:2])


def test_a_periodic_motion_has_derivatives_of_its_lines():
    """A weight on a spring, shaken: against differences."""

    def build(x):
        scene, mass = held_body((0.3, 0.0), x[0], 0.0, "rotation")
        laws = {"spring": fb.Spring(40.0 * x[1], rest=0.4), "damper": fb.Damper(0.4)}
        line = scene.add_force_between(mass, (0.0, 0.4), **laws)
        held = scene.add_spring(mass, x=[fb.Spring(30.0), fb.Damper(0.3)])
        scene.add_force(mass, lambda t: (0.0, 0.5 * np.cos(3.0 * t)))
        names = "force", "energy", "length", "rate"
        outputs = {name: fb.Output(name, line) for name in names}
        return scene, outputs | {"push": fb.Output("force", held.x)}

    def motion(scene):
        return fb.periodic(scene, period=2 * np.pi / 3.0, steps=41, tolerance=1e-12)

    run = fb.PeriodicResponse(build, motion)
    assert_orbit_slopes(run, [1.0, 1.0], 1e-5, multipliers=False)


def test_forces_of_lines_are_linearised():
    """Against motions that begin beside the state, and against a pull that is an input."""
    scene, mass = held_body((0.3, 0.0), 2.0, 0.0, "rotation", gravity=(0.0, -9.81))
    laws = {"spring": fb.Spring(400.0, rest=0.4), "damper": fb.Damper(7.0)}
    line = scene.add_force_between(mass, (0.0, 0.4), **laws)
    scene.add_spring(mass, x=fb.Spring(300.0))
    winch = scene.add_force_between(mass, (1.0, 0.5), force=fb.Input("winch"))
    rest = fb.static(scene)
    outputs = {name: fb.Output(name, line) for name in ("force", "energy", "length", "rate")}
    outputs |= {"winch": fb.Output("force", winch), "x": fb.Output("position", mass)}
    outputs |= {"v": fb.Output("velocity", mass)}
    system = fb.linearise(scene, rest, outputs=outputs)
    place = rest.position(mass)[-1] - (0.0, 0.4)
    length = np.hypot(*place)
    way = place / length
    x, v = system.C[5:7], system.C[7:9]
    pull = 400.0 * (length - 0.4)
    assert system.C[0] == pytest.approx(way @ (400.0 * x + 7.0 * v), abs=1e-9)
    assert system.C[1] == pytest.approx(pull * way @ x, abs=1e-9)
    assert system.C[2] == pytest.approx(way @ x, abs=1e-12)
    assert system.C[3] == pytest.approx(way @ v, abs=1e-12)
    assert system.C[4] == pytest.approx(0.0, abs=1e-12) and system.D[4, 0] == pytest.approx(1.0)
    assert system.D[:4, 0] == pytest.approx(0.0, abs=1e-12)


def test_derivatives_of_pulls_do_not_depend_on_memory():
    def gradient(**memory):
        run = fb.Response(lambda x: roped(x, "points"), dt=0.01, t_end=0.5, **memory)
        run(X)
        return run.vjp({"force": np.ones(51), "energy": np.ones(51)})

    assert gradient(memory=2e4) == pytest.approx(gradient())


@pytest.mark.parametrize("kind", KINDS)
def test_the_energies_of_all_lines_are_that_of_springs(kind):
    scene, _ = roped(X, kind)
    lines = scene.forces_between
    outputs = {str(i): fb.Output("energy", line) for i, line in enumerate(lines)}
    motion = fb.Motion(scene, dt=0.01, outputs=outputs, record=fb.Record())
    rows = [sum(motion.step().values()) for _ in range(20)]
    solution = motion.solution()
    springs = solution.energy.springs
    assert rows == pytest.approx(springs[1:], abs=1e-13) and springs.max() > 0.01
    total = sum(solution.joint(line).energy for line in lines)
    assert total == pytest.approx(springs, abs=1e-13)


@pytest.mark.parametrize(
    "start", [[(-1, 0), (0, 0)], [(-1, 0.2), fb.Pulley((-0.2, 0), 0.2, "right")]]
)
def test_a_weight_on_a_rope_has_the_derivatives_of_closed_forms(start):
    """A spring beside the rope has a part of the weight; over a point and over a pulley.

    The stretch is s = m g / (k + c), T = k s, E = k s^2 / 2.
    """
    g, m, k, c = 9.81, 20.0, 3e4, 500.0
    length = 4.0 if start[1] == (0, 0) else 3.8 + 0.1 * np.pi

    def build(x):
        scene, load = held_body((0, -3), x[0], 0.0, "x", "rotation", gravity=(0, -g))
        scene.add_spring(load, y=fb.Spring(c))
        rope = scene.add_rope([*start, load], spring=fb.Spring(x[1]), length=length)
        return scene, {name: fb.Output(name, rope) for name in ("force", "energy", "length")}

    run = fb.StaticResponse(build, load_steps=1)
    _, y = run([m, k])
    s = m * g / (k + c)
    by_m, by_k = s / m, -s / (k + c)
    assert y["force"][-1] == pytest.approx(k * s, rel=1e-9)
    assert y["energy"][-1] == pytest.approx(k * s * s / 2, rel=1e-9)
    jacobian = {name: rows[-1] for name, rows in run.jacobian().items()}
    assert jacobian["force"] == pytest.approx([k * by_m, s + k * by_k], rel=1e-8)
    assert jacobian["energy"] == pytest.approx([k * s * by_m, s * s / 2 + k * s * by_k], rel=1e-8)
    assert jacobian["length"] == pytest.approx([by_m, by_k], rel=1e-8)


@pytest.mark.parametrize("n", [3, 12])
def test_a_rope_over_many_points_pulls_each_along_both_of_its_pieces(n):
    """Against the sum of its pieces, with the tension of the length."""
    scene = fb.Scene()
    places = [(0.5 * i, -0.4 * (i % 3)) for i in range(n)]
    nodes = [scene.add_body(place, mass=1.0).centre for place in places]
    scene.clamp(nodes[0])
    for node in nodes[1:]:
        scene.fix(node, "rotation")
        scene.add_spring(node, x=fb.Spring(80.0), y=fb.Spring(50.0))
    rope = scene.add_rope(nodes, spring=fb.Spring(100.0), length=0.4 * n)
    solution = fb.static(scene)
    positions = np.array([solution.position(node)[-1] for node in nodes])
    ways = np.diff(positions, axis=0)
    sizes = np.hypot(*ways.T)
    tension = 100.0 * (sizes.sum() - 0.4 * n)
    assert tension > 1.0
    assert solution.joint(rope).force[-1] == pytest.approx(tension, rel=1e-9)
    pulls = tension * ways / sizes[:, None]
    node_forces = np.append(pulls[1:], [[0.0, 0.0]], axis=0) - pulls
    held = np.array([80.0, 50.0]) * (positions - np.array(places))[1:]
    assert node_forces == pytest.approx(held, abs=1e-7 * tension)
