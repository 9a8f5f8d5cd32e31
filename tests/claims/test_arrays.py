"""Arrays belong to one side: what a caller changes later changes neither a scene nor a solution."""

import numpy as np
import pytest
from jointed import MEMBER

import fx_beam as fb


def scene_of(array):
    """Everything of a scene that can be given as an array, made by `array`."""
    scene = fb.Scene(gravity=array((0.0, -9.81)))
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    corners = array([(0.0, 0.0), (1.0, 0.0)])
    first = scene.add_beam(corners, section, elements=array([2]), name="first")
    arc = fb.arc(array((1.2, 0.1)), array((1.5, 0.3)), array((2.0, 0.1)))
    second = scene.add_beam(arc, section, elements=2)
    spline = fb.spline(array([(2.0, 0.1), (2.5, 0.3), (3.0, 0.0)]))
    third = scene.add_beam(spline, section, elements=2)
    bend = fb.Curve(lambda x: (3 + x, abs(x - 0.5)), breaks=array([0.5]))
    scene.add_beam(bend, section, elements=2)
    scene.pin(first.start)
    scene.add_joint(fb.Revolute(first.end, second.start, offset=array((0.2, 0.1))))
    spring, damper = fb.Spring(30.0, rest=0.1), fb.Damper(2.0)
    axis = array((2.0, 1.0))
    scene.add_joint(fb.PinInSlot(second.end, third.start, axis, array((0.0, 0.0)), spring, damper))
    scene.add_force(first.end, array((1.0, 2.0)))
    scene.add_force(second.end, array((1.0, 2.0)), follower=True)
    scene.add_moment(first.end, array(0.5))
    scene.add_line_load(third, array((0.0, -1.0)))
    scene.add_mass(third.end, array(0.5), inertia=array(0.1))
    scene.set_velocity(third, array((0.1, 0.2)), spin=array(0.3))
    scene.make_velocities_compatible()
    return scene


def test_arrays_given_to_a_scene_may_be_used_again():
    made = []

    def array(values):
        made.append(np.array(values))
        return made[-1]

    scene = scene_of(array)
    for values in made:
        values[...] = 0
    run = {"scheme": fb.Newmark(), "dt": 0.01, "t_end": 0.1}
    assert (fb.simulate(scene, **run).q == fb.simulate(scene_of(np.array), **run).q).all()


def fresh(values):
    return values


def filled(kind):
    """Functions that fill one array, or list, of their own and return it."""

    def make(function):
        own = np.empty(np.shape(function(0.0)))
        own = own.tolist() if kind == "list" and own.shape else own

        def call(*arguments):
            own[...] = function(*arguments)
            return own

        def call_list(*arguments):
            own[:] = function(*arguments)
            return own

        return call_list if isinstance(own, list) else call

    return make


def moving(made):
    """A scene of which everything moves by functions that `made` makes."""
    scene = fb.Scene()
    first = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
    second = scene.add_beam([(1, 0), (2, 0)], MEMBER, elements=2)
    third = scene.add_beam([(1, 0), (1, 1)], MEMBER, elements=2)
    scene.prescribe(first.start, x=made(lambda t: 0.1 * t**2), y=made(lambda t: -0.1 * t**2))
    scene.add_joint(fb.Revolute(first.end, second.start, motor=made(lambda t: np.sin(t) ** 2)))
    scene.add_joint(fb.Revolute(first.end, third.start))
    scene.add_force(second.end, made(lambda t: (3 * np.sin(9 * t), t)))
    scene.add_force(third.end, made(lambda t: (2 * np.cos(9 * t), t)), follower=True)
    scene.add_moment(third.end, made(lambda t: np.sin(20 * t)))
    scene.add_line_load(second, made(lambda t: (0.0, np.sin(20 * t))))
    return scene


@pytest.mark.parametrize("kind", ["array", "list"])
def test_a_function_of_time_may_fill_and_return_its_own_array(kind):
    run = {"dt": 0.01, "t_end": 0.3}
    expected = fb.simulate(moving(fresh), **run)
    solution = fb.simulate(moving(filled(kind)), **run)
    assert (solution.q == expected.q).all()
    assert (solution.energy.work == expected.energy.work).all()
    assert np.ptp(expected.displacement(expected.beams["beam 2"].end)[:, 1]) > 0.05


def test_functions_of_place_may_fill_and_return_their_own_array():
    def build(made):
        scene = fb.Scene()
        bow = made(lambda x: (2 * x, np.sin(2 * x)))
        taper = made(lambda x: 1e4 * (2 - x))
        section = fb.Section(EA=taper, GA=1e4, EI=100.0, rhoA=made(lambda x: 2 - x), rhoI=0.1)
        beam = scene.add_beam(bow, section, elements=4, degree=2)
        scene.set_velocity(beam, made(lambda x, y=0: (-y, x)), made(lambda x, y=0: x + y))
        return scene

    run = {"dt": 0.01, "t_end": 0.1}
    expected = fb.simulate(build(fresh), **run)
    solution = fb.simulate(build(filled("array")), **run)
    assert (solution.X == expected.X).all() and np.ptp(expected.X[:, 0]) == pytest.approx(2.0)
    assert (solution.v == expected.v).all() and np.ptp(expected.v[0, :, 2]) > 0.5
    assert (solution.q == expected.q).all()


ARRAYS = "t", "t_level", "X", "q", "v", "a", "reactions", "slides", "joint_forces"
MOMENTA = "linear_momentum", "angular_momentum"


@pytest.mark.parametrize("loaded", [False, True])
def test_what_a_solution_hands_out_cannot_be_changed(loaded, tmp_path):
    scene = moving(fresh)
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    if loaded:
        solution.save(tmp_path / "run.npz")
        solution = fb.load(tmp_path / "run.npz")
    before = solution.resultants("beam 2").M.copy()
    handed = [getattr(solution, name) for name in (*ARRAYS, *MOMENTA)]
    handed += [solution.energy.kinetic, solution.energy.work, solution.resultants("beam 2").M]
    handed += solution.nodes_of_beam.values()
    node = solution.beams["beam 1"].end
    handed += [solution.displacement(node), solution.rotation(node), solution.velocity(node)]
    for values in handed:
        with pytest.raises(ValueError, match="read-only"):
            values[...] = 0
    solution.position(node)[:] = 0  # which is made anew
    solution.energy.total[:] = 0
    assert (solution.resultants("beam 2").M == before).all()


def test_the_geometry_of_a_scene_cannot_be_changed():
    scene = scene_of(np.array)
    joint = scene.joints[1]
    for values in (scene.gravity, scene.beams[0].s, scene.beams[1].s, joint.axis, joint.offset):
        with pytest.raises(ValueError, match="read-only"):
            values[...] = 1
