"""Outputs as sums of terms: parts of states and forces, times numbers."""

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

from .gradient import Gradient


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


class Term(NamedTuple):
    """Terms of some rows of an output: a value of the states or of the scene, times factors."""

    #: Name of an array of states, or with `direct` of numbers of the scene; flat index in it.
    name: str
    at: int
    #: Rows (k,) in their order, factors (k,) or one, and component of the output.
    rows: np.ndarray
    factors: Any
    part: int = 0
    #: Places (k,) among the states or forces; none for numbers of the scene.
    places: np.ndarray | None = None


class LinearOutput:
    """An output that is a sum of terms, at given states."""

    def __init__(self, terms: list[Term], components: int):
        #: The terms, and the number of components; 0 for a single number.
        self.terms = [term for term in terms if len(term.rows)]
        self.components = components

    def pull(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n, ...) times the output."""
        weights = weights.reshape(len(weights), -1)
        for term in self.terms:
            values = term.factors * weights[term.rows, term.part]
            if term.places is None:
                to.add_number(term.name, term.at, float(values.sum()))
            else:
                np.add.at(to.at(term.name)[:, term.at], term.places, values)

    def push(
        self, rows: int, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (rows, ..., m) from those of the states and of the numbers of the scene."""
        count = len(changes["X"])
        found = np.zeros((rows, max(1, self.components), count))
        for term in self.terms:
            factors = np.broadcast_to(term.factors, term.rows.shape)[:, None]
            if term.places is None:
                of_number = changes[term.name].reshape(count, -1)[:, term.at]
                values = factors * of_number
            else:
                own = of_state[term.name]
                values = factors * own.reshape(*own.shape[:2], -1)[term.places, :, term.at]
            first = np.flatnonzero(np.diff(term.rows, prepend=-1))
            found[term.rows[first], term.part] += np.add.reduceat(values, first)
        return found if self.components else found[:, 0]


# -- Terms of the outputs ---------------------------------------------------------------------


def linear_output(
    model: Model, output: Output, places: Places, states: Mapping[str, np.ndarray]
) -> LinearOutput:
    """An output of a node or a joint; `states` has "q", and "rates" if there are any."""
    of = _OfJoint if isinstance(output.of, Joint) else _OfNode
    terms = list(of(model, output, places, states).terms())
    if output.index is not None:
        terms = [term._replace(part=0) for term in terms if term.part == output.index]
    return LinearOutput(terms, len(output.components))


class _Terms:
    def __init__(self, model: Model, output: Output, places: Places, states: Mapping):
        self.model, self.output, self.places, self.states = model, output, places, states
        self.fits = model.fitted_rates is not None
        #: Name of the rates of nodes.
        self.rates = "rates" if self.fits else "v"

    def terms(self) -> Iterator[Term]:
        """Those of all components."""
        if self.model.scheme.rates.at_rest and self.output.quantity in _OF_RATES:
            return
        yield from getattr(self, self.output.quantity)()

    def _at_ends(self, name: str, index: int, part: int = 0, factor: Any = 1.0) -> Term:
        ends = self.places.ends
        return Term(name, index, np.arange(len(ends)), factor, part, ends)

    def _change(self, name: str, index: int, part: int) -> Iterator[Term]:
        """The change over the steps, by their lengths."""
        places, rows = self.places, self.places.moved
        per_time = 1 / places.steps.lengths[rows]
        yield Term(name, index, rows, per_time, part, places.ends[rows])
        yield Term(name, index, rows, -per_time, part, places.starts[rows])

    def _at_start(self, name: str, index: int, part: int) -> Term:
        return Term(name, index, self.places.at_start, 1.0, part)

    def _force(self, name: str, at_start: str, impulse: str, index: int, part: int):
        """A mean force over the steps, with what rates that fit add to it."""
        steps = self.places.steps
        yield Term(name, index, steps.of, steps.shares, part, self.places.forces)
        yield self._at_start(at_start, index, part)
        if self.fits:
            yield from self._change(impulse, index, part)

    def _of_column(self, column: int, part: int = 0) -> Iterator[Term]:
        names = "constraints", "forces of columns", "impulses of columns"
        yield from self._force(*names, column, part)


class _OfNode(_Terms):
    @property
    def _node(self) -> int:
        assert isinstance(self.output.of, Node)
        return self.output.of.number

    @property
    def _dofs(self) -> list[int]:
        return self.model.mesh.dofs[self._node].tolist()

    def displacement(self) -> Iterator[Term]:
        for i in range(2):
            yield self._at_ends("q", self._dofs[i], i)

    def position(self) -> Iterator[Term]:
        yield from self.displacement()
        every = np.arange(len(self.places.ends))
        for i in range(2):
            yield Term("X", 2 * self._node + i, every, 1.0, i)

    def rotation(self) -> Iterator[Term]:
        yield self._at_ends("q", self._dofs[2])

    def velocity(self) -> Iterator[Term]:
        for i in range(2):
            yield self._at_ends(self.rates, self._dofs[i], i)

    def spin(self) -> Iterator[Term]:
        yield self._at_ends(self.rates, self._dofs[2])

    def acceleration(self) -> Iterator[Term]:
        for i in range(2):
            yield from self._change(self.rates, self._dofs[i], i)
            yield self._at_start("a", self._dofs[i], i)

    def reaction(self) -> Iterator[Term]:
        nodes, components, columns = self.model.supports
        for k in np.flatnonzero(nodes == self._node):
            yield from self._of_column(int(columns[k]), int(components[k]))


class _OfJoint(_Terms):
    @property
    def _joint(self) -> Joint:
        assert isinstance(self.output.of, Joint)
        return self.output.of

    def _ends(self) -> Iterator[tuple[list[int], float]]:
        """Degrees of freedom of the nodes, and their signs in what b has relative to a."""
        for node, sign in ((self._joint.b, 1.0), (self._joint.a, -1.0)):
            if node is not GROUND:
                yield self.model.mesh.dofs[node.number].tolist(), sign

    def angle(self) -> Iterator[Term]:
        for dofs, sign in self._ends():
            yield self._at_ends("q", dofs[2], factor=sign)

    def slide(self) -> Iterator[Term]:
        yield self._at_ends("slides", self._joint.number)

    def spin(self) -> Iterator[Term]:
        for dofs, sign in self._ends():
            yield self._at_ends(self.rates, dofs[2], factor=sign)

    def rate(self) -> Iterator[Term]:
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
            yield Term("axes of slides", 2 * number + i, every, of_axis[i])
            yield Term("offsets of slides", 2 * number + i, every, of_offset[i])

    def _rate_on_beam(self) -> Iterator[Term]:
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
            yield Term("paths", first + k, np.arange(len(q)), by_path[:, k])
        for i in range(2):
            yield self._at_ends(self.rates, int(own.node_dofs[i]), factor=along[:, i])
            for k, dof in enumerate(place.dofs[:, i].tolist()):
                factor = -along[:, i] * place.weights[0][:, k]
                yield self._at_ends(self.rates, dof, factor=factor)
                yield self._at_ends("q", dof, factor=by_q[:, dof])

    def force(self) -> Iterator[Term]:
        names = "joints", "forces of joints", "impulses of joints"
        for i in range(3):
            yield from self._force(*names, 3 * self._joint.number + i, i)

    def motor_force(self) -> Iterator[Term]:
        motors = [joint.number for joint, _ in self.model.motors]
        column = len(self.model.prescribed) + motors.index(self._joint.number)
        yield from self._of_column(column)


# What of nodes and joints has derivatives, and what of these needs rates or forces of steps.
_OF_FORCES = {"reaction", "force", "motor_force"}
_OF_RATES = {"velocity", "spin", "rate", "acceleration"}


def needs_rates(output: Output) -> bool:
    """Whether rates that fit the joints, or their impulses, are in an output."""
    return output.quantity in _OF_RATES | _OF_FORCES
