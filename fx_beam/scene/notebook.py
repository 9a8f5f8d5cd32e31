"""What notebooks show of an object: tables, and small pictures."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np


def html_table(title: str, rows: dict[str, str]) -> str:
    """Table with a title, of two columns."""
    cells = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows.items())
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def sketch(lines: Iterable[Any], shades: Iterable[str]) -> str:
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
