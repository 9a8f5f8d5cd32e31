/* Estimate of the local error of a step (local_error.py). */

#pragma once

#include "newton.h"

/* Ratio of the error of a step of length dt to what is allowed, from the configurations at its start,
   which is in `saved`, and at its end; negative in the first steps. */
static double local_error(Problem *p, const Work *w, double dt) {
  int n = p->dofs;
  double ages[MAX_ORDER + 1] = {dt}, product = dt, *now = w->left;
  for (int k = 0; k < p->scheme_order; ++k) product *= ages[k + 1] = p->error_ages[k] + dt;
  for (int i = 0; i < n; ++i) now[i] = (p->q[i] - w->saved[i]) / dt;
  for (int k = 0; k < p->scheme_order; ++k) difference(n, ages[k + 1], now, p->error_past + k * n);
  memcpy(p->error_ages, ages, p->scheme_order * sizeof(double));
  double smooth = 0, raw = 0, *last = p->error_highest, *before = last + n;
  for (int i = 0; i < n; ++i) {
    smooth = fmax(smooth, fabs(now[i] + 2 * last[i] + before[i]) * p->per_displacement[i]);
    raw = fmax(raw, fabs(now[i]) * p->per_unit[i]);
    before[i] = last[i], last[i] = now[i];
  }
  if (++p->known_errors < p->scheme_order + AVERAGED) return -1;
  return product * fmax(p->smooth * smooth / 4, p->raw * raw);
}
