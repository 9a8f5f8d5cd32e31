"""Converts a model for the compiled loop: forms, matrices and couplings as arrays.

FFCx generates the integrals along beams from the UFL, and functions of points of laws in UFL. All
else is in the C files: Newton's method, couplings, nodal rates, and the forces at nodes and joints.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from fx_beam.coupling.index_reduction import Tables, TieTables
from fx_beam.fem import dolfinx_api, ffcx_api
from fx_beam.fem.nodal_rules import NodalRules
from fx_beam.mechanics.rates import MidPointRates, NewmarkRates
from fx_beam.model.joint_forces import JointForces, Passing
from fx_beam.model.model import Model
from fx_beam.stepping.newton import NewtonOptions

from .build import LoopUnavailable, load_batches, load_library
from .element_data import aligned, element_data, in_lanes, rows_of_nodes
from .kernels import Kernel
from .lu_layout import COSTS, alone_in_column, factors_of, places_of_entries
from .slider_tables import hand_over_sliders, storage_of
from .tolerances import hand_over_tolerances

# Forms that are evaluated together, by their names in C.
_FORMS = {
    "internal": ("internal forces", "tangent"),
    "energy": ("strain energy",),
    "inversion": ("inverted sections",),
    "added": ("added virtual work",),
    "lost": ("lost energy",),
    "taken": ("scheme's loss",),
    "held_by_scheme": ("scheme's energy",),
    "evolution": ("internal variables",),
}


class Problem:
    """The C struct Problem, and the arrays to which it points.

    LoopUnavailable, with the reason, if the compiled loop cannot run the model.
    """

    def __init__(self, model: Model, joint_forces: JointForces | None, options: NewtonOptions):
        self.model = model
        self.ffi, self.library = load_library()
        self._keep: list[Any] = []
        #: Pointers to the data of cells by cells, since forms have them in common.
        self._shared: dict[Any, Any] = {}
        self.c = self.ffi.new("Problem *")
        tables = model.reduction.tables()
        place = self._hand_over_couplings(tables)
        self._hand_over_mesh(place)
        for name, forms in _FORMS.items():
            if forms[0] in model.forms.bound:
                self._hand_over_forms(getattr(self.c, name), forms, model.forms.moving)
        self.c.has_added, self.c.keeps_before = model.forms.has_added, model.keeps_before
        self._hand_over_rates(place)
        self._hand_over_nodal_forces(place)
        if (follow := model.forms.followers) is not None:
            self.c.thrusts = len(follow.dofs)
            self._ints(thrust_dofs=follow.dofs, thrust_places=place[follow.places])
        self._hand_over_motors()
        self._hand_over_actuators()
        if joint_forces is not None:
            self._hand_over_joint_forces(joint_forces)
        hand_over_tolerances(self.c, options)
        self._allocate()

    def _ints(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self.c, name, self._pointer(values, np.int32))

    def _doubles(self, **arrays) -> None:
        for name, values in arrays.items():
            setattr(self.c, name, self._pointer(values, np.float64))

    def _pointer(self, values, dtype):
        kind, array = "int[]" if dtype == np.int32 else "double[]", np.asarray(values, dtype, "C")
        return self._kept(self.ffi.from_buffer(kind, array))

    def _kept(self, data):
        """Keep a reference to data of C, so that Python does not free them."""
        self._keep.append(data)
        return data

    def _hand_over_mesh(self, place: np.ndarray) -> None:
        model, p = self.model, self.c
        mesh, K, mass = model.mesh, model.forms.stiffness, model.mass
        dofs, coordinates, entries = element_data(mesh, K)
        p.dofs, p.nodes = model.size, len(mesh.X)
        p.cells, p.cell_internal = len(dofs), int(np.prod(model.forms.internal_shape[1:]))
        p.cell_dofs, p.cell_coordinates = dofs.shape[1], coordinates.shape[1]
        massless = np.flatnonzero(model.massless)
        p.turning, p.massless_count = len(model.turns), len(massless)
        #: Degrees of freedom and coordinates of each cell; with the first index for the lanes that
        #: have no cell. Storage indices.
        self._of_cells = {
            "dofs": (dofs, None),
            "to": (dofs, p.dofs),
            "coordinates": (coordinates, None),
        }
        self._places = place[entries]
        turns = np.zeros(model.size, dtype=bool)
        turns[model.turns] = True
        heavy = mass.data != 0
        turning = heavy & turns[mass.indices]
        p.turning_masses = np.count_nonzero(turning)
        self._ints(
            turns=model.turns,
            massless=massless,
            row_start=K.indptr,
            column_of=K.indices,
            place=place,
            mass_start=np.concatenate([[0], np.cumsum(heavy)])[mass.indptr],
            mass_column=mass.indices[heavy],
            mass_place=place[heavy],
            turning_column=mass.indices[turning],
            turning_place=place[turning],
            node_dofs=mesh.dofs,
        )
        self._doubles(
            per_unit=1 / model.unit,
            per_displacement=np.where(turns, 0, 1 / model.unit),
            mass=mass.data[heavy],
            turning_mass=mass.data[turning],
            position=mesh.X,
        )
        if p.cell_internal:
            internal, width = np.arange(p.cells * p.cell_internal), model.forms.internal_shape[-1]
            self._of_cells["internal"] = internal.reshape(p.cells, -1), None
            self._doubles(per_weight=np.repeat(1 / model.forms.point_weights, width))
        if model.weight is not None:
            self._doubles(weight=model.weight)
        columns = model.loads.columns
        p.loads = columns.shape[1]
        self._ints(load_start=columns.indptr, load_dof=columns.indices)
        self._doubles(load_force=columns.data)

    def _hand_over_forms(self, out, names: tuple[str, ...], fields: list) -> None:
        """Hand over forms of fields that change, in the order of `Forms.moving`."""
        ffi, p, forms = self.ffi, self.c, self.model.forms
        found = [forms.bound[name] for name in names if name in forms.bound]
        form, compiled = found[0]
        packed, tags = dolfinx_api.packed_coefficients(form, compiled), ffcx_api.integrals(compiled)
        of_cell = p.cell_internal if out == p.evolution else p.cell_dofs
        kernel = Kernel(found, of_cell)
        out.integrals, out.width = len(tags), packed[tags[0]].shape[1]
        numbers = kernel.size, out.width, p.cell_coordinates
        # Named after the form that takes longest to compile.
        name = names[min(1, len(found) - 1)]
        batches = load_batches(name, kernel.key, kernel.source, len(tags), numbers)
        out.of = integrals = self._kept(ffi.new("Integral[]", len(tags)))
        moving = sorted(dolfinx_api.coefficient_offsets(form, fields))
        out.moving, out.changing = len(moving), sum(kind == 0 for kind, _ in moving)
        for of, tag, batch in zip(integrals, tags, batches, strict=True):
            cells = forms.cells_of(tag)
            of.batch, of.cells = ffi.cast("Batch *", batch), len(cells)
            of.packed = self._lanes(packed[tag])
            for name, pointer in self._pointers_of(cells).items():
                setattr(of, name, pointer)
        out.kind = self._pointer([kind for kind, _ in moving], np.int32)
        out.offset = self._pointer([offset for _, offset in moving], np.int32)
        sought = forms.fields.time, forms.fields.dt, forms.fields.memory
        constants, places = dolfinx_api.packed_constants(form, compiled, sought)
        out.constants = self._pointer(constants, np.float64)
        out.time_at, out.dt_at, out.memory_at = places

    def _pointers_of(self, cells: np.ndarray) -> dict[str, Any]:
        """Pointers to the data of some cells, by their names in C."""
        key, places, p = cells.tobytes(), self._places[cells], self.c
        if key in self._shared:
            return self._shared[key]
        found = {name: self._lanes(rows[cells], at) for name, (rows, at) in self._of_cells.items()}
        if p.chain:
            rows = rows_of_nodes(places, p.places, self.library.LANES)
            found["run"] = self._lanes(rows.run, p.places)
            for name in ("single_start", "single_from", "single_to"):
                found[name] = self._pointer(getattr(rows, name), np.int32)
        else:
            found["place"] = self._lanes(places, p.places)
        self._shared[key] = found
        return found

    def _lanes(self, rows: np.ndarray, behind: int | None = None):
        """Pointer to rows as `in_lanes` arranges them."""
        blocks = in_lanes(rows, self.library.LANES, behind)
        return self._pointer(blocks, blocks.dtype)

    def _hand_over_nodal_forces(self, place: np.ndarray) -> None:
        p, forms = self.c, self.model.forms
        if forms.beam_drag is not None:
            fields = [forms.beam_drag.increment, *forms.moving[1:]]
            self._hand_over_forms(p.drag, ("drag", "tangent of drag"), fields)
            self._hand_over_forms(p.lost_to_drag, ("loss to drag",), fields)
        if forms.node_drag is not None:
            p.drags = len(forms.node_drag.dofs)
            self._ints(drag_dofs=forms.node_drag.dofs, drag_places=place[forms.node_drag.places])
            self._doubles(drag_factors=forms.node_drag.factors)
        if forms.contact is not None:
            rows = forms.contact.table(place)
            p.contacts, p.contact = len(rows), self._kept(self.ffi.new("Contact[]", rows))

    def _hand_over_rates(self, place: np.ndarray) -> None:
        p, rates = self.c, self.model.scheme.rates
        p.level = rates.level
        if type(rates) is NewmarkRates:
            p.rule, p.beta, p.gamma, p.alpha_m = 1, rates.beta, rates.gamma, rates.alpha_m
        elif (rules := self.model.nodal_rules) is not None:
            self._hand_over_rules(rules, place)
        elif type(rates) is not MidPointRates:
            raise LoopUnavailable(f"custom rates {type(rates).__name__}")
        fractions = self.model.scheme.fractions
        if len(fractions) > self.library.SUB_STEPS:
            raise LoopUnavailable(f"more than {self.library.SUB_STEPS} sub-steps")
        p.sub_steps, p.fractions[0 : len(fractions)] = len(fractions), fractions

    def _hand_over_rules(self, rules: NodalRules, place: np.ndarray) -> None:
        p = self.c
        p.rule = 0 if p.level == 0.5 else 1
        addresses = [function.address for function in rules.functions]
        p.rules = len(addresses)
        p.nodal_rule = self._kept(self.ffi.new("Law *[]", p.rules))
        for i, address in enumerate(addresses):
            p.nodal_rule[i] = self.ffi.cast("Law *", address)
        self._ints(column_at_node=rules.columns, rule_places=place[rules.places])

    def _hand_over_couplings(self, t: Tables) -> np.ndarray:
        """Hand over the couplings; returns the storage index of each entry of the full tangent."""
        p, reduction = self.c, self.model.reduction
        p.columns, p.free, p.driven = reduction.columns, reduction.free, reduction.driven
        equal = (t.entries["value"] == 0) & (t.entries["sign"] == 1)
        first = np.argsort(~equal, kind="stable")
        entries = {key: values[first] for key, values in t.entries.items()}
        p.entries, p.equal = len(equal), np.count_nonzero(equal)
        p.joints, p.followers = len(t.joints["number"]), len(t.followers["through"])
        self._ints(
            **{f"entry_{name}": entries[name] for name in ("row", "column", "value")},
            guide=t.joints["guide"],
            slide_column=t.joints["slide_column"],
            slide_of=t.joints["number"],
            follower=t.followers["dof"],
            through=t.followers["through"],
        )
        self._doubles(
            entry_sign=entries["sign"],
            offset=t.joints["offset"],
            axis=t.joints["axis"],
            joint_sign=t.joints["sign"],
        )
        if not reduction.free:
            raise LoopUnavailable("the scene has no unknowns")
        loops = reduction.loop_tables()
        # Rows of unknowns that close loops are no forces, by which errors are judged.
        ties = reduction.dependent if reduction.dependent.size else None
        self.factors = factors = factors_of(*reduction.pattern, loops is None, ties, COSTS)
        at, stored = factors.at, factors.size
        if not factors.band:  # the tangent is stored apart
            indptr, indices = reduction.pattern
            at, stored = np.arange(len(indices)), len(indices)
            p.factor_size, p.kept.worth = factors.size, factors.worth
            self._ints(tangent_start=indptr, tangent_column=indices, factor_at=factors.at)
        alone = alone_in_column(t, self.model.size, reduction.free)
        alone[self.model.actuators.turns()] = False  # springs and dampers act there as well
        if t.ties:
            alone[np.isin(self.model.couplings.column, t.ties.ints["tie_column"])] = False
        if loops is not None:
            alone[np.isin(self.model.couplings.column, loops.ints["loop_column"])] = False
            for name, value in loops.numbers.items():
                setattr(p, name, value)
            self._ints(**loops.ints, **{name: at[k] for name, k in loops.places.items()})
            self._doubles(**loops.doubles)
        at, stored = storage_of(reduction, at, stored)
        padding = [*factors.padding, *self._hand_over_ties(t.ties, at)]
        place, p.places = places_of_entries(t, self.model.forms.stiffness, alone, at, stored)
        self._kept(hand_over_sliders(self.ffi, p, reduction, at, self._pointer))
        p.band, p.chain, p.reacting = factors.band, factors.chain, np.count_nonzero(~alone)
        p.paddings = len(padding)
        self._ints(
            order=factors.order,
            padding=padding,
            factor_start=factors.starts,
            factor_diagonal=factors.diagonals,
            reacts=np.flatnonzero(~alone),
        )
        if (groups := factors.groups) is not None:
            p.groups = len(groups.group_first) - 1
            self._ints(**groups._asdict())
        added = place[t.direct["source"]] >= stored
        parts = t._replace(direct={key: values[added] for key, values in t.direct.items()})
        for name in ("direct", "coupled", "geometric", "restoring"):
            table = getattr(parts, name)
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
        return place

    def _hand_over_ties(self, ties: TieTables | None, at: np.ndarray) -> np.ndarray:
        """Hand over the ties; returns the storage indices of their diagonals, which are 1.

        `at` has those of the entries of the pattern.
        """
        p = self.c
        p.unknowns = p.free
        if ties is None:
            return np.empty(0, int)
        for name, value in ties.numbers.items():
            setattr(p, name, value)
        at = np.append(at, -1)  # for what is no unknown
        self._ints(**ties.ints, **{name: at[k] for name, k in ties.places.items()})
        self._doubles(tie_sign=ties.sign)
        return at[ties.ones]

    def _hand_over_motors(self) -> None:
        model = self.model

        def turn(node) -> int:
            return -1 if node.number < 0 else model.mesh.dofs[node.number, 2]

        none = [-1] * len(model.prescribed)
        self._ints(
            driven_dof=[*model.prescribed, *[-1] * len(model.motors)],
            motor_a=none + [turn(joint.a) for joint, _ in model.motors],
            motor_b=none + [turn(joint.b) for joint, _ in model.motors],
            motor_slide=none + [j.number if on == "slide" else -1 for j, on in model.motors],
        )
        self.c.slides = len(model.scene.joints)

    def _hand_over_actuators(self) -> None:
        actuators = self.model.actuators
        rows, pushes = actuators.tables()
        self.c.actuators, self.c.pushes = len(rows), len(pushes["of"])
        self.c.spring_width, self.c.may_overshoot = actuators.width, self.model.may_overshoot
        for row in rows:
            for name in ("law", "elastic", "switch_"):
                row[name] = self.ffi.cast("Law *", row[name])
            for name in ("given", "found"):
                row[name] = self._pointer(np.zeros(4 + row["variables"]), np.float64)
        self.c.actuator = self._kept(self.ffi.new("Actuator[]", rows))
        self._ints(push_column=pushes["column"], push_of=pushes["of"])
        self._doubles(push_sign=pushes["sign"])

    def _hand_over_joint_forces(self, joint_forces: JointForces) -> None:
        self.c.scene_joints = len(self.model.scene.joints)
        both = joint_forces.displacements, joint_forces.rotations
        parts = {name: np.concatenate([getattr(p, name) for p in both]) for name in Passing._fields}
        self.c.passes, self.c.passes_of_forces = len(parts["dof"]), len(both[0].dof)
        self._ints(pass_dof=parts["dof"], pass_to=parts["to"], pass_of=parts["of"])
        self._doubles(pass_sign=parts["sign"])

    def _allocate(self) -> None:
        model, reduction = self.model, self.model.reduction
        sizes = {
            "q": model.size,
            "v": model.size,
            "a": model.size,
            "slide": len(model.scene.joints),
            "driven_now": reduction.driven,
            "added_forces": model.size,
            "constraint_forces": reduction.columns - reduction.free,
            "joint_forces": 3 * len(model.scene.joints),
            "contact_forces": 2 * model.forms.contacts,
            "before": model.size if model.keeps_before else 0,
            "internals": int(np.prod(model.forms.internal_shape)),
            "spring_internals": model.actuators.width,
        }
        # One piece of memory, which the loop copies before a step with sub-steps.
        known, past = self.library.PAST, (1, model.size, reduction.free)
        order = self.library.MAX_ORDER if self.c.sub_steps > 1 else 0
        errors = order, order * model.size, (self.library.AVERAGED - 1) * model.size
        memory = self._kept(np.zeros(sum(sizes.values()) + known * sum(past) + sum(errors)))
        self.c.memory = self.ffi.cast("double *", memory.ctypes.data)
        self.c.memory_size = len(memory)
        ends = [0, *itertools.accumulate([*sizes.values(), *(known * n for n in past), *errors])]
        arrays = [memory[start:end] for start, end in itertools.pairwise(ends)]
        states, of_errors = arrays[:-6], arrays[-3:]
        ages, differences, differences_y = arrays[-6:-3]
        self.state_arrays = dict(zip(sizes, states, strict=True))
        self._doubles(**self.state_arrays)
        names = "error_ages", "error_past", "error_highest"
        self._doubles(**dict(zip(names, of_errors, strict=True)))
        ages[:] = of_errors[0][:] = 1.0
        #: Past of the predictor: ages, divided differences of nodes (size,) and unknowns (free,).
        self.past = ages, *(d.reshape(known, -1) for d in (differences, differences_y))
        #: First configuration with inverted sections.
        self.inverted_q = np.zeros(model.size)
        self._doubles(inverted_q=self.inverted_q)
        self._doubles(ages=self.past[0], past=self.past[1], past_y=self.past[2])
        self._doubles(scratch=aligned(np.zeros(self.library.fx_scratch(self.c))))
