"""Imports point one way, versions and drawing stay at the edge, files stay short."""

import ast
import functools
import graphlib
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import fx_beam

PACKAGE = Path(fx_beam.__file__).parent
# From the ground up: a room imports from the rooms before it only, and no import goes in a circle.
ROOMS = (
    *("scene", "laws", "results", "plot", "fem", "coupling", "step", "motions"),
    *("equilibria", "linear", "orbits", "derivatives", "sweeps", "fenicsx"),
    "__main__",
)
#: The room that has a library for itself: all of it may be called there.
OF_FENICSX = "fenicsx"
#: Files beside the rooms, on which all rooms may build, and the package's own face.
BESIDE = ""


def _name(path):
    """Dotted name of a file in the package; of an __init__.py that of its folder."""
    return (
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        .removesuffix("__init__")
        .strip(".")
    )


SOURCES = {_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}


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
    return module.split(".")[0] if module.split(".")[0] in ROOMS else BESIDE


# -- The direction of imports ----------------------------------------------------------------


def test_every_file_is_beside_the_rooms_or_in_one():
    folders = {module.split(".")[0] for module in SOURCES if SOURCES[module].parent != PACKAGE}
    assert folders <= set(ROOMS)


def test_imports_go_from_room_to_room_in_one_direction():
    for module in set(SOURCES) - {""}:
        place = (BESIDE, *ROOMS).index(room_of(module))
        rooms = {room_of(name) for name in own_imports(module)}
        assert rooms <= {BESIDE, *ROOMS[:place]}, module


def test_no_import_goes_in_a_circle():
    graphlib.TopologicalSorter({m: own_imports(m) - {"", m} for m in SOURCES if m}).prepare()


def test_rooms_say_what_they_hold_and_nothing_else():
    for room in set(ROOMS) - {"plot", OF_FENICSX, "__main__"}:
        assert [type(node) for node in TREES[room].body] == [ast.Expr], room


def test_pictures_are_imported_by_what_writes_reports_only():
    drawing = {module for module in SOURCES if "plot" in own_imports(module)}
    assert {module.rpartition(".")[2] for module in drawing} <= {"picture", "report"}


def test_the_model_knows_nothing_of_solutions():
    below = [m for m in SOURCES if room_of(m) in ("fem", "coupling", "step")]
    assert [m for m in below if "results.solution" in own_imports(m)] == []


# -- The edges -------------------------------------------------------------------------------


HOMES = {
    "mpi4py": "mpi",
    "petsc4py slepc4py dolfinx": "",  # but for their own room
    "ffcx": "fem.ffcx_api",
    "matplotlib": "plot.charts plot.look plot.labels plot.symbols plot.shape_pictures "
    "plot.animations plot.drawing plot.scene_drawing plot.live_page",
    "pyvista vtk vtkmodules": "plot.shape_pictures",
    "PIL imageio_ffmpeg": "plot.animations",
    "tqdm": "motions.progress",
    "pandas xarray": "results.export",
}


@pytest.mark.parametrize("packages", HOMES)
def test_each_library_is_called_from_one_place(packages):
    callers = {m for m in SOURCES if foreign_imports(m) & set(packages.split())}
    outside = {module for module in callers if room_of(module) != OF_FENICSX}
    assert outside == set(HOMES[packages].split())


def test_physics_and_data_need_numpy_and_ufl_only():
    # scipy: splines, roots of arc lengths, nearest nodes, drawings; tables are made on request
    more = {
        "scene.curve": {"scipy"},
        "scene.contacts": {"scipy"},
        "scene.mesh": {"scipy"},
        "results.export": {"pandas", "xarray"},
    }
    for module in SOURCES:
        if room_of(module) in ("scene", "laws", "results"):
            assert foreign_imports(module) <= {"numpy", "ufl"} | more.get(module, set()), module


def test_the_package_imports_what_is_asked_for():
    code = """import sys, fx_beam; print(*sys.modules)
fx_beam.simulate; print(*sys.modules)"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    package, motions = (set(line.split()) for line in done.stdout.splitlines())
    libraries = {"matplotlib", "pyvista", "vtkmodules", "imageio", "pandas", "xarray"}
    rooms = {name.split(".")[1] for name in motions if name.startswith("fx_beam.")} & set(ROOMS)
    assert rooms == {"scene", "laws", "results", "fem", "coupling", "step", "motions"}
    assert {name for name in package if name.startswith("fx_beam")} == {"fx_beam"}
    assert not package & {"numpy", "ufl"}
    assert not motions & (libraries | {"dolfinx", "mpi4py", "petsc4py"})


def test_pictures_are_had_from_the_package_and_nothing_else_is():
    assert fx_beam.plot.curves and {"plot", "Scene", "modes"} <= set(dir(fx_beam))
    with pytest.raises(AttributeError, match="work_precision"):
        fx_beam.work_precision  # noqa: B018


def test_versions_are_asked_for_in_one_place_only():
    # The last one prints them.
    asking = {"fem.ffcx_api", "__main__"}
    for module in set(SOURCES) - asking:
        asked = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
        assert not asked & {"__version__", "version_info", "hexversion"}, module
        assert not foreign_imports(module) & {"packaging", "pkg_resources"}, module


def test_no_import_is_optional():
    for module, tree in TREES.items():
        handlers = [node for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler)]
        caught = " ".join(ast.unparse(h.type) for h in handlers if h.type is not None)
        assert "ImportError" not in caught and "ModuleNotFound" not in caught, module


def test_no_public_name_hides_a_module():
    for room in ("", "plot"):
        public = set(importlib.import_module(f"fx_beam.{room}".rstrip(".")).__all__)
        files = {name.rpartition(".")[2] for name in SOURCES if name.rpartition(".")[0] == room}
        assert not public & files


# -- Size and manners ------------------------------------------------------------------------


def test_no_file_needs_what_is_private_in_another():
    """Else the two are one concept that was cut."""
    tuples = {"_replace", "_asdict", "_fields"}
    # Which Python documents; the last is that of a ctypes.CDLL.
    outside = {"os._exit", "sys._getframe", "library._handle"}
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


def test_nothing_is_printed():
    for module, tree in TREES.items():
        calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        assert "print" not in calls, module


def test_source_is_ascii():
    assert [m for m, path in SOURCES.items() if not path.read_text("utf-8").isascii()] == []


# -- The door --------------------------------------------------------------------------------


def test_each_public_name_is_loaded_from_its_file():
    assert len(fx_beam.__all__) == len(set(fx_beam.__all__))
    for name in fx_beam.__all__:
        assert not inspect.ismodule(getattr(fx_beam, name))
