"""Factors of sparse matrices: in C, by SciPy and by PETSc."""

import numpy as np
import pytest
import scipy.sparse

from fx_beam.algebra.petsc_lu import PetscLU
from fx_beam.algebra.sparse_lu import CompiledLU, ScipyLU, sparse_lu
from fx_beam.stepping.bordered import BorderedLU

KINDS = {"compiled": sparse_lu, "scipy": ScipyLU, "petsc": PetscLU}


def grid(n, inside):
    """A matrix for a square grid of n x n nodes that is coupled like a membrane."""
    line = scipy.sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (n, n))
    each = scipy.sparse.identity(n)
    A = scipy.sparse.kron(line, each) + scipy.sparse.kron(each, line)
    return (A + scipy.sparse.diags(np.full(n * n, inside))).tocsr()


def nodes_of_three(seed=0, nodes=40):
    """A matrix of three unknowns a node that is not symmetric, and needs no exchange of rows."""
    random = np.random.default_rng(seed)
    pattern = scipy.sparse.random(nodes, nodes, 0.05, random_state=0) + scipy.sparse.identity(nodes)
    A = scipy.sparse.kron(pattern + pattern.T, np.ones((3, 3))).tocsr()
    A.data = random.standard_normal(A.nnz)
    return (A + scipy.sparse.diags(np.full(3 * nodes, 40.0))).tocsr()


@pytest.mark.parametrize("kind", KINDS)
def test_the_solution_satisfies_the_equations_also_with_other_values(kind):
    lu, b = None, np.arange(120.0)
    for seed in (1, 2):
        A = nodes_of_three(seed)
        lu = lu or KINDS[kind]((A.indptr, A.indices))
        assert lu.factorise(A.data)
        assert A @ lu.solve(b) == pytest.approx(b, abs=1e-11)


@pytest.mark.parametrize("kind", ["compiled", "scipy"])
@pytest.mark.parametrize("shift", [0.0, 0.3, 4.1, 8.0])
def test_negative_pivots_are_negative_eigenvalues(kind, shift):
    A = grid(9, -shift)
    lu = KINDS[kind]((A.indptr, A.indices))
    assert lu.factorise(A.data)
    assert lu.negative_pivots() == (np.linalg.eigvalsh(A.toarray()) < 0).sum()


@pytest.mark.parametrize("kind", ["compiled", "scipy"])
def test_a_singular_matrix_is_told(kind):
    A = scipy.sparse.csr_matrix(np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert not KINDS[kind]((A.indptr, A.indices)).factorise(A.data)


def test_a_large_grid_has_all_its_fill_in():
    # A solution that lacks some of it is wrong where the matrix hardly has a diagonal of its own.
    A, b = grid(120, 1e-4), np.ones(120**2)
    lu = sparse_lu((A.indptr, A.indices))
    assert isinstance(lu, CompiledLU) and lu.factorise(A.data)
    assert A @ lu.solve(b) == pytest.approx(b, abs=1e-9)


# From none to three negative eigenvalues; a simple and nearly simple zero.
@pytest.mark.parametrize("below", [0.0, 1e-9, 0.5, 1.5, 2.5, 3.0, 3.0 + 1e-11])
def test_a_bordered_matrix_is_solved_and_has_the_sign_of_its_determinant_also_if_singular(below):
    random = np.random.default_rng(5)
    whole = grid(5, 0.0) + scipy.sparse.diags(0.1 * random.random(25))
    squares, vectors = np.linalg.eigh(whole.toarray())
    level = np.interp(below, np.arange(25), squares)
    A = (whole - scipy.sparse.diags(np.full(25, level))).tocsr()
    row = vectors[:, round(below)] + 0.1 * random.standard_normal(25)
    column, corner, b = random.standard_normal(25), 0.3, random.standard_normal(26)
    whole = np.block([[A.toarray(), column[:, None]], [row[None, :], np.array([[corner]])]])
    lu = BorderedLU((A.indptr, A.indices), np.ones(25))
    lu.factorise(A.data, column, row, corner)
    assert lu.sign == np.sign(np.linalg.det(whole))
    x, load = lu.solve(b)
    assert whole @ np.append(x, load) == pytest.approx(b, abs=1e-9)
