"""Reading of saved solutions, whose arrays must fit together."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from typing import Any, BinaryIO

import numpy as np

from fx_beam.errors import Failure
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.body import Body
from fx_beam.scene.contacts import Contact, Shape
from fx_beam.scene.coordinate import Coulomb

from .audit import BeamResultants, Energy, Stability, Stats
from .export import FORMAT
from .files import named
from .solution import Solution
from .state import ARRAYS, AT_NODES, HISTORIES, NUMBERS, Past, State

# Lengths by name; those of rows that may be missing begin with "n?".
_SHAPES: dict[str, tuple] = {
    "X": ("nodes", 2),
    **{
        name: ("n" if history.record == "always" else "n?", *history.shape)
        for name, history in HISTORIES.items()
    },
    **{f"energy_{part.name}": ("n",) for part in fields(Energy)},
    **{"beams_nodes": ("beam nodes",), "beams_s": ("all points",)},
    **{f"beams_{part}": ("n", "all points") for part in "NQM"},
    **{f"end_{name}": () for name in NUMBERS},
    **{f"end_{p.name}": p.metadata["shape"] for p in fields(State) if "shape" in p.metadata},
    **{f"past_{part.name}": part.metadata["shape"] for part in fields(Past)},
}
for _name, _array in ARRAYS.items():
    _shape = ("nodes", 3) if _name in AT_NODES else _array.shape
    # Two motions in one solution may have more contacts than the last state.
    _shape = tuple("end " + s if s in ("contacts", "parameters") else s for s in _shape)
    _SHAPES[f"end_{_name}"] = _shape
# What numbers are not floats.
_KINDS = dict.fromkeys(("end_owners", "end_constraints"), "U")
_KINDS |= dict.fromkeys(("beams_nodes", "end_negative_eigenvalues", "past_orders"), "i")
# A lost motion may have infinite rates, forces and energies, but not these.
_FINITE = {"t", "X", "q", "past_ages", "past_differences", "past_slides"}
_FINITE |= {f"end_{name}" for name in ("t", "motors", "q", "slides", "parts", "inputs", "length")}
_FINITE |= {f"end_{name}" for name in ("q_previous", "internal", "spring_internal", "natural")}


def _check_arrays(data: Mapping[str, np.ndarray], points: list[int]) -> None:
    """Refuse arrays that do not fit together, or to beams with these numbers of Gauss points."""
    sizes = {"n": len(data["t"]), "nodes": len(data["X"])}
    sizes |= {"all points": sum(points), "beam nodes": sum(points) + len(points)}
    shapes = {name: shape for name, shape in _SHAPES.items() if name in data}
    if not data.get("past_ages", np.ones(1)).size:
        del shapes["past_differences"]  # of no steps, in another form
    for name, shape in shapes.items():
        _check(name, data[name], shape, sizes)
    nodes = data.get("beams_nodes", np.zeros(0))
    if ((nodes < 0) | (nodes >= len(data["X"]))).any():
        raise ValueError("a node of a beam is missing")
    orders = data.get("past_orders", np.zeros(0))
    if ((orders < 0) | (orders > len(data.get("past_ages", [])))).any():
        raise ValueError("past_orders are above the number of configurations")


def _check(name: str, array: np.ndarray, shape: tuple, sizes: dict[str, int]) -> None:
    """Refuse an array of another shape or kind; `sizes` are those known by names so far."""
    missing = shape[:1] == ("n?",) and len(array) == 0
    fits = array.ndim == len(shape) and array.dtype.kind == _KINDS.get(name, "f")
    for size, length in list(zip(shape, array.shape, strict=False))[missing:]:
        wanted = sizes.setdefault(size.rstrip("?"), length) if isinstance(size, str) else size
        fits &= wanted == length
    if not fits:
        raise ValueError(f"{name} is {array.dtype} {array.shape}, not {shape} of {sizes}")
    if name in _FINITE and not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")


def _points(beam: dict[str, Any]) -> int:
    """Number of Gauss points of a beam."""
    degree, elements = beam["degree"], len(beam["s"]) - 1
    if degree not in (1, 2, 3) or elements < 1:
        raise ValueError(f"beam {beam['name']!r} has {elements} elements of degree {degree}")
    return degree * elements


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
    if meta["format"] != FORMAT:
        raise KeyError("format")
    counts = [_points(beam) for beam in meta["beams"]]
    _check_arrays(data, counts)

    def node(number: int) -> Node:
        if not 0 <= number < len(data["X"]):
            raise IndexError(number)
        return Node(int(number), *map(float, data["X"][number]))

    names = [item["name"] for item in meta["beams"]]
    beams, internal, resultants = dict[str, Beam](), dict[str, Any](), dict[str, BeamResultants]()
    nodes_of_beam = _of_beams(data, "nodes", names, [count + 1 for count in counts])
    for i, item in enumerate(meta["beams"]):
        name, degree, variables = item["name"], item["degree"], item["internal"]
        ends = tuple(node(n) for n in nodes_of_beam[name][::degree])
        fractions = np.array(item["fractions"]) if "fractions" in item else None
        beams[name] = Beam(name, ends, degree, np.array(item["s"]), fractions=fractions)
        if variables:
            of_beam = (data[f"beam{i}_internal{k}"] for k in range(len(variables)))
            internal[name] = dict(zip(variables, of_beam, strict=True))
    if len(data["q"]) == len(data["t"]):  # else there was no motion recorded to compute them of
        parts = {part: _of_beams(data, part, names, counts) for part in "sNQM"}
        resultants = {
            name: BeamResultants(*(of_beams[name] for of_beams in parts.values())) for name in names
        }
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
    energies: dict[str, Any] = {f.name: data[f"energy_{f.name}"] for f in fields(Energy)}
    end = None
    if "end_t" in data:
        needed = [*NUMBERS, "impact", *(f.name for f in fields(State) if f.default is MISSING)]
        state: dict[str, Any] = {f.name: data.get(f"end_{f.name}") for f in fields(State)}
        state |= {name: data[f"end_{name}"] for name in needed}
        state |= {name: float(state[name]) for name in (*NUMBERS, "impact")}
        if "past_ages" in data:  # that of a motion
            state["past"] = Past(**{f.name: data[f"past_{f.name}"] for f in fields(Past)})
        end = State(**state)
    contacts = _contacts(meta["contacts"], beams, node)
    friction = {o.number: data.get(f"contact{o.number}_friction") for o in contacts}
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
        contacts=contacts,
        end=end,
        names_of_parameters=meta.get("parameters", []),
        variables_of_contact={n: rows for n, rows in friction.items() if rows is not None},
        stability=Stability(counted=data.get("unstable_modes")),
    )


def _of_beams(
    data: Mapping[str, np.ndarray], part: str, names: list[str], counts: list[int]
) -> dict[str, np.ndarray]:
    """What each beam has, by its name, of those of all beams one after the other."""
    if not names:
        return {}
    rows = np.split(data[f"beams_{part}"], np.cumsum(counts)[:-1], axis=-1)
    return dict(zip(names, rows, strict=True))


def _contacts(
    saved: list[dict], beams: dict[str, Beam], node: Callable[[int], Node]
) -> list[Contact]:
    contacts = []
    kinds: dict[str, Any] = {kind.__name__: kind for kind in Shape.__subclasses__()}

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
        contacts.append(Contact(target, made(kind, shape), **{"number": number} | item))
    return contacts


def _stats(saved: dict[str, Any]) -> Stats:
    failure = saved.pop("failure")
    return Stats(**saved, failure=Failure(**failure) if failure else None)
