"""Where linear outputs of nodes and joints are in the states and forces of a model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fx_beam.scene.outputs import Output, definition

from .model import Model


class Measured(NamedTuple):
    """An output as entries of an array: a number, or one for each component."""

    #: Name of the array in `State`.
    array: str
    #: Entries that count, and those that are subtracted; None for none.
    plus: Any
    minus: Any = None
    #: What is added to them: parts of positions; None for nothing.
    added: Any = None
    #: Components that the array does not have, which are zero; None for none.
    missing: np.ndarray | None = None

    def of(self, values: np.ndarray) -> Any:
        """Values (..., components) or (...) from arrays (..., size)."""
        if self.plus is None:
            return -values[..., self.minus]
        if not values.shape[-1]:  # a scene without supports has no reactions
            return np.zeros(values.shape[:-1] + np.shape(self.plus))
        components = values[..., self.plus]
        if self.minus is not None:
            components = components - values[..., self.minus]
        if self.missing is not None:
            components[..., self.missing] = 0.0
        return components if self.added is None else self.added + components

    def terms(self) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        """Of all that counts: components, their entries, and the sign."""
        for entries, sign in ((self.plus, 1.0), (self.minus, -1.0)):
            if entries is not None:
                parts = np.arange(np.size(entries))
                if self.missing is not None:
                    parts = parts[~np.atleast_1d(self.missing)]
                yield parts, np.atleast_1d(entries)[parts], sign


def measured(model: Model, output: Output) -> Measured:
    """Where an output is that has no law."""
    of = definition(output)
    quantity, columns, number = of.quantity, of.columns, of.number
    if quantity.of in ("q", "v", "a"):
        ends = {sign: model.mesh.dofs[node.number][columns] for sign, node in of.ends()}
        added = model.mesh.X[number][columns] if quantity.is_place else None
        return Measured(quantity.of, ends.get(1), ends.get(-1), added)
    if quantity.of == "reactions":
        nodes, components, column = model.supports
        of_node, entries = nodes == number, np.full(3, -1)
        entries[components[of_node]] = column[of_node]
        entries = entries[columns]
        return Measured("constraint_forces", entries, missing=entries < 0)
    if quantity.of == "joint_forces":
        return Measured("joint_forces", 3 * number + columns)
    if quantity.of == "motor_forces":
        motors = [joint.number for joint, _ in model.motors]
        return Measured("constraint_forces", len(model.prescribed) + motors.index(number))
    return Measured(quantity.of, number)
