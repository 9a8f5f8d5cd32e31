"""Critical points of paths: their loads, kinds and modes, against exact references."""

import pickle
from dataclasses import replace

import ufl

import numpy as np
import pytest
from scenes import assert_refused, hinged_body, pinned_bar, supported_bar

import fx_beam as fb

EI = 1.0
STOUT = fb.Section(EA=1e4, GA=4e3, EI=EI)


def column(load, elements, degree, k, section=STOUT):
    """A column of length 1 and its buckling load: pinned for k = pi, a cantilever for k = pi/2.

    In the compressed column, N = -P, an incline psi of the section has the shear strain
    psi P / (GA - P (1 - ...)): P (1 - P/EA + P/GA) = EI k^2, the smaller root.
    """
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (0, 1)], section, elements, degree)
    if k == np.pi:
        scene.pin(beam.start)
        scene.fix(beam.end, "x")
    else:
        scene.clamp(beam.start)
    scene.add_force(beam.end, (0, -load))
    c = 1 / section.GA - 1 / section.EA
    return scene, (np.sqrt(1 + 4 * c * EI * k**2) - 1) / (2 * c)


@pytest.mark.parametrize(
    ("degree", "order", "elements", "k"), [(1, 2, 8, np.pi), (2, 4, 4, np.pi / 2), (3, 6, 2, np.pi)]
)
def test_buckling_loads_converge_with_twice_the_degree(degree, order, elements, k):
    errors = []
    for n in (elements, 2 * elements):
        scene, exact = column(1.4 * k**2, n, degree, k)
        (point,) = fb.static(scene, load_steps=4).critical_points
        assert point.kind == "bifurcation"
        errors.append(1.4 * k**2 * point.load_factor / exact - 1)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)
    assert errors[1] < 0.01


def test_a_point_does_not_depend_on_the_steps_between_which_it_lies():
    scene, _ = column(14.0, 4, 2, np.pi)
    ways = [(3, None), (10, None), (5, "arc-length"), (17, "arc-length")]
    factors = [
        fb.static(scene, steps, continuation=how).critical_points[0].load_factor
        for steps, how in ways
    ]
    assert factors == pytest.approx(factors[:1] * 4, rel=1e-8)


def truss(height, load):
    """Two bars between hinges, each one element: by EA alone, since no moment bends them."""
    section = fb.Section(EA=1e3, GA=1e5, EI=1e4)
    scene, left = pinned_bar([(-1, 0), (0, height)], section, elements=1)
    right = scene.add_beam([(0, height), (1, 0)], section, elements=1)
    scene.add_joint(fb.Revolute(left.end, right.start))
    scene.pin(right.end)
    scene.add_force(left.end, (0, -load))
    return scene


def force_on_truss(y, height):
    """Load at the height y of the top: the strain of a bar is its relative elongation."""
    length, now = np.hypot(1, height), np.hypot(1, y)
    return 2e3 * (length - now) / length * y / now


def test_a_toggle_on_a_sprung_slide_snaps_at_its_limit_points():
    """Two rigid bars of 1 m: no force at a node depends on the motion, only that of the slide."""
    height, stiffness = 0.28, 1000.0  # span 0.96 m each
    scene = fb.Scene()
    bars = [
        scene.add_body(
            (x + 0.48, height / 2), 1.0, 0.1, points={"foot": foot, "top": (0.96, height)}
        )
        for x, foot in ((0.0, (0, 0)), (0.96, (1.92, 0)))
    ]
    scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["foot"]))
    scene.add_joint(fb.Revolute(bars[0]["top"], bars[1]["top"]))
    spring = fb.Spring(stiffness)
    scene.add_joint(fb.PinInSlot(fb.GROUND, bars[1]["foot"], axis=(1, 0), spring=spring))
    scene.add_force(bars[0]["top"], (0.0, -30.0))
    points = fb.static(scene, load_steps=8, continuation="arc-length").critical_points
    # P = 4 k (s - s0) y / s with s^2 = 1 - y^2 has its extrema where s^3 = s0
    s = 0.96 ** (1 / 3)
    limit = 4 * stiffness * (s - 0.96) * np.sqrt(1 - s**2) / s
    assert [point.kind for point in points] == ["limit point"] * 2
    loads = [30 * point.load_factor for point in points]
    assert loads == pytest.approx([limit, -limit], rel=1e-9)


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("wall", [False, True])
def test_a_bifurcation_in_the_step_to_a_limit_point_is_located(wall, steps):
    """Half of the arch, held as by symmetry, has the limit point alone."""
    height, section = 0.0742, fb.Section(EA=1e4, GA=1e4, EI=2.0)
    radius = (1 + height**2) / (2 * height)
    angle = np.arcsin(1 / radius)

    def path(end, elements):
        shape = [
            (1 - radius * np.sin(a), height - radius * (1 - np.cos(a)))
            for a in (angle, (angle + end) / 2, end)
        ]
        scene, arch = pinned_bar(fb.arc(*shape), section, elements, degree=2)
        if end:
            scene.pin(arch.end)
        else:
            scene.fix(arch.end, "x", "rotation")
        crown = arch.node(0.5) if end else arch.end
        scene.add_force(crown, (0.0, -22.26 if end else -11.13))
        if wall:  # which is far away
            scene.add_contact(crown, fb.Line((0, -5), (0, 1)), stiffness=1e3)
        return fb.static(scene, load_steps=steps, continuation="arc-length", max_steps=16)

    (limit,) = path(0.0, 4).critical_points
    points = path(-angle, 8).critical_points
    assert [point.kind for point in points] == ["bifurcation", "limit point"]
    assert points[1].load_factor == pytest.approx(limit.load_factor, rel=1e-7)
    assert 0.998 < points[0].load_factor / limit.load_factor < 0.9999


def test_columns_that_differ_and_buckle_at_once_are_one_point():
    """The eigenvalues cross each other where they vanish."""
    scene = fb.Scene()
    for x, factor in ((0, 1.0), (1, 4.0)):
        section = fb.Section(EA=1e4 * factor, GA=4e3 * factor, EI=factor)
        beam = scene.add_beam([(x, 0), (x, 1)], section, 4, 2)
        scene.pin(beam.start)
        scene.fix(beam.end, "x")
        scene.add_force(beam.end, (0, -14.0 * factor))
    (point,) = fb.static(scene, load_steps=4).critical_points
    alone = fb.static(column(14.0, 4, 2, np.pi)[0], load_steps=4).critical_points[0]
    assert len(point.modes) == 2
    across = point.modes.shapes[:, [beam.node(0.5).number for beam in scene.beams], 0]
    assert abs(np.linalg.det(across / abs(across).max())) > 0.1  # one mode for each column
    assert point.load_factor == pytest.approx(alone.load_factor, rel=1e-8)


# -- Where steps meet a point ----------------------------------------------------------------------


def rigid_column(stiffness, load):
    """A rigid column of length 1 on a hinge: P L = c."""
    scene, bar, _ = hinged_body((0, 1), 1.0, 1.0, {"foot": (0, 0)}, spring=fb.Spring(stiffness))
    scene.add_force(bar.centre, (0, -load))
    return scene, bar.centre


@pytest.mark.parametrize(("load", "how"), [(7.0, None), (14.0, None), (14.0, "arc-length")])
def test_steps_may_end_exactly_at_a_bifurcation(load, how):
    scene, top = rigid_column(7.0, load)
    path = fb.static(scene, 4, continuation=how)
    assert path.load_factor == pytest.approx([0, 0.25, 0.5, 0.75, 1.0], abs=1e-12)
    (point,) = path.critical_points
    assert (point.kind, point.load_factor) == ("bifurcation", pytest.approx(7.0 / load, rel=1e-9))
    if load > 7:
        branch = fb.static(scene, start=point.branch(1), continuation="arc-length")
        assert abs(branch.position(top)[-1, 0]) > 0.5


@pytest.mark.parametrize("how", [None, "arc-length"])
def test_steps_may_end_exactly_at_a_bifurcation_of_a_loop(how):
    """A strut in a slot that moves up and down: k at the critical load is exactly zero."""
    scene = fb.Scene()
    strut = scene.add_body((0, 0.5), 1.0, 1.0, points={"foot": (0, 0), "top": (0, 1)})
    guide = scene.add_body((0, 1), 1.0, 1.0).centre
    scene.add_joint(fb.Revolute(fb.GROUND, strut["foot"]))
    scene.add_joint(fb.Prismatic(fb.GROUND, guide, axis=(0, 1)))
    scene.add_joint(fb.PinInSlot(guide, strut["top"], axis=(1, 0), spring=fb.Spring(2.0)))
    scene.add_force(strut["top"], (0, -4.0))
    (point,) = fb.static(scene, load_steps=4, continuation=how).critical_points
    assert point.kind == "bifurcation" and point.load_factor == pytest.approx(0.5)


def test_a_pivot_that_is_zero_is_no_bifurcation():
    """Two rods on springs c: K = [[2 c - P, -c], [-c, c - P]], regular at P = 2 c."""
    scene = fb.Scene()
    one = scene.add_body((1, 0), 1.0, 1.0, points={"O": (0, 0), "A": (1, 0)})
    two = scene.add_body((2, 0), 1.0, 1.0, points={"A": (1, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, one["O"], spring=fb.Spring(1.0)))
    scene.add_joint(fb.Revolute(one["A"], two["A"], spring=fb.Spring(1.0)))
    scene.add_force(two.centre, (-3.0, 0))
    path = fb.static(scene, load_steps=6)
    points = [3 * point.load_factor for point in path.critical_points]
    assert points == pytest.approx([(3 - 5**0.5) / 2, (3 + 5**0.5) / 2], rel=1e-9)
    assert path.unstable_modes.tolist() == [0, *[1] * 5, 2]


def stiffening(c):
    """A spring with the moment c x + 4 x^3."""
    return fb.Spring(strain_energy=lambda x: c / 2 * x**2 + x**4)


def yielding(c):
    """A spring that yields at a moment that is not reached."""

    def flow(old, strains0, strains, dt):
        trial = c * (strains[0] - old[0])
        return [old[0] + ufl.sign(trial) * ufl.max_value(abs(trial) - 100.0, 0) / c]

    variables = fb.InternalVariables(("plastic angle",), flow)
    return fb.Spring(strain_energy=lambda x, a: c / 2 * (x - a[0]) ** 2, internal=variables)


@pytest.mark.parametrize("spring", [stiffening, yielding])
@pytest.mark.parametrize("steps", [5, 6, 7, 10, 12])
def test_equal_columns_on_springs_of_a_user_buckle_at_once(steps, spring):
    """Two with c = 10 N m and one with 8 N m; with some numbers of steps rows lie exactly there."""
    scene = fb.Scene()
    for x, c in enumerate((10.0, 10.0, 8.0)):
        bar = scene.add_body((x, 1), mass=1.0, points={"foot": (x, 0)})
        scene.add_joint(fb.Revolute(fb.GROUND, bar["foot"], spring=spring(c)))
        scene.add_force(bar.centre, (0, -12.0))
    points = fb.static(scene, load_steps=steps).critical_points
    assert [12 * point.load_factor for point in points] == pytest.approx([8, 10], rel=1e-9)
    assert [(point.kind, len(point.modes)) for point in points] == [
        ("bifurcation", 1),
        ("bifurcation", 2),
    ]


@pytest.mark.parametrize("spring", [stiffening, yielding])
def test_a_closed_loop_buckles_where_nothing_flows(spring):
    """Two bars of 1 m between pins: the spring of the joint in the middle holds 2 c / L."""
    scene = fb.Scene()
    lower = scene.add_body((0, 0.5), mass=1.0, points={"foot": (0, 0), "top": (0, 1)})
    upper = scene.add_body((0, 1.5), mass=1.0, points={"foot": (0, 1), "top": (0, 2)})
    scene.add_joint(fb.Revolute(fb.GROUND, lower["foot"]))
    scene.add_joint(fb.Revolute(lower["top"], upper["foot"], spring=spring(3.0)))
    scene.add_joint(fb.PinInSlot(fb.GROUND, upper["top"], axis=(0, 1)))
    scene.add_force(upper["top"], (0, -20.0))
    (point,) = fb.static(scene, load_steps=5).critical_points
    assert point.kind == "bifurcation"
    assert 20 * point.load_factor == pytest.approx(2 * 3.0, rel=1e-9)


def test_a_ring_under_pressure_buckles_in_two_modes_at_once():
    """Pressure across the wall, as a virtual work of one's own: 3 EI / R^3 (Levy 1884)."""
    turn = ufl.as_matrix([[0, -1], [1, 0]])

    def pressure(step):
        tangent = step.prime(step.X + step.u)
        return 4.3 * step.load_factor * ufl.dot(turn * tangent, step.virtual_u)

    scene = fb.Scene()
    circle = fb.Curve(lambda f: (np.cos(2 * np.pi * f), np.sin(2 * np.pi * f)))
    ring = scene.add_beam(circle, fb.Section(1e5, 1e5, EI, rhoA=1.0), elements=24, degree=2)
    scene.add_joint(fb.Rigid(ring.end, ring.start))
    for fraction, component in ((0, "y"), (0.25, "x"), (0.5, "y")):
        scene.fix(ring.node(fraction), component)
    scene.add_virtual_work(pressure)
    (point,) = fb.static(scene, load_steps=16).critical_points
    assert (point.kind, len(point.modes)) == ("bifurcation", 2)
    assert 4.3 * point.load_factor == pytest.approx(3.0, rel=2e-4)


def test_an_error_names_the_bifurcation_at_which_steps_fail():
    """A push of 1e-9 of the load leads a column to one side, but not to a load above buckling."""
    straight, _ = column(14.0, 4, 2, np.pi)
    factor = fb.static(straight, load_steps=4).critical_points[0].load_factor
    scene, _ = column(14.0 * factor, 4, 2, np.pi)
    scene.add_force(scene.beams[0].node(0.5), (1e-9, 0))
    with pytest.raises(fb.StepError, match=r"a bifurcation near load factor 1\. Follow") as caught:
        fb.static(scene, load_steps=4, max_cuts=4)  # more cuts follow the bend
    path = caught.value.solution
    assert len(path.t) > 4
    assert path.critical_points[-1].load_factor == pytest.approx(1, abs=1e-7)
    assert "critical_points[-1].branch(+1)" in path.stats.failure.advice
    # No branches start on a path that began on another one.
    scene.remove(scene.loads[0])
    pushed = fb.static(scene, load_steps=1)
    scene.add_force(scene.beams[0].end, (0, -14.0 * factor))
    with pytest.raises(fb.StepError, match=r"a bifurcation near load factor 1\. If the path"):
        fb.static(scene, load_steps=4, max_cuts=4, start=pushed)


def test_an_error_names_the_limit_point_at_which_steps_fail():
    with pytest.raises(fb.StepError, match=r"limit point near load factor 0\.148\. .*arc-length"):
        fb.static(truss(0.2, 20.0), load_steps=17)


# -- Contact and materials that flow ---------------------------------------------------------------


def test_a_column_between_walls_buckles_as_if_they_were_away():
    scene, _ = column(50.0, 4, 2, np.pi)
    free = fb.static(scene, load_steps=6).critical_points
    for side in (0.02, -0.02):
        wall = fb.Line((side, 0), (-side, 0))
        scene.add_contact(scene.beams[0], wall, stiffness=1e4)
    points = fb.static(scene, load_steps=6).critical_points
    assert [point.kind for point in points] == ["bifurcation"] * 2
    factors = [point.load_factor for point in free]
    assert [point.load_factor for point in points] == pytest.approx(factors, rel=1e-9)


def test_a_heated_column_that_cannot_expand_buckles_beside_an_open_contact():
    """Nothing moves before it buckles: displacements are round-off."""
    scene, ends = fb.Scene(), np.array([(0.1, 0.3), (0.8, 1.7)])
    section = fb.Section(EA=1e6, GA=1e6, EI=EI)
    beam = scene.add_beam(ends, section, elements=4, degree=3)
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.add_contact(beam.node(0.5), fb.Line((2, 0), normal=(-1, 0)), stiffness=1e3)
    scene.add_natural_strain(beam, axial=6e-6)
    (point,) = fb.static(scene, load_steps=6).critical_points
    assert point.kind == "bifurcation"
    exact = EI * np.pi**2 / ((ends[1] - ends[0]) ** 2).sum()
    assert section.EA * 6e-6 * point.load_factor == pytest.approx(exact, rel=1e-4)


def test_a_column_that_leans_on_a_prop_buckles_into_two_waves():
    """The prop is a node's stop at a small gap in the middle, where the second mode has a node."""
    scene, _ = column(45.0, 8, 2, np.pi)
    middle = scene.beams[0].node(0.5)
    scene.add_contact(middle, fb.Line((2e-3, 0), (-1, 0)), stiffness=1e6)
    first = fb.static(scene, load_steps=4).critical_points[0]
    side = np.sign(first.modes.shapes[0, middle.number, 0])
    leaning = fb.static(scene, start=first.branch(side), continuation="arc-length")
    (point,) = leaning.critical_points
    c = 1 / STOUT.GA - 1 / STOUT.EA
    exact = (np.sqrt(1 + 4 * c * EI * 4 * np.pi**2) - 1) / (2 * c)
    assert point.kind == "bifurcation"
    assert 45 * point.load_factor == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(("stop", "steps"), [(0.05, 8), (0.0, 10)])
def test_a_truss_becomes_stable_where_it_meets_a_stop(stop, steps):
    """Its load falls down to the stop, where it has a minimum, and rises again."""
    scene = truss(0.2, 20.0)
    top = scene.beams[0].end
    scene.add_contact(top, fb.Line((0, stop), (0, 1)), stiffness=1e3)
    path = fb.static(scene, load_steps=steps, continuation="arc-length")
    limit, contact = path.critical_points
    assert [limit.kind, contact.kind] == ["limit point", "contact"]
    exact = force_on_truss(stop, 0.2) / 20
    assert contact.load_factor == pytest.approx(exact, rel=1e-9, abs=1e-12)
    assert contact.solution.position(top)[-1, 1] == pytest.approx(stop, abs=1e-9)
    assert path.stable[-1] and not path.stable[contact.row]
    assert_refused("no path branches off at a contact", lambda: contact.branch())
    drawn = fb.plot.equilibrium_paths(path, lambda s: s.position(top)[:, 1]).axes[0].lines
    assert {"limit point", "contact"} <= {line.get_label() for line in drawn}


@pytest.mark.parametrize("hardening", [0.0, 20.0])
def test_a_column_on_a_plastic_hinge_fails_where_it_begins_to_flow(hardening):
    """Loads V down and H across: M0 = V L sin psi + H L cos psi, psi = M0 / c. With V L < c."""
    c, yields, down, across = 100.0, 1.0, 5.0, 2.0

    def energy(x, a):
        return c / 2 * (x - a[0]) ** 2 + hardening / 2 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = c * (strains[0] - old[0]) - hardening * old[0]
        more = ufl.max_value(abs(trial) - yields, 0) / (c + hardening)
        return [old[0] + ufl.sign(trial) * more]

    hinge = fb.Spring(strain_energy=energy, internal=fb.InternalVariables(("a",), flow))
    scene, bar, _ = hinged_body((0, 1), 1.0, 1.0, {"foot": (0, 0)}, spring=hinge)
    scene.add_force(bar.centre, (across, -down))
    path = fb.static(scene, load_steps=7, continuation="arc-length", max_steps=30)
    points = path.critical_points
    if hardening:
        assert path.load_factor[-1] == 1 and path.stable.all() and not points
        return
    (point,) = points
    psi = yields / c
    exact = yields / (down * np.sin(psi) + across * np.cos(psi))
    assert point.kind == "flow"
    assert point.load_factor == pytest.approx(exact, rel=1e-7)
    assert path.load_factor.max() == pytest.approx(exact, rel=1e-7)
    drawn = fb.plot.equilibrium_paths(path, lambda s: s.rotation(bar.centre)).axes[0].lines
    marked = [line.get_ydata().tolist() for line in drawn if line.get_label() == "flow"]
    assert marked == [[point.load_factor]]


@pytest.mark.parametrize("how", [None, "arc-length"])
def test_a_column_that_hardens_buckles_at_its_tangent_modulus_load(how):
    """Shanley (1947): two flanges that flow, with a quarter of the modulus: pi^2 Et I / L^2."""
    E, slope, d = 1e4, 2.5e3, 0.02
    hardening = E * slope / (E - slope)
    euler = np.pi**2 * E * d**2
    yields = 0.075 * euler  # of a flange

    def energy(eps, gamma, kappa, a):
        flanges = ((eps + d * kappa, a[0]), (eps - d * kappa, a[1]))
        stored = sum(E / 4 * (e - x) ** 2 + hardening / 4 * x**2 for e, x in flanges)
        return stored + E / 2 * gamma**2

    def flow(old, strains0, strains, dt):
        new = []
        for x, z in ((old[0], d), (old[1], -d)):
            trial = E / 2 * (strains[0] + z * strains[2] - x) - hardening / 2 * x
            more = ufl.max_value(abs(trial) - yields, 0) / ((E + hardening) / 2)
            new.append(x + ufl.sign(trial) * more)
        return new

    variables = fb.InternalVariables(("one", "other"), flow)
    section = fb.Section(strain_energy=energy, internal=variables)
    scene, beam = supported_bar((0, 1), section, 8, 2, held="x", load=(0, -0.5 * euler))
    path = fb.static(scene, load_steps=7, continuation=how)
    (point,) = path.critical_points
    load = 0.5 * euler * point.load_factor
    strain = 2 * yields / E + (load - 2 * yields) / slope
    assert point.kind == "bifurcation"
    assert load * (1 - strain + load / E) == pytest.approx(np.pi**2 * slope * d**2, rel=1e-4)
    # Only one flange goes on flowing: beside the straight column the load rises, as it must.
    options = {"continuation": "arc-length", "max_steps": 12}
    bent = fb.static(scene, start=point.branch(1), **options)
    assert bent.load_factor[1:].min() > point.load_factor
    assert abs(bent.displacement(beam.node(0.5))[-1, 0]) > 0.01


def test_points_are_kept_in_copies_once_they_were_read():
    scene, _ = column(14.0, 4, 2, np.pi)
    path = fb.static(scene, load_steps=3)
    before = pickle.loads(pickle.dumps(path))
    with pytest.raises(ValueError, match="Compute the path again"):
        _ = before.critical_points
    (point,) = path.critical_points
    (copy,) = pickle.loads(pickle.dumps(path)).critical_points
    assert copy.load_factor == point.load_factor
    assert np.array_equal(copy.modes.shapes, point.modes.shapes)


def test_an_imperfect_bifurcation_is_a_limit_point_for_any_steps():
    """A spring beside the column is stretched a little by its compression, and pulls it aside.

    Long steps would go on along the column, and are divided.
    """

    def limit(load_steps):
        section = fb.Section(EA=3800.0, GA=1900.0, EI=2.3)
        scene, column = supported_bar((0, 1), section, elements=4, degree=3, held="x")
        scene.add_force_between(column.node(0.5), (1, 0.5), spring=fb.Spring(14.0, rest=1.0))
        scene.add_force(column.end, (0, -76.0))
        with pytest.raises(fb.StepError, match="does not return to load factor 1") as caught:
            fb.static(scene, load_steps, continuation="arc-length", branches=1)
        (point,) = caught.value.solution.critical_points
        assert point.kind == "limit point"
        return point.load_factor

    assert limit(8) == pytest.approx(limit(64), rel=1e-6)


def test_at_a_point_of_a_path_with_a_start_both_loads_act():
    """A weight on an upright rod, then a load on its end; a bar that is pressed by its heat first.

    The rod falls at 10 N m/rad = 5 N m + 10 N m l. The bar keeps its length:
    P (1 + P/GA) = pi^2 EI/L^2, from 4 N on.
    """
    scene, rod, _ = hinged_body(
        (0, 0.5), 1.0, 0.1, {"low": (0, 0), "top": (0, 1)}, spring=fb.Spring(10.0), gravity=(0, -10)
    )
    under_its_weight = fb.static(scene)
    scene.add_force(rod["top"], (0, -10.0))
    paths = [(scene, fb.static(scene, load_steps=5, start=under_its_weight), 0.5)]

    scene, _ = column(0.0, 4, 3, np.pi, replace(STOUT, rhoA=1.0, rhoI=1e-4))
    (bar,) = scene.beams
    scene.fix(bar.end, "y")
    heat = scene.add_natural_strain(bar, axial=4e-4)
    exact = STOUT.GA / 2 * (np.sqrt(1 + 4 * np.pi**2 / STOUT.GA) - 1)
    warm = fb.static(scene)
    scene.change(heat, axial=14e-4)
    paths.append((scene, fb.static(scene, load_steps=5, start=warm), (exact - 4) / 10))

    for scene, path, factor in paths:
        (point,) = path.critical_points
        assert point.load_factor == pytest.approx(factor, rel=1e-4)
        assert abs(fb.modes(scene, point.solution, n=1).angular_frequencies[0]) < 1e-3
        roots = abs(np.linalg.eigvals(fb.linearise(scene, point.solution).A))
        assert np.sort(roots)[:2] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("wall", [False, True])
def test_long_steps_find_the_bifurcation_of_short_ones_beside_an_open_contact(wall):
    """A post on a shallow arch, of which one half is rigid. Long steps may leave its path."""
    section = fb.Section(EA=1e4, GA=1e4, EI=2.0)
    scene, half = pinned_bar((1, 0.15), section, elements=3, degree=2)
    other = scene.add_body((1.5, 0.075), 1.0, 0.1, points={"top": (1, 0.15), "foot": (2, 0)})
    post = scene.add_beam([(1, 0.15), (1, 0.85)], section, elements=3, degree=2)
    scene.add_joint(fb.Revolute(half.end, other["top"]))
    scene.add_joint(fb.Revolute(half.end, post.start))
    scene.fix(other["foot"], "y")
    for node, anchor, stiffness in (
        (half.start, other["foot"], 2500.0),
        (half.end, (1, -1), 44.0),
        (post.end, (-1, 0.85), 106.0),
        (post.end, (3, 0.85), 121.0),
    ):
        place = anchor if isinstance(anchor, tuple) else (anchor.x, anchor.y)
        rest = np.hypot(place[0] - node.x, place[1] - node.y)
        scene.add_force_between(node, anchor, spring=fb.Spring(stiffness, rest=rest))
    scene.add_force(post.end, (0.0, -200.0))
    if wall:
        scene.add_contact(half.end, fb.Line((0, -0.8), (0, 1)), stiffness=1e4)
    first, other = (
        fb.static(scene, steps, continuation="arc-length", max_steps=most).critical_points[0]
        for steps, most in ((10, 2), (40, 20))
    )
    assert first.kind == other.kind == "bifurcation"
    assert first.load_factor == pytest.approx(other.load_factor, rel=1e-6)


@pytest.mark.parametrize("what", ["beam", "body", "nothing of it"])
def test_what_a_scene_has_later_is_not_in_the_critical_points_of_an_earlier_path(what):
    scene, P = column(1.0, 8, 1, np.pi / 2)
    mass = scene.add_body((2, 0), 1.0, 0.1, name="mass")
    scene.add_joint(fb.Revolute(fb.GROUND, mass.centre, spring=fb.Spring(5.0)))
    scene.add_force(scene.beams[0].end, (0, 1 - 3 * P))
    path, members = fb.static(scene, load_steps=5), (["mass"], [scene.beams[0].name])
    if what == "beam":
        scene.add_beam([(1, 0), (1, 1)], STOUT, elements=2)
    elif what == "body":
        scene.add_body((0, 3), 1.0)
    else:
        scene.remove(mass)
    (point,) = path.critical_points
    assert (point.kind, point.load_factor) == ("bifurcation", pytest.approx(1 / 3, rel=0.01))
    assert ([*point.modes.bodies], [*point.modes.beams]) == members
