"""The part of one process: its forces, its tangent, and its rows of the linear system."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.laws.interval import Interval
from fx_beam.laws.schemes import Scheme
from fx_beam.results.state import State
from fx_beam.step.equations import Equations
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.tables import Problem

from .linear_system import LinearSystem, Solved
from .partition import Share


class Frame(NamedTuple):
    """How vectors of a part are numbered, for the process that has the whole."""

    #: Degrees of freedom (n, 3) of the rows of its share.
    dofs: np.ndarray
    #: Number in the linear system of each of its unknowns.
    unknowns: np.ndarray


class Part:
    """A share of the scene as a model, with its equations."""

    def __init__(self, share: Share, scheme: Scheme, time: float):
        self._model = model = Model(share.scene(), scheme, part=True)
        problem = Problem(model, NewtonOptions(), bare=True)
        problem.hand_over_ends(None)
        self._natural: np.ndarray | None = None
        self._equations = Equations(model, time, None, lambda end: self._natural, problem)
        self._unknowns = _numbers_of_unknowns(share, model)
        #: Indices of its parameters among those of the scene.
        self._parameters = [share.parameters.index(name) for name in model.forms.parameters.names]
        self._system: LinearSystem | None = None

    def frame(self) -> Frame:
        """How its vectors are numbered."""
        return Frame(self._model.mesh.dofs, self._unknowns)

    def connect(self, counts: np.ndarray, kind: str, negligible: float) -> None:
        """Begin the linear system, of so many unknowns of each process; all processes at once.

        An error of an unknown may be `negligible`.
        """
        self._system = LinearSystem(counts, kind, negligible)

    def begin(
        self,
        interval: Interval,
        start: dict[str, Any],
        natural_end: np.ndarray | None,
        parameters: np.ndarray,
    ) -> None:
        """Begin a step from a part of the state; natural strains are those at its end."""
        state = State(interval.start, np.empty(0), **start)
        self._model.forms.parameters.keep(parameters[self._parameters])
        self._natural = natural_end
        self._equations.begin(interval, state)
        if self._system is not None:
            self._system.begin()

    def at(
        self, y: np.ndarray, driven: np.ndarray, force: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Its share (size,) of the internal forces and of the full residual, for its own loads."""
        balance = self._equations.at(y, driven, force)
        return balance.f, balance.r

    def change(self, D: np.ndarray, sizes: bool) -> np.ndarray:
        """Its share of the change of forces with small changes; of their sizes if asked."""
        return self._equations.change(D, sizes)

    def set_pattern(self, more: np.ndarray) -> None:
        """Set the pattern of the linear system, with (m, 2) more entries; all processes at once."""
        indptr, indices = self._model.reduction.factored
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        assert self._system is not None
        self._system.set_pattern(self._unknowns, rows, indices, more)

    def solve(self, more: np.ndarray, b: np.ndarray, least: float) -> Solved:
        """Its own unknowns from its own right-hand side; all processes at once.

        `more` are the values of the entries that were added, `least` is a negligible error.
        """
        assert self._system is not None
        return self._system.solve(self._equations.values, more, b, least)

    def destroy(self) -> None:
        """Free what PETSc has; all processes at once."""
        if self._system is not None:
            self._system.destroy()


def _numbers_of_unknowns(share: Share, model: Model) -> np.ndarray:
    """Number in the whole linear system of each unknown of the part."""
    column, dof, of_slide, joint = model.couplings.free_columns
    of_dof = np.empty(model.size, dtype=int)
    of_dof[model.mesh.dofs] = share.unknowns
    numbers = np.full(model.reduction.free, -1)
    numbers[column] = of_dof[dof]
    numbers[of_slide] = share.slides[joint]
    assert (numbers >= 0).all(), "a part has other unknowns than the whole"
    return numbers
