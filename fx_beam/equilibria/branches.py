"""Branches of a path of equilibria, their first steps from its bifurcations; imperfect scenes."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError, StepError, as_float, is_number, is_whole, require, shown
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.initial_state import rates_of_columns, reference_state
from fx_beam.motions.prepared import model_for
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import Modes
from fx_beam.scene.beam import Beam, Node, inner_positions, lengths_to_ends
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.step_failures import StepFailed

from .arc_length import ArcLength
from .path_equations import Tangent

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

    Elements of degree 2 and 3 become curved. Handles of the scene, such as beams, are not those of
    the copy: its own are in ``copy.beams`` and ``copy.nodes``, in the same order. `Beam.node` of
    the copy takes the fractions of the scene.

    Parameters
    ----------
    scene : Scene
        The perfect scene. What is rigid, such as bodies and the arms of ribs, turns and moves.
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
