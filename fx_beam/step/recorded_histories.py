"""The histories of a record by their names in a solution, each made when it is first read."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from fx_beam.results.audit import Energy
from fx_beam.results.state import HISTORIES, ROWS

from .model import Model

# What a solution has besides.
_OTHERS = "energy", "internal", "spring_internal", "natural"
# Rows that depend on fitted rates.
_FITTED = {"v", "a", "joint_forces", "constraint_forces"}
# Energies of a row, in their order.
_ENERGIES = [field.name for field in fields(Energy) if field.name != "impact"]


class RecordedHistories(Mapping):
    """Histories of n rows; empty if not recorded.

    `rows` are the recorded ones; `fitted` gives them with rates that fit the joints, and is None
    where those of steps do. `late_accelerations` gives those of row 0, if they are not recorded.
    `turns` are the full turns that are missing in rows from a number on.
    """

    def __init__(
        self,
        model: Model,
        rows: Mapping[str, np.ndarray],
        fitted: Callable[[], Mapping[str, np.ndarray]] | None,
        turns: Mapping[int, np.ndarray],
        t: np.ndarray,
        t_level: Callable[[], np.ndarray],
        impact: float,
        late_accelerations: Callable[[], np.ndarray] | None = None,
    ):
        self._model, self._rows, self._turns = model, rows, turns
        self._fitted_rows, self._t_level, self._impact = fitted, t_level, impact
        self._known: dict[str, Any] = {"t": t}
        self._late_accelerations = late_accelerations

    def __getitem__(self, name: str) -> Any:
        with self._model.reading:
            if name not in self._known:
                self._known[name] = self._made(name)
            return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*HISTORIES, *_OTHERS]))

    def __len__(self) -> int:
        return len([*self])

    def of_node(self, name: str, number: int) -> np.ndarray | None:
        """Rows (n, 3) of a node; None if they are not recorded, or known already."""
        rows = self._recorded(name)
        if rows is None or self._turns or name in self._known:
            return None
        return rows[:, self._model.mesh.dofs[number]]

    def fitted_at(self, t: float) -> np.ndarray | None:
        """Rates (size,) that fit the joints at a time [s] if it is the last, and steps' do not."""
        if self._fitted_rows is None or self["t"][-1] != t:
            return None
        return self._fitted["v"][-1]

    def small_rows(self, first: int) -> dict[str, np.ndarray]:
        """Rows from one on of what does not grow with the number of nodes."""
        return {
            name: rows[first:].copy()
            for name, rows in self._fitted.items()
            if name in ROWS and ROWS[name].record not in ("motion", "rates")
        }

    @functools.cached_property
    def _fitted(self) -> Mapping[str, np.ndarray]:
        return self._rows if self._fitted_rows is None else self._fitted_rows()

    def _recorded(self, name: str) -> np.ndarray | None:
        if name not in self._rows:
            return None
        if name == "a" and self._late_accelerations is not None:
            self._rows["a"][0] = self._late_accelerations()
            self._late_accelerations = None
        return (self._fitted if name in _FITTED else self._rows)[name]

    def _made(self, name: str) -> Any:
        if name == "t_level":
            return self._t_level()
        if name == "energy":
            energies = self._fitted["energies"]
            parts = dict(zip(_ENERGIES, energies.T, strict=True))
            return Energy(**parts, impact=np.full(len(energies), self._impact))
        if name in ("linear_momentum", "angular_momentum"):
            return self._fitted["momenta"][:, 2 if name == "angular_momentum" else slice(2)]
        if name in ("reactions", "motor_forces"):
            return self._by_supports[name == "motor_forces"]
        model, quantity = self._model, ROWS[name]
        at_nodes = quantity.shape == ("dofs",)
        lengths = model.mesh.dofs.shape if at_nodes else quantity.lengths(model.sizes)
        rows = self._recorded(name)
        if rows is None:
            values = np.empty((0, *lengths))
        elif at_nodes:
            values = rows[:, model.mesh.dofs]
        else:
            values = rows.reshape(len(rows), *lengths)
        if name == "q" and self._turns and len(values):
            for first, stop in itertools.pairwise([*self._turns, len(values)]):
                values[first:stop] += self._turns[first][model.mesh.dofs]
        if name == "slides" and model.removed_joints:
            values = values.copy()
            values[:, model.removed_joints] = np.nan
        if name in _OTHERS and not values.size:
            return None
        return values

    @functools.cached_property
    def _by_supports(self) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the supports on nodes, and those of motors, from rows of all of them."""
        model, forces = self._model, self._recorded("constraint_forces")
        if forces is None:
            forces = np.empty((0, *ROWS["constraint_forces"].lengths(model.sizes)))
        reactions = np.zeros((len(forces), len(model.mesh.X), 3))
        supported, components, columns = model.supports
        reactions[:, supported, components] = forces[:, columns]
        motors = np.zeros((len(forces), model.sizes["joints"]))
        first, numbers = len(model.prescribed), [joint.number for joint, _ in model.motors]
        motors[:, numbers] = forces[:, first : first + len(numbers)]
        return reactions, motors
