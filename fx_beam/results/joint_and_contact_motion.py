"""Joints, forces between points, contacts over time: coordinates, gaps, slip and forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast
from weakref import WeakKeyDictionary

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import is_one_of, shown
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact, arc_of, nearest
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.scene.joints import Joint, NodalMotion
from fx_beam.scene.law import Energy
from fx_beam.scene.outputs import Measured, Output, wraps
from fx_beam.scene.parameters import replaced
from fx_beam.symbolic import ufl

if TYPE_CHECKING:
    from fx_beam.scene.gears import Gear


# -- Gaps of contacts in given configurations, and where their recorded forces are --------------


#: Displacements (n, nodes, 3) of nodes by their numbers, in n rows.
Moved = Callable[[np.ndarray], np.ndarray]
#: Gaps (n, m), and directions (n, m, 2) to the free side.
GapsAndNormals = tuple[np.ndarray, np.ndarray]

# Distances of points and nodes, in all rows, that are looked at together.
_AT_ONCE = 100_000
# Distance of the ends of a member, relative to its size, at which it is closed.
_CLOSED = 1e-9


def nodes_of(nodes_of_beam: Mapping[str, np.ndarray], target: Node | Beam) -> np.ndarray:
    """Numbers (m,) of a node, or of all nodes of a beam, along it."""
    return nodes_of_beam[target.name] if isinstance(target, Beam) else np.array([target.number])


def columns_of(contacts: Iterable[Contact]) -> dict[int, slice]:
    """Columns of recorded forces by the number of a contact; contacts of members come last."""
    columns, end = dict[int, slice](), 0
    for contact in sorted(contacts, key=lambda contact: isinstance(contact.shape, Beam)):
        first, end = end, end + len(contact.points.lengths)
        columns[contact.number] = slice(first, end)
    return columns


def gaps_and_normals(
    contact: Contact, X: np.ndarray, nodes_of_beam: Mapping[str, np.ndarray], moved: Moved
) -> GapsAndNormals:
    """Gaps of the points of a contact, for reference positions X (nodes, 2) and displacements."""
    shape, nodes = contact.shape, nodes_of(nodes_of_beam, contact.target)
    points = X[nodes] + moved(nodes)[..., :2]
    if isinstance(shape, Beam):
        member_nodes = nodes_of_beam[shape.name]
        return _from_member(contact, points, X[member_nodes], moved(member_nodes)[..., :2])
    arms = contact.points.of(points) - shape.origin
    psi = np.zeros(len(arms))
    if shape.carrier is not None:
        x, y, psi = moved(np.array([shape.carrier.number]))[:, 0].T
        arms = arms - np.column_stack([x, y])[:, None]
    distances, directions = shape.seen(arms, psi[:, None])
    return distances - contact.radius, directions


def _from_member(
    contact: Contact, points: np.ndarray, X: np.ndarray, moved: np.ndarray
) -> GapsAndNormals:
    """Gaps from a member, for the positions (n, m, 2) of points that touch it."""
    positions, arc = X + moved, arc_of(X) if contact.shape is contact.target else None
    closed = bool(abs(positions[:, 0] - positions[:, -1]).max() <= _CLOSED * np.ptp(X))
    rows = max(1, _AT_ONCE // (points.shape[1] * len(X)))
    parts = [
        nearest(points[k : k + rows], positions[k : k + rows], contact.apart, arc, closed)
        for k in range(0, len(points), rows)
    ]
    distance, _, point = (np.concatenate(part) for part in zip(*parts, strict=True))
    directions = (points - point) / np.maximum(distance, 1e-300)[..., None]
    return distance - contact.radii, directions


# -- Joints, forces between points, contacts over time: coordinates, gaps, slip and forces ------


# What was read of parts of solutions, by its name and the part.
_MEASURED: WeakKeyDictionary[Any, dict[tuple[str, Any], Measured]] = WeakKeyDictionary()


@dataclass(frozen=True, repr=False)
class _PartMotion:
    """A part of a scene, the second field, over time."""

    solution: Any

    def __repr__(self):
        return f"<{self._part} over {len(self.solution.t)} rows>"

    @property
    def _part(self) -> Any:
        return getattr(self, self.__match_args__[-1])

    def _value(self, name: str) -> np.ndarray:
        """A quantity of the part by its definition, which is kept with the solution."""
        known = _MEASURED.setdefault(self.solution, {})
        if (key := (name, self._part)) not in known:
            known[key] = measured_in(self.solution, Output(*key))
        return values_in(self.solution, known[key])

    def _rows(self, history: str) -> np.ndarray:
        """The rows of a history that are those of the part."""
        return self.solution.recorded(history)[:, self._part.number]

    def _mean_force(self, force: np.ndarray) -> np.ndarray:
        """Mean forces (steps,) of steps, from (n,) at the scheme's level, unknown in row 0."""
        level, now, first = self.solution.stats.level, force[1:], force[1:2]
        before = np.concatenate([first, now])[:-1]
        start = before + (1 - level) * (before - np.concatenate([first, before])[:-1])
        return now + (0.5 - level) / level * (now - start)

    def _mean_power(self, name: str, work: np.ndarray) -> np.ndarray:
        """Power (n,) of the work (n - 1,) in each step; ValueError unless every step has a row."""
        t = self.solution.t
        if self.solution.stats.static:
            raise ValueError(f"{name}: no time passes in a static solution")
        if len(t) != self.solution.stats.steps + 1:
            raise ValueError(f"{name} needs every step; simulate with record=Record(every=1)")
        return np.append(0.0, work / np.diff(t))


@dataclass(frozen=True, repr=False)
class JointMotion(_PartMotion):
    """Coordinates, rates and forces of a joint over time; created by `Solution.joint`.

    Parameters
    ----------
    solution : Solution
        The solution.
    joint : Joint
        A joint of its scene.

    Examples
    --------
    A bar that a motor pushes along a guide.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=2.0))
    >>> guide = fb.Prismatic(fb.GROUND, bar.start, axis=(0, 1), motor=lambda t: 3 * t**2)
    >>> guide = scene.add_joint(guide)
    >>> motion = fb.simulate(scene, dt=0.1, t_end=0.5).joint(guide)
    >>> round(float(motion.slide[-1]), 6), bool(motion.gap.max() < 1e-12)
    (0.75, True)
    """

    joint: Joint

    @property
    def angle(self) -> np.ndarray:
        """Rotation psi_b - psi_a of b relative to a since the reference configuration [rad].

        For a node that slides on a beam: relative to the beam at the present position of the node.
        """
        return self._value("angle")

    @property
    def slide(self) -> np.ndarray:
        """Distance (n,) along the axis from the joint's position on a to b [m].

        For a node that slides on a beam: its arc length from the start of the beam.
        """
        self._check(self.joint.slide is not None, "slide")
        return self._rows("slides")

    @property
    def spin(self) -> np.ndarray:
        """Rate (n,) of the angle [rad/s].

        With the mid-point rule it is the mean over a step if free nodes have no rotary inertia.
        """
        return self._value("spin")

    @property
    def rate(self) -> np.ndarray:
        """Rate (n,) of the slide [m/s] if the joint has one, else of the angle [rad/s]."""
        return self._value("rate")

    @property
    def force(self) -> np.ndarray:
        """Force [N] and moment [N m] (n, 3) of the joint on its node b, at `Solution.t_level`.

        Springs, dampers and motors are included.
        """
        return self._rows("joint_forces")

    @property
    def motor_force(self) -> np.ndarray:
        """Force (n,) [N] of the motor or lock, or its moment [N m] on b, at `t_level`."""
        forces = self._rows("motor_forces")
        self._check(bool(self.joint.driven or forces.any()), "motor")  # a latch may have locked it
        return forces

    @property
    def motor_power(self) -> np.ndarray:
        """Mean power (n,) of the motor over the step that ends at t[k] [W]; 0 in row 0.

        The sum of power times step length is the work of the motor, to second order in the step;
        for an `Input`, whose rate jumps from step to step, to first order. Where a motor jumps, its
        power has the inertia of this blow. The work in `Solution.energy` is exact. A row for every
        step must have been recorded, otherwise this is a ValueError, and so it is in statics.
        """
        place = self.slide if "slide" in self.joint.driven else self.angle
        return self._mean_power("motor_power", self._mean_force(self.motor_force) * np.diff(place))

    def internal(self, variable: str) -> np.ndarray:
        """An internal variable of the joint's springs over time.

        Parameters
        ----------
        variable : str
            Name of one of the `InternalVariables` of a spring on the slide or the rotation.

        Returns
        -------
        (n,) float
            Its values at the times t.

        Raises
        ------
        ValueError
            If the motion was not recorded, or the joint has no such variable.
        """
        known = self.solution.variables_of_joint.get(self.joint.number, {})
        return internal_variable(self.solution, known, variable, str(self.joint))

    @property
    def gap(self) -> np.ndarray:
        """Distance (n,) of b from the position that the joint prescribes [m]; zero to round-off."""
        return self.joint.kinematics.gap(*self._motion)

    @property
    def _motion(self) -> tuple[NodalMotion, np.ndarray]:
        """Motion of the nodes, and the slide (n,)."""
        return motion_of(self.solution), self.solution.slides[:, self.joint.number]

    def _check(self, exists: bool, quantity: str) -> None:
        if not exists:
            raise ValueError(f"{self.joint} has no {quantity}")


def internal_variable(solution, known: Mapping[str, np.ndarray], name, owner: str) -> np.ndarray:
    """One of the internal variables of a beam or joint; ValueError if there is no such one."""
    solution.recorded("q")  # they are recorded with the motion
    if not is_one_of(name, known):
        raise ValueError(f"{owner} has no internal variable {shown(name)}; it has {list(known)}")
    return known[name]


def measured_in(solution, output: Output) -> Measured:
    """An output, measured in a solution, which it does not keep."""
    nodes_of_beam = solution.nodes_of_beam
    return Measured(output, lambda beam: nodes_of_beam[beam.name])


def values_in(solution, measured: Measured) -> np.ndarray:
    """Values (n, ...) of an output of a place, a joint or a line."""

    def read(array: str, entries: np.ndarray) -> np.ndarray:
        if array == "X":
            return solution.X.reshape(-1)[entries]
        rows = solution.recorded(array)
        return rows.reshape(len(rows), -1)[:, entries]

    counted = solution.turns_of_line.get(measured.place.number) if measured.counts_turns else None
    return measured.values(read, counted)


def motion_of(solution) -> NodalMotion:
    """Motion of the nodes and beams of a solution."""
    return NodalMotion(
        lambda name, node: solution.recorded(name)[:, node.number].T,
        lambda name, beam: solution.recorded(name)[:, solution.nodes_of_beam[beam.name]],
    )


@dataclass(frozen=True, repr=False)
class PullMotion(_PartMotion):
    """Length, tension, energy and power of a force between points, rope or spring to the ground.

    Created by `Solution.joint`.

    Parameters
    ----------
    solution : Solution
        The solution.
    line : ForceBetween
        A force between points, rope or spring to the ground of its scene.

    Examples
    --------
    A load on a rope: the tension is its weight.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> load = scene.add_body((0, -3), mass=20.0).centre
    >>> scene.fix(load, "rotation")
    >>> rope = scene.add_force_between(load, (0, 0), stop=(None, 3.1, 2e4))
    >>> hanging = fb.static(scene).joint(rope)
    >>> float(hanging.force[-1].round(1)), float(hanging.length[-1].round(5))
    (196.2, 3.10981)
    """

    line: ForceBetween

    @property
    def force(self) -> np.ndarray:
        """Pull (n,) [N], positive if it shortens the line, at `Solution.t_level`; 0 if slack.

        It is the sum of spring, damper, friction, stops and the additional force. For a spring to
        the ground: the force, or moment [N m], against an increase of `length`; for a bed: the
        total force on the beam.
        """
        return self._rows("line_forces")

    @property
    def length(self) -> np.ndarray:
        """Distance (n,) of the points, or the sum of the distances along a rope [m].

        Arcs on pulleys, and rope wound on drums since the start, are included. For a spring to the
        ground: the displacement along its direction [m], or the rotation [rad]; for a bed: the
        displacements (n, nodes) of the nodes of the beam.
        """
        return self._of_bed("q") if self.line.is_bed else self._value("length")

    @property
    def wrap(self) -> np.ndarray:
        """Angles (n, points) over which a rope lies on its pulleys [rad]; 0 at points.

        A negative angle means that the rope has left the pulley. The model does not include this:
        it computes the length as if the pulley held the rope. For a drum: the angle since the
        start.
        """
        if not self.line.kinds:
            return np.zeros((len(self.solution.t), len(self.line.points)))
        rows = self.solution.recorded("q").reshape(len(self.solution.t), -1)
        counted = self.solution.turns_of_line.get(self.line.number)
        return wraps(self.line, lambda _, entries: rows[:, entries], counted)

    def _of_bed(self, name: str) -> np.ndarray:
        """Displacements ("q") or rates ("v") along a bed (n, nodes)."""
        solution, bed = self.solution, cast(Any, self.line)
        nodes = nodes_of(solution.nodes_of_beam, bed.target)
        moved = solution.recorded(name)[:, nodes, :2]
        return np.sum(moved * bed.ways(solution.X[nodes]), axis=-1)

    @property
    def rate(self) -> np.ndarray:
        """Rate (n,) of the length [m/s or rad/s] at t[k]; for a bed (n, nodes)."""
        return self._of_bed("v") if self.line.is_bed else self._value("rate")

    @property
    def power(self) -> np.ndarray:
        """Mean power (n,) [W] that the line takes over the step that ends at t[k]; 0 in row 0.

        It is the pull times the rate of the length: the power that springs store and that dampers,
        friction and stops take, less the power of an additional force. The sum of power times step
        length is exact with `EnergyMomentum` of order 2, except for rotations; otherwise it is of
        second order. If a driven motion jumps in the first step, `Newmark`, `HHT` and
        `GeneralizedAlpha` give up to twice the power there. For a bed: the stored power of all
        nodes. A row for every step must have been recorded, otherwise this is a ValueError, and so
        it is in statics.
        """
        length = self.length
        is_bed = length.ndim > 1
        works = np.diff(self.energy) if is_bed else self._mean_force(self.force) * np.diff(length)
        return self._mean_power("power", works)

    @property
    def energy(self) -> np.ndarray:
        """Energy (n,) [J] that the spring and the stops store.

        Springs with internal variables are refused: `Solution.energy` has their energy.
        """
        x, line = self.length, self.line
        spring, stop = line.on.spring, line.on.stop
        stored = np.zeros(x.shape)
        if spring is not None:
            if spring.internal:
                raise ValueError(f"{line}: a spring with internal variables; see Solution.energy")
            stretch = x - spring.rest
            stored += spring.stiffness / 2 * stretch**2
            if spring.strain_energy is not None:
                stored += self._of_law(spring.strain_energy, stretch)
        for name, side in (("lower", -1), ("upper", 1)):
            if (limit := getattr(stop, name, None)) is not None:
                excess = np.maximum(side * (x - limit), 0.0)
                stored += getattr(stop, "stiffness", 0.0) / 2 * excess**2
        return stored @ getattr(line, "lengths", 1.0) if x.ndim > 1 else stored

    def _of_law(self, law: Energy, stretch: np.ndarray) -> np.ndarray:
        """Stored energy (n,) by a law of a user, with the parameters of the rows."""
        names, rows = self.solution.names_of_parameters, self.solution.parameters
        pairs = zip(stretch.tolist(), rows.tolist(), strict=True)
        laws = ((law(ufl.as_ufl(x)), dict(zip(names, row, strict=True))) for x, row in pairs)
        return np.array([float(replaced(energy, values)(())) for energy, values in laws])


@dataclass(frozen=True, repr=False)
class GearMotion(_PartMotion):
    """Force of a gear or rack over time; created by `Solution.joint`.

    Parameters
    ----------
    solution : Solution
        The solution.
    gear : Gear
        A gear or rack of its scene.

    Examples
    --------
    A moment of 3 N m on a wheel of twice the radius is held by half of it on the other wheel.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> wheels = [scene.add_body((x, 0), mass=1.0, inertia=0.1).centre for x in (0, 1)]
    >>> shafts = [scene.add_joint(fb.Revolute(fb.GROUND, wheel)) for wheel in wheels]
    >>> gear = scene.add_joint(fb.Gear(*shafts, ratio=-0.5))
    >>> scene.fix(wheels[0], "rotation")
    >>> load = scene.add_moment(wheels[1], 3.0)
    >>> held = fb.static(scene)
    >>> round(float(held.joint(gear).force[-1]), 6), held.reaction(wheels[0])[-1].round(6)
    (-3.0, array([0. , 0. , 1.5]))
    """

    gear: Gear

    @property
    def force(self) -> np.ndarray:
        """Moment (n,) of a gear on b of `joint_b` [N m], at `Solution.t_level`.

        The moment on b of `joint_a` is -ratio times this one. For a rack: the force [N] on b along
        the slide.
        """
        return self._rows("joint_forces")[:, self.gear.column]

    @property
    def difference(self) -> np.ndarray:
        """Angle of `joint_b` less ratio times that of `joint_a` (n,) [rad]: play and twist.

        For a rack: the slide less radius times angle [m]. Without a spring, damper, friction or
        stop on the gear it is zero to round-off.
        """
        return self.gear.difference(motion_of(self.solution), self.solution.slides)


@dataclass(frozen=True, repr=False)
class ContactMotion(_PartMotion):
    """Gaps, forces and slip of a contact over time; created by `Solution.contact`.

    Parameters
    ----------
    solution : Solution
        The solution.
    contact : Contact
        A contact of its scene.

    Examples
    --------
    A load presses the tip of a cantilever against a stop, 1 mm below it.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (0.0, -10.0))
    >>> stop = scene.add_contact(beam.end, fb.Line((0, -1e-3), normal=(0, 1)), stiffness=1e9)
    >>> contact = fb.static(scene).contact(stop)
    >>> float(contact.force[-1, 0, 1].round(1)), bool(contact.gap.min() > -1e-8)
    (7.0, True)
    """

    contact: Contact

    @property
    def nodes(self) -> np.ndarray:
        """Numbers (m,) of the nodes, along the beam; rows of `Solution.X`."""
        return nodes_of(self.solution.nodes_of_beam, self.contact.target)

    @property
    def points(self) -> np.ndarray:
        """Positions (n, m, 2) of the points that touch [m]: nodes, or points along elements."""
        nodes = self.nodes
        positions = self.solution.X[nodes] + self.solution.recorded("q")[:, nodes, :2]
        return self.contact.points.of(positions)

    @property
    def gap(self) -> np.ndarray:
        """Distance (n, m) of the points from the obstacle [m]; negative behind it."""
        return self._now[0].copy()

    @property
    def force(self) -> np.ndarray:
        """Forces (n, m, 2) on the points at `Solution.t_level` [N]."""
        columns = columns_of(self.solution.contacts)[self.contact.number]
        return self.solution.recorded("contact_forces")[:, columns]

    @property
    def normal(self) -> np.ndarray:
        """Normal forces (n, m) at `Solution.t_level` [N]; positive towards the free side."""
        return np.einsum("nmi,nmi->nm", self.force, self._normals_at_level)

    @property
    def tangential(self) -> np.ndarray:
        """Friction (n, m) on the points at `Solution.t_level` [N].

        Positive to the left, looking along the normal force.
        """
        x, y = np.moveaxis(self._normals_at_level, -1, 0)
        return np.einsum("nmi,nmi->nm", self.force, np.stack([-y, x], axis=-1))

    @property
    def slip(self) -> np.ndarray:
        """Slip (n, m) of the points since they came into contact [m]; signs as `tangential`."""
        return self._of_friction(1)

    @property
    def stretch(self) -> np.ndarray:
        """Stretch z (n, m) of the springs of friction [m]; the friction is -kt (z + tau dz/dt)."""
        return self._of_friction(0)

    def _of_friction(self, variable: int) -> np.ndarray:
        known = self.solution.variables_of_contact.get(self.contact.number)
        if known is None:
            lack = "has no motion recorded, or only one of a version before 1.2"
            lack = lack if self.contact.friction else "has no friction"
            raise ValueError(f"{self.contact} {lack}")
        shape = self.contact.shape
        return known[..., variable] * (1 if isinstance(shape, Beam) else shape.side)

    # Nearest points take time: they are found once for each `ContactMotion`.
    @cached_property
    def _now(self) -> GapsAndNormals:
        """Gaps (n, m) and directions (n, m, 2) to the free side at the times t."""
        q = self.solution.recorded("q")
        return self._gaps_and_normals(lambda nodes: q[:, nodes])

    @cached_property
    def _normals_at_level(self) -> np.ndarray:
        """Directions (n, m, 2) of the normal force in the steps between rows."""
        q, t, t_level = self.solution.recorded("q"), self.solution.t, self.solution.t_level
        length = np.diff(t)
        part = np.divide(t_level[1:] - t[:-1], length, out=np.ones_like(length), where=length > 0)

        def level_rows(nodes: np.ndarray) -> np.ndarray:
            rows = q[:, nodes]
            rows[1:] = rows[:-1] + part[:, None, None] * np.diff(rows, axis=0)
            return rows

        return self._gaps_and_normals(level_rows)[1]

    def _gaps_and_normals(self, q_of: Moved) -> GapsAndNormals:
        solution = self.solution
        return gaps_and_normals(self.contact, solution.X, solution.nodes_of_beam, q_of)
