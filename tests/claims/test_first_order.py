"""First-order statics against a stiffness matrix of Timoshenko's beams, and closed forms."""

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, one_bar

import fx_beam as fb
from fx_beam.results.member_fields import along_all

EA, GA, EI = 3e5, 1e5, 40.0
SECTION = fb.Section(EA=EA, GA=GA, EI=EI, rhoA=2.0)
LIGHT = fb.Section(EA=EA, GA=GA, EI=EI)


def stiffness(a, b):
    """Stiffness (6, 6) of a beam of Timoshenko between two points, and its turn (6, 6)."""
    (dx, dy) = np.subtract(b, a)
    L = np.hypot(dx, dy)
    c, s, phi = dx / L, dy / L, 12 * EI / (GA * L**2)
    k = EI / (L**3 * (1 + phi))
    K = np.zeros((6, 6))
    K[np.ix_([0, 3], [0, 3])] = EA / L * np.array([[1, -1], [-1, 1]])
    near, far = (4 + phi) * L**2, (2 - phi) * L**2
    K[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = k * np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, near, -6 * L, far],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, far, -6 * L, near],
        ]
    )
    turn = np.kron(np.eye(2), [[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return K, turn


POINTS = np.array([(0, 0), (0, 3), (2, 4.5), (4, 3), (4, 0)], float)
MEMBERS = [(0, 1), (1, 2), (2, 3), (3, 4), (1, 3)]
LOADS = np.zeros((5, 3))
LOADS[1], LOADS[2], LOADS[3] = (5.0, -20.0, 0.0), (1.0, -40.0, 3.0), (0.0, -10.0, -2.0)


def by_stiffness():
    """Displacements (5, 3) of a frame on two clamps, reactions, and end forces of members."""
    K = np.zeros((15, 15))
    for a, b in MEMBERS:
        local, turn = stiffness(POINTS[a], POINTS[b])
        dofs = [*range(3 * a, 3 * a + 3), *range(3 * b, 3 * b + 3)]
        K[np.ix_(dofs, dofs)] += turn.T @ local @ turn
    free = np.arange(3, 12)
    u = np.zeros(15)
    u[free] = np.linalg.solve(K[np.ix_(free, free)], LOADS.ravel()[free])
    ends = []
    for a, b in MEMBERS:
        local, turn = stiffness(POINTS[a], POINTS[b])
        dofs = [*range(3 * a, 3 * a + 3), *range(3 * b, 3 * b + 3)]
        ends.append(local @ turn @ u[dofs])
    return u.reshape(5, 3), (K @ u - LOADS.ravel()).reshape(5, 3), np.array(ends)


def frame(factor=1.0):
    scene = fb.Scene()
    beams = scene.add_mesh(POINTS, MEMBERS, SECTION, elements=2, degree=3)
    for node in (beams.nodes[0], beams.nodes[4]):
        scene.clamp(node)
    for node, (x, y, moment) in zip(beams.nodes, LOADS, strict=True):
        scene.add_force(node, (factor * x, factor * y))
        scene.add_moment(node, factor * moment)
    return scene, beams


@pytest.mark.parametrize("factor", [1.0, 1e4])  # large loads, in which no path could be followed
def test_a_frame_has_the_displacements_and_forces_of_its_stiffness_matrix(factor):
    u, reactions, ends = by_stiffness()
    scene, beams = frame(factor)
    solution = fb.static(scene, linear=True)
    q = np.array(
        [[*solution.displacement(node)[-1], solution.rotation(node)[-1]] for node in beams.nodes]
    )
    assert q / factor == pytest.approx(u, rel=1e-9, abs=1e-9 * abs(u).max())
    for k in (0, 4):
        computed = solution.reaction(beams.nodes[k])[-1] / factor
        assert computed == pytest.approx(reactions[k], abs=1e-8 * abs(reactions).max())
    ends_of_element = np.array([0.0, 1.0])
    N, Q, M = (values[0] for values in along_all(solution, "NQM", [1], ends_of_element).values())
    for member, (n1, q1, m1, n2, q2, m2) in enumerate(ends):
        first, last = 2 * member, 2 * member + 1
        size = 1e-8 * abs(ends).max()
        assert [-N[first, 0] / factor, N[last, 1] / factor] == pytest.approx([n1, n2], abs=size)
        assert [-Q[first, 0] / factor, Q[last, 1] / factor] == pytest.approx([q1, q2], abs=size)
        assert [-M[first, 0] / factor, M[last, 1] / factor] == pytest.approx([m1, m2], abs=size)


@pytest.mark.parametrize(("elements", "degree"), [(1, 3), (4, 3), (16, 3), (16, 1)])
@pytest.mark.parametrize("stiff", [1e6, 1e9, 1e12])
def test_forces_of_a_stiff_portal_are_in_balance_and_those_of_kleinlogel(stiff, elements, degree):
    """Clamped feet, EI 1 and 2.5, a side force of 3: foot moments of 36/11."""
    scene = fb.Scene()
    post, girder = fb.Section(stiff, stiff, 1.0), fb.Section(stiff, stiff, 2.5)
    left = scene.add_beam([(0, 0), (0, 4)], post, elements, degree)
    top = scene.add_beam([left.end, (6, 4)], girder, elements, degree)
    right = scene.add_beam([(6, 0), top.end], post, elements, degree)
    scene.clamp(left.start)
    scene.clamp(right.start)
    scene.add_force(left.end, (3.0, 0.0))
    solution = fb.static(scene, linear=True)
    (x0, y0, m0), (x1, y1, m1) = (solution.reaction(b.start)[-1] for b in (left, right))
    assert [x0 + x1 + 3, y0 + y1, m0 + m1 + 6 * y1 - 12] == pytest.approx([0, 0, 0], abs=3e-10)
    accuracy = 6 / stiff + 1e-10 if degree == 3 else 4e-4
    assert m0 == pytest.approx(36 / 11, rel=accuracy)
    # Sections of the members, at nodes and Gauss points.
    N, Q, M = [], [], []
    for beam in (left, top, right):
        resultants = solution.resultants(beam)
        ends = resultants.at(np.array([0.0, beam.length]))
        for ends_of_all, at_ends, at_points in (
            (N, ends.N, resultants.N),
            (Q, ends.Q, resultants.Q),
        ):
            ends_of_all.append(at_ends[-1])
            assert at_points[-1] == pytest.approx(at_ends[-1, 0] + 0 * at_points[-1], abs=1e-10)
        M.append(ends.M[-1])
    assert np.array(N) == pytest.approx(np.array([[-y0] * 2, [x1] * 2, [-y1] * 2]), abs=1e-10)
    assert np.array(Q) == pytest.approx(np.array([[x0] * 2, [y1] * 2, [x1] * 2]), abs=1e-10)
    assert [M[0][0], M[2][0]] == pytest.approx([-m0, -m1], abs=1e-10)
    assert [M[0][1], M[2][1]] == pytest.approx([M[1][0], -M[1][1]], abs=1e-10)


def test_stiff_members_between_bodies_and_joints_are_in_balance_under_loads_inside_elements():
    stiff = fb.Section(EA=1e12, GA=1e12, EI=1.0, rhoA=3.0)
    scene = fb.Scene(gravity=(0, -2.0))
    post = scene.add_beam([(0, 0), (0, 2)], stiff, 4, 3)
    scene.clamp(post.start)
    block = scene.add_body((0.5, 2.5), 1.0, 1.0, points={"in": post.end, "out": (1, 3)})
    arm = scene.add_beam([block["out"], (4, 7)], stiff, 5, 3)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.end))
    scene.add_line_load(arm, (1.0, -5.0))
    scene.add_force(arm.at(1.3), (1.0, -2.0))
    solution = fb.static(scene, linear=True)
    foot, pin = solution.reaction(post.start)[-1], solution.joint(hinge).force[-1]
    # Weights of post, block and arm, the line load and the force, with their places.
    loads = [((0, 1), (0, -12)), ((0.5, 2.5), (0, -2)), ((2.5, 5), (0, -30))]
    loads += [((2.5, 5), (5, -25)), ((1.78, 4.04), (1, -2))]
    forces = np.sum([force for _, force in loads], axis=0)
    moments = sum(x * fy - y * fx for (x, y), (fx, fy) in loads)
    size = 1e-10 * abs(forces).max()
    assert foot[:2] + pin[:2] == pytest.approx(-forces, abs=size)
    assert foot[2] + 4 * pin[1] - 7 * pin[0] == pytest.approx(-moments, abs=10 * size)
    ends = solution.resultants(arm).at(np.array([0.0, 5.0]))
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    assert ends.M[-1, 1] == pytest.approx(0.0, abs=size)
    expected = [along @ pin[:2], across @ pin[:2]]
    assert [ends.N[-1, 1], ends.Q[-1, 1]] == pytest.approx(expected, abs=size)


def test_energies_are_half_the_work_of_the_full_loads():
    u, _, _ = by_stiffness()
    scene, _ = frame()
    energy = fb.static(scene, linear=True).energy
    assert energy.strain[-1] == pytest.approx(0.5 * (u * LOADS).sum(), rel=1e-8)
    assert abs(energy.balance_error).max() < 1e-8 * energy.strain[-1]


def test_it_is_the_limit_of_static_at_small_loads():
    scene, beams = frame(1e-4)
    linear = fb.static(scene, linear=True)
    path = fb.static(scene, load_steps=1)
    assert linear.q[-1] == pytest.approx(path.q[-1], abs=1e-3 * abs(path.q).max())


def test_weight_heat_settlement_and_springs_count():
    L, q, settled, k, heat = 2.0, 2.0 * 9.81, -0.01, 50.0, 2e-3
    scene, beam = one_bar((L, 0), SECTION, elements=2, degree=3, gravity=(0, -9.81))
    scene.fix(beam.start, "x", "rotation")
    scene.prescribe(beam.start, y=lambda t: settled)
    scene.add_force_between(beam.end, (L, -1.0), spring=fb.Spring(k, rest=1.0))
    scene.add_natural_strain(beam, curvature=heat)
    tip = fb.static(scene, linear=True).displacement(beam.end)[-1, 1]
    free = settled - q * L**4 / (8 * EI) - q * L**2 / (2 * GA) + heat * L**2 / 2
    compliance = L**3 / (3 * EI) + L / GA
    assert tip == pytest.approx(free / (1 + k * compliance), rel=1e-8)


@pytest.mark.parametrize("body_first", [True, False])
def test_a_body_on_an_arm_sinks_as_far_as_its_first_order_displacement(body_first):
    """Whichever of its nodes has the unknowns; its weight does half of its work on the beam."""
    scene, L, weight, arm = fb.Scene(gravity=(0, -10.0)), 2.0, 30.0, 0.3
    place, points = (L + arm, 0.5), {"hook": (L, 0)}
    if body_first:
        body = scene.add_body(place, weight / 10, points=points)
    beam = scene.add_beam([(0, 0), (L, 0)], LIGHT, elements=2, degree=3)
    if not body_first:
        body = scene.add_body(place, weight / 10, points=points)
    scene.clamp(beam.start)
    scene.add_joint(fb.Rigid(beam.end, body["hook"]))
    M = -weight * arm
    w = -weight * (L**3 / (3 * EI) + L / GA) + M * L**2 / (2 * EI)
    turn = M * L / EI - weight * L**2 / (2 * EI)
    solution, sunk = fb.static(scene, linear=True), w + turn * arm
    assert solution.displacement(body.centre)[-1, 1] == pytest.approx(sunk, rel=1e-8)
    assert solution.energy.potential[-1] == pytest.approx(weight * sunk, rel=1e-8)
    assert solution.energy.strain[-1] == pytest.approx(-weight * sunk / 2, rel=1e-8)
    assert abs(solution.energy.balance_error).max() < 1e-8 * abs(weight * sunk)


@pytest.mark.parametrize("body_first", [True, False])
def test_a_taut_line_on_an_arm_is_a_load_in_the_shape_as_it_is_drawn(body_first):
    """It pulls with T along the beam and the arm, so little that it hardly stiffens the beam."""
    scene, L, T, k, F = fb.Scene(), 2.0, 2e-5, 50.0, 3e-3
    if body_first:
        body = scene.add_body((L + 0.5, 0), 1.0)
    beam = scene.add_beam([(0, 0), (L, 0)], LIGHT, elements=2, degree=3)
    if not body_first:
        body = scene.add_body((L + 0.5, 0), 1.0)
    scene.clamp(beam.start)
    pair = (body.centre, beam.end) if body_first else (beam.end, body.centre)
    joint = scene.add_joint(fb.Rigid(*pair, offset=(-0.5 if body_first else 0.5, 0)))
    spring = fb.Spring(k, rest=1e3 - T / k)
    line = scene.add_force_between(body.centre, (L + 0.5 + 1e3, 0), spring)
    scene.add_force(beam.end, (0, F))
    solution = fb.static(scene, linear=True)
    u, w = solution.displacement(beam.end)[-1]
    pull = T - k * u
    assert w == pytest.approx(F * (L**3 / (3 * EI) + L / GA), rel=1e-5)
    assert u == pytest.approx(T / (EA / L + k), rel=1e-5)
    assert solution.joint(line).force[-1] == pytest.approx(pull, rel=1e-6)
    expected = (1, -1)[body_first] * -pull
    assert solution.joint(joint).force[-1, 0] == pytest.approx(expected, rel=1e-6)
    assert solution.reaction(beam.start)[-1] == pytest.approx([-pull, -F, -F * L], rel=1e-5)
    assert solution.energy.springs == pytest.approx([pull**2 / (2 * k)] * 2, rel=1e-3)


def test_a_taut_line_at_a_pin_pulls_at_it_without_loads_as_well():
    """As at a supported node, which has a reaction in both rows; another line pulls at the beam."""
    scene, spring = fb.Scene(), fb.Spring(10.0, rest=0.5)
    beam = scene.add_beam([(0, 0), (1, 0)], LIGHT, elements=2)
    pin = scene.add_joint(fb.Revolute(fb.GROUND, beam.start))
    scene.fix(beam.end, "y")
    for node in (beam.start, beam.node(0.5)):
        scene.add_force_between(node, (node.x, -1), spring)
    pull = fb.static(scene, linear=True).joint(pin).force
    assert pull[:, 1] == pytest.approx(5.0 + 2.5, rel=0.01)


@pytest.mark.parametrize("joint", [fb.Prismatic, fb.PinInSlot])
def test_a_spring_on_a_slide_under_tension_is_let_go_against_both_beams(joint):
    """Two cantilevers along x meet in a slide along y; its spring is pushed together by s."""
    L, k, s = 2.0, 30.0, 4e-6
    scene, left = clamped_bar((L, 0), LIGHT, elements=2, degree=3)
    right = scene.add_beam([(2 * L, 0), (L, 0)], LIGHT, elements=2, degree=3)
    scene.clamp(right.start)
    # Where the ends turn alike, as in a prismatic joint, each is a cantilever with a guided end.
    guided = joint is fb.Prismatic
    compliance = L**3 / ((12 if guided else 3) * EI) + L / GA
    slide = scene.add_joint(joint(left.end, right.end, axis=(0, 1), spring=fb.Spring(k, rest=s)))
    if guided:
        scene.fix(left.end, "rotation")
    solution = fb.static(scene, linear=True)
    opened = s * k / (k + 0.5 / compliance)
    assert solution.joint(slide).slide[-1] == pytest.approx(opened, rel=1e-8)
    assert solution.energy.springs == pytest.approx(k / 2 * (opened - s) ** 2)
    stored = 2 * (opened / 2) ** 2 / (2 * compliance)
    assert solution.energy.strain[-1] == pytest.approx(stored, rel=1e-8)
    assert abs(solution.energy.balance_error).max() < 1e-8 * stored


def test_a_short_line_is_short_beside_displacements_that_nothing_turns_with():
    """A ball on two lines, far from a beam that hardly bends."""
    scene, beam = clamped_bar((2, 0), fb.Section(EA=1e6, GA=1e6, EI=1e4), elements=2)
    scene.add_force(beam.end, (0, 1e-4))
    ball = scene.add_body((2.9, 0), mass=1.0).centre
    scene.fix(ball, "rotation")
    lines = [(beam.end, 0.9), ((3.2, 0.4), 0.5)]
    lines = [scene.add_force_between(ball, p, fb.Spring(10.0, rest=r)) for p, r in lines]
    scene.add_force(ball, (1e-3, 2e-3))
    solution = fb.static(scene, linear=True)
    pulls = [solution.joint(line).force[-1] for line in lines]
    assert pulls == pytest.approx([1e-3 - 0.75 * 2e-3, -2e-3 / 0.8], rel=1e-8)
    assert solution.reaction(beam.start)[-1] == pytest.approx([5e-4, -1e-4, -2e-4], rel=1e-8)
    stored = sum(pull**2 for pull in pulls) / 20
    assert solution.energy.springs[-1] == pytest.approx(stored, rel=1e-8)


def test_a_stop_that_is_far_does_not_count_where_what_slides_turns_nothing():
    scene, beam = clamped_bar((2, 0), SECTION, elements=2, degree=3)
    scene.add_force(beam.end, (0, 1e-8))
    ball = scene.add_body((2.9, 0), mass=1.0).centre
    laws = {"spring": fb.Spring(10.0), "stop": (-0.1, 0.1, 1e4)}
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, ball, axis=(1, 0), **laws))
    scene.add_force(ball, (1e-2, 0))
    assert fb.static(scene, linear=True).joint(guide).slide[-1] == pytest.approx(1e-3)


@pytest.mark.parametrize("joint", [fb.Slider, fb.Sleeve])
def test_a_node_slides_on_a_beam_as_far_as_its_spring_lets_it(joint):
    """The beam does not bend at all, and hardly stretches."""
    scene, beam = clamped_bar((2, 0), fb.Section(EA=1e6, GA=1e6, EI=1e4), elements=4)
    scene.clamp(beam.end)
    ball = scene.add_body((0.9, 0), mass=1.0).centre
    slide = scene.add_joint(joint(beam, ball, spring=fb.Spring(10.0, rest=0.9)))
    scene.add_spring(ball, rotation=fb.Spring(1.0))
    scene.add_force(ball, (1e-3, 0))
    solution = fb.static(scene, linear=True)
    assert solution.joint(slide).slide[-1] == pytest.approx(0.9001, rel=1e-12)
    assert solution.displacement(ball)[-1] == pytest.approx([1e-4, 0], rel=1e-5)
    assert abs(solution.energy.balance_error).max() < 1e-8 * solution.energy.springs[-1]


def test_joints_are_those_of_the_reference():
    # A hinged beam in the middle: the hinge has no moment, and each half is a cantilever.
    scene, left = clamped_bar((1, 0), SECTION, elements=2, degree=3)
    right = scene.add_beam([(1, 0), (3, 0)], SECTION, elements=2, degree=3)
    scene.clamp(right.end)
    scene.add_joint(fb.Revolute(left.end, right.start))
    scene.add_force(left.end, (0, -6.0))
    solution = fb.static(scene, linear=True)
    stiffnesses = [1 / (L**3 / (3 * EI) + L / GA) for L in (1.0, 2.0)]
    sunk = solution.displacement(left.end)[-1, 1]
    assert sunk == pytest.approx(-6.0 / sum(stiffnesses), rel=1e-9)
    assert solution.reaction(left.start)[-1, 1] == pytest.approx(-sunk * stiffnesses[0], rel=1e-8)


@pytest.mark.parametrize("gap", [1e-3, 0.5])
@pytest.mark.parametrize("stiff", [1e3, 1e7])
def test_a_stop_stays_open(gap, stiff):
    section = fb.Section(EA=stiff, GA=stiff, EI=1.0)
    scene, beam = clamped_bar((1, 0), section, elements=2, degree=3, load=(0, -1.0))
    scene.add_force_between(beam.end, (1.0, -1.0), stop=(1.0 - gap, None, 1e5))
    sunk = fb.static(scene, linear=True).displacement(beam.end)[-1, 1]
    assert sunk == pytest.approx(-(1 / 3 + 1 / stiff), rel=1e-7)


def resting():
    scene, beam = clamped_bar((1, 0), SECTION, elements=4, gravity=(0, -9.81))
    scene.add_contact(beam.end, fb.Line((0, 0), normal=(0, 1)), stiffness=1e5)
    return scene


def swinging():
    scene = fb.Scene(gravity=(0, -9.81))
    scene.pin(scene.add_beam([(0, 0), (1, 0)], SECTION, elements=4).start)
    return scene


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (resting, {}, "linear: a stop, a contact or a law of springs switches"),
        (swinging, {}, "it has no first-order equilibrium"),
        (lambda: frame()[0], {"spin": 1.0}, "linear goes without start, spin"),
        (lambda: frame()[0], {"linear": "yes"}, "linear = 'yes' must be True or False"),
        (lambda: frame()[0], {"continuation": "arc-length"}, "linear goes without"),
    ],
)
def test_what_has_no_first_order_answer_is_refused(make, options, message):
    assert_refused(message, lambda: fb.static(make(), **{"linear": True} | options))


@pytest.mark.parametrize(("slender", "warns"), [(1e-9, False), (1e-14, True)])
def test_beams_so_thin_that_rounding_hides_their_bending_are_told(slender, warns, caplog):
    """In first order, modes and buckling loads. Load steps know bending by its strains."""
    section = fb.Section(EA=1.0, GA=1.0, EI=slender, rhoA=1.0)
    scene, beam = clamped_bar((1, 0.3), section, elements=64)
    scene.add_force(beam.end, (-2e-3 * slender, 1e-3 * slender))
    analyses = [
        lambda: fb.static(scene, linear=True),
        lambda: fb.modes(scene, n=1),
        lambda: fb.buckling(scene, n=1),
    ]
    for analysis in analyses:
        caplog.clear()
        analysis()
        assert ("few correct digits" in caplog.text) == warns
    length = np.hypot(1, 0.3)
    across = np.array([-0.3, 1.0]) / length
    force = across @ (-2e-3, 1e-3) * slender
    deflection = fb.static(scene, load_steps=1).displacement(beam.end)[-1] @ across
    exact = force * length**3 / 3 / slender + force * length
    assert deflection == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(("slender", "warns"), [(1.0, False), (1e-14, True)])
def test_a_mode_of_a_column_under_its_critical_load_is_not_lost_in_rounding(slender, warns, caplog):
    """It bends without any stiffness, as one does that rounding hides in the reference, too."""
    section = fb.Section(EA=1e8, GA=1e8, EI=slender, rhoA=1.0, rhoI=1e-3)
    scene, beam = clamped_bar((1, 0), section, elements=10)
    load = scene.add_force(beam.end, (-1.0, 0))
    critical = float(fb.buckling(scene, n=1).load_factors[0]) if slender == 1.0 else 0.0
    scene.change(load, (-critical, 0.0))
    state = fb.static(scene)
    caplog.clear()
    assert fb.modes(scene, state, n=2).frequencies[0] == 0
    assert ("few correct digits" in caplog.text) == warns


def test_free_beams_have_rigid_modes_without_a_word(caplog):
    scene = fb.Scene()
    for k in (1, 3):
        section = fb.Section(EA=1e6, GA=1e6, EI=1.0, rhoA=1.0, rhoI=1e-6)
        scene.add_beam([(0, k), (2, k)], section, elements=8)
    assert (fb.modes(scene, n=6).frequencies == 0).all()
    assert not caplog.text


@pytest.mark.parametrize("begin", [fb.simulate, fb.Motion])
def test_a_motion_does_not_start_from_a_solution_of_first_order(begin):
    """Whose elements would be stretched by the turns that it takes for small ones."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=0.1))
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, 1.0))
    options = {"t_end": 0.1} if begin is fb.simulate else {}
    with pytest.raises(fb.SceneError, match="first order is in no balance"):
        begin(scene, dt=0.01, start=fb.static(scene, linear=True), **options)
