"""Materials: Young's modulus, Poisson's ratio, density and thermal expansion, with their sources.

Values at room temperature for a first estimate; a certificate of your material is better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

__all__ = ["Material"]


@dataclass(frozen=True)
class Material:
    """A linear elastic material: ``Section.rectangle(height, width, *material)`` reads it.

    Parameters
    ----------
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    rho : float
        Mass density [kg/m^3].
    alpha : float
        Linear thermal expansion [1/K], for `thermal`.
    source : str
        Where the values are from.

    Examples
    --------
    A steel strip of 20 mm by 2 mm, in metres and in millimetres: the same bending stiffness, in
    N m^2 and N mm^2.

    >>> import fx_beam as fb
    >>> strip = fb.Section.rectangle(0.002, 0.02, *fb.materials.steel)
    >>> in_mm = fb.Section.rectangle(2.0, 20.0, *fb.materials.steel.in_mm)
    >>> round(strip.EI, 9), round(in_mm.EI, 3)
    (2.8, 2800000.0)
    """

    E: float
    nu: float
    rho: float
    alpha: float
    source: str

    def __iter__(self) -> Iterator[float]:
        return iter((self.E, self.nu, self.rho))

    @property
    def in_mm(self) -> Material:
        """The same in N, mm, t and s: E [N/mm^2], rho [t/mm^3]; gravity is then 9810 mm/s^2."""
        return replace(self, E=1e-6 * self.E, rho=1e-12 * self.rho)


steel = Material(210e9, 0.3, 7850.0, 12e-6, "EN 1993-1-1, 3.2.6; EN 1991-1-1, table A.4")
stainless_steel = Material(200e9, 0.3, 7900.0, 16e-6, "1.4301: EN 1993-1-4, 2.1.3; EN 10088-1")
aluminium = Material(70e9, 0.3, 2700.0, 23e-6, "EN 1999-1-1, 3.2.5")
titanium = Material(113.8e9, 0.342, 4430.0, 8.6e-6, "Ti-6Al-4V: ASM Aerospace Specification Metals")
glass = Material(70e9, 0.2, 2500.0, 9e-6, "soda lime glass: EN 572-1")
concrete = Material(33e9, 0.2, 2500.0, 10e-6, "C30/37, uncracked: EN 1992-1-1, 3.1; EN 1991-1-1")
