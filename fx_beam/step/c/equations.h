/* The equations of a sub-step for those who solve them in another way (equations.py): arc length, small motions and initial
   states. */

#pragma once

#include "newton.h"

/* Begins a sub-step from the state, at a time. */
OF_STEPS void fx_begin(Problem *problem, double t, double dt, double *follower_force) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  w->state.t = t, w->dt = dt, w->follower_force = follower_force;
  begin_couplings(p, s, w);
}

/* Sets its end for the elements, in statics with the load factor. Laws at points go on with what they remember of the iterations so far. */
OF_STEPS void fx_end_at(Problem *problem, double dt, double ratio) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  w->dt = dt;
  w->state.ratio = p->scheme.at_rest ? ratio : ratio_of_lengths(&w->state, dt);
  begin_elements(&p->scheme, s, w);
}

/* Forces, residual and tangent for the increments of the columns and dead forces that were set, without forces that
   hold the unknowns; returns 0 if loops cannot be closed. */
OF_STEPS int fx_balance(Problem *problem, double dt) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  double *hold = w->statics.hold;
  w->dt = dt, w->statics.hold = 0;
  int closed = expand(p, s, w);
  balance(p, s, w);
  w->statics.hold = hold;
  if (HAS(MEMBERS) && w->factors.changing) change_rows(&p->system, s->points, &w->factors);
  reduce_tangent(p, s, w);
  return closed;
}

/* Change of the forces with a small one of the nodes, by the last tangent; with `sizes` by the sizes of its entries. */
OF_STEPS void fx_change(const Problem *problem, const double *x, int sizes, double *out) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers;
  const double *member_product = times_members(s->points->members, x);
  for (int i = 0; i < p->dofs; ++i)
    out[i] = row_times(&p->tangent, problem->work.tangent, i, sizes, x) + (member_product ? member_product[i] : 0);
}
