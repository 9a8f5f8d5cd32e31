"""Energies as outputs: their derivatives by states and by numbers of the scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from fx_beam.step.model import Model

from .gradient import Block
from .sub_steps import OF_POINTS, SubSteps

#: A state by name, with the values of the parameters there and the natural strains.
Row = Mapping[str, np.ndarray]
#: Derivatives by these, and by numbers of the scene, by name.
Derivatives = dict[str, np.ndarray]


def _by_mass(model: Model, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Derivatives of x.M y by the entries of M."""
    return np.repeat(x, np.diff(model.mass.indptr)) * y[model.mass.indices]


def _kinetic(model: Model, row: Row) -> Derivatives:
    """v.M v / 2."""
    if model.scheme.rates.at_rest:
        return {}
    v = row["v"]
    return {"v": model.mass @ v, "mass": _by_mass(model, v, v) / 2}


def _of_fit(model: Model, row: Row) -> Derivatives:
    """v*.M (v* - v), the work of driven motions on the impulses with which rates v* fit."""
    if "rates" not in row or not model.couplings.driven:
        return {}
    v, rates = row["v"], row["rates"]
    fitting, by_mass = model.mass @ rates, _by_mass(model, rates, rates - v)
    return {"v": -fitting, "rates": 2 * fitting - model.mass @ v, "mass": by_mass}


def _strain(model: Model, row: Row) -> Derivatives:
    if model.forms.beams is None:
        return {}
    model.forms.parameters.use(row.get("parameters"))
    given = row["internal"]
    internal = given.reshape(model.forms.internal_shape) if given.size else None
    return model.forms.beams.stored_energy_by(row["q"], internal, row.get("natural"))


def _potential(model: Model, row: Row) -> Derivatives:
    return {} if model.weight is None else {"q": -model.weight, "weight": -row["q"]}


def _springs(model: Model, row: Row) -> Derivatives:
    if not model.points.any:
        return {}
    model.forms.parameters.use(row.get("parameters"))
    by = model.points.energy_by(row["q"], row["slides"], row["spring internal"])
    wanted = {"q", "slides", "internal", "numbers", "parameters", "members", "X"}
    return {OF_POINTS.get(name, name): by[name] for name in by if name in wanted}


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
    """An energy of the scene at the rows of a run, which are at `ends` (n,) among the states."""

    #: A row is a number.
    shape = ()

    def __init__(self, of: SubSteps, quantity: str, ends: np.ndarray):
        self._of, self._parts, self._ends = of, _PARTS[quantity], ends

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """Derivatives of some of the rows by states, and by numbers of the scene."""
        for k in rows.tolist():
            place = int(self._ends[k])
            state = self._of.row(place)
            for part in self._parts:
                yield from self._of.at_state(k, place, part(self._of.model, state))
