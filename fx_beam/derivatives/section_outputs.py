"""Section forces at places as outputs: their derivatives, by the balance of an element."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from fx_beam.dual import dual_array
from fx_beam.errors import SceneError
from fx_beam.fem.loads import OnBeams
from fx_beam.fem.mass import masses_of_points
from fx_beam.laws.interval import StepBatch, just_inside
from fx_beam.motions.element_balance import ElementLoads, components, directions_at_ends
from fx_beam.results.section_forces import Balance
from fx_beam.scene.beam import BeamPlace
from fx_beam.scene.outputs import Output, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.layout import Arrays
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Block, RowOutput, of_rows
from .local_outputs import Places
from .output_values import OF_PLACES, Wanted
from .sub_steps import SubSteps

#: Numbers of section forces: masses (n, points) at Gauss points of their elements, directions
#: (n, 2) at their ends, and dead loads (sub-steps + 1, n, width) on them, the last at the start.
MASSES, DIRECTIONS, DEAD = "masses of outputs", "directions of outputs", "dead loads of outputs"
# Step of differences of polynomials of the fourth degree, which are exact.
_STEP = 1e-2


def numbers_of_sections(
    model: Model, tape: Tape, rest_time: float | None, scene: Scene, known: Mapping[str, Wanted]
) -> dict[str, Any]:
    """Numbers of a scene in the sub-steps of a tape; equilibria have their loads at one time."""
    mesh, level, times = model.mesh, model.scheme.rates.level, tape.times
    X = mesh.positions_of(scene)
    on = OnBeams(tuple(scene.beams), tuple(scene.loads), scene.gravity, scene.array_calls)
    loads = ElementLoads(model, on, X)
    start, last = times.starts[:1], np.zeros(1)

    def in_steps(function: Callable[[np.ndarray], Any]) -> Any:
        if rest_time is not None:
            factors = np.append(tape.memories, last)
            return factors[:, None] * function(np.array([rest_time]))
        t0, t1 = just_inside(times.starts, times.ends)
        t0, t1 = np.append(t0, start), np.append(t1, start)
        return (1 - level) * function(t0) + level * function(t1)

    cells = []
    outputs: list[Any] = [*filter(is_section_force, known.values())]
    for output in outputs:
        cells.append(cell := _cell(model, output))
        if any(_cell(model, load.target) == cell for load in loads.inside(output.of.beam.name)):
            raise SceneError(
                f"the output {output} has no derivatives: a force or couple acts inside its "
                "element. Let an element end there"
            )
    dead = [_on_element(loads, cell, in_steps) for cell in cells]
    directions = directions_at_ends(X[mesh.elements[cells]])
    return {
        MASSES: dual_array(loads.masses)[cells],
        DIRECTIONS: directions,
        DEAD: np.stack(dead, axis=1),
    }


def _cell(model: Model, place: Any) -> int:
    """Number of the element of a place or of an output there."""
    place = place.of if isinstance(place, Output) else place
    names = [beam.name for beam in model.scene.beams]
    return int(model.mesh.cells[names.index(place.beam.name)][place.element[0]])


def _on_element(loads: ElementLoads, cell: int, in_steps: Callable) -> Any:
    """Dead loads (sub-steps + 1, width) on an element."""
    dofs, dead = loads.torn.unknowns.dofs[cell], loads.dead
    width, columns = len(dofs), len(dead.starts) - 1
    place = np.full(loads.torn.dofs.size, -1)
    place[dofs] = np.arange(width)
    there = np.flatnonzero(place[dead.rows] >= 0)
    column = np.repeat(np.arange(columns), np.diff(dead.starts))[there]
    at = column * width + place[dead.rows[there]]
    unit = np.bincount(at, dead.entries[there], columns * width).reshape(columns, width)
    total = in_steps(lambda t: dead.series(t) @ unit)
    if loads.weight is not None:
        total = total + in_steps(lambda t: np.ones((len(t), 1))) * loads.weight[dofs]
    return total


def _shares(component: int, degree: int, x: float, h: float) -> np.ndarray:
    """Shares (6 + degree,) of N, Q, M at both ends of an element, and of values at Gauss points."""
    units = np.eye(6 + degree)
    gauss = np.zeros((len(units), degree, 3))
    gauss[..., component] = units[:, 6:]
    ends, none = units[:, :6].reshape(-1, 1, 2, 3), np.empty((len(units), 0, 3))
    balance = Balance(np.array([0.0, h]), ends, np.empty(0), none)
    return balance.in_elements(gauss, np.array([x]))[component].ravel()


class SectionOutput(RowOutput):
    """N, Q or M at a place at the rows (n,) of a run; `numbers` and their rows are known."""

    def __init__(self, of: SubSteps, output: Output, places: Places, numbers: Arrays, rows: tuple):
        model, place = of.model, output.of
        assert isinstance(place, BeamPlace)
        self._of, self._places, (self._of_place, self._row) = of, places, rows
        self._beams: Any = model.forms.beams  # there are some
        self._cell, self._component = _cell(model, output), "NQM".index(output.quantity)
        self._dofs = model.mesh.unknowns.dofs[self._cell]
        ends = model.mesh.dofs[model.mesh.elements[self._cell, [0, -1]]]
        # Places of the forces at both ends in those of the element, and of rotations in q.
        self._at = np.argsort(self._dofs)[np.searchsorted(np.sort(self._dofs), ends)]
        self._turns = ends[:, 2]
        steps, start = places.steps, places.at_start
        #: Rows, numbers and shares of the sub-steps, and their dead loads among all.
        self._rows = np.append(steps.of, start)
        self._steps = np.append(steps.sub_steps, -np.ones(len(start), dtype=int))
        self._weights = np.append(steps.shares, np.ones(len(start)))
        self._read(numbers)

    def _read(self, numbers: Arrays) -> None:
        """Find the forces of the element, and how the output follows from what it depends on."""
        of, places, count = self._of, self._places, len(self._places.ends)
        degree, width = self._beams.kind.degree, len(self._dofs)
        masses, dead = numbers[MASSES][self._row], numbers[DEAD][:, self._row]
        self._unit_masses = masses_of_points(degree)
        forces, turns, gauss = (np.zeros((count, n)) for n in (width, 2, degree))
        for group, parts in self._batches(np.arange(len(self._steps))):
            rows, share = self._rows[group], self._weights[group, None]
            at = self._beams.forces_of_cells(parts)[:, self._cell] - dead[self._steps[group]]
            np.add.at(forces, rows, share * at)
            level = parts.q + of.model.scheme.rates.level * parts.D
            np.add.at(turns, rows, share * level[:, self._turns])
            points = self._beams.resultants(parts)[:, self._cell, :, self._component]
            np.add.at(gauss, rows, share * points)
        #: Accelerations (n, width) of the element, and the name of their rates.
        self._rates = "rates" if of.model.fits_rates else "v"
        self._a = np.zeros((count, width))
        if not of.model.scheme.rates.at_rest:
            v, moved = of.states[self._rates][:, self._dofs], places.moved
            change = v[places.ends[moved]] - v[places.starts[moved]]
            self._a[moved] = change / places.steps.lengths[moved, None]
            if len(places.at_start):
                self._a[places.at_start] = numbers["a"][self._dofs]
            self._mass = np.tensordot(masses, self._unit_masses, 1)
            forces += self._a @ self._mass
        signs, angles = np.array([[-1.0], [1.0]]), numbers[DIRECTIONS][self._row] + turns
        ends = components(signs * forces[:, self._at], angles)
        (x, h), values = numbers[OF_PLACES][self._of_place], np.hstack([ends.reshape(-1, 6), gauss])

        def slope(by: np.ndarray) -> np.ndarray:
            """Along a change of x and h: shares are polynomials of the fourth degree at most."""
            shares = [_shares(self._component, degree, *((x, h) + k * by)) for k in (-2, -1, 1, 2)]
            return values @ np.array(shares).T @ np.array([1.0, -8.0, 8.0, -1.0]) / 12

        shares = _shares(self._component, degree, x, h)
        #: Derivatives by the part x of the element and its length.
        steps = np.diag([_STEP, _STEP * h])
        self._by_place = np.stack([slope(step) for step in steps], axis=1) / np.diag(steps)
        of_ends, self._gauss = shares[:6].reshape(2, 3), shares[6:]
        #: By the angles (n, 2), and by the forces (n, width) of the element.
        self._by_angles = of_ends[:, 0] * ends[..., 1] - of_ends[:, 1] * ends[..., 0]
        c, s, (N, Q, M) = np.cos(angles), np.sin(angles), of_ends.T
        by_ends = np.stack([c * N - s * Q, s * N + c * Q, np.broadcast_to(M, c.shape)], axis=-1)
        self._by_forces = np.zeros((count, width))
        self._by_forces[:, self._at] = signs * by_ends

    def _batches(self, which: np.ndarray) -> Iterator[tuple[np.ndarray, StepBatch]]:
        """Sub-steps, some of all, in groups."""
        for group in self._of.groups(which):
            at, tape = which[group], self._of.tape
            parts = self._of.parts(self._steps[at])
            if self._of.model.scheme.rates.at_rest:
                parts = parts._replace(load_factor=tape.memories[self._steps[at]])
            yield at, parts

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """Its derivatives in some of the rows."""
        wanted = np.isin(self._rows, rows)
        for at, parts in self._batches(np.flatnonzero(wanted)):
            yield from self._of_steps(at, parts)
        yield from self._inertia()
        every = np.arange(len(self._a))
        yield of_rows(OF_PLACES, every, self._by_place, first=2 * self._of_place)
        yield of_rows(DIRECTIONS, every, self._by_angles, first=2 * self._row)

    def _of_steps(self, at: np.ndarray, parts: StepBatch) -> Iterator[Block]:
        """By what forms read of some sub-steps, and by dead loads in them."""
        of, steps, rows, shares = self._of, self._steps[at], self._rows[at], self._weights[at, None]
        model, weights = of.model, shares * self._by_forces[rows]
        by = self._beams.slopes.of_forces(parts, of.by_places, weights, self._cell)
        if self._gauss.any():
            of_points = np.zeros((len(at), *model.forms.internal_shape[:2]))
            of_points[:, self._cell] = shares * self._gauss
            more = self._beams.slopes.of_resultants(parts, of.by_places, of_points, self._component)
            by = {name: by.get(name, 0.0) + more.get(name, 0.0) for name in by.keys() | more.keys()}
        for name, factor in (("increment", model.scheme.rates.level), ("start", 1.0)):
            turned = by.setdefault(name, np.zeros((len(at), model.size)))
            turned[:, self._turns] += factor * shares * self._by_angles[rows]
        yield from of.in_steps(rows, steps, by)
        width, loads = len(self._dofs), np.where(steps < 0, len(of.tape), steps)
        yield of_rows(DEAD, rows, -weights, loads, first=width * self._row)

    def _inertia(self) -> Iterator[Block]:
        """By rates, accelerations at the start, and masses."""
        if self._of.model.scheme.rates.at_rest:
            return
        places, moved, every = self._places, self._places.moved, np.arange(len(self._a))
        masses = np.einsum("nw,pwv->npv", self._by_forces, self._unit_masses)
        points = masses.shape[1]
        by_masses = np.einsum("npv,nv->np", masses, self._a)
        yield of_rows(MASSES, every, by_masses, first=points * self._row)
        by_a = self._by_forces @ self._mass
        per_time = by_a[moved] / places.steps.lengths[moved, None]
        for at, sign in ((places.ends, 1.0), (places.starts, -1.0)):
            yield Block(self._rates, self._dofs, moved, sign * per_time, at[moved])
        if len(places.at_start):
            yield Block("a", self._dofs, places.at_start, by_a[places.at_start])
