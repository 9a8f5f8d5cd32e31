r"""Simple pendulum on a nearly rigid rod.

A mass at the end of a massless beam, pinned at the top, swings by 45 degrees to each side. The
beam is one element. It is so stiff that its axial vibration is some hundred thousand times faster
than the swing. A time step that suits the swing does not resolve it. Objective: the swing with
steps up to 0.1 s, a fifteenth of the period, and its energy, axial force and acceleration (the
paper's figures 3 to 7).

Reference: A. Ibrahimbegovic, S. Mamouri, Nonlinear dynamics of flexible beams in planar motion:
formulation and time-stepping scheme for stiff problems, Computers & Structures 70 (1999) 1-22,
section 4.1, doi 10.1016/S0045-7949(98)00150-3.

On a rigid rod the angle $\theta$ from the vertical starts from 0 with the speed $v_0$ of the mass.
It is

$$
L \ddot\theta = -g \sin\theta, \quad \sin(\theta/2) = k\,\mathrm{sn}(\omega t, k), \quad
\omega = \sqrt{g/L}, \quad k = \frac{v_0}{2 \omega L},
$$

with Jacobi's elliptic function $\mathrm{sn}$. The period is $4 K(k)/\omega$ with the complete
elliptic integral $K$. The axial force is $N = m (g \cos\theta + L \dot\theta^2)$.

The beam starts unstressed, whereas the rigid rod carries $m (g + v_0^2/L)$ at the start. The axial
force of the elastic beam therefore vibrates about that of the rigid rod, with this amplitude. The
energy of the vibration, $N^2 L/(2 EA)$, is only 6e-9 J. A run is useful if the scheme does not let
this energy grow.

In the paper the energy blows up, first with Newmark's rule and later with HHT; the value of
$\alpha$ is not given. With steps of 0.1 s this happens here at 1.4 s with Newmark, and at 2.2 s
with HHT and $\alpha = -0.05$. With $\alpha = -0.1$ it does not happen within 10 s; a third of the
energy is lost instead. damping_scan.py shows more values of $\alpha$, and of $\rho$ of generalized
alpha.
"""

import logging

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.special import ellipj, ellipk

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

# Data that are not in the paper, or have lost digits in our text of it.
OURS = {
    "length": "0.5 m, deduced: together with v0 it gives a swing of 45 degrees",
    "mass": "1 kg, deduced: the text has 'm = kg'",
    "initial velocity": "1.695 m/s, deduced: the text has 'v =.695'",
    "EA, GA, EI": "1e10, 1e10 and 1e3, deduced: the text has '0 0', '0 0' and '0 3'",
    "gravity": "9.81 m/s2, our own",
    "time steps": "0.1 s deduced: the text has '0. s'; the others are our own",
    "end of the run": "our own",
    "alpha of HHT": "our own",
}
LENGTH = 0.5  # L [m], deduced
MASS = 1.0  # m [kg], deduced
GRAVITY = 9.81  # g [m/s²]
SPEED = 1.695  # v0 [m/s], deduced: it gives a swing of 45 degrees
SECTION = fb.Section(
    EA=1e10,  # [N], deduced
    GA=1e10,  # [N], deduced
    EI=1e3,  # [N m²], deduced; no effect, as the beam does not bend
    rhoA=0.0,  # [kg/m]
    rhoI=0.0,  # [kg m]
)
T_END = 5.0  # [s]
LARGE, SMALL = 0.1, 0.01  # steps of the figures over time [s]
STEPS = (LARGE, 0.05, 0.02, SMALL, 0.005, 0.002, 0.001)  # [s]

# Energies are those at the ends of the steps. MidPoint evaluates the rod's force at the middle of
# the chord between two positions. The middle stays on the circle; the ends are off by O(dt^2), and
# the large EA turns this into a large energy.
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyDecaying": fb.EnergyDecaying(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "MidPoint": fb.MidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.05": fb.HHT(-0.05),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "Generalized alpha, 0.9": fb.GeneralizedAlpha(0.9),
}
CONSERVING = "EnergyMomentum", "ModifiedMidPoint (as published)"
# The motion counts as lost when the energy exceeds this multiple of its initial value.
LOST = 1.5
# A failing step is halved at most twice: more would only prolong a motion that is lost.
MAX_HALVINGS = 2


def scene(elements=1, degree=1):
    """The scene and its beam."""
    pendulum = fb.Scene(gravity=(0.0, -GRAVITY))
    ends = (0, 0), (0, -LENGTH)
    rod = pendulum.add_beam(ends, SECTION, elements=elements, degree=degree, name="rod")
    pendulum.pin(rod.start)
    pendulum.add_mass(rod.end, MASS)
    pendulum.set_velocity(rod.end, (SPEED, 0.0))
    return pendulum, rod


def rigid(t):
    """Displacement, acceleration and axial force over time on a rigid rod, and the period."""
    w = np.sqrt(GRAVITY / LENGTH)
    k = SPEED / (2 * w * LENGTH)
    sn, cn, dn, _ = ellipj(w * t, k**2)
    theta, rate = 2 * np.arcsin(k * sn), 2 * w * k * cn
    tangent = np.array([np.cos(theta), np.sin(theta)])
    inward = np.array([-np.sin(theta), np.cos(theta)])
    displacement = LENGTH * (np.array([[0.0], [1.0]]) - inward)
    acceleration = -GRAVITY * np.sin(theta) * tangent + LENGTH * rate**2 * inward
    force = MASS * (GRAVITY * np.cos(theta) + LENGTH * rate**2)
    return displacement.T, acceleration.T, force, 4 * ellipk(k**2) / w


def simulate(scheme, dt):
    """The solution, up to a step that fails."""
    log.info("%s, dt = %g s", scheme.name, dt)
    pendulum, _ = scene()
    try:
        return fb.simulate(pendulum, scheme, dt=dt, t_end=T_END, max_halvings=MAX_HALVINGS)
    except fb.StepError as error:
        return error.solution


def displacement(solution):
    return solution.displacement(solution.beams["rod"].end)


def horizontal_acceleration(solution):
    return solution.acceleration(solution.beams["rod"].end)[:, 0]


def acceleration_times(solution):
    """Times of the accelerations: the middle of a step for mid-point schemes, else its end."""
    return solution.t_level if solution.stats.level == 0.5 else solution.t


def energy_ratio(solution):
    return solution.energy.total / solution.energy.total[0]


def axial_force(solution):
    return solution.resultants("rod").N[:, 0]


def period(solution):
    """Time [s] at which the mass passes the lowest point for the second time."""
    x, y = solution.position(solution.beams["rod"].end).T
    vx, vy = solution.velocity(solution.beams["rod"].end).T
    angle, rate = np.unwrap(np.arctan2(x, -y)), (x * vy - y * vx) / (x**2 + y**2)
    bottom = CubicHermiteSpline(solution.t, angle, rate).roots(extrapolate=False)
    bottom = bottom[bottom > 0.01]
    return float(bottom[1]) if len(bottom) > 1 else None


def lost_at(solution):
    """Time [s] at which the energy exceeds LOST times its initial value, or None."""
    above = solution.t[~(energy_ratio(solution) <= LOST)]
    return above[0] if len(above) else None


def audit(solution):
    """Numbers by which a run is assessed."""
    # Row 0 is the unstressed start.
    force = axial_force(solution)[1:]
    return {
        "steps": solution.stats.steps,
        "period": period(solution),
        "energy drift": abs(energy_ratio(solution) - 1).max(),
        "lowest energy ratio": energy_ratio(solution).min(),
        "lost at": lost_at(solution),
        "lowest axial force": force.min(),
        "highest axial force": force.max(),
        "largest horizontal acceleration": abs(horizontal_acceleration(solution)).max(),
        "Newton iterations": solution.stats.newton_iterations,
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
        "failure": solution.stats.failure and solution.stats.failure.reason,
    }


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {(name, dt): simulate(SCHEMES[name], dt) for name in SCHEMES for dt in steps}
    _, acceleration, force, exact = rigid(np.linspace(0, T_END, 10001))
    numbers = {
        "not in the paper": OURS,
        "energy": runs["EnergyMomentum", LARGE].energy.total[0],
        "rigid rod": {
            "period": exact,
            "lowest axial force": force.min(),
            "highest axial force": force.max(),
            "largest horizontal acceleration": abs(acceleration[:, 0]).max(),
        },
        "schemes": {
            name: {f"dt {dt:g}": audit(runs[name, dt]) for dt in steps} for name in SCHEMES
        },
    }
    return numbers, (runs, numbers)


def report(numbers):
    rod = numbers["rigid rod"]
    print("Not in the paper, or illegible in our text of it:")
    print(*(f"    {name}: {why}" for name, why in OURS.items()), sep="\n")
    print(
        f"Energy of the swing {numbers['energy']:.6g} J. On a rigid rod: period "
        f"{rod['period']:.5f} s,\naxial force {rod['lowest axial force']:.4g} to "
        f"{rod['highest axial force']:.5g} N, horizontal acceleration up to "
        f"{rod['largest horizontal acceleration']:.4g} m/s^2\n"
        f"\n{T_END:g} s, a failing step halved at most {MAX_HALVINGS} times. A motion is\n"
        f"lost when its energy exceeds {LOST} times that at the start:"
    )
    row = "{:31} {:>6} {:>5} {:>8} {:>8} {:>7} {:>10} {:>10} {:>9} {:>7} {:>5} {:>6}".format
    names = "dt", "", "period", "largest", "lost at", "lowest", "highest", "accel.", "Newton"
    print(row("", *names, "halv-", ""))
    units = (
        "[s]",
        "steps",
        "[s]",
        "|E/E0-1|",
        "[s]",
        "N [N]",
        "N [N]",
        "m/s^2",
        "it/step",
        "ings",
        "failed",
    )
    print(row("scheme", *units))
    failures = []
    for name, step_runs in numbers["schemes"].items():
        for dt, run in step_runs.items():
            failed = run["failure"] is not None
            values = (
                dt.removeprefix("dt "),
                run["steps"],
                "none" if run["period"] is None else f"{run['period']:.5f}",
                f"{run['energy drift']:.1e}",
                "never" if run["lost at"] is None else f"{run['lost at']:.3g}",
                f"{run['lowest axial force']:.4g}",
                f"{run['highest axial force']:.4g}",
                f"{run['largest horizontal acceleration']:.4g}",
                f"{run['Newton iterations'] / run['steps']:.1f}",
                run["halvings"],
                f"{run['failed at']:.2f} s" if failed else "never",
            )
            print(row(name, *values))
            failures += [run["failure"]] if failed else []
    print(*failures, sep="\n", end="")


def draw(results, runs, numbers):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    # Conserving schemes are drawn last, on top of those whose curves fill the panel. The mid-point
    # rule is left out: the paper does not show it, and its values exceed all scales.
    others = [name for name in SCHEMES if name not in ("MidPoint", *CONSERVING)]
    compared = [*others, *CONSERVING]
    large, small = ({name: runs[name, dt] for name in compared} for dt in (LARGE, SMALL))
    t = np.linspace(0, T_END, 2001)
    rigid_tip, acceleration, force, exact = rigid(t)
    grey = {"color": "0.55", "linewidth": 1.0, "label": "rigid rod, exact"}

    solution = runs["EnergyMomentum", SMALL]
    first = range(0, round(2 * exact / SMALL), 2)
    tip = solution.beams["rod"].end
    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    plot.animate(solution, results / "motion.gif", rows=first, fps=25, trace=tip)
    thumbnail.card(solution, first, results / "thumbnail.png")

    figure, axes = plot.figure(2, 1)
    for i, ax in enumerate(axes.flat):
        ax.set(xlim=(0, T_END), ylim=((-0.45, 0.45), (-0.02, 0.26))[i])
        ax.set(xlabel="time $t$ [s]", ylabel=f"displacement $u_{'xy'[i]}$ [m]")
        ax.plot(t, rigid_tip[:, i], **grey)
        plot.curves(ax, large, lambda s, i=i: displacement(s)[:, i])
    axes[0, 0].set_title(f"$\\Delta t$ = {LARGE:g} s")
    plot.save(figure, results / "displacement.png")

    # Small steps are shown over half a period only, so that single steps are visible.
    windows = (large, LARGE, 3.0), (small, SMALL, 0.75)
    figure, axes = plot.figure(1, 2, height=3.0)
    for ax, (solutions, dt, until) in zip(axes[0], windows, strict=True):
        ax.set(xlim=(0, until), ylim=(-20, 20), title=f"$\\Delta t$ = {dt:g} s")
        ax.set(xlabel="time $t$ [s]", ylabel="acceleration $a_x$ [m/s$^2$]")
        ax.plot(t, acceleration[:, 0], **grey)
        plot.curves(ax, solutions, horizontal_acceleration, acceleration_times)
    plot.save(figure, results / "acceleration.png")

    figure, axes = plot.figure(2, 2)
    for column, (solutions, dt, _) in zip(axes.T, windows, strict=True):
        top, bottom = column
        top.set(xlim=(0, T_END), ylim=(0.4, 30), yscale="log", title=f"$\\Delta t$ = {dt:g} s")
        top.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        top.minorticks_off()
        top.set(xlabel="time $t$ [s]", ylabel="total energy $E/E_0$ [-]")
        plot.curves(top, solutions, energy_ratio)
        # Linear up to the forces of the swing, logarithmic above.
        bottom.set(xlim=(0, T_END), ylim=(-1e7, 1e7))
        bottom.set_yscale("symlog", linthresh=20)
        bottom.set_yticks([-1e6, -1e4, -100, 0, 10, 100, 1e4, 1e6])
        bottom.set(xlabel="time $t$ [s]", ylabel="axial force $N$ [N]")
        bottom.plot(t, force, **grey)
        plot.curves(bottom, solutions, axial_force, lambda solution: solution.t_level)
    plot.save(figure, results / "energy_and_force.png")

    steps = sorted({dt for _, dt in runs})
    figure, (axes,) = plot.figure(1, 3, height=3.0)
    largest = numbers["rigid rod"]["highest axial force"]
    for name, step_runs in numbers["schemes"].items():
        runs_of = [step_runs[f"dt {dt:g}"] for dt in steps]
        marker = "s" if name == "HHT, alpha = -0.05" else "o"
        look = plot.style(SCHEMES[name].name) | {"marker": marker, "markersize": 5}
        late = [abs(run["period"] / exact - 1) if run["period"] else np.nan for run in runs_of]
        axes[0].plot(steps, late, label=name, **look)
        axes[1].plot(steps, [run["energy drift"] for run in runs_of], label=name, **look)
        off = [abs(run["highest axial force"] - largest) for run in runs_of]
        axes[2].plot(steps, off, label=name, **look)
    guide = np.array([0.005, 0.05])
    axes[0].plot(guide, 2e-1 * guide**2, color="0.55", linewidth=1.0, label="order 2")
    axes[0].set(ylabel="error of the period $|T/T_{rigid} - 1|$ [-]")
    axes[1].set(ylabel="largest $|E/E_0 - 1|$ [-]")
    axes[2].set(ylabel="error of the largest $N$ [N]", ylim=(1e-3, 1e3))
    for ax in axes:
        ax.set(xscale="log", yscale="log", xlabel="time step $\\Delta t$ [s]")
    plot.save(figure, results / "steps.png")


if __name__ == "__main__":
    script.run()
