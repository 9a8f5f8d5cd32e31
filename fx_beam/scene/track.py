"""Where node b is on node a: the law of a joint that slides."""

from __future__ import annotations

from typing import Any


class Track:
    """A straight line through the joint's offset, in the frame of a.

    Another joint has another one as its `track`: functions of its `axis` (2, ...) and of the slide,
    analytic in both, and the same as a `Track` of step/c/track.h, with its number there.
    """

    number = 0

    @staticmethod
    def place(axis: Any, slide: Any) -> tuple[Any, Any]:
        """Components of the way from the offset to b [m]."""
        return slide * axis[0], slide * axis[1]

    @staticmethod
    def tangent(axis: Any, slide: Any) -> tuple[Any, Any]:
        """Unit vector of the slide: the derivative of the place."""
        return axis[0] + 0 * slide, axis[1] + 0 * slide

    @staticmethod
    def nearest(axis: Any, x: Any, y: Any) -> Any:
        """Slide of the place that is nearest to a point (x, y), seen from the offset [m]."""
        return x * axis[0] + y * axis[1]
