"""Laws of forces at points: tangents, forces of a user between points, of contact and friction."""

import copy
import pickle

import ufl

import numpy as np
import pytest
from scipy.integrate import quad

import fx_beam as fb
from fx_beam.fem import dolfinx_api, point_functions
from fx_beam.fem.compiled_laws import compiled_law
from fx_beam.mechanics import node_laws, scalar_laws
from fx_beam.mechanics.coordinates import ANGLE, DISTANCE, FROM_POINT, SLIDE
from fx_beam.mechanics.gaps import CIRCLE, LINE
from fx_beam.mechanics.point_laws import StepRule, arguments

SOLVERS = pytest.mark.parametrize("solver", ["compiled", "petsc"])
MID, END = StepRule(0.5, True, False), StepRule(1.0, False, False)
LAWS = [
    scalar_laws.spring(SLIDE, True),
    scalar_laws.spring(ANGLE, True),
    scalar_laws.spring(DISTANCE, True),
    scalar_laws.spring(FROM_POINT, False),
    scalar_laws.friction(ANGLE),
    scalar_laws.contact(LINE),
    scalar_laws.contact(CIRCLE),
    scalar_laws.contact(LINE, True),
    scalar_laws.contact(CIRCLE, True),
    scalar_laws.stop(ANGLE, 1),
    scalar_laws.stop(SLIDE, -1),
    node_laws.drag(True, False, False),
    node_laws.drag(False, True, True),
    node_laws.drag(True, True, False),
    node_laws.drag(False, False, True),
    node_laws.FOLLOWER,
]


@pytest.mark.parametrize("rule", [MID, END], ids=["mid-step", "end"])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_the_tangent_of_a_law_is_the_derivative_of_its_forces(law, rule):
    compiled, n, random = compiled_law(law, rule), law.size, np.random.default_rng(1)
    for _ in range(5):
        given = random.uniform(-1, 1, arguments(law))
        given[3 * n + 1] = 0.1  # the length of the step
        given[3 * n + 2 : 3 * n + 2 + law.remembered] = 0.0
        given[len(given) - law.numbers :] = abs(given[len(given) - law.numbers :])
        tangent, found = np.zeros((n, n)), compiled(given)
        tangent[tuple(compiled.entries.T)] = found[n : n + len(compiled.entries)]
        for k in range(n):
            more, less = (given.copy() for _ in range(2))
            more[n + k] += 1e-6
            less[n + k] -= 1e-6
            difference = (compiled(more)[:n] - compiled(less)[:n]) / 2e-6
            assert tangent[:, k] == pytest.approx(difference, abs=1e-7 * (1 + abs(tangent).max()))


def balls(distance=1.0, mass=2.0):
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), mass=mass, inertia=0.1) for x in (0, distance)]
    return scene, *(body.centre for body in bodies)


def thrown(distance=1.0):
    """Two balls that fly past each other."""
    scene, left, right = balls(distance)
    scene.set_velocity(left, (0.2, 0.3))
    scene.set_velocity(right, (-0.5, 0.1))
    return scene, left, right


# -- Between points -------------------------------------------------------------------------------


def repelled(dt):
    """Distance of two magnets with the energy c / r^2 that approach each other, and its error."""
    scene, left, right = balls(2.0)
    scene.add_force_between(left, right, spring=fb.Spring(strain_energy=lambda x: 3 / x**2))
    for node, v in ((left, 1.5), (right, -1.5)):
        scene.set_velocity(node, (v, 0.0))
    solution = fb.simulate(scene, dt=dt, t_end=2.0)
    r = np.hypot(*(solution.position(right) - solution.position(left)).T)
    # m r'^2 / 4 + c / r^2 = E, which r^2 = c / E + (4 E / m) (t - t0)^2 solves.
    E = 2.0 * 1.5**2 + 3 / 2.0**2
    turn = np.sqrt((4.0 - 3 / E) / (4 * E / 2.0))
    return solution, abs(r - np.sqrt(3 / E + (4 * E / 2.0) * (solution.t - turn) ** 2)).max()


def test_two_magnets_turn_back_as_the_closed_form_says_with_order_two():
    solution, coarse = repelled(0.02)
    _, fine = repelled(0.01)
    assert coarse / fine == pytest.approx(4, rel=0.15) and fine < 1e-3
    assert abs(solution.energy.balance_error).max() < 1e-12


@SOLVERS
def test_a_force_between_bodies_keeps_energy_and_both_momenta(solver):
    scene, left, right = thrown()
    scene.add_force_between(
        left, right, fb.Spring(30.0, 0.8, lambda x: 5 * x**4), stop=(0.7, 1.4, 1e4)
    )
    solution = fb.simulate(scene, dt=0.01, t_end=3.0, solver=solver)
    energy = solution.energy
    assert np.ptp(energy.springs) > 0.1
    assert np.ptp(energy.total) < 1e-12 * energy.total[0]
    assert np.ptp(solution.angular_momentum) < 1e-12
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-12


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(), fb.EnergyMomentum(order=4)])
def test_both_solvers_agree_on_forces_between_points(scheme):
    runs = []
    for solver in ("compiled", "petsc"):
        scene, left, right = thrown()
        scene.add_force_between(left, right, fb.Spring(30.0, 0.8), fb.Damper(0.3))
        scene.add_force_between(right, (1.0, 1.0), friction=fb.Friction(0.2, 0.05))
        scene.add_force_between(
            left, (0.0, -1.0), force=lambda r, rate, t: ufl.sin(3 * t) * r - rate
        )
        runs.append(fb.simulate(scene, scheme, dt=0.02, t_end=1.0, solver=solver))
    assert runs[0].q == pytest.approx(runs[1].q, abs=1e-11)
    for name in ("work", "dissipated", "springs"):
        one, other = (getattr(run.energy, name) for run in runs)
        assert one == pytest.approx(other, abs=1e-10) and abs(one).max() > 1e-3


def test_a_muscle_lifts_a_mass_as_its_law_says():
    # A pull F (1 - shortening rate / w): m v' = F (1 - v / w) - m g from rest.
    scene = fb.Scene(gravity=(0, -10))
    mass = scene.add_body((0, 0), mass=2.0, inertia=0.1).centre
    scene.add_force_between(mass, (0, 5), force=lambda r, rate, t: 30 * (1 + rate / 4))
    solution = fb.simulate(scene, dt=1e-3, t_end=1.0)
    t, rest = solution.t, 2.0 * 4 / 30
    speed = (30 - 20) * 4 / 30 * (1 - np.exp(-t / rest))
    assert solution.v[:, mass.number, 1] == pytest.approx(speed, abs=1e-6)
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.work[-1]


def test_a_rope_holds_a_pendulum_only_where_it_is_tight():
    scene = fb.Scene(gravity=(0, -10))
    mass = scene.add_body((1.0, 0), mass=1.0, inertia=0.1).centre
    scene.add_force_between(mass, (0, 0), stop=(None, 2.0, 1e6))
    solution = fb.simulate(scene, dt=1e-3, t_end=3.0)
    x, y = solution.position(mass).T
    falls = solution.t < 0.5
    assert y[falls] == pytest.approx(-5 * solution.t[falls] ** 2, abs=1e-5)
    assert 2.0 < np.hypot(x, y).max() < 2.02
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_a_mass_on_springs_hangs_and_vibrates_as_linear_theory_says():
    scene = fb.Scene(gravity=(0, -10))
    mass = scene.add_body((0, -1), mass=2.0, inertia=0.1).centre
    scene.fix(mass, "rotation")
    for x in (-1.0, 1.0):
        scene.add_force_between(mass, (x, 0.0), fb.Spring(400.0, rest=np.sqrt(2)))
    state = fb.static(scene)
    y = -state.position(mass)[-1, 1]
    r = np.hypot(1, y)
    pull = 400 * (r - np.sqrt(2))
    assert 2 * pull * y / r == pytest.approx(20.0, rel=1e-9)
    found = fb.modes(scene, state=state).frequencies
    # Along and across: k sin^2 + (F / r) cos^2 of each spring, and the same with both exchanged.
    c, s = 1 / r, y / r
    k = 2 * (400 * np.array([c**2, s**2]) + pull / r * np.array([s**2, c**2]))
    assert found == pytest.approx(np.sort(np.sqrt(k / 2.0)) / (2 * np.pi), rel=1e-6)


def test_a_damped_pair_has_the_eigenvalues_of_one_mass():
    scene, left, right = balls()
    for node in (left, right):
        scene.fix(node, "y", "rotation")
    scene.fix(left, "x")
    scene.add_force_between(left, right, fb.Spring(50.0, 1.0), fb.Damper(3.0))
    output = {"x": fb.Output("position", right)}
    found = np.linalg.eigvals(fb.linearise(scene, outputs=output).A)
    expected = np.roots([2.0, 3.0, 50.0])
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(expected), rel=1e-7)


def test_a_run_goes_on_and_copies_and_files_have_the_forces(tmp_path):
    def made():
        scene, left, right = thrown()
        scene.add_force_between(left, right, fb.Spring(30.0, 0.8), stop=(0.7, None, 1e4))
        return scene

    whole = fb.simulate(made(), dt=0.01, t_end=1.0)
    half = fb.simulate(made(), dt=0.01, t_end=0.5)
    rest = fb.simulate(made(), dt=0.01, t_end=1.0, start=half)
    assert rest.q[-1] == pytest.approx(whole.q[-1], abs=1e-12)
    for scene in (copy.copy(made()), pickle.loads(pickle.dumps(made()))):
        assert fb.simulate(scene, dt=0.01, t_end=1.0).q == pytest.approx(whole.q, abs=0)
        assert scene.forces_between[0].a.scene is scene
    whole.save(tmp_path / "run.npz")
    assert (fb.load(tmp_path / "run.npz").energy.springs == whole.energy.springs).all()


def test_a_wire_that_yields_keeps_its_length_in_statics():
    def flow(old, strains0, strains, dt):
        trial = 1e4 * (strains[0] - old[0]) - 100 * old[0]
        excess = ufl.max_value(abs(trial) - 30, 0)
        return [old[0] + ufl.sign(trial) * excess / (1e4 + 100)]

    energy = fb.Spring(
        rest=1.0,
        strain_energy=lambda x, a: 1e4 / 2 * (x - a[0]) ** 2 + 50 * a[0] ** 2,
        internal=fb.InternalVariables(("plastic",), flow),
    )
    scene = fb.Scene()
    ball = scene.add_body((1.0, 0), mass=1.0, inertia=1.0).centre
    scene.fix(ball, "y", "rotation")
    scene.add_force_between(ball, (0, 0), energy)
    scene.add_force(ball, (40.0, 0.0))
    # It yields at 30 N, then hardens by 100 N/m.
    assert fb.static(scene, steps=4).displacement(ball)[-1, 0] == pytest.approx(
        0.1 + 40 / 1e4, rel=1e-6
    )


# -- Contact and friction -------------------------------------------------------------------------


def hertz(dt, solver="compiled", **more):
    scene = fb.Scene()
    ball = scene.add_body((0, 0.01), mass=1.0, inertia=1.0).centre
    law = {"energy": lambda d: 0.4 * 1e6 * d**2.5} | more
    floor = scene.add_obstacle(ball, fb.Line((0, 0), normal=(0, 1)), **law)
    scene.set_velocity(ball, (0.0, -1.0))
    return fb.simulate(scene, dt=dt, t_end=0.05, solver=solver), floor


@SOLVERS
def test_a_hertzian_contact_has_the_depth_and_the_duration_of_the_closed_form(solver):
    # Force k d^1.5: depth (5 m v^2 / (4 k))^(2/5), and 2.9432 depth / v from touch to touch.
    solution, floor = hertz(2e-5, solver)
    gap, t = solution.contact(floor).gap[:, 0], solution.t
    depth = (5 / (4 * 1e6)) ** 0.4
    assert -gap.min() == pytest.approx(depth, rel=1e-5)
    touching = t[gap < 0]
    assert touching[-1] - touching[0] == pytest.approx(2.9432 * depth, abs=4e-5)
    assert np.ptp(solution.energy.total) < 1e-12


def test_a_contact_law_of_a_user_is_the_built_in_one_if_it_is_quadratic():
    own, linear = (
        hertz(1e-3, **more)[0]
        for more in ({"energy": lambda d: 1e6 / 2 * d**2}, {"energy": None, "stiffness": 1e6})
    )
    assert own.q == pytest.approx(linear.q, abs=1e-14)


def test_a_contact_law_with_restitution_returns_its_square_of_the_energy():
    solution, _ = hertz(2e-5, restitution=0.5, speed=1e-3)
    assert solution.energy.kinetic[-1] == pytest.approx(0.25 * 0.5, rel=1e-3)
    assert abs(solution.energy.balance_error).max() < 1e-12


@SOLVERS
def test_stribecks_friction_stops_a_block_where_its_integral_says(solver):
    scene = fb.Scene()
    block = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    law = fb.Friction(lambda rate: 1 + ufl.exp(-abs(rate) / 0.5), 0.005)
    rail = scene.add_joint(fb.Prismatic(fb.GROUND, block.start, axis=(1, 0), friction=law))
    scene.set_velocity(block, (2.0, 0.0))
    solution = fb.simulate(scene, dt=5e-3, t_end=2.5, solver=solver)
    stop, _ = quad(lambda v: v / (1 + np.exp(-v / 0.5)), 0, 2.0)
    assert solution.slide(rail)[-1] == pytest.approx(stop, rel=1e-3)
    assert solution.energy.dissipated[-1] == pytest.approx(2.0, rel=1e-6)
    assert abs(solution.energy.balance_error).max() < 1e-11


# -- Refusals -------------------------------------------------------------------------------------


def test_forces_that_make_no_sense_are_refused():
    scene, left, right = balls()
    floor = fb.Line((0, -1), normal=(0, 1))
    refused = (
        ("same place", lambda: scene.add_force_between(left, (0, 0), fb.Spring(1.0))),
        ("give a spring", lambda: scene.add_force_between(left, right)),
        ("a node or a fixed point", lambda: scene.add_force_between(left, 3.0, fb.Spring(1.0))),
        ("another scene", lambda: scene.add_force_between(left, balls()[1], fb.Spring(1.0))),
        ("upper limit", lambda: scene.add_force_between(left, right, stop=(None, 0.5, 1.0))),
        ("UFL", lambda: scene.add_force_between(left, right, force=lambda r, v, t: np.sin(r))),
        ("is nan", lambda: scene.add_force_between(left, right, force=lambda r, v, t: r / v)),
        ("either", lambda: scene.add_obstacle(left, floor)),
        ("either", lambda: scene.add_obstacle(left, floor, 1.0, energy=lambda d: d**2)),
        ("energy", lambda: scene.add_obstacle(left, floor, energy=lambda d: 1.0)),
        ("negative", lambda: fb.Friction(lambda rate: rate, 0.1)),
        ("UFL", lambda: fb.Friction(lambda rate: np.exp(rate), 0.1)),
    )
    for message, call in refused:
        with pytest.raises(fb.SceneError, match=message):
            call()
    assert not scene.forces_between and not scene.obstacles


def test_equal_parts_of_an_expression_become_one_object():
    x = ufl.Constant(dolfinx_api.domain(1), shape=(2,))

    def grown(times):
        y = x[0] + ufl.sqrt(x[1])
        for _ in range(times):
            y = y * ufl.sin(y)
        return y

    # Two trees of 2^40 leaves, which no comparison of their parts would end.
    one = point_functions._shared(ufl.as_vector([grown(40), grown(40)]))
    assert one.ufl_operands[0] is one.ufl_operands[1]
    assert point_functions._shared(one) is one
