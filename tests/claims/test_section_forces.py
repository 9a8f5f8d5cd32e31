"""Section forces at any place, from the balance of elements, against closed forms and reactions."""

import math
import pickle

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, supported_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=2.0, rhoI=0.01)
SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.EnergyDecaying(),
    fb.MidPoint(),
    fb.Newmark(),
    fb.HHT(),
    fb.GeneralizedAlpha(0.6),
]


def cantilever(degree=1, elements=4, **data):
    values = {"EA": 1e6, "GA": 1e6, "EI": 1e3} | data
    return clamped_bar((2, 0), fb.Section(**values), elements, degree=degree)


def simply_supported(degree=1, elements=4):
    return supported_bar((2, 0), SECTION, elements=elements, degree=degree)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("elements", [1, 4])
def test_the_moment_at_a_clamp_is_the_load_times_its_arm(degree, elements):
    scene, beam = cantilever(degree, elements)
    scene.add_force(beam.end, (3.0, 10.0))
    forces = fb.static(scene, linear=True).resultants(beam)
    assert forces.ends.M[-1] == pytest.approx([20.0, 0.0], abs=1e-9)
    assert forces.ends.Q[-1] == pytest.approx([10.0, 10.0], abs=1e-9)
    assert forces.ends.N[-1] == pytest.approx([3.0, 3.0], abs=1e-9)
    s = np.linspace(0.0, 2.0, 7)
    assert forces.at(s).M[-1] == pytest.approx(10.0 * (2.0 - s), abs=1e-9)


def test_section_forces_are_right_where_shear_is_a_constraint():
    scene, beam = cantilever(EA=1e4, GA=1e13)
    scene.add_force(beam.end, (0.0, 10.0))
    solution = fb.static(scene, linear=True)
    ends = solution.resultants(beam).ends
    assert ends.M[-1] == pytest.approx([20.0, 0.0], abs=1e-3)
    assert ends.Q[-1] == pytest.approx([10.0, 10.0], rel=1e-3)
    assert ends.N[-1] == pytest.approx([0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("elements", [1, 3])
def test_moments_under_a_uniform_load_are_the_parabola(degree, elements):
    scene, beam = simply_supported(degree, elements)
    scene.add_line_load(beam, (0.0, -8.0))
    s = np.linspace(0.0, 2.0, 11)
    forces = fb.static(scene, linear=True).resultants(beam).at(s)
    assert forces.M[-1] == pytest.approx(4.0 * s * (2.0 - s), abs=1e-8)
    assert forces.Q[-1] == pytest.approx(8.0 * (s - 1.0), abs=1e-8)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("elements", [1, 3])
def test_a_force_and_a_couple_inside_an_element_have_their_kink_and_jump(degree, elements):
    scene, beam = simply_supported(degree, elements)
    scene.add_force(beam.at(0.9), (5.0, -10.0))
    scene.add_moment(beam.at(1.1), 4.0)
    s = np.linspace(0.0, 2.0, 9)
    left = 10.0 * 1.1 / 2 + 4.0 / 2  # force of the left support
    M = left * s - 10.0 * np.maximum(s - 0.9, 0.0) - 4.0 * (s > 1.1)
    forces = fb.static(scene, linear=True).resultants(beam)
    assert forces.at(s).M[-1] == pytest.approx(M, abs=1e-8)
    assert forces.at(s).Q[-1] == pytest.approx(-left + 10.0 * (s > 0.9), abs=1e-8)
    assert forces.at(s).N[-1] == pytest.approx(5.0 * (s < 0.9), abs=1e-8)
    before, after = (forces.at(1.1, side).M[-1, 0] for side in ("before", "after"))
    assert after - before == pytest.approx(-4.0, abs=1e-8)


@pytest.mark.parametrize("right", [1, -1])
def test_the_jump_at_a_force_inside_a_curved_element_is_the_force_wherever_the_beam_goes(right):
    """On the top of an arc, of which the direction passes pi where it goes to the left."""
    scene = fb.Scene()
    arc = fb.arc((-right, 0), (0, 0.3), (right, 0))
    beam = scene.add_beam(arc, fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=1, degree=2)
    scene.clamp(beam.start)
    scene.add_force(beam.at(beam.length / 2), (3.0, -10.0))
    forces = fb.static(scene, linear=True).resultants(beam)
    before, after = (forces.at(beam.length / 2, side) for side in ("before", "after"))
    assert (before.N - after.N)[-1] == pytest.approx(3.0 * right)
    assert (before.Q - after.Q)[-1] == pytest.approx(-10.0 * right)


def test_the_jump_at_a_force_inside_a_bent_element_is_that_of_many_elements():
    """Sections between the ends of a long element turn otherwise than on a straight line."""
    jumps = []
    for elements in (1, 8):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(1e4, 1e4, 1.0), elements, degree=3)
        scene.clamp(beam.start)
        scene.add_force(beam.at(0.3), (0, -4.0))
        scene.add_force(beam.end, (0, -1.0))
        forces = fb.static(scene).resultants(beam)
        before, after = (forces.at(0.3, side) for side in ("before", "after"))
        jumps.append([(before.N - after.N)[-1].item(), (before.Q - after.Q)[-1].item()])
    assert jumps[0] == pytest.approx(jumps[1], rel=2e-3)


def test_jumps_are_in_the_direction_of_their_beam_after_another_scene_of_the_same_structure():
    found = []
    for y in (0.0, 0.75, -0.75):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, y)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=2)
        scene.clamp(beam.start)
        scene.add_force(beam.at(0.3), (2.0, 0))
        found.append((beam, fb.static(scene, linear=True), 2.0 / math.hypot(1, y)))
    for beam, solution, jump in found:
        forces = solution.resultants(beam)
        before, after = (forces.at(0.3, side) for side in ("before", "after"))
        assert (before.N - after.N)[-1] == pytest.approx(jump)


def test_a_couple_on_a_node_is_the_jump_of_the_moment_there():
    scene, beam = simply_supported()
    scene.add_moment(beam.node(0.5), 6.0)
    forces = fb.static(scene).resultants(beam)
    before, after = (forces.at(1.0, side).M[-1, 0] for side in ("before", "after"))
    assert after - before == pytest.approx(-6.0, abs=1e-7)


def moved(scheme, record=None, **options):
    """A clamped frame of two beams with gravity, drag, loads, damping and a mass at a corner."""
    section = fb.Section(EA=1e5, GA=1e5, EI=500.0, rhoA=2.0, rhoI=0.05, retardation=1e-3)
    scene, arm = clamped_bar((1, 0.4), section, 3, name="arm", **options, gravity=(0.0, -9.81))
    leg = scene.add_beam([arm.end, (1.5, -0.2)], section, elements=2, name="leg", **options)
    scene.add_mass(arm.end, 1.0, 0.02)
    scene.add_line_load(arm, lambda t: (0.0, 30 * np.sin(9 * t)), between=(0.2, 0.8))
    scene.add_force(leg.at(0.3), (5.0, 2.0))
    scene.add_drag(leg, linear=0.4, quadratic=0.2)
    scene.add_natural_strain(arm, curvature=lambda t: 0.2 * np.sin(5 * t))
    return scene, arm, fb.simulate(scene, scheme, dt=0.01, t_end=0.3, record=record or fb.Record())


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("degree", [1, 2])
def test_section_forces_of_motions_are_reactions_and_balance_at_nodes(scheme, degree):
    """At its clamp, its free end, and between elements, in every row and by every scheme."""
    _, arm, solution = moved(scheme, degree=degree)
    forces, reaction = solution.resultants("arm"), solution.reaction(arm.start)[1:]
    ends, most = forces.ends, abs(reaction).max()
    assert ends.M[1:, 0] == pytest.approx(-reaction[:, 2], abs=1e-9 * most)
    size = np.hypot(ends.N[1:, 0], ends.Q[1:, 0])
    assert size == pytest.approx(np.hypot(*reaction[:, :2].T), abs=1e-9 * most)
    tip = solution.resultants("leg").ends
    for name in "NQM":
        free = abs(getattr(tip, name)[:, 1])
        # Accelerations of the start are found by differences of forces that depend on rates.
        assert free[0] < 1e-5 * most and free[1:].max() < 1e-9 * most
        inner = arm.s[1:-1]
        before, after = (getattr(forces.at(inner, side), name) for side in ("before", "after"))
        assert before[0] == pytest.approx(after[0], abs=1e-5 * most)
        assert before[1:] == pytest.approx(after[1:], abs=1e-8 * most)


@pytest.mark.parametrize("every", [1, 3])
def test_section_forces_of_rows_do_not_depend_on_which_are_recorded(every):
    _, _, solution = moved(fb.GeneralizedAlpha(0.6), fb.Record(every=every))
    _, _, whole = moved(fb.GeneralizedAlpha(0.6))
    rows = np.searchsorted(whole.t, solution.t - 1e-9)
    computed, known = (motion.resultants("leg").at([0.1, 0.5]).M for motion in (solution, whole))
    assert computed[1:] == pytest.approx(known[rows][1:], abs=1e-7 * abs(known).max())


def test_files_copies_and_joined_motions_have_section_forces(tmp_path):
    scene, _, solution = moved(fb.EnergyMomentum())
    solution.save(tmp_path / "run.npz")
    known = solution.resultants("leg").at([0.0, 0.1, 0.3, 0.7])
    for same in (fb.load(tmp_path / "run.npz"), pickle.loads(pickle.dumps(solution))):
        computed = same.resultants("leg").at([0.0, 0.1, 0.3, 0.7])
        for one, other in zip(known, computed, strict=True):
            np.testing.assert_array_equal(one, other)
    more = fb.simulate(scene, dt=0.01, t_end=0.4, start=solution)
    whole = solution.then(more).resultants("leg").at(0.4).M
    parts = [motion.resultants("leg").at(0.4).M for motion in (solution, more)]
    np.testing.assert_array_equal(whole, np.concatenate([parts[0], parts[1][1:]]))


def test_section_forces_outlive_the_solution_and_other_runs_of_the_same_structure():
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, 10.0))
    forces = fb.static(scene, linear=True).resultants(beam)
    scene.change(load, (0.0, 50.0))
    fb.static(scene)
    assert forces.ends.M[-1, 0] == pytest.approx(20.0, abs=1e-9)


def test_copies_of_sections_with_functions_of_ones_own_have_section_forces():
    class Cubic:
        __hash__ = None

        def __call__(self, eps, gamma, kappa):
            return 5e3 * (eps**2 + gamma**2) + 40.0 * kappa**2 + kappa**4

    scene, beam = clamped_bar((1, 0), fb.Section(strain_energy=Cubic()), elements=3)
    scene.add_force(beam.end, (0.0, 10.0))
    solution = fb.static(scene)
    ends = solution.resultants(beam).ends
    assert ends.M[-1, 0] == pytest.approx(-solution.reaction(beam.start)[-1, 2], rel=1e-9)


def test_bad_places_and_missing_rates_are_refused():
    _, _, solution = moved(fb.EnergyMomentum(), fb.Record(rates=False))
    with pytest.raises(ValueError, match="need accelerations, which were not recorded"):
        _ = solution.resultants("arm").ends
    _, _, solution = moved(fb.EnergyMomentum())
    forces = solution.resultants("arm")
    for bad in ([5.0], [-0.1], [np.nan]):
        assert_refused("arc lengths from 0 to the length of the beam", forces.at, bad)
    assert_refused("'before' or 'after'", forces.at, 0.5, "left")


def test_a_scene_that_has_changed_since_does_not_change_them():
    """A solution's forces are those of the scene as it was, though they are computed when read."""
    values = []
    for changes in (False, True):
        section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.01)
        scene, other = clamped_bar([(0, 1), (1, 1)], section, elements=2, gravity=(0, -10.0))
        beam = scene.add_beam([(0, 0), (2, 0)], section, elements=4)
        scene.clamp(beam.start)
        load = scene.add_line_load(beam, (0, -5.0))
        solution = fb.simulate(scene, dt=0.01, t_end=0.1)
        if changes:
            scene.gravity = (0, -1000.0)
            scene.change(load, (0.0, 70.0))
            scene.remove(other)
        values.append(solution.resultants(beam).at([0.0, 0.7]).M)
    assert (values[0] == values[1]).all()
    assert abs(values[0]).max() > 1


@pytest.mark.parametrize(("length", "elements"), [(3.0, 10), (0.9, 3), (0.7, 7)])
def test_a_force_at_a_node_but_for_round_off_is_at_this_node(length, elements):
    """M = -P (a - s) up to the force: 0.3 is not the third of ten equal parts of 3 m in binary."""
    section = fb.Section(EA=1e6, GA=1e6, EI=1e3)
    s = np.linspace(0, length, 61)[1:-1] + 1e-4
    for k in range(1, elements):
        place = round(k * length / elements, 12)
        scene, beam = clamped_bar((length, 0), section, elements)
        scene.add_force(beam.at(place), (0, -10.0))
        moments = fb.static(scene, linear=True).resultants(beam).at(s).M[-1]
        np.testing.assert_allclose(moments, -10 * np.maximum(place - s, 0), atol=1e-6)


def test_fields_of_all_members_are_those_of_each():
    from fx_beam.results.member_fields import along_all, in_rows

    scene = fb.Scene()
    section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0)
    points = [(0, 0), (3, 0), (3, 2), (0, 2)]
    beams = scene.add_mesh(points, [(0, 1), (1, 2), (2, 3), (3, 0)], section, elements=10)
    scene.clamp(beams.nodes[0])
    scene.add_force(beams[0].at(0.3), (1.0, -10.0))
    scene.add_force(beams[1].at(0.77), (0.0, -3.0))
    scene.add_line_load(beams[2], (0.0, -2.0))
    solution, places = fb.simulate(scene, dt=1e-3, t_end=3e-3), np.array([0.0, 0.4, 1.0])
    fields = along_all(solution, "NQM", [1, 3], places)
    for name, values in fields.items():
        each = [in_rows(solution.resultants(beam), [1, 3]) for beam in beams]
        expected = np.concatenate([part.in_elements(name, places) for part in each], axis=1)
        np.testing.assert_allclose(values, expected, atol=1e-12 * abs(expected).max())


class VonKarman(fb.Resultants):
    """Moderate deflections along x: N is along x, and Q beside it with N w'."""

    def virtual_work(self, step):
        slope, bent = step.prime(step.u0 + step.Du)[1], step.prime(step.virtual_psi)
        du, dw = step.prime(step.virtual_u)
        return self.N * (du + slope * dw) + self.Q * (dw - step.virtual_psi) + self.M * bent


def moderate(step, law):
    (du, dw), psi = step.prime(step.u0 + step.Du), step.psi0 + step.Dpsi
    N, Q, M = law.resultants(du + dw**2 / 2, dw - psi, step.prime(psi))
    return VonKarman(step.t0, step.t0, N, Q, M, m=M)


def softening(step, law):
    r = fb.Newmark().resultants(step, law).end
    M = r.M / (1 + 1e-4 * r.M**2)
    return r._replace(N=r.N - 1e-3 * r.N**3, M=M, m=M)


@pytest.mark.parametrize("resultants", [softening, moderate], ids=lambda of: of.__name__)
def test_section_forces_of_ones_own_laws_are_in_balance_and_of_other_theories_are_told(
    resultants, caplog
):
    """A massless cantilever under -30 N at its tip: its moment by the arm, moved or as drawn."""
    scene, beam = clamped_bar((1, 0), fb.Section(1e4, 1e4, 100.0, rhoA=0.0), 8)
    scene.add_force(beam.end, lambda t: (0, -30.0 * t))
    scheme = fb.Scheme("own", resultants, fb.NewmarkRates(0.25, 0.5))
    solution = fb.simulate(scene, scheme, dt=0.25, t_end=1.0)
    caplog.clear()
    (x, *_), psi = solution.shape(beam)[-1].T, solution.q[-1, :, 2]
    forces, ends = solution.resultants(beam), beam.s
    at_nodes = forces.at(ends)
    if resultants is softening:
        np.testing.assert_allclose(at_nodes.M[-1], -30 * (x[-1] - x), atol=1e-9)
        np.testing.assert_allclose(at_nodes.N[-1], -30 * np.sin(psi), atol=1e-9)
        assert "your own" not in caplog.text
    else:
        np.testing.assert_allclose(at_nodes.M[-1], -30 * (1 - ends), atol=1e-9)
        np.testing.assert_allclose(forces.N[-1], 0, atol=1e-9)  # at the ends -30 sin(psi)
        np.testing.assert_allclose(forces.Q[-1], -30, atol=1e-9)
        assert "the virtual work of own is your own. M is its couple" in caplog.text
