r"""Stability chart of a column under a pulsating load, by Floquet multipliers.

A strip of steel between hinges, one of which may slide along the axis, carries the load
$P(t) = P_0 + P_1 \cos(\Omega t)$, which never reaches the buckling load. The column stays straight
and only becomes shorter and longer. At certain frequencies this motion is unstable all the same,
and the column begins to bend: near $\Omega = 2 \omega$ with twice the period of the load (a
multiplier below -1), near $\Omega = \omega$ with its period (a multiplier above 1). Objective:
these regions over frequency and load. For each $P_1$, `fx_beam.forced_response` follows the
straight motion over the frequency, with the multipliers of all deviations.

The reference is Mathieu's equation for the first mode (Bolotin, The Dynamic Stability of Elastic
Systems, 1964),

$$
\ddot q + 2 \zeta \omega \dot q + \omega^2 (1 - 2 m \cos \Omega t)\,q = 0, \qquad
m = \frac{P_1}{2 (P_\mathrm{cr} - P_0)},
$$

with $\omega$ and $\zeta$ of the column under $P_0$ and its buckling load $P_\mathrm{cr}$. On a
boundary of stability it has the solution $q = \sum_k a_k e^{i k \Omega t/2}$, with odd $k$ for
twice the period and even $k$ for the period. So
$(\omega^2 + i k \zeta \omega \Omega - k^2 \Omega^2/4)\,a_k = m \omega^2 (a_{k-2} + a_{k+2})$: the
eigenvalues $m$ of this (Hill's determinant) are the loads on the boundary. Damping lifts the
regions from the axis, to $m = 2 \zeta$ near $2 \omega$ and to about $m = \sqrt{2 \zeta}$ near
$\omega$.

A second check is without any multiplier: a column that is pushed a little to the side must grow by
the multiplier in each period.
"""

import logging
import math

import numpy as np
from scipy.interpolate import CubicSpline

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

# Strip of steel, 1 m long, 30 mm x 5 mm [N, N m², kg/m, kg m, s]
SECTION = fb.Section(EA=31.5e6, GA=10e6, EI=65.6, rhoA=1.18, rhoI=2.45e-6, retardation=2.5e-4)
LENGTH = 1.0  # [m]
EULER = np.pi**2 * SECTION.EI / LENGTH**2  # unit of loads [N]
MEAN = 0.3  # P0 [EULER]
PULSES = (0.05, 0.1, 0.2, 0.25, 0.3, 0.4)  # P1 [EULER]
RANGE = (0.8, 2.4)  # Omega / omega
ELEMENTS, DEGREE = 4, 2
SCHEME, STEPS = fb.EnergyMomentum(order=4), 21  # in a period
STEP = 0.05  # of the logarithm of the frequency
GROWING = {"period doubling": (2.0, 0.3), "fold": (0.98, 0.4)}  # Omega / omega, P1
PUSH, PERIODS = 1e-6, 30  # sideways [EULER], and of the load in the simulation


def scene(load, push=None):
    """The column under a load $P(t)$ in units of Euler's, or a constant one, and a push(t)."""
    made = fb.Scene()
    column = made.add_beam([(0, 0), (LENGTH, 0)], SECTION, ELEMENTS, DEGREE, name="column")
    made.pin(column.start)
    made.fix(column.end, "y")
    force = (lambda t: (-EULER * load(t), 0.0)) if callable(load) else (-EULER * load, 0.0)
    made.add_force(column.end, force)
    if push is not None:
        made.add_force(column.node(0.5), lambda t: (0.0, EULER * push(t)))
    return made, column


def pulsating(pulse, frequency):
    """$P(t)$ of a pulse $P_1$ and a frequency [Hz]."""
    return lambda t: MEAN + pulse * math.cos(2 * np.pi * frequency * t)


def own_numbers():
    """Buckling load, and natural frequency [rad/s] and damping ratio under $P_0$."""
    path = fb.static(scene(1.2)[0], 4, progress=False)
    pressed, _ = scene(MEAN)
    modes = fb.modes(pressed, fb.static(pressed, progress=False), n=1)
    omega, zeta = modes.angular_frequencies[0], modes.damping_ratios[0]
    return 1.2 * path.critical_points[0].load_factor, float(omega), float(zeta)


def by_mathieu(ratio, zeta, parity, terms=7):
    r"""Least $m$ on the boundary at $\Omega/\omega$, by Hill's determinant; 1 if larger or none.

    The parity is 1 for twice the period of the load, 0 for its period.
    """
    k = 2 * np.arange(-terms, terms + 1) + parity
    alone = 1 + 1j * k * zeta * ratio - (k * ratio / 2) ** 2
    coupling = np.eye(len(k), k=1) + np.eye(len(k), k=-1)
    inverse = np.linalg.eigvals(coupling / alone[:, None])
    return 1 / max(1.0, max(inverse.real[abs(inverse.imag) < 1e-9], default=0.0))


def chart_row(pulse, omega):
    """The straight motions under a $P_1$, over the frequency."""
    first, last = (ratio * omega / (2 * np.pi) for ratio in RANGE)
    return fb.forced_response(
        lambda f: scene(pulsating(pulse, f))[0],
        (first, last),
        step=STEP,
        steps=STEPS,
        scheme=SCHEME,
        tolerance=1e-7,  # of a motion that is 1e-5 of the length
    )


def crossings(ratio, margin):
    r"""Where a smooth function of $\Omega/\omega$ changes its sign."""
    return CubicSpline(ratio, margin).roots(extrapolate=False).tolist()


def growth(kind, omega):
    """The straight motion, and a pushed column: turns, deflections [m], growth in a period.

    The push takes a quarter of the first period.
    """
    ratio, pulse = GROWING[kind]
    frequency = ratio * omega / (2 * np.pi)
    load, dt = pulsating(pulse, frequency), 1 / frequency / STEPS
    straight = fb.periodic(
        scene(load)[0], period=1 / frequency, steps=STEPS, scheme=SCHEME, tolerance=1e-7
    )
    pushed, column = scene(load, push=lambda t: PUSH if t * frequency < 0.25 else 0.0)
    motion = fb.simulate(pushed, SCHEME, dt=dt, t_end=PERIODS / frequency, progress=False)
    deflection = motion.displacement(column.node(0.5))[:, 1]
    each = abs(deflection[STEPS::STEPS])
    late = np.arange(2 * PERIODS // 3, PERIODS)
    rate = float(np.exp(np.polyfit(late, np.log(each[late]), 1)[0]))
    return straight, motion.t * frequency, deflection, rate


def compute(pulses=PULSES):
    """The numbers, and what is drawn."""
    buckling, omega, zeta = own_numbers()
    fine = np.linspace(*RANGE, 1601)
    mathieu = {
        kind: 2 * (buckling - MEAN) * np.array([by_mathieu(r, zeta, parity) for r in fine])
        for kind, parity in (("period doubling", 1), ("fold", 0))
    }
    rows, boundaries = {}, {kind: {} for kind in mathieu}
    for pulse in pulses:
        log.info("P1 = %g", pulse)
        family = chart_row(pulse, omega)
        ratio = 2 * np.pi * family.frequencies / omega
        rows[pulse] = ratio, [motion.instability for motion in family]
        # Those of the first bending mode: the others have more damping.
        pair = np.array([motion.multipliers[:2] for motion in family])
        for kind, multiplier in (("period doubling", -1), ("fold", 1)):
            margin = np.prod(pair - multiplier, axis=1).real  # of a real pair: negative between
            boundaries[kind][f"P1 = {pulse:g}"] = [
                crossings(ratio, margin),
                crossings(fine, mathieu[kind] - pulse),
            ]
    grown = {kind: growth(kind, omega) for kind in GROWING}
    numbers = {
        "buckling load": buckling,
        "natural frequency under P0 [rad/s]": omega,
        "the same by theory [rad/s]": float(
            (np.pi / LENGTH) ** 2 * np.sqrt(SECTION.EI / SECTION.rhoA * (1 - MEAN))
        ),
        "damping ratio": zeta,
        "boundaries": boundaries,
        "multipliers": {
            kind: float(straight.multipliers[0].real) for kind, (straight, *_) in grown.items()
        },
        "growth in a period": {kind: rate for kind, (*_, rate) in grown.items()},
    }
    return numbers, (rows, fine, mathieu, boundaries, grown)


def report(numbers):
    print(
        f"Buckling load {numbers['buckling load']:.4f} of Euler's; under P0 the column "
        f"vibrates with {numbers['natural frequency under P0 [rad/s]']:.2f} rad/s (theory "
        f"{numbers['the same by theory [rad/s]']:.2f}), with a damping ratio of "
        f"{numbers['damping ratio']:.4f}."
    )
    for kind, pulses in numbers["boundaries"].items():
        for pulse, (computed, exact) in pulses.items():
            if computed or exact:
                column = ", ".join(f"{r:.4f}" for r in computed)
                theory = ", ".join(f"{r:.4f}" for r in exact)
                print(f"{kind}, {pulse}: Omega/omega = {column} (Mathieu {theory})")
    for kind, rate in numbers["growth in a period"].items():
        print(
            f"{kind}: multiplier {numbers['multipliers'][kind]:.5f}, the pushed column grows by "
            f"{rate:.5f} in a period"
        )


def draw(results, rows, fine, mathieu, boundaries, grown):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    colors = {"": "0.65", "period doubling": "#D55E00", "fold": "#0072B2"}
    labels = {
        "": "stable",
        "period doubling": r"multiplier below $-1$",
        "fold": "multiplier above 1",
    }
    top = 1.08 * max(rows)
    plot.scene(scene(MEAN)[0], results / "scene.png")
    pushed, _ = scene(pulsating(0.4, 2.0 * own_numbers()[1] / (2 * np.pi)), push=lambda t: PUSH)
    shaken = fb.simulate(pushed, SCHEME, dt=5e-4, t_end=0.2, progress=False)
    size = 0.2 * LENGTH / abs(shaken.displacement(pushed.beams[0].node(0.5))[:, 1]).max()
    thumbnail.card(shaken, range(len(shaken.t)), results / "thumbnail.png", tall=size)
    figure, ((chart,),) = plot.figure(1, 1, height=3.6)
    for pulse, (ratios, kinds) in rows.items():
        for kind, color in colors.items():
            marked = [r for r, k in zip(ratios, kinds, strict=True) if k == kind]
            label = labels[kind] if pulse == max(rows) else None
            chart.plot(
                marked,
                np.full(len(marked), pulse),
                ".",
                color=color,
                ms=6,
                label=label,
            )
        ends = [r for pairs in boundaries.values() for r in pairs[f"P1 = {pulse:g}"][0]]
        label = "boundary of the column" if pulse == max(rows) else None
        chart.plot(ends, np.full(len(ends), pulse), "k|", ms=11, label=label)
    for kind, loads in mathieu.items():
        within = np.minimum(loads, 2 * top)
        chart.fill_between(fine, within, 2 * top, color=colors[kind], alpha=0.15, lw=0)
        label = "boundary by Mathieu's equation" if kind == "fold" else None
        chart.plot(fine, within, "k-", lw=0.8, label=label)
    chart.set(
        xlim=(RANGE[0] - 0.02, RANGE[1] + 0.02),
        ylim=(0, top),
        xlabel=r"frequency of the load over that of the column, $\Omega/\omega$",
        ylabel=r"pulsating load $P_1/P_{\mathrm{Euler}}$",
    )
    plot.save(figure, results / "chart.png")

    figure, (axes,) = plot.figure(1, 2, height=2.8)
    for ax, (kind, (straight, turns, deflection, _)) in zip(axes, grown.items(), strict=True):
        ratio, pulse = GROWING[kind]
        ax.semilogy(turns[1:], abs(deflection[1:]), color=colors[kind], lw=0.9, label=kind)
        size, last = abs(straight.multipliers[0]), abs(deflection[-STEPS:])
        peak, peak_turn = last.max(), turns[-STEPS:][last.argmax()]
        ax.semilogy(turns, peak * size ** (turns - peak_turn), "k--", lw=1, label=r"$|\mu|^{t/T}$")
        title = rf"$\Omega/\omega = {ratio:g}$, $P_1 = {pulse:g}\,P_{{\mathrm{{Euler}}}}$"
        ax.set(xlabel="periods of the load", title=title)
        ax.set_ylim(bottom=peak * size**-PERIODS / 30)
    axes[0].set_ylabel("deflection of the middle [m]")
    plot.save(figure, results / "growth.png")


if __name__ == "__main__":
    script.run()
