"""How a mechanism settles under its loads: the equilibrium that it finds in a viscous fluid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from fx_beam.coupling.determinacy import links
from fx_beam.errors import SceneError
from fx_beam.fem.mesh import connected_parts
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.step.constrained_matrix import ConstrainedMatrix
from fx_beam.step.model import Model
from fx_beam.step.stepper import StepFailed

from .load_steps import LoadStepper, check_circles

# -- Parts of a scene that nothing but supports holds, and their rigid motions that these leave -
# Where loads are in balance among themselves, such a motion meets no force. A spring at as many
# degrees of freedom holds it, as a statically determinate support does: it carries nothing.


# Forces without balance that are round-off, relative to the sum of all; motions of supports.
_BALANCED, _MOTION_ROUNDING = 1e-9, 1e-9


class FreePart(NamedTuple):
    """Nodes that hang together, and that nothing joins to the ground but supports."""

    nodes: np.ndarray
    #: Whether it has no support at all.
    unsupported: bool

    def middle(self, x: np.ndarray) -> np.ndarray:
        """The middle (2,) of the nodes, of all positions (n_node, 2)."""
        return x[self.nodes].mean(axis=0)

    def rigid(self, x: np.ndarray) -> np.ndarray:
        """Motions (n_node, 3, 3) along x and y, and about its middle."""
        motions, (dx, dy) = np.zeros((len(x), 3, 3)), (x[self.nodes] - self.middle(x)).T
        motions[self.nodes] = np.eye(3)
        motions[self.nodes, 0, 2], motions[self.nodes, 1, 2] = -dy, dx
        return motions


def free_parts(model: Model) -> list[FreePart]:
    """The parts of a scene that joints, springs and obstacles do not join to the ground."""
    scene, mesh = model.scene, model.mesh
    beams, ground = len(mesh.X), len(mesh.X) + len(scene.beams)
    pairs = links(scene, mesh)
    pairs += [(beams + i, node) for i, nodes in enumerate(mesh.nodes) for node in nodes]
    ends = np.reshape(pairs, (-1, 2)).astype(int).T % (ground + 1)  # -1 is the ground
    part_of = connected_parts(ends, ground + 1)
    supported = {node for node, _ in (*scene.fixed, *scene.prescribed)}
    parts = (np.flatnonzero(part_of[:beams] == k) for k in np.unique(part_of[:beams]))
    apart = (nodes for nodes in parts if part_of[nodes[0]] != part_of[ground])
    return [FreePart(nodes, supported.isdisjoint(nodes.tolist())) for nodes in apart]


def without_balance(model: Model, forces: np.ndarray) -> str:
    """Resultants of all forces (size,) on parts without support, where they are not zero."""
    for part in free_parts(model):
        # Virtual works may join it to the ground, as a bed does.
        if part.unsupported and not model.scene.virtual_works:
            motions = part.rigid(model.mesh.X).reshape(-1, 3)
            sums, sizes = motions.T @ forces, abs(motions.T) @ abs(forces)
            sizes[2] += sizes[:2].sum() * model.mesh.size
            if (abs(sums) > _BALANCED * sizes).any():
                x, y, moment = np.where(abs(sums) > _BALANCED * sizes, -sums, 0.0) + 0.0
                middle = part.middle(model.mesh.X)
                return (
                    f"its loads have no balance: their sum is ({x:.4g}, {y:.4g}) N and, about "
                    f"({middle[0]:.4g}, {middle[1]:.4g}), {moment:.4g} N m, and it has no support"
                )
    return ""


def left_by_supports(model: Model, q: np.ndarray) -> np.ndarray:
    """Rigid motions (size, n) of free parts that supports leave, in a configuration (size,)."""
    scene, x = model.scene, model.mesh.X + q.reshape(-1, 3)[:, :2]
    supports = np.array([*scene.fixed, *scene.prescribed], dtype=int).reshape(-1, 2)
    motions = [np.zeros((model.size, 0))]
    for part in free_parts(model):
        rigid = part.rigid(x) / [1, 1, model.mesh.size]
        # With rows of zeros, as a matrix needs rows where there are no supports.
        rows = np.vstack([rigid[supports[:, 0], supports[:, 1]], np.zeros((3, 3))])
        left = scipy.linalg.null_space(rows, rcond=_MOTION_ROUNDING)
        motions.append(rigid.reshape(-1, 3) @ left)
    return np.hstack(motions)


def held_for_nothing(model: Model, q: np.ndarray, K: ConstrainedMatrix, none: float) -> np.ndarray:
    """Degrees of freedom (n,) at which supports hold motions of `left_by_supports` without force.

    K is the tangent of the configuration; a stiffness [J] up to `none` is none.
    """
    rigid = left_by_supports(model, q) / model.units.nodes[:, None]
    if not rigid.size:
        return np.empty(0, int)
    reduction, unit = model.reduction, model.units.nodes
    rigid = scipy.linalg.orth(rigid)
    unknown_forces = [reduction.maps.transpose_to_nodes(r / unit) for r in rigid.T]
    sides = np.array(unknown_forces)[:, reduction.independent].T
    moved = K.weighted(scipy.sparse.diags(unit**-2.0), reduction).solve(sides)
    node_motions = np.array([reduction.maps.motion(x) / unit for x in moved.T]).T
    _, apart, parts = np.linalg.svd(node_motions - rigid, full_matrices=False)
    together = parts[apart <= _MOTION_ROUNDING**0.5].T  # joints leave them as well
    k = together.T @ moved.T @ (K @ (moved @ together))
    stiffness, parts = np.linalg.eigh((k + k.T) / 2)
    neutral = rigid @ together @ parts[:, abs(stiffness) <= none]
    if not neutral.size:
        return np.empty(0, int)
    order = scipy.linalg.qr(neutral.T * model.acted_on, mode="r", pivoting=True)[1]
    return order[: neutral.shape[1]]


# -- How a mechanism settles under its loads: the equilibrium that it finds in a viscous fluid --
# Without loads a mechanism has no stiffness, and any of its positions is an equilibrium; a slack
# cable has hardly any. From its reference configuration it moves against a drag on all nodes, in
# steps of implicit Euler,
#
#     f(q + D) + mu W D = F,    W = diag(1 / unit^2),
#
# as the fluid becomes thin (mu to 0). In a step to a minimum of the potential the fluid takes at
# least half of mu D.W D. Steps on the way up, or to a saddle, are taken again with more drag.
#
# Rigid motions that supports leave, and that meet no force, keep a drag for good: at as many
# degrees of freedom, where it is a statically determinate support that carries nothing.


# Length that a step should have and may have, in units of the scene and radians.
_TARGET, _LONGEST = 0.2, 0.5
# Largest deviation of a step with drag from its predictor, relative to it: it goes straight down.
_DEVIATION = 1.0
# Length of a step after which the next one may be without drag; where rigid motions may be left.
_SHORT, _SHORTER = 1e-3, 1e-8
# Length of a step in equilibrium.
_STILL = 1e-12
# Least part of mu D.W D that the fluid takes.
_LEAST_WORK = 0.4
# Largest number of steps, and way in units of the scene that no equilibrium is beyond.
_MOST, _FAR = 400, 100.0
# Drag without loads, relative to the largest stiffness.
_LITTLE = 1e-6
_NO_LOAD = "it has no load, and no prestress"
# Stiffness that is none, relative to the loads and to the largest stiffness.
_OF_LOADS, _ROUNDING = 1e-9, 1e-14
# Difference of rotations in a beam that bends, relative to the motion.
_BENT = 1e-3
# The same of rigid motions, and forces that their support may carry.
_NEUTRAL, _CARRIED = 1e-6, 1e-6


class Settling:
    """Finds the equilibrium of a mechanism at a load factor; errors say for what `reason`."""

    def __init__(self, stepper: LoadStepper, reason: str = ""):
        self._why = reason or stepper.model.mechanism
        self.stepper, self.model, self._loop = stepper, stepper.model, stepper.loop
        self._weights = self._loop.drag_weight.copy()
        #: Whether no mode may grow against the drag in a step, which may turn its sign.
        self.keeps_side = False

    def settled(self, state: State, goal: float) -> State:
        """The equilibrium that is found from a state. SceneError if there is none."""
        loop, first, work = self._loop, state.q, state.work
        self.stepper.hold_between(goal, goal)
        self._check_forces(state)
        largest, failed = self._load(state, goal), ""
        if reason := without_balance(self.model, loop.balance(state, 1.0).r):
            raise self._error(reason)
        enough = _SHORTER if largest and left_by_supports(self.model, first).size else _SHORT
        # Where no force moves it, prestress may hold it.
        drag = (largest or _LITTLE * self._largest(self.stepper.motions.extended(state))) / _TARGET
        short, moved = False, np.inf
        for _ in range(_MOST if drag else 0):
            loop.drag_weight[:], loop.drag = self._weights, drag
            if short:
                self.hold_rigid_motions(state, largest)
            try:
                new, moved = self._step(state, goal)
            except StepFailed as failure:
                # A motion that only the drag holds goes on, as that of a node off its beam.
                if short and moved * drag <= _STILL * largest:
                    break
                drag, short, failed = (drag if short else 4 * drag), False, failure.reason
                continue
            state = new
            if short:
                break
            if self._size(state.q - first) > _FAR:
                raise self._error("under its loads it moves on without an end")
            short = moved <= enough
            drag *= min(1.0, max(0.1, moved / _TARGET))
        else:
            lost = "under its loads it finds no equilibrium" + f" ({failed})" * bool(failed)
            raise self._error(lost if drag else _NO_LOAD)
        self._check(largest, state)
        return state.changed(work=work)

    def hold_rigid_motions(self, state: State, largest: float) -> None:
        """Drag on rigid motions without force, beside a load, at as many degrees of freedom."""
        loop, motions = self._loop, self.stepper.motions
        loop.drag = 0.0
        K = motions.extended(state)
        none = max(_NEUTRAL * largest, _ROUNDING * self._largest(K))
        if largest and len(dofs := held_for_nothing(self.model, state.q, K, none)):
            loop.drag_weight[:] = 0.0
            loop.drag_weight[dofs] = self._weights[dofs]
            loop.drag = self._largest(K)

    def check_balance(self, state: State) -> None:
        """SceneError if a support would have to carry the rigid motions that are held."""
        if self._loop.drag:
            unit = self.model.units.unknowns[: self.model.reduction.free]
            left = abs(self.stepper.residual(state, state.t) * unit).max(initial=0.0)
            largest = max(self._load(state, state.t), self.stepper.energies.largest_force(state))
            if left > _CARRIED * largest + 100 * _ROUNDING * self._loop.drag:
                raise self._error(f"at the load factor {state.t:.4g} they have no balance")

    def _load(self, state: State, goal: float) -> float:
        """Largest load, other force at a node or force without balance, times its unit [J]."""
        balance = self._loop.balance(state, goal)
        unit = self.model.units.unknowns
        largest = abs(balance.residual[: len(unit)] * unit).max(initial=0.0)
        forces = self.stepper.loop.forcing.dead(goal), balance.f, balance.r
        return float(max(largest, *(abs(force * self.model.units.nodes).max() for force in forces)))

    def _step(self, state: State, goal: float) -> tuple[State, float]:
        """State after a step, and its length; StepFailed if too long, upwards, or over a circle."""
        new, step = self._loop.step(state, Interval(goal, goal))
        self.stepper.note(step)
        moved = self._size(step.D)
        bent = self._loop.drag and self.stepper.deviation > _DEVIATION and moved > _SHORT
        # Slip and yielding make a step deviate as well, however short it is.
        if (bent and not self.model.kinks.flowed(state, new)) or moved > _LONGEST:
            raise StepFailed("off the path", "the step is too long", step.D)
        check_circles(self.model, state, new)
        if self.keeps_side:
            self._check_side(state, goal, step.predicted)
        work, gained, rounding = self.stepper.energies.work_and_gain(state, new, step.D)
        drag_work = self._loop.drag * step.D @ (self._loop.drag_weight * step.D)
        self.stepper.motions.note(new, self._loop)
        saddle = new.unstable_modes and moved > _STILL
        if saddle or not work - gained + rounding >= _LEAST_WORK * drag_work:
            raise StepFailed("off the path", "the step goes up", step.D)
        return new, moved

    def _check_side(self, state: State, goal: float, predicted: np.ndarray) -> None:
        """StepFailed if a mode grows against the drag before a step or by its predictor (size,).

        An implicit step turns its sign.
        """
        straight = state.changed(t=goal, q=state.q + predicted)
        if any(sum(self.stepper.motions.growing(place)) for place in (state, straight)):
            raise StepFailed("off the path", "a mode grows faster than the drag", predicted)

    def _size(self, D: np.ndarray) -> float:
        return float(abs(D / self.model.units.nodes).max(initial=0.0))

    def _largest(self, K: ConstrainedMatrix) -> float:
        """The largest stiffness of a tangent, times its units [J]."""
        return float(abs(K.alone.diagonal() * K.units(self.model) ** 2).max(initial=0.0))

    def freest(self, state: State, largest: float = 0.0) -> np.ndarray | None:
        """A small motion (size,) against which a state has no stiffness, beside a load; or None."""
        model, motions = self.model, self.stepper.motions
        K, unit = motions.extended(state), motions.unit
        none = max(_OF_LOADS * largest, _ROUNDING * self._largest(K)) or 1.0
        # With so little drag the tangent is never singular.
        drag = scipy.sparse.diags(0.1 * none * model.units.nodes**-2.0)
        regularised = K + K.weighted(drag, model.reduction)
        least, x = 0.0, np.random.default_rng(0).standard_normal(len(unit)) * unit
        for _ in range(4):  # inverse iteration
            x = regularised.solve(x / unit**2)
            size = float(np.linalg.norm(x / unit))
            least, x = 1 / size, x / size
        return None if least > none else model.reduction.maps.motion(x) / model.units.nodes

    def _check_forces(self, state: State) -> None:
        """SceneError if on an unknown nothing acts, not even the drag."""
        self._loop.balance(state, state.t)  # the couplings are then those of this state
        reduction = self.model.reduction
        random_drag = np.random.default_rng(0).random(len(self._weights)) * self._weights
        drag = reduction.maps.transpose_to_nodes(random_drag)[reduction.independent]
        if (drag == 0).any():
            first = np.arange(len(drag)) == np.argmax(drag == 0)
            free = reduction.maps.motion(first) / self.model.units.nodes
            raise self._error(f"nothing acts on {self.where(free)}", free)

    def _check(self, largest: float, state: State) -> None:
        """SceneError if an equilibrium is free to move: the loads give it no stiffness.

        Where beams have less than round-off, so little drag stays.
        """
        if (free := self.freest(state, largest)) is None:
            return
        if not self._bends(free):
            lost = f"in their equilibrium they leave {self.where(free)} free"
            raise self._error(lost if largest else _NO_LOAD, free)
        loop, most = self._loop, self._largest(self.stepper.motions.extended(state))
        loop.drag_weight[:] = loop.drag_weight * bool(loop.drag) + 10 * _ROUNDING * self._weights
        loop.drag = loop.drag or most

    def _bends(self, motion: np.ndarray) -> bool:
        """Whether beams bend in a small motion (size,): a stiffness that is less than round-off."""
        turns = abs(motion).max() * _BENT
        beams = (motion[2::3][nodes] for nodes in self.model.mesh.nodes)
        return any(np.ptp(turn) > turns for turn in beams)

    def where(self, free: np.ndarray) -> str:
        """Name of the component that moves most in a small motion (size,)."""
        node, component = self._most(free)
        return f"{component} of {self.model.mesh.named(node, self.model.scene)}"

    def _most(self, free: np.ndarray) -> tuple[int, str]:
        """Node and component that move most in a small motion (size,)."""
        node, component = divmod(int(abs(free).argmax()), 3)
        return node, COMPONENTS[component]

    def _error(self, reason: str, free: np.ndarray | None = None) -> SceneError:
        """Error of a mechanism that loads do not hold: why, a support against a motion (size,)."""
        support = "" if free is None else f', such as fix(node, "{self._most(free)[1]}"),'
        return SceneError(
            f"{self._why}. Loads may hold such a part, as gravity holds a pendulum, but "
            f"{reason}. Add a support{support or ','} or a spring"
        )
