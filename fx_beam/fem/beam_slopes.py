"""Derivatives of the forces, energies and resultants of beams in steps, by all that these read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.laws.interval import StepBatch
from fx_beam.scene.beam import gauss_rule

from .assembly import MeshTerm, Space
from .beam_forms import BeamForms

#: Name and space of numbers, and derivatives by these in k steps.
_Slopes = Iterator[tuple[str, Space, np.ndarray]]


class BeamSlopes:
    """Derivatives by name: (k, numbers) in k steps by nodal fields, positions "X", "parameters".

    Others are by numbers at Gauss points or of cells.
    """

    def __init__(self, beams: BeamForms):
        self._beams, self._data = beams, beams.data

    def sizes(self, forces: str) -> dict[str, int]:
        """Widths of the arrays of an element on which "internal forces" or "drag" depend."""
        names = self._beams.source.module("work", forces).facts["derivatives"]
        return {name: self._data.spaces[name].width for name in names}

    def jacobians(self, forces: str, moves_nodes: bool) -> dict[tuple[str, int], MeshTerm]:
        """The work of these forces on weights, as ("work", 0), and its derivatives.

        Each is by numbers of a name, and by a weight: of the forces, and of the increments of
        internal variables.
        """
        names = [name for name in self.sizes(forces) if moves_nodes or name != "coordinates"]
        pairs = self._beams.terms("slopes", forces, *names).items()
        titles = ((title.rsplit(" ", 1), term) for title, term in pairs)
        return {(name, int(number)): term for (name, number), term in titles}

    def _slopes(self, quantity: str, steps: StepBatch, moves_nodes: bool) -> _Slopes:
        """Derivatives (k, cells, entries of a tensor) of a quantity; by positions if wanted."""
        steps = self._data.read(steps)
        for name, term in self._beams.terms("derivatives", quantity).items():
            if moves_nodes or name != "coordinates":
                yield name, term.spaces[-1], term.values(steps, (term.size,))

    def _summed(self, slopes: _Slopes, cell: int | None = None) -> dict[str, np.ndarray]:
        """Sums (k, numbers) over cells, or of one cell, by the names of numbers."""
        sums: dict[str, np.ndarray] = {}
        cells = slice(None) if cell is None else [cell]
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

    def energy(self, steps: StepBatch, moves_nodes: bool) -> dict[str, np.ndarray]:
        """Derivatives of `BeamForms.strain_energy` by "q", "internal" variables, "natural" strains.

        And by the data of sections, "X", and "parameters".
        """
        derivatives = self._summed(self._slopes("strain energy", steps, moves_nodes))
        derivatives["q"] = derivatives.pop("start")
        return derivatives

    def losses(self, steps: StepBatch, moves_nodes: bool) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in completed steps: to material, scheme and drag.

        By "increment", "start" and "q_previous", "X", "internal" variables, strains "natural" at
        the start and "natural_end", "parameters", "stiffness", "retardation", and coefficients of
        "drag ...".
        """
        losses = self._beams.losses
        return [self._summed(self._slopes(name, steps, moves_nodes)) for name in losses]

    def forces(
        self, steps: StepBatch, moves_nodes: bool, weights: np.ndarray, cell: int
    ) -> dict[str, np.ndarray]:
        """Derivatives of sums of weights (k, width) times forces of a cell.

        These are `BeamForms.forces_of_cells`. By "increment", "start" and "q_previous", "internal"
        variables, the data of sections, strains "natural" at the start and "natural_end",
        "parameters", and "X".
        """
        steps = self._data.read(steps)

        def cell_slopes() -> _Slopes:
            for forces in self._beams.forces:
                for (name, weight), term in self.jacobians(forces, moves_nodes).items():
                    if name != "work" and not weight:
                        space = term.spaces[0]
                        slopes = term.values(steps, (space.width, weights.shape[1]), cell)
                        yield name, space, np.einsum("kcnw,kw->kcn", slopes, weights)

        return self._summed(cell_slopes(), cell)

    def resultants(
        self, steps: StepBatch, moves_nodes: bool, component: int
    ) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Jacobians (k, cells, points, numbers) of N, Q or M by name, and entries of the numbers.

        These (cells, numbers) are those of fields, of positions "X", or of all "parameters".
        """
        weights = gauss_rule(self._beams.kind.degree)[1][:, None]
        for name, space, slopes in self._slopes("resultants", steps, moves_nodes):
            entries = space.dofs
            if name == "parameters":
                entries = np.broadcast_to(self._data.parameters, entries.shape)
            name = "X" if name == "coordinates" else name
            point_slopes = slopes.reshape(*slopes.shape[:2], len(weights), 3, space.width)
            yield name, entries, point_slopes[..., component, :] / weights
