"""Derivatives of the stress resultants of a step by all that they depend on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import ufl

import numpy as np

from . import dolfinx_api
from .mesh import Mesh
from .pulled_form import NODAL, assembled, work_and_derivatives
from .weak_form import WeakForm


class ResultantForm(WeakForm):
    """Sums of weights times resultants at the Gauss points, and their derivatives."""

    def __init__(self, parameters: Any, *arguments: Any):
        #: UFL's constant of the values of parameters; None without any.
        self._values = parameters
        super().__init__(*arguments)

    def _compile(self) -> None:
        fields, space = self.fields, self.fields.internal(3)
        #: Weights, each over the weight of its point.
        self.weight = dolfinx_api.Coefficient(space)
        #: Zero, added to the parameters of each element.
        self.more: Any = None
        if self.parameters is not None:
            self.more = fields.data((1, self.parameters.ufl_shape))
        sums = self._sum(self.weight)
        data = {"stiffness": self.stiffness, "times": self.times, "parameters": self.more}
        by = {name: symbol for name, symbol in data.items() if symbol is not None}
        if fields.before in sums.coefficients():
            by["before"] = fields.before
        if self.width:
            by["internal"] = self.internal
        if self.has_natural:
            by |= dict(zip(("natural", "natural_end"), fields.natural, strict=True))
        #: As `PulledForm.forms`.
        self.forms = work_and_derivatives("resultants", sums, fields, by)
        X, of_X = fields.coordinates
        by |= {"increment": fields.increment, "start": fields.start}
        changing = {name: by[name] for name in by if name in self.forms}
        #: Symbols of the changes by name.
        self.changes = {
            name: dolfinx_api.Coefficient(field.ufl_function_space())
            for name, field in changing.items()
        }
        at_points = self._sum(ufl.TestFunction(space))
        change: Any = 0
        for name, field in changing.items():
            change += ufl.derivative(at_points, field, self.changes[name])
        if "coordinates" in self.forms:
            self.changes["coordinates"] = dolfinx_api.Coefficient(of_X)
            change += ufl.derivative(at_points, X, self.changes["coordinates"])
        #: Changes of the resultants at the Gauss points, times the weights of these.
        self.change = dolfinx_api.compile_form(change, "changes of resultants")

    def _sum(self, weight: Any) -> Any:
        dx, form = self.fields.measure(self.fields.degree), 0
        for tag, resultants in enumerate(self.resultants):
            dx_law = dx(tag) if len(self.resultants) > 1 else dx
            form += ufl.dot(weight, resultants) / self.step.h * dx_law
        if self.more is None:
            return form
        return ufl.replace(form, {self.parameters: self._values + self.more})


class Bound(NamedTuple):
    """A `ResultantForm` on a mesh: forms, and functions in the place of its symbols, by name."""

    forms: Mapping[str, Any]
    change: Any
    changes: Mapping[str, Any]
    weight: Any
    #: Spaces of the derivatives.
    spaces: Mapping[str, Any]


class ResultantDerivatives:
    """Derivatives in a step, which `begin` begins."""

    def __init__(self, bound: Bound, mesh: Mesh, degree: int, begin: Callable[[Any], None]):
        self._bound, self._mesh, self._begin = bound, mesh, begin
        #: Weights (points, 1) of the Gauss points, relative to the element's length.
        self._point_weights = np.polynomial.legendre.leggauss(degree)[1][:, None] / 2

    def pull(self, part: Any, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the sum of weights (cells, points, 3) times N, Q and M, by name.

        By "increment", "start" and "before" (size of beams,), "internal" variables, the data of
        sections, strains "natural" at the start and "natural_end", "parameters", and "X".
        """
        self._begin(part)
        bound = self._bound
        dolfinx_api.set_at_gauss_points(bound.weight, weights / self._point_weights)
        return assembled(bound.forms, bound.spaces, self._mesh)

    def push(self, part: Any, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """Changes (cells, points, 3) of N, Q and M from those by these names."""
        self._begin(part)
        for name, field in self._bound.changes.items():
            array, dofs = field.x.array, dolfinx_api.element_dofs(field.function_space)
            if name in NODAL:
                array[: self._mesh.in_beams] = changes[name][: self._mesh.in_beams]
            elif name == "coordinates":
                points = dolfinx_api.element_points(self._mesh.mesh)
                array.reshape(-1, 2)[dofs] = changes["X"][points]
            else:
                own = changes[name]
                own = own if name == "parameters" else own.reshape(*dofs.shape, -1)
                array.reshape(dofs.max() + 1, -1)[dofs] = own
        weight = self._bound.weight.function_space
        values, dofs = dolfinx_api.function(weight).x.array, dolfinx_api.element_dofs(weight)
        dolfinx_api.assemble_vector(values, self._bound.change)
        return values.reshape(-1, 3)[dofs] / self._point_weights


def bound(
    weak: ResultantForm,
    forms: Mapping[str, Any],
    spaces: Mapping[str, Any],
    bind: Callable[[Any, Any, dict[Any, Any]], Any],
    weight: Any,
) -> Bound:
    """A form on a mesh, where its derivatives are bound to spaces; `bind` binds its change."""
    changes = {name: dolfinx_api.function(spaces[name]) for name in weak.changes}
    data = {symbol: changes[name] for name, symbol in weak.changes.items()}
    change = bind(weak.change, weight.function_space, data)
    return Bound(forms, change, changes, weight, spaces)
