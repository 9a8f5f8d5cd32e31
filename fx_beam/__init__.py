"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import importlib
import importlib.util

if importlib.util.find_spec("dolfinx") is None:
    raise ImportError(
        "fx_beam needs dolfinx 0.5, 0.9 or 0.11, which pip does not have: install Debian's "
        "python3-dolfinx and use Debian's /usr/bin/python3, or see https://fenicsproject.org/download",
        name="dolfinx",
    )

from .analyses.branches import Branch
from .analyses.convergence import Converged, converge
from .analyses.critical_points import CriticalPoint
from .analyses.dynamics import simulate
from .analyses.harmonic import FrequencyResponse, frequency_response
from .analyses.imperfection import imperfect
from .analyses.linear_system import LinearSystem, linearise
from .analyses.modal import Modes, modes
from .analyses.motion import Motion
from .analyses.rayleigh import rayleigh
from .analyses.snapshot import Snapshot
from .analyses.statics import static
from .analyses.sweep import sweep
from .errors import Failure, SceneError, StepError
from .mechanics.kinematics import Step
from .mechanics.nodal_rates import NodalRates
from .mechanics.rates import AtRest, MidPointRates, NewmarkRates, UpdateRule
from .mechanics.resultants import Resultants, WeightedResultants
from .mechanics.schemes import (
    HHT,
    EnergyDecaying,
    EnergyMomentum,
    Equilibrium,
    GeneralizedAlpha,
    MidPoint,
    ModifiedMidPoint,
    Newmark,
    Scheme,
)
from .orbits.backbone import backbone
from .orbits.forced_response import forced_response
from .orbits.periodic_family import PeriodicFamily
from .orbits.periodic_motion import PeriodicMotion
from .orbits.periodic_search import periodic
from .responses.response import Response
from .responses.static_response import StaticResponse
from .results.audit import BeamResultants, Energy, Stats
from .results.contact import Contact
from .results.joint_motion import JointMotion
from .results.saved import load
from .results.solution import Solution
from .scene.beam import Beam, Node
from .scene.body import Body
from .scene.changes import Fuse, Latch
from .scene.coordinate import Coordinate, Damper, Friction, Spring
from .scene.coulomb import Coulomb
from .scene.curve import Curve, arc, spline
from .scene.forces_between import ForceBetween
from .scene.inputs import Input
from .scene.internal_variables import InternalVariables
from .scene.joints import GROUND, Joint, PinInSlot, Prismatic, Revolute, Rigid
from .scene.law import Law
from .scene.natural_strains import thermal
from .scene.obstacles import Circle, Line, Obstacle
from .scene.outputs import Output
from .scene.parameters import Parameter
from .scene.scene import Scene
from .scene.section import Section
from .scene.sliders import Sleeve, Slider
from .scene.stop import Stop
from .stepping.newton import NewtonOptions
from .stepping.recorder import Record

__version__ = "0.1.0"

__all__ = [
    "GROUND",
    "HHT",
    "AtRest",
    "Beam",
    "BeamResultants",
    "Body",
    "Branch",
    "Circle",
    "Contact",
    "Coordinate",
    "Coulomb",
    "CriticalPoint",
    "Curve",
    "Damper",
    "Energy",
    "Converged",
    "EnergyDecaying",
    "EnergyMomentum",
    "Equilibrium",
    "Failure",
    "FrequencyResponse",
    "ForceBetween",
    "Friction",
    "Fuse",
    "GeneralizedAlpha",
    "Input",
    "InternalVariables",
    "Joint",
    "JointMotion",
    "Latch",
    "Law",
    "Line",
    "LinearSystem",
    "MidPoint",
    "MidPointRates",
    "ModifiedMidPoint",
    "NewmarkRates",
    "Modes",
    "Motion",
    "Newmark",
    "NewtonOptions",
    "NodalRates",
    "Node",
    "Obstacle",
    "Output",
    "Parameter",
    "PeriodicFamily",
    "PeriodicMotion",
    "PinInSlot",
    "Prismatic",
    "Record",
    "Response",
    "StaticResponse",
    "Resultants",
    "Revolute",
    "Rigid",
    "Scene",
    "SceneError",
    "Scheme",
    "Section",
    "Sleeve",
    "Slider",
    "Snapshot",
    "Solution",
    "Spring",
    "Stats",
    "Step",
    "StepError",
    "Stop",
    "UpdateRule",
    "WeightedResultants",
    "arc",
    "backbone",
    "converge",
    "forced_response",
    "frequency_response",
    "imperfect",
    "linearise",
    "load",
    "modes",
    "periodic",
    "rayleigh",
    "simulate",
    "spline",
    "static",
    "sweep",
    "thermal",
]


#: What is imported by those who ask for it: pictures, and studies.
_ON_DEMAND = {
    "plot": "fx_beam.plot",
    "stability": "fx_beam.studies.stability",
    "work_precision": "fx_beam.studies.work_precision",
}


def __getattr__(name: str):
    if name in _ON_DEMAND:
        return importlib.import_module(_ON_DEMAND[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted({*__all__, *_ON_DEMAND, *(name for name in globals() if name.startswith("__"))})
