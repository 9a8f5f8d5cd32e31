/* Degrees of freedom in long trees that are unknowns of the linear system (graph.py). */

#pragma once

#include "algebra.h"

/* Columns of the auxiliary unknowns in small changes z, for values of T or Tv; without values in increments. */
INLINED void change_auxiliaries(const Problem *p, const Work *w, const double *values, double *z) {
  double *auxiliary = z + p->columns;
  memset(auxiliary, 0, p->auxiliaries * sizeof *auxiliary);
  for (int k = 0; !values && k < p->auxiliary_arms; ++k)
    auxiliary[p->auxiliary_arm_of[k]] += p->joint_sign[p->auxiliary_arm[k]] * w->arm_change[p->auxiliary_arm[k]];
  for (int k = 0; k < p->auxiliary_entries; ++k)
    if (values || p->auxiliary_value[k] == 0)
      auxiliary[p->auxiliary_of[k]] += p->auxiliary_sign[k] * (values ? values[p->auxiliary_value[k]] : 1) * z[p->auxiliary_column[k]];
}

/* Adds the forces on the auxiliary unknowns to those on the columns before, for values of T or Tv. */
static void collect_auxiliaries(const Problem *p, const double *virtual_map, double *out) {
  const double *auxiliary = out + p->columns;
  for (int k = p->auxiliary_entries - 1; k >= 0; --k)
    out[p->auxiliary_column[k]] += p->auxiliary_sign[k] * virtual_map[p->auxiliary_value[k]] * auxiliary[p->auxiliary_of[k]];
}
