"""Nodes, joints and beams of a solution by names, or a clear error; histories along its beams."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from fx_beam.errors import is_one_of, shown
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import NAMES

from .audit import BeamResultants


def node_number(solution: Any, node: Node) -> int:
    """Number of a node of a solution."""
    if not isinstance(node, Node):
        raise ValueError(
            f"{shown(node)} is not a node; take one from a beam: beam.start, beam.end or "
            "beam.node(fraction)"
        )
    X, scene = solution.X, scene_of(solution)
    known = node.number < len(X) and X[node.number].tolist() == [node.x, node.y]
    if not known or (
        scene and node.scene and node.scene is not scene and _differ(scene, node.scene)
    ):
        raise ValueError(f"{node} is not a node of this solution; take a node of its scene")
    return node.number


def _differ(scene: Any, other: Any) -> bool:
    """Whether nodes lie elsewhere; those of scenes that are copied or built again do not."""
    pairs = zip(scene.nodes, other.nodes, strict=False)
    return any((a.x, a.y) != (b.x, b.y) for a, b in pairs)


def scene_of(solution: Any) -> Any:
    """The scene of a solution; None for one that was read from a file."""
    members = itertools.chain(solution.beams.values(), solution.bodies.values())
    first = next(members, None)
    node = first.start if isinstance(first, Beam) else getattr(first, "centre", None)
    return getattr(node, "scene", None)


def joint_number(solution: Any, joint: Joint) -> int:
    """Number of a joint of a solution."""
    if not isinstance(joint, Joint) or not 0 <= joint.number < solution.slides.shape[1]:
        raise ValueError(
            f"{shown(joint)} is not a joint of this solution; take the one that add_joint returned"
        )
    for node in (joint.a, joint.b):
        if node is not GROUND:
            node_number(solution, node)  # a joint of another scene has other nodes
    return joint.number


def contact_of(solution: Any, contact: Contact) -> Contact:
    """The contact of a solution, also for that of its scene or of a copy."""
    known = {ours.number: ours for ours in solution.contacts}
    if not isinstance(contact, Contact) or contact.number not in known:
        raise ValueError(
            f"{shown(contact)} is not a contact of this solution; take the one that add_contact "
            "returned"
        )
    ours = known[contact.number]
    other = ours.shape != contact.shape and not isinstance(ours.shape, Beam)
    if str(ours) != str(contact) or other:
        raise ValueError(f"{contact} belongs to another scene; this solution has {ours}")
    return ours


def beam_name(solution: Any, beam: Beam | str) -> str:
    """Name of a beam of a solution."""
    if isinstance(beam, Joint):
        raise ValueError(
            f"{beam} is no beam. What belongs to it is in solution.joint(joint): angle, slide, "
            "force, and internal(variable) of its spring"
        )
    name, beams = beam.name if isinstance(beam, Beam) else beam, solution.beams
    if isinstance(beam, Beam) and name in beams and beam.nodes != beams[name].nodes:
        raise ValueError(
            f"{shown(name)} is not a beam of this solution, whose beam of this name has other "
            "nodes; take the beam of its scene, or give the name"
        )
    if not is_one_of(name, beams):
        raise ValueError(f"{shown(name)} is not a beam of this solution; it has {list(beams)}")
    return name


def shape(solution: Any, beam: Beam | str) -> np.ndarray:
    """Deformed axis of a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.

    Returns
    -------
    (n, elements * degree + 1, 2) float
        Positions of its nodes, those inside elements included [m].
    """
    nodes = solution.nodes_of_beam[beam_name(solution, beam)]
    return solution.X[nodes] + solution.recorded("q")[:, nodes, :2]


def resultants(solution: Any, beam: Beam | str) -> BeamResultants:
    """Stress resultants along a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.

    Returns
    -------
    BeamResultants
        Axial force N, shear force Q and bending moment M at the arc lengths s and the times
        `t_level`. Row 0 is the start configuration. Forces of `Scene.add_virtual_work` that act
        inside a beam are not included.

    Raises
    ------
    ValueError
        If the motion was not recorded, or the rates that the scheme's resultants need.
    """
    solution.recorded("q")  # they are computed from the motion
    return solution.resultants_of_beam(beam_name(solution, beam))


def internal(solution: Any, beam: Beam | str, variable: str | None = None) -> np.ndarray:
    """An internal variable along a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.
    variable : str, optional
        Name of one of the `InternalVariables` of its section; not needed if there is only one.

    Returns
    -------
    (n, elements * degree) float
        Its values at the times t, at the arc lengths s of `resultants`.

    Raises
    ------
    ValueError
        If the motion was not recorded, or the beam has no such variable.
    """
    name = beam_name(solution, beam)
    solution.recorded("q")  # internal variables are recorded with the motion
    known = solution.variables_of_beam.get(name, {})
    internal_names = [name for name in known if name not in NAMES.values()]
    if variable is None and len(internal_names) == 1:
        (variable,) = internal_names
    if not is_one_of(variable, known):
        raise ValueError(
            f"beam {name!r} has no internal variable {shown(variable)}; it has {list(known)}"
        )
    return known[variable]
