"""Derivatives of the states of a load path by the numbers of its scene."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fx_beam.dual import Dual, MaybeDual, floats
from fx_beam.equilibria.statics import LoadPath
from fx_beam.errors import SceneError
from fx_beam.fem.scene_data import SceneArrays
from fx_beam.motions.initial_state import reference_state
from fx_beam.motions.numbers import static_numbers_of
from fx_beam.results.state import State
from fx_beam.scene.inputs import with_functions
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene
from fx_beam.step.model import data_of, fact, sizes_of
from fx_beam.step.tables import problem_of
from fx_beam.step.tangent_storage import ProblemKind
from fx_beam.step.tape import static_tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .built_scenes import NumbersOf, refuse_others
from .energy_outputs import why_no_losses, why_no_work
from .observation import Observation

#: Derivatives (m, ...) by x of numbers of scenes.
DerivativesOf = Callable[[NumbersOf], dict[str, np.ndarray]]
# Internal variables that round-off may leave at a contact without a force.
_ROUNDING = 1e-12


def why_not(path: LoadPath) -> str:
    """Why a path has no derivatives; empty if it has."""
    model, first = path.model, path.states[0]
    if path.forcing.turning is not None:
        return "a frame that turns (spin) has none"
    if not path.from_rest and model.kinks.flows:
        return "parts with internal variables that start from another solution have none"
    if path.mechanism and model.kinks.flows:
        return (
            "a mechanism that its loads hold, with internal variables, has none: these depend on "
            "how it settles"
        )
    variables = [values for values in (first.internal, first.spring_internal) if values is not None]
    if first.spring_internal is not None:  # forces that friction follows are no states
        variables[-1] = np.delete(first.spring_internal, model.points.normal_forces)
    if any(abs(values).max(initial=0.0) > _ROUNDING for values in variables):
        return "springs are under tension, and change internal variables before the loads act"
    return ""


def why_no_sums(path: LoadPath | None) -> dict[str, str]:
    """Why work and losses of a motion have no derivatives if it starts from a path, by quantity."""
    if path is None or why_not(path):  # nothing came before, or differences have it
        return {}
    model = path.model
    reasons = {"work": why_no_work(model)}
    if model.forms.dissipate:
        lossless = why_no_losses(model)
        reasons["dissipated_energy"] = lossless and f"where {lossless}"
    if not path.from_rest:
        reasons = {quantity: "if it began at another solution" for quantity in reasons}
    refusal = "has no derivatives since the equilibrium from which each motion starts has none"
    return {quantity: f"{refusal} {reason}" for quantity, reason in reasons.items() if reason}


class StaticDerivatives:
    """The load steps of a path on a tape, and their derivatives."""

    def __init__(self, path: LoadPath):
        if reason := why_not(path):
            raise SceneError(f"the equilibria have no derivatives: {reason}")
        self.path, self.model = path, (model := path.model)
        #: The states that are followed. Of what began at another solution these are the last alone,
        #: which is an equilibrium of this scene whatever it began from.
        self.states, start = path.states, reference_state(model)
        if not path.from_rest:
            start, self.states = path.states[-2], path.states[-1:]
        self.factors = np.array([state.t for state in self.states])
        problem = problem_of(model, ProblemKind())
        holding_forces = path.held if path.from_rest else 0 * path.held
        if holding_forces.any():
            problem.set(work={"statics": {"holds": model.reduction.free}})
        self.derivatives = TapeDerivatives(problem)
        self.tape = static_tape(problem, start, self.states, path.forcing)
        if holding_forces.any():
            self.tape.hold = (1 - self.factors)[:, None] * holding_forces

    def numbers_of(self, scene: Scene, change: MaybeDual) -> dict[str, MaybeDual]:
        """The numbers of these load steps for another scene; OtherStructureError if it differs."""
        return self._numbers_at(self.factors, scene, change)

    def _numbers_at(
        self, factors: np.ndarray, scene: Scene, change: MaybeDual
    ) -> dict[str, MaybeDual]:
        scene = with_functions(scene, self.path.options.inputs, "static: inputs")
        data = data_of(self.model, scene)
        return static_numbers_of(self.model, data, self.path.forcing.time, factors)

    def changes(self, derivatives: DerivativesOf) -> dict[str, np.ndarray]:
        """Changes (m, ...) of all numbers with x, by `derivatives` of the numbers of scenes."""
        if self.tape.hold is None:
            return derivatives(self.numbers_of)
        # What holds the springs is what is left without it in the reference.
        first, problem = self.states[0], self.derivatives.problem
        tape = static_tape(problem, first, [first], self.path.forcing)
        at_rest = derivatives(functools.partial(self._numbers_at, np.zeros(1)))
        rows, shares = np.zeros(1, dtype=int), np.ones(1)
        held_forces, _ = self.derivatives.jvp_of_equations(tape, at_rest, None, rows, shares)
        hold = (1 - self.factors)[None, :, None] * held_forces[0][:, None]
        return derivatives(self.numbers_of) | {"hold": hold}

    def change_of_end(
        self, derivatives: DerivativesOf, name: str, pulls: Sequence[Measured] = ()
    ) -> StateChange:
        """Changes of the last state with x, by `derivatives` of the numbers of scenes.

        With those of some `pulls` of lines.
        """
        changes = self.changes(derivatives)
        refuse_others(changes, self.derivatives.names, name)
        boundaries = np.arange(len(self.tape) + 1)
        rows = self.derivatives.jvp(self.tape, changes, boundaries, boundaries[:-1])
        names = {"q": "q", "slides": "slides"}
        names |= {"constraint_forces": "constraints", "joint_forces": "joints"}
        at_end = {name: rows[array][-1] for name, array in names.items()}
        count, sums = len(changes["X"]), self._summed()
        outputs = {str(pull.place.number): pull for pull in pulls}
        outputs |= {name: Measured(Output(name, self.model.scene)) for name in sums}
        forces = functools.partial(self.derivatives.constraint_forces, self.tape)
        last = boundaries[-1:]
        observed = Observation(self.model, self.tape, forces, {}, True, {}, outputs, last)
        for name, values in rows.items():
            is_force = name in ("constraints", "joints")
            rows[name] = values[observed.sub_steps if is_force else observed.boundaries]
        outputs_at_end = observed.jvp(rows, changes, {name: np.zeros(count) for name in sums})
        at_end["line_forces"] = np.zeros((count, fact(self.model, sizes_of)["lines"]))
        for pull in pulls:
            number = pull.place.number
            at_end["line_forces"][:, number] = outputs_at_end[str(number)][0]
        for name in sums:
            at_end[name.removesuffix("_energy")] = outputs_at_end[name][0]
        return StateChange(self, at_end | self.derivatives.at_end)

    def _summed(self) -> list[str]:
        """The outputs with derivatives that add up over the load steps."""
        names, model = list[str](), self.model
        if self.path.from_rest and not why_no_work(model):
            names.append("work")
        if self.path.from_rest and model.forms.dissipate and not why_no_losses(model):
            names.append("dissipated_energy")
        return names


class StateChange:
    """Changes (m, ...) of an equilibrium, from which a motion starts."""

    def __init__(self, derivatives: StaticDerivatives, changes: dict[str, np.ndarray]):
        self._path, self._state, self._changes = derivatives.path, derivatives.states[-1], changes
        #: Those of the configuration (m, size).
        self.node_changes = changes["q"]

    def equilibrium_at(self, data: SceneArrays, change: MaybeDual) -> State:
        """The equilibrium with a change of the numbers (m,), for those of a scene.

        It has slopes if the change has.
        """
        moved = {
            name: values
            + (change @ self._changes[name].reshape(len(change), -1)).reshape(np.shape(values))
            for name in self._changes
            if (values := getattr(self._state, name)) is not None
        }
        if data.natural:
            natural = data.natural.numbers_at(self._path.forcing.time)
            moved["natural"] = natural if isinstance(change, Dual) else floats(natural)
        return replace(self._state, t=self._path.forcing.time, parameters=None, **moved)
