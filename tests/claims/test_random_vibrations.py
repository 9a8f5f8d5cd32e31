"""Small motions of random scenes: linear systems against modes, gradients against differences."""

import ufl

import numpy as np
import pytest
from derivatives import difference
from scenes import clamped_bar
from test_harmonic_response import relaxing
from test_linearise import DATA, roots_of_modes

import fx_beam as fb

X = np.array([1.1, 0.9, 1.05])
F = [0.7, 3.0, 11.0]


def section_of(x, rng):
    match rng.integers(5):
        case 0:
            return fb.Section(rhoI=0.01, retardation=0.01 * x[1], **DATA)
        case 1:
            return fb.Section(**DATA)  # turns have no mass
        case 2:
            return fb.Section(**DATA | {"EI": lambda f: 100 * (x[0] + f * x[2])}, rhoI=0.01)
        case 3:
            parts = fb.Parameter("k", x[1]), fb.Parameter("k1", x[2])
            return fb.Section(rhoA=x[0], rhoI=0.01, **relaxing(25.0, parts))
    return fb.Section(rhoI=0.01 * x[2], **DATA)


def scene_of(x, seed):
    """A mast on a rail, with forces of several kinds on both."""
    rng = np.random.default_rng(seed)
    joint = rng.choice(["hinge", "slot", "slider", "sleeve"])
    place, degree, elements = 1.0 if joint in ("hinge", "slot") else 0.61, *rng.integers(1, [4, 3])
    # Two degrees only: most of these tests is the compilation of their forms.
    size = {"degree": 1 + int(degree) % 2, "elements": int(2 + 2 * elements)}
    scene, rail = clamped_bar((1, 0), section_of(x, rng), **size, gravity=(0, -9.81 * x[2]))
    mast = scene.add_beam([(place, 0), (place + 0.2, 1)], section_of(x, rng), **size)
    laws = {"spring": fb.Spring(100.0 * x[0], rest=place if place < 1 else 0.1 * x[1])}
    if rng.random() < 0.5:
        laws["damper"] = fb.Damper(0.3 * x[2])
    if joint == "hinge":
        scene.add_joint(fb.Revolute(rail.end, mast.start, **laws))
    elif joint == "slot":
        hinge = fb.Coordinate(spring=fb.Spring(20.0), friction=fb.SmoothFriction(0.5, 0.2 * x[1]))
        scene.add_joint(fb.PinInSlot(rail.end, mast.start, axis=(1, 0.3), hinge=hinge, **laws))
    else:
        scene.add_joint((fb.Slider if joint == "slider" else fb.Sleeve)(rail, mast.start, **laws))
        for side in (-1, 1):
            scene.add_force_between(mast.end, (place + side, 2.0), spring=fb.Spring(50.0))
    p, q = (fb.Parameter(f"force {k}", x[k]) for k in range(2))

    def pull(distance, rate, t):
        return p * ufl.sin(3 * t) * distance + 0.3 * q * ufl.cos(t) * rate

    for kind in rng.choice(5, 2, replace=False):
        beam = (rail, mast)[rng.integers(2)]
        match kind:
            case 0:
                scene.add_force_between(mast.end, (3.0, 1.0), force=pull)
            case 1:
                scene.add_natural_strain(beam, curvature=lambda f, t: 0.3 * x[0] * f * t)
            case 2:
                scene.add_drag(beam, linear=0.5 * x[1], quadratic=x[2])
            case 3:
                load = lambda s, t: (x[0] * t, x[1] * s)  # noqa: E731
                scene.add_line_load(beam, load, of="arc length and time")
            case 4:
                loss = {"restitution": 0.5, "speed": 0.3}
                scene.add_contact(mast.end, fb.Line((0, 0.9), (0, 1)), stiffness=500 * x[1], **loss)
    return scene, mast.end


def state_of(scene):
    return fb.static(scene, load_steps=4, t=0.7)


@pytest.mark.parametrize("seed", range(12))
def test_a_system_at_rest_has_the_vibrations_of_modes(seed):
    scene, _ = scene_of(X, seed)
    roots_of_modes(scene, state_of(scene), 1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_responses_have_the_derivatives_of_differences(seed):
    """In one direction; about a state, and with an odd seed about the reference."""

    def build(x):
        scene, node = scene_of(x, seed)
        return scene, (node, (0.3, 1.0 + x[1])), node

    run, h = fb.HarmonicResponse(build, F, state=None if seed % 2 else state_of), 3e-4
    rng = np.random.default_rng(0)
    weights = rng.standard_normal(run(X).shape)
    slopes = np.einsum("ncm,nc->m", run.jacobian().real, weights)
    assert run.vjp(weights) == pytest.approx(slopes, rel=0, abs=1e-5 * abs(slopes).max())
    direction = rng.uniform(0.5, 1.5, 3)
    expected = difference(lambda step: (run(X + step * direction).real * weights).sum(), h)
    assert slopes @ direction == pytest.approx(expected, rel=0, abs=1e-5 * abs(slopes).max())
