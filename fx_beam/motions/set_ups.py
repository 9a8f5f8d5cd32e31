"""The programs of the latest scenes, and models of them for runs."""

from __future__ import annotations

from fx_beam.laws.schemes import Scheme
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError, Structure
from fx_beam.step.model import Model
from fx_beam.step.numbers import data_of
from fx_beam.step.program import Program

from .surroundings import call_with_arrays


class Programs:
    """The latest programs, by the structure of their scenes; threads may share them.

    At most so many; all of them together have at most `size` degrees of freedom.
    """

    def __init__(self, size: int = 25_000, most: int = 8):
        self.size, self._most = size, most
        # The latest one that was used is the last.
        self._programs: dict[tuple, Program] = {}

    def model_of(
        self, scene: Scene, scheme: Scheme, owned: bool = False, **options: bool
    ) -> tuple[Model, str]:
        """The model of a scene, and why it has a new program; empty if an earlier one serves.

        By `options` of `Model`. A large scene has a program only if its model is `owned`: by a
        caller who gives it the numbers of other scenes.
        """
        kind, structure = (scheme, *options.items()), Structure(scene)
        key, reason = (*kind, structure), ""
        program = self._programs.get(key)
        if program is not None:
            try:
                model = program.model_of(scene)
            except OtherStructureError as other:
                reason = str(other)
            else:
                self._keep(key, program)
                return model, ""
        model = Model(scene, scheme, **options)
        reason = reason or self._reason(kind, structure)
        is_large = model.size > self.size
        if is_large and not owned:
            return model, reason
        program = Program(model)
        if not is_large:
            self._keep(key, program)
        return program.model_of(scene), reason

    def clear(self) -> None:
        """Keep no program; runs that have one go on."""
        self._programs = {}

    def _keep(self, key: tuple, program: Program) -> None:
        """Have a program as the latest, and drop the earliest ones beyond a number and a size."""
        entries = [*self._programs.items()]
        if entries and entries[-1][1] is program:
            return
        others = [entry for entry in entries if entry[1] is not program]
        kept, size = [(key, program)], program.model.size
        for entry in others[::-1][: self._most - 1]:
            if (size := size + entry[1].model.size) > self.size:
                break
            kept.append(entry)
        self._programs = dict(kept[::-1])

    def _reason(self, kind: tuple, structure: Structure) -> str:
        """Why no program serves: how the latest of a kind differs that has as many parts."""
        for key, program in [*self._programs.items()][::-1]:
            other = program.model.structure
            if key[:-1] == kind and other.counts == structure.counts:
                return other.difference(structure)
        return "the first scene"


PROGRAMS = Programs()


def model_for(
    scene: Scene,
    scheme: Scheme,
    own: dict[str, Model] | None = None,
    name: str = "",
    **options: bool,
) -> Model:
    """A model of a scene, by `options` of `Model`.

    That of a `name` among models of the caller's `own`, if the scene has its structure: these get
    the numbers of scene after scene.
    """
    call_with_arrays(scene)
    if own is None:
        return PROGRAMS.model_of(scene, scheme, **options)[0]
    if (model := own.get(name)) is not None:
        try:
            model.set_numbers(data_of(model, scene))
        except OtherStructureError:
            pass
        else:
            return model
    own[name] = PROGRAMS.model_of(scene, scheme, owned=True, **options)[0]
    return own[name]
