"""Natural frequencies against exact ones, dense algebra, equilibria and the motion itself."""

import math
import pickle

import ufl

import numpy as np
import pytest
import scipy.linalg
from jointed import BENDING, pair
from scenes import FLYING, assert_refused, clamped_bar, demo, held_body, one_bar, supported_bar

import fx_beam as fb

DEGREES = pytest.mark.parametrize("degree", [1, 2, 3])
GRAVITY = 9.81


def square(height):
    """Square section of unit modulus, so stiff along its axis that only bending is low."""
    A, J = height**2, height**4 / 12
    return fb.Section(EA=1e3 * A, GA=5 / 6 * A / 2.6, EI=J, rhoA=A, rhoI=J)


def simply_supported(degree, elements, section):
    scene, beam = supported_bar((1, 0), section, elements=elements, degree=degree)
    return scene


def timoshenko(section, n):
    """Lowest angular frequencies of a simply supported beam of length 1 with rotary inertia.

    For w = W sin(k x), psi = P cos(k x) with k = m pi: the two roots of the quadratic in omega^2
    for each m, and sqrt(GA/rhoI) for m = 0.
    """
    s, computed = section, [math.sqrt(section.GA / section.rhoI)]
    for k in math.pi * np.arange(1, n + 1):
        linear = s.rhoA * (s.EI * k**2 + s.GA) + s.GA * k**2 * s.rhoI
        computed += list(np.sqrt(np.roots([s.rhoA * s.rhoI, -linear, s.GA * s.EI * k**4])))
    return np.sort(computed)[:n]


# -- Straight beams ----------------------------------------------------------------------------


@DEGREES
def test_five_frequencies_of_a_supported_beam_converge_to_the_exact_ones(degree):
    section = square(0.2)
    exact = timoshenko(section, 5)
    slender = (math.pi * np.arange(1, 6)) ** 2 * math.sqrt(section.EI / section.rhoA)
    assert (1 - exact / slender > 0.25).any()  # shear and rotary inertia count
    counts = {1: (16, 32), 2: (8, 16), 3: (6, 12)}[degree]
    errors = [fb.modes(simply_supported(degree, n, section), n=5) for n in counts]
    errors = np.array([computed.angular_frequencies / exact - 1 for computed in errors])
    order = np.log2(errors[0] / errors[1])
    # Two for each degree; the first frequency stands for all once it is near its rounding.
    assert order[0] == pytest.approx(2 * degree, abs=0.1)
    assert (order > 2 * degree - 0.5).all()
    assert (errors[1] < {1: 0.14, 2: 2e-3, 3: 2e-4}[degree]).all()


@pytest.mark.parametrize(
    ("points", "height", "degree"),
    [([(0, 0), (0.6, 0.8)], 0.1, 1), (fb.arc((0, 0), (1, 0.1), (1, 1)), 1e-3, 2)],
)
def test_a_free_beam_has_three_rigid_modes(points, height, degree):
    scene = fb.Scene(gravity=(0, -10))
    scene.add_beam(points, square(height), elements=6, degree=degree)
    modes = fb.modes(scene, n=5)
    assert modes.rigid.tolist() == [True] * 3 + [False] * 2
    assert (modes.angular_frequencies[:3] == 0).all() and (modes.frequencies[3:] > 0).all()
    # Rounding mixes in some of the first bending mode, the more the softer that is.
    close = 1e-7 if height > 0.01 else 1e-3
    for shape in modes.shapes[:3]:
        # A turn about one point, or none.
        spin = shape[:, 2]
        assert spin == pytest.approx(spin[0], abs=close * abs(shape).max())
        x, y = (modes.positions - modes.positions[0]).T
        expected = shape[0, :2] + spin[0] * np.column_stack([-y, x])
        assert abs(shape[:, :2] - expected).max() < close * abs(shape).max()
    assert str(modes).splitlines()[0] == "mode 0: 0 Hz rigid"


# -- Rigid modes, copies and slender members -----------------------------------------------------

SPARSE = fb.Section(EA=1e5, GA=1e5, EI=1.0, rhoA=1.0)  # rotations without mass


def steel(height):
    return fb.Section.rectangle(height=height, width=0.1, E=2.1e11, rho=7850.0)


def chain(links, height, elements, degree):
    """Free links in a row with revolute joints between them."""
    scene, last = fb.Scene(), None
    for i in range(links):
        ends = [(0.8 * k, 0.6 * k) for k in (i, i + 1)]
        link = scene.add_beam(ends, steel(height), elements=elements, degree=degree)
        if last is not None:
            scene.add_joint(fb.Revolute(last.end, link.start))
        last = link
    return scene


def side_by_side(count, section, elements, degree=1):
    scene = fb.Scene()
    for y in range(count):
        beam = scene.add_beam([(0, y), (1, y)], section, elements=elements, degree=degree)
        scene.clamp(beam.start)
    return scene


@pytest.mark.parametrize("height", [0.1, 1e-5])
@pytest.mark.parametrize(("links", "elements", "degree"), [(1, 1, 1), (1, 128, 1), (3, 8, 2)])
def test_free_links_have_as_many_rigid_modes_as_they_can_move(links, elements, degree, height):
    scene = chain(links, height, elements, degree)
    mobility = 2 + links
    for n in (1, mobility, 6, 13):
        modes = fb.modes(scene, n=n)
        assert modes.rigid.sum() == min(n, mobility)
        assert modes.rigid[: min(n, mobility)].all() and not modes.unstable.any()


@pytest.mark.parametrize("count", [6, 25])
def test_no_copy_of_a_multiple_frequency_is_missed(count):
    one = fb.modes(side_by_side(1, SPARSE, 6, degree=2), n=3).angular_frequencies
    scene = side_by_side(count, SPARSE, 6, degree=2)
    for n in (1, count - 1, count, count + 2, 2 * count + 1):
        exact = np.repeat(one, count)[:n]
        assert fb.modes(scene, n=n).angular_frequencies == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize(("elements", "count"), [(1, 30), (2, 30), (4, 30)])
def test_all_modes_of_many_equal_beams_with_massless_turns_are_found(elements, count):
    one = fb.modes(side_by_side(1, SPARSE, elements), n=100).angular_frequencies
    assert len(one) == 2 * elements
    scene = side_by_side(count, SPARSE, elements)
    frequencies = fb.modes(scene, n=len(one) * count + 1).angular_frequencies
    assert frequencies == pytest.approx(np.repeat(one, count), rel=1e-8)


def test_parts_of_very_different_stiffness_have_the_modes_that_each_has_alone():
    stiff = fb.Section(EA=1e9, GA=1e9, EI=10.0, rhoA=1.0)
    soft = fb.Section(EA=1.0, GA=1.0, EI=1e-8, rhoA=1.0)

    def squeezed(*sections):
        scene = fb.Scene()
        for y, section in enumerate(sections):
            beam = scene.add_beam([(0, y), (1, y)], section, elements=8, degree=2)
            scene.pin(beam.start)
            scene.fix(beam.end, "y")
            # Between the second and the third critical load.
            scene.add_force(beam.end, (-4.5 * math.pi**2 * section.EI, 0))
        return fb.modes(scene, fb.static(scene), n=6).angular_frequencies

    alone = squeezed(stiff)[:2], squeezed(soft)
    assert (alone[0] < 0).all() and (alone[1] < 0).tolist() == [True] * 2 + [False] * 4
    exact = np.concatenate(alone)[:6]
    assert squeezed(stiff, soft) == pytest.approx(exact, rel=1e-5)


def set_shape(scene, modes, shape):
    """Initial velocities by a shape."""
    places = {tuple(x): v for x, v in zip(modes.positions, shape, strict=True)}
    for beam in scene.beams:
        scene.set_velocity(beam, lambda x, y: places[x, y][:2], spin=lambda x, y: places[x, y][2])


def ring(degree=2):
    """A free ring of two arcs: three rigid modes and double ones."""
    scene, half = one_bar(fb.arc((1, 0), (0, 1), (-1, 0)), square(0.05), 6, degree)
    scene.add_beam(fb.arc(half.end, (0, -1), half.start), square(0.05), 6, degree)
    return scene


@pytest.mark.parametrize("make", [lambda: simply_supported(2, 4, square(0.1)), ring])
def test_shapes_have_the_modal_mass_one_and_are_orthogonal(make):
    modes = fb.modes(make(), n=6)

    def energy(shape):
        scene = make()
        set_shape(scene, modes, shape)
        return fb.simulate(scene, dt=1e-6, t_end=1e-6).energy.kinetic[0]

    for i, one in enumerate(modes.shapes):
        assert energy(one) == pytest.approx(0.5, abs=1e-9)
        for other in modes.shapes[:i]:
            assert energy(one + other) == pytest.approx(1.0, abs=1e-9)


def test_a_shape_moves_the_axis_of_its_beam():
    scene = simply_supported(2, 4, square(0.1))
    moved = fb.modes(scene, n=1).shape(scene.beams[0], 0, size=0.1)
    assert abs(moved[:, 1]) == pytest.approx(0.1 * np.sin(np.pi * moved[:, 0]), abs=2e-4)


@pytest.mark.parametrize("elements", [1, 2])
def test_where_nodes_only_turn_no_node_is_displaced(elements):
    size = 0.1
    scene, beam = supported_bar((1, 0), FLYING, elements, held="xy")
    modes = fb.modes(scene)
    turns = abs(modes.shapes[..., :2]).max(axis=(1, 2)) < 1e-9 * abs(modes.shapes).max(axis=(1, 2))
    assert turns.sum() == 2
    for mode, only_turns in enumerate(turns):
        moved = np.hypot(*(modes.shape(beam, mode, size) - modes.positions).T).max()
        assert moved == pytest.approx(0.0 if only_turns else size, abs=1e-8)


# -- Stress ------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [-0.9, -4.5, 100.0])
def test_a_force_along_a_beam_changes_its_frequencies_as_a_strings(ratio):
    section = fb.Section(EA=1e9, GA=1e9, EI=10.0, rhoA=1.0)
    force = ratio * math.pi**2 * section.EI  # of the critical one
    scene = simply_supported(3, 8, section)
    scene.add_force(scene.beams[0].end, (force, 0))
    k = math.pi * np.arange(1, 5)
    squares = np.sort(k**4 * section.EI + k**2 * force)
    modes = fb.modes(scene, fb.static(scene), n=4)
    exact = np.sign(squares) * np.sqrt(abs(squares))
    assert modes.angular_frequencies == pytest.approx(exact, rel=3e-4 if ratio > -1 else 1e-3)
    assert modes.unstable.tolist() == (squares < 0).tolist() and not modes.rigid.any()
    assert ("unstable" in str(modes)) == (ratio < -1)


# -- Joints, springs, lumped masses ------------------------------------------------------------


def test_a_ring_in_one_piece_with_a_rigid_joint_is_the_ring_of_two_arcs():
    closed = fb.Scene()
    whole = closed.add_beam(
        lambda f: (math.cos(2 * math.pi * f), math.sin(2 * math.pi * f)), square(0.05), 12, 2
    )
    closed.add_joint(fb.Rigid(whole.start, whole.end))
    one, two = (fb.modes(scene, n=9) for scene in (closed, ring()))
    assert one.rigid.sum() == two.rigid.sum() == 3
    assert one.angular_frequencies == pytest.approx(two.angular_frequencies, rel=1e-8)


@pytest.mark.parametrize("kind", [kind for kind in BENDING if "offset" in kind])
def test_stiffness_is_the_derivative_of_the_forces_of_a_stressed_scene_with_joints(kind):
    spring = {"spring": fb.Spring(30.0, 0.2)} if "rigid" not in kind else {}
    if "slot" in kind:
        spring["hinge"] = fb.Coordinate(spring=fb.Spring(20.0))
    scene, first, second, _ = pair(kind, gravity=(0, -GRAVITY), **spring)
    scene.clamp(first.start)
    place, load = second.end, np.array([30.0, 50.0])
    scene.add_force(place, load)
    state = fb.static(scene)
    assert abs(state.q[-1]).max() > 0.3

    def end(h):
        scene.change(scene.loads[0], load + h * np.array([0.6, -0.8]))
        moved = fb.static(scene)
        return np.append(moved.displacement(place)[-1], moved.rotation(place)[-1])

    h = 0.05
    slope = (end(-2 * h) - 8 * end(-h) + 8 * end(h) - end(2 * h)) / (12 * h)
    scene.change(scene.loads[0], load)
    amplitudes = fb.frequency_response(scene, (place, (0.6, -0.8)), place, [0.0], state).values[0]
    assert abs(amplitudes - slope).max() < 1e-7 * abs(slope).max()


def dense(scene, state=None):
    """All finite angular frequencies squared by dense algebra, massless unknowns condensed."""
    A = fb.linearise(scene, state).A
    half = len(A) // 2
    return np.sort(scipy.linalg.eigvals(-A[half:, :half]).real)


def sleeves():
    """Two masts in sleeves on a rail, whose turns have no mass but move with those of the masts."""
    data = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0}
    scene, rail = clamped_bar((1, 0), fb.Section(**data), elements=4)
    for place in (0.305, 0.61):
        section = fb.Section(rhoI=0.01, **data)
        mast = scene.add_beam([(place, 0), (place + 0.2, 1)], section, elements=3)
        scene.add_joint(fb.Sleeve(rail, mast.start, spring=fb.Spring(100.0, rest=place)))
    return scene


@pytest.mark.parametrize("name", ["multibody", "massless turns", "arch", "sleeves"])
def test_frequencies_are_those_of_dense_algebra(name):
    state = None
    if name == "massless turns":
        scene = simply_supported(1, 6, fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0))
    elif name == "sleeves":
        scene = sleeves()
    elif name == "arch":
        scene, arch = supported_bar(
            fb.arc((0, 0), (1, 0.5), (2, 0)),
            FLYING,
            elements=6,
            degree=2,
            gravity=(0, -20),
            held="xy",
        )
        state = fb.static(scene)
    else:
        scene = demo(name).scene()[0]
    squares = dense(scene, state)
    modes = fb.modes(scene, state, n=len(squares) + 3)
    assert len(modes) == len(squares)  # there are no more
    # The squares are as accurate as the rounding of the largest, in both.
    rounding = 1e-15 * squares.max()
    assert modes.angular_frequencies**2 == pytest.approx(squares, rel=1e-9, abs=rounding)
    few = fb.modes(scene, state, n=3).angular_frequencies ** 2
    assert few == pytest.approx(squares[:3], rel=1e-9, abs=rounding)


# -- Refusals ----------------------------------------------------------------------------------


def test_modes_of_what_cannot_vibrate_are_refused():
    scene = simply_supported(1, 2, FLYING)
    other = fb.simulate(simply_supported(1, 3, FLYING), dt=0.1, t_end=0.1)
    assert_refused("nodes of this scene", lambda: fb.modes(scene, state=other))
    unrecorded = fb.simulate(scene, dt=0.1, t_end=0.1, record=fb.Record(motion=False))
    assert_refused("motion recorded", lambda: fb.modes(scene, state=unrecorded))
    massless = simply_supported(1, 2, fb.Section(EA=1, GA=1, EI=1))
    assert_refused("no mass", lambda: fb.modes(massless))
    modes = fb.modes(simply_supported(1, 4, SPARSE), n=2)
    assert_refused("mode 2: there are 2 modes, numbered from 0", modes.shape, "beam 1", 2, size=1.0)


def test_a_force_that_follows_the_motion_has_other_modes_than_a_bed_of_springs():
    section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0)
    free, bedded = (simply_supported(2, 4, section) for _ in range(2))
    bedded.add_virtual_work(lambda step: -3.0 * ufl.dot(step.u, step.virtual_u))
    squares = [fb.modes(scene, n=1).angular_frequencies[0] ** 2 for scene in (free, bedded)]
    assert squares[1] - squares[0] == pytest.approx(3.0, rel=1e-2)
    # Without a potential, but as small as this it changes no frequency to first order: its work
    # on an even mode is that of an odd one. Until there were complex roots, it was refused.
    bedded.add_virtual_work(lambda step: 1e-3 * ufl.dot(step.director, step.virtual_u))
    run = fb.ModalResponse(lambda x: bedded, n=1)
    assert_refused("not symmetric", lambda: run([1.0]))
    root = fb.modes(bedded, n=1).eigenvalues[0]
    A = np.linalg.eigvals(fb.linearise(bedded).A)
    assert abs(A - root).min() < 1e-6 * abs(root)
    assert abs(root) ** 2 == pytest.approx(squares[1], rel=1e-4)


def test_a_free_part_without_mass_is_refused():
    scene = simply_supported(1, 2, FLYING)
    beam = scene.add_beam([(0, 1), (1, 1)], fb.Section(EA=1, GA=1, EI=1), elements=1)
    assert_refused("without mass", lambda: fb.modes(scene))
    # Added virtual works might hold it, which only the numbers tell.
    scene.add_virtual_work(lambda step: -3.0 * step.virtual_u[0] * step.u[0], beam)
    assert_refused("moves freely and has no mass", lambda: fb.modes(scene))


def test_a_state_that_has_relaxed_keeps_its_internal_variables():
    def energy(eps, gamma, kappa, a):
        stretched = 1e4 * eps**2 + 4e3 * gamma**2
        return stretched + 2.0 * kappa**2 + 1.0 * (kappa - a[0]) ** 2

    def relax(old, strains0, strains, dt):
        return [(old[0] + 2 * dt * strains[2]) / (1 + 2 * dt)]

    variables = fb.InternalVariables(("dashpot",), relax)
    section = fb.Section(strain_energy=energy, internal=variables, rhoA=1.0)
    scene, arm = clamped_bar((1, 0), section, elements=4)
    scene.add_moment(arm.end, 0.9)
    state = fb.static(scene, load_steps=4)
    assert state.internal(arm, "dashpot")[-1].min() > 0.05
    elastic = fb.Scene()
    elastic.clamp(elastic.add_beam([(0, 0), (1, 0)], SPARSE, elements=4).start)
    with pytest.raises(fb.SceneError, match="modes: the solution has other internal variables"):
        fb.modes(scene, fb.static(elastic))
    # The forces about which modes are found are in equilibrium, or they would be refused.
    assert len(fb.modes(scene, state, n=2)) == 2


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 10])
def test_about_a_state_on_a_yield_surface_nothing_flows(steps):
    """There round-off would choose between two stiffnesses, 50 and 4.5."""

    def energy(stretch, a):
        return 25.0 * (stretch - a[0]) ** 2 + 2.5 * a[0] ** 2

    def flow(old, before, now, dt):
        trial = 50.0 * (now[0] - old[0]) - 5.0 * old[0]
        return [old[0] + ufl.sign(trial) * ufl.max_value(abs(trial) - 0.4, 0) / 55.0]

    mass, f = 2.0, 0.3
    scene, body = held_body((1, 0), mass, 1.0, "y", "rotation")
    spring = fb.Spring(rest=1.0, strain_energy=energy, internal=fb.InternalVariables(("a",), flow))
    scene.add_force_between(body, (0, 0), spring=spring)
    scene.add_force(body, (3.3, 0.0))
    state = fb.static(scene, load_steps=steps)
    assert fb.modes(scene, state).angular_frequencies == pytest.approx([5.0], rel=1e-9)
    response = fb.frequency_response(scene, (body, (1.0, 0.0)), body, [f], state)
    stiffness = 50.0 - (2 * math.pi * f) ** 2 * mass
    assert response.component("x") == pytest.approx(1 / stiffness, rel=1e-9)


def test_a_state_that_is_unstable_in_what_has_no_mass_is_refused():
    section = fb.Section(EA=1e6, GA=1e6, EI=10.0)
    scene = simply_supported(2, 8, section)
    scene.add_mass(scene.beams[0].node(0.5), 1.0)  # stands still while the halves buckle
    scene.add_force(scene.beams[0].end, (-4.5 * math.pi**2 * section.EI, 0))
    assert_refused("unstable in a motion without mass", lambda: fb.modes(scene, fb.static(scene)))


def test_without_damping_a_damped_scene_has_the_modes_of_the_undamped_one():
    plain, dragged = (simply_supported(2, 4, square(0.1)) for _ in range(2))
    dragged.add_virtual_work(lambda step: -50.0 * ufl.dot(step.v, step.virtual_u))
    one, two = fb.modes(plain, n=3), fb.modes(dragged, n=3, damping=False)
    assert two.angular_frequencies == pytest.approx(one.angular_frequencies, rel=1e-9)
    assert not two.damping_ratios.any() and two.shapes.dtype == float
    assert one.eigenvalues == pytest.approx(1j * one.angular_frequencies)


@pytest.mark.parametrize("rest", [1.0, 0.5])
def test_a_reference_in_which_springs_are_strained_is_told(rest, caplog):
    scene = simply_supported(1, 4, square(0.1))
    scene.add_force_between(scene.beams[0].node(0.5), (0.5, 1), spring=fb.Spring(5.0, rest=rest))
    fb.modes(scene, fb.static(scene))
    assert "no equilibrium" not in caplog.text
    fb.modes(scene)
    assert ("modes: the reference is no equilibrium" in caplog.text) == (rest == 0.5)


def test_a_state_that_another_joint_holds_tells_of_the_unstable_pendulum():
    """A bead on a spring along an upright arm, which a slot holds at its top in the state."""

    def build(held):
        scene = fb.Scene(gravity=(0, -10))
        arm = scene.add_body((0, 0.5), 1.0, 0.1, points={"low": (0, 0), "top": (0, 1)})
        bead = scene.add_body((0, 0.4), mass=2.0, inertia=0.05)
        if held:  # the joints behind it have other numbers
            scene.add_joint(fb.PinInSlot(fb.GROUND, arm["top"], axis=(0, 1)))
        scene.add_joint(fb.Revolute(fb.GROUND, arm["low"]))
        spring = fb.Spring(100.0, rest=0.3)
        scene.add_joint(fb.Prismatic(arm.centre, bead.centre, axis=(0, 1), spring=spring))
        return scene

    state = fb.static(build(held=True), load_steps=2)
    place = 0.5 + 0.3 - 2 * 10 / 100  # of the bead, from the hinge
    growth = np.sqrt(10 * (0.5 + 2 * place) / (0.1 + 0.25 + 0.05 + 2 * place**2))
    modes = fb.modes(build(held=False), state, n=2)
    assert modes.eigenvalues == pytest.approx([growth, np.sqrt(100 / 2) * 1j], rel=1e-6)


def test_a_node_on_a_bent_beam_is_where_it_slid_though_its_joint_has_another_number():
    def build(held):
        section = fb.Section(EA=1e3, GA=1e3, EI=0.5, rhoA=1.0, rhoI=1e-2)
        scene, beam = clamped_bar((1, 0), section, elements=6, degree=2)
        hook, bead = (scene.add_body((x, 0), mass=0.5, inertia=0.1).centre for x in (3, 0.1))
        scene.fix(bead, "rotation")
        if held:
            scene.add_joint(fb.Rigid(fb.GROUND, hook))
        else:
            scene.clamp(hook)
        scene.add_joint(fb.Slider(beam, bead, spring=fb.Spring(200.0, rest=0.9)))
        scene.add_moment(beam.end, 1.0)
        return scene, fb.static(scene, load_steps=6)

    (scene, state), (_, other_state) = build(held=False), build(held=True)
    expected = fb.modes(scene, state, n=3).angular_frequencies
    computed = fb.modes(scene, other_state, n=3).angular_frequencies
    assert computed == pytest.approx(expected, rel=1e-9)


# -- A shaken ground ------------------------------------------------------------------------------


def storeys(arm=0.0):
    """Two storeys of 2 and 3 kg on springs of 100 and 50 N/m, the second on an arm of its body."""
    scene = fb.Scene()
    first = scene.add_body((0, 0), 2.0, 1.0).centre
    body = scene.add_body((1, arm), 3.0, 1.0, points={"foot": (1, 0)} if arm else None)
    second = body["foot"] if arm else body.centre
    for node in (first, body.centre):
        scene.fix(node, "y", "rotation")
    scene.add_spring(first, x=fb.Spring(100.0))
    scene.add_force_between(first, second, spring=fb.Spring(50.0, rest=1.0))
    return scene


@pytest.mark.parametrize("arm", [0.0, 0.5])
def test_participation_factors_are_those_of_a_model_of_two_masses(arm):
    K, M = np.array([[150.0, -50.0], [-50.0, 50.0]]), np.diag([2.0, 3.0])
    _, vectors = scipy.linalg.eigh(K, M)
    factors = vectors.T @ M @ [1, 1]
    shaken = fb.modes(storeys(arm), n=2).participation((1, 0))
    assert shaken.effective_masses == pytest.approx(factors**2, rel=1e-9)
    assert shaken.total == pytest.approx(5.0)
    copied = pickle.loads(pickle.dumps(fb.modes(storeys(arm), n=2))).participation((1, 0))
    assert copied.effective_masses == pytest.approx(factors**2, rel=1e-9)
    across = fb.modes(storeys(arm), n=2).participation((0, 1))
    assert abs(across.factors).max() < 1e-9


def test_all_modes_together_have_the_whole_effective_mass_in_any_direction():
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
    post = scene.add_beam([(0, 0), (0, 1)], section, elements=4, degree=2)
    beam = scene.add_beam([post.end, (1, 1)], section, elements=4, degree=2)
    scene.clamp(post.start)
    joint = scene.add_beam([(1, 1), (1, 0)], section, elements=4, degree=2)
    scene.add_joint(fb.Revolute(beam.end, joint.start))
    scene.add_mass(joint.end, 2.0, 0.1)
    modes = fb.modes(scene, n=200)
    for direction in (1, 0), (0, 3), (1, -2):
        shaken = modes.participation(direction)
        assert shaken.effective_masses.sum() == pytest.approx(shaken.total, rel=1e-9)
        assert shaken.shares.sum() == pytest.approx(1.0, rel=1e-9)


def test_a_ground_without_direction_and_modes_without_mass_are_refused():
    modes = fb.modes(storeys(), n=1)
    assert_refused("direction.*not zero", modes.participation, (0, 0))
    scene = storeys()
    scene.add_spring(scene.nodes[0], x=fb.Damper(3.0))
    assert_refused("undamped ones", fb.modes(scene, n=1).participation, (1, 0))


@pytest.mark.parametrize("n", [1, 4, 10])
def test_frequencies_that_are_all_near_each_other_are_those_of_a_chain(n):
    # Of x alone: equal bodies on springs to the ground, and between neighbours.
    count, ground, between, mass = 4000, 1e3, 10.0, 2.0
    scene, last = fb.Scene(), None
    for k in range(count):
        body = scene.add_body((float(k), 0.0), mass, 0.1).centre
        scene.fix(body, "y", "rotation")
        scene.add_spring(body, x=fb.Spring(ground))
        if last is not None:
            scene.add_force_between(last, body, spring=fb.Spring(between, rest=1.0))
        last = body
    waves = 4 * between * np.sin(np.pi * np.arange(n) / (2 * count)) ** 2
    expected = np.sqrt((ground + waves) / mass)
    assert fb.modes(scene, n=n).angular_frequencies == pytest.approx(expected, rel=1e-12)
