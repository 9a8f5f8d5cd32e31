"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import importlib

from .audit import BeamResultants, Energy, Stats
from .beam import Beam, Node
from .curve import Curve, arc, spline
from .dynamics import simulate
from .errors import SceneError, StepError
from .io import load
from .joint_motion import JointMotion
from .joints import (
    GROUND,
    Coordinate,
    Damper,
    Joint,
    PinInSlot,
    Prismatic,
    Revolute,
    Rigid,
    Spring,
)
from .kinematics import Step
from .modal import Modes, modes
from .newton import NewtonOptions
from .rates import AtRest, MidPointRates, NewmarkRates, Rates
from .recorder import Record
from .resultants import Resultants, WeightedResultants
from .scene import Scene
from .schemes import (
    HHT,
    EnergyMomentum,
    Equilibrium,
    GeneralizedAlpha,
    MidPoint,
    ModifiedMidPoint,
    Newmark,
    Scheme,
)
from .section import Law, Section
from .solution import Solution
from .statics import static

__all__ = [
    "GROUND",
    "HHT",
    "AtRest",
    "Beam",
    "BeamResultants",
    "Coordinate",
    "Curve",
    "Damper",
    "Energy",
    "EnergyMomentum",
    "Equilibrium",
    "GeneralizedAlpha",
    "Joint",
    "JointMotion",
    "Law",
    "MidPoint",
    "MidPointRates",
    "ModifiedMidPoint",
    "NewmarkRates",
    "Modes",
    "Newmark",
    "NewtonOptions",
    "Node",
    "PinInSlot",
    "Prismatic",
    "Rates",
    "Record",
    "Resultants",
    "Revolute",
    "Rigid",
    "Scene",
    "SceneError",
    "Scheme",
    "Section",
    "Solution",
    "Spring",
    "Stats",
    "Step",
    "StepError",
    "WeightedResultants",
    "arc",
    "load",
    "modes",
    "simulate",
    "spline",
    "static",
]


#: What is imported by those who ask for it: pictures, and studies.
_ON_DEMAND = "plot", "stability", "work_precision"


def __getattr__(name: str):
    if name in _ON_DEMAND:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *_ON_DEMAND})
