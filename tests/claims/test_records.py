"""What was not recorded is left out of files, and invalid options are refused."""

import csv
import pickle

import numpy as np
import pytest
from jointed import pair

import fx_beam as fb


def sprung(**options):
    """A pair of beams that swing on a sprung hinge."""
    scene, first, second, joint = pair("revolute", gravity=(0.0, -9.81), spring=fb.Spring(20.0))
    scene.pin(first.start)
    record = fb.Record(**options)
    return fb.simulate(scene, dt=0.02, t_end=0.2, record=record), second.end, joint


@pytest.mark.parametrize("left_out", ["motion", "rates", "forces"])
def test_a_record_without_a_part_is_saved_and_read(left_out, tmp_path):
    solution, node, joint = sprung(**{left_out: False})
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
            with pytest.raises(ValueError, match=f"{part} not recorded"):
                get(each)
    if left_out == "motion":
        with pytest.raises(ValueError, match="motion not recorded"):
            other.resultants("beam 1")
    else:
        assert (other.resultants("beam 1").M == solution.resultants("beam 1").M).all()


def test_a_table_has_the_columns_that_were_recorded(tmp_path):
    columns = {}
    for left_out in ("motion", "rates", "forces"):
        solution, node, _ = sprung(**{left_out: False})
        solution.to_csv(tmp_path / "run.csv", nodes={"tip": node})
        with open(tmp_path / "run.csv", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(solution.t)
        columns[left_out] = set(rows[0])
        energies = [float(row["energy springs"]) for row in rows]
        assert energies == pytest.approx(solution.energy.springs) and max(energies) > 0
    assert columns["forces"] - columns["rates"] == {f"tip {c} rate" for c in ("x", "y", "rotation")}
    assert columns["forces"] - columns["motion"] == {f"tip {c}" for c in ("x", "y", "rotation")}


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_springs_and_beams_have_their_energies_apart(solver):
    scene, first, second, joint = pair("prismatic", spring=fb.Spring(20.0, rest=0.3))
    scene.clamp(first.start)
    solution = fb.simulate(scene, dt=0.01, t_end=0.3, solver=solver)
    energy = solution.energy
    in_springs = 20.0 / 2 * (solution.slide(joint) - 0.3) ** 2
    assert energy.springs == pytest.approx(in_springs, rel=1e-9, abs=1e-12)
    assert energy.strain[0] == 0 < energy.strain.max()
    assert energy.total == pytest.approx(energy.kinetic + energy.strain + energy.springs)
    assert abs(energy.balance_error).max() < 1e-9 * energy.springs[0]
    assert pickle.loads(pickle.dumps(energy)).total == pytest.approx(energy.total)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"every": 0}, "every = 0 must be a positive whole number"),
        ({"every": 1.5}, "every = 1.5"),
        ({"every": True}, "every = True"),
        ({"every": np.nan}, "every = nan"),
        ({"motion": "no"}, "motion = 'no' must be True or False"),
        ({"rates": None}, "rates = None must"),
        ({"forces": 2}, "forces = 2 must"),
    ],
)
def test_an_invalid_record_is_refused(options, message):
    with pytest.raises(fb.SceneError, match=f"Record: {message}"):
        fb.Record(**options)


def test_flags_of_numpy_are_accepted():
    assert fb.Record(every=np.int64(2), motion=np.True_, rates=np.False_).every == 2


@pytest.mark.parametrize("pinned", [False, True])
def test_accelerations_at_the_start_are_those_of_the_run_whenever_they_are_read(pinned):
    lift = [20.0]

    def swing(scheme=None):
        scene = fb.Scene(gravity=(0.0, -9.81))
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
        if pinned:
            scene.pin(beam.start)
        scene.add_force(beam.end, lambda t: (0.0, lift[0]))
        scene.set_velocity(beam, lambda x, y: (0.0, x), spin=1.0)
        return fb.simulate(scene, scheme, dt=0.01, t_end=0.02)

    # Newmark's steps need them, so that they are known before the run.
    late, known = swing(), swing(fb.Newmark()).a[0]
    lift[0] = -1.0  # the function of the load gives another value from now on
    assert abs(late.a[0] - known).max() < 1e-12 * abs(known).max()
