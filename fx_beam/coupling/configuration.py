"""Joints at one configuration, evaluated in C."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam import c_library
from fx_beam.c_library import Structs, array_at
from fx_beam.results.state import MACROS

if TYPE_CHECKING:
    from .sliders import Slide

# What evaluates joints, and the flags of its compiler.
_LIBRARY = "joints", "joints.c"
_FLAGS = "-O1", c_library.WHOLE_PROGRAM


def begin_to_build_joints() -> None:
    """Compile what evaluates joints beside all else, if the cache lacks it."""
    c_library.begin_to_build(*_LIBRARY, MACROS, _FLAGS)


class Configuration:
    """Joints at one configuration, in C: increments in a step, and the values of T and Tv.

    `members` are named as in ``Problem`` of c/problem.h.
    """

    def __init__(self, members: dict[str, Any], joints: int, slides: Sequence[Slide]):
        ffi, self._library = c_library.open_library(*_LIBRARY, "problem.h", MACROS, (), _FLAGS)
        self._structs, self._slides = Structs(ffi), slides
        self._c, self._ffi = ffi.new("Problem *"), ffi
        size, columns = members["dofs"], members["columns"] + members["auxiliary"]["count"]
        self._state = np.zeros(size), np.zeros(joints)
        state = dict(zip(("q", "slides"), self._state, strict=True))
        self._structs.set(self._c, **members, points=[{}], state=state)
        scratch = np.zeros(self._library.fx_scratch(self._c))
        self._structs.set(self._c, run={"scratch": scratch})
        results, array = self._library.fx_results(self._c), functools.partial(array_at, ffi)
        values = 1 + 4 * members["joints"]["count"] + members["gears"].get("count", 0)
        closures = members["loops"].get("closures", 0)
        #: Increments of nodes and columns; the values of T and Tv; closures.
        self.D, self.z = array(results.D, size), array(results.z, columns)
        self.values = array(results.values, values), array(results.virtual_map, values)
        self.closure = array(results.closure, closures)
        self.following = array(self._c.loops.following, closures)

    def begin(self, q: np.ndarray, slides: np.ndarray) -> bool:
        """Set the start: displacements and rotations, and slides; False in a singular position."""
        self._state[0][:], self._state[1][:] = q, slides
        return bool(self._library.fx_begin_joints(self._c))

    def expand(self, y: np.ndarray, driven: np.ndarray, close: bool) -> bool:
        """Find D for increments of unknowns and driven columns; False if loops do not close.

        With `close` the unknowns that close loops are corrected in y.
        """
        free = len(y)
        self.z[:free], self.z[free : free + len(driven)] = y, driven
        closed = bool(self._library.fx_expand(self._c, close))
        y[:] = self.z[:free]
        return closed

    def relations(self, virtual: bool) -> Iterator[tuple[np.ndarray, int]]:
        """For each node on a beam the columns of T, or Tv, and where its window begins."""
        for i, slide in enumerate(self._slides):
            c = self._c.sliders.slider[i]
            rows = np.frombuffer(self._ffi.buffer(c.virtual_map if virtual else c.T)).reshape(3, -1)
            width, components = slide.path.width, len(slide.columns)
            yield rows[:components, [*range(components * width), -1]], c.first

    @property
    def arcs(self) -> list[tuple[float, float]]:
        """Arc lengths of nodes on beams at both ends of the step [m]."""
        return [(c.s0, c.s1) for c in (self._c.sliders.slider[i] for i in range(len(self._slides)))]
