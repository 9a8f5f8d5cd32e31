"""Views of an object in notebooks and `repr`: facts in tables, and small pictures."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def html_table(title: str, rows: dict[str, str]) -> str:
    """Table with a title, of two columns."""
    cells = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows.items())
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def sketch(lines: Iterable[ArrayLike], shades: Iterable[str]) -> str:
    """Small picture in SVG of lines (n, 2), each in its colour, as high as wide or lower."""
    lines = [np.asarray(line, dtype=float) for line in lines]
    points = np.concatenate(lines) if lines else np.empty((0, 2))
    points = points[np.isfinite(points).all(axis=1)]
    size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if not size:
        return ""
    low, high = points.min(axis=0) - 0.05 * size, points.max(axis=0) + 0.05 * size
    width, height = 240 * (high - low) / max(high - low)
    # One path for each colour: an element for each of thousands of members would be long.
    paths: dict[str, str] = {}
    for line, shade in zip(lines, shades, strict=False):
        points = width * (line - low) / (high - low)[0]
        corners = " ".join(f"{x:.1f},{height - y:.1f}" for x, y in points)
        paths[shade] = f"{paths.get(shade, '')}M{corners}"
    drawn = "".join(
        f'<path fill="none" stroke="{shade}" stroke-width="1.5" d="{path}"/>'
        for shade, path in paths.items()
    )
    box = f'width="{width:.0f}" height="{max(height, 1):.0f}"'
    return f'<svg {box} style="background:white">{drawn}</svg>'


def facts(scene) -> dict[str, str]:
    """Numbers of what a scene is made of, by their names."""
    beams, elements = scene.beams, sum(beam.elements for beam in scene.beams)
    entries = {"members": _listed([beam.name for beam in beams])}
    if scene.bodies:
        entries["bodies"] = _listed([body.name for body in scene.bodies])
    if scene.nodes:
        degree, gone = beams[0].degree if beams else 1, len(scene.gone)
        if beams:
            entries["elements"] = f"{elements} of degree {degree}"
        nodes = len(scene.nodes) - gone + elements * (degree - 1)
        supported = len(scene.fixed) - 3 * gone + len(scene.prescribed)
        held_count = supported + sum(map(_held, scene.joints))
        entries |= {"nodes": str(nodes), "unknowns": str(3 * nodes - held_count)}
    always, optional = ("joints", "masses", "loads"), ("natural_strains", "drags", "contacts")
    for name in (*always, *optional, "forces_between"):
        if name in always or getattr(scene, name):
            entries[name.replace("_", " ")] = str(len(getattr(scene, name)))
    if scene.parameters:
        entries["parameters"] = str(scene.parameters)
    if scene.gravity is not None:
        entries["gravity"] = f"({scene.gravity[0]:g}, {scene.gravity[1]:g})"
    return entries


def _listed(names: list[str]) -> str:
    """Number of some names, and the first four of them."""
    ending = ", ..." if len(names) > 4 else ""
    return f"{len(names)}: {', '.join(names[:4])}{ending}" if names else "0"


def _held(joint) -> int:
    """Components that a joint or its motor holds."""
    return 2 + joint.turns_together - (joint.slide is not None) + ("slide" in joint.driven)
