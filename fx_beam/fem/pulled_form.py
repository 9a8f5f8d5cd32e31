"""The work of a step's forces on given weights, and its derivatives: what steps backwards need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import ufl
from ufl.algorithms import expand_derivatives

import numpy as np

from . import dolfinx_api, ffcx_api
from .dolfinx_api import CompiledForm
from .fields import Fields
from .mesh import Mesh
from .weak_form import WeakForm

#: Names of the derivatives by nodal vectors.
NODAL = "increment", "start", "before"


class WorkOnWeights:
    """A work on weights in UFL and its derivatives, compiled, by name; on no particular mesh."""

    def __init__(self, forms: dict[str, CompiledForm], weights: list[Any]):
        self.forms, self.weights = forms, weights
        self._slopes: dict[tuple[str, ...], dict[tuple[str, int], CompiledForm]] = {}

    def slopes(self, names: Iterable[str]) -> dict[tuple[str, int], CompiledForm]:
        """Derivatives of those by these names by each of the weights, by its number."""
        key = tuple(names)
        if key not in self._slopes:
            self._slopes[key] = self._derived(key)
        return self._slopes[key]

    def _derived(self, names: tuple[str, ...]) -> dict[tuple[str, int], CompiledForm]:
        found = {}
        for name in names:
            for number, weight in enumerate(self.weights):
                slope = ufl.derivative(self.forms[name].form, weight)
                if not expand_derivatives(slope).empty():
                    found[name, number] = slope
        titles = {
            f"{self.forms['work'].name}, slope {name} {k}": found[name, k] for name, k in found
        }
        compiled = dolfinx_api.compile_together(titles, dolfinx_api.ONLY_IN_BATCHES)
        return dict(zip(found, compiled, strict=True))


class BoundPull(NamedTuple):
    """A work on a mesh: by name, the work and its derivatives as bound and compiled."""

    work: WorkOnWeights
    forms: dict[str, tuple[Any, CompiledForm]]
    #: Its fields that change, numbered as in problem.h.
    moving: list[Any]
    #: Binds a derivative by one of the names, of which that by a weight is taken.
    bind: Callable[[str, Any, CompiledForm], Any]

    def slopes(self, names: Iterable[str]) -> dict[tuple[str, int], tuple[Any, CompiledForm]]:
        """Those of the work, as bound and compiled."""
        return {
            (name, number): (self.bind(name, self.work.weights[number], form), form)
            for (name, number), form in self.work.slopes(names).items()
        }

    @property
    def tags(self) -> list[int]:
        """Subdomain of each integral; -1 for all cells."""
        return ffcx_api.integrals(self.forms["work"][1])


def bound_forms(
    compiled: Mapping[str, CompiledForm], mesh: Any, spaces: Mapping, data: Mapping, tags: Any
) -> dict[str, tuple[Any, CompiledForm]]:
    """A work and its derivatives by names, those by coefficients in the given spaces, on a mesh."""
    return {
        name: (dolfinx_api.bind(form, mesh, spaces.get(name), data, tags), form)
        for name, form in compiled.items()
    }


def bound_pull(
    work: WorkOnWeights, mesh: Any, spaces: Mapping, data: Mapping, tags: Any, moving: list[Any]
) -> BoundPull:
    """The same as a `BoundPull`."""

    def bind(name: str, weight: Any, form: CompiledForm) -> Any:
        both = [spaces[name], data[weight].function_space]
        return dolfinx_api.bind(form, mesh, both, data, tags)

    forms = bound_forms(work.forms, mesh, spaces, data, tags)
    return BoundPull(work, forms, moving, bind)


def work_and_derivatives(
    name: str, work: Any, fields: Fields, by: Mapping[str, Any], flags: Sequence[str] = ()
) -> dict[str, CompiledForm]:
    """A work and its derivatives by increment and start, by coefficients, and by coordinates.

    Without those that are zero; compiled with further flags.
    """
    by = {"increment": fields.increment, "start": fields.start, **by}
    forms = {what: ufl.derivative(work, field) for what, field in by.items()}
    X, of_X = fields.coordinates
    forms["coordinates"] = ufl.derivative(work, X, ufl.TestFunction(of_X))
    forms = {what: form for what, form in forms.items() if not expand_derivatives(form).empty()}
    forms = {"work": work, **forms}
    named = {f"{name} by {what}": form for what, form in forms.items()}
    compiled = dolfinx_api.compile_together(named, flags)
    return dict(zip(forms, compiled, strict=True))


class PulledForm(WeakForm):
    """The work of the internal forces of a step on weights in the place of virtual displacements.

    With internal variables, their increments times further weights are added. All data of the
    sections must vary, cell by cell at least.
    """

    def __init__(self, parameters: Any, *arguments: Any):
        #: UFL's constant of the values of parameters; None without any.
        self._values = parameters
        super().__init__(*arguments)

    def _compile(self) -> None:
        fields, by = self.fields, {}
        #: Weights in the place of the test function, and of the increments of internal variables.
        self.weight = dolfinx_api.Coefficient(fields.test.ufl_function_space())
        self.internal_weight = None
        work = ufl.replace(self._residual, {fields.test: self.weight})
        if fields.before in work.coefficients():
            by["before"] = fields.before
        if self.width:
            space = fields.internal(self.width)
            self.internal_weight = dolfinx_api.Coefficient(space)
            grown = {ufl.TestFunction(space): self.internal_weight}
            work += ufl.replace(self._increments(), grown)
            by["internal"] = self.internal
        weights = [self.weight, *[self.internal_weight] * bool(self.width)]
        if self.has_natural:
            by |= dict(zip(("natural", "natural_end"), fields.natural, strict=True))
        #: Zero, added to the parameters of each element.
        self.more = None
        if self.parameters is not None:
            self.more = fields.data((1, self.parameters.ufl_shape))
            work = ufl.replace(work, {self.parameters: self._values + self.more})
        data = {"stiffness": self.stiffness, "times": self.times, "parameters": self.more}
        by |= {name: symbol for name, symbol in data.items() if symbol is not None}
        #: The work, and its derivatives in the order of `Pulled` in problem.h.
        flags = dolfinx_api.ONLY_IN_BATCHES
        forms = work_and_derivatives("work", work, fields, by, flags)
        self.work = WorkOnWeights(forms, weights)


class StoredForm(WeakForm):
    """The stored energy, and its derivatives by the start of a step, data and parameters."""

    def __init__(self, parameters: Any, *arguments: Any):
        #: UFL's constant of the values of parameters; None without any.
        self._values = parameters
        super().__init__(*arguments)

    def _compile(self) -> None:
        #: As `PulledForm.forms`; and zero, added to the parameters of each element.
        self.forms, self.more = energy_forms(self, "stored energy", self._stored, self._values)


class LossForm(WeakForm):
    """What material and scheme take in a step, and its derivatives by all that it depends on."""

    def __init__(self, parameters: Any, *arguments: Any):
        #: UFL's constant of the values of parameters; None without any.
        self._values = parameters
        super().__init__(*arguments)

    def _compile(self) -> None:
        lost = self._losses["lost energy"] + self._losses["scheme's loss"]
        #: As those of `StoredForm`.
        self.forms, self.more = energy_forms(self, "lost energy", lost, self._values)


def energy_forms(
    weak: WeakForm, name: str, energy: Any, values: Any
) -> tuple[dict[str, CompiledForm], Any]:
    """An energy and its derivatives, and zero that is added to the parameters of each element."""
    natural, natural_end = weak.fields.natural
    by = {"stiffness": weak.stiffness, "times": weak.times, "internal": weak.internal}
    by |= {"natural": natural, "natural_end": natural_end, "before": weak.fields.before}
    more: Any = None
    if weak.parameters is not None:
        more = by["parameters"] = weak.fields.data((1, weak.parameters.ufl_shape))
        energy = ufl.replace(energy, {weak.parameters: values + more})
    there = {what: symbol for what, symbol in by.items() if symbol in energy.coefficients()}
    return work_and_derivatives(name, energy, weak.fields, there), more


def assembled(
    forms: Mapping[str, Any], spaces: Mapping[str, Any], mesh: Mesh
) -> dict[str, np.ndarray]:
    """Derivatives by name: those in `NODAL` (size of beams,), by places "X", and "parameters" (n,).

    Others, at Gauss points or on cells, (cells, points, ...).
    """
    found = {}
    for name, form in forms.items():
        space = spaces[name]
        values, dofs = dolfinx_api.function(space).x.array, dolfinx_api.element_dofs(space)
        dolfinx_api.assemble_vector(values, form)
        if name in NODAL:
            found[name] = values[: mesh.in_beams]
        elif name == "coordinates":
            found["X"] = np.zeros_like(mesh.X)
            found["X"][dolfinx_api.element_points(mesh.mesh)] = values.reshape(-1, 2)[dofs]
        else:
            at_points = values.reshape(dofs.max() + 1, -1)
            found[name] = at_points.sum(axis=0) if name == "parameters" else at_points[dofs]
    return found
