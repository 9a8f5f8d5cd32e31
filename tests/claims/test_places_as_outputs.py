"""Places inside elements as outputs: values, derivatives, linear systems and tables."""

import csv

import numpy as np
import pytest
from derivatives import assert_derivatives, assert_orbit_slopes
from scenes import assert_refused, clamped_bar, one_bar

import fx_beam as fb

KINDS = "position", "displacement", "rotation", "velocity", "spin"


def swing(x, degree=2):
    """A beam before, so that inner nodes have other numbers, and a curved one that swings."""
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0 * x[1], rhoA=1.0, rhoI=0.01)
    scene = fb.Scene(gravity=(0, -9.81))
    scene.clamp(scene.add_beam([(0, 1), (1, 1)], section, 2, degree).start)
    beam = scene.add_beam(fb.arc((0, 0), (0.5, 0.1 * x[0]), (1, 0)), section, 3, degree, name="bow")
    scene.clamp(beam.start)
    return scene, beam


def build(x, degree=2):
    scene, beam = swing(x, degree)
    place = beam.at(0.4 * float(beam.length))
    return scene, {kind: fb.Output(kind, place) for kind in KINDS}


def interpolated(values, s, length, degree):
    """Values at an arc length by polynomials through all nodes of the element of three."""
    element = int(3 * s / length)
    nodes = np.linspace(element / 3, (element + 1) / 3, degree + 1) * length
    rows = values[degree * element : degree * (element + 1) + 1]
    return np.array([np.polyval(np.polyfit(nodes, row, degree), s) for row in rows.T])


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_places_have_the_motion_of_the_interpolation(degree, tmp_path):
    scene, outputs = build(np.ones(2), degree)
    beam = scene.beams["bow"]
    solution = fb.simulate(scene, dt=0.01, t_end=0.2)
    nodes, s = solution.nodes_of_beam["bow"], 0.4 * beam.length
    q, v = (
        interpolated(rows[-1, nodes], s, beam.length, degree) for rows in (solution.q, solution.v)
    )
    X = interpolated(solution.X[nodes], s, beam.length, degree)
    expected = X + q[:2], q[:2], q[2], v[:2], v[2]

    motion = fb.Motion(scene, dt=0.01, outputs=outputs)
    for _ in range(20):
        last = motion.step()
    for kind, value in zip(KINDS, expected, strict=True):
        assert last[kind] == pytest.approx(value, rel=1e-9, abs=1e-12)

    solution.to_csv(tmp_path / "bow.csv", {"place": beam.at(s)})
    with open(tmp_path / "bow.csv", encoding="utf-8") as file:
        *_, row = csv.DictReader(file)
    assert float(row["place y"]) == pytest.approx(expected[0][1], rel=1e-9)
    assert float(row["place y rate"]) == pytest.approx(v[1], rel=1e-9)
    moment = solution.resultants(beam).at(s).M[-1, 0]
    assert float(row["place M"]) == pytest.approx(moment, rel=1e-9)


def stretched(x, degree=2):
    """Beams whose lengths depend on x, with places at arc lengths, and at fractions."""
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0 * x[1], rhoA=1.0, rhoI=0.01)
    scene, bar = one_bar([(0, 1), (x[0], 0.8)], section, 3, degree, gravity=(0, -9.81))
    bow = scene.add_beam(fb.arc((0, 0), (0.5, 0.1 * x[1]), (x[2], 0)), section, 3, degree)
    places = {"bar": bar.at(0.5), "part of bar": bar.at(0.4 * float(bar.length))}
    places |= {"bow": bow.at(0.35 * x[2]), "part of bow": bow.at(0.8 * float(bow.length))}
    for beam in (bar, bow):
        scene.clamp(beam.start)
        scene.add_line_load(beam, lambda t: (0.0, 3 * np.sin(5 * t)))
    return scene, {
        f"{kind} of {name}": fb.Output(kind, place)
        for kind in KINDS
        for name, place in places.items()
    }


@pytest.mark.parametrize("degree", [1, 3])
def test_places_have_derivatives_where_lengths_depend_on_numbers(degree):
    x = np.array([1.1, 0.9, 1.0])
    assert_derivatives(fb.Response(lambda x: stretched(x, degree), dt=0.01, t_end=0.1), x)
    assert_derivatives(fb.StaticResponse(lambda x: stretched(x, degree), 4, t=0.1), x)


def test_places_of_periodic_motions_have_derivatives_where_lengths_depend_on_numbers():
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01, retardation=5e-3)
        scene, beam = clamped_bar((x[0], 0), section, 2, 2)
        scene.add_force(beam.end, lambda t: (0.0, x[1] * np.cos(2 * np.pi * t)))
        place = beam.at(0.6)
        return scene, {kind: fb.Output(kind, place) for kind in KINDS}

    def motion(scene):
        return fb.periodic(scene, period=1.0, steps=41, tolerance=1e-12)

    run = fb.PeriodicResponse(build, motion)
    assert_orbit_slopes(run, [1.0, 0.7], 1e-6, multipliers=False)


def test_a_linear_system_sees_the_share_of_each_node():
    scene, beam = swing(np.ones(2), degree=1)
    start, end = beam.nodes[1:3]
    place = beam.at(0.75 * float(beam.s[1]) + 0.25 * float(beam.s[2]))
    outputs = {
        name: fb.Output("displacement", node, "y")
        for name, node in {"place": place, "start": start, "end": end}.items()
    }
    rows = dict(zip(outputs, fb.linearise(scene, outputs=outputs).C, strict=True))
    shared = 0.75 * rows["start"] + 0.25 * rows["end"]
    assert rows["place"] == pytest.approx(shared, abs=1e-12)


def test_what_a_place_does_not_have_is_refused():
    scene, beam = swing(np.ones(2))
    with pytest.raises(fb.SceneError, match="'reaction' must be one of .* for beam 'bow' at 0.5"):
        fb.Output("reaction", beam.at(0.5))
    other = fb.Output("position", swing(np.ones(2))[1].at(0.5))
    assert_refused("of a beam of this scene", fb.Motion, scene, dt=0.1, outputs={"y": other})
