"""The geometry of a scene: beams and the nodes between their elements."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Sequence

from fx_beam.errors import SceneError
from fx_beam.validation import is_name, is_whole, require

from . import loads
from .beam import Beam, Node
from .curve import Curve, layout
from .section import Section


class Geometry:
    """Beams and nodes of a scene; a copy has its own."""

    def __init__(self):
        self.beams: list[Beam] = []
        self._names: set[str] = set()
        self.nodes: list[Node] = []
        #: Smallest and largest coordinates of all nodes.
        self._corners = [math.inf] * 2, [-math.inf] * 2

    def __copy__(self):
        return copy.deepcopy(self)

    def __setstate__(self, state):
        self.__dict__.update(state)
        for node in self.nodes:
            object.__setattr__(node, "scene", self)

    @property
    def _size(self) -> float:
        """Larger side of the box around all nodes [m]; 1 for a single node, as in `Mesh.size`."""
        return max(high - low for low, high in zip(*self._corners, strict=True)) or 1.0

    def _add(
        self,
        points: Sequence | Curve | Callable,
        section: Section,
        elements: int | Sequence[int],
        degree: int,
        name: str | None,
    ) -> Beam:
        """Add a beam; SceneError for what does not fit."""
        if name is None:
            numbers = itertools.count(len(self.beams) + 1)
            name = next(free for n in numbers if (free := f"beam {n}") not in self._names)
        require(is_name(name), "add_beam: name", name, "a text that is not empty")
        if name in self._names:
            raise SceneError(f"two beams are called {name!r}; use different names")
        if not isinstance(section, Section):
            raise SceneError(f"beam {name!r}: section must be an fx_beam.Section, not {section!r}")
        require(is_whole(degree, 1, 3), f"beam {name!r}: degree", degree, "1, 2 or 3")
        degree = int(degree)
        if self.beams and degree != self.beams[0].degree:
            raise SceneError(
                f"beam {name!r}: degree {degree} differs from degree {self.beams[0].degree} of "
                f"{self.beams[0].name!r}; use one degree for all beams of a scene"
            )
        ends, s, inner = layout(points, elements, degree, name)
        self.beams.append(Beam(name, self._nodes_at(ends, name), degree, s, section, inner))
        self._names.add(name)
        return self.beams[-1]

    def _nodes_at(self, ends: list, name: str) -> tuple[Node, ...]:
        """Nodes at the ends of elements; given nodes belong to other beams."""
        for end in ends:
            if isinstance(end, Node):
                loads.check_node(self, end, f"beam {name!r}")
        nodes, first = [], len(self.nodes)
        for end in ends:
            if not isinstance(end, Node):
                end = Node(len(self.nodes), float(end[0]), float(end[1]), self)
                self.nodes.append(end)
            nodes.append(end)
        lowest, highest = self._corners
        for i, name in enumerate("xy"):
            places = [getattr(node, name) for node in self.nodes[first:]]
            lowest[i], highest[i] = min([lowest[i], *places]), max([highest[i], *places])
        return tuple(nodes)
