"""Curved members: where their nodes lie, and that they move as straight ones do."""

import math

import numpy as np
import pytest
from numpy.polynomial import Legendre
from scenes import FLYING, clamped_bar, one_bar
from scipy.integrate import quad, simpson

import fx_beam as fb

DEGREES = pytest.mark.parametrize("degree", [1, 2, 3])
QUARTER = (0.0, 0.0), (math.sqrt(0.5), 1 - math.sqrt(0.5)), (1.0, 1.0)  # about (0, 1)


def quarter(degree=1, elements=4, section=FLYING, **scene):
    """A quarter of a circle of radius 1."""
    scene = fb.Scene(**scene)
    return scene, scene.add_beam(fb.arc(*QUARTER), section, elements=elements, degree=degree)


def all_places(beam):
    """Places of a beam's nodes in order, those inside elements included."""
    ends = np.array([(node.x, node.y) for node in beam.nodes])
    return np.vstack([np.hstack([ends[:-1, None], beam.inner]).reshape(-1, 2), ends[-1:]])


# -- Places ------------------------------------------------------------------------------------


def at_lobatto_points(beam):
    """Places (elements, degree + 1, 2) of the elements' polynomials at their Lobatto points."""
    p, nodes = beam.degree, all_places(beam)
    places = np.array([-1, *np.sort(Legendre.basis(p).deriv().roots().real), 1])
    through = np.vander(places, p + 1) @ np.linalg.inv(np.vander(np.linspace(-1, 1, p + 1)))
    return np.array([through @ nodes[k * p : k * p + p + 1] for k in range(beam.elements)]), places


@DEGREES
@pytest.mark.parametrize("sweep", [0.02, 6.2])
@pytest.mark.parametrize("side", [1, -1])
def test_elements_of_an_arc_divide_its_circle_and_meet_it_at_their_lobatto_points(
    degree, sweep, side
):
    def point(angle):
        return 3 - 2 * math.cos(side * angle), 5 - 2 * math.sin(side * angle)

    curve = fb.arc(point(0), point(0.3 * sweep), point(sweep))
    scene, arc = one_bar(curve, FLYING, elements=5, degree=degree)
    computed, places = at_lobatto_points(arc)
    exact = [[point(sweep * (k + (1 + x) / 2) / 5) for x in places] for k in range(5)]
    assert abs(computed - exact).max() < 1e-12
    ends = [(node.x, node.y) for node in arc.nodes]
    assert abs(ends - np.array([point(sweep * k / 5) for k in range(6)])).max() < 1e-12
    assert arc.s == pytest.approx(2 * sweep * np.arange(6) / 5, rel=1e-12)
    assert arc.length == pytest.approx(2 * sweep, rel=1e-12)
    assert arc.node(0.4) is arc.nodes[2]


@pytest.mark.parametrize("rise", [1e-3, 1e-6, 3e-9])
def test_an_arc_goes_through_its_points_however_flat_it_is(rise):
    scene, post = one_bar([(5, -1), (5, 0)], FLYING, elements=1)
    arc = scene.add_beam(fb.arc((0, 0), (2.5, 5 * rise), post.end), FLYING, elements=4)
    middle = arc.node(0.5)
    assert (middle.x, middle.y) == pytest.approx((2.5, 5 * rise), rel=1e-14)
    assert arc.length == pytest.approx(5 * (1 + 8 / 3 * rise**2), rel=1e-10)


def test_straight_elements_along_a_function_have_their_nodes_at_equal_distances():
    beam = fb.Scene().add_beam(lambda f: (3 * f, 4 * f), FLYING, elements=2, degree=3)
    assert all_places(beam)[:, 1] == pytest.approx(4 * np.arange(7) / 6, abs=1e-14)


def test_nodes_of_a_function_lie_at_equal_arc_lengths_whatever_its_speed():
    def length_to(x):  # of the parabola y = x^2/2
        return (x * np.sqrt(1 + x**2) + np.arcsinh(x)) / 2

    scene = fb.Scene()
    for function in (
        lambda f: (2 * f, 2 * f**2),
        lambda f: (2 * f**3, 2 * f**6),
        lambda f: (2 * math.sin(math.pi / 2 * f), 2 * math.sin(math.pi / 2 * f) ** 2),
    ):
        beam = scene.add_beam(function, FLYING, elements=7)
        x = np.array([node.x for node in beam.nodes])
        assert length_to(x) == pytest.approx(length_to(2.0) * np.arange(8) / 7, abs=1e-11)
        assert beam.s == pytest.approx(length_to(x), abs=1e-11)


@pytest.mark.parametrize(
    ("function", "length"),
    [
        (lambda f: (f, abs(f - 1 / 3)), math.sqrt(2)),
        (lambda f: (f, abs(f - 0.7)), math.sqrt(2)),
        (lambda f: (f, max(0.0, 10 * f - 9.1)), 0.91 + 0.09 * math.sqrt(101)),
        (lambda f: (f, np.interp(f, [0, 0.1, 0.55, 1], [0, 1, 0, 0])), None),
        (lambda f: (f, math.sqrt(1 - f * f)), math.pi / 2),  # at infinite speed in the end
        (lambda f: (math.sqrt(f), 2.0), 1.0),
        (lambda f: (f**20, f**40), math.sqrt(5) / 2 + math.asinh(2) / 4),
        (lambda f: (1e6 + math.cos(f), 1e6 + math.sin(f)), 1.0),
    ],
)
def test_a_function_with_corners_or_of_uneven_speed_is_measured_all_the_same(function, length):
    if length is None:
        length = math.hypot(0.1, 1) + math.hypot(0.45, 1) + 0.45
    beam = fb.Scene().add_beam(function, FLYING, elements=20, degree=2)
    assert beam.length == pytest.approx(length, rel=1e-9)


def test_breaks_help_to_measure_and_change_nothing():
    def function(f):
        nonlocal calls
        calls += 1
        return f, abs(f - 1 / 3)

    lengths = []
    for breaks in ((), (1 / 3,), [0.0, 1 / 3, 1.0]):
        calls = 0
        beam = fb.Scene().add_beam(fb.Curve(function, breaks=breaks), FLYING, elements=6)
        lengths.append((calls, beam.length))
    assert lengths[0][1] == pytest.approx(lengths[1][1], rel=1e-11)
    assert lengths[1] == lengths[2] and lengths[1][0] < 0.1 * lengths[0][0]


def splined(count):
    """A spline through points of a half circle of radius 1, and its beam."""
    angles = np.linspace(0, np.pi, count)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    spline = fb.spline(points)
    for point, fraction in zip(points, spline.breaks, strict=True):
        assert spline.function(fraction) == pytest.approx(point, abs=1e-15)
    return fb.Scene().add_beam(spline, FLYING, elements=24, degree=2)


def test_a_spline_goes_through_its_points_and_follows_a_smooth_curve_with_order_4():
    beams = [splined(count) for count in (9, 17)]
    errors = [abs(np.hypot(*all_places(beam).T) - 1).max() for beam in beams]
    assert errors[0] / errors[1] > 2**3.9
    steps = np.hypot(*np.diff(all_places(beams[1]), axis=0).T)
    assert steps == pytest.approx(steps.mean(), rel=1e-4)
    assert beams[1].length == pytest.approx(np.pi, rel=1e-4)


@pytest.mark.parametrize("closing", [0.0, 1e-16])
def test_a_spline_that_ends_where_it_begins_up_to_rounding_has_no_kink(closing):
    function = fb.spline([(1, 0), (0, 2), (-1, 0), (0, -2), (1, closing)]).function
    assert function(0.0, 1) == pytest.approx(function(1.0, 1), abs=1e-12)


@pytest.mark.parametrize("kind", ["arc", "spline", "function"])
def test_a_curve_shares_the_nodes_it_is_given(kind):
    scene, post = one_bar([(0, -1), (0, 0)], FLYING, elements=2)
    strut = scene.add_beam([(1, -1), (1, 1)], FLYING, elements=2)
    arch = scene.add_beam(
        {
            "arc": fb.arc(post.end, QUARTER[1], strut.end),
            "spline": fb.spline([post.end, QUARTER[1], strut.end]),
            "function": fb.Curve(lambda f: (f, f**2), start=post.end, end=strut.end),
        }[kind],
        FLYING,
        elements=3,
    )
    assert arch.start is post.end and arch.end is strut.end
    assert len(scene.nodes) == 3 + 3 + 2


def test_a_curve_with_too_many_corners_is_refused(monkeypatch):
    monkeypatch.setattr("fx_beam.scene.curve._MOST_PIECES", 1000)  # ten times sooner
    with pytest.raises(fb.SceneError, match="too many corners"):
        fb.Scene().add_beam(lambda f: (f, f * math.sin(1 / f) if f else 0.0), FLYING, elements=1)


# -- Statics -----------------------------------------------------------------------------------


@pytest.mark.parametrize("GA", [1e4, 1e8])
def test_an_arc_is_bent_straight_by_its_own_curvature(GA):
    errors = []
    for elements in (4, 8, 16):
        scene, beam = quarter(2, elements, fb.Section(EA=2 * GA, GA=GA, EI=1.0))
        scene.clamp(beam.start)
        scene.add_moment(beam.end, -1.0)
        solution = fb.static(scene, load_steps=4)
        assert abs(solution.resultants(beam).N[-1]).max() < 1e-9 * GA
        errors.append(math.dist(solution.position(beam.end)[-1], (math.pi / 2, 0)))
    assert (np.log2(np.divide(errors[:-1], errors[1:])) > 2 * 2 - 0.1).all()


# Curves from (0, 0) to x = 1, and their derivatives.
CURVES = {
    "arc": (
        lambda f: (math.sin(math.pi / 2 * f), 1 - math.cos(math.pi / 2 * f)),
        lambda f: (
            math.pi / 2 * math.cos(math.pi / 2 * f),
            math.pi / 2 * math.sin(math.pi / 2 * f),
        ),
    ),
    "parabola": (lambda f: (f, f**2), lambda f: (1.0, 2 * f)),
}


def tip_per_force(degree, elements, thickness, curve="arc", force=1e-4):
    """Relative error of the tip of a curve under a small force across it."""
    section = fb.Section(EA=12 / thickness**2, GA=4 / thickness**2, EI=1.0)
    function, rate = CURVES[curve]

    def work(f):  # of the resultants M, N and Q of a unit force on themselves
        (x, _), (dx, dy) = function(f), rate(f)
        bent = (1 - x) ** 2 / section.EI * (dx**2 + dy**2)
        return (bent + dy**2 / section.EA + dx**2 / section.GA) / math.hypot(dx, dy)

    values = 0.0
    # Their sum is linear to fifth order.
    for factor, weight in ((1, 2 / 3), (-1, 2 / 3), (2, -1 / 6), (-2, -1 / 6)):
        scene, beam = clamped_bar(function, section, elements=elements, degree=degree)
        scene.add_force(beam.end, (0, factor * force))
        tip = fb.static(scene, load_steps=1).displacement(beam.end)[-1, 1]
        values += weight * tip / (factor * force)
    return values / quad(work, 0, 1, epsabs=1e-13)[0] - 1


@pytest.mark.parametrize(("degree", "curve"), [(1, "arc"), (2, "parabola"), (3, "arc")])
def test_a_curved_cantilever_bends_under_a_force_with_order_twice_the_degree(degree, curve):
    meshes = (4, 8) if degree == 3 else (4, 8, 16)  # with 16 it is off by rounding
    errors = np.abs([tip_per_force(degree, n, 1.0, curve, force=1e-3) for n in meshes])
    assert (np.log2(errors[:-1] / errors[1:]) > 2 * degree - 0.2).all()


@pytest.mark.parametrize(("degree", "elements"), [(1, 8), (2, 4), (3, 3)])
def test_a_curved_cantilever_does_not_lock(degree, elements):
    errors = [abs(tip_per_force(degree, elements, t)) for t in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)]
    assert max(errors) < {1: 5e-3, 2: 3e-4, 3: 2e-5}[degree]
    assert max(errors) < 2 * min(errors)


def test_a_line_load_on_a_curve_is_per_arc_length():
    scene, beam = quarter(2, 8)
    scene.clamp(beam.start)
    scene.add_line_load(beam, (0.5, -2.0))
    solution = fb.static(scene)
    force, moment = solution.reaction(beam.start)[-1, :2], solution.reaction(beam.start)[-1, 2]
    assert force == pytest.approx([-0.5 * math.pi / 2, 2.0 * math.pi / 2], rel=1e-5)
    # About the clamp, of the load where it has moved to.
    x, y = solution.shape(beam)[-1].T
    assert moment == pytest.approx(simpson(2.0 * x + 0.5 * y, dx=math.pi / 32), rel=1e-4)


def test_resultants_of_a_curve_stand_at_its_arc_length():
    scene, beam = quarter(2, 4, fb.Section(EA=1e6, GA=1e6, EI=1e3))
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, 1e-3))
    r = fb.static(scene, load_steps=1).resultants(beam)
    angle = r.s  # on a radius of 1
    assert r.M[-1] == pytest.approx(1e-3 * (1 - np.sin(angle)), abs=2e-5)
    assert r.N[-1] == pytest.approx(1e-3 * np.sin(angle), abs=2e-5)
    assert r.Q[-1] == pytest.approx(1e-3 * np.cos(angle), abs=2e-5)


def test_a_monotone_spline_stays_between_its_points():
    """A plain one swings out by a quarter of a metre, as points are at very different distances."""
    points = [(0, 0), (1, 0), (1.1, 1), (3, 1), (3.2, 0.2)]
    lows = []
    for monotone in (False, True):
        curve = fb.spline(points, monotone=monotone)
        beam = fb.Scene().add_beam(curve, fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=64)
        X = np.array([(node.x, node.y) for node in beam.nodes])
        assert abs(X[None] - np.array(points)[:, None]).max(axis=2).min(axis=1).max() < 0.05
        lows.append(X[:, 1].min())
    assert lows[0] < -0.2
    assert lows[1] == 0.0
    assert X.max(axis=0) == pytest.approx([3.2, 1.0])
