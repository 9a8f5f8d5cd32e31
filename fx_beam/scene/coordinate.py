"""Springs, dampers, friction, stops and motors on coordinates of joints."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from fx_beam.errors import IS_DATA, SceneError, check_fields, finite, is_number, real, require
from fx_beam.symbolic import Expr, parts_of, ufl

from .functions import Input, Numbers, Signal, time_function
from .law import Energy, InternalVariables, check_energy, functions_of_energy
from .parameters import is_parameter, scalar_of, value_of

# With less a contact opens without a force, and Newton's method has no slope: of 1000 steps of an
# elastic ring on a plane 94 had to be halved with 0, none with 0.02.
_LEAST = 0.02
# Rates at which laws of a user are looked at.
_RATES = [sign * 10.0**k for k in range(-6, 5) for sign in (1, -1)]


class OneSided:
    """A stop or a contact: it resists on one side alone, with a loss."""

    restitution: float
    speed: float | None

    @property
    def loss(self) -> float:
        """Dissipative part of the force, r = (1 - e^2) / (1 + e^2), relative to the elastic part.

        The forces out and in have the ratio e^2.
        """
        e = max(self.restitution, _LEAST)
        return (1 - e**2) / (1 + e**2)

    def _check_impact(self, name: str) -> None:
        """Check the fields; SceneError for losses that are out of range."""
        check_fields(self, name)
        e = self.restitution
        require(e <= 1, f"{name}: restitution", e, "a number from 0 to 1")
        if self.speed is None and e < 1:
            raise SceneError(
                f"{name}: a restitution below 1 needs a speed, the rate below which the loss is "
                "viscous. Try a hundredth of the speed of the impacts"
            )


@dataclass(frozen=True)
class Stop(OneSided):
    """Stops at one or both ends of a joint's free coordinate x: one-sided springs.

    Beyond a limit by d, the force is k d (1 + r tanh(rate of d / speed)), with r = (1 - e^2) /
    (1 + e^2). The energy k d^2 / 2 is stored, and after a fast impact the part e^2 of it is
    returned. With e = 1 all of it is returned, exactly, in each scheme that conserves energy.

    Parameters
    ----------
    lower, upper : float or None
        Limits of the slide [m] or of the relative rotation [rad]; None for no stop at this end.
        The coordinate starts between them.
    stiffness : float
        Stiffness k [N/m or N m/rad]. With e = 1 a mass m with the speed v goes beyond the limit by
        v sqrt(m / k), and returns after the time pi sqrt(m / k).
    restitution : float
        Coefficient of restitution e from 0 to 1: the speed after an impact, relative to the speed v
        before it; values below 0.02 are taken as 0.02. It holds for v far above `speed`: the square
        of the ratio of the speeds is e^2 + c (speed / v)^2, with c = 0.16, 0.98, 3.3 for e = 0.9,
        0.5, 0.2.
    speed : float, optional
        Rate [m/s or rad/s] below which the loss is viscous; required for e < 1. Try a hundredth of
        the speed of the impacts. At rest the force is k d, without a loss.

    Raises
    ------
    SceneError
        If both limits are None, for a lower limit above the upper one, or for a value out of range.

    Examples
    --------
    A slide that starts at 0, with a stop at 0.5 m that returns the energy of the block.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> block = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    >>> stop = fb.Stop(None, 0.5, stiffness=1e4)
    >>> rail = scene.add_joint(fb.Prismatic(fb.GROUND, block.start, axis=(1, 0), stop=stop))
    >>> scene.set_velocity(block, (2.0, 0.0))
    >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    >>> bool(solution.joint(rail).slide.max() < 0.53), bool(solution.joint(rail).slide[-1] < 0.1)
    (True, True)
    >>> bool(abs(solution.energy.balance_error).max() < 1e-11)
    True
    """

    lower: float | None = real(optional=True)
    upper: float | None = real(optional=True)
    stiffness: float = real("positive")
    restitution: float = real("not negative", default=1.0)
    speed: float | None = real("positive", optional=True, default=None)

    def __post_init__(self):
        _refuse_functions(self, ("lower", "upper", "stiffness"), _IN_ENERGY)
        self._check_impact("Stop")
        if self.lower is None and self.upper is None:
            raise SceneError("Stop: give a lower limit, an upper limit or both")
        if self.lower is not None and self.upper is not None:
            expected = f"below upper = {self.upper!r}; the order is (lower, upper, stiffness)"
            require(self.lower < self.upper, "Stop: lower", self.lower, expected)

    def check_start(self, place: float, tolerance: float, what: str, more: str = "") -> None:
        """Refuse a start of the coordinate beyond a limit.

        Parameters
        ----------
        place : float
            The start [m or rad].
        tolerance : float
            How far it may be beyond [m or rad].
        what : str
            Name of the coordinate in the message.
        more : str
            What else to try.

        Raises
        ------
        SceneError
            With the limit.
        """
        for name, limit, sign in (("lower", self.lower, -1.0), ("upper", self.upper, 1.0)):
            if limit is not None and sign * (place - limit) > tolerance:
                raise SceneError(
                    f"{what} starts at {place:.6g}, beyond the {name} limit {limit:.6g} of its "
                    f"stop. Move the limit{more}"
                )


# Where what changes in time is given.
_IN_ENERGY = (
    "a strain_energy, such as Spring(strain_energy=lambda x: k / 2 * (x - rest) ** 2) with "
    "rest = Parameter('rest', lambda t: ...); the length of a rope is that of Scene.add_rope"
)


def _refuse_functions(part: object, names: tuple[str, ...], place: str) -> None:
    """Refuse functions of time, parameters and inputs, with the place where they may stand."""
    for name in names:
        value = getattr(part, name)
        if callable(value) or is_parameter(value) or isinstance(value, Input):
            raise SceneError(
                f"{type(part).__name__}: {name} is a number, and does not change in time. What "
                f"changes is an fx_beam.Parameter in {place}"
            )


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction that sticks: at most mu times the normal force, and elastic below.

    A spring of the stiffness kt and the damping time tau acts along the surface; its stretch is z.
    While the contact sticks, the friction is kt (z + tau dz/dt), as in the LuGre model. If this
    were above mu N, with the normal force N, the contact slips: the friction is mu N, and dz/dt
    follows from it. The spring stores kt z^2 / 2. The rest of the work of friction is lost and
    never negative. When the contact opens, the energy of the spring is lost as well.

    In a joint N is the force of the joint in the same step: on a slide its component across the
    axis, or across the beam; on a pin of radius R its magnitude, and the moment of friction is at
    most mu R N.

    A contact that sticks does not creep. Steps dt longer than 2 tau add damping: the viscosity of
    the spring is then kt dt / 2.

    Parameters
    ----------
    mu : float
        Coefficient of friction.
    stiffness : float
        Stiffness kt along the surface: of a node [N/m], of a beam, per length [N/m^2], of a slide
        [N/m], of a pin [N m/rad]. Try the stiffness of the contact. Where a body lands without
        restitution and sticks, as a leg, a rod or a rimless wheel, try a hundred times as much.
    radius : float, optional
        Radius R of a pin [m], for the rotation of a joint.
    damping : float, optional
        Time tau [s]. By default that of critical damping, 2 sqrt(m / kt). Here m is the mass that
        the spring holds: that of the node (the lighter of two) and of all that joints fix to it,
        the mass that a slide moves, or the inertia that a pin turns, both about the centre of mass
        of the free parts. `Stats.friction_damping` has the time. With 0 only the steps damp.

    Raises
    ------
    SceneError
        For a negative coefficient or damping, or a stiffness that is not positive.

    References
    ----------
    Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with friction,
    IEEE Trans. Automatic Control 40 (1995) 419-425, doi 10.1109/9.376053

    Examples
    --------
    A block of 2 kg that slides over a floor stops after v^2 / (2 mu g) = 0.1 m.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -10))
    >>> block = scene.add_body((0, 0), mass=2.0, inertia=0.1).centre
    >>> scene.fix(block, "rotation")
    >>> floor = fb.Line((0, 0), normal=(0, 1))
    >>> friction = fb.Coulomb(0.5, 1e6)
    >>> contact = scene.add_contact(block, floor, stiffness=1e6, friction=friction)
    >>> scene.set_velocity(block, (1.0, 0.0))
    >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    >>> round(float(solution.displacement(block)[-1, 0]), 3)
    0.1
    """

    mu: float = real("not negative")
    stiffness: float = real("positive")
    radius: float | None = real("positive", optional=True, default=None)
    damping: float | None = real("not negative", optional=True, default=None)

    def __post_init__(self):
        check_fields(self)


def friction_numbers(friction: Coulomb, share: Numbers, mobility: Numbers) -> list:
    """Numbers tau, mu, kt of the law with a share of the stiffness; damping is critical by default.

    The `mobility` is 1 / m, zero for what cannot move; an array for several points.
    """
    mobility, stiffness = np.asarray(mobility, float), friction.stiffness * share
    damping: Numbers | None = friction.damping
    if damping is None:
        damping = 2 / np.sqrt(np.where(mobility > 0, stiffness * mobility, np.inf))
    return [damping + 0 * mobility, friction.mu + 0 * mobility, stiffness + 0 * mobility]


def numbers_of_loss(part: OneSided, static: bool) -> list[float]:
    """Numbers r and speed of the loss of a stop or a contact; none without, or in statics."""
    if static or part.speed is None or not part.loss:
        return []
    return [part.loss, part.speed]


@dataclass(frozen=True)
class Spring:
    """Spring on a joint's free coordinate: linear, with a stored energy of your own, or both.

    Parameters
    ----------
    stiffness : float
        Force per slide [N/m], or moment per relative rotation [N m/rad].
    rest : float
        Slide [m] or relative rotation [rad] at which the spring is free of force.
    strain_energy : callable, optional
        ``strain_energy(x)``, the stored energy [J] besides that of `stiffness`, as a UFL expression
        of the slide [m] or relative rotation [rad] x since `rest`. The force is its derivative.
        With `internal` it has a second argument, the vector of internal variables.
    internal : InternalVariables, optional
        Variables by which the spring remembers its past: a hinge that yields or relaxes. The
        strains in their update are (x,).

    Raises
    ------
    SceneError
        For a negative stiffness, a stored energy that is no UFL expression of all its arguments, or
        an update of internal variables that does not fit the energy.

    Examples
    --------
    >>> import fx_beam as fb
    >>> spring = fb.Spring(stiffness=50, rest=0.1)
    >>> spring.stiffness, spring.rest
    (50.0, 0.1)

    A spring that stiffens, with the force 50 x + 200 x^3:

    >>> spring = fb.Spring(stiffness=50, strain_energy=lambda x: 50 * x**4)

    A hinge that yields at the moment 3 N m and then hardens by 10 N m/rad:

    >>> import ufl
    >>> def energy(x, a):
    ...     return 1e4 / 2 * (x - a[0]) ** 2 + 10 / 2 * a[0] ** 2
    >>> def flow(old, strains0, strains, dt):
    ...     trial = 1e4 * (strains[0] - old[0]) - 10 * old[0]
    ...     excess = ufl.max_value(abs(trial) - 3, 0)
    ...     return [old[0] + ufl.sign(trial) * excess / (1e4 + 10)]
    >>> variables = fb.InternalVariables(("plastic angle",), flow)
    >>> hinge = fb.Spring(strain_energy=energy, internal=variables)

    It carries an arm, whose end is loaded by 4 N m. The hinge turns by (4 - 3)/10 rad for good.

    >>> scene = fb.Scene()
    >>> arm = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e9, GA=1e9, EI=1e9))
    >>> joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, spring=hinge))
    >>> load = scene.add_moment(arm.end, 4.0)
    >>> motion = fb.static(scene, load_steps=4).joint(joint)
    >>> round(float(motion.internal("plastic angle")[-1]), 6), round(float(motion.angle[-1]), 6)
    (0.1, 0.1004)
    """

    stiffness: float = real("not negative", default=0.0)
    rest: float = real(default=0.0)
    strain_energy: Energy | None = field(default=None, metadata=IS_DATA)
    internal: InternalVariables | None = None

    def __post_init__(self):
        _refuse_functions(self, ("stiffness", "rest"), _IN_ENERGY)
        check_fields(self)
        check_energy(self.strain_energy, self.internal, "Spring", ("x",))


@dataclass(frozen=True)
class Damper:
    """Damper on a joint's free coordinate: linear, with a law of your own, or the sum of both.

    Parameters
    ----------
    viscosity : float
        Force per slide rate [N s/m], or moment per relative spin [N m s/rad].
    law : callable, optional
        ``law(rate)``, the force [N] or moment [N m] besides that of `viscosity`, as a UFL
        expression of the rate [m/s or rad/s]; positive if it acts against a positive rate. It must
        not drive the motion, which is checked at rates from 1e-6 to 1e4 of both signs.

    Raises
    ------
    SceneError
        For a negative viscosity, or a law that is no UFL expression of the rate or that drives.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Damper(viscosity=2)
    Damper(viscosity=2.0, law=None)

    A damper whose force grows with the square of the rate:

    >>> damper = fb.Damper(law=lambda rate: 0.3 * abs(rate) * rate)
    """

    viscosity: float = real("not negative", default=0.0)
    law: Callable[[Expr], Expr] | None = field(default=None, metadata=IS_DATA)

    def __post_init__(self):
        _refuse_functions(self, ("viscosity",), "the law of a damper, law=lambda rate: c * rate")
        check_fields(self)
        if self.law is not None:
            _check_law(self.law)


@dataclass(frozen=True)
class SmoothFriction:
    """Coulomb friction on a joint's free coordinate, of constant magnitude, regularised.

    The force is F tanh(rate / speed): above 3 times the speed it is F up to 0.5 %. At lower rates
    it is viscous, so that a joint under a load smaller than F creeps slowly instead of sticking.

    Parameters
    ----------
    force : float or callable
        Magnitude F of the force on a slide [N], or of the moment on a relative rotation [N m]; or
        ``force(rate)``, a UFL expression of the rate whose values are not negative, such as
        Stribeck's law.
    speed : float
        Rate [m/s or rad/s], small compared with the rates of the motion. The stopping distance of a
        body with the initial rate v is longer than that of ideal friction by the fraction pi^2/6
        (speed/v)^2.

    Raises
    ------
    SceneError
        For a negative force, or a speed that is not positive.

    Examples
    --------
    A block of 1 kg on a rail stops in m v^2 / (2 F).

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> block = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    >>> friction = fb.SmoothFriction(force=2.0, speed=0.01)
    >>> rail = fb.Prismatic(fb.GROUND, block.start, axis=(1, 0), friction=friction)
    >>> rail = scene.add_joint(rail)
    >>> scene.set_velocity(block, (2.0, 0.0))
    >>> solution = fb.simulate(scene, dt=0.01, t_end=1.5)
    >>> round(float(solution.joint(rail).slide[-1]), 3)
    1.0
    """

    force: float | Callable[[Expr], Expr] = field(metadata=IS_DATA)
    speed: float = real("not negative")

    def __post_init__(self):
        if callable(self.force):
            _check_magnitude(self.force)
        else:
            force = finite(self.force, "SmoothFriction: force", "not negative")
            object.__setattr__(self, "force", force)
        check_fields(self)
        if not self.speed:
            raise SceneError(
                "SmoothFriction: speed = 0 must be positive. It is the rate below which friction "
                "is viscous; try a hundredth of the rates of the motion"
            )


#: Friction on a coordinate of a joint.
Friction = SmoothFriction | Coulomb


class Locked(Signal):
    """In the place of a motor: it holds a coordinate where it is when a run starts.

    In the reference configuration it is at zero.
    """

    is_constant = False

    def __init__(self) -> None:
        super().__init__(None, 1, "locked", np.zeros(1))


@dataclass(frozen=True)
class Coordinate:
    """Spring, damper, friction, stops and motor on a coordinate of a joint.

    Parameters
    ----------
    spring : Spring, optional
        Linear spring, or one with a stored energy of its own.
    damper : Damper, optional
        Linear damper, or one with a law of its own.
    motor : callable or Input, optional
        ``motor(t)``, the change of the coordinate since the start. It prescribes the coordinate.
    friction : SmoothFriction or Coulomb, optional
        Friction of a constant magnitude, or that follows the force of the joint and sticks.
    stop : Stop or (lower, upper, stiffness), optional
        Elastic stops.

    Examples
    --------
    >>> import fx_beam as fb
    >>> hinge = fb.Coordinate(spring=fb.Spring(stiffness=2.0), damper=fb.Damper(viscosity=0.1))
    >>> hinge.spring.stiffness
    2.0
    """

    spring: Spring | None = None
    damper: Damper | None = None
    motor: Callable[[float], np.ndarray] | None = field(default=None, metadata=IS_DATA)
    friction: Friction | None = None
    stop: Stop | None = None

    def __str__(self):
        parts = (part for part in vars(self).values() if part is not None)
        # A motor is a function, whose own text says nothing.
        return ", ".join("motor" if part is self.motor else str(part) for part in parts) or "free"

    def __post_init__(self):
        if isinstance(self.stop, tuple | list) and len(self.stop) == 3:
            object.__setattr__(self, "stop", Stop(*self.stop))
        friction = "an fx_beam.SmoothFriction or an fx_beam.Coulomb"
        for name, kinds, expected in (
            ("spring", Spring, "an fx_beam.Spring"),
            ("damper", Damper, "an fx_beam.Damper"),
            ("friction", Friction, friction),
            ("stop", Stop, "(lower, upper, stiffness) or an fx_beam.Stop"),
        ):
            value = getattr(self, name)
            require(value is None or isinstance(value, kinds), name, value, expected)
        ok = self.motor is None or isinstance(self.motor, Input) or callable(self.motor)
        ok = ok or is_number(self.motor)
        require(ok, "motor", self.motor, "a function of time, or an fx_beam.Input")

    @property
    def acts(self) -> bool:
        """Whether there is a spring, a damper, friction or stops."""
        return any((self.spring, self.damper, self.friction, self.stop))


def checked_coordinate(name: str, spring, damper, motor, friction=None, stop=None) -> Coordinate:
    """Coordinate of checked parts."""
    if motor is not None:
        motor = time_function(motor, 1, name)
    return Coordinate(spring, damper, motor, friction, stop)


def _check_magnitude(force: Callable[[Expr], Expr]) -> None:
    """Refuse a magnitude of friction that is no UFL expression of the rate, or negative."""
    call = "SmoothFriction: force"
    for rate in _RATES:
        value = value_of(force, [rate], f"{call}(rate)")
        if isinstance(value, complex) or not value >= 0:
            raise SceneError(f"{call}({rate:g}) = {value:g} must not be negative, and finite")


def _check_law(law: Callable[[Expr], Expr]) -> None:
    """Refuse a law of a damper that is no scalar UFL expression of the rate, or that drives."""
    call = "Damper: law"
    force, rates = scalar_of(law, 1, f"{call}(rate)")
    if not {*rates} & {*parts_of(force)}:
        raise SceneError(
            f"{call}(rate) must be a scalar that depends on the rate, not {force}. Use ufl.tanh, "
            "not math.tanh"
        )
    for rate in _RATES:
        force = value_of(law, [rate], f"{call}(rate)")
        if isinstance(force, complex):
            raise SceneError(f"{call}({rate:g}) is complex. Write abs(rate) in roots and powers")
        if force * rate < 0:
            raise SceneError(
                f"{call}({rate:g}) = {force:g} adds energy: the force must have the sign of the "
                "rate, and be zero at the rate 0. Subtract law(0), or change its sign"
            )


def functions_of(coordinate: Coordinate) -> Iterator[tuple[str, Expr]]:
    """Expressions of the user's functions on a coordinate, by kind."""
    if (spring := coordinate.spring) is not None:
        yield from functions_of_energy(spring.strain_energy, spring.internal, 1)
    laws = getattr(coordinate.damper, "law", None), getattr(coordinate.friction, "force", None)
    for law in filter(callable, laws):
        from .ufl_symbols import SCALARS

        yield "law", ufl.as_ufl(law(SCALARS[0]))
