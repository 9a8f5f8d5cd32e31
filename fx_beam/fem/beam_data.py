"""What the forms of beams read on the mesh of a scene: fields, and numbers of a step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.laws.interval import StepBatch
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .assembly import Field, Space, Term
from .fields import CONSTANTS, NATURAL, NODAL
from .form_library import CompiledForm
from .mesh import Mesh
from .parameter_values import ParameterValues
from .weak_form import Kind, StepFacts


class BeamData:
    """Fields and arrays by their names in forms; `tags` (cells,) are the numbers of materials."""

    def __init__(
        self,
        scene: Scene,
        mesh: Mesh,
        kind: Kind,
        facts: StepFacts,
        numbers: Mapping[str, Any],
        tags: np.ndarray,
        parameters: ParameterValues,
    ):
        self.mesh, self.tags, self._numbers = mesh, tags, {*numbers}
        degree, self._parameters = kind.degree, parameters
        #: Indices of the parameters in the forms among all, and the number of all.
        self.parameters, self.parameter_count = parameters.indices(facts.names), len(parameters)
        named: dict[str, Any] = {name: np.zeros(()) for name in CONSTANTS}
        named["dt"][...] = named["load_factor"][...] = 1.0
        named["parameters"] = np.zeros(len(facts.names))
        named |= {
            name: Field(mesh.space(values.shape[1], math.prod(values.shape[2:])))
            for name, values in numbers.items()
        }
        if facts.width:
            named["internal"] = Field(mesh.space(degree, facts.width))
        if kind.natural:
            named |= {name: Field(mesh.space(degree, 3)) for name in NATURAL}
        named |= {name: Field(mesh.unknowns) for name in NODAL}
        coordinate = named["coordinate"] = Field(mesh.space(2))
        coordinate.array.reshape(-1, 2)[:] = 0.0, degree
        for i, work in enumerate(scene.virtual_works):
            indicator = named[f"indicator {i}"] = Field(mesh.space(1))
            indicator.array[:] = work.beam is None
            if work.beam is not None:
                cells = mesh.cells[scene.beams.index(work.beam)]
                indicator.array[cells[slice(*work.elements)]] = True
        #: Fields and arrays by name.
        self.named = named
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in problem.h; None is missing.
        self.moving: list[Any] = [named.get(name) for name in (*NODAL, "internal", *NATURAL)]
        self.bind(numbers)

    def bind(self, numbers: Mapping[str, Any]) -> None:
        """Set the data (cells, points, ...) of sections and of drag."""
        self.named["load_factor"][...] = 1.0
        for name, values in numbers.items():
            self.named[name].array[:] = floats(values).ravel()

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Values (cells, width) of what is constant over steps, by name."""
        names = [n for n in self.named if n in self._numbers or n.startswith(("coord", "indic"))]
        return {name: self.named[name].array.reshape(len(self.tags), -1) for name in names}

    def term(
        self, form: CompiledForm, spaces: Sequence[Space] = (), more: dict[str, Any] | None = None
    ) -> Term:
        """A form or an expression on the mesh, with arguments in some spaces, and `more` fields."""
        return Term(form, self.mesh, self.named | (more or {}), spaces, self.tags, self.moving)

    def read(self, steps: StepBatch) -> StepBatch:
        """Steps with the parameters of the forms alone."""
        values = steps.parameters
        if not values.size:
            values = floats(self._parameters.at_times(steps.t))
        return steps._replace(parameters=values[:, self.parameters])


def check_shapes(kind: Kind, numbers: Mapping[str, Any]) -> None:
    """OtherStructureError if data of sections and of drag are of another kind."""
    shapes = shapes_of(numbers)
    if [name for name, _ in kind.data] != [name for name, _ in shapes]:
        raise OtherStructureError("beams have other kinds of data")
    if kind.data != shapes:
        raise OtherStructureError("data of beams that were constant vary, or conversely")


def shapes_of(numbers: Mapping[str, Any]) -> tuple:
    """How many points data (cells, points, ...) have, and the shape of a value, by name."""
    return tuple((name, (x.shape[1], x.shape[2:])) for name, x in numbers.items())
