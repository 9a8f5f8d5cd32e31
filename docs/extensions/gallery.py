"""A page for each demo: what it says, the pictures it draws, what it prints, and its code.

Sphinx-Gallery would want the demos cut into blocks of comments; they are scripts with a docstring
and functions, so that tests can import them. Each is run once, into docs/_build/demos, and again
when it or the package has changed. With FX_BEAM_DOCS=quick none is run, and pages show what is
there.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

from sphinx.errors import ExtensionError
from sphinx.util import logging

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "_build" / "demos"
_log = logging.getLogger(__name__)

PAGE = """\
# {title}

{animation}

{text}

## Pictures

{pictures}

## What it prints

```text
{printed}
```

## Code

`demos/{name}.py`, run by `./run demos {name}`.

```{{literalinclude}} ../../demos/{name}.py
:language: python
```
"""


def run(demo):
    """Run a demo, unless what it wrote is newer than itself and the package."""
    results = RESULTS / demo.stem
    printed = results / "printed.txt"
    sources = [demo, *(ROOT / "fx_beam").rglob("*.py"), *(ROOT / "fx_beam").rglob("*.[ch]")]
    newest = max(path.stat().st_mtime for path in sources)
    if os.environ.get("FX_BEAM_DOCS") == "quick" or (
        printed.exists() and printed.stat().st_mtime > newest
    ):
        return results
    _log.info("running demos/%s", demo.name)
    command = [sys.executable, str(demo), str(results)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ExtensionError(f"demos/{demo.name} failed:\n{done.stderr}")
    printed.write_text(done.stdout, encoding="utf-8")
    return results


def page(demo, folder):
    """Markdown page of a demo, whose pictures are copied beside it."""
    results = run(demo)
    text = ast.get_docstring(ast.parse(demo.read_text(encoding="utf-8")))
    title, _, text = text.partition("\n")
    pictures = sorted(results.glob("*.png")) + sorted(results.glob("*.gif"))
    if not pictures:
        pictures = sorted((ROOT / "demos" / "pictures").glob(f"{demo.stem}_*.png"))
    for picture in pictures:
        shutil.copy(picture, folder / f"{demo.stem}-{picture.name}")
    images = {
        path: f"![{path.stem.replace('_', ' ')}]({demo.stem}-{path.name})" for path in pictures
    }
    moving = [image for path, image in images.items() if path.suffix == ".gif"]
    still = [image for image in images.values() if image not in moving]
    printed = results / "printed.txt"
    return PAGE.format(
        name=demo.stem,
        title=title.rstrip("."),
        text=text.strip(),
        animation="\n\n".join(moving),
        pictures="\n\n".join(still),
        printed=printed.read_text("utf-8").rstrip() if printed.exists() else "not run yet",
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
