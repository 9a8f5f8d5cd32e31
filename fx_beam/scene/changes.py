"""Changes of a scene in a motion: latches that close, and joints that break."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fx_beam.errors import LARGEST, SceneError, between, check_fields, real, require

from .joints import Joint
from .outputs import Output
from .removal import joint_of, locked


@dataclass(frozen=True)
class Latch:
    """A latch that closes when a joint reaches a value, and holds the joint there from then on.

    For the `changes` of `simulate`. Velocities are projected by the mass, as in a plastic impact:
    `Energy.impact` is the energy that is lost. The force of the latch is `JointMotion.motor_force`.

    A joint that starts at this value is not caught at the start, but when it returns; `Scene.lock`
    holds a joint from the start. Of several latches of a joint only the one that is reached first
    closes; the others then have no effect.

    Parameters
    ----------
    joint : Joint
        A joint of the scene with a slide or a relative rotation that no motor drives.
    at : float
        The slide [m] or relative rotation [rad], reached from either side.
    coordinate : {"slide", "rotation"}, optional
        The coordinate to be held, for joints that have both.

    Raises
    ------
    SceneError
        If `joint` is no joint, or `at` no finite number.

    Examples
    --------
    Two masses that move apart on a guide, until they are 1.5 m from each other.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> one, other = (scene.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
    >>> guide = scene.add_joint(fb.Prismatic(one, other, axis=(1, 0)))
    >>> scene.set_velocity(other, (0.6, 0.0))
    >>> latch = {"latch": fb.Latch(guide, 1.5)}
    >>> solution = fb.simulate(scene, dt=0.1, t_end=2.0, changes=latch)
    >>> print(f"{solution.stats.changes['latch']:.6f} s, {solution.energy.impact[-1]:.6f} J")
    0.833333 s, 0.180000 J
    """

    joint: Joint
    at: float = between(-LARGEST, LARGEST, "a finite number")
    coordinate: str | None = None

    def __post_init__(self):
        require(isinstance(self.joint, Joint), "Latch: joint", self.joint, "a joint of the scene")
        check_fields(self)


@dataclass(frozen=True)
class Fuse:
    """A joint that breaks when its force reaches a limit; it is then removed.

    For the `changes` of `simulate`. The force is the mean over a step. The joint breaks at the end
    of the step in which the force reaches the limit. Impulses of impacts in an instant
    (`Energy.impact`) do not count.

    Parameters
    ----------
    joint : Joint
        A joint of the scene.
    force : float
        Largest magnitude of the force of the joint [N].

    Raises
    ------
    SceneError
        If `joint` is no joint, or the force not positive.

    Examples
    --------
    A growing force pulls two equal masses. The joint between them carries half of it.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> one, other = (scene.add_body((x, 0), mass=2.0, inertia=0.1).centre for x in (0, 1))
    >>> joint = scene.add_joint(fb.Rigid(one, other, offset=(1, 0)))
    >>> load = scene.add_force(other, lambda t: (10.0 * t, 0.0))
    >>> breaks = {"fuse": fb.Fuse(joint, 4.01)}
    >>> solution = fb.simulate(scene, dt=0.01, t_end=1.0, changes=breaks)
    >>> print(f"{solution.stats.changes['fuse']:.3f} s")
    0.802 s
    """

    joint: Joint
    force: float = real("positive")

    def __post_init__(self):
        require(isinstance(self.joint, Joint), "Fuse: joint", self.joint, "a joint of the scene")
        check_fields(self)


def checked_changes(scene, changes: Mapping[str, Latch | Fuse]) -> dict[str, Latch | Fuse]:
    """Latches and fuses by their names; SceneError if they are none, or do not fit the scene."""
    ok = isinstance(changes, Mapping) and all(isinstance(name, str) for name in changes)
    ok = ok and all(isinstance(change, Latch | Fuse) for change in changes.values())
    expected = "a dictionary of fx_beam.Latch and fx_beam.Fuse by names"
    require(ok, "simulate: changes", changes, expected)
    coordinates: dict[tuple[int, str, float], str] = {}
    for name, change in changes.items():
        subject = f"simulate: changes[{name!r}]"
        joint = joint_of(scene, change.joint, f"{subject}: joint")
        if isinstance(change, Latch):
            try:
                locked(joint, change.coordinate)
            except SceneError as reason:
                raise SceneError(f"{subject}: {reason}") from None
        limit = change.at if isinstance(change, Latch) else change.force
        key = change.joint.number, output_of(change).quantity, limit
        if key in coordinates:
            raise SceneError(
                f"simulate: changes[{coordinates[key]!r}] and changes[{name!r}] are the same "
                f"{type(change).__name__.lower()} of {change.joint}. Omit one of them"
            )
        coordinates[key] = name
    return dict(changes)


def is_over(change: Latch | Fuse, done: Latch | Fuse) -> bool:
    """Whether a change cannot happen after another one: a fuse of its joint, or its own latch."""
    same_joint = change.joint.number == done.joint.number
    return same_joint and (isinstance(done, Fuse) or output_of(change) == output_of(done))


def output_of(change: Latch | Fuse) -> Output:
    """The slide or angle of a latch, the force (3,) of a fuse."""
    if isinstance(change, Fuse):
        return Output("force", change.joint)
    joint = change.joint
    slides = change.coordinate == "slide" or joint.rotation is None or joint.on_beam
    return Output("slide" if slides else "angle", joint)


def excess(change: Latch | Fuse, measured) -> float:
    """How far the measured output of a change is beyond the limit [m, rad or N]."""
    if isinstance(change, Fuse):
        return math.hypot(measured[0], measured[1]) - change.force
    return measured - change.at
