"""The work of a step's forces on given weights, and its derivatives: what steps backwards need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import ufl
from ufl.algorithms import expand_derivatives

import numpy as np

from fx_beam.scene.beam import gauss_rule

from . import elements, ffcx_api
from .assembly import BoundForm, Space
from .ffcx_api import CompiledForm
from .fields import Fields
from .weak_form import WeakForm

#: Names of the derivatives by nodal vectors.
NODAL = "increment", "start", "q_previous"


class WorkOnWeights:
    """A work on weights and its derivatives by name, in UFL; on no particular mesh."""

    def __init__(self, name: str, work: Any, derivatives: dict[str, Any], weights: list[Any]):
        self.derivatives, self.weights = derivatives, weights
        self._name, self._work = name, work
        self._compiled: dict[tuple[str, ...], dict[tuple[str, int], CompiledForm]] = {}

    def slopes(self, names: Iterable[str]) -> dict[tuple[str, int], CompiledForm]:
        """The work itself, as ("work", 0), and derivatives by these names and by each weight."""
        key = tuple(names)
        if key not in self._compiled:
            self._compiled[key] = self._slopes(key)
        return self._compiled[key]

    def _slopes(self, names: tuple[str, ...]) -> dict[tuple[str, int], CompiledForm]:
        slopes = {("work", 0): self._work}
        for name in names:
            for number, weight in enumerate(self.weights):
                slope = ufl.derivative(self.derivatives[name], weight)
                if not expand_derivatives(slope).empty():
                    slopes[name, number] = slope
        titles = {f"{self._name}, slope {name} {k}": slopes[name, k] for name, k in slopes}
        compiled = ffcx_api.compile_together(titles, ffcx_api.ONLY_IN_BATCHES)
        return dict(zip(slopes, compiled, strict=True))


class BoundVjp(NamedTuple):
    """A work on a mesh."""

    work: WorkOnWeights
    #: Spaces of the derivatives by their names.
    spaces: Mapping[str, Space]
    #: Binds a form with arguments in these spaces.
    bind: Callable[[CompiledForm, list[Space]], BoundForm]
    #: Spaces of the weights.
    of_weights: list[Space]

    def slopes(self, names: Iterable[str]) -> dict[tuple[str, int], BoundForm]:
        """The work and its slopes."""
        slopes = {}
        for (name, number), form in self.work.slopes(names).items():
            spaces = [] if name == "work" else [self.spaces[name], self.of_weights[number]]
            slopes[name, number] = self.bind(form, spaces)
        return slopes

    @property
    def sizes(self) -> dict[str, int]:
        """How many numbers of an element there are, by the names of derivatives."""
        return {name: self.spaces[name].width for name in self.work.derivatives}


def derivatives_of(quantity: Any, fields: Fields, by: Mapping[str, Any]) -> dict[str, Any]:
    """Its derivatives by increment and start, by coefficients, and by coordinates, in UFL.

    Without those that are zero.
    """
    by = {"increment": fields.increment, "start": fields.start, **by}
    forms = {what: ufl.derivative(quantity, field) for what, field in by.items()}
    X, of_X = fields.coordinates
    argument = ufl.Argument(of_X, len(quantity.arguments()))
    forms["coordinates"] = ufl.derivative(quantity, X, argument)
    return {what: form for what, form in forms.items() if not expand_derivatives(form).empty()}


def compiled_derivatives(
    title: str, quantity: Any, fields: Fields, by: Mapping[str, Any]
) -> dict[str, CompiledForm]:
    """The same, compiled."""
    forms = derivatives_of(quantity, fields, by)
    named = {f"{title} by {what}": form for what, form in forms.items()}
    return dict(zip(forms, ffcx_api.compile_together(named), strict=True))


class DerivedForm(WeakForm):
    """A quantity of a step, and its derivatives by all that it depends on.

    All data of the sections must vary, cell by cell at least.
    """

    title: str

    def __init__(self, parameters: Any, *arguments: Any):
        #: UFL's constant of the values of parameters; None without any.
        self._values = parameters
        super().__init__(*arguments)

    def _quantity(self) -> Any:
        """It, as an integral."""
        raise NotImplementedError

    def _compile(self) -> None:
        fields, quantity = self.fields, self._quantity()
        #: Zero, added to the parameters of each element.
        self.more: Any = None
        if self.parameters is not None:
            self.more = fields.data((1, self.parameters.ufl_shape))
        quantity = self._with_more(quantity)
        by = {"q_previous": fields.q_previous, "internal": self.internal}
        by |= dict(zip(("natural", "natural_end"), fields.natural, strict=True))
        by |= {"stiffness": self.stiffness, "times": self.times, "parameters": self.more}
        #: Those in the quantity by name.
        self.by = {name: field for name, field in by.items() if field in quantity.coefficients()}
        self._derive(quantity)

    def _derive(self, quantity: Any) -> None:
        #: Its derivatives by name.
        self.forms = compiled_derivatives(self.title, quantity, self.fields, self.by)

    def _with_more(self, quantity: Any) -> Any:
        if self.more is None:
            return quantity
        return ufl.replace(quantity, {self.parameters: self._values + self.more})


class VjpForm(DerivedForm):
    """The work of the internal forces of a step on weights in the place of virtual displacements.

    With internal variables, their increments times further weights are added.
    """

    title = "work"

    def _quantity(self) -> Any:
        test = self.fields.test
        #: Weights in the place of the test function, and of the increments of internal variables.
        self.weight = elements.Coefficient(test.ufl_function_space())
        self.internal_weight = None
        work = ufl.replace(self._residual, {test: self.weight})
        if self.width:
            space = self.fields.internal(self.width)
            self.internal_weight = elements.Coefficient(space)
            grown = {ufl.TestFunction(space): self.internal_weight}
            work += ufl.replace(self._increments(), grown)
        return work

    def _derive(self, quantity: Any) -> None:
        weights = [self.weight, *[self.internal_weight] * bool(self.width)]
        derivatives = derivatives_of(quantity, self.fields, self.by)
        #: The work with its weights.
        self.work = WorkOnWeights(self.title, quantity, derivatives, weights)


class StoredForm(DerivedForm):
    """The stored energy."""

    title = "stored energy"

    def _quantity(self) -> Any:
        return self._stored


class LossForm(DerivedForm):
    """What material and scheme take in a step."""

    title = "lost energy"

    def _quantity(self) -> Any:
        return self._losses["lost energy"] + self._losses["scheme's loss"]


class ResultantForm(DerivedForm):
    """Resultants at the Gauss points, each times the weight of its point."""

    title = "resultants"

    def _quantity(self) -> Any:
        return self._at_points(self.resultants, ufl.TestFunction(self.fields.internal(3)))


def named(vectors: Mapping[str, tuple[Space, np.ndarray]]) -> dict[str, np.ndarray]:
    """Derivatives by name: those in `NODAL` (size,), by positions "X" (n, 2), "parameters" (n,).

    Others, at Gauss points or on cells, (cells, points, numbers).
    """
    derivatives = {}
    for name, (space, values) in vectors.items():
        if name == "coordinates":
            derivatives["X"] = values.reshape(-1, 2)
        elif name in NODAL:
            derivatives[name] = values
        else:
            of_cells = values.reshape(-1, space.points, space.width // space.points)
            derivatives[name] = of_cells.sum(axis=(0, 1)) if name == "parameters" else of_cells
    return derivatives


class ResultantDerivatives:
    """Local Jacobians of resultants in a step, which `begin` begins, by forms on a mesh."""

    def __init__(self, forms: Mapping[str, BoundForm], points: int, begin: Callable[[Any], None]):
        self._forms, self._begin = forms, begin
        #: Weights (points,) of the Gauss points, relative to the element's length.
        self._point_weights = gauss_rule(points)[1]

    def _slopes(self, part: Any) -> Iterator[tuple[str, Space, np.ndarray]]:
        """Derivatives (cells, points, 3, numbers) by name, and the space of the numbers."""
        self._begin(part)
        for name, form in self._forms.items():
            space, points = form.spaces[1], len(self._point_weights)
            slopes = form.tensors().reshape(-1, points, 3, space.width)
            yield name, space, slopes / self._point_weights[:, None, None]

    def vjp(self, part: Any, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the sum of weights (cells, points, 3) times N, Q and M, by name.

        By "increment", "start" and "q_previous" (size,), "internal" variables, the data of
        sections, strains "natural" at the start and "natural_end", "parameters", and "X".
        """
        vectors = {}
        for name, space, slopes in self._slopes(part):
            by = np.einsum("cpi,cpin->cn", weights, slopes)
            vectors[name] = space, np.bincount(space.dofs.ravel(), by.ravel(), space.size)
        return named(vectors)

    def jvp(self, part: Any, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """Changes (m, cells, points, 3) of N, Q and M from those (m, ...) by these names."""
        total: Any = 0.0
        for name, space, slopes in self._slopes(part):
            values = changes["X" if name == "coordinates" else name]
            values = values.reshape(len(values), -1)
            if name == "parameters":
                values = np.tile(values, len(space.dofs))
            total = total + np.einsum("cpin,mcn->mcpi", slopes, values[:, space.dofs])
        return total
