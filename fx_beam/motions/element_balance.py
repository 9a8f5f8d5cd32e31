"""Section forces at the ends of elements, from the balance of each with its inertia and loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import dual_array, floats
from fx_beam.errors import any_of, warn_once
from fx_beam.fem.functions_of_time import LoadedBeams, dead_loads
from fx_beam.fem.mass import masses_of_points
from fx_beam.fem.mesh import Mesh
from fx_beam.laws.interval import Rest, StepBatch, just_inside
from fx_beam.laws.rates import NewmarkRates
from fx_beam.results.records import BeamBalance
from fx_beam.scene.beam import Beam, BeamPlace, lagrange, lagrange_and_slopes
from fx_beam.scene.functions import InputSignal
from fx_beam.scene.outputs import Output, section_value
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import RowSteps
from fx_beam.step.recorder import Recorder

# -- Section forces at the ends of elements, from the balance of each with its inertia and loads


class ElementLoads:
    """Masses of elements and dead loads on their own nodes, with slopes that the scene has.

    Of beams and loads, and nodes at X (n, 2). Loads at nodes are none of elements.
    """

    def __init__(self, model: Model, loaded_beams: LoadedBeams, X: Any):
        mesh, loads, beams = model.mesh, loaded_beams.loads, model.forms.beams
        if beams is not None and beams.has_own_work:
            warn_once(
                f"section forces at places: the virtual work of {model.scheme.name} is your own. M "
                "is its couple; N and Q are components along sections that turn by psi, as in "
                "Reissner's theory. Those of your theory are resultants(beam).N and .Q, at the "
                "Gauss points"
            )
        numbers = np.arange(mesh.elements.size).reshape(mesh.elements.shape)
        own = floats(X)[mesh.elements].reshape(-1, 2)
        #: The mesh with own nodes of each element.
        self.torn = Mesh(own, numbers, mesh.cells, mesh.curved)
        #: Masses (cells, n) of the Gauss points of elements.
        self.masses = model.masses.at_points(loaded_beams, X)
        self._loads = [load for load in loads if isinstance(load.target, Beam | BeamPlace | None)]
        for load in self._loads:
            if isinstance(load.value, InputSignal) and not load.value.is_open:
                raise ValueError(
                    f"section forces from the balance of elements need the history of {load}, "
                    "which an Input of a Motion does not keep; give simulate(inputs=...) "
                    "functions, or take N, Q and M at the Gauss points"
                )
        moves = any_of(floats(self.masses))
        chosen = [load for load in self._loads if load.target is not None or moves]
        #: Loads on the own nodes, and their weight (size,) by constant gravity, if there is any.
        self.dead = dead_loads(loaded_beams, self.torn, own, self._weights, chosen)
        gravity = loaded_beams.gravity
        self.weight = None if gravity is None else self._weights(dual_array(gravity))

    def _weights(self, acceleration: Any) -> Any:
        """Weights of elements by an acceleration (2,)."""
        dofs, count = self.torn.unknowns.dofs, self.torn.elements.shape[1]
        pull = np.concatenate([np.tile(acceleration, count), np.zeros(count)])
        weights = self.masses @ (masses_of_points(count - 1) @ pull)
        return weights.reshape(-1)[np.argsort(dofs.ravel())]

    def inside(self, beam: str) -> list[Any]:
        """Loads inside elements of a beam."""
        return self._inside.get(beam, [])

    @cached_property
    def _inside(self) -> dict[str, list[Any]]:
        inside = dict[str, list[Any]]()
        for load in self._loads:
            if isinstance(load.target, BeamPlace):
                inside.setdefault(load.target.beam.name, []).append(load)
        return inside


class ElementBalance:
    """Forces f = internal + inertia - loads (8.3) of elements on their own nodes, in rows.

    `loaded_beams` are beams and loads, `a` (n, size) accelerations of the rows from `first` on,
    `rest` that of equilibria; loads of elements may be known as `own_loads`. Loads of the state
    from which equilibria start act at nodes.
    """

    def __init__(
        self,
        recorder: Recorder,
        loaded_beams: LoadedBeams,
        a: np.ndarray,
        rest: Rest | None = None,
        first: int = 0,
        own_loads: ElementLoads | None = None,
    ):
        self.model, self._rest, self._first = (model := recorder.model), rest, first
        self._steps, beams = RowSteps(recorder, first), model.forms.beams
        assert beams is not None
        self._loaded_beams = loaded_beams
        self._loads = own_loads or ElementLoads(model, loaded_beams, model.mesh.X)
        level = model.scheme.rates.level
        self._parts = parts = self._batch(a, beams.depend_on_rates)
        unit_masses = masses_of_points(beams.kind.degree)
        self._masses = np.tensordot(floats(self._loads.masses), unit_masses, 1)
        form_dofs = model.mesh.unknowns.dofs
        nodal_forces = beams.forces_of_cells(parts)
        forces = np.zeros((len(parts.t), self._loads.torn.dofs.size))
        forces[:, self._loads.torn.unknowns.dofs] = nodal_forces
        forces -= self._dead()
        forces = self._steps.means(forces)
        if a.any():
            # The same sums to the last digit in any number of rows.
            columns = zip(np.moveaxis(self._masses, -1, 0), a[:, form_dofs].T, strict=True)
            inertia = sum(column * part.T[..., None] for column, part in columns)
            forces[:, self._loads.torn.unknowns.dofs] += inertia
        #: Forces (n, cells, degree + 1, 3) on the nodes of elements, in order along them.
        self.forces = forces.reshape(len(a), *model.mesh.elements.shape, 3)
        turns = self._steps.means(parts.q + level * parts.D)[:, model.mesh.dofs[:, 2]]
        # Positions (cells, degree + 1, 2) and rotations (n, cells, degree + 1) of their nodes: the
        # model may serve another scene when jumps are read.
        self._X, self._turns = model.mesh.X[model.mesh.elements], turns[:, model.mesh.elements]
        angles = directions(self._X) + self._turns[:, :, [0, -1]]
        #: N, Q and M (n, cells, 2, 3) at both ends of elements.
        ends = self.forces[:, :, [0, -1]] * np.array([-1.0, 1.0])[:, None]
        self.ends = components(ends, angles)

    def _batch(self, a: np.ndarray, moves: bool) -> StepBatch:
        """The sub-steps; accelerations (n, size) at their ends become those of the equations."""
        parts, rest = self._steps.batch(moves), self._rest
        if rest is not None:
            return parts._replace(t=np.full(len(parts.t), rest.time), load_factor=rest.factors)
        rates = self.model.scheme.rates
        if isinstance(rates, NewmarkRates) and rates.alpha_m:
            rows = slice(not self._first, None)  # row 0 is no step
            a[rows] += rates.alpha_m * (parts.a - a)[rows]
        return parts

    def _dead(self) -> np.ndarray:
        """Dead loads (n, size) of elements in the sub-steps."""
        loads, rates = self._loads.dead, self.model.scheme.rates
        if self._rest is not None:
            at_rest = floats(loads.series(np.array([self._rest.time]))) @ loads.unit_loads.T
            dead = self._rest.factors[:, None] * at_rest
        else:
            both = floats(loads.in_steps(*self._ends_of_steps(), rates.mean_based))
            at_start, at_end = (both[:, i] @ loads.unit_loads.T for i in (0, 1))
            dead = (1 - rates.level) * at_start + rates.level * at_end
        if (weight := self._loads.weight) is not None:
            factors = 1.0 if self._rest is None else self._rest.factors[:, None]
            dead = dead + factors * floats(weight)
        return dead

    def _in_steps(self, values) -> np.ndarray:
        """Values (n, ...) at the scheme's level of a function of times, or by the load factors."""
        if self._rest is not None:
            return self._rest.factors[:, None] * values(np.array([self._rest.time]))
        level, (t0, t1) = self.model.scheme.rates.level, just_inside(*self._ends_of_steps())
        return (1 - level) * values(t0) + level * values(t1)

    def _ends_of_steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts and ends (n,) of the sub-steps [s]."""
        parts, level = self._parts, self.model.scheme.rates.level
        t0, t1 = parts.t - level * parts.dt, parts.t + (1 - level) * parts.dt
        if not self._first:
            t0[0] = t1[0] = parts.t[0]  # of the start, before which nothing need be known
        return t0, t1

    def of_beam(self, number: int, rows: slice | np.ndarray = slice(None)) -> BeamBalance:
        """Section forces of a beam of the scene in some rows."""
        places, jumps = self.jumps(number)
        s, cells = self._loaded_beams.beams[number].s, self.model.mesh.cells[number]
        return BeamBalance(s, self.ends[:, cells][rows], places, jumps[rows])

    def jumps(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Arc lengths (m,) of loads inside elements of a beam, and jumps (n, m, 3) there."""
        scene, mesh, places, jumps = self._loaded_beams, self.model.mesh, [], []
        beam = scene.beams[number]
        for load in self._loads.inside(beam.name):
            values = self._in_steps(
                lambda t, load=load: floats(load.value.series(t, str(load), scene.array_calls))
            )
            values = self._steps.means(np.asarray(values, dtype=float))
            force = np.zeros((len(values), 3))
            force[:, [0, 1] if load.kind == "force" else [2]] = values
            element, x = load.target.element
            cell = mesh.cells[number][element]
            weights = lagrange(np.linspace(0.0, 1.0, mesh.elements.shape[1]), np.array([x]))[0]
            angles = directions(self._X[cell], [x]) + self._turns[:, cell] @ weights
            places.append(load.target.s)
            jumps.append(-components(force, angles))
        shape = len(places), len(self.forces), 3
        return np.array(places), np.reshape(jumps, shape).swapaxes(0, 1)


def directions(X: Any, places: Sequence[float] = (0.0, 1.0)) -> Any:
    """Directions (..., places) of the normals [rad] in elements with nodes (..., n, 2)."""
    nodes = np.linspace(0.0, 1.0, X.shape[-2])
    tangents = lagrange_and_slopes(nodes, np.array(places))[1] @ X
    return np.arctan2(tangents[..., 1], tangents[..., 0])


def components(forces: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """N, Q and M (..., 3) of forces and moments (..., 3), by directions of the normal [rad]."""
    (x, y, m), c, s = np.moveaxis(forces, -1, 0), np.cos(angles), np.sin(angles)
    return np.stack([c * x + s * y, c * y - s * x, m], axis=-1)


# -- Section forces in the last row of a motion that is recorded, from the balance of elements --


class RowBalance:
    """The balance of the elements in the present state, which is computed once for all outputs.

    `now` gives what identifies the state, its record, and its accelerations (size,).
    """

    def __init__(self, model: Model, now: Callable[[], tuple[Any, Recorder, np.ndarray]]):
        self._model, self._now, self._state = model, now, None
        self._loads = ElementLoads(model, model.data.loaded_beams, model.mesh.X)
        self._balance: ElementBalance
        self._gauss: np.ndarray

    def value_of(self, output: Output) -> Callable[[], float]:
        """A function that reads an output at a place."""
        place: Any = output.of
        number = self._model.scene.beams.number_of(place.beam.name)
        cells = self._model.mesh.cells[number]

        def read() -> float:
            self._renew()
            gauss = self._gauss[:, cells].reshape(1, -1, 3)
            _, *forces = self._balance.of_beam(number).forces_at(gauss, place.s, "after")
            return float(section_value(output, *(force[0, 0] for force in forces)))

        return read

    def _renew(self) -> None:
        state, recorder, a = self._now()
        if state is self._state:
            return
        model, last, beams = self._model, recorder.rows - 1, self._model.forms.beams
        assert beams is not None  # as an output is of one
        with model.lock:
            steps = RowSteps(recorder, last)
            self._gauss = steps.means(beams.resultants(steps.batch()))
            self._balance = ElementBalance(
                recorder, model.data.loaded_beams, a[None].copy(), first=last, own_loads=self._loads
            )
        self._state = state
