"""Natural frequencies and mode shapes about a configuration, by SLEPc."""

from __future__ import annotations

import bisect
import functools
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import scipy.linalg
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.errors import SceneError
from fx_beam.mechanics.interval import Interval
from fx_beam.mechanics.schemes import Equilibrium
from fx_beam.model.equations import Equations
from fx_beam.model.model import Model
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam
from fx_beam.scene.scene import Scene
from fx_beam.stepping.initial_state import reference_state
from fx_beam.stepping.newton import petsc
from fx_beam.validation import is_whole, require


@dataclass(frozen=True)
class Modes:
    r"""Free vibrations about a configuration, lowest first.

    A vibration :math:`\hat x \sin(\omega t)` of small amplitude obeys
    :math:`K \hat x = \omega^2 M \hat x` in the unknowns of the scene. If :math:`\omega^2` is
    negative, the configuration is unstable: the amplitude grows as :math:`e^{|\omega| t}`, and the
    frequency is given as the negative number :math:`-|\omega|`.

    Parameters
    ----------
    angular_frequencies : (n,) float
        Angular frequencies omega [rad/s]; zero for rigid modes, negative for unstable ones.
    rigid : (n,) bool
        Whether a mode is a rigid-body motion: its strain energy is zero up to rounding.
    shapes : (n, n_node, 3) float
        Displacements and rotations of the nodes, with modal mass 1: shape.M.shape = 1 kg m^2.
    positions : (n_node, 2) float
        Positions of the nodes in the configuration [m].
    nodes_of_beam : dict
        All nodes of each beam in order, those inside elements included.
    degree : int
        Degree of the elements.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0))
    >>> scene.fix(bar.start, "x", "y", "rotation")
    >>> scene.add_mass(bar.end, mass=1.0)
    >>> found = fb.modes(scene, n=2)
    >>> moved = found.shape(bar, mode=0, size=0.1)[-1] - found.positions[-1]
    >>> len(found), abs(moved).round(3)
    (2, array([0. , 0.1]))
    """

    angular_frequencies: np.ndarray
    rigid: np.ndarray
    shapes: np.ndarray
    positions: np.ndarray
    nodes_of_beam: dict[str, np.ndarray]
    degree: int

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies [Hz], (n,); negative for unstable modes."""
        return self.angular_frequencies / (2 * np.pi)

    @property
    def unstable(self) -> np.ndarray:
        """Whether a mode grows instead of vibrating, (n,)."""
        return self.angular_frequencies < 0

    def __len__(self):
        return len(self.rigid)

    def __str__(self):
        names = np.select([self.rigid, self.unstable], ["rigid", "unstable"], "")
        rows = zip(range(len(self)), self.frequencies, names, strict=True)
        return "\n".join(f"mode {k}: {f:.6g} Hz {name}".rstrip() for k, f, name in rows)

    def shape(self, beam: Beam | str, mode: int, size: float) -> np.ndarray:
        """Axis of a beam, displaced by a mode.

        Parameters
        ----------
        beam : Beam or str
            A beam or its name.
        mode : int
            Number of the mode, from 0.
        size : float
            Largest displacement of a node of the scene [m].

        Returns
        -------
        (elements * degree + 1, 2) float
            Positions of its nodes, those inside elements included [m].

        Raises
        ------
        SceneError
            If there is no such beam or mode.
        """
        name = beam.name if isinstance(beam, Beam) else beam
        if name not in self.nodes_of_beam:
            raise SceneError(
                f"{name!r} is not a beam of these modes; they have {list(self.nodes_of_beam)}"
            )
        if mode not in range(-len(self), len(self)):
            raise SceneError(f"mode {mode!r}: there are {len(self)} modes, numbered from 0")
        moved, nodes = self.shapes[mode, :, :2], self.nodes_of_beam[name]
        scale = size / np.hypot(*moved.T).max()
        return self.positions[nodes] + scale * moved[nodes]


def modes(scene: Scene, state: Solution | None = None, n: int = 6) -> Modes:
    """Compute the lowest natural frequencies and mode shapes.

    The stiffness is the tangent at the state: it includes the geometric stiffness, springs, dead
    loads, and added forces with a potential, but no dampers or drag. Prescribed motions and motors
    are fixed.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : Solution, optional
        A solution whose last row is the configuration, which should be an equilibrium; by default
        the reference configuration without loads. It may be a solution of another scene with the
        same nodes, such as one in which a mechanism is supported.
    n : int
        Number of modes; fewer are returned if the scene has fewer degrees of freedom with mass.

    Returns
    -------
    Modes
        Frequencies and shapes.

    Raises
    ------
    SceneError
        If the scene cannot vibrate: it has no mass, no unknowns, or forces that depend on the
        motion and have no potential.
    RuntimeError
        If PETSc or SLEPc is missing, or if SLEPc fails.

    Examples
    --------
    The first bending frequency of a cantilever; the exact value is 3.516 sqrt(EI / (rhoA L^4)).

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e5, GA=1e5, EI=1.0, rhoA=1.0)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=16)
    >>> scene.clamp(beam.start)
    >>> lowest = fb.modes(scene, n=2)
    >>> round(float(lowest.angular_frequencies[0]), 1)
    3.5
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"modes needs an fx_beam.Scene, not {scene!r}")
    require(is_whole(n, 1), "modes: n", n, "a whole number from 1 on")
    model = Model(scene, Equilibrium(), mobile=True)
    K, M, T, q = _matrices(model, state)
    values, rounding, vectors = _lowest(K, M, n)
    rigid = abs(values) <= rounding
    omega = np.where(rigid, 0.0, np.sign(values) * np.sqrt(abs(values)))
    shapes = np.array([model.to_nodes(T @ vector) for vector in vectors.T])
    positions = model.mesh.X + model.to_nodes(q)[:, :2]
    names = [beam.name for beam in scene.beams]
    nodes = dict(zip(names, model.mesh.nodes, strict=True))
    return Modes(omega, rigid, shapes, positions, nodes, scene.beams[0].degree)


def _matrices(model: Model, state: Solution | None):
    """Reduced stiffness and mass, the matrix T of the coupling, and the configuration q."""
    reduction = model.reduction
    factor, t = 0.0, 0.0  # the reference configuration is an equilibrium without loads
    start = reference_state(model)
    if state is not None:
        factor, t, start.q, start.slides = _last(model, state)
    if not reduction.free:
        raise SceneError(
            "modes: the scene has no unknowns: supports, joints and motors fix all degrees of "
            "freedom. Release one of them"
        )
    if not model.mass.data.any():
        raise SceneError("modes: the scene has no mass. Give a section rhoA or add a mass")
    equations, force = Equations(model, t), factor * model.loads.at(t)
    if model.weight is not None:
        force += factor * model.weight
    equations.begin(Interval(factor, factor), start)
    K = equations.tangent(equations.at_start(force).r)
    if _asymmetry(K, model.unit_of_unknowns) > 1e-12:
        raise SceneError(
            "modes: the stiffness is not symmetric, since a load or an added virtual work depends "
            "on the motion and has no potential. Simulate the scene instead, or remove this load"
        )
    T = reduction.coupling()[:, : reduction.free]
    return (K + K.T) / 2, (T.T @ model.mass @ T).tocsr(), T, start.q


def _asymmetry(K, unit: np.ndarray) -> float:
    """Largest asymmetry of a stiffness, relative to its rows, independent of the user's units."""
    scale = scipy.sparse.diags(unit)
    work = abs(scale @ K @ scale)
    largest = work.max(axis=1).toarray()[:, 0]
    gap = (scale @ abs(K - K.T) @ scale).tocoo()
    sizes = np.sqrt(largest[gap.row] * largest[gap.col])
    return float((gap.data[sizes > 0] / sizes[sizes > 0]).max(initial=0.0))


def _last(model: Model, state: Solution):
    """Load factor, time, displacements and slides in the last row of a solution."""
    if not isinstance(state, Solution):
        raise SceneError(f"modes: state = {state!r} must be a solution of the scene")
    if not np.array_equal(state.X, model.mesh.X) or not len(state.q):
        raise SceneError(
            "modes: the state must be a solution with the nodes of this scene and its motion "
            "recorded (record=Record(motion=True))"
        )
    factor, t = 1.0, float(state.t[-1])
    if state.stats.static:
        # Functions of time were evaluated at one time.
        factor, t = t, state.end.t if state.end is not None else 0.0
    return factor, t, model.from_nodes(state.q[-1]), state.slides[-1]


def _lowest(K, M, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lowest eigenvalues (n,) of K x = lambda M x, their rounding, and vectors (size, n).

    The vectors have the modal mass 1.
    """
    massive = M.diagonal() > 0
    ratios = abs(K.diagonal()[massive]) / M.diagonal()[massive]
    # Scaled so that stiffnesses are of order 1 and eigenvalues below 1.
    unit = ratios.max() or 1.0
    scale = scipy.sparse.diags((abs(K.diagonal()) + unit * M.diagonal()) ** -0.5)
    K, M = scale @ K @ scale, unit * scale @ M @ scale
    # Smaller eigenvalues are rounding errors, even in the softest direction.
    least = 1e4 * np.finfo(float).eps * ratios.min(where=ratios > 1e-20 * unit, initial=unit) / unit
    values, rounding, vectors = _in_slices(K, M, n, 10.0 ** np.arange(np.log10(least), 4, 0.25))
    vectors = np.sqrt(unit) * (scale @ vectors)
    vectors *= np.sign(vectors[abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    return unit * values, unit * rounding, vectors


def _in_slices(K, M, n: int, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same by slices of four decades from below; `sizes` are candidates for slice bounds."""
    # Each slice has its own shift, since eigenvalues far below a shift are lost to rounding errors.
    # A slice is complete when it has as many eigenvalues as Sylvester's law counts. A Krylov space
    # may lack copies of multiple eigenvalues; they are found after deflation of the others.
    below = functools.cache(functools.partial(_below, K, M))
    levels = _levels(below, sizes)

    def reach(k):
        return levels[bisect.bisect_left(levels, k, hi=len(levels) - 1, key=below)]

    n = min(n, below(levels[-1]))  # the others are infinite, for unknowns without mass
    last = reach(n)
    values: np.ndarray = np.empty(0)
    rounding, vectors = values, np.empty((K.shape[0], 0))
    while (found := len(values)) < max(n, below(last)):
        bottom, noise = reach(found + 1), rounding.max(initial=levels[levels > 0][0])
        top = min(last, max(1e4 * bottom, 1e-4 * bottom, noise))
        shift = -max(top, -10 * bottom, 10 * noise)  # below the slice, not an eigenvalue
        new = _nearest(K, M, max(below(top) - found, 1), shift, vectors)
        # Rayleigh-Ritz method, orthogonal to the slices below.
        new -= vectors @ (vectors.T @ (M @ new))
        new = new @ scipy.linalg.eigh(new.T @ (K @ new), new.T @ (M @ new))[1]
        squares, errors = _quotients(K, M, new)
        # Vectors above the slice took the place of copies that are not found yet.
        inside = squares <= max(top + 1e-8 * abs(top), squares[0])
        values, rounding = np.append(values, squares[inside]), np.append(rounding, errors[inside])
        vectors = np.column_stack([vectors, new[:, inside]])
    order = np.argsort(values)[:n]
    return values[order], rounding[order], vectors[:, order]


def _levels(below: Callable[[float], int], sizes: np.ndarray) -> np.ndarray:
    """Slice bounds of both signs and these sizes, above the rounding error."""
    if below(sizes[-1]) < 1:
        raise SceneError(
            "modes: a part of the scene moves freely and has no mass. Give it mass or a support"
        )
    if below(-sizes[-1]) != 0:
        raise SceneError(
            "modes: the state is unstable in a motion without mass, so its growth rate is infinite."
            " Give this part mass, or use a state with less load"
        )
    # The rounding error of a rigid mode of a stiff part may be large compared with a soft part.
    least = next(k for k, x in enumerate(sizes) if min(below(x), below(-x)) >= 0)
    return np.concatenate([-sizes[least:][::-1], sizes[least:]])


def _quotients(K, M, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rayleigh quotients of vectors and their rounding errors; scales vectors to modal mass 1."""
    vectors /= np.sqrt(np.einsum("ij,ij->j", vectors, M @ vectors))
    values = np.einsum("ij,ij->j", vectors, K @ vectors)
    sizes = np.einsum("ij,ij->j", abs(vectors), abs(K) @ abs(vectors))
    return values, 2 * np.finfo(float).eps * sizes


def _below(K, M, x: float) -> int:
    """Number of eigenvalues below x: negative pivots of K - x M, by Sylvester's law of inertia.

    -1 if a pivot is zero: x is an eigenvalue.
    """
    try:
        factors = splu(
            (K - x * M).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError:
        return -1
    return int((factors.U.diagonal() < 0).sum())


def _nearest(K, M, n: int, shift: float, deflated: np.ndarray) -> np.ndarray:
    """Eigenvectors (size, n or fewer) nearest to a shift, except the deflated ones."""
    PETSc = petsc("fx_beam.modes")
    if find_spec("slepc4py") is None:
        raise RuntimeError("fx_beam.modes needs SLEPc. Install Debian's python3-slepc4py")
    from slepc4py import SLEPc

    def handed_over(matrix):
        rows = matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType)
        return PETSc.Mat().createAIJ(matrix.shape, csr=(*rows, matrix.data), comm=PETSc.COMM_SELF)

    # A tiny mass for massless unknowns, so that no vector has zero norm.
    trace = scipy.sparse.diags(1e-20 * (M.diagonal() == 0))
    A, B = handed_over(K.tocsr()), handed_over((M + trace).tocsr())
    solver = SLEPc.EPS().create(PETSc.COMM_SELF)
    solver.setOperators(A, B)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setDimensions(n, min(K.shape[0], 2 * n + 20))
    solver.setTolerances(1e-12, 1000)
    solver.setTarget(shift)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    solver.setDeflationSpace(
        [PETSc.Vec().createWithArray(x, comm=PETSc.COMM_SELF) for x in deflated.T.copy()]
    )
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    # Pivots of a slender beam in bending are small relative to its axial stiffness, but not zero.
    transform.getKSP().setType(PETSc.KSP.Type.PREONLY)
    factorisation = transform.getKSP().getPC()
    factorisation.setType(PETSc.PC.Type.LU)
    factorisation.setFactorPivot(zeropivot=1e-100)
    try:
        solver.solve()
        found = min(solver.getConverged(), n)
    except PETSc.Error as error:
        raise _failure(f"failed ({error})") from error
    if found == 0:
        raise _failure("found no mode")
    vectors, x = np.empty((K.shape[0], found)), A.createVecLeft()
    for k in range(found):
        solver.getEigenvector(k, x)
        vectors[:, k] = x.array
    return vectors


def _failure(what: str) -> RuntimeError:
    return RuntimeError(
        f"modes: SLEPc {what}. Try fewer modes, and check the units of stiffnesses and masses: "
        "SLEPc may fail for very different magnitudes"
    )
