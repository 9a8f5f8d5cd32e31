r"""Scatter of a slider crank's peak moment: a Monte Carlo study with 1000 samples.

The slider crank of demos/slider_crank.py is built many times, each time with other dimensions and
another steel, as a workshop would. Objective: the distribution of the largest bending moment in the
rod, its mean and standard deviation, and the moment that 99 % of the mechanisms do not exceed.
These are compared with a linear estimate from the slopes of the moment at the nominal values.

This example is our own. The height $h$ of the rod, its modulus $E$, the mass $m$ of the slider and
the period $T$ of a turn are normally distributed about their nominal values, independent of one
another, with standard deviations of 2, 2, 3 and 1 %. With the moment $M(p)$ and its slopes at the
nominal values, from central differences over one standard deviation, linear error propagation gives
the standard deviation of the moment,

$$
\sigma_M^2 = \sum_i \left(\frac{\partial M}{\partial p_i}\right)^2 \sigma_i^2.
$$

The moment is not that linear: the fifth multiple of the speed, 50 Hz, is near the lowest frequency
of the rod's bending between its pins, with which the moment rises and falls,

$$
f = \frac{\pi}{2 l^2} \sqrt{\frac{EI}{\rho A}} = \frac{\pi h}{2 l^2} \sqrt{\frac{E}{12 \rho}}.
$$

Each sample is a case of `fx_beam.sweep`, which uses all cores. A mean of $n$ samples has a standard
error of $\sigma_M/\sqrt{n}$. Units are metre, kilogram and second.
"""

from time import perf_counter

import numpy as np

import fx_beam as fb
import slider_crank
from shared import script
from slider_crank import CRANK, ELEMENTS, LENGTH, RADIUS, STEEL

NOMINAL = {"h": 4e-3, "E": STEEL["E"], "m": slider_crank.SLIDER, "T": slider_crank.PERIOD}
SCATTER = {"h": 0.02, "E": 0.02, "m": 0.03, "T": 0.01}  # standard deviations, relative
SAMPLES, SEED = 1000, 1
RAMP, TURNS = 2, 3  # turns in which the crank reaches its speed, and at constant speed
STEPS = 100  # in a turn


def scene(case):
    """The mechanism of a case, and its rod."""
    speed, ramp = 2 * np.pi / case["T"], RAMP * case["T"]

    def angle(t):
        s = min(t / ramp, 1.0)
        return speed * (ramp * (s**6 - 3 * s**5 + 2.5 * s**4) + max(t - ramp, 0.0))

    steel = STEEL | {"E": case["E"]}
    mechanism = fb.Scene()
    crank = mechanism.add_beam([(0, 0), (RADIUS, 0)], CRANK, ELEMENTS["crank"], name="crank")
    rod = mechanism.add_beam(
        [(RADIUS, 0), (RADIUS + LENGTH, 0)],
        fb.Section.rectangle(height=case["h"], **steel),
        ELEMENTS["rod"],
        name="rod",
    )
    mechanism.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=angle))
    mechanism.add_joint(fb.Revolute(crank.end, rod.start))
    mechanism.add_joint(fb.PinInSlot(fb.GROUND, rod.end, axis=(1, 0)))
    mechanism.add_mass(rod.end, case["m"])
    return mechanism, rod


def peak(case):
    """Largest bending moment [N m] in the rod of a case; what the workers compute."""
    mechanism, rod = scene(case)
    dt = case["T"] / STEPS
    record = fb.Record(rates=False)
    solution = fb.simulate(mechanism, dt=dt, t_end=(RAMP + TURNS) * case["T"], record=record)
    return {"moment": abs(solution.resultants(rod).M).max()}


def sampled(samples):
    """Cases: normally distributed parameters by name."""
    draws = 1 + np.random.default_rng(SEED).standard_normal((samples, 4)) * [*SCATTER.values()]
    draws *= [*NOMINAL.values()]
    return [dict(zip(NOMINAL, draw, strict=True)) for draw in draws.tolist()]


def shifted(name, deviations):
    """The nominal case with one parameter off by so many of its standard deviations."""
    return NOMINAL | {name: NOMINAL[name] * (1 + deviations * SCATTER[name])}


def column(table, name):
    """A column of a table of `fx_beam.sweep`, with or without pandas."""
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    assert not any(row["error"] for row in rows)
    return np.array([row[name] for row in rows])


def compute(samples=SAMPLES, executor=None):
    """The numbers, and what is drawn."""
    around = [NOMINAL, *(shifted(name, side) for name in NOMINAL for side in (-1, 1))]
    clock = perf_counter()
    # One sweep: the first of its cases compiles the forms, the others follow on all workers.
    moments = column(fb.sweep(peak, [*around, *sampled(samples)], executor), "moment")
    seconds = perf_counter() - clock
    (nominal, *neighbours), scattered = np.split(moments, [len(around)])
    effects = {
        name: (after - before) / 2
        for name, before, after in zip(NOMINAL, neighbours[::2], neighbours[1::2], strict=True)
    }
    numbers = {
        "samples": samples,
        "nominal": nominal,
        "mean": scattered.mean(),
        "standard error of the mean": scattered.std(ddof=1) / np.sqrt(samples),
        "standard deviation": scattered.std(ddof=1),
        "99 % stay below": np.quantile(scattered, 0.99),
        "linear standard deviation": np.hypot.reduce([*effects.values()]),
        "effect of one standard deviation": effects,
        "lowest frequency of the rod": frequency(NOMINAL),
        "seconds": seconds,
    }
    return numbers, (scattered, numbers)


def frequency(case):
    """Lowest frequency [Hz] of the rod's bending between its pins."""
    return np.pi * case["h"] / (2 * LENGTH**2) * np.sqrt(case["E"] / (12 * STEEL["rho"]))


def film(case, path):
    """The last turn of the mechanism as a thumbnail."""
    from shared import thumbnail

    mechanism, _ = scene(case)
    motion = fb.simulate(mechanism, dt=case["T"] / STEPS, t_end=(RAMP + TURNS) * case["T"])
    rows = range(len(motion.t) - STEPS, len(motion.t), 2)
    thumbnail.card(motion, rows, path)


def report(numbers):
    print(
        f"Largest bending moment in the rod [N m], {numbers['samples']} samples in "
        f"{numbers['seconds']:.1f} s:"
    )
    for name in ("nominal", "mean", "standard error of the mean", "standard deviation"):
        print(f"{name:>30} {numbers[name]:8.4f}")
    print(f"{'by linear error propagation':>30} {numbers['linear standard deviation']:8.4f}")
    print(f"{'99 % stay below':>30} {numbers['99 % stay below']:8.4f}")
    print("Change with one standard deviation of")
    for name, effect in numbers["effect of one standard deviation"].items():
        print(f"{name:>30} {effect:8.4f}")


def draw(results, moments, numbers):
    # Imported here: the numbers need no matplotlib.
    from fx_beam import plot

    film(NOMINAL, results / "thumbnail.png")
    figure, axes = plot.figure(1, 1)
    (ax,) = axes.flat
    ax.hist(moments, bins=max(round(np.sqrt(len(moments))), 5), color="#0072B2", density=True)
    m = np.linspace(moments.min(), moments.max(), 200)
    std = numbers["linear standard deviation"]
    bell = np.exp(-(((m - numbers["nominal"]) / std) ** 2) / 2) / (np.sqrt(2 * np.pi) * std)
    ax.plot(m, bell, color="#D55E00", label="linear error propagation")
    ax.axvline(numbers["99 % stay below"], color="0.4", ls="--", label="99 % stay below")
    ax.set(xlabel="largest bending moment in the rod [N m]", ylabel="density [1/(N m)]")
    plot.save(figure, results / "histogram.png")


if __name__ == "__main__":
    script.run()
