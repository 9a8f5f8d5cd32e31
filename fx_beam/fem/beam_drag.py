"""Drag on the beams of a scene: force, tangent and loss, as forms with the full Gauss rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fx_beam.laws.resultants import drag_loss, drag_work
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene
from fx_beam.symbolic import Written, ufl

from . import elements
from .fields import Data, DataShape, cell_data, fields_of
from .mesh import Mesh
from .vjp_form import WorkOnWeights, derivatives_of


class DragKind(NamedTuple):
    """What forms of the drag depend on, on no particular mesh: also the shapes of coefficients."""

    degree: int
    curved: bool
    scheme: Scheme
    shapes: tuple[tuple[str, DataShape], ...]

    @property
    def key(self) -> tuple | None:
        """An identifier if the rates are those of this package, else None."""
        return (*self[:2], self.scheme.key, self.shapes) if self.scheme.built_in else None


class DragForm:
    """The drag on beams in a step, in UFL.

    With mid-point rates a drag of the spin needs the rotations at the nodes of elements.
    """

    def __init__(self, kind: DragKind):
        fields, rates = fields_of(kind.degree, kind.curved), kind.scheme.rates
        if rates.by_mean and "rotation" in dict(kind.shapes):
            fields = fields.with_nodal_rotations
        self._fields = fields
        self._symbols = {name: fields.data(shape) for name, shape in kind.shapes}
        self._names = {**fields.names, **{of: name for name, of in self._symbols.items()}}
        step, dx = fields.step(rates, "rates of the drag"), fields.measure(fields.full_rule)
        self._force, self._loss = (of(step, self._symbols) * dx for of in (drag_work, drag_loss))

    def of_step(self) -> Written:
        """Forms of force, tangent and loss."""
        tangent = ufl.derivative(self._force, self._fields.increment, self._fields.trial)
        forms = {"drag": self._force, "tangent of drag": tangent, "loss to drag": self._loss}
        return Written(forms, self._names)

    def vjp(self) -> WorkOnWeights:
        """Its work on weights in the place of the test function, and derivatives."""
        test = self._fields.test
        weight = elements.coefficient(test.ufl_function_space())
        work = ufl.replace(self._force, {test: weight})
        derivatives = derivatives_of(work, self._fields, self._symbols)
        return WorkOnWeights(work, derivatives, [weight], self._names)

    def derivatives(self) -> Written:
        """Derivatives of the loss by name."""
        by = {f"drag {name}": symbol for name, symbol in self._symbols.items()}
        return Written(derivatives_of(self._loss, self._fields, by), self._names)


def vjp_of_drag(kind: DragKind) -> WorkOnWeights:
    """The work of the drag on weights."""
    return DragForm(kind).vjp()


def coefficients(scene: Scene, drags: Sequence[Drag], mesh: Mesh) -> dict[str, Data]:
    """Coefficients of `drag_work` on all beams, those that there are."""
    rows: dict[str, np.ndarray] = {}
    on_beams = ((drag, drag.target) for drag in drags if isinstance(drag.target, Beam))
    for drag, beam in on_beams:
        for name in ("linear", "quadratic", "rotation"):
            value = getattr(drag, name)
            if value.any():
                key = name if len(value) == 1 else f"{name} along and across"
                of_beams = rows.setdefault(key, np.zeros((len(scene.beams), len(value))))
                of_beams[scene.beams.index(beam)] += value
    return {
        name: cell_data(mesh, row if "across" in name else row[:, 0]) for name, row in rows.items()
    }
