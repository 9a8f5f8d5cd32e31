"""The cache of what is set up for scenes: a set-up has one user, then serves the next scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from fx_beam.laws.schemes import Scheme
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.model import Model

from .surroundings import call_with_arrays

if TYPE_CHECKING:
    from fx_beam.step.program import Program


class SetUp(Protocol):
    """A model, or a prepared motion, that serves one scene after the other."""

    @property
    def size(self) -> int:
        """Number of degrees of freedom."""

    @property
    def readers(self) -> int:
        """Number of blocks in which something reads it."""


T = TypeVar("T", bound=SetUp)


class SetUps(Generic[T]):
    """Set-ups that wait for scenes, by kind; the earliest go beyond a size and a number.

    `size` is the sum of their degrees of freedom. Threads may share a cache.
    """

    def __init__(self, size: float = math.inf, most: int = 8):
        self.size, self._most = size, most
        # Kinds and set-ups that wait, the earliest first.
        self._waiting: list[tuple[Hashable, T]] = []
        # Kinds and set-ups in use, by ids of set-ups. They are referenced here, or else garbage
        # collection could close the libraries of one that a lease returns a moment later.
        self._used: dict[int, tuple[Hashable, T]] = {}

    def take(
        self, kind: Hashable, bind: Callable[[T], None], make: Callable[[], T]
    ) -> tuple[T, str]:
        """The last set-up of a kind after `bind`, or a new one and why no other one fits."""
        reason = ""
        for entry in self._waiting[::-1]:
            if entry[0] == kind and not entry[1].readers and self._take(entry):
                try:
                    bind(entry[1])
                except OtherStructureError as other:
                    reason = str(other)
                    break
                self._used[id(entry[1])] = entry
                return entry[1], ""
        if not reason:
            is_used = any(used == kind for used, _ in [*self._used.values()])
            reason = "the last set-up is still in use" if is_used else "the first scene"
        set_up = make()  # whose errors have no other cause
        self._used[id(set_up)] = kind, set_up
        return set_up, reason

    def _take(self, entry: tuple[Hashable, T]) -> bool:
        """Take out what waits; False if another thread was first."""
        try:
            self._waiting.remove(entry)
        except ValueError:
            return False
        return True

    def give_back(self, set_up: T) -> None:
        """Let a set-up wait for the next scene, if it is not too large."""
        entry, waiting = self._used.pop(id(set_up)), self._waiting
        if set_up.size <= self.size:
            waiting.append(entry)
        while len(waiting) > self._most:
            del waiting[:1]
        while len(waiting) > 1 and sum(other.size for _, other in waiting) > self.size:
            del waiting[:1]


#: Set-ups of all that is called by itself, from any thread.
RECENT: SetUps[Any] = SetUps(size=25_000)


class Programs:
    """The latest programs, by kind; any number of runs and threads use them at once."""

    def __init__(self, most: int = 8):
        self._most = most
        self._known: list[tuple[Hashable, Program]] = []
        # Kinds of scenes that are still bound to one model after the other.
        self._unserved: set[Hashable] = set()

    def find(self, kind: Hashable, run: Callable[[Program], T]) -> tuple[T | None, str]:
        """A run of the latest program that fits, or None and why the latest of its kind does not."""
        reason = ""
        for known, program in self._known[::-1]:
            if known == kind:
                try:
                    found = run(program)
                except OtherStructureError as other:
                    reason = reason or str(other)
                else:
                    # The latest one that was used is the last to go.
                    others = [entry for entry in self._known if entry[1] is not program]
                    self._known = [*others, (kind, program)]
                    return found, ""
        return None, reason

    def add(self, kind: Hashable, model: Model) -> Program | None:
        """The program of a model; None if such models cannot be shared yet."""
        from fx_beam.step.program import Program

        if model.size > RECENT.size:
            return None  # nobody else comes: a pattern beside the run would only take memory
        if not Program.serves(model):
            self._unserved.add(kind)
            return None
        program = Program(model)
        known = [*self._known, (kind, program)][-self._most :]
        while known and sum(other.model.size for _, other in known) > RECENT.size:
            del known[:1]
        self._known = known
        return program

    def serves(self, kind: Hashable) -> bool:
        """Whether scenes of a kind may have programs."""
        return kind not in self._unserved


PROGRAMS = Programs()


def kind_of(scene: Scene, *kind: object) -> Hashable:
    """A kind of set-ups for scenes with as many parts."""
    return *kind, len(scene.nodes), len(scene.beams), len(scene.joints), len(scene.bodies)


def bind(model: Model, scene: Scene) -> None:
    """Set all numbers of a model to those of another scene; OtherStructureError if it differs."""
    from fx_beam.step.numbers import data_of

    with model.lock:
        model.bind(data_of(model, scene))


class Lease:
    """A model of a scene for one user; it returns to `RECENT` as soon as no object has the lease.

    Or a new one, by `options` of `Model`.
    """

    def __init__(self, scene: Scene, scheme: Scheme, **options: bool):
        self._is_over = True
        # By all options, as those of `Model`.
        kind, model, made = kind_of(scene, type(scheme), *options.items()), None, None
        if scheme.built_in and PROGRAMS.serves(kind):
            model, _ = PROGRAMS.find(kind, lambda program: program.model_of(scene))
            if model is None:
                made = Model(scene, scheme, **options)
                if program := PROGRAMS.add(kind, made):
                    model = program.model_of(scene)
        if model is not None:
            self.model = model
            return
        #: The model.
        self.model = RECENT.take(
            kind_of(scene, type(scheme), *options),
            lambda model: bind(model, scene),
            lambda: made or Model(scene, scheme, **options),
        )[0]
        self._is_over = False

    def end(self) -> None:
        """Return the model, once: it may be in use by another lease since."""
        was_over, self._is_over = self._is_over, True
        if not was_over:
            RECENT.give_back(self.model)

    __del__ = end


def model_for(scene: Scene, scheme: Scheme, last: Lease | None = None, **options: bool) -> Lease:
    """The lease of a model for a scene: the `last` one if its owner has it for this structure."""
    call_with_arrays(scene)
    if last is not None and last.model.program is None:
        try:
            bind(last.model, scene)
            return last
        except OtherStructureError:
            last.end()
    return Lease(scene, scheme, **options)
