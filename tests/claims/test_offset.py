"""Beams with their axis beside their points, against closed forms."""

import math

import numpy as np
import pytest
from derivatives import assert_derivatives
from scenes import assert_refused, clamped_bar, one_bar, pinned_bar

import fx_beam as fb

DECK = fb.Section(EA=1e6, GA=1e9, EI=1e3, rhoA=2.0, rhoI=0.1)
RIB = fb.Section(EA=5e5, GA=1e9, EI=2e3, rhoA=1.0, rhoI=0.1)


def t_beam(elements):
    scene, deck = clamped_bar((4, 0), DECK, elements, 1, name="deck")
    rib = scene.add_beam(deck.nodes, RIB, elements, 1, name="rib", offset=-0.3)
    return scene, deck, rib


def test_a_deck_and_its_rib_are_a_composite_section():
    """Parallel axes: EI = sum (EI_i + EA_i z_i^2) about the common centroid."""
    centroid = -0.3 * 5e5 / 1.5e6
    stiffness = 1e3 + 2e3 + 1e6 * centroid**2 + 5e5 * (0.3 + centroid) ** 2
    errors = []
    for elements in (8, 16):
        scene, deck, rib = t_beam(elements)
        scene.add_force(deck.end, (0, -1.0))
        bent = fb.static(scene, linear=True)
        errors.append(1 + bent.displacement(deck.end)[-1, 1] * 3 * stiffness / 4**3)
        N = [bent.resultants(beam).N[-1] for beam in (deck, rib)]
        assert N[0] == pytest.approx(-N[1], abs=1e-9)  # no axial force on both
        # In the middle of an element N is that of the moment there: M EA z / EI.
        M = -(4 - (np.arange(elements) + 0.5) * 4 / elements)
        assert N[1] == pytest.approx(M * 5e5 * (0.3 + centroid) / stiffness, rel=1e-6)
    assert errors[0] == pytest.approx(4 * errors[1], rel=0.02)  # order 2
    assert abs(errors[1]) < 0.0015


def test_a_force_on_the_line_bends_the_axis_beside_it():
    """A moment F e: rotation F e L / EI and deflection F e L^2 / (2 EI)."""
    scene, beam = clamped_bar((0, 2), RIB, elements=4, degree=2, offset=0.1, load=(0, 1.0))
    bent = fb.static(scene, linear=True)
    moment = -0.1  # the axis is to the left of the force, which goes up
    assert bent.rotation(beam.end)[-1] == pytest.approx(-moment * 2 / 2e3, rel=1e-9)
    assert bent.displacement(beam.end)[-1, 0] == pytest.approx(moment * 4 / 2 / 2e3, rel=1e-9)


@pytest.mark.parametrize("offset", [0.2, -0.5])
def test_it_swings_with_the_inertia_of_its_axis(offset):
    """A rigid pendulum on a pin of its line: omega^2 = m g d / J, J about the pin."""
    length, mass = 1.5, 1.5 * 2.0
    d = math.hypot(length / 2, offset)
    # Hung so that the centre of mass is below the pin.
    lean = math.atan2(offset, length / 2)
    end = length * math.cos(-math.pi / 2 - lean), length * math.sin(-math.pi / 2 - lean)
    stiff = fb.Section(EA=1e9, GA=1e9, EI=1e9, rhoA=2.0, rhoI=0.1)
    scene, beam = pinned_bar(end, stiff, elements=3, offset=offset, gravity=(0, -10.0))
    J = mass * (length**2 / 3 + offset**2) + 0.1 * length
    frequency = fb.modes(scene, state=fb.static(scene)).angular_frequencies[0]
    assert frequency**2 == pytest.approx(mass * 10 * d / J, rel=1e-6)
    scene.set_velocity(beam, lambda x, y: (-3 * y, 3 * x), spin=3.0)
    motion = fb.simulate(scene, dt=0.01, t_end=0.01)
    assert motion.energy.kinetic[0] == pytest.approx(J * 9 / 2, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_axis_of_an_arc_is_a_concentric_arc(degree):
    """In the limit of many elements, of order 2 at least."""
    line = fb.arc((2, 0), (math.sqrt(2), math.sqrt(2)), (0, 2))  # anticlockwise: inside is left
    errors = []
    for elements in (10, 20):
        beam = fb.Scene().add_beam(line, DECK, elements, degree, offset=0.5)
        radii = np.hypot(*np.array([(node.x, node.y) for node in beam.nodes]).T)
        errors.append([abs(radii - 1.5).max(), abs(beam.length - 1.5 * math.pi / 2)])
    assert (np.array(errors[1]) < 0.3 * np.array(errors[0]) + 1e-14).all()
    assert max(errors[1]) < 2e-3
    assert math.hypot(beam.node(0.5).x, beam.node(0.5).y) == pytest.approx(2.0)
    assert beam.start.x == pytest.approx(2.0)


def test_the_axis_of_a_polyline_is_mitred():
    scene, beam = one_bar([(0, 0), (2, 0), (2, 2)], DECK, elements=[2, 1], offset=0.1)
    places = [(node.x, node.y) for node in beam.nodes]
    assert places == [(0, 0.1), (1, 0.1), pytest.approx((1.9, 0.1)), pytest.approx((1.9, 2.0))]
    assert beam.s == pytest.approx([0, 1, 1.9, 3.8])
    assert (beam.node(0.5).x, beam.node(0.5).y) == (2, 0)


def test_a_file_and_a_copy_know_the_nodes_of_the_line(tmp_path):
    scene, deck, rib = t_beam(4)
    scene.add_force(rib.end, (0, -1.0))
    solution = fb.static(scene)
    solution.save(tmp_path / "rib.npz")
    loaded = fb.load(tmp_path / "rib.npz").beams["rib"]
    assert (loaded.end.number, loaded.nodes[-1].number) == (deck.end.number, rib.nodes[-1].number)
    assert loaded.end.number != loaded.nodes[-1].number


def test_a_removed_rib_leaves_the_deck_alone():
    scene, deck, rib = t_beam(4)
    scene.add_force(deck.end, (0, -1.0))
    scene.remove(rib)
    bare = fb.static(scene, linear=True)
    alone, beam = clamped_bar((4, 0), DECK, elements=4, load=(0, -1.0))
    expected = fb.static(alone, linear=True).displacement(beam.end)[-1]
    assert bare.displacement(deck.end)[-1] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("points", "offset", "message"),
    [
        ([(0, 0), (1, 0)], "left", "offset"),
        ([(0, 0), (1, 0), (0, 0.1)], 0.01, r"corner at \(1, 0\) is too sharp"),
        (fb.arc((1, 0), (0, 1), (-1, 0)), 1.2, "the axis goes back at .* other side"),
    ],
)
def test_what_cannot_be_is_refused(points, offset, message):
    scene = fb.Scene()
    assert_refused(message, scene.add_beam, points, DECK, elements=8, offset=offset)
    assert not (scene.nodes or scene.joints or scene.beams)


LOADS = {"a part": {"between": (0.2, 0.7)}, "pressure": {"follower": True}, "all": {}}


@pytest.mark.parametrize("load", LOADS)
def test_loaded_beams_with_an_offset_have_derivatives(load):
    """Where their lengths, and so the fractions of their nodes, depend on numbers."""

    def build(x):
        section = fb.Section(EA=1e4 * x[0], GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
        points = [(0, 0), (x[2] / 2, 0.1), (x[2], 0.3 * x[1])]
        scene, beam = one_bar(points, section, elements=4, offset=0.1 * x[1], gravity=(0, -9.81))
        scene.clamp(beam.start)
        value = 3.0 * x[1] if load == "pressure" else (1.0, -3.0 * x[1])
        scene.add_line_load(beam, value, **LOADS[load])
        return scene, {"end": fb.Output("position", beam.end), "M": fb.Output("M", beam)}

    assert_derivatives(fb.Response(build, dt=0.01, t_end=0.1), np.ones(3))
    assert_derivatives(fb.StaticResponse(build, 3), np.ones(3))
