"""The last state of a solution, carried over to a scene that may have changed since."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.dual import plain
from fx_beam.errors import SceneError
from fx_beam.fem.parameter_values import before
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.joints import Constraints, JointKey, constraints_of, key_of
from fx_beam.scene.loads import NAMES
from fx_beam.step.model import Model

from .initial_state import end_of, given_velocity, reference_state

_GROUND = -1


def has_changed(model: Model, start: Solution) -> bool:
    """Whether members, joints, supports or contacts are others than those of a solution."""
    end, X, scene = end_of(start), model.mesh.X, model.scene
    if start.X.shape != X.shape or (start.X != X).any():
        return True
    members = [one.name for one in scene.beams], [one.name for one in scene.bodies]
    if members != ([*start.beams], [*start.bodies]):
        return True
    has, had = ([(str(o), o.along, o.variables) for o in of.contacts] for of in (scene, start))
    if has != had:
        return True
    if end.constraints is None:  # a solution that is no run
        return len(end.slides) != scene.joint_count or len(end.motors) != len(model.motors)
    return end.constraints != constraints_of(scene)


def transferred_state(model: Model, start: Solution) -> State:
    """The state of a scene that has changed, before its rates are made to fit; it has no past.

    Members and joints are known by their names and nodes. Those that are new are as at the start.
    """
    end, new, mesh = end_of(start), reference_state(model), model.mesh
    rows = _rows_of_nodes(model, start)
    known = rows >= 0
    rates = end.v if end.fitted is None else end.fitted
    nodal = dict[str, Any]()
    for name, values in (("q", end.q), ("v", end.v), ("fitted", rates)):
        mine = np.zeros((len(mesh.X), 3))
        mine[known] = values[rows[known]]
        nodal[name] = mine.ravel()
    if start.stats.static:  # the motion begins with the initial velocities of the scene
        nodal.pop("fitted")
    elif not known.all():
        fresh = np.repeat(~known, 3)
        given = fresh * plain(given_velocity(model))
        nodal["v"] += given
        nodal["fitted"] += given
    _check_new_beams(model, start, nodal["q"])
    theirs = _joints_before(model, start, rows)
    at = model.motion(q=nodal["q"][None])
    slides = new.slides
    for joint in model.scene.joints:
        old, slide = theirs.get(joint.number), slides[joint.number : joint.number + 1]
        slide[:] = joint.kinematics.slide(at, slide) if old is None else end.slides[old.number]
    state = State(
        end.t,
        _motors(model, start, theirs, slides, at),
        a=np.zeros(model.size),
        slides=slides,
        work=end.work,
        # What a scheme holds for the next step is lost.
        dissipated=end.dissipated + end.algorithmic,
        numerical=end.numerical + end.algorithmic,
        impact=end.impact,
        internal=_internal(model, start),
        natural=_natural(model, start),
        spring_internal=_spring_internal(model, start, theirs, rows),
        inputs=end.inputs,
        **nodal,
    )
    of_scene = model.forms.parameters
    return replace(state, parameters=of_scene.at(before(state.t)) if len(of_scene) else None)


def _rows_of_nodes(model: Model, start: Solution) -> np.ndarray:
    """Row (n_node,) of each node in the solution; -1 for nodes of new members."""
    mesh, scene = model.mesh, model.scene
    rows = np.full(len(mesh.X), -1)
    pairs = [
        (f"beam {beam.name!r}", nodes, start.nodes_of_beam[beam.name])
        for beam, nodes in zip(scene.beams, mesh.nodes, strict=True)
        if beam.name in start.nodes_of_beam
    ]
    for body in scene.bodies:
        if body.name in start.bodies:
            old = start.bodies[body.name]
            mine, theirs = (np.array([node.number for node in one.nodes]) for one in (body, old))
            pairs.append((f"body {body.name!r}", mine, theirs))
    advice = "Use the same beams and elements; a new member needs another name"
    if not pairs:
        raise SceneError(f"start: the solution has other nodes than the scene. {advice}")
    for what, mine, theirs in pairs:
        if len(mine) != len(theirs) or (mesh.X[mine] != start.X[theirs]).any():
            raise SceneError(
                f"start: the solution has other nodes than the scene for {what}. {advice}"
            )
        rows[mine] = theirs
    for number in scene.gone:
        if number < len(start.X) and (start.X[number] == mesh.X[number]).all():
            rows[number] = number
    return rows


def _check_new_beams(model: Model, start: Solution, q: np.ndarray) -> None:
    """Refuse new beams at nodes that have moved: their other nodes are in the reference shape."""
    moved = q.reshape(-1, 3)
    for beam, nodes in zip(model.scene.beams, model.mesh.nodes, strict=True):
        if beam.name in start.nodes_of_beam:
            continue
        far = np.hypot(*moved[nodes, :2].T) + model.mesh.size * abs(moved[nodes, 2])
        worst = int(np.argmax(far))
        if far[worst] > 1e-8 * model.mesh.size:
            u, v, psi = moved[nodes[worst]]
            raise SceneError(
                f"start: {beam!r} is new, but its node {nodes[worst]} has moved by "
                f"({u:.3g}, {v:.3g}) and turned by {psi:.3g} rad, so that it would be strained. "
                "Give it nodes of its own where that node is, and a joint"
            )


def _joints_before(model: Model, start: Solution, rows: np.ndarray) -> dict[int, JointKey]:
    """Joints of the solution by the numbers of the same joints of the scene."""
    keys: dict[tuple, list[JointKey]] = {}
    for key in (end_of(start).constraints or Constraints()).joints:
        keys.setdefault((key.kind, key.a, key.b), []).append(key)
    same = {}
    for joint in model.scene.joints:
        mine = key_of(joint)
        a, b = (int(rows[n]) if n >= 0 else _GROUND for n in (mine.a, mine.b))
        new = any(n >= 0 and rows[n] < 0 for n in (mine.a, mine.b))
        if not new and (twins := keys.get((mine.kind, a, b))):
            twin = next((key for key in twins if key.number == joint.number), twins[0])
            if joint.place is not None and twin.number != joint.number:
                continue  # it is made anew
            twins.remove(twin)
            same[joint.number] = twin
    return same


def _motors(model: Model, start: Solution, theirs: dict[int, JointKey], slides, at) -> np.ndarray:
    """How far motors have moved; new ones are where their joints are."""
    end, moved = end_of(start), np.zeros(len(model.motors))
    joints = (end.constraints or Constraints()).joints
    places = [(key.number, name) for key in joints for name in key.motors]
    for i, (joint, name) in enumerate(model.motors):
        old, number = theirs.get(joint.number), joint.number
        if old is not None and (old.number, name) in places:
            moved[i] = end.motors[places.index((old.number, name))]
        elif name == "slide":
            moved[i] = slides[number] - joint.start()[0]
        else:
            moved[i] = float(joint.kinematics.angle(at, slides[number : number + 1])[0])
    return moved


def _internal(model: Model, start: Solution) -> np.ndarray | None:
    """Internal variables at the Gauss points; those of new beams are zero."""
    shape = model.forms.internal_shape
    if not shape[-1]:
        return None
    values, theirs = np.zeros(shape), end_of(start).internal
    elements_of = _elements_of(start)
    for beam, cells in zip(model.scene.beams, model.mesh.cells, strict=True):
        names = [] if beam.section.internal is None else [*beam.section.internal.names]
        if names and beam.name in elements_of:
            has = start.variables_of_beam.get(beam.name, {})
            known = [name for name in has if name not in NAMES.values()]
            if theirs is None or known != names:
                raise SceneError(
                    "start: the solution has other internal variables than the sections of the "
                    f"scene: beam {beam.name!r} has {names}, there it has {known}"
                )
            values[cells, :, : len(names)] = theirs[elements_of[beam.name], :, : len(names)]
    return values


def _natural(model: Model, start: Solution) -> np.ndarray | None:
    """Natural strains at the Gauss points; those of new beams are those of the time."""
    if not model.natural:
        return None
    end, elements_of = end_of(start), _elements_of(start)
    values = model.natural.at(end.t)
    for beam, cells in zip(model.scene.beams, model.mesh.cells, strict=True):
        if (theirs := elements_of.get(beam.name)) is not None:
            values[cells] = 0.0 if end.natural is None else end.natural[theirs]
    return values


def _elements_of(start: Solution) -> dict[str, slice]:
    """Elements of each beam of a solution, in their order, by its name."""
    first, elements_of = 0, {}
    for name, nodes in start.nodes_of_beam.items():
        elements = (len(nodes) - 1) // start.beams[name].degree
        elements_of[name] = slice(first, first + elements)
        first += elements
    return elements_of


def _contacts_before(model: Model, start: Solution, rows: np.ndarray) -> dict[str, str]:
    """Contacts of the scene, and the same ones of the solution, if it has them."""
    left, same = list(start.contacts), dict[str, str]()
    for contact in model.scene.contacts:
        key = _contact_key(contact, lambda node: int(rows[node.number]))
        twins = [one for one in left if _contact_key(one, lambda node: node.number) == key]
        same[str(contact)] = ""
        if twins:
            best = max(
                twins, key=lambda one: (one.shape == contact.shape, one.number == contact.number)
            )
            left.remove(best)
            same[str(contact)] = str(best)
    return same


def _contact_key(contact: Contact, number_of: Callable[[Node], int]) -> tuple:
    """What touches what; members by their names, nodes by their numbers in the solution."""
    shape, target = contact.shape, contact.target
    carrier = None if isinstance(shape, Beam) else shape.carrier
    touched = shape.name if isinstance(shape, Beam) else type(shape).__name__
    return (
        target.name if isinstance(target, Beam) else number_of(target),
        touched,
        None if carrier is None else number_of(carrier),
        contact.along,
        contact.variables,
    )


def _spring_internal(
    model: Model, start: Solution, theirs: dict[int, JointKey], rows: np.ndarray
) -> np.ndarray | None:
    """Internal variables of contacts and springs; those of new ones are zero."""
    if not model.points.width:
        return None
    values, old = np.zeros(model.points.width), end_of(start).spring_internal
    owners = end_of(start).owners
    known = [] if owners is None else owners.tolist()
    places: dict[str, list[int]] = {}
    for at, owner in enumerate(known):
        places.setdefault(owner, []).append(at)
    _check_variables(model, start, theirs)
    contacts = _contacts_before(model, start, rows)
    for at, owner in enumerate(model.points.owners.tolist()):
        of, *words = owner.split(" ")
        if of == "joint":  # which may have had another number
            key = theirs.get(int(words[0]))
            owner = "" if key is None else " ".join([of, str(key.number), *words[1:]])
        owner = contacts.get(owner, owner)
        if old is not None and (columns := places.get(owner)):
            values[at] = old[columns.pop(0)]
    return values


def _check_variables(model: Model, start: Solution, theirs: dict[int, JointKey]) -> None:
    """Refuse springs of joints with other internal variables than before."""
    for joint in model.scene.joints:
        key = theirs.get(joint.number)
        if key is None:
            continue
        names, known = [*joint.internal], [*start.variables_of_joint.get(key.number, {})]
        if names != known:
            raise SceneError(
                "start: the solution has other internal variables than the springs of the "
                f"scene: {joint} has {names}, there it has {known}"
            )
