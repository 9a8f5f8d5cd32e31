"""Section forces at places as outputs: closed forms, the balance of elements, and derivatives."""

import derivatives
import numpy as np
import pytest
from derivatives import EXACT, assert_both_ways_agree, assert_derivatives, difference, size_of
from registry import ONES, SCENES
from scenes import assert_refused, clamped_bar, pinned_bar

import fx_beam as fb


def sections(beam, *places):
    """N, Q and M at parts of the length of a beam."""
    return {
        f"{name} at {part}": fb.Output(name, beam.at(part * float(beam.length)))
        for name in "NQM"
        for part in places
    }


# -- Closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_moment_of_a_cantilever_changes_with_its_load_and_its_length(degree):
    """M = P L at the clamp, so that dM/dP = L and dM/dL = P; P (L - s) elsewhere."""

    def build(x):
        load, length = x
        section = fb.Section(EA=1e13, GA=1e13, EI=1e13)
        scene, beam = clamped_bar((length, 0), section, 3, degree, load=(0, load))
        return scene, {
            "clamp": fb.Output("M", beam.at(0.0)),
            "inside": fb.Output("M", beam.at(0.5)),
        }

    run = fb.StaticResponse(build, 1)
    _, y = run([10.0, 2.0])
    J = run.jacobian()
    assert y["clamp"][-1] == pytest.approx(20.0, rel=1e-8)
    assert J["clamp"][-1] == pytest.approx([2.0, 10.0], rel=1e-8)
    assert J["inside"][-1] == pytest.approx([1.5, 10.0], rel=1e-8)


def test_the_axial_force_in_a_bar_that_turns_changes_as_its_closed_form():
    """N = rho A w^2 (L^2 - s^2) / 2."""
    s = 0.4

    def build(x):
        density, spin, length = x
        scene, bar = pinned_bar((length, 0), fb.Section(EA=1e9, GA=1e9, EI=1e7, rhoA=density), 8, 2)
        scene.set_velocity(bar, lambda x, y: (-spin * y, spin * x), spin=spin)
        return scene, {"N": fb.Output("N", bar.at(s))}

    x = np.array([2.0, 3.0, 1.0])
    density, spin, length = x
    run = fb.Response(build, fb.EnergyDecaying(1.0), dt=1e-3, t_end=0.1)
    _, y = run(x)
    size = spin**2 * (length**2 - s**2) / 2
    assert y["N"][-1] == pytest.approx(density * size, rel=0.01)
    expected = size, 2 * density * size / spin, density * spin**2 * length
    assert run.jacobian()["N"][-1] == pytest.approx(expected, rel=0.02)


# -- The values are those of a solution -----------------------------------------------------------


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.Newmark()])
def test_a_motion_measures_what_its_solution_has(scheme):
    section = fb.Section(EA=1e5, GA=1e5, EI=500.0, rhoA=2.0, rhoI=0.05, retardation=1e-3)
    scene, arm = clamped_bar((1, 0.4), section, elements=3, degree=2, gravity=(0.0, -9.81))
    scene.add_line_load(arm, lambda t: (0.0, 30 * np.sin(9 * t)), between=(0.2, 0.8))
    scene.add_force(arm.at(0.5), (3.0, 1.0))
    scene.add_moment(arm.end, fb.Input("torque"))
    outputs = sections(arm, 0.0, 0.3, 1.0)
    motion = fb.Motion(scene, scheme, dt=0.01, outputs=outputs, record=fb.Record())
    rows = [motion.outputs]
    for k in range(12):
        rows.append(motion.step({"torque": np.sin(k)}))
    forces = motion.solution().resultants(arm)
    for name, output in outputs.items():
        known = getattr(forces.at(output.of.s), output.quantity)[:, 0]
        measured = [row[name] for row in rows]
        assert measured[1:] == pytest.approx(known[1:], rel=1e-12), name
        # At the start rates are found in a short step, whose length is not known then.
        assert measured[0] == pytest.approx(known[0], rel=1e-4, abs=1e-4 * abs(known).max())
    before = motion.snapshot()
    assert motion.outputs == rows[-1]
    after = motion.step({"torque": 2.0})
    motion.restore(before)
    again = motion.step({"torque": 2.0})
    assert again == pytest.approx(after, rel=1e-6)


# -- Derivatives ----------------------------------------------------------------------------------

NAMES = [
    *("curved tapered beam", "beams with an offset", "material with a memory", "dead loads"),
    *("drag", "rayleigh damping", "line load that travels", "natural strains"),
    *("virtual work with a parameter", "prescribed motion", "slider on a beam"),
    *("shaken base in gravity that changes", "order four", "energy decaying"),
]


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_motion(name):
    case = SCENES[name]

    def build(x):
        scene = case.build(x)
        return scene, sections(scene.beams[0], 0.0, 0.37)

    run = fb.Response(build, case.scheme(), newton=EXACT, dt=case.dt, t_end=6 * case.dt)
    _, y = run(ONES)
    J = run.jacobian()
    assert_both_ways_agree(run, y, J)
    derivatives.assert_they_are_those_of_the_motion(run, ONES, J)


@pytest.mark.parametrize("kind", [fb.Response, fb.StaticResponse])
def test_calls_after_derivatives_give_the_same(kind):
    """Then scenes have slopes, with which solutions are none the less computed."""

    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0 * x[1], rhoA=x[2], rhoI=0.01)
        scene, beam = clamped_bar((1, 0), section, 2, gravity=(0, -9.81 * x[0]))
        scene.add_line_load(beam, lambda t: (0.0, x[0] * np.sin(t)))
        scene.add_force(beam.at(0.7), lambda t: (0.0, x[0] * t))
        return scene, {"M": fb.Output("M", beam.at(0.0)), "inside": fb.Output("M", beam.at(0.2))}

    run = kind(build, **({"dt": 0.01, "t_end": 0.1} if kind is fb.Response else {"t": 1.0}))
    x = np.array([1.0, 1.1, 0.9])
    _, first = run(x)
    J = run.jacobian()
    assert run.stats.difference_reason == ""
    _, again = run(x)
    for name, values in first.items():
        assert again[name] == pytest.approx(values, rel=1e-9, abs=1e-9)
        assert run.jacobian()[name] == pytest.approx(J[name], rel=1e-9, abs=1e-9)


def frame(x, degree):
    """A bent arm and a leg, lengths, places and data of which depend on x."""
    section = fb.Section(EA=1e4 * x[0], GA=1e4, EI=10.0 * x[1], rhoA=x[2], rhoI=0.01)
    scene, arm = clamped_bar((x[2], 0.2 * x[1]), section, 3, degree, gravity=(0, -9.81 * x[1]))
    leg = scene.add_beam([arm.end, (1.3, -0.4 * x[0])], section, 2, degree)
    scene.add_line_load(arm, lambda t: (0.5 * t, -3.0 * x[1]))
    scene.add_force(leg.end, (x[0], -2 * x[1]))
    return scene, sections(arm, 0.5, 1.0) | sections(leg, 0.0) | {"M": fb.Output("M", arm.at(0.3))}


@pytest.mark.parametrize("degree", [1, 2])
def test_equilibria_have_derivatives(degree):
    run = fb.StaticResponse(lambda x: frame(x, degree), 4, t=0.3, newton=EXACT)
    assert_derivatives(run, np.ones(3))


def loaded_inside(x, degree, is_static=True):
    """A curved arm with forces and a couple inside the elements of its outputs."""
    data = {"EA": 1e4 * x[0], "GA": 1e4, "EI": 10.0, "rhoA": x[1], "rhoI": 0.01}
    axis = fb.arc((0, 0), (0.5, 0.3), (1, 0.2)) if degree > 1 else [(0, 0), (1, 0.3)]
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_beam(axis, fb.Section(**data), elements=2, degree=degree)
    scene.clamp(arm.start)
    s = [part * float(arm.length) for part in (0.15, 0.3, 0.4)]
    push = (2.0 * x[2], -3.0 * x[1]) if is_static else lambda t: (2.0 * x[2] * (1 + t), -3.0 * x[1])
    scene.add_force(arm.at(s[0]), push)
    scene.add_moment(arm.at(s[1]), 0.7 * x[2])
    scene.add_force(arm.at(s[2]), (x[0], 4.0 * x[2]))
    return scene, sections(arm, 0.1, 0.15, 0.31, 0.5, 0.8)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_beside_forces_and_couples_inside_an_element_there_are_derivatives(degree):
    run = fb.StaticResponse(lambda x: loaded_inside(x, degree), 4, newton=EXACT)
    assert_derivatives(run, np.ones(3))
    options = {"newton": EXACT, "dt": 0.01, "t_end": 0.06}
    run = fb.Response(lambda x: loaded_inside(x, degree, is_static=False), **options)
    assert_derivatives(run, np.ones(3))


def test_the_place_of_a_section_may_move_beside_a_force_inside_its_element():
    """M of a beam on two supports: P (L - a) s / L before the force, P a (L - s) / L behind."""

    def build(x):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (4, 0)], fb.Section(EA=1e9, GA=1e9, EI=1e9), elements=1)
        scene.pin(beam.start)
        scene.fix(beam.end, "y")
        scene.add_force(beam.at(1.0), (0, -10.0))
        return scene, {str(k): fb.Output("M", beam.at(place)) for k, place in enumerate(x)}

    run = fb.StaticResponse(build, 1)
    _, y = run([0.96, 1.02, 3.0])
    J = run.jacobian()
    assert [abs(y[name][-1]) for name in y] == pytest.approx([7.2, 7.45, 2.5], rel=1e-6)
    signs = [np.sign(y[name][-1]) for name in y]
    found = [signs[k] * J[str(k)][-1, k] for k in range(3)]
    assert found == pytest.approx([7.5, -2.5, -2.5], rel=1e-6)


def test_a_motion_from_an_equilibrium_has_derivatives():
    def at_rest(scene):
        return fb.static(scene, load_steps=3)

    def build(x):
        scene, outputs = frame(x, 1)
        scene.add_moment(scene.beams[1].end, lambda t: 3 * x[0] * np.sin(20 * t))
        return scene, outputs

    run = fb.Response(build, dt=0.01, t_end=0.06, start=at_rest, newton=EXACT)
    x = np.ones(3)
    _, y = run(x)
    J = run.jacobian()
    assert_both_ways_agree(run, y, J)
    along = np.array([0.5, 1.0, -0.7])
    ends = {name: difference(lambda h, key=name: run(x + h * along)[1][key], 1e-4) for name in J}
    for name, expected in ends.items():
        # At rest accelerations are round-off.
        error = abs(J[name] @ along - expected)[1:].max()
        assert error < 1e-5 * size_of(expected), name


def test_periodic_motions_have_derivatives():
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01, retardation=5e-3)
        scene, beam = clamped_bar((x[0], 0), section, 2)
        scene.add_force(beam.end, lambda t: (0.0, x[1] * np.cos(2 * np.pi * t)))
        return scene, sections(beam, 0.0, 0.6)

    run = fb.PeriodicResponse(
        build, lambda scene: fb.periodic(scene, period=1.0, steps=31, tolerance=1e-12)
    )
    derivatives.assert_orbit_slopes(run, [1.0, 0.7], 1e-5, multipliers=False)


# -- What is refused ------------------------------------------------------------------------------


def test_what_has_no_section_forces_says_so():
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01), 2)
    outputs = {"M": fb.Output("M", beam.at(0.3))}
    with pytest.raises(fb.SceneError, match="output 'M' is a M; only .* are linearised"):
        fb.linearise(scene, outputs=outputs)
    assert_refused("give Motion record", fb.Motion, scene, dt=0.1, outputs=outputs)
    until = {"strong": lambda t, y: y["M"] - 1.0}
    with pytest.raises(fb.SceneError, match="`until` a record of all steps"):
        record = fb.Record(every=2)
        fb.simulate(scene, dt=0.1, t_end=1.0, until=until, outputs=outputs, record=record)
    load = scene.add_line_load(beam, fb.Input("wind"))
    with pytest.raises(ValueError, match="need the history of"):
        fb.Motion(scene, dt=0.1, outputs=outputs, record=fb.Record())
    scene.remove(load)


def test_forces_inside_the_element_of_an_output_may_not_move():
    def build(x):
        scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=10.0), 2)
        scene.add_force(beam.at(0.3 * x[0]), (0, 1.0))
        return scene, {"M": fb.Output("M", beam.at(0.3))}

    run = fb.StaticResponse(build)
    run([1.0])
    assert_refused("places of loads in the element of 'M'", run.jacobian)
