"""Stresses at the edges of sections, from section forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import require
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import label
from fx_beam.scene.section import check_sizes

from .records import BeamResultants
from .section_forces import SectionForces


@dataclass(frozen=True, repr=False)
class BeamStress:
    """Stresses along a beam, from its section forces and the sizes of its section.

    The normal stress at the distance e to the left of the axis is N / A - M e / I, the mean shear
    stress Q / As. Stresses are spread linearly over the depth also in curved members: in a
    rectangle of depth h that is bent to the radius R the inner one is 3.4, 7.1 and 20 % larger for
    R / h = 10, 5 and 2 by Winkler's theory.

    Parameters
    ----------
    beam : Beam
        The beam, with its `Section`.
    forces : BeamResultants or SectionForces
        Section forces (rows, places), with their arc lengths s.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = fb.Section.circle(0.02, **fb.materials.steel)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], bar, elements=1)
    >>> scene.clamp(beam.start)
    >>> pull = scene.add_force(beam.end, (314.16, 0.0))
    >>> print(fb.static(scene, linear=True).stress(beam))
    <BeamStress: 2 rows, 1 places, largest 1e+06 Pa>
    """

    beam: Beam
    forces: BeamResultants | SectionForces

    def __repr__(self):
        rows, places = self.forces.N.shape
        return f"<BeamStress: {rows} rows, {places} places, largest {self.largest.max():.4g} Pa>"

    @property
    def s(self) -> np.ndarray:
        """Arc lengths (places,) from the start of the beam [m]."""
        return self.forces.s

    @property
    def lower(self) -> np.ndarray:
        """Normal stress (rows, places) at the lower edge, right of the axis [Pa]."""
        return self._at_edge("lower")

    @property
    def upper(self) -> np.ndarray:
        """Normal stress (rows, places) at the upper edge, left of the axis [Pa]."""
        return self._at_edge("upper")

    @property
    def largest(self) -> np.ndarray:
        """The larger size (rows, places) of the normal stresses at both edges [Pa]."""
        return np.maximum(abs(self.lower), abs(self.upper))

    @property
    def shear(self) -> np.ndarray:
        """Mean shear stress Q / As (rows, places) [Pa]."""
        return self.forces.Q / self._sizes("As")[0]

    def at(self, s: Any, side: str = "after") -> BeamStress:
        """Stresses at any places, from the section forces of `BeamResultants.at`.

        Parameters
        ----------
        s : float or (places,) array of float
            Arc lengths from the start of the beam [m].
        side : {"after", "before"}
            The side of a node or place at which forces jump.

        Returns
        -------
        BeamStress
            Stresses (rows, places).
        """
        of_beam = isinstance(self.forces, BeamResultants)
        require(of_beam, "BeamStress.at: stresses", self, "those of solution.stress, not at places")
        assert isinstance(self.forces, BeamResultants)
        return BeamStress(self.beam, self.forces.at(s, side))

    @property
    def ends(self) -> BeamStress:
        """Stresses (rows, 2) at the start and at the end of the beam, as of `at`."""
        return self.at([0.0, self.beam.length])

    def _at_edge(self, edge: str) -> np.ndarray:
        A, J, place = self._sizes("A", "I", edge)
        return self.forces.N / A - self.forces.M * place / J

    def _sizes(self, *names: str) -> list[np.ndarray]:
        """Sizes (places,) of the section."""
        section = self.beam.section
        check_sizes(section, *names, subject=f"stress of {label(self.beam)}")
        fractions = np.clip(self.s / self.beam.length, 0.0, 1.0)
        return [section.values(name, fractions) for name in names]
