"""Orders of convergence, and relations between the schemes."""

import functools
from dataclasses import FrozenInstanceError, replace

import ufl

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, held_body, hinged_body, one_body, pinned_bar
from scipy.integrate import quad, solve_ivp

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.ModifiedMidPoint(),
    fb.MidPoint(),
    fb.EnergyDecaying(),
    fb.Newmark(),
    fb.HHT(-0.1),
    fb.GeneralizedAlpha(0.8),
]


def arm(elements=4, degree=1):
    """A pinned arm, swung from rest by a moment that grows smoothly: no front is to resolve."""
    section = fb.Section(EA=2e3, GA=1e3, EI=200.0, rhoA=1.0, rhoI=0.1)
    scene, beam = pinned_bar((4, 0), section, elements=elements, degree=degree)
    scene.add_moment(beam.end, lambda t: 300 * np.sin(4 * t) ** 4)
    return scene, beam


def end_state(scheme, dt, **options):
    scene, beam = arm(**options)
    solution = fb.simulate(scene, scheme, dt=dt, t_end=0.5)
    return np.append(solution.position(beam.end)[-1], solution.rotation(beam.end)[-1])


def order(steps, errors):
    """Slope of the logarithms by least squares."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@functools.cache
def fine_state():
    """Limit of all schemes for small steps: on a mesh they discretise the same equations."""
    return end_state(fb.EnergyMomentum(), 1 / 12800)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_every_scheme_is_of_second_order_in_time(scheme):
    steps = np.array([1 / 200, 1 / 400, 1 / 800])
    errors = [np.linalg.norm(end_state(scheme, dt) - fine_state()) for dt in steps]
    assert order(steps, errors) > 1.9


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_damping_at_a_point_of_a_body_leaves_the_order(scheme):
    """A pendulum: I w' = -m g r cos(psi) - c L^2 w, with drag at a point without mass."""
    m, r, L, c, inertia = 1.0, 0.3, 0.6, 0.5, 0.05

    def rates(t, y):
        psi, w = y
        return w, -(m * 9.81 * r * np.cos(psi) + c * L**2 * w) / (inertia + m * r**2)

    psi, w = solve_ivp(rates, (0, 0.4), (0.0, 0.0), rtol=1e-12, atol=1e-12).y[:, -1]
    exact = L * np.array([np.cos(psi), np.sin(psi), -w * np.sin(psi), w * np.cos(psi)])
    steps, errors = np.array([1 / 100, 1 / 200, 1 / 400]), []
    for dt in steps:
        scene, body, _ = hinged_body(
            (r, 0), m, inertia, {"pin": (0, 0), "end": (L, 0)}, gravity=(0, -9.81)
        )
        scene.add_drag(body["end"], linear=c)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=0.4)
        ends = solution.position(body["end"])[-1], solution.velocity(body["end"])[-1]
        errors.append(np.linalg.norm(np.concatenate(ends) - exact))
    assert order(steps, errors) > 1.9


IMPACT = {"stiffness": 400.0, "restitution": 0.5, "speed": 0.2}


def floor(scene, ball):
    scene.add_contact(ball, fb.Line((0, 0), (0, 1)), **IMPACT)


def hinged_plate(scene, ball):
    plate = scene.add_body((0, 0), 1.0, 0.5).centre
    scene.pin(plate)
    scene.add_contact(ball, fb.Line(plate, (0, 1)), **IMPACT)


def square_damper(scene, ball):
    damper = fb.Damper(law=lambda rate: 40 * abs(rate) * rate)
    scene.add_force_between(ball, (0.5, -1.0), damper=damper)


@pytest.mark.parametrize("stop", [floor, hinged_plate, square_damper])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_what_restitution_and_dampers_take_is_of_second_order_in_time(scheme, stop):
    """Newmark's family took the loss by the force at the end of each step, of first order."""

    def lost(scheme, dt):
        scene, ball = held_body((0.5, 0), 1.0, 0.1)
        scene.set_velocity(ball, (0, -1.0))
        stop(scene, ball)
        return fb.simulate(scene, scheme, dt=dt, t_end=0.1).energy.dissipated[-1]

    exact, steps = lost(fb.EnergyMomentum(), 1 / 12800), np.array([1 / 200, 1 / 400, 1 / 800])
    assert order(steps, [abs(lost(scheme, dt) - exact) for dt in steps]) > 1.9


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_accelerations_are_of_second_order_at_the_times_that_are_documented(scheme):
    k, t_end = 100.0, 1.0
    steps, errors = np.array([1 / 100, 1 / 200, 1 / 400]), []
    for dt in steps:
        scene, ball = one_body((1, 0), 1.0, 0.1)
        scene.add_force_between(ball.centre, (0, 0), spring=fb.Spring(k))
        solution = fb.simulate(scene, scheme, dt=dt, t_end=t_end)
        t = solution.t_level
        if isinstance(rates := scheme.rates, fb.NewmarkRates):
            t = solution.t + (rates.alpha_m - rates.alpha_f) * dt
        late = solution.t > t_end / 2  # a false start has decayed
        exact = -k * np.cos(np.sqrt(k) * t)
        errors.append(abs(solution.acceleration(ball.centre)[:, 0] - exact)[late].max())
    assert order(steps, errors) > 1.9


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_the_work_of_a_drive_after_an_equilibrium_is_of_second_order(scheme):
    """The equilibrium has no forces of inertia: with those, Newmark's family had first order."""
    m, c, begin, t_end = 2.0, 5.0, 0.1, 0.3
    y = lambda t: 0.1 * np.sin(3 * t)  # noqa: E731

    def power(t):
        return (-9 * m * y(t) + c * 0.3 * np.cos(3 * t)) * 0.3 * np.cos(3 * t)

    steps, errors = np.array([1 / 100, 1 / 200, 1 / 400]), []
    for dt in steps:
        scene, block = held_body((0, 0), m, 0.1, "x", "rotation")
        scene.prescribe(block, y=y)
        scene.add_drag(block, linear=c)
        start = fb.static(scene, t=begin)
        work = fb.simulate(scene, scheme, dt=dt, t_end=t_end, start=start).energy.work
        errors.append(abs(work[-1] - work[0] - quad(power, begin, t_end)[0]))
    assert order(steps, errors) > 1.9


def test_convergence_in_the_element_size_rises_with_the_degree():
    # At the nodes the error falls with the power 2p of the element size.
    dt, orders = 1 / 400, {}
    fine = end_state(None, dt, elements=32, degree=3)
    for degree, meshes in ((1, (8, 16, 32)), (2, (4, 8, 16)), (3, (2, 4, 8))):
        ends = (end_state(None, dt, elements=n, degree=degree) for n in meshes)
        errors = [np.linalg.norm(end - fine) for end in ends]
        orders[degree] = order([1 / n for n in meshes], errors)
    assert orders[1] > 1.9
    assert orders[2] > 3.8
    assert orders[3] > 5.5


def test_hht_without_damping_is_the_trapezoidal_rule():
    assert end_state(fb.HHT(0.0), 0.005) == pytest.approx(end_state(fb.Newmark(), 0.005), abs=1e-12)


def test_newmark_conserves_energy_in_the_linear_limit():
    section = fb.Section(EA=2e3, GA=1e3, EI=200.0, rhoA=1.0, rhoI=0.1)
    scene, beam = clamped_bar((4, 0), section, elements=4)
    scene.set_velocity(beam, lambda x, y: (1e-6 * x, 1e-6 * x**2), spin=lambda x, y: 2e-6 * x)
    energy = fb.simulate(scene, fb.Newmark(), dt=0.05, t_end=5.0).energy.total
    # What is left is the next order of the amplitude.
    assert abs(energy / energy[0] - 1).max() < 1e-5


def test_hht_damps_a_high_frequency_and_newmark_does_not():
    section = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=0.1)
    scene, beam = clamped_bar((1, 0), section, elements=1)
    scene.fix(beam.end, "y", "rotation")
    scene.set_velocity(beam.end, (1.0, 0.0))
    energies = {
        scheme.name: fb.simulate(scene, scheme, dt=0.01, t_end=1.0).energy.total
        for scheme in (fb.Newmark(), fb.HHT(-0.3), fb.GeneralizedAlpha(0.5))
    }
    assert energies["Newmark"][-1] == pytest.approx(energies["Newmark"][0], rel=1e-6)
    assert energies["HHT"][-1] < 1e-2 * energies["HHT"][0]
    assert energies["GeneralizedAlpha"][-1] < 1e-6 * energies["GeneralizedAlpha"][0]


def test_frequency_of_axial_vibration_is_exact_for_one_degree_of_freedom():
    # Massless bar with a mass at its end: omega = sqrt(EA / (L m)); the mid-point rule has
    # tan(omega_h dt / 2) = omega dt / 2.
    scene, beam = clamped_bar((2, 0), fb.Section(EA=200.0, GA=1e3, EI=1.0), elements=1)
    scene.fix(beam.end, "y", "rotation")
    scene.add_mass(beam.end, 4.0)
    scene.set_velocity(beam.end, (0.1, 0.0))
    dt, omega = 0.05, np.sqrt(200.0 / (2 * 4.0))
    omega_h = 2 / dt * np.arctan(omega * dt / 2)
    for scheme in SCHEMES[:3]:
        solution = fb.simulate(scene, scheme, dt=dt, t_end=5.0)
        exact = 0.1 / omega * np.sin(omega_h * solution.t)
        assert solution.displacement(beam.end)[:, 0] == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize(
    "scheme",
    [*SCHEMES, fb.Equilibrium(), fb.MidPoint(4), fb.EnergyMomentum(order=4)]
    + [fb.EnergyDecaying(0.25, order=1), fb.Newmark(0.3, 0.6)],
    ids=repr,
)
def test_a_scheme_is_shown_as_it_is_typed(scheme):
    again = eval(repr(scheme), vars(fb))
    assert again == scheme and repr(again) == repr(scheme)


def test_a_scheme_that_was_changed_is_shown_as_what_it_is():
    changed = replace(fb.MidPoint(), name="mine", rates=fb.Newmark().rates)
    assert repr(changed).startswith("Scheme('mine', at_mid_step, NewmarkRates(")


def test_nothing_is_set_on_a_step():
    step = fb.Step(*range(16))
    for name in ("load_factor", "loadfactor"):
        with pytest.raises(FrozenInstanceError):
            setattr(step, name, 2.0)


FAMILY = [fb.Newmark(), fb.HHT(), fb.GeneralizedAlpha(0.8), fb.GeneralizedAlpha(0.0)]


@pytest.mark.parametrize("scheme", FAMILY, ids=str)
def test_reactions_of_driven_masses_do_not_alternate_by_newmarks_family(scheme):
    """A mass m at x = j t^3 / 6, in steps of two lengths: by recursion they did by m j t / 3."""
    m, j, dt = 2.0, 3.0, 0.01
    scene = fb.Scene()
    mass = scene.add_body((0, 0), m).centre
    scene.prescribe(mass, x=lambda t: j * t**3 / 6)
    scene.fix(mass, "y", "rotation")
    first = fb.simulate(scene, scheme, dt=dt / 2, t_end=0.25)
    run = fb.simulate(scene, scheme, dt=dt, t_end=1.0, start=first)
    assert run.reaction(mass)[2:, 0] == pytest.approx(m * j * run.t_level[2:], abs=1e-8)
    assert run.velocity(mass)[:, 0] == pytest.approx(j * run.t**2 / 2, abs=j * dt**2)
    for energy in (first.energy, run.energy):
        assert abs(energy.balance_error).max() < 1e-9


@pytest.mark.parametrize("scheme", FAMILY, ids=str)
def test_kinks_of_inputs_give_their_impulse_in_a_few_steps_by_newmarks_family(scheme):
    """The speed of a driven mass m changes by V / 10 every ten steps."""
    m, V, dt = 2.0, 0.7, 0.01
    scene = fb.Scene()
    mass = scene.add_body((0, 0), m).centre
    scene.prescribe(mass, x=fb.Input("x"))
    scene.fix(mass, "y", "rotation")
    motion = fb.Motion(scene, scheme, dt=dt, record=fb.Record())
    for k in range(1, 51):
        motion.step({"x": np.interp(k, np.arange(6) * 10, V * dt * np.array([0, 0, 1, 3, 6, 10]))})
    forces = motion.solution().reaction(mass)[1:, 0].reshape(5, 10)
    assert dt * forces.sum(axis=1) == pytest.approx(np.append(0, np.full(4, m * V / 10)))
    assert abs(forces[:, 5:]).max() < 1e-9


@pytest.mark.parametrize("scheme", FAMILY, ids=str)
def test_motor_torques_of_a_driven_arm_are_of_second_order_by_newmarks_family(scheme):
    """Two links, both driven, against the equations of motion of rigid bodies."""
    length, g = 0.8, 9.81j
    scene = fb.Scene(gravity=(0, -9.81))
    points = {"O": (0, 0), "P": (length, 0)}
    upper = scene.add_body((length / 2, 0), 2.0, 0.1, points=points)
    lower = scene.add_body((length + 0.3, 0), 1.5, 0.05, points=points)
    turn, bend = np.polynomial.Polynomial([0, 1, 0, 2]), lambda t: np.sin(3 * t)
    shoulder = scene.add_joint(fb.Revolute(fb.GROUND, upper["O"], motor=turn))
    elbow = scene.add_joint(fb.Revolute(upper["P"], lower["P"], motor=bend))
    scene.make_velocities_compatible()

    def torques(t):
        a, da, dda = (turn.deriv(k)(t) for k in range(3))
        b, db, ddb = a + np.sin(3 * t), da + 3 * np.cos(3 * t), dda - 9 * np.sin(3 * t)
        along, beside = length * np.exp(1j * a), 0.3 * np.exp(1j * b)
        pivot = along * (1j * dda - da**2)
        pull = 1.5 * (pivot + beside * (1j * ddb - db**2) + g)
        at_elbow = 0.05 * ddb + (beside.conj() * pull).imag
        weight = 2.0 * (pivot / 2 + g)
        return at_elbow + 0.1 * dda + (along.conj() * (weight / 2 + pull)).imag, at_elbow

    steps, errors = np.array([0.01, 0.005, 0.0025]), []
    for dt in steps:
        run = fb.simulate(scene, scheme, dt=dt, t_end=0.6)
        exact = np.array(torques(run.t_level)).T
        found = run.motor_forces[:, [shoulder.number, elbow.number]]
        errors.append(abs(found - exact)[len(exact) // 2 :].max())
    assert errors[0] < 0.1
    assert order(steps, errors) > 1.8


def test_strains_and_energies_that_are_none_are_refused():
    def scheme(**options):
        return fb.Scheme("own", fb.MidPoint().resultants, fb.MidPointRates(), **options)

    assert_refused("three scalars", scheme, strains=lambda step, u, psi: (u[0], u[1]))
    assert_refused("three UFL expressions", scheme, strains=lambda step, u, psi: np.sin(psi))
    assert_refused("must take .step, u, psi", scheme, strains=lambda step: step.strains0)
    assert_refused("must take .law, eps", scheme, energy=lambda eps: eps)
    data = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}
    scene, _ = clamped_bar((1, 0), fb.Section(**data, retardation=0.01), 2)
    own = scheme(strains=lambda step, u, psi: (step.prime(u)[0], 0 * psi, step.prime(psi)))
    assert_refused("viscous forces are not known", fb.simulate, scene, own, dt=0.1, t_end=0.1)


def test_an_energy_of_a_scheme_balances_what_its_resultants_have_beside_the_law():
    """A constant tension: its energy is linear in the axial strain."""
    scene, beam = clamped_bar((1, 0), fb.Section(1e4, 1e4, 100.0, 1.0, 0.1), 4)
    scene.add_force(beam.end, (0, -5.0))
    exact = fb.EnergyMomentum()

    def tense(step, law):
        r = exact.resultants(step, law)
        return type(r)(*r._replace(N=r.N + 10.0))

    def energy(law, eps, gamma, kappa):
        return law.energy(eps, gamma, kappa) + 10.0 * eps

    plain = fb.simulate(scene, fb.Scheme("tense", tense, exact.rates), dt=0.01, t_end=0.2)
    own = fb.Scheme("tense", tense, exact.rates, energy=energy)
    solution = fb.simulate(scene, own, dt=0.01, t_end=0.2)
    np.testing.assert_array_equal(solution.q, plain.q)
    assert abs(plain.energy.balance_error).max() > 1e-3
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_the_weak_form_is_written_as_on_paper():
    def lines(scheme):
        pairs = (line.split(" = ", 1) for line in scheme.written().splitlines())
        return {name.strip(): formula for name, formula in pairs}

    modified = lines(fb.ModifiedMidPoint())
    assert modified["epsilon_i"] == "(phi_i' - t_i) . t_i"
    assert modified["phi'"], modified["t"] == ("phi_m'", "(t_0 + t_1)/2")
    assert modified["N"] == "EA (epsilon_0 + epsilon_1)/2"
    assert modified["m"] == "EI (kappa_0 + kappa_1)/2/(1 + tan(Delta_psi/2)^2)"
    assert modified["n"] == "N t + Q W t"
    terms = "m delta_psi'", "delta_psi W phi' . n", "delta_u' . n"
    assert modified["delta_W"] == "{} - {} + {}".format(*terms)
    assert modified["a"] == "2 (D/Delta_t - v_0)/Delta_t"
    assert lines(fb.MidPoint())["M"] == "EI kappa_m"
    hht = lines(fb.HHT(-0.1))["delta_W"]
    assert hht.startswith("0.1 (m_0 delta_psi'") and " + 0.9 (m_1 delta_psi'" in hht
    exact = lines(fb.EnergyMomentum())
    assert exact["d"] == "h Delta_psi'/4" and "m d cot(d)" in exact["delta_W"]

    def tense(step, law):
        r = fb.MidPoint().resultants(step, law)
        return r._replace(N=r.N + 10.0 * abs(step.strains1[0]) * ufl.exp(step.Du[0]))

    own = lines(fb.Scheme("own", tense, fb.MidPointRates()))
    # UFL has an order of its own for the terms of a sum, not the same in all versions.
    terms = {"EA epsilon_m", "10 |epsilon_1| exp(Delta_u[0])"}
    assert {*own["N"].split(" + ")} == terms


def test_formulas_are_written_in_greek_letters_and_in_latex():
    assert "δW = m δψ' - δψ Wφ' · n + δu' · n" in fb.MidPoint().written("unicode")
    latex = fb.MidPoint().written("latex")
    assert latex.startswith("$$") and latex._repr_latex_() == latex
    assert r"\delta W &= m \, \delta \psi' - \delta \psi \, W \phi' \cdot n" in latex
    assert fb.MidPoint().written()._repr_latex_() is None
    assert_refused("written: format", fb.MidPoint().written, "html")
