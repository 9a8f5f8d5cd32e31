"""The core uses every public name and measures every quantity: a new one must enter it."""

import ast
import re
from pathlib import Path

import pytest

import fx_beam as fb

TREES = [
    ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    for path in Path(__file__).parent.glob("*.py")
]
NODES = [node for tree in TREES for node in tree]


def test_every_public_name_is_used():
    used = {
        node.attr
        for node in NODES
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", None) == "fb"
    }
    assert set(fb.__all__) <= used, sorted(set(fb.__all__) - used)


def test_every_quantity_is_measured():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    texts = {node.value for node in NODES if isinstance(node, ast.Constant)}
    for part in (scene, beam, beam.end, fb.Revolute(fb.GROUND, beam.end)):
        with pytest.raises(fb.SceneError) as refused:
            fb.Output("?", part)
        (known,) = re.findall(r"one of \[(.*?)\]", str(refused.value))
        names = set(re.findall(r"'(\w+)'", known))
        assert names and not names - texts
        assert all(re.search(rf'"{name}"\s+\[', fb.Output.__doc__) for name in names)
