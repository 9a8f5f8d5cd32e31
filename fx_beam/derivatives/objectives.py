"""Costs and misfits as functions of parameters, with derivatives, for optimisers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, array_of, check_takes, real_array, require, shown

#: ``function(t, y)`` gives a value, and its derivatives by outputs, by name.
Cost = Callable[[np.ndarray, dict[str, np.ndarray]], tuple[float, Mapping[str, np.ndarray]]]


class _Run(Protocol):
    def __call__(self, x: ArrayLike) -> tuple[np.ndarray, dict[str, np.ndarray]]: ...
    def vjp(self, weights: Mapping[str, np.ndarray]) -> np.ndarray: ...
    def jacobian(self, *names: str) -> dict[str, np.ndarray]: ...


class Objective:
    """A number of a whole motion, and its derivatives by x."""

    def __init__(self, run: _Run, function: Cost):
        check_takes(function, "t, y", "objective: function")
        self._run, self._function = run, function

    def __call__(self, x: ArrayLike) -> tuple[float, np.ndarray]:
        """The value, and its derivatives (m,) by x."""
        result = self._function(*self._run(x))
        ok = isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Mapping)
        if not ok or real_array(result[0]).shape:
            raise SceneError(
                "objective: function(t, y) must give a number and its derivatives by outputs, a "
                f"dict of arrays by names, not {shown(result)}"
            )
        return float(result[0]), self._run.vjp(result[1])


def _measured(rows: ArrayLike, name: str) -> np.ndarray:
    if isinstance(rows, np.ma.MaskedArray):
        rows = np.ma.filled(rows.astype(float), np.nan)
    values = array_of(rows, name)
    require(not np.isinf(values).any(), name, rows, "finite, or NaN where nothing was measured")
    return values


def _scatter(scatter: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    values = array_of(scatter, name)
    require(bool((np.isfinite(values) & (values > 0)).all()), name, scatter, "positive")
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        raise SceneError(
            f"{name} has the shape {values.shape}, which does not fit {shape}"
        ) from None


class Misfit:
    """Outputs less what was measured, over the scatter of this, as one vector."""

    def __init__(
        self,
        run: _Run,
        last_x: Callable[[], np.ndarray],
        measured: Mapping[str, ArrayLike],
        scatter: ArrayLike | Mapping[str, ArrayLike],
    ):
        subject = "misfit: measured"
        ok = isinstance(measured, Mapping) and len(measured) > 0
        require(ok, subject, measured, "a dict of arrays by names of outputs")
        self._run, self._last_x = run, last_x
        pairs = measured.items()
        self._measured = {name: _measured(rows, f"{subject}[{name!r}]") for name, rows in pairs}
        scatters = scatter if isinstance(scatter, Mapping) else dict.fromkeys(measured, scatter)
        same_names = scatters.keys() == measured.keys()
        require(same_names, "misfit: scatter", scatter, f"a number, or for each of {[*measured]}")
        self._scatter = {
            name: _scatter(scatters[name], rows.shape, f"misfit: scatter of {name!r}")
            for name, rows in self._measured.items()
        }

    def __call__(self, x: ArrayLike) -> np.ndarray:
        """Deviations (n,); zero where nothing was measured, which is NaN."""
        (_, y), parts = self._run(x), list[np.ndarray]()
        self._check_shapes(y)
        for name, rows in self._measured.items():
            deviations = (y[name] - rows) / self._scatter[name]
            parts.append(np.where(np.isnan(rows), 0.0, deviations).ravel())
        return np.concatenate(parts)

    def jacobian(self, x: ArrayLike) -> np.ndarray:
        """Derivatives (n, m) of deviations by x; without a motion if the last one was that of x."""
        if not np.array_equal(self._last_x(), x):
            self(x)
        J, parts = self._run.jacobian(*self._measured), []
        self._check_shapes({name: slopes[..., 0] for name, slopes in J.items()})
        for name, rows in self._measured.items():
            scaled = J[name] * np.where(np.isnan(rows), 0.0, 1 / self._scatter[name])[..., None]
            parts.append(scaled.reshape(-1, scaled.shape[-1]))
        return np.concatenate(parts)

    def _check_shapes(self, y: Mapping[str, np.ndarray]) -> None:
        """SceneError if outputs have other names or shapes than what was measured."""
        for name, rows in self._measured.items():
            require(name in y, "misfit: measured", [*self._measured], f"names of {[*y]}")
            ok = rows.shape == y[name].shape
            require(ok, f"misfit: measured[{name!r}]", rows.shape, f"of shape {y[name].shape}")
