"""Outputs: all quantities in one table, and where they may be measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.dual import MaybeDual, floats
from fx_beam.errors import is_one_of, require

from .beam import Beam, BeamPlace, Node
from .contacts import Contact
from .forces_between import ForceBetween
from .joints import Joint
from .loads import check_node
from .removal import own_joint
from .scene import Scene
from .section import stress_weights
from .sliders import SlidingJoint

if TYPE_CHECKING:
    from .gears import Gear


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

    `Solution.value` has its rows. `Response` also takes energies of the scene and stress resultants
    of beams, `StaticResponse` its critical load, `PeriodicResponse` its period.

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

    They have the names of `Solution`, `JointMotion` and `Energy`. "spring_energy" is also that of
    stops and obstacles; "total_energy" is the sum of the four before it, "work" and
    "dissipated_energy" are those since the start; the resultants of a beam are at all its Gauss
    points. "critical_load" is the load factor of the first critical point of a `StaticResponse`, a
    single number: a limit point, a bifurcation or flutter; "period" that of the motion of a
    `PeriodicResponse`.

    Parameters
    ----------
    quantity : str
        Name of the quantity.
    of : Node, BeamPlace, Joint, ForceBetween, Contact, Gear, Scene or Beam
        Where it is measured.
    component : {"x", "y", "moment"}, optional
        One component of a quantity that has several; by default all of them.
    edge : {"lower", "upper"}, optional
        Of a "stress": the edge of the section.

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
        """Names of its components; empty for a single number."""
        return () if self.component else quantity_of(self).components

    @property
    def unit(self) -> str:
        """SI unit of its values; "N, N m" for forces with their moment."""
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


def check_has_rows(output: object, name: str) -> None:
    """Refuse what is no output, and single numbers of a whole path or motion."""
    require(isinstance(output, Output), name, output, "an fx_beam.Output")
    assert isinstance(output, Output)
    expected = (
        "one of rows: critical_load is that of a StaticResponse, period of a PeriodicResponse"
    )
    require(output.quantity not in SINGLE, name, str(output), expected)


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
