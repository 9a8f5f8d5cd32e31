"""The weak form of one step on the mesh of a scene: internal forces, tangent, stored energy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.mechanics.interval import Interval
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene

from . import dolfinx_api, interval_mesh
from .beam_drag import BeamDrag, DragForms, coefficients
from .dolfinx_api import CompiledForm
from .fields import Fields, fields_of
from .free_nodes import with_blocks
from .nodal_forms import NodalForms
from .section_fields import Data, FilledField, distinct, on_beam, refill, section_data
from .weak_form import Material, WeakForm, inverted_sections, weak_form


class Part(NamedTuple):
    """A completed step, or a part of a halved one."""

    interval: Interval
    #: Increment (size,), and displacements and rotations (size,) at the start.
    D: np.ndarray
    q: np.ndarray
    #: Rates and accelerations (size,) at the start.
    rates: tuple[np.ndarray, ...] = ()
    #: Start of the last step (size,), and `Step.memory`.
    before: np.ndarray | None = None
    memory: float = 0.0
    #: Internal variables (cells, degree, width) at the start.
    internal: np.ndarray | None = None


class Forms(NodalForms):
    """Internal forces, tangent and energies of the beams of a scene, and forces at its nodes."""

    time: Any
    dt: Any
    memory: Any

    # -- Construction ---------------------------------------------------------------------------

    def _build_forms(self, scene: Scene) -> scipy.sparse.csr_matrix:
        self._weak = weak = self._weak_form(scene)
        #: UFL's fields, and what they stand for on this mesh.
        self.fields = weak.fields
        self._data |= self._fields(bool(scene.drags))
        self.moving = [self._data.get(field) for field in (*self.fields.moving, weak.internal)]
        self.increment, self._start, *self._start_rates = self.moving[:4]
        if weak.added is not None:
            self._added = self._bind(weak.added)
        self._residual, self._tangent = self._bind(weak.force), self._bind(weak.tangent)
        self._energy = self._bind(weak.energy)
        self._losses = [form and self._bind(form) for form in weak.losses]
        if weak.evolution is not None:
            self._bind_evolution(weak.evolution)
        self.needs_before, self.needs_rates = weak.needs_before, weak.needs_rates
        self.resultants_need_rates = weak.resultants_need_rates
        self.resultants_move = weak.resultants_move
        self.internal_shape = len(self._tags), self.fields.degree, weak.width
        self.matrix = dolfinx_api.create_matrix(self._tangent, self._mesh.mesh)
        return with_blocks(self.matrix.data, self.matrix.indices, self.matrix.indptr, self.size)

    def _fields(self, damps: bool) -> dict[Any, Any]:
        """Constants and functions in the place of UFL's fields, for drag if it `damps`."""
        mesh, space, fields = self._mesh.mesh, self._mesh.space, self.fields
        names = "time", "dt", "load_factor", "memory", "load_increment"
        for name in names:
            setattr(self, name, dolfinx_api.constant(mesh, 0.0))
        self._reset_constants()
        data = {getattr(fields, name): getattr(self, name) for name in names}
        if self._weak.internal is not None:
            gauss_space = interval_mesh.gauss_space(mesh, fields.degree, self._weak.width)
            data[self._weak.internal] = dolfinx_api.function(gauss_space)
            self._cell_points = dolfinx_api.element_dofs(gauss_space)
        data |= {field: dolfinx_api.function(space) for field in self._weak.given(damps)}
        #: Space of the increment and of the virtual displacements and rotations.
        self._space, unknowns = self._unknowns(fields)
        return data | unknowns

    def _reset_constants(self) -> None:
        self.time.value = self.memory.value = self.load_increment.value = 0.0
        self.dt.value = self.load_factor.value = 1.0

    def _unknowns(self, fields: Fields) -> tuple[Any, dict[Any, Any]]:
        """Space of the increment, and the increment in the place of UFL's."""
        mesh, space = self._mesh.mesh, self._mesh.space
        data: dict[Any, Any] = {}
        if fields.coordinate is not None:
            space = interval_mesh.nodal_rotations(space, fields.degree)
            data[fields.coordinate] = dolfinx_api.coordinate_on_cells(mesh, fields.degree)
        return space, data | {fields.increment: dolfinx_api.function(space)}

    def _drag_on_beams(self, scene: Scene, drags: list[Drag]) -> BeamDrag:
        plan = DragForms(scene, drags, self._mesh, self._scheme, self.fields.plain)
        space, unknowns = self._unknowns(plan.fields)
        data = self._data | unknowns | plan.data
        forms = [self._bound(form, space, data) for form in plan.compiled]
        #: Coefficients of the drag on beams by name.
        self.of_drag = plan.coefficients
        return BeamDrag(self._mesh.mesh, unknowns[plan.fields.increment], *forms)

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
        weak = weak_form(
            fields_of(degree, mesh.curved),
            self._scheme,
            materials,
            data["stiffness"].shape if "stiffness" in data else None,
            data["times"].shape if "times" in data else None,
            [(work, on.shape) for work, on in zip(scene.virtual_works, inside, strict=True)],
        )
        self._data: dict[Any, Any] = {
            symbol: data.on(mesh) for symbol, data in zip(weak.indicators, inside, strict=True)
        }
        #: Data of the sections by name.
        self.of_sections = {name: FilledField(own, mesh) for name, own in data.items()}
        self._data |= {getattr(weak, name): f.on_mesh for name, f in self.of_sections.items()}
        return weak

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
        super().refill(scene)
        for field in self.moving:
            if field is not None:
                field.x.array[:] = 0.0
        self._reset_constants()
        refill(self.of_sections, self._section_data(scene))
        drags = [drag for drag in scene.drags if isinstance(drag.target, Beam)]
        if self.beam_drag is not None:
            refill(self.of_drag, coefficients(scene, drags, self._mesh))

    def _bind(self, compiled: CompiledForm):
        """Bind a form of a step's fields."""
        return self._bound(compiled, self._space, self._data)

    def _bind_evolution(self, compiled: CompiledForm) -> None:
        space = self._data[self._weak.internal].function_space
        self._evolution = self._bound(compiled, space, self._data)
        self._internal = self._data[self._weak.internal].x.array.reshape(-1, self._weak.width)
        #: Weights (degree,) of the Gauss points, relative to the element's length.
        self.point_weights = np.polynomial.legendre.leggauss(self.fields.degree)[1] / 2

    def bind(self, compiled: CompiledForm, data: Mapping):
        """Bind a form of other data, such as the mass, and keep it by its name."""
        return self._bound(compiled, self._mesh.space, data)

    def _bound(self, compiled: CompiledForm, space, data: Mapping):
        tags = self._tags if self._tags.any() else None
        form = dolfinx_api.bind(compiled, self._mesh.mesh, space, data, tags)
        if compiled.name not in self.bound:
            self.names.append(compiled.name)
        self.bound[compiled.name] = form, compiled
        return form

    @property
    def has_added(self) -> bool:
        """Whether the scene has added virtual works or follower forces."""
        return self._weak.added is not None or super().has_added

    def cells_of(self, tag: int) -> np.ndarray:
        """Cells of a subdomain of the forms; -1 for all."""
        every = np.arange(len(self._tags))
        return every if tag < 0 else np.flatnonzero(self._tags == tag)

    # -- Evaluation -----------------------------------------------------------------------------

    def set_step(self, interval: Interval, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Set the interval of a step, and displacements, rates and accelerations at its start."""
        self._set_start(interval, q)
        super().set_step(interval, q, v, a)
        if self.needs_rates or self.beam_drag is not None:
            self._set_rates(v, a)

    def _set_start(self, interval: Interval, q: np.ndarray) -> None:
        self.time.value = interval.start + self._scheme.rates.level * interval.length
        self.dt.value = interval.length
        self._set(self._start, q)
        self._q = q

    def _set_rates(self, *rates: np.ndarray) -> None:
        for function, rate in zip(self._start_rates, rates, strict=True):
            self._set(function, rate)

    def _set(self, function, values: np.ndarray) -> None:
        """Set a function to the values (size,) at the nodes of beams."""
        function.x.array[:] = values[: self._mesh.in_beams]

    def set_memory(self, before: np.ndarray | None, memory: float) -> None:
        """Set the start of the last step (size,), and `Step.memory`, for schemes that need them."""
        if self.needs_before:
            self.memory.value = memory
            self._set(self.moving[4], self._q if before is None else before)

    def set_internal(self, internal: np.ndarray | None) -> None:
        """Set the internal variables (cells, degree, width) at the start of the step."""
        if internal is not None:
            self._internal[self._cell_points] = internal

    def evolve(self, D: np.ndarray) -> np.ndarray | None:
        """Internal variables (cells, degree, width) at the end of the step; None without any."""
        if self._weak.evolution is None:
            return None
        self._set(self.increment, D)
        grown = np.zeros(self._internal.size)
        dolfinx_api.assemble_vector(grown, self._evolution)
        at_points = grown.reshape(self._internal.shape)[self._cell_points]
        return self._internal[self._cell_points] + at_points / self.point_weights[:, None]

    def losses(self, D: np.ndarray) -> list[float]:
        """Energies [J] that material, drag and contact take; that the scheme takes, and holds."""
        self._set(self.increment, D)
        lost, *of_scheme = (
            dolfinx_api.assemble_scalar(form) if form is not None else 0.0 for form in self._losses
        )
        return [lost + super().losses(D)[0], *of_scheme]

    def add_beam_forces(self) -> None:
        """Add the internal forces of beams (eq. 53), by the reduced rule."""
        self._set(self.increment, self._D)
        dolfinx_api.assemble_vector(self._force[: self._mesh.in_beams], self._residual)

    @property
    def _assembled(self) -> int:
        """Number of assembled values of the tangent."""
        return len(self.matrix.data)

    def set_beam_tangent(self, data: np.ndarray) -> None:
        """Set the values of `stiffness` to those of beams (eq. 54), derived by UFL."""
        dolfinx_api.assemble_matrix(self.matrix, self._tangent)
        if len(data) > self._assembled:  # else it is a view
            data[:] = 0.0
            data[self.assembled] = self.matrix.data

    def added_force(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers at the last increment [N, N m]."""
        force = super().added_force()
        if self._weak.added is not None:
            added = np.empty(self._mesh.in_beams)
            dolfinx_api.assemble_vector(added, self._added)
            force[: len(added)] += added
        return force

    def strain_energy(self, q: np.ndarray, internal: np.ndarray | None = None) -> float:
        """Stored energy [J] of q (size,) and internal variables, integrated by the reduced rule."""
        self._set(self._start, q)
        self.set_internal(internal)
        return dolfinx_api.assemble_scalar(self._energy)

    def bind_inversion(self) -> None:
        """Bind the form that `is_inverted` takes."""
        self._inversion = self._bind(inverted_sections(self.fields.plain))

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        self._set(self._start, q)
        return dolfinx_api.assemble_scalar(self._inversion) > 0

    def normal_stretch(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        self._set(self._start, q)
        return dolfinx_api.evaluate(
            self._expression(self._weak.normal_stretch), self._mesh.mesh, self.cells_of(-1)
        )

    def _expression(self, expression):
        """Compile an expression of the fields for the Gauss points."""
        points = dolfinx_api.gauss_points(self.fields.degree)
        return dolfinx_api.compile_expression(expression, points, self._mesh.mesh, self._data)

    def resultants(self, parts: Iterable[Part]) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        expressions = [
            (self._expression(r), self.cells_of(tag)) for tag, r in enumerate(self._weak.resultants)
        ]
        rows = []
        for part in parts:
            self._set_start(part.interval, part.q)
            self._set(self.increment, part.D)
            if self.resultants_need_rates:
                self._set_rates(*part.rates)
            self.set_memory(part.before, part.memory)
            self.set_internal(part.internal)
            out = np.empty((len(self._tags), self.fields.degree, 3))
            for expression, cells in expressions:
                values = dolfinx_api.evaluate(expression, self._mesh.mesh, cells)
                out[cells] = values.reshape(len(cells), -1, 3)
            rows.append(out)
        return np.array(rows)
