"""The compiled loop over time steps: a scene's forms, matrices and couplings handed to loop.c.

Everything physical comes from the functions that FFCx generates from the UFL; loop.c knows
Newton's method, the couplings and the nodal rates. Forces and driven motions are evaluated here,
a block of steps ahead.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from . import compat
from .library import LoopUnavailable, load_library
from .newton import ENERGY_FLOOR, ENERGY_SHARE, LONGEST_TURN, NewtonOptions
from .rates import MidPointRates, NewmarkRates
from .recorder import Recorder
from .reduction import Tables
from .state import State
from .stepping import Stepper

# A wider band costs more than a sparse factorisation.
_WIDEST_BAND = 60


class CompiledLoop:
    """Steps of a scene in compiled code; a step that fails goes to the stepper, which may halve it.

    Parameters
    ----------
    stepper : Stepper
        The model, its statistics, and the way out.
    options : NewtonOptions
        When Newton's method stops.

    Raises
    ------
    LoopUnavailable
        For springs, dampers, a scheme with rates of its own, a wide band, or no compiler.
    """

    def __init__(self, stepper: Stepper, options: NewtonOptions):
        self._stepper, self.model = stepper, stepper.model
        if len(self.model.actuators):
            raise LoopUnavailable("springs and dampers")
        self._ffi, self._library = load_library()
        self._keep: list[Any] = []
        self._problem = self._ffi.new("Problem *")
        self._hand_over_mesh()
        for name, form in (
            ("residual", "internal forces"),
            ("tangent", "tangent"),
            ("path_tangent", "tangent of the path"),
            ("energy", "strain energy"),
            ("added", "added virtual work"),
        ):
            if form in self.model.forms.compiled:
                self._hand_over_form(getattr(self._problem, name), *self.model.forms.compiled[form])
        self._problem.has_path = "tangent of the path" in self.model.forms.compiled
        self._problem.has_added = self.model.forms.has_added
        self._hand_over_rates()
        tables = self.model.reduction.tables()
        band = self._hand_over_couplings(tables)
        self._hand_over_motors_and_joints(tables.joints["number"])
        self._hand_over_newton(options)
        self._make_room()
        stepper.stats.solver = f"compiled, band {band}"

    # -- Handing over ---------------------------------------------------------------------------

    def _ints(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self._problem, name, self._pointer(values, np.int32, "int *"))

    def _doubles(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self._problem, name, self._pointer(values, np.float64, "double *"))

    def _pointer(self, values, dtype, kind: str):
        array = np.ascontiguousarray(values, dtype=dtype)
        self._keep.append(array)  # C holds no reference
        return self._ffi.cast(kind, array.ctypes.data)

    def _hand_over_mesh(self) -> None:
        model, p = self.model, self._problem
        mesh, K = model.mesh, model.forms.stiffness
        dofs = compat.element_dofs(mesh.space)
        p.dofs, p.cells, p.cell_dofs = model.size, *dofs.shape
        p.nonzeros, p.nodes = K.nnz, len(mesh.X)
        massless = np.flatnonzero(model.massless)
        p.turning, p.lacking = len(model.turns), len(massless)
        # Places of the entries of K, from 1 so that none is a zero.
        numbered = scipy.sparse.csr_matrix((np.arange(1, K.nnz + 1), K.indices, K.indptr), K.shape)
        n = dofs.shape[1]
        places = numbered[np.repeat(dofs, n, axis=1).ravel(), np.tile(dofs, (1, n)).ravel()]
        self._ints(
            dofs_of_cell=dofs,
            turns=model.turns,
            massless=massless,
            row_start=K.indptr,
            column_of=K.indices,
            place=np.asarray(places).ravel() - 1,
            node_dofs=mesh.dofs,
        )
        self._doubles(
            coordinates=compat.element_coordinates(mesh.mesh),
            per_unit=1 / model.unit,
            mass=model.mass.data,
            position=mesh.X,
        )
        if model.weight is not None:
            self._doubles(weight=model.weight)

    def _hand_over_form(self, out, form, ufl_form) -> None:
        ffi, forms = self._ffi, self.model.forms
        kernels, packed = compat.kernels(form), compat.packed_coefficients(form)
        cells = [forms.cells_of(tag) for tag, _ in kernels]
        data = [packed[tag] for tag, _ in kernels]
        lists = (
            ffi.new("kernel *[]", [ffi.cast("kernel *", address) for _, address in kernels]),
            ffi.new("int *[]", [self._pointer(own, np.int32, "int *") for own in cells]),
            ffi.new("double *[]", [self._pointer(own, np.float64, "double *") for own in data]),
        )
        self._keep += lists
        out.integrals, out.width = len(kernels), data[0].shape[1]
        out.kernels, out.cells, out.packed = lists
        out.cells_of = self._pointer([len(own) for own in cells], np.int32, "int *")
        moving = compat.coefficient_offsets(form, forms.moving)
        out.moving = len(moving)
        out.kind = self._pointer([kind for kind, _ in moving], np.int32, "int *")
        out.offset = self._pointer([offset for _, offset in moving], np.int32, "int *")
        sought = forms.time, forms.dt
        constants, places = compat.packed_constants(form, ufl_form, sought)
        out.constants = self._pointer(constants, np.float64, "double *")
        out.time_at, out.dt_at = places

    def _hand_over_rates(self) -> None:
        p, rates = self._problem, self.model.scheme.rates
        p.level = rates.level
        if type(rates) is NewmarkRates:
            p.rule, p.beta, p.gamma, p.alpha_m = 1, rates.beta, rates.gamma, rates.alpha_m
        elif type(rates) is not MidPointRates:
            raise LoopUnavailable(f"{type(rates).__name__} is a rule of its own")

    def _hand_over_couplings(self, t: Tables) -> int:
        p, reduction = self._problem, self.model.reduction
        p.columns, p.free, p.driven = reduction.columns, reduction.free, reduction.driven
        p.entries, p.joints = len(t.entries["row"]), len(t.joints["number"])
        p.followers = len(t.followers["through"])
        names = {"row": "entry_row", "column": "entry_column", "value": "entry_value"}
        self._ints(**{names[key]: t.entries[key] for key in names})
        self._ints(
            guide=t.joints["guide"],
            slide_column=t.joints["slide_column"],
            slide_of=t.joints["number"],
            follower_x=t.followers["x"],
            follower_y=t.followers["y"],
            through=t.followers["through"],
        )
        self._doubles(
            entry_sign=t.entries["sign"],
            offset=t.joints["offset"],
            axis=t.joints["axis"],
            joint_sign=t.joints["sign"],
        )
        band, order, at = _banded(*reduction.pattern)
        p.band = band
        self._ints(order=order)
        for name in ("plain", "mixed", "second"):
            table = getattr(t, name)
            setattr(p, name, len(table["to"]))
            for key, values in table.items():
                values = at[values] if key == "to" else values
                hand_over = self._doubles if key == "sign" else self._ints
                hand_over(**{f"{name}_{'from' if key == 'source' else key}": values})
        return band

    def _hand_over_motors_and_joints(self, bending: np.ndarray) -> None:
        p, model = self._problem, self.model

        def turn(node) -> int:
            return -1 if node.number < 0 else model.mesh.dofs[node.number, 2]

        none = [-1] * len(model.prescribed)
        self._ints(
            driven_dof=[*model.prescribed, *[-1] * len(model.motors)],
            motor_a=none + [turn(joint.a) for joint, _ in model.motors],
            motor_b=none + [turn(joint.b) for joint, _ in model.motors],
            motor_slide=none + [j.number if on == "slide" else -1 for j, on in model.motors],
        )
        p.slides = p.scene_joints = len(model.scene.joints)
        if self._stepper.joint_forces is None:
            return
        sums, turning = self._stepper.joint_forces.tables
        # Bending joints by the node that carries them.
        carriers = [model.scene.joints[n].a.number for n in bending]
        levers = [
            (j, m, turning[j, node])
            for j in range(p.scene_joints)
            for m, node in enumerate(carriers)
            if node >= 0 and turning[j, node]
        ]
        starts = np.searchsorted([j for j, _, _ in levers], np.arange(p.scene_joints + 1))
        self._ints(
            sum_start=sums.indptr,
            sum_of=sums.indices,
            lever_joint_start=starts,
            lever_joint=[m for _, m, _ in levers],
        )
        self._doubles(sum_sign=sums.data, lever_sign=[sign for _, _, sign in levers])

    def _hand_over_newton(self, options: NewtonOptions) -> None:
        p = self._problem
        p.tolerance, p.max_turn = options.tolerance, options.max_turn
        p.longest_turn, p.energy_floor = LONGEST_TURN, ENERGY_FLOOR
        p.energy_tolerance = ENERGY_SHARE * options.tolerance
        p.max_iterations = options.max_iterations

    def _make_room(self) -> None:
        model, reduction = self.model, self.model.reduction
        sizes = {
            "q": model.size,
            "v": model.size,
            "a": model.size,
            "slide": len(model.scene.joints),
            "driven_now": reduction.driven,
            "held": reduction.columns - reduction.free,
            "added_force": model.size,
        }
        self._room = {name: np.zeros(size) for name, size in sizes.items()}
        self._doubles(**self._room)
        self._doubles(scratch=np.zeros(self._library.fx_scratch(self._problem)))

    # -- Running --------------------------------------------------------------------------------

    def march(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> State:
        """State after several steps of the grid.

        Parameters
        ----------
        state : State
            The present.
        times : (steps,) float
            Ends of the steps [s].
        first : int
            Number of the first of them, from 1.
        recorder : Recorder
            Keeps what it wants.

        Returns
        -------
        State
            The state at the last of the times.

        Raises
        ------
        StepError
            If a step fails after all halvings, or a function of time fails.
        """
        done = 0
        while done < len(times):
            steps = _equal_steps(state.t, times[done:])
            done += self._run(state, times[done : done + steps], first + done, recorder)
            state = self._state(float(times[done - 1]) if done else state.t)
            if self._problem.failure:
                # The step that failed, in Python, which knows how to halve it.
                self._problem.failure = 0
                state = self._stepper.march(state, times[done : done + 1], first + done, recorder)
                done += 1
        return state

    def _run(self, state: State, times: np.ndarray, first: int, recorder: Recorder) -> int:
        """Take steps of one length, and give how many succeeded."""
        p, stats, model = self._problem, self._stepper.stats, self.model
        forces, driven, error = self._ahead(state.t, times)
        room = self._room
        room["q"][:], room["v"][:], room["a"][:] = state.q, state.v, state.a
        room["slide"][:] = state.slides
        room["driven_now"][len(model.prescribed) :] = state.motors
        p.steps_done = state.held is not None
        if state.held is not None:
            room["held"][:] = state.held
        if state.added is not None:
            room["added_force"][:] = state.added
        p.t, p.work, p.iterations, p.by_round_off = state.t, state.work, 0, 0
        to = self._ffi.new("Record *")
        to.every, to.first, to.last = recorder.every, first, recorder.last
        for name, rows in recorder.arrays.items():
            at = rows[recorder.rows :]
            setattr(to, name, self._ffi.cast("double *", at.ctypes.data))
        stride = 2 * model.size if len(forces) > 1 else 0
        steps = len(driven)
        dt = (times[-1] - state.t) / len(times)
        done = self._library.fx_run(
            p,
            steps,
            dt,
            self._ffi.cast("double *", forces.ctypes.data),
            stride,
            self._ffi.cast("double *", driven.ctypes.data),
            to,
        )
        recorder.rows += to.rows
        stats.steps += done
        stats.newton_iterations += p.iterations
        for name, count in (("increment", done - p.by_round_off), ("round-off", p.by_round_off)):
            if count:
                stats.ended_by[name] = stats.ended_by.get(name, 0) + count
        if error is not None and done == steps:
            raise error
        return done

    def _ahead(self, t: float, times: np.ndarray):
        """Forces and driven motions of all steps, or of those before the first that fails."""
        stepper, model = self._stepper, self.model
        starts = np.concatenate([[t], times[:-1]])
        forces, driven, error = [], np.zeros((len(times), model.reduction.driven)), None
        if model.loads.constant:
            forces.append(stepper.end_forces(t, float(times[0])))
        try:
            for k, (t0, t1) in enumerate(zip(starts, times, strict=True)):
                if not model.loads.constant:
                    forces.append(stepper.end_forces(float(t0), float(t1)))
                if model.reduction.driven:
                    driven[k] = stepper.driven_at(float(t1))
        except (Exception, KeyboardInterrupt) as raised:
            error, driven = raised, driven[:k]
            forces = forces or [(np.zeros(model.size),) * 2]
        return np.array(forces), driven, error

    def _state(self, t: float) -> State:
        p, room = self._problem, {name: values.copy() for name, values in self._room.items()}
        taken = p.steps_done > 0
        return State(
            t,
            room["q"],
            room["v"],
            room["a"],
            room["slide"],
            room["driven_now"][len(self.model.prescribed) :],
            held=room["held"] if taken else None,
            added=room["added_force"] if taken and p.has_added else None,
            work=p.work,
        )


def _equal_steps(t: float, times: np.ndarray) -> int:
    """How many of the steps have the length of the first, rounding aside."""
    steps = np.diff(times, prepend=t)
    different = abs(steps / steps[0] - 1) > 1e-6
    return int(np.argmax(different)) if different.any() else len(steps)


def _banded(indptr: np.ndarray, indices: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """Half band width, place of each unknown in it, and place of each entry."""
    n = len(indptr) - 1
    if n == 0:
        raise LoopUnavailable("there are no unknowns")
    graph = scipy.sparse.csr_matrix((np.ones(len(indices)), indices, indptr), (n, n))
    order = np.empty(n, dtype=int)
    order[reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)] = np.arange(n)
    rows, columns = order[np.repeat(np.arange(n), np.diff(indptr))], order[indices]
    band = int(abs(rows - columns).max(initial=0))
    if band > _WIDEST_BAND:
        raise LoopUnavailable(f"a band of {band} is too wide")
    return band, order, rows * (2 * band + 1) + band + columns - rows
