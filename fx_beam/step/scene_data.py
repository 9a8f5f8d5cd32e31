"""All numbers of a scene by the indices of a set-up: the one path from a scene to its numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.fem.form_data import FormData
from fx_beam.fem.loads import SumOfLoads
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError


class Arms(NamedTuple):
    """Where joints that move lie, by their numbers; some of their axes are None."""

    numbers: list[int]
    vectors: list[Any]

    @classmethod
    def of(cls, scene: Scene) -> Arms:
        """Those of a scene."""
        joints = [joint for joint in scene.joints if not joint.is_selection]
        names = "arm", "offset", "axis", "apart"
        return cls([j.number for j in joints], [getattr(j, of) for j in joints for of in names])

    def are_at(self, others: Arms) -> bool:
        """Whether they lie where others do; OtherStructureError if these are not the same."""
        if self.numbers != others.numbers:
            raise OtherStructureError("other joints have offsets")
        return all(map(np.array_equal, self.vectors, others.vectors))


class Data(NamedTuple):
    """The numbers of a scene, with slopes that it has."""

    scene: Scene
    #: Positions (n, 2) of nodes [m].
    X: Any
    #: Of forms and of forces at points.
    forms: FormData
    #: Entries of the "mass", and the "weight" (size,) if there is gravity.
    masses: dict[str, Any]
    loads: SumOfLoads
    natural: SumOfLoads
    arms: Arms
    #: Joints with a motor, each with the name of its coordinate.
    motors: list[tuple[Joint, str]]

    @property
    def before_motors(self) -> Any:
        """Slides (driven,) in the reference, from which motors go on; 0 for other motions."""
        of_motors = [joint.start()[0] if name == "slide" else 0.0 for joint, name in self.motors]
        return np.append(np.zeros(len(self.scene.prescribed)), of_motors)
