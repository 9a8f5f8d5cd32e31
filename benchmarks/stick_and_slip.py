"""Which order steps with friction that sticks could have: a block that sticks and slips on a rail.

    .venv/bin/python benchmarks/stick_and_slip.py

The steps are not those of the package: while they stick the spring of friction has its mean force,
so that they are symmetric in time, and what sticks or slips stays so in all sub-steps of a step. It
changes between steps, or where an event is located. Errors are those of the block of
tests/claims/test_stick_and_slip.py after 1 s, with 1e4 N/m.
"""

import sys
from math import copysign, sin
from pathlib import Path

from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests/claims"))

from test_stick_and_slip import FORCE, LIMIT, RATE, SPRING, exact

KT, END = 1e4, 1.0
OUTER = 1 / (4 - 4 ** (1 / 3))
FRACTIONS = {2: (1.0,), 4: (OUTER, OUTER, 1 - 4 * OUTER, OUTER, OUTER)}


def sub_step(y, t, dt, sign):
    """Place, speed and stretch after a step of the mid-point rule; sign 0 sticks."""
    x, v, z = y
    force = FORCE * (sin(RATE * t) + sin(RATE * (t + dt))) / 2 - SPRING * x
    force -= sign * LIMIT if sign else KT * z
    D = (force + 2 * v / dt) / (2 / dt**2 + SPRING / 2 + (0 if sign else KT / 2))
    return x + D, 2 * D / dt - v, z if sign else z + D


def step(y, t, dt, sign, order):
    for fraction in FRACTIONS[order]:
        y = sub_step(y, t, fraction * dt, sign)
        t += fraction * dt
    return y


def before_event(y, sign):
    """Positive before what sticks begins to slip, or what slips to stick."""
    return sign * y[1] if sign else LIMIT - KT * abs(y[2])


def end_of(dt, order, locate):
    """Place at the end, and the least that friction takes in a step."""
    y, t, sign, least = (0.0, 0.0, 0.0), 0.0, 0, 0.0
    while t < END - 1e-12:

        def behind(length, y=y, t=t, sign=sign):
            return before_event(step(y, t, length, sign, order), sign)

        length, begins = min(dt, END - t), 1e-9 * dt
        switches = behind(length) < 0
        if locate and switches and behind(begins) > 0:
            length = brentq(behind, begins, length, xtol=1e-15, rtol=1e-14)
        new = step(y, t, length, sign, order)
        least = min(least, sign * LIMIT * (new[0] - y[0]))
        t += length
        if switches:
            stretch = (sign or copysign(1, new[2])) * LIMIT / KT
            # Not again at the limit that it has just left.
            new = (*new[:2], stretch * (1 - 1e-13) if sign or locate else new[2])
            sign = 0 if sign else int(copysign(1, new[2]))
        y = new
    return y[0], least


def main():
    x, _ = exact(KT, END)
    print("order   events    dt [ms]     error [m]   least loss in a step [J]")
    for order in FRACTIONS:
        for locate in (False, True):
            for dt in (4e-3, 2e-3, 1e-3, 5e-4):
                end, least = end_of(dt, order, locate)
                events = "located" if locate else "at ends"
                print(f"{order:5}   {events} {1e3 * dt:9g} {abs(end - x):13.2e} {least:14.1e}")


if __name__ == "__main__":
    main()
