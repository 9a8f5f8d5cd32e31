"""Reading of saved solutions."""

from __future__ import annotations

import itertools
import json
from dataclasses import fields
from typing import Any, BinaryIO

import numpy as np

from fx_beam.errors import Failure
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.body import Body
from fx_beam.scene.coordinate import Coulomb
from fx_beam.scene.obstacles import Obstacle, Shape

from .audit import BeamResultants, Energy, Stats
from .export import FORMAT
from .files import named
from .histories import HISTORIES
from .saved_arrays import check_arrays
from .solution import Solution
from .stability import Stability
from .state import NUMBERS, Past, State

# Format of earlier files, with arrays of each beam.
_BY_BEAM = "fx_beam solution 1"


def load(path) -> Solution:
    """Read a solution that `Solution.save` wrote; no code in the file is run.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Solution
        The solution. Its beams are in `Solution.beams`, by name.

    Raises
    ------
    ValueError
        If the file is not a saved solution, or is damaged.

    Examples
    --------
    >>> import tempfile, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> scene.clamp(scene.add_beam([(0, 0), (1, 0)], section, name="arm").start)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fb.simulate(scene, dt=0.1, t_end=0.5).save(f"{folder}/run.npz")
    ...     solution = fb.load(f"{folder}/run.npz")
    >>> len(solution.t), list(solution.beams)
    (6, ['arm'])
    """
    if named(path).is_dir():
        raise ValueError(f"{path} is a folder; give the name of a file in it")
    # Opened here: NumPy leaves a damaged file open.
    with open(path, "rb") as raw:
        try:
            return _read(raw)
        except Exception as error:  # a damaged file may raise nearly any
            raise ValueError(f"{path} is not a solution saved by fx_beam") from error


def _read(raw: BinaryIO) -> Solution:
    with np.load(raw, allow_pickle=False) as file:
        data = dict(file)
    meta = json.loads(str(data["meta"]))
    if meta["format"] == FORMAT:
        _divide_by_beams(data, meta["beams"])
    elif meta["format"] != _BY_BEAM:
        raise KeyError("format")
    data.setdefault("parameters", np.empty((len(data["t"]), 0)))  # files of earlier versions
    check_arrays(data, meta["beams"])

    def node(number: int) -> Node:
        if not 0 <= number < len(data["X"]):
            raise IndexError(number)
        return Node(int(number), *map(float, data["X"][number]))

    beams: dict[str, Beam] = {}
    nodes_of_beam, resultants, internal = {}, {}, {}
    for i, item in enumerate(meta["beams"]):
        name, numbers = item["name"], data[f"beam{i}_nodes"]
        ends = tuple(node(n) for n in numbers[:: item["degree"]])
        fractions = np.array(item["fractions"]) if "fractions" in item else None
        s = np.array(item["s"])
        beams[name] = Beam(name, ends, item["degree"], s, fractions=fractions)
        nodes_of_beam[name] = numbers
        if names := item["internal"]:
            internal[name] = {
                variable: data[f"beam{i}_internal{k}"] for k, variable in enumerate(names)
            }
        if len(data["q"]) == len(data["t"]):  # else there was no motion recorded to compute them of
            resultants[name] = BeamResultants(*(data[f"beam{i}_{part}"] for part in "sNQM"))
    bodies = {}
    for item in meta["bodies"]:
        points = {name: node(number) for name, number in item["points"].items()}
        bodies[item["name"]] = Body(
            item["name"], node(item["centre"]), points, item["mass"], item["inertia"]
        )
    springs = {
        int(number): {name: data[f"joint{number}_internal{i}"] for i, name in enumerate(names)}
        for number, names in meta["joints"].items()
    }
    data.setdefault("energy_impact", np.zeros_like(data["t"]))  # files of earlier versions
    energies: dict[str, Any] = {f.name: data[f"energy_{f.name}"] for f in fields(Energy)}
    end = None
    if "end_t" in data:
        parts: dict[str, Any] = {f.name: data.get(f"end_{f.name}") for f in fields(State)}
        parts |= {name: float(data[f"end_{name}"]) for name in NUMBERS}
        parts["impact"] = float(data.get("end_impact", 0.0))
        if "past_ages" in data:  # that of a motion
            parts["past"] = Past(**{f.name: data[f"past_{f.name}"] for f in fields(Past)})
        end = State(**parts)
    obstacles = _obstacles(meta["obstacles"], beams, data["X"])
    friction = {o.number: data.get(f"contact{o.number}_friction") for o in obstacles}
    return Solution(
        {name: data[name] for name in HISTORIES},
        X=data["X"],
        energy=Energy(**energies),
        stats=_stats(meta["stats"]),
        beams=beams,
        nodes_of_beam=nodes_of_beam,
        resultants_of_beam=resultants.__getitem__,
        variables_of_beam=internal,
        variables_of_joint=springs,
        bodies=bodies,
        obstacles=obstacles,
        end=end,
        names_of_parameters=meta.get("parameters", []),
        variables_of_contact={n: rows for n, rows in friction.items() if rows is not None},
        stability=Stability(counted=data.get("unstable_modes")),
    )


def _divide_by_beams(data: dict[str, np.ndarray], beams: list[dict]) -> None:
    """Give each beam its arrays, of those of all beams one after the other."""
    points = np.array([item["degree"] * (len(item["s"]) - 1) for item in beams], dtype=int)
    for part in ("nodes", *"sNQM"):
        whole = data.pop(f"beams_{part}", None)
        if whole is None:
            continue
        ends = np.cumsum(points + (part == "nodes")).tolist()
        if whole.shape[-1] != ends[-1]:
            raise ValueError(f"{part} of beams do not fit to their elements")
        for i, (first, end) in enumerate(itertools.pairwise([0, *ends])):
            data[f"beam{i}_{part}"] = whole[..., first:end]


def _obstacles(saved: list[dict], beams: dict[str, Beam], X: np.ndarray) -> list[Obstacle]:
    obstacles = []
    kinds: dict[str, Any] = {kind.__name__: kind for kind in Shape.__subclasses__()}

    def node(number: int) -> Node:
        return Node(number, *map(float, X[number]))

    def made(kind: str, shape: dict) -> Shape | Beam:
        if kind == "Beam":
            return beams[shape["beam"]]
        place, *others = shape.values()
        return kinds[kind](node(place) if isinstance(place, int) else place, *others)

    for number, item in enumerate(saved):
        on, shape, kind = item.pop("on"), item.pop("shape"), item.pop("kind")
        target = beams[on] if isinstance(on, str) else node(on)
        if isinstance(item.get("radius"), list):
            item["radius"] = tuple(item["radius"])
        if item.get("friction") is not None:
            item["friction"] = Coulomb(**item["friction"])
        obstacles.append(Obstacle(target, made(kind, shape), **{"number": number} | item))
    return obstacles


def _stats(saved: dict[str, Any]) -> Stats:
    failure = saved.pop("failure")
    return Stats(**saved, failure=Failure(**failure) if failure else None)
