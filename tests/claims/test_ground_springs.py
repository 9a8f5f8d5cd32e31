"""Springs, dampers and stops to the ground, and beds, against closed forms."""

import tracemalloc

import ufl

import numpy as np
import pytest
from scenes import assert_refused, pinned_bar
from scipy.integrate import solve_bvp

import fx_beam as fb

SECTION = fb.Section(EA=1e7, GA=1e11, EI=100.0, rhoA=2.0, rhoI=1e-3)


def held_body(axis=(1, 0), **laws):
    scene = fb.Scene()
    body = scene.add_body((1, 2), mass=2.0, inertia=0.5).centre
    return scene, body, scene.add_spring(body, axis=axis, **laws)


def test_a_body_on_three_springs_vibrates_with_the_root_of_stiffness_by_mass():
    springs = {"x": fb.Spring(50.0), "y": fb.Spring(200.0), "rotation": fb.Spring(8.0)}
    scene, *_ = held_body(axis=(3, 4), **springs)
    modes = fb.modes(scene)
    assert 2 * np.pi * modes.frequencies == pytest.approx([4.0, 5.0, 10.0], rel=1e-12)


def test_forces_in_statics_are_those_of_the_loads_along_the_axis():
    springs = {"x": fb.Spring(50.0), "y": fb.Spring(200.0, rest=0.1), "rotation": fb.Spring(8.0)}
    scene, body, held = held_body(axis=(3, 4), **springs)
    scene.add_force(body, (10.0, -5.0))
    scene.add_moment(body, 0.4)
    rest = fb.static(scene, load_steps=1)
    along, left = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    for spring, force in zip(held, (along @ (10, -5), left @ (10, -5), 0.4), strict=True):
        assert rest.joint(spring).force[-1] == pytest.approx(force)
    assert rest.joint(held.y).length[-1] == pytest.approx(left @ (10, -5) / 200 + 0.1)
    assert rest.rotation(body)[-1] == pytest.approx(0.05)


def test_a_damper_with_a_law_of_its_own_brakes_a_body():
    """m v' = -c v^2: v = v0 / (1 + c v0 t / m)."""
    scene, body, _ = held_body(x=fb.Damper(law=lambda rate: 3 * abs(rate) * rate))
    scene.set_velocity(body, (4.0, 0.0))
    braked = fb.simulate(scene, dt=1e-3, t_end=0.5)
    assert braked.velocity(body)[-1, 0] == pytest.approx(4.0 / (1 + 3 * 4 * 0.5 / 2), rel=1e-5)


def test_a_cantilever_in_a_rotational_spring():
    """Its end sinks by F l^3 / (3 EI) + F l^2 / k + F l / GA."""
    scene, beam = pinned_bar((2, 0), fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=2, degree=3)
    scene.add_spring(beam.start, rotation=fb.Spring(40.0))
    scene.add_force(beam.end, (0, -1e-3))
    sunk = fb.static(scene, linear=True).displacement(beam.end)[-1, 1]
    assert sunk == pytest.approx(-1e-3 * (8 / 300 + 4 / 40 + 2 / 1e4), rel=1e-9)


def on_a_bed(elements, degree=2, **options):
    scene = fb.Scene()
    beam = scene.add_beam([(-5, 0), (5, 0)], SECTION, elements, degree=degree)
    return scene, beam, scene.add_bed(beam, normal=6400.0, **options)


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 4)])
def test_a_long_beam_on_a_bed_sinks_as_hetenyi_says(degree, order):
    """P b / (2 k) with b^4 = k / (4 EI), with the order of the elements."""
    errors = []
    for elements in (40, 80):
        scene, beam, bed = on_a_bed(elements, degree, tangential=1.0)
        scene.add_force(beam.node(0.5), (0, -1.0))
        rest = fb.static(scene, load_steps=1)
        errors.append(rest.displacement(beam.node(0.5))[-1, 1] * 2 * 6400 / 2 + 1)
        assert rest.joint(bed.normal).force[-1] == pytest.approx(-1.0)
    assert abs(errors[-1]) < 10.0 ** (-1 - degree)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


def test_a_beam_on_a_bed_moves_as_a_whole_with_the_root_of_stiffness_by_mass():
    scene, *_ = on_a_bed(8, tangential=2 * 25.0)
    assert 2 * np.pi * fb.modes(scene, n=1).frequencies[0] == pytest.approx(5.0)


def test_a_ring_on_a_bed_is_pressed_evenly():
    """The bed of a ring under the pressure p yields by p / (k + EA / r^2)."""
    scene = fb.Scene()
    half = [fb.arc((1, 0), (0, 1), (-1, 0)), fb.arc((-1, 0), (0, -1), (1, 0))]
    section = fb.Section(EA=100.0, GA=1e4, EI=1.0)
    first = scene.add_beam(half[0], section, elements=16, degree=2)
    second = scene.add_beam(half[1], section, elements=16, degree=2)
    scene.add_joint(fb.Rigid(first.end, second.start))
    scene.add_joint(fb.Rigid(second.end, first.start))
    for beam in (first, second):
        scene.add_bed(beam, normal=300.0, tangential=1.0)
        way = 1 if beam is first else -1
        pressure = lambda s, way=way: (1e-3 * way * np.cos(s), 1e-3 * way * np.sin(s))  # noqa: E731
        scene.add_line_load(beam, pressure, of="arc length")
    out = fb.static(scene, linear=True).displacement(first.node(0.5))[-1, 1]
    assert out == pytest.approx(1e-3 / 400, rel=1e-3)


def test_a_bed_that_only_pushes_lets_the_ends_lift():
    scene, beam, bed = on_a_bed(80, pushes_only=True)
    scene.fix(beam.start, "x")
    scene.add_force(beam.node(0.5), (0, -1.0))
    rest = fb.static(scene, load_steps=1)
    sunk = rest.joint(bed.normal).length[-1]
    assert sunk.max() > 0 > sunk.min()
    assert rest.joint(bed.normal).force[-1] == pytest.approx(-1.0)
    # The pressure is that of the part which is down.
    lengths = bed.normal.lengths
    assert 6400 * lengths @ np.minimum(sunk, 0) == pytest.approx(-1.0)


def test_a_bed_that_only_holds_along_the_beam_may_be_said_to_push_only():
    scene = fb.Scene()
    bed = scene.add_bed(
        scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1), tangential=5.0, pushes_only=True
    )
    assert bed.normal is None and bed.tangential.on.spring.stiffness == 5.0


def test_springs_are_removed_alone_and_with_what_they_hold():
    scene, body, held = held_body(x=fb.Spring(50.0), y=fb.Spring(200.0), rotation=fb.Spring(8.0))
    scene.remove(held.x)
    assert fb.modes(scene).frequencies[0] == 0
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1)
    scene.add_bed(beam, normal=1.0)
    scene.remove(beam)
    assert len(scene.forces_between) == 2


def test_a_bed_takes_memory_in_proportion_to_the_elements():
    """A square of the rows of supports and springs would be 3.2 GB."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (100, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=10_000)
    scene.fix(beam.start, "x")
    scene.add_bed(beam, normal=1e3)
    scene.add_line_load(beam, (0, -1.0))
    tracemalloc.start()
    solution = fb.static(scene, linear=True)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 5e8
    assert solution.displacement(beam.node(0.5))[-1, 1] == pytest.approx(-1e-3, rel=1e-3)


# -- Beds by laws of their own, and springs that begin in a state --------------------------------


def yielding(limit, scale):
    """A spring per length that holds limit * tanh(x / scale)."""
    return fb.Spring(strain_energy=lambda x: limit * scale * ufl.ln(ufl.cosh(x / scale)))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_stiff_beam_sinks_evenly_into_a_bed_that_yields(degree):
    """A load q per length and p = p0 tanh(y / y0): y = y0 artanh(q / p0)."""
    scene = fb.Scene()
    stiff = fb.Section(EA=1e9, GA=1e9, EI=1e9)
    beam = scene.add_beam([(0, 0), (3, 0)], stiff, elements=4, degree=degree)
    scene.fix(beam.start, "x")
    bed = scene.add_bed(beam, law=yielding(500.0, 0.02))
    scene.add_line_load(beam, (0.0, -400.0))
    solution = fb.static(scene, load_steps=4)
    sunk = -0.02 * np.arctanh(0.8)
    np.testing.assert_allclose(solution.displacement(beam.end)[-1, 1], sunk, rtol=1e-6)
    assert solution.joint(bed.normal).force[-1] == pytest.approx(-1200.0, rel=1e-9)


def test_the_head_of_a_pile_moves_as_its_differential_equation():
    """EI w'''' + p0 tanh(w / y0) = 0, a force H at a free head, a free toe."""
    EI, L, p0, y0, H = 5e4, 8.0, 300.0, 1e-3, 400.0

    def slopes(x, w):
        return np.array([w[1], w[2], w[3], -p0 * np.tanh(w[0] / y0) / EI])

    def ends(a, b):
        return np.array([a[2], a[3] - H / EI, b[2], b[3]])

    x = np.linspace(0, L, 400)
    exact = solve_bvp(slopes, ends, x, np.zeros((4, len(x))), tol=1e-8, max_nodes=100_000)
    assert exact.success
    scene = fb.Scene()
    section = fb.Section(EA=1e9, GA=1e12, EI=EI)
    pile = scene.add_beam([(0, 0), (0, -L)], section, elements=80, degree=2)
    scene.fix(pile.end, "y")
    scene.add_bed(pile, law=yielding(p0, y0))
    scene.add_force(pile.start, (H, 0.0))
    head = fb.static(scene, load_steps=4).displacement(pile.start)[-1, 0]
    assert head == pytest.approx(abs(exact.y[0, 0]), rel=2e-3)
    assert head > 1.5 * abs(H / np.sqrt(np.sqrt(EI * (p0 / y0) ** 3)))  # it has yielded


def test_a_bed_by_a_law_that_only_pushes_is_the_one_that_only_pushes():
    tips = []
    for bed in (
        {"normal": 1e5, "pushes_only": True},
        {"law": fb.Stop(0.0, None, 1e5)},
        {"law": fb.Spring(strain_energy=lambda x: 5e4 * ufl.min_value(x, 0) ** 2)},
    ):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (4, 0)], fb.Section(EA=1e8, GA=1e8, EI=1e4), elements=16)
        scene.fix(beam.start, "x")
        scene.add_bed(beam, **bed)
        scene.add_line_load(beam, (0.0, -50.0))
        scene.add_force(beam.node(0.5), (0.0, -1e3))
        tips.append(fb.static(scene).displacement(beam.end)[-1, 1])
    assert tips[0] > 0  # it lifts off
    np.testing.assert_allclose(tips[1:], tips[0], rtol=1e-6)


def test_a_prop_that_is_put_under_a_sagged_tip_takes_only_what_comes_later():
    """Then 3 EI / L^3 and the prop share the second force."""
    scene = fb.Scene()
    section = fb.Section(EA=1e8, GA=1e8, EI=1e4)
    beam = scene.add_beam([(0, 0), (2, 0)], section, elements=16, degree=2)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, -20.0))
    first = fb.static(scene, load_steps=2)
    sagged = first.displacement(beam.end)[-1, 1]
    prop = scene.add_spring(beam.end, y=fb.Spring(1e4), at="now", start=first).y
    still = fb.static(scene, load_steps=1, start=first)
    assert still.displacement(beam.end)[-1, 1] == pytest.approx(sagged, rel=1e-9)
    assert abs(still.joint(prop).force).max() < 1e-6
    scene.add_force(beam.end, (0.0, -20.0))
    second = fb.static(scene, load_steps=2, start=first)
    stiffness = 3e4 / 8 / (1 + 3e4 / (1e8 * 4))
    further = second.displacement(beam.end)[-1, 1] - sagged
    assert further == pytest.approx(-20 / (1e4 + stiffness), rel=1e-3)
    assert second.joint(prop).force[-1] == pytest.approx(1e4 * further, rel=1e-9)


def test_a_stop_and_an_axis_count_from_the_state_too():
    scene = fb.Scene()
    node = scene.add_body((0, 0), mass=1.0, inertia=1.0).centre
    scene.add_spring(node, x=fb.Spring(100.0), y=fb.Spring(100.0), rotation=fb.Spring(10.0))
    scene.add_force(node, (3.0, 4.0))
    scene.add_moment(node, 1.0)
    start = fb.static(scene, load_steps=1)
    laws = {"x": fb.Stop(-0.01, 0.0, 1e3), "rotation": fb.Spring(1e3)}
    more = scene.add_spring(node, axis=(3, 4), at="now", start=start, **laws)
    assert more.x.on.stop.upper == pytest.approx(0.05)
    assert more.x.on.stop.lower == pytest.approx(0.04)
    assert more.rotation.on.spring.rest == pytest.approx(0.1)


def test_laws_of_beds_and_states_that_do_not_fit_are_refused():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1, GA=1, EI=1), elements=2)
    assert_refused("law.*fx_beam.Spring, Damper", scene.add_bed, beam, law=3.0)
    spring = fb.Spring(1.0)
    assert_refused("without normal", scene.add_bed, beam, normal=1.0, law=spring)
    damper = fb.Damper(law=lambda rate: rate**3)
    assert_refused("dampers and friction without functions", scene.add_bed, beam, law=damper)
    assert_refused("at = .*'now'", scene.add_spring, beam.end, y=spring, at="then", start=1)
    assert_refused("start", scene.add_spring, beam.end, y=spring, at="now")
    assert_refused("start.*Solution", scene.add_spring, beam.end, y=spring, at="now", start=3)
