"""What cannot be right is refused where it is given, or before a run starts, by its name."""

import math
import re
import signal

import ufl

import numpy as np
import pytest

import fx_beam as fb

STIFFNESS = {"EA": 1e4, "GA": 1e4, "EI": 100.0}
MASSLESS = fb.Section(**STIFFNESS)
SECTION = fb.Section(**STIFFNESS, rhoA=1.0, rhoI=0.1)


def small_scene(section=SECTION, **options):
    """One beam of two elements from (0, 0) to (2, 0), free and without loads."""
    scene = fb.Scene(**options)
    return scene, scene.add_beam([(0, 0), (2, 0)], section, elements=2, name="arm")


def run(scene, scheme=None, dt=0.1, t_end=0.1, **options):
    return fb.simulate(scene, scheme, dt=dt, t_end=t_end, **options)


def refused(match):
    return pytest.raises(fb.SceneError, match=match)


def failing(value):
    raise KeyError("no such table")


def test_a_scene_error_is_a_value_error_and_a_step_error_a_runtime_error():
    assert issubclass(fb.SceneError, ValueError)
    assert issubclass(fb.StepError, RuntimeError)


# -- Sections --------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [-1.0, 0.0, math.nan, math.inf, "stiff"])
@pytest.mark.parametrize("name", ["EA", "GA", "EI"])
def test_a_stiffness_that_is_not_positive_and_finite_is_refused(name, value):
    with refused(f"Section: {name} = .*positive and finite"):
        fb.Section(**STIFFNESS | {name: value})


@pytest.mark.parametrize("name", ["EA", "GA", "EI"])
def test_a_missing_stiffness_is_refused(name):
    with refused(f"{name} is missing"):
        fb.Section(**STIFFNESS | {name: None})


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf, None])
@pytest.mark.parametrize("name", ["rhoA", "rhoI"])
def test_a_density_that_is_negative_or_not_finite_is_refused(name, value):
    with refused(f"Section: {name} = .*zero or positive and finite"):
        fb.Section(**STIFFNESS, **{name: value})


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"height": 0.0}, "height"),
        ({"width": -1.0}, "width"),
        ({"E": math.nan}, "E"),
        ({"nu": 0.6}, "nu"),
        ({"nu": -1.0}, "nu"),
        ({"rho": -1.0}, "rho"),
        ({"shear_factor": 0.0}, "shear_factor"),
    ],
)
def test_an_invalid_rectangle_is_refused(changed, name):
    with refused(f"Section: {name}"):
        fb.Section.rectangle(**{"height": 0.1, "width": 0.1, "E": 1e9} | changed)


def test_a_circle_without_diameter_is_refused():
    with refused("diameter = 0"):
        fb.Section.circle(diameter=0, E=1e9)


@pytest.mark.parametrize(
    "energy",
    [
        lambda eps, gamma, kappa: np.sqrt(1 + eps**2) + gamma**2 + kappa**2,
        lambda eps, gamma, kappa: eps**2 if eps > 0 else 0 * eps,
        lambda eps, gamma, kappa: (eps**2, gamma**2),
        lambda eps, gamma, kappa: None,
        lambda eps, gamma: eps**2 + gamma**2,
        "quadratic",
    ],
    ids=["numpy", "if", "tuple", "none", "two arguments", "string"],
)
def test_a_strain_energy_that_is_no_ufl_expression_is_refused(energy):
    with refused("strain_energy.*must give a UFL expression"):
        fb.Section(strain_energy=energy)


def test_a_strain_energy_that_is_a_vector_is_refused():
    with refused(r"strain_energy must be a scalar, not of shape \(3,\)"):
        fb.Section(strain_energy=lambda *strains: ufl.as_vector(strains))


@pytest.mark.parametrize(
    ("energy", "strain", "slope"),
    [
        (lambda e, g, k: 1e4 * (e**2 + g**2) - 50 * k**2, "kappa", "-100"),
        (lambda e, g, k: -1e3 * e**2 + g**2 + k**2, "eps", "-2000"),
    ],
)
def test_a_strain_energy_that_falls_from_zero_on_is_refused_with_the_number(energy, strain, slope):
    with refused(f"falls as {strain} grows .* derivative by {strain} is {slope}, which must be"):
        fb.Section(strain_energy=energy)


@pytest.mark.parametrize(
    "energy",
    [
        lambda e, g, k: e**2 + g**2 - k**2 + k**4,  # two wells: it snaps
        lambda e, g, k: e**2 + g**2 + k**4,
        lambda e, g, k: e**2 + g**2 + abs(k) ** 1.5,
        lambda e, g, k: (1 + e) * ufl.ln(1 + e) - e + g**2 + ufl.sqrt(1 + k**2),
    ],
)
def test_other_strain_energies_that_are_not_convex_everywhere_are_not(energy):
    assert fb.Section(strain_energy=energy).strain_energy is energy


def test_the_time_of_a_force_between_points_is_no_number():
    scene, arm = small_scene()
    with refused("force.distance, rate, t. must give a UFL expression.*not math"):
        scene.add_force_between(arm.end, (5, 5), force=lambda r, rate, t: math.sin(t) * r)
    with refused("force.distance, rate, t. must give a UFL expression"):
        scene.add_force_between(
            arm.end, (5, 5), force=lambda r, rate, t: np.interp(t, [0, 1], [0, 1])
        )


class Hangs(BaseException):
    """Passes through handlers of `Exception`."""


def test_a_strain_energy_that_uses_the_math_module_is_refused():
    def interrupt(*_):
        raise Hangs

    previous = signal.signal(signal.SIGALRM, interrupt)
    signal.alarm(2)
    try:
        with refused("strain_energy"):
            fb.Section(strain_energy=lambda eps, gamma, kappa: math.cosh(eps) + gamma**2 + kappa**2)
    except Hangs:
        pytest.fail("the check does not come to an end")
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


# -- Beams -----------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [[(1, 1), (1, 1)], [(0, 0), (1, 0), (1, 0), (2, 0)]])
def test_points_that_coincide_are_refused(points):
    first = 0 if len(points) == 2 else 1
    with refused(f"'arm': the points {first} and {first + 1} coincide at \\(1, "):
        fb.Scene().add_beam(points, SECTION, elements=4, name="arm")


def test_a_beam_from_a_node_to_itself_is_refused():
    scene, beam = small_scene()
    with refused("'loop': the points 0 and 1 coincide at"):
        scene.add_beam([beam.end, beam.end], SECTION, name="loop")


def test_a_beam_of_rounding_length_far_from_the_origin_is_refused():
    with refused("coincide"):
        fb.Scene().add_beam([(1e6, 0), (1e6 * (1 + 2e-16), 0)], SECTION)


def test_a_single_point_is_refused():
    with refused("'arm': a beam needs at least two points"):
        fb.Scene().add_beam([(0, 0)], SECTION, name="arm")


@pytest.mark.parametrize(
    "points",
    [
        [],
        [(0, 0), (1, 0, 0)],
        [(0, 0, 0), (1, 0, 0)],
        [(0, 0), (1,)],
        [0, 1],
        [(0, 0), (math.nan, 0)],
        [(0, 0), (math.inf, 0)],
        [(0, 0), None],
        [(0, 0), ("a", "b")],
        "ab",
        7,
        None,
    ],
    ids=str,
)
def test_points_that_are_no_pairs_are_refused(points):
    with refused("'arm': points must be"):
        fb.Scene().add_beam(points, SECTION, name="arm")


@pytest.mark.parametrize("elements", [0, -3, 2.0, 2.5, None, "two", [2, 0], [2, 2.0], []])
def test_invalid_numbers_of_elements_are_refused(elements):
    with refused("'arm': .*elements"):
        fb.Scene().add_beam([(0, 0), (1, 0), (1, 1)], SECTION, elements=elements, name="arm")


@pytest.mark.parametrize("elements", [[2], [2, 2, 2]])
def test_a_list_of_elements_of_the_wrong_length_is_refused(elements):
    with refused(f"'arm': {len(elements)} numbers of elements for 2 straight pieces"):
        fb.Scene().add_beam([(0, 0), (1, 0), (1, 1)], SECTION, elements=elements, name="arm")


def test_fewer_elements_than_pieces_are_refused():
    with refused("'arm': 2 elements are too few for 3 straight pieces"):
        fb.Scene().add_beam([(0, 0), (1, 0), (1, 1), (0, 1)], SECTION, elements=2, name="arm")


@pytest.mark.parametrize("degree", [0, 4, -1, 1.5, 2.0, "1", None])
def test_a_degree_that_is_not_1_2_or_3_is_refused(degree):
    with refused(f"'arm': degree = {re.escape(repr(degree))} must be 1, 2 or 3"):
        fb.Scene().add_beam([(0, 0), (1, 0)], SECTION, degree=degree, name="arm")


def test_beams_of_different_degrees_are_refused():
    scene, _ = small_scene()
    with refused("'leg': degree 2 differs from degree 1 of 'arm'"):
        scene.add_beam([(0, 0), (1, 0)], SECTION, degree=2, name="leg")


@pytest.mark.parametrize("name", ["arm", "beam 2"])
def test_two_beams_of_one_name_are_refused(name):
    scene, _ = small_scene()
    scene.add_beam([(0, 1), (1, 1)], SECTION)
    with refused(f"two beams are called '{name}'"):
        scene.add_beam([(0, 2), (1, 2)], SECTION, name=name)


@pytest.mark.parametrize("section", [None, STIFFNESS, fb.Section])
def test_an_invalid_section_is_refused(section):
    with refused("'arm': section must be an fx_beam.Section"):
        fb.Scene().add_beam([(0, 0), (1, 0)], section, name="arm")


def test_a_refused_beam_leaves_the_scene_as_it_was():
    scene, beam = small_scene()
    with refused("coincide"):
        scene.add_beam([beam.end, (3, 0), (3, 0)], SECTION, elements=2)
    assert scene.beams == [beam]
    assert len(scene.nodes) == 3


@pytest.mark.parametrize("fraction", [0.3, -0.5, 1.5, math.nan])
def test_a_fraction_without_a_node_is_refused_and_the_nodes_are_named(fraction):
    _, beam = small_scene()
    with refused(rf"'arm' has no node at the fraction {fraction}.*\[0. , 0.5, 1. \]"):
        beam.node(fraction)


# -- Nodes and beams of others ---------------------------------------------------------------

WITH_A_NODE = {
    "fix": lambda scene, node: scene.fix(node, "x"),
    "pin": lambda scene, node: scene.pin(node),
    "clamp": lambda scene, node: scene.clamp(node),
    "prescribe": lambda scene, node: scene.prescribe(node, x=lambda t: t),
    "add_mass": lambda scene, node: scene.add_mass(node, 1.0),
    "add_force": lambda scene, node: scene.add_force(node, (1.0, 0.0)),
    "add_moment": lambda scene, node: scene.add_moment(node, 1.0),
    "set_velocity": lambda scene, node: scene.set_velocity(node, (1.0, 0.0)),
}
WITH_A_BEAM = {
    "add_line_load": lambda scene, beam: scene.add_line_load(beam, (1.0, 0.0)),
    "add_virtual_work": lambda scene, beam: scene.add_virtual_work(lambda s: s.virtual_psi, beam),
    "set_velocity": lambda scene, beam: scene.set_velocity(beam, (1.0, 0.0)),
}


@pytest.mark.parametrize("method", WITH_A_NODE)
def test_a_node_of_another_scene_is_refused(method):
    scene, _ = small_scene()
    _, other = small_scene()
    with refused(r"node 2 at \(2, 0\) belongs to another scene"):
        WITH_A_NODE[method](scene, other.end)


def test_a_beam_at_a_node_of_another_scene_is_refused():
    scene, _ = small_scene()
    _, other = small_scene()
    with refused(r"'leg': node 2 at \(2, 0\) belongs to another scene"):
        scene.add_beam([other.end, (5, 5)], SECTION, name="leg")


@pytest.mark.parametrize("thing", [0, (0.0, 0.0), None, "start"], ids=str)
@pytest.mark.parametrize("method", WITH_A_NODE)
def test_what_is_no_node_is_refused_with_the_way_to_get_one(method, thing):
    scene, _ = small_scene()
    with refused(re.escape(f"{thing!r} is not a node; take one from a beam")):
        WITH_A_NODE[method](scene, thing)


@pytest.mark.parametrize("method", [name for name in WITH_A_NODE if name != "set_velocity"])
def test_a_beam_in_place_of_a_node_is_refused(method):
    scene, beam = small_scene()
    with refused("is not a node"):
        WITH_A_NODE[method](scene, beam)


@pytest.mark.parametrize("method", WITH_A_BEAM)
def test_a_beam_of_another_scene_is_refused(method):
    scene, _ = small_scene()
    _, other = small_scene()
    with refused("beam 'arm' belongs to another scene"):
        WITH_A_BEAM[method](scene, other)


@pytest.mark.parametrize("thing", ["arm", 0, "node"])
def test_what_is_no_beam_is_refused(thing):
    scene, beam = small_scene()
    with refused("line load: .* is not a beam"):
        scene.add_line_load(beam.end if thing == "node" else thing, (1.0, 0.0))


# -- Supports --------------------------------------------------------------------------------

FIX = {
    "fix": lambda scene, node: scene.fix(node, "y"),
    "pin": lambda scene, node: scene.pin(node),
    "prescribe": lambda scene, node: scene.prescribe(node, y=lambda t: t),
}


@pytest.mark.parametrize("second", FIX)
@pytest.mark.parametrize("first", FIX)
def test_a_component_that_is_supported_twice_is_refused(first, second):
    scene, beam = small_scene()
    FIX[first](scene, beam.end)
    component = "[xy]" if first == second == "pin" else "y"
    with refused(rf"{component} of node 2 at \(2, 0\) is supported twice"):
        FIX[second](scene, beam.end)


def test_a_component_named_twice_is_refused():
    scene, beam = small_scene()
    with refused("x of node 0 .* is supported twice"):
        scene.fix(beam.start, "x", "x")


def test_an_unknown_component_is_refused_and_the_known_ones_are_named():
    scene, beam = small_scene()
    with refused("'z' must be one of .*'x', 'y', 'rotation'"):
        scene.fix(beam.start, "z")


def test_a_support_without_components_is_refused():
    scene, beam = small_scene()
    with refused("support of node 0 .* name the components to fix"):
        scene.fix(beam.start)
    with refused("prescribed motion of node 0 .* give x, y or rotation"):
        scene.prescribe(beam.start)


@pytest.mark.parametrize("component", ["x", "y", "rotation"])
def test_a_prescribed_motion_that_does_not_start_from_0_is_refused(component):
    scene, beam = small_scene()
    scene.prescribe(beam.start, **{component: lambda t: 0.5 + t})
    with refused(rf"prescribed {component} of node 0 at \(0, 0\) is 0.5 at t = 0"):
        run(scene)


def test_a_prescribed_motion_that_starts_from_0_up_to_rounding_is_accepted():
    scene, beam = small_scene()
    scene.prescribe(beam.start, y=lambda t: math.sin(t + math.pi))
    assert run(scene).displacement(beam.start)[1, 1] == pytest.approx(-math.sin(0.1), abs=1e-14)


# -- Loads, masses and virtual works ---------------------------------------------------------

LOADS = {
    "force": (2, lambda scene, beam, value: scene.add_force(beam.end, value)),
    "moment": (1, lambda scene, beam, value: scene.add_moment(beam.end, value)),
    "line load": (2, lambda scene, beam, value: scene.add_line_load(beam, value)),
    "prescribed y": (1, lambda scene, beam, value: scene.prescribe(beam.end, y=value)),
}


@pytest.mark.parametrize("as_function", [False, True])
@pytest.mark.parametrize("value", [(1.0, 2.0, 3.0), "up", {}, [[1.0]]], ids=str)
@pytest.mark.parametrize("kind", LOADS)
def test_a_load_of_the_wrong_shape_is_refused(kind, value, as_function):
    scene, beam = small_scene()
    size, add = LOADS[kind]
    wanted = "a number" if size == 1 else "2 numbers"
    with refused(f"{kind} o[nf] .*: .* has the wrong type or shape; it must be {wanted}"):
        add(scene, beam, (lambda t: value) if as_function else value)


@pytest.mark.parametrize("as_function", [False, True])
@pytest.mark.parametrize("kind", LOADS)
def test_a_load_that_is_not_finite_from_the_start_is_refused(kind, as_function):
    scene, beam = small_scene()
    size, add = LOADS[kind]
    value = [math.nan] * size
    with refused(f"{kind} o[nf] .* not finite"):
        add(scene, beam, (lambda t: value) if as_function else value)


@pytest.mark.parametrize("kind", LOADS)
def test_a_load_function_that_raises_is_refused(kind):
    scene, beam = small_scene()
    with refused(f"{kind} o[nf] .*raised KeyError"):
        LOADS[kind][1](scene, beam, failing)


def test_a_load_function_of_too_many_arguments_is_refused():
    scene, beam = small_scene()
    with refused("force on node 2 .*raised TypeError"):
        scene.add_force(beam.end, lambda t, x: (0.0, 0.0))


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf, "heavy", (1.0, 2.0)])
@pytest.mark.parametrize("name", ["mass", "inertia"])
def test_a_mass_or_inertia_that_is_negative_or_no_finite_number_is_refused(name, value):
    scene, beam = small_scene()
    with refused(rf"{name}.* of node 2 at \(2, 0\)"):
        scene.add_mass(beam.end, **{"mass": 1.0} | {name: value})


@pytest.mark.parametrize("gravity", [9.81, (0, -9.81, 0), "down", (0, math.nan)])
def test_gravity_that_is_no_finite_pair_is_refused(gravity):
    with refused("gravity: .*(wrong type or shape|not finite)"):
        fb.Scene(gravity=gravity)


@pytest.mark.parametrize("term", [1.0, None, "drag"])
def test_a_virtual_work_that_cannot_be_called_is_refused(term):
    scene, _ = small_scene()
    with refused("add_virtual_work needs a function of the step"):
        scene.add_virtual_work(term)


@pytest.mark.parametrize(
    ("term", "reason"),
    [
        (lambda step: step.virtual_u, "must be a scalar"),
        (lambda step: ufl.grad(step.virtual_u), "must be a scalar"),
        (lambda step: step.psi, "linear in step.virtual_u and step.virtual_psi"),
        (lambda step: 0.0, "linear in step.virtual_u and step.virtual_psi"),
        (lambda step: None, "raised"),
        (lambda step: step.no_such_field, "raised AttributeError"),
        (lambda step: 1 / 0, "raised ZeroDivisionError"),
    ],
)
def test_a_virtual_work_that_is_no_scalar_of_the_virtual_fields_is_refused(term, reason):
    scene, _ = small_scene()
    scene.add_virtual_work(lambda step: -step.virtual_psi * step.omega)
    with refused(f"virtual work 2: .*{reason}"):
        scene.add_virtual_work(term)
        run(scene)


@pytest.mark.parametrize(
    "term",
    [
        lambda step: ufl.dot(step.virtual_u, step.virtual_u),
        lambda step: step.virtual_psi * step.virtual_u[0],
        lambda step: step.virtual_psi + 1,
        lambda step: ufl.sin(step.virtual_psi),
        lambda step: abs(step.virtual_psi),
    ],
    ids=["square", "product", "affine", "sine", "absolute value"],
)
def test_a_virtual_work_that_is_not_linear_is_refused_and_named(term):
    scene, _ = small_scene()
    scene.add_virtual_work(term)
    with refused("virtual work 1: .*linear in step.virtual_u and step.virtual_psi"):
        run(scene)


# -- Initial velocities ----------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [1.0, (1.0, 2.0, 3.0), lambda x, y: x, lambda x, y: (x, y, 0)])
def test_a_velocity_of_the_wrong_shape_is_refused(velocity):
    scene, beam = small_scene()
    with refused("velocity of beam 'arm': .*wrong type or shape; it must be 2 numbers"):
        scene.set_velocity(beam, velocity)


def test_a_spin_of_the_wrong_shape_is_refused():
    scene, beam = small_scene()
    with refused("spin of node 2 .*wrong type or shape; it must be a number"):
        scene.set_velocity(beam.end, spin=(1.0, 2.0))


@pytest.mark.parametrize("part", ["velocity", "spin"])
def test_an_initial_velocity_that_fails_at_a_later_node_is_refused(part):
    def at(x, y):
        value = 1 / (2 - x)  # 2 is the end of the beam
        return (value, 0.0) if part == "velocity" else value

    scene, beam = small_scene()
    scene.set_velocity(beam, **{part: at})
    with refused(f"{part} of beam 'arm'.*ZeroDivisionError"):
        run(scene)


def test_an_initial_velocity_that_is_not_finite_is_refused():
    scene, beam = small_scene()
    scene.set_velocity(beam, lambda x, y: (math.inf if x > 1 else 0.0, 0.0))
    with refused(r"velocity at \(2, 0\) is .*; it must be finite"):
        run(scene)


@pytest.mark.parametrize(
    ("component", "velocity", "spin"),
    [("x", (1.0, 0.0), 0.0), ("y", (0.0, 1.0), 0.0), ("rotation", (0.0, 0.0), 1.0)],
)
def test_an_initial_velocity_that_moves_a_support_is_refused(component, velocity, spin):
    scene, beam = small_scene()
    scene.fix(beam.end, component)
    scene.set_velocity(beam, velocity, spin)
    with refused(
        rf"node 2 at \(2, 0\) is supported in {component}, but its initial rate there is 1"
    ):
        run(scene)


def test_an_initial_velocity_that_vanishes_at_a_support_up_to_rounding_is_accepted():
    scene, beam = small_scene()
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.set_velocity(beam, lambda x, y: (0.0, math.sin(math.pi * x / 2)))
    assert run(scene).velocity(beam.end)[0] == pytest.approx([0, 0], abs=1e-15)


def test_an_initial_velocity_against_a_prescribed_motion_is_refused():
    scene, beam = small_scene()
    scene.prescribe(beam.end, y=lambda t: t)
    scene.set_velocity(beam, (0.0, 5.0))
    with refused(r"node 2 at \(2, 0\)"):
        run(scene)


def test_two_initial_velocities_of_a_shared_node_are_refused():
    scene, beam = small_scene()
    leg = scene.add_beam([beam.end, (2, 3)], SECTION)
    scene.set_velocity(beam, (1.0, 0.0))
    scene.set_velocity(leg, (0.0, 1.0))
    with refused(r"two initial velocities at \(2, 0\)"):
        run(scene)


def test_initial_velocities_that_agree_at_a_shared_node_are_accepted():
    scene, beam = small_scene()
    leg = scene.add_beam([beam.end, (2, 3)], SECTION)
    scene.set_velocity(beam, lambda x, y: (-y, x), spin=1.0)
    scene.set_velocity(leg, lambda x, y: (-y, x), spin=1.0)
    assert run(scene).velocity(leg.end)[0] == pytest.approx([-3, 2], abs=1e-15)


# -- Time grid and scheme --------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, "0.1", None, (0.1,)], ids=str)
@pytest.mark.parametrize("name", ["dt", "t_end"])
def test_a_time_that_is_no_finite_number_is_refused(name, value):
    scene, _ = small_scene()
    with refused(f"{name} = .* must be a (finite|positive) number"):
        run(scene, **{name: value})


@pytest.mark.exact_times
@pytest.mark.parametrize("dt", [0, -0.1])
def test_a_step_that_is_not_positive_is_refused(dt):
    scene, _ = small_scene()
    with refused(f"dt = {dt} must be a positive number"):
        run(scene, dt=dt)


@pytest.mark.parametrize("t_end", [0.05, 0.0, -1.0])
def test_an_end_before_the_first_step_is_refused(t_end):
    scene, _ = small_scene()
    with refused(f"t_end = {t_end} must be at least one step dt = 0.1"):
        run(scene, t_end=t_end)


def test_an_end_below_one_step_by_rounding_is_one_step():
    scene, _ = small_scene()
    assert 0.3 - 0.2 < 0.1
    assert list(run(scene, dt=0.1, t_end=0.3 - 0.2).t) == [0.0, 0.3 - 0.2]


def test_negative_halvings_are_refused():
    scene, _ = small_scene()
    with refused("max_halvings = -1 must be a whole number from 0 to 50"):
        run(scene, max_halvings=-1)


@pytest.mark.parametrize(
    "scheme",
    ["Newmark", fb.EnergyMomentum, fb.Newmark, 0],
    ids=["a name", "EnergyMomentum", "Newmark", "a number"],
)
def test_an_unknown_scheme_is_refused_with_the_way_to_get_one(scheme):
    scene, _ = small_scene()
    with refused(r"unknown scheme .*fx_beam.EnergyMomentum\(\)"):
        run(scene, scheme)


def test_without_a_scheme_it_is_energy_momentum():
    scene, _ = small_scene()
    assert run(scene, None).stats.scheme == "EnergyMomentum"


PARAMETERS = {
    "HHT: alpha": (fb.HHT, [0.1, -0.5, math.nan, math.inf, "strong"]),
    "GeneralizedAlpha: rho_inf": (fb.GeneralizedAlpha, [1.5, -0.1, math.nan, "none"]),
    "Newmark: beta": (lambda beta: fb.Newmark(beta=beta), [0, -0.25, 2, math.nan, None]),
    "Newmark: gamma": (lambda gamma: fb.Newmark(gamma=gamma), [-0.5, 2, math.nan]),
}


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name, (_, values) in PARAMETERS.items() for value in values],
)
def test_a_parameter_out_of_range_is_refused_with_the_range(name, value):
    with refused(rf"{name} = {value!r} must lie in [\[(].*\]"):
        PARAMETERS[name][0](value)


@pytest.mark.parametrize("alpha", [0, -1 / 3])
def test_parameters_at_the_end_of_their_range_are_accepted(alpha):
    assert fb.HHT(alpha).rates.beta == pytest.approx((1 - alpha) ** 2 / 4, abs=1e-15)


# -- Scenes that cannot be computed ----------------------------------------------------------


def test_an_empty_scene_is_refused():
    with refused("the scene has no beams"):
        run(fb.Scene())


@pytest.mark.parametrize("scene", [None, fb.Scene, "scene"], ids=str)
def test_what_is_no_scene_is_refused(scene):
    with refused("simulate needs an fx_beam.Scene"):
        run(scene)


def massless(*supports):
    """Massless beam from (2, 1) to (5, 1)."""
    scene = fb.Scene()
    beam = scene.add_beam([(2, 1), (5, 1)], MASSLESS, elements=2)
    for node, *components in supports:
        scene.fix(getattr(beam, node), *components)
    return scene, beam


PIN = ("start", "x", "y")


def test_a_free_beam_without_mass_is_refused():
    scene, _ = massless()
    with refused(r"beam 'beam 1' can (move|rotate) .* without mass or support"):
        run(scene)


@pytest.mark.parametrize("other", [(), (("end", "x"),)])
def test_a_beam_without_mass_that_turns_about_its_pin_is_refused(other):
    scene, _ = massless(PIN, *other)
    with refused(r"'beam 1' can rotate about \(2, 1\) .*without mass or support"):
        run(scene)


@pytest.mark.parametrize(
    "supports", [[("start", "y"), ("end", "y")], [("start", "y", "rotation")]], ids=str
)
def test_a_beam_without_mass_that_slides_is_refused(supports):
    scene, _ = massless(*supports)
    with refused(r"can move along \(-?1, -?0\) .*without mass or support"):
        run(scene)


def test_a_beam_with_rotary_inertia_only_is_refused():
    scene = fb.Scene()
    scene.add_beam([(0, 0), (1, 0)], fb.Section(**STIFFNESS, rhoI=1.0))
    with refused("can move along"):
        run(scene)


def test_a_mass_does_not_hold_a_beam_that_turns_about_it():
    scene, beam = massless()
    scene.add_mass(beam.end, 1.0)
    with refused(r"can rotate about \(5, 1\)"):
        run(scene)


def test_a_mass_at_a_pin_does_not_hold_a_beam_that_turns_about_it():
    scene, beam = massless(PIN)
    scene.add_mass(beam.start, 1.0)
    with refused(r"can rotate about \(2, 1\)"):
        run(scene)


def test_the_part_that_moves_is_found_among_parts_that_do_not():
    scene, _ = massless(PIN)
    scene.add_beam([(0, 0), (1, 0)], SECTION)
    with refused(r"beam 'beam 1' can rotate about \(2, 1\)"):
        run(scene)


@pytest.mark.parametrize(
    ("supports", "mass", "inertia"),
    [
        ([PIN], 1.0, 0.0),
        ([PIN], 0.0, 1.0),
        ([], 1.0, 1.0),
        ([PIN, ("end", "y")], None, None),
        ([PIN, ("end", "rotation")], None, None),
        ([("start", "y"), ("end", "y")], 1e-9, 0.0),
    ],
    ids=["pendulum", "tip inertia", "free tip body", "roller", "clamp apart", "light slider"],
)
def test_massless_beams_that_mass_or_supports_hold_are_accepted(supports, mass, inertia):
    scene, beam = massless(*supports)
    if mass is not None:
        scene.add_mass(beam.end, mass, inertia)
    scene.add_force(beam.node(0.5), (0.0, 1e-12))
    assert np.isfinite(run(scene).q).all()


@pytest.mark.parametrize(
    ("supports", "reason"), [([PIN], "a node turns"), ([], "the tangent is singular")]
)
def test_a_mechanism_that_a_virtual_work_does_not_hold_fails_in_its_first_step(supports, reason):
    scene, beam = massless(*supports)
    scene.add_virtual_work(lambda step: 2.0 * step.virtual_psi, beam)
    with pytest.raises(fb.StepError, match=f"the step from t = 0 to .* failed.*{reason}") as caught:
        run(scene)
    assert caught.value.time == 0
    assert list(caught.value.solution.t) == [0]


# -- Functions of time that fail later -------------------------------------------------------


def raised():
    raise KeyError("no such table")


FAILURES = {
    "nan": (lambda size: [math.nan] * size, "not finite"),
    "infinite": (lambda size: [math.inf] * size, "not finite"),
    "raises": (lambda size: raised(), "raised KeyError"),
    "shape": (lambda size: [0.0] * 3, "wrong type or shape"),
}


@pytest.mark.exact_times
@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("kind", LOADS)
def test_a_function_of_time_that_fails_later_ends_the_run_there(kind, failure):
    size, add = LOADS[kind]
    value, reason = FAILURES[failure]

    def scene_with(fails_after):
        def function(t):
            return [0.3 * t] * size if t <= fails_after else value(size)

        scene, beam = small_scene()
        scene.clamp(beam.start)
        add(scene, beam, function)
        return scene

    with pytest.raises(fb.StepError, match=f"{kind} o[nf] .* t = 0.4.*{reason}") as caught:
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
