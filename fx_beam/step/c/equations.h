/* The equations of a sub-step for those who solve them in another way (equations.py): arc length, small motions and initial
   states. */

#pragma once

#include "newton.h"

/* Begins a sub-step from the state, at a time. */
OF_STEPS void fx_begin(Problem *p, double t, double dt, double *follower_force) {
  Work work = work_of(p), *w = &work;
  p->state.t = t, w->dt = dt, w->follower_force = follower_force;
  begin_couplings(p, w);
}

/* Sets its end for the elements, in statics with the load factor. Laws at points go on with what they remember of the iterations so far. */
OF_STEPS void fx_end_at(Problem *p, double dt, double ratio) {
  Work work = work_of(p), *w = &work;
  w->dt = dt;
  p->state.ratio = p->scheme.at_rest ? ratio : ratio_of_lengths(p, dt);
  begin_elements(p, w);
}

/* Forces, residual and tangent for the increments of the columns and dead forces that were set, without forces that
   hold the unknowns; returns 0 if loops cannot be closed. */
OF_STEPS int fx_balance(Problem *p, double dt) {
  Work work = work_of(p), *w = &work;
  double *hold = p->statics.hold;
  w->dt = dt, p->statics.hold = 0;
  int closed = expand(p, w);
  balance(p, w);
  p->statics.hold = hold;
  if (HAS(MEMBERS) && p->system.changing) change_rows(p);
  reduce_tangent(p, w);
  return closed;
}

/* Change of the forces with a small one of the nodes, by the last tangent; with `sizes` by the sizes of its entries. */
OF_STEPS void fx_change(const Problem *p, const double *x, int sizes, double *out) {
  Work w = work_of(p);
  const double *member_product = times_members(p->points->members, x);
  for (int i = 0; i < p->dofs; ++i) out[i] = row_times(p, w.tangent, i, sizes, x) + (member_product ? member_product[i] : 0);
}
