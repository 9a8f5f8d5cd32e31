"""Rows that go to files as they come are those of a solution in memory."""

import errno
import os

import ufl

import numpy as np
import pytest
from scenes import assert_refused, grid, one_bar

import fx_beam as fb
from fx_beam.motions import run
from fx_beam.results import member_fields

SECTION = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3)
# What a solution has in memory beside the files.
IN_MEMORY = "t", "t_level", "reactions", "joint_forces", "motor_forces", "contact_forces", "slides"


def frame(cells, high, section=SECTION, **kind):
    """A lattice of struts, with its nodes by their places."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    return scene, grid(scene, cells, high, section, **kind)


def jointed():
    """A frame with bodies, springs, a damper, a motor, a slide, a pendulum and an obstacle."""
    scene, nodes = frame(3, 2)
    body = scene.add_body((3.5, 2.5), 3.0, 0.5, points={"a": (3, 2), "b": (4, 3)})
    spring, damper = fb.Spring(stiffness=30.0), fb.Damper(viscosity=0.5)
    scene.add_joint(fb.Revolute(nodes[3, 2], body["a"], spring=spring, damper=damper))
    other = scene.add_body((5.0, 3.0), 1.0, 0.1, points={"b": (4, 3)})
    scene.add_joint(fb.Revolute(body["b"], other["b"], motor=lambda t: 0.5 * t**2))
    arm = scene.add_beam([(3, 0), (6, -1)], SECTION, elements=6)
    scene.add_joint(fb.Revolute(nodes[3, 0], arm.start))
    block = scene.add_body((0.0, 2.0), 2.0, 0.3)
    spring = fb.Spring(stiffness=200.0)
    scene.add_joint(fb.Prismatic(nodes[0, 2], block.centre, axis=(0, 1), spring=spring))
    scene.add_force_between(nodes[0, 0], arm.end, spring=fb.Spring(stiffness=40.0))
    scene.clamp(nodes[0, 0])
    scene.pin(nodes[1, 0])
    scene.add_contact(arm, fb.Line((0.0, -1.3), (0.0, 1.0)), stiffness=1e4)
    return scene


def yielding():
    """A section that yields in bending."""

    def energy(eps, gamma, kappa, a):
        return 1e5 / 2 * (eps**2 + gamma**2) + 25 * (kappa - a[0]) ** 2 + 5 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = 50 * (strains[2] - old[0]) - 10 * old[0]
        return [old[0] + ufl.sign(trial) * ufl.max_value(abs(trial) - 2.0, 0) / 60]

    own = fb.InternalVariables(("plastic curvature",), flow)
    return fb.Section(strain_energy=energy, internal=own, rhoA=1.0, rhoI=1e-3)


def held(section=SECTION):
    """A frame under its weight, with a support that is moved."""
    scene, nodes = frame(3, 3, section, elements=2)
    for i in range(4):
        scene.clamp(nodes[i, 0])
    scene.prescribe(nodes[3, 3], x=lambda t: 0.2 * t)
    scene.add_force(nodes[0, 3], (3.0, 0.0))
    return scene


def flung(spin=3.0):
    """A free bow of degree 2, which is cut within, and turns."""
    scene, bow = one_bar(fb.arc((1, 0), (0, 1), (-1, 0)), SECTION, elements=12, degree=2)
    scene.set_velocity(bow, lambda x, y: (-spin * y, spin * x), spin)
    scene.add_force(bow.end, lambda t: (0.0, 5 * t))
    return scene


def motion(make, scheme=None, **options):
    """The motion of a scene."""
    return fb.simulate(make(), scheme, **{"dt": 0.01, "t_end": 0.1} | options)


#: Solutions by name.
CASES = {
    "jointed": lambda **o: motion(jointed, **o),
    "flung": lambda **o: motion(flung, fb.EnergyMomentum(order=4), **o),
    "flung with a tolerance": lambda **o: motion(flung, tolerance=1e-4, **o),
    "decaying": lambda **o: motion(jointed, fb.EnergyDecaying(), **o),
    "yielding": lambda **o: motion(lambda: held(yielding()), **o),
}


@pytest.fixture
def few(monkeypatch):
    """Rows are written after a few steps."""
    monkeypatch.setattr(run, "_BLOCK", 400)
    monkeypatch.setattr(member_fields, "_NUMBERS", 100)


def grids(file):
    """Times, and the grid at each, in turn."""
    pv = pytest.importorskip("pyvista")
    reader = pv.get_reader(str(file))
    for t in reader.time_values:
        reader.set_active_time_value(t)
        (grid,) = reader.read()
        yield t, grid


OPTIONS = {
    "jointed": {},
    "decaying": {"every": 3},
    "flung": {"rates": False},
    "flung with a tolerance": {},
    "yielding": {},
}


@pytest.mark.plot
@pytest.mark.parametrize("name", OPTIONS)
def test_files_have_the_rows_and_the_solution_all_else(name, few, tmp_path):
    kinds = OPTIONS[name]
    whole = CASES[name](record=fb.Record(**kinds))
    whole.to_paraview(tmp_path / "whole.pvd")
    computed = CASES[name](record=fb.Record(file=tmp_path / "rows.pvd", **kinds))
    rows, wanted = (list(grids(tmp_path / f"{name}.pvd")) for name in ("rows", "whole"))
    assert [t for t, _ in rows] == [t for t, _ in wanted]
    for (_, one), (_, other) in zip(rows, wanted, strict=True):
        assert one.point_data.keys() == other.point_data.keys()
        for kind in other.point_data:
            np.testing.assert_array_equal(one[kind], other[kind])
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.cell_data["beam"], other.cell_data["beam"])
    files = [sorted(tmp_path.glob(f"{name}/*.vtu")) for name in ("rows", "whole")]
    for row, wanted_row in zip(*files, strict=True):
        assert row.read_bytes() == wanted_row.read_bytes()
    assert not list(tmp_path.glob("*/.*"))
    for kind in IN_MEMORY:
        np.testing.assert_array_equal(getattr(computed, kind), getattr(whole, kind))
    for kind, values in vars(whole.energy).items():
        np.testing.assert_array_equal(getattr(computed.energy, kind), values)


def test_a_motion_goes_on_from_its_end_also_from_the_file(few, tmp_path):
    scene, file = jointed(), tmp_path / "rows.pvd"
    whole = fb.simulate(scene, dt=0.01, t_end=0.2)
    first = fb.simulate(scene, dt=0.01, t_end=0.1, record=fb.Record(file=file))
    for start in (first, fb.load(tmp_path / "rows" / "end.npz")):
        rest = fb.simulate(scene, dt=0.01, t_end=0.2, start=start)
        assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-13
        # The work is 0.05 J in a motion of 740 J, whose round-off it has.
        round_off = 1e-15 * whole.energy.total.max()
        assert abs(rest.energy.work[-1] - whole.energy.work[-1]) < round_off


def test_what_is_in_the_file_is_said_where_it_is_asked_for(tmp_path):
    file = tmp_path / "rows.pvd"
    computed = CASES["flung"](record=fb.Record(file=file))
    assert computed.stats.file == str(file)
    for ask in (
        lambda: computed.position(next(iter(computed.beams.values())).end),
        lambda: computed.resultants(next(iter(computed.beams))),
        lambda: fb.plot.shapes(computed, rows=[0]),
    ):
        assert_refused(r"motion not in memory: the rows are in .*rows.pvd", ask, error=ValueError)


def test_steps_before_a_failure_are_in_the_file(few, tmp_path):
    def load(t):
        if t > 0.055:
            raise ValueError("no such load")
        return 0.0, 1.0

    scene = held()
    scene.add_force(scene.beams[0].end, load)
    with pytest.raises(fb.StepError) as caught:
        fb.simulate(scene, dt=0.01, t_end=0.1, record=fb.Record(file=tmp_path / "rows.pvd"))
    text = (tmp_path / "rows.pvd").read_text()
    assert text.count("DataSet ") == len(caught.value.solution.t) == 6


def test_a_disk_full_from_the_start_is_named_and_rows_are_kept(few, tmp_path, monkeypatch):
    def write(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("fx_beam.results.member_fields.Grid.write", write)
    with pytest.raises(OSError, match="No space left on device") as stop:
        fb.simulate(held(), dt=0.01, t_end=0.1, record=fb.Record(file=tmp_path / "rows.pvd"))
    assert len(stop.value.solution.t) > 1 and stop.value.solution.has_motion


def test_what_a_file_cannot_have_is_refused(tmp_path):
    file, scene = tmp_path / "rows.pvd", held()
    for wrong in ({"times": [0.0, 0.1]}, {"motion": False}):
        assert_refused("a file needs", fb.Record, file=file, **wrong)
    with pytest.raises(ValueError, match="its name must end with .pvd"):
        fb.Record(file=tmp_path / "rows.vtk")
    record = fb.Record(file=file)
    with pytest.raises(fb.SceneError, match="not possible with until or changes"):
        fb.simulate(scene, dt=0.01, t_end=0.1, record=record, until=lambda t, y: t - 0.05)
    with pytest.raises(fb.SceneError, match="Motion: a record to a file is not possible"):
        fb.Motion(scene, dt=0.01, record=record)
    with pytest.raises(fb.SceneError, match="Response: a record to a file is not possible"):
        fb.Response(lambda x: (scene, {}), dt=0.01, t_end=0.1, record=record)
    bare = fb.Scene()
    bare.add_body((0, 0), 1.0, 0.1)
    assert_refused("needs beams", fb.simulate, bare, dt=0.01, t_end=0.1, record=record)
    assert not list(tmp_path.iterdir())
