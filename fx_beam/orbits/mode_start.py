"""States at rest, displaced by a mode from an equilibrium: where periodic motions begin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval
from fx_beam.linear.equilibrium_check import check_equilibrium
from fx_beam.linear.linearisation import linearised
from fx_beam.linear.undamped_modes import first_of_largest, lowest
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.validation import is_whole, require

from .closing import Condition
from .shooting import Directions, Period, Shooting

# Smallest part of a displacement in a mode that moves nodes, in units of the scene.
_MOVES = 1e-6


class ModeStart(NamedTuple):
    """A mode about an equilibrium."""

    shooting: Shooting
    rest: State
    #: Its period [s] for small amplitudes, and its vector (free,).
    period: float
    vector: np.ndarray
    #: The degree of freedom that moves most, of which the vector has 1.
    most: int

    def state(self, amplitude: float) -> State:
        """The state at rest with an amplitude [m or rad] of this degree of freedom."""
        model, reduction = self.shooting.model, self.shooting.model.reduction
        y = amplitude * self.vector
        reduction.begin(self.rest.q, self.rest.slides)
        q = self.rest.q + reduction.expand(y, np.zeros(reduction.driven))
        slides = model.couplings.free_slides(y, model.scene.joint_count)
        return self.rest.changed(q=q, slides=self.rest.slides + slides)

    def holds(self, amplitude: float) -> Condition:
        """That the start has an amplitude."""
        unit = self.shooting.model.unit[self.most]

        def error(period: Period) -> float:
            return float(period.start.q[self.most] - self.rest.q[self.most] - amplitude) / unit

        def slopes(period: Period, by: Directions) -> np.ndarray:
            return np.append(by.changes["q"][:, self.most], 0.0) / unit

        return Condition(error, slopes)


def mode_start(shooting: Shooting, scene: Scene, state: Solution | None, mode: int) -> ModeStart:
    """A mode of a scene about an equilibrium, by default its reference configuration."""
    what = shooting.what
    require(is_whole(mode, 0), f"{what}: mode", mode, "the number of a mode, from 0 on")
    shooting.check_free()
    if shooting.depends_on_time(shooting.first_state(state, 1.0 / shooting.steps), 1.0):
        raise SceneError(
            f"{what}: loads, motors or parameters depend on time, so that the motion is forced: it "
            "has their period. Give period=, without a mode"
        )
    if state is None and shooting.setup.forcing.forces(Interval(0.0, 0.0))[0].any():
        raise SceneError(
            f"{what}: the scene has loads. Give the equilibrium about which the mode vibrates, "
            "such as state=fx_beam.static(scene)"
        )
    about = linearised(scene, state, what)
    check_equilibrium(about, state, what)
    omega, rigid, vectors = lowest(about.K, about.M, mode + 1)
    if mode >= len(omega) or rigid[mode] or omega[mode] <= 0:
        raise SceneError(
            f"{what}: mode {mode} does not vibrate: fx_beam.modes(scene) shows which do"
        )
    shape = about.model.to_nodes(about.T @ vectors[:, mode])
    slides = np.zeros(about.model.scene.joint_count)
    for joint in about.model.scene.joints:
        if joint.slide is not None:
            row = about.columns[about.model.couplings.slides[joint.number]]
            slides[joint.number] = (row @ vectors[:, mode]).item()
    model = shooting.model
    period = 2 * np.pi / float(omega[mode])
    rest = shooting.first_state(state, period / shooting.steps)
    rest = rest.changed(v=0 * rest.v, a=0 * rest.a)
    moved = model.from_nodes(shape)
    sizes = abs(moved / model.unit)
    sizes[model.turns] *= _MOVES  # rotations count if nothing else moves
    most = first_of_largest(sizes)
    vector = model.couplings.unknowns(moved, slides) / moved[most]
    return ModeStart(shooting, rest, period, vector, most)
