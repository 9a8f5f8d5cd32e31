"""Two motions, one after the other, as one solution."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact

from .audit import BeamResultants, Energy, Stats
from .contact import columns_of
from .state import HISTORIES

# Statistics that add up.
_SUMS = (
    *("steps", "newton_iterations", "halvings", "substeps", "too_large", "inverted"),
    *("amplified", "rejected", "seconds", "setup_seconds", "krylov_iterations"),
)


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
            f"t = {second.t[0]:g}. Start it by simulate(..., start=first)"
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
        self._contacts = self._contacts_of_first()

    def solution(self):
        """Both motions."""
        first, second = self._first, self._second
        end = second.end
        if end is not None and len(self._gone):
            size = len(self.X)
            named = ("q", "v", "a", "q_previous", "added_forces", "fitted")
            values = {name: getattr(end, name) for name in named}
            padded = {
                name: _padded(value[None], (size,))[0]
                for name, value in values.items()
                if value is not None
            }
            end = replace(end, **padded)
        energies = {
            part.name: _rows(getattr(first.energy, part.name), getattr(second.energy, part.name))
            for part in fields(Energy)
        }
        beams = {name: self._beam(beam) for name, beam in first.beams.items()} | second.beams
        beams = {name: beams[name] for name in [*second.beams, *beams]}
        nodes = {name: self._nodes[of_beam] for name, of_beam in first.nodes_of_beam.items()}
        return type(first)(
            self._histories(),
            X=self.X,
            energy=Energy(**energies),
            stats=_stats(first.stats, second.stats),
            beams=beams,
            nodes_of_beam=nodes | second.nodes_of_beam,
            resultants_of_beam=self._resultants,
            variables_of_beam=self._variables("variables_of_beam"),
            variables_of_joint=self._variables("variables_of_joint"),
            contacts=self._every_contact(),
            bodies=first.bodies | second.bodies,
            end=end,
            names_of_parameters=self._parameters(),
            variables_of_contact=self._variables_of_contact(),
        )

    def _histories(self) -> dict[str, np.ndarray]:
        first, second, histories = self._first, self._second, dict[str, np.ndarray]()
        contacts, parameters = self._every_contact(), self._parameters()
        for name, history in HISTORIES.items():
            one, two = getattr(first, name), getattr(second, name)
            if len(one) != len(first.t) or len(two) != len(second.t):
                histories[name] = np.empty((0, *two.shape[1:]))  # one of them has none
                continue
            if history.shape[:1] == ("nodes",):
                one, two = self._at_nodes(one), _padded(two, (len(self.X),))
                if name == "q":
                    two[:, self._gone] = one[-1, self._gone]
            elif history.shape[:1] == ("joints",):
                most = (max(one.shape[1], two.shape[1]),)
                nothing = np.nan if name == "slides" else 0.0
                one, two = _padded(one, most, nothing), _padded(two, most, nothing)
            elif name == "contact_forces":
                one = _of_contacts([*self._contacts.values()], one, contacts)
                two = _of_contacts(second.contacts, two, contacts)
            elif name == "parameters":
                one, two = (
                    _of_names(of, rows, parameters) for of, rows in ((first, one), (second, two))
                )
            histories[name] = _rows(one, two)
        return histories

    def _at_nodes(self, rows: np.ndarray) -> np.ndarray:
        """Rows of the first motion at all nodes; zero at new ones."""
        every = np.zeros((len(rows), len(self.X), *rows.shape[2:]))
        every[:, self._nodes] = rows
        return every

    def _beam(self, beam: Beam) -> Beam:
        """A beam of the first motion with the numbers of the joined one."""
        return replace(beam, nodes=tuple(map(self._node, beam.nodes)))

    def _node(self, node: Node) -> Node:
        number = int(self._nodes[node.number])
        return node if number == node.number else Node(number, node.x, node.y, node.scene)

    def _contacts_of_first(self) -> dict[int, Contact]:
        """Contacts of the first motion by their numbers there, as the joined one has them."""
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

    def _every_contact(self) -> list[Contact]:
        every = [*self._second.contacts, *self._contacts.values()]
        return [*{one.number: one for one in every}.values()]

    def _parameters(self) -> list[str]:
        names = self._second.names_of_parameters
        return [*names, *(n for n in self._first.names_of_parameters if n not in names)]

    def _resultants(self, name: str) -> BeamResultants:
        parts = [s.resultants_of_beam(name) if name in s.beams else None for s in self._both]
        known = next(part for part in parts if part is not None)
        rows = []
        for part, of in zip(parts, self._both, strict=True):
            none = np.zeros((len(of.t), len(known.s)))
            rows.append([none] * 3 if part is None else [part.N, part.Q, part.M])
        return BeamResultants(known.s, *(_rows(*both) for both in zip(*rows, strict=True)))

    @property
    def _both(self) -> tuple:
        return self._first, self._second

    def _variables_of_contact(self) -> dict[int, np.ndarray]:
        """Rows by numbers; those that one of the motions does not have are zero."""
        first, second = self._both
        one = {self._contacts[n].number: rows for n, rows in first.variables_of_contact.items()}
        return _of_both(one, second.variables_of_contact, len(first.t), len(second.t))

    def _variables(self, name: str) -> dict[Any, dict[str, np.ndarray]]:
        """Rows by two keys; those that one of the motions does not have are zero."""
        one, two = (getattr(of, name) for of in self._both)
        lengths = len(self._first.t), len(self._second.t)
        return {key: _of_both(one.get(key, {}), two.get(key, {}), *lengths) for key in one | two}


def _of_both(one: Mapping, two: Mapping, n: int, m: int) -> dict[Any, np.ndarray]:
    same = {}
    for key in {**one, **two}:
        shape = (one[key] if key in one else two[key]).shape[1:]
        rows = (one.get(key, np.zeros((n, *shape))), two.get(key, np.zeros((m, *shape))))
        same[key] = _rows(*rows)
    return same


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


def _rows(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Rows of both motions, without the start of the second one."""
    return np.concatenate([one, two[1:]])


def _padded(rows: np.ndarray, lengths: tuple[int, ...], nothing: float = 0.0) -> np.ndarray:
    """Rows with zeros, or something else, behind their values, up to some lengths."""
    padded = np.full((len(rows), *lengths, *rows.shape[1 + len(lengths) :]), nothing)
    padded[tuple(slice(n) for n in rows.shape[: 1 + len(lengths)])] = rows
    return padded


def _contact_key(contact: Contact) -> tuple:
    """What touches what, and where."""
    shape = None if isinstance(contact.shape, Beam) else contact.shape
    return str(contact), contact.along, shape


def _of_contacts(before: list[Contact], rows: np.ndarray, contacts: list[Contact]) -> np.ndarray:
    """Forces at the contacts of both motions, from those of one."""
    columns = columns_of(contacts)
    forces = np.zeros((len(rows), max((of.stop for of in columns.values()), default=0), 2))
    for number, of in columns_of(before).items():
        forces[:, columns[number]] = rows[:, of]
    return forces


def _of_names(solution, rows: np.ndarray, names: list[str]) -> np.ndarray:
    """Values of the parameters of both motions, from those of one; NaN for others."""
    values = np.full((len(rows), len(names)), np.nan)
    for i, name in enumerate(solution.names_of_parameters):
        values[:, names.index(name)] = rows[:, i]
    return values


def _stats(first: Stats, second: Stats) -> Stats:
    """Statistics of both motions; why they end is that of the second one."""
    sums = {name: getattr(first, name) + getattr(second, name) for name in _SUMS}
    ended = dict(Counter(first.ended_by) + Counter(second.ended_by))
    changes = {**first.changes, **second.changes}
    return replace(second, **sums, ended_by=ended, changes=changes)
