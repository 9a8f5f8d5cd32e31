"""Error against run time: time schemes, steps and meshes for the paper's four examples.

    ./run report work-precision            some minutes
    ./run report work-precision --quick    fewer schemes, steps and meshes

The scenes are those of the demos. Each example has its own quantities of interest, and a duration
for which errors are meaningful:

- The pendulum is compared with the exact motion on a rigid rod; the elastic rod is longer by about
  1e-9. A massless rod stays straight, so all meshes and degrees give the same model. The run starts
  with the stretch that belongs to the rigid rod's force. From an unstressed start, as in the demo,
  the force vibrates about that of the rigid rod with the same amplitude, at a frequency that no
  step here resolves. With HHT 0.65 of this amplitude remains for all steps. In the mid-point
  schemes the mean over a step contains 2/(w dt) of it, with w^2 = EA/(m L): the error grows as the
  step decreases.
- The swing ends before its right link turns back at 0.64 s: after it a change in the last digit
  leads to a different motion. Time steps coincide with the corners of the pulse.
- The multi-body system ends with its moment, before its members are in line at 0.6 s. Its axial
  force vibrates with a phase that depends on mesh and step; the integral over time, the impulse,
  does not. It is computed from the mean force along the member, because Gauss points differ between
  meshes. The swing's axial force is the mean along its beam as well.
- The pinned beam starts with a jump of the spin in its middle, which no mesh resolves. It excites
  waves of all lengths, so that errors fall more slowly than with the square of step and element.

Energy and momentum are invariants: their errors are computed against exact values.
"""

import argparse
import logging
from pathlib import Path
from time import perf_counter

import numpy as np
from demo_scenes import ROOT, demo, scene
from scipy.integrate import cumulative_trapezoid

import fx_beam as fb

SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "MidPoint": fb.MidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "Generalized alpha, 0.9": fb.GeneralizedAlpha(0.9),
}
QUICK_SCHEMES = "EnergyMomentum", "Newmark (trapezoidal)"


# -- Quantities of interest ------------------------------------------------------------------------


def energy_error(solution):
    """Energy gained without work, over the largest kinetic energy."""
    return solution.energy.balance_error / solution.energy.kinetic.max()


def momentum_error(solution):
    return solution.angular_momentum / solution.angular_momentum[0] - 1


def axial_force(beam):
    """Mean of the axial force along a beam, at the times for which the scheme gives it."""

    def mean(solution):
        elements, degree = solution.beams[beam].elements, solution.beams[beam].degree
        weights = np.tile(np.polynomial.legendre.leggauss(degree)[1] / 2, elements) / elements
        return solution.t_level, solution.resultants(beam).N @ weights

    return mean


def impulse(beam):
    """Integral of the mean axial force over time."""

    def integral(solution):
        t, force = axial_force(beam)(solution)
        # A mid-point scheme gives the mean over the first step, which also applies to its start.
        first = 1 if solution.stats.level == 0.5 else 0
        t, force = t[first:], force[first:]
        return t, force[0] * t[0] + cumulative_trapezoid(force, t, initial=0)

    return integral


def path(beam):
    """Position of the end of a beam."""
    return lambda solution: solution.position(solution.beams[beam].end)


def slide(solution):
    return solution.slides[:, -1]


def turn(solution):
    """Angle of the free end of the pinned beam about the pin, from the start."""
    x, y = path("beam")(solution).T
    return np.unwrap(np.arctan2(y, x))


# -- Examples --------------------------------------------------------------------------------------


def halved(step, times):
    return [step / 2**k for k in range(times)]


def stretched(elements, degree):
    """The pendulum in equilibrium with the rigid rod's initial force, as a start for the swing."""
    module = demo("pendulum")
    scene, rod = module.scene(elements, degree)
    scene.fix(rod.end, "x")
    scene.add_force(rod.end, (0.0, -module.MASS * module.SPEED**2 / module.LENGTH))
    return fb.static(scene)


def pendulum(quick):
    module = demo("pendulum")
    rigid = module.rigid
    return {
        "quantities": {
            "tip path": module.displacement,
            "period": module.period,
            "axial force": axial_force("rod"),
            "energy": lambda s: module.energy_ratio(s) - 1,
        },
        "exact": {
            "tip path": lambda t: rigid(t)[0],
            "period": rigid(0.0)[3],
            "axial force": lambda t: rigid(t)[2],
            "energy": 0.0,
        },
        "start": stretched,
        "t_end": module.T_END,
        "steps": halved(module.LARGE, 4 if quick else 8),
        "meshes": [(1, 1)] if quick else [(1, 1), (4, 1), (1, 2)],
    }


def three_bar_swing(quick):
    corner = demo("three_bar_swing").PULSE[0][1]
    return {
        "quantities": {
            "path of B": lambda s: s.position(s.beams["beam"].node(0.25)),
            "joint path": path("right"),
            "axial force": axial_force("beam"),
            "energy": energy_error,
        },
        "exact": {"energy": 0.0},
        "t_end": 0.6,
        "steps": halved(corner / 8, 3 if quick else 6),
        "meshes": [(4, 1), (8, 1)] if quick else [(4, 1), (8, 1), (16, 1), (4, 2), (8, 2), (4, 3)],
    }


def multibody(quick):
    _, corner, pulse_end = demo("multibody").PULSE[0]
    meshes = [(5, 1), (10, 1), (20, 1), (3, 2), (5, 2), (10, 2)]
    return {
        "quantities": {
            "joint path": path("member 1"),
            "slide": slide,
            "impulse of the axial force": impulse("member 1"),
            "energy": energy_error,
        },
        "exact": {"energy": 0.0},
        "t_end": pulse_end,
        "steps": halved(corner / 10, 3 if quick else 5),
        "meshes": [(5, 1)] if quick else meshes,
    }


def pinned_beam(quick):
    meshes = [(8, 1), (16, 1), (32, 1), (4, 2), (8, 2), (16, 2), (4, 3), (8, 3), (16, 3)]
    return {
        "quantities": {
            "tip path": path("beam"),
            "turn": turn,
            "impulse of the axial force": impulse("beam"),
            "energy": energy_error,
            "angular momentum": momentum_error,
        },
        "exact": {"energy": 0.0, "angular momentum": 0.0},
        "t_end": 0.5,
        "steps": halved(demo("pinned_beam").DT, 3 if quick else 6),
        "meshes": [(8, 1)] if quick else meshes,
    }


EXAMPLES = [pendulum, three_bar_swing, multibody, pinned_beam]


def main(quick=False, results=ROOT / "results" / "work_precision", examples=EXAMPLES):
    """Results by example; JSON, pages and pictures are written to the directory for results."""
    schemes = {name: SCHEMES[name] for name in (QUICK_SCHEMES if quick else SCHEMES)}
    found = {}
    for example in examples:
        start = perf_counter()
        name = example.__name__
        found[name] = fb.work_precision.study(
            lambda elements, degree, name=name: scene(name, elements, degree),
            schemes=schemes,
            results=results / name,
            **example(quick),
        )
        print(f"== {name}, {perf_counter() - start:.0f} s: {results / name}.md")
        for quantity in found[name].references:
            print("  ", fb.work_precision.sentence(found[name], quantity))
    return found


if __name__ == "__main__":
    # The tables have a column for halved steps, so their warnings are not needed.
    logging.getLogger("fx_beam").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a short form, under a minute")
    parser.add_argument("results", nargs="?", type=Path, help="directory to write to")
    given = parser.parse_args()
    main(given.quick, *([given.results] if given.results else []))
