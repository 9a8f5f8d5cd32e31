"""Compiled forms and expressions, in the cache by keys that are known before anything is in UFL.

FFCx makes a text in C of what is written in UFL, once. Beside it are the names of its fields, which
is all that a process needs to know. Functions of one element are compiled where they are called.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from fx_beam import c_library, compiler, library_cache
from fx_beam.c_library import compiled
from fx_beam.content_cache import cached_property
from fx_beam.symbolic import Written

# Vector instructions of a single law or element would read pairs of numbers that were just written
# one by one, for which processors wait long. The loop computes several elements at once instead.
_FLAGS = "-O2", "-fno-tree-slp-vectorize"
# Where all that becomes a form is written.
_PACKAGE = Path(__file__).parents[1]
_WRITERS = "laws/*.py", "fem/*.py", "scene/law.py"


class CompiledForm(NamedTuple):
    """A form or an expression that was compiled for all meshes of its kind."""

    name: str
    module: FormModule
    #: Names of its coefficients and constants, in the order of its code.
    coefficients: list[str]
    constants: list[str]
    #: Number of arguments of a form, and of values of an expression.
    arguments: int
    values: int
    #: Subdomain (-1: all cells) and name in C of each function.
    functions: list[tuple[int, str]]

    @property
    def tags(self) -> list[int]:
        """Subdomain of each integral (-1: all cells)."""
        return [tag for tag, _ in self.functions]

    @property
    def addresses(self) -> list[int]:
        """Addresses of the functions of one element, one for each integral."""
        return [self.module.addresses[name] for _, name in self.functions]


class FormModule:
    """Forms whose code is one text in C, by name."""

    def __init__(self, key: str, content: Mapping[str, Any]):
        #: Identifier of the text.
        self.key = key
        #: What it includes, the text, and the number of arguments of its functions.
        self.header, self.source = content["header"], content["source"]
        self.arguments = content["arguments"]
        #: What else was written of them.
        self.facts = content["facts"]
        self.forms = {
            name: CompiledForm(name, self, **form) for name, form in content["forms"].items()
        }
        #: Functions for several elements at once, by what was asked for.
        self.batches: dict[tuple[str, ...], c_library.Functions] = {}

    @cached_property
    def addresses(self) -> dict[str, int]:
        """Addresses of the functions of one element, by their names in C."""
        title, text = " and ".join(map(repr, self.forms)), self.header + self.source
        names = [name for form in self.forms.values() for _, name in form.functions]
        self._functions = c_library.functions_of(title, text, lambda: text, names, _FLAGS)
        return dict(zip(names, self._functions, strict=True))


def form_module(key: object, write: Callable[[], Written]) -> FormModule:
    """The forms of a key, which are written if they are not in the cache.

    Without a key they are written in any case, and signed: functions of a user may have changed.
    """
    if key is not None:
        return compiled((FormModule, key), lambda: _loaded(key, write))
    from . import ffcx_api

    written = write()
    key = ffcx_api.signature(written)
    return compiled((FormModule, key), lambda: _loaded(key, lambda: written), user_defined=True)


def _loaded(key: object, write: Callable[[], Written]) -> FormModule:
    origin = compiled((_origin,), _origin)
    name = hashlib.sha256(repr((key, origin)).encode()).hexdigest()[:32]
    file = f"{name}.forms"

    def loader(path: Path) -> dict:
        return json.loads(library_cache.content(path))

    def builder(folder: Path) -> dict:
        from . import ffcx_api

        compiler.check()
        content = ffcx_api.generated(write(), name)
        (folder / file).write_text(json.dumps(content))
        return content

    return FormModule(name, library_cache.loaded(file, loader, builder))


def _origin() -> tuple:
    """Digest of the files in which forms are written, and the places of UFL and FFCx."""
    texts = (path.read_bytes() for pattern in _WRITERS for path in sorted(_PACKAGE.glob(pattern)))
    specs = [find_spec(name) for name in ("ufl", "basix", "ffcx")]
    places = [Path(spec.origin) for spec in specs if spec is not None and spec.origin]
    installed = [(str(place), place.stat().st_mtime_ns) for place in places]
    return hashlib.sha256(b"".join(texts)).hexdigest(), installed
