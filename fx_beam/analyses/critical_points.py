"""Critical points of a path: where modes of an equilibrium become unstable."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.results.state import ARRAYS, NUMBERS, State
from fx_beam.stepping.arc_length import ArcLength
from fx_beam.stepping.load_steps import LoadStepper
from fx_beam.stepping.newton import StepFailed
from fx_beam.stepping.path_equations import Tangent

from .branches import Branch
from .modal import Modes
from .small_motions import SmallMotions, diverges, flutters

# A point is first found up to this part of the step between two rows. States at five distances
# before it, of this part each, are then extrapolated: no state is computed so near to the point
# that the tangent is singular.
_PLACE, _APART, _STATES = 1e-3, 0.01, 5
# How far before a step one is sought, relative to the step.
_BEFORE = 0.05
# Points so near to each other, relative to the step, are one with several modes.
_SAME = 1e-6
# Work of the loads on a mode that is none, relative to the loads' largest.
_NONE = 1e-6


@dataclass(frozen=True)
class CriticalPoint:
    """A point of a path of equilibria at which modes become unstable, or stable again.

    Parameters
    ----------
    kind : {"limit point", "bifurcation", "flutter"}
        At a limit point the load factor has an extremum: the loads do work on the mode. At a
        bifurcation they do none, and other paths start. Flutter is a vibration that begins to grow,
        under forces that follow the motion.
    load_factor : float
        The load factor.
    row : int
        The last row of the path before the point.
    modes : Modes
        Its modes, the null vectors of the tangent; several if more modes become unstable at once.
    solution : Solution
        The point itself as a static solution of one row, for example to start a motion from.

    Examples
    --------
    Euler's column.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
    >>> column = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, steps=4).critical_points
    >>> point.kind, round(12 * point.load_factor / math.pi**2, 6)
    ('bifurcation', 1.0)
    """

    kind: str
    load_factor: float
    row: int
    modes: Modes
    solution: Solution

    def branch(self, direction: float = 1.0, mode: int = 0) -> Branch:
        """Where a branch starts, for ``static(scene, start=..., continuation="arc-length")``.

        Parameters
        ----------
        direction : float
            1 along the mode, -1 against it.
        mode : int
            Number of the mode among those of the point.

        Returns
        -------
        Branch
            The start.

        Raises
        ------
        SceneError
            If the point is no bifurcation.
        """
        return Branch(self, direction, mode)

    def __repr__(self):
        several = f", {len(self.modes)} modes" if len(self.modes) > 1 else ""
        return f"<CriticalPoint: {self.kind} at load factor {self.load_factor:.9g}{several}>"


class CriticalPoints:
    """Finds the critical points between the states of a path; `solved` makes solutions of one."""

    def __init__(
        self, stepper: LoadStepper, states: list[State], solved: Callable[[State], Solution]
    ):
        self._stepper, self._states, self._solved = stepper, states, solved
        self._motions, self._arc = SmallMotions(stepper), ArcLength(stepper)

    def between(self, counts: np.ndarray) -> list[CriticalPoint]:
        """All of them, from the numbers of unstable modes (n,) of the states."""
        model = self._stepper.model
        if model.flows or model.has_contact:
            raise ValueError(
                "critical_points: they are found on smooth paths. This scene has contact, friction "
                "that sticks or internal variables; unstable_modes tells where stability changes"
            )
        points: list[CriticalPoint] = []
        for row in np.flatnonzero(np.diff(counts)):
            points += self._in_step(int(row), counts[row : row + 2])
        return points

    def _in_step(self, row: int, counts: np.ndarray) -> list[CriticalPoint]:
        """Those in the step that starts at a row."""
        piece = _Piece(self._arc, self._stepper, *self._states[row : row + 2])
        measures = self._measures(piece, counts)
        try:
            roots = [(kind, _root(piece, measure)) for kind, measure in measures]
        except StepFailed as failure:
            raise RuntimeError(
                f"critical_points: the one between the rows {row} and {row + 1} was not found: "
                f"{failure}. Compute the path with more steps"
            ) from failure
        found = sorted(((*root, kind) for kind, root in roots if root), key=lambda x: x[0])
        points: list[CriticalPoint] = []
        last = -np.inf
        for place, state, kind in found:
            if points and place - last <= _SAME * piece.length:
                continue  # one more mode of the same point
            same = sum(abs(other - place) <= _SAME * piece.length for other, *_ in found)
            points.append(self._point(kind, state, row, same))
            last = place
        return points

    def _measures(
        self, piece: _Piece, counts: np.ndarray
    ) -> list[tuple[str, Callable[[State], float]]]:
        """Functions of states that vanish at the critical points of a step."""
        motions, (low, high) = self._motions, sorted(counts.tolist())
        ends = [piece.at(0.0), piece.at(piece.length)]
        stiffness = [motions.stiffness(state) for state in ends]
        if all(motions.symmetric(K) for K in stiffness):
            known: dict[int, np.ndarray] = {}

            def eigenvalue(k: int, state: State) -> float:
                if id(state) not in known:
                    known[id(state)] = motions.lowest(state, high)[0]
                return float(known[id(state)][k])

            return [("", functools.partial(eigenvalue, k)) for k in range(low, high)]
        squares = [motions.squares(state) for state in ends]
        measures: list[tuple[str, Callable[[State], float]]] = []
        if flutters(squares[0]).sum() != flutters(squares[1]).sum():
            measures.append(("flutter", lambda state: _discriminant(motions.squares(state))))
        if diverges(squares[0]).sum() != diverges(squares[1]).sum():
            measures.append(("", lambda state: motions.squares(state).real.min()))
        return measures

    def _point(self, kind: str, state: State, row: int, several: int) -> CriticalPoint:
        motions = self._motions
        if kind == "flutter":
            squares = motions.squares(state)
            first, second = _pair(squares)
            square = float((first + second).real / 2)
            vectors = motions.flutter_shape(state, square)[:, None]
        else:
            vectors = self._null_vectors(state, several)
            square, kind = 0.0, self._kind(state, vectors)
        modes = self._modes(state, vectors, square)
        return CriticalPoint(kind, state.t, row, modes, self._solved(state))

    def _null_vectors(self, state: State, several: int) -> np.ndarray:
        """Vectors (unknowns, several) of the eigenvalues that vanish, of length 1 in the metric."""
        motions = self._motions
        K = motions.stiffness(state)
        if not motions.symmetric(K):
            roots = motions.squares(state)
            return motions.flutter_shape(state, float(roots.real[abs(roots).argmin()]))[:, None]
        count = min(several + 1, K.shape[0])
        while True:
            values, vectors = motions.lowest(state, count)
            nearest = np.argsort(abs(values))[:several]
            if values[-1] > 0 and nearest.max() < len(values) - 1 or count == K.shape[0]:
                return vectors[:, np.sort(nearest)]
            count = min(2 * count, K.shape[0])

    def _kind(self, state: State, vectors: np.ndarray) -> str:
        """Whether the loads do work on the only mode."""
        path, unknowns = self._stepper.path, self._motions.unknowns
        path.begin(state)
        _, _, column = path.balance(np.zeros(self._stepper.model.reduction.free), 0.0)
        column, unit = column[unknowns], self._motions.unit
        largest = np.linalg.norm(column * unit)
        works = abs(vectors.T @ column) / largest if largest else np.zeros(1)
        return "limit point" if vectors.shape[1] == 1 and works[0] > _NONE else "bifurcation"

    def _modes(self, state: State, vectors: np.ndarray, square: float) -> Modes:
        model, T = self._stepper.model, self._motions.coupling()
        mesh, scene, count = model.mesh, model.scene, vectors.shape[1]
        shapes = np.array([model.to_nodes(T @ vector) for vector in vectors.T])
        omega = np.full(count, np.sqrt(square))
        return Modes(
            omega,
            np.zeros(count, dtype=bool),
            shapes,
            mesh.X + model.to_nodes(state.q)[:, :2],
            {beam.name: nodes for beam, nodes in zip(scene.beams, mesh.nodes, strict=True)},
            scene.beams[0].degree if scene.beams else 1,
            np.zeros(count),
            1j * omega,
            {body.name: body for body in scene.bodies},
            {beam.name: beam for beam in scene.beams},
        )


class _Piece:
    """The path between two states, by the distance along its tangent at the first one."""

    def __init__(self, arc: ArcLength, stepper: LoadStepper, first: State, second: State):
        path, D, load = stepper.path, second.q - first.q, second.t - first.t
        none = np.zeros(stepper.model.reduction.free)
        path.begin(first)
        self._arc, self._first = arc, first
        self._tangent = path.tangent(none, 0.0, Tangent(none, D, load))
        self.length = float(self._tangent.D @ (path.weight * D)) + self._tangent.load * load
        self._known: dict[float, State] = {}

    def at(self, distance: float) -> State:
        """The state at a distance."""
        if distance not in self._known:
            self._known[distance] = self._arc.state_at(self._first, self._tangent, distance)
        return self._known[distance]


def _root(piece: _Piece, measure: Callable[[State], float]) -> tuple[float, State] | None:
    """Distance and state where a function of the states vanishes; None if it only touches zero."""
    # Imported here: most paths have no critical point, and the import takes time.
    from scipy.optimize import brentq

    def value(distance: float) -> float:
        return measure(piece.at(distance))

    first = 0.0
    if value(first) * value(piece.length) > 0:
        first = -_BEFORE * piece.length  # the step starts at a limit point
        if value(first) * value(piece.length) > 0:
            return None

    def value_or_zero(distance: float) -> float:
        try:
            return value(distance)
        except StepFailed as failure:
            if failure.kind != "singular":
                raise
            return 0.0  # the point itself

    near = brentq(value_or_zero, first, piece.length, xtol=_PLACE * piece.length)
    # On the side of the start sorted eigenvalues are smooth, also if several vanish at once.
    distances = near - _APART * piece.length * np.arange(1, _STATES + 1)
    values = np.array([value(distance) for distance in distances])
    scaled = (distances - near) / piece.length
    polynomial = np.polynomial.Polynomial(
        np.linalg.solve(np.vander(scaled, increasing=True), values)
    )
    slope, place = polynomial.deriv(), 0.0
    for _ in range(20):
        place -= float(polynomial(place) / slope(place))
    if not abs(place) <= _APART * _STATES:
        raise StepFailed("critical point", "the eigenvalue has no root", np.zeros(1), [])
    weights = np.linalg.solve(
        np.vander(scaled, increasing=True).T, place ** np.arange(_STATES, dtype=float)
    )
    states = [piece.at(distance) for distance in distances]
    return near + place * piece.length, _combined(states, weights)


def _combined(states: list[State], weights: np.ndarray) -> State:
    """The state whose arrays are sums of those of others."""
    values: dict[str, object] = {}
    for name in (*ARRAYS, *NUMBERS, "motors"):
        parts = [getattr(state, name) for state in states]
        if parts[0] is not None:
            values[name] = sum(w * part for w, part in zip(weights, parts, strict=True))
    values["t"] = float(values["t"])  # type: ignore[arg-type]
    return replace(states[0], **values, negative_eigenvalues=None)  # type: ignore[arg-type]


def _pair(squares: np.ndarray) -> tuple[complex, complex]:
    """The two squares of frequencies that are a complex pair, or else nearest to each other."""
    growing = squares[flutters(squares)]
    if len(growing):
        worst = growing[(growing.imag / abs(growing)).argmax()]
        return worst, worst.conjugate()
    real = np.sort(squares.real)
    nearest = (np.diff(real) / (abs(real[1:]) + abs(real[:-1]))).argmin()
    return complex(real[nearest]), complex(real[nearest + 1])


def _discriminant(squares: np.ndarray) -> float:
    """Square of half the distance of two squares of frequencies; negative for a complex pair."""
    first, second = _pair(squares)
    return float((((first - second) / 2) ** 2).real)
