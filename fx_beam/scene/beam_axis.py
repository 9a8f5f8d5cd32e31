"""The axis of a beam as a smooth path: weights of its nodes at an arc length."""

from __future__ import annotations

import weakref

import numpy as np

from .beam import Beam, reference_positions

# Two straight pieces meet in a corner if their directions differ by more than this angle [rad].
_STRAIGHT = 1e-6
# Cubic functions on [0, 1] with slope 1 at one end, and zero value and slope otherwise.
_SLOPES = np.array([[0.0, 1.0, -2.0, 1.0], [0.0, 0.0, -1.0, 1.0]])


# Axes of the beams that live, by ids of these.
_axes: dict[int, BeamAxis] = {}


def axis_of(beam: Beam) -> BeamAxis:
    """The axis of a beam, made once for all that slides on it."""
    if (axis := _axes.get(id(beam))) is None:
        axis = _axes[id(beam)] = BeamAxis(beam)
        weakref.finalize(beam, _axes.pop, id(beam), None)
    return axis


class BeamAxis:
    """The axis of a beam, phi(s) = sum N_a(s) phi_a over its nodes, with a continuous tangent.

    The position is that of the finite elements where these meet, and between if neighbours have
    the same tangent there. Elsewhere cubics correct both, so that the tangent at the end
    of an element is the mean of the two, weighted so that it is exact for a parabola. Corners of a
    polyline stay corners.
    """

    #: Elements of a window: a step may go from an element to the second next one, and each of them
    #: needs its neighbours.
    WINDOW = 5

    def __init__(self, beam: Beam):
        self.s, p = beam.s, beam.degree
        self.degree, self.h = p, np.diff(beam.s)
        #: Arc length [m].
        self.length = beam.length
        elements = len(self.h)
        #: Reference positions (nodes, 2) of all nodes in order [m].
        self.X = reference_positions(beam)
        #: Elements and nodes of a window.
        self.window = min(elements, self.WINDOW)
        self.width = p * self.window + 1
        #: Number of borders between elements that a step may pass.
        self.most = 2 if elements > self.WINDOW else elements
        #: Whether the elements i and i + 1 meet in a corner of a polyline, (elements - 1,).
        self.corners = np.zeros(elements - 1, dtype=bool)
        if beam.inner is None:
            chords = np.diff(self.X[::p], axis=0)
            turns = np.angle(_complex(chords[1:]) / _complex(chords[:-1]))
            self.corners = np.abs(turns) > _STRAIGHT
        #: Coefficients (elements, 3 p + 1, 4) for the nodes of an element and of both neighbours.
        self.coefficients = _polynomials(p, self.h, self.corners)
        nodes = np.clip(self._nodes(np.arange(elements)), 0, len(self) - 1)
        cubics = np.einsum("eak,eax->ekx", self.coefficients, self.X[nodes])
        #: The reference path by its elements.
        self.cubics = CubicPath(self.s, cubics)
        nodes = np.arange(len(self))
        e = np.minimum(nodes // p, elements - 1)
        tangents = self._over(self.X[None], e, (nodes - p * e) / p, 1)
        #: Angles (nodes,) of the reference tangent at the nodes, without jumps [rad].
        self.angles = np.unwrap(np.angle(_complex(tangents)))

    def __len__(self):
        return len(self.X)

    def corner_near(self, s: float) -> np.ndarray | None:
        """Position (2,) of a corner within a hundredth of an element from an arc length [m]."""
        inner, h = self.s[1:-1], np.minimum(self.h[1:], self.h[:-1])
        corners = np.flatnonzero(self.corners & (abs(inner - s) <= 0.01 * h))
        return self.X[self.degree * (corners[0] + 1)] if corners.size else None

    @property
    def numbers(self) -> np.ndarray:
        """All numbers on which it depends."""
        return np.concatenate([self.s, self.X.ravel(), self.coefficients.ravel(), self.angles])

    def element(self, s):
        """Element at an arc length, or several; the first or last one beyond the ends."""
        return np.clip(np.searchsorted(self.s, s, "right") - 1, 0, len(self.h) - 1)

    def position(self, s: float, order: int = 0) -> np.ndarray:
        """Reference position (2,) at an arc length [m], or its derivative."""
        return self.over(self.X[None], np.array([s]), order)[0]

    def over(self, values: np.ndarray, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Values (n, ...), or derivatives, at arc lengths s (n,), from `values` (n, nodes, ...)."""
        e = self.element(s)
        return self._over(values, e, (s - self.s[e]) / self.h[e], order)

    def _over(self, values: np.ndarray, e: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
        """Values, or derivatives by s, at coordinates x (n,) in elements e (n,)."""
        nodes = np.clip(self._nodes(e), 0, len(self) - 1)  # others have the weight 0
        index = nodes.reshape(*nodes.shape, *[1] * (values.ndim - 2))
        local = np.take_along_axis(values, index, 1)
        return np.einsum("na,na...->n...", self._weights(e, x, order), local)

    def _nodes(self, e: np.ndarray) -> np.ndarray:
        """Nodes (n, 3 p + 1) of elements and their neighbours, also where there is none."""
        return self.degree * (e[:, None] - 1) + np.arange(3 * self.degree + 1)

    def _weights(self, e: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
        """Weights (n, 3 p + 1) of nodes at coordinates x (n,) in elements, or derivatives by s."""
        ones = np.ones_like(x)
        powers = (ones, x, x * x, x * x * x), (0 * x, ones, 2 * x, 3 * x * x)
        weights = np.einsum("nak,nk->na", self.coefficients[e], np.column_stack(powers[order]))
        return weights / self.h[e][:, None] ** order

    def nearest_over(self, positions: np.ndarray, points: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Arc lengths (n,) nearest to points (n, 2), from ones near by, for nodes (n, nodes, 2)."""
        for _ in range(3):  # the method of Gauss and Newton
            arm, tangent = points - self.over(positions, s), self.over(positions, s, 1)
            s = s + np.sum(arm * tangent, axis=1) / np.sum(tangent**2, axis=1)
        return s


class CubicPath:
    """A path whose pieces are cubics (n, 4, 2), from arc lengths s[i] to s[i + 1]."""

    def __init__(self, s: np.ndarray, cubics: np.ndarray):
        self._s, self._cubics = s, cubics
        # Three places (n, 3, 2) of each piece, and the distance from these within which it is: the
        # next place is at most a quarter of the largest slope away.
        self._places = np.array([0.0, 0.5, 1.0])[:, None] ** np.arange(4) @ cubics
        self._reach = np.linalg.norm(cubics[:, 1:], axis=2) @ [0.25, 0.5, 0.75]

    def nearest(self, point: np.ndarray) -> tuple[float, float]:
        """Arc length of the nearest point of the path, and the distance to it [m]."""
        distances = np.linalg.norm(self._places - point, axis=2).min(axis=1)
        most = distances.min() * (1 + 1e-6) + 1e-12 * self._s[-1]
        arcs, gaps, within = [], [], []
        for piece in np.flatnonzero(distances - self._reach <= most):
            x, gap = _nearest_on_cubic(self._cubics[piece] - [point, *np.zeros((3, 2))])
            start, end = self._s[piece : piece + 2]
            arcs.append(np.where(x < 1, start + (end - start) * x, end))
            gaps.append(gap)
            within.append((x > 0) & (x < 1))
        s, gap = np.concatenate(arcs), np.concatenate(gaps)
        is_farther = gap > gap.min() + 1e-15 * self._s[-1]
        best = np.lexsort((s, np.concatenate(within), is_farther))[0]  # ends of pieces come first
        return float(s[best]), float(gap[best])


def _nearest_on_cubic(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places x in [0, 1] where the length of a cubic (4, 2) may be least, ends first; lengths."""
    slopes = np.arange(1, 4)[:, None] * coefficients[1:]
    # The square of the distance is a polynomial of degree 6.
    square = np.sum([np.convolve(part, part) for part in coefficients.T], axis=0)
    x = np.roots(np.arange(6, 0, -1) * square[:0:-1])
    powers = np.clip(x.real[abs(x.imag) < 1e-3], 0, 1)[:, None] ** np.arange(4)
    # A step of Gauss and Newton takes away what round-off has left.
    arm, tangent = powers @ coefficients, powers[:, :3] @ slopes
    x = powers[:, 1] - np.sum(arm * tangent, axis=1) / np.sum(tangent**2, axis=1)
    x = np.concatenate([[0.0, 1.0], np.clip(x, 0, 1)])
    return x, np.hypot(*(x[:, None] ** np.arange(4) @ coefficients).T)


def _polynomials(p: int, h: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Coefficients of cubics over elements of the lengths h (n,) and the degree p."""
    n = len(h)
    shapes = np.zeros((p + 1, 4))  # coefficients of 1, x, x^2, x^3
    fractions = np.arange(p + 1) / p
    shapes[:, : p + 1] = np.linalg.inv(fractions[:, None] ** np.arange(p + 1)).T
    begin, end = shapes[:, 1], shapes @ np.arange(4)
    coefficients = np.zeros((n, 3 * p + 1, 4))
    coefficients[:, p : 2 * p + 1] = shapes
    for i in np.flatnonzero(~corner):
        # Tangents by the nodes of both elements: their jump, taken up by one or the other.
        jump = np.zeros(2 * p + 1)
        jump[p:] += begin / h[i + 1]
        jump[: p + 1] -= end / h[i]
        share = h[i] / (h[i] + h[i + 1])
        left, right = share * h[i] * jump, -(1 - share) * h[i + 1] * jump
        coefficients[i, p:] += np.outer(left, _SLOPES[1])
        coefficients[i + 1, : 2 * p + 1] += np.outer(right, _SLOPES[0])
    return coefficients


def _complex(vectors: np.ndarray) -> np.ndarray:
    return vectors[:, 0] + 1j * vectors[:, 1]
