"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from .accuracy import Mesh, Precision, Run
from .report import sentence, write
from .runner import study

__all__ = ["Mesh", "Precision", "Run", "sentence", "study", "write"]
