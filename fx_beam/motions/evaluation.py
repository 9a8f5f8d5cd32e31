"""Builds a solution from a record, at chosen times, or as files for ParaView."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Rest
from fx_beam.results.export import replacing, replacing_all, writable
from fx_beam.results.member_fields import RESULTANTS, Grid, at_ends, write_collection
from fx_beam.results.records import BeamResultants, Energy, Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import HISTORIES, State
from fx_beam.scene.beam import Beam, arc_lengths, gauss_rule, lagrange_and_slopes
from fx_beam.scene.joints import constraints_of
from fx_beam.scene.loads import NAMES
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import RecordedHistories, RowSteps, histories_of, slides_near
from fx_beam.step.recorder import Recorder

from .motion_setup import MotionSetup

if TYPE_CHECKING:
    from fx_beam.results.records import BeamBalance

    from .element_balance import ElementBalance


# -- Builds a solution from a record, also one at chosen times between the ends of the steps ----


def solution_of(
    recorder: Recorder,
    stats: Stats,
    end: Callable[[], State],
    times: np.ndarray | None = None,
    breaks: Sequence[float] = (),
    ended: bool = False,
    scene_stays: bool = False,
    stability: Mapping[str, object] | None = None,
    stored: Any = None,
    rest: Rest | None = None,
) -> Solution:
    """Solution from a record, or from what is `stored` of it; `end` gives the last state.

    With `times` its rows are at these times, otherwise those of the record; the motion is smooth
    between `breaks`. What cannot change any more is made when it is first read: the record does not
    if the run has `ended`, and the scene does not if it `scene_stays` as it is until then.
    """
    model, scene, mesh = recorder.model, recorder.model.scene, recorder.model.mesh
    later = ended and (scene_stays or not model.fits_rates)
    recorded = histories_of(recorder) if stored is None else stored
    histories: Mapping[str, Any] = recorded
    rows: slice | np.ndarray = slice(recorder.rows)  # a `Motion` may add more
    if times is not None:
        if stats.until:  # its end is a row as well
            times = np.append(times[times < recorded["t"][-1]], recorded["t"][-1])
        histories, rows = at_times(model, recorded, times, breaks)
    elif not ended:
        histories = dict(recorded)
    elif not later:
        recorded.fit()
    data = model.data
    spring_rows = histories["spring_internal"] if model.points.width else None
    beams = zip(scene.beams, mesh.cells, strict=True)
    named_beams = {beam.name: (beam, cells) for beam, cells in beams}
    numbers = {name: number for number, name in enumerate(named_beams)}

    means: list[np.ndarray] = []

    def resultants() -> np.ndarray:
        if not means:
            beams = model.forms.beams
            assert beams is not None
            check_rates(recorder)
            with model.lock:
                steps = RowSteps(recorder)
                means.append(steps.means(beams.resultants(steps.batch()))[rows])
        return means[0]

    def resultants_of_beam(name: str) -> BeamResultants:
        beam, cells = named_beams[name]
        values = resultants()[:, cells]
        s = arc_lengths(beam, gauss_rule(beam.degree)[0])
        N, Q, M = np.moveaxis(values.reshape(len(values), -1, 3), -1, 0)
        return BeamResultants(s.ravel(), N, Q, M, lambda: balance_of(name))

    balances: list[ElementBalance] = []

    def balance() -> ElementBalance:
        if balances:
            return balances[0]
        from .element_balance import ElementBalance

        with model.lock:
            if len(a := histories_of(recorder)["a"]) < recorder.rows:
                raise ValueError(
                    "section forces from the balance of elements need accelerations, which were "
                    "not recorded; simulate with record=Record(rates=True)"
                )
            accelerations = a.reshape(len(a), -1).copy()
            balances.append(ElementBalance(recorder, data.loaded_beams, accelerations, rest))
        return balances[0]

    def balance_of(name: str) -> BeamBalance:
        return balance().of_beam(numbers[name], rows)

    constraints = None if scene_stays else constraints_of(scene)

    def last() -> State:
        state = end()
        with model.lock:
            state = state.changed(
                impact=recorder.first.impact,
                **recorded.at_end(state.t),
                constraints=constraints_of(scene) if constraints is None else constraints,
                owners=model.points.owners,
            )
        return state.reshaped(-1, 3)

    solution = Solution(
        histories,
        X=mesh.X,
        energy=None,
        stats=stats,
        beams={beam.name: beam for beam in scene.beams},
        nodes_of_beam={b.name: n for b, n in zip(scene.beams, mesh.nodes, strict=True)},
        resultants_of_beam=resultants_of_beam,
        variables_of_beam=_variables_of_beam(model, histories),
        variables_of_joint={} if spring_rows is None else _variables_of_joint(model, spring_rows),
        bodies={body.name: body for body in scene.bodies},
        contacts=list(data.parts.contacts),
        end=last if later else last(),
        names_of_parameters=model.forms.parameters.names,
        variables_of_contact={}
        if spring_rows is None
        else _variables_of_contact(model, spring_rows),
        turns_of_line={} if spring_rows is None else _turns_of_line(model, spring_rows),
        stability=stability,
    )
    solution.has_own_energy = model.scheme.has_own_energy
    solution.parts = ((0, data.parts),)
    return solution


def check_rates(recorder: Recorder) -> None:
    """ValueError if stress resultants depend on rates that are not recorded."""
    model, beams = recorder.model, recorder.model.forms.beams
    if beams is not None and beams.facts.resultants_need_rates and "v" not in recorder.arrays:
        raise ValueError(
            f"the stress resultants of {model.scheme.name} depend on rates: rates not "
            "recorded; simulate with record=Record(rates=True)"
        )


def variables_along(model: Model) -> Iterator[tuple[Beam, np.ndarray, str, str, int]]:
    """Internal variables and natural strains: beam, its cells, name, history, and column there."""
    strained = {strain.beam.name for strain in model.scene.natural_strains}
    for beam, cells in zip(model.scene.beams, model.mesh.cells, strict=True):
        internal = beam.section.internal
        for i, name in enumerate(() if internal is None else internal.names):
            yield beam, cells, name, "internal", i
        for i, name in enumerate(NAMES.values() if beam.name in strained else ()):
            yield beam, cells, name, "natural", i


def _variables_of_beam(
    model: Model, histories: Mapping[str, Any]
) -> dict[str, dict[str, np.ndarray]]:
    """Internal variables and natural strains (n, points) by beam and name, from all cells'."""
    beam_rows: dict[str, dict[str, np.ndarray]] = {}
    for beam, cells, name, history, column in variables_along(model):
        if (rows := histories[history]) is not None:
            beam_values = rows[:, cells][..., column].reshape(len(rows), -1)
            beam_rows.setdefault(beam.name, {})[name] = beam_values
    return beam_rows


def _variables_of_joint(model: Model, rows: np.ndarray) -> dict[int, dict[str, np.ndarray]]:
    """Internal variables (n,) of springs by the joint's number and name, from those of all."""
    columns = iter(rows.T)
    joints = [joint for joint in model.scene.joints if joint.internal]
    return {joint.number: {name: next(columns) for name in joint.internal} for joint in joints}


def _variables_of_contact(model: Model, rows: np.ndarray) -> dict[int, np.ndarray]:
    """Stretch and slip (n, points, 2) by the number of a contact."""
    variables, first = dict[int, np.ndarray](), model.points.first_of_contacts
    for obstacle in model.scene.contacts:
        point_rows = rows[:, first : first + obstacle.variables]
        if obstacle.variables:
            variables[obstacle.number] = point_rows.reshape(len(rows), -1, 2)
        first += obstacle.variables
    if model.points.members is not None:
        from fx_beam.fem.point_values import friction_of_members

        variables |= friction_of_members(model.points, rows)
    return variables


def _turns_of_line(model: Model, rows: np.ndarray) -> dict[int, np.ndarray]:
    """Half turns (n, spans) of the spans of ropes over pulleys [rad], by the number of the rope."""
    counting = (placed for placed in model.points.placed if placed.law.law.counters)
    return {placed.force.line: rows[:, placed.counters] for placed in counting}


# Displacements and rotations at chosen times are those of polynomials through the nearest ends of
# steps, of one degree more than the scheme's order, on the side of a contact where the motion is
# smooth. The rates are their derivatives: those at the ends of steps contain vibrations that the
# steps do not resolve. Only next to breaks, where few steps may turn the motion, are these better.

# Ratio of divided differences from which on the row of the larger one is avoided.
_MUCH = 4.0
# Sums (n, ...) of rows (n, k, ...) with weights (n, k).
_WEIGHTED = "nk,nk...->n..."
# Difference of two times that are the same but for round-off, relative to a mean step.
_SAME = 1e-9


def at_times(
    model: Model, steps: Mapping[str, Any], times: np.ndarray, breaks: Sequence[float]
) -> tuple[dict, np.ndarray]:
    """Histories at times (n,) from those of all steps, and the steps' rows (n,) that contain them.

    Polynomials do not reach over a break. Energies and momenta are linear, so that balances stay
    exact, and so are internal variables and natural strains. Forces and accelerations are those of
    the step.
    """
    t = steps["t"]
    round_off = _SAME * np.ptp(t) / len(t)
    row_times = t[np.minimum(np.searchsorted(t, times - round_off), len(t) - 1)]
    times = np.where(abs(times - row_times) <= round_off, row_times, times)
    times = times[(times >= t[0]) & (times <= t[-1])]
    row = np.minimum(np.searchsorted(t, times), len(t) - 1)
    row[times > t[0]] = np.maximum(row[times > t[0]], 1)
    previous = np.maximum(row - 1, 0)
    x = (times - t[previous]) / np.where(row > previous, t[row] - t[previous], 1.0)
    histories = dict(steps)
    points = 4 if len(model.scheme.fractions) == 1 else 6
    unit = model.units.nodes.reshape(-1, 3)
    q, v = _polynomials(t, steps["q"], steps["v"], unit, times, row, breaks, points)
    histories |= {"t": times, "q": q, "v": v if len(steps["v"]) else steps["v"]}

    def linear(values):
        weight = x.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - weight) * values[previous] + weight * values[row]

    for name, history in HISTORIES.items():
        if history.between and len(steps[name]):
            values = steps[name]
            histories[name] = linear(values) if history.between == "linear" else values[row]
    for name in ("internal", "spring_internal", "natural"):
        if steps[name] is not None:
            histories[name] = linear(steps[name])
    histories["energy"] = Energy(*(linear(part) for part in vars(steps["energy"]).values()))
    histories["slides"] = slides_near(model, q, histories["slides"])
    return histories, row


def _polynomials(t, q, v, unit, times, row, breaks, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives at some times, which lie in the steps that end in some rows."""
    margin = 1e-9 * (t[-1] - t[0])
    inner = [b for b in breaks if t[0] + margin < b < t[-1] - margin]
    edges = np.unique([0, *np.searchsorted(t, np.array(inner) - margin), len(t) - 1])
    values, rates = (np.empty((len(times), *q.shape[1:])) for _ in range(2))
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        piece = np.flatnonzero((row > first) & (row <= last) | (row == first) & (first == 0))
        known = min(points, last - first + 1)
        smooth = slice(first, last + 1)
        ends = np.maximum(row[piece], first + 1) - first
        start = first + _smoothest(t[smooth], q[smooth] / unit, ends, known)
        rows = start[:, None] + np.arange(known)
        q_near = q[rows]
        weights = lagrange_and_slopes(t[rows], times[piece])
        values[piece], rates[piece] = (np.einsum(_WEIGHTED, w, q_near) for w in weights)
        if len(v) and last - first < len(t) - 1 and points > 4:  # between events, long steps
            both_ends = first + ends + np.array([[-1], [0]])
            slopes = (lagrange_and_slopes(t[rows], end)[1] for end in t[both_ends])
            missing = v[both_ends] - [np.einsum(_WEIGHTED, slope, q_near) for slope in slopes]
            value, rate = _bend(t[both_ends], times[piece], missing)
            values[piece] += value
            rates[piece] += rate
    if len(edges) == 1:
        values[:], rates[:] = q[0], 0.0
    return values, rates


def _bend(ends, times, rates) -> tuple[np.ndarray, np.ndarray]:
    """Cubics at times (n,) with rates (2, n, ...) and no values at ends (2, n), and their rates."""
    shape, length = (-1, *[1] * (rates.ndim - 2)), ends[1] - ends[0]
    x, length = (a.reshape(shape) for a in ((times - ends[0]) / length, length))
    value = length * x * (1 - x) * ((1 - x) * rates[0] - x * rates[1])
    return value, (1 - x) * (1 - 3 * x) * rates[0] + x * (3 * x - 2) * rates[1]


def _smoothest(t, q, ends: np.ndarray, known: int) -> np.ndarray:
    """First ones (n,) of so many rows about the steps that end in some rows.

    Beginning with those of the step, a row is added on one side or the other: in turns, unless the
    divided difference with it is much larger. So polynomials do not reach over a contact, or
    whatever else changes the accelerations at once (Harten and others 1987, doi
    10.1016/0021-9991(87)90031-3).
    """
    start, last = ends - 1, len(t) - 1
    differences = q
    for number in range(1, known):
        ages = (t[number:] - t[:-number]).reshape(-1, *[1] * (q.ndim - 1))
        differences = (differences[1:] - differences[:-1]) / ages
        if number == 1:
            continue
        sizes = abs(differences).max(axis=tuple(range(1, q.ndim)), initial=0.0)
        sizes = np.concatenate([[np.inf], sizes, [np.inf]])
        left_sizes, right_sizes = sizes[start], sizes[start + 1]
        left = 2 * (ends - start) <= number
        start = start - np.where(
            left, left_sizes <= _MUCH * right_sizes, _MUCH * left_sizes < right_sizes
        )
    return np.clip(start, 0, last + 1 - known)


# -- Rows of a motion that go to files for ParaView as they come, in place of memory ------------


# Which part of the time the solution so far may take to be saved.
_SHARE = 0.05


class _Written(NamedTuple):
    """Rows in files, which a single assignment replaces."""

    times: list[float] = []
    names: list[str] = []
    #: Blocks of the histories that stay in memory.
    small: list[dict[str, np.ndarray]] = []
    #: Rates that fit the joints at the last row, if those of steps do not.
    fitted: np.ndarray | None = None


class RowFiles:
    """Takes rows from a recorder and writes them; what a solution has besides stays in memory."""

    def __init__(self, prepared: MotionSetup, recorder: Recorder, file: Path | str):
        self._model, self._recorder = prepared.model, recorder
        if not self._model.scene.beams:
            raise SceneError("Record: a file for ParaView needs beams, and the scene has none")
        check_rates(recorder)
        self._path = writable(file, ("pvd",)).resolve()
        self._folder = self._path.with_suffix("")
        self._folder.mkdir(exist_ok=True)
        mesh = self._model.mesh
        self._grid = Grid(mesh.X, mesh.elements, mesh.beam_of_cell)
        self._written = _Written()
        self._saved, self._took = time.monotonic(), 0.0
        #: Whether a file could not be written.
        self._broken = False

    # -- Writing ------------------------------------------------------------------------------

    def write_rows(self) -> None:
        """Write the rows that the recorder has, which forgets them."""
        recorder, written = self._recorder, self._written
        new = len(written.times) - recorder.gone  # the recorder has the last two rows still
        if new >= recorder.rows or self._broken:
            return
        histories = histories_of(recorder)
        times = histories["t"][new:].tolist()
        try:
            names = self._write(histories, new)
            with replacing(self._path, durable=False) as file:
                times, names = written.times + times, written.names + names
                write_collection(file, times, names)
        except OSError:
            self._broken = True
            raise
        small = histories.small_rows(new) | {"t_level": histories["t_level"][new:]}
        fitted = histories.at_end(times[-1]).get("fitted")
        self._written = _Written(times, names, [*written.small, small], fitted)
        recorder.forget()

    def save(self, last: Callable[[RecordedHistories], Solution], always: bool = False) -> None:
        """Save the solution by a function of the last row, if this does not take too much time."""
        start = time.monotonic()
        if self._broken or not (always or start - self._saved > self._took / _SHARE):
            return
        last(self.histories(last=True)).save(self._folder / "end.npz")
        self._saved = time.monotonic()
        self._took = self._saved - start

    def _write(self, histories: RecordedHistories, new: int) -> list[str]:
        """Write the rows from one on; the names of their files beside the collection."""
        q, v, resultants = histories["q"], histories["v"], self._along(histories, new)
        first, folder = len(self._written.times), self._folder.name
        names = [f"{folder}_{first + i:05d}.vtu" for i in range(len(q) - new)]
        with replacing_all([self._folder / name for name in names]) as files:
            self._grid.write(files, q[new:], v[new:] if len(v) == len(q) else None, resultants)
        return [f"{folder}/{name}" for name in names]

    def _along(self, histories: RecordedHistories, new: int) -> dict[str, np.ndarray]:
        """Resultants and internal variables (rows, elements, points) of the rows from one on."""
        model, recorder = self._model, self._recorder
        beams = model.forms.beams
        assert beams is not None
        steps = RowSteps(recorder, new)
        values = steps.means(beams.resultants(steps.batch()))
        resultants = dict(zip(RESULTANTS, np.moveaxis(values, -1, 0), strict=True))
        forces = self._section_forces(histories["a"], new, values)
        for _, cells, name, history, column in variables_along(model):
            cell_values = resultants.setdefault(name, np.zeros_like(resultants["N"]))
            cell_values[:, cells] = histories[history][new:, cells][..., column]
        return {name: at_ends(values) for name, values in resultants.items()} | forces

    def _section_forces(self, a: np.ndarray, new: int, gauss: np.ndarray) -> dict[str, np.ndarray]:
        """N, Q and M (rows, elements, points) by the balance of elements, where that is known."""
        from .element_balance import ElementBalance

        recorder, mesh = self._recorder, self._model.mesh
        if len(a) < recorder.rows:
            return {}
        points = np.linspace(0.0, 1.0, mesh.elements.shape[1])
        values = np.empty((3, *gauss.shape[:2], len(points)))
        accelerations = a[new:].reshape(len(gauss), -1).copy()
        with suppress(ValueError):
            balance = ElementBalance(
                recorder, self._model.data.loaded_beams, accelerations, first=new
            )
            for number, cells in enumerate(mesh.cells):
                beam_points = gauss[:, cells].reshape(len(gauss), -1, 3)
                values[:, :, cells] = balance.of_beam(number).in_elements(beam_points, points)
            return dict(zip(RESULTANTS, values, strict=True))
        return {}

    @property
    def has_rows(self) -> bool:
        """Whether any rows are in files; else the recorder has all."""
        return bool(self._written.small)

    # -- What stays ---------------------------------------------------------------------------

    def histories(self, last: bool = False) -> RecordedHistories:
        """The histories of all rows, or of the last one, without those of the motion."""
        parts, written = slice(-1 if last else 0, None), self._written
        small = {
            name: np.concatenate([block[name][parts] for block in written.small[parts]])
            for name in written.small[0]
        }
        t, levels, rates = np.array(written.times[parts]), small.pop("t_level"), written.fitted
        fitted = None if rates is None else lambda: small | {"v": rates[None]}
        impact = self._recorder.first.impact
        return RecordedHistories(self._model, small, fitted, {}, t, lambda: levels, impact)
