"""Numbers of a scene that only outputs at places of beams read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from fx_beam.dual import dual_array
from fx_beam.scene.beam import BeamPlace
from fx_beam.scene.outputs import Output

#: Numbers (n, 2) of outputs at places: the part of the element before them, and its length.
OF_PLACES = "places of outputs"


class KnownNumbers(NamedTuple):
    """Numbers of outputs of a scene without slopes, and their rows by names of outputs."""

    values: dict[str, Any]
    places: dict[str, int]
    sections: dict[str, int]


def numbers_of_places(outputs: Mapping[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers `OF_PLACES`, if there are any, in the elements of outputs that are known."""
    numbers = []
    for name in filter(lambda key: is_at_place(known[key]), known):
        place, (element, _) = outputs[name].of, known[name].of.element
        start, end = place.beam.s[element : element + 2]
        numbers.append(((place.s - start) / (end - start), end - start))
    return {OF_PLACES: dual_array(numbers)} if numbers else {}


def is_at_place(output: Any) -> bool:
    """Whether it is an output at a place of a beam."""
    return isinstance(output, Output) and isinstance(output.of, BeamPlace)
