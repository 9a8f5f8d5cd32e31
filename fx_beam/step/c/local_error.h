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
  int n = p->dofs, order = p->scheme_order;
  double product = dt, per_age[PAST + 1], *mean = w->scratch, *highest = w->acc, *last = p->error_highest, *before = last + n;
  advance_ages(dt, p->error_ages, per_age);
  for (int k = 1; k <= order; ++k) product *= p->error_ages[k];
  for (int i = 0; i < n; ++i) mean[i] = p->q[i] - w->saved[i];
  double moved = largest(n, mean, p->per_error);
  extend_differences(n, n, mean, per_age, p->error_past, highest);
  const double *now = order < PAST ? p->error_past + order * n : highest;
  double raw = largest(n, now, p->per_unit), displaced = largest(n, now, p->per_error);
  for (int i = 0; i < n; ++i)
    mean[i] = (now[i] + 2 * last[i] + before[i]) / 4, before[i] = last[i], last[i] = now[i];
  if (++p->known_errors < order + AVERAGED) return -1;
  double fine = product * fmax(p->smooth * largest(n, mean, p->per_error), p->raw * raw);
  return fmax(fine, p->coarse * (product * displaced - RESOLVED * moved));
}
