"""Free motions of a mode over their amplitude or energy."""

from __future__ import annotations

import itertools

from fx_beam.laws.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions

from .mode_family import STEP, ModeFamily
from .mode_start import mode_start
from .periodic_family import PeriodicFamily
from .periodic_motion import motion_of
from .periodic_search import check_tolerance, longest_step, target
from .shooting import Shooting


def backbone(
    scene: Scene,
    mode: int = 0,
    *,
    amplitude: float | None = None,
    energy: float | None = None,
    state: Solution | None = None,
    step: float = STEP,
    most: int = 200,
    steps: int = 101,
    scheme: Scheme | None = None,
    tolerance: float = 1e-9,
    newton: NewtonOptions | None = None,
) -> PeriodicFamily:
    """Follow the free periodic motions of a mode, from a small amplitude on.

    The curve of frequency over amplitude, or over energy, is the backbone of the resonances. It is
    followed by the pseudo-arc length, also where amplitude or frequency turn back.

    Parameters
    ----------
    scene : Scene
        The scene.
    mode : int
        Number of the mode, as of `modes`.
    amplitude : float, optional
        Where the family ends: amplitude at the start [m], as of `periodic`.
    energy : float, optional
        Or its energy there [J].
    state : Solution, optional
        Equilibrium about which the mode vibrates; by default the reference configuration without
        loads.
    step : float
        Longest step: change of the state over the size of the motion, or of the period over itself.
    most : int
        Largest number of motions.
    steps : int
        Odd number of steps in a period.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    tolerance : float
        As of `periodic`.
    newton : NewtonOptions, optional
        Convergence criteria of the steps.

    Returns
    -------
    PeriodicFamily
        The motions, by growing arc length; the last one has the amplitude or energy.

    Raises
    ------
    SceneError
        As of `periodic`.
    RuntimeError
        If the family cannot be followed so far.

    Examples
    --------
    A mass on a spring that hardens: with stiffness 1 + x^2 the frequency grows with the amplitude.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    >>> spring = fb.Spring(stiffness=1.0, strain_energy=lambda x: x**4 / 4)
    >>> joint = scene.add_joint(
    ...     fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring)
    ... )
    >>> family = fb.backbone(scene, amplitude=1.0)
    >>> (family.frequencies * 6.2832).round(2)[[0, -1]]
    array([1.  , 1.32])
    """
    what = "backbone"
    amplitude, energy = target(what, amplitude, energy)
    check_tolerance(what, tolerance)
    step = longest_step(what, step, most)
    shooting = Shooting(scene, scheme, steps, newton, what)
    family = ModeFamily(mode_start(shooting, scene, state, mode), amplitude, energy, tolerance)
    found = itertools.islice(family.followed(step), most)
    return PeriodicFamily([motion_of(shooting, closed, True) for closed in found], free=True)
