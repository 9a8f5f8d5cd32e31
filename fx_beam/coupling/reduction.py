"""From all degrees of freedom to the unknowns: joints in C, the maps T and Tv, tangents."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse import csr_matrix

from fx_beam import c_library
from fx_beam.c_library import Structs, array_at
from fx_beam.content_cache import cached_by_content, cached_property, shallow_copy
from fx_beam.fem.forms import Arm
from fx_beam.fem.mesh import Pattern, rotation_of, sparsity
from fx_beam.fem.point_forces import CompiledPoints
from fx_beam.laws.rates import UpdateRule
from fx_beam.results.state import MACROS
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene

from .graph import Auxiliaries, Couplings, Entries, joined

if TYPE_CHECKING:
    from .dependent_columns import ColumnMap, Loops, Slide, Sliders


# -- How the reduced tangent is made of the full one --------------------------------------------


class ReducedTangent(NamedTuple):
    """How the reduced tangent is made of the full one, by the names in c/tables.h."""

    #: Sparsity (indptr, indices) of the linear system, in compressed rows; nodes that slide on
    #: beams border it.
    pattern: Pattern
    #: Entries of K that are added as they are.
    direct: dict[str, np.ndarray]
    #: Products Tv K T. From the number `stiffened` on K is the stiffness of closures, then 1, for
    #: auxiliary unknowns and closures: both entries are behind the full tangent.
    coupled: dict[str, np.ndarray]
    #: Derivatives of Tv.
    geometric: dict[str, np.ndarray]
    #: Derivatives of the forces of springs and dampers on slides.
    restoring: dict[str, np.ndarray]
    stiffened: int
    #: Positions of entries of auxiliary unknowns that are 1.
    ones: np.ndarray


def reduced_tangent(
    couplings: Couplings,
    auxiliaries: Auxiliaries,
    sliders: Sliders | None,
    loops: Loops | None,
    sprung_columns: np.ndarray,
    matrix: csr_matrix,
    used: np.ndarray,
) -> ReducedTangent:
    """Positions of all products Tv[i, a] K[i, j] T[j, b] in the reduced tangent.

    `matrix` has the sparsity of K, of which some entries are `used`; `sprung_columns` are those of
    slides with forces.
    """
    free, arm_joints = couplings.free, couplings.arm_joints
    slide_columns = columns_of_slides(couplings)
    row_of, unknown_of = couplings.system
    geometric = []
    for m, joint in enumerate(arm_joints):
        turn = [] if joint.a is GROUND else couplings.entries(rotation_of(joint.a))
        turn = [e for e in turn if unknown_of[e[0]] >= 0]
        slide = [(slide_columns[m], 0, 1.0)] if 0 <= slide_columns[m] < free else []
        pairs_of_kinds = (turn, turn), (turn, slide), (slide, turn), (slide, slide)
        for kind, (maps, values) in enumerate(pairs_of_kinds[: 4 if joint.track.number else 3]):
            geometric += [(a, b, m, kind, s * o) for a, _, s in maps for b, _, o in values]
    terms = [term for gear in couplings.gears for term in gear.terms]
    for m, term in enumerate(terms, start=len(arm_joints)):
        ends = enumerate((term.joint.b, term.joint.a) if term.name == "rotation" else ())
        turns = [
            (column, end, sign)
            for end, node in ends
            if node is not GROUND
            for column, _, sign in couplings.entries(rotation_of(node))
            if unknown_of[column] >= 0
        ]
        geometric += [
            (a, b, m, end, (2 * e - 1) * s * o)
            for (a, e, s), (b, end, o) in itertools.product(turns, turns)
        ]
    #: Slides with forces that are unknowns, among all with forces.
    sprung = np.flatnonzero(unknown_of[sprung_columns] >= 0)
    restoring = [(c, c) for c in sprung_columns[sprung].tolist()]

    entries, moves = couplings.all_entries, unknown_of[couplings.all_entries.column] >= 0
    source, i, j = _products(entries.row, moves, used, matrix.indptr, matrix.indices)
    full_count = len(source)
    added, forces = [auxiliaries.system_entries], np.empty(0, dtype=int)
    if loops is not None:
        added = [loops.system_entries, *added]
        forces = couplings.unknown_count - len(loops) + loops.carried
        left, right = loops.stiffened()
        added_numbers = len(entries.row) + np.arange(len(left.row))
        i = np.append(i, added_numbers)
        j = np.append(j, added_numbers + len(added_numbers))
        source = np.append(source, np.full(len(added_numbers), matrix.nnz + 1, np.int32))
        entries = Entries(*map(np.concatenate, zip(entries, left, right, strict=True)))
    extra = np.array([p[:2] for p in (*geometric, *restoring)], dtype=int).reshape(-1, 2).T
    rows = [row_of[entries.column][i], row_of[extra[0]], *(part.rows for part in added)]
    columns = [unknown_of[entries.column][j], unknown_of[extra[1]], *(p.columns for p in added)]
    row, column = np.concatenate(rows), np.concatenate(columns)
    del rows, columns  # of large scenes
    if sliders is None or not couplings.sliding:
        pattern, position = sparsity(row, column, couplings.unknown_count)
    else:
        position = sliders.set_tangent(row, column, forces)
        pattern = sliders.bordered.pattern
    factors = joined(*(part.factors for part in added))
    counts = len(source), len(geometric), len(restoring), len(factors["sign"])
    position, *small_parts = np.split(position, np.cumsum(counts))
    geometric_to, restoring_to, add_to, ones = map(np.copy, small_parts)  # the large one goes
    constant, sign = entries.value_at == 0, entries.sign
    direct = constant[i] & constant[j] & (sign[i] * sign[j] == 1) & (source < matrix.nnz)
    other_products = np.flatnonzero(~direct)
    i, j = i[other_products], j[other_products]
    names = "to", "from", "virtual", "value", "sign"
    coupled = (
        *(position[other_products], source[other_products]),
        *(entries.value_at[i], entries.value_at[j], sign[i] * sign[j]),
    )
    factors |= {"to": add_to, "from": np.full(len(add_to), matrix.nnz)}
    table = np.array([(m, kind, sign) for _, _, m, kind, sign in geometric]).reshape(-1, 3)
    joint_and_kind = dict(zip(("joint", "kind"), table[:, :2].T.astype(int), strict=True))
    return ReducedTangent(
        pattern,
        direct={"to": position[direct], "from": source[direct]},
        coupled=joined(dict(zip(names, coupled, strict=True)), factors),
        geometric={"to": geometric_to, **joint_and_kind, "sign": table[:, 2]},
        restoring={"to": restoring_to, "of": sprung},
        stiffened=np.count_nonzero(~direct[:full_count]),
        ones=ones,
    )


def columns_of_slides(couplings: Couplings) -> np.ndarray:
    """Column of the slide of each joint that moves; -1 for none."""
    numbers = (couplings.slides.get(joint.number, -1) for joint in couplings.arm_joints)
    return np.array([*numbers], dtype=int)


@cached_by_content
def runs_of(column: np.ndarray) -> dict[str, Any]:
    """Runs of entries whose columns follow each other, by the names in c/tables.h.

    None if they are short.
    """
    starts = np.flatnonzero(np.diff(column, prepend=-2, append=-2) != 1)
    if 8 * len(starts) > len(column):
        return {}
    return {"runs": len(starts) - 1, "run_start": starts, "run_column": column[starts[:-1]]}


def _products(
    row: np.ndarray, moves: np.ndarray, used: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of K, and entries of Tv and T by which they are multiplied, of all products Tv K T.

    `row` and `moves`: rows of the entries of Tv, and whether they have an unknown. `used`, `indptr`
    and `indices`: used entries of K, and its compressed rows.
    """
    moving, size = np.flatnonzero(moves).astype(np.int32), len(indptr) - 1
    count = np.bincount(row[moving], minlength=size).astype(np.int32)
    first = np.cumsum(count, dtype=np.int32) - count
    rows = np.repeat(np.arange(size, dtype=np.int32), np.diff(indptr))
    products = count[rows] * count[indices] * used
    if (count <= 1).all():  # each at most one product
        source = np.flatnonzero(products).astype(np.int32)
        return source, moving[first[rows[source]]], moving[first[indices[source]]]
    source = np.repeat(np.arange(len(indices), dtype=np.int32), products)
    begin = np.cumsum(products, dtype=np.int32) - products
    number = np.arange(len(source), dtype=np.int32) - np.repeat(begin, products)
    i, j = rows[source], indices[source]
    left, right = first[i] + number // count[j], first[j] + number % count[j]
    return source, moving[left], moving[right]


# -- Joints and gears as C has them: tables, numbers, and a configuration -----------------------


# What evaluates joints, and the flags of its compiler.
_LIBRARY = "joints", "joints.c"
_FLAGS = "-O1", c_library.WHOLE_PROGRAM


class JointsInC:
    """The joints of a scene with `size` degrees of freedom, in C."""

    def __init__(
        self,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        sliders: Sliders | None,
        loops: Loops | None,
        rates: UpdateRule,
        size: int,
    ):
        self.couplings, self.auxiliaries, self.sliders = couplings, auxiliaries, sliders
        self.loops, self.size, self._rates = loops, size, rates
        #: Offsets and axes (2, joints, 2) of `Couplings.arm_joints`.
        self.arms = np.zeros((2, len(couplings.arm_joints), 2))
        #: Weights of both terms of gears, and their sums at rest (gears, 3).
        self.gears = np.zeros((len(couplings.gears), 3))
        #: Tables by the names in c/tables.h, without positions in the tangent.
        self.members = self._tables()

    def set_numbers(self, arms: dict[int, Arm], gears: Sequence[Sequence[float]]) -> None:
        """Set offsets and axes of joints, and the numbers of gears."""
        offset, axis = self.arms
        for m, joint in enumerate(self.couplings.arm_joints):
            arm = arms[joint.number]
            offset[m], axis[m] = arm.offset, arm.axis or (0.0, 0.0)
        for gear_numbers, numbers in zip(self.gears, gears, strict=True):
            gear_numbers[:] = numbers

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Offsets and axes of joints that move, and gears, by the names in c/numbers.h."""
        return {"offset": self.arms[0], "axis": self.arms[1], "gears": self.gears}

    def _tables(self) -> dict[str, Any]:
        """The couplings by the names in c/tables.h, without positions in the tangent."""
        couplings, arm_joints = self.couplings, self.couplings.arm_joints
        entries = couplings.all_entries
        # Rows that follow through joint m: in x as 2 m, in y as 2 m + 1.
        followers, arm_numbers = entries.arms
        equal = (entries.value_at == 0) & (entries.sign == 1)
        if not equal.all():
            entries = entries.take(np.argsort(~equal, kind="stable"))
        ends = [[rotation_of(node) for node in (joint.a, joint.b)] for joint in arm_joints]
        carrier, carried = np.array(ends, dtype=int).reshape(-1, 2).T
        return {
            "dofs": self.size,
            "columns": couplings.columns,
            "free": couplings.free,
            "driven": couplings.driven,
            "map": {
                "count": len(equal),
                "equal": np.count_nonzero(equal),
                "row": entries.row,
                **entries.members(),
                **runs_of(entries.column),
            },
            "joints": {
                "count": len(arm_joints),
                "sign": couplings.sign[:2, [joint.number for joint in arm_joints]].T,
                "carrier": carrier,
                "carried_node": carried,
                "slide_column": columns_of_slides(couplings),
                "number": np.array([joint.number for joint in arm_joints], dtype=int),
                "track": np.array([joint.track.number for joint in arm_joints], dtype=int),
                "followers": len(followers),
                "follower": followers,
                "through": arm_numbers,
            },
            "auxiliary": self.auxiliaries.members(),
            "loops": {} if self.loops is None else self.loops.members(),
            "gears": {} if self.loops is None else self.loops.gear_members(),
        }

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        structs: list[Any] = []
        arrays = [self.arms, self.gears]
        if not self.couplings.is_selection:
            own_structs, own_arrays = self.configuration.memory
            structs, arrays = structs + own_structs, arrays + own_arrays
        return structs, arrays

    def in_block(self, block: Any) -> JointsInC:
        """Joints whose numbers and configuration are in the block of a run."""
        other = shallow_copy(self)
        other.arms, other.gears = block.view(self.arms), block.view(self.gears)
        if "configuration" in self.__dict__:
            other.configuration = self.configuration.in_block(block)
        return other

    @cached_property
    def configuration(self) -> Configuration:
        """Joints in C."""
        slides = self.sliders.all if self.sliders else []
        scheme = {"level": self._rates.level, **self._rates.constants}
        members = self.members | {"scheme": scheme, "sliders": {"count": len(slides)}}
        return Configuration(members, self.numbers, self.couplings.sign.shape[1], slides)

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        unknowns = np.arange(self.couplings.free)
        return unknowns if self.loops is None else np.setdiff1d(unknowns, self.following)

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        if self.loops is None:
            return np.empty(0, dtype=int)
        return self.loops.columns[self.configuration.following]


def numbers_of_gears(scene: Scene) -> list[list[Any]]:
    """Weights and sum at rest of each gear that is a relation, with slopes."""
    ideal = [gear for gear in scene.gears if gear.is_ideal]
    return [[*(term.weight for term in gear.terms), gear.rest] for gear in ideal]


def begin_to_build_joints() -> None:
    """Compile what evaluates joints beside all else, if the cache lacks it."""
    c_library.begin_to_build(*_LIBRARY, MACROS, _FLAGS)


class Configuration:
    """Joints at one configuration, in C: increments in a step, and the values of T and Tv.

    `members` are named as in ``Tables`` of C (c/tables.h), `numbers` as in ``Numbers``.
    """

    def __init__(
        self,
        members: dict[str, Any],
        numbers: dict[str, np.ndarray],
        joints: int,
        slides: Sequence[Slide],
    ):
        ffi, self._library = c_library.open_library(*_LIBRARY, "problem.h", MACROS, (), _FLAGS)
        self._structs, self._slides = Structs(ffi), slides
        self._c, self._ffi = ffi.new("Problem *"), ffi
        size, columns = members["dofs"], members["columns"] + members["auxiliary"]["count"]
        self._state = np.zeros(size), np.zeros(joints)
        state = dict(zip(("q", "slides"), self._state, strict=True))
        values = 1 + 4 * members["joints"]["count"] + members["gears"].get("count", 0)
        self.following = np.zeros(members["loops"].get("closures", 0), np.int32)
        sliders = [slide.members() for slide in slides]
        work = {"state": state, "slider": sliders, "following": self.following}
        points: dict[str, Any] = {"points": [{}]}
        self._structs.set(self._c, tables=[members], numbers=numbers | points, work=work)
        self._scratch = np.zeros(self._library.fx_lay_out(self._c, ffi.NULL))
        self._library.fx_lay_out(self._c, ffi.from_buffer("double[]", self._scratch))
        w, array = self._c.work, functools.partial(array_at, ffi)
        #: Increments of nodes and columns; the values of T and Tv; closures.
        self.D, self.z = array(w.D, size), array(w.z, columns)
        self.values = array(w.values, values), array(w.virtual_map, values)
        self.closure = array(w.closure, len(self.following))

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        structs, count = [self._c], len(self._slides)
        if count:
            structs.append(self._ffi.cast(f"Slider(*)[{count}]", self._c.work.slider)[0])
        return structs, [*self._state, self._scratch, self.following]

    def in_block(self, block: Any) -> Configuration:
        """The configuration of a run."""
        other = shallow_copy(self)
        other._c = block.struct(self._ffi, self._c)
        other._state = tuple(map(block.view, self._state))
        other.D, other.z = block.view(self.D), block.view(self.z)
        other.values = tuple(map(block.view, self.values))
        other.closure, other.following = block.view(self.closure), block.view(self.following)
        return other

    def set_start(self, q: np.ndarray, slides: np.ndarray) -> bool:
        """Set the start: displacements and rotations, and slides; False in a singular position."""
        self._state[0][:], self._state[1][:] = q, slides
        return bool(self._library.fx_begin_joints(self._c))

    def expand(self, y: np.ndarray, driven: np.ndarray, close: bool) -> bool:
        """Find D for increments of unknowns and driven columns; False if loops do not close.

        With `close` the unknowns that close loops are corrected in y.
        """
        free = len(y)
        self.z[:free], self.z[free : free + len(driven)] = y, driven
        closed = bool(self._library.fx_expand(self._c, close))
        y[:] = self.z[:free]
        return closed

    def relations(self, virtual: bool) -> tuple[np.ndarray, np.ndarray]:
        """Rows (nodes on beams, 3, ...) of T or Tv, and where their windows begin (nodes,)."""
        ffi, sliders, count = self._ffi, self._c.work.slider, len(self._slides)
        size, columns = ffi.sizeof("Slider"), ffi.sizeof(sliders[0].T) // 24
        memory, place = ffi.buffer(sliders, count * size), functools.partial(ffi.offsetof, "Slider")
        start, steps = place("virtual_map" if virtual else "T"), (size, 8 * columns, 8)
        rows: np.ndarray = np.ndarray((count, 3, columns), float, memory, start, steps)
        return rows, np.ndarray(count, np.int32, memory, place("first"), (size,))

    @property
    def arcs(self) -> list[tuple[float, float]]:
        """Arc lengths of nodes on beams at both ends of the step [m]."""
        return [(c.s0, c.s1) for c in (self._c.work.slider[i] for i in range(len(self._slides)))]


# -- Small changes through joints: the maps T and Tv at one configuration, and their transposes -


# Up to so many columns of nodes on beams, what they depend on is an array: it takes less time.
_FEW = 100


class JointMaps:
    """T and Tv at the last configuration of joints, from columns z to degrees of freedom."""

    def __init__(self, joints: JointsInC, compiled_points: CompiledPoints):
        self._joints, self._compiled_points = joints, compiled_points
        columns = joints.couplings.columns + len(joints.auxiliaries)
        self._shape, self._columns = (joints.size, columns), joints.couplings.columns
        self._entries = joints.couplings.all_entries
        self._maps: dict[Any, Any] = {}

    def on(self, joints: JointsInC, compiled_points: CompiledPoints) -> JointMaps:
        """The maps of joints of another scene with this structure."""
        other = shallow_copy(self)
        other._joints, other._compiled_points, other._maps = joints, compiled_points, {}
        return other

    def forget(self) -> None:
        """Take another configuration."""
        self._maps = {}

    def _values(self, virtual: bool) -> np.ndarray:
        selects = self._joints.couplings.is_selection
        return np.ones(1) if selects else self._joints.configuration.values[virtual]

    def _map(self, virtual: bool, auxiliaries: bool = True, closed: bool = True) -> ColumnMap:
        """T or Tv, with dependent columns of what slides, `auxiliaries`, and of `closed` loops."""
        if (key := (virtual, auxiliaries, closed)) not in self._maps:
            from .dependent_columns import ColumnMap

            values = self._values(virtual)
            dependence = self._dependence(values, virtual, auxiliaries, closed)
            others = auxiliaries and len(self._joints.auxiliaries)
            nested = not (others or (closed and self._joints.loops))
            weights = self._entries.weights(values)
            self._maps[key] = ColumnMap(weights, self._shape, *dependence, nested=nested)
        return self._maps[key]

    def _dependence(
        self, values: np.ndarray, virtual: bool, auxiliaries: bool, closed: bool
    ) -> tuple[csr_matrix | np.ndarray, np.ndarray]:
        """C (dependent, columns) with C z = 0, and the numbers of the dependent columns."""
        columns, dependent = self._shape[1], [np.empty(0, int)]
        row, column, weights = np.empty(0, int), np.empty(0, int), np.empty(0)
        if self._joints.sliders and self._joints.sliders.all:
            relations = self._joints.configuration.relations(virtual)
            equations = self._joints.sliders.equations
            row, column, weights = equations.entries(*relations, values)
            dependent = [equations.columns]
        size = len(dependent[0])
        has_auxiliaries = auxiliaries and len(self._joints.auxiliaries)
        if not has_auxiliaries and size <= _FEW:
            C = np.bincount(row * columns + column, weights, size * columns)
            rows: list[Any] = [C.reshape(size, columns)]
        else:
            rows = [csr_matrix((weights, (row, column)), (size, columns))]
        if has_auxiliaries:
            rows.insert(0, self._joints.auxiliaries.equations(values))
            dependent.insert(0, np.arange(self._columns, columns))
        if closed and self._joints.loops is not None:
            rows.append(self._joints.loops.derivatives(values))
            dependent.append(self._joints.following)
        if all(isinstance(block, np.ndarray) for block in rows):
            return np.concatenate(rows), np.concatenate(dependent)
        C = scipy.sparse.vstack([csr_matrix(block) for block in rows], "csr")
        return C, np.concatenate(dependent)

    @property
    def column_map(self) -> ColumnMap:
        """T, with auxiliary unknowns, at this configuration."""
        return self._map(False)

    def closure_derivatives(self) -> csr_matrix:
        """Derivatives (closures, unknowns) of closures [m] by units of the loops' unknowns."""
        from .dependent_columns import without_dependent

        assert (loops := self._joints.loops) is not None
        C, dependent = self._dependence(values := self._values(False), False, True, False)
        equations = csr_matrix(C), dependent
        G = without_dependent(loops.derivatives(values), *equations)[0][:, loops.unknowns]
        unit = scipy.sparse.diags(loops.unit[loops.unknowns])
        return (scipy.sparse.diags(loops.lengths) @ G @ unit).tocsr()

    def dependence_matrix(self) -> csr_matrix:
        """Matrix (columns, columns) from rates of independent columns to rates of all."""
        return self._map(False).dependence_matrix[: self._columns, : self._columns]

    def _with_auxiliaries(self, z: np.ndarray) -> np.ndarray:
        return np.append(z, np.zeros(extra)) if (extra := len(self._joints.auxiliaries)) else z

    def with_dependent(self, z: np.ndarray) -> np.ndarray:
        """Rates of all columns from z with rates of independent columns: dependence_matrix() z."""
        if self._joints.couplings.is_selection:
            return z
        return self._map(False).with_dependent(self._with_auxiliaries(z))[: self._columns]

    def to_nodes(self, z: np.ndarray) -> np.ndarray:
        """dq = T dz (size,), the small change of all degrees of freedom by all columns."""
        if self._joints.couplings.is_selection:
            return z[self._joints.couplings.column] + 0.0
        return self._map(False) @ self._with_auxiliaries(z)

    def motion(self, x: np.ndarray) -> np.ndarray:
        """Small change (size,) of all degrees of freedom by `independent` unknowns."""
        z = np.zeros(self._columns)
        z[self._joints.independent] = x
        return self.to_nodes(z)

    def coupling(self, closed: bool = True, virtual: bool = False) -> csr_matrix:
        """T (size, columns), or with `virtual` Tv; loops follow the unknowns if `closed`."""
        T = self._map(virtual, closed=closed).matrix
        return T[:, : self._columns] if len(self._joints.auxiliaries) else T

    def coupling_array(self, closed: bool = True) -> np.ndarray:
        """T of a small scene, as an array."""
        return self._map(False, closed=closed).array[:, : self._columns]

    def transpose_to_nodes(self, r: np.ndarray) -> np.ndarray:
        """T^T r (columns,), without Tv and springs."""
        return self._map(False).transposed(r, np.zeros(self._shape[1]))[: self._columns]

    def reduced_force(self, r: np.ndarray) -> np.ndarray:
        """Tv^T r (columns,), with springs and dampers on slides."""
        compiled, slide_forces = self._compiled_points, np.zeros(self._shape[1])
        np.add.at(slide_forces, compiled.points.columns, compiled.on_slides(0))
        return self._map(True).transposed(r, slide_forces)[: self._columns]

    def moves(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) moves one of some degrees of freedom (size,), or a loop."""
        random = np.random.default_rng(0).random(self._shape[0]) * dofs  # which do not cancel
        moved = self._map(False, closed=False).transposed(random, np.zeros(self._shape[1]))
        moves = moved[: self._joints.couplings.free] != 0
        if self._joints.loops is not None:
            moves[self._joints.loops.unknowns] = True
        return moves

    def normal(self, weight: csr_matrix) -> csr_matrix:
        """T^T W T for a matrix W (size, size), as a system with the equations C z = 0.

        Its first unknowns x solve T^T W T x = b, if zeros follow b.
        """
        values = self._values(False)
        C = csr_matrix(self._dependence(values, False, True, True)[0])
        auxiliary = np.arange(self._columns, self._shape[1])
        moving = np.append(np.arange(self._joints.couplings.free), auxiliary)
        A, C = self._entries.matrix(values, self._shape)[:, moving], C[:, moving]
        return scipy.sparse.bmat([[A.T @ weight @ A, C.T], [C, None]], "csr")

    def reduced(self, matrix: csr_matrix) -> csr_matrix:
        """The part Tv^T A T of the linear system for a matrix A of any sparsity, without loops."""
        couplings = self._joints.couplings
        (row_of, unknown_of), n = couplings.system, couplings.unknown_count
        T, Tv = (self._map(virtual, False, False).matrix for virtual in (False, True))
        A = (Tv.T @ matrix @ T).tocoo()
        row, column = row_of[A.row], unknown_of[A.col]
        valid = (row >= 0) & (column >= 0) & (row < n) & (column < n)
        return csr_matrix((A.data[valid], (row[valid], column[valid])), (n, n))


def moves_alone(couplings: Couplings, dofs: np.ndarray) -> np.ndarray:
    """Whether each unknown (free,) equals one of some degrees of freedom (size,).

    So far as it is known: not in long trees, loops or on beams.
    """
    if couplings.auxiliaries or couplings.sliding:
        return np.zeros(couplings.free, dtype=bool)
    row, column, value_at, _ = couplings.all_entries
    alone = np.bincount(row, minlength=len(dofs)) == 1
    equal = column[alone[row] & dofs[row] & (value_at == 0)]
    return np.bincount(equal, minlength=couplings.columns)[: couplings.free] > 0


# -- From all degrees of freedom to the unknowns: supports, and joints without multipliers ------
# The nodal vector x is a function g of the columns z, unknowns first, with T = dg/dz. Virtual
# displacements are dx = Tv dz. Newton's method solves Tv^T r(g(z)) = 0; the tangent is Tv^T K T +
# (dTv/dz)^T r.


class Reduction:
    """Unknowns of a scene, and the reduction of vectors and matrices to them.

    `matrix` has the sparsity of the full tangent; entries that are not `used()` remain zero. In the
    linear system an auxiliary unknown is two unknowns, its displacement u and the force on what it
    follows, and a closure of a loop is one, its force.
    """

    #: Why no step can begin here; empty if it can.
    singularity = ""
    # The reduction of the program, which has the tables of the tangent for its runs.
    _pattern: Reduction | None = None

    def __init__(
        self,
        *,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        compiled_points: CompiledPoints,
        rates: UpdateRule,
        matrix: csr_matrix,
        used: Callable[[], np.ndarray],
        sliders: Sliders | None = None,
        loops: Loops | None = None,
    ):
        #: Nodes that slide on beams, where there are some or loops; else nothing asks for them.
        self.sliders: Any = sliders
        self.loops, self.couplings, self.auxiliaries = loops, couplings, auxiliaries
        #: Number of unknowns, of driven columns (prescribed, motors), and of all columns.
        self.free, self.driven = couplings.free, couplings.driven
        self.columns = couplings.columns
        #: For each force that closes a loop an unknown on which it acts. In C the forces are
        #: unknowns, too, behind all others.
        self.forces = np.empty(0, dtype=int) if loops is None else loops.acts_on
        self._compiled_points, self._matrix, self._used = compiled_points, matrix, used
        #: The joints in C.
        self.joints = JointsInC(couplings, auxiliaries, sliders, loops, rates, matrix.shape[0])
        #: Small changes at the last configuration.
        self.maps = JointMaps(self.joints, compiled_points)

    def in_block(self, block: Any, compiled_points: CompiledPoints) -> Reduction:
        """The reduction of a run, whose joints are in its block."""
        if self.couplings.is_selection and compiled_points is self._compiled_points:
            return self  # nothing of it changes
        other = shallow_copy(self)
        other._pattern, other._compiled_points, other.singularity = self, compiled_points, ""
        other.joints = self.joints.in_block(block)
        other.maps = self.maps.on(other.joints, compiled_points)
        return other

    @property
    def tangent(self) -> ReducedTangent:
        """How the reduced tangent is made of the full one."""
        return self._tangent if self._pattern is None else self._pattern.tangent

    @cached_property
    def _tangent(self) -> ReducedTangent:
        return reduced_tangent(
            *(self.couplings, self.auxiliaries, self.sliders, self.loops),
            *(self._compiled_points.points.columns, self._matrix, self._used()),
        )

    def forget_tangent(self) -> None:
        """Free the tables of the tangent of a large scene, which are found again if asked for."""
        self.__dict__.pop("_tangent", None)

    # -- A step -----------------------------------------------------------------------------------

    def set_start(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step, q and slides, and choose the unknowns that close loops."""
        if self.couplings.is_selection:
            return
        regular = self.joints.configuration.set_start(q, slides)
        self.singularity = "" if regular or self.loops is None else self.loops.singularity
        self.closures_at(np.zeros(self.free), np.zeros(self.driven))

    def in_columns(self, y: np.ndarray, driven: Any = ()) -> np.ndarray:
        """Increments (columns,) from y of the unknowns and from driven columns; else zero."""
        fixed = np.zeros(self.columns - self.free - len(driven))
        return np.concatenate([y, driven, fixed])

    def increment(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Increment (size,) of all degrees of freedom by unknowns y and driven columns: g.

        From now on T and Tv belong to this configuration. Unknowns that close loops are corrected
        in y; the increment is not finite if no correction closes them.
        """
        if self.couplings.is_selection:
            return self.in_columns(y, driven)[self.couplings.column]
        self.maps.forget()
        configuration = self.joints.configuration
        closed = configuration.expand(y, driven, True)
        self._compiled_points.evaluate_slides(configuration.z[: self.columns])
        return configuration.D.copy() if closed else np.full(self.joints.size, np.nan)

    def closures_at(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Closures (closures,) at increments of unknowns that need not close the loops [m]."""
        self.maps.forget()
        self.joints.configuration.expand(y, driven, False)
        return self.joints.configuration.closure

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        return self.joints.independent

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        return self.joints.following

    @property
    def closing(self) -> np.ndarray:
        """Unknowns (closures,) that close loops, in the order of the closures that they move most.

        The product of the derivatives of each closure by its unknown is as large as it can be.
        """
        followers = self.joints.configuration.following
        derivatives = abs(self.maps.closure_derivatives()[:, followers])
        derivatives.eliminate_zeros()
        # Weights that are zero count as entries that are not there.
        derivatives.data = 1 - np.log(derivatives.data / derivatives.data.max(initial=0.0))
        try:
            _, pairs = scipy.sparse.csgraph.min_weight_full_bipartite_matching(derivatives)
        except ValueError:  # no unknowns close all loops in a singular position
            return self.following
        return self.following[pairs]

    def fault(self, arcs: Sequence[tuple[float, float]] | None = None) -> tuple[str, str] | None:
        """Kind and reason of a step in which a node leaves the beam on which it slides; or None.

        `arcs` are the arc lengths of all nodes at both ends, by default of the last step.
        """
        if not self.couplings.sliding:
            return None
        return self.sliders.fault(self.joints.configuration.arcs if arcs is None else arcs)

    def reach(self, slides: np.ndarray, z: np.ndarray) -> float:
        """How often columns z can be added to `slides` before a node slides off its element."""
        return self.sliders.reach(slides, z) if self.sliders else np.inf
