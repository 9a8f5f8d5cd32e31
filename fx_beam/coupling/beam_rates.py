"""Equations of rates of nodes that slide on beams, and their changes.

At the arc length s the node is at sum N_a phi_a, its beam has the slope t = sum N_a' phi_a and the
bend k = sum N_a' Psi_a (rate_equations.py).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import scipy.sparse

from fx_beam.scene.path import Path

from .path_derivatives import weights_by_numbers
from .rate_equations import OnBeam


class PlaceOnBeam:
    """Places s (n,) on a beam with the degrees of freedom (nodes, 3), at configurations q.

    `weights` N, N' and N'' (3, n, near) are those of the nodes that have any, with the degrees of
    freedom `dofs` (near, 3); `slope` t (n, 2) and `bend` (n,).
    """

    def __init__(self, path: Path, dofs: np.ndarray, q: np.ndarray, s: np.ndarray):
        near, self.weights = path.weights_near(s)
        self.dofs, self._near, self._path, self._s = dofs[near], near, path, s
        _, first, second = self.weights
        self._at = at = path.X[near] + q[:, self.dofs[:, :2]]
        self._turned = turned = path.angles()[near] + q[:, self.dofs[:, 2]]
        self.slope, self._slope_by_s = (np.einsum("na,nai->ni", w, at) for w in (first, second))
        self.bend, self._bend_by_s = (np.einsum("na,na->n", w, turned) for w in (first, second))

    @functools.cached_property
    def _by_numbers(self) -> list[scipy.sparse.csr_matrix]:
        return weights_by_numbers(self._path, self._s)

    def _of_nodes(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Views of positions (..., nodes, 2) and angles (..., nodes) among numbers of the path."""
        path, shape = self._path, numbers.shape[:-1]
        positions = numbers[..., len(path.s) :][..., : path.X.size].reshape(*shape, -1, 2)
        return positions, numbers[..., -len(path) :]

    def changes(
        self, q: np.ndarray, s: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of slope (n, m, 2), bend (n, m) and N (n, m, near).

        For those of q (n, m, size), s (n, m), and of the numbers of the path (m, numbers).
        """
        values, first = np.zeros((2, len(s), len(numbers), len(self._near)))
        slope = np.einsum("na,nmai->nmi", self.weights[1], q[..., self.dofs[:, :2]])
        bend = np.einsum("na,nma->nm", self.weights[1], q[..., self.dofs[:, 2]])
        if numbers.any():
            values, first = (
                (by @ numbers.T).reshape(len(s), -1, len(numbers)).swapaxes(1, 2)
                for by in self._by_numbers
            )
            positions, angles = self._of_nodes(numbers)
            slope += np.einsum("nma,nai->nmi", first, self._at)
            slope += np.einsum("na,mai->nmi", self.weights[1], positions[:, self._near])
            bend += np.einsum("nma,na->nm", first, self._turned)
            bend += np.einsum("na,ma->nm", self.weights[1], angles[:, self._near])
        by_s = self._slope_by_s[:, None] * s[..., None], self._bend_by_s[:, None] * s
        return slope + by_s[0], bend + by_s[1], values + self.weights[1][:, None] * s[..., None]

    def pull(
        self, slope: np.ndarray, bend: np.ndarray, values: np.ndarray, by_q: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by s (n,) and by the numbers of the path at each place (n, numbers).

        From those by slope, bend and N (n, near); adds to those by q (n, size).
        """
        of_both = np.column_stack([slope, bend])
        by_q[:, self.dofs] += self.weights[1][:, :, None] * of_both[:, None]
        n, near = len(slope), len(self._near)
        of_first = np.einsum("ni,nai->na", slope, self._at) + bend[:, None] * self._turned
        by_numbers = np.zeros((n, self._path.numbers.size))
        for by, given in zip(self._by_numbers, (values, of_first), strict=True):
            rows = np.repeat(np.arange(n), near), np.arange(n * near)
            each = scipy.sparse.csr_matrix((given.ravel(), rows), (n, n * near))
            by_numbers += (each @ by).toarray()
        positions, angles = self._of_nodes(by_numbers)
        positions[:, self._near] += self.weights[1][:, :, None] * slope[:, None]
        angles[:, self._near] += self.weights[1] * bend[:, None]
        by_s = (slope * self._slope_by_s).sum(axis=1) + bend * self._bend_by_s
        return by_s + (values * self.weights[1]).sum(axis=1), by_numbers


class _Rows:
    """The equations of one node: entries (n, rows, 3, 1 + near) are `weight` times `at`."""

    def __init__(self, of: OnBeam, q: np.ndarray, s: np.ndarray):
        self.joint, self._free, self._sleeve = of.number, of.free, of.sleeve
        self.place = place = PlaceOnBeam(of.path, of.beam, q, s)
        self.rows = 2 - self._free + self._sleeve
        self.dof = np.vstack([of.node, place.dofs]).T
        one = np.ones((len(q), 1))
        #: Signs of the nodes in v_b - sum N_a v_a.
        self._at = np.hstack([one, -place.weights[0]])
        self.given, self.push = self._of(place.slope[:, None], place.bend[:, None], None, None)
        self.given, self.push = self.given[:, 0], self.push[:, 0]
        self._weight = self._weights(self.push, 1.0)

    def _weights(self, push: np.ndarray, turning: float) -> np.ndarray:
        weight = np.concatenate([push, np.zeros_like(push[..., :1])], axis=-1)
        weight[..., self.rows - self._sleeve :, 2] = turning
        return weight

    def _of(self, slope, bend, d_slope, d_bend) -> tuple[np.ndarray, np.ndarray]:
        """What is given (n, m, rows), and pushes (n, m, rows, 2), or with d their changes."""
        changes = d_slope is not None
        shape = (d_slope if changes else slope).shape[:2]
        given, push = np.zeros((*shape, self.rows)), np.zeros((*shape, self.rows, 2))
        t, dt, db = slope, d_slope, d_bend
        square = (t * t).sum(axis=-1, keepdims=True)
        along = (t * dt).sum(axis=-1, keepdims=True) / square if changes else 0.0
        if self._free:
            across = dt - along * t if changes else t
            push[:, :, 0] = np.stack([-across[..., 1], across[..., 0]], axis=-1) / np.sqrt(square)
        else:
            given[..., :2] = dt if changes else t
            push[:, :, 0, 0] = push[:, :, 1, 1] = float(not changes)
        if self._sleeve and self._free:
            k = bend[..., None]
            more = db[..., None] * t + k * dt - 2 * k * along * t if changes else k * t
            push[:, :, -1] = -more / square
        elif self._sleeve:
            given[..., -1] = db if changes else bend
        return given, push

    def entries(self) -> np.ndarray:
        """Entries (n, rows, 3, 1 + near)."""
        return self._weight[..., None] * self._at[:, None, None]

    def changes(
        self, q: np.ndarray, s: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of entries (n, m, rows, 3, 1 + near), of what is given, and of pushes."""
        place = self.place
        slope, bend, values = place.changes(q, s, numbers)
        given, push = self._of(place.slope[:, None], place.bend[:, None], slope, bend)
        entries = self._weights(push, 0.0)[..., None] * self._at[:, None, None, None]
        moved = np.concatenate([0 * values[..., :1], -values], axis=-1)
        entries += self._weight[:, None, ..., None] * moved[:, :, None, None]
        return entries, given, push

    def pull(self, entries, given, push, by_q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by s (n,) and by numbers of the path (n, numbers); adds those by q.

        From those by entries, what is given, and pushes.
        """
        place, t = self.place, self.place.slope
        values = -np.einsum("nria,nri->na", entries, self._weight)[:, 1:]
        push = push + np.einsum("nria,na->nri", entries, self._at)[..., :2]
        square = (t * t).sum(axis=1)
        slope, bend = np.zeros_like(t), np.zeros(len(t))
        if self._free:
            back = np.column_stack([push[:, 0, 1], -push[:, 0, 0]])
            along = (back * t).sum(axis=1) / square
            slope += (back - along[:, None] * t) / np.sqrt(square)[:, None]
        else:
            slope += given[:, :2]
        if self._sleeve and self._free:
            along, last = (push[:, -1] * t).sum(axis=1) / square, push[:, -1] / square[:, None]
            bend -= along
            slope += place.bend[:, None] * (2 * (along / square)[:, None] * t - last)
        elif self._sleeve:
            bend += given[:, -1]
        return place.pull(slope, bend, values, by_q)


class BeamRates:
    """The equations of all nodes on beams at n configurations, from a row on.

    `row` and `dof` (entries,) are those of their entries.
    """

    def __init__(self, on_beams: Sequence[OnBeam], first: int, q: np.ndarray, slides: np.ndarray):
        self._all = [_Rows(of, q, slides[:, of.number]) for of in on_beams]
        counts = [one.rows for one in self._all]
        starts = first + np.cumsum([0, *counts])
        self._rows = [slice(a, b) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        ends = np.cumsum([0, *(of.path.numbers.size for of in on_beams)])
        #: The numbers of each path among those of all.
        self._paths = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        rows, dofs = [np.empty(0, int)], [np.empty(0, int)]
        for one, own in zip(self._all, self._rows, strict=True):
            rows.append(np.repeat(np.arange(own.start, own.stop), one.dof.size))
            dofs.append(np.tile(one.dof.ravel(), one.rows))
        self.row, self.dof = np.concatenate(rows), np.concatenate(dofs)

    def set(self, given: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Entries (n, entries); sets what is given (n, count) and pushes (n, count, 2)."""
        found = [np.zeros((len(given), 0))]
        for one, own in zip(self._all, self._rows, strict=True):
            given[:, own], push[:, own] = one.given, one.push
            found.append(one.entries().reshape(len(given), -1))
        return np.concatenate(found, axis=-1)

    def set_changes(self, q, slides, paths, given: np.ndarray, push: np.ndarray) -> np.ndarray:
        """The same of changes (n, m, ...), for those of q, slides (n, m, joints) and paths (m,)."""
        found = [np.zeros((*given.shape[:2], 0))]
        for one, own, path in zip(self._all, self._rows, self._paths, strict=True):
            of_own = one.changes(q, slides[..., one.joint], paths[:, path])
            entries, given[..., own], push[..., own, :] = of_own
            found.append(entries.reshape(*given.shape[:2], -1))
        return np.concatenate(found, axis=-1)

    def pull(self, entries, given, push, by_q: np.ndarray, by_slides: np.ndarray) -> np.ndarray:
        """Derivatives by the numbers of all paths; adds those by q and slides (n, ...).

        From those by all of these.
        """
        first, by_paths = 0, [np.empty(0)]
        for one, own in zip(self._all, self._rows, strict=True):
            shape = len(entries), one.rows, *one.dof.shape
            of_own = entries[:, first : (first := first + one.rows * one.dof.size)].reshape(shape)
            by_s, by_path = one.pull(of_own, given[:, own], push[:, own], by_q)
            by_slides[:, one.joint] += by_s
            by_paths.append(by_path.sum(axis=0))
        return np.concatenate(by_paths)
