r"""Whip taper: the heights of a whip whose tip becomes as fast as possible, at a given mass.

A flexible strip of the length $L$ is turned at its root by the angle $A$ within the time $T$, and
held:

$$ \psi = A \left(s - \frac{\sin 2 \pi s}{2 \pi}\right), \qquad s = \frac{t}{T}. $$

Objective: the heights $h_1, \ldots, h_n$ of its elements for which the largest speed of the tip is
highest, at a given mass, where no height is less than a fraction of their mean. References: the
uniform strip; the best linear taper, which is found by its one number; differences of motions for
the gradient; and the found whip with shorter steps and elements. This example is our own.

The largest speed over time has jumps in its derivative where another time takes over. It is
smoothed by the $p$-norm of the speeds $v$ of the steps, 4 to 8 % above the largest:

$$ V^p = \sum v^p, \qquad p = 30. $$

`Response` gives the motion, and by `vjp` the gradient of $V$ by all heights, from the same motion
backwards. The speed of a step is the way of the tip over $\Delta t$, so that $V$ is a function of
positions. Mass and bound hold by scaling, with free numbers $z$ and the mean height $H$:

$$ h_i = H (b + (1 - b)\,n q_i), \qquad q_i = \frac{1}{Z} \exp(z_i) $$

in which $Z$ is the sum of all $\exp(z_j)$. SciPy's L-BFGS maximises $V$ over $z$, from the best
linear taper. At a maximum the gain

$$ g_i = \frac{\mathrm{d}V}{\mathrm{d}h_i} - G $$

of an element at a given mass is zero, or negative where its height is the least. $G$ is the mean of
all $\mathrm{d}V/\mathrm{d}h_j$ with the weights $q_j$. There may be other maxima. Units are metre,
kilogram and second.
"""

from dataclasses import replace
from time import process_time

import numpy as np
from scipy.optimize import minimize, minimize_scalar

import fx_beam as fb
from shared import script

LENGTH, WIDTH = 1.0, 0.02  # L [m], across the plane [m]
HEIGHT, LEAST = 3e-3, 0.3  # mean height H [m]; least one b, over the mean
MATERIAL = {"E": 3e9, "rho": 1200.0}  # [Pa, kg/m³], a plastic
RETARDATION = 2e-3  # of a Kelvin-Voigt material [s]
ANGLE, TURN = 1.5, 0.3  # A [rad], T [s]
ELEMENTS, DT, T_END = 12, 2e-3, 0.6  # n, [s], [s]
POWER = 30  # p
ITERATIONS = 25  # at most
RECORD = fb.Record(rates=False, forces=False)
DIFFERENCE = 1e-5  # of heights over their mean, for differences of motions
REPEATS = 3  # of what is timed
LIMIT = 12.0  # of colours [m/s]


def root(t):
    """Angle of the root."""
    s = min(t / TURN, 1.0)
    return ANGLE * (s - np.sin(2 * np.pi * s) / (2 * np.pi))


def whip(x, elements=ELEMENTS):
    """The whip whose heights over their mean are $x$, in pieces of equal length."""
    heights = HEIGHT * np.asarray(x)
    last = len(heights) - 1

    def height(fraction):
        return heights[min(int(fraction * len(heights)), last)]

    shape = fb.Section.rectangle(height=height, width=WIDTH, **MATERIAL)
    section = replace(shape, retardation=RETARDATION)
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], section, elements=elements)
    scene.fix(beam.start, "x", "y")
    scene.prescribe(beam.start, rotation=root)
    return scene, {"tip": fb.Output("position", beam.end)}


class Peak:
    """The largest speed of the tip, smoothed, and its gradient by the heights over their mean."""

    def __init__(self):
        self.run = fb.Response(whip, dt=DT, t_end=T_END, record=RECORD)

    def velocities(self, x):
        """Times of mid-points of the steps, mean velocities and speeds of the tip in them."""
        t, y = self.run(x)
        velocity = np.diff(y["tip"], axis=0) / DT
        return (t[1:] + t[:-1]) / 2, velocity, np.hypot(*velocity.T)

    def value(self, x):
        """The p-norm V of the speeds."""
        return self._smoothed(self.velocities(x)[2])

    @staticmethod
    def _smoothed(speed):
        largest = speed.max()
        return largest * ((speed / largest) ** POWER).sum() ** (1 / POWER)

    def gradient(self, x):
        """V and dV/dx."""
        _, velocity, speed = self.velocities(x)
        V = self._smoothed(speed)
        slope = ((speed / V) ** (POWER - 2))[:, None] * velocity / (V * DT)
        weights = np.zeros((len(speed) + 1, 2))
        weights[1:] += slope
        weights[:-1] -= slope
        return V, self.run.vjp({"tip": weights})

    def differences(self, x):
        """dV/dx by central differences of motions."""
        steps = DIFFERENCE * np.eye(len(x))
        return np.array([self.value(x + h) - self.value(x - h) for h in steps]) / (2 * DIFFERENCE)


def linear(slope):
    """Heights over their mean from 1 + slope at the root to 1 - slope at the tip."""
    middles = (np.arange(ELEMENTS) + 0.5) / ELEMENTS
    return 1 + slope * (1 - 2 * middles)


def scaled(z):
    """Heights over their mean of the free numbers $z$, and shares $q$ of what is above $b$."""
    q = np.exp(z - z.max())
    q /= q.sum()
    return LEAST + (1 - LEAST) * len(z) * q, q


def best_linear(peak):
    """The best linear taper that is nowhere below the least height at the ends."""
    least = minimize_scalar(
        lambda slope: -peak.value(linear(slope)), bounds=(0.0, 1 - LEAST), method="bounded"
    )
    return linear(least.x)


def optimised(peak, x):
    """The heights of the whip of the fastest tip near $x$, and the number of gradients."""
    unit = peak.value(x)

    def cost(z):
        x, q = scaled(z)
        V, slopes = peak.gradient(x)
        z_slope = (1 - LEAST) * len(z) * q * (slopes - q @ slopes)
        return -V / unit, -z_slope / unit

    z = np.log(x - LEAST)
    options = {"maxiter": ITERATIONS, "ftol": 1e-5}
    optimum = minimize(cost, z, jac=True, method="L-BFGS-B", options=options)
    return scaled(optimum.x)[0], optimum.nfev


def refined(x):
    """Largest speed of the tip with half the steps and half the elements."""
    scene, outputs = whip(x, elements=2 * len(x))
    solution = fb.simulate(scene, dt=DT / 2, t_end=T_END, record=RECORD, progress=False)
    tip = solution.position(outputs["tip"].of)
    return float(np.hypot(*np.diff(tip, axis=0).T).max() / (DT / 2))


def timed(function, x):
    """Least time of some calls [s]."""
    seconds = []
    for _ in range(REPEATS):
        start = process_time()
        function(x)
        seconds.append(process_time() - start)
    return min(seconds)


def compute():
    """The numbers, and what is drawn."""
    peak = Peak()
    uniform = np.ones(ELEMENTS)
    taper = best_linear(peak)
    peak.gradient(taper)  # compiles
    start = process_time()
    best, gradients = optimised(peak, taper)
    seconds = process_time() - start
    whips = {"uniform": uniform, "linear": taper, "optimised": best}
    numbers, drawn = {}, {}
    for name, x in whips.items():
        t, _, speed = peak.velocities(x)
        V, slopes = peak.gradient(x)
        numbers[name] = {
            "largest speed": speed.max(),
            "time": t[speed.argmax()],
            "smoothed": V,
            "refined": refined(x),
            "mass": MATERIAL["rho"] * WIDTH * HEIGHT * LENGTH * x.mean(),
            "heights": (1e3 * HEIGHT * x).tolist(),
        }
        # At a given mass: a height grows, and all others lose as they do by scaling.
        share = (x - LEAST) / (x - LEAST).sum()
        gain = slopes - share @ slopes
        drawn[name] = x, t, speed, gain
        numbers[name]["gain"] = gain.tolist()
    _, slopes = peak.gradient(taper)
    error = abs(peak.differences(taper) - slopes).max() / abs(slopes).max()
    numbers["gradient"] = {
        "error by differences": error,
        "evaluations": gradients,
        "seconds of all": seconds,
        "seconds of one": timed(peak.gradient, taper),
        "seconds of one motion": timed(peak.value, taper),
    }
    return numbers, (drawn,)


def report(numbers):
    print("      whip  largest speed [m/s]  at [s]  refined [m/s]  smoothed [m/s]")
    for name in ("uniform", "linear", "optimised"):
        own = numbers[name]
        print(
            f"{name:>10} {own['largest speed']:20.2f} {own['time']:7.3f} {own['refined']:14.2f} "
            f"{own['smoothed']:15.2f}"
        )
    own = numbers["gradient"]
    motion, seconds_of_gradient = own["seconds of one motion"], own["seconds of one"]
    print(
        f"{own['evaluations']} motions with gradients in {own['seconds of all']:.1f} s. "
        f"One takes {1e3 * seconds_of_gradient:.0f} ms, a motion {1e3 * motion:.1f} ms:\n"
        f"differences of {ELEMENTS + 1} motions would take {1e3 * (ELEMENTS + 1) * motion:.0f} ms, "
        f"central ones of {2 * ELEMENTS} {2e3 * ELEMENTS * motion:.0f} ms.\n"
        f"The gradient differs from central ones by {own['error by differences']:.1e} of its "
        "largest entry."
    )


def draw(results, drawn):
    # Imported here: the numbers need no matplotlib.
    from matplotlib.collections import PolyCollection

    from fx_beam import plot
    from shared import thumbnail

    tapered, _ = whip(drawn["optimised"][0])
    stroke = fb.simulate(tapered, dt=DT, t_end=T_END)
    plot.animate(stroke, results / "motion.gif")
    thumbnail.card(stroke, range(0, len(stroke.t), 6), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.4)
    shapes, speeds = axes.flat
    shapes.grid(False)
    looks = {"uniform": "0.5", "linear": "#E69F00", "optimised": "#0072B2"}
    for row, (name, (x, t, speed, slopes)) in enumerate(drawn.items()):
        middle, edges = -2.2 * row, np.linspace(0, LENGTH, len(x) + 1)
        boxes = [
            [(a, middle - h / 2), (b, middle - h / 2), (b, middle + h / 2), (a, middle + h / 2)]
            for a, b, h in zip(edges[:-1], edges[1:], x, strict=True)
        ]
        pieces = PolyCollection(boxes, cmap="RdBu_r", edgecolors="0.3", linewidths=0.5)
        pieces.set_array(slopes)
        pieces.set_clim(-LIMIT, LIMIT)
        shapes.add_collection(pieces)
        shapes.text(0.0, middle + 1.05, name, fontsize="small", color=looks[name])
        speeds.plot(t, speed, color=looks[name], label=name)
    figure.colorbar(pieces, ax=shapes, extend="both", label="gain $g_i H$ of the peak [m/s]")
    shapes.set(
        xlim=(-0.02, 1.02), ylim=(-5.6, 1.6), yticks=[], xlabel="position along the whip [m]"
    )
    speeds.set(xlabel="time $t$ [s]", ylabel="speed of the tip [m/s]")
    plot.save(figure, results / "taper.png")


if __name__ == "__main__":
    script.run()
