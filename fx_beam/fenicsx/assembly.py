"""Vectors and matrices of a form in the numbers of a scene, as dolfinx assembles them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

from mpi4py import MPI
from petsc4py import PETSc

import ufl
from dolfinx import fem

import numpy as np
import scipy.sparse

from fx_beam.fem.beam_data import section_data
from fx_beam.step.model import Model

from .form import StepForm
from .symbols import DolfinxSymbols
from .versions import CompiledForm, compiled


class Assembly:
    """Forces (size,), their tangent and the mass (size, size) of all degrees of freedom."""

    def __init__(self, form: StepForm, model: Model):
        self.form, self.fields, self.grid, self.model = form, form.fields, form.grid, model
        #: Sparsity (size, size) of the tangent of all forces.
        self.pattern = model.forms.stiffness.astype(float)
        self._local = PETSc.Mat().createAIJ(
            self.pattern.shape, csr=csr_of(self.pattern), comm=MPI.COMM_SELF
        )
        self._glue = _glue(self.fields.increment_numbers)
        #: Mass (eqs 19 to 21) of beams and lumped masses, with the sparsity of `pattern`.
        self.mass = self._assembled_mass()

    def residual(self, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces and drag (size,) at increments D (size,), and added terms."""
        numbers = self.fields.increment_numbers
        self.fields.symbols.increment.x.array[:] = D[numbers]
        forces = np.zeros((2, len(D)))
        for out, terms in zip(forces, (self.form.terms, self.form.added), strict=True):
            b = np.zeros(len(numbers))
            for form, _ in (term.compiled for term in terms):
                if form is not None:
                    fem.assemble_vector(b, form)
            out[:] = np.bincount(numbers, b, len(D))
        internal, added = self.grid.total(forces)
        return internal, added

    def tangent(self) -> scipy.sparse.csr_matrix:
        """Tangent (size, size), in the sparsity of `pattern`."""
        forms = (term.compiled[1] for term in (*self.form.terms, *self.form.added))
        return self._assembled(self._glue, [form for form in forms if form is not None])

    def _assembled(
        self, numbers: PETSc.LGMap, forms: Sequence[CompiledForm]
    ) -> scipy.sparse.csr_matrix:
        """Sum of bilinear forms over the elements of all processes, by `numbers` of rows."""
        self._local.zeroEntries()
        self._local.setLGMap(numbers, numbers)
        for form in forms:
            fem.petsc.assemble_matrix(self._local, form)
        self._local.assemble()
        matrix = copy(self.pattern)  # which shares its rows and columns
        matrix.data = self.grid.total(self._local.getValuesCSR()[2])
        return matrix

    def resultants(self) -> np.ndarray:
        """N, Q and M (cells, points, 3) at the Gauss points."""
        return self.grid.at_points(self.fields.resultants)

    def _assembled_mass(self) -> scipy.sparse.csr_matrix:
        model, V, points = self.model, self.fields.V, self.grid.degree + 1
        data = np.asarray(section_data(model.mesh, model.scene, ("rhoA", "rhoI"), points), float)
        density = DolfinxSymbols(self.grid, None).data(data.shape[1], (2,))
        self.grid.fill(density, data)
        u, psi = ufl.TrialFunctions(V)
        virtual_u, virtual_psi = ufl.TestFunctions(V)
        translation = density[0] * ufl.dot(u, virtual_u)
        rotation = density[1] * psi * virtual_psi
        form = (translation + rotation) * self.grid.measure(None, points)
        mass = self._assembled(_glue(self.fields.V_numbers), [compiled(form)])
        lumped = np.zeros(model.size)
        for node, m, inertia in model.scene.masses:
            lumped[model.mesh.dofs[node]] += float(m), float(m), float(inertia)
        mass.data[model.masses.places.diagonal] += lumped
        return mass


def _glue(numbers: np.ndarray) -> PETSc.LGMap:
    """A map from degrees of freedom to their numbers in a matrix; -1 for none."""
    return PETSc.LGMap().create(numbers, comm=MPI.COMM_SELF)


def csr_of(matrix: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of a matrix, as PETSc takes them."""
    matrix.sort_indices()
    indptr, indices = (np.asarray(row, PETSc.IntType) for row in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data
