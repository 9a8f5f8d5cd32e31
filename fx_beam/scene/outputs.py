"""Outputs: all quantities in one table, where they are measured, and their definitions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import Dual, MaybeDual, dual_array, floats
from fx_beam.errors import is_one_of, require

from .beam import Beam, BeamPlace, Node, numbers_along
from .contacts import Contact
from .forces_between import ForceBetween
from .joints import Joint, NodalMotion, axial_rate
from .loads import check_node
from .removal import own_joint
from .scene import Scene
from .section import stress_weights
from .sliders import SlidingJoint

if TYPE_CHECKING:
    from .gears import Gear


# -- Outputs: all quantities in one table, and where they may be measured -----------------------


class Quantity(NamedTuple):
    """A quantity that can be measured, for solutions, motions, linear systems and derivatives.

    `measured` has it as a function of the state.
    """

    #: Its SI unit; "N, N m" if that of a moment differs, "m or rad" if that of a rotation does.
    unit: str
    components: tuple[str, ...] = ()
    #: Name of the history, or part of the energy, that has the quantity (of a joint: history of
    #: node b less that of node a); first column in the history.
    of: str = ""
    column: int = 0
    #: Whether it is a place, to which that in the reference configuration is added.
    is_place: bool = False
    #: Whether it is that of a slide, if the joint has one, which is not linear.
    is_rate: bool = False

    @property
    def columns(self) -> slice | int:
        """Its columns in the history of a node."""
        first, count = self.column, len(self.components)
        return slice(first, first + count) if count else first


_PLANE, _FORCE = ("x", "y"), ("x", "y", "moment")
CRITICAL_LOAD, PERIOD = "critical_load", "period"
#: Quantities of nodes, joints, forces between points, scenes and beams by name.
OF_NODES: dict[str, Quantity] = {
    "position": Quantity("m", _PLANE, "q", is_place=True),
    "displacement": Quantity("m", _PLANE, "q"),
    "rotation": Quantity("rad", of="q", column=2),
    "velocity": Quantity("m/s", _PLANE, "v"),
    "spin": Quantity("rad/s", of="v", column=2),
    "acceleration": Quantity("m/s^2", _PLANE, "a"),
    "reaction": Quantity("N, N m", _FORCE, "reactions"),
}
SECTION_FORCES = "section_forces"
_RESULTANTS = {"N": "N", "Q": "N", "M": "N m"}
#: Quantities of places that are sums of N, Q and M.
STRESSES = "stress", "shear_stress"
EDGES = "lower", "upper"
OF_PLACES = {
    name: OF_NODES[name] for name in ("position", "displacement", "rotation", "velocity", "spin")
} | {name: Quantity(unit, of=SECTION_FORCES) for name, unit in _RESULTANTS.items()}
OF_PLACES |= {name: Quantity("Pa", of=SECTION_FORCES) for name in STRESSES}
OF_JOINTS: dict[str, Quantity] = {
    "angle": Quantity("rad", of="q", column=2),
    "slide": Quantity("m", of="slides"),
    "spin": Quantity("rad/s", of="v", column=2),
    "rate": Quantity("m/s or rad/s", of="v", column=2, is_rate=True),
    "force": Quantity("N, N m", _FORCE, "joint_forces"),
    "motor_force": Quantity("N or N m", of="motor_forces"),
}
OF_LINES: dict[str, Quantity] = {
    "force": Quantity("N or N m", of="line_forces"),
    "length": Quantity("m or rad", of="q"),
    "rate": Quantity("m/s or rad/s", of="v"),
    "energy": Quantity("J", of="line_energies"),
}
# Its nodes have lengths and rates of their own.
OF_BEDS = {name: OF_LINES[name] for name in ("force", "energy")}
OF_CONTACTS: dict[str, Quantity] = {
    "force": Quantity("N", _PLANE, "contact_forces"),
    "gap": Quantity("m", of="gaps"),
}
OF_GEARS: dict[str, Quantity] = {"force": Quantity("N or N m", of="joint_forces")}
_ENERGIES = "kinetic strain potential springs total dissipated".split()
OF_SCENES = {f"{part.removesuffix('s')}_energy": Quantity("J", of=part) for part in _ENERGIES}
OF_SCENES["work"] = Quantity("J", of="work")
#: Single numbers of a whole path, and of a periodic motion.
SINGLE = {CRITICAL_LOAD: Quantity("1"), PERIOD: Quantity("s")}
OF_SCENES |= SINGLE
OF_BEAMS = {name: Quantity(unit, of="resultants") for name, unit in _RESULTANTS.items()}
_OF_CLASSES: dict[type, dict[str, Quantity]] = {
    Scene: OF_SCENES,
    Beam: OF_BEAMS,
    Joint: OF_JOINTS,
    ForceBetween: OF_LINES,
    Contact: OF_CONTACTS,
    Node: OF_NODES,
    BeamPlace: OF_PLACES,
}


@dataclass(frozen=True)
class Output:
    """A quantity of a part of the scene that `Motion` measures and `linearise` observes.

    `Solution.value` gives its rows. Responses take further ones: energies of the scene and stress
    resultants of beams, the critical load (`StaticResponse`) and the period (`PeriodicResponse`).

    - of a node: "position" [m], "displacement" [m], "rotation" [rad], "velocity" [m/s], "spin"
      [rad/s], "acceleration" [m/s^2], "reaction" [N, N m]
    - of any place of a beam, ``beam.at(s)``: the first five of a node, and section forces "N" [N],
      "Q" [N], "M" [N m] from the balance of its element, as `BeamResultants.at` has them, with
      "stress" [Pa] at an edge and "shear_stress" [Pa], as `BeamStress` has them: for solutions and
      responses, and for motions that record each step, also in `until`
    - of a joint: "angle" [rad], "slide" [m], "spin" [rad/s], "rate" [m/s or rad/s], "force" [N, N
      m], "motor_force" [N or N m]
    - of a rope, a force between points or a spring to the ground: "length" [m or rad] and its
      "rate" [m/s or rad/s], its "force" [N or N m], a pull, and the "energy" [J] of its spring and
      stops; of a bed only the last two
    - of a contact, for motions alone: "gap" [m], the least one of all its points, and "force" [N],
      the sum of those on them
    - of a gear or rack: "force" [N m or N]
    - of a scene: "kinetic_energy" [J], "strain_energy" [J], "potential_energy" [J], "spring_energy"
      [J], "total_energy" [J], "dissipated_energy" [J], "work" [J], "critical_load" [1], "period"
      [s]
    - of a beam: "N" [N], "Q" [N], "M" [N m]

    The quantities have the names and meanings of `Solution`, `JointMotion` and `Energy`.
    "spring_energy" includes stops and obstacles; "total_energy" is the sum of the four energies
    before it; "work" and "dissipated_energy" count from the start. The resultants of a beam are
    those at all its Gauss points. "critical_load", a single number, is the load factor at the first
    critical point of a `StaticResponse`: a limit point, a bifurcation or flutter. "period" is that
    of the motion of a `PeriodicResponse`.

    Parameters
    ----------
    quantity : str
        Name of the quantity.
    of : Node, BeamPlace, Joint, ForceBetween, Contact, Gear, Scene or Beam
        The part of the scene that has the quantity.
    component : {"x", "y", "moment"}, optional
        One component of a quantity that has several; by default all components.
    edge : {"lower", "upper"}, optional
        The edge of the section at which a "stress" is wanted.

    Raises
    ------
    SceneError
        For a quantity that the node, joint or scene does not have, or an unknown component.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> arm = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=10.0), elements=1)
    >>> speed = fb.Output("velocity", arm.end, "y")
    >>> print(speed, speed.unit, speed.label, sep="; ")
    velocity.y of node 1 at (1, 0); m/s; velocity y of node 1 at (1, 0) [m/s]
    """

    quantity: str
    of: Node | BeamPlace | Joint | ForceBetween | Contact | Gear | Scene | Beam
    component: str | None = None
    edge: str | None = None

    def __post_init__(self):
        ok = isinstance(self.of, (*_OF_CLASSES,)) or is_gear(self.of)
        expected = "a node, a place, a joint, a rope, a contact, a scene or a beam"
        require(ok, "Output: of", self.of, expected)
        known = quantities_of(self.of)
        if not is_one_of(self.quantity, known):  # texts take time
            expected = f"one of {list(known)} for {self._place}"
            require(False, "Output: quantity", self.quantity, expected)
        parts = known[self.quantity].components
        if self.component is not None and not is_one_of(self.component, parts):
            expected = f"one of {list(parts)}" if parts else "left out: it is a single number"
            require(False, f"Output: component of {self.quantity!r}", self.component, expected)
        if self.quantity == "stress" or self.edge is not None:
            is_stress = self.quantity == "stress"
            expected = "'lower' or 'upper'" if is_stress else "left out: it is that of a stress"
            ok = is_stress and is_one_of(self.edge, EDGES)
            require(ok, f"Output: edge of {self.quantity!r}", self.edge, expected)

    def __str__(self):
        part = self.component or self.edge
        return f"{self.quantity}{f'.{part}' if part else ''} of {self._place}"

    @property
    def _place(self) -> str:
        if isinstance(self.of, Beam):
            return self.of.name
        return "the scene" if isinstance(self.of, Scene) else str(self.of)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components; empty for a single number."""
        return () if self.component else quantity_of(self).components

    @property
    def unit(self) -> str:
        """SI unit of the values; "N, N m" for forces with their moment."""
        units = quantity_of(self).unit.split(" or ")
        unit = units[-1 if self._turns else 0]
        if self.component is None:
            return unit
        return unit.split(", ")[-1 if self.component == "moment" else 0]

    @property
    def label(self) -> str:
        """Name for columns of tables and axes of pictures, with the unit."""
        part = self.component or self.edge
        name = self.quantity.replace("_", " ") + (f" {part}" if part else "")
        return f"{name} of {self._place} [{self.unit}]"

    @property
    def _turns(self) -> bool:
        """Whether it is of a coordinate that is an angle."""
        place: Any = self.of
        if isinstance(place, Joint):
            driven = place.driven if self.quantity == "motor_force" else []
            return "slide" not in (driven or place.coordinates)
        if is_gear(place):
            return place.driven == "rotation"
        return isinstance(place, ForceBetween) and getattr(place, "direction", place) is None


def quantities_of(place: Any) -> dict[str, Quantity]:
    """Quantities of a part of a scene by name."""
    if is_gear(place):
        return OF_GEARS
    if isinstance(place, ForceBetween) and place.is_bed:
        return OF_BEDS
    return next(known for kind, known in _OF_CLASSES.items() if isinstance(place, kind))


def quantity_of(output: Output) -> Quantity:
    """Where the values of an output come from."""
    return quantities_of(output.of)[output.quantity]


def component_of(output: Output) -> int | None:
    """Number of its component; None for all, or a single number."""
    parts = quantity_of(output).components
    return None if output.component is None else parts.index(output.component)


def is_section_force(output: object) -> bool:
    """Whether it is an output that follows from the balance of an element."""
    if not isinstance(output, Output) or not isinstance(output.of, BeamPlace):
        return False
    return quantity_of(output).of == SECTION_FORCES


def section_weights(output: Output) -> MaybeDual:
    """Shares (3,) of N, Q and M in an output of a section, with slopes that they have."""
    place = output.of
    assert isinstance(place, BeamPlace)
    if output.quantity not in STRESSES:
        return np.eye(3)["NQM".index(output.quantity)]
    fraction = min(max(place.s / place.beam.length, 0.0), 1.0)
    return stress_weights(place.beam.section, output.quantity, output.edge, fraction)


def section_value(output: Output, N: Any, Q: Any, M: Any) -> Any:
    """Value of an output of a section, from its forces."""
    if output.quantity not in STRESSES:
        return {"N": N, "Q": Q, "M": M}[output.quantity]
    weights = floats(section_weights(output))
    return weights[0] * N + weights[1] * Q + weights[2] * M


def is_gear(place: object) -> bool:
    """Whether it is a gear; its class is not loaded for scenes without any."""
    return hasattr(type(place), "terms")


def check_has_rows(output: object) -> None:
    """Refuse what is no output, and single numbers of a whole path or motion."""
    name = "Solution.value: output"
    require(isinstance(output, Output), name, output, "an fx_beam.Output")
    assert isinstance(output, Output)
    owners = "critical_load is that of a StaticResponse, period of a PeriodicResponse"
    require(output.quantity not in SINGLE, name, str(output), f"one of rows: {owners}")


def check_differentiable(output: Output, name: str) -> None:
    """Refuse outputs without derivatives by their kind: what touches jumps where it does so."""
    expected = (
        "of a node, a joint, a rope, a beam or the scene: those of contacts have no derivatives. "
        "The gap is a function of positions of nodes, which have"
    )
    require(not isinstance(output.of, Contact), name, str(output), expected)


def check_outputs(scene, outputs, subject: str) -> None:
    """Refuse outputs that are no dictionary of outputs of the scene."""
    ok = isinstance(outputs, Mapping) and all(isinstance(name, str) for name in outputs)
    require(ok, subject, outputs, "a dictionary of fx_beam.Output by names")
    for name, output in outputs.items():
        label = f"{subject}[{name!r}]"
        ok = isinstance(output, Output) and not isinstance(output.of, Beam | Scene)
        require(ok, label, output, "an fx_beam.Output of a node, a joint, a rope or a contact")
        check_output(scene, output, label)


def check_linear(scene, outputs, caller: str) -> None:
    """Refuse outputs that do not change with small loads, or of which statics knows nothing."""
    check_outputs(scene, outputs, f"{caller}: outputs")
    for name, output in outputs.items():
        label = f"{caller}: output {name!r}"
        check_differentiable(output, label)
        ok = quantity_of(output).of not in ("v", "line_energies")
        require(ok, label, str(output), "no rate and no energy, but a place, a force or a stress")


def check_output(scene, output: Output, name: str) -> None:
    """Refuse an output of another scene or of its nodes and joints, or one that its joint lacks."""
    if isinstance(output.of, Node):
        check_node(scene, output.of, name)
        return
    expected = _place_in(scene, output)
    require(not expected, name, str(output), expected)


def _place_in(scene: Scene, output: Output) -> str:
    """Place that an output must have in a scene; empty if it has it."""
    place: Any = output.of
    if isinstance(place, Scene):
        return "" if place is scene else "of the scene of the motion"
    if isinstance(place, Beam | BeamPlace):
        beam = place if isinstance(place, Beam) else place.beam
        return "" if scene.beams.has(beam) else "of a beam of this scene"
    if isinstance(place, Joint):
        joint = own_joint(scene, place)
        other = "of a joint that add_joint of this scene returned"
        return other if joint is None else lack(joint, output.quantity)
    parts: list = scene.forces_between
    noun = "rope that add_rope"
    if is_gear(place):
        parts, noun = scene.gears, "gear that add_joint"
    elif isinstance(place, Contact):
        parts, noun = scene.contacts, "contact that add_contact"
    is_there = str(place) in map(str, parts)  # also of a copy
    return "" if is_there else f"of a {noun} of this scene returned"


def lack(joint: Joint, quantity: str) -> str:
    """Joint that an output of a quantity must be of, if not of this one; else empty."""
    if isinstance(joint, SlidingJoint) and quantity in ("angle", "spin"):
        return "of another joint; measure the rotation of the node that slides"
    if quantity == "slide" and joint.slide is None:
        return "of a joint with a slide"
    return "of a joint with a motor" if quantity == "motor_force" and not joint.driven else ""


# -- Outputs as functions of a state: each quantity of nodes, joints and lines is defined once --


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
