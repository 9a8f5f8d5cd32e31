"""From all degrees of freedom to the unknowns: supports, and joints without multipliers.

The nodal vector x is a function g of the columns z, unknowns first, with T = dg/dz. Virtual
displacements are dx = Tv dz. Newton's method solves Tv^T r(g(z)) = 0; the
tangent is Tv^T K T + (dTv/dz)^T r.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam import c_library
from fx_beam.c_library import Structs, array_at
from fx_beam.content_cache import cached_by_content, cached_property
from fx_beam.fem.compiled_points import CompiledPoints
from fx_beam.fem.mesh import rotation_of
from fx_beam.fem.sparsity import Pattern, sparsity, starts_of
from fx_beam.laws.rates import UpdateRule
from fx_beam.results.state import MACROS
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene

from .graph import Auxiliaries, Couplings, Entries, joined

if TYPE_CHECKING:
    from .column_map import ColumnMap
    from .loops import Loops
    from .sliders import Slide, Sliders

# Up to so many columns of nodes on beams, what they depend on is an array: it takes less time.
_FEW = 100


class ReducedTangent(NamedTuple):
    """How the reduced tangent is made of the full one, by the names in c/problem.h."""

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


class Reduction:
    """Unknowns of a scene, and the reduction of vectors and matrices to them.

    `matrix` has the sparsity of the full tangent; entries that are not `used` remain zero. In the
    linear system an auxiliary unknown is two unknowns, its displacement u and the force on what it
    follows, and a closure of a loop is one, its force.
    """

    #: Why no step can begin here; empty if it can.
    singularity = ""

    def __init__(
        self,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        compiled_points: CompiledPoints,
        rates: UpdateRule,
        matrix,
        used: np.ndarray,
        sliders: Sliders | None = None,
        loops: Loops | None = None,
    ):
        #: Nodes that slide on beams, where there are some or loops; else nothing asks for them.
        self.sliders: Any = sliders
        self.loops, self.couplings = loops, couplings
        #: Number of unknowns, of driven columns (prescribed, motors), and of all columns.
        self.free, self.driven = couplings.free, couplings.driven
        self.columns = couplings.columns
        #: For each force that closes a loop an unknown on which it acts. In C the forces are
        #: unknowns, too, behind all others.
        self.forces = np.empty(0, dtype=int) if loops is None else loops.acts_on
        self.auxiliaries = auxiliaries
        self._rates, self._compiled_points, self._points = (
            rates,
            compiled_points,
            compiled_points.points,
        )
        #: Entries of the full tangent that may be other than zero.
        self.used = used
        self._size, self._full = matrix.shape[0], matrix
        self._shape = self._size, self.columns + len(auxiliaries)
        self._entries = couplings.all_entries
        arm_joints = couplings.arm_joints
        #: Offsets and axes (2, joints, 2) of `arm_joints`.
        self.arms = np.zeros((2, len(arm_joints), 2))
        self.set_arms(arm_joints)
        #: Weights of both terms of gears, and their sums at rest (gears, 3).
        self.gears = np.zeros((len(couplings.gears), 3))
        self._slide = np.array([couplings.slides.get(j.number, -1) for j in arm_joints], dtype=int)
        self._maps: dict[Any, Any] = {}

    def set_arms(self, arm_joints: Sequence[Joint]) -> None:
        """Set the joints that move, in the same order: their offsets and axes."""
        offset, axis = self.arms
        for m, joint in enumerate(arm_joints):
            offset[m], axis[m] = joint.offset, (0.0, 0.0) if joint.axis is None else joint.axis

    def set_gears(self, scene: Scene) -> None:
        """Set the numbers of the gears of a scene."""
        for gear_numbers, numbers in zip(self.gears, numbers_of_gears(scene), strict=True):
            gear_numbers[:] = numbers

    # -- The tangent ------------------------------------------------------------------------------

    @cached_property
    def tangent(self) -> ReducedTangent:
        """Positions of all products Tv[i, a] K[i, j] T[j, b] in the reduced tangent."""
        free, couplings, matrix, used = self.free, self.couplings, self._full, self.used
        row_of, unknown_of = couplings.system
        geometric = []
        for m, joint in enumerate(couplings.arm_joints):
            turn = [] if joint.a is GROUND else couplings.entries(rotation_of(joint.a))
            turn = [e for e in turn if unknown_of[e[0]] >= 0]
            slide = [(self._slide[m], 0, 1.0)] if 0 <= self._slide[m] < free else []
            pairs_of_kinds = (turn, turn), (turn, slide), (slide, turn), (slide, slide)
            for kind, (maps, values) in enumerate(pairs_of_kinds[: 4 if joint.track.number else 3]):
                geometric += [(a, b, m, kind, s * o) for a, _, s in maps for b, _, o in values]
        terms = [term for gear in couplings.gears for term in gear.terms]
        for m, term in enumerate(terms, start=len(couplings.arm_joints)):
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
        sprung = np.flatnonzero(unknown_of[self._points.columns] >= 0)
        restoring = [(c, c) for c in self._points.columns[sprung].tolist()]

        entries, moves = self._entries, unknown_of[self._entries.column] >= 0
        source, i, j = _products(entries.row, moves, used, matrix.indptr, matrix.indices)
        left, right, full_count = entries.take(i), entries.take(j), len(source)
        added, forces = [self.auxiliaries.in_system], np.empty(0, dtype=int)
        if self.loops is not None:
            added, forces = [self.loops.in_system, *added], self.loops.bordering
            halves = zip((left, right), self.loops.stiffened(), strict=True)
            left, right = (Entries(*map(np.append, *sides)) for sides in halves)
        source = np.append(source, np.full(len(left.row) - full_count, matrix.nnz + 1))
        extra = np.array([p[:2] for p in (*geometric, *restoring)], dtype=int).reshape(-1, 2).T
        rows = [row_of[left.column], row_of[extra[0]], *(part.rows for part in added)]
        columns = [unknown_of[right.column], unknown_of[extra[1]], *(p.columns for p in added)]
        pairs = np.concatenate(rows), np.concatenate(columns)
        if not couplings.sliding:
            pattern, position = sparsity(*pairs, couplings.unknown_count)
        else:
            position = self.sliders.set_tangent(*pairs, forces)
            pattern = self.sliders.bordered.pattern
        factors = joined(*(part.factors for part in added))
        counts = len(source), len(geometric), len(restoring), len(factors["sign"])
        position, geometric_to, restoring_to, add_to, one_to = np.split(position, np.cumsum(counts))
        virtual, value, sign = left.value_at, right.value_at, left.sign * right.sign
        direct = (virtual == 0) & (value == 0) & (sign == 1) & (source < matrix.nnz)
        names = "to", "from", "virtual", "value", "sign"
        coupled = (part[~direct] for part in (position, source, virtual, value, sign))
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
            ones=one_to,
        )

    @property
    def dependent(self) -> np.ndarray | None:
        """`Auxiliaries.dependent` (2, m); None without auxiliary unknowns."""
        return self.auxiliaries.dependent if len(self.auxiliaries) else None

    @property
    def offsets_and_axes(self) -> dict[str, np.ndarray]:
        """Offsets and axes of joints that move, by the names in c/problem.h."""
        return dict(zip(("offset", "axis"), self.arms, strict=True))

    @cached_property
    def members(self) -> dict[str, Any]:
        """The couplings by the names in c/problem.h, without positions in the tangent."""
        couplings, arm_joints = self.couplings, self.couplings.arm_joints
        equal = (self._entries.value_at == 0) & (self._entries.sign == 1)
        entries = self._entries.take(np.argsort(~equal, kind="stable"))
        ends = [[rotation_of(node) for node in (joint.a, joint.b)] for joint in arm_joints]
        carrier, carried = np.array(ends, dtype=int).reshape(-1, 2).T
        # Rows that follow through joint m: in x as 2 m, in y as 2 m + 1.
        below, through = self._entries.arms
        return {
            "dofs": self._size,
            "columns": self.columns,
            "free": self.free,
            "driven": self.driven,
            "map": {
                "count": len(equal),
                "equal": np.count_nonzero(equal),
                "row": entries.row,
                **entries.members(),
            },
            "joints": {
                "count": len(arm_joints),
                "sign": couplings.sign[:2, [joint.number for joint in arm_joints]].T,
                "carrier": carrier,
                "carried_node": carried,
                "slide_column": self._slide,
                "number": np.array([joint.number for joint in arm_joints], dtype=int),
                "track": np.array([joint.track.number for joint in arm_joints], dtype=int),
                "followers": len(below),
                "follower": below,
                "through": through,
                **self.offsets_and_axes,
            },
            "auxiliary": self.auxiliaries.members(),
            "loops": {} if self.loops is None else self.loops.members(),
            "gears": {} if self.loops is None else self.loops.gear_members(self.gears),
        }

    # -- A step -----------------------------------------------------------------------------------

    @cached_property
    def _configuration(self) -> Configuration:
        slides = self.sliders.all if self.sliders else []
        sliders = {"count": len(slides), "slider": [slide.members() for slide in slides]}
        scheme = {"level": self._rates.level, **self._rates.constants}
        members = self.members | {"scheme": scheme, "sliders": sliders}
        return Configuration(members, self.couplings.sign.shape[1], slides)

    def begin(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step, q and slides, and choose the unknowns that close loops."""
        if self.couplings.is_selection:
            return
        regular = self._configuration.begin(q, slides)
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
        closed = self._expand(y, driven, True)
        self._compiled_points.evaluate_slides(self._configuration.z[: self.columns])
        return self._configuration.D.copy() if closed else np.full(self._size, np.nan)

    def closures_at(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Closures (closures,) at increments of unknowns that need not close the loops [m]."""
        self._expand(y, driven, False)
        return self._configuration.closure

    def _expand(self, y: np.ndarray, driven: np.ndarray, close: bool) -> bool:
        self._maps = {}
        return self._configuration.expand(y, driven, close)

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        unknowns = np.arange(self.free)
        return unknowns if self.loops is None else np.setdiff1d(unknowns, self.following)

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        if self.loops is None:
            return np.empty(0, dtype=int)
        return self.loops.columns[self._configuration.following]

    def fault(self, arcs: Sequence[tuple[float, float]] | None = None) -> tuple[str, str] | None:
        """Kind and reason of a step in which a node leaves the beam on which it slides; or None.

        `arcs` are the arc lengths of all nodes at both ends, by default of the last step.
        """
        if not self.couplings.sliding:
            return None
        return self.sliders.fault(self._configuration.arcs if arcs is None else arcs)

    def reach(self, slides: np.ndarray, z: np.ndarray) -> float:
        """How often columns z can be added to `slides` before a node slides off its element."""
        return self.sliders.reach(slides, z) if self.sliders else np.inf

    # -- Small changes ----------------------------------------------------------------------------

    def _values(self, virtual: bool) -> np.ndarray:
        return np.ones(1) if self.couplings.is_selection else self._configuration.values[virtual]

    def _map(self, virtual: bool, auxiliaries: bool = True, closed: bool = True) -> ColumnMap:
        """T or Tv, with dependent columns of what slides, `auxiliaries`, and of `closed` loops."""
        if (key := (virtual, auxiliaries, closed)) not in self._maps:
            from .column_map import ColumnMap

            values = self._values(virtual)
            dependence = self._dependence(values, virtual, auxiliaries, closed)
            nested = not (auxiliaries and len(self.auxiliaries)) and not (closed and self.loops)
            weights = self._entries.weights(values)
            self._maps[key] = ColumnMap(weights, self._shape, *dependence, nested=nested)
        return self._maps[key]

    def _dependence(
        self, values: np.ndarray, virtual: bool, auxiliaries: bool, closed: bool
    ) -> tuple[scipy.sparse.csr_matrix | np.ndarray, np.ndarray]:
        """C (dependent, columns) with C z = 0, and the numbers of the dependent columns."""
        columns, slides = self._shape[1], self.sliders.all if self.sliders else []
        relations = self._configuration.relations(virtual) if slides else []
        dependent = [np.empty(0, int), *(slide.columns for slide in slides)]
        starts = starts_of([*map(len, dependent[1:])])
        parts = [(np.empty(0, int), np.empty(0, int), np.empty(0))]
        for slide, first_row, (relation, first) in zip(slides, starts, relations, strict=False):
            row, column, weights = slide.equations(relation, first, values)
            parts.append((first_row + row, column, weights))
        row, column, weights = map(np.concatenate, zip(*parts, strict=True))
        with_auxiliaries = auxiliaries and len(self.auxiliaries)
        if not with_auxiliaries and starts[-1] <= _FEW:
            of_slides = np.bincount(row * columns + column, weights, starts[-1] * columns)
            rows: list[Any] = [of_slides.reshape(starts[-1], columns)]
        else:
            rows = [scipy.sparse.csr_matrix((weights, (row, column)), (starts[-1], columns))]
        if with_auxiliaries:
            rows.insert(0, self.auxiliaries.equations(values))
            dependent.insert(0, np.arange(self.columns, columns))
        if closed and self.loops is not None:
            rows.append(self.loops.derivatives(values))
            dependent.append(self.following)
        if all(isinstance(block, np.ndarray) for block in rows):
            return np.concatenate(rows), np.concatenate(dependent)
        C = scipy.sparse.vstack([scipy.sparse.csr_matrix(block) for block in rows], "csr")
        return C, np.concatenate(dependent)

    @property
    def column_map(self) -> ColumnMap:
        """T, with auxiliary unknowns, at this configuration."""
        return self._map(False)

    def closure_derivatives(self) -> scipy.sparse.csr_matrix:
        """Derivatives (closures, unknowns) of closures [m] by units of the loops' unknowns."""
        from .column_map import without_dependent

        assert (loops := self.loops) is not None
        C, dependent = self._dependence(values := self._values(False), False, True, False)
        equations = scipy.sparse.csr_matrix(C), dependent
        G = without_dependent(loops.derivatives(values), *equations)[0][:, loops.unknowns]
        unit = scipy.sparse.diags(loops.unit[loops.unknowns])
        return (scipy.sparse.diags(loops.lengths) @ G @ unit).tocsr()

    def dependence_matrix(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) from rates of independent columns to rates of all."""
        return self._map(False).dependence_matrix[: self.columns, : self.columns]

    def _with_auxiliaries(self, z: np.ndarray) -> np.ndarray:
        return np.append(z, np.zeros(extra)) if (extra := len(self.auxiliaries)) else z

    def with_dependent(self, z: np.ndarray) -> np.ndarray:
        """Rates of all columns from z with rates of independent columns: dependence_matrix() z."""
        if self.couplings.is_selection:
            return z
        return self._map(False).with_dependent(self._with_auxiliaries(z))[: self.columns]

    def to_nodes(self, z: np.ndarray) -> np.ndarray:
        """dq = T dz (size,), the small change of all degrees of freedom by all columns."""
        if self.couplings.is_selection:
            return z[self.couplings.column] + 0.0
        return self._map(False) @ self._with_auxiliaries(z)

    def motion(self, x: np.ndarray) -> np.ndarray:
        """Small change (size,) of all degrees of freedom by `independent` unknowns."""
        z = np.zeros(self.columns)
        z[self.independent] = x
        return self.to_nodes(z)

    def coupling(self, closed: bool = True, virtual: bool = False) -> scipy.sparse.csr_matrix:
        """T (size, columns), or with `virtual` Tv; loops follow the unknowns if `closed`."""
        T = self._map(virtual, closed=closed).matrix
        return T[:, : self.columns] if len(self.auxiliaries) else T

    def coupling_array(self, closed: bool = True) -> np.ndarray:
        """T of a small scene, as an array."""
        return self._map(False, closed=closed).array[:, : self.columns]

    def transpose_to_nodes(self, r: np.ndarray) -> np.ndarray:
        """T^T r (columns,), without Tv and springs."""
        return self._map(False).transposed(r, np.zeros(self._shape[1]))[: self.columns]

    def reduced_force(self, r: np.ndarray) -> np.ndarray:
        """Tv^T r (columns,), with springs and dampers on slides."""
        on_slides = np.zeros(self._shape[1])
        np.add.at(on_slides, self._points.columns, self._compiled_points.on_slides(0))
        return self._map(True).transposed(r, on_slides)[: self.columns]

    def moves(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) moves one of some degrees of freedom (size,), or a loop."""
        random = np.random.default_rng(0).random(self._size) * dofs  # which do not cancel
        on_columns = self._map(False, closed=False).transposed(random, np.zeros(self._shape[1]))
        moves = on_columns[: self.free] != 0
        if self.loops is not None:
            moves[self.loops.unknowns] = True
        return moves

    def moves_alone(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) equals one of some degrees of freedom (size,).

        So far as it is known: not in long trees, loops or on beams.
        """
        if len(self.auxiliaries) or self.couplings.sliding:
            return np.zeros(self.free, dtype=bool)
        row, column, value_at, _ = self._entries
        alone = np.bincount(row, minlength=self._size) == 1
        equal = column[alone[row] & dofs[row] & (value_at == 0)]
        return np.bincount(equal, minlength=self.columns)[: self.free] > 0

    def normal(self, weight: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """T^T W T for a matrix W (size, size), as a system with the equations C z = 0.

        Its first unknowns x solve T^T W T x = b, if zeros follow b.
        """
        values = self._values(False)
        C = scipy.sparse.csr_matrix(self._dependence(values, False, True, True)[0])
        moving = np.append(np.arange(self.free), np.arange(self.columns, self._shape[1]))
        A, C = self._entries.matrix(values, self._shape)[:, moving], C[:, moving]
        return scipy.sparse.bmat([[A.T @ weight @ A, C.T], [C, None]], "csr")

    def reduced(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The part Tv^T A T of the linear system for a matrix A of any sparsity, without loops."""
        (row_of, unknown_of), n = self.couplings.system, self.couplings.unknown_count
        T, Tv = (self._map(virtual, False, False).matrix for virtual in (False, True))
        A = (Tv.T @ matrix @ T).tocoo()
        row, column = row_of[A.row], unknown_of[A.col]
        valid = (row >= 0) & (column >= 0) & (row < n) & (column < n)
        return scipy.sparse.csr_matrix((A.data[valid], (row[valid], column[valid])), (n, n))


def numbers_of_gears(scene: Scene) -> list[list[Any]]:
    """Weights and sum at rest of each gear that is a relation, with slopes."""
    ideal = [gear for gear in scene.gears if gear.is_ideal]
    return [[*(term.weight for term in gear.terms), gear.rest] for gear in ideal]


@cached_by_content
def _products(
    row: np.ndarray, moves: np.ndarray, used: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of K, and entries of Tv and T by which they are multiplied, of all products Tv K T.

    `row` and `moves`: rows of the entries of Tv, and whether they have an unknown. `used`, `indptr`
    and `indices`: used entries of K, and its compressed rows.
    """
    moving, size = np.flatnonzero(moves), len(indptr) - 1
    count = np.bincount(row[moving], minlength=size)
    first = np.cumsum(count) - count
    i, j = np.repeat(np.arange(size), np.diff(indptr)), indices
    products = count[i] * count[j] * used
    source = np.repeat(np.arange(len(j), dtype=np.int32), products)
    number = np.arange(len(source)) - np.repeat(np.cumsum(products) - products, products)
    i, j = i[source], j[source]
    left, right = first[i] + number // count[j], first[j] + number % count[j]
    return source, moving[left], moving[right]


# What evaluates joints, and the flags of its compiler.
_LIBRARY = "joints", "joints.c"
_FLAGS = "-O1", c_library.WHOLE_PROGRAM


def begin_to_build_joints() -> None:
    """Compile what evaluates joints beside all else, if the cache lacks it."""
    c_library.begin_to_build(*_LIBRARY, MACROS, _FLAGS)


class Configuration:
    """Joints at one configuration, in C: increments in a step, and the values of T and Tv.

    `members` are named as in ``Problem`` of c/problem.h.
    """

    def __init__(self, members: dict[str, Any], joints: int, slides: Sequence[Slide]):
        ffi, self._library = c_library.open_library(*_LIBRARY, "problem.h", MACROS, (), _FLAGS)
        self._structs, self._slides = Structs(ffi), slides
        self._c, self._ffi = ffi.new("Problem *"), ffi
        size, columns = members["dofs"], members["columns"] + members["auxiliary"]["count"]
        self._state = np.zeros(size), np.zeros(joints)
        state = dict(zip(("q", "slides"), self._state, strict=True))
        self._structs.set(self._c, **members, points=[{}], state=state)
        scratch = np.zeros(self._library.fx_scratch(self._c))
        self._structs.set(self._c, run={"scratch": scratch})
        results, array = self._library.fx_results(self._c), functools.partial(array_at, ffi)
        values = 1 + 4 * members["joints"]["count"] + members["gears"].get("count", 0)
        closures = members["loops"].get("closures", 0)
        #: Increments of nodes and columns; the values of T and Tv; closures.
        self.D, self.z = array(results.D, size), array(results.z, columns)
        self.values = array(results.values, values), array(results.virtual_map, values)
        self.closure = array(results.closure, closures)
        self.following = array(self._c.loops.following, closures)

    def begin(self, q: np.ndarray, slides: np.ndarray) -> bool:
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

    def relations(self, virtual: bool) -> Iterator[tuple[np.ndarray, int]]:
        """For each node on a beam the columns of T, or Tv, and where its window begins."""
        for i, slide in enumerate(self._slides):
            c = self._c.sliders.slider[i]
            rows = np.frombuffer(self._ffi.buffer(c.virtual_map if virtual else c.T)).reshape(3, -1)
            width, components = slide.path.width, len(slide.columns)
            yield rows[:components, [*range(components * width), -1]], c.first

    @property
    def arcs(self) -> list[tuple[float, float]]:
        """Arc lengths of nodes on beams at both ends of the step [m]."""
        return [(c.s0, c.s1) for c in (self._c.sliders.slider[i] for i in range(len(self._slides)))]
