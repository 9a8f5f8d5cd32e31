"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from fx_beam.errors import answer_in_module

from .accuracy import Mesh, Precision, Run
from .report import sentence, write
from .runner import study

__all__ = ["Mesh", "Precision", "Run", "sentence", "study", "write"]
answer_in_module(globals())
