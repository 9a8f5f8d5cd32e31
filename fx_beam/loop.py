"""The compiled loop over time steps: a scene's forms, matrices and couplings handed to loop.c.

Everything physical comes from the functions that FFCx generates from the UFL; loop.c knows
Newton's method, the couplings and the nodal rates. Forces and driven motions are evaluated here,
a block of steps ahead.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from . import compat
from .band import alone_in_column, in_band, places_in_band
from .library import LoopUnavailable, load_batches, load_library
from .newton import CLOSE, ENERGY_FLOOR, ENERGY_SHARE, LONGEST_TURN, NewtonOptions
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
        For springs, dampers, follower forces, a scheme with rates of its own, a wide band, or no
        compiler.
    """

    def __init__(self, stepper: Stepper, options: NewtonOptions):
        self._stepper, self.model = stepper, stepper.model
        if len(self.model.actuators):
            raise LoopUnavailable("springs and dampers")
        if any(load.follower for load in self.model.scene.loads):
            raise LoopUnavailable("follower forces")
        self._ffi, self._library = load_library()
        self._keep: list[Any] = []
        self._problem = self._ffi.new("Problem *")
        tables = self.model.reduction.tables()
        band, place = self._hand_over_couplings(tables)
        self._hand_over_mesh(place)
        for name, form in (
            ("residual", "internal forces"),
            ("tangent", "tangent"),
            ("path_tangent", "tangent of the path"),
            ("energy", "strain energy"),
            ("added", "added virtual work"),
        ):
            if form in self.model.forms.compiled:
                self._hand_over_form(getattr(self._problem, name), form)
        self._problem.has_added = self.model.forms.has_added
        self._hand_over_rates()
        self._hand_over_motors_and_joints(tables.joints["number"])
        self._hand_over_newton(options)
        self._make_room()
        stepper.stats.solver = f"compiled, band {band}"

    # -- Handing over ---------------------------------------------------------------------------

    def _ints(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self._problem, name, self._pointer(values, np.int32))

    def _doubles(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self._problem, name, self._pointer(values, np.float64))

    def _pointer(self, values, dtype):
        array = self._kept(np.ascontiguousarray(values, dtype=dtype))
        return self._ffi.cast("int *" if dtype == np.int32 else "double *", array.ctypes.data)

    def _kept(self, data):
        """What C holds no reference to."""
        self._keep.append(data)
        return data

    def _hand_over_mesh(self, place: np.ndarray) -> None:
        model, p = self.model, self._problem
        mesh, K, mass = model.mesh, model.forms.stiffness, model.mass
        dofs, coordinates = compat.element_dofs(mesh.space), compat.element_coordinates(mesh.mesh)
        p.dofs, p.nodes = model.size, len(mesh.X)
        p.cell_dofs, p.cell_coordinates = dofs.shape[1], coordinates.shape[1]
        massless = np.flatnonzero(model.massless)
        p.turning, p.lacking = len(model.turns), len(massless)
        # Numbers of the entries of K, from 1 so that none is a zero.
        numbered = scipy.sparse.csr_matrix((np.arange(1, K.nnz + 1), K.indices, K.indptr), K.shape)
        n = dofs.shape[1]
        entries = numbered[np.repeat(dofs, n, axis=1).ravel(), np.tile(dofs, (1, n)).ravel()]
        #: What element functions and their results refer to, cell by cell.
        self._cell_data = {
            "dofs": dofs,
            "place": place[np.asarray(entries).reshape(len(dofs), n * n) - 1],
            "coordinates": coordinates,
        }
        heavy = mass.data != 0
        self._ints(
            turns=model.turns,
            massless=massless,
            row_start=K.indptr,
            column_of=K.indices,
            place=place,
            mass_start=np.concatenate([[0], np.cumsum(heavy)])[mass.indptr],
            mass_column=mass.indices[heavy],
            mass_place=place[heavy],
            node_dofs=mesh.dofs,
        )
        self._doubles(per_unit=1 / model.unit, mass=mass.data[heavy], position=mesh.X)
        if model.weight is not None:
            self._doubles(weight=model.weight)

    def _hand_over_form(self, out, name: str) -> None:
        ffi, p, forms = self._ffi, self._problem, self.model.forms
        form, ufl_form = forms.compiled[name]
        packed = compat.packed_coefficients(form)
        tags = compat.integrals(form)
        out.integrals, out.width = len(tags), packed[tags[0]].shape[1]
        size = p.cell_dofs ** len(ufl_form.arguments())
        numbers = size, out.width, p.cell_coordinates
        batches = load_batches(name, form, ufl_form, *numbers)
        out.of = integrals = self._kept(ffi.new("Integral[]", len(tags)))
        for of, tag, batch in zip(integrals, tags, batches, strict=True):
            cells = forms.cells_of(tag)
            of.batch, of.cells = ffi.cast("Batch *", batch), len(cells)
            for key, rows in self._cell_data.items():
                setattr(of, key, self._lanes(rows[cells]))
            of.packed = self._lanes(packed[tag])
        moving = compat.coefficient_offsets(form, forms.moving)
        out.moving = len(moving)
        out.kind = self._pointer([kind for kind, _ in moving], np.int32)
        out.offset = self._pointer([offset for _, offset in moving], np.int32)
        sought = forms.time, forms.dt
        constants, places = compat.packed_constants(form, ufl_form, sought)
        out.constants = self._pointer(constants, np.float64)
        out.time_at, out.dt_at = places

    def _lanes(self, rows: np.ndarray):
        """Pointer to rows in blocks of LANES, column by column; the last row fills the last one."""
        lanes = self._library.LANES
        padded = np.pad(rows, ((0, -len(rows) % lanes), (0, 0)), mode="edge")
        blocks = padded.reshape(len(padded) // lanes, lanes, rows.shape[1]).swapaxes(1, 2)
        return self._pointer(blocks, np.float64 if rows.dtype == np.float64 else np.int32)

    def _hand_over_rates(self) -> None:
        p, rates = self._problem, self.model.scheme.rates
        p.level = rates.level
        if type(rates) is NewmarkRates:
            p.rule, p.beta, p.gamma, p.alpha_m = 1, rates.beta, rates.gamma, rates.alpha_m
        elif type(rates) is not MidPointRates:
            raise LoopUnavailable(f"{type(rates).__name__} is a rule of its own")

    def _hand_over_couplings(self, t: Tables) -> tuple[int, np.ndarray]:
        """Half width of the band, and where each entry of the full tangent stands."""
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
        if not reduction.free:
            raise LoopUnavailable("there are no unknowns")
        band, order, at = in_band(*reduction.pattern)
        if band > _WIDEST_BAND:
            raise LoopUnavailable(f"a band of {band} is too wide")
        alone = alone_in_column(t, self.model.size, reduction.free)
        behind = reduction.free * (2 * band + 1)
        place, places = places_in_band(t, self.model.forms.stiffness, alone, at, behind)
        reacts = np.flatnonzero(~alone)
        p.band, p.places, p.reacting = band, places, len(reacts)
        self._ints(order=order, reacts=reacts)
        added = place[t.plain["source"]] >= behind
        plain = {key: values[added] for key, values in t.plain.items()}
        for name, table in (("plain", plain), ("mixed", t.mixed), ("second", t.second)):
            setattr(p, name, len(table["to"]))
            for key, values in table.items():
                if key == "sign":
                    self._doubles(**{f"{name}_sign": values})
                elif key == "to":
                    self._ints(**{f"{name}_to": at[values]})
                elif key == "source":
                    self._ints(**{f"{name}_from": place[values]})
                else:
                    self._ints(**{f"{name}_{key}": values})
        return band, place

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
        p.energy_tolerance, p.close = ENERGY_SHARE * options.tolerance, CLOSE
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
            forces.append(stepper.drive.forces(t, float(times[0])))
        try:
            for k, (t0, t1) in enumerate(zip(starts, times, strict=True)):
                if not model.loads.constant:
                    forces.append(stepper.drive.forces(float(t0), float(t1)))
                if model.reduction.driven:
                    driven[k] = stepper.drive.places(float(t1))
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
