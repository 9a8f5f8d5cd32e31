"""Drag on the beams of a scene: force, tangent and loss, as forms with the full Gauss rule."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import ufl

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.laws.resultants import drag_loss, drag_work
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene

from . import elements, ffcx_api
from .ffcx_api import CompiledForm
from .fields import Data, DataShape, Fields, cell_data
from .mesh import Mesh
from .vjp_form import WorkOnWeights, compiled_derivatives, derivatives_of


class DragForm:
    """The drag on beams in a step, on no particular mesh, with coefficients of some shapes.

    With mid-point rates a drag of the spin needs the rotations at the nodes of elements.
    """

    def __init__(self, fields: Fields, rates: Any, shapes: tuple[tuple[str, DataShape], ...]):
        if rates.by_mean and "rotation" in dict(shapes):
            fields = fields.with_nodal_rotations
        self.fields = fields
        #: Symbols of the coefficients by name.
        self.symbols = {name: fields.data(shape) for name, shape in shapes}
        step, dx = fields.step(rates, "rates of the drag"), fields.measure(fields.full_rule)
        self._force, self._loss = (of(step, self.symbols) * dx for of in (drag_work, drag_loss))

    @cached_property
    def compiled(self) -> list[CompiledForm]:
        """Forms of force, tangent and loss."""
        tangent = ufl.derivative(self._force, self.fields.increment, self.fields.trial)
        forms = {"drag": self._force, "tangent of drag": tangent, "loss to drag": self._loss}
        return ffcx_api.compile_together(forms)

    @cached_property
    def work(self) -> WorkOnWeights:
        """Its work on weights in the place of the test function, and derivatives."""
        test = self.fields.test
        weight = elements.Coefficient(test.ufl_function_space())
        work = ufl.replace(self._force, {test: weight})
        derivatives = derivatives_of(work, self.fields, self.symbols)
        return WorkOnWeights("work of drag", work, derivatives, [weight])

    @cached_property
    def loss_by(self) -> dict[str, CompiledForm]:
        """Derivatives of the loss by name."""
        by = {f"drag {name}": symbol for name, symbol in self.symbols.items()}
        return compiled_derivatives("loss to drag", self._loss, self.fields, by)


_cached = functools.cache(DragForm)


def drag_form(
    scheme: Scheme, fields: Fields, shapes: tuple[tuple[str, DataShape], ...]
) -> DragForm:
    """The drag in the steps of a scheme, kept if its rates are those of this package."""
    return (_cached if scheme.built_in else DragForm)(fields, scheme.rates, shapes)


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
