"""Cross-sections of a beam: stiffness, inertia, stored energy; beams too coarse for theirs."""

from __future__ import annotations

import functools
import inspect
import math
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fx_beam import errors
from fx_beam.dual import Dual, DualFloat, MaybeDual, dual_array, floats, scene_number
from fx_beam.errors import IS_DATA, LARGEST, SceneError, as_float, require, shaped, shown, warn_once
from fx_beam.symbolic import Expr, ufl

from .beam import Beam
from .functions import BUILDING, ArrayCalls
from .law import Energy, InternalVariables, check_energy, functions_of_energy

# -- Cross-sections of a beam: stiffness, inertia and stored energy -----------------------------


#: A number, or a function of the fraction of the arc length.
Datum = float | Callable[[float], float]

#: Names of all data that may vary along a beam.
DATA = "EA", "GA", "EI", "rhoA", "rhoI", "retardation"
#: Names of the sizes from which stresses follow.
SIZES = "A", "I", "As", "lower", "upper"
_MAY_BE_ZERO = "rhoA", "rhoI", "rho", "retardation", "r", "slope", "toe"


_MODULI = """E : float or callable
    Young's modulus [Pa].
nu : float
    Poisson's ratio.
rho : float or callable
    Mass density [kg/m^3].
shear_factor : float or callable
    Shear area divided by area; by default that of the shape."""
_MORE = """G : float or callable, optional
    Shear modulus [Pa]; by default E / (2 (1 + nu)). Timber needs it.
retardation : float, callable or a triple of them, optional
    As in `Section` [s].

Returns
-------
Section
    With EA, GA, EI, rhoA and rhoI."""


def _data_of_material(
    A: Datum,
    J: Datum,
    edges: tuple[Datum, Datum] | None,
    E: Datum,
    nu: float = 0.3,
    rho: Datum = 0.0,
    shear_factor: Datum = 5 / 6,
    *,
    G: Datum | None = None,
    retardation: Datum | tuple[Datum, ...] = 0.0,
) -> dict:
    """Data of a `Section` of an area, a second moment of area and edges."""
    require(-1 < as_float(nu) <= 0.5, "Section: nu", nu, "a number in (-1, 0.5]")
    if G is None:
        G = _combined(functools.partial(_shear_modulus, as_float(nu)), E=E)
    return {
        "EA": _combined(_product, E=E, area=A),
        "GA": _combined(_product, shear_factor=shear_factor, G=G, area=A),
        "EI": _combined(_product, E=E, second_moment=J),
        "rhoA": _combined(_product, rho=rho, area=A),
        "rhoI": _combined(_product, rho=rho, second_moment=J),
        "retardation": retardation,
        "A": A,
        "I": J,
        "As": _combined(_product, shear_factor=shear_factor, area=A),
        "edges": edges,
    }


class _Shape(NamedTuple):
    """Area, second moment of area, shear factor, and places of the edges left of the centroid."""

    A: float
    J: float
    shear_factor: float
    lower: float
    upper: float


def _constructor(shape: Callable[..., _Shape] | None) -> Callable[[Callable], Callable]:
    """A constructor from the sizes of a shape, documented by a function of them, and a material.

    Without a shape it has an area, a second moment of area, and a height or None.
    """

    def made_of(documented: Callable) -> Callable[..., Section]:
        own = [*inspect.signature(documented).parameters.values()]
        material = dict(inspect.signature(_data_of_material).parameters)
        for name in ("A", "J", "edges"):
            del material[name]
        if shape is not None:
            material["shear_factor"] = material["shear_factor"].replace(default=None)
        kinds = [part.kind for part in own if part.default is not part.empty]
        if inspect.Parameter.POSITIONAL_OR_KEYWORD in kinds:
            by_name = inspect.Parameter.KEYWORD_ONLY
            material = {name: part.replace(kind=by_name) for name, part in material.items()}
        parts = sorted([*own, *material.values()], key=operator.attrgetter("kind"))
        signature = inspect.Signature(parts, return_annotation="Section")

        @functools.wraps(documented)
        def constructed(*values, **named) -> Section:
            try:
                bound = signature.bind(*values, **named)
            except TypeError as error:
                more = errors.keyword_hint(error, named, signature.parameters)
                raise SceneError(
                    f"Section.{documented.__name__}: {error}{more}. With named sizes write "
                    "**material, as in Section.rectangle(height=0.02, width=0.01, "
                    "**fx_beam.materials.steel)"
                ) from None
            bound.apply_defaults()
            data = bound.arguments
            cls, *sizes = (data.pop(part.name) for part in own)
            edges: Any = None
            if shape is None:
                A, J, height = sizes
                if height is not None:
                    halves = (functools.partial(operator.mul, side) for side in (-0.5, 0.5))
                    edges = tuple(_combined(half, height=height) for half in halves)
            else:
                size = {part.name: value for part, value in zip(own[1:], sizes, strict=True)}
                A, J, shear_factor, *edges = (
                    _combined(functools.partial(_entry, shape, i), **size) for i in range(5)
                )
                if data["shear_factor"] is None:
                    data["shear_factor"] = shear_factor
            return cls(**_data_of_material(A, J, edges and (edges[0], edges[1]), **data))

        constructed.__signature__ = signature  # type: ignore[attr-defined]
        text = inspect.cleandoc(documented.__doc__ or "")
        text = text.replace("{material}", "{moduli}\n{more}")
        constructed.__doc__ = text.replace("{moduli}", _MODULI).replace("{more}", _MORE)
        return constructed

    return made_of


def _rectangle(height: float, width: float) -> _Shape:
    return _Shape(height * width, width * height**3 / 12, 5 / 6, -height / 2, height / 2)


def _circle(diameter: float) -> _Shape:
    A, J = math.pi * diameter**2 / 4, math.pi * diameter**4 / 64
    return _Shape(A, J, 0.9, -diameter / 2, diameter / 2)


def _tube(diameter: float, thickness: float) -> _Shape:
    outer, inner = _circle(diameter), _circle(_inner(diameter, thickness))
    return outer._replace(A=outer.A - inner.A, J=outer.J - inner.J, shear_factor=0.5)


def _box(height: float, width: float, thickness: float) -> _Shape:
    outer = _rectangle(height, width)
    inner = _rectangle(_inner(height, thickness), _inner(width, thickness))
    A = outer.A - inner.A
    return outer._replace(A=A, J=outer.J - inner.J, shear_factor=2 * thickness * height / A)


# A part of a profile: its area, the height of its centroid, and its own second moment of area.
_Part = tuple[float, float, float]


def _plate(height: float, width: float, bottom: float) -> _Part:
    """A rectangle above the height of its bottom."""
    return height * width, bottom + height / 2, width * height**3 / 12


def _fillet(r: float, face: float, side: int, sign: int = 1) -> _Part:
    """What a radius adds (1) in a corner above (1) or below (-1) a face, or takes (-1) at a tip."""
    A = (1 - math.pi / 4) * r**2
    depth = (10 - 3 * math.pi) / (12 - 3 * math.pi) * r
    J = (1 / 3 - math.pi / 16 - 1 / (9 * (4 - math.pi))) * r**4
    return sign * A, face + sign * side * depth, sign * J


def _wedge(run: float, slope: float, face: float, side: int, sign: int) -> _Part:
    """What a slope adds (1) near the web above (1) or below (-1) a face, or takes (-1) at a tip."""
    rise = slope * run
    A, J = run * rise / 2, run * rise**3 / 36
    return sign * A, face + sign * side * rise / 3, sign * J


def _profile(height: float, web: float, parts: Iterable[_Part]) -> _Shape:
    """A shape of parts above its lower edge; shear goes through the area of its `web`."""
    parts = list(parts)
    A = sum(area for area, _, _ in parts)
    centre = sum(area * y for area, y, _ in parts) / A
    J = sum(own + area * (y - centre) ** 2 for area, y, own in parts)
    return _Shape(A, J, web / A, -centre, height - centre)


def _i_beam(h: float, b: float, tw: float, tf: float, r: float) -> _Shape:
    _check_plates("i_beam", h, b, tw, tf, 2, r)
    parts = [_plate(tf, b, 0.0), _plate(tf, b, h - tf), _plate(h - 2 * tf, tw, tf)]
    fillets = [_fillet(r, tf, 1), _fillet(r, h - tf, -1)]
    return _profile(h, (h - tf) * tw, parts + 2 * fillets)


def _channel(
    h: float, b: float, tw: float, tf: float, r: float, slope: float, toe: float
) -> _Shape:
    _check_plates("channel", h, b, tw, tf, 2, r)
    parts = [_plate(tf, b, 0.0), _plate(tf, b, h - tf), _plate(h - 2 * tf, tw, tf)]
    for face, side in ((tf, 1), (h - tf, -1)):
        parts += [_wedge(b / 2 - tw, slope, face, side, 1), _wedge(b / 2, slope, face, side, -1)]
        tip = face - side * slope * b / 2
        parts += [_fillet(r, face, side), _fillet(toe, tip, side, -1)]
    return _profile(h, (h - tf) * tw, parts)


def _angle(h: float, b: float, t: float, r: float, toe: float) -> _Shape:
    _check_plates("angle", h, b, t, t, 1, r)
    parts = [_plate(t, b, 0.0), _plate(h - t, t, t), _fillet(r, t, 1)]
    parts += [_fillet(toe, t, 1, -1), _fillet(toe, h, 1, -1)]
    return _profile(h, 5 / 6 * h * t, parts)


def _tee(h: float, b: float, tw: float, tf: float, r: float) -> _Shape:
    _check_plates("tee", h, b, tw, tf, 1, r)
    parts = [_plate(tf, b, h - tf), _plate(h - tf, tw, 0.0)] + 2 * [_fillet(r, h - tf, -1)]
    return _profile(h, 5 / 6 * h * tw, parts)


def _check_plates(
    name: str, h: float, b: float, tw: float, tf: float, flanges: int, r: float
) -> None:
    """Refuse walls that do not fit into the height and width of a profile."""
    subject = f"Section.{name}"
    require(0 < tw < b, f"{subject}: thickness of the web", tw, f"less than the width, {b:g}")
    limit = h / flanges
    require(0 < tf < limit, f"{subject}: thickness of a flange", tf, f"less than {limit:g}")
    room = min(b - tw, limit - tf)
    require(0 <= r <= room, f"{subject}: radius r", r, f"a number from 0 to {room:g}")


@errors.answering
@dataclass(frozen=True)
class Section:
    r"""Stiffness and inertia of a cross-section, per reference length.

    The stored energy per length is quadratic in axial strain, shear strain and curvature,
    :math:`W = \frac{1}{2} (EA\,\varepsilon^2 + GA\,\gamma^2 + EI\,\kappa^2)` (eq. 11), unless
    `strain_energy` gives another one.

    Each stiffness and inertia may be a function of the fraction of the arc length, from 0 at the
    start of the beam to 1 at its end, for a tapered or stepped beam. The function takes and returns
    a number; it may use Python, NumPy or UFL. It is evaluated at the Gauss points: a jump between
    two elements is exact; for a jump inside an element `add_beam` warns.

    Parameters
    ----------
    EA : float or callable
        Axial stiffness [N].
    GA : float or callable
        Shear stiffness, shear factor included [N].
    EI : float or callable
        Bending stiffness [N m^2].
    rhoA : float or callable
        Mass per length [kg/m]; zero for a beam whose mass is lumped or neglected.
    rhoI : float or callable
        Rotary inertia per length [kg m].
    strain_energy : callable, optional
        ``strain_energy(eps, gamma, kappa)``, the stored energy per length [J/m] as a UFL expression
        of axial strain, shear strain and curvature [1/m]. It replaces the quadratic energy; EA, GA
        and EI may then be omitted. With `internal` it has a fourth argument, the vector of internal
        variables.
    retardation : float, callable or a triple of them, optional
        Retardation times tau of a Kelvin-Voigt material [s], for axial, shear and bending strains,
        or one time for all. The term C tau dE/dt is added to the resultants, with the stiffness C
        of the undeformed section and the strain E. A vibration of angular frequency w has the
        damping ratio tau w/2. No damping by default. With `strain_energy` there must be one time
        for all strains.
    internal : InternalVariables, optional
        Internal variables of a material whose state depends on the past, such as a plastic
        curvature. They need a `strain_energy`.

    A, I, As : float or callable, optional
        Area [m^2], second moment of area [m^4] and shear area [m^2], for `Solution.stress`. The
        constructors below set them.
    edges : (float, float) or two callables, optional
        Positions of the lower and the upper edge [m]: distances from the axis, positive to the left
        of the beam's direction, so that the lower one is negative. The axis is the line of
        centroids.

    Raises
    ------
    SceneError
        For a stiffness that is not positive and finite, a negative or non-finite inertia, or a
        `strain_energy` that is not a scalar UFL expression.

    References
    ----------
    Ibrahimbegovic & Mamouri (1999), eqs 8 and 11.

    Examples
    --------
    >>> import fx_beam as fb
    >>> section = fb.Section(EA=1e6, GA=4e5, EI=lambda fraction: 100 * (1 - fraction / 2))
    >>> section.varies("EI"), section.rhoA
    (True, 0.0)

    A material that stiffens in tension.

    >>> stiffening = fb.Section(
    ...     strain_energy=lambda eps, gamma, kappa: 50 * (eps**2 + eps**4 + gamma**2 + kappa**2)
    ... )
    """

    EA: Datum | None = field(default=None, metadata=IS_DATA)
    GA: Datum | None = field(default=None, metadata=IS_DATA)
    EI: Datum | None = field(default=None, metadata=IS_DATA)
    rhoA: Datum = field(default=0.0, metadata=IS_DATA)
    rhoI: Datum = field(default=0.0, metadata=IS_DATA)
    strain_energy: Energy | None = field(default=None, metadata=IS_DATA)
    retardation: Datum | tuple[Datum, ...] = field(default=0.0, metadata=IS_DATA)
    internal: InternalVariables | None = None
    A: Datum | None = field(default=None, metadata=IS_DATA, repr=False)
    I: Datum | None = field(default=None, metadata=IS_DATA, repr=False)  # noqa: E741
    As: Datum | None = field(default=None, metadata=IS_DATA, repr=False)
    edges: tuple[Datum, Datum] | None = field(default=None, metadata=IS_DATA, repr=False)

    def __post_init__(self):
        times: Any = self.retardation
        if isinstance(times, list) or getattr(times, "ndim", 0) == 1:
            object.__setattr__(self, "retardation", tuple(times))
        ok = self.strain_energy is None or not isinstance(self.retardation, tuple)
        expected = "one time for all strains, as there is a strain_energy"
        require(ok, "Section: retardation", self.retardation, expected)
        for time in self._times:
            _value("retardation", time, 0.5)
        for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
            datum = getattr(self, name)
            if datum is None and name not in _MAY_BE_ZERO:
                if self.strain_energy is None:
                    raise SceneError(f"Section: {name} is missing. Give it, or a strain_energy")
                continue
            value = _value(name, datum, 0.5)
            if not callable(datum):
                object.__setattr__(self, name, value)
        for name in SIZES:
            for datum in self._data(name):
                if datum is not None:
                    _value(name, datum, 0.5)
        check_energy(self.strain_energy, self.internal)

    def values(self, name: str, fractions: np.ndarray) -> np.ndarray:
        """Values of a stiffness, inertia, retardation time or size along a beam.

        Parameters
        ----------
        name : {"EA", "GA", "EI", "rhoA", "rhoI", "retardation", "A", "I", "As", "lower", "upper"}
            Its name; "lower" and "upper" are the edges.
        fractions : float array
            Fractions of the arc length.

        Returns
        -------
        float array
            The values, in the shape of the fractions; zero for an omitted stiffness. For
            "retardation" a last axis has the times of axial, shear and bending strains.

        Raises
        ------
        SceneError
            For a stiffness that is not positive and finite, or a negative or non-finite inertia.
        """
        _check_name(name, "values")
        places = errors.real_array(fractions)
        require(places.size > 0, "Section.values: fractions", fractions, "an array of numbers")
        return scene_number(values_along(self, name, places, None))

    def constants(self, names: tuple[str, ...]) -> Any:
        """Values of data if none varies: of several a list, of one itself; zero if omitted.

        Parameters
        ----------
        names : tuple of str
            Their names, as of `values`.

        Returns
        -------
        float, list or None
            The values; for "retardation" the times of axial, shear and bending strains. None if a
            value is a function.
        """
        values: list = []
        for name in names:
            datum = self._times if name == "retardation" else getattr(self, name)
            is_triple = isinstance(datum, tuple)
            if any(map(callable, datum)) if is_triple else callable(datum):
                return None
            values.append([as_float(x or 0.0) for x in datum] if is_triple else datum or 0.0)
        return values if len(names) > 1 else values[0]

    def _data(self, name: str) -> tuple[Datum | None, ...]:
        """A stiffness, an inertia or a size, or three retardation times."""
        if name in ("lower", "upper"):
            return (self._edges[name == "upper"],)
        return self._times if name == "retardation" else (getattr(self, name),)

    @property
    def _edges(self) -> tuple[Datum | None, Datum | None]:
        """Lower and upper edge."""
        edges = (None, None) if self.edges is None else self.edges
        is_pair = isinstance(edges, tuple | list) and len(edges) == 2
        require(is_pair, "Section: edges", edges, "two distances: of the lower and the upper edge")
        return edges[0], edges[1]

    @property
    def _times(self) -> tuple[Datum, ...]:
        """Retardation times of axial, shear and bending strains."""
        times = self.retardation
        if not isinstance(times, tuple):
            return times, times, times
        expected = "one time, or three: for axial, shear and bending strains"
        require(len(times) == 3, "Section: retardation", times, expected)
        return times

    @property
    def damped(self) -> bool:
        """Whether there are retardation times other than zero."""
        return any(callable(time) or time != 0 for time in self._times)

    def varies(self, name: str) -> bool:
        """Whether a stiffness, inertia or retardation time is a function of the arc length.

        Parameters
        ----------
        name : {"EA", "GA", "EI", "rhoA", "rhoI", "retardation"}
            Its name.

        Returns
        -------
        bool
            True for a function, False for a number.
        """
        _check_name(name, "varies")
        return any(map(callable, self._data(name)))

    @classmethod
    @_constructor(_rectangle)
    def rectangle(cls, height: Datum, width: Datum):
        """Rectangular section.

        Parameters
        ----------
        height : float or callable
            Depth in the plane of motion [m].
        width : float or callable
            Depth across the plane [m].
        {material}

        Examples
        --------
        >>> import fx_beam as fb
        >>> steel = fb.Section.rectangle(height=0.02, width=0.01, E=210e9, rho=7850.0)
        >>> round(steel.EI), round(steel.rhoA, 2)
        (1400, 1.57)
        """

    @classmethod
    @_constructor(_circle)
    def circle(cls, diameter: Datum):
        """Solid circular section.

        Parameters
        ----------
        diameter : float or callable
            Diameter [m].
        {material}
        """

    @classmethod
    @_constructor(_tube)
    def tube(cls, diameter: Datum, thickness: Datum):
        """Circular hollow section; the default shear factor is that of a thin wall.

        Parameters
        ----------
        diameter : float or callable
            Outer diameter [m].
        thickness : float or callable
            Thickness of the wall [m]; at most half the diameter.
        {material}

        Examples
        --------
        A tube of steel of 48.3 mm by 3.2 mm: EN 10210-2 gives 4.53 cm^2 and 11.6 cm^4.

        >>> import fx_beam as fb
        >>> tube = fb.Section.tube(0.0483, 0.0032, E=1.0)
        >>> round(1e4 * tube.EA, 2), round(1e8 * tube.EI, 1)
        (4.53, 11.6)
        """

    @classmethod
    @_constructor(_box)
    def box(cls, height: Datum, width: Datum, thickness: Datum):
        """Rectangular hollow section with sharp corners.

        By default the shear area is the area of the two walls along the height.

        Parameters
        ----------
        height : float or callable
            Outer depth in the plane of motion [m].
        width : float or callable
            Outer depth across the plane [m].
        thickness : float or callable
            Thickness of all four walls [m]; at most half of each depth.
        {material}
        """

    @classmethod
    @_constructor(None)
    def from_area(cls, area: Datum, second_moment: Datum, *, height: Datum | None = None):
        """Section of given area and second moment of area, as tables of profiles have them.

        Parameters
        ----------
        area : float or callable
            Area [m^2].
        second_moment : float or callable
            Second moment of area about the centroid, for bending in the plane of motion [m^4].
        {moduli}
        height : float or callable, optional
            Depth in the plane of motion [m], for the stresses of a symmetric section.
        {more}

        Examples
        --------
        IPE 300: 53.8 cm^2, 8360 cm^4.

        >>> import fx_beam as fb
        >>> ipe = fb.Section.from_area(53.8e-4, 8360e-8, height=0.3, **fb.materials.steel)
        >>> ipe.edges
        (-0.15, 0.15)
        """

    @classmethod
    @_constructor(_i_beam)
    def i_beam(cls, h: Datum, b: Datum, tw: Datum, tf: Datum, r: Datum = 0.0):
        """Section of two flanges and a web between them, which bends in the plane of the web.

        By default the shear area is that of the web between the middles of the flanges,
        ``(h - tf) tw``.

        Parameters
        ----------
        h : float or callable
            Depth in the plane of motion [m].
        b : float or callable
            Width of the flanges [m].
        tw, tf : float or callable
            Thickness of the web and of each flange [m].
        r : float or callable
            Radius of the fillets between web and flanges [m].
        {material}

        Examples
        --------
        IPE 300 by its table: 53.8 cm^2, 8360 cm^4.

        >>> import fx_beam as fb
        >>> ipe = fb.Section.i_beam(0.3, 0.15, 0.0071, 0.0107, 0.015, **fb.materials.steel)
        >>> round(1e4 * ipe.A, 1), round(1e8 * ipe.I)
        (53.8, 8356)
        """

    @classmethod
    @_constructor(_channel)
    def channel(
        cls,
        h: Datum,
        b: Datum,
        tw: Datum,
        tf: Datum,
        r: Datum = 0.0,
        slope: Datum = 0.0,
        toe: Datum = 0.0,
    ):
        """Section of a web with two flanges on one side, which bends in the plane of the web.

        The model is that of a channel which is held against torsion. The default shear area is that
        of `i_beam`.

        Parameters
        ----------
        h : float or callable
            Depth in the plane of motion [m].
        b : float or callable
            Width of the flanges, web included [m].
        tw, tf : float or callable
            Thickness of the web, and of each flange in the middle of its width [m].
        r : float or callable
            Radius of the fillets between web and flanges [m].
        slope : float or callable
            Slope of the inner faces of the flanges: 0.08 of UPN up to 300.
        toe : float or callable
            Radius at the tips of the flanges [m].
        {material}

        Examples
        --------
        UPN 200 by its table: 32.2 cm^2, 1910 cm^4.

        >>> import fx_beam as fb
        >>> upn = fb.Section.channel(
        ...     0.2, 0.075, 0.0085, 0.0115, 0.0115, slope=0.08, toe=0.006, **fb.materials.steel
        ... )
        >>> round(1e4 * upn.A, 1), round(1e8 * upn.I)
        (32.3, 1917)
        """

    @classmethod
    @_constructor(_angle)
    def angle(cls, h: Datum, b: Datum, t: Datum, r: Datum = 0.0, toe: Datum = 0.0):
        """Section of two legs, the lower one across the plane of motion.

        The principal axes of an angle are inclined to the plane of motion. The model is that of an
        angle which is held so that it bends in the plane. By default the shear area is 5/6 of the
        area of the leg in the plane.

        Parameters
        ----------
        h : float or callable
            Depth in the plane of motion [m].
        b : float or callable
            Width of the leg across the plane [m].
        t : float or callable
            Thickness of both legs [m].
        r : float or callable
            Radius of the fillet between them [m].
        toe : float or callable
            Radius at the tips of the legs [m].
        {material}

        Examples
        --------
        L 100 x 100 x 10 by its table: 19.2 cm^2, 177 cm^4, centroid at 28.2 mm.

        >>> import fx_beam as fb
        >>> leg = fb.Section.angle(0.1, 0.1, 0.01, 0.012, toe=0.006, **fb.materials.steel)
        >>> round(1e4 * leg.A, 1), round(1e8 * leg.I), round(-1e3 * leg.edges[0], 1)
        (19.2, 177, 28.2)
        """

    @classmethod
    @_constructor(_tee)
    def tee(cls, h: Datum, b: Datum, tw: Datum, tf: Datum, r: Datum = 0.0):
        """Section of a web with a flange at its upper edge.

        By default the shear area is 5/6 of the area of the web over the whole depth.

        Parameters
        ----------
        h : float or callable
            Depth in the plane of motion [m].
        b : float or callable
            Width of the flange [m].
        tw, tf : float or callable
            Thickness of the web and of the flange [m].
        r : float or callable
            Radius of the fillets between them [m].
        {material}
        """


def functions_of_section(section: Section) -> Iterator[tuple[str, Expr]]:
    """Expressions of the user's functions of a section, by kind."""
    return functions_of_energy(section.strain_energy, section.internal, 3)


def values_along(
    section: Section, name: str, fractions: np.ndarray, arrays: ArrayCalls | None
) -> MaybeDual:
    """`Section.values`, by one call of a function for all fractions if it accepts `arrays`."""
    values = [_values(name, datum, fractions, arrays) for datum in section._data(name)]
    return np.stack(values, axis=-1) if len(values) > 1 else values[0]


def stress_weights(section: Section, quantity: str, edge: str | None, fraction: float) -> MaybeDual:
    """Shares (3,) of N, Q and M in a stress at a fraction of the arc length: N / A - M e / I."""
    if quantity == "shear_stress":
        return dual_array([0.0, 1 / _size(section, "As", fraction), 0.0])
    A, J = _size(section, "A", fraction), _size(section, "I", fraction)
    assert edge is not None  # as an Output has one
    return dual_array([1 / A, 0.0, -_size(section, edge, fraction) / J])


def _size(section: Section, name: str, fraction: float) -> float:
    check_sizes(section, name)
    (datum,) = section._data(name)
    assert datum is not None
    return _value(name, datum, fraction)


def has_stresses(section: Section | None) -> bool:
    """Whether normal stresses of a section are known."""
    if section is None or section.strain_energy is not None:
        return False
    return None not in (section.A, section.I, section.edges)


def check_sizes(section: Section | None, *names: str, subject: str = "stress") -> None:
    """Refuse the stresses of a section that lacks sizes, or has another law than a linear one."""
    if section is None:
        raise SceneError(
            f"{subject}: a saved file does not hold sections; take the solution as simulate or "
            "static gave it"
        )
    if section.strain_energy is not None:
        raise SceneError(
            f"{subject}: N / A and M e / I hold for linear sections. This one has a strain_energy "
            "of its own, by which stresses have another distribution"
        )
    missing = [name for name in names if section._data(name) == (None,)]
    if missing:
        name = "edges" if missing[0] in ("lower", "upper") else missing[0]
        value = "(lower, upper)" if name == "edges" else "..."
        raise SceneError(
            f"{subject}: the section has no {name}. Give Section(..., {name}={value}), or take a "
            "constructor that knows its sizes, such as Section.rectangle or "
            "Section.from_area(..., height=)"
        )


def _check_name(name, method: str) -> None:
    expected = f"one of {[*DATA, *SIZES]}"
    require(errors.is_one_of(name, (*DATA, *SIZES)), f"Section.{method}: name", name, expected)


def _values(
    name: str, datum: Datum | None, fractions: np.ndarray, arrays: ArrayCalls | None
) -> MaybeDual:
    """Values in the shape of fractions of the arc length; zero for no stiffness."""
    if not callable(datum):
        value = 0.0 if datum is None else _value(name, datum)
        return np.broadcast_to(dual_array(value), fractions.shape)

    def each(rows: np.ndarray) -> MaybeDual:
        return dual_array([[_value(name, datum, float(f))] for f in rows[:, 0]])

    rows = fractions.reshape(-1, 1)
    if arrays is not None:
        is_dual = isinstance(_value(name, datum, float(rows[0, 0])), DualFloat)
        values = arrays.values(datum, 1, rows, name, each, is_dual)
        if (floats(values) > 0).all():  # else the calls below tell what is wrong
            return values.reshape(fractions.shape)
    return each(rows).reshape(fractions.shape)


def _combined(function: Callable[..., float], **data: Datum) -> Datum:
    """A function of stiffness or size data; it varies along the beam if one of the data does."""
    value = functools.partial(_of_data, function, data)
    return value if any(map(callable, data.values())) else value(0.0)


def _of_data(function: Callable[..., float], data: dict[str, Datum], fraction: float) -> float:
    return function(*(_value(name, datum, fraction) for name, datum in data.items()))


def _entry(shape: Callable[..., _Shape], i: int, *size: float, **sizes: float) -> float:
    return shape(*size, **sizes)[i]


def _inner(outer: float, thickness: float) -> float:
    """Inner size of a hollow section."""
    expected = f"at most half of the outer size, {as_float(outer) / 2:g}"
    require(2 * thickness <= outer, "Section: thickness", thickness, expected)
    return outer - 2 * thickness


def _product(*factors: float) -> float:
    return functools.reduce(operator.mul, factors)


def _shear_modulus(nu: float, E: float) -> float:
    return E / (2 * (1 + nu))


def _value(name: str, datum: Datum, fraction: float = 0.0) -> float:
    """Value of a datum; it must be finite and positive (zero is allowed for inertia)."""
    place = ""
    if callable(datum):
        place = f" at the fraction {fraction:.4g} of the length"
        datum = _evaluated(datum, fraction, f"Section: {name}{place}")
    may_be_zero = name in _MAY_BE_ZERO
    number = as_float(datum)
    if name in ("lower", "upper"):
        ok = abs(number) <= LARGEST
        require(ok, f"Section: {name} edge{place}", datum, "a finite distance from the axis")
    elif not ((0 < number or (may_be_zero and number == 0)) and number <= LARGEST):
        expected = "zero or positive and finite" if may_be_zero else "positive and finite"
        expected += errors.size_limit(datum, expected)
        raise SceneError(f"Section: {name} = {shown(datum)}{place} must be {expected}")
    return number


def _evaluated(datum: Callable, fraction: float, name: str) -> float:
    try:
        value = datum if isinstance(datum, ufl.core.expr.Expr) else datum(fraction)
        if isinstance(value, float) or (isinstance(value, Dual) and not value.ndim):
            return as_float(value)
        # UFL functions of numbers return numbers or expressions of numbers.
        if isinstance(value, ufl.core.expr.Expr):
            errors.refuse_fields_in(value, name)
            value = value(())
    except SceneError:
        raise  # from a datum that this one is computed from
    except Exception as error:
        raise SceneError(f"{name}: calling it raised {error!r}") from error
    return as_float(shaped(value, 1, name)[0])


# -- Warnings of beams whose elements are too coarse for their sections, as far as the scene tells


# Relative change of a quantity within an element that counts, and its part that is left only of a
# jump after so many halvings of the element; distance of the first places to its ends.
_CHANGE, _LEFT, _HALVINGS, _INSIDE = 0.02, 0.5, 16, 1e-6
# Places in an element between which a quantity is looked at first.
_PLACES = np.array([_INSIDE, 0.25, 0.5, 0.75, 1 - _INSIDE])
# Number of elements of degree 2 or 3 from which on two layers bend as one, with an error below 1 %.
_LAYER_ELEMENTS = 16


def warn_of_coarse_elements(beam: Beam) -> None:
    """Warn of stiffness or mass that jumps in an element, and of layers held at few places."""
    for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
        place = None
        if callable(getattr(beam.section, name)):
            try:
                place = _jump(beam, name)
            except SceneError:  # the analysis says where the function fails
                return
        if place is not None:
            warn_once(
                f"beam {beam.name!r}: {name} jumps inside an element, near the fraction "
                f"{place:.4g} of its length: deflections or frequencies may be wrong by several "
                "per cent. Begin a new beam there, or take elements that end there"
            )
            return
    if beam.carriers and beam.degree > 1 and beam.elements < _LAYER_ELEMENTS:
        warn_once(
            f"beam {beam.name!r}: its offset is held at the ends of its {beam.elements} elements "
            f"only, of degree {beam.degree}: two layers bend as one with {_LAYER_ELEMENTS} "
            "elements or more; take them, or degree=1"
        )


def _jump(beam: Beam, name: str) -> float | None:
    """The fraction of the length at which a quantity jumps inside an element; None if nowhere."""
    edges = floats(beam.s) / float(beam.length)

    def logs(places: np.ndarray) -> np.ndarray:
        values = floats(values_along(beam.section, name, places, BUILDING.get()))
        return np.log(np.maximum(values, np.finfo(float).tiny))  # masses may be zero

    places = edges[:-1, None] + np.diff(edges)[:, None] * _PLACES
    changes = abs(np.diff(values := logs(places), axis=1))
    first = changes.argmax(axis=1)
    rows = np.flatnonzero(changes.max(axis=1) > _CHANGE)
    low, high = places[rows, first[rows]], places[rows, first[rows] + 1]
    at_low, at_high = values[rows, first[rows]], values[rows, first[rows] + 1]
    most = abs(at_high - at_low)
    for _ in range(_HALVINGS):
        rows = np.flatnonzero(abs(at_high - at_low) > _LEFT * most)
        if not len(rows):
            return None
        low, high, at_low, at_high, most = (x[rows] for x in (low, high, at_low, at_high, most))
        middle = (low + high) / 2
        value = logs(middle)
        ahead = abs(at_high - value) > abs(value - at_low)
        low, at_low = np.where(ahead, middle, low), np.where(ahead, value, at_low)
        high, at_high = np.where(ahead, high, middle), np.where(ahead, at_high, value)
    return float((low[0] + high[0]) / 2)
