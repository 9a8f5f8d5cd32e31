"""The initial state of a motion: velocities, accelerations, or the end of another solution."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse.linalg

from fx_beam.coupling.reduction import moves_alone
from fx_beam.dual import Dual, floats, with_slopes
from fx_beam.errors import SceneError, all_of, any_of, shown
from fx_beam.laws.interval import INSTANT, Interval, instant
from fx_beam.results.solution import Solution
from fx_beam.results.state import NUMBERS, Past, State
from fx_beam.scene import joints as scene_joints
from fx_beam.scene.beam import COMPONENTS, Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.joints import GROUND, Constraints, JointKey, key_of, slides_at_start
from fx_beam.scene.loads import NAMES
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import Forcing
from fx_beam.step.model import Model, fact, led_dofs, massless_dofs, sizes_of
from fx_beam.step.newton import newton

if TYPE_CHECKING:
    from fx_beam.fem.forms import StepForces


# -- The initial state of a motion: velocities, checked or projected, and accelerations ---------


_log = logging.getLogger("fx_beam")

# Last correction, in units of the scene, and one that may be the last if no smaller one follows.
_TOLERANCE, _STALLED = 1e-10, 1e-6
_MOST_CORRECTIONS = 100
# Longest turn of a node in a correction [rad].
_LONGEST_TURN = 0.5
# Part of the masses that holds them while massless parts find their equilibrium, where several
# unknowns move one mass: beside all of it, in so short a time, stiffnesses would be round-off.
_LITTLE = 1e-12
# Distance from a place that is round-off, in units of the scene's size.
_IN_PLACE = 1e-13

# Work of a force where there is no mass that is round-off, relative to the largest, in a motion by
# units of the scene: so moments are compared with forces.
_NONE = 1e-9
_NOT_SETTLED = (
    "no equilibrium was found at the start for nodes without mass: their motion may alternate from "
    "step to step. Let the loads begin at zero, or start from static(scene)"
)
# Rates before the first given ones, and flags of nodes that have some: none for any node.
_NONE_BEFORE = np.zeros(1, dtype=bool)
_ADVICE = "Give compatible velocities to all members, or call scene.make_velocities_compatible()"


def _settled(model: Model, state: State, force: np.ndarray, dt: float) -> State:
    """The state with massless parts in equilibrium under dead forces (size,), by Newton's method.

    In a time so short that mass and dampers hold all others, and nothing relaxes. The state itself,
    with a warning, if that fails, or where internal variables would flow, which depends on the way.
    """
    from fx_beam.step.equations import Equations

    reduction, still, has_mass = model.reduction, np.zeros(model.size), ~fact(model, massless_dofs)
    shared = reduction.maps.moves(has_mass) & ~moves_alone(model.couplings, has_mass)
    equations = Equations(model, inertia=_LITTLE if shared.any() else 1.0)
    time, level = 1e-9 * dt, model.scheme.rates.level
    new, holding, away = replace(state, a=still), still, still

    def correct() -> tuple[float, bool]:
        nonlocal new, away
        # What has mass returns to its place, from which a correction along its path leads away.
        away = state.q - new.q
        away[~has_mass | (abs(away) < _IN_PLACE * model.units.nodes)] = 0.0
        new.v = holding + away / (level * time)
        equations.set_start(instant(new.t, time), new)
        residual = equations.at_start(force).residual[: reduction.free]
        w, independent = np.zeros(reduction.columns), reduction.independent
        unit = model.units.unknowns[independent]  # pivots are of one kind
        scale = scipy.sparse.diags(unit)
        # The stiffness is that of the scheme's level in the step.
        factors = scipy.sparse.linalg.splu((scale @ equations.tangent() @ scale).tocsc())
        w[independent] = -level * unit * factors.solve(unit * residual[independent])
        y = reduction.maps.with_dependent(w)[: reduction.free]
        D = reduction.increment(y, np.zeros(reduction.driven))
        turn = abs(D[model.mesh.turns]).max()
        if turn > _LONGEST_TURN:
            y *= _LONGEST_TURN / turn
            D = reduction.increment(y, np.zeros(reduction.driven))
        size = abs(D / model.units.nodes).max()
        if not np.isfinite(size):
            raise RuntimeError(_NOT_SETTLED)
        slides = new.slides + model.couplings.free_slides(y, len(new.slides))
        new = replace(new, q=new.q + D, slides=slides)
        return size, size <= _STALLED

    with suppress(RuntimeError):  # a tangent is singular
        settled = newton(correct, _TOLERANCE, _MOST_CORRECTIONS)[1]
        if settled and away.any():
            # Little inertia gives way. The force that it had is given, and brings all back.
            holding = away / (level * time)
            settled = newton(correct, _TOLERANCE, _MOST_CORRECTIONS)[1]
        moved = abs(new.q - state.q) > _TOLERANCE * model.units.nodes
        slid = abs(new.slides - state.slides) > _TOLERANCE * model.mesh.size
        if settled and not _remembers(model, state, moved, slid):
            return replace(state, q=new.q, slides=new.slides)
    _log.warning(_NOT_SETTLED)
    return state


def _remembers(model: Model, state: State, moved: np.ndarray, slid: np.ndarray) -> bool:
    """Whether what may flow at once depends on degrees of freedom or slides that have moved.

    Contacts that have not been closed have nothing to remember.
    """
    beams = (beam for beam in model.scene.beams if (m := beam.section.internal) and m.level == 1)
    dofs = (model.mesh.dofs[model.mesh.nodes_of(model.scene, beam)] for beam in beams)
    points, internal = model.points, state.spring_internal
    closed = internal is not None and internal[points.first_of_contacts :].any()
    joint_forces = (placed.force for placed in points.placed[points.first_contacts :])
    flowing = (force for force in joint_forces if force.law.internal > force.law.counters)
    places = ((slid, [f.slide]) if f.slide >= 0 else (moved, f.dofs) for f in flowing)
    points_moved = closed or any(x[i] for x, indices in places for i in indices if i >= 0)
    return bool(points_moved) or any(moved[entries].any() for entries in dofs)


def needs_accelerations(model: Model) -> bool:
    """Whether steps, or unknowns without mass, need the accelerations at the start."""
    has_mean_rates, beams = model.scheme.rates.mean_based, model.forms.beams
    read = beams is not None and (beams.facts.needs_rates or beams.facts.resultants_need_rates)
    if read or not has_mean_rates or len(model.scheme.fractions) > 1:
        return True
    return not moves_alone(model.couplings, ~fact(model, massless_dofs)).all()


def finds_accelerations_later(model: Model) -> bool:
    """Whether those at the start need not be known before the run, and depend on no joints."""
    depends_on_state = model.fits_rates or bool(model.data.natural)
    return model.couplings.is_selection and not (
        depends_on_state or fact(model, needs_accelerations)
    )


class Starts:
    """First states of motions by steps of the length dt [s].

    There may be `further` forces (size,) of an interval, a state before it, an increment, and those
    of the engine.
    """

    def __init__(
        self,
        model: Model,
        forcing: Forcing,
        dt: float,
        further: Callable[[Interval, State, np.ndarray, StepForces], np.ndarray] | None = None,
    ):
        self.model, self._forcing, self._dt, self._further = model, forcing, dt, further

    def initial(self, start: State | None = None, accelerations: bool = True) -> State:
        """State with the scene's initial velocities and the accelerations of dynamic equilibrium.

        At `start`, whose rates are kept if it turns, and projected if they are `fitted` to other
        joints; or in the reference configuration. SceneError for incompatible velocities. Without
        `accelerations` they are zero where steps do not read them.
        """
        model = self.model
        state = drawn_state(model) if start is None else start
        if start is None and model.data.natural:
            state.natural = model.data.natural.sum_at(state.t)
        if len(fact(model, led_dofs)):  # they have not moved before
            state = state.changed(q_previous=None, length=0.0)
        needed = accelerations or fact(model, needs_accelerations)
        state, unbalanced = self._moving(state, needed)
        if unbalanced:
            settled = _settled(model, state, self._loads(state)[0], self._dt)
            state, _ = self._moving(settled, needed)
        return state

    def _loads(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        return self._forcing.forces(Interval(state.t, state.t + self._dt))

    def _moving(self, state: State, accelerates: bool) -> tuple[State, bool]:
        """The state with rates and accelerations, and whether massless parts are unbalanced."""
        model, (rates, accelerations) = self.model, self._begin(state)
        if state.fitted is None:
            w, v = initial_rates(model, state, rates)
            state = state.changed(v=v)
        else:
            w = projected_rates(model, state, state.fitted, rates)
            v = model.reduction.maps.to_nodes(w)
            lost = model.masses.matrix @ (state.fitted - v)
            driven_work = -float(lost @ v) if model.couplings.driven else 0.0
            state = state.changed(v=v, work=state.work + driven_work, fitted=None)
        if (parts := len(model.scheme.fractions)) > 1:
            # The rates predict the first sub-steps: one of order 4 is longer than a step. Those
            # of order 2 are found as well without it.
            slides = model.couplings.free_slides(w[None, : model.reduction.free], len(state.slides))
            past = Past(np.zeros(1), np.ones(parts, dtype=int), state.v[None], slides)
            state = state.changed(past=past)
        if not accelerates:
            return state, False
        found, rest = self._acceleration(state, w, accelerations, self._loads(state))
        return state.changed(**found), rest

    def late_accelerations(self, state: State) -> Callable[[], np.ndarray]:
        """A function that gives the accelerations at the start, by the loads as they are now.

        For a model of which `finds_accelerations_later` is true.
        """
        loads, none = self._loads(state), np.zeros(self.model.reduction.columns)

        def accelerations() -> np.ndarray:
            self.model.forms.parameters.use(state.parameters)
            return self._acceleration(state, none, np.empty(0), loads)[0]["a"]

        return accelerations

    def resumed(self, start: State, same_scheme: bool) -> State:
        """The state itself for the same scheme, else with its velocities and new accelerations."""
        rates, accelerations = self._begin(start)
        keeps = fact(self.model, sizes_of)["kept driven"] > 0
        if same_scheme and (start.driven_forces is not None or not keeps):
            return start
        w = rates_of_columns(self.model, start, start.v, rates)
        found, _ = self._acceleration(start, w, accelerations, self._loads(start))
        # What the last step of another scheme leaves to the next one does not count.
        return start.changed(**found, parts=None, past=None).released()

    def _begin(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Set the reduction to the start; rates and accelerations (driven,) of driven motion."""
        model, forcing = self.model, self._forcing
        forcing.check_start(state)
        rates, bend = map(floats, forcing.derivatives(state.t, 1e-3 * self._dt))
        model.reduction.set_start(state.q, state.slides)
        if singularity := model.reduction.singularity:
            raise SceneError(f"start: {singularity}. Start from a position beside it")
        return rates, bend

    def _acceleration(
        self, state: State, w: np.ndarray, driven: np.ndarray, loads: tuple[np.ndarray, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], bool]:
        """Accelerations from T^T M a = T^T (F - f), with those of driven motion and of couplings.

        Those of unknowns without mass are zero. With the forces that a state keeps; and whether
        forces are left.
        """
        from fx_beam.step.equations import accelerations
        from fx_beam.step.state_vector import slide_rates, start_of

        model, reduction, dt = self.model, self.model.reduction, self._dt
        level, rated = model.scheme.rates.level, model.forms.depend_on_rates or self._further
        moves = bool(rated) and any_of(state.v)
        found: dict[str, np.ndarray] = {}
        mass, size = model.masses.matrix, abs(state.v / model.units.nodes).max()

        def internal_force(h: float) -> np.ndarray:
            """Forces that may depend on velocity: they see it as the increment over a short step.

            At its level the motion is in this state.
            """
            D, slid = moves * h * state.v, moves * h * slide_rates(model, state)
            shifted = replace(state, q=state.q - level * D, slides=state.slides - level * slid)
            start = start_of(model, shifted, h)._replace(a=np.zeros((1, model.size)))
            if (natural := state.natural) is not None:
                change = h / dt * (self._forcing.natural(state.t + dt) - natural)
                first = natural - level * change
                start = start.with_natural(first, first + change)
            forces = model.forms.begin_step(instant(state.t, h), start)
            model.forms.compiled_points.evaluate_slides(h * w)
            force = forces.internal(D)
            if not model.scheme.rates.mean_based:
                found["added_forces"] = forces.added()
            if self._further is not None:
                force += self._further(instant(state.t, h), shifted, D, forces)
            return force

        free, moved = reduction.free, slice(reduction.free, reduction.free + reduction.driven)
        a = np.zeros(reduction.columns)
        a[moved] = driven
        curved = np.zeros(model.size)
        if model.scene.joints and any_of(w):
            k = 1e-4 / size
            curved = _second_difference(model, w, k)
            if model.couplings.sliding:
                # The third derivative of a beam's curve jumps at its nodes: an error of order k.
                curved = 2 * curved - _second_difference(model, w, 2 * k)
            reduction.increment(np.zeros(free), np.zeros(reduction.driven))
        if moves and not model.kinks.flows:
            # What a scheme damps over the length of a step has the opposite sign in a step back.
            h = min(dt, INSTANT / size)
            f = (internal_force(h) + internal_force(-h)) / 2
        else:
            f = internal_force(INSTANT * dt)
        force = loads[0] - f - mass @ (reduction.maps.to_nodes(a) + curved)
        b = -reduction.maps.reduced_force(-force)[:free]
        a[:free], rest = accelerations(model, b)
        # A load that grows from zero has a little of its first step already.
        node_units, unknown_units = model.units.nodes, model.units.unknowns
        works = b * unknown_units, *(part * node_units for part in (force, *loads))
        largest = max(abs(work).max(initial=0.0) for work in works)
        left = abs(rest * unknown_units).max(initial=0.0)
        found["a"] = a = reduction.maps.to_nodes(a) + curved
        if fact(model, sizes_of)["kept driven"]:
            led, reaction = fact(model, led_dofs), f + mass @ a - loads[0]
            reaction[led] -= mass[led][:, led] @ a[led]
            found["driven_forces"] = reduction.maps.reduced_force(reaction)[moved]
        return found, bool(left > _NONE * largest)


def end_of(start: Solution) -> State:
    """Last state of a solution, with vectors numbered by nodes."""
    if not isinstance(start, Solution):
        raise SceneError(f"start must be a Solution, not {shown(start)}")
    if start.end is None:
        raise SceneError("start: the solution has no last state. Start from another solution")
    end = start.end
    if not math.isfinite(sum(getattr(end, name) for name in NUMBERS)):
        lost = next(name for name in NUMBERS if not math.isfinite(getattr(end, name)))
        raise SceneError(
            f"start: {lost} = {getattr(end, lost)} in its last state is not finite: the motion is "
            "lost there, or its file was changed. Start from an earlier time"
        )
    return end


def reference_state(model: Model, scene: Scene | None = None) -> State:
    """The reference configuration at t = 0, without natural strains; that of another scene."""
    slides = slides_at_start(scene or model.scene)
    q, v, a = np.zeros((3, model.size))
    state = State(0.0, np.zeros(len(model.data.motors)), q, v, a, slides)
    if len(model.forms.parameters):
        state.parameters = model.forms.parameters.values_at(0.0)
    shape = model.forms.internal_shape
    if shape[-1]:
        state.internal = np.zeros(shape)
    if model.points.width:
        state.spring_internal = np.zeros(model.points.width)
    if model.data.natural:
        state.natural = np.zeros((*shape[:2], 3))
    return state


def drawn_state(model: Model) -> State:
    """The reference configuration as a start; SceneError where it violates a joint."""
    state, scene = reference_state(model), model.scene
    if any(gear.value for gear in scene.gears) or any(j.place is not None for j in scene.joints):
        check_joints(model, state, "the scene as drawn")
    return state


def check_joints(model: Model, state: State, subject: str = "start: the solution") -> None:
    """Refuse a state that violates a joint."""
    pairs = zip(model.data.motors, state.motors, strict=True)
    moved = {(joint.number, name): position for (joint, name), position in pairs}
    motion = model.mesh.motion(model.scene, q=state.q[None])
    for joint in model.scene.joints:
        number, slide = joint.number, state.slides[joint.number : joint.number + 1]
        gap = float(joint.kinematics.gap(motion, slide)[0])
        if "slide" in joint.driven:
            gap += abs(float(slide[0]) - joint.start()[0] - moved[number, "slide"])
        turn = float(joint.kinematics.angle(motion, slide)[0])
        turn -= moved.get((number, "rotation"), 0.0)
        turn -= 0.0 if joint.place is None else joint.place.turn
        faults = {
            f"its nodes have a gap of {gap:.3g} m": gap / model.mesh.size,
            f"the rotation of node b deviates by {turn:.3g} rad": abs(turn) * joint.turns_together,
        }
        for fault, size in faults.items():
            if size > 1e-8:
                raise SceneError(
                    f"{subject} violates {joint}: {fault}. Start from a solution that "
                    "has this joint, or make it there: scene.add_joint(joint, at=solution)"
                )
    for gear in model.scene.gears:
        apart = float(gear.difference(motion, state.slides[None])[0])
        if gear.is_ideal and abs(apart) > 1e-8 * (1.0 if gear.column else model.mesh.size):
            raise SceneError(
                f"{subject} violates {gear}: its joints deviate by {apart:.3g}. Start from a "
                "solution that has it, or make it there: scene.add_joint(gear, at=solution)"
            )


def _second_difference(model: Model, w: np.ndarray, k: float) -> np.ndarray:
    """Accelerations (size,) at constant rates of the columns, by the motion over +-k [s]."""
    reduction = model.reduction
    free, driven = reduction.free, reduction.driven
    increments = (sign * k * w[: free + driven] for sign in (1, -1))
    ahead, back = (reduction.increment(y[:free], y[free:]) for y in increments)
    return (ahead + back) / k**2


def initial_rates(model: Model, state: State, driven: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates (columns,), and (size,), from the scene's initial velocities and from driven motion.

    SceneError if they violate a support or a joint and the scene does not project them.
    """
    scene, moves = model.scene, any_of(state.v)
    if not (moves or scene.velocities or scene.rates or any_of(driven)):
        return np.zeros(model.reduction.columns), np.zeros(model.size)
    v = state.v.copy() if moves else floats(given_velocity(model))
    project = scene.projects_velocities
    w = (projected_rates if project else rates_of_columns)(model, state, v, driven)
    if scene.rates and not moves:
        w = w + _changes_to_rates(model, state, w)
    compatible = model.reduction.maps.to_nodes(w)
    if project or (not scene.prescribed and all_of(compatible == v)):
        return w, compatible
    unit = [1.0, 1.0, 1 / model.mesh.size]
    gap = abs(compatible - v).reshape(-1, 3) / unit
    # At its own degree of freedom prescribed motion gives the rate; another one is an error.
    for key in scene.prescribed:
        gap[key] = 0.0
        initial, moved = (rates.reshape(-1, 3)[key] for rates in (v, compatible))
        if initial != 0 and abs(initial - moved) > 1e-3 * max(abs(initial), abs(moved)):
            raise SceneError(_message(model, key, v, compatible, ", or not given"))
    is_still = v[model.prescribed] == 0
    v[model.prescribed] = compatible[model.prescribed]
    # Rates of driven motion are finite differences, hence the second tolerance.
    driven_v = model.reduction.maps.to_nodes(_driven_rates(model, driven))
    speed, driven_speed = (abs(rates.reshape(-1, 3) / unit).max() for rates in (v, driven_v))
    tolerance = 1e-9 * speed + 1e-5 * driven_speed
    if gap.max() > tolerance:
        _check_joints(model, state, v, driven, tolerance)
        node, component = map(int, np.unravel_index(np.argmax(gap), gap.shape))
        raise SceneError(_message(model, (node, component), v, compatible))
    if any_of(struck := np.where(is_still, driven[: len(is_still)], 0.0)):
        w = w + _after_blow(model, struck)
        compatible = model.reduction.maps.to_nodes(w)
    return w, compatible


def _changes_to_rates(model: Model, state: State, w: np.ndarray) -> np.ndarray:
    """Least changes of rates w (columns,), in the norm of the mass, for rates of joints as set."""
    from fx_beam.step.equations import accelerations

    maps, mesh, free = model.reduction.maps, model.mesh, model.reduction.free
    joints = scene_joints.joints_by_number(model.scene)
    rates = {joints[n]: rate for n, rate in model.scene.rates.items() if n in joints}
    # The rate of each joint by those of all nodes (size,), and the changes by a unit impulse on it.
    rows, changes = np.zeros((len(rates), model.size)), np.zeros((len(rates), len(w)))
    for joint, row, change in zip(rates, rows, changes, strict=True):
        dofs = mesh.dofs[[node.number for node in (joint.a, joint.b) if node is not GROUND]].ravel()
        q, v = np.tile(state.q, (len(dofs), 1)), np.zeros((len(dofs), model.size))
        v[np.arange(len(dofs)), dofs] = 1.0
        slides = np.full(len(dofs), state.slides[joint.number])
        row[dofs] = joint.kinematics.rate(mesh.motion(model.scene, q=q, v=v), slides)
        change[:free] = accelerations(model, maps.transpose_to_nodes(row)[:free])[0]
        change[:] = maps.with_dependent(change)
    mobility = rows @ np.reshape([maps.to_nodes(change) for change in changes], rows.shape).T
    missing = [*rates.values()] - rows @ maps.to_nodes(w)
    parts = np.linalg.lstsq(mobility, missing, rcond=None)[0]
    for joint, rate, left in zip(rates, missing, abs(mobility @ parts - missing), strict=True):
        if left > 1e-8 * max(abs(rate), abs(rates[joint])):
            raise SceneError(
                f"set_rate: {joint} cannot start with the rate {rates[joint]:g}: no mass moves "
                "with it, or other rates or supports exclude it"
            )
    return parts @ changes


def _after_blow(model: Model, struck: np.ndarray) -> np.ndarray:
    """Changes of rates (columns,) of all masses where supports are given rates (prescribed,)."""
    from fx_beam.step.equations import accelerations

    maps, free, motors = model.reduction.maps, model.reduction.free, len(model.data.motors)
    blow = maps.with_dependent(_driven_rates(model, np.append(struck, np.zeros(motors))))
    momentum = maps.transpose_to_nodes(model.masses.matrix @ maps.to_nodes(blow))[:free]
    change = np.zeros_like(blow)
    change[:free] = -accelerations(model, momentum)[0]
    return maps.with_dependent(change)


def projected_rates(model: Model, state: State, v: np.ndarray, driven: np.ndarray) -> np.ndarray:
    """Rates (columns,) closest to given rates v (size,) in the norm of the mass."""
    from fx_beam.step.fitted_rates import rate_fit

    fit = rate_fit(model).fit(state.q[None], v[None], state.slides[None], driven[None])
    return rates_of_columns(model, state, fit.rates[0], driven)


def rates_of_columns(model: Model, state: State, v: np.ndarray, driven: np.ndarray) -> np.ndarray:
    """Rates (columns,) of rates v (size,) that fit the joints, with those of driven motion."""
    slides = np.zeros(len(state.slides))
    if len(driven):
        v = v.copy()
        v[model.prescribed] = driven[: len(model.prescribed)]
    for joint in model.scene.joints:
        if joint.axis is None and joint.slide is None:
            continue
        number, motion = [joint.number], model.mesh.motion(model.scene, q=state.q[None], v=v[None])
        slides[number] = joint.kinematics.rate(motion, state.slides[number])
    w = _driven_rates(model, driven)
    w[: model.reduction.free] = model.couplings.unknowns(v, slides)
    return model.reduction.maps.with_dependent(w)


def _driven_rates(model: Model, driven: np.ndarray) -> np.ndarray:
    """Rates (columns,) of driven motion; all others are zero."""
    reduction = model.reduction
    w = np.zeros(reduction.columns)
    w[reduction.free : reduction.free + reduction.driven] = driven
    return w


def given_velocity(model: Model) -> Any:
    """Initial rates (size,) as given, with slopes that the scene has; zero elsewhere."""
    mesh, scene = model.mesh, model.scene
    if not scene.velocities:
        return np.zeros(model.size)
    X = model.data.X
    values, known, arrays = np.zeros((len(X), 3)), np.zeros(len(X), dtype=bool), scene.array_calls
    slopes: Any = None
    for i, item in enumerate(scene.velocities):
        nodes = mesh.nodes_of(scene, item.target)
        x, earlier = X[nodes], values[nodes] if i else _NONE_BEFORE
        rates: Any = np.concatenate([item.value.each(x, arrays), item.spin.each(x, arrays)], axis=1)
        plain_rates, twice = floats(rates), known[nodes] if i else _NONE_BEFORE
        values[nodes], known[nodes] = plain_rates, True
        if isinstance(rates, Dual):
            slopes = np.zeros((*values.shape, rates.count)) if slopes is None else slopes
            slopes[nodes] = rates.slopes
        elif slopes is not None:
            slopes[nodes] = 0.0
        if any_of(twice) or not all_of(np.isfinite(plain_rates)):
            _check_velocities(model, mesh.X[nodes], plain_rates, earlier, twice)
    has_slopes = slopes is not None and any_of(slopes)
    return (Dual(values, slopes) if has_slopes else values).reshape(-1)


def rates_with_slopes(
    model: Model, forcing: Forcing, state: State, dt: float, numbers: dict[str, object], count: int
) -> Any:
    """Rates of a first state that fit the joints, with slopes by `count` parameters.

    The `numbers` are those of the scene.
    """
    if model.scene.rates:
        raise TypeError("rates of joints at the start have no slopes")
    rates: Any = given_velocity(model)
    driven: Any = forcing.derivatives(state.t, 1e-3 * dt)[0]
    if not (isinstance(rates, Dual) or isinstance(driven, Dual) or any_of(state.v)):
        return state.v
    rates, driven = with_slopes(rates, count), with_slopes(driven, count)
    if model.scene.joints or driven.size:
        from fx_beam.step.fitted_rates import RateDerivatives, rate_fit

        if not model.scene.projects_velocities:  # else a given rate there has its momentum
            given = np.flatnonzero(rates.values[model.prescribed])
            for source, target in ((driven.values, rates.values), (driven.slopes, rates.slopes)):
                target[model.prescribed[given]] = source[given]
        state_numbers = {"q": state.q, "v": rates, "slides": state.slides, "driven rates": driven}
        known = (numbers | state_numbers).items()
        duals = {name: with_slopes(values, count) for name, values in known}
        arrays = (duals[name].values[None] for name in state_numbers)
        fit = RateDerivatives(rate_fit(model), *arrays)
        changes = {name: np.moveaxis(dual.slopes, -1, 0) for name, dual in duals.items()}
        fitted = fit.jvp({name: changes[name][None] for name in state_numbers}, changes)
        rates.slopes = fitted["rates"][0].T
    return Dual(state.v, rates.slopes)


def _check_velocities(
    model: Model, positions: np.ndarray, rates: np.ndarray, earlier: np.ndarray, twice: np.ndarray
) -> None:
    """Refuse rates (n, 3) that are not finite, or differ from others where they are given twice."""
    unit = [1.0, 1.0, model.mesh.size]
    size = (abs(rates) * unit).max(axis=1, keepdims=True)
    infinite = ~np.isfinite(rates).all(axis=1)
    differs = twice & (abs(earlier - rates) * unit > 1e-9 * size).any(axis=1)
    for bad in np.flatnonzero(infinite | differs):
        x, y = positions[bad]
        if infinite[bad]:
            raise SceneError(
                f"initial velocity at ({x:g}, {y:g}) is {rates[bad]}; it must be finite"
            )
        raise SceneError(
            f"two initial velocities at ({x:g}, {y:g}): {earlier[bad]} and {rates[bad]}. Give "
            "only one, or equal ones"
        )


def _check_joints(
    model: Model, state: State, v: np.ndarray, driven: np.ndarray, tolerance: float
) -> None:
    """Refuse velocities that violate a joint; the message names the worst joint."""
    scene = model.scene
    motion = model.mesh.motion(model.scene, q=state.q[None], v=v[None])
    rates = driven[len(model.prescribed) :]
    motors = {(j.number, name): r for (j, name), r in zip(model.data.motors, rates, strict=True)}
    worst, text = tolerance, ""
    violated: Any
    for joint in scene.joints:
        slide = state.slides[joint.number : joint.number + 1]
        gap, axis = (part[:, 0] for part in joint.kinematics.parting_rate(motion, slide))
        turn = float(joint.kinematics.spin(motion, slide)[0])
        turn -= motors.get((joint.number, "rotation"), 0.0)
        gap = gap - motors.get((joint.number, "slide"), gap @ axis) * axis
        apart, turned = np.hypot(*gap), abs(turn) * model.mesh.size * joint.turns_together
        faults = {
            f"its nodes separate at {apart:.3g} m/s": apart,
            f"the rotation rate of node b deviates by {turn:.3g} rad/s": turned,
        }
        for fault, size in faults.items():
            if size > worst:
                worst, text, violated = size, f"{joint}: {fault}", joint
    for gear in filter(lambda gear: gear.is_ideal, scene.gears):
        rate = float(gear.rate(motion, state.slides[None])[0])
        size = abs(rate) * (model.mesh.size if gear.column else 1.0)
        if size > worst:
            worst, text, violated = size, f"{gear}: its joints deviate by the rate {rate:.3g}", gear
    for (number, part), rate in motors.items():
        if text and number == violated.number and rate:
            raise SceneError(
                f"the motor of {violated} starts with the rate {rate:.3g} of its {part}, but its "
                "nodes have other initial velocities. Give it a motion that starts at rest, or "
                "call scene.make_velocities_compatible()"
            )
    if text:
        raise SceneError(f"the initial velocities violate {text}. {_ADVICE}")


def _message(
    model: Model, key: tuple[int, int], v: np.ndarray, compatible: np.ndarray, or_none: str = ""
) -> str:
    """Message on a rate (node, component) that cannot be."""
    node, component = key
    rate_given, needed = (rates.reshape(-1, 3)[key] for rates in (v, compatible))
    node_name, component_name = model.mesh.named(node, model.scene), COMPONENTS[component]
    for kind, keys in (("supported", model.scene.fixed), ("moved", model.scene.prescribed)):
        if key in keys:
            return (
                f"{node_name} is {kind} in {component_name}, but its initial rate there is "
                f"{rate_given:g}; it must be {needed:g}{or_none}"
            )
    return (
        f"the initial velocities violate a support: the rate of {component_name} of {node_name} is "
        f"{rate_given:g}; it must be {needed:g}. {_ADVICE}"
    )


# -- The last state of a solution, carried over to a scene that may have changed since ----------


# In the place of rows: of the ground, whose number in `JointKey` this is, and of new nodes.
_GROUND, _NEW = -1, -2
# What goes on as it is.
_GOES_ON = "work", "dissipated", "numerical", "impact", "inputs", "input_names"


def scene_has_changed(model: Model, start: Solution) -> bool:
    """Whether members, joints, supports, contacts or springs are others than in a solution."""
    end, X, scene = end_of(start), model.mesh.X, model.scene
    if start.X.shape != X.shape or (start.X != X).any():
        return True
    members = [part.name for part in scene.beams], [part.name for part in scene.bodies]
    has, had = ([(str(o), o.along, o.variables) for o in s.contacts] for s in (scene, start))
    if members != ([*start.beams], [*start.bodies]) or has != had:
        return True
    if end.owners is not None:
        earlier, current = ([*map(_numbered, names)] for names in (end.owners, model.points.owners))
        if earlier != current:
            return True
    if end.constraints is None:  # a solution that is no run
        return len(end.slides) != scene.joint_count or len(end.motors) != len(model.data.motors)
    return end.constraints != scene_joints.constraints_of(scene)


class TransferredState:
    """A scene that has changed, and the solution that it goes on from.

    Members and joints are known by their names and nodes. Those that are new are as at the start.
    """

    def __init__(self, model: Model, start: Solution):
        self._model, self._start, self._end = model, start, end_of(start).released()
        #: Row (n_node,) of each node in the solution, or `_NEW`.
        self._rows = self._rows_of_nodes()
        #: Joints of the solution, and by the numbers of the same joints of the scene.
        self._had = (self._end.constraints or Constraints()).joints
        self._joints = self._joints_before()

    def state(self) -> State:
        """The state of the scene, before its rates are made to fit; it has no past."""
        model, end = self._model, self._end
        nodal, slides = self._at_nodes(), slides_at_start(model.scene)
        self._check_new_beams(nodal["q"].reshape(-1, 3))
        motion = model.mesh.motion(model.scene, q=nodal["q"][None])
        for joint in model.scene.joints:
            old, slide = self._joints.get(joint.number), slides[joint.number : joint.number + 1]
            slide[:] = (
                joint.kinematics.slide(motion, slide) if old is None else end.slides[old.number]
            )
        return State(
            end.t,
            self._motors(slides, motion),
            a=np.zeros(model.size),
            slides=slides,
            internal=self._internal(),
            natural=self._natural(),
            spring_internal=self._spring_internal(),
            **{name: getattr(end, name) for name in _GOES_ON},
            **nodal,
        )

    # -- Nodes and beams ------------------------------------------------------------------------

    def _rows_of_nodes(self) -> np.ndarray:
        mesh, scene, start = self._model.mesh, self._model.scene, self._start
        rows = np.full(len(mesh.X), _NEW)
        pairs = [
            (f"beam {beam.name!r}", nodes, start.nodes_of_beam[beam.name])
            for beam, nodes in zip(scene.beams, mesh.nodes, strict=True)
            if beam.name in start.nodes_of_beam
        ]
        for body in scene.bodies:
            if body.name in start.bodies:
                twins = body, start.bodies[body.name]
                mine, old = (np.array([node.number for node in twin.nodes]) for twin in twins)
                pairs.append((f"body {body.name!r}", mine, old))
        advice = "Use the same beams and elements; a new member needs another name"
        if not pairs:
            raise SceneError(f"start: the solution has other nodes than the scene. {advice}")
        for member, mine, old in pairs:
            if len(mine) != len(old) or (mesh.X[mine] != start.X[old]).any():
                raise SceneError(
                    f"start: the solution has other nodes than the scene for {member}. {advice}"
                )
            rows[mine] = old
        # Nodes of no member: of those that are gone, and between a support and what slides.
        body_nodes = [node.number for body in scene.bodies for node in body.nodes]
        count = min(len(start.X), len(rows))
        for number in {*range(count)} - set(body_nodes).union(*map(np.ndarray.tolist, mesh.nodes)):
            if (start.X[number] == mesh.X[number]).all():
                rows[number] = number
        return rows

    def _at_nodes(self) -> dict[str, Any]:
        """Configuration and rates (size,), with those that new nodes are given."""
        end, known = self._end, self._rows >= 0
        rates, nodal = end.v if end.fitted is None else end.fitted, dict[str, Any]()
        for name, values in (("q", end.q), ("v", end.v), ("fitted", rates), ("loads", end.loads)):
            if values is not None:
                nodal[name] = np.where(known[:, None], values[self._rows], 0.0).ravel()
        if self._start.stats.static:  # the motion begins with the initial velocities of the scene
            nodal.pop("fitted")
        elif not known.all():
            new_rates = np.repeat(~known, 3) * floats(given_velocity(self._model))
            nodal["v"] += new_rates
            nodal["fitted"] += new_rates
        return nodal

    def _check_new_beams(self, moved: np.ndarray) -> None:
        """Refuse new beams at nodes that have moved: their other nodes are in the reference."""
        mesh = self._model.mesh
        for beam, nodes in zip(self._model.scene.beams, mesh.nodes, strict=True):
            if beam.name in self._start.nodes_of_beam:
                continue
            far = np.hypot(*moved[nodes, :2].T) + mesh.size * abs(moved[nodes, 2])
            worst = int(np.argmax(far))
            if far[worst] > 1e-8 * mesh.size:
                u, v, psi = moved[nodes[worst]]
                raise SceneError(
                    f"start: {beam!r} is new, but its node {nodes[worst]} has moved by "
                    f"({u:.3g}, {v:.3g}) and turned by {psi:.3g} rad, so that it would be "
                    "strained. Give it nodes of its own where that node is, and a joint"
                )

    def _beams(self) -> Iterator[tuple[Beam, Any, slice]]:
        """Beams that the solution has, with their elements in the scene and there."""
        beams = self._start.beams
        ends = dict(zip(beams, accumulate(beam.elements for beam in beams.values()), strict=True))
        for beam, cells in zip(self._model.scene.beams, self._model.mesh.cells, strict=True):
            if (end := ends.get(beam.name)) is not None:
                yield beam, cells, slice(end - beams[beam.name].elements, end)

    def _internal(self) -> np.ndarray | None:
        """Internal variables at the Gauss points; those of new beams are zero."""
        shape = self._model.forms.internal_shape
        if not shape[-1]:
            return None
        values, old = np.zeros(shape), self._end.internal
        for beam, cells, start_cells in self._beams():
            names = [] if beam.section.internal is None else [*beam.section.internal.names]
            if not names:
                continue
            has = self._start.variables_of_beam.get(beam.name, {})
            known = [name for name in has if name not in NAMES.values()]
            if old is None or known != names:
                raise SceneError(
                    "start: the solution has other internal variables than the sections of the "
                    f"scene: beam {beam.name!r} has {names}, there it has {known}"
                )
            values[cells, :, : len(names)] = old[start_cells, :, : len(names)]
        return values

    def _natural(self) -> np.ndarray | None:
        """Natural strains at the Gauss points; of new beams the values at this time."""
        if not self._model.data.natural:
            return None
        values, old = self._model.data.natural.sum_at(self._end.t), self._end.natural
        for _, cells, start_cells in self._beams():
            values[cells] = 0.0 if old is None else old[start_cells]
        return values

    # -- Joints and contacts --------------------------------------------------------------------

    def _joints_before(self) -> dict[int, JointKey]:
        keys: dict[tuple, list[JointKey]] = {}
        for key in self._had:
            keys.setdefault((key.kind, key.a, key.b), []).append(key)
        matches, rows = {}, [*self._rows.tolist(), _GROUND]
        for joint in self._model.scene.joints:
            mine = key_of(joint)
            if twins := keys.get((mine.kind, rows[mine.a], rows[mine.b])):
                twin = next((key for key in twins if key.number == joint.number), twins[0])
                if joint.place is not None and twin.number != joint.number:
                    continue  # it is made anew
                twins.remove(twin)
                matches[joint.number] = twin
        return matches

    def _motors(self, slides: np.ndarray, motion: Any) -> np.ndarray:
        """How far motors have moved; new ones are where their joints are."""
        motors = self._model.data.motors
        moved = np.zeros(len(motors))
        before = [(key.number, name) for key in self._had for name in key.motors]
        places = {motor: i for i, motor in enumerate(before)}
        for i, (joint, name) in enumerate(motors):
            old, number = self._joints.get(joint.number), joint.number
            place = None if old is None else places.get((old.number, name))
            if place is not None:
                moved[i] = self._end.motors[place]
            elif name == "slide":
                moved[i] = slides[number] - joint.start()[0]
            else:
                moved[i] = float(joint.kinematics.angle(motion, slides[number : number + 1])[0])
        return moved

    def _contacts_before(self) -> dict[str, str]:
        """Contact of the scene -> its twin in the solution, or "", by their texts."""
        left, matches = list(self._start.contacts), dict[str, str]()
        for contact in self._model.scene.contacts:
            key = _contact_key(contact, lambda node: int(self._rows[node.number]))
            twins = [twin for twin in left if _contact_key(twin, lambda node: node.number) == key]
            matches[str(contact)] = ""
            if twins:
                mine = contact.shape, contact.number
                best = max(twins, key=lambda twin: (twin.shape == mine[0], twin.number == mine[1]))
                left.remove(best)
                matches[str(contact)] = str(best)
        return matches

    def _spring_internal(self) -> np.ndarray | None:
        """Internal variables of contacts and springs; zero for new contacts and springs."""
        points, end = self._model.points, self._end
        if not points.width:
            return None
        values, columns_of = np.zeros(points.width), dict[str, list[int]]()
        for column, owner in enumerate([] if end.owners is None else end.owners.tolist()):
            columns_of.setdefault(_numbered(owner), []).append(column)
        for joint in self._model.scene.joints:
            if (key := self._joints.get(joint.number)) is not None:
                had = self._start.variables_of_joint.get(key.number, {})
                if [*joint.internal] != [*had]:
                    raise SceneError(
                        "start: the solution has other internal variables than the springs of the "
                        f"scene: {joint} has {[*joint.internal]}, there it has {[*had]}"
                    )
        contacts = self._contacts_before()
        for column, owner in enumerate(points.owners.tolist()):
            kind, *words = owner.split(" ")
            if kind == "joint":  # which may have had another number
                key = self._joints.get(int(words[0]))
                owner = "" if key is None else " ".join([kind, str(key.number), *words[1:]])
            owner = contacts.get(owner, owner)
            if end.spring_internal is not None and (columns := columns_of.get(_numbered(owner))):
                values[column] = end.spring_internal[columns.pop(0)]
        return values


def _numbered(owner: str) -> str:
    """Owner of an internal variable, by its number: a fixed point, in the text, may have moved."""
    return owner.split(",")[0]


def _contact_key(contact: Contact, number_of: Callable[[Node], int]) -> tuple:
    """Pairs that touch; members by their names, nodes by their numbers in the solution."""
    shape, target = contact.shape, contact.target
    carrier = None if isinstance(shape, Beam) else shape.carrier
    touched = shape.name if isinstance(shape, Beam) else type(shape).__name__
    touching = target.name if isinstance(target, Beam) else number_of(target)
    moved_by = None if carrier is None else number_of(carrier)
    return touching, touched, moved_by, contact.along, contact.variables
