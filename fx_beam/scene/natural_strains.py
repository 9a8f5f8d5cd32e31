"""Natural strains of beams: those that they have without stress, along them and over time."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import (
    CheckedFunction,
    Constant,
    TimeFunction,
    argument_names,
    checked_function,
    vector,
)

from .beam import Beam
from .inputs import Input, time_function
from .loads import PlaceTimeFunction

#: Names of the components in results.
NAMES = {
    "axial": "natural axial strain",
    "shear": "natural shear strain",
    "curvature": "natural curvature",
}


@dataclass(frozen=True, eq=False)
class StrainPart:
    """A component of a natural strain."""

    #: ``value(t)`` (1,), or a `PlaceTimeFunction` of fraction and time.
    value: TimeFunction
    #: ``along(f)`` (1,), by the fraction of the arc length; then ``value(t)`` is its factor.
    along: CheckedFunction | None = None


@dataclass(frozen=True, eq=False)
class NaturalStrain:
    """Natural strains of a beam by their names, of "axial", "shear" and "curvature"."""

    beam: Beam
    parts: Mapping[str, StrainPart]

    def __str__(self):
        return f"natural strain of beam {self.beam.name!r}"


def natural_strain(beam: Beam, given: Mapping[str, Any]) -> NaturalStrain:
    """Natural strains of a beam, from numbers and functions of f, of t, or of both."""
    parts = {name: _part(beam, name, value) for name, value in given.items() if value is not None}
    if not parts:
        raise SceneError(
            f"natural strain of beam {beam.name!r}: give axial, shear or curvature, not none of "
            "them"
        )
    return NaturalStrain(beam, parts)


def changed_strain(strain: NaturalStrain, given: Mapping[str, Any]) -> NaturalStrain:
    """The natural strain with other values of some components."""
    return replace(strain, parts={**strain.parts, **natural_strain(strain.beam, given).parts})


def _part(beam: Beam, name: str, value) -> StrainPart:
    what = f"{NAMES[name]} of beam {beam.name!r}"
    if isinstance(value, Input) or not callable(value):
        return StrainPart(time_function(value, 1, what))
    arguments = _arguments(value, what)
    if arguments == ["t"]:
        return StrainPart(time_function(value, 1, what))
    if arguments == ["f"]:
        along = checked_function(value, 1, what, 0.0)
        return StrainPart(Constant(np.ones(1)), along)
    return StrainPart(PlaceTimeFunction(value, 1, what, 1.0, "f"))


def _arguments(function: Callable, what: str) -> list[str]:
    """Names of the arguments of a function, which say what it is of."""
    names = argument_names(function)
    if names not in (["f"], ["t"], ["f", "t"]):
        raise SceneError(
            f"{what}: the arguments of the function are ({', '.join(names)}). Name them f for the "
            "fraction of the arc length, t for the time, or (f, t) for both: lambda f, t: ..."
        )
    return names


def thermal(alpha: float, temperature):
    """Strain of a change of temperature, alpha T, for `Scene.add_natural_strain`.

    Parameters
    ----------
    alpha : float
        Coefficient of thermal expansion [1/K].
    temperature : float, callable or Input
        Rise of the temperature T [K], for an axial strain: a number, or a function of f, of t, or
        of (f, t), as in `Scene.add_natural_strain`. For a curvature the fall of the temperature
        along the normal of the beam, -dT/dn [K/m], which points to the left of its direction.

    Returns
    -------
    float, callable or Input
        The strain, of the same kind.

    Raises
    ------
    SceneError
        For a coefficient or a temperature that is no finite number.

    Examples
    --------
    A bar of steel between two walls that becomes 50 K warmer: N = -EA alpha T.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=10.0), elements=2)
    >>> scene.clamp(bar.start)
    >>> scene.clamp(bar.end)
    >>> strain = scene.add_natural_strain(bar, axial=fb.thermal(12e-6, 50.0))
    >>> fb.static(scene, steps=1).resultants(bar).N[-1].round(6)
    array([-600., -600.])
    """
    (factor,) = vector(alpha, 1, "thermal: alpha")
    if isinstance(temperature, Input):
        old = 1.0 if temperature.factor is None else np.array(temperature.factor)
        return replace(temperature, factor=factor * old)
    if not callable(temperature):
        (rise,) = vector(temperature, 1, "thermal: temperature")
        return float(factor * rise)

    @functools.wraps(temperature)
    def strain(*arguments):
        return factor * np.asarray(temperature(*arguments))

    return strain
