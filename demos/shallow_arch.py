r"""Shallow arch: snap-through, sway, and its bifurcation diagram.

An arch $y = H \sin(\pi x/l)$ between two hinges that cannot move carries a load $p \sin(\pi x/l)$.
A low arch snaps through symmetrically at its limit point. In a higher arch the thrust reaches the
second buckling load before: the symmetric path has a bifurcation, and the arch sways to one side.
Objective: both loads for several heights, the path with its branches, and which parts are stable.

With the radius of gyration $r$ of the section, $e = H/(2 r)$ and $q = p l^4/(2 r \pi^4 EI)$, the
theory of slender shallow arches (Fung and Kaplan 1952, NACA TN 2840) gives for the amplitude $u$ of
the deformed arch, also divided by $2 r$, the path, its limit point for $e > 1$ and its bifurcation
for $e > 2$:

$$
\begin{aligned}
q &= e + (e^2 - 1)\,u - u^3, \\
q_\mathrm{limit} &= e + \sqrt{4 (e^2 - 1)^3/27}, \\
q_\mathrm{sway} &= e + 3 \sqrt{e^2 - 4},
\end{aligned}
$$

the last where the thrust $e^2 - u^2$ is that of a column that buckles with two half waves. The
bifurcation comes first for $e > \sqrt{5.5} = 2.35$. On the branch the thrust is constant, and the
amplitude $v$ of the second mode grows from zero: $u = (q - e)/3$ and $4 v^2 = e^2 - 4 - u^2$. It
leads over to a second bifurcation of the symmetric path.

The beams are those of the geometrically exact theory; the differences fall with $r^2$. No
imperfection is needed: `static(..., branches=1)` starts from the bifurcations along their modes.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS = 1e-3  # of gyration, relative to the span
RISES = (1.5, 2.2, 3.0)  # e
DRAWN = 3.0
ELEMENTS, DEGREE = 8, 3
STEPS = 6
SECTION = fb.Section(EA=RADIUS**-2, GA=RADIUS**-2, EI=1.0)
UNIT = 2 * RADIUS * np.pi**4  # load p for q = 1


def scene(rise):
    """The arch, its middle, and its load $q$, which is a fifth more than the limit load."""
    arch, height, load = fb.Scene(), 2 * RADIUS * rise, 1.2 * limit(rise)
    beam = arch.add_beam(
        lambda f: (f, height * np.sin(np.pi * f)), SECTION, ELEMENTS, DEGREE, name="arch"
    )
    arch.pin(beam.start)
    arch.pin(beam.end)
    length = beam.length
    arch.add_line_load(
        beam, lambda s: (0.0, -load * UNIT * np.sin(np.pi * s / length)), of="arc length"
    )
    return arch, beam, load


def limit(rise):
    """Limit load $q$."""
    return rise + np.sqrt(4 * (rise**2 - 1) ** 3 / 27)


def sway(rise):
    """Load $q$ of the bifurcation, for $e > 2$."""
    return rise + 3 * np.sqrt(rise**2 - 4)


def second_mode(path, beam):
    """Amplitude $v$ (n,) of the second mode, divided by $2 r$."""
    nodes = beam.nodes
    places = np.array([node.x for node in nodes])
    across = np.column_stack([path.displacement(node)[:, 1] for node in nodes])
    weights = np.sin(2 * np.pi * places)
    return across @ weights / (weights @ weights) / (2 * RADIUS)


def compute():
    """The numbers, and what is drawn."""
    loads, first, drawn = {}, {}, None
    for rise in RISES:
        log.info("e = %g", rise)
        arch, beam, load = scene(rise)
        branches = int(rise == DRAWN)
        path = fb.static(
            arch, STEPS, continuation="arc-length", max_steps=120, branches=branches, progress=False
        )
        points = path.critical_points
        loads[f"e = {rise:g}"] = {
            kind: max((load * p.load_factor for p in points if p.kind == kind), default=None)
            for kind in ("limit point", "bifurcation")
        }
        first[f"e = {rise:g}"] = points[0].kind
        if branches:
            drawn = path, beam, load
    path, beam, load = drawn
    branch = path.branches[0]
    q, v = load * branch.load_factor, second_mode(branch, beam)
    u = (q - DRAWN) / 3
    numbers = {
        "loads": loads,
        "first": first,
        "theory": {
            f"e = {rise:g}": [limit(rise), sway(rise) if rise > 2 else None] for rise in RISES
        },
        "branches": len(path.branches),
        "stable rows of branches": int(sum(b.stable.sum() for b in path.branches)),
        "largest v": float(abs(v).max()),
        "largest v by theory": float(np.sqrt((DRAWN**2 - 4) / 4)),
        "error of v^2": float(abs(4 * v**2 - (DRAWN**2 - 4 - u**2)).max()),
    }
    return numbers, drawn


def report(numbers):
    for name, loads in numbers["loads"].items():
        pairs = zip(loads.items(), numbers["theory"][name], strict=True)
        text = ", ".join(
            f"{kind} {q:.4f} (shallow arch {exact:.4f})"
            for (kind, q), exact in pairs
            if q is not None
        )
        print(f"{name}: {text}; first a {numbers['first'][name]}")
    print(
        f"Sway for e = {DRAWN:g}: {numbers['branches']} branches, largest amplitude "
        f"{numbers['largest v']:.4f} (shallow arch {numbers['largest v by theory']:.4f})"
    )


def draw(results, path, beam, load):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene(DRAWN)[0], results / "scene.png", scene_unit="-")
    there = range(0, len(path.t), max(1, len(path.t) // 30))
    thumbnail.card(path, there, results / "thumbnail.png", tall=25.0)
    middle = beam.node(0.5)

    def fall(solution):
        return -solution.displacement(middle)[:, 1] / (2 * RADIUS)

    figure = plot.equilibrium_paths(
        path, fall, label="fall of the middle, divided by $2r$", load=load, load_label="load $q$"
    )
    ax = figure.axes[0]
    ax.set(xlim=(-0.6, 7.6), ylim=(-9, 17))
    bifurcation = next(p for p in path.critical_points if p.kind == "bifurcation")
    summit = next(p for p in path.critical_points if p.kind == "limit point")
    branch = path.branches[0]
    half = int(abs(second_mode(branch, beam)).argmax())
    shown = [
        (path, 0, (-0.4, -4.0)),
        (bifurcation.solution, 0, (-0.4, 11.5)),
        (summit.solution, 0, (1.6, 13.0)),
        (branch, half, (3.3, 5.5)),
        (path, len(path.t) - 1, (5.6, 13.0)),
    ]
    for solution, row, (x, y) in shown:
        inside = ax.inset_axes((x, y, 1.6, 3.0), transform=ax.transData)
        inside.axis("off")
        nodes = solution.nodes_of_beam["arch"]
        inside.plot(*solution.X[nodes].T, color="0.75", lw=1)
        inside.plot(*(solution.X + solution.q[row, :, :2])[nodes].T, color="k", lw=1.6)
        inside.set(xlim=(-0.05, 1.05), ylim=(-0.0085, 0.0085))
        place = fall(solution)[row], load * solution.load_factor[row]
        ax.plot([place[0], x + 0.8], [place[1], y + 1.5], color="0.6", lw=0.6, zorder=1)
    plot.save(figure, results / "diagram.png")
    plot.modes(bifurcation.modes, results / "mode.png")


if __name__ == "__main__":
    script.run()
