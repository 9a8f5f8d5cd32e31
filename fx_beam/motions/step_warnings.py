"""Warnings of what the steps of a motion did."""

from __future__ import annotations

import functools
import logging

from fx_beam.results.audit import Stats
from fx_beam.step.substeps import LARGE_TURN

_log = logging.getLogger("fx_beam")


def warn_of_parts(stats: Stats, dt: float) -> None:
    """Warn if steps were divided, and if they are too large for the motion."""
    if not stats.halvings:
        return
    text = f"{stats.steps} steps took {stats.substeps} sub-steps, since some failed and were halved"
    if stats.too_large:
        text += (
            f". dt = {dt:g} is too large for this motion: in {stats.too_large} sub-steps a node "
            f"turned by more than {LARGE_TURN:g} rad per step, so the motion may depend on "
            "rounding errors. Try a smaller dt"
        )
    _warn_once(f"{stats.scheme}: {text}")


@functools.lru_cache(maxsize=256)
def _warn_once(text: str) -> None:
    """Warn, but not in each of many equal runs: `Stats` has what the warning says."""
    _log.warning("%s", text)


def warn_of_damping(stats: Stats, dt: float | None) -> None:
    """Warn if sub-steps that go back in time amplified the motion."""
    if stats.amplified:
        _log.warning(
            "%s: in %d of %d steps damping added energy to the motion. One sub-step of the scheme "
            "goes back in time, and there damping amplifies. This happens if the damping rate is "
            "about 3 / dt%s. Try another dt, or order=2",
            *(stats.scheme, stats.amplified, stats.substeps),
            "" if dt is None else f" = {3 / dt:.3g} /s",
        )
