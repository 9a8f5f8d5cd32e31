"""One-sided springs whose work over a step is exact, and friction that depends on a rate."""

from __future__ import annotations

import math

import numpy as np


def push(
    stiffness: float | np.ndarray, g0: np.ndarray, g1: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Forces (n,) of one-sided springs that open from gaps g0 to g1, and their slopes by g1.

    At mid-step the mean over the way: the energy k <-g>^2 / 2 that is given up, per way. It is a
    convex function of g1 with a continuous slope. Else the force at the level of the step.
    """
    deep0, deep1 = np.maximum(-g0, 0), np.maximum(-g1, 0)
    if level != 0.5:
        deep = np.maximum(-(g0 + level * (g1 - g0)), 0)
        return stiffness * deep, -level * stiffness * (deep > 0)
    enters, leaves = (g0 >= 0) & (g1 < 0), (g0 < 0) & (g1 >= 0)
    way = np.where(enters | leaves, abs(g1 - g0), 1.0)
    # The part of the way behind the obstacle; its derivative acts where the way crosses it.
    part = np.where(enters, deep1 / way, np.where(leaves, deep0 / way, 1.0))
    force = stiffness * part * (deep0 + deep1) / 2
    inside = (g0 < 0) | (g1 < 0)
    slope = np.where(enters, part * (2 - part), np.where(leaves, part**2, inside))
    return force, -stiffness / 2 * slope


def friction_slope(x: float, last: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """x, y = tanh(x), and a derivative with which Newton's method does not jump to and fro.

    With s = x / y the friction is s y = x, whose linear form has the derivative (1 - y s') / s. For
    y it takes what the last iteration expected, limited to 1 (Chan, Golub and Mulet 1999, doi
    10.1137/S1064827596299767). Where both agree it is that of tanh.
    """
    if last is not None and x == last[0]:
        return last  # the same iteration
    y = math.tanh(x)
    near = abs(x) < 1e-4
    s, bend = (1.0, 2 * x / 3) if near else (x / y, (1 - (1 - y * y) * x / y) / y)
    expected = y
    if last is not None:
        expected = min(1.0, max(-1.0, last[1] + last[2] * (x - last[0])))
    return x, y, (1 - expected * bend) / s
