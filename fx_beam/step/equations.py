"""The equations of a step and of accelerations, reduced to the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from fx_beam.dual import floats
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State

from .constrained_matrix import ConstrainedMatrix, without_border
from .model import Model, fact
from .sparse_lu import LU
from .tables import ProblemInC, problem_of
from .tangent_storage import ProblemKind

if TYPE_CHECKING:
    from .forcing import TurningFrame


# -- Accelerations of nodes that joints couple, by T^T M T a = f for the unknowns ---------------


# Up to so many rows matrices are arrays: an operation on sparse ones costs 0.1 ms.
_SMALL = 200
# From so many unknowns on a mass matrix is not factorised.
_LARGE = 5000
# Largest error of a solution, relative to the right side, that tells a singular matrix.
_SINGULAR = 1e-6
# Largest error of the scaled forces of accelerations, relative to them, and most iterations for it.
_EXACT, _MOST = 1e-14, 300
# Masses relative to the largest, in sizes of unit unknowns, that a lever of round-off gives.
_NO_MASS = 1e-26


def accelerations(model: Model, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations a (free,) under generalised forces f (free,), and the rest f - M a.

    As `acceleration_of`, in the configuration in which the reduction is.
    """
    reduction, n, a = model.reduction, model.reduction.free, None
    if reduction.couplings.is_selection:
        a = _of_equal(model, force)
    elif not reduction.couplings.sliding and len(reduction.auxiliaries):
        a = _with_auxiliaries(model, force)
    if a is None:
        T = reduction.maps.coupling_array() if model.size <= _SMALL else reduction.maps.coupling()
        M, unit = (T.T @ (model.masses.matrix @ T))[:n, :n], model.units.unknowns
        a = acceleration_of(M, force, unit)
    return a, force - _inertia(model, a)


def _inertia(model: Model, a: np.ndarray) -> np.ndarray:
    """Generalised forces (free,) of accelerations of the unknowns (free,)."""
    reduction = model.reduction
    node_forces = model.masses.matrix @ reduction.maps.to_nodes(reduction.in_columns(a))
    return reduction.maps.transpose_to_nodes(node_forces)[: reduction.free]


def _of_equal(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By the reduced mass, whose factors have the pattern of the tangent; None if it is singular.

    Or without factors where they would need more memory than all else.
    """
    free = model.reduction.free
    if free > _LARGE and (a := _iterated(model, force)) is not None:
        return a
    tangent = model.reduction.tangent
    (indptr, indices), direct = tangent.pattern, tangent.direct
    values = np.bincount(direct["to"], model.masses.matrix.data[direct["from"]], len(indices))
    diagonal = values[np.repeat(np.arange(free), np.diff(indptr)) == indices]
    has_mass = free and (diagonal > 0).all()
    factors = fact(model, _factors).empty()
    return factors.solve(force) if has_mass and factors.factorise(values) else None


def _with_auxiliaries(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By the system with auxiliary unknowns, without unknowns that move no mass and no loop."""
    n, still = model.reduction.free, ~model.reduction.maps.moves(model.masses.matrix.diagonal() > 0)
    matrix = model.reduction.maps.normal(model.masses.matrix)
    moving = np.append(~still, np.ones(matrix.shape[0] - n, dtype=bool))
    matrix = scipy.sparse.diags(1.0 * moving) @ matrix + scipy.sparse.diags(1.0 * ~moving)
    b = np.zeros(matrix.shape[0])
    b[:n] = np.where(still, 0.0, force)
    try:
        a = scipy.sparse.linalg.splu(matrix.tocsc()).solve(b)[:n]
    except RuntimeError:  # exactly singular
        return None
    error = _inertia(model, a) - b[:n]
    return a if abs(error).max(initial=0.0) <= _SINGULAR * abs(b).max(initial=0.0) else None


def have_mass(masses: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Flags (n,) of the unknowns that have mass, by their masses and sizes of unit unknowns."""
    sizes = masses * unit**2
    return sizes > _NO_MASS * sizes.max(initial=0.0)


def acceleration_of(mass, force: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Accelerations (n,) under generalised forces (n,); zero where masses are none but round-off.

    If several unknowns move one mass, they are the accelerations of least norm.
    """
    a, diagonal, solution = np.zeros(len(force)), mass.diagonal(), None
    moving = np.flatnonzero(have_mass(diagonal, unit))
    if not len(moving):
        return a
    scale = diagonal[moving] ** -0.5
    b = scale * force[moving]
    if isinstance(mass, np.ndarray):
        scaled = scale[:, None] * mass[np.ix_(moving, moving)] * scale
    else:
        S = scipy.sparse.diags(scale)
        scaled = (S @ mass.tocsr()[moving][:, moving] @ S).tocsc()
        solution = _solve_sparse(scaled, b)
    if solution is None:
        full = scaled if isinstance(scaled, np.ndarray) else scaled.toarray()
        options = {"lapack_driver": "gelsy", "check_finite": False}  # a step says what is not
        solution = scipy.linalg.lstsq(full, b, 1e-10, **options)[0]
    a[moving] = scale * solution
    return a


def _iterated(model: Model, force: np.ndarray) -> np.ndarray | None:
    """By products with the mass; None if conjugate gradients do not find them.

    Scaled by its diagonal, the mass of a mesh has a condition number below ten.
    """
    diagonal = model.reduction.maps.transpose_to_nodes(model.masses.matrix.diagonal())[: len(force)]
    scale = np.zeros(len(force))
    scale[diagonal > 0] = diagonal[diagonal > 0] ** -0.5
    x, r = np.zeros(len(force)), scale * force
    d, size = r, r @ r
    least = _EXACT**2 * size
    for _ in range(_MOST):
        if size <= least:
            return scale * x
        image = scale * _inertia(model, scale * d)
        if (moved := d @ image) <= _EXACT * (d @ d):  # nothing that has mass
            return None
        part = size / moved
        x, r = x + part * d, r - part * image
        size, last_size = r @ r, size
        d = r + size / last_size * d
    return None


def _solve_sparse(A: scipy.sparse.csc_matrix, b: np.ndarray) -> np.ndarray | None:
    """Solution for a positive definite matrix; None if it is singular."""
    A.eliminate_zeros()  # the masses have the stiffness' pattern
    try:
        factors = scipy.sparse.linalg.splu(A, "MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:
        return None
    return None if abs(factors.U.diagonal()).min() < 1e-10 else factors.solve(b)


def _factors(model: Model) -> LU:
    """Factors for matrices of the reduced pattern, in which the mass of unknowns is one."""
    return LU(model.reduction.tangent.pattern)


# -- The equations of a step, reduced to the unknowns by supports and joints, evaluated in C ----


class Residual(NamedTuple):
    """Residual of the equations at one increment, and its parts; the next one overwrites them."""

    #: Increment (size,) of displacements and rotations; not finite if loops cannot be closed.
    D: np.ndarray
    #: Internal minus added forces (size,) [N, N m].
    f: np.ndarray
    #: Full residual (size,) at the nodes: the forces of supports and joints [N, N m].
    r: np.ndarray
    #: Reduced residual (columns,): zero for the unknowns, support forces in the other columns.
    residual: np.ndarray


class Equations:
    """Tv^T r = 0 with r = M a(D) + f(D) - F (eqs 43 and 46), at the scheme's level of a step.

    In statics, functions of time are evaluated at one `time` [s], and the scene may rest in a frame
    that turns. ``natural(end)`` gives the natural strains at the end of a step; without, they are
    those at its start. A `problem` may be that of a loop; otherwise it is made, without masses if
    it is not `inert`, or with a part of their `inertia`.
    """

    def __init__(
        self,
        model: Model,
        time: float = 0.0,
        turning: TurningFrame | None = None,
        natural: Callable[[float], np.ndarray | None] | None = None,
        problem: ProblemInC | None = None,
        inert: bool = True,
        inertia: float = 1.0,
    ):
        self.model, self._time, self._natural = model, time, natural
        if problem is None:
            # The loop of a motion has another storage, whose library is there already.
            forces_only = model.scheme.rates.at_rest or not inert
            kind = ProblemKind(turns=turning is not None, forces_only=forces_only)
            problem = problem_of(model, kind._replace(inertia=inertia, inert=inert))
            problem.set_frame(turning)
        self._problem, self._c, self._library = problem, problem.c, problem.library
        self._doubles = problem.ffi.typeof("double[]")
        n, columns, p = model.size, model.reduction.columns, problem.c
        D, self._z, r, self._tangent, f, residual = problem.results(
            D=n, z=columns, r=n, tangent=p.tables.tangent.stored, f=n, reduced=columns
        )
        self._force, _, self._strains = problem.given()
        self._balance = Residual(D, f, r, residual)

    def _of(self, values: np.ndarray):
        return self._problem.ffi.from_buffer(self._doubles, np.ascontiguousarray(values))

    def set_load(self, factor: float) -> None:
        """Set the load factor of external forces in steps of a motion; 1 at first."""
        self.model.forms.set_load(factor)
        if (tables := self._problem.tables) is not None:
            tables.set_load(factor)

    def set_start(self, interval: Interval, start: State) -> None:
        """Set the interval of a step and the state at its start."""
        model, length, end = self.model, interval.length, interval.end
        model.reduction.set_start(start.q, start.slides)
        self._problem.state.load(start)
        if model.scheme.rates.at_rest:
            # The interval is one of load factors; only internal variables depend on its length.
            interval = Interval(self._time, self._time)
        level = model.scheme.rates.level
        model.forms.parameters.set_step_values(interval.time_at(level), start.parameters)
        self._length, self._start = length, start
        follow = model.points.followers
        followers = floats(follow.forces_in(interval)) if len(follow) else np.empty(0)
        t = interval.time_at(level) - level * length  # also of an instant
        self._library.fx_begin(self._c, t, length, self._of(followers))
        self.end_at(end)

    def take_beams(self, forces: np.ndarray, tangent: np.ndarray, sub_step: int) -> None:
        """Take forces along beams (size,) and their tangent from arrays, in one of the sub-steps.

        The tangent has the sparsity of all forces.
        """
        self._c.work.run.sub_step = sub_step
        arrays = {"beam_forces": forces, "beam_tangent": tangent}
        self._problem.set(work={"newton": arrays})

    def end_at(self, end: float) -> None:
        """Set the end of the step, in statics the load factor there."""
        model = self.model
        at_rest = model.scheme.rates.at_rest
        if at_rest:
            model.forms.compiled_points.set_load(end, self._length)
        if model.data.natural:
            strains = self._start.natural if self._natural is None else self._natural(end)
            self._strains[:] = 0.0 if strains is None else strains.ravel()
        self._library.fx_end_at(self._c, self._length, end if at_rest else 0.0)

    def evaluate(self, y: np.ndarray, driven: np.ndarray, force: np.ndarray) -> Residual:
        """Evaluate at increments of the unknowns y (free,) and of driven motion (driven,).

        `force` (size,) has the dead loads at the scheme's level. Also finds the tangent.
        """
        reduction = self.model.reduction
        reduction.increment(y, driven)
        self._z[:], self._force[:] = reduction.in_columns(y, driven), force
        if not self._library.fx_balance(self._c, self._length):
            self._balance.D[:] = np.nan
        y[:] = self._z[: len(y)]
        return self._balance

    def at_start(self, force: np.ndarray) -> Residual:
        """Evaluate at the start of the step: the increment is zero."""
        free, driven = self.model.reduction.free, self.model.reduction.driven
        return self.evaluate(np.zeros(free), np.zeros(driven), force)

    def change(self, D: np.ndarray, sizes: bool = False) -> np.ndarray:
        """Change (size,) of the forces with a small change of all degrees of freedom.

        With `sizes` by the sizes of all entries of the tangent.
        """
        out = np.empty(len(D))
        self._library.fx_change(self._c, self._of(D), sizes, self._of(out))
        return out

    @property
    def acceleration(self) -> np.ndarray:
        """Accelerations (size,) of the last balance, at the level of its forces."""
        return next(self._problem.results(acc=self.model.size))

    @property
    def values(self) -> np.ndarray:
        """Values of the tangent in the sparsity of `ReducedTangent.pattern`."""
        return self._tangent[self._problem.storage.tangent_places]

    def system(self) -> scipy.sparse.csr_matrix:
        """The linear system of the last balance: the unknowns and auxiliary ones before others."""
        reduction, storage = self.model.reduction, self._problem.storage
        indptr, indices = storage.pattern
        n = len(indptr) - 1
        A = scipy.sparse.csr_matrix((self.values, indices, indptr), (n, n))
        if reduction.couplings.sliding:
            A = without_border(A, storage.bordering_entries(self._problem), storage.border)
        if (members := self.model.points.members) is not None:
            A = (A + reduction.maps.reduced(members.tangent())).tocsr()
        return A

    def tangent(self) -> scipy.sparse.csr_matrix:
        """Reduced tangent (n, n) of the last balance, of the unknowns that follow no others.

        Not finite where those that follow are not determined.
        """
        return self.extended().matrix

    def extended(self) -> ConstrainedMatrix:
        """Reduced tangent of the last balance, in long trees with auxiliary unknowns."""
        return ConstrainedMatrix.of(self.system(), self.model.reduction)
