r"""Lee's frame: snap-through and snap-back under a dead load.

Two legs of equal length are joined rigidly at a right angle. Both ends are hinged. A dead load acts
on the beam at a fifth of its length. At the first limit load the frame would snap through. Beyond
it the load falls and becomes negative, and the loaded point moves back over part of the path. From
the second limit load on, the load rises again. Objective: the whole path, both limit loads, and the
load at which load steps without arc length fail.

The frame is that of Lee, Manuel & Rossow (1968), J. Eng. Mech. Div. ASCE 94, 527-547, with the data
in use since then: legs of 120, $A$ = 6, $I$ = 2 and $E$ = 7.2e6. $\nu$ = 0.3 and a shear factor of
5/6 are our choice. The literature gives a first limit load of 18.5e3 to 18.6e3; the differences
come from beam theories and meshes. The exact values for the present theory are computed here by
shooting. With $n$ the constant force in each of the three straight parts, $t$ and $W t$ the rotated
axes of the section, and a prime for the derivative by $s$, the equations

$$
\varphi' = \left(1 + \frac{n \cdot t}{EA}\right) t + \frac{n \cdot W t}{GA} W t, \quad
EI\,\psi' = M, \quad M' = n \cdot W \varphi'
$$

are integrated from one hinge to the other. For a given rotation $\psi$ at the first hinge, the load
and the two components of the reaction are found for which the far end lies at its hinge and has no
moment. The limit loads are the extrema over $\psi$.

In `fx_beam.static(..., continuation="arc-length")` the load factor is an unknown (Keller's
pseudo-arc-length method), and steps end exactly at limit points. The data have no units; any
consistent set will do.
"""

import logging
import math

import numpy as np
import scipy.integrate
import scipy.optimize

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LEG, AT = 120.0, 24.0  # length of a leg; of the load from the corner
SECTION = fb.Section.from_area(area=6.0, second_moment=2.0, E=7.2e6)
LOAD = 20e3  # beyond the first limit load
LITERATURE = (18.5e3, 18.6e3)
MESHES = {1: (10, 20, 40), 2: (5, 10, 20), 3: (5, 10)}  # elements of a leg, by degree
ELEMENTS, DEGREE = 10, 2  # of the pictures
FORCE = SECTION.EI / LEG**2  # typical force, for scaling
STEPS = 10


def scene(elements=ELEMENTS, degree=DEGREE):
    """The frame, its loaded node and the hinge of the column."""
    frame = fb.Scene()
    column = frame.add_beam([(0, 0), (0, LEG)], SECTION, elements, degree, name="column")
    pieces = [elements // 5, elements - elements // 5]
    points = [column.end, (AT, LEG), (LEG, LEG)]
    beam = frame.add_beam(points, SECTION, pieces, degree, name="beam")
    frame.pin(column.start)
    frame.pin(beam.end)
    loaded = beam.node(AT / LEG)
    frame.add_force(loaded, (0.0, -LOAD))
    return frame, loaded, column.start


# -- Shooting --------------------------------------------------------------------------------------


def shoot(psi, reaction_x, reaction_y, load):
    """Gap and moment at the far hinge, scaled, and the position of the loaded point."""
    n = -np.array([reaction_x, reaction_y])
    y = np.array([0.0, 0.0, psi, 0.0])
    parts = ((LEG, np.pi / 2, 0.0), (AT, 0.0, 0.0), (LEG - AT, 0.0, load))
    for length, direction, pressed in parts:
        n = n + (0.0, pressed)
        y = _along(y, n, direction, length)
        if not pressed:
            place = y[:2]
    return np.array([y[0] / LEG - 1, y[1] / LEG - 1, y[3] * LEG / SECTION.EI]), place


def _along(start, n, direction, length):
    nx, ny = n

    def slope(_, y):
        c, s = math.cos(direction + y[2]), math.sin(direction + y[2])
        stretch, across = 1 + (nx * c + ny * s) / SECTION.EA, (ny * c - nx * s) / SECTION.GA
        dx, dy = stretch * c - across * s, stretch * s + across * c
        return dx, dy, y[3] / SECTION.EI, dy * nx - dx * ny

    options = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-9}
    return scipy.integrate.solve_ivp(slope, (0, length), start, **options).y[:, -1]


def solved(gap, guess):
    """Root of a gap near a guess."""
    root = scipy.optimize.root(gap, guess, tol=1e-11)
    if abs(root.fun).max() > 1e-7:  # tolerance of the integration: 1e-9
        raise RuntimeError(f"shooting: {root.message}")
    return root.x


def limit_by_shooting(path, row, hinge):
    """Extremum of the load near a row of the path."""
    psi, *force = start(path, row, hinge)

    def load(psi):
        return solved(lambda x: shoot(psi, *(FORCE * x))[0], np.array(force) / FORCE)[2] * FORCE

    # A parabola through three points around the extremum: its top is accurate to h^4.
    h = 1e-3
    loads = [load(psi + k * h) for k in (-1, 0, 1)]
    slope, bend = (loads[2] - loads[0]) / 2, loads[2] - 2 * loads[1] + loads[0]
    return loads[1] - slope**2 / (2 * bend)


def place_by_shooting(path, row, hinge):
    """Position of the loaded point at the load of a row of the path; not at limit points."""
    psi, *reaction, load = start(path, row, hinge)

    def gap(x):
        return shoot(x[0], *(FORCE * x[1:]), load)[0]

    x = solved(gap, np.array([psi, *(np.array(reaction) / FORCE)]))
    return shoot(x[0], *(FORCE * x[1:]), load)[1]


def start(path, row, hinge):
    """Rotation, reaction (2,) and load in a row of the path: initial guess of the shooting."""
    return path.rotation(hinge)[row], *path.reaction(hinge)[row, :2], LOAD * path.load_factor[row]


# -- The frame -------------------------------------------------------------------------------------


def compute():
    """The numbers, and what is drawn."""
    meshes, runs = {}, {}
    for degree, counts in MESHES.items():
        for elements in counts:
            log.info("degree %d, %d elements", degree, elements)
            made = scene(elements, degree)
            solution = fb.static(made[0], STEPS, continuation="arc-length")
            runs[elements, degree] = *made, solution
            name = f"degree {degree}, {elements} elements"
            meshes[name] = [LOAD * factor for factor in solution.stats.limit_points]

    frame, loaded, hinge, path = runs[ELEMENTS, DEGREE]
    rows = [int(np.flatnonzero(path.load_factor == p)[0]) for p in path.stats.limit_points]
    down = -path.displacement(loaded)[:, 1]
    numbers = {
        "limit loads": meshes,
        "limit loads by shooting": [limit_by_shooting(path, row, hinge) for row in rows],
        "deflection at the limit loads": [down[row] for row in rows],
        "steps": path.stats.steps,
        "Newton iterations": path.stats.newton_iterations,
        "cuts": path.stats.halvings,
        "largest way back of the loaded point": float((np.maximum.accumulate(down) - down).max()),
        "load at the end": LOAD * path.load_factor[-1],
    }
    try:
        fb.static(frame, STEPS)
    except fb.StepError as error:
        numbers["load steps alone end at"] = LOAD * error.time
    return numbers, (path, loaded, hinge, rows)


def report(numbers):
    shot = numbers["limit loads by shooting"]
    print(f"Limit loads by shooting: {shot[0]:.2f} and {shot[1]:.2f}")
    for name, loads in numbers["limit loads"].items():
        off = ", ".join(
            f"{load:.2f} ({load - s:+.2f})" for load, s in zip(loads, shot, strict=True)
        )
        print(f"{name:>24}: {off}")
    print(
        f"Arc length: {numbers['steps']} steps, {numbers['Newton iterations']} iterations, "
        f"{numbers['cuts']} cuts, up to a load of {numbers['load at the end']:g}; the loaded point "
        f"moves back by {numbers['largest way back of the loaded point']:.2f} on the way\n"
        f"Load steps without arc length fail at {numbers['load steps alone end at']:.0f}"
    )


def draw(results, path, loaded, hinge, rows):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", scene_unit="-", dimensions=True)
    load, moved = LOAD * path.load_factor / 1e3, path.displacement(loaded)
    figure, axes = plot.figure(1, 2, height=3.6)
    shot = [k for k in range(2, len(load), 4) if min(abs(k - row) for row in rows) > 1]
    places = np.array([place_by_shooting(path, k, hinge) for k in shot]) - (AT, LEG)
    looks = (-1, 1, "deflection $-u_y$"), (1, 0, "displacement $u_x$")
    for ax, (sign, component, label) in zip(axes.flat, looks, strict=True):
        ax.axhspan(*(x / 1e3 for x in LITERATURE), color="#E69F00", alpha=0.5, lw=0)
        ax.plot(sign * moved[:, component], load, ".-", color="#0072B2", markersize=4)
        rings = {"markerfacecolor": "none", "markersize": 6}
        ax.plot(sign * places[:, component], load[shot], "o", color="k", **rings)
        ax.plot(sign * moved[rows, component], load[rows], "D", color="#D55E00", zorder=4)
        ax.set(xlabel=f"{label} at the load", ylabel="load $P$ [$10^3$]")
    ax.plot([], [], ".-", color="#0072B2", label="arc length")
    ax.plot([], [], "o", color="k", **rings, label="shooting")
    ax.plot([], [], "D", color="#D55E00", label="limit points")
    ax.fill_between([], [], color="#E69F00", alpha=0.5, label="first limit load, literature")
    plot.save(figure, results / "load_and_displacement.png")

    # The three unloaded states on the path, both limit points, and the end.
    unloaded = [int(np.argmin(abs(part))) for part in np.split(load, rows)]
    shown = sorted([*np.add(unloaded, [0, *rows]), *rows, len(load) - 1])
    plot.shapes(path, results / "shapes.png", rows=shown, scene_unit="-")
    plot.shapes(path, results / "moments.png", rows=shown, scene_unit="-", colour="M")
    plot.animate(
        path, results / "motion.gif", rows=range(len(load)), fps=8, trace=loaded, scene_unit="-"
    )
    thumbnail.card(path, range(len(load)), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
