"""Error against run time: time schemes, steps and meshes for the paper's four examples.

    ./run report work-precision            about ten minutes
    ./run report work-precision --quick    fewer schemes, steps and meshes
    ./run report work-precision --docs     and renew the table and the pictures of docs/

The scenes are those of the demos. Each example has its own quantities of interest. Where the motion
becomes stiff there are two windows. One ends before the stiff event and shows all quantities. The
other goes through it. There only slow quantities have a meaning: paths, and axial forces averaged
over a stated time, since the phase of fast vibrations depends on step and mesh.

- The pendulum is compared with the exact motion on a rigid rod; the elastic rod is longer by about
  1e-9. A massless rod stays straight, so all meshes and degrees give the same model. The run starts
  with the stretch that belongs to the rigid rod's force. From an unstressed start, as in the demo,
  the force vibrates about that of the rigid rod with the same amplitude, at a frequency that no
  step here resolves. With HHT 0.65 of this amplitude remains for all steps. In the mid-point
  schemes the mean over a step contains 2/(w dt) of it, with w^2 = EA/(m L): the error grows as the
  step decreases.
- The swing's right link turns back at 0.64 s, by an axial force a thousand times larger than
  before. The windows end at 0.6 s and at 1 s. Time steps coincide with the corners of the pulse.
- The multi-body system is in line at 0.6 s. The windows end with its moment, at 0.5 s, and at 2 s.
  From about 1.2 s on neighbouring motions part: no affordable reference knows the path at 2 s. So
  its errors are given up to 1.2 s, and up to 2 s with the reference's uncertainty.
- The pinned beam starts with a jump of the spin in its middle, which no mesh resolves. It excites
  waves of all lengths, so that errors fall more slowly than with the square of step and element.
  The windows end at 0.5 s and 2 s.

The axial force is the mean along the beam, because Gauss points differ between meshes. Energy and
momentum are invariants: their errors are computed against exact values.
"""

import argparse
import dataclasses
import functools
import itertools
import logging
import shutil
from pathlib import Path
from time import perf_counter

import numpy as np
from demo_scenes import ROOT, demo, scene
from scipy.integrate import cumulative_trapezoid

import fx_beam as fb
from fx_beam_studies import work_precision
from fx_beam_studies.reporting import short, table, write_csv
from fx_beam_studies.work_precision.accuracy import alike, floor
from fx_beam_studies.work_precision.report import draw_dots, draw_fronts

# One line adds a candidate.
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyMomentum, order 4": fb.EnergyMomentum(order=4),
    "EnergyDecaying": fb.EnergyDecaying(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "MidPoint": fb.MidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "Generalized alpha, 0.9": fb.GeneralizedAlpha(0.9),
}
QUICK_SCHEMES = "EnergyMomentum", "Newmark (trapezoidal)"
#: Errors for which the overview names the cheapest run.
LEVELS = 1e-2, 1e-4, 1e-6
#: The scheme to take if nothing speaks for another one, and the mark of those that lose motions.
RECOMMENDED, FRAGILE = "EnergyMomentum", " (\u00d7)"


# -- Quantities of interest ------------------------------------------------------------------------


def energy_error(solution):
    """Energy gained or lost without work, over the largest kinetic energy."""
    return solution.energy.gained / solution.energy.kinetic.max()


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


def mean_force(beam, duration):
    """Axial force of a beam, averaged over a duration [s] about each time of the run."""

    def mean(solution):
        t, integral = impulse(beam)(solution)
        t, integral = np.append(0, t), np.append(0, integral)
        half = duration / 2
        inside = solution.t[(solution.t > half) & (solution.t < t[-1] - half)]
        ends = (np.interp(inside + side, t, integral) for side in (half, -half))
        return inside, np.subtract(*ends) / duration

    return mean


def until(t_end, quantity):
    """A quantity up to a time [s]."""

    def first(solution):
        measured = quantity(solution)
        t, values = measured if isinstance(measured, tuple) else (solution.t, measured)
        return t[t < t_end + 1e-9], values[t < t_end + 1e-9]

    return first


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
        "dt": halved(module.LARGE, 4 if quick else 8),
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
        "dt": halved(corner / 8, 3 if quick else 6),
        "meshes": [(4, 1), (8, 1)] if quick else [(4, 1), (8, 1), (16, 1), (4, 2), (8, 2), (4, 3)],
    }


def three_bar_swing_to_1_s(quick):
    corner = demo("three_bar_swing").PULSE[0][1]
    return three_bar_swing(quick) | {
        "quantities": {
            "path of the mass": lambda s: s.position(s.beams["beam"].node(0.5)),
            "joint path": path("right"),
            "axial force, mean over 20 ms": mean_force("beam", 0.02),
            "energy": energy_error,
        },
        "t_end": demo("three_bar_swing").T_END,
        "dt": halved(corner / 32, 2 if quick else 5),
        "meshes": [(4, 2)] if quick else [(4, 1), (8, 1), (16, 1), (4, 2), (8, 2), (8, 3)],
        "finer": (8 if quick else 16, 2),
        "repetitions": 1 if quick else 3,
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
        "dt": halved(corner / 10, 2 if quick else 5),
        "meshes": [(5, 1)] if quick else meshes,
    }


def multibody_to_2_s(quick):
    return multibody(quick) | {
        "quantities": {
            "joint path to 1.2 s": until(1.2, path("member 1")),
            "joint path to 2 s": path("member 1"),
            "slide to 1.2 s": until(1.2, slide),
            "axial force to 1.2 s, mean over 0.1 s": until(1.2, mean_force("member 1", 0.1)),
            "energy": energy_error,
        },
        "t_end": demo("multibody").SHOWN,
        "dt": halved(0.01, 2 if quick else 5),
        "meshes": [(5, 2)] if quick else [(5, 1), (10, 1), (20, 1), (5, 2), (10, 2), (5, 3)],
        "finer": (8, 2),
        "repetitions": 1 if quick else 3,
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
        "dt": halved(demo("pinned_beam").DT, 3 if quick else 6),
        "meshes": [(8, 1)] if quick else meshes,
    }


def pinned_beam_to_2_s(quick):
    return pinned_beam(quick) | {
        "quantities": {
            "tip path": path("beam"),
            "turn": turn,
            "axial force, mean over 0.1 s": mean_force("beam", 0.1),
            "energy": energy_error,
            "angular momentum": momentum_error,
        },
        "t_end": 2.0,
        "dt": halved(demo("pinned_beam").DT, 2 if quick else 6),
        "meshes": [(8, 2)] if quick else [(8, 1), (16, 1), (32, 1), (8, 2), (16, 2), (16, 3)],
        "finer": (8 if quick else 16, 2),
        "repetitions": 1 if quick else 3,
    }


#: Studies of each example: before the stiff event, and through it.
EXAMPLES = [pendulum, three_bar_swing, three_bar_swing_to_1_s, multibody, multibody_to_2_s]
EXAMPLES += [pinned_beam, pinned_beam_to_2_s]


# -- Overview --------------------------------------------------------------------------------------


def is_fragile(study, run):
    """Whether the scheme of a run loses the motion on the same mesh with twice the step."""
    same = [r for r in study.runs if (r.scheme, r.mesh) == (run.scheme, run.mesh)]
    return any(r.lost and run.dt < r.dt < 2.1 * run.dt for r in same)


def cheapest(studies):
    """Rows of the cheapest run of each example for each error of its path, its first quantity.

    The recommended scheme stands for those that cost about the same as it does.
    """
    rows = []
    for (name, study), level in itertools.product(studies.items(), LEVELS):
        quantity = next(iter(study.references))
        row = {"example": title(name, study, quantity), "error": short(level)}
        if fastest := study.cheapest(quantity, level):
            names = [s + FRAGILE * is_fragile(study, fastest[s]) for s in alike(fastest)]
            first = RECOMMENDED if RECOMMENDED in names else names[0]
            names.remove(first)
            run = fastest[first.removesuffix(FRAGILE)]
            row |= {"scheme": first, "dt": run.dt, **vars(run.mesh), "seconds": run.seconds}
            row["about the same"] = "; ".join(names) if len(names) < 3 else f"{len(names)} others"
        else:
            known = floor(study, quantity)
            row["why none"] = "no run" if known <= level else f"not known below {short(known)}"
        rows.append(row)
    return rows


def in_words(row):
    """Cell of the overview."""
    if "scheme" not in row:
        return row["why none"]
    others = f" or {row['about the same']}" if row["about the same"] else ""
    return (
        f"**{row['scheme']}**{others}<br>dt = {1e3 * row['dt']:.3g} ms, {row['elements']} of "
        f"degree {row['degree']}<br>in {1e3 * row['seconds']:.3g} ms"
    )


def title(name, study, quantity):
    """Name of an example, its time span and the quantity."""
    return f"{name.partition('_to_')[0].replace('_', ' ')} to {study.t_end:g} s: {quantity}"


def panels_of(studies):
    """Names of pictures, with what they show: by scheme, and by degree where motions are smooth."""
    for name, study in studies.items():
        quantities = list(study.references)
        if name == "pendulum":
            quantities = ["tip path", "axial force"]
        for quantity in quantities[: 2 if name == "pendulum" else 1]:
            key = name if quantity == quantities[0] else f"{name}_{quantity.replace(' ', '_')}"
            yield key, title(name, study, quantity), study, quantity, lambda run: run.scheme
    for name in "three_bar_swing", "pinned_beam":
        if name in studies:
            ours = [run for run in studies[name].runs if run.name.startswith("EnergyMomentum")]
            study = dataclasses.replace(studies[name], runs=ours)
            quantity = next(iter(study.references))
            words = f"{title(name, study, quantity)}, EnergyMomentum of order 2 and 4"
            yield f"{name}_degrees", words, study, quantity, lambda r: f"degree {r.mesh.degree}"


def write_overview(results, studies):
    """The page to read first: a table, and a picture and a sentence for each example."""
    rows = cheapest(studies)
    write_csv(results / "overview.csv", rows)
    cells = [
        {"example": example} | {f"error {row['error']}": in_words(row) for row in own}
        for example, own in itertools.groupby(rows, lambda row: row["example"])
    ]
    paths = [(title(n, s, q := next(iter(s.references))), s, q) for n, s in studies.items()]
    draw_dots(results / "dots.png", [(words.replace(": ", "\n"), *look) for words, *look in paths])
    pictures = {}
    for key, words, study, quantity, kind in panels_of(studies):
        draw_fronts(results / f"front_{key}.png", [(words, study, quantity)], kind)
        pictures[key] = words
    page = [
        "# Error against run time: the cheapest run for an error\n",
        "In each cell: the scheme whose whole call of `simulate` takes the least processor time, "
        f"or {RECOMMENDED} if it takes at most 20 % more, and others of which this holds; its time "
        "step and elements; the time of the whole call. With (\u00d7): with twice the step the "
        "scheme loses the motion.\n",
        table(cells),
        "![Run time for an error](dots.png)\n",
        *(f"![{words}](front_{key}.png)\n" for key, words in pictures.items()),
        *(f"- [{name.replace('_', ' ')}]({name}.md)" for name in studies),
    ]
    (results / "overview.md").write_text("\n".join(page) + "\n", "utf-8")
    return table(cells), pictures


def renew_docs(results, cells, pictures):
    """Renew the table and the pictures of the page in docs/reports, between their comments."""
    page = ROOT / "docs" / "reports" / "work_precision.md"
    folder = ROOT / "docs" / "pictures"
    for old in folder.glob("work_precision_*.png"):
        old.unlink()
    shutil.copy(results / "dots.png", folder / "work_precision_dots.png")
    shown = ""
    for key, words in pictures.items():
        shutil.copy(results / f"front_{key}.png", folder / f"work_precision_{key}.png")
        shown += f"![{words}](../pictures/work_precision_{key}.png)\n\n"
    text = page.read_text("utf-8")
    for name, new in ("overview", cells), ("pictures", shown):
        before, _, rest = text.partition(f"<!-- {name} -->\n")
        text = f"{before}<!-- {name} -->\n{new}<!-- end {name} -->"
        text += rest.partition(f"<!-- end {name} -->")[2]
    page.write_text(text, "utf-8")


def main(quick=False, results=ROOT / "results" / "work_precision", examples=EXAMPLES, docs=False):
    """Results by example; JSON, pages and pictures are written to the directory for results."""
    schemes = {name: SCHEMES[name] for name in (QUICK_SCHEMES if quick else SCHEMES)}
    studies = {}
    for example in examples:
        start = perf_counter()
        name = example.__name__
        studies[name] = work_precision.study(
            functools.partial(scene, name.partition("_to_")[0]),
            schemes=schemes,
            results=results / name,
            **{"repetitions": 1 if quick else 7} | example(quick),
        )
        print(f"== {name}, {perf_counter() - start:.0f} s: {results / name}.md", flush=True)
        for quantity in studies[name].references:
            print("  ", work_precision.sentence(studies[name], quantity))
    cells, pictures = write_overview(results, studies)
    if docs:
        renew_docs(results, cells, pictures)
    return studies


if __name__ == "__main__":
    # The tables have a column for halved steps, so their warnings are not needed.
    logging.getLogger("fx_beam").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a short form, under a minute")
    parser.add_argument("--docs", action="store_true", help="renew the docs' table and pictures")
    parser.add_argument("results", nargs="?", type=Path, help="directory to write to")
    arguments = parser.parse_args()
    more = {"results": arguments.results} if arguments.results else {}
    main(arguments.quick, docs=arguments.docs, **more)
