"""Load factors and shapes of linear buckling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fx_beam.scene.beam import Beam
from fx_beam.scene.body import Body

from .vibrations import Modes


@dataclass(frozen=True, repr=False)
class BucklingModes:
    r"""Linear buckling: load factors and shapes, lowest load factor first; made by `buckling`.

    Parameters
    ----------
    load_factors : (n,) float
        Load factors :math:`\lambda`, positive, in rising order.
    modes : Modes
        Shapes of the modes, for pictures; their frequencies are zero.

    Examples
    --------
    Euler's column on two hinges, :math:`\pi^2 EI / L^2`.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
    >>> column = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -1.0))
    >>> found = fb.buckling(scene, n=2)
    >>> (found.load_factors / math.pi**2).round(4)
    array([1., 4.])
    >>> found.shape(column, mode=0, size=0.1).shape
    (25, 2)
    """

    load_factors: np.ndarray
    modes: Modes

    def __len__(self):
        return len(self.load_factors)

    def __repr__(self):
        return f"<BucklingModes: load factors {', '.join(f'{x:.6g}' for x in self.load_factors)}>"

    def shape(self, beam: Beam | Body | str, mode: int, size: float) -> np.ndarray:
        """Axis of a beam, or nodes of a body, displaced by a mode.

        Parameters
        ----------
        beam : Beam, Body or str
            A beam or its name, or a body.
        mode : int
            Number of the mode, from 0.
        size : float
            Largest displacement of a node of the scene [m].

        Returns
        -------
        (elements * degree + 1, 2) float
            Positions of its nodes [m], as of `Modes.shape`.
        """
        return self.modes.shape(beam, mode, size)
