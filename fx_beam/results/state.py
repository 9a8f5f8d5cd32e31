"""The system at one time, and the histories that a solution has of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.scene.joints import Constraints


def _kept(*shape: str | int, **options: Any) -> Any:
    """An array that only Python has, with its lengths, by their names in files."""
    return field(metadata={"shape": shape}, **options)


@dataclass
class Past:
    """The last configurations; the next increment is predicted from them."""

    #: Times (m,) since the configurations before the last one [s], the latest first.
    ages: np.ndarray = _kept("past")
    #: Orders of extrapolation, one for each sub-step of the scheme; 0 for no prediction.
    orders: np.ndarray = _kept("orders")
    #: Divided differences (m, size) of the configurations, from order 1 on.
    differences: np.ndarray = _kept("past", "past nodes", 3)
    #: The same (m, joints) for the slides of the joints [m].
    slides: np.ndarray = _kept("past", "joints")


class StateArray(NamedTuple):
    """An array of the state."""

    #: Its lengths, by their names in `Model.sizes`.
    shape: tuple[str | int, ...]
    #: What of a `Record` selects its rows: "motion", "rates", "forces", or "always"; "" for none.
    record: str = ""
    #: Whether it is a mean over the step so far, where the scheme has it at mid-step.
    mean: bool = False
    #: Whether every state has it.
    required: bool = False

    @property
    def in_files(self) -> tuple[str | int, ...]:
        """The lengths in files, where vectors are by nodes."""
        if self.at_nodes:
            return "nodes", 3
        # Two motions in one solution may have more of these than the last state.
        growing_sizes = "contacts", "lines", "parameters"
        return tuple(f"end {size}" if size in growing_sizes else size for size in self.shape)

    @property
    def at_nodes(self) -> bool:
        """Whether it has an entry for each degree of freedom."""
        return str(self.shape[0]).endswith("dofs")

    def lengths(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """The lengths of a model."""
        return tuple(size if isinstance(size, int) else sizes[size] for size in self.shape)


def _array(*shape: str | int, **facts: Any) -> Any:
    """An array of the state: lengths by their names in `Model.sizes`, and facts of `StateArray`."""
    default: Any = MISSING if facts.get("required") else None
    return field(default=default, metadata={"quantity": StateArray(shape, **facts)})


@dataclass
class SteppedState:
    """The system at one time, as steps in C have it.

    This is the schema: its arrays and numbers are the members of the state in C, and the rows of a
    record, of a solution and of files.
    """

    t: float
    #: Motion of the motors since the start (motors,) [m, rad].
    motors: np.ndarray = _kept("motors")
    #: Displacements and rotations, rates, accelerations.
    q: np.ndarray = _array("dofs", record="motion", required=True)
    v: np.ndarray = _array("dofs", record="rates", required=True)
    a: np.ndarray = _array("dofs", record="rates", required=True)
    #: Slides of the joints [m].
    slides: np.ndarray = _array("joints", record="always", required=True)
    #: In the step so far: forces of driven and fixed columns, of joints, of obstacles, and along
    #: lines between points [N, N m].
    constraint_forces: np.ndarray | None = _array("constraints", record="forces", mean=True)
    joint_forces: np.ndarray | None = _array("joints", 3, record="forces", mean=True)
    contact_forces: np.ndarray | None = _array("contacts", 2, record="forces", mean=True)
    line_forces: np.ndarray | None = _array("lines", record="forces", mean=True)
    #: At its end, for schemes whose forces are not at mid-step: forces of added virtual works, and
    #: of driven columns without the inertia of what they alone move.
    added_forces: np.ndarray | None = _array("added dofs")
    driven_forces: np.ndarray | None = _array("kept driven")
    #: Parameters in functions of the user.
    parameters: np.ndarray | None = _array("parameters", record="always")
    #: Work and dissipated energy since the start [J].
    work: float = 0.0
    dissipated: float = 0.0
    #: Part of it that the scheme took, and energy that the scheme holds for the next step [J].
    numerical: float = 0.0
    algorithmic: float = 0.0
    #: The configuration at the start of the step that ended here, only for schemes that need it;
    #: the length of this step, and of the one before [s].
    q_previous: np.ndarray | None = _array("kept dofs")
    length: float = 0.0
    length_before: float = 0.0
    #: Internal variables at the Gauss points, and of the springs of joints in their order.
    internal: np.ndarray | None = _array("cells", "points", "variables", record="motion")
    spring_internal: np.ndarray | None = _array("spring variables", record="motion")
    #: Natural strains (axial, shear, curvature) at the Gauss points.
    natural: np.ndarray | None = _array("cells", "points", "natural strains", record="motion")

    def memory(self, length: float) -> float:
        """`Step.memory` of a step of this length [s] from here."""
        return min(1.0, length / self.length) if self.length else 0.0


@dataclass
class State(SteppedState):
    """The system at one time, and what the next run needs from the last one."""

    #: Memory of `Halving` (5,): the number of parts of the next steps. Set at the end of a run.
    parts: np.ndarray | None = _kept(5, default=None)
    #: Set at the end of a run: the past, and the values of the inputs in the scene's order.
    past: Past | None = None
    #: Rates of driven motions (driven,) at the end of a run; they may jump there.
    driven_rates: np.ndarray | None = _kept("driven", default=None)
    inputs: np.ndarray | None = _kept("inputs", default=None)
    #: The name of the input of each of these values.
    input_names: np.ndarray | None = _kept("inputs", default=None)
    #: Energy since the start that changes of the scene took from velocities [J].
    impact: float = _kept(default=0.0)
    #: Set at the end of a run: rates (size,) that fit the joints, if those of steps do not, and the
    #: joints and supports of the scene, as `constraints_of` gives them.
    fitted: np.ndarray | None = _kept("nodes", 3, default=None)
    constraints: Constraints | None = None
    #: Set at the end of a path of equilibria: its dead loads (size,) [N, N m].
    loads: np.ndarray | None = _kept("nodes", 3, default=None)
    #: Set at the end of a run: what the variables of `spring_internal` belong to, as texts.
    owners: np.ndarray | None = _kept("spring variables", default=None)
    #: Of an equilibrium: the number of modes that grow, if it is known, and of negative pivots of
    #: the factors of its step, which changes where the former may.
    unstable_modes: int | None = None
    negative_pivots: int | None = None

    def changed(self, **values: Any) -> State:
        """The state with other values; far quicker than `dataclasses.replace`."""
        new = object.__new__(type(self))
        new.__dict__.update(self.__dict__, **values)
        return new

    def released(self) -> State:
        """The state without what a scheme holds for the next step: its energy is lost."""
        losses = {
            part: getattr(self, part) + self.algorithmic for part in ("dissipated", "numerical")
        }
        return self.changed(q_previous=None, length=0.0, algorithmic=0.0, **losses)

    @property
    def at_nodes(self) -> dict[str, np.ndarray]:
        """Arrays at all nodes by name."""
        return {name: array for name in AT_NODES if (array := getattr(self, name)) is not None}

    def reshaped(self, *shape: int) -> State:
        """The state with copies of arrays of degrees of freedom of a shape: (-1, 3) or (-1,)."""
        past = self.past
        if past is not None and len(D := past.differences):
            past = replace(past, differences=np.array(D).reshape(len(D), *shape))
        new = {name: array.copy().reshape(shape) for name, array in self.at_nodes.items()}
        return self.changed(**new, past=past)


#: The arrays and numbers of the state by name; forces that are means over the step so far.
ARRAYS: dict[str, StateArray] = {
    part.name: part.metadata["quantity"]
    for part in fields(SteppedState)
    if "quantity" in part.metadata
}
#: Arrays that have an entry for each degree of freedom.
AT_NODES = *(name for name, array in ARRAYS.items() if array.at_nodes), "fitted", "loads"
NUMBERS = tuple(part.name for part in fields(SteppedState) if part.type == "float")
FORCES = tuple(name for name, quantity in ARRAYS.items() if quantity.mean)
#: What a record has of the state at the end of a step, and of its sums.
ROWS = {name: quantity for name, quantity in ARRAYS.items() if quantity.record} | {
    "energies": StateArray((8,), "always"),
    "momenta": StateArray((3,), "always"),
}
#: Members of the state in C, as macros of c/work.h.
MACROS = (
    f"STATE_NUMBERS {', '.join(NUMBERS)}",
    f"STATE_ARRAYS {', '.join(f'*{name}' for name in ARRAYS)}",
)


class History(NamedTuple):
    """Rows (n, ...) over time; `Solution` says what they are."""

    #: Lengths of a row, by their names or as they are.
    shape: tuple[str | int, ...]
    #: What of a `Record` selects it; "always" if it cannot be omitted.
    record: str = "always"
    #: Whether it is "linear" between steps, or that of the "step"; "" if neither.
    between: str = ""
    #: Its value where there is nothing, in one of two motions that are joined.
    nothing: float = 0.0


#: The histories by name.
HISTORIES: dict[str, History] = {
    "t": History(()),
    "t_level": History((), between="step"),
    "q": History(("nodes", 3), "motion"),
    "v": History(("nodes", 3), "rates"),
    "a": History(("nodes", 3), "rates", "step"),
    "reactions": History(("nodes", 3), "forces", "step"),
    "motor_forces": History(("joints",), "forces", "step"),
    "linear_momentum": History((2,), between="linear"),
    "angular_momentum": History((), between="linear"),
    "slides": History(("joints",), between="linear", nothing=np.nan),
    "joint_forces": History(("joints", 3), "forces", "step"),
    "contact_forces": History(("contacts", 2), "forces", "step"),
    "line_forces": History(("lines",), "forces", "step"),
    "parameters": History(("parameters",), between="linear", nothing=np.nan),
}
