"""Joints and gears as C has them: tables, numbers, and a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.fem.mesh import rotation_of
from fx_beam.laws.rates import UpdateRule
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene

from .graph import Auxiliaries, Couplings
from .reduced_tangent import columns_of_slides

if TYPE_CHECKING:
    from .configuration import Configuration
    from .loops import Loops
    from .sliders import Sliders


class JointsInC:
    """The joints of a scene with `size` degrees of freedom, in C."""

    def __init__(
        self,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        sliders: Sliders | None,
        loops: Loops | None,
        rates: UpdateRule,
        size: int,
    ):
        self.couplings, self.auxiliaries, self.sliders = couplings, auxiliaries, sliders
        self.loops, self.size, self._rates = loops, size, rates
        #: Offsets and axes (2, joints, 2) of `Couplings.arm_joints`.
        self.arms = np.zeros((2, len(couplings.arm_joints), 2))
        self.set_arms(couplings.arm_joints)
        #: Weights of both terms of gears, and their sums at rest (gears, 3).
        self.gears = np.zeros((len(couplings.gears), 3))
        #: Tables by the names in c/problem.h, without positions in the tangent.
        self.members = self._tables()

    def set_arms(self, arm_joints: Sequence[Joint]) -> None:
        """Set the joints that move, in the same order: their offsets and axes."""
        offset, axis = self.arms
        for m, joint in enumerate(arm_joints):
            offset[m], axis[m] = joint.offset, (0.0, 0.0) if joint.axis is None else joint.axis

    def set_gears(self, scene: Scene) -> None:
        """Set the numbers of the gears of a scene."""
        for gear_numbers, numbers in zip(self.gears, numbers_of_gears(scene), strict=True):
            gear_numbers[:] = numbers

    @property
    def offsets_and_axes(self) -> dict[str, np.ndarray]:
        """Offsets and axes of joints that move, by the names in c/problem.h."""
        return dict(zip(("offset", "axis"), self.arms, strict=True))

    def _tables(self) -> dict[str, Any]:
        """The couplings by the names in c/problem.h, without positions in the tangent."""
        couplings, arm_joints = self.couplings, self.couplings.arm_joints
        entries = couplings.all_entries
        # Rows that follow through joint m: in x as 2 m, in y as 2 m + 1.
        below, through = entries.arms
        equal = (entries.value_at == 0) & (entries.sign == 1)
        entries = entries.take(np.argsort(~equal, kind="stable"))
        ends = [[rotation_of(node) for node in (joint.a, joint.b)] for joint in arm_joints]
        carrier, carried = np.array(ends, dtype=int).reshape(-1, 2).T
        return {
            "dofs": self.size,
            "columns": couplings.columns,
            "free": couplings.free,
            "driven": couplings.driven,
            "map": {
                "count": len(equal),
                "equal": np.count_nonzero(equal),
                "row": entries.row,
                **entries.members(),
            },
            "joints": {
                "count": len(arm_joints),
                "sign": couplings.sign[:2, [joint.number for joint in arm_joints]].T,
                "carrier": carrier,
                "carried_node": carried,
                "slide_column": columns_of_slides(couplings),
                "number": np.array([joint.number for joint in arm_joints], dtype=int),
                "track": np.array([joint.track.number for joint in arm_joints], dtype=int),
                "followers": len(below),
                "follower": below,
                "through": through,
                **self.offsets_and_axes,
            },
            "auxiliary": self.auxiliaries.members(),
            "loops": {} if self.loops is None else self.loops.members(),
            "gears": {} if self.loops is None else self.loops.gear_members(self.gears),
        }

    @cached_property
    def configuration(self) -> Configuration:
        """Joints in C."""
        from .configuration import Configuration

        slides = self.sliders.all if self.sliders else []
        sliders = {"count": len(slides), "slider": [slide.members() for slide in slides]}
        scheme = {"level": self._rates.level, **self._rates.constants}
        members = self.members | {"scheme": scheme, "sliders": sliders}
        return Configuration(members, self.couplings.sign.shape[1], slides)

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        unknowns = np.arange(self.couplings.free)
        return unknowns if self.loops is None else np.setdiff1d(unknowns, self.following)

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        if self.loops is None:
            return np.empty(0, dtype=int)
        return self.loops.columns[self.configuration.following]


def numbers_of_gears(scene: Scene) -> list[list[Any]]:
    """Weights and sum at rest of each gear that is a relation, with slopes."""
    ideal = [gear for gear in scene.gears if gear.is_ideal]
    return [[*(term.weight for term in gear.terms), gear.rest] for gear in ideal]
