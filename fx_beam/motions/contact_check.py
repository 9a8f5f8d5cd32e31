"""Warnings: points deep in a circle, impacts in few steps, sharp bends, too few elements."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import Failure, StepError, as_float, is_number, warn_once
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Circle, Contact, arc_of, nearest
from fx_beam.scene.coordinate import Coordinate, Stop
from fx_beam.scene.forces_between import ForceBetween, RopeSpring
from fx_beam.scene.gears import Gear
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import label
from fx_beam.scene.scene import Scene

_log = logging.getLogger("fx_beam")
# Depth in a circle, relative to its radius, from which its force says little. A way that comes
# nearer to the centre than this part of the distance at both ends, and of that at which contact
# begins, goes through the circle.
_DEEP, _THROUGH = 0.5, 0.95
# Distance of points of a member, relative to the radius of a wheel, from which it bumps from one to
# the next: 1/12 costs 1 % of the way down a slope, 1/7 4 %. So many it must have passed.
_SPACING, _PASSED = 1 / 10, 4
# Points of all rows that are looked at together.
_AT_ONCE = 20_000
# Steps that an impact needs: 10, or 6 / (e + 0.2) if the restitution e asks for more. Impacts that
# are slower than 10 times the speed below which the loss is viscous do not count.
_STEPS, _OF_LOSS, _FAST = 10, 6.0, 10.0
# Restitution of a plastic impact; stiffness of friction, relative to its contact, from which
# what sticks does so at once (3 % of the spin of a rimless wheel); part of the limit below which it
# sticks, and of the normal force, and of the depth, from which its force and way matter.
_PLASTIC, _STIFFER, _STUCK, _ALONG = 0.1, 30.0, 0.98, 0.05
# Part of the largest motion in a step towards a contact, below which one is no impact.
_OF_FASTEST = 1e-2
# Part of the largest force of a joint along its slide, or moment, that is round-off; and of the
# force in a step, as guides turn in it.
_NO_FORCE, _ACROSS = 1e-9, 0.05
# Arc of a rope on a pulley, below zero, at which it has left it [rad].
_LIFTED = 1e-6
# Both half thicknesses, relative to the radius of curvature, from which bends are sharp.
_SHARP = 0.95
# Nodes of all rows that are looked at together.
_NODES_AT_ONCE = 200_000
# Angle by which a straight element may bend between its ends [rad], and rows that are looked at.
# One that is bent to an arc by 0.5 rad misplaces its end by 0.8 % of its length, as the square.
_BENT, _ROWS = 0.5, 16


def warn_of_places(solution: Solution, scene: Scene) -> None:
    """Warn of contact where its forces say little; StepError as of `check_ropes`."""
    _warn_of_depth(solution)
    _warn_of_bumps(solution)
    has_all_steps = len(solution.t) == solution.stats.steps + 1 > 2
    if has_all_steps and not solution.stats.static:
        _warn_of_short_impacts(solution, scene)
        _warn_of_hits_at_once(solution, scene)
        _warn_of_soft_landings(solution)
    warn_of_sharp_bends(solution)
    check_ropes(solution, scene)


def check_ropes(solution: Solution, scene: Scene) -> None:
    """StepError for ropes that leave pulleys; where no forces are recorded all ropes may pull."""
    for line in scene.forces_between:
        if line.has_pulleys:
            motion, unknown = solution.joint(line), np.ones(len(solution.t))
            force = motion.force if len(solution.line_forces) else unknown
            row_name = "load factor" if solution.stats.static else "t ="
            check_on_pulleys(line, solution.t, motion.wrap, force, row_name)


def check_on_pulleys(
    rope: ForceBetween, t: np.ndarray, wrap: np.ndarray, force: np.ndarray, row_name: str = "t ="
) -> None:
    """StepError where a rope has left a pulley and pulls; slack ones are slack there too.

    In rows of angles (n, points) and forces (n,) at times or load factors t (n,), as the row name
    says.
    """
    bad = (wrap[:, 1:-1] < -_LIFTED) & (force != 0)[:, None]
    if not bad.any():
        return
    k, i = np.unravel_index(np.argmax(bad), bad.shape)
    reason = (
        f"{rope}: the rope leaves the pulley at point {i + 1} at {row_name} {t[k]:.4g}, where it "
        "would run straight on. Its length and force are not right from there on"
    )
    advice = "End the run there by `until`, and go on with a rope without this pulley"
    raise StepError(Failure("off the pulley", reason, float(t[k]), "", advice))


def warn_of_long_elements(solution: Solution, t: np.ndarray, q: np.ndarray) -> None:
    """Warn of the straight element that bends most in rows q (n, nodes, 3), if that is much."""
    beams = [beam for beam in solution.beams.values() if beam.degree == 1]
    if not beams:
        return
    rows = range(len(q))[:: -max(1, len(q) // _ROWS)]  # the last one is among them
    nodes = [solution.nodes_of_beam[beam.name] for beam in beams]
    turns = q[:: rows.step, :, 2][:, nodes[0] if len(nodes) == 1 else np.concatenate(nodes)]
    bends = abs(turns[:, 1:] - turns[:, :-1])
    ends = list(itertools.accumulate(map(len, nodes)))
    if ends[:-1]:
        bends[:, np.array(ends[:-1]) - 1] = 0.0  # from one beam to the next
    if bends.max() <= _BENT:
        return
    k, i = np.unravel_index(np.argmax(bends), bends.shape)
    beam = beams[int(np.searchsorted(ends, i, "right"))]
    static = solution.stats.static
    warn_once(
        f"{'static' if static else 'simulate'}: an element of {label(beam)} bends by "
        f"{bends[k, i]:.2g} rad at {'load factor' if static else 't ='} {t[rows[k]]:.4g}, "
        f"which costs about {100 * bends[k, i] ** 2 / 30:.2g} % of its length. The beam has "
        f"{beam.elements} of degree 1: take more elements, or degree=2"
    )


def _warn_of_depth(solution: Solution) -> None:
    """Warn of the first row in which a point comes deep into a circle, or goes through it.

    Of motions, rows between which there are several steps do not show the second.
    """
    name, row, are, steps = (
        ("static", "load factor", "equilibria from there on are not those", "more")
        if (static := solution.stats.static)
        else ("simulate", "t =", "motion from there on is not that", "shorter")
    )
    whole = static or len(solution.t) == solution.stats.steps + 1
    for obstacle in solution.contacts:
        first_deep = _first_in_depth(solution, obstacle, whole)
        if first_deep is None:
            continue
        k, (x, y), finding = first_deep
        _log.warning(
            "%s: %s: at %s %.6g the point at (%.4g, %.4g) %s. The %s of bodies in contact. Raise "
            "the stiffness of the contact, take %s steps, or hold what moves away more firmly",
            *(name, obstacle, row, solution.t[k], x, y, finding, are, steps),
        )


def _warn_of_bumps(solution: Solution) -> None:
    """Warn of a wheel that rolls over points of a member which are so far apart that it bumps."""
    for obstacle in solution.contacts:
        shape, target = obstacle.shape, obstacle.target
        if not isinstance(shape, Circle) or shape.inside or shape.carrier is None:
            continue
        if not isinstance(target, Beam) or obstacle.friction is None:
            continue
        contact = solution.contact(obstacle)
        closed = contact.gap < 0
        touched, counts = np.flatnonzero(closed.any(axis=0)), closed.sum(axis=1)
        if len(touched) < _PASSED or np.median(counts[counts > 0]) > 2:
            continue
        points = obstacle.points.of(solution.X[contact.nodes])[touched]
        apart, radius = float(_lengths(np.diff(points, axis=0)).max()), shape.radius
        if apart > _SPACING * radius:
            _log.warning(
                "simulate: %s: the circle of radius %.4g rolls over points that are up to %.3g "
                "apart, and sinks between them by %.2g: it bumps, and its way is wrong. Let the "
                "wheel touch the member: add_contact(%s, %s, radius=(%.4g, %.4g), ...). Or take "
                "shorter elements or along=%d, for points of at most %.2g",
                *(obstacle, radius, apart, apart**2 / (8 * radius)),
                *(shape.carrier, label(target), radius, obstacle.radius),
                *(max(4, 2 * (obstacle.along or 1)), _SPACING * radius),
            )


def _first_in_depth(
    solution: Solution, obstacle: Contact, whole: bool
) -> tuple[int, np.ndarray, str] | None:
    """Row and place of the first point deep in a circle or, if `whole`, gone through it."""
    shape, q = obstacle.shape, solution.recorded("q")
    if not isinstance(shape, Circle) or shape.inside:
        return None
    nodes = solution.contact(obstacle).nodes
    rows = max(2, _AT_ONCE // len(nodes))
    for first in range(0, len(q), rows - 1):
        points, arms, reach = _arms(obstacle, shape, solution.X, q[first : first + rows], nodes)
        distances = _lengths(arms)
        bad = deep = distances < (1 - _DEEP) * reach
        if whole:
            bad = deep.copy()
            bad[1:] |= _through(arms, distances, reach)
        if bad.any():
            k, i = np.argwhere(bad)[0]
            finding = "has gone through the circle in one step"
            if deep[k, i]:
                depth, radius = reach[k, i] - distances[k, i], reach[k, i]
                finding = f"lies {depth:.3g} deep in the circle, which has the radius {radius:.3g}"
                finding += " together with its own" if obstacle.radius else ""
            return first + int(k), points[k, i], finding
    return None


def goes_through(obstacle: Contact, X: np.ndarray, q: np.ndarray, nodes: np.ndarray) -> bool:
    """Whether a point of some nodes jumps deep into a circle, or through it.

    In a step between two configurations q (2, all nodes, 3).
    """
    shape = obstacle.shape
    if not isinstance(shape, Circle) or shape.inside:
        return False
    _, arms, reach = _arms(obstacle, shape, X, q, nodes)
    distances = _lengths(arms)
    start_gaps, end_gaps = distances - reach
    # Soft contacts get deep over several steps; from outside, within one step, it is a jump.
    jumps = (start_gaps > (_THROUGH - 1) * reach) & (end_gaps < -_DEEP * reach)
    return bool(jumps.any() or _through(arms, distances, reach).any())


def _arms(
    obstacle: Contact, circle: Circle, X: np.ndarray, q: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (rows, m, 2) that may touch a circle, the same from its centre, and its reach."""
    points = obstacle.points.of(X[nodes] + q[:, nodes, :2])
    centre = 0.0 if circle.carrier is None else q[:, None, circle.carrier.number, :2]
    reach = np.broadcast_to(np.add(circle.radius, obstacle.radius), points.shape[:2])
    return points, points - circle.origin - centre, reach


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (...) of vectors (..., 2)."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _through(arms: np.ndarray, distances: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Whether points (rows - 1, m) come nearer to a circle's centre between two rows than in these.

    By the straight ways of their arms (rows, m, 2) from it; contact begins at the `reach`.
    """
    way, through = np.diff(arms, axis=0), np.zeros((len(arms) - 1, arms.shape[1]), bool)
    # A way through is longer than this part of the distance at its ends: most often none is.
    long_ways = np.nonzero(_lengths(way) > 0.6 * np.minimum(distances[:-1], reach[1:]))
    start, way = arms[:-1][long_ways], way[long_ways]
    part = -(start * way).sum(axis=-1) / np.maximum((way**2).sum(axis=-1), 1e-300)
    least = _lengths(start + np.clip(part, 0.0, 1.0)[:, None] * way)
    ends = np.minimum(distances[:-1][long_ways], distances[1:][long_ways])
    through[long_ways] = least < _THROUGH * np.minimum(ends, reach[1:][long_ways])
    return through


def _warn_of_short_impacts(solution: Solution, scene: Scene) -> None:
    """Warn of the restitution whose impacts take the fewest steps, if these are too few."""
    if len(solution.t) < 4:
        return
    short_impacts: list[tuple[int, float, str, Contact | Stop]] = []
    for owner, law, gap in _with_losses(solution, scene):
        closed = gap < 0  # a step has a force if it begins or ends behind the obstacle
        closed[1:] |= closed[:-1]
        begins = closed[2:] & ~closed[1:-1]
        fast = gap[:-2] - gap[1:-1] > _FAST * (law.speed or 0.0) * np.diff(solution.t)[:-1, None]
        for k, i in np.argwhere(begins & fast):
            opens = np.flatnonzero(~closed[k + 2 :, i])
            steps = min(_steps_of_impact(gap[k + 1 :, i], law.loss), *opens[:1], np.inf)
            if steps < _steps_for(law.restitution):
                short_impacts.append((int(steps), float(solution.t[k + 1]), owner, law))
    if short_impacts:
        steps, t, owner, law = min(short_impacts, key=lambda impact: impact[0])
        _log.warning(
            "simulate: %s: the impact at t = %.6g takes %d steps. Its restitution %g holds in "
            "contacts of %d steps or more, whose time is about pi sqrt(m / k). Take shorter steps "
            "or a smaller stiffness",
            *(owner, t, steps, law.restitution, _steps_for(law.restitution)),
        )


class _Hits(NamedTuple):
    """A contact or a stop that may be hit."""

    owner: object
    #: Numbers of its nodes; -1 for the ground.
    nodes: Sequence[int]
    #: Gives its gap (n,), and for each step (n - 1,) whether it acts there besides.
    read: Callable[[], tuple[np.ndarray, np.ndarray | bool]]


def _warn_of_hits_at_once(solution: Solution, scene: Scene) -> None:
    """Warn of a body with two impacts of few steps at once: it shares momentum wrongly."""
    body_of = {n.number: body.name for body in solution.bodies.values() for n in body.nodes}
    of_body: dict[object, list[_Hits]] = {}
    every = [*_hits_of_contacts(solution), *_hits_of_stops(solution, scene)]
    for hits in every:
        for node in hits.nodes:
            if node >= 0:
                of_body.setdefault(body_of.get(node, node), []).append(hits)
    if max(map(len, of_body.values()), default=0) < 2:
        return
    gaps, steps = dict[int, np.ndarray](), dict[int, np.ndarray]()
    for hits in every:
        gap, acts = hits.read()
        gaps[id(hits)], steps[id(hits)] = gap, _steps_of_touch(gap, acts)
    fastest = max(-np.diff(gap).min() for gap in gaps.values())
    for of_one in of_body.values():
        for a, b in itertools.combinations(of_one, 2):
            (gap_a, steps_a), (gap_b, steps_b) = ((gaps[id(x)], steps[id(x)]) for x in (a, b))
            both = (steps_a > 0) & (steps_b > 0)
            short = np.minimum(steps_a, steps_b) < _STEPS
            ways = np.minimum(np.diff(gap_a), np.diff(gap_b))
            closing = np.minimum(ways, [0.0, *ways[:-1]]) < -_OF_FASTEST * fastest
            bad = both & short & closing
            if a.owner is not b.owner and bad.any():
                _log.warning(
                    "simulate: %s and %s: both touch one body in the step to t = %.6g, and one of "
                    "them for less than %d steps: bodies that hit in turn would share momentum "
                    "wrongly. Take steps of a tenth of a contact (1 %%), whose time is about "
                    "pi sqrt(m / k) with the reduced mass m, a smaller stiffness, or a tolerance",
                    *(a.owner, b.owner, solution.t[1 + int(np.argmax(bad))], _STEPS),
                )
                return


def _hits_of_contacts(solution: Solution) -> Iterator[_Hits]:
    """Of nodes; sub-steps may touch between two rows, of which forces tell."""

    def read(contact: Contact) -> tuple[np.ndarray, np.ndarray | bool]:
        motion, has_forces = solution.contact(contact), len(solution.contact_forces)
        acts = motion.force[1:].any(axis=(1, 2)) if has_forces else False
        return motion.gap[:, 0], acts

    for contact in solution.contacts:
        if isinstance(contact.target, Node):
            carrier = getattr(contact.shape, "carrier", None)
            nodes = [node.number for node in (contact.target, carrier) if node]
            yield _Hits(contact, nodes, partial(read, contact))


def _hits_of_stops(solution: Solution, scene: Scene) -> Iterator[_Hits]:
    """Of joints, gears, forces between points, and ropes whose length is a number."""

    def read(
        stopped: _Stopped, alone: bool, sign: int, limit: Any
    ) -> tuple[np.ndarray, np.ndarray | bool]:
        return sign * (stopped.place() - as_float(limit)), alone and stopped.acts()

    for stopped in _stopped(solution, scene):
        rope, alone = stopped.on.spring, stopped.on == Coordinate(stop=stopped.on.stop)
        if isinstance(rope, RopeSpring) and is_number(length := rope.length.given):
            yield _Hits(stopped.owner, stopped.nodes, partial(read, stopped, True, -1, length))
            continue
        for sign, limit in _limits(stopped.on.stop):
            yield _Hits(stopped.owner, stopped.nodes, partial(read, stopped, alone, sign, limit))


class _Stopped(NamedTuple):
    """What may have a stop: the numbers of its nodes, with -1 for the ground, and its law."""

    owner: Joint | Gear | ForceBetween
    nodes: Sequence[int]
    on: Coordinate
    #: Gives the coordinate (n,) of the law; for each step (n - 1,) whether it has a force.
    place: Callable[[], np.ndarray]
    acts: Callable[[], np.ndarray | bool]


def _stopped(solution: Solution, scene: Scene) -> Iterator[_Stopped]:
    def acts(line: ForceBetween) -> np.ndarray | bool:
        has_forces = line.force is None and len(solution.line_forces)
        return solution.joint(line).force[1:] != 0 if has_forces else False

    for joint in scene.joints:
        for name, on in joint.coordinates.items():
            nodes = [node.number for node in (joint.a, joint.b)]
            place = partial(_value, solution, joint, "slide" if name == "slide" else "angle")
            yield _Stopped(joint, nodes, on, place, partial(_pushes, solution, joint, name))
    for gear in scene.gears:
        nodes = [node.number for node in gear.nodes]
        place = partial(_value, solution, gear, "difference")
        yield _Stopped(gear, nodes, gear.on, place, partial(_turns, solution, gear))
    for line in scene.forces_between:
        if not line.is_bed:
            place = partial(_value, solution, line, "length")
            yield _Stopped(line, line.nodes, line.on, place, partial(acts, line))


def _value(solution: Solution, part: Any, name: str) -> np.ndarray:
    return getattr(solution.joint(part), name)


def _turns(solution: Solution, gear: Gear) -> np.ndarray | bool:
    """Whether in each step (n - 1,) a gear has a moment, or a rack a force."""
    if not len(solution.joint_forces):
        return False
    force = abs(solution.joint(gear).force[1:])
    return force > _NO_FORCE * force.max(initial=0.0)


def _pushes(solution: Solution, joint: Joint, name: str) -> np.ndarray | bool:
    """Whether in each step (n - 1,) the joint has a force along its slide, or a moment."""
    if not len(solution.joint_forces):
        return False
    x, y, moment = solution.joint(joint).force[1:].T
    if name == "rotation":
        return abs(moment) > _NO_FORCE * abs(moment).max(initial=0.0)
    psi = np.zeros(len(solution.t)) if joint.a is GROUND else solution.rotation(joint.a)
    slides = solution.joint(joint).slide
    psi, slides = ((values[1:] + values[:-1]) / 2 for values in (psi, slides))
    (a, b), size = joint.kinematics.tangent(slides), np.hypot(x, y)
    along = abs(np.cos(psi) * (x * a + y * b) + np.sin(psi) * (y * a - x * b))
    return along > np.maximum(_ACROSS * size, _NO_FORCE * size.max(initial=0.0))


def _limits(stop: Stop | None) -> list[tuple[int, float]]:
    """Signs of the gaps at the limits that a stop has, and the limits."""
    if stop is None:
        return []
    pairs = (1, stop.lower), (-1, stop.upper)
    return [(sign, limit) for sign, limit in pairs if limit is not None]


def _warn_of_soft_landings(solution: Solution) -> None:
    """Warn of plastic impacts that stick on a bristle which is not far stiffer than the contact.

    Where rows have forces.
    """
    for obstacle in solution.contacts:
        friction, stiffness = obstacle.friction, obstacle.stiffness
        if friction is None or obstacle.restitution > _PLASTIC or isinstance(obstacle.shape, Beam):
            continue
        known = obstacle.energy is None and len(solution.contact_forces)
        if friction.stiffness >= _STIFFER * stiffness or not known:
            continue
        contact = solution.contact(obstacle)
        gap, t, speed = contact.gap, solution.t, _FAST * (obstacle.speed or 0.0)
        fast = -np.diff(gap, axis=0) > speed * np.diff(t)[:, None]
        begins = (gap[1:] < 0) & (gap[:-1] >= 0) & fast
        pull, normal = abs(contact.tangential), contact.normal
        along = (pull > _ALONG * normal) | (abs(contact.stretch) > _ALONG * abs(gap))
        sticks = along & (pull < _STUCK * friction.mu * normal)
        deepest = np.append(np.diff(gap, axis=0) >= 0, np.ones((1, gap.shape[1]), bool), axis=0)
        landed = []
        for k, i in np.argwhere(begins):
            soon = max(_steps_for(0.0), int(np.argmax(deepest[k + 1 :, i])))
            if sticks[k + 1 : k + 1 + soon, i].any():
                landed.append(k)
        if landed:
            _log.warning(
                "simulate: %s: at t = %.6g it lands without restitution and sticks, with a "
                "friction of %.3g of its stiffness: how much momentum along the surface is lost "
                "depends on this ratio, by up to a third. Give friction=fx_beam.Coulomb(mu, "
                "stiffness) a hundred times the stiffness of the contact",
                *(obstacle, t[landed[0] + 1], friction.stiffness / stiffness),
            )


def _steps_of_touch(gap: np.ndarray, acts: np.ndarray | bool = False) -> np.ndarray:
    """For each step (n - 1,) of gaps (n,) the number of steps of the touch it is in; 0 for none.

    A touch within a step, of which no gap tells, `acts` in it.
    """
    touches = (gap[1:] < 0) | (gap[:-1] < 0) | acts
    ends = np.flatnonzero(np.diff(np.concatenate([[False], touches, [False]])))
    steps = np.zeros(len(touches), dtype=int)
    for first, end in ends.reshape(-1, 2):
        steps[first:end] = end - first
    return steps


def _steps_for(restitution: float) -> int:
    return round(max(_STEPS, _OF_LOSS / (0.2 + restitution)))


def _steps_of_impact(gaps: np.ndarray, loss: float) -> float:
    """Steps in a contact without loss, from the way to the deepest place of this one.

    With a loss this way is shorter by the root of 1 + `loss`, and the way back may be very long.
    """
    rises = np.flatnonzero(np.diff(gaps) >= 0)
    if not len(rises):
        return np.inf  # it is on the way at the end
    deepest = rises[0]
    rise, fall = gaps[deepest - 1] - gaps[deepest], gaps[deepest + 1] - gaps[deepest]
    top = (rise - fall) / (2 * (rise + fall))  # of the parabola through three rows
    entered = gaps[0] / (gaps[0] - gaps[1])
    return 2 * np.sqrt(1 + loss) * (deepest + top - entered)


def _with_losses(
    solution: Solution, scene: Scene
) -> Iterator[tuple[str, Contact | Stop, np.ndarray]]:
    """Contacts that can hit with a loss: as text, its law, and gaps (n, m)."""
    for obstacle in solution.contacts:
        if obstacle.restitution < 1:
            yield str(obstacle), obstacle, solution.contact(obstacle).gap
    for stopped in _stopped(solution, scene):
        stop = stopped.on.stop
        if stop is None or stop.restitution == 1:
            continue
        for sign, limit in _limits(stop):
            yield str(stopped.owner), stop, sign * (stopped.place() - as_float(limit))[:, None]


def warn_of_sharp_bends(solution: Solution) -> None:
    """Warn of the first row in which a member is touched inside a bend sharper than its thickness.

    A contact may begin or end at a depth there: the energy jumps, or a step fails.
    """
    name, row = ("static", "load factor") if solution.stats.static else ("simulate", "t =")
    for obstacle in solution.contacts:
        a, b = obstacle.target, obstacle.shape
        if not isinstance(b, Beam):
            continue
        pairs = [(a, b)] if a is b or not isinstance(a, Beam) else [(a, b), (b, a)]
        touches = [_first_inside(solution, obstacle, *pair) for pair in pairs]
        first = min((f for f in touches if f is not None), key=lambda f: f[0], default=None)
        if first is None:
            continue
        k, (x, y), radius, member = first
        _log.warning(
            "%s: %s: at %s %.6g %s has the radius of curvature %.3g at (%.4g, %.4g), where it is "
            "touched inside its bend; both half thicknesses are %.3g. The energy may jump there, "
            "which energy.balance_error shows, and steps may fail. Raise the stiffness of the "
            "contact or of the member in bending, or give a smaller radius",
            *(name, obstacle, row, solution.t[k], label(member), radius, x, y, obstacle.radii),
        )


def _first_inside(
    solution: Solution, obstacle: Contact, touching: Beam | Node, member: Beam
) -> tuple[int, np.ndarray, float, Beam] | None:
    """Row, place and radius of curvature of the first such touch of a member."""
    from fx_beam.results.joint_and_contact_motion import nodes_of

    X, q = solution.X[:, :2], solution.recorded("q")
    nodes = solution.nodes_of_beam[member.name]
    points = nodes_of(solution.nodes_of_beam, touching)
    arc = arc_of(X[nodes]) if touching is member else None
    rows = max(1, _NODES_AT_ONCE // len(nodes))
    for first in range(0, len(q), rows):
        curvature = _curvature(X[nodes] + q[first : first + rows, nodes, :2])
        sharp = abs(curvature) * obstacle.radii > _SHARP
        for k in np.flatnonzero(sharp.any(axis=1)):
            positions = X + q[first + k, :, :2]
            places = nearest(positions[points], positions[nodes], obstacle.apart, arc)
            tangent = np.gradient(positions[nodes], axis=0)[places.node]
            arms = positions[points] - places.point
            side = tangent[:, 0] * arms[:, 1] - tangent[:, 1] * arms[:, 0]
            is_inside = side * curvature[k][places.node] > 0
            bad = sharp[k][places.node] & is_inside & (places.distance < obstacle.radii)
            if bad.any():
                i = int(np.argmax(bad))
                radius = 1 / abs(curvature[k][places.node[i]])
                return first + int(k), places.point[i], float(radius), member
    return None


def _curvature(nodes: np.ndarray) -> np.ndarray:
    """Curvature (rows, n) of a member's curve at its nodes (rows, n, 2), positive to the left."""
    kappa = np.zeros(nodes.shape[:2])
    slope = (nodes[:, 2:] - nodes[:, :-2]) / 2
    bend = nodes[:, 2:] - 2 * nodes[:, 1:-1] + nodes[:, :-2]
    turn = slope[..., 0] * bend[..., 1] - slope[..., 1] * bend[..., 0]
    kappa[:, 1:-1] = turn / np.maximum((slope**2).sum(axis=-1), 1e-300) ** 1.5
    return kappa
