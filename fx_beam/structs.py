"""C structs: their members are set as they are declared, and none is forgotten."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

# What C takes arrays of numbers as.
_NUMBERS = {"int": np.int32, "double": np.float64}


class Structs:
    """Sets members of C structs, and keeps the data to which they point.

    A member takes, by its declaration, a number, an array, the address of a function or of data, a
    dict for a struct, or a list of dicts for a pointer to structs.
    """

    def __init__(self, ffi: Any, declarations: str):
        self._ffi = ffi
        self._groups = _groups(declarations)
        self._referenced: list[Any] = []

    def set(self, struct: Any, **values: Any) -> None:
        """Set members of a struct, or of the one to which a pointer points."""
        members = self._members(struct)
        for name, value in values.items():
            kind = members[name]
            if kind.kind == "primitive":
                setattr(struct, name, value)
            elif kind.kind == "array":
                getattr(struct, name)[0 : len(value)] = list(value)
            elif kind.kind == "struct":
                self.set(getattr(struct, name), **value)
            else:
                setattr(struct, name, self._pointer(kind, value))

    def _members(self, struct: Any) -> dict[str, Any]:
        return _types(self._type(struct))

    def _type(self, struct: Any) -> Any:
        kind = self._ffi.typeof(struct)
        return kind.item if kind.kind == "pointer" else kind

    def _pointer(self, kind: Any, value: Any) -> Any:
        if kind.kind == "function":
            return self._ffi.cast(kind, value)
        if isinstance(value, int):
            return self._ffi.cast(kind, value)
        if kind.item.kind == "struct":
            return self._array(kind.item, value)
        wanted = _NUMBERS.get(kind.item.cname, np.uintp)  # else addresses of functions
        value = np.asarray(value)
        if value.size and not np.can_cast(value.dtype, wanted, "same_kind"):
            raise TypeError(f"an array of {value.dtype} for C's {kind.cname}")
        value = np.asarray(value, wanted, "C")
        self._referenced.append(value)
        return self._ffi.cast(kind, value.ctypes.data)

    def _array(self, kind: Any, rows: list[dict[str, Any]]) -> Any:
        array = self._ffi.new(self._ffi.getctype(kind, "[]"), len(rows))
        self._referenced.append(array)
        for number, row in enumerate(rows):
            self.set(array[number], **row)
            self.check(array[number])
        return array

    def check(self, struct: Any) -> None:
        """ValueError if a pointer of a struct is not set.

        Those in a ``struct { }`` inside, with a name or without, are set all or none; without them
        its numbers are zero.
        """
        missing = list(self._missing(struct, optional=False))
        if missing:
            what = self._type(struct).cname
            raise ValueError(f"C struct {what}: not set: {', '.join(missing)}")

    def _missing(self, struct: Any, optional: bool) -> Iterator[str]:
        members, groups = self._members(struct), self._groups[self._type(struct).cname]
        inner = [name for name, kind in members.items() if kind.kind == "struct"]
        apart = set(inner).union(*groups)
        own = [name for name in members if name not in apart]
        for names, free in ((own, optional), *((group, True) for group in groups)):
            values = {n: getattr(struct, n) for n in names if members[n].kind != "array"}
            if not free or any(values.values()):
                pointers = (n for n in values if members[n].kind in ("pointer", "function"))
                yield from (name for name in pointers if not values[name])
        for name in inner:
            yield from (f"{name}.{n}" for n in self._missing(getattr(struct, name), optional=True))


@functools.cache
def _types(kind: Any) -> dict[str, Any]:
    """Types of the members of a struct."""
    return {name: field.type for name, field in kind.fields}


@functools.cache
def _groups(declarations: str) -> dict[str, list[list[str]]]:
    """Names of the members in each ``struct { };`` inside a struct, by the name of the latter."""
    text = re.sub(r"/\*.*?\*/", "", declarations, flags=re.DOTALL)
    structs = re.findall(r"^typedef struct \{(.*?)^\} (\w+);", text, re.DOTALL | re.MULTILINE)
    inside = re.compile(r"^  struct \{(.*?)\};", re.DOTALL | re.MULTILINE)
    names = re.compile(r"(\w+)(?:\[\w+\])?[,;]")
    return {name: [names.findall(part) for part in inside.findall(body)] for body, name in structs}
