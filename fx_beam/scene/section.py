"""Cross-sections of a beam: stiffness, inertia and stored energy."""

from __future__ import annotations

import functools
import inspect
import math
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fx_beam.dual import Dual, DualFloat, MaybeDual, dual_array, floats, scene_number
from fx_beam.errors import (
    IS_DATA,
    LARGEST,
    SceneError,
    as_float,
    is_one_of,
    real_array,
    refuse_fields_in,
    require,
    shaped,
    shown,
    size_limit,
)
from fx_beam.symbolic import Expr, ufl

from .functions import ArrayCalls
from .law import Energy, InternalVariables, check_energy, functions_of_energy

#: A number, or a function of the fraction of the arc length.
Datum = float | Callable[[float], float]

#: Names of all data that may vary along a beam.
DATA = "EA", "GA", "EI", "rhoA", "rhoI", "retardation"
_MAY_BE_ZERO = "rhoA", "rhoI", "rho", "retardation"


_MATERIAL = """E : float or callable
    Young's modulus [Pa].
nu : float
    Poisson's ratio.
rho : float or callable
    Mass density [kg/m^3].
shear_factor : float or callable
    Shear area divided by area.
G : float or callable, optional
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
    E: Datum,
    nu: float = 0.3,
    rho: Datum = 0.0,
    shear_factor: Datum = 5 / 6,
    *,
    G: Datum | None = None,
    retardation: Datum | tuple[Datum, ...] = 0.0,
) -> dict:
    """Data of a `Section` of an area and a second moment of area."""
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
    }


def _constructor(
    shape: Callable[..., tuple[float, float]] | None, shear_factor: float | None
) -> Callable[[Callable], Callable[..., Section]]:
    """A constructor from the sizes of a shape, documented by a function of them, and a material."""

    def made_of(documented: Callable) -> Callable[..., Section]:
        own = [*inspect.signature(documented).parameters.values()]
        material = dict(inspect.signature(_data_of_material).parameters)
        del material["A"], material["J"]
        material["shear_factor"] = material["shear_factor"].replace(default=shear_factor)
        signature = inspect.Signature([*own, *material.values()], return_annotation="Section")

        @functools.wraps(documented)
        def constructed(*values, **named) -> Section:
            try:
                bound = signature.bind(*values, **named)
            except TypeError as error:
                raise SceneError(
                    f"Section.{documented.__name__}: {error}. With named sizes write **material, "
                    "as in Section.rectangle(height=0.02, width=0.01, **fx_beam.materials.steel)"
                ) from None
            bound.apply_defaults()
            data = bound.arguments
            cls, *sizes = (data.pop(part.name) for part in own)
            if shape is not None:
                size = {part.name: value for part, value in zip(own[1:], sizes, strict=True)}
                sizes = [_combined(functools.partial(_entry, shape, i), **size) for i in (0, 1)]
                if data["shear_factor"] is None and shape is _box:
                    data["shear_factor"] = _combined(_share_of_webs, **size)
            return cls(**_data_of_material(*sizes, **data))

        constructed.__signature__ = signature  # type: ignore[attr-defined]
        text = inspect.cleandoc(documented.__doc__ or "")
        constructed.__doc__ = text.replace("{material}", _MATERIAL)
        return constructed

    return made_of


def _rectangle(height: float, width: float) -> tuple[float, float]:
    return height * width, width * height**3 / 12


def _circle(diameter: float) -> tuple[float, float]:
    return math.pi * diameter**2 / 4, math.pi * diameter**4 / 64


def _tube(diameter: float, thickness: float) -> tuple[float, float]:
    (A, J), (A_inner, J_inner) = _circle(diameter), _circle(_inner(diameter, thickness))
    return A - A_inner, J - J_inner


def _box(height: float, width: float, thickness: float) -> tuple[float, float]:
    inner = _inner(height, thickness), _inner(width, thickness)
    (A, J), (A_inner, J_inner) = _rectangle(height, width), _rectangle(*inner)
    return A - A_inner, J - J_inner


@dataclass(frozen=True)
class Section:
    r"""Stiffness and inertia of a cross-section, per reference length.

    The stored energy per length is quadratic in axial strain, shear strain and curvature,
    :math:`W = \frac{1}{2} (EA\,\varepsilon^2 + GA\,\gamma^2 + EI\,\kappa^2)` (eq. 11), unless
    `strain_energy` gives another one.

    Each stiffness and inertia may be a function of the fraction of the arc length, from 0 at the
    start of the beam to 1 at its end, for a tapered or stepped beam. The function takes and
    returns a number; it may use Python, NumPy or UFL. It is evaluated at the Gauss points: a jump
    between two elements is exact; of one inside an element `add_beam` warns.

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
        ``strain_energy(eps, gamma, kappa)``, the stored energy per length [J/m] as a UFL
        expression in axial strain, shear strain and curvature [1/m]. It replaces the quadratic
        energy; EA, GA and EI may then be omitted. With `internal` it has a fourth argument, the
        vector of internal variables.
    retardation : float, callable or a triple of them, optional
        Retardation times of a Kelvin-Voigt material [s], for axial, shear and bending strains, or
        one for all. The resultants get the addition C tau dE/dt, with the stiffness C of the
        undeformed section. A vibration of angular frequency w has the damping ratio tau w/2. No
        damping by default. With `strain_energy` it must be one time for all strains.
    internal : InternalVariables, optional
        Internal variables of a material whose state depends on the past, such as a plastic
        curvature. They need a `strain_energy`.

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
        check_energy(self.strain_energy, self.internal)

    def values(self, name: str, fractions: np.ndarray) -> np.ndarray:
        """Values of a stiffness, inertia or retardation time along a beam.

        Parameters
        ----------
        name : {"EA", "GA", "EI", "rhoA", "rhoI", "retardation"}
            Its name.
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
        places = real_array(fractions)
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
        """A stiffness or an inertia, or three retardation times."""
        return self._times if name == "retardation" else (getattr(self, name),)

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
    @_constructor(_rectangle, 5 / 6)
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
    @_constructor(_circle, 0.9)
    def circle(cls, diameter: Datum):
        """Solid circular section.

        Parameters
        ----------
        diameter : float or callable
            Diameter [m].
        {material}
        """

    @classmethod
    @_constructor(_tube, 0.5)
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
    @_constructor(_box, None)
    def box(cls, height: Datum, width: Datum, thickness: Datum):
        """Rectangular hollow section with sharp corners.

        By default the shear area is that of the two walls along the height.

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
    @_constructor(None, 5 / 6)
    def from_area(cls, area: Datum, second_moment: Datum):
        """Section of given area and second moment of area.

        Parameters
        ----------
        area : float or callable
            Area [m^2].
        second_moment : float or callable
            Second moment of area [m^4].
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


def _check_name(name, method: str) -> None:
    expected = f"one of {list(DATA)}"
    require(is_one_of(name, DATA), f"Section.{method}: name", name, expected)


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


def _entry(shape: Callable[..., tuple[float, float]], i: int, *size: float) -> float:
    return shape(*size)[i]


def _share_of_webs(height: float, width: float, thickness: float) -> float:
    return 2 * thickness * height / _box(height, width, thickness)[0]


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
    if not ((0 < number or (may_be_zero and number == 0)) and number <= LARGEST):
        expected = "zero or positive and finite" if may_be_zero else "positive and finite"
        expected += size_limit(datum, expected)
        raise SceneError(f"Section: {name} = {shown(datum)}{place} must be {expected}")
    return number


def _evaluated(datum: Callable, fraction: float, name: str) -> float:
    try:
        value = datum if isinstance(datum, ufl.core.expr.Expr) else datum(fraction)
        if isinstance(value, float) or (isinstance(value, Dual) and not value.ndim):
            return as_float(value)
        # UFL functions of numbers return numbers or expressions of numbers.
        if isinstance(value, ufl.core.expr.Expr):
            refuse_fields_in(value, name)
            value = value(())
    except SceneError:
        raise  # from a datum that this one is computed from
    except Exception as error:
        raise SceneError(f"{name}: calling it raised {error!r}") from error
    return as_float(shaped(value, 1, name)[0])
