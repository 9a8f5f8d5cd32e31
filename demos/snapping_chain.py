r"""Snapping chain: a metamaterial of bistable cells, and the path through all of its states.

A cell is a shallow truss: two bars with hinges rise from a stiff frame to the middle of the next
frame. It carries a load up to its limit load, then it snaps through and is stable upside down. By
symmetry one half of the chain is enough. Each of the three cells is stiffer than the one below.
Objective: the path of all equilibria with its limit points; which cell snaps when, under a growing
load and under a growing displacement; and the energy barrier that holds each state.

All cells carry the same force $F$. With the height $y$ and the half width $w$ of a cell, the length
$l = \sqrt{w^2 + y^2}$ of its bar, $L$ the length without load, and the strain energy
$EA (l - L)^2/(2 L)$ of the bar,

$$ F(y) = EA\,\frac{L - l}{L}\,\frac{y}{l}, $$

with the limit point $l^3 = L w^2$, where $F_\mathrm{max} = EA\,(1 - (w/L)^{2/3})^{3/2}$.

At $F = 0$ a cell is in its upper or lower state, or flat and unstable: the barrier between both is
the energy $EA (L - w)^2/(2 L)$ of the flat bar.

No two cells are at their limit points at once, so only one cell at a time passes its limit point:
the weakest one that carries the load at that moment. The path counts in binary numbers: the first
cell snaps; it snaps back, and the second one has snapped; the first one snaps again; both snap
back, and the third one has snapped. So the path visits all $2^3$ states that are stable without
load. A dead load and a prescribed displacement lead along this same path, but not the same parts
are stable: under a displacement the force may fall. Where the path turns back in the displacement,
a cell jumps all the same.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

WIDTH, RISE = 0.10, 0.02  # of half a cell [m]
EA = [2e4 * (1 + 0.1 * k) for k in range(3)]  # axial stiffness of the bars of each cell [N]
FRAME = fb.Section(EA=1e9, GA=1e9, EI=1e6, rhoA=0.3, rhoI=1e-5)
LOAD = 60.0  # on half of the chain [N]
DOWN = 2.1 * RISE * len(EA)  # prescribed displacement [m]
STEPS = 12
LENGTH = np.hypot(WIDTH, RISE)


def scene(driven=False):
    """Half of the chain, and its nodes in the middle from below to above."""
    chain = fb.Scene()
    height, middle, middles = 0.0, None, []
    for number, stiffness in enumerate(EA):
        frame = chain.add_beam(
            [(0, height), (WIDTH, height)], FRAME, name=f"frame {number}", elements=1
        )
        chain.fix(frame.start, "x", "rotation")
        if middle is None:
            chain.fix(frame.start, "y")
        else:
            chain.add_joint(fb.Revolute(frame.start, middle))
        top = height + RISE
        bar_section = fb.Section(EA=stiffness, GA=1e7, EI=1e4, rhoA=0.1, rhoI=1e-6)
        bar = chain.add_beam(
            [(WIDTH, height), (0, top)], bar_section, name=f"bar {number}", elements=1
        )
        chain.add_joint(fb.Revolute(frame.end, bar.start))
        middles.append(frame.start)
        middle, height = bar.end, top
    middles.append(middle)
    chain.fix(middle, "x")
    if driven:
        chain.prescribe(middle, y=-DOWN)
    else:
        chain.add_force(middle, (0.0, -LOAD))
    return chain, middles


def limit_load(stiffness):
    """Largest force of a cell [N]."""
    return stiffness * (1 - (WIDTH / LENGTH) ** (2 / 3)) ** 1.5


def barrier(stiffness):
    """Energy of a flat cell [J]."""
    return stiffness * (LENGTH - WIDTH) ** 2 / (2 * LENGTH)


def heights(path, middles):
    """Heights of the cells (n, cells) [m]."""
    places = np.column_stack([path.position(node)[:, 1] for node in middles])
    return np.diff(places, axis=1)


def states_without_load(path, cells):
    """Which cells are up (1) or down (-1) where the path passes $F = 0$, in its stable parts."""
    factor, stable = path.load_factor, path.stable
    rows = np.flatnonzero((factor[1:] * factor[:-1] <= 0) & stable[1:] & stable[:-1])
    return [tuple(np.sign(cells[row]).astype(int).tolist()) for row in rows]


def lowest_barrier(path):
    """Energy where the path first passes $F = 0$ in an unstable state [J]."""
    F, energy = LOAD * path.load_factor, path.energy.strain
    rows = np.flatnonzero((F[1:] * F[:-1] < 0) & ~path.stable[1:] & ~path.stable[:-1])
    part = F[rows[0]] / (F[rows[0]] - F[rows[0] + 1])
    return float((1 - part) * energy[rows[0]] + part * energy[rows[0] + 1])


def compute():
    """The numbers, and what is drawn."""
    made = scene()
    log.info("under a load")
    path = fb.static(made[0], STEPS, continuation="arc-length")
    log.info("under a displacement")
    driven = scene(driven=True)
    pulled = fb.static(driven[0], STEPS, continuation="arc-length")
    cells = heights(path, made[1])
    points = path.critical_points
    limits = [LOAD * point.load_factor for point in points]
    rising = [max(limits[: n + 1]) for n in range(len(limits))]
    numbers = {
        "limit loads": sorted(set(np.round(rising, 6))),
        "limit loads of cells": [limit_load(stiffness) for stiffness in EA],
        "kinds": sorted({point.kind for point in points}),
        "limit points under a load": len(points),
        "limit points under a displacement": len(pulled.critical_points),
        "states without load": states_without_load(path, cells),
        "barrier": lowest_barrier(path),
        "barrier of the first cell": barrier(EA[0]),
        "stable part under a load": float(path.stable.mean()),
        "stable part under a displacement": float(pulled.stable.mean()),
        "steps": path.stats.steps,
    }
    return numbers, (path, made, pulled, driven)


def report(numbers):
    pairs = zip(numbers["limit loads"], numbers["limit loads of cells"], strict=False)
    print("Cells snap at " + ", ".join(f"{a:.4f} N (exact {b:.4f} N)" for a, b in pairs))
    states = numbers["states without load"]
    print(
        f"{numbers['limit points under a load']} limit points under a load, "
        f"{numbers['limit points under a displacement']} under a displacement; the path visits "
        f"{len(set(states))} different states without load"
    )
    print(
        f"Barrier of the first cell: {1e3 * numbers['barrier']:.3f} mJ, exact "
        f"{1e3 * numbers['barrier of the first cell']:.3f} mJ"
    )


def draw(results, path, made, pulled, driven):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(made[0], results / "scene.png")
    figure, axes = plot.figure(1, 2, height=3.6)
    top = made[1][-1], driven[1][-1]
    down = -1e3 * path.displacement(top[0])[:, 1], -1e3 * pulled.displacement(top[1])[:, 1]
    force = LOAD * path.load_factor, -pulled.reaction(top[1])[:, 1]
    titles = "under a load", "under a displacement"
    for ax, x, F, stable, title in zip(
        axes.flat, down, force, (path.stable, pulled.stable), titles, strict=True
    ):
        ax.plot(x, F, color="0.7", linewidth=1.0, label="unstable")
        ax.plot(x, np.where(stable, F, np.nan), color="#0072B2", linewidth=2.0, label="stable")
        ax.set(
            xlabel="displacement of the top [mm]",
            ylabel="force on half of the chain [N]",
            title=title,
        )
    points = path.critical_points
    places = [-1e3 * float(point.solution.displacement(top[0])[-1, 1]) for point in points]
    loads = [LOAD * point.load_factor for point in points]
    axes[0, 0].plot(places, loads, "D", color="#D55E00", markersize=3, label="limit points")
    plot.save(figure, results / "force_and_displacement.png")

    figure, axes = plot.figure(1, 1, height=3.0)
    ax = axes[0, 0]
    cells = 1e3 * heights(path, made[1])
    curves = {f"cell {k + 1}": cells[:, k] for k in range(len(EA))}
    plot.quantities(ax, curves, np.arange(len(cells)))
    ax.set(xlabel="equilibrium along the path", ylabel="height of the cell [mm]")
    plot.save(figure, results / "heights.png")
    plot.animate(path, results / "motion.gif", rows=range(0, len(path.t), 8), fps=12)
    thumbnail.card(path, range(0, len(path.t), 8), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
