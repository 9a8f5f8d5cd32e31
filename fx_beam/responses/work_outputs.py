"""Work and dissipated energy as outputs: sums over the steps, or what the balance of energy leaves.

E + dissipated - work stays the same in each step of a scheme that conserves energy, so that one of
both follows from the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.compiled.tape import Tape
from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.scene.outputs import Output
from fx_beam.stepping.forcing import Forcing

from .energy_gradients import EnergyOutput
from .gradient import Gradient

#: Quantities of scenes that add up over the steps.
SINCE_START = "work", "dissipated_energy"


class _Parts(NamedTuple):
    """What a quantity since the start is the sum of: the signs of energy and of work of loads."""

    energy: int
    loads: int


def _parts(model: Model, quantity: str) -> _Parts:
    if quantity == "work":
        return _Parts(1, 0) if _other_work(model) else _Parts(0, 1)
    return _Parts(-1, 1) if model.forms.dissipate else _Parts(0, 0)


def _other_work(model: Model) -> str:
    """What else than dead loads does work; empty for nothing."""
    forms = model.forms
    others = {
        "prescribed motions or motors": model.couplings.driven,
        "natural strains": model.natural,
        "added virtual works or follower forces": forms.has_added,
        "parameters of stored energies that vary": forms.parameters.in_energies,
    }
    return ", ".join(name for name, there in others.items() if there)


def sums_steps(model: Model, output: Output) -> bool:
    """Whether an output is a sum over all steps before."""
    return output.quantity in SINCE_START and bool(_parts(model, output.quantity).loads)


def check_work(model: Model, tape: Tape, output: Output, name: str, rests: bool) -> None:
    """Refuse work and dissipated energy that are neither sums over steps nor given by a balance.

    And those of a motion that starts from an equilibrium for the same numbers, if it `rests`.
    """
    parts, others, why = _parts(model, output.quantity), _other_work(model), ""
    if model.scheme.rates.at_rest:
        why = "has derivatives in motions only"
    elif rests:
        why = (
            "has no derivatives if each motion starts from an equilibrium of its own, since that "
            "before the motion depends on x as well. Start from a solution"
        )
    elif parts.energy and not model.scheme.balances_energy:
        reason = f"where {others} do work" if output.quantity == "work" else "of all steps"
        why = (
            f"follows from the balance of energy {reason}, which is not exact with "
            f"{model.scheme.name}. Use EnergyMomentum"
        )
    elif others and model.forms.dissipate:
        why = (
            f"has no derivatives where energy is dissipated and {others} do work: the balance "
            'of energy gives only their difference, which fx_beam.Output("total_energy", ...) has'
        )
    elif any(parts) and not tape.is_whole:
        why = "has derivatives only if all steps are in memory. Give Response more memory"
    if why:
        raise SceneError(f"the output {name!r}, {output}, {why}")


class WorkOutput:
    """Work or dissipated energy at the rows (n,) of a run, since its start.

    `energy` makes the total energy at the rows, or (True) at the start of the run; `loads` the work
    of dead loads at the rows.
    """

    def __init__(
        self,
        model: Model,
        quantity: str,
        energy: Callable[[bool], EnergyOutput],
        loads: Callable[[], LoadWork],
    ):
        self._at_start = f"{quantity} at the start"
        parts = _parts(model, quantity)
        self._sign = parts.energy
        self._energies = (energy(False), energy(True)) if parts.energy else None
        self._loads = loads() if parts.loads else None

    def pull(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the quantity."""
        to.add_number(self._at_start, 0, float(weights.sum()))
        if self._energies is not None:
            at_rows, at_start = self._energies
            at_rows.pull(self._sign * weights, to)
            at_start.pull(np.array([-self._sign * weights.sum()]), to)
        if self._loads is not None:
            self._loads.pull(weights, to)

    def push(
        self, rows: int, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (rows, m) from those of the states and of the numbers of the scene."""
        found = np.tile(changes[self._at_start].ravel(), (rows, 1))
        if self._energies is not None:
            at_rows, at_start = self._energies
            found += self._sign * at_rows.push(rows, of_state, changes)
            found -= self._sign * at_start.push(1, of_state, changes)
        if self._loads is not None:
            found += self._loads.push(of_state["q"], changes)
        return found


class LoadWork:
    """Work of dead loads before some sub-steps `ends` (n,): the sum of F . w over those before.

    F are the means of the loads at both ends of a sub-step, w its work increments. `q` (k + 1,
    size) are all displacements before the first k sub-steps, and after them.
    """

    def __init__(self, model: Model, tape: Tape, q: np.ndarray, ends: np.ndarray):
        self._ends, self._steps, self._all_steps = ends, len(q) - 1, len(tape)
        own, columns = slice(self._steps), model.loads.columns
        t0 = tape.starts[own]
        #: Means (k, loads) of the factors of the loads.
        self._factors = Forcing(model).loads(t0, t0 + tape.lengths[own]).mean(axis=1)
        rates, turns = model.scheme.rates, model.turns
        each = [rates.work_increment(D, turns) for D in np.diff(q, axis=0)]
        path, slope = np.array(each).reshape(-1, 2, q.shape[1]).swapaxes(0, 1)
        #: Works (k, loads) of the unit loads, and increments (k, n) at the entries of the columns.
        self._unit_works = (columns.T @ path.T).T
        self._at_entries = path[:, columns.indices]
        self._of_entry = np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr))
        #: Derivatives (k, size) of the work in each sub-step by its increments.
        self._by_increments = (columns @ self._factors.T).T * slope

    def pull(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the work."""
        at_ends = np.bincount(self._ends, weights, self._steps + 1)
        later = at_ends[::-1].cumsum()[::-1][1:, None]
        to.at("q")[1:] += later * self._by_increments
        to.at("q")[:-1] -= later * self._by_increments
        by_loads = np.zeros((self._all_steps, 2, self._factors.shape[1]))
        by_loads[: self._steps] = (later * self._unit_works / 2)[:, None]
        to.add_numbers("loads", by_loads)
        factors = (later * self._factors)[:, self._of_entry]
        to.add_numbers("columns", (factors * self._at_entries).sum(axis=0))

    def push(self, by_q: np.ndarray, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """Changes (n, m) from those of the displacements (k + 1, m, size) and of the loads."""
        of_steps = np.einsum("kmi,ki->km", np.diff(by_q, axis=0), self._by_increments)
        factors = changes["loads"][:, : self._steps].mean(axis=2)
        of_steps += np.einsum("mkl,kl->km", factors, self._unit_works)
        of_steps += (self._factors[:, self._of_entry] * self._at_entries) @ changes["columns"].T
        sums = np.concatenate([np.zeros((1, of_steps.shape[1])), of_steps.cumsum(axis=0)])
        return sums[self._ends]
