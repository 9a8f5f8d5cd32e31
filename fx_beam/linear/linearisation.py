"""Stiffness, damping and mass of small motions about a configuration, and their pencil."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse
from scipy.sparse import csr_matrix

from fx_beam.content_cache import cached_property
from fx_beam.coupling.dependent_columns import ColumnMap
from fx_beam.equilibria.statics import unloaded
from fx_beam.errors import SceneError, StepError, require, warn_once
from fx_beam.laws.interval import Interval, instant
from fx_beam.laws.schemes import Equilibrium, MidPoint
from fx_beam.motions.initial_state import drawn_state, rates_of_columns
from fx_beam.motions.motion_setup import check_scene, model_for, state_of
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.functions import values_of, widths, with_values
from fx_beam.scene.outputs import Measured
from fx_beam.scene.scene import Scene
from fx_beam.step.constrained_matrix import ConstrainedMatrix, UndampedModes
from fx_beam.step.equations import Equations, have_mass
from fx_beam.step.forcing import Forcing, TurningFrame, check_turns
from fx_beam.step.model import Model
from fx_beam.step.state_vector import added_force

# -- K + s C + s^2 M of small motions: sparse, also in long trees and loops ---------------------


# Difference of rotations in a beam, relative to the largest motion: a rigid one has none.
_BENT = 1e-2
# Random vectors of which sizes of diagonals are estimated.
_SAMPLES = 8


class Weighted:
    """E^T A E (free, free) of a sparse A (n, n), where y = E x is all that follows unknowns x."""

    def __init__(self, A: csr_matrix, stiffness: ConstrainedMatrix):
        self.A, self._stiffness = A, stiffness

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return self._stiffness.collected(self.A @ self._stiffness.spread(x))

    def __abs__(self) -> Weighted:
        return Weighted(abs(self.A), self._stiffness)

    def diagonal(self) -> np.ndarray:
        """Diagonal (free,); where other unknowns follow an estimate, without signs."""
        diagonal = self.A.diagonal()
        if self._stiffness.is_plain:
            return diagonal
        random = np.random.default_rng(0).standard_normal((len(diagonal), _SAMPLES))
        roots = self._stiffness.collected(np.sqrt(abs(diagonal))[:, None] * random)
        return (roots**2).mean(axis=1)


class DampedPencil:
    """K + s C + s^2 M of unknowns; with `ConstrainedMatrix` matrices, C and M without equations."""

    def __init__(self, K: ConstrainedMatrix, C: ConstrainedMatrix, M: ConstrainedMatrix):
        self._stiffness = K
        self.K, self.C, self.M = (Weighted(part.alone, K) for part in (K, C, M))
        parts, n = [part.system.tocoo() for part in (K, C, M)], K.system.shape[0]
        places = [part.col.astype(np.int64) * n + part.row for part in parts]
        pattern = np.unique(np.concatenate(places))
        # The values of all three in the columns of a common pattern.
        self._values = np.zeros((3, len(pattern)))
        for values, part, place in zip(self._values, parts, places, strict=True):
            np.add.at(values, np.searchsorted(pattern, place), part.data)
        self._pattern = pattern % n, np.searchsorted(pattern // n, np.arange(n + 1))

    def matrix_at(self, s: complex) -> ConstrainedMatrix:
        """The matrix at a number s [1/s]."""
        values, shape = np.array([1, s, s**2]) @ self._values, self._stiffness.system.shape
        matrix = scipy.sparse.csc_matrix((values, *self._pattern), shape)
        return replace(self._stiffness, system=matrix)


# -- Stiffness, damping and mass of small motions about a configuration -------------------------


# Length of the steps whose tangents give the damping [s]. In much shorter ones damping over the
# length hides what couples nodes that slide.
INSTANT = 1e-9
# Round-off of a mass or a damping of a combination of unknowns, relative to the largest.
_NOTHING = 1e-12
# Distance, relative to the scene's size, at which what is one-sided just begins to act.
_JUST = 1e-12
_STRAINED = "the reference is no equilibrium, as springs are strained there"


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Small motions about a configuration, reduced to the unknowns."""

    #: The scene, and its model with the values of its inputs in the state.
    scene: Scene
    model: Model
    #: Stiffness K and mass M (free, free), in long trees with auxiliary unknowns.
    stiffness: ConstrainedMatrix
    inertia: ConstrainedMatrix
    #: How all columns and the nodes follow the unknowns.
    coupling: ColumnMap
    #: Numbers (free,) of the unknowns in the model, where others follow to close loops.
    unknowns: np.ndarray
    #: The configuration, at rest in its frame.
    start: State
    #: A frame that turns, and Coriolis forces by rates in it (free, free); None for one at rest.
    frame: TurningFrame | None
    coriolis: ConstrainedMatrix | None
    #: Load factor, zero for the reference, and dead loads (size,) in the state [N, N m].
    factor: float
    loads: np.ndarray
    #: Models by name of a response, which get the numbers of the next scene; else None.
    models: dict[str, Model] | None

    @cached_property
    def T(self) -> csr_matrix:
        """Coupling (size, free): motions of the nodes are T times the unknowns."""
        return self.coupling.matrix[:, self.unknowns]

    @property
    def columns(self) -> csr_matrix:
        """Matrix (columns, free) that gives all columns of the model from the unknowns."""
        count = self.model.reduction.columns
        return self.coupling.dependence_matrix[:count, self.unknowns]

    @property
    def K(self) -> csr_matrix:
        """Stiffness (free, free)."""
        return self.stiffness.matrix

    @property
    def M(self) -> csr_matrix:
        """Mass (free, free)."""
        if (M := self.inertia).is_plain:
            return M.system
        followed = self.coupling.dependence_matrix[self._extended][:, self.unknowns]
        return (followed.T @ M.alone @ followed).tocsr()

    @property
    def _count(self) -> int:
        return self.coupling.shape[1]

    @property
    def _extended(self) -> np.ndarray:
        """Columns of the unknowns, of auxiliary ones, and of those that close loops."""
        K, auxiliary = self.stiffness, np.arange(self.model.reduction.columns, self._count)
        return np.concatenate([self.unknowns, auxiliary, K.places.order[K.places.closing]])

    @property
    def unit(self) -> np.ndarray:
        """Sizes (n,) of unit unknowns of `stiffness`."""
        return self.stiffness.units(self.model)

    def at_nodes(self, x: np.ndarray) -> np.ndarray:
        """Motions (size, n) of the nodes by unknowns (free, n)."""
        if self.stiffness.is_plain:
            return self.T @ x
        columns = np.zeros((x.shape[1], self._count), x.dtype)
        columns[:, self.unknowns] = x.T
        moved = np.zeros((self.model.size, len(columns)), x.dtype)
        for k, z in enumerate(columns):
            moved[:, k] = self.coupling @ z.real
            if z.imag.any():
                moved[:, k] += 1j * (self.coupling @ z.imag)
        return moved

    def unknown_forces(
        self, forces: np.ndarray, column_forces: np.ndarray | None = None
    ) -> np.ndarray:
        """T^T f (free,) for forces f (size,) at nodes, or also those (columns,) on columns."""
        others = np.zeros(self._count)
        if column_forces is not None:
            others[: len(column_forces)] = column_forces
        parts = self.coupling.transposed(forces.real, others)[self.unknowns]
        if np.iscomplexobj(forces):
            parts = parts + 1j * self.coupling.transposed(forces.imag, 0 * others)[self.unknowns]
        return parts

    @property
    def may_be_damped(self) -> bool:
        """Whether the scene has anything whose forces depend on rates."""
        scene, beams = self.model.scene, self.model.forms.beams
        coordinates = _coordinates(scene)
        return (
            any(beam.section.damped for beam in scene.beams)
            or any(c.damper or c.friction or (c.stop and c.stop.loss) for c in coordinates)
            or any(obstacle.loss or obstacle.friction for obstacle in scene.contacts)
            or bool(scene.drags or scene.dampings)
            or any(force.force for force in scene.forces_between)
            or (beams is not None and beams.facts.needs_rates)  # in statics: of added virtual works
        )

    def damping(self, caller: str, damped: bool = True) -> ConstrainedMatrix | None:
        """Derivative C of all forces by the rates, without equations; with damping if that counts.

        None without any; errors name the `caller`.
        """
        if not (damped and self.may_be_damped):
            return self.coriolis
        model, tangents, start = self.damped_model, [], self.start
        equations = Equations(model, inert=False)
        equations.set_load(self.factor or 1.0)  # of forces that depend on rates
        for dt in (INSTANT, 2 * INSTANT):
            equations.set_start(instant(start.t, dt), start)
            equations.at_start(np.zeros(model.size))
            tangents.append(equations.extended())
        equations.set_load(1.0)
        short, long = (tangent.system for tangent in tangents)
        system = (2 * INSTANT * (short - long)).tocsr()
        check_damping(system.data, f"{caller}: the damping at rest")
        system.eliminate_zeros()
        C = replace(tangents[0], system=system).without_equations
        return C if self.coriolis is None else C + self.coriolis

    @cached_property
    def damped_model(self) -> Model:
        """A model whose steps tell damping: their tangent is stiffness/2 + damping/dt.

        Forces of the mid-point rule are smooth in their increments, for all stored energies.
        """
        kind = MidPoint(), self.models, "damped"
        return model_for(self.model.scene, *kind, instant=True)

    @property
    def has_potential(self) -> bool:
        """Whether the stiffness is symmetric but for round-off."""
        return self.stiffness.is_symmetric(self.unit, bool(self.model.couplings.sliding))

    @cached_property
    def undamped_modes(self) -> UndampedModes:
        """Modes of the mass and the symmetric part of the stiffness."""
        K, M = self.stiffness.symmetric, self.inertia
        if not M.system.data.any():
            raise SceneError("modes: the scene has no mass. Give a section rhoA or add a mass")
        if K.is_plain:
            return UndampedModes(K, M)
        # Sums over masses that do not cancel.
        random, sums = np.random.default_rng(0).random(len(self._extended)), np.zeros(self._count)
        sums[self._extended] = random * M.alone.diagonal()
        moves = self.coupling.transposed(np.zeros(self.model.size), sums) != 0
        return UndampedModes(K, M, moves[self.unknowns])


def _coordinates(scene: Scene) -> list[Coordinate]:
    """All of the joints and between points of a scene."""
    joints = [c for joint in scene.joints for c in joint.coordinates.values()]
    return joints + [force.on for force in scene.forces_between]


def check_finite(stiffness: np.ndarray, forces: np.ndarray, caller: str) -> None:
    """Refuse a state in which a stiffness or a force is not finite."""
    if not (np.isfinite(stiffness).all() and np.isfinite(forces).all()):
        raise SceneError(
            f"{caller}: a stiffness or a force is not finite in the state: a law of the scene is "
            "beyond what it can hold there. Take a state beside it, or another form of the law"
        )


def check_unknowns(model: Model, caller: str) -> None:
    """Refuse a scene in which nothing can move."""
    if len(model.reduction.independent) == model.couplings.released:
        raise SceneError(
            f"{caller}: the scene has no unknowns: supports, joints and motors fix all degrees of "
            "freedom. Release one of them"
        )


def bends(model: Model, shapes: np.ndarray) -> bool:
    """Whether a beam bends in one of the shapes (size, n)."""
    motions = shapes / model.units.nodes[:, None]
    turns = motions[2::3] / abs(motions).max(axis=0)
    differences = [np.ptp(turns[nodes], axis=0) for nodes in model.mesh.nodes]
    return bool(np.max(differences, initial=0.0) > _BENT)


def check_damping(values: np.ndarray, which: str) -> None:
    """Refuse damping that is not finite; errors say `which` it is."""
    if not np.isfinite(values).all():
        raise SceneError(
            f"{which} is not finite, since the derivative of an added virtual work by the velocity "
            "is not. Smooth it there, such as ufl.sqrt(v**2 + 1e-12) for the speed"
        )


def sized(basis: np.ndarray) -> np.ndarray:
    """Columns (n, k) with the largest value 1."""
    return basis / abs(basis).max(axis=0, initial=0.0)


def split(A: np.ndarray, basis: np.ndarray, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Bases (n, k) of the parts of a basis in which a semidefinite A is positive, and zero.

    The basis itself where it is all of one kind; diagonals up to the `least` value are zero.
    """
    a = basis.T @ A @ basis
    diagonal = a.diagonal()
    if not (diagonal > least).any():
        return basis[:, :0], basis
    scale = 1 / np.sqrt(np.where(diagonal > least, diagonal, 1.0))
    R, order, rank, _ = scipy.linalg.lapack.dpstrf(scale[:, None] * a * scale, tol=_NOTHING)
    if rank == len(a):
        return basis, basis[:, :0]
    positive, rest = np.split((basis * scale)[:, order - 1], [rank], axis=1)
    factor, right = np.split(R[:rank], [rank], axis=1)
    zero = rest - positive @ scipy.linalg.solve_triangular(factor, right)
    return sized(positive), sized(zero)


def output_rows(
    model: Model,
    measured: Measured,
    matrices: Mapping[str, csr_matrix],
    slopes: Iterable[tuple[str, np.ndarray, np.ndarray]] | None = None,
) -> np.ndarray:
    """Rows (components, n) of an output for changes of arrays: a matrix by the name of each.

    That of the slides has the columns of the model. Other arrays stay, and so do all numbers. With
    its `slopes`, if they are not the same in every state.
    """
    rows = np.zeros((*(measured.shape or (1,)), next(iter(matrices.values())).shape[1]))
    for array, entries, values in measured.slopes() if slopes is None else slopes:
        if (matrix := matrices.get(array)) is not None:
            if "slides" in array:
                entries = np.array([model.couplings.slides[number] for number in entries.tolist()])
            rows += values[0] @ matrix[entries].toarray()
    return rows


def linearised(
    scene: Scene,
    state: Solution | None,
    caller: str,
    models: dict[str, Model] | None = None,
    is_held: bool = False,
) -> Linearisation:
    """Linearise about the last row of a state, or about the reference without loads.

    SceneError for a state that is no equilibrium, unless it `is_held`; errors name the `caller`.
    Models of a response, by name, get the numbers of this scene.
    """
    check_scene(scene, caller)
    end = state.end if isinstance(state, Solution) else None
    driven_scene = with_values(scene, None if end is None else values_of(end, widths(scene)))
    # On a yield surface round-off would say whether something flows.
    springs = [coordinate.spring for coordinate in _coordinates(scene) if coordinate.spring]
    flows = any(law.internal for law in [*springs, *(beam.section for beam in scene.beams)])
    kind = {"mobile": True} | ({"instant": True} if flows else {})
    model = model_for(driven_scene, Equilibrium(), models, "plain", **kind)
    # The drawing is an equilibrium without loads.
    factor, start = (0.0, drawn_state(model)) if state is None else _last(model, state, caller)
    reduction = model.reduction
    check_unknowns(model, caller)
    frame = None if state is None else turning_frame_of(model, state, caller)
    equations = Equations(model, start.t, frame)
    force = dead_loads(model, start, factor, frame, added_force(model, start, factor, start.t))
    equations.set_start(Interval(factor, factor), start)
    balance = equations.at_start(force)
    if reduction.singularity:
        raise SceneError(f"{caller}: {reduction.singularity}. Take a state beside it")
    K, unknowns, G = equations.extended(), reduction.independent, None
    check_finite(K.system.data, balance.residual, caller)
    if frame is not None:
        G = K.weighted(frame.gyroscopic, reduction).without_equations
        G = G.with_data(np.sqrt(factor) * G.system.data)
    M = _without_round_off(K.weighted(model.masses.matrix, reduction), K.units(model))
    about = Linearisation(
        scene=scene,
        model=model,
        stiffness=K,
        inertia=M,
        coupling=reduction.maps.column_map,
        unknowns=unknowns,
        start=start,
        frame=frame,
        coriolis=G,
        factor=factor,
        loads=force,
        models=models,
    )
    # The largest work of a force at a node in a unit motion of the scene [J].
    largest = max(abs(part * model.units.nodes).max() for part in (balance.f, balance.r, force))
    _warn_of_switches(model, start, caller)
    if is_held or _is_equilibrium(about, state, balance.residual[unknowns], largest, caller):
        return about
    settled = settled_reference(scene, caller, models is None)
    return about if settled is None else linearised(scene, settled, caller)


def _warn_of_switches(model: Model, state: State, caller: str) -> None:
    """Warn of a rope, stop or contact that is just where it begins to act."""
    points = model.points
    if not points.placed or not sum(points.switch_counts):
        return
    ends = np.cumsum(points.switch_counts, dtype=int)
    values = np.split(model.kinks.switches(state), ends)
    for placed, gaps in zip(points.placed, values, strict=False):
        law = placed.law.law
        is_one_sided = law.unilateral or (law.length_law is not None and not law.internal)
        if is_one_sided and (abs(gaps) <= _JUST * model.mesh.size).any():
            warn_once(
                f"{caller}: {placed.force.belongs_to} is just where it begins to act, and counts "
                "as if it did not. Give a state in which it does or does not, such as "
                "static(scene), a gap, or a pretension (add_rope(..., pretension=))"
            )
            return


def settled_reference(scene: Scene, caller: str, settles: bool = True) -> Solution | None:
    """The equilibrium without loads to which springs under tension bring a scene, if it `settles`.

    None of a mechanism, which has none. A warning tells both.
    """
    solution = None
    with suppress(SceneError, StepError):
        solution = unloaded(scene, caller) if settles else None
    told = "The state is the equilibrium without loads to which they bring it"
    if solution is None:
        told = "What they press has none of their force. Give a state, such as static(scene)"
    warn_once(f"{caller}: {_STRAINED}. {told}")
    return solution


def _without_round_off(M: ConstrainedMatrix, unit: np.ndarray) -> ConstrainedMatrix:
    """A mass without equations, and those of unknowns (n,) that are round-off."""
    masses = M.alone.diagonal()
    heavy = have_mass(masses, unit)
    return M.only(heavy) if not M.is_plain or masses[~heavy].any() else M


def turning_frame_of(model: Model, state: Solution, caller: str) -> TurningFrame | None:
    """The frame in which a static state turns, of load factor 1; None if it does not turn."""
    if not state.stats.static or not state.v[-1].any():
        return None
    check_turns(model.scene, caller)
    v, x = state.v[-1], state.X + state.q[-1, :, :2]
    spin = v[0, 2]
    # v = spin W (x - pivot)
    pivot = x[0] + np.array([-v[0, 1], v[0, 0]]) / spin
    return TurningFrame(model, spin / np.sqrt(state.t[-1]), pivot)


def dead_loads(
    model: Model, state: State, factor: float, frame: TurningFrame | None, added: np.ndarray
) -> np.ndarray:
    """Dead loads (size,) of a state at a load factor.

    Within a path they are the loads that the state has, without `added` (size,) and the frame's.
    """
    if factor == 1 or state.loads is None:
        return factor * Forcing(model).dead(state.t)
    turning = 0.0 if frame is None else factor * frame.force(state.q)
    return state.loads - turning - added


def _last(model: Model, state: Solution, caller: str) -> tuple[float, State]:
    """Load factor and configuration in the last row of a solution."""
    require(isinstance(state, Solution), f"{caller}: state", state, "a solution of the scene")
    if not np.array_equal(state.X, model.mesh.X) or not len(state.q):
        raise SceneError(
            f"{caller}: the state must be a solution with the nodes of this scene and its motion "
            "recorded (record=Record(motion=True))"
        )
    try:
        end = state_of(model, state)
    except SceneError as error:
        raise SceneError(f"{caller}: {str(error).removeprefix('start: ')}") from None
    factor = float(state.t[-1]) if state.stats.static else 1.0
    return factor, replace(end, v=0 * end.v, a=0 * end.a)


# Forces without balance in a state that is called an equilibrium, relative to the largest force;
# rounding errors, relative to stiffness times the size of the scene.
_BALANCED, _ROUNDING = 1e-4, 1e-13
# Amplitude of the motion in it, relative to the size of the scene.
_AT_REST = 1e-3
_ADVICE = (
    "Take the state from static(scene), and for a scene that turns steadily from "
    "static(scene, spin=...)"
)


def _is_equilibrium(
    about: Linearisation,
    state: Solution | None,
    unbalanced: np.ndarray,
    largest: float,
    caller: str,
) -> bool:
    """Whether the reference is in balance; SceneError for a state that is not, or moves on.

    The `largest` work of a force in a unit motion [J] says which forces are round-off.
    """
    model = about.model
    unit = about.unit
    left = abs(unbalanced) * unit[: len(unbalanced)]
    rounding = _ROUNDING * (unit * (abs(about.stiffness.alone) @ unit)).max()
    if left.max() <= _BALANCED * largest + rounding:
        if state is not None and not state.stats.static:
            _check_rest(about, state, caller)
        return True
    if state is None:
        return False
    worst = int(left.argmax())
    moved = (abs(about.T[:, [worst]].toarray()[:, 0]) / model.units.nodes).reshape(-1, 3)
    if moved[:, 2].any():  # a rotation, which may move other nodes
        moved[:, :2] = 0.0
    node, component = np.unravel_index(moved.argmax(), moved.shape)
    force, name = left[worst] / unit[worst], "N m" if component == 2 else "N"
    raise SceneError(
        f"{caller}: the state is no equilibrium: {force:.3g} {name} in {COMPONENTS[component]} of "
        f"{model.mesh.named(node, model.scene)} has no balance; the largest force in the state is "
        f"{largest / model.mesh.size:.3g} N. {_ADVICE}"
    )


def _check_rest(about: Linearisation, state: Solution, caller: str) -> None:
    rates = state.v[-1] if len(state.v) else getattr(state.end, "v", None)
    if rates is None or not rates.any():
        return
    model, v = about.model, rates.ravel()
    driven = np.zeros(model.couplings.driven)
    w = rates_of_columns(model, about.start, v, driven)[about.unknowns]
    # The amplitude of a vibration that passes with these rates, in units of the scene.
    speed = abs(v / model.units.nodes).max()
    stiffness = abs(w @ (about.K @ w))
    amplitude = speed * np.sqrt(w @ (about.M @ w) / stiffness) if stiffness else np.inf
    if amplitude > _AT_REST:
        raise SceneError(
            f"{caller}: the state is no equilibrium, since it moves on, at up to "
            f"{speed * model.mesh.size:.3g} m/s. {_ADVICE}"
        )
