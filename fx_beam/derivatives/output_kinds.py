"""The kinds of outputs: each has its values, what it reads, and its derivatives in one class."""

from __future__ import annotations

from collections.abc import Iterable

from fx_beam.scene.beam import Beam
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model

from .energy_outputs import SINCE_START, EnergyOutput, WorkOutput
from .local_outputs import LineEnergyOutput, LocalOutput, PullOutput, ResultantOutput
from .row_output import Needs, RowOutput
from .section_outputs import SectionOutput


def kind_of(measured: Measured) -> type[RowOutput]:
    """The class of an output."""
    if isinstance(measured.place, Scene):
        return WorkOutput if measured.name in SINCE_START else EnergyOutput
    if isinstance(measured.place, Beam):
        return ResultantOutput
    if is_section_force(measured.output):
        return SectionOutput
    if measured.law_quantity:
        return PullOutput if measured.law_quantity == "pull" else LineEnergyOutput
    return LocalOutput


def needs_of(model: Model, outputs: Iterable[Measured]) -> Needs:
    """Needs of some outputs together."""
    needs = [Needs(), *(kind_of(measured).needs(model, measured) for measured in outputs)]
    return Needs(*map(any, zip(*needs, strict=True)))
