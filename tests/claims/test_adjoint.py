"""Exact derivatives of motions: against differences, and of what motions conserve."""

import ufl

import numpy as np
import pytest
from derivatives import Run, both, forward_and_backward
from jointed import KINDS, throw
from jointed import chain as bars
from test_internal_variables import ISOTROPIC, PLASTIC, ZENER

import fx_beam as fb
from fx_beam.compiled.adjoint import Adjoint
from fx_beam.errors import SceneError
from fx_beam.fem.step_start import StepStart
from fx_beam.mechanics.interval import Interval
from fx_beam.model.model import Model

DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}
SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.MidPoint(),
    fb.ModifiedMidPoint(),
    fb.EnergyDecaying(),
]


def swing(degree=1, x=1.0, elements=3, scene=None, **data):
    """A beam that swings about a pin, with loads at its end."""
    scene = scene or fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam(
        [(0, 0), (1, 0.3 * x)], fb.Section(**DATA | data), elements, degree=degree
    )
    scene.pin(beam.start)
    scene.add_force(beam.end, lambda t: (3 * np.sin(3 * t), 1 + t))
    scene.set_velocity(beam, lambda x, y: (-2 * y, 2 * x), spin=2.0)
    return scene, beam


def of_sections(x, degree=2):
    """All data of sections, and the shape."""
    times = 1e-3 * x, 2e-3, 1e-3
    data = {"EA": 1e4 * x, "GA": 1e4 / x, "rhoA": x, "rhoI": 0.1 * x, "retardation": times}
    return swing(degree, x, EI=lambda f: 100 * (1 + 0.5 * x * f), **data)[0]


def curved(x):
    scene = fb.Scene()
    arc = fb.arc((0, 0), (1, 0.3 * x), (2, 0))
    beam = scene.add_beam(arc, fb.Section(**DATA), elements=3, degree=2)
    scene.clamp(beam.start)
    scene.set_velocity(beam.end, (0.0, 3.0 * x))
    return scene


def loaded(x):
    """Lumped mass, line load, follower force, drag of beam and node, forces between points."""
    scene, beam = swing(degree=2)
    scene.add_mass(beam.end, 2 * x, 0.3 * x)
    scene.add_line_load(beam, lambda t: (0, x * (1 + t)))
    scene.add_force(beam.end, lambda t: (x, 20 * x * t), follower=True)
    scene.add_drag(beam, linear=0.3 * x, quadratic=0.2 * x, rotation=0.1 * x)
    scene.add_drag(beam.end, linear=0.3 * x, quadratic=0.2 * x, rotation=0.1 * x)
    pull = {"spring": fb.Spring(30 * x, rest=0.3), "damper": fb.Damper(0.1 * x)}
    scene.add_force_between(beam.end, (2, 0.5), force=lambda r, rate, t: 2 * ufl.sin(t) / r, **pull)
    return scene


def worked(x):
    scene, beam = swing()
    scene.add_virtual_work(lambda step: -100 * ufl.dot(step.u, step.virtual_u))
    scene.add_mass(beam.end, 0.5 * x)
    return scene


def driven(x):
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(**DATA), elements=3)
    scene.pin(beam.start)
    scene.prescribe(beam.end, y=lambda t: 3 * x * t**2)
    return scene


def jointed(kind, x=1.0, **options):
    make, offset, given = KINDS[kind]
    scene, given = fb.Scene(gravity=(0, -9.81)), dict(given)
    first = scene.add_beam([(-1, 0), (0, 0)], fb.Section(**DATA), elements=2)
    shift = np.zeros(2)
    if "offset" in given:
        shift = np.array([0.2 * (x - 1), 0])
        given["offset"] = tuple(np.array(given["offset"]) + shift)
    if "axis" in given:
        shift = shift + (x - 1) * np.array(given["axis"])
    start = np.array(offset) + shift
    section = fb.Section(**DATA | {"EI": 100 * x})
    second = scene.add_beam([start, start + (0.8, -0.6)], section, elements=2)
    joint = scene.add_joint(make(first.end, second.start, **given | options))
    throw(scene, first, second, joint)
    return scene


def stop(x):
    return fb.Stop(lower=-1.0, upper=0.51 * x, stiffness=1e4 * x, restitution=0.5, speed=0.1)


SLIDE, HINGE = "prismatic with offset", "revolute with offset"
PARTS = {
    "slide with spring": (SLIDE, lambda x: {"spring": fb.Spring(50 * x, rest=0.1 * x)}),
    "slide with friction": (SLIDE, lambda x: {"friction": fb.Friction(2 * x, 0.001 * x)}),
    "slide with stop": (SLIDE, lambda x: {"stop": stop(x)}),
    "hinge with damper": (HINGE, lambda x: {"damper": fb.Damper(0.5 * x)}),
    "hinge with laws": (
        HINGE,
        lambda x: {
            "damper": fb.Damper(law=lambda rate: 0.7 * abs(rate) * rate),
            "spring": fb.Spring(strain_energy=lambda y: 3 * y**4, rest=0.1 * x),
        },
    ),
    "hinge with motor": (HINGE, lambda x: {"motor": lambda t: x * (40 * t - 3) * t}),
}


def bodies(x, links=2):
    """A chain of bodies; a long one has ties."""
    scene, last, L = fb.Scene(gravity=(0, -10)), None, 0.1 * x
    for k in range(links):
        ends = {"a": (k * L, 0.01 * (k % 2)), "b": ((k + 1) * L, 0.01 * ((k + 1) % 2))}
        link = scene.add_body(((k + 0.5) * L, 0.01 * k), 2.0 * x, 1e-3 * x, points=ends)
        if last is None:
            scene.pin(link["a"])
        else:
            scene.add_joint(fb.Revolute(last, link["a"], friction=fb.Friction(0.1 * x, 0.1)))
        last = link["b"]
    return scene


def four_bar(x):
    scene = fb.Scene(gravity=(0, -9.81))
    links = bars(scene, [(0, 0), (0.3, 0.9 * x), (2.0, 1.3), (1.8, 0.0)])
    spring = fb.Spring(5 * x)
    scene.add_joint(fb.Revolute(fb.GROUND, links[0]["a"], spring=spring, damper=fb.Damper(0.2)))
    scene.add_joint(fb.Revolute(links[2]["b"], fb.GROUND))
    return scene


def quick_return(x):
    """The joint that closes the loop has a guide that turns."""
    scene = fb.Scene(gravity=(0, -9.81))
    crank = scene.add_body((0.1, 0.5), x, 0.01, points={"O": (0, 0.5), "P": (0.2 * x, 0.5)})
    arm = scene.add_body((0.1, 0.3), 1.0, 0.2, points={"O": (0, -0.2)})
    for body in (crank, arm):
        scene.add_joint(fb.Revolute(fb.GROUND, body["O"]))
    slot = {"axis": (0.2 * x, 0.7), "damper": fb.Damper(0.1 * x)}
    scene.add_joint(fb.PinInSlot(arm["O"], crank["P"], **slot))
    scene.add_moment(crank.centre, 0.5 * x)
    return scene


def on_floor(x):
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0.01 * x), (1, 0.01)], fb.Section(**DATA), elements=2)
    scene.set_velocity(beam, (0.1, -1.0))
    loss = {"restitution": 0.5, "speed": 0.01}
    scene.add_obstacle(beam, fb.Line((0, 0), normal=(0.1, 1)), stiffness=1e4 * x, **loss)
    scene.add_obstacle(beam, fb.Circle((0.5 * x, -1.0), 1.0), stiffness=1e4 * x)
    return scene


def of_material(section, x):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    scene.clamp(beam.start)
    scene.add_force(beam.end, lambda t: (0, 5 * x * np.sin(6 * t)))
    return scene


def with_parameters(x):
    """In a stored energy, a virtual work and a force at points; one varies in time."""
    k = fb.Parameter("stiffness", 1e4 * x)
    c = fb.Parameter("viscosity", lambda t: 0.5 * x * (1 + t))
    pull = fb.Parameter("pull", lambda t: 10 * x * t)

    def energy(eps, gamma, kappa):
        return k / 2 * (eps**2 + gamma**2 + kappa**2 / 200) + k * kappa**4

    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(strain_energy=energy, rhoA=1.0, rhoI=0.01)
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=3)
    scene.pin(arm.start)
    scene.add_virtual_work(lambda step: -c * ufl.dot(step.v, step.virtual_u))
    spring = fb.Spring(strain_energy=lambda r: pull * (r - 0.5) ** 2)
    scene.add_force_between(arm.end, (0.5, 1.0), spring=spring)
    return scene


def frame(x, cells):
    """Its tangent is stored in sparse rows, or as a band if it is small."""
    scene, nodes = fb.Scene(gravity=(0, -9.81)), {}
    section = fb.Section(**DATA | {"EI": 100 * x})
    for i in range(cells):
        for j in range(cells):
            for a, b in (((i, j), (i + 1, j)), ((i, j), (i, j + 1))):
                if max(b) < cells:
                    beam = scene.add_beam([nodes.get(a, a), nodes.get(b, b)], section, elements=2)
                    nodes[a], nodes[b] = beam.start, beam.end
    scene.clamp(nodes[0, 0])
    return scene


SCENES = {
    "sections and shape": of_sections,
    "curved": curved,
    "loads, drag and masses": loaded,
    "virtual work": worked,
    "driven": driven,
    **{kind: lambda x, kind=kind: jointed(kind, x) for kind in KINDS},
    **{
        name: lambda x, kind=kind, parts=parts: jointed(kind, **parts(x))
        for name, (kind, parts) in PARTS.items()
    },
    "bodies": bodies,
    "long chain of bodies": lambda x: bodies(x, 20),
    "loop": four_bar,
    "loop with a turning guide": quick_return,
    "contact": on_floor,
    "viscous material": lambda x: of_material(ZENER, x),
    "plastic material": lambda x: of_material(PLASTIC, x),
    "plastic material with length": lambda x: of_material(ISOTROPIC, x),
    "parameters": with_parameters,
    "small frame": lambda x: frame(x, 3),
    "frame": lambda x: frame(x, 10),
}


@pytest.mark.parametrize("name", SCENES)
def test_adjoint_is_the_derivative_of_the_motion(name):
    found, expected, size = both(SCENES[name])
    # Differences of the motion have the error of Newton's method over h.
    assert found == pytest.approx(expected, rel=0, abs=1e-6 * max(size, abs(expected)) + 1e-7)


@pytest.mark.parametrize("name", SCENES)
def test_forwards_and_backwards_agree(name):
    forward, backward = forward_and_backward(SCENES[name])
    assert forward == pytest.approx(backward, rel=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES[1:], ids=lambda scheme: scheme.name)
def test_so_they_do_for_other_schemes(scheme):
    forward, backward = forward_and_backward(of_sections, scheme)
    assert forward == pytest.approx(backward, rel=1e-9)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_so_it_is_for_all_schemes_and_degrees(scheme, degree):
    found, expected, size = both(lambda x: of_sections(x, degree), scheme)
    assert found == pytest.approx(expected, rel=0, abs=1e-6 * size)


def test_remainder_of_a_linear_prediction_is_of_order_two():
    def end(speed):
        run = Run(of_sections(1.0), fb.EnergyMomentum(), 0.01, 50, taped=True, disturb=speed)
        return run, run.rows["q"][-1].sum()

    run, value = end(None)
    slope = run.adjoint({"q": np.ones((1, run.model.size))}, np.array([50]))["v"]
    direction = np.random.default_rng(1).standard_normal(run.model.size)

    def remainder(h):
        def disturb(state):
            state.v[:] += h * direction

        return end(disturb)[1] - value - h * slope @ direction

    assert np.log2(remainder(0.02) / remainder(0.01)) == pytest.approx(2, abs=0.1)


def internal_force(model, q):
    """Forces (size,) that are the derivative of the energy stored in a configuration."""
    at_rest = Model(model.scene, fb.Equilibrium(), mobile=True)
    at_rest.forms.begin(Interval(0.0, 0.0), StepStart(q))
    return at_rest.forms.internal_force(np.zeros(model.size)).copy()


def conserved(scheme, steps=1000):
    """Derivative of the energy at the end by the rates at the start, and M v0."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(**DATA), elements=4)
    scene.set_velocity(beam, lambda x, y: (3 * np.sin(5 * y), 2 * x * x), spin=2.0)
    run = Run(scene, scheme, 0.01, steps, taped=True)
    model, last = run.model, np.array([steps])
    weights = {"q": internal_force(model, run.end.q)[None], "v": (model.mass @ run.end.v)[None]}
    return run, run.adjoint(weights, last)["v"], model.mass @ run.start.v


def test_energy_at_the_end_depends_on_rates_as_at_the_start():
    _, found, expected = conserved(fb.EnergyMomentum())
    assert found == pytest.approx(expected, rel=0, abs=1e-8 * abs(expected).max())


def test_it_does_not_with_the_mid_point_rule():
    _, found, expected = conserved(fb.MidPoint(), 200)
    assert abs(found - expected).max() > 1e-3 * abs(expected).max()


def test_momentum_at_the_end_depends_on_rates_as_at_the_start():
    run, _, _ = conserved(fb.EnergyMomentum())
    model = run.model
    for direction in ((1, 0, 0), (0, 1, 0)):
        push = model.mass @ model.from_nodes(np.tile(np.array(direction, float), (5, 1)))
        found = run.adjoint({"v": push[None]}, np.array([1000]))
        assert found["v"] == pytest.approx(push, rel=0, abs=1e-8 * abs(push).max())


def growth(t_end):
    """Growth of the derivatives of the end of a double pendulum that is released horizontally."""

    def build(x):
        scene, last = fb.Scene(gravity=(0, -9.81)), None
        for k in range(2):
            ends = {"a": (k, 0.0), "b": (k + 1, 0.0)}
            link = scene.add_body((k + 0.5, 0.0), x[0], 0.1, points=ends)
            scene.add_joint(fb.Revolute(last or fb.GROUND, link["a"]))
            last = link["b"]
        return scene, {"end": fb.Output("position", last)}

    run = fb.Response(build, dt=0.01, t_end=t_end)
    t, y = run([1.0])
    weights = np.zeros_like(y["end"])
    weights[-1] = 1.0
    run.vjp({"end": weights})
    return run.stats.gradient_growth


def test_growth_of_derivatives_shows_a_chaotic_motion(caplog):
    assert growth(1.0) < 100
    assert "chaotic" not in caplog.text
    assert growth(30.0) > 1e6
    assert "the motion is chaotic" in caplog.text


def test_what_has_no_derivative_is_refused_by_its_name():
    run = Run(of_sections(1.0), fb.Newmark(), 0.01, 2)
    with pytest.raises(SceneError, match=r"Newmark.* no derivatives.* Use EnergyMomentum"):
        Adjoint(run.loop.problem)
