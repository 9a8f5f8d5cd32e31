"""Gaps and forces of contacts as outputs of motions."""

import numpy as np
import pytest
from scenes import assert_refused, held_body, one_bar

import fx_beam as fb


def ball(shape=None, **options):
    """A ball of 2 kg and a radius of 0.2 m above a floor."""
    scene, centre = held_body((0.0, 1.2), mass=2.0, inertia=0.1, gravity=(0.0, -10.0))
    floor = shape or fb.Line((0, 0), normal=(0, 1))
    contact = scene.add_contact(centre, floor, stiffness=1e4, radius=0.2, **options)
    outputs = {"gap": fb.Output("gap", contact), "force": fb.Output("force", contact)}
    return scene, contact, outputs


@pytest.mark.parametrize("dt", [0.01, 0.033])
def test_a_fall_ends_where_the_gap_closes(dt):
    """After sqrt(2 h / g), for a free height h = 1 m."""
    scene, contact, outputs = ball()
    fall = fb.simulate(scene, dt=dt, t_end=3.0, outputs=outputs, until=lambda t, y: y["gap"])
    assert fall.t[-1] == pytest.approx(np.sqrt(0.2), abs=1e-12)
    assert fall.contact(contact).gap[-1, 0] == pytest.approx(0.0, abs=1e-11)


def test_a_motion_ends_where_a_contact_pushes_hard():
    scene, contact, outputs = ball()
    until = {"outputs": outputs, "until": lambda t, y: y["force"][1] - 100.0}
    fall = fb.simulate(scene, dt=1e-3, t_end=3.0, **until)
    assert fall.t[-1] > np.sqrt(0.2)
    assert -1e4 * fall.contact(contact).gap[-1].min() == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize("kind", ["line", "moving circle", "member"])
def test_outputs_are_those_of_the_solution(kind):
    section = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=2.0, rhoI=1e-4)
    scene, beam = one_bar([(-1, 0.05), (1, 0.1)], section, elements=6, gravity=(0.0, -10.0))
    if kind == "line":
        shape = fb.Line((0, 0), normal=(0, 1))
        contacts = [scene.add_contact(beam, shape, stiffness=3e4, along=2)]
    else:
        support = scene.add_body((0.1, -0.4), mass=1.0, inertia=0.1, name="support").centre
        scene.clamp(support)
        shape = fb.Circle(support, 0.4)
        contacts = [scene.add_contact(beam, shape, stiffness=3e4)]
    if kind == "member":
        load = scene.add_body((0.0, 0.2), mass=1.0, inertia=0.1).centre
        scene.add_contact(load, beam, stiffness=1e4, radius=0.02)
        contacts.append(scene.contacts[-1])
    outputs = {}
    for i, contact in enumerate(contacts):
        names = {"gap": None, "force": None, "y": "y"}
        for name, component in names.items():
            quantity = "gap" if name == "gap" else "force"
            outputs[f"{name} {i}"] = fb.Output(quantity, contact, component)
    motion = fb.Motion(scene, dt=2e-3, outputs=outputs, record=fb.Record())
    rows = [motion.step() for _ in range(150)]
    solution = motion.solution()
    for i, contact in enumerate(contacts):
        known = solution.contact(contact)
        force = known.force.sum(axis=1)[1:]
        assert force[:, 1].max() > 5.0
        assert [row[f"force {i}"] for row in rows] == pytest.approx(force, abs=1e-12)
        assert [row[f"y {i}"] for row in rows] == pytest.approx(force[:, 1], abs=1e-12)
        gap = known.gap.min(axis=1)[1:]
        assert [row[f"gap {i}"] for row in rows] == pytest.approx(gap, abs=1e-14)


def test_outputs_of_contacts_have_no_derivatives_and_say_so():
    scene, contact, outputs = ball()
    with pytest.raises(fb.SceneError, match="of contacts have no derivatives"):
        fb.Response(lambda x: (scene, outputs), dt=0.1, t_end=1.0)([1.0])
    assert_refused("of contacts have no derivatives", fb.linearise, scene, outputs=outputs)
    other = ball(fb.Circle((0, -1), 1.0))[1]
    with pytest.raises(fb.SceneError, match="add_contact of this scene returned"):
        fb.Motion(scene, dt=0.1, outputs={"gap": fb.Output("gap", other)})
