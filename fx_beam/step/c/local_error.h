/* Estimate of the local error of a step (step_control.py). */

#pragma once

#include "newton.h"

/* x becomes (x - old) / age, and old becomes x. */
HOT void difference(int n, double age, double *restrict x, double *restrict old) {
  double per_age = 1 / age;
  for (int i = 0; i < n; ++i) {
    double now = x[i];
    x[i] = (now - old[i]) * per_age, old[i] = now;
  }
}

/* Ratio of the error of a step of length dt to what is allowed, from the configurations at its start, which is in `saved`, and
   at its end: by what a polynomial through the last configurations does not predict of the step. Negative in the first
   steps. */
HOT double local_error(Problem *p, const Work *w, double dt) {
  int n = p->dofs, order = p->scheme_order;
  double ages[MAX_ORDER + 1] = {dt}, product = dt, *now = w->scratch, *last = p->error_highest, *before = last + n;
  for (int k = 0; k < order; ++k) product *= ages[k + 1] = p->error_ages[k] + dt;
  for (int i = 0; i < n; ++i) now[i] = (p->q[i] - w->saved[i]) / dt;
  for (int k = 0; k < order; ++k) difference(n, ages[k + 1], now, p->error_past + k * n);
  memcpy(p->error_ages, ages, order * sizeof(double));
  double raw = largest(n, now, p->per_unit);
  for (int i = 0; i < n; ++i) {
    double sum = now[i] + 2 * last[i] + before[i];
    before[i] = last[i], last[i] = now[i], now[i] = sum / 4;
  }
  if (++p->known_errors < order + AVERAGED) return -1;
  return product * fmax(p->smooth * largest(n, now, p->per_displacement), p->raw * raw);
}
