"""Small motions about a state, by SLEPc: K x = omega^2 M x with the reduced tangent and mass."""

from __future__ import annotations

import importlib.util
from typing import NamedTuple

from petsc4py import PETSc

from dolfinx import fem

import numpy as np

from fx_beam.errors import SceneError

from .reduced_equations import ReducedEquations


class FieldModes(NamedTuple):
    """Undamped small motions, from the lowest frequency on."""

    #: Frequencies (n,) [Hz].
    frequencies: np.ndarray
    #: Displacement and rotation of each, in `V`, of modal mass 1.
    functions: list[fem.Function]


def modes_of(equations: ReducedEquations, K: PETSc.Mat, n: int) -> FieldModes:
    """The lowest modes; SceneError if there is one that grows."""
    pairs, fields, mass = eigenpairs(equations, K, n), equations.assembly.fields, equations.mass
    squares = np.array([square.real for square, _ in pairs])
    if (squares < -1e-9 * abs(squares).max(initial=0.0)).any():
        raise SceneError(
            f"fenicsx: modes: a motion grows, as omega^2 = {squares.min():.4g} 1/s^2: the state is "
            "no stable equilibrium. See Equilibrium.eigenvalues and unstable_modes"
        )
    functions = []
    for number, (_, x) in enumerate(pairs, start=1):
        motion = equations.unknowns.T @ x
        function = fem.Function(fields.V, name=f"mode_{number}")
        function.x.array[:] = (motion / np.sqrt(motion @ mass @ motion))[fields.V_numbers]
        functions.append(function)
    return FieldModes(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi), functions)


def eigenpairs(
    equations: ReducedEquations, K: PETSc.Mat, n: int
) -> list[tuple[complex, np.ndarray]]:
    """Squares of circular frequencies next to zero [1/s^2], rising, and unknowns (n,) of each."""
    if importlib.util.find_spec("slepc4py") is None:
        raise SceneError("fenicsx: eigenvalues need SLEPc: install Debian's python3-slepc4py")
    from slepc4py import SLEPc

    unknowns = equations.unknowns
    M = (unknowns.Tv.T @ equations.mass @ unknowns.T).tocsr()
    if not abs(M).sum():
        raise SceneError("fenicsx: eigenvalues: the scene has no mass. Give rhoA, or add_mass")
    solver = SLEPc.EPS().create(K.comm)
    solver.setOperators(K, unknowns.matrix(M))
    solver.setDimensions(n)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.setTarget(0.0)
    transform = solver.getST()
    transform.setType("sinvert")
    pc = transform.getKSP().getPC()
    pc.setType("lu")
    if K.comm.size > 1:
        pc.setFactorSolverType("mumps")
    solver.solve()
    x, pairs = K.createVecRight(), []
    for i in range(min(n, solver.getConverged())):
        pairs.append((solver.getEigenpair(i, x), unknowns.all(x).copy()))
    return sorted(pairs, key=lambda pair: (pair[0].real, pair[0].imag))
