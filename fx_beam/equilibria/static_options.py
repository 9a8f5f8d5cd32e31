"""What a path of equilibria is asked for, checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fx_beam.errors import (
    SceneError,
    as_float,
    is_flag,
    is_number,
    is_one_of,
    is_whole,
    require,
    vector,
)
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.substeps import MOST_HALVINGS
from fx_beam.step.turning_frame import check_turns

from .branches import Branch

# Largest number of load steps.
_MOST_STEPS = 10_000_000


@dataclass(frozen=True, kw_only=True)
class StaticOptions:
    """Those of `static`; SceneError for all that can be refused without a scene."""

    load_steps: int = 10
    t: float = 0.0
    continuation: str | None = None
    newton: Any = None
    max_cuts: int = 8
    max_steps: int = 1000
    progress: bool | None = None
    inputs: Mapping[str, Any] | None = None
    spin: float = 0.0
    pivot: Sequence[float] = (0.0, 0.0)
    branches: int = 0

    def __post_init__(self):
        self.__dict__["newton"] = NewtonOptions() if self.newton is None else self.newton
        for name, least, most in (
            ("load_steps", 1, _MOST_STEPS),
            ("max_steps", 1, _MOST_STEPS),
            ("max_cuts", 0, MOST_HALVINGS),
            ("branches", 0, 10),
        ):
            fits = is_whole(getattr(self, name), least, most)
            self._require(name, fits, f"a whole number from {least} to {most:,}")
        self._require("t", is_number(self.t), "a finite number")
        fits = self.continuation is None or is_one_of(self.continuation, ("arc-length",))
        self._require("continuation", fits, '"arc-length" or None')
        self._require("newton", isinstance(self.newton, NewtonOptions), "an fx_beam.NewtonOptions")
        fits = self.progress is None or is_flag(self.progress)
        self._require("progress", fits, "True, False or None")
        self._require("spin", is_number(self.spin), "a finite number [rad/s]")
        vector(self.pivot, 2, "static: pivot")
        self.__dict__.update({name: as_float(getattr(self, name)) for name in ("t", "spin")})

    def _require(self, name: str, fits: bool, wanted: str) -> None:
        require(fits, f"static: {name}", getattr(self, name), wanted)

    def check(self, scene: Scene, start: Any) -> None:
        """Refuse a start that does not fit the other options, and what cannot turn."""
        if self.spin:
            check_turns(scene, "static: spin")
            if start is not None:
                raise SceneError(
                    "static: start with a spin: the loads of a turn rise from zero. Give all loads "
                    "at once, without start"
                )
        if isinstance(start, Branch) and self.continuation is None:
            raise SceneError('static: start is a branch. Follow it by continuation="arc-length"')
        if self.branches and (start is not None or self.spin):
            raise SceneError("static: branches are followed of paths without start and spin")
