"""Derivatives of motions in which members touch: against differences, and of what they conserve."""

import numpy as np
import pytest
from derivatives import Run, both, forward_and_backward
from test_members import jointed

import fx_beam as fb

DATA = {"EA": 1e4, "GA": 4e3, "EI": 10.0, "rhoA": 1.0, "rhoI": 1e-3}


def crossing(x, friction=None, degree=1, **loss):
    """A free beam falls with its tip on another one and slides along it."""
    scene, section = fb.Scene(), fb.Section(**DATA | {"EI": 10.0 * x})
    below = scene.add_beam([(0, 0), (2, 0.02 * x)], section, elements=8 // degree, degree=degree)
    above = scene.add_beam(
        [(0.71, 0.118), (1.1 * x, 1.3)], section, elements=8 // degree, degree=degree
    )
    options = {"stiffness": 1e5 * x, "radius": 0.05 * x, "friction": friction}
    scene.add_contact(above, below, **options, **loss)
    scene.set_velocity(above, (0.3, -1.0 * x), spin=0.5)
    return scene


def with_friction(x, degree=1):
    return crossing(x, fb.Coulomb(0.5 * x, 5e4 * x), degree)


def with_loss(x):
    return crossing(x, restitution=0.5 * x, speed=0.1 * x)


def stacked(x):
    """Two cantilevers, of which one carries a moving mass on a pin, and rests upon the other."""
    scene, section = fb.Scene(gravity=(0, -9.81)), fb.Section(**DATA | {"EI": 10.0 * x})
    for y, elements in ((0.0, 7), (0.1002, 9)):
        beam = scene.add_beam([(0, y), (1.03, y)], section, elements=elements)
        scene.clamp(beam.start)
    body = scene.add_body((1.03, 0.3), x, 0.01, points={"foot": (1.03, 0.1002)})
    scene.add_joint(fb.Revolute(beam.end, body["foot"], damper=fb.Damper(0.1)))
    contact = {"stiffness": 1e5, "radius": 0.05, "friction": fb.Coulomb(0.3, 1e4)}
    scene.add_contact(scene.beams[1], scene.beams[0], **contact)
    return scene


SCENES = {"plain": crossing, "friction": with_friction, "joints": stacked}


@pytest.mark.parametrize("name", SCENES)
def test_the_adjoint_is_the_derivative_of_the_motion(name):
    found, low, size = both(SCENES[name], dt=2e-3, steps=30, h=4e-5)
    _, high, _ = both(SCENES[name], dt=2e-3, steps=30, h=8e-5)
    assert abs(found - (4 * low - high) / 3) < 2e-8 * size


@pytest.mark.parametrize("name", SCENES)
def test_forwards_and_backwards_agree(name):
    forward, backward = forward_and_backward(SCENES[name], dt=2e-3, steps=30)
    assert forward == pytest.approx(backward, rel=1e-10)


@pytest.mark.parametrize(
    ("build", "scheme"), [(with_loss, fb.MidPoint()), (lambda x: with_friction(x, 2), None)]
)
def test_so_they_do_with_losses_and_other_degrees(build, scheme):
    forward, backward = forward_and_backward(build, scheme, dt=2e-3, steps=30)
    assert forward == pytest.approx(backward, rel=1e-10)


@pytest.mark.parametrize("count", [4, 24])
def test_so_they_do_in_closed_loops_and_long_trees_of_joints(count):
    def build(x):
        return jointed(count, True, fb.Coulomb(0.4 * x, 5e4 * x))

    forward, backward = forward_and_backward(build, dt=2e-3, steps=30)
    assert forward == pytest.approx(backward, rel=1e-9)
    found, expected, size = both(build, dt=2e-3, steps=30, h=2e-4)
    assert abs(found - expected) < 1e-6 * size
    assert size > 1e-3


def test_the_momentum_at_the_end_depends_on_rates_as_at_the_start():
    """Through contact with friction, and on nothing else."""
    run = Run(with_friction(1.0), fb.EnergyMomentum(), 2e-3, 60, taped=True)
    along = np.zeros(run.model.size)
    along[run.model.mesh.dofs[:, 0]] = 1.0
    weights = {"q": np.zeros((1, run.model.size)), "v": np.array([run.model.mass @ along])}
    found = run.adjoint(weights, steps=[-1])
    assert found["v"] == pytest.approx(run.model.mass @ along, abs=1e-11)
    largest = {name: abs(found[name]).max() for name in ("q", "members", "arcs", "X")}
    assert max(largest.values()) < 1e-9


def of_numbers(x):
    """Numbers: stiffness, speed, place, radius."""
    scene, section = fb.Scene(), fb.Section(**DATA | {"EI": x[0]})
    below = scene.add_beam([(0, 0), (2, 0)], section, elements=8)
    above = scene.add_beam([(0.71, 0.118), (x[2], 1.3)], section, elements=8)
    scene.add_contact(above, below, stiffness=1e5, radius=x[3])
    scene.set_velocity(above, (0.3, x[1]), spin=0.5)
    energies = {name: fb.Output(f"{name}_energy", scene) for name in ("total", "spring")}
    return scene, energies | {"tip": fb.Output("position", below.end)}


NUMBERS = np.array([10.0, -1.0, 1.1, 0.05])


def test_derivatives_of_the_energy_are_constant():
    """That of contact is a part of it."""
    run = fb.Response(of_numbers, dt=2e-3, t_end=0.08)
    t, y = run(NUMBERS)
    changes = run.jacobian()
    assert (y["spring"] > 1e-4).sum() > 5
    energy = changes["total"]
    assert energy == pytest.approx(np.tile(energy[0], (len(t), 1)), abs=1e-9 * abs(energy).max())
    assert abs(changes["spring"]).max() > 0.1 * abs(energy).max()
    weights = {name: np.cos(np.arange(rows.size)).reshape(rows.shape) for name, rows in y.items()}
    expected = sum(
        np.tensordot(weights[name], changes[name], rows.ndim) for name, rows in y.items()
    )
    assert run.vjp(weights) == pytest.approx(expected, rel=1e-9)
    # Within a memory of some steps.
    few = fb.Response(of_numbers, dt=2e-3, t_end=0.08, memory=2e4)
    few(NUMBERS)
    assert few.vjp(weights) == pytest.approx(expected, rel=1e-8)


def resting(x):
    """A cantilever on another one, at rest with friction; numbers: load, stiffness, height."""
    scene = fb.Scene()
    for y, length, elements in ((0.0, 1.0, 7), (0.1 + x[2], 0.9, 5)):
        section = fb.Section(**DATA | {"EI": x[1]})
        beam = scene.add_beam([(0, y), (length, y)], section, elements=elements)
        scene.clamp(beam.start)
    friction = fb.Coulomb(0.3, 1e3)
    scene.add_contact(beam, scene.beams[0], stiffness=1e5, radius=0.05, friction=friction)
    scene.add_force(beam.end, (0.0, -x[0]))
    tips = {f"tip {k}": fb.Output("position", scene.beams[k].end) for k in (0, 1)}
    return scene, tips | {"M": fb.Output("M", beam), "energy": fb.Output("spring_energy", scene)}


def test_derivatives_of_equilibria_are_those_of_differences():
    run, x = fb.StaticResponse(resting, steps=3), np.array([5.0, 10.0, 0.01])
    _, y = run(x)
    assert y["energy"][-1] > 1e-6
    weights = {name: np.cos(np.arange(rows.size)).reshape(rows.shape) for name, rows in y.items()}
    found, changes = run.vjp(weights), run.jacobian()

    def value(x):
        rows = run(x)[1]
        return sum((weights[name] * rows[name]).sum() for name in rows)

    for i, number in enumerate(x):
        one = np.eye(len(x))[i] * number
        low, high = ((value(x + h * one) - value(x - h * one)) / (2 * h) for h in (1e-4, 2e-4))
        assert found[i] * number == pytest.approx((4 * low - high) / 3, rel=1e-6, abs=1e-7)
    forward = sum(np.tensordot(weights[name], changes[name], y[name].ndim) for name in y)
    assert found == pytest.approx(forward, rel=1e-9)


def test_contact_of_members_beside_a_node_that_slides_is_refused():
    def build(x):
        scene = crossing(x[0])
        bead = scene.add_body((0.3, 0.003 * x[0]), 0.1, 0.01)
        scene.add_joint(fb.Slider(scene.beams[0], bead.centre))
        return scene, {"bead": fb.Output("position", bead.centre)}

    run = fb.Response(build, dt=2e-3, t_end=4e-3)
    t, _ = run([1.0])
    with pytest.raises(fb.SceneError, match="in a scene with nodes that slide on beams"):
        run.vjp({"bead": np.ones((len(t), 2))})
