"""Outputs as functions of a state: each quantity of nodes, joints and lines is defined once."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import Dual, MaybeDual, dual_array, floats

from .beam import Beam, BeamPlace, Node, numbers_along
from .contacts import Contact
from .forces_between import ForceBetween
from .joints import Joint, NodalMotion, axial_rate
from .outputs import Output, component_of, is_gear, quantity_of
from .sliders import SlidingJoint

# Arrays with one entry for each joint or rope; others have three for each node or joint.
_ONE_EACH = "slides", "motor_forces", "line_forces", "line_energies"
#: What forces along lines have by their laws, by the names of arrays.
BY_LAW = {"line_forces": "pull", "line_energies": "energy"}
#: Entries (..., e) of an array of a state by its name, in all rows of a host.
Read = Callable[[str, np.ndarray], Any]
#: Numbers (n,) of all nodes of a beam in order.
NodesOf = Callable[[Beam], np.ndarray]
#: Values (..., components) of numbers (k,) and of entries (..., e) of arrays.
Function = Callable[..., Any]


class Need(NamedTuple):
    """Entries (e,) of an array of the state."""

    array: str
    entries: np.ndarray


class Slope(NamedTuple):
    """Derivatives (n, components, e) by entries of an array, in n rows, or one for all rows.

    By the numbers of the output, if the array is empty.
    """

    array: str
    entries: np.ndarray
    values: np.ndarray


class Definition(NamedTuple):
    """A quantity y = f(n, u) of numbers n of the scene, and of entries u of the state."""

    needs: tuple[Need, ...]
    function: Function
    #: Whether it is linear in the state, for the same numbers.
    is_linear: bool = True


class Measured:
    """An output y = f(n, u): its value in rows of a host, and its derivatives there.

    This is all that solutions, motions, linear systems and derivatives know of it. What an array
    is, and how it depends on others, is known to the host: forces are means over a step.
    """

    def __init__(self, output: Output, nodes_of: NodesOf | None = None):
        place: Any = output.of
        quantity = quantity_of(output)
        #: The output, and where it is measured.
        self.output, self.place = output, place
        self.name, self.quantity = output.quantity, quantity
        count, index = len(quantity.components), component_of(output)
        #: The component, or all of them.
        self.component = slice(None) if index is None else index
        #: Lengths of a value; none of a single number.
        self.shape = (count,) if count and index is None else ()
        columns = quantity.column + (np.arange(count) if self.shape else np.array([index or 0]))
        #: The contact whose gap or force it is; else None.
        self.contact: Contact | None = place if isinstance(place, Contact) else None
        #: Of a line what only its laws have: "pull" or "energy"; else empty.
        self.law_quantity = BY_LAW.get(quantity.of, "")
        definition = _definition(self.name, quantity, place, columns, nodes_of or numbers_along)
        self.needs, self._function, self.is_linear = definition
        self._floats = floats(numbers_of(output))
        #: Of the rate of a node that slides on a beam, the joint, in whose fit of rates it is.
        self.sliding: Joint | None = None
        if isinstance(place, SlidingJoint) and quantity.is_rate:
            self.sliding = place

    @property
    def counts_turns(self) -> bool:
        """Whether it is the length of a rope over pulleys, whose spans turn."""
        return self.name == "length" and bool(getattr(self.place, "kinds", ""))

    def values(self, read: Read, counted: np.ndarray | None = None) -> Any:
        """Values (..., components) or (...); `counted` half turns if it counts them."""
        parts = [read(*need) for need in self.needs]
        y = self._function(self._floats, *parts, *([counted] if self.counts_turns else []))
        return y if self.shape else y[..., 0]

    def slopes(
        self, read: Read | None = None, counted: np.ndarray | None = None
    ) -> Iterator[Slope]:
        """Derivatives that are not zero, with half turns; without `read` of what `is_constant`."""
        k = len(self._floats)
        if self.is_linear:
            yield from self._constant_slopes
            if k:
                assert read is not None
                numbers = Dual(self._floats, np.eye(k))
                by_numbers = self._function(numbers, *(read(*need) for need in self.needs))
                yield Slope("", np.arange(k), np.reshape(by_numbers.slopes, (-1, self._count, k)))
            return
        assert read is not None
        parts = [np.reshape(read(*need), (-1, len(need.entries))) for need in self.needs]
        arrays = [Need("", np.arange(k)), *self.needs]
        ends = np.cumsum([0, *(len(need.entries) for need in arrays)]).tolist()
        units, duals = np.eye(ends[-1]), list[Dual]()
        for x, a, b in zip([self._floats, *parts], ends[:-1], ends[1:], strict=True):
            duals.append(Dual(x, np.broadcast_to(units[a:b], (*x.shape, ends[-1]))))
        slopes = self._function(*duals, *([counted] if self.counts_turns else [])).slopes
        for (array, entries), a, b in zip(arrays, ends[:-1], ends[1:], strict=True):
            if slopes[..., a:b].any():
                yield Slope(array, entries, slopes[..., a:b])

    @property
    def is_constant(self) -> bool:
        """Whether its derivatives are the same in every state."""
        return self.is_linear and not len(self._floats)

    @property
    def _count(self) -> int:
        return self.shape[0] if self.shape else 1

    @cached_property
    def _constant_slopes(self) -> list[Slope]:
        slopes, zeros = list[Slope](), [np.zeros(len(entries)) for _, entries in self.needs]
        for i, (array, entries) in enumerate(self.needs):
            units = [*zeros[:i], np.eye(len(entries)), *zeros[i + 1 :]]
            slopes.append(Slope(array, entries, self._function(self._floats, *units).T[None]))
        return slopes


def numbers_of(output: Output) -> MaybeDual:
    """Numbers (k,) of the scene of which an output is a function, with slopes that they have."""
    place: Any = output.of
    quantity = quantity_of(output)
    if isinstance(place, BeamPlace):
        return dual_array([place.element[1]])
    if quantity.of in ("q", "v") and isinstance(place, ForceBetween):
        return dual_array(place.geometry)
    if quantity.is_rate and place.axis is not None:
        return dual_array([*place.offset, *place.axis])
    return np.empty(0)


def _definition(
    name: str, quantity, place: Any, columns: np.ndarray, nodes_of: NodesOf
) -> Definition:
    """The definition of a quantity at a place; of scenes, beams and contacts it is elsewhere."""
    array = quantity.of
    if isinstance(place, Node):
        return _of_node(quantity, place, columns)
    if isinstance(place, BeamPlace):
        return _of_place(quantity, place, columns, nodes_of)
    if is_gear(place):
        return _entries(array, np.array([3 * place.number + place.column]))
    if array in _ONE_EACH and isinstance(place, Joint | ForceBetween):
        return _entries(array, np.array([place.number]))
    if isinstance(place, Joint):
        if array not in ("q", "v"):
            return _entries(array, 3 * place.number + columns)
        if isinstance(place, SlidingJoint):
            return _of_slider(name, place, nodes_of)
        if quantity.is_rate and place.axis is not None:
            return _rate_of_slide(place)
        return _of_joint(array, place, columns)
    if isinstance(place, ForceBetween):
        return _along(array, place) if place.to_ground else _of_line(name, place)
    return Definition((), lambda numbers: numbers)


def _entries(array: str, entries: np.ndarray) -> Definition:
    """The entries themselves."""
    return Definition((Need(array, entries),), lambda numbers, u: u)


def _of_node(quantity, node: Node, columns: np.ndarray) -> Definition:
    needs = Need(quantity.of, 3 * node.number + columns), Need("X", 2 * node.number + columns)
    if quantity.is_place:
        return Definition(needs, lambda numbers, u, X: X + u)
    return Definition(needs[:1], lambda numbers, u: u)


def _of_place(quantity, place: BeamPlace, columns: np.ndarray, nodes_of: NodesOf) -> Definition:
    """By the polynomials of an element's nodes; its number is the place in the element."""
    if quantity.of not in ("q", "v"):
        return Definition((), lambda numbers: numbers)  # a section force
    nodes, count = nodes_of(place.beam)[place.nodes].tolist(), len(columns)
    needs = [Need(quantity.of, np.concatenate([3 * node + columns for node in nodes]))]
    if quantity.is_place:
        needs.append(Need("X", np.concatenate([2 * node + columns for node in nodes])))

    def function(numbers, u, X=0.0):
        x, u = numbers[0] * (len(nodes) - 1), u + X
        total = 0.0
        for i in range(len(nodes)):
            share = math.prod((x - j) / (i - j) for j in range(len(nodes)) if j != i)
            total = total + share * u[..., i * count : (i + 1) * count]
        return total

    return Definition(tuple(needs), function)


class _Moving:
    """Some nodes, of which definitions read components; those of the ground are zero."""

    def __init__(self, nodes: Iterable[int], columns: Sequence[int] = (0, 1, 2)):
        numbers = sorted({number for number in nodes if number >= 0})
        places = [(number, column) for number in numbers for column in columns]
        self._entries = np.array([3 * number + column for number, column in places])
        self._at = {place: k for k, place in enumerate(places)}

    def need(self, array: str) -> Need:
        """What is read of an array."""
        return Need(array, self._entries)

    def of(self, u: Any, node: int, column: int) -> Any:
        """A component (...) of a node."""
        return u[..., self._at[node, column]] if node >= 0 else 0.0

    def apart(self, u: Any, a: int, b: int, column: int) -> Any:
        """The same of b relative to a."""
        return self.of(u, b, column) - self.of(u, a, column)


def _of_joint(array: str, joint: Joint, columns: np.ndarray) -> Definition:
    """Rotation or spin of b relative to a."""
    a, b, (column,) = joint.a.number, joint.b.number, columns.tolist()
    nodes = _Moving((a, b), (column,))
    return Definition(
        (nodes.need(array),), lambda numbers, u: nodes.apart(u, a, b, column)[..., None]
    )


def _rate_of_slide(joint: Joint) -> Definition:
    """By offset and axis, the slide, rotation and spin of a, and the velocities of both."""
    a, b = joint.a.number, joint.b.number
    nodes = _Moving((a, b))

    def function(numbers, slide, q, v):
        turning = nodes.of(q, a, 2), nodes.of(v, a, 2)
        moving = (nodes.apart(v, a, b, i) for i in (0, 1))
        places = numbers[:2], numbers[2:], slide[..., 0]
        return axial_rate(joint.track, *places, *turning, *moving)[..., None]

    needs = Need("slides", np.array([joint.number])), nodes.need("q"), nodes.need("v")
    return Definition(needs, function, is_linear=False)


def _of_slider(name: str, joint: SlidingJoint, nodes_of: NodesOf) -> Definition:
    """The angle of a node that slides on a beam, or a rate: by all nodes of the beam.

    Values alone: of the rate derivatives are those of the fit of rates.
    """
    nodes = np.append(joint.b.number, nodes_of(joint.beam))
    entries = (3 * nodes[:, None] + np.arange(3)).ravel()

    arrays = "q" if name == "angle" else "qv"

    def function(numbers, slide, *parts):
        pairs = zip(arrays, parts, strict=True)
        rows = {array: np.reshape(u, (-1, len(nodes), 3)) for array, u in pairs}
        motion = NodalMotion(
            lambda array, node: rows[array][:, 0].T, lambda array, beam: rows[array][:, 1:]
        )
        return getattr(joint.kinematics, name)(motion, np.atleast_1d(slide[..., 0]))[..., None]

    needs = Need("slides", np.array([joint.number])), *(Need(array, entries) for array in arrays)
    return Definition(needs, function, is_linear=False)


def _of_line(name: str, line: Any) -> Definition:
    """Length or rate of a line, or the angles of its arcs."""
    nodes, ends = _Moving(line.nodes), [line.nodes[0], line.nodes[-1]]
    kinds = line.kinds[:1], line.kinds[-1:]
    drums = [number if kind == "D" else -1 for number, kind in zip(ends, kinds, strict=True)]

    def motion(u) -> tuple[list, list]:
        """Changes (x, y) of vectors along the line, and rotations of drums at its ends."""
        pairs = itertools.pairwise(line.nodes)
        moved = [[nodes.apart(u, a, b, i) for i in (0, 1)] for a, b in pairs]
        return moved, [nodes.of(u, number, 2) for number in drums]

    def rate(numbers, q, v):
        return line.rate(numbers, motion(q)[0], *motion(v))[..., None]

    def length(numbers, q, counted=None):
        return line.length(numbers, *motion(q), counted)[..., None]

    def wrap(numbers, q, counted=None):
        arcs = np.broadcast_arrays(0.0 * q[..., 0], *line.arcs(numbers, *motion(q), counted))[1:]
        return np.stack(arcs, axis=-1) * np.sign(line.radii)

    functions: dict[str, Function] = {"rate": rate, "length": length, "wrap": wrap}
    needs = tuple(map(nodes.need, "qv" if name == "rate" else "q"))
    return Definition(needs, functions[name], is_linear=False)


def wraps(line: Any, read: Read, counted: np.ndarray | None) -> np.ndarray:
    """Angles (..., points) over which a rope lies on its pulleys [rad]; half turns of its spans."""
    needs, function, _ = _of_line("wrap", line)
    return function(floats(dual_array(line.geometry)), *(read(*need) for need in needs), counted)


def _along(array: str, line: Any) -> Definition:
    """Displacement or rotation that a spring to the ground resists, or its rate."""
    node = line.target
    if line.direction is None:
        return _entries(array, np.array([3 * node.number + 2]))
    needs = (Need(array, 3 * node.number + np.arange(2)),)

    def function(way, u):
        return (way[0] * u[..., 0] + way[1] * u[..., 1])[..., None]

    return Definition(needs, function)
