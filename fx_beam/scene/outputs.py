"""Outputs: what can be measured, in one table, and what of it is measured in each step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import is_one_of, require

from .beam import Beam, Node
from .forces_between import ForceBetween
from .joints import GROUND, Joint
from .loads import check_node
from .removal import own_joint
from .scene import Scene


class Quantity(NamedTuple):
    """What can be measured: all that solutions, motions, linear systems and derivatives know of it.

    It is linear in what is recorded, except the rate of a slide.
    """

    components: tuple[str, ...] = ()
    #: The history that has it, of a joint's nodes that of b less that of a; the column there.
    of: str = ""
    column: int = 0
    #: Whether it is a place, to which that in the reference configuration is added.
    is_place: bool = False
    is_slide_rate: bool = False


_PLANE, _FORCE = ("x", "y"), ("x", "y", "moment")
CRITICAL_LOAD, PERIOD = "critical_load", "period"
#: Quantities of nodes, joints, forces between points, scenes and beams by name.
OF_NODES: dict[str, Quantity] = {
    "position": Quantity(_PLANE, "q", is_place=True),
    "displacement": Quantity(_PLANE, "q"),
    "rotation": Quantity(of="q", column=2),
    "velocity": Quantity(_PLANE, "v"),
    "spin": Quantity(of="v", column=2),
    "acceleration": Quantity(_PLANE, "a"),
    "reaction": Quantity(_FORCE, "reactions"),
}
OF_JOINTS: dict[str, Quantity] = {
    "angle": Quantity(of="q", column=2),
    "slide": Quantity(of="slides"),
    "spin": Quantity(of="v", column=2),
    "rate": Quantity(of="v", column=2, is_slide_rate=True),
    "force": Quantity(_FORCE, "joint_forces"),
    "motor_force": Quantity(of="motor_forces"),
}
OF_LINES: dict[str, Quantity] = {"force": Quantity(of="line_forces")}
_ENERGIES = """kinetic_energy strain_energy potential_energy spring_energy total_energy
    dissipated_energy work""".split()
OF_SCENES = dict.fromkeys([*_ENERGIES, CRITICAL_LOAD, PERIOD], Quantity())
OF_BEAMS = dict.fromkeys("NQM", Quantity(of="resultants"))
_OF_CLASSES: dict[type, dict[str, Quantity]] = {
    Scene: OF_SCENES,
    Beam: OF_BEAMS,
    Joint: OF_JOINTS,
    ForceBetween: OF_LINES,
    Node: OF_NODES,
}


@dataclass(frozen=True)
class Defined:
    """A quantity of a node, a joint, a beam or the scene, or one of its components."""

    quantity: Quantity
    of: Any
    #: Number of its component; None for all.
    index: int | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of a value; none of a single number."""
        count = len(self.quantity.components)
        return (count,) if count and self.index is None else ()

    @property
    def number(self) -> int:
        """Number of its node or joint."""
        return self.of.number

    @property
    def columns(self) -> Any:
        """Columns of its components in the history of its quantity; a number for a single one."""
        first, count = self.quantity.column, len(self.quantity.components)
        return first + (np.arange(count) if self.shape else self.index or 0)

    def ends(self) -> Iterator[tuple[int, Node]]:
        """Its nodes, with their signs: 1, and -1 of a joint's node a; without the ground."""
        both = [self.of] if isinstance(self.of, Node) else [self.of.b, self.of.a]
        for sign, node in zip((1, -1), both, strict=False):
            if node is not GROUND:
                yield sign, node


@dataclass(frozen=True)
class Output:
    """A quantity of a node, joint or rope that `Motion` measures and `linearise` observes.

    `Response` also takes energies of the scene and stress resultants of beams, `StaticResponse` its
    critical load, `PeriodicResponse` its period.

    - of a node: "position" [m], "displacement" [m], "rotation" [rad], "velocity" [m/s], "spin"
      [rad/s], "acceleration" [m/s^2], "reaction" [N, N m]
    - of a joint: "angle" [rad], "slide" [m], "spin" [rad/s], "rate" [m/s or rad/s], "force" [N, N
      m], "motor_force" [N or N m]
    - of a rope or force between points, for `Motion`: "force" [N], its pull
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
    of : Node, Joint, ForceBetween, Scene or Beam
        Where it is measured.
    component : {"x", "y", "moment"}, optional
        One component of a quantity that has several; by default all of them.

    Raises
    ------
    SceneError
        For a quantity that the node, joint or scene does not have, or an unknown component.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> arm = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=10.0))
    >>> print(fb.Output("velocity", arm.end, "y"))
    velocity.y of node 1 at (1, 0)
    """

    quantity: str
    of: Node | Joint | ForceBetween | Scene | Beam
    component: str | None = None

    def __post_init__(self):
        ok = isinstance(self.of, Node | Joint | ForceBetween | Scene | Beam)
        require(ok, "Output: of", self.of, "a node, a joint, a rope, a scene or a beam")
        known = self._known
        expected = f"one of {list(known)} for {self._place}"
        require(is_one_of(self.quantity, known), "Output: quantity", self.quantity, expected)
        parts = known[self.quantity].components
        ok = self.component is None or is_one_of(self.component, parts)
        expected = f"one of {list(parts)}" if parts else "left out: it is a single number"
        require(ok, f"Output: component of {self.quantity!r}", self.component, expected)

    def __str__(self):
        return f"{self.quantity}{f'.{self.component}' if self.component else ''} of {self._place}"

    @property
    def _place(self) -> str:
        if isinstance(self.of, Beam):
            return self.of.name
        return "the scene" if isinstance(self.of, Scene) else str(self.of)

    @property
    def _known(self) -> dict[str, Quantity]:
        classes = type(self.of).__mro__
        return next(_OF_CLASSES[each] for each in classes if each in _OF_CLASSES)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its components; empty for a single number."""
        return () if self.component else self._known[self.quantity].components

    @property
    def index(self) -> int | None:
        """Number of its component; None for all."""
        parts = self._known[self.quantity].components
        return None if self.component is None else parts.index(self.component)


def definition(output: Output) -> Defined:
    """What is measured of a node or a joint, or of a beam or scene."""
    quantity = output._known[output.quantity]
    if isinstance(output.of, Joint) and output.of.slide is None and output.quantity == "rate":
        quantity = quantity._replace(is_slide_rate=False)  # its spin
    return Defined(quantity, output.of, output.index)


def check_outputs(scene, outputs, what: str) -> None:
    """Refuse outputs that are no dictionary of outputs of the scene."""
    ok = isinstance(outputs, Mapping) and all(isinstance(name, str) for name in outputs)
    require(ok, what, outputs, "a dictionary of fx_beam.Output by names")
    for name, output in outputs.items():
        label = f"{what}[{name!r}]"
        ok = isinstance(output, Output) and isinstance(output.of, Node | Joint | ForceBetween)
        require(ok, label, output, "an fx_beam.Output of a node, a joint or a rope")
        check_output(scene, output, label)


def check_output(scene, output: Output, what: str) -> None:
    """Refuse an output of another scene or of its nodes and joints, or one that its joint lacks."""
    of, expected = output.of, ""
    if isinstance(of, Scene):
        expected = "" if of is scene else "of the scene of the motion"
    elif isinstance(of, Beam):
        expected = "" if any(of is one for one in scene.beams) else "of a beam of this scene"
    elif isinstance(of, Node):
        check_node(scene, of, what)
    elif isinstance(of, ForceBetween):
        ours = {str(one) for one in scene.forces_between}  # also of a copy
        expected = "" if str(of) in ours else "of a rope that add_rope of this scene returned"
    elif (joint := own_joint(scene, of)) is None:
        expected = "of a joint that add_joint of this scene returned"
    else:
        expected = joint.lacks(output.quantity)
    require(not expected, what, str(output), expected)
