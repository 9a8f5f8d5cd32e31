"""Load steps in C, one at a time: equilibria at rising load factors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.c_library import array_at
from fx_beam.dual import floats
from fx_beam.laws.interval import Interval
from fx_beam.results.records import Stats
from fx_beam.results.state import State

from .equations import Equations, Residual
from .forcing import LoadForcing
from .loop import CompiledLoop
from .newton import NewtonOptions
from .recorded_histories import sums_of
from .recorder import Recorder
from .step_inputs import StepInputs


class StepSolution(NamedTuple):
    """A converged step."""

    #: Increment (size,) of displacements and rotations, and (free,) of the unknowns.
    D: np.ndarray
    y: np.ndarray
    #: Forces and couples (size,) of supports and joints [N, N m].
    r: np.ndarray
    #: Number of corrections, and why they ended: "increment" or "round-off".
    iterations: int
    ended_by: str
    #: D by the tangent at the start: the linear predictor.
    predicted: np.ndarray


class LoadLoop(CompiledLoop):
    """Takes steps of the load factor; the states of a model have it in place of time."""

    forcing: LoadForcing

    def __init__(self, forcing: LoadForcing, options: NewtonOptions, stats: Stats):
        super().__init__(forcing, options, stats)
        model = forcing.model
        free = model.reduction.free
        #: Holding forces (free,) on the unknowns, in addition to the forces of the model.
        self.hold, self._predicted = np.zeros(free), np.zeros(model.size)
        #: Weights (size,) of a viscous drag on increments; zero at points at which nothing acts.
        self.drag_weight = np.where(model.acted_on, model.units.nodes**-2.0, 0.0)
        diagonal_at = self.problem.storage.stored_at[model.masses.places.diagonal]
        self.problem.set(
            numbers={"viscous_weight": self.drag_weight},
            work={
                "statics": {"hold": self.hold, "diagonal_at": diagonal_at},
                "newton": {"predicted": self._predicted},
            },
        )
        self.problem.set_frame(forcing.turning)
        n, columns = model.size, model.reduction.columns
        sizes = {"D": n, "z": columns, "r": n, "tangent": self.problem.storage.entries}
        # Increments of nodes and columns, the residual at nodes, and the tangent, by C.
        self._results = [*self.problem.results(**sizes)]
        # A record of forces alone, for one step.
        self._one_row, self._row = self.problem.ffi.new("Record *"), np.zeros(1, np.int32)
        self._one_row.every = self._one_row.first = self._one_row.parts = self._one_row.forces = 1
        self._one_row.up_to_row = self.problem.ffi.from_buffer("int[]", self._row)
        # Dead forces at the end and their mean, and natural strains, for C.
        self._given_forces = [*self.problem.given()]
        #: The equations of load steps, which have the arrays of the loop.
        time, turning = forcing.time, forcing.turning
        self.equations = Equations(model, time, turning, forcing.natural, self.problem)

    @property
    def drag(self) -> float:
        """Drag [J] on increments, in all tangents and residuals of the loop and its equations."""
        return float(self.problem.c.work.statics.viscosity)

    @drag.setter
    def drag(self, drag: float) -> None:
        self.problem.set(work={"statics": {"viscosity": drag}})

    def record(self, state: State, recorder: Recorder) -> None:
        """Record a state in the next row of a recorder.

        Masses of a frame that turns have no rotary inertia in C.
        """
        super().record(state, recorder)
        if (frame := self.forcing.turning) is not None:
            rows, row = recorder.arrays, recorder.rows - 1
            spin = (self.model.masses.matrix - frame.mass) @ state.v
            rows["energies"][row, 0] += state.v @ spin / 2
            rows["momenta"][row] += sums_of(self.model, state.q[None], spin[None])[0]

    def balance(self, state: State, factor: float) -> Residual:
        """The equations in a state at a load factor, without holding forces."""
        self.equations.set_start(Interval(factor, factor), state)
        return self.equations.at_start(self.forcing.dead(factor))

    def step(self, state: State, interval: Interval) -> tuple[State, StepSolution]:
        """State at the end of a load step, and its increment; StepFailed if none is found."""
        p, length = self.problem.c, interval.length
        inputs = self._begin_step(state, interval, length)
        self.problem.library.fx_take_counts(p)  # those of the steps before
        self._one_row.rows = 0
        c_inputs, t = inputs.in_c(self.problem.ffi), self.forcing.time - length
        if not self._steps(1, t, length, c_inputs, self._one_row):
            raise self.failures.in_c(self.problem, state)
        ended_by = "round-off" if p.work.counts.by_round_off else "increment"
        D, z, r, _ = self._results
        y, predicted = z[: self.model.reduction.free].copy(), self._predicted.copy()
        step = StepSolution(D.copy(), y, r.copy(), p.work.newton.tried, ended_by, predicted)
        return self._taken(state, interval), step

    def finished(self, state: State, interval: Interval, y: np.ndarray, r: np.ndarray) -> State:
        """State at the end of a step whose increment and forces are known.

        No time passes for internal variables.
        """
        driven = self.forcing.positions(interval.end)
        inputs = self._begin_step(state, interval, 0.0)
        z = self.model.reduction.in_columns(y, driven - self.forcing.current(state))
        c_inputs, r = inputs.in_c(self.problem.ffi), np.ascontiguousarray(r)
        c_inputs.known, c_inputs.known_forces = map(
            self.problem.ffi.from_buffer, ("double[]",) * 2, (z, r)
        )
        self._one_row.rows = 0
        self._steps(1, self.forcing.time, 0.0, c_inputs, self._one_row)
        return self._taken(state, interval)

    def _begin_step(self, state: State, interval: Interval, length: float) -> StepInputs:
        """Begin in a state; the inputs of the step."""
        model, forcing, self._interval = self.model, self.forcing, interval
        self.state.load(state)
        model.forms.compiled_points.set_load(interval.end, length)
        force, mean_force, strains = self._given_forces
        force[:], mean_force[:] = map(forcing.dead, (interval.end, interval.time_at(0.5)))
        if model.masses.weight is not None:  # whose work is all of its potential energy
            mean_force -= model.masses.weight
        if (natural := forcing.natural(interval.end)) is not None:
            strains[:] = natural.ravel()
        t, followers = np.array([forcing.time]), model.points.followers
        follower_force = floats(followers.series(t, t)) if len(followers) else np.empty((1, 0))
        values = np.array([[model.forms.parameters.values] * 2])
        driven, none = floats(forcing.positions(interval.end))[None], np.empty((1, 0))
        return StepInputs(none, driven, follower_force, values, none, 1, ratio=interval.end)

    def interval(self, dt: float) -> Interval:
        """Load factors of the step that C takes."""
        return self._interval

    def _taken(self, state: State, interval: Interval) -> State:
        new = self.state.read().changed(t=interval.end)
        if (frame := self.forcing.turning) is not None:
            pushes = (end.t * frame.force(end.q) for end in (state, new))
            new.work += float(sum(pushes) / 2 @ self._results[0])
        return new

    def change_of_sizes(self, left: np.ndarray, right: np.ndarray) -> float:
        """Product of sizes: of a vector (size,), of the last tangent's entries, and `right`."""
        return float(abs(left) @ self.equations.change(right, sizes=True))

    # -- The last tangent -------------------------------------------------------------------------

    @property
    def singular(self) -> bool:
        """Whether it was singular, or nearly."""
        return self.problem.c.work.newton.raised < 0

    @property
    def values(self) -> np.ndarray:
        """Values of the last tangent, in the sparsity of the reduced matrix."""
        return self._results[3]

    def negative_eigenvalues(self) -> int | None:
        """Number of negative eigenvalues of a symmetric tangent; None if it is singular.

        By Sylvester's law of inertia: the pivots have their signs. The next step has its factors.
        """
        p = self.problem.c
        if p.work.newton.raised:
            return None
        if p.work.newton.old_factors and not self.problem.library.fx_renew_factors(p):
            return None
        if not p.tables.system.unknowns:
            return 0
        rows = p.work.factors.rows
        factors = array_at(self.problem.ffi, rows.factors, rows.start[p.tables.system.unknowns])
        diagonal = array_at(self.problem.ffi, rows.diagonal, p.tables.system.unknowns)
        return int((factors[diagonal] < 0).sum())
