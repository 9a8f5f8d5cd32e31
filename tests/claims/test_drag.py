"""Drag on beams and nodes: closed solutions, balance, bad input."""

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, one_bar

import fx_beam as fb

SCHEMES = [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.HHT(-0.2)]
SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.5, rhoI=0.1)


def bar_at(velocity, on, angle=0.0, gravity=None, **drag):
    """A straight bar of 3 kg that moves without turning, with drag on it or halved on its ends."""
    end = 2 * np.array([np.cos(angle), np.sin(angle)])
    scene, bar = one_bar([(0, 0), end], SECTION, elements=1, gravity=gravity)
    scene.set_velocity(bar, velocity)
    if on == "beam":
        scene.add_drag(bar, **{name: np.divide(value, 2).tolist() for name, value in drag.items()})
    else:
        for node in (bar.start, bar.end):
            scene.add_drag(node, **{name: value / 2 for name, value in drag.items()})
    return scene, bar


# -- Closed solutions -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("on", "scheme"),
    [*(("nodes", scheme) for scheme in SCHEMES), *(("beam", scheme) for scheme in SCHEMES[:2])],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_a_falling_bar_reaches_its_terminal_velocity(on, scheme):
    # m v' = m g - c v^2: v = V tanh(g t / V) with V^2 = m g / c.
    g, c, m = 10.0, 0.8, 3.0
    V, errors = np.sqrt(m * g / c), []
    for dt in (0.1, 0.05):
        scene, bar = bar_at((0, 0), on, gravity=(0, -g), quadratic=c)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=2.0)
        exact = -(V**2) / g * np.log(np.cosh(g * solution.t / V))
        errors.append(abs(solution.displacement(bar.end)[:, 1] - exact).max())
    assert np.log2(errors[0] / errors[1]) > (3.5 if "order=4" in scheme.name else 1.8)
    assert errors[1] < 3e-3
    assert -solution.velocity(bar.end)[-1, 1] == pytest.approx(V, rel=1e-2)


def test_a_bar_glides_along_itself(angle=0.7):
    # In each direction v' = -a v - b v^2: v = v0 f / (1 + b v0 (1 - f) / a) with f = exp(-a t).
    along, across = np.array([(np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))])
    drag = {"linear": (0.3, 1.5), "quadratic": (0.6, 2.1), "rotation": 0.1}
    scene, bar = bar_at(2.0 * along + 1.0 * across, "beam", angle, **drag)
    solution = fb.simulate(scene, dt=0.01, t_end=2.0)
    for direction, v0, a, b in ((along, 2.0, 0.1, 0.2), (across, 1.0, 0.5, 0.7)):
        f = np.exp(-a * solution.t)
        exact = v0 * f / (1 + b * v0 * (1 - f) / a)
        assert abs(solution.velocity(bar.end) @ direction - exact).max() < 1e-4 * v0


@pytest.mark.parametrize(("on", "resistance"), [("beam", 1.6), ("nodes", 2.4)])
def test_a_rotation_is_stopped_by_drag_on_the_spin_and_on_the_speed(on, resistance):
    # J = rhoA L^3 / 12 + rhoI L = 1.2 kg m^2; c L^3 / 12 + c L, or twice c L^2 / 4 + c.
    scene = fb.Scene()
    bar = scene.add_beam(
        [(-1, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e6, rhoA=1.5, rhoI=0.1), elements=1
    )
    for part in (bar,) if on == "beam" else (bar.start, bar.end):
        scene.add_drag(part, linear=0.6, rotation=0.6)
    scene.set_velocity(bar, lambda x, y: (-y, x), spin=1.0)
    solution = fb.simulate(scene, dt=0.01, t_end=3.0)
    rate = resistance / 1.2
    exact = (1 - np.exp(-rate * solution.t)) / rate
    assert abs(solution.rotation(bar.end) - exact).max() < 1e-4
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert np.diff(solution.energy.dissipated).min() > 0


# -- Balance --------------------------------------------------------------------------------------


def tumbling():
    """A bent bar that flies, turns and vibrates in a fluid, with more drag at its end."""
    scene, bar = one_bar([(0, 0), (1, 0), (1.5, 1)], SECTION, elements=[2, 2], gravity=(0.0, -9.81))
    scene.add_drag(bar, linear=(0.1, 0.5), quadratic=(0.05, 0.7), rotation=0.1)
    scene.add_drag(bar.end, linear=0.3, quadratic=0.2, rotation=0.1)
    scene.set_velocity(bar, lambda x, y: (1 - 2.0 * y, 2.0 * x), spin=2.0)
    return scene


@pytest.mark.parametrize("scheme", [fb.EnergyDecaying(0.01), fb.HHT(-0.2)], ids=lambda s: s.name)
def test_every_scheme_loses_the_same_energy_in_every_step(scheme):
    lost = []
    for other_scheme in (scheme, fb.EnergyMomentum()):
        solution = fb.simulate(tumbling(), other_scheme, dt=0.005, t_end=0.5)
        taken = solution.energy.dissipated - solution.energy.numerical
        assert np.diff(taken).min() > 0
        lost.append(taken[-1])
    assert lost[0] == pytest.approx(lost[1], rel=1e-3)


def test_a_step_is_halved_where_drag_would_give_energy_in_a_sub_step_that_goes_back():
    scene, _ = bar_at((2.0, 0.0), "nodes", linear=3.0 * 3.03 / 0.12)
    solution = fb.simulate(scene, fb.EnergyMomentum(order=4), dt=0.12, t_end=0.36)
    assert solution.stats.amplified > 0
    assert np.diff(solution.energy.dissipated).min() > 0


# -- Scenes ---------------------------------------------------------------------------------------


def test_a_massless_bar_may_sink_against_drag():
    scene, bar = one_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=1)
    scene.add_line_load(bar, (0.0, -3.0))
    assert_refused("without mass", fb.simulate, scene, dt=0.1, t_end=1.0)
    scene.add_drag(bar, linear=2.0, rotation=1.0)
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    assert solution.displacement(bar.end)[-1] == pytest.approx([0.0, -1.5], abs=1e-9)


def test_statics_knows_nothing_of_drag():
    tips = []
    for drag in (0.0, 10.0):
        scene, bar = clamped_bar((1, 0), SECTION, elements=1, gravity=(0, -9.81))
        if drag:
            scene.add_drag(bar, linear=drag)
            scene.add_drag(bar.end, linear=drag)
        solution = fb.static(scene, load_steps=1)
        assert not any("drag" in name for name in solution.stats.compiled)
        tips.append(solution.displacement(bar.end)[-1])
    assert (tips[0] == tips[1]).all()
