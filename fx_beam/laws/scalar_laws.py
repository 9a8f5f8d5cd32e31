"""Forces on a coordinate in UFL: springs, dampers, friction, contact, and what evolves in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from fx_beam.scene.law import (
    Energy,
    InternalVariables,
    evolution_loss,
    evolved,
    is_quadratic,
    slope,
    switches,
)
from fx_beam.symbolic import Expr, ufl

from .point_laws import (
    REMEMBERED,
    CoordinateKind,
    ForceStep,
    LawForces,
    PointLaw,
    Slip,
    StepCoordinate,
    clipped,
    smooth_sign,
)

# Shortest path, relative to the coordinates, over which the force is the quotient of energy and
# path. On a shorter one round-off of the energy exceeds the error of the force in its middle.
_SHORT = 6e-6

# In equilibrium a contact slips that is so close to its limit: in the state where its slip ended,
# round-off would decide.
_LIMIT_MARGIN = 1e-9
# A smaller friction [N] is none.
_OPEN = 1e-100


class _Step(NamedTuple):
    """A coordinate over a step, and the numbers of its force."""

    motion: ForceStep
    x: StepCoordinate
    numbers: Sequence[Expr]
    #: In contact with friction the slip.
    slip: Slip | None
    #: This step with a coordinate and slip without derivatives.
    still: Any = None

    @property
    def rate(self) -> Expr:
        """Rate of the coordinate at the scheme's level."""
        return self.motion.rate_at_level(self.x.rate, self.mean)

    @property
    def mean(self) -> Expr:
        """Mean rate of the coordinate over the step."""
        return self.motion.mean_rate(self.x.path)

    def sign(self, speed: Expr) -> tuple[Expr, list[Expr]]:
        """The smooth sign of the rate, and what the next iteration remembers."""
        still = self.still.rate / speed
        return smooth_sign(self.rate / speed, still, self.motion.iteration_memory[:REMEMBERED])

    def forces(
        self, elastic: Expr = 0.0, other: Expr = 0.0, friction: Expr = 0.0, **memory: Sequence[Expr]
    ) -> LawForces:
        """A force with a potential and another one, both against an increase of the coordinate.

        With a slip also the friction against it; and what `LawForces` has besides.
        """
        pairs = zip(self.x.along, self.x.across, strict=True)
        total = [elastic * a + other * b for a, b in pairs]
        if self.slip is not None:
            total = [force + friction * c for force, c in zip(total, self.slip.along, strict=True)]
        return LawForces(total, pull=elastic + other, **memory)


def _point_law(
    kind: CoordinateKind,
    name: str,
    numbers: int,
    forces: Callable[[_Step], LawForces],
    energy: Callable[[_Step], Expr] | None = None,
    loss: Callable[[_Step], Expr] | None = None,
    switches: Callable[[_Step], list] | None = None,
    side: int = 1,
    **options: Any,
) -> PointLaw:
    """A law on a kind of coordinate; numbers: of the coordinate, then of the law.

    Its pull is on a side of the coordinate: -1 if it is against a decrease.
    """

    def motion_function(function: Callable[[_Step], Expr]) -> Callable[[ForceStep], Expr]:
        return lambda motion: function(step(motion))

    def step(motion: ForceStep) -> _Step:
        kind_numbers, law_numbers = motion.numbers[: kind.numbers], motion.numbers[kind.numbers :]
        cases = [(motion, D, kind_numbers) for D in (motion.increment, motion.still)]
        moving, still = (
            _Step(motion, kind.coordinate(*case), law_numbers, kind.slip and kind.slip(*case))
            for case in cases
        )
        return moving._replace(still=still)

    def with_counters(motion: ForceStep) -> LawForces:
        given = forces(here := step(motion))
        return given._replace(internal=[*given.internal, *here.x.counters])

    pull = motion_function(lambda step: side * forces(step).pull)
    options["internal"] = options.get("internal", 0) + kind.counters
    return PointLaw(
        f"{name} on {kind.name}",
        kind.size,
        kind.numbers + numbers,
        with_counters,
        energy and motion_function(energy),
        loss and motion_function(loss),
        switches and motion_function(switches),
        pull=pull if kind.is_line else None,
        counters=kind.counters,
        **options,
    )


# -- Springs ------------------------------------------------------------------------------------


def spring(kind: CoordinateKind, damped: bool) -> PointLaw:
    """A linear spring; numbers: stiffness, rest, and viscosity if it is `damped`."""

    def forces(step: _Step) -> LawForces:
        k, rest, *c = step.numbers
        stretch = step.motion.at_level(step.x.start, step.x.end - step.x.start) - rest
        return step.forces(k * stretch, c[0] * step.rate if damped else 0.0)

    def energy(step: _Step) -> Expr:
        k, rest, *_ = step.numbers
        stretch = step.x.start - rest
        return k / 2 * stretch * stretch

    def loss(step: _Step) -> Expr:
        return step.numbers[2] * step.mean * step.x.path

    return _point_law(kind, "spring", 2 + damped, forces, energy, loss if damped else None)


def stored_energy(
    kind: CoordinateKind, energy: Energy, internal: InternalVariables | None, is_bed: bool
) -> PointLaw:
    """A spring with a stored energy, a function of the coordinate since its rest.

    Numbers: rest, and of a bed, whose energy is per length, the length.
    """
    count, level = (len(internal.names), internal.level) if internal else (0, 1.0)

    def stored(x: Expr, a: Expr) -> Expr:
        return energy(x, a) if internal else energy(x)

    def ends(step: _Step) -> tuple[Expr, Expr]:
        rest = step.numbers[0]
        return step.x.start - rest, step.x.end - rest

    def on_length(step: _Step, value: Expr) -> Expr:
        return step.numbers[1] * value if is_bed else value

    def variables(step: _Step) -> tuple[Expr, Expr, Expr]:
        """Internal variables at both ends of the step, and shortly after its start."""
        x0, x1 = ends(step)
        old = ufl.as_vector(step.motion.internal[:count] or [0.0])
        if not internal or step.motion.rule.instant:
            return old, old, old
        return evolved(internal, old, (x0,), (x1,), step.motion.dt, step.motion.rule.at_rest)

    def forces(step: _Step) -> LawForces:
        x0, x1 = ends(step)
        old, new, _ = variables(step)
        level = step.motion.rule.level
        if level == 0.5:
            mean = _discrete_gradient(lambda x: stored(x, (old + new) / 2), x0, x1)
        else:
            start = slope(lambda x: stored(x, old), x0)
            end = slope(lambda x: stored(x, new), x1)
            mean = (1 - level) * start + level * end
        return step.forces(on_length(step, mean), internal=[new[i] for i in range(count)])

    def loss(step: _Step) -> Expr:
        strains = [(x,) for x in ends(step)]
        return evolution_loss(energy, level, variables(step), strains, step.motion.rule.at_rest)

    return _point_law(
        kind,
        "stored energy",
        1 + is_bed,
        forces,
        lambda step: on_length(step, stored(ends(step)[0], variables(step)[0])),
        loss if internal else None,
        None if internal else lambda step: switches(energy(ends(step)[0])),
        internal=count,
        user_defined=True,
        needs_line_search=True,
        zero_advice="Spring: at its rest the force, its derivative and the internal variables must "
        "be finite. Write ufl.sqrt(x**2 + 1e-12) for abs(x), for example"
        if kind.starts_at_zero
        else "",
    )


def _discrete_gradient(energy: Callable[[Expr], Expr], x0: Expr, x1: Expr) -> Expr:
    """Force whose work over the step is the increment of the energy."""
    middle = slope(energy, (x0 + x1) / 2)
    if is_quadratic(energy):
        return middle
    path = x1 - x0
    long_enough = ufl.gt(abs(path), _SHORT * (abs(x0) + abs(x1)))
    quotient = (energy(x1) - energy(x0)) / ufl.conditional(long_enough, path, 1)
    return ufl.conditional(long_enough, quotient, middle)


# -- Dampers and friction -----------------------------------------------------------------------


def damper_law(kind: CoordinateKind, law: Callable[[Expr], Expr]) -> PointLaw:
    """A damper with a law of its own."""
    return _point_law(
        kind,
        "law of a damper",
        0,
        lambda step: step.forces(other=law(step.rate)),
        loss=lambda step: law(step.mean) * step.x.path,
        user_defined=True,
        zero_advice="Damper: law at the rate 0 and its derivative must be finite. Write "
        "ufl.sqrt(rate**2 + 1e-4) for abs(rate), for example",
    )


def friction(kind: CoordinateKind, magnitude: Callable[[Expr], Expr] | None = None) -> PointLaw:
    """Coulomb's friction, regularised: F tanh(rate / speed); numbers: speed, F.

    Or only the speed, with a `magnitude` F(rate).
    """

    def force(step: _Step, rate: Expr) -> Expr:
        return step.numbers[1] if magnitude is None else magnitude(rate)

    def forces(step: _Step) -> LawForces:
        sign, memory = step.sign(step.numbers[0])
        return step.forces(other=force(step, step.rate) * sign, iteration_memory=memory)

    def loss(step: _Step) -> Expr:
        return force(step, step.mean) * ufl.tanh(step.mean / step.numbers[0]) * step.x.path

    options: dict[str, Any] = {"iteration_memory": REMEMBERED, "loss": loss}
    if magnitude is None:
        return _point_law(kind, "friction", 2, forces, **options)
    return _point_law(kind, "friction", 1, forces, user_defined=True, **options)


def joint_friction(kind: CoordinateKind) -> PointLaw:
    """Friction that sticks, of a joint under its own force; numbers: tau, limit of unit force, kt.

    Internal variables: stretch and slip as in a contact, and the force, with which the step is
    repeated until it is that of the step (follow_forces).
    """

    def slips(step: _Step) -> tuple[_Step, Expr]:
        still, step = (s._replace(slip=Slip(s.x.path, s.x.across)) for s in (step.still, step))
        N = step.motion.internal[2]
        return step._replace(still=still), ufl.conditional(ufl.gt(N, 0), N, 0.0)

    def forces(step: _Step) -> LawForces:
        step, N = slips(step)
        friction, internal, memory = _sticking(step, N, N)
        internal = [*internal, step.motion.internal[2]]
        return step.forces(friction=friction, internal=internal, iteration_memory=memory)

    return _point_law(
        kind,
        "friction that sticks",
        3,
        forces,
        lambda step: _bristle_energy(step, step.motion.internal[0]),
        lambda step: _lost_to_friction(*slips(step)),
        internal=3,
        iteration_memory=REMEMBERED,
        has_stick_state=True,
    )


# -- Ropes --------------------------------------------------------------------------------------


def rope(
    kind: CoordinateKind,
    stiffness: Expr,
    length: Expr,
    law: Callable[[Expr], Expr] | None = None,
    friction: float | Callable[[Expr], Expr] | None = None,
) -> PointLaw:
    """A rope that pulls beyond a length, with what resists its rate while it is taut.

    Numbers: viscosity; of friction, which may be a function of the rate, its speed and F.
    """
    # The tension is max(0, T + s D): s is the taut share of the lengthening, so that D does work on
    # the stretch e alone. T = k s (e0 + e1) / 2 is stored, and the loss is not negative.

    def elastic(step: _Step, level: float) -> tuple[Expr, Expr]:
        """The stored part of the tension at a level, and the share of the step that is taut."""
        x0, x1 = step.x.start - length, step.x.end - length
        e0, e1 = _depth(-x0), _depth(-x1)
        crosses, taut = ufl.lt(x0 * x1, 0), ufl.conditional(ufl.gt(e0 + e1, 0), 1.0, 0.0)
        quotient = (e1 - e0) / ufl.conditional(crosses, x1 - x0, 1.0)
        share = ufl.conditional(crosses, quotient, taut)
        stretch = share * (e0 + e1) / 2 if level == 0.5 else (1 - level) * e0 + level * e1
        return stiffness * stretch, share

    def resistance(step: _Step, rate: Expr, sign: Expr) -> Expr:
        """What resists a rate of the rope while it is taut."""
        force = step.numbers[0] * rate
        if law is not None:
            force += law(rate)
        if friction is not None:
            force += sign * (friction(rate) if callable(friction) else step.numbers[2])
        return force

    def tension(stored: Expr, share: Expr, resisting: Expr) -> Expr:
        total = stored + share * resisting
        return ufl.conditional(ufl.gt(total, 0), total, 0.0)

    def forces(step: _Step) -> LawForces:
        sign, memory = (0.0, []) if friction is None else step.sign(step.numbers[1])
        resisting = resistance(step, step.rate, sign)
        pull = tension(*elastic(step, step.motion.rule.level), resisting)
        return step.forces(pull, iteration_memory=memory)

    def energy(step: _Step) -> Expr:
        stretch = _depth(length - step.x.start)
        return stiffness / 2 * stretch * stretch

    def loss(step: _Step) -> Expr:
        sign = 0.0 if friction is None else ufl.tanh(step.mean / step.numbers[1])
        stored, share = elastic(step, 0.5)
        resisting = resistance(step, step.mean, sign)
        return (tension(stored, share, resisting) - stored) * step.x.path

    return _point_law(
        kind,
        "rope",
        1 if friction is None else 3,
        forces,
        energy,
        loss,
        lambda step: [step.x.start - length],
        iteration_memory=0 if friction is None else REMEMBERED,
        user_defined=True,
        needs_line_search=True,
    )


# -- Forces of a user ---------------------------------------------------------------------------


def pull(kind: CoordinateKind, force: Callable[[Expr, Expr, Expr], Expr]) -> PointLaw:
    """A force against an increase, from the coordinate, its rate and time; number: load factor."""

    def forces(step: _Step) -> LawForces:
        motion, x, (factor,) = step.motion, step.x, step.numbers
        place = motion.at_level(x.start, x.end - x.start)
        return step.forces(other=factor * force(place, step.rate, motion.t))

    return _point_law(kind, "force", 1, forces, user_defined=True)


# -- Contact ------------------------------------------------------------------------------------


class _OneSided(NamedTuple):
    """Contact on a gap, or with a sign on the distance of a coordinate from its limit."""

    loses: bool
    sticks: bool
    sign: int
    energy: Energy | None

    def gap(self, step: _Step) -> _Step:
        """The step of the gap, without the limit among its numbers."""
        if not self.sign:
            return step
        *numbers, limit = step.numbers
        still = step.still and self.gap(step.still)
        return step._replace(x=step.x.beyond(limit, self.sign), numbers=numbers, still=still)

    def unit(self, depth: Expr) -> Expr:
        """The stored energy over the first number, zero at the surface."""
        if self.energy is None:
            return depth * depth / 2
        return self.energy(depth) - self.energy(ufl.as_ufl(0.0))

    def push(self, step: _Step, level: float | None = None) -> Expr:
        """The part of the force that is stored, against a closing."""
        level = step.motion.rule.level if level is None else level
        return step.numbers[0] * _mean_push(self.unit, step.x, level, self.energy is None)

    def damping(self, step: _Step, level: float | None = None) -> Expr:
        """The part of the force that takes energy, against an opening."""
        _, r, speed, *_ = step.numbers
        return r * self.push(step, level) * ufl.tanh(step.mean / speed)

    def forces(self, step: _Step) -> LawForces:
        """Forces against the motion, with internal variables and iteration memory."""
        step = self.gap(step)
        normal, other = self.push(step), ufl.as_ufl(0.0)
        memory: list[Expr] = []
        if self.loses:
            _, r, speed, *_ = step.numbers
            direction, memory = step.sign(speed)
            other = r * normal * direction
        if not self.sticks:
            return step.forces(-normal, other, iteration_memory=memory)
        still_normal = self.push(step.still)
        if self.loses:
            still_normal -= self.damping(step.still)
        friction, internal, stick_memory = _sticking(step, normal - other, still_normal)
        return step.forces(
            -normal, other, friction, internal=internal, iteration_memory=[*memory, *stick_memory]
        )

    def stored(self, step: _Step) -> Expr:
        """Energy at the start of the step."""
        step = self.gap(step)
        depth = _depth(step.x.start)
        energy = step.numbers[0] * ufl.conditional(ufl.gt(depth, 0), self.unit(depth), 0.0)
        return energy + _bristle_energy(step, step.motion.internal[0]) if self.sticks else energy

    def loss(self, step: _Step) -> Expr:
        """Energy lost by the mean force over the step: at an end it would be of first order."""
        step = self.gap(step)
        total = self.damping(step, 0.5) * step.x.path if self.loses else ufl.as_ufl(0.0)
        if not self.sticks:
            return total
        normal = self.push(step) - self.damping(step) if self.loses else self.push(step)
        return total + _lost_to_friction(step, normal)


def contact(
    kind: CoordinateKind, loses: bool = False, energy: Energy | None = None, sign: int = 0
) -> PointLaw:
    """A one-sided spring on a gap, k g^2 / 2 where g < 0, or k times an energy of the depth.

    Number: k. If it `loses` energy, the force is k <-g> (1 + r tanh(-rate / speed)); numbers: k, r,
    speed. If the kind has a slip, there is friction that sticks; more numbers: tau, mu and the
    stiffness kt. With a `sign` it is the stop of a coordinate at its lower (1) or upper (-1) limit,
    which is the last number.
    """
    sticks = kind.slip is not None
    law = _OneSided(loses, sticks, sign, energy)
    name = "contact" if energy is None else "law of contact"
    return _point_law(
        kind,
        f"stop {sign}" if sign else name,
        (3 if loses else 1) + 3 * sticks + bool(sign),
        law.forces,
        law.stored,
        law.loss if loses or sticks else None,
        lambda step: [law.gap(step).x.start],
        sign or 1,
        internal=2 * sticks,
        iteration_memory=REMEMBERED * (loses + sticks),
        user_defined=energy is not None,
        unilateral=True,
        has_stick_state=sticks,
    )


def _sticking(step: _Step, normal: Expr, still_normal: Expr) -> tuple[Expr, list[Expr], list[Expr]]:
    """Friction of a contact against its slip, internal variables at the end, iteration memory.

    A spring along the surface, of stiffness kt and viscosity kt tau, has a force of at most mu
    times the normal force. Variables: its stretch z, and the slip since the contact closed.
    `still_normal` is the normal force without derivatives.
    """
    assert step.slip is not None
    tau, mu, stiffness = step.numbers[-3:]
    start, slipped = step.motion.internal[:2]
    rule = step.motion.rule
    edge = 1 - _LIMIT_MARGIN if rule.at_rest or rule.instant else 1.0
    # The force is kt (z0 + part Dz): at the scheme's level with the viscosity, or at the end.
    part = rule.level + tau / step.motion.dt
    if rule.at_rest:
        part = ufl.as_ufl(1.0)
    elif not rule.instant:  # else derivatives are sought, of the viscosity alone
        part = ufl.conditional(ufl.gt(part, 1), part, 1.0)

    def ratio(path: Expr, limit: Expr) -> Expr:
        return stiffness * (start + part * path) / ufl.conditional(ufl.gt(limit, _OPEN), limit, 1.0)

    limit, still_limit = mu * normal * step.slip.normal, mu * still_normal * step.still.slip.normal
    x, still = ratio(step.slip.path, limit), ratio(step.still.slip.path, still_limit)
    if rule.instant:  # what is at its limit slips, also if round-off leads back
        unmoved = ratio(0.0, still_limit)
        still = ufl.conditional(ufl.gt(abs(unmoved), abs(still)), unmoved, still)
    bounded, iteration_memory = clipped(x, still, step.motion.iteration_memory[-REMEMBERED:], edge)
    friction = ufl.conditional(ufl.gt(limit, _OPEN), limit * bounded, 0.0)
    end = start + (friction / stiffness - start) / part
    # At rest its spring holds no more than the limit: what it lags behind a falling one is lost.
    most = ufl.conditional(ufl.gt(limit, _OPEN), limit / stiffness, 0.0)
    end = ufl.conditional(ufl.gt(abs(end), most), most * ufl.sign(end), end)
    path = slipped + step.slip.path - (end - start)
    return friction, [end, ufl.conditional(ufl.gt(normal, 0), path, 0.0)], iteration_memory


def _lost_to_friction(step: _Step, normal: Expr) -> Expr:
    """Work of the friction that its spring does not store; with the mean force in statics."""
    assert step.slip is not None
    friction, (end, _), _ = _sticking(step, normal, normal)
    start = step.motion.internal[0]
    if step.motion.rule.at_rest:
        start_force = step.numbers[-1] * start
        lost = (start_force + friction) / 2 * (step.slip.path - (end - start))
        return ufl.conditional(ufl.gt(lost, 0), lost, 0.0)
    return friction * step.slip.path + _bristle_energy(step, start) - _bristle_energy(step, end)


def _bristle_energy(step: _Step, stretch: Expr) -> Expr:
    return step.numbers[-1] / 2 * stretch * stretch


def _depth(gap: Expr) -> Expr:
    return ufl.conditional(ufl.lt(gap, 0), -gap, 0.0)


def _mean_push(energy: Callable, gap: StepCoordinate, level: float, linear: bool) -> Expr:
    """Force at a level; at mid-step its work over the step is the change of the stored energy.

    For k depth^2 / 2 it is a convex function of the gap at the end, with a continuous slope.
    """
    g0, g1 = gap.start, gap.end
    if level != 0.5:
        depth = _depth(g0 + level * (g1 - g0))
        return ufl.conditional(ufl.gt(depth, 0), slope(energy, depth), 0.0)
    depth0, depth1 = _depth(g0), _depth(g1)
    # The part of the way behind the obstacle.
    depth_sum, crosses = depth0 + depth1, ufl.lt(g0 * g1, 0)
    part = ufl.conditional(crosses, depth_sum / ufl.conditional(crosses, abs(g1 - g0), 1.0), 1.0)
    push = part * _discrete_gradient(energy, depth0, depth1)
    # Only a linear force is zero by itself where nothing touches.
    return push if linear else ufl.conditional(ufl.gt(depth_sum, 0), push, 0.0)
