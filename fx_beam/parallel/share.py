"""What one process gets of a scene: some of its members, and the trees of joints they touch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fx_beam.errors import Constant
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import Drag, Mass, NaturalStrain, StrainPart
from fx_beam.scene.parameters import Parameter
from fx_beam.scene.scene import Scene

_AT_REST = Constant(np.zeros(1))


@dataclass
class Share:
    """Members, nodes and joints of one process, in the order of the whole scene.

    Without loads and forces at points, which the first process has.
    """

    #: Positions (n, 2) of its nodes, and their numbers in the scene, which rise.
    X: np.ndarray
    nodes: np.ndarray
    #: Rows of its nodes among all nodes, and then of those inside its elements.
    rows: np.ndarray
    #: Numbers of its elements in the scene, in order.
    elements: np.ndarray
    #: Whether forces and masses at a node of `rows` are its own: each node has one owner.
    owned: np.ndarray
    degree: int = 1
    sections: list[Any] = field(default_factory=list)
    #: Runs of elements: the beam's name, nodes in `nodes`, arc lengths, nodes inside, section.
    runs: list[tuple[str, np.ndarray, np.ndarray, Any, int]] = field(default_factory=list)
    #: Joints without forces, with the indices of their nodes in `nodes`; -1 for the ground.
    joints: list[tuple[Joint, int, int]] = field(default_factory=list)
    fixed: list[tuple[int, int]] = field(default_factory=list)
    prescribed: list[tuple[int, int]] = field(default_factory=list)
    masses: list[Mass] = field(default_factory=list)
    #: Whether members of the scene have natural strains, whose values come with each step.
    natural: bool = False
    #: Names of the scene's parameters, whose values come with each step.
    parameters: list[str] = field(default_factory=list)
    #: Drag on runs, by the index of the run.
    drags: list[tuple[int, Drag]] = field(default_factory=list)
    #: Indices of its driven columns among those of the scene.
    driven: list[int] = field(default_factory=list)
    #: Numbers of its unknowns in the linear system: of its nodes (n, 3), and of its joints' slides;
    #: -1 where there is none.
    unknowns: np.ndarray = field(default_factory=lambda: np.empty((0, 3), int))
    slides: np.ndarray = field(default_factory=lambda: np.empty(0, int))

    def scene(self) -> Scene:
        """The sub-scene."""
        scene = Scene()
        scene.nodes += [Node(i, x, y, scene) for i, (x, y) in enumerate(self.X.tolist())]
        for name, nodes, s, inner, section in self.runs:
            ends = tuple(scene.nodes[node] for node in nodes)
            beam = Beam(name, ends, self.degree, s, self.sections[section], inner)
            scene.beams.append(beam)
        for number, (joint, *pair) in enumerate(self.joints):
            a, b = (scene.nodes[node] if node >= 0 else GROUND for node in pair)
            scene.joints.append(replace(joint, a=a, b=b, number=number))
        scene.joint_count = len(self.joints)
        scene.fixed |= {*self.fixed}
        scene.prescribed |= dict.fromkeys(self.prescribed, _AT_REST)
        scene.masses += self.masses
        if self.natural and scene.beams:
            none = NaturalStrain(scene.beams[0], {"axial": StrainPart(_AT_REST)})
            scene.natural_strains.append(none)
        scene.parameters.add([Parameter(name, 0.0) for name in self.parameters], "a part")
        scene.drags += [replace(drag, target=scene.beams[run]) for run, drag in self.drags]
        return scene


def bare(joint: Joint) -> Joint:
    """The joint without the forces on its coordinates; motors are only known to be there."""
    motors = {name: _AT_REST if name in joint.driven else None for name in joint.coordinates}
    parts: dict[str, Any] = {name: Coordinate(motor=motor) for name, motor in motors.items()}
    return replace(joint, **parts)
