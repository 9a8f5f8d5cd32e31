r"""A column between two walls: contact at a point, then along a line.

A pinned column is compressed between two walls at a small distance $h$ on either side. It buckles,
its middle touches one wall, and the load can grow far beyond the buckling load. First only the
middle touches; then the column lies flat on the wall, and the flat part grows. Objective: the force
on the wall, the load at which the column begins to lie flat, and the length that does.

The theory is that of small deflections (Chai 1998, J. Mech. Phys. Solids 46, 1155-1171), with
$k^2 = P/EI$ and $P_1 = \pi^2 EI/L^2$. From $P_1$ to $4 P_1$ the force on the wall is

$$ F = \frac{-2 P k h \cos(kL/2)}{\sin(kL/2) - \frac{1}{2} kL \cos(kL/2)}. $$

Above $4 P_1$ the force is $F = 2 P k h/\pi$, and the flat length is $L - 2 \pi/k$.

At $4 P_1$ the bending moment of the middle, which touches, has fallen to zero. While the column is
flat, half of the force acts at each end of the flat part. At $16 P_1$ the flat part would buckle
itself.

A weak line load in the place of an imperfection leads the column to one side. Between $P_1$ and the
wall the deflection grows at a nearly constant load, so that the path is followed with an unknown
load factor. The walls are stiff springs along the column. They spread the forces at the ends of the
flat part over a length of about $(EI/\text{stiffness})^{1/4}$; the ends are taken as the mean
places of the force on either half. What differs from the theory for small deflections falls with
$h^2$.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, EI, EA = 1.0, 1.0, 1e6
SECTION = fb.Section(EA=EA, GA=10 * EA, EI=EI)
GAPS = (0.02, 0.01, 0.005)  # from either wall
STIFFNESS = 1e10  # of the walls, per length
IMPERFECTION = 1e-2  # line load over h: so the deflections are alike for all h
BUCKLING = np.pi**2 * EI / LENGTH**2
LARGEST = 12.0  # load over the buckling load
ELEMENTS, DEGREE = 80, 2
STEPS, CUTS = 40, 16
SHOWN = (1.0, 2.0, 4.0, 8.0, LARGEST)


def scene(gap=GAPS[0]):
    """The column, its beam and the wall that it touches."""
    made = fb.Scene()
    column = made.add_beam([(0, 0), (LENGTH, 0)], SECTION, ELEMENTS, DEGREE, name="column")
    made.pin(column.start)
    made.fix(column.end, "y")
    made.add_force(column.end, (-LARGEST * BUCKLING, 0.0))
    made.add_line_load(column, (0.0, IMPERFECTION * gap))
    upper, _ = (
        made.add_contact(column, fb.Line((0, y), normal=(0, -y)), stiffness=STIFFNESS)
        for y in (gap, -gap)
    )
    return made, column, upper


def theory(load, gap):
    """Force on the wall and flat length at a load over the buckling load, from 1 on."""
    P, half = load * BUCKLING, LENGTH / 2
    k = np.sqrt(P / EI)
    if load >= 4:
        return 2 * P * k * gap / np.pi, LENGTH - 2 * np.pi / k
    c, s = np.cos(k * half), np.sin(k * half)
    return -2 * P * k * gap * c / (s - k * half * c), 0.0


class Path:
    """The states of a column, and what is known of the wall in each."""

    def __init__(self, gap):
        made, self.column, upper = scene(gap)
        self.gap = gap
        # Where the column meets the stiff wall its path has a corner, which takes short steps.
        self.solution = fb.static(made, STEPS, continuation="arc-length", max_cuts=CUTS)
        self.load = LARGEST * self.solution.load_factor
        contact = self.solution.contact(upper)
        pushes, x = -contact.force[..., 1], contact.points[..., 0]
        middle = pushes.shape[1] // 2
        self.force = pushes.sum(axis=1)
        arms = (pushes * abs(x - x[:, [middle]])).sum(axis=1)
        touches = self.force > 0
        self.flat = 2 * np.divide(arms, self.force, where=touches, out=np.zeros_like(arms))
        moments = self.solution.resultants(self.column).M
        points = moments.shape[1] // 2
        self.moment = abs(moments[:, [points - 1, points]]).mean(axis=1)
        self.known = np.array([theory(max(load, 1.0), gap) for load in self.load])
        # Where the column has reached the wall, and the loads that the theory is compared at.
        self.compared = touches & (self.load > 1.2)

    def errors(self):
        """Largest differences from the theory, over the largest values."""
        known, own = self.known[self.compared], (self.force, self.flat)
        return [
            float(abs(values[self.compared] - exact).max() / abs(exact).max())
            for values, exact in zip(own, known.T, strict=True)
        ]

    def unbalanced(self):
        """Largest difference of the forces across the column, over the largest on the wall."""
        ends = self.column.start, self.column.end
        sides = sum(self.solution.reaction(node)[:, 1] for node in ends)
        load = IMPERFECTION * self.gap * LENGTH * self.solution.load_factor
        return float(abs(sides + load - self.force).max() / self.force.max())


def compute():
    """The numbers, and what is drawn."""
    paths = []
    for gap in GAPS:
        log.info("walls at %g m", gap)
        paths.append(Path(gap))
    errors = np.array([path.errors() for path in paths])
    names = "force on the wall", "flat length"
    first, last = paths[0], paths[-1]
    numbers = {
        "difference from the theory": {
            name: dict(zip(map(str, GAPS), column.tolist(), strict=True))
            for name, column in zip(names, errors.T, strict=True)
        },
        "moment in the middle at 4 P1 over that at 2 P1": float(
            np.interp(4, last.load[last.compared], last.moment[last.compared])
            / np.interp(2, last.load[last.compared], last.moment[last.compared])
        ),
        "force on the wall at the end": float(first.force[-1]),
        "flat length at the end": float(first.flat[-1]),
        "the same by the theory": theory(LARGEST, first.gap),
        "forces across, out of balance": max(path.unbalanced() for path in paths),
        "steps": [path.solution.stats.steps for path in paths],
    }
    return numbers, (paths,)


def report(numbers):
    force, flat = numbers["the same by the theory"]
    print(
        f"At {LARGEST:g} P1, h = {GAPS[0]:g} L: {numbers['force on the wall at the end']:.3f} N on "
        f"the wall, {numbers['flat length at the end']:.4f} m flat; by the theory {force:.3f} N "
        f"and {flat:.4f} m"
    )
    for name, errors in numbers["difference from the theory"].items():
        listed = ", ".join(f"{error:.1e} with h = {gap} L" for gap, error in errors.items())
        print(f"Largest difference from the theory, {name}: {listed}")
    left = numbers["moment in the middle at 4 P1 over that at 2 P1"]
    print(
        f"The moment in the middle at 4 P1 is {left:.3f} of that at 2 P1 (theory: 0)\n"
        f"The forces across the column are in balance within "
        f"{numbers['forces across, out of balance']:.0e}; "
        f"{', '.join(map(str, numbers['steps']))} steps"
    )


def draw(results, paths):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    path = paths[0]

    thumbnail.card(
        path.solution, range(len(path.load)), results / "thumbnail.png", tall=0.4 / path.gap
    )
    figure, axes = plot.figure(1, 3, height=3.2)
    shapes, force, flat = axes.flat
    for n, load in enumerate(SHOWN):
        row = int(np.argmin(abs(path.load - load) + 10 * (~path.compared & (load > 1))))
        x, y = path.solution.shape(path.column)[row].T
        shapes.plot(x, y / path.gap, color=f"C{n}", label=f"$P = {load:g}\\,P_1$")
    for side in (-1, 1):
        shapes.axhline(side, color="0.6", lw=4, zorder=0)
    shapes.set(xlabel="$x$ [m]", ylabel="deflection over $h$", ylim=(-1.2, 1.2))
    loads = np.linspace(1, LARGEST, 200)
    exact = np.array([theory(load, 1.0) for load in loads])
    for n, own in enumerate(paths):
        keep = own.compared
        label = f"$h = {own.gap:g}\\,L$"
        look = {"color": f"C{n}", "markersize": 8 - 2 * n, "label": label}
        force.plot(own.load[keep], own.force[keep] / own.gap, "o", **look)
        flat.plot(own.load[keep], own.flat[keep], "o", **look)
    force.plot(loads, exact[:, 0], "k-", lw=1, label="theory")
    flat.plot(loads, exact[:, 1], "k-", lw=1, label="theory")
    force.set(xlabel="load $P/P_1$", ylabel="force over $h$ [N/m]")
    flat.set(xlabel="load $P/P_1$", ylabel="flat length [m]")
    plot.save(figure, results / "shapes_and_wall.png")


if __name__ == "__main__":
    script.run()
