"""The histories in a solution: what the constructor takes, files have, and the manual says."""

from __future__ import annotations

from typing import NamedTuple

from .state import ARRAYS


class History(NamedTuple):
    """Rows (n, ...) over time."""

    #: Lengths of a row, by their names or as they are.
    shape: tuple[str | int, ...]
    says: str
    #: What of a `Record` selects it; "always" if it cannot be omitted.
    record: str = "always"
    #: Whether it is "linear" between steps, or that of the "step"; "" if neither.
    between: str = ""


#: The histories by name. Arrays of the state that say what they are follow by themselves.
HISTORIES: dict[str, History] = {
    "t": History((), "Times [s]; in a static solution load factors"),
    "t_level": History(
        (),
        "Times at which the rows of `resultants`, `reaction`, `JointMotion.force` and "
        "`Contact.force` hold [s]: the scheme's level in the step that ends at t[k]. At mid-"
        "step they are means over the whole step, whatever its parts: times the step's length "
        "they are impulses. Otherwise they are values, for a halved step in its last part. Row "
        "0 is the start: reactions and joint forces are zero there or, after "
        "`simulate(start=...)`, those of the last step before",
        between="step",
    ),
    "q": History(("nodes", 3), "Displacements and rotation [m, rad]", "motion"),
    "v": History(("nodes", 3), "Their rates; zero in a static solution", "rates"),
    "a": History(("nodes", 3), "Their accelerations; zero in a static solution", "rates", "step"),
    "reactions": History(
        ("nodes", 3), "Forces and moments of the supports on the nodes [N, N m]", "forces", "step"
    ),
    "motor_forces": History(
        ("joints",), "Forces and moments of the joints' motors [N, N m]", "forces", "step"
    ),
    "linear_momentum": History((2,), "Linear momentum [kg m/s]", between="linear"),
    "angular_momentum": History(
        (), "Angular momentum about the origin [kg m^2/s]", between="linear"
    ),
} | {
    name: History(array.shape, array.says, array.record, "step" if array.mean else "linear")
    for name, array in ARRAYS.items()
    if array.says
}
