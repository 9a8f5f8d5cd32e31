"""What a study of stability found, in numbers and in sentences derived from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from fractions import Fraction
from itertools import groupby

import numpy as np

from .case import Cell, by_group, by_scheme
from .verdict import KINDS

#: Verdicts on a motion that is not the one sought.
LOST_MOTION = "gained", "blew up", "failed"
# Cases that a sentence names one by one.
_NAMED = 6


def short(value: float) -> str:
    """A number with one digit, such as 3e-13 or 2e9; up to 999 with all before the point.

    Parameters
    ----------
    value : float
        The number, not negative.

    Returns
    -------
    str
        The number.
    """
    if 1 <= value < 999.5:
        return f"{value:.0f}" if value >= 9.5 else f"{value:.2g}"
    if not np.isfinite(value):
        return f"{value}"
    mantissa, _, exponent = f"{value:.0e}".partition("e")
    return f"{mantissa}e{int(exponent)}" if value else "0"


def percent(part: float) -> str:
    """A part in percent, with one digit if it is small, or as a multiple if it is large.

    Parameters
    ----------
    part : float
        The part.

    Returns
    -------
    str
        Such as 840 %, 0.31 %, 2e-5 or 1e4 times.
    """
    if part < 1e-3:
        return short(part)
    if part >= 100:
        return f"{short(part)} times"
    return f"{100 * part:.0f} %" if part >= 0.0995 else f"{100 * part:.2g} %"


def counts(cells: Iterable[Cell]) -> dict[str, dict[str, float]]:
    """How often each scheme had each verdict, and the most that it gained.

    Parameters
    ----------
    cells : iterable of Cell
        A study.

    Returns
    -------
    dict
        By scheme, the number of each verdict, and "largest gain".
    """
    found: dict[str, dict[str, float]] = {}
    for scheme, own in by_scheme(cells).items():
        kinds = Counter(cell.verdict.kind for cell in own)
        gains = [cell.verdict.gain for cell in own if not np.isnan(cell.verdict.highest)]
        gain = {"largest gain": max(gains, default=0.0)}
        found[scheme] = {kind: kinds[kind] for kind in KINDS} | gain
    return found


def sentences(cells: Iterable[Cell]) -> list[str]:
    """What each scheme made of the cases.

    Parameters
    ----------
    cells : iterable of Cell
        A study.

    Returns
    -------
    list of str
        A line for each scheme.
    """
    return [_sentence(scheme, own) for scheme, own in by_scheme(cells).items()]


def _sentence(scheme: str, cells: list[Cell]) -> str:
    kept = [cell for cell in cells if cell.verdict.kind == "kept"]
    within = f", within {short(max(cell.verdict.worst for cell in kept))}" if kept else ""
    parts = [f"{scheme} kept the energy in {len(kept)} of {len(cells)} cases{within}"]
    for kind in KINDS[1:]:
        if of_kind := [cell for cell in cells if cell.verdict.kind == kind]:
            parts.append(f"{kind.replace('lost', 'lost it')} in {_named(of_kind)}")
    gain = counts(cells)[scheme]["largest gain"]
    lines = [", ".join(parts), f"It gained {percent(gain)} at most"]
    if often := [cell for cell in kept if cell.halved_often]:
        most = max(often, key=lambda cell: cell.verdict.parts)
        lines.append(
            f"In {len(often)} of the cases in which it kept it, steps were halved often, most in "
            f"{most.case.name}, which took {short(most.verdict.parts)} times the steps"
        )
    if unsure := [(cell.verdict, cell.other) for cell in cells if cell.other]:
        turned = [one for one, other in unsure if one.kind != other.kind]
        lines.append(f"Other rounding turns {_number(len(unsure), 'number')}")
        if turned:
            them = "them" if len(unsure) > 1 else "it"
            lines[-1] += f", and {_number(len(turned), 'verdict')} with {them}"
    return ". ".join(lines) + "."


def _named(cells: list[Cell]) -> str:
    """Their number, and which they are if they are few."""
    if len(cells) > _NAMED:
        return f"{len(cells)}"
    groups = by_group(cells)
    names = [f"{g}: " + ", ".join(c[0].case.label for c in cases) for g, cases in groups.items()]
    return f"{len(cells)} ({'; '.join(names)})"


def _number(number: int, what: str) -> str:
    return f"{number} {what}{'s' if number > 1 else ''}"


def lost_motions(cells: Iterable[Cell]) -> list[list[str | None]]:
    """Where schemes gained energy, blew up or failed.

    Parameters
    ----------
    cells : iterable of Cell
        A study.

    Returns
    -------
    list of lists
        Rows of a table: a group, and for each scheme in how many of its cases, such as 3 of 7;
        None for none.
    """
    rows = []
    for group, cases in by_group(cells).items():
        own = by_scheme(cell for case in cases for cell in case)
        numbers = [sum(c.verdict.kind in LOST_MOTION for c in column) for column in own.values()]
        rows.append([group, *(f"{n} of {len(cases)}" if n else None for n in numbers)])
    return rows


def along(cases: list[list[Cell]]) -> str:
    """Where the verdicts change along a group.

    Parameters
    ----------
    cases : list of lists of Cell
        The cases of a group.

    Returns
    -------
    str
        A line; empty for fewer than three cases, and where the labels are no numbers.
    """
    if len(cases) < 3 or not all(_is_value(case[0].case.label) for case in cases):
        return ""
    found: dict[str, list[str]] = {}
    for scheme, own in by_scheme(cell for case in cases for cell in case).items():
        stretches = [
            (kind, [cell.case.label for cell in stretch])
            for kind, stretch in groupby(own, key=lambda cell: cell.verdict.kind)
        ]
        words = ", ".join(_stretch(kind, labels, own) for kind, labels in stretches)
        found.setdefault(words, []).append(scheme)
    return "; ".join(f"{', '.join(schemes)}: {words}" for words, schemes in found.items()) + ".\n"


def _stretch(kind: str, labels: list[str], own: list[Cell]) -> str:
    first, last = (own[k].case.label for k in (0, -1))
    if len(labels) == len(own):
        return f"{kind} throughout"
    if len(labels) == 1:
        return f"{kind} at {labels[0]}"
    if labels[0] == first:
        return f"{kind} until {labels[-1]}"
    return f"{kind} from {labels[0]} {'on' if labels[-1] == last else f'to {labels[-1]}'}"


def _is_value(label: str) -> bool:
    try:
        Fraction(label)
    except ValueError:
        return False
    return True
