"""Stability of the equilibria of a path, which is found when it is first read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .audit import read_only


class Stability:
    """What a path knows of its stability: functions, and what they have found.

    Copies and files keep what has been found; numbers of unstable modes are found for them.
    """

    def __init__(
        self,
        count: Callable[[], np.ndarray] | None = None,
        locate: Callable[[], list[Any]] | None = None,
        counted: np.ndarray | None = None,
    ):
        self._count, self._locate = count, locate
        self._counted = counted
        self._points: list[Any] | None = None

    def __getstate__(self):
        try:
            counted: np.ndarray | None = self.unstable_modes()
        except ValueError:
            counted = None
        return {"_count": None, "_locate": None, "_counted": counted, "_points": self._points}

    def unstable_modes(self) -> np.ndarray:
        """Numbers of modes (n,) that grow."""
        if self._counted is None:
            if self._count is None:
                raise _unknown("unstable_modes")
            self._counted = self._count()
        return read_only(self._counted)

    def critical_points(self) -> list[Any]:
        """The critical points of the path."""
        if self._points is None:
            if self._locate is None:
                raise _unknown("critical_points")
            self._points = self._locate()
        return list(self._points)


def _unknown(name: str) -> ValueError:
    return ValueError(
        f"{name}: a solution from a file has none, nor has a copy of one in which they were not "
        "read before. Compute the path again by static"
    )
