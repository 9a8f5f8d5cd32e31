"""Derivatives within a memory: steps between kept states are repeated, to the last digit."""

import tracemalloc

import numpy as np
import pytest
from derivatives import assert_derivatives
from jointed import frame, linkage, pair
from scenes import PLASTIC, clamped_bar, lattice

import fx_beam as fb


def loaded(scene, x, node, joint=None):
    """A scene with a mass and a force at a node, and its outputs."""
    scene.add_mass(node, 0.1 * x[0])
    scene.add_force(node, (x[1], 0.0))
    outputs = {"tip": fb.Output("position", node), "rate": fb.Output("velocity", node)}
    if joint is not None:
        outputs["force"] = fb.Output("force", joint)
    return scene, outputs | {"energy": fb.Output("kinetic_energy", scene)}


def linked(x):
    """With rates that fit the joints, and forces: a row needs the whole step before it."""
    scene = linkage()
    return loaded(scene, x, scene.beams[0].end, scene.joints[1])


def framed(x):
    scene = frame()
    return loaded(scene, x, scene.beams[-1].end)


def paired(x):
    scene, first, second, _ = pair("revolute with offset", gravity=(0, -9.81))
    scene.pin(first.start)
    return loaded(scene, x, second.end)


def latticed(x):
    """Its tangent is stored in sparse rows, whose factors serve several steps."""
    scene = lattice(9)
    return loaded(scene, x, scene.beams[-1].end)


def yielding(x):
    scene, beam = clamped_bar((1, 0), PLASTIC, elements=4, load=(0, 6.0))
    return loaded(scene, x, beam.end)


CASES = {
    "with rates that fit the joints": (linked, {"dt": 0.01}, 1e4),
    "of order 4": (paired, {"dt": 0.01, "scheme": fb.EnergyMomentum(order=4)}, 2e4),
    "that depend on the last one": (paired, {"dt": 0.01, "scheme": fb.EnergyDecaying()}, 1e4),
    "that a tolerance chooses": (framed, {"tolerance": 1e-3}, 3e4),
    "with factors of earlier steps": (latticed, {"dt": 0.01}, 2e5),
    "with internal variables": (yielding, {"dt": 0.01}, 6e3),
}


@pytest.mark.parametrize("case", CASES)
def test_steps_that_are_repeated_are_the_same_to_the_last_digit(case):
    build, options, memory = CASES[case]
    gradients, rows = [], []
    for limit in (1e9, memory, 1.0):
        run = fb.Response(build, t_end=0.31, memory=limit, **options)
        _, y = run([1.0, 0.5])
        weights = {name: np.ones_like(y[name]) for name in y}
        gradients.append(run.vjp(weights))
        J = run.jacobian()
        assert np.array_equal(gradients[-1], run.vjp(weights))
        rows.append([*y.values(), *J.values()])
    for repeated in rows[1:]:
        assert all(np.array_equal(one, other) for one, other in zip(rows[0], repeated, strict=True))
    # What outputs have of the numbers themselves is summed part by part.
    assert gradients[1] == pytest.approx(gradients[0], rel=1e-12)
    assert gradients[2] == pytest.approx(gradients[0], rel=1e-12)


def test_a_lattice_whose_factors_serve_several_steps_has_derivatives():
    run = fb.Response(latticed, dt=0.01, t_end=0.1, newton=fb.NewtonOptions(tolerance=1e-13))
    assert_derivatives(run, [1.0, 0.5])
    assert "kept over several steps" in str(run.stats)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4)])
def test_sums_over_steps_count_in_parts_without_a_recorded_row(scheme):
    def build(x):
        scene, _ = paired(x)
        scene.add_drag(scene.beams[0], linear=0.1 * x[0])
        quantities = "work", "dissipated_energy"
        return scene, {quantity: fb.Output(quantity, scene) for quantity in quantities}

    gradients = []
    for limit in (1e9, 1.0):  # with a part for each step
        options = {"dt": 0.01, "t_end": 0.3, "record": fb.Record(every=30), "memory": limit}
        run = fb.Response(build, scheme, **options)
        _, y = run([1.0, 0.5])
        weights = {name: np.linspace(0.3, 0.5, len(rows)) for name, rows in y.items()}
        gradients.append([run.vjp({name: rows}) for name, rows in weights.items()])
    for whole, in_parts in zip(*gradients, strict=True):
        assert in_parts == pytest.approx(whole, rel=1e-10)


def test_the_memory_of_a_gradient_is_bounded():
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=x[0], rhoA=1.0, rhoI=0.1)
        scene, beam = clamped_bar((1, 0), section, elements=40, gravity=(0, -9.81))
        return scene, {"tip": fb.Output("position", beam.end)}

    def peak(memory):
        run = fb.Response(build, dt=1e-3, t_end=1.0, memory=memory, record=fb.Record(every=500))
        tracemalloc.start()  # the first call has the steps on the tape
        _, y = run([100.0])
        gradient = run.vjp({"tip": np.ones_like(y["tip"])})
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size, gradient

    (whole, gradient), (few, same) = peak(1e9), peak(5e5)
    rows = 1000 * 3 * 41 * 3 * 8  # of displacements, rates and increments
    assert whole > rows
    assert few < whole - rows + 2e6
    assert same == gradient


def test_a_jacobian_needs_no_memory_for_states_that_no_output_reads():
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
        scene, beam = clamped_bar((1, 0), section, elements=100, load=(0.0, np.sum(x)))
        return scene, {"tip": fb.Output("velocity", beam.end)}

    run, x = fb.Response(build, dt=0.01, t_end=1.0), np.ones(8)
    t, _ = run(x)
    run.jacobian()
    tracemalloc.start()
    run.jacobian()
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert largest < 8 * len(t) * len(x) * 300  # bytes of all displacements
