"""The equations of all degrees of freedom of a scene, and what supports and joints leave."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import scipy.sparse

from .assembly import csr_of
from .equations import ReducedEquations


class System:
    """The system of all degrees of freedom of a scene, and the maps of supports and joints.

    They are displacement (2) and rotation of each node, in the order of nodes. Supports and joints
    make them functions of unknowns y: Newton's method solves ``Tv.T r = 0``.

    Parameters
    ----------
    equations : Equations
        Those of a problem, which makes its `system` itself.
    """

    def __init__(self, equations: ReducedEquations):
        self._equations, self._assembly = equations, equations.assembly

    @property
    def dofs(self) -> np.ndarray:
        """Number here of each degree of freedom of `V`: its row of `T`, `Tv`, `K`, `M`."""
        return self._assembly.fields.V_numbers

    @property
    def residual(self) -> np.ndarray:
        """All forces r (size,) of the last iteration, with inertia [N, N m].

        At the end of a step Tv^T r is zero: what is left are forces of supports and joints.
        """
        return self._equations.forces

    @property
    def K(self) -> PETSc.Mat:
        """Derivative of `F` in the last iteration, as a copy."""
        K = self._assembly.model.forms.stiffness
        matrix = scipy.sparse.csr_matrix((self._assembly.tangent(), K.indices, K.indptr), K.shape)
        return self._distributed(matrix)

    @property
    def M(self) -> PETSc.Mat:
        """Mass matrix of beams and lumped masses, as a copy [kg, kg m^2]."""
        return self._distributed(self._equations.model.masses.matrix)

    @property
    def T(self) -> scipy.sparse.csr_matrix:
        """dq = T dy (size, n): small motions of all degrees of freedom by the unknowns."""
        return self._equations.unknowns.T

    @property
    def Tv(self) -> scipy.sparse.csr_matrix:
        """Virtual motions (size, n) by virtual unknowns: forces on the unknowns are Tv^T r."""
        return self._equations.unknowns.Tv

    def _distributed(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix whose rows the processes share."""
        shared = PETSc.Mat().create(self._assembly.grid.comm)
        shared.setSizes(matrix.shape)
        shared.setType("aij")
        shared.setUp()
        shared.setPreallocationCSR(csr_of(matrix[slice(*shared.getOwnershipRange())]))
        shared.assemble()
        return shared
