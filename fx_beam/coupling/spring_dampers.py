"""Springs, dampers, friction and stops on the free coordinates of joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.mechanics.rates import UpdateRule
from fx_beam.results.state import State
from fx_beam.scene.beam import Node
from fx_beam.scene.joint_kinematics import axial_rate
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.sliders import SlidingJoint

from .actuator import Actuator, limits_of
from .damper_laws import DamperLaw
from .graph import Couplings, Entry
from .sliding import rate_along
from .spring_laws import SpringLaw


class Actuators:
    """All springs, dampers, friction and stops of a scene.

    Exact work: a rotational spring has the moment k (mean angle - rest) (Dpsi_b - Dpsi_a) /
    (Dtheta_b - Dtheta_a). Its work on Dtheta is the increment of k/2 (angle - rest)^2. A stored
    energy of its own has its discrete gradient in the place of k (mean angle - rest), and so have
    stops.
    """

    def __init__(
        self, joints: list[Joint], couplings: Couplings, rates: UpdateRule, dofs: np.ndarray
    ):
        self._rates, self._dofs = rates, dofs
        #: Length of the step [s].
        self._dt = 1.0
        self._all: list[Actuator] = []
        #: Number of internal variables of all springs.
        self.width = 0
        #: Degrees of freedom (nodes, 3) of the beams on which nodes slide, by joint.
        self._sliding: dict[int, np.ndarray] = {}
        laws: dict[tuple[int, int], SpringLaw] = {}
        for joint in joints:
            for coordinate, name in ((joint.slide, "slide"), (joint.rotation, "rotation")):
                if coordinate is None or not coordinate.acts:
                    continue
                spring, damper, friction = coordinate.spring, coordinate.damper, coordinate.friction
                if rates.at_rest:
                    damper = friction = None
                elastic = None
                if spring is not None and spring.strain_energy is not None:
                    kind = id(spring.strain_energy), id(spring.internal)
                    elastic = laws[kind] = laws.get(kind) or SpringLaw(
                        spring.strain_energy, spring.internal, rates
                    )
                first, self.width = self.width, self.width + (elastic.variables if elastic else 0)
                turns: tuple[int, int] | None = None
                columns: tuple[list[Entry], list[Entry]]
                if name == "slide":
                    columns = [], [(couplings.slides[joint.number], 0, 1.0)]
                else:
                    a, b = (dofs[n.number, 2] if n.number >= 0 else -1 for n in (joint.a, joint.b))
                    turns = int(a), int(b)
                    columns = _entries(couplings, turns[0]), _entries(couplings, turns[1])
                self._all.append(
                    Actuator(
                        joint,
                        k=spring.stiffness if spring else 0.0,
                        rest=spring.rest if spring else 0.0,
                        c=damper.viscosity if damper else 0.0,
                        friction=friction,
                        stop=coordinate.stop,
                        loss=coordinate.stop.loss if coordinate.stop and not rates.at_rest else 0.0,
                        law=DamperLaw(damper.law) if damper and damper.law else None,
                        elastic=elastic,
                        inside=slice(first, self.width),
                        turns=turns,
                        columns=columns,
                    )
                )

    def __len__(self):
        return len(self._all)

    def set_sliding(self, dofs: dict[int, np.ndarray]) -> None:
        """Set the degrees of freedom (nodes, 3) of the beams on which nodes slide, by joint."""
        self._sliding = dofs

    @property
    def have_laws(self) -> bool:
        """Whether a spring has a stored energy of its own."""
        return any(actuator.elastic for actuator in self._all)

    @property
    def have_stops(self) -> bool:
        """Whether a coordinate has stops."""
        return any(actuator.stop for actuator in self._all)

    @property
    def rub(self) -> bool:
        """Whether a coordinate has friction or a damper with its own law."""
        return any(a.friction or a.law for a in self._all)

    @property
    def lose_at_stops(self) -> bool:
        """Whether a stop takes energy."""
        return any(a.loss for a in self._all)

    def remember(self) -> None:
        """Keep the tangents of the springs' own energies for `deviation`."""
        for actuator in self._all:
            if actuator.elastic is not None:
                actuator.remember()

    def deviation(self, step: np.ndarray) -> Callable[[float], float]:
        """Work on the last correction (free,) of what the springs' forces deviate from the tangent.

        A function of the part of the correction that is taken; it has just been taken as a whole.
        """
        pushed = [
            (
                actuator,
                sum(
                    side * sign * step[column]
                    for side, own in zip((-1.0, 1.0), actuator.columns, strict=True)
                    for column, _, sign in own
                    if column < len(step)
                ),
            )
            for actuator in self._all
            if actuator.elastic is not None
        ]
        return lambda part: sum(s * a.deviation((1 - part) * s) for a, s in pushed)

    def evolve(self) -> np.ndarray | None:
        """Internal variables (width,) at the end of the step; None without any."""
        if not self.width:
            return None
        return np.concatenate([a.found[4:] for a in self._all if a.elastic is not None])

    def begin(self, start: State, length: float) -> None:
        """Set the start of a step, and its length [s], in statics the increment of the load."""
        rates, self._dt = self._rates, 1.0 if self._rates.at_rest else length
        for actuator in self._all:
            actuator.start = self._coordinate(actuator, start.q, start.slides)
            actuator.last = actuator.last_stop = None
            # Dampers interpolate from it to their level; the mean rate does not depend on it.
            if rates.level != 0.5 and not rates.at_rest:
                actuator.rate = self._rate(actuator, start.q, start.v, start.slides)
            if actuator.elastic is not None:
                actuator.given[2] = length
                if start.spring_internal is not None:
                    actuator.given[3:] = start.spring_internal[actuator.inside]

    def _rate(self, actuator: Actuator, q: np.ndarray, v: np.ndarray, slides: np.ndarray) -> float:
        """Rate of a coordinate in a state."""
        joint = actuator.joint
        x, y, turn = (self._of(joint.b, v, i) - self._of(joint.a, v, i) for i in range(3))
        if actuator.turns is not None:
            return turn
        if isinstance(joint, SlidingJoint):
            own, s = self._sliding[joint.number], float(slides[joint.number])
            v_node = v[self._dofs[joint.b.number, :2]]
            return rate_along(joint.path, s, q[own][:, :2], v[own][:, :2], v_node)
        psi, spin = (self._of(joint.a, values, 2) for values in (q, v))
        return float(axial_rate(joint, slides[joint.number], psi, spin, x, y))

    def set_increment(self, D: np.ndarray, z: np.ndarray) -> None:
        """Set the increments over the step: D (size,) and z (columns,)."""
        level, dt = self._rates.level, self._dt
        for a in self._all:
            if a.turns is None:
                a.change = path = float(z[a.columns[1][0][0]])
                ratio, by_a, by_b, slope_a, slope_b = 1.0, 0.0, 0.0, 0.0, 1.0
            else:
                Da, Db = (float(D[t]) if t >= 0 else 0.0 for t in a.turns)
                a.change = Db - Da
                ends, slopes = self._rates.work_increment(np.array([Da, Db]), np.arange(2))
                path = float(ends[1] - ends[0])
                slope_a, slope_b = (float(s) for s in slopes)
                ratio, by_a, by_b = self._rates.turn_ratio(Da, Db)
            elastic, stiff = a.spring(level)
            # The rate at the scheme's level; in the middle of the step it is the mean rate.
            rate = a.rate + 2 * level * (path / dt - a.rate)
            a.force = elastic * ratio + a.resistance(rate)
            a.dissipated = a.resistance(path / dt) * path
            if a.elastic is not None:
                a.dissipated += float(a.found[2])
            steep, grows = 2 * level * a.tangent_damping(rate) / dt, a.tangent_stiffness(rate)
            a.slopes = (
                -stiff * ratio + elastic * by_a - steep * slope_a - grows,
                stiff * ratio + elastic * by_b + steep * slope_b + grows,
            )

    def linear(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, columns: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness and damping (columns, columns) of all in a state, and their forces (columns,).

        After `begin`.
        """
        K, C, total = np.zeros((columns, columns)), np.zeros((columns, columns)), np.zeros(columns)
        for actuator in self._all:
            along = np.zeros(columns)
            for side, own in zip((-1.0, 1.0), actuator.columns, strict=True):
                for column, _, sign in own:
                    along[column] += side * sign
            actuator.change, rate = 0.0, self._rate(actuator, q, v, slides)
            # At its start the mean over a step depends on half of the step's increment.
            elastic, half = actuator.spring(0.5)
            K += 2 * (half + actuator.tangent_stiffness(rate)) * np.outer(along, along)
            C += actuator.tangent_damping(rate) * np.outer(along, along)
            total += (elastic + actuator.resistance(rate)) * along
        return K, C, total

    def forces(self, columns: int) -> np.ndarray:
        """Generalised forces (columns,) [N, N m]."""
        total = np.zeros(columns)
        for actuator in self._all:
            for side, own in zip((-1.0, 1.0), actuator.columns, strict=True):
                for column, _, sign in own:
                    total[column] += side * sign * actuator.force
        return total

    def pairs(self, index: np.ndarray) -> list[tuple[int, int]]:
        """Rows and columns of the entries of `stiffness`; an index of -1 is no unknown."""
        return [pair[:2] for pair in self._pairs(index)]

    def stiffness(self) -> np.ndarray:
        """Derivatives of the generalised forces, in the order of `pairs`."""
        return np.array(
            [
                row_sign * column_sign * actuator.slopes[side]
                for actuator, side, row_sign, column_sign in self._terms
            ]
        )

    def _pairs(self, index: np.ndarray):
        found, self._terms = [], []
        for actuator in self._all:
            rows = [
                (c, side * s)
                for side, own in zip((-1.0, 1.0), actuator.columns, strict=True)
                for c, _, s in own
                if index[c] >= 0
            ]
            for row, row_sign in rows:
                for side, own in enumerate(actuator.columns):
                    for column, _, sign in own:
                        if index[column] >= 0:
                            found.append((row, column))
                            self._terms.append((actuator, side, row_sign, sign))
        return found

    def energy(self, q: np.ndarray, slides: np.ndarray, internal: np.ndarray | None) -> float:
        """Energy stored in springs and stops [J] for displacements and rotations q and slides."""
        return sum(a.stored(self._coordinate(a, q, slides), internal) for a in self._all)

    def switches(self, q: np.ndarray, slides: np.ndarray) -> list[float]:
        """Values that change their sign where a stop opens or closes, or a law switches."""
        return [value for a in self._all for value in a.switches(self._coordinate(a, q, slides))]

    def dissipated(self) -> float:
        """Energy dissipated by dampers, friction, springs and stops in this step [J]."""
        return sum(actuator.dissipated for actuator in self._all)

    # -- For the compiled loop ------------------------------------------------------------------

    def turns(self) -> list[int]:
        """Rotations with springs or dampers."""
        return [t for actuator in self._all for t in actuator.turns or () if t >= 0]

    def tables(self) -> tuple[list[dict], dict[str, list]]:
        """Springs and dampers as ``Actuator`` of c/problem.h, and the columns of their forces."""
        rows, pushes, sliders = [], [], list(self._sliding)
        for number, actuator in enumerate(self._all):
            joint, slides, stop = actuator.joint, actuator.turns is None, actuator.stop
            rows.append(
                {
                    "joint": joint.number,
                    "slide": joint.number if slides else -1,
                    "slider": sliders.index(joint.number) if joint.number in sliders else -1,
                    "column": actuator.columns[1][0][0] if slides else -1,
                    "a": self._dofs_of(joint.a),
                    "b": self._dofs_of(joint.b),
                    "axis": [0.0, 0.0] if joint.axis is None else joint.axis.tolist(),
                    "offset": joint.offset.tolist(),
                    "k": actuator.k,
                    "rest": actuator.rest,
                    "c": actuator.c,
                    "friction": actuator.friction.force if actuator.friction else 0.0,
                    "speed": actuator.friction.speed if actuator.friction else 1.0,
                    "limit": [0.0, 0.0] if stop is None else limits_of(stop).tolist(),
                    "stop": stop.stiffness if stop else 0.0,
                    "loss": actuator.loss,
                    "stop_speed": (stop and stop.speed) or 1.0,
                    "law": actuator.law.address if actuator.law else 0,
                    "elastic": actuator.elastic.address if actuator.elastic else 0,
                    "conditions": actuator.elastic.conditions if actuator.elastic else 0,
                    "switch_": actuator.elastic.switch_address if actuator.elastic else 0,
                    "variables": actuator.inside.stop - actuator.inside.start,
                    "first": actuator.inside.start,
                }
            )
            for side, own in zip((-1.0, 1.0), actuator.columns, strict=True):
                pushes += [(column, number, side * sign) for column, _, sign in own]
        return rows, _table(("column", "of", "sign"), pushes)

    def stiffness_terms(self) -> dict[str, list]:
        """The terms of `stiffness`: actuator, side and sign of each entry."""
        numbers = {id(actuator): number for number, actuator in enumerate(self._all)}
        terms = [(numbers[id(a)], side, row * column) for a, side, row, column in self._terms]
        return _table(("of", "side", "sign"), terms)

    # -- Moments --------------------------------------------------------------------------------

    def moments(self, joints: int) -> np.ndarray:
        """Moments (joints,) of rotational springs and dampers on the nodes b [N m]."""
        total = np.zeros(joints)
        for actuator in self._all:
            if actuator.turns is not None:
                total[actuator.joint.number] -= actuator.force
        return total

    def node_moments(self, nodes: int) -> np.ndarray:
        """Moments (nodes,) of rotational springs and dampers on the nodes [N m]."""
        total = np.zeros(nodes)
        for actuator in self._all:
            if actuator.turns is not None:
                for node, sign in ((actuator.joint.a, 1.0), (actuator.joint.b, -1.0)):
                    if node is not GROUND:
                        total[node.number] += sign * actuator.force
        return total

    def _dofs_of(self, node: Node) -> list[int]:
        """Degrees of freedom of a node; -1 for the ground."""
        return [-1] * 3 if node is GROUND else self._dofs[node.number].tolist()

    def _of(self, node: Node, values: np.ndarray, component: int) -> float:
        """Value (size,) at a node; zero on the ground."""
        return 0.0 if node is GROUND else float(values[self._dofs[node.number, component]])

    @staticmethod
    def _coordinate(actuator: Actuator, q: np.ndarray, slides: np.ndarray) -> float:
        if actuator.turns is None:
            return float(slides[actuator.joint.number])
        a, b = (float(q[t]) if t >= 0 else 0.0 for t in actuator.turns)
        return b - a


def _entries(couplings: Couplings, dof: int) -> list[Entry]:
    return couplings.entries(dof) if dof >= 0 else []


def _table(names: tuple[str, ...], rows: list[tuple]) -> dict[str, list]:
    return {name: [row[i] for row in rows] for i, name in enumerate(names)}
