"""A beam as a problem of dolfinx: its equations, spaces, form, joints and Newton's method.

The paper's pinned beam, written as a demo of dolfinx is: to be read by somebody who wants to change
the form. Objective: the first 1.4 s of its motion by dolfinx and PETSc, what each part of the
problem is, the two invariants, and the difference from the engine.

1. Equations. With position phi = X + u, rotation psi of the section, and the strains
   E = R(psi)^T phi' - t0 and K = psi', the weak form of the step from level 0 to level 1 is

       M a . dq + int (du' - dpsi W phi'_m) . n + dpsi' m ds = 0   for all du, dpsi,

   with n = R_av C (E0 + E1)/2 and the couple m whose work is that of EI (K0 + K1)/2. Index m is the
   middle of the step, av the mean of both rotation matrices.
2. Space. Displacement (2) and rotation, linear on intervals: `problem.V`.
3. Form. F has the integrals; a = 2/dt (D/dt - v0) is nodal, with D = 2 tan(Dpsi/2) for rotations,
   so that inertia is a matrix times a, and no integral.
4. Joints. The pin is a map: x = g(y) of all degrees of freedom x by the unknowns y, with T = dg/dy.
   Newton's method solves Tv^T r(g(y)) = 0.
5. Invariants. There are no loads: energy and angular momentum about the pin are constant.

Reference: A. Ibrahimbegovic, S. Mamouri, Computers & Structures 70 (1999) 1-22, section 4.4, doi
10.1016/S0045-7949(98)00150-3. Units are inch, pound and second.
"""

import logging
from time import perf_counter

from mpi4py import MPI

import ufl
from dolfinx import fem, io

import numpy as np

import fx_beam as fb
from fx_beam import fenicsx
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, ELEMENTS = 100.0, 8  # [in]
SECTION = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)  # [lb, lb in^2, lb s^2]
VELOCITY = 600.0  # in the middle of the beam [in/s]
DT, T_END = 0.01, 1.4  # [s]


def scene():
    """The scene of the pinned beam, and the beam."""
    pinned = fb.Scene()
    beam = pinned.add_beam([(0, 0), (LENGTH, 0)], SECTION, elements=ELEMENTS, name="beam")
    pinned.pin(beam.start)
    middle = LENGTH / 2
    pinned.set_velocity(
        beam,
        lambda x, y: (0.0, VELOCITY * (1 - abs(x / middle - 1))),
        spin=lambda x, y: VELOCITY / middle * np.sign(middle - x),
    )
    return pinned, beam


# -- The problem, part by part ---------------------------------------------------------------------


def written_out(problem):
    """The residual by hand: the paper's modified mid-point scheme (eqs 39 to 47)."""
    step, C = problem.step, ufl.as_vector((SECTION.EA, SECTION.GA, SECTION.EI))
    before, after = step.strains0, step.strains1
    N, Q, M = (C[i] * (before[i] + after[i]) / 2 for i in range(3))
    t = (step.director0 + step.director1) / 2  # the mean of both, not a unit vector
    n = N * t + Q * ufl.as_vector((-t[1], t[0]))
    dphi = step.t0 + step.prime(step.u0 + step.Du / 2)
    couple = M * ufl.cos(step.Dpsi / 2) ** 2
    turned = ufl.as_vector((-dphi[1], dphi[0]))
    work = ufl.dot(step.prime(step.virtual_u) - step.virtual_psi * turned, n)
    return (work + step.prime(step.virtual_psi) * couple) * problem.measure()


def parts(problem):
    """What a problem of dolfinx consists of."""
    return {
        "cells": problem.mesh.topology.index_map(1).size_global,
        "degrees of freedom": problem.V.dofmap.index_map.size_global,
        "unknowns": problem.T.shape[1],
        "entries of K": problem.K.getInfo()["nz_used"],
        "mass [lb s^2/in]": problem.M.getDiagonal().array[::3].sum()
        + 2 * sum(problem.M.getValue(3 * i, 3 * i + 3) for i in range(ELEMENTS)),
    }


def march(results=None):
    """The motion by dolfinx, one step after the other, and the displacement in a file."""
    problem = fenicsx.Problem(scene()[0], fb.EnergyMomentum(), dt=DT)
    problem.advance()  # compiles
    problem = fenicsx.Problem(scene()[0], fb.EnergyMomentum(), dt=DT)
    clock = perf_counter()
    solution = problem.run(T_END)
    seconds = (perf_counter() - clock) / solution.stats.steps
    if results is not None:
        problem = fenicsx.Problem(scene()[0], fb.EnergyMomentum(), dt=DT)
        with io.XDMFFile(MPI.COMM_SELF, str(results / "beam.xdmf"), "w") as file:
            file.write_mesh(problem.mesh)
            while problem.t < T_END - DT / 2:
                problem.advance()
                file.write_function(problem.u, problem.t)
    return problem, solution, seconds


def compute():
    """The numbers, and what is drawn."""
    log.info("by dolfinx and PETSc")
    problem, solution, seconds = march()
    log.info("by the engine")
    fb.simulate(scene()[0], dt=DT, t_end=2 * DT)
    clock = perf_counter()
    engine = fb.simulate(scene()[0], dt=DT, t_end=T_END)
    in_engine = (perf_counter() - clock) / engine.stats.steps

    published = fenicsx.Problem(scene()[0], fb.ModifiedMidPoint(), dt=DT)
    published.advance()
    forms = (published.F, written_out(published))
    by_form, by_hand = (fem.assemble_vector(fem.form(form)).array for form in forms)

    energy, momentum = solution.energy.total, solution.angular_momentum
    numbers = {
        "parts": parts(problem),
        "residual written out, difference": abs(by_form - by_hand).max() / abs(by_form).max(),
        "free forces at the end of a step": abs(problem.Tv.T @ problem.residual).max()
        / abs(problem.residual).max(),
        "energy drift": abs(energy / energy[0] - 1).max(),
        "angular momentum drift": abs(momentum / momentum[0] - 1).max(),
        "tip at 1.4 s": solution.position(solution.beams["beam"].end)[-1].tolist(),
        "difference from the engine": abs(solution.q - engine.q).max() / LENGTH,
        "iterations": {
            "dolfinx": solution.stats.newton_iterations,
            "engine": engine.stats.newton_iterations,
        },
        "milliseconds a step": {"dolfinx": 1e3 * seconds, "engine": 1e3 * in_engine},
    }
    return numbers, (solution, engine)


def report(numbers):
    has, times = numbers["parts"], numbers["milliseconds a step"]
    print(
        f"{has['cells']} cells, {has['degrees of freedom']} degrees of freedom, of which the pin "
        f"leaves {has['unknowns']}; mass {has['mass [lb s^2/in]']:.4g} lb s2/in\n"
        f"The paper's residual written out by hand: the same to "
        f"{numbers['residual written out, difference']:.0e}\n"
        f"At the end of a step forces on the unknowns are "
        f"{numbers['free forces at the end of a step']:.0e} of the largest force\n"
        f"Drift of energy {numbers['energy drift']:.0e}, of angular momentum "
        f"{numbers['angular momentum drift']:.0e}\n"
        f"Largest difference from the engine {numbers['difference from the engine']:.0e} of the "
        f"length after {round(T_END / DT)} steps\n"
        f"A step takes {times['dolfinx']:.2g} ms in dolfinx, {times['engine']:.2g} ms in the engine"
    )


def draw(results, solution, engine):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    march(results)
    rows = range(0, len(solution.t), 3)
    plot.shapes(solution, results / "shapes.png", rows=rows)
    thumbnail.animate(solution, range(len(solution.t)), results / "thumbnail.gif")
    figure, axes = plot.figure(2, 1, height=2.4)
    drift, apart = axes.flat
    energy, momentum = solution.energy.total, solution.angular_momentum
    round_off = np.finfo(float).eps
    for values, label in ((energy, "energy"), (momentum, "angular momentum")):
        drift.semilogy(solution.t, abs(values / values[0] - 1) + round_off, label=label)
    drift.set(xlabel="time $t$ [s]", ylabel="relative change", xlim=(0, T_END))
    gap = abs(solution.q - engine.q).max(axis=(1, 2)) / LENGTH
    apart.semilogy(solution.t, gap + round_off, "C2")
    apart.set(xlabel="time $t$ [s]", ylabel="dolfinx less engine", xlim=(0, T_END))
    plot.save(figure, results / "invariants.png")


if __name__ == "__main__":
    script.run()
