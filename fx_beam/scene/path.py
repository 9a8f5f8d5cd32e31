"""The axis of a beam as a smooth path: weights of its nodes at an arc length."""

from __future__ import annotations

import numpy as np

from .beam import Beam, inner_positions

# Two straight pieces meet in a corner if their directions differ by more than this angle [rad].
_STRAIGHT = 1e-6
# Cubic functions on [0, 1] with slope 1 at one end, and zero value and slope otherwise.
_SLOPES = np.array([[0.0, 1.0, -2.0, 1.0], [0.0, 0.0, -1.0, 1.0]])


class Path:
    """The axis of a beam, phi(s) = sum N_a(s) phi_a over its nodes, with a continuous tangent.

    The position is that of the finite elements at all nodes, and between them if neighbours have
    the same tangent where they meet. Elsewhere cubics correct both, so that the tangent at the end
    of an element is the mean of the two, weighted so that it is exact for a parabola. Corners of a
    polyline stay corners.
    """

    #: Elements of a window: a step may begin and end in any two that are 2 apart, and each needs
    #: its neighbours.
    WINDOW = 5

    def __init__(self, beam: Beam):
        self.beam, self.s, p = beam, beam.s, beam.degree
        self.degree, self.h = p, np.diff(beam.s)
        elements = len(self.h)
        #: Reference positions (nodes, 2) of all nodes in order [m].
        self.X = np.empty((p * elements + 1, 2))
        self.X[::p] = [(node.x, node.y) for node in beam.nodes]
        inner = inner_positions(beam).reshape(elements, p - 1, 2)
        for k in range(1, p):
            self.X[k::p] = inner[:, k - 1]
        #: Elements and nodes of a window.
        self.window = min(elements, self.WINDOW)
        self.width = p * self.window + 1
        #: Number of borders between elements that a step may pass.
        self.most = 2 if elements > self.WINDOW else elements
        self._set_polynomials()

    def __len__(self):
        return len(self.X)

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.s[-1])

    def _set_polynomials(self) -> None:
        p, h, n = self.degree, self.h, len(self.h)
        shapes = np.zeros((p + 1, 4))  # coefficients of 1, x, x^2, x^3
        fractions = np.arange(p + 1) / p
        shapes[:, : p + 1] = np.linalg.inv(fractions[:, None] ** np.arange(p + 1)).T
        begin, end = shapes[:, 1], shapes @ np.arange(4)
        corner = self._corners()
        #: Coefficients (elements, 3 p + 1, 4) for the nodes of an element and of both neighbours.
        self.coefficients = np.zeros((n, 3 * p + 1, 4))
        own = slice(p, 2 * p + 1)
        self.coefficients[:, own] = shapes
        for i in range(n - 1):
            if corner[i]:
                continue
            # Tangents by the nodes of both elements: their jump, taken up by one or the other.
            jump = np.zeros(2 * p + 1)
            jump[p:] += begin / h[i + 1]
            jump[: p + 1] -= end / h[i]
            share = h[i] / (h[i] + h[i + 1])
            left, right = share * h[i] * jump, -(1 - share) * h[i + 1] * jump
            self.coefficients[i, p:] += np.outer(left, _SLOPES[1])
            self.coefficients[i + 1, : 2 * p + 1] += np.outer(right, _SLOPES[0])

    def _corners(self) -> np.ndarray:
        """Whether the elements i and i + 1 meet in a corner of a polyline, (elements - 1,)."""
        if self.beam.inner is not None:
            return np.zeros(len(self.h) - 1, dtype=bool)
        along = np.diff(self.X[:: self.degree], axis=0)
        return np.abs(np.angle(_complex(along[1:]) / _complex(along[:-1]))) > _STRAIGHT

    @property
    def has_corners(self) -> bool:
        """Whether the beam is a polyline with corners."""
        return bool(self._corners().any())

    def corner_near(self, s: float) -> np.ndarray | None:
        """Position (2,) of a corner within a hundredth of an element from an arc length [m]."""
        inner, h = self.s[1:-1], np.minimum(self.h[1:], self.h[:-1])
        near = np.flatnonzero(self._corners() & (abs(inner - s) <= 0.01 * h))
        return self.X[self.degree * (near[0] + 1)] if near.size else None

    def angles(self) -> np.ndarray:
        """Angles (nodes,) of the reference tangent at the nodes, without jumps [rad]."""
        p = self.degree
        at = np.arange(len(self))
        slopes = [self._derivative(min(i // p, len(self.h) - 1), i) for i in at]
        return np.unwrap(np.angle(_complex(np.array(slopes))))

    @property
    def numbers(self) -> np.ndarray:
        """All numbers on which it depends."""
        return np.concatenate([self.s, self.X.ravel(), self.coefficients.ravel(), self.angles()])

    def _derivative(self, element: int, node: int) -> np.ndarray:
        x = (node - self.degree * element) / self.degree
        return self._of_element(element, x, 1) @ self._nodes(element)

    def _nodes(self, element: int) -> np.ndarray:
        """Positions (3 p + 1, 2) of an element and its neighbours; zero where there is none."""
        p, first = self.degree, self.degree * (element - 1)
        index = np.arange(first, first + 3 * p + 1)
        known = (index >= 0) & (index < len(self))
        return np.where(known[:, None], self.X[np.clip(index, 0, len(self) - 1)], 0.0)

    def _of_element(self, element: int, x: float, order: int) -> np.ndarray:
        """Weights (3 p + 1,) or their derivatives by s, at the coordinate x in an element."""
        powers = {
            0: (1.0, x, x * x, x**3),
            1: (0.0, 1.0, 2 * x, 3 * x * x),
        }
        return self.coefficients[element] @ powers[order] / self.h[element] ** order

    def element(self, s: float) -> int:
        """Element at an arc length; the first or last one beyond the ends."""
        return int(np.clip(np.searchsorted(self.s, s, "right") - 1, 0, len(self.h) - 1))

    def at(self, s: float, order: int = 0) -> tuple[int, np.ndarray]:
        """First node, and weights (width,) of a window around s, or their derivatives by s."""
        e = self.element(s)
        w = self.first_of(e)
        return self.degree * w, self._in_window(e, w, (s - self.s[e]) / self.h[e], order)

    def position(self, s: float, order: int = 0) -> np.ndarray:
        """Reference position (2,) at an arc length [m], or its derivative."""
        first, weights = self.at(s, order)
        return weights @ self.X[first : first + self.width]

    def over(self, values: np.ndarray, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Values (n, ...) at places s (n,), or derivatives, of those (n, nodes, ...) at nodes."""
        last = len(self.h) - 1
        e = np.clip(np.searchsorted(self.s, s, "right") - 1, 0, last)
        x = (s - self.s[e]) / self.h[e]
        powers = np.polynomial.polynomial.polyvander(x, 3)
        if order:
            powers = np.column_stack([0 * x, 1 + 0 * x, 2 * x, 3 * x * x])
        weights = np.einsum("nak,nk->na", self.coefficients[e], powers)
        weights = weights / self.h[e][:, None] ** order
        nodes = self.degree * (e[:, None] - 1) + np.arange(weights.shape[1])
        nodes = np.clip(nodes, 0, len(self) - 1)  # others have the weight 0
        near = np.take_along_axis(values, nodes.reshape(*nodes.shape, *[1] * (values.ndim - 2)), 1)
        return np.einsum("na,na...->n...", weights, near)

    def weights_near(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes (near,) with weights at places s (n,), and these, N, N' and N'' (3, n, near)."""
        e = np.clip(np.searchsorted(self.s, s, "right") - 1, 0, len(self.h) - 1)
        x, h = (s - self.s[e]) / self.h[e], self.h[e][:, None]
        one, c = np.ones_like(x), self.coefficients[e]
        powers = (one, x, x**2, x**3), (0 * x, one, 2 * x, 3 * x**2), (0 * x, 0 * x, 2 * one, 6 * x)
        nodes = self.degree * (e[:, None] - 1) + np.arange(c.shape[1])
        known = (nodes >= 0) & (nodes < len(self))
        near, at = np.unique(nodes[known], return_inverse=True)
        rows, weights = np.nonzero(known)[0], np.zeros((3, len(s), len(near)))
        for order, own in enumerate(powers):
            of_nodes = np.einsum("nak,nk->na", c, np.column_stack(own)) / h**order
            weights[order, rows, at] = of_nodes[known]
        return near, weights

    def nearest_over(self, positions: np.ndarray, points: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Arc lengths (n,) nearest to points (n, 2), from ones near by, for nodes (n, nodes, 2)."""
        for _ in range(3):  # the method of Gauss and Newton
            apart, along = points - self.over(positions, s), self.over(positions, s, 1)
            s = s + np.sum(apart * along, axis=1) / np.sum(along**2, axis=1)
        return s

    def first_of(self, low: int) -> int:
        """First element of the window for a step whose first element along the beam is `low`."""
        return int(np.clip(low - 1, 0, len(self.h) - self.window))

    def _in_window(self, element: int, window: int, x: float, order: int) -> np.ndarray:
        """Weights (width,) in the window that begins with an element, at a coordinate."""
        weights, out = self._of_element(element, x, order), np.zeros(self.width)
        first = self.degree * (element - 1 - window)
        low, high = max(first, 0), min(first + len(weights), self.width)
        out[low:high] = weights[low - first : high - first]
        return out

    def nearest(self, point: np.ndarray) -> tuple[float, float]:
        """Arc length of the nearest point of the reference path, and the distance to it [m]."""
        best = (np.inf, 0.0)
        for e in self._near(point):
            h = self.h[e]
            c = self.coefficients[e].T @ self._nodes(e) - np.outer([1, 0, 0, 0], point)
            # The square of the distance, a polynomial of degree 6, is stationary.
            square = np.zeros(7)
            for i in range(4):
                square[i : i + 4] += c @ c[i]
            roots = np.polynomial.polynomial.polyroots(
                np.trim_zeros(np.arange(1, 7) * square[1:], "b")
            )
            inside = np.clip(roots.real[abs(roots.imag) < 1e-3], 0, 1)
            for x in (0.0, 1.0, *inside):
                x = self._polish(c, x)
                gap = float(np.hypot(*(c.T @ x ** np.arange(4))))
                if gap < best[0] * (1 - 1e-9) - 1e-15 * self.length:
                    best = gap, float(self.s[e] + h * x)
        return best[1], best[0]

    def _near(self, point: np.ndarray) -> np.ndarray:
        """Elements that may have the nearest point of the reference path."""
        p, e = self.degree, np.arange(len(self.h))[:, None]
        nodes = np.clip(p * (e - 1) + np.arange(3 * p + 1), 0, len(self) - 1)
        c = np.einsum("eak,eax->ekx", self.coefficients, self.X[nodes])  # others: weight 0
        powers = np.array([0.0, 0.5, 1.0])[:, None] ** np.arange(4)
        distances = np.linalg.norm(powers @ c - point, axis=2).min(axis=1)
        # No point is farther from one of these than a quarter of the largest slope.
        reach = np.linalg.norm(c[:, 1:], axis=2) @ [0.25, 0.5, 0.75]
        return np.flatnonzero(
            distances - reach <= distances.min() * (1 + 1e-6) + 1e-12 * self.length
        )

    @staticmethod
    def _polish(c: np.ndarray, x: float) -> float:
        """One step of Gauss and Newton towards the point of least distance, within [0, 1]."""
        for _ in range(2):
            position, along = (
                c.T @ x ** np.arange(4),
                c[1:].T @ (np.arange(1, 4) * x ** np.arange(3)),
            )
            x = float(np.clip(x - position @ along / (along @ along), 0, 1))
        return x


def _complex(vectors: np.ndarray) -> np.ndarray:
    return vectors[:, 0] + 1j * vectors[:, 1]
