"""What slides on beams borders the tangent of the compiled loop: the same motion, at what cost."""

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.compiled.handover import Problem
from fx_beam.model.model import Model
from fx_beam.scene.path import Path
from fx_beam.stepping.newton import NewtonOptions

SOFT = fb.Section(EA=1e4, GA=1e4, EI=50.0, rhoA=1.0, rhoI=0.01)
MASSLESS = fb.Section(EA=1e4, GA=1e4, EI=50.0)
# Members of a frame that moves little.
STIFF = fb.Section(EA=1e6, GA=1e6, EI=500.0, rhoA=1.0, rhoI=0.01)


def carriages(elements, number, make=fb.Slider, degree=1, speed=1.0):
    """A simply supported beam, on which carriages of two wheels run."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (6, 0)], SOFT, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    for k in range(number):
        axle = scene.add_beam([(0.5 + 1.2 * k, 0), (1.1 + 1.2 * k, 0)], SOFT, degree=degree)
        for wheel in (axle.start, axle.end):
            scene.add_mass(wheel, 0.4, inertia=0.05)
            scene.add_joint(make(beam, wheel))
        scene.set_velocity(axle, (speed, 0.0))
    return scene


def held_by_what_slides(make=fb.Slider, degree=1):
    """A massless rod that is held along its axis, and else by two nodes that slide on it."""
    scene = fb.Scene(gravity=(0, -1))
    rod = scene.add_beam([(0, 0), (6, 0)], MASSLESS, elements=12, degree=degree)
    scene.fix(rod.start, "x")
    axle = scene.add_beam([(1.2, 0), (4.7, 0)], SOFT, elements=6, degree=degree)
    for node, kind in ((axle.start, make), (axle.end, fb.Slider)):
        scene.add_mass(node, 0.8, inertia=0.05)
        scene.add_joint(kind(rod, node))
    scene.set_velocity(axle, (0.5, 0.0))
    return scene


def bridge(columns=12, rows=8):
    """A mass on the girder of a frame."""
    scene = fb.Scene(gravity=(0, -9.81))
    girder = scene.add_beam([(0, 0), (columns, 0)], STIFF, elements=2 * columns)
    above = list(girder.nodes[::2])
    for row in range(1, rows + 1):
        above = [scene.add_beam([n, (n.x, -row)], STIFF).end for n in above]
        for left, right in zip(above[:-1], above[1:], strict=True):
            scene.add_beam([left, right], STIFF)
    scene.pin(above[0])
    scene.pin(above[-1])
    small = scene.add_beam([(1.5, 0), (1.5, 0.3)], STIFF)
    scene.add_mass(small.start, 8.0, inertia=0.05)
    scene.add_joint(fb.Slider(girder, small.start))
    scene.set_velocity(small, (6.0, 0.0))
    return scene


def on_a_mechanism():
    """A four-bar of bodies, at one of which a beam ends, on which a mass slides."""
    scene = fb.Scene(gravity=(0, -9.81))
    corners = [(0, 0), (0, 1), (2, 1.2), (2, 0)]
    bars = [
        scene.add_body(np.mean([a, b], axis=0), 1.0, 0.1, points={"start": a, "end": b, "end 2": b})
        for a, b in zip(corners[:-1], corners[1:], strict=True)
    ]
    scene.pin(bars[0]["start"])
    scene.add_joint(fb.Revolute(bars[0]["end"], bars[1]["start"]))
    scene.add_joint(fb.Revolute(bars[1]["end"], bars[2]["start"]))
    scene.add_joint(fb.Revolute(bars[2]["end"], fb.GROUND))
    beam = scene.add_beam([bars[1]["end 2"], (5, 1.2)], SOFT, elements=10)
    small = scene.add_beam([(2.5, 1.2), (2.5, 1.5)], SOFT)
    scene.add_mass(small.start, 0.5)
    scene.add_joint(fb.Slider(beam, small.start))
    return scene


MADE = {
    "chain": lambda: carriages(24, 2),
    "sleeves in a chain": lambda: carriages(24, 1, fb.Sleeve),
    "band": lambda: carriages(12, 2, degree=2),
    "sleeves in a band": lambda: carriages(12, 1, fb.Sleeve, degree=3),
    "massless rod": held_by_what_slides,
    "massless rod with a sleeve": lambda: held_by_what_slides(fb.Sleeve, 2),
    "sparse": bridge,
    "loop": on_a_mechanism,
}


@pytest.mark.parametrize("made", MADE)
def test_corrections_are_those_of_a_tangent_without_borders(made):
    scenes = [MADE[made]() for _ in range(2)]
    found, exact = (
        fb.simulate(scene, dt=0.01, t_end=0.25, solver=solver)
        for scene, solver in zip(scenes, ("compiled", "petsc"), strict=True)
    )
    *_, storage = made.split()
    assert storage not in ("chain", "band", "sparse") or storage in found.stats.solver
    assert found.stats.newton_iterations == exact.stats.newton_iterations
    energy = exact.energy.kinetic.max()
    assert abs(found.energy.balance_error).max() < 1e-10 * energy
    for a, b in zip(*(scene.nodes for scene in scenes), strict=True):
        assert found.position(a) == pytest.approx(exact.position(b), abs=1e-9)
    for a, b in zip(*(scene.joints for scene in scenes), strict=True):
        forces = exact.joint(b).force
        assert found.joint(a).force == pytest.approx(forces, abs=1e-7 * max(1, abs(forces).max()))


def handed_over(scene):
    return Problem(Model(scene, fb.EnergyMomentum()), None, NewtonOptions())


@pytest.mark.parametrize("make, borders", [(fb.Slider, 7), (fb.Sleeve, 11)])
def test_factors_grow_as_those_of_the_beam_and_borders_only_with_what_slides(make, borders):
    entries = {}
    for elements in (100, 1000):
        alone = handed_over(carriages(elements, 0))
        for number in (1, 2):
            problem = handed_over(carriages(elements, number, make))
            assert problem.c.borders == 2 * number * borders
            # A group of three unknowns has 36 numbers.
            assert problem.factors.size < alone.factors.size + number * 6 * 36
            entries[elements, number] = problem.c.most_border_entries
    assert entries[100, 1] == entries[1000, 1] < entries[100, 2] == entries[1000, 2]


def test_beams_beside_each_other_are_chains_whatever_their_ends():
    def beams(*numbers):
        scene = fb.Scene()
        for k, elements in enumerate(numbers):
            beam = scene.add_beam([(0, k), (1, k)], SOFT, elements=elements)
            scene.pin(beam.start)
            if k % 2:
                scene.clamp(beam.end)
        return handed_over(scene).factors

    # Together they have no more groups than one by one.
    found = beams(7, 8, 5)
    assert str(found) == "chain" and found.chain <= sum(beams(n).chain for n in (7, 8, 5))


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize(
    "points", [[(0, 0), (3, 0), (3, 3), (1, 2)], fb.arc((0, 0), (3, 0.8), (6, 0))]
)
def test_the_nearest_point_is_the_nearest_of_many(points, degree):
    path = Path(fb.Scene().add_beam(points, SOFT, elements=30, degree=degree))
    on_path = path.over(
        np.broadcast_to(path.X, (4001, *path.X.shape)), np.linspace(0, path.length, 4001)
    )
    for point in np.random.default_rng(0).uniform(-1, 5, (40, 2)):
        s, distance = path.nearest(point)
        assert np.linalg.norm(path.position(s) - point) == pytest.approx(distance, abs=1e-12)
        assert distance <= np.linalg.norm(on_path - point, axis=1).min() + 1e-12
