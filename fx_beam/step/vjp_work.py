"""Forces of elements as their work on weights: the local Jacobians that runs both ways follow."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.beam_slopes import BeamSlopes

from .form_tables import Kernel, in_lanes
from .layout import StepVariables
from .tables import ProblemInC

#: Members of a struct in C by name.
Members = dict[str, object]
# Arrays of `StepVariables` and rows of `FormTables` of numbers that elements have in common, by
# the names of derivatives; other numbers are of each element.
_IN_COMMON = {
    "increment": ("q1", "dofs"),
    "start": ("q", "dofs"),
    "q_previous": ("q previous", "dofs"),
    "internal": ("internal", "internal"),
    "natural": ("natural", "natural"),
    "natural_end": ("natural1", "natural"),
    "parameters": ("parameters", ""),
}


class VjpWork:
    """Dense Jacobians of all elements, and where their numbers are in the vector of a sub-step.

    They are by the configurations at the end and at the start, not by increment and start.
    """

    def __init__(self, name: str, beams: BeamForms, problem: ProblemInC):
        assert problem.tables is not None  # as there are beams
        #: The forms, as the array of `StepVariables` with the numbers of one element after the
        #: other.
        self.array, self._beams, self._tables = name, beams, problem.tables
        self._slopes, self._lanes = BeamSlopes(beams), problem.constants.LANES
        #: Its name in C.
        self.name = name.replace(" ", "_")
        nodal = dict.fromkeys(("increment", "start"), problem.c.tables.mesh.cell_dofs)
        self._sizes = nodal | self._slopes.sizes(name)
        self._local = {name: size for name, size in self._sizes.items() if name not in _IN_COMMON}
        self._compiled: dict[bool, tuple[list[tuple[str, int]], Kernel, Members]] = {}

    def first_members(self) -> Members:
        """Members of ``Vjp`` of c/problem.h that the layout of the vector needs."""
        has_previous = int("q_previous" in self._sizes)
        return {"element_numbers": sum(self._local.values()), "q_previous": has_previous}

    def compiled(self, has_places: bool) -> tuple[list[tuple[str, int]], Kernel, Members]:
        """Names of derivatives, each by a weight, and their forms, also as a table for C."""
        if has_places not in self._compiled:
            slopes = self._slopes.jacobians(self.array, has_places)
            kernel = Kernel([*slopes.values()])
            table = self._tables.of("slopes of forces", kernel)
            self._compiled[has_places] = [*slopes][1:], kernel, table  # behind the work
        return self._compiled[has_places]

    def members(self, layout: StepVariables, has_places: bool) -> Members:
        """The other members; without derivatives by places of nodes if they are not wanted."""
        slopes, kernel, table = self.compiled(has_places)
        ends = {weight: i for i, (name, weight) in enumerate(slopes) if name == "increment"}
        pieces = slopes + [key for weight in ends if (key := ("start", weight)) not in slopes]
        numbers, weights, lanes = self._numbers(layout), self._weights(layout), self._lanes
        first, widths = _starts(self._sizes.values()), [rows.shape[1] for rows in weights]
        first_number = dict(zip(self._sizes, first, strict=False))
        size = [self._sizes[name] for name, _ in pieces]
        width = [widths[weight] for _, weight in pieces]
        piece_start = _starts([1, *(m * n for m, n in zip(size, width, strict=True))])
        nowhere, state_names = layout.at["nowhere"][0], _IN_COMMON.keys() - {"parameters"}
        cells = kernel.forms[0].cells
        sources, targets = (
            np.concatenate([in_lanes(np.hstack(rows)[chosen], lanes, nowhere) for chosen in cells])
            for rows in ([*numbers], weights)
        )
        return {
            "slopes": table,
            "blocks": sum(-(-len(chosen) // lanes) for chosen in cells),
            "numbers": first[-1],
            "state_numbers": sum(self._sizes[name] for name in self._sizes.keys() & state_names),
            "weights": sum(widths),
            "slope_numbers": piece_start[-1],
            "pieces": len(pieces),
            "made": len(slopes),
            "piece_start": piece_start[1:-1],
            "number_at": [first_number[name] for name, _ in pieces],
            "piece_numbers": size,
            "weight_at": [_starts(widths)[weight] for _, weight in pieces],
            "piece_weights": width,
            "end_of": [ends.get(weight, -1) if name == "start" else -1 for name, weight in pieces],
            "from": sources,
            "to": targets,
        }

    def of_element(self, layout: StepVariables) -> dict[str, np.ndarray]:
        """Places (cells, n) of the numbers of each element itself, by name."""
        cells = layout.at[self.array].reshape(-1, sum(self._local.values()))
        parts = np.split(cells, _starts(self._local.values())[1:-1], axis=1)
        return dict(zip(self._local, parts, strict=True))

    def _numbers(self, layout: StepVariables) -> Iterator[np.ndarray]:
        """Places (cells, n) of all numbers of the elements, in the order of the sizes."""
        element_rows, rows = iter(self.of_element(layout).values()), self._tables.rows
        for name, size in self._sizes.items():
            if name not in _IN_COMMON:
                yield next(element_rows)
                continue
            array, kind = _IN_COMMON[name]
            columns = self._beams.data.parameters if name == "parameters" else rows[kind]
            places = layout.at[array][np.reshape(columns, (-1, size))]
            yield np.broadcast_to(places, (len(rows["dofs"]), size))

    def _weights(self, layout: StepVariables) -> list[np.ndarray]:
        """Places (cells, n) of forces, and of internal variables at the end."""
        pairs = [("r", "dofs")]
        if "internal" in self._sizes:
            pairs.append(("internal1", "internal"))
        return [layout.at[array][self._tables.rows[kind]] for array, kind in pairs]


def _starts(sizes: Iterable[int]) -> list[int]:
    """Where parts of some sizes begin that stand behind each other, and where the last one ends."""
    return [0, *itertools.accumulate(sizes)]
