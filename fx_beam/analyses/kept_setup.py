"""The set-up of the last motion, which serves the next scene if only its numbers differ."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from fx_beam.compiled.loop import CompiledLoop
from fx_beam.compiled.tape import LIMIT, Tape
from fx_beam.mechanics.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.stepping.newton import NewtonOptions
from fx_beam.stepping.substeps import Halving

from .run_setup import RunSetup

_KEPT: ContextVar[KeptSetup | None] = ContextVar("kept set-up", default=None)


class KeptSetup:
    """Sets scenes up, by the last set-up if they have its structure."""

    def __init__(self):
        self._setup: RunSetup | None = None
        self._options: tuple = ()
        self._lent: Callable[[], Any] = lambda: None
        #: Why the last scene was set up anew; empty if it was not.
        self.reason = ""
        #: Whether solutions are read before anything else happens.
        self.reads_at_once = False
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
        solver: str,
    ) -> RunSetup:
        """The set-up of a scene."""
        options, setup = (scheme, newton, solver), self._setup
        self._setup = None
        if setup is None:
            self.reason = "the first scene"
        elif self._lent() is not None:
            self.reason = "the last solution is still in use"
        elif not scheme.built_in:
            self.reason = "the scheme has functions of your own, which may have changed"
        elif options != self._options:
            self.reason = "another scheme, or other options"
        else:
            try:
                setup.refill(scene, halving)
                self.reason = ""
                return setup
            except OtherStructureError as other:
                self.reason = str(other)
        self._options = options
        return RunSetup(scene, scheme, newton, halving, solver)

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
    """Motions of this block use the set-up of the last one where the structure is the same."""
    kept = kept or _KEPT.get() or KeptSetup()
    before = _KEPT.set(kept)
    try:
        yield kept
    finally:
        _KEPT.reset(before)
