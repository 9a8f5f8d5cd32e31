"""Start of all demos, and places of their numbers and pictures.

A demo is a module with three functions: `compute` returns its numbers and what is drawn,
`report` prints the numbers, and `draw` writes the pictures.
"""

import json
import logging
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path


def main(demo, results=None, **options):
    """Compute and print the numbers of a demo; with a folder for results, write them and pictures.

    The options are those of the demo's `compute`.
    """
    numbers, drawn = demo.compute(**options)
    with redirect_stdout(StringIO()) as report:
        demo.report(numbers)
    print(report.getvalue(), end="")
    if results is not None:
        results.mkdir(parents=True, exist_ok=True)
        (results / "summary.json").write_text(json.dumps(numbers, indent=2) + "\n")
        demo.draw(results, *drawn)
        (results / "printed.txt").write_text(report.getvalue(), encoding="utf-8")
    return numbers


def run(level="WARNING"):
    """Run the demo that was started as a script; its argument is another folder for results.

    It prints what the demo is, its runs, its report, and the names of the pictures. The level is
    that of the package's own messages.
    """
    logging.basicConfig(format="%(message)s", force=True)
    logging.getLogger("fx_beam").setLevel(level)
    logging.getLogger("fx_beam.demo").setLevel("INFO")
    demo = sys.modules["__main__"]
    print((demo.__doc__ or "").partition("\n")[0], flush=True)
    here = Path(demo.__file__).resolve()
    folder = Path(sys.argv[1]) if sys.argv[1:] else here.parents[1] / "results" / here.stem
    main(demo, folder)
    pictures = {path.name for path in folder.iterdir() if path.suffix in (".gif", ".png")}
    print(f"pictures in {folder}:", *sorted(pictures - {"thumbnail.png"}))
