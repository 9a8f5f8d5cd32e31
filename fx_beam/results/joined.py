"""Two motions, one after the other, as one solution."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact

from .contact_gaps import columns_of
from .records import BeamResultants, Energy, Stats
from .section_forces import Balance
from .state import HISTORIES

# Statistics that add up: counts of steps and iterations, and times.
_SUMS = [part.name for part in fields(Stats) if part.type == "int" and part.default == 0]
_SUMS += ["seconds", "setup_seconds"]


def then(solution, second):
    """Join the motion with one that started from its end.

    For pictures, animations, tables and files of a motion in parts, such as one of a scene that
    changes. The row at which the second motion starts is left out. Members that exist in one of
    them only rest in the other one: before, in their reference shape; later, where they were last.
    Forces of joints, supports and contacts that do not exist are zero, slides of joints NaN.

    Parameters
    ----------
    solution : Solution
        The first motion.
    second : Solution
        A motion by ``simulate(..., start=...)`` from its end.

    Returns
    -------
    Solution
        Both motions. Nodes have the numbers of the second one.

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
    return _Joined(solution, second).solution()


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


class _Joined:
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
        every = [*second.contacts, *self._contacts.values()]
        self._every_contact = [*{contact.number: contact for contact in every}.values()]
        names = second.names_of_parameters
        self._parameters = [*names, *(n for n in first.names_of_parameters if n not in names)]
        joints = first.slides.shape[1], second.slides.shape[1]
        lines = first.line_forces.shape[1], second.line_forces.shape[1]
        contacts = self._every_contact, self._contacts.values(), second.contacts
        #: Columns of rows in the joined motion, by what they are of: those of the first motion,
        #: those of the second one, and the number of all.
        self._columns: dict[Any, tuple[np.ndarray, np.ndarray, int]] = {
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
            _, at, count = self._columns["nodes"]
            spread = {name: _spread(of[None], at, count)[0] for name, of in end.at_nodes.items()}
            end = replace(end, **spread)
        gone = {
            name: replace(beam, nodes=tuple(map(self._node, beam.nodes)))
            for name, beam in first.beams.items()
            if name not in second.beams
        }
        nodes = {name: self._nodes[of_beam] for name, of_beam in first.nodes_of_beam.items()}
        friction = first.variables_of_contact.items()
        friction = {self._contacts[number].number: rows for number, rows in friction}
        return type(first)(
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
        )

    def _histories(self) -> dict[str, np.ndarray]:
        first, second, histories = self._first, self._second, dict[str, np.ndarray]()
        for name, history in HISTORIES.items():
            one, two = getattr(first, name), getattr(second, name)
            if len(one) != len(first.t) or len(two) != len(second.t):
                histories[name] = np.empty((0, *two.shape[1:]))  # one of them has none
                continue
            if history.shape and history.shape[0] in self._columns:
                of_first, of_second, count = self._columns[history.shape[0]]
                one = _spread(one, of_first, count, history.nothing)
                two = _spread(two, of_second, count, history.nothing)
            if name == "q":
                two[:, self._gone] = one[-1, self._gone]
            histories[name] = np.concatenate([one, two[1:]])
        return histories

    def _node(self, node: Node) -> Node:
        """A node of the first motion with its number in the joined one."""
        number = int(self._nodes[node.number])
        return node if number == node.number else Node(number, node.x, node.y, node.scene)

    def _contacts_of_first(self) -> dict[int, Contact]:
        known = {_contact_key(one): one for one in self._second.contacts}
        numbers, contacts = {one.number for one in self._second.contacts}, dict[int, Contact]()
        for one in self._first.contacts:
            moved = one
            if isinstance(one.target, Node):
                moved = replace(moved, target=self._node(one.target))
            if not isinstance(one.shape, Beam) and one.shape.carrier is not None:
                moved = replace(moved, shape=one.shape.at(self._node(one.shape.carrier)))
            same = known.get(_contact_key(moved))
            if same is None and moved.number in numbers:
                moved = replace(moved, number=1 + max(numbers))
            contacts[one.number] = moved if same is None else same
            numbers.add(contacts[one.number].number)
        return contacts

    def _resultants(self, name: str) -> BeamResultants:
        both = self._first, self._second
        known = [of.resultants(name) if name in of.beams else None for of in both]
        parts = [{} if of is None else {part: getattr(of, part) for part in "NQM"} for of in known]
        (s, *_) = (of.s for of in known if of is not None)
        return BeamResultants(s, **self._rows(*parts), balance=lambda: self._balance(*known))

    def _balance(self, *known: BeamResultants | None) -> Balance:
        """Of a beam of both motions, or of one; loads inside elements of both."""
        one, two = (None if of is None else of.balanced() for of in known)
        parts = [{} if of is None else {"ends": of.ends} for of in (one, two)]
        places, jumps, rows = [], [], (len(self._first.t), len(self._second.t) - 1)
        for of, first, (before, after) in ((one, 0, (0, rows[1])), (two, 1, (rows[0], 0))):
            if of is not None:
                places.append(of.places)
                jumps.append(np.pad(of.jumps[first:], [(before, after), (0, 0), (0, 0)]))
        s = (two or one).s  # type: ignore[union-attr]
        every = np.concatenate(places), np.concatenate(jumps, axis=1)
        return Balance(s, self._rows(*parts)["ends"], *every)

    def _variables(self, name: str) -> dict[Any, dict[str, np.ndarray]]:
        one, two = getattr(self._first, name), getattr(self._second, name)
        return {key: self._rows(one.get(key, {}), two.get(key, {})) for key in one | two}

    def _rows(self, one: Mapping, two: Mapping) -> dict[Any, np.ndarray]:
        """Rows of both motions by keys; those that one of them does not have are zero."""
        rows, n, m = {}, len(self._first.t), len(self._second.t)
        for key, like in {**one, **two}.items():
            before = one[key] if key in one else np.zeros((n, *like.shape[1:]))
            after = two[key] if key in two else np.zeros((m, *like.shape[1:]))
            rows[key] = np.concatenate([before, after[1:]])
        return rows


def _nodes_of_first(first, second) -> np.ndarray:
    """Node of the joined motion for each node of the first one."""
    nodes = np.full(len(first.X), -1)
    for name, of_beam in first.nodes_of_beam.items():
        if name in second.nodes_of_beam:
            nodes[of_beam] = second.nodes_of_beam[name]
    for name, body in first.bodies.items():
        if name in second.bodies:
            nodes[[n.number for n in body.nodes]] = [n.number for n in second.bodies[name].nodes]
    # Nodes of the scene that belong to no member any more have kept their numbers.
    used = set(nodes.tolist())
    used |= {int(n) for name, of_beam in second.nodes_of_beam.items() for n in of_beam}
    for number in np.flatnonzero(nodes < 0).tolist():
        same = number < len(second.X) and (second.X[number] == first.X[number]).all()
        if same and number not in used:
            nodes[number] = number
    missing = nodes < 0
    nodes[missing] = len(second.X) + np.arange(np.count_nonzero(missing))
    return nodes


def _keys(contacts: Iterable[Contact]) -> list[tuple[int, int]]:
    """Numbers of contacts and of their points, in the order of the columns of forces."""
    columns = columns_of(contacts).items()
    return [(number, i) for number, of in columns for i in range(of.stop - of.start)]


def _places(keys: Iterable, *motions: Iterable) -> tuple[Any, Any, int]:
    """Places of the columns of two motions among those with these keys, and their number."""
    place = {key: i for i, key in enumerate(keys)}
    first, second = (np.array([place[key] for key in of], dtype=int) for of in motions)
    return first, second, len(place)


def _spread(rows: np.ndarray, at: np.ndarray, count: int, nothing: float = 0.0) -> np.ndarray:
    """Rows whose columns are at some places among a count, with nothing in the others."""
    spread = np.full((len(rows), count, *rows.shape[2:]), nothing)
    spread[:, at] = rows
    return spread


def _contact_key(contact: Contact) -> tuple:
    """What touches what, and where."""
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
