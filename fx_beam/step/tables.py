"""Converts a model for the compiled loop: forms, matrices and couplings as arrays.

FFCx generates the integrals along beams from the UFL, and the laws of forces at points. All else is
in the C files: Newton's method, couplings and nodal rates.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse

from fx_beam.c_library import Structs, array_at, declared
from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.fem.mesh import rotation_of
from fx_beam.fem.sparsity import blocks_with
from fx_beam.laws.schemes import MOST_SUB_STEPS
from fx_beam.results.state import MACROS
from fx_beam.scene.beam import gauss_rule

from .build import begin_to_build, load_library
from .form_tables import FORMS, FormTables, aligned_zeros
from .lu_layout import COSTS, Factors, factors_of, graph_of, groups_of
from .model import Model
from .newton import ENERGY_FLOOR, LONGEST_TURN, NEGLIGIBLE, NewtonOptions
from .state_vector import StateVector
from .substeps import LARGE_TURN
from .tangent_storage import (
    alone_in_column,
    bordering_tables,
    on_bordering_rows,
    storage_of,
    storage_of_entries,
    with_bordering_rows,
)

if TYPE_CHECKING:
    from .turning_frame import TurningFrame

#: From so many elements on, threads share the work: they gain more than they cost.
LARGE = 20_000
# Forms of the equations.
_OF_EQUATIONS = "internal_forces", "drag"
# From so many nodes on beams, what slides is in the sparse rows, not beside them.
_MANY_SLIDES = 8
# Pointers of structs in Problem that not every scene and run needs.
_NOT_ALWAYS = {
    "internal": ("per_weight",),
    "loads": ("weight",),
    "system": (
        *("rows", "tangent_start", "tangent_column", "factor_at", "changing"),
        *("row_of", "unknown_of"),
    ),
    "at_points": ("stored_at", "slide_rate"),
    "scheme": ("rule_stored_at", "nodal_rule"),
    "statics": ("hold", "hold_dof", "viscous_weight", "diagonal_at"),
    "newton": ("find", "predicted"),
}


class Problem:
    """The C struct Problem, and the arrays to which it points.

    One of `forces_only` is for `Equations`: it takes no steps. One of `rates` has no forces. It may
    have a part of the `inertia` only; steps of one that is not `inert` are those of statics.
    """

    def __init__(
        self,
        model: Model,
        options: NewtonOptions,
        turns: bool = False,
        forces_only: bool = False,
        rates: bool = False,
        inertia: float = 1.0,
        inert: bool = True,
    ):
        self.model, self._frame_turns = model, turns
        self._forces_only, self._rates, self._inertia, self._inert = (
            forces_only,
            rates,
            inertia,
            inert,
        )
        #: Threads share the work of a large scene.
        self._is_large = len(model.mesh.unknowns.dofs) >= LARGE
        self._threads = 1
        if self._is_large:
            from .threads import thread_count

            self._threads = thread_count()
        pattern = model.reduction.tangent.pattern
        #: Whether bordering rows are among the sparse rows (c/bordering_rows.h).
        self._inside = (
            len(model.couplings.sliding) >= _MANY_SLIDES
            and not (forces_only or model.scheme.rates.at_rest)
            and model.points.members is None
            and not len(model.reduction.sliders.forces)
        )
        self.factors = self._factors_of(*pattern)
        self._features = self._features_of_scene()
        begin_to_build(self._features)  # beside what is compiled for the elements
        self.ffi = declared("problem.h", MACROS)
        #: Constants of problem.h.
        self.constants = self.ffi.dlopen(None)
        self._structs = Structs(self.ffi)
        self.c = self.ffi.new("Problem *")
        self._set(**{group: dict.fromkeys(names) for group, names in _NOT_ALWAYS.items()})
        self._sparse_factors = np.zeros(0)
        self._stored_at = stored_at = self._set_couplings()
        self._set_mesh(stored_at)
        self._set(forms={"has_added": model.forms.has_added})
        self._set_rates(stored_at)
        if rates:
            diagonal_at = stored_at[model.masses.diagonal]
            self._set(points=[{}], statics={"diagonal_at": diagonal_at})
        else:
            self._set_points(stored_at)
        self._set_motors()
        self._set(at_points={"lines": model.scene.force_count})
        if model.scene.joint_count:  # also of joints that were removed
            self._set_joint_forces()
        self._set(
            newton={
                **vars(options),
                "negligible": NEGLIGIBLE * options.tolerance,
                "energy_floor": ENERGY_FLOOR,
                "longest_turn": LONGEST_TURN,
                "large_turn": LARGE_TURN,
            }
        )
        of_beams = model.mesh.nodes
        if len(of_beams) != 1 or len(of_beams[0]) < len(model.mesh.X):  # else all is one part
            from .parts import part_tables

            self._set(parts=part_tables(model))
        numbers = self._numbers(masses=True) | self._positions()
        #: The numbers of the model, and positions of nodes, that this has.
        self.data, self._X = model.data, model.mesh.X
        #: Members that are numbers of the scene, which C reads here.
        self._own = {name: np.array(values, float) for name, values in numbers.items()}
        for name, values in self._own.items():
            group, member = name.split(".")
            self._set(**{group: {member: values}})
        self._allocate()
        self._structs.check(self.c)
        self._structs.remember(self.c)

    @classmethod
    def of(cls, model: Model, *options: Any) -> Problem:
        """A problem with the numbers that a model has now; one of earlier numbers serves again."""
        problem = model.problems.get(options)
        if problem is None or problem.data is model.data:  # that serves others now
            problem = model.problems[options] = cls(model, *options)
        else:
            problem.bind()
        return problem

    def _features_of_scene(self) -> str:
        """What the library for C must have (c/scene_features.h)."""
        factors, couplings = self.factors, self.model.couplings
        has = {
            "CHAIN": factors.chain,
            "BAND": factors.band and not factors.chain,
            "COUPLED": not couplings.is_selection,
            "LOOPS": couplings.closures,
            "SLIDERS": couplings.sliding,
            "MEMBERS": self.model.points.members is not None,
        }
        return "|".join(name for name, present in has.items() if present) or "0"

    @cached_property
    def library(self) -> Any:
        """The library of steps."""
        return load_library(self._features)[1]

    def begin_derivatives(self, way: str) -> None:
        """Compile `derivatives` beside all else."""
        begin_to_build(self._features, way)

    def derivatives(self, way: str) -> Any:
        """The library of the derivatives of steps, backwards ("VJP") or forwards ("JVP")."""
        return load_library(self._features, way)[1]

    def _set(self, **values: Any) -> None:
        self._structs.set(self.c, **values)

    def _set_mesh(self, stored_at: np.ndarray) -> None:
        model = self.model
        mesh, K = model.mesh, model.forms.stiffness
        cells, cell_dofs = mesh.unknowns.dofs.shape
        at_rest = model.scheme.rates.at_rest
        massless = np.empty(0, int) if at_rest else np.flatnonzero(model.massless)
        if natural := model.natural:
            self._set(
                natural={
                    "per_cell": int(np.prod(natural.shape[1:])),
                    "count": len(natural.starts) - 1,
                    "start": natural.starts,
                    "at": natural.rows,
                }
            )
        starts, nodes, _ = self._mass_blocks
        loads = model.loads
        per_cell = 0 if self._rates else int(np.prod(model.forms.internal_shape[1:]))
        self._set(
            cells=cells,
            mesh={
                "nodes": len(mesh.X),
                "cell_dofs": cell_dofs,
                "cell_coordinates": mesh.coordinates.shape[1],
                "massless_count": len(massless),
                "massless": massless,
                "threads": self._threads,
            },
            internal={"per_cell": per_cell},
            tangent={"row_start": K.indptr, "column_of": K.indices, "stored_at": stored_at},
            mass={"start": starts, "dof": 3 * nodes, "stored_at": stored_at[self.mass_entries]},
            loads={
                "count": len(loads.starts) - 1,
                "start": loads.starts,
                "dof": loads.rows,
                "follower_forces": 0 if self._rates else len(model.points.followers),
            },
        )
        #: Tables of the forms of beams, None without any.
        self.tables: FormTables | None = None
        if (beams := model.forms.beams) is not None and not self._rates:
            stored = stored_at[model.forms.of_cells]
            self.tables = FormTables(self, stored, self._is_large)
            forms = self.tables.all(_OF_EQUATIONS if self._forces_only else FORMS)
            self._set(forms=forms)
            if per_cell:
                weights = gauss_rule(beams.kind.degree)[1]
                per_weight = np.repeat(1 / weights, beams.internal_shape[-1])
                self._set(internal={"per_weight": per_weight})

    @cached_property
    def _mass_blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        weightless = self.model.scheme.rates.at_rest and not self._frame_turns
        K = self.model.forms.stiffness
        has_mass = np.zeros(K.nnz, bool) if weightless else self.model.mass.data != 0
        return blocks_with(has_mass, K.indptr, K.indices)

    @cached_property
    def mass_entries(self) -> np.ndarray:
        """Entries (pairs, 3) of the tangent that C has as masses and rotary inertias."""
        return np.ascontiguousarray(self._mass_blocks[2].reshape(-1, 9)[:, ::4])

    def _positions(self) -> dict[str, np.ndarray]:
        """The numbers that change where nodes move, by the names in c/problem.h."""
        return {
            "mesh.position": self.model.mesh.X,
            "mesh.per_unit": 1 / self.model.unit,
            "mesh.per_error": 1 / self.model.error_unit,
        }

    def _numbers(self, masses: bool) -> dict[str, np.ndarray]:
        """The other numbers of the scene, besides those of forms and points."""
        model = self.model
        of_joints = model.reduction.offsets_and_axes
        numbers = {f"joints.{name}": values for name, values in of_joints.items()}
        numbers["loads.force"] = floats(model.loads.entries)
        if masses:
            values, turning = 0, 0 if self._frame_turns else 1  # centrifugal forces have no moments
            if len(self.mass_entries):
                values = model.masses.values[self.mass_entries] * [1, 1, turning]
            numbers["mass.value"] = np.append(self._inertia * values, 0.0)
        if self._rates:
            numbers["statics.viscous_weight"] = model.little_mass()
        if model.weight is not None:
            numbers["loads.weight"] = model.weight
        if model.natural:
            numbers["natural.value"] = floats(model.natural.entries)
        return numbers

    def bind(self) -> None:
        """Set all numbers to those that the model has now, and all else to that before a run."""
        mesh, moved = self.model.mesh, self.model.mesh.X is not self._X
        heavier = self.data.masses is not self.model.data.masses
        numbers = self._numbers(heavier) | (self._positions() if moved else {})
        for name, values in numbers.items():
            self._own[name][...] = values
        self.data, self._X = self.model.data, mesh.X
        if self.tables is not None:
            self.tables.bind(mesh.coordinates if moved else None)
        self._structs.restore(self.c)
        self.state.clear()

    def _set_points(self, stored_at: np.ndarray) -> None:
        model, points = self.model, self.model.points
        self._set(
            at_points={
                "spring_width": points.width,
                "friction_follows": len(points.followed) > 0,
            },
            newton={"may_overshoot": model.may_overshoot},
        )
        if len(of_scene := model.forms.parameters):
            self._set(
                parameters={
                    "count": len(of_scene),
                    "value": of_scene.values,
                    "vary": of_scene.vary,
                    "energies_vary": of_scene.in_energies,
                }
            )
        if not points.any:
            self._set(points=[{}])
            return
        point_stored_at = np.where(points.value_at >= 0, stored_at[points.value_at], -1)
        # Each force on a slide has one entry, the last ones.
        places, numbers = self._on_slides
        point_stored_at[len(point_stored_at) - len(points.slides) + numbers] = places
        self._set(points=model.forms.in_c.address, at_points={"stored_at": point_stored_at})
        if len(points.slides):
            self._set(at_points={"slide_rate": np.zeros(model.scene.joint_count)})

    def _set_rates(self, stored_at: np.ndarray) -> None:
        rates, fractions = self.model.scheme.rates, self.model.scheme.fractions
        assert self.constants.SUB_STEPS == MOST_SUB_STEPS
        self._set(
            scheme={
                "level": rates.level,
                "at_rest": rates.at_rest or not self._inert,
                **rates.constants,
                "keeps_previous": self.model.keeps_previous,
                "sub_steps": len(fractions),
                "fractions": fractions,
            }
        )
        if rules := self.model.nodal_rules:
            addresses = np.array([function.address for function in rules], np.uintp)
            of_pairs = stored_at[self._mass_blocks[2]]
            tables = {"nodal_rule": addresses, "rule_stored_at": of_pairs}
            self._set(scheme={"rules": len(addresses), **tables})

    def _set_couplings(self) -> np.ndarray:
        """Hand over the couplings; returns the storage index of each entry of the full tangent."""
        p, reduction, factors = self.c, self.model.reduction, self.factors
        on_border = self.constants.ON_BORDER
        self._set(**reduction.members)
        places, stored = factors.at, factors.size
        if not factors.band:  # the tangent is stored apart
            indptr, indices = reduction.tangent.pattern
            places, stored = np.arange(len(indices)), len(indices)
            self._set(
                system={
                    "tangent_start": indptr,
                    "tangent_column": indices,
                    "factor_at": factors.at.astype(np.int32),
                    "reused": {"worth": 0 if self._rates else factors.worth},
                }
            )
        #: Storage indices of the entries of `ReducedTangent.pattern`.
        self.tangent_at = places
        if self.model.points.members is not None and not self._rates:
            self._set_changing_rows()
        elif factors.rows and not self._inside:
            self._sparse_factors = np.zeros(factors.size + 1)  # one more: see `factors_of`
            own = {"factors": self._sparse_factors, "threads": self._threads}
            self._set(system={"rows": [factors.rows | own]})
        if (loops := reduction.loops) is not None:
            diagonal, unit = loops.scales(reduction.tangent.pattern)
            table = {"scales": len(unit), "scale_at": places[diagonal], "scale_unit": unit}
            self._set(loops=table)
        places, stored, places_of_ones = storage_of(reduction, places, stored)
        tangent = reduction.tangent
        K, alone = self.model.forms.stiffness, alone_in_column(reduction)
        stored_at, place_of_one = storage_of_entries(tangent, K, alone, places, stored)
        stiff = {"stiffness_at": place_of_one + 1, "stiffened": tangent.stiffened}
        self._set(tangent={"stored": place_of_one + 2}, coupled=stiff)
        if reduction.couplings.sliding:
            diagonal_at = stored_at[self.model.masses.diagonal]
            tables = bordering_tables(self.model, places, diagonal_at, on_border, self._inside)
            self._set(**tables)
            if self._inside:
                self._set_changing_rows(tables)
        order = factors.order
        if self._inside:
            order = np.arange(len(order) + p.border.rows)
        padding = np.concatenate(
            [factors.padding, places_of_ones, places[tangent.ones], [place_of_one]]
        )
        self._set(
            system={
                "band": factors.band,
                "chain": factors.chain,
                "positions": 3 * factors.chain or len(order),
                "order": order.astype(np.int32),
                "unknowns": len(factors.order),
                "paddings": len(padding),
                "padding": padding,
            },
            tangent={"reacting": np.count_nonzero(~alone), "reacts": np.flatnonzero(~alone)},
        )
        added = stored_at[tangent.direct["from"]] >= stored
        direct = {key: values[added] for key, values in tangent.direct.items()}
        stored_from = np.append(stored_at, [place_of_one, p.coupled.stiffness_at])
        products = {"coupled": tangent.coupled, "geometric": tangent.geometric}
        for name, product in {"direct": direct, **products}.items():
            table = {key: stored_from[x] if key == "from" else x for key, x in product.items()}
            table["to"] = places[product["to"]]
            self._set(**{name: table | {"count": len(product["to"])}})
        #: Storage indices of the forces on slides, and which these are.
        self._on_slides = places[tangent.restoring["to"]], tangent.restoring["of"]
        return stored_at

    def _set_changing_rows(self, bordering: dict[str, Any] | None = None) -> None:
        """Hand over what a pattern that changes with contact points is found from.

        With tables of `bordering` rows it changes with what slides.
        """
        reduction, couplings = self.model.reduction, self.model.couplings
        graph = graph_of(*reduction.tangent.pattern)
        groups = groups_of(graph, reduction.dependent, reduction.forces)
        if bordering is not None:
            groups = with_bordering_rows(groups, bordering)
        system = *couplings.system, self.constants.ON_BORDER
        row_of, unknown_of = on_bordering_rows(reduction, *system)
        found_in_c = dict.fromkeys(("near_to", "order", "work", "position"))
        row = {
            "elimination": groups | found_in_c,
            "pair": None,
            "window": np.full(len(couplings.sliding), -1),
            "dof_start": couplings.all_entries.starts(self.model.size),
            **couplings.all_entries.members("dof_"),
            "keep": not couplings.closures and not couplings.auxiliaries and not couplings.sliding,
            **{name: getattr(COSTS, name) for name in ("row_entry", "substitution", "least_worth")},
        }
        if bordering is None:
            self._set(system={"row_of": row_of, "unknown_of": unknown_of})
        self._set(system={"changing": [row]})
        self.c.system.rows = self.ffi.addressof(self.c.system.changing[0], "elimination", "rows")
        # Freed with this object, before what it points to: C allocates as much as the rows need.
        free, owner = self.library.fx_free_rows, self._structs
        self._rows = self.ffi.gc(self.c.system.changing, lambda rows, owner=owner: free(rows))

    def _factors_of(self, indptr: np.ndarray, indices: np.ndarray) -> Factors:
        reduction, order = self.model.reduction, np.arange(len(indptr) - 1)
        if self._forces_only:
            return Factors(order, np.arange(len(indices)), 0, 0)
        couplings, members = self.model.couplings, self.model.points.members is not None
        # Rows of unknowns that close loops are no forces, by which errors are judged.
        keep = not (couplings.closures or couplings.auxiliaries or (members and couplings.sliding))
        keep = keep and not self._inside
        # In statics the signs of pivots tell modes.
        sparse = members or self._inside or self.model.scheme.rates.at_rest
        behind = reduction.dependent, reduction.forces
        parts = self._is_large and not self._inside
        symmetric = (
            self.model.scheme.rates.at_rest
            and self.model.has_potential
            and not (self._rates or members or couplings.closures or couplings.auxiliaries)
            and not couplings.sliding
        )
        return factors_of(indptr, indices, *behind, keep, sparse, COSTS, parts, symmetric)

    def keep_joint_forces(self) -> None:
        """Find forces of joints in each step, whether it is recorded or not."""
        self.c.run.keeps_joint_forces = True

    def set_load_steps(
        self, frame: TurningFrame | None, hold: np.ndarray, predicted: np.ndarray
    ) -> np.ndarray:
        """Let C read forces that `hold` the unknowns, and write the first correction of a step.

        In a frame that turns or None. Returns the weights (size,) of a viscous drag on increments,
        zero where nothing acts.
        """
        model, diagonal = self.model, self.model.masses.diagonal
        weights = np.where(model.used_entries()[diagonal], model.unit**-2.0, 0.0)
        table = {"viscous_weight": weights, "diagonal_at": self._stored_at[diagonal]}
        self._set(statics=table | {"hold": hold}, newton={"predicted": predicted})
        self.set_frame(frame)
        return weights

    def set_holds(self) -> None:
        """Let derivatives by the forces that hold the unknowns be found."""
        columns, dofs, _, _ = self.model.couplings.free_columns
        first = np.zeros(self.model.reduction.free, int)
        first[columns[::-1]] = dofs[::-1]
        self._set(statics={"hold_dof": first, "holds": len(first)})

    def set_frame(self, frame: TurningFrame | None) -> None:
        """Let C read a frame that turns, or None."""
        if frame is not None:
            arm = frame.arms(np.zeros(self.model.size))
            self._set(frame={"arm": arm, "spin_squared": frame.spin**2})

    def results(self, **sizes: int) -> Iterator[np.ndarray]:
        """What C has found in the last step: members of ``Results`` of c/problem.h, with sizes."""
        of_step = self.library.fx_results(self.c)
        return (array_at(self.ffi, getattr(of_step, name), n) for name, n in sizes.items())

    def given(self) -> Iterator[np.ndarray]:
        """What of a step is set here: dead forces at its level, their mean, strains at the end."""
        n, natural = self.model.size, self.model.natural
        return self.results(force=n, dead=n, natural_end=natural.size if natural else 0)

    def border(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What borders the last tangent (n, n): columns (n, m), rows (m, n), and corner (m, m).

        With unknowns in their order in the tangent.
        """
        p, results = self.c, self.library.fx_results(self.c)
        m, positions, array = (
            p.border.rows,
            p.system.positions,
            functools.partial(array_at, self.ffi),
        )
        order, corner = array(p.system.order, n), array(results.corner, m, m)
        block = array(results.block, positions, p.border.block)[order, :m]
        reached = array(results.reached, positions)[order]
        rows = array(results.border, m, positions)[:, order]
        first, last = array(results.crossed, m, 2, 1).swapaxes(0, 1)
        crossed = (first <= order) & (order <= last)
        return np.where(reached[:, None] != 0, block, 0.0), np.where(crossed, rows, 0.0), corner

    def transposed(self) -> np.ndarray:
        """Storage index of each entry of the tangent in its transpose, among sparse factors.

        Of a chain or a band it is that of each stored value.
        """
        indptr, indices = self.model.reduction.tangent.pattern
        n = len(indptr) - 1
        numbered = scipy.sparse.csr_matrix((np.arange(len(indices)), indices, indptr), (n, n))
        turned = numbered.T.tocsr()
        turned.sort_indices()
        places = np.empty(len(indices), dtype=int)
        places[turned.data] = self._factors_of(turned.indptr, turned.indices).at
        if not self.factors.band:
            return places
        stored = np.arange(self.c.tangent.stored)
        stored[self.factors.at] = places
        stored[places] = self.factors.at
        return stored

    def _set_motors(self) -> None:
        prescribed, motors = [*self.model.prescribed], self.model.motors
        self._set(
            motors={
                "prescribed": len(prescribed),
                "a": [-1] * len(prescribed) + [rotation_of(joint.a) for joint, _ in motors],
                "b": prescribed + [rotation_of(joint.b) for joint, _ in motors],
                "slides": [0] * len(prescribed) + [name == "slide" for _, name in motors],
            }
        )

    def _set_joint_forces(self) -> None:
        """How forces on nodes pass through joints of trees, from the leaves to the roots.

        The force of a joint on b is the sum of those on all nodes that follow through it.
        """
        couplings = self.model.couplings
        sums: list[tuple[int, ...]] = []
        for i in range(3):
            if i == 2:
                self._set(passes={"of_forces": len(sums)})
            for branch in reversed(couplings.forests[i]):
                parent_dof = 3 * branch.parent + i if branch.parent >= 0 else -1
                sums.append(
                    (3 * branch.node + i, parent_dof, 3 * branch.joint.number + i, int(branch.sign))
                )
            for joint in couplings.sliding:
                if i < len(couplings.carried[joint.number]):
                    sums.append((3 * joint.b.number + i, -1, 3 * joint.number + i, 1))
        columns = np.array(sums, dtype=int).reshape(-1, 4).T
        tables = dict(zip(("dof", "to", "of", "sign"), columns, strict=True))
        joints = self.model.scene.joint_count
        self._set(passes={"joints": joints, "count": len(sums), **tables})

    def _allocate(self) -> None:
        model = self.model
        #: The state, its past and its local errors.
        self.state = StateVector(model, self.c, self.ffi, self.library)
        self._set(**self.state.members)
        #: First configuration with inverted sections.
        self.inverted_q = np.zeros(model.size)
        switches = sum(model.points.switch_counts)
        #: Values of the switches at both ends of a sub-step.
        self.sides = np.zeros((2, switches))
        self._set(inverted={"q": self.inverted_q})
        self._set(control={"switches": switches, "sides": self.sides})
        #: Work space of C.
        self.scratch = aligned_zeros(self.library.fx_scratch(self.c))
        self._set(run={"scratch": self.scratch})
        #: What steps by the factors of earlier ones depend on, beside the state.
        self.work = [self.scratch, self._sparse_factors]
        self.state.clear()
