"""Gears and racks between two joints, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError, check_fields, is_number, is_one_of, real, require

from .beam import Node
from .coordinate import Coordinate, Coulomb, Damper, Friction, Spring, Stop, functions_of
from .joints import Joint, JointKey, NodalMotion, moved_by
from .removal import joint_of
from .sliders import SlidingJoint


class GearTerm(NamedTuple):
    """A coordinate of a joint in the relation of a gear, with its weight."""

    joint: Joint
    #: "rotation" or "slide".
    name: str
    weight: float


@dataclass(frozen=True, eq=False)
class Gear:
    r"""A gear between two joints that turn: angle_b = ratio * angle_a.

    For `Scene.add_joint`. The angle of a joint is psi_b - psi_a of its nodes since the start, so
    that the carrier of a joint may itself move (planetary gears). The relation has no unknown and
    no multiplier, does no work and conserves both momenta. A spring, damper, friction or stop takes
    the place of the relation: it acts on the difference ``angle_b - ratio * angle_a``, as
    stiffness, losses and play of the teeth.

    Parameters
    ----------
    joint_a, joint_b : Joint
        Two joints of the scene that turn: `Revolute` or `PinInSlot`.
    ratio : float
        rho = angle_b / angle_a: -r_a / r_b for two outer wheels with the radii r_a and r_b, or by
        their numbers of teeth; positive for a belt, a chain or an inner wheel.
    spring, damper : Spring, Damper, optional
        On the difference of the angles: a moment on b of `joint_b` [N m/rad, N m s/rad].
    friction : SmoothFriction, optional
        On the difference of the angles. A loss in proportion to the force of the teeth (an
        efficiency) is not available: this force is known only when the step is solved.
    stop : Stop or (lower, upper, stiffness), optional
        Play of the difference [rad], and the stiffness of the teeth [N m/rad].
    driven : {"rotation", "slide"}
        Coordinate of `joint_b`; "slide" for a `Rack`.
    number : int
        Number among the joints of the scene.
    value : float
        Difference of the angles when the gear is made [rad]; without laws each run must start with
        this difference. ``Scene.add_joint(gear, at=solution)`` finds it.

    Raises
    ------
    SceneError
        For joints that do not turn, the same joint twice, or a ratio of zero.

    Notes
    -----
    In a step with the increments Dpsi of rotations a couple does work on 2 tan(Dpsi/2). The moment
    M on b of `joint_b` is therefore multiplied, for each joint, by (Dpsi_b - Dpsi_a) / (2
    tan(Dpsi_b/2) - 2 tan(Dpsi_a/2)): its work is that on the increments of the angles, and the work
    of the gear is zero.

    Examples
    --------
    A rotor J_b turns 5 times as fast as J_a: the slow shaft has the inertia J_a + 5^2 J_b.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> wheels = [scene.add_body((x, 0), mass=1.0, inertia=0.1).centre for x in (0, 1)]
    >>> shafts = [scene.add_joint(fb.Revolute(fb.GROUND, wheel)) for wheel in wheels]
    >>> gear = scene.add_joint(fb.Gear(*shafts, ratio=-5.0))
    >>> motor = scene.add_moment(wheels[0], 2.6)
    >>> motion = fb.simulate(scene, dt=0.01, t_end=0.1)
    >>> print(f"{motion.spin(wheels[0])[-1]:.4f} = {2.6 * 0.1 / (0.1 + 25 * 0.1):.4f} rad/s")
    0.1000 = 0.1000 rad/s
    >>> print(f"{motion.joint(gear).force[-1]:.4f} N m")
    -0.5000 N m
    """

    joint_a: Joint
    joint_b: Joint
    ratio: float = real()
    spring: Spring | None = None
    damper: Damper | None = None
    friction: Friction | None = None
    stop: Stop | None = None
    driven: str = "rotation"
    number: int = -1
    value: float = real(default=0.0)

    def __post_init__(self):
        known = is_one_of(self.driven, ("rotation", "slide"))
        require(known, "Gear: driven", self.driven, "'rotation' or 'slide'")
        name = self._kind
        check_fields(self, name)
        for joint, coordinate in ((self.joint_a, "rotation"), (self.joint_b, self.driven)):
            ok = isinstance(joint, Joint) and not isinstance(joint, SlidingJoint)
            ok = ok and getattr(joint, coordinate) is not None
            does = "turns: a Revolute or a PinInSlot"
            if coordinate == "slide":
                does = "slides along an axis: a Prismatic or a PinInSlot"
            require(ok, name, joint, f"a joint that {does}")
        if self.joint_a is self.joint_b and self.driven == "rotation":
            raise SceneError(f"{name}: both of its joints are {self.joint_a}. Give two joints")
        if self.ratio == 0:
            raise SceneError(f"{name}: the ratio is zero. Hold the joint that is still instead")
        object.__setattr__(self, "stop", self.on.stop)
        if isinstance(self.friction, Coulomb):
            raise SceneError(
                f"{name}: fx_beam.Coulomb needs a normal force, which a gear has not. Use "
                "fx_beam.SmoothFriction, or fx_beam.Coulomb on one of the joints"
            )
        if self.spring is not None and self.spring.internal is not None:
            raise SceneError(f"{name}: its spring has internal variables. Give them to a joint")

    def __repr__(self):
        return f"<{self}>"

    def __str__(self):
        number = "" if self.number < 0 else f"joint {self.number}, "
        return (
            f"{number}{self._kind} of joint {self.joint_a.number} and joint {self.joint_b.number}"
        )

    @property
    def _kind(self) -> str:
        return "Gear" if self.driven == "rotation" else "Rack"

    @property
    def on(self) -> Coordinate:
        """Laws on the difference of the angles."""
        return Coordinate(self.spring, self.damper, None, self.friction, self.stop)

    @property
    def is_ideal(self) -> bool:
        """Whether it is a relation, on which no law acts."""
        return not self.on.acts

    @property
    def terms(self) -> tuple[GearTerm, GearTerm]:
        """The coordinates whose weighted sum is the difference, that of `joint_b` first."""
        other = GearTerm(self.joint_a, "rotation", -self.ratio)
        return GearTerm(self.joint_b, self.driven, 1.0), other

    @property
    def rest(self) -> float:
        """The sum of the terms where the relation holds."""
        return self.value + (self.joint_b.start()[0] if self.driven == "slide" else 0.0)

    @property
    def column(self) -> int:
        """Where rows of forces of joints have its force: 2 as a moment, 0 as a force."""
        return 2 if self.driven == "rotation" else 0

    @property
    def key(self) -> JointKey:
        """Identifier in a scene that has changed, by numbers of joints in the place of nodes."""
        a, b = self.joint_a.number, self.joint_b.number
        place = float(self.ratio), float(self.value)
        return JointKey(self.number, self._kind, a, b, (), place, "")

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes of its joints: a and b of `joint_b`, then of `joint_a`."""
        return self.joint_b.a, self.joint_b.b, self.joint_a.a, self.joint_a.b

    def difference(self, motion: NodalMotion, slides: np.ndarray) -> np.ndarray:
        """The sum of the terms in a motion, less that at rest.

        Parameters
        ----------
        motion : NodalMotion
            Motion of the nodes.
        slides : (n, joints) float
            Slides of all joints [m].

        Returns
        -------
        (n,) float
            The difference [rad or m].
        """
        a, b = self.joint_a, self.joint_b
        place = slides[:, b.number]
        if self.driven == "rotation":
            place = b.kinematics.angle(motion, place)
        return place - self.ratio * a.kinematics.angle(motion, slides[:, a.number]) - self.rest

    def rate(self, motion: NodalMotion, slides: np.ndarray) -> np.ndarray:
        """The rate of the difference.

        Parameters
        ----------
        motion : NodalMotion
            Motion of the nodes.
        slides : (n, joints) float
            Slides of all joints [m].

        Returns
        -------
        (n,) float
            The rate [rad/s or m/s].
        """
        a, b = self.joint_a, self.joint_b
        rate = b.kinematics.spin if self.driven == "rotation" else b.kinematics.rate
        turning = a.kinematics.spin(motion, slides[:, a.number])
        return rate(motion, slides[:, b.number]) - self.ratio * turning


def Rack(joint: Joint, slide: Joint, radius: float) -> Gear:
    """A rack and its pinion: slide = radius * angle, both since the start.

    For `Scene.add_joint`. Slide and angle are those of any two joints, so that a pinion on a cart,
    a belt drive and a ball screw are racks as well. A rack does no work.

    Parameters
    ----------
    joint : Joint
        The joint of the pinion: `Revolute` or `PinInSlot`.
    slide : Joint
        The joint with the slide: `Prismatic` or `PinInSlot`.
    radius : float
        Radius r = slide / angle [m], with the sign of the motion; lead / (2 pi) of a screw.

    Returns
    -------
    Gear
        The rack, for `Scene.add_joint`. A rack takes no laws: for play or stiffness, drive the
        pinion by a wheel and a `Gear` of ratio 1 with these laws.

    Raises
    ------
    SceneError
        For joints that do not turn or slide, or a radius of zero.

    Examples
    --------
    A pinion of radius 0.1 m drives a rack of 5 kg, whose inertia about the pinion is 5 * 0.1^2 =
    0.05 kg m^2.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> pinion = scene.add_body((0, 0), mass=1.0, inertia=0.05).centre
    >>> rack = scene.add_body((0, 0.1), mass=5.0, inertia=0.1).centre
    >>> shaft = scene.add_joint(fb.Revolute(fb.GROUND, pinion))
    >>> guide = scene.add_joint(fb.Prismatic(fb.GROUND, rack, axis=(1, 0)))
    >>> teeth = scene.add_joint(fb.Rack(shaft, guide, radius=-0.1))
    >>> motor = scene.add_moment(pinion, -2.0)
    >>> motion = fb.simulate(scene, dt=0.01, t_end=0.1)
    >>> print(f"{motion.velocity(rack)[-1, 0]:.4f} m/s, {motion.joint(teeth).force[-1]:.2f} N")
    0.2000 m/s, 10.00 N
    """
    require(is_number(radius), "Rack: radius", radius, "a finite number [m]")
    return Gear(joint, slide, radius, driven="slide")


def added_gear(scene, gear: object, solution: object) -> Gear:
    """A gear that a scene has from now on, made at a solution if one is given."""
    if not isinstance(gear, Gear):
        raise SceneError(f"add_joint needs a joint such as fx_beam.Revolute, not {gear!r}")
    gear = replace(gear, number=-1)
    for joint in (gear.joint_a, gear.joint_b):
        joint_of(scene, joint, str(gear))
    if solution is not None:
        moved = {node.number: moved_by(solution, node) for node in gear.nodes}
        motion = NodalMotion(lambda _, node: moved[node.number][:, None], lambda *_: np.zeros(0))
        slides = np.zeros((1, scene.joint_count))
        for joint in (side for side in (gear.joint_a, gear.joint_b) if side.slide is not None):
            slides[:, joint.number] = joint.kinematics.slide(motion, np.zeros(1))
        gear = replace(gear, value=gear.value + float(gear.difference(motion, slides)[0]))
    scene.parameters.add(functions_of(gear.on), str(gear))
    gear = replace(gear, number=scene.joint_count)
    scene.joint_count += 1
    scene.gears.append(gear)
    return gear
