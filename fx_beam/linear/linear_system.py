"""A scene as a linear system x' = A x + B u, y = C x + D u about a state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from scipy.sparse import csr_matrix

from fx_beam.errors import SceneError, answering_keywords, is_whole, require
from fx_beam.fem.point_values import AN_INSTANT, PointValues
from fx_beam.laws.interval import StepBatch
from fx_beam.motions.initial_state import end_of
from fx_beam.motions.motion import Motion
from fx_beam.motions.motion_setup import check_scene
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Node
from fx_beam.scene.functions import InputSignal, check_names, values_of, widths
from fx_beam.scene.outputs import (
    OF_JOINTS,
    OF_LINES,
    OF_NODES,
    Measured,
    Output,
    check_differentiable,
    check_outputs,
)
from fx_beam.scene.scene import Scene
from fx_beam.step.constrained_matrix import warn_of_rounding
from fx_beam.step.equations import have_mass
from fx_beam.step.recorded_rows import driven_of

from .linearisation import bends, output_rows, sized, split
from .moving_state import Deviations, deviations, forces_inside

# Round-off of the jump of a rate with an input, relative to the outputs.
_NONE = 1e-12
# A lever that is round-off: damping by its square is none, and the forces that it drives are none.
_LEVER = 1e-9
# Least pivot of a mass that is scaled by its diagonal: none of its combinations is round-off.
_DEFINITE = 1e-6
# Random forces from which soft directions are found.
_SAMPLES = 3


class InputColumns:
    """Forces F u + G u' of inputs u (m,) on z: F and G (columns, m); and motions of motors.

    Positions p (k,) of motors move z by P p, P (columns, k); their rates are p' = R u, R (k, m).
    """

    def __init__(self, about: Deviations, names: Sequence[str]):
        model, inputs, free, count = about.model, about.held, len(about.unknowns), about.T.shape[1]
        size = sum(inputs.widths[name] for name in names)
        self.F, self.G = np.zeros((2, count, size))
        moved: list[np.ndarray] = []
        driven: list[int] = []
        #: Name of each input; with its component where it has two.
        self.labels: list[str] = []
        #: Number and factor of the first driven motion of each position.
        self.driven: list[tuple[int, float]] = []
        #: Inputs whose rates have forces: number, place in all inputs, and value in the state.
        self.straining: list[tuple[int, int, float]] = []
        first = dict(zip(inputs.widths, np.cumsum([0, *inputs.widths.values()]), strict=False))
        strains = (function for _, function in model.data.natural.functions)
        inner = [*model.forms.parameters.functions, *strains]
        for name in names:
            parts, width, number = inputs.parts[name], inputs.widths[name], len(self.labels)
            self.labels += [name] if width == 1 else [f"{name}.{part}" for part in "xy"]
            if any(part is function for function in inner for part in parts):
                self.F[:, number], self.G[:, number] = forces_inside(about, name)
                if self.G[:, number].any():
                    self.straining.append((number, first[name], float(inputs.values[name][0])))
            elif parts[0].ramps:
                pairs = enumerate(about.forcing.functions)
                ramps = [(i, ramp) for i, ramp in pairs if isinstance(ramp, InputSignal)]
                scales = {i: ramp.scale for i, ramp in ramps if ramp.name == name}
                column = np.zeros(count)
                column[[free + i for i in scales]] = [*scales.values()]
                self.driven.append(next(iter(scales.items())))
                driven.append(number)
                moved.append(column)
            else:
                for i, unit in enumerate(np.eye(width), start=number):
                    self.F[:, i] = about.T.T @ _force(about, parts, unit)
        self.P = np.array(moved).reshape(-1, count).T
        self.R = np.eye(size)[driven]


def _force(about: Deviations, parts: list, unit: np.ndarray) -> np.ndarray:
    """Nodal forces (size,) of a unit of an input."""
    model = about.model
    force, values = np.zeros(model.size), {id(part): part.scale * unit for part in parts}
    for columns, function in model.data.loads.functions:
        if id(function) in values:
            force += model.data.loads.unit_loads[:, columns] @ values[id(function)]
    for load in model.scene.loads:
        if load.follower and id(load.value) in values:
            assert isinstance(load.target, Node)  # only forces on nodes turn
            dof_x, dof_y, turn = model.mesh.dofs[load.target.number]
            c, s = np.cos(about.state.q[turn]), np.sin(about.state.q[turn])
            x, y = values[id(load.value)]
            force[dof_x] += c * x - s * y
            force[dof_y] += s * x + c * y
    return force


class FirstOrder:
    """x' and the deviations z, as matrices of the states x and the inputs u side by side: (x, u).

    Unknowns without mass and damping are eliminated. Where the rate of an input has a force G u',
    the rates of masses are v + M^-1 G u and what has damping only is at x + C^-1 G u: so the states
    v and x have no force of u', and do not jump with u.
    """

    def __init__(self, about: Deviations, inputs: InputColumns, caller: str):
        free = len(about.unknowns)
        y, unit = slice(free), about.model.units.unknowns[about.unknowns]
        V, masses, damped = _kinds(about.M[y, y], about.C[y, y], unit, caller)
        M, C, K = ((V.T @ part[y, y] @ V).tocsr() for part in (about.M, about.C, about.K))
        P, R = inputs.P, inputs.R
        Mp, Cp, Kp = (V.T @ part[y] @ P for part in (about.M, about.C, about.K))
        F, G = V.T @ inputs.F[y], V.T @ inputs.G[y]
        # Unknowns with mass, with damping only, and with neither.
        h, a, b = slice(masses), slice(masses, masses + damped), slice(masses + damped, free)
        k, m = R.shape
        counts = np.cumsum([0, masses, damped, k, masses, m])
        eye = np.eye(counts[-1])
        yh, ya, p, s, u = (eye[i:j] for i, j in zip(counts[:-1], counts[1:], strict=True))
        solve_mass = scipy.sparse.linalg.splu(M[h, h].tocsc()).solve if masses else np.copy
        solve, C_a, K_b = np.linalg.solve, C[a, a].toarray(), K[b, b].toarray()
        dp = R @ u
        self.moved = solve_mass(Mp[h])
        #: Jumps of what has damping only, and of the rates of masses, with the inputs.
        self.shifts = solve(C_a, G[a])
        self.kicks = solve_mass(G[h] - C[h, a] @ self.shifts)
        dyh = s + self.kicks @ u - self.moved @ dp
        ya = ya + self.shifts @ u
        try:
            answers = solve(K_b, np.column_stack([F[b], K[b, : b.start].toarray(), Kp[b]]))
        except np.linalg.LinAlgError as error:
            raise SceneError(
                f"{caller}: a part without mass and damping moves freely. Give it mass or a support"
            ) from error
        # K_b yb = F u - K (yh, ya) - Kp p.
        Bu, Bh, Ba, Bp = np.split(answers, np.cumsum([m, masses, damped]), axis=1)
        yb = Bu @ u - Bh @ yh - Ba @ ya - Bp @ p

        def force(rows: slice) -> np.ndarray:
            elastic = K[rows, h] @ yh + K[rows, a] @ ya + K[rows, b] @ yb + Kp[rows] @ p
            return F[rows] @ u - elastic - C[rows, h] @ dyh - Cp[rows] @ dp

        dya = solve(C_a, force(a))
        ds = solve_mass(force(h) - C[h, a] @ dya)
        dyb = -Bh @ dyh - Ba @ dya - Bp @ dp
        self.dx = np.vstack([dyh, dya, dp, ds])
        moved = np.zeros((len(P), counts[-1]))
        moved[y] = V @ np.vstack([yh, ya, yb])
        self.z = moved + P @ p
        rates = np.zeros_like(moved)
        rates[y] = V @ np.vstack([dyh, dya, dyb])
        self.dz = rates + P @ dp
        #: Jumps (free, m) of the unknowns with the inputs.
        self.jumps = V[:, a] @ self.shifts + V[:, b] @ (Bu - Ba @ self.shifts)
        self._inverse = V if masses == free else np.linalg.inv(V.toarray())
        self._h, self._a = h, a
        #: Matrix (n, states) that gives the states of this system.
        self._states = np.eye(len(self.dx))
        # What motions are compared with: arrays alone, and no model.
        self._start, self._frame, self._inputs = about.state, about.frame, inputs
        self._factor, self._widths = about.factor, dict(about.held.widths)
        self._T, self._dT, self._rates = about.T, about.dT, about.rates
        self._rates_from, (q, slides) = about.rates_from, (about.state.q, about.state.slides)
        D, slides = np.split(np.eye(len(q) + len(slides)), [len(q)], axis=1)
        unknowns = about.model.couplings.unknowns(D, slides)[:, about.unknowns]
        #: What is read of displacements and slides: unknowns, then driven motions.
        self._read = np.hstack([unknowns, driven_of(about.model, D, slides)]).T

    def projected(self, W: np.ndarray) -> FirstOrder:
        """The system of fewer states W x, W (n, states)."""
        fewer = copy(self)
        fewer._states = W @ self._states
        return fewer

    def deviation(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, end: State) -> np.ndarray:
        """States x of a motion: displacements (nodes, 3), rates, slides (joints,), and time [s].

        With the inputs at its end, where a force follows from their rates.
        """
        start, free = self._start, len(self.jumps)
        if q.size != start.q.size or len(slides) != len(start.slides):
            raise SceneError("deviation: the motion is one of another scene")
        q, v = q.reshape(-1), v.reshape(-1)
        if self._frame is not None:
            q, v = self._frame.seen(q, v, self._factor, end.t - start.t)
        z = self._read @ np.concatenate([q - start.q, slides - start.slides])
        dz = self._rates_from @ (v - self._T @ self._rates - self._dT @ z)
        driven, u = self._inputs.driven, np.zeros(self.jumps.shape[1])
        p, dp = (np.array([x[free + number] / scale for number, scale in driven]) for x in (z, dz))
        if (inputs := values_of(end, self._widths)) is not None:
            for number, place, value in self._inputs.straining:
                u[number] = inputs[place] - value
        y, dy = self._inverse @ z[:free], self._inverse @ dz[:free]
        slow = y[self._a] - self.shifts @ u
        rates = dy[self._h] + self.moved @ dp - self.kicks @ u
        return self._states @ np.concatenate([y[self._h], slow, p, rates])


def _kinds(
    M: csr_matrix, C: csr_matrix, unit: np.ndarray, caller: str
) -> tuple[csr_matrix, int, int]:
    """Basis V (free, free) of unknowns with mass, with damping only, with neither; two numbers."""
    heavy, count = have_mass(M.diagonal(), unit), M.shape[0]
    if heavy.all() and _are_definite(M):
        return scipy.sparse.identity(count, format="csr"), count, 0
    identity = np.eye(count)
    heavy_basis, light_basis = split(M.toarray(), identity[:, heavy])
    rest = np.hstack([light_basis, identity[:, ~heavy]])
    C = unit[:, None] * C.toarray() * unit
    most = abs(C).max(initial=0.0)
    damped, neither = split((C + C.T) / 2, sized(rest / unit[:, None]), _LEVER**2 * most)
    left = max(abs(C @ neither).max(initial=0), abs(neither.T @ C).max(initial=0))
    if left > _LEVER * most:
        raise SceneError(
            f"{caller}: forces that depend on rates drive a part without mass. Give it mass"
        )
    basis = np.hstack([heavy_basis, unit[:, None] * damped, unit[:, None] * neither])
    return csr_matrix(basis), heavy_basis.shape[1], damped.shape[1]


def _are_definite(M: csr_matrix) -> bool:
    """Whether each motion has mass, by the factors of a mass matrix."""
    S = scipy.sparse.diags(M.diagonal() ** -0.5)
    options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
    try:
        factors = scipy.sparse.linalg.splu(
            (S @ M @ S).tocsc(), **options, options={"SymmetricMode": True}
        )
    except RuntimeError:  # exactly singular
        return False
    return bool((factors.U.diagonal() > _DEFINITE).all())


# Quantities that are linearised: places and rates of nodes and joints.
_MOTION_ARRAYS = "q", "slides", "v"
_KINDS = (OF_NODES | OF_JOINTS | OF_LINES).items()
_LINEAR = [name for name, quantity in _KINDS if quantity.of in _MOTION_ARRAYS]


@answering_keywords
@dataclass(frozen=True, repr=False)
class LinearSystem:
    r"""Small deviations from a state: :math:`\dot x = A x + B u`, :math:`y = C x + D u`.

    Created by `linearise`. The states x are, in this order: the deviations of the unknowns with
    mass; of the unknowns with damping but no mass; of the positions of motors; and the rates of the
    unknowns with mass. Where motors move masses, the motion by the motors is subtracted from these
    rates. Where an input u strains a damping material, a force G u' depends on the rate of u. The
    jumps that it would cause are then subtracted: M^-1 G u from the rates, and C^-1 G u from the
    unknowns with damping but no mass.

    Parameters
    ----------
    A : (n, n) float
        System matrix [1/s and mixed units].
    B : (n, m) float
        Effect of the inputs.
    C : (k, n) float
        Outputs of the states.
    D : (k, m) float
        Direct effect of the inputs on the outputs.
    inputs : tuple of str
        Names of the inputs: forces and moments as they are; of motors and driven motions the rates
        of their positions [m/s, rad/s].
    outputs : tuple of str
        Names of the outputs; those with several components have names such as "tip.x".
    reduction : object
        Maps motions of the scene to x; used by `deviation`.

    Examples
    --------
    A mass on a spring: the eigenvalues are +-i omega, with omega = sqrt(k/m) = 2 rad/s.

    >>> import numpy as np, fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=8.0, GA=1.0, EI=1.0))
    >>> scene.fix(bar.start, "x", "y", "rotation")
    >>> scene.fix(bar.end, "y", "rotation")
    >>> mass = scene.add_mass(bar.end, 2.0)
    >>> load = scene.add_force(bar.end, fb.Input("push", factor=(1, 0)))
    >>> system = fb.linearise(scene, outputs={"x": fb.Output("displacement", bar.end, "x")})
    >>> system
    <LinearSystem: 2 states, inputs ['push'], outputs ['x']>
    >>> np.linalg.eigvals(system.A).imag.round(6)
    array([ 2., -2.])
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    reduction: Any

    def __repr__(self):
        return (
            f"<LinearSystem: {len(self.A)} states, inputs {list(self.inputs)}, "
            f"outputs {list(self.outputs)}>"
        )

    def state_space(self):
        """The system for the functions of `scipy.signal`.

        Returns
        -------
        scipy.signal.StateSpace
            In continuous time.
        """
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def slowest(self, n: int) -> LinearSystem:
        """Reduce the system to its slowest modes, for the design of controllers.

        Beams have axial vibrations that are faster by many orders than the motion to be controlled,
        and methods such as `scipy.linalg.solve_continuous_are` fail with them. Modes that are left
        out are assumed to follow the inputs without delay, which adds to D.

        Parameters
        ----------
        n : int
            Number of states; one more is kept if this number would split a complex pair.

        Returns
        -------
        LinearSystem
            With the states of these modes; `deviation` gives them.

        Raises
        ------
        SceneError
            If there are not that many states.

        Examples
        --------
        >>> import numpy as np, fx_beam as fb
        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e6, GA=1e6, EI=1.0, rhoA=1.0, rhoI=1e-4)
        >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
        >>> scene.clamp(beam.start)
        >>> load = scene.add_force(beam.end, fb.Input("push", factor=(0, 1)))
        >>> outputs = {"tip": fb.Output("displacement", beam.end, "y")}
        >>> slow = fb.linearise(scene, outputs=outputs).slowest(2)
        >>> abs(np.linalg.eigvals(slow.A)).round(2)
        array([3.52, 3.52])
        """
        states = len(self.A)
        expected = f"a whole number below that of the states, {states}"
        require(is_whole(n, 1, states - 1), "slowest: n", n, expected)
        # Balanced, so that rounding errors of fast modes do not hide the slow ones.
        A, scale = scipy.linalg.matrix_balance(self.A, permute=False)
        scale = scale.diagonal()
        B, C = self.B / scale[:, None], self.C * scale
        sizes = np.sort(abs(np.linalg.eigvals(A)))
        paired = sizes[n] <= sizes[n - 1] * (1 + 1e-9) and n + 1 < states
        bound = np.sqrt(sizes[n - 1 + paired] * sizes[n + paired])

        def slow(real: float, imaginary: float = 0.0) -> bool:
            return abs(real + 1j * imaginary) < bound

        _, right, _ = scipy.linalg.schur(A, sort=slow)
        _, left, count = scipy.linalg.schur(A.T, sort=slow)
        V, W = right[:, :count], left[:, :count].T
        W = np.linalg.solve(W @ V, W)
        fast = B - V @ (W @ B)
        answer = np.linalg.solve(A - V @ (W @ A) + bound * V @ W, fast)
        matrices = {"A": W @ A @ V, "B": W @ B, "C": C @ V, "D": self.D - C @ answer}
        return replace(self, reduction=self.reduction.projected(W / scale), **matrices)

    def deviation(self, of: Motion | Solution) -> np.ndarray:
        """States x of a motion, for feedback of all states.

        Parameters
        ----------
        of : Motion or Solution
            A motion of the scene, in its present state, or a solution in its last row.

        Returns
        -------
        (n,) float
            Deviation of the motion from the state of the linear system, to first order.

        Raises
        ------
        SceneError
            If `of` is neither a motion nor a solution, or belongs to another scene.
        """
        expected = "a Motion or a Solution of the scene"
        require(isinstance(of, Motion | Solution), "deviation: of", of, expected)
        motion = of.state if isinstance(of, Motion) else of
        q, v = motion.recorded("q")[-1], motion.recorded("v")[-1]
        return self.reduction.deviation(q, v, motion.slides[-1], end_of(motion))


def linearise(
    scene: Scene,
    state: Solution | Motion | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Mapping[str, Output] | None = None,
) -> LinearSystem:
    r"""Linearise the motion of a scene about a state, for control.

    :math:`M \ddot z + C \dot z + K z = F u` for small deviations z of the unknowns, with joints and
    supports eliminated. All forces that depend on positions and rates are differentiated: stiffness
    (also geometric), springs, dampers, drag, retardation. About a state in motion, M, C and K also
    have the centrifugal and gyroscopic terms of joints whose coupling changes. The system is then
    that of the instant: its coefficients are constant, although the state moves on, and its
    unknowns are measured in the fixed frame. About a static state that turns (``static(scene,
    spin=...)``) deviations, and the directions of forces and outputs, are measured in the turning
    frame. The axes of this frame are the fixed ones at the time of the state, and the system is the
    same at all times. Unknowns without mass are eliminated if they have no damping, and are of
    first order otherwise.

    The matrices A to D are full, as each acceleration depends on all masses: 1200 unknowns (400
    elements of degree 1) take about 1 s, 6000 unknowns 20 s and 5 GB. `LinearSystem.slowest` takes
    far longer, 10 s for 600 unknowns. For larger scenes `modes`, `ModalResponse` and
    `frequency_response` have sparse matrices, and elements of degree 3 need fewer unknowns.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : Solution or Motion, optional
        The state: the last row of a static solution, which may turn, or of a motion with its
        velocities, or the present state of a `Motion`; inputs have the values of this state. By
        default the reference configuration at rest without loads, or the equilibrium to which
        springs under tension bring it, as for `modes`.
    inputs : sequence of str, optional
        Names of inputs of the scene; by default all.
    outputs : dict, optional
        `Output` by names: positions, displacements, rotations, velocities and spins of nodes,
        angles, slides and their rates ("spin", "rate") of joints; length, rate, force and energy of
        ropes, forces between points and springs to the ground.

    Returns
    -------
    LinearSystem
        With A, B, C and D as arrays.

    Raises
    ------
    SceneError
        For unknown inputs or outputs, a state of another scene, or a scene without unknowns. If a
        part without mass or damping is not held by a stiffness, or if the rate of a massless node
        is an output of an input that acts on it.

    Examples
    --------
    A hinged rod that stands upright falls as e^(lambda t), with lambda^2 = 3/2 g/L:

    >>> import copy, numpy as np, fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> section = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=1e-6)
    >>> rod = scene.add_beam([(0, 0), (0, 1)], section, elements=2)
    >>> hinge = scene.add_joint(fb.Revolute(fb.GROUND, rod.start))
    >>> load = scene.add_moment(rod.start, fb.Input("torque"))

    The state is an equilibrium of a copy that is held upright.

    >>> held = copy.copy(scene)
    >>> held.fix(held.beams[0].start, "rotation")
    >>> upright = fb.static(held, load_steps=1)
    >>> system = fb.linearise(scene, upright, outputs={"angle": fb.Output("angle", hinge)})
    >>> round(float(np.linalg.eigvals(system.A).real.max()), 2), round((1.5 * 9.81) ** 0.5, 2)
    (3.84, 3.84)
    """
    caller = "linearise"
    check_scene(scene, caller)
    expected = "a Solution or a Motion of the scene"
    require(isinstance(state, Motion | Solution | None), f"{caller}: state", state, expected)
    outputs = {} if outputs is None else outputs
    check_outputs(scene, outputs, f"{caller}: outputs")
    all_names = widths(scene)
    names = list(all_names) if inputs is None else inputs
    is_list = isinstance(names, Sequence) and not isinstance(names, str)
    are_names = is_list and all(isinstance(name, str) for name in names)
    require(are_names, f"{caller}: inputs", inputs, "a sequence of names")
    check_names(names, all_names, f"{caller}: inputs")
    about = deviations(scene, state.state if isinstance(state, Motion) else state, caller)
    _warn_of_rounding(about, caller)
    driving = InputColumns(about, names)
    reduced = FirstOrder(about, driving, caller)
    rows, rate_rows, direct, labels = _outputs(about, outputs, names, caller)
    CD = rows @ reduced.z + rate_rows @ reduced.dz
    CD[:, len(reduced.dx) :] += direct
    improper = abs(rate_rows[:, : len(about.unknowns)] @ reduced.jumps)
    if improper.size and improper.max() > _NONE * abs(CD).max():
        label = labels[int(improper.max(axis=1).argmax())]
        raise SceneError(
            f"{caller}: output {label!r} is the rate of a node without mass on which an input "
            "acts; it jumps with the input. Give the node a mass or an inertia (add_mass, rhoI)"
        )
    n = [len(reduced.dx)]
    A, B = np.hsplit(reduced.dx, n)
    C, D = np.hsplit(CD, n)
    return LinearSystem(A, B, C, D, tuple(driving.labels), tuple(labels), reduced)


def _warn_of_rounding(about: Deviations, caller: str) -> None:
    """Warn of a stiffness with few digits in soft directions, near the lowest modes."""
    free = slice(len(about.unknowns))
    K, unit = about.K[free, free], about.model.units.unknowns[about.unknowns]
    forces = np.random.default_rng(0).normal(size=(len(unit), _SAMPLES)) / unit[:, None]
    with suppress(RuntimeError):  # a singular one
        solve = scipy.sparse.linalg.splu(K.tocsc()).solve
        soft = solve(solve(forces) / unit[:, None] ** 2)
        if bends(about.model, about.T[:, free] @ soft):
            warn_of_rounding(K, soft, f"{caller}: the stiffness has")


def _outputs(about: Deviations, outputs: Mapping[str, Output], inputs: Sequence[str], caller: str):
    """Matrices Y, Y' (k, columns), E (k, m) of outputs Y z + Y' z' + E u, and their names.

    Places are T z, and rates T z' + T' z.
    """
    T, S, dT, dS = about.T, about.S, about.dT, about.dS
    parts: list[dict[str, Any]] = [
        {"q": T, "v": dT, "slides": S, "rates of slides": dS},
        {"v": T, "rates of slides": S},
        {"parameters": csr_matrix(_parameters_by_inputs(about, inputs))},
    ]
    rows, labels = [[np.zeros((0, next(iter(x.values())).shape[1]))] for x in parts], list[str]()
    for name, output in outputs.items():
        check_differentiable(output, f"{caller}: output {name!r}")
        measured = Measured(output)
        if not measured.law_quantity and output.quantity not in _LINEAR:
            raise SceneError(
                f"{caller}: output {name!r} is a {output.quantity}; only {', '.join(_LINEAR)} are "
                "linearised"
            )
        slopes = _slopes(about, measured)
        for matrices, part_rows in zip(parts, rows, strict=True):
            part_rows.append(output_rows(about.model, measured, matrices, slopes))
        components = output.components
        labels += [f"{name}.{part}" for part in components] if components else [name]
    return *map(np.concatenate, rows), labels


def _slopes(about: Deviations, measured: Measured) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Derivatives of an output by entries of arrays; those of lines by their own laws."""
    model, state, rates = about.model, about.state, about.T @ about.rates
    if measured.sliding:
        return [("rates of slides", np.array([measured.place.number]), np.ones((1, 1, 1)))]
    if not (quantity := measured.law_quantity):
        arrays = {"q": state.q, "v": rates, "slides": state.slides, "X": model.mesh.X.ravel()}
        return [*measured.slopes(lambda array, entries: arrays[array][entries])]
    step = StepBatch.single(
        state.t,
        1.0,
        q=state.q,
        v=rates,
        parameters=model.forms.parameters.values_at(state.t),
        spring_internal=state.spring_internal,
        load_factor=np.array(about.factor),
    )
    rule = AN_INSTANT if quantity == "pull" else None
    return [*PointValues(model.points, quantity, measured.place.number, rule).slopes(step)]


def _parameters_by_inputs(about: Deviations, names: Sequence[str]) -> np.ndarray:
    """Changes (parameters, m) of parameters with inputs, in which they are linear."""
    inputs, parameters, columns = about.held, about.model.forms.parameters, list[np.ndarray]()

    def changed(name: str, value: np.ndarray) -> np.ndarray:
        inputs.set({name: value})
        inputs.arrive()
        return parameters.values_at(about.state.t)

    for name in names:
        value = inputs.values[name]
        columns += [changed(name, value + u) - changed(name, value) for u in np.eye(len(value))]
    return np.reshape(columns, (len(columns), len(parameters))).T
