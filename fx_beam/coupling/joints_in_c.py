"""Joints and gears as C has them: tables, numbers, and a configuration."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam import c_library
from fx_beam.c_library import Structs, array_at
from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.fem.mesh import rotation_of
from fx_beam.fem.scene_data import Arm
from fx_beam.laws.rates import UpdateRule
from fx_beam.results.state import MACROS
from fx_beam.scene.scene import Scene

from .graph import Auxiliaries, Couplings
from .reduced_tangent import columns_of_slides

if TYPE_CHECKING:
    from .loops import Loops
    from .sliders import Slide, Sliders


# What evaluates joints, and the flags of its compiler.
_LIBRARY = "joints", "joints.c"
_FLAGS = "-O1", c_library.WHOLE_PROGRAM


class JointsInC:
    """The joints of a scene with `size` degrees of freedom, in C."""

    def __init__(
        self,
        couplings: Couplings,
        auxiliaries: Auxiliaries,
        sliders: Sliders | None,
        loops: Loops | None,
        rates: UpdateRule,
        size: int,
    ):
        self.couplings, self.auxiliaries, self.sliders = couplings, auxiliaries, sliders
        self.loops, self.size, self._rates = loops, size, rates
        #: Offsets and axes (2, joints, 2) of `Couplings.arm_joints`.
        self.arms = np.zeros((2, len(couplings.arm_joints), 2))
        #: Weights of both terms of gears, and their sums at rest (gears, 3).
        self.gears = np.zeros((len(couplings.gears), 3))
        #: Tables by the names in c/tables.h, without positions in the tangent.
        self.members = self._tables()

    def set_numbers(self, arms: dict[int, Arm], gears: Sequence[Sequence[float]]) -> None:
        """Set offsets and axes of joints, and the numbers of gears."""
        offset, axis = self.arms
        for m, joint in enumerate(self.couplings.arm_joints):
            arm = arms[joint.number]
            offset[m], axis[m] = arm.offset, arm.axis or (0.0, 0.0)
        for gear_numbers, numbers in zip(self.gears, gears, strict=True):
            gear_numbers[:] = numbers

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Offsets and axes of joints that move, and gears, by the names in c/numbers.h."""
        return {"offset": self.arms[0], "axis": self.arms[1], "gears": self.gears}

    def _tables(self) -> dict[str, Any]:
        """The couplings by the names in c/tables.h, without positions in the tangent."""
        couplings, arm_joints = self.couplings, self.couplings.arm_joints
        entries = couplings.all_entries
        # Rows that follow through joint m: in x as 2 m, in y as 2 m + 1.
        followers, arm_numbers = entries.arms
        equal = (entries.value_at == 0) & (entries.sign == 1)
        if not equal.all():
            entries = entries.take(np.argsort(~equal, kind="stable"))
        ends = [[rotation_of(node) for node in (joint.a, joint.b)] for joint in arm_joints]
        carrier, carried = np.array(ends, dtype=int).reshape(-1, 2).T
        return {
            "dofs": self.size,
            "columns": couplings.columns,
            "free": couplings.free,
            "driven": couplings.driven,
            "map": {
                "count": len(equal),
                "equal": np.count_nonzero(equal),
                "row": entries.row,
                **entries.members(),
            },
            "joints": {
                "count": len(arm_joints),
                "sign": couplings.sign[:2, [joint.number for joint in arm_joints]].T,
                "carrier": carrier,
                "carried_node": carried,
                "slide_column": columns_of_slides(couplings),
                "number": np.array([joint.number for joint in arm_joints], dtype=int),
                "track": np.array([joint.track.number for joint in arm_joints], dtype=int),
                "followers": len(followers),
                "follower": followers,
                "through": arm_numbers,
            },
            "auxiliary": self.auxiliaries.members(),
            "loops": {} if self.loops is None else self.loops.members(),
            "gears": {} if self.loops is None else self.loops.gear_members(),
        }

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        structs: list[Any] = []
        arrays = [self.arms, self.gears]
        if not self.couplings.is_selection:
            own_structs, own_arrays = self.configuration.memory
            structs, arrays = structs + own_structs, arrays + own_arrays
        return structs, arrays

    def in_block(self, block: Any) -> JointsInC:
        """Joints whose numbers and configuration are in the block of a run."""
        other = shallow_copy(self)
        other.arms, other.gears = block.view(self.arms), block.view(self.gears)
        if "configuration" in self.__dict__:
            other.configuration = self.configuration.in_block(block)
        return other

    @cached_property
    def configuration(self) -> Configuration:
        """Joints in C."""
        slides = self.sliders.all if self.sliders else []
        scheme = {"level": self._rates.level, **self._rates.constants}
        members = self.members | {"scheme": scheme, "sliders": {"count": len(slides)}}
        return Configuration(members, self.numbers, self.couplings.sign.shape[1], slides)

    @property
    def independent(self) -> np.ndarray:
        """Unknowns that follow no others: all but the ones that close loops."""
        unknowns = np.arange(self.couplings.free)
        return unknowns if self.loops is None else np.setdiff1d(unknowns, self.following)

    @property
    def following(self) -> np.ndarray:
        """Unknowns (closures,) that close loops."""
        if self.loops is None:
            return np.empty(0, dtype=int)
        return self.loops.columns[self.configuration.following]


def numbers_of_gears(scene: Scene) -> list[list[Any]]:
    """Weights and sum at rest of each gear that is a relation, with slopes."""
    ideal = [gear for gear in scene.gears if gear.is_ideal]
    return [[*(term.weight for term in gear.terms), gear.rest] for gear in ideal]


def begin_to_build_joints() -> None:
    """Compile what evaluates joints beside all else, if the cache lacks it."""
    c_library.begin_to_build(*_LIBRARY, MACROS, _FLAGS)


class Configuration:
    """Joints at one configuration, in C: increments in a step, and the values of T and Tv.

    `members` are named as in ``Tables`` of C (c/tables.h), `numbers` as in ``Numbers``.
    """

    def __init__(
        self,
        members: dict[str, Any],
        numbers: dict[str, np.ndarray],
        joints: int,
        slides: Sequence[Slide],
    ):
        ffi, self._library = c_library.open_library(*_LIBRARY, "problem.h", MACROS, (), _FLAGS)
        self._structs, self._slides = Structs(ffi), slides
        self._c, self._ffi = ffi.new("Problem *"), ffi
        size, columns = members["dofs"], members["columns"] + members["auxiliary"]["count"]
        self._state = np.zeros(size), np.zeros(joints)
        state = dict(zip(("q", "slides"), self._state, strict=True))
        values = 1 + 4 * members["joints"]["count"] + members["gears"].get("count", 0)
        self.following = np.zeros(members["loops"].get("closures", 0), np.int32)
        sliders = [slide.members() for slide in slides]
        work = {"state": state, "slider": sliders, "following": self.following}
        points: dict[str, Any] = {"points": [{}]}
        self._structs.set(self._c, tables=[members], numbers=numbers | points, work=work)
        self._scratch = np.zeros(self._library.fx_lay_out(self._c, ffi.NULL))
        self._library.fx_lay_out(self._c, ffi.from_buffer("double[]", self._scratch))
        w, array = self._c.work, functools.partial(array_at, ffi)
        #: Increments of nodes and columns; the values of T and Tv; closures.
        self.D, self.z = array(w.D, size), array(w.z, columns)
        self.values = array(w.values, values), array(w.virtual_map, values)
        self.closure = array(w.closure, len(self.following))

    @property
    def memory(self) -> tuple[list, list[np.ndarray]]:
        """Structs and arrays that change, for a `BlockPlan`."""
        structs, count = [self._c], len(self._slides)
        if count:
            structs.append(self._ffi.cast(f"Slider(*)[{count}]", self._c.work.slider)[0])
        return structs, [*self._state, self._scratch, self.following]

    def in_block(self, block: Any) -> Configuration:
        """The configuration of a run."""
        other = shallow_copy(self)
        other._c = block.struct(self._ffi, self._c)
        other._state = tuple(map(block.view, self._state))
        other.D, other.z = block.view(self.D), block.view(self.z)
        other.values = tuple(map(block.view, self.values))
        other.closure, other.following = block.view(self.closure), block.view(self.following)
        return other

    def set_start(self, q: np.ndarray, slides: np.ndarray) -> bool:
        """Set the start: displacements and rotations, and slides; False in a singular position."""
        self._state[0][:], self._state[1][:] = q, slides
        return bool(self._library.fx_begin_joints(self._c))

    def expand(self, y: np.ndarray, driven: np.ndarray, close: bool) -> bool:
        """Find D for increments of unknowns and driven columns; False if loops do not close.

        With `close` the unknowns that close loops are corrected in y.
        """
        free = len(y)
        self.z[:free], self.z[free : free + len(driven)] = y, driven
        closed = bool(self._library.fx_expand(self._c, close))
        y[:] = self.z[:free]
        return closed

    def relations(self, virtual: bool) -> Iterator[tuple[np.ndarray, int]]:
        """For each node on a beam the columns of T, or Tv, and where its window begins."""
        for i, slide in enumerate(self._slides):
            c = self._c.work.slider[i]
            rows = np.frombuffer(self._ffi.buffer(c.virtual_map if virtual else c.T)).reshape(3, -1)
            width, components = slide.path.width, len(slide.columns)
            yield rows[:components, [*range(components * width), -1]], c.first

    @property
    def arcs(self) -> list[tuple[float, float]]:
        """Arc lengths of nodes on beams at both ends of the step [m]."""
        return [(c.s0, c.s1) for c in (self._c.work.slider[i] for i in range(len(self._slides)))]
