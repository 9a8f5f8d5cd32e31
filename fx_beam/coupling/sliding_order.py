"""Sliding nodes among the trees of joints: their checks, their order, and what follows them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints


def hold_sliding_nodes(joints: Iterable[Joint], held: list[set[int]]) -> list[SlidingJoint]:
    """Joints of sliding nodes; adds what a beam holds to nodes held in x, y and rotation.

    SceneError for a sliding node that is supported, or that slides on two beams.
    """
    sliding = sliding_joints(joints)
    for joint in sliding:
        others = [other for other in sliding if other.b is joint.b]
        if len(others) > 1:
            names = "; ".join(map(str, others))
            raise SceneError(
                f"over-constrained: {names}: {joint.b} slides on two beams. Let two nodes slide, "
                "and join them by a beam"
            )
        for _, node, i in joint.carried:
            if node in held[i]:
                raise SceneError(
                    f"over-constrained: {joint}: {COMPONENTS[i]} of the node is supported, but the "
                    "beam moves it. Support the node before this joint is added: then it is a guide"
                )
    for joint in sliding:
        for _, node, i in joint.carried:
            held[i].add(node)
    return sliding


def with_order(scene: Scene, mesh: Mesh, couplings: Any) -> Any:
    """The `Couplings` whose sliding joints are in order."""
    owner = {c: number for number, columns in couplings.carried.items() for c in columns}
    needs = {
        joint.number: {
            owner[column]
            for node in mesh.nodes_of(scene, joint.beam)
            for dof in mesh.dofs[node]
            for column, _, _ in couplings.entries(int(dof))
            if column in owner
        }
        for joint in couplings.sliding
    }
    left, order = list(couplings.sliding), list[SlidingJoint]()
    while left:
        ready = [j for j in left if not needs[j.number] - {done.number for done in order}]
        if not ready:
            names = "; ".join(map(str, left))
            raise SceneError(
                f"over-constrained: {names}: each node slides on a beam that the other nodes "
                "carry. Remove one of them"
            )
        order += ready
        left = [j for j in left if j not in ready]
    return replace(couplings, sliding=order)
