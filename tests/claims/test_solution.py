"""What a solution holds: shapes, signs, files, statistics, and what a broken run leaves."""

import csv
import json
import math
import time
from dataclasses import asdict

import numpy as np
import pytest
from scenes import pendulum, pinned_beam

import fx_beam as fb

STIFFNESS = {"EA": 1e4, "GA": 1e4, "EI": 100.0}
MASSLESS = fb.Section(**STIFFNESS)
SECTION = fb.Section(**STIFFNESS, rhoA=1.0, rhoI=0.1)
HISTORIES = ("t", "X", "q", "v", "a", "reactions", "linear_momentum", "angular_momentum")
ENERGIES = (
    *("kinetic", "strain", "potential", "work", "springs", "dissipated"),
    *("algorithmic", "numerical", "impact", "total", "balance_error"),
)


def frame(degree=2):
    """Two beams that share a node, pinned, pushed and in motion."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    arm = scene.add_beam([(0, 0), (2, 0)], SECTION, elements=3, degree=degree, name="arm")
    leg = scene.add_beam([arm.end, (2, -1)], SECTION, elements=2, degree=degree, name="leg")
    scene.pin(arm.start)
    scene.add_force(leg.end, lambda t: (5.0, 10 * t))
    scene.set_velocity(arm, lambda x, y: (0.0, x), spin=1.0)
    return scene, arm, leg


@pytest.fixture(scope="module")
def framed():
    scene, arm, leg = frame()
    return fb.simulate(scene, dt=0.05, t_end=0.5), arm, leg


# -- Arrays ----------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 3])
def test_all_arrays_have_one_row_for_each_time(degree):
    scene, arm, leg = frame(degree)
    solution = fb.simulate(scene, dt=0.05, t_end=0.2)
    n, nodes = 5, 5 * degree + 1
    assert solution.t.shape == (n,)
    assert solution.X.shape == (nodes, 2)
    for name in ("q", "v", "a", "reactions"):
        assert getattr(solution, name).shape == (n, nodes, 3)
    for name in ("position", "displacement", "velocity", "acceleration"):
        assert getattr(solution, name)(arm.end).shape == (n, 2)
    for name in ("rotation", "spin"):
        assert getattr(solution, name)(arm.end).shape == (n,)
    assert solution.reaction(arm.start).shape == (n, 3)
    assert solution.linear_momentum.shape == (n, 2)
    assert solution.angular_momentum.shape == (n,)
    for name in ENERGIES:
        assert getattr(solution.energy, name).shape == (n,)
    for beam, elements in ((arm, 3), (leg, 2)):
        assert solution.shape(beam).shape == (n, elements * degree + 1, 2)
        resultants = solution.resultants(beam)
        assert resultants.s.shape == (elements * degree,)
        for part in (resultants.N, resultants.Q, resultants.M):
            assert part.shape == (n, elements * degree)


def test_position_is_the_reference_position_and_the_displacement(framed):
    solution, arm, leg = framed
    for beam in (arm, leg):
        for node in beam.nodes:
            place = np.array([node.x, node.y]) + solution.displacement(node)
            assert solution.position(node) == pytest.approx(place, abs=1e-15)


def test_the_shape_of_a_beam_passes_through_its_nodes(framed):
    solution, arm, leg = framed
    for beam in (arm, leg):
        for place, node in zip(range(0, 99, 2), beam.nodes, strict=False):
            np.testing.assert_array_equal(solution.shape(beam)[:, place], solution.position(node))
        np.testing.assert_array_equal(solution.shape(beam), solution.shape(beam.name))


def test_the_first_row_is_the_start(framed):
    solution, arm, leg = framed
    assert solution.t[0] == 0
    assert (solution.q[0] == 0).all()
    assert (solution.reactions[0] == 0).all()
    assert solution.energy.strain[0] == solution.energy.work[0] == solution.energy.potential[0] == 0
    for node in arm.nodes:
        assert solution.velocity(node)[0] == pytest.approx([0, node.x], abs=1e-15)
        assert solution.spin(node)[0] == 1
    assert solution.velocity(leg.end)[0] == pytest.approx([0, 0], abs=0)


def test_the_first_acceleration_is_in_equilibrium_with_the_start():
    scene = fb.Scene(gravity=(0.0, -9.81))
    beam = scene.add_beam([(0, 0), (2, 0)], SECTION, elements=2)
    scene.add_line_load(beam, (3.0, 0.0))
    for scheme in (fb.EnergyMomentum(), fb.Newmark()):
        solution = fb.simulate(scene, scheme, dt=0.1, t_end=0.1)
        assert solution.acceleration(beam.end)[0] == pytest.approx([3.0, -9.81], rel=1e-9)


# -- Times -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dt", "t_end", "steps"),
    [
        (0.1, 0.3, 3),
        (0.1, 0.1 * 3, 3),
        (0.1, 0.7, 7),
        (0.01, 10, 1000),
        (0.1, 1, 10),
        (1 / 3, 1, 3),
        (0.3, 0.3, 1),
        (2, 4, 2),
        (0.1, 0.25, 3),
        (0.1, 0.301, 4),
        (0.3, 1.0, 4),
        (1e-9, 3e-9, 3),
    ],
)
def test_times_are_multiples_of_the_step_up_to_the_end(dt, t_end, steps):
    scene = fb.Scene()
    scene.add_beam([(0, 0), (1, 0)], SECTION)
    solution = fb.simulate(scene, dt=dt, t_end=t_end)
    assert len(solution.t) == steps + 1
    assert solution.t[:-1] == pytest.approx(dt * np.arange(steps), rel=1e-15)
    assert solution.t[-1] == t_end
    assert (np.diff(solution.t) > 0).all()
    assert np.diff(solution.t).max() < dt * (1 + 1e-6)
    assert solution.stats.steps == steps


def test_the_shorter_last_step_is_integrated_as_such():
    scene = fb.Scene(gravity=(0.0, -10.0))
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION)
    solution = fb.simulate(scene, dt=0.1, t_end=0.25)
    assert solution.displacement(beam.end)[:, 1] == pytest.approx(-5 * solution.t**2, abs=1e-13)


# -- Stress resultants -----------------------------------------------------------------------

GAUSS = {1: [0.0], 2: [-(3**-0.5), 3**-0.5], 3: [-(0.6**0.5), 0.0, 0.6**0.5]}


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_resultants_are_given_at_the_gauss_points_of_the_elements(degree):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (3, 0), (3, 1)], SECTION, elements=[2, 1], degree=degree)
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    middles, halves = np.array([0.75, 2.25, 3.5]), np.array([0.75, 0.75, 0.5])
    expected = (middles[:, None] + halves[:, None] * GAUSS[degree]).ravel()
    assert solution.resultants(beam).s == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("degree", [1, 2])
def test_tension_is_positive_and_carries_the_weight_that_hangs_below(degree):
    # The scheme that damps most: the axial swing about rest dies out.
    heavy = fb.Section(EA=1e5, GA=1e5, EI=100.0, rhoA=2.0)
    scene = fb.Scene(gravity=(0.0, -9.81))
    beam = scene.add_beam([(0, 0), (0, -3)], heavy, elements=3, degree=degree)
    scene.pin(beam.start)
    scene.add_mass(beam.end, 5.0)
    solution = fb.simulate(scene, fb.GeneralizedAlpha(0.0), dt=0.5, t_end=40.0)
    r = solution.resultants(beam)
    below = 9.81 * (5.0 + 2.0 * (3 - r.s))
    # Linear over the beam; constant over a two-node element, at its middle.
    assert r.N[-1] == pytest.approx(below, rel=1e-9)
    assert r.Q[-1] == pytest.approx(np.zeros(3 * degree), abs=1e-9)
    assert r.M[-1] == pytest.approx(np.zeros(3 * degree), abs=1e-9)
    assert solution.reaction(beam.start)[-1, 1] == pytest.approx(9.81 * 11, rel=1e-9)


def cantilever(direction=(1.0, 0.0), degree=1):
    scene = fb.Scene()
    end = 2 * np.array(direction)
    beam = scene.add_beam([(0, 0), end], MASSLESS, elements=4, degree=degree)
    scene.clamp(beam.start)
    return scene, beam


@pytest.mark.parametrize("moment", [5.0, -5.0])
@pytest.mark.parametrize("degree", [1, 2])
def test_the_bending_moment_of_an_end_moment_is_that_moment(degree, moment):
    scene, beam = cantilever(degree=degree)
    scene.add_moment(beam.end, lambda t: moment * t)
    solution = fb.simulate(scene, fb.Newmark(), dt=0.25, t_end=1.0)
    r = solution.resultants(beam)
    assert r.M == pytest.approx(np.outer(moment * solution.t, np.ones(4 * degree)), rel=1e-8)
    assert abs(r.N).max() + abs(r.Q).max() < 1e-3 * abs(moment)
    # A positive moment bends to the left of the way along the beam.
    assert np.sign(solution.displacement(beam.end)[-1, 1]) == np.sign(moment)


@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_resultants_of_a_tip_force_follow_from_equilibrium(angle):
    """n = N t + Q W t is the force on the part before the section, in its own frame."""
    c, s = math.cos(angle), math.sin(angle)
    along, across, length = 1e-3, 2e-3, 2.0
    force = np.array([c * along - s * across, s * along + c * across])
    scene, beam = cantilever((c, s), degree=2)
    scene.add_force(beam.end, lambda t: t * force)
    solution = fb.simulate(scene, fb.Newmark(), dt=1.0, t_end=1.0)
    r = solution.resultants(beam)
    assert r.N[1] == pytest.approx(np.full(8, along), rel=1e-4)
    assert r.Q[1] == pytest.approx(np.full(8, across), rel=1e-4)
    assert r.M[1] == pytest.approx(across * (length - r.s), rel=1e-4)
    assert (r.N[0] == 0).all()


def test_resultants_belong_to_the_elements_of_their_beam():
    """A comb, pulled at its teeth: the mesh numbers its elements otherwise than the scene."""
    scene = fb.Scene()
    spine = scene.add_beam([(0, 0), (0, 4)], MASSLESS, elements=4)
    scene.clamp(spine.start)
    pull = {}
    for k in (3, 1, 4, 2):
        tooth = scene.add_beam([spine.nodes[k], (1, k)], MASSLESS, elements=2, name=f"tooth {k}")
        pull[k] = 1e-4 * k**2
        scene.add_force(tooth.end, lambda t, k=k: (pull[k] * t, 0.0))
    solution = fb.simulate(scene, fb.Newmark(), dt=1.0, t_end=1.0)
    for k, force in pull.items():
        assert solution.resultants(f"tooth {k}").N[1] == pytest.approx([force] * 2, rel=1e-3)
    # Across the spine, to the left of its way, acts what pulls above.
    above = [sum(force for k, force in pull.items() if k > element) for element in range(4)]
    assert solution.resultants(spine).Q[1] == pytest.approx(-np.array(above), rel=1e-3)


def test_resultants_of_a_mid_point_scheme_are_those_at_mid_step():
    scene, beam = cantilever()
    scene.add_force(beam.end, lambda t: (50.0 * t, 0.0))
    scene.add_moment(beam.node(0.5), 0.0)
    solution = fb.simulate(scene, dt=0.25, t_end=1.0)
    half = np.concatenate(([0.0], 50.0 * (solution.t[1:] - 0.125)))
    expected = np.outer(half, np.ones(4))
    assert solution.resultants(beam).N == pytest.approx(expected, rel=1e-12, abs=1e-12)


# -- Files -----------------------------------------------------------------------------------


def test_a_saved_solution_is_read_back_to_the_last_bit(framed, tmp_path):
    solution, arm, leg = framed
    path = tmp_path / "run.npz"
    solution.save(path)
    loaded = fb.load(path)
    for name in HISTORIES:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(solution, name))
    for name in ENERGIES:
        np.testing.assert_array_equal(getattr(loaded.energy, name), getattr(solution.energy, name))
    assert asdict(loaded.stats) == asdict(solution.stats)
    assert list(loaded.beams) == ["arm", "leg"]
    for beam in (arm, leg):
        own = loaded.beams[beam.name]
        assert (own.degree, own.elements, own.nodes) == (beam.degree, beam.elements, beam.nodes)
        np.testing.assert_array_equal(own.s, beam.s)
        for key in (beam, own, beam.name):
            np.testing.assert_array_equal(loaded.shape(key), solution.shape(beam))
            for part in "sNQM":
                np.testing.assert_array_equal(
                    getattr(loaded.resultants(key), part),
                    getattr(solution.resultants(beam), part),
                )
        for node in (beam.end, own.end):
            np.testing.assert_array_equal(loaded.position(node), solution.position(beam.end))
            np.testing.assert_array_equal(loaded.spin(node), solution.spin(beam.end))


def test_a_solution_that_was_read_can_be_saved_again(framed, tmp_path):
    framed[0].save(tmp_path / "one.npz")
    fb.load(tmp_path / "one.npz").save(tmp_path / "two.npz")
    with np.load(tmp_path / "one.npz") as one, np.load(tmp_path / "two.npz") as two:
        assert one.files == two.files
        for name in one.files:
            np.testing.assert_array_equal(one[name], two[name])


def test_a_path_is_taken_as_given(framed, tmp_path):
    framed[0].save(str(tmp_path / "run.data"))
    assert [path.name for path in tmp_path.iterdir()] == ["run.data"]
    assert len(fb.load(str(tmp_path / "run.data")).t) == 11


def test_a_file_holds_no_pickled_objects(framed, tmp_path):
    path = tmp_path / "run.npz"
    framed[0].save(path)
    with np.load(path, allow_pickle=False) as file:
        kinds = {name: file[name].dtype.kind for name in file.files}
    assert set(kinds.values()) <= set("fiuU")
    assert kinds["q"] == "f"


def write(path, content, framed):
    """Write a file that is no solution, or only half of one."""
    framed[0].save(path)
    if content == "text":
        path.write_text("t,x\n0,1\n")
    elif content == "empty":
        path.write_bytes(b"")
    elif content == "cut off":
        path.write_bytes(path.read_bytes()[:-100])
    elif content == "one array":
        with open(path, "wb") as file:
            np.save(file, np.arange(3.0))
    else:
        with np.load(path) as file:
            arrays = dict(file)
        if content == "other arrays":
            arrays = {"t": np.arange(3.0)}
        elif content == "pickle":
            arrays["meta"] = np.array([{"format": "fx_beam solution 1"}])
        elif content == "other text":
            arrays["meta"] = np.array("fx_beam")
        elif content == "another version":
            meta = json.loads(str(arrays["meta"])) | {"format": "fx_beam solution 0"}
            arrays["meta"] = np.array(json.dumps(meta))
        elif content == "without statistics":
            meta = json.loads(str(arrays["meta"]))
            del meta["stats"]
            arrays["meta"] = np.array(json.dumps(meta))
        else:
            del arrays[content]
        with open(path, "wb") as file:
            np.savez(file, **arrays)


@pytest.mark.parametrize(
    "content",
    [
        "text",
        "empty",
        "cut off",
        "one array",
        "other arrays",
        "pickle",
        "other text",
        "another version",
        "without statistics",
        "meta",
        "X",
        "energy_work",
        "beams_nodes",
        "beams_N",
    ],
)
def test_a_file_that_is_no_solution_is_refused_by_its_name(content, framed, tmp_path):
    path = tmp_path / "wrong.npz"
    write(path, content, framed)
    with pytest.raises(ValueError, match="wrong.npz is not a solution saved by fx_beam"):
        fb.load(path)


def test_a_missing_file_is_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere.npz"):
        fb.load(tmp_path / "nowhere.npz")


def test_a_table_holds_the_named_columns_to_the_last_bit(framed, tmp_path):
    solution, arm, leg = framed
    path = tmp_path / "run.csv"
    solution.to_csv(path, {"corner": arm.end, "tip": leg.end})
    with open(path, newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    table = dict(zip(header, np.array(rows, dtype=float).T, strict=True))
    expected = {"t": solution.t, "angular momentum": solution.angular_momentum}
    expected |= {
        f"energy {name.replace('_', ' ')}": getattr(solution.energy, name) for name in ENERGIES
    }
    for i, axis in enumerate("xy"):
        expected[f"linear momentum {axis}"] = solution.linear_momentum[:, i]
    for label, node in (("corner", arm.end), ("tip", leg.end)):
        for i, axis in enumerate("xy"):
            expected[f"{label} {axis}"] = solution.position(node)[:, i]
            expected[f"{label} {axis} rate"] = solution.velocity(node)[:, i]
        expected[f"{label} rotation"] = solution.rotation(node)
        expected[f"{label} rotation rate"] = solution.spin(node)
    assert len(header) == len(set(header))
    assert set(table) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(table[name], values)


def test_a_table_without_nodes_holds_the_audit(framed, tmp_path):
    framed[0].to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert header[0] == "t"
    assert len(header) == 1 + len(ENERGIES) + 3


# -- Nodes and beams of others ---------------------------------------------------------------

OF_A_NODE = (
    "position",
    "displacement",
    "rotation",
    "velocity",
    "spin",
    "acceleration",
    "reaction",
)


@pytest.fixture(scope="module")
def foreign():
    scene = fb.Scene()
    return scene.add_beam([(0, 1), (0, 9)], SECTION, elements=30, degree=2, name="arm")


@pytest.mark.parametrize("method", OF_A_NODE)
def test_a_node_of_another_scene_is_refused(method, framed, foreign):
    for node in (foreign.start, foreign.end):
        with pytest.raises(ValueError, match=r"node \d+ at .* is not a node of this solution"):
            getattr(framed[0], method)(node)


@pytest.mark.parametrize("thing", [0, None, (2.0, 0.0), "arm"], ids=str)
@pytest.mark.parametrize("method", OF_A_NODE)
def test_what_is_no_node_is_refused(method, thing, framed):
    with pytest.raises(ValueError, match="is not a node; take one from a beam"):
        getattr(framed[0], method)(thing)


@pytest.mark.parametrize("method", ["shape", "resultants"])
def test_a_beam_of_another_scene_is_refused(method, framed, foreign):
    with pytest.raises(ValueError, match="'arm' is not a beam of this solution"):
        getattr(framed[0], method)(foreign)
    with pytest.raises(
        ValueError, match=r"'boom' is not a beam of this solution; it has \['arm', 'leg'"
    ):
        getattr(framed[0], method)("boom")


def test_a_foreign_node_is_refused_in_a_table(framed, foreign, tmp_path):
    with pytest.raises(ValueError, match="is not a node of this solution"):
        framed[0].to_csv(tmp_path / "run.csv", {"tip": foreign.end})


# -- Statistics: only what the scene needs ---------------------------------------------------


def test_only_what_the_pendulum_has_is_compiled_and_assembled():
    scene, _ = pendulum()
    stats = fb.simulate(scene, dt=0.01, t_end=0.05).stats
    assert set(stats.compiled) == {
        "internal forces",
        "tangent",
        "strain energy",
        "inverted sections",
    }
    assert set(stats.assembled) == {"lumped mass", "gravity"}
    assert stats.unknowns == 3 * 2 - 2
    assert stats.scheme == "EnergyMomentum"


def test_only_what_the_pinned_beam_has_is_compiled_and_assembled():
    scene, _ = pinned_beam()
    stats = fb.simulate(scene, dt=0.01, t_end=0.05).stats
    assert set(stats.compiled) == {
        "internal forces",
        "tangent",
        "strain energy",
        "inverted sections",
        "mass",
    }
    assert set(stats.assembled) == {"distributed mass", "distributed rotary inertia"}
    assert stats.unknowns == 3 * 9 - 2


def test_what_a_scene_has_is_named():
    scene, arm, leg = frame()
    scene.add_line_load(leg, (1.0, 0.0))
    scene.add_line_load(arm, (1.0, 0.0))
    scene.add_virtual_work(lambda step: -0.1 * step.omega * step.virtual_psi)
    stats = fb.simulate(scene, dt=0.01, t_end=0.01).stats
    assert {"added virtual work", "mass"} < set(stats.compiled)
    assert len(stats.compiled) == len(set(stats.compiled))
    assert set(stats.assembled) == {
        "distributed mass",
        "distributed rotary inertia",
        "gravity",
        f"force on {leg.end}",
        "line load on beam 'leg'",
        "line load on beam 'arm'",
    }


@pytest.mark.parametrize("degree", [1, 2])
def test_unknowns_are_three_for_each_node_less_the_supported_components(degree):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=3, degree=degree)
    scene.clamp(beam.start)
    scene.fix(beam.end, "y")
    scene.prescribe(beam.end, rotation=lambda t: t)
    stats = fb.simulate(scene, dt=0.01, t_end=0.01).stats
    assert stats.unknowns == 3 * (3 * degree + 1) - 3 - 1 - 1


def test_iterations_are_counted_step_by_step(framed):
    stats = framed[0].stats
    assert stats.steps == 10
    assert stats.halvings == 0
    # At least a correction and its confirmation.
    assert 2 * stats.steps <= stats.newton_iterations <= 25 * stats.steps
    assert sum(stats.ended_by.values()) == stats.steps
    assert set(stats.ended_by) <= {"increment", "round-off"}
    assert stats.seconds > 0
    assert stats.setup_seconds > 0


def test_every_part_of_a_halved_step_is_a_solve():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION)
    scene.pin(beam.start)
    # The mid-point rule would turn by 2 atan(5/2) = 2.4 rad in a step, beyond the bound of 2.
    scene.set_velocity(beam, lambda x, y: (0.0, 5.0 * x), spin=5.0)
    stats = fb.simulate(scene, dt=1.0, t_end=2.0).stats
    assert stats.steps == 2
    assert stats.halvings >= 1
    assert sum(stats.ended_by.values()) == stats.substeps == 4


# -- Runs that break off ---------------------------------------------------------------------


def test_a_failed_run_keeps_the_beginning_of_a_successful_one(tmp_path):
    def run(bad_after):
        scene, arm, leg = frame(degree=1)
        scene.add_moment(leg.end, lambda t: t if t < bad_after else math.nan)
        return fb.simulate(scene, dt=0.05, t_end=0.5), arm

    whole, _ = run(math.inf)
    with pytest.raises(fb.StepError) as caught:
        run(0.32)
    part = caught.value.solution
    assert len(part.t) == 7
    assert part.stats.steps == 6
    for name in set(HISTORIES) - {"X"}:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[:7])
    for name in ENERGIES:
        np.testing.assert_array_equal(getattr(part.energy, name), getattr(whole.energy, name)[:7])
    for name in ("arm", "leg"):
        np.testing.assert_array_equal(part.shape(name), whole.shape(name)[:7])
        np.testing.assert_array_equal(part.resultants(name).M, whole.resultants(name).M[:7])
    part.save(tmp_path / "part.npz")
    np.testing.assert_array_equal(fb.load(tmp_path / "part.npz").q, part.q)


@pytest.mark.exact_times
def test_an_interrupt_keeps_the_steps_before_it():
    def force(t):
        if t > 0.22:
            raise KeyboardInterrupt
        return 0.0, t

    scene, _, leg = frame(degree=1)
    scene.add_force(leg.end, force)
    with pytest.raises(KeyboardInterrupt) as caught:
        fb.simulate(scene, dt=0.05, t_end=0.5)
    solution = caught.value.solution
    assert solution.t == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2], abs=1e-15)
    assert abs(solution.displacement(leg.end)[-1]).max() > 0


# -- Words -----------------------------------------------------------------------------------


def slow_scene():
    """Takes longer than the two seconds after which a progress bar may appear."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION)

    def force(t):
        time.sleep(0.22)
        return 0.0, 0.0

    scene.add_force(beam.end, force)
    return scene


def test_nothing_is_written_where_no_terminal_is(capfd):
    solution = fb.simulate(slow_scene(), dt=0.1, t_end=0.5)
    assert solution.stats.seconds > 2
    assert capfd.readouterr() == ("", "")


def test_a_progress_bar_is_shown_to_those_who_ask(capfd):
    scene, _ = pendulum()
    fb.simulate(scene, dt=0.01, t_end=0.05, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert "5" in err


def test_a_solution_says_what_it_is(framed):
    text = repr(framed[0])
    assert "EnergyMomentum" in text
    assert "10 steps to t = 0.5" in text


# -- Refusals that name the thing --------------------------------------------------------------


@pytest.mark.parametrize("method", ["slide", "joint", "gap"])
def test_what_is_no_joint_is_refused(method, framed):
    with pytest.raises(ValueError, match="1 is not a joint of this solution; take the one"):
        getattr(framed[0], method)(1)


def test_a_beam_in_place_of_a_node_is_named_in_one_line(framed):
    solution, arm = framed[0], framed[0].beams["arm"]
    with pytest.raises(ValueError, match="^<Beam 'arm': .* is not a node; take one") as refused:
        solution.position(arm)
    assert len(str(refused.value)) < 200


def test_a_file_in_a_folder_that_does_not_exist_is_refused(framed, tmp_path):
    for write in (framed[0].save, framed[0].to_csv):
        with pytest.raises(ValueError, match="make the folder .*nowhere first"):
            write(tmp_path / "nowhere" / "run")


def test_nodes_of_a_table_need_names(framed, tmp_path):
    with pytest.raises(ValueError, match="must be a dict of nodes by the names"):
        framed[0].to_csv(tmp_path / "run.csv", [framed[0].beams["arm"].end])
