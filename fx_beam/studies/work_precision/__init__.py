"""Error against run time: schemes, time steps and meshes compared on any scene and quantity."""

from .precision import Precision
from .report import sentence, write
from .run import Mesh, Run
from .runner import study

__all__ = ["Mesh", "Precision", "Run", "sentence", "study", "write"]
