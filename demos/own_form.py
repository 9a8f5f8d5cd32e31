r"""A form of one's own, followed past its limit points by an arc length of one's own.

Two bars of rubber meet at an apex that is pressed down, until they snap through. Objective: to give
dolfinx the weak form of the beams as a whole, with its energy, and to find equilibria by a method
that is not in the package, here Crisfield's (1981, doi 10.1016/0045-7949(81)90108-5).

1. Form. The stored energy of a bar of length $L$ with the axial strain $\varepsilon$, the shear
   strain $\gamma$ and the curvature $\kappa$ is that of rubber in its stretch
   $\lambda = 1 + \varepsilon$,

   $$
   \Pi = \int_0^L \frac{EA}{6} \left(\lambda^2 + \frac{2}{\lambda} - 3\right)
   + \frac{GA}{2} \gamma^2 + \frac{EI}{2} \kappa^2 \, ds ,
   $$

   and its derivative by displacements and rotations is the virtual work.
2. Method. With the residual $r(y, l)$ of the unknowns $y$ of a step and the load factor $l$, each
   step ends where $|y|$ is a given radius. A correction is

   $$
   \Delta y = -K^{-1} r - \Delta l \, K^{-1} \frac{\partial r}{\partial l}, \qquad
   2 y \cdot \Delta y = \rho^2 - y \cdot y .
   $$

Check: bars that meet at the height $h$ over the half span $a$ have at the apex's way $w$ the length
$l = \sqrt{a^2 + (h - w)^2}$, and carry the force

$$
F(w) = 2 \, \frac{EA}{3} \left(\lambda - \frac{1}{\lambda^2}\right) \frac{w - h}{l}, \qquad
\lambda = \frac{l}{L} .
$$

Units are metre, newton and their combinations.
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

log = logging.getLogger("fx_beam.demo")

HALF_SPAN, HEIGHT = 1.0, 0.4  # a, h [m]
EA, GA, EI = 1e4, 1e4, 1e3  # [N, N, N m²]
FORCE = 500.0  # at load factor 1 [N]
ELEMENTS = 4
RADIUS, STEPS, CORRECTIONS = 0.15, 40, 8  # of steps along the path; of y [m, rad]


def energy(eps, gamma, kappa):
    """Stored energy per length [J/m]."""
    stretch = 1 + eps
    rubber = EA / 6 * (stretch**2 + 2 / stretch - 3)
    return rubber + GA / 2 * gamma**2 + EI / 2 * kappa**2


def bars(section):
    """Both bars with a hinge at the apex, and the apex."""
    scene = fb.Scene()
    left, right = (
        scene.add_beam([(side * HALF_SPAN, 0), (0, HEIGHT)], section, elements=ELEMENTS)
        for side in (-1, 1)
    )
    scene.add_joint(fb.Revolute(left.end, right.end))
    for bar in (left, right):
        scene.pin(bar.start)
    scene.add_force(left.end, (0, -FORCE))
    return scene, left.end


def whole_form():
    """The static problem with the form and the energy of its own."""
    scene, apex = bars(fb.Section(EA=EA, GA=GA, EI=EI))
    equilibrium = fenicsx.Equilibrium(scene)
    Pi = energy(*equilibrium.step.total_strains1) * equilibrium.dx
    F = ufl.derivative(Pi, equilibrium.increment, equilibrium.test)
    equilibrium.replace_form(F, energy=Pi)
    return equilibrium, apex


def direct_solver():
    """A solver by factors."""
    ksp = PETSc.KSP().create()
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    return ksp


def arc_length_step(equilibrium, ksp, last):
    """A step of Crisfield's method; `last` has the unknowns of the step before."""
    load, y = equilibrium.load_factor, None
    for _ in range(CORRECTIONS):
        with equilibrium.begin(load) as step:
            start = y is None
            y = step.y.duplicate() if start else y
            r, back, along = (y.duplicate() for _ in range(3))
            step.residual(y, r)
            slope = equilibrium.load_derivative()
            ksp.setOperators(step.tangent(y))
            ksp.solve(r, back)
            ksp.solve(-slope, along)
        if start:  # on from the step before
            way = 1.0 if last is None or along.dot(last) > 0 else -1.0
            change = way * RADIUS / along.norm()
        else:
            change = ((RADIUS**2 - y.dot(y)) / 2 + y.dot(back)) / y.dot(along)
        y.axpy(-1, back)
        y.axpy(change, along)
        load += change
    with equilibrium.begin(load) as step:
        step.residual(y, r)
        left = r.norm() / FORCE
        step.accept(y)
    return y, left


def closed_form(w):
    """Force [N] and stored energy [J] at the apex's way."""
    first, now = np.hypot(HALF_SPAN, HEIGHT), np.hypot(HALF_SPAN, HEIGHT - w)
    stretch = now / first
    N = EA / 3 * (stretch - stretch**-2)
    return 2 * N * (w - HEIGHT) / now, 2 * first * EA / 6 * (stretch**2 + 2 / stretch - 3)


def compute():
    """The numbers, and what is drawn."""
    equilibrium, apex = whole_form()
    ksp, y, rows, shapes, left = direct_solver(), None, [(0.0, 0.0, 0.0)], [], []
    log.info("Crisfield's method")
    for _ in range(STEPS):
        y, residual = arc_length_step(equilibrium, ksp, y)
        q = np.zeros(equilibrium.system.T.shape[0])
        q[equilibrium.system.dofs] = equilibrium.q.x.array
        stored = equilibrium.energies()["strain"]
        rows.append((-q.reshape(-1, 3)[apex.number, 1], FORCE * equilibrium.load_factor, stored))
        shapes.append(equilibrium.u.x.array.copy())
        left.append(residual)
        if rows[-1][1] > FORCE:
            break
    w, F, stored = np.array(rows).T
    force, work = closed_form(w)
    log.info("the path by the engine")
    scene, apex = bars(fb.Section(strain_energy=energy))
    engine = fb.static(scene, continuation="arc-length")
    way = -engine.displacement(apex)[:, 1]
    fine = np.linspace(0.0, HEIGHT, 100_001)
    numbers = {
        "steps": len(F) - 1,
        "past both limit points": bool(F.min() < 0 and w[-1] > 2 * HEIGHT),
        "largest force, closed form [N]": closed_form(fine)[0].max(),
        "limit point by fb.static [N]": FORCE * engine.critical_points[0].load_factor,
        "force less closed form, relative": abs(F - force).max() / force.max(),
        "engine less closed form, relative": abs(FORCE * engine.t - closed_form(way)[0]).max()
        / force.max(),
        "energy less closed form, relative": abs(stored - work).max() / work.max(),
        "largest residual, relative": max(left),
    }
    return numbers, (equilibrium, engine, way, (w, F), shapes)


def report(numbers):
    print(
        f"{numbers['steps']} steps of Crisfield's method lead past both limit points: "
        f"{'yes' if numbers['past both limit points'] else 'no'}\n"
        f"Forces: closed form to {numbers['force less closed form, relative']:.0e}, energies to "
        f"{numbers['energy less closed form, relative']:.0e}; the engine's forces to "
        f"{numbers['engine less closed form, relative']:.0e}\n"
        f"Limit point: {numbers['limit point by fb.static [N]']:.3f} N by fb.static, "
        f"{numbers['largest force, closed form [N]']:.3f} N by the closed form"
    )


def draw(results, equilibrium, engine, way, path, shapes):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    import dolfinx.plot

    import pyvista

    from fx_beam import plot
    from shared import thumbnail

    plot.animate(engine, results / "motion.gif")
    thumbnail.card(engine, range(len(engine.t)), results / "thumbnail.png")
    figure, axes = plot.figure(1, 1, height=3.0)
    (panel,) = axes.flat
    fine = np.linspace(0.0, max(way.max(), path[0].max()), 400)
    panel.plot(fine, closed_form(fine)[0], color="0.8", linewidth=4, label="closed form")
    panel.plot(way, FORCE * engine.t, "x", label="fb.static")
    panel.plot(*path, ".", label="form and arc length of one's own")
    panel.set(xlabel="way of the apex $w$ [m]", ylabel="force $F$ [N]")
    plot.save(figure, results / "path.png")

    # Shapes on the way by dolfinx's own way to VTK: its mesh, moved by u.
    cells = getattr(dolfinx.plot, "vtk_mesh", None) or dolfinx.plot.create_vtk_mesh
    grid = pyvista.UnstructuredGrid(*cells(equilibrium.u.function_space))
    plotter = pyvista.Plotter(off_screen=True, window_size=(1280, 640))
    look = {"line_width": 5, "show_scalar_bar": False}
    for number, u in enumerate(shapes[::2]):
        part = 2 * number / len(shapes)
        shift = u.reshape(-1, 2)
        grid["u"] = np.column_stack([shift, np.zeros(len(shift))])
        plotter.add_mesh(
            grid.warp_by_vector("u"), color=(0.9 * part, 0.2, 0.9 - 0.9 * part), **look
        )
    plotter.view_xy()
    plotter.camera.zoom(1.8)
    plotter.screenshot(str(results / "shapes.png"))
    plotter.close()


if __name__ == "__main__":
    script.run()
