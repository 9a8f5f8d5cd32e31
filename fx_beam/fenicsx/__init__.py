"""A scene as a variational problem of FEniCSx: for experiments with its form, fields and solvers.

Only this loads dolfinx. `Problem` takes steps in time, `Equilibrium` load steps. In the order of
a demo of dolfinx: `meshes` has the mesh, `step_form` the Functions, the residual F and J,
`reduced_equations` their vectors and matrices, nodal rates, the maps T and Tv of joints, the
reduced residual and tangent, and the SNES that solves them.
"""

import importlib.util

if importlib.util.find_spec("dolfinx") is None or importlib.util.find_spec("petsc4py") is None:
    raise ModuleNotFoundError(
        "fx_beam.fenicsx needs dolfinx with PETSc: Debian's python3-dolfinx, with its "
        "/usr/bin/python3, or pip install 'fx-beam[dolfinx]'",
        name="dolfinx",
    )

from fx_beam.errors import answer_in_module

from .meshes import beams_of
from .problem import Equilibrium, Problem
from .reduced_equations import System
from .steps import TrialStep

__all__ = ["Equilibrium", "Problem", "System", "TrialStep", "beams_of"]
answer_in_module(globals())
