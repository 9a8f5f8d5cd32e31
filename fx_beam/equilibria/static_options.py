"""Options of paths of equilibria."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fx_beam.errors import flag, is_one_of, real, vector, whole
from fx_beam.motions.options import CommonOptions
from fx_beam.step.substeps import MOST_HALVINGS

# Largest number of load steps.
_MOST_STEPS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class StaticOptions(CommonOptions):
    """Options of `static`; SceneError for all that can be refused without a scene."""

    what: str = "static"
    load_steps: int = whole(1, _MOST_STEPS, default=10)
    t: float = real(default=0.0)
    continuation: str | None = None
    max_cuts: int = whole(0, MOST_HALVINGS, default=8)
    max_steps: int = whole(1, _MOST_STEPS, default=1000)
    spin: float = real(default=0.0)
    pivot: Sequence[float] = (0.0, 0.0)
    branches: int = whole(0, 10, default=0)
    stop_at: str | None = None
    linear: bool = flag(default=False)

    def __post_init__(self):
        super().__post_init__()
        is_arc = is_one_of(self.continuation, ("arc-length",))
        self._require("continuation", self.continuation is None or is_arc, '"arc-length" or None')
        stops = self.continuation is not None and is_one_of(self.stop_at, ("limit point",))
        expected = '"limit point", with continuation="arc-length", or None'
        self._require("stop_at", self.stop_at is None or stops, expected)
        vector(self.pivot, 2, "static: pivot")
