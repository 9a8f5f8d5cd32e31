"""Derivatives of natural frequencies: closed forms, remainders, crossing and repeated modes."""

import functools
import pickle

import ufl

import numpy as np
import pytest
from derivatives import assert_left_of_second_order, difference
from scenes import assert_refused, clamped_bar, guided_body, held_body, hinged_body, supported_bar
from test_static_response import DATA, X, bending, chain, driven, motors, slide

import fx_beam as fb

LONG = {"elements": 16, "degree": 2}


def cantilever(x):
    """EI, mass per length and length; the other stiffnesses are large, and grow with EI."""
    section = fb.Section(EA=1e6 * x[0], GA=1e6 * x[0], EI=x[0], rhoA=x[1])
    scene, beam = clamped_bar((x[2], 0), section, **LONG)
    return scene


def column(x):
    """EI, and a force at its end, between two pins."""
    section = fb.Section(EA=1e7, GA=1e7, EI=x[0], rhoA=1.0)
    scene, beam = supported_bar((1, 0), section, **LONG, load=(-x[1], 0))
    return scene


def crossed(x):
    """A mass on a cross of four beams: half lengths along x and y, and stiffness."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4 * x[2], GA=1e4 * x[2], EI=x[2], rhoA=1.0)
    lines = [[(-x[0], 0), (x[0], 0)], [(0, -x[1]), (0, x[1])]]
    first, second = (scene.add_beam(points, section, elements=4) for points in lines)
    for node in (first.start, first.end, second.start, second.end):
        scene.clamp(node)
    scene.add_joint(fb.Rigid(first.node(0.5), second.node(0.5)))
    scene.add_mass(second.node(0.5), 10.0)
    return scene


def damped(x):
    scene, section = fb.Scene(gravity=(0, -x[3])), {"EA": 1e4, "GA": 1e4, "rhoA": 1.0}
    member = fb.Section(EI=2.0, retardation=1e-3 * x[1], **section)
    beam = scene.add_beam([(0, 0), (x[0], 0)], member, elements=3, degree=2)
    hinge = {"spring": fb.Spring(20.0), "damper": fb.Damper(0.5 * x[2])}
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, **hinge))
    scene.add_drag(beam.end, linear=0.1 * x[0])
    return scene


def loaded(scene):
    return fb.static(scene, load_steps=3, t=1.0, newton=fb.NewtonOptions(tolerance=1e-13))


def test_frequencies_of_a_cantilever_depend_on_its_data_as_in_the_closed_form():
    """They are in proportion to sqrt(EI / rhoA) / L^2, whatever the mode."""
    run = fb.ModalResponse(cantilever, n=3)
    x = np.array([2.0, 3.0, 1.5])
    w = run(x)
    assert w[0] == pytest.approx(3.51602 * np.sqrt(2.0 / 3.0) / 1.5**2, rel=1e-4)
    relative = run.jacobian() * x / w[:, None]
    assert relative[:, :2] == pytest.approx(np.tile([0.5, -0.5], (3, 1)), abs=1e-7)
    assert relative[:, 2] == pytest.approx(-2.0, abs=1e-3)  # it has some shear
    assert run.vjp([1, 0, 2]) == pytest.approx(np.array([1, 0, 2]) @ run.jacobian(), rel=1e-9)


def test_the_frequency_of_a_column_depends_on_its_force_as_in_the_closed_form():
    """w^2 = pi^2 (pi^2 EI - P) per unit of mass and length: the state follows from the force."""
    run, EI, P = fb.ModalResponse(column, n=1, state=loaded), 2.0, 12.0
    (w,) = run([EI, P])
    assert w**2 == pytest.approx(np.pi**2 * (np.pi**2 * EI - P), rel=1e-4)
    exact = np.pi**2 * np.array([np.pi**2, -1.0]) / (2 * w)
    assert run.jacobian()[0] == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize(
    ("build", "options"),
    [
        *((build, {"state": loaded}) for build in (bending, chain, driven, motors, slide)),
        (slide, {}),
        (damped, {"damped": True}),
        *((build, {"damped": True, "state": loaded}) for build in (damped, bending, driven)),
    ],
)
def test_what_is_left_of_the_linear_change_is_of_second_order(build, options, monkeypatch):
    if "damped" in options:
        monkeypatch.setitem(DATA, "retardation", 2e-3)
    x, run = np.append(X, 1.0), fb.ModalResponse(build, n=3, **options)
    w, J = assert_left_of_second_order(run, x)
    for _ in range(2):  # then by the scene with slopes, which without a state serves the values
        assert run(x) == pytest.approx(w, rel=1e-9)
        assert run.jacobian() == pytest.approx(J, rel=0, abs=1e-7 * abs(J).max())


# -- Turns, loops, slides and contact ------------------------------------------------------------

NUMBERS, SPIN = np.array([1.0, 1.1, 0.9]), 5.0


def turning(scene):
    newton = fb.NewtonOptions(tolerance=1e-13)
    return fb.static(scene, load_steps=2, spin=SPIN, pivot=(-0.3, 0.1), newton=newton)


def hinged(x):
    """A rigid body on a hinge at some distance from the pivot: stiffness and damping there."""
    distance, arm, mass, k, c = x
    hinge = (distance - 0.3, 0.1)
    centre = (distance + arm - 0.3, 0.1)
    laws = {"spring": fb.Spring(k), "damper": fb.Damper(c)}
    scene, body, _ = hinged_body(centre, mass, 0.2, {"hinge": hinge}, **laws)
    return scene


def limb(x, **data):
    return fb.Section(**{"EA": 1e4, "GA": 1e4, "EI": 10.0 * x, "rhoA": 1.0, "rhoI": 1e-3} | data)


def rotor(x):
    """A closed loop that turns, of two beams between a hub and a tip, with offsets."""
    scene = fb.Scene()
    ends = {"a": (0.3, 0.2 * x[0]), "b": (0.3, -0.2), "o": (0, 0)}
    hub = scene.add_body((0.1, 0), mass=1.0, inertia=0.1, points=ends)
    scene.clamp(hub["o"])
    upper, lower = [ends["a"], (x[1], 0.3)], [ends["b"], (1.0, -0.3)]
    one = scene.add_beam(upper, limb(x[2], retardation=1e-4), elements=2)
    two = scene.add_beam(lower, limb(1.0), elements=2)
    tip = scene.add_body((1.2, 0), mass=0.5 * x[0], inertia=0.02)
    for node, beam in ((hub["a"], one), (hub["b"], two)):
        scene.add_joint(fb.Revolute(node, beam.start, spring=fb.Spring(3.0 * x[1])))
    scene.add_joint(fb.Revolute(one.end, tip.centre, offset=(1.2 - x[1], -0.3)))
    scene.add_joint(fb.Rigid(two.end, tip.centre, offset=(0.2, 0.3)))
    return scene


def linkage(x):
    """Four bars, one of them the ground, of bodies that hang in a spring."""
    scene = fb.Scene(gravity=(0, -9.81))
    corners = [(0, 0), (0.3 * x[0], 0.9), (2.0, 1.3 * x[1]), (1.8, 0.0)]
    last, laws = fb.GROUND, {"spring": fb.Spring(100.0 * x[2], rest=0.2), "damper": fb.Damper(x[1])}
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        centre = (np.asarray(a) + np.asarray(b)) / 2
        bar = scene.add_body(centre, mass=1.0 + x[0], inertia=0.2, points={"a": a, "b": b})
        scene.add_joint(fb.Revolute(last, bar["a"], **laws))
        last, laws = bar["b"], {}
    scene.add_joint(fb.Revolute(last, fb.GROUND))
    return scene


def beaded(x):
    """A sleeve on a spring on a beam."""
    scene, rod = clamped_bar((2 * x[0], 0.1), limb(x[1]), elements=4, degree=2)
    bead = scene.add_body((0.9 * x[0], 0.045), mass=0.5, inertia=0.01)
    laws = {"spring": fb.Spring(60.0), "damper": fb.Damper(0.5 * x[2])}
    scene.add_joint(fb.Sleeve(rod, bead.centre, **laws))
    scene.add_force(rod.end, (0.3, -0.5 * x[2]))
    return scene


def pressed(x):
    """A beam that lies on another one, and on the ground, as deep as a thousandth of its length."""
    scene, low = clamped_bar((1, 0), limb(10.0 * x[0]), elements=4, gravity=(0, -9.81 * x[2]))
    high = scene.add_beam([(0.4, 0.0205), (1.2 * x[1], 0.25)], limb(x[1]), elements=3)
    scene.clamp(high.end)
    scene.add_contact(low, high, stiffness=1e4, radius=0.01)
    scene.add_contact(low.end, fb.Line((0, -1e-4), normal=(0, 1)), stiffness=3e3 * x[0])
    return scene


def assert_derivatives(run, x):
    """Beside differences of order six along a change of all numbers; and backwards."""
    w, J = run(x), run.jacobian()
    direction = x * np.random.default_rng(1).uniform(0.5, 1.5, len(x))
    moved = [run(x + k * 2e-3 * direction) for k in (-3, -2, -1, 1, 2, 3)]
    expected = np.tensordot(np.array([-1, 9, -45, 45, -9, 1]) / (60 * 2e-3), moved, 1)
    assert J @ direction == pytest.approx(expected, rel=0, abs=1e-8 * abs(J).max())
    run(x)
    weights = np.random.default_rng(0).standard_normal(w.shape)
    assert run.vjp(weights) == pytest.approx(np.tensordot(weights, J, w.ndim), rel=1e-8, abs=1e-9)


@pytest.mark.parametrize(
    ("build", "state", "damping"),
    [
        (rotor, turning, False),
        (beaded, turning, True),
        (linkage, None, False),
        (linkage, loaded, True),
        (beaded, loaded, False),
        (beaded, loaded, True),
        (pressed, loaded, False),
        (pressed, loaded, True),
    ],
)
def test_turns_loops_slides_and_contact_have_derivatives(build, state, damping):
    run = fb.ModalResponse(build, n=4, state=state, damped=damping)
    assert_derivatives(run, NUMBERS)


def test_a_body_that_turns_on_a_hinge_has_the_derivatives_of_its_closed_form():
    """w^2 = (k + spin^2 e m s) / (J + m s^2), with the pivot at e and its mass at s."""
    x = np.array([0.5, 0.7, 2.0, 3.0, 0.4])
    e, s, m, k, c = x
    J, turn_stiffness = 0.2 + m * s**2, SPIN**2 * e * m * s
    square, damping = (k + turn_stiffness) / J, c / (2 * J)
    by_square = np.array([turn_stiffness / e, turn_stiffness / s, turn_stiffness / m, 1, 0]) / J
    by_inertia = np.array([0, 2 * m * s, s**2, 0, 0]) / J
    by_square -= square * by_inertia
    run = fb.ModalResponse(hinged, n=1, state=turning, damped=True)
    ((w, ratio),) = run(x)
    assert (w**2, ratio * w) == pytest.approx((square, damping), rel=1e-9)
    by_w, by_ratio = run.jacobian()[0]
    assert 2 * w * by_w == pytest.approx(by_square, rel=0, abs=1e-8 * abs(by_square).max())
    by_damping = damping * (np.array([0, 0, 0, 0, 1 / c]) - by_inertia)
    assert ratio * by_w + w * by_ratio == pytest.approx(by_damping, rel=0, abs=1e-8)


def test_closed_contact_has_the_derivatives_of_its_closed_form_at_each_depth():
    """Of a body on a hinge, whose tip below presses on the floor: it also rises as it turns.

    With U(a) = kt (a - a0)^2/2 + k d^2/2 and the depth d = sin a0 - sin a under a moment.
    """
    k, kt, inertia, a0 = 1e4, 50.0, 0.5, -1.4

    def build(x, moment):
        scene, tip = fb.Scene(), (np.cos(a0), np.sin(a0))
        body = scene.add_body((0, 0), mass=1.0, inertia=inertia, points={"tip": tip})
        scene.add_joint(fb.Revolute(fb.GROUND, body.centre, spring=fb.Spring(kt)))
        scene.add_contact(body["tip"], fb.Line(tip, (0, 1)), stiffness=x[0])
        scene.add_moment(body.centre, moment)
        return scene

    for depth in np.geomspace(1e-3, 2e-3, 7):
        a = np.arcsin(np.sin(a0) - depth)
        c, s = np.cos(a), np.sin(a)
        moment, stiffness = kt * (a - a0) - k * depth * c, kt + k * (c**2 + depth * s)
        by_angle, angle_by_k = k * (depth * c - 3 * c * s), depth * c / stiffness
        exact = (c**2 + depth * s + by_angle * angle_by_k) / (2 * np.sqrt(stiffness * inertia))
        made = functools.partial(build, moment=moment)
        run = fb.ModalResponse(made, n=1, state=fb.static)
        assert run([k]) == pytest.approx(np.sqrt(stiffness / inertia), rel=1e-7)
        assert run.jacobian() == pytest.approx(exact, rel=1e-6)


def test_short_springs_in_a_large_scene_have_the_derivatives_of_their_closed_form():
    """A bead on a rail, to which a spring of 20 mm is held across: U(x) = k (r - r0)^2/2."""
    k, height, free, m, x = 300.0, 2e-2, 12e-3, 0.5, 16e-3
    r = np.hypot(x, height)
    force = k * (r - free) * x / r

    def build(number):
        scene = fb.Scene()
        bead = scene.add_body((0, 0), mass=m, inertia=0.1, points={"far": (1, 0)})
        scene.add_joint(fb.Prismatic(fb.GROUND, bead.centre, axis=(1, 0)))
        scene.add_force_between(bead.centre, (0.0, height), spring=fb.Spring(number[0], rest=free))
        scene.add_force(bead.centre, (force, 0.0))
        return scene

    square = k * (1 - free * height**2 / r**3) / m
    run = fb.ModalResponse(build, n=1, state=loaded)
    assert run([k]) ** 2 == pytest.approx(square, rel=1e-9)
    by_place = k * 3 * free * height**2 * x / r**5 / m
    place_by_k = -(r - free) * x / r / (m * square)
    exact = (square / k + by_place * place_by_k) / (2 * np.sqrt(square))
    assert run.jacobian() == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("kind", ["member", "force"])
def test_a_mass_on_a_cable_that_is_soft_in_compression_has_derivatives_of_its_tension(kind, damped):
    """Its frequency grows with the root of EA, at a strain of 1e-4 near which pieces meet."""

    def build(x):
        EA = fb.Parameter("EA", 1e5 * x[0])

        def energy(eps, gamma, kappa):
            return EA / 2 * (ufl.max_value(eps, 0) ** 2 + 0.01 * eps**2) + gamma**2 + kappa**2

        def pull(r, rate, t):
            return EA * (ufl.max_value(r - 1, 0) + 0.01 * (r - 1))

        scene, weight = held_body((0, -1), 1.0, 1.0, "x", "rotation", gravity=(0, -10))
        scene.add_drag(weight, linear=1.0)
        if kind == "force":
            scene.add_force_between(weight, (0, 0), force=pull)
            return scene
        cable = scene.add_beam([(0, 0), (0, -1)], fb.Section(strain_energy=energy), elements=1)
        scene.clamp(cable.start)
        scene.add_joint(fb.Rigid(weight, cable.end))
        return scene

    run = fb.ModalResponse(build, n=1, state=loaded, damped=damped)
    w = run([1.0]).ravel()[0]
    assert run.jacobian().ravel()[0] == pytest.approx(w / 2, rel=1e-6)


def test_nodes_that_touch_a_member_beside_its_end_have_their_derivatives():
    """There the curvature of its axis jumps: frequencies jump where the node passes the end."""

    def build(x):
        data = {"EA": 2e4, "GA": 1e4, "rhoA": 1.0, "rhoI": 0.01}
        scene, below = clamped_bar(
            (1, 0), fb.Section(EI=20.0 * x[0], **data), elements=4, gravity=(0.0, -9.81)
        )
        above = [(1.6, 0.3), (0.48, 0.03)]
        above = scene.add_beam(above, fb.Section(EI=10.0 * x[1], **data), elements=3)
        scene.clamp(above.start)
        scene.add_contact(above, below, stiffness=1e4 * x[2], radius=0.01)
        scene.add_force(above.end, (0.0, -6.0))
        return scene

    run, way = fb.ModalResponse(build, n=2, state=loaded), np.array([1.0, -0.7, 0.8])
    run(np.ones(3))
    J = run.jacobian()
    expected = difference(lambda step: run(np.ones(3) + step * way), 1e-4)
    assert J @ way == pytest.approx(expected, rel=0, abs=1e-6 * abs(J).max())


def test_quadratic_drag_leaves_the_derivatives_of_small_damping_as_they_are():
    """At rest it has no part in damping, whose forces are small beside those of a stiff frame."""

    def build(x, quadratic):
        section = fb.Section(EA=1e8, GA=5e7, EI=30.0 * x[0], rhoA=1.0, rhoI=0.01)
        scene, arm = clamped_bar((1, 0.2), section, elements=4, degree=2)
        post = scene.add_beam([arm.end, (1, 1)], section, elements=4, degree=2)
        scene.add_force(post.end, (0.0, -8.0))
        for beam in (arm, post):
            scene.add_drag(beam, linear=0.01 * x[1], quadratic=quadratic * x[1])
        return scene

    jacobians = []
    for quadratic in (0.0, 1.0):
        made = functools.partial(build, quadratic=quadratic)
        run = fb.ModalResponse(made, n=3, state=fb.static, damped=True)
        run([1.0, 1.0])
        jacobians.append(run.jacobian()[:, 1])
    assert jacobians[1] == pytest.approx(jacobians[0], rel=1e-4)


def test_little_damping_leaves_derivatives_by_a_material_that_stiffens_as_they_are():
    """Its strains in the steps that tell damping are small, and not in proportion to these."""

    def build(x):
        scene = fb.Scene(gravity=(0.0, -9.81))
        section = fb.Section(EA=2e4, GA=1e4, EI=60.0 * x[0], rhoA=1.0, rhoI=0.05)
        arm = scene.add_beam([(0, 0), (1, 0.3)], section, elements=4)

        def energy(eps, gamma, kappa):
            return 5e3 * (eps**2 + gamma**2) + 1.25e9 * eps**4 + 15 * kappa**2

        stiffening = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.05)
        last = scene.add_beam([(1, 0.3), (1.7, -0.1)], stiffening, elements=4)
        scene.clamp(arm.start)
        hinge = {"spring": fb.Spring(20.0 * x[1]), "damper": fb.Damper(1e-6)}
        scene.add_joint(fb.Revolute(arm.end, last.start, **hinge))
        scene.add_force(last.end, (30.0 * x[2], 0.0))
        return scene

    of_both = []
    for damping in (False, True):
        run = fb.ModalResponse(build, n=3, state=loaded, damped=damping)
        w = run([1.0, 1.0, 1.0])
        of_both.append(run.jacobian().reshape(*w.shape, -1))
    undamped, slightly = of_both[0], of_both[1][:, 0]
    assert slightly == pytest.approx(undamped, rel=0, abs=1e-6 * abs(undamped).max())


def test_modes_keep_their_places_where_frequencies_cross():
    run = fb.ModalResponse(crossed, n=3)
    before = run([1.0, 0.9, 1.0])
    after = run([0.9, 1.0, 1.0])
    assert (np.diff(before) > 0).all() and not (np.diff(after) > 0).all()
    assert np.sort(after) == pytest.approx(before, rel=1e-9)
    other = pickle.loads(pickle.dumps(run))  # has seen no modes yet
    assert other([0.9, 1.0, 1.0]) == pytest.approx(np.sort(after))


def test_repeated_modes_have_the_derivatives_of_their_group(caplog):
    """With other lengths they part: each change of a length alone is told exactly."""
    run = fb.ModalResponse(crossed, n=3)
    w = run([1.0, 1.0, 1.0])
    pair = np.flatnonzero(np.isclose(w, np.median(w), rtol=1e-9))
    J = run.jacobian()
    assert "have the same frequency" in caplog.text and len(pair) == 2
    for i in range(3):
        for sign in (1, -1):
            x = 1 + sign * 1e-5 * (np.arange(3) == i)
            slopes = (np.sort(fb.ModalResponse(crossed, n=3)(x)) - np.sort(w)) / (sign * 1e-5)
            assert np.sort(slopes) == pytest.approx(np.sort(J[:, i]), rel=1e-3)
    weights = 2.0 * np.isin(np.arange(3), pair)
    assert run.vjp(weights) == pytest.approx(weights @ J, rel=1e-9)
    weights[pair[0]] = 1.0
    assert_refused("only their sum has a gradient", lambda: run.vjp(weights))
    cut, whole = (fb.ModalResponse(crossed, n=n) for n in (4, 8))  # of five, one and all
    cut(np.ones(3)), whole(np.ones(3))
    assert cut.jacobian()[3] == pytest.approx(whole.jacobian()[3], rel=1e-9)


def overdamped(x):
    laws = {"spring": fb.Spring(1.0), "damper": fb.Damper(3.0 * x[0])}
    scene, body, _ = guided_body((0, 0), 1.0, 1.0, **laws)
    return scene


def held_by_friction(x):
    laws = {"spring": fb.Spring(x[0]), "friction": fb.Coulomb(1.0, 100.0)}
    scene, body, _ = guided_body((0, 0), 1.0, 1.0, **laws)
    return scene


def resting(x):
    scene = fb.Scene(gravity=(0, -x[0]))
    body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    scene.fix(body.centre, "rotation")
    ground = fb.Line((0, 0), normal=(0, 1))
    scene.add_contact(body.centre, ground, stiffness=100.0, friction=fb.Coulomb(1.0, 100.0))
    return scene


@pytest.mark.parametrize(
    ("build", "options", "message"),
    [
        (lambda x: crossed(np.ones(3)), {"damped": True, "n": 3}, "the same root"),
        (overdamped, {"damped": True}, "mode 0 does not vibrate: it is overdamped"),
        (held_by_friction, {"state": loaded}, "friction that sticks has none"),
        (resting, {"state": loaded}, "friction that sticks has none"),
    ],
)
def test_what_has_no_derivatives_is_refused(build, options, message):
    run = fb.ModalResponse(build, **{"n": 1} | options)
    run([1.0, 1.0, 1.0])
    assert_refused(message, lambda: run.jacobian())


def above(gap, friction):
    """Two beams, one of them above the other and above the ground."""

    def build(x):
        scene, low = clamped_bar((1, 0), limb(10.0 * x[0]), elements=4, gravity=(0, -x[2]))
        high = scene.add_beam([(0, 0.02 + gap), (x[1], 0.02 + gap)], limb(x[1]), elements=4)
        scene.clamp(high.start)
        scene.add_contact(low, high, stiffness=1e4, radius=0.01, friction=friction)
        ground = fb.Line((0, -gap - 0.1), normal=(0, 1))
        scene.add_contact(low.end, ground, stiffness=1e3, friction=friction)
        return scene

    return build


@pytest.mark.parametrize("state", [None, loaded])
@pytest.mark.parametrize("damped", [False, True])
def test_friction_of_open_contact_has_no_part_in_derivatives(state, damped):
    friction = fb.Coulomb(0.3, 1e3)
    options = {"state": state, "damped": damped}
    runs = [fb.ModalResponse(above(0.5, law), 3, **options) for law in (None, friction)]
    (w, J), (same, by_x) = ((run(np.ones(3)), run.jacobian()) for run in runs)
    assert same == pytest.approx(w, rel=1e-9, abs=1e-12)
    assert by_x == pytest.approx(J, rel=0, abs=1e-9 * abs(J).max())


@pytest.mark.parametrize("damped", [False, True])
def test_where_all_modes_are_rigid_nothing_changes(damped):
    """A free beam moves in three ways, whatever its data are."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=1e4, GA=1e4, EI=x[0], rhoA=x[1])
        scene.add_beam([(0, 0), (x[2], 0)], section, elements=1)
        return scene

    run = fb.ModalResponse(build, n=3, damped=damped)
    assert not run([10.0, 1.0, 2.0]).any()
    assert run.jacobian().shape == ((3, 2, 3) if damped else (3, 3))
    assert not run.jacobian().any()
    assert not run.vjp(np.ones((3, 2) if damped else 3)).any()
