"""Work and dissipated energy as outputs: sums over the steps, or what the balance of energy leaves.

The work of dead loads and driven motions is a sum over the steps, of any scheme. In each step of a
scheme that conserves energy E + dissipated - work stays the same: so what is dissipated follows
from the work, or other works follow from the energy and what is dissipated. Where both are unknown,
or energy is not conserved, what is dissipated is a sum over the steps as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.compiled.tape import Tape
from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.scene.joints import GROUND
from fx_beam.scene.outputs import Output
from fx_beam.stepping.forcing import Forcing
from fx_beam.stepping.full_turns import without_turns

from .energy_gradients import EnergyOutput
from .gradient import Gradient, sums_after, weights_of_steps
from .step_losses import StepLosses, why_no_losses

#: Quantities of scenes that add up over the steps.
SINCE_START = "work", "dissipated_energy"


class _Parts(NamedTuple):
    """What a quantity since the start is the sum of: the signs of energy, work and losses."""

    energy: int = 0
    steps: int = 0
    losses: int = 0


def _parts(model: Model, quantity: str) -> _Parts:
    others, loses = bool(_other_work(model)), model.forms.dissipate
    if quantity == "work":
        return _Parts(energy=1, losses=int(loses)) if others else _Parts(steps=1)
    if not loses:
        return _Parts()
    if model.scheme.balances_energy and not others:
        return _Parts(energy=-1, steps=1)
    return _Parts(losses=1)


def _other_work(model: Model) -> str:
    """What else than dead loads and driven motions does work; empty for nothing."""
    forms = model.forms
    others = {
        "natural strains": model.natural,
        "added virtual works or follower forces": forms.has_added,
        "parameters of stored energies that vary": forms.parameters.in_energies,
    }
    return ", ".join(name for name, there in others.items() if there)


def sums_steps(model: Model, output: Output) -> bool:
    """Whether an output is a sum over all steps before."""
    if output.quantity not in SINCE_START:
        return False
    parts = _parts(model, output.quantity)
    return bool(parts.steps or parts.losses)


def sums_losses(model: Model, output: Output) -> bool:
    """Whether it is a sum of what is lost in these."""
    return output.quantity in SINCE_START and bool(_parts(model, output.quantity).losses)


def fits_rates(model: Model, output: Output) -> bool:
    """Whether rates that fit the joints are in the work: that of driven motions on them."""
    return output.quantity == "work" and bool(model.couplings.driven)


def check_work(model: Model, output: Output, name: str, rests: bool) -> None:
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
        why = (
            f"follows from the balance of energy where {others} do work, which is not exact with "
            f"{model.scheme.name}. Use EnergyMomentum"
        )
    elif parts.losses and (reason := why_no_losses(model)):
        advice = f", as {others} do work" if others else ". Use EnergyMomentum"
        why = f"is the sum of the losses of steps, without derivatives where {reason}{advice}"
    if why:
        raise SceneError(f"the output {name!r}, {output}, {why}")


class WorkOutput:
    """Work or dissipated energy since the start, at the rows (n,) of a run in a part of a tape.

    `energy` makes an energy at the rows by its name, or (True) at the start of the run, and `steps`
    the work of the steps of the part.
    """

    def __init__(
        self,
        model: Model,
        quantity: str,
        is_first: bool,
        energy: Callable[[str, bool], EnergyOutput],
        steps: Callable[[], StepWork],
        losses: Callable[[], StepLosses],
    ):
        parts = _parts(model, quantity)
        #: Energies with their signs, at the rows, and at the start of the run.
        self._at_rows, self._at_start = list[tuple[int, EnergyOutput]](), ""
        self._before: EnergyOutput | None = None
        self._sign = parts.energy
        if parts.energy:
            # Losses are those of the steps, without rates that fit.
            own = "total_energy" if quantity == "work" else "energy of steps"
            self._at_rows.append((parts.energy, energy(own, False)))
        elif quantity == "work" and model.couplings.driven and model.fitted_rates is not None:
            self._at_rows.append((1, energy("work of rates that fit", False)))
        if is_first:
            self._at_start = f"{quantity} at the start"
            self._before = energy("energy of steps", True) if parts.energy else None
        #: Sums over the steps, with their signs.
        self._sums: list[tuple[int, StepWork | StepLosses]] = []
        if parts.steps:
            self._sums.append((parts.steps, steps()))
        if parts.losses:
            self._sums.append((parts.losses, losses()))

    def pull(self, weights: np.ndarray, later: float, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the quantity.

        `later` is the sum of the weights of rows in later parts.
        """
        total = float(weights.sum()) + later
        for sign, energy in self._at_rows:
            energy.pull(sign * weights, to)
        if self._at_start:
            to.add_number(self._at_start, 0, total)
        if self._before is not None:
            self._before.pull(np.array([-self._sign * total]), to)
        for sign, of_steps in self._sums:
            of_steps.pull(sign * weights, sign * later, to)

    def push(
        self,
        rows: int,
        before: np.ndarray,
        of_state: Mapping[str, np.ndarray],
        changes: Mapping[str, np.ndarray],
    ) -> np.ndarray:
        """Changes (rows, m) from those of the states and of the numbers of the scene.

        `before` (m,) is what the parts before have given, to which this one adds.
        """
        if self._at_start:
            before += changes[self._at_start].ravel()
        if self._before is not None:
            before -= self._sign * self._before.push(1, of_state, changes)[0]
        found = np.tile(before, (rows, 1))
        for sign, energy in self._at_rows:
            found += sign * energy.push(rows, of_state, changes)
        for sign, of_steps in self._sums:
            sums = sign * of_steps.push(of_state, changes)
            found += sums[of_steps.ends]
            before += sums[-1]
        return found


class StepWork:
    """Work of dead loads and driven motions in the k sub-steps of a part of a tape.

    It is F . w, with the mean F of the loads at both ends and the path w, and the forces of driven
    columns (k, columns) times their paths. `states` (k + 1, ...) are those before the sub-steps and
    after the last; `ends` (n,) the numbers of sub-steps before the rows.
    """

    def __init__(
        self,
        model: Model,
        tape: Tape,
        states: Mapping[str, np.ndarray],
        forces: np.ndarray,
        ends: np.ndarray,
    ):
        self.ends, part, columns = ends, tape.present, model.loads.columns
        self._own, self._all_steps = slice(*part), len(tape)
        t0 = tape.starts[self._own]
        #: Means (k, loads) of the factors of the loads.
        self._factors = Forcing(model).loads(t0, t0 + tape.lengths[self._own]).mean(axis=1)
        rates, turns = model.scheme.rates, model.turns
        D = without_turns(model, np.diff(states["q"], axis=0))
        each = [rates.work_increment(increment, turns) for increment in D]
        path, slope = np.array(each).reshape(-1, 2, D.shape[1]).swapaxes(0, 1)
        #: Works (k, loads) of the unit loads, and increments (k, n) at the entries of the columns.
        self._unit_works = (columns.T @ path.T).T
        self._at_entries = path[:, columns.indices]
        self._of_entry = np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr))
        #: Paths (k, driven) of driven motions, and derivatives of the work by their increments.
        of_nodes, of_slides = _driven_paths(model)
        driven = forces[:, : model.couplings.driven]
        self._paths = path @ of_nodes.T + np.diff(states["slides"], axis=0) @ of_slides.T
        self._by_slides = driven @ of_slides
        #: Derivatives (k, size) of the work in each sub-step by its increments.
        self._by_increments = ((columns @ self._factors.T).T + driven @ of_nodes) * slope

    def pull(self, weights: np.ndarray, later: float, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the work, and `later` all of it."""
        of_steps = weights_of_steps(self.ends, weights, later, len(self._factors))[:, None]
        for name, own in (("q", self._by_increments), ("slides", self._by_slides)):
            to.at(name)[-len(own) :] += of_steps * own
            to.at(name)[-len(own) - 1 : -1] -= of_steps * own
        if self._paths.size:
            forces = to.at("constraints")
            forces[-len(self._paths) :, : self._paths.shape[1]] += of_steps * self._paths
        by_loads = np.zeros((self._all_steps, 2, self._factors.shape[1]))
        by_loads[self._own] = (of_steps * self._unit_works / 2)[:, None]
        to.add_numbers("loads", by_loads)
        factors = (of_steps * self._factors)[:, self._of_entry]
        to.add_numbers("columns", (factors * self._at_entries).sum(axis=0))

    def push(
        self, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (k + 1, m) of the work before the first sub-steps, and after all of the part."""
        q, slides = (np.diff(of_state[name], axis=0) for name in ("q", "slides"))
        of_steps = np.einsum("kmi,ki->km", q, self._by_increments)
        of_steps += np.einsum("kmi,ki->km", slides, self._by_slides)
        if self._paths.size:
            forces = of_state["constraints"][:, :, : self._paths.shape[1]]
            of_steps += np.einsum("kmi,ki->km", forces, self._paths)
        factors = changes["loads"][:, self._own].mean(axis=2)
        of_steps += np.einsum("mkl,kl->km", factors, self._unit_works)
        of_steps += (self._factors[:, self._of_entry] * self._at_entries) @ changes["columns"].T
        return sums_after(of_steps)


def _driven_paths(model: Model) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
    """Paths of driven motions as sums of those of nodes (driven, size) and slides (driven, n)."""
    driven, joints = model.couplings.driven, model.scene.joint_count
    nodes, slides = np.zeros((driven, model.size)), np.zeros((driven, joints))
    first = len(model.prescribed)
    nodes[np.arange(first), model.prescribed] = 1.0
    for i, (joint, name) in enumerate(model.motors, start=first):
        if name == "slide":
            slides[i, joint.number] = 1.0
            continue
        for node, sign in ((joint.b, 1.0), (joint.a, -1.0)):
            if node is not GROUND:
                nodes[i, model.mesh.dofs[node.number, 2]] += sign
    return scipy.sparse.csr_matrix(nodes), scipy.sparse.csr_matrix(slides)
