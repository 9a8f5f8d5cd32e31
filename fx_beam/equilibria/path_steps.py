"""Steps of a path of equilibria."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.prepared import model_for, stats_of
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.turning_frame import TurningFrame

from .crossings import Crossings
from .load_steps import LoadStepper
from .static_options import StaticOptions

# The scheme of all equilibria.
_AT_REST = Equilibrium()


class PathSteps:
    """Steps of a path of a scene whose inputs are set, and the model that takes them."""

    def __init__(self, scene: Scene, options: StaticOptions):
        self.options = options
        self.model = model = model_for(scene, _AT_REST, settles=True)
        self.stats = stats_of(model, solver="sparse lu", static=True)
        if options.continuation is not None and len(model.points.normal_forces):
            raise SceneError(
                "static: arc-length steps do not find the force of a joint that its friction "
                "follows. Use load steps (without continuation), or fx_beam.SmoothFriction"
            )
        turning = TurningFrame(model, options.spin, options.pivot) if options.spin else None
        self.forcing = LoadForcing(model, options.t, turning)
        #: What takes the steps.
        self.stepper = LoadStepper(self.forcing, self.options, self.stats)
        self.crossings = Crossings(self.stepper)
        self.stepper.check = self.crossings.check_stability
        self.stepper.check_turn = self.crossings.check_turn

    @property
    def mechanism(self) -> str:
        """Why the scene without loads is a mechanism; empty if it is none."""
        return self.model.mechanism

    @property
    def held(self) -> np.ndarray:
        """Forces (free,) that hold the start, and fade as the loads rise."""
        return self.stepper.path.held
