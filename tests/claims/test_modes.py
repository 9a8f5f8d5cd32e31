"""Natural frequencies against exact ones, against dense algebra and against the motion itself."""

import math

import ufl

import numpy as np
import pytest
import scipy.linalg
from jointed import KINDS, pair
from scenes import FLYING, demo, lattice

import fx_beam as fb
from fx_beam.algebra.sparse_lu import CompiledLU
from fx_beam.analyses.linearisation import linearised
from fx_beam.fem.step_start import StepStart
from fx_beam.mechanics.interval import Interval
from fx_beam.model.model import Model

DEGREES = pytest.mark.parametrize("degree", [1, 2, 3])
GRAVITY = 9.81


def square(height):
    """Square section of unit modulus, so stiff along its axis that only bending is low."""
    A, J = height**2, height**4 / 12
    return fb.Section(EA=1e3 * A, GA=5 / 6 * A / 2.6, EI=J, rhoA=A, rhoI=J)


def simply_supported(degree, elements, section):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    return scene


def timoshenko(section, n):
    """Lowest angular frequencies of a simply supported beam of length 1 with rotary inertia.

    For w = W sin(k x), psi = P cos(k x) with k = m pi: the two roots of the quadratic in omega^2
    for each m, and sqrt(GA/rhoI) for m = 0.
    """
    s, found = section, [math.sqrt(section.GA / section.rhoI)]
    for k in math.pi * np.arange(1, n + 1):
        linear = s.rhoA * (s.EI * k**2 + s.GA) + s.GA * k**2 * s.rhoI
        found += list(np.sqrt(np.roots([s.rhoA * s.rhoI, -linear, s.GA * s.EI * k**4])))
    return np.sort(found)[:n]


# -- Straight beams ----------------------------------------------------------------------------


@DEGREES
@pytest.mark.parametrize("height", [0.2, 0.01], ids=["stout", "slender"])
def test_five_frequencies_of_a_supported_beam_converge_to_the_exact_ones(height, degree):
    section = square(height)
    exact = timoshenko(section, 5)
    slender = (math.pi * np.arange(1, 6)) ** 2 * math.sqrt(section.EI / section.rhoA)
    shear = 1 - exact / slender
    assert (shear > 0.25).any() if height == 0.2 else (shear < 5e-3).all()
    counts = {1: (16, 32), 2: (8, 16), 3: (6, 12)}[degree]
    errors = [fb.modes(simply_supported(degree, n, section), n=5) for n in counts]
    errors = np.array([found.angular_frequencies / exact - 1 for found in errors])
    order = np.log2(errors[0] / errors[1])
    # Two for each degree; the first frequency stands for all once it is near its rounding.
    assert order[0] == pytest.approx(2 * degree, abs=0.1)
    assert (order > 2 * degree - 0.5).all()
    assert (errors[1] < {1: 0.14, 2: 2e-3, 3: 2e-4}[degree]).all()


@DEGREES
def test_a_slender_supported_beam_has_the_frequencies_of_euler_and_bernoulli(degree):
    section = square(1e-3)
    exact = (math.pi * np.arange(1, 6)) ** 2 * math.sqrt(section.EI / section.rhoA)
    counts = {1: 128, 2: 32, 3: 16}[degree]
    found = fb.modes(simply_supported(degree, counts, section), n=5).angular_frequencies
    assert found == pytest.approx(exact, rel={1: 1e-2, 2: 2e-4, 3: 6e-5}[degree])
    assert found[0] == pytest.approx(exact[0], rel={1: 1e-4, 2: 3e-6, 3: 3e-6}[degree])


@pytest.mark.parametrize("points", [[(0, 0), (0.6, 0.8)], fb.arc((0, 0), (1, 0.1), (1, 1))])
@pytest.mark.parametrize("height", [0.1, 1e-3])
@DEGREES
def test_a_free_beam_has_three_rigid_modes(points, height, degree):
    scene = fb.Scene(gravity=(0, -10))
    scene.add_beam(points, square(height), elements=6, degree=degree)
    found = fb.modes(scene, n=5)
    assert found.rigid.tolist() == [True] * 3 + [False] * 2
    assert (found.angular_frequencies[:3] == 0).all() and (found.frequencies[3:] > 0).all()
    # Rounding mixes in some of the first bending mode, the more the softer that is.
    close = 1e-7 if height > 0.01 else 1e-3
    for shape in found.shapes[:3]:
        # A turn about one point, or none.
        spin = shape[:, 2]
        assert spin == pytest.approx(spin[0], abs=close * abs(shape).max())
        x, y = (found.positions - found.positions[0]).T
        expected = shape[0, :2] + spin[0] * np.column_stack([-y, x])
        assert abs(shape[:, :2] - expected).max() < close * abs(shape).max()
    assert str(found).splitlines()[0] == "mode 0: 0 Hz rigid"


# -- Rigid modes, copies and slender members -----------------------------------------------------

SLENDERNESS = pytest.mark.parametrize("height", [0.1, 1e-3, 1e-5])
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


def side_by_side(count, section, elements, degree=1, clamped=True):
    scene = fb.Scene()
    for y in range(count):
        beam = scene.add_beam([(0, y), (1, y)], section, elements=elements, degree=degree)
        if clamped:
            scene.clamp(beam.start)
    return scene


@SLENDERNESS
@DEGREES
@pytest.mark.parametrize(
    ("links", "elements"), [(1, 1), (1, 2), (1, 8), (1, 32), (1, 128), (3, 1), (3, 8)]
)
def test_free_links_have_as_many_rigid_modes_as_they_can_move(links, elements, degree, height):
    scene = chain(links, height, elements, degree)
    mobility = 2 + links
    for n in (1, mobility, 6, 13):
        found = fb.modes(scene, n=n)
        assert found.rigid.sum() == min(n, mobility)
        assert found.rigid[: min(n, mobility)].all() and not found.unstable.any()


@SLENDERNESS
@pytest.mark.parametrize("count", [2, 15])
def test_free_bodies_have_three_rigid_modes_each(count, height):
    scene = side_by_side(count, steel(height), 1, clamped=False)
    for n in (3 * count - 1, 3 * count, 3 * count + 1):
        assert fb.modes(scene, n=n).rigid.sum() == min(n, 3 * count)


@pytest.mark.parametrize("count", [6, 12, 25])
def test_no_copy_of_a_multiple_frequency_is_missed(count):
    one = fb.modes(side_by_side(1, SPARSE, 6, degree=2), n=3).angular_frequencies
    scene = side_by_side(count, SPARSE, 6, degree=2)
    for n in (1, count - 1, count, count + 2, 2 * count + 1):
        exact = np.repeat(one, count)[:n]
        assert fb.modes(scene, n=n).angular_frequencies == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize("count", [5, 30])
@pytest.mark.parametrize("elements", [1, 2, 4])
def test_all_modes_of_many_equal_beams_with_massless_turns_are_found(elements, count):
    one = fb.modes(side_by_side(1, SPARSE, elements), n=100).angular_frequencies
    assert len(one) == 2 * elements
    scene = side_by_side(count, SPARSE, elements)
    found = fb.modes(scene, n=len(one) * count + 1).angular_frequencies
    assert found == pytest.approx(np.repeat(one, count), rel=1e-8)


@pytest.mark.parametrize(("elements", "degree"), [(1, 3), (2, 1), (2, 2), (8, 1), (8, 2), (8, 3)])
@pytest.mark.parametrize("n", [5, 9, 14])
def test_bending_frequencies_of_a_free_beam_are_as_its_height_however_small(elements, degree, n):
    # Shear takes a share of height^2; axial frequencies, among the n or not, are 1e5 higher.
    stout, slender = (
        fb.modes(chain(1, height, elements, degree), n=n).angular_frequencies[3:] / height
        for height in (1e-4, 1e-5)
    )
    bending = stout * 1e-4 < 1e3
    assert bending.any()
    assert slender[bending] == pytest.approx(stout[bending], rel=2e-5)


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


@pytest.mark.parametrize("free", [False, True], ids=["supported", "free ring"])
def test_shapes_have_the_modal_mass_one_and_are_orthogonal(free):
    scene = simply_supported(2, 4, square(0.1))
    if free:  # three rigid modes and double ones
        scene = fb.Scene()
        half = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), square(0.02), elements=6, degree=2)
        scene.add_beam(fb.arc(half.end, (0, -1), half.start), square(0.02), elements=6, degree=2)
    found = fb.modes(scene, n=8)
    model = Model(scene, fb.Newmark())
    vectors = np.array([model.from_nodes(shape) for shape in found.shapes])
    assert vectors @ model.mass @ vectors.T == pytest.approx(np.eye(8), abs=1e-9)
    stiffness = found.angular_frequencies**2
    forms = model.forms
    forms.begin(Interval(0.0, 1.0), StepStart(*(np.zeros(model.size) for _ in range(3))))
    forms.internal_force(np.zeros(model.size))
    forms.assemble_stiffness()
    energies = vectors @ forms.stiffness @ vectors.T
    assert energies == pytest.approx(np.diag(stiffness), abs=1e-6 * stiffness.max())


def test_a_shape_moves_the_axis_of_its_beam():
    scene = simply_supported(2, 4, square(0.1))
    moved = fb.modes(scene, n=1).shape(scene.beams[0], 0, size=0.1)
    assert abs(moved[:, 1]) == pytest.approx(0.1 * np.sin(np.pi * moved[:, 0]), abs=2e-4)


def test_a_beam_vibrates_with_its_frequency():
    scene = simply_supported(2, 4, square(0.05))
    beam = scene.beams[0]
    found = fb.modes(scene, n=2)
    period, shape = 1 / found.frequencies[1], found.shapes[1]
    places = {tuple(x): rates for x, rates in zip(found.positions, shape, strict=True)}
    scene.set_velocity(
        beam,
        lambda x, y: 1e-6 * places[x, y][:2],
        spin=lambda x, y: 1e-6 * places[x, y][2],
    )
    solution = fb.simulate(scene, dt=period / 200, t_end=period)
    quarter = solution.displacement(beam.node(0.25))[:, 1]
    exact = np.sin(2 * np.pi * solution.t / period)
    assert quarter == pytest.approx(quarter[50] * exact, abs=2e-3 * abs(quarter).max())


# -- Stress ------------------------------------------------------------------------------------


@DEGREES
@pytest.mark.parametrize("ratio", [-0.9, 0.5, 100.0])
def test_a_force_along_a_beam_changes_its_frequencies_as_a_strings(degree, ratio):
    section = fb.Section(EA=1e9, GA=1e9, EI=10.0, rhoA=1.0)
    force = ratio * math.pi**2 * section.EI  # of the critical one
    scene = simply_supported(degree, {1: 48, 2: 12, 3: 6}[degree], section)
    scene.add_force(scene.beams[0].end, (force, 0))
    k = math.pi * np.arange(1, 4)
    exact = np.sqrt(k**4 * section.EI + k**2 * force)
    found = fb.modes(scene, fb.static(scene), n=3)
    assert found.angular_frequencies == pytest.approx(
        exact, rel={1: 2e-2, 2: 6e-3, 3: 3e-4}[degree]
    )
    assert not found.rigid.any()


def test_a_beam_beyond_its_critical_load_is_reported_unstable():
    section = fb.Section(EA=1e9, GA=1e9, EI=10.0, rhoA=1.0)
    scene = simply_supported(3, 8, section)
    force = -4.5 * math.pi**2 * section.EI
    scene.add_force(scene.beams[0].end, (force, 0))
    found = fb.modes(scene, fb.static(scene), n=4)
    k = math.pi * np.arange(1, 5)
    squares = np.sort(k**4 * section.EI + k**2 * force)
    exact = np.sign(squares) * np.sqrt(abs(squares))
    assert found.angular_frequencies == pytest.approx(exact, rel=1e-3)
    assert found.unstable.tolist() == [True, True, False, False]
    assert "unstable" in str(found)


def test_the_two_small_frequencies_of_a_stiff_double_pendulum_are_those_of_the_rigid_one():
    def pendulum(EA, held=False):
        section = fb.Section(EA=EA, GA=EA, EI=EA)
        scene = fb.Scene(gravity=(0, -GRAVITY))
        upper = scene.add_beam([(0, 0), (0, -1)], section, elements=2)
        lower = scene.add_beam([(0, -1), (0, -2)], section, elements=2)
        # Held by a clamp and a rigid joint it hangs as it does on hinges.
        (scene.clamp if held else scene.pin)(upper.start)
        scene.add_joint((fb.Rigid if held else fb.Revolute)(upper.end, lower.start))
        scene.add_mass(upper.end, 3.0)
        scene.add_mass(lower.end, 3.0)
        return scene

    exact = np.sqrt(GRAVITY * (2 + np.array([-1, 1]) * math.sqrt(2)))
    errors = []
    for EA in (1e5, 1e7):
        found = fb.modes(pendulum(EA), fb.static(pendulum(EA, held=True)), n=4)
        assert not found.rigid.any() and found.angular_frequencies[2] > 100
        errors.append(abs(found.angular_frequencies[:2] / exact - 1).max())
    assert errors[0] < 1e-3
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)  # the stretch of the rods
    # Without the force of gravity in the rods nothing turns them back.
    assert fb.modes(pendulum(1e7), n=4).rigid.tolist() == [True, True, False, False]


def test_an_arch_is_unstable_in_one_more_mode_behind_a_limit_point():
    section = fb.Section(EA=2e5, GA=1e5, EI=lambda s: 10 + 40 * (s - 0.5) ** 2, rhoA=1.0, rhoI=1e-3)
    scene = fb.Scene()
    arch = scene.add_beam(fb.arc((-1, 0), (0, 0.1), (1, 0)), section, elements=12, degree=2)
    scene.pin(arch.start)
    scene.pin(arch.end)
    scene.add_force(arch.node(0.5), (0, -600.0))

    def after(steps):
        return fb.static(scene, continuation="arc-length", max_steps=steps)

    limit = after(9).stats.limit_points[0]
    stable, near, behind = after(2), after(5), after(9)
    assert 0.95 * limit < near.load_factor[-1] < limit > behind.load_factor[-1]
    found = [fb.modes(scene, state, n=3) for state in (stable, near, behind)]
    # Sideways it buckles first, off the symmetric path that is followed here.
    assert [int(modes.unstable.sum()) for modes in found] == [0, 1, 2]
    start = fb.modes(scene, n=3).angular_frequencies
    assert (found[0].angular_frequencies[:2] < start[:2]).all()
    # The mode that vanishes at the limit point is nearly gone before it.
    assert found[1].angular_frequencies[1] < 0.2 * start[1]


# -- Joints, springs, lumped masses ------------------------------------------------------------


def test_springs_on_joints_and_lumped_masses_give_the_oscillator_of_the_textbook():
    section = fb.Section(EA=1e9, GA=1e9, EI=1e9)
    scene = fb.Scene()
    rod = scene.add_beam([(0, 0), (2, 0)], section)
    scene.add_joint(
        fb.Revolute(fb.GROUND, rod.start, spring=fb.Spring(50.0), damper=fb.Damper(3.0))
    )
    scene.add_mass(rod.end, 0.5)
    slider = scene.add_beam([(0, 1), (1, 1)], section)
    scene.add_joint(fb.Prismatic(fb.GROUND, slider.start, axis=(1, 0), spring=fb.Spring(72.0)))
    scene.add_mass(slider.start, 2.0)
    found = fb.modes(scene, n=2)
    # sqrt(50/(0.5 2^2)) and sqrt(72/2); 3/(2 sqrt(50 2)) of the damper.
    assert found.angular_frequencies == pytest.approx([5.0, 6.0], rel=1e-6)
    assert found.damping_ratios == pytest.approx([0.15, 0.0], rel=1e-6, abs=1e-12)


def test_a_ring_in_one_piece_with_a_rigid_joint_is_the_ring_of_two_arcs():
    section = square(0.05)
    closed, halves = fb.Scene(), fb.Scene()
    whole = closed.add_beam(
        lambda f: (math.cos(2 * math.pi * f), math.sin(2 * math.pi * f)), section, 12, degree=2
    )
    closed.add_joint(fb.Rigid(whole.start, whole.end))
    upper = halves.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), section, 6, degree=2)
    halves.add_beam(fb.arc(upper.end, (0, -1), upper.start), section, 6, degree=2)
    one, two = (fb.modes(scene, n=9) for scene in (closed, halves))
    assert one.rigid.sum() == two.rigid.sum() == 3
    assert one.angular_frequencies == pytest.approx(two.angular_frequencies, rel=1e-8)


def test_a_prescribed_node_is_held():
    section = square(0.1)
    moved, held = fb.Scene(), fb.Scene()
    for scene in (moved, held):
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4, degree=2)
        if scene is held:
            scene.clamp(beam.start)
        else:
            scene.fix(beam.start, "x", "rotation")
            scene.prescribe(beam.start, y=lambda t: math.sin(t))
    found = [fb.modes(scene, n=4).angular_frequencies for scene in (moved, held)]
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_stiffness_is_the_derivative_of_the_forces_of_a_stressed_scene_with_joints(kind):
    spring = {"spring": fb.Spring(30.0, 0.2)} if "rigid" not in kind else {}
    scene, first, second, _ = pair(kind, degree=2, gravity=(0, -GRAVITY), **spring)
    scene.pin(first.start)
    scene.add_force(second.end, (30.0, 50.0))
    state = fb.simulate(scene, dt=0.02, t_end=0.5)
    assert abs(state.q[-1]).max() > 0.3
    about = linearised(scene, state, "test")
    model, K = about.model, about.K
    force = model.loads.at(0.5) + model.weight

    def gradient(y):
        D = model.reduction.expand(y, np.empty(0))
        r = model.forms.internal_force(D) - force
        return model.reduction.project(r)[: model.reduction.free].copy()

    h = 1e-5
    columns = [
        (gradient(-2 * e) - 8 * gradient(-e) + 8 * gradient(e) - gradient(2 * e)) / (12 * h)
        for e in h * np.eye(model.reduction.free)
    ]
    assert abs(K - np.array(columns)).max() < 1e-7 * abs(K).max()


def dense(scene, state=None):
    """All finite angular frequencies squared by dense algebra, massless unknowns condensed."""
    about = linearised(scene, state, "test")
    K, M = about.K.toarray(), about.M.toarray()
    has = M.diagonal() > 0
    K = K[np.ix_(has, has)] - K[np.ix_(has, ~has)] @ np.linalg.solve(
        K[np.ix_(~has, ~has)], K[np.ix_(~has, has)]
    )
    return scipy.linalg.eigvalsh(K, M[np.ix_(has, has)])


@pytest.mark.parametrize("name", ["multibody", "three_bar_swing", "massless turns", "arch"])
def test_frequencies_are_those_of_dense_algebra(name):
    state = None
    if name == "massless turns":
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0)
        scene = simply_supported(1, 6, section)
    elif name == "arch":
        scene = fb.Scene(gravity=(0, -20))
        arch = scene.add_beam(fb.arc((0, 0), (1, 0.5), (2, 0)), FLYING, elements=6, degree=2)
        scene.pin(arch.start)
        scene.pin(arch.end)
        state = fb.static(scene)
    else:
        made = demo(name).scene()
        scene = made if isinstance(made, fb.Scene) else made[0]
    squares = dense(scene, state)
    found = fb.modes(scene, state, n=len(squares) + 3)
    assert len(found) == len(squares)  # there are no more
    # The squares are as accurate as the rounding of the largest, in both.
    rounding = 1e-15 * squares.max()
    assert found.angular_frequencies**2 == pytest.approx(squares, rel=1e-9, abs=rounding)
    few = fb.modes(scene, state, n=3).angular_frequencies ** 2
    assert few == pytest.approx(squares[:3], rel=1e-9, abs=rounding)


# -- Refusals ----------------------------------------------------------------------------------


def test_slepc_finds_the_same_modes_of_a_frame():
    PETSc = pytest.importorskip("petsc4py.PETSc")
    SLEPc = pytest.importorskip("slepc4py.SLEPc")
    scene = lattice(8)
    about = linearised(scene, None, "modes")
    K, M = (
        PETSc.Mat().createAIJ(A.shape, csr=(A.indptr, A.indices, A.data), comm=PETSc.COMM_SELF)
        for A in (about.K + 0 * about.M, about.M + 0 * about.K)
    )
    solver = SLEPc.EPS().create(PETSc.COMM_SELF)
    solver.setOperators(K, M)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setDimensions(12)
    solver.setTarget(-1.0)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.getST().setType(SLEPc.ST.Type.SINVERT)
    solver.solve()
    squares = [solver.getEigenvalue(k).real for k in range(12)]
    found = fb.modes(scene, n=12).angular_frequencies
    assert found**2 == pytest.approx(squares, rel=1e-8)


def test_modes_of_what_cannot_vibrate_are_refused():
    scene = simply_supported(1, 2, FLYING)
    with pytest.raises(fb.SceneError, match="fx_beam.Scene"):
        fb.modes(scene.beams[0])
    with pytest.raises(fb.SceneError, match="n = 0 must be"):
        fb.modes(scene, n=0)
    with pytest.raises(fb.SceneError, match="n = True must be"):
        fb.modes(scene, n=True)
    with pytest.raises(fb.SceneError, match="must be a solution"):
        fb.modes(scene, state=3)
    other = fb.simulate(simply_supported(1, 3, FLYING), dt=0.1, t_end=0.1)
    with pytest.raises(fb.SceneError, match="nodes of this scene"):
        fb.modes(scene, state=other)
    unrecorded = fb.simulate(scene, dt=0.1, t_end=0.1, record=fb.Record(motion=False))
    with pytest.raises(fb.SceneError, match="motion recorded"):
        fb.modes(scene, state=unrecorded)
    massless = simply_supported(1, 2, fb.Section(EA=1, GA=1, EI=1))
    with pytest.raises(fb.SceneError, match="no mass"):
        fb.modes(massless)


def test_a_shape_of_a_beam_or_a_mode_that_is_not_there_is_refused():
    found = fb.modes(simply_supported(1, 4, SPARSE), n=2)
    with pytest.raises(fb.SceneError, match="'nope' is not a beam of these modes; they have"):
        found.shape("nope", 0, size=1.0)
    with pytest.raises(fb.SceneError, match="mode 2: there are 2 modes, numbered from 0"):
        found.shape("beam 1", 2, size=1.0)


def test_a_failure_says_what_to_try(monkeypatch):
    monkeypatch.setattr(CompiledLU, "solve", lambda self, b: np.full(len(b), np.nan))
    with pytest.raises(RuntimeError, match="no mode was found. Try fewer modes"):
        fb.modes(simply_supported(1, 4, SPARSE), n=1)


def test_a_force_that_follows_the_motion_is_refused_and_a_bed_of_springs_is_not():
    section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0)
    free, bedded = (simply_supported(2, 4, section) for _ in range(2))
    bedded.add_virtual_work(lambda step: -3.0 * ufl.dot(step.u, step.virtual_u))
    squares = [fb.modes(scene, n=1).angular_frequencies[0] ** 2 for scene in (free, bedded)]
    assert squares[1] - squares[0] == pytest.approx(3.0, rel=1e-2)
    bedded.add_virtual_work(lambda step: ufl.dot(step.director, step.virtual_u))
    with pytest.raises(fb.SceneError, match="not symmetric"):
        fb.modes(bedded)


def test_a_free_part_without_mass_is_refused():
    scene = simply_supported(1, 2, FLYING)
    beam = scene.add_beam([(0, 1), (1, 1)], fb.Section(EA=1, GA=1, EI=1))
    with pytest.raises(fb.SceneError, match="without mass"):
        fb.modes(scene)
    # Added virtual works might hold it, which only the numbers tell.
    scene.add_virtual_work(lambda step: -3.0 * step.virtual_u[0] * step.u[0], beam)
    with pytest.raises(fb.SceneError, match="moves freely and has no mass"):
        fb.modes(scene)


def test_a_state_that_has_relaxed_keeps_its_internal_variables():
    def energy(eps, gamma, kappa, a):
        stretched = 1e4 * eps**2 + 4e3 * gamma**2
        return stretched + 2.0 * kappa**2 + 1.0 * (kappa - a[0]) ** 2

    def relax(old, strains0, strains, dt):
        return [(old[0] + 2 * dt * strains[2]) / (1 + 2 * dt)]

    variables = fb.InternalVariables(("dashpot",), relax)
    section = fb.Section(strain_energy=energy, internal=variables, rhoA=1.0)
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    scene.clamp(arm.start)
    scene.add_moment(arm.end, 0.9)
    state = fb.static(scene, steps=4)
    assert state.internal(arm, "dashpot")[-1].min() > 0.05
    elastic = fb.Scene()
    elastic.clamp(elastic.add_beam([(0, 0), (1, 0)], SPARSE, elements=4).start)
    with pytest.raises(fb.SceneError, match="modes: the state has other internal variables"):
        fb.modes(scene, fb.static(elastic))
    model = linearised(scene, state, "test").model
    # The forces about which modes are found are in equilibrium.
    r = model.forms.internal_force(np.zeros(model.size)) - model.loads.at(0.0)
    assert abs(model.reduction.project(r)[: model.reduction.free]).max() < 1e-9


def test_gravity_has_no_part_in_the_modes_of_an_unloaded_start():
    found = []
    for gravity in (None, (0, -GRAVITY)):
        scene, *_ = pair("pin in slot with offset", degree=2, gravity=gravity)
        found.append(fb.modes(scene, n=8))
    assert (found[0].angular_frequencies == found[1].angular_frequencies).all()
    assert found[0].rigid.tolist() == [True] * 5 + [False] * 3


def test_a_state_that_is_unstable_in_what_has_no_mass_is_refused():
    section = fb.Section(EA=1e6, GA=1e6, EI=10.0)
    scene = simply_supported(2, 8, section)
    scene.add_mass(scene.beams[0].node(0.5), 1.0)  # stands still while the halves buckle
    scene.add_force(scene.beams[0].end, (-4.5 * math.pi**2 * section.EI, 0))
    with pytest.raises(fb.SceneError, match="unstable in a motion without mass"):
        fb.modes(scene, fb.static(scene))


def test_without_damping_a_damped_scene_has_the_modes_of_the_undamped_one():
    plain, dragged = (simply_supported(2, 4, square(0.1)) for _ in range(2))
    dragged.add_virtual_work(lambda step: -50.0 * ufl.dot(step.v, step.virtual_u))
    one, two = fb.modes(plain, n=3), fb.modes(dragged, n=3, damping=False)
    assert two.angular_frequencies == pytest.approx(one.angular_frequencies, rel=1e-9)
    assert not two.damping_ratios.any() and two.shapes.dtype == float
    assert one.eigenvalues == pytest.approx(1j * one.angular_frequencies)
