"""Energies, resultants, section forces, stability and statistics of a simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.errors import Failure, answering, answering_keywords, is_one_of, real_array, require
from fx_beam.scene.beam import Beam, gauss_rule, lagrange
from fx_beam.scene.loads import label
from fx_beam.scene.notebook import html_table, sketch
from fx_beam.scene.section import check_sizes

# -- Section forces N, Q and M at any place of a beam, from the balance of its elements ---------


# Distance of places from a node, relative to the length of a beam, at which they are at it.
AT_NODE = 1e-9


class SectionForces(NamedTuple):
    """Section forces (rows, places) of a beam at some places.

    Parameters
    ----------
    s : (places,) float
        Arc lengths from the start [m].
    N, Q, M : (rows, places) float
        Axial force [N], shear force [N], bending moment [N m].
    """

    s: np.ndarray
    N: np.ndarray
    Q: np.ndarray
    M: np.ndarray


@dataclass(frozen=True)
class BeamBalance:
    """Section forces that follow from the balance of the elements of a beam.

    M' = -Q joins them: where N and Q go straight, M is a parabola. Elements of degree 2 and 3
    without loads at places have polynomials that also go through the values at the Gauss points.
    """

    #: Arc lengths (elements + 1,) of the ends of elements [m].
    s: np.ndarray
    #: N, Q and M (rows, elements, 2, 3) at both ends of elements.
    ends: np.ndarray
    #: Arc lengths (m,) of forces and couples inside elements, and jumps (rows, m, 3) there.
    places: np.ndarray
    jumps: np.ndarray

    @cached_property
    def owners(self) -> np.ndarray:
        """Elements (m,) that these act on: at a node that behind it, as of `BeamPlace.element`."""
        places = self.places + AT_NODE * self.s[-1]
        return np.clip(np.searchsorted(self.s, places, "right") - 1, 0, len(self.s) - 2)

    @classmethod
    def of_all(cls, balances: Sequence[BeamBalance]) -> BeamBalance:
        """The balance of several beams, as of one behind the other."""
        s = np.cumsum(np.concatenate([[0.0], *(np.diff(balance.s) for balance in balances)]))
        parts = ([getattr(b, name) for b in balances] for name in ("ends", "jumps"))
        ends, jumps = (np.concatenate(part, axis=1) for part in parts)
        first = np.cumsum([0, *(len(balance.s) - 1 for balance in balances)])
        pairs = [*zip(balances, first, strict=False)]
        owners = np.concatenate([balance.owners + k for balance, k in pairs])
        inside = np.concatenate([b.places - b.s[b.owners] for b in balances])
        whole = cls(s, ends, s[owners] + inside, jumps)
        vars(whole)["owners"] = owners  # in many beams a tolerance would be too large
        return whole

    def in_rows(self, rows: list[int]) -> BeamBalance:
        """The balance in some rows."""
        return replace(self, ends=self.ends[rows], jumps=self.jumps[rows])

    def forces_at(self, gauss: np.ndarray, s, side: str) -> SectionForces:
        """Section forces at arc lengths s, by values (rows, points, 3) at the Gauss points."""
        places, length = np.atleast_1d(real_array(s)), self.s[-1]
        tolerance = AT_NODE * length
        is_on_beam = (places > -tolerance) & (places < length + tolerance)
        expected = f"arc lengths from 0 to the length of the beam, {length:g}"
        require(places.ndim == 1 and bool(is_on_beam.all()), "at: s", s, expected)
        require(is_one_of(side, ("before", "after")), "at: side", side, "'before' or 'after'")
        shift = tolerance if side == "after" else -tolerance
        element = np.clip(np.searchsorted(self.s, places + shift) - 1, 0, len(self.s) - 2)
        x = (places - self.s[element]) / np.diff(self.s)[element]
        return SectionForces(places, *self._values(gauss, element, x, shift))

    def in_elements(self, gauss: np.ndarray, x: np.ndarray, behind: float = 0.0) -> np.ndarray:
        """N, Q and M (3, rows, elements, points) at points x (points,) of each element.

        Points are `behind` [m] of these where loads act.
        """
        count = len(self.s) - 1
        elements, points = np.repeat(np.arange(count), len(x)), np.tile(x, count)
        values = self._values(gauss, elements, points, behind)
        return values.reshape(3, len(gauss), count, len(x))

    def _values(self, gauss, element: np.ndarray, x: np.ndarray, shift: float) -> np.ndarray:
        """N, Q and M (3, rows, n) in elements (n,) at x (n,) from 0 to 1."""
        h, count = np.diff(self.s), len(self.s) - 1
        degree = gauss.shape[1] // count
        gauss_values = gauss.reshape(len(gauss), count, degree, 3)
        change = self.ends[:, :, 1, 1] - self.ends[:, :, 0, 1]
        owners = self.owners
        for owner, jump in zip(owners, self.jumps[..., 1].T, strict=True):
            change[:, owner] -= jump
        start, end = self.ends[:, element].swapaxes(0, 2)  # (n, rows, 3) each
        values = np.moveaxis(start + (end - start) * x[:, None, None], -1, 0).swapaxes(1, 2)
        bend = change[:, element] * (h[element] * x * (1 - x) / 2)
        values[2] += bend
        smooth = np.isin(element, owners, invert=True)
        if degree > 1 and smooth.any():
            nodes = np.array([0.0, 1.0, *gauss_rule(degree)[0]])
            known_values = np.concatenate([self.ends, gauss_values], axis=2)[:, element[smooth]]
            weights = lagrange(nodes, x[smooth])
            # The same sums to the last digit in any number of rows.
            terms = (w[:, None] * known_values[:, :, p] for p, w in enumerate(weights.T))
            values[..., smooth] = np.moveaxis(sum(terms), -1, 0)
        for place, owner, jump in zip(self.places, owners, self.jumps.swapaxes(0, 1), strict=True):
            (places,) = np.nonzero(element == owner)
            load_place, part = (place - self.s[owner]) / h[owner], x[places]
            is_beyond = part > load_place - shift / h[owner]
            values[..., places] += jump.T[..., None] * (is_beyond - part)
            hat = np.where(part < load_place, part * (1 - load_place), load_place * (1 - part))
            values[2][:, places] += h[owner] * jump[:, 1, None] * hat
        return values


# -- Energies, resultants, stability and statistics of a simulation; these in a few lines -------


@contextmanager
def stats_unchanged(stats: Stats) -> Iterator[None]:
    """Block in which no statistics change."""
    # Lists of what is compiled are those of the model, which goes on with them.
    counts = vars(stats) | {"ended_by": dict(stats.ended_by)}
    try:
        yield
    finally:
        vars(stats).update(counts)


def read_only(values: np.ndarray) -> np.ndarray:
    """Read-only view of an array."""
    view = np.asarray(values).view()
    view.setflags(write=False)
    return view


@dataclass(frozen=True)
class Energy:
    """Energies over time, each (n,) [J].

    Parameters
    ----------
    kinetic : (n,) float
        1/2 v.M v (eq. 8), with the rates v of the scheme. `Solution.v` has rates that joints allow:
        their energy is smaller, by the order of dt^4 if the coupling by joints changes with the
        motion, and by the energy of a jump after the rate of a driven motion has jumped.
    strain : (n,) float
        Stored energy of the beams (eq. 10).
    potential : (n,) float
        Potential energy of the weight, zero in the reference configuration.
    work : (n,) float
        Work since the start of loads, prescribed motions, motors and added virtual works.
    springs : (n,) float, optional
        Stored energy of springs and stops of joints, and of obstacles; zero by default.
    dissipated : (n,) float, optional
        Energy dissipated since the start by dampers and friction of joints, by drag, by the
        material (`retardation` and `internal` variables of sections and springs), by the
        restitution of stops and obstacles and by `EnergyDecaying`; it never decreases, with schemes
        of order 4 by more than 1e-8 of the energy. Zero by default.
    algorithmic : (n,) float, optional
        Energy that `EnergyDecaying` of order 2 stores until the next step; part of the balance, not
        of `total`. Zero by default.
    numerical : (n,) float, optional
        The part of `dissipated` that is due to `EnergyDecaying`. Zero by default.
    impact : (n,) float, optional
        Kinetic energy lost since the start by changes of the scene between two motions: new joints
        and supports act like a plastic impact. Zero by default.

    Examples
    --------
    >>> import numpy as np, fx_beam as fb
    >>> zero = np.zeros(2)
    >>> energy = fb.Energy(kinetic=np.array([2.0, 3.0]), strain=zero, potential=zero,
    ...                    work=np.array([0.0, 0.9]))
    >>> energy.total, energy.balance_error.round(3)
    (array([2., 3.]), array([0. , 0.1]))
    """

    kinetic: np.ndarray
    strain: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    springs: Any = None
    dissipated: Any = None
    algorithmic: Any = None
    numerical: Any = None
    impact: Any = None

    def __post_init__(self):
        for name, values in vars(self).items():
            vars(self)[name] = read_only(np.zeros_like(self.kinetic) if values is None else values)

    def __repr__(self):
        total, error = self.total, abs(self.balance_error).max()
        return (
            f"<Energy: {len(total)} rows, total {total[0]:.6g} to {total[-1]:.6g} J, "
            f"largest balance error {error:.2g} J>"
        )

    def _repr_html_(self):
        shades = "#000", "#0072B2", "#D55E00", "#009E73"
        values = {name: getattr(self, name) for name in ("total", "kinetic", "strain", "potential")}
        largest = max(abs(energy).max() for energy in values.values()) or 1.0
        x = np.linspace(0, 3, len(self.total))
        lines = [np.column_stack([x, energy / largest]) for energy in values.values()]
        ends = {name: f"{energy[0]:.6g} to {energy[-1]:.6g}" for name, energy in values.items()}
        error = {"largest balance error": f"{abs(self.balance_error).max():.2g}"}
        return html_table("Energy [J]", ends | error) + sketch(lines, shades)

    @property
    def stored(self) -> np.ndarray:
        """Energy stored in beams, springs, stops and obstacles (n,) [J]."""
        return self.strain + self.springs

    @property
    def total(self) -> np.ndarray:
        """Kinetic, stored and potential energy (n,) [J]."""
        return self.kinetic + self.stored + self.potential

    @property
    def supplied(self) -> np.ndarray:
        """Work minus dissipated energy and impacts, all since the start, (n,) [J]."""
        supplied = self.work - self.dissipated - self.impact
        return supplied - supplied[0]

    @property
    def balance_error(self) -> np.ndarray:
        """Increase of the energy since the start, minus the supplied energy, (n,) [J].

        The energy is `total` plus `algorithmic`. In statics `work` is a sum over load steps, each
        with the mean of its loads; the error is that of the sum, and falls with the square of the
        number of steps.
        """
        energy = self.total + self.algorithmic
        return energy - energy[0] - self.supplied

    @property
    def gained(self) -> np.ndarray:
        """Energy that the motion gained without a physical cause, (n,) [J]; negative if lost.

        Unlike in `balance_error`, energy that the scheme dissipates or stores counts as lost.
        """
        return self.total - self.total[0] - self.supplied - (self.numerical - self.numerical[0])


@dataclass
class Stats:
    """Statistics of a simulation.

    Parameters
    ----------
    scheme : str
        Name of the time scheme.
    level : float
        Level of the step at which forces are evaluated: 0.5 is its middle, 1 its end.
    solver : str
        Name of the linear solver.
    unknowns : int
        Number of free degrees of freedom.
    steps : int
        Completed steps of the time grid.
    newton_iterations : int
        Newton iterations in all, failed attempts not counted.
    halvings : int
        How often a step failed and was halved.
    substeps : int
        Steps that were computed, each part of a halved step counted. The sub-steps of a scheme of
        order 4 count as one.
    too_large : int
        Parts of halved steps in which a node rotated by more than half a radian per step of the
        grid. Then `dt` is too large for the motion, and the result may depend on round-off.
    unconverged : int
        Steps, each part of a halved step counted, that were halved because Newton's method did not
        converge. Round-off may decide whether it converges, and therefore which steps are halved.
    inverted : int
        Steps, each part of a halved step counted, that end with a Gauss point at which a section
        is inverted: t . phi' > 0 (eq. 4) is violated.
    amplified : int
        Steps, each part of a halved step counted, that were halved since dampers, friction or drag
        gave energy in them. Only schemes of order 4 have such steps: they have a sub-step that goes
        back in time.
    rejected : int
        With a tolerance: steps that were repeated because their errors were too large, and trial
        steps that choose the first length.
    ended_by : dict
        Number of Newton solves that ended by a small increment, and of those that ended at
        round-off.
    rounding : float
        Estimated effect of rounding errors, relative to the largest displacement of the motion or
        to 1e-5 of the size of the scene, if that is more: the sum of the last corrections in steps
        in which Newton's method ended at round-off. 0 if there are no such steps. The effect may
        grow in the later motion.
    rounding_in : str
        Beam or node with the largest of these corrections; empty if there is none.
    seconds : float
        Time of the steps [s].
    setup_seconds : float
        Time for mesh, compilation and constant matrices [s].
    setup_reason : str
        Why the scene was set up anew; empty if only its numbers were new, after a scene of the same
        structure in a `Response`, a `Motion` or `simulate`.
    difference_reason : str
        The parameters of a `Response` by which derivatives use differences of `build`, and why;
        empty if one call with dual numbers gives all derivatives.
    compiled : list of str
        Compiled forms.
    assembled : list of str
        Matrices and loads of the scene.
    friction_damping : dict
        Damping tau [s] of friction that sticks (`Coulomb`): the least and the largest of each
        contact or joint, by its text. For two members it is that of the nodes of the first one.
    failure : Failure, optional
        Why the run failed; none if it did not.
    until : str
        Name of the condition that ended the motion, as given to `simulate`: "until" for a single
        function. Empty if the motion went on to its end.
    changes : dict
        Time [s] of each change of the scene in the motion, by its name in the `changes` of
        `simulate`.
    file : str
        File with motion and rates, if `Record` has one; the solution then does not have them. Empty
        otherwise.
    static : bool
        Whether the solution is static: its steps are load factors, not times.
    linear : bool
        Whether the solution is linear, for small displacements.
    limit_points : list of float
        Load factors of the limit points on the path.
    closed : bool
        Whether the branch has returned to the bifurcation where it began, which is its last row.
    gradient_growth : float
        After `Response.vjp`: the largest derivative by the rates in the first half of the motion,
        relative to the largest one in the second half. It is of the order of 1 if later states
        depend on earlier states as in a vibration. In a chaotic motion it grows exponentially with
        time.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> scene.clamp(scene.add_beam([(0, 0), (1, 0)], section, elements=1).start)
    >>> stats = fb.simulate(scene, dt=0.1, t_end=0.5).stats
    >>> stats.scheme, stats.steps, stats.unknowns, stats.halvings
    ('EnergyMomentum', 5, 3, 0)
    """

    scheme: str
    level: float
    solver: str
    unknowns: int
    steps: int = 0
    newton_iterations: int = 0
    halvings: int = 0
    substeps: int = 0
    too_large: int = 0
    unconverged: int = 0
    inverted: int = 0
    amplified: int = 0
    rejected: int = 0
    ended_by: dict[str, int] = field(default_factory=dict)
    rounding: float = 0.0
    rounding_in: str = ""
    seconds: float = 0.0
    setup_seconds: float = 0.0
    setup_reason: str = ""
    difference_reason: str = ""
    compiled: list[str] = field(default_factory=list)
    assembled: list[str] = field(default_factory=list)
    friction_damping: dict[str, list[float]] = field(default_factory=dict)
    failure: Failure | None = None
    until: str = ""
    changes: dict[str, float] = field(default_factory=dict)
    file: str = ""
    static: bool = False
    linear: bool = False
    limit_points: list[float] = field(default_factory=list)
    closed: bool = False
    gradient_growth: float = 0.0

    def __repr__(self):
        iterations = self.newton_iterations / max(1, self.substeps)
        ended = f", ended early: {self.failure}" if self.failure else ""
        return (
            f"<Stats: {self.scheme}, {self.solver}, {self.unknowns} unknowns, {self.steps} steps "
            f"with {self.halvings} halvings, {iterations:.2g} iterations each, "
            f"{self.seconds:.3g} s{ended}>"
        )

    def _repr_html_(self):
        known = {name.replace("_", " "): value for name, value in vars(self).items() if value}
        words = {name: f"{x:.3g}" if isinstance(x, float) else str(x) for name, x in known.items()}
        return html_table("Stats", words)

    def add_solve(self, iterations: int, ended_by: str) -> None:
        """Count a Newton solve.

        Parameters
        ----------
        iterations : int
            Its iterations.
        ended_by : {"increment", "round-off"}
            Why it ended.
        """
        self.newton_iterations += iterations
        self.ended_by[ended_by] = self.ended_by.get(ended_by, 0) + 1


@answering_keywords
@answering
@dataclass(frozen=True)
class BeamResultants:
    """Stress resultants along a beam, at the Gauss points of its elements.

    Row k belongs to the step that ends at t[k], also if this step was halved. With the mid-point
    schemes it is the mean over the step, otherwise the value at `Solution.t_level`. The same holds
    for row k of `Solution.reaction` and `JointMotion.force`. Row 0 has the resultants of the
    configuration and rates at the start, for constant natural strains.

    Forces of `Scene.add_virtual_work` that act inside a beam are not included: they are not part of
    the stored energy or of the scheme.

    Parameters
    ----------
    s : (elements * degree,) float
        Arc length of the points [m].
    N : (n, elements * degree) float
        Axial force, positive in tension [N].
    Q : (n, elements * degree) float
        Shear force along the rotated section [N].
    M : (n, elements * degree) float
        Bending moment [N m].
    balance : Balance, callable or None
        Section forces at the ends of elements, for `at` and `ends`, or a function that gives them;
        None if they are not known.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=2)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (10.0, 0.0))
    >>> forces = fb.static(scene, load_steps=1).resultants(beam)
    >>> forces.s, forces.N[-1].round(6)
    (array([0.5, 1.5]), array([10., 10.]))
    """

    s: np.ndarray
    N: np.ndarray
    Q: np.ndarray
    M: np.ndarray
    balance: Any = field(default=None, repr=False)

    def __repr__(self):
        rows, points = self.N.shape
        peaks = (f"{name} to {abs(getattr(self, name)).max():.4g}" for name in "NQM")
        return f"<BeamResultants: {rows} rows, {points} points, {', '.join(peaks)}>"

    def __post_init__(self):
        vars(self).update({name: read_only(getattr(self, name)) for name in "sNQM"})

    def __getstate__(self):
        with suppress(ValueError):
            self.balanced()
        return self.__dict__ | {"balance": None if callable(self.balance) else self.balance}

    def balanced(self) -> Any:
        """The balance of the elements.

        Returns
        -------
        Balance
            Section forces at the ends of elements.

        Raises
        ------
        ValueError
            If the balance is not known.
        """
        if callable(self.balance):
            object.__setattr__(self, "balance", self.balance())
        if self.balance is None:
            raise ValueError(
                "the balance of elements is not known: of a file of an older version, replaced "
                "resultants, or a motion without rates. N, Q and M at the Gauss points are"
            )
        return self.balance

    def at(self, s, side: str = "after") -> SectionForces:
        """Section forces at any places, from the balance of each element.

        The section forces at the ends of an element are its internal forces plus inertia minus
        loads. They are in exact balance: at a clamp they are the reaction, at a free end zero.
        Between the ends N and Q are linear and M is a parabola, which is exact for uniform line
        loads; at forces and moments inside elements they jump. With degree 2 and 3 the curves also
        pass through the values at the Gauss points.

        Parameters
        ----------
        s : float or (places,) array of float
            Arc lengths from the start of the beam [m].
        side : {"after", "before"}
            The side of a node or place at which they jump.

        Returns
        -------
        SectionForces
            With N, Q and M (rows, places).

        Raises
        ------
        SceneError
            For places beyond the ends.
        ValueError
            If the accelerations were not recorded, or loads of elements are not known.
        """
        return self.balanced().forces_at(self._points, s, side)

    @property
    def ends(self) -> SectionForces:
        """Section forces (rows, 2) at the start and at the end of the beam, as given by `at`."""
        return self.at(self.balanced().s[[0, -1]])

    @property
    def _points(self) -> np.ndarray:
        """N, Q and M (rows, points, 3) at the Gauss points."""
        return np.stack([self.N, self.Q, self.M], axis=-1)

    def in_elements(self, quantity: str, points: np.ndarray) -> np.ndarray:
        """Values at the same points of each element.

        Parameters
        ----------
        quantity : {"N", "Q", "M"}
            Which.
        points : (points,) float
            Places in elements, from 0 to 1.

        Returns
        -------
        (rows, elements, points) float
            The values.
        """
        values = self.balanced().in_elements(self._points, points)
        return values["NQM".index(quantity)]


def facts(solution) -> dict[str, str]:
    """Range, steps, effort and energy of a solution, by their names."""
    stats, energy = solution.stats, solution.energy
    time = "load factor" if stats.static else "t"
    entries = {
        "scheme": stats.scheme,
        time: f"{solution.t[0]:g} to {solution.t[-1]:g}, {len(solution.t)} rows",
        "steps": f"{stats.steps}, {stats.halvings} halvings",
        "Newton iterations": str(stats.newton_iterations),
        "solver": f"{stats.solver}, {stats.unknowns} unknowns",
        "seconds": f"{stats.seconds:.3g}, and {stats.setup_seconds:.3g} to set up",
        "total energy": f"{energy.total[0]:.6g} to {energy.total[-1]:.6g}",
        "largest energy error": f"{abs(energy.balance_error).max():.2g}",
    }
    return entries | ({"ended early": str(stats.failure)} if stats.failure else {})


def known_resultants(solution) -> dict[str, BeamResultants]:
    """Resultants of all beams by their names; none if what they depend on was not recorded."""
    with suppress(ValueError):
        return {name: solution.resultants(name) for name in solution.beams}
    return {}


# -- Stresses at the edges of sections, from section forces -------------------------------------


@dataclass(frozen=True, repr=False)
class BeamStress:
    """Stresses along a beam, from its section forces and the sizes of its section.

    The normal stress at the distance e to the left of the axis is N / A - M e / I, the mean shear
    stress Q / As. Stresses are linear over the depth also in curved members. By Winkler's theory
    the stress at the inner edge of a curved rectangle of depth h and radius R is 3.4, 7.1 and 20 %
    larger for R / h = 10, 5 and 2.

    Parameters
    ----------
    beam : Beam
        The beam, with its `Section`.
    forces : BeamResultants or SectionForces
        Section forces (rows, places), with their arc lengths s.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = fb.Section.circle(0.02, **fb.materials.steel)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], bar, elements=1)
    >>> scene.clamp(beam.start)
    >>> pull = scene.add_force(beam.end, (314.16, 0.0))
    >>> print(fb.static(scene, linear=True).stress(beam))
    <BeamStress: 2 rows, 1 places, largest 1e+06 Pa>
    """

    beam: Beam
    forces: BeamResultants | SectionForces

    def __repr__(self):
        rows, places = self.forces.N.shape
        return f"<BeamStress: {rows} rows, {places} places, largest {self.largest.max():.4g} Pa>"

    @property
    def s(self) -> np.ndarray:
        """Arc lengths (places,) from the start of the beam [m]."""
        return self.forces.s

    @property
    def lower(self) -> np.ndarray:
        """Normal stress (rows, places) at the lower edge, right of the axis [Pa]."""
        return self._at_edge("lower")

    @property
    def upper(self) -> np.ndarray:
        """Normal stress (rows, places) at the upper edge, left of the axis [Pa]."""
        return self._at_edge("upper")

    @property
    def largest(self) -> np.ndarray:
        """The larger magnitude (rows, places) of the normal stresses at both edges [Pa]."""
        return np.maximum(abs(self.lower), abs(self.upper))

    @property
    def shear(self) -> np.ndarray:
        """Mean shear stress Q / As (rows, places) [Pa]."""
        return self.forces.Q / self._sizes("As")[0]

    def at(self, s: Any, side: str = "after") -> BeamStress:
        """Stresses at any places, from the section forces of `BeamResultants.at`.

        Parameters
        ----------
        s : float or (places,) array of float
            Arc lengths from the start of the beam [m].
        side : {"after", "before"}
            The side of a node or place at which forces jump.

        Returns
        -------
        BeamStress
            Stresses (rows, places).
        """
        of_beam = isinstance(self.forces, BeamResultants)
        require(of_beam, "BeamStress.at: stresses", self, "those of solution.stress, not at places")
        assert isinstance(self.forces, BeamResultants)
        return BeamStress(self.beam, self.forces.at(s, side))

    @property
    def ends(self) -> BeamStress:
        """Stresses (rows, 2) at the start and at the end of the beam, as given by `at`."""
        return self.at([0.0, self.beam.length])

    def _at_edge(self, edge: str) -> np.ndarray:
        A, J, place = self._sizes("A", "I", edge)
        return self.forces.N / A - self.forces.M * place / J

    def _sizes(self, *names: str) -> list[np.ndarray]:
        """Sizes (places,) of the section."""
        section = self.beam.section
        check_sizes(section, *names, subject=f"stress of {label(self.beam)}")
        fractions = np.clip(self.s / self.beam.length, 0.0, 1.0)
        return [section.values(name, fractions) for name in names]
