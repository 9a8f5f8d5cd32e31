"""Pressure on beams: a load along the normal of the deformed axis, by its virtual work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fx_beam.errors import require
from fx_beam.symbolic import ufl

from .beam import Beam
from .functions import check_takes_time
from .inputs import Input
from .loads import VirtualWork, label, part_of
from .parameters import is_parameter

if TYPE_CHECKING:
    from .symbols import Parameter


@dataclass(frozen=True)
class PressureTerm:
    """The virtual work p (W phi').virtual u per reference length, at the level of a step."""

    pressure: Parameter

    def __call__(self, step):
        """The term in UFL."""
        x, y = step.t0 + step.prime(step.u)
        normal = ufl.as_vector((-y, x))
        return step.load_factor * self.pressure * ufl.dot(normal, step.virtual_u)


def pressure_on(
    beam: Beam, value, arguments: str, between: Sequence[float] | None, number: int
) -> tuple[VirtualWork, Parameter]:
    """A pressure on a beam or on some of its elements, and its parameter; SceneError otherwise."""
    from .symbols import Parameter

    name = f"pressure on {label(beam)}"
    require(arguments == "time", f"{name}: of", arguments, "'time': it is the same everywhere")
    elements: tuple[int, int | None] = (0, None)
    if between is not None:
        part = part_of(beam, between, arguments, name)
        first, last = (int(abs(beam.s - end).argmin()) for end in part)
        close = np.allclose(beam.s[[first, last]], part, rtol=0.0, atol=1e-9 * beam.length)
        expected = "arc lengths of ends of elements, as a normal is that of an element: "
        expected += f"{beam.s[first]:.6g} and {beam.s[last]:.6g} are the next ones"
        require(close and first < last, f"{name}: between", between, expected)
        elements = first, last
    own_names: tuple[str, ...] = ()
    if not is_parameter(value):
        if not isinstance(value, Input):
            check_takes_time(value, name)
        value = Parameter(f"pressure {number}", value)
        own_names = (value.name,)
    return VirtualWork(PressureTerm(value), beam, elements, own_names), value
