"""The state in C, one piece of memory by the schema of `State`, and values of states."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fx_beam.content_cache import shallow_copy
from fx_beam.laws.interval import Interval, StepBatch
from fx_beam.laws.schemes import order_and_constant
from fx_beam.results.state import ARRAYS, FORCES, NUMBERS, Past, State
from fx_beam.scene.joints import joints_by_number

from .block import aligned_zeros
from .model import Model, fact, sizes_of

# -- The state in C, one piece of memory by the schema of `State`, and copies of it -------------


# An empty state, which is copied and filled to make others.
_EMPTY = np.empty(0)
_NOTHING = State(t=0.0, motors=_EMPTY, q=_EMPTY, v=_EMPTY, a=_EMPTY, slides=_EMPTY)
_SCALARS_OF = operator.itemgetter(*NUMBERS)
#: A copy of the memory, and of the numbers that go with it.
StateCopy = tuple[np.ndarray, bytes]


class StateVector:
    """The state of a problem in C, with its past and its local errors."""

    def __init__(self, model: Model, c: Any, ffi: Any, C: Any):
        n, self._most = model.size, C.PAST
        shapes = {name: array.lengths(fact(model, sizes_of)) for name, array in ARRAYS.items()}
        sizes = {name: math.prod(shape) for name, shape in shapes.items()}
        # Arrays of the state that are empty, by name, and shapes of the others.
        self._empty = {name: np.zeros(shape) for name, shape in shapes.items() if not sizes[name]}
        self._shapes = {name: shape for name, shape in shapes.items() if sizes[name]}
        sizes["driven_now"] = model.reduction.driven
        # Where each unknown is a displacement of nodes, its differences are those of the nodes.
        unknowns = 0 if model.couplings.is_selection else model.reduction.free
        past = {"ages": C.PAST + 1, "past": C.PAST * (n + unknowns)}
        errors = {"ages": C.PAST + 1, "past": C.PAST * n, "last": (C.AVERAGED - 1) * n}
        all_sizes = sizes | past | {f"error_{name}": size for name, size in errors.items()}
        memory = aligned_zeros(sum(all_sizes.values()))
        ends = itertools.pairwise(itertools.accumulate(all_sizes.values(), initial=0))
        #: Where its arrays are in the memory, which C copies before a step with sub-steps.
        self.places = dict(zip(all_sizes, itertools.starmap(slice, ends), strict=True))
        self._begin_in(model, c, ffi, memory)
        self._ages[0][:] = self._ages[1][:] = 1.0
        # Zeros for those that are not empty, which the memory begins with.
        self._blank = {name: np.broadcast_to(0.0, shape) for name, shape in self._shapes.items()}
        # Names of those that states have: before the first step, and after it without and with the
        # forces of joints and obstacles, which only steps that are recorded compute.
        names = [name for name in ARRAYS if name in self._blank or ARRAYS[name].required]
        names_at_start = [name for name in names if name not in FORCES]
        self._readable = (
            names_at_start,
            [*names_at_start, "constraint_forces"],
            [*names_at_start, *FORCES],
        )
        arrays = {name: memory[place] for name, place in self.places.items()}
        state_arrays = {name: arrays[name] for name in sizes}
        #: Members of ``Work`` of c/work.h.
        self.members: dict[str, dict[str, object]] = {
            "state": {"memory": self.memory, "size": len(self.memory), **state_arrays},
            "predictor": {name: arrays[name] for name in past},
            "control": {name: arrays[f"error_{name}"] for name in errors},
        }

    def _begin_in(self, model: Model, c: Any, ffi: Any, memory: np.ndarray) -> None:
        """Have the state in a piece of memory."""
        self._model, self._c, self.memory, places = model, c, memory, self.places
        #: Arrays of the state by name.
        self.arrays = self._empty | {
            name: memory[places[name]].reshape(shape) for name, shape in self._shapes.items()
        }
        # All of them, and positions (driven,) of driven motions.
        self._of_state = memory[: places["driven_now"].start]
        self._driven = memory[places["driven_now"]]
        self._ages = memory[places["ages"]], memory[places["error_ages"]]
        # Numbers that go with the memory, in structs of C that follow each other, as bytes.
        first, stop = (ffi.offsetof("Work", name) for name in ("state", "run"))
        self._numbers = ffi.buffer(ffi.addressof(c.work, "state"), stop - first)
        # Those of a `State` among them follow each other, in the order of `NUMBERS`.
        place = ffi.offsetof("State", NUMBERS[0])
        self._scalars = np.frombuffer(self._numbers, float, len(NUMBERS), place)
        # Ages, and divided differences of nodes (PAST, size) and of unknowns (PAST, free or 0).
        past, n = memory[places["past"]].reshape(self._most, -1), model.size
        self._past = self._ages[0], past[:, :n], past[:, n:]

    def in_block(self, model: Model, c: Any, ffi: Any, memory: np.ndarray) -> StateVector:
        """The state of a run, in its memory, which is as it was here at first."""
        other = shallow_copy(self)
        other._begin_in(model, c, ffi, memory)
        return other

    def load(self, state: State) -> None:
        """Write a state into the memory."""
        p, values = self._c, vars(state)
        pairs = ((values[name], zeros) for name, zeros in self._blank.items())
        arrays = [zeros if array is None else array for array, zeros in pairs]
        np.concatenate(arrays, axis=None, out=self._of_state)
        if len(state.motors):
            self._driven[len(self._model.prescribed) :] = state.motors
        p.work.state.steps_done = state.constraint_forces is not None
        p.work.state.forces_found = state.joint_forces is not None
        self._scalars[:] = _SCALARS_OF(values)
        if p.tables.scheme.keeps_previous and state.q_previous is None:
            self.arrays["q_previous"][:], p.work.state.length = state.q, 0.0

    @property
    def t(self) -> float:
        """Time [s]."""
        return self._c.work.state.t

    def read(self) -> State:
        """A copy of the state, without its past."""
        numbers = self._c.work.state
        names = self._readable[(numbers.steps_done > 0) * (1 + bool(numbers.forces_found))]
        values: dict[str, object] = {name: self.arrays[name].copy() for name in names}
        values.update(zip(NUMBERS, self._scalars.tolist(), strict=True))
        values["motors"] = self._driven[len(self._model.prescribed) :].copy()
        return _NOTHING.changed(**values)

    @property
    def past(self) -> Past:
        """The last configurations, from which the next increment is predicted."""
        p, model = self._c, self._model
        known = min(p.work.predictor.known, len(self._past[1]))
        ages, differences, y = (values[:known].copy() for values in self._past)
        slides = model.couplings.free_slides(y, model.scene.joint_count)
        orders = np.array(list(p.work.predictor.orders[0 : p.tables.scheme.sub_steps]))
        return Past(ages, orders, differences, slides)

    @past.setter
    def past(self, past: Past | None) -> None:
        predictor, parts = self._c.work.predictor, self._c.tables.scheme.sub_steps
        if past is None:  # nothing is predicted in the next step
            predictor.known, predictor.orders[0:parts] = 0, [0] * parts
            return
        predictor.known = known = len(past.ages)
        predictor.orders[0:parts] = past.orders.tolist()
        y = self._model.couplings.unknowns(past.differences, past.slides)
        y = y[:, : self._past[2].shape[1]]
        for values, rows in zip(self._past, (past.ages, past.differences, y), strict=True):
            values[:known] = rows

    def forget_errors(self) -> None:
        """Do not compare the next steps with those before."""
        control = self._c.work.control
        control.scheme_order, _ = order_and_constant(self._model.scheme)
        control.known, control.ratios = 0, [-1.0, -1.0]

    def copy(self) -> StateCopy:
        """A copy of all, for `restore`."""
        # Behind all else there are the past and local errors, as far as these are known.
        stop = None
        if not self._c.work.control.known:
            stop = self.places["error_ages" if self._c.work.predictor.known else "ages"].start
        return self.memory[:stop].copy(), bytes(self._numbers)

    @contextmanager
    def unchanged(self) -> Iterator[None]:
        """In this block steps are tried, after which all is as before."""
        copy = self.copy()
        try:
            yield
        finally:
            self.restore(copy)

    def arrays_of(self, copy: StateCopy) -> Callable[[str], np.ndarray]:
        """Arrays of a copy by name, as vectors."""
        return lambda name: copy[0][self.places[name]]

    def restore(self, copy: StateCopy) -> None:
        """Have all again as it was copied."""
        self.memory[: len(copy[0])], self._numbers[:] = copy


# -- Values of states of a model: energies, rates of slides, and starts of steps from them ------


def energy_of(model: Model, state: State) -> float:
    """Kinetic, stored and potential energy [J]."""
    forms, weight = model.forms, model.masses.weight
    forms.parameters.use(state.parameters)
    strained = forms.strain_energy(state.q, state.internal, state.natural)
    stored = forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
    potential = 0.0 if weight is None else -(weight @ state.q)
    kinetic = state.v @ (model.masses.matrix @ state.v) / 2 if state.v.any() else 0.0
    return float(sum((kinetic, strained, potential, stored)))


def start_of(model: Model, state: State, length: float) -> StepBatch:
    """The start of a step of some length [s] from a state, for the forces.

    Natural strains do not change in the step.
    """
    # At mid-step forces at points depend on mean rates alone.
    needed = model.scheme.rates.level != 0.5 and not model.scheme.rates.at_rest
    rates = slide_rates(model, state) if needed else 0 * state.slides
    return StepBatch.single(
        state.t,
        length,
        q=state.q,
        v=state.v,
        a=state.a,
        q_previous=state.q if state.q_previous is None else state.q_previous,
        memory=np.array(state.memory(length)),
        internal=state.internal,
        slides=state.slides,
        slide_rates=rates,
        spring_internal=state.spring_internal,
        natural=state.natural,
        natural_end=state.natural,
    )


def added_force(model: Model, state: State, factor: float, time: float) -> np.ndarray:
    """Followers and added virtual works (size,) of a state at a load factor [N, N m]."""
    zero, forms = np.zeros(model.size), model.forms
    if not forms.has_added:
        return zero
    forms.set_load(factor)
    forces = forms.begin_step(Interval(time, time), start_of(model, state, 0.0))
    forces.internal(zero)
    return forces.added()


def slide_rates(model: Model, state: State) -> np.ndarray:
    """Rates (joints,) of the slides on which forces act; zero for others."""
    rates = np.zeros(len(state.slides))
    if len(model.points.slides):
        motion = model.mesh.motion(model.scene, q=state.q[None], v=state.v[None])
        joints = joints_by_number(model.scene)
        for number in set(model.points.slides.tolist()):
            kinematics = joints[number].kinematics
            (rates[number],) = kinematics.rate(motion, state.slides[[number]])
    return rates
