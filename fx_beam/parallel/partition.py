"""Cuts a scene by coordinates into shares of about equal numbers of elements.

A process gets some of the members, and the trees of joints that the members touch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem.sparsity import connected_parts
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.functions import constant
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import Drag, Mass, NaturalStrain
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import DATA, Section
from fx_beam.step.model import Model

from .linear_system import BLOCK

_AT_REST = constant(np.zeros(1))
#: A run of elements: beam's name, nodes as rows of `X`, arc lengths, section, inside, and drag.
Run = tuple[str, np.ndarray, np.ndarray, Section, Any, list[Drag]]


@dataclass
class Share:
    """Members, nodes and joints of one process, in the order of the whole scene.

    Without loads and forces at points, which the first process has.
    """

    #: Positions (n, 2) of the nodes, in the order of the scene.
    X: np.ndarray
    #: Rows of the nodes in the whole mesh, then of the nodes inside elements.
    rows: np.ndarray
    #: Numbers of the elements in the scene, in order.
    elements: np.ndarray
    #: Whether the process has the forces and masses at a node of `rows`: each node has one owner.
    owned: np.ndarray
    degree: int
    runs: list[Run]
    #: Joints without forces, with the rows of their nodes in `X`; -1 for the ground.
    joints: list[tuple[Joint, int, int]]
    fixed: list[tuple[int, int]]
    prescribed: list[tuple[int, int]]
    masses: list[Mass]
    #: Whether members of the scene have natural strains, whose values come with each step.
    natural: bool
    #: Names of the scene's parameters, whose values come with each step.
    parameters: list[str]
    #: Indices of the driven columns in the list of the scene.
    driven: np.ndarray
    #: Numbers of the unknowns in the linear system: of nodes (n, 3), and of slides of joints; -1
    #: where there is none.
    unknowns: np.ndarray
    slides: np.ndarray

    def scene(self) -> Scene:
        """The sub-scene."""
        scene = Scene()
        scene.nodes += [Node(i, x, y, scene) for i, (x, y) in enumerate(self.X.tolist())]
        for name, nodes, *facts, drags in self.runs:
            beam = Beam(name, tuple(scene.nodes[n] for n in nodes), self.degree, *facts)
            scene.beams.append(beam)
            scene.drags += [replace(drag, target=beam) for drag in drags]
        for number, (joint, *pair) in enumerate(self.joints):
            a, b = (scene.nodes[node] if node >= 0 else GROUND for node in pair)
            scene.joints.append(replace(joint, a=a, b=b, number=number))
        scene.joint_count = len(self.joints)
        scene.fixed |= {*self.fixed}
        scene.prescribed |= dict.fromkeys(self.prescribed, _AT_REST)
        scene.masses += self.masses
        if self.natural and scene.beams:
            none = NaturalStrain(scene.beams[0], {"axial": _AT_REST})
            scene.natural_strains.append(none)
        if self.parameters:
            from fx_beam.scene.symbols import Parameter

            parameters = [(name, Parameter(name, 0.0)) for name in self.parameters]
            scene.parameters.add(parameters, "a part")
        return scene


def _bare(joint: Joint) -> Joint:
    """The joint without the forces on its coordinates; motors are only known to be there."""
    motors = {name: _AT_REST if name in joint.driven else None for name in joint.coordinates}
    parts: dict[str, Any] = {name: Coordinate(motor=motor) for name, motor in motors.items()}
    return replace(joint, **parts)


def divided(model: Model, number: int) -> tuple[list[Share], np.ndarray, np.ndarray]:
    """The scene of a model in shares, for a number of processes.

    Also the number (free,) of each unknown in the linear system, and how many each process has.
    """
    cut = _Cut(model, number)
    numbers, counts = cut.numbered_unknowns()
    return [cut.share(process, numbers) for process in range(number)], numbers, counts


class _Cut:
    """Who has which element and which node of a scene."""

    def __init__(self, model: Model, number: int):
        self._model, self._scene, self._number = model, model.scene, number
        #: Nodes (elements, 2) at the ends of all elements, and inside them.
        self._ends, self._inside = model.mesh.elements[:, [0, -1]], model.mesh.elements[:, 1:-1]
        self._tree = _trees(self._scene)
        X, ends, count = model.mesh.X, self._ends, len(self._scene.nodes)
        alone = np.setdiff1d(np.arange(count), ends)
        pairs = zip(self._scene.beams, model.mesh.cells, strict=True)
        # A part of a beam has the same section, unless its data are functions along the beam.
        whole = [cells for beam, cells in pairs if beam.section.constants(DATA) is None]
        middles = X[ends].mean(axis=1)
        for cells in whole:
            middles[cells] = middles[cells].mean(axis=0)
        process = bisected(np.vstack([middles, X[alone]]), number)
        for cells in whole:
            process[cells] = process[cells[0]]
        #: Process of each element, and of each node of the scene: a tree of joints has one owner.
        self.element_process = process[: len(ends)]
        node_process = np.empty(count, dtype=int)
        node_process[alone] = process[len(ends) :]
        node_process[ends[::-1]] = self.element_process[::-1, None]
        first = np.unique(self._tree, return_index=True)[1]
        self.node_process = node_process[first[self._tree]]
        if len(np.unique(self.node_process)) < number:
            raise SceneError(
                f"the scene has too few members for {number} processes. Start fewer of them, "
                "or compute it on one, without mpirun"
            )

    def numbered_unknowns(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (free,) of the unknowns, in order of processes, and counts (processes,).

        Each node has a block of three places; at supports places are free.
        """
        couplings = self._model.couplings
        owner, block = (np.zeros(couplings.free, dtype=int) for _ in range(2))
        column, dof, slide_column, joint = couplings.free_columns
        inside_process = np.repeat(self.element_process, self._inside.shape[1])
        row_process = np.append(self.node_process, inside_process)
        block[column] = dof // 3
        owner[column] = row_process[block[column]]
        joints = {joint.number: joint for joint in self._scene.joints}
        owner[slide_column] = [self.node_process[joints[number].b.number] for number in joint]
        block[slide_column] = len(row_process) + np.arange(len(slide_column))
        order = np.lexsort((block, owner))
        first = np.diff(block[order], prepend=-1) != 0
        starts = np.flatnonzero(first)
        block_number = np.cumsum(first) - 1
        numbers = np.empty(couplings.free, dtype=int)
        numbers[order] = BLOCK * block_number + np.arange(couplings.free) - starts[block_number]
        return numbers, BLOCK * np.bincount(owner[order][starts], minlength=self._number)

    def share(self, process: int, numbers: np.ndarray) -> Share:
        """What a process has."""
        scene, mesh, couplings = self._scene, self._model.mesh, self._model.couplings
        elements = np.flatnonzero(self.element_process == process)
        touched = self.node_process == process
        touched[self._ends[elements]] = True
        nodes = np.flatnonzero(np.isin(self._tree, self._tree[touched]))
        local = np.full(len(scene.nodes) + 1, -1)  # the last one is the ground
        local[nodes] = np.arange(len(nodes))
        rows = np.concatenate([nodes, self._inside[elements].ravel()])
        owned = np.ones(len(rows), dtype=bool)
        owned[: len(nodes)] = self.node_process[nodes] == process
        ends = [(joint, local[[joint.a.number, joint.b.number]].tolist()) for joint in scene.joints]
        joints = [(_bare(joint), a, b) for joint, (a, b) in ends if max(a, b) >= 0]
        own_joints = {joint.number for joint, *_ in joints}
        prescribed = [(int(local[node]), i) for node, i in scene.prescribed]
        moved = [node >= 0 for node, _ in prescribed]
        moved += [joint.number in own_joints for joint, _ in self._model.motors]
        column_number = np.full(couplings.columns + 1, -1)  # the last one is none
        column_number[: couplings.free] = numbers
        slides = [couplings.slides.get(joint.number, -1) for joint, *_ in joints]
        heavy = [mass for mass in scene.masses if self.node_process[mass.node] == process]
        return Share(
            mesh.X[nodes],
            rows,
            elements,
            owned,
            degree=self._inside.shape[1] + 1,
            runs=self._runs_of(process, local),
            joints=joints,
            fixed=[(int(local[node]), i) for node, i in scene.fixed if local[node] >= 0],
            prescribed=[(node, i) for node, i in prescribed if node >= 0],
            masses=[mass._replace(node=int(local[mass.node])) for mass in heavy],
            natural=bool(scene.natural_strains),
            parameters=[*scene.parameters],
            driven=np.flatnonzero(moved),
            unknowns=column_number[couplings.column[mesh.dofs[rows]]],
            slides=column_number[np.array(slides, int)],
        )

    def _runs_of(self, process: int, local: np.ndarray) -> list[Run]:
        """The runs of elements, and the drag on them."""
        mesh, in_process, runs = self._model.mesh, self.element_process == process, list[Run]()
        for i in np.unique(mesh.beam_of_cell[in_process]).tolist():
            beam, nodes = self._scene.beams[i], local[mesh.nodes[i][:: self._inside.shape[1] + 1]]
            drags = [drag for drag in self._scene.drags if drag.target is beam]
            for a, b in _runs(in_process[mesh.cells[i]]):
                inner = None if beam.inner is None else beam.inner[a:b]
                ends = slice(a, b + 1)
                runs.append((beam.name, nodes[ends], beam.s[ends], beam.section, inner, drags))
        return runs


def bisected(X: np.ndarray, number: int) -> np.ndarray:
    """Process of each point (n, 2): cut in two across the longer side, again and again."""
    process = np.zeros(len(X), dtype=int)

    def cut(points: np.ndarray, first: int, count: int) -> None:
        if count == 1:
            process[points] = first
            return
        longer = int(np.argmax(np.ptp(X[points], axis=0))) if len(points) else 0
        order = points[np.lexsort((X[points, 1 - longer], X[points, longer]))]
        half = count // 2
        middle = round(len(points) * half / count)
        cut(order[:middle], first, half)
        cut(order[middle:], first + half, count - half)

    cut(np.arange(len(X)), 0, number)
    return process


def _trees(scene: Scene) -> np.ndarray:
    """Number (nodes,) of the tree of joints to which a node belongs; the ground connects none."""
    joints = [joint for joint in scene.joints if GROUND not in (joint.a, joint.b)]
    a, b = np.array([(j.a.number, j.b.number) for j in joints], dtype=int).reshape(-1, 2).T
    return connected_parts((a, b), len(scene.nodes))


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Where each run of True begins, and where the flags are False again."""
    change = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in change.reshape(-1, 2)]
