"""Loads, masses and supports that are changed and taken away; statics that go on from a state."""

import copy

import ufl

import numpy as np
import pytest

import fx_beam as fb

L, EI = 2.0, 1e3
SECTION = fb.Section(EA=1e6, GA=1e7, EI=EI, rhoA=1.0, rhoI=1e-3)


def cantilever(elements=8):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (L, 0)], SECTION, elements=elements, degree=2)
    scene.clamp(beam.start)
    return scene, beam


# -- Changes of a scene ------------------------------------------------------------------------


def test_a_load_is_changed():
    scene, beam = cantilever()
    force, moment = scene.add_force(beam.end, (0.0, -1.0)), scene.add_moment(beam.end, 1.0)
    line = scene.add_line_load(beam, lambda s: (0.0, s), of="arc length")
    force = scene.change(force, (0.0, -2.0))
    scene.change(moment, lambda t: 3.0)
    scene.change(line, lambda s: (0.0, -s))
    other, same = cantilever()
    other.add_force(same.end, (0.0, -2.0))
    other.add_moment(same.end, 3.0)
    other.add_line_load(same, lambda s: (0.0, -s), of="arc length")
    assert (fb.static(scene).q[-1] == fb.static(other).q[-1]).all()
    scene.change(force, fb.Input("push"))
    assert fb.static(scene, inputs={"push": (0.0, -2.0)}).q[-1] == pytest.approx(
        fb.static(other).q[-1], abs=1e-15
    )


def test_all_that_was_added_is_taken_away_again():
    scene, beam = cantilever()
    reference = fb.simulate(scene, dt=0.01, t_end=0.1)
    parts = [
        scene.add_force(beam.end, (0.0, -1.0)),
        scene.add_force(beam.end, (0.0, -1.0)),
        scene.add_line_load(beam, (1.0, 0.0)),
        scene.add_mass(beam.end, 2.0),
        scene.add_mass(beam.end, 2.0),
        scene.add_drag(beam, linear=1.0),
        scene.add_virtual_work(lambda step: ufl.dot(step.v, step.virtual_u)),
        scene.add_force_between(beam.end, (0, 3), force=5.0),
    ]
    assert abs(fb.simulate(scene, dt=0.01, t_end=0.1).q).max() > 1e-6
    scene.remove(*parts)
    assert not any((scene.loads, scene.masses, scene.drags, scene.virtual_works))
    assert (fb.simulate(scene, dt=0.01, t_end=0.1).q == reference.q).all()
    scene.add_force_between(beam.end, (0, 3), force=7.0)


def test_a_support_is_taken_away():
    scene, beam = cantilever()
    scene.prescribe(beam.end, y=lambda t: 0.1 * t)
    scene.free(beam.end, "y")
    scene.free(beam.start)
    assert not scene.fixed and not scene.prescribed
    scene.pin(beam.start)
    with pytest.raises(
        fb.SceneError, match="free node 0.*'rotation' must be one that is supported"
    ):
        scene.free(beam.start, "rotation")
    with pytest.raises(fb.SceneError, match="free node 8"):
        scene.free(beam.end)


def test_what_belongs_to_another_scene_is_refused():
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, -1.0))
    other = copy.deepcopy(scene)
    for use in (other.remove, lambda load: other.change(load, (0, 0))):
        with pytest.raises(fb.SceneError, match="the scene does not have"):
            use(load)
    other.remove(other.loads[0])
    assert scene.loads == [load]
    with pytest.raises(fb.SceneError, match="the scene does not have"):
        scene.remove(other.beams[0])


@pytest.mark.parametrize("way", ["change", "remove", "free", "swap"])
def test_a_motion_notices_a_change(way):
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, -1.0))
    motion = fb.Motion(scene, dt=0.01)
    motion.step()
    if way == "change":
        scene.change(load, (0.0, -2.0))
    elif way == "free":
        scene.free(beam.start, "rotation")
    else:
        scene.remove(load)
        if way == "swap":
            scene.add_moment(beam.end, 1.0)
    with pytest.raises(fb.SceneError, match="removed from it or changed"):
        motion.step()


# -- Loads one after the other -----------------------------------------------------------------


def test_the_last_equilibrium_does_not_depend_on_the_order_of_loads():
    scene, beam = cantilever()
    pull = scene.add_force(beam.end, (400.0, 0.0), follower=True)
    first = fb.static(scene)
    scene.add_force(beam.end, (0.0, -200.0))
    both = fb.static(scene, start=first)
    assert both.q[0] == pytest.approx(first.q[-1], abs=1e-12)
    assert both.q[-1] == pytest.approx(fb.static(scene).q[-1], abs=1e-9)
    scene.remove(pull)
    released = fb.static(scene, start=both)
    assert released.q[-1] == pytest.approx(fb.static(scene).q[-1], abs=1e-9)


def test_a_string_under_prestress_sinks_by_its_tension():
    """Mid-span deflection P L / (4 T) of a string: prestressed by a pull, then loaded across."""
    scene = fb.Scene()
    section = fb.Section(EA=1e7, GA=1e6, EI=1e-3)
    string = scene.add_beam([(0, 0), (2, 0)], section, elements=32, degree=2)
    middle = string.node(0.5)
    scene.pin(string.start)
    scene.fix(string.end, "y")
    scene.add_force(string.end, (1e3, 0.0))
    taut = fb.static(scene)
    scene.add_force(middle, (0.0, -1.0))
    loaded = fb.static(scene, start=taut)
    sunk = loaded.displacement(middle)[-1, 1] - loaded.displacement(middle)[0, 1]
    assert sunk == pytest.approx(-1.0 * 2.0 / (4 * 1e3), rel=0.02)


def test_a_hinge_that_has_yielded_stays_bent_when_the_load_is_taken_away():
    def energy(x, a):
        return 1e4 / 2 * (x - a[0]) ** 2 + 10 / 2 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = 1e4 * (strains[0] - old[0]) - 10 * old[0]
        excess = ufl.max_value(abs(trial) - 3, 0)
        return [old[0] + ufl.sign(trial) * excess / (1e4 + 10)]

    hinge = fb.Spring(strain_energy=energy, internal=fb.InternalVariables(("plastic angle",), flow))
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e9, GA=1e9, EI=1e9))
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, spring=hinge))
    moment = scene.add_moment(arm.end, 4.0)
    bent = fb.static(scene, steps=4)
    assert bent.joint(joint).angle[-1] == pytest.approx(0.1 + 4e-4 - 1e-4, abs=1e-4)
    scene.remove(moment)
    free = fb.static(scene, start=bent, steps=4)
    assert free.joint(joint).angle[-1] == pytest.approx(0.1, abs=1e-6)
    assert free.joint(joint).internal("plastic angle")[-1] == pytest.approx(0.1, abs=1e-9)


def test_a_new_support_holds_a_node_where_it_is():
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, -10.0))
    bent = fb.static(scene)
    scene.fix(beam.end, "y")
    scene.remove(load)
    held = fb.static(scene, start=bent)
    assert held.displacement(beam.end)[:, 1] == pytest.approx(bent.displacement(beam.end)[-1, 1])
    assert held.reaction(beam.end)[:, 1] == pytest.approx(-10.0, rel=1e-6)


def test_driven_motions_go_on_from_where_they_are():
    scene, beam = cantilever()
    scene.prescribe(beam.end, y=lambda t: 0.1 * t)
    first = fb.static(scene, t=1.0)
    second = fb.static(scene, t=3.0, start=first, steps=4)
    assert second.displacement(beam.end)[:, 1] == pytest.approx([0.1, 0.15, 0.2, 0.25, 0.3])


def test_arc_length_goes_on_from_a_prestressed_state():
    """A shallow arch, prestressed by heat-like thrust, snaps through: both ways end alike."""
    arch = fb.Scene()
    section = fb.Section(EA=1e5, GA=5e4, EI=1.0)
    beam = arch.add_beam([(0, 0), (1, 0.05), (2, 0)], section, elements=[4, 4], degree=2)
    arch.pin(beam.start)
    arch.fix(beam.end, "y")
    arch.add_force(beam.end, (-5.0, 0.0))
    first = fb.static(arch)
    arch.fix(beam.end, "x")
    arch.add_force(beam.node(0.5), (0.0, -40.0))
    path = fb.static(arch, start=first, continuation="arc-length")
    assert path.load_factor[-1] == pytest.approx(1.0)
    again = fb.static(arch, start=path)
    assert abs(again.q - path.q[-1]).max() < 1e-8
    assert abs(path.energy.balance_error).max() < 0.02 * abs(path.energy.work).max()


def test_a_motion_starts_from_the_end_of_a_sequence():
    scene, beam = cantilever()
    scene.add_force(beam.end, (500.0, 0.0))
    first = fb.static(scene)
    across = scene.add_force(beam.end, (0.0, -100.0))
    bent = fb.static(scene, start=first)
    still = fb.simulate(scene, dt=1e-3, t_end=0.05, start=bent)
    assert abs(still.q - bent.q[-1]).max() < 1e-9
    scene.remove(across)
    swing = fb.simulate(scene, dt=1e-3, t_end=0.05, start=bent)
    assert abs(swing.q[-1] - bent.q[-1]).max() > 1e-3


def test_a_start_that_does_not_fit_is_refused():
    scene, beam = cantilever()
    other, _ = cantilever(elements=4)
    with pytest.raises(fb.SceneError, match="start: the solution has other nodes"):
        fb.static(scene, start=fb.static(other))
    with pytest.raises(fb.SceneError, match="start must be a Solution"):
        fb.static(scene, start=scene)
    scene.add_force(beam.end, (0.0, -1.0))
    with pytest.raises(fb.SceneError, match="start with a spin"):
        fb.static(scene, start=fb.static(scene), spin=1.0)
    assert np.isfinite(fb.static(scene).q).all()
