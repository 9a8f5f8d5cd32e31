"""The record of a simulation, kept also when the run breaks off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .audit import Energy
from .errors import SceneError
from .model import Model
from .state import State


@dataclass(frozen=True)
class Record:
    """What is kept of a simulation; energies, momenta and slides always are.

    Parameters
    ----------
    every : int
        Steps between two rows; the start and the last step are always kept.
    motion : bool
        Whether to keep displacements and rotations, which stress resultants need as well.
    rates : bool
        Whether to keep velocities and accelerations.
    forces : bool
        Whether to keep the forces of supports and joints.
    """

    every: int = 1
    motion: bool = True
    rates: bool = True
    forces: bool = True

    def __post_init__(self):
        if not isinstance(self.every, int | np.integer) or self.every < 1:
            raise SceneError(f"Record: every = {self.every!r} must be a positive whole number")


class Recorder:
    """Histories of motion, forces, energies and momenta.

    Parameters
    ----------
    model : Model
        The compiled scene.
    times : (n,) float
        Times of the grid [s].
    record : Record
        What is kept.
    """

    def __init__(self, model: Model, times: np.ndarray, record: Record):
        self.model, self.every, self.last = model, record.every, len(times) - 1
        steps = np.union1d(np.arange(0, len(times), record.every), [self.last])
        self._times = times
        self._steps = steps
        self.rows = 0
        n, size, joints = len(steps), model.size, len(model.scene.joints)
        held = model.reduction.columns - model.reduction.free
        #: Rows (n, ...) by name, vectors in the order of the degrees of freedom.
        self.arrays = {"energies": np.zeros((n, 4)), "momenta": np.zeros((n, 3))}
        if joints:
            self.arrays["slides"] = np.zeros((n, joints))
        if record.motion:
            self.arrays["q"] = np.zeros((n, size))
            if record.every > 1:
                self.arrays["before"] = np.zeros((n, size))
        if record.rates:
            self.arrays |= {"v": np.zeros((n, size)), "a": np.zeros((n, size))}
        if record.forces:
            self.arrays["held"] = np.zeros((n, held))
            if joints:
                self.arrays["joint_forces"] = np.zeros((n, 3 * joints))

    def _wants(self, step: int) -> bool:
        return step % self.every == 0 or step == self.last

    def begin(self, step: int, q: np.ndarray) -> None:
        """Keep the start of a step, if it is wanted.

        Parameters
        ----------
        step : int
            Its number.
        q : (size,) float
            Displacements and rotations.
        """
        if "before" in self.arrays and self._wants(step):
            self.arrays["before"][self.rows] = q

    def record(self, step: int, state: State) -> None:
        """Add a state that was computed here and not in the compiled loop, if it is wanted.

        Parameters
        ----------
        step : int
            Number of the step that ends with it; 0 for the start.
        state : State
            The system at a time of the grid.
        """
        if not self._wants(step):
            return
        model = self.model
        momentum = state.v if model.scheme.rates.at_rest else model.mass @ state.v
        q, p = model.to_nodes(state.q), model.to_nodes(momentum)
        x = model.mesh.X + q[:, :2]
        potential = 0.0 if model.weight is None else -(model.weight @ state.q)
        strain = model.forms.strain_energy(state.q)
        strain += model.actuators.energy(state.q, state.slides)
        angular = x[:, 0] @ p[:, 1] - x[:, 1] @ p[:, 0] + p[:, 2].sum()
        values: dict[str, Any] = {
            "q": state.q,
            "v": state.v,
            "a": state.a,
            "held": state.held,
            "slides": state.slides,
            "joint_forces": state.joint_forces,
            "energies": (state.v @ momentum / 2, strain, potential, state.work),
            "momenta": (*p[:, :2].sum(axis=0), angular),
        }
        for name, rows in self.arrays.items():
            if values.get(name) is not None:
                rows[self.rows] = np.ravel(values[name])
        self.rows += 1

    def wind(self, first: int, taken: np.ndarray) -> None:
        """Add to the rows from one on the turns (size,) that were taken off while they were made.

        Parameters
        ----------
        first : int
            Number of that row.
        taken : (size,) float
            Rotations [rad].
        """
        for name in ("q", "before"):
            if name in self.arrays:
                self.arrays[name][first : self.rows] += taken

    def histories(self) -> dict:
        """What was recorded, by the names that `Solution` gives it; empty where it was not."""
        model, n = self.model, self.rows
        kept = {name: rows[:n] for name, rows in self.arrays.items()}
        joints, nodes = len(model.scene.joints), len(model.mesh.X)
        none = np.empty((0, nodes, 3))

        def at_nodes(name):
            return kept[name][:, model.mesh.dofs] if name in kept else none

        reactions = none
        if "held" in kept:
            reactions = np.zeros((n, nodes, 3))
            supported, components, places = model.supports
            reactions[:, supported, components] = kept["held"][:, places]
        forces = kept.get("joint_forces", np.empty((0 if "held" not in kept else n, 3 * joints)))
        t = self._times[self._steps[:n]]
        return {
            "t": t,
            "t_level": t - (1 - model.scheme.rates.level) * (t - self._times_before()),
            "q": at_nodes("q"),
            "v": at_nodes("v"),
            "a": at_nodes("a"),
            "reactions": reactions,
            "slides": kept.get("slides", np.empty((n, 0))),
            "joint_forces": forces.reshape(len(forces), joints, 3),
            "energy": Energy(*kept["energies"].T),
            "linear_momentum": kept["momenta"][:, :2],
            "angular_momentum": kept["momenta"][:, 2],
        }

    def _times_before(self) -> np.ndarray:
        """Times (n,) one step of the grid before each row; the start for row 0."""
        return self._times[np.maximum(self._steps[: self.rows] - 1, 0)]

    def steps_before(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (n,) and displacements (n, size) one step before each row; the start for row 0."""
        n = self.rows
        before = self.arrays.get("before")
        if before is None:
            q = self.arrays["q"][:n]
            before = np.vstack([q[:1], q[:-1]])
        return self._times_before(), before[:n]
