# The names of the package and the files that define them, for type checkers and for __init__.py,
# which reads this file.

from . import materials as materials, plot as plot
from .derivatives.influence import InfluenceLines as InfluenceLines, influence as influence
from .derivatives.periodic_response import PeriodicResponse as PeriodicResponse
from .derivatives.response import Response as Response
from .derivatives.static_response import StaticResponse as StaticResponse
from .derivatives.vibration_response import (
    HarmonicResponse as HarmonicResponse,
    ModalResponse as ModalResponse,
)
from .equilibria.buckling import buckling as buckling
from .equilibria.critical_points import (
    Branch as Branch,
    CriticalPoint as CriticalPoint,
    imperfect as imperfect,
)
from .equilibria.statics import static as static
from .errors import Failure as Failure, SceneError as SceneError, StepError as StepError
from .laws.kinematics import Step as Step
from .laws.rates import (
    AtRest as AtRest,
    MidPointRates as MidPointRates,
    NewmarkRates as NewmarkRates,
    NodalRates as NodalRates,
)
from .laws.resultants import Resultants as Resultants, WeightedResultants as WeightedResultants
from .laws.schemes import (
    HHT as HHT,
    EnergyDecaying as EnergyDecaying,
    EnergyMomentum as EnergyMomentum,
    Equilibrium as Equilibrium,
    GeneralizedAlpha as GeneralizedAlpha,
    MidPoint as MidPoint,
    ModifiedMidPoint as ModifiedMidPoint,
    Newmark as Newmark,
    Scheme as Scheme,
)
from .linear.harmonic import frequency_response as frequency_response
from .linear.linear_system import LinearSystem as LinearSystem, linearise as linearise
from .linear.modal import modes as modes, rayleigh as rayleigh
from .motions.dynamics import simulate as simulate
from .motions.motion import Motion as Motion, Snapshot as Snapshot
from .orbits.periodic_search import (
    backbone as backbone,
    forced_response as forced_response,
    periodic as periodic,
)
from .results.envelopes import (
    BeamEnvelope as BeamEnvelope,
    Envelope as Envelope,
    envelope as envelope,
)
from .results.joint_and_contact_motion import (
    ContactMotion as ContactMotion,
    GearMotion as GearMotion,
    JointMotion as JointMotion,
    PullMotion as PullMotion,
)
from .results.records import (
    BeamResultants as BeamResultants,
    BeamStress as BeamStress,
    Energy as Energy,
    Stats as Stats,
)
from .results.saved import load as load
from .results.solution import Solution as Solution
from .results.vibrations import (
    BucklingModes as BucklingModes,
    FrequencyResponse as FrequencyResponse,
    Modes as Modes,
    Participation as Participation,
    PeriodicFamily as PeriodicFamily,
    PeriodicMotion as PeriodicMotion,
    SpectrumResponse as SpectrumResponse,
)
from .scene.beam import Beam as Beam, BeamPlace as BeamPlace, Node as Node
from .scene.body import Body as Body
from .scene.changes import Fuse as Fuse, Latch as Latch
from .scene.contacts import Circle as Circle, Contact as Contact, Line as Line
from .scene.coordinate import (
    Coordinate as Coordinate,
    Coulomb as Coulomb,
    Damper as Damper,
    SmoothFriction as SmoothFriction,
    Spring as Spring,
    Stop as Stop,
)
from .scene.curve import Curve as Curve, arc as arc, spline as spline
from .scene.forces_between import (
    Bed as Bed,
    ForceBetween as ForceBetween,
    GroundSpring as GroundSpring,
    GroundSprings as GroundSprings,
    Pulley as Pulley,
)
from .scene.functions import Input as Input
from .scene.gears import Gear as Gear, Rack as Rack
from .scene.joints import (
    GROUND as GROUND,
    Joint as Joint,
    PinInSlot as PinInSlot,
    Prismatic as Prismatic,
    Revolute as Revolute,
    Rigid as Rigid,
)
from .scene.law import InternalVariables as InternalVariables, Law as Law
from .scene.loads import Shaking as Shaking, thermal as thermal
from .scene.outputs import Output as Output
from .scene.scene import Scene as Scene
from .scene.section import Section as Section
from .scene.sliders import Sleeve as Sleeve, Slider as Slider
from .scene.ufl_symbols import Parameter as Parameter
from .step.newton import NewtonOptions as NewtonOptions
from .step.recorder import Record as Record
from .sweeps.convergence import Converged as Converged, converge as converge
from .sweeps.sweep import sweep as sweep

__version__: str
