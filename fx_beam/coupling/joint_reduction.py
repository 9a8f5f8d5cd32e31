"""From all degrees of freedom to the unknowns: supports, and joints without multipliers.

The nodal vector x is a function g of the columns z, unknowns first, with T = dg/dz. Virtual
displacements are Tv times those of the columns (`virtual_map`). Newton's method solves
Tv^T r(g(z)) = 0; the tangent is Tv^T K T + (dTv/dz)^T r.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_by_content
from fx_beam.fem.point_forces import PointForces
from fx_beam.laws.rates import UpdateRule
from fx_beam.scene.joints import Joint

from .auxiliaries import Auxiliaries
from .graph import Couplings
from .sliders import Slide, Sliders
from .tables import LoopTables, Tables, sparsity

# Signs of the components of W a, exchanged.
_QUARTER_TURN = np.array([-1.0, 1.0])


class _Tangent(NamedTuple):
    """How the reduced tangent is made of the full one: parts of `Tables`."""

    #: Sparsity of open loops, without what slides.
    pattern: tuple[np.ndarray, np.ndarray]
    direct: dict[str, np.ndarray]
    coupled: dict[str, np.ndarray]
    geometric: dict[str, np.ndarray]
    restoring: dict[str, np.ndarray]
    #: Positions of the entries of auxiliary unknowns.
    auxiliary_to: np.ndarray


class JointReduction:
    """Unknowns of a scene without closed loops, and the reduction of vectors and matrices to them.

    `matrix` has the sparsity of the full tangent; those of its entries that are not `used` remain
    zero. In the linear system each auxiliary unknown has two unknowns,
    its displacement u and the force on what it follows. Their rows are the auxiliary unknown's
    equation, and the balance of u.
    """

    #: Why no step can begin here; empty if it can.
    singularity = ""
    #: Number of forces that close loops, which are unknowns of the compiled loop behind the others.
    forces = 0

    def __init__(
        self,
        couplings: Couplings,
        points: PointForces,
        rates: UpdateRule,
        dofs: np.ndarray,
        matrix,
        used: np.ndarray,
        sliders: Sliders | None = None,
    ):
        self.sliders = sliders
        #: Number of unknowns, of driven columns (prescribed, motors), and of all with fixed ones.
        self.free, self.driven = couplings.free, couplings.driven
        self.columns = couplings.columns
        self.auxiliaries = Auxiliaries(couplings)
        #: Unknowns (2, m) of auxiliary unknowns in it, and those on which they depend.
        self.dependent = self.auxiliaries.dependent
        #: Column of the tangent that belongs to each column, and row of its forces; -1 where it is
        #: no unknown.
        self._index, self._row_index = (
            self.auxiliaries.columns_of_unknowns,
            self.auxiliaries.rows_of_unknowns,
        )
        if sliders is not None:
            for index in (self._index, self._row_index):
                own = slice(couplings.independent, self.columns)
                index[own] = sliders.index[own]
        self._rates, self._points, self._dofs = rates, points, dofs
        self._size, self._couplings, self._full = matrix.shape[0], couplings, (matrix, used)
        self._z = np.zeros(self.columns + len(self.auxiliaries))
        rows, columns, value_at, signs = couplings.all_entries()
        self._row, self._col, self._value_at = rows, columns, value_at
        self._sign = signs
        constant = value_at == 0
        self._linear = tuple(part[constant] for part in (rows, columns, signs))
        self._build_joints(couplings)

    def _build_joints(self, couplings: Couplings) -> None:
        moving = couplings.moving
        self.set_arms(moving)
        #: Signs in x and y.
        self._joint_sign = couplings.sign[:2, [joint.number for joint in moving]].T
        #: Rotation of the carrier; -1 for the ground.
        self._carrier = np.array(
            [self._dofs[j.a.number, 2] if j.a.number >= 0 else -1 for j in moving], dtype=int
        )
        self._slide = np.array([couplings.slides.get(j.number, -1) for j in moving], dtype=int)
        # Rows that follow through joint m: 2 m for those in x, 2 m + 1 for those in y.
        pairs = [(dof, arm) for dof, arms in couplings.arms.items() for arm in arms]
        self._below, self._through = np.array(pairs, dtype=int).reshape(-1, 2).T
        self._values, self._virtual_map = (np.ones(1 + 4 * len(moving)) for _ in range(2))

    def set_arms(self, moving: Sequence[Joint]) -> None:
        """Set the joints that move, in the same order: their offsets and axes."""
        self._moving = moving
        self._offset = np.array([joint.offset for joint in moving]).reshape(-1, 2)
        self._axis = np.array(
            [(0.0, 0.0) if joint.axis is None else joint.axis for joint in moving]
        ).reshape(-1, 2)

    def _on_tracks(self, slides: np.ndarray) -> np.ndarray:
        """Places (joints, 2) of b in the frames of a, and tangents there."""
        place, tangent = parts = np.empty((2, *self._axis.shape))
        for track in {joint.track for joint in self._moving}:
            rows = [m for m, joint in enumerate(self._moving) if joint.track is track]
            given = self._axis[rows].T, slides[rows]
            place[rows] = np.transpose(track.place(*given))
            tangent[rows] = np.transpose(track.tangent(*given))
        place += self._offset
        return parts

    @functools.cached_property
    def _tangent(self) -> _Tangent:
        """Positions of all products Tv[i, a] K[i, j] T[j, b] in the reduced tangent.

        Not made where others have the tangent.
        """
        free, couplings, (matrix, used) = self.free, self._couplings, self._full
        geometric = []
        for m, joint in enumerate(self._moving):
            turn = [
                e for e in couplings.entries_of_carrier(joint, self._dofs) if self._index[e[0]] >= 0
            ]
            slide = [(self._slide[m], 0, 1.0)] if 0 <= self._slide[m] < free else []
            of_kinds = (turn, turn), (turn, slide), (slide, turn), (slide, slide)
            for kind, (maps, values) in enumerate(of_kinds[: 4 if joint.track.number else 3]):
                geometric += [(a, b, m, kind, s * o) for a, _, s in maps for b, _, o in values]
        #: Slides with forces that are unknowns, among all with forces.
        sprung = np.flatnonzero(self._index[self._points.columns] >= 0)
        restoring = [(c, c) for c in self._points.columns[sprung].tolist()]

        moves = self._index[self._col] >= 0
        source, left, right = _products(self._row, moves, used, matrix.indptr, matrix.indices)
        others = np.array([p[:2] for p in (*geometric, *restoring)], dtype=int).reshape(-1, 2)
        pairs = np.vstack([np.column_stack([self._col[left], self._col[right]]), others])
        rows, columns = self._row_index[pairs[:, 0]], self._index[pairs[:, 1]]
        rows = np.concatenate([rows, self.auxiliaries.rows])
        columns = np.concatenate([columns, self.auxiliaries.columns])
        if self.sliders is None:
            pattern, position = sparsity(rows, columns, self.auxiliaries.unknowns)
        else:
            position = self.sliders.set_tangent(rows, columns)
            pattern = self.sliders.bordered.pattern
        cuts = np.cumsum([len(source), len(geometric), len(restoring)])
        position, geometric_to, restoring_to, auxiliary_to = np.split(position, cuts)
        maps, values = self._value_at[left], self._value_at[right]
        signs = self._sign[left] * self._sign[right]
        direct = (maps == 0) & (values == 0) & (signs == 1)
        names = "to", "source", "virtual", "value", "sign"
        coupled = (part[~direct] for part in (position, source, maps, values, signs))
        table = np.array([(m, kind, sign) for _, _, m, kind, sign in geometric]).reshape(-1, 3)
        joint_and_kind = dict(zip(("joint", "kind"), table[:, :2].T.astype(int), strict=True))
        return _Tangent(
            pattern,
            direct={"to": position[direct], "source": source[direct]},
            coupled=dict(zip(names, coupled, strict=True)),
            geometric={"to": geometric_to, **joint_and_kind, "sign": table[:, 2]},
            restoring={"to": restoring_to, "of": sprung},
            auxiliary_to=auxiliary_to,
        )

    @property
    def factored(self) -> tuple[np.ndarray, np.ndarray]:
        """Sparsity (indptr, indices) of the linear system in compressed rows.

        Of the unknowns, and of what is behind them; nodes that slide on beams border it.
        """
        return self._tangent.pattern

    @property
    def direct(self) -> dict[str, np.ndarray]:
        """As in `Tables`."""
        return self._tangent.direct

    @functools.cached_property
    def equates(self) -> bool:
        """Whether supports and joints only make degrees of freedom equal."""
        return self._couplings.is_index and not (self.forces or len(self._points.columns))

    @functools.cached_property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all, but for those that close loops."""
        return np.arange(self.free)

    def choose(self, y: np.ndarray, driven: np.ndarray) -> None:
        """Choose the unknowns that close loops by the configuration after increments."""

    def completion(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) that gives all rates from those of independent columns."""
        return scipy.sparse.identity(self.columns, format="csr")

    def completed(self, z: np.ndarray) -> np.ndarray:
        """All rates from those of independent columns: completion() z."""
        return z

    def bordering_rows(self) -> np.ndarray | None:
        """Gv and G (2, closures, unknowns) of loops that border the linear system; or None."""
        return None

    def loop_tables(self) -> LoopTables | None:
        """The closed loops as lists of numbers, for the compiled loop; None without any."""
        return None

    def system(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the linear system for all columns and auxiliaries; -1 for none."""
        return self._row_index, self._index

    def carriers(self) -> tuple[np.ndarray, int]:
        """None."""
        return np.empty(0, int), 0

    def open_entries(self) -> np.ndarray:
        """Positions of the entries of `factored` with open loops in that with closed ones."""
        return np.arange(len(self.factored[1]))

    def joint_tables(self) -> dict:
        """`Tables.joints`."""
        return {
            "joints": len(self._moving),
            "offset": self._offset,
            "axis": self._axis,
            "joint_sign": self._joint_sign,
            "carrier": self._carrier,
            "slide_column": self._slide,
            "slide_of": np.array([joint.number for joint in self._moving], dtype=int),
            "track": np.array([joint.track.number for joint in self._moving], dtype=int),
        }

    def tables(self) -> Tables:
        """The coupling as lists of numbers, for the compiled loop."""
        of = self._tangent
        return Tables(
            entries={
                "row": self._row,
                "column": self._col,
                "value": self._value_at,
                "sign": self._sign,
            },
            joints=self.joint_tables(),
            followers={
                "followers": len(self._below),
                "follower": self._below,
                "through": self._through,
            },
            direct=of.direct,
            coupled=of.coupled,
            geometric=of.geometric,
            restoring=of.restoring,
            auxiliaries=self.auxiliaries.tables(of.auxiliary_to),
        )

    # -- A step -----------------------------------------------------------------------------------

    def begin(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step: displacements and rotations, and slides."""
        carrier = self._carrier
        self._psi0 = np.where(carrier >= 0, q[carrier], 0.0) if len(carrier) else np.empty(0)
        self._arm_steps = np.zeros(2 * len(carrier))
        self._d0 = slides[[joint.number for joint in self._moving]]
        place, tangent = self._on_tracks(self._d0)
        self._rho0 = self._rho1 = _turn(self._psi0, place)
        self._t0 = _turn(self._psi0, tangent)
        if self.sliders is not None:
            self.sliders.begin(q, slides)

    def expand(self, y: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Increment of all degrees of freedom from increments of unknowns and driven columns: g.

        `spread` and `project` refer to it. Unknowns that close loops are corrected in y.
        """
        z = self._z
        z[: self.free] = y
        z[self.free : self.free + self.driven] = driven
        if len(self.auxiliaries):
            # First those of rotations, on which the arms of joints depend.
            for _ in range(2):
                self.auxiliaries.set_increments(z, self._arm_steps)
                D = self._expand(z)
        else:
            D = self._expand(z)
        for slide in self._sliding:  # a beam may hang on a node that slides on another one
            slide.relation.set(D[slide.dofs], float(z[slide.column]))
            z[slide.columns] = slide.relation.increment
            D = self._expand(z)
        self._points.evaluate_slides(z)
        return D

    def _expand(self, z):
        row, col, sign = self._linear
        D = np.bincount(row, z[col] * sign, self._size)
        carrier, level = self._carrier, self._rates.level
        if len(carrier):
            Dpsi = np.where(carrier >= 0, D[carrier], 0.0)
            Dd = np.where(self._slide >= 0, z[self._slide], 0.0)
            psi1, at_end = self._psi0 + Dpsi, self._on_tracks(self._d0 + Dd)
            self._rho1, t1 = (_turn(psi1, part) for part in at_end)
            self._arm_steps = (self._joint_sign * (self._rho1 - self._rho0)).ravel()
            np.add.at(D, self._below, self._arm_steps[self._through])

            # Virtual displacements that reproduce the step's increment and a rigid rotation:
            # W (rho0 + rho1)/2, and (t0 + t1)/2 times 1 + Dtheta^2/4 = dDtheta/dDpsi.
            _, slope = self._rates.work_increment(Dpsi, np.arange(len(Dpsi)))
            mean_t = (1 - level) * self._t0 + level * t1
            mean_rho = (1 - level) * self._rho0 + level * self._rho1
            of_joints, maps = self._values[1:].reshape(-1, 4), self._virtual_map[1:].reshape(-1, 4)
            of_joints[:, :2], of_joints[:, 2:] = _perp(self._rho1), t1
            maps[:, :2], maps[:, 2:] = _perp(mean_rho), slope[:, None] * mean_t
        return D

    @property
    def _sliding(self) -> list[Slide]:
        return [] if self.sliders is None else self.sliders.all

    def spread(self, z: np.ndarray) -> np.ndarray:
        """Small change of all degrees of freedom from a small change of all columns: T z."""
        if self._sliding:
            z = z.copy()
        for slide in self._sliding:
            change = self._spread(z)[slide.local_dofs(slide.relation.nodes.start)]
            z[slide.columns] = slide.relation.T @ np.append(change, z[slide.column])
        return self._spread(z)

    def _spread(self, z):
        if len(self.auxiliaries):
            z = np.append(z, np.zeros(len(self.auxiliaries)))
            self.auxiliaries.set_changes(z, self._values)
        weights = z[self._col] * self._values[self._value_at] * self._sign
        return np.bincount(self._row, weights, self._size)

    def gather(self, r):
        """Forces on all columns without Tv, springs and sliding nodes: T^T r, in a tree."""
        weights = r[self._row] * self._values[self._value_at] * self._sign
        out = np.bincount(self._col, weights, self.columns + len(self.auxiliaries))
        self.auxiliaries.collect(out, self._values)
        return out[: self.columns]

    def normal(self, weight):
        """T^T W T for a matrix W (size, size), as the system with auxiliaries.

        Its first unknowns x solve T^T W T x = b, if b is followed by zeros.
        """
        moves = self._index[self._col] >= 0
        rows, columns, value_at, signs = (
            part[moves] for part in (self._row, self._col, self._value_at, self._sign)
        )
        shape = (self._size, self.columns + len(self.auxiliaries))
        T = scipy.sparse.csr_matrix((self._values[value_at] * signs, (rows, columns)), shape)
        A, n = (T.T @ weight @ T).tocoo(), self.auxiliaries.unknowns
        rows = np.concatenate([self._row_index[A.row], self.auxiliaries.rows])
        columns = np.concatenate([self._index[A.col], self.auxiliaries.columns])
        entries = np.concatenate([A.data, self.auxiliaries.entries(self._values, self._values)])
        return scipy.sparse.csc_matrix((entries, (rows, columns)), (n, n))

    def coupling(self) -> scipy.sparse.csr_matrix:
        """The matrix T (size, columns) of `spread`."""
        T = self._of_columns(self._values)
        if len(self.auxiliaries):
            T = (T @ self.auxiliaries.completion(self._values)).tocsr()
        return self._with_slides(T, self._values, T)

    def _of_columns(self, values):
        """T (size, columns and auxiliary unknowns), or Tv, of the trees."""
        shape, at = (self._size, self.columns + len(self.auxiliaries)), (self._row, self._col)
        return scipy.sparse.csr_matrix((values[self._value_at] * self._sign, at), shape)

    def _with_slides(self, T, values, trees=None):
        """A matrix by columns with those of nodes on beams by those of the beams; for T or Tv.

        `trees` is the map of the trees, by default with auxiliary unknowns.
        """
        before = self._of_columns(values) if trees is None else trees
        for slide in self._sliding[::-1]:
            rule = slide.relation
            of = rule.virtual_map if values is self._virtual_map else rule.T
            local, row = slide.local_dofs(rule.nodes.start), np.arange(len(slide.columns))
            own = scipy.sparse.csr_matrix(of[:, :-1]) @ before[local]
            along = of[:, -1], (row, np.full(len(row), slide.column))
            own += scipy.sparse.csr_matrix(along, own.shape)
            others = np.ones(T.shape[1])
            others[slide.columns] = 0.0
            T = T @ scipy.sparse.diags(others) + T[:, slide.columns] @ own
        return T.tocsr()

    def moves(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) moves one of some degrees of freedom (size,)."""
        own = (self._values[self._value_at] != 0) & dofs[self._row]
        counts = np.bincount(self._col[own], minlength=self.columns + len(self.auxiliaries)) * 1.0
        self.auxiliaries.collect_whether(counts, self._values)
        return counts[: self.free] > 0

    def moves_alone(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) equals one of some degrees of freedom (size,).

        So far as it is known: not in long trees, loops or on beams.
        """
        if len(self.auxiliaries) or self.sliders is not None:
            return np.zeros(self.free, dtype=bool)
        alone = np.bincount(self._row, minlength=self._size) == 1
        own = alone[self._row] & dofs[self._row] & (self._value_at == 0)
        return np.bincount(self._col[own], minlength=self.columns)[: self.free] > 0

    def _on_slides(self, count: int) -> np.ndarray:
        """Forces (count,) on slides."""
        forces = np.zeros(count)
        np.add.at(forces, self._points.columns, self._points.on_slides(0))
        return forces

    def fault(self, arcs: Sequence[tuple[float, float]] = ()) -> tuple[str, str] | None:
        """Kind and reason of a step in which a node leaves the beam on which it slides; or None."""
        return None if self.sliders is None else self.sliders.fault(arcs)

    def project(self, r: np.ndarray) -> np.ndarray:
        """Generalised forces of all columns: Tv^T r, with springs and dampers."""
        return self._project(r)[: self.columns]

    def _project(self, r):
        """Generalised forces at all columns and auxiliary unknowns."""
        count = self.columns + len(self.auxiliaries)
        forces = self._on_slides(count)
        if self.sliders is not None:
            r = self.sliders.carry(r, self._virtual_map, forces)
        weights = r[self._row] * self._virtual_map[self._value_at] * self._sign
        out = np.bincount(self._col, weights, count) + forces
        if len(self.auxiliaries):
            self.auxiliaries.collect(out, self._virtual_map)
        return out

    def reduced(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The part Tv^T A T of the linear system for a matrix A of any sparsity, without loops."""
        T, Tv = (
            self._with_slides(self._of_columns(values), values)
            for values in (self._values, self._virtual_map)
        )
        A, n = (Tv.T @ matrix @ T).tocoo(), self.auxiliaries.unknowns
        row, column = self._row_index[A.row], self._index[A.col]
        on = (row >= 0) & (column >= 0) & (row < n) & (column < n)
        return scipy.sparse.csr_matrix((A.data[on], (row[on], column[on])), (n, n))


@cached_by_content
def _products(
    row: np.ndarray, moves: np.ndarray, used: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Used entries of K, in compressed rows, and the entries of Tv and T by which to multiply.

    From the rows of Tv's entries, and whether they move.
    """
    moving, size = np.flatnonzero(moves), len(indptr) - 1
    count = np.bincount(row[moving], minlength=size)
    first = np.cumsum(count) - count
    i, j = np.repeat(np.arange(size), np.diff(indptr)), indices
    products = count[i] * count[j] * used
    source = np.repeat(np.arange(len(j)), products)
    number = np.arange(len(source)) - np.repeat(np.cumsum(products) - products, products)
    i, j = i[source], j[source]
    left, right = first[i] + number // count[j], first[j] + number % count[j]
    return source, moving[left], moving[right]


def _turn(psi: np.ndarray, a: np.ndarray) -> np.ndarray:
    c, s = np.cos(psi)[:, None], np.sin(psi)[:, None]
    return c * a + s * _perp(a)


def _perp(a: np.ndarray) -> np.ndarray:
    return a[:, ::-1] * _QUARTER_TURN
