"""A scene and a scheme as compiled forms, constant matrices and unknowns."""

from __future__ import annotations

import math
from collections.abc import Callable
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.coupling.graph import Auxiliaries, Couplings, couple, motors
from fx_beam.coupling.reduction import Reduction, begin_to_build_joints
from fx_beam.coupling.sliders import Sliders
from fx_beam.dual import floats
from fx_beam.errors import SceneError, all_of
from fx_beam.fem.compiled_laws import PointFunction, compiled_rule
from fx_beam.fem.forms import Forms
from fx_beam.fem.loads import OnBeams, dead_loads, natural_strains
from fx_beam.fem.mass import Mass, about_centres, mobilities
from fx_beam.fem.mesh import build_mesh
from fx_beam.fem.scene_data import Arms, Data, form_data
from fx_beam.laws.interval import Interval, StepStart
from fx_beam.laws.rates import NodalRates
from fx_beam.laws.schemes import Scheme
from fx_beam.results.state import ROWS, State
from fx_beam.scene.beam import Beam
from fx_beam.scene.coordinate import Coulomb
from fx_beam.scene.joints import GROUND, Joint, NodalMotion, joints_by_number, slides_at_start
from fx_beam.scene.law import has_pieces
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import sliding_joints
from fx_beam.scene.structure import OtherStructureError, Structure

from .build import begin_to_build
from .flywheels import only_turn

if TYPE_CHECKING:
    from .sparse_lu import LU

# Mass of what has none in rates that fit joints, relative to the least mass that there is.
_LITTLE = 1e-8
# Degrees of freedom up to which a coupling is an array.
_SMALL = 200


class Model:
    """All data of a scene and a scheme that are constant over the steps.

    Vectors contain all degrees of freedom; `mesh.dofs` gives those of a node. With `mobile`, parts
    with mass need no supports, even if the scheme is static. With `instant`, its steps only serve
    to find derivatives of forces. A `part` of a scene is checked with the whole. A mechanism that
    its loads may hold is not refused if it `settles`.
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        mobile: bool = False,
        instant: bool = False,
        part: bool = False,
        settles: bool = False,
    ):
        self.scheme, self.mesh = scheme, build_mesh(scene)
        if not sliding_joints(scene.joints):
            begin_to_build(_probable_features(scene, scheme))
        if not all(joint.is_selection for joint in scene.joints):
            begin_to_build_joints()
        X = self.mesh.positions_of(scene)
        of_forms = form_data(scene, self.mesh, X, scheme.rates)
        self.forms = forms = Forms(scene, scheme, self.mesh, of_forms, instant)
        #: The forces at points.
        self.points = self.forms.points
        #: Number of degrees of freedom, and those that are rotations.
        self.size, self.turns = forms.size, self.mesh.dofs[:, 2]
        #: The mass of beams and lumped ones.
        self.masses = Mass(scene, self.mesh, forms.stiffness, forms.of_cells)
        #: Numbers of joints that were removed, or are not there yet.
        present = {*joints_by_number(scene), *(gear.number for gear in scene.gears)}
        self.removed_joints = sorted({*range(scene.joint_count)} - present)
        #: Held by the thread that makes what solutions have only when it is read.
        self.reading = RLock()
        #: Names of the compiled forms and of the assembled matrices and vectors.
        self.compiled = [] if self.forms.beams is None else [*self.forms.beams.bound]
        self.assembled = self.masses.assembled
        masses, arms = self.masses.numbers_of(scene, X), Arms.of(scene)
        loads = dead_loads(scene, self.mesh, self.mesh.X, self.weights(masses))
        natural = natural_strains(scene, self.mesh)
        data = Data(scene, X, of_forms, masses, loads, natural, arms, motors(scene))
        self._set(data)
        self._place(data)
        self.assembled += [str(load) for load in scene.loads]
        self.masses.name(scene)
        self._build_reduction()
        if sticks(scene) and not scheme.rates.at_rest:
            damped = form_data(scene, self.mesh, X, scheme.rates, self.mobility(data))
            self.data = data._replace(forms=damped)
            forms.bind(damped)
        #: The structure of the scene.
        self.structure = Structure(scene)
        self._weightless = scheme.rates.at_rest and not mobile
        self._settles = settles
        #: What C has of it, by what it is for.
        self.problems: dict[Any, Any] = {}
        if not part:
            self._check_mechanism()

    def _check_mechanism(self) -> None:
        #: Why the scene without loads is a mechanism; empty if it is none.
        self.mechanism = ""
        heavy = not self._weightless and not self.massless.any()
        if heavy or (self.scene.virtual_works and not self._settles):
            return
        from fx_beam.coupling.determinacy import check_no_massless_mechanism

        mass = None if self._weightless else self.mass
        try:
            check_no_massless_mechanism(self.scene, self.mesh, self.forms.of_members, mass)
        except SceneError as error:
            if not self._settles:
                raise
            self.mechanism = str(error).removesuffix(". Add a support")

    def check(self, data: Data) -> None:
        """OtherStructureError if data are of other kinds than the numbers that this has."""
        self.forms.check(data.forms)
        if data.masses is not self.data.masses:
            self.masses.check(data.masses)
        data.arms.are_at(self.data.arms)
        for known, new in ((self.loads, data.loads), (self.natural, data.natural)):
            if new is not known:
                known.check(new)

    def lies_at(self, data: Data) -> bool:
        """Whether nodes and joints are where data have them, or nothing depends on it."""
        # Joints first: they also say whether others have offsets.
        return data.arms.are_at(self.data.arms) and all_of(floats(data.X) == self.mesh.X)

    def bind(self, data: Data) -> None:
        """Set all numbers, as if this were set up anew; OtherStructureError, then nothing is set.

        What was assembled for the last scene changes in place.
        """
        elsewhere = not self.lies_at(data)
        if elsewhere and self.needs_places:
            raise OtherStructureError("joints that close loops, or slide on beams, lie elsewhere")
        self._set(data)
        if elsewhere:
            self._place(data)
        if self.couplings.arm_joints:
            self.reduction.set_arms(self.arm_joints)
        if self.couplings.gears:
            self.reduction.set_gears(data.scene)
        self.forms.bind(data.forms)
        # In statics without joints and forces between nodes places alone tell mechanisms.
        scene = data.scene
        by_places = self._weightless and not (scene.joints or scene.forces_between)
        if elsewhere or scene.drags or (self.scheme.rates.at_rest and not by_places):
            self._check_mechanism()

    def _set(self, data: Data) -> None:
        #: The numbers that it has now, and their scene.
        self.data, self.scene = data, (scene := data.scene)
        acting = tuple(scene.beams), tuple(scene.loads), scene.gravity, scene.array_calls
        #: What section forces need, whatever becomes of the scene.
        self.on_beams = OnBeams(*acting)
        self.masses.bind(data.masses)
        #: Dead loads and natural strains.
        self.loads, self.natural = data.loads, data.natural

    def _place(self, data: Data) -> None:
        self.mesh.bind(floats(data.X))
        #: Size (size,) of unit increments: that of the scene for displacements, 1 for rotations.
        self.unit = np.full(self.mesh.dofs.size, self.mesh.size)
        self.unit[2::3] = 1.0

    def weights(self, masses: dict[str, Any]) -> Callable[[Any], Any]:
        """Weights (size,) of all masses by an acceleration (2,), as a function."""
        return lambda acceleration: self.masses.weights(acceleration, masses["mass"])

    def mobility(self, data: Data) -> np.ndarray:
        """1 / mass that moves with each degree of freedom, then with each slide; 0 without mass.

        Of displacements that in the direction in which the node moves most easily. By the diagonal
        of the reduced mass in the reference; what is free moves about its centre of mass, unless
        nodes slide on beams.
        """
        scene, couplings, reduction = data.scene, self.couplings, self.reduction
        arms = reduction.arms.copy()
        reduction.set_arms(moving_in(scene, couplings))
        reduction.begin(np.zeros(self.size), slides_at_start(scene))
        closed = not reduction.singularity
        # Operations on small arrays are quick, those on sparse ones take 0.1 ms.
        if self.size <= _SMALL:
            T = reduction.coupling_array(closed)[:, : couplings.free]
        else:
            T = scipy.sparse.csr_array(reduction.coupling(closed)[:, : couplings.free])
        reduction.arms[...] = arms
        mass = self.masses.of(floats(data.masses["mass"]))
        if not (couplings.is_selection or couplings.sliding):
            roots = np.isin(np.arange(couplings.free), couplings.column[self.mesh.dofs[:, :2]])
            T = about_centres(T, roots, mass.diagonal())
        of_unknowns, of_dofs = mobilities(T, mass)
        of_slides = couplings.free_slides(of_unknowns, scene.joint_count)
        return np.concatenate([of_dofs, of_slides])

    def start_of(self, state: State, length: float) -> StepStart:
        """The start of a step of some length [s] from a state, for the forces.

        Natural strains do not change in the step.
        """
        # At mid-step forces at points depend on mean rates alone.
        needed = self.scheme.rates.level != 0.5 and not self.scheme.rates.at_rest
        rates = self.slide_rates(state) if needed else 0 * state.slides
        of_nodes = state.q, state.v, state.a, state.q_previous, state.memory(length)
        of_joints = state.slides, rates, state.spring_internal
        natural = None if state.natural is None else (state.natural, state.natural)
        return StepStart(*of_nodes, state.internal, *of_joints, natural=natural)

    def added_force(self, state: State, factor: float, time: float) -> np.ndarray:
        """Followers and added virtual works (size,) of a state at a load factor [N, N m]."""
        zero = np.zeros(self.size)
        if not self.forms.has_added:
            return zero
        self.forms.set_load(factor)
        self.forms.begin(Interval(time, time), self.start_of(state, 0.0))
        self.forms.internal_force(zero)
        return self.forms.added_force()

    def slide_rates(self, state: State) -> np.ndarray:
        """Rates (joints,) of the slides on which forces act; zero for others."""
        rates = np.zeros(len(state.slides))
        if len(self.points.slides):
            motion = self.motion(q=state.q[None], v=state.v[None])
            joints = joints_by_number(self.scene)
            for number in set(self.points.slides.tolist()):
                kinematics = joints[number].kinematics
                (rates[number],) = kinematics.rate(motion, state.slides[[number]])
        return rates

    @property
    def mass(self) -> scipy.sparse.csr_matrix:
        """The constant mass matrix, assembled at the first access."""
        return self.masses.matrix

    @property
    def may_overshoot(self) -> bool:
        """Whether corrections of Newton's method may be far too long.

        In motions the force of a contact over a step is smooth and convex.
        """
        internal = self.forms.internal_shape[-1] > 0
        statics_with_contact = self.scheme.rates.at_rest and self.has_contact
        return internal or self.points.any_have("needs_line_search") or statics_with_contact

    @property
    def flows(self) -> bool:
        """Whether members or springs have internal variables."""
        return self.forms.internal_shape[-1] > 0 or self.points.width > 0

    @property
    def has_potential(self) -> bool:
        """Whether all forces have a potential in statics: nothing follows the motion or flows."""
        own = any(force.force for force in self.scene.forces_between)
        return not (self.forms.has_added or own or self.flows)

    @cached_property
    def nonsmooth(self) -> bool:
        """Whether the slopes of forces may change at once: flow, contact, functions of a user."""
        bends = self.bends or self.points.any_have("needs_line_search")
        return bends or self.flows or self.has_contact

    @property
    def bends(self) -> bool:
        """Whether members or virtual works have functions of a user, which may have kinks."""
        energies = (beam.section.strain_energy for beam in self.scene.beams)
        return any(energies) or bool(self.scene.virtual_works)

    @property
    def has_contact(self) -> bool:
        """Whether there are obstacles or stops."""
        return self.points.any_have("unilateral")

    def switches(self, state: State) -> np.ndarray:
        """Values that change their sign where a contact opens or closes, or a law switches."""
        self.forms.parameters.use(state.parameters)
        return self.forms.in_c.switches(state.q, state.slides)

    def flowed(self, before: State, behind: State) -> bool:
        """Whether something flows, or sticks, between two states."""
        names = "internal", "spring_internal"
        return not all(np.array_equal(getattr(before, n), getattr(behind, n)) for n in names)

    def switched(self, before: State, behind: State) -> bool:
        """Whether a contact opens or closes, or a law switches: members that are near may touch."""
        members, signs = self.points.members, [np.sign(self.switches(s)) for s in (before, behind)]
        return (members is not None and members.are_near) or not np.array_equal(*signs)

    def begins(self, before: State, behind: State) -> bool:
        """Whether flow or contact may begin or end in a step, which its predictor does not know."""
        return self.flowed(before, behind) or (self.has_contact and self.switched(before, behind))

    @property
    def has_unseen_kinks(self) -> bool:
        """Whether forces may change quickly where no switch tells: sections' laws, flow, losses."""
        # Friction, contact with a loss, and dampers with laws of a user lose quickly.
        laws = self.points.laws
        quick = (law.iteration_memory or (law.loss and law.user_defined) for law in laws)
        energies = [beam.section.strain_energy for beam in self.scene.beams]
        in_pieces = (energy is not None and has_pieces(energy) for energy in energies)
        return self.flows or any(quick) or any(in_pieces)

    def energy(self, state: State) -> float:
        """Kinetic, stored and potential energy [J]."""
        return float(sum(self.energies(state)))

    def energies(self, state: State) -> tuple[float, ...]:
        """Energies [J]: kinetic, of beams, potential, and of springs, stops and obstacles."""
        self.forms.parameters.use(state.parameters)
        strained = self.forms.strain_energy(state.q, state.internal, state.natural)
        stored = self.forms.in_c.energy(state.q, state.slides, state.spring_internal)
        potential = 0.0 if self.weight is None else -(self.weight @ state.q)
        kinetic = state.v @ (self.mass @ state.v) / 2 if state.v.any() else 0.0
        return kinetic, strained, potential, stored

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Lengths of the arrays of a state, by their names in `StateArray.shape`."""
        cells, points, variables = self.forms.internal_shape
        return {
            "dofs": self.size,
            "joints": self.scene.joint_count,
            "lines": self.scene.force_count,
            "constraints": self.reduction.columns - self.reduction.free,
            "contacts": self.points.contacts,
            "parameters": len(self.forms.parameters),
            "added dofs": self.size if self.forms.has_added else 0,
            "kept dofs": self.size if self.keeps_previous else 0,
            "cells": cells,
            "points": points,
            "variables": variables,
            "spring variables": self.points.width,
            "natural strains": 3 * bool(self.natural),
        }

    @cached_property
    def widths(self) -> dict[str, int]:
        """Numbers in a row of each recorded quantity."""
        return {name: math.prod(quantity.lengths(self.sizes)) for name, quantity in ROWS.items()}

    @cached_property
    def nodal_rules(self) -> list[PointFunction]:
        """The nodal rules of the rates, if they are those of a user."""
        rates: Any = self.scheme.rates
        of_user = rates.rules if isinstance(rates, NodalRates) else ()
        return [compiled_rule(rates, rule) for rule in of_user]

    @property
    def keeps_previous(self) -> bool:
        """Whether a step needs the configuration at the start of the last one."""
        return self.forms.needs_previous or self.scheme.rates.user_defined

    @cached_property
    def factors_of_mass(self) -> LU:
        """Factors for matrices of the reduced pattern, in which the mass of unknowns is one."""
        from .sparse_lu import LU

        return LU(self.reduction.tangent.pattern)

    @property
    def error_unit(self) -> np.ndarray:
        """The same (size,) for errors: rotations that displace something are seen there.

        In fast vibrations nodes of beams turn, but are hardly displaced.
        """
        unit = self.unit.copy()
        unit[self.turns[~only_turn(self.scene, self.mesh)]] = np.inf
        return unit

    @cached_property
    def needs_accelerations(self) -> bool:
        """Whether steps, or unknowns without mass, need the accelerations at the start."""
        by_mean, beams = self.scheme.rates.mean_based, self.forms.beams
        read = beams is not None and (beams.facts.needs_rates or beams.facts.resultants_need_rates)
        if read or not by_mean or len(self.scheme.fractions) > 1:
            return True
        return not self.reduction.moves_alone(~self.massless).all()

    @property
    def finds_accelerations_later(self) -> bool:
        """Whether those at the start need not be known before the run, and depend on no joints."""
        of_state = self.fits_rates or bool(self.natural)
        return self.couplings.is_selection and not (of_state or self.needs_accelerations)

    @cached_property
    def massless(self) -> np.ndarray:
        """Whether neither a degree of freedom has mass nor one that moves as it does, (size,)."""
        heavy = self.mass.diagonal() > 0
        if heavy.all():
            return ~heavy
        self.reduction.begin(np.zeros(self.size), slides_at_start(self.scene))
        # Those that are equal have equal rates, whatever those of the columns are.
        rates = self.reduction.to_nodes(np.random.default_rng(0).random(self.reduction.columns))
        return ~np.isin(rates, rates[heavy])

    def little_mass(self) -> np.ndarray:
        """Small masses and inertias (size,) of the degrees of freedom that have none, for fits."""
        inertia = self.mass.diagonal() * self.unit**2
        least = inertia[inertia > 0].min() if inertia.any() else 1.0
        little = np.where(inertia > 0, 0.0, _LITTLE * least / self.unit**2)
        for joint in self.scene.joints:  # what is rigid with a mass needs none
            if joint.is_rigid and GROUND not in (joint.a, joint.b):
                a, b = (self.mesh.dofs[node.number] for node in (joint.a, joint.b))
                if inertia[a].all():
                    little[b] = 0.0
        return little

    @property
    def unit_of_unknowns(self) -> np.ndarray:
        """Size of a unit increment of each unknown (free,); compare `unit`."""
        couplings, turns = self.couplings, np.zeros(self.size, dtype=bool)
        turns[self.turns] = True
        unit = np.full(couplings.columns + len(couplings.auxiliaries), self.mesh.size)
        entries = couplings.all_entries
        unit[entries.column[turns[entries.row]]] = 1.0
        for auxiliary in couplings.auxiliaries:
            if turns[auxiliary.dof]:
                unit[[entry[0] for entry in auxiliary.entries]] = 1.0
        return unit[: couplings.free]

    @property
    def arm_joints(self) -> list[Joint]:
        """Joints with an arm or a slide, in the order of the couplings, as the scene has them."""
        return moving_in(self.scene, self.couplings)

    @property
    def motors(self) -> list[tuple[Joint, str]]:
        """Joints with a motor, each with the name of its coordinate."""
        return self.data.motors

    @property
    def needs_places(self) -> bool:
        """Whether joints close loops, or slide on beams: these are set up for their places."""
        return bool(self.couplings.closures or self.couplings.sliding)

    @property
    def weight(self) -> np.ndarray | None:
        """Weight (size,) [N] of all masses; None without gravity."""
        return self.masses.weight

    def _build_reduction(self) -> None:
        """Build the unknowns and the reduction to them, by supports and joints."""
        scene, matrix = self.scene, self.forms.stiffness
        self.couplings = couple(scene, self.mesh)
        # Couplings that change with the motion.
        turning = any(not (joint.is_selection or joint.a is GROUND) for joint in scene.joints)
        turning |= bool(self.couplings.gears)  # as rates are 4 / dt tan(Dpsi / 2)
        #: Whether rates by the mean rule must be fitted to joints and driven motions.
        self.fits_rates = self.scheme.rates.mean_based and (turning or self.couplings.driven > 0)
        keys, driven = [*scene.prescribed, *sorted(scene.fixed)], len(scene.prescribed)
        nodes, components = np.reshape(np.array(keys, dtype=int), (-1, 2)).T
        columns = np.arange(len(keys))
        columns[driven:] += len(self.motors)  # which are between
        self.prescribed = (3 * nodes + components)[:driven]
        of_nodes, of_motors = np.full(self.mesh.dofs.shape, -1), np.full(scene.joint_count, -1)
        of_nodes[nodes, components] = columns
        of_motors[[joint.number for joint, _ in self.motors]] = driven + np.arange(len(self.motors))
        #: Columns, driven or fixed, whose forces histories have; -1 where there is none.
        self.force_columns = {"reactions": of_nodes, "motor_forces": of_motors}
        self.forms.in_c.set_columns(self.couplings.slides)
        if self.flows and min(self.scheme.fractions) < 0:
            raise SceneError(
                f"{self.scheme.name}: the sub-step that goes back in time would give back what "
                "internal variables of a section or of a spring, or friction that sticks, have "
                "dissipated. Use order=2"
            )
        sliders = Sliders(scene, self.couplings, self.mesh)
        used, auxiliaries = self.used_entries(), Auxiliaries(self.couplings)
        parts = self.couplings, auxiliaries, self.forms.in_c, self.scheme.rates, matrix, used
        loops = None
        if self.couplings.closures:
            from fx_beam.coupling.loops import Loops

            loops = Loops(self.couplings, auxiliaries, self.unit_of_unknowns, sliders)
        self.reduction = Reduction(*parts, sliders, loops)
        self.reduction.set_gears(scene)
        made_later = any(joint.place for joint in scene.joints) or any(g.value for g in scene.gears)
        if loops is not None and not made_later:
            from fx_beam.coupling.determinacy import check_loops

            self.reduction.begin(np.zeros(self.size), slides_at_start(scene))
            check_loops(scene, self.reduction, loops)
        if not self.couplings.is_selection:
            self.assembled.append("joints")

    def used_entries(self) -> np.ndarray:
        """Whether an entry of the tangent may be other than zero: at many points of bodies none is.

        The sparsity has all entries of nodes without beams.
        """
        forms, K = self.forms, self.forms.stiffness
        used = np.zeros(K.nnz, dtype=bool)
        used[forms.of_cells] = True
        if self.scheme.rates.user_defined:  # they may couple the components at a node
            return np.ones_like(used)
        masses = np.array([(m, m, inertia) for _, m, inertia in self.scene.masses]).ravel()
        used[self.masses.entries_of_nodes[masses != 0]] = True
        value_at = forms.points.value_at
        used[value_at[value_at >= 0]] = True
        if self.fits_rates:
            used[self.masses.diagonal[self.little_mass() > 0]] = True
        return used

    def motion(self, **histories: np.ndarray) -> NodalMotion:
        """How joints read the motion: histories (n, size) "q" and "v"."""
        count = len(self.mesh.X)
        at_nodes = {name: rows.reshape(-1, count, 3) for name, rows in histories.items()}
        return NodalMotion(
            lambda name, node: at_nodes[name][:, node.number].T,
            lambda name, beam: at_nodes[name][:, self.mesh.nodes_of(self.scene, beam)],
        )


def sticks(scene: Scene) -> bool:
    """Whether a scene has friction that sticks, which is damped by the masses that it holds."""
    coordinates = [c for joint in scene.joints for c in joint.coordinates.values()]
    frictions = [getattr(part, "friction", None) for part in (*scene.contacts, *coordinates)]
    return any(isinstance(friction, Coulomb) for friction in frictions)


def moving_in(scene: Scene, couplings: Couplings) -> list[Joint]:
    """Joints of a scene with an arm or a slide, in the order of the couplings."""
    joints = joints_by_number(scene)
    return [joints[joint.number] for joint in couplings.arm_joints]


def _probable_features(scene: Scene, scheme: Scheme) -> str:
    """What the library for most scenes of a kind has (c/scene_features.h)."""
    if any(isinstance(obstacle.shape, Beam) for obstacle in scene.contacts):
        return "MEMBERS"
    if scheme.rates.at_rest:
        return "0"
    return "BAND" if scene.beams and (scene.joints or scene.beams[0].degree > 1) else "CHAIN"
