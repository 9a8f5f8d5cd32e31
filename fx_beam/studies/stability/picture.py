"""The heat map of a stability study, and energy curves of the cases that differ most."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fx_beam.studies.reporting import short

from .case import Cell, by_case, by_group, by_scheme
from .verdict import Verdict

#: Colours of the verdicts, from pale for kept to dark for failed.
COLOURS = {
    "kept": "#CFE6F4",
    "lost": "#F6E7A1",
    "gained": "#F2B48A",
    "blew up": "#C8460B",
    "failed": "#6E6E6E",
    "no verdict": "#F0F0F0",
}
_ON_DARK = "blew up", "failed"
# Font size of the labels over the cases in the heat map.
_LETTERS = 7
# Half the width and height of a cell, the width of a second verdict's colour, and the legs of the
# black corner that marks steps halved often.
_HALF, _OTHER, _CORNER = (0.48, 0.46), 0.16, (0.2, 0.36)
#: Cases whose curves are drawn.
TELLING = 6


def symbol(verdict: Verdict) -> str:
    """A verdict as a short text: 2e-13, -17%, +4e-5, x1e9, or a cross and the part reached."""
    amount = verdict.amount
    if verdict.kind == "failed":
        return f"\u2717{100 * amount:.0f}%"
    if verdict.kind == "blew up":
        return f"\u00d7{short(amount)}"
    if verdict.kind in ("lost", "gained"):
        sign = "-" if verdict.kind == "lost" else "+"
        return f"{sign}{100 * amount:.0f}%" if amount >= 0.01 else sign + short(amount)
    return short(amount) if verdict.kind == "kept" else "?"


def telling(cells: list[Cell]) -> list[list[Cell]]:
    """Cases on which the schemes differ most, one of each group, with all their schemes.

    First those with the most different verdicts, then those with the widest range of errors.
    """
    best: dict[str, tuple[tuple[int, float], list[Cell]]] = {}
    for case in by_case(cells):
        judged = [cell.verdict for cell in case if cell.verdict.kind != "no verdict"]
        if not judged:
            continue
        worst = np.clip([verdict.worst for verdict in judged], 1e-16, 1e16)
        score = len({verdict.kind for verdict in judged}), float(np.ptp(np.log10(worst)))
        group = case[0].case.group
        if group not in best or score > best[group][0]:
            best[group] = score, case
    ranked = sorted(best.values(), key=lambda entry: entry[0], reverse=True)
    return [case for _, case in ranked[:TELLING]]


# -- The heat map --------------------------------------------------------------------------------


def draw_map(path: Path, cells: list[Cell], slots: int = 27) -> None:
    """Write the heat map; `slots` is the number of cases and gaps side by side."""
    # Imported here: a study without pictures needs neither matplotlib nor pyvista.
    from fx_beam import plot

    groups, schemes = by_group(cells), list(by_scheme(cells))
    bands = _bands(groups, slots)
    figure, axes = plot.figure(len(bands), 1, height=0.65 + 0.18 * len(schemes))
    figure.set_figwidth(0.48 * slots)
    for ax, band in zip(axes.flat, bands, strict=True):
        _draw_band(ax, [(group, groups[group]) for group in band], schemes, slots)
    found = {cell.verdict.kind for cell in cells}
    squares = [
        axes[0, 0].plot([], [], "s", color=colour, markersize=9, label=kind)[0]
        for kind, colour in COLOURS.items()
        if kind in found
    ]
    look = {"color": "black", "linestyle": "none"}
    corner = axes[0, 0].plot(
        [], [], **look, marker=((-1, 1), (1, 1), (-1, -1)), markersize=7, label="steps halved often"
    )
    tilde = axes[0, 0].plot(
        [], [], **look, marker="$\\sim$", markersize=9, label="sensitive to round-off"
    )
    handles = [*squares, *corner, *tilde]
    figure.legend(handles=handles, ncols=slots // 3, loc="outside upper center", frameon=False)
    figure.savefig(path, dpi=150)


def _bands(groups: dict[str, list], slots: int) -> list[list[str]]:
    """Groups that fit side by side, in their order."""
    bands: list[list[str]] = [[]]
    taken = 0
    for group, cases in groups.items():
        if taken and taken + _width(group, cases) > slots + 1:
            bands.append([])
            taken = 0
        bands[-1].append(group)
        taken += _width(group, cases)
    return bands


def _width(group: str, cases: list) -> int:
    """Slots that a group needs: for its cases and a gap, or for its title."""
    title = max(map(len, group.split(": ")))
    return max(len(cases) + 1, -(-title // _LETTERS))


def _draw_band(
    ax, band: list[tuple[str, list[list[Cell]]]], schemes: list[str], slots: int
) -> None:
    places, labels, left = [], [], 0
    for group, cases in band:
        for x, case in enumerate(cases, left):
            places.append(x)
            labels.append(case[0].case.label.replace(" ", "\n"))
            for cell in case:
                _draw_cell(ax, x, schemes.index(cell.scheme), cell)
        title = group.replace(": ", "\n")
        ax.text(left - 0.5, -0.7, title, fontsize=7, va="bottom", linespacing=1.1)
        left += _width(group, cases)
    ax.set(xlim=(-0.55, slots - 0.45), ylim=(len(schemes) - 0.45, -0.55))
    ax.set_xticks(places, labels, fontsize=6.5, linespacing=0.95)
    ax.set_yticks(range(len(schemes)), schemes, fontsize=7)
    ax.tick_params(length=0, pad=2)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)


def _draw_cell(ax, x: int, y: int, cell: Cell) -> None:
    """A square in the colour of the verdict; its right end shows a differing repeated verdict."""
    verdict, other, (width, height) = cell.verdict, cell.other, _HALF
    ink = "white" if verdict.kind in _ON_DARK else "black"
    left, right, edges = x - width, x + width, (y - height, y - height, y + height, y + height)
    ax.fill((left, right, right, left), edges, color=COLOURS[verdict.kind], lw=0)
    shift = 0.0
    if other and other.kind != verdict.kind:
        inner = right - _OTHER
        ax.fill((inner, right, right, inner), edges, color=COLOURS[other.kind], lw=0)
        shift = _OTHER / 2
    if cell.halved_often:
        top, (across, down) = y - height, _CORNER
        ax.fill_between((left, left + across), (top, top), (top + down, top), color=ink, lw=0)
    text = f"{'~' if other else ''}{symbol(verdict)}"
    # The text lies in its cell: the layout need not measure it.
    look = {"color": ink, "fontsize": 6, "ha": "center", "va": "center_baseline"}
    ax.text(x - shift, y, text, **look).set_in_layout(False)


# -- Curves --------------------------------------------------------------------------------------


def draw_curves(path: Path, cells: list[Cell]) -> None:
    """Write the energy over time in the cases of `telling`."""
    from fx_beam import plot

    shown = telling(cells)
    columns = 2 if len(shown) > 1 else 1
    figure, axes = plot.figure(-(-len(shown) // columns) or 1, columns)
    for ax, case in zip(axes.flat, shown, strict=False):
        ax.set_title(case[0].case.name.replace(": ", "\n", 1), fontsize=8)
        ax.set(ylim=(0.08, 12), yscale="log", xlabel="time $t$ [s]", ylabel="energy ratio $r$ [-]")
        ax.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        for cell in case:
            look = plot.style(cell.family)
            ax.plot(cell.t, np.clip(cell.ratio, 0.01, 100), label=cell.scheme, **look)
            if cell.verdict.reason and len(cell.t):
                end = np.clip(cell.ratio[-1], 0.08, 12)
                ax.plot(cell.t[-1], end, "X", color=look["color"], clip_on=False, zorder=5)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    plot.save(figure, path)
