"""Derivatives within a memory: steps between kept states are repeated, to the last digit."""

import tracemalloc

import numpy as np
import pytest
from test_adjoint import frame as grid
from test_response import frame, linkage
from test_static_response import yielding

import fx_beam as fb


def loaded(scene, x):
    end = scene.beams[-1].end
    scene.add_mass(end, 0.1 * x[0])
    scene.add_force(end, (x[1], 0.0))
    return scene, {
        "tip": fb.Output("position", end),
        "energy": fb.Output("kinetic_energy", scene),
    }


def linked(x):
    """With rates that fit the joints, and forces: a row needs the whole step before it."""
    scene = linkage()
    scene.add_mass(scene.beams[0].end, 0.1 * x[0])
    scene.add_force(scene.beams[0].start, (x[1], 0.0))
    return scene, {
        "speed": fb.Output("velocity", scene.beams[0].end),
        "force": fb.Output("force", scene.joints[1]),
    }


CASES = {
    "with rates that fit the joints": (linked, {"dt": 0.01}, 1e4),
    "with all kinds of forces": (lambda x: loaded(frame(), x), {"dt": 0.01}, 3e4),
    "of order 4": (
        lambda x: loaded(frame(), x),
        {"dt": 0.01, "scheme": fb.EnergyMomentum(order=4)},
        3e4,
    ),
    "that depend on the last one": (
        lambda x: loaded(frame(), x),
        {"dt": 0.01, "scheme": fb.EnergyDecaying()},
        3e4,
    ),
    "that a tolerance chooses": (lambda x: loaded(frame(), x), {"tolerance": 1e-3}, 3e4),
    "with kept factors": (lambda x: loaded(grid(1.0, 10), x), {"dt": 0.01}, 2e5),
    "with internal variables": (lambda x: yielding([1.0, *x]), {"dt": 0.01}, 6e3),
}


@pytest.mark.parametrize("case", CASES)
def test_steps_that_are_repeated_are_the_same_to_the_last_digit(case):
    build, options, memory = CASES[case]
    found = []
    for limit in (1e9, memory):
        run = fb.Response(build, t_end=0.31, memory=limit, **options)
        _, y = run([1.0, 0.5])
        weights = {name: np.ones_like(values) for name, values in y.items()}
        gradient, J = run.vjp(weights), run.jacobian()
        assert np.array_equal(gradient, run.vjp(weights))
        found.append((gradient, [*y.values(), *J.values()]))
        assert run._kept.tape.is_whole == (limit == 1e9)
    (gradient, whole), (same, repeated) = found
    for one, other in zip(whole, repeated, strict=True):
        assert np.array_equal(one, other)
    # What outputs have of the numbers themselves is summed part by part.
    assert gradient == pytest.approx(same, rel=1e-12)


def test_steps_whose_increments_are_kept_are_repeated_without_iterations():
    run = fb.Response(lambda x: loaded(frame(), x), dt=0.01, t_end=0.31, memory=1e4)
    _, y = run([1.0, 0.5])
    run.vjp({name: np.ones_like(values) for name, values in y.items()})
    tape, problem = run._kept.tape, run._kept.last.stepper.integrator.problem
    known = [checkpoint.increments is not None for checkpoint in tape._checkpoints]
    iterated, iterations = [], problem.c.iterations
    for _ in tape.parts(problem):
        iterated.append(problem.c.iterations > iterations)
        iterations = problem.c.iterations
    assert True in known and False in known
    assert iterated == [not kept for kept in known]
    kept = [own.increments.nbytes for own in tape._checkpoints if own.increments is not None]
    assert sum(kept) <= 5e3


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4)])
def test_sums_over_steps_count_in_parts_without_a_recorded_row(scheme):
    def build(x):
        scene, _ = loaded(frame(), x)
        scene.add_drag(scene.beams[0], linear=0.1 * x[0])
        quantities = "work", "dissipated_energy"
        return scene, {quantity: fb.Output(quantity, scene) for quantity in quantities}

    options = {"dt": 0.01, "t_end": 0.3, "record": fb.Record(every=30)}
    gradients = []
    for limit in (1e9, 1e4):
        run = fb.Response(build, scheme, memory=limit, **options)
        _, y = run([1.0, 0.5])
        weights = {name: np.linspace(0.3, 0.5, len(rows)) for name, rows in y.items()}
        gradients.append([run.vjp({name: rows}) for name, rows in weights.items()])
    tape, problem = run._kept.tape, run._kept.last.stepper.integrator.problem
    assert not all(len(part.own(run._boundaries(tape))) for part in tape.parts(problem))
    for whole, in_parts in zip(*gradients, strict=True):
        assert in_parts == pytest.approx(whole, rel=1e-10)


def test_the_memory_of_a_gradient_is_bounded():
    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        section = fb.Section(EA=1e4, GA=1e4, EI=x[0], rhoA=1.0, rhoI=0.1)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=40)
        scene.clamp(beam.start)
        return scene, {"tip": fb.Output("position", beam.end)}

    def peak(memory):
        run = fb.Response(build, dt=1e-3, t_end=2.0, memory=memory, record=fb.Record(every=500))
        _, y = run([100.0])
        tracemalloc.start()
        gradient = run.vjp({"tip": np.ones_like(y["tip"])})
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size, gradient

    (whole, gradient), (few, same) = peak(1e9), peak(5e5)
    rows = 2000 * 3 * 41 * 3 * 8  # of displacements, rates and increments
    assert whole > rows
    assert few < whole - rows + 2e6
    assert same == gradient


def test_a_memory_that_is_no_number_is_refused():
    with pytest.raises(fb.SceneError, match="Response: memory = 0 must be a positive number"):
        fb.Response(lambda x: x, dt=0.1, t_end=1.0, memory=0)
