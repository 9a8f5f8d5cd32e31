"""First-order statics: small displacements about the reference, as of a frame program."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from fx_beam.motions.evaluation import solution_of
from fx_beam.results.records import BeamResultants, Energy, Stats
from fx_beam.results.section_forces import BeamBalance
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.step.row_steps import histories_of

from .load_steps import LoadStepper
from .small_loads import SmallLoads

_log = logging.getLogger("fx_beam")
# Error of the balance of forces, relative to the loads, of which a warning tells.
_OUT_OF_BALANCE = 1e-8


class _Histories(dict[str, object]):
    """Histories by name, of which no motion goes on."""

    def at_end(self, t: float) -> dict[str, np.ndarray]:
        """Nothing that a next step would need."""
        return {}


def first_order(
    stepper: LoadStepper, start: State, stats: Stats, end: Callable[[State], State]
) -> Solution:
    """The solution of two rows, without loads and with all loads, from a state without loads.

    Every history is linear in the load factor; energies and work are quadratic.
    """
    small = SmallLoads("static: linear", stepper, start)
    close, recorder = small.solution, small.recorder
    histories = _Histories(histories_of(recorder))
    for name, rows in histories.items():
        if isinstance(rows, np.ndarray) and len(rows) == len(close.t):
            histories[name] = small.at_ends(rows)
        elif isinstance(rows, Energy):
            parts = (
                [part[0], part[0] + small.slope(part) + small.curvature(part)]
                for part in vars(rows).values()
            )
            histories[name] = Energy(*map(np.array, parts))
    histories.update({"t": np.array([0.0, 1.0]), "t_level": np.array([0.0, 1.0])})
    last = end(start.changed(t=1.0, q=start.q + small.D))
    solution = solution_of(recorder, stats, lambda: last, stored=histories)

    def resultants_of_beam(name: str) -> BeamResultants:
        beam = close.resultants_of_beam(name)
        N, Q, M = map(small.at_ends, (beam.N, beam.Q, beam.M))
        return BeamResultants(beam.s, N, Q, M, lambda: balance_of(name, beam))

    def balance_of(name: str, beam: BeamResultants) -> BeamBalance:
        balance = beam.balanced()
        ends, jumps = map(small.at_ends, (balance.ends, balance.jumps))
        if (slopes := small.slopes_at_ends(name, ends[0])) is not None:
            ends[1] = ends[0] + slopes
        return BeamBalance(balance.s, ends, balance.places, jumps)

    solution.resultants_of_beam = resultants_of_beam
    if small.error > _OUT_OF_BALANCE:
        _log.warning(
            "static: linear: few correct digits, if any: forces are out of balance by %.0e of the "
            "loads by rounding errors. Beams are far stiffer in tension or shear than in bending, "
            "or have very many elements. Take fewer elements, or smaller EA and GA",
            small.error,
        )
    return solution
