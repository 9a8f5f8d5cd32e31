"""A quantity of a motion, refined in step and mesh until it is known to a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import Failure, StepError, check_takes, is_whole, positive, real_array, require
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.dynamics import simulate
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene

# Tolerance of the steps at first, and its factor in a refinement; the elements are doubled.
_FIRST, _FACTOR = 1e-2, 0.25
# Largest number of elements at first.
_MOST = 10_000
# Error of the finer of two runs, relative to their difference: at second order it is a third.
_SHARE = 0.5
# An error falls at most by the first factor when the steps are refined, and by the second one times
# 4^degree when the mesh is. If a change is smaller than that, it is chance.
_FASTEST, _FASTEST_OF_MESH = 8.0, 2.0


@dataclass(frozen=True)
class Converged:
    """A quantity that is known to a tolerance; returned by `converge`.

    Parameters
    ----------
    value : float or array
        The quantity in the finest run.
    error : float
        The estimated error, the sum of `step_error` and `mesh_error`; of an array the largest.
    step_error, mesh_error : float
        The two parts of the error.
    elements : int
        Elements in the finest run.
    tolerance : float
        Tolerance of the steps in the finest run.
    runs : int
        Number of runs.
    steps : int
        Steps of all runs.
    solution : Solution
        The finest run.

    Examples
    --------
    >>> import fx_beam as fb
    >>> def scene_of(elements, degree):
    ...     scene = fb.Scene(gravity=(0, -9.81))
    ...     section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
    ...     beam = scene.add_beam([(0, 0), (1, 0)], section, elements, degree, name="arm")
    ...     scene.clamp(beam.start)
    ...     return scene
    >>> def tip(solution):
    ...     return solution.displacement(solution.beams["arm"].end)[-1, 1]
    >>> converged = fb.converge(scene_of, tip, 1e-2, t_end=0.2)
    >>> converged.error < 1e-2, converged.elements >= 8
    (True, True)
    """

    value: float | np.ndarray
    error: float
    step_error: float
    mesh_error: float
    elements: int
    tolerance: float
    runs: int
    steps: int
    solution: Solution

    def __repr__(self):
        return (
            f"<Converged: {self.value} +- {self.error:.2g}, {self.elements} elements, steps by a "
            f"tolerance of {self.tolerance:.2g}; {self.runs} runs, {self.steps} steps>"
        )


def converge(
    scene_of: Callable[[int, int], Scene],
    quantity: Callable[[Solution], float | np.ndarray],
    tolerance: float,
    *,
    t_end: float,
    scheme: Scheme | None = None,
    elements: int = 4,
    degree: int = 1,
    breaks: Sequence[float] = (),
    max_runs: int = 24,
) -> Converged:
    """Refine step and mesh until a quantity of a motion is known to a tolerance.

    Each run chooses its steps by a tolerance. From run to run either this tolerance is divided by
    four or the number of elements is doubled, whichever has changed the quantity more. This ends
    when half of the last change by the steps plus half of the last change by the mesh is below the
    `tolerance`. A change that is far smaller than the one before may be accidental: it is taken to
    be at least an eighth of the change before by the steps, or 1 / (2 4^degree) of the change
    before by the mesh. The quantity must converge, which it does not in a chaotic motion. An effect
    that occurs in none of the first runs, such as damage that begins only on a finer mesh, gives
    the value 0 with the error 0: begin with more `elements`.

    Parameters
    ----------
    scene_of : callable
        ``scene_of(elements, degree)`` builds the scene.
    quantity : callable
        ``quantity(solution)`` gives a number or an array of fixed shape. For values at given times,
        interpolate: steps end at other times in each run.
    tolerance : float
        Largest error of the quantity, in its own unit.
    t_end : float
        End of the simulations [s].
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    elements : int
        Number of elements in the first run.
    degree : int
        Degree of the elements; it is not changed.
    breaks : sequence of float, optional
        Times at which loads jump, as for `simulate` [s].
    max_runs : int
        Largest number of runs.

    Returns
    -------
    Converged
        The quantity, its estimated error, and the number of runs and steps.

    Raises
    ------
    SceneError
        If an option or a scene is invalid.
    StepError
        If a run fails, or if the quantity is not known after `max_runs` runs. The attribute
        `solution` is that of the last run. This exception and any other, such as KeyboardInterrupt
        after Ctrl-C, has the attribute `values`: the quantity by elements and tolerance of the
        steps, in the completed runs.

    Examples
    --------
    The position of a pendulum after a second, to a tenth of a millimetre.

    >>> import fx_beam as fb
    >>> def scene_of(elements, degree):
    ...     scene = fb.Scene(gravity=(0, -9.81))
    ...     section = fb.Section(EA=1e8, GA=1e8, EI=1e4, rhoA=1.0, rhoI=1e-4)
    ...     bar = scene.add_beam([(0, 0), (0.5, 0)], section, elements, degree, name="bar")
    ...     scene.pin(bar.start)
    ...     return scene
    >>> def position(solution):
    ...     return solution.position(solution.beams["bar"].end)[-1]
    >>> converged = fb.converge(scene_of, position, 1e-4, t_end=1.0, elements=2)
    >>> converged.error < 1e-4
    True
    """
    check_takes(scene_of, "elements, degree", "converge: scene_of")
    check_takes(quantity, "solution", "converge: quantity")
    tolerance = positive(tolerance, "converge: tolerance")
    expected = f"a whole number from 1 to {_MOST}"
    require(is_whole(elements, 1, _MOST), "converge: elements", elements, expected)
    require(is_whole(degree, 1, 3), "converge: degree", degree, "1, 2 or 3")
    require(is_whole(max_runs, 4), "converge: max_runs", max_runs, "a whole number from 4 on")

    def run(elements: int, tolerance: float) -> Solution:
        scene = scene_of(elements, int(degree))
        return simulate(scene, scheme, t_end=t_end, tolerance=tolerance, breaks=breaks)

    runs = _Runs(run, quantity, max_runs)
    try:
        return _refined(runs, int(elements), int(degree), tolerance)
    except BaseException as stop:
        stop.values = runs.values  # type: ignore[attr-defined]
        raise


def _refined(runs: _Runs, mesh: int, degree: int, tolerance: float) -> Converged:
    """The quantity, known to the tolerance; from a number of elements on."""
    step, mesh_before, step_before = _FIRST, 0.0, 0.0
    while True:
        value = runs.value(mesh, step)
        mesh_error = _SHARE * float(abs(runs.value(2 * mesh, step) - value).max())
        step_error = _SHARE * float(abs(runs.value(mesh, _FACTOR * step) - value).max())
        mesh_error = max(mesh_error, mesh_before / (_FASTEST_OF_MESH * 4**degree))
        step_error = max(step_error, step_before / _FASTEST)
        if mesh_error + step_error <= tolerance:
            finest = runs.value(2 * mesh, _FACTOR * step)
            result = finest if finest.ndim else float(finest)
            errors = mesh_error + step_error, step_error, mesh_error
            used = len(runs.values), runs.steps
            return Converged(result, *errors, 2 * mesh, _FACTOR * step, *used, runs.last)
        if mesh_error > step_error:
            mesh, mesh_before = 2 * mesh, mesh_error
        else:
            step, step_before = _FACTOR * step, step_error


class _Runs:
    """Values of the quantity by elements and tolerance of the steps, computed once."""

    def __init__(self, run: Callable[[int, float], Solution], quantity: Callable, most: int):
        self._run, self._quantity, self._most = run, quantity, most
        self.values: dict[tuple[int, float], np.ndarray] = {}
        self.steps = 0
        self.last: Solution

    def value(self, elements: int, tolerance: float) -> np.ndarray:
        """The quantity for a number of elements and a tolerance of the steps."""
        key = elements, tolerance
        if key not in self.values:
            if len(self.values) == self._most:
                raise self._unknown()
            self.last = self._run(elements, tolerance)
            result = self._quantity(self.last)
            value = real_array(result)
            ok = value.size > 0 and {value.shape} >= {v.shape for v in self.values.values()}
            expected = "a number, or an array of numbers, of one shape in all runs"
            require(ok, "converge: the quantity", result, expected)
            name = f"converge: the quantity with {elements} elements"
            require(bool(np.isfinite(value).all()), name, result, "finite")
            self.values[key], self.steps = value, self.steps + self.last.stats.steps
        return self.values[key]

    def _unknown(self) -> StepError:
        last_values = "; ".join(
            f"{elements} elements, {tolerance:.2g}: {value}"
            for (elements, tolerance), value in list(self.values.items())[-4:]
        )
        error = StepError(
            Failure(
                "not converged",
                f"converge: the quantity is not known to the tolerance after {self._most} runs",
                self.last.t[-1],
                where=f"The last values, by elements and tolerance of the steps: {last_values}",
                advice="Try a larger tolerance, a shorter time, or more runs (max_runs)",
            )
        )
        error.solution = self.last
        return error
