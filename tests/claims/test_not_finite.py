"""Infinite forces and stiffnesses, which laws have beyond what they hold, are no convergence."""

import math

import ufl

import numpy as np
import pytest

import fx_beam as fb

EA = 1e3


def hencky(mass, elements=4):
    """A bar with N = EA ln(1 + e), pressed by 2 EA; it ends at e = -1."""
    scene = fb.Scene()

    def energy(e, g, k):
        return EA * ((1 + e) * ufl.ln(1 + e) - e) + EA * g**2 + 50 * k**2

    section = fb.Section(strain_energy=energy, rhoA=mass)
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
    scene.clamp(bar.start)
    for node in bar.nodes[1:]:
        scene.fix(node, "y", "rotation")
    scene.add_force(bar.end, (-2 * EA, 0.0))
    return scene, bar


def shaft():
    """A shaft in soil 100 tanh(u/Y) at each of five nodes is pushed by 600 N."""
    scene, Y = fb.Scene(), 0.0075
    bar = scene.add_beam([(0, 0), (0, 2)], fb.Section(EA=1e6, GA=1e6, EI=50.0), elements=4)
    scene.fix(bar.start, "y")
    for node in bar.nodes:
        soil = fb.Spring(strain_energy=lambda u: 100 * Y * ufl.ln(ufl.cosh(u / Y)))
        scene.add_spring(node, x=soil)
    scene.add_force(bar.node(0.5), (600.0, 0.0))
    return scene, bar


@pytest.mark.parametrize("way", [None, "arc-length"])
@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("mass", [0.0, 1.0])
def test_a_stiffness_that_becomes_infinite_does_not_end_newtons_method(mass, steps, way):
    scene, bar = hencky(mass)
    path = fb.static(scene, load_steps=steps, continuation=way)
    assert path.displacement(bar.end)[-1, 0] == pytest.approx(math.exp(-2) - 1, rel=1e-8)
    assert path.reaction(bar.start)[-1, 0] == pytest.approx(2 * EA, rel=1e-8)


def test_soil_that_holds_less_than_the_load_is_an_error_with_the_states_before():
    scene, bar = shaft()
    with pytest.raises(fb.StepError, match="singular or a value is not finite") as error:
        fb.static(scene)
    path = error.value.solution
    assert 0.8 <= path.load_factor[-1] < 5 / 6
    assert np.isfinite(path.q).all() and path.stable.all()
    held = 100 * np.tanh(np.array([path.displacement(node)[-1, 0] for node in bar.nodes]) / 0.0075)
    assert held.sum() == pytest.approx(600 * path.load_factor[-1], rel=1e-6)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(), fb.MidPoint()])
def test_motions_never_go_on_from_what_is_not_finite(scheme):
    """The bar is so light that a step is nearly an equilibrium."""
    scene, bar = hencky(1e-6, elements=1)
    try:
        motion = fb.simulate(scene, dt=1.0, t_end=3.0, scheme=scheme)
    except fb.StepError as error:
        motion = error.solution
    assert np.isfinite(motion.q).all() and np.isfinite(motion.energy.total).all()
    assert motion.displacement(bar.end)[:, 0].min() > -1
