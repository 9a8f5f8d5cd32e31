"""Public names that changed: the former ones still work, with a warning."""

import pytest

import fx_beam as fb


def test_former_names_of_the_package_give_the_new_ones():
    with pytest.warns(DeprecationWarning, match="fx_beam.Rates is now fx_beam.UpdateRule"):
        assert fb.Rates is fb.UpdateRule


def test_former_names_of_statistics_give_the_new_ones():
    stats = fb.Stats("Newmark", 1.0, "band", 3, inverted=2)
    with pytest.warns(DeprecationWarning, match="Stats.inside_out is now Stats.inverted"):
        assert stats.inside_out == 2


def test_former_names_of_parameters_are_taken():
    floor = fb.Line((0, 0), normal=(0, 1))
    with pytest.warns(DeprecationWarning, match="places is now positions"):
        assert floor.gap(places=(3.0, 2.0)) == 2.0


def test_former_names_of_solutions_give_the_new_ones():
    scene = fb.Scene(gravity=(0, -10.0))
    body = scene.add_body((0, -0.2), mass=3.0, inertia=0.48, points={"pin": (0, 0)})
    joint = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
    solution = fb.simulate(scene, dt=0.01, t_end=0.02)
    with pytest.warns(
        DeprecationWarning, match=r"joint_force is now Solution.joint\(joint\).force"
    ):
        assert (solution.joint_force(joint) == solution.joint(joint).force).all()
    with pytest.warns(DeprecationWarning, match="internal_of_beam is now Solution.internal"):
        assert solution.internal_of_beam == {}
    with pytest.raises(AttributeError, match="'Solution' object has no attribute 'joint_farce'"):
        solution.joint_farce  # noqa: B018
