"""Imports point one way, versions and drawing stay at the edge, files stay short."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import fx_beam

PACKAGE = Path(fx_beam.__file__).parent
# From the floor up: a module imports from those before it only.
LAYERS = [
    # what is said, and every call into dolfinx
    "errors",
    "files",
    "report",
    "compat",
    # physics and data
    "audit",
    "kinematics",
    "values",
    "rates",
    "beam",
    "curve",
    "actions",
    "section",
    "resultants",
    "schemes",
    "joints",
    "scene",
    "state",
    "export",
    "lookup",
    "joint_motion",
    "solution",
    "io",
    # from a scene to matrices
    "mesh",
    "couplings",
    "actuators",
    "reduction",
    "joint_reduction",
    "loads",
    "followers",
    "beam_data",
    "virtual_works",
    "forms",
    "mechanism",
    "model",
    # from matrices to a motion
    "drive",
    "initial",
    "recorder",
    "newton",
    "halving",
    "facing",
    "stepping",
    "library",
    "factors",
    "problem",
    "loop",
    "loading",
    "continuation",
    # analyses and their results
    "results",
    "windings",
    "dynamics",
    "statics",
    "modal",
    # the door, pictures beside it, and studies behind it
    "__init__",
    "symbols",
    "curve_pictures",
    "shape_pictures",
    "plot",
    "accuracy",
    "run",
    "front",
    "precision",
    "precision_picture",
    "precision_report",
    "candidates",
    "work_precision",
    "verdict",
    "drift",
    "cell",
    "findings",
    "stability_picture",
    "stability_report",
    "stability",
]
SOURCES = {path.stem: path for path in sorted(PACKAGE.glob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}

every_module = pytest.mark.parametrize("module", SOURCES)


def imports(module):
    """Dotted names of all modules that a module imports, inside functions as well."""
    names = set()
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level:
            base = ".".join(filter(None, ["fx_beam", node.module]))
            own = [f"{base}.{alias.name}" for alias in node.names]
            names |= set(own) if node.module is None else {base}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module)
    return names


def own_imports(module):
    """Names of the package's modules that a module imports."""
    dotted = {name for name in imports(module) if name.split(".")[0] == "fx_beam"}
    return {(name.split(".") + ["__init__"])[1] for name in dotted}


def foreign_imports(module):
    """Names of the packages outside the standard library and this one that a module imports."""
    packages = {name.split(".")[0] for name in imports(module)}
    return packages - set(sys.stdlib_module_names) - {"fx_beam"}


# -- The direction of imports ----------------------------------------------------------------


def test_every_module_has_its_place():
    assert set(SOURCES) <= set(LAYERS), "name the new module in LAYERS, above all that it imports"
    assert len(LAYERS) == len(set(LAYERS))
    assert not [path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE]


@every_module
def test_imports_point_downwards(module):
    assert module in LAYERS
    below = LAYERS[: LAYERS.index(module)]
    assert own_imports(module) <= set(below)


def test_pictures_are_imported_by_what_writes_reports_only():
    drawing = {module for module in SOURCES if "plot" in own_imports(module)}
    assert drawing <= {"precision_picture", "precision_report", "stability_picture"}


def test_the_model_knows_nothing_of_solutions():
    between = LAYERS[LAYERS.index("mesh") : LAYERS.index("results")]
    assert [m for m in between if m in SOURCES and "solution" in own_imports(m)] == []


# -- The edges -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("packages", "home"),
    [
        ({"dolfinx", "basix", "ffcx", "mpi4py"}, {"compat"}),
        ({"petsc4py"}, {"newton"}),
        ({"slepc4py"}, {"modal"}),
        ({"matplotlib"}, {"curve_pictures", "shape_pictures"}),
        ({"pyvista", "vtk", "vtkmodules"}, {"shape_pictures"}),
        ({"tqdm"}, {"dynamics"}),
    ],
    ids=["dolfinx", "petsc4py", "slepc4py", "matplotlib", "pyvista", "tqdm"],
)
def test_each_library_is_called_from_one_place(packages, home):
    assert {module for module in SOURCES if foreign_imports(module) & packages} == home


def test_physics_and_data_need_numpy_and_ufl_only():
    for module in LAYERS[LAYERS.index("audit") : LAYERS.index("mesh")]:
        if module in SOURCES:
            # scipy: splines, and the root of an arc length
            more = {"scipy"} if module == "curve" else set()
            assert foreign_imports(module) <= {"numpy", "ufl"} | more, module
            assert "compat" not in own_imports(module), module


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
    assert "fx_beam.dynamics" in loaded
    assert not loaded & {"matplotlib", "pyvista", "vtkmodules", "imageio", "fx_beam.plot"}
    assert not loaded & {"fx_beam.work_precision", "fx_beam.stability"}


def test_pictures_and_studies_are_had_from_the_package_and_nothing_else_is():
    assert fx_beam.work_precision.study and fx_beam.stability and fx_beam.plot.curves
    assert {"plot", "stability", "work_precision", "Scene", "modes"} <= set(dir(fx_beam))
    with pytest.raises(AttributeError, match="workprecision"):
        fx_beam.workprecision  # noqa: B018


@every_module
def test_versions_are_asked_for_in_compat_only(module):
    if module == "compat":
        return
    asked = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
    assert not asked & {"__version__", "version_info", "hexversion"}
    assert not foreign_imports(module) & {"packaging", "pkg_resources"}


@every_module
def test_no_import_is_optional(module):
    handlers = [node for node in ast.walk(TREES[module]) if isinstance(node, ast.ExceptHandler)]
    caught = {ast.unparse(handler.type) for handler in handlers if handler.type is not None}
    assert not [name for name in caught if "ImportError" in name or "ModuleNotFound" in name]


def test_no_public_name_hides_a_module():
    assert not set(fx_beam.__all__) & set(SOURCES)


# -- Size and manners ------------------------------------------------------------------------


@every_module
def test_files_have_at_most_400_lines(module):
    assert len(SOURCES[module].read_text(encoding="utf-8").splitlines()) <= 400


@every_module
def test_nothing_is_printed(module):
    calls = [node.func for node in ast.walk(TREES[module]) if isinstance(node, ast.Call)]
    assert "print" not in {ast.unparse(call) for call in calls}


@every_module
def test_source_is_ascii(module):
    assert SOURCES[module].read_text(encoding="utf-8").isascii()


# -- The door --------------------------------------------------------------------------------


def test_the_public_names_are_all_that_the_package_imports():
    imported = {
        alias.asname or alias.name
        for node in TREES["__init__"].body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert set(fx_beam.__all__) == imported
    assert len(fx_beam.__all__) == len(set(fx_beam.__all__))
    for name in fx_beam.__all__:
        assert not inspect.ismodule(getattr(fx_beam, name))


def test_the_public_names_cover_all_that_a_scene_and_a_solution_are_made_of():
    assert {
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
        "section",
        "schemes",
        "scene",
        "solution",
        "errors",
        "audit",
        "beam",
        "curve",
        "rates",
    ):
        source = sys.modules[f"fx_beam.{module}"]
        defined = {name for name, value in vars(source).items() if inspect.isclass(value)}
        own = {name for name in defined if getattr(source, name).__module__ == source.__name__}
        public = {name for name in own if not name.startswith("_")}
        assert public <= set(fx_beam.__all__) | {"Layout", "Load", "Velocity", "VirtualWork"}
