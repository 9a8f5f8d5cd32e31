"""Derivatives of motions and equilibria with nodes that slide on beams."""

import numpy as np
import pytest
from derivatives import Run, both, forward_and_backward

import fx_beam as fb
from fx_beam.compiled.adjoint import Adjoint

EXACT = fb.NewtonOptions(tolerance=1e-13)
LIGHT = fb.Section(EA=1e4, GA=1.1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.MidPoint(),
    fb.ModifiedMidPoint(),
    fb.EnergyDecaying(),
]


def outputs(scene, joint, node, **more):
    """What the joint and a node measure, and energies."""
    of_joint = {name: fb.Output(name, joint) for name in ("slide", "rate", "force")}
    of_node = {name: fb.Output(name, node) for name in ("position", "velocity", "acceleration")}
    return scene, of_joint | of_node | {"energy": fb.Output("total_energy", scene)} | more


def thrown(x, make=fb.Slider, curved=False, degree=1):
    """A free beam that rotates, and a bead that runs over several of its elements."""
    scene = fb.Scene(gravity=(0, -2 * x[1]))
    section = fb.Section(EA=1e4 * x[0], GA=1.1e4, EI=50 * x[1], rhoA=x[1], rhoI=0.01)
    shape = fb.arc((0, 0), (3, 0.8), (6, 0)) if curved else [(0, 0), (6, 0)]
    rod = scene.add_beam(shape, section, elements=12, degree=degree)
    bead = scene.add_beam([(0, 0), (0, 0.3)], LIGHT, degree=degree)
    scene.add_mass(bead.start, 0.8 * x[0], inertia=0.05)
    joint = scene.add_joint(make(rod, bead.start))
    scene.set_velocity(rod, lambda x, y: (0.2 - 0.3 * y, 0.5 + 0.3 * (x - 3)), spin=0.3)
    scene.set_velocity(bead, (8 * x[1], 1.0), spin=1.0)
    scene.make_velocities_compatible()
    return outputs(scene, joint, bead.end)


def carriage(x):
    """A load with two wheels on a bridge; one has a spring, a damper and friction."""
    scene = fb.Scene(gravity=(0, -9.81))
    data = {"EA": 1e4, "GA": 1.1e4, "EI": 200 * x[0], "rhoA": 1.0, "rhoI": 0.01}
    bridge = scene.add_beam([(0, 0), (6, 0)], fb.Section(**data), elements=10)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    axle = scene.add_beam([(1.25, 0), (1.5, 0.3), (1.85, 0)], LIGHT, elements=2)
    scene.add_mass(axle.nodes[1], 2 * x[0], 0.1)
    parts = {"spring": fb.Spring(3 * x[1], rest=2.0), "damper": fb.Damper(0.1 * x[0])}
    friction = fb.Friction(0.3 * x[1], 0.1)
    joint = scene.add_joint(fb.Slider(bridge, axle.start, friction=friction, **parts))
    scene.add_joint(fb.Slider(bridge, axle.end))
    scene.set_velocity(axle, (3 * x[0], 0))
    scene.make_velocities_compatible()
    held = fb.Output("reaction", bridge.start)
    return outputs(scene, joint, axle.nodes[1], held=held)


def hanging(x):
    """A beam hangs on a node that slides on a beam, which hangs on a sleeve on a third one."""
    scene = fb.Scene(gravity=(0, -3 * x[0]))
    last = scene.add_beam([(0, 0), (4, 0)], LIGHT, elements=6)
    scene.pin(last.start)
    scene.fix(last.end, "y")
    for make in (fb.Slider, fb.Sleeve):
        a, b = last.nodes[3], last.nodes[4]
        at = np.array([a.x + 0.3 * (b.x - a.x), a.y + 0.3 * (b.y - a.y)])
        section = fb.Section(EA=1e4 * x[1], GA=1.1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
        new = scene.add_beam([at, at + (1.5, -1.5)], section, elements=6)
        joint, last = scene.add_joint(make(last, new.start)), new
    scene.set_velocity(last, (0.5 * x[0], 0.0))
    scene.make_velocities_compatible()
    return outputs(scene, joint, last.end)


def driven(x):
    """A motor moves a body along a bridge, from a place that depends on x."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1.1e4, EI=300 * x[0], rhoA=1.0, rhoI=0.01)
    bridge = scene.add_beam([(0, 0), (4, 0)], section, elements=8)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    car = scene.add_body((0.73 * x[1], 0), mass=3.0, inertia=0.1)
    motor = {"motor": lambda t: 2 * x[0] * t + t * t}
    joint = scene.add_joint(fb.Slider(bridge, car.centre, **motor))
    scene.set_velocity(car.centre, (2 * x[0], 0.0))
    scene.make_velocities_compatible()
    return outputs(scene, joint, car.centre, power=fb.Output("motor_force", joint))


def on_an_arm(x):
    """A sleeve beside a hinge with a motor: the rotation there is the sum of two."""
    scene = fb.Scene(gravity=(0, -3))
    hub = scene.add_body((0, 0), 2.0, 0.5 * x[0])
    scene.add_joint(fb.Revolute(fb.GROUND, hub.centre))
    section = fb.Section(EA=1e4, GA=1.1e4, EI=100 * x[1], rhoA=1.0, rhoI=0.01)
    arm = scene.add_beam([(0, 0), (3, 0)], section, elements=6)
    scene.add_joint(fb.Revolute(hub.centre, arm.start, motor=lambda t: x[0] * t * t))
    bead = scene.add_beam([(0.2, 0), (0.2, 0.3)], LIGHT)
    scene.add_mass(bead.start, x[1], 0.05)
    joint = scene.add_joint(fb.Sleeve(arm, bead.start))
    for turning in (arm, bead):
        scene.set_velocity(turning, lambda x, y: (-2 * y, 2 * x), spin=2.0)
    scene.set_velocity(hub, spin=2.0)
    scene.make_velocities_compatible()
    return outputs(scene, joint, arm.end)


SCENES = {
    "slider": thrown,
    "sleeve on an arc": lambda x: thrown(x, fb.Sleeve, True, 2),
    "carriage": carriage,
    "hanging": hanging,
    "driven": driven,
    "arm": on_an_arm,
}
X = np.array([1.1, 0.9])


def assert_derivatives(run, x, h=1e-3):
    """Forwards and backwards, and against differences, extrapolated, of what it computes."""
    _, y = run(x)
    J, rng = run.jacobian(), np.random.default_rng(0)
    for name, rows in y.items():
        weights = rng.standard_normal(rows.shape) / abs(J[name]).max()
        forward = np.tensordot(weights, J[name], weights.ndim)
        assert run.vjp({name: weights}) == pytest.approx(forward, rel=0, abs=1e-9), name
    for i, unit in enumerate(np.eye(len(x))):
        ends = [run(x + k * h * unit)[1] for k in (-2, -1, 1, 2)]
        for name in y:
            a, b, c, d = (np.asarray(end[name]) for end in ends)
            expected = (8 * (c - b) - (d - a)) / (12 * h)
            # Accelerations and forces at the start are differences of the scene's.
            error = abs(J[name][1:, ..., i] - expected[1:]).max() / abs(J[name]).max()
            # Rates and forces have a larger part of the round-off of the motions.
            assert error <= (1e-8 if name in ("slide", "position") else 1e-7), (name, i)


@pytest.mark.parametrize("name", SCENES)
def test_all_outputs_have_the_derivatives_of_the_motion(name):
    run = fb.Response(SCENES[name], fb.EnergyMomentum(), dt=0.01, t_end=0.15, newton=EXACT)
    assert_derivatives(run, X)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_forwards_and_backwards_agree_for_all_schemes(scheme):
    for make in (fb.Slider, fb.Sleeve):
        forward, backward = forward_and_backward(
            lambda x, make=make: thrown([x, 1.0], make, True, 2)[0], scheme, steps=10
        )
        assert forward == pytest.approx(backward, rel=1e-9)


def test_so_they_do_with_a_force_on_the_node():
    """Its forces and displacements differ by their units, which must not choose the pivots."""

    def build(x):
        scene = thrown([x, 1.0], curved=True)[0]
        scene.gravity = (0.0, 0.0)
        pin = scene.beams[0].start
        scene.pin(pin)
        spring = fb.Spring(220 * x, rest=1.0)
        scene.add_force_between(scene.beams[1].start, (1.0, -3.0), spring=spring)
        return scene

    forward, backward = forward_and_backward(build, dt=0.005, steps=6)
    assert forward == pytest.approx(backward, rel=1e-12)


def test_so_they_do_on_a_beam_with_retardation():
    """And they are those of the motion."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=1e4, GA=1.1e4, EI=50.0, rhoA=1.0, rhoI=0.01, retardation=2e-3 * x)
        rod = scene.add_beam([(0, 0), (6, 0)], section, elements=12)
        scene.pin(rod.start)
        bead = scene.add_beam([(1.3, 0), (1.3, 0.3)], LIGHT)
        scene.add_joint(fb.Sleeve(rod, bead.start))
        scene.set_velocity(bead, (6.0, 2.0), spin=1.0)
        scene.make_velocities_compatible()
        return scene

    forward, backward = forward_and_backward(build)
    assert forward == pytest.approx(backward, rel=1e-10)
    found, low, size = both(build, h=1e-3)
    _, high, _ = both(build, h=2e-3)
    assert found == pytest.approx((4 * low - high) / 3, abs=1e-8 * size)
    assert size > 1e-3


def test_so_they_do_for_degree_3():
    forward, backward = forward_and_backward(
        lambda x: thrown([x, 1.0], fb.Sleeve, True, 3)[0], steps=10
    )
    assert forward == pytest.approx(backward, rel=1e-9)


def test_the_first_step_of_order_4_is_predicted_by_the_rates():
    """Else it takes 41 iterations at this speed, and is halved; some of its sub-steps are long."""
    scene = thrown([1.0, 1.0], fb.Sleeve, True, 3)[0]
    stats = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=1e-3, t_end=1e-3).stats
    assert stats.halvings == 0
    assert stats.newton_iterations <= 25


@pytest.mark.parametrize("scheme", [fb.MidPoint(), fb.EnergyDecaying()], ids=lambda own: own.name)
def test_derivatives_of_a_bead_on_straight_elements_of_an_arc_are_those_of_the_motion(scheme):
    """It passes two of them. In no step it begins where two elements meet."""
    run = fb.Response(lambda x: thrown(x, curved=True), scheme, dt=0.01, t_end=0.15, newton=EXACT)
    run(X)
    J, h = run.jacobian("position")["position"], 1e-3
    for i, unit in enumerate(np.eye(2)):
        a, b, c, d = (run(X + k * h * unit)[1]["position"] for k in (-2, -1, 1, 2))
        expected = (8 * (c - b) - (d - a)) / (12 * h)
        assert abs(J[..., i] - expected).max() < 1e-9 * abs(J).max()


@pytest.mark.parametrize("make", [fb.Slider, fb.Sleeve])
def test_gradients_of_momenta_and_energy_are_those_at_the_start(make):
    """In free flight, while the bead passes elements; by all rates at the start."""

    scene = thrown([1.1, 1.0], make, True, 2)[0]
    scene.gravity = (0.0, 0.0)
    run = Run(scene, fb.EnergyMomentum(), 0.01, 60, taped=True)
    model, mass = run.model, run.model.mass
    assert run.rows["slides"][-1, 0] > 2.0  # four elements
    at = model.mesh.dofs
    x = model.mesh.X + run.rows["q"][:, at][..., :2]
    along, arms = np.zeros(model.size), np.zeros((len(x), model.size))
    along[at[:, 0]] = 1.0
    arms[:, at[:, 0]], arms[:, at[:, 1]], arms[:, at[:, 2]] = -x[..., 1], x[..., 0], 1.0
    last = np.array([len(run.loop.tape)])

    def gradient(v, q=None):
        weights = {"v": v[None], "q": np.zeros((1, model.size)) if q is None else q[None]}
        return Adjoint(run.loop.problem).pull(run.loop.tape, weights, last)

    assert gradient(mass @ along)["v"] == pytest.approx(mass @ along, abs=1e-9)
    momentum, turned = mass @ run.rows["v"][-1], np.zeros(model.size)
    turned[at[:, 0]], turned[at[:, 1]] = momentum[at[:, 1]], -momentum[at[:, 0]]
    moment = gradient(mass @ arms[-1], turned)["v"]
    assert moment == pytest.approx(mass @ arms[0], abs=1e-9 * abs(mass @ arms[0]).max())


@pytest.mark.parametrize("make", [fb.Slider, fb.Sleeve])
def test_the_derivative_of_the_energy_is_that_at_the_start(make):
    """By the speed of the bead and the mass, to round-off, after 60 steps."""

    def build(x):
        return thrown([x[0], x[1]], make)

    run = fb.Response(build, fb.EnergyMomentum(), dt=0.01, t_end=0.6, newton=EXACT)
    run(X)
    J = run.jacobian("energy", "slide")
    assert run.stats.halvings == 0
    assert J["energy"] == pytest.approx(
        np.broadcast_to(J["energy"][0], J["energy"].shape), rel=1e-9
    )
    assert abs(J["slide"][-1]).min() > 0.01


def test_a_bead_on_a_turning_rod_has_the_derivatives_of_cosh():
    """Its place s0 cosh(w t) by s0 and w; the error of the steps is of order 2."""

    def build(x):
        scene = fb.Scene()
        stiff = fb.Section(EA=1e9, GA=1e9, EI=1e8, rhoA=1e-3, rhoI=1e-4)
        rod = scene.add_beam([(0, 0), (4, 0)], stiff, elements=4)
        scene.add_joint(fb.Revolute(fb.GROUND, rod.start, motor=lambda t: x[1] * t))
        bead = scene.add_body((x[0], 0), mass=1.0, inertia=0.1)
        joint = scene.add_joint(fb.Slider(rod, bead.centre))
        scene.set_velocity(rod, lambda a, b: (-x[1] * b, x[1] * a), spin=x[1])
        scene.set_velocity(bead.centre, (0.0, x[0] * x[1]))
        return scene, {"slide": fb.Output("slide", joint)}

    s0, w, errors = 0.7, 2.0, []
    exact = np.array([np.cosh(w), s0 * np.sinh(w)])
    for dt in (0.02, 0.01):
        run = fb.Response(build, fb.EnergyMomentum(), dt=dt, t_end=1.0)
        run([s0, w])
        errors.append(run.jacobian()["slide"][-1] / exact - 1)
    assert errors[0] / errors[1] == pytest.approx([4, 4], abs=0.2)
    assert abs(errors[1]).max() < 2e-3


def weighed(x):
    """A spring and the bend of a beam hold a weight that slides on it."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1.1e4, EI=300 * x[0], rhoA=1.0, rhoI=0.01)
    beam = scene.add_beam([(0, 0), (4, 0.5)], section, elements=8)
    scene.pin(beam.start)
    scene.pin(beam.end)
    load = scene.add_body((1.12, 0.14), mass=4 * x[1], inertia=0.1)
    spring = fb.Spring(300 * x[1], rest=1.0)
    joint = scene.add_joint(fb.Slider(beam, load.centre, spring=spring))
    scene.fix(load.centre, "rotation")
    of = {"slide": fb.Output("slide", joint), "position": fb.Output("position", load.centre)}
    return scene, of | {"force": fb.Output("force", joint)}


def test_equilibria_have_derivatives_and_so_has_a_motion_from_them():
    assert_derivatives(fb.StaticResponse(weighed, steps=4, newton=EXACT), X)

    def start(scene):
        return fb.static(scene, steps=4, newton=EXACT)

    moved = fb.Response(weighed, dt=0.01, t_end=0.05, start=start, newton=EXACT)
    moved(X)
    J = moved.jacobian("slide")["slide"]
    equilibria = fb.StaticResponse(weighed, steps=4, newton=EXACT)
    equilibria(X)
    assert J[-1] == pytest.approx(equilibria.jacobian("slide")["slide"][-1], rel=1e-6)


def test_a_tape_in_parts_gives_the_same():
    whole, parts = (
        fb.Response(carriage, dt=0.01, t_end=0.2, memory=memory) for memory in (1e9, 2e4)
    )
    for run in (whole, parts):
        run(X)
    J, other = whole.jacobian(), parts.jacobian()
    for name in J:
        assert other[name] == pytest.approx(J[name], rel=1e-12, abs=1e-12 * abs(J[name]).max())


def bent(x, make=fb.Sleeve):
    """A bead on an arc, the rise and span of which are numbers; a spring hangs on the bead."""
    scene = fb.Scene(gravity=(0, -3))
    arc = fb.arc((0, 0), (3, 0.8 * x[0]), (6 * x[1], 0))
    rod = scene.add_beam(arc, LIGHT, elements=12, degree=2)
    scene.pin(rod.start)
    at = rod.nodes[2]
    bead = scene.add_beam([(at.x, at.y), (at.x, at.y + 0.3)], LIGHT, degree=2)
    scene.add_mass(bead.start, 0.8, inertia=0.05)
    joint = scene.add_joint(make(rod, bead.start, spring=fb.Spring(40.0, rest=1.0)))
    scene.set_velocity(bead, (8.0, 1.0), spin=1.0)
    scene.make_velocities_compatible()
    return outputs(scene, joint, bead.end)


def leaning(x):
    """A weight on a sloping beam of other lengths and heights, held by a spring along it."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1.1e4, EI=300, rhoA=1.0, rhoI=0.01)
    beam = scene.add_beam([(0, 0), (4 * x[0], 0.5 * x[1])], section, elements=8)
    scene.pin(beam.start)
    scene.pin(beam.end)
    load = scene.add_body((1.12 * x[0], 0.14 * x[1]), mass=4, inertia=0.1)
    joint = scene.add_joint(fb.Slider(beam, load.centre, spring=fb.Spring(300, rest=1.0)))
    scene.fix(load.centre, "rotation")
    of = {"slide": fb.Output("slide", joint), "position": fb.Output("position", load.centre)}
    return scene, of | {"reaction": fb.Output("reaction", beam.start)}


def driven_along(x):
    """A motor moves a body along a bridge of other lengths, on which a second beam hangs."""
    scene = fb.Scene(gravity=(0, -9.81))
    bridge = scene.add_beam([(0, 0.2 * x[1]), (4 * x[0], 0)], LIGHT, elements=8)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    at = np.array([0.8 * x[0], 0.16 * x[1]])
    arm = scene.add_beam([at, at + (0.5, -x[0])], LIGHT, elements=4)
    moved = scene.add_joint(fb.Sleeve(bridge, arm.start, motor=lambda t: 2 * t + t * t))
    bead = scene.add_body(at + (0.1, -0.2 * x[0]), mass=0.3, inertia=0.01)
    joint = scene.add_joint(fb.Slider(arm, bead.centre))
    scene.set_velocity(arm, (2.0, 0.0))
    scene.make_velocities_compatible()
    return outputs(scene, joint, bead.centre, power=fb.Output("motor_force", moved))


@pytest.mark.parametrize("scene", [bent, lambda x: bent(x, fb.Slider), driven_along])
def test_the_shape_of_a_beam_on_which_nodes_slide_is_among_the_numbers(scene):
    run = fb.Response(scene, fb.EnergyMomentum(), dt=0.01, t_end=0.06, newton=EXACT)
    assert_derivatives(run, X, h=5e-4)


def test_so_it_is_in_equilibria():
    assert_derivatives(fb.StaticResponse(leaning, steps=4, newton=EXACT), X)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_forwards_and_backwards_agree_for_shapes_and_all_schemes(scheme):
    for make in (fb.Slider, fb.Sleeve):
        forward, backward = forward_and_backward(
            lambda x, make=make: bent([x, 1.0], make)[0], scheme, steps=6
        )
        assert forward == pytest.approx(backward, rel=1e-9)
