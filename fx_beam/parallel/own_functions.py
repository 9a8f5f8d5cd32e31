"""Functions of a script as bytes: the other processes have not run it."""

from __future__ import annotations

import importlib
import io
import marshal
import pickle
import sys
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

from fx_beam.scene.parameters import Parameter


class _Pickler(pickle.Pickler):
    """Takes functions that cannot be imported as their code, with the names that this uses."""

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, ModuleType):
            return importlib.import_module, (thing.__name__,)
        if isinstance(thing, Parameter):  # its values come with each step
            return Parameter, (thing.name, 0.0)
        if not isinstance(thing, FunctionType) or _can_be_imported(thing):
            return NotImplemented
        code = thing.__code__
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        used = {n: thing.__globals__[n] for n in _names(code) if n in thing.__globals__}
        state = used, cells, thing.__defaults__, thing.__kwdefaults__
        made = marshal.dumps(code), thing.__name__, len(cells)
        return _function, made, state, None, None, _fill


def packed(thing: Any) -> bytes:
    """Any object as bytes, functions included; PicklingError or TypeError if it cannot be."""
    out = io.BytesIO()
    _Pickler(out, protocol=pickle.HIGHEST_PROTOCOL).dump(thing)
    return out.getvalue()


def _can_be_imported(function: FunctionType) -> bool:
    """Whether another process finds the same function by its name."""
    named: Any = sys.modules.get(function.__module__)
    if function.__module__ == "__main__":
        return False
    for name in function.__qualname__.split("."):
        named = getattr(named, name, None)
    return named is function


def _names(code: CodeType) -> set[str]:
    """Names that the code uses, also in functions inside."""
    inside = [_names(part) for part in code.co_consts if isinstance(part, CodeType)]
    return set(code.co_names).union(*inside)


def _function(code: bytes, name: str, cells: int) -> FunctionType:
    """Make a function; `_fill` gives it what it refers to, which may be itself."""
    empty = tuple(CellType() for _ in range(cells))
    return FunctionType(marshal.loads(code), {"__builtins__": __builtins__}, name, None, empty)


def _fill(function: FunctionType, state: tuple) -> None:
    used, cells, function.__defaults__, function.__kwdefaults__ = state
    function.__globals__.update(used)
    for cell, value in zip(function.__closure__ or (), cells, strict=True):
        cell.cell_contents = value
