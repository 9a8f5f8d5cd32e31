"""Functions of the place along a beam and of time, evaluated at once for all places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import LARGEST, TimeFunction, shaped, shown, vector

# Places at which a function is called to learn whether it takes arrays, in parts of the length.
_SAMPLES = np.linspace(0.0, 1.0, 7)


class PlaceTimeFunction:
    """A function of the user, ``function(place, t)``, with values (size,).

    It is called once for all places if it takes an array of them and gives numbers or arrays; one
    by one otherwise. It is tried at time 0, so that errors show before the run.
    """

    def __init__(self, function: Callable, size: int, what: str, length: float, name: str):
        if not callable(function):
            raise SceneError(f"{what}: {shown(function)} must be a function of ({name}, t)")
        self._function, self._size, self._what, self._name = function, size, what, name
        self._samples = length * _SAMPLES
        one_by_one = self._one_by_one(self._samples, 0.0)
        at_once = self._at_once(self._samples, 0.0)
        self._takes_arrays = at_once is not None and np.array_equal(at_once, one_by_one)

    def __call__(self, t: float) -> np.ndarray:
        """The largest value (size,) at some places, as pictures show it."""
        values = self.at(self._samples, t)
        return values[np.argmax(np.linalg.norm(values, axis=1))]

    def over(self, places: np.ndarray) -> TimeFunction:
        """The function of time that gives the values (n size,) at n places."""
        return lambda t: self.at(places, t).ravel()

    def at(self, places: np.ndarray, t: float) -> np.ndarray:
        """Finite values (n, size) at n places; SceneError otherwise."""
        values = self._at_once(places, t) if self._takes_arrays else None
        if values is None or not (abs(values) <= LARGEST).all():
            values = self._one_by_one(places, t)  # which names the place
        return values

    def _at_once(self, places: np.ndarray, t: float) -> np.ndarray | None:
        """Values (n, size) of one call; None if they do not fit."""
        try:
            result: Any = self._function(places.copy(), t)
            parts: Sequence = (result,) if self._size == 1 else tuple(result)
            columns = [np.broadcast_to(np.asarray(part, float), len(places)) for part in parts]
            return np.column_stack(columns) if len(columns) == self._size else None
        except Exception:  # noqa: BLE001  # whatever a function does that takes single places
            return None

    def _one_by_one(self, places: np.ndarray, t: float) -> np.ndarray:
        values = np.empty((len(places), self._size))
        for i, place in enumerate(places.tolist()):
            what = f"{self._what} at {self._name} = {place:g}, t = {t:g}"
            try:
                value = self._function(place, t)
            except Exception as error:
                raise SceneError(f"{what}: calling it raised {error!r}") from error
            values[i] = shaped(value, self._size, what)
            if not (abs(values[i]) <= LARGEST).all():
                raise SceneError(f"{what}: {shown(value)} is not finite, or too large")
        return values


def values_along(
    function: Callable[[float], np.ndarray], size: int, what: str, name: str, places: np.ndarray
) -> np.ndarray:
    """Values (n * size,) of a function of place at n places."""
    checked = [vector(function(x), size, f"{what} at {name} = {x:g}") for x in places.tolist()]
    return np.concatenate(checked)
