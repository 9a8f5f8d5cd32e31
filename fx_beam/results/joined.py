"""Two motions, one after the other, as one solution."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.parts import Parts

from .joint_and_contact_motion import columns_of
from .records import BeamBalance, BeamResultants, Energy, Stats
from .state import HISTORIES

# Statistics that add up: counts of steps and iterations, and times.
_SUMS = [part.name for part in fields(Stats) if part.type == "int" and part.default == 0]
_SUMS += ["seconds", "setup_seconds"]


def then(solution, second):
    """Join the motion with one that started from its end.

    For pictures, animations, tables and files of a motion in parts, such as that of a scene which
    changes. The first row of the second motion is left out. A member that exists in only one of the
    motions is at rest in the other motion: before it exists in its reference shape, after it was
    removed in its last shape. Forces of joints, supports and contacts that do not exist are zero,
    slides of joints NaN.

    Parameters
    ----------
    solution : Solution
        The first motion.
    second : Solution
        A motion by ``simulate(..., start=...)`` from its end.

    Returns
    -------
    Solution
        Both motions. Nodes have the numbers of the second motion.

    Raises
    ------
    ValueError
        If the second motion does not start where the first one ends, or one of them is static.

    Examples
    --------
    A mass that is caught by a support.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=0.1)
    >>> scene.set_velocity(ball, (1.0, 0.0))
    >>> flight = fb.simulate(scene, dt=0.1, t_end=0.5)
    >>> scene.pin(ball.centre)
    >>> whole = flight.then(fb.simulate(scene, dt=0.1, t_end=1.0, start=flight))
    >>> whole.t[[0, -1]], whole.position(ball.centre)[-1].round(6)
    (array([0., 1.]), array([0.5, 0. ]))
    >>> whole.energy.impact[[0, -1]], bool(abs(whole.energy.balance_error).max() < 1e-12)
    (array([0. , 0.5]), True)
    """
    _check(solution, second)
    return _JoinedMotion(solution, second).solution()


def _check(first, second) -> None:
    if not isinstance(second, type(first)):
        raise ValueError(f"then needs a solution, not {second!r:.80}")
    if first.stats.static or second.stats.static:
        raise ValueError("then joins motions; rows of a static solution are not times")
    if second.t[0] != first.t[-1]:
        raise ValueError(
            f"the first motion ends at t = {first.t[-1]:g}, but the second one starts at "
            f"t = {second.t[0]:g}. Start it by simulate(..., start=first), and record rows at both"
        )


class _JoinedMotion:
    """Two motions in the numbers of the second one; what only the first has comes behind."""

    def __init__(self, first, second):
        self._first, self._second = first, second
        #: Node (n_node,) of the joined motion for each node of the first one.
        self._nodes = _nodes_of_first(first, second)
        new = self._nodes >= len(second.X)
        self.X = np.vstack([second.X, first.X[new]])
        self._gone = self._nodes[new]
        #: Contacts of the first motion by their numbers there, as the joined one has them.
        self._contacts = self._contacts_of_first()
        all_contacts = [*second.contacts, *self._contacts.values()]
        self._every_contact = [*{contact.number: contact for contact in all_contacts}.values()]
        names = second.names_of_parameters
        self._parameters = [*names, *(n for n in first.names_of_parameters if n not in names)]
        joints = first.slides.shape[1], second.slides.shape[1]
        lines = first.line_forces.shape[1], second.line_forces.shape[1]
        contacts = self._every_contact, self._contacts.values(), second.contacts
        #: For each kind of column ("nodes", "joints", ...): columns in the joined motion of the
        #: first motion's columns, of the second motion's columns, and their number.
        self._columns: dict[object, tuple[np.ndarray, np.ndarray, int]] = {
            "nodes": (self._nodes, np.arange(len(second.X)), len(self.X)),
            "joints": _places(range(max(joints)), *map(range, joints)),
            "lines": _places(range(max(lines)), *map(range, lines)),
            "contacts": _places(*map(_keys, contacts)),
            "parameters": _places(self._parameters, first.names_of_parameters, names),
        }

    def solution(self):
        """Both motions."""
        first, second = self._first, self._second
        end = second.end
        if end is not None:
            _, places, count = self._columns["nodes"]
            spread = {name: _spread(x[None], places, count)[0] for name, x in end.at_nodes.items()}
            end = replace(end, **spread)
        gone = {
            name: replace(beam, nodes=tuple(map(self._node, beam.nodes)))
            for name, beam in first.beams.items()
            if name not in second.beams
        }
        nodes = {name: self._nodes[beam_nodes] for name, beam_nodes in first.nodes_of_beam.items()}
        friction = first.variables_of_contact.items()
        friction = {self._contacts[number].number: rows for number, rows in friction}
        joined = type(first)(
            self._histories(),
            X=self.X,
            energy=Energy(**self._rows(vars(first.energy), vars(second.energy))),
            stats=_stats(first.stats, second.stats),
            beams=second.beams | gone,
            nodes_of_beam=nodes | second.nodes_of_beam,
            resultants_of_beam=self._resultants,
            variables_of_beam=self._variables("variables_of_beam"),
            variables_of_joint=self._variables("variables_of_joint"),
            contacts=self._every_contact,
            bodies=first.bodies | second.bodies,
            end=end,
            names_of_parameters=self._parameters,
            variables_of_contact=self._rows(friction, second.variables_of_contact),
            turns_of_line=self._rows(first.turns_of_line, second.turns_of_line),
        )
        joined.has_own_energy = first.has_own_energy or second.has_own_energy
        joined.parts = self._parts()
        return joined

    def _parts(self) -> tuple[tuple[int, Parts], ...]:
        """Parts of both scenes with their first rows, on the nodes of the joined motion."""
        first, second = self._first.parts, self._second.parts
        if (self._nodes != np.arange(len(self._nodes))).any():
            first = tuple((row, parts.moved(self._node, self._nodes)) for row, parts in first)
        shift = len(self._first.t) - 1
        return *first, *((shift + max(row, 1), parts) for row, parts in second)

    def _histories(self) -> dict[str, np.ndarray]:
        first, second, histories = self._first, self._second, dict[str, np.ndarray]()
        for name, history in HISTORIES.items():
            first_rows, second_rows = getattr(first, name), getattr(second, name)
            if len(first_rows) != len(first.t) or len(second_rows) != len(second.t):
                histories[name] = np.empty((0, *second_rows.shape[1:]))  # one of them has none
                continue
            if history.shape and history.shape[0] in self._columns:
                first_places, second_places, count = self._columns[history.shape[0]]
                first_rows = _spread(first_rows, first_places, count, history.nothing)
                second_rows = _spread(second_rows, second_places, count, history.nothing)
            if name == "q":
                second_rows[:, self._gone] = first_rows[-1, self._gone]
            histories[name] = np.concatenate([first_rows, second_rows[1:]])
        return histories

    def _node(self, node: Node) -> Node:
        """A node of the first motion with its number in the joined one."""
        number = int(self._nodes[node.number])
        return node if number == node.number else Node(number, node.x, node.y, node.scene)

    def _contacts_of_first(self) -> dict[int, Contact]:
        known = {_contact_key(item): item for item in self._second.contacts}
        numbers, contacts = {item.number for item in self._second.contacts}, dict[int, Contact]()
        for item in self._first.contacts:
            moved = item
            if isinstance(item.target, Node):
                moved = replace(moved, target=self._node(item.target))
            if not isinstance(item.shape, Beam) and item.shape.carrier is not None:
                moved = replace(moved, shape=item.shape.at(self._node(item.shape.carrier)))
            match = known.get(_contact_key(moved))
            if match is None and moved.number in numbers:
                moved = replace(moved, number=1 + max(numbers))
            contacts[item.number] = moved if match is None else match
            numbers.add(contacts[item.number].number)
        return contacts

    def _resultants(self, name: str) -> BeamResultants:
        motions = self._first, self._second
        known = [motion.resultants(name) if name in motion.beams else None for motion in motions]
        parts = [{} if r is None else {part: getattr(r, part) for part in "NQM"} for r in known]
        (s, *_) = (r.s for r in known if r is not None)
        return BeamResultants(s, **self._rows(*parts), balance=lambda: self._balance(*known))

    def _balance(self, *known: BeamResultants | None) -> BeamBalance:
        """Of a beam of both motions, or of one; loads inside elements of both."""
        old, new = (None if r is None else r.balanced() for r in known)
        parts = [{} if part is None else {"ends": part.ends} for part in (old, new)]
        places, jumps, rows = [], [], (len(self._first.t), len(self._second.t) - 1)
        for part, first, pads in ((old, 0, (0, rows[1])), (new, 1, (rows[0], 0))):
            if part is not None:
                places.append(part.places)
                jumps.append(np.pad(part.jumps[first:], [pads, (0, 0), (0, 0)]))
        s = (new or old).s  # type: ignore[union-attr]
        all_loads = np.concatenate(places), np.concatenate(jumps, axis=1)
        return BeamBalance(s, self._rows(*parts)["ends"], *all_loads)

    def _variables(self, name: str) -> dict[Any, dict[str, np.ndarray]]:
        old, new = getattr(self._first, name), getattr(self._second, name)
        return {key: self._rows(old.get(key, {}), new.get(key, {})) for key in old | new}

    def _rows(self, first: Mapping, second: Mapping) -> dict[Any, np.ndarray]:
        """Rows of both motions by keys; zero where a motion does not have a key."""
        rows, n, m = {}, len(self._first.t), len(self._second.t)
        for key, example in {**first, **second}.items():
            first_rows = first[key] if key in first else np.zeros((n, *example.shape[1:]))
            second_rows = second[key] if key in second else np.zeros((m, *example.shape[1:]))
            rows[key] = np.concatenate([first_rows, second_rows[1:]])
        return rows


def _nodes_of_first(first, second) -> np.ndarray:
    """Node of the joined motion for each node of the first one."""
    nodes = np.full(len(first.X), -1)
    for name, beam_nodes in first.nodes_of_beam.items():
        if name in second.nodes_of_beam:
            nodes[beam_nodes] = second.nodes_of_beam[name]
    for name, body in first.bodies.items():
        if name in second.bodies:
            nodes[[n.number for n in body.nodes]] = [n.number for n in second.bodies[name].nodes]
    # Nodes of the scene that belong to no member any more have kept their numbers.
    used = set(nodes.tolist())
    used |= {int(n) for name, beam_nodes in second.nodes_of_beam.items() for n in beam_nodes}
    for number in np.flatnonzero(nodes < 0).tolist():
        same_place = number < len(second.X) and (second.X[number] == first.X[number]).all()
        if same_place and number not in used:
            nodes[number] = number
    missing = nodes < 0
    nodes[missing] = len(second.X) + np.arange(np.count_nonzero(missing))
    return nodes


def _keys(contacts: Iterable[Contact]) -> list[tuple[int, int]]:
    """Numbers of contacts and of their points, in the order of the columns of forces."""
    columns = columns_of(contacts).items()
    return [(number, i) for number, part in columns for i in range(part.stop - part.start)]


def _places(keys: Iterable, *motions: Iterable) -> tuple[np.ndarray, np.ndarray, int]:
    """Indices of the keys of two motions among all `keys`, and the number of all keys."""
    place = {key: i for i, key in enumerate(keys)}
    first, second = (np.array([place[key] for key in names], dtype=int) for names in motions)
    return first, second, len(place)


def _spread(rows: np.ndarray, places: np.ndarray, count: int, nothing: float = 0.0) -> np.ndarray:
    """Rows (n, count, ...) with columns of `rows` at `places`, and `nothing` elsewhere."""
    spread = np.full((len(rows), count, *rows.shape[2:]), nothing)
    spread[:, places] = rows
    return spread


def _contact_key(contact: Contact) -> tuple:
    """Identifier of a contact: both sides, and the places."""
    shape = None if isinstance(contact.shape, Beam) else contact.shape
    return str(contact), contact.along, shape


def _stats(first: Stats, second: Stats) -> Stats:
    """Statistics of both motions; why they end is that of the second one."""
    sums = {name: getattr(first, name) + getattr(second, name) for name in _SUMS}
    ended = dict(Counter(first.ended_by) + Counter(second.ended_by))
    changes = {**first.changes, **second.changes}
    worse = max(first, second, key=lambda stats: stats.rounding)
    joined = replace(second, **sums, ended_by=ended, changes=changes)
    return replace(joined, rounding=worse.rounding, rounding_in=worse.rounding_in)
