/* Estimate of the local error of a step (step_control.py). */

#pragma once

#include "newton.h"

/* Part of a motion in a step that is not predicted, up to which the step is fine enough for the local error to be that of the
   scheme's order. */
static const double RESOLVED = 0.05;

/* Ratio of the error of a step of length dt to what is allowed, from the configurations at its start, which is in `saved`, and
   at its end: by what a polynomial through the last configurations does not predict of the step. Negative in the first
   steps. */
HOT double local_error(Problem *p, const Work *w, double dt) {
  int n = p->dofs, order = p->control.scheme_order;
  double product = dt, per_age[PAST + 1], *mean = w->scratch, *highest = w->acc, *last = p->control.last, *before = last + n;
  advance_ages(dt, p->control.ages, per_age);
  for (int k = 1; k <= order; ++k) product *= p->control.ages[k];
  for (int i = 0; i < n; ++i) mean[i] = p->state.q[i] - w->saved[i];
  double moved = largest(n, mean, p->mesh.per_error);
  extend_differences(n, n, mean, per_age, p->control.past, highest);
  const double *now = order < PAST ? p->control.past + order * n : highest;
  double raw = largest(n, now, p->mesh.per_unit), displaced = largest(n, now, p->mesh.per_error);
  for (int i = 0; i < n; ++i)
    mean[i] = (now[i] + 2 * last[i] + before[i]) / 4, before[i] = last[i], last[i] = now[i];
  if (++p->control.known < order + AVERAGED) return -1;
  double fine = product * fmax(p->control.limits.smooth * largest(n, mean, p->mesh.per_error), p->control.limits.raw * raw);
  return fmax(fine, p->control.limits.coarse * (product * displaced - RESOLVED * moved));
}
