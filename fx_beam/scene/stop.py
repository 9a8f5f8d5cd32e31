"""Elastic stops, with a loss or without, as plain data."""

from __future__ import annotations

from dataclasses import dataclass

from fx_beam.errors import SceneError
from fx_beam.validation import as_float, finite, require, set_finite, shown

# With less a contact opens without a force, and Newton's method has no slope: of 1000 steps of an
# elastic ring on a plane 94 had to be halved with 0, none with 0.02.
_LEAST = 0.02


@dataclass(frozen=True)
class Stop:
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
        Stiffness k [N/m or N m/rad]. A mass m with the speed v passes the limit by
        v sqrt(m / k), for the time pi sqrt(m / k).
    restitution : float
        Coefficient of restitution e from 0 to 1: the speed after an impact, relative to that before
        it; below 0.02 it is 0.02. It holds for impacts at v far above `speed`: the square of the
        ratio is larger by c (speed / v)^2, with c = 0.16, 0.98, 3.3 for e = 0.9, 0.5, 0.2.
    speed : float, optional
        Rate [m/s or rad/s] below which the loss is viscous; required for e < 1. Try a hundredth of
        the speed of the impacts. At rest the force is k d, without a loss.

    Raises
    ------
    SceneError
        Without a limit, for a lower limit above the upper one, or for a value out of range.

    Examples
    --------
    A slide that starts at 0 and stops at 0.5 m. It gives back the energy of the block.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> block = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1e3, rhoA=1.0))
    >>> stop = fb.Stop(None, 0.5, stiffness=1e4)
    >>> rail = scene.add_joint(fb.Prismatic(fb.GROUND, block.start, axis=(1, 0), stop=stop))
    >>> scene.set_velocity(block, (2.0, 0.0))
    >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    >>> bool(solution.slide(rail).max() < 0.53), bool(solution.slide(rail)[-1] < 0.1)
    (True, True)
    >>> bool(abs(solution.energy.balance_error).max() < 1e-11)
    True
    """

    lower: float | None
    upper: float | None
    stiffness: float
    restitution: float = 1.0
    speed: float | None = None

    def __post_init__(self):
        for name in ("lower", "upper"):
            set_finite(self, name, optional=True)
        if self.lower is None and self.upper is None:
            raise SceneError("Stop: give a lower limit, an upper limit or both")
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise SceneError(
                f"Stop: lower = {self.lower!r} must be below upper = {self.upper!r}; the order is "
                "(lower, upper, stiffness)"
            )
        impact = checked_impact("Stop", self.stiffness, self.restitution, self.speed)
        for name, value in zip(("stiffness", "restitution", "speed"), impact, strict=True):
            object.__setattr__(self, name, value)

    def check_start(self, place: float, tolerance: float, what: str) -> None:
        """Refuse a start of the coordinate beyond a limit.

        Parameters
        ----------
        place : float
            The start [m or rad].
        tolerance : float
            How far it may be beyond [m or rad].
        what : str
            Name of the coordinate in the message.

        Raises
        ------
        SceneError
            With the limit.
        """
        for name, limit, beyond in (
            ("lower", self.lower, -1.0),
            ("upper", self.upper, 1.0),
        ):
            if limit is not None and beyond * (place - limit) > tolerance:
                raise SceneError(
                    f"{what} starts at {place:.6g}, beyond the {name} limit {limit:.6g} of its "
                    "stop. Move the limit"
                )

    @property
    def loss(self) -> float:
        """Dissipative part r of the force, relative to the elastic part."""
        return loss_of(self.restitution)


def as_stop(given) -> Stop | None:
    """A stop, from one or from (lower, upper, stiffness)."""
    if given is None or isinstance(given, Stop):
        return given
    if isinstance(given, tuple | list) and len(given) == 3:
        return Stop(*given)
    raise SceneError(f"stop = {shown(given)} must be (lower, upper, stiffness) or an fx_beam.Stop")


def loss_of(restitution: float) -> float:
    """r = (1 - e^2) / (1 + e^2), so that the forces out and in have the ratio e^2."""
    e = max(restitution, _LEAST)
    return (1 - e**2) / (1 + e**2)


def checked_impact(what: str, stiffness, restitution, speed) -> tuple[float, float, float | None]:
    """Stiffness, restitution and speed of a contact; SceneError if one is out of range."""
    k, e = finite(stiffness, f"{what}: stiffness", "positive"), as_float(restitution)
    require(0 <= e <= 1, f"{what}: restitution", restitution, "a number from 0 to 1")
    if speed is not None:
        speed = finite(speed, f"{what}: speed", "positive")
    elif e < 1:
        raise SceneError(
            f"{what}: a restitution below 1 needs a speed, the rate below which the loss is "
            "viscous. Try a hundredth of the speed of the impacts"
        )
    return k, e, speed
