"""Internal variables: closed solutions, balances, restarts, and refusals."""

import math
import re

import ufl

import numpy as np
import pytest
from scenes import (
    EA,
    EI,
    GA,
    HARDENING,
    INERTIA,
    PLASTIC,
    SOFT,
    STIFF,
    TAU,
    YIELD,
    ZENER,
    assert_refused,
    clamped_bar,
    forces_of_flow,
    plastic_energy,
    plastic_flow,
    with_variables,
    zener_energy,
    zener_flow,
)

import fx_beam as fb

ELASTIC = fb.Section(EA=EA, GA=GA, EI=EI, **INERTIA)
NAME = "plastic curvature"


def isotropic_energy(eps, gamma, kappa, a):
    """Isotropic hardening: a[0] is the plastic curvature, a[1] its length."""
    elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
    return elastic + HARDENING / 2 * a[1] ** 2


def isotropic_flow(old, strains0, strains, dt):
    trial = EI * (strains[2] - old[0])
    flown = ufl.max_value(abs(trial) - YIELD - HARDENING * old[1], 0) / (EI + HARDENING)
    return [old[0] + ufl.sign(trial) * flown, old[1] + flown]


ISOTROPIC = with_variables(isotropic_energy, isotropic_flow, (NAME, "length"), **INERTIA)


def cantilever(material, elements=2):
    return clamped_bar((1, 0), material, elements=elements, degree=1, name="arm")


# -- Closed solutions ------------------------------------------------------------------------------


def _creep(t):
    """Curvature under the bending moment c t, without inertia."""
    all_stiff, rate = STIFF + SOFT, STIFF / (STIFF + SOFT) / TAU
    a = 0.4 / STIFF * (t - (1 - np.exp(-rate * t)) / rate)
    return (0.4 * t + SOFT * a) / all_stiff


def _relaxation(t):
    """Bending moment at the curvature c t."""
    a = 0.8 * (t - TAU * (1 - np.exp(-t / TAU)))
    return STIFF * 0.8 * t + SOFT * (0.8 * t - a)


@pytest.mark.parametrize(
    ("test", "scheme"),
    [("creep", fb.EnergyMomentum()), ("relaxation", fb.EnergyMomentum()), ("creep", fb.Newmark())],
)
def test_a_zener_cantilever_creeps_and_relaxes_with_second_order(test, scheme):
    material = with_variables(zener_energy, zener_flow, ("dashpot",))
    errors = []
    for dt in (0.1, 0.05):
        scene, beam = cantilever(material)
        if test == "creep":
            scene.add_moment(beam.end, lambda t: 0.4 * t)
            solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
            computed, exact = solution.rotation(beam.end)[-1], _creep(1.0)
        else:
            scene.prescribe(beam.end, rotation=lambda t: 0.8 * t)
            solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
            computed, exact = solution.resultants(beam).M[-1, 0], _relaxation(solution.t_level[-1])
        errors.append(abs(computed - exact))
    assert errors[1] < 1e-3
    assert math.log2(errors[0] / errors[1]) > 1.9


@pytest.mark.parametrize("kind", ["plastic", "isotropic"])
def test_the_loop_of_moment_and_curvature_is_exact(kind):
    material = PLASTIC if kind == "plastic" else ISOTROPIC
    scene, beam = cantilever(material, elements=1)
    corners = [0.0, 0.4, -0.5, 0.6, 0.0]
    scene.prescribe(beam.end, rotation=lambda t: float(np.interp(t, range(5), corners)))
    solution = fb.simulate(scene, dt=0.05, t_end=4.0)
    curvatures = np.interp(solution.t, range(5), corners)
    exact = forces_of_flow(curvatures, EI, HARDENING, YIELD, kind == "plastic")[:, None]
    M = EI * (curvatures[:, None] - solution.internal(beam, NAME))
    assert abs(M - exact).max() < 1e-9
    # In a step the moment is the mean of both ends.
    assert abs(solution.resultants(beam).M[1:] - (M[1:] + M[:-1]) / 2).max() < 1e-9
    lost = solution.energy.dissipated
    assert (np.diff(lost) >= 0).all() and lost[-1] > 0.3


def test_load_steps_follow_the_flow_exactly():
    scene, beam = cantilever(PLASTIC)
    scene.add_moment(beam.end, 1.0)
    solution = fb.static(scene, load_steps=10)
    flown = np.maximum(solution.t - YIELD, 0) / HARDENING
    plastic = solution.internal(beam, NAME)
    assert abs(plastic - flown[:, None]).max() < 1e-12
    assert abs(solution.rotation(beam.end) - solution.t / EI - flown).max() < 1e-10
    # A motion that starts there rests.
    motion = fb.simulate(scene, dt=0.05, t_end=0.5, start=solution)
    assert abs(np.diff(motion.internal(beam, NAME), axis=0)).max() < 1e-12
    assert motion.energy.kinetic.max() < 1e-20
    assert abs(motion.a[0]).max() < 1e-6


def test_a_load_step_of_statics_is_the_time_of_the_update():
    scene, beam = cantilever(ZENER)
    scene.prescribe(beam.end, rotation=0.1)
    rows = fb.static(scene, load_steps=1).internal(beam, "dashpot")
    (dashpot,) = {round(x, 12) for x in rows[-1]}
    assert dashpot == pytest.approx(0.1 * (1 / TAU) / (1 + 1 / TAU))


@pytest.mark.parametrize("factor", [1.0, 1.1, 0.5])
def test_what_relaxes_is_followed_by_load_steps_from_a_loaded_state(factor):
    # (STIFF + SOFT) kappa = M + SOFT a at the end of each step, a by implicit Euler steps.
    scene, beam = cantilever(ZENER)
    moment = scene.add_moment(beam.end, 0.5)
    loaded = fb.static(scene, load_steps=4)
    scene.remove(moment)
    scene.add_moment(beam.end, 0.5 * factor)
    path = fb.static(scene, load_steps=20, start=loaded)
    a = loaded.internal(beam, "dashpot")[-1, 0]
    M = 0.5 + 0.5 * (factor - 1) * path.t
    for r, at_end in zip(np.diff(path.t) / TAU, M[1:] / (STIFF + SOFT), strict=True):
        a = (a + r * at_end) / (1 + r - r * SOFT / (STIFF + SOFT))
    assert path.internal(beam, "dashpot")[-1] == pytest.approx(a, rel=1e-9)
    # The work of the moment is stored or dissipated.
    work = ((M[1:] + M[:-1]) / 2 * np.diff(path.rotation(beam.end))).sum()
    change = path.energy.strain + path.energy.dissipated
    assert change[-1] - change[0] == pytest.approx(work, rel=1e-9)


@pytest.mark.parametrize("part", ["section", "spring"])
def test_what_damage_dissipates_in_load_steps_is_of_second_order(part):
    """A bar that is pulled beyond its strength: its force falls from 20 N as exp(-(x - 0.02)/0.1).

    The force that drives the damage, k x^2 / 2, grows with it.
    """
    k, limit, length, end = 1e3, 0.02, 0.1, 0.2

    def damaged(x, a):
        return (1 - a[0]) * k / 2 * x**2

    def damage(old, strains0, strains, dt):
        x = ufl.max_value(abs(strains[0]), limit)
        return [ufl.max_value(old[0], 1 - limit / x * ufl.exp(-(x - limit) / length))]

    def energy(eps, gamma, kappa, a):
        return damaged(eps, a) + GA / 2 * gamma**2 + EI / 2 * kappa**2

    def dissipated(load_steps):
        """Dissipated energy, the error of the balance, and how many steps were halved."""
        if part == "section":
            scene, bar = cantilever(with_variables(energy, damage, ("damage",)), elements=1)
        else:
            scene = fb.Scene()
            bar = scene.add_beam([(0, 0), (1, 0)], ELASTIC, elements=1)
            variables = fb.InternalVariables(("damage",), damage)
            spring = fb.Spring(strain_energy=damaged, internal=variables)
            scene.add_joint(fb.Prismatic(fb.GROUND, bar.start, axis=(1, 0), spring=spring))
        scene.prescribe(bar.end, x=end)
        solution = fb.static(scene, load_steps=load_steps)
        energies = solution.energy
        return energies.dissipated[-1], energies.balance_error[-1], solution.stats.halvings

    fall = math.exp(-(end - limit) / length)
    work = k * limit**2 / 2 + k * limit * length * (1 - fall)
    exact = work - k * limit * fall * end / 2
    assert dissipated(5)[2] < 5
    errors = {n: dissipated(n)[0] - exact for n in (20, 40)}
    assert abs(errors[40]) < 0.01 * exact
    if part == "section":  # whose strain is prescribed
        assert errors[20] / errors[40] == pytest.approx(4, rel=0.05)
    assert abs(dissipated(40)[1]) < 0.01 * exact


# -- Balances --------------------------------------------------------------------------------------


def test_strains_whose_squares_have_no_reciprocal_do_not_fail(monkeypatch):
    # A load at one end has hardly begun: towards the other end strains fall below 1e-155.
    monkeypatch.setenv("CC", "cc")  # optimised code takes reciprocals

    def energy(eps, gamma, kappa, a):
        return 500 * eps**2 + 200 * gamma**2 + 10 * (kappa - a[0]) ** 2

    def flow(old, strains0, strains, dt):
        trial = 20 * (strains[2] - old[0])
        return [old[0] + ufl.sign(trial) * ufl.max_value(abs(trial) - 3, 0) / 20]

    scene, beam = cantilever(with_variables(energy, flow, rhoA=1.0, rhoI=0.01), elements=512)
    scene.add_force(beam.end, lambda t: (0.0, -12 * math.sin(6 * t)))
    for dt in (1e-4, 1e-5):
        solution = fb.simulate(scene, dt=dt, t_end=2 * dt)
        assert solution.stats.halvings == 0
        assert solution.displacement(beam.end)[-1, 1] < 0


def test_a_scene_may_have_several_materials():
    scene = fb.Scene()
    arms = [
        scene.add_beam([(0, 0), (math.cos(a), math.sin(a))], material, elements=3)
        for a, material in ((0, ELASTIC), (2, PLASTIC), (4, ZENER))
    ]
    for arm in arms:
        scene.set_velocity(arm, lambda x, y: (-4 * y * np.hypot(x, y), 4 * x * np.hypot(x, y)))
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.02, t_end=1.0)
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert not solution.variables_of_beam.keys() & {arms[0].name}
    assert abs(solution.internal(arms[1], NAME)).max() > 0.1
    assert abs(solution.internal(arms[2], "dashpot")).max() > 0.005
    with pytest.raises(ValueError, match="no internal variable 'dashpot'"):
        solution.internal(arms[1], "dashpot")


@pytest.mark.parametrize(("degree", "load"), [(1, 5.0), (1, 15.0), (1, 20.0), (2, 15.0)])
def test_at_rest_on_the_yield_surface_a_motion_has_the_derivatives_of_its_equilibrium(degree, load):
    """Whether a point flows is decided by round-off there, and in each kind of form otherwise."""

    def build(x):
        scene, beam = clamped_bar((x[1], 0), PLASTIC, elements=3, degree=degree)
        scene.add_force(beam.end, (0, load * x[0]))
        return scene, {"tip": fb.Output("position", beam.end)}

    def tip(x):
        scene, outputs = build(x)
        return fb.static(scene, load_steps=4).position(outputs["tip"].of)[-1]

    start = {"start": lambda scene: fb.static(scene, load_steps=4)}
    run, x, h = fb.Response(build, dt=0.01, t_end=0.05, **start), np.array([1.1, 1.05]), 1e-5
    _, y = run(x)
    assert abs(y["tip"] - tip(x)).max() < 1e-12
    tips = [[tip(x + k * h * row) for k in (-2, -1, 1, 2)] for row in np.eye(2)]
    expected = np.einsum("k,mkc->cm", [1, -8, 8, -1], tips) / (12 * h)
    J = run.jacobian("tip")["tip"]
    assert abs(J - expected).max() < 1e-8
    weights = np.arange(y["tip"].size, dtype=float).reshape(y["tip"].shape)
    gradient = run.vjp({"tip": weights})
    assert gradient == pytest.approx(np.einsum("nc,ncm->m", weights, J), rel=1e-9)


# -- Steps in parts, restarts, records -------------------------------------------------------------


def swung():
    scene, beam = cantilever(PLASTIC, elements=4)
    scene.add_force(beam.end, (0.0, 2.0))
    return scene, beam


def test_a_failed_part_leaves_no_trace():
    scene, beam = cantilever(PLASTIC, elements=4)
    scene.set_velocity(beam, lambda x, y: (0.0, 30 * x * x), spin=0.0)
    scene.make_velocities_compatible()
    options = fb.NewtonOptions(max_turn=0.3)
    solution = fb.simulate(scene, dt=0.04, t_end=0.4, newton=options)
    assert solution.stats.halvings > 0
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic[0]
    # What was taken belongs to the plastic curvatures that remain.
    assert energy.dissipated[-1] > 0.1 * energy.kinetic[0]


def test_rows_are_those_of_the_steps_that_are_recorded():
    scene, beam = swung()
    records = fb.Record(every=1), fb.Record(every=7)
    every, some = (fb.simulate(scene, dt=0.02, t_end=1.0, record=record) for record in records)
    rows = [*range(0, 50, 7), 50]
    assert (some.internal(beam, NAME) == every.internal(beam, NAME)[rows]).all()
    assert abs(some.resultants(beam).M - every.resultants(beam).M[rows]).max() < 1e-12
    record = fb.Record(times=[0.0, 0.33, 1.0])
    some_rows = fb.simulate(scene, tolerance=1e-2, t_end=1.0, record=record)
    assert abs(some_rows.energy.balance_error).max() < 1e-11
    assert abs(some_rows.internal(beam, NAME)[-1] - every.internal(beam, NAME)[-1]).max() < 0.02
    none = fb.simulate(scene, dt=0.02, t_end=0.1, record=fb.Record(motion=False))
    assert_refused("motion not recorded", lambda: none.internal(beam, NAME), error=ValueError)


@pytest.mark.plot
def test_pictures_and_files_for_paraview_show_the_variables(tmp_path):
    pv = pytest.importorskip("pyvista")
    scene, beam = swung()
    other = scene.add_beam([beam.end, (2, 0)], ELASTIC, elements=1)
    solution = fb.simulate(scene, dt=0.02, t_end=0.6)
    solution.to_paraview(tmp_path / "run.pvd")
    reader = pv.get_reader(str(tmp_path / "run.pvd"))
    reader.set_active_time_value(reader.time_values[-1])
    (grid,) = reader.read()
    # Elements of degree 1 have one Gauss point: the variable is constant on each.
    values = grid.point_data["plastic curvature"].reshape(-1, 2)
    wanted = [*solution.internal(beam, NAME)[-1], *[0.0] * other.elements]
    assert values == pytest.approx(np.transpose([wanted] * 2), abs=1e-12)
    fb.plot.shapes(solution, tmp_path / "a.png", rows=[0, 30], colour="plastic curvature")
    with pytest.raises(ValueError, match="'plastic curvature', values by their label, or None"):
        fb.plot.shapes(solution, tmp_path / "a.png", rows=[0, 30], colour="plastic strain")


def test_the_variable_may_be_left_out_if_there_is_one_and_joints_are_named():
    scene, arm = swung()
    solution = fb.simulate(scene, dt=0.1, t_end=0.2)
    assert (solution.internal(arm) == solution.internal(arm, NAME)).all()
    with pytest.raises(ValueError, match=r"is no beam. What belongs to it is in solution.joint"):
        solution.internal(fb.Revolute(fb.GROUND, arm.end))


# -- Refusals --------------------------------------------------------------------------------------


def test_order_four_is_refused():
    scene, _ = swung()
    with pytest.raises(fb.SceneError, match="goes back in time"):
        fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.1, t_end=1.0)


# What the files call connectivity.
CELLS = "connectivity", "offsets", "types"
VARIABLES = fb.InternalVariables(("a",), plastic_flow)
REFUSED = {
    "gives energy to the motion": lambda old, e0, e, dt: [old[0] - 0.1 * e[2]],
    "must give 1 scalars": lambda old, e0, e, dt: [old[0], old[0]],
    "must give a UFL expression": lambda old, e0, e, dt: old[0],
    "Use ufl.exp, not math.exp": lambda old, e0, e, dt: [math.exp(old[0])],
    "takes 2 positional arguments": lambda old, e: [old[0]],
}
INCOMPLETE = {
    "need a strain_energy": lambda: fb.Section(EA=EA, GA=GA, EI=EI, internal=VARIABLES),
    r"does not depend on \['b'\]": lambda: with_variables(
        plastic_energy, isotropic_flow, ("a", "b")
    ),
    "InternalVariables: update": lambda: fb.InternalVariables(("a",), 3),
}


@pytest.mark.parametrize("text", REFUSED)
def test_updates_that_do_not_fit_are_refused(text):
    assert_refused(text, lambda: with_variables(plastic_energy, REFUSED[text]))


def test_a_variable_has_no_name_that_something_else_along_a_member_has(tmp_path):
    scene, beam = cantilever(ELASTIC)
    scene.add_natural_strain(beam, axial=0.0, shear=0.0, curvature=0.1)
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    solution.to_paraview(tmp_path / "run.pvd")
    text, _, _ = (tmp_path / "run" / "run_00001.vtu").read_bytes().partition(b"<AppendedData")
    fields = {*re.findall('Name="(.*?)"', text.decode())} - {"Points", *CELLS}
    assert {"natural curvature", "displacement", "spin", "M", "beam"} <= fields
    for name in (*fields, "strain energy", "speed"):
        with pytest.raises(fb.SceneError, match=f"'{name}'.*names that pictures and files do not"):
            with_variables(plastic_energy, plastic_flow, (name,))


@pytest.mark.parametrize("text", INCOMPLETE)
def test_incomplete_materials_are_refused(text):
    assert_refused(text, lambda: INCOMPLETE[text]())
