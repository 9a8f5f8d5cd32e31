r"""A lattice that lets no waves through in a band of frequencies; gradients choose the band.

A bar of cells carries arms with lumps at their ends. Above the frequency of the arms, waves along
the bar do not pass: the arms move against it. Objective: the arms and lumps with the widest band
about a wanted frequency, for a given mass, from natural frequencies and their gradients; and how
much less a finite bar then transmits there.

Reference: a chain of masses $M$ on springs with resonators of mass $m$ and frequency $w$ lets no
waves through between $w$ and $w \sqrt{1 + m/M}$ (Huang, Sun and Huang, Int. J. Eng. Sci. 47, 2009);
of a free bar with $n$ cells $n$ frequencies are below the band, of which one is zero, and $n$
above. An arm of the mass $m_a$ with a lump $m_l$ vibrates as the mass $m_l + \frac{33}{140} m_a$ at
its end (Rayleigh), and pushes the bar as the mass $(m_l + \frac{3}{8} m_a)^2/(m_l + \frac{33}{140}
m_a)$ does. By symmetry the bar does not bend if arms point to both sides; one side is computed,
with half of the bar. Units are metre, kilogram and second.
"""

import logging

import numpy as np
from scipy.optimize import minimize

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

CELLS, CELL = 12, 0.08  # number and length of cells [m]
HALF, WIDTH = 1e-3, 10e-3  # half height of the bar, and width [m]
E, NU, RHO = 3e9, 0.35, 1240.0  # of a printed polymer
START = np.array([3.2e-3, 24e-3, 2.0e-3])  # thickness and length of arms [m], lumps [kg]
LEAST = 3.0e-3  # thickness [m]
WANTED, BUDGET = 1000.0, 3e-3  # middle of the band [Hz], mass of an arm and its lump [kg]


def lattice(x):
    """The bar, and the nodes at its ends."""
    thickness, length, lump = x
    material = {"width": WIDTH, "E": E, "nu": NU, "rho": RHO}
    bar = fb.Section.rectangle(height=HALF, **material)
    arm = fb.Section.rectangle(height=thickness, **material)
    points = [(k * CELL, 0.0) for k in range(CELLS + 1)]
    points += [(k * CELL, length) for k in range(1, CELLS + 1)]
    pieces = [(k, k + 1) for k in range(CELLS)]
    arms = [(k, CELLS + k) for k in range(1, CELLS + 1)]
    sections, tags = {"bar": bar, "arm": arm}, ["bar"] * CELLS + ["arm"] * CELLS
    scene, elements = fb.Scene(), [1] * CELLS + [4] * CELLS
    nodes = scene.add_mesh(points, pieces + arms, sections, elements, degree=2, tags=tags).nodes
    for node in nodes[: CELLS + 1]:
        scene.fix(node, "y", "rotation")  # symmetry
    for node in nodes[CELLS + 1 :]:
        scene.add_mass(node, lump)
    return scene, nodes[0], nodes[CELLS]


def arm_mass(x):
    """Of an arm without its lump, and its slopes."""
    unit = RHO * WIDTH
    return unit * x[0] * x[1], unit * np.array([x[1], x[0], 0.0])


def edges(run, x):
    """Angular frequencies below and above the band, and their slopes (2, 3)."""
    w = run(x)
    order = np.argsort(w)[[CELLS - 1, CELLS]]
    return w[order], run.jacobian()[order]


def widened():
    """The numbers with the widest band about the wanted frequency, and evaluations."""
    run = fb.ModalResponse(lambda x: lattice(x)[0], n=CELLS + 2)

    def narrow(y):
        w, J = edges(run, START * y)
        return np.log(w[0] / w[1]), START * (J[0] / w[0] - J[1] / w[1])

    def middle(y):
        w, J = edges(run, START * y)
        return np.log(w.prod() / (2 * np.pi * WANTED) ** 2), START * (J / w[:, None]).sum(axis=0)

    def mass(y):
        own, slopes = arm_mass(START * y)
        total = (own + START[2] * y[2]) / BUDGET - 1
        return total, START * (slopes + np.array([0, 0, 1.0])) / BUDGET

    constraints = [
        {
            "type": "eq",
            "fun": lambda y, limit=limit: limit(y)[0],
            "jac": lambda y, limit=limit: limit(y)[1],
        }
        for limit in (middle, mass)
    ]
    bounds = [(LEAST / START[0], 3.0), (0.4, 3.0), (0.3, 3.0)]
    best = minimize(
        narrow, np.ones(3), jac=True, bounds=bounds, constraints=constraints, method="SLSQP"
    )
    return START * best.x, best.nfev


def theory(x):
    """Frequencies of the edges [Hz] of the chain."""
    thickness, length, lump = x
    own, _ = arm_mass(x)
    bends, EI = lump + 33 / 140 * own, E * WIDTH * thickness**3 / 12
    m, w = (lump + 3 / 8 * own) ** 2 / bends, np.sqrt(3 * EI / (bends * length**3))
    M = RHO * HALF * WIDTH * CELL + own + lump - m
    return np.array([w, w * np.sqrt(1 + m / M)]) / (2 * np.pi)


def transmitted(x, frequencies):
    """Motion of the far end over that of a rigid bar, as a response."""
    scene, first, last = lattice(x)
    mass = CELLS * (RHO * HALF * WIDTH * CELL + arm_mass(x)[0] + x[2])
    far = fb.frequency_response(scene, (first, (1.0, 0.0)), last, frequencies)
    return mass * (2 * np.pi * frequencies) ** 2 * abs(far.component("x"))


def compute():
    """The numbers, and what is drawn."""
    log.info("the widest band")
    best, evaluations = widened()
    run = fb.ModalResponse(lambda x: lattice(x)[0], n=CELLS + 2)
    before, after = (edges(run, x)[0] / (2 * np.pi) for x in (START, best))
    frequencies = np.linspace(100, 2000, 381)
    curves = {"at first": transmitted(START, frequencies), "best": transmitted(best, frequencies)}
    close = abs(frequencies / WANTED - 1) < 0.1
    numbers = {
        "edges at first": before.tolist(),
        "edges": after.tolist(),
        "edges by theory": theory(best).tolist(),
        "thickness": best[0],
        "length": best[1],
        "lump": best[2],
        "mass of arm and lump over budget": (arm_mass(best)[0] + best[2]) / BUDGET,
        "evaluations": evaluations,
        "least transmission near at first": float(curves["at first"][close].min()),
        "largest transmission near": float(curves["best"][close].max()),
    }
    return numbers, (frequencies, curves, before, after, best)


def report(numbers):
    (a, b), (c, d), (e, f) = (
        numbers[name] for name in ("edges at first", "edges", "edges by theory")
    )
    print(
        f"no waves between {a:.0f} and {b:.0f} Hz at first, between {c:.1f} and {d:.1f} Hz (chain "
        f"{e:.0f} and {f:.0f} Hz) after {numbers['evaluations']} evaluations"
    )
    print(
        f"arms of {1e3 * numbers['thickness']:.2f} mm by {1e3 * numbers['length']:.2f} mm, lumps "
        f"of {1e3 * numbers['lump']:.3f} g; within 10 % of {WANTED:g} Hz the far end moves at most "
        f"{numbers['largest transmission near']:.2f} of a rigid bar, at first at least "
        f"{numbers['least transmission near at first']:.0f} times as far as this"
    )


def draw(results, frequencies, curves, before, after, best):
    # Imported here: the numbers need neither matplotlib nor pyvista.

    from fx_beam import plot
    from shared import thumbnail

    scene, first, _ = lattice(best)
    figure, axes = plot.figure(1, 1, height=3.2)
    (ax,) = axes.flat
    for (name, curve), edges in zip(curves.items(), (before, after), strict=True):
        (line,) = ax.semilogy(frequencies, curve, lw=1.2, label=name)
        ax.axvspan(*edges, color=line.get_color(), alpha=0.12, lw=0)
    ax.axvline(WANTED, color="0.3", lw=0.8, ls=":")
    ax.set(xlabel="frequency [Hz]", ylabel="far end over rigid bar", ylim=(1e-3, 1e3))
    plot.save(figure, results / "transmission.png")

    w = 2 * np.pi * WANTED
    scene.add_force(first, lambda t: (150.0 * np.sin(w * t), 0.0))
    period = 2 * np.pi / w
    motion = fb.simulate(scene, dt=period / 40, t_end=30 * period)
    rows = range(29 * 40, 30 * 40)
    plot.animate(motion, results / "motion.gif", rows=rows, magnify=30.0, size=(700, 320))
    thumbnail.card(motion, rows, results / "thumbnail.png", magnify=30.0, tall=8.0)


if __name__ == "__main__":
    script.run()
