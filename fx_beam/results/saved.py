"""Reading of saved solutions, whose arrays must fit together."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import fields, replace
from types import UnionType
from typing import Any, BinaryIO, Union, get_args, get_origin, get_type_hints

import numpy as np

from fx_beam.errors import Failure
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.body import Body
from fx_beam.scene.contacts import Contact, Shape
from fx_beam.scene.coordinate import Coulomb
from fx_beam.scene.joints import Constraints, JointKey

from .export import FORMAT, named
from .records import BeamBalance, BeamResultants, Energy, Stats
from .solution import Solution
from .state import ARRAYS, HISTORIES, Past, State

# Lengths by name; those of rows that may be missing begin with "n?".
_SHAPES: dict[str, tuple] = {
    "X": ("nodes", 2),
    **{
        name: ("n" if history.record == "always" else "n?", *history.shape)
        for name, history in HISTORIES.items()
    },
    **{f"energy_{part.name}": ("n",) for part in fields(Energy)},
    **{"beams_nodes": ("beam nodes",), "resultants_s": ("all points",)},
    **{f"resultants_{part}": ("n", "all points") for part in "NQM"},
    "section_forces": ("n", "elements", 2, 3),
    **{"section_places": ("places", 2), "section_jumps": ("n", "places", 3)},
    **{f"end_{p.name}": p.metadata["shape"] for p in fields(State) if "shape" in p.metadata},
    **{f"end_past_{part.name}": part.metadata["shape"] for part in fields(Past)},
    **{f"end_{name}": array.in_files for name, array in ARRAYS.items()},
}
# What numbers are not floats.
_DTYPES = {"end_owners": "U", "end_input_names": "U", "beams_nodes": "i", "end_past_orders": "i"}
# A lost motion may have infinite rates, forces and energies, but not these.
_FINITE = {"t", "X", "q", "end_past_ages", "end_past_differences", "end_past_slides"}
_FINITE |= {f"end_{name}" for name in ("motors", "q", "slides", "parts", "inputs", "q_previous")}
_FINITE |= {f"end_{name}" for name in ("internal", "spring_internal", "natural")}
# Types of what a file has of a beam.
_OF_BEAM = {
    "name": str,
    "degree": int,
    "s": list[float],
    "fractions": list[float] | None,
    "carriers": list[int],
}
#: What JSON has by its kind.
_KINDS: dict[str, Any] = {
    kind.__name__: kind
    for kind in (
        *(Body, Contact, *Shape.__subclasses__(), Coulomb, Constraints, JointKey),
        *(BeamResultants, Energy, State, Past, Stats, Failure),
    )
}


class _OtherFormatError(ValueError):
    """A file of another version, or of something else."""


_type_hints = functools.cache(get_type_hints)


def _check_types(values: Mapping[str, Any], hints: Mapping[str, Any]) -> None:
    """Refuse values that do not have the types of their names."""
    for name, hint in hints.items():
        if name in values and not _has_type(values[name], hint):
            raise ValueError(f"{name} is {values[name]!r:.80}")


def _has_type(value: Any, hint: Any) -> bool:
    """Whether a value has the type of an annotation."""
    kind, parts = get_origin(hint), get_args(hint)
    if kind in (Union, UnionType):
        return any(_has_type(value, part) for part in parts)
    if hint is Any or kind is None:
        types = (int, float) if hint is float else hint
        is_bool = isinstance(value, bool)
        return hint is Any or isinstance(value, types) and is_bool == (hint is bool)
    if not isinstance(value, kind) or isinstance(value, str):
        return False
    if kind is dict:
        pairs = zip(parts, (value, value.values()), strict=True)
        return all(_has_type(item, part) for part, items in pairs for item in items)
    if kind is not tuple or parts[-1] is Ellipsis:
        parts = parts[:1] * len(value)
    return len(value) == len(parts) and all(map(_has_type, value, parts))


def _check_arrays(data: Mapping[str, np.ndarray], points: list[int], elements: int) -> None:
    """Refuse arrays that do not fit together, or to beams with these numbers of Gauss points."""
    sizes = {"n": len(data["t"]), "nodes": len(data["X"])}
    sizes |= {"all points": sum(points), "beam nodes": sum(points) + len(points)}
    sizes["elements"] = elements
    shapes = {name: shape for name, shape in _SHAPES.items() if name in data}
    if not data.get("end_past_ages", np.ones(1)).size:
        del shapes["end_past_differences"]  # of no steps, in another form
    for name, shape in shapes.items():
        _check(name, data[name], shape, sizes)
    orders = data.get("end_past_orders", np.zeros(0))
    if ((orders < 0) | (orders > len(data.get("end_past_ages", [])))).any():
        raise ValueError("end_past_orders are above the number of configurations")


def _check(name: str, array: np.ndarray, shape: tuple, sizes: dict[str, int]) -> None:
    """Refuse an array of another shape or kind; `sizes` are those known by names so far."""
    missing = shape[:1] == ("n?",) and len(array) == 0
    ok = array.ndim == len(shape) and array.dtype.kind == _DTYPES.get(name, "f")
    for size, length in list(zip(shape, array.shape, strict=False))[missing:]:
        expected = sizes.setdefault(size.rstrip("?"), length) if isinstance(size, str) else size
        ok &= expected == length
    if not ok:
        raise ValueError(f"{name} is {array.dtype} {array.shape}, not {shape} of {sizes}")
    if name in _FINITE and not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")


def _points(beam: dict) -> int:
    """Number of Gauss points of a beam."""
    _check_types(beam, _OF_BEAM)
    degree, s, fractions = beam["degree"], beam["s"], beam["fractions"]
    if degree not in (1, 2, 3) or len(s) < 2 or not (np.diff(s) > 0).all():
        raise ValueError(f"beam {beam['name']!r} has elements of degree {degree} at {s!r:.80}")
    if fractions is not None and len(fractions) != len(s):
        raise ValueError(f"fractions of beam {beam['name']!r} are {fractions!r:.80}")
    return degree * (len(s) - 1)


def load(path) -> Solution:
    """Read a solution that `Solution.save` wrote; no code in the file is run.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Solution
        The solution. Its beams are in `Solution.beams`, by name. It has no branches and critical
        points of a path.

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
            reason = str(error) if isinstance(error, _OtherFormatError) else ""
            raise ValueError(f"{path} is not a solution saved by fx_beam{reason}") from error


def _read(raw: BinaryIO) -> Solution:
    with np.load(raw, allow_pickle=False) as file:
        # NumPy may stop before the end of an array, where its sum would be checked. A file with a
        # wrong sum is refused below, as one without arrays.
        arrays = dict(file) if file.zip.testzip() is None else {}
    meta = json.loads(str(arrays.pop("meta")))
    if (written := meta.pop("format")) != FORMAT:
        raise _OtherFormatError(
            f" in the format of this version, {FORMAT!r:.80}, but in {written!r:.80}. Load it with "
            "a version of fx_beam that knows this format"
        )
    parts = _Unpacker(arrays)
    members = parts.read(meta.pop("beams"))
    counts = [_points(member) for member in members]
    _check_arrays(arrays, counts, sum(len(member["s"]) - 1 for member in members))
    ends, nodes_of_beam = np.cumsum(counts)[:-1], dict[str, np.ndarray]()
    if members:
        nodes = parts.read(meta.pop("beams_nodes"))
        pieces = np.split(nodes, ends + np.arange(1, len(members)))
        for member, beam_nodes in zip(members, pieces, strict=True):
            # Files of the first version have no carriers.
            name, degree, s, fractions, *lines = member.values()
            s, fractions = np.array(s), None if fractions is None else np.array(fractions)
            corners = tuple(map(parts.node, beam_nodes))[::degree]
            carriers = tuple(parts.node(number) for line in lines for number in line)
            parts.beams[name] = Beam(name, corners, degree, s, None, None, fractions, carriers)
            nodes_of_beam[name] = beam_nodes
    resultants = dict[str, BeamResultants]()
    known = {name: parts.read(part) for name, part in meta.items()}
    if (resultants_along := known.pop("resultants", None)) is not None:
        columns = resultants_along.s, resultants_along.N, resultants_along.Q, resultants_along.M
        rows = zip(*(np.split(column, ends, axis=-1) for column in columns), strict=True)
        balances = _balances(known, list(parts.beams.values()))
        beams = zip(nodes_of_beam, rows, balances, strict=True)
        resultants = {name: replace(BeamResultants(*row), balance=b) for name, row, b in beams}
    stability = {name: known.pop(name) for name in ("unstable_modes",) if name in known}
    if "turns_of_line" not in known:
        _forget_slip_on_members(known)
    end = known["end"]
    _check_types(known, _type_hints(Solution.__init__))
    if arrays or end is not None and not np.isfinite([end.t, end.length]).all():
        raise ValueError(f"{[*arrays]} belong to nothing, or the last state has no time")
    if end is not None and end.constraints is not None:
        numbers = {key.number for key in end.constraints.joints}
        if not numbers <= {*range(len(end.slides))}:
            raise ValueError(f"the last state has slides of {len(end.slides)} joints")
    return Solution(
        # Files of the first version have no forces along lines.
        {name: known.pop(name, np.empty((0, 0))) for name in HISTORIES},
        beams=parts.beams,
        nodes_of_beam=nodes_of_beam,
        resultants_of_beam=resultants.get,
        stability=stability,
        **known,
    )


def _forget_slip_on_members(known: dict[str, Any]) -> None:
    """Files before version 1.2 have slip along a member as it is drawn: neither it nor an end."""
    for contact in known["contacts"]:
        if isinstance(contact.shape, Beam) and contact.friction is not None:
            known["variables_of_contact"].pop(contact.number, None)
            known["end"] = None


def _balances(known: dict, beams: list[Beam]) -> list[BeamBalance | None]:
    """Section forces of each beam, taken from what is known; None in files of the first version."""
    names = "section_forces", "section_places", "section_jumps"
    forces, places, jumps = (known.pop(name, None) for name in names)
    if forces is None:
        return [None] * len(beams)
    beam_forces = np.split(forces, np.cumsum([beam.elements for beam in beams])[:-1], axis=1)
    masks = [places[:, 0] == k for k in range(len(beams))]
    return [
        BeamBalance(beam.s, ends, places[mask, 1], jumps[:, mask])
        for beam, ends, mask in zip(beams, beam_forces, masks, strict=True)
    ]


class _Unpacker:
    """Makes of JSON what `save` has packed; each array belongs to one part."""

    def __init__(self, arrays: dict[str, np.ndarray]):
        self._arrays, self._X = arrays, arrays["X"]
        #: Beams by their names, of those read so far.
        self.beams = dict[str, Beam]()

    def node(self, number: int) -> Node:
        """A node by its number."""
        if not 0 <= number < len(self._X):
            raise IndexError(number)
        return Node(int(number), *map(float, self._X[number]))

    def read(self, packed: Any) -> Any:
        """A value of this package, or of Python."""
        if isinstance(packed, list):
            return [self.read(part) for part in packed]
        if not isinstance(packed, dict):
            return packed
        (kind, content), *rest = packed.items()
        if kind == "is":
            # Files of the first version have iterations of a solver that is no longer there.
            known = {name: part for name, part in rest if name != "krylov_iterations"}
            values = {name: self.read(part) for name, part in known.items()}
            _check_types(values, _type_hints(_KINDS[content]))
            return _KINDS[content](**values)
        if kind == "keys":
            return dict(zip(content, self.read(packed["values"]), strict=True))
        parsers: dict[str, Any] = {"array": self._arrays.pop, "node": self.node}
        parsers |= {"beam": self.beams.__getitem__, "tuple": lambda items: tuple(self.read(items))}
        return parsers[kind](content)
