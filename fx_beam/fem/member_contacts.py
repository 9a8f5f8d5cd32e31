"""Contact of nodes with members in a step: found, called and scattered in C."""

from __future__ import annotations

import enum
import functools
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.content_cache import shallow_copy
from fx_beam.errors import SceneError
from fx_beam.laws import scalar_laws as laws
from fx_beam.laws.gaps import FOLLOWED, FOLLOWED_WITH_FRICTION, MEMBER, MEMBER_WITH_FRICTION
from fx_beam.laws.point_laws import PointLaw, StepRule
from fx_beam.scene.beam import Beam
from fx_beam.scene.contacts import Contact, arc_of, points_of
from fx_beam.scene.coordinate import friction_numbers, numbers_of_loss
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .compiled_laws import LIBRARY, PointFunction, compiled_laws
from .mesh import Mesh, connected_parts

# Entries of a contact point: positions, with friction then rotations (member_contact.h).
_POSITIONS, _ENTRIES = 10, 15
#: Slots of memory of a point's friction, and numbers in each.
SLOTS, SLOT_WIDTH = 2, 3
# Nodes of a closed member on either side of its seam that are there twice; ends relative to its
# length that are at one place.
_AROUND, _SAME_PLACE = 4, 1e-9


class MemberPair(NamedTuple):
    """Points, which are nodes, against a member; compare ``MemberContact`` of member_contact.h."""

    law: PointLaw
    #: The same law for derivatives.
    followed: PointLaw
    #: Nodes that touch, and where the forces on them are recorded (-1: nowhere).
    points: np.ndarray
    point_slots: np.ndarray
    #: Nodes of the member, in order; of a closed one some at both ends are there twice.
    nodes: np.ndarray
    node_slots: np.ndarray
    #: Numbers (points, n): sum of the radii, with friction the share of the point in it, then those
    #: of the law.
    numbers: np.ndarray
    #: Of a member and itself: arc lengths of its nodes, and how far apart they must be to touch.
    arc: np.ndarray
    apart: float = 0.0
    #: The contact; None for the points of its second member.
    contact: Contact | None = None
    #: Pieces once around a closed member; 0 for others.
    turn: int = 0


def _is_closed(scene: Scene, beam: Beam) -> bool:
    """Whether a member ends where it begins, and supports or rigid joints hold both together."""
    start, end = beam.nodes[0], beam.nodes[-1]
    if np.hypot(end.x - start.x, end.y - start.y) > _SAME_PLACE * beam.length:
        return False
    fixed_x, fixed_y = ({number for number, c in scene.fixed if c == i} for i in range(2))
    links = [(GROUND.number, number) for number in fixed_x & fixed_y]
    links += [(j.a.number, j.b.number) for j in scene.joints if j.is_rigid]
    numbers = np.array([(start.number, start.number), (end.number, end.number), *links]).T + 1
    part = connected_parts(numbers, numbers.max() + 1)
    return bool(part[start.number + 1] == part[end.number + 1])


def member_pairs(
    scene: Scene, mesh: Mesh, X: np.ndarray, mobility: np.ndarray, at_rest: bool
) -> list[MemberPair]:
    """All contact with members, with nodes at X (n, 2).

    By the `mobility` of degrees of freedom, 1 / mass, the friction on nodes has critical damping.
    """
    pairs, first = list[MemberPair](), 0
    for contact in scene.contacts:
        a, b, radii = contact.target, contact.shape, contact.radius
        if not isinstance(b, Beam):
            continue
        assert isinstance(radii, tuple)
        nodes_a, nodes_b = mesh.nodes_of(scene, a), mesh.nodes_of(scene, b)
        slots_a = first + np.arange(len(nodes_a))
        slots_b = slots_a if a is b else np.full(len(nodes_b), -1)
        loss_numbers, friction = numbers_of_loss(contact, at_rest), contact.friction
        kinds = (MEMBER, FOLLOWED)
        if friction is not None:
            kinds = (MEMBER_WITH_FRICTION, FOLLOWED_WITH_FRICTION)
        law, followed = (laws.contact(kind, bool(loss_numbers), contact.energy) for kind in kinds)
        sides = (a, nodes_a, slots_a, contact.points), (b, nodes_b, slots_b, points_of(b))
        twice, share = isinstance(a, Beam) and a is not b, 0.5 if isinstance(a, Beam) else 1.0
        both = list[MemberPair]()
        directions = (sides, sides[::-1])[: 1 + twice]
        for (_, points, point_slots, p), (member, nodes, slots, _) in directions:
            lengths = share * p.lengths
            columns: list[float | np.ndarray] = [contact.radii, contact.stiffness * lengths]
            columns += loss_numbers
            if friction is not None:
                columns.insert(1, radii[len(both)] / contact.radii)
                most_mobile = mobility[mesh.dofs[points, :2]].max(axis=1)
                columns += friction_numbers(friction, lengths, most_mobile)
            numbers = np.column_stack([column + np.zeros(len(lengths)) for column in columns])
            turn = len(nodes) - 1 if isinstance(member, Beam) and _is_closed(scene, member) else 0
            if turn:
                ring = np.arange(-_AROUND, turn + _AROUND) % turn
                nodes, slots = nodes[ring], slots[ring]
            arrays = points, point_slots, nodes, slots, numbers, arc_of(X[nodes])
            apart = contact.apart if a is b else 0.0
            both.append(MemberPair(law, followed, *arrays, apart, None if both else contact, turn))
        pairs += both
        first += len(contact.points.lengths)
    return pairs


class Found(enum.IntEnum):
    """Results of a search: all is fine, points moved or slid too far, or passed."""

    FINE, MOVED, PASSED, SLID = range(4)


class MemberContacts:
    """All contact with members of a scene; its internal variables have a first place among all.

    Its data lie in C, for both kinds of steps.
    """

    def __init__(self, pairs: list[MemberPair], rule: StepRule, mesh: Mesh, first_internal: int):
        self.pairs, self._mesh = pairs, mesh
        #: Number of points whose forces are recorded.
        self.slots = sum(len(pair.points) for pair in pairs if pair.contact)
        self.laws = compiled_laws([pair.law for pair in pairs], rule)
        if named := [law for law in self.laws if law.parameters]:
            raise SceneError(
                f"contact with a member: its energy has the parameter {named[0].parameters[0]!r}. "
                "Write the number in its place"
            )
        #: What derivatives call.
        self.slopes: list[PointFunction] = []
        counts = [SLOTS * len(pair.points) * bool(pair.law.internal) for pair in pairs]
        #: First slot of memory of each; all their internal variables.
        self.first_slots, self.width = np.cumsum([0, *counts]), SLOT_WIDTH * sum(counts)
        self.ffi, self.library = c_library.open_library(*LIBRARY)
        self._doubles = functools.partial(self.ffi.from_buffer, self.ffi.typeof("double[]"))
        self._numbers = [np.array(pair.numbers) for pair in pairs]
        sizes = [(len(pair.points), pair.numbers.size) for pair in pairs]
        firsts = np.cumsum([(0, 0), *sizes], axis=0)
        nodes = np.unique(np.concatenate([[*pair.points, *pair.nodes] for pair in pairs]))
        self._reference, size = _positions(mesh), mesh.dofs.size
        #: The C struct MemberContacts.
        self.c, self._structs = self.ffi.new("MemberContacts *"), Structs(self.ffi)
        self._structs.set(
            self.c,
            contacts=len(pairs),
            conditions=sum(len(pair.points) for pair in pairs),
            of=[self._row(i, *firsts[i]) for i in range(len(pairs))],
            turning=rule.turning,
            dofs=size,
            moving=len(nodes),
            moves=mesh.dofs[nodes, :2],
            reference=self._reference,
            margin=-1.0,
            slots=self.first_slots[-1],
            first_internal=first_internal,
            has_slot=np.zeros(self.first_slots[-1], np.int32),
            memory=np.zeros(self.width),
            contact_point=None,
            near=None,
            **{name: np.zeros(size) for name in ("searched_at", "start", "v", "product")},
        )
        # Freed with this object: C allocates as much as there are contact points.
        self._freed = self.ffi.gc(self.c, self.library.fx_free_members)

    def _row(self, i: int, point: int, number: int) -> dict[str, object]:
        """Members of ``MemberContact`` of a pair: its first point and number among all."""
        pair, law, numbers, mesh = self.pairs[i], self.laws[i], self._numbers[i], self._mesh
        return {
            **law.members,
            "coordinates": law.law.size,
            "dofs": _ENTRIES if law.law.internal else _POSITIONS,
            "first_slot": self.first_slots[i],
            "points": len(pair.points),
            "point_dof": mesh.dofs[pair.points, :2],
            "first_point": point,
            "point_slot": pair.point_slots,
            "nodes": len(pair.nodes),
            "turn": pair.turn,
            "first_node": _AROUND * bool(pair.turn),
            "end_node": len(pair.nodes) - _AROUND * bool(pair.turn),
            "node_dof": mesh.dofs[pair.nodes, :2],
            "node_slot": pair.node_slots,
            "numbers": numbers.shape[1],
            "number": numbers,
            "apart": pair.apart,
            "arc": pair.arc,
            "first_number": number,
        }

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`; C has allocated nothing yet."""
        c, ffi, n = self.c, self.ffi, len(self.pairs)
        assert not (c.near or c.contact_point)
        size, slots = self._mesh.dofs.size, int(self.first_slots[-1])
        arrays = [*self._numbers, self._reference, c_library.array_at(ffi, c.has_slot, slots)]
        arrays.append(c_library.array_at(ffi, c.memory, self.width))
        for name in ("searched_at", "start", "v", "product"):
            arrays.append(c_library.array_at(ffi, getattr(c, name), size))
        rows = ffi.cast(f"MemberContact(*)[{n}]", c.of)[0]
        pairs = zip(rows, self.pairs, strict=True)
        arrays += [c_library.array_at(ffi, row.arc, len(pair.arc)) for row, pair in pairs]
        return [c, rows], arrays

    def in_block(self, block: Any, mesh: Mesh) -> MemberContacts:
        """Contact whose numbers are in the block of a run; `set_numbers` is to follow."""
        other = shallow_copy(self)
        other._mesh, other.c = mesh, block.struct(self.ffi, self.c)
        other._numbers = [*map(block.view, self._numbers)]
        other._reference = block.view(self._reference)
        other._freed = self.ffi.gc(other.c, self.library.fx_free_members)
        return other

    def check_pairs(self, pairs: list[MemberPair]) -> None:
        """OtherStructureError if other members touch."""
        kinds, own_kinds = (
            [(pair.law.kind, pair.numbers.shape, pair.turn) for pair in side]
            for side in (pairs, self.pairs)
        )
        if kinds != own_kinds:
            raise OtherStructureError("other members touch")

    def set_numbers(self, pairs: list[MemberPair]) -> None:
        """Set the numbers of pairs of the same kinds, with the mesh; forget the last run."""
        self.pairs = pairs
        for i, pair in enumerate(pairs):
            self._numbers[i][...] = pair.numbers
            row = self.c.of[i]
            self.ffi.memmove(row.arc, np.ascontiguousarray(pair.arc), pair.arc.nbytes)
            row.apart = pair.apart
        self._reference[...] = _positions(self._mesh)
        self.forget()

    def forget(self) -> None:
        """Search anew in the next step, as in the first one of a run."""
        self.c.margin, self.c.step = -1.0, 0.0

    @property
    def are_near(self) -> bool:
        """Whether points are so near to a member that they may touch it in the last step."""
        return self.c.contact_points > 0

    @property
    def touched(self) -> list[tuple[int, int, int, bool]]:
        """Contacts, points, and pieces or ends that these touch, at the last look at switches.

        There the curvature of a member jumps.
        """
        pieces = list[tuple[int, int, int, bool]]()
        for k in range(self.c.near_places):
            near = self.c.near[k]
            place, last = near.piece + near.place, self.c.of[near.contact].nodes - 1
            pieces.append((near.contact, near.point, round(place), place in (0, last)))
        return pieces

    # -- A step ---------------------------------------------------------------------------------

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Evaluate the forces for the increment D (size,), and add them against the motion."""
        self.library.fx_evaluate_members(self.c, self._doubles(D))
        self.library.fx_add_members(self.c, self._doubles(out))

    def tangent(self) -> scipy.sparse.csr_matrix:
        """Their derivatives (size, size) by the increments."""
        count, size = self.c.contact_points, self._mesh.dofs.size
        closed = [point for point in self.c.contact_point[0:count] if point.closed]
        dofs = np.array([list(point.dof) for point in closed], dtype=int).reshape(-1, _ENTRIES)
        values = np.array([list(point.tangent) for point in closed])
        rows, columns = np.repeat(dofs, _ENTRIES, axis=1), np.tile(dofs, (1, _ENTRIES))
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        return scipy.sparse.csr_matrix(entries, (size, size))

    def check_search(self, D: np.ndarray) -> int:
        """Result at the end of a step D, as `Found`."""
        return int(self.library.fx_check_members(self.c, self._doubles(D)))


def _positions(mesh: Mesh) -> np.ndarray:
    """Positions (size,) of all degrees of freedom in the reference configuration."""
    return np.pad(mesh.X, ((0, 0), (0, 1))).ravel()
