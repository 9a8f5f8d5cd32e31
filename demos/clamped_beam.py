r"""A clamped beam over its amplitude: backbone, shapes, and where other modes join in.

A beam between two clamps that cannot move is pulled taut by its deflection: its frequency grows
with the amplitude, and its shape changes. Objective: the family of free motions of its first mode,
by `fx_beam.backbone`, up to seven radii of gyration.

Reference: a single mode. With $w = a(t)\,\varphi(x)$, $\varphi$ the first mode of a clamped beam
with $\varphi = 1$ in the middle, and the axial force $\frac{EA}{2 l} \int w'^2\,\mathrm{d}x$ of a
slender beam, Galerkin's method gives Duffing's equation, with the radius of gyration
$r = \sqrt{EI/EA}$:

$$
\ddot a + \omega_0^2 \left(1 + g \frac{a^2}{r^2}\right) a = 0, \quad
\omega_0^2 = \beta^4 \frac{EI}{\rho A}, \quad \beta l = 4.7300,
$$

$$
g = \frac{\left(\int \varphi'^2\,\mathrm{d}x\right)^2}
{2 l \beta^4 \int \varphi^2\,\mathrm{d}x} = 0.0599.
$$

Its frequency at the amplitude $A$, with $e = g (A/r)^2$, is $\omega_0 \pi \sqrt{1 + e}/(2 K(m))$,
$K$ the complete elliptic integral with the parameter $m = e/(2 + 2 e)$. One mode is a little too
stiff, since the shape of the beam is free to change.

The taut beam's modes come closer to those of a string, 1 : 2 : 3, and meet whole-number ratios:

- Near $A = 2.3\,r$ the third mode is five times as fast as the first. There the curve has a tongue,
  on which the motion passes over to the third mode, until it is that mode alone. It is narrow: with
  long steps the continuation passes it, with short ones it follows it. It ends on the backbone of
  the third mode, at a fifth of its frequency.
- Near $A = 7\,r$ the second mode is twice as fast. The axial force of the first mode lets it grow:
  the motions are unstable. By Galerkin's method a small amplitude $b$ of the second mode
  $\varphi_2$ follows Hill's equation $\ddot b + (\omega_2^2 + h a^2) b = 0$ with
  $h = \frac{EA}{2 l\,\rho A} \int \varphi'^2\,\mathrm{d}x \int \varphi_2'^2\,\mathrm{d}x$ for
  $\int \varphi_2^2\,\mathrm{d}x = 1$. It grows where the sum of its two multipliers in a period of
  the first mode is above 2.
"""

import logging

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.special import ellipk

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS = 1 / 200  # of gyration, relative to the length
SECTION = fb.Section(EA=RADIUS**-2, GA=10 * RADIUS**-2, EI=1.0, rhoA=1.0)  # length 1
ELEMENTS, DEGREE, STEPS = 4, 3, 41
SCHEME = fb.EnergyMomentum(order=4)
LARGEST = 8.0  # A/r of a single mode with the energy at which the backbone ends
LONG, SHORT = 0.1, 0.03  # steps of the continuation
# Into the tongue: a family begins at a twentieth of the amplitude given, here 2.1 r.
BEFORE, MOST = 42.0, 25
SHOWN = (1.0, 4.0, 7.0)  # A/r of the shapes
EDGES = (5.0, 6.9), (6.9, 8.5)  # A/r between which the second mode begins and ceases to grow
BETA = 4.730040744862704, 7.853204624095838  # beta l of the first two modes
GAUSS = np.polynomial.legendre.leggauss(40)


def scene():
    """The beam."""
    made = fb.Scene()
    beam = made.add_beam([(0, 0), (1, 0)], SECTION, ELEMENTS, DEGREE, name="beam")
    made.clamp(beam.start)
    made.clamp(beam.end)
    return made, beam


def mode_shape(x, number=0, derivative=0):
    r"""A mode of a clamped beam, with $\cos 0 = \cosh 0 = 1$ in its formula, or its derivative."""
    beta = BETA[number]
    z = beta * np.asarray(x)
    share = (np.cosh(beta) - np.cos(beta)) / (np.sinh(beta) - np.sin(beta))
    if derivative:
        return beta * (np.sinh(z) + np.sin(z) - share * (np.cosh(z) - np.cos(z)))
    return np.cosh(z) - np.cos(z) - share * (np.sinh(z) - np.sin(z))


def integrals(number):
    r"""Integrals of $\varphi^2$ and $\varphi'^2$ of a mode."""
    x, weights = (GAUSS[0] + 1) / 2, GAUSS[1] / 2
    return weights @ mode_shape(x, number) ** 2, weights @ mode_shape(x, number, 1) ** 2


def single_mode():
    """Stiffness $k$ of the first mode, for $EI = l = 1$, and the factor $g$ of its hardening."""
    squares, slopes = np.array(integrals(0)) / mode_shape(0.5) ** 2
    stiffness = BETA[0] ** 4 * squares
    return stiffness, slopes**2 / (2 * stiffness)


def trace_of_second_mode(amplitude):
    """Sum of the multipliers of the second mode in a period of the first; above 2 it grows."""
    g, (squares, slopes) = single_mode()[1], integrals(1)
    taut = integrals(0)[1] / mode_shape(0.5) ** 2 * slopes / squares / 2

    def rates(t, z):
        a, first, second = z[0], z[2:4], z[4:]
        back = -(BETA[1] ** 4) - taut * a**2
        first_force = -(BETA[0] ** 4) * (1 + g * a**2) * a
        return [z[1], first_force, first[1], back * first[0], second[1], back * second[0]]

    period = 2 * np.pi / (BETA[0] ** 2 * frequency_of(amplitude))
    start = [amplitude, 0, 1, 0, 0, 1]
    end = solve_ivp(rates, (0, period), start, rtol=1e-9, atol=1e-9).y[:, -1]
    return float(end[2] + end[5])


def energy_of(amplitude):
    """Energy [J] of a single mode with an amplitude $A/r$."""
    k, g = single_mode()
    return RADIUS**2 * k * (amplitude**2 / 2 + g * amplitude**4 / 4)


def frequency_of(amplitude):
    r"""Frequency of a single mode over $\omega_0$, with an amplitude $A/r$."""
    e = single_mode()[1] * np.asarray(amplitude) ** 2
    return np.pi * np.sqrt(1 + e) / (2 * ellipk(e / (2 * (1 + e))))


def deflections(motion, beam, times=2001):
    """Deflections (times, nodes) over r in a period, between its steps by their Fourier series."""
    nodes = motion.solution.nodes_of_beam[beam.name]
    path = motion.solution.q[:-1, nodes, 1] / RADIUS
    return np.fft.irfft(np.fft.rfft(path, axis=0) * (times / STEPS), times, axis=0)


def places(family, beam):
    """Places x (nodes,) of the deflections."""
    solution = family[0].solution
    return solution.X[solution.nodes_of_beam[beam.name], 0]


def middle(motion, beam):
    """Deflections (times,) of the middle over r."""
    rows = deflections(motion, beam)
    return rows[:, rows.shape[1] // 2]


def points(family, beam, linear):
    """Amplitudes of the middle over r (n,), and frequencies over that of small vibrations."""
    rows = [middle(motion, beam) for motion in family]
    return np.ptp(rows, axis=1) / 2, family.frequencies / linear


def shape(motion, beam):
    """Deflections (nodes,) over that of the middle, when this is largest."""
    row = deflections(motion, beam)[abs(middle(motion, beam)).argmax()]
    return row / row[len(row) // 2]


def linear_shape(x):
    """The first mode, 1 in the middle."""
    return mode_shape(x) / mode_shape(0.5)


def fifth(motion, beam):
    """Amplitude of the fifth harmonic in the middle, over that of the first."""
    harmonics = abs(np.fft.rfft(middle(motion, beam)))
    return float(harmonics[5] / harmonics[1])


def compute():
    """The numbers, and what is drawn."""
    made, beam = scene()
    linear = float(fb.modes(made, n=1).frequencies[0])
    options = {"steps": STEPS, "scheme": SCHEME}
    log.info("backbone of the first mode")
    first = fb.backbone(made, energy=energy_of(LARGEST), step=LONG, **options)
    log.info("the same with short steps, into the tongue")
    tongue = fb.backbone(made, amplitude=BEFORE * RADIUS, step=SHORT, most=MOST, **options)
    log.info("backbone of the third mode, to the same energy")
    third = fb.backbone(made, mode=2, energy=tongue[-1].energy, **options)
    amplitudes, ratios = points(first, beam, linear)
    x = places(first, beam)
    numbers = {
        "frequency of small vibrations over w0": 2 * np.pi * linear / BETA[0] ** 2,
        "amplitude": amplitudes.tolist(),
        "frequency": ratios.tolist(),
        "of a single mode": frequency_of(amplitudes).tolist(),
        "change of shape": [float(abs(shape(m, beam) - linear_shape(x)).max()) for m in first],
        "energies": first.energies.tolist(),
        "stable": first.stable.tolist(),
        "second mode grows": [
            float(brentq(lambda a: trace_of_second_mode(a) - 2, *ends, xtol=1e-4)) for ends in EDGES
        ],
        "stable in the tongue": bool(tongue.stable.all()),
        "fifth harmonic on the curve": max(fifth(motion, beam) for motion in first),
        "fifth harmonic in the tongue": fifth(tongue[-1], beam),
        "frequency in the tongue": float(tongue.frequencies[-1] / linear),
        "a fifth of that of the third mode": float(third.frequencies[-1] / linear / 5),
    }
    return numbers, (beam, linear, first, tongue, third)


def report(numbers):
    print(f"Small vibrations: {numbers['frequency of small vibrations over w0']:.5f} w0")
    columns = ("amplitude", "frequency", "of a single mode", "change of shape")
    rows = np.column_stack([numbers[name] for name in columns])
    print("   A/r   f/f0   single mode  deviation  change of shape")
    for a, f, single, change in rows[:: -(len(rows) // 6)][::-1]:
        print(f"{a:6.3f} {f:8.5f} {single:8.5f} {f / single - 1:11.2%} {change:11.4f}")
    away = [
        a for a, stable in zip(numbers["amplitude"], numbers["stable"], strict=True) if not stable
    ]
    low, high = numbers["second mode grows"]
    print(
        f"Unstable from {min(away):.2f} to {max(away):.2f} r; the second mode grows by Hill's "
        f"equation from {low:.2f} to {high:.2f} r"
    )
    print(
        f"End of the tongue: {numbers['frequency in the tongue']:.4f}, a fifth of the third mode's "
        f"{numbers['a fifth of that of the third mode']:.4f}; fifth over first harmonic "
        f"{numbers['fifth harmonic in the tongue']:.2f}"
    )


def draw(results, beam, linear, first, tongue, third):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", scene_unit="l")
    largest = first[-1].solution
    rows, path = range(len(largest.t)), results / "thumbnail.png"
    plot.animate(largest, results / "motion.gif", rows=rows, scene_unit="l", magnify=8.0)
    thumbnail.card(largest, rows, path, tall=8.0)
    figure, ((curve, zoom), (shapes, changes)) = plot.figure(2, 2, height=2.9)
    for axes in (curve, zoom):
        amplitudes = np.linspace(0, 1.05 * LARGEST, 200)
        axes.plot(frequency_of(amplitudes), amplitudes, "k--", lw=1, label="single mode")
        for family, color, label, unit in (
            (first, "#0072B2", "first mode", 1),
            (tongue, "#D55E00", "with short steps", 1),
            (third, "#009E73", "third mode, $f/5$", 5),
        ):
            a, f = points(family, beam, linear)
            axes.plot(f / unit, a, ".-", ms=4, lw=1, color=color, label=label)
            away = ~family.stable
            if not away.any():
                continue
            axes.plot(
                f[away] / unit, a[away], "o", ms=5, mfc="white", color=color, label="unstable"
            )
        axes.set(xlabel="frequency $f/f_0$", ylabel="amplitude of the middle $A/r$")
    zoom.set(xlim=(1.07, 1.17), ylim=(0, 3.2))
    draw_shapes(shapes, changes, beam, first, tongue)
    plot.save(figure, results / "backbone.png")


def draw_shapes(shapes, changes, beam, first, tongue):
    """Shapes over that of the middle, and how far they are from the mode of small vibrations."""
    nodes, x = places(first, beam), np.linspace(0, 1, 201)
    amplitudes = points(first, beam, 1.0)[0]
    drawn = [first[int(abs(amplitudes - a).argmin())] for a in SHOWN]
    drawn.append(tongue[-1])
    for motion, color in zip(drawn, ("#56B4E9", "#0072B2", "#000000", "#D55E00"), strict=True):
        smooth = CubicSpline(nodes, shape(motion, beam), bc_type="clamped")(x)
        size = np.ptp(middle(motion, beam)) / 2
        label = f"{size:.1f} r" + ", tongue" * (motion is tongue[-1])
        shapes.plot(x, smooth, color=color, lw=1.2, label=label)
        if motion is not tongue[-1]:
            changes.plot(x, 100 * (smooth - linear_shape(x)), color=color, lw=1.2, label=label)
    shapes.set(xlabel="place $x/l$", ylabel="deflection, middle = 1")
    changes.set(xlabel="place $x/l$", ylabel="change of the shape [%]")


if __name__ == "__main__":
    script.run()
