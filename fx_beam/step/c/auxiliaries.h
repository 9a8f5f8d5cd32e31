/* Degrees of freedom in long trees that are unknowns of the linear system (graph.py). */

#pragma once

#include "algebra.h"

/* Columns of the auxiliary unknowns in small changes z, for values of T or Tv; without values in increments. */
INLINED void change_auxiliaries(const Tables *p, const Work *w, const double *values, double *z) {
  double *auxiliary = z + p->columns;
  memset(auxiliary, 0, p->auxiliary.count * sizeof *auxiliary);
  for (int k = 0; !values && k < p->auxiliary.arms; ++k)
    auxiliary[p->auxiliary.arm_of[k]] += p->joints.sign[p->auxiliary.arm[k]] * w->arm_change[p->auxiliary.arm[k]];
  for (int k = 0; k < p->auxiliary.entries; ++k)
    if (values || p->auxiliary.value[k] == 0)
      auxiliary[p->auxiliary.of[k]] += p->auxiliary.sign[k] * (values ? values[p->auxiliary.value[k]] : 1)
          * z[p->auxiliary.column[k]];
}

/* Adds the forces on the auxiliary unknowns to those on the columns before, for values of T or Tv. */
static void collect_auxiliaries(const Tables *p, const double *virtual_map, double *out) {
  const double *auxiliary = out + p->columns;
  for (int k = p->auxiliary.entries - 1; k >= 0; --k)
    out[p->auxiliary.column[k]] += p->auxiliary.sign[k] * virtual_map[p->auxiliary.value[k]] * auxiliary[p->auxiliary.of[k]];
}
