"""Outputs of nodes and joints: their derivatives by states, forces and numbers of the scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.place_on_beam import PlaceOnBeam
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.outputs import Output
from fx_beam.scene.sliders import SlidingJoint
from fx_beam.step.model import Model
from fx_beam.step.tape import Steps

from .gradient import Block, of_entry


class Places(NamedTuple):
    """Where the rows of outputs are in the states of a run."""

    #: Rows (n,) among the states, and the starts of the steps that end there.
    ends: np.ndarray
    starts: np.ndarray
    #: Whether there is such a step (n,): not at the start of the run.
    after: np.ndarray
    #: Those steps, and the places of their sub-steps among those of the forces.
    steps: Steps
    forces: np.ndarray

    @property
    def moved(self) -> np.ndarray:
        """Numbers of the rows that are the end of a step, not the start of the run."""
        return np.flatnonzero(self.after)

    @property
    def at_start(self) -> np.ndarray:
        """Numbers of the rows at the start of the run."""
        return np.flatnonzero(~self.after)


class LinearOutput(NamedTuple):
    """An output that is linear in what changes, at given states."""

    every: list[Block]
    #: Lengths of a row.
    shape: tuple[int, ...]

    def blocks(self, rows: np.ndarray) -> list[Block]:
        """Its derivatives, in all rows."""
        return self.every


# -- Blocks of the outputs --------------------------------------------------------------------


def linear_output(
    model: Model, output: Output, places: Places, states: Mapping[str, np.ndarray]
) -> LinearOutput:
    """An output of a node or a joint; `states` has "q", and "rates" if there are any."""
    of = _OfJoint if isinstance(output.of, Joint) else _OfNode
    blocks = [block for block in of(model, output, places, states).blocks() if len(block.rows)]
    if output.index is not None:
        blocks = [block._replace(part=0) for block in blocks if block.part == output.index]
    return LinearOutput(blocks, (len(output.components),) if output.components else ())


class _Blocks:
    def __init__(self, model: Model, output: Output, places: Places, states: Mapping):
        self.model, self.output, self.places, self.states = model, output, places, states
        self.fits = model.fitted_rates is not None
        #: Name of the rates of nodes.
        self.rates = "rates" if self.fits else "v"

    def blocks(self) -> Iterator[Block]:
        """Those of all components."""
        if self.model.scheme.rates.at_rest and self.output.quantity in _OF_RATES:
            return
        yield from getattr(self, self.output.quantity)()

    def _at_ends(self, name: str, index: int, part: int = 0, factor: Any = 1.0) -> Block:
        ends = self.places.ends
        return of_entry(name, index, np.arange(len(ends)), factor, part=part, places=ends)

    def _change(self, name: str, index: int, part: int) -> Iterator[Block]:
        """The change over the steps, by their lengths."""
        places, rows = self.places, self.places.moved
        per_time = 1 / places.steps.lengths[rows]
        for at, factor in ((places.ends, per_time), (places.starts, -per_time)):
            yield of_entry(name, index, rows, factor, part=part, places=at[rows])

    def _at_start(self, name: str, index: int, part: int) -> Block:
        return of_entry(name, index, self.places.at_start, 1.0, part=part)

    def _force(self, name: str, at_start: str, impulse: str, index: int, part: int):
        """A mean force over the steps, with what rates that fit add to it."""
        steps = self.places.steps
        forces = self.places.forces
        yield of_entry(name, index, steps.of, steps.shares, part=part, places=forces)
        yield self._at_start(at_start, index, part)
        if self.fits:
            yield from self._change(impulse, index, part)

    def _of_column(self, column: int, part: int = 0) -> Iterator[Block]:
        names = "constraints", "forces of columns", "impulses of columns"
        yield from self._force(*names, column, part)


class _OfNode(_Blocks):
    @property
    def _node(self) -> int:
        assert isinstance(self.output.of, Node)
        return self.output.of.number

    @property
    def _dofs(self) -> list[int]:
        return self.model.mesh.dofs[self._node].tolist()

    def displacement(self) -> Iterator[Block]:
        for i in range(2):
            yield self._at_ends("q", self._dofs[i], i)

    def position(self) -> Iterator[Block]:
        yield from self.displacement()
        every = np.arange(len(self.places.ends))
        for i in range(2):
            yield of_entry("X", 2 * self._node + i, every, 1.0, part=i)

    def rotation(self) -> Iterator[Block]:
        yield self._at_ends("q", self._dofs[2])

    def velocity(self) -> Iterator[Block]:
        for i in range(2):
            yield self._at_ends(self.rates, self._dofs[i], i)

    def spin(self) -> Iterator[Block]:
        yield self._at_ends(self.rates, self._dofs[2])

    def acceleration(self) -> Iterator[Block]:
        for i in range(2):
            yield from self._change(self.rates, self._dofs[i], i)
            yield self._at_start("a", self._dofs[i], i)

    def reaction(self) -> Iterator[Block]:
        nodes, components, columns = self.model.supports
        for k in np.flatnonzero(nodes == self._node):
            yield from self._of_column(int(columns[k]), int(components[k]))


class _OfJoint(_Blocks):
    @property
    def _joint(self) -> Joint:
        assert isinstance(self.output.of, Joint)
        return self.output.of

    def _ends(self) -> Iterator[tuple[list[int], float]]:
        """Degrees of freedom of the nodes, and their signs in what b has relative to a."""
        for node, sign in ((self._joint.b, 1.0), (self._joint.a, -1.0)):
            if node is not GROUND:
                yield self.model.mesh.dofs[node.number].tolist(), sign

    def angle(self) -> Iterator[Block]:
        for dofs, sign in self._ends():
            yield self._at_ends("q", dofs[2], factor=sign)

    def slide(self) -> Iterator[Block]:
        yield self._at_ends("slides", self._joint.number)

    def spin(self) -> Iterator[Block]:
        for dofs, sign in self._ends():
            yield self._at_ends(self.rates, dofs[2], factor=sign)

    def rate(self) -> Iterator[Block]:
        """Along a slide: t . (v_b - v_a) + omega_a offset x axis, with t = R(psi_a) axis."""
        joint = self._joint
        if isinstance(joint, SlidingJoint):
            yield from self._rate_on_beam()
            return
        if joint.axis is None:
            yield from self.spin()
            return
        places = self.places
        q, v = self.states["q"][places.ends], self.states[self.rates][places.ends]
        axis, offset = np.array(joint.axis), np.array(joint.offset)
        apart, psi, omega = np.zeros((len(q), 2)), np.zeros(len(q)), np.zeros(len(q))
        for dofs, sign in self._ends():
            apart += sign * v[:, dofs[:2]]
            if sign < 0:
                psi, omega = q[:, dofs[2]], v[:, dofs[2]]
        c, s = np.cos(psi), np.sin(psi)
        t = c * axis[0] - s * axis[1], s * axis[0] + c * axis[1]
        for dofs, sign in self._ends():
            for i in range(2):
                yield self._at_ends(self.rates, dofs[i], factor=sign * t[i])
            if sign < 0:
                turn = t[0] * apart[:, 1] - t[1] * apart[:, 0]
                yield self._at_ends("q", dofs[2], factor=turn)
                cross = offset[1] * axis[0] - offset[0] * axis[1]
                yield self._at_ends(self.rates, dofs[2], factor=cross)
        back = c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0]
        of_axis = back[0] + omega * offset[1], back[1] - omega * offset[0]
        of_offset = -omega * axis[1], omega * axis[0]
        number, every = joint.number, np.arange(len(q))
        for i in range(2):
            yield of_entry("axes of slides", 2 * number + i, every, of_axis[i])
            yield of_entry("offsets of slides", 2 * number + i, every, of_offset[i])

    def _rate_on_beam(self) -> Iterator[Block]:
        """t . (v_b - sum N v_a) / t . t with the slope t of the beam where the node is."""
        ends, n, reduction = self.places.ends, self._joint.number, self.model.reduction
        assert isinstance(reduction, JointReduction) and reduction.sliders is not None
        own = next(slide for slide in reduction.sliders.all if slide.joint.number == n)
        q, v = self.states["q"][ends], self.states[self.rates][ends]
        place = PlaceOnBeam(own.path, own.dofs, q, self.states["slides"][ends, n])
        of_beam = v[:, place.dofs[:, :2]]
        beneath = np.einsum("na,nai->ni", place.weights[0], of_beam)
        apart = v[:, own.node_dofs[:2]] - beneath
        t, square = place.slope, (place.slope**2).sum(axis=1)[:, None]
        along = t / square
        rate = (along * apart).sum(axis=1)[:, None]
        by_slope = (apart - 2 * rate * t) / square
        by_q = np.zeros_like(q)
        by_weights = -np.einsum("ni,nai->na", along, of_beam)
        by_place = np.column_stack([by_slope, np.zeros(len(q)), by_weights])
        by_s, by_path = place.pull(by_place, by_q)
        yield self._at_ends("slides", n, factor=by_s)
        before = [other.path.numbers.size for other in self.model.sliding]
        first = sum(before[: [other.number for other in self.model.sliding].index(n)])
        for k in np.flatnonzero(by_path.any(axis=0)).tolist():
            yield of_entry("paths", first + k, np.arange(len(q)), by_path[:, k])
        for i in range(2):
            yield self._at_ends(self.rates, int(own.node_dofs[i]), factor=along[:, i])
            for k, dof in enumerate(place.dofs[:, i].tolist()):
                factor = -along[:, i] * place.weights[0][:, k]
                yield self._at_ends(self.rates, dof, factor=factor)
                yield self._at_ends("q", dof, factor=by_q[:, dof])

    def force(self) -> Iterator[Block]:
        names = "joints", "forces of joints", "impulses of joints"
        for i in range(3):
            yield from self._force(*names, 3 * self._joint.number + i, i)

    def motor_force(self) -> Iterator[Block]:
        motors = [joint.number for joint, _ in self.model.motors]
        column = len(self.model.prescribed) + motors.index(self._joint.number)
        yield from self._of_column(column)


# What of nodes and joints has derivatives, and what of these needs rates or forces of steps.
_OF_FORCES = {"reaction", "force", "motor_force"}
_OF_RATES = {"velocity", "spin", "rate", "acceleration"}


def needs_rates(output: Output) -> bool:
    """Whether rates that fit the joints, or their impulses, are in an output."""
    return output.quantity in _OF_RATES | _OF_FORCES
