"""The table of .ci/systems, and the largest differences of the demos' numbers between systems."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

#: Number of differences that are listed.
LARGEST = 5
#: Left out: these depend on the last digits or on the machine.
CHANCE = "seconds", "iterations", "halvings"
#: Paths of runs whose motion differs between machines: the multi-body system, after more than a
#: second. Numbers of the time before that are compared.
CHAOTIC = "multibody/schemes/", "multibody/largest bending moments/", "/Multi-body system/"
KNOWN = "the pulse", "up to 0.7 s"


def leaves(value, path: str = "") -> Iterator[tuple[str, object]]:
    """Numbers and texts of a JSON object by their paths."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, below in items:
            if not any(word in str(key) for word in CHANCE):
                yield from leaves(below, f"{path}/{key}")
    else:
        yield path, value


def numbers(folder: Path) -> dict[str, object]:
    """All numbers of the demos of a system."""
    values = {}
    for summary in sorted((folder / "results").glob("*/summary.json")):
        values |= dict(leaves(json.loads(summary.read_text()), summary.parent.name))
    return values


def lost(numbers: dict) -> set[str]:
    """Paths of the runs that blew up or failed: their end depends on the last digit."""
    ends = "lost at", "failed at"
    return {
        path.rpartition("/")[0]
        for path, value in numbers.items()
        if path.endswith(ends) and value is not None
    }


def differences(ours: dict, theirs: dict) -> list[tuple[float, str]]:
    """Differences relative to the numbers, absolute for those below 1, largest first.

    Chaotic motions are left out, and so are texts, which may contain numbers.
    """
    out, left_out = [], lost(ours) | lost(theirs)
    for path in ours.keys() | theirs.keys():
        a, b = ours.get(path), theirs.get(path)
        if any(path.startswith(f"{run}/") for run in left_out):
            continue
        if any(part in path for part in CHAOTIC) and not path.endswith(KNOWN):
            continue
        if isinstance(a, str) and isinstance(b, str):
            continue
        if not isinstance(a, int | float) or not isinstance(b, int | float):
            out.append((0.0 if a == b else float("inf"), path))
        else:
            out.append((abs(a - b) / max(abs(a), abs(b), 1.0), path))
    return sorted(out, reverse=True)


def seconds(file: Path) -> float:
    """Time from the start of a call to the event that the file records."""
    start, end = map(float, file.read_text().split())
    return end - start


def row(folder: Path) -> dict[str, str]:
    """Results of a system; a question mark if one is missing."""

    def known(value) -> str:
        try:
            return str(value())
        except (OSError, KeyError, ValueError, IndexError):
            return "?"

    def step() -> dict:
        return json.loads((folder / "step").read_text())

    def status(command: str) -> str:
        return "passed" if (folder / f"{command}.status").read_text().strip() == "0" else "failed"

    def tests() -> str:
        said = (folder / "test").read_text()
        return re.findall(r"(\d+ (?:passed|failed|errors?)\b.*?) in \d", said)[-1]

    install = known(lambda: f"{seconds(folder / 'demos'):.0f}")
    return {
        "FFCx": known(lambda: step()["FFCx"]),
        "Python": known(lambda: step()["python"]),
        "NumPy": known(lambda: step()["numpy"]),
        "install [s]": install,
        "disk [MB]": known(lambda: (folder / "megabytes").read_text().strip()),
        "demos [s]": known(
            lambda: f"{seconds(folder / 'demos.end') - seconds(folder / 'demos'):.0f}"
        ),
        "demos": "failed" if (folder / "demos.failed").exists() else "passed",
        "second call [s]": known(lambda: f"{seconds(folder / 'second'):.1f}"),
        "lint": known(lambda: status("lint")),
        "tests": known(tests),
        "solver": known(lambda: step()["solver"]),
        "a step [us]": known(lambda: f"{step()['microseconds']:.2f}"),
    }


def main() -> int:
    folder, suites = Path(sys.argv[1]), sys.argv[2:]
    rows = {suite: row(folder / suite) for suite in suites}
    first = numbers(folder / suites[0])
    print("| |", " | ".join(suites), "|")
    print("|---|" + "---|" * len(suites))
    apart = {suite: differences(first, numbers(folder / suite)) for suite in suites}
    for suite in suites:
        rows[suite]["largest difference"] = f"{apart[suite][0][0]:.1e}" if apart[suite] else "?"
    for name in rows[suites[0]]:
        print(f"| {name} |", " | ".join(rows[suite][name] for suite in suites), "|")
    for suite in suites[1:]:
        print(f"\nNumbers of the demos that differ most from those of {suites[0]}, in {suite}:")
        for size, path in apart[suite][:LARGEST]:
            print(f"  {size:.1e}  {path}")
    good = all(
        facts["demos"] == "passed"
        and facts["solver"].startswith("compiled")
        and "failed" not in facts["lint"] + facts["tests"]
        for facts in rows.values()
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
