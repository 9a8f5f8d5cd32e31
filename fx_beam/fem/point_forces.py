"""The forces at points of a scene: their compiled laws, and their sums in a step."""

from __future__ import annotations

import enum
import functools
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.content_cache import shallow_copy
from fx_beam.dual import floats
from fx_beam.laws.interval import Interval, StepBatch
from fx_beam.laws.point_laws import PointLaw, StepRule, arguments
from fx_beam.scene.structure import OtherStructureError

from .compiled_laws import LIBRARY, laws_of_forces
from .functions_of_time import Followers, ParameterValues
from .mesh import positions_in

if TYPE_CHECKING:
    from .compiled_laws import CompiledLaw, LineLaw
    from .member_contacts import MemberContacts, MemberPair
    from .mesh import Mesh


# -- The forces at points of a scene: their compiled laws, and what belongs to each among all ---


_NO_LINE = {"pieces": 0, "moves": [-1], "length_entries": 0, "others": 0, "level": 0.0}


class Role(enum.IntEnum):
    """Roles of forces in records, in the order in which they are evaluated."""

    CONTACT, OTHER, EXTERNAL, SLIDE = range(4)


class FrictionNormalForce(NamedTuple):
    """The force of a joint that limits friction on it: all of it, or its part across an axis."""

    joint: int = -1
    #: The axis in the reference, and the rotation that turns it; zero for all of the force. That
    #: of a beam at the node that slides on it is set in each step.
    axis: tuple[float, float] = (0.0, 0.0)
    turn: int = -1


class PointForce(NamedTuple):
    """A force at points: its law, and what belongs to it alone."""

    law: PointLaw
    #: Numbers of the law.
    numbers: Sequence[float]
    #: Degrees of freedom of its coordinates, -1 for the ground; or the joint of its slide.
    dofs: Sequence[int] = ()
    slide: int = -1
    #: Joint to whose moment it belongs, or -1.
    joint: int = -1
    role: Role = Role.OTHER
    #: Of a contact the number of nodes, the first ones, on which the force on its point acts.
    nodes: int = 0
    load: FrictionNormalForce = FrictionNormalForce()
    #: The contact or force between points to which it belongs, as text; empty for a joint.
    owner: str = ""
    #: Number of that force between points, or -1.
    line: int = -1

    @property
    def belongs_to(self) -> str:
        """Owner in the scene, as text; a joint by its number."""
        joint, name = (self.slide, "slide") if self.slide >= 0 else (self.joint, "rotation")
        return self.owner or f"joint {joint} {name}"


class PlacedForce(NamedTuple):
    """A force with its compiled law, the arrays that C has of it, and its places among all."""

    force: PointForce
    law: CompiledLaw | LineLaw
    #: What its functions are given, the numbers of the law among it, and what the law gives.
    given: np.ndarray
    numbers: np.ndarray
    results: np.ndarray
    #: Places of its parameters; first of its internal variables, numbers and tangent entries.
    parameters: np.ndarray
    first_internal: int
    first_number: int
    first_entry: int

    @property
    def variables(self) -> np.ndarray:
        """Places of its internal variables."""
        return self.first_internal + np.arange(self.law.law.internal)

    @property
    def counters(self) -> np.ndarray:
        """Places of its counters."""
        return self.variables[self.law.law.internal - self.law.law.counters :]

    def members(self, at_rest: bool) -> dict[str, object]:
        """The force as ``PointForce`` of c/point_force.h, whose scheme may be static."""
        force, law, point_law = self.force, self.law, self.law.law
        return {
            **_NO_LINE,
            **law.members,
            "switches": law.address("switches"),
            "pull": law.address("pull"),
            "line": force.line,
            "size": point_law.size,
            "conditions": law.conditions,
            "needs_line_search": point_law.needs_line_search or (point_law.unilateral and at_rest),
            "dof": np.array(force.dofs or [-1]),
            "slide": force.slide,
            "column": -1,
            "joint": force.joint,
            "nodes": force.nodes,
            "load": force.load.joint,
            "load_turn": force.load.turn,
            "load_axis": force.load.axis,
            "first_internal": self.first_internal,
            "first_entry": self.first_entry,
            "given": self.given,
            "numbers": self.numbers,
            "parameters": len(self.parameters),
            "parameter": self.parameters,
            "parameter_values": self.given[arguments(point_law) :],
            "results": self.results,
            "tangent_at": np.zeros(2 * point_law.size + len(law.entries)),
        }


def by_role(forces: Sequence[PointForce]) -> list[PointForce]:
    """Forces in the order in which they are evaluated."""
    return sorted(forces, key=lambda force: force.role)


def _without_numbers(force: PointForce) -> tuple:
    """A force without its numbers; its functions of a user are compared in the scene.

    Nor with the text of its owner, which has positions, and the axis of its load.
    """
    return force.law.kind, *force[2:7], force.load.joint, force.load.turn, force.line


def _check_at_zero(laws: Iterable[CompiledLaw | LineLaw], parameters: ParameterValues) -> None:
    """SceneError if a law is not finite at zero, by the present values of its parameters."""
    for law in dict.fromkeys(laws):
        law.check_at_zero(parameters.values[parameters.indices(law.parameters)])


def _placed(
    forces: Sequence[PointForce], rule: StepRule, parameters: ParameterValues
) -> tuple[list[PlacedForce], np.ndarray]:
    """Forces by their roles, and inputs of all; variables have places as forces come."""
    if not forces:
        return [], np.empty(0)

    laws = [force.law for force in forces]
    pairs = [*zip(forces, laws_of_forces(laws, rule), strict=True)]
    _check_at_zero((law for _, law in pairs), parameters)
    variables = itertools.accumulate((law.internal for law in laws), initial=0)
    triples = sorted(zip(pairs, variables, strict=False), key=lambda x: x[0][0].role)
    sizes = [(w.input_count, w.size, w.law.numbers, len(w.entries)) for (_, w), _ in triples]
    starts = np.cumsum([(0, 0, 0, 0), *sizes], axis=0).tolist()
    all_inputs, results, placed = np.zeros(starts[-1][0]), np.zeros(starts[-1][1]), []
    for ((force, law), first), start, end in zip(triples, starts[:-1], starts[1:], strict=True):
        inputs, last = all_inputs[start[0] : end[0]], arguments(law.law)
        numbers = inputs[last - law.law.numbers : last]
        numbers[:] = force.numbers
        places = np.array(parameters.indices(law.parameters), dtype=int)
        arrays = inputs, numbers, results[start[1] : end[1]], places
        placed.append(PlacedForce(force, law, *arrays, first, *start[2:]))
    return placed, all_inputs


class PointForces:
    """All forces at points of a scene: their laws, numbers and places."""

    def __init__(
        self,
        forces: Sequence[PointForce],
        followers: Followers,
        rule: StepRule,
        parameters: ParameterValues,
        members: MemberContacts | None = None,
    ):
        #: Contact of nodes with members; None without any.
        self.members = members
        self.rule, self.parameters = rule, parameters
        #: Values of the external ones over time.
        self.followers = followers
        #: All forces by their roles, and the inputs of their laws, in one array.
        self.placed, self.inputs = _placed(forces, rule, parameters)
        roles = np.array([placed.force.role for placed in self.placed], dtype=int)
        ends = [int(np.searchsorted(roles, role, "right")) for role in Role]
        #: Number of contacts, which come first, and the forces that work as loads do.
        self.first_contacts, self.external = ends[0], slice(*ends[Role.OTHER : Role.SLIDE])
        #: Whether there are any, on nodes, slides or members.
        self.any = bool(forces) or members is not None
        #: Number of all internal variables.
        self.width = sum(force.law.internal for force in forces) + (members.width if members else 0)
        #: Number of `switches` of each law.
        self.switch_counts = [placed.law.conditions for placed in self.placed]
        self.switch_counts += [len(pair.points) for pair in members.pairs] if members else []
        slides = [placed.force.slide for placed in self.placed[self.external.stop :]]
        #: Joints of the slides, and their columns, once they are known.
        self.slides, self.columns = np.array(slides, dtype=int), np.full(len(slides), -1)
        #: Rows and columns (entries, 2) of the tangent; below 0 for the ground and slides.
        dofs = (np.array(placed.force.dofs or [-1])[placed.law.entries] for placed in self.placed)
        self.pairs = np.concatenate([np.empty((0, 2), dtype=int), *dofs])
        #: Positions of their values in the tangent, -1 for none; `locate_in` finds them.
        self.value_at = np.full(len(self.pairs), -1, dtype=np.int32)
        for placed in self.placed:
            if placed.law.law.energy:
                parameters.add_energies(placed.law.parameters)

    def check(self, forces: Sequence[PointForce]) -> None:
        """OtherStructureError if forces are of other kinds."""
        if not (forces or self.placed):
            return
        own_forces = [_without_numbers(placed.force) for placed in self.placed]
        if [*map(_without_numbers, by_role(forces))] != own_forces:
            raise OtherStructureError("forces at points are of other kinds")

    def set_numbers(
        self, forces: Sequence[PointForce], followers: Followers, pairs: list[MemberPair]
    ) -> None:
        """Set the numbers of all forces, and of contact with members."""
        if not self.any:
            return
        self.followers = followers
        if self.members is not None:
            self.members.set_numbers(pairs)
        if not self.placed:
            return
        sorted_forces = zip(self.placed, by_role(forces), strict=True)
        self.placed = [placed._replace(force=force) for placed, force in sorted_forces]
        for placed in self.placed:
            placed.numbers[:] = placed.force.numbers
        if self.parameters.names:
            laws = (placed.law for placed in self.placed)
            _check_at_zero((law for law in laws if law.parameters), self.parameters)

    def in_block(self, block: Any, parameters: ParameterValues, mesh: Mesh) -> PointForces:
        """Forces whose numbers are in the block of a run; `set_numbers` is to follow."""
        if not self.any:
            return self
        other, view = shallow_copy(self), block.view
        other.parameters = parameters
        if self.members is not None:
            other.members = self.members.in_block(block, mesh)
        if self.placed:
            other.inputs = view(self.inputs)
            other.placed = [
                placed._replace(
                    given=view(placed.given),
                    numbers=view(placed.numbers),
                    results=view(placed.results),
                )
                for placed in self.placed
            ]
        return other

    def locate_in(self, K: scipy.sparse.csr_matrix) -> None:
        """Find the entries in the values of a matrix."""
        positions = positions_in(K.indptr, K.indices, *self.pairs.T)
        self.value_at[:] = np.where(self.pairs.min(axis=1) < 0, -1, positions)

    # -- What they are ----------------------------------------------------------------------------

    @property
    def laws(self) -> list[PointLaw]:
        """Laws of all forces, and of contact with members."""
        members = self.members.laws if self.members else ()
        return [law.law for law in (*(placed.law for placed in self.placed), *members)]

    def any_have(self, name: str) -> bool:
        """Whether a law has an attribute, such as a "loss"."""
        return any(bool(getattr(law, name)) for law in self.laws)

    @property
    def contacts(self) -> int:
        """Number of points that obstacles or members may stop."""
        return self.first_contacts + (self.members.slots if self.members else 0)

    @property
    def normal_forces(self) -> np.ndarray:
        """Internal variables that are forces of joints, which friction follows in a step."""
        following = (placed for placed in self.placed if placed.force.load.joint >= 0)
        return np.array([placed.first_internal + 2 for placed in following], dtype=int)

    @property
    def flows(self) -> bool:
        """Whether there are internal variables that do not only count."""
        return self.width > sum(placed.law.law.counters for placed in self.placed)

    def spans_of(self, measured: Any) -> np.ndarray | None:
        """Places of half turns of spans, of the length of a rope over pulleys; else None."""
        for placed in self.placed:
            if measured.counts_turns and placed.force.line == measured.place.number:
                return placed.counters
        return None

    @property
    def owners(self) -> np.ndarray:
        """Owner in the scene of each internal variable (width,), as text."""
        texts = [""] * self.width
        for placed in self.placed:
            for variable in placed.variables.tolist():
                texts[variable] = placed.force.belongs_to
        return np.array(texts, dtype=str)

    @property
    def first_of_contacts(self) -> int:
        """First of the internal variables of contacts, which follow each other."""
        return self.placed[0].first_internal if self.first_contacts else 0


# -- The forces at points in a step: gathered, called and scattered in C, also for steps in Python


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
