"""Derivatives of rates that fit the joints, and of the impulses that make them fit.

Corrections c and multipliers mu of `FittedRates` solve

    [ M  G^T ] [  c  ]   [    0    ]
    [ G   0  ] [ -mu ] = [ g - G v ]

so that changes of all that is given need further right sides only, and derivatives of a function of
c and mu one solution with these, since the matrix is symmetric.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from .beam_rates import BeamRates
from .rate_equations import RateEquations

# Added to the equations, relative to their diagonal, where joints are redundant. Repetitions that
# remove the effect of the small masses of what has none, until changes are below round-off.
_REGULAR, _REPETITIONS, _ROUND_OFF = 1e-14, 20, 1e-13
# Unknowns of the systems that are solved at once.
_BLOCK = 50_000


class _Entries(NamedTuple):
    """Entries (n, ..., entries) of G, what is given for each row, and forces on b for each."""

    g: np.ndarray
    given: np.ndarray
    push: np.ndarray


class RateDerivatives:
    """The linear system of a scene's rates at n configurations.

    `mass` (size, size) is that of the scene, `little` (size,) the small masses of what has none.
    """

    def __init__(
        self,
        equations: RateEquations,
        mass: scipy.sparse.csr_matrix,
        little: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        slides: np.ndarray,
        driven: np.ndarray,
    ):
        self._mass, self._little, self._tables = mass, little, equations.tables()
        tables, size = self._tables, len(little)
        self._pins, self._slots, self._turns = (tables[name] for name in ("pins", "slots", "turns"))
        self._count, self._driven = equations.count, driven.shape[1]
        first = 2 * self._pins + self._slots + self._turns
        self._beams = BeamRates(equations.on_beams, first, q, slides)
        self._set_entries(equations)
        entries, ones = np.arange(len(self._row)), np.ones(len(self._row))
        self._to_rows = scipy.sparse.csr_matrix((ones, (self._row, entries)))
        self._to_rows.resize(self._count, len(entries))
        self._to_dofs = scipy.sparse.csr_matrix((ones, (self._dof, entries)))
        self._to_dofs.resize(size, len(entries))
        #: Rotations (n, joints) of the nodes a, arms and directions of slides (n, joints, 2).
        self._psi = self._ends(q)[0][..., 2]
        self._arm = self._arms(q, tables["apart"])
        self._along = _turned(self._psi, np.broadcast_to(tables["slide_axis"], self._arm.shape))
        of_arms = self._of_arms(self._arm, self._along, constant=True)
        of_beams = self._beams.set(of_arms.given, of_arms.push)
        self._entries = of_arms._replace(g=np.concatenate([of_arms.g, of_beams], axis=-1))
        self._factorise()
        lacking = self._times_driven(self._entries.given, driven) - self._G(self._entries.g, v)
        x = self._solve(np.concatenate([np.zeros_like(v), lacking], axis=-1))
        #: Corrections (n, size), multipliers (n, count), rates that fit, and driven rates.
        self.c, self._mu = x[..., :size], -x[..., size:]
        self.rates, self._rates_of_driven = v + self.c, driven

    def _set_entries(self, equations: RateEquations) -> None:
        """Set rows and degrees of freedom of all entries; those of nodes on beams are the last."""
        on_beams = sum(3 * one.rows * (1 + len(one.beam)) for one in equations.on_beams)
        begin = 6 * self._pins + 5 * self._slots + 2 * self._turns
        others = (equations.moving < begin) | (equations.moving >= begin + on_beams)
        self._moving = equations.moving[others]
        self._moving[self._moving >= begin] -= on_beams
        self._others = self._tables["all_entries"] - on_beams
        self._supports = self._others - begin
        self._row = np.concatenate([equations.row[others], self._beams.row])
        self._dof = np.concatenate([equations.dof[others], self._beams.dof])

    # -- The equations, and their changes ---------------------------------------------------------

    def _ends(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Motions (..., joints, 3) of the nodes a and b of joints with arms; zero on the ground."""
        with_ground = np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1)
        return tuple(
            with_ground[..., self._tables[name].reshape(-1, 3)] for name in ("arm_a", "arm_b")
        )

    def _arms(self, q: np.ndarray, apart: np.ndarray) -> np.ndarray:
        """Arms (..., joints, 2), or their changes."""
        a, b = self._ends(q)
        return self._tables["has_arm"].reshape(-1, 1) * (apart + b[..., :2] - a[..., :2])

    def _change_of_directions(self, q: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Changes of the directions of slides (n, m, joints, 2)."""
        a, _ = self._ends(q)
        turned = _turned(self._psi[:, None], np.broadcast_to(axis, (*a.shape[:-1], 2)))
        return turned + a[..., 2:] * _across(self._along[:, None])

    def _of_arms(self, arm, along, constant: bool = False) -> _Entries:
        """Entries from arms and directions; with `constant` also those that do not change."""
        shape, k = arm.shape[:-2], self._pins
        one = np.full(shape, float(constant))
        g = np.zeros((*shape, self._others))
        given, push = np.zeros((*shape, self._count)), np.zeros((*shape, self._count, 2))
        pins, slots = g[..., : 6 * k], g[..., 6 * k : 6 * k + 5 * self._slots]
        parts = np.moveaxis(pins.reshape(*shape, 6, k), -2, 0)
        parts[0] = parts[3] = one[..., None]
        parts[1] = parts[4] = -one[..., None]
        parts[2], parts[5] = arm[..., :k, 1], -arm[..., :k, 0]
        given[..., : 2 * k] = along[..., :k, :].reshape(*shape, 2 * k)
        push[..., : 2 * k : 2, 0] = push[..., 1 : 2 * k : 2, 1] = one[..., None]
        t = along[..., k:, :]
        parts = np.moveaxis(slots.reshape(*shape, 5, self._slots), -2, 0)
        parts[0], parts[1], parts[2], parts[3] = -t[..., 1], t[..., 0], t[..., 1], -t[..., 0]
        base = arm[..., k:, :] if constant else self._arm[:, None, k:]
        parts[4] = -(t * base).sum(axis=-1)
        if not constant:
            parts[4] -= (self._along[:, None, k:] * arm[..., k:, :]).sum(axis=-1)
        push[..., 2 * k : 2 * k + self._slots, :] = _across(t)
        if constant:
            at, turns = 6 * k + 5 * self._slots, self._turns
            g[..., at : at + turns], g[..., at + turns : at + 2 * turns] = 1.0, -1.0
            g[..., at + 2 * turns :] = 1.0
            row = 2 * k + self._slots
            given[..., row : row + turns] = self._tables["turned"]
            given[..., self._count - self._supports :] = 1.0
        return _Entries(g[..., self._moving], given, push)

    def _pull_entries(self, by: _Entries) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (n, joints, 2) by arms and directions from those by entries."""
        k, n = self._pins, len(self._psi)
        g = np.zeros((n, self._others))
        g[:, self._moving] = by.g[:, : len(self._moving)]
        arm, along = np.zeros_like(self._arm), np.zeros_like(self._along)
        pins = g[:, : 6 * k].reshape(n, 6, k)
        arm[:, :k, 1], arm[:, :k, 0] = pins[:, 2], -pins[:, 5]
        along[:, :k] = by.given[:, : 2 * k].reshape(n, k, 2)
        slots = g[:, 6 * k : 6 * k + 5 * self._slots].reshape(n, 5, self._slots)
        push, t = by.push[:, 2 * k : 2 * k + self._slots], along[:, k:]
        t[..., 0] = slots[:, 1] - slots[:, 3] + push[..., 1]
        t[..., 1] = slots[:, 2] - slots[:, 0] - push[..., 0]
        t -= slots[:, 4, :, None] * self._arm[:, k:]
        arm[:, k:] = -slots[:, 4, :, None] * self._along[:, k:]
        return arm, along

    def _G(self, g: np.ndarray, x: np.ndarray) -> np.ndarray:
        """G x (..., count)."""
        return _sums(self._to_rows, g * x[..., self._dof])

    def _G_transposed(self, g: np.ndarray, y: np.ndarray) -> np.ndarray:
        """G^T y (..., size)."""
        return _sums(self._to_dofs, g * y[..., self._row])

    def _times_driven(self, given: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """What is given (..., count) of each equation, for driven rates (..., driven)."""
        column = self._tables["column"]
        own = (column >= 0) & (column < self._driven)
        found = np.zeros(np.broadcast_shapes(given.shape[:-1], driven.shape[:-1]) + (self._count,))
        found[..., own] = given[..., own] * driven[..., column[own]]
        return found

    # -- The system -------------------------------------------------------------------------------

    def _factorise(self) -> None:
        """Factors of some configurations at once, as one matrix of blocks."""
        g, size, count = self._entries.g, len(self._little), self._count
        mass = (self._mass + scipy.sparse.diags(self._little)).tocoo()
        inertia = self._mass.diagonal()
        loose = np.divide(1.0, inertia, where=inertia > 0, out=np.zeros(size))
        scales = _sums(self._to_rows, g**2 * loose[self._dof])
        scales[:] = scales.min(axis=1, keepdims=True, where=scales > 0, initial=np.inf)
        scales[np.isinf(scales)] = 0.0
        step = max(1, _BLOCK // (size + count))
        self._factors: list[tuple[slice, Any]] = []
        for first in range(0, len(g), step):
            own = slice(first, min(first + step, len(g)))
            n = own.stop - first
            at = (size + count) * np.arange(n)[:, None]
            rows = [mass.row + at, self._row + size + at, self._dof + at]
            columns = [mass.col + at, self._dof + at, self._row + size + at]
            values = [np.broadcast_to(mass.data, (n, mass.nnz)), g[own], g[own]]
            diagonal = size + np.arange(count) + at
            rows, columns = [*rows, diagonal], [*columns, diagonal]
            values = [*values, -_REGULAR * scales[own]]
            of_all = [
                np.concatenate([np.ravel(x) for x in part]) for part in (values, rows, columns)
            ]
            K = scipy.sparse.csc_matrix((of_all[0], (of_all[1], of_all[2])))
            self._factors.append((own, scipy.sparse.linalg.splu(K)))

    def _solve(self, right: np.ndarray) -> np.ndarray:
        """Solutions (n, ..., size + count) for right sides."""
        size, little, found = len(self._little), self._little, np.zeros_like(right)
        for own, factors in self._factors:
            x, b = found[own], right[own]
            for _ in range(_REPETITIONS):
                before = x.copy()
                more = b.copy()
                more[..., :size] += little * before[..., :size]
                by_direction = np.moveaxis(more.reshape(len(b), -1, b.shape[-1]), 1, 0)
                solved = factors.solve(by_direction.reshape(len(by_direction), -1).T).T
                x[...] = np.moveaxis(solved.reshape(by_direction.shape), 0, 1).reshape(b.shape)
                change = abs(x - before)[..., :size] * (little > 0)
                if not little.any() or change.max() <= _ROUND_OFF * abs(x[..., :size]).max():
                    break
        return found

    # -- Derivatives ------------------------------------------------------------------------------

    def _forces(
        self, push: np.ndarray, turning: np.ndarray, given: np.ndarray, mu: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Impulses (..., joints, 3) of joints and (..., columns) of columns by multipliers."""
        joint, column = self._tables["joint"], self._tables["column"]
        shape = np.broadcast_shapes(mu.shape[:-1], given.shape[:-1])
        on_b = np.concatenate([push, np.broadcast_to(turning[:, None], (*push.shape[:-1], 1))], -1)
        joints = np.zeros((*shape, self._tables["joints"], 3))
        columns = np.zeros((*shape, self._tables["columns"]))
        for r in range(self._count):
            if joint[r] >= 0:
                joints[..., joint[r], :] += on_b[..., r, :] * mu[..., r, None]
            if column[r] >= 0:
                columns[..., column[r]] += given[..., r] * mu[..., r]
        return joints, columns

    def pull(
        self, rates: np.ndarray, joints: np.ndarray, columns: np.ndarray
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Derivatives by "q", "v", "slides" and "driven rates" (n, ...), and by numbers.

        From those by rates that fit (n, size), and by impulses (n, joints, 3) and (n, columns).
        """
        (g, given, push), mu = self._entries, self._mu
        joint, column, turning = (self._tables[name] for name in ("joint", "column", "turning"))
        on_rows = np.zeros((len(rates), self._count, 3))
        on_rows[:, joint >= 0] = joints[:, joint[joint >= 0]]
        on_columns = np.where(column >= 0, columns[:, column] if columns.size else 0.0, 0.0)
        by_mu = (push * on_rows[..., :2]).sum(axis=-1) + turning * on_rows[..., 2]
        by_mu += given * on_columns
        # What has no mass, and no joint, keeps its rates.
        held = _sums(self._to_dofs, abs(g)) > 0
        by_c = np.where(held | (self._little == 0), rates, 0.0)
        x = self._solve(np.concatenate([by_c, -by_mu], axis=-1))
        of_c, of_rows = x[:, : rates.shape[1]], x[:, rates.shape[1] :]
        by_g = (
            mu[:, self._row] * of_c[:, self._dof] - of_rows[:, self._row] * self.rates[:, self._dof]
        )
        driven = self._times_driven(np.ones(self._count), self._rates_of_driven)
        by_push = mu[..., None] * on_rows[..., :2]
        by_given = of_rows * driven + mu * on_columns
        by_driven = np.zeros_like(self._rates_of_driven)
        for r in np.flatnonzero((column >= 0) & (column < self._driven)):
            by_driven[:, column[r]] += given[:, r] * of_rows[:, r]
        by_entries = _Entries(by_g, by_given, by_push)
        arm, along = self._pull_entries(by_entries)
        arm *= self._tables["has_arm"].reshape(-1, 1)
        turns = (along * _across(self._along)).sum(axis=-1)
        by_q = np.zeros((rates.shape[1] + 1, len(mu)))  # the ground is the last
        for name, sign in (("arm_a", -1.0), ("arm_b", 1.0)):
            dofs = self._tables[name].reshape(-1, 3)
            for i in range(2):
                np.add.at(by_q, dofs[:, i], sign * arm[..., i].T)
        np.add.at(by_q, self._tables["arm_a"].reshape(-1, 3)[:, 2], turns.T)
        entries = self._mass.tocoo()
        numbers = {
            "mass": -(of_c[:, entries.row] * self.c[:, entries.col]).sum(axis=0),
            "arms of joints": arm.sum(axis=0),
            "axes of joints": _turned(-self._psi, along).sum(axis=0),
        }
        by_v = rates - self._G_transposed(g, of_rows)
        of_state = {"q": by_q[:-1].T, "slides": np.zeros((len(mu), self._tables["joints"]))}
        of_beams = by_entries._replace(g=by_g[:, len(self._moving) :])
        by_paths = self._beams.pull(*of_beams, of_state["q"], of_state["slides"])
        if by_paths.size:
            numbers["paths"] = by_paths
        return of_state | {"v": by_v, "driven rates": by_driven}, numbers

    def push(
        self, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of rates (n, m, size), and of impulses (n, m, joints, 3) and (n, m, columns).

        From those of the state, "q", "v", "slides" and "driven rates" (n, m, ...), and of numbers
        (m, ...).
        """
        (g, given, push), mu = self._entries, self._mu
        q, v, driven = (of_state[name] for name in ("q", "v", "driven rates"))
        arms = self._arms(q, changes["arms of joints"])
        more = self._of_arms(arms, self._change_of_directions(q, changes["axes of joints"]))
        paths = changes.get("paths", np.empty((q.shape[1], 0)))
        of_beams = self._beams.set_changes(q, of_state["slides"], paths, more.given, more.push)
        more = more._replace(g=np.concatenate([more.g, of_beams], axis=-1))
        top = self._G_transposed(more.g, mu[:, None])
        for j, mass in enumerate(changes["mass"]):
            if mass.any():
                entries = self._mass.copy()
                entries.data = mass
                top[:, j] -= (entries @ self.c.T).T
        rows = self._times_driven(given[:, None], driven)
        rows += self._times_driven(more.given, self._rates_of_driven[:, None])
        rows -= self._G(more.g, self.rates[:, None]) + self._G(g[:, None], v)
        x = self._solve(np.concatenate([top, rows], axis=-1))
        c, of_mu = x[..., : v.shape[-1]], -x[..., v.shape[-1] :]
        turning = self._tables["turning"]
        joints, columns = self._forces(push[:, None], turning, given[:, None], of_mu)
        others = self._forces(more.push, 0 * turning, more.given, mu[:, None])
        return v + c, joints + others[0], columns + others[1]


def _turned(psi: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Vectors (..., 2), turned by psi (...)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1]], axis=-1)


def _across(x: np.ndarray) -> np.ndarray:
    """Vectors (..., 2), turned by a right angle."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _sums(to: scipy.sparse.csr_matrix, x: np.ndarray) -> np.ndarray:
    """Sums (..., n) of entries (..., entries)."""
    flat = x.reshape(-1, x.shape[-1])
    return (to @ flat.T).T.reshape(*x.shape[:-1], to.shape[0])
