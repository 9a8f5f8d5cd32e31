"""Derivatives of energies by the state and by numbers of the scene."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.model.model import Model
from fx_beam.scene.outputs import Output


def check_energy(model: Model, output: Output, name: str) -> None:
    """Refuse an energy that is no function of displacements, rates and constant numbers."""
    beams, lacking = model.forms.beams, ""
    if output.quantity == "kinetic_energy":
        if model.fitted_rates is not None and model.couplings.driven:
            lacking = "rates of driven motions are fitted to the joints"
    elif output.quantity == "strain_energy" and beams is not None:
        if beams.internal_shape[-1]:
            lacking = "it depends on internal variables"
        elif beams.energy_has_parameters:
            lacking = "it depends on parameters"
    if lacking:
        raise SceneError(f"the output {name!r}, {output}, has no derivatives: {lacking}")


def energy_gradient(
    model: Model, output: Output, q: np.ndarray, v: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Derivatives of an energy by "q" and "v" (size,), and by numbers of the scene by name."""
    if output.quantity == "kinetic_energy":
        mass = model.mass.tocoo()
        return {"v": model.mass @ v}, {"mass": v[mass.row] * v[mass.col] / 2}
    if output.quantity == "potential_energy":
        return ({}, {}) if model.weight is None else ({"q": -model.weight}, {"weight": -q})
    if model.forms.beams is None:
        return {}, {}
    found = model.forms.beams.stored_energy_by(q)
    return {"q": found.pop("q")}, found
