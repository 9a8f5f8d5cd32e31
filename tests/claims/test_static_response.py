"""Equilibria as functions of numbers: derivatives by closed forms, and at starts of motions."""

import ufl

import numpy as np
import pytest
from jointed import KINDS
from test_internal_variables import EI, HARDENING, PLASTIC, YIELD, section

import fx_beam as fb

DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}
X = np.array([1.0, 1.1, 0.9])
EXACT = fb.NewtonOptions(tolerance=1e-13)


def gradients(run, y):
    """Derivatives of a random sum of all outputs, forwards and backwards, and its weights."""
    J, rng = run.jacobian(), np.random.default_rng(0)
    weights = {name: rng.standard_normal(values.shape) for name, values in y.items()}
    forward = sum(np.tensordot(weights[name], J[name], weights[name].ndim) for name in y)
    return forward, run.vjp(weights), weights


def differences(run, weights, h=1e-4):
    """The same by extrapolated differences of the outputs."""

    def value(x):
        return sum((weights[name] * values).sum() for name, values in run(x)[1].items())

    def central(h):
        return np.array([(value(X + h * e) - value(X - h * e)) / (2 * h) for e in np.eye(len(X))])

    return (4 * central(h) - central(2 * h)) / 3


# -- Closed forms ----------------------------------------------------------------------------------

LENGTH, ELEMENTS = 2.0, 40


def roll_up(x):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], fb.Section(**DATA), elements=ELEMENTS)
    scene.clamp(beam.start)
    scene.add_moment(beam.end, np.pi * DATA["EI"] / LENGTH * x[0])
    return scene, {"tip": fb.Output("position", beam.end)}


def rolled_tip(load):
    """Elements are straight between their ends, each turned by the same angle."""
    turn = np.pi * load
    bent = np.sin(turn / 2) / np.sin(turn / (2 * ELEMENTS)) * np.exp(1j * turn / 2)
    return LENGTH / ELEMENTS * np.array([bent.real, bent.imag])


def test_tip_of_a_rolled_beam_depends_on_its_load_as_exact():
    run = fb.StaticResponse(roll_up, steps=8)
    factors, y = run([1.0])
    J, h = run.jacobian()["tip"][..., 0], 1e-5
    loads = factors[1:, None]
    exact = [(rolled_tip(f * (1 + h)) - rolled_tip(f * (1 - h))) / (2 * h) for f in loads[:, 0]]
    assert y["tip"][1:] == pytest.approx(np.array([rolled_tip(f) for f in loads[:, 0]]), abs=1e-9)
    assert J[1:] == pytest.approx(np.array(exact), abs=1e-8)
    assert J[-1] == pytest.approx([-LENGTH, -2 * LENGTH / np.pi], rel=2e-3)
    for component in range(2):
        weights = np.zeros_like(y["tip"])
        weights[-1, component] = 1.0
        assert run.vjp({"tip": weights}) == pytest.approx(J[-1, component], abs=1e-9)


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
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], section(energy, flow, rhoA=1.0, rhoI=0.1), elements=1)
    scene.clamp(beam.start)
    scene.add_moment(beam.end, x[0])
    return scene, {"turn": fb.Output("rotation", beam.end)}


def test_turn_of_a_beam_that_has_yielded_depends_on_its_moment_and_limit_as_exact():
    moment, limit = 2 * YIELD, YIELD
    run = fb.StaticResponse(bent_beyond_its_limit, steps=4)
    factors, y = run([moment, HARDENING, limit])
    over = factors * moment - limit > 1e-9
    assert over.any() and not over.all()
    flown = np.where(over, (factors * moment - limit) / HARDENING, 0.0)
    assert y["turn"] == pytest.approx(factors * moment / EI + flown, abs=1e-9)
    exact = np.column_stack(
        [
            factors / EI + np.where(over, factors / HARDENING, 0.0),
            -flown / HARDENING,
            np.where(over, -1 / HARDENING, 0.0),
        ]
    )
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


# -- All kinds of numbers --------------------------------------------------------------------------


def loaded(x):
    """Dead, line and follower loads, weight, a spring, an obstacle, a taper; the shape changes."""
    scene = fb.Scene(gravity=(0, -9.81 * x[2]))
    own = DATA | {"EA": 1e4 * x[0], "EI": lambda s: 100 * (1 - x[0] * s / 4)}
    beam = scene.add_beam([(0, 0), (1, 0.3 * x[0])], fb.Section(**own), elements=3, degree=2)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (20 * x[1], -30.0))
    scene.add_force(beam.end, (0, 20 * x[1]), follower=True)
    scene.add_line_load(beam, (3 * x[0], 2 * x[1]))
    scene.add_mass(beam.end, 0.5 * x[1])
    spring = fb.Spring(30 * x[0], rest=0.5 * x[1])
    pull = {"spring": spring, "force": lambda r, rate, t: 2 * ufl.sin(t + 1) / r}
    scene.add_force_between(beam.end, (2, 0.5), **pull)
    scene.add_obstacle(beam.end, fb.Circle((1.0, -0.9 * x[1]), 0.9), stiffness=1e3 * x[0])
    return scene, {"tip": fb.Output("position", beam.end)}


def driven(x):
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(**DATA), elements=3)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, spring=fb.Spring(50 * x[0], rest=0.3)))
    scene.prescribe(beam.end, y=0.2 * x[1])
    scene.add_moment(beam.end, x[1] * x[2])
    return scene, {"middle": fb.Output("position", beam.node(2 / 3))}


def yielding(x):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (x[0], 0)], PLASTIC, elements=4)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (x[2], 6 * x[1]))
    return scene, {"tip": fb.Output("position", beam.end)}


def sliding(x):
    make, offset, given = KINDS["prismatic with offset"]
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_beam([(-1, 0), (0, 0)], fb.Section(**DATA), elements=2)
    scene.clamp(first.start)
    start = np.array(offset) + (x[0] - 1) * np.array(given["axis"])
    own = fb.Section(**DATA | {"EI": 100 * x[1]})
    second = scene.add_beam([start, start + (0.8, -0.6)], own, elements=2)
    spring = fb.Spring(200 * x[2], rest=0.05)
    scene.add_joint(make(first.end, second.start, **given, spring=spring))
    scene.add_force(second.end, (x[0], 2.0))
    return scene, {"tip": fb.Output("position", second.end)}


SCENES = {"loads": loaded, "driven": driven, "yielding": yielding, "slide": sliding}


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_of_equilibria_are_those_of_differences_in_both_ways(name):
    run = fb.StaticResponse(SCENES[name], steps=4, newton=EXACT)
    _, y = run(X)
    forward, backward, weights = gradients(run, y)
    assert forward == pytest.approx(backward, rel=1e-9, abs=1e-12)
    expected = differences(run, weights)
    assert forward == pytest.approx(expected, rel=0, abs=1e-8 * abs(expected).max())


@pytest.mark.parametrize("name", SCENES)
def test_a_motion_from_an_equilibrium_takes_its_derivatives_without_further_equilibria(name):
    count = [0]

    def start(scene):
        count[0] += 1
        return fb.static(scene, steps=4, newton=EXACT)

    run = fb.Response(SCENES[name], dt=0.01, t_end=0.05, start=start, newton=EXACT)
    _, y = run(X)
    forward, backward, weights = gradients(run, y)
    assert count[0] == 2  # that of the motion, and of its repetition on a tape
    assert forward == pytest.approx(backward, rel=1e-9, abs=1e-12)
    expected = differences(run, weights)
    assert forward == pytest.approx(expected, rel=0, abs=1e-8 * abs(expected).max())


# -- Other starts, and what is refused -------------------------------------------------------------


def test_a_start_that_goes_on_from_another_equilibrium():
    """That of an elastic scene does not depend on the way; one that yields is differenced."""

    def from_half(scene):
        half = fb.static(scene, steps=2)
        return fb.static(scene, steps=2, start=half, newton=EXACT)

    for build in (driven, yielding):
        run = fb.Response(build, dt=0.01, t_end=0.02, start=from_half, newton=EXACT)
        _, y = run(X)
        forward, backward, weights = gradients(run, y)
        assert forward == pytest.approx(backward, rel=1e-9)
        expected = differences(run, weights)
        assert forward == pytest.approx(expected, rel=0, abs=1e-6 * abs(expected).max())


# -- Friction of joints, and mechanisms ------------------------------------------------------------


def block(x):
    """A block on rails, which its load F pushes against a spring and the friction mu N."""
    scene = fb.Scene()
    of = {"axis": (1, 0), "spring": fb.Spring(200.0), "friction": fb.Coulomb(x[2], 1e4)}
    block = scene.add_body((0, 0), 1.0, 0.1).centre
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, block, **of))
    scene.add_force(block, (x[0], -x[1]))
    return scene, {"d": fb.Output("slide", joint), "force": fb.Output("force", joint)}


def test_a_block_with_friction_moves_by_f_less_mu_n_over_k():
    x = np.array([30.0, 50.0, 0.2])
    run = fb.StaticResponse(block, steps=3)
    y = run(x)[1]
    assert y["d"][-1] == pytest.approx((30.0 - 10.0) / 200.0)
    J = run.jacobian()
    assert J["d"][-1] == pytest.approx(np.array([1.0, -0.2, -50.0]) / 200.0, rel=1e-10)
    weights = {"d": np.array([0, 0, 0, 1.0])}
    assert run.vjp(weights) == pytest.approx(J["d"][-1], rel=1e-12)


def lever(x):
    """An elastic arm on a pin with friction and a spring."""
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_beam([(0, 0), (1, 0.1)], fb.Section(**DATA | {"EI": 60 * x[0]}), elements=4)
    friction = fb.Coulomb(0.4 * x[1], 500.0, radius=0.1)
    of = {"spring": fb.Spring(150.0 * x[2]), "friction": friction}
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, **of))
    scene.add_force(arm.end, (3.0 * x[0], -20.0 * x[1]))
    return scene, {"p": fb.Output("position", arm.end), "force": fb.Output("force", joint)}


def chain(x):
    """Three elastic bars that hang between two points."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    places = [(0, 0), (x[0], -0.3), (2 * x[0], -0.2), (2.6, 0.1 * x[1])]
    for ends in zip(places[:-1], places[1:], strict=True):
        section = fb.Section(**DATA | {"EA": 1e3 * x[2], "rhoA": x[1]})
        bar = scene.add_beam(ends, section)
        if last is None:
            scene.pin(bar.start)
        else:
            scene.add_joint(fb.Revolute(last.end, bar.start))
        last = bar
    scene.pin(last.end)
    first = scene.beams[0]
    of = {"p": fb.Output("position", first.end), "held": fb.Output("reaction", first.start)}
    return scene, of


@pytest.mark.parametrize("build", [lever, chain])
def test_friction_of_joints_and_mechanisms_have_derivatives_and_motions_from_them(build):
    """Those of an equilibrium, and the same at the start of a motion that it begins."""
    run = fb.StaticResponse(build, steps=4, newton=EXACT)
    _, y = run(X)
    forward, backward, weights = gradients(run, y)
    assert forward == pytest.approx(backward, rel=1e-10)
    at_rest = run.jacobian("p")["p"][-1]
    expected = differences(run, weights)
    assert forward == pytest.approx(expected, rel=0, abs=1e-7 * abs(expected).max())

    def start(scene):
        return fb.static(scene, steps=4, newton=EXACT)

    moved = fb.Response(build, dt=0.01, t_end=0.03, start=start, newton=EXACT)
    moved(X)
    places = moved.jacobian("p")["p"]
    assert places[0] == pytest.approx(at_rest, rel=0, abs=1e-10 * abs(at_rest).max())
    assert places[-1] == pytest.approx(at_rest, rel=0, abs=1e-6 * abs(at_rest).max())


def test_a_mechanism_whose_friction_depends_on_its_way_is_refused():
    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        bob = scene.add_body((0.1 * x[0], -1), 1.0, 0.1, points={"O": (0, 0)})
        friction = fb.Coulomb(0.1, 10.0, radius=0.1)
        scene.add_joint(fb.Revolute(fb.GROUND, bob["O"], friction=friction))
        return scene, {"p": fb.Output("position", bob.centre)}

    run = fb.StaticResponse(build, steps=2)
    run([1.0])
    with pytest.raises(fb.SceneError, match="depend on how it settles"):
        run.jacobian()


def test_derivatives_before_a_call_are_refused():
    with pytest.raises(fb.SceneError, match=r"StaticResponse\.vjp .* called after run\(x\)"):
        fb.StaticResponse(loaded).vjp({})


def test_springs_under_tension_that_yield_before_the_loads_are_refused():
    def build(x):
        scene, outputs = yielding(x)
        spring = fb.Spring(20.0, rest=0.5)
        scene.add_force_between(scene.beams[0].end, (1.0, 1.0), spring=spring)
        return scene, outputs

    run = fb.StaticResponse(build, steps=2)
    run(X)
    with pytest.raises(fb.SceneError, match="under tension, and change internal variables"):
        run.jacobian()
