"""What is read of forces at points after steps: energies, derivatives, friction that sticks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.laws.interval import StepBatch
from fx_beam.laws.point_laws import StepRule, arguments

from .compiled_laws import derivative_of, laws_of_forces
from .member_contacts import SLOT_WIDTH, SLOTS, MemberPair
from .point_forces import CompiledPoints, PlacedForce, PointForces, Role

if TYPE_CHECKING:
    from .member_contacts import MemberContacts


# -- Values of functions of forces at points, such as energies, in many steps, and derivatives --


#: Forces at an instant, from places and rates at the start of a step.
AN_INSTANT = StepRule(0.0, turning=False, at_rest=False, instant=True)


class PointSlopes(NamedTuple):
    """Derivatives (k, e) of a value by entries (e,) of the array `name` that the force reads."""

    name: str
    entries: np.ndarray
    slopes: np.ndarray


class PointValues:
    """The sum of a function of all forces at points, or of those along a line.

    The function is that of a law: "energy" or "loss", of lines also "pull". It is that in steps of
    the scheme, or by a `rule` of its own. Members that touch are left out.
    """

    def __init__(
        self,
        points: PointForces,
        quantity: str,
        line: int | None = None,
        rule: StepRule | None = None,
    ):
        self._quantity = quantity
        chosen = [x for x in points.placed if line is None or x.force.line == line]
        forces = [x for x in chosen if getattr(x.law.law, quantity) is not None]
        if rule is not None and forces:
            laws = laws_of_forces([placed.law.law for placed in forces], rule)
            places = [np.array(points.parameters.indices(law.parameters), int) for law in laws]
            triples = zip(forces, laws, places, strict=True)
            forces = [placed._replace(law=law, parameters=x) for placed, law, x in triples]
        # Forces of one law, which are evaluated together.
        self._groups: dict[tuple[int, bool, bool], list[PlacedForce]] = {}
        for placed in forces:
            key = id(placed.law), placed.force.slide >= 0, placed.force.role == Role.EXTERNAL
            self._groups.setdefault(key, []).append(placed)
        numbers = sum(len(placed.numbers) for placed in points.placed)
        # Lengths of arrays besides those of the state.
        self._sizes = {"points": numbers, "parameters": len(points.parameters)}

    def values(self, steps: StepBatch) -> np.ndarray:
        """The values (k,)."""
        total = np.zeros(len(steps.t))
        for forces in self._groups.values():
            inputs = _law_inputs(forces, steps)
            values = forces[0].law.values(self._quantity, inputs.reshape(-1, inputs.shape[-1]))
            total += values[:, 0].reshape(inputs.shape[:2]).sum(axis=1)
        return total

    def slopes(self, steps: StepBatch) -> Iterator[PointSlopes]:
        """Derivatives of the values that are not zero.

        By "q", "increment" and "v", or "slides", "slide increment" and "slide rate", by "spring
        internal", "points" (numbers) and "parameters".
        """
        for forces in self._groups.values():
            inputs, first = _law_inputs(forces, steps), forces[0]
            law, rows = first.law.law, inputs.reshape(-1, inputs.shape[-1])
            slopes = first.law.slopes(self._quantity, rows).reshape(inputs.shape)
            names = ("q", "increment", "v")
            if first.force.slide >= 0:
                names = ("slides", "slide increment", "slide rate")
            n, last, dofs = law.size, arguments(law), _dofs(forces).ravel()
            entries, place = np.unique(dofs, return_inverse=True)
            ones, coordinates = np.ones(len(dofs)), np.arange(len(dofs))
            places = scipy.sparse.csr_matrix((ones, (place, coordinates)))  # a node may be twice
            moving, count = entries >= 0, len(inputs)
            for i, name in enumerate(names):
                dof_slopes = places @ slopes[..., i * n : (i + 1) * n].reshape(count, -1).T
                yield from _nonzero(name, entries[moving], dof_slopes[moving].T)
            ends = np.cumsum([3 * n + 2, law.internal])
            variables = np.concatenate([placed.variables for placed in forces])
            yield from _nonzero("spring internal", variables, slopes[..., slice(*ends)])
            numbers = [placed.first_number + np.arange(law.numbers) for placed in forces]
            number_slopes = slopes[..., last - law.numbers : last]
            yield from _nonzero("points", np.concatenate(numbers), number_slopes)
            parameter_slopes = slopes[..., last:].sum(axis=1)
            yield from _nonzero("parameters", first.parameters, parameter_slopes)

    def summed_slopes(self, steps: StepBatch) -> dict[str, np.ndarray]:
        """Derivatives (k, n) of the values by name; arrays by which all are zero are left out."""
        arrays = dict.fromkeys(("slides", "slide increment", "slide rate"), steps.slides)
        arrays["spring internal"] = steps.spring_internal
        sums: dict[str, np.ndarray] = {}
        for name, entries, slopes in self.slopes(steps):
            if name not in sums:
                size = self._sizes.get(name) or arrays.get(name, steps.q).shape[1]
                sums[name] = np.zeros((len(slopes), size))
            sums[name][:, entries] += slopes
        return sums


def _nonzero(name: str, entries: np.ndarray, slopes: np.ndarray) -> Iterator[PointSlopes]:
    """Derivatives (k, ...) by entries (e,), if any is not zero."""
    if slopes.any():
        yield PointSlopes(name, entries, slopes.reshape(len(slopes), -1))


def _dofs(forces: Sequence[PlacedForce]) -> np.ndarray:
    """Degrees of freedom (m, n) of m forces of one law, or the joints of their slides."""
    return np.array([x.force.dofs if x.force.slide < 0 else [x.force.slide] for x in forces])


def _law_inputs(forces: Sequence[PlacedForce], steps: StepBatch) -> np.ndarray:
    """Inputs (k, m, n) of the law of m forces; zeros of an iteration before, and at rest."""
    first, count, dofs = forces[0], len(steps.t), _dofs(forces)
    numbers = np.tile(np.stack([placed.numbers for placed in forces]), (count, 1, 1))
    if first.force.role == Role.EXTERNAL and steps.load_factor.size:
        numbers[..., -1] = steps.load_factor[:, None]
    motion = steps.q, steps.D, steps.v
    if first.force.slide >= 0:
        motion = steps.slides, steps.slide_increments, np.empty(0)

    def entries(rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Entries (k, m, n) of rows (k, ...) at places (m, n) or (1, n)."""
        shape = count, len(forces), places.shape[-1]
        return np.broadcast_to(rows[:, places], shape) if places.size else np.zeros(shape)

    still = np.zeros((count, *dofs.shape))
    coordinates = [
        np.where(dofs < 0, 0.0, entries(rows, dofs)) if rows.size else still for rows in motion
    ]
    times = entries(np.column_stack([steps.t, steps.dt]), np.array([[0, 1]]))
    internal = entries(steps.spring_internal, np.stack([placed.variables for placed in forces]))
    memory = np.zeros((count, len(forces), first.law.law.iteration_memory))
    parameters = entries(steps.parameters, first.parameters[None])
    parts = [*coordinates, times, internal, memory, numbers, parameters]
    return np.concatenate(parts, axis=-1)


def slopes_by_load_factor(points: PointForces) -> np.ndarray:
    """Derivatives (numbers,) of the numbers of all forces by the load factor."""
    slopes = np.zeros(sum(len(placed.numbers) for placed in points.placed))
    for placed in points.placed[points.external]:
        slopes[placed.first_number + len(placed.numbers) - 1] = 1.0
    return slopes


# -- Contact of nodes with members -----------------------------------------------------------------


def energy_slopes_of_members(
    members: MemberContacts, q: np.ndarray, internal: np.ndarray
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of stored energies: by "q", "spring internal", "members", "X".

    `internal` (k, n) has all variables at points.
    """
    numbers, ffi = sum(pair.numbers.size for pair in members.pairs), members.ffi
    sums = [np.zeros(q.shape), np.zeros(internal.shape), np.zeros((len(q), numbers))]
    addresses = [
        0 if law.law.energy is None else law.derivative("energy").address for law in members.laws
    ]
    functions = ffi.new("Law *[]", [ffi.cast("Law *", address) for address in addresses])

    def pointer(row: np.ndarray):
        return ffi.from_buffer("double[]", row)

    for state, *rows in zip(zip(q, internal, strict=True), *sums, strict=True):
        energy = ffi.new("Energy *", [functions, 0.0, *map(pointer, rows)])
        members.library.fx_stored_at_members(members.c, energy, *map(pointer, state))
    X = sums[0].reshape(len(q), -1, 3)[..., :2]
    return {**dict(zip(("q", "spring internal", "members"), sums, strict=True)), "X": X}


def hand_over_slopes(members: MemberContacts, rule: StepRule) -> dict[str, int]:
    """Hand over what derivatives of forces need besides.

    Returns how many numbers all points have, by the name in c/problem.h.
    """
    members.slopes = [derivative_of(pair.followed, rule, "forces") for pair in members.pairs]
    for i, function in enumerate(members.slopes):
        members.c.of[i].slopes = members.ffi.cast("Law *", function.address)
    return {"member_numbers": sum(pair.numbers.size for pair in members.pairs)}


# -- Friction of forces at points that sticks: its springs, and where it acts -------------------


class Bristle(NamedTuple):
    """The spring of friction that sticks."""

    #: Place of its stretch among all internal variables of forces at points; then comes the slip,
    #: and in a joint, if it follows its force, this force.
    place: int
    mu: float
    follows: bool


def bristles_of(points: PointForces) -> list[Bristle]:
    """The springs of all friction that sticks."""
    bristles = [
        Bristle(first, float(numbers[-2]), force.load.joint >= 0)
        for force, _, _, numbers, _, _, first, *_ in points.placed
        if force.law.has_stick_state
    ]
    for pair, slots in _slots_of_members(points):
        for k, first in enumerate(slots.tolist()):
            bristles.append(Bristle(first + 1, float(pair.numbers[k // SLOTS, -2]), False))
    return bristles


def friction_of_members(points: PointForces, internal: np.ndarray) -> dict[int, np.ndarray]:
    """Stretch and slip (n, points, 2) of the first members, by the contact's number.

    From all internal variables (n, width). Of a node that touches two points: where its spring is
    stretched further.
    """
    frictions = {}
    for pair, slots in _slots_of_members(points):
        if pair.contact is not None:
            memory = internal[:, slots[:, None] + np.arange(SLOT_WIDTH)]
            memory = memory.reshape(len(internal), len(pair.points), SLOTS, SLOT_WIDTH)
            most = abs(memory[..., 1]).argmax(axis=-1)
            farthest = np.take_along_axis(memory, most[..., None, None], axis=2)
            frictions[pair.contact.number] = farthest[:, :, 0, 1:]
    return frictions


def _slots_of_members(points: PointForces) -> Iterator[tuple[MemberPair, np.ndarray]]:
    """Members that touch with friction, and where slots of all points are among all variables."""
    if (members := points.members) is None:
        return
    first_variable = points.width - members.width
    for pair, first in zip(members.pairs, members.first_slots[:-1].tolist(), strict=True):
        if pair.law.internal:
            yield pair, first_variable + SLOT_WIDTH * (first + np.arange(SLOTS * len(pair.points)))


def friction_sticks(compiled_points: CompiledPoints, q: np.ndarray, slides: np.ndarray) -> bool:
    """Whether friction acts that sticks: of a joint, or of a contact that is closed."""
    ends = np.cumsum(compiled_points.points.switch_counts, dtype=int)
    pairs = zip(
        compiled_points.points.laws,
        np.split(compiled_points.switches(q, slides) <= 0, ends),
        strict=False,
    )
    return any(
        law.has_stick_state and (not law.unilateral or closed.any()) for law, closed in pairs
    )
