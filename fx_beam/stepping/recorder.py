"""The recorded histories of a simulation, also of one that ended early."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem.forms import Part
from fx_beam.mechanics.interval import Interval, divided, moment
from fx_beam.model.model import Model
from fx_beam.results.audit import Energy
from fx_beam.results.state import State

# Length of the short step for the forces of row 0, relative to the first step.
_SHORT = 1e-9


@dataclass(frozen=True)
class Record:
    """What a simulation records; energies, momenta and slides are always recorded.

    Parameters
    ----------
    every : int
        Steps between two rows; the start and the last step are always recorded.
    motion : bool
        Whether to record displacements and rotations; stress resultants need them as well.
    rates : bool
        Whether to record velocities and accelerations.
    forces : bool
        Whether to record the forces of supports and joints.
    times : sequence of float, optional
        Increasing times of the rows [s], in place of the ends of steps. Displacements and rotations
        are those of polynomials through the nearest ends of steps, cubic for schemes of order 2, of
        degree 5 for order 4; velocities are their derivatives. Energies and momenta are linear.
        Forces and accelerations are those of the step. All steps are kept until the end of the run;
        the motion must be recorded. Times before the start and after the end are left out.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> scene.clamp(scene.add_beam([(0, 0), (1, 0)], section).start)
    >>> record = fb.Record(every=4, rates=False)
    >>> fb.simulate(scene, dt=0.1, t_end=1.0, record=record).t.round(3)
    array([0. , 0.4, 0.8, 1. ])

    >>> record = fb.Record(times=[0.0, 0.25, 0.5])
    >>> fb.simulate(scene, tolerance=1e-3, t_end=1.0, record=record).t
    array([0.  , 0.25, 0.5 ])
    """

    every: int = 1
    motion: bool = True
    rates: bool = True
    forces: bool = True
    times: Sequence[float] | None = None

    def __post_init__(self):
        whole = isinstance(self.every, int | np.integer) and not isinstance(self.every, bool)
        if not whole or self.every < 1:
            raise SceneError(f"Record: every = {self.every!r} must be a positive whole number")
        for name in ("motion", "rates", "forces"):
            if not isinstance(getattr(self, name), bool | np.bool_):
                raise SceneError(f"Record: {name} = {getattr(self, name)!r} must be True or False")
        if self.times is None:
            return
        try:
            times = np.array(self.times, dtype=float)
        except (TypeError, ValueError):
            times = np.empty(0)
        rising = times.ndim == 1 and len(times) and np.isfinite(times).all()
        if not rising or (np.diff(times) <= 0).any():
            raise SceneError(f"Record: times = {self.times!r} must be increasing finite times")
        if not (self.every == 1 and self.motion):
            raise SceneError("Record: times need every=1 and motion=True")


class Unrecorded:
    """In place of a `Recorder`, for trial steps."""

    every, last, rows = np.iinfo(np.int32).max, -1, 0
    end: State

    def next_rows(self, parts: int) -> dict[str, np.ndarray]:
        """No arrays."""
        return {}

    def add(self, rows: int, parts: int) -> None:
        """Nothing."""

    def record(self, step: int, state: State, starts: Sequence[State] = (), parts: int = 1) -> None:
        """Nothing."""


def _grown(array: np.ndarray, rows: int, used: int) -> np.ndarray:
    """An array with at least some rows, of which those used are kept."""
    if len(array) >= rows:
        return array
    grown = np.zeros((max(rows, 2 * len(array)), *array.shape[1:]), dtype=array.dtype)
    grown[:used] = array[:used]
    return grown


class Recorder:
    """Histories of motion, forces, energies and momenta at the times (n,) of a grid."""

    def __init__(self, model: Model, times: np.ndarray, record: Record):
        self.model, self.every, self.last = model, record.every, -1
        #: Times at the ends of all steps, and numbers of the steps that have a row.
        self._times, self._steps = np.empty(0), np.empty(0, dtype=int)
        self.rows = 0
        #: The last state.
        self.end: State
        self._first: State
        #: Sub-steps (n,) in the step before each row, if all were as long as the last one.
        self._parts = np.empty(0, dtype=int)
        n, size, joints = 0, model.size, len(model.scene.joints)
        self._fractions = model.scheme.fractions
        starts = len(self._fractions) * size
        constrained = model.reduction.columns - model.reduction.free
        #: Rows (n, ...) by name, vectors in the order of the degrees of freedom.
        self.arrays = {"energies": np.zeros((n, 8)), "momenta": np.zeros((n, 3))}
        if joints:
            self.arrays["slides"] = np.zeros((n, joints))
        if record.motion:
            # An array of zeros takes no memory until it is written: starts of the last sub-steps
            # are written only if they differ from the previous row.
            self.arrays |= {"q": np.zeros((n, size)), "before_q": np.zeros((n, starts))}
            if record.rates and model.forms.resultants_need_rates:
                self.arrays |= {f"before_{name}": np.zeros((n, starts)) for name in "va"}
            if width := math.prod(model.forms.internal_shape):
                self.arrays |= {
                    "internal": np.zeros((n, width)),
                    "before_internal": np.zeros((n, width)),
                }
            if model.actuators.width:
                self.arrays["spring_internal"] = np.zeros((n, model.actuators.width))
            if model.forms.needs_before:
                self.arrays |= {"earlier_q": np.zeros((n, size)), "memory": np.zeros((n, 1))}
        if record.rates:
            self.arrays |= {"v": np.zeros((n, size)), "a": np.zeros((n, size))}
        if record.forces:
            self.arrays["constraint_forces"] = np.zeros((n, constrained))
            if joints:
                self.arrays["joint_forces"] = np.zeros((n, 3 * joints))
            if (contact := model.forms.contact) is not None:
                self.arrays["contact_forces"] = np.zeros((n, 2 * len(contact.dofs)))
        self.plan(0, times, last=True)

    def plan(self, first: int, ends: np.ndarray, last: bool) -> None:
        """Make room for steps from number `first` on that end at times (n,); step 0 is the start.

        With `last` the run ends with them. Steps that are planned again replace those before.
        """
        stop = first + len(ends)
        self._times = _grown(self._times, stop, first)
        self._times[first:stop] = ends
        self.last = stop - 1 if last else -1
        steps = np.arange(first, stop)
        steps = steps[(steps % self.every == 0) | (steps == self.last)]
        rows = self.rows + len(steps)
        self._steps, self._parts = (
            _grown(numbers, rows, self.rows) for numbers in (self._steps, self._parts)
        )
        self._steps[self.rows : rows] = steps
        for name, array in self.arrays.items():
            self.arrays[name] = _grown(array, rows, self.rows)

    def next_rows(self, parts: int) -> dict[str, np.ndarray]:
        """Arrays from the next row on, by name, to be written by the compiled loop."""
        kept = self._starts_kept(parts)
        return {
            name: rows[self.rows :]
            for name, rows in self.arrays.items()
            if kept or not name.startswith("before")
        }

    def add(self, rows: int, parts: int) -> None:
        """Count rows that were written, of steps of `parts` sub-steps."""
        self._parts[self.rows : self.rows + rows] = parts
        self.rows += rows

    def _starts_kept(self, parts):
        """Whether the start of the last sub-step differs from the previous row."""
        return self.every > 1 or len(self._fractions) > 1 or parts > 1

    def record(self, step: int, state: State, starts: Sequence[State] = (), parts: int = 1) -> None:
        """Add a row for the end of a step of the grid, if `every` selects it; step 0 is the start.

        `starts` are those of the scheme's sub-steps in the last of the step's equal `parts`.
        """
        if step % self.every and step != self.last:
            return
        if step == 0:
            self._first = self.end = state
        model = self.model
        momentum = state.v if model.scheme.rates.at_rest else model.mass @ state.v
        q, p = model.to_nodes(state.q), model.to_nodes(momentum)
        x = model.mesh.X + q[:, :2]
        potential = 0.0 if model.weight is None else -(model.weight @ state.q)
        strain = model.forms.strain_energy(state.q, state.internal)
        angular = x[:, 0] @ p[:, 1] - x[:, 1] @ p[:, 0] + p[:, 2].sum()
        values: dict[str, Any] = {
            "q": state.q,
            "internal": state.internal,
            "spring_internal": state.spring_internal,
            "v": state.v,
            "a": state.a,
            "constraint_forces": state.constraint_forces,
            "slides": state.slides,
            "joint_forces": state.joint_forces,
            "contact_forces": state.contact_forces,
            "energies": (
                state.v @ momentum / 2,
                strain,
                potential,
                state.work,
                model.spring_energy(state),
                state.dissipated,
                state.algorithmic,
                state.numerical,
            ),
            "momenta": (*p[:, :2].sum(axis=0), angular),
        }
        if starts and self._starts_kept(parts):
            for name in ("q", "v", "a", "internal"):
                values[f"before_{name}"] = [getattr(start, name) for start in starts]
        if starts and starts[0].before is not None:
            values |= {"earlier_q": starts[0].before, "memory": starts[0].memory(state.length)}
        for name, rows in self.arrays.items():
            if values.get(name) is not None:
                rows[self.rows] = np.ravel(values[name])
        self.add(1, parts)

    def add_turns(self, first: int, turns: np.ndarray) -> None:
        """Add the full turns (size,) [rad] that are missing in the rows from `first` on."""
        if "q" in self.arrays and turns.any():
            rows = np.arange(first, self.rows)
            self.arrays["q"][first : self.rows] += turns
            kept = rows[self._starts_kept(self._parts[rows])]
            self.arrays["before_q"][kept] += np.tile(turns, len(self._fractions))
            if "earlier_q" in self.arrays:
                self.arrays["earlier_q"][rows] += turns

    def histories(self) -> dict:
        """Recorded histories by their names in `Solution`; empty if not recorded."""
        model, n = self.model, self.rows
        kept = {name: rows[:n] for name, rows in self.arrays.items()}
        joints, nodes = len(model.scene.joints), len(model.mesh.X)
        none = np.empty((0, nodes, 3))

        def at_nodes(name):
            return kept[name][:, model.mesh.dofs] if name in kept else none

        reactions = none
        if "constraint_forces" in kept:
            reactions = np.zeros((n, nodes, 3))
            supported, components, places = model.supports
            reactions[:, supported, components] = kept["constraint_forces"][:, places]
        motors = np.zeros((n if "constraint_forces" in kept else 0, joints))
        if "constraint_forces" in kept:
            first, numbers = len(model.prescribed), [joint.number for joint, _ in model.motors]
            motors[:, numbers] = kept["constraint_forces"][:, first : first + len(numbers)]
        forces = kept.get(
            "joint_forces", np.empty((0 if "constraint_forces" not in kept else n, 3 * joints))
        )
        contacts = model.forms.contacts
        pushes = kept.get("contact_forces", np.empty((len(forces), 2 * contacts)))
        t = self._times[self._steps[:n]]
        return {
            "t": t,
            "t_level": t - (1 - model.scheme.rates.level) * self._lengths(),
            "q": at_nodes("q"),
            "v": at_nodes("v"),
            "a": at_nodes("a"),
            "reactions": reactions,
            "slides": kept.get("slides", np.empty((n, 0))),
            "joint_forces": forces.reshape(len(forces), joints, 3),
            "motor_forces": motors,
            "contact_forces": pushes.reshape(len(pushes), contacts, 2),
            "internal": self._internal(),
            "spring_internal": kept.get("spring_internal"),
            "energy": Energy(*kept["energies"].T),
            "linear_momentum": kept["momenta"][:, :2],
            "angular_momentum": kept["momenta"][:, 2],
        }

    def _internal(self) -> np.ndarray | None:
        """Internal variables (n, cells, degree, width); None without any, or unrecorded."""
        if "internal" not in self.arrays:
            return None
        return self.arrays["internal"][: self.rows].reshape(-1, *self.model.forms.internal_shape)

    def _lengths(self) -> np.ndarray:
        """Length (n,) of the last sub-step before each row; 0 for row 0."""
        steps = self._steps[: self.rows]
        grid = self._times[steps] - self._times[np.maximum(steps - 1, 0)]
        return grid / self._parts[: self.rows]

    def means(self, values: np.ndarray) -> np.ndarray:
        """Forces (n, ...) of the rows, from those of `last_parts`: means over the sub-steps."""
        first, rest = values[:1], values[1:]
        rest = rest.reshape(self.rows - 1, len(self._fractions), *values.shape[1:])
        return np.concatenate([first, np.tensordot(self._fractions, rest, (0, 1))])

    def last_parts(self) -> Iterator[Part]:
        """The scheme's sub-steps before each row, for which its forces are evaluated.

        Row 0 has a single one, so short that its forces depend on the rates, but not on a motion.
        """
        arrays, forms, first = self.arrays, self.model.forms, self._first
        dt = _SHORT * np.diff(self._times[:2]).sum() or 1.0
        D = dt * first.v if forms.resultants_move else np.zeros(self.model.size)
        short = moment(first.t, dt)
        yield Part(short, D, arrays["q"][0], (first.v, first.a), internal=first.internal)
        times, count = self._times[self._steps[: self.rows]], len(self._fractions)
        ends = divided(times - self._lengths(), times, self._fractions)
        t0, t1 = (np.reshape(places, (-1, count)) for places in ends)
        earlier = [arrays[name] for name in ("earlier_q", "memory") if name in arrays]
        for k in range(1, self.rows):
            kept = self._starts_kept(self._parts[k])
            q, *rates = (
                (arrays[f"before_{name}"][k] if kept else arrays[name][k - 1]).reshape(count, -1)
                for name in ("qva" if forms.resultants_need_rates else "q")
            )
            D = np.concatenate([q[1:], arrays["q"][k : k + 1]]) - q
            internal = None
            if "internal" in arrays:
                found = arrays["before_internal"][k] if kept else arrays["internal"][k - 1]
                internal = found.reshape(forms.internal_shape)
            for i in range(count):
                of_rates = tuple(rate[i] for rate in rates)
                interval = Interval(t0[k, i], t1[k, i])
                part = Part(interval, D[i], q[i], of_rates, internal=internal)
                if earlier:
                    part = part._replace(before=earlier[0][k], memory=float(earlier[1][k, 0]))
                yield part


#: What takes the rows of steps.
Rows = Recorder | Unrecorded
