"""Solutions as files."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict

import numpy as np

from fx_beam.scene.beam import COMPONENTS, Node

from .files import writable

#: Format of saved files, and the arrays in them that bear their own name.
FORMAT = "fx_beam solution 1"
HISTORIES = (
    "t",
    "t_level",
    "X",
    "q",
    "v",
    "a",
    "reactions",
    "slides",
    "joint_forces",
    "motor_forces",
    "linear_momentum",
    "angular_momentum",
)


def save(solution, path) -> None:
    """Write a solution in NumPy's npz format: arrays and a JSON text, no pickled objects.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write.
    """
    path = writable(path)
    arrays = {name: getattr(solution, name) for name in HISTORIES}
    arrays |= {f"energy_{name}": value for name, value in vars(solution.energy).items()}
    if solution.end is not None:
        known = {name: value for name, value in vars(solution.end).items() if value is not None}
        past = known.pop("past", None)
        arrays |= {f"end_{name}": value for name, value in known.items()}
        arrays |= {f"past_{name}": value for name, value in vars(past).items()} if past else {}
    beams: list[dict] = []
    for name, beam in solution.beams.items():
        key = f"beam{len(beams)}"
        if solution.has_motion:
            found = vars(solution.resultants(name))
            arrays |= {f"{key}_{part}": value for part, value in found.items()}
        arrays[f"{key}_nodes"] = solution.nodes_of_beam[name]
        beams.append({"name": name, "degree": beam.degree, "s": beam.s.tolist()})
    meta = {"format": FORMAT, "stats": asdict(solution.stats), "beams": beams}
    with open(path, "wb") as file:
        np.savez_compressed(file, meta=np.array(json.dumps(meta)), **arrays)


def to_csv(solution, path, nodes: dict[str, Node]) -> None:
    """Write energies, momenta and the motion of some nodes as comma-separated columns.

    What was not recorded is left out.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write; its first row names the columns.
    nodes : dict
        Nodes by the names that their columns shall have.
    """
    path = writable(path)
    if not isinstance(nodes, dict):
        raise ValueError(
            f"nodes = {nodes!r} must be a dict of nodes by the names of their columns, such as "
            "{'tip': beam.end}"
        )
    columns = {"load factor" if solution.stats.static else "t": solution.t}
    columns |= {f"energy {name}": value for name, value in vars(solution.energy).items()}
    columns["energy total"] = solution.energy.total
    columns["energy balance error"] = solution.energy.balance_error
    columns["linear momentum x"], columns["linear momentum y"] = solution.linear_momentum.T
    columns["angular momentum"] = solution.angular_momentum
    for label, node in nodes.items():
        parts: dict = {}
        if solution.has_motion:
            parts[""] = *solution.position(node).T, solution.rotation(node)
        if solution.has_rates:
            parts[" rate"] = *solution.velocity(node).T, solution.spin(node)
        for i, component in enumerate(COMPONENTS):
            for kind, values in parts.items():
                columns[f"{label} {component}{kind}"] = values[i]
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
