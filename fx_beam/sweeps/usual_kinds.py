"""Kinds of scenes that most scripts have, compiled before a script waits for it."""

from __future__ import annotations

import hashlib
from itertools import product
from pathlib import Path

from fx_beam import c_library, library_cache
from fx_beam.equilibria.statics import static
from fx_beam.laws import schemes
from fx_beam.motions.dynamics import simulate
from fx_beam.scene.joints import Revolute
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Section

from .sweep import sweep

_SCHEMES = "EnergyMomentum", "EnergyDecaying", "GeneralizedAlpha"
_DEGREES = 1, 2, 3
#: The kinds in words.
TEXT = (
    f"static and {', '.join(_SCHEMES)}; degrees {_DEGREES[0]} to {_DEGREES[-1]}; linear sections; "
    "with and without gravity; alone and on hinges"
)
_FILES = "*.py", "*.h", "*.c"


def compile_usual_kinds() -> None:
    """Compile them in several processes; RuntimeError with the first reason if one fails."""
    names = "scheme", "degree", "gravity", "hinged"
    options = ("", *_SCHEMES), _DEGREES, (9.81, 0.0), (False, True)
    rows = sweep(_run, [dict(zip(names, case, strict=True)) for case in product(*options)])
    rows = rows if isinstance(rows, list) else rows.to_dict("records")
    if errors := [row["error"] for row in rows if row["error"]]:
        raise RuntimeError(errors[0])
    name = _name()
    library_cache.loaded(name, library_cache.content, lambda folder: _write(folder / name))


def are_compiled() -> bool:
    """Whether they were compiled by these files of the package, this compiler and its flags."""
    return library_cache.load_cached(_name(), library_cache.content) is not None


def _run(case: dict) -> None:
    """A first call."""
    section = Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene = Scene(gravity=(0, -case["gravity"]))
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=2, degree=case["degree"])
    scene.clamp(beam.start)
    if case["hinged"]:
        arm = scene.add_beam([(1, 0), (2, 0)], section, elements=2, degree=case["degree"])
        scene.add_joint(Revolute(beam.end, arm.start))
        scene.fix(arm.end, "y")
    if case["scheme"]:
        simulate(scene, getattr(schemes, case["scheme"])(), dt=1e-3, t_end=2e-3)
    else:
        static(scene)


def _name() -> str:
    """Name of the file in the cache that is there when all are compiled."""
    package = Path(__file__).parents[1]
    texts = [file.read_bytes() for files in _FILES for file in sorted(package.rglob(files))]
    made_by = " ".join([*c_library.target_flags()[1], c_library.identity()])
    return f"{hashlib.sha256(b''.join([*texts, made_by.encode()])).hexdigest()[:32]}.kinds"


def _write(file: Path) -> bytes:
    file.write_text(TEXT)
    return TEXT.encode()
