"""The last state of a solution, carried over to a scene that may have changed since."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import accumulate
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.joints import Constraints, JointKey, constraints_of, key_of, slides_at_start
from fx_beam.scene.loads import NAMES
from fx_beam.step.model import Model

from .initial_state import end_of, given_velocity

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
    return end.constraints != constraints_of(scene)


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
