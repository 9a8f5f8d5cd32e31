"""The weak form of one step on the mesh of a scene: forces, tangent, energies, derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.dual import MaybeDual
from fx_beam.errors import SceneError
from fx_beam.laws.interval import StepBatch
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import gauss_rule
from fx_beam.scene.law import frozen, functions_of_energy
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section

from .beam_data import LOSSES, BeamData, Kind, StepFacts, distinct, shapes_of
from .compiled_forms import FormModule, MeshTerm, Space, form_module
from .functions_of_time import ParameterValues
from .mesh import Mesh

if TYPE_CHECKING:
    from .weak_form import DerivedForm


# -- The weak form of one step on the mesh of a scene: forces, tangent and energies of its beams


class FormSource:
    """Forms of a kind, written in UFL only if they are not in the cache.

    For a kind without a key the writer is made in any case: it has functions of a user.
    """

    def __init__(self, kind: Kind):
        self._kind = kind
        if kind.key is None:
            self._writer  # noqa: B018  # what is wrong with functions is said at once

    @cached_property
    def _writer(self) -> DerivedForm:
        from .weak_form import DerivedForm

        return DerivedForm(self._kind)

    def module(self, method: str, *names: str) -> FormModule:
        """Forms that a method of the writer gives for some names."""
        key = self._kind.key and ("DerivedForm", *self._kind.key, method, *names)
        return form_module(key, lambda: getattr(self._writer, method)(*names))


class BeamForms:
    """Forces and energies of the beams of a scene, their drag, and virtual works added by a user.

    Vectors contain all degrees of freedom. Internal variables change in a step unless it `holds`
    them, as in an instant.
    """

    # The forms of the program; mesh and parameters of this run, and its numbers.
    _pattern: BeamForms | None = None
    _run: tuple[Mesh, ParameterValues]
    _numbers: Mapping[str, MaybeDual]

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        mesh: Mesh,
        parameters: ParameterValues,
        numbers: Mapping[str, MaybeDual],
        holds: bool = False,
    ):
        #: Whether there are virtual works of a user.
        self.has_external = bool(scene.virtual_works)
        self.kind, tags = _kind(scene, scheme, mesh, numbers, holds)
        #: The writer of its forms.
        self.source = FormSource(self.kind)
        step = self._compiled()
        #: What is known of the forms.
        self.facts = facts = StepFacts(**step.facts["step"])
        #: Whether the virtual work of resultants is that of a user's class.
        self.has_own_work = "own work" in step.facts
        if facts.needs_previous and len(scheme.fractions) > 1:
            raise SceneError(
                f"{scheme.name}: its resultants depend on the last step, so that it cannot "
                "have sub-steps. Use fractions=(1.0,)"
            )
        for parameter in scheme.parameters if facts.names else ():
            parameters.check_constant(parameter.name, f"{scheme.name}: damping")
        parameters.add_energies(facts.energy_names)
        #: What they read.
        self.data = BeamData(scene, mesh, self.kind, facts, numbers, tags, parameters)
        #: Forms of a step on the mesh by name.
        self.bound = self._placed(step)
        #: Names of these.
        self.names = [*self.bound]
        self._terms: dict[tuple[str, ...], dict[str, MeshTerm]] = {}
        #: Names of the forms of forces.
        self.forces = ["internal forces"] + ["drag"] * ("drag" in self.bound)
        #: Whether forces may depend on rates, and may dissipate energy.
        moves = self.has_external or len(self.forces) > 1 or facts.resultants_move
        self.depend_on_rates = moves
        #: Names of the energies that are lost.
        self.losses = [name for name in LOSSES if name in self.bound]
        self.dissipate = bool(self.losses)
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = len(tags), self.kind.degree, facts.width

    def on(self, mesh: Mesh, parameters: ParameterValues) -> BeamForms:
        """The forms of another scene with this structure; `set_numbers` is to follow.

        What Python evaluates is made when it is first asked for: C has numbers of its own.
        """
        other = shallow_copy(self)
        other._terms, other._pattern, other._run = {}, self, (mesh, parameters)
        for name in ("data", "bound"):
            del other.__dict__[name]
        return other

    def set_numbers(self, numbers: Mapping[str, MaybeDual]) -> None:
        """Set the data (cells, points, ...) of sections and of drag."""
        self._numbers = numbers
        if "data" in self.__dict__:
            self.data.set_numbers(numbers)

    def set_load(self, factor: float) -> None:
        """Set the load factor of virtual works in forms that Python evaluates; 1 at first."""
        if factor != 1.0 or "data" in self.__dict__:
            self.data.named["load_factor"][...] = factor

    @cached_property
    def data(self) -> BeamData:
        """Fields and arrays that the forms read."""
        assert self._pattern is not None  # else it is there
        return self._pattern.data.on(*self._run, self._numbers)

    @cached_property
    def bound(self) -> dict[str, MeshTerm]:
        """The forms of a step on the mesh, by name."""
        assert self._pattern is not None
        return self._own(self._pattern.bound)

    def _own(self, terms: dict[str, MeshTerm]) -> dict[str, MeshTerm]:
        """Terms of the program, which read the data of this run."""
        return {name: term.on(self.data.mesh, self.data.named) for name, term in terms.items()}

    def _compiled(self) -> FormModule:
        try:
            return self.source.module("step_forms")
        except Exception as error:
            if not self.has_external:
                raise
            raise SceneError(
                f"forms with the added virtual work do not compile: {error}. Simplify its "
                "expressions"
            ) from error

    def terms(self, method: str, *arguments: str) -> dict[str, MeshTerm]:
        """Terms on the mesh by name, as a method of the writer gives them; each is made once."""
        if (key := (method, *arguments)) not in self._terms:
            if self._pattern is None:
                self._terms[key] = self._placed(self.source.module(method, *arguments))
            else:
                self._terms[key] = self._own(self._pattern.terms(method, *arguments))
        return self._terms[key]

    def _placed(self, module: FormModule) -> dict[str, MeshTerm]:
        """Forms on the mesh; each of several expressions at Gauss points is on one subdomain."""
        spaces, space_names = self.data.spaces, module.facts.get("spaces", {})
        terms = dict[str, MeshTerm]()
        for i, (name, form) in enumerate(module.forms.items()):
            if form.values and len(module.forms) > 1:
                form = form._replace(functions=[(i, form.functions[0][1])])
            names = space_names.get(name, ["increment"] * form.arguments)
            terms[name] = self.data.term(form, [spaces[space] for space in names])
        return terms

    # -- In one step ----------------------------------------------------------------------------

    def add_force(self, step: StepBatch, out: np.ndarray) -> None:
        """Add the internal forces (eq. 53), by the reduced rule, and drag to `out` (size,)."""
        for name in self.forces:
            self.bound[name].add_to(out, self.data.read(step))

    def add_external(self, step: StepBatch, out: np.ndarray) -> None:
        """Add the forces of virtual works of a user to `out` (size,)."""
        if self.has_external:
            self.bound["added virtual work"].add_to(out, self.data.read(step))

    def strain_energy(self, step: StepBatch) -> float:
        """Stored energy [J] at the start, integrated by the reduced rule."""
        return self.bound["strain energy"].total(self.data.read(step))

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        return self.bound["inverted sections"].total(StepBatch.at_rest(q)) > 0

    def normal_stretch(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        (stretch,) = self.terms("normal_stretch").values()
        return stretch.values(StepBatch.at_rest(q), self.internal_shape[1:2])[0]

    # -- In many steps --------------------------------------------------------------------------

    def resultants(self, steps: StepBatch) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        return self._sum(self.terms("resultants_at_points").values(), steps, (self.kind.degree, 3))

    def forces_of_cells(self, steps: StepBatch) -> np.ndarray:
        """Forces (n, cells, width) of elements on their own nodes, minus added virtual works.

        Entries are those of `Mesh.unknowns`, for n steps or parts.
        """
        terms = [self.bound[name] for name in self.forces]
        return self._sum(terms, steps, (terms[0].size,))

    def _sum(
        self, terms: Iterable[MeshTerm], steps: StepBatch, shape: tuple[int, ...]
    ) -> np.ndarray:
        first, *others = (term.values(self.data.read(steps), shape) for term in terms)
        for values in others:
            first += values
        return first


def _kind(
    scene: Scene, scheme: Scheme, mesh: Mesh, numbers: Mapping[str, MaybeDual], holds: bool
) -> tuple[Kind, np.ndarray]:
    """The kind of a scene, and the subdomain of each cell, the number of its material."""
    sections = [beam.section for beam in scene.beams]
    internal = [frozen(section.internal) if holds else section.internal for section in sections]
    expressions = {id(section): _expressions(section) for section in distinct(sections)}
    keys = [expressions[id(section)] for section in sections]
    energies = (section.strain_energy for section in sections)
    materials = dict(zip(keys, zip(energies, internal, strict=True), strict=True))
    number = {key: i for i, key in enumerate(materials)}
    works, natural = tuple(scene.virtual_works), bool(scene.natural_strains)
    kind = Kind(
        *(scene.beams[0].degree, mesh.curved, scheme, tuple(materials.values())),
        *(works, natural, shapes_of(numbers), bool(works) and holds),
    )
    return kind, np.array([number[key] for key in keys])[mesh.beam_of_cell]


def _expressions(section: Section) -> tuple:
    """Values of its functions in UFL: sections with equal ones have the same material."""
    expressions = functions_of_energy(section.strain_energy, section.internal, 3)
    return (*expressions, section.internal and (section.internal.names, section.internal.level))


# -- Derivatives of the forces, energies and resultants of beams in steps, by all that these read


#: Name and space of numbers, and derivatives by these in k steps.
_Slopes = Iterator[tuple[str, Space, np.ndarray]]


class BeamSlopes:
    """Derivatives by name: (k, numbers) in k steps by nodal fields, positions "X", "parameters".

    Others are by numbers at Gauss points or of cells.
    """

    def __init__(self, beams: BeamForms):
        self._beams, self._data = beams, beams.data

    def sizes(self, forces: str) -> dict[str, int]:
        """Widths of the arrays of an element on which "internal forces" or "drag" depend."""
        names = self._beams.source.module("work", forces).facts["derivatives"]
        return {name: self._data.spaces[name].width for name in names}

    def jacobians(self, forces: str, moves_nodes: bool) -> dict[tuple[str, int], MeshTerm]:
        """The work of these forces on weights, as ("work", 0), and its derivatives.

        Each is by numbers of a name, and by a weight: of the forces, and of the increments of
        internal variables.
        """
        names = [name for name in self.sizes(forces) if moves_nodes or name != "coordinates"]
        pairs = self._beams.terms("slopes", forces, *names).items()
        titles = ((title.rsplit(" ", 1), term) for title, term in pairs)
        return {(name, int(number)): term for (name, number), term in titles}

    def _slopes(self, quantity: str, steps: StepBatch, moves_nodes: bool) -> _Slopes:
        """Derivatives (k, cells, entries of a tensor) of a quantity; by positions if wanted."""
        steps = self._data.read(steps)
        for name, term in self._beams.terms("derivatives", quantity).items():
            if moves_nodes or name != "coordinates":
                yield name, term.spaces[-1], term.values(steps, (term.size,))

    def _summed(self, slopes: _Slopes, cell: int | None = None) -> dict[str, np.ndarray]:
        """Sums (k, numbers) over cells, or of one cell, by the names of numbers."""
        sums: dict[str, np.ndarray] = {}
        cells = slice(None) if cell is None else [cell]
        for name, space, values in slopes:
            places, size = space.dofs[cells], space.size
            if name == "parameters":
                places, size = np.array(self._data.parameters), self._data.parameter_count
            places = np.broadcast_to(
                places + size * np.arange(len(values))[:, None, None], values.shape
            )
            rows = np.bincount(places.ravel(), values.ravel(), len(values) * size)
            name = "X" if name == "coordinates" else name
            sums[name] = sums.get(name, 0.0) + rows.reshape(-1, size)
        return sums

    def energy(self, steps: StepBatch, moves_nodes: bool) -> dict[str, np.ndarray]:
        """Derivatives of `BeamForms.strain_energy` by "q", "internal" variables, "natural" strains.

        And by the data of sections, "X", and "parameters".
        """
        derivatives = self._summed(self._slopes("strain energy", steps, moves_nodes))
        derivatives["q"] = derivatives.pop("start")
        return derivatives

    def losses(self, steps: StepBatch, moves_nodes: bool) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in completed steps: to material, scheme and drag.

        By "increment", "start" and "q_previous", "X", "internal" variables, strains "natural" at
        the start and "natural_end", "parameters", "stiffness", "retardation", and coefficients of
        "drag ...".
        """
        losses = self._beams.losses
        return [self._summed(self._slopes(name, steps, moves_nodes)) for name in losses]

    def forces(
        self, steps: StepBatch, moves_nodes: bool, weights: np.ndarray, cell: int
    ) -> dict[str, np.ndarray]:
        """Derivatives of sums of weights (k, width) times forces of a cell.

        These are `BeamForms.forces_of_cells`. By "increment", "start" and "q_previous", "internal"
        variables, the data of sections, strains "natural" at the start and "natural_end",
        "parameters", and "X".
        """
        steps = self._data.read(steps)

        def cell_slopes() -> _Slopes:
            for forces in self._beams.forces:
                for (name, weight), term in self.jacobians(forces, moves_nodes).items():
                    if name != "work" and not weight:
                        space = term.spaces[0]
                        slopes = term.values(steps, (space.width, weights.shape[1]), cell)
                        yield name, space, np.einsum("kcnw,kw->kcn", slopes, weights)

        return self._summed(cell_slopes(), cell)

    def resultants(
        self, steps: StepBatch, moves_nodes: bool, component: int
    ) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Jacobians (k, cells, points, numbers) of N, Q or M by name, and entries of the numbers.

        These (cells, numbers) are those of fields, of positions "X", or of all "parameters".
        """
        weights = gauss_rule(self._beams.kind.degree)[1][:, None]
        for name, space, slopes in self._slopes("resultants", steps, moves_nodes):
            entries = space.dofs
            if name == "parameters":
                entries = np.broadcast_to(self._data.parameters, entries.shape)
            name = "X" if name == "coordinates" else name
            point_slopes = slopes.reshape(*slopes.shape[:2], len(weights), 3, space.width)
            yield name, entries, point_slopes[..., component, :] / weights
