"""Pages that show the project's own files, and links to them.

In a Markdown page `[strains](../../fx_beam/laws/kinematics.py#strains)` leads to the
definition in the page of that file; in the repository it leads to the file. So does
`demos/ring.py` in code font. A link `[ring](../demos/ring.py)` leads to its page in the gallery.
"""

import functools
import inspect
import re
import sys
from pathlib import Path

from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_for_filename

ROOT = Path(__file__).parents[2]
FOLDERS = "fx_beam", "demos", "benchmarks", "tests"
_FILE = rf"((?:{'|'.join(FOLDERS)})/[\w/]+\.(?:py|c|h))"
_LINK = re.compile(rf"\[([^\]]*)\]\((?:\.\./)+{_FILE}(?:#(\w+))?\)")
_DEMO = re.compile(r"\]\((?:\.\./)+demos/(\w+)\.py\)")
_NAME = re.compile(rf"`{_FILE}`")
#: Files to which a page links.
_linked = set()


@functools.cache
def files():
    """Paths of all files that may be shown, from the root of the project."""
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
    return {str(p.relative_to(ROOT)) for p in paths if p.suffix in (".py", ".c", ".h")}


def line_of(file, name):
    """Line in which a function or class is defined; None where there is none of that name."""
    definition = re.compile(rf"\s*(?:def|class)\s+{name}\b|\w[\w *]*\b{name}\(")
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    return next((n for n, line in enumerate(lines, 1) if definition.match(line)), None)


def place(page, file, name=None):
    """Link from a page to a file, and to the definition of a name in it."""
    _linked.add(file)
    line = line_of(file, name) if name else None
    return f"{'../' * page.count('/')}source/{file}.html" + (f"#line-{line}" if line else "")


def place_of(domain, info):
    """Link from the pages in `interface` to the source of what they document."""
    thing = sys.modules.get(info["module"])
    for part in info["fullname"].split("."):
        thing = getattr(thing, part, None)
    thing = getattr(thing, "fget", None) or getattr(thing, "func", None) or thing
    try:
        file = Path(inspect.getsourcefile(thing)).relative_to(ROOT)
        line = inspect.getsourcelines(thing)[1]
    except (TypeError, ValueError, OSError):
        return None
    return f"../source/{file}.html#line-{line}"


def _link(app, page, text):
    def named(match):
        label, file, name = match.groups()
        return f'<a href="{place(page, file, name)}">{label}</a>' if file in files() else match[0]

    def mentioned(match):
        file = match[1]
        return f'<a href="{place(page, file)}">{match[0]}</a>' if file in files() else match[0]

    text[0] = _DEMO.sub(rf"]({'../' * page.count('/')}gallery/\1.md)", text[0])
    if "```{eval-rst}" not in text[0]:
        text[0] = _LINK.sub(named, text[0])
        if page != "changelog":
            text[0] = re.sub(rf"(?<!\[){_NAME.pattern}(?!\]|</a>)", mentioned, text[0])


def _pages(app):
    look = HtmlFormatter(linenos="inline", lineanchors="line", anchorlinenos=True, wrapcode=True)
    for file in sorted(f for f in files() if f in _linked or f.startswith("fx_beam/")):
        text = (ROOT / file).read_text(encoding="utf-8")
        code = highlight(text, get_lexer_for_filename(file), look)
        title = f"<code>{file}</code>"
        yield f"source/{file}", {"title": file, "body": f"<h1>{title}</h1>{code}"}, "page.html"


def setup(app):
    """Connect to Sphinx."""
    app.connect("source-read", _link)
    app.connect("html-collect-pages", _pages)
    return {"parallel_read_safe": True}
