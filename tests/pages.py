"""Pages in Markdown, for tests: their Python, and their links."""

import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def text(page):
    return page.read_text(encoding="utf-8")


def blocks(page):
    """The pieces of Python of a page."""
    return re.findall(r"```python\n(.*?)```", text(page), flags=re.DOTALL)


def prose(page):
    """The text of a page without code; of a demo, what its docstrings say."""
    says = text(page)
    if page.suffix == ".py":
        tree = ast.parse(says)
        functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
        says = "\n\n".join(ast.get_docstring(node) or "" for node in [tree, *functions])
    return re.sub(r"```.*?```|`[^`]*`", "", says, flags=re.DOTALL)


def formulas(page):
    """The formulas of a page in LaTeX: those on lines of their own, and those in lines."""
    formulas = re.findall(r"\$\$(.*?)\$\$|\$([^$]+)\$", prose(page), flags=re.DOTALL)
    return [block for block, _ in formulas if block], [inline for _, inline in formulas if inline]


def links(page):
    """Files that a page links to, and the names in them; pictures as well."""
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if not re.match(r"https?:|#|10\.", target):
            file, _, name = target.partition("#")
            yield (page.parent / file).resolve(), name


def headings(page):
    """Headings of a page, as links name them."""
    titles = re.findall(r"^#+ (.*)$", text(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-") for title in titles}


def missing(page):
    """Links of a page that lead nowhere in the repository, as into what is only made from it."""
    lost = []
    for file, name in links(page):
        if not file.is_file() or file.is_relative_to(ROOT / "docs" / "gallery"):
            lost.append(str(file))
        elif file.suffix == ".md":
            lost += [f"{file}#{name}"] if name and name not in headings(file) else []
        elif name:  # as docs/extensions/sources.py finds its line
            definition = rf"^\s*(?:def|class)\s+{name}\b|^\w[\w *]*\b{name}\("
            lost += [] if re.search(definition, text(file), re.MULTILINE) else [f"{file}#{name}"]
    return lost


def run(block, page):
    """Run a piece of Python alone, and give its names; a script that processes import, as such."""
    if "__main__" in block:
        Path("script.py").write_text(block, encoding="utf-8")
        command = [sys.executable, "script.py"]
        print(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        return {}
    names = {"__name__": page.stem}
    exec(compile(block, str(page), "exec"), names)
    return names
