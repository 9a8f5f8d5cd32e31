"""Names that other programs have, and what they are called here: for messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_POSITIONS = "Use solution.position(node), or solution.X + solution.q[..., :2] for all nodes"
_DISPLACEMENTS = "Use solution.displacement(node), or solution.q for all nodes"
_SUPPORT = "Use scene.clamp(node), scene.pin(node) or scene.fix(node, 'y')"
_JOINT = "Use scene.add_joint with a joint such as fb.Revolute(a, b)"
_RUN = "Use fb.simulate(scene, dt=..., t_end=...), fb.static(scene) or fb.modes(scene)"
_OTHERS = {
    "Scene": {
        "add_node": "Nodes come with beams, beam.node(0.5), and bodies, body.centre, body['hook']",
        "add_torque": "Use scene.add_moment(node, moment)",
        "add_load": "Use scene.add_force, scene.add_moment or scene.add_line_load",
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
        **dict.fromkeys(("M", "N", "Q", "moments"), "Use solution.resultants(beam).M, .N, .Q"),
        **dict.fromkeys(("stress", "stresses"), "Use solution.resultants(beam)"),
        "to_vtk": "Use solution.to_paraview('motion.pvd')",
    },
}


def no_attribute(owner: object, name: str, names: Iterable[str]) -> AttributeError:
    """The error for a name that an object does not have, with what it may be called."""
    kind = type(owner).__name__
    hint = _OTHERS.get(kind, {}).get(name)
    if hint is None:
        near = difflib.get_close_matches(name, names, 1)
        hint = f"Is it {near[0]!r}?" if near else ""
    text = f"{kind!r} object has no attribute {name!r}"
    return AttributeError(f"{text}. {hint}" if hint else text)
