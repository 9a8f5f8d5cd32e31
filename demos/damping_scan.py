r"""Numerical damping in the paper's four examples: a scan of its parameter and of the time step.

The paper says that the numerical dissipation of the HHT scheme does not cure the instability of
Newmark's rule but "merely postpones" it. It does not give its value of $\alpha$. Objective: the
time at which the energy of a run exceeds 1.5 times its initial value. HHT is run with $\alpha$ from
0, which is Newmark's rule, to its limit of $-1/3$; generalized alpha with spectral radii $\rho$
from 0.9 to 0. All run with several time steps.

References: A. Ibrahimbegovic, S. Mamouri, Nonlinear dynamics of flexible beams in planar motion:
formulation and time-stepping scheme for stiff problems, Computers & Structures 70 (1999) 1-22,
sections 4 and 5, doi 10.1016/S0045-7949(98)00150-3; H. M. Hilber, T. J. R. Hughes, R. L. Taylor,
Earthquake Engineering & Structural Dynamics 5 (1977) 283-292; J. Chung, G. M. Hulbert, Journal of
Applied Mechanics 60 (1993) 371-375.

The two families have members in common: HHT with $\alpha = -1/3$ is generalized alpha with
$\rho = 1/2$, and HHT with $\alpha = 0$ is generalized alpha with $\rho = 1$. The scenes are those
of the other demos. If a step of these two families still fails after two halvings, the run stops
and counts as lost at that time; for the schemes that conserve energy the limit is twelve halvings,
the default. The values of $\alpha$ and of the time steps are our choice.
"""

import logging

import fx_beam as fb
import multibody
import pendulum
import pinned_beam
import three_bar_swing
from shared import script

log = logging.getLogger("fx_beam.demo")

LOST = 1.5  # times the energy at the start of the free motion
# Scene, end of the loads and of the run [s], and steps [s].
EXAMPLES = {
    "Pendulum": (pendulum, 0.0, 10.0, (0.2, 0.1, 0.05, 0.02, 0.01)),
    "Three-bar swing": (three_bar_swing, three_bar_swing.PULSE_END, 1.0, (4e-3, 2e-3, 1e-3, 5e-4)),
    "Multi-body system": (multibody, multibody.PULSE_END, 4.0, (0.01, 0.005, 0.0025)),
    "Pinned beam": (pinned_beam, 0.0, 10.0, (0.02, 0.01, 0.005)),
}
ALPHAS = (0.0, -0.01, -0.05, -0.07, -0.1, -0.2, -1 / 3)
RADII = (0.9, 0.8, 0.7, 0.5, 0.0)


def schemes(alphas=ALPHAS, radii=RADII):
    """Schemes by name: two that conserve energy, then both families in order of damping."""
    return (
        {"EnergyMomentum": fb.EnergyMomentum(), "ModifiedMidPoint": fb.ModifiedMidPoint()}
        | {f"HHT, alpha = {alpha:.2g}": fb.HHT(alpha) for alpha in alphas}
        | {f"Generalized alpha, {rho:g}": fb.GeneralizedAlpha(rho) for rho in radii}
    )


def run(example, scheme, dt):
    """Time [s] at which a run was lost, or None, and its lowest energy ratio until then."""
    module, start, t_end, _ = EXAMPLES[example]
    made = module.scene()
    scene = made if isinstance(made, fb.Scene) else made[0]
    record = fb.Record(motion=False, rates=False, forces=False)
    log.info("%s: %s, dt = %g s", example, scheme.name, dt)
    limit = {} if multibody.keeps_energy(scheme) else {"max_halvings": multibody.MAX_HALVINGS}
    try:
        solution = fb.simulate(scene, scheme, dt=dt, t_end=t_end, record=record, **limit)
    except fb.StepError as error:
        solution = error.solution
    free = solution.t > start - 1e-9
    t, ratio = solution.t[free], solution.energy.total[free] / solution.energy.total[free][0]
    above = t[~(ratio <= LOST)]
    broke_off = not len(above) and bool(solution.stats.failure)
    lost = float(above[0]) if len(above) else float(t[-1]) if broke_off else None
    lowest = float(ratio[t <= (lost or t_end)].min())
    return {"lost at": lost, "broke off": broke_off, "lowest energy ratio": lowest}


def scan(alphas=ALPHAS, radii=RADII, examples=EXAMPLES):
    """The runs by example, scheme and step."""
    return {
        example: {
            name: {f"dt {dt:g}": run(example, scheme, dt) for dt in EXAMPLES[example][3]}
            for name, scheme in schemes(alphas, radii).items()
        }
        for example in examples
    }


def compute(alphas=ALPHAS, radii=RADII):
    """The numbers, and what is drawn."""
    numbers = scan(alphas, radii)
    return numbers, (numbers,)


def cell(run):
    """Text for one run: the time at which it was lost, or else its largest loss of energy."""
    if run["lost at"] is not None:
        return f"{run['lost at']:.3g} s{' x' if run['broke off'] else ''}"
    loss = 1 - run["lowest energy ratio"]
    if loss < 1e-9:
        return "kept"
    if loss < 1e-3:
        return f"-{loss:.0e}".replace("e-0", "e-")
    return f"-{100 * loss:.0f} %" if loss >= 0.0995 else f"-{100 * loss:.1f} %"


def report(numbers):
    print(
        f"Time at which the energy exceeded {LOST} times that at the start of the free motion, or "
        "(x) at which\na step failed before that; otherwise the largest loss of energy:"
    )
    for example, schemes in numbers.items():
        _, _, t_end, steps = EXAMPLES[example]
        print(f"\n{example}, {t_end:g} s")
        row = ("{:24}" + " {:>11}" * len(steps)).format
        print(row("", *(f"dt {dt:g} s" for dt in steps)))
        for scheme, runs in schemes.items():
            print(row(scheme, *map(cell, runs.values())))


def draw(results, numbers):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from matplotlib.colors import ListedColormap

    from fx_beam import plot
    from shared import thumbnail

    # What is lost: the pinned beam by a scheme that does not keep its energy.
    module, _, t_end, steps = EXAMPLES["Pinned beam"]
    made = module.scene()
    try:
        motion = fb.simulate(
            *(made if isinstance(made, fb.Scene) else made[0], fb.HHT(0.0)),
            **{"dt": steps[0], "t_end": t_end, "max_halvings": multibody.MAX_HALVINGS},
        )
    except fb.StepError as error:
        motion = error.solution
    plot.animate(motion, results / "motion.gif")
    thumbnail.card(motion, range(len(motion.t)), results / "thumbnail.png")

    kinds = {
        "energy within 0.1 %": "#CFE6F4",
        "energy lost, in percent": "#F6E7A1",
        "motion lost, at this time": "#F2B48A",
    }
    figure, axes = plot.figure(1, len(numbers), height=4.2)
    axes[0, 0].get_gridspec().set_width_ratios([len(EXAMPLES[name][3]) for name in numbers])
    for ax, (example, schemes) in zip(axes[0], numbers.items(), strict=True):
        _, _, t_end, steps = EXAMPLES[example]
        colours = [[kind(run) for run in runs.values()] for runs in schemes.values()]
        look = {"cmap": ListedColormap([*kinds.values()]), "vmin": 0, "vmax": 2}
        ax.imshow(colours, aspect="auto", **look)
        for row, runs in enumerate(schemes.values()):
            for column, run in enumerate(runs.values()):
                ax.text(column, row, cell(run), ha="center", va="center", fontsize=6.5)
        ax.grid(False)
        ax.set_title(f"{example}, {t_end:g} s", fontsize=8)
        ax.set_xticks(range(len(steps)), [f"{dt:g}" for dt in steps], fontsize=6)
        ax.set_yticks(range(len(schemes)), [])
        ax.set_xlabel("time step [s]", fontsize=7)
        ax.tick_params(length=0)
    axes[0, 0].set_yticks(range(len(schemes)), [*schemes], fontsize=7)
    for name, colour in kinds.items():
        axes[0, 0].plot([], [], "s", color=colour, markersize=9, label=name)
    plot.save(figure, results / "lost.png")


def kind(run):
    """Index of the colour that shows the outcome of a run."""
    if run["lost at"] is not None:
        return 2
    return 1 if 1 - run["lowest energy ratio"] >= 1e-3 else 0


if __name__ == "__main__":
    script.run()
