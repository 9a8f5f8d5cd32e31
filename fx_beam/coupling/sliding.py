"""The relation of a node that slides on a flexible beam, over one step.

Node c at the arc length s: phi_c = sum N_a phi_a. With bars for means of both ends of the step and
D for increments,

    virtual phi_c = sum Nbar_a virtual phi_a + z virtual alpha
                    + virtual s (sum (DN_a/Ds) phibar_a - z Dalpha/Ds)
    z = W/4 sum DN_a Dphi_a,    virtual alpha = W rbar . (virtual r) / |rbar|^2

where r is the chord of the element in which the step begins. It gives the step's own increment
Dphi_c, a translation for a translation, and a rotation for a rotation.
A sleeve also turns with the beam, psi_c = sum N_a Psi_a with Psi_a = psi_a + the reference angle.
With x_a = Dpsi_a/2, y = sum Nbar_a x_a, y_c = Dpsi_c/2 and k(x) = x / sin x,

    virtual psi_c = sum B_a virtual psi_a + virtual s q sin(y_c - y) / ((y_c - y) cos y_c cos y)
    B_a = Nbar_a k(x_a - y) cos x_a / sum of the same,    q = sum (DN_a/Ds) Psibar_a

which gives Dtheta_c = 2 tan(Dpsi_c/2) for the nodal Dtheta_a = 2 tan(Dpsi_a/2).
Schemes with another level have the derivatives at both ends, weighted as their forces are.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.scene.path import Path

_LIBRARY = "nodes on beams", "sliding.c", "sliding.h"


class Sliding:
    """Increment of a node on a path, its derivatives, and its virtual displacement, in C.

    Local degrees of freedom: x and y of the nodes of a window, for a sleeve also their rotations,
    and the arc length; `components` is 2 or 3.
    """

    def __init__(self, path: Path, components: int, level: float, by_tangent: bool):
        self.path, self.components, self.level = path, components, level
        ffi, self._library = c_library.kept_library(*_LIBRARY)
        self._of = functools.partial(ffi.from_buffer, ffi.typeof("double[]"))
        #: What the relation depends on, by the names of Slider in C.
        self.table = table_of(path) | {
            "components": components,
            "level": level,
            "by_tangent": by_tangent,
        }
        self._structs = Structs(ffi, c_library.declarations("sliding.h"))
        self._c = ffi.new("Slider *")
        dofs = np.arange(3 * len(path)).reshape(-1, 3)
        self._structs.set(self._c, **self.table, dofs=dofs)
        local = components * path.width + 1
        #: Displacements and rotations of the beam's nodes at the start, and increments, for C.
        self._motion: list[Any] = [None, None]
        #: Increments (components,) of the node, their derivatives, and the virtual ones.
        self.increment = self._array(self._c, "increment")[:components]
        self.T, self.virtual_map = (
            self._array(self._c, name)[:components, :local] for name in ("T", "virtual_map")
        )

    @staticmethod
    def _array(struct: Any, name: str) -> np.ndarray:
        """An array in a struct, which C changes."""
        ffi, _ = c_library.kept_library(*_LIBRARY)
        member = getattr(struct, name)
        rows = ffi.typeof(member)
        values = np.frombuffer(ffi.buffer(member))
        return values if rows.item.kind == "primitive" else values.reshape(rows.length, -1)

    def begin(self, q: np.ndarray, s: float) -> None:
        """Set the start of a step: displacements and rotations (nodes, 3), and arc length [m]."""
        self._c.s0 = s
        self._motion[0] = self._of(np.ascontiguousarray(q))

    def set(self, D: np.ndarray, Ds: float) -> None:
        """Set the increments (nodes, 3) of the beam's nodes, and that of the arc length."""
        self._c.s1 = self._c.s0 + Ds
        self._motion[1] = self._of(np.ascontiguousarray(D))
        self._library.fx_slide(self._c, *self._motion)

    def place(self, start: float, end: float) -> None:
        """Set the arc lengths at both ends of a step [m]."""
        self._c.s0, self._c.s1 = start, end

    @property
    def nodes(self) -> slice:
        """Nodes of the window."""
        return slice(self._c.first, self._c.first + self.path.width)

    def reaches(self) -> bool:
        """Whether the step ends in the element to which its weights belong, or beyond an end."""
        passed = self.path.element(self._c.s1) - self.path.element(self._c.s0)
        return abs(passed) <= self.path.most

    def off_the_end(self) -> tuple[float, str]:
        """Distance beyond an end of the beam at the end of the step [m], and which one it is."""
        s = self._c.s1
        return (-s, "start") if s < 0 else (max(s - self.path.length, 0.0), "end")


def table_of(path: Path) -> dict[str, Any]:
    """A path by the names of Slider in C."""
    return {
        "degree": path.degree,
        "elements": len(path.h),
        "window": path.window,
        "most": path.most,
        "width": path.width,
        "ends": path.s,
        "coefficients": path.coefficients,
        "position": path.X,
        "angle": path.angles(),
    }
