"""Forces and tangent of the beams of a part of a scene, several elements at once."""

from __future__ import annotations

import numpy as np

from fx_beam.c_library import Structs, declarations
from fx_beam.fem import dolfinx_api
from fx_beam.laws.interval import Interval, StepStart
from fx_beam.step.build import load_library
from fx_beam.step.element_data import element_data
from fx_beam.step.form_tables import FormTables
from fx_beam.step.model import Model


class BatchedBeams:
    """In the place of `BeamForms` for internal forces and drag: the functions of the loop."""

    def __init__(self, model: Model):
        assert model.forms.beams is not None
        self._beams = beams = model.forms.beams
        self._ffi, self._library = load_library()
        structs, self._c = Structs(self._ffi, declarations("problem.h")), self._ffi.new("Problem *")
        self._kept = structs  # and with it the arrays of C
        matrix, lanes = model.forms.stiffness, self._library.LANES
        dofs, coordinates, stored_at = element_data(model.mesh, matrix)
        _, *steps = beams.moving
        #: Fields that change from step to step by nodes, and then those by cells with their places.
        self._by_cells = [
            None if field is None else (field, dolfinx_api.element_dofs(field.function_space))
            for field in steps[self._library.INTERNAL - 1 :]
        ]
        self._fields = [np.empty(0)] * len(beams.moving)
        for kind, field in enumerate(steps[: self._library.INTERNAL - 1], start=1):
            if field is not None:
                self._fields[kind] = field.x.array
        structs.set(
            self._c,
            dofs=model.size,
            stored_values=matrix.nnz,
            cell_dofs=dofs.shape[1],
            cell_coordinates=coordinates.shape[1],
            cell_internal=int(np.prod(beams.internal_shape[1:])),
            cell_natural=3 * beams.internal_shape[1] if beams.natural.data else 0,
        )
        self._tables = FormTables(beams, dofs, coordinates, stored_at, self._c, lanes)
        # The constants of the forms are set in Python.
        none = {"time_at": -1, "dt_at": -1, "memory_at": -1, "parameters": 0}
        for name, table in self._tables.all(("internal_forces", "drag")).items():
            structs.set(self._c, **{name: table | none})
        # Lanes without an element add behind the end.
        self._force, self._tangent = np.zeros(model.size + lanes), np.zeros(matrix.nnz + lanes)
        self._begun = False

    # -- As in BeamForms --------------------------------------------------------------------------

    @property
    def has_external(self) -> bool:
        """Whether there are virtual works of a user."""
        return self._beams.has_external

    @property
    def depend_on_rates(self) -> bool:
        """Whether forces may depend on rates."""
        return self._beams.depend_on_rates

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor, and in statics its increment in the step."""
        self._beams.set_load(factor, increment)

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step."""
        self._beams.begin(interval, start)
        self._begun = False

    def add_external(self, out: np.ndarray) -> None:
        """Add the forces of virtual works of a user."""
        self._beams.add_external(out)

    # -- By the loop ------------------------------------------------------------------------------

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Add the internal forces and drag to `out` (size,); finds their tangent as well."""
        if not self._begun:
            self._begin()
        self._fields[0] = D
        self._force[:], self._tangent[:] = 0.0, 0.0
        to = self._doubles(self._force), self._doubles(self._tangent)
        self._library.fx_add_beams(self._c, self._c_fields(), *to)
        out += self._force[: len(out)]

    def add_tangent(self, values: np.ndarray) -> None:
        """Add their tangent to the values of that of all forces."""
        values += self._tangent[: len(values)]

    def _begin(self) -> None:
        """Hand over what changes from step to step, now that all of it is set."""
        self._tables.refill()
        for kind, by_cells in enumerate(self._by_cells, start=self._library.INTERNAL):
            if by_cells is not None:
                field, points = by_cells
                at_points = field.x.array.reshape(points.max() + 1, -1)[points]
                self._fields[kind] = at_points.ravel()
        self._library.fx_begin_beams(self._c, self._c_fields())
        self._begun = True

    def _c_fields(self):
        self._pointers = [self._doubles(np.asarray(f, float, "C")) for f in self._fields]
        return self._ffi.new("double *[]", self._pointers)

    def _doubles(self, values: np.ndarray):
        return self._ffi.from_buffer("double[]", values)
