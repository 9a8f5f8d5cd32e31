"""Internal variables: closed solutions, balances, restarts, and refusals."""

import copy
import math
import pickle

import ufl

import numpy as np
import pytest

import fx_beam as fb

EA, GA, EI, HARDENING, YIELD = 2e4, 8e3, 6.0, 1.5, 0.3
STIFF, SOFT, TAU = 4.0, 2.0, 0.5


def zener_energy(eps, gamma, kappa, a):
    return (
        EA / 2 * eps**2 + GA / 2 * gamma**2 + STIFF / 2 * kappa**2 + SOFT / 2 * (kappa - a[0]) ** 2
    )


def relax(old, strains0, strains, dt):
    return [(old[0] + dt / TAU * strains[2]) / (1 + dt / TAU)]


def plastic_energy(eps, gamma, kappa, a):
    """Kinematic hardening: a[0] is the plastic curvature."""
    elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
    return elastic + HARDENING / 2 * a[0] ** 2


def flow(old, strains0, strains, dt):
    trial = EI * (strains[2] - old[0]) - HARDENING * old[0]
    excess = ufl.max_value(abs(trial) - YIELD, 0)
    return [old[0] + ufl.sign(trial) * excess / (EI + HARDENING)]


def isotropic_energy(eps, gamma, kappa, a):
    """Isotropic hardening: a[0] is the plastic curvature, a[1] its length."""
    elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
    return elastic + HARDENING / 2 * a[1] ** 2


def isotropic_flow(old, strains0, strains, dt):
    trial = EI * (strains[2] - old[0])
    flown = ufl.max_value(abs(trial) - YIELD - HARDENING * old[1], 0) / (EI + HARDENING)
    return [old[0] + ufl.sign(trial) * flown, old[1] + flown]


def section(energy, update, names=("a",), **data):
    return fb.Section(strain_energy=energy, internal=fb.InternalVariables(names, update), **data)


INERTIA = {"rhoA": 1.0, "rhoI": 0.01}
ZENER = section(zener_energy, relax, ("dashpot",), **INERTIA)
PLASTIC = section(plastic_energy, flow, ("plastic curvature",), **INERTIA)
ISOTROPIC = section(isotropic_energy, isotropic_flow, ("plastic curvature", "length"), **INERTIA)
MATERIALS = {"zener": ZENER, "plastic": PLASTIC, "isotropic": ISOTROPIC}


def cantilever(material, elements=2, degree=1):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], material, elements=elements, degree=degree, name="arm")
    scene.clamp(beam.start)
    return scene, beam


# -- Closed solutions ------------------------------------------------------------------------------


def _creep(t, c=0.4):
    """Curvature under the bending moment c t, without inertia."""
    all_stiff, rate = STIFF + SOFT, STIFF / (STIFF + SOFT) / TAU
    a = c / STIFF * (t - (1 - np.exp(-rate * t)) / rate)
    return (c * t + SOFT * a) / all_stiff


def _relaxation(t, c=0.8):
    """Bending moment at the curvature c t."""
    a = c * (t - TAU * (1 - np.exp(-t / TAU)))
    return STIFF * c * t + SOFT * (c * t - a)


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.Newmark()], ids=lambda scheme: scheme.name
)
@pytest.mark.parametrize("test", ["creep", "relaxation"])
def test_a_zener_cantilever_creeps_and_relaxes_with_second_order(test, scheme):
    material = section(zener_energy, relax, ("dashpot",))
    errors = []
    for dt in (0.1, 0.05):
        scene, beam = cantilever(material)
        if test == "creep":
            scene.add_moment(beam.end, lambda t: 0.4 * t)
            solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
            found, exact = solution.rotation(beam.end)[-1], _creep(1.0)
        else:
            scene.prescribe(beam.end, rotation=lambda t: 0.8 * t)
            solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
            found, exact = solution.resultants(beam).M[-1, 0], _relaxation(solution.t_level[-1])
        errors.append(abs(found - exact))
    assert errors[1] < 1e-3
    assert math.log2(errors[0] / errors[1]) > 1.9


def _loop_of_plasticity(curvatures, kinematic):
    """Bending moments along a path of curvatures, from the corners of the yield surface."""
    moment, centre, radius, before, moments = 0.0, 0.0, YIELD, 0.0, []
    for kappa in curvatures:
        trial = moment + EI * (kappa - before)
        excess = max(abs(trial - centre) - radius, 0.0) / (EI + HARDENING)
        direction = np.sign(trial - centre)
        moment = trial - EI * direction * excess
        if kinematic:
            centre += HARDENING * direction * excess
        else:
            radius += HARDENING * excess
        before = kappa
        moments.append(moment)
    return np.array(moments)


@pytest.mark.parametrize("kind", ["plastic", "isotropic"])
def test_the_loop_of_moment_and_curvature_is_exact(kind):
    energy, update = (
        (plastic_energy, flow) if kind == "plastic" else (isotropic_energy, isotropic_flow)
    )
    names = ("plastic curvature", "length")[: 1 if kind == "plastic" else 2]
    scene, beam = cantilever(section(energy, update, names), elements=1)
    corners = [0.0, 0.4, -0.5, 0.6, 0.0]
    scene.prescribe(beam.end, rotation=lambda t: float(np.interp(t, range(5), corners)))
    solution = fb.simulate(scene, dt=0.05, t_end=4.0)
    curvatures = np.interp(solution.t, range(5), corners)
    exact = _loop_of_plasticity(curvatures, kinematic=kind == "plastic")[:, None]
    M = EI * (curvatures[:, None] - solution.internal(beam, "plastic curvature"))
    assert abs(M - exact).max() < 1e-9
    # In a step the moment is the mean of both ends.
    assert abs(solution.resultants(beam).M[1:] - (M[1:] + M[:-1]) / 2).max() < 1e-9
    lost = solution.energy.dissipated
    assert (np.diff(lost) >= 0).all() and lost[-1] > 0.3
    assert abs(solution.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("degree", [1, 2])
def test_load_steps_follow_the_flow_exactly(degree):
    scene, beam = cantilever(PLASTIC, degree=degree)
    scene.add_moment(beam.end, 1.0)
    solution = fb.static(scene, steps=10)
    flown = np.maximum(solution.t - YIELD, 0) / HARDENING
    found = solution.internal(beam, "plastic curvature")
    assert abs(found - flown[:, None]).max() < 1e-12
    assert abs(solution.rotation(beam.end) - solution.t / EI - flown).max() < 1e-10
    # A motion that starts there rests.
    motion = fb.simulate(scene, dt=0.05, t_end=0.5, start=solution)
    assert abs(np.diff(motion.internal(beam, "plastic curvature"), axis=0)).max() < 1e-12
    assert motion.energy.kinetic.max() < 1e-20
    assert abs(motion.a[0]).max() < 1e-6


def test_a_load_step_of_statics_is_the_time_of_the_update():
    scene, beam = cantilever(ZENER)
    scene.prescribe(beam.end, rotation=0.1)
    (found,) = {round(x, 12) for x in fb.static(scene, steps=1).internal(beam, "dashpot")[-1]}
    assert found == pytest.approx(0.1 * (1 / TAU) / (1 + 1 / TAU))


# -- Balances --------------------------------------------------------------------------------------


def spinning_bar(material, degree):
    """A free bar that spins and bends."""
    scene = fb.Scene()
    bar = scene.add_beam([(-1, 0), (1, 0.3)], material, elements=4, degree=degree)
    scene.set_velocity(bar, lambda x, y: (0.3 - 2 * y, 2 * x + 3 * x * x), spin=2.0)
    return scene, bar


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", MATERIALS)
def test_free_flight_loses_what_the_material_takes(kind, degree, solver):
    scene, _ = spinning_bar(MATERIALS[kind], degree)
    solution = fb.simulate(scene, dt=0.02, t_end=0.6, solver=solver)
    energy = solution.energy
    assert energy.dissipated[-1] > 0.01 * energy.kinetic[0]
    assert np.diff(energy.dissipated).min() >= -1e-14
    assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic[0]
    for momentum in (solution.linear_momentum, solution.angular_momentum):
        assert abs(momentum - momentum[0]).max() < 1e-11


@pytest.mark.parametrize(
    "scheme",
    [fb.EnergyDecaying(), fb.ModifiedMidPoint(), fb.MidPoint(), fb.Newmark(), fb.HHT()],
    ids=lambda scheme: scheme.name,
)
def test_all_schemes_agree_with_their_other_solver(scheme):
    scene, bar = spinning_bar(PLASTIC, 2)
    compiled, petsc = (
        fb.simulate(scene, scheme, dt=0.02, t_end=0.6, solver=solver)
        for solver in ("compiled", "petsc")
    )
    assert len(compiled.t) > 20
    name = "plastic curvature"
    assert abs(compiled.internal(bar, name) - petsc.internal(bar, name)).max() < 1e-9
    assert abs(compiled.resultants(bar).M - petsc.resultants(bar).M).max() < 1e-7
    for part in ("dissipated", "strain"):
        a, b = (getattr(solution.energy, part) for solution in (compiled, petsc))
        assert abs(a - b).max() < 1e-8 * compiled.energy.kinetic[0]


def test_the_flow_does_not_depend_on_the_frame():
    angle, found = 0.7, []
    c, s = math.cos(angle), math.sin(angle)
    for turn in (np.eye(2), np.array([[c, -s], [s, c]])):
        scene = fb.Scene()
        beam = scene.add_beam([turn @ (0, 0), turn @ (1, 0)], PLASTIC, elements=4)
        scene.clamp(beam.start)
        scene.add_force(beam.end, turn @ (0.2, 2.0))
        solution = fb.simulate(scene, dt=0.02, t_end=0.6)
        found.append(solution.internal(beam, "plastic curvature"))
    assert abs(found[0]).max() > 0.1
    assert abs(found[1] - found[0]).max() < 1e-9


def test_a_scene_may_have_several_materials():
    elastic = fb.Section(EA=EA, GA=GA, EI=EI, **INERTIA)
    scene = fb.Scene()
    arms = [
        scene.add_beam([(0, 0), (math.cos(a), math.sin(a))], material, elements=3)
        for a, material in ((0, elastic), (2, ISOTROPIC), (4, ZENER))
    ]
    for arm in arms:
        scene.set_velocity(arm, lambda x, y: (-4 * y * np.hypot(x, y), 4 * x * np.hypot(x, y)))
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=0.02, t_end=1.0)
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert not solution.variables_of_beam.keys() & {arms[0].name}
    assert abs(solution.internal(arms[1], "plastic curvature")).max() > 0.1
    assert abs(solution.internal(arms[2], "dashpot")).max() > 0.005
    with pytest.raises(ValueError, match="no internal variable 'dashpot'"):
        solution.internal(arms[1], "dashpot")


# -- Steps in parts, restarts, records -------------------------------------------------------------


def swung(material=PLASTIC):
    scene, beam = cantilever(material, elements=4)
    scene.add_force(beam.end, (0.0, 2.0))
    return scene, beam


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_a_failed_part_leaves_no_trace(solver):
    scene, beam = cantilever(PLASTIC, elements=4)
    scene.set_velocity(beam, lambda x, y: (0.0, 30 * x * x), spin=0.0)
    scene.make_velocities_compatible()
    options = fb.NewtonOptions(max_turn=0.3)
    solution = fb.simulate(scene, dt=0.04, t_end=0.4, newton=options, solver=solver)
    assert solution.stats.halvings > 0
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.kinetic[0]
    # What was taken belongs to the plastic curvatures that remain.
    assert energy.dissipated[-1] > 0.1 * energy.kinetic[0]


def test_a_motion_goes_on_from_what_was_saved(tmp_path):
    scene, beam = swung()
    whole = fb.simulate(scene, dt=0.02, t_end=1.0)
    half = fb.simulate(scene, dt=0.02, t_end=0.5)
    half.save(tmp_path / "half.npz")
    loaded, name = fb.load(tmp_path / "half.npz"), "plastic curvature"
    assert (loaded.internal("arm", name) == half.internal(beam, name)).all()
    for start in (half, loaded, copy.deepcopy(half), pickle.loads(pickle.dumps(half))):
        rest = fb.simulate(scene, dt=0.02, t_end=1.0, start=start)
        assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-12
        found = rest.internal(beam, name)[-1]
        assert abs(found - whole.internal(beam, name)[-1]).max() < 1e-12
    elastic, _ = swung(fb.Section(EA=EA, GA=GA, EI=EI, **INERTIA))
    with pytest.raises(fb.SceneError, match="other internal variables"):
        fb.simulate(elastic, dt=0.02, t_end=1.0, start=half)


def test_rows_are_those_of_the_steps_that_are_recorded():
    scene, beam = swung()
    every, some = (
        fb.simulate(scene, dt=0.02, t_end=1.0, record=fb.Record(every=n)) for n in (1, 7)
    )
    rows, name = [*range(0, 50, 7), 50], "plastic curvature"
    assert (some.internal(beam, name) == every.internal(beam, name)[rows]).all()
    assert abs(some.resultants(beam).M - every.resultants(beam).M[rows]).max() < 1e-12
    at = fb.simulate(scene, tolerance=1e-2, t_end=1.0, record=fb.Record(times=[0.0, 0.33, 1.0]))
    assert abs(at.energy.balance_error).max() < 1e-11
    assert abs(at.internal(beam, name)[-1] - every.internal(beam, name)[-1]).max() < 0.02
    none = fb.simulate(scene, dt=0.02, t_end=0.1, record=fb.Record(motion=False))
    with pytest.raises(ValueError, match="motion not recorded"):
        none.internal(beam, name)


@pytest.mark.plot
def test_pictures_and_files_for_paraview_show_the_variables(tmp_path):
    pv = pytest.importorskip("pyvista")
    scene, beam = swung()
    other = scene.add_beam([beam.end, (2, 0)], fb.Section(EA=EA, GA=GA, EI=EI, **INERTIA))
    solution = fb.simulate(scene, dt=0.02, t_end=0.6)
    solution.to_paraview(tmp_path / "run.pvd")
    reader = pv.get_reader(str(tmp_path / "run.pvd"))
    reader.set_active_time_value(reader.time_values[-1])
    (grid,) = reader.read()
    # Elements of degree 1 have one Gauss point: the variable is constant on each.
    on_members = grid.point_data["plastic curvature"].reshape(-1, 2)
    wanted = [*solution.internal(beam, "plastic curvature")[-1], *[0.0] * other.elements]
    assert on_members == pytest.approx(np.transpose([wanted] * 2), abs=1e-12)
    fb.plot.shapes(solution, [0, 30], tmp_path / "a.png", colour="plastic curvature")
    with pytest.raises(ValueError, match="'plastic curvature', or None"):
        fb.plot.shapes(solution, [0, 30], tmp_path / "a.png", colour="plastic strain")


def test_the_variable_may_be_left_out_if_there_is_one_and_joints_are_named():
    scene, arm = swung()
    solution = fb.simulate(scene, dt=0.1, t_end=0.2)
    name = arm.section.internal.names[0]
    assert (solution.internal(arm) == solution.internal(arm, name)).all()
    joint = fb.Revolute(fb.GROUND, arm.end)
    with pytest.raises(ValueError, match=r"is no beam. What belongs to it is in solution.joint"):
        solution.internal(joint)


def test_scenes_without_internal_variables_have_no_form_for_them():
    scene, _ = swung(fb.Section(EA=EA, GA=GA, EI=EI, **INERTIA))
    assert "internal variables" not in fb.simulate(scene, dt=0.1, t_end=0.2).stats.compiled


# -- Refusals --------------------------------------------------------------------------------------


def test_order_four_is_refused():
    scene, _ = swung()
    with pytest.raises(fb.SceneError, match="goes back in time"):
        fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.1, t_end=1.0)


@pytest.mark.parametrize(
    ("update", "text"),
    [
        (lambda old, e0, e, dt: [old[0] - 0.1 * e[2]], "gives energy to the motion"),
        (lambda old, e0, e, dt: [old[0], old[0]], "must give 1 scalars"),
        (lambda old, e0, e, dt: old[0], "must give a UFL expression"),
        (lambda old, e0, e, dt: [math.exp(old[0])], "Use ufl.exp, not math.exp"),
        (lambda old, e: [old[0]], "takes 2 positional arguments"),
    ],
    ids=["gain", "shape", "scalar", "math", "arguments"],
)
def test_updates_that_do_not_fit_are_refused(update, text):
    with pytest.raises(fb.SceneError, match=text):
        section(plastic_energy, update, ("plastic curvature",))


def test_incomplete_materials_are_refused():
    variables = fb.InternalVariables(("a",), flow)
    with pytest.raises(fb.SceneError, match="need a strain_energy"):
        fb.Section(EA=EA, GA=GA, EI=EI, internal=variables)
    with pytest.raises(fb.SceneError, match="does not depend on \\['b'\\]"):
        section(plastic_energy, isotropic_flow, ("a", "b"))
    with pytest.raises(fb.SceneError, match="InternalVariables: names"):
        fb.InternalVariables("a", flow)
    with pytest.raises(fb.SceneError, match="InternalVariables: update"):
        fb.InternalVariables(("a",), 3)
    with pytest.raises(fb.SceneError, match="InternalVariables: level"):
        fb.InternalVariables(("a",), flow, level=0.4)
    with pytest.raises(fb.SceneError, match="Section: internal"):
        fb.Section(strain_energy=plastic_energy, internal=flow)
