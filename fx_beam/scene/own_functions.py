"""The functions of the user in a scene as UFL expressions of fixed symbols, to compare them."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import ufl

from .coordinate import Coordinate
from .internal_variables import InternalVariables
from .law import Energy
from .scene import Scene
from .step_symbols import SCALARS, STEP, Symbol


def expressions_of(scene: Scene) -> list[tuple[str, Any]]:
    """What all functions of the user give, with their names, in a fixed order."""
    sections = [beam.section for beam in scene.beams]
    own: list[tuple[str, Any]] = []
    if any(section.strain_energy is not None for section in sections):
        distinct = {id(section): section for section in sections}
        numbers = {key: number for number, key in enumerate(distinct)}
        own.append(("sections", [numbers[id(section)] for section in sections]))
        for section in distinct.values():
            own += _of_energy(section.strain_energy, section.internal, 3)
    for joint in scene.joints:
        for on in filter(None, (joint.slide, joint.rotation)):
            own += _of_coordinate(on)
    for obstacle in scene.obstacles:
        own += _of_energy(obstacle.energy, None, 1)
    for force in scene.forces_between:
        own += _of_coordinate(force.on)
        if force.force is not None:
            own.append(("force", ufl.as_ufl(force.force(*SCALARS[:3]))))
    works = [work.of(STEP, "virtual work") for work in scene.virtual_works]
    return own + [("virtual work", work) for work in works]


def _of_energy(
    energy: Energy | None, internal: InternalVariables | None, strains: int
) -> Iterator[tuple[str, Any]]:
    if energy is None:
        return
    e0, e, dt = SCALARS[:strains], SCALARS[3 : 3 + strains], SCALARS[6]
    if internal is None:
        yield "strain_energy", ufl.as_ufl(energy(*e))
        return
    a = _vector(len(internal.names))
    yield "strain_energy", ufl.as_ufl(energy(*e, a))
    yield "update", internal.updated(a, e0, e, dt)


def _of_coordinate(on: Coordinate) -> Iterator[tuple[str, Any]]:
    if on.spring is not None:
        yield from _of_energy(on.spring.strain_energy, on.spring.internal, 1)
    for law in (on.damper and on.damper.law, getattr(on.friction, "force", None)):
        if callable(law):
            yield "law", ufl.as_ufl(law(SCALARS[0]))


@functools.cache
def _vector(size: int) -> Any:
    """A vector of symbols."""
    return ufl.as_vector([Symbol() for _ in range(size)])
