"""Histories whose rates fit the joints, with the accelerations and forces that belong to them."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from fx_beam.results.audit import Energy
from fx_beam.scene.sliders import sliding_joints

from .fitted_rates import Fit
from .forcing import Forcing
from .held_inputs import Ramp
from .model import Model

# Which energies have the work of driven motions.
_BY_DRIVEN = [
    float(field.name in ("kinetic", "work")) for field in fields(Energy) if field.name != "impact"
]


class Ends(NamedTuple):
    """Ends or starts of n steps."""

    #: Times (n,), and lengths of the steps before [s].
    t: np.ndarray
    lengths: np.ndarray
    #: Displacements and rotations, and rates, (n, size); slides (n, joints).
    q: np.ndarray
    v: np.ndarray
    slides: np.ndarray
    #: Rates (driven,) of driven motions at the first one, if `State` has them.
    driven: np.ndarray | None = None


def fitted(
    model: Model,
    rows: dict[str, np.ndarray],
    starts: tuple[np.ndarray, np.ndarray] | None,
    grid: tuple[np.ndarray, np.ndarray],
    driven: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """Rows (n, ...) of a record with fitted rates; row 0 is the start.

    `starts` are q and v at the starts of the steps before the other rows, where these are not the
    rows before; `grid` has the times at the ends of all steps, and the steps of the rows; `driven`
    the rates at the start.
    """
    times, steps = grid
    fits = model.fitted_rates
    assert fits is not None
    histories, slides = dict(rows), rows.get("slides", np.empty((len(steps), 0)))
    lengths = _lengths(times, steps)
    ends = Ends(times[steps], lengths, rows["q"], rows["v"], slides, driven)
    now = fits.fit(ends.q, ends.v, slides, _driven(model, ends, starts is None))
    before = Fit(*(values[:-1] for values in now))
    if starts is not None:
        (q, v), at, near = starts, steps[1:] - 1, _slides_near(model, starts[0], slides[1:])
        first = Ends(times[at], _lengths(times, at), q, v, near)
        before = fits.fit(q, v, near, _driven(model, first, False))
    histories["v"] = now.rates
    impulses = (model.mass @ now.corrections.T).T
    histories["momenta"] = rows["momenta"] + sums_of(model, ends.q, impulses)
    if model.couplings.driven:  # at rates that fit, other impulses do no work
        given = np.einsum("ni,ni->n", now.rates, impulses)
        histories["energies"] = rows["energies"] + np.outer(given, _BY_DRIVEN)
    changes = ("a", "corrections"), ("joint_forces", "joints"), ("constraint_forces", "constraints")
    for name, change in changes:
        if name in rows:
            after, start = getattr(now, change)[1:], getattr(before, change)
            mean = (after - start).reshape(rows[name][1:].shape) / lengths[1:, None]
            histories[name] = np.concatenate([rows[name][:1], rows[name][1:] + mean])
    return histories


def _lengths(times: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Lengths (n,) of steps by their number; for number 0 that of the first step, negative."""
    return times[steps] - times[np.where(steps, steps - 1, len(times[:2]) - 1)]


def _driven(model: Model, ends: Ends, in_turn: bool) -> np.ndarray:
    """Rates (n, driven) of driven motion; NaN where they are not known.

    Inputs go straight in a step, so that their rates are those over it, if the rows are `in_turn`.
    """
    driven = np.full((len(ends.t), model.couplings.driven), np.nan)
    if not driven.size:
        return driven
    forcing = Forcing(model)
    straight = np.array([isinstance(function, Ramp) for function in forcing.functions])
    if ends.lengths.all():
        driven[:] = forcing.end_rates(ends.t, ends.lengths)
    driven[:, straight] = np.nan
    if in_turn and straight.any():
        means = driven_ways(model, ends.q, ends.slides) / ends.lengths[1:, None]
        driven[1:, straight] = means[:, straight]
    if ends.driven is not None:
        driven[0] = ends.driven
    return driven


def driven_ways(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Increments (n - 1, driven) of driven motions from row to row, without full turns."""
    positions = [q[:, model.prescribed]]
    dofs = np.vstack([model.mesh.dofs, np.full((1, 3), model.size)])
    q = np.pad(q, ((0, 0), (0, 1)))  # the ground is the last
    for joint, name in model.motors:
        a, b = (q[:, dofs[node.number, 2]] for node in (joint.a, joint.b))
        positions.append((b - a if name == "rotation" else slides[:, joint.number])[:, None])
    ways = np.diff(np.hstack(positions), axis=0)
    turns = [component == 2 for _, component in model.scene.prescribed]
    turns += [name == "rotation" for _, name in model.motors]
    return ways - np.where(turns, 2 * np.pi * np.round(ways / (2 * np.pi)), 0.0)


def sums_of(model: Model, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Sums (n, 3) of nodal momenta p (n, size): in x and y, and about the origin."""
    x, p = model.mesh.X + q[:, model.mesh.dofs[:, :2]], p[:, model.mesh.dofs]
    turning = x[..., 0] * p[..., 1] - x[..., 1] * p[..., 0] + p[..., 2]
    sums = np.empty((len(p), 3))
    sums[:, :2], sums[:, 2] = p[..., :2].sum(axis=1), turning.sum(axis=1)
    return sums


def _slides_near(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Slides (n, joints) at q (n, size), from ones near by; only those on beams change."""
    nearest, mesh = slides.copy(), model.mesh
    for joint in sliding_joints(model.scene.joints):
        nodes = mesh.nodes_of(model.scene, joint.beam)
        axis, point = (mesh.X[at] + q[:, mesh.dofs[at, :2]] for at in (nodes, joint.b.number))
        number = joint.number
        nearest[:, number] = joint.path.nearest_over(axis, point, slides[:, number])
    return nearest
