"""Critical points of a path: where modes of an equilibrium become unstable."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.stepping.arc_length import ArcLength
from fx_beam.stepping.load_steps import LoadStepper
from fx_beam.stepping.newton import StepFailed

from .branches import Branch
from .modal import Modes
from .path_piece import Piece, Root, end_of, root_of
from .small_motions import SmallMotions, diverges, flutters

# Points so near to each other, relative to the step, are one with several modes.
_SAME = 1e-6
# How far ahead of the end of a path that has failed one is sought, in lengths of the last step.
_AHEAD = 4.0
# Work of the loads on a mode that is none, relative to the loads' largest.
_NONE = 1e-6


@dataclass(frozen=True)
class CriticalPoint:
    """A point of a path of equilibria at which modes become unstable, or stable again.

    Parameters
    ----------
    kind : {"limit point", "bifurcation", "flutter", "contact", "flow", "kink"}
        At a limit point the load factor has an extremum: the loads do work on the mode. At a
        bifurcation they do none, and other paths start. Flutter is a vibration that begins to grow,
        under forces that follow the motion. At the others the stiffness jumps from one sign to the
        other, where a contact opens or closes, where members or springs begin to flow or to slip,
        or at a kink of a law of springs; the load factor may have an extremum there, with a corner
        of the path.
    load_factor : float
        The load factor.
    row : int
        The last row of the path before the point.
    modes : Modes
        Its modes, the null vectors of the tangent; several if more modes become unstable at once.
        Where the stiffness jumps, those that are unstable on one side.
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
    >>> point.kind, round(12 * point.load_factor / math.pi**2, 5)
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

    def between(self, counts: np.ndarray, failed: bool = False) -> list[CriticalPoint]:
        """All of them, from the numbers of unstable modes (n,) of the states.

        Also one at the end, or beyond the end of a path that has failed.
        """
        points: list[CriticalPoint] = []
        for row in np.flatnonzero(np.diff(counts)):
            try:
                points += self._in_step(int(row), counts[row : row + 2])
            except StepFailed as failure:
                raise RuntimeError(
                    f"critical_points: the one between the rows {row} and {row + 1} was not found: "
                    f"{failure}. Compute the path with more steps"
                ) from failure
        return points + self.at_end(counts, failed)

    def at_end(self, counts: np.ndarray, failed: bool) -> list[CriticalPoint]:
        """The one at the end of the last step, or a little beyond it if the path has failed."""
        motions, row, count = self._motions, len(counts) - 2, int(counts[-1])
        if row < 0 or counts[row] != count or count == len(motions.unit):
            return []
        try:
            piece = Piece(self._arc, motions, *self._states[row:])
            ends = [piece.stiffness(end) for end in (piece.first, piece.length)]
            if piece.kinked or not all(motions.symmetric(K) for K in ends):
                return []
            eigenvalue = functools.partial(self._eigenvalues(piece, count + 1), count)
            root = end_of(piece, eigenvalue, _AHEAD if failed else _SAME)
            return [] if root is None else [self._point("", root, row, 1, count + 1)]
        except StepFailed:
            return []

    def _eigenvalues(self, piece: Piece, n: int) -> Callable[[int, float], float]:
        """The n lowest eigenvalues as functions of their number and the distance."""
        known: dict[float, np.ndarray] = {}

        def eigenvalue(k: int, distance: float) -> float:
            if distance not in known:
                known[distance] = self._motions.lowest(piece.stiffness(distance), n)[0]
            return float(known[distance][k])

        return eigenvalue

    def _in_step(self, row: int, counts: np.ndarray) -> list[CriticalPoint]:
        """Those in the step that starts at a row."""
        piece = Piece(self._arc, self._motions, *self._states[row : row + 2])
        measures = self._measures(piece, counts)
        roots = [(kind, root_of(piece, measure)) for kind, measure in measures]
        found = sorted(((root, kind) for kind, root in roots if root), key=lambda x: x[0].place)
        points: list[CriticalPoint] = []
        last = -np.inf
        for root, kind in found:
            if points and root.place - last <= _SAME * piece.length:
                continue  # one more mode of the same point
            near = (abs(other.place - root.place) for other, _ in found)
            same = sum(gap <= _SAME * piece.length for gap in near)
            points.append(self._point(kind or root.kind, root, row, same, counts.max()))
            last = root.place
        return points

    def _measures(
        self, piece: Piece, counts: np.ndarray
    ) -> list[tuple[str, Callable[[float], float]]]:
        """Functions of the distance that vanish at the critical points of a step."""
        motions, (low, high) = self._motions, sorted(counts.tolist())
        ends = [piece.first, piece.length]
        if all(motions.symmetric(piece.stiffness(end)) for end in ends):
            eigenvalue = self._eigenvalues(piece, high)
            return [("", functools.partial(eigenvalue, k)) for k in range(low, high)]

        def squares(distance: float) -> np.ndarray:
            return motions.squares(piece.at(distance))

        first, last = map(squares, ends)
        measures: list[tuple[str, Callable[[float], float]]] = []
        if flutters(first).sum() != flutters(last).sum():
            measures.append(("flutter", lambda distance: _discriminant(squares(distance))))
        if diverges(first).sum() != diverges(last).sum():
            measures.append(("", lambda distance: squares(distance).real.min()))
        return measures

    def _point(self, kind: str, root: Root, row: int, several: int, unstable: int) -> CriticalPoint:
        motions, state, square = self._motions, root.state, 0.0
        if kind == "flutter":
            first, second = _pair(motions.squares(state))
            square = float((first + second).real / 2)
            vectors = motions.flutter_shape(state, square)[:, None]
        elif kind:
            vectors = motions.lowest(root.stiffness, unstable)[1][:, -several:]
        else:
            vectors = self._null_vectors(root, several)
            kind = self._kind(state, vectors)
        modes = self._modes(state, vectors, square)
        return CriticalPoint(kind, state.t, row, modes, self._solved(state))

    def _null_vectors(self, root: Root, several: int) -> np.ndarray:
        """Vectors (unknowns, several) of the eigenvalues that vanish, of length 1 in the metric."""
        motions, state, K = self._motions, root.state, root.stiffness
        if not motions.symmetric(K):
            roots = motions.squares(state)
            return motions.flutter_shape(state, float(roots.real[abs(roots).argmin()]))[:, None]
        count = min(several + 1, K.shape[0])
        while True:
            values, vectors = motions.lowest(K, count)
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
