"""A researcher's own stored energy, virtual work and scheme."""

import gc
import itertools
import math
from pathlib import Path

import ufl

import numpy as np
import pytest
from scenes import FLYING, assert_refused, clamped_bar, pinned_bar, supported_bar

import fx_beam as fb


def stiffening(eps, gamma, kappa):
    """Stiffens with the strain, softer than FLYING at rest."""
    return 5e3 * (eps**2 + gamma**2) + 2e7 * eps**4 + 30 * kappa**2 + 200 * kappa**4


def same_as_flying(eps, gamma, kappa):
    """The quadratic energy of FLYING, given as a user would."""
    return 0.5 * (1e4 * eps**2 + 1e4 * gamma**2 + 100.0 * kappa**2)


def test_a_discrete_gradient_of_tiny_strains_is_not_lost_in_rounding():
    # Of EA (1 + eps)^2 and its like the rounding, 1e-16 EA, is all that a small increment changes.
    def rubber(eps, gamma, kappa):
        return 100 * ((1 + eps) ** 2 - 1 - 2 * ufl.ln(1 + eps)) + 75 * gamma**2 + kappa**2 / 40

    section = fb.Section(strain_energy=rubber, rhoA=0.1, rhoI=1e-5)
    scene, beam = pinned_bar((1, 0), section, elements=20, gravity=(0, -9.81))
    for dt in (4e-3, 1e-4):
        solution = fb.simulate(scene, dt=dt, t_end=50 * dt)
        assert solution.stats.halvings == 0
        error = abs(solution.energy.balance_error).max()
        assert error < 1e-12 * max(solution.energy.kinetic.max(), 1e-2)


def slack(eps, gamma, kappa):
    """A rope: stiff when it is stretched, quadratic in each of its two pieces."""
    return 5e3 * ufl.max_value(eps, 0) ** 2 + 5 * eps**2 + 50 * gamma**2 + kappa**2 / 2


def two_stiffnesses(x):
    """Another stiffness to each side."""
    return ufl.conditional(ufl.gt(x, 0), 500 * x**2, 5 * x**2)


def test_energies_that_are_quadratic_piece_by_piece_are_kept():
    # Each piece has no third derivative: the law at the mean strain would lose 1e-5 here, and that
    # of the spring 1 %.
    scene = fb.Scene(gravity=(0, -10))
    rope = fb.Section(strain_energy=slack, rhoA=1.0, rhoI=0.01)
    scene.pin(scene.add_beam([(0, 0), (1, 0)], rope, elements=6).start)
    rod = scene.add_beam(
        [(0, 1), (1, 1)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0, rhoI=0.1), elements=1
    )
    spring = fb.Spring(strain_energy=two_stiffnesses)
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, rod.start, axis=(1, 0), spring=spring))
    scene.set_velocity(rod, (3.0, 0.0))
    solution = fb.simulate(scene, dt=0.005, t_end=2.0)
    slide = solution.joint(guide).slide
    assert slide.min() < -0.5 and slide.max() > 0.09
    assert abs(solution.energy.balance_error).max() < 1e-11


SAME = fb.Section(strain_energy=same_as_flying, rhoA=1.0, rhoI=10.0)


@pytest.mark.parametrize("strain", [1e-4, 1e-6])
def test_energies_with_pieces_are_kept_at_small_strains(strain):
    """A bar that is stiffer in compression, and vibrates along its axis."""

    def energy(eps, gamma, kappa):
        stiff = ufl.conditional(ufl.lt(eps, 0), 2e4, 1e4)
        return (stiff * eps**2 + 1e4 * gamma**2 + 10 * kappa**2) / 2

    section = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=1e-2)
    scene, bar = clamped_bar((1, 0), section, elements=2)
    speed = 100 * strain
    scene.set_velocity(bar, lambda x, y: (speed * x, 0.0))
    total = fb.simulate(scene, dt=2e-3, t_end=2.0).energy.total
    assert abs(total - total[0]).max() < 1e-7 * total[0]


def test_beams_of_different_laws_live_in_one_scene():
    def run(first, second):
        scene, a = clamped_bar((1, 0), first, elements=2, gravity=(0, -9.81))
        b = scene.add_beam([a.end, (2, 0)], second, elements=2)
        solution = fb.simulate(scene, dt=0.02, t_end=1.0)
        r = solution.resultants(b)
        return np.column_stack([solution.position(b.end), r.N[:, -1], r.M[:, 0]])

    soft = fb.Section(EA=5e3, GA=2e3, EI=30.0, rhoA=1.0, rhoI=0.1)
    assert run(soft, SAME) == pytest.approx(run(soft, FLYING), rel=1e-7, abs=1e-7)
    assert run(SAME, soft) == pytest.approx(run(FLYING, soft), rel=1e-7, abs=1e-7)


def test_sections_of_equal_energies_have_the_resultants_of_one_that_is_shared():
    def run(sections):
        scene = fb.Scene(gravity=(0, -9.81))
        beams = [
            scene.add_beam([(k, 0), (k + 1, 0)], member_section, elements=1)
            for k, member_section in enumerate(sections)
        ]
        for a, b in itertools.pairwise(beams):
            scene.add_joint(fb.Rigid(a.end, b.start))
        scene.clamp(beams[0].start)
        solution = fb.simulate(scene, dt=0.02, t_end=0.2)
        return np.array([solution.resultants(beam).M for beam in beams])

    def section():
        def energy(*strains):
            return stiffening(*strains)

        return fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.1)

    shared = section()
    assert (run([section(), SAME, section()]) == run([shared, SAME, shared])).all()


def test_resultants_of_a_given_energy_are_its_derivatives():
    # A massless bar pulled by F: 1e4 eps + 8e7 eps^3 = F, 180 for eps = 0.01.
    scene, beam = clamped_bar((1, 0), fb.Section(strain_energy=stiffening), elements=2)
    scene.add_force(beam.end, lambda t: (180.0 * min(1.0, t), 0.0))
    # Newmark's rule is in equilibrium at the end of a step, whatever came before.
    solution = fb.simulate(scene, fb.Newmark(), dt=0.25, t_end=2.0)
    assert solution.displacement(beam.end)[-1, 0] == pytest.approx(0.01, rel=1e-9)
    assert solution.resultants(beam).N[-1] == pytest.approx(180.0, rel=1e-9)


# -- Added virtual work -------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(-0.1)])
def test_a_viscous_force_slows_a_sliding_beam_exponentially(scheme):
    # rhoA dv/dt = -c v; the mid-point rule has v1/v0 = (1 - z)/(1 + z), z = c dt/(2 rhoA).
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (2, 1)], FLYING, elements=3)
    scene.set_velocity(beam, (3.0, -1.0))
    scene.add_virtual_work(lambda step: -0.7 * ufl.dot(step.v, step.virtual_u))
    solution = fb.simulate(scene, scheme, dt=0.05, t_end=2.0)
    decay = solution.velocity(beam.end)[:, 0] / 3.0
    if scheme.rates.level == 0.5:
        z = 0.7 * 0.05 / 2
        assert decay == pytest.approx(((1 - z) / (1 + z)) ** np.arange(41), rel=1e-10)
        assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.total[0]
    assert decay == pytest.approx(np.exp(-0.7 * solution.t), abs=3e-4)


def test_a_follower_load_turns_with_the_beam():
    # A stiff rotor, pinned in the middle, pushed by forces that stay normal to it: torque
    # q L^2/4 about the pin, constant while it turns, so that the spin grows linearly.
    scene = fb.Scene()
    section = fb.Section(EA=1e7, GA=1e7, EI=1e6, rhoA=1.0, rhoI=1.0)
    rotor = scene.add_beam([(-1, 0), (1, 0)], section, elements=8)
    scene.pin(rotor.node(0.5))

    def normal_load(step):
        t = step.director
        side = ufl.conditional(ufl.gt(step.X[0], 0), 1.0, -1.0)
        return 3.0 * side * (t[0] * step.virtual_u[1] - t[1] * step.virtual_u[0])

    scene.add_virtual_work(normal_load)
    solution = fb.simulate(scene, dt=0.02, t_end=3.0)
    inertia = 2 * 1.0 + 1.0 * 2**3 / 12
    # The lever at mid-step is shorter than the rotor by cos(Dpsi/2).
    assert solution.angular_momentum == pytest.approx(3.0 * solution.t, rel=1e-3, abs=1e-9)
    assert solution.rotation(rotor.start)[-1] == pytest.approx(3.0 / inertia * 4.5, rel=1e-3)
    assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.total[-1]


# -- A scheme of one's own ----------------------------------------------------------------------


def damped(eta):
    """Averaged resultants with a part of the strain rate, as a user would write it."""

    def resultants(step, law):
        r = fb.MidPoint().resultants(step, law)
        turned = ufl.as_vector((-r.dphi[1], r.dphi[0]))
        rate = step.prime(step.Du) - 2 * ufl.tan(step.Dpsi / 2) * turned
        N = r.N + eta * ufl.dot(rate, r.t) / step.dt
        return r._replace(N=N)

    return fb.Scheme("Damped", resultants, fb.MidPointRates())


def test_a_scheme_of_ones_own_damps_stretching_and_keeps_momentum():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=4)
    scene.set_velocity(beam, lambda x, y: (10 * (x - 0.5), 2.0 * (x - 0.5)), spin=2.0)
    undamped = fb.simulate(scene, damped(0.0), dt=0.002, t_end=1.0)
    lost = fb.simulate(scene, damped(50.0), dt=0.002, t_end=1.0)
    assert undamped.energy.total[-1] == pytest.approx(undamped.energy.total[0], rel=1e-3)
    assert lost.energy.total[-1] < 0.9 * lost.energy.total[0]
    assert lost.angular_momentum == pytest.approx(lost.angular_momentum[0], rel=1e-10)
    assert lost.stats.scheme == "Damped"


@pytest.mark.parametrize(
    "factor",
    [math.sin, np.sin, lambda t: np.interp(t, [0, 1], [0, 1]), lambda t: fb.Input("wind")],
    ids=["math", "numpy", "interp", "input"],
)
def test_what_needs_numbers_is_refused_at_once(factor):
    scene = fb.Scene()
    scene.clamp(scene.add_beam([(0, 0), (1, 0)], FLYING, elements=1).start)
    with pytest.raises(fb.SceneError, match="use ufl.sin, ufl.conditional"):
        scene.add_virtual_work(lambda step: factor(step.t) * step.virtual_u[1])
    assert float(ufl.as_ufl(2.0)) == 2.0  # UFL is as before

    def rule(D, v0, a0, before, dt):
        return ufl.as_vector((math.sin(D[0]), D[1], D[2])), v0, a0

    assert_refused("must give three UFL vectors", lambda: fb.NodalRates(rule))


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_refused_by_the_name_of_the_function(number):
    scene, arm = clamped_bar((1, 0), FLYING, elements=1)
    for name, give in (
        ("strain_energy", lambda f: fb.Section(strain_energy=lambda e, g, k: f(e) + g**2 + k**2)),
        ("Spring", lambda f: fb.Spring(strain_energy=f)),
        ("law", lambda f: fb.Damper(law=f)),
        ("NodalRates", lambda f: fb.NodalRates(lambda D, v0, *rest: (f(D[0]) * D, v0, v0))),
        ("energy", lambda f: scene.add_contact(arm.end, fb.Line((0, -1), (0, 1)), energy=f)),
    ):
        with pytest.raises(fb.SceneError, match=f"{name}.* contains the number {number}"):
            give(lambda x: number * x**2)
    with pytest.raises(fb.SceneError, match=f"of Damped: it contains the number {number}"):
        fb.simulate(scene, damped(number), dt=0.1, t_end=0.1)
    scene.add_virtual_work(lambda step: number * step.virtual_u[1])
    with pytest.raises(fb.SceneError, match=f"virtual work 1.* contains the number {number}"):
        fb.simulate(scene, dt=0.1, t_end=0.1)


def test_a_prestressed_section_with_pieces_moves_as_one_without_where_these_do_not_meet():
    """A cable that only takes tension: round-off of its energy is no force in tiny motions."""

    def end(energy):
        section = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=1e-2)
        scene, bar = supported_bar((1, 0), section, elements=4, held="x", load=(0.0, 0.01))
        solution = fb.simulate(scene, dt=1e-4, t_end=5e-3)
        assert solution.stats.newton_iterations < 250
        return solution.displacement(bar.end)[-1, 1]

    def cable(e, g, k):
        return 5e6 * ufl.max_value(e + 1e-2, 0) ** 2 + 5e6 * g**2 + 10 * k**2

    def plain(e, g, k):
        return 5e6 * (e + 1e-2) ** 2 + 5e6 * g**2 + 10 * k**2

    assert end(cable) == pytest.approx(end(plain), rel=1e-6)


# -- What a step is without motion --------------------------------------------------------------


def _held_by(work):
    """A loaded arm with a virtual work: its equilibria by one step and by three, and its modes."""
    section = fb.Section(EA=3e3, GA=1.2e3, EI=20.0, rhoA=1.0, rhoI=0.01)
    scene, arm = clamped_bar((1, 0.3), section, elements=2, gravity=(0, -9.81))
    scene.add_virtual_work(work)
    states = [fb.static(scene, load_steps=n) for n in (1, 3)]
    roots = [fb.modes(scene, state, n=2).eigenvalues for state in (None, states[0])]
    return [state.q[-1] for state in states], roots


@pytest.mark.parametrize(
    ("step_work", "level_work"),
    [
        (
            lambda step: -2 * ufl.dot(step.Du, step.virtual_u) / step.dt,
            lambda step: -2 * ufl.dot(step.v, step.virtual_u),
        ),
        (
            lambda step: -30 * step.u0[1] * step.virtual_u[1],
            lambda step: -30 * step.u[1] * step.virtual_u[1],
        ),
    ],
    ids=["increment over length", "start of the step"],
)
def test_forces_of_increments_and_starts_know_no_motion_in_load_steps(step_work, level_work):
    # As the steps of the load get shorter, both are the same force.
    step_forces, wanted = _held_by(step_work), _held_by(level_work)
    for values, exact in zip(
        [*step_forces[0], *step_forces[1]], [*wanted[0], *wanted[1]], strict=True
    ):
        assert values == pytest.approx(exact, rel=1e-8, abs=1e-10)
    assert step_forces[0][0] == pytest.approx(step_forces[0][1], abs=1e-10)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize(
    "step_work",
    [
        lambda step: step.u0 + 0.1 * step.Du / step.dt,
        lambda step: step.u0 + step.Du + 0.1 * step.v,
        lambda step: step.u_before + 0.1 * step.v,
    ],
    ids=["start", "end", "start of the last step"],
)
def test_small_motions_see_forces_of_starts_and_ends_as_those_of_places(step_work, moves):
    def system(force, state=None):
        section = fb.Section(EA=3e3, GA=1.2e3, EI=20.0, rhoA=1.0, rhoI=0.01)
        scene, arm = clamped_bar((1, 0.3), section, elements=2, gravity=(0, -9.81))
        scene.add_virtual_work(lambda step: -30 * ufl.dot(force(step), step.virtual_u))
        motion = fb.simulate(scene, dt=0.01, t_end=0.1) if moves and state is None else state
        return fb.linearise(scene, state=motion).A, motion

    expected, motion = system(lambda step: step.u + 0.1 * step.v)
    computed, _ = system(step_work, motion)
    assert abs(computed - expected).max() < 1e-6 * abs(expected).max()
    values = (np.sort_complex(np.linalg.eigvals(A)) for A in (computed, expected))
    assert next(values) == pytest.approx(next(values), rel=1e-4)


def mapped():
    """Files of code that this process has mapped, also those that were removed since."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return {tuple(line.split(maxsplit=5)[3:]) for line in lines if ".so" in line}


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux says what is mapped")
@pytest.mark.parametrize("law", ["section", "spring", "work"])
def test_code_of_laws_that_nothing_has_any_more_leaves_the_process(law):
    def motion(number):
        def energy(eps, gamma, kappa):
            return same_as_flying(eps, gamma, kappa) + number * kappa**4

        own = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.1)
        scene = fb.Scene(gravity=(0.0, -9.81))
        beam = scene.add_beam([(0, 0), (1, 0)], own if law == "section" else FLYING, elements=2)
        spring = fb.Spring(strain_energy=lambda x: number * x**4) if law == "spring" else None
        scene.add_joint(fb.Revolute(fb.GROUND, beam.start, spring=spring))
        if law == "work":
            scene.add_virtual_work(lambda step: number * step.virtual_u[0], beam)
        return fb.simulate(scene, dt=0.01, t_end=0.03, record=fb.Record(rates=True))

    def left_by_others(first, count):
        # Code of tests before may go at any time: what counts is what comes and stays.
        before = mapped()
        for k in range(first, first + count):
            motion(1.0 + 0.01 * k)
        gc.collect()
        return len(mapped() - before)

    undamped = motion(0.5)
    together, known = left_by_others(0, 1), undamped.energy.total[-1]
    assert left_by_others(1, 2) <= together
    # What a solution reads later is there as long as the solution.
    N = undamped.resultants(next(iter(undamped.beams.values()))).N
    assert np.isfinite(N).all()
    again = motion(0.5)
    assert again.energy.total[-1] == known
    assert np.array_equal(again.resultants(next(iter(again.beams.values()))).N, N)
