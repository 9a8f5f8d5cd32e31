/* Numbers in which scenes of one structure differ. */

#pragma once

#include "tables.h"

/* Numbers of the elements of an integral, [block][..][lane]: coordinates x and y of each place. Coefficients that do not move: blocks
   with equal ones share them, so that each has its number among those stored. */
typedef struct { const Integral *of; const double *coordinates, *data; const int *data_at; } Cells;

/* Compiled forms that are evaluated together: one integral for each law. */
typedef struct { int integrals; const FormTables *tables; Cells *cells; double *constants; } Form;

/* Forms of the beams: internal forces and drag, each with its tangent; energies lost to drag, to the material and to the scheme,
   and held by it, also at the start with the parameters of the step; increments of the internal variables, each times the weight
   of its point; work of natural strains that change. */
typedef struct {
  Form internal_forces, energy, inversion, added, drag, lost_to_drag, lost, taken, held_by_scheme, held_before, evolution, actuated;
} Forms;

/* A frame that turns: arms of the displacements in the reference, and square of its spin. */
typedef struct { const double *arm; double spin_squared; } Frame;

/* Numbers of a scene: positions [node][x, y]; 1 / size of a unit correction of each degree of freedom, and the same for errors of
   steps; mass, the same, and rotary inertia of each pair of nodes, with a number behind all; weights with which a viscosity resists
   increments; offset and axis of joints in the frame of the carrier; [gear][weight, weight, sum at rest]; strains of unit natural
   strains, forces of unit loads, and the weight of all nodes; values of parameters with which forms and laws are evaluated, those
   of the state where they do not vary. */
typedef struct {
  const double *position, *per_unit, *per_error, *mass, *viscous_weight, *offset, *axis, *gears, *natural, *load_force, *weight;
  double *parameters; Forms forms; PointForces *points; Frame frame;
} Numbers;
