"""Natural strains: exact states, prestressed vibrations, work in the balance, derivatives."""

import numpy as np
import pytest
import scipy.signal
from scenes import clamped_bar, one_bar, supported_bar

import fx_beam as fb

SOFT = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)


def bar(section=SOFT, elements=4, degree=1, **strains):
    """A cantilever of length 1 along x, with natural strains."""
    scene, beam = clamped_bar((1, 0), section, elements=elements, degree=degree)
    if strains:
        scene.add_natural_strain(beam, **strains)
    return scene, beam


# -- Equilibria --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degree", "error", "continuation"), [(1, 3e-3, None), (2, 3e-6, "arc-length"), (3, 2e-9, None)]
)
def test_a_free_beam_becomes_an_arc_without_stress(degree, error, continuation):
    k0 = 2.0
    scene, beam = bar(degree=degree, elements=7, curvature=k0)
    arc = fb.static(scene, load_steps=4, continuation=continuation)
    tip = np.sin(k0) / k0, (1 - np.cos(k0)) / k0
    np.testing.assert_allclose(arc.position(beam.end)[-1], tip, rtol=0, atol=error)
    r = arc.resultants(beam)
    assert max(abs(part[-1]).max() for part in (r.N, r.Q, r.M)) < 1e-9
    assert abs(arc.energy.strain[-1]) < 1e-18
    assert abs(arc.reaction(beam.start)[-1]).max() < 1e-9


@pytest.mark.parametrize("height", [1e-2, 1e-5])
@pytest.mark.parametrize("support", ["clamp", "roller", "middle"])
def test_a_thin_free_beam_that_expands_has_no_step_halved(support, height):
    """Round-off in its forces, of stiffness times places, does work on its natural strain."""
    thin = fb.Section.rectangle(height=height, width=0.02, E=210e9, nu=0.3, rho=7850.0)
    for expansion, elements, length in ((1e-5, 1, 1.0), (-1e-3, 7, 10.0), (0.03, 16, 0.37)):
        scene, beam = one_bar((length, 0), thin, elements=2 * elements)
        node = {"clamp": beam.start, "roller": beam.start, "middle": beam.node(0.5)}[support]
        scene.fix(node, "x", "y")
        if support == "roller":
            scene.fix(beam.end, "y")
        else:
            scene.fix(node, "rotation")
        scene.add_natural_strain(beam, axial=expansion)
        grown = fb.static(scene)
        assert grown.stats.steps == 10 and not grown.stats.halvings
        way = grown.displacement(beam.end)[-1, 0] - grown.displacement(beam.start)[-1, 0]
        assert way == pytest.approx(expansion * length, rel=1e-9)


@pytest.mark.parametrize("elements", [3, 4, 8])
def test_a_beam_that_nothing_holds_expands(elements):
    """It was refused until rigid motions that meet no force were held."""
    thin = fb.Section.rectangle(height=1e-2, width=0.02, E=210e9, nu=0.3, rho=7850.0)
    scene, beam = one_bar((1, 0), thin, elements=elements)
    scene.add_natural_strain(beam, axial=1e-5)
    path = fb.static(scene)
    ends = (path.displacement(node)[-1] for node in (beam.start, beam.end))
    assert np.subtract(*ends) == pytest.approx([-1e-5, 0.0], abs=1e-11)
    assert path.stable.all()


def test_a_beam_clamped_at_both_ends_does_not_move_and_has_the_moment_of_its_curvature():
    k0 = 3.0
    scene, beam = bar(curvature=k0)
    scene.clamp(beam.end)
    held = fb.static(scene, load_steps=2)
    assert not held.q[-1].any()
    np.testing.assert_allclose(held.resultants(beam).M[-1], -SOFT.EI * k0, rtol=1e-12)
    np.testing.assert_allclose(held.reaction(beam.end)[-1], [0, 0, -SOFT.EI * k0], atol=1e-9)
    # The actuation does the work that is stored.
    assert held.energy.work[-1] == pytest.approx(SOFT.EI * k0**2 / 2, rel=1e-12)
    assert held.energy.strain[-1] == pytest.approx(SOFT.EI * k0**2 / 2, rel=1e-12)


def test_a_heated_bar_between_walls_is_pressed_and_a_free_one_grows():
    scene, beam = bar(axial=fb.thermal(12e-6, lambda f, t: 80.0 * t * f))
    warm = fb.static(scene, load_steps=1, t=0.5)
    assert warm.displacement(beam.end)[-1, 0] == pytest.approx(12e-6 * 20, rel=1e-6)
    scene.clamp(beam.end)
    # N is constant, and its strain makes up for the mean of the heat.
    N = fb.static(scene, load_steps=1, t=0.5).resultants(beam).N[-1]
    np.testing.assert_allclose(N, -SOFT.EA * 12e-6 * 20, rtol=1e-6)
    assert fb.thermal(2e-5, 50) == pytest.approx(1e-3)
    assert fb.thermal(2e-5, fb.Input("oven", factor=2.0)).factor == (4e-5,)


def test_natural_shear_and_functions_of_both_are_those_of_the_time_of_the_equilibrium():
    scene, beam = bar(degree=2, shear=lambda f, t: 1e-3 * t * (1 + 0 * f), axial=lambda t: 2e-3 * t)
    sheared = fb.static(scene, load_steps=1, t=3.0)
    np.testing.assert_allclose(sheared.position(beam.end)[-1], [1.006, 3e-3], rtol=0, atol=2e-5)
    for name, value in (("natural axial strain", 6e-3), ("natural shear strain", 3e-3)):
        np.testing.assert_allclose(sheared.internal(beam, name)[-1], value, rtol=1e-12)


def test_several_natural_strains_add_up_and_one_that_is_changed_goes_on_from_where_it_is():
    scene, beam = bar(axial=1e-3)
    scene.clamp(beam.end)
    more = scene.add_natural_strain(beam, axial=2e-3, curvature=0.5)
    both = fb.static(scene, load_steps=1)
    np.testing.assert_allclose(both.resultants(beam).N[-1], -3e-3 * SOFT.EA, rtol=1e-9)
    scene.change(more, axial=0.0)
    less = fb.static(scene, load_steps=2, start=both)
    expected = [-3e-3 * SOFT.EA, -2e-3 * SOFT.EA, -1e-3 * SOFT.EA]
    np.testing.assert_allclose(less.resultants(beam).N[:, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(less.resultants(beam).M[-1], -0.5 * SOFT.EI, rtol=1e-9)
    scene.remove(scene.natural_strains[1])
    assert len(scene.natural_strains) == 1


# -- Small vibrations --------------------------------------------------------------------------


@pytest.mark.parametrize("tension", [50.0, -1.0])
def test_the_vibrations_of_a_prestressed_beam_are_those_of_the_continuum(tension):
    """Its modes, linear system, first period, and response to a force in the middle."""
    s = fb.Section(EA=1e5, GA=1e4, EI=0.5, rhoA=0.1, rhoI=1e-5)
    scene, beam = supported_bar((2, 0), s, elements=8, degree=3, held="xy")
    scene.add_natural_strain(beam, axial=-tension / s.EA)
    state = fb.static(scene, load_steps=1)
    by_modes = fb.modes(scene, state=state, n=3).angular_frequencies
    by_system = np.sort(np.linalg.eigvals(fb.linearise(scene, state=state).A).imag)
    by_system = by_system[by_system > 0][:3]
    for n, omegas in enumerate(zip(by_modes, by_system, strict=True), start=1):
        # (GA k^2 - rhoA w^2) (EI k^2 + GA - T - rhoI w^2) = (GA - T)^2 k^2
        k2, T = (n * np.pi / 2) ** 2, tension
        bent, rest = s.EI * k2 + s.GA - T, (s.GA - T) ** 2 * k2
        factors = s.rhoA * s.rhoI, -(s.GA * k2 * s.rhoI + s.rhoA * bent), s.GA * k2 * bent - rest
        np.testing.assert_allclose(omegas, np.sqrt(np.roots(factors).min()), rtol=1e-4)
    middle, f = beam.node(0.5), [0.0, 1.3, 4.0]
    response = fb.frequency_response(scene, (middle, (0.0, 1.0)), middle, f, state)
    k2 = (np.arange(1, 200_000, 2) * np.pi / 2) ** 2  # a sum of sines, each deflects and turns
    for frequency, value in zip(f, response.component("y"), strict=True):
        w2 = (2 * np.pi * frequency) ** 2
        deflects, turns = s.GA * k2 - s.rhoA * w2, s.EI * k2 + s.GA - tension - s.rhoI * w2
        sine = deflects - (s.GA - tension) ** 2 * k2 / turns
        assert value == pytest.approx((1 / sine).sum(), rel=2e-4)
    if tension < 0:
        return
    scene.set_velocity(beam, lambda x, y: (0.0, 1e-3 * np.sin(np.pi * x / 2)))
    half = np.pi / by_modes[0]
    motion = fb.simulate(scene, dt=half / 100, t_end=half, start=state)
    path = motion.displacement(middle)[:, 1]
    assert path[50] == pytest.approx(1e-3 / by_modes[0], rel=2e-3)
    assert abs(path[100]) < 2e-3 * path[50]
    assert np.ptp(motion.energy.work) == 0


@pytest.mark.parametrize(("rhoI", "retardation"), [(1e-3, 0.01), (0.0, 0.01)])
def test_a_linear_system_of_a_muscle_is_the_limit_of_small_motions(rhoI, retardation):
    """Also where the material damps the rate of the muscle."""
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=rhoI, retardation=retardation)
    scene, beam = bar(section, elements=3, curvature=fb.Input("muscle", factor=0.5))
    scene.add_drag(beam, linear=2.0, rotation=0.02)
    load = scene.add_force(beam.end, (0.0, 0.2))
    start = fb.static(scene, load_steps=4)
    quantities = ("displacement", "y"), ("velocity", "y"), ("rotation", None)
    outputs = {name: fb.Output(name, beam.end, axis) for name, axis in quantities}
    system = fb.linearise(scene, start, outputs=outputs)
    t = 2e-3 * np.arange(201)
    push = np.sin(np.pi * t / 0.4) ** 4
    exact = scipy.signal.lsim(system.state_space(), push, t)[1][:, 0]
    seen = []
    for size in (1e-3, -1e-3):
        inputs = {"muscle": lambda t, size=size: size * np.sin(np.pi * t / 0.4) ** 4}
        motion = fb.simulate(scene, dt=2e-3, t_end=0.4, start=start, inputs=inputs)
        seen.append(motion.displacement(beam.end)[:, 1])
    assert load in scene.loads
    assert (seen[0] - seen[1]) / 2e-3 == pytest.approx(exact, abs=3e-3 * abs(exact).max())
    # The states of a motion, from displacements, rates and the input.
    motion = fb.Motion(scene, dt=2e-3, start=start, outputs=outputs)
    for _ in range(2):
        motion.step({"muscle": 1e-3})
    seen = system.C @ system.deviation(motion) + system.D @ [1e-3]
    at_rest = start.displacement(beam.end)[-1, 1], 0.0, start.rotation(beam.end)[-1]
    assert seen == pytest.approx(np.subtract([*motion.outputs.values()], at_rest), rel=1e-3)
    assert system.deviation(motion.state) == pytest.approx(system.deviation(motion), abs=1e-12)


def test_a_linear_system_needs_the_rates_of_natural_strains_that_damp():
    damped = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3, retardation=1e-2)
    scene, _ = bar(damped, curvature=lambda t: min(t, 0.02))
    fb.linearise(scene, fb.static(scene, t=0.02))
    with pytest.raises(fb.SceneError, match="a natural strain whose rate jumps at t = 0.02"):
        fb.linearise(scene, fb.simulate(scene, dt=0.005, t_end=0.02))
    fb.linearise(scene, fb.simulate(scene, dt=0.005, t_end=0.03))


@pytest.mark.parametrize("unit", [1.0, 3600.0])
@pytest.mark.parametrize("strain", [lambda x: x**2, np.cos, lambda x: 1 - np.cos(x), np.sin])
def test_a_natural_strain_without_a_rate_at_the_start_has_no_jump_in_any_unit_of_time(strain, unit):
    """The rate is that of its slope: none at the start, but that of a sine."""
    lengths = []
    for function in (strain, lambda x: np.sin(x) * (strain is np.sin)):
        rod = {"EA": 1e4 * unit**2, "GA": 1e4 * unit**2, "EI": unit**2, "rhoA": 1.0, "rhoI": 1e-3}
        damped = fb.Section(**rod, retardation=1e-2 / unit)
        scene, _ = bar(damped, curvature=lambda t, function=function: 0.3 * function(20 * t * unit))
        system = fb.linearise(scene, fb.Motion(scene, dt=5e-3 / unit))
        lengths.append(np.sort(abs(np.linalg.eigvals(system.A))) / unit)
    if strain is not np.cos:  # which bends the beam
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-6)


@pytest.mark.parametrize("link", [False, True])
def test_a_damped_string_that_is_strained_has_the_frequencies_of_its_whole_force(link):
    """Its force is -EA (e + tau e') for a natural strain e that grows; it also pulls at a link."""
    tau, grows = 0.05, lambda t: -0.01 - 0.2 * t
    systems = []
    for damping, axial in (((tau, 0.0, 0.0), grows), (0.0, grows(0.1) - 0.2 * tau)):
        own = {"EA": 1e3, "GA": 1e3, "EI": 0.1, "rhoA": 1.0, "rhoI": 1e-3}
        string = fb.Section(**own, retardation=damping)
        scene, beam = clamped_bar((1, 0), string, elements=6, degree=2)
        if link:
            body = scene.add_body((1.2, 0), mass=1.0, inertia=0.1, points={"end": (1, 0)})
            scene.pin(body.centre)
            scene.add_joint(fb.Revolute(body["end"], beam.end))
        else:
            scene.clamp(beam.end)
        scene.add_natural_strain(beam, axial=axial)
        systems.append(fb.linearise(scene, fb.simulate(scene, dt=0.01, t_end=0.1)))
    damped, plain = (np.linalg.eigvals(system.A) for system in systems)
    frequencies = np.sort(plain.imag[plain.imag > 0])[:3]
    nearest = [damped[abs(damped - 1j * w).argmin()] for w in frequencies]
    assert np.imag(nearest) == pytest.approx(frequencies, rel=1e-6)
    assert abs(np.real(nearest)).max() < 1e-5 * frequencies[0]


# -- Motions -----------------------------------------------------------------------------------


def oscillator(scheme, steps):
    """A mass on a bar without mass, whose natural length oscillates; its end and the exact one."""
    k, m, e, W = 40.0, 0.5, 0.02, 7.0
    rod = fb.Section(EA=k, GA=1e3, EI=1e3)
    scene, beam = bar(rod, elements=1, axial=lambda t: e * np.sin(W * t))
    scene.add_mass(beam.end, m, 1.0)
    t = 1.0
    solution = fb.simulate(scene, scheme, dt=t / steps, t_end=t)
    w0 = np.sqrt(k / m)
    exact = e * w0**2 / (w0**2 - W**2) * (np.sin(W * t) - W / w0 * np.sin(w0 * t))
    return solution.displacement(beam.end)[-1, 0], exact


@pytest.mark.parametrize(
    ("scheme", "order"),
    [(fb.EnergyMomentum(), 2), (fb.EnergyMomentum(order=4), 4), (fb.Newmark(), 2)],
)
def test_a_natural_strain_that_oscillates_drives_a_mass_with_the_order_of_the_scheme(scheme, order):
    errors = [abs(np.subtract(*oscillator(scheme, steps))) for steps in (20, 40)]
    assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.2)


WAVE = {
    "axial": lambda t: 0.05 * np.sin(3 * t),
    "curvature": lambda f, t: 2 * np.sin(5 * t - 4 * f),
}


def stiffening(eps, gamma, kappa):
    return 5e3 * (eps**2 + gamma**2) + kappa**2 / 2 + kappa**4 / 20


def zener(eps, gamma, kappa, a):
    return 5e3 * (eps**2 + gamma**2) + kappa**2 / 2 + (kappa - a[0]) ** 2 / 4


def relaxed(old, strains0, strains, dt):
    return [(old[0] + dt / 0.1 * strains[2]) / (1 + dt / 0.1)]


MASS = {"rhoA": 1.0, "rhoI": 1e-3}
RELAXING = {"strain_energy": zener, "internal": fb.InternalVariables(("dashpot",), relaxed)}
DAMPED = {"EA": 1e4, "GA": 1e4, "EI": 1.0, "retardation": 1e-3}


@pytest.mark.parametrize(
    ("section", "scheme"),
    [
        (SOFT, fb.EnergyMomentum(order=4)),
        (SOFT, fb.EnergyDecaying()),
        (fb.Section(**DAMPED, **MASS), fb.EnergyMomentum()),
        (fb.Section(strain_energy=stiffening, **MASS), fb.EnergyMomentum()),
        (fb.Section(**RELAXING, **MASS), fb.EnergyMomentum()),
    ],
    ids=["order 4", "decaying", "damped", "stiffening", "relaxing"],
)
def test_the_work_of_natural_strains_closes_the_balance(section, scheme):
    scene, _ = bar(section, **WAVE)
    energy = fb.simulate(scene, scheme, dt=0.01, t_end=0.5).energy
    assert energy.work[-1] > 0.1
    assert abs(energy.balance_error).max() < 1e-12 * energy.total.max()
    assert (np.diff(energy.dissipated) >= 0).all()


@pytest.mark.parametrize(
    ("data", "scheme"),
    [(DAMPED, fb.EnergyMomentum()), (DAMPED, fb.Newmark()), (RELAXING, fb.EnergyMomentum())],
    ids=["damped", "damped, Newmark", "relaxing"],
)
def test_a_beam_that_follows_its_natural_strain_freely_has_no_stress_and_loses_nothing(
    data, scheme
):
    scene, beam = bar(fb.Section(**data), curvature=lambda t: 3 * t)
    scene.add_mass(beam.end, 1e-9)
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=0.5)
    assert solution.rotation(beam.end)[-1] == pytest.approx(1.5, rel=1e-6)
    assert abs(solution.resultants(beam).M).max() < 1e-6
    if scheme.name != "Newmark":  # by which the spin from rest swings about that of the strain
        assert solution.energy.dissipated[-1] < 1e-9


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4)], ids=str)
def test_resultants_are_those_of_the_step_whatever_is_recorded(scheme):
    scene, beam = bar(**WAVE)
    all_rows, some = (
        fb.simulate(scene, scheme, dt=0.02, t_end=0.24, record=fb.Record(every=every))
        for every in (1, 4)
    )
    for name in ("N", "Q", "M"):
        each, fourth = (getattr(run.resultants(beam), name) for run in (all_rows, some))
        np.testing.assert_allclose(each[::4], fourth, rtol=1e-9, atol=1e-9)
    natural = all_rows.internal(beam, "natural curvature")
    s = all_rows.resultants(beam).s
    np.testing.assert_allclose(natural, 2 * np.sin(5 * all_rows.t[:, None] - 4 * s), atol=1e-12)


def test_an_own_force_sees_the_natural_strains_of_the_step():
    def force(step):
        # Half of the couple of a quadratic energy, with the opposite sign.
        return SOFT.EI / 2 * step.strains1[2] * step.prime(step.virtual_psi)

    scene, beam = bar(curvature=2.0)
    scene.clamp(beam.end)
    scene.add_virtual_work(force)
    held = fb.static(scene, load_steps=1)
    np.testing.assert_allclose(held.reaction(beam.end)[-1], [0, 0, -SOFT.EI], atol=1e-9)
