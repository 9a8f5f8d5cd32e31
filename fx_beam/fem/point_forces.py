"""The forces at points in a step: gathered, called and scattered in C, also for steps in Python."""

from __future__ import annotations

import enum
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.dual import floats
from fx_beam.laws.interval import Interval, StepStart
from fx_beam.laws.point_laws import PointLaw, StepRule, arguments
from fx_beam.scene.structure import OtherStructureError

from .compiled_laws import compiled_laws
from .loads import Followers
from .parameter_values import ParameterValues
from .sparsity import positions_in

if TYPE_CHECKING:
    from .frictions import Bristle, SmoothSign
    from .member_contacts import MemberContacts

_NONE = np.empty(0)
_NO_LINE = {"pieces": 0, "moves": [-1], "length_entries": 0, "others": 0, "level": 0.0}
_HEADER = "point_force.h"
_LIBRARY = "forces at points", "point_forces.h", _HEADER


class Role(enum.IntEnum):
    """What a force is recorded or counted as; in the order in which they are evaluated."""

    CONTACT, OTHER, EXTERNAL, SLIDE = range(4)


class Load(NamedTuple):
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
    load: Load = Load()
    #: The contact or force between points to which it belongs, as text; empty for a joint.
    owner: str = ""
    #: Number of that force between points, or -1.
    line: int = -1

    @property
    def belongs_to(self) -> str:
        """What of the scene it belongs to, as text; a joint by its number."""
        joint, name = (self.slide, "slide") if self.slide >= 0 else (self.joint, "rotation")
        return self.owner or f"joint {joint} {name}"


class PlacedForce(NamedTuple):
    """A force, its law, and where its internal variables and numbers are among those of all."""

    force: PointForce
    law: Any  # compiled
    numbers: np.ndarray
    first_internal: int
    first_number: int

    @property
    def variables(self) -> np.ndarray:
        """Places of its internal variables."""
        return self.first_internal + np.arange(self.law.law.internal)


def by_role(forces: Sequence[PointForce]) -> list[PointForce]:
    """Forces in the order in which they are evaluated."""
    return sorted(forces, key=lambda force: force.role)


def _without_numbers(force: PointForce) -> tuple:
    """A force without its numbers; its functions of a user are compared in the scene.

    Nor with the text of its owner, which has positions, and the axis of its load.
    """
    return force.law.kind, *force[2:7], force.load.joint, force.load.turn, force.line


class PointForces:
    """All forces at points of a scene. Their data lie in C, where both kinds of steps use them."""

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
        self._names = parameters.names
        self._rule = rule
        #: Values of the external ones over time.
        self.followers = followers
        counts = [force.law.internal for force in forces]
        firsts = np.cumsum([0, *counts])[:-1].tolist()
        order = sorted(range(len(forces)), key=lambda i: forces[i].role)
        #: Place of the internal variables of each force among all.
        self._first_internal = [firsts[i] for i in order]
        self._forces = forces = [forces[i] for i in order]
        laws, compiled = [force.law for force in forces], compiled_laws
        if any(law.of_length for law in laws):
            from .line_laws import laws_of_forces as compiled
        self._laws = compiled(laws, rule)
        for law in dict.fromkeys(self._laws):
            law.check_at_zero(parameters.values[parameters.indices(law.parameters)])
        roles = np.array([force.role for force in forces], dtype=int)
        #: Numbers of forces up to the end of each role.
        self.ends = [int(np.searchsorted(roles, role, "right")) for role in Role]
        self._nodal = self.ends[Role.EXTERNAL]
        #: Number of points that obstacles or members may stop.
        self.contacts = self.ends[Role.CONTACT] + (members.slots if members else 0)
        #: Number of `switches` of each law, and of all.
        self._switch_counts = [law.conditions for law in self._laws]
        self._switch_counts += members.switch_counts if members else []
        self.conditions = sum(self._switch_counts)
        #: The forces that work as loads do, and whether there are any.
        self.external = slice(self.ends[Role.OTHER], self._nodal)
        self.has_external = self._nodal > self.external.start
        #: Whether forces may dissipate energy, and may depend on rates.
        self.dissipate = self.any_have("loss")
        self.depend_on_rates = self.has_external or self.dissipate
        #: Number of all internal variables.
        self._of_forces = sum(counts)
        self.width = self._of_forces + (members.width if members else 0)
        #: Joints of the slides, and their columns, once they are known.
        self.slides = np.array([force.slide for force in forces[self._nodal :]], dtype=int)
        self.columns = np.full(len(self.slides), -1)
        #: In statics the increment of the load factor.
        self._load_increment = 0.0
        dofs = (np.array(force.dofs or [-1]) for force in forces)
        pairs = [force_dofs[law.entries] for force_dofs, law in zip(dofs, self._laws, strict=True)]
        #: Rows and columns (entries, 2) of the tangent; below 0 for the ground and slides.
        self.pairs = np.concatenate([np.empty((0, 2), dtype=int), *pairs])
        #: Positions of their values in the tangent, -1 for none; `locate_in` finds them.
        self.value_at = np.full(len(self.pairs), -1, dtype=np.int32)
        #: Inputs of all forces in one array, views of it for each force and for the numbers of its
        #: law, and results of each force.
        self.given = _NONE
        self._given: list[np.ndarray] = []
        self._numbers: list[np.ndarray] = []
        self._results: list[np.ndarray] = []
        #: Whether there are any, on nodes, slides or members.
        self.any = bool(forces) or members is not None
        if self.any:
            self._build()
        in_energies = [name for law in self._laws if law.law.energy for name in law.parameters]
        parameters.add_energies(in_energies)
        parameters.add_reader(self.set_parameters)

    def __len__(self):
        return len(self._forces)

    def any_have(self, name: str) -> bool:
        """Whether a law has an attribute, such as a "loss"."""
        return any(bool(getattr(law, name)) for law in self.laws)

    @property
    def laws(self) -> list[PointLaw]:
        """Those of all forces."""
        return [law.law for law in (*self._laws, *(self.members.laws if self.members else ()))]

    # -- Data in C ------------------------------------------------------------------------------

    def _build(self) -> None:
        ffi, self._c = c_library.open_library(*_LIBRARY)
        self._of = functools.partial(ffi.from_buffer, ffi.typeof("double[]"))
        self._of_numbers = functools.partial(ffi.from_buffer, ffi.typeof("int[]"))
        self._structs = structs = Structs(ffi)
        laws = self._laws
        self.given, self._given = _parts([law.given for law in laws])
        ends = [arguments(law.law) for law in laws]
        self._numbers = [
            inputs[end - law.law.numbers : end]
            for inputs, end, law in zip(self._given, ends, laws, strict=True)
        ]
        _, self._results = _parts([law.values for law in laws])
        first_entries = np.cumsum([0, *(len(law.entries) for law in laws)])
        rows = [self._row(i, int(first)) for i, first in enumerate(first_entries[:-1])]
        self._all = ffi.new("PointForces *")
        following = sum(force.load.joint >= 0 for force in self._forces)
        structs.set(
            self._all,
            contacts=self.ends[Role.CONTACT],
            recorded=self.contacts,
            external=self.external.start,
            nodal=self._nodal,
            all=len(rows),
            of=rows,
            members=None,
            probe=np.zeros(max((law.values + 2 * law.law.size for law in laws), default=1)),
            followed={"size": following, "memory": np.zeros(self._c.FIXED_POINT_ROWS * following)},
        )
        if self.members is not None:
            address = self.members.build(ffi, self._c, structs, self._of_forces)
            structs.set(self._all, members=address)
        structs.check(self._all)
        #: Address of the C struct PointForces.
        self.address = int(ffi.cast("uintptr_t", self._all))

    def check(self, forces: Sequence[PointForce]) -> None:
        """OtherStructureError if forces are of other kinds."""
        if [*map(_without_numbers, by_role(forces))] != [*map(_without_numbers, self._forces)]:
            raise OtherStructureError("forces at points are of other kinds")

    def bind(self, forces: Sequence[PointForce], followers: Followers) -> None:
        """Set the numbers of all forces."""
        self._forces, self.followers = by_role(forces), followers
        for i, (force, numbers) in enumerate(zip(self._forces, self._numbers, strict=True)):
            numbers[:] = force.numbers
            if force.load.joint >= 0:
                self._all.of[i].load_axis = force.load.axis

    def _row(self, i: int, first_entry: int) -> dict[str, Any]:
        """A force as ``PointForce`` of c/point_force.h."""
        force, law, inputs = self._forces[i], self._laws[i], self._given[i]
        point_law = law.law
        self._numbers[i][:] = force.numbers
        return {
            **_NO_LINE,
            **law.members,
            "switches": law.address("switches"),
            "pull": law.address("pull"),
            "line": force.line,
            "size": point_law.size,
            "conditions": law.conditions,
            "needs_line_search": point_law.needs_line_search
            or (point_law.unilateral and self._rule.at_rest),
            "dof": np.array(force.dofs or [-1]),
            "slide": force.slide,
            "column": -1,
            "joint": force.joint,
            "nodes": force.nodes,
            "load": force.load.joint,
            "load_turn": force.load.turn,
            "load_axis": force.load.axis,
            "first_internal": self._first_internal[i],
            "first_entry": first_entry,
            "given": inputs,
            "numbers": self._numbers[i],
            "parameters": len(law.parameters),
            "parameter": [self._names.index(name) for name in law.parameters],
            "parameter_values": inputs[arguments(point_law) :],
            "results": self._results[i],
            "tangent_at": np.zeros(2 * point_law.size + len(law.entries)),
        }

    @property
    def slopes(self) -> list[tuple[int, int, int]]:
        """For each force: address of `CompiledLaw.slopes`, how many numbers, how many slopes."""
        return [(law.slopes_address, law.law.numbers, law.slopes_size) for law in self._laws]

    def set_columns(self, of_joints: Mapping[int, int]) -> None:
        """Set the columns of the slides, by the number of the joint."""
        self.columns = np.array([of_joints[joint] for joint in self.slides], dtype=int)
        for i, column in enumerate(self.columns.tolist(), start=self._nodal):
            self._all.of[i].column = column

    def locate_in(self, K: scipy.sparse.csr_matrix) -> None:
        """Find the entries in the values of a matrix."""
        positions = positions_in(K.indptr, K.indices, *self.pairs.T)
        self.value_at[:] = np.where(self.pairs.min(axis=1) < 0, -1, positions)

    # -- A step ---------------------------------------------------------------------------------

    @property
    def by_load_factor(self) -> np.ndarray:
        """Derivatives (numbers,) of the numbers of all forces by the load factor."""
        ends = np.cumsum([*map(len, self._numbers)], dtype=int)
        by_factor = np.zeros(ends[-1] if len(ends) else 0)
        by_factor[ends[self.external] - 1] = 1.0
        return by_factor

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor of external forces, and in statics its increment in the step."""
        for numbers in self._numbers[self.external]:
            numbers[-1] = factor
        self._load_increment = increment

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step. In statics its length is the increment of the load."""
        if not self.any:
            return
        t = interval.at(self._rule.level)
        dt = self._load_increment if self._rule.at_rest else interval.length
        missing = np.zeros(int(self.slides.max(initial=-1)) + 1)
        slides, rates = (x if len(x) else missing for x in (start.slides, start.slide_rates))
        vectors = (self._of(x) for x in (start.q, start.v, slides, rates))
        variables = self._of(self._variables(start.spring_internal))
        self._c.fx_begin_points(self._all, *vectors, t, dt, variables)
        if len(self.followers):
            first = self.external.start
            for i, force in enumerate(floats(self.followers.at(interval)), start=first):
                self._numbers[i][:2] = force

    def set_parameters(self, values: np.ndarray) -> None:
        """Set the values (n,) of all parameters of the scene."""
        if self.any:
            self._c.fx_set_parameters(self._all, self._of(values))

    def evaluate_slides(self, z: np.ndarray) -> None:
        """Evaluate the forces on slides for the increments of all columns (columns,)."""
        if len(self.slides):
            ends = self._nodal, len(self._forces)
            self._c.fx_evaluate_points(self._all, *ends, self._of(_NONE), self._of(z))

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Evaluate the forces at nodes for D (size,), and add them (size,) against the motion."""
        if self._forces:
            self._c.fx_evaluate_points(self._all, 0, self._nodal, self._of(D), self._of(_NONE))
            self._c.fx_add_points(self._all, 0, self._nodal, 1.0, self._of(out))
        if self.members is not None:
            self.members.add_force(D, out)

    def add_external(self, out: np.ndarray) -> None:
        """Add the external ones at the last increment with the motion."""
        if self.has_external:
            first, end = self.external.start, self.external.stop
            self._c.fx_add_points(self._all, first, end, -1.0, self._of(out))

    def add_tangent(self, values: np.ndarray) -> None:
        """Add their derivatives by the increments to the entries of the stiffness."""
        if self._forces:
            value_at = self._of_numbers(self.value_at)
            self._c.fx_add_point_tangents(self._all, value_at, self._of(values))

    def on_slides(self, entry: int) -> np.ndarray:
        """Forces (0) on the slides, or their slopes (1)."""
        return np.array([result[entry] for result in self._results[self._nodal :]])

    def _variables(self, internal: np.ndarray | None) -> np.ndarray:
        """Internal variables (width,); zero by default."""
        return np.zeros(self.width) if internal is None else internal

    def energy(self, q: np.ndarray, slides: np.ndarray, internal: np.ndarray | None) -> float:
        """Energy [J] that is stored in a configuration."""
        if not self.any:
            return 0.0
        vectors = (self._of(x) for x in (q, slides, self._variables(internal)))
        return self._c.fx_stored_at_points(self._all, *vectors)

    def energy_by(
        self,
        q: np.ndarray,
        slides: np.ndarray,
        internal: np.ndarray,
        parameters: np.ndarray | None = None,
    ) -> dict[str, np.ndarray]:
        """Derivatives (k, ...) of `energy` in k configurations, with values of the parameters.

        By "q", "slides", "spring internal", "points" (numbers) and "parameters"; with contact of
        members also by "members", their numbers, and the positions "X" of nodes.
        """
        inputs = np.empty((len(q), len(self.given)))
        for i, of_row in enumerate(zip(q, slides, internal, strict=True)):
            if parameters is not None:
                self.set_parameters(parameters[i])
            self.energy(*of_row)  # which places all forces
            inputs[i] = self.given
        sums = self._sums("energy", inputs, q.shape[1], slides.shape[1])
        if self.members is not None:
            sums |= self.members.energy_by(q, internal, sums)
        return sums

    def given_with(self, D: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """What all forces are given at mean rates, for increments of nodes (size,) and slides."""
        z = np.zeros(int(self.columns.max(initial=-1)) + 1)
        z[self.columns] = slides[self.slides]
        self._c.fx_lost_at_points(self._all, self._of(D), self._of(z))
        return self.given.copy()

    def losses_by(self, inputs: np.ndarray, size: int, joints: int) -> dict[str, np.ndarray]:
        """Derivatives (k, ...) of energy lost at mean rates, from k rows of `given_with`.

        By "q" and "slides" at the start, their "increment" and "slide increment", and the others
        as `energy_by`. Losses of members that touch are left out.
        """
        return self._sums("loss", inputs, size, joints)

    def _sums(self, kind: str, inputs: np.ndarray, size: int, joints: int) -> dict[str, np.ndarray]:
        """Derivatives (k, ...) of the sum of an energy of all forces by what they are given."""
        motions = [("slides", "q"), ("slide increment", "increment")][: 1 + (kind == "loss")]
        sizes = {name: n for pair in motions for name, n in zip(pair, (joints, size), strict=True)}
        sizes |= {"spring internal": self.width, "points": sum(map(len, self._numbers))}
        sizes["parameters"] = len(self._names)
        sums = {name: np.zeros((len(inputs), size)) for name, size in sizes.items()}
        first = begin = 0
        for force, law, start in zip(self._forces, self._laws, self._first_internal, strict=True):
            size, last, numbers = law.law.size, arguments(law.law), law.law.numbers
            end = begin + law.given
            if getattr(law.law, kind) is not None:
                slopes = law.derivatives(kind).in_rows(inputs[:, begin:end])
                for i, (on_slide, at_nodes) in enumerate(motions):
                    part = slopes[:, i * size : (i + 1) * size]
                    if force.slide >= 0:
                        sums[on_slide][:, force.slide] += part[:, 0]
                    for k, dof in enumerate(force.dofs):
                        if dof >= 0:
                            sums[at_nodes][:, dof] += part[:, k]
                index = 3 * size + 2
                slots = slice(start, start + law.law.internal)
                sums["spring internal"][:, slots] += slopes[:, index : index + law.law.internal]
                sums["points"][:, first : first + numbers] += slopes[:, last - numbers : last]
                for i, name in enumerate(law.parameters):
                    sums["parameters"][:, self._names.index(name)] += slopes[:, last + i]
            first, begin = first + numbers, end
        return sums

    def along(self, line: int) -> Iterator[PlacedForce]:
        """The forces of a line between points."""
        ends = np.cumsum([0, *map(len, self._numbers)], dtype=int).tolist()
        arrays = self._forces, self._laws, self._numbers, self._first_internal, ends
        return (placed for placed in map(PlacedForce, *arrays) if placed.force.line == line)

    def parameters_of(self, law: Any) -> np.ndarray:
        """Numbers of the parameters of a law among those of the scene."""
        return np.array([self._names.index(name) for name in law.parameters], dtype=int)

    @property
    def follow_joints(self) -> bool:
        """Whether there is friction that follows the force of a joint."""
        return any(force.load.joint >= 0 for force in self._forces)

    @property
    def followed(self) -> np.ndarray:
        """Internal variables that are forces of joints, which friction follows in a step."""
        pairs = zip(self._forces, self._first_internal, strict=True)
        return np.array([first + 2 for force, first in pairs if force.load.joint >= 0], dtype=int)

    @property
    def bristles(self) -> list[Bristle]:
        """The springs of all friction that sticks."""
        from .frictions import Bristle

        triples = zip(self._forces, self._first_internal, self._numbers, strict=True)
        of_forces = [
            Bristle(first, float(numbers[-2]), force.load.joint >= 0)
            for force, first, numbers in triples
            if force.law.has_stick_state
        ]
        of_members = [] if self.members is None else self.members.bristles
        return of_forces + [Bristle(self._of_forces + place, mu, False) for place, mu in of_members]

    @property
    def smooth_signs(self) -> list[SmoothSign]:
        """All friction with the smooth sign of a rate."""
        from .frictions import SmoothSign

        signs = list[SmoothSign]()
        for force, numbers in zip(self._forces, self._numbers, strict=True):
            if force.law.smooth:
                arm = numbers[:2] if len(force.dofs) == 4 else _NONE  # numbers of a distance
                place = force.slide, force.dofs, arm, force.belongs_to
                signs.append(SmoothSign(float(numbers[len(arm)]), *place))
        return signs

    @property
    def owners(self) -> np.ndarray:
        """What of the scene each internal variable (width,) belongs to, as text."""
        texts = [""] * self.width
        for force, first in zip(self._forces, self._first_internal, strict=True):
            texts[first : first + force.law.internal] = [force.belongs_to] * force.law.internal
        return np.array(texts, dtype=str)

    def remember(self, internal: np.ndarray | None, moved: np.ndarray, slid: np.ndarray) -> bool:
        """Whether internal variables depend on degrees of freedom or slides that have moved.

        Contacts that have not been closed have nothing to remember.
        """
        have_closed = self._variables(internal)[self.first_of_contacts :].any()
        of_joints = (f for f in self._forces[self.ends[Role.CONTACT] :] if f.law.internal)
        places = ((slid, [f.slide]) if f.slide >= 0 else (moved, f.dofs) for f in of_joints)
        return bool(have_closed) or any(x[i] for x, indices in places for i in indices if i >= 0)

    @property
    def first_of_contacts(self) -> int:
        """First of the internal variables of contacts, which follow each other."""
        return self._first_internal[0] if self.ends[Role.CONTACT] else 0

    def friction_of_members(self, internal: np.ndarray) -> dict[int, np.ndarray]:
        """`MemberContacts.friction` from all internal variables (n, width)."""
        members = self.members
        return {} if members is None else members.friction(internal[:, self._of_forces :])

    def switches(self, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Values that change their sign where a contact opens or closes, or a law switches."""
        values = np.zeros(self.conditions)
        if len(values):
            vectors = (self._of(x) for x in (q, slides, values))
            self._c.fx_find_switches(self._all, *vectors)
        return values

    def friction_sticks(self, q: np.ndarray, slides: np.ndarray) -> bool:
        """Whether friction acts that sticks: of a joint, or of a contact that is closed."""
        ends = np.cumsum(self._switch_counts, dtype=int)
        pairs = zip(self.laws, np.split(self.switches(q, slides) <= 0, ends), strict=False)
        return any(
            law.has_stick_state and (not law.unilateral or closed.any()) for law, closed in pairs
        )


def _parts(sizes: list[int]) -> tuple[np.ndarray, list[np.ndarray]]:
    """An array of zeros, and its parts."""
    values = np.zeros(sum(sizes))
    return values, np.split(values, np.cumsum(sizes)[:-1]) if sizes else []
