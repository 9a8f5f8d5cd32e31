"""The work of elements on weights, whose derivatives are summed over the steps of a run."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.fem import dolfinx_api
from fx_beam.fem.beam_forms import BeamForms
from fx_beam.fem.vjp_form import BoundVjp

from .kernels import Kernel
from .tables import Problem

# These derivatives come first, in this order; the others are summed for each element.
_FIRST = "work", "increment", "start", "q_previous", "internal", "natural", "natural_end"
# Names of the others, besides the coefficients of drag.
_NAMES = {
    "coordinates": "coordinates",
    "parameters": "parameters of elements",
    "stiffness": "stiffness",
    "times": "retardation",
}


class VjpWork:
    """A work on weights: its derivatives by the numbers of each element are summed over steps."""

    def __init__(self, name: str, vjp: BoundVjp):
        #: Its name in C.
        self.name, self._vjp = name, vjp
        sizes = {name: dolfinx_api.tensor_size(form) for name, (form, _) in vjp.forms.items()}
        self._sizes = sizes
        #: Numbers of an element by name.
        self._tail = {name: size for name, size in sizes.items() if name not in _FIRST}
        self._slopes: dict[bool, dict[str, Any]] = {}
        #: Names of the derivatives.
        self.names = [_name_of(name) for name in self._tail]
        #: Sums [block][number][lane], and the cells of each integral.
        self.sums, self._cells = np.empty((0, 0, 0)), list[np.ndarray]()

    def handed_over(self, problem: Problem, beams: BeamForms) -> dict[str, Any]:
        """The work as ``Vjp`` of c/problem.h, without its form."""
        self._cells = [beams.cells_of(tag) for tag in self._vjp.tags]
        lanes, total = problem.library.LANES, sum(self._tail.values())
        blocks = sum(-(-len(cells) // lanes) for cells in self._cells)
        self.sums = np.zeros((blocks, total, lanes))
        return {
            **{name: int(name in self._sizes) for name in _FIRST[1:]},
            "parameters_at": self._first_parameter(),
            "tail": total,
            "sums": self.sums,
        }

    def form(self, problem: Problem) -> dict[str, Any]:
        """Its form, for runs backwards."""
        assert problem.tables is not None
        kernel = Kernel([*self._vjp.forms.values()], [*self._sizes.values()])
        table = problem.tables.of("work by start", kernel, self._vjp.moving)
        table["changing"] = table["moving"]
        return {"form": table}

    def slopes(self, problem: Problem, by_places: bool) -> dict[str, Any]:
        """What runs forwards need of it besides, as members of ``Vjp``: by places if wanted."""
        if by_places not in self._slopes:
            self._slopes[by_places] = self._made_slopes(problem, by_places)
        return self._slopes[by_places]

    def _made_slopes(self, problem: Problem, by_places: bool) -> dict[str, Any]:
        assert problem.tables is not None
        names = [name for name in self._sizes if name != "work"]
        at = dict(
            zip(names, itertools.accumulate(self._sizes[name] for name in names), strict=True)
        )
        wanted = [name for name in names if by_places or name != "coordinates"]
        pieces = self._vjp.slopes(wanted)
        forms = [self._vjp.forms["work"], *pieces.values()]
        kernel = Kernel(forms, [1, *(dolfinx_api.tensor_size(form) for form, _ in pieces.values())])
        table = problem.tables.of("slopes of forces", kernel, self._vjp.moving)
        table["changing"] = table["moving"]
        return {
            "slopes": table,
            "pieces": len(pieces),
            "slope_numbers": kernel.size,
            "of_internal": [weight for _, weight in pieces],
            "piece_at": [at[name] - self._sizes[name] for name, _ in pieces],
            "piece_size": [self._sizes[name] for name, _ in pieces],
        }

    def _first_parameter(self) -> int:
        """Index of the first parameter in the tail, or -1."""
        names = list(self._tail)
        if "parameters" not in names:
            return -1
        return sum(self._tail[name] for name in names[: names.index("parameters")])

    def of_cells(self, cells: int) -> dict[str, np.ndarray]:
        """Derivatives (cells, points, ...) by name, in the order of the cells."""
        total, lanes = self.sums.shape[1:]
        found, first = np.zeros((cells, total)), 0
        for own in self._cells:
            end = first + -(-len(own) // lanes)
            rows = self.sums[first:end].transpose(0, 2, 1).reshape(-1, total)
            found[own], first = rows[: len(own)], end
        ends = np.cumsum([*self._tail.values()])[:-1]
        parts = dict(zip(self._tail, np.split(found, ends, axis=1), strict=True))
        return {_name_of(name): self._by_points(name, part) for name, part in parts.items()}

    def in_lanes(self, changes: Mapping[str, np.ndarray], count: int, cells: int) -> np.ndarray:
        """Changes (count, numbers) of the numbers of all elements, of one after the other.

        The elements are in the order of the sums, those that are missing in a block included.
        """
        parts = [
            np.broadcast_to(0.0, (count, cells, size))
            if (change := changes.get(_name_of(name))) is None
            else np.reshape(change, (count, cells, size))
            for name, size in self._tail.items()
        ]
        rows, (blocks, total, lanes) = np.concatenate(parts, axis=-1), self.sums.shape
        found, first = np.zeros((count, blocks * lanes, total)), 0
        for own in self._cells:
            found[:, first : first + len(own)] = rows[:, own]
            first += -(-len(own) // lanes) * lanes
        return found.reshape(count, -1)

    @staticmethod
    def _by_points(name: str, part: np.ndarray) -> np.ndarray:
        if name in ("coordinates", "parameters"):
            return part
        width = 3 if name in _NAMES else 2 if "across" in name else 1
        by_points = part.reshape(len(part), -1, width)
        return by_points if width > 1 else by_points[..., 0]


def _name_of(name: str) -> str:
    return _NAMES.get(name, f"drag {name}")
