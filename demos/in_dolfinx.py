r"""The pinned beam in dolfinx: mesh, form, coupling and Newton's method, step by step.

A scene is a variational problem as well. `fx_beam.fenicsx.Problem` has its mesh, its function space
and its form as objects of dolfinx, and PETSc takes its steps. Objective: to write the paper's
scheme by hand in dolfinx, to take a step with it, and to change its form. Whoever wants another
form can begin here.

Reference: A. Ibrahimbegovic, S. Mamouri, Computers & Structures 70 (1999) 1-22, section 4.4, doi
10.1016/S0045-7949(98)00150-3. The beam and its data are those of the demo "Pinned beam": it turns
freely about a pin at its end, so that energy and angular momentum are constant.

Unknowns are the displacement $u$ and the rotation $\psi$ of sections, with the reference tangent
$t_0$ and a prime for the derivative by $s$ along the beam. The position is $\varphi = X + u$,
$R(\psi)$ a rotation, $W$ a rotation by 90 degrees. Strains (eqs 9 and 12) and virtual work of the
forces $n$ and the couple $m$ (eqs 15 to 17):

$$
\begin{aligned}
E &= R(\psi)^T \varphi' - t_0, \qquad K = \psi', \\
G &= \int ((\delta u' - \delta\psi\,W \varphi') \cdot n + \delta\psi'\,m)\,\mathrm{d}s.
\end{aligned}
$$

A step goes from $u_0$, $\psi_0$ to $u_0 + \Delta u$, $\psi_0 + \Delta\psi$. The scheme has mean
strains, a mean of two rotations, and the mean $\varphi'$ (eqs 39 to 41 and 47):

$$
n = \frac{R_0 + R_1}{2}\,C\,\frac{E_0 + E_1}{2}, \qquad
m = \frac{EI\,(K_0 + K_1)/2}{1 + \tan^2(\Delta\psi/2)}.
$$

Rates are those of nodes (eqs 27 to 30). So inertia is no integral of UFL, but the mass matrix $M$
times nodal accelerations:

$$
\begin{aligned}
v_1 + v_0 &= \frac{2}{\Delta t} \Delta u, &
\omega_1 + \omega_0 &= \frac{4}{\Delta t} \tan\frac{\Delta\psi}{2}, \\
a &= \frac{v_1 - v_0}{\Delta t}, & \alpha &= \frac{\omega_1 - \omega_0}{\Delta t}.
\end{aligned}
$$

A support or a joint makes all degrees of freedom $D$ functions of fewer unknowns $y$, as a
multi-point constraint does. With $T = \mathrm{d}D/\mathrm{d}y$ and the virtual motion $T_v$,
Newton's method solves

$$
T_v^T (M a + G) = 0, \qquad
T_v^T \left(M \frac{\mathrm{d}a}{\mathrm{d}D} + \frac{\mathrm{d}G}{\mathrm{d}D}\right)
T\,\mathrm{d}y = -T_v^T (M a + G).
$$

Here $T$ and $T_v$ are equal, and drop the two displacements of the pinned node. With joints they
differ.

Without the divisor in $m$ the work of the couple on the step is no longer $EI$ times the increment
of $K^2/2$, and the energy drifts. The default scheme of the package has a factor that makes it
exact.

Units are the paper's: inch, pound and second.
"""

import logging
import time

import numpy as np
import scipy.sparse.linalg

import fx_beam as fb
from shared import script

try:
    from fx_beam import fenicsx
except ImportError as error:
    raise SystemExit(str(error)) from None

import ufl
from dolfinx import fem, io

log = logging.getLogger("fx_beam.demo")

LENGTH = 100.0  # [in]
EA, GA, EI = 4e7, 1e7, 1.3e7  # [lb], [lb], [lb·in²]
RHO_A, RHO_I = 0.05, 1 / 60  # [lb·s²/in²], [lb·s²]
VELOCITY = 600.0  # in the middle of the beam [in/s]
ELEMENTS = 8
DT, T_END = 0.01, 4.0  # [s]
T_FILE = 1.4  # end of the motion in the file for ParaView [s]


def scene():
    """The scene: geometry, section, support and the velocities at the start."""
    pinned, middle = fb.Scene(), LENGTH / 2
    section = fb.Section(EA, GA, EI, RHO_A, RHO_I)
    beam = pinned.add_beam([(0, 0), (LENGTH, 0)], section, elements=ELEMENTS, name="beam")
    pinned.pin(beam.start)
    pinned.set_velocity(
        beam,
        lambda x, y: (0.0, VELOCITY * (1 - abs(x / middle - 1))),
        spin=lambda x, y: VELOCITY / middle * np.sign(middle - x),
    )
    return pinned, beam


# -- 1. The form by hand ---------------------------------------------------------------------------


def turned(psi, a):
    r"""$R(\psi)\,a$."""
    return ufl.cos(psi) * a + ufl.sin(psi) * ufl.perp(a)


def weak_form(q0, D):
    """The form $G$, for the start $q_0$ and the increments $D$, two Functions on the mixed space.

    The rule has one point, against locking. `ufl.perp` is $W$, and $t_0$ of the beam (1, 0).
    """
    (u0, psi0), (Du, Dpsi) = ufl.split(q0), ufl.split(D)
    du, dpsi = ufl.TestFunctions(D.function_space)
    t0 = ufl.as_vector((1.0, 0.0))

    def prime(f):
        return ufl.dot(ufl.grad(f), t0)

    def strains(u, psi):
        E = turned(-psi, t0 + prime(u)) - t0
        return E[0], E[1], prime(psi)

    start, end = strains(u0, psi0), strains(u0 + Du, psi0 + Dpsi)
    eps, gamma, kappa = ((a + b) / 2 for a, b in zip(start, end, strict=True))

    t = (turned(psi0, t0) + turned(psi0 + Dpsi, t0)) / 2  # a mean, a little shorter than 1
    n = EA * eps * t + GA * gamma * ufl.perp(t)
    m = EI * kappa / (1 + ufl.tan(Dpsi / 2) ** 2)
    dphi = t0 + prime(u0 + Du / 2)  # the mean phi'
    virtual_work = ufl.dot(prime(du) - dpsi * ufl.perp(dphi), n) + prime(dpsi) * m
    return virtual_work * ufl.dx(metadata={"quadrature_degree": 1})


def mass_form(space):
    """The mass matrix, integrated exactly."""
    (u, psi), (du, dpsi) = ufl.TrialFunctions(space), ufl.TestFunctions(space)
    return (RHO_A * ufl.dot(u, du) + RHO_I * psi * dpsi) * ufl.dx(metadata={"quadrature_degree": 2})


# -- 2. A step by hand -----------------------------------------------------------------------------


def matrix(form):
    """A form of rank two, assembled by dolfinx."""
    A = fem.petsc.assemble_matrix(fem.form(form))
    A.assemble()
    indptr, indices, values = A.getValuesCSR()
    return scipy.sparse.csr_matrix((values, indices, indptr), A.getSize())


def step_by_hand(q0, v0, T, Tv, dt=DT):
    """The increments $D$ of a step, and the largest correction of each iteration.

    $T$ and $T_v$ have a row for each degree of freedom of the space.
    """
    space = q0.function_space
    D = fem.Function(space)
    G = weak_form(q0, D)
    tangent = ufl.derivative(G, D)
    M = matrix(mass_form(space))
    _, turns = space.sub(1).collapse()  # degrees of freedom that are rotations
    y, corrections = np.zeros(T.shape[1]), []
    for _ in range(20):
        D.x.array[:] = T @ y
        path, slope = D.x.array.copy(), np.ones(len(D.x.array))
        path[turns] = 2 * np.tan(D.x.array[turns] / 2)
        slope[turns] = 1 + np.tan(D.x.array[turns] / 2) ** 2
        a = (2 * path / dt - 2 * v0.x.array) / dt
        r = M @ a + fem.petsc.assemble_vector(fem.form(G)).array
        K = matrix(tangent) + M @ scipy.sparse.diags(2 / dt**2 * slope)
        dy = scipy.sparse.linalg.spsolve((Tv.T @ K @ T).tocsc(), -Tv.T @ r)
        y += dy
        corrections.append(abs(dy).max())
        if corrections[-1] < 1e-10:
            break
    return D, corrections


def first_step():
    """The first step by hand and by `Problem`: what there is of either."""
    problem = fenicsx.Problem(scene()[0], fb.ModifiedMidPoint(), dt=DT)
    q0, v0 = problem.q.copy(), problem.v.copy()
    problem.advance()
    system = problem.system
    T, Tv = system.T[system.dofs], system.Tv[system.dofs]  # they have the order of the scene
    D, corrections = step_by_hand(q0, v0, T, Tv)
    reached = q0.x.array + D.x.array
    return problem, {
        "cells": int(problem.mesh.topology.index_map(1).size_global),
        "degrees of freedom": T.shape[0],
        "unknowns": T.shape[1],
        "corrections by hand": [float(size) for size in corrections],
        "iterations of PETSc": problem.snes.getIterationNumber(),
        "by hand less PETSc / largest displacement": float(
            abs(reached - problem.q.x.array).max() / abs(problem.u.x.array).max()
        ),
    }


# -- 3. The form changed ---------------------------------------------------------------------------


def published(step, law):
    """Resultants $n$ and $m$ in the fields of a step, as `Problem.replace_resultants` takes them.

    `step.strains0` and `step.director0` are $E_0$, $K_0$, $R_0 t_0$; `law` has the stiffness.
    """
    ends = zip(step.strains0, step.strains1, strict=True)
    N, Q, M = law.resultants(*((a + b) / 2 for a, b in ends))
    t = (step.director0 + step.director1) / 2
    dphi = step.t0 + step.prime(step.u0 + step.Du / 2)
    return fb.Resultants(dphi, t, N, Q, M, m=M / (1 + ufl.tan(step.Dpsi / 2) ** 2))


def without_divisor(step, law):
    """A change of one factor: $m$ is the mean moment."""
    r = published(step, law)
    return r._replace(m=r.M)


def stored(eps, gamma, kappa):
    """Energy per length [lb], of which `Problem` gives the integral where resultants are ours."""
    return (EA * eps**2 + GA * gamma**2 + EI * kappa**2) / 2


FORMS = {
    "as published": published,
    "m without divisor": without_divisor,
    "EnergyMomentum": None,
}


def run(form, t_end=T_END):
    """A motion by dolfinx and PETSc, and its time for a step [ms of the processor]."""
    scheme = fb.EnergyMomentum() if form is None else fb.ModifiedMidPoint()
    problem = fenicsx.Problem(scene()[0], scheme, dt=DT)
    if form is not None:
        problem.replace_resultants(form, stored)
    ends: list[float] = []  # of steps; the first one compiles the forms
    solution = problem.run(t_end, after=lambda _: ends.append(time.process_time()))
    return solution, 1e3 * np.diff(ends).mean()


def engine(form):
    """Motion by the compiled steps of `fb.simulate`."""
    scheme = fb.EnergyMomentum()
    if form is not None:
        scheme = fb.Scheme("own", form, fb.MidPointRates())
    fb.simulate(scene()[0], scheme, dt=DT, t_end=DT)
    start = time.process_time()
    solution = fb.simulate(scene()[0], scheme, dt=DT, t_end=T_END)
    return solution, 1e3 * (time.process_time() - start) / (len(solution.t) - 1)


# -- 4. Files --------------------------------------------------------------------------------------


def write_xdmf(path):
    """The motion in a file for ParaView, written as in any program of dolfinx."""
    problem = fenicsx.Problem(scene()[0], dt=DT)
    with io.XDMFFile(problem.mesh.comm, str(path), "w") as file:
        file.write_mesh(problem.mesh)
        file.write_function(problem.u, problem.t)
        problem.run(T_FILE, after=lambda now: file.write_function(now.u, now.t))


# -- All of it -------------------------------------------------------------------------------------


def drift(values):
    """The largest change of an invariant, relative to its start."""
    return float(abs(values / values[0] - 1).max())


def compute():
    """The numbers, and what is drawn."""
    log.info("a step by hand")
    problem, numbers = first_step()
    runs, pairs = {}, {}
    for name, form in FORMS.items():
        log.info("%s", name)
        (runs[name], slow), (same, fast) = run(form), engine(form)
        pairs[name] = runs[name], same
        numbers[name] = {
            "energy drift": drift(runs[name].energy.total),
            "angular momentum drift": drift(runs[name].angular_momentum),
            "largest difference from the engine / length": float(
                abs(runs[name].q - same.q)[..., :2].max() / LENGTH
            ),
            "relative difference of energies": float(
                abs(runs[name].energy.total - same.energy.total).max() / same.energy.total[0]
            ),
            "ms a step, dolfinx": slow,
            "ms a step, engine": fast,
        }
    return numbers, (problem, pairs)


def report(numbers):
    print(
        f"{numbers['cells']} cells, {numbers['degrees of freedom']} degrees of freedom, "
        f"{numbers['unknowns']} unknowns\n"
        f"First step: {numbers['iterations of PETSc']} iterations by PETSc; by hand the largest "
        "corrections are\n    " + "  ".join(f"{c:.0e}" for c in numbers["corrections by hand"])
    )
    apart = numbers["by hand less PETSc / largest displacement"]
    print(f"    and the end differs by {apart:.0e}\n")
    row = "{:20}{:>10}{:>10}{:>12}{:>12}{:>10}{:>10}".format
    print(row(f"{T_END:g} s, dt = {DT:g} s", "energy", "momentum", "less engine", "", "", "engine"))
    print(row("", "drift", "drift", "position", "energy", "ms/step", "ms/step"))
    for name in FORMS:
        run = numbers[name]
        values = [
            f"{run[key]:.0e}"
            for key in (
                "energy drift",
                "angular momentum drift",
                "largest difference from the engine / length",
                "relative difference of energies",
            )
        ]
        times = f"{run['ms a step, dolfinx']:.1f}", f"{run['ms a step, engine']:.3f}"
        print(row(name, *values, *times))


def draw(results, problem, pairs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    write_xdmf(results / "motion.xdmf")
    ours, _ = pairs["EnergyMomentum"]
    until = range(round(T_FILE / DT) + 1)
    plot.shapes(ours, results / "shapes.png", rows=until[::4], scene_unit="in")
    plot.animate(ours, results / "motion.gif", rows=until, scene_unit="in")
    thumbnail.card(ours, until, results / "thumbnail.png")

    figure, axes = plot.figure(1, 3, height=3.0)
    tangent, coupling, energy = axes.flat
    K, T = problem.system.K, problem.system.T
    indptr, indices, _ = K.getValuesCSR()
    entries = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), K.getSize())
    for ax, pattern, title in (
        (tangent, entries, "tangent $K$"),
        (coupling, T, "coupling $T$"),
    ):
        ax.spy(pattern, markersize=3, color="#0072B2")
        ax.set(title=title, xticks=[], yticks=[], xlabel=f"{pattern.shape[0]} x {pattern.shape[1]}")
    for (name, (solution, _)), line in zip(pairs.items(), ("-", "--", ":"), strict=True):
        ratio = solution.energy.total / solution.energy.total[0]
        drifts = np.maximum.accumulate(abs(ratio - 1))[1:]
        energy.semilogy(solution.t[1:], np.maximum(drifts, 1e-17), line, label=name)
    energy.set(xlabel="time $t$ [s]", ylabel="largest $|E/E_0 - 1|$ so far", xlim=(0, T_END))
    plot.save(figure, results / "form_and_energy.png")


if __name__ == "__main__":
    script.run()
