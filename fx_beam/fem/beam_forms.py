"""The weak form of one step on the mesh of a scene: forces, tangent and energies of its beams."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, Part, Parts, StepStart
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import gauss_rule
from fx_beam.scene.law import held
from fx_beam.scene.scene import Scene

from . import vjp_form
from .assembly import BoundForm, Field, PointValues, Space
from .beam_drag import DragForm, DragKind, coefficients, vjp_of_drag
from .fields import (
    CONSTANTS,
    NATURAL,
    NODAL,
    Data,
    DataShape,
    FilledField,
    distinct,
    on_beam,
    refill,
    section_data,
)
from .form_library import CompiledForm, FormModule, FormSource
from .mesh import Mesh
from .parameter_values import ParameterValues
from .vjp_form import ResultantDerivatives
from .weak_form import LOSSES, Kind, Material, StepFacts, WeakForm

Given = np.ndarray | None


class BeamForms:
    """Forces and energies of the beams of a scene, their drag, and virtual works added by a user.

    Vectors contain all degrees of freedom. Internal variables change in a step unless it `holds`
    them.
    """

    # -- Construction ---------------------------------------------------------------------------

    def __init__(
        self,
        scene: Scene,
        scheme: Scheme,
        mesh: Mesh,
        parameters: ParameterValues,
        holds: bool = False,
    ):
        self._scheme, self._mesh, self._parameters = scheme, mesh, parameters
        self._holds = holds
        #: Indices of the parameters in the forms among all.
        self.parameters: list[int] = []
        #: Data of beams, by name, that vary cell by cell for steps backwards.
        self._by_cells: dict[str, FilledField] = {}
        #: How often data of beams were changed.
        self.changes = 0
        #: Forms on the mesh by name.
        self.bound: dict[str, BoundForm] = {}
        #: Polynomial degree of the elements.
        self.degree = scene.beams[0].degree
        data = self._section_data(scene)
        inside = self._read(scene, data)
        works = [self._compiled_works()] if scene.virtual_works else []
        step = self._forms.module("of_step")
        #: What is known of the forms.
        self.facts = facts = StepFacts(**step.facts)
        if facts.needs_previous and len(scheme.fractions) > 1:
            raise SceneError(
                f"{scheme.name}: its resultants depend on the last step, so that it cannot "
                "have sub-steps. Use fractions=(1.0,)"
            )
        #: Data of the sections by name.
        self.of_sections = {name: FilledField(values, mesh) for name, values in data.items()}
        #: Fields and arrays on this mesh by their names in forms.
        self._data = self._fields(bool(scene.drags))
        self._data |= {f"indicator {i}": of.on(mesh) for i, of in enumerate(inside)}
        if facts.names:
            self._read_parameters()
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in problem.h; None is missing.
        self.moving: list[Any] = [self._data.get(name) for name in (*NODAL, "internal", *NATURAL)]
        self._start, *self._start_rates = self.moving[1:4]
        #: Whether there are virtual works of a user.
        self.has_external = bool(works)
        self._added = [self._bind(work) for work in works]
        unknowns = mesh.unknowns
        #: Field of the internal variables; None without any.
        self._internal: Any = self._data.get("internal")
        for name, form in step.forms.items():
            of_internal = name == "internal variables"
            self._bind(form, self._data["internal"].space if of_internal else unknowns)
        bound = self.bound
        #: Those of forces and of their tangents: the internal ones, and drag.
        self._forces, self._tangents = [bound["internal forces"]], [bound["tangent"]]
        self._energy, self._inversion = bound["strain energy"], bound["inverted sections"]
        #: Forms of `LOSSES`; None where there is none.
        self.of_loss = [bound.get(name) for name in LOSSES]
        #: Weights (degree,) of the Gauss points, relative to the element's length.
        self.point_weights = gauss_rule(self.degree)[1]
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = len(self._tags), self.degree, facts.width
        #: Coefficients of the drag on beams by name.
        self.of_drag: dict[str, FilledField] = {}
        if drags := [] if scheme.rates.at_rest else scene.drags:
            self._add_drag(coefficients(scene, drags, mesh))

    def _fields(self, damps: bool) -> dict[str, Any]:
        """Constants and functions, those of drag if it `damps`."""
        mesh, degree, facts, unknowns = self._mesh, self.degree, self.facts, self._mesh.unknowns
        #: Increments of displacements and rotations.
        self.increment = Field(unknowns)
        self._values = {name: np.zeros(()) for name in CONSTANTS}
        self._reset_constants()
        data: dict[str, Any] = {**self._values, "increment": self.increment}
        data |= {name: field.on_mesh for name, field in self.of_sections.items()}
        if facts.width:
            data["internal"] = Field(mesh.space(degree, facts.width))
        #: Natural strains at both ends of the step.
        self.natural = NaturalFields(mesh, degree, self._kind.natural)
        given = ["start"]
        if damps or facts.needs_rates or facts.resultants_need_rates:
            given += ["velocity", "acceleration"]
        given += ["q_previous"] * self.facts.needs_previous
        data |= self.natural.data | {name: Field(unknowns) for name in given}
        if degree > 1 or damps:
            coordinate = data["coordinate"] = Field(mesh.space(2))
            coordinate.array.reshape(-1, 2)[:] = 0.0, degree
        return data

    def _reset_constants(self) -> None:
        for name, value in self._values.items():
            value[...] = 1.0 if name in ("dt", "load_factor") else 0.0

    def _add_drag(self, given: dict[str, Data]) -> None:
        """Add the drag on beams with these coefficients."""
        self.of_drag = {name: FilledField(part, self._mesh) for name, part in given.items()}
        if given:
            source, data = self._drag(self.of_drag)
            forms = source.module("of_step").forms.values()
            force, tangent, _ = (self._bind(compiled, data=data) for compiled in forms)
            self._forces.append(force)
            self._tangents.append(tangent)

    def _drag(
        self, of_drag: Mapping[str, FilledField], writer: Callable[[DragKind], Any] = DragForm
    ) -> tuple[FormSource, dict[str, Any]]:
        """Forms of the drag with these coefficients, and their data."""
        shapes = tuple((name, field.data.shape) for name, field in of_drag.items())
        kind = DragKind(self.degree, self._mesh.curved, self._scheme, shapes)
        data = self._data | {name: field.on_mesh for name, field in of_drag.items()}
        return _forms_of(writer, kind), data

    def _read(self, scene: Scene, data: dict[str, Data]) -> list[Data]:
        """Find the kind of the scene, and where virtual works act."""
        mesh = self._mesh
        sections = [beam.section for beam in scene.beams]
        internal = [held(of.internal) if self._holds else of.internal for of in sections]
        of_beams = [*zip((of.strain_energy for of in sections), internal, strict=True)]
        materials: list[Material] = []
        for material in of_beams:
            if material not in materials:
                materials.append(material)
        kinds = [materials.index(material) for material in of_beams]
        #: Subdomain of each cell, the number of its material.
        self._tags = np.array(kinds)[mesh.beam_of_cell]
        everywhere = Data(0, np.array(1.0))
        inside = [
            everywhere if work.beam is None else on_beam(mesh, scene, work.beam)
            for work in scene.virtual_works
        ]
        works = [(work, on.shape) for work, on in zip(scene.virtual_works, inside, strict=True)]
        self._kind = Kind(
            *(self.degree, mesh.curved, self._scheme, tuple(materials), tuple(works)),
            *(bool(scene.natural_strains), *_shapes(data)),
        )
        self._forms = _forms_of(WeakForm, self._kind)
        return inside

    def _compiled_works(self) -> CompiledForm:
        try:
            return self._forms.module("added").forms["added virtual work"]
        except Exception as error:
            raise SceneError(
                f"the added virtual work does not compile: {error}. Simplify its expressions"
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

    def _section_data(self, scene: Scene) -> dict[str, Data]:
        """Stiffnesses of the quadratic law, and retardation times, if there are any."""
        mesh, degree, data = self._mesh, scene.beams[0].degree, {}
        sections = distinct(beam.section for beam in scene.beams)
        if any(section.strain_energy is None for section in sections):
            data["stiffness"] = section_data(mesh, scene, ("EA", "GA", "EI"), degree)
        if any(section.damped for section in sections) and not self._scheme.rates.at_rest:
            data["times"] = section_data(mesh, scene, ("retardation",), degree)
        return data

    def refill(self, scene: Scene) -> None:
        """Set all numbers to those of a scene of the same structure, whose mesh is set."""
        for field in self.moving:
            if field is not None:
                field.array[:] = 0.0
        self._reset_constants()
        data = self._section_data(scene)
        changed = refill(self.of_sections, data)
        if self.of_drag:
            data |= (of_drag := coefficients(scene, scene.drags, self._mesh))
            changed += refill(self.of_drag, of_drag)
        self.changes += bool(changed)
        for name in self._by_cells.keys() & set(changed):
            self._by_cells[name].refill(data[name].by_cells(len(self._tags)))

    # -- Steps backwards ------------------------------------------------------------------------

    def vjp(self) -> vjp_form.BoundVjp:
        """The work of the internal forces on weights, and its derivatives."""
        source, data, spaces = self._varied(vjp_form.vjp_of)
        of_weights = [self._mesh.unknowns]
        if self.facts.width:
            of_weights.append(spaces["internal"])
        return self._bound_vjp(source, data, spaces, of_weights)

    def _varied(
        self, writer: Callable[[Kind], Any], without: Iterable[str] = ()
    ) -> tuple[FormSource, dict[str, Any], dict[str, Space]]:
        """Forms whose data vary cell by cell; the data, and spaces of derivatives, by name."""
        names = [name for name in self.of_sections if name not in without]
        varied = self._vary({name: self.of_sections[name] for name in names})
        stiffness, times = _shapes({name: field.data for name, field in varied.items()})
        kind, facts = self._kind._replace(stiffness=stiffness, times=times), self.facts
        data = self._data | {name: field.on_mesh for name, field in varied.items()}
        spaces = self._spaces(varied)
        if facts.width:
            spaces["internal"] = self._internal.space
        if facts.names:
            values = np.zeros((len(self._tags), 1, len(facts.names)))
            data["more"] = Data(1, values).on(self._mesh)
            spaces["parameters"] = data["more"].space
        return _forms_of(writer, kind), data, spaces

    def vjp_drag(self) -> vjp_form.BoundVjp:
        """The work of the drag on weights, and its derivatives."""
        varied = self._vary(self.of_drag)
        source, data = self._drag(varied, vjp_of_drag)
        return self._bound_vjp(source, data, self._spaces(varied), [self._mesh.unknowns])

    def _spaces(self, varied: Mapping[str, FilledField]) -> dict[str, Space]:
        """Spaces of derivatives by name: by data that vary, and by all that forms may depend on."""
        spaces = {name: field.on_mesh.space for name, field in varied.items()}
        spaces |= dict.fromkeys(NODAL, self._mesh.unknowns)
        return {**spaces, **self.natural.spaces, "coordinates": self._mesh.positions}

    def _bound_vjp(
        self,
        source: FormSource,
        data: Mapping[str, Any],
        spaces: dict[str, Space],
        of_weights: list[Space],
    ) -> vjp_form.BoundVjp:
        """A work on the mesh, with derivatives by coefficients in the given spaces."""
        weights = {f"weight {k}": Field(space) for k, space in enumerate(of_weights)}
        data = {**data, **weights}

        def bind(form: CompiledForm, of_form: list[Space]) -> BoundForm:
            return BoundForm(form, self._mesh, data, of_form, self._tags)

        return vjp_form.BoundVjp(source, spaces, bind, of_weights)

    def stored_energy_by(
        self, q: np.ndarray, internal: Given = None, natural: Given = None
    ) -> dict[str, np.ndarray]:
        """Derivatives of `strain_energy` by "q", "X", and "stiffness" (cells, points, 3).

        And by "internal" variables (cells, degree, width), "natural" strains (cells, degree, 3) and
        "parameters" (n,) of the scene.
        """
        self._start.array[:] = q
        self._set_internal(internal)
        self.natural.set(natural)
        derivatives = self._assembled(self._stored)
        derivatives["q"] = derivatives.pop("start")
        return derivatives

    @cached_property
    def _stored(self) -> dict[str, BoundForm]:
        """Derivatives of the stored energy on the mesh by name."""
        return self._derivatives(*self._varied(vjp_form.StoredForm, without=["times"]))

    def _assembled(self, forms: Mapping[str, BoundForm]) -> dict[str, np.ndarray]:
        """Derivatives by name, those by all parameters of the scene."""
        vectors = {name: (form.spaces[0], form.vector()) for name, form in forms.items()}
        derivatives = vjp_form.named(vectors)
        if "parameters" in derivatives:
            of_all = np.zeros(len(self._parameters))
            of_all[self.parameters] = derivatives["parameters"]
            derivatives["parameters"] = of_all
        return derivatives

    def _derivatives(
        self,
        source: FormSource,
        data: Mapping[str, Any],
        spaces: Mapping[str, Space],
        *tests: Space,
    ) -> dict[str, BoundForm]:
        """Derivatives on the mesh by name."""
        return {
            name: BoundForm(form, self._mesh, data, [*tests, spaces[name]], self._tags)
            for name, form in source.module("derivatives").forms.items()
        }

    def losses_by(self, part: Part) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in a completed step: of material and scheme, and of drag.

        By "increment", "start" and "q_previous" (size of beams,), "X", "internal" variables,
        strains
        "natural" at the start and "natural_end", "parameters" (n,) of the scene, "stiffness",
        "times", and coefficients of "drag ...".
        """
        self.begin_part(part)
        return [self._assembled(forms) for forms in self._lost]

    @cached_property
    def _lost(self) -> list[dict[str, BoundForm]]:
        """Derivatives of what beams lose in a step, as those of the stored energy."""
        lost = []
        if any(self.of_loss[:2]):
            lost.append(self._derivatives(*self._varied(vjp_form.LossForm)))
        if self.of_drag:
            varied = self._vary(self.of_drag)
            spaces = self._spaces({f"drag {name}": of for name, of in varied.items()})
            lost.append(self._derivatives(*self._drag(varied), spaces))
        return lost

    @cached_property
    def derived_resultants(self) -> ResultantDerivatives:
        """Derivatives of `resultants`."""
        of_points = self._mesh.space(self.degree, 3)
        forms = self._derivatives(*self._varied(vjp_form.ResultantForm), of_points)
        return ResultantDerivatives(forms, of_points.points, self.begin_part)

    def _vary(self, fields: Mapping[str, FilledField]) -> dict[str, FilledField]:
        """The same data cell by cell; `refill` sets them as well."""
        cells = len(self._tags)
        for name, field in fields.items():
            if name not in self._by_cells:
                self._by_cells[name] = FilledField(field.data.by_cells(cells), self._mesh)
        return {name: self._by_cells[name] for name in fields}

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Data of sections and of drag by name, cell by cell."""
        names, cells = {"times": "retardation"}, len(self._tags)
        fields = {names.get(name, name): field for name, field in self.of_sections.items()}
        if self.of_drag:
            fields |= {f"drag {name}": field for name, field in self.of_drag.items()}
        return {name: field.data.by_cells(cells).values for name, field in fields.items()}

    def _bind(
        self, compiled: CompiledForm, space: Space | None = None, data: Mapping | None = None
    ) -> BoundForm:
        """Bind a form of a step, of the unknowns or in another space, and keep it by its name."""
        spaces = [space or self._mesh.unknowns] * compiled.arguments
        form = BoundForm(compiled, self._mesh, data or self._data, spaces, self._tags)
        self.bound[compiled.name] = form
        return form

    # -- Evaluation -----------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether the scheme is static."""
        return self._scheme.rates.at_rest

    @property
    def depend_on_rates(self) -> bool:
        """Whether forces may depend on rates."""
        return self.has_external or bool(self.of_drag) or self.facts.resultants_move

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor, and in statics its increment in the step."""
        self._values["load_factor"][...] = factor
        self._values["load_increment"][...] = increment

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step."""
        self._values["time"][...] = interval.start + self._scheme.rates.level * interval.length
        self._values["dt"][...] = interval.length
        self._start.array[:] = start.q
        if (self.facts.needs_rates or self.of_drag) and len(start.v):
            for field, rate in zip(self._start_rates, (start.v, start.a), strict=True):
                field.array[:] = rate
        if self.facts.needs_previous:
            self._values["memory"][...] = start.memory
            before = start.q if start.q_previous is None else start.q_previous
            self.moving[4].array[:] = before
        self._set_internal(start.internal)
        self.natural.set(*(start.natural or (None, None)))

    def _set_internal(self, internal: np.ndarray | None) -> None:
        """Set the internal variables (cells, degree, width) at the start of the step."""
        if internal is not None:
            self._internal.array[:] = internal.ravel()

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the internal forces (eq. 53), by the reduced rule, and drag to `out` (size,)."""
        self.increment.array[:] = D
        for form in self._forces:
            form.add_to(out)

    def add_tangent(self, values: np.ndarray, at: np.ndarray) -> None:
        """Add their tangent (eq. 54), derived by UFL, to entries `at` of stored values."""
        for form in self._tangents:
            form.add_to(values, at)

    def add_external(self, out: np.ndarray) -> None:
        """Add the forces of virtual works of a user, with the motion, to `out` (size,)."""
        for form in self._added:
            form.add_to(out)

    def strain_energy(self, q: np.ndarray, internal: Given = None, natural: Given = None) -> float:
        """Stored energy [J], integrated by the reduced rule.

        Of q (size,), internal variables, and natural strains (cells, degree, 3).
        """
        self._start.array[:] = q
        self._set_internal(internal)
        self.natural.set(natural)
        return self._energy.total()

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        self._start.array[:] = q
        return self._inversion.total() > 0

    def normal_stretch(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        instant = Parts(np.zeros(1), np.ones(1), q=q[None], memory=np.zeros(1))
        values = self._point_values(self._forms.module("normal_stretch"))
        return values(instant, np.empty((1, 0)), (self.degree,))[0]

    def _point_values(self, expressions: FormModule) -> PointValues:
        """Values of expressions, one for all cells, or for each subdomain its own."""
        bound = [BoundForm(of, self._mesh, self._data) for of in expressions.forms.values()]
        tags = self._tags if len(bound) > 1 else 0 * self._tags
        return PointValues(bound, tags, self._mesh, self.moving)

    def begin_part(self, part: Part) -> None:
        """Begin a completed step."""
        level = part.interval.start + self._scheme.rates.level * part.interval.length
        self._parameters.begin(level, part.start.parameters)
        self.begin(part.interval, part.start)
        self.increment.array[:] = part.D

    @cached_property
    def _resultants(self) -> PointValues:
        return self._point_values(self._forms.module("of_points"))

    def resultants(self, parts: Parts) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        parameters = parts.parameters
        if not parameters.size:
            parameters = self._parameters.at_times(parts.t)
        shape = self.degree, 3
        return self._resultants(parts, parameters[:, self.parameters], shape)


def _forms_of(writer: Callable[[Any], Any], kind: Any) -> FormSource:
    """What a writer has of a kind."""
    return FormSource(kind.key and (writer.__name__, *kind.key), lambda: writer(kind))


def _shapes(data: Mapping[str, Data]) -> tuple[DataShape | None, DataShape | None]:
    """Shapes of stiffnesses and retardation times, as `WeakForm` takes them."""
    stiffness, times = data.get("stiffness"), data.get("times")
    return stiffness and stiffness.shape, times and times.shape


class NaturalFields:
    """Fields of natural strains; none if they are not `present`."""

    def __init__(self, mesh: Mesh, degree: int, present: bool):
        #: The fields and their spaces, by name.
        self.data: dict[str, Field] = {}
        self.spaces: dict[str, Space] = {}
        if present:
            space = mesh.space(degree, 3)
            self.data = {name: Field(space) for name in NATURAL}
            self.spaces = dict.fromkeys(NATURAL, space)

    def set(self, start: np.ndarray | None, end: np.ndarray | None = None) -> None:
        """Set the strains (cells, degree, 3) at the start or at the end of the step."""
        for field, values in zip(self.data.values(), (start, end), strict=False):
            if values is not None:
                field.array[:] = values.ravel()
