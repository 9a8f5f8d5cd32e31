"""The joints of a scene at one configuration, in C: increments, and the values of T and Tv."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.results.state import MACROS

if TYPE_CHECKING:
    from .sliders import Slide

_LIBRARY = "joints", "joints.c"
_FLAGS = "-O1", "-fwhole-program"


def begin_to_build() -> None:
    """Compile what evaluates joints beside all else, if the cache lacks it."""
    c_library.begin_to_build(*_LIBRARY, MACROS, _FLAGS)


class Configuration:
    """A step of joints from a start; `members` are those of ``Problem`` in c/problem.h."""

    def __init__(self, members: dict[str, Any], joints: int, slides: Sequence[Slide]):
        ffi, self._library = c_library.kept_library(*_LIBRARY, "problem.h", MACROS, (), _FLAGS)
        self._structs, self._slides = Structs(ffi, c_library.declarations("problem.h")), slides
        self._c, self._ffi, self._double = ffi.new("Problem *"), ffi, ffi.typeof("double[]")
        size, columns = members["dofs"], members["columns"] + members.get("auxiliaries", 0)
        self._state = np.zeros(size), np.zeros(joints)
        self._structs.set(self._c, **members, points=[{}])
        self._structs.set(self._c, q=self._state[0], slides=self._state[1])
        self._structs.set(self._c, scratch=np.zeros(self._library.fx_scratch(self._c)))
        counts = size, columns, *[1 + 4 * members["joints"]] * 2, members.get("closures", 0)
        to = ffi.new("double *[]", len(counts))
        self._results, self._columns = to, np.zeros(members["columns"])
        self._library.fx_expand(self._c, self._of(self._columns), 0, to)
        #: Increments of nodes and columns; the values of T and Tv; closures.
        self.D, self.z, *values, self.closure = (
            np.frombuffer(ffi.buffer(at, 8 * n)) if n else np.empty(0)
            for at, n in zip(to, counts, strict=True)
        )
        self.values = tuple(values)
        loops = self._c.following, 4 * self.closure.size
        self.following = np.frombuffer(ffi.buffer(*loops), np.int32) if loops[1] else np.empty(0)

    def _of(self, values: np.ndarray) -> Any:
        return self._ffi.from_buffer(self._double, values)

    def begin(self, q: np.ndarray, slides: np.ndarray) -> bool:
        """Set the start: displacements and rotations, and slides; False in a singular position."""
        self._state[0][:], self._state[1][:] = q, slides
        return bool(self._library.fx_begin_joints(self._c))

    def expand(self, y: np.ndarray, driven: np.ndarray, close: bool) -> bool:
        """Find D for increments of unknowns and driven columns; False if loops do not close.

        Those that close loops are corrected in y if they shall `close`.
        """
        free = len(y)
        self._columns[:free], self._columns[free : free + len(driven)] = y, driven
        given = self._of(self._columns), close, self._results
        closed = bool(self._library.fx_expand(self._c, *given))
        y[:] = self.z[:free]
        return closed

    def relations(self, virtual: bool) -> Iterator[tuple[np.ndarray, int]]:
        """Of the nodes on beams the columns of T, or Tv, and where their windows begin."""
        for i, slide in enumerate(self._slides):
            c = self._c.slider[i]
            rows = np.frombuffer(self._ffi.buffer(c.virtual_map if virtual else c.T)).reshape(3, -1)
            width, components = slide.path.width, len(slide.columns)
            yield rows[:components, : components * width + 1].copy(), c.first

    @property
    def arcs(self) -> list[tuple[float, float]]:
        """Arc lengths of nodes on beams at both ends of the step [m]."""
        return [(c.s0, c.s1) for c in (self._c.slider[i] for i in range(len(self._slides)))]
