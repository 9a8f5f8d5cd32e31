"""What a user changes in a problem of dolfinx: terms, resultants, fields, solvers, starts."""

import json
import logging
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, pinned_bar

import fx_beam as fb

fenicsx = pytest.importorskip("fx_beam.fenicsx")

from mpi4py import MPI  # noqa: E402
from petsc4py import PETSc  # noqa: E402

import dolfinx  # noqa: E402
import ufl  # noqa: E402
from dolfinx import fem  # noqa: E402

from fx_beam.fem.elements import lagrange  # noqa: E402
from fx_beam.fenicsx.versions import create_mesh  # noqa: E402

space = getattr(fem, "functionspace", fem.FunctionSpace)

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
DT, STEPS = 0.01, 20
T_END = DT * STEPS


def pair(degree=1):
    """Two beams with a hinge, on a pin."""
    scene, first = pinned_bar((1, 0.3), SECTION, 4, degree=degree, gravity=(0, -9.81))
    second = scene.add_beam([(1, 0.3), (2, 0)], SECTION, 3, degree=degree)
    scene.add_joint(fb.Revolute(first.end, second.start))
    return scene, first, second


def cantilever(elements=4):
    return clamped_bar((1, 0), SECTION, elements)


def assert_same(solution, other, digits=1e-12):
    for name in ("q", "v", "reactions"):
        values = getattr(other, name)
        size = digits * max(abs(values).max(), 1.0)
        np.testing.assert_allclose(getattr(solution, name), values, rtol=0, atol=size, err_msg=name)


@pytest.mark.parametrize(
    ("call", "name", "real"),
    [
        (lambda scene: fenicsx.Problem(scene, timestep=0.1), "timestep", "Use dt$"),
        (lambda scene: fenicsx.Problem(scene, dt=0.1).run(0.1, duration=1.0), "duration", "t_end$"),
        (lambda scene: fenicsx.Equilibrium(scene).run(load_step=3), "load_step", "'load_steps'"),
        (lambda scene: fenicsx.Equilibrium(scene).modes(num_modes=2), "num_modes", "Use n$"),
    ],
)
def test_keywords_of_other_programs_are_answered_by_ours(call, name, real):
    assert_refused(f"argument '{name}'.*{real}", call, cantilever()[0], error=TypeError)


# -- Terms -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.Newmark(), fb.HHT(-0.1)], ids=lambda of: of.name
)
def test_a_term_with_a_constant_is_the_virtual_work_with_a_parameter(scheme):
    scene, first, _ = pair()
    problem, level = fenicsx.Problem(scene, scheme, dt=DT), scheme.rates.level
    step, k = problem.step, fem.Constant(problem.mesh, 100.0 + 50 * level * DT)
    problem.add(k * ufl.dot(step.u, step.virtual_u) * problem.measure(first))

    def grow(problem):
        k.value = 100.0 + 50 * (problem.t + level * DT)

    solution = problem.run(T_END, after=grow)
    same, beam, _ = pair()
    stiffness = fb.Parameter("k", lambda t: 100.0 + 50 * t)
    same.add_virtual_work(lambda s: -stiffness * ufl.dot(s.u, s.virtual_u), beam)
    engine = fb.simulate(same, scheme, dt=DT, t_end=T_END)
    assert_same(solution, engine, 1e-11)
    np.testing.assert_allclose(solution.a, engine.a, rtol=0, atol=1e-9 * abs(engine.a).max())
    np.testing.assert_allclose(solution.energy.work, engine.energy.work, rtol=0, atol=1e-12)


def test_the_balance_has_the_work_of_an_added_term():
    scene, first, _ = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    step = problem.step
    problem.add(3.0 * ufl.dot(step.v, step.virtual_u) * problem.measure())
    energy = problem.run(T_END).energy
    assert energy.work[-1] < -0.1
    assert abs(energy.balance_error).max() < 1e-12 * energy.kinetic.max()


def test_a_term_at_an_end_is_a_force_on_its_node():
    (scene, beam), (same, other) = cantilever(), cantilever()
    problem = fenicsx.Problem(scene, dt=DT)
    problem.add(-10.0 * problem.step.virtual_u[1] * problem.measure(beam.end))
    same.add_force(other.end, (0, 10.0))
    assert_same(problem.run(T_END), fb.simulate(same, dt=DT, t_end=T_END))


def test_a_term_may_come_between_steps_and_have_a_function_on_the_mesh():
    scene, _ = cantilever()
    problem = fenicsx.Problem(scene, dt=DT)
    problem.run(2 * DT)
    load = fem.Function(space(problem.mesh, ("DG", 0)))
    load.x.array[:] = 5.0
    problem.add(-load * problem.step.virtual_u[1] * problem.measure())
    later = problem.run(T_END)
    same, beam = cantilever()
    same.add_line_load(beam, lambda t: (0.0, 5.0 * (t > 2 * DT)))
    engine = fb.simulate(same, dt=DT, t_end=T_END)
    np.testing.assert_allclose(later.q, engine.q[2:], rtol=0, atol=1e-14)


def test_what_is_no_term_of_the_residual_is_refused_with_a_sentence():
    scene, first, _ = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    step, dx = problem.step, problem.measure()
    line, cells = dolfinx.mesh.create_unit_interval(MPI.COMM_SELF, 3), np.arange(3, dtype=np.int32)
    other, tags = ufl.dx(line), dolfinx.mesh.meshtags(line, 1, cells, cells)
    tagged = ufl.dx(problem.mesh, subdomain_data=tags)(1)
    for term, says in (
        (3, "must be a form"),
        (step.u[0] * dx, "it has neither"),
        (ufl.dot(step.virtual_u, step.virtual_u) * dx, "must be linear"),
        (ufl.sin(step.virtual_psi) * dx, "must be linear"),
        (step.virtual_u[0] * other, "another mesh"),
        *[(step.virtual_u[0] * tagged, "another mesh")] * hasattr(tags, "mesh"),
        (0 * step.virtual_u[0] * dx, "it has neither"),
    ):
        assert_refused(says, problem.add, term)
    for places in (cantilever()[1], [first, cantilever()[1]]):
        assert_refused("no beam of this scene", problem.measure, places)
    assert_refused("no end of the mesh", lambda: problem.measure(first.nodes[1]))
    for place in (2, "beam 1", [1], cantilever()[1]):
        assert_refused("is no beam of this scene", problem.measure, place)


def test_a_term_may_be_the_derivative_of_an_energy():
    scene, first, _ = pair()
    problem = fenicsx.Problem(scene, fb.Newmark(), dt=DT)
    step, dx = problem.step, problem.measure(first)
    energy = 50.0 * ufl.dot(step.u, step.u) * (1 + step.u[1] ** 2) * dx  # of the end, by Newmark
    problem.add(ufl.derivative(energy, problem.increment, problem.test))
    same, beam, _ = pair()

    def soil(step):
        u, v = step.u, step.virtual_u
        return -100.0 * (ufl.dot(u, v) * (1 + u[1] ** 2) + ufl.dot(u, u) * u[1] * v[1])

    same.add_virtual_work(soil, beam)
    assert_same(problem.run(T_END), fb.simulate(same, fb.Newmark(), dt=DT, t_end=T_END), 1e-11)


def assembled(problem, form):
    """Force in y and couple of each node, from a vector of dolfinx in the numbers of V."""
    vector = fem.assemble_vector(fem.form(form))
    entries = np.empty(problem.system.M.size[0])
    entries[problem.system.dofs] = getattr(vector, "array", vector)
    return entries.reshape(-1, 3)[:, 1:].T


@pytest.mark.parametrize("materials", [1, 2])
def test_the_residual_compiles_with_terms_on_beams_and_at_ends(materials):
    section = SECTION
    if materials == 2:
        section = fb.Section(strain_energy=lambda e, g, k: 5e3 * (e**2 + g**2) + 50 * k**2, rhoA=1)
    scene, arm = cantilever(2)
    middle = scene.add_beam([arm.end, (2, 0)], section, elements=1)
    last = scene.add_beam([middle.end, (3, 0)], SECTION, elements=1)
    problem = fenicsx.Problem(scene, dt=DT)
    down, turn = problem.step.virtual_u[1], problem.step.virtual_psi
    for term in (
        2 * down * problem.measure(),
        3 * down * problem.measure([arm, last]),
        5 * turn * problem.dx(1),
        7 * down * problem.measure(last.end),
        11 * turn * problem.measure(arm.start),
        problem.start[2] ** 2 * turn * ufl.dx(domain=problem.mesh),
    ):
        problem.add(term)
    force, couple = assembled(problem, problem.F)
    np.testing.assert_allclose(force, [1.25, 2.5, 1.25 + 1, 1 + 2.5, 2.5 + 7], atol=1e-14)
    np.testing.assert_allclose(couple, [11, 0, 2.5, 2.5, 0], atol=1e-14)
    matrix = fem.petsc.assemble_matrix(fem.form(problem.J))
    matrix.assemble()
    clamp = np.flatnonzero(problem.system.dofs == 0)
    assert matrix[clamp[0], clamp[0]] == pytest.approx(1e4 / 0.5 / 2)  # EA/h of the mean


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8)], ids=lambda of: of.name
)
def test_the_residual_is_the_form_with_inertia_less_loads(scheme, degree):
    """Also where supports are: what is left there are their forces."""
    tapered = fb.Section(1e4, 1e4, 100.0, rhoA=lambda s: 1 + s, rhoI=lambda s: 0.1 * (2 - s))
    scene, beam = clamped_bar((1, 0), tapered, 3, degree=degree, gravity=(0, -9.81))
    scene.add_force(beam.end, lambda t: (0, 50 * t))
    problem = fenicsx.Problem(scene, scheme, dt=DT)
    solution = problem.run(5 * DT)
    loads = problem.loads.reshape(-1, 3)[:, 1:].T
    r = assembled(problem, problem.F) + assembled(problem, problem.F_inertia) - loads
    size = abs(solution.reactions).max()
    np.testing.assert_allclose(r[:, 1:], 0, atol=1e-9 * size)
    np.testing.assert_allclose(r[:, 0], solution.reactions[-1, 0, 1:], atol=1e-9 * size)
    level = scheme.rates.level  # of the mass 1.5 and of the force, by hand
    assert problem.loads[1::3].sum() == pytest.approx(-1.5 * 9.81 + 50 * (4 + level) * DT)
    assert_refused("are nodal", lambda: fenicsx.Problem(scene, dt=DT).F_inertia)


@pytest.mark.parametrize("rho_inf", [0.8, 0.3])
def test_the_inertia_of_a_driven_end_is_that_of_its_support_force(rho_inf):
    """In the form its acceleration is that of the equations, which weigh the one before as well."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(1e4, 1e4, 100.0, rhoA=lambda s: 1 + s, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=3)
    scene.fix(beam.start, "x", "rotation")
    scene.prescribe(beam.start, y=lambda t: 0.1 * np.sin(20 * t))
    problem = fenicsx.Problem(scene, fb.GeneralizedAlpha(rho_inf), dt=DT)
    solution = problem.run(5 * DT)
    form = assembled(problem, problem.F) + assembled(problem, problem.F_inertia)
    force = form[:, 0] - problem.loads.reshape(-1, 3)[0, 1:]
    size = abs(solution.reactions).max()
    np.testing.assert_allclose(force, solution.reactions[-1, 0, 1:], atol=1e-9 * size)


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.GeneralizedAlpha(0.8)], ids=lambda of: of.name)
def test_inertia_of_what_driven_motions_move_has_their_acceleration(scheme):
    """A rigid shift by t^3 of a bar: 6 t at the level of the forces, and half of its mass there."""
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1)
    for node in (bar.start, bar.end):
        scene.prescribe(node, x=0.0, y=lambda t: t**3, rotation=0.0)
    problem = fenicsx.Problem(scene, scheme, dt=DT)
    problem.run(5 * DT)
    force, couple = assembled(problem, problem.F_inertia)
    np.testing.assert_allclose(force, 3.0 * (4 + scheme.rates.level) * DT, rtol=1e-9)
    np.testing.assert_allclose(couple, 0, atol=1e-12)


def test_gauss_rules_that_ffcx_confuses_in_one_form_are_named(caplog):
    scene, beam = cantilever()
    scene.add_drag(beam, linear=1.0)
    problem = fenicsx.Problem(scene, fb.HHT(-0.1), dt=DT)
    assert_same(problem.run(5 * DT), fb.simulate(scene, fb.HHT(-0.1), dt=DT, t_end=5 * DT))
    assert not caplog.text
    assert problem.F and len(problem.parts) == 2
    assert ("assemble problem.parts" in caplog.text) == hasattr(ufl, "FiniteElement")


def test_the_mass_is_the_form_of_mass_of_dolfinx():
    scene, *_ = pair(degree=2)
    problem = fenicsx.Problem(scene, dt=DT)
    u, v = ufl.TrialFunction(problem.V), ufl.TestFunction(problem.V)
    density = ufl.as_vector((1.0, 1.0, 0.1))
    form = sum(density[i] * u[i] * v[i] for i in range(3)) * problem.measure(points=3)
    local = fem.petsc.assemble_matrix(fem.form(form))
    local.assemble()
    dofs, M = problem.system.dofs, problem.system.M
    here = M.getValues(*[range(M.size[0])] * 2)
    there = local.getValues(*[range(local.size[0])] * 2)
    np.testing.assert_allclose(here[np.ix_(dofs, dofs)], there, atol=1e-14)


# -- Resultants and natural strains ----------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2])
def test_replaced_resultants_are_those_of_a_scheme_of_ones_own(degree):
    scheme, (scene, first, _) = fb.EnergyMomentum(), pair(degree)
    problem = fenicsx.Problem(scene, scheme, dt=DT)
    tension = fem.Constant(problem.mesh, 10.0)

    def pulled(step, law, by=tension):
        r = scheme.resultants(step, law)
        return r._replace(N=r.N + by)

    def energy(eps, gamma, kappa):
        return (1e4 * (eps**2 + gamma**2) + 100.0 * kappa**2) / 2 + 10.0 * eps

    problem.replace_resultants(pulled, energy)
    solution = problem.run(T_END)
    own = fb.Scheme("pulled", lambda step, law: pulled(step, law, 10.0), fb.MidPointRates())
    engine = fb.simulate(scene, own, dt=DT, t_end=T_END)
    assert_same(solution, engine, 1e-11)
    here, there = (motion.resultants(first) for motion in (solution, engine))
    for name in "NQM":
        values = getattr(there, name)
        allowed = 1e-8 * abs(values).max()
        np.testing.assert_allclose(getattr(here, name), values, rtol=0, atol=allowed)
    assert abs(solution.energy.balance_error).max() < 1e-11


@pytest.mark.parametrize(
    "new, old", [("EnergyMomentum", "MidPoint"), ("MidPoint", "EnergyMomentum")]
)
def test_replaced_resultants_may_want_other_increments_than_those_of_the_scene(new, old):
    """Exact resultants of degree 2 have rotations at nodes as components, others do not."""
    scene, *_ = pair(degree=2)
    problem = fenicsx.Problem(scene, getattr(fb, old)(), dt=DT)
    resultants = getattr(fb, new)().resultants
    problem.replace_resultants(resultants)
    own = fb.Scheme("own", resultants, fb.MidPointRates())
    assert_same(problem.run(T_END), fb.simulate(scene, own, dt=DT, t_end=T_END), 1e-11)


def test_symbols_of_another_mesh_and_without_values_are_refused_wherever_they_enter():
    """Of them dolfinx 0.5 reads other memory, or ends the process."""
    drawn = fb.Scene()
    drawn.clamp(drawn.add_mesh([(0, 0), (1, 0), (2, 0)], [(0, 1), (1, 2)], SECTION, 1).nodes[0])
    given = fenicsx.Problem(drawn, dt=DT).mesh
    scene = fb.Scene()
    beams = fenicsx.beams_of(scene, given, SECTION, elements=2)
    scene.clamp(beams.nodes[0])
    scene.add_natural_strain(beams[0], axial=0.0)
    problem, scheme = fenicsx.Problem(scene, dt=DT), fb.EnergyMomentum()
    step, dx, before = problem.step, problem.dx, problem.step

    def replace(symbol, energy=lambda eps, gamma, kappa: eps**2):
        def resultants(step, law):
            r = scheme.resultants(step, law)
            return r._replace(N=r.N + symbol)

        problem.replace_resultants(resultants, energy)

    def natural(symbol):
        problem.natural_strains = (0, symbol, 0)

    line = dolfinx.mesh.create_unit_interval(MPI.COMM_SELF, 3)
    for mesh in (given, line):
        function = fem.Function(space(mesh, ("DG", 0)))
        for symbol in (function, fem.Constant(mesh, 1.0), ufl.SpatialCoordinate(mesh)[0]):
            for enter in (
                lambda symbol: problem.add(symbol * step.virtual_u[1] * dx),
                replace,
                lambda symbol: replace(0.0, lambda eps, gamma, kappa: symbol * eps**2),
                natural,
                problem.interpolate,
                problem.at_points,
            ):
                assert_refused("on another mesh than problem.mesh", enter, symbol)
    for symbol in (ufl.Constant(problem.mesh), ufl.Coefficient(problem.V)[0]):
        for enter in (lambda s: problem.add(s * step.virtual_psi * dx), replace, natural):
            assert_refused("has no values", enter, symbol)
    assert problem.step is before  # nothing is replaced by what is refused
    problem.run(2 * DT)


def test_fields_of_the_step_before_replaced_resultants_are_refused(caplog):
    """Steps no longer set them: a foundation on them had no force, tip -0.30 for -0.07."""
    scene, beam = cantilever()
    scene.add_natural_strain(beam, axial=0.0)
    problem, same = fenicsx.Problem(scene, dt=DT), fb.EnergyMomentum().resultants
    step, dx, q = problem.step, problem.dx, problem.q
    problem.natural_strains = (0, 0, 1e-3 * step.u0[0])
    assert_refused("the step before", problem.replace_resultants, same)
    problem.natural_strains = None

    def of_before(now, law):
        r = same(now, law)
        return r._replace(N=r.N * (1 + step.psi0**2))

    assert_refused("the step before", problem.replace_resultants, of_before)
    problem.replace_resultants(same)
    assert "work of natural strains that change, in Energy.work" in caplog.text
    for u in (step.u, step.u0, step.v):
        assert_refused("the step before", problem.add, ufl.dot(u, problem.step.virtual_u) * dx)
        assert_refused("the step before", problem.interpolate, u[0])
    problem.add(ufl.dot(problem.step.u - q.sub(0), problem.step.virtual_u) * dx)
    problem.advance()
    assert q is problem.q and abs(q.x.array).max() == 0.0


def test_resultants_that_are_zero_are_those_of_the_engine():
    def none(step, law):
        r = fb.EnergyMomentum().resultants(step, law)
        return r._replace(N=0 * r.N, Q=0 * r.Q, M=0 * r.M, m=0 * r.m)

    scene, beam = cantilever()
    scene.set_velocity(beam, lambda x, y: (0.0, x))
    problem = fenicsx.Problem(scene, dt=DT)
    problem.replace_resultants(none, lambda eps, gamma, kappa: 0.0)
    solution, own = problem.run(T_END), fb.Scheme("none", none, fb.MidPointRates())
    assert_same(solution, fb.simulate(scene, own, dt=DT, t_end=T_END))
    assert not solution.energy.strain.any() and not solution.resultants(beam).N.any()


@pytest.mark.parametrize("kind", ["motion", "equilibria"])
def test_rows_have_the_energy_of_functions_that_are_updated_at_the_end_of_a_step(kind):
    """A damage that grows with curvature: its rows had the energy of the damage before."""
    scene, beam = cantilever()
    scene.add_force(beam.end, (0, -20.0))
    moves = kind == "motion"
    problem = fenicsx.Problem(scene, dt=DT) if moves else fenicsx.Equilibrium(scene)
    damage = problem.function("damage")

    def damaged(step, law):
        motion = fb.EnergyMomentum().resultants(step, law)
        r = motion if moves else fb.Equilibrium().resultants(step, law).end
        return r._replace(M=(1 - damage) * r.M, m=(1 - damage) * r.m)

    def energy(eps, gamma, kappa):
        return 5e3 * (eps**2 + gamma**2) + 50 * (1 - damage) * kappa**2

    before = problem.function("before")  # exact, as the energy is linear in the damage

    def dissipation(eps, gamma, kappa):
        return 50 * (damage - before) * kappa**2

    problem.replace_resultants(damaged, energy, dissipation)
    bent, rows, used = abs(problem.step.strains1[2]), [], []

    def grow(problem):
        used.append(damage.x.array.copy())
        before.x.array[:] = damage.x.array
        damage.x.array[:] = np.maximum(problem.interpolate(bent).x.array, damage.x.array)

    def note(problem):
        q, h = problem.start.x.array + problem.increment.x.array, 0.25
        nodes = np.empty(q.size)
        nodes[problem.system.dofs] = q
        x, y, psi = nodes.reshape(-1, 3).T
        slope, turn = np.stack([h + np.diff(x), np.diff(y)]) / h, (psi[1:] + psi[:-1]) / 2
        axis = np.stack([np.cos(turn), np.sin(turn)])
        eps, kappa = (slope * axis).sum(axis=0) - 1, np.diff(psi) / h
        gamma = slope[1] * axis[0] - slope[0] * axis[1]
        stored = 5e3 * (eps**2 + gamma**2) + 50 * (1 - damage.x.array) * kappa**2
        rows.append(h * stored.sum())

    run = problem.run if moves else lambda steps, **options: problem.run(10, **options)
    solution = run(10 * DT, after=note, update=grow)
    np.testing.assert_allclose(solution.energy.strain[1:], rows, rtol=1e-10)
    assert damage.x.array.max() > 0.01 and len(used) == 10
    if moves:
        assert solution.energy.dissipated[-1] > 1e-3 * solution.energy.work[-1]
        assert abs(solution.energy.balance_error).max() < 1e-11
        later = problem.run(12 * DT, update=grow).energy  # goes on from what is lost
        assert later.dissipated[0] == solution.energy.dissipated[-1]
    if not moves:  # N, Q and M are those of the step: of an end load
        M = solution.resultants(beam).M[-1]
        lever = solution.position(beam.end)[-1, 0] - np.convolve(
            solution.q[-1][:, 0] + np.linspace(0, 1, 5), [0.5, 0.5], "valid"
        )
        np.testing.assert_allclose(M, -20.0 * lever, rtol=1e-8)


class VonKarman(fb.Resultants):
    """The theory of moderate deflections along x, with strains u' + w'^2/2, w' - psi, psi'."""

    def virtual_work(self, step):
        slope, bent = step.prime(step.u0 + step.Du)[1], step.prime(step.virtual_psi)
        du, dw = step.prime(step.virtual_u)
        return self.N * (du + slope * dw) + self.Q * (dw - step.virtual_psi) + self.M * bent


def von_karman(step, law):
    du, dw = step.prime(step.u0 + step.Du)
    psi = step.psi0 + step.Dpsi
    N, Q, M = law.resultants(du + dw**2 / 2, dw - psi, step.prime(psi))
    return VonKarman(step.t0, step.t0, N, Q, M, m=M)


def test_a_theory_of_ones_own_is_a_class_with_its_virtual_work():
    """Cantilever: w of linear theory, by 8 elements with one Gauss point, and u of its slopes."""
    n, F = 8, -30.0
    scene, beam = cantilever(n)
    scene.add_force(beam.end, (0, F))
    equilibrium = fenicsx.Equilibrium(scene)
    equilibrium.replace_resultants(von_karman)
    solution = equilibrium.run(load_steps=2)
    u, w, _ = solution.q[-1].T
    assert w[-1] == pytest.approx(F / 300 * (1 - 1 / (4 * n**2)) + F / 1e4, rel=1e-9)
    np.testing.assert_allclose(np.diff(u), -n * np.diff(w) ** 2 / 2, rtol=1e-9)
    assert np.isnan(solution.energy.strain).all()
    scheme = fb.Scheme("von Karman", von_karman, fb.NewmarkRates(0.25, 0.5))
    here = fenicsx.Problem(scene, scheme, dt=DT).run(T_END)
    assert_same(here, fb.simulate(scene, scheme, dt=DT, t_end=T_END), 1e-11)


def mean_slope_theory(step, strains, stiffnesses):
    """Virtual work of von Karman's theory with mean slopes: the energy is exact in each step."""
    ends = (step.u0, step.psi0), (step.u0 + step.Du, step.psi0 + step.Dpsi)
    e0, e1 = (strains(step, *end) for end in ends)
    N, Q, M = (C * (a + b) / 2 for C, a, b in zip(stiffnesses, e0, e1, strict=True))
    (du, dw), slope = step.prime(step.virtual_u), step.prime(step.u0 + step.Du / 2)[1]
    turning = Q * (dw - step.virtual_psi) + M * step.prime(step.virtual_psi)
    stored = sum(C * e**2 for C, e in zip(stiffnesses, e1, strict=True)) / 2
    return N * (du + slope * dw) + turning, stored


def von_karman_strains(step, u, psi):
    du, dw = step.prime(u)
    return du + dw**2 / 2, dw - psi, step.prime(psi)


def test_a_form_of_ones_own_with_its_energy_is_a_scheme_with_its_strains():
    class MeanSlope(fb.Resultants):
        def virtual_work(self, step):
            return mean_slope_theory(step, von_karman_strains, (1e4, 1e4, 100.0))[0]

    def resultants(step, law):
        means = [(a + b) / 2 for a, b in zip(step.strains0, step.strains1, strict=True)]
        return MeanSlope(step.t0, step.t0, *law.resultants(*means), m=0.0)

    scene, beam = cantilever(4)
    scene.add_force(beam.end, (0, -30.0))
    rates = fb.NewmarkRates(0.25, 0.5, 0.5, 0.5)
    own = fb.Scheme("own", resultants, rates, strains=von_karman_strains)
    engine = fb.simulate(scene, own, dt=DT, t_end=T_END)
    assert engine.energy.strain.max() > 0.5
    assert abs(engine.energy.balance_error).max() < 1e-11
    # Their formulas, of what each element has in its middle.
    q, h = engine.q, 1 / 4
    (du, dw, bend), psi = np.moveaxis(np.diff(q, axis=1) / h, -1, 0), q[..., 2]
    shear = dw - (psi[:, 1:] + psi[:, :-1]) / 2
    squares = 1e4 * (du + dw**2 / 2) ** 2 + 1e4 * shear**2 + 100 * bend**2
    np.testing.assert_allclose(engine.energy.strain, h / 2 * squares.sum(axis=1), rtol=1e-10)
    with pytest.raises(ValueError, match="your own"):
        fb.plot.shapes(engine, colour="strain energy")

    problem = fenicsx.Problem(scene, fb.Scheme("plain", resultants, rates), dt=DT)
    work, stored = mean_slope_theory(problem.step, von_karman_strains, (1e4, 1e4, 100.0))
    problem.replace_form(work * problem.dx, energy=stored * problem.dx)
    solution = problem.run(T_END)
    assert_same(solution, engine, 1e-11)
    np.testing.assert_allclose(solution.energy.strain, engine.energy.strain, atol=1e-12)
    assert problem.energies()["strain"] == pytest.approx(engine.energy.strain[-1], rel=1e-10)
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert np.isnan(solution.resultants(beam).M).all()  # they are in no form
    assert [part.arguments() for part in problem.parts] == [(problem.test,)]


def test_a_form_may_be_the_derivative_of_a_potential():
    """Along a bar N = k (e^eps - 1), so that an end force gives eps in closed form."""
    scene, bar = clamped_bar((1, 0), SECTION, 2)
    scene.add_force(bar.end, (2e3, 0.0))
    equilibrium = fenicsx.Equilibrium(scene)
    u, psi = (
        equilibrium.step.u0 + equilibrium.step.Du,
        equilibrium.step.psi0 + equilibrium.step.Dpsi,
    )
    eps, slope = equilibrium.step.prime(u)
    stored = 1e3 * (ufl.exp(eps) - 1 - eps) + 1e4 * (
        slope**2 + psi**2 + equilibrium.step.prime(psi) ** 2
    )
    Pi = stored * equilibrium.dx
    equilibrium.replace_form(ufl.derivative(Pi, equilibrium.increment, equilibrium.test), energy=Pi)
    solution = equilibrium.run(4)
    assert solution.displacement(bar.end)[-1, 0] == pytest.approx(np.log(3.0), rel=1e-9)
    assert equilibrium.energies()["strain"] == pytest.approx(2e3 - 1e3 * np.log(3.0), rel=1e-9)


def test_what_is_no_whole_form_is_refused_with_a_sentence():
    scene, _, _ = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    step, dx = problem.step, problem.dx
    F, k = ufl.dot(step.Du, step.virtual_u) * dx, fem.Constant(problem.mesh, 1.0)
    assert_refused("must be linear", problem.replace_form, k * dx)
    assert_refused("a form without test functions", problem.replace_form, F, energy=F)
    assert_refused("energy", problem.replace_form, F, energy=1.0)
    problem.advance()  # as before
    engine = fb.simulate(scene, dt=DT, t_end=DT)
    np.testing.assert_allclose(problem.system.T.shape[0], engine.q[-1].size)
    damped = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1, retardation=0.01)
    for section, scheme in ((damped, None), (SECTION, fb.EnergyDecaying())):
        scene, _ = clamped_bar((1, 0), section, 2)
        problem = fenicsx.Problem(scene, scheme, dt=DT)
        F = ufl.dot(problem.step.Du, problem.step.virtual_u) * problem.dx
        assert_refused("would be counted", problem.replace_form, F)
    assert_refused("would be counted", problem.replace_resultants, von_karman)


def test_a_problem_is_written_with_the_names_of_its_fields():
    scene, beam = cantilever()
    problem = fenicsx.Problem(scene, fb.MidPoint(), dt=DT)
    damage, k = problem.function("damage"), fem.Constant(problem.mesh, 50.0)

    def damaged(step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(M=(1 - damage) * r.M, m=(1 - damage) * r.m)

    problem.replace_resultants(damaged)
    step = problem.step
    problem.add(k * ufl.dot(step.u, step.virtual_u) * problem.dx)
    problem.add(-ufl.max_value(0, step.u[1]) * step.virtual_u[1] * problem.measure(beam.end))
    lines = [line.split(" = ", 1)[1] for line in problem.written().splitlines()]
    assert "(1 - damage) EI kappa_m" in lines
    assert lines[-2:] == ["50 u . delta_u", "(-max(0, u[1])) delta_u[1]"]
    problem.replace_form(damage * ufl.dot(step.Du, step.virtual_u) * problem.dx)
    assert problem.written().splitlines()[0] == "delta_W = damage Delta_u . delta_u"


def test_printed_forms_have_the_names_of_functions_and_constants():
    scene, beam = cantilever()
    scene.add_drag(beam, linear=0.1)
    problem = fenicsx.Problem(scene, fb.Newmark(), dt=DT)
    problem.add(-problem.step.t * problem.step.virtual_u[1] * problem.dx)
    text = " ".join(map(str, [*problem.parts, problem.F_inertia]))
    names = "start increment stiffness velocity acceleration drag_linear dt time rhoA_rhoI"
    assert {*names.split()} <= {*re.findall(r"\w+", text)}
    assert not re.findall(r"\b(f|[wc]_?\d+)\b", text)


def test_numbers_are_expressions():
    scene, _ = cantilever(3)
    problem = fenicsx.Problem(scene, dt=DT)
    assert list(problem.interpolate(0 * problem.step.X[0]).x.array) == [0, 0, 0]
    np.testing.assert_array_equal(problem.at_points(2.5, [0.0, 1.0]), np.full((3, 2), 2.5))
    for degree in (1, 2):
        problem = fenicsx.Problem(pair(degree)[0], dt=DT)
        function = problem.function("alpha", (2,))
        assert function.name == "alpha" and function.x.array.shape == (7 * degree * 2,)
        assert not function.x.array.any()
        vector = problem.interpolate(problem.step.X)
        assert vector.function_space.element == function.function_space.element
    assert_refused("a scalar or a vector", problem.interpolate, ufl.zero(2, 2))
    for expression, points in (([1.0, 2.0], None), ([], None), (0.0, [0.5, 1.1]), (0.0, [np.nan])):
        assert_refused("fenicsx: (expression|points)", problem.at_points, expression, points)


def test_without_their_energy_replaced_resultants_have_none_in_a_solution():
    scene, _ = cantilever()
    problem = fenicsx.Problem(scene, dt=DT)
    problem.replace_resultants(fb.EnergyMomentum().resultants)
    assert np.isnan(problem.run(2 * DT).energy.strain).all()


def test_strains_by_a_field_of_another_problem_are_natural_strains():
    scene, first, second = pair()
    for beam in (first, second):
        scene.add_natural_strain(beam, axial=0.0)
    problem = fenicsx.Problem(scene, dt=DT)
    heat = fem.Function(space(problem.mesh, ("Lagrange", 1)))
    problem.natural_strains = (1e-3 * heat, 0, 2e-2 * heat)

    def warm(problem):
        heat.x.array[:] = 10 * (problem.t + DT)

    heat.x.array[:] = 10 * DT
    solution = problem.run(T_END, after=warm)
    same, *beams = pair()
    for beam in beams:
        same.add_natural_strain(beam, axial=lambda t: 1e-2 * t, curvature=lambda t: 0.2 * t)
    engine = fb.simulate(same, dt=DT, t_end=T_END)
    assert_same(solution, engine, 1e-11)
    assert abs(solution.energy.balance_error).max() < 1e-12 * engine.energy.kinetic.max()
    with pytest.raises(fb.SceneError, match="add_natural_strain"):
        fenicsx.Problem(pair()[0], dt=DT).natural_strains = (0, 0, 0)


def test_natural_strains_may_be_numbers():
    scene, beam = cantilever()
    scene.add_natural_strain(beam, axial=0.0)
    problem = fenicsx.Problem(scene, dt=DT)
    problem.natural_strains = (0.01, 0, 0.2)
    solution = problem.run(5 * DT)
    same, beam = cantilever()
    # They arise in the first step, which starts with those of the scene.
    same.add_natural_strain(beam, axial=lambda t: 0.01 * (t > 0), curvature=lambda t: 0.2 * (t > 0))
    engine = fb.simulate(same, dt=DT, t_end=5 * DT)
    assert_same(solution, engine, 1e-11)


# -- Steps, starts, solvers ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"pc_factor_mat_solver_type": "mumps"},
        {"ksp_type": "gmres", "pc_type": "ilu", "ksp_rtol": 1e-13},
        {"snes_rtol": 1e-13, "snes_stol": 0, "snes_linesearch_type": "bt"},
    ],
    ids=["MUMPS", "GMRES", "line search"],
)
def test_a_solver_of_petsc_may_be_chosen(options):
    scene, *_ = pair()
    problem = fenicsx.Problem(scene, dt=DT, petsc_options=options)
    solution = problem.run(5 * DT)
    engine = fb.simulate(scene, dt=DT, t_end=5 * DT)
    np.testing.assert_allclose(solution.q, engine.q, rtol=0, atol=1e-9)
    assert problem.snes.ksp.getType() == options.get("ksp_type", "preonly")


@pytest.mark.parametrize(
    "options",
    [{"snes_linesearch_type": kind} for kind in ("bt", "l2", "cp")] + [{"snes_type": "newtontr"}],
    ids=lambda options: next(iter(options.values())),
)
def test_a_search_ends_where_the_forces_are_in_balance_already(options):
    """It cannot lower a residual of zero or of round-off, and called this a failure."""
    scene, beam = cantilever()
    scene.add_force(beam.end, (0, -5.0))
    equilibrium = fenicsx.Equilibrium(scene, petsc_options=options)
    state = equilibrium.run(load_steps=2)  # from load factor 0
    engine = fb.static(scene, load_steps=2)
    np.testing.assert_allclose(state.q, engine.q, rtol=0, atol=1e-9)
    again = equilibrium.run(load_steps=1)  # from 1 to 1
    np.testing.assert_allclose(again.q, 0 * again.q + engine.q[-1], rtol=0, atol=1e-9)
    problem = fenicsx.Problem(scene, dt=DT, petsc_options=options)
    problem.start_from(engine)
    at_rest = problem.run(5 * DT)
    np.testing.assert_allclose(at_rest.q, 0 * at_rest.q + engine.q[-1], rtol=0, atol=1e-9)


def test_a_method_of_petsc_has_as_many_iterations_as_it_needs():
    """A trust region takes more than three, in PETSc 3.22 forty times as many for -2.5 N."""
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=10.0), 6)
    scene.add_force(beam.end, (0, -1.0))
    newton = fenicsx.Equilibrium(scene)
    newton.advance(1.0)
    few, most = fb.NewtonOptions(max_iterations=3), {"snes_max_it": 12}
    with pytest.raises(fb.StepError, match="no convergence in 2 iterations"):
        fenicsx.Equilibrium(scene, petsc_options={"snes_max_it": 2}).advance(1.0)
    for options in ({"snes_type": "newtontr"}, most):
        other = fenicsx.Equilibrium(scene, petsc_options=options, newton=few)
        other.advance(1.0)
        np.testing.assert_allclose(other.q.x.array, newton.q.x.array, rtol=0, atol=1e-9)


def test_a_correction_that_is_not_finite_is_no_loop_that_cannot_be_closed():
    scene, _ = cantilever()
    problem = fenicsx.Problem(scene, dt=DT)
    with problem.begin() as step, pytest.raises(fb.StepError) as failed:
        step.y.set(np.inf)
        step.accept(step.y)
    assert "loop of joints" not in str(failed.value)


def direct():
    """A solver by the factors of a matrix."""
    ksp = PETSc.KSP().create()
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    return ksp


def found_by_hand(step, corrections=8):
    ksp, y = direct(), step.y.copy()
    r, dy = y.duplicate(), y.duplicate()
    for _ in range(corrections):
        step.residual(y, r)
        ksp.setOperators(step.tangent(y))
        ksp.solve(r, dy)
        y.axpy(-1, dy)
    return y


def test_steps_may_be_found_by_a_method_of_ones_own():
    scene, _, second = pair()
    rod = scene.add_beam([(2.1, 0), (2.5, -0.5)], SECTION, 2)
    scene.add_joint(fb.Prismatic(second.end, rod.start, axis=(1, 0.2), offset=(0.1, 0)))
    engine = fb.simulate(scene, dt=DT, t_end=T_END)
    problem = fenicsx.Problem(scene, dt=DT)
    for _ in range(STEPS):
        with problem.begin() as step:
            pass  # nothing is accepted
        with problem.begin() as step:
            step.accept(found_by_hand(step))
    assert problem.t == pytest.approx(T_END)
    q = np.zeros(engine.q[-1].size)
    q[problem.system.dofs] = problem.q.x.array
    beams = np.unique(problem.system.dofs)
    np.testing.assert_allclose(q[beams], engine.q[-1].ravel()[beams], rtol=0, atol=1e-11)
    assert_refused("the step has ended", step.tangent, step.y)
    with problem.begin() as step:
        far = step.y.copy()
        far.set(10.0)
        with pytest.raises(fb.StepError):
            step.accept(far)
    assert problem.t == pytest.approx(T_END)
    composed = fenicsx.Problem(scene, fb.EnergyMomentum(order=4), dt=DT)
    assert_refused("has sub-steps", composed.begin)


def test_an_arc_length_of_ones_own_passes_a_limit_point():
    """Two bars that snap through: F = 2 EA (1 - l/L) height/l, Crisfield's method in y and load."""
    scene, h = fb.Scene(), 0.3
    bars = [scene.add_beam([(x, 0), (0, h)], SECTION, elements=1) for x in (-1, 1)]
    scene.add_joint(fb.Revolute(bars[0].end, bars[1].end))
    for bar in bars:
        scene.pin(bar.start)
    F = 1e3
    scene.add_force(bars[0].end, (0, -F))
    equilibrium, ksp, radius, path = fenicsx.Equilibrium(scene), direct(), 0.05, [(0.0, 0.0)]
    assert_refused("no residual was found", equilibrium.load_derivative)
    on = None  # the last step
    for _ in range(22):
        load = equilibrium.load_factor
        for correction in range(8):
            with equilibrium.begin(load) as step:
                if correction == 0:
                    y = step.y.duplicate()
                r, a, v = (y.duplicate() for _ in range(3))
                step.residual(y, r)
                slope = equilibrium.load_derivative()
                ksp.setOperators(step.tangent(y))
                ksp.solve(r, a)
                ksp.solve(-slope, v)  # dy by the load factor
            if correction == 0:
                change = radius / v.norm() * (1.0 if on is None or v.dot(on) > 0 else -1.0)
            else:  # y.y stays the square of the radius
                change = ((radius**2 - y.dot(y)) / 2 + y.dot(a)) / y.dot(v)
            y.axpy(-1, a)
            y.axpy(change, v)
            load += change
        with equilibrium.begin(load) as step:
            step.residual(y, r)
            assert r.norm() < 1e-7
            step.accept(y)
        on = y.copy()
        q = np.zeros(equilibrium.system.T.shape[0])
        q[equilibrium.system.dofs] = equilibrium.q.x.array
        path.append((-q[3 * bars[0].end.number + 1], load))
    w, loads = np.array(path).T
    L, length = np.hypot(1, h), np.hypot(1, h - w)
    np.testing.assert_allclose(F * loads, 2e4 * (1 - length / L) * (h - w) / length, atol=1e-6)
    assert loads.max() > loads[-1] and loads.min() < 0  # past both limit points
    assert w[-1] > h


def test_nodal_rules_of_a_user_are_those_of_the_engine():
    def rule(D, v0, a0, before, dt):
        path = ufl.as_vector((D[0], D[1], 2 * ufl.tan(D[2] / 2)))
        v1 = 2 * path / dt - v0
        return (v1 - v0) / dt, v1, (v1 - v0) / dt

    scheme = fb.Scheme("own", fb.MidPoint().resultants, fb.NodalRates(rule))
    scene, *_ = pair()
    solution = fenicsx.Problem(scene, scheme, dt=DT).run(T_END)
    assert_same(solution, fb.simulate(scene, scheme, dt=DT, t_end=T_END), 1e-11)


@pytest.mark.parametrize("moves", [True, False])
def test_a_rope_that_leaves_its_pulley_and_pulls_ends_the_run(moves):
    scene, bar = clamped_bar((1, 0), SECTION, elements=1)
    ball = scene.add_body((2, 0), 1.0, 0.1).centre
    scene.fix(ball, "rotation")
    pulley = fb.Pulley((1, -0.1), 0.2, "right")
    scene.add_rope([(0, 0), pulley, ball], fb.Spring(1.0, rest=2.0))
    scene.add_spring(ball, x=fb.Spring(1.0), y=fb.Spring(1.0))
    scene.add_force(ball, (0.0, 2.0))
    with pytest.raises(fb.StepError, match="leaves the pulley at point 1") as failed:
        fenicsx.Problem(scene, dt=0.02).run(1.0) if moves else fenicsx.Equilibrium(scene).run(10)
    assert failed.value.solution.q[-1, ball.number, 1] > 0.2


def test_a_motion_goes_on_from_the_engine_and_in_it():
    scene, *_ = pair()
    whole = fb.simulate(scene, dt=DT, t_end=2 * T_END)
    problem = fenicsx.Problem(scene, dt=DT)
    problem.start_from(fb.simulate(scene, dt=DT, t_end=T_END))
    longer = problem.run(2 * T_END)
    np.testing.assert_allclose(longer.q[-1], whole.q[-1], rtol=0, atol=1e-12)
    back = fb.simulate(scene, dt=DT, t_end=3 * T_END, start=longer)
    assert abs(back.energy.balance_error).max() < 1e-12
    problem.start_from(whole, row=STEPS)
    assert problem.t == pytest.approx(T_END)
    again = problem.run(2 * T_END)
    np.testing.assert_allclose(again.q[-1], whole.q[-1], rtol=0, atol=1e-12)


def test_a_state_may_be_set_by_functions():
    (scene, _), (same, beam) = cantilever(8), cantilever(8)
    same.set_velocity(beam, lambda x, y: (0.0, x**2), spin=lambda x, y: 2 * x)
    problem = fenicsx.Problem(scene, dt=DT)
    v = fem.Function(problem.V)
    v.sub(0).interpolate(lambda x: (0 * x[0], x[0] ** 2))
    v.sub(1).interpolate(lambda x: 2 * x[0])
    problem.set_state(v=v)
    assert_same(problem.run(T_END), fb.simulate(same, dt=DT, t_end=T_END))


def test_a_state_may_be_set_by_arrays():
    """A shape that a force has bent, which is let go: its energy is that of the engine."""
    scene, first, second = pair()
    loaded, arm, rod = pair()
    loaded.pin(rod.end)
    loaded.add_force(arm.end, (0, -30.0))
    bent = fb.static(loaded, load_steps=4)
    problem = fenicsx.Problem(scene, dt=DT)
    problem.run(3 * DT)
    problem.set_state(q=bent.q[-1])
    at_start = problem.energies()
    assert at_start["strain"] == pytest.approx(bent.energy.strain[-1], rel=1e-10)
    assert at_start["kinetic"] == 0.0
    solution = problem.run(T_END)
    engine = fb.simulate(scene, dt=DT, t_end=T_END - 3 * DT, start=bent)
    np.testing.assert_allclose(solution.q, engine.q, rtol=0, atol=1e-11)
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_what_joints_and_supports_say_holds_in_a_state_that_is_set():
    scene, first, second = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    rng = np.random.default_rng(0)
    q, v = rng.normal(size=(2, len(scene.nodes), 3)) * 0.05
    problem.set_state(q, v)
    rows, rates = np.empty((2, q.size))
    rows[problem.system.dofs], rates[problem.system.dofs] = problem.q.x.array, problem.v.x.array
    rows, rates = rows.reshape(q.shape), rates.reshape(q.shape)
    pin, a, b = (node.number for node in (first.start, first.end, second.start))
    for values in (rows, rates):
        np.testing.assert_allclose(values[pin, :2], 0, atol=1e-15)
        np.testing.assert_allclose(values[a, :2], values[b, :2], atol=1e-12)
    free = np.delete(np.arange(len(q)), [pin, a, b])
    np.testing.assert_allclose(rows[free], q[free], atol=1e-15)
    assert abs(problem.run(5 * DT).energy.balance_error).max() < 1e-10


def test_what_is_written_into_the_state_is_refused_and_not_lost():
    scene, _ = cantilever()
    for make in (lambda: fenicsx.Problem(scene, dt=DT), lambda: fenicsx.Equilibrium(scene)):
        for name in "qva":
            problem = make()
            getattr(problem, name).sub(1).interpolate(lambda x: 1 + x[0])
            assert_refused(f"written into {name} ", problem.advance, 0.1)
        for number in ("dt", "t", "load_factor"):
            problem = make()
            problem.advance(0.1)
            getattr(problem.step, number).value = 0.07
            assert_refused("written into (dt|time|load_factor) ", problem.advance, 0.2)
        for name in ("u", "start", "increment", "stiffness"):
            for begun in (False, True):
                problem = make()
                functions = {c.name: c for c in problem.F.coefficients()} | {"u": problem.u}
                if begun:
                    problem.advance(0.1)
                functions[name].x.array[-1] = 1.0
                assert_refused(f"written into {name} ", problem.advance, 0.2)
    problem = fenicsx.Problem(scene, dt=DT)
    for value in (
        np.zeros((3, 3)),
        np.full((5, 3), np.nan),
        fem.Function(problem.u.function_space),
    ):
        assert_refused("set_state: [qv]", problem.set_state, value)
        assert_refused("set_state: [qv]", problem.set_state, None, value)


def test_a_step_that_fails_says_dt_and_leaves_all_as_it_was():
    scene, *_ = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    problem.advance()
    before = problem.q.x.array.copy()
    assert_refused(r"t = 0.01 to 5.01 failed.*smaller dt", problem.advance, 5.0, error=fb.StepError)
    assert problem.t == DT and np.array_equal(problem.q.x.array, before)
    problem.advance()
    assert problem.t == pytest.approx(2 * DT)


def test_a_term_that_is_not_finite_is_said_to_be():
    scene, _ = cantilever()
    problem = fenicsx.Problem(scene, dt=DT)
    step = problem.step
    problem.add(step.u[0] / abs(step.psi) * step.virtual_psi * problem.measure())  # 0 / 0
    assert_refused("a value is not finite", problem.advance, error=fb.StepError)


def test_a_step_that_fails_may_be_halved():
    scene, *_ = pair()
    long = 1.2
    with pytest.raises(fb.StepError) as failed:
        fenicsx.Problem(scene, dt=long).run(2 * long)
    assert failed.value.solution.t[0] == 0.0
    problem = fenicsx.Problem(scene, dt=long, max_halvings=6)
    solution = problem.run(2 * long)
    assert solution.stats.halvings > 0 and solution.t[-1] == pytest.approx(2 * long)
    assert abs(solution.energy.balance_error).max() < 1e-10


def test_compiling_leaves_logging_as_it_was():
    root = logging.getLogger()
    before = root.level, root.handlers[:], root.manager.disable
    fenicsx.Problem(pair()[0], dt=DT)
    assert (root.level, root.handlers[:], root.manager.disable) == before


def test_steps_do_not_keep_memory():
    resource = pytest.importorskip("resource")
    problem = fenicsx.Problem(pair()[0], dt=1e-4)
    for _ in range(30):
        problem.advance()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(300):  # what petsc4py keeps of a single iteration has 85 kB
        problem.advance()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20e3


def test_a_beam_of_many_elements_is_that_of_the_engine():
    # The keys of 47 000 unknowns, row n + column, do not fit into 32 bits.
    scene, _ = pinned_bar((160, 0), SECTION, 16_000, gravity=(0, -9.81))
    solution = fenicsx.Problem(scene, dt=DT).run(DT)
    assert_same(solution, fb.simulate(scene, dt=DT, t_end=DT), 1e-9)


# -- Statics ---------------------------------------------------------------------------------------


def test_equilibria_are_those_of_the_engine():
    scene, first, second = pair()
    scene.pin(second.end)
    scene.add_force(first.end, (0, -30.0))
    engine = fb.static(scene, load_steps=4)
    solution = fenicsx.Equilibrium(scene).run(load_steps=4)
    np.testing.assert_allclose(solution.q, engine.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(solution.reactions, engine.reactions, rtol=0, atol=1e-8)
    assert list(solution.unstable_modes) == list(engine.unstable_modes)
    longer = fb.simulate(scene, dt=DT, t_end=5 * DT, start=solution)
    assert abs(longer.q - longer.q[0]).max() < 1e-11  # it rests


def test_a_column_above_its_critical_load_is_said_to_be_unstable(caplog):
    critical = np.pi**2 * 100.0 / 4  # Euler's, of EI = 100 and a length of 1; shear lowers it
    for factor, modes in ((0.9, 0), (1.1, 1)):
        scene, beam = cantilever(16)
        scene.add_force(beam.end, (-factor * critical, 0))
        equilibrium = fenicsx.Equilibrium(scene)
        equilibrium.run(load_steps=4)
        assert equilibrium.unstable_modes() == modes
        pytest.importorskip("slepc4py")
        assert (equilibrium.eigenvalues(3).real < 0).sum() == modes
    assert "unstable" in caplog.text


def test_squares_of_frequencies_are_those_of_modes():
    pytest.importorskip("slepc4py")
    scene, beam = cantilever(8)
    scene.add_force(beam.end, (0, -50.0))
    equilibrium = fenicsx.Equilibrium(scene)
    state = equilibrium.run(load_steps=2)
    modes = fb.modes(scene, state=state, n=3)
    omega = 2 * np.pi * modes.frequencies
    np.testing.assert_allclose(equilibrium.eigenvalues(3).real, omega**2, rtol=1e-6)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(-0.2)])
def test_modes_are_those_of_the_engine_with_shapes_of_modal_mass_one(scheme):
    pytest.importorskip("slepc4py")

    def sliding(**laws):
        scene, beam = cantilever(8)
        rod = scene.add_beam([(1, 0), (1, -0.5)], SECTION, 3)
        laws["spring"] = fb.Spring(50.0)
        scene.add_joint(fb.Prismatic(beam.end, rod.start, axis=(1, 0.2), **laws))
        scene.add_force(beam.end, (0, -50.0))
        return scene

    plain, scene = sliding(), sliding(damper=fb.Damper(0.3))
    state = fb.static(scene, load_steps=2)
    engine = fb.modes(plain, state=fb.static(plain, load_steps=2), n=3).frequencies
    equilibrium = fenicsx.Equilibrium(scene)
    equilibrium.run(load_steps=2)
    modes = equilibrium.modes(3)
    np.testing.assert_allclose(modes.frequencies, engine, rtol=1e-6)
    problem = fenicsx.Problem(scene, scheme, dt=DT)
    problem.start_from(state)
    moving = problem.modes(3)
    np.testing.assert_allclose(moving.frequencies, engine, rtol=1e-6)
    mass = problem.system.M
    for shape in moving.functions:
        x, y = mass.createVecs()
        x.array[problem.system.dofs] = shape.x.array
        mass.mult(x, y)
        assert x.dot(y) == pytest.approx(1.0)
    problem.run(T_END)  # as without modes
    problem.add(problem.step.u[0] * problem.step.virtual_u[0] * problem.dx)
    assert_refused("Use Equilibrium.modes", problem.modes)


def test_modes_that_grow_are_refused_and_a_foundation_is_in_others():
    pytest.importorskip("slepc4py")
    scene, bar = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=2.0), 8)
    scene.add_force(bar.end, (-4.0, 1e-3))
    equilibrium = fenicsx.Equilibrium(scene)
    equilibrium.advance(1.0)
    assert_refused("a motion grows", equilibrium.modes)
    # On a foundation k all squares of frequencies are greater by k / rhoA, but for rotary inertia.
    before, step = equilibrium.eigenvalues(2).real, equilibrium.step
    equilibrium.add(400.0 * ufl.dot(step.u, step.virtual_u) * equilibrium.measure(points=2))
    equilibrium.advance(1.0 + 1e-9)
    after = (2 * np.pi * equilibrium.modes(2).frequencies) ** 2
    np.testing.assert_allclose(after, before + 200.0, rtol=2e-3)


# -- Meshes ----------------------------------------------------------------------------------------


def test_a_mesh_of_dolfinx_is_beams_with_sections_by_tags():
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_mesh([(0, 0), (1, 0), (1, 1)], [(0, 1), (1, 2), (2, 0)], SECTION)
    scene.clamp(first.nodes[0])
    mesh = fenicsx.Problem(scene, dt=DT).mesh
    cells = np.arange(3, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, 1, cells, np.array([4, 4, 5], dtype=np.int32))
    again, stiff = fb.Scene(gravity=(0, -9.81)), fb.Section(EA=2e4, GA=2e4, EI=200.0, rhoA=1.0)
    beams = fenicsx.beams_of(again, mesh, {4: SECTION, 5: stiff}, tags, joints="rigid")
    assert [beam.section for beam in beams] == [SECTION, SECTION, stiff]
    for node, x in zip(beams.nodes, mesh.geometry.x, strict=True):
        assert (node.x, node.y) == tuple(x[:2])
    with pytest.raises(fb.SceneError, match="tag -2147483648"):
        few = dolfinx.mesh.meshtags(mesh, 1, cells[:1], np.array([4], dtype=np.int32))
        fenicsx.beams_of(fb.Scene(), mesh, {4: SECTION}, few)
    square = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    assert_refused("straight intervals", lambda: fenicsx.beams_of(fb.Scene(), square, SECTION))


def branches(order):
    """A mesh of three lines from one point, two of them with the tag 2."""
    X = np.array([(0, 0), (1, 0), (2, 0.5), (1, 1.0)])
    cells = np.array([(0, 1), (1, 2), (1, 3)])
    if order == 2:
        X, cells = np.vstack([X, X[cells].mean(axis=1)]), np.column_stack([cells, 4 + np.arange(3)])
    mesh = create_mesh(MPI.COMM_SELF, cells, X, lagrange(order, 2))
    numbers = np.asarray(mesh.topology.original_cell_index)
    tags = np.array([1, 2, 2], np.int32)[numbers]
    return mesh, dolfinx.mesh.meshtags(mesh, 1, np.arange(3, dtype=np.int32), tags)


@pytest.mark.parametrize("order", [1, 2])
def test_a_mesh_of_ones_own_is_that_of_the_problem(order):
    mesh, tags = branches(order)
    scene = fb.Scene(gravity=(0, -9.81))
    beams = fenicsx.beams_of(scene, mesh, SECTION, tags, elements=1)
    assert {beam.degree for beam in beams} == {order}
    assert sorted(beam.end.x for beam in beams.tagged(2)) == [1.0, 2.0]
    assert_refused("no cell has the tag 3", beams.tagged, 3)
    left = dolfinx.mesh.locate_entities(mesh, 0, lambda x: x[0] < 1e-9).astype(np.int32)
    points = dolfinx.mesh.meshtags(mesh, 0, left, np.array([7], np.int32))
    (node,) = beams.nodes_of(points, 7)
    assert (node.x, node.y) == (0.0, 0.0)
    assert_refused("no point has the tag 8", beams.nodes_of, points, 8)
    assert_refused("those of points", beams.nodes_of, tags, 2)
    scene.clamp(node)
    engine = fb.simulate(scene, dt=DT, t_end=T_END)
    problem = fenicsx.Problem(scene, dt=DT, mesh=mesh)
    assert problem.mesh is mesh
    assert_same(problem.run(T_END), engine, 1e-11)
    stiffness = fem.Function(space(mesh, ("Lagrange", 1)))
    stiffness.x.array[:] = 5.0
    equilibria = fenicsx.Equilibrium(scene, mesh=mesh), fenicsx.Equilibrium(scene)
    for k, equilibrium in zip((stiffness, 5.0), equilibria, strict=True):
        step = equilibrium.step
        equilibrium.add(k * ufl.dot(step.u, step.virtual_u) * equilibrium.dx)
    own, made = (equilibrium.run(2).q for equilibrium in equilibria)
    np.testing.assert_allclose(own, made, rtol=0, atol=1e-12)


def test_a_mesh_with_other_cells_is_refused_and_mapped():
    mesh, _ = branches(1)
    for options in ({"elements": 2}, {"elements": 1, "joints": "pin"}):
        scene = fb.Scene()
        beams = fenicsx.beams_of(scene, mesh, SECTION, **options)
        scene.clamp(beams[0].start)
        assert_refused("are not the elements", fenicsx.Problem, scene, dt=DT, mesh=mesh)
        cells = fenicsx.Problem(scene, dt=DT).cell_map
        assert sorted(cells) == sorted(options["elements"] * [0, 1, 2])
    X, cells = np.array([(0, 0), (1, 0), (0.5, 0.1)]), np.array([(0, 1, 2)])
    bent = create_mesh(MPI.COMM_SELF, cells, X, lagrange(2, 2))
    assert_refused("straight intervals", fenicsx.beams_of, fb.Scene(), bent, SECTION)


def test_a_mesh_that_branches_moves_as_in_the_engine():
    scene = fb.Scene(gravity=(0, -9.81))
    beams = scene.add_mesh([(0, 0), (1, 0), (0, 1), (-1, 0)], [(0, 1), (0, 2), (0, 3)], SECTION, 3)
    scene.clamp(beams.nodes[1])
    solution = fenicsx.Problem(scene, dt=DT).run(T_END)
    assert_same(solution, fb.simulate(scene, dt=DT, t_end=T_END))


# -- Files and pictures ----------------------------------------------------------------------------


def test_displacements_and_moments_go_to_xdmf_and_vtk(tmp_path):
    scene, _, _ = pair()
    problem = fenicsx.Problem(scene, dt=DT)
    with dolfinx.io.XDMFFile(MPI.COMM_SELF, str(tmp_path / "u.xdmf"), "w") as file:
        file.write_mesh(problem.mesh)
        for _ in range(3):
            problem.advance()
            file.write_function(problem.u, problem.t)
    moment = problem.interpolate([resultants[2] for resultants in problem.resultants], name="M")
    with dolfinx.io.VTKFile(MPI.COMM_SELF, str(tmp_path / "u.pvd"), "w") as file:
        file.write_mesh(problem.mesh)
        file.write_function([problem.u], problem.t)
    text = (tmp_path / "u.xdmf").read_text()
    assert text.count("<Time") >= 3 and (tmp_path / "u.pvd").exists()
    engine = fb.simulate(scene, dt=DT, t_end=3 * DT)
    M = np.concatenate([engine.resultants(beam).M[-1] for beam in scene.beams])
    at_middle = problem.at_points([resultants[2] for resultants in problem.resultants])[..., 0]
    np.testing.assert_allclose(at_middle, M, atol=1e-9 * abs(M).max())
    np.testing.assert_allclose(np.sort(moment.x.array), np.sort(M), atol=1e-9 * abs(M).max())


# -- Loading ---------------------------------------------------------------------------------------


def test_only_the_room_loads_dolfinx():
    code = "import sys, fx_beam as fb; fb.simulate; fb.static; print('dolfinx' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_files_of_options_in_the_current_folder_are_not_read_or_named(tmp_path):
    rounded = {"table_atol": 0.6, "epsilon": 0.5}
    other_functions = {"cffi_extra_compile_args": ["-Dcos=sin"]}
    for package, options in {"ffcx": rounded, "dolfinx_jit": other_functions}.items():
        for word in ("parameters", "options"):  # of older and of newer versions
            (tmp_path / f"{package}_{word}.json").write_text(json.dumps(options))
    (tmp_path / ".petscrc").write_text("-snes_max_it 1")
    (tmp_path / "script.py").write_text(
        "import fx_beam as fb\n"
        "from fx_beam.fenicsx import Problem\n"
        "scene = fb.Scene(gravity=(0, -9.81))\n"
        "section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)\n"
        "bar = scene.add_beam([(0, 0), (1, 0)], section, elements=3, degree=2)\n"
        "scene.pin(bar.start)\n"
        "ways = Problem(scene, dt=0.05).run(0.2), fb.simulate(scene, dt=0.05, t_end=0.2)\n"
        "print(abs(ways[0].q - ways[1].q).max())\n"
    )
    run = [sys.executable, "script.py"]
    variables = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run(run, cwd=tmp_path, env=variables, capture_output=True, text=True)
    assert float(done.stdout.split()[0]) < 1e-12  # PETSc 3.22 tells there of options without use
    assert "options of .petscrc in the current folder" in done.stderr
