"""Histories along the beams of a solution: shapes, stress resultants, internal variables."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam
from fx_beam.scene.natural_strains import NAMES
from fx_beam.validation import is_one_of, shown

from .audit import BeamResultants
from .lookup import beam_name


def shape(solution: Any, beam: Beam | str) -> np.ndarray:
    """Deformed axis of a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.

    Returns
    -------
    (n, elements * degree + 1, 2) float
        Positions of its nodes, those inside elements included [m].
    """
    nodes = solution.nodes_of_beam[beam_name(solution, beam)]
    return solution.X[nodes] + solution.recorded("q")[:, nodes, :2]


def resultants(solution: Any, beam: Beam | str) -> BeamResultants:
    """Stress resultants along a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.

    Returns
    -------
    BeamResultants
        Axial force N, shear force Q and bending moment M at the arc lengths s and the times
        `t_level`. Row 0 is the start configuration. Forces of `Scene.add_virtual_work` that act
        inside a beam are not included.

    Raises
    ------
    ValueError
        If the motion was not recorded, or the rates that the scheme's resultants need.
    """
    solution.recorded("q")  # they are computed from the motion
    return solution.resultants_of_beam(beam_name(solution, beam))


def internal(solution: Any, beam: Beam | str, variable: str | None = None) -> np.ndarray:
    """An internal variable along a beam over time.

    Parameters
    ----------
    solution : Solution
        What is read.
    beam : Beam or str
        A beam or its name.
    variable : str, optional
        Name of one of the `InternalVariables` of its section; not needed if there is only one.

    Returns
    -------
    (n, elements * degree) float
        Its values at the times t, at the arc lengths s of `resultants`.

    Raises
    ------
    ValueError
        If the motion was not recorded, or the beam has no such variable.
    """
    name = beam_name(solution, beam)
    solution.recorded("q")  # internal variables are recorded with the motion
    known = solution.variables_of_beam.get(name, {})
    own = [name for name in known if name not in NAMES.values()]
    if variable is None and len(own) == 1:
        (variable,) = own
    if not is_one_of(variable, known):
        raise ValueError(
            f"beam {name!r} has no internal variable {shown(variable)}; it has {list(known)}"
        )
    return known[variable]
