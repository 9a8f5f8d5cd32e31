"""Functions and Constants of a step on a mesh of dolfinx, with their values of a scene."""

from __future__ import annotations

from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, require
from fx_beam.fem.beam_data import CONSTANTS
from fx_beam.fem.weak_form import WeakForm
from fx_beam.laws.interval import Interval
from fx_beam.laws.kinematics import Step
from fx_beam.results.state import State
from fx_beam.step.model import Model

from .grid import BeamMesh


class DolfinxFields:
    """Fields of a step: its start, its increment, and the state q, v, a at its end.

    Arrays (size,) have all degrees of freedom of a scene, on each process.
    """

    def __init__(
        self, written: WeakForm, model: Model, grid: BeamMesh, state: list[fem.Function] | None
    ):
        fields, data = written.fields, written.symbols
        #: Names of the Functions and Constants of the form.
        self.named = {symbol: name for symbol, name in written.named.items() if symbol is not None}
        for symbol, name in self.named.items():
            symbol.name = name.replace(" ", "_")  # FFCx 0.5 takes it into C
        self._grid, self._rates = grid, model.scheme.rates
        self._scene_parameters = model.forms.parameters
        #: Start, increment and arguments of forms: Functions and Constants.
        self.symbols = fields
        #: The step in UFL; N, Q and M of each material.
        self.step: Step = written.laws.step
        self.resultants: list[Expr] = written.laws.resultants
        #: Space of displacements (2) and rotation (1).
        self.V = fields.start.function_space
        #: Number in the scene of each degree of freedom of V, and of the space of increments. The
        #: latter is discontinuous if nodal rotations are components: then numbers repeat.
        spaces, dofs = (self.V, fields.increment.function_space), model.mesh.unknowns.dofs
        self.V_numbers, self.increment_numbers = (grid.numbers(space, dofs) for space in spaces)
        displacements, self._u_dofs = self.V.sub(0).collapse()
        if state is None:
            state = [fem.Function(self.V, name=name) for name in "qva"]
            state.append(fem.Function(displacements, name="u"))
        #: State at the end of the last step, its rates, accelerations, and the displacement alone.
        self.state = state
        self.q, self.v, self.a, self.u = self.state
        self._internal, self._parameters = data.internal, data.parameters
        #: Accelerations beside those of the rule, of what driven motions alone move.
        self.led = fem.Function(self.V)
        # Values of Constants of the step, and q (size,) at its start, as they were set last.
        self._step_numbers = dict.fromkeys(CONSTANTS, 0.0)
        self._start_q = np.zeros(model.size)
        #: What takes the place of each symbol of the start in a form of the end.
        self.ends = {fields.start: self.q, fields.natural[0]: fields.natural[1]}
        if self._internal is not None:
            self._internal_end = fem.Function(self._internal.function_space)
            self.ends[self._internal] = self._internal_end
        named = data.named_data
        if fields.coordinate is not None:
            named["coordinate"] = fields.coordinate
        for name, symbol in named.items():
            grid.fill(symbol, np.asarray(grid.beams.data.values[name], dtype=float))

    def set_start(self, interval: Interval, state: State, natural: np.ndarray | None) -> None:
        """Set the start of a step, and natural strains (cells, degree, 3) at its end."""
        fields, rates = self.symbols, self._rates
        length, factor = interval.length, interval.end if rates.at_rest else 1.0
        self._set_numbers(time=interval.time_at(rates.level), dt=1.0 if rates.at_rest else length)
        self._set_numbers(load_factor=factor, load_increment=length, memory=state.memory(length))
        self._start_q = state.q
        v, a = fields.start_rates
        q_previous = state.q if state.q_previous is None else state.q_previous
        self._fill_nodes(fields.start, state.q)
        self._fill_nodes(fields.q_previous, q_previous)
        self._fill_nodes(v, state.v)
        self._fill_nodes(a, state.a)
        for function, strains in zip(fields.natural, (state.natural, natural), strict=True):
            if strains is not None:
                self._grid.fill(function, strains)
        if state.internal is not None:
            self._grid.fill(self._internal, state.internal)
        self._set_parameters(self._scene_parameters.values)

    def lead(self, accelerations: np.ndarray) -> None:
        """Set the accelerations (size,) beside those of the rule."""
        self._fill_nodes(self.led, accelerations)

    def set_load(self, factor: float, natural: np.ndarray | None) -> None:
        """Set load factor and natural strains at the end of a load step."""
        self._set_numbers(load_factor=factor)
        if natural is not None:
            self._grid.fill(self.symbols.natural[1], natural)

    def end(self, state: State) -> None:
        """Set the end of a step."""
        self._fill_nodes(self.q, state.q)
        self._fill_nodes(self.v, state.v)
        self._fill_nodes(self.a, state.a)
        self.u.x.array[:] = self.q.x.array[self._u_dofs]
        if state.internal is not None:
            self._grid.fill(self._internal_end, state.internal)
        if state.natural is not None:
            self._grid.fill(self.symbols.natural[1], state.natural)
        self._set_parameters(state.parameters)

    def _set_numbers(self, **values: float) -> None:
        """Set Constants of a step."""
        self._step_numbers |= values
        for name, value in values.items():
            getattr(self.symbols, name).value = value

    def refuse_writes(self, state: State) -> None:
        """Refuse values that a user has written into fields, which no step would read."""
        functions = (*self.state, self.symbols.start)
        values = [x[self.V_numbers] for x in (state.q, state.v, state.a, state.q, self._start_q)]
        values[3] = values[3][self._u_dofs]
        # Bytes are the same also where values are not finite.
        written = [
            f"problem.{function.name}"
            for function, known in zip(functions, values, strict=True)
            if function.x.array.tobytes() != known.tobytes()
        ]
        for name, number in self._step_numbers.items():
            if getattr(self.symbols, name).value != number:
                written.append(f"the Constant {name} of the step")
        if written:
            raise SceneError(
                f"fenicsx: what was written into {written[0]} would be lost. Give a state of your "
                "own to Problem.set_state(q=, v=), and a length to advance(dt)"
            )

    def in_scene(
        self, values: fem.Function | ArrayLike, others: np.ndarray, name: str
    ) -> np.ndarray:
        """Values (size,) of a Function in V, with `others` at nodes without beams, or of rows."""
        expected = "finite: a Function in problem.V, or an array (nodes, 3)"
        if isinstance(values, fem.Function):
            require(values.function_space == self.V, f"set_state: {name}", values, expected)
            sums = np.zeros((2, len(others)))
            np.add.at(sums[0], self.V_numbers, values.x.array)
            np.add.at(sums[1], self.V_numbers, 1.0)
            total, count = self._grid.total(sums)
            result = np.where(count > 0, total / np.maximum(count, 1.0), others)
        else:
            result = np.asarray(values, dtype=float).ravel()
        ok = result.shape == others.shape and np.isfinite(result).all()
        require(ok, f"set_state: {name}", values, expected)
        return result

    def _fill_nodes(self, function: fem.Function, values: np.ndarray) -> None:
        """Set a Function on V by values (size,)."""
        function.x.array[:] = values[self.V_numbers]

    def _set_parameters(self, parameters: np.ndarray | None) -> None:
        """Have values (n,) of all parameters of the scene."""
        if self._parameters is not None and parameters is not None:
            self._parameters.value[:] = parameters[self._grid.beams.data.parameters]
