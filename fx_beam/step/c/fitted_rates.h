/* Rates that fit joints and supports, for Python (fitted_rates.py). All pointers are always set. */

#pragma once

#include "slider.h"

/* A node that slides on a beam, in equations of rates: whether it slides freely and turns with the beam, nodes of the beam,
   and its path alone. */
typedef struct {
  int joint, free, sleeve, nodes;
  Slider *path;
} BeamRate;

/* The equations G v = g of a scene, and their solution. */
typedef struct {
  int size, joints, columns, driven; /* degrees of freedom, joints, driven and fixed columns, driven ones */
  int count, plain, beams, all_entries;
  /* Plain equations: degrees of freedom of nodes b and a, and of those that carry them, -1 for the ground;
     arms from these to b in the reference configuration, and that from a; axis and kind of the track. */
  int *b, *a, *ends, *track;
  double *arms, *apart, *axis, *direction, *constant;
  BeamRate *beam;
  int *joint, *column;  /* of each equation, or -1 */
  int *free;            /* whether its force is across a free slide */
  double *turning;      /* whether its multiplier is a moment */
  /* Massless points that move rigidly with other nodes, carriers first: their joints, the nodes a of these
     and those that carry all; the points that are such nodes a, or nodes b and a of equations, or -1. */
  int points, *point_joint, *point_b, *point_a, *point_carrier, *point_of_point, *point_of;
  double *point_apart, *point_arm;
  int entries, *entry, *row, *dof; /* entries that may not be zero: number among all, row, degree of freedom */
  /* Unknowns are rates of `used` degrees of freedom, and negative multipliers, in an `order` of elimination.
     Entries of G: both unknowns and the place in the factors; `mobility` is the inverse of the mass. */
  int used, *used_dof, *order, *entry_rate, *entry_multiplier, *entry_at;
  double *mobility;
  int masses, *mass_row, *mass_column;
  double *mass;
  /* Factors L D L^T by columns, which begin with the diagonal: rows, and the place from which each product of
     two entries below it is subtracted; masses in them, with small ones of what has none. */
  int *column_start, *row_of, *target;
  double *start_of_factors;
  int others, *other_dof;          /* rates that follow from these by the masses of beams */
  double *follow;                  /* [used][others] */
} RateFit;

/* Returns 0 without memory. */
int fx_fit(const RateFit *f, int n, const double *q, const double *v, const double *slide, const double *driven,
           double *rates, double *corrections, double *joints, double *constraints, double *values);
/* Rates and negative multipliers for m right sides of each configuration. */
int fx_solve_rates(const RateFit *f, int n, int m, const double *entries, const double *right, double *x);
