"""Each public analysis against a closed reference, on a scene that is quick to set up."""

import math
from concurrent.futures import ThreadPoolExecutor

import ufl

import numpy as np
import pytest
from jointed import midpoint
from registry import DATA, GRAVITY, ONES, SCENES, hung
from scenes import assert_refused, clamped_bar, guided_body, hinged_body, pinned_bar, supported_bar
from scipy.special import ellipk

import fx_beam as fb

SECTION = fb.Section(**DATA)


def guided(k=100.0, m=1.0, c=4.0, speed=0.0, load=None, **spring):
    """A mass on a spring on a guide of the ground; omega = 10 rad/s, damping ratio 0.2."""
    scene = fb.Scene()
    body = scene.add_body((0, 0), mass=m, inertia=1.0)
    damper = fb.Damper(c) if c else None
    laws = {"spring": fb.Spring(k, **spring), "damper": damper}
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), **laws))
    scene.set_velocity(body, (speed, 0.0))
    if load is not None:
        scene.add_force(body.centre, load)
    return scene, body, guide


def duffing():
    """The spring force x + x^3 on a mass of 1 kg."""
    return guided(1.0, c=0.0, load=None, strain_energy=lambda x: x**4 / 4)[:2]


def frequency_of_duffing(amplitude):
    e = amplitude**2
    return math.pi * math.sqrt(1 + e) / (2 * ellipk(e / (2 * (1 + e))))


def rolled(x, elements=8):
    """A cantilever that a moment rolls up to a half circle at x = 1."""
    scene, beam = clamped_bar((2, 0), SECTION, elements)
    scene.add_moment(beam.end, np.pi * DATA["EI"] / 2 * x[0])
    return scene, {"tip": fb.Output("position", beam.end)}


def rolled_tip(x):
    """Elements are straight between their ends, each turned by the same angle."""
    turn = np.pi * x
    bent = np.sin(turn / 2) / np.sin(turn / 16) * np.exp(1j * turn / 2)
    return 2 / 8 * np.array([bent.real, bent.imag])


def falling():
    scene = fb.Scene(gravity=(0, -10.0))
    body = scene.add_body((0, 5.0), 1.0, 0.1)
    return scene, {"place": fb.Output("position", body.centre, "y")}


# -- Equilibria and paths --------------------------------------------------------------------------


def test_static_rolls_a_beam_up_as_exact():
    scene, outputs = rolled([1.0])
    solution = fb.static(scene, load_steps=4)
    tip = solution.position(outputs["tip"].of)
    exact = [rolled_tip(f) for f in solution.load_factor[1:]]
    assert tip[1:] == pytest.approx(np.array(exact), abs=1e-9)
    moment = solution.resultants(scene.beams[0])
    assert isinstance(moment, fb.BeamResultants)
    assert moment.M[-1] == pytest.approx(np.pi * DATA["EI"] / 2)
    assert fb.Equilibrium().rates == fb.AtRest()


def test_an_envelope_has_the_extremes_and_the_cases_that_give_them():
    """A cantilever under P at its end, up and down: M = -P (L - s), P (L - s)."""
    scene, beam = clamped_bar((2, 0), fb.Section(EA=1e8, GA=1e8, EI=1e6), 4)
    cases = []
    for force in (3.0, -1.0):
        load = scene.add_force(beam.end, (0.0, force))
        cases.append(fb.static(scene, linear=True))
        scene.remove(load)
    along = fb.envelope(cases, beam, s=[0.0, 1.0])
    assert isinstance(along, fb.BeamEnvelope) and isinstance(along.M, fb.Envelope)
    assert along.M.largest == pytest.approx([6.0, 3.0])
    assert along.M.least == pytest.approx([-2.0, -1.0])
    assert along.M.largest_by.tolist() == [0, 0] and along.M.least_by.tolist() == [1, 1]
    by_name = fb.envelope(cases, beam.name).Q
    assert by_name.largest == pytest.approx(3 * np.ones(101))
    assert by_name.largest_by.tolist() == [0] * 101
    tip = fb.envelope(cases, fb.Output("displacement", beam.end))
    exact = 8 / 3e6 + 2 / 1e8
    assert tip.largest[1] == pytest.approx(3 * exact, rel=2e-2)
    assert (tip.least_by[1], tip.largest_by[1]) == (1, 0)
    for cases_or_none, part, words in (
        ([], beam, "one or more"),
        (cases, "no beam", "no beam of these"),
        (cases, 3, "Output or a beam"),
    ):
        assert_refused(words, fb.envelope, cases_or_none, part)


def test_an_influence_line_has_the_ordinates_of_a_cantilever():
    scene, beam = clamped_bar((4, 0), fb.Section(EA=1e6, GA=1e6, EI=1e4), 5)
    outputs = {"clamp": fb.Output("reaction", beam.start), "M": fb.Output("M", beam.at(1.0))}
    lines = fb.influence(scene, outputs, beam, s=[0.0, 0.5, 1.5, 4.0])
    assert isinstance(lines, fb.InfluenceLines)
    assert lines.values["clamp"][:, 1] == pytest.approx(1.0)
    assert lines.values["clamp"][:, 2] == pytest.approx([0.0, 0.5, 1.5, 4.0], abs=1e-9)
    assert abs(lines.values["M"]) == pytest.approx([0.0, 0.0, 0.5, 3.0], abs=1e-9)


def test_effective_masses_of_a_cantilever_are_those_of_its_closed_form():
    """Of a slender uniform cantilever: 0.6131, 0.1883, 0.0647 (Clough & Penzien, Dynamics)."""
    scene, beam = clamped_bar((0, 1), fb.Section(EA=1e6, GA=1e6, EI=1.0, rhoA=1.0), 64)
    shaken = fb.modes(scene, n=3).participation((1, 0))
    assert isinstance(shaken, fb.Participation)
    assert shaken.effective_masses == pytest.approx([0.6131, 0.1883, 0.0647], rel=2e-3)
    assert shaken.effective_masses == pytest.approx(shaken.factors**2)
    # The clamped node has half of the mass of an element.
    assert shaken.total == pytest.approx(1 - 0.5 / 64, rel=1e-2)


def test_an_oscillator_has_the_acceleration_of_its_spectrum():
    scene = fb.Scene()
    mass = scene.add_body((0, 0), mass=2.0, inertia=1.0).centre
    scene.fix(mass, "y", "rotation")
    spring = scene.add_spring(mass, x=fb.Spring(50.0)).x  # a period of 0.4 pi s
    outputs = {"felt": fb.Output("acceleration", mass, "x"), "pull": fb.Output("force", spring)}
    spectrum = [0.0, 0.2 * np.pi, 0.6 * np.pi], [2.0, 6.0, 4.0]
    shaken = fb.modes(scene).spectrum(spectrum, (0.5, 0), outputs=outputs)
    assert isinstance(shaken, fb.SpectrumResponse) and shaken.share == pytest.approx(1.0)
    assert shaken.accelerations == pytest.approx([5.0])
    assert [shaken.values[name] for name in outputs] == pytest.approx([5.0, 10.0], rel=1e-12)


def test_stresses_are_those_of_the_moment():
    section = fb.Section(**DATA, A=0.02, I=1e-4, As=0.01, edges=(-0.1, 0.3))
    scene, beam = clamped_bar((2, 0), section, 8)
    scene.add_moment(beam.end, 5.0)
    stress = fb.static(scene, load_steps=1).stress(beam)
    assert isinstance(stress, fb.BeamStress)
    ends = stress.ends
    assert ends.lower[-1] == pytest.approx([5e3, 5e3])
    assert ends.upper[-1] == pytest.approx([-1.5e4, -1.5e4])


def test_static_response_has_the_derivatives_of_the_closed_form():
    run, h = fb.StaticResponse(rolled, load_steps=4), 1e-5
    factors, y = run([1.0])
    slopes = run.jacobian()["tip"][1:, :, 0]
    exact = [(rolled_tip(f * (1 + h)) - rolled_tip(f * (1 - h))) / (2 * h) for f in factors[1:]]
    assert slopes == pytest.approx(np.array(exact), abs=1e-7)
    weights = np.zeros_like(y["tip"])
    weights[-1, 1] = 1.0
    assert run.vjp({"tip": weights}) == pytest.approx(slopes[-1, 1], abs=1e-9)


def arch(x):
    """Height, stiffness and force of a shallow arch of two bars, which snaps through."""
    section = fb.Section(EA=1e3 * x[1], GA=1e3 * x[1], EI=x[1])
    scene, bars = supported_bar([(-1, 0), (0, x[0]), (1, 0)], section, elements=4, held="xy")
    scene.add_force(bars.node(0.5), (0, -20 * x[2]))
    return scene, {"load": fb.Output("critical_load", scene)}


def test_a_limit_point_moves_with_the_numbers_as_its_differences():
    run, x, h = fb.StaticResponse(arch, 10, continuation="arc-length"), np.array([0.2, 1, 1]), 1e-4
    (_, y), J = run(x), run.jacobian()["load"]
    assert J[1:] == pytest.approx(y["load"] * [1, -1], rel=1e-6)
    ends = [run(x + change)[1]["load"] for change in ([h, 0, 0], [-h, 0, 0])]
    assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(J[0], rel=1e-5)
    assert_refused("a limit point has none", lambda: run.imperfection_sensitivity())


def test_the_arc_length_follows_a_snap_through():
    k, rest = 100.0, np.hypot(1, 0.5)

    def force(y):
        return k * (rest - np.hypot(1, y)) * y / np.hypot(1, y)

    top = np.sqrt(rest ** (2 / 3) - 1)
    scene, body, _ = guided_body((1, 0.5), 1.0, 1.0, axis=(0, 1))
    pull = scene.add_force_between(body, (0, 0), spring=fb.Spring(k, rest=rest))
    scene.add_force(body, (0, -2 * force(top)))
    path = fb.static(scene, load_steps=8, continuation="arc-length")
    assert isinstance(pull, fb.ForceBetween)
    assert path.stats.limit_points == pytest.approx([0.5, -0.5], rel=1e-9)
    assert [p.kind for p in path.critical_points] == ["limit point"] * 2
    height = path.position(body)[:, 1]
    assert 2 * force(top) * path.load_factor == pytest.approx(force(height), abs=1e-9)
    spring = path.joint(pull)
    assert isinstance(spring, fb.PullMotion)
    assert spring.force == pytest.approx(k * (np.hypot(1, height) - rest), abs=1e-9)
    away = abs(abs(height) - top) > 1e-3
    assert path.unstable_modes[away].tolist() == (abs(height[away]) < top).tolist()


def test_a_rigid_column_tips_over_at_its_critical_point_and_along_its_branch():
    scene, bar, _ = hinged_body((0, 1), 1.0, 1.0, {"foot": (0, 0)}, spring=fb.Spring(7.0))
    scene.add_force(bar.centre, (0, -15.0))
    (point,) = fb.static(scene, 9).critical_points
    assert isinstance(point, fb.CriticalPoint) and isinstance(point.branch(1), fb.Branch)
    assert (point.kind, 15 * point.load_factor) == ("bifurcation", pytest.approx(7.0, rel=1e-9))
    linear = fb.buckling(scene)
    assert isinstance(linear, fb.BucklingModes) and 15 * linear.load_factors == pytest.approx([7.0])
    tipped = fb.static(scene, start=point.branch(1), continuation="arc-length")
    x, y = tipped.position(bar.centre).T
    psi = np.arctan2(abs(x), y)
    assert tipped.load_factor[-1] == 1 and psi[-1] > 1
    assert 15 * tipped.load_factor * np.sin(psi) == pytest.approx(7.0 * psi, abs=1e-9)


def test_an_imperfect_column_deflects_as_southwell_says():
    section = fb.Section(**DATA | {"EA": 1e9, "GA": 1e9, "EI": 1.0})
    scene, beam = supported_bar((0, 1), section, elements=8, held="x", load=(0, -12.0))
    (point,) = fb.static(scene, load_steps=4).critical_points
    size = 1e-6
    crooked = fb.imperfect(scene, point.modes, size)
    node = crooked.beams[0].node(0.5)
    assert abs(node.x) == pytest.approx(size, rel=1e-9) and beam.node(0.5).x == 0
    crooked.change(crooked.loads[0], (0.0, -5.0))
    moved = abs(fb.static(crooked, load_steps=1).displacement(node)[-1, 0])
    assert moved == pytest.approx(size * 5 / (12 * point.load_factor - 5), rel=1e-5)


# -- Vibrations ------------------------------------------------------------------------------------


def test_modes_are_those_of_the_textbook():
    scene, *_ = guided()
    rod = scene.add_beam([(0, 1), (2, 1)], fb.Section(EA=1e9, GA=1e9, EI=1e9), elements=1)
    hinge = {"spring": fb.Spring(50.0), "damper": fb.Damper(3.0)}
    scene.add_joint(fb.Revolute(fb.GROUND, rod.start, **hinge))
    scene.add_mass(rod.end, 0.5)
    modes = fb.modes(scene, n=2)
    assert isinstance(modes, fb.Modes)
    # sqrt(50/(0.5 2^2)) and sqrt(100/1); 3/(2 sqrt(50 2)) and 4/(2 10) of the dampers.
    assert modes.angular_frequencies == pytest.approx([5.0, 10.0], rel=1e-6)
    assert modes.frequencies == pytest.approx([0.7957747, 1.5915494], rel=1e-6)
    assert modes.damping_ratios == pytest.approx([0.15, 0.2], rel=1e-6)


def test_a_linear_system_has_the_poles_of_its_modes_and_the_slopes_of_the_motion():
    scene, body, guide = guided(load=fb.Input("push", factor=(1, 0)))
    outputs = {"x": fb.Output("slide", guide), "v": fb.Output("rate", guide)}
    system = fb.linearise(scene, outputs=outputs)
    assert isinstance(system, fb.LinearSystem)
    poles = np.linalg.eigvals(system.A)
    assert poles[poles.imag > 0] == pytest.approx(fb.modes(scene, n=1).eigenvalues, rel=1e-9)
    response = np.linalg.solve(10j * np.eye(2) - system.A, system.B)
    assert system.C @ response == pytest.approx(np.array([[1 / 40j], [0.25]]), rel=1e-9)
    motion = fb.Motion(scene, dt=1e-5, outputs=outputs)
    motion.step({"push": 2.0})
    assert motion.outputs["v"] / 1e-5 == pytest.approx(2 * (system.C @ system.B)[1, 0], rel=1e-3)


def test_an_oscillator_lags_by_a_quarter_at_resonance():
    scene, body, guide = guided()
    w = np.array([0.0, 10.0, 25.0])
    response = fb.frequency_response(scene, (body.centre, (0.5, 0.0)), guide, w / (2 * np.pi))
    assert isinstance(response, fb.FrequencyResponse)
    assert response.values[:, 0] == pytest.approx(0.5 / (100 + 4j * w - w**2), rel=1e-8)
    assert response.phase[1, 0] == pytest.approx(-np.pi / 2)
    assert response.names == ("slide",) and response.units == ("m",)


def test_rayleigh_gives_the_ratios_that_were_asked_for():
    f, ratios = (2.0, 7.0), (0.01, 0.03)
    alpha, tau = fb.rayleigh(f, ratios)
    w = 2 * np.pi * np.array(f)
    assert alpha / (2 * w) + tau * w / 2 == pytest.approx(ratios, rel=1e-12)


def test_periodic_motions_and_their_backbone_have_the_frequencies_of_the_hardening_spring():
    scene, body = duffing()
    family = fb.backbone(scene, amplitude=1.0, steps=41)
    single = fb.periodic(scene, mode=0, amplitude=1.0, steps=41)
    assert isinstance(single, fb.PeriodicMotion) and isinstance(family, fb.PeriodicFamily)
    assert single.error < 1e-9 and family.free and family.stable.all()
    assert family[-1].frequency == pytest.approx(single.frequency, rel=1e-8)
    amplitudes = family.amplitudes(body.centre, "x")
    assert (np.diff(amplitudes) > 0).all() and (np.diff(family.energies) > 0).all()
    exact = [frequency_of_duffing(a) for a in amplitudes]
    assert 2 * np.pi * family.frequencies == pytest.approx(exact, rel=4e-3)


def test_the_period_of_an_oscillator_follows_its_data_as_in_the_closed_form():
    def build(x):
        scene = guided(100.0 * x[0], x[1], c=0.0)[0]
        return scene, {"T": fb.Output("period", scene)}

    motion = lambda scene: fb.periodic(scene, mode=0, amplitude=0.1, steps=41)  # noqa: E731
    run = fb.PeriodicResponse(build, motion)
    _, y = run([1.2, 0.8])
    assert run.jacobian()["T"] * [1.2, 0.8] / y["T"] == pytest.approx([-0.5, 0.5], rel=1e-7)


def test_a_forced_response_is_that_of_the_linear_oscillator():
    def build(f):
        load = {"load": lambda t: (math.cos(2 * math.pi * f * t), 0.0)}
        build.scene, build.body, build.guide = guided(**load)
        return build.scene

    curve = fb.forced_response(build, (1.2, 2.0), steps=101, step=0.4)
    load = build.body.centre, (1.0, 0.0)
    linear = fb.frequency_response(build.scene, load, build.guide, curve.frequencies)
    amplitudes = curve.amplitudes(build.body.centre, "x")
    assert amplitudes == pytest.approx(linear.amplitude[:, 0], rel=0.01)
    assert curve.stable.all() and curve.frequencies[[0, -1]] == pytest.approx([1.2, 2.0])


# -- Motions ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_the_reached_error_follows_the_tolerance(tolerance):
    scene, body, _ = guided(c=0.0, speed=5.0)
    swing = fb.simulate(scene, t_end=2.0, tolerance=tolerance)
    scene.add_body((1, 0), 1.0, 1.0)  # tolerances are relative to the size of the scene
    swing = fb.simulate(scene, t_end=2.0, tolerance=tolerance)
    error = abs(swing.displacement(body.centre)[:, 0] - 0.5 * np.sin(10 * swing.t)).max()
    assert 0.2 < error / tolerance < 5
    assert abs(swing.energy.balance_error).max() < 1e-11


def test_a_falling_ball_ends_on_the_floor_at_the_exact_time():
    scene, outputs = falling()
    options = {"outputs": outputs, "until": lambda t, y: y["place"]}
    fall = fb.simulate(scene, dt=0.03, t_end=3.0, **options)
    assert abs(fall.t[-1] - 1.0) < 1e-12 and fall.stats.until == "until"
    assert fall.velocity(outputs["place"].of)[-1, 1] == pytest.approx(-10.0, rel=1e-9)


def test_a_latch_closes_and_a_fuse_breaks_at_their_times():
    scene = fb.Scene()
    one, other = (scene.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
    guide = scene.add_joint(fb.Prismatic(one, other, axis=(1, 0)))
    scene.set_velocity(other, (0.6, 0.0))
    solution = fb.simulate(scene, dt=0.1, t_end=2.0, changes={"latch": fb.Latch(guide, 1.5)})
    assert solution.stats.changes["latch"] == pytest.approx(0.5 / 0.6, abs=1e-12)
    assert solution.energy.impact[-1] == pytest.approx(0.18, rel=1e-10)
    pulled = fb.Scene()
    one, other = (pulled.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
    joint = pulled.add_joint(fb.Rigid(one, other, offset=(1, 0)))
    pulled.add_force(other, lambda t: (10.0 * t, 0.0))
    solution = fb.simulate(pulled, dt=0.01, t_end=1.0, changes={"fuse": fb.Fuse(joint, 4.01)})
    assert solution.stats.changes["fuse"] == pytest.approx(0.804, abs=6e-3)


def test_steps_with_held_inputs_are_those_of_simulate_and_a_snapshot_brings_them_back(tmp_path):
    scene, body, guide = guided(load=fb.Input("push"))
    outputs = {"x": fb.Output("position", body.centre, "x"), "F": fb.Output("force", guide)}
    motion = fb.Motion(scene, dt=0.01, outputs=outputs, record=fb.Record(every=2))
    start = motion.snapshot()
    assert isinstance(start, fb.Snapshot)
    for _ in range(2):
        motion.restore(start)
        for k in range(20):
            computed = motion.step({"push": (float(k % 3), 0.0)})
        inputs = {"push": lambda t: (np.floor(t / 0.01) % 3, 0.0)}
        whole = fb.simulate(scene, dt=0.01, t_end=0.2, inputs=inputs)
        assert computed["x"] == pytest.approx(whole.position(body.centre)[-1, 0], abs=1e-12)
        assert computed["F"] == pytest.approx(whole.joint(guide).force[-1], abs=1e-10)
    motion.solution().save(tmp_path / "run.npz")
    rows = fb.load(tmp_path / "run.npz")
    assert isinstance(rows, fb.Solution) and len(rows.t) == 11
    assert rows.displacement(body.centre)[-1, 0] == computed["x"]


def test_a_quantity_is_refined_until_it_is_known():
    def scene_of(elements, degree):
        scene, bar = pinned_bar((0.5, 0), SECTION, elements, degree, name="arm", gravity=GRAVITY)
        return scene

    def tip(solution):
        return solution.displacement(solution.beams["arm"].end)[-1]

    convergence = fb.converge(scene_of, tip, 2e-3, t_end=0.2, elements=2)
    fine = tip(fb.simulate(scene_of(16, 1), fb.EnergyMomentum(4), dt=1e-3, t_end=0.2))
    assert isinstance(convergence, fb.Converged)
    error = abs(convergence.value - fine).max()
    assert error < 2e-3 and error / 3 < convergence.error <= 2e-3


def _lowest(case):
    return {"omega": fb.modes(guided(k=case["k"])[0], n=1).angular_frequencies[0]}


def test_a_sweep_has_a_row_for_each_case_and_the_message_of_one_that_fails():
    with ThreadPoolExecutor(1) as executor:
        table = fb.sweep(_lowest, [{"k": 25.0}, {"k": 100.0}, {"k": -1.0}], executor=executor)
    assert list(table["omega"])[:2] == pytest.approx([5.0, 10.0])
    assert "Spring: stiffness" in list(table["error"])[2]


# -- What is observed ------------------------------------------------------------------------------


def observed(x):
    """Every quantity of a scene with a motor, loads and dampers."""
    motor = {"axis": (0.6, 0.8), "motor": lambda t: 0.2 * x[7] * t**2}
    scene = hung(x, fb.PinInSlot, hinge=fb.Coordinate(fb.Spring(5.0), fb.Damper(0.3)), **motor)
    joint, node = scene.joints[0], scene.nodes[-1]
    outputs = {f"node {name}": fb.Output(name, node) for name in OF_NODES}
    outputs |= {f"joint {name}": fb.Output(name, joint) for name in OF_JOINTS}
    outputs |= {f"scene {name}": fb.Output(name, scene) for name in OF_SCENES}
    outputs |= {f"beam {name}": fb.Output(name, scene.beams[1]) for name in OF_BEAMS}
    outputs["pin"] = fb.Output("reaction", scene.nodes[0], "moment")
    return scene, outputs


OF_NODES = ("position", "displacement", "rotation", "velocity", "spin", "acceleration", "reaction")
OF_JOINTS = ("angle", "slide", "spin", "rate", "force", "motor_force")
OF_SCENES = ("kinetic_energy", "strain_energy", "potential_energy", "spring_energy")
OF_SCENES += ("total_energy", "dissipated_energy", "work")
OF_BEAMS = ("N", "Q", "M")


def test_every_output_of_a_response_and_a_motion_is_what_a_solution_says():
    scene, outputs = observed(ONES)
    times = {"dt": 0.01, "t_end": 0.1}
    solution = fb.simulate(scene, **times)
    _, computed = fb.Response(observed, **times)(ONES)
    node, joint, beam = scene.nodes[-1], solution.joint(scene.joints[0]), scene.beams[1]
    energy, resultants = solution.energy, solution.resultants(beam)
    kinds = (energy, fb.Energy), (joint, fb.JointMotion), (solution.stats, fb.Stats)
    kinds += (node, fb.Node), (beam, fb.Beam), (scene.joints[0], fb.Joint)
    assert all(isinstance(thing, kind) for thing, kind in kinds)
    expected = {f"node {name}": getattr(solution, name)(node) for name in OF_NODES}
    expected |= {f"joint {name}": getattr(joint, name) for name in OF_JOINTS}
    energies = {"spring_energy": "springs", "dissipated_energy": "dissipated", "work": "work"}
    expected |= {
        f"scene {name}": getattr(energy, energies.get(name, name.removesuffix("_energy")))
        for name in OF_SCENES
    }
    expected |= {f"beam {name}": getattr(resultants, name) for name in OF_BEAMS}
    expected["pin"] = solution.reaction(scene.nodes[0])[:, 2]
    assert computed.keys() == expected.keys()
    for name, rows in expected.items():
        assert computed[name] == pytest.approx(rows, rel=1e-9, abs=1e-9 * abs(rows).max()), name
    measured = {name: o for name, o in outputs.items() if name.startswith(("node", "joint", "pin"))}
    last = fb.Motion(scene, dt=0.01, outputs=measured).run(0.1)
    for name, value in last.items():
        size = abs(expected[name]).max()
        assert value == pytest.approx(expected[name][-1], rel=1e-9, abs=1e-9 * size), name


def test_a_gear_hands_a_moment_on_by_its_ratio():
    scene = fb.Scene()
    wheels = [scene.add_body((x, 0), mass=1.0, inertia=0.1).centre for x in (0, 1)]
    gear = scene.add_joint(
        fb.Gear(*(scene.add_joint(fb.Revolute(fb.GROUND, wheel)) for wheel in wheels), ratio=-0.5)
    )
    scene.fix(wheels[0], "rotation")
    scene.add_moment(wheels[1], 3.0)
    held = fb.static(scene)
    teeth = held.joint(gear)
    assert isinstance(teeth, fb.GearMotion)
    assert teeth.force[-1] == pytest.approx(-3.0, rel=1e-12)
    assert held.reaction(wheels[0])[-1, 2] == pytest.approx(1.5, rel=1e-12)
    assert not teeth.difference.any()


def test_a_contact_pushes_back_what_falls_on_it():
    scene = fb.Scene()
    body = scene.add_body((0, 1e-3), mass=1.0, inertia=1.0)
    wall = scene.add_contact(body.centre, fb.Line((0, 0), (0, 1)), stiffness=100.0)
    scene.set_velocity(body, (0.0, -1.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.4)
    contact = solution.contact(wall)
    assert isinstance(body, fb.Body) and isinstance(wall, fb.Contact)
    assert isinstance(contact, fb.ContactMotion)
    # Half a period of omega = 10 rad/s: the depth 1/10 m at the most, and the same speed back.
    assert contact.gap.min() == pytest.approx(-0.1, rel=1e-3)
    assert solution.velocity(body.centre)[-1, 1] == pytest.approx(1.0, rel=1e-9)


# -- Schemes of one's own --------------------------------------------------------------------------


def at(step: fb.Step, law: fb.Law, u, psi) -> fb.Resultants:
    """Resultants of one configuration of straight beams."""
    dphi = step.t0 + step.prime(u)
    c, s = ufl.cos(psi), ufl.sin(psi)
    t = ufl.as_vector((c * step.t0[0] - s * step.t0[1], s * step.t0[0] + c * step.t0[1]))
    across = ufl.as_vector((-t[1], t[0]))
    strains = ufl.dot(dphi, t) - 1, ufl.dot(dphi, across), step.prime(psi)
    N, Q, M = law.resultants(*strains)
    return fb.Resultants(dphi, t, N, Q, M, m=M)


def at_mid_step(step, law):
    return at(step, law, step.u0 + step.Du / 2, step.psi0 + step.Dpsi / 2)


def at_the_end(step, law):
    start, end = at(step, law, step.u0, step.psi0), at(step, law, step.u, step.psi)
    return fb.WeightedResultants(start, end, 1.0)


@pytest.mark.parametrize(
    ("scheme", "resultants", "rates"),
    [
        (fb.MidPoint(), at_mid_step, fb.MidPointRates()),
        (fb.MidPoint(), at_mid_step, fb.NodalRates(midpoint)),
        (fb.Newmark(), at_the_end, fb.NewmarkRates(0.25, 0.5)),
    ],
    ids=["mid point", "nodal rates", "newmark"],
)
def test_a_scheme_written_out_is_the_one_of_the_package(scheme: fb.Scheme, resultants, rates):
    case = SCENES["pinned beam"]
    mine = fb.Scheme("mine", resultants, rates)
    ours, theirs = (fb.simulate(case.build(ONES), s, dt=0.01, t_end=0.1) for s in (scheme, mine))
    assert abs(ours.q - theirs.q).max() < 1e-9 < 1e-3 < abs(ours.q).max()
