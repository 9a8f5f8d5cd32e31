"""The whole scene on the first process, the part of each process, and what goes between them."""

from __future__ import annotations

import functools
import math
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.c_library import array_at
from fx_beam.errors import SceneError
from fx_beam.fem.mpi import petsc
from fx_beam.laws.interval import Interval
from fx_beam.laws.schemes import Scheme
from fx_beam.results.records import Stats
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam
from fx_beam.scene.sliders import sliding_joints
from fx_beam.step.equations import Equations
from fx_beam.step.forcing import Forcing
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.loop import CompiledLoop, Steps, StepsResult
from fx_beam.step.model import Model
from fx_beam.step.newton import NEGLIGIBLE, NewtonOptions
from fx_beam.step.recorder import Rows
from fx_beam.step.step_inputs import StepInputs, no_inputs
from fx_beam.step.tables import Problem

from .linear_system import LinearSystem, Solved
from .partition import Share, divided
from .process_group import ProcessGroup, RemoteObjects

# Error of a step's energy, relative to it, that solutions may leave.
_ENERGY_ERROR = 1e-13
_ADVICE = "it runs on one process: start the script without mpirun"


def _check(model: Model) -> None:
    """Refuse what cannot be computed on several processes."""
    scene, couplings = model.scene, model.couplings
    for part, present in (
        ("a node that slides on a beam", sliding_joints(scene.joints)),
        ("contact between members", any(isinstance(o.shape, Beam) for o in scene.contacts)),
        ("a gear", scene.gears),
        ("virtual works of your own", scene.virtual_works),
        ("damping of a scene", scene.dampings),
        ("a closed loop of joints", couplings.closures),
        ("a long tree of joints", couplings.auxiliaries),
        ("a scheme of your own", not model.scheme.built_in),
        ("a mechanism that its loads hold", model.mechanism),
        ("a scene without unknowns", not model.reduction.free),
    ):
        if present:
            raise SceneError(f"on several processes: {part} is not possible yet; {_ADVICE}")


@contextmanager
def shared(team: ProcessGroup | None, loop: LoadLoop) -> Iterator[None]:
    """Let all processes take load steps for a while, if there are any."""
    if team is not None:
        loop.together = RemoteStep(team, loop)
    try:
        yield
    finally:
        if loop.together is not None:
            loop.together.leave()
            loop.together = None


class RemoteStep:
    """What all processes do in the place of C: ``Team`` of c/problem.h."""

    def __init__(self, team: ProcessGroup, loop: CompiledLoop):
        # Nothing here refers to itself or to the loop: with this the parts go at once.
        model, self._loop = loop.model, weakref.proxy(loop)
        #: The equations of steps.
        inputs = loop.forcing, loop.failures.options, loop.stats
        self.equations = DistributedEquations(team, *inputs)
        self._error: BaseException | None = None
        self._at_rest, self._driven = model.scheme.rates.at_rest, model.reduction.driven
        self._size, self._free = model.size, model.reduction.free
        ffi, self._team = loop.problem.ffi, loop.problem.c.team
        self._null, self._array = ffi.NULL, functools.partial(array_at, ffi)
        weak_self, fail = weakref.ref(self), _of(weakref.ref(self), "_fail")
        #: Functions that C calls.
        self._calls = {
            name: ffi.callback(
                ffi.typeof(getattr(self._team, name)), _of(weak_self, name), onerror=fail
            )
            for name in ("begin", "forces", "change", "solve")
        }
        for name, call in self._calls.items():
            setattr(self._team, name, call)

    def leave(self) -> None:
        """Let one process go on alone."""
        for name in self._calls:
            setattr(self._team, name, self._null)

    def check(self) -> None:
        """Raise the error of the last step, if there was one."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _fail(self, kind: type, error: BaseException, trace: Any) -> None:
        self._error = self._error or error

    def begin(self, t: float, dt: float) -> None:
        """Begin a sub-step of a length [s]."""
        p, interval = self._loop.problem.c, Interval(t, t + dt)
        if self._at_rest:
            interval = Interval(p.statics.ratio_before, p.state.ratio)
        if self._error is None:
            self.equations.begin(interval, self._loop.state.read(interval.start))

    def forces(self, z: Any, loads: Any, f: Any, r: Any) -> None:
        """Find forces and residual for increments of the columns, and loads."""
        size, free = self._size, self._free
        out = self._array(f, size), self._array(r, size)
        out[1][:] = np.nan
        if self._error is None:
            increments = self._array(z, free + self._driven)
            changes = increments[:free], increments[free:], self._array(loads, size)
            out[0][:], out[1][:] = self.equations.at(*changes)

    def change(self, x: Any, df: Any) -> None:
        """Find the change of forces df = K dx (size,) for a change dx of the nodes."""
        out = self._array(df, self._size)
        out[:] = np.nan
        if self._error is None:
            out[:] = self.equations.change(self._array(x, self._size))

    def solve(self, b: Any, energy: float, solution: Any, error: Any) -> None:
        """Find the correction x and its error for a residual b; `energy` is that of the step."""
        x = self._array(solution, self._free)
        x[:] = np.nan
        if self._error is None:
            x[:], error[0] = self.equations.solve(self._array(b, self._free).copy(), energy)


def _of(together: Callable[[], RemoteStep | None], method: str) -> Callable[..., None]:
    return lambda *arguments: getattr(together(), method)(*arguments)


class TeamLoop(CompiledLoop):
    """Takes time steps one by one: each process evaluates its part, and PETSc solves."""

    def __init__(self, team: ProcessGroup, forcing: Forcing, options: NewtonOptions, stats: Stats):
        super().__init__(forcing, options, stats, alone=False)
        self.together = RemoteStep(team, self)
        stats.solver = f"PETSc on {team.size} processes"

    def inputs_ahead(self, t: float, ends: np.ndarray) -> StepInputs:
        """None: functions of time are evaluated in each step."""
        return no_inputs(len(self.model.scheme.fractions))

    def take(
        self, state: State, steps: Steps, recorder: Rows, completed: Callable[[int], int] = int
    ) -> StepsResult:
        """Take the first of some steps or parts, if it succeeds."""
        end = steps.ends[:1]
        first_step = steps._replace(ends=end, inputs=super().inputs_ahead(state.t, end))
        return super().take(state, first_step, recorder, completed)


class DistributedEquations:
    """The equations of a step: parts evaluate all but forces at points, which are added here."""

    def __init__(self, team: ProcessGroup, forcing: Forcing, options: NewtonOptions, stats: Stats):
        self.model, self._natural = (model := forcing.model), forcing.natural
        #: Where iterations are counted; sqrt(b.x) / |x| of the last solution.
        self._stats, self._stiffness = stats, 0.0
        _check(model)
        if forcing.turning is not None:
            raise SceneError(f"static: spin on several processes is not possible yet; {_ADVICE}")
        petsc()
        self._team = team
        self._shares, self._numbers, counts = divided(model, team.size)
        self._ends = np.cumsum(counts)
        kind = "MUMPS" if model.scheme.rates.at_rest else "Schwarz"
        negligible = NEGLIGIBLE * options.tolerance * min(model.mesh.size, 1.0)
        shared = model.scheme, forcing.time, counts, kind, negligible
        self._crew = team.make(Part, [(share, *shared) for share in self._shares])
        for share in self._shares:
            share.runs.clear()  # the parts have them
        column = np.empty(self._ends[-1], dtype=int)
        column[self._numbers] = np.arange(len(self._numbers))
        #: Degrees of freedom and unknowns of each part, by their numbers in the whole.
        self._dofs = [model.mesh.dofs[share.rows].ravel() for share in self._shares]
        self._columns = [column[numbers] for numbers in self._crew("unknowns")]
        #: Whether a part owns the forces at its degrees of freedom.
        self._owned = [np.repeat(share.owned, 3) for share in self._shares]
        K, points = model.forms.stiffness, model.points
        #: Entries of the tangent of forces at points.
        self._at_points = np.unique(points.value_at[points.value_at >= 0])
        rows = np.searchsorted(K.indptr, self._at_points, side="right") - 1
        self._entries = rows, K.indices[self._at_points]
        #: Pairs of unknowns that these entries couple, row * free + column.
        self._pairs = np.empty(0, dtype=int)
        self._set_pattern()

    def pieces(self) -> tuple[list[np.ndarray], Callable[..., RemoteObjects]]:
        """Elements of each process, and what makes objects on all."""
        return [share.elements for share in self._shares], self._team.make

    # -- A step -----------------------------------------------------------------------------------

    def begin(self, interval: Interval, start: State) -> None:
        """Set the interval of a step and the state at its start, everywhere."""
        self.model.reduction.begin(start.q, start.slides)
        end = self._natural(interval.end)
        starts = [self._start_of(i, start) for i in range(self._team.size)]
        pairs, values = zip(self._shares, starts, strict=True), self.model.forms.parameters.values
        arguments = [(interval, start, _in_part(share, end), values) for share, start in pairs]
        self._crew("begin", arguments)

    def _start_of(self, part: int, start: State) -> dict[str, Any]:
        """What a part needs of the state."""
        dofs, share = self._dofs[part], self._shares[part]
        numbers = [joint.number for joint, *_ in share.joints]
        state = {"q": start.q[dofs], "v": start.v[dofs], "a": start.a[dofs]}
        state |= {"slides": start.slides[numbers], "length": start.length}
        if start.q_previous is not None:
            state["q_previous"] = start.q_previous[dofs]
        for name in ("internal", "natural"):
            state[name] = _in_part(share, getattr(start, name))
        return state

    def at(
        self, y: np.ndarray, driven: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces and residual (size,) at increments of the unknowns and of driven motion."""
        model = self.model
        D = model.reduction.increment(y, driven)
        f, r = np.zeros(model.size), np.zeros(model.size)
        model.points.add_force(D, f)
        model.forms.stiffness.data[self._at_points] = 0.0
        model.points.add_tangent(model.forms.stiffness.data)
        loads = force - f
        parts = zip(self._columns, self._shares, self._owned, self._dofs, strict=True)
        arguments = [
            (y[columns], driven[share.driven], np.where(owned, loads[dofs], 0.0))
            for columns, share, owned, dofs in parts
        ]
        balances = self._crew("at", arguments)
        for dofs, (force_of_part, residual) in zip(self._dofs, balances, strict=True):
            f[dofs] += force_of_part
            r[dofs] += residual
        return f, r

    def change(self, D: np.ndarray, sizes: bool = False) -> np.ndarray:
        """Change (size,) of the forces with D (size,), as `Equations.change`."""
        point_tangent = self._tangent_of_points()
        out = (abs(point_tangent) if sizes else point_tangent) @ D
        changes = self._crew("change", [(D[dofs], sizes) for dofs in self._dofs])
        for dofs, change in zip(self._dofs, changes, strict=True):
            out[dofs] += change
        return out

    # -- Forces at points -------------------------------------------------------------------------

    def _tangent_of_points(self) -> scipy.sparse.csr_matrix:
        values, size = self.model.forms.stiffness.data[self._at_points], self.model.size
        return scipy.sparse.csr_matrix((values, self._entries), (size, size))

    def _set_pattern(self) -> None:
        free = self.model.reduction.free
        pairs = self._numbers[np.column_stack(np.divmod(self._pairs, free))]
        empty_pairs = [(np.empty((0, 2), dtype=int),)] * (self._team.size - 1)
        self._crew("set_pattern", [(pairs,), *empty_pairs])

    def _of_points(self) -> np.ndarray:
        """Values of the reduced tangent of forces at points, for `_pairs`."""
        points, free = self.model.points, self.model.reduction.free
        if not len(points):
            return np.empty(0)
        reduced = self.model.reduction.reduced(self._tangent_of_points()).tocoo()
        columns, slopes = points.columns, points.on_slides(1)
        free_columns = columns < free
        rows = np.concatenate([reduced.row, columns[free_columns]]).astype(int)
        values = np.concatenate([reduced.data, slopes[free_columns]])
        keys = rows * free + np.concatenate([reduced.col, columns[free_columns]])
        if len(np.setdiff1d(keys, self._pairs)):
            self._pairs = np.union1d(self._pairs, keys)
            self._set_pattern()
        position = np.searchsorted(self._pairs, keys)
        return np.bincount(position, values, len(self._pairs))

    # -- The linear system ------------------------------------------------------------------------

    def solve(self, b: np.ndarray, energy: float) -> tuple[np.ndarray, float]:
        """Solution x (free,) for the reduced tangent, and its relative error.

        x is not finite if the tangent is singular, and as exact as a step of this energy needs.
        """
        least, point_values = np.inf, self._of_points()
        if self._stiffness:
            least = _ENERGY_ERROR * math.sqrt(energy) / self._stiffness
        right = np.zeros(self._ends[-1])
        right[self._numbers] = b
        parts, none = np.split(right, self._ends[:-1]), np.empty(0)
        arguments = [(point_values if not i else none, part, least) for i, part in enumerate(parts)]
        solved: list[Solved] = self._crew("solve", arguments)
        x, first = np.concatenate([part.x for part in solved])[self._numbers], solved[0]
        if first.size:
            self._stiffness = math.sqrt(abs(b @ x)) / first.size
        self._stats.krylov_iterations += first.iterations
        self._stats.solver = f"PETSc on {self._team.size} processes, {first.kind}"
        return x, first.error


def _in_part(share: Share, values: np.ndarray | None) -> np.ndarray | None:
    """Values (cells, ...) in the order of the elements of a part, if there are any."""
    return None if values is None else values[share.elements]


class Part:
    """A share of the scene as a model, with its equations."""

    def __init__(self, share: Share, scheme: Scheme, time: float, *numbering: Any):
        self._model = model = Model(share.scene(), scheme, part=True)
        problem = Problem(model, NewtonOptions(), forces_only=True)
        problem.set_given_strains(None)
        self._natural: np.ndarray | None = None
        self._equations = Equations(model, time, None, lambda end: self._natural, problem)
        column, dof, slide_column, joint = model.couplings.free_columns
        #: Numbers (free,) of the unknowns in the whole linear system.
        self._unknowns = np.full(model.reduction.free, -1)
        self._unknowns[column] = share.unknowns.ravel()[dof]
        self._unknowns[slide_column] = share.slides[joint]
        assert (self._unknowns >= 0).all(), "a part has other unknowns than the whole"
        #: Indices of the part's parameters in the list of the scene.
        self._parameters = [share.parameters.index(name) for name in model.forms.parameters.names]
        self._system = LinearSystem(*numbering)

    def unknowns(self) -> np.ndarray:
        """Numbers (free,) of the unknowns in the whole linear system."""
        return self._unknowns

    def begin(
        self,
        interval: Interval,
        start: dict[str, Any],
        natural_end: np.ndarray | None,
        parameters: np.ndarray,
    ) -> None:
        """Begin a step from a part of the state, with the natural strains at its end."""
        state = State(interval.start, np.empty(0), **start)
        self._model.forms.parameters.keep(parameters[self._parameters])
        self._natural = natural_end
        self._equations.begin(interval, state)
        self._system.begin()

    def at(
        self, y: np.ndarray, driven: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The part's internal forces and residual (size,), for the loads that it owns."""
        balance = self._equations.at(y, driven, force)
        return balance.f, balance.r

    def change(self, D: np.ndarray, sizes: bool) -> np.ndarray:
        """The part's change of forces K D; with `sizes` |K| D."""
        return self._equations.change(D, sizes)

    def set_pattern(self, added: np.ndarray) -> None:
        """Set the pattern of the linear system, with (m, 2) more entries; all processes at once."""
        indptr, indices = self._model.reduction.tangent.pattern
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        self._system.set_pattern(self._unknowns, rows, indices, added)

    def solve(self, added_values: np.ndarray, b: np.ndarray, least: float) -> Solved:
        """Unknowns of this process from its part b of the right-hand side; all at once.

        `added_values` are those of the added entries, `least` is a negligible error.
        """
        return self._system.solve(self._equations.values, added_values, b, least)

    def destroy(self) -> None:
        """Free what PETSc has; all processes at once."""
        self._system.destroy()
