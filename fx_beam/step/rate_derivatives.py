"""Derivatives of rates that fit the joints, and of the impulses that make them fit.

Corrections c and multipliers mu of `FittedRates` solve

    [ M  G^T ] [  c  ]   [    0    ]
    [ G   0  ] [ -mu ] = [ g - G v ]

so that changes of all that is given need further right sides only, and derivatives of a function of
c and mu one solution with these, since the matrix is symmetric. A row of G is p . s + m d(omega)
with the velocity s of b relative to its place on a, the force p and the moment m. These and what is
given depend on the slope t, the bend k, arms and weights of the joint by a few local derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse

from fx_beam.coupling.place_on_beam import PlaceOnBeam

from .rate_solver import RateSolver

# Step in the imaginary direction.
_STEP = 1e-100


class RateDerivatives:
    """The linear system of a scene's rates at n configurations; `mass` is that of the scene."""

    def __init__(
        self,
        solver: RateSolver,
        mass: scipy.sparse.csr_matrix,
        q: np.ndarray,
        v: np.ndarray,
        slides: np.ndarray,
        driven: np.ndarray,
    ):
        self._solver, self._mass, self._equations = solver, mass, solver.equations
        self._driven, self._values = driven, solver.values(q, slides)
        equations, entries = self._equations, np.arange(len(self._equations.row))
        self._plain, self._joint = equations.plain, equations.joint[: equations.plain]
        shapes = (equations.row, equations.count), (equations.dof, equations.size)
        self._to_rows, self._to_dofs = (
            scipy.sparse.csr_matrix((np.ones(len(to)), (to, entries)), (n, len(to)))
            for to, n in shapes
        )
        turning = np.broadcast_to(equations.turning, self._values.given.shape)
        #: Forces and moments (n, count, 3) on b.
        self._weight = np.concatenate([self._values.push, turning[..., None]], axis=-1)
        self._psi = _with_ground(q)[:, equations.a[:, 2]]
        self._arm = self._arms(q, equations.apart[self._joint])
        self._places = [
            PlaceOnBeam(b.path, b.beam, q, slides[:, b.number]) for b in equations.on_beams
        ]
        self._set_local_derivatives(slides)
        lacking = self._times_driven(self._values.given, driven)
        lacking -= self._G(self._values.entries, v)
        x = solver.solve(self._values.entries, np.hstack([np.zeros_like(v), lacking]))
        #: Corrections (n, size), multipliers (n, count), and rates that fit.
        self.c, self._mu = x[:, : v.shape[1]], -x[:, v.shape[1] :]
        self.rates = v + self.c

    def _set_local_derivatives(self, slides: np.ndarray) -> None:
        """Set those (n, count, 3, 3) of p and of what is given by t and k, and t (n, count, 2)."""
        equations, n = self._equations, len(self._psi)
        t, k, sleeve = np.zeros((n, equations.count, 2)), np.zeros((n, equations.count)), []
        tangent, self._tangent_by = self._tangents(slides)
        t[:, : self._plain] = _turned(self._psi, tangent)
        local = np.zeros((*k.shape, 3, 3))
        local[:, : self._plain, 2, :2] = equations.direction
        self._beam_rows, row = [], self._plain
        for one, place in zip(equations.on_beams, self._places, strict=True):
            rows = np.arange(row, row := row + one.rows)
            t[:, rows], k[:, rows] = place.slope[:, None], place.bend[:, None]
            self._beam_rows.append(rows)
            if one.sleeve:
                sleeve.append(rows[-1])
            if not one.free[0]:
                local[:, rows[:2], 2, :2] = np.eye(2)
        self._along, free = t, equations.free.copy()
        bent, driven = (np.array([r for r in sleeve if free[r] == f], int) for f in (True, False))
        local[..., 2, 2][:, driven] = 1.0
        free[bent] = False
        unit, square = np.eye(2), (t * t).sum(axis=-1)[..., None, None]
        outer = t[..., :, None] * t[..., None, :] / np.where(square, square, 1.0)
        across = (unit - outer)[:, free] / np.sqrt(square[:, free])
        local[:, free, :2, :2] = np.array([[0.0, -1.0], [1.0, 0.0]]) @ across
        by_t = -k[:, bent, None, None] * (unit - 2 * outer[:, bent])
        local[:, bent, :2, :2] = by_t / square[:, bent]
        local[..., :2, 2][:, bent] = -t[:, bent] / square[:, bent, 0]
        self._local = local

    def _tangents(self, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tangents (n, plain, 2) of tracks, and their derivatives (n, plain, 2, 3).

        These by axes and slides, exact to round-off by steps in the imaginary direction.
        """
        equations, slide = self._equations, _with_ground(slides)[:, self._joint, None]
        axis = np.broadcast_to(equations.axis[self._joint], (*slide.shape[:2], 2))
        given = np.concatenate([axis, slide], axis=-1).astype(complex)
        tangent, by = np.zeros(axis.shape), np.zeros((*axis.shape, 3))
        for track in equations.tracks:
            rows = equations.track[self._joint] == track.number
            for k, step in enumerate(_STEP * 1j * np.eye(3)):
                *moved, at = np.moveaxis(given[:, rows] + step, -1, 0)
                value = np.stack(track.tangent(moved, at), axis=-1)
                tangent[:, rows], by[..., k][:, rows] = value.real, value.imag / _STEP
        return tangent, by

    # -- Products with the equations --------------------------------------------------------------

    def _arms(self, q: np.ndarray, apart: np.ndarray) -> np.ndarray:
        """Arms (..., plain, 2) from a to b, or their changes."""
        with_ground, equations = _with_ground(q), self._equations
        return apart + with_ground[..., equations.b[:, :2]] - with_ground[..., equations.a[:, :2]]

    def _G(self, g: np.ndarray, x: np.ndarray) -> np.ndarray:
        """G x (..., count)."""
        return _sums(self._to_rows, g * x[..., self._equations.dof])

    def _times_driven(self, given: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """What is given (..., count) of each equation, for driven rates (..., driven)."""
        own = self._is_driven
        product = np.zeros(
            np.broadcast_shapes(given.shape[:-1], driven.shape[:-1]) + given.shape[-1:]
        )
        product[..., own] = given[..., own] * driven[..., self._equations.column[own]]
        return product

    @property
    def _is_driven(self) -> np.ndarray:
        column = self._equations.column
        return (column >= 0) & (column < self._driven.shape[1])

    def _relative(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities s (n, count, 2) of b relative to its place on a, and those of a (n, plain)."""
        equations, with_ground = self._equations, _with_ground(x)
        spin = with_ground[:, equations.a[:, 2]]
        s = with_ground[:, equations.b[:, :2]] - with_ground[:, equations.a[:, :2]]
        relative = np.empty((len(x), equations.count, 2))
        relative[:, : self._plain] = s - spin[..., None] * _across(self._arm)
        for one, place, rows in self._of_beams():
            beneath = np.einsum("na,nai->ni", place.weights[0], x[:, place.dofs[:, :2]])
            relative[:, rows] = (x[:, one.node[:2]] - beneath)[:, None]
        return relative, spin

    def _of_beams(self):
        return zip(self._equations.on_beams, self._places, self._beam_rows, strict=True)

    # -- Derivatives ------------------------------------------------------------------------------

    def vjp(
        self, rates: np.ndarray, joints: np.ndarray, columns: np.ndarray
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Derivatives by "q", "v", "slides" and "driven rates" (n, ...), and by numbers.

        From those by rates that fit (n, size), and by impulses (n, joints, 3) and (n, columns).
        """
        (entries, given, push), mu, equations = self._values, self._mu, self._equations
        joint, column = equations.joint, equations.column
        n, size, plain = len(mu), rates.shape[1], self._plain
        on_rows = np.pad(joints, ((0, 0), (0, 1), (0, 0)))[:, joint]
        on_columns = np.pad(columns, ((0, 0), (0, 1)))[:, column]
        by_mu = (self._weight * on_rows).sum(axis=-1) + given * on_columns
        # What has no mass, and no joint, keeps its rates.
        held = _sums(self._to_dofs, abs(entries)) > 0
        by_c = np.where(held | (self._solver.little == 0), rates, 0.0)
        x = self._solver.solve(entries, np.hstack([by_c, -by_mu]))
        of_c, of_rows = x[:, :size], x[:, size:]
        (s, spin), (moved, turned) = self._relative(of_c), self._relative(self.rates)
        by_push = mu[..., None] * (s + on_rows[..., :2]) - of_rows[..., None] * moved
        driven = self._times_driven(np.ones(len(column)), self._driven)
        by_given = of_rows * driven + mu * on_columns
        by_local = np.concatenate([by_push, by_given[..., None]], axis=-1)
        by_along = np.einsum("nri,nrij->nrj", by_local, self._local)
        by_q, by_slides = np.zeros((size + 1, n)), np.zeros((n, equations.joints + 1))
        turn = mu[:, :plain] * spin - of_rows[:, :plain] * turned
        by_arm = turn[..., None] * _across(push[:, :plain])
        by_t = by_along[:, :plain, :2]
        for i in range(2):
            np.add.at(by_q, equations.b[:, i], by_arm[..., i].T)
            np.add.at(by_q, equations.a[:, i], -by_arm[..., i].T)
        turns = (by_t * _across(self._along[:, :plain])).sum(axis=-1)
        np.add.at(by_q, equations.a[:, 2], turns.T)
        by_track = np.einsum("nri,nrik->nrk", _turned(-self._psi, by_t), self._tangent_by)
        np.add.at(by_slides.T, self._joint, by_track[..., 2].T)
        by_q, by_paths, by_slides = by_q[:-1].T.copy(), [np.empty(0)], by_slides[:, :-1]
        for one, place, rows in self._of_beams():
            weight = self._weight[:, rows]
            of = _times(of_rows[:, rows], weight) * self.rates[:, place.dofs]
            of -= _times(mu[:, rows], weight) * of_c[:, place.dofs]
            by = np.hstack([by_along[:, rows].sum(axis=1), of.sum(axis=-1)])
            by_slides[:, one.number], by_path = place.vjp(by, by_q)
            by_paths.append(by_path.sum(axis=0))
        masses, of_joints = self._mass.tocoo(), np.zeros((2, equations.joints + 1, 2))
        np.add.at(of_joints[0], self._joint, by_arm.sum(axis=0))
        np.add.at(of_joints[1], self._joint, by_track[..., :2].sum(axis=0))
        numbers = {
            "mass": -(of_c[:, masses.row] * self.c[:, masses.col]).sum(axis=0),
            "arms of joints": of_joints[0],
            "axes of joints": of_joints[1],
        }
        if equations.on_beams:
            numbers["paths"] = np.concatenate(by_paths)
        by_driven = np.zeros_like(self._driven)
        own = self._is_driven
        np.add.at(by_driven.T, column[own], (given * of_rows)[:, own].T)
        by_v = rates - _sums(self._to_dofs, entries * of_rows[:, equations.row])
        return {"q": by_q, "slides": by_slides, "v": by_v, "driven rates": by_driven}, numbers

    def jvp(
        self, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of rates (n, m, size), and of impulses (n, m, joints, 3) and (n, m, columns).

        From those of the state, "q", "v", "slides" and "driven rates" (n, m, ...), and of numbers
        (m, ...).
        """
        (entries, given, push), mu, equations = self._values, self._mu, self._equations
        q, v, driven = (of_state[name] for name in ("q", "v", "driven rates"))
        size, plain, (n, m, _) = v.shape[-1], self._plain, v.shape
        arm = self._arms(q, changes["arms of joints"][:, self._joint])
        along = np.zeros((n, m, equations.count, 3))
        turn = _with_ground(q)[..., equations.a[:, 2], None]
        axis = np.broadcast_to(changes["axes of joints"][:, self._joint], (n, m, plain, 2))
        along[..., :plain, :2] = turn * _across(self._along[:, None, :plain])
        slide = _with_ground(of_state["slides"])[..., self._joint, None]
        of_track = np.concatenate([axis, slide], axis=-1)
        of_track = np.einsum("nrik,nmrk->nmri", self._tangent_by, of_track)
        along[..., :plain, :2] += _turned(self._psi[:, None], of_track)
        firsts, weights = 0, []
        for one, place, rows in self._of_beams():
            numbers = changes["paths"][:, firsts : (firsts := firsts + one.path.numbers.size)]
            of_place = place.changes(q, of_state["slides"][..., one.number], numbers)
            along[..., rows, :] = of_place[..., None, :3]
            weights.append(of_place[..., 3:])
        more = np.einsum("nrij,nmrj->nmri", self._local, along)
        of_push, of_given = more[..., :2], more[..., 2]
        p = push[:, None, :plain]
        lever = _cross(arm, p) + _cross(self._arm[:, None], of_push[..., :plain, :])
        none = np.zeros((n, m, plain, 1))
        ends = np.concatenate(
            [of_push[..., :plain, :], none, -of_push[..., :plain, :], -lever[..., None]], -1
        )
        parts = [ends.reshape(n, m, -1)]
        for (one, place, rows), of_weights in zip(self._of_beams(), weights, strict=True):
            of_rows = np.zeros((n, m, len(rows), 3, one.dof.shape[1]))
            at = 1 + place.near
            of_rows[..., :2, 0] = of_push[..., rows, :]
            N = place.weights[0][:, None, None, None]
            of_rows[..., :2, at] = -of_push[..., rows, :, None] * N
            weight = self._weight[:, None, rows, :, None]
            of_rows[..., at] -= weight * of_weights[:, :, None, None]
            parts.append(of_rows.reshape(n, m, -1))
        of_entries = np.concatenate(parts, axis=-1)[..., equations.entry]
        top = _sums(self._to_dofs, of_entries * mu[:, None, equations.row])
        for j, mass in enumerate(changes["mass"]):
            if mass.any():
                of_mass = self._mass.copy()
                of_mass.data = mass
                top[:, j] -= (of_mass @ self.c.T).T
        bottom = self._times_driven(given[:, None], driven)
        bottom += self._times_driven(of_given, self._driven[:, None])
        bottom -= self._G(of_entries, self.rates[:, None]) + self._G(entries[:, None], v)
        x = self._solver.solve(entries, np.concatenate([top, bottom], axis=-1))
        forces, turning = self._solver.forces, equations.turning
        joints, columns = forces(push[:, None], turning, given[:, None], -x[..., size:])
        others = forces(of_push, 0 * turning, of_given, mu[:, None])
        return v + x[..., :size], joints + others[0], columns + others[1]


def _with_ground(x: np.ndarray) -> np.ndarray:
    """Values (..., size + 1), zero at the number -1."""
    return np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1)


def _turned(psi: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Vectors (..., 2), turned by psi (...)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1]], axis=-1)


def _across(x: np.ndarray) -> np.ndarray:
    """Vectors (..., 2), turned by a right angle."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)


def _times(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Sums (n, 1, 3) over rows of x (n, rows) times weights (n, rows, 3)."""
    return np.einsum("nr,nri->ni", x, weight)[:, None]


def _cross(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]


def _sums(to: scipy.sparse.csr_matrix, x: np.ndarray) -> np.ndarray:
    """Sums (..., n) of entries (..., entries)."""
    flat = x.reshape(-1, x.shape[-1])
    return (to @ flat.T).T.reshape(*x.shape[:-1], to.shape[0])
