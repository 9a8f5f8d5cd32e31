"""Derivatives of the forces, energies and resultants of beams in steps, by all that these read."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

from fx_beam.laws.interval import StepBatch
from fx_beam.scene.beam import gauss_rule

from .assembly import Field, Space, Term
from .beam_data import BeamData, Kind
from .form_library import FormSource
from .vjp_form import DerivedForm

#: Name and space of numbers, and derivatives by these in k steps.
_Slopes = Iterator[tuple[str, Space, np.ndarray]]


class BeamSlopes:
    """Derivatives by name: (k, numbers) in k steps by nodal fields, positions "X", "parameters".

    Others are by numbers at Gauss points or of cells.
    """

    def __init__(self, kind: Kind, data: BeamData, forces: list[str], losses: list[str]):
        self._forces, self._losses = forces, losses
        self._degree, self._data, mesh = kind.degree, data, data.mesh
        self._source = FormSource("DerivedForm", kind, functools.partial(DerivedForm, kind))
        #: Fields of derivatives, and the spaces of the numbers, by name.
        self._more = {"weight 0": Field(mesh.unknowns)}
        if (internal := data.named.get("internal")) is not None:
            self._more["weight 1"] = Field(internal.space)
        if data.parameters:
            self._more["more"] = Field(mesh.space(1, len(data.parameters)))
        fields = data.named | self._more
        self._spaces = {n: field.space for n, field in fields.items() if isinstance(field, Field)}
        self._spaces["coordinates"] = mesh.positions
        if data.parameters:
            self._spaces["parameters"] = self._more["more"].space
        # Terms by the quantity, or by the forces and whether by places as well.
        self._terms: dict[Any, dict[Any, Term]] = {}

    def sizes(self, forces: str) -> dict[str, int]:
        """How many numbers of an element "internal forces" or "drag" depend on, by name."""
        names = self._source.module("work", forces).facts["derivatives"]
        return {name: self._spaces[name].width for name in names}

    def jacobians(self, forces: str, by_places: bool) -> dict[tuple[str, int], Term]:
        """The work of these forces on weights, as ("work", 0), and its derivatives.

        Each is by numbers of a name, and by a weight: of the forces, and of the increments of
        internal variables.
        """
        if (key := (forces, by_places)) not in self._terms:
            names = [name for name in self.sizes(forces) if by_places or name != "coordinates"]
            terms = self._terms[key] = {}
            for title, form in self._source.module("slopes", forces, *names).forms.items():
                name, number = title.rsplit(" ", 1)
                weight = f"weight {number}"
                spaces = [] if name == "work" else [self._spaces[name], self._spaces[weight]]
                terms[name, int(number)] = self._data.term(form, spaces, self._more)
        return self._terms[key]

    def _derivatives(
        self, quantity: str, steps: StepBatch, by_places: bool, points: int = 0
    ) -> _Slopes:
        """Derivatives of a quantity of `DerivedForm`; those by positions only if they are wanted.

        Values are (k, cells, numbers), or with `points` (k, cells, points, 3, numbers).
        """
        if quantity not in self._terms:
            tests = [self._data.mesh.space(points, 3)] * bool(points)
            self._terms[quantity] = {
                name: self._data.term(form, [*tests, self._spaces[name]], self._more)
                for name, form in self._source.module("derivatives", quantity).forms.items()
            }
        steps = self._data.read(steps)
        for name, term in self._terms[quantity].items():
            if by_places or name != "coordinates":
                shape = *(points, 3) * bool(points), term.spaces[-1].width
                yield name, term.spaces[-1], term.values(steps, shape)

    def _summed(self, slopes: _Slopes, cells: Any = slice(None)) -> dict[str, np.ndarray]:
        """Sums of derivatives of some cells that are by the same numbers."""
        sums: dict[str, np.ndarray] = {}
        for name, space, values in slopes:
            places, size = space.dofs[cells], space.size
            if name == "parameters":
                places, size = np.array(self._data.parameters), self._data.parameter_count
            places = np.broadcast_to(
                places + size * np.arange(len(values))[:, None, None], values.shape
            )
            rows = np.bincount(places.ravel(), values.ravel(), len(values) * size)
            name = "X" if name == "coordinates" else name
            sums[name] = sums.get(name, 0.0) + rows.reshape(-1, size)
        return sums

    def of_energy(self, steps: StepBatch, by_places: bool) -> dict[str, np.ndarray]:
        """Derivatives of `BeamForms.strain_energy` by "q", "internal" variables, "natural" strains.

        And by the data of sections, "X", and "parameters".
        """
        derivatives = self._summed(self._derivatives("strain energy", steps, by_places))
        derivatives["q"] = derivatives.pop("start")
        return derivatives

    def of_losses(self, steps: StepBatch, by_places: bool) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in completed steps: to material, scheme and drag.

        By "increment", "start" and "q_previous", "X", "internal" variables, strains "natural" at
        the start and "natural_end", "parameters", "stiffness", "retardation", and coefficients of
        "drag ...".
        """
        losses = (self._derivatives(name, steps, by_places) for name in self._losses)
        return [self._summed(slopes) for slopes in losses]

    def of_forces(
        self, steps: StepBatch, by_places: bool, weights: np.ndarray, cell: int
    ) -> dict[str, np.ndarray]:
        """Derivatives of sums of weights (k, width) times forces of a cell.

        These are `BeamForms.forces_of_cells`. By "increment", "start" and "q_previous", "internal"
        variables, the data of sections, strains "natural" at the start and "natural_end",
        "parameters", and "X".
        """
        steps = self._data.read(steps)

        def of_cell() -> _Slopes:
            for forces in self._forces:
                for (name, weight), term in self.jacobians(forces, by_places).items():
                    if name != "work" and not weight:
                        shape = self._spaces[name].width, weights.shape[1]
                        slopes = term.values(steps, shape, cell)
                        yield name, self._spaces[name], np.einsum("kcnw,kw->kcn", slopes, weights)

        return self._summed(of_cell(), [cell])

    def of_resultants(
        self, steps: StepBatch, by_places: bool, component: int
    ) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Jacobians (k, cells, points, numbers) of N, Q or M by name, and entries of the numbers.

        These (cells, numbers) are those of fields, of positions "X", or of all "parameters".
        """
        weights = gauss_rule(self._degree)[1][:, None]
        of_all = self._derivatives("resultants", steps, by_places, self._degree)
        for name, space, slopes in of_all:
            entries = space.dofs
            if name == "parameters":
                entries = np.broadcast_to(self._data.parameters, entries.shape)
            name = "X" if name == "coordinates" else name
            yield name, entries, slopes[..., component, :] / weights
