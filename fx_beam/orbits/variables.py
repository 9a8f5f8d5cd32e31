"""Variables of a state in periodic motions: positions, rates and what steps remember."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.sparse.linalg

from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.step.layout import Arrays
from fx_beam.step.model import Model, fact, massless_dofs
from fx_beam.step.state_values import energy_of

_Value = TypeVar("_Value", float, np.ndarray)
# Change of variables in differences of the energy.
_STEP = 1e-6


class Directions(NamedTuple):
    """Changes of a state, one for each of its variables, in units of their scales."""

    #: Changes (n, ...) of what steps read, by name.
    changes: dict[str, np.ndarray]
    #: Changes (rows, n) in the order of `Variables.rows_of`, over the scales.
    matrix: np.ndarray
    #: Numbers (n,) of the rows that are variables; others follow to close loops.
    independent: np.ndarray
    scale: np.ndarray


class Variables:
    """The variables of the states of a model; errors name the `caller`."""

    def __init__(self, model: Model, caller: str):
        self.model, self._what = model, caller
        fixed = [3 * node + i for node, i in model.scene.fixed]
        #: Rates that steps keep: of what has mass and moves.
        self._rates = np.setdiff1d(np.flatnonzero(~fact(model, massless_dofs)), fixed)

    @property
    def count(self) -> int:
        """Number of rows of a state."""
        return self.movable + sum(self.inside.values())

    @property
    def remembers(self) -> bool:
        """Whether steps depend on earlier ones: by the scheme, or by friction of joints."""
        return self.model.forms.keeps_previous or len(self.model.points.normal_forces) > 0

    @property
    def are_rates(self) -> np.ndarray:
        """Flags (rows,) of the rows of a state that are rates."""
        rows = np.arange(self.count)
        return (rows >= self.model.reduction.free) & (rows < self.movable)

    @property
    def movable(self) -> int:
        """Number of rows of positions and rates."""
        return self.model.reduction.free + len(self._rates)

    def rows_of(self, state: State) -> np.ndarray:
        """Positions, rates and what steps remember of a state, in one row."""
        remembered = {name: _remembered(state, name).ravel() for name in self.inside}
        return self.rows(vars(state) | remembered, remembered)

    def rows(self, arrays: Arrays, remembered: Iterable[str]) -> np.ndarray:
        """Rows (..., rows) from arrays by name, with some of what steps remember."""
        y = self.model.couplings.unknowns(arrays["q"], arrays["slides"])
        parts = [y, arrays["v"][..., self._rates], *(arrays[name] for name in remembered)]
        return np.concatenate(parts, axis=-1)

    def scales(self, state: State, period: float) -> np.ndarray:
        """Units of the rows: of the scene, and of rates in a period."""
        model = self.model
        rates = 2 * np.pi / period * model.units.nodes[self._rates]
        units = {name: np.ones(size) for name, size in self.inside.items()}
        if model.forms.keeps_previous:
            units["q previous"] = model.units.nodes
        if len(model.points.normal_forces):  # forces are large
            units["spring internal"] = np.maximum(1.0, abs(_remembered(state, "spring internal")))
        return np.concatenate([model.units.unknowns, rates, *units.values()])

    def directions(self, state: State, length: float) -> Directions:
        """Changes of all variables at a state, which keep joints and loops closed."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        if reduction.singularity:
            raise SceneError(f"{self._what}: {reduction.singularity}. Start from another state")
        free, scale = reduction.free, self.scales(state, length)
        independent = np.concatenate([reduction.independent, np.arange(free, len(scale))])
        y, n = len(reduction.independent), len(independent)
        matrix = np.zeros((len(scale), n))
        columns = reduction.maps.dependence_matrix().toarray()[:free, independent[:y]]
        columns = columns * scale[independent[:y]]
        matrix[:free, :y], matrix[independent[y:], np.arange(y, n)] = columns, scale[free:]
        rows = matrix.T
        changes = {"slides": model.couplings.free_slides(rows[:, :free], model.scene.joint_count)}
        changes["v"] = np.zeros((n, model.size))
        changes["v"][:, self._rates] = rows[:, free : self.movable]
        first = self.movable
        for name, size in self.inside.items():
            changes[name], first = rows[:, first : first + size], first + size
        spread = reduction.maps.coupling()[:, independent[:y]].toarray() * scale[independent[:y]]
        changes["q"] = np.vstack([spread.T, np.zeros((n - y, model.size))])
        return Directions(changes, matrix / scale[:, None], independent, scale)

    @property
    def inside(self) -> dict[str, int]:
        """Numbers of what steps remember, by their names in the layout.

        Internal variables of members and of springs, and the configuration a step before.
        """
        members, springs = int(np.prod(self.model.forms.internal_shape)), self.model.points.width
        previous = self.model.size * self.model.forms.keeps_previous
        sizes = {"internal": members, "spring internal": springs, "q previous": previous}
        return {name: size for name, size in sizes.items() if size}

    def closing(self, state: State, gaps: np.ndarray) -> dict[str, np.ndarray]:
        """Changes (m, ...) by name of the unknowns that close gaps (m, closures) of loops."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        assert (loops := reduction.loops) is not None
        y, following = np.zeros((len(gaps), reduction.free)), reduction.following
        G = reduction.maps.closure_derivatives()[:, reduction.joints.configuration.following]
        closing = -scipy.sparse.linalg.splu(G.tocsc()).solve((gaps * loops.lengths).T)
        y[:, following] = closing.T * loops.unit[following]
        q, (columns, dofs, _, _) = np.zeros((len(gaps), model.size)), model.couplings.free_columns
        q[:, dofs] = y[:, columns]
        return {"q": q, "slides": model.couplings.free_slides(y, model.scene.joint_count)}

    def moved(self, state: State, directions: Directions, amounts: np.ndarray) -> State:
        """The state after a change of its variables: amounts (n,) of the directions."""
        y = (directions.matrix @ amounts * directions.scale)[: self.model.reduction.free]
        changed = {"v": state.v + amounts @ directions.changes["v"]}
        for name in self.inside:
            values = _remembered(state, name)
            change = (amounts @ directions.changes[name]).reshape(values.shape)
            changed[name.replace(" ", "_")] = values + change
        return self.shifted(state, y).changed(**changed)

    def shifted(self, state: State, y: np.ndarray) -> State:
        """The state after a change of its unknowns (free,)."""
        model, reduction = self.model, self.model.reduction
        reduction.set_start(state.q, state.slides)
        q = state.q + reduction.increment(y, np.zeros(reduction.driven))
        slides = state.slides + model.couplings.free_slides(y, model.scene.joint_count)
        return state.changed(q=q, slides=slides)

    def energy(self, state: State) -> float:
        """Energy of scene and constant loads, zero in the reference configuration [J]."""
        energy, loads = energy_of(self.model, state), self.model.data.loads
        return energy - float(loads.sum_at(0.0) @ state.q) if loads.constant else energy

    def slope_of_energy(self, state: State, directions: Directions) -> np.ndarray:
        """Derivatives (n,) of the energy along directions, by differences."""

        def derivative(unit: np.ndarray) -> float:
            return slope(lambda x: self.energy(self.moved(state, directions, x * unit)), _STEP)

        return np.array([derivative(unit) for unit in np.eye(directions.matrix.shape[1])])


def slope(function: Callable[[float], _Value], h: float) -> _Value:
    """The derivative at zero, by a central difference."""
    low, high = function(-h), function(h)
    return (high - low) / (2 * h)


def _remembered(state: State, name: str) -> np.ndarray:
    """An array that steps remember, by its name in the layout; before a first step q is at rest."""
    values = getattr(state, name.replace(" ", "_"))
    return state.q if values is None else values
