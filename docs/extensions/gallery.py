"""A page for each demo: what it says, results, pictures, what it prints, and its code in pieces.

Some have a notebook. The text on the results is in docs/outcomes.

Sphinx-Gallery would want the demos cut into blocks of comments; they are scripts with a docstring
and functions, so that tests can import them. Each is run once, into docs/_build/demos, and again
when it or the package has changed. With FX_BEAM_DOCS=quick none is run, and pages show what is
there: results of earlier builds, those of `./run demos`, or only the pictures in demos/pictures.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import notebooks
from scripts import code_of, without_frame
from sphinx.errors import ExtensionError
from sphinx.util import logging

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "_build" / "demos"
_log = logging.getLogger(__name__)

PAGE = """\
# {title}

{animation}

{text}

## Results

{outcome}

{pictures}

{printed}

## Code

`./run demos {name}` runs `demos/{name}.py`. {notebook} This code can be copied into a file:

{code}

The numbers, and the pictures in the current folder:

```python
from pathlib import Path

numbers, drawn = compute()
report(numbers)
draw(Path(), *drawn)
```
"""


def run(demo):
    """Folder of a demo's results; it runs, unless they are newer than the demo and the package."""
    folder = RESULTS / demo.stem
    if os.environ.get("FX_BEAM_DOCS") == "quick":
        earlier = folder, ROOT / "results" / demo.stem
        return next((past for past in earlier if (past / "printed.txt").exists()), folder)
    printed = folder / "printed.txt"  # the last file that a demo writes
    sources = [demo, *(ROOT / "fx_beam").rglob("*.py"), *(ROOT / "fx_beam").rglob("*.[ch]")]
    newest = max(path.stat().st_mtime for path in sources)
    if printed.exists() and printed.stat().st_mtime > newest:
        return folder
    _log.info("running demos/%s", demo.name)
    command = [sys.executable, str(demo), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ExtensionError(f"demos/{demo.name} failed:\n{done.stderr}")
    return folder


def caption(name):
    """The name of a picture in words, such as "Force and displacement"; a card shows shapes."""
    return name.replace("_", " ").replace("thumbnail", "shapes").capitalize()


def page(demo, folder):
    """Markdown page of a demo, whose pictures are copied beside it."""
    results = run(demo)
    source = demo.read_text(encoding="utf-8")
    title, _, text = ast.get_docstring(ast.parse(source)).partition("\n")
    copies = ROOT / "demos" / "pictures"
    known = [*results.glob("*.png"), *results.glob("*.gif")]
    known = known or [
        path for kind in ("png", "gif") for path in copies.glob(f"{demo.stem}_*.{kind}")
    ]
    # The card is for the gallery: on its page it stands for pictures that are not there.
    pictures = sorted(path for path in known if not path.stem.endswith("thumbnail")) or known
    for picture in pictures:
        shutil.copy(picture, folder / f"{demo.stem}-{picture.name}")
    images = {
        path: f"![{words}]({demo.stem}-{path.name})\n\n*{words}*"
        for path in pictures
        for words in [caption(path.stem.removeprefix(f"{demo.stem}_"))]
    }
    moving = [image for path, image in images.items() if path.suffix == ".gif"]
    still = [image for image in images.values() if image not in moving]
    printed = results / "printed.txt"
    outcome = ROOT / "docs" / "outcomes" / f"{demo.stem}.md"
    notebook = ""
    if demo.stem in notebooks.SHOWN:
        notebooks.write(demo, folder)
        notebook = f"As a [notebook]({demo.stem}.ipynb), with its motion to play."
    return PAGE.format(
        name=demo.stem,
        notebook=notebook,
        title=title.rstrip("."),
        text=text.strip(),
        animation="\n\n".join(moving),
        outcome=outcome.read_text(encoding="utf-8"),
        pictures="\n\n".join(still),
        printed=f"It prints\n\n```text\n{printed.read_text('utf-8').rstrip()}\n```"
        if printed.exists()
        else "",
        code=code_of(without_frame(source)),
    )


def write(app):
    """Write the pages of all demos before Sphinx looks for pages."""
    folder = Path(app.srcdir) / "gallery"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for demo in sorted((ROOT / "demos").glob("*.py")):
        (folder / f"{demo.stem}.md").write_text(page(demo, folder), encoding="utf-8")


def setup(app):
    """Connect to Sphinx."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}
