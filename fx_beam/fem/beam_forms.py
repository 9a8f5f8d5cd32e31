"""The weak form of one step on the mesh of a scene: forces, tangent and energies of its beams."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, StepBatch, StepStart
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import gauss_rule
from fx_beam.scene.law import frozen, functions_of_energy
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section
from fx_beam.scene.structure import OtherStructureError

from .assembly import BoundForm, Field, RowValues, Space
from .fields import CONSTANTS, NATURAL, NODAL, data_field, distinct
from .form_library import CompiledForm, FormModule, FormSource
from .mesh import Mesh
from .parameter_values import ParameterValues
from .weak_form import LOSSES, Kind, StepFacts, WeakForm

Given = np.ndarray | None


class BeamForms:
    """Forces and energies of the beams of a scene, their drag, and virtual works added by a user.

    Vectors contain all degrees of freedom. Internal variables change in a step unless it `holds`
    them, as in an instant.
    """

    # -- Construction ---------------------------------------------------------------------------

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        mesh: Mesh,
        parameters: ParameterValues,
        numbers: Mapping[str, Any],
        holds: bool = False,
    ):
        self._scheme, self._mesh, self._parameters = scheme, mesh, parameters
        self._holds = holds
        #: Whether the scheme is static.
        self.at_rest = scheme.rates.at_rest
        #: Indices of the parameters in the forms among all.
        self.parameters: list[int] = []
        #: Derivatives of energies and resultants on the mesh, by what they are of and by.
        self._derivatives_of: dict[str, list[tuple[str, Space, RowValues]]] = {}
        # Jacobians of forces, by these and whether by places as well.
        self._slopes_of: dict[tuple[str, bool], dict[tuple[str, int], BoundForm]] = {}
        #: Forms on the mesh by name.
        self.bound: dict[str, BoundForm] = {}
        #: Polynomial degree of the elements.
        self.degree = scene.beams[0].degree
        # Shapes of the data of sections and of drag by name.
        self._shapes = {name: values.shape for name, values in numbers.items()}
        self._read(scene)
        #: Whether there are virtual works of a user.
        self.has_external = bool(scene.virtual_works)
        step = self._compiled()
        #: What is known of the forms.
        self.facts = facts = StepFacts(**step.facts)
        if facts.needs_previous and len(scheme.fractions) > 1:
            raise SceneError(
                f"{scheme.name}: its resultants depend on the last step, so that it cannot "
                "have sub-steps. Use fractions=(1.0,)"
            )
        #: Fields and arrays on this mesh by their names in forms.
        self._data = self._fields(numbers)
        for i, work in enumerate(scene.virtual_works):
            is_loaded = np.full(len(mesh.beam_of_cell), work.beam is None)
            if work.beam is not None:
                cells = mesh.cells[scene.beams.index(work.beam)]
                is_loaded[cells[slice(*work.elements)]] = True
            self._data[f"indicator {i}"] = data_field(is_loaded[:, None], mesh)
        if facts.names:
            self._read_parameters()
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in problem.h; None is missing.
        self.moving: list[Any] = [self._data.get(name) for name in (*NODAL, "internal", *NATURAL)]
        self._increment, self._start, *self._start_rates, self._q_previous = self.moving[:5]
        #: Field of the internal variables; None without any.
        self._internal: Any = self._data.get("internal")
        for form in step.forms.values():
            space = (
                self._data["internal"].space if form.name == "internal variables" else mesh.unknowns
            )
            self.bound[form.name] = self._bind(form, [space] * form.arguments)
        #: Whether there is drag.
        self.have_drag = "drag" in self.bound
        #: Whether forces may depend on rates, and may dissipate energy.
        self.depend_on_rates = self.has_external or self.have_drag or facts.resultants_move
        self.dissipate = not self.bound.keys().isdisjoint(LOSSES)
        #: Weights (degree,) of the Gauss points, relative to the element's length.
        self.point_weights = gauss_rule(self.degree)[1]
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = len(self.tags), self.degree, facts.width

    def _fields(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        """Constants and functions."""
        mesh, degree, width = self._mesh, self.degree, self.facts.width
        self._values = {name: np.zeros(()) for name in CONSTANTS}
        self._reset_constants()
        data: dict[str, Any] = dict(self._values)
        data |= {name: data_field(values, mesh) for name, values in numbers.items()}
        if width:
            data["internal"] = Field(mesh.space(degree, width))
        if self.kind.natural:
            data |= {name: Field(mesh.space(degree, 3)) for name in NATURAL}
        data |= {name: Field(mesh.unknowns) for name in NODAL}
        coordinate = data["coordinate"] = Field(mesh.space(2))
        coordinate.array.reshape(-1, 2)[:] = 0.0, degree
        return data

    @property
    def data(self) -> dict[str, np.ndarray]:
        """Values (cells, width) of what is constant over steps, by name in forms."""
        names = (name for name in self._data if name in self._shapes or name == "coordinate")
        named = [*names, *(name for name in self._data if name.startswith("indicator "))]
        return {name: self._data[name].array.reshape(len(self.tags), -1) for name in named}

    def _reset_constants(self) -> None:
        for name, value in self._values.items():
            value[...] = 1.0 if name in ("dt", "load_factor") else 0.0

    def _read(self, scene: Scene) -> None:
        """Find the kind of the scene."""
        mesh = self._mesh
        sections = [beam.section for beam in scene.beams]
        internal = [
            frozen(section.internal) if self._holds else section.internal for section in sections
        ]
        of_sections = {id(section): _expressions(section) for section in distinct(sections)}
        keys = [of_sections[id(section)] for section in sections]
        energies = (section.strain_energy for section in sections)
        materials = dict(zip(keys, zip(energies, internal, strict=True), strict=True))
        numbers = {key: number for number, key in enumerate(materials)}
        #: Subdomain of each cell, the number of its material.
        self.tags = np.array([numbers[key] for key in keys])[mesh.beam_of_cell]
        works, natural = tuple(scene.virtual_works), bool(scene.natural_strains)
        shapes = tuple((name, (shape[1], shape[2:])) for name, shape in self._shapes.items())
        self.kind = Kind(
            *(self.degree, mesh.curved, self._scheme, tuple(materials.values())),
            *(works, natural, shapes, bool(works) and self._holds),
        )
        self._forms = FormSource(WeakForm, self.kind)

    def _compiled(self) -> FormModule:
        try:
            return self._forms.module("of_step")
        except Exception as error:
            if not self.has_external:
                raise
            raise SceneError(
                f"forms with the added virtual work do not compile: {error}. Simplify its "
                "expressions"
            ) from error

    def _read_parameters(self) -> None:
        """Let the forms read the values of their parameters."""
        names = self.facts.names
        values = self._data["parameters"] = np.zeros(len(names))
        for parameter in self._scheme.parameters:
            self._parameters.check_constant(parameter.name, f"{self._scheme.name}: damping")
        self.parameters = self._parameters.indices(names)

        def read(of_all: np.ndarray) -> None:
            values[:] = of_all[self.parameters]

        self._parameters.add_reader(read, self.facts.names_in_energies)

    def check(self, numbers: Mapping[str, Any]) -> None:
        """OtherStructureError if data are of another kind."""
        if list(self._shapes) != list(numbers):
            raise OtherStructureError("beams have other kinds of data")
        if any(shape != numbers[name].shape for name, shape in self._shapes.items()):
            raise OtherStructureError("data of beams that were constant vary, or conversely")

    def bind(self, numbers: Mapping[str, Any]) -> None:
        """Set the data (cells, points, ...) of sections and of drag, and begin anew."""
        for field in filter(None, self.moving):
            field.array[:] = 0.0
        self._reset_constants()
        for name, values in numbers.items():
            self._data[name].array[:] = floats(values).ravel()

    # -- Derivatives ----------------------------------------------------------------------------

    @cached_property
    def _derived(self) -> tuple[FormSource, dict[str, Any], dict[str, Space]]:
        """Forms of derivatives; their data, and spaces of derivatives, by name."""
        mesh, facts = self._mesh, self.facts
        data = self._data | {"weight 0": Field(mesh.unknowns)}
        if facts.width:
            data["weight 1"] = Field(self._internal.space)
        spaces = {name: field.space for name, field in data.items() if isinstance(field, Field)}
        spaces["coordinates"] = mesh.positions
        if facts.names:
            data["more"] = Field(mesh.space(1, len(facts.names)))
            spaces["parameters"] = data["more"].space
        from .vjp_form import DerivedForm

        return FormSource(DerivedForm, self.kind), data, spaces

    def sizes_of_slopes(self, forces: str) -> dict[str, int]:
        """How many numbers of an element "internal forces" or "drag" depend on, by name."""
        source, _, spaces = self._derived
        names = source.module("work", forces).facts["derivatives"]
        return {name: spaces[name].width for name in names}

    def slopes(self, forces: str, names: Iterable[str]) -> dict[tuple[str, int], BoundForm]:
        """The work of these forces on weights, as ("work", 0), and its derivatives.

        Each is by numbers with one of the `names`, and by a weight: of the forces,
        and of the increments of internal variables.
        """
        source, data, spaces = self._derived
        slopes = {}
        for title, form in source.module("slopes", forces, *names).forms.items():
            name, number = title.rsplit(" ", 1)
            of_form = [] if name == "work" else [spaces[name], spaces[f"weight {number}"]]
            slopes[name, int(number)] = self._bind(form, of_form, data)
        return slopes

    def _derivatives(
        self, quantity: str, parts: StepBatch, by_places: bool, points: int = 0
    ) -> Iterator[tuple[str, Space, np.ndarray]]:
        """Derivatives of a quantity of `DerivedForm` in steps: name, space, and values.

        Those by positions come only if they are wanted. Values are (k, cells, numbers), or with
        `points` (k, cells, points, 3, numbers).
        """
        if quantity not in self._derivatives_of:
            source, data, spaces = self._derived
            tests = [self._mesh.space(points, 3)] * bool(points)
            self._derivatives_of[quantity] = [
                (name, spaces[name], self._in_rows(self._bind(form, [*tests, spaces[name]], data)))
                for name, form in source.module("derivatives", quantity).forms.items()
            ]
        shape, parameters = (points, 3) * bool(points), self._parameters_in(parts)
        for name, space, values in self._derivatives_of[quantity]:
            if by_places or name != "coordinates":
                yield name, space, values(parts, parameters, (*shape, space.width))

    def stored_energy_by(self, parts: StepBatch, by_places: bool) -> dict[str, np.ndarray]:
        """Derivatives of `strain_energy` at the starts of k steps by "q" (k, size), as `_summed`.

        And by "internal" variables, "natural" strains, the data of sections, "X", and "parameters".
        """
        derivatives = self._summed(self._derivatives("strain energy", parts, by_places))
        derivatives["q"] = derivatives.pop("start")
        return derivatives

    def _summed(
        self, of_cells: Iterable[tuple[str, Space, np.ndarray]], cells: Any = slice(None)
    ) -> dict[str, np.ndarray]:
        """Derivatives (k, numbers), by name, by nodal fields, positions "X" and all "parameters".

        Others are by numbers at Gauss points or of cells.
        """
        derivatives: dict[str, np.ndarray] = {}
        for name, space, values in of_cells:
            places, size = space.dofs[cells], space.size
            if name == "parameters":
                places, size = np.array(self.parameters), len(self._parameters)
            places = np.broadcast_to(
                places + size * np.arange(len(values))[:, None, None], values.shape
            )
            sums = np.bincount(places.ravel(), values.ravel(), len(values) * size)
            name = "X" if name == "coordinates" else name
            derivatives[name] = derivatives.get(name, 0.0) + sums.reshape(-1, size)
        return derivatives

    def losses_by(self, parts: StepBatch, by_places: bool) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in k completed steps: to material, scheme and drag.

        As `_summed`: by "increment", "start" and "q_previous", "X", "internal" variables, strains
        "natural" at the start and "natural_end", "parameters", "stiffness", "retardation", and
        coefficients of "drag ...".
        """
        names = (name for name in LOSSES if name in self.bound)
        return [self._summed(self._derivatives(name, parts, by_places)) for name in names]

    def forces_by(
        self, parts: StepBatch, by_places: bool, weights: np.ndarray, cell: int
    ) -> dict[str, np.ndarray]:
        """Derivatives of sums of weights (k, width) times forces of a cell in k steps.

        These are `forces_of_cells`; the derivatives as of `resultants_by`.
        """
        parameters, (_, _, spaces) = self._parameters_in(parts), self._derived

        def of_cell() -> Iterator[tuple[str, Space, np.ndarray]]:
            for (name, _), values in self._slopes_of_cell(by_places, cell):
                shape = spaces[name].width, weights.shape[1]
                slopes = values(parts, parameters, shape)
                yield name, spaces[name], np.einsum("kcnw,kw->kcn", slopes, weights)

        return self._summed(of_cell(), [cell])

    def _slopes_of_cell(
        self, by_places: bool, cell: int
    ) -> Iterator[tuple[tuple[str, int], RowValues]]:
        """Jacobians of forces of a cell by name."""
        for of in ["internal forces"] + ["drag"] * self.have_drag:
            if (of, by_places) not in self._slopes_of:
                names = [
                    key for key in self.sizes_of_slopes(of) if by_places or key != "coordinates"
                ]
                self._slopes_of[of, by_places] = self.slopes(of, names)
            for key, form in self._slopes_of[of, by_places].items():
                if key[0] == "work" or key[1]:
                    continue
                pairs = zip(form.compiled.addresses, form.cells.values(), strict=True)
                own = [(form, at, np.array([cell])) for at, cells in pairs if cell in cells]
                yield key, RowValues(own, self._mesh, self.moving, one_cell=True)

    def resultants_by(
        self, parts: StepBatch, by_places: bool, weights: np.ndarray, component: int
    ) -> dict[str, np.ndarray]:
        """Derivatives of the sums of weights (k, cells, points) times N, Q or M in k steps.

        As `_summed`: by "increment", "start" and "q_previous", "internal" variables, the data of
        sections, strains "natural" at the start and "natural_end", "parameters", and "X".
        """
        return self._summed(
            (name, space, np.einsum("kcp,kcpn->kcn", weights, slopes))
            for name, space, slopes in self._slopes_of_resultants(parts, by_places, component)
        )

    def resultants_with(
        self, parts: StepBatch, by_places: bool, changes: Mapping[str, np.ndarray], component: int
    ) -> np.ndarray:
        """Changes (k, m, cells, points) of N, Q or M, from `changes` (k or 1, m, ...) of fields."""
        total: Any = 0.0
        for name, space, slopes in self._slopes_of_resultants(parts, by_places, component):
            values = changes["X" if name == "coordinates" else name]
            values = values.reshape(*values.shape[:2], -1)
            if name == "parameters":
                values = np.tile(values[..., self.parameters], len(space.dofs))
            total = total + np.einsum("kcpn,kmcn->kmcp", slopes, values[..., space.dofs])
        return total

    def _slopes_of_resultants(
        self, parts: StepBatch, by_places: bool, component: int
    ) -> Iterator[tuple[str, Space, np.ndarray]]:
        """Local Jacobians (k, cells, points, numbers) by name, and the space of the numbers."""
        for name, space, slopes in self._derivatives("resultants", parts, by_places, self.degree):
            yield name, space, slopes[..., component, :] / self.point_weights[:, None]

    def _bind(
        self, compiled: CompiledForm, spaces: Sequence[Space] = (), data: Mapping | None = None
    ) -> BoundForm:
        """A form or an expression on the mesh, with arguments in some spaces."""
        return BoundForm(compiled, self._mesh, data or self._data, spaces, self.tags)

    # -- Evaluation -----------------------------------------------------------------------------

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor, and in statics its increment in the step."""
        self._values["load_factor"][...] = factor
        self._values["load_increment"][...] = increment

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step."""
        self._values["time"][...] = interval.at(self._scheme.rates.level)
        self._values["dt"][...] = interval.length
        self._start.array[:] = start.q
        if self.facts.needs_rates and len(start.v):
            for field, rate in zip(self._start_rates, (start.v, start.a), strict=True):
                field.array[:] = rate
        if self.facts.needs_previous:
            self._values["memory"][...] = start.memory
            q_previous = start.q if start.q_previous is None else start.q_previous
            self._q_previous.array[:] = q_previous
        self._set_internal(start.internal)
        self.set_natural(*(start.natural or (None, None)))

    def _set_internal(self, internal: np.ndarray | None) -> None:
        """Set the internal variables (cells, degree, width) at the start of the step."""
        if internal is not None:
            self._internal.array[:] = internal.ravel()

    def set_natural(self, start: np.ndarray | None, end: np.ndarray | None = None) -> None:
        """Set natural strains (cells, degree, 3) at the start or at the end of the step."""
        for field, values in zip(self.moving[-2:], (start, end), strict=True):
            if field is not None and values is not None:
                field.array[:] = values.ravel()

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the internal forces (eq. 53), by the reduced rule, and drag to `out` (size,)."""
        self._increment.array[:] = D
        for name in ["internal forces"] + ["drag"] * self.have_drag:
            self.bound[name].add_to(out)

    def add_tangent(self, values: np.ndarray, entries: np.ndarray) -> None:
        """Add their tangent (eq. 54), derived by UFL, to some `entries` of stored values."""
        for name in ["tangent"] + ["tangent of drag"] * self.have_drag:
            self.bound[name].add_to(values, entries)

    def add_external(self, out: np.ndarray) -> None:
        """Add the forces of virtual works of a user to `out` (size,)."""
        if self.has_external:
            self.bound["added virtual work"].add_to(out)

    def strain_energy(self, q: np.ndarray, internal: Given = None, natural: Given = None) -> float:
        """Stored energy [J], integrated by the reduced rule.

        Of q (size,), internal variables, and natural strains (cells, degree, 3).
        """
        self._start.array[:] = q
        self._set_internal(internal)
        self.set_natural(natural)
        return self.bound["strain energy"].total()

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        self._start.array[:] = q
        return self.bound["inverted sections"].total() > 0

    def normal_stretch(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        instant = StepBatch(np.zeros(1), np.ones(1), q=q[None], memory=np.zeros(1))
        values = self._point_values(self._forms.module("normal_stretch"))
        return values(instant, np.empty((1, 0)), (self.degree,))[0]

    def _point_values(self, expressions: FormModule) -> RowValues:
        """Values of expressions, one for all cells, or for each subdomain its own."""
        bound = [self._bind(form) for form in expressions.forms.values()]
        tags = self.tags if len(bound) > 1 else 0 * self.tags
        cells = (np.flatnonzero(tags == i) for i in range(len(bound)))
        addresses = (form.compiled.addresses[0] for form in bound)
        return RowValues(zip(bound, addresses, cells, strict=True), self._mesh, self.moving)

    def _in_rows(self, form: BoundForm) -> RowValues:
        """Tensors of a form."""
        pairs = zip(form.compiled.addresses, form.cells.values(), strict=True)
        return RowValues([(form, *pair) for pair in pairs], self._mesh, self.moving)

    @cached_property
    def _resultants(self) -> RowValues:
        return self._point_values(self._forms.module("of_points"))

    def resultants(self, parts: StepBatch) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        return self._resultants(parts, self._parameters_in(parts), (self.degree, 3))

    @cached_property
    def _forces(self) -> list[RowValues]:
        names = ["internal forces"] + ["drag"] * self.have_drag
        return [self._in_rows(self.bound[name]) for name in names]

    def forces_of_cells(self, parts: StepBatch) -> np.ndarray:
        """Forces (n, cells, width) of elements on their own nodes, minus added virtual works.

        Entries are those of `Mesh.unknowns`, for n steps or parts.
        """
        shape = (self._mesh.unknowns.width,)
        parameters = self._parameters_in(parts)
        values = [of_rows(parts, parameters, shape) for of_rows in self._forces]
        return values[0] if len(values) == 1 else values[0] + values[1]

    def _parameters_in(self, parts: StepBatch) -> np.ndarray:
        """Values (n, k) of the parameters of the forms."""
        of_all = parts.parameters
        if not of_all.size:
            of_all = floats(self._parameters.at_times(parts.t))
        return of_all[:, self.parameters]


def _expressions(section: Section) -> tuple:
    """What its functions give: sections in which it is equal have the same material."""
    expressions = functions_of_energy(section.strain_energy, section.internal, 3)
    return (*expressions, section.internal and (section.internal.names, section.internal.level))
