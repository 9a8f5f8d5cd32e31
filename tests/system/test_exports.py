"""What other programs read: ParaView's files, tables of pandas and xarray, HTML in notebooks."""

import importlib.util

import numpy as np
import pytest
from scenes import FLYING, clamped_bar

import fx_beam as fb
from fx_beam.results.member_fields import along_all, energy_density


def frame(degree=2):
    """A clamped arm with a curved leg on a hinge, which falls."""
    scene, arm = clamped_bar((1, 0), FLYING, 4, degree, name="arm", gravity=(0.0, -9.81))
    leg = scene.add_beam(fb.arc((1, 0), (1.5, -0.2), (2, -1)), FLYING, 3, degree, name="leg")
    scene.add_joint(fb.Revolute(arm.end, leg.start))
    scene.add_mass(leg.end, 2.0)
    return scene, arm, leg


def fall(degree=2, **options):
    return fb.simulate(frame(degree)[0], **{"dt": 0.02, "t_end": 0.2} | options)


# -- Fields along members ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("curved", "off", "degree"), [(False, 1e-9, 1), (False, 1e-9, 2), (True, 5e-3, 2)]
)
def test_the_stored_energy_along_the_members_adds_up_to_that_of_the_solution(curved, off, degree):
    points = fb.arc((0, 0), (1, 0.2), (2, 0)) if curved else [(0, 0), (1, 0.2), (2, 0)]
    scene, beam = clamped_bar(points, FLYING, 6, degree, name="arm", gravity=(0.0, -9.81))
    scene.add_natural_strain(beam, axial=1e-3, curvature=0.05)
    solution, rows = fb.simulate(scene, dt=0.02, t_end=0.2), [4, 10]
    # Of a curve the lengths along it are taken, which those of its elements come near to.
    weights = np.outer(np.diff(beam.s), np.polynomial.legendre.leggauss(degree)[1] / 2)
    total = np.einsum("rep,ep->r", energy_density(solution, rows), weights)
    assert (total > 1e-3).all()
    assert total == pytest.approx(solution.energy.strain[rows], rel=off)


def test_an_own_stored_energy_is_evaluated_along_the_members():
    def energy(eps, gamma, kappa):
        return 5e3 * eps**2 + 5e3 * gamma**2 + 50.0 * kappa**2

    own = fb.Section(strain_energy=energy, rhoA=FLYING.rhoA, rhoI=FLYING.rhoI)
    values = []
    for section in (FLYING, own):
        scene, arm = clamped_bar((1, 0), section, 3, name="arm", gravity=(0.0, -9.81))
        solution = fb.simulate(scene, dt=0.02, t_end=0.1)
        values.append(along_all(solution, ["strain energy"], [5], np.array([0.5]))["strain energy"])
    assert values[0] == pytest.approx(values[1], rel=1e-6)


@pytest.mark.parametrize("degree", [1, 2])
def test_fields_pass_through_the_nodes_and_the_gauss_points(degree):
    solution, rows = fall(degree), range(11)
    leg = slice(4, None)  # its elements follow those of the arm
    ends = along_all(solution, ["speed"], rows, np.array([0.0, 1.0]))["speed"][:, leg]
    tip = np.hypot(*solution.velocity(solution.beams["leg"].end).T)
    assert ends[:, -1, 1] == pytest.approx(tip, abs=1e-14)
    gauss = (np.polynomial.legendre.leggauss(degree)[0] + 1) / 2
    computed = along_all(solution, ["M"], rows, gauss)["M"][:, leg].reshape(11, -1)
    resultants = solution.resultants("leg")
    # In the middle of an element of degree 1 lies the top of a parabola.
    own = resultants.M if degree > 1 else resultants.at(resultants.s).M
    assert computed == pytest.approx(own, abs=1e-9)


def test_the_energy_along_members_of_a_saved_solution_is_refused(tmp_path):
    fall().save(tmp_path / "run.npz")
    with pytest.raises(ValueError, match="needs its section, which a saved file does not hold"):
        along_all(fb.load(tmp_path / "run.npz"), ["strain energy"], [0], np.array([0.5]))


# -- ParaView ----------------------------------------------------------------------------------


@pytest.mark.plot
@pytest.mark.parametrize(("source", "degree"), [("computed", 3), ("saved", 1)])
def test_paraview_files_hold_what_the_solution_has(degree, source, tmp_path):
    pv = pytest.importorskip("pyvista")
    solution = fall(degree)
    if source == "saved":
        solution.save(tmp_path / "run.npz")
        solution = fb.load(tmp_path / "run.npz")
    solution.to_paraview(tmp_path / "run.pvd")
    reader = pv.get_reader(str(tmp_path / "run.pvd"))
    np.testing.assert_array_equal(reader.time_values, solution.t)
    for k in (0, 10):
        reader.set_active_time_value(reader.time_values[k])
        (grid,) = reader.read()
        assert grid.n_cells == 7 and grid.n_points == 7 * (degree + 1)
        assert sorted(set(grid.cell_data["beam"])) == [0, 1]
        pieces = np.arange(0, 12, degree)[:, None] + np.arange(degree + 1)
        ends = (n[pieces[: (len(n) - 1) // degree]] for n in solution.nodes_of_beam.values())
        nodes = np.concatenate([*map(np.ravel, ends)])
        np.testing.assert_array_equal(grid.points[:, :2], solution.X[nodes])
        data = grid.point_data
        np.testing.assert_array_equal(data["displacement"][:, :2], solution.q[k][nodes, :2])
        np.testing.assert_array_equal(data["rotation"], solution.q[k][nodes, 2])
        np.testing.assert_array_equal(data["velocity"][:, :2], solution.v[k][nodes, :2])
        np.testing.assert_array_equal(data["spin"], solution.v[k][nodes, 2])
        for kind in "NQM":
            values, first = data[kind].reshape(7, degree + 1), 0
            for name, beam in solution.beams.items():
                rows = values[first : (first := first + beam.elements)]
                resultants = solution.resultants(name)
                starts, ends = resultants.at(beam.s[:-1]), resultants.at(beam.s[1:], "before")
                assert rows[:, 0] == pytest.approx(getattr(starts, kind)[k], abs=1e-9)
                assert rows[:, -1] == pytest.approx(getattr(ends, kind)[k], abs=1e-9)


# -- Tables ------------------------------------------------------------------------------------


def test_a_table_of_pandas_has_the_columns_of_the_csv_file(tmp_path):
    pandas = pytest.importorskip("pandas")
    solution = fall()
    nodes = {"tip": solution.beams["leg"].end}
    table = solution.to_pandas(nodes)
    solution.to_csv(tmp_path / "run.csv", nodes)
    pandas.testing.assert_frame_equal(table, pandas.read_csv(tmp_path / "run.csv", index_col="t"))
    np.testing.assert_array_equal(table["tip y rate"], solution.velocity(nodes["tip"])[:, 1])


def test_arrays_of_xarray_bear_the_names_of_their_axes():
    pytest.importorskip("xarray")
    solution = fall()
    computed = solution.to_xarray()
    tip = solution.beams["leg"].end
    y = computed["q"].sel(node=tip.number, component="y")
    np.testing.assert_array_equal(y, solution.displacement(tip)[:, 1])
    np.testing.assert_array_equal(computed["M leg"], solution.resultants("leg").M)
    assert computed["M leg"].dims == ("t", "s leg")
    np.testing.assert_array_equal(computed["energy total"], solution.energy.total)
    bare = fall(record=fb.Record(motion=False, rates=False)).to_xarray()
    assert not {"q", "v", "M leg"} & set(bare)


def hung():
    """A bar on a hinge, a support, a rope, a spring, a peg and a gear, with its parts by names."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section.rectangle(0.02, 0.02, **fb.materials.steel)
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=4, name="arm")
    foot, wheel = scene.add_body((0, 0), 1.0, 0.1), scene.add_body((0, -1), 1.0, 0.1)
    scene.clamp(foot.centre)
    axle = scene.add_joint(fb.Revolute(fb.GROUND, wheel.centre))
    hinge = scene.add_joint(fb.Revolute(foot.centre, arm.start))
    return scene, {
        "foot": foot,
        "middle": arm.at(0.5),
        "hinge": hinge,
        "rope": scene.add_rope([(1, 1), arm.end], spring=fb.Spring(1e5), length=1.0),
        "spring": scene.add_spring(arm.end, x=fb.Spring(1e3)).x,
        "peg": scene.add_contact(arm.end, fb.Line((0, -1), (0, 1)), stiffness=1e5),
        "gear": scene.add_joint(fb.Gear(hinge, axle, ratio=-2.0)),
    }


@pytest.mark.parametrize("static", [False, True])
def test_tables_take_all_parts_of_a_scene_and_outputs_with_units(static, tmp_path):
    pandas = pytest.importorskip("pandas")
    scene, parts = hung()
    outputs = {
        "peak": fb.Output("stress", parts["middle"], edge="lower"),
        "moments": fb.Output("M", scene.beams[0]),
        "speed": fb.Output("velocity", scene.beams[0].end),
    }
    solution = fb.static(scene) if static else fb.simulate(scene, dt=1e-3, t_end=2e-3)
    table = solution.to_pandas(parts, outputs=outputs, energies=False)
    units = table.attrs["units"]
    for column, part, quantity, component, unit in (
        ("rope force", "rope", "force", None, "N"),
        ("rope length", "rope", "length", None, "m"),
        ("spring energy", "spring", "energy", None, "J"),
        ("hinge angle", "hinge", "angle", None, "rad"),
        ("hinge force y", "hinge", "force", "y", "N"),
        ("hinge force moment", "hinge", "force", "moment", "N m"),
        ("peg gap", "peg", "gap", None, "m"),
        ("gear force", "gear", "force", None, "N m"),
        ("middle M", "middle", "M", None, "N m"),
        ("middle y rate", "middle", "velocity", "y", "m/s"),
    ):
        expected = solution.value(fb.Output(quantity, parts[part], component))
        np.testing.assert_array_equal(table[column], expected)
        assert units[column] == unit
    reaction = solution.reaction(parts["foot"].centre)
    np.testing.assert_array_equal(table["foot reaction y"], reaction[:, 1])
    assert not any(name.startswith("middle reaction") for name in table)
    np.testing.assert_array_equal(table["peak"], solution.value(outputs["peak"]))
    np.testing.assert_array_equal(table["moments at 0.375"], solution.resultants("arm").M[:, 1])
    assert (units["peak"], units["speed x"]) == ("Pa", "m/s")
    with_energies = set(solution.to_pandas())
    assert ("energy total" in with_energies) is not static
    assert "energy total" in set(solution.to_pandas(energies=True))

    solution.to_csv(tmp_path / "run.csv", parts, outputs=outputs, energies=False, units=True)
    read = pandas.read_csv(tmp_path / "run.csv", header=[0, 1], index_col=0)
    assert dict(read.columns) == {name: units[name] for name in table}
    np.testing.assert_allclose(read.to_numpy(), table.to_numpy(), rtol=1e-12)


def test_columns_that_would_hide_others_and_what_is_no_part_are_refused():
    scene, parts = hung()
    solution = fb.simulate(scene, dt=1e-3, t_end=1e-3)
    twice = {"a": parts["rope"], "a force": parts["hinge"]}
    assert "a force angle" in solution.to_pandas(twice)
    with pytest.raises(fb.SceneError, match="'t'.*used once"):
        solution.to_pandas(outputs={"t": fb.Output("gap", parts["peg"])})
    with pytest.raises(fb.SceneError, match="a node, a body, a place"):
        solution.to_pandas({"arm": scene.beams[0]})
    pytest.importorskip("xarray")
    with pytest.raises(fb.SceneError, match="other names"):
        solution.to_xarray(outputs={"q": fb.Output("gap", parts["peg"])})
    computed = solution.to_xarray(parts, energies=False)
    assert computed["hinge force y"].attrs["units"] == "N"
    assert computed["M arm"].attrs["units"] == "N m" and computed["t"].attrs["units"] == "s"


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_a_missing_package_is_named_with_what_to_do(package, monkeypatch):
    solution = fall()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match=f"to_{package} needs {package}: pip install {package}"):
        getattr(solution, f"to_{package}")()
