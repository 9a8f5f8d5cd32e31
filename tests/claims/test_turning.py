"""Steady turns: their equilibria, modes, responses, linear systems, in the turning frame."""

import copy

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from numpy.polynomial import Polynomial
from scenes import assert_refused, hinged_body, one_body, pinned_bar

import fx_beam as fb

SLENDER = fb.Section(EA=1e7, GA=1e7, EI=1.0, rhoA=1.0, rhoI=0.0)
BLADE = fb.Section(EA=1e5, GA=1e5, EI=10.0, rhoA=1.0, rhoI=1e-4)


def blade(section=BLADE, spin=0.0, elements=8, degree=2):
    """A blade on a hub of no radius, which turns with the frame, or is driven in space."""
    scene, beam = pinned_bar((1, 0), section, elements=elements, degree=degree)
    if spin:
        scene.prescribe(beam.start, rotation=lambda t: spin * t)
    else:
        scene.fix(beam.start, "rotation")
    return scene, beam


# -- Equilibrium ---------------------------------------------------------------------------------


def test_a_turning_bar_stretches_by_the_centrifugal_force():
    # u'' + k^2 (x + u) = 0 with k^2 = rhoA W^2 / EA, and u(0) = u'(1) = 0.
    spin, k = 60.0, 60.0 / np.sqrt(1e5)
    scene, beam = blade()
    state = fb.static(scene, load_steps=4, spin=spin)
    assert state.displacement(beam.end)[-1] == pytest.approx([np.tan(k) / k - 1, 0], rel=1e-6)
    assert state.velocity(beam.end)[-1] == pytest.approx([0, spin * np.tan(k) / k], rel=1e-6)
    assert state.reaction(beam.start)[-1, 0] == pytest.approx(-1e5 * (1 / np.cos(k) - 1), rel=1e-5)


def test_the_work_of_a_turn_is_its_kinetic_and_its_strain_energy():
    scene, beam = blade()
    scene.add_force(beam.end, (0.0, 1.0))
    errors = []
    for steps in (5, 10):
        energy = fb.static(scene, load_steps=steps, spin=20.0, pivot=(-0.3, 0.0)).energy
        assert energy.kinetic[-1] > 100 * energy.strain[-1] > 0
        errors.append(abs(energy.balance_error[-1]) / energy.strain[-1])
    assert errors[1] < 0.3 * errors[0] < 0.01


@pytest.mark.parametrize("spin", [1.0, 60.0, 200.0])
def test_reactions_of_a_turn_that_stops_fall_in_equal_steps(spin):
    """As the forces of the turn fade on all nodes, the supported ones too."""
    scene, beam = blade()
    turning = fb.static(scene, load_steps=4, spin=spin)
    stopped = fb.static(scene, load_steps=4, start=turning).reaction(beam.start)
    expected = turning.reaction(beam.start)[-1] * np.linspace(1, 0, 5)[:, None]
    assert stopped == pytest.approx(expected, rel=0, abs=1e-8 * abs(expected).max())


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.Newmark()], ids=lambda s: s.name)
def test_a_motion_from_a_turn_goes_on_turning(scheme):
    spin, gaps = 5.0, []
    scene, beam = blade(spin=spin)
    state = fb.static(scene, spin=spin)
    for dt in (2e-3, 1e-3):
        motion = fb.simulate(scene, scheme, dt=dt, t_end=0.4, start=state)
        r, angle = abs(z := motion.position(beam.end) @ [1, 1j]), np.angle(z)
        stretch = state.displacement(beam.end)[-1, 0]
        gaps.append(abs(r * np.exp(1j * (angle - spin * motion.t)) - 1 - stretch).max())
        assert motion.energy.kinetic[0] == pytest.approx(state.energy.kinetic[-1], rel=1e-14)
    assert gaps[1] < 0.3 * gaps[0] < 1e-4


# -- Frequencies in closed form --------------------------------------------------------------------


def on_rail(normal, spin):
    """A mass on a spring, on a rail through the pivot or normal to the arm; modes in the turn."""
    scene, body = one_body((0.4, 0), mass=2.0, inertia=0.1)
    axis = (0, 1) if normal else (1, 0)
    rail = fb.Prismatic(fb.GROUND, body.centre, axis=axis, spring=fb.Spring(50.0))
    rail = scene.add_joint(rail)
    return scene, body, rail, fb.static(scene, load_steps=4, spin=spin)


@pytest.mark.parametrize("normal", [True, False], ids=["lagging", "radial"])
def test_a_mass_on_a_spring_loses_the_square_of_the_spin(normal):
    scene, body, rail, state = on_rail(normal, spin=3.0)
    reach = 0.0 if normal else 2 * 9 * 0.4 / (50 - 2 * 9)
    assert state.joint(rail).slide[-1] == pytest.approx(reach, abs=1e-10)
    modes = fb.modes(scene, state, n=1)
    assert modes.angular_frequencies == pytest.approx([np.sqrt(50 / 2 - 9)], rel=1e-9)
    f = [0.0, 0.3, 2.0]
    seen = fb.frequency_response(scene, (body.centre, (1.0, 1.0)), rail, f, state).values[:, 0]
    assert seen == pytest.approx(1 / (50 - 18 - 2 * (2 * np.pi * np.array(f)) ** 2), rel=1e-9)
    # Beyond the spin sqrt(k/m) = 5 nothing holds the mass.
    if normal:
        lost = fb.modes(scene, fb.static(scene, spin=6.0), n=1)
        assert lost.unstable.all()
        assert lost.angular_frequencies == pytest.approx([-np.sqrt(36 - 25)], rel=1e-9)


def whirling(kx, ky, spin, retardation=0.0):
    """A mass m = 1 at the pivot between four massless bars, of stiffness kx and ky in all."""
    scene, m = one_body((0, 0), mass=1.0, inertia=1.0)
    for x, y, k in ((1, 0, kx), (-1, 0, kx), (0, 1, ky), (0, -1, ky)):
        bar = fb.Section(EA=k / 2, GA=k / 2, EI=1e3, retardation=retardation)
        bar = scene.add_beam([(x, y), (0, 0)], bar, elements=1)
        scene.pin(bar.start)
        scene.add_joint(fb.Revolute(m.centre, bar.end))
    scene.fix(m.centre, "rotation")
    return scene, fb.static(scene, load_steps=2, spin=spin)


@pytest.mark.parametrize("spin", [3.0, 14.0])
def test_a_symmetric_rotor_whirls_forwards_and_backwards_at_every_spin(spin):
    omega = 10.0
    scene, state = whirling(omega**2, omega**2, spin)
    modes = fb.modes(scene, state, n=2)
    assert modes.angular_frequencies == pytest.approx([abs(omega - spin), omega + spin], rel=1e-8)
    assert not modes.unstable.any()
    for shape, turns in zip(modes.shapes[:, 0], (np.sign(omega - spin), -1), strict=True):
        # x + i y turns forwards with e^(i omega t) where y lags a quarter behind x.
        assert shape[1] / shape[0] == pytest.approx(-1j * turns, abs=1e-6)


def roots(kx, ky, c, spin):
    """Roots of a mass on two springs with dampers in the turning frame, by its polynomial."""
    x, y = (Polynomial([k - spin**2, c * k, 1.0]) for k in (kx, ky))
    computed = (x * y + Polynomial([0, 2 * spin]) ** 2).roots()
    computed = computed[computed.imag >= -1e-9]
    return computed[np.lexsort((computed.imag, abs(computed)))]


@pytest.mark.parametrize(
    ("kx", "ky", "c", "spin"),
    [
        (100.0, 144.0, 0.0, 11.0),  # between the critical speeds
        (100.0, 144.0, 0.0, 13.0),
        (100.0, 100.0, 0.002, 9.0),
        (100.0, 100.0, 0.002, 11.0),  # damping inside the rotor drives it beyond the critical speed
    ],
)
def test_an_unsymmetric_or_damped_rotor_has_the_roots_of_its_polynomial(kx, ky, c, spin):
    scene, state = whirling(kx, ky, spin, retardation=c)
    modes, exact = fb.modes(scene, state, n=3), roots(kx, ky, c, spin)
    for root in modes.eigenvalues:
        assert abs(exact - root).min() < 1e-6 * abs(root)
    unstable = spin == 11.0
    assert modes.unstable.any() == unstable == (exact.real.max() > 1e-6)
    system = np.linalg.eigvals(fb.linearise(scene, state).A)
    for root in exact:
        assert abs(system - root).min() < 1e-6 * abs(root)


def test_a_turn_that_is_free_exchanges_angular_momentum_with_what_vibrates():
    # m r'' = L^2 m r / (J + m r^2)^2 - k (r - r0) at the angular momentum L = (J + m r^2) W.
    k, m, J, r0, spin = 80.0, 2.0, 0.3, 0.5, 4.0
    scene, hub = one_body((0, 0), mass=1.0, inertia=J)
    bead = scene.add_body((r0, 0), mass=m, inertia=1e-9)
    scene.add_joint(fb.Revolute(fb.GROUND, hub.centre))
    rail = fb.Prismatic(hub.centre, bead.centre, axis=(1, 0), offset=(r0, 0), spring=fb.Spring(k))
    rail = scene.add_joint(rail)
    held = copy.copy(scene)
    held.fix(held.bodies[0].centre, "rotation")
    state = fb.static(held, spin=spin)
    r = k * r0 / (k - m * spin**2)
    assert r0 + state.joint(rail).slide[-1] == pytest.approx(r)
    driven, free = fb.modes(held, state), fb.modes(scene, state)
    assert driven.angular_frequencies == pytest.approx([np.sqrt(k / m - spin**2)])
    J += 1e-9
    exact = k / m + spin**2 * (3 * m * r**2 - J) / (J + m * r**2)
    assert free.rigid.tolist() == [True, False]
    assert free.angular_frequencies == pytest.approx([0, np.sqrt(exact)], rel=1e-7)
    system = fb.linearise(scene, state)
    assert abs(np.linalg.eigvals(system.A)).max() == pytest.approx(np.sqrt(exact), rel=1e-7)


# -- Turning blades -------------------------------------------------------------------------------


def ritz(eta, hub=0.0):
    """Two lowest frequencies of bending in the plane of the turn, and those out of it.

    For EI = rhoA = L = 1 and infinite EA, by the Rayleigh-Ritz method with x^2 times Legendre
    polynomials: stiffness of bending, the tension eta^2 ((1 - x^2)/2 + hub (1 - x)), and in the
    plane -eta^2 of the frame.
    """
    x, weight = np.polynomial.legendre.leggauss(40)
    x, weight = (x + 1) / 2, weight / 2
    P = [np.polynomial.Legendre.basis(i, [0, 1]) for i in range(14)]
    P, dP, ddP = (np.array([p.deriv(k)(x) if k else p(x) for p in P]) for k in range(3))
    w, dw, ddw = x**2 * P, 2 * x * P + x**2 * dP, 2 * P + 4 * x * dP + x**2 * ddP
    tension = eta**2 * ((1 - x**2) / 2 + hub * (1 - x))
    K, M = (ddw * weight) @ ddw.T + (dw * weight * tension) @ dw.T, (w * weight) @ w.T
    squares = scipy.linalg.eigh(K, M, eigvals_only=True)[:2]
    return np.sqrt(squares - eta**2), np.sqrt(squares)


#: First frequencies of bending out of the plane: Wright, Smith, Thresher, Wang (1982), Vibration
#: modes of centrifugally stiffened beams, J. Appl. Mech. 49; also Hodges and Rutkowski (1981).
PUBLISHED = {0: 3.5160, 1: 3.6816, 3: 4.7973, 6: 7.3604}


def test_a_turning_cantilever_has_the_published_table():
    for eta, published in PUBLISHED.items():
        scene, _ = blade(SLENDER, elements=10, degree=3)
        modes = fb.modes(scene, fb.static(scene, load_steps=2, spin=float(eta)), n=1)
        # Out of the plane the frame takes nothing from the square.
        across = np.hypot(modes.angular_frequencies[0], eta)
        assert across == pytest.approx(published, abs=6e-5)
        assert ritz(eta)[1][0] == pytest.approx(published, abs=6e-5)


@pytest.mark.parametrize(("eta", "hub"), [(3, 0.0), (6, 1.0)])
def test_a_slender_blade_has_the_frequencies_of_the_ritz_method(eta, hub):
    scene, _ = blade(SLENDER, elements=10, degree=3)
    state = fb.static(scene, load_steps=2, spin=float(eta), pivot=(-hub, 0.0))
    modes = fb.modes(scene, state, n=2)
    # Axial elasticity of 1e-7 of the stiffness and Coriolis forces change the last digits.
    assert modes.angular_frequencies == pytest.approx(ritz(eta, hub)[0], rel=2e-5)


def test_a_blade_vibrates_in_its_turn_with_its_frequency():
    spin, size = 5.0, 1e-4
    scene, beam = blade(spin=spin)
    scene.add_force(beam.end, fb.Input("push"), follower=True)
    state = fb.static(scene, spin=spin)
    modes = fb.modes(scene, state, n=2)
    omega = modes.angular_frequencies[0]
    outputs = fb.Output("displacement", beam.end, "y"), fb.Output("rotation", beam.end)
    system = fb.linearise(scene, state, outputs=dict(zip(("tip", "slope"), outputs, strict=True)))
    roots = np.linalg.eigvals(system.A)
    for own in modes.angular_frequencies:
        assert abs(roots - 1j * own).min() < 1e-7 * own
    assert omega == pytest.approx(np.sqrt(10) * ritz(spin / np.sqrt(10))[0][0], rel=2e-3)
    pulse = {"push": lambda t: (0.0, size * (np.sin(np.pi * min(t, 0.3) / 0.3) ** 2))}
    pushed = fb.simulate(scene, dt=2e-3, t_end=3.0, start=state, inputs=pulse)
    lag = ((pushed.position(beam.end) @ [1, 1j]) * np.exp(-1j * spin * pushed.t)).imag[200:]

    def misfit(w):
        basis = np.column_stack([f(w * pushed.t[200:]) for f in (np.cos, np.sin, np.ones_like)])
        return np.linalg.norm(lag - basis @ np.linalg.lstsq(basis, lag, rcond=None)[0])

    bounds = {"bounds": (omega - 0.8, omega + 1.5), "options": {"xatol": 1e-6}}
    measured = scipy.optimize.minimize_scalar(misfit, method="bounded", **bounds).x
    assert measured == pytest.approx(omega, rel=3e-4)
    # The state that feedback sees is the one that turns.
    x = system.deviation(pushed)
    slope = pushed.rotation(beam.end)[-1] - spin * pushed.t[-1]
    assert system.C @ x == pytest.approx([lag[-1], slope], abs=1e-3 * abs(lag).max())
    assert abs(system.deviation(state)).max() < 1e-12


def test_a_linear_system_of_a_turning_motion_says_where_to_find_that_of_its_turn(caplog):
    spin = 5.0
    scene, beam = blade(spin=spin, elements=4)
    turning = fb.simulate(scene, dt=1e-3, t_end=0.05, start=fb.static(scene, spin=spin))
    fb.linearise(scene, turning)
    assert "turns as a whole, at 5 rad/s about" in caplog.text and "spin=..." in caplog.text
    caplog.clear()
    # The angle of a rigid body is the same in every frame.
    single, body, _ = hinged_body((1, 0), 1.0, 0.1, {"pin": (0, 0)})
    single.set_velocity(body, lambda x, y: (-spin * y, spin * x), spin=spin)
    fb.linearise(single, fb.simulate(single, dt=1e-3, t_end=0.05))
    fb.linearise(scene, fb.static(scene, spin=spin))
    assert not caplog.text


def test_many_modes_of_a_blade_are_the_poles_of_its_linear_system():
    scene, beam = blade(elements=12)
    scene.add_force(beam.end, (0.0, 5.0))
    state = fb.static(scene, spin=40.0)
    poles = np.linalg.eigvals(fb.linearise(scene, state).A).imag
    frequencies = fb.modes(scene, state, n=8).angular_frequencies
    assert frequencies == pytest.approx(np.sort(poles[poles > 0])[:8], rel=1e-7)


def test_modes_of_a_saved_turn_about_another_pivot_are_the_same(tmp_path):
    scene, _ = blade()
    state = fb.static(scene, spin=7.0, pivot=(0.2, -0.3))
    state.save(tmp_path / "turn.npz")
    modes = [fb.modes(scene, s, n=3) for s in (state, fb.load(tmp_path / "turn.npz"))]
    assert (modes[0].eigenvalues == modes[1].eigenvalues).all()


# -- What is refused ------------------------------------------------------------------------------


def test_a_state_without_balance_is_refused_with_what_is_left():
    scene = fb.Scene(gravity=(0, -10.0))
    body = scene.add_body((0, 0), mass=2.0, inertia=0.1, points={"pin": (-1, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, body.points["pin"]))
    held = copy.copy(scene)
    held.fix(held.bodies[0].centre, "rotation")
    state = fb.static(held)
    words = r"the state is no equilibrium: 20 N m in rotation of node 0 at \(0, 0\) has no balance"
    for ask in (
        lambda: fb.modes(scene, state),
        lambda: fb.frequency_response(scene, (body.centre, (0, 1.0)), body.centre, [1.0], state),
    ):
        assert_refused(words, ask)
    assert len(fb.linearise(scene, state).A) == 2  # of the moment


def test_a_state_that_moves_on_is_refused():
    spin = 5.0
    scene, beam = blade(spin=spin)
    scene.set_velocity(beam, lambda x, y: (0, spin * x), spin=spin)
    turning = fb.simulate(scene, dt=1e-3, t_end=0.05)
    assert_refused("no equilibrium.*static.scene, spin=....", fb.modes, scene, turning)
    scene, beam = blade()
    swing = fb.simulate(scene, dt=1e-3, t_end=0.05)
    assert len(fb.modes(scene, swing, n=2)) == 2  # nothing moved
    scene.set_velocity(beam, lambda x, y: (0, 1e-2 * x**2), spin=lambda x, y: 2e-2 * x)
    passing = fb.simulate(scene, dt=1e-3, t_end=1e-3)
    assert_refused("no equilibrium", fb.modes, scene, passing)


def test_what_does_not_turn_with_the_scene_is_refused():
    scene, beam = blade()
    state = fb.static(scene, spin=1.0)
    scene.add_drag(beam, linear=0.1)
    for ask in (lambda: fb.static(scene, spin=1.0), lambda: fb.modes(scene, state)):
        assert_refused("drag in air at rest does not turn with", ask)
    heavy = fb.Scene(gravity=(0, -9.81))
    heavy.clamp(heavy.add_beam([(0, 0), (1, 0)], BLADE, elements=1).start)
    assert_refused("gravity does not turn with the scene", fb.static, heavy, spin=1.0)
    # A clamp of the turning frame stands still in space.
    clamped, _ = blade()
    with pytest.raises(fb.SceneError, match="supported in rotation, but its initial rate there is"):
        fb.simulate(clamped, dt=0.01, t_end=0.1, start=fb.static(clamped, spin=1.0))
