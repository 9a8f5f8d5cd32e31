"""Derivatives through reversals of slip: with the time of the reversal, and of the steps alone.

    .venv/bin/python benchmarks/reversals.py

The block of tests/claims/test_slip_reversals.py, which slips against a push and back, and the
forced oscillator of Den Hartog in tests/claims/test_periodic_response.py. Largest errors of
derivatives by mu, relative to the closed form of rigid friction, at seven values of mu.
"""

import sys
from pathlib import Path

import fx_beam as fb
from fx_beam.step import tape_derivatives

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests/claims"))

from test_periodic_response import dry_friction
from test_slip_reversals import derivatives, on_slide

FEW = tape_derivatives._FEW


def main():
    for few, what in ((0, "of the steps alone"), (FEW, "with the time of the reversal")):
        tape_derivatives._FEW = few
        print(f"Derivatives {what}")
        for stiffness in (1e4, 1e5, 1e6, 1e7, 1e8):
            row = []
            for dt in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4):
                place, rate = derivatives(on_slide, dt, lambda mu, k=stiffness: fb.Coulomb(mu, k))
                row.append(f"{place:8.1e} {rate:8.1e}")
            print(f"  {stiffness:8g} N/m, place and rate:", ", ".join(row))
        for steps in (201, 401, 801):
            _, place, jacobian = dry_friction(1e7, steps)
            print(f"  forced, {steps} steps: {jacobian[place[:, 0].argmax(), 0].round(4)}")
    print("Errors of the rate for 1e6 N/m, of the steps alone and with the time of the reversal")
    for dt in (1e-3, 5e-4, 2.5e-4, 1.2e-4, 6e-5):
        errors = []
        for few in (0, 1000):
            tape_derivatives._FEW = few
            errors.append(derivatives(on_slide, dt, lambda mu: fb.Coulomb(mu, 1e6))[1])
        print(f"  {dt:g} s: {errors[0]:.1e} {errors[1]:.1e}")


if __name__ == "__main__":
    main()
