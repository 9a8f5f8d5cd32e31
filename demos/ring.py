r"""Ring: natural frequencies, and free flight after an impact.

A thin steel ring is made of two half circles. The first part computes its natural frequencies:
three rigid modes, then pairs of modes with 2, 3, 4, ... waves around the circumference. In the
second part the ring flies and spins. Two opposite forces squeeze it for a short time. It then
vibrates with large displacements, at the most nearly half its diameter. Objective: curved elements
compared with straight ones, and the energy and momenta of a curved body.

Reference for the frequencies: A. E. H. Love, A Treatise on the Mathematical Theory of Elasticity,
4th edition (1927), section 293. A ring that does not stretch has, for $n$ waves, the angular
frequency

$$ \omega_n^2 = \frac{EI\,n^2 (n^2 - 1)^2}{\rho A\,R^4 (n^2 + 1)}. $$

A ring that stretches and shears, and whose sections have inertia, moves with radial displacement
$A \cos n\theta$, tangential displacement $B \sin n\theta$ and rotation $C \sin n\theta$, which have

- the axial strain $(A + n B)/R$,
- the shear strain $(B + n A)/R - C$,
- the curvature $n C/R$,

so that its frequencies are those of a system with three degrees of freedom: the exact ones here.
"""

import logging
import math

import numpy as np
import scipy.linalg

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS = 0.5  # R [m]
SECTION = fb.Section.rectangle(
    height=5e-3,  # [m]
    width=20e-3,  # [m]
    E=210e9,  # [Pa]
    nu=0.3,
    rho=7850.0,  # [kg/m³]
)
WAVES = 2, 3, 4, 5
MESHES = {1: (32, 64), 2: (16, 32), 3: (12, 24)}  # elements by degree, of the whole ring

DEGREE, ELEMENTS = 2, 24
VELOCITY = 2.0, 0.0  # [m/s]
SPIN = 10.0  # [rad/s]
FORCE = 3 * SECTION.EI / RADIUS**2  # largest force on either side [N]
PULSE = 0.06  # length of the blow [s]
T_END = 1.0  # [s]
DT = 1e-3  # [s]
STEPS = 2e-3, DT, 5e-4  # [s]
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "ModifiedMidPoint": fb.ModifiedMidPoint(),
    "Newmark": fb.Newmark(),
    "HHT": fb.HHT(-0.1),
}
# A failing step is halved at most twice: more would only prolong a motion that is lost.
MAX_HALVINGS = 2


def scene(degree=DEGREE, elements=ELEMENTS):
    """The ring in two halves that share both nodes at which they meet."""
    ring, R, half = fb.Scene(), RADIUS, elements // 2
    upper = ring.add_beam(
        fb.arc((R, 0), (0, R), (-R, 0)), SECTION, elements=half, degree=degree, name="upper half"
    )
    lower = ring.add_beam(
        fb.arc(upper.end, (0, -R), upper.start),
        SECTION,
        elements=half,
        degree=degree,
        name="lower half",
    )
    return ring, upper, lower


# -- Frequencies -----------------------------------------------------------------------------------


def inextensional(n):
    """Angular frequency [rad/s] of a ring that does not stretch."""
    s = SECTION
    return math.sqrt(s.EI * n**2 * (n**2 - 1) ** 2 / (s.rhoA * RADIUS**4 * (n**2 + 1)))


def exact(n):
    """Lowest angular frequency [rad/s] with $n$ waves of a ring that stretches and shears."""
    s, R = SECTION, RADIUS
    axial, shear, bending = (
        np.array(row) for row in ((1 / R, n / R, 0), (n / R, 1 / R, -1), (0, 0, n / R))
    )
    K = s.EA * np.outer(axial, axial) + s.GA * np.outer(shear, shear)
    K += s.EI * np.outer(bending, bending)
    squares = scipy.linalg.eigvalsh(K, np.diag([s.rhoA, s.rhoA, s.rhoI]))
    return math.sqrt(squares[0])


def frequencies():
    """Frequencies [Hz] of all meshes, and how far they are from the exact ones."""
    meshes = {}
    wanted = np.array([exact(n) for n in WAVES])
    for degree, counts in MESHES.items():
        for count in counts:
            modes = fb.modes(scene(degree, count)[0], n=3 + 2 * len(WAVES))
            pairs = modes.angular_frequencies[3:].reshape(-1, 2)
            meshes[f"degree {degree}, {count} elements"] = {
                "rigid modes": int(modes.rigid.sum()),
                "frequencies": (pairs[:, 0] / (2 * math.pi)).tolist(),
                "relative errors": (pairs[:, 0] / wanted - 1).tolist(),
                "largest split of a pair": (pairs[:, 1] / pairs[:, 0] - 1).max(),
            }
    return meshes


# -- Flight ----------------------------------------------------------------------------------------


def blow(t):
    return FORCE * math.sin(math.pi * t / PULSE) if t < PULSE else 0.0


def thrown():
    """The ring with its velocities and the blow."""
    ring, upper, lower = scene()
    ring.add_force(upper.start, lambda t: (-blow(t), 0))
    ring.add_force(upper.end, lambda t: (blow(t), 0))
    for half in (upper, lower):
        ring.set_velocity(
            half, lambda x, y: (VELOCITY[0] - SPIN * y, VELOCITY[1] + SPIN * x), spin=SPIN
        )
    return ring


def fly(scheme, dt):
    """The solution, up to a step that fails."""
    log.info("%s, dt = %g s", scheme.name, dt)
    ring = thrown()
    try:
        return fb.simulate(ring, scheme, dt=dt, t_end=T_END, max_halvings=MAX_HALVINGS)
    except fb.StepError as error:
        return error.solution


def diameter(solution):
    """Distance [m] between the two loaded nodes."""
    half = solution.beams["upper half"]
    return np.hypot(*(solution.position(half.start) - solution.position(half.end)).T)


def after_the_blow(values):
    """Times after the blow, and values relative to that at its end."""

    def ratio(solution):
        after = solution.t > PULSE - 1e-9
        return solution.t[after], values(solution)[after] / values(solution)[after][0]

    return ratio


energy_ratio = after_the_blow(lambda solution: solution.energy.total)
momentum_ratio = after_the_blow(lambda solution: solution.angular_momentum)


def audit(solution):
    """Numbers by which a run is assessed."""
    _, energy = energy_ratio(solution)
    _, momentum = momentum_ratio(solution)
    linear = solution.linear_momentum
    return {
        "steps": solution.stats.steps,
        "lowest energy ratio": energy.min(),
        "highest energy ratio": energy.max(),
        "energy drift": abs(energy - 1).max(),
        "angular momentum drift": abs(momentum - 1).max(),
        "linear momentum drift": abs(linear - linear[0]).max() / abs(linear[0]).max(),
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
        "failure": solution.stats.failure and solution.stats.failure.reason,
    }


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {(name, dt): fly(SCHEMES[name], dt) for name in SCHEMES for dt in steps}
    flight = runs["EnergyMomentum", DT]
    numbers = {
        "inextensional": [inextensional(n) / (2 * math.pi) for n in WAVES],
        "exact": [exact(n) / (2 * math.pi) for n in WAVES],
        "meshes": frequencies(),
        "diameter": [diameter(flight).min() / (2 * RADIUS), diameter(flight).max() / (2 * RADIUS)],
        "largest share of strain energy": (flight.energy.strain / flight.energy.total).max(),
        "schemes": {
            name: {f"dt {dt:g}": audit(runs[name, dt]) for dt in steps} for name in SCHEMES
        },
    }
    return numbers, (runs,)


def report(numbers):
    row = "{:26}".format, ("{:>12}" * len(WAVES)).format
    print(row[0]("Frequencies [Hz]"), row[1](*(f"{n} waves" for n in WAVES)))
    for name in ("inextensional", "exact"):
        print(row[0](name), row[1](*(f"{f:.4f}" for f in numbers[name])))
    print("Relative errors of the meshes")
    for name, mesh in numbers["meshes"].items():
        print(row[0](name), row[1](*(f"{error:.1e}" for error in mesh["relative errors"])))
    low, high = numbers["diameter"]
    share = numbers["largest share of strain energy"]
    print(
        f"\nThe diameter varies from {low:.2f} to {high:.2f} times its initial value; the strain "
        f"energy is at most {share:.2f} of the total.\n{T_END:g} s, a failing step halved at most "
        f"{MAX_HALVINGS} times. E0 and L0 are the values after the blow, p0 at the start:"
    )
    line = "{:16} {:>7} {:>5} {:>7} {:>7} {:>8} {:>8} {:>8} {:>5} {:>6}".format
    print(line("", "dt", "", "lowest", "highest", "largest", "largest", "largest", "halv-", ""))
    units = "[s]", "steps", "E/E0", "E/E0", "|E/E0-1|", "|L/L0-1|", "|p-p0|/p", "ings", "failed"
    print(line("scheme", *units))
    for name, runs in numbers["schemes"].items():
        for dt, run in runs.items():
            values = (
                dt.removeprefix("dt "),
                run["steps"],
                f"{run['lowest energy ratio']:.4f}",
                f"{run['highest energy ratio']:.4f}",
                f"{run['energy drift']:.1e}",
                f"{run['angular momentum drift']:.1e}",
                f"{run['linear momentum drift']:.1e}",
                run["halvings"],
                "never" if run["failure"] is None else f"{run['failed at']:.2f} s",
            )
            print(line(name, *values))


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    ring, *halves = scene(elements=48)
    modes = fb.modes(ring, n=3 + 2 * len(WAVES))
    figure, axes = plot.figure(1, len(WAVES), height=2.0)
    for k, (ax, n) in enumerate(zip(axes.flat, WAVES, strict=True)):
        for half in halves:
            for size, colour, width in ((0.0, "0.7", 1), (0.25 * RADIUS, "C0", 2)):
                nodes = modes.shape(half, 3 + 2 * k, size=size)
                ax.plot(*plot.axis(nodes, half.degree).T, colour, linewidth=width)
        window = -1.3 * RADIUS, 1.3 * RADIUS
        ax.set(xlim=window, ylim=window, aspect="equal")
        ax.set_title(f"{n} waves, {modes.frequencies[3 + 2 * k]:.1f} Hz", fontsize="medium")
        ax.axis("off")
    figure.savefig(results / "modes.png", dpi=200)

    flight = runs["EnergyMomentum", DT]
    plot.shapes(flight, results / "shapes.png", rows=range(0, 901, 150))
    plot.animate(flight, results / "motion.gif", rows=range(0, len(flight.t), 8), fps=20)
    thumbnail.card(flight, range(0, len(flight.t), 8), results / "thumbnail.png")

    figure, axes = plot.figure(2, 2)
    for (energy, drift), dt in zip(axes.T, (max(STEPS), DT), strict=True):
        solutions = {name: runs[name, dt] for name in SCHEMES}
        energy.set(xlim=(0, T_END), ylim=(0.9, 1.1), title=f"$\\Delta t$ = {dt:g} s")
        energy.set(ylabel="total energy $E/E_0$ [-]")
        drift.set(xlim=(0, T_END), ylim=(1e-17, 1e3), yscale="log")
        drift.set(ylabel="largest $|E/E_0 - 1|$ so far [-]")
        plot.curves(energy, solutions, lambda s: energy_ratio(s)[1], lambda s: energy_ratio(s)[0])
        plot.curves(
            drift,
            solutions,
            lambda solution: np.maximum.accumulate(abs(energy_ratio(solution)[1] - 1)),
            lambda solution: energy_ratio(solution)[0],
        )
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]")
    plot.save(figure, results / "energy.png")


if __name__ == "__main__":
    script.run()
