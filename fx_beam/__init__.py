"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import importlib
import importlib.util

if importlib.util.find_spec("dolfinx") is None:
    raise ImportError(
        "fx_beam needs dolfinx 0.5, 0.9 or 0.11, which pip does not have: install Debian's "
        "python3-dolfinx and use Debian's /usr/bin/python3, or see https://fenicsproject.org/download",
        name="dolfinx",
    )

from .derivatives.response import Response
from .derivatives.static_response import StaticResponse
from .equilibria.branches import Branch, imperfect
from .equilibria.critical_points import CriticalPoint
from .equilibria.statics import static
from .errors import Failure, SceneError, StepError
from .laws.kinematics import Step
from .laws.rates import AtRest, MidPointRates, NewmarkRates, NodalRates
from .laws.resultants import Resultants, WeightedResultants
from .laws.schemes import (
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
from .linear.harmonic import frequency_response
from .linear.linear_system import LinearSystem, linearise
from .linear.modal import modes, rayleigh
from .motions.dynamics import simulate
from .motions.motion import Motion
from .motions.open_motion import Snapshot
from .orbits.periodic_search import backbone, forced_response, periodic
from .results.audit import BeamResultants, Energy, Stats
from .results.contact import Contact
from .results.joint_motion import JointMotion
from .results.saved import load
from .results.solution import Solution
from .results.vibrations import FrequencyResponse, Modes, PeriodicFamily, PeriodicMotion
from .scene.beam import Beam, Node
from .scene.body import Body
from .scene.changes import Fuse, Latch
from .scene.coordinate import Coordinate, Coulomb, Damper, Friction, Spring, Stop
from .scene.curve import Curve, arc, spline
from .scene.forces_between import ForceBetween
from .scene.inputs import Input
from .scene.internal_variables import InternalVariables
from .scene.joints import GROUND, Joint, PinInSlot, Prismatic, Revolute, Rigid
from .scene.law import Law
from .scene.loads import thermal
from .scene.obstacles import Circle, Line, Obstacle
from .scene.outputs import Output
from .scene.parameters import Parameter
from .scene.scene import Scene
from .scene.section import Section
from .scene.sliders import Sleeve, Slider
from .step.newton import NewtonOptions
from .step.recorder import Record
from .sweeps.convergence import Converged, converge
from .sweeps.sweep import sweep

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
