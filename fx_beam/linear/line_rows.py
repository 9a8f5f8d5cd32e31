"""Forces and energies of lines between points as outputs of a linear system, by their own laws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.fem.point_values import AN_INSTANT, PointValues
from fx_beam.laws.interval import StepBatch

from .moving_state import Deviations


def line_rows(
    about: Deviations, line: int, quantity: str, inputs: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows by z and z' (columns,) and by inputs (m,) of the "pull" or "energy" of a line."""
    model, state = about.model, about.state
    T, dT = about.T.toarray(), about.dT.toarray()
    parameters = model.forms.parameters
    steps = StepBatch.single(
        state.t,
        1.0,
        q=state.q,
        v=T @ about.rates,
        parameters=parameters.at(state.t),
        spring_internal=state.spring_internal,
        load_factor=np.array(about.factor),
    )
    moved, rate_row, direct = np.zeros(T.shape[1]), np.zeros(T.shape[1]), list[float]()
    parameter_slopes = np.zeros(len(parameters))
    rule = AN_INSTANT if quantity == "pull" else None
    for name, entries, slopes in PointValues(model.points, quantity, line, rule).slopes(steps):
        if name == "q":
            moved += slopes[0] @ T[entries]
        elif name == "v":
            moved += slopes[0] @ dT[entries]
            rate_row += slopes[0] @ T[entries]
        elif name == "parameters":
            parameter_slopes[entries] += slopes[0]
    for name in inputs:
        for unit in np.eye(about.held.widths[name]):
            direct.append(float(parameter_slopes @ _by_input(about, name, unit)))
    return moved, rate_row, np.array(direct)


def _by_input(about: Deviations, name: str, unit: np.ndarray) -> np.ndarray:
    """Change of all parameters with a unit of an input, in which they are linear."""
    inputs, parameters, value = about.held, about.model.forms.parameters, about.held.values[name]
    ends = list[np.ndarray]()
    for end in (value + unit, value):
        inputs.set({name: end})
        inputs.arrive()
        ends.append(parameters.at(about.state.t))
    return ends[0] - ends[1]
