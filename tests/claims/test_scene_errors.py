"""What is accepted at the edge of what is refused, and what a refusal leaves as it was.

The table of what is refused is `tests/core/test_refusals.py`.
"""

import copy
import math
import pickle
from fractions import Fraction

import ufl

import numpy as np
import pytest
from jointed import MEMBER as SECTION
from scenes import assert_refused, clamped_bar

import fx_beam as fb
from fx_beam_studies import stability, work_precision

MASSLESS = fb.Section(EA=1e4, GA=1e4, EI=100.0)


def small_scene(section=SECTION, **options):
    """One beam of two elements from (0, 0) to (2, 0), free and without loads."""
    scene = fb.Scene(**options)
    return scene, scene.add_beam([(0, 0), (2, 0)], section, elements=2, name="arm")


def run(scene, dt=0.1, t_end=0.1, **options):
    return fb.simulate(scene, None, dt=dt, t_end=t_end, **options)


# -- Accepted --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "energy",
    [
        lambda e, g, k: e**2 + g**2 - k**2 + k**4,  # two wells: it snaps
        lambda e, g, k: e**2 + g**2 + abs(k) ** 1.5,
        lambda e, g, k: (1 + e) * ufl.ln(1 + e) - e + g**2 + ufl.sqrt(1 + k**2),
    ],
)
def test_strain_energies_that_are_not_convex_everywhere_are_accepted(energy):
    assert fb.Section(strain_energy=energy).strain_energy is energy


def test_what_fits_up_to_rounding_is_accepted():
    scene, beam = small_scene()
    scene.prescribe(beam.start, y=lambda t: math.sin(t + math.pi))  # 0 at the start
    assert run(scene).displacement(beam.start)[1, 1] == pytest.approx(-math.sin(0.1), abs=1e-14)
    scene, beam = small_scene()
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.set_velocity(beam, lambda x, y: (0.0, math.sin(math.pi * x / 2)))  # 0 at both pins
    assert run(scene).velocity(beam.end)[0] == pytest.approx([0, 0], abs=1e-15)
    assert 0.3 - 0.2 < 0.1  # a step
    assert list(run(scene, dt=0.1, t_end=0.3 - 0.2).t) == [0.0, 0.3 - 0.2]


def test_initial_velocities_agree_at_a_shared_node_or_are_refused():
    scene, beam = small_scene()
    leg = scene.add_beam([beam.end, (2, 3)], SECTION, elements=1)
    scene.set_velocity(beam, lambda x, y: (-y, x), spin=1.0)
    scene.set_velocity(leg, lambda x, y: (-y, x), spin=1.0)
    assert run(scene).velocity(leg.end)[0] == pytest.approx([-3, 2], abs=1e-15)
    scene.set_velocity(leg, (0.0, 1.0))
    assert_refused(r"two initial velocities at \(2, 0\)", run, scene)


@pytest.mark.parametrize(
    ("supports", "mass", "inertia"),
    [
        ([("start", "x", "y")], 1.0, 0.0),
        ([("start", "x", "y")], 0.0, 1.0),
        ([], 1.0, 1.0),
        ([("start", "x", "y"), ("end", "y")], None, None),
        ([("start", "x", "y"), ("end", "rotation")], None, None),
        ([("start", "y"), ("end", "y")], 1e-9, 0.0),
    ],
    ids=["pendulum", "tip inertia", "free tip body", "roller", "clamp apart", "light slider"],
)
def test_massless_beams_that_mass_or_supports_hold_are_accepted(supports, mass, inertia):
    scene, beam = small_scene(MASSLESS)
    for node, *components in supports:
        scene.fix(getattr(beam, node), *components)
    if mass is not None:
        scene.add_mass(beam.end, mass, inertia)
    scene.add_force(beam.node(0.5), (0.0, 1e-12))
    assert np.isfinite(run(scene).q).all()


def test_defaults_and_numbers_of_all_kinds_are_taken_as_they_are():
    scene, _ = small_scene()
    newton = fb.NewtonOptions(tolerance=np.float32(1e-6), max_iterations=np.int64(9), max_turn=3)
    computed = run(scene, dt=Fraction(1, 4), t_end=np.float32(0.5), newton=newton)
    assert computed.t.tolist() == [0.0, 0.25, 0.5] and computed.stats.scheme == "EnergyMomentum"
    assert fb.Record(every=np.int64(2), motion=np.True_, rates=np.False_).every == 2
    assert fb.HHT(-1 / 3).rates.beta == pytest.approx((4 / 3) ** 2 / 4, abs=1e-15)
    level = fb.InternalVariables(("a",), lambda old, *rest: old, level=np.float32(1)).level
    assert type(level) is float and level == 1


# -- Refused ---------------------------------------------------------------------------------


def test_a_refused_beam_leaves_the_scene_as_it_was():
    scene, beam = small_scene()
    for points in ([beam.end, (3, 0), (3, 0)], lambda f: (f, float(f > 0.5))):
        assert_refused("coincide|jumps", scene.add_beam, points, SECTION, elements=2)
    assert scene.beams == [beam] and len(scene.nodes) == 3


def test_a_joint_is_added_once_also_to_a_copy():
    scene, beam = small_scene()
    other = scene.add_beam([(2, 0), (3, 0)], SECTION, elements=1)
    scene.add_joint(fb.Revolute(beam.end, other.start))
    copied = copy.copy(scene)
    with pytest.raises(fb.SceneError, match="Add each joint once"):
        copied.add_joint(fb.Revolute(copied.beams[0].end, copied.beams[1].start))
    # Two slots for one pin are another thing than one slot twice.
    for axis in ((1, 0), (0, 1)):
        scene.add_joint(fb.PinInSlot(fb.GROUND, other.end, axis))


@pytest.mark.parametrize(
    ("pinned", "reason"), [(True, "a node turns"), (False, "the tangent is singular")]
)
def test_a_mechanism_that_a_virtual_work_does_not_hold_fails_in_its_first_step(pinned, reason):
    scene, beam = small_scene(MASSLESS)
    if pinned:
        scene.pin(beam.start)
    scene.add_virtual_work(lambda step: 2.0 * step.virtual_psi, beam)
    with pytest.raises(fb.StepError, match=f"the step from t = 0 to .* failed.*{reason}") as caught:
        run(scene)
    assert caught.value.time == 0
    assert list(caught.value.solution.t) == [0]


def test_a_function_that_simulates_its_own_scene_is_stopped():
    scene, beam = small_scene()

    def force(t):
        return run(scene).velocity(beam.end)[-1] if scene.loads else (0.0, 0.0)

    scene.add_force(beam.end, force)
    with pytest.raises(fb.StepError, match="^force on node 2 .* runs an analysis of the scene to"):
        run(scene)


@pytest.mark.exact_times
@pytest.mark.parametrize("kind", ["force", "moment", "line load", "prescribed y"])
def test_a_function_of_time_that_fails_later_ends_the_run_there(kind):
    def scene_with(fails_after):
        def function(t):
            value = 0.3 * t if t <= fails_after else math.nan
            return value if kind in ("moment", "prescribed y") else (value, value)

        scene, beam = small_scene()
        scene.clamp(beam.start)
        {
            "force": lambda: scene.add_force(beam.end, function),
            "moment": lambda: scene.add_moment(beam.end, function),
            "line load": lambda: scene.add_line_load(beam, function),
            "prescribed y": lambda: scene.prescribe(beam.end, y=function),
        }[kind]()
        return scene

    with pytest.raises(fb.StepError, match=f"{kind} o[nf] .* t = 0.4.*not finite") as caught:
        run(scene_with(0.35), t_end=1.0)
    error = caught.value
    assert error.time == pytest.approx(0.4, abs=1e-6)
    # The steps before it are kept, and are those of a run that does not fail.
    whole = run(scene_with(math.inf), t_end=1.0)
    assert error.solution.t == pytest.approx([0.0, 0.1, 0.2, 0.3], abs=1e-15)
    assert error.solution.stats.steps == 3
    for name in ("q", "v", "a", "reactions", "linear_momentum", "angular_momentum"):
        np.testing.assert_array_equal(getattr(error.solution, name), getattr(whole, name)[:4])
    np.testing.assert_array_equal(error.solution.energy.total, whole.energy.total[:4])


OTHER_NAMES = {
    "package": [("linearize", "'linearise'"), ("Hinge", "Revolute"), ("solve", r"fb\.static")],
    "scene": [
        *(("add_torque", "add_moment"), ("add_bodys", "'add_body'"), ("solve", r"fb\.static")),
        ("add_element", r"scene\.add_beam"),
    ],
    "solution": [
        *(("plot", r"fb\.plot\.shapes"), ("time", r"solution\.t$"), ("rotations", "'rotation'")),
        ("stresses", r"solution\.stress\(beam\)"),
    ],
    "node": [("position", r"node\.x"), ("clamp", r"scene\.clamp")],
    "beam": [("middle", r"beam\.node"), ("lenght", "'length'"), ("EI", r"beam\.section")],
    "resultants": [("V", r"resultants\.Q"), ("bending_moment", r"resultants\.M")],
    "section": [("E", "EA"), ("density", "rhoA")],
}


@pytest.mark.parametrize(
    ("kind", "name", "real"), [(kind, *pair) for kind, xs in OTHER_NAMES.items() for pair in xs]
)
def test_names_of_other_programs_are_answered_by_ours(kind, name, real):
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    parts = {"package": fb, "scene": scene, "node": beam.end, "beam": beam, "section": beam.section}
    if kind in ("solution", "resultants"):
        parts["solution"] = fb.static(scene)
        parts["resultants"] = parts["solution"].resultants(beam)
    thing = parts[kind]
    assert_refused(f"no attribute '{name}'.*{real}", getattr, thing, name, error=AttributeError)
    assert not hasattr(thing, name)


@pytest.mark.parametrize("name", ["add_axle", "elements_of", "zzz"])
def test_a_name_that_is_like_none_of_ours_has_no_guess(name):
    with pytest.raises(AttributeError) as caught:
        getattr(fb.Scene(), name)
    assert str(caught.value).endswith(f"no attribute '{name}'")


@pytest.mark.parametrize(
    ("call", "name", "real"),
    [
        (lambda scene: fb.simulate(scene, dt=0.1, t_end=1.0, t_eval=[0.5]), "t_eval", "record$"),
        (lambda scene: fb.static(scene, load_step=3), "load_step", "'load_steps'"),
        (lambda scene: fb.modes(scene, num_modes=3), "num_modes", "Use n$"),
        (lambda scene: fb.Motion(scene, dt=0.1, t_eval=[0.5]), "t_eval", "Use dt and record$"),
        (lambda scene: fb.Scene(gravitiy=(0, -9.81)), "gravitiy", "'gravity'"),
        (lambda scene: fb.Spring(k=5.0), "k", "Use stiffness$"),
        (lambda scene: scene.add_beam([(0, 0)], None, n_elements=3), "n_elements", "Use elements$"),
        (lambda scene: fb.static(scene).resultants("beam 1").at(0, sides=1), "sides", "'side'"),
        (lambda scene: fb.static(scene).to_csv(filename="a.csv"), "filename", "Use path$"),
    ],
)
def test_keywords_of_other_programs_are_answered_by_ours(call, name, real):
    scene, _ = clamped_bar((1, 0), fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    assert_refused(f"argument '{name}'.*{real}", call, scene, error=TypeError)


def test_keywords_of_other_programs_of_sections_are_answered_by_ours():
    assert_refused("'density'. Use rho", fb.Section.rectangle, 0.1, 0.1, E=1.0, density=1.0)


@pytest.mark.plot
def test_keywords_of_other_programs_of_pictures_are_answered_by_ours():
    assert_refused("'color'.*'colour'", fb.plot.shapes, None, "x.png", color="M", error=TypeError)


@pytest.mark.parametrize(
    ("called", "name", "real"),
    [
        (work_precision.study, "timestep", "Use dt$"),
        (work_precision.Mesh, "n_elements", "Use elements$"),
        (stability.study, "repeat", "'repeats'"),
        (stability.Case, "duration", "Use t_end$"),
        (fb.materials.Material, "density", "Use rho$"),
    ],
)
def test_keywords_of_other_programs_of_studies_and_materials_are_answered_by_ours(
    called, name, real
):
    assert_refused(f"argument '{name}'.*{real}", lambda: called(**{name: 1}), error=TypeError)


@pytest.mark.plot
def test_functions_with_hints_are_pickled_by_name():
    for function in (fb.simulate, fb.modes, fb.plot.shapes, stability.study):
        assert pickle.loads(pickle.dumps(function)) is function
