"""A bimetal strip over a heat source: two fields on one mesh, one by dolfinx alone.

A shallow arch of two metals is clamped at both ends above a heater. Heat makes it lose its curvature
until it snaps down... or up: the metal that expands more is below, so that it snaps away from the
heater, cools, and snaps back: a thermal relay. Objective: to couple a heat equation, written as any
problem of dolfinx, to the motion of a scene on the same mesh.

1. Heat. The temperature T(s, t) above that of the air obeys

       c T' = (k T_s)_s - 2 h / d T + q(y),   T = 0 at both ends,

   with heat capacity c per volume, conductivity k, film coefficient h, thickness d, and a source
   q(y) = q0 exp(-(y - y0)/l) that fades with the height y of the strip above the heater. It is a
   problem of dolfinx on `problem.mesh`, by the implicit Euler rule, after each step of the motion.
2. Strain. A bimetal of layers d/2 with expansions a1 (above) and a2 (below), of equal stiffness, has
   the natural strain (a1 + a2)/2 T, and the natural curvature 3/2 (a1 - a2) T / d (Timoshenko 1925,
   doi 10.1364/JOSA.11.000233). Both are `problem.natural_strains`.

Check: a strip that does not move has the steady temperature of the closed form
T = q d / (2 h) (1 - cosh(m (s - L/2)) / cosh(m L/2)), m^2 = 2 h / (k d).
Units are metre, kilogram, second and kelvin.
"""

import logging

from petsc4py import PETSc

import ufl
from dolfinx import fem, plot as to_vtk
from dolfinx.fem.petsc import LinearProblem

import numpy as np

import fx_beam as fb
from fx_beam import fenicsx
from shared import script

log = logging.getLogger("fx_beam.demo")

SPAN, RISE, THICK, WIDTH = 0.1, 1.5e-3, 0.4e-3, 10e-3  # [m]
STRIP = fb.Section.rectangle(height=THICK, width=WIDTH, E=170e9, nu=0.3, rho=8100.0)
ABOVE, BELOW = 1.2e-6, 20e-6  # expansion of Invar and of steel with nickel and manganese [1/K]
CAPACITY, CONDUCTIVITY = 4e6, 13.0  # c [J/(m^3 K)], k [W/(m K)]
FILM = 400.0  # h, with a fan [W/(m^2 K)]
SOURCE, NEAR = 3e8, 1.2e-3  # q0 [W/m^3] at the height of the clamps, l [m]
ELEMENTS, DEGREE = 24, 1
DAMPING = 2e-4  # retardation time [s]
DT, T_END = 5e-3, 12.0  # [s]
