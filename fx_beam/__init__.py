"""Geometrically exact planar beams and energy-conserving time stepping on FEniCSx."""

import importlib
import importlib.util
import sys
from importlib import metadata
from types import ModuleType
from typing import TYPE_CHECKING, Any

if importlib.util.find_spec("dolfinx") is None:
    raise ImportError(
        "fx_beam needs dolfinx 0.5, 0.9 or 0.11, which pip does not have: install Debian's "
        "python3-dolfinx and use Debian's /usr/bin/python3, or see https://fenicsproject.org/download",
        name="dolfinx",
    )

if TYPE_CHECKING:
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

# The files that are loaded when one of their names is first asked for.
_FILES = {
    "derivatives.response": "Response",
    "derivatives.static_response": "StaticResponse",
    "equilibria.branches": "Branch imperfect",
    "equilibria.critical_points": "CriticalPoint",
    "equilibria.statics": "static",
    "errors": "Failure SceneError StepError",
    "laws.kinematics": "Step",
    "laws.rates": "AtRest MidPointRates NewmarkRates NodalRates",
    "laws.resultants": "Resultants WeightedResultants",
    "laws.schemes": "HHT EnergyDecaying EnergyMomentum Equilibrium "
    "GeneralizedAlpha MidPoint ModifiedMidPoint Newmark Scheme",
    "linear.harmonic": "frequency_response",
    "linear.linear_system": "LinearSystem linearise",
    "linear.modal": "modes rayleigh",
    "motions.dynamics": "simulate",
    "motions.motion": "Motion",
    "motions.open_motion": "Snapshot",
    "orbits.periodic_search": "backbone forced_response periodic",
    "results.audit": "BeamResultants Energy Stats",
    "results.contact": "Contact",
    "results.joint_motion": "JointMotion",
    "results.saved": "load",
    "results.solution": "Solution",
    "results.vibrations": "FrequencyResponse Modes PeriodicFamily PeriodicMotion",
    "scene.beam": "Beam Node",
    "scene.body": "Body",
    "scene.changes": "Fuse Latch",
    "scene.coordinate": "Coordinate Coulomb Damper Friction Spring Stop",
    "scene.curve": "Curve arc spline",
    "scene.forces_between": "ForceBetween",
    "scene.inputs": "Input",
    "scene.internal_variables": "InternalVariables",
    "scene.joints": "GROUND Joint PinInSlot Prismatic Revolute Rigid",
    "scene.law": "Law",
    "scene.loads": "thermal",
    "scene.obstacles": "Circle Line Obstacle",
    "scene.outputs": "Output",
    "scene.parameters": "Parameter",
    "scene.scene": "Scene",
    "scene.section": "Section",
    "scene.sliders": "Sleeve Slider",
    "step.newton": "NewtonOptions",
    "step.recorder": "Record",
    "sweeps.convergence": "Converged converge",
    "sweeps.sweep": "sweep",
}
_HOMES = {name: f"{__name__}.{file}" for file, names in _FILES.items() for name in names.split()}
# Pictures, and studies.
_ROOMS = {
    "plot": "fx_beam.plot",
    "stability": "fx_beam.studies.stability",
    "work_precision": "fx_beam.studies.work_precision",
}


def __getattr__(name: str):
    if name in _ROOMS:
        return importlib.import_module(_ROOMS[name])
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _import_compilers()
    value = globals()[name] = getattr(importlib.import_module(_HOMES[name]), name)
    return value


def _import_compilers() -> None:
    """Import UFL and FFCx, which ask pkg_resources for their versions alone in Debian 12.

    Its own import takes longer than both of theirs.
    """
    if not {"ufl", "ffcx", "pkg_resources"} & set(sys.modules):
        stand_in: Any = ModuleType("pkg_resources")
        stand_in.get_distribution = metadata.distribution
        sys.modules["pkg_resources"] = stand_in
        try:
            for name in ("ufl", "ffcx"):
                importlib.import_module(name)
        finally:
            del sys.modules["pkg_resources"]


def __dir__():
    return sorted({*__all__, *_ROOMS, *(name for name in globals() if name.startswith("__"))})
