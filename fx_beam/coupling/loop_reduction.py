"""Closed loops of joints, without multipliers: some unknowns follow the others.

The trees of joints leave the columns z; a joint that closes a loop gives equations closure(z) = 0.
Of the unknowns some, d, follow the others, i, by Newton's method on these equations. The closing
joints' forces on b are those that leave no residual R of d. With G the derivative of the closures,
and Gv that of virtual displacements, so that Gv times the work increments of a step is its closure:

    F = Gv_d^-T R_d,    0 = R_i - Gv_i^T F,    z_d = -G_d^-1 G_i z_i   (in small changes)

The forces do no work and leave both momenta, since they are forces of joints like all others.
"""

from __future__ import annotations

import functools

import numpy as np
import scipy.sparse

from fx_beam.fem.point_forces import PointForces
from fx_beam.laws.rates import UpdateRule

from .closure_bordering_rows import ClosedSystem, ClosureBorderingRows
from .closure_rows import blocks_of, closure_rows
from .graph import Couplings
from .joint_reduction import JointReduction
from .sliders import Sliders

# Largest number of corrections that close the loops, and the closure that is left, relative to the
# size of the scene.
_CORRECTIONS, _CLOSED = 30, 1e-15
# Below this ratio of pivots loops are in a singular position. Near to it a closure of 1e-15 leaves
# the unknowns open by its root.
_SINGULAR = 1e-6


class LoopReduction(JointReduction):
    """Reduction for scenes with closed loops; `unit` (free,) is the size of unit unknowns."""

    def __init__(
        self,
        couplings: Couplings,
        points: PointForces,
        rates: UpdateRule,
        dofs: np.ndarray,
        matrix,
        used: np.ndarray,
        unit: np.ndarray,
        sliders: Sliders | None = None,
    ):
        super().__init__(couplings, points, rates, dofs, matrix, used, sliders)
        self._closures, self._free_columns = couplings.closures, couplings.free_columns
        rows = [(k, *entry) for k, one in enumerate(self._closures) for entry in one.entries]
        k, columns, value_at, signs = np.array(rows, dtype=float).reshape(-1, 4).T
        on_beam = (columns >= couplings.independent) & (columns < couplings.columns)
        #: Closures of loops with nodes on beams: their forces border the compiled loop's
        #: tangent.
        self._carried = np.unique(k[on_beam]).astype(int)
        self._closure_entries = k.astype(int), columns.astype(int), value_at.astype(int), signs
        self.unit = unit
        #: Largest closure of closed loops; some are angles.
        self._tolerance = _CLOSED * max(unit.max(), max(k.component == 2 for k in self._closures))
        slides = [] if sliders is None else sliders.all
        self._rows = closure_rows(couplings, len(self._values), slides)
        used_columns = np.unique([column for row in self._rows for column in row.columns])
        #: Unknowns of the loops, and other columns on which their closures depend.
        self.loop = used_columns[used_columns < self.free].astype(int)
        self._others = used_columns[used_columns >= self.free].astype(int)
        #: Closures of loops that share unknowns, and these among those of all loops.
        self.blocks = [
            (own, np.searchsorted(self.loop, columns))
            for own, columns in blocks_of(self._rows, self.free)
        ]
        #: Forces that are unknowns of the compiled loop, behind all others.
        self.forces = len(self._closures)
        self._build_closures()

    def _build_closures(self) -> None:
        """The closures as differences of displacements, less the arm of the joint."""
        number = {joint.number: m for m, joint in enumerate(self._moving)}
        rows, columns, signs, arms = [], [], [], []
        for k, one in enumerate(self._closures):
            for node, sign in ((one.joint.b, 1.0), (one.joint.a, -1.0)):
                if node.number >= 0:
                    rows.append(k)
                    columns.append(int(self._dofs[node.number, one.component]))
                    signs.append(sign)
            if one.component < 2 and one.joint.number in number:
                arms.append((k, number[one.joint.number], one.component))
        shape = len(self._closures), self._size
        #: Closures (closures, size) of displacements.
        self._ends = scipy.sparse.csr_matrix((signs, (rows, columns)), shape)
        self._arms = tuple(np.array(arms, dtype=int).reshape(-1, 3).T)
        #: Arms of the joints in the reference configuration.
        at_rest = [joint.arm if joint.place is None else joint.apart for joint in self._moving]
        self._rho_at_rest = np.array(at_rest).reshape(-1, 2)

    @functools.cached_property
    def _system(self) -> ClosedSystem:
        """The linear system of the compiled loop, with closures block by block."""
        order = np.argsort(np.concatenate([own for own, _ in self.blocks]))
        closure, *parts = self._closure_entries
        by_block = np.argsort(order[closure], kind="stable")
        self._entries = tuple(part[by_block] for part in (order[closure], *parts))
        index, carried = (self._row_index, self._index), order[self._carried]
        bordering_rows = ClosureBorderingRows(
            self._entries, *index, self._tangent.pattern, self.unit, carried
        )
        return bordering_rows.system()

    @property
    def factored(self):
        """Sparsity of the reduced matrix with closing forces, without what slides."""
        return self._system.pattern

    def carriers(self) -> tuple[np.ndarray, int]:
        """Positions in `factored` of forces that border it, which are 1; entries of all."""
        return self._system.ones, len(self._closure_entries[0])

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that do not follow others to close the loops."""
        return np.setdiff1d(np.arange(self.free), self._following)

    # -- A step -----------------------------------------------------------------------------------

    def begin(self, q, slides) -> None:
        """Set the start of a step, and choose the unknowns that follow there."""
        super().begin(q, slides)
        closure = self._ends @ q
        k, joint, component = self._arms
        closure[k] -= (self._rho0 - self._rho_at_rest)[joint, component]
        self._closure0 = closure
        self.choose(np.zeros(self.free), np.zeros(self.driven))

    def choose(self, y, driven) -> None:
        """Choose the unknowns that follow after increments, and set `singularity`."""
        self.closure(y, driven)
        G = self.scaled_derivative()
        parts = [(own, _pivots(G[np.ix_(rows, own)])) for rows, own in self.blocks]
        self._following = self.loop[np.concatenate([own[pivots] for own, (pivots, _) in parts])]
        self.singularity = ""
        if not all(regular for _, (_, regular) in parts):
            names = "; ".join(dict.fromkeys(str(one.joint) for one in self._closures))
            self.singularity = (
                f"the loops that {names} close are in a singular position, such as bars in one "
                "line, from which the motion may go on in several ways"
            )

    def expand(self, y, driven):
        """Increment of all degrees of freedom; corrects the unknowns that close the loops."""
        d, last, closed = self._following, np.inf, self._tolerance
        for _ in range(_CORRECTIONS):
            closure = self.closure(y, driven)
            size = abs(closure).max()
            if size <= closed or last < size <= 1e3 * closed:
                return self._D
            y[d] -= _solved(self._of_closures(self._values)[:, d], closure)
            last = size
        return np.full(self._size, np.nan)

    def closure(self, y, driven) -> np.ndarray:
        """Closures (closures,) of joints at unknowns that need not close the loops [m]."""
        self._D = super().expand(y, driven)
        closure = self._closure0 + self._ends @ self._D
        k, joint, component = self._arms
        closure[k] -= (self._rho1 - self._rho0)[joint, component]
        return closure

    def scaled_derivative(self) -> np.ndarray:
        """Derivative (closures, loop) of the closures by units of the unknowns [m]."""
        return self._of_closures(self._values)[:, self.loop] * self.unit[self.loop]

    def _of_closures(self, values: np.ndarray) -> np.ndarray:
        k, columns, value_at, signs = self._closure_entries
        G = np.zeros((len(self._closures), self.columns + len(self.auxiliaries)))
        np.add.at(G, (k, columns), values[value_at] * signs)
        if len(self._carried):
            G = self._with_slides(scipy.sparse.csr_matrix(G), values).toarray()
        return self.auxiliaries.by_columns(G, values) if len(self.auxiliaries) else G

    def _ratios(self) -> np.ndarray:
        """Changes (closures, columns) of the unknowns that follow, by the other columns."""
        G, d = self._of_closures(self._values), self._following
        W = -_solved(G[:, d], G)
        W[:, d] = 0.0
        return W

    def completion(self):
        """Matrix (columns, columns) that gives all rates from those of independent columns."""
        W, d = self._ratios(), self._following
        kept = np.setdiff1d(np.arange(self.columns), d)
        k, columns = np.nonzero(W)
        rows = np.concatenate([kept, d[k]])
        entries = np.concatenate([np.ones(len(kept)), W[k, columns]])
        at = rows, np.concatenate([kept, columns])
        return scipy.sparse.csr_matrix((entries, at), (self.columns,) * 2)

    def completed(self, z):
        """All rates from those of independent columns."""
        return self.completion() @ z

    def spread(self, z):
        """Small change of all degrees of freedom."""
        z = z.copy()
        z[self._following] = self._ratios() @ z
        return super().spread(z)

    def gather(self, r):
        """Forces on all columns, as `project` without Tv and springs; zero at d."""
        R, d = super().gather(r), self._following
        R += self._ratios().T @ R[d]
        R[d] = 0.0
        return R

    def moves(self, dofs):
        """Whether an unknown moves some degrees of freedom, or a loop."""
        moving = super().moves(dofs)
        moving[self.loop] = True
        return moving

    def coupling(self):
        """The matrix of `spread`."""
        return (super().coupling() @ self.completion()).tocsr()

    def project(self, r):
        """Generalised forces at all columns, with those of the closing joints; zero at d."""
        R = super().project(r)
        G, d = self._of_closures(self._virtual_map), self._following
        R -= G.T @ _solved(G[:, d].T, R[d])
        R[d] = 0.0
        return R

    def bordering_rows(self):
        """What closes the loops in the linear system with auxiliary unknowns; or None."""
        if not len(self.auxiliaries):
            return None
        k, columns, value_at, signs = self._closure_entries
        rows = np.zeros((2, len(self._closures), self.auxiliaries.unknowns))
        for out, index, values in zip(
            rows,
            (self._row_index, self._index),
            (self._virtual_map, self._values),
            strict=True,
        ):
            on = index[columns] >= 0
            np.add.at(out, (k[on], index[columns[on]]), (values[value_at] * signs)[on])
        return rows

    # -- For the compiled loop ------------------------------------------------------------------

    def tables(self):
        """Entries, joints and products of the trees, for the pattern with the loops."""
        tables, at = super().tables(), self.open_entries()
        if self.sliders is not None:
            return tables  # theirs is another pattern, stored at these positions
        names = "direct", "coupled", "geometric", "restoring"
        parts = {name: getattr(tables, name) for name in names}
        moved = {n: {**part, "to": at[part["to"]]} for n, part in parts.items()}
        return tables._replace(
            **moved, auxiliaries=self.auxiliaries.tables(at[self._tangent.auxiliary_to])
        )

    def open_entries(self) -> np.ndarray:
        """Places of the entries of the trees' pattern in that with the loops."""
        return self._system.open_entries

    def loop_tables(self):
        """The closed loops as lists of numbers."""
        of_system, (closure, entry_columns, values, signs) = self._system.tables, self._entries
        order = np.concatenate([own for own, _ in self.blocks])
        rows = [self._rows[k] for k in order]
        # The loops' columns: unknowns block by block, then others.
        block_columns = [self.loop[own] for _, own in self.blocks]
        of_loops = np.concatenate([*block_columns, self._others]).astype(int)
        number = np.empty(self.columns, dtype=int)
        number[of_loops] = np.arange(len(of_loops))
        closures = [self._closures[k] for k in order]
        ends = np.full((2, len(closures)), -1)
        for i, one in enumerate(closures):
            for side, node in enumerate((one.joint.b, one.joint.a)):
                if node.number >= 0:
                    ends[side, i] = self._dofs[node.number, one.component]
        arms = np.full(len(closures), -1)
        arms[np.argsort(order)[self._arms[0]]] = 2 * self._arms[1] + self._arms[2]
        column, dof, _, _ = self._free_columns
        dofs = np.full(self.columns, -1)
        dofs[column] = dof
        sizes = np.array([len(own) for own, _ in self.blocks])
        widths = np.array([len(own) for own in block_columns])
        of_rows = {
            "closure_near": ([number[row.columns] for row in rows], "closure_start"),
            "closure_auxiliary": ([row.auxiliaries for row in rows], "closure_auxiliary_start"),
        }
        values_of = {
            "closures": len(closures),
            "loop_columns": len(of_loops),
            "loop_free": len(self.loop),
            "blocks": len(sizes),
            "part_size": int(sizes @ sizes),
            "pivoting_size": int((sizes * (widths + 1)).max()),
            "loop_column": of_loops,
            "loop_dof": dofs[of_loops[: len(self.loop)]],
            "loop_unit": self.unit[of_loops[: len(self.loop)]],
            "following": np.zeros(len(closures), dtype=int),
            "closure_b": ends[0],
            "closure_a": ends[1],
            "closure_arm": arms,
            "closure_force": np.array([3 * one.joint.number + one.component for one in closures]),
            "closure_entry_start": _starts(np.bincount(closure, minlength=len(closures))),
            "closure_column": entry_columns,
            "closure_value": values,
            "closure_sign": signs,
            "block_closure": _starts(sizes),
            "block_column": _starts(widths),
            "block_part": _starts(sizes**2),
            "arm_at_rest": self._rho_at_rest,
            "closure_closed": self._tolerance,
        }
        for name, (parts, start) in of_rows.items():
            values_of[name] = np.concatenate([np.empty(0, int), *parts]).astype(int)
            values_of[start] = _starts([len(part) for part in parts])
        return of_system._replace(values=values_of | of_system.values)


def _starts(counts) -> np.ndarray:
    """Where each of several parts begins, and the last one ends."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(int)


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of A x = b; not finite for a singular matrix."""
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)


def _pivots(G: np.ndarray) -> tuple[np.ndarray, bool]:
    """Columns with the largest pivots of the rows of G, and whether none of them vanishes."""
    G, columns = G.copy(), np.zeros(len(G), dtype=int)
    if G.shape[1] < len(G):
        return columns, False
    first = abs(G).max()
    for k in range(len(G)):
        row, columns[k] = divmod(int(np.argmax(abs(G[k:]))), G.shape[1])
        G[[k, k + row]] = G[[k + row, k]]
        pivot = G[k, columns[k]]
        if not abs(pivot) > _SINGULAR * first:
            return columns, False
        G[k + 1 :] -= np.outer(G[k + 1 :, columns[k]] / pivot, G[k])
        G[k + 1 :, columns[k]] = 0.0
    return columns, True
