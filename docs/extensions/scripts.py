"""The script of a demo as Markdown: its code in pieces, each after the text of its function."""

import ast
import re

# Statements of a demo that start it as a script, or draw its card in the gallery.
_FRAME = "from shared import", "thumbnail.", "if __name__"


def without_frame(source, frame=_FRAME):
    """The script without statements that begin so: code that can be copied."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt) and ast.unparse(node).startswith(frame):
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    return re.sub("\n{4,}", "\n\n\n", "\n".join(lines))


def _start(node, lines):
    """Index of a definition's first line, decorators and the comments before it included."""
    decorators = getattr(node, "decorator_list", [])
    first = min(part.lineno for part in (node, *decorators)) - 1
    before = first
    while before and (not lines[before - 1] or lines[before - 1].startswith("#")):
        before -= 1
    return before if any(lines[before:first]) else first


def pieces(source):
    """The code of a script without its docstrings, each function after what it says."""
    tree, lines = ast.parse(source), source.splitlines()
    starts = [_start(node, lines) for node in tree.body[1:]]
    text, code = "", []
    for node, start, end in zip(tree.body[1:], starts, [*starts[1:], len(lines)], strict=True):
        says = ast.get_docstring(node) if isinstance(node, ast.FunctionDef) else None
        if says:
            yield text, code
            text, first = f"**{node.name}**: {says}", node.body[0]
            code = lines[start : first.lineno - 1] + lines[first.end_lineno : end]
        else:
            code = [*code, *lines[start:end]]
    yield text, code


def code_of(source):
    """Markdown of the pieces."""
    blocks = ((text, "\n".join(code).strip("\n")) for text, code in pieces(source))
    return "\n\n".join(f"{text}\n\n```python\n{code}\n```" for text, code in blocks if code)
