"""Check of eq. 4, t . phi' > 0 at every Gauss point: no section may be inverted."""

from __future__ import annotations

import logging

import numpy as np

from fx_beam.dual import floats
from fx_beam.results.records import Stats
from fx_beam.scene.beam import arc_lengths, gauss_rule

from .model import Model

_log = logging.getLogger("fx_beam")
_INVERTED = (
    "%s: beam %r has an inverted section at its arc length %.4g m and %s = %.6g: there t . phi' is "
    "%.3g, but must be positive (eq. 4). Check the units of loads, velocities and stiffnesses, or "
    "make the section stiffer"
)


def count_inverted(model: Model, stats: Stats, number: int, t: float, q: np.ndarray) -> None:
    """Count steps with inverted sections; a warning reports the first, at t [s] or load factor.

    With the beam and the position of the worst section at displacements and rotations q (size,).
    """
    stats.inverted += number
    if stats.inverted > number:
        return
    beams = model.forms.beams
    assert beams is not None  # sections are those of beams
    stretch = beams.normal_stretch(q)
    cell, point = np.unravel_index(np.argmin(stretch), stretch.shape)
    beam_number = model.mesh.beam_of_cell[cell]
    beam, element = model.scene.beams[beam_number], cell - model.mesh.cells[beam_number][0]
    start, end = beam.s[element : element + 2]
    s = start + (end - start) * gauss_rule(beam.degree)[0][point]
    place = stats.scheme, beam.name, s, "load factor" if stats.static else "t", t
    _log.warning(_INVERTED, *place, stretch[cell, point])


def least_energy(model: Model) -> float:
    """Lower bound of the strain energy of a Gauss point whose axial strain is -1 [J].

    It is EA/2 times the length of the Gauss point, here a smaller one; 0 for stored energies that
    are not quadratic.
    """
    least: float = np.inf
    for beam, length in zip(model.scene.beams, model.mesh.shortest, strict=True):
        section = beam.section
        if section.strain_energy is not None:
            return 0.0
        EA = section.EA
        if callable(EA):
            gauss, _ = gauss_rule(beam.degree)
            EA = floats(section.values("EA", arc_lengths(beam, gauss) / beam.length)).min()
        least = min(least, float(EA) * length / 50)
    return least
