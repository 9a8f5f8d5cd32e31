/* Sums, maxima and rotations. */

#pragma once

#include <string.h>
#include "vectors.h"
#include "work.h"

/* Largest |x| / unit; not finite if an x is not finite. Computed in LANES lanes for vectorisation. */
static double largest(int n, const double *x, const double *per_unit) {
  double top[LANES] = {0}, all[LANES] = {0};
  for (int i = 0; i < n; i += LANES)
    for (int l = 0; l < LANES && i + l < n; ++l) {
      double size = fabs(x[i + l]) * per_unit[i + l];
      top[l] = top[l] < size ? size : top[l];
      all[l] += size;
    }
  double found = 0, sum = 0;
  for (int l = 0; l < LANES; ++l) {
    found = found < top[l] ? top[l] : found;
    sum += all[l];
  }
  return isnan(sum) ? sum : found;
}

static void times_mass(const Problem *p, const double *x, double *out) {
  for (int i = 0; i < p->dofs; ++i) {
    double sum = 0;
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k)
      sum += p->mass[k] * x[p->mass_column[k]];
    out[i] = sum;
  }
}

/* Product of a row of the full tangent and a vector. */
static double row_times(const Problem *p, const double *tangent, int row, const double *x) {
  double sum = 0;
  for (int k = p->row_start[row]; k < p->row_start[row + 1]; ++k)
    sum += tangent[p->place[k]] * x[p->column_of[k]];
  return sum;
}

/* Value at a degree of freedom; zero for the ground, -1. */
static inline double at(const double *x, int dof) { return dof < 0 ? 0 : x[dof]; }

static void turn(double psi, double x, double y, double *out) {
  double c = cos(psi), s = sin(psi);
  out[0] = c * x - s * y, out[1] = s * x + c * y;
}
