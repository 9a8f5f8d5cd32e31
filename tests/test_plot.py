"""What pictures draw of a beam: its elements as they are, not lines between their nodes."""

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb

plot = pytest.importorskip("fx_beam.plot")
pytestmark = pytest.mark.plot


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_is_drawn_goes_through_the_nodes_and_between_them_along_the_polynomial(degree):
    x = np.linspace(-1, 2, 3 * degree + 1)  # of three elements
    nodes = np.array([np.column_stack([x, factor * x**degree]) for factor in (1.0, -2.0)])
    drawn = plot.axis(nodes, degree)
    assert drawn[..., 1] == pytest.approx([[1], [-2]] * drawn[..., 0] ** degree, abs=1e-13)
    lines = (drawn.shape[1] - 1) // (3 * degree)
    assert lines * 3 * degree == drawn.shape[1] - 1
    np.testing.assert_array_equal(drawn[:, ::lines], nodes)
    assert (np.diff(drawn[..., 0]) > 0).all()
    np.testing.assert_array_equal(plot.axis(nodes[1], degree), drawn[1])


@pytest.mark.parametrize("degree", [2, 3])
def test_half_a_circle_of_three_elements_is_drawn_round(degree):
    def off_the_circle(points):
        """Largest distance of the lines between points from the circle of radius 1."""
        middles = (points[1:] + points[:-1]) / 2
        return max(abs(np.hypot(*part.T) - 1).max() for part in (points, middles))

    scene = fb.Scene()
    beam = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), FLYING, elements=3, degree=degree)
    nodes = fb.simulate(scene, dt=0.1, t_end=0.1).shape(beam)[0]
    assert off_the_circle(nodes) > 0.01
    # As round as the elements are.
    assert off_the_circle(plot.axis(nodes, degree)) < {2: 5e-3, 3: 2e-3}[degree]


def test_the_window_of_a_picture_holds_what_curves_between_nodes():
    scene = fb.Scene()
    beam = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), FLYING, elements=1, degree=3)
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    nodes = solution.shape(beam)
    top = plot.axis(nodes, beam.degree)[..., 1].max()
    assert top > 1.1 * nodes[..., 1].max()
    assert plot._window(solution, [0, 1])[1][1] > top
