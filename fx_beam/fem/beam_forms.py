"""The weak form of one step on the mesh of a scene: forces, tangent and energies of its beams."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fx_beam.laws.interval import Interval, Part, Parts, StepStart
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.scene import Scene

from . import dolfinx_api, interval_mesh, vjp_form
from .beam_drag import BeamDrag, DragForms, LossToDrag, VjpDrag, coefficients
from .dolfinx_api import CompiledForm
from .fields import (
    Data,
    DataShape,
    Fields,
    FilledField,
    distinct,
    fields_of,
    on_beam,
    refill,
    section_data,
)
from .mesh import Mesh
from .parameter_values import ParameterValues
from .point_values import PointValues
from .vjp_form import ResultantDerivatives
from .weak_form import Material, WeakForm, inverted_sections, weak_form

Given = np.ndarray | None


class BeamForms:
    """Forces and energies of the beams of a scene, their drag, and virtual works added by a user.

    Vectors contain all degrees of freedom; those of beams are the first.
    """

    time: Any
    dt: Any
    memory: Any
    load_factor: Any
    load_increment: Any

    # -- Construction ---------------------------------------------------------------------------

    def __init__(self, scene: Scene, scheme: Scheme, mesh: Mesh, parameters: ParameterValues):
        self._scheme, self._mesh, self._parameters = scheme, mesh, parameters
        #: UFL's constant of the parameters in the forms, None without any, and their indices among
        #: all.
        self.parameters: tuple[Any, list[int]] = None, []
        #: Data of beams, by name, that vary cell by cell for steps backwards.
        self._by_cells: dict[str, FilledField] = {}
        #: How often data of beams were changed.
        self.changes = 0
        #: Derivatives of the stored energy by name, with their spaces; None until they are needed.
        self._stored: tuple[dict, dict] | None = None
        #: Those of what beams lose in a step.
        self._lost: list[tuple[dict, dict]] | None = None
        #: Those of resultants.
        self._derived: ResultantDerivatives | None = None
        #: Forms by name: on the mesh, and as compiled.
        self.bound: dict[str, tuple[Any, CompiledForm]] = {}
        #: Their names, in order.
        self.names: list[str] = []
        self._weak = weak = self._weak_form(scene)
        #: UFL's fields, and what they stand for on this mesh.
        self.fields = weak.fields
        self._data |= self._fields(bool(scene.drags))
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in problem.h; None is missing.
        self.moving = [self._data.get(field) for field in weak.moving]
        self.increment, self._start, *self._start_rates = self.moving[:4]
        #: Their values, those of missing ones apart.
        self._moved = [field.x.array for field in self.moving if field is not None]
        if weak.added is not None:
            self._added = self._bind(weak.added)
        self._residual, self._tangent = self._bind(weak.force), self._bind(weak.tangent)
        self._energy = self._bind(weak.energy)
        #: Forms of `WeakForm.losses`; None where there is none.
        self.of_loss = [form and self._bind(form) for form in weak.losses]
        for form in (weak.held_before, weak.actuation):
            if form:
                self._bind(form)
        if weak.evolution is not None:
            self._bind_evolution(weak.evolution)
        #: Whether the forces depend on the start of the last step, and on rates at the start of a
        #: step.
        self.needs_previous, self.needs_rates = weak.needs_previous, weak.needs_rates
        #: Whether the resultants depend on rates at the start of a step, and on any rates.
        self.resultants_need_rates = weak.resultants_need_rates
        self.resultants_move = weak.resultants_move
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = len(self._tags), self.fields.degree, weak.width
        self.matrix = dolfinx_api.create_matrix(self._tangent, mesh.mesh)
        #: Positions of its values among those of the tangent of all forces.
        self.value_at: slice | np.ndarray = slice(0, len(self.matrix.data))
        self.drag = self._drag_on_beams(scene)

    def _fields(self, damps: bool) -> dict[Any, Any]:
        """Constants and functions in the place of UFL's fields, for drag if it `damps`."""
        mesh, space, fields = self._mesh.mesh, self._mesh.space, self.fields
        names = "time", "dt", "load_factor", "memory", "load_increment"
        for name in names:
            setattr(self, name, dolfinx_api.constant(mesh, 0.0))
        #: Their values as arrays, which are set more quickly.
        self._values = {name: getattr(self, name).value for name in names}
        self._reset_constants()
        data = {getattr(fields, name): getattr(self, name) for name in names}
        if self._weak.internal is not None:
            gauss_space = interval_mesh.gauss_space(mesh, fields.degree, self._weak.width)
            data[self._weak.internal] = dolfinx_api.function(gauss_space)
            self._cell_points = dolfinx_api.element_dofs(gauss_space)
        #: Natural strains at both ends of the step.
        self.natural = NaturalFields(mesh, fields, self._weak.has_natural)
        data |= self.natural.data
        data |= {field: dolfinx_api.function(space) for field in self._weak.given(damps)}
        #: Space of the increment and of the virtual displacements and rotations.
        self._space, unknowns = self._unknowns(fields)
        return data | unknowns

    def _reset_constants(self) -> None:
        for name, value in self._values.items():
            value[...] = 1.0 if name in ("dt", "load_factor") else 0.0

    def _unknowns(self, fields: Fields) -> tuple[Any, dict[Any, Any]]:
        """Space of the increment, and the increment in the place of UFL's."""
        mesh, space = self._mesh.mesh, self._mesh.space
        data: dict[Any, Any] = {}
        if fields.coordinate is not None:
            space = interval_mesh.nodal_rotations(space, fields.degree)
            data[fields.coordinate] = dolfinx_api.coordinate_on_cells(mesh, fields.degree)
        return space, data | {fields.increment: dolfinx_api.function(space)}

    def _drag_on_beams(self, scene: Scene) -> BeamDrag | None:
        drags = [] if self._scheme.rates.at_rest else scene.drags
        of_beams = [drag for drag in drags if isinstance(drag.target, Beam)]
        if not of_beams:
            return None
        plan = DragForms(scene, of_beams, self._mesh, self._scheme, self.fields.plain)
        space, unknowns = self._unknowns(plan.fields)
        data = self._data | unknowns | plan.data
        forms = [self._bound(form, space, data) for form in plan.compiled]
        #: Coefficients of the drag on beams by name.
        self.of_drag, self._drag_fields = plan.coefficients, plan.fields
        return BeamDrag(self._mesh.mesh, unknowns[plan.fields.increment], *forms[:2])

    def _weak_form(self, scene: Scene) -> WeakForm:
        """The weak form of the scene; the data of the sections are those of the forms."""
        mesh, degree = self._mesh, scene.beams[0].degree
        sections = [beam.section for beam in scene.beams]
        of_beams = [(section.strain_energy, section.internal) for section in sections]
        materials: list[Material] = []
        for material in of_beams:
            if material not in materials:
                materials.append(material)
        kinds = [materials.index(material) for material in of_beams]
        #: Subdomain of each cell, the number of its material.
        self._tags = np.array(kinds)[mesh.beam_of_cell]
        data = self._section_data(scene)
        everywhere = Data(0, np.array(1.0))
        inside = [
            everywhere if work.beam is None else on_beam(mesh, scene, work.beam)
            for work in scene.virtual_works
        ]
        self._kind = fields_of(degree, mesh.curved), self._scheme, materials
        self._works = [
            (work, on.shape) for work, on in zip(scene.virtual_works, inside, strict=True)
        ]
        weak = weak_form(*self._kind, *_shapes(data), self._works, bool(scene.natural_strains))
        self._data: dict[Any, Any] = {
            symbol: data.on(mesh) for symbol, data in zip(weak.indicators, inside, strict=True)
        }
        #: Data of the sections by name.
        self.of_sections = {name: FilledField(values, mesh) for name, values in data.items()}
        self._data |= {getattr(weak, name): f.on_mesh for name, f in self.of_sections.items()}
        if weak.names:
            self._read_parameters(weak)
        return weak

    def _read_parameters(self, weak: WeakForm) -> None:
        """Let the forms read the values of their parameters."""
        values = dolfinx_api.constant(self._mesh.mesh, np.zeros(len(weak.names)))
        self._data[weak.parameters] = values
        for parameter in self._scheme.parameters:
            self._parameters.check_constant(parameter.name, f"{self._scheme.name}: damping")
        indices = self._parameters.indices(weak.names)

        def read(of_all: np.ndarray) -> None:
            values.value[:] = of_all[indices]

        self._parameters.add_reader(read, weak.names_in_energies)
        self.parameters = weak.parameters, indices

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
        for values in self._moved:
            values[:] = 0.0
        self._reset_constants()
        data = self._section_data(scene)
        changed = refill(self.of_sections, data)
        if self.drag is not None:
            drags = [drag for drag in scene.drags if isinstance(drag.target, Beam)]
            data |= (of_drag := coefficients(scene, drags, self._mesh))
            changed += refill(self.of_drag, of_drag)
        self.changes += bool(changed)
        for name in self._by_cells.keys() & set(changed):
            self._by_cells[name].refill(data[name].by_cells(len(self._tags)))

    # -- Steps backwards ------------------------------------------------------------------------

    def vjp(self) -> vjp_form.BoundVjp:
        """The work of the internal forces on weights, and its derivatives."""
        weak, data, spaces = self._varied(vjp_form.VjpForm)
        data[weak.weight] = dolfinx_api.function(self._space)
        if weak.width:
            data[weak.internal_weight] = dolfinx_api.function(spaces["internal"])
        return self._bound_vjp(weak.work, spaces, data, self.fields.increment)

    def _varied(self, kind: Any, without: Iterable[str] = ()) -> tuple[Any, dict, dict[str, Any]]:
        """A form of a kind, whose data vary cell by cell; what is in the place of its symbols.

        And the spaces of its data, by name.
        """
        names = [name for name in self.of_sections if name not in without]
        varied = self._vary({name: self.of_sections[name] for name in names})
        shapes = {name: field.data for name, field in varied.items()}
        given: Any = *_shapes(shapes), self._works, self._weak.has_natural
        weak = weak_form(*self._kind, *given, kind, self._weak.parameters)
        data = self._data | {getattr(weak, name): field.on_mesh for name, field in varied.items()}
        pairs = zip(weak.indicators, self._weak.indicators, strict=True)
        data |= {symbol: self._data[known] for symbol, known in pairs}
        spaces = {name: field.on_mesh.function_space for name, field in varied.items()}
        if weak.width:
            data[weak.internal] = self._data[self._weak.internal]
            spaces["internal"] = data[weak.internal].function_space
        if weak.more is not None:
            values = np.zeros((len(self._tags), 1, len(weak.names)))
            data[weak.more] = Data(1, values).on(self._mesh)
            spaces["parameters"] = data[weak.more].function_space
        return weak, data, spaces

    def vjp_drag(self) -> vjp_form.BoundVjp:
        """The work of the drag on weights, and its derivatives."""
        plan, spaces, data = self._varied_drag(VjpDrag)
        data[plan.weight] = dolfinx_api.function(data[plan.fields.increment].function_space)
        return self._bound_vjp(plan.work, spaces, data, plan.fields.increment)

    def _varied_drag(self, kind: Any) -> tuple[Any, dict[str, Any], dict]:
        """Forms of the drag of a kind, whose coefficients vary cell by cell.

        And the spaces of these by name, and what is in the place of symbols.
        """
        varied = self._vary(self.of_drag)
        shapes = {name: field.data.shape for name, field in varied.items()}
        plan = kind(self._drag_fields, self._scheme.rates, shapes)
        data = self._data | self._unknowns(plan.fields)[1]
        data |= {plan.symbols[name]: field.on_mesh for name, field in varied.items()}
        return plan, {name: f.on_mesh.function_space for name, f in varied.items()}, data

    def _bind_drag_loss(self) -> tuple[dict, dict]:
        plan, spaces, data = self._varied_drag(LossToDrag)
        self._drag_increment = data[plan.fields.increment]
        spaces = {f"drag {name}": space for name, space in spaces.items()}
        return self._bound_forms(plan.forms, self._drag_increment.function_space, spaces, data)

    def _bound_vjp(
        self, work: Any, spaces: dict[str, Any], data: Mapping, increment: Any
    ) -> vjp_form.BoundVjp:
        """A work on the mesh, with derivatives by coefficients in the given spaces."""
        space, mesh, tags = data[increment].function_space, self._mesh.mesh, self._subdomains
        spaces = self._spaces_of_vjp(space, spaces)
        moving = [data[increment], *self.moving[1:]]

        def bind(form: CompiledForm, of_form: list[Any]) -> Any:
            return dolfinx_api.bind(form, mesh, of_form or None, data, tags)

        of_weights = [data[weight].function_space for weight in work.weights]
        return vjp_form.BoundVjp(work, spaces, moving, bind, of_weights)

    def _spaces_of_vjp(self, space: Any, spaces: dict[str, Any]) -> dict[str, Any]:
        nodal = {"increment": space, "start": self._mesh.space, "q_previous": self._mesh.space}
        positions = interval_mesh.positions_space(self._mesh.mesh)
        return {**spaces, **nodal, **self.natural.spaces, "coordinates": positions}

    def stored_energy_by(
        self, q: np.ndarray, internal: Given = None, natural: Given = None
    ) -> dict[str, np.ndarray]:
        """Derivatives of `strain_energy` by "q", "X", and "stiffness" (cells, points, 3).

        And by "internal" variables (cells, degree, width), "natural" strains (cells, degree, 3) and
        "parameters" (n,) of the scene.
        """
        if self._stored is None:
            self._stored = self._bind_energy(vjp_form.StoredForm, without=["times"])
        self._set(self._start, q)
        self._set_internal(internal)
        self.natural.set(natural)
        derivatives = self._assembled(*self._stored)
        derivatives["q"] = np.zeros(len(q))
        derivatives["q"][: self._mesh.in_beams] = derivatives.pop("start")
        return derivatives

    def _assembled(self, forms: Mapping, spaces: Mapping) -> dict[str, np.ndarray]:
        """Derivatives by name, those by all parameters of the scene."""
        derivatives = vjp_form.assembled(forms, spaces, self._mesh)
        if "parameters" in derivatives:
            of_all = np.zeros(len(self._parameters))
            of_all[self.parameters[1]] = derivatives["parameters"]
            derivatives["parameters"] = of_all
        return derivatives

    def _bind_energy(self, kind: Any, without: Iterable[str] = ()) -> tuple[dict, dict]:
        """Derivatives of an energy on the mesh by name, and the space of each."""
        weak, data, spaces = self._varied(kind, without)
        return self._bound_forms(weak.forms, self._space, spaces, data)

    def _bound_forms(
        self, compiled: Any, space: Any, spaces: dict[str, Any], data: Mapping
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Derivatives on the mesh by name, those by coefficients in given spaces; all spaces."""
        spaces, given = self._spaces_of_vjp(space, spaces), (data, self._subdomains)
        return {
            name: dolfinx_api.bind(form, self._mesh.mesh, spaces[name], *given)
            for name, form in compiled.items()
        }, spaces

    def losses_by(self, part: Part) -> list[dict[str, np.ndarray]]:
        """Derivatives of what beams lose in a completed step: of material and scheme, and of drag.

        By "increment", "start" and "q_previous" (size of beams,), "X", "internal" variables,
        strains
        "natural" at the start and "natural_end", "parameters" (n,) of the scene, "stiffness",
        "times", and coefficients of "drag ...".
        """
        if self._lost is None:
            self._lost = [self._bind_energy(vjp_form.LossForm)] if any(self.of_loss[:2]) else []
            self._lost += [self._bind_drag_loss()] if self.drag is not None else []
        self.begin_part(part)
        if self.drag is not None:
            self._set(self._drag_increment, part.D)
        return [self._assembled(*lost) for lost in self._lost]

    def derive_resultants(self) -> ResultantDerivatives:
        """Derivatives of `resultants`."""
        if self._derived is None:
            weak, data, spaces = self._varied(vjp_form.ResultantForm)
            mesh, degree = self._mesh.mesh, self.fields.degree
            weight = dolfinx_api.function(interval_mesh.gauss_space(mesh, degree, 3))
            data[weak.weight] = weight
            forms, spaces = self._bound_forms(weak.forms, self._space, spaces, data)
            changes = {name: dolfinx_api.function(spaces[name]) for name in weak.changes}
            data |= {symbol: changes[name] for name, symbol in weak.changes.items()}
            space, tags = weight.function_space, self._subdomains
            change = dolfinx_api.bind(weak.change, mesh, space, data, tags)
            bound = forms, spaces, change, changes, weight
            self._derived = ResultantDerivatives(*bound, self._mesh, self.begin_part)
        return self._derived

    def _vary(self, fields: Mapping[str, FilledField]) -> dict[str, FilledField]:
        """The same data cell by cell; `refill` sets them as well."""
        cells = len(self._tags)
        for name, field in fields.items():
            if name not in self._by_cells:
                self._by_cells[name] = FilledField(field.data.by_cells(cells), self._mesh)
        return {name: self._by_cells[name] for name in fields}

    @property
    def _subdomains(self) -> np.ndarray | None:
        return self._tags if self._tags.any() else None

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Data of sections and of drag by name, cell by cell."""
        names, cells = {"times": "retardation"}, len(self._tags)
        fields = {names.get(name, name): field for name, field in self.of_sections.items()}
        if self.drag is not None:
            fields |= {f"drag {name}": field for name, field in self.of_drag.items()}
        return {name: field.data.by_cells(cells).values for name, field in fields.items()}

    def _bind(self, compiled: CompiledForm):
        """Bind a form of a step's fields."""
        return self._bound(compiled, self._space, self._data)

    def _bind_evolution(self, compiled: CompiledForm) -> None:
        space = self._data[self._weak.internal].function_space
        self._bound(compiled, space, self._data)
        self._internal = self._data[self._weak.internal].x.array.reshape(-1, self._weak.width)
        #: Weights (degree,) of the Gauss points, relative to the element's length.
        self.point_weights = dolfinx_api.gauss_weights(self.fields.degree)

    def bind(self, compiled: CompiledForm, data: Mapping):
        """Bind a form of other data, such as the mass, and keep it by its name."""
        return self._bound(compiled, self._mesh.space, data)

    def _bound(self, compiled: CompiledForm, space, data: Mapping):
        form = dolfinx_api.bind(compiled, self._mesh.mesh, space, data, self._subdomains)
        if compiled.name not in self.bound:
            self.names.append(compiled.name)
        self.bound[compiled.name] = form, compiled
        return form

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The tangent in compressed rows: values (which `add_tangent` sets), columns, starts."""
        return self.matrix.data, self.matrix.indices, self.matrix.indptr

    def cells_of(self, tag: int) -> np.ndarray:
        """Cells of a subdomain of the forms; -1 for all."""
        every = np.arange(len(self._tags))
        return every if tag < 0 else np.flatnonzero(self._tags == tag)

    # -- Evaluation -----------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether the scheme is static."""
        return self._scheme.rates.at_rest

    @property
    def has_external(self) -> bool:
        """Whether there are virtual works of a user."""
        return self._weak.added is not None

    @property
    def depend_on_rates(self) -> bool:
        """Whether forces may depend on rates."""
        return self.has_external or self.drag is not None or self.resultants_move

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor, and in statics its increment in the step."""
        self._values["load_factor"][...] = factor
        self._values["load_increment"][...] = increment

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step."""
        self._values["time"][...] = interval.start + self._scheme.rates.level * interval.length
        self._values["dt"][...] = interval.length
        self._set(self._start, start.q)
        if (self.needs_rates or self.drag is not None) and len(start.v):
            for function, rate in zip(self._start_rates, (start.v, start.a), strict=True):
                self._set(function, rate)
        if self.needs_previous:
            self._values["memory"][...] = start.memory
            self._set(self.moving[4], start.q if start.q_previous is None else start.q_previous)
        self._set_internal(start.internal)
        self.natural.set(*(start.natural or (None, None)))

    def _set(self, function, values: np.ndarray) -> None:
        """Set a function to the values (size,) at the nodes of beams."""
        function.x.array[:] = values[: self._mesh.in_beams]

    def _set_internal(self, internal: np.ndarray | None) -> None:
        """Set the internal variables (cells, degree, width) at the start of the step."""
        if internal is not None:
            self._internal[self._cell_points] = internal

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the internal forces (eq. 53), by the reduced rule, and drag to `out` (size,)."""
        self._set(self.increment, D)
        dolfinx_api.add_vector(out[: self._mesh.in_beams], self._residual)
        if self.drag is not None:
            self.drag.add_force(D, out)

    def add_tangent(self, values: np.ndarray) -> None:
        """Add their tangent (eq. 54), derived by UFL, to the values of that of all forces."""
        dolfinx_api.assemble_matrix(self.matrix, self._tangent)
        if len(values) > len(self.matrix.data):  # else they are the same
            values[self.value_at] += self.matrix.data
        if self.drag is not None:
            self.drag.add_tangent(values, self.value_at)

    def add_external(self, out: np.ndarray) -> None:
        """Add the forces of virtual works of a user, with the motion, to `out` (size,)."""
        if self.has_external:
            dolfinx_api.add_vector(out[: self._mesh.in_beams], self._added)

    def strain_energy(self, q: np.ndarray, internal: Given = None, natural: Given = None) -> float:
        """Stored energy [J], integrated by the reduced rule.

        Of q (size,), internal variables, and natural strains (cells, degree, 3).
        """
        self._set(self._start, q)
        self._set_internal(internal)
        self.natural.set(natural)
        return dolfinx_api.assemble_scalar(self._energy)

    def bind_inversion(self) -> None:
        """Bind the form that `is_inverted` takes."""
        if "inverted sections" not in self.bound:
            self._inversion = self._bind(inverted_sections(self.fields.plain))

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        self._set(self._start, q)
        return dolfinx_api.assemble_scalar(self._inversion) > 0

    def normal_stretch(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        instant = Parts(np.zeros(1), np.ones(1), q=q[None], memory=np.zeros(1))
        values = self._point_values(self._weak.normal_stretch, [self.cells_of(-1)])
        return values(instant, np.empty((1, 0)), (self.fields.degree,))[0]

    def _point_values(
        self, expressions: list[CompiledForm], cells: list[np.ndarray]
    ) -> PointValues:
        fields = self.fields
        changing = fields.time, fields.dt, fields.memory, self.parameters[0]
        pairs, moving = zip(expressions, cells, strict=True), self._weak.moving
        return PointValues(pairs, self._mesh.mesh, self._data, moving, changing)

    def begin_part(self, part: Part) -> None:
        """Begin a completed step."""
        level = part.interval.start + self._scheme.rates.level * part.interval.length
        self._parameters.begin(level, part.start.parameters)
        self.begin(part.interval, part.start)
        self._set(self.increment, part.D)

    @functools.cached_property
    def _resultants(self) -> PointValues:
        compiled = self._weak.compiled_resultants
        return self._point_values(compiled, [self.cells_of(tag) for tag in range(len(compiled))])

    def resultants(self, parts: Parts) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        parameters = parts.parameters
        if not parameters.size:
            parameters = self._parameters.at_times(parts.t)
        shape = self.fields.degree, 3
        return self._resultants(parts, parameters[:, self.parameters[1]], shape)


def _shapes(data: Mapping[str, Data]) -> tuple[DataShape | None, DataShape | None]:
    """Shapes of stiffnesses and retardation times, as `WeakForm` takes them."""
    stiffness, times = data.get("stiffness"), data.get("times")
    return stiffness and stiffness.shape, times and times.shape


class NaturalFields:
    """Functions in the place of UFL's fields of natural strains; none if they are not `present`."""

    def __init__(self, mesh: Any, fields: Fields, present: bool):
        #: The functions by their fields, and spaces by the names of derivatives.
        self.data: dict[Any, Any] = {}
        self.spaces: dict[str, Any] = {}
        if present:
            space = interval_mesh.gauss_space(mesh, fields.degree, 3)
            self._points = dolfinx_api.element_dofs(space)
            self.data = {field: dolfinx_api.function(space) for field in fields.natural}
            self.spaces = {"natural": space, "natural_end": space}

    def set(self, start: np.ndarray | None, end: np.ndarray | None = None) -> None:
        """Set the strains (cells, degree, 3) at the start or at the end of the step."""
        for function, values in zip(self.data.values(), (start, end), strict=False):
            if values is not None:
                function.x.array.reshape(-1, 3)[self._points] = values
