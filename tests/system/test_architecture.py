"""Imports point one way, versions and drawing stay at the edge, files stay short."""

import ast
import functools
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import fx_beam

PACKAGE = Path(fx_beam.__file__).parent
# From the ground up. A room imports from the rooms before it only, and within a room a file imports
# from the files before it only.
HOUSE = {
    "": [
        "errors",
        "deprecation",
        "array_calls",
        "validation",
        "content_cache",
        "library_cache",
        "c_library",
        "structs",
    ],
    "scene": [
        "notebook",
        "symbols",
        "beam",
        "path",
        "curve",
        "inputs",
        "parameters",
        "step_symbols",
        "place_functions",
        "loads",
        "natural_strains",
        "internal_variables",
        "law",
        "section",
        "stop",
        "coulomb",
        "coordinate",
        "forces_between",
        "joint_kinematics",
        "joints",
        "constraints",
        "obstacles",
        "member_curve",
        "member_contact",
        "sliders",
        "summary",
        "geometry",
        "body",
        "removal",
        "scene",
        "outputs",
        "changes",
        "own_functions",
        "structure",
    ],
    "mechanics": [
        "interval",
        "kinematics",
        "exact_work",
        "rates",
        "nodal_rates",
        "resultants",
        "evolution",
        "decaying",
        "actuation",
        "retardation",
        "drag",
        "point_laws",
        "coordinates",
        "gaps",
        "member_gap",
        "scalar_laws",
        "node_laws",
        "schemes",
    ],
    "results": [
        "files",
        "audit",
        "state",
        "histories",
        "export",
        "fields",
        "grids",
        "piece",
        "paraview",
        "tables",
        "summary",
        "lookup",
        "beam_histories",
        "joint_motion",
        "contact",
        "joined",
        "stability",
        "solution",
        "saved_arrays",
        "saved",
    ],
    "fem": [
        "mpi",
        "elements",
        "ffcx_api",
        "interval_mesh",
        "dolfinx_api",
        "point_functions",
        "nodal_rules",
        "compiled_laws",
        "follower_loads",
        "step_start",
        "parameter_values",
        "mesh",
        "member_contacts",
        "point_forces",
        "scene_forces",
        "section_fields",
        "fields",
        "free_nodes",
        "virtual_works",
        "weak_form",
        "pulled_form",
        "resultant_derivatives",
        "beam_drag",
        "natural_fields",
        "beam_forms",
        "forms",
        "mass",
        "line_forces",
        "dead_loads",
        "natural_strains",
    ],
    "coupling": [
        "sliding_order",
        "forest",
        "graph",
        "tied_order",
        "sliding",
        "index_reduction",
        "ties",
        "sliders",
        "joint_reduction",
        "gap_borders",
        "closed_pattern",
        "gap_rows",
        "loop_reduction",
        "rate_equations",
        "path_derivatives",
        "beam_rates",
        "rate_derivatives",
        "rigid_points",
        "rate_masses",
        "fitted_rates",
        "redundancy",
        "mechanism_check",
    ],
    "algebra": ["lu_layout", "sparse_lu", "symmetry", "kept_factors", "petsc_lu"],
    "model": ["model", "joint_forces", "turning_frame", "equations"],
    "stepping": [
        "interrupts",
        "forcing",
        "held_inputs",
        "mass_solver",
        "massless_start",
        "coupled_rates",
        "initial_state",
        "sub_step_starts",
        "fitted_histories",
        "recorded_histories",
        "recorder",
        "interpolation",
        "linear_solver",
        "line_search",
        "newton",
        "single_step",
        "substeps",
        "inverted_sections",
        "events",
        "step_control",
        "local_error",
        "python_loop",
        "stepper",
        "smooth_start",
        "single_stepper",
        "tolerance",
        "adaptive_run",
        "bordered",
        "path_equations",
        "inertia",
        "load_steps",
        "settling",
        "arc_length",
        "branch_step",
        "full_turns",
    ],
    "compiled": [
        "build",
        "kernels",
        "element_data",
        "form_tables",
        "border_tables",
        "tangent_storage",
        "handover",
        "tape",
        "static_tape",
        "loop",
        "single_steps",
        "pulled_work",
        "adjoint",
        "forward",
        "batched_beams",
    ],
    "parallel": [
        "own_functions",
        "team",
        "share",
        "accuracy",
        "linear_system",
        "partition",
        "part",
        "whole",
    ],
    "analyses": [
        "evaluation",
        "open_record",
        "progress",
        "mpi_ranks",
        "carried_state",
        "run_setup",
        "row_files",
        "kept_setup",
        "fitted_state",
        "measurement",
        "ending",
        "changing_scene",
        "contact_check",
        "bend_check",
        "step_warnings",
        "repeated_motion",
        "dynamics",
        "static_path",
        "snapshot",
        "open_motion",
        "motion",
        "convergence",
        "undamped_modes",
        "damped_modes",
        "linearisation",
        "equilibrium_check",
        "modal",
        "imperfection",
        "small_motions",
        "branches",
        "path_piece",
        "critical_points",
        "path_stability",
        "statics",
        "moving_state",
        "first_order",
        "linear_system",
        "harmonic",
        "rayleigh",
        "workers",
        "journal",
        "sweep",
    ],
    "responses": [
        "numbers",
        "gradient",
        "natural_gradients",
        "linear_outputs",
        "energy_gradients",
        "resultant_outputs",
        "step_losses",
        "work_outputs",
        "static_derivatives",
        "objectives",
        "output_values",
        "row_outputs",
        "built_scenes",
        "observation",
        "response",
        "static_response",
    ],
    "orbits": [
        "shooting",
        "closing",
        "floquet",
        "periodic_motion",
        "periodic_family",
        "mode_start",
        "mode_family",
        "periodic_search",
        "backbone",
        "forced_response",
    ],
    "plot": [
        "digits",
        "obstacles",
        "drawing",
        "slide_direction",
        "supports",
        "symbols",
        "plane",
        "members",
        "time_curves",
        "colouring",
        "frames",
        "deformed_shapes",
        "animations",
        "mode_shapes",
        "browser_page",
        "force_diagrams",
        "sheet",
        "actions",
        "scene_drawing",
        "response_curves",
        "load_paths",
        "",
    ],
    "studies": ["reporting", "candidates"],
    "studies.work_precision": [
        "accuracy",
        "precision",
        "picture",
        "fronts",
        "report",
        "runner",
        "",
    ],
    "studies.stability": [
        "verdict",
        "case",
        "picture",
        "report",
        "runner",
        "",
    ],
    "__main__": [""],
}
# The room itself, "", is its __init__.py.
ORDER = [".".join(filter(None, (room, file))) for room, files in HOUSE.items() for file in files]


def _name(path):
    """Dotted name of a file in the package; of an __init__.py that of its folder."""
    return (
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        .removesuffix("__init__")
        .strip(".")
    )


SOURCES = {_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}
#: The face of the package and of rooms which only say what is in them.
FACES = {"", *(room for room, files in HOUSE.items() if room and "" not in files)}


@functools.cache
def imports(module):
    """Dotted names of all modules that a module imports, inside functions as well."""
    path, names = SOURCES[module], set()
    room = ["fx_beam", *path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level < 2, "a file outside the room is named in full"
            home = ".".join(filter(None, (room if node.level else []) + [node.module]))
            for alias in node.names:
                below = f"{home}.{alias.name}".removeprefix("fx_beam.")
                names.add(f"{home}.{alias.name}" if below in SOURCES else home)
    return names


def own_imports(module):
    """Names of the package's modules that a module imports."""
    return {
        name.removeprefix("fx_beam").strip(".")
        for name in imports(module)
        if name.split(".")[0] == "fx_beam"
    }


def foreign_imports(module):
    """Names of the packages outside the standard library and this one that a module imports."""
    packages = {name.split(".")[0] for name in imports(module)}
    return packages - set(sys.stdlib_module_names) - {"fx_beam"}


def room_of(module):
    """The room of a file."""
    return max((room for room in HOUSE if f"{module}.".startswith(f"{room}.") and room), default="")


# -- The direction of imports ----------------------------------------------------------------


def test_every_module_has_its_place():
    assert set(SOURCES) == set(ORDER) | FACES, "name it in HOUSE, above all that it imports"
    assert len(ORDER) == len(set(ORDER))


def test_imports_point_downwards():
    above = {m: own_imports(m) - set(ORDER[: ORDER.index(m)]) for m in ORDER}
    assert {module: names for module, names in above.items() if names} == {}


def test_rooms_say_what_they_hold_and_nothing_else():
    for module in FACES - {""}:
        assert [type(node) for node in TREES[module].body] == [ast.Expr], module


def test_pictures_are_imported_by_what_writes_reports_only():
    drawing = {module for module in SOURCES if "plot" in own_imports(module)}
    assert {module.rpartition(".")[2] for module in drawing} <= {"picture", "fronts", "report"}


def test_the_model_knows_nothing_of_solutions():
    between = [
        m
        for room in ("fem", "coupling", "model", "stepping")
        for m in SOURCES
        if room_of(m) == room
    ]
    assert [m for m in between if "results.solution" in own_imports(m)] == []


# -- The edges -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("packages", "home"),
    [
        ({"mpi4py"}, {"fem.mpi"}),
        ({"dolfinx", "basix"}, {"fem.dolfinx_api", "fem.interval_mesh", "fem.elements"}),
        ({"ffcx"}, {"fem.ffcx_api"}),
        ({"petsc4py"}, {"fem.mpi"}),
        ({"slepc4py"}, set()),
        (
            {"matplotlib"},
            {
                "plot.time_curves",
                "plot.symbols",
                "plot.plane",
                "plot.members",
                "plot.colouring",
                "plot.deformed_shapes",
                "plot.animations",
                "plot.mode_shapes",
                "plot.force_diagrams",
                "plot.sheet",
                "plot.scene_drawing",
            },
        ),
        ({"pyvista", "vtk", "vtkmodules"}, {"plot.deformed_shapes"}),
        ({"PIL", "imageio_ffmpeg"}, {"plot.frames"}),
        ({"tqdm"}, {"analyses.progress"}),
        ({"pandas", "xarray"}, {"results.tables"}),
        ({"scooby", "tabulate"}, {"studies.reporting"}),
    ],
    ids=[
        *("mpi4py", "dolfinx", "ffcx", "petsc4py", "slepc4py", "matplotlib", "pyvista"),
        *("PIL", "tqdm", "pandas", "reports"),
    ],
)
def test_each_library_is_called_from_one_place(packages, home):
    assert {module for module in SOURCES if foreign_imports(module) & packages} == home


def test_physics_and_data_need_numpy_and_ufl_only():
    # scipy: splines, and the root of an arc length; tables are made on request
    more = {"scene.curve": {"scipy"}, "results.tables": {"pandas", "xarray"}}
    for module in SOURCES:
        if room_of(module) in ("scene", "mechanics", "results"):
            assert foreign_imports(module) <= {"numpy", "ufl"} | more.get(module, set()), module


def test_importing_the_package_imports_no_library_for_pictures_and_no_study():
    code = "import sys, fx_beam; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(done.stdout.split())
    assert "fx_beam.analyses.dynamics" in loaded
    assert not loaded & {"matplotlib", "pyvista", "vtkmodules", "imageio", "fx_beam.plot"}
    assert not loaded & {"pandas", "xarray"}
    assert not loaded & {"fx_beam.studies.work_precision", "fx_beam.studies.stability"}


def test_studies_import_no_library_for_reports():
    code = "import sys, fx_beam; fx_beam.work_precision, fx_beam.stability; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=PACKAGE.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(done.stdout.split())
    assert {"fx_beam.studies.work_precision", "fx_beam.studies.stability"} <= loaded
    assert not loaded & {"matplotlib", "pyvista", "scooby", "tabulate"}


def test_pictures_and_studies_are_had_from_the_package_and_nothing_else_is():
    assert fx_beam.work_precision.study and fx_beam.stability and fx_beam.plot.curves
    assert {"plot", "stability", "work_precision", "Scene", "modes"} <= set(dir(fx_beam))
    with pytest.raises(AttributeError, match="workprecision"):
        fx_beam.workprecision  # noqa: B018


def test_versions_are_asked_for_in_one_place_only():
    # The last one prints them.
    for module in set(SOURCES) - {"fem.dolfinx_api", "fem.elements", "fem.ffcx_api", "__main__"}:
        asked = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
        assert not asked & {"__version__", "version_info", "hexversion"}, module
        assert not foreign_imports(module) & {"packaging", "pkg_resources"}, module


def test_no_import_is_optional():
    for module, tree in TREES.items():
        handlers = [node for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler)]
        caught = " ".join(ast.unparse(h.type) for h in handlers if h.type is not None)
        assert "ImportError" not in caught and "ModuleNotFound" not in caught, module


def test_no_public_name_hides_a_module():
    for room in ("", "plot", "studies.work_precision", "studies.stability"):
        public = set(importlib.import_module(f"fx_beam.{room}".rstrip(".")).__all__)
        files = {name.rpartition(".")[2] for name in SOURCES if name.rpartition(".")[0] == room}
        assert not public & files


# -- Size and manners ------------------------------------------------------------------------


def code_lines(module):
    """Numbers of the lines of a file that have code: no blank lines, comments or docstrings."""
    texts = {
        line
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for line in range(node.lineno, node.end_lineno + 1)
    }
    lines = enumerate(SOURCES[module].read_text(encoding="utf-8").splitlines(), 1)
    return {n for n, line in lines if line.strip() and not line.strip().startswith("#")} - texts


def test_no_file_needs_what_is_private_in_another():
    """Else the two are one concept that was cut."""
    tuples, outside = {"_replace", "_asdict", "_fields"}, {"os._exit", "sys._getframe"}
    for module, tree in TREES.items():
        nodes = list(ast.walk(tree))
        own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        own |= {node.attr for node in nodes if isinstance(node, ast.Attribute) and _stored(node)}
        own |= {node.id for node in nodes if isinstance(node, ast.Name) and _stored(node)}
        read = [node for node in nodes if isinstance(node, ast.Attribute) and not _stored(node)]
        names = {
            ast.unparse(node)
            for node in read
            if node.attr.startswith("_") and not node.attr.startswith("__")
            if node.attr not in own | tuples and ast.unparse(node.value) not in ("self", "cls")
        }
        names |= {
            alias.name
            for node in nodes
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.name.startswith("_")
        }
        foreign = {name for name in names - outside if not name.endswith("._cpp_object")}
        assert foreign == set(), module


def _stored(node):
    return isinstance(node.ctx, ast.Store)


def test_files_are_of_one_concept():
    """By their code; what explains it is not counted, so that it need not be cut."""
    sizes = {module: len(code_lines(module)) for module in SOURCES}
    assert {module: size for module, size in sizes.items() if size > 400} == {}


def test_nothing_is_printed():
    for module, tree in TREES.items():
        calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        assert "print" not in calls, module


def test_source_is_ascii():
    assert [m for m, path in SOURCES.items() if not path.read_text("utf-8").isascii()] == []


# -- The door --------------------------------------------------------------------------------


def test_the_public_names_are_all_that_the_package_imports():
    imported = {
        alias.asname or alias.name
        for node in TREES[""].body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert set(fx_beam.__all__) == imported
    assert len(fx_beam.__all__) == len(set(fx_beam.__all__))
    for name in fx_beam.__all__:
        assert not inspect.ismodule(getattr(fx_beam, name))


def test_the_public_names_cover_all_that_a_scene_and_a_solution_are_made_of():
    assert {
        "EnergyDecaying",
        "EnergyMomentum",
        "GeneralizedAlpha",
        "HHT",
        "MidPoint",
        "ModifiedMidPoint",
        "Newmark",
        "Scene",
        "SceneError",
        "Section",
        "Solution",
        "StepError",
        "load",
        "simulate",
    } <= set(fx_beam.__all__)
    for module in (
        "scene.section",
        "mechanics.schemes",
        "scene.scene",
        "results.solution",
        "errors",
        "results.audit",
        "scene.beam",
        "scene.curve",
        "mechanics.rates",
    ):
        source = sys.modules[f"fx_beam.{module}"]
        defined = {name for name, value in vars(source).items() if inspect.isclass(value)}
        own = {name for name in defined if getattr(source, name).__module__ == source.__name__}
        public = {name for name in own if not name.startswith("_")}
        assert public <= set(fx_beam.__all__) | {"Layout", "Load", "Velocity", "VirtualWork"}
