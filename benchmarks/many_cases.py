"""Time, memory and file of a sweep over very many cases, and of its continuation.

    .venv/bin/python benchmarks/many_cases.py [number of cases]

The function does nothing, so that what is measured is the sweep's own part. The cases come from a
generator, the table comes in chunks of 10 000 rows, and each row is in the file. Then the same call
is made again: it computes nothing and reads the rows. Times are those of the processor in this
process; the memory is its peak, in which 0.1 GB are the imported packages.
"""

import resource
import sys
import tempfile
from pathlib import Path
from time import process_time

import fx_beam as fb

CHUNK = 10_000


def nothing(case):
    """Two numbers, as a simulation may give."""
    return {"x": case["stiffness"] / 3, "y": case["speed"] / 3}


def cases(number):
    """Cases that are made when they are needed."""
    return ({"stiffness": 1.0 + k / number, "speed": float(k)} for k in range(number))


def measured(number, results):
    """Processor time [s] and peak memory [GB] of a sweep whose tables are not kept."""
    clock, rows = process_time(), 0
    for table in fb.sweep(nothing, cases(number), 1, results, chunksize=CHUNK):
        rows += len(table)
    assert rows == number
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return process_time() - clock, peak


def main(number=100_000):
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "rows.jsonl"
        for name in "first call", "continued":
            seconds, peak = measured(number, results)
            size = results.stat().st_size / 1e6
            print(f"{name}: {number} cases, {seconds:.1f} s, {peak:.2f} GB, file {size:.0f} MB")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
