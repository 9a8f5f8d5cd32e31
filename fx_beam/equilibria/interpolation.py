"""States of a path between others, by polynomials in the distance along it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fx_beam.results.state import ARRAYS, NUMBERS, State


@np.errstate(divide="ignore", invalid="ignore")
def root_near(places: np.ndarray, values: np.ndarray) -> float:
    """Root near zero of the polynomial through values at places; not finite if it has none."""
    polynomial = np.polynomial.Polynomial(
        np.linalg.solve(np.vander(places, increasing=True), values)
    )
    slope, root = polynomial.deriv(), 0.0
    for _ in range(20):
        root -= float(polynomial(root) / slope(root))
    return root


def weights(places: np.ndarray, place: float) -> np.ndarray:
    """Weights of values at places in that of their polynomial at another place."""
    powers = place ** np.arange(len(places), dtype=float)
    return np.linalg.solve(np.vander(places, increasing=True).T, powers)


def combined(states: list[State], weights: np.ndarray) -> State:
    """The state whose arrays are sums of those of others."""
    values: dict[str, object] = {}
    for name in (*ARRAYS, *NUMBERS, "motors"):
        parts = [getattr(state, name) for state in states]
        if parts[0] is not None:
            values[name] = sum(w * part for w, part in zip(weights, parts, strict=True))
    values["t"] = float(values["t"])  # type: ignore[arg-type]
    return replace(states[0], **values, negative_eigenvalues=None)  # type: ignore[arg-type]
