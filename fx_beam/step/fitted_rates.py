"""Rates that fit the joints, and the impulses of joints and supports that make them fit.

The mid-point rule leaves in the rates a part that joints do not allow: v1 = 2 Du/dt - v0. It
alternates from step to step, and hardly enters the motion, but forces of a step contain its change.
The nearest rates in the norm of the mass are without it:

    v* = v + c    with    M c = G^T mu,    G v* = g

The joints exert the impulses mu. So their mean force over a step is that of the step, plus the
increment of mu, divided by the length of the step.

Their derivatives: corrections c and multipliers mu of `FittedRates` solve

    [ M  G^T ] [  c  ]   [    0    ]
    [ G   0  ] [ -mu ] = [ g - G v ]

so that changes of all that is given need further right sides only, and derivatives of a function of
c and mu one solution with these, since the matrix is symmetric. Right sides and impulses, at
constant c and mu, have a sparse Jacobian, which is followed both ways. A row of G is
p . s + m d(omega) with the velocity s of b relative to its place on a, the force p and the moment
m. These and what is given depend on the slope t, the bend k, arms and weights of the joint by a few
local derivatives.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.coupling.rate_equations import OnBeam, RateEquations
from fx_beam.coupling.sliders import PlaceOnBeam

from .rate_solver import Fit, RateSolver
from .row_jacobian import RowJacobian, behind, slope, times

# Columns of the Jacobian: those of each configuration, and numbers that all have in common.
_OF_STATE = "q", "v", "slides", "driven rates"
_NUMBERS = "arms of joints", "axes of joints", "paths"


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions.

    `equations` gives those of the scene, with or without rigid points; `mass` (size, size) is that
    of the scene, `unit` (size,) the size of a unit increment.
    """

    def __init__(
        self,
        equations: Callable[[bool], RateEquations],
        mass: scipy.sparse.csr_matrix,
        unit: np.ndarray,
    ):
        self._equations, self._mass, self._unit = equations, mass, unit

    @cached_property
    def _solver(self) -> RateSolver:
        return RateSolver(self._equations(False), self._mass, self._unit)

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        return self._solver.fit(q, v, slides, driven)

    @cached_property
    def _solver_of_all(self) -> RateSolver:
        return RateSolver(self._equations(True), self._mass, self._unit, all_rates=True)

    def derivatives(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray
    ) -> RateDerivatives:
        """What `fit` found for n configurations, and its derivatives; all as there."""
        return RateDerivatives(self._solver_of_all, self._mass, q, v, slides, driven)


class RateDerivatives:
    """The linear system of a scene's rates at n configurations; `mass` is that of the scene."""

    def __init__(
        self,
        solver: RateSolver,
        mass: scipy.sparse.csr_matrix,
        q: np.ndarray,
        v: np.ndarray,
        slides: np.ndarray,
        driven: np.ndarray,
    ):
        self._solver, self._mass, equations = solver, mass, solver.equations
        n, count, entries = len(q), equations.count, len(equations.entry)
        values = np.empty((n, entries + 4 * count))
        fit = solver.fit(q, v, slides, driven, values=values)
        #: Corrections (n, size), and rates that fit; entries (n, entries) of G, what is given and
        #: multipliers (n, count), forces (n, count, 2) and with moments (n, count, 3) on b.
        self.c, self.rates, self._equations = fit.corrections, fit.rates, equations
        ends = np.cumsum([entries, count, 2 * count])
        parts = (np.ascontiguousarray(part) for part in np.split(values, ends, axis=1))
        self._entries, self._given, push, self._mu = parts
        self._push = push.reshape(n, count, 2)
        turning = np.broadcast_to(equations.turning, self._given.shape)
        self._weight = np.concatenate([self._push, turning[..., None]], axis=-1)
        self._places = [
            PlaceOnBeam(b.path, b.beam, q, slides[:, b.number]) for b in equations.on_beams
        ]
        self._sliding, self._of_slides = self._slopes_of_slides(q, slides)
        #: Driven column of each equation, or -1, and its rates (n, count).
        self._column = np.where(equations.column < driven.shape[1], equations.column, -1)
        self._driven = _with_ground(driven)[:, self._column]
        #: Numbers of columns of the Jacobian, those of all configurations in common.
        self._widths = [x.shape[1] for x in (q, v, slides, driven)]
        paths = sum(one.path.numbers.size for one in equations.on_beams)
        self._common = [equations.apart.size, equations.axis.size, paths]

    # -- Local derivatives, exact to round-off by steps in the imaginary direction ----------------

    def _slopes_of_slides(self, q: np.ndarray, slides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Plain equations (k,) of joints with an axis, and those (n, k, 7, 4) of what they have.

        That is entries on b and a, and what is given; by the rotation of a, axis and slide.
        """
        equations, with_ground = self._equations, _with_ground(q)
        axis = equations.axis[equations.joint[: equations.plain]]
        own = np.flatnonzero(axis.any(axis=1))
        a, b, joint, direction = (
            x[own] for x in (equations.a, equations.b, equations.joint, equations.direction)
        )
        free, track_of = equations.free[own, None], equations.track[joint]

        def law(given: np.ndarray) -> np.ndarray:
            t = np.zeros_like(given[..., :2])
            for track in equations.tracks:
                rows = np.flatnonzero(track_of == track.number)
                psi, *axis, slide = np.moveaxis(given[:, rows], -1, 0)
                c, s, (x, y) = np.cos(psi), np.sin(psi), track.tangent(axis, slide)
                t[:, rows] = np.stack([c * x - s * y, s * x + c * y], axis=-1)
            along = (t * direction).sum(axis=-1, keepdims=True)
            return np.concatenate([np.where(free, _across(t), direction), along], axis=-1)

        axis = np.broadcast_to(axis[own], (len(q), *axis[own].shape))
        given = [with_ground[:, a[:, 2:]], axis, slides[:, joint, None]]
        slopes = _slopes(law, np.concatenate(given, axis=-1))
        of_p, arm = slopes[:, :, :2], with_ground[:, b[:, :2]] - with_ground[:, a[:, :2]]
        lever = np.einsum("nri,nrij->nrj", _across(equations.apart[joint] + arm), of_p)
        none = np.zeros_like(lever)[:, :, None]
        return own, np.concatenate(
            [of_p, none, -of_p, -lever[:, :, None], slopes[:, :, 2:]], axis=2
        )

    @staticmethod
    def _slopes_on_beam(one: OnBeam, place: PlaceOnBeam) -> np.ndarray:
        """Those (n, rows, 4, 3) of forces and moments on b, and of what is given, by t and k."""

        def law(given: np.ndarray) -> np.ndarray:
            t, k = given[..., :2], given[..., 2:]
            none, square = np.zeros_like(k), (t * t).sum(axis=-1, keepdims=True)
            if not one.free[0]:
                unit = np.broadcast_to(np.eye(3), (*given.shape, 3))
                return np.concatenate([unit, given[..., None]], axis=-1)[:, : one.rows]
            across, turned = _across(t) / np.sqrt(square), -k / square * t
            both = [np.hstack([x, none, none]) for x in (across, turned)]
            return np.stack(both, axis=1)[:, : one.rows]

        return _slopes(law, np.column_stack([place.slope, place.bend]))

    # -- Jacobians --------------------------------------------------------------------------------

    @cached_property
    def _impulses(self) -> scipy.sparse.csr_matrix:
        """Impulses of joints and of columns by the multipliers."""
        count, joints = self._equations.count, 3 * self._equations.joints
        of = RowJacobian(len(self._mu), joints + self._equations.columns, count)
        of.put(self._of_joint, np.arange(count)[:, None], self._weight)
        of.put(behind(joints, self._equations.column), np.arange(count), self._given)
        return of.matrix

    @property
    def _of_joint(self) -> np.ndarray:
        """Places (count, 3) of the joint of each equation among impulses; -1 of supports."""
        return behind(0, 3 * self._equations.joint[:, None] + np.arange(3))

    @cached_property
    def _jacobian(self) -> scipy.sparse.csr_matrix:
        """Right sides, and impulses at constant multipliers, by the state and by numbers."""
        equations, n, mu = self._equations, len(self._mu), self._mu[..., None]
        size, row, rates = equations.size, np.arange(equations.count), _with_ground(self.rates)
        starts = itertools.accumulate((*self._widths, *self._common[:2]), initial=0)
        first = dict(zip((*_OF_STATE, *_NUMBERS), starts, strict=True))
        impulses = size + equations.count
        of_columns = impulses + 3 * equations.joints
        of_joint = behind(impulses, self._of_joint)
        of_column = behind(of_columns, equations.column)[:, None]
        outputs, states = of_columns + equations.columns, sum(self._widths)
        numbers, near = sum(self._common), sum(3 + len(place.near) for place in self._places)
        found, by_places = RowJacobian(n, outputs, states, numbers), RowJacobian(n, outputs, near)
        places = RowJacobian(n, near, states, numbers)

        def put(to: RowJacobian, rows: Any, dofs: Any, of: Any, slopes: Any, given: Any) -> None:
            """Put those by local numbers: slopes (n, rows, entries, ...) and (n, rows, ...)."""
            by_rates = np.einsum("nre,nrei->nri", rates[:, dofs], slopes)
            to.put(dofs[..., None], of[:, None], mu[:, rows, None] * slopes)
            to.put(size + rows[:, None], of, self._driven[:, rows, None] * given - by_rates)
            to.put(of_joint[rows, :2, None], of[:, None], mu[:, rows, None] * slopes[:, :, :2])
            to.put(of_column[rows], of, mu[:, rows] * given)

        plain, own, a, b = equations.plain, self._sliding, equations.a, equations.b
        number = equations.joint[:plain, None]
        pair = 2 * (number % len(equations.apart)) + [0, 1]
        of_arm = np.hstack([b[:, :2], a[:, :2], first["arms of joints"] + pair])
        across = _across(self._push[:, :plain])
        across = np.concatenate([across, -across, across], axis=-1)
        found.put(a[:, 2:], of_arm, mu[:, :plain] * across)
        found.put(size + row[:plain, None], of_arm, -rates[:, a[:, 2:]] * across)
        of = np.hstack([a[:, 2:], first["axes of joints"] + pair, first["slides"] + number])[own]
        slopes = self._of_slides
        put(found, own, np.hstack([b, a])[own], of, slopes[:, :, :6], slopes[:, :, 6])
        start, last, path = 0, plain, first["paths"]
        for one, place in zip(equations.on_beams, self._places, strict=True):
            rows = np.arange(last, last := last + one.rows)
            at = np.arange(start, start := start + 3 + len(place.near))
            N, nodes, slopes = place.weights, place.dofs, self._slopes_on_beam(one, place)
            of_node = slopes[:, :, :3]
            on_beam = -np.einsum("nrij,na->nraij", of_node, N[0]).reshape(n, len(rows), -1, 3)
            dofs = np.append(one.node, nodes)[None].repeat(len(rows), axis=0)
            both = np.concatenate([of_node, on_beam], axis=2)
            put(by_places, rows, dofs, at[None, :3], both, slopes[:, :, 3])
            weight = self._weight[:, rows]
            by_places.put(nodes, at[3:, None], -(mu[:, rows] * weight).sum(axis=1)[:, None])
            by_rates = np.einsum("nri,nai->nra", weight, self.rates[:, nodes])
            by_places.put(size + rows[:, None], at[3:], by_rates)
            places.put(at, first["slides"] + one.number, place.by_slide)
            places.put(at[:3], nodes, N[1][..., None])
            places.put_common(at, path, place.by_numbers)
            path += one.path.numbers.size
        found.put(size + row, behind(first["driven rates"], self._column), self._given)
        found.put(size + equations.row, first["v"] + equations.dof, -self._entries)
        of_places = [by_places.matrix @ places.matrix] if self._places else []
        return sum(of_places, found.matrix)

    # -- Derivatives ------------------------------------------------------------------------------

    def vjp(
        self, rates: np.ndarray, joints: np.ndarray, columns: np.ndarray
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Derivatives by "q", "v", "slides" and "driven rates" (n, ...), and by numbers.

        From those by rates that fit (n, size), and by impulses (n, joints, 3) and (n, columns).
        """
        n, size = rates.shape
        impulses = np.hstack([joints.reshape(n, -1), columns])
        by_mu = (self._impulses.T @ impulses.ravel()).reshape(n, -1)
        # What has no mass, and no joint, keeps its rates.
        held = np.zeros((n, size), dtype=bool)
        for dof, entries in zip(self._equations.dof, self._entries.T, strict=True):
            held[:, dof] |= entries != 0
        by_c = np.where(held | (self._solver.little == 0), rates, 0.0)
        x = self._solver.solve(self._entries, np.hstack([by_c, -by_mu]))
        by = self._jacobian.T @ np.hstack([x, impulses]).ravel()
        of_state, numbers = by[: n * sum(self._widths)], by[n * sum(self._widths) :]
        parts = np.split(of_state.reshape(n, -1), np.cumsum(self._widths)[:-1], axis=1)
        found = dict(zip(_OF_STATE, parts, strict=True))
        found["v"] = found["v"] + rates
        common = dict(zip(_NUMBERS, np.split(numbers, np.cumsum(self._common)[:-1]), strict=True))
        masses = self._mass.tocoo()
        common["mass"] = -(x[:, masses.row] * self.c[:, masses.col]).sum(axis=0)
        return found, {name: values for name, values in common.items() if values.size}

    def jvp(
        self, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of rates (n, m, size), and of impulses (n, m, joints, 3) and (n, m, columns).

        From those of the state, "q", "v", "slides" and "driven rates" (n, m, ...), and of numbers
        (m, ...).
        """
        states = np.concatenate([of_state[name] for name in _OF_STATE], axis=-1)
        (n, m, _), size = states.shape, self.c.shape[1]
        numbers = [changes[name].reshape(m, -1).T for name in _NUMBERS if name in changes]
        found, right = times(self._jacobian, states, numbers), size + self._equations.count
        for j, mass in enumerate(changes["mass"]):
            if mass.any():
                of_mass = self._mass.copy()
                of_mass.data = mass
                found[:, j, :size] -= (of_mass @ self.c.T).T
        x = self._solver.solve(self._entries, found[..., :right])
        impulses = found[..., right:] - times(self._impulses, x[..., size:])
        joints, columns = np.split(impulses, [3 * self._equations.joints], axis=-1)
        return of_state["v"] + x[..., :size], joints.reshape(n, m, -1, 3), columns


def _slopes(law: Callable[[np.ndarray], np.ndarray], given: np.ndarray) -> np.ndarray:
    """Derivatives (..., m) of an analytic law by m numbers (..., m)."""
    return np.stack([slope(law, given, unit) for unit in np.eye(given.shape[-1])], axis=-1)


def _with_ground(x: np.ndarray) -> np.ndarray:
    """Values (..., size + 1), zero at the number -1."""
    return np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1)


def _across(x: np.ndarray) -> np.ndarray:
    """Vectors (..., 2), turned by a right angle."""
    return np.stack([-x[..., 1], x[..., 0]], axis=-1)
