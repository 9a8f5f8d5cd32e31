"""Functions of a script as bytes: the other processes have not run it."""

from __future__ import annotations

import io
from typing import Any

import cloudpickle

from fx_beam.scene.parameters import Parameter


class _Pickler(cloudpickle.Pickler):
    """Takes functions that cannot be imported as their code, with the names that this uses."""

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, Parameter):  # its values come with each step
            return Parameter, (thing.name, 0.0)
        return super().reducer_override(thing)


def packed(thing: Any) -> bytes:
    """Any object as bytes, functions included; PicklingError or TypeError if it cannot be."""
    out = io.BytesIO()
    _Pickler(out).dump(thing)
    return out.getvalue()
