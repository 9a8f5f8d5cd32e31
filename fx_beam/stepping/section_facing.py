"""Sections that face backwards: eq. 4 asks for t . phi' > 0 at every Gauss point."""

from __future__ import annotations

import logging

import numpy as np

from fx_beam.fem import dolfinx_api
from fx_beam.model.model import Model
from fx_beam.results.audit import Stats

_log = logging.getLogger("fx_beam")


class Facing:
    """Watches that no section of a beam faces backwards at the end of a step."""

    def __init__(self, model: Model, stats: Stats):
        self._model, self._stats = model, stats
        model.forms.compile_facing()
        self.least_energy = _least_energy(model)

    def look(self, t: float, q: np.ndarray) -> None:
        """Look at the end of a step: t [s] or load factor, displacements and rotations (size,)."""
        if self._model.forms.faces_backwards(q):
            self.found(1, t, q)

    def found(self, number: int, t: float, q: np.ndarray) -> None:
        """Count steps that end with sections facing backwards; the log tells of the first, at t."""
        if not self._stats.inside_out:
            self._warn(t, q)
        self._stats.inside_out += number

    def _warn(self, t: float, q: np.ndarray) -> None:
        """Name the beam and the place where it is worst."""
        model = self._model
        facing = model.forms.facing(q)
        cell, point = np.unravel_index(np.argmin(facing), facing.shape)
        number = model.mesh.beam_of_cell[cell]
        beam = model.scene.beams[number]
        element = int(np.flatnonzero(model.mesh.cells[number] == cell)[0])
        start, end = beam.s[element : element + 2]
        s = start + (end - start) * dolfinx_api.gauss_points(beam.degree)[point, 0]
        _log.warning(
            "%s: beam %r is turned inside out at its arc length %.4g m and %s = %.6g: there "
            "t . phi' is %.3g, which eq. 4 asks to be positive, and no beam can do that. Look for "
            "a load, a velocity or a stiffness in the wrong unit, or make the section stiffer",
            self._stats.scheme,
            beam.name,
            s,
            "load factor" if self._stats.static else "t",
            t,
            facing[cell, point],
        )


def _least_energy(model: Model) -> float:
    """Less than what one Gauss point stores where its axial strain is -1 [J].

    EA/2 times its share of the element. Energies that are not quadratic have no such bound.
    """
    least = np.inf
    for beam in model.scene.beams:
        if beam.section.strain_energy is not None:
            return 0.0
        lengths = np.diff(beam.s)[:, None]
        s = beam.s[:-1, None] + lengths * dolfinx_api.gauss_points(beam.degree).T
        EA = np.asarray(beam.section.values("EA", s / beam.length))
        least = min(least, (EA * lengths).min() / 50)
    return float(least)
