"""The forces at points in a step: gathered, called and scattered in C, also for steps in Python."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.content_cache import shallow_copy
from fx_beam.dual import floats
from fx_beam.laws.interval import Interval, StepBatch

from .compiled_laws import LIBRARY
from .point_forces import PointForces

_NONE = np.empty(0)


class CompiledPoints:
    """The C struct PointForces with all forces at points, and what C finds of it."""

    def __init__(self, points: PointForces):
        self.points = points
        #: In statics the increment of the load factor.
        self._load_increment = 0.0
        if points.any:
            self._build()
        points.parameters.add_reader(self.set_parameters)

    def _build(self) -> None:
        points, (ffi, self._c) = self.points, c_library.open_library(*LIBRARY)
        self._doubles = functools.partial(ffi.from_buffer, ffi.typeof("double[]"))
        self._integers = functools.partial(ffi.from_buffer, ffi.typeof("int[]"))
        self._structs, laws = Structs(ffi), [placed.law for placed in points.placed]
        self._all, self._ffi = ffi.new("PointForces *"), ffi
        self._probe = np.zeros(max((law.size + 2 * law.law.size for law in laws), default=1))
        members = points.members and int(ffi.cast("uintptr_t", points.members.c))
        following = sum(placed.force.load.joint >= 0 for placed in points.placed)
        self._followed = np.zeros(self._c.FIXED_POINT_ROWS * following)
        self._structs.set(
            self._all,
            contacts=points.first_contacts,
            recorded=points.contacts,
            external=points.external.start,
            nodal=points.external.stop,
            all=len(points.placed),
            of=[placed.members(points.rule.at_rest) for placed in points.placed],
            members=members,
            probe=self._probe,
            followed={"size": following, "memory": self._followed},
        )
        #: Address of the C struct PointForces.
        self.address = int(ffi.cast("uintptr_t", self._all))

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        if not self.points.any:
            return [], []
        ffi, forces = self._ffi, self._all
        count = forces.all
        structs = [forces]
        arrays = [self.points.inputs, self._probe, self._followed]
        if self.points.members is not None:
            member_structs, member_arrays = self.points.members.memory
            structs, arrays = structs + member_structs, arrays + member_arrays
        if count:
            rows = ffi.cast(ffi.typeof(f"PointForce(*)[{count}]"), forces.of)[0]
            structs.append(rows)
            for placed, row in zip(self.points.placed, rows, strict=True):
                n = 2 * placed.law.law.size + len(placed.law.entries)
                arrays.append(np.frombuffer(ffi.buffer(row.tangent_at, 8 * n)))
            results = [placed.results for placed in self.points.placed]
            arrays.append(results[0].base if results[0].base is not None else results[0])
        return structs, arrays

    def in_block(self, block: Any, points: PointForces) -> CompiledPoints:
        """The struct in the block of a run, with the points there."""
        if not points.any:
            return self
        other = shallow_copy(self)
        other.points, other._load_increment = points, 0.0
        other._all = block.struct(self._ffi, self._all)
        other.address = int(self._ffi.cast("uintptr_t", other._all))
        points.parameters.add_reader(other.set_parameters)
        return other

    def set_axes(self) -> None:
        """Set the axes of joints whose forces limit friction."""
        for i, placed in enumerate(self.points.placed):
            if placed.force.load.joint >= 0:
                self._all.of[i].load_axis = placed.force.load.axis

    def set_columns(self, joint_columns: Mapping[int, int]) -> None:
        """Set the columns of the slides, by the number of the joint."""
        columns = self.points.columns
        columns[:] = [joint_columns[joint] for joint in self.points.slides.tolist()]
        for i, column in enumerate(columns.tolist(), start=self.points.external.stop):
            self._all.of[i].column = column

    # -- A step -----------------------------------------------------------------------------------

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor of external forces, and in statics its increment in the step."""
        for placed in self.points.placed[self.points.external]:
            placed.numbers[-1] = factor
        self._load_increment = increment

    def begin_step(self, interval: Interval, start: StepBatch) -> None:
        """Begin a step. In statics its length is the increment of the load."""
        if not self.points.any:
            return
        t = interval.time_at(self.points.rule.level)
        dt = self._load_increment if self.points.rule.at_rest else interval.length
        still = np.zeros(int(self.points.slides.max(initial=-1)) + 1)
        slides, rates = (x if x.size else still for x in (start.slides, start.slide_rates))
        variables = start.spring_internal
        if not variables.size:
            variables = np.zeros(self.points.width)
        vectors = map(self._doubles, (start.q, start.v, slides, rates))
        self._c.fx_begin_points(self._all, *vectors, t, dt, self._doubles(variables))
        if len(self.points.followers):
            forces = floats(self.points.followers.forces_in(interval))
            for placed, force in zip(
                self.points.placed[self.points.external], forces, strict=False
            ):
                placed.numbers[:2] = force

    def set_parameters(self, values: np.ndarray) -> None:
        """Set the values (n,) of all parameters of the scene."""
        if self.points.any:
            self._c.fx_set_parameters(self._all, self._doubles(values))

    def evaluate_slides(self, z: np.ndarray) -> None:
        """Evaluate the forces on slides for the increments of all columns (columns,)."""
        if len(self.points.slides):
            ends = self.points.external.stop, len(self.points.placed)
            self._c.fx_evaluate_points(self._all, *ends, self._doubles(_NONE), self._doubles(z))

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Evaluate the forces at nodes for D (size,), and add them (size,) against the motion."""
        if self.points.placed:
            ends = self._all, 0, self.points.external.stop
            self._c.fx_evaluate_points(*ends, self._doubles(D), self._doubles(_NONE))
            self._c.fx_add_points(*ends, 1.0, self._doubles(out))
        if self.points.members is not None:
            self.points.members.add_force(D, out)

    def add_external(self, out: np.ndarray) -> None:
        """Add the external ones at the last increment with the motion."""
        if self.points.any:
            ends = self.points.external.start, self.points.external.stop
            self._c.fx_add_points(self._all, *ends, -1.0, self._doubles(out))

    def add_tangent(self, values: np.ndarray) -> None:
        """Add their derivatives by the increments to the entries of the stiffness."""
        if self.points.placed:
            value_at = self._integers(self.points.value_at)
            self._c.fx_add_point_tangents(self._all, value_at, self._doubles(values))

    def on_slides(self, entry: int) -> np.ndarray:
        """Forces (0) on the slides, or their slopes (1)."""
        return np.array(
            [placed.results[entry] for placed in self.points.placed[self.points.external.stop :]]
        )

    # -- A configuration --------------------------------------------------------------------------

    def energy(self, q: np.ndarray, slides: np.ndarray, internal: np.ndarray | None) -> float:
        """Energy [J] that is stored in a configuration."""
        if not self.points.any:
            return 0.0
        variables = np.zeros(self.points.width) if internal is None else internal
        return self._c.fx_stored_at_points(self._all, *map(self._doubles, (q, slides, variables)))

    def switches(self, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Values that change their sign where a contact opens or closes, or a law switches."""
        values = np.zeros(sum(self.points.switch_counts))
        if len(values):
            self._c.fx_find_switches(self._all, *map(self._doubles, (q, slides, values)))
        return values
