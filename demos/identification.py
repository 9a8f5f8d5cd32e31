r"""Identification: stiffness, density and damping of two members, and the friction of their hinge.

Two flexible members, a double pendulum with a known mass at its tip, fall from rest. The paths of
the hinge and of the tip are measured, with noise. Objective: the seven numbers

$$ x = (E_1, E_2, \rho_1, \rho_2, \tau_1, \tau_2, M) $$

of the members, Young's modulus $E$, density $\rho$ and the retardation time $\tau$ of a
Kelvin-Voigt material, and the moment $M$ of the hinge's Coulomb friction, with intervals of 95 %.

This example is our own. The measurement is a motion that was computed with known numbers, plus
independent normal noise of the standard deviation $\sigma$. The numbers minimise

$$ \chi^2 = \sum \frac{(y(x) - y_m)^2}{\sigma^2} $$

over all measured values $y_m$, in terms of their logarithms $z$, $x = x_0 \exp(z)$, by the method
of Gauss and Newton. It needs the derivatives $J$ of $y/\sigma$ by $z$. `Response.jacobian` gives
them, exact to the steps, from the motion that has just been computed; otherwise they are
differences of motions, one for each number. Where the noise is small, $(J^T J)^{-1}$ is the
covariance of $z$.

A short time is fitted first: $\chi^2$ of a long motion has many minima, as vibrations come out of
step. In this small scene $J$ takes as long as seven differences of motions; $J$ needs no choice of
a step, and is exact. Units are metre, kilogram and second.
"""

import logging
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy.optimize import least_squares

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

NAMES = ("E1", "E2", "rho1", "rho2", "tau1", "tau2", "friction")
TRUE = np.array([2.0e9, 1.2e9, 1200.0, 1000.0, 4e-3, 8e-3, 0.02])  # [Pa, kg/m³, s, N m]
GUESS = TRUE * np.array([0.85, 1.2, 1.15, 0.85, 1.5, 0.6, 1.6])  # x0
LENGTHS, HEIGHT, WIDTH = (0.5, 0.4), 3e-3, 20e-3  # [m]
TIP = 0.05  # [kg]; without it only ratios of the numbers change the motion
ELEMENTS, DT = 20, 1.25e-3  # per member, [s]
ROWS = fb.Record(every=2)  # what is measured
STAGES, NOISE, SEED = (0.2, 0.8), 2e-4, 1  # ends [s] of the motions that are fitted; sigma [m]
QUANTILE = 1.96  # of 95 %


def build(x):
    """The double pendulum of seven numbers, and what is measured."""
    E1, E2, rho1, rho2, tau1, tau2, friction = x
    scene = fb.Scene(gravity=(0.0, -9.81))
    members, start = [], (0.0, 0.0)
    for E, rho, tau, length in ((E1, rho1, tau1, LENGTHS[0]), (E2, rho2, tau2, LENGTHS[1])):
        shape = fb.Section.rectangle(height=HEIGHT, width=WIDTH, E=E, rho=rho)
        section = replace(shape, retardation=tau)
        end = (start[0] + length, 0.0)
        members.append(scene.add_beam([start, end], section, elements=ELEMENTS))
        start = end
    first, second = members
    scene.pin(first.start)
    scene.add_mass(second.end, TIP)
    coulomb = fb.SmoothFriction(friction, speed=0.5)
    scene.add_joint(fb.Revolute(first.end, second.start, friction=coulomb))
    return scene, {
        "hinge": fb.Output("position", first.end),
        "tip": fb.Output("position", second.end),
    }


class Fit:
    """The deviation of a motion to some time from the measured one, and its derivatives."""

    def __init__(self, t_end, measured):
        self.run = fb.Response(build, dt=DT, t_end=t_end, record=ROWS)
        rows = round(t_end / DT) // ROWS.every + 1
        self.measured = {name: path[:rows] for name, path in measured.items()}
        self.motions, self._z = 0, None

    def deviation(self, z):
        """Deviations of all measured values, in terms of the noise."""
        self.motions, self._z = self.motions + 1, z.copy()
        _, y = self.run(GUESS * np.exp(z))
        return np.concatenate([((y[name] - self.measured[name]) / NOISE).ravel() for name in y])

    def jacobian(self, z):
        """Their derivatives J (values, numbers)."""
        if not np.array_equal(z, self._z):
            self.deviation(z)
        J = self.run.jacobian()
        rows = [J[name].reshape(-1, len(z)) / NOISE for name in J]
        return np.concatenate(rows) * GUESS * np.exp(z)


def measurement(t_end=STAGES[-1]):
    """Times, and the paths with noise."""
    t, y = fb.Response(build, dt=DT, t_end=t_end, record=ROWS)(TRUE)
    rng = np.random.default_rng(SEED)
    return t, {name: path + NOISE * rng.standard_normal(path.shape) for name, path in y.items()}


def identified(measured, stages, differences):
    """Logarithms $z$ of the numbers, $J$ there, and what it took."""
    z, motions, seconds = np.zeros(len(NAMES)), 0, perf_counter()
    for t_end in stages:
        fit = Fit(t_end, measured)
        fitted = least_squares(fit.deviation, z, jac="2-point" if differences else fit.jacobian)
        z, motions = fitted.x, motions + fit.motions
    seconds = perf_counter() - seconds
    log.info("%s: %d motions, %.2f s", "differences" if differences else "J", motions, seconds)
    chi_2 = 2 * fitted.cost / fitted.fun.size
    return z, fitted.jac, {"motions": motions, "seconds": seconds, "chi^2 per value": chi_2}


def compute(stages=STAGES):
    """The numbers, and what is drawn."""
    t, measured = measurement(stages[-1])
    Fit(2 * DT, measured).jacobian(np.zeros(len(NAMES)))  # compiles
    z, J, jacobian_motions = identified(measured, stages, differences=False)
    other, _, difference_motions = identified(measured, stages, differences=True)
    half_width = QUANTILE * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    x = GUESS * np.exp(z)
    numbers = {
        "with the Jacobian": jacobian_motions,
        "with differences": difference_motions,
        "largest difference of z": float(abs(z - other).max()),
    }
    for i, name in enumerate(NAMES):
        numbers[name] = {
            "true": TRUE[i],
            "guess": GUESS[i],
            "found": x[i],
            "relative half width of 95 %": half_width[i],
            "inside": bool(abs(np.log(TRUE[i]) - np.log(x[i])) <= half_width[i]),
        }
    run = fb.Response(build, dt=DT, t_end=stages[-1], record=ROWS)
    paths = [run(point)[1] for point in (GUESS, x)]
    return numbers, (t, measured, *paths, x, half_width)


def report(numbers):
    row = "{:>9} {:>12} {:>12} {:>12} {:>10}".format
    print(row("", "true", "guess", "found", "+- [%]"))
    for name in NAMES:
        own = numbers[name]
        shown = (f"{own[key]:.5g}" for key in ("true", "guess", "found"))
        print(row(name, *shown, f"{100 * own['relative half width of 95 %']:.2g}"))
    for how in ("with the Jacobian", "with differences"):
        own = numbers[how]
        print(
            f"{how}: {own['motions']} motions, {own['seconds']:.2f} s, "
            f"chi^2 {own['chi^2 per value']:.3f} of each value"
        )


def draw(results, t, measured, guessed, fitted, x, half_width):
    # Imported here: the numbers need no matplotlib.
    from fx_beam import plot
    from shared import thumbnail

    swinging, _ = build(x)
    swing = fb.simulate(swinging, dt=DT, t_end=STAGES[-1])
    plot.animate(swing, results / "motion.gif")
    thumbnail.card(swing, range(0, len(swing.t), 8), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.2)
    errors, bars = axes.flat
    for path, colour, label in ((guessed, "#D55E00", "guess"), (fitted, "#0072B2", "identified")):
        apart = np.hypot(*(path["tip"] - measured["tip"]).T)
        errors.semilogy(t, 1e3 * apart, color=colour, lw=1, label=label)
    errors.axhline(1e3 * NOISE, color="0.5", lw=1)
    errors.set(xlabel="time $t$ [s]", ylabel="tip from its measured place [mm]", ylim=(1e-2, None))
    rows = np.arange(len(NAMES))[::-1]
    labels = "$E_1$", "$E_2$", "$\\rho_1$", "$\\rho_2$", "$\\tau_1$", "$\\tau_2$", "$M$"
    bars.axvline(1, color="0.5", lw=1)
    bars.plot(GUESS / TRUE, rows, "x", color="#D55E00")
    ratio = x / TRUE
    ends = ratio - ratio * np.exp(-half_width), ratio * np.exp(half_width) - ratio
    look = {"fmt": "o", "ms": 4, "capsize": 3, "color": "#0072B2"}
    bars.errorbar(ratio, rows, xerr=ends, **look)
    bars.set(yticks=rows, yticklabels=labels, xlabel="number over its true value, 95 %")
    plot.save(figure, results / "identified.png")


if __name__ == "__main__":
    script.run()
