"""What a solution holds: shapes, signs, files, tables, records, statistics, and what is left of a
run that breaks off."""

import csv
import inspect
import json
import pickle

import numpy as np
import pytest
from jointed import MEMBER as SECTION, pair
from scenes import assert_refused, clamped_bar, held_body, hinged_body, one_body, pinned_bar

import fx_beam as fb

MASSLESS = fb.Section(EA=1e4, GA=1e4, EI=100.0)
NODAL = ("q", "v", "a", "reactions")
HISTORIES = ("t", *NODAL, "linear_momentum", "angular_momentum")
ENERGIES = (
    *("kinetic", "strain", "potential", "work", "springs", "dissipated"),
    *("algorithmic", "numerical", "impact", "total", "balance_error"),
)


def frame():
    """Two beams that share a node, pinned, pushed and in motion."""
    scene, arm = pinned_bar((2, 0), SECTION, elements=3, degree=2, name="arm", gravity=(0.0, -9.81))
    leg = scene.add_beam([arm.end, (2, -1)], SECTION, elements=2, degree=2, name="leg")
    scene.add_force(leg.end, lambda t: (5.0, 10 * t))
    scene.set_velocity(arm, lambda x, y: (0.0, x), spin=1.0)
    return scene, arm, leg


@pytest.fixture(scope="module")
def framed():
    scene, arm, leg = frame()
    return fb.simulate(scene, dt=0.05, t_end=0.5), arm, leg


# -- Arrays ----------------------------------------------------------------------------------


def test_all_arrays_have_one_row_for_each_time(framed):
    solution, arm, leg = framed
    n, nodes = 11, 5 * 2 + 1
    assert solution.X.shape == (nodes, 2)
    shapes = {name: (n, nodes, 3) for name in NODAL} | {"t": (n,), "linear_momentum": (n, 2)}
    for name, shape in shapes.items():
        assert getattr(solution, name).shape == shape
        assert f"\n{name} : (n" in inspect.getdoc(fb.Solution)
    for name in ENERGIES:
        assert getattr(solution.energy, name).shape == (n,)
    for beam, elements in ((arm, 3), (leg, 2)):
        assert solution.shape(beam).shape == (n, elements * 2 + 1, 2)
        r = solution.resultants(beam)
        assert r.s.shape == (elements * 2,) and r.N.shape == r.Q.shape == r.M.shape == (
            n,
            *r.s.shape,
        )


def test_places_of_nodes_and_shapes_are_the_reference_and_the_displacement(framed):
    solution, arm, leg = framed
    for beam in (arm, leg):
        shape = solution.shape(beam)
        assert (shape == solution.shape(beam.name)).all()
        for k, node in enumerate(beam.nodes):
            place = np.array([node.x, node.y]) + solution.displacement(node)
            assert solution.position(node) == pytest.approx(place, abs=1e-15)
            assert (shape[:, 2 * k] == solution.position(node)).all()


def test_the_first_row_is_the_start(framed):
    solution, arm, leg = framed
    assert solution.t[0] == 0 and not solution.q[0].any() and not solution.reactions[0].any()
    assert solution.energy.strain[0] == solution.energy.work[0] == solution.energy.potential[0] == 0
    for node in arm.nodes:
        assert solution.velocity(node)[0] == pytest.approx([0, node.x], abs=1e-15)
        assert solution.spin(node)[0] == 1
    assert not solution.velocity(leg.end)[0].any()


def test_accelerations_at_the_start_are_those_of_the_run_whenever_they_are_read():
    lift = [20.0]

    def swing(scheme=None):
        scene, beam = pinned_bar((1, 0), SECTION, elements=2, gravity=(0.0, -9.81))
        scene.add_force(beam.end, lambda t: (0.0, lift[0]))
        scene.set_velocity(beam, lambda x, y: (0.0, x), spin=1.0)
        return fb.simulate(scene, scheme, dt=0.01, t_end=0.02)

    # Newmark's steps need them, so that they are known before the run.
    late, known = swing(), swing(fb.Newmark()).a[0]
    lift[0] = -1.0  # the function of the load gives another value from now on
    assert abs(late.a[0] - known).max() < 1e-12 * abs(known).max()


@pytest.mark.parametrize(
    ("dt", "t_end", "steps"),
    [(0.1, 0.3, 3), (0.01, 10, 1000), (1 / 3, 1, 3), (2, 4, 2), (0.1, 0.25, 3), (0.1, 0.301, 4)]
    + [(1e-9, 3e-9, 3)],
)
def test_times_are_multiples_of_the_step_up_to_the_end(dt, t_end, steps):
    scene = fb.Scene()
    scene.add_body((0, 0), 1.0, 0.1)
    solution = fb.simulate(scene, dt=dt, t_end=t_end)
    assert solution.stats.steps == len(solution.t) - 1 == steps
    assert solution.t[:-1] == pytest.approx(dt * np.arange(steps), rel=1e-15)
    assert solution.t[-1] == t_end
    assert 0 < np.diff(solution.t).min() and np.diff(solution.t).max() < dt * (1 + 1e-6)


def test_the_shorter_last_step_is_integrated_as_such():
    scene, body = one_body((0, 0), 1.0, 0.1, gravity=(0.0, -10.0))
    solution = fb.simulate(scene, dt=0.1, t_end=0.25)
    assert solution.displacement(body.centre)[:, 1] == pytest.approx(-5 * solution.t**2, abs=1e-13)


# -- Stress resultants -----------------------------------------------------------------------

GAUSS = {1: [0.0], 2: [-(3**-0.5), 3**-0.5], 3: [-(0.6**0.5), 0.0, 0.6**0.5]}


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_resultants_are_given_at_the_gauss_points_of_the_elements(degree):
    points = [(0, 0), (3, 0), (3, 1)]
    scene, beam = clamped_bar(points, MASSLESS, elements=[2, 1], degree=degree)
    middles, halves = np.array([0.75, 2.25, 3.5]), np.array([0.75, 0.75, 0.5])
    expected = (middles[:, None] + halves[:, None] * GAUSS[degree]).ravel()
    assert fb.static(scene, load_steps=1).resultants(beam).s == pytest.approx(expected, rel=1e-14)


def test_tension_is_positive_and_carries_the_weight_that_hangs_below():
    heavy = fb.Section(EA=1e5, GA=1e5, EI=100.0, rhoA=2.0)
    scene, beam = pinned_bar((0, -3), heavy, elements=3, gravity=(0.0, -9.81))
    scene.add_mass(beam.end, 5.0)
    solution = fb.static(scene, load_steps=1)
    r = solution.resultants(beam)
    # Constant over a two-node element, at its middle.
    assert r.N[-1] == pytest.approx(9.81 * (5.0 + 2.0 * (3 - r.s)), rel=1e-9)
    assert abs(r.Q[-1]).max() + abs(r.M[-1]).max() < 1e-9
    assert solution.reaction(beam.start)[-1, 1] == pytest.approx(9.81 * 11, rel=1e-9)


def test_resultants_belong_to_the_elements_of_their_beam():
    """A comb, pulled at its teeth: the mesh numbers its elements otherwise than the scene."""
    scene, spine = clamped_bar((0, 4), MASSLESS, elements=4)
    pull = {}
    for k in (3, 1, 4, 2):
        tooth = scene.add_beam([spine.nodes[k], (1, k)], MASSLESS, elements=2, name=f"tooth {k}")
        pull[k] = 1e-4 * k**2
        scene.add_force(tooth.end, (pull[k], 0.0))
    solution = fb.static(scene, load_steps=1)
    for k, force in pull.items():
        assert solution.resultants(f"tooth {k}").N[1] == pytest.approx([force] * 2, rel=1e-3)
    # Across the spine, to the left of its way, acts what pulls above.
    above = [sum(force for k, force in pull.items() if k > element) for element in range(4)]
    assert solution.resultants(spine).Q[1] == pytest.approx(-np.array(above), rel=1e-3)


# -- Files and tables ------------------------------------------------------------------------


def test_a_saved_solution_is_read_back_to_the_last_bit(framed, tmp_path):
    solution, arm, leg = framed
    solution.save(str(tmp_path / "run.data"))
    assert [path.name for path in tmp_path.iterdir()] == ["run.data"]  # the path as it was given
    loaded = fb.load(tmp_path / "run.data")
    for name in (*HISTORIES, "X"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(solution, name))
    for name in ENERGIES:
        np.testing.assert_array_equal(getattr(loaded.energy, name), getattr(solution.energy, name))
    assert loaded.stats == solution.stats and list(loaded.beams) == ["arm", "leg"]
    for beam in (arm, leg):
        own = loaded.beams[beam.name]
        assert (own.degree, own.elements, own.nodes) == (beam.degree, beam.elements, beam.nodes)
        assert (own.s == beam.s).all() and own.length == beam.length
        for key in (beam, own, beam.name):
            assert (loaded.shape(key) == solution.shape(beam)).all()
            for part in "sNQM":
                values = getattr(solution.resultants(beam), part)
                assert (getattr(loaded.resultants(key), part) == values).all()
        assert (loaded.spin(own.end) == solution.spin(beam.end)).all()
    loaded.save(tmp_path / "again.data")
    with np.load(tmp_path / "run.data") as one, np.load(tmp_path / "again.data") as two:
        assert one.files == two.files
        for name in one.files:
            np.testing.assert_array_equal(one[name], two[name])
            assert one[name].dtype.kind in "fiuU"  # no pickled objects


def write(path, content, framed):
    """Write a file that is no solution, or only half of one."""
    framed[0].save(path)
    if content == "text":
        path.write_text("t,x\n0,1\n")
    elif content == "cut off":
        path.write_bytes(path.read_bytes()[:-100])
    else:
        with np.load(path) as file:
            arrays = dict(file)
        if content == "other arrays":
            arrays = {"t": np.arange(3.0)}
        elif content == "pickle":
            arrays["meta"] = np.array([{"format": "fx_beam solution 2"}])
        elif content == "another version":
            meta = json.loads(str(arrays["meta"])) | {"format": "fx_beam solution 1"}
            arrays["meta"] = np.array(json.dumps(meta))
        else:
            del arrays[content]
        with open(path, "wb") as file:
            np.savez(file, **arrays)


def test_a_joint_of_a_scene_with_the_same_joints_in_another_order_is_refused(tmp_path):
    def built(places):
        scene = fb.Scene(gravity=(0.0, -9.81))
        beams = [scene.add_beam([(x, 0), (x + 1, 0)], SECTION, elements=1) for x in range(3)]
        scene.clamp(beams[0].start)
        pins = {x: fb.Revolute(beams[x].end, beams[x + 1].start) for x in places}
        return scene, {x: scene.add_joint(pin) for x, pin in pins.items()}

    (scene, pins), (_, again), (_, others) = map(built, [(0, 1), (0, 1), (1, 0)])
    solution = fb.simulate(scene, dt=0.05, t_end=0.1)
    solution.save(tmp_path / "run.npz")
    for known in (solution, fb.load(tmp_path / "run.npz")):
        for x in (0, 1):
            assert (known.joint(again[x]).force == solution.joint(pins[x]).force).all()
            with pytest.raises(ValueError, match="belongs to another scene; the joint of this"):
                known.joint(others[x])


WRONG = ["text", "cut off", "other arrays", "pickle", "another version", "X", "energy_work"]


@pytest.mark.parametrize("content", WRONG)
def test_a_file_that_is_no_solution_is_refused_by_its_name(content, framed, tmp_path):
    path = tmp_path / "wrong.npz"
    write(path, content, framed)
    assert_refused("wrong.npz is not a solution saved by fx_beam", fb.load, path, error=ValueError)


def test_a_table_holds_the_named_columns_to_the_last_bit(framed, tmp_path):
    solution, arm, leg = framed
    solution.to_csv(tmp_path / "run.csv", {"corner": arm.end, "tip": leg.end})
    with open(tmp_path / "run.csv", newline="", encoding="utf-8") as file:
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
    assert len(header) == len(set(header)) and set(table) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(table[name], values)


def test_resultants_that_need_rates_may_be_missing_in_files_and_copies(tmp_path):
    damped = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1, retardation=1e-3)
    scene, arm = clamped_bar((1, 0), damped, elements=1, gravity=(0.0, -9.81))
    options = {"dt": 0.02, "record": fb.Record(rates=False)}
    solution = fb.simulate(scene, fb.Newmark(), t_end=0.1, **options)
    solution.save(tmp_path / "run.npz")
    for other in (fb.load(tmp_path / "run.npz"), pickle.loads(pickle.dumps(solution))):
        assert (other.position(arm.end) == solution.position(arm.end)).all()
        more = fb.simulate(scene, fb.Newmark(), t_end=0.2, start=other, **options)
        joined = other.then(more)
        joined.save(tmp_path / "joined.npz")
        for each in (solution, other, more, joined):
            assert_refused("rates not recorded", each.resultants, arm, error=ValueError)


@pytest.mark.parametrize("left_out", ["motion", "rates", "forces"])
def test_what_is_not_recorded_is_in_no_file_and_no_table(left_out, tmp_path):
    scene, first, second, joint = pair("revolute", gravity=(0.0, -9.81), spring=fb.Spring(20.0))
    scene.pin(first.start)
    node = second.end
    solution = fb.simulate(scene, dt=0.02, t_end=0.2, record=fb.Record(**{left_out: False}))
    solution.save(tmp_path / "run.npz")
    other = fb.load(tmp_path / "run.npz")
    assert (other.energy.total == solution.energy.total).all()
    known = {
        "motion": lambda s: s.position(node),
        "rates": lambda s: s.velocity(node),
        "forces": lambda s: s.joint(joint).force,
    }
    for part, get in known.items():
        if part != left_out:
            assert (get(other) == get(solution)).all()
            continue
        for each in (solution, other):
            assert_refused(f"{part} not recorded", get, each, error=ValueError)
    if left_out == "motion":
        assert_refused("motion not recorded", other.resultants, "beam 1", error=ValueError)
    solution.to_csv(tmp_path / "run.csv", nodes={"tip": node})
    header = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert ("tip x" in header) == (left_out != "motion")
    assert ("tip rotation rate" in header) == (left_out != "rates")


# -- Statistics: only what the scene needs ---------------------------------------------------


def test_iterations_and_solves_are_counted_also_of_halved_steps(framed):
    stats = framed[0].stats
    assert stats.steps == sum(stats.ended_by.values()) == 10 and stats.halvings == 0
    # At least a correction and its confirmation.
    assert 2 * stats.steps <= stats.newton_iterations <= 25 * stats.steps
    assert set(stats.ended_by) <= {"increment", "round-off"}
    assert stats.seconds > 0 and stats.setup_seconds > 0
    scene, arm, _ = hinged_body((1, 0), 1.0, 0.1, {"pin": (0, 0)})
    # The mid-point rule would turn by 2 atan(5/2) = 2.4 rad in a step, beyond the bound of 2.
    scene.set_velocity(arm, lambda x, y: (0.0, 5.0 * x), spin=5.0)
    stats = fb.simulate(scene, dt=1.0, t_end=2.0).stats
    assert stats.steps == 2 and stats.halvings >= 1
    assert sum(stats.ended_by.values()) == stats.substeps == 4


# -- Runs that break off, and words ----------------------------------------------------------


def test_times_of_rows_may_be_a_column_of_a_table():
    column = pytest.importorskip("pandas").Series([0.05, 0.1])
    record = fb.Record(times=column)
    assert fb.simulate(frame()[0], dt=0.05, t_end=0.2, record=record).t.tolist() == [0.05, 0.1]


def test_times_that_are_ends_of_steps_but_for_round_off_belong_to_these():
    """0.1 k and k / 10 differ in the last digit; the last one may lie behind the end."""
    scene, ball = held_body((0, 0), 1.0, 1.0)
    scene.add_force(ball, lambda t: (1.0 if t <= 0.3 else 0.0, 0.0))
    times = 0.1 * np.arange(8)
    motion = fb.simulate(scene, dt=0.01, t_end=0.7, record=fb.Record(times=times))
    assert motion.t == pytest.approx(times, abs=1e-12)
    # The forces of a row are those of the step that ends there.
    assert (motion.t_level[1:] < motion.t[1:]).all()
    assert motion.acceleration(ball)[3, 0] == pytest.approx(1.0)
