"""Influence lines: what a unit force at each place along beams gives to outputs."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.equilibria.statics import static
from fx_beam.errors import SceneError, real_array, require, vector
from fx_beam.motions.motion_setup import check_scene
from fx_beam.scene.beam import Beam, BeamPlace
from fx_beam.scene.outputs import Output, check_linear, is_section_force
from fx_beam.scene.scene import Scene

from .static_response import StaticResponse

# Places along the beams, if none are given.
_PLACES = 101
# Displacement without loads, relative to the size of the scene, that is round-off.
_STILL = 1e-9


class InfluenceLines(NamedTuple):
    """Influence lines along beams.

    Returned by `influence`.

    Parameters
    ----------
    s : (places,) float
        Arc lengths of the force [m], from the start of the first beam on.
    values : dict of (places, ...) float
        Each output under a force of 1 N there, by name, in its unit.

    Examples
    --------
    >>> import numpy as np, fx_beam as fb
    >>> lines = fb.InfluenceLines(np.array([0.0, 1.0, 2.0]), {"M": np.array([0.0, 0.5, 0.0])})
    >>> print(lines.s[lines.values["M"].argmax()])
    1.0
    """

    s: np.ndarray
    values: dict[str, np.ndarray]


def influence(
    scene: Scene,
    outputs: Mapping[str, Output],
    along: Beam | Sequence[Beam],
    direction: Sequence[float] = (0.0, -1.0),
    s: Any = None,
) -> InfluenceLines:
    """Compute influence lines: outputs under a unit force at each place along beams.

    The values are those of ``static(scene, linear=True)`` under this force alone, found by
    reciprocity: one solution for each output, not for each place.

    Parameters
    ----------
    scene : Scene
        The scene; its loads and natural strains do not act.
    outputs : dict
        `Output` by names: displacements, reactions, forces of joints and lines, section forces,
        stresses.
    along : Beam or sequence of Beam
        The path of the force: a beam, or several beams, one behind the other.
    direction : (2,) float
        Direction of the force, of any length; by default downwards.
    s : (places,) float, optional
        Arc lengths of the force from the start of the first beam on [m]; by default 101 places from
        end to end.

    Returns
    -------
    InfluenceLines
        The places, and the values there. If the force is at the place of a section force, the
        section is just behind it.

    Raises
    ------
    SceneError
        For beams and outputs of other scenes, and places beyond the beams; if a motor or a
        prescribed motion moves the scene; and in the cases of `static` and `StaticResponse`.

    Examples
    --------
    The moment in the middle of a beam on two supports is largest under a force there, F L / 4.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (8, 0)], fb.Section(EA=1e8, GA=1e8, EI=1e6))
    >>> scene.pin(beam.start)
    >>> scene.fix(beam.end, "y")
    >>> lines = fb.influence(scene, {"M": fb.Output("M", beam.at(4.0))}, beam)
    >>> place = abs(lines.values["M"]).argmax()
    >>> print(lines.s[place].round(6), abs(lines.values["M"][place]).round(6))
    4.0 2.0
    """
    check_scene(scene, "influence")
    check_linear(scene, outputs, "influence")
    way = floats(vector(direction, 2, "influence: direction"))
    require(bool(way.any()), "influence: direction", direction, "not zero")
    arcs, places = _places(scene, along, s)
    bare, own_outputs, own_places = copy.deepcopy((scene, dict(outputs), places))
    bare.loads.clear()
    bare.natural_strains.clear()
    bare.gravity = (0.0, 0.0)
    rest = static(bare, linear=True)
    if abs(np.diff(rest.q, axis=0)).max() > _STILL * np.ptp(rest.X):
        raise SceneError(
            "influence: without loads the scene does not rest: a motor or a prescribed motion, a "
            "pressure or an added virtual work acts. Remove it from a copy of the scene"
        )
    # Forces inside the element of a section apart: there N, Q and M go on in another way.
    sections: list[Any] = [output.of for output in outputs.values() if is_section_force(output)]
    apart = {(place.beam.name, place.element[0]) for place in sections}
    groups = dict[Any, list[int]]()
    for i, place in enumerate(places):
        key = place.beam.name, place.element[0]
        groups.setdefault(key if key in apart else None, []).append(i)
    values, unit = dict[str, np.ndarray](), way / np.hypot(*way)
    for chosen in groups.values():
        lines = _lines(bare, own_outputs, [own_places[i] for i in chosen], unit)
        for name, rows in lines.items():
            values.setdefault(name, np.empty((len(arcs), *rows.shape[1:])))[chosen] = rows
    return InfluenceLines(arcs, values)


def _places(scene: Scene, along: Any, s: Any) -> tuple[np.ndarray, list[BeamPlace]]:
    """Arc lengths (n,) from the start of the first beam on, and places there."""
    beams = [along] if isinstance(along, Beam) else along
    ok = isinstance(beams, list | tuple) and len(beams) > 0
    ok = ok and all(any(beam is own for own in scene.beams) for beam in beams)
    require(ok, "influence: along", along, "one or more beams of the scene")
    ends = np.cumsum([0.0, *(float(beam.length) for beam in beams)])
    arcs = np.linspace(0.0, ends[-1], _PLACES) if s is None else floats(real_array(s))
    ok = arcs.ndim == 1 and len(arcs) > 0 and bool(((arcs >= 0) & (arcs <= ends[-1])).all())
    require(ok, "influence: s", s, f"arc lengths from 0 to that of the beams, {ends[-1]:g}")
    numbers = np.clip(np.searchsorted(ends, arcs) - 1, 0, None)
    return arcs, [beams[i].at(arc - ends[i]) for i, arc in zip(numbers, arcs, strict=True)]


def _lines(
    bare: Scene, outputs: Mapping[str, Output], places: list[BeamPlace], unit: np.ndarray
) -> dict[str, np.ndarray]:
    """Outputs (places, ...) of a scene without loads under a force at each of some places."""

    def build(x):
        loaded, loaded_outputs, own_places = copy.deepcopy((bare, outputs, places))
        for place, size in zip(own_places, x, strict=True):
            loaded.add_force(place, (size * unit[0], size * unit[1]))
        return loaded, loaded_outputs

    run, lines = StaticResponse(build, load_steps=1), dict[str, np.ndarray]()
    for name, rows in run(np.zeros(len(places)))[1].items():
        components = np.eye(rows[-1].size).reshape(-1, *rows.shape[1:])
        slopes = []
        for component in components:
            weights = np.zeros_like(rows)
            weights[-1] = component
            slopes.append(run.vjp({name: weights}))
        lines[name] = np.transpose(slopes).reshape(-1, *rows.shape[1:])
    return lines
