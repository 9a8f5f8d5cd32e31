"""Solutions as files that are read again."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, fields

import numpy as np

from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.obstacles import Obstacle

from .files import replacing
from .state import HISTORIES

#: Format of saved files.
FORMAT = "fx_beam solution 2"


def save(solution, path) -> None:
    """Write the solution to a file that `fx_beam.load` reads.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write, in NumPy's npz format: arrays and a JSON text, no pickled objects.
    """
    arrays = {name: getattr(solution, name) for name in ("X", *HISTORIES)}
    arrays |= {f"energy_{name}": value for name, value in vars(solution.energy).items()}
    if solution.end is not None:
        known = {name: value for name, value in vars(solution.end).items() if value is not None}
        past = known.pop("past", None)
        arrays |= {f"end_{name}": value for name, value in known.items()}
        arrays |= {f"past_{name}": value for name, value in vars(past).items()} if past else {}
    if solution.stats.static:
        arrays |= _stability(solution)
    beams: list[dict] = []
    if solution.beams:
        arrays |= _of_all_beams(solution)
    for name, beam in solution.beams.items():
        internal = solution.variables_of_beam.get(name, {})
        arrays |= {
            f"beam{len(beams)}_internal{i}": rows for i, rows in enumerate(internal.values())
        }
        item = {"name": name, "degree": beam.degree, "s": beam.s.tolist()}
        if beam.fractions is not None:
            item["fractions"] = beam.fractions.tolist()
        beams.append({**item, "internal": list(internal)})
    joints = {number: list(variables) for number, variables in solution.variables_of_joint.items()}
    for number, variables in solution.variables_of_joint.items():
        arrays |= {f"joint{number}_internal{i}": rows for i, rows in enumerate(variables.values())}
    for number, variables in solution.variables_of_contact.items():
        arrays[f"contact{number}_friction"] = variables
    stats = asdict(solution.stats)
    bodies = [
        {
            **{name: getattr(body, name) for name in ("name", "mass", "inertia")},
            "centre": body.centre.number,
            "points": {name: node.number for name, node in body.points.items()},
        }
        for body in solution.bodies.values()
    ]
    meta = {"format": FORMAT, "stats": stats, "beams": beams, "joints": joints, "bodies": bodies}
    meta["parameters"] = solution.names_of_parameters
    meta["obstacles"] = [_described(obstacle) for obstacle in solution.obstacles]
    text = json.dumps(meta, default=_plain)
    arrays = {"meta": np.array(text), **arrays}
    with replacing(path) as new, open(new, "wb") as raw:
        file = zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        try:
            for name, values in arrays.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as part:
                    np.lib.format.write_array(part, np.asarray(values), allow_pickle=False)
            file.close()
        except BaseException:
            file.fp = None  # it would complain of a part that Ctrl-C has left open
            raise


def _of_all_beams(solution) -> dict[str, np.ndarray]:
    """Nodes and resultants, those of each beam after those of the one before: few arrays."""
    arrays = {"nodes": [solution.nodes_of_beam[name] for name in solution.beams]}
    if solution.has_motion:
        parts = [vars(solution.resultants(name)) for name in solution.beams]
        arrays |= {name: [own[name] for own in parts] for name in parts[0]}
    return {f"beams_{name}": np.concatenate(own, axis=-1) for name, own in arrays.items()}


def _stability(solution) -> dict[str, np.ndarray]:
    """Numbers of unstable modes, if they can be found."""
    try:
        return {"unstable_modes": solution.unstable_modes}
    except ValueError:
        return {}


def _plain(value):
    """A number of NumPy as JSON has it."""
    if isinstance(value, np.generic):
        return value.item()
    raise ValueError(f"cannot save {value!r:.80}, a {type(value).__name__}: JSON does not know it")


def _described(obstacle: Obstacle) -> dict:
    """An obstacle in plain values; a node by its number, a beam by its name."""
    target, shape = obstacle.target, obstacle.shape
    parts: dict = {"beam": shape.name} if isinstance(shape, Beam) else {}
    if not parts:
        parts = {field.name: getattr(shape, field.name) for field in fields(shape)}
    return {
        "on": target.name if isinstance(target, Beam) else target.number,
        "kind": type(obstacle.shape).__name__,
        "shape": {
            name: part.number if isinstance(part, Node) else part for name, part in parts.items()
        },
        "stiffness": obstacle.stiffness,
        "restitution": obstacle.restitution,
        "speed": obstacle.speed,
        "radius": obstacle.radius,
        "along": obstacle.along,
        "number": obstacle.number,
        "friction": None if obstacle.friction is None else asdict(obstacle.friction),
    }
