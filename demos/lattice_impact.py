r"""Lattice impact: a wave through 20 200 struts.

A free square lattice of 100 x 100 cells, one element a strut, is hit in the middle of its left
side. Objective: a large frame; the energy and the momentum of a transient motion; the energy of
each strut. The wave stretches the rows, and bends the struts between them, through which it reaches
other rows. The bent struts are soft, but have about half of the strain energy.

Reference, by hand: a bar alone carries axial waves at $c = \sqrt{EA/\rho A}$. In a row of the
lattice the nodes also carry the struts across it, at the same mass per node, while the stiffness is
that of the row: long waves run at

$$ c_\mathrm{row} = \sqrt{\frac{EA}{2 \rho A}} = \frac{c}{\sqrt{2}}, $$

and no wave that is much longer than a strut is faster. The blow is a force $F \sin^2(\pi t/T)$
along the rows, whose impulse $F T/2$ is the momentum of the lattice from then on. Scene and blow
are mirror images of themselves about the row in the middle, and so is the motion.
"""

import logging
import math

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

CELLS = 100  # on each side
STRUT = 10e-3  # [m]
SECTION = fb.Section.rectangle(
    height=1.5e-3,  # [m]
    width=10e-3,  # [m]
    E=70e9,  # [Pa]
    nu=0.33,
    rho=2700.0,  # [kg/m³]
)
SPEED = math.sqrt(SECTION.EA / SECTION.rhoA)  # c [m/s]
ROW_SPEED = SPEED / math.sqrt(2)  # [m/s]
FORCE = 2000.0  # on each node that is hit [N]
HIT = 1  # rows that are hit, to either side of the middle one
PULSE = 40e-6  # T [s]
DT = 2e-6  # [s]
MAGNIFY = 50  # displacements in the pictures
FRONT = 0.01  # of the largest speed of all: from here on a node has been reached


def scene(cells=CELLS):
    """The lattice, and the nodes (cells + 1, cells + 1) by their places along x and y."""
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    rows = np.stack([number[:-1], number[1:]], axis=-1)
    columns = np.stack([number[:, :-1], number[:, 1:]], axis=-1)
    struts = np.concatenate([rows.reshape(-1, 2), columns.reshape(-1, 2)])
    lattice = fb.Scene()
    beams = lattice.add_mesh(STRUT * np.argwhere(number >= 0), struts, SECTION)
    nodes = np.reshape(beams.nodes, number.shape)
    for row in range(cells // 2 - HIT, cells // 2 + HIT + 1):
        lattice.add_force(nodes[0, row], blow)
    return lattice, nodes


def blow(t):
    """Force on a node that is hit [N]."""
    return FORCE * math.sin(math.pi * t / PULSE) ** 2 if t < PULSE else 0.0, 0.0


def run(cells):
    """The motion until the wave has crossed the lattice, and the nodes."""
    lattice, nodes = scene(cells)
    steps = round((cells * STRUT / ROW_SPEED + PULSE / 2) / DT)
    log.info("%d struts, %d steps", len(lattice.beams), steps)
    solution = fb.simulate(
        lattice, dt=DT, t_end=steps * DT, record=fb.Record(forces=False), max_halvings=0
    )
    return solution, nodes


def compute(cells=CELLS):
    """The numbers, and what is drawn."""
    solution, nodes = run(cells)
    energy, row = solution.energy, speeds_of_row(solution, nodes, cells)
    x = STRUT * np.arange(cells + 1)
    peaks = solution.t[row.argmax(axis=0)]
    # Away from both ends: the blow itself, and what the far end reflects.
    inside = slice(cells // 5, cells * 4 // 5)
    reached = row > FRONT * row.max()
    arrivals = np.where(reached.any(axis=0), solution.t[reached.argmax(axis=0)], np.inf)
    mirror = [node.number for node in nodes[:, ::-1].flat]  # turns the lattice over
    parts = energies(solution, -1)
    turned_over = solution.q[-1][mirror] * (1, -1, -1)
    numbers = {
        "struts": len(solution.beams),
        "unknowns": solution.stats.unknowns,
        "solver": solution.stats.solver,
        "iterations per step": solution.stats.newton_iterations / solution.stats.steps,
        "energy of the blow [J]": float(energy.total[-1]),
        "relative error of the energy": float(abs(energy.balance_error).max() / energy.total[-1]),
        "momentum / impulse": float(
            solution.linear_momentum[-1, 0] / ((2 * HIT + 1) * FORCE * PULSE / 2)
        ),
        "speed / c of the peak": float(np.polyfit(peaks[inside], x[inside], 1)[0] / SPEED),
        "fastest front / c": float((x[1:] / arrivals[1:]).max() / SPEED),
        "asymmetry": float(abs(turned_over - solution.q[-1]).max() / abs(solution.q[-1]).max()),
        "strain energy / sum over struts": float(energy.strain[-1] / parts.sum()),
        "bending share of the strain energy": float(parts[1:].sum() / parts.sum()),
    }
    return numbers, (solution, x, row)


def speeds_of_row(solution, nodes, cells):
    """Speeds (n, cells + 1) along the row in the middle [m/s]."""
    numbers = [nodes[i, cells // 2].number for i in range(cells + 1)]
    return abs(solution.v[:, numbers, 0])


def energies(solution, k):
    """Energies (3, struts) of stretching, shear and bending of each strut in row k [J]."""
    ends = np.array([(beam.start.number, beam.end.number) for beam in solution.beams.values()])
    places = solution.X + solution.q[k][:, :2]
    (x, y), (dx, dy) = (
        np.diff(positions[ends], axis=1)[:, 0].T for positions in (solution.X, places)
    )
    turn = solution.q[k][ends, 2]
    c, s = np.cos(turn.mean(axis=1)), np.sin(turn.mean(axis=1))
    stretched = x * (c * dx + s * dy) + y * (c * dy - s * dx)
    sheared = x * (c * dy - s * dx) - y * (c * dx + s * dy)
    strains = [stretched / STRUT**2 - 1, sheared / STRUT**2, np.diff(turn)[:, 0] / STRUT]
    stiffness = np.array([[SECTION.EA], [SECTION.GA], [SECTION.EI]])
    return stiffness / 2 * np.square(strains) * STRUT


def report(numbers):
    for what, value in numbers.items():
        print(f"{what}: {value:.4g}" if isinstance(value, float) else f"{what}: {value}")


def draw(results, solution, x, row):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from matplotlib.collections import LineCollection
    from matplotlib.colors import PowerNorm

    from fx_beam import plot
    from shared import thumbnail

    stored = [energies(solution, k).sum(axis=0) for k in range(len(solution.t))]
    thumbnail.card(
        *(solution, range(0, len(solution.t), len(solution.t) // 40), results / "thumbnail.png"),
        shade=lambda k: np.sqrt(stored[k] / max(stored[k].max(), 1e-6 * stored[-1].max())),
        magnify=MAGNIFY,
    )
    figure, (panels,) = plot.figure(1, 3, height=2.6)
    ends = [(beam.start.number, beam.end.number) for beam in solution.beams.values()]
    for ax, part in zip(panels, (0.2, 0.5, 0.8), strict=True):
        k = round(part * (len(solution.t) - 1))
        places = solution.X + MAGNIFY * solution.q[k][:, :2]
        lines = LineCollection(places[ends], linewidths=130 / len(x), cmap="magma_r")
        stored = energies(solution, k).sum(axis=0)
        lines.set_array(stored / stored.max())
        lines.set_norm(PowerNorm(0.5, 0.0, 1.0))
        ax.add_collection(lines)
        ax.set(xlim=(x[0], x[-1]), ylim=(x[0], x[-1]), aspect="equal", xlabel="$x$ [m]")
        time, most = 1e6 * solution.t[k], 1e3 * stored.max()
        ax.set_title(f"{time:.0f} us, the darkest {most:.2g} mJ", fontsize=8)
        ax.grid(False)
    bar = figure.colorbar(lines, ax=panels, ticks=(0, 0.05, 0.2, 0.5, 1), pad=0.02, shrink=0.7)
    bar.set_label("relative strain energy of a strut", fontsize=8)
    panels[0].set_ylabel("$y$ [m]")
    plot.save(figure, results / "energy.png")

    figure, ((ax,),) = plot.figure(1, 1, height=4.0)
    extent = (0, x[-1], 0, 1e6 * solution.t[-1])
    image = ax.imshow(row, extent=extent, aspect="auto", origin="lower", cmap="magma_r")
    figure.colorbar(image, ax=ax, label="speed in the middle row [m/s]")
    for speed, line, name in ((SPEED, "k--", "$c$"), (ROW_SPEED, "k-", r"$c/\sqrt{2}$")):
        for start in (0, PULSE / 2) if line == "k-" else (0,):
            ax.plot(x, 1e6 * (start + x / speed), line, linewidth=1, label=None if start else name)
    ax.set(xlabel="$x$ [m]", ylabel="$t$ [us]", ylim=(0, extent[-1]))
    ax.grid(False)
    plot.save(figure, results / "front.png")


if __name__ == "__main__":
    script.run()
