"""Vectors and matrices of a form in the numbers of a scene, as dolfinx assembles them."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem

import numpy as np
import scipy.sparse

from fx_beam.step.model import Model

from .form import StepForm


class Assembly:
    """Forces (size,) and their tangent (size, size) of all degrees of freedom."""

    def __init__(self, form: StepForm, model: Model):
        self.form, self.fields, self.grid, self.model = form, form.fields, form.grid, model
        pattern = model.forms.stiffness.astype(float)
        self._local = PETSc.Mat().createAIJ(pattern.shape, csr=csr_of(pattern), comm=MPI.COMM_SELF)
        numbers = PETSc.LGMap().create(self.fields.increment_numbers, comm=MPI.COMM_SELF)
        self._local.setLGMap(numbers, numbers)

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

    def tangent(self) -> np.ndarray:
        """Entries of the tangent (size, size), in the sparsity of all forces."""
        forms = (term.compiled[1] for term in (*self.form.terms, *self.form.added))
        self._local.zeroEntries()
        for form in forms:
            if form is not None:
                fem.petsc.assemble_matrix(self._local, form)
        self._local.assemble()
        return self.grid.total(self._local.getValuesCSR()[2])

    def resultants(self) -> np.ndarray:
        """N, Q and M (cells, points, 3) at the Gauss points."""
        return self.grid.at_points(self.fields.resultants)


def csr_of(matrix: scipy.sparse.csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of a matrix, as PETSc takes them."""
    matrix.sort_indices()
    indptr, indices = (np.asarray(row, PETSc.IntType) for row in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data
