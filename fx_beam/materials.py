"""Materials: elastic moduli, density and thermal expansion, with their sources.

Values at room temperature for a first estimate; a certificate of your material is better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from .errors import SceneError, answering_keywords

__all__ = ["Material"]


@answering_keywords
@dataclass(frozen=True)
class Material:
    """A linear elastic material: ``Section.rectangle(0.02, 0.01, **material)`` reads it.

    Of an isotropic material ``*material`` gives E, nu and rho in this order.

    Parameters
    ----------
    E : float
        Young's modulus [Pa].
    nu : float or None
        Poisson's ratio; None for a material that is not isotropic, which has a `G`.
    rho : float
        Mass density [kg/m^3].
    alpha : float
        Linear thermal expansion [1/K], for `thermal`.
    source : str
        Source of the values.
    G : float, optional
        Shear modulus [Pa]; by default that of an isotropic material, E / (2 (1 + nu)).

    Examples
    --------
    A steel strip of 20 mm by 2 mm, in metres and in millimetres: the same bending stiffness, in
    N m^2 and N mm^2.

    >>> import fx_beam as fb
    >>> strip = fb.Section.rectangle(height=0.002, width=0.02, **fb.materials.steel)
    >>> in_mm = fb.Section.rectangle(2.0, 20.0, *fb.materials.steel.in_mm)
    >>> round(strip.EI, 9), round(in_mm.EI, 3)
    (2.8, 2800000.0)
    """

    E: float
    nu: float | None
    rho: float
    alpha: float
    source: str
    G: float | None = None

    def __iter__(self) -> Iterator[float]:
        if self.nu is None:
            kind = self.source.partition(":")[0]
            raise SceneError(f"{kind}: this material is not isotropic. Write **material, not *")
        return iter((self.E, self.nu, self.rho))

    def keys(self) -> tuple[str, ...]:
        """Names of the arguments of sections that ``**material`` gives."""
        return ("E", "G", "rho") if self.nu is None else ("E", "nu", "rho")

    def __getitem__(self, name: str) -> float:
        return getattr(self, name)

    @property
    def in_mm(self) -> Material:
        """Material in N, mm, t and s: E [N/mm^2], rho [t/mm^3]; gravity is then 9810 mm/s^2."""
        G = None if self.G is None else 1e-6 * self.G
        return replace(self, E=1e-6 * self.E, rho=1e-12 * self.rho, G=G)


steel = Material(210e9, 0.3, 7850.0, 12e-6, "EN 1993-1-1, 3.2.6; EN 1991-1-1, table A.4")
stainless_steel = Material(200e9, 0.3, 7900.0, 16e-6, "1.4301: EN 1993-1-4, 2.1.3; EN 10088-1")
aluminium = Material(70e9, 0.3, 2700.0, 23e-6, "EN 1999-1-1, 3.2.5")
titanium = Material(113.8e9, 0.342, 4430.0, 8.6e-6, "Ti-6Al-4V: ASM Aerospace Specification Metals")
glass = Material(70e9, 0.2, 2500.0, 9e-6, "soda lime glass: EN 572-1")
concrete = Material(33e9, 0.2, 2500.0, 10e-6, "C30/37, uncracked: EN 1992-1-1, 3.1; EN 1991-1-1")
softwood = Material(11e9, None, 420.0, 5e-6, "C24, along the grain: EN 338; EN 1991-1-5", 0.69e9)
glulam = Material(11.5e9, None, 420.0, 5e-6, "GL 24h: EN 14080; EN 1991-1-5", 0.65e9)
