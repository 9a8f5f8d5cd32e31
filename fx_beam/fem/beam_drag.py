"""Drag on the beams of a scene: force, tangent and loss, as forms with the full Gauss rule."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import ufl

import numpy as np

from fx_beam.laws.resultants import drag_loss, drag_work
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene

from . import elements, ffcx_api
from .assembly import BoundForm, Field
from .ffcx_api import CompiledForm
from .fields import Data, DataShape, Fields, FilledField, cell_data
from .mesh import Mesh
from .vjp_form import WorkOnWeights, compiled_derivatives, derivatives_of


class DragForms:
    """The compiled forms of the drag on beams, on no particular mesh, and their data on one.

    With mid-point rates a drag of the spin needs the rotations at the nodes of elements.
    """

    def __init__(
        self, scene: Scene, drags: Sequence[Drag], mesh: Mesh, scheme: Scheme, fields: Fields
    ):
        data = coefficients(scene, drags, mesh)
        if "rotation" in data and scheme.rates.by_mean:
            fields = fields.with_nodal_rotations
        self.fields = fields
        compiling: Any = _compiled if scheme.built_in else _compiled.__wrapped__
        shapes = tuple((name, part.shape) for name, part in data.items())
        #: Forms of force, tangent and loss.
        self.compiled, at = compiling(fields, scheme.rates, shapes)
        #: Coefficients by name, and by their symbols in UFL.
        self.coefficients = {name: FilledField(part, mesh) for name, part in data.items()}
        self.data = {at[name]: part.on_mesh for name, part in self.coefficients.items()}


class VjpDrag:
    """The work of the drag on weights, and its derivatives, on no particular mesh.

    The fields are those of the drag; its coefficients, by name, vary cell by cell.
    """

    def __init__(self, fields: Fields, rates: Any, shapes: Mapping[str, DataShape]):
        self.fields = fields
        #: Symbols of the coefficients, and of the weights in the place of the test function.
        self.symbols = {name: fields.data(shape) for name, shape in shapes.items()}
        self.weight = elements.Coefficient(fields.test.ufl_function_space())
        work = drag_work(fields.step(rates, "rates of the drag"), self.symbols)
        work = ufl.replace(work * fields.measure(fields.full_rule), {fields.test: self.weight})
        derivatives = derivatives_of(work, fields, self.symbols)
        self.work = WorkOnWeights("work of drag", work, derivatives, [self.weight])


class LossToDrag:
    """What the drag takes in a step, and its derivatives; as `VjpDrag`."""

    def __init__(self, fields: Fields, rates: Any, shapes: Mapping[str, DataShape]):
        self.fields = fields
        self.symbols = {name: fields.data(shape) for name, shape in shapes.items()}
        lost = drag_loss(fields.step(rates, "rates of the drag"), self.symbols)
        lost *= fields.measure(fields.full_rule)
        by = {f"drag {name}": symbol for name, symbol in self.symbols.items()}
        self.forms = compiled_derivatives("loss to drag", lost, fields, by)


class BeamDrag:
    """The drag of a scene's beams in a step, by its forms on the mesh."""

    def __init__(self, increment: Field, force: BoundForm, tangent: BoundForm):
        #: The increment in these forms, another one than that of the internal forces.
        self.increment = increment
        self._force, self._tangent = force, tangent

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the resisting forces (size,) for the increment D."""
        self.increment.array[:] = D
        self._force.add_to(out)

    def add_tangent(self, values: np.ndarray, at: np.ndarray) -> None:
        """Add their derivative by the last D to values of a matrix at places of cells."""
        self._tangent.add_to(values, at)


def coefficients(scene: Scene, drags: Sequence[Drag], mesh: Mesh) -> dict[str, Data]:
    """Coefficients of `drag_work` on all beams, those that there are."""
    rows: dict[str, np.ndarray] = {}
    for drag in drags:
        assert isinstance(drag.target, Beam)
        for name in ("linear", "quadratic", "rotation"):
            value = getattr(drag, name)
            if value.any():
                key = name if len(value) == 1 else f"{name} along and across"
                of_beams = rows.setdefault(key, np.zeros((len(scene.beams), len(value))))
                of_beams[scene.beams.index(drag.target)] += value
    return {
        name: cell_data(mesh, row if "across" in name else row[:, 0]) for name, row in rows.items()
    }


@functools.cache
def _compiled(
    fields: Fields, rates: Any, shapes: tuple[tuple[str, DataShape], ...]
) -> tuple[list[CompiledForm], dict[str, Any]]:
    """Forms of force, tangent and loss, and their symbols of the coefficients."""
    at = {name: fields.data(shape) for name, shape in shapes}
    step, dx = fields.step(rates, "rates of the drag"), fields.measure(fields.full_rule)
    force, loss = drag_work(step, at) * dx, drag_loss(step, at) * dx
    tangent = ufl.derivative(force, fields.increment, fields.trial)
    forms = {"drag": force, "tangent of drag": tangent, "loss to drag": loss}
    return ffcx_api.compile_together(forms), at
