"""Notebooks: jupytext makes a cell of each block of Python in Markdown, and of the text between.

`python docs/extensions/notebooks.py gripper` makes gripper.ipynb of demos/gripper.py, and likewise
of each page in Markdown that is given.
"""

import ast
import re
import sys
from pathlib import Path

import jupytext
from scripts import code_of, without_frame

DEMOS = Path(__file__).parents[2] / "demos"
#: Demos whose pages have a notebook: the first thing that they draw is a solution.
SHOWN = "gripper", "shallow_arch", "slider_crank"
END = """

## The result

```python
numbers, drawn = compute()
report(numbers)
```

```python
fb.plot.interactive(drawn[0])
```
"""


def of_page(markdown):
    """The notebook of a text in Markdown; code that begins with the name of a file is one."""
    markdown = re.sub(r"^# (\w+\.py)$", r"%%writefile \1", markdown, flags=re.MULTILINE)
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    book = jupytext.reads(markdown, "md")
    book.metadata = kernel
    return book


def of_demo(demo):
    """The notebook of a demo, without what makes it a script and draws its pictures."""
    source = demo.read_text(encoding="utf-8")
    title, _, text = ast.get_docstring(ast.parse(source)).partition("\n")
    code = code_of(without_frame(without_frame(source), "def draw("))
    return of_page(f"# {title.rstrip('.')}\n\n{text.strip()}\n\n## Code\n\n{code}{END}")


def write(path, folder):
    """Write the notebook of a demo or page into a folder."""
    book = of_demo(path) if path.suffix == ".py" else of_page(path.read_text(encoding="utf-8"))
    jupytext.write(book, folder / f"{path.stem}.ipynb")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write(Path(name) if name.endswith(".md") else DEMOS / f"{name}.py", Path())
