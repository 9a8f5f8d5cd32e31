"""Outputs: quantities of a motion that are measured in each step, by names."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from fx_beam.validation import is_one_of, require

from .beam import Beam, Node
from .joints import Joint
from .loads import check_node
from .quantities import OF_BEAMS, OF_JOINTS, OF_NODES, OF_SCENES, Defined, Quantity
from .removal import own_joint
from .scene import Scene


@dataclass(frozen=True)
class Output:
    """A quantity of a node or a joint that `Motion` measures and `linearise` observes.

    `Response` also takes energies of the scene and stress resultants of beams.

    QUANTITIES

    They have the names of `Solution`, `JointMotion` and `Energy`. "spring_energy" is also that of
    stops and obstacles; "total_energy" is the sum of the four before it, "work" and
    "dissipated_energy" are those since the start; the resultants of a beam are at all its Gauss
    points.

    Parameters
    ----------
    quantity : str
        Name of the quantity.
    of : Node, Joint, Scene or Beam
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
    of: Node | Joint | Scene | Beam
    component: str | None = None

    def __post_init__(self):
        fits = isinstance(self.of, Node | Joint | Scene | Beam)
        require(fits, "Output: of", self.of, "a node, a joint, a scene or a beam")
        known = self._known
        wanted = f"one of {list(known)} for {self._place}"
        named = isinstance(self.quantity, str) and self.quantity in known
        require(named, "Output: quantity", self.quantity, wanted)
        parts = known[self.quantity].components
        fits = self.component is None or is_one_of(self.component, parts)
        wanted = f"one of {list(parts)}" if parts else "left out: it is a single number"
        require(fits, f"Output: component of {self.quantity!r}", self.component, wanted)

    def __str__(self):
        return f"{self.quantity}{f'.{self.component}' if self.component else ''} of {self._place}"

    @property
    def _place(self) -> str:
        if isinstance(self.of, Beam):
            return self.of.name
        return "the scene" if isinstance(self.of, Scene) else str(self.of)

    @property
    def _known(self) -> dict[str, Quantity]:
        if isinstance(self.of, Scene):
            return OF_SCENES
        if isinstance(self.of, Beam):
            return OF_BEAMS
        return OF_JOINTS if isinstance(self.of, Joint) else OF_NODES

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
        quantity = quantity._replace(law=None)  # its spin
    return Defined(quantity, output.of, output.index)


def check_outputs(scene, outputs, what: str) -> None:
    """Refuse outputs that are no dictionary of outputs of the scene."""
    fits = isinstance(outputs, Mapping) and all(isinstance(name, str) for name in outputs)
    require(fits, what, outputs, "a dictionary of fx_beam.Output by names")
    for name, output in outputs.items():
        own = f"{what}[{name!r}]"
        fits = isinstance(output, Output) and isinstance(output.of, Node | Joint)
        require(fits, own, output, "an fx_beam.Output of a node or a joint")
        check_output(scene, output, own)


def check_output(scene, output: Output, what: str) -> None:
    """Refuse an output of another scene or of its nodes and joints, or one that its joint lacks."""
    joint = output.of
    if isinstance(joint, Scene):
        require(joint is scene, what, str(output), "of the scene of the motion")
        return
    if isinstance(joint, Beam):
        theirs = any(joint is one for one in scene.beams)
        require(theirs, what, str(output), "of a beam of this scene")
        return
    if not isinstance(joint, Joint):
        check_node(scene, joint, what)
        return
    own = own_joint(scene, joint)
    wanted = "of a joint that add_joint of this scene returned"
    require(own is not None, what, str(output), wanted)
    assert own is not None
    lacking = own.lacks(output.quantity)
    require(not lacking, what, str(output), lacking)


def _quantities() -> str:
    """The quantities as a list in Markdown."""
    lines = []
    kinds = {"a node": OF_NODES, "a joint": OF_JOINTS, "a scene": OF_SCENES, "a beam": OF_BEAMS}
    for of, known in kinds.items():
        names = [f'"{name}" [{quantity.unit}]' for name, quantity in known.items()]
        lines.append(f"- of {of}: {', '.join(names)}")
    return "\n".join(
        textwrap.fill(line, 96, subsequent_indent="  ", break_on_hyphens=False) for line in lines
    )


if Output.__doc__ is not None:  # else Python runs without docstrings
    # Python takes the indentation away from 3.13 on.
    Output.__doc__ = inspect.cleandoc(Output.__doc__).replace("QUANTITIES", _quantities())
