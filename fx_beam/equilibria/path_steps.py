"""Steps of a path of equilibria, by a model that serves other paths later."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import Equilibrium
from fx_beam.motions.prepared import stats_of
from fx_beam.motions.set_ups import model_for
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model
from fx_beam.step.turning_frame import TurningFrame

from .crossings import Crossings
from .load_steps import LoadStepper
from .static_options import StaticOptions

T = TypeVar("T")
# The scheme of all equilibria.
_AT_REST = Equilibrium()


class PathSteps:
    """Steps of a path of a scene whose inputs are set, and the model that takes them."""

    def __init__(self, scene: Scene, options: StaticOptions):
        self.options = options
        self._lease = model_for(scene, _AT_REST, settles=True)
        self.model: Model = (model := self._lease.model)
        self.stats = stats_of(model, solver="sparse lu", static=True)
        if options.continuation is not None and len(model.points.followed):
            raise SceneError(
                "static: arc-length steps do not find the force of a joint that its friction "
                "follows. Use load steps (without continuation), or fx_beam.SmoothFriction"
            )
        with model.lock:  # or else another thread may read with other numbers
            self._data = model.data
            #: Why the scene without loads is a mechanism; empty if it is none.
            self.mechanism = model.mechanism
            turning = TurningFrame(model, options.spin, options.pivot) if options.spin else None
            self.forcing = LoadForcing(model, options.t, turning)
            self._begin_steps()

    def _begin_steps(self) -> None:
        #: What takes the steps.
        self.stepper = LoadStepper(self.forcing, self.options, self.stats)
        self.crossings = Crossings(self.stepper)
        self.stepper.check = self.crossings.check

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """A block with the numbers of this path, whatever its model has served since."""
        model = self.model
        with model.reading(self._data, self.forcing.time):
            loop, held, present = self.stepper.loop, self.held, model.mechanism
            model.mechanism = self.mechanism
            try:
                if loop.problem.numbers.data is not self._data:  # a later path has what is in C
                    model.problems.pop(loop.problem.kind, None)
                    self._begin_steps()
                    self.stepper.path.held[:] = held
                yield
            finally:
                self.mechanism, model.mechanism = model.mechanism, present

    @property
    def held(self) -> np.ndarray:
        """Forces (free,) that hold the start, and fade as the loads rise."""
        return self.stepper.path.held

    def finished(self, find: Callable[[], T]) -> T:
        """What a function finds on this path, whose model serves others from then on."""
        try:
            with self.in_use():
                return find()
        finally:
            self._lease.end()
