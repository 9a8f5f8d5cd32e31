"""Branches of paths: pitchforks, loops, trees, imperfections and snaps."""

import numpy as np
import pytest
import scipy.optimize
import scipy.special
from scenes import assert_refused, one_bar, pinned_bar, supported_bar

import fx_beam as fb
from fx_beam import plot

EI = 1.0
SLENDER = fb.Section(EA=1e7, GA=1e7, EI=EI, rhoA=1.0, rhoI=1e-6)


def column(load):
    """A slender pinned column of length 1, and its middle."""
    scene, beam = supported_bar((0, 1), SLENDER, 8, 3, held="x", load=(0, -load))
    return scene, beam.node(0.5), beam.end


def elastica(load):
    """Deflection of the middle and way of the load of a pinned column of length 1."""
    half = np.sqrt(load / EI) / 2
    m = scipy.optimize.brentq(lambda m: scipy.special.ellipk(m) - half, 0, 0.99)
    return np.sqrt(m) / half, 2 * (1 - scipy.special.ellipe(m) / half)


@pytest.fixture(scope="module")
def bent():
    """Both branches of a column, up to twice its buckling load."""
    scene, middle, top = column(20.0)
    (point,) = fb.static(scene, load_steps=4).critical_points
    how = {"load_steps": 10, "continuation": "arc-length"}
    ways = [fb.static(scene, start=point.branch(sign), **how) for sign in (1, -1)]
    return point, ways, middle, top


def test_post_buckling_follows_the_elastica(bent):
    _, ways, middle, top = bent
    for way in ways:
        for row in (3, len(way.t) // 2, -1):
            across, down = elastica(20 * way.load_factor[row])
            assert abs(way.displacement(middle)[row, 0]) == pytest.approx(across, rel=2e-4)
            assert -way.displacement(top)[row, 1] == pytest.approx(down, rel=4e-4)


def test_both_directions_of_a_pitchfork_are_mirror_images_and_stable(bent):
    point, (right, left), middle, _ = bent
    assert right.load_factor == pytest.approx(left.load_factor, rel=1e-9)
    moved = right.displacement(middle)[:, 0], left.displacement(middle)[:, 0]
    assert moved[0][1:] == pytest.approx(-moved[1][1:], rel=1e-6)
    assert abs(moved[0][-1]) > 0.3
    assert right.stable.all() and left.stable.all()
    assert right.load_factor[0] == point.load_factor


def test_near_the_bifurcation_the_load_rises_with_the_square_of_the_deflection(bent):
    point, (right, _), middle, _ = bent
    rises = right.load_factor[1] / point.load_factor - 1
    assert rises == pytest.approx(np.pi**2 / 8 * right.displacement(middle)[1, 0] ** 2, rel=0.01)


def shallow_arch(rise, load, radius=1e-3):
    """A pinned arch H sin(pi x), H = 2 r e, under q sin(pi x), in units of EI pi^4 2 r."""
    section = fb.Section(EA=1 / radius**2, GA=1 / radius**2, EI=1.0)
    scene = fb.Scene()
    height = 2 * radius * rise
    beam = scene.add_beam(lambda f: (f, height * np.sin(np.pi * f)), section, 8, degree=3)
    scene.pin(beam.start)
    scene.pin(beam.end)
    unit = load * np.pi**4 * 2 * radius
    total = beam.length
    scene.add_line_load(beam, lambda s: (0.0, -unit * np.sin(np.pi * s / total)), of="arc length")
    return scene, beam


@pytest.mark.parametrize("rise", [2.2, 3.0])
def test_shallow_arches_snap_and_sway_at_their_loads(rise):
    """Fung and Kaplan (1952); on the way down the same loads, mirrored: 2 e - q.

    Their theory is the limit of small heights: the difference falls with their square. Sway comes
    first for e > sqrt(5.5).
    """
    limit = rise + np.sqrt(4 * (rise**2 - 1) ** 3 / 27)
    sway = rise + 3 * np.sqrt(rise**2 - 4)
    exact = np.array([sway, limit, 2 * rise - limit, 2 * rise - sway])
    computed = []
    for radius in (2e-3, 1e-3):
        scene, _ = shallow_arch(rise, 1.2 * limit, radius=radius)
        path = fb.static(scene, load_steps=6, continuation="arc-length", max_steps=100)
        points = path.critical_points
        assert (points[0].kind == "bifurcation") == (rise > np.sqrt(5.5))
        bifurcations, limits = (
            sorted((1.2 * limit * p.load_factor for p in points if p.kind == kind), reverse=True)
            for kind in ("bifurcation", "limit point")
        )
        computed.append([bifurcations[0], *limits, bifurcations[1]])
    errors = np.array(computed) - exact
    assert abs(errors[1]).max() < 1e-3 * limit
    assert abs(errors[0] - 4 * errors[1]).max() < 0.02 * abs(errors[0]).max()


def low_arch():
    """Two members, joined rigidly."""
    scene, left = pinned_bar((1, 0.2), fb.Section(EA=1e4, GA=4e3, EI=EI, rhoA=1), 3, 2)
    right = scene.add_beam([left.end, (2, 0)], left.section, 3, 2)
    scene.pin(right.end)
    scene.add_force(left.end, (0, -60.0))
    return scene, left.end


@pytest.fixture(scope="module")
def tree():
    scene, top = low_arch()
    how = {"load_steps": 8, "continuation": "arc-length", "max_steps": 60}
    return fb.static(scene, branches=2, **how), top


def test_a_sway_branch_leads_from_one_bifurcation_to_the_other_and_returns(tree):
    path, top = tree
    points = [point for point in path.critical_points if point.kind == "bifurcation"]
    assert len(points) == 2 and len(path.branches) == 4
    assert path.stats.failure is None
    for branch in path.branches:
        assert branch.stats.failure is None and branch.stats.steps < 60
        assert not branch.stable.any()
        sideways = branch.displacement(top)[:, 0]
        assert sideways.max() > 0.01 and sideways.min() < -0.01  # through the other one
        factors = branch.load_factor
        ends = sorted(point.load_factor for point in points)
        assert factors.min() == pytest.approx(ends[0], abs=1e-6)
        assert factors.max() == pytest.approx(ends[1], abs=1e-6)
        assert branch.stats.closed  # it ends at the point itself
        assert factors[-1] == factors[0] and (branch.q[-1] == branch.q[0]).all()
    for one, other in (path.branches[:2], path.branches[2:]):
        mirrored = -other.displacement(top)[:, 0]
        assert one.displacement(top)[:, 0] == pytest.approx(mirrored, abs=1e-7)
    assert all(not branch.branches for branch in path.branches)  # they meet nothing new
    assert [b.origin.direction for b in path.branches] == [1, -1, 1, -1]


def test_an_imperfect_path_nears_the_branch():
    scene, middle, _ = column(20.0)
    (point,) = fb.static(scene, load_steps=4).critical_points
    crooked = fb.imperfect(scene, point.modes, 1e-3)
    path = fb.static(crooked, load_steps=20)
    across, _ = elastica(20.0)
    assert abs(path.displacement(crooked.beams[0].node(0.5))[-1, 0]) == pytest.approx(across, 0.01)
    assert path.stable.all() and scene.beams[0].node(0.5).x == 0


SOFT = fb.Section(EA=1e4, GA=1e4, EI=1.0)


def with_a_body():
    """A column of two halves with a rigid block between them, whose centre is beside its axis."""
    scene = fb.Scene()
    lower = scene.add_beam([(0, 0), (0, 0.4)], SOFT, elements=6)
    points = {"foot": lower.end, "top": (0, 0.6), "side": (0.2, 0.5)}
    block = scene.add_body((0.1, 0.5), 1.0, 0.1, points=points)
    return scene, lower, scene.add_beam([block["top"], (0, 1.3)], SOFT, elements=9)


def with_a_hinged_body():
    scene = fb.Scene()
    lower = scene.add_beam([(0, 0), (0, 0.4)], SOFT, elements=6)
    points = {"foot": (0, 0.4), "top": (0, 0.6)}
    block = scene.add_body((0.1, 0.5), 1.0, 0.1, points=points)
    scene.add_joint(fb.Revolute(lower.end, block["foot"], spring=fb.Spring(50.0)))
    return scene, lower, scene.add_beam([block["top"], (0, 1.3)], SOFT, elements=9)


def with_ribs():
    scene = fb.Scene()
    lower = scene.add_beam([(0, 0), (0, 0.4)], SOFT, elements=6)
    for side in (-0.03, 0.03):
        scene.add_beam([*lower.nodes], fb.Section(50.0, 50.0, 0.1), elements=6, offset=side)
    return scene, lower, scene.add_beam([lower.end, (0, 1)], SOFT, elements=9)


@pytest.mark.parametrize("build", [with_a_body, with_a_hinged_body, with_ribs])
def test_imperfect_columns_with_rigid_parts_deflect_as_southwell_says(build):
    """w0 grows to w0 / (1 - P / Pcr); what is rigid keeps its lengths, and nothing is stressed."""
    scene, lower, upper = build()
    scene.pin(lower.start)
    scene.fix(upper.end, "x")
    scene.add_force(upper.end, (0, -2.0))
    perfect = fb.buckling(scene, n=1)
    (critical,), size = perfect.load_factors, 1e-3
    crooked = fb.imperfect(scene, perfect.modes, size)
    for joint, old in zip(crooked.joints, scene.joints, strict=True):
        assert np.hypot(*joint.offset) == pytest.approx(np.hypot(*old.offset), rel=1e-14)
    bent = fb.static(crooked, load_steps=2)
    assert not bent.q[0].any() and abs(bent.reaction(crooked.beams[0].start)[0]).max() < 1e-12
    start = crooked.nodes[lower.end.number].x
    assert abs(start) > 0.5 * size
    moved = bent.displacement(crooked.nodes[lower.end.number])[-1, 0]
    assert moved == pytest.approx(start / (critical - 1), rel=0.01)
    if scene.bodies:  # it turns with the mode, as rigid bodies do
        body, moved = crooked.bodies[0], perfect.modes.shapes[0]
        largest = np.hypot(*moved[:, :2].T).max()
        angle = size / largest * moved[body.centre.number, 2]
        arm = np.array([body["top"].x - body.centre.x, body["top"].y - body.centre.y])
        assert abs(angle) > 1e-4
        assert arm == pytest.approx([-0.1 - 0.1 * angle, 0.1 - 0.1 * angle], abs=angle**2)


def test_imperfect_scenes_have_no_guides():
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (0, 1)], SOFT, elements=4)
    scene.clamp(bar.start)
    scene.add_joint(fb.Prismatic(fb.GROUND, bar.end, axis=(0, 1)))
    scene.add_force(bar.end, (0, -1.0))
    assert_refused("guide or sleeve", fb.imperfect, scene, fb.buckling(scene, n=1).modes, 1e-3)


def test_a_motion_snaps_from_a_limit_point():
    """Under a little more than the limit load the arch falls through; under less it stays."""
    scene, top = low_arch()
    path = fb.static(scene, load_steps=8, continuation="arc-length")
    limit = next(point for point in path.critical_points if point.kind == "limit point")
    lowest = []
    for factor in (1.1, 0.9):
        scene.change(scene.loads[0], (0.0, -60.0 * factor * limit.load_factor))
        motion = fb.simulate(scene, dt=0.02, t_end=3.0, start=limit.solution)
        lowest.append(motion.displacement(top)[:, 1].min())
        assert abs(motion.energy.balance_error).max() < 1e-9
    assert lowest[0] < -0.3


def test_branches_are_refused_where_there_is_none(tree):
    path, _ = tree
    scene, _ = low_arch()
    points = {point.kind: point for point in path.critical_points}
    assert_refused("no path branches off at a limit point", lambda: points["limit point"].branch())
    assert_refused("a number of the 1 modes", lambda: points["bifurcation"].branch(mode=1))
    branch = points["bifurcation"].branch()
    assert_refused("Follow it by continuation", fb.static, scene, start=branch)
    scene.change(scene.loads[0], (0.0, -70.0))
    with pytest.raises(fb.SceneError, match="no equilibrium of this scene"):
        fb.static(scene, start=branch, continuation="arc-length")


def test_the_diagram_shows_stable_and_unstable_lines_and_points(tree, tmp_path):
    path, top = tree
    figure = plot.equilibrium_paths(
        path, lambda s: -s.displacement(top)[:, 1], tmp_path / "paths.png", "deflection [m]"
    )
    drawn = {line.get_label(): line for line in figure.axes[0].lines}
    assert {"stable", "unstable", "limit point", "bifurcation"} <= set(drawn)
    limits = [p.load_factor for p in path.critical_points if p.kind == "limit point"]
    assert drawn["limit point"].get_ydata().tolist() == limits
    assert (tmp_path / "paths.png").stat().st_size > 0


@pytest.fixture(scope="module")
def asymmetric():
    """A rigid column on a hinge with the moment c psi + b psi^2 / 2: P sin(psi) is equal to it."""
    c, b = 10.0, 6.0
    stiff = fb.Section(EA=1e6, GA=1e6, EI=1e6)
    scene, bar = one_bar((0, 1), stiff, elements=1)
    spring = fb.Spring(stiffness=c, strain_energy=lambda x: b * x**3 / 6)
    scene.add_joint(fb.Revolute(fb.GROUND, bar.start, spring=spring))
    scene.add_force(bar.end, (0, -15.0))
    return scene, bar, lambda psi: (c * psi + b * psi**2 / 2) / np.sin(psi)


def test_an_asymmetric_bifurcation_is_found_and_followed_to_both_sides(asymmetric):
    scene, bar, load = asymmetric
    computed = [fb.static(scene, steps).critical_points for steps in (3, 7)]
    assert [points[0].kind for points in computed] == ["bifurcation"] * 2
    factors = [points[0].load_factor for points in computed]
    assert 15 * np.array(factors) == pytest.approx(10.0, rel=3e-5)
    assert factors[0] == pytest.approx(factors[1], rel=1e-8)
    rises, stable = [], []
    for sign in (1, -1):
        how = {"load_steps": 10, "continuation": "arc-length", "max_steps": 12}
        branch = fb.static(scene, start=computed[0][0].branch(sign), **how)
        psi = branch.rotation(bar.end)[1:]
        assert 15 * branch.load_factor[1:] == pytest.approx(load(psi), rel=3e-5)
        rises.append(branch.load_factor[1] > branch.load_factor[0])
        stable.append(bool(branch.stable[1]))
    assert sorted(rises) == [False, True] and rises == stable


def hinged_columns(stiffness, load):
    """Rigid columns on hinges with springs c, all under one load: P sin(psi) = c psi."""
    stiff = fb.Section(EA=1e6, GA=1e6, EI=1e6)
    scene, tops = fb.Scene(), []
    for x, c in enumerate(stiffness):
        bar = scene.add_beam([(x, 0), (x, 1)], stiff, elements=1)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, spring=fb.Spring(stiffness=c)))
        scene.add_force(bar.end, (0, -load))
        tops.append(bar.end)
    return scene, tops


def test_a_tree_has_the_branches_of_its_branches():
    """The second column buckles on the straight path, and on both branches of the first one."""
    scene, tops = hinged_columns((10.0, 12.0), 15.0)
    path = fb.static(scene, load_steps=5, branches=2)
    assert path.unstable_modes[-1] == 2
    factors = [point.load_factor for point in path.critical_points]
    assert 15 * np.array(factors) == pytest.approx([10.0, 12.0], rel=3e-5)
    assert len(path.branches) == 4
    first, second = path.branches[:2], path.branches[2:]
    for branch in first:
        (point,) = branch.critical_points
        assert point.load_factor == pytest.approx(factors[1], rel=1e-7)
        assert branch.stable[1] and not branch.stable[-1]
        assert len(branch.branches) == 2
        for last in branch.branches:
            turned = np.array([last.rotation(top)[-1] for top in tops])
            assert 15 * np.sin(abs(turned)) == pytest.approx(
                np.array([10.0, 12.0]) * abs(turned), rel=3e-5
            )
            assert last.stable.all() and not last.branches
    for branch in second:
        assert (branch.unstable_modes == 1).all() and not branch.branches


def test_a_point_with_two_modes_has_branches_along_both():
    scene, tops = hinged_columns((10.0, 10.0), 15.0)
    (point,) = fb.static(scene, load_steps=5).critical_points
    assert len(point.modes) == 2
    how = {"load_steps": 10, "continuation": "arc-length"}
    for mode in (0, 1):
        branch = fb.static(scene, start=point.branch(+1, mode), **how)
        turned = np.array([branch.rotation(top)[-1] for top in tops])
        assert abs(turned).max() > 1
        assert 15 * np.sin(turned) == pytest.approx(10 * turned, rel=3e-5, abs=1e-6)


def test_points_of_a_path_that_starts_from_a_loaded_state():
    """The first load fades while the second one rises; such a path has no branches yet."""
    scene, _ = hinged_columns((10.0,), 0.0)
    scene.change(scene.loads[0], (0.0, 5.0))
    pulled = fb.static(scene, load_steps=2)
    scene.change(scene.loads[0], (0.0, -15.0))
    path = fb.static(scene, load_steps=4, start=pulled)
    (point,) = path.critical_points
    assert 15 * point.load_factor - 5 * (1 - point.load_factor) == pytest.approx(10, rel=3e-5)
    with pytest.raises(fb.SceneError, match="without a start of its own"):
        fb.static(scene, start=point.branch(), continuation="arc-length")
    assert_refused("without start and spin", fb.static, scene, start=pulled, branches=1)
