"""Section forces N, Q and M at any place of a beam, from the balance of its elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import is_one_of, real_array, require
from fx_beam.scene.beam import gauss_rule, lagrange

# Distance of places from a node, relative to the length of a beam, at which they are at it.
AT_NODE = 1e-9


class SectionForces(NamedTuple):
    """Section forces (rows, places) of a beam at some places.

    Parameters
    ----------
    s : (places,) float
        Arc lengths from the start [m].
    N, Q, M : (rows, places) float
        Axial force [N], shear force [N], bending moment [N m].
    """

    s: np.ndarray
    N: np.ndarray
    Q: np.ndarray
    M: np.ndarray


@dataclass(frozen=True)
class BeamBalance:
    """Section forces that follow from the balance of the elements of a beam.

    M' = -Q joins them: where N and Q go straight, M is a parabola. Elements of degree 2 and 3
    without loads at places have polynomials that also go through the values at the Gauss points.
    """

    #: Arc lengths (elements + 1,) of the ends of elements [m].
    s: np.ndarray
    #: N, Q and M (rows, elements, 2, 3) at both ends of elements.
    ends: np.ndarray
    #: Arc lengths (m,) of forces and couples inside elements, and jumps (rows, m, 3) there.
    places: np.ndarray
    jumps: np.ndarray

    @cached_property
    def owners(self) -> np.ndarray:
        """Elements (m,) that these act on: at a node that behind it, as of `BeamPlace.element`."""
        places = self.places + AT_NODE * self.s[-1]
        return np.clip(np.searchsorted(self.s, places, "right") - 1, 0, len(self.s) - 2)

    @classmethod
    def of_all(cls, balances: Sequence[BeamBalance]) -> BeamBalance:
        """The balance of several beams, as of one behind the other."""
        s = np.cumsum(np.concatenate([[0.0], *(np.diff(balance.s) for balance in balances)]))
        parts = ([getattr(b, name) for b in balances] for name in ("ends", "jumps"))
        ends, jumps = (np.concatenate(part, axis=1) for part in parts)
        first = np.cumsum([0, *(len(balance.s) - 1 for balance in balances)])
        pairs = [*zip(balances, first, strict=False)]
        owners = np.concatenate([balance.owners + k for balance, k in pairs])
        inside = np.concatenate([b.places - b.s[b.owners] for b in balances])
        whole = cls(s, ends, s[owners] + inside, jumps)
        vars(whole)["owners"] = owners  # in many beams a tolerance would be too large
        return whole

    def in_rows(self, rows: list[int]) -> BeamBalance:
        """The balance in some rows."""
        return replace(self, ends=self.ends[rows], jumps=self.jumps[rows])

    def forces_at(self, gauss: np.ndarray, s, side: str) -> SectionForces:
        """Section forces at arc lengths s, by values (rows, points, 3) at the Gauss points."""
        places, length = np.atleast_1d(real_array(s)), self.s[-1]
        tolerance = AT_NODE * length
        is_on_beam = (places > -tolerance) & (places < length + tolerance)
        expected = f"arc lengths from 0 to the length of the beam, {length:g}"
        require(places.ndim == 1 and bool(is_on_beam.all()), "at: s", s, expected)
        require(is_one_of(side, ("before", "after")), "at: side", side, "'before' or 'after'")
        shift = tolerance if side == "after" else -tolerance
        element = np.clip(np.searchsorted(self.s, places + shift) - 1, 0, len(self.s) - 2)
        x = (places - self.s[element]) / np.diff(self.s)[element]
        return SectionForces(places, *self._values(gauss, element, x, shift))

    def in_elements(self, gauss: np.ndarray, x: np.ndarray, behind: float = 0.0) -> np.ndarray:
        """N, Q and M (3, rows, elements, points) at points x (points,) of each element.

        Points are `behind` [m] of these where loads act.
        """
        count = len(self.s) - 1
        elements, points = np.repeat(np.arange(count), len(x)), np.tile(x, count)
        values = self._values(gauss, elements, points, behind)
        return values.reshape(3, len(gauss), count, len(x))

    def _values(self, gauss, element: np.ndarray, x: np.ndarray, shift: float) -> np.ndarray:
        """N, Q and M (3, rows, n) in elements (n,) at x (n,) from 0 to 1."""
        h, count = np.diff(self.s), len(self.s) - 1
        degree = gauss.shape[1] // count
        gauss_values = gauss.reshape(len(gauss), count, degree, 3)
        change = self.ends[:, :, 1, 1] - self.ends[:, :, 0, 1]
        owners = self.owners
        for owner, jump in zip(owners, self.jumps[..., 1].T, strict=True):
            change[:, owner] -= jump
        start, end = self.ends[:, element].swapaxes(0, 2)  # (n, rows, 3) each
        values = np.moveaxis(start + (end - start) * x[:, None, None], -1, 0).swapaxes(1, 2)
        bend = change[:, element] * (h[element] * x * (1 - x) / 2)
        values[2] += bend
        smooth = np.isin(element, owners, invert=True)
        if degree > 1 and smooth.any():
            nodes = np.array([0.0, 1.0, *gauss_rule(degree)[0]])
            known_values = np.concatenate([self.ends, gauss_values], axis=2)[:, element[smooth]]
            weights = lagrange(nodes, x[smooth])
            # The same sums to the last digit in any number of rows.
            terms = (w[:, None] * known_values[:, :, p] for p, w in enumerate(weights.T))
            values[..., smooth] = np.moveaxis(sum(terms), -1, 0)
        for place, owner, jump in zip(self.places, owners, self.jumps.swapaxes(0, 1), strict=True):
            (places,) = np.nonzero(element == owner)
            load_place, part = (place - self.s[owner]) / h[owner], x[places]
            is_beyond = part > load_place - shift / h[owner]
            values[..., places] += jump.T[..., None] * (is_beyond - part)
            hat = np.where(part < load_place, part * (1 - load_place), load_place * (1 - part))
            values[2][:, places] += h[owner] * jump[:, 1, None] * hat
        return values
