"""The work of a step's forces on given weights, and its derivatives: what steps backwards need."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.scene.beam import gauss_rule
from fx_beam.symbolic import Written, ufl

from . import elements
from .assembly import BoundForm, Space
from .fields import NODAL, Fields
from .form_library import CompiledForm, FormSource
from .weak_form import Kind, WeakForm


class WorkOnWeights:
    """A work on weights and its derivatives by name, in UFL; on no particular mesh."""

    def __init__(self, work: Any, derivatives: dict[str, Any], weights: list[Any], names: Mapping):
        self._work, self._derivatives, self._weights = work, derivatives, weights
        self._names = {**names, **{weight: f"weight {k}" for k, weight in enumerate(weights)}}

    def derivatives(self) -> Written:
        """Names of the derivatives, as a fact."""
        return Written({}, {}, {"derivatives": [*self._derivatives]})

    def slopes(self, *wanted: str) -> Written:
        """The work itself, as "work 0", and derivatives by these names and by each weight."""
        slopes = {"work 0": self._work}
        for name in wanted:
            for number, weight in enumerate(self._weights):
                slope = ufl.derivative(self._derivatives[name], weight)
                if not _is_empty(slope):
                    slopes[f"{name} {number}"] = slope
        return Written(slopes, self._names)


class BoundVjp(NamedTuple):
    """A work on a mesh, by forms of `WorkOnWeights`."""

    source: FormSource
    #: Spaces of the derivatives by their names.
    spaces: Mapping[str, Space]
    #: Binds a form with arguments in these spaces.
    bind: Callable[[CompiledForm, list[Space]], BoundForm]
    #: Spaces of the weights.
    of_weights: list[Space]

    def slopes(self, wanted: Iterable[str]) -> dict[tuple[str, int], BoundForm]:
        """The work, as ("work", 0), and its slopes."""
        slopes = {}
        for title, form in self.source.module("slopes", *wanted).forms.items():
            name, number = title.rsplit(" ", 1)
            of_weight = self.of_weights[int(number)]
            spaces = [] if name == "work" else [self.spaces[name], of_weight]
            slopes[name, int(number)] = self.bind(form, spaces)
        return slopes

    @property
    def sizes(self) -> dict[str, int]:
        """How many numbers of an element there are, by the names of derivatives."""
        names = self.source.module("derivatives").facts["derivatives"]
        return {name: self.spaces[name].width for name in names}


def derivatives_of(quantity: Any, fields: Fields, by: Mapping[str, Any]) -> dict[str, Any]:
    """Its derivatives by increment and start, by coefficients, and by coordinates, in UFL.

    Without those that are zero.
    """
    by = {"increment": fields.increment, "start": fields.start, **by}
    forms = {what: ufl.derivative(quantity, field) for what, field in by.items()}
    X, of_X = fields.coordinates
    argument = ufl.Argument(of_X, len(quantity.arguments()))
    forms["coordinates"] = ufl.derivative(quantity, X, argument)
    return {what: form for what, form in forms.items() if not _is_empty(form)}


def _is_empty(form: Any) -> bool:
    """Whether a form is zero once its derivatives are taken."""
    return ufl.algorithms.expand_derivatives(form).empty()


class DerivedForm(WeakForm):
    """A quantity of a step, and its derivatives by all that it depends on.

    All data of the sections must vary, cell by cell at least.
    """

    def __init__(self, kind: Kind):
        super().__init__(kind)
        fields, quantity = self.fields, self._quantity()
        if self.parameters is not None:
            #: Zero, added to the parameters of each element.
            more = fields.data((1, self.parameters.ufl_shape))
            self.named[more] = "more"
            quantity = ufl.replace(quantity, {self.parameters: self.parameters + more})
        of = {name: symbol for symbol, name in self.named.items() if symbol is not None}
        names = "q_previous", "internal", "natural", "natural_end", "stiffness", "times"
        by = {name: of.get(name) for name in names} | {"parameters": of.get("more")}
        #: Those in the quantity by name.
        by = {name: field for name, field in by.items() if field in quantity.coefficients()}
        #: The quantity, and its derivatives by name.
        self.quantity, self.derived = quantity, derivatives_of(quantity, fields, by)

    def _quantity(self) -> Any:
        """It, as an integral."""
        raise NotImplementedError

    def derivatives(self) -> Written:
        """Its derivatives by name."""
        return Written(self.derived, self.named)


def vjp_of(kind: Kind) -> WorkOnWeights:
    """The work of the internal forces of a step on weights in the place of virtual displacements.

    With internal variables, their increments times further weights are added.
    """
    form = _VjpForm(kind)
    return WorkOnWeights(form.quantity, form.derived, form.weights, form.named)


class _VjpForm(DerivedForm):
    def _quantity(self) -> Any:
        test = self.fields.test
        #: Weights in the place of the test function, and of the increments of internal variables.
        self.weights = [elements.coefficient(test.ufl_function_space())]
        work = ufl.replace(self._residual, {test: self.weights[0]})
        if self.width:
            space = self.fields.internal(self.width)
            self.weights.append(elements.coefficient(space))
            grown = {ufl.TestFunction(space): self.weights[1]}
            work += ufl.replace(self._increments(), grown)
        return work


class StoredForm(DerivedForm):
    """The stored energy."""

    def _quantity(self) -> Any:
        return self._stored


class LossForm(DerivedForm):
    """What material and scheme take in a step."""

    def _quantity(self) -> Any:
        return self._losses["lost energy"] + self._losses["scheme's loss"]


class ResultantForm(DerivedForm):
    """Resultants at the Gauss points, each times the weight of its point."""

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
