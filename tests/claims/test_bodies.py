"""Rigid bodies: against equations in minimal coordinates, with beams, and in all analyses."""

import numpy as np
import pytest
from scenes import assert_refused, one_body
from scipy.integrate import solve_ivp

import fx_beam as fb

G = 9.81
LEG = fb.Section(EA=1e9, GA=1e4, EI=100.0)


def largest(values):
    return abs(np.asarray(values)).max()


def turned(psi, x):
    c, s = np.cos(psi), np.sin(psi)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])


# -- Alone -------------------------------------------------------------------------------------

HINGE, R1, R2 = np.array([1.0, 0.1]), np.array([0.5, 0.0]), np.array([0.2, 0.5])
MASSES, INERTIAS = (2.0, 1.0), (0.3, 0.1)


def double_pendulum():
    """Two bodies with centres beside the lines between their hinges, and no beam."""
    scene = fb.Scene(gravity=(0, -G))
    first = scene.add_body(R1, MASSES[0], INERTIAS[0], points={"O": (0, 0), "A": HINGE})
    second = scene.add_body(HINGE + R2, MASSES[1], INERTIAS[1], points={"A": HINGE})
    scene.add_joint(fb.Revolute(fb.GROUND, first["O"]))
    scene.add_joint(fb.Revolute(first["A"], second["A"]))
    return scene, (first, second)


def exact_rotations(t_end):
    """Rotations of the double pendulum by Lagrange's equations."""

    def perp(x):
        return np.array([-x[1], x[0]])

    def rates(_, y):
        arms = turned(y[0], R1), turned(y[0], HINGE), turned(y[1], R2)
        J1 = np.column_stack([perp(arms[0]), np.zeros(2)])
        J2 = np.column_stack([perp(arms[1]), perp(arms[2])])
        M = MASSES[0] * J1.T @ J1 + MASSES[1] * J2.T @ J2 + np.diag(INERTIAS)
        inward1, inward2 = arms[0] * y[2] ** 2, arms[1] * y[2] ** 2 + arms[2] * y[3] ** 2
        weight = np.array([0, -G])
        f = MASSES[0] * J1.T @ (weight + inward1) + MASSES[1] * J2.T @ (weight + inward2)
        return [*y[2:], *np.linalg.solve(M, f)]

    return solve_ivp(rates, (0, t_end), np.zeros(4), rtol=1e-11, atol=1e-11).y[:2, -1]


def test_a_double_pendulum_of_bodies_follows_lagranges_equations_with_order_two():
    exact, errors = exact_rotations(1.0), []
    for dt in (0.01, 0.005):
        scene, bodies = double_pendulum()
        solution = fb.simulate(scene, dt=dt, t_end=1.0)
        assert solution.stats.unknowns == 2 and solution.stats.compiled == []
        energy = solution.energy
        assert largest(energy.balance_error) < 1e-11 * energy.kinetic.max()
        errors.append(largest([solution.rotation(b.centre)[-1] for b in bodies] - exact))
    assert errors[1] < 1e-3
    assert 3.8 < errors[0] / errors[1] < 4.2


def test_the_velocity_of_a_body_is_that_of_its_centre():
    scene, body = one_body((1, 0), 1.0, 0.1, points={"A": (1, 2)})
    scene.set_velocity(body, (3.0, 1.0), spin=0.5)
    solution = fb.simulate(scene, dt=0.1, t_end=0.2)
    assert solution.velocity(body.centre)[0] == pytest.approx([3, 1])
    assert solution.velocity(body["A"])[0] == pytest.approx([2, 1])
    assert solution.position(body.centre)[-1] == pytest.approx([1.6, 0.2])


# -- With beams --------------------------------------------------------------------------------


def test_a_body_on_two_legs_sways_as_a_frame_with_a_rigid_girder():
    scene, body = one_body((0.5, 1.0), 2.0, 0.3, points={"L": (0, 1), "R": (1, 1)})
    for x, point in ((0.0, "L"), (1.0, "R")):
        scene.clamp(scene.add_beam([(x, 0), body[point]], LEG, elements=2, degree=3).start)
    shear = 1 + 12 * LEG.EI / LEG.GA
    stiffness = 24 * LEG.EI / shear
    assert fb.modes(scene).angular_frequencies[0] ** 2 == pytest.approx(stiffness / 2, rel=1e-5)


# -- Files, copies, pictures -------------------------------------------------------------------


@pytest.mark.plot
def test_bodies_are_drawn_without_any_beam(tmp_path):
    scene, _ = double_pendulum()
    ax = fb.plot.scene(scene).axes[0]
    assert {"body 1", "body 2"} <= {text.get_text() for text in ax.texts}
    solution = fb.simulate(scene, dt=0.01, t_end=0.2)
    solution.save(tmp_path / "run.npz")
    fb.plot.shapes(fb.load(tmp_path / "run.npz"), tmp_path / "a.png", rows=[0, 20])
    assert (tmp_path / "a.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="has none"):
        fb.plot.shapes(solution, tmp_path / "c.png", rows=[0], colour="M")
    with pytest.raises(ValueError, match="has no beams"):
        solution.to_paraview(tmp_path / "d.pvd")


# -- Refusals ----------------------------------------------------------------------------------


def test_points_of_other_scenes_and_unknown_names_are_refused():
    scene, (body, _) = double_pendulum()
    other = fb.Scene()
    with pytest.raises(fb.SceneError, match="point 'A': node 0 .* belongs to another scene"):
        other.add_body((0, 0), 1.0, points={"A": body.centre})
    with pytest.raises(fb.SceneError, match="body 1 has no point 'B'; it has .*'O', 'A'"):
        body["B"]
    assert_refused("body 1 belongs to another scene", other.set_velocity, body, (1, 0))
    assert_refused(r"is not a node; .* from a body: body.centre", scene.add_force, body, (1, 0))


def test_a_body_that_turns_without_inertia_and_virtual_works_without_beams_are_refused():
    scene, ball = one_body((0, 0), 1.0, name="ball")
    assert_refused("node 0 at .* of ball can rotate about", fb.simulate, scene, dt=0.1, t_end=1.0)
    scene.fix(ball.centre, "rotation")
    scene.add_virtual_work(lambda step: step.virtual_psi)
    assert_refused("the scene has none", fb.simulate, scene, dt=0.1, t_end=1.0)
