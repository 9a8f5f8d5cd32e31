"""Names that other programs have, and what they are called here: for messages."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable
from types import FunctionType
from typing import Any, TypeVar

_Kind = TypeVar("_Kind", bound=type)

_POSITIONS = "Use solution.position(node), or solution.X + solution.q[..., :2] for all nodes"
_DISPLACEMENTS = "Use solution.displacement(node), or solution.q for all nodes"
_SUPPORT = "Use scene.clamp(node), scene.pin(node) or scene.fix(node, 'y')"
_JOINT = "Use scene.add_joint with a joint such as fb.Revolute(a, b)"
_RUN = "Use fb.simulate(scene, dt=..., t_end=...), fb.static(scene) or fb.modes(scene)"
_BEAM = "Use scene.add_beam(points, section, elements=...)"
_LOAD = "Use scene.add_force, scene.add_moment or scene.add_line_load"
_MOTION = "Use fb.simulate(scene, dt=..., t_end=...), or fb.Motion for single steps"
_RESULTANTS = "Use solution.resultants(beam).M, .N, .Q"
_TIMES = "Steps have the length dt and end at t_end; rows are chosen by record=fb.Record(...)"
_OTHERS: dict[str, dict[str, str]] = {
    "fx_beam": {
        **dict.fromkeys(("solve", "run", "analyse", "analyze"), _RUN),
        **dict.fromkeys(("dynamic", "transient", "integrate", "solve_ivp", "Simulation"), _MOTION),
        **dict.fromkeys(("Hinge", "Pin", "PinJoint"), "Use fb.Revolute(a, b), or scene.pin(node)"),
        **dict.fromkeys(("Weld", "Fixed", "Clamp", "Support"), f"{_SUPPORT}, or fb.Rigid(a, b)"),
        **dict.fromkeys(("Model", "System", "Frame", "Structure", "Truss"), "Use fb.Scene()"),
        **dict.fromkeys(("Element", "BeamElement", "Rod"), _BEAM),
        **dict.fromkeys(("Force", "Moment", "Load", "PointLoad", "LineLoad"), _LOAD),
        **dict.fromkeys(("Rope", "Cable"), "Use scene.add_rope(points)"),
        **dict.fromkeys(("Mass", "PointMass"), "Use scene.add_mass(node, mass)"),
        **dict.fromkeys(("RigidBody",), "Use scene.add_body(position, mass, inertia)"),
        **dict.fromkeys(("Motor", "Actuator"), "Use motor= of a joint, or scene.prescribe"),
        **dict.fromkeys(("eigenmodes", "eigenfrequencies", "modal"), "Use fb.modes(scene)"),
        **dict.fromkeys(
            ("gradient", "grad", "optimize", "minimize"), "Use fb.Response(build, ...)"
        ),
        **dict.fromkeys(
            ("Material", "Steel", "steel"), "Use fb.materials.steel, or E= of a section"
        ),
        "linear_static": "Use fb.static(scene, linear=True)",
    },
    "Scene": {
        "add_node": "Nodes come with beams, beam.node(0.5), and bodies, body.centre, body['hook']",
        "add_torque": "Use scene.add_moment(node, moment)",
        **dict.fromkeys(("add_load", "add_point_load"), _LOAD),
        **dict.fromkeys(("add_element", "add_member", "add_rod", "add_bar", "add_truss"), _BEAM),
        "add_distributed_load": "Use scene.add_line_load(beam, load)",
        "add_gravity": "Use fb.Scene(gravity=(0, -9.81)), or set scene.gravity",
        "add_rigid_body": "Use scene.add_body(position, mass, inertia)",
        "add_damper": "Use scene.add_spring with an fb.Damper, or damper= of a joint",
        "add_motor": "Use motor= of a joint, or scene.prescribe(node, rotation=...)",
        "add_cable": "Use scene.add_rope, or scene.add_beam with a small EI",
        **dict.fromkeys(("add_support", "add_constraint", "add_boundary", "support"), _SUPPORT),
        **dict.fromkeys(("add_hinge", "add_revolute", "add_slider", "connect"), _JOINT),
        **dict.fromkeys(("run", "solve", "simulate", "static", "modes"), _RUN),
        "plot": "Use fb.plot.scene(scene, 'scene.png')",
    },
    "Solution": {
        "plot": "Use fb.plot.shapes(solution, 'shapes.png') and what else fb.plot has",
        "animate": "Use fb.plot.animate(solution, 'motion.gif')",
        **dict.fromkeys(("time", "times"), "Use solution.t"),
        **dict.fromkeys(("u", "displacements"), _DISPLACEMENTS),
        **dict.fromkeys(("x", "y", "positions"), _POSITIONS),
        "energies": "Use solution.energy",
        **dict.fromkeys(
            ("forces", "reactions"), "Use solution.reaction(node), .joint(joint).force"
        ),
        **dict.fromkeys(("M", "N", "Q", "moments"), _RESULTANTS),
        "stresses": "Use solution.stress(beam)",
        "to_vtk": "Use solution.to_paraview('motion.pvd')",
    },
    "Node": {
        **dict.fromkeys(
            ("position", "pos", "coordinates", "xy"), f"Use node.x, node.y. {_POSITIONS}"
        ),
        **dict.fromkeys(("u", "displacement", "q"), _DISPLACEMENTS),
        **dict.fromkeys(("fix", "clamp", "pin", "support"), _SUPPORT),
        **dict.fromkeys(("force", "add_force", "load"), "Use scene.add_force(node, (fx, fy))"),
        **dict.fromkeys(("id", "index"), "Use node.number"),
    },
    "Beam": {
        **dict.fromkeys(("mid", "middle", "midpoint", "center"), "Use beam.node(0.5)"),
        **dict.fromkeys(("first", "begin", "a"), "Use beam.start"),
        **dict.fromkeys(("last", "b"), "Use beam.end"),
        "L": "Use beam.length",
        **dict.fromkeys(("E", "I", "EI", "EA", "GA", "rhoA"), "Use beam.section"),
        **dict.fromkeys(("M", "N", "Q", "V", "moments", "forces"), _RESULTANTS),
        **dict.fromkeys(("stress", "stresses"), "Use solution.stress(beam)"),
        **dict.fromkeys(("u", "displacement"), f"{_DISPLACEMENTS}. Nodes are beam.node(0.5)"),
        "hinge": _JOINT,
    },
    "BeamResultants": {
        **dict.fromkeys(("V", "shear", "shear_force"), "Use resultants.Q"),
        **dict.fromkeys(("moment", "bending_moment", "Mz"), "Use resultants.M"),
        **dict.fromkeys(("axial", "axial_force", "normal", "normal_force"), "Use resultants.N"),
        "x": "Use resultants.s, the arc lengths of the points",
        "max": "Use abs(resultants.M).max()",
        **dict.fromkeys(("stress", "stresses"), "Use solution.stress(beam)"),
    },
    "Section": {
        **dict.fromkeys(("E", "modulus"), "A section has EA, GA and EI"),
        **dict.fromkeys(("area", "height", "width"), "A section has A, and its edges as edges="),
        **dict.fromkeys(("J", "Iz", "inertia", "second_moment"), "A section has I, EI and rhoI"),
        **dict.fromkeys(("rho", "density", "mass", "m"), "A section has rhoA and rhoI"),
    },
    "keyword": {
        **dict.fromkeys(("t_eval", "t_span", "times", "tspan"), _TIMES),
        **dict.fromkeys(("steps", "n_steps"), "Use dt and t_end, or in statics load_steps"),
        **dict.fromkeys(("t", "T", "t_final", "duration", "tf"), "Use t_end"),
        **dict.fromkeys(("h", "time_step", "timestep", "step"), "Use dt"),
        **dict.fromkeys(("scale", "scale_factor", "factor"), "Use magnify"),
        **dict.fromkeys(("filename", "file", "output"), "Use path"),
        **dict.fromkeys(("num_modes", "nmodes", "k"), "Use n"),
        "method": "Use scheme",
    },
}


def hint(kind: str, name: str, names: Iterable[str]) -> str:
    """What a name that a kind of thing does not have may be called here; empty if nothing is near.

    Names of methods are compared without "add_", in which nearly all of them are alike.
    """
    known = _OTHERS.get(kind, {}).get(name)
    if known is not None:
        return f". {known}"
    ours = {other.removeprefix("add_"): other for other in names}
    near = difflib.get_close_matches(name.removeprefix("add_"), ours, 1, 0.8)
    return f". Is it {ours[near[0]]!r}?" if near else ""


def no_attribute(owner: object, name: str, names: Iterable[str]) -> AttributeError:
    """The error for a name that an object does not have, with what it may be called."""
    kind = type(owner).__name__
    # Python asks each object for names with underscores, such as __deepcopy__.
    more = "" if name.startswith("_") else hint(kind, name, names)
    return AttributeError(f"{kind!r} object has no attribute {name!r}{more}")


def answering(kind: _Kind) -> _Kind:
    """The class, whose objects answer names that they do not have by hints."""

    def missing(self, name: str) -> Any:
        raise no_attribute(self, name, dir(type(self)))

    missing.__name__ = "__getattr__"
    setattr(kind, "__getattr__", missing)  # noqa: B010  # unknown to type checkers
    return kind


def add_hint(error: TypeError, function: Callable, keywords: Iterable[str]) -> None:
    """Add a hint to the error of a call, if it has a keyword that the function does not know."""
    names = inspect.signature(function).parameters
    unknown = [name for name in keywords if name not in names]
    if unknown and "unexpected keyword" in str(error):
        error.args = (f"{error}{hint('keyword', unknown[0], names)}",)


def answering_keywords(function: Any, home: str) -> Any:
    """A function of the module `home`, with hints for keywords that it does not have.

    Functions with a decorator are as they are: it adds the hints.
    """
    if not isinstance(function, FunctionType) or hasattr(function, "__wrapped__"):
        return function
    called: Callable = function

    @functools.wraps(called)
    def answer(*arguments, **options):
        try:
            return called(*arguments, **options)
        except TypeError as error:
            add_hint(error, called, options)
            raise

    answer.__module__ = home  # where pickles find it
    return answer
