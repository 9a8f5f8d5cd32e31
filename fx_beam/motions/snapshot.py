"""All on which the next steps of a motion depend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.step.model import Model


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Everything that the next steps of a motion depend on; made by `Motion.snapshot`.

    Parameters
    ----------
    t : float
        Its time [s].
    state : State
        The state, in the numbering of the model, for internal use.
    step : (float, int)
        Time at the start of the count of steps [s], and their number.
    turns : (size,) float
        Full turns that are counted separately [rad].
    dofs : (n_node, 3) int
        The numbering of the model.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
    >>> arm = scene.add_beam([(0, 0), (1, 0)], section)
    >>> fb.Motion(scene, dt=0.1).snapshot().t
    0.0
    """

    t: float
    state: State
    step: tuple[float, int]
    turns: np.ndarray
    dofs: np.ndarray

    def check(self, model: Model, inputs: int) -> None:
        """Refuse the snapshot for another model.

        Parameters
        ----------
        model : Model
            The model of a motion.
        inputs : int
            Number of values of its inputs.

        Raises
        ------
        SceneError
            If nodes, joints, motors or inputs differ.
        """
        state = self.state
        given = 0 if state.inputs is None else len(state.inputs)
        theirs = len(state.slides), len(state.motors), given
        ours = model.scene.joint_count, len(model.motors), inputs
        if not np.array_equal(self.dofs, model.mesh.dofs) or ours != theirs:
            raise SceneError(
                "Motion.restore: the snapshot is of another scene. Its nodes, joints, motors and "
                "inputs must be the same"
            )
