"""Cost grows as the work grows: memory of arrays at sizes four times apart, without a clock."""

import math
import tracemalloc

import pytest
from growth import sliders

import fx_beam as fb
from fx_beam.step.loop import CompiledLoop

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
LARGEST = 1.3  # exponent p of memory ~ n^p


def hanging_chain(n):
    """n links on hinges, some with springs, pulled aside at the end."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    for k in range(n):
        link = scene.add_body((0, -k - 0.5), 1.0, 0.1, points={"top": (0, -k), "end": (0, -k - 1)})
        if last is None:
            scene.pin(link["top"])
        else:
            spring = fb.Spring(10.0) if k % 2 else None
            scene.add_joint(fb.Revolute(last["end"], link["top"], spring=spring))
        last = link
    scene.add_force(last.centre, (1.0, 0.0))
    return scene


def members(n):
    """A beam of n elements beside another one; both may touch."""
    scene = fb.Scene()
    below = scene.add_beam([(0, 0), (n, 0)], SECTION, elements=n)
    above = scene.add_beam([(0, 0.2), (n, 0.2)], SECTION, elements=n)
    for end in (below.start, below.end, above.start, above.end):
        scene.clamp(end)
    contact = scene.add_contact(above, below, stiffness=1e5, radius=0.05)
    return scene, contact


def memory(run):
    """Largest number of bytes at a time."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def exponent(run, sizes):
    run(4)  # loads and compiles
    small, large = (memory(lambda n=n: run(n)) for n in sizes)
    return math.log(large / small) / math.log(sizes[1] / sizes[0])


def vibrate(n):
    scene = hanging_chain(n)
    lowest = fb.modes(scene, fb.static(scene, load_steps=1), n=4)
    assert (lowest.angular_frequencies > 0).all()


def touch(n):
    scene, contact = members(n)
    solution = fb.static(scene, load_steps=1)
    assert (solution.contact(contact).gap > 0).all()


def test_memory_of_modes_of_a_long_chain_is_linear():
    assert exponent(vibrate, (128, 512)) < LARGEST


def test_memory_of_members_that_may_touch_is_linear():
    assert exponent(touch, (400, 1600)) < LARGEST


def test_factors_and_work_space_of_many_bodies_on_a_beam_are_linear(monkeypatch):
    loops, take = [], CompiledLoop.take

    def noted(loop, *arguments):
        loops.append(loop)
        return take(loop, *arguments)

    monkeypatch.setattr(CompiledLoop, "take", noted)

    def sizes(n):
        fb.simulate(sliders(n)[0], dt=1e-3, t_end=2e-3)
        rows = loops[-1].problem.c.system.rows
        return [rows.start[rows.unknowns], len(loops[-1].problem.scratch)]

    small, large = sizes(16), sizes(64)
    assert [after / before for before, after in zip(small, large, strict=True)] == pytest.approx(
        [4.0, 4.0], rel=0.1
    )
