r"""A bimetal strip over a heater: two fields on one mesh, one of them by dolfinx alone.

A strip of two metals, bent a little towards a heater, is pinned at both ends. Heat gives it the
opposite curvature, until it snaps away from the heater; there it cools, and snaps back: a thermal
relay. Objective: to couple a heat equation, written as any problem of dolfinx, to the motion of a
scene on the same mesh.

1. Heat. The temperature $T(s, t)$ above that of the air is zero at both ends and obeys, with heat
   capacity $c$ per volume, conductivity $k$, film coefficient $h$ and thickness $d$,

   $$
   c \dot T = k T_{ss} - \frac{2 h}{d} T + q(y), \qquad
   q(y) = \frac{q_0}{1 + \exp((y - y_0)/l)}.
   $$

   The source $q$ fades where the strip is higher than $y_0$. The implicit Euler rule takes a step
   of it after each step of the motion.
2. Strain. Layers of thickness $d/2$ and equal stiffness that expand by $a_1$ (above) and $a_2$
   (below) have the natural axial strain $\frac{1}{2} (a_1 + a_2) T$ and the natural curvature
   $\frac{3}{2} (a_1 - a_2) T/d$ (Timoshenko 1925, doi 10.1364/JOSA.11.000233).

Check: where the source is constant, the steady temperature is that of the closed form
$T = \frac{q d}{2 h} \left(1 - \cosh(m (s - L/2))/\cosh(m L/2)\right)$ with $m^2 = 2 h/(k d)$. Units
are metre, kilogram, second and kelvin.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

try:
    from fx_beam import fenicsx
except ImportError as error:
    raise SystemExit(str(error)) from None

from petsc4py import PETSc

import ufl
from dolfinx import fem
from dolfinx.fem.petsc import LinearProblem

log = logging.getLogger("fx_beam.demo")

SPAN, SAG, THICK, WIDTH = 0.1, 0.6e-3, 0.2e-3, 10e-3  # [m]
STRIP = {"height": THICK, "width": WIDTH, "E": 170e9, "nu": 0.3, "rho": 8100.0}
ABOVE, BELOW = 9e-6, 14e-6  # expansions a1, a2 [1/K]
SUPPORT = 7e4  # stiffness along the strip, of the right support [N/m]
CAPACITY, CONDUCTIVITY = 4e6, 13.0  # c [J/(m³ K)], k [W/(m K)]
FILM = 400.0  # h, with a fan [W/(m² K)]
SOURCE, REACH, FADING = 5e8, -0.1e-3, 0.1e-3  # q0 [W/m³], y0, l [m]
ELEMENTS = 16
RETARDATION = 4e-3  # damping [s]
DT, T_END = 5e-3, 6.0  # [s]


def scene():
    """The strip, which sags as a sine."""
    strip = fb.Section.rectangle(**STRIP)
    strip = fb.Section(
        **{name: getattr(strip, name) for name in ("EA", "GA", "EI", "rhoA", "rhoI")},
        retardation=RETARDATION,
    )
    heated = fb.Scene()
    curve = fb.Curve(lambda f: (SPAN * f, -SAG * np.sin(np.pi * f)))
    beam = heated.add_beam(curve, strip, elements=ELEMENTS, name="strip")
    heated.pin(beam.start)
    slot = fb.PinInSlot(fb.GROUND, beam.end, axis=(1, 0), spring=fb.Spring(SUPPORT))
    heated.add_joint(slot)
    heated.add_natural_strain(beam, axial=0.0)  # those by heat take its place
    return heated, beam


class Heat:
    """The heat equation on a mesh of intervals, of which y is moved by a displacement."""

    def __init__(self, mesh, dt, u=None):
        space = getattr(fem, "functionspace", fem.FunctionSpace)(mesh, ("Lagrange", 1))
        self.T, self._last = (fem.Function(space, name=name) for name in ("T", "before"))
        T, S, x = ufl.TrialFunction(space), ufl.TestFunction(space), ufl.SpatialCoordinate(mesh)
        far = 0.0 if u is None else ufl.exp((x[1] + u[1] - REACH) / FADING)
        source = SOURCE / (1 + far) + 0 * x[0]
        loss = 2 * FILM / THICK
        a = (CAPACITY / dt + loss) * T * S * ufl.dx
        a += CONDUCTIVITY * ufl.dot(ufl.grad(T), ufl.grad(S)) * ufl.dx
        b = (CAPACITY / dt * self._last + source) * S * ufl.dx
        end_dofs = fem.locate_dofs_geometrical(
            space, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[0], SPAN)
        )
        cold = fem.dirichletbc(PETSc.ScalarType(0.0), end_dofs, space)
        options = {"bcs": [cold], "u": self.T}
        if "petsc_options_prefix" in LinearProblem.__init__.__code__.co_varnames:
            options["petsc_options_prefix"] = "heat_"
        self._problem = LinearProblem(a, b, **options)

    def advance(self):
        """Take a step."""
        self._problem.solve()
        self._last.x.array[:] = self.T.x.array


def by_heat(T):
    """Natural axial strain, shear strain and curvature of the bimetal."""
    return (ABOVE + BELOW) / 2 * T, 0, 1.5 * (ABOVE - BELOW) * T / THICK


def steady():
    """Temperatures of a strip that does not move, after a long time, and their closed form."""
    straight = fb.Scene()
    beam = straight.add_beam([(0, 0), (SPAN, 0)], fb.Section.rectangle(**STRIP), 4 * ELEMENTS)
    straight.clamp(beam.start)
    heat = Heat(fenicsx.Problem(straight, dt=1.0).mesh, 100.0)
    for _ in range(20):
        heat.advance()
    x = heat.T.function_space.tabulate_dof_coordinates()[:, 0]
    m = np.sqrt(2 * FILM / (CONDUCTIVITY * THICK))
    profile = 1 - np.cosh(m * (x - SPAN / 2)) / np.cosh(m * SPAN / 2)
    return heat.T.x.array, SOURCE * THICK / (2 * FILM) * profile


def motion(t_end=T_END):
    """The motion, with temperatures (n, nodes) along the strip."""
    heated, beam = scene()
    problem = fenicsx.Problem(heated, fb.EnergyMomentum(), dt=DT)
    heat = Heat(problem.mesh, DT, problem.u)
    problem.natural_strains = by_heat(heat.T)
    order = np.argsort(heat.T.function_space.tabulate_dof_coordinates()[:, 0])
    temperatures = [heat.T.x.array[order].copy()]

    def conduct(problem):
        heat.advance()
        temperatures.append(heat.T.x.array[order].copy())

    solution = problem.run(t_end, after=conduct)
    return solution, np.array(temperatures), problem, heat


def compute(t_end=T_END):
    """The numbers, and what is drawn."""
    log.info("the strip over the heater")
    solution, temperatures, problem, heat = motion(t_end)
    height = solution.position(solution.beams["strip"].node(0.5))[:, 1]
    snaps = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0)) + 1
    returns = np.flatnonzero((height[:-1] >= 0) & (height[1:] < 0)) + 1
    steady_state, closed_form = steady()
    energy = solution.energy
    numbers = {
        "snaps": len(snaps),
        "returns": len(returns),
        "lowest and highest [mm]": [1e3 * height.min(), 1e3 * height.max()],
        "middle at the last snap, at the return before it [K]": [
            temperatures[snaps[-1]].max(),
            temperatures[returns[-1]].max(),
        ],
        "seconds from snap to snap": float(np.diff(solution.t[snaps])[1:].mean()),
        "steady temperature, relative error": abs(steady_state - closed_form).max()
        / closed_form.max(),
        "work of heat [uJ]": 1e6 * energy.work[-1],
        "balance of energy, relative": abs(energy.balance_error).max() / energy.strain.max(),
    }
    return numbers, (solution, temperatures, problem, heat)


def report(numbers):
    low, high = numbers["lowest and highest [mm]"]
    hot, cool = numbers["middle at the last snap, at the return before it [K]"]
    print(
        f"The strip snaps away {numbers['snaps']} times and returns {numbers['returns']} times, "
        f"every {numbers['seconds from snap to snap']:.2f} s, between {low:.2f} and {high:.2f} mm\n"
        f"It is {hot:.1f} K warmer than the air when it snaps away, {cool:.1f} K when it returns\n"
        f"Steady temperature of a strip at rest: closed form to "
        f"{numbers['steady temperature, relative error']:.1e}\n"
        f"The strains by heat have done {numbers['work of heat [uJ]']:.3g} uJ of work; the balance "
        f"of energy closes to {numbers['balance of energy, relative']:.0e}"
    )


def draw(results, solution, temperatures, problem, heat):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.animate(solution, results / "motion.gif", magnify=20.0)
    thumbnail.card(solution, range(len(solution.t) // 2), results / "thumbnail.png", tall=20)
    figure, axes = plot.figure(3, 1, height=2.0)
    field, middle, shapes = axes.flat
    s = np.linspace(0, 1e3 * SPAN, temperatures.shape[1])
    image = field.pcolormesh(solution.t, s, temperatures.T, cmap="inferno", rasterized=True)
    figure.colorbar(image, ax=field, label="$T$ [K]")
    field.set(xlabel="time $t$ [s]", ylabel="place $s$ [mm]")
    height = 1e3 * solution.position(solution.beams["strip"].node(0.5))[:, 1]
    middle.plot(solution.t, height)
    middle.set(xlabel="time $t$ [s]", ylabel="height [mm]", xlim=(0, solution.t[-1]))
    snap = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0))[-1]
    for row in range(snap - 8, snap + 9, 2):
        shape = 1e3 * solution.shape("strip")[row]
        colour = colour_of(temperatures[row].max() / temperatures.max())
        shapes.plot(*shape.T, color=colour)
    shapes.set(xlabel="$x$ [mm]", ylabel="$y$ [mm], magnified", title="while it snaps away")
    plot.save(figure, results / "fields.png")

    shown = {"temperature $T$ [K]": problem.at_points(heat.T, [0.25, 0.75])}
    plot.shapes(solution, results / "mesh.png", rows=[-1], colour=shown, magnify=20.0)


def colour_of(part):
    """A colour for a number from 0 to 1."""
    return 0.9 * part, 0.2, 0.9 * (1 - part)


if __name__ == "__main__":
    script.run()
