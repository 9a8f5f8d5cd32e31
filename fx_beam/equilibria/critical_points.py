"""Stability along a path of equilibria, its critical points and branches."""

from __future__ import annotations

import copy
import itertools
import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.dual import floats
from fx_beam.errors import SceneError, StepError, as_float, is_number, is_whole, require, shown
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.initial_state import rates_of_columns, reference_state
from fx_beam.motions.motion_setup import model_for
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import Modes, modes_of
from fx_beam.scene.beam import Beam, Node, inner_positions, lagrange, lengths_to_ends
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.stepper import StepFailed

from .arc_length import ArcLength, Stretch, root_between, root_near
from .load_steps import LoadStepper
from .path_equations import Growing, SmallMotions, Tangent, between, pairs_and_others

# -- Branches of a path of equilibria, their first steps from its bifurcations; imperfect scenes


# Two points with load factors and displacements so near to each other are the same.
_SAME = 1e-5


@dataclass(frozen=True)
class Branch:
    """Where a branch starts: ``static(scene, start=point.branch(+1), continuation="arc-length")``.

    Parameters
    ----------
    point : CriticalPoint
        A bifurcation.
    direction : float
        1 along the mode, whose sign follows the rule of `Modes`, -1 against it.
    mode : int
        Number of the mode among those of the point.

    Raises
    ------
    SceneError
        If the point is no bifurcation, or has no such mode.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> column = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, load_steps=4).critical_points
    >>> bent = fb.static(scene, start=point.branch(+1), continuation="arc-length")
    >>> bool(abs(bent.displacement(column.node(0.5))[-1, 0]) > 0.2), bool(bent.stable.all())
    (True, True)
    """

    point: Any
    direction: float = 1.0
    mode: int = 0

    def __post_init__(self):
        is_sign = is_number(self.direction) and self.direction != 0
        require(is_sign, "branch: direction", self.direction, "1 or -1")
        if (kind := getattr(self.point, "kind", shown(self.point))) != "bifurcation":
            path = "the path itself goes on by continuation='arc-length'"
            raise SceneError(f"branch: no path branches off at a {kind}; {path}")
        count = len(self.point.modes)
        expected = f"a number of the {count} modes, from 0"
        require(is_whole(self.mode, 0, count - 1), "branch: mode", self.mode, expected)

    @property
    def shape(self) -> np.ndarray:
        """Displacements and rotations (n_node, 3) of the nodes along which it starts."""
        return np.sign(self.direction) * self.point.modes.shapes[self.mode].real


def grow(
    path: Solution, levels: int, follow: Callable[[Branch], Solution], known_points: list[Any]
) -> None:
    """Compute the branches of a path by `follow`, and the branches of these, `levels` deep.

    None starts at `known_points`, to which the bifurcations of the path are added.
    """
    points = [point for point in path.critical_points if point.kind == "bifurcation"]
    new = [point for point in points if not any(_same(point, other) for other in known_points)]
    known_points += new
    path.branches = []
    for point in new:
        for mode, direction in itertools.product(range(len(point.modes)), (1, -1)):
            start = Branch(point, direction, mode)
            try:
                branch = follow(start)
            except StepError as error:
                branch = error.solution
            if branch is not None:
                branch.origin = start
                path.branches.append(branch)
    if levels > 1:
        for branch in path.branches:
            grow(branch, levels - 1, follow, known_points)


def _same(point: Any, other: Any) -> bool:
    """Whether two critical points are the same."""
    size = float(np.ptp(point.solution.X, axis=0).max()) or 1.0
    gap = (point.solution.q[-1] - other.solution.q[-1]) / np.array([size, size, 1.0])
    return abs(point.load_factor - other.load_factor) <= _SAME and bool(abs(gap).max() <= _SAME)


def imperfect(scene: Scene, modes: Modes, size: float, mode: int = 0) -> Scene:
    """Copy of a scene whose reference shape, without stress, has a mode added.

    Elements of degree 2 and 3 become curved. Beams and nodes of the scene are not those of the
    copy, which are in ``copy.beams`` and ``copy.nodes``, in the same order. `Beam.node` of the copy
    takes the fractions of the scene.

    Parameters
    ----------
    scene : Scene
        The perfect scene. Rigid parts, such as bodies and the arms of ribs, turn and move.
    modes : Modes
        Modes of this scene: of a critical point, or of `modes`.
    size : float
        Largest displacement of a node [m]; negative against the mode, whose sign follows the rule
        of `Modes`.
    mode : int
        Number of the mode.

    Returns
    -------
    Scene
        The imperfect scene.

    Raises
    ------
    SceneError
        If the modes belong to another scene, for joints with a guide or sleeve, whose slides would
        start elsewhere, and joints that were made at a solution.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> column = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, load_steps=4).critical_points
    >>> crooked = fb.imperfect(scene, point.modes, 0.001)
    >>> round(crooked.beams[0].node(0.5).x, 6)
    0.001
    """
    require(isinstance(scene, Scene), "imperfect: scene", scene, "an fx_beam.Scene")
    require(is_number(size), "imperfect: size", size, "a finite number [m]")
    expected = "fx_beam.Modes, such as those of a critical point"
    require(isinstance(modes, Modes), "imperfect: modes", modes, expected)
    exists = is_whole(mode, 0, len(modes) - 1)
    require(exists, "imperfect: mode", mode, "the number of one of the modes")
    nodes = np.array([[node.x, node.y] for node in scene.nodes]).reshape(-1, 2)
    X = np.vstack([nodes, *(floats(inner_positions(beam)) for beam in scene.beams)])
    if len(X) != len(modes.positions) or {*modes.beams} != {beam.name for beam in scene.beams}:
        raise SceneError("imperfect: the modes belong to another scene, with other nodes")
    if any(joint.slide is not None or joint.place is not None for joint in scene.joints):
        raise SceneError(
            "imperfect: joints with a guide or sleeve, or made at a solution, would start from "
            "other slides and angles. Give the scene its imperfect shape when you build it"
        )
    D = _displaced(scene, modes.shapes[mode].real, as_float(size))
    X += D[:, :2]
    # Other parts refer to nodes, beams and joints, which a copy takes from here.
    copies: dict[int, Any] = {id(GROUND): GROUND}
    for node, (x, y) in zip(scene.nodes, X.tolist(), strict=False):
        copies[id(node)] = Node(node.number, x, y)
    for beam in scene.beams:
        copies[id(beam)] = _bent(beam, X[modes.nodes_of_beam[beam.name]], copies)
    for joint in scene.joints:
        own = copy.deepcopy(joint, copies)
        if joint.a is not GROUND:
            c, s = np.cos(turn := D[joint.a.number, 2]), np.sin(turn)
            copies[id(joint)] = replace(own, offset=np.array([[c, -s], [s, c]]) @ own.offset)
    return copy.deepcopy(scene, copies)


def _displaced(scene: Scene, shape: np.ndarray, size: float) -> np.ndarray:
    """Displacements and rotations (n, 3) by a mode (n, 3), with which rigid parts stay rigid."""
    model = model_for(scene, Equilibrium(), settles=True)
    start, reduction = reference_state(model), model.reduction
    scaled = size / np.hypot(*shape[:, :2].T).max() * shape
    reduction.set_start(start.q, start.slides)
    y = unknowns_of(model, start, scaled.ravel())
    return reduction.increment(y, np.zeros(reduction.driven)).reshape(-1, 3)


def _bent(beam: Beam, X: np.ndarray, copies: dict[int, Any]) -> Beam:
    """A beam with all its nodes, in order, at positions X (elements * degree + 1, 2)."""
    p = beam.degree
    elements = X[p * np.arange(beam.elements)[:, None] + np.arange(p + 1)]
    return replace(
        beam,
        nodes=tuple(copies[id(node)] for node in beam.nodes),
        carriers=tuple(copies[id(node)] for node in beam.carriers),
        section=copy.deepcopy(beam.section, copies),
        s=lengths_to_ends(elements),
        fractions=beam.s / beam.length if beam.fractions is None else beam.fractions,
        inner=elements[:, 1:-1].copy() if p > 1 else None,
    )


# The first step. Beside the path that is known, a branch leaves along a null vector of the tangent.
# The first state on it lies in a plane normal to this vector, at a distance from the bifurcation:
# neither the known path nor the bifurcation itself meets this plane, and the equations are regular
# there.

# Its length, as the root mean square over the nodes in units of the scene.
_FIRST = 0.02
# No step is shorter.
_LEAST = 1e-9
# Largest deviation of the first step from the mode, relative to its length: not through a wall.
_NEAR = 0.3


def first_step(arc: ArcLength, state: State, shape: np.ndarray) -> tuple[State, Tangent, float]:
    """State, tangent and length of the first step along a null vector (size,) of a bifurcation.

    It changes the load factor by at most that of a load step, and goes at most half the way to 1.
    StepFailed if it fails after all cuts.
    """
    path, model, options = arc.stepper.path, arc.model, arc.stepper.options
    path.set_start(state)
    path.balance(np.zeros(model.reduction.free), 0.0)
    y = unknowns_of(model, state, shape)
    D = path.spread(y, 0.0)
    length = path.length(D, 0.0)
    mode = Tangent(y / length, D / length, 0.0)
    half_way = 2 / (1 - state.t) if state.t < 1 else 0.0
    distance, cuts = _FIRST, 0
    while True:
        try:
            new, ahead = arc.step(state, mode, distance)
            if arc.stepper.deviation > _NEAR and cuts < options.max_cuts:
                raise StepFailed("off the path", "the step leaves the mode", new.q - state.q)
        except StepFailed:
            if cuts == options.max_cuts:
                raise
            arc.stepper.stats.halvings, cuts = arc.stepper.stats.halvings + 1, cuts + 1
            distance /= 2
            continue
        # The load factor changes with the distance or its square.
        rise = new.t - state.t
        excess = max(options.load_steps * abs(rise), half_way * rise)
        if excess <= 1 or distance <= _LEAST:
            return new, ahead, distance
        distance *= min(0.5, excess**-0.5)


def is_equilibrium(arc: ArcLength, state: State) -> bool:
    """Whether the loads and internal forces of a state are in balance."""
    path, model = arc.stepper.path, arc.model
    path.set_start(state)
    balance, _, _ = path.balance(np.zeros(model.reduction.free), 0.0)
    left = abs(balance.residual[: model.reduction.free] * model.units.unknowns)
    # Springs of slides have no forces at nodes, but those of the joints.
    forces = (abs(force * model.units.nodes).max() for force in (balance.f, balance.r))
    largest = max(*forces, arc.stepper.energies.largest_force(state))
    return bool(left.max(initial=0.0) <= 1e-5 * largest)


def unknowns_of(model: Model, state: State, shape: np.ndarray) -> np.ndarray:
    """Unknowns (free,) of a small motion (size,) of all degrees of freedom from a state."""
    driven = np.zeros(model.couplings.driven)
    return rates_of_columns(model, state, shape, driven)[: model.reduction.free]


# -- A piece of a path of equilibria between two rows, and where a measure of it changes its sign


# Points so near to each other, relative to the step, are one with several modes.
SAME = 1e-6
FLUTTER, LIMIT_POINT, BIFURCATION = "flutter", "limit point", "bifurcation"
SMOOTH = LIMIT_POINT, BIFURCATION
# States at five distances before a point, of this part of the step each, are extrapolated: no state
# is computed so near to the point that the tangent is singular. They are nearer if another point is
# near: this part of its distance. Before, the point is known to this part of theirs.
_APART, _STATES, _OF_GAP, _PLACE = 0.01, 5, 0.1, 0.1
# The place of flutter, where the tangent is regular, relative to the step.
_FLUTTER = 1e-11
# Where an interval is divided: hardly ever where a point lies.
_SPLIT = 0.4871
# How far beyond the ends of a step one is sought, relative to the step.
_BESIDE_STEP = 0.05
# Where measures may jump: one is smooth if its extrapolation is wrong by less than so many times
# the interval; where smooth parts are short, states are so much nearer.
_SMOOTH, _CLOSE = 3.0, 0.01
# The place of a jump relative to the step; how near to it measures are looked at, and how far from
# zero they are there, relative to their values at the ends.
_JUMP, _BESIDE, _LARGE = 1e-11, 1e-8, 1e-4
# Slope of the load factor, relative to its rise from state to state, which is zero; more where it
# is extrapolated over more than one of their distances.
_FLAT = 0.04
# Distance from the end of a step, relative to it, that is no distance.
_SAME_END = 1e-9
# Where a step begins to flow; how exactly its end must be found again.
_FLOWING, _AGAIN = 1e-9, 1e-5


class PathInterval(Stretch[State]):
    """The path between two states, by the distance along its tangent at the first one.

    Where the path may have corners or branches, the straight way between them is the tangent.
    """

    def __init__(self, arc: ArcLength, motions: SmallMotions, first: State, second: State):
        stepper, self.model = arc.stepper, arc.model
        path, D, load = stepper.path, second.q - first.q, second.t - first.t
        self._arc, self.motions, self._start = arc, motions, first
        #: Whether measures may jump.
        self.kinked = self.model.kinks.any
        path.set_start(first)
        length = path.length(D, load)
        y = unknowns_of(self.model, first, D / length)
        self._tangent = Tangent(y, D / length, load / length)
        if not self.kinked:
            with suppress(StepFailed):  # it is singular: the piece starts at a bifurcation
                self._tangent = arc.at_start(first, self._tangent)
        self.length = path.along(self._tangent, D, load)
        #: Whether something flows in it, and where it begins: at the start itself nothing does.
        self.flows = self.model.kinks.flowed(first, second)
        self.first = _FLOWING * self.length if self.flows else 0.0
        ends = {0.0: first} | ({} if self.kinked else {self.length: second})
        super().__init__(lambda place: arc.state_at(first, self._tangent, place), ends)
        self._tangents: dict[float, csr_matrix] = {}
        with suppress(StepFailed):  # it is singular: the piece ends at a bifurcation
            self.point_at(self.length)
        gap = self.points.setdefault(self.length, second).q - second.q
        if not path.is_still(gap) and path.size(gap) > _AGAIN * path.size(D):
            reason = "its end depends on the way, as where materials creep, or others lie beside it"
            raise StepFailed("off the path", reason, D + gap)

    def stiffness(self, distance: float) -> csr_matrix:
        """The tangent K (n, n) at a distance; where something flows, for motions that go on."""
        if distance not in self._tangents:
            if self.flows:
                K = self._arc.stiffness_at(self._start, self._tangent, distance)
            else:
                K = self.motions.stiffness(self.point_at(distance))
            self._tangents[distance] = K
        return self._tangents[distance]

    def switched(self, low: float, high: float) -> State | None:
        """The state in which a contact between two distances opens or closes; None if unknown.

        The path may turn back there: it is extrapolated from states before.
        """
        arc, h = self._arc, _APART * self.length
        start = self._start if low < h else self.point_at(low)
        tangent = arc.at_start(start, self._tangent)
        signs, last = (np.sign(self.model.kinks.switches(s)) for s in (start, self.point_at(high)))
        changed = signs != last
        for side in (-h, h):
            distances = side * np.arange(_STATES)
            try:
                states = [start, *(arc.state_at(start, tangent, d) for d in distances[1:])]
            except StepFailed:
                continue
            values = np.array([self.model.kinks.switches(state) for state in states])
            if changed.any() and (np.sign(values) == signs).all():
                break
        else:
            return None
        roots = [root_near(distances / h, column) for column in values[:, changed].T]
        nearest = min(roots, key=abs)
        return between(states, distances / h, nearest) if abs(nearest) < 2 else None


@dataclass
class Root:
    """Where a mode becomes unstable."""

    place: float
    state: State
    #: The tangent (n, n) there; where it jumps, the tangent of the unstable side.
    stiffness: csr_matrix
    #: The kind of the point.
    kind: str
    #: Slope of the load factor there, relative to its mean slope in states before it.
    rise: float = 1.0


class Bracket(NamedTuple):
    """An interval of distances in which modes become unstable, or stable again."""

    low: float
    high: float
    #: How far apart states beside it should be; 0 for a jump at the start of the piece.
    apart: float
    #: The smaller and the larger number of modes that diverge; at flutter, of those that vibrate.
    few: int
    many: int
    flutter: bool = False
    #: The end at which more vibrate.
    growing: float = 0.0


class _Counted(NamedTuple):
    """A distance, and how many modes grow there."""

    distance: float
    growing: Growing


def brackets_of(piece: PathInterval, first_count: int, last_count: int) -> list[Bracket]:
    """Where the number of modes that grow changes, from its values in the rows before and after."""
    length, brackets = piece.length, list[Bracket]()

    def counted(distance: float) -> _Counted:
        growing = piece.motions.growing(piece.point_at(distance), piece.stiffness(distance))
        return _Counted(distance, growing)

    def intervals(low: _Counted, high: _Counted, exact: float) -> list[tuple[_Counted, _Counted]]:
        """Intervals in which the numbers change, by one mode if longer than SAME."""
        changed = sum(abs(a - b) for a, b in zip(low.growing, high.growing, strict=True))
        extent = high.distance - low.distance
        if changed == 0:
            return []
        if extent <= (exact if changed == 1 else min(exact, SAME * length)):
            return [(low, high)]
        try:
            middle = counted(low.distance + _SPLIT * extent)
            return [*intervals(low, middle, exact), *intervals(middle, high, exact)]
        except StepFailed:
            # So near to a point with several modes the tangent may be too singular for a state.
            if extent > exact:
                raise
            return [(low, high)]

    # A row may lie at a point.
    end_distance = _PLACE * _APART * length
    low, high = counted(piece.first), counted(length)
    if (count := sum(low.growing)) != first_count:
        if piece.kinked:
            few, many = sorted((first_count, count))
            brackets.append(Bracket(low.distance, length, 0.0, few, many))
        else:  # and another one just before it
            earlier = counted(low.distance - end_distance)
            is_before = sum(earlier.growing) == first_count
            low = earlier if is_before else counted(low.distance - _BESIDE_STEP * length)
    if abs((ahead := sum(high.growing)) - first_count) > abs(last_count - first_count):
        high = counted(length - end_distance)  # a limit point at its end is one of the next step
    elif ahead != last_count and not piece.kinked:
        high = counted(length * (1 + _BESIDE_STEP))
    places = intervals(low, high, end_distance)
    for first, last in places:
        gaps = [max(first.distance - b.distance, a.distance - last.distance) for a, b in places]
        apart = _OF_GAP * min([gap for gap in gaps if gap > SAME * length], default=length)
        apart = min(apart, _APART * length)
        meet = first.growing.vibrating != last.growing.vibrating
        for ends in intervals(first, last, _FLUTTER * length if meet else _PLACE * apart):
            before, after = (end.growing for end in ends)
            flutter = before.vibrating != after.vibrating
            which = 0 if flutter else 1
            numbers = {end.growing[which]: end.distance for end in ends}
            few, many = min(numbers), max(numbers)
            low_end, high_end = (end.distance for end in ends)
            brackets.append(Bracket(low_end, high_end, apart, few, many, flutter, numbers[many]))
    return brackets


def root_of(piece: PathInterval, measure: Callable[[float], float], bracket: Bracket) -> Root:
    """Where a measure changes its sign."""
    low, high = bracket.low, bracket.high
    if bracket.flutter:
        place = bracket.growing
        return Root(place, piece.point_at(place), piece.stiffness(place), FLUTTER)
    if not bracket.apart:
        if abs(measure(low)) > _LARGE * abs(measure(high)):
            return _jump(piece, measure, 0.0, low, high)
        # Round-off has put the row behind a limit point.
        apart = _APART * piece.length * (1 if piece.flows else -1)  # nothing flows back
        return _extrapolated(piece, measure, low, apart, abs(apart))
    guess, apart = (low + high) / 2, -bracket.apart
    if piece.flows and guess + _STATES * apart < piece.first:
        apart = -apart  # nothing flows back
    if not piece.kinked:
        return _extrapolated(piece, measure, guess, apart, _STATES * abs(apart))
    ends = [piece.first, piece.length]
    try:
        return _extrapolated(piece, measure, guess, apart, _SMOOTH * (high - low))
    except StepFailed:
        guess = root_between(measure, low, high, _JUMP * piece.length)
    side = _BESIDE * piece.length
    low, high = max(guess - side, piece.first), min(guess + side, piece.length)
    sizes = [abs(measure(place)) for place in (*ends, low, high)]
    if min(sizes[2:]) > _LARGE * max(sizes[:2]):
        return _jump(piece, measure, guess, low, high)
    apart *= _CLOSE
    return _extrapolated(piece, measure, guess, apart, _STATES * abs(apart))


def end_of(piece: PathInterval, measure: Callable[[float], float], reach: float) -> Root | None:
    """Where a function of the distance vanishes at the end of a smooth step, or so far beyond it.

    `reach` is relative to the step; None if it does not.
    """
    first, last = (measure(place) for place in (piece.first, piece.length))
    # The line through both values, and what a curve may differ from it.
    if abs(last) > 2 * (reach + _PLACE * _APART) * abs(last - first):
        return None
    apart = -max(_APART, min(reach, 1.0) / _STATES) * piece.length
    try:
        root = _extrapolated(piece, measure, piece.length, apart, (reach + _APART) * piece.length)
    except StepFailed:
        return None
    return root if 0 <= root.place / piece.length - 1 + _SAME_END <= reach + _SAME_END else None


def _jump(
    piece: PathInterval, measure: Callable[[float], float], place: float, low: float, high: float
) -> Root:
    """Where a measure jumps between two distances."""
    K, model = piece.stiffness(low if measure(low) < 0 else high), piece.model
    kind = "flow" if piece.flows else "kink"
    if model.kinks.switched(piece.point_at(low), piece.point_at(high)):
        kind = "contact" if model.kinks.has_contact else "kink"
    elif not (piece.flows or model.kinks.bend):
        step = piece.point_at(high).q - piece.point_at(low).q
        raise StepFailed("off the path", "the step reaches another path", step)
    state = None if piece.flows else piece.switched(low, high)
    return Root(place, piece.point_at(place) if state is None else state, K, kind)


def _extrapolated(
    piece: PathInterval,
    measure: Callable[[float], float],
    guess: float,
    apart: float,
    farthest: float,
) -> Root:
    """The root near a distance, extrapolated from states on one side, some length `apart`.

    StepFailed if it is farther away than `farthest`.
    """
    # There sorted eigenvalues are smooth, also if several vanish at once.
    distances = guess + apart * np.arange(1, _STATES + 1)
    values = np.array([measure(distance) for distance in distances])
    scaled = (distances - guess) / apart
    place = root_near(scaled, values)
    if not abs(place * apart) <= farthest:
        raise StepFailed("critical point", "the eigenvalue has no root", np.zeros(1))
    states = [piece.point_at(distance) for distance in distances]
    state = between(states, scaled, place)
    loads = np.array([state.t for state in states])
    slope = np.polynomial.Polynomial.fit(scaled, loads, _STATES - 1).deriv()(place)
    rise = abs(slope) * (_STATES - 1) / max(np.ptp(loads), np.finfo(float).tiny)
    kind = SMOOTH[int(rise > _FLAT * max(1.0, abs(place)))]
    if piece.flows:
        (shares,) = lagrange(scaled, np.array([place]))
        K = sum(w * piece.stiffness(d) for w, d in zip(shares, distances, strict=True))
    else:
        K = piece.motions.stiffness(state)
    return Root(guess + place * apart, state, K, kind, rise)


# -- Where modes become unstable, or stable again, in the steps of a path -----------------------
# A step in which their number changes at no point that is found has left its path.


#: A point in a step, and how many modes become unstable there.
Crossing = tuple[Root, int]
# What equilibria, factors and eigenvalues raise.
FAILURES = StepFailed, RuntimeError, ValueError
# Work of the loads on a mode that is none, relative to its parts, and to the forces in members;
# rounding errors, relative to stiffness times the size of the scene. The part of the loads by which
# it is found.
_OF_PARTS, _OF_FORCES, _ROUNDING, _PART_OF_LOADS = 1e-7, 1e-9, 2e-16, 0.5
# Eigenvalue that vanishes, relative to that of a state beside it.
_VANISHES = 1e-4
# Modes that one point has at most, as a rule.
_AT_ONE_POINT = 2


class Crossings:
    """Finds crossings in the steps of a path."""

    def __init__(self, stepper: LoadStepper):
        self.motions, self.arc = stepper.motions, ArcLength(stepper)
        #: Crossings in accepted steps, by the state at their end.
        self._seen: dict[int, tuple[State, State, list[Crossing]]] = {}

    def check_stability(self, old: State, new: State, limits: int) -> None:
        """StepFailed if the number of unstable modes changes in a step where no point is found.

        It may change by one at each of so many limit points.
        """
        if None in (old.unstable_modes, new.unstable_modes):
            if old.negative_pivots == new.negative_pivots is not None:
                return  # at flutter the path itself goes on as before
        count, next_count = (self.motions.count(state, old) for state in (old, new))
        if count is None or next_count is None or abs(next_count - count) in (0, limits):
            return
        stepper = self.arc.stepper
        if stepper.may_be_cut and not count and self._is_too_long(new, next_count):
            reason = f"{next_count} of its modes become unstable in it"
            raise StepFailed("off the path", reason, new.q - old.q)
        crossings, missing = self._in_step(old, new, count, next_count, whole=False)
        if missing:
            count, next_count = self.motions.count_again(old, new)
            if count == next_count:
                return
            reason = (
                f"of its modes {count} are unstable at its start and {next_count} at its end, "
                f"with no critical point between: {missing}"
            )
            raise StepFailed("off the path", reason, new.q - old.q)
        self._seen[id(new)] = old, new, crossings

    def is_singular(self, state: State, neighbour: State) -> bool:
        """Whether the lowest eigenvalue of a state vanishes, beside that of its neighbour."""
        motions = self.motions
        with suppress(*FAILURES):
            tangents = [motions.stiffness(each) for each in (state, neighbour)]
            if all(map(motions.symmetric, tangents)):
                lowest, size = (abs(motions.lowest(K, 1)[0][0]) for K in tangents)
                return bool(lowest < _VANISHES * size)
        return False

    def _is_too_long(self, end: State, count: int) -> bool:
        """Whether a step from a stable state passes more modes than one point, or two that bend."""
        if count == _AT_ONE_POINT:
            with suppress(*FAILURES):
                K = self.motions.stiffness(end)
                symmetric = self.motions.symmetric(K)
                return symmetric and self.bends(end, self.motions.lowest(K, count)[1])
        return count > _AT_ONE_POINT

    def between(
        self, old: State, new: State, count: int, next_count: int
    ) -> tuple[list[Crossing], str]:
        """Crossings in a step with numbers of unstable modes, and why others were not found."""
        cached = self._seen.get(id(new))
        if cached is not None and cached[0] is old:
            return cached[2], ""
        return self._in_step(old, new, count, next_count)

    def _in_step(
        self, old: State, new: State, *counts: int, whole: bool = True
    ) -> tuple[list[Crossing], str]:
        """Points in a step, and why another one was not found; empty if all were.

        If the `whole` is not wanted, those before the first that is not found.
        """
        try:
            piece = PathInterval(self.arc, self.motions, old, new)
            brackets = brackets_of(piece, *counts)
        except FAILURES as failure:
            return [], str(failure)
        crossings = list[Crossing]()
        missing, last = "" if brackets else "all modes stay as they are", -np.inf
        for bracket in brackets:
            if missing and not whole:
                break
            multiplicity = bracket.many - bracket.few
            try:
                root = root_of(piece, self.eigenvalue(piece, bracket.few), bracket)
                stays = self._is_on_path(root, multiplicity, max(counts))
            except FAILURES as failure:
                missing = str(failure)
                continue
            if not stays:
                missing = "the step reaches another path"
            elif root.place - last > SAME * piece.length:  # else it is the same one, divided
                crossings.append((root, multiplicity))
                last = root.place
        return crossings, missing

    def _is_on_path(self, root: Root, multiplicity: int, unstable: int) -> bool:
        """Whether a smooth point is an equilibrium, at which no rising load bends its modes."""
        if root.kind not in SMOOTH:
            return True
        if not is_equilibrium(self.arc, root.state):
            return False
        if root.kind == LIMIT_POINT or not self.motions.symmetric(root.stiffness):
            return True
        return not self.bends(
            root.state, self.motions.vanishing(root.stiffness, multiplicity, unstable)
        )

    def bends(self, state: State, vectors: np.ndarray) -> bool:
        """Whether the loads up to a state do work on its modes (unknowns, n)."""
        stepper, unit = self.arc.stepper, self.motions.unit
        K = self.motions.stiffness(state)
        stepper.path.set_start(state)
        apart = _PART_OF_LOADS * abs(state.t)
        loads = abs(state.t) * stepper.path.disturbance(apart)
        loads = loads[self.motions.model.reduction.independent]
        sizes = np.linalg.norm(vectors.T / unit, axis=1)
        least = _OF_PARTS * abs(loads) @ abs(vectors)
        least += _OF_FORCES * stepper.energies.largest_force(state) * sizes
        least += _ROUNDING / _PART_OF_LOADS * (abs(K) @ unit) @ abs(vectors)
        return bool((abs(loads @ vectors) > least).any())

    def eigenvalue(self, piece: PathInterval, k: int) -> Callable[[float], float]:
        """Eigenvalue k, numbered from the lowest one, as a function of the distance.

        Where forces follow the motion, the square of the lowest frequency.
        """
        motions = self.motions

        def eigenvalue(distance: float) -> float:
            K = piece.stiffness(distance)
            if motions.symmetric(K):
                return float(motions.lowest(K, k + 1)[0][k])
            return float(motions.squares(piece.point_at(distance))[0].real)

        return eigenvalue


# -- Stability along a path of equilibria, and its critical points ------------------------------


_log = logging.getLogger("fx_beam")
# How far ahead of the end of a path that has failed one is sought, in lengths of the last step.
_AHEAD = 2.0
# Slope of the load factor there, relative to its rise before, beyond which it has no limit point.
_STEEP = 0.5
NOT_LOCATED = "not located"


@dataclass(frozen=True)
class CriticalPoint:
    """A point of a path of equilibria at which modes become unstable, or stable again.

    Parameters
    ----------
    kind : {"limit point", "bifurcation", "flutter", "contact", "flow", "kink", "not located"}
        At a limit point the load factor has an extremum: the loads do work on the mode. At a
        bifurcation it rises or falls, and other paths start. Flutter is a vibration, under forces
        that follow the motion, that begins or ceases to grow; its two modes may continue to grow
        without vibrating. At "contact", "flow" and "kink" the stiffness jumps from one sign to the
        other: where a contact opens or closes, where members or springs begin to flow or to slip,
        or at a kink in the law of a spring; the load factor may have an extremum there, with a
        corner of the path. "not located" is a point that was not found between two rows.
    load_factor : float
        The load factor; nan if the point was not located.
    row : int
        The last row of the path before the point.
    modes : Modes, optional
        The null vectors of the tangent; several if several modes become unstable at once. Where the
        stiffness jumps, the modes that are unstable on one side. Their signs follow the rule of
        `Modes`. None if the point was not located.
    solution : Solution, optional
        The point itself as a static solution of one row, for example to start a motion from. None
        if the point was not located.

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
    >>> point, = fb.static(scene, load_steps=4).critical_points
    >>> point.kind, round(12 * point.load_factor / math.pi**2, 5)
    ('bifurcation', 1.0)
    """

    kind: str
    load_factor: float
    row: int
    modes: Modes | None = None
    solution: Solution | None = None

    def branch(self, direction: float = 1.0, mode: int = 0) -> Branch:
        """Where a branch starts, for ``static(scene, start=..., continuation="arc-length")``.

        Parameters
        ----------
        direction : float
            1 along the mode, whose sign follows the rule of `Modes`, -1 against it.
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
        if self.modes is None:
            return f"<CriticalPoint: {self.kind}, between the rows {self.row} and {self.row + 1}>"
        modes_text = f", {len(self.modes)} modes" if len(self.modes) > 1 else ""
        return f"<CriticalPoint: {self.kind} at load factor {self.load_factor:.9g}{modes_text}>"


def first_critical_point(solution: Solution) -> CriticalPoint:
    """The first critical point of a static solution; SceneError if none was located."""
    if not solution.stats.static:
        raise SceneError("Response: a motion has no critical_load. Take fx_beam.StaticResponse")
    points = solution.critical_points
    if not points:
        raise SceneError(
            "critical_load: the path has no critical point up to load factor "
            f"{solution.t[-1]:.6g}. Give larger loads, and to find limit points "
            'continuation="arc-length"'
        )
    if points[0].kind == NOT_LOCATED:
        raise SceneError(
            f"critical_load: the first critical point, between the rows {points[0].row} and "
            f"{points[0].row + 1} of the path, was not located. Take more load steps"
        )
    return points[0]


class PathStability:
    """Stability of the states of a path; `solved` makes a solution of a single state.

    The first state may be a bifurcation at which the path `branches_off`.
    """

    def __init__(
        self,
        stepper: LoadStepper,
        crossings: Crossings,
        states: list[State],
        solved: Callable[[State], Solution],
        branches_off: bool = False,
    ):
        self._stepper, self._states, self._solved = stepper, states, solved
        # There an eigenvalue is zero: it counts as the state beside it.
        self._first = int(branches_off and len(states) > 1)
        self._last = int(stepper.stats.closed and len(states) > 1)
        self._motions, self._crossings = stepper.motions, crossings

    def unstable_modes(self) -> np.ndarray:
        """Numbers (n,) of modes that grow, by the factors of the steps, or by new ones."""
        states = self._states[self._first : len(self._states) - self._last]
        factors = [state.unstable_modes for state in states]
        steps = zip(states, states[1:], factors[1:], strict=False)
        flowed = self._motions.model.kinks.flowed
        if any(count is None and flowed(old, new) for old, new, count in steps):
            raise ValueError(
                "unstable_modes: where something slips or flows, they are known of symmetric "
                "tangents: not where friction slips or forces follow the motion, nor with closed "
                "loops, nodes that slide on beams, or contact of members"
            )
        counts: list[int] = []
        limits = self._stepper.stats.limit_points
        limit = None
        for count, state in zip(factors, states, strict=True):
            is_limit = bool(counts) and state.t in limits
            if is_limit:
                count = counts[-1]
            elif count is None:
                count = sum(self._motions.growing(state))
            if limit is not None:
                counts[-1] = self._at_limit(limit, counts[-1], count)
            counts.append(count)
            limit = state if is_limit else None
        ends = counts[:1] * self._first, counts[-1:] * self._last
        return np.array(ends[0] + counts + ends[1], dtype=int)

    def _at_limit(self, state: State, last: int, following: int) -> int:
        """Number of unstable modes at a limit point, from those of the `last` row before it.

        The eigenvalue that is zero counts as there; those that change beside it as they are here.
        """
        if abs(following - last) == 1 or self._motions.model.kinks.flows:
            return last
        K = self._motions.stiffness(state)
        if not self._motions.symmetric(K):
            return last
        values = self._motions.lowest(K, max(last, following) + 1)[0]
        rest = int((np.delete(values, abs(values).argmin()) < 0).sum())

        def change(count: int) -> tuple[int, int]:
            gap = abs(count - last)
            return gap + abs(following - (2 * rest + 1 - count)), gap

        return min((rest, rest + 1), key=change)

    def critical_points(self) -> list[CriticalPoint]:
        """The critical points between the states, and at their end; none if modes are unknown.

        A warning names points that were not located.
        """
        try:
            counts = self.unstable_modes()
        except ValueError as error:
            _log.warning("critical_points: none is known. %s", error)
            return []
        points: list[CriticalPoint] = []
        reasons: dict[int, str] = {}
        for row in np.flatnonzero(np.diff(counts)).tolist():
            points_in_step, reason = self._in_step(row, counts[row : row + 2].tolist())
            points += points_in_step
            if reason:
                points.append(CriticalPoint(NOT_LOCATED, np.nan, row))
                reasons[row] = reason
        if reasons:
            rows = ", ".join(f"{row} and {row + 1}" for row in reasons)
            _log.warning(
                "critical_points: points between the rows %s were not located, and are in the list "
                'as "%s": %s. Compute the path with more steps',
                *(rows, NOT_LOCATED, next(iter(reasons.values()))),
            )
        return points + self.at_end(counts)

    def at_end(self, counts: np.ndarray) -> list[CriticalPoint]:
        """The critical point at the end of the path, or ahead of it if it has failed."""
        failure = self._stepper.stats.failure
        failed = failure is not None and failure.kind != "too many steps"
        motions, row, count = self._motions, len(counts) - 2, int(counts[-1])
        if row < 0 or self._last or counts[row] != count or count == len(motions.unit):
            return []
        try:
            piece = PathInterval(self._crossings.arc, motions, *self._states[row:])
            ends = [piece.stiffness(end) for end in (piece.first, piece.length)]
            if piece.kinked or not all(motions.symmetric(K) for K in ends):
                return []
            eigenvalue, far = self._crossings.eigenvalue(piece, count), _AHEAD if failed else SAME
            if (root := end_of(piece, eigenvalue, far)) is None:
                return []
            modes = motions.vanishing(root.stiffness, 1, count + 1)
            if root.kind == BIFURCATION and self._crossings.bends(root.state, modes):
                if root.rise <= _STEEP:
                    root.kind = LIMIT_POINT
                elif not is_equilibrium(self._crossings.arc, root.state):
                    return []  # the path goes on along the mode
            return [self._point(root, row, 1, count + 1)]
        except FAILURES:
            return []

    def _in_step(self, row: int, counts: list[int]) -> tuple[list[CriticalPoint], str]:
        """Critical points in the step after a row, and why others were not located."""
        points: list[CriticalPoint] = []
        old, new = self._states[row : row + 2]
        crossings, reason = self._crossings.between(old, new, *counts)
        for root, multiplicity in crossings:
            try:
                points.append(self._point(root, row, multiplicity, max(counts)))
            except FAILURES as failure:
                reason = str(failure)
        return points, reason

    def _point(self, root: Root, row: int, multiplicity: int, unstable: int) -> CriticalPoint:
        motions, state, K, square = self._motions, root.state, root.stiffness, 0.0
        if root.kind == FLUTTER:
            square = float(pairs_and_others(motions.squares(state))[0][0].real)
            vectors = motions.shapes(state, square, multiplicity)
        elif not motions.symmetric(K):
            vectors = motions.shapes(state, float(motions.squares(state)[0].real), multiplicity)
        elif root.kind in SMOOTH:
            vectors = motions.vanishing(K, multiplicity, unstable)
        else:
            vectors = motions.lowest(K, unstable)[1][:, -multiplicity:]
        kind = "bifurcation" if multiplicity > 1 and root.kind in SMOOTH else root.kind
        omega = np.sign(square) * np.sqrt(abs(square))
        rate, ratio = (-omega, np.nan) if square < 0 else (1j * omega, 0.0)
        values = (np.full(vectors.shape[1], value) for value in (omega, False, ratio, rate))
        shapes = motions.at_nodes(state, vectors)
        modes = modes_of(self._stepper.model, state.q, shapes, *values)
        return CriticalPoint(kind, state.t, row, modes, self._solved(state))
