"""Validate the docstrings of all public objects with numpydoc, by the rules in pyproject.toml.

`numpydoc lint` reads the sources only: it does not know the parameters of a dataclass, nor that a
property needs no Returns section. Therefore the package is imported and its objects are validated.
"""

import inspect
import sys
import tomllib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Protocol

from numpydoc.validate import get_validation_checks, validate

import fx_beam
from fx_beam import fenicsx
from fx_beam_studies import stability, work_precision

MODULES = (fx_beam, fenicsx, stability, work_precision)
DESCRIPTORS = (property, cached_property, classmethod, staticmethod)


def public() -> Iterator[str]:
    """Names of the exported functions and classes, and of the classes' methods and properties."""
    for module, exported in [(m, name) for m in MODULES for name in m.__all__]:
        name, thing = f"{module.__name__}.{exported}", getattr(module, exported)
        if not callable(thing):
            continue
        if Protocol not in getattr(thing, "__bases__", ()):  # documented by its call
            yield name
        if not inspect.isclass(thing):
            continue
        for attribute, member in vars(thing).items():
            own = inspect.isfunction(member) or isinstance(member, DESCRIPTORS)
            # Documented in a base class already.
            known = any(hasattr(base, attribute) for base in thing.__mro__[1:])
            if own and not known and not attribute.startswith("_"):
                yield f"{name}.{attribute}"


def main() -> int:
    root = Path(__file__).resolve().parents[1]
    settings = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]
    checks = get_validation_checks(set(settings["checks"]))
    objects = errors = 0
    for name in public():
        objects += 1
        result = validate(name)
        for code, message in result["errors"]:
            if code in checks:
                errors += 1
                print(f"{result['file']}:{result['file_line']}: {name}: {code} {message}")
    print(f"{objects} public objects, {errors} errors")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
