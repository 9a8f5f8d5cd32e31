"""Mechanisms that their loads hold: the equilibria in which they settle."""

import ufl

import numpy as np
import pytest
import scenes
import scipy.optimize
from jointed import four_bar
from scenes import assert_refused, clamped_bar, held_body, hinged_body, one_body, pinned_bar

import fx_beam as fb

G = 9.81
STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-4)


def pendulum(angle):
    """A body on an arm of 1 m, at an angle from the vertical, and its frequency."""
    place = np.round([np.sin(angle), -np.cos(angle)], 12)
    scene, bob, _ = hinged_body(place, 2.0, 0.5, {"O": (0, 0)}, gravity=(0, -G))
    return scene, bob.centre, np.sqrt(2.0 * G / 2.5)


@pytest.mark.parametrize(
    ("angle", "how"), [(0.0, None), (np.pi / 2, None), (3.1, None), (0.7, "arc-length")]
)
def test_a_pendulum_hangs_down_wherever_it_starts(angle, how):
    scene, bob, frequency = pendulum(angle)
    path = fb.static(scene, load_steps=4, continuation=how)
    assert path.load_factor[[0, -1]].tolist() == [0.25, 1.0]
    assert path.position(bob) == pytest.approx(np.array([[0.0, -1.0]] * len(path.t)), abs=1e-9)
    assert path.stable.all() and path.critical_points == []
    frequencies = fb.modes(scene, path, n=1).angular_frequencies
    assert frequencies == pytest.approx([frequency], rel=1e-9)


def test_a_pendulum_on_its_head_is_said_to_be_unstable(caplog):
    scene, bob, _ = pendulum(np.pi)
    path = fb.static(scene, load_steps=2)
    assert path.position(bob)[-1] == pytest.approx([0, 1], abs=1e-9)
    assert path.unstable_modes.tolist() == [1, 1]
    assert "is unstable" in caplog.text


@pytest.mark.parametrize("side", [-1, 1])
def test_a_chain_of_bars_hangs_as_a_funicular_polygon(side):
    """From below its supports and from above: half of each bar's weight is at its ends."""
    scene, n = fb.Scene(gravity=(0, -G)), 7
    angles = np.linspace(0, np.pi, n + 1)
    places = np.column_stack([-np.cos(angles), side * np.sin(angles)])
    bars = [
        scene.add_beam(ends, STIFF, elements=1)
        for ends in zip(places[:-1], places[1:], strict=True)
    ]
    for first, second in zip(bars[:-1], bars[1:], strict=True):
        scene.add_joint(fb.Revolute(first.end, second.start))
    scene.pin(bars[0].start)
    scene.pin(bars[-1].end)
    path = fb.static(scene, load_steps=2)
    left, right = (path.reaction(node)[-1, :2] for node in (bars[0].start, bars[-1].end))
    weight = G * sum(bar.length for bar in bars)
    assert left + right == pytest.approx([0, weight], abs=1e-8 * weight)
    x = np.array([path.position(bar.start)[-1] for bar in bars] + [[1.0, 0.0]])
    slopes = np.diff(x[:, 1]) / np.diff(x[:, 0])
    rises = np.diff(slopes) * abs(left[0])
    halves = G * np.array([bar.length for bar in bars]) / 2
    assert rises == pytest.approx(halves[:-1] + halves[1:], rel=1e-6)
    assert path.stable.all() and x[1:-1, 1].max() < 0


def hinged_arm():
    """A heavy arm on a pin, which starts level."""
    section = fb.Section(EA=400.0, GA=150.0, EI=0.5, rhoA=0.1, rhoI=1e-5)
    return pinned_bar((1, 0), section, elements=8, gravity=(0.0, -G))


@pytest.mark.parametrize("wind", [0.0, 0.1])
@pytest.mark.parametrize("how", [None, "arc-length"])
def test_an_arm_hangs_with_a_force_of_ones_own_as_with_a_load(wind, how):
    """Drag against the velocity does not act at rest, and wind is a line load."""
    scene, arm = hinged_arm()
    scene.add_virtual_work(lambda step: -0.4 * ufl.dot(step.v, step.virtual_u))
    loaded, other = hinged_arm()
    if wind:
        scene.add_virtual_work(lambda step: wind * step.load_factor * step.virtual_u[0])
        loaded.add_line_load(other, (wind, 0.0))
    computed, exact = (fb.static(it, load_steps=5, continuation=how) for it in (scene, loaded))
    assert computed.load_factor[[0, -1]].tolist() == exact.load_factor[[0, -1]].tolist() == [0.2, 1]
    assert computed.position(arm.end)[-1] == pytest.approx(exact.position(other.end)[-1], abs=1e-9)


def test_a_bed_of_ones_own_holds_an_arm_from_the_start():
    scene, arm = hinged_arm()
    scene.add_virtual_work(lambda step: -80.0 * step.u[1] * step.virtual_u[1])
    path = fb.static(scene, load_steps=5)
    assert path.load_factor[0] == 0 and not path.q[0].any()
    assert path.displacement(arm.end)[-1, 1] == pytest.approx(-0.1 * G / 80, rel=0.25)


def test_a_loop_of_bars_hangs_where_its_weight_is_lowest():
    def held(angle):
        return fb.static(four_bar(motor=lambda t: angle * t)[0], t=1.0, load_steps=4)

    def height(angle):
        return held(angle).energy.potential[-1]

    best = scipy.optimize.minimize_scalar(height, bounds=(-3.5, -2.5), options={"xatol": 1e-6}).x
    path = fb.static(four_bar()[0], load_steps=2)
    assert path.q[-1] == pytest.approx(held(best).q[-1], abs=1e-5)
    assert path.stable.all()


def test_a_body_comes_to_rest_in_a_groove():
    scene, ball = one_body((0.3, 1.0), mass=1.0, inertia=0.1, gravity=(0, -G))
    scene.fix(ball.centre, "rotation")
    for side in (1, -1):
        scene.add_contact(ball.centre, fb.Line((0, 0), (side, 1)), stiffness=1e5)
    path = fb.static(scene, load_steps=3)
    # Each side is pressed in by d = -y / sqrt(2): 2 k d / sqrt(2) = m g.
    assert path.position(ball.centre)[-1] == pytest.approx([0, -G / 1e5], abs=1e-9)
    assert path.stable.all()


@pytest.mark.parametrize("gap", [0.0, 1e-4])
def test_a_ball_comes_to_rest_on_a_thin_beam_by_friction(gap):
    """Steps that would pass the beam are shortened."""
    k, weight = 1e4, 0.2 * 9.81
    scene, ball = held_body((0.02, 0.02 + gap), 0.2, 1e-4, "rotation", gravity=(0.0, -9.81))
    bed = scene.add_beam([(-0.5, 0), (0.5, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=10)
    for node in bed.nodes:
        scene.clamp(node)
    scene.add_contact(ball, bed, k, radius=(0.01, 0.01), friction=fb.Coulomb(0.5, k))
    down = gap + weight / k
    assert fb.static(scene).displacement(ball)[-1] == pytest.approx([0.0, -down], abs=1e-8)


def test_a_second_load_starts_from_what_hangs():
    scene, bob, _ = pendulum(1.0)
    hanging = fb.static(scene, load_steps=2)
    scene.add_force(bob, (2.0 * G, 0.0))
    path = fb.static(scene, load_steps=4, start=hanging)
    assert path.position(bob)[-1] == pytest.approx([np.sqrt(0.5), -np.sqrt(0.5)], abs=1e-9)


def test_what_no_load_holds_is_refused():
    def body(rotates=False):
        scene, part = one_body((0.3, 0.5), mass=1.0, inertia=0.1, gravity=(0, -G))
        if not rotates:
            scene.fix(part.centre, "rotation")
        return scene, part.centre

    falling, _ = body()
    assert_refused("along .*as a rigid body.* finds no equilibrium", fb.static, falling)
    sliding, block = body()
    sliding.add_contact(block, fb.Line((0, 0), (0, 1)), stiffness=1e5)
    assert_refused(r"they leave x of node 0 at \(0.3, 0.5\) free", fb.static, sliding)
    turning, ball = body(rotates=True)
    for side in (1, -1):
        turning.add_contact(ball, fb.Line((0, 0), (side, 1)), stiffness=1e5)
    assert_refused("they leave rotation of node 0 .* free", fb.static, turning)
    soft = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    # In the sag of a beam that is held at both ends, and down one that is held at its start.
    for end, message in (
        ((0.9, 0.0), "they leave rotation of node .* free"),
        ((0.9, -0.4), r"no equilibrium .*: the node runs off the end of the beam"),
    ):
        carried, beam = clamped_bar(end, soft, elements=4, gravity=(0, -G))
        if not end[1]:
            carried.clamp(beam.end)
        bead = carried.add_body((0.45, end[1] / 2), mass=0.5, inertia=0.01)
        carried.add_joint(fb.Slider(beam, bead.centre))
        assert_refused(message, fb.static, carried)
    loose = fb.Scene()
    loose.pin(loose.add_beam([(0, 0), (1, 0)], STIFF, elements=1).start)
    assert_refused(r"can rotate about \(0, 0\) .* it has no load", fb.static, loose)


def taut_bars(scene, stretched):
    """Two hinged bars that are too short for their supports, or are stretched by one of them."""
    bars = [scene.add_beam([(x, 0), (x + 1, 0)], STIFF, elements=1) for x in (0, 1)]
    scene.add_joint(fb.Revolute(bars[0].end, bars[1].start))
    scene.pin(bars[0].start)
    scene.fix(bars[1].end, "y")
    scene.prescribe(bars[1].end, x=2e-4 * stretched)
    for bar in bars:
        scene.add_natural_strain(bar, axial=1e-4 * stretched - 1e-4)
    return bars[0].end, 2 / 3 * (STIFF.rhoA + STIFF.rhoI)


def taut_springs(scene):
    mass = scene.add_body((1, 0), mass=3.0, inertia=0.1).centre
    scene.fix(mass, "rotation")
    for x in (0.0, 2.0):
        scene.add_force_between(mass, (x, 0.0), spring=fb.Spring(1e4, rest=0.99))
    return mass, 3.0


@pytest.mark.parametrize(
    "build", [taut_springs, lambda scene: taut_bars(scene, 0), lambda scene: taut_bars(scene, 1)]
)
def test_prestress_holds_what_has_no_load(build):
    """The tension T = 100 N at l = 1 m to both sides has the stiffness 2 T / l across."""
    scene = fb.Scene()
    middle, mass = build(scene)
    path = fb.static(scene, load_steps=2)
    assert path.stable.all() and abs(path.displacement(middle)[:, 1]).max() < 1e-12
    (frequency,) = fb.modes(scene, path, n=1).angular_frequencies
    assert frequency == pytest.approx(np.sqrt(200 / mass), rel=3e-4)
    scene.add_force(middle, (0.0, -0.02))
    sunk = fb.static(scene, start=path).displacement(middle)[-1, 1]
    assert sunk == pytest.approx(-1e-4, rel=1e-4)


def test_a_blade_on_a_hinge_is_held_by_its_turn():
    """Its frequency is the spin times sqrt(e m r / J), with the hinge at e and J about it."""
    scene, blade, _ = hinged_body((0.7, 0), 3.0, 0.25, {"hinge": (0.2, 0)})
    turning = fb.static(scene, spin=10.0, load_steps=2)
    (frequency,) = fb.modes(scene, turning).angular_frequencies
    assert frequency == pytest.approx(10 * np.sqrt(0.2 * 3.0 * 0.5 / (0.25 + 3.0 * 0.5**2)))


def test_a_constant_tension_holds_a_pointer_in_its_line():
    scene, pointer, _ = hinged_body((0.5, 0), 2.0, 0.1, {"hinge": (0, 0), "tip": (1, 0)})
    scene.add_force_between(pointer["tip"], (3, 0), force=10.0)
    (frequency,) = fb.modes(scene, fb.static(scene)).angular_frequencies
    assert frequency == pytest.approx(np.sqrt(10.0 * 1 * 3 / 2 / (0.1 + 2 * 0.5**2)))


@pytest.mark.parametrize("gap", [0.01, 0.05, 0.2])
def test_a_wheel_settles_on_a_beam_from_every_height(gap):
    """The first step of its fall is longer than the wheel is thick."""

    def place_of_wheel(gap):
        section = fb.Section(EA=1e5, GA=4e4, EI=20.0, rhoA=1.0, rhoI=1e-3)
        scene, beam = scenes.supported_bar((1, 0), section, elements=10, gravity=(0, -9.81))
        wheel = scene.add_body((0.5, 0.1 + gap), mass=2.0, inertia=0.01).centre
        scene.fix(wheel, "x", "rotation")
        scene.add_contact(beam, fb.Circle(wheel, 0.1), stiffness=1e5)
        return fb.static(scene).position(wheel)[-1, 1]

    assert place_of_wheel(gap) == pytest.approx(place_of_wheel(0.0), abs=1e-9)


# -- Springs without stiffness at rest -------------------------------------------------------------

PLAY = fb.Spring(strain_energy=lambda x: 50 * ufl.max_value(abs(x) - 0.1, 0) ** 2)
QUARTIC = fb.Spring(strain_energy=lambda x: 50 * x**4)


@pytest.mark.parametrize("how", [None, "arc-length"])
@pytest.mark.parametrize(
    ("spring", "moment"), [(PLAY, lambda a: 100 * (a + 0.1)), (QUARTIC, lambda a: 200 * a**3)]
)
def test_an_arm_on_a_spring_without_stiffness_at_rest_finds_its_balance(spring, moment, how):
    options = {"spring": spring, "gravity": (0, -G)}
    scene, arm, hinge = hinged_body((0.5, 0), 2.0, 0.1, {"pin": (0, 0)}, **options)
    path = fb.static(scene, load_steps=4, continuation=how)
    exact = scipy.optimize.brentq(lambda a: moment(a) + 2.0 * G * 0.5 * np.cos(a), -1.0, 0.0)
    assert path.joint(hinge).angle[-1] == pytest.approx(exact, rel=1e-6)
    assert path.stable.all()


@pytest.mark.parametrize("load_steps", [1, 5])
def test_a_weight_falls_into_two_slack_ropes(load_steps):
    """Of the length r each, 2 k (r - l) sin(angle) = m g."""
    k, length = 2e4, 1.2
    scene, weight = one_body((0.0, -0.3), 5.0, 0.1, gravity=(0, -G))
    scene.fix(weight.centre, "rotation")
    rope = fb.Spring(strain_energy=lambda r: k / 2 * ufl.max_value(r - length, 0) ** 2)
    for x in (-1.0, 1.0):
        scene.add_force_between(weight.centre, (x, 0.0), spring=rope)
    path = fb.static(scene, load_steps)

    def left(y):
        r = np.hypot(1.0, y)
        return 2 * k * (r - length) * y / r - 5.0 * G

    exact = scipy.optimize.brentq(left, np.sqrt(length**2 - 1), 1.0)
    assert path.position(weight.centre)[-1] == pytest.approx([0.0, -exact], abs=1e-8)


def test_what_nothing_holds_is_named_beside_a_spring_with_play():
    scene, arm, _ = hinged_body((0.5, 0), 2.0, 0.1, {"pin": (0, 0)}, spring=PLAY)
    assert_refused("without loads y of node .* is free.* no load", fb.static, scene)
