"""Equilibria of a scene under rising loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fx_beam.motions.progress import keeping_steps
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions

from .branches import Branch, grown
from .load_path import LoadPath, StaticOptions


@keeping_steps
def static(
    scene: Scene,
    load_steps: int = 10,
    *,
    t: float = 0.0,
    continuation: str | None = None,
    newton: NewtonOptions | None = None,
    max_cuts: int = 8,
    max_steps: int = 1000,
    progress: bool | None = None,
    inputs: Mapping[str, Any] | None = None,
    spin: float = 0.0,
    pivot: Sequence[float] = (0.0, 0.0),
    start: Solution | Branch | None = None,
    branches: int = 0,
) -> Solution:
    """Compute equilibria of a scene while its loads rise from zero.

    The load factor multiplies all loads, including the weight, prescribed motions and motors.
    Functions of time are evaluated at the time `t`. Inertia, damping and initial velocities have no
    effect. The work of the loads uses the mean of the forces at both ends of each step; the energy
    balance thus has an error of second order in the steps. The potential energy is that of the full
    weight; the part of the weight that does not act yet is counted as an upward load.

    Parameters
    ----------
    scene : Scene
        The scene.
    load_steps : int
        Number of load steps, if none is divided. A step that fails, or whose work is too
        inaccurate, is halved; after steps with few iterations the length is doubled again. Springs
        under tension are released before the first load step, in the same number of steps. An
        arc-length step changes the load factor by at most 1/`load_steps`, and its turn is limited
        in proportion.
    t : float
        Time at which functions of time are evaluated [s].
    continuation : {"arc-length"}, optional
        Method to pass limit points: the load factor is an unknown; it falls after a limit point
        and rises again after the next. A path is abandoned at the load factor -10. By default the
        load factor only rises.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_cuts : int
        How often a step may be halved.
    max_steps : int
        Largest number of arc-length steps; if the path has not reached load factor 1 by then, it
        ends and ``stats.failure`` reports this.
    progress : bool, optional
        Whether to show a progress bar; by default on a terminal if the run takes longer than two
        seconds.
    inputs : dict, optional
        For names of inputs of the scene (`Input`) a constant or a function of time. The others are
        zero.
    spin : float
        Spin Omega [rad/s] of a frame in which the scene rests: a steady turn, with the centrifugal
        forces of all masses. Supports, obstacles and loads turn with the frame. The centrifugal
        forces increase with the load factor l, so that a row has the spin Omega sqrt(l), and
        velocities. `modes`, `linearise` and `simulate` continue with this rotation.
    pivot : (float, float)
        Point about which the frame turns [m].
    start : Solution, optional
        A solution from whose last state to start: loads one after the other, such as prestress and
        then a load. The forces that held this state decrease to zero while the loads of the scene
        increase to their full values, so that loads in both stay constant. Prescribed motions and
        motors continue from their present position; a new support holds its node where it is.
        Velocities have no effect. Internal variables, work and dissipated energy continue.

        Or a branch, ``point.branch(+1)`` of a bifurcation among the `critical_points` of a path of
        the same scene that had no `start`, with the same `t` and `inputs`; with
        ``continuation="arc-length"``. The first row is the bifurcation. The path ends at load
        factor 1, or at the bifurcation if it returns there, which ``stats.closed`` says.
    branches : int
        Levels of branches that are followed, by arc length, from all bifurcations in both
        directions of each mode; those of the second level start at bifurcations of the first. They
        are in ``solution.branches``.

    Returns
    -------
    Solution
        The equilibria, with their load factors in `Solution.load_factor` in place of times, their
        stability in `unstable_modes`, and `critical_points`. The load factors of limit points that
        arc-length steps have passed, which are also rows, are in ``stats.limit_points``.

    Raises
    ------
    SceneError
        Before the first step, if the scene cannot be in equilibrium, or its loads leave it free to
        move.
    StepError
        If a step fails. Its attribute `solution` has all steps before it, `time` the load factor.
    KeyboardInterrupt
        After Ctrl-C. Its attribute `solution` has the steps so far, or is None before the first
        one. Every other exception has `solution` as well.

    Examples
    --------
    An end moment bends a cantilever into a quarter circle.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_moment(beam.end, math.pi / 2)
    >>> solution = fb.static(scene, load_steps=4)
    >>> bool(abs(solution.rotation(beam.end)[-1] - math.pi / 2) < 1e-8)
    True
    """
    options = StaticOptions.among(locals())
    solution = LoadPath(scene, options, start).followed()
    if branches:
        along = replace(options, continuation="arc-length", branches=0)
        grown(solution, branches, lambda origin: LoadPath(scene, along, origin).followed())
    return solution
