"""A tape of load steps: then they are followed backwards and forwards as steps in time are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fx_beam.results.state import State

from .forcing import LoadForcing
from .model import Model
from .tables import Problem
from .tape import Tape


def static_tape(
    problem: Problem, start: State, states: Sequence[State], forcing: LoadForcing
) -> Tape:
    """The steps from a state over others, as rows of a tape (c/tape.h).

    Their length is the increment of the load factor, and their `ratio` the factor itself. Without
    internal variables an equilibrium depends on none before, and is a step from itself.
    """
    model, t = problem.model, np.array([forcing.time])
    loads, parameters = model.loads.series(t)[0], model.forms.parameters
    follower_force, values, strains = np.empty(0), np.empty(0), np.empty(0)
    if len(model.points.followers):
        follower_force = model.points.followers.series(t, t)
    if len(parameters):
        values = parameters.at(forcing.time)
    if model.natural:
        strains = forcing.naturals(t)[0]
    rows, apart, last = [], not model.flows, start.t
    for old, new in zip(states if apart else [start, *states], states, strict=False):
        length, last = new.t - last, new.t
        rows.append(
            [
                [forcing.time - length, length, new.t, 1.0, 0.0],
                *(old.q, np.zeros(model.size), old.slides, _or_none(old.internal)),
                *(_at_start(model, old, new), _or_none(old.natural)),
                *(new.t * loads, new.t * loads, follower_force, new.t * strains),
                *(values, _increments(model, old, new)),
            ]
        )
    tape = Tape(problem)
    tape.c.apart = apart
    tape.write(np.array([np.concatenate([np.ravel(part) for part in row]) for row in rows]))
    return tape


def _or_none(values: np.ndarray | None) -> Any:
    return np.empty(0) if values is None else values


def _at_start(model: Model, old: State, new: State) -> np.ndarray:
    """Internal variables of forces at points at its start, with forces that friction follows."""
    if old.spring_internal is None or new.spring_internal is None:
        return np.empty(0)
    given, followed = old.spring_internal.copy(), model.points.followed
    given[followed] = new.spring_internal[followed]
    return given


def _increments(model: Model, old: State, new: State) -> np.ndarray:
    """Increments (columns,) of the unknowns and of driven motions; zero for those that follow."""
    D, reduction, driven = new.q - old.q, model.reduction, len(model.prescribed)
    z = np.zeros(reduction.columns)
    z[: reduction.free] = model.couplings.unknowns(D, new.slides - old.slides)
    z[reduction.free : reduction.free + driven] = D[model.prescribed]
    end = reduction.free + reduction.driven
    z[reduction.free + driven : end] = new.motors - old.motors
    return z
