"""Rates that fit the joints, and the arrays of a linearised sub-step."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.c_library import Structs
from fx_beam.dual import LinearChanges

from .block import aligned_zeros
from .model import Model
from .tables import ProblemInC, problem_of
from .tangent_storage import ProblemKind

# -- The table of named arrays in the vector of a linearised sub-step (c/blocks.h) --------------


#: Arrays by name.
Arrays = Mapping[str, np.ndarray]
_FIRST_OF_STEPS, _FIRST_OF_RESULTS = "loads", "Y1"


class Numbers(NamedTuple):
    """Numbers of a scene with one name: where the vector has them, some more than once."""

    at: np.ndarray
    #: Which of how many numbers these are.
    of: np.ndarray
    size: int

    def sums(self, x: np.ndarray) -> np.ndarray:
        """Sums (size,) of the entries of a vector x that belong to each number."""
        return np.bincount(self.of, x[self.at], self.size)


def all_of(places: np.ndarray) -> Numbers:
    """Numbers in their order."""
    return Numbers(places.ravel(), np.arange(places.size), places.size)


class StepVariables:
    """Where the arrays are, by their names in C with spaces."""

    def __init__(self, problem: ProblemInC, c: Any):
        fields = [name for name, _ in problem.ffi.typeof(c).fields]
        starts = {name.replace("_", " "): getattr(c, name) for name in fields}
        #: The indices of all arrays; length of the vector.
        ends = itertools.pairwise(starts.values())
        self.at = {name: np.arange(*part) for name, part in zip(starts, ends, strict=False)}
        self.size, names = starts["size"], [*self.at]
        first, end = names.index(_FIRST_OF_STEPS), names.index(_FIRST_OF_RESULTS)
        #: Names of the numbers of the scene and of its state.
        self.numbers = names[:first]
        #: Indices of the numbers of each sub-step among these, and how many there are.
        self.steps = {name: self.at[name] - starts[_FIRST_OF_STEPS] for name in names[first:end]}
        self.step_size = starts[_FIRST_OF_RESULTS] - starts[_FIRST_OF_STEPS]
        model, p = problem.model, problem.c.tables
        self._group_size = problem.constants.GROUP_SIZE
        #: Indices of the slides of all joints.
        self.slides = np.full(model.scene.joint_count, starts["nowhere"])
        for joint, column in model.couplings.slides.items():
            self.slides[joint] = starts["Y"] + column
        #: Rows of states, of forces, of configurations at ends, closures and forces on unknowns.
        arrays = "q", "v", "internal", "spring internal", "natural"
        state_places = {name: self.at[name] for name in arrays}
        constrained = self.at["R"][p.free : p.columns]
        self.states = Rows(state_places | {"slides": self.slides})
        self.ends = Rows({"q": self.at["q1"]})
        self.closures = Rows({"closures": self.at["closures"]})
        self.forces = Rows({"constraints": constrained, "joints": self.at["forces"]})
        self.equations = Rows({"equations": self.at["R"][: p.free]})

    def groups(self, count: int, size: int) -> np.ndarray:
        """Zeros (groups, size, group size) for so many columns, side by side in groups."""
        return aligned_zeros(-(-count // self._group_size), size, self._group_size)

    def vector(self, changes: Arrays, numbers: Mapping[str, Numbers], count: int) -> np.ndarray:
        """Changes (count, ...) of some numbers in `groups`, and zeros."""
        x, size = self.groups(count, self.size), self._group_size
        for name in changes.keys() & numbers.keys():
            (places, entries, _), change = numbers[name], changes[name]
            if isinstance(change, LinearChanges):
                for i, column in zip(*change.columns, strict=True):
                    x[i // size, places, i % size] = column[entries]
            elif any(change.strides):  # others are zeros (dual.py)
                put_columns(x, places, np.reshape(change, (count, -1)).T[entries])
        return x


class Rows:
    """Numbers of the vector in rows of a run, in parts by name: ``RowsOfRun`` of c/problem.h."""

    def __init__(self, parts: dict[str, np.ndarray]):
        self._places = np.concatenate([*parts.values()]).astype(np.int32)
        ends = itertools.accumulate([0, *map(len, parts.values())])
        slices = itertools.starmap(slice, itertools.pairwise(ends))
        self._part = dict(zip(parts, slices, strict=True))

    def only(self, entries: Mapping[str, Any] | None) -> Rows:
        """Rows of some entries of some parts, by name; these rows themselves for none."""
        chosen = (entries or {}).items()
        parts = {name: self._places[self._part[name]][entry] for name, entry in chosen}
        return Rows(parts) if parts else self

    def members(
        self, numbers: np.ndarray, count: int, rows: np.ndarray, row_of: np.ndarray | None = None
    ) -> dict[str, Any]:
        """Members for `rows` that belong to some numbers k of a `count`.

        In the order of the numbers, or the i-th to row `row_of[i]`: several may have one row.
        """
        row_numbers = np.full(count, -1, np.int32)
        row_numbers[numbers] = np.arange(len(numbers)) if row_of is None else row_of
        size = len(self._places)
        return {"at": row_numbers, "size": size, "place": self._places, "rows": never_empty(rows)}

    def filled(self, arrays: Arrays, count: int) -> np.ndarray:
        """Rows (count, size) of the given parts, with zeros in all others."""
        rows = np.zeros((count, len(self._places)))
        for name in arrays.keys() & self._part.keys():
            rows[:, self._part[name]] = np.reshape(arrays[name], (count, -1))
        return rows

    def empty(self, *lengths: int) -> np.ndarray:
        """Rows (*lengths, size) of zeros, to which C adds."""
        return np.zeros((*lengths, len(self._places)))

    def parts(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Parts of rows by name."""
        return {name: rows[..., part] for name, part in self._part.items()}


def put_columns(groups: np.ndarray, rows: Any, columns: np.ndarray) -> None:
    """Put columns (k, n) in these rows of all groups."""
    size = groups.shape[2]
    for group, first in zip(groups, range(0, columns.shape[1], size), strict=True):
        part = columns[:, first : first + size]
        group[rows, : part.shape[1]] = part


def never_empty(array: np.ndarray) -> np.ndarray:
    """An array with an address."""
    return array if array.size else np.zeros(1)


# -- Rates that fit the joints, and the impulses of joints and supports that make them fit ------
# The mid-point rule leaves in the rates a part that joints do not allow: v1 = 2 Du/dt - v0. It
# alternates from step to step, and hardly enters the motion, but forces of a step contain its
# change. The nearest rates in the norm of the mass are without it: v* = T w, with
#
#     T^T M (T w - v) = 0
#
# for the rates w of the unknowns. The joints exert the impulses M (v* - v). So their mean force
# over a step is that of the step, plus the increment of the impulses, divided by the length of
# the step. C finds them, and derivatives in both directions, as those of a sub-step that is
# linear (c/fitted_rates.h).


# Numbers of a scene on which T depends, besides the masses.
_OF_SHAPE = "gears", "offset", "axis", "paths"


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray
    #: Rates (n, driven) of driven motions that were given.
    driven: np.ndarray


def rate_fit(model: Model) -> FittedRates:
    """Finds rates that fit the joints and driven motions of a model."""
    if model.rate_fit is None:
        model.rate_fit = FittedRates(weakref.proxy(model))  # as the model has it
    return model.rate_fit


class FitPlaces(NamedTuple):
    """Places in the vector of a fit."""

    layout: StepVariables
    states: Rows
    results: Rows
    numbers: dict[str, Numbers]


def _places(problem: ProblemInC, layout: StepVariables) -> FitPlaces:
    rows, p, slides = layout.at, problem.c.tables, layout.slides
    states = {"q": rows["q"], "v": rows["v"], "slides": slides, "driven rates": rows["driven"]}
    slides1 = np.where(slides < rows["q"][0], slides - rows["Y"][0] + rows["Y1"][0], slides)
    results = {"rates": rows["q1"], "rates of slides": slides1}
    results["impulses of joints"] = rows["forces"]
    results["impulses of columns"] = rows["R"][p.free : p.columns]
    numbers = {name: all_of(rows[name]) for name in _OF_SHAPE}
    entries, count = problem.storage.mass_entries.ravel(), problem.model.masses.matrix.nnz
    numbers["mass"] = Numbers(rows["mass"], entries, count)
    numbers = {name: part for name, part in numbers.items() if part.size}
    return FitPlaces(layout, Rows(states), Rows(results), numbers)


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions of a model."""

    def __init__(self, model: Model):
        self._model = model
        self._problem = problem = problem_of(model, ProblemKind(rates=True))
        self._ffi, self._p = problem.ffi, problem.c
        self._structs = Structs(self._ffi)
        self._a = self._ffi.new("Derivatives *")
        self._structs.set(self._a, slide_at_rest=np.zeros(1 + len(model.couplings.arm_joints)))
        #: The library, with names of what is asked of it: VALUES, BACKWARDS and FORWARDS.
        self.library = library = problem.derivatives("FIT")
        room = aligned_zeros(library.fx_linear_scratch(self._p, self._a))
        self._structs.set(self._a, scratch=room)
        # Where everything is follows from the structure alone.
        places: FitPlaces | None = model.facts.get(FitPlaces)
        if places is None:
            layout = StepVariables(problem, library.fx_layout(self._p, self._a))
            places = model.facts[FitPlaces] = _places(problem, layout)
        #: Where the numbers of a fit are in its vector, rows of states and of results in it, and
        #: the numbers of the scene by name.
        self.layout, self.states, self.results, self.numbers = places

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        return self.fit_with_derivatives(self.library.VALUES, q, v, slides, driven)

    def fit_with_derivatives(self, way: int, *states: np.ndarray, **derivatives: object) -> Fit:
        """As `fit`, and derivatives in one `way`, by members of ``Derivatives`` in C."""
        model, n, p = self._model, len(states[0]), self._p.tables
        if self._problem.numbers.data is not model.data:
            self._problem.restart()
        q, v, slides, driven = (np.ascontiguousarray(x, dtype=float) for x in states)
        shapes = (q.shape, (n, 0), (n, p.passes.joints, 3), (n, p.columns - p.free))
        # What is not a number stays so where it is singular.
        fit = Fit(*(*(np.full(shape, np.nan) for shape in shapes), driven))
        if (unknown := np.isnan(driven)).any():
            driven = np.where(unknown, self._driven_rates(q, v, slides), driven)
        structs, fits = Structs(self._ffi), self._ffi.new("Fits *")
        arrays = {"q": q, "v": v, "slides": slides, "driven": driven, "rates": fit.rates}
        arrays |= {"joints": fit.joints, "constraints": fit.constraints}
        structs.set(fits, rows=n, **{name: never_empty(x) for name, x in arrays.items()})
        with model.lock:
            structs.set(self._a, **derivatives)
            if not self.library.fx_fit(self._p, fits, self._a, way):
                raise MemoryError("rates that fit the joints")
        return fit._replace(corrections=fit.rates - v)

    def _driven_rates(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Rates (n, driven) of driven motions as the nodes have them."""
        model = self._model
        motion, rates = model.mesh.motion(model.scene, q=q, v=v), [*v[:, model.prescribed].T]
        for joint, name in model.data.motors:
            kinematics, slide = joint.kinematics, slides[:, joint.number]
            rates.append((kinematics.rate if name == "slide" else kinematics.spin)(motion, slide))
        return np.array(rates).T


class RateDerivatives:
    """Rates that fit at n configurations, and their derivatives; given as to `FittedRates.fit`."""

    def __init__(self, fits: FittedRates, *states: np.ndarray):
        self._fits, self._states = fits, states
        self.rates = fits.fit(*states).rates

    def _follow(self, way: int, states: np.ndarray, results: np.ndarray, **members: object) -> None:
        fits, rows = self._fits, np.arange(len(self.rates))
        members["states"] = fits.states.members(rows, len(rows), states)
        members["forces"] = fits.results.members(rows, len(rows), results)
        fits.fit_with_derivatives(way, *self._states, **members)

    def vjp(self, weights: Arrays) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Derivatives by "q", "v", "slides" and "driven rates" (n, ...), and by numbers.

        From those by "rates" that fit (n, size), "rates of slides" (n, joints), "impulses of
        joints" (n, joints, 3) and "impulses of columns" (n, columns).
        """
        fits, n, x = self._fits, len(self.rates), aligned_zeros(self._fits.layout.size)
        rows = fits.states.empty(n)
        self._follow(fits.library.BACKWARDS, rows, fits.results.filled(weights, n), x=x)
        return fits.states.parts(rows), {name: p.sums(x) for name, p in fits.numbers.items()}

    def jvp(self, state_changes: Arrays, changes: Arrays) -> dict[str, np.ndarray]:
        """Changes (n, m, ...) of the same in m directions.

        From those of the state, "q", "v", "slides" and "driven rates" (n, m, ...), and of numbers
        (m, ...).
        """
        fits, (n, m, _) = self._fits, state_changes["q"].shape
        x, result_changes = fits.layout.vector(changes, fits.numbers, m), fits.results.empty(n, m)
        flat = {name: values.reshape(n * m, -1) for name, values in state_changes.items()}
        states = fits.states.filled(flat, n * m)
        self._follow(fits.library.FORWARDS, states, result_changes, x=x, directions=m)
        return fits.results.parts(result_changes)
