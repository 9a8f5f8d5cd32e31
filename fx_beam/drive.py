"""What drives a model: dead loads, prescribed motions and motors as functions of time."""

from __future__ import annotations

import numpy as np

from .beam import COMPONENTS
from .errors import SceneError
from .model import Model
from .state import State
from .values import evaluate


class Drive:
    """Dead loads and driven motions over time.

    Parameters
    ----------
    model : Model
        The compiled scene.
    """

    def __init__(self, model: Model):
        self.model = model
        scene = model.scene
        self._driven = [
            (function, f"prescribed {COMPONENTS[component]} of {scene.nodes[node]}")
            for (node, component), function in scene.prescribed.items()
        ]
        self._driven += [
            (getattr(joint, name).motor, f"motor of {joint}") for joint, name in model.motors
        ]

    def forces(self, t0: float, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Dead forces (size,) at the start and at the end of a step, weight included [N, N m].

        Both are taken just inside the step: a load that jumps from one step to the next belongs
        to the one in which it acts, whichever way its function rounds.
        """
        inset = max(1e-12 * (t1 - t0), 4 * np.spacing(t1))
        before, after = (self._dead(t) for t in (t0 + inset, t1 - inset))
        return before, after

    def places(self, t: float) -> np.ndarray:
        """Where prescribed motions and motors are at a time, (driven,) [m, rad]."""
        return np.array([evaluate(function, t, what)[0] for function, what in self._driven])

    def moved(self, state: State) -> np.ndarray:
        """Where they are in a state, (driven,) [m, rad]."""
        return np.concatenate([state.q[self.model.prescribed], state.motors])

    def check_start(self, state: State) -> None:
        """Refuse driven motions that do not start from where the scene is.

        Parameters
        ----------
        state : State
            The start.

        Raises
        ------
        SceneError
            For a motion that would jump.
        """
        places = self.places(state.t)
        for value, place, (_, what) in zip(places, self.moved(state), self._driven, strict=True):
            if abs(value - place) > 1e-12 + 1e-9 * abs(value):
                raise SceneError(
                    f"{what} is {value:g} at t = {state.t:g}, and the scene starts from "
                    f"{place:g}: let it start there"
                )

    def _dead(self, t: float) -> np.ndarray:
        force = self.model.loads.at(t)
        return force if self.model.weight is None else force + self.model.weight
