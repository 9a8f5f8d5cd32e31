"""The relation of a node that slides on a flexible beam, over one step.

Node c at the arc length s: phi_c = sum N_a phi_a. With bars for means of both ends of the step and
D for increments,

    virtual phi_c = sum Nbar_a virtual phi_a + z virtual alpha
                    + virtual s (sum (DN_a/Ds) phibar_a - z Dalpha/Ds)
    z = W/4 sum DN_a Dphi_a,    virtual alpha = W rbar . (virtual r) / |rbar|^2

where r is the chord of the element in which the step begins. It gives the step's own increment
Dphi_c, a translation for a translation, and a rotation for a rotation.
A sleeve also turns with the beam, psi_c = sum N_a Psi_a with Psi_a = psi_a + the reference angle.
With x_a = Dpsi_a/2, y = sum Nbar_a x_a, y_c = Dpsi_c/2 and k(x) = x / sin x,

    virtual psi_c = sum B_a virtual psi_a + virtual s q sin(y_c - y) / ((y_c - y) cos y_c cos y)
    B_a = Nbar_a k(x_a - y) cos x_a / sum of the same,    q = sum (DN_a/Ds) Psibar_a

which gives Dtheta_c = 2 tan(Dpsi_c/2) for the nodal Dtheta_a = 2 tan(Dpsi_a/2).
Schemes with another level have the derivatives at both ends, weighted as their forces are.
"""

from __future__ import annotations

import numpy as np

from fx_beam.scene.path import Path, Weights

_W = np.array([[0.0, -1.0], [1.0, 0.0]])


class Sliding:
    """Increment of a node on a path, its derivatives, and its virtual displacement.

    Local degrees of freedom: x and y of the nodes of a window, for a sleeve also their rotations,
    and the arc length; `components` is 2 or 3.
    """

    def __init__(self, path: Path, components: int, level: float, by_tangent: bool):
        self.path, self.components = path, components
        self.level, self._by_tangent = level, by_tangent
        self.angles = path.angles() if components == 3 else np.zeros(len(path))

    def begin(self, q: np.ndarray, s: float) -> None:
        """Set the start of a step: displacements and rotations (nodes, 3), and arc length [m]."""
        self.s0 = s
        self._phi0, self._psi0 = self.path.X + q[:, :2], self.angles + q[:, 2]

    def set(self, D: np.ndarray, Ds: float) -> None:
        """Set the increments (nodes, 3) of the beam's nodes, and that of the arc length."""
        path, n = self.path, self.path.width
        self.Ds, self.s1 = Ds, self.s0 + Ds
        self.weights = w = path.step(self.s0, self.s1)
        self.nodes = window = slice(w.first, w.first + n)
        self._p0 = self._phi0[window]
        self._Dp = D[window, :2]
        p1 = self._p0 + self._Dp
        #: Derivative of the position by s at the end.
        self.along = w.slope1 @ p1
        #: Increments (components,) of the node, their derivatives, and the virtual ones.
        self.increment = np.zeros(self.components)
        self.T, self.virtual_map = np.zeros((2, self.components, self.components * n + 1))
        self.increment[:2] = w.at1 @ p1 - w.at0 @ self._p0
        for i in (0, 1):
            self.T[i, i * n : (i + 1) * n] = w.at1
        self.T[:2, -1] = self.along
        self._set_virtual(w, p1)
        if self.components == 3:
            self._set_rotation(w, self._psi0[window], D[window, 2])

    def reaches(self) -> bool:
        """Whether the step ends in the element to which its weights belong, or beyond an end."""
        return self.path.reach(self.s0, self.s1)[1] == self.path.element(self.s1)

    def off_the_end(self) -> float:
        """Distance beyond an end of the beam at the end of the step [m]."""
        return max(-self.s1, self.s1 - self.path.length, 0.0)

    def _set_virtual(self, w: Weights, p1: np.ndarray) -> None:
        level, n, p0 = self.level, self.path.width, self._p0
        mean = (1 - level) * w.at0 + level * w.at1
        for i in (0, 1):
            self.virtual_map[i, i * n : (i + 1) * n] = mean
        if level != 0.5:
            self.virtual_map[:2, -1] = (1 - level) * (w.slope0 @ p0) + level * self.along
            return
        degree = self.path.degree
        first = degree * self.path.element(self.s0) - w.first
        self._ends = [first, first + degree]
        r0, r1 = (p[first + degree] - p[first] for p in (p0, p1))
        rbar, self._Dr = (r0 + r1) / 2, r1 - r0
        self._square = rbar @ rbar
        self._omega = omega = _W @ rbar / self._square
        self._turn = (_W / 2 - np.outer(omega, rbar)) / self._square
        self._Dalpha = omega @ self._Dr
        zeta = _W @ (w.quotient @ self._Dp) / 4
        self._pbar = (p0 + p1) / 2
        for i in (0, 1):
            row = self.virtual_map[i, : 2 * n].reshape(2, n)
            row[:, self._ends] += np.outer(self.Ds * zeta[i] * omega, (-1.0, 1.0))
        self.virtual_map[:2, -1] = w.quotient @ self._pbar - zeta * self._Dalpha

    def _set_rotation(self, w: Weights, psi0: np.ndarray, Dpsi: np.ndarray) -> None:
        level, n = self.level, self.path.width
        psi1 = psi0 + Dpsi
        self.increment[2] = w.at1 @ psi1 - w.at0 @ psi0
        self.T[2, 2 * n : 3 * n], self.T[2, -1] = w.at1, w.slope1 @ psi1
        mean = (1 - level) * w.at0 + level * w.at1
        self._psibar = (psi0 + psi1) / 2
        if level != 0.5:
            self.virtual_map[2, 2 * n : 3 * n] = mean
            self.virtual_map[2, -1] = (1 - level) * (w.slope0 @ psi0) + level * (w.slope1 @ psi1)
            return
        self._q = q = w.quotient @ self._psibar
        if not self._by_tangent:
            self.virtual_map[2, 2 * n : 3 * n], self.virtual_map[2, -1] = mean, q
            return
        x = Dpsi / 2
        y = mean @ x
        y_c = self.increment[2] / 2
        self._turns = x, y, y_c
        c = _over_sine(x - y) * np.cos(x)
        self._total = total = mean @ c
        self.virtual_map[2, 2 * n : 3 * n] = mean * c / total
        self.virtual_map[2, -1] = q / _over_sine(y_c - y) / (np.cos(y_c) * np.cos(y))

    # -- Derivatives of the virtual displacement --------------------------------------------------

    def second(self, F: np.ndarray) -> np.ndarray:
        """Derivatives of virtual_map^T F, for a force F (components,), by all local ones."""
        n, w, level = self.path.width, self.weights, self.level
        size = self.components * n + 1
        H = np.zeros((size, size))
        for i in (0, 1):
            own = slice(i * n, (i + 1) * n)
            H[own, -1] = level * F[i] * w.slope1
        if level != 0.5:
            p1 = self._p0 + self._Dp
            for i in range(2):
                H[-1, i * n : (i + 1) * n] = level * F[i] * w.slope1
            H[-1, -1] = level * (F[:2] @ (w.bend1 @ p1))
            if self.components == 3:
                own = slice(2 * n, 3 * n)
                H[own, -1] = H[-1, own] = level * F[2] * w.slope1
                psi1 = 2 * self._psibar - self._psi0[self.nodes]
                H[-1, -1] += level * F[2] * (w.bend1 @ psi1)
            return H
        omega, Ds, M, Mp = self._omega, self.Ds, w.quotient, w.quotient_slope
        G = -_W @ F[:2] / 4
        Z, Z_s = G @ (M @ self._Dp), G @ (Mp @ self._Dp)
        ends = np.zeros(n)
        ends[self._ends] = -1.0, 1.0
        by_r = omega + self._turn.T @ self._Dr
        for i in (0, 1):
            rows = slice(i * n, (i + 1) * n)
            H[rows, -1] += ends * omega[i] * (Z + Ds * Z_s)
            H[-1, rows] = F[i] * M / 2 - G[i] * M * self._Dalpha - Z * by_r[i] * ends
            for j in (0, 1):
                across = Ds * omega[i] * G[j] * np.outer(ends, M)
                across += Ds * Z * self._turn[i, j] * np.outer(ends, ends)
                H[rows, j * n : (j + 1) * n] = across
        H[-1, -1] = F[:2] @ (Mp @ self._pbar) - self._Dalpha * Z_s
        if self.components == 3:
            self._add_second_of_rotation(F[2], H)
        return H

    def _add_second_of_rotation(self, moment: float, H: np.ndarray) -> None:
        n, w, Ds = self.path.width, self.weights, self.Ds
        M, Mp = w.quotient, w.quotient_slope
        own = slice(2 * n, 3 * n)
        q_s = Mp @ self._psibar
        if not self._by_tangent:
            H[own, -1], H[-1, own] = moment * w.slope1 / 2, moment * M / 2
            H[-1, -1] += moment * q_s
            return
        x, y, y_c = self._turns
        mean = (w.at0 + w.at1) / 2
        k, k_slope = _over_sine(x - y), _over_sine_slope(x - y)
        # Derivatives (n, n + 1) by the rotations and by s.
        y_by = np.append(mean / 2, w.slope1 @ x / 2)
        x_by = np.hstack([np.eye(n) / 2, np.zeros((n, 1))])
        c = k * np.cos(x)
        c_by = (k_slope * np.cos(x))[:, None] * (x_by - y_by) - (k * np.sin(x))[:, None] * x_by
        mc_by = mean[:, None] * c_by
        mc_by[:, -1] += w.slope1 * c / 2
        B = self.virtual_map[2, own]
        B_by = (mc_by - np.outer(B, mc_by.sum(axis=0))) / self._total
        u, q = y_c - y, self._q
        q_by = np.append(M / 2, q_s)
        u_by = Ds / 2 * q_by
        u_by[-1] += q / 2
        cosines = np.cos(y_c) * np.cos(y)
        beta_by = q_by / (_over_sine(u) * cosines)
        beta_by -= q * _over_sine_slope(u) / _over_sine(u) ** 2 / cosines * u_by
        beta_by += self.virtual_map[2, -1] * (np.tan(y_c) * (y_by + u_by) + np.tan(y) * y_by)
        H[own, own] = moment * B_by[:, :-1]
        H[own, -1] = moment * B_by[:, -1]
        H[-1, own] = moment * beta_by[:-1]
        H[-1, -1] += moment * beta_by[-1]


def _over_sine(x):
    """x / sin(x), smooth at 0."""
    return 1 / np.sinc(np.asarray(x) / np.pi)


def _over_sine_slope(x):
    """Derivative of x / sin(x), smooth at 0."""
    x = np.asarray(x, dtype=float)
    small = abs(x) < 1e-2
    y = np.where(small, 1.0, x)
    return np.where(small, x / 3 + 7 * x**3 / 90, (1 - y / np.tan(y)) / np.sin(y))
