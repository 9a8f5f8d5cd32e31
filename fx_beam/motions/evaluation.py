"""Builds a solution from a record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.fem.dolfinx_api import gauss_points
from fx_beam.results.audit import BeamResultants, Stability, Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.joints import constraints_of
from fx_beam.scene.loads import NAMES
from fx_beam.step.model import Model
from fx_beam.step.recorded_histories import RecordedHistories
from fx_beam.step.recorder import Recorder

from .interpolation import at_times


def solution_of(
    model: Model,
    recorder: Recorder,
    stats: Stats,
    end: Callable[[], State],
    times: np.ndarray | None = None,
    breaks: Sequence[float] = (),
    ended: bool = False,
    scene_stays: bool = False,
    stability: Stability | None = None,
    stored: RecordedHistories | None = None,
) -> Solution:
    """Solution from a record, or from what is `stored` of it; `end` gives the last state.

    With `times` its rows are at these times, otherwise those of the record; the motion is smooth
    between `breaks`. What depends on nothing that may change is made when it is first read: the
    record stays as it is if the run has `ended`, and the scene if `scene_stays` until the solution
    is read.
    """
    scene, mesh = model.scene, model.mesh
    # Fitted rates depend on the joints of the scene, which may be changed.
    later = ended and (scene_stays or not model.fits_rates)
    recorded = recorder.histories() if stored is None else stored
    histories: Mapping[str, Any] = recorded
    rows: slice | np.ndarray = slice(None)
    if times is not None:
        histories, rows = at_times(model, recorded, times, breaks)
    elif not later:
        histories = dict(recorded)
    of_springs = histories["spring_internal"] if model.points.width else None
    cache: list[np.ndarray] = []
    of_name = {
        beam.name: (beam, cells) for beam, cells in zip(scene.beams, mesh.cells, strict=True)
    }

    def resultants_of_beam(name: str) -> BeamResultants:
        beams = model.forms.beams
        assert beams is not None
        check_rates(model, recorder)
        with model.reading:
            if not cache:
                every = recorder.means(beams.resultants(recorder.sub_steps()))
                cache.append(every[rows])
        beam, cells = of_name[name]
        values = cache[0][:, cells]
        s = arc_lengths(beam, gauss_points(beam.degree))
        N, Q, M = np.moveaxis(values.reshape(len(values), -1, 3), -1, 0)
        return BeamResultants(s.ravel(), N, Q, M)

    constraints = None if scene_stays else constraints_of(scene)

    def last() -> State:
        state = end()
        state = state.changed(
            impact=recorder.impact,
            fitted=recorded.fitted_at(state.t),
            constraints=constraints_of(scene) if constraints is None else constraints,
            owners=model.points.owners,
        )
        return state.renumbered(model.to_nodes, mesh.to_elements)

    return Solution(
        histories,
        X=mesh.X,
        energy=None,
        stats=stats,
        beams={beam.name: beam for beam in scene.beams},
        nodes_of_beam={b.name: n for b, n in zip(scene.beams, mesh.nodes, strict=True)},
        resultants_of_beam=resultants_of_beam,
        variables_of_beam=_variables_of_beam(model, histories),
        variables_of_joint=_variables_of_joint(model, of_springs),
        bodies={body.name: body for body in scene.bodies},
        contacts=list(scene.contacts),
        end=last if later else last(),
        names_of_parameters=model.forms.parameters.names,
        variables_of_contact=_variables_of_contact(model, of_springs),
        stability=stability,
    )


def check_rates(model: Model, recorder: Recorder) -> None:
    """ValueError if stress resultants depend on rates that are not recorded."""
    beams = model.forms.beams
    if beams is not None and beams.resultants_need_rates and "v" not in recorder.arrays:
        raise ValueError(
            f"the stress resultants of {model.scheme.name} depend on rates: rates not "
            "recorded; simulate with record=Record(rates=True)"
        )


def variables_along(model: Model) -> Iterator[tuple[Beam, np.ndarray, str, str, int]]:
    """Internal variables and natural strains: beam, its cells, name, history, and column there."""
    with_strains = {strain.beam.name for strain in model.scene.natural_strains}
    for beam, cells in zip(model.scene.beams, model.mesh.cells, strict=True):
        internal = beam.section.internal
        for i, name in enumerate(() if internal is None else internal.names):
            yield beam, cells, name, "internal", i
        for i, name in enumerate(NAMES.values() if beam.name in with_strains else ()):
            yield beam, cells, name, "natural", i


def _variables_of_beam(
    model: Model, histories: Mapping[str, Any]
) -> dict[str, dict[str, np.ndarray]]:
    """Internal variables and natural strains (n, points) by beam and name, from all cells'."""
    by_beam: dict[str, dict[str, np.ndarray]] = {}
    for beam, cells, name, history, column in variables_along(model):
        if (rows := histories[history]) is not None:
            of_beam = rows[:, cells][..., column].reshape(len(rows), -1)
            by_beam.setdefault(beam.name, {})[name] = of_beam
    return by_beam


def _variables_of_joint(model: Model, rows: np.ndarray | None) -> dict[int, dict[str, np.ndarray]]:
    """Internal variables (n,) of springs by the joint's number and name, from those of all."""
    by_joint: dict[int, dict[str, np.ndarray]] = {}
    if rows is None:
        return by_joint
    columns = iter(rows.T)
    for joint in model.scene.joints:
        if joint.internal:
            by_joint[joint.number] = {name: next(columns) for name in joint.internal}
    return by_joint


def _variables_of_contact(model: Model, rows: np.ndarray | None) -> dict[int, np.ndarray]:
    """Stretch and slip (n, points, 2) by the number of a contact."""
    by_contact: dict[int, np.ndarray] = {}
    first = model.points.of_contacts.start
    for obstacle in model.scene.contacts:
        if rows is not None and obstacle.variables:
            of_points = rows[:, first : first + obstacle.variables]
            by_contact[obstacle.number] = of_points.reshape(len(rows), -1, 2)
        first += obstacle.variables
    if rows is not None:
        by_contact |= model.points.friction_of_members(rows)
    return by_contact
