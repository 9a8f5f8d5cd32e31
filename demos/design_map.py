r"""Design map of a slider crank: how far its rod bends, over its height and the speed.

The slider crank of demos/slider_crank.py with rods of many heights, at many speeds. Objective: a
map of the largest deflection of the rod, from which a designer reads the thinnest rod for a speed,
and speeds that are better avoided.

This example is our own. The crank starts from rest and turns at $n$ turns a second after two turns;
then three more turns follow. The rod bends under its own inertia, with forces at all multiples of
$n$. It is in resonance where one of them is the lowest frequency of its bending between its pins,

$$ k n = f = \frac{\pi h}{2 l^2} \sqrt{\frac{E}{12 \rho}}, \qquad k = 2, 3, \ldots $$

A rod that is far stiffer bends by $w \sim (n/h)^2$, as its mass is proportional to $h$ and its
stiffness to $h^3$: on a straight line through the origin of the map the deflection is constant. At
high speeds the crank, which is always the same, bends as well, and also shakes stiff rods.

Each point of the map is a case of `fx_beam.sweep`, which uses all cores. Runs in which the rod
bends so far that a step fails are rows with an error, and blank on the map. Units are metre,
kilogram and second.
"""

import itertools
from time import perf_counter

import numpy as np

import fx_beam as fb
import monte_carlo
import slider_crank
from monte_carlo import NOMINAL, RAMP, STEPS, TURNS
from shared import script

HEIGHTS, SPEEDS = (2.5e-3, 7e-3), (5.0, 20.0)  # h [m]; n [1/s]
POINTS = 32, 24  # heights, speeds
ALLOWED = 0.01  # largest deflection of a design, over the rod's length
MULTIPLES = (2, 3, 4, 5, 6)  # k


def bent(case):
    """Largest deflection of the rod of a case, over its length; what the workers compute."""
    mechanism, _ = monte_carlo.scene(NOMINAL | {"h": case["height"], "T": 1 / case["speed"]})
    dt, t_end = 1 / (STEPS * case["speed"]), (RAMP + TURNS) / case["speed"]
    record = fb.Record(rates=False, forces=False)
    solution = fb.simulate(mechanism, dt=dt, t_end=t_end, max_halvings=2, record=record)
    return {"deflection": abs(slider_crank.deflection(solution)).max() / slider_crank.LENGTH}


def compute(points=POINTS, executor=None):
    """The numbers, and what is drawn."""
    heights, speeds = (
        np.linspace(*ends, n) for ends, n in ((HEIGHTS, points[0]), (SPEEDS, points[1]))
    )
    # Stiff rods first: they are the ones that cannot fail.
    pairs = itertools.product(heights[::-1].tolist(), speeds.tolist())
    cases = [{"height": height, "speed": speed} for height, speed in pairs]
    clock = perf_counter()
    table = fb.sweep(bent, cases, executor)
    seconds = perf_counter() - clock
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    deflections = [np.nan if row["error"] else row["deflection"] for row in rows]
    deflection = np.reshape(deflections, points)[::-1]
    numbers = {
        "points": len(cases),
        "failed": int(np.isnan(deflection).sum()),
        "smallest deflection": np.nanmin(deflection),
        "largest deflection": np.nanmax(deflection),
        "thinnest rod": {
            f"{speed:.3g} turns a second": thinnest(heights, column)
            for speed, column in zip(speeds, deflection.T, strict=True)
        },
        "seconds": seconds,
    }
    return numbers, (heights, speeds, deflection)


def thinnest(heights, deflection):
    """Height from which on all rods bend by less than is allowed; None if none does."""
    fine = np.append(np.nan_to_num(deflection, nan=np.inf) < ALLOWED, False)
    first = len(heights) if not fine[-2] else np.flatnonzero(~fine[:-1]).max(initial=-1) + 1
    return float(heights[first]) if first < len(heights) else None


def report(numbers):
    print(
        f"{numbers['points']} runs in {numbers['seconds']:.1f} s, {numbers['failed']} failed.\n"
        f"The rod bends by {numbers['smallest deflection']:.2g} to "
        f"{numbers['largest deflection']:.2g} of its length.\n"
        f"Thinnest rod from which on all bend by less than {ALLOWED:g} of it:"
    )
    for speed, height in numbers["thinnest rod"].items():
        print(f"{speed:>24}: " + (f"{1e3 * height:.2f} mm" if height else "none of these"))


def draw(results, heights, speeds, deflection):
    # Imported here: the numbers need no matplotlib.
    from fx_beam import plot

    thin = NOMINAL | {"h": HEIGHTS[0], "T": 1 / 14}
    monte_carlo.film(thin, results / "thumbnail.png")
    figure, axes = plot.figure(1, 1, height=4.5)
    (ax,) = axes.flat
    ax.grid(False)
    x, y = speeds, 1e3 * heights
    percent = 100 * deflection
    norm = {"norm": "log", "vmin": np.nanmin(percent), "vmax": np.nanmax(percent)}
    colours = ax.pcolormesh(x, y, percent, cmap="viridis", shading="nearest", **norm)
    figure.colorbar(colours, label="largest deflection of the rod [% of its length]")
    if np.nanmin(deflection) < ALLOWED < np.nanmax(deflection):
        ax.contour(x, y, percent, [100 * ALLOWED], colors="white")
    f = monte_carlo.frequency(NOMINAL) / NOMINAL["h"]  # for each metre of height
    n = np.array(SPEEDS)
    for k in MULTIPLES:
        label = "a multiple of the speed is the rod's frequency" if k == MULTIPLES[0] else None
        ax.plot(n, 1e3 * k * n / f, color="#D55E00", ls="--", lw=1, label=label)
    ax.set(xlim=SPEEDS, ylim=1e3 * np.array(HEIGHTS))
    ax.set(xlabel="speed $n$ [turns a second]", ylabel="height of the rod $h$ [mm]")
    plot.save(figure, results / "map.png")


if __name__ == "__main__":
    script.run()
