"""Energies as outputs: their derivatives by states and by numbers of the scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from fx_beam.step.model import Model

from .gradient import Gradient, along
from .natural_gradients import NaturalRows

#: States of one row by name, and the values of the parameters there.
Row = Mapping[str, np.ndarray]
#: Derivatives by states, and by numbers of the scene, by name.
Derivatives = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]


def _kinetic(model: Model, row: Row) -> Derivatives:
    """v.M v / 2."""
    if model.scheme.rates.at_rest:
        return {}, {}
    mass, v = model.mass.tocoo(), row["v"]
    return {"v": model.mass @ v}, {"mass": v[mass.row] * v[mass.col] / 2}


def _of_fit(model: Model, row: Row) -> Derivatives:
    """v*.M (v* - v), the work of driven motions on the impulses with which rates v* fit."""
    if "rates" not in row or not model.couplings.driven:
        return {}, {}
    mass, v, rates = model.mass.tocoo(), row["v"], row["rates"]
    fitting = model.mass @ rates
    by_mass = rates[mass.row] * (rates - v)[mass.col]
    return {"v": -fitting, "rates": 2 * fitting - model.mass @ v}, {"mass": by_mass}


def _strain(model: Model, row: Row) -> Derivatives:
    if model.forms.beams is None:
        return {}, {}
    model.forms.parameters.use(row.get("parameters"))
    given = row["internal"]
    internal = given.reshape(model.forms.internal_shape) if given.size else None
    found = model.forms.beams.stored_energy_by(row["q"], internal, row.get("natural"))
    return {name: found.pop(name) for name in ("q", "internal") if name in found}, found


def _potential(model: Model, row: Row) -> Derivatives:
    return ({}, {}) if model.weight is None else ({"q": -model.weight}, {"weight": -row["q"]})


def _springs(model: Model, row: Row) -> Derivatives:
    if not model.points.any:
        return {}, {}
    model.forms.parameters.use(row.get("parameters"))
    found = model.points.energy_by(row["q"], row["slides"], row["spring internal"])
    by_state = {"q": found["q"], "slides": found["slides"], "spring internal": found["internal"]}
    by_numbers = {"points": found["numbers"], "parameters": found["parameters"]}
    return by_state, by_numbers | {name: found[name] for name in ("members", "X") if name in found}


_PARTS: dict[str, list[Callable[[Model, Row], Derivatives]]] = {
    "kinetic_energy": [_kinetic, _of_fit],
    "strain_energy": [_strain],
    "potential_energy": [_potential],
    "spring_energy": [_springs],
    "total_energy": [_kinetic, _of_fit, _strain, _potential, _springs],
    # That of the steps themselves, and what driven motions do besides.
    "energy of steps": [_kinetic, _strain, _potential, _springs],
    "work of rates that fit": [_of_fit],
}


class EnergyOutput:
    """An energy of the scene at the rows (n,) of a run.

    `states` has what `State` has, and "rates" that fit, at the rows; `at_parameters` (n,) the
    places of the parameters of the rows among the numbers "parameters", with their values;
    `natural` the natural strains, with the numbers (n,) of the sub-steps before which they are.
    """

    def __init__(
        self,
        model: Model,
        quantity: str,
        states: Mapping[str, np.ndarray],
        ends: np.ndarray,
        parameters: tuple[np.ndarray, np.ndarray] | None,
        natural: tuple[NaturalRows, np.ndarray] | None,
    ):
        self._model, self._states, self._ends, self._parameters = model, states, ends, parameters
        self._natural = natural
        self._parts = _PARTS[quantity]

    def _derivatives(self, k: int) -> tuple[int, Derivatives]:
        """The place of a row among the states, and the derivatives there."""
        at = int(self._ends[k])
        row = {name: values[at] for name, values in self._states.items()}
        if self._parameters is not None:
            row["parameters"] = self._parameters[1][k]
        if self._natural is not None:
            strains, boundaries = self._natural
            row["natural"] = strains.at(int(boundaries[k]))
        by_state: dict[str, np.ndarray] = {}
        by_numbers: dict[str, np.ndarray] = {}
        for part in self._parts:
            for found, more in zip((by_state, by_numbers), part(self._model, row), strict=True):
                for name, values in more.items():
                    found[name] = found.get(name, 0.0) + values
        return at, (by_state, by_numbers)

    def pull(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the energy."""
        for k in np.flatnonzero(weights).tolist():
            at, (by_state, by_numbers) = self._derivatives(k)
            for name, values in by_state.items():
                if values.size:
                    to.at(name)[at] += weights[k] * values.ravel()
            for i, value in enumerate(by_numbers.pop("parameters", ())):
                to.add_number(*self._parameter(k, i), weights[k] * value)
            by_natural = by_numbers.pop("natural", None)
            if by_natural is not None and self._natural is not None:
                strains, boundaries = self._natural
                strains.pull(int(boundaries[k]), weights[k] * by_natural, to)
            for name, values in by_numbers.items():
                to.add_numbers(name, weights[k] * values)

    def push(
        self, rows: int, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (rows, m) from those of the states and of the numbers of the scene."""
        found = np.zeros((rows, len(changes["X"])))
        for k in range(rows):
            at, (by_state, by_numbers) = self._derivatives(k)
            for name, values in by_state.items():
                if values.size:
                    found[k] += of_state[name][at] @ values.ravel()
            for i, value in enumerate(by_numbers.pop("parameters", ())):
                name, index = self._parameter(k, i)
                found[k] += value * changes[name].reshape(len(found[k]), -1)[:, index]
            by_natural = by_numbers.pop("natural", None)
            if by_natural is not None and self._natural is not None:
                strains, boundaries = self._natural
                for j in range(len(found[k])):
                    change = strains.push(int(boundaries[k]), changes, j)
                    found[k, j] += (by_natural * change).sum()
            for name, values in by_numbers.items():
                found[k] += along(changes[name], values)
        return found

    def _parameter(self, k: int, i: int) -> tuple[str, int]:
        """Name and index of a parameter of a row among the numbers."""
        assert self._parameters is not None
        first = int(self._parameters[0][k])
        return ("parameters", first + i) if first >= 0 else ("parameters at the start", i)
