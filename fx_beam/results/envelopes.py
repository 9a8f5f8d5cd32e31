"""Envelopes: least and largest values of several solutions, and which of them give these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, require
from fx_beam.scene.beam import Beam
from fx_beam.scene.outputs import Output

from .solution import Solution

# Places along a beam, if none are given.
_PLACES = 101


@dataclass(frozen=True)
class Envelope:
    """Least and largest values over all rows of several solutions.

    Returned by `envelope`.

    Parameters
    ----------
    least, largest : (...) float
        The values, in the unit of the output.
    least_by, largest_by : (...) int
        Numbers of the solutions with these values; the first one if several have the same value.

    Examples
    --------
    >>> import numpy as np, fx_beam as fb
    >>> values = fb.Envelope(np.array(-1.0), np.array(3.0), np.array(1), np.array(0))
    >>> print(values.largest, values.largest_by)
    3.0 0
    """

    least: np.ndarray
    largest: np.ndarray
    least_by: np.ndarray
    largest_by: np.ndarray


@dataclass(frozen=True)
class BeamEnvelope:
    """Envelopes of the section forces along a beam.

    Returned by `envelope`.

    Parameters
    ----------
    s : (places,) float
        Arc lengths from the start of the beam [m].
    N, Q, M : Envelope
        Envelopes (places,) of axial force [N], shear force [N] and bending moment [N m].

    Examples
    --------
    >>> import numpy as np, fx_beam as fb
    >>> zero = fb.Envelope(*np.zeros((4, 2)))
    >>> fb.BeamEnvelope(np.array([0.0, 1.0]), zero, zero, zero).M.largest
    array([0., 0.])
    """

    s: np.ndarray
    N: Envelope
    Q: Envelope
    M: Envelope


def envelope(
    solutions: Sequence[Solution], part: Output | Beam | str, s: Any = None
) -> Envelope | BeamEnvelope:
    """Least and largest values over the rows of several load cases or motions.

    Parameters
    ----------
    solutions : sequence of Solution
        The cases: of one scene, of copies of it, or of scenes with the same parts.
    part : Output, Beam or str
        An output, or a beam or its name for the section forces along it.
    s : (places,) float, optional
        Arc lengths along the beam [m]; by default 101 places from end to end.

    Returns
    -------
    Envelope or BeamEnvelope
        For an output: its least and largest values, for each component or point. For a beam: those
        of N, Q and M at the places s.

    Raises
    ------
    SceneError
        Without a solution, for a part that is no output or beam of each solution, and for places
        beyond the beam.
    ValueError
        If a needed quantity was not recorded.

    Examples
    --------
    A beam under its weight, and with a force in the middle.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -10))
    >>> beam = scene.add_beam([(0, 0), (4, 0)], fb.Section(EA=1e8, GA=1e8, EI=1e6, rhoA=5.0))
    >>> scene.pin(beam.start)
    >>> scene.fix(beam.end, "y")
    >>> cases = [fb.static(scene, linear=True)]
    >>> load = scene.add_force(beam.node(0.5), (0, 500.0))
    >>> cases.append(fb.static(scene, linear=True))
    >>> moments = fb.envelope(cases, fb.Output("M", beam.at(2.0)))
    >>> print(moments.least.round(), moments.least_by, moments.largest.round(), moments.largest_by)
    -400.0 1 100.0 0
    """
    ok = isinstance(solutions, list | tuple) and len(solutions) > 0
    ok = ok and all(isinstance(solution, Solution) for solution in solutions)
    require(ok, "envelope: solutions", solutions, "a list of one or more fx_beam.Solution")
    if isinstance(part, Output):
        require(s is None, "envelope: s", s, "left out, as the output has its place")
        return _envelope([solution.value(part) for solution in solutions])
    require(isinstance(part, Beam | str), "envelope: part", part, "an fx_beam.Output or a beam")
    places = np.linspace(0.0, _length(solutions[0], part), _PLACES) if s is None else s
    forces = [solution.resultants(part).at(places) for solution in solutions]
    parts = (_envelope([getattr(force, name) for force in forces]) for name in "NQM")
    return BeamEnvelope(forces[0].s, *parts)


def _length(solution: Solution, beam: Beam | str) -> float:
    name = beam.name if isinstance(beam, Beam) else beam
    if name not in solution.beams:
        raise SceneError(f"envelope: {name!r} is no beam of these solutions")
    return float(solution.beams[name].length)


def _envelope(rows: Sequence[np.ndarray]) -> Envelope:
    """Of rows (n, ...) of each solution."""
    shapes = {values.shape[1:] for values in rows}
    require(len(shapes) == 1, "envelope: solutions", shapes, "of scenes with equal parts")
    least, largest = (np.stack([f(v, axis=0) for v in rows]) for f in (np.min, np.max))
    least_by, largest_by = least.argmin(axis=0), largest.argmax(axis=0)
    return Envelope(least.min(axis=0), largest.max(axis=0), least_by, largest_by)
