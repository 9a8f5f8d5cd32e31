"""Gaps, forces and slip of a contact over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.scene.beam import Beam
from fx_beam.scene.contacts import Contact, arc_of, nearest


def columns_of(contacts: Iterable[Contact]) -> dict[int, slice]:
    """Columns of recorded forces by the number of a contact: those of members are behind others."""
    columns, end = dict[int, slice](), 0
    for contact in sorted(contacts, key=lambda contact: isinstance(contact.shape, Beam)):
        columns[contact.number] = slice(end, end := end + len(contact.points.lengths))
    return columns


@dataclass(frozen=True, repr=False)
class ContactMotion:
    """Gaps, forces and slip of a contact over time; created by `Solution.contact`.

    Parameters
    ----------
    solution : Solution
        The solution.
    contact : Contact
        One of its contacts.

    Examples
    --------
    A load presses the tip of a cantilever against a stop, 1 mm below it.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (0.0, -10.0))
    >>> stop = scene.add_contact(beam.end, fb.Line((0, -1e-3), normal=(0, 1)), stiffness=1e9)
    >>> contact = fb.static(scene).contact(stop)
    >>> float(contact.force[-1, 0, 1].round(1)), bool(contact.gap.min() > -1e-8)
    (7.0, True)
    """

    solution: Any
    contact: Contact

    def __repr__(self):
        return f"<{self.contact} over {len(self.solution.t)} rows>"

    @property
    def nodes(self) -> np.ndarray:
        """Numbers (m,) of the nodes, along the beam; rows of `Solution.X`."""
        target = self.contact.target
        if isinstance(target, Beam):
            return self.solution.nodes_of_beam[target.name]
        return np.array([target.number])

    @property
    def points(self) -> np.ndarray:
        """Positions (n, m, 2) of the points that touch [m]: nodes, or points along elements."""
        nodes = self.nodes
        positions = self.solution.X[nodes] + self.solution.recorded("q")[:, nodes, :2]
        return self.contact.points.of(positions)

    @property
    def gap(self) -> np.ndarray:
        """Distance (n, m) of the points from the obstacle [m]; negative behind it."""
        return self._now[0].copy()

    @property
    def force(self) -> np.ndarray:
        """Forces (n, m, 2) on the points at `Solution.t_level` [N]."""
        columns = columns_of(self.solution.contacts)[self.contact.number]
        return self.solution.recorded("contact_forces")[:, columns]

    @property
    def normal(self) -> np.ndarray:
        """Normal forces (n, m) at `Solution.t_level` [N], which push to the free side."""
        return np.einsum("nmi,nmi->nm", self.force, self._normals_at_level)

    @property
    def tangential(self) -> np.ndarray:
        """Friction (n, m) on the points at `Solution.t_level` [N].

        It is positive to the left for who looks along the normal force.
        """
        x, y = np.moveaxis(self._normals_at_level, -1, 0)
        return np.einsum("nmi,nmi->nm", self.force, np.stack([-y, x], axis=-1))

    @property
    def slip(self) -> np.ndarray:
        """How far the points have slipped since they touched (n, m) [m]; signs as `tangential`."""
        return self._of_friction(1)

    @property
    def stretch(self) -> np.ndarray:
        """Stretch z of the friction's springs (n, m) [m]: friction is -kt (z + tau dz/dt)."""
        return self._of_friction(0)

    def _of_friction(self, variable: int) -> np.ndarray:
        known = self.solution.variables_of_contact.get(self.contact.number)
        if known is None:
            why = "has no friction" if self.contact.friction is None else "has no motion recorded"
            raise ValueError(f"{self.contact} {why}")
        shape = self.contact.shape
        if isinstance(shape, Beam):
            return self._sides(shape) * known[..., variable]
        return shape.side * known[..., variable]

    # Nearest points take time: they are found once for each `ContactMotion`.
    @cached_property
    def _now(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Gaps (n, m), directions (n, m, 2) to the free side, and nearest nodes at the times t."""
        return self._gaps_and_normals(self.solution.recorded("q"))

    @cached_property
    def _normals_at_level(self) -> np.ndarray:
        """Directions (n, m, 2) of the normal force in the steps between rows."""
        q, t, at = self.solution.recorded("q"), self.solution.t, self.solution.t_level
        length = np.diff(t)
        part = np.divide(at[1:] - t[:-1], length, out=np.ones_like(length), where=length > 0)
        between = q[:-1] + part[:, None, None] * np.diff(q, axis=0)
        return self._gaps_and_normals(np.concatenate([q[:1], between]))[1]

    def _gaps_and_normals(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Gaps (n, m) and directions (n, m, 2) to the free side, at displacements (n, nodes, 3).

        Of a member also the nodes (n, m) near which its nearest points are.
        """
        shape, radius = self.contact.shape, self.contact.radius
        nodes = self.nodes
        if isinstance(shape, Beam):
            return self._from_member(q, shape)
        origin = shape.origin
        points = self.contact.points.of(self.solution.X[nodes] + q[:, nodes, :2])
        arms, psi = points - origin, np.zeros(len(q))
        if shape.carrier is not None:
            arms = arms - q[:, None, shape.carrier.number, :2]
            psi = q[:, shape.carrier.number, 2]
        distances, directions = shape.seen(arms, psi[:, None])
        return distances - radius, directions, None

    def _from_member(
        self, q: np.ndarray, member: Beam
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        positions = self.solution.X + q[:, :, :2]
        nodes = self.solution.nodes_of_beam[member.name]
        arc, apart = None, 0.0
        if member is self.contact.target:
            arc, apart = arc_of(self.solution.X[nodes]), self.contact.apart
        rows = [nearest(row[self.nodes], row[nodes], apart, arc) for row in positions]
        distance, node, point = (np.stack(of) for of in zip(*rows, strict=True))
        arms = positions[:, self.nodes] - point
        return distance - self.contact.radii, arms / np.maximum(distance, 1e-300)[..., None], node

    def _sides(self, member: Beam) -> np.ndarray:
        """1 for the nodes (n, m) to the right of a member, for who looks along it, else -1."""
        _, directions, near = self._now
        assert near is not None
        nodes = self.solution.nodes_of_beam[member.name]
        positions = self.solution.X[nodes] + self.solution.recorded("q")[:, nodes, :2]
        before, after = np.maximum(near - 1, 0), np.minimum(near + 1, len(nodes) - 1)
        ends = (np.take_along_axis(positions, at[..., None], axis=1) for at in (after, before))
        x, y = np.moveaxis(np.subtract(*ends), -1, 0)
        return np.where(x * directions[..., 1] > y * directions[..., 0], -1.0, 1.0)
