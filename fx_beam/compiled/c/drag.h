/* Drag on nodes (node_drag.py). */

#pragma once

#include "algebra.h"

/* Forces and moment at rates v; returns linear + quadratic |v|. */
static double resist(const double *factors, const double *v, double *out) {
  double along = factors[0] + factors[1] * hypot(v[0], v[1]);
  out[0] = along * v[0], out[1] = along * v[1], out[2] = factors[2] * v[2];
  return along;
}

static void add_drags(const Problem *p, const Work *w, double *f, double *K) {
  double level = 2 * p->level;
  for (int i = 0; i < p->drags; ++i) {
    const int *dof = p->drag_dofs + 3 * i, *place = p->drag_places + 5 * i;
    const double *factors = p->drag_factors + 3 * i;
    double v[3], force[3], scale[3];
    for (int k = 0; k < 3; ++k) {
      double v0 = p->v[dof[k]];
      v[k] = v0 + level * (w->path[dof[k]] / w->dt - v0);
      scale[k] = level * w->slope[dof[k]] / w->dt;
    }
    double along = resist(factors, v, force), speed = hypot(v[0], v[1]);
    double bent = speed > 0 ? factors[1] / speed : 0;
    for (int k = 0; k < 3; ++k) f[dof[k]] += force[k];
    K[place[0]] += scale[0] * (along + bent * v[0] * v[0]);
    K[place[1]] += scale[1] * bent * v[0] * v[1];
    K[place[2]] += scale[0] * bent * v[0] * v[1];
    K[place[3]] += scale[1] * (along + bent * v[1] * v[1]);
    K[place[4]] += scale[2] * factors[2];
  }
}

/* Energy that they take in the step at the mean rates. */
static double lost_to_drags(const Problem *p, const Work *w) {
  double sum = 0;
  for (int i = 0; i < p->drags; ++i) {
    double v[3], force[3];
    for (int k = 0; k < 3; ++k) v[k] = w->path[p->drag_dofs[3 * i + k]] / w->dt;
    resist(p->drag_factors + 3 * i, v, force);
    for (int k = 0; k < 3; ++k) sum += force[k] * v[k] * w->dt;
  }
  return sum;
}
