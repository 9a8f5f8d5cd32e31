"""Nodes that meet fixed lines and circles: closed solutions, invariants, statics, solvers."""

import math

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.fem.compiled_laws import compiled_law
from fx_beam.mechanics.coordinates import SLIDE
from fx_beam.mechanics.point_laws import StepRule
from fx_beam.mechanics.scalar_laws import contact

SOLVERS = pytest.mark.parametrize("solver", ["compiled", "petsc"])
STIFF = fb.Section(EA=1e6, GA=1e6, EI=1e4)
SOFT = fb.Section(EA=100.0, GA=100.0, EI=10.0, rhoA=1.0, rhoI=0.1)
FLOOR = fb.Line((0, 0), normal=(0, 1))
WALL = fb.Line((0, 0), normal=(1, 0))


def ball(height=0.05, k=1e6, gravity=(0, -10), velocity=0.0, e=1.0, speed=None):
    """A mass of 1 kg above a floor, on one node of a massless bar."""
    scene = fb.Scene(gravity=gravity)
    bar = scene.add_beam([(0, height), (1, height)], STIFF)
    scene.fix(bar.start, "x", "rotation")
    scene.add_mass(bar.start, 1.0)
    floor = scene.add_obstacle(bar.start, FLOOR, k, e, speed)
    scene.set_velocity(bar, (0, velocity))
    return scene, bar.start, floor


def pendulum(e=1.0, speed=None):
    """A mass of 1 kg on a massless rod, 30 degrees from a vertical wall."""
    scene = fb.Scene(gravity=(0, -9.81))
    rod = scene.add_beam([(0, 0), (0.5, -(0.75**0.5))], fb.Section(EA=1e5, GA=1e5, EI=1e4))
    scene.pin(rod.start)
    scene.add_mass(rod.end, 1.0)
    return scene, scene.add_obstacle(rod.end, WALL, 1e4, e, speed)


def roller(shape, k=1e3, velocity=(1.0, 0.6), **options):
    """A free soft bar near an obstacle for all of its nodes."""
    scene = fb.Scene()
    bar = scene.add_beam([(-0.5, 0.3), (0.5, 0.2)], SOFT, elements=2, name="bar")
    obstacle = scene.add_obstacle(bar, shape, k, **options)
    scene.set_velocity(bar, velocity, spin=0.0)
    return scene, bar, obstacle


def cantilever(k, at=0.0, load=-1.0, rhoA=0.0):
    scene = fb.Scene()
    section = fb.Section(EA=1e8, GA=1e8, EI=1e3, rhoA=rhoA)
    beam = scene.add_beam([(0, 0), (2, 0)], section, elements=32)
    scene.clamp(beam.start)
    scene.add_line_load(beam, (0, load))
    stop = scene.add_obstacle(beam.end, fb.Line((0, at), normal=(0, 1)), k) if k else None
    return scene, stop


def bounces(gap):
    return np.count_nonzero((gap[:-1] >= 0) & (gap[1:] < 0))


# -- Bounces --------------------------------------------------------------------------------------


def test_a_ball_keeps_its_energy_over_100_bounces():
    scene, node, floor = ball()
    solution = fb.simulate(scene, dt=1e-3, t_end=20.4)
    gap = solution.contact(floor).gap[:, 0]
    assert bounces(gap) >= 100
    assert abs(solution.energy.balance_error).max() < 1e-10 * 0.5
    assert solution.stats.halvings == 0
    assert gap[-250:].max() == pytest.approx(0.05, rel=1e-3)


def test_a_cantilever_that_whips_against_a_stop_keeps_its_energy():
    def bent(force):
        scene = fb.Scene()
        section = fb.Section(EA=1e5, GA=1e5, EI=10.0, rhoA=1.0, rhoI=1e-3)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=12)
        scene.clamp(beam.start)
        scene.add_force(beam.end, (0.0, force))
        stop = fb.Line((0, -0.02), normal=(0, 1))
        return scene, beam, scene.add_obstacle(beam.end, stop, stiffness=1e6)

    held = fb.static(bent(10.0)[0], steps=4)
    scene, beam, stop = bent(0.0)
    solution = fb.simulate(scene, dt=2e-3, t_end=10.0, start=held)
    contact = solution.contact(stop)
    assert held.displacement(beam.end)[-1, 1] > 0.25
    assert bounces(contact.gap[:, 0]) > 20
    assert abs(solution.energy.balance_error).max() < 1e-10 * held.energy.strain[-1]
    pushed = contact.force[1:, 0] + solution.reaction(beam.start)[1:, :2]
    momentum = solution.linear_momentum
    assert momentum[-1] - momentum[0] == pytest.approx(pushed.sum(axis=0) * 2e-3, abs=1e-9)


@SOLVERS
def test_a_bounce_has_the_time_depth_and_momentum_of_the_closed_solution(solver):
    m, k, v = 1.0, 1e4, 2.0
    scene, node, floor = ball(0.02, k, None, -v)
    solution = fb.simulate(scene, dt=1e-4, t_end=0.06, solver=solver)
    contact, t = solution.contact(floor), solution.t
    inside = t[contact.gap[:, 0] < 0]
    assert inside[-1] - inside[0] == pytest.approx(math.pi * math.sqrt(m / k), abs=2e-4)
    assert contact.gap.min() == pytest.approx(-v * math.sqrt(m / k), rel=1e-4)
    assert solution.velocity(node)[-1, 1] == pytest.approx(v, rel=1e-12)
    # The force of a row is the mean over its step: its impulse is the change of momentum.
    assert contact.force[:, 0, 1].sum() * 1e-4 == pytest.approx(2 * m * v, rel=1e-10)
    assert solution.energy.springs.max() == pytest.approx(m * v**2 / 2, rel=1e-4)


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_a_stiff_contact_costs_few_iterations_and_no_halved_step(dt):
    # A step is up to 3e4 / (2 pi) times the period of the contact.
    scene, node, floor = ball(k=1e12, height=0.5)
    solution = fb.simulate(scene, dt=dt, t_end=5.0)
    assert solution.stats.halvings == 0
    assert solution.stats.newton_iterations < 4 * solution.stats.steps
    assert abs(solution.energy.balance_error).max() < 1e-9 * 5.0
    assert solution.contact(floor).gap.min() > -1e-5


def test_the_force_over_a_step_is_the_mean_over_its_way():
    law = compiled_law(contact(SLIDE), StepRule(0.5, True, False))

    def found(g0, g1):
        """The force that opens the gap, and its derivative by the gap at the end."""
        start, increment, rate, t, dt, k = g0, g1 - g0, 0.0, 0.0, 0.1, 7.0
        return -law(np.array([start, increment, rate, t, dt, k]))

    way = np.linspace(0, 1, 200_001)
    for g0, g1 in [(0.3, -0.2), (-0.2, 0.3), (-0.1, -0.4), (-0.4, -0.4), (0.0, -0.1), (0.2, 0.1)]:
        force, slope = found(g0, g1)
        assert force == pytest.approx(7.0 * np.maximum(-g0 - way * (g1 - g0), 0).mean(), abs=1e-4)
        more, less = (found(g0, g1 + h)[0] for h in (1e-7, -1e-7))
        assert slope == pytest.approx((more - less) / 2e-7, abs=1e-5)


# -- Invariants -----------------------------------------------------------------------------------


@SOLVERS
def test_a_circle_conserves_energy_and_the_momentum_about_its_centre(solver):
    scene, bar, _ = roller(fb.Circle((0, 0), 0.8, inside=True))
    solution = fb.simulate(
        scene, dt=0.02, t_end=6.0 if solver == "compiled" else 2.0, solver=solver
    )
    assert bounces(solution.contact(scene.obstacles[0]).gap.min(axis=1)) >= 2
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert np.ptp(solution.angular_momentum) < 1e-11
    assert np.ptp(solution.linear_momentum[:, 0]) > 1.0


def test_a_line_conserves_energy_and_the_momentum_along_it():
    along, normal = np.array([0.8, -0.6]), np.array([0.6, 0.8])
    scene, bar, wall = roller(fb.Line(-0.4 * normal, normal), velocity=(-1.0, -0.7))
    solution = fb.simulate(scene, dt=0.02, t_end=3.0)
    assert bounces(solution.contact(wall).gap.min(axis=1)) >= 1
    assert abs(solution.energy.balance_error).max() < 1e-11
    assert np.ptp(solution.linear_momentum @ along) < 1e-11
    assert np.ptp(solution.linear_momentum @ normal) > 1.0


# -- Restitution ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("e", "more"), [(0.9, 0.158), (0.5, 0.977), (0.2, 3.28)])
def test_restitution_returns_its_part_of_the_speed(e, more):
    # To order 4 in w / v: v1^2 = e^2 v^2 + more w^2, where `more` is an integral over tanh.
    v, w = 2.0, 0.04
    scene, node, floor = ball(0.02, 1e4, None, -v, e, w)
    solution = fb.simulate(scene, dt=1e-4, t_end=0.1)
    assert solution.velocity(node)[-1, 1] ** 2 == pytest.approx(
        (e * v) ** 2 + more * w**2, rel=2e-4
    )
    energy = solution.energy
    assert abs(energy.balance_error).max() < 1e-12
    assert np.diff(energy.dissipated).min() >= 0
    lost = (v**2 - solution.velocity(node)[-1, 1] ** 2) / 2
    assert energy.dissipated[-1] == pytest.approx(lost, rel=1e-11)


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_a_ball_with_restitution_comes_to_rest_where_the_floor_carries_its_weight(e):
    scene, node, floor = ball(0.05, 1e5, e=e, speed=0.01)
    solution = fb.simulate(scene, dt=1e-3, t_end=2.0)
    assert solution.contact(floor).gap[-1] == pytest.approx(-10.0 / 1e5, rel=1e-3)
    assert abs(solution.velocity(node)[-1]).max() < 1e-4
    assert np.diff(solution.energy.dissipated).min() >= 0
    assert solution.stats.halvings == 0


# -- Solvers, schemes, tangents -------------------------------------------------------------------


# -- Equilibria and small motions -----------------------------------------------------------------


@pytest.mark.parametrize("k", [1e3, 1e9])
def test_a_cantilever_on_an_obstacle_is_a_propped_one(k):
    scene, stop = cantilever(k)
    contact = fb.static(scene, steps=2).contact(stop)
    prop = 3 / 8 * 2.0 / (1 + 3 * 1e3 / (k * 2**3))  # of a prop with this stiffness
    assert contact.force[-1, 0] == pytest.approx([0.0, prop], rel=4e-4, abs=1e-12)
    assert contact.force[-1, 0, 1] == pytest.approx(-k * contact.gap[-1, 0], rel=1e-6)


def test_modes_have_the_stiffness_of_a_closed_contact_and_not_of_an_open_one():
    factor = 2 * math.pi * 2**2 / math.sqrt(1e3)
    for at, first in ((0.0, 15.418), (-1.0, 3.516)):
        scene, _ = cantilever(1e9, at=at, load=-1e-3, rhoA=1.0)
        found = fb.modes(scene, state=fb.static(scene, steps=1), n=1)
        assert factor * found.frequencies[0] == pytest.approx(first, rel=3e-3)


def test_a_closed_contact_with_a_loss_damps_small_motions():
    # At rest the viscosity is r F / w, with the force F of the contact.
    e, w, k = 0.5, 10.0, 1e4
    r = (1 - e**2) / (1 + e**2)
    scene = fb.Scene(gravity=(0, -10))
    bar = scene.add_beam([(0, 0), (1, 0)], STIFF)
    scene.add_mass(bar.start, 1.0)
    spring = fb.Spring(1e-6)  # a support for statics
    scene.add_joint(fb.Prismatic(fb.GROUND, bar.start, axis=(0, 1), spring=spring))
    scene.add_obstacle(bar.start, FLOOR, k, e, w)
    found = fb.modes(scene, state=fb.static(scene, steps=1), n=1)
    assert found.damping_ratios[0] == pytest.approx(r * 10.0 / w / (2 * math.sqrt(k)), rel=1e-4)


def test_a_ball_comes_to_rest_on_the_floor():
    scene, node, floor = ball(0.05)
    path = fb.static(scene, steps=2)
    assert path.position(node)[-1, 1] == pytest.approx(-10.0 / 1e6, rel=1e-9)
    assert path.contact(floor).force[-1, 0, 1] == pytest.approx(10.0, rel=1e-9)


# -- Runs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_stiffness_of_a_beam_is_shared_by_its_nodes(degree):
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (1, 0), (1, 2)], SOFT, elements=[1, 3], degree=degree)
    lengths = scene.add_obstacle(bar, FLOOR, 1.0).points.lengths
    assert len(lengths) == 4 * degree + 1
    assert lengths.sum() == pytest.approx(3.0)
    s = np.concatenate(
        [
            [0.0],
            *(
                a + (b - a) * np.arange(1, degree + 1) / degree
                for a, b in zip(bar.s[:-1], bar.s[1:], strict=True)
            ),
        ]
    )
    assert lengths @ s == pytest.approx(4.5)


def test_the_direction_of_a_line_is_kept_to_the_last_digit():
    for angle in np.linspace(0, 6, 200):
        line = fb.Line((1, 2), (3 * math.cos(angle), 3 * math.sin(angle)))
        assert fb.Line(line.point, line.normal) == line
        assert math.hypot(*line.normal) == pytest.approx(1, rel=1e-15)


# -- Refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda s, b: s.add_obstacle("bar", FLOOR, 1.0), "is not a node"),
        (lambda s, b: s.add_obstacle(ball()[1], FLOOR, 1.0), "another scene"),
        (lambda s, b: s.add_obstacle(b, (0, 1), 1.0), "fx_beam.Line"),
        (lambda s, b: s.add_obstacle(b, FLOOR, 0.0), "finite and positive"),
        (lambda s, b: s.add_obstacle(b, FLOOR, math.nan), "finite and positive"),
        (lambda s, b: s.add_obstacle(b, FLOOR, 1.0, 1.5), "from 0 to 1"),
        (lambda s, b: s.add_obstacle(b, FLOOR, 1.0, 0.5), "needs a speed"),
        (lambda s, b: s.add_obstacle(b, FLOOR, 1.0, 0.5, -1.0), "speed = -1.0"),
        (lambda s, b: s.add_obstacle(b, fb.Line((0, 0), (0, -1)), 1.0), "opposite normal"),
        (lambda s, b: s.add_obstacle(b, fb.Circle((0.5, 1), 0.6), 1.0), "starts 0.6 behind"),
        (lambda s, b: fb.Line((0, 0), (0, 0)), "no direction"),
        (lambda s, b: fb.Line((0, math.inf), (0, 1)), "not finite"),
        (lambda s, b: s.add_obstacle(b, fb.Circle(b.end, 1.0), 1.0), "belongs to what it should"),
        (lambda s, b: fb.Circle((0, 0), -1.0), "radius = -1.0"),
        (lambda s, b: fb.Circle((0, 0), 1.0, inside=2), "True or False"),
    ],
)
def test_bad_input_is_refused(wrong, words):
    scene = fb.Scene()
    bar = scene.add_beam([(0, 1), (1, 1)], SOFT, elements=2)
    with pytest.raises(fb.SceneError, match=words):
        wrong(scene, bar)
    assert scene.obstacles == []


def test_an_obstacle_of_another_scene_has_no_contact_here():
    scene, node, floor = ball()
    solution = fb.simulate(scene, dt=1e-3, t_end=2e-3)
    with pytest.raises(ValueError, match="not an obstacle"):
        solution.contact(FLOOR)
    with pytest.raises(ValueError, match="another scene"):
        solution.contact(roller(fb.Circle((0, 0), 2.0, inside=True))[2])
    assert solution.contact(floor).nodes.tolist() == [node.number]


# -- Pictures -------------------------------------------------------------------------------------


@pytest.mark.plot
def test_pictures_show_the_obstacles_that_are_near(tmp_path):
    from fx_beam.plot.obstacles import outlines

    scene, bar, _ = roller(fb.Circle((0, 0), 0.8, inside=True))
    for shape in (fb.Line((0, -0.4), (0, 1)), fb.Circle((0, -9), 9.0), fb.Line((0, -50), (0, 1))):
        scene.add_obstacle(bar, shape, 1e3)
    places, size = np.array([(-0.5, 0.3), (0.5, 0.2)]), 1.0
    ring, floor, hill = [line for line, *_ in outlines(scene.obstacles, places, size)]
    assert np.hypot(*ring.T) == pytest.approx(0.8)
    assert floor[:, 1] == pytest.approx(-0.4)
    assert np.ptp(floor[:, 0]) == pytest.approx(1.2)
    assert np.hypot(*(hill - (0, -9)).T) == pytest.approx(9.0)
    assert np.ptp(hill[:, 0]) < 1.5
    for line, strokes in outlines(scene.obstacles, places, size):
        starts, ends = np.moveaxis(strokes, 1, 0)
        shape = next(o.shape for o in scene.obstacles if abs(o.shape.gap(line)).max() < 1e-9)
        assert shape.gap(starts) == pytest.approx(0, abs=1e-3)
        assert (shape.gap(ends) < 0).all()
    drawn = fb.plot.scene(scene).axes[0].lines
    on_ring = [abs(np.hypot(*line.get_xydata().T) - 0.8) < 1e-9 for line in drawn]
    assert max(of.sum() for of in on_ring) >= len(ring)
    fb.plot.shapes(fb.simulate(scene, dt=0.01, t_end=0.1), [0, 10], tmp_path / "shapes.png")
    assert (tmp_path / "shapes.png").stat().st_size > 10_000


def test_a_shape_on_the_ground_or_on_a_body_is_refused_and_an_own_energy_is_shown():
    scene = fb.Scene()
    body = scene.add_body((1, 0), 1.0, 0.1)
    for carrier, words in ((fb.GROUND, "the ground"), (body, "Body")):
        with pytest.raises(
            fb.SceneError, match=f"Circle: centre = .*{words}.* a node that carries"
        ):
            fb.Circle(carrier, 0.1)
        with pytest.raises(fb.SceneError, match=f"Line: point = .*{words}.* a node that carries"):
            fb.Line(carrier, (0, 1))
    floor = fb.Line((0, -1), normal=(0, 1))
    own = scene.add_obstacle(body.centre, floor, energy=lambda d: 100 * d**2)
    assert repr(own) == f"<{own}, energy of its own>"
