"""Contact with circles and lines that move: invariants, closed solutions, files, bad input."""

import copy

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.mechanics.interval import Interval
from fx_beam.model.equations import Equations
from fx_beam.model.model import Model
from fx_beam.stepping.initial_state import reference_state

SOFT = fb.Section(EA=100.0, GA=100.0, EI=10.0, rhoA=1.0, rhoI=0.1)
SHAPES = pytest.mark.parametrize("shape", ["circle", "line"])


def bar_on_plate(shape, **options):
    """A free soft bar of degree 2 that meets a shape off the centre of a free body."""
    scene = fb.Scene()
    plate = scene.add_body((0, 0), mass=2.0, inertia=0.5, points={"edge": (0.1, 0.2)})
    bar = scene.add_beam([(-0.5, 0.9), (0.5, 0.8)], SOFT, elements=3, degree=2, name="bar")
    edge = plate["edge"]
    made = fb.Circle(edge, 0.5) if shape == "circle" else fb.Line(edge, (0.1, 1.0))
    contact = scene.add_contact(bar, made, stiffness=1e4, radius=0.02, **options)
    scene.set_velocity(bar, (0.3, -1.0), spin=0.5)
    scene.set_velocity(plate, (0.1, 0.0), spin=0.7)
    return scene, contact


@SHAPES
@pytest.mark.parametrize("along", [None, 3])
def test_free_members_keep_energy_and_both_momenta_in_contact(shape, along):
    scene, contact = bar_on_plate(shape, along=along)
    solution = fb.simulate(scene, dt=0.005, t_end=2.0)
    assert solution.contact(contact).gap.min() < -1e-3
    assert abs(solution.energy.balance_error).max() < 1e-12
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-13
    assert np.ptp(solution.angular_momentum) < 1e-13
    assert solution.stats.halvings == 0


@SHAPES
def test_both_solvers_agree_with_a_loss(shape):
    runs = []
    for solver in ("compiled", "petsc"):
        scene, contact = bar_on_plate(shape, along=2, restitution=0.5, speed=0.02)
        runs.append(fb.simulate(scene, dt=0.005, t_end=0.5, solver=solver))
    assert runs[0].energy.dissipated[-1] > 0.02
    assert runs[0].q == pytest.approx(runs[1].q, abs=1e-9)
    one, other = (run.contact(contact).force for run in runs)
    assert one == pytest.approx(other, abs=1e-7)
    # What pushes the bar changes its momentum, and pushes the body the other way.
    body = scene.bodies[0].centre
    change = -2.0 * (runs[0].velocity(body)[-1] - runs[0].velocity(body)[0])
    assert one.sum(axis=(0, 1)) * 0.005 == pytest.approx(change, abs=1e-10)


@SHAPES
@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.HHT(-0.2), fb.Equilibrium()], ids=lambda s: s.name
)
def test_the_tangent_is_the_derivative_of_the_forces(shape, scheme):
    random = np.random.default_rng(1)
    scene, _ = bar_on_plate(shape, along=2)
    model = Model(scene, scheme, mobile=True)
    start, equations = reference_state(model), Equations(model)
    start.q[:], start.v[:] = 0.05 * random.normal(size=(2, model.size))
    start.q[model.mesh.dofs[model.mesh.X[:, 1] > 0.4, 1]] -= 0.2 if shape == "circle" else 0.7
    equations.begin(Interval(0.0, 0.1), start)
    D, direction = 0.01 * random.normal(size=(2, model.size))
    points = model.points

    def force(at):
        out = np.zeros(model.size)
        points.add_force(at, out)
        return out

    h = 1e-6
    difference = (force(D + h * direction) - force(D - h * direction)) / (2 * h)
    assert abs(difference).max() > 1.0
    force(D)
    product, first = np.zeros(model.size), 0
    for entry, law in zip(points._results, points._laws, strict=True):
        pairs = points.pairs[first : first + len(law.entries)]
        values = entry[law.law.size :][: len(pairs)]
        np.add.at(product, pairs[:, 0], values * direction[pairs[:, 1]])
        first += len(pairs)
    assert product == pytest.approx(difference, abs=1e-6 * abs(difference).max())


def test_two_equal_discs_change_their_velocities():
    scene = fb.Scene()
    discs = [scene.add_body((x, 0), mass=3.0, inertia=0.1).centre for x in (0.0, 1.0)]
    scene.add_contact(discs[0], fb.Circle(discs[1], 0.2), stiffness=1e6, radius=0.1)
    scene.set_velocity(discs[0], (2.0, 0.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    assert solution.velocity(discs[1])[-1] == pytest.approx([2.0, 0.0], abs=1e-12)
    assert solution.velocity(discs[0])[-1] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_body_on_a_carried_line_presses_on_what_carries_it():
    scene = fb.Scene(gravity=(0, -10))
    section = fb.Section(EA=1e6, GA=1e6, EI=1e3)
    shelf = scene.add_beam([(0, 0), (1, 0)], section, elements=4, degree=2)
    scene.clamp(shelf.start)
    block = scene.add_body((1, 0.1), mass=2.0, inertia=0.1).centre
    scene.add_joint(fb.Prismatic(fb.GROUND, block, axis=(0, 1), spring=fb.Spring(1e-3)))
    contact = scene.add_contact(block, fb.Line(shelf.end, (0, 1)), stiffness=1e6, radius=0.1)
    solution = fb.static(scene, steps=4)
    force = solution.contact(contact).force[-1, 0]
    assert force[1] == pytest.approx(20.0, rel=1e-6)
    assert solution.displacement(shelf.end)[-1, 1] == pytest.approx(-20 / 3e3, rel=2e-2)
    normal = force / np.hypot(*force)
    psi = solution.rotation(shelf.end)[-1]
    assert normal == pytest.approx([-np.sin(psi), np.cos(psi)], abs=1e-9)


def test_contact_is_saved_copied_and_taken_away(tmp_path):
    scene, contact = bar_on_plate("circle", along=2)
    wall = scene.add_contact(scene.bodies[0].centre, fb.Line((0, -3), (0, 1)), stiffness=1e3)
    solution = fb.simulate(scene, dt=0.005, t_end=0.5)
    solution.save(tmp_path / "run.npz")
    again = fb.load(tmp_path / "run.npz")
    for part in (contact, wall):
        assert (again.contact(part).gap == solution.contact(part).gap).all()
        assert (again.contact(part).force == solution.contact(part).force).all()
    twin = copy.deepcopy(scene)
    assert twin.obstacles[0].shape.carrier.scene is twin
    assert (fb.simulate(twin, dt=0.005, t_end=0.5).q == solution.q).all()
    scene.remove(contact)
    free = fb.simulate(scene, dt=0.005, t_end=0.5)
    assert not free.contact(wall).force.any()
    assert len(free.contact(wall).gap) == len(free.t)
    with pytest.raises(ValueError, match="not an obstacle of this solution"):
        free.contact(contact)


@pytest.mark.parametrize(
    ("shape", "options", "says"),
    [
        (lambda s, p: fb.Circle(p["edge"], 0.9), {}, r"point at .* starts 0\.2.* behind it"),
        (lambda s, p: fb.Circle(s.beams[0].start, 0.1), {}, "belongs to what it should stop"),
        (lambda s, p: fb.Circle(p["edge"], 0.1, True), {"radius": 0.2}, "above that of the inner"),
        (lambda s, p: fb.Line(p["edge"], (0, 1)), {"along": 0}, "along = 0 must be a whole number"),
        (lambda s, p: fb.Line(p["edge"], (0, 1)), {"radius": -1.0}, "finite and not negative"),
        (lambda s, p: fb.Line(fb.Scene().add_body((0, 0), 1).centre, (0, 1)), {}, "another scene"),
        (lambda s, p: p, {}, "needs an fx_beam.Line or an fx_beam.Circle"),
    ],
)
def test_what_does_not_fit_is_named(shape, options, says):
    scene, _ = bar_on_plate("line")
    options = {"along": 2} | options
    with pytest.raises(fb.SceneError, match=says):
        made = shape(scene, scene.bodies[0])
        scene.add_contact(scene.beams[0], made, stiffness=1e3, **options)
