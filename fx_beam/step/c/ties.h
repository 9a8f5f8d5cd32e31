/* Degrees of freedom in long trees that are unknowns of the linear system (ties.py). */

#pragma once

#include "algebra.h"

/* Columns of the ties in increments, for the arms of the joints. */
static void increase_ties(const Problem *p, const Work *w) {
  double *tie = w->z + p->columns;
  memset(tie, 0, p->ties * sizeof *tie);
  for (int k = 0; k < p->tie_arms; ++k) {
    int i = p->tie_arm[k];
    tie[p->tie_arm_of[k]] += p->joint_sign[i] * (w->rho1[i] - w->rho0[i]);
  }
  for (int k = 0; k < p->tie_entries; ++k)
    if (p->tie_value[k] == 0) tie[p->tie_of[k]] += p->tie_sign[k] * w->z[p->tie_column[k]];
}

/* Columns of the ties in small changes z, for values of T or Tv. */
static void change_ties(const Problem *p, const double *values, double *z) {
  double *tie = z + p->columns;
  memset(tie, 0, p->ties * sizeof *tie);
  for (int k = 0; k < p->tie_entries; ++k)
    tie[p->tie_of[k]] += p->tie_sign[k] * values[p->tie_value[k]] * z[p->tie_column[k]];
}

/* Adds the forces on the ties to those on the columns before, for values of T or Tv. */
static void collect_ties(const Problem *p, const double *virtual_map, double *out) {
  const double *tie = out + p->columns;
  for (int k = p->tie_entries - 1; k >= 0; --k)
    out[p->tie_column[k]] += p->tie_sign[k] * virtual_map[p->tie_value[k]] * tie[p->tie_of[k]];
}
