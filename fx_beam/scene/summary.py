"""What a scene has, in a few lines, as notebooks show it."""

from __future__ import annotations

from typing import Any

from .joints import Joint


def facts(scene: Any) -> dict[str, str]:
    """Numbers of what a scene is made of, by their names."""
    beams, elements = scene.beams, sum(beam.elements for beam in scene.beams)
    entries = {"members": _listed([beam.name for beam in beams])}
    if scene.bodies:
        entries["bodies"] = _listed([body.name for body in scene.bodies])
    if scene.nodes:
        degree = beams[0].degree if beams else 1
        if beams:
            entries["elements"] = f"{elements} of degree {degree}"
        nodes = len(scene.nodes) - len(scene.gone) + elements * (degree - 1)
        entries["nodes"] = str(nodes)
        held = (
            len(scene.fixed)
            - 3 * len(scene.gone)
            + len(scene.prescribed)
            + sum(map(_held, scene.joints))
        )
        entries["unknowns"] = str(3 * nodes - held)
    for name in ("joints", "masses", "loads"):
        entries[name] = str(len(getattr(scene, name)))
    for name in ("natural_strains", "drags", "obstacles", "forces_between"):
        if getattr(scene, name):
            entries[name.replace("_", " ")] = str(len(getattr(scene, name)))
    if scene.parameters:
        entries["parameters"] = str(scene.parameters)
    if scene.gravity is not None:
        entries["gravity"] = f"({scene.gravity[0]:g}, {scene.gravity[1]:g})"
    return entries


def _listed(names: list[str]) -> str:
    """Their number and the first of some names."""
    more = ", ..." if len(names) > 4 else ""
    return f"{len(names)}: {', '.join(names[:4])}{more}" if names else "0"


def _held(joint: Joint) -> int:
    """Components that a joint or its motor holds."""
    held = 2 + joint.turns_together - (joint.slide is not None)
    return held + (joint.slide is not None and joint.slide.motor is not None)
