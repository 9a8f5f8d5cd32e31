"""A scene and a scheme as compiled forms, constant matrices and unknowns."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from threading import RLock
from typing import Any, TypeVar

import numpy as np
import scipy.sparse

from fx_beam.content_cache import shallow_copy
from fx_beam.coupling.graph import Auxiliaries, Couplings, couple, joints_with_arms, motors
from fx_beam.coupling.reduction import Reduction, begin_to_build_joints, numbers_of_gears
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import SceneError
from fx_beam.fem.forms import FormData, Forms, SceneArrays, arms_of, form_data
from fx_beam.fem.functions_of_time import LoadedBeams, dead_loads, natural_strains
from fx_beam.fem.mass import MassMatrix, about_centres, mobilities
from fx_beam.fem.mesh import Mesh, build_mesh, connected_parts
from fx_beam.laws.rates import NewmarkRates
from fx_beam.laws.schemes import Scheme
from fx_beam.results.state import ROWS, State
from fx_beam.scene.beam import Beam
from fx_beam.scene.coordinate import Coulomb
from fx_beam.scene.joints import GROUND, slides_at_start
from fx_beam.scene.law import has_pieces
from fx_beam.scene.parts import Parts
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import sliding_joints
from fx_beam.scene.structure import OtherStructureError, Structure

from .build import begin_to_build

# -- Sizes of unit increments, how easily they move, and little masses of what has none ---------


# Mass of what has none in rates that fit joints, relative to the least mass that there is.
_LITTLE = 1e-8
# Degrees of freedom up to which a coupling is an array.
_SMALL = 200


class Units:
    """Unit increments: the size of a mesh for displacements, 1 for rotations."""

    def __init__(self, mesh: Mesh, couplings: Couplings):
        self._mesh = mesh
        #: Sizes (size,) of unit increments of degrees of freedom.
        self.nodes = np.full(mesh.dofs.size, mesh.size)
        self.nodes[2::3] = 1.0
        turns = np.zeros(couplings.columns + len(couplings.auxiliaries), dtype=bool)
        entries = couplings.all_entries
        turns[entries.column[entries.row % 3 == 2]] = True
        for auxiliary in couplings.auxiliaries:
            if auxiliary.dof % 3 == 2:
                turns[[entry[0] for entry in auxiliary.entries]] = True
        #: Which unknowns (free,) are rotations, and sizes (free,) of their unit increments.
        self.turns = turns[: couplings.free]
        self.unknowns = np.where(self.turns, 1.0, mesh.size)

    def errors(self, scene: Scene) -> np.ndarray:
        """Sizes (size,) of errors: rotations that displace something are seen as displacements.

        In fast vibrations nodes of beams turn, but are hardly displaced.
        """
        unit = self.nodes.copy()
        unit[self._mesh.turns[~only_turn(scene, self._mesh)]] = np.inf
        return unit


def turning_together(scene: Scene) -> np.ndarray:
    """Pairs (n, 2) of nodes that joints let turn together only; -1 is the ground."""
    pairs = [(joint.a.number, joint.b.number) for joint in scene.joints if joint.turns_together]
    return np.reshape(pairs, (-1, 2)).astype(int)


def only_turn(scene: Scene, mesh: Mesh) -> np.ndarray:
    """Which nodes (n,) are in no element, and turn together with none that is or lies elsewhere."""
    pairs = turning_together(scene)
    pairs = pairs[(pairs >= 0).all(axis=1)]
    displacing = np.zeros(len(mesh.X), dtype=bool)
    displacing[mesh.elements.ravel()] = True
    geared = {node.number for gear in scene.gears if gear.is_ideal for node in gear.nodes}
    displacing[[number for number in geared if number >= 0]] = True  # which the others follow
    apart = (mesh.X[pairs[:, 0]] != mesh.X[pairs[:, 1]]).any(axis=1)
    displacing[pairs[apart].ravel()] = True
    part = connected_parts(pairs.T, len(displacing))
    return ~np.bincount(part, displacing).astype(bool)[part]


def little_mass(
    mass: scipy.sparse.csr_matrix, unit: np.ndarray, scene: Scene, mesh: Mesh
) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none, for fits."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    little = np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)
    for joint in scene.joints:  # what is rigid with a mass needs none
        if joint.is_rigid and GROUND not in (joint.a, joint.b):
            a, b = (mesh.dofs[node.number] for node in (joint.a, joint.b))
            if inertia[a].all():
                little[b] = 0.0
    return little


def mobility(
    data: SceneArrays, mass: scipy.sparse.csr_matrix, reduction: Reduction, mesh: Mesh
) -> np.ndarray:
    """1 / mass that moves with each degree of freedom, then with each slide; 0 without mass.

    Of displacements that in the direction in which the node moves most easily. By the diagonal
    of the reduced mass in the reference; what is free moves about its centre of mass, unless
    nodes slide on beams.
    """
    scene, couplings, size = data.scene, reduction.couplings, mesh.dofs.size
    joints = reduction.joints
    arms, gears = joints.arms.copy(), joints.gears.copy()
    joints.set_numbers(data.arms, data.gears)
    reduction.set_start(np.zeros(size), slides_at_start(scene))
    closed = not reduction.singularity
    # Operations on small arrays are quick, those on sparse ones take 0.1 ms.
    if size <= _SMALL:
        T = reduction.maps.coupling_array(closed)[:, : couplings.free]
    else:
        T = scipy.sparse.csr_array(reduction.maps.coupling(closed)[:, : couplings.free])
    joints.arms[...], joints.gears[...] = arms, gears
    if not (couplings.is_selection or couplings.sliding):
        roots = np.isin(np.arange(couplings.free), couplings.column[mesh.dofs[:, :2]])
        T = about_centres(T, roots, mass.diagonal())
    unknown_mobility, dof_mobility = mobilities(T, mass)
    slide_mobility = couplings.free_slides(unknown_mobility, scene.joint_count)
    return np.concatenate([dof_mobility, slide_mobility])


# -- A scene and a scheme as compiled forms, constant matrices and unknowns ---------------------


T = TypeVar("T")


class Kinks:
    """Conditions on which slopes of the forces depend besides small changes of the state."""

    def __init__(self, scene: Scene, forms: Forms, at_rest: bool):
        self._forms, points = forms, forms.points
        energies = [beam.section.strain_energy for beam in scene.beams]
        #: Whether members or springs have internal variables.
        self.flows = forms.internal_shape[-1] > 0 or points.flows
        #: Whether members or virtual works have functions of a user, which may have kinks; those of
        #: a pressure, which has a number of its own, are smooth.
        self.bend = any(energies) or not all(work.own for work in scene.virtual_works)
        #: Whether there are obstacles or stops.
        self.has_contact = points.any_have("unilateral")
        own = any(force.force for force in scene.forces_between)
        #: Whether all forces have a potential in statics: nothing follows the motion or flows.
        self.potential = not (forms.has_added or own or self.flows)
        sudden = points.any_have("needs_line_search")
        #: Whether slopes of forces may change at once: flow, contact, functions of a user.
        self.any = self.bend or sudden or self.flows or self.has_contact
        #: Whether corrections of Newton's method may be far too long. In motions the force of a
        #: contact over a step is smooth and convex.
        self.overshoot = forms.internal_shape[-1] > 0 or sudden or (at_rest and self.has_contact)
        # Friction, contact with a loss, and dampers with laws of a user lose quickly.
        quick = (law.iteration_memory or (law.loss and law.user_defined) for law in points.laws)
        pieced = (energy is not None and has_pieces(energy) for energy in energies)
        #: Whether forces change quickly where no switch tells: sections' laws, flow, losses.
        self.unseen = self.flows or any(quick) or any(pieced)

    def on(self, forms: Forms) -> Kinks:
        """The same conditions on the forces of another scene with this structure."""
        other = shallow_copy(self)
        other._forms = forms
        return other

    def switches(self, state: State) -> np.ndarray:
        """Values that change their sign where a contact opens or closes, or a law switches."""
        self._forms.parameters.use(state.parameters)
        return self._forms.compiled_points.switches(state.q, state.slides)

    def flowed(self, start: State, end: State) -> bool:
        """Whether something flows, or sticks, between two states."""
        names = "internal", "spring_internal"
        return not all(np.array_equal(getattr(start, n), getattr(end, n)) for n in names)

    def switched(self, start: State, end: State) -> bool:
        """Whether a contact opens or closes, or a law switches: members that are near may touch."""
        members = self._forms.points.members
        first, last = (np.sign(self.switches(state)) for state in (start, end))
        return (members is not None and members.are_near) or not np.array_equal(first, last)

    def may_begin(self, start: State, end: State) -> bool:
        """Whether flow or contact may begin or end in a step, which its predictor does not know."""
        return self.flowed(start, end) or (self.has_contact and self.switched(start, end))


class Model:
    """All data of a scene and a scheme that are constant over the steps.

    Vectors contain all degrees of freedom; `mesh.dofs` gives those of a node. With `mobile`, parts
    with mass need no supports, even if the scheme is static. With `instant`, its steps only serve
    to find derivatives of forces. A `part` of a scene is checked with the whole. A mechanism that
    its loads may hold is not refused if it `settles`. Driven motions are unknowns if `released`.
    """

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        mobile: bool = False,
        instant: bool = False,
        part: bool = False,
        settles: bool = False,
        structure: Structure | None = None,
        released: bool = False,
    ):
        self.scheme, self.mesh = scheme, build_mesh(scene)
        #: Held by a thread that computes with it: a solution may be read by several.
        self.lock = RLock()
        #: The `Program` of a run's model, and the `Block` with its numbers; None of one alone.
        self.program: Any = None
        self.block: Any = None
        if not sliding_joints(scene.joints):
            begin_to_build(_probable_features(scene, scheme))
        if not all(joint.is_selection for joint in scene.joints):
            begin_to_build_joints()
        X = self.mesh.positions_of(scene)
        form_numbers = form_data(scene, self.mesh, X, scheme.rates)
        self.forms = forms = Forms(scene, scheme, self.mesh, form_numbers, instant)
        #: The forces at points.
        self.points = self.forms.points
        #: Number of degrees of freedom.
        self.size = self.mesh.dofs.size
        #: Where forces bend.
        self.kinks = Kinks(scene, forms, scheme.rates.at_rest)
        #: The mass of beams and lumped ones.
        self.masses = MassMatrix(scene, self.mesh, forms.stiffness, forms.cell_entries)
        #: The numbers of the scene.
        self.data = data = self.read(scene, X, form_numbers)
        self.scene = scene
        self.masses.set_numbers(data.masses)
        self.masses.assembled += [str(load) for load in scene.loads]
        self.masses.name(scene, scheme.rates.at_rest)
        self.masses.warn_of_no_weight(scene)
        look_at_ends(scene, self.mesh)
        self.reduction: Reduction
        self._build_reduction(released)
        #: Whether friction sticks, whose damping depends on masses and places.
        self.sticks = sticks(scene) and not scheme.rates.at_rest
        if self.sticks:
            self.data = damped(self, data, self.reduction)
            forms.set_numbers(self.data.forms)
        #: The structure of the scene.
        self.structure = structure or Structure(scene)
        #: Facts of the structure by what gives them; runs of a program share them.
        self.facts: dict[Callable, Any] = {}
        #: What fits rates (`rate_fit`), made when it is first asked for.
        self.rate_fit: Any = None
        # Whether masses hold nothing, and whether loads may hold a mechanism.
        self._rests = scheme.rates.at_rest and not mobile, settles
        #: Why the scene without loads is a mechanism; empty if it is none.
        self.mechanism = "" if part else _mechanism(self, *self._rests)

    def read(
        self, scene: Scene, X: MaybeDual, forms: FormData, known: SceneArrays | None = None
    ) -> SceneArrays:
        """The numbers of a scene with nodes at X (n, 2); loads that are not there are those known.

        Friction that sticks has the damping of `forms`; see `damped`.
        """
        masses, mesh, arms = self.masses.numbers_of(scene, X), self.mesh, arms_of(scene)
        if scene.loads or known is None:
            weights = functools.partial(self.masses.places.weights, entries=masses["mass"])
            loads = dead_loads(scene, mesh, floats(X), weights)
        else:
            loads = known.loads
        if scene.natural_strains or known is None:
            natural = natural_strains(scene, mesh)
        else:
            natural = known.natural
        gears, moved = numbers_of_gears(scene), motors(scene)
        lasting = LoadedBeams.of(scene), Parts.of(scene)
        return SceneArrays(scene, X, forms, masses, loads, natural, arms, gears, moved, *lasting)

    def set_numbers(self, data: SceneArrays) -> None:
        """Take the numbers of a scene of this structure, as if this were the model of it.

        OtherStructureError, then nothing is set. What was assembled changes in place.
        """
        elsewhere = not data.lies_as(self.data)
        if elsewhere and self.couplings.need_places:
            raise OtherStructureError("joints that close loops, or slide on beams, lie elsewhere")
        gears, self.data, self.scene = self.data.gears, data, data.scene
        self.masses.set_numbers(data.masses)
        self.masses.warn_of_no_weight(data.scene)
        if elsewhere:
            self.mesh.move(floats(data.X))
            self.units = Units(self.mesh, self.couplings)
        self.reduction.joints.set_numbers(data.arms, data.gears)
        if data.gears != gears:
            self._check_loops()
        if self.sticks:
            self.data = data = damped(self, data, self.reduction)
        self.forms.set_numbers(data.forms)
        # In statics without joints and forces between nodes places alone tell mechanisms.
        scene = data.scene
        places_tell = self._rests[0] and not (scene.joints or scene.forces_between)
        if elsewhere or scene.drags or (self.scheme.rates.at_rest and not places_tell):
            self.mechanism = _mechanism(self, *self._rests)

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        structs, arrays = self.reduction.joints.memory
        point_structs, point_arrays = self.forms.compiled_points.memory
        return [*structs, *point_structs], [*arrays, *point_arrays, self.forms.parameters.values]

    def in_block(self, block: Any, program: Any) -> Model:
        """The model of a run, whose numbers are in its block; `set_numbers` is to follow."""
        other = shallow_copy(self)
        other.program, other.block, other.lock, other.rate_fit = program, block, RLock(), None
        other.mesh = mesh = shallow_copy(self.mesh)
        other.masses = self.masses.on(mesh)
        other.forms = forms = self.forms.in_block(block, mesh)
        other.points = forms.points
        other.kinks = self.kinks.on(forms)
        other.reduction = self.reduction.in_block(block, forms.compiled_points)
        return other

    def _build_reduction(self, released: bool) -> None:
        """Build the unknowns and the reduction to them, by supports and joints."""
        scene, matrix = self.scene, self.forms.stiffness
        self.couplings = couple(scene, self.mesh, released)
        #: Sizes of unit increments.
        self.units = Units(self.mesh, self.couplings)
        # Couplings that change with the motion.
        turning = any(not (joint.is_selection or joint.a is GROUND) for joint in scene.joints)
        turning |= bool(self.couplings.gears)  # as rates are 4 / dt tan(Dpsi / 2)
        #: Whether rates by the mean rule must be fitted to joints and driven motions.
        self.fits_rates = self.scheme.rates.mean_based and (turning or self.couplings.driven > 0)
        keys, driven = [*scene.prescribed, *sorted(scene.fixed)], len(scene.prescribed)
        nodes, components = np.reshape(np.array(keys, dtype=int), (-1, 2)).T
        columns = np.arange(len(keys))
        motors = [joint.number for joint, _ in self.data.motors]
        columns[driven:] += len(motors)  # which are between
        self.prescribed = (3 * nodes + components)[:driven]
        node_columns, motor_columns = (
            np.full(self.mesh.dofs.shape, -1, np.int32),
            np.full(scene.joint_count, -1, np.int32),
        )
        node_columns[nodes, components] = columns
        motor_columns[motors] = driven + np.arange(len(motors))
        #: Columns, driven or fixed, whose forces histories have; -1 where there is none.
        self.force_columns = {"reactions": node_columns, "motor_forces": motor_columns}
        self.forms.compiled_points.set_columns(self.couplings.slides)
        if self.kinks.flows and min(self.scheme.fractions) < 0:
            raise SceneError(
                f"{self.scheme.name}: the sub-step that goes back in time would give back what "
                "internal variables of a section or of a spring, or friction that sticks, have "
                "dissipated. Use order=2"
            )
        sliders = None
        if self.couplings.need_places:
            from fx_beam.coupling.dependent_columns import Sliders

            sliders = Sliders(scene, self.couplings, self.mesh)
        masses = np.array([(m, m, inertia) for _, m, inertia in scene.masses]).ravel()
        entries = self.masses.places.lumped[masses != 0]
        if self.fits_rates:
            little = little_mass(self.masses.matrix, self.units.nodes, scene, self.mesh)
            entries = np.append(entries, self.masses.places.diagonal[little > 0])
        used = functools.partial(self.forms.used_entries, entries, self.scheme.rates.user_defined)
        #: Whether something may act on a degree of freedom, (size,).
        self.acted_on = used()[self.masses.places.diagonal]
        auxiliaries = Auxiliaries(self.couplings)
        loops = None
        if self.couplings.closures and sliders is not None:
            from fx_beam.coupling.dependent_columns import Loops

            loops = Loops(self.couplings, auxiliaries, self.units.turns, sliders)
        self.reduction = Reduction(
            couplings=self.couplings,
            auxiliaries=auxiliaries,
            compiled_points=self.forms.compiled_points,
            rates=self.scheme.rates,
            matrix=matrix,
            used=used,
            sliders=sliders,
            loops=loops,
        )
        self.reduction.joints.set_numbers(self.data.arms, self.data.gears)
        self._check_loops()
        if not self.couplings.is_selection:
            self.masses.assembled.append("joints")

    def _check_loops(self) -> None:
        """Refuse loops whose equations depend on each other, as those of gears may."""
        scene, loops = self.scene, self.reduction.loops
        made_later = any(joint.place for joint in scene.joints) or any(g.value for g in scene.gears)
        if loops is not None and not made_later:
            from fx_beam.coupling.determinacy import check_loops

            self.reduction.set_start(np.zeros(self.size), slides_at_start(scene))
            check_loops(scene, self.reduction, loops)


def look_at_ends(scene: Scene, mesh: Mesh) -> None:
    """Warn of beams that end on another one without being joined to it."""
    if len(scene.beams) > 1:
        from fx_beam.coupling.determinacy import warn_of_unjoined

        warn_of_unjoined(scene, mesh)


def damped(model: Model, data: SceneArrays, reduction: Reduction) -> SceneArrays:
    """Numbers in which friction that sticks has critical damping, by the masses it holds."""
    mass = model.masses.places.matrix(floats(data.masses["mass"]))
    moves = mobility(data, mass, reduction, model.mesh)
    return data._replace(forms=form_data(data.scene, model.mesh, data.X, model.scheme.rates, moves))


def _mechanism(model: Model, massless: bool, settles: bool) -> str:
    """Why a scene moves freely without loads (and masses, if `massless`); empty if it does not."""
    heavy = not massless and not fact(model, massless_dofs).any()
    if heavy or not (settles or not model.scene.virtual_works):
        return ""
    from fx_beam.coupling.determinacy import mechanism_of

    mass = None if massless else model.masses.matrix
    return mechanism_of(model.scene, model.mesh, mass, settles)


def massless_dofs(model: Model) -> np.ndarray:
    """Whether neither a degree of freedom has mass nor one that moves as it does, (size,)."""
    heavy, reduction = model.masses.matrix.diagonal() > 0, model.reduction
    if heavy.all():
        return ~heavy
    reduction.set_start(np.zeros(model.size), slides_at_start(model.scene))
    # Those that are equal have equal rates, whatever those of the columns are.
    rates = np.random.default_rng(0).random(reduction.columns)
    rates = reduction.maps.to_nodes(rates)
    return ~np.isin(rates, rates[heavy])


def led_dofs(model: Model) -> np.ndarray:
    """Degrees of freedom that driven motions alone move, in schemes of Newmark's family."""
    couplings = model.couplings
    if not isinstance(model.scheme.rates, NewmarkRates) or not couplings.driven:
        return np.empty(0, dtype=int)
    held = np.zeros(couplings.columns, dtype=bool)
    held[couplings.free : couplings.independent] = True
    for auxiliary in couplings.auxiliaries:
        held = np.append(held, all(held[column] for column, _, _ in auxiliary.entries))
    row, column, _, _ = couplings.all_entries
    return np.setdiff1d(row, row[~held[column]])


def recursive_columns(model: Model) -> np.ndarray:
    """Whether driven motions (driven,) move masses whose rates are by Newmark's recursion."""
    entries, driven = model.couplings.all_entries, model.couplings.driven
    if not isinstance(model.scheme.rates, NewmarkRates) or not driven:
        return np.zeros(driven, dtype=bool)
    others = entries.column[~np.isin(entries.row, fact(model, led_dofs))]
    passed_on = np.isin(model.couplings.free + np.arange(driven), others)
    return passed_on | bool(model.couplings.auxiliaries)


def keeps_rate_errors(model: Model) -> bool:
    """Whether masses turn on arms, where errors of accelerations by Newmark's rule add up.

    The equations do not control a part of these. Known motion leaves a recursion, stable if gamma
    is at least 1/2 and beta gamma/2, which with 1/2 and 1/4 repeats them with alternating signs.
    """
    couplings, rates = model.couplings, model.scheme.rates
    if not isinstance(rates, NewmarkRates) or (0.5 <= rates.gamma <= 2 * rates.beta > 0.5):
        return False
    row, column, value_at, _ = couplings.all_entries
    moved = row[(value_at > 0) & (column < couplings.independent)]
    turned = np.setdiff1d(moved, fact(model, led_dofs))
    return bool((model.masses.matrix.diagonal()[turned] > 0).any() or couplings.auxiliaries)


def need_rates(model: Model) -> bool:
    """Whether forces of beams are evaluated with the rates at the starts of steps."""
    beams, rates = model.forms.beams, model.scheme.rates
    if beams is None or beams.facts.resultants_need_rates:
        return beams is not None
    return isinstance(rates, NewmarkRates) and (beams.depend_on_rates or rates.alpha_m != 0)


def keeps_previous(model: Model) -> bool:
    """Whether steps depend on the start of the step before."""
    return model.forms.keeps_previous or len(fact(model, led_dofs)) > 0


def fact(model: Model, find: Callable[[Model], T]) -> T:
    """What a function finds of the structure of a model, once for all runs of its program."""
    if find not in model.facts:
        model.facts[find] = find(model)
    return model.facts[find]


def widths_of(model: Model) -> dict[str, int]:
    """Numbers in a row of each recorded quantity."""
    sizes = fact(model, sizes_of)
    return {name: math.prod(quantity.lengths(sizes)) for name, quantity in ROWS.items()}


def sizes_of(model: Model) -> dict[str, int]:
    """Lengths of the arrays of a state, by their names in `StateArray.shape`."""
    forms, reduction, rates = model.forms, model.reduction, model.scheme.rates
    cells, points, variables = forms.internal_shape
    return {
        "dofs": model.size,
        "joints": model.scene.joint_count,
        "lines": model.scene.force_count,
        "constraints": reduction.columns - reduction.free,
        "contacts": model.points.contacts,
        "parameters": len(forms.parameters),
        "added dofs": model.size if forms.has_added else 0,
        "kept driven": 0 if rates.mean_based or rates.at_rest else reduction.driven,
        "kept dofs": model.size if keeps_previous(model) else 0,
        "cells": cells,
        "points": points,
        "variables": variables,
        "spring variables": model.points.width,
        "natural strains": 3 * bool(model.data.natural),
    }


def sticks(scene: Scene) -> bool:
    """Whether a scene has friction that sticks, which is damped by the masses that it holds."""
    coordinates = [c for joint in scene.joints for c in joint.coordinates.values()]
    frictions = [getattr(part, "friction", None) for part in (*scene.contacts, *coordinates)]
    return any(isinstance(friction, Coulomb) for friction in frictions)


def _probable_features(scene: Scene, scheme: Scheme) -> str:
    """Features of the library for most scenes of a kind (c/scene_features.h)."""
    if any(isinstance(obstacle.shape, Beam) for obstacle in scene.contacts):
        return "MEMBERS"
    if scheme.rates.at_rest:
        return "0"
    return "BAND" if scene.beams and (scene.joints or scene.beams[0].degree > 1) else "CHAIN"


# -- The numbers of a scene by the indices of a model ----------------------------------------------


def read_numbers(model: Model, scene: Scene) -> SceneArrays:
    """The numbers of a scene of the structure of a model; OtherStructureError for other zeros.

    Friction that sticks has the damping of other masses until `Model.set_numbers`.
    """
    X = model.mesh.positions_of(scene)
    data = model.read(scene, X, form_data(scene, model.mesh, X, model.scheme.rates), model.data)
    _check(model, data)
    return data


def data_of(model: Model, scene: Scene) -> SceneArrays:
    """The numbers of a scene; OtherStructureError if it differs in more from that of the model."""
    model.structure.check(scene)
    data = read_numbers(model, scene)
    if not model.sticks:
        return data
    fits = not model.couplings.need_places or data.lies_as(model.data)
    fitting = model if fits else Model(scene, model.scheme, part=True)
    return damped(model, data, fitting.reduction)


def _check(model: Model, data: SceneArrays) -> None:
    """OtherStructureError if data are of other kinds than the numbers that a model has."""
    known = model.data
    model.forms.check(data.forms)
    if data.masses is not known.masses:
        model.masses.check(data.masses)
    if data.arms.keys() != known.arms.keys():
        raise OtherStructureError("other joints have offsets")
    for old, new in ((known.loads, data.loads), (known.natural, data.natural)):
        if new is not old:
            old.check(new)


def numbers_of(model: Model, data: SceneArrays) -> dict[str, MaybeDual]:
    """All numbers by name as flat arrays, with slopes that the scene has."""
    scene, couplings = data.scene, model.couplings
    numbers: dict[str, object] = {"X": data.X, "columns": data.loads.entries}
    numbers |= data.forms.numbers | data.masses
    if data.natural:
        numbers["natural columns"] = data.natural.entries
    if moving := joints_with_arms(couplings, scene):
        axes = [(0.0, 0.0) if joint.axis is None else joint.axis for joint in moving]
        numbers["offset"] = dual_array([joint.offset for joint in moving]).reshape(-1, 2)
        numbers["axis"] = dual_array(axes).reshape(-1, 2)
        numbers["rest"] = [joint.start()[0] for joint in moving]
    if couplings.gears:
        numbers["gears"] = dual_array(data.gears)
    if couplings.sliding:
        joints = {joint.number: joint for joint in sliding_joints(scene.joints)}
        sliding = [joints[joint.number] for joint in couplings.sliding]
        numbers["places"] = [joint.place_at_rest for joint in sliding]
        paths = {id(joint.beam): joint.path for joint in sliding}
        numbers["paths"] = np.concatenate([path.numbers for path in paths.values()])
    return {name: dual_array(values) for name, values in numbers.items()}
