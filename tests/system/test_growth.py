"""Cost grows as the work grows: memory, calls and lines at several sizes, without a clock."""

import sys

import numpy as np
import pytest
from growth import (
    KINDS,
    calls,
    exponent,
    ladder,
    lattice,
    measure,
    peak,
    sliders,
    springs,
    tower,
    truss,
    warm,
)

import fx_beam as fb
from fx_beam.coupling import reduction
from fx_beam.coupling.graph import Entries
from fx_beam.plot.drawing import Drawing
from fx_beam.scene.sliders import axis_of
from fx_beam.step import tangent_storage
from fx_beam.step.stepper import CompiledLoop

LARGEST = 1.1  # exponent p of cost ~ n^p
FILES = "save", "to_paraview", "interactive", "table of outputs"
COSTS = "10 steps", "static", "modes", "gradient, 1", "shapes", *FILES
# Smaller sizes of kinds of which each thing has several parts.
SMALL = dict.fromkeys(KINDS, 16) | {"tower": 12, "sliders": 12}


def too_large(kind, count, costs, small):
    """Costs by name with their exponents, if these are too large twice.

    One measurement may count what others need: a table of the process that grows, another thread.
    """
    warm(kind, costs)
    powers = {}
    for _ in range(2):
        before, now = (measure(kind, n, count, costs) for n in (small, 4 * small))
        powers = {name: exponent(before[name], now[name], 4) for name in costs}
        powers = {name: power for name, power in powers.items() if power >= LARGEST}
        if not powers:
            break
    return powers


# A ladder is a tower without springs. Loops on all sides take more memory (docs/limits.md).
@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"ladder", "bars"}))
def test_memory_grows_as_the_number_of_things(kind):
    assert not too_large(kind, peak, COSTS, SMALL[kind])


def test_memory_of_buckling_grows_as_the_number_of_closed_loops():
    fb.buckling(tower(4)[0], n=2)
    small, large = (peak(lambda n=n: fb.buckling(tower(n)[0], n=2)) for n in (64, 192))
    assert exponent(small, large, 3) < LARGEST


@pytest.mark.parametrize("kind", ["lattice", "gears", "springs"])
def test_files_and_pages_take_calls_as_the_number_of_things(kind):
    assert not too_large(kind, calls, FILES, small=64)


def lines(run):
    """Number of lines of Python that are run."""
    count = 0

    def line(_, event, __):
        nonlocal count
        count += event == "line"
        return line

    tracer = sys.gettrace()
    sys.settrace(line)
    try:
        run()
        return count
    finally:
        sys.settrace(tracer)


def changes(n):
    """Changes of some parts of a truss, by names."""
    scene = truss(n)[0]
    joints, springs = scene.joints[:8], scene.forces_between[:8]
    forces = [scene.add_force(node, (0.0, -1.0)) for node in scene.nodes]
    return {
        "change": lambda: [scene.change(force, (0.0, -2.0)) for force in forces[-8:]],
        "lock": lambda: [scene.unlock(scene.lock(joint)) for joint in joints],
        "remove forces": lambda: [scene.remove(force) for force in forces[:8]],
        "remove springs": lambda: [scene.remove(spring) for spring in springs],
        "remove joints": lambda: [scene.remove(joint) for joint in joints],
        "add and remove": lambda: [
            scene.remove(scene.add_force(x, (1, 0))) for x in scene.nodes[:8]
        ],
    }


def test_changes_of_parts_do_not_look_through_the_scene():
    small, large = ({name: lines(run) for name, run in changes(n).items()} for n in (32, 512))
    powers = {name: exponent(small[name], large[name], 16) for name in small}
    assert not {name: power for name, power in powers.items() if power > 0.1}


@pytest.mark.parametrize(("kind", "error"), [(sliders, 0.1), (ladder, 0.15)])
def test_factors_and_work_space_of_many_joints_are_linear(kind, error, monkeypatch):
    loops, take = [], CompiledLoop.take_steps

    def noted(loop, *arguments):
        loops.append(loop)
        return take(loop, *arguments)

    monkeypatch.setattr(CompiledLoop, "take_steps", noted)

    def sizes(n):
        fb.simulate(kind(n)[0], dt=1e-3, t_end=2e-3)
        rows = loops[-1].problem.c.work.factors.rows
        return [rows.start[rows.unknowns], len(loops[-1].problem.scratch)]

    small, large = sizes(16), sizes(64)
    assert [after / before for before, after in zip(small, large, strict=True)] == pytest.approx(
        [4.0, 4.0], rel=error
    )


def test_the_position_of_a_node_in_some_rows_copies_no_other_nodes():
    solution = fb.simulate(springs(512)[0], dt=1e-3, t_end=0.01)
    drawing = Drawing(solution, [0])
    assert peak(lambda: drawing.positions(3, range(10))) < solution.q.nbytes / 20


def test_tables_of_the_tangent_of_a_large_frame_are_found_once(monkeypatch):
    calls, find = [], reduction.reduced_tangent
    monkeypatch.setattr(tangent_storage, "LARGE", 0)
    monkeypatch.setattr(reduction, "reduced_tangent", lambda *x: calls.append(0) or find(*x))
    fb.modes(lattice(32)[0], n=2)
    assert len(calls) == 1


def test_equations_of_many_sliders_are_found_together(monkeypatch):
    counts, find = [], reduction.JointMaps._dependence

    def counted(*arguments):
        results = []
        counts.append(calls(lambda: results.append(find(*arguments))))
        return results[0]

    monkeypatch.setattr(reduction.JointMaps, "_dependence", counted)
    last = []
    for n in (64, 128):
        fb.simulate(sliders(n)[0], dt=1e-3, t_end=1e-3)
        last.append(counts[-1])
    assert last[1] < 1.1 * last[0]


def test_arms_are_found_where_products_of_their_numbers_are_too_large_for_32_bits():
    rows, values = np.array([[80_000, 80_999], [71_993, 71_994]], np.int32)
    entries = Entries(rows, np.zeros(2, np.int32), values, np.ones(2))
    assert [part.tolist() for part in entries.arms] == [rows.tolist(), [35_996, 35_997]]


def test_a_node_on_a_long_beam_is_looked_for_near_it_and_has_the_same_place(monkeypatch):
    section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    ring = fb.Scene().add_beam(fb.arc((1, 0), (0.6, 0.8), (0, 1)), section, elements=200, degree=2)
    cubics = axis_of(ring).cubics
    points = np.vstack([np.zeros(2), np.random.default_rng(0).uniform(-1, 2, (50, 2))])
    places = [cubics.nearest(point) for point in points]
    assert np.median([len(cubics._near(point)) for point in points]) < 60
    monkeypatch.setattr(type(cubics), "_near", lambda path, point: np.arange(200))
    assert places == [cubics.nearest(point) for point in points]
