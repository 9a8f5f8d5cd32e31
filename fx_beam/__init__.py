"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

from .audit import BeamResultants, Energy, Stats
from .beam import Beam, Node
from .dynamics import simulate
from .errors import SceneError, StepError
from .kinematics import Step
from .newton import NewtonOptions
from .rates import MidPointRates, NewmarkRates, Rates
from .resultants import Resultants, WeightedResultants
from .scene import Scene
from .schemes import (
    HHT,
    EnergyMomentum,
    GeneralizedAlpha,
    MidPoint,
    ModifiedMidPoint,
    Newmark,
    Scheme,
)
from .section import Law, Section
from .solution import Solution, load

__all__ = [
    "HHT",
    "Beam",
    "BeamResultants",
    "Energy",
    "EnergyMomentum",
    "GeneralizedAlpha",
    "Law",
    "MidPoint",
    "MidPointRates",
    "ModifiedMidPoint",
    "NewmarkRates",
    "Newmark",
    "NewtonOptions",
    "Node",
    "Rates",
    "Resultants",
    "Scene",
    "SceneError",
    "Scheme",
    "Section",
    "Solution",
    "Stats",
    "Step",
    "StepError",
    "WeightedResultants",
    "load",
    "simulate",
]
