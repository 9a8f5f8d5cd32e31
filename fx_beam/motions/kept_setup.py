"""The set-up of the last motion, which serves the next scene if only its numbers differ."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from fx_beam.array_calls import ArrayCalls, calling_with_arrays
from fx_beam.laws.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.substeps import Halving
from fx_beam.step.tape import LIMIT, Tape

from .mpi_ranks import waiting_team
from .run_setup import RunSetup

_KEPT: ContextVar[KeptSetup | None] = ContextVar("kept set-up", default=None)


class KeptSetup:
    """Sets scenes up, by the last set-up if they have its structure."""

    def __init__(self):
        self._setup: RunSetup | None = None
        self._options: tuple = ()
        self._lent: Callable[[], Any] = lambda: None
        #: What is known of the functions of its scenes.
        self.calls = ArrayCalls()
        #: Why the last scene was set up anew; empty if it was not.
        self.reason = ""
        #: How the last motion goes on for scenes with other numbers, if it may.
        self.repeated: Any = None
        #: Whether other motions may follow.
        self.lasts = False
        #: Whether solutions are read before anything else happens.
        self.reads_at_once = False
        #: Whether motions run on this process alone: several have no derivatives.
        self.alone = False
        #: Whether runs are taped, and the tape of the last one.
        self.tapes = False
        #: Largest memory of their rows [bytes].
        self.memory = LIMIT
        self.tape: Tape | None = None

    def of(
        self,
        scene: Scene,
        scheme: Scheme,
        newton: NewtonOptions | None,
        halving: Halving,
    ) -> RunSetup:
        """The set-up of a scene."""
        self.repeated = None
        options, known = (scheme, newton), self._options
        if self._setup is not None and not scheme.built_in:
            self._leave("the scheme has functions of your own, which may have changed")
        elif self._setup is not None and options != known:
            self._leave("another scheme, or other options")
        self._options = options
        setup = self.refilled(scene, halving)
        if setup is None:
            team = None if self.alone else waiting_team()
            setup = RunSetup(scene, scheme, newton, halving, team)
        return setup

    def refilled(self, scene: Scene, halving: Halving) -> RunSetup | None:
        """The last set-up with the numbers of a scene; None if this must be set up anew."""
        if self._setup is not None and self._lent() is not None:
            self._leave("the last solution is still in use")
        setup, self._setup = self._setup, None
        if setup is None:
            self.reason = self.reason or "the first scene"
            return None
        try:
            setup.refill(scene, halving)
        except OtherStructureError as other:
            self.reason = str(other)
            return None
        self.reason = ""
        return setup

    def _leave(self, reason: str) -> None:
        """Set the next scene up anew, for a reason."""
        self._setup, self.reason = None, reason

    def begin(self, setup: RunSetup) -> None:
        """Begin a run, on a tape if runs are taped."""
        loop, self.tape = setup.stepper.integrator, None
        if isinstance(loop, CompiledLoop):
            loop.tape = self.tape = Tape(loop.problem, self.memory) if self.tapes else None

    def keep(self, setup: RunSetup, solution: Solution) -> None:
        """Keep a set-up after its run. As long as the solution lives, it needs it."""
        self._setup, self._lent = setup, weakref.ref(solution.resultants_of_beam)

    @property
    def last(self) -> RunSetup | None:
        """The set-up of the last run."""
        return self._setup

    def forget(self) -> None:
        """Set the next scene up anew."""
        self._setup = None

    def put_back(self, setup: RunSetup) -> None:
        """Keep a set-up that has not run."""
        self._setup = setup


def kept_setup() -> KeptSetup:
    """The one that is in force here, or a new one that nobody keeps."""
    return _KEPT.get() or KeptSetup()


@contextmanager
def keeping_setup(kept: KeptSetup | None = None) -> Iterator[KeptSetup]:
    """Motions of this block use the set-up of the last one where the structure is the same.

    Functions are called with arrays where they accept them.
    """
    kept = kept or _KEPT.get() or KeptSetup()
    kept.lasts, before = True, _KEPT.set(kept)
    try:
        with calling_with_arrays(kept.calls):
            yield kept
    finally:
        _KEPT.reset(before)
