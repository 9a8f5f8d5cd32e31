"""Derivatives of steady vibrations: closed forms, remainders and peaks."""

import gc
import pickle
import weakref

import ufl

import numpy as np
import pytest
from derivatives import assert_left_of_second_order
from scenes import assert_refused, guided_body, one_bar
from test_modal_response import NUMBERS, beaded, damped, loaded, rotor, turning
from test_static_response import DATA, X, bending, chain, driven, motors, slide

import fx_beam as fb

F = [0.0, 0.7, 3.0, 11.0]


def shaken(build):
    """A scene under a load with phases at the end of a beam, which depends on the numbers."""

    def built(x):
        scene = build(x)
        node = scene.beams[-1].end
        return scene, (node, (x[0], 0.3 * x[1] + 0.2, 0.1j * x[2])), node

    return built


def oscillator(x):
    """Mass, stiffness and damping, and the load."""
    scene, (m, k, c, load) = fb.Scene(), x
    body = scene.add_body((0, 0), mass=m, inertia=1.0)
    laws = {"spring": fb.Spring(k), "damper": fb.Damper(c)}
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), **laws))
    return scene, (body.centre, (load, 0.0)), joint


def test_many_frequencies_at_once_have_the_derivatives_of_each():
    # Motions at near frequencies are followed as sums of a few; those far above the first natural
    # frequencies are 1e4 times smaller, and count as much in a sum of logarithms.
    run = fb.HarmonicResponse(shaken(damped), np.geomspace(0.1, 300.0, 40))
    values = run(np.array([1.0, 1.1, 0.9, 0.5]))
    known = np.einsum("kcm,kc->m", run.jacobian(), 1 / values).real
    assert abs(values).max() > 1e4 * abs(values).min()
    assert run.vjp(1 / values) == pytest.approx(known, rel=1e-9, abs=1e-9 * abs(known).max())


def relaxing(part, x):
    """Of the strain that gives moments, or of a spring's coordinate, a part relaxes."""

    def energy(*strains):
        *others, strain, a = strains
        stretched = sum(1e4 * other**2 for other in others)
        return stretched + part * (x[0] * strain**2 + x[1] * (strain - a[0]) ** 2)

    def relax(old, strains0, strains, dt):
        return [(old[0] + 2 * dt * strains[-1]) / (1 + 2 * dt)]

    return {"strain_energy": energy, "internal": fb.InternalVariables(("dashpot",), relax)}


def relaxed(x):
    """An arm of such a material on such a spring, under its weight."""
    k = fb.Parameter("k", x[0]), fb.Parameter("k1", x[1])
    arm = fb.Section(**relaxing(1.0, k), rhoA=1.0, retardation=1e-3 * x[1])
    scene, beam = one_bar((x[2], 0), arm, elements=3, gravity=(0, -x[3]))
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, spring=fb.Spring(**relaxing(10.0, k))))
    return scene


def test_a_spring_whose_internal_variable_is_held_has_its_stiffness_at_once():
    def build(x):
        k = fb.Parameter("k", x[0]), fb.Parameter("k1", x[1])
        scene, body, joint = guided_body((0, 0), x[2], 1.0, spring=fb.Spring(**relaxing(1.0, k)))
        return scene, (body, (1.0, 0.0)), joint

    f = np.array([0.0, 0.7, 2.0])
    run, (k, k1, m), w2 = fb.HarmonicResponse(build, f), (3.0, 2.0, 1.5), (2 * np.pi * f) ** 2
    D = 2 * k + 2 * k1 - w2 * m
    assert run([k, k1, m])[:, 0] == pytest.approx(1 / D, rel=1e-12)
    exact = np.array([-2 * np.ones(3), -2 * np.ones(3), w2]) / D**2
    assert run.jacobian()[:, 0] == pytest.approx(exact.T, rel=1e-7)
    assert run.stats.difference_reason == ""


def test_an_oscillator_has_the_derivatives_of_its_closed_form():
    x, f = np.array([1.2, 30.0, 0.5, 2.0]), np.array([0.0, 0.5, 0.8, 2.0])
    run = fb.HarmonicResponse(oscillator, f)
    w, (m, k, c, load) = 2 * np.pi * f, x
    D = k + 1j * w * c - w**2 * m
    assert run(x)[:, 0] == pytest.approx(load / D, rel=1e-12)
    exact = load / D**2 * np.array([w**2, -np.ones(4), -1j * w, D / load])
    assert run.jacobian()[:, 0] == pytest.approx(exact.T, rel=1e-7, abs=1e-12)
    run = pickle.loads(pickle.dumps(run))
    assert run(x) == pytest.approx(load / D[:, None], rel=1e-12)


@pytest.mark.parametrize(
    ("build", "options"),
    [
        *(
            (build, {"state": loaded})
            for build in (bending, chain, driven, motors, slide, damped, relaxed)
        ),
        *((build, {}) for build in (slide, damped, relaxed)),
    ],
)
def test_what_is_left_of_the_linear_change_is_of_second_order(build, options, monkeypatch):
    monkeypatch.setitem(DATA, "retardation", 2e-3)
    run = fb.HarmonicResponse(shaken(build), F, **options)
    assert_left_of_second_order(run, np.append(X, 1.0), 1e-5)


@pytest.mark.parametrize("build", [damped, relaxed])
def test_a_call_after_derivatives_gives_the_same_values_and_derivatives(build, monkeypatch):
    """By the scene with slopes, which then serves both."""
    monkeypatch.setitem(DATA, "retardation", 2e-3)

    def built(x):
        scene = build(x)
        return scene, (scene.beams[-1].end, (x[0], 0.3 * x[1])), scene.beams[-1].end

    run, x = fb.HarmonicResponse(built, F), np.append(X, 1.0)
    values, J = run(x), run.jacobian()
    assert run.stats.difference_reason == ""
    assert run(x) == pytest.approx(values, rel=1e-9)
    assert run.jacobian() == pytest.approx(J, rel=0, abs=1e-8 * abs(J).max())


@pytest.mark.parametrize("build, state", [(beaded, loaded), (beaded, turning), (rotor, turning)])
def test_turns_and_slides_have_derivatives(build, state):
    """Beside differences of order six along a change of all numbers; and backwards."""
    x, h, direction = NUMBERS, 5e-4, np.array([0.7, -0.9, 1.1])
    run = fb.HarmonicResponse(shaken(build), F, state=state)
    values, J = run(x), run.jacobian()
    weights = np.random.default_rng(0).standard_normal((*values.shape, 2)) @ (1, 1j)
    assert run.vjp(weights) == pytest.approx(np.tensordot(weights, J, 2).real, rel=1e-7)
    moved = [run(x + k * h * direction) for k in (-3, -2, -1, 1, 2, 3)]
    expected = np.tensordot(np.array([-1, 9, -45, 45, -9, 1]) / (60 * h), moved, 1)
    assert J @ direction == pytest.approx(expected, rel=0, abs=1e-7 * abs(J).max())


def _bent(kind, x):
    """Two arms under their weight with damping that is no line over the rate."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.01)
    a, b = (scene.add_beam([(k, 0), (k + 1, 0)], section, elements=2) for k in (0, 1))
    scene.clamp(a.start)
    parts = {
        "friction": {"friction": fb.SmoothFriction(0.5 * x[0], 0.05 * x[1])},
        "law": {"damper": fb.Damper(law=lambda rate: 0.3 * rate + ufl.atan(30 * rate))},
        "stop": {"stop": fb.Stop(-0.05 * x[0], 0.3, 200 * x[1], 0.5, speed=0.02)},
    }
    scene.add_joint(fb.Revolute(a.end, b.start, spring=fb.Spring(20.0), **parts.get(kind, {})))
    if kind == "drag":
        scene.add_drag(b.end, linear=0.1 * x[0], quadratic=3 * x[1])
        scene.add_drag(b, linear=(0.1 * x[0], 0.3), quadratic=(3 * x[1], 2 * x[0]))
    if kind == "contact":
        loss = {"restitution": 0.4, "speed": 0.01 * x[1]}
        scene.add_contact(b.end, fb.Line((0, -0.3), (0, 1)), stiffness=1e3 * x[0], **loss)
    if kind == "force":  # a load: without a state its stiffness does not count
        c, k = (fb.Parameter(name, value) for name, value in zip("ck", x, strict=True))
        scene.add_force_between(
            b.end, (3, 1), force=lambda d, rate, t: k * ufl.cos(3 * t) * d + c * ufl.cos(t) * rate
        )
    scene.add_mass(b.end, 0.1 * x[1])
    return scene, (b.end, (0.0, 1.0)), b.end


@pytest.mark.parametrize("kind", ["friction", "law", "stop", "drag", "contact", "force"])
@pytest.mark.parametrize("state", [None, lambda scene: fb.static(scene, load_steps=3, t=0.7)])
def test_damping_that_depends_on_the_rate_counts_as_it_is_at_rest(kind, state):
    def run_at(x):
        run = fb.HarmonicResponse(lambda x: _bent(kind, x), F, state=state)
        return run, run(x)

    x, h = np.array([1.1, 0.9]), 3e-4
    run, values = run_at(x)
    weights = np.random.default_rng(0).standard_normal(values.shape)
    ends = [[run_at(x + k * h * row)[1] for k in (-2, -1, 1, 2)] for row in np.eye(2)]
    sums = np.einsum("mknc,nc->mk", np.array(ends).real, weights)
    expected = sums @ [1, -8, 8, -1] / (12 * h)
    size = abs(expected).max()
    assert run.vjp(weights) == pytest.approx(expected, abs=1e-6 * size)
    J = run.jacobian().real
    assert np.einsum("ncm,nc->m", J, weights) == pytest.approx(expected, abs=1e-6 * size)


def test_scenes_of_earlier_calls_are_forgotten():
    scenes = weakref.WeakSet()

    def built(x):
        scene, *rest = oscillator(x)
        scenes.add(scene)
        return scene, *rest

    run, x = fb.HarmonicResponse(built, [0.5]), np.array([1.2, 30.0, 0.5, 2.0])
    for k in range(20):
        run(x * (1 + 1e-3 * k)), run.jacobian()
    gc.collect()
    assert len(scenes) < 10


@pytest.mark.parametrize("ratio", [1e-1, 1e-2, 1e-3])
def test_heights_of_sharp_peaks_have_the_derivatives_of_the_closed_form(ratio):
    """Largest amplitude F / (2 z sqrt(1 - z^2) k) with z = c / (2 sqrt(k m))."""
    x = np.array([1.0, 4.0, 4 * ratio, 0.5])
    place = 2 * np.sqrt(1 - 2 * ratio**2) / (2 * np.pi)
    run = fb.HarmonicResponse(oscillator, place * (1 + ratio * np.linspace(-3, 3, 8)))
    run(x)
    (peak,) = run.peaks("slide")
    assert peak.frequency == pytest.approx(place, rel=1e-12)

    def height(x):
        m, k, c, load = x
        z = c / (2 * np.sqrt(k * m))
        return load / (2 * z * np.sqrt(1 - z**2) * k)

    assert peak.amplitude == pytest.approx(height(x), rel=1e-10)
    ends = [(height(x + h) - height(x - h)) / (2 * h.sum()) for h in np.diag(1e-4 * x)]
    assert peak.gradient == pytest.approx(ends, rel=1e-6)


# -- Shaken bases ---------------------------------------------------------------------------------


def test_an_oscillator_on_a_base_has_the_derivatives_of_its_closed_form():
    def build(x):
        scene, (node, _), _ = oscillator([*x, 1.0])
        return scene, None, node

    x, f, b = np.array([1.2, 30.0, 0.5]), np.array([0.0, 0.5, 0.8, 2.0]), 0.7 - 0.2j
    run, w, (m, k, c) = fb.HarmonicResponse(build, f, base=(b, 0.0)), 2 * np.pi * f, x
    held, D = k + 1j * w * c, k + 1j * w * c - w**2 * m
    assert run(x)[:, 0] == pytest.approx(b * held / D, rel=1e-12)
    exact = b / D**2 * np.array([held * w**2, D - held, 1j * w * (D - held)])
    assert run.jacobian()[:, 0] == pytest.approx(exact.T, rel=1e-7, abs=1e-12)
    weights = np.array([[1, 0.3j, 0], [0.5, 0, 0], [1j, 0, 0], [-1, 0, 0]])
    assert run.vjp(weights) == pytest.approx((weights[:, 0] @ exact.T).real, rel=1e-7)
    run = fb.HarmonicResponse(build, np.linspace(0.5, 1.2, 8), base=(b, 0.0))
    run(x)
    (peak,) = run.peaks("x")
    # Of the ratio (1 + (2 z r)^2) / ((1 - r^2)^2 + (2 z r)^2) in r^2: largest at this one.
    z = c / (2 * np.sqrt(k * m))
    r2 = (np.sqrt(1 + 8 * z**2) - 1) / (4 * z**2)
    assert 2 * np.pi * peak.frequency == pytest.approx(np.sqrt(r2 * k / m), rel=1e-6)
    w = 2 * np.pi * peak.frequency
    assert peak.amplitude == pytest.approx(abs(b * (k + 1j * w * c) / (k + 1j * w * c - w**2 * m)))
    for base, load in (((1, 0), (1, 2)), (None, None)):
        refused = fb.HarmonicResponse(lambda x, load=load: (build(x)[0], load, 0), f, base=base)
        assert_refused("what build gives", refused, x)


@pytest.mark.parametrize("build", [bending, chain, slide, damped])
def test_on_a_base_what_is_left_of_the_linear_change_is_of_second_order(build, monkeypatch):
    monkeypatch.setitem(DATA, "retardation", 2e-3)

    def built(x):
        scene = build(x)
        return scene, None, scene.beams[-1].end

    run = fb.HarmonicResponse(built, F, state=loaded, base=(0.4, 1.0 + 0.5j))
    assert_left_of_second_order(run, np.append(X, 1.0), 1e-5)
