"""Equilibria as functions of numbers: derivatives by closed forms, and at starts of motions."""

import ufl

import derivatives
import numpy as np
import pytest
from derivatives import EXACT, assert_both_ways_agree, assert_derivatives, outputs_of
from jointed import KINDS, MEMBER
from scenes import (
    EI,
    HARDENING,
    PLASTIC,
    YIELD,
    assert_refused,
    clamped_bar,
    held_body,
    hinged_body,
    one_bar,
    pinned_bar,
    with_variables,
)

import fx_beam as fb

DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}
X = np.array([1.0, 1.1, 0.9])

# -- Closed forms ----------------------------------------------------------------------------------

LENGTH, ELEMENTS = 2.0, 20


def bent_beyond_its_limit(x):
    """A moment at the end: its curvature is the same everywhere."""

    def energy(eps, gamma, kappa, a):
        elastic = ufl.as_ufl(DATA["EA"] / 2) * (eps**2 + gamma**2) + EI / 2 * (kappa - a[0]) ** 2
        return elastic + hardening / 2 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = EI * (strains[2] - old[0]) - hardening * old[0]
        excess = ufl.max_value(abs(trial) - limit, 0)
        return [old[0] + ufl.sign(trial) * excess / (EI + hardening)]

    hardening, limit = fb.Parameter("hardening", x[1]), fb.Parameter("limit", x[2])
    scene, beam = clamped_bar((1, 0), with_variables(energy, flow, rhoA=1.0, rhoI=0.1), elements=1)
    scene.add_moment(beam.end, x[0])
    return scene, {"turn": fb.Output("rotation", beam.end)}


def test_turn_of_a_beam_that_has_yielded_depends_on_its_moment_and_limit_as_exact():
    moment, limit = 2 * YIELD, YIELD
    run = fb.StaticResponse(bent_beyond_its_limit, load_steps=4)
    factors, y = run([moment, HARDENING, limit])
    flows = factors * moment - limit > 1e-9
    assert flows.any() and not flows.all()
    flown = np.where(flows, (factors * moment - limit) / HARDENING, 0.0)
    assert y["turn"] == pytest.approx(factors * moment / EI + flown, abs=1e-9)
    by_moment = factors / EI + np.where(flows, factors / HARDENING, 0.0)
    by_limit = np.where(flows, -1 / HARDENING, 0.0)
    exact = np.column_stack([by_moment, -flown / HARDENING, by_limit])
    beside = abs(factors * moment - limit) > 1e-6  # at the limit itself there is a kink
    assert run.jacobian()["turn"][beside] == pytest.approx(exact[beside], abs=1e-8)
    assert run.vjp({"turn": 1.0 * beside}) == pytest.approx(exact[beside].sum(axis=0), abs=1e-8)


def test_derivatives_along_a_path_with_limit_points():
    """Two bars, pressed at their apex: the load is a closed function of the place of the apex."""
    half, rise, EA, load = 1.0, 0.3, 1e3, 20.0

    def build(x):
        scene, bar = fb.Scene(), fb.Section(EA=x[0], GA=1e4, EI=100.0)
        left = scene.add_beam([(-half, 0), (0, rise)], bar, elements=1)
        right = scene.add_beam([(0, rise), (half, 0)], bar, elements=1)
        scene.add_joint(fb.Revolute(left.end, right.start))
        for node in (left.start, right.end):
            scene.pin(node)
        scene.add_force(left.end, (0, -load))
        scene.fix(left.end, "x")
        return scene, {"apex": fb.Output("position", left.end, "y")}

    run = fb.StaticResponse(build, 10, continuation="arc-length", newton=EXACT)
    factors, y = run([EA])
    long = np.hypot(half, rise)

    def pressed(height):
        now = np.hypot(half, height)
        return 2 * EA * (long - now) / long * height / now

    assert pressed(y["apex"]) == pytest.approx(load * factors, abs=1e-6)
    assert (np.diff(factors) < 0).any()  # it has snapped through
    h = 1e-6
    slope = (pressed(y["apex"] + h) - pressed(y["apex"] - h)) / (2 * h)
    away = abs(slope) > 5.0  # from limit points, which have no derivative
    exact = -load * factors / EA / slope
    assert run.jacobian()["apex"][away, 0] == pytest.approx(exact[away], rel=1e-6)


def test_work_of_a_moment_that_bends_a_cantilever():
    """W = M^2 L / 2 EI; of equal load steps as well, as the rotation is linear in M."""

    def build(x):
        scene, beam = clamped_bar((x[2], 0), fb.Section(EA=1e4, GA=1e4, EI=x[1]), elements=3)
        scene.add_moment(beam.end, x[0])
        lost = fb.Output("dissipated_energy", scene)
        return scene, {"work": fb.Output("work", scene), "lost": lost}

    M, EI, L = x = np.array([2.0, 3.0, 0.8])
    run = fb.StaticResponse(build, load_steps=4)
    factors, y = run(x)
    assert y["work"] == pytest.approx(factors**2 * M**2 * L / (2 * EI), abs=1e-12)
    expected = [M * L / EI, -(M**2) * L / (2 * EI**2), M**2 / (2 * EI)]
    J = run.jacobian()
    assert J["work"] == pytest.approx(np.outer(factors**2, expected), abs=1e-10)
    assert not J["lost"].any()


def block(x):
    """A block on rails, which its load F pushes against a spring and the friction mu N."""
    laws = {"axis": (1, 0), "spring": fb.Spring(200.0), "friction": fb.Coulomb(x[2], 1e4)}
    scene, block = held_body((0, 0), 1.0, 0.1)
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, block, **laws))
    scene.add_force(block, (x[0], -x[1]))
    return scene, {"d": fb.Output("slide", joint), "force": fb.Output("force", joint)}


def test_a_driven_crank_moves_a_slider_by_no_weight():
    """All forces are vertical, so that none has a stiffness; the motor lifts two rods of x kg."""
    pin, end = np.array([0.3, 0.4]), np.array([1.3, 0.0])

    def build(x):
        scene, place, before = fb.Scene(gravity=(0, -9.81)), np.zeros(2), fb.GROUND
        for tip, motor in ((pin, lambda t: 2 * t**2), (end, None)):
            rod = scene.add_body((place + tip) / 2, x[0], 0.05, points={"a": place, "b": tip})
            scene.add_joint(fb.Revolute(before, rod["a"], motor=motor))
            place, before = tip, rod["b"]
        slider = scene.add_body(end, 1.0, 0.05).centre
        scene.add_joint(fb.Revolute(before, slider))
        scene.add_joint(fb.Prismatic(fb.GROUND, slider, (1, 0)))
        return scene, {"slider": fb.Output("position", slider), "work": fb.Output("work", scene)}

    run = fb.StaticResponse(build, t=0.3, load_steps=3)
    _, y = run([1.0])
    angle, length = 0.18 + np.arctan2(0.4, 0.3), np.hypot(*(end - pin))
    high = 0.5 * np.sin(angle)
    exact = 0.5 * np.cos(angle) + np.sqrt(length**2 - high**2)
    assert y["slider"][-1] == pytest.approx([exact, 0.0], abs=1e-12)
    J = run.jacobian()
    assert abs(J["slider"]).max() < 1e-12
    # The work is that of load steps, and in proportion to x.
    assert J["work"][:, 0] == pytest.approx(y["work"], abs=1e-12)
    assert y["work"][-1] == pytest.approx(9.81 * (high - 0.4), rel=0.01)


def test_a_block_with_friction_moves_by_f_less_mu_n_over_k():
    x = np.array([30.0, 50.0, 0.2])
    run = fb.StaticResponse(block, load_steps=3)
    y = run(x)[1]
    assert y["d"][-1] == pytest.approx((30.0 - 10.0) / 200.0)
    J = run.jacobian()
    assert J["d"][-1] == pytest.approx(np.array([1.0, -0.2, -50.0]) / 200.0, rel=1e-10)
    weights = {"d": np.array([0, 0, 0, 1.0])}
    assert run.vjp(weights) == pytest.approx(J["d"][-1], rel=1e-12)


# -- All kinds of numbers --------------------------------------------------------------------------


def cantilever(section=MEMBER, gravity=None, points=((0, 0), (1, 0)), elements=3, degree=1):
    scene, beam = clamped_bar(points, section, elements=elements, degree=degree, gravity=gravity)
    return scene, beam


def loads(x):
    """Dead, line and follower loads, weight, a spring, an obstacle, a taper; the shape changes."""
    section = fb.Section(**DATA | {"EA": 1e4 * x[0], "EI": lambda s: 100 * (1 - x[0] * s / 4)})
    points = [(0, 0), (1, 0.3 * x[0])]
    scene, beam = cantilever(section, (0, -9.81 * x[2]), points, degree=2)
    scene.add_force(beam.end, (20 * x[1], -30.0))
    scene.add_force(beam.end, (0, 20 * x[1]), follower=True)
    scene.add_line_load(beam, (3 * x[0], 2 * x[1]))
    scene.add_mass(beam.end, 0.5 * x[1])
    spring = fb.Spring(30 * x[0], rest=0.5 * x[1])
    pull = {"spring": spring, "force": lambda r, rate, t: 2 * ufl.sin(t + 1) / r}
    scene.add_force_between(beam.end, (2, 0.5), **pull)
    scene.add_contact(beam.end, fb.Circle((1.0, -0.9 * x[1]), 0.9), stiffness=1e3 * x[0])
    return scene


def released(x):
    """The load vanishes after the start."""
    scene, beam = cantilever(fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2))
    scene.add_force(beam.end, lambda t: (0.0, 5 * x[2] * (t <= 0)))
    return scene


def driven(x):
    scene, beam = one_bar((1, 0.3), fb.Section(**DATA), elements=3, gravity=(0, -9.81))
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, spring=fb.Spring(50 * x[0], rest=0.3)))
    scene.prescribe(beam.end, y=0.2 * x[1])
    scene.add_moment(beam.end, x[1] * x[2])
    return scene


def yielding(x):
    scene, beam = cantilever(PLASTIC, points=[(0, 0), (x[0], 0)])
    scene.add_force(beam.end, (x[2], 6 * x[1]))
    return scene


def slide(x):
    make, offset, data = KINDS["prismatic with offset"]
    scene, first = cantilever(gravity=(0, -9.81), points=[(-1, 0), (0, 0)], elements=2)
    start = np.array(offset) + (x[0] - 1) * np.array(data["axis"])
    section = fb.Section(**DATA | {"EI": 110 * x[1]})
    second = scene.add_beam([start, start + (0.8, -0.6)], section, elements=2)
    scene.add_joint(make(first.end, second.start, **data, spring=fb.Spring(200 * x[2], rest=0.05)))
    scene.add_force(second.end, (x[0], 2.0))
    return scene


def motors(x):
    """They lift bodies beside a beam, of which one slides along the other."""
    scene, _ = cantilever(gravity=(0, -9.81 * x[2]))
    arm = scene.add_body((5, 0), 1.0, 0.1, points={"pin": (4.6, 0)})
    lift = {"motor": lambda t: 0.4 * x[1] * t * (2 - t)}
    scene.add_joint(fb.Revolute(fb.GROUND, arm["pin"], **lift))
    block = scene.add_body((5.5, 0), 0.5 * x[1], 0.1)
    push = {"motor": lambda t: 0.2 * x[0] * t * (2 - t)}
    scene.add_joint(fb.Prismatic(arm.centre, block.centre, (1, 0), **push))
    scene.add_force(block.centre, (x[2], 3.0))
    return scene


def lever(x):
    """An elastic arm on a pin with friction and a spring."""
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_beam([(0, 0), (1, 0.1)], fb.Section(**DATA | {"EI": 60 * x[0]}), elements=3)
    friction = fb.Coulomb(0.4 * x[1], 500.0, radius=0.1)
    laws = {"spring": fb.Spring(150.0 * x[2]), "friction": friction}
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, **laws))
    scene.add_force(arm.end, (3.0 * x[0], -20.0 * x[1]))
    return scene


def stretched_at_first(x):
    """A beam that yields under a spring under tension, and its loads."""
    scene = yielding(x)
    scene.add_force_between(scene.beams[0].end, (1.0, 1.0), spring=fb.Spring(20.0, rest=0.5))
    return scene


def chain(x):
    """Three elastic bars that hang between two points: a mechanism."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    places = [(0, 0), (x[0], -0.3), (2 * x[0], -0.2), (2.6, 0.1 * x[1])]
    for ends in zip(places[:-1], places[1:], strict=True):
        section = fb.Section(**DATA | {"EA": 1e3 * x[2], "rhoA": x[1]})
        bar = scene.add_beam(ends, section, elements=1)
        if last is None:
            scene.pin(bar.start)
        else:
            scene.add_joint(fb.Revolute(last.end, bar.start))
        last = bar
    scene.pin(last.end)
    return scene


def weighed(x):
    """A weight slides on a sloping beam of other lengths and heights, held by a spring along it."""
    section = fb.Section(EA=1e4, GA=1.1e4, EI=300 * x[2], rhoA=1.0, rhoI=0.01)
    scene, beam = pinned_bar((4 * x[0], 0.5 * x[1]), section, elements=8, gravity=(0, -9.81))
    scene.pin(beam.end)
    load = scene.add_body((1.12 * x[0], 0.14 * x[1]), mass=4 * x[2], inertia=0.1)
    scene.add_joint(fb.Slider(beam, load.centre, spring=fb.Spring(300 * x[1], rest=1.0)))
    scene.fix(load.centre, "rotation")
    return scene


def resting(x):
    """A cantilever on another one, at rest with friction."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=4e3, EI=10.0 * x[1], rhoA=1.0, rhoI=1e-3)
    for y, length, elements in ((0.0, 1.0, 7), (0.1 + 0.01 * x[2], 0.9, 5)):
        beam = scene.add_beam([(0, y), (length, y)], section, elements=elements)
        scene.clamp(beam.start)
    friction = fb.Coulomb(0.3, 1e3)
    scene.add_contact(beam, scene.beams[0], stiffness=1e5, radius=0.05, friction=friction)
    scene.add_force(beam.end, (0.0, -5.0 * x[0]))
    return scene


def bending(x):
    """A cantilever that bends itself, and is loaded."""
    scene, beam = cantilever(fb.Section(**DATA | {"EI": 10 * x[0]}), points=[(0, 0), (x[2], 0)])
    scene.add_natural_strain(beam, curvature=lambda f: x[1] + 2 * x[0] * f, axial=x[2] * 1e-3)
    scene.add_force(beam.end, (0.0, -3.0))
    return scene


OF_BARS = [f"{of} of beam {k}" for of in "QM" for k in (1, 2)]  # zero but for round-off
LOSSES = ["work", "dissipated"]
#: What has no derivatives: work of followers, natural strains and mechanisms, losses of friction.
SCENES = {
    loads: ["work"],
    driven: [],
    yielding: [],
    slide: [],
    motors: [],
    lever: LOSSES,
    stretched_at_first: LOSSES,
    chain: ["work", *OF_BARS],
    weighed: [],
    resting: LOSSES,
    bending: ["work"],
}
AT_REST = "velocity", "spin", "acceleration", "rate"


def with_outputs(build, *without):
    def observed(x):
        scene = build(x)
        outputs = outputs_of(scene, [*SCENES.get(build, ()), *without])
        rests = () if build is released else AT_REST
        return scene, {name: it for name, it in outputs.items() if it.quantity not in rests}

    return observed


@pytest.mark.parametrize("build", SCENES, ids=lambda build: build.__name__)
def test_all_outputs_of_equilibria_have_their_derivatives(build):
    assert_derivatives(fb.StaticResponse(with_outputs(build), load_steps=3, t=1.0, newton=EXACT), X)


# -- Starts of motions -----------------------------------------------------------------------------


def moving(build, start):
    """A motion from an equilibrium."""
    return fb.Response(build, dt=0.01, t_end=0.05, start=start, newton=EXACT)


@pytest.mark.parametrize("build", [released, yielding, lever, slide])
def test_a_motion_from_an_equilibrium_takes_its_derivatives_without_further_equilibria(build):
    count = [0]

    def start(scene):
        count[0] += 1
        return fb.static(scene, load_steps=4, newton=EXACT)

    run = moving(with_outputs(build), start)
    _, y = run(X)
    J = run.jacobian()
    assert_both_ways_agree(run, y, J)
    assert count[0] == 1  # that of the motion, which derivatives do not repeat
    derivatives.assert_they_are_those_of_the_motion(run, X, J)


def test_a_start_that_goes_on_from_another_equilibrium():
    """A start of an elastic scene does not depend on the way; one that yields is differenced."""

    def from_half(scene):
        half = fb.static(scene, load_steps=2)
        return fb.static(scene, load_steps=2, start=half, newton=EXACT)

    for build in (driven, yielding):
        assert_derivatives(moving(with_outputs(build, *LOSSES), from_half), X)


@pytest.mark.parametrize("kind", ["between", "rope", "to the ground"])
@pytest.mark.parametrize("place", ["before the joint", "behind it", "at the tip"])
def test_forces_of_a_joint_beside_a_line_that_is_taut_as_drawn(kind, place):
    """Below the load factor 1 what holds the line fades, on the node of the joint alone."""

    def build(x):
        scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=50.0)
        root = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
        arm = scene.add_beam([(1, 0), (2, 0)], section, elements=2)
        scene.clamp(root.start)
        joint = scene.add_joint(fb.Revolute(root.end, arm.start, spring=fb.Spring(50.0)))
        node = {"before the joint": root.end, "behind it": arm.start, "at the tip": arm.end}[place]
        if kind == "between":
            line = scene.add_force_between(node, (1.2, 1.3), spring=fb.Spring(x[0], rest=x[1]))
        elif kind == "rope":
            line = scene.add_rope([node, (1.2, 1.3)], spring=fb.Spring(x[0]), length=x[1])
        else:
            line = scene.add_spring(node, y=fb.Spring(x[0], rest=0.1 * x[1])).y
        scene.add_force(arm.end, (0, -1.0))
        outputs = {
            "joint": fb.Output("force", joint),
            "clamp": fb.Output("reaction", root.start),
            "line": fb.Output("force", line),
            "M": fb.Output("M", root.at(0.3)),
        }
        return scene, outputs

    assert_derivatives(fb.StaticResponse(build, load_steps=2, newton=EXACT), [30.0, 0.9])


# -- What is refused -------------------------------------------------------------------------------


def swinging_with_friction(x):
    friction = fb.Coulomb(0.1, 10.0, radius=0.1)
    scene, bob, _ = hinged_body(
        (0.1 * x[0], -1), 1.0, 0.1, {"O": (0, 0)}, friction=friction, gravity=(0, -9.81)
    )
    return scene


def yielded_at_first(x):
    """A spring that yields as it is drawn."""

    def flow(old, strains0, strains, dt):
        excess = ufl.max_value(abs(strains[0] - old[0]) - 0.1, 0)
        return [old[0] + ufl.sign(strains[0] - old[0]) * excess]

    scene, beam = cantilever(fb.Section(**DATA))
    law = {"strain_energy": lambda turn, a: 25.0 * (turn - a[0]) ** 2 + 1.0 * a[0] ** 2}
    spring = fb.Spring(rest=0.3, internal=fb.InternalVariables(("a",), flow), **law)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.end, spring=spring))
    return scene


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (swinging_with_friction, "depend on how it settles"),
        (yielded_at_first, "under tension, and change internal variables"),
        (chain, "'work'.* of a mechanism, which also depends on how it settles"),
        (bending, "'work'.* in equilibria where natural strains do work"),
    ],
)
def test_what_has_no_derivatives_in_equilibria_is_refused_by_its_name(build, message):
    def observed(x):
        scene = build(x)
        return scene, {"work": fb.Output("work", scene)}

    run = fb.StaticResponse(observed, load_steps=2)
    run(X)
    assert_refused(message, run.jacobian)
