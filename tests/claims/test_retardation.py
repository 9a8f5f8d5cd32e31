"""Kelvin-Voigt damping of members: exact solutions, balance, all schemes, degrees and solvers."""

from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest
from scenes import PINNED, assert_refused, clamped_bar, one_bar, pinned_beam

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.ModifiedMidPoint(),
    fb.EnergyDecaying(1e-6),
    fb.Newmark(),
    fb.HHT(-0.02),
]


def oscillator(tau, component=0, speed=1e-3):
    """A unit mass that moves in one component at the end of a massless rod; w = 10 rad/s."""
    stiffnesses = "EA", "GA", "EI"
    # A rotation of the end shears the element as well.
    data = {name: 1e-9 for name in stiffnesses} | {stiffnesses[component]: 100.0}
    scene, rod = clamped_bar((1, 0), fb.Section(**data, retardation=tau), elements=1)
    names = "x", "y", "rotation"
    scene.fix(rod.end, *(name for i, name in enumerate(names) if i != component))
    scene.add_mass(rod.end, 1.0, inertia=1.0)
    v = [0.0, 0.0, 0.0]
    v[component] = speed
    scene.set_velocity(rod.end, v[:2], spin=v[2])
    return scene, rod


def exact(t, tau, w=10.0, v=1e-3):
    ratio = tau * w / 2
    wd = w * np.sqrt(1 - ratio**2)
    return v / wd * np.exp(-ratio * w * t) * np.sin(wd * t)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_an_axial_oscillator_and_its_force_are_exact_to_the_order_of_the_scheme(scheme):
    tau, errors = 0.02, []
    for dt in (0.01, 0.005):
        scene, rod = oscillator(tau)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
        x = solution.displacement(rod.end)[:, 0]
        errors.append(abs(x - exact(solution.t, tau)).max())
    order = 4 if "order=4" in scheme.name else 2
    assert np.log2(errors[0] / errors[1]) > order - 0.2
    assert errors[1] < 1e-6
    # With its viscous part, at the end of the rod it is the inertia of the mass.
    scene, rod = oscillator(0.05, speed=1.0)
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=0.3)
    N = solution.resultants(rod).N[:, 0]
    reaction = -solution.reaction(rod.start)[:, 0]
    assert N[1:] == pytest.approx(reaction[1:], abs=1e-9 * abs(N).max())
    assert N[0] == pytest.approx(100.0 * 0.05 * 1.0, rel=1e-5)
    assert abs(N[1]) > 0


@pytest.mark.parametrize("component", [0, 1, 2])
def test_each_strain_has_its_own_time(component):
    times = 0.03, 0.05, 0.02
    scene, _ = oscillator(times, component)
    solution = fb.simulate(scene, dt=0.002, t_end=1.0)
    q = solution.q[:, -1, component]
    assert abs(q - exact(solution.t, times[component])).max() < 2e-7


def stiffening(eps, gamma, kappa):
    return 2e7 * (eps**2 + eps**4) + 5e6 * gamma**2 + 6.5e6 * kappa**2


@pytest.mark.parametrize(
    ("degree", "section", "dt"),
    [
        (1, {"retardation": 1e-3}, 0.01),
        (2, {"retardation": (0.0, 1e-4, lambda s: 1e-2 * s)}, 0.01),
        (1, {"retardation": 1e-3, "strain_energy": stiffening}, 0.005),
    ],
    ids=["one", "triple", "own energy"],
)
def test_the_balance_closes_and_every_step_loses(degree, section, dt):
    data = {"EA": 4e7, "GA": 1e7, "EI": 1.3e7} if "strain_energy" not in section else {}
    damped = fb.Section(**data, rhoA=0.05, rhoI=1 / 60, **section)
    scene, beam = pinned_beam(elements=4, degree=degree, section=damped)
    solution = fb.simulate(scene, dt=dt, t_end=0.2)
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-11 * energy.total[0]
    assert np.diff(energy.dissipated).min() > 0
    assert energy.dissipated[-1] > 1e-3 * energy.total[0]
    L = solution.angular_momentum
    assert abs(L - L[0]).max() < 1e-11 * abs(L[0])
    # A third quantity: the reaction gives the change of the momentum.
    forces = np.diff(solution.linear_momentum, axis=0) / dt
    assert abs(solution.reaction(beam.start)[1:, :2] - forces).max() < 1e-8 * abs(forces).max()


def test_the_newmark_family_loses_by_the_material():
    section = fb.Section(EA=4e5, GA=1e5, EI=1.3e7, rhoA=0.05, retardation=0.01)
    scene, _ = pinned_beam(section=section)
    solution = fb.simulate(scene, fb.Newmark(), dt=0.005, t_end=0.2)
    assert np.diff(solution.energy.dissipated).min() >= 0
    loss = solution.energy.total[0] - solution.energy.total[-1]
    assert solution.energy.dissipated[-1] == pytest.approx(loss, rel=0.05)


def test_statics_and_undamped_scenes_know_nothing_of_it():
    scene, beam = pinned_beam(section=PINNED)
    assert "lost energy" not in fb.simulate(scene, dt=0.01, t_end=0.1).stats.compiled
    tips = []
    for tau in (0.0, 0.1):
        section = fb.Section(EA=1e6, GA=1e6, EI=1e3, retardation=tau)
        cantilever, arm = clamped_bar((1, 0), section, elements=4, load=(0.0, -100.0))
        tips.append(fb.static(cantilever, load_steps=2).displacement(arm.end)[-1])
    assert tips[1] == pytest.approx(tips[0], rel=1e-12)


@pytest.mark.parametrize("middle", [2e-3, lambda f: 2e-3], ids=["number", "function"])
def test_three_times_may_have_names(middle):
    times = namedtuple("Times", ["axial", "shear", "bending"])(1e-3, middle, 3e-3)
    section = fb.Section(EA=1.0, GA=1.0, EI=1.0, retardation=times)
    known = None if callable(middle) else [1e-3, 2e-3, 3e-3]
    assert section.constants(("retardation",)) == known


def test_bad_times_are_refused():
    data = {"EA": 1.0, "GA": 1.0, "EI": 1.0}
    for tau in (-1.0, np.nan, "long", (1.0, 2.0), (0.1, -0.1, 0.1), lambda s: -1.0):
        assert_refused("retardation", fb.Section, **data, retardation=tau)
    with pytest.raises(fb.SceneError, match="one time for all strains"):
        fb.Section(strain_energy=stiffening, retardation=(0.1, 0.1, 0.1))


@pytest.mark.parametrize("scheme", [*SCHEMES[:3], fb.EnergyDecaying(0.1), *SCHEMES[4:]])
def test_forces_and_accelerations_at_the_start_are_those_of_the_rates(scheme):
    """A stiff bar that is stretched: its viscous force is that of a load on its end."""
    EA, tau, rate = 2e8, 1e-3, 0.5
    motions = []
    for damping, load in ((tau, 0.0), (0.0, -EA * tau * rate)):
        section = fb.Section(EA=EA, GA=1e8, EI=2e4, rhoA=1.0, rhoI=1e-4, retardation=damping)
        scene, bar = clamped_bar((0.8, 0.6), section, elements=4)
        scene.set_velocity(bar, lambda x, y: (rate * x, rate * y))
        scene.add_force(bar.end, (0.8 * load, 0.6 * load))
        motions.append((fb.simulate(scene, scheme, dt=1e-4, t_end=1e-4, progress=False), bar))
    (motion, bar), (expected, _) = motions
    assert motion.resultants(bar).N[0] == pytest.approx(EA * tau * rate, rel=1e-6)
    a = expected.a[0]
    assert motion.a[0] == pytest.approx(a, rel=0, abs=1e-6 * abs(a).max())


@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.HHT(), fb.EnergyDecaying()], ids=lambda s: s.name
)
def test_a_quadratic_energy_with_forces_at_rest_is_damped_about_its_own_rest(scheme):
    """W = EA (eps + eps0)^2 / 2 + ..., as of a bar that is too long: it rests at eps = -eps0."""
    eps0, EA = 1e-3, 1e4
    energy = lambda e, g, k: EA / 2 * (e + eps0) ** 2 + EA / 2 * g**2 + 10 * k**2  # noqa: E731
    damping = 0.0 if scheme.name == "EnergyDecaying" else 0.01
    section = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=1e-2, retardation=damping)
    scene, bar = one_bar((1, 0), section, elements=2)
    scene.fix(bar.start, "x", "y", "rotation")
    scene.add_drag(bar.end, linear=50.0)
    solution = fb.simulate(scene, scheme, dt=2e-3, t_end=1.0)
    assert solution.resultants(bar).N[0] == pytest.approx(EA * eps0, rel=1e-6)
    assert solution.displacement(bar.end)[-1, 0] == pytest.approx(-eps0, rel=1e-3)


@pytest.mark.parametrize("inertia", [1.0, 0.0])
def test_a_damped_strip_that_is_struck_moves_alike_in_all_schemes_but_newmarks_family(inertia):
    """The page on limits says what HHT does here in its place."""

    def height(scheme, dt=1e-3):
        steel = fb.Section.rectangle(2e-3, 20e-3, *fb.materials.steel)
        section = replace(steel, rhoI=inertia * steel.rhoI, retardation=1e-3)
        scene, strip = clamped_bar((0.5, 0), section, elements=10)
        scene.set_velocity(strip, lambda x, y: (0.0, 8 * x**3), lambda x, y: 24 * x**2)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=0.05)
        return solution.displacement(strip.end)[:, 1]

    exact = height(fb.EnergyMomentum(order=4), 1e-4)[::10]
    for scheme in (fb.EnergyMomentum(), fb.MidPoint(), fb.EnergyDecaying()):
        assert height(scheme) == pytest.approx(exact, abs=1e-3 * abs(exact).max())
    assert abs(height(fb.HHT()) - exact).max() > 0.1 * abs(exact).max()
