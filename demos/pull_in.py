r"""A strip that a magnet pulls in: where equilibria end, and how a sudden field reaches farther.

A steel strip is clamped at its foot and carries a mass $m$ at its tip. A magnet at the distance $d$
from the tip attracts it, along the line between them, by $c/r^2$ at the distance $r$. Objective:
forces between points in statics, in modes and in a motion that conserves energy; the end of
equilibria.

Reference, by hand. For small deflections the strip is a spring of the stiffness $k$, with

$$ \frac{1}{k} = \frac{L^3}{3 EI} + \frac{L}{GA}. $$

Its tip is at rest at $x$ where $k x = c/(d - x)^2$. This $c$ is largest at $x = d/3$:

$$ c_\mathrm{max} = \frac{4}{27} k d^3. $$

Beyond it there is no equilibrium, and the strip snaps to the magnet. Below it the tip vibrates at

$$ \omega^2 = \frac{k - 2 c/(d - x)^3}{m + \frac{33}{140} \rho A\,L}, $$

which is zero at $x = d/3$: 33/140 of its mass is what a strip adds to the tip. When the field is
switched on at once, the strip swings beyond its equilibrium, and no energy is lost:

$$ \frac{1}{2} k x^2 = \frac{c}{d - x} - \frac{c}{d}, $$

so that it arrives at rest at $x = d/2$ with $c = k d^3/8$, and snaps with more: 27/32 of
$c_\mathrm{max}$ is enough. The force of the motion is a spring with the stored energy $-c/r$, which
the scheme conserves. A stop at a tenth of $d$ holds the strip off the magnet, elastically.

Units are metre, kilogram and second.
"""

import logging
import math

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH = 0.25  # L [m]
SECTION = fb.Section.rectangle(height=0.5e-3, width=20e-3, E=210e9, nu=0.3, rho=7850.0)
MASS = 0.2  # m [kg]
GAP = 0.02  # d [m]
ELEMENTS, DEGREE = 8, 2
STIFFNESS = 1 / (LENGTH**3 / (3 * SECTION.EI) + LENGTH / SECTION.GA)  # k [N/m]
STRONGEST = 4 * STIFFNESS * GAP**3 / 27  # c_max [N m²]
INERTIA = MASS + 33 / 140 * SECTION.rhoA * LENGTH  # [kg]
STRENGTHS = (0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99)  # c / c_max at rest
SHOWN = (0.82, 0.86)  # c / c_max of the motions that are drawn
STOP, STOP_STIFFNESS = 0.1 * GAP, 1e5  # [m], [N/m]
DT, T_END = 1e-3, 2.5  # [s]


def scene():
    """The strip, without the magnet."""
    field = fb.Scene()
    strip = field.add_beam([(0, 0), (0, LENGTH)], SECTION, ELEMENTS, DEGREE, name="strip")
    field.clamp(strip.start)
    field.add_mass(strip.end, MASS)
    return field, strip


def held(strength):
    """The strip with a magnet, for statics: its pull grows with the load factor."""
    field, strip = scene()
    c = fb.Parameter("c", strength * STRONGEST)
    field.add_force_between(strip.end, (GAP, LENGTH), force=lambda r, rate, t: c / r**2)
    return field, strip


def free(strength):
    """The strip with a magnet that is there at once, for motions."""
    field, strip = scene()
    c = fb.Parameter("c", strength * STRONGEST)
    magnet = fb.Spring(strain_energy=lambda r: -c / r)
    stop = (STOP, 2 * LENGTH, STOP_STIFFNESS)
    field.add_force_between(strip.end, (GAP, LENGTH), spring=magnet, stop=stop)
    return field, strip


def at_rest(strength):
    """Deflection over the gap, and frequency [Hz], of the equilibrium under a magnet."""
    field, strip = held(strength)
    state = fb.static(field)
    x = float(state.displacement(strip.end)[-1, 0])
    return x / GAP, float(fb.modes(field, state=state, n=1).frequencies[0])


def frequency(strength, x):
    """Frequency by hand, at a deflection over the gap [Hz]."""
    softening = 2 * strength * STRONGEST / (GAP * (1 - x)) ** 3
    return math.sqrt((STIFFNESS - softening) / INERTIA) / (2 * np.pi)


def swing(strength):
    """Motion after the field is switched on, and deflections over the gap (n,)."""
    field, strip = free(strength)
    solution = fb.simulate(field, dt=DT, t_end=T_END)
    return solution, solution.displacement(strip.end)[:, 0] / GAP


def threshold(low=0.80, high=0.88):
    r"""Strength at which the strip begins to snap, $c/c_\mathrm{max}$, within 1e-3."""
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if swing(middle)[1].max() > 0.7 else (middle, high)
    return (low + high) / 2


def has_equilibrium(strength):
    """Whether load steps reach a strength."""
    try:
        fb.static(held(strength)[0])
    except fb.StepError:
        return False
    return True


def compute():
    """The numbers, and what is drawn."""
    log.info("equilibria under magnets up to %g of the strongest", STRENGTHS[-1])
    rest = {strength: at_rest(strength) for strength in STRENGTHS}
    exact = {c: frequency(c, x) for c, (x, _) in rest.items()}
    needed = {c: 27 / 4 * x * (1 - x) ** 2 / c for c, (x, _) in rest.items()}
    log.info("motions after a field is switched on")
    motions = {strength: swing(strength) for strength in SHOWN}
    energy = {c: solution.energy for c, (solution, _) in motions.items()}
    numbers = {
        "equilibrium at 0.99": has_equilibrium(0.99),
        "equilibrium at 1.01": has_equilibrium(1.01),
        "strength / exact": {f"{c:g}": ratio for c, ratio in needed.items()},
        "frequency / exact": {f"{c:g}": rest[c][1] / exact[c] for c in rest},
        "deflection / gap": {f"{c:g}": x for c, (x, _) in rest.items()},
        "snaps from": threshold(),
        "largest deflection / gap": {f"{c:g}": x.max() for c, (_, x) in motions.items()},
        "relative energy error": {
            f"{c:g}": abs(energies.balance_error).max() / energies.kinetic.max()
            for c, energies in energy.items()
        },
    }
    return numbers, (rest, motions)


def report(numbers):
    for c, x in numbers["deflection / gap"].items():
        print(
            f"c = {c} c_max: at rest at {x:.4f} d; c is {numbers['strength / exact'][c]:.4f} and "
            f"the frequency {numbers['frequency / exact'][c]:.4f} of those by hand"
        )
    print(
        f"Equilibrium at 0.99: {numbers['equilibrium at 0.99']}; "
        f"at 1.01: {numbers['equilibrium at 1.01']}"
    )
    print(f"Switched on at once, it snaps from {numbers['snaps from']:.4f} c_max; 27/32 = 0.8438")
    for c, x in numbers["largest deflection / gap"].items():
        error = numbers["relative energy error"][c]
        print(f"c = {c} c_max: up to {x:.3f} d; energy constant within {error:.0e}")


def draw(results, rest, motions):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(free(1.0)[0], results / "scene.png")
    snapping = motions[SHOWN[1]][0]
    plot.animate(snapping, results / "motion.gif", rows=range(0, 1500, 10), fps=20, thickness=2.0)
    thumbnail.card(snapping, range(0, 1500, 10), results / "thumbnail.png")

    figure, (axes,) = plot.figure(1, 2, height=3.2)
    x = np.linspace(0, 1, 201)
    c = 27 / 4 * x * (1 - x) ** 2
    stable = x <= 1 / 3
    axes[0].plot(c[stable], x[stable], "-", color="0.4", label="equilibria by hand")
    axes[0].plot(c[~stable], x[~stable], ":", color="0.4", label="unstable ones")
    places = [x for x, _ in rest.values()]
    axes[0].plot(list(rest), places, "o", color="#0072B2", label="strip at rest")
    axes[0].axvline(27 / 32, color="#D55E00", linewidth=1, label="snaps if switched on at once")
    axes[0].set(xlabel="strength $c / c_{max}$", ylabel="deflection $x / d$", xlim=(0, 1.1))
    looks = {SHOWN[0]: "-", SHOWN[1]: (0, (5, 1.5))}
    for strength, (solution, x) in motions.items():
        label = f"$c$ = {strength:g} $c_{{max}}$, switched on at once"
        axes[1].plot(solution.t, x, color="#009E73", linestyle=looks[strength], label=label)
    axes[1].axhline(1 - STOP / GAP, color="0.6", linewidth=1)
    axes[1].text(0, 1.02 - STOP / GAP, " stop", fontsize=8, color="0.4")
    axes[1].set(xlabel="time $t$ [s]", ylabel="deflection $x / d$", xlim=(0, T_END))
    plot.save(figure, results / "pull_in.png")


if __name__ == "__main__":
    script.run()
