/* Estimate of the local error of a step (step_control.py). */

#pragma once

#include "newton.h"

/* Part of a motion in a step that is not predicted, up to which the step is fine enough for the local error to be that of the
   scheme's order. */
static const double RESOLVED = 0.05;

/* Largest displacement of a node, as a length so that no direction counts more, or rotation, in units; not finite if one is not
   finite (`largest`). */
HOT double largest_change(int n, const double *x, const double *per_unit) {
  union { double square; int64_t bits; } top = {0}, length, turn;
  for (int i = 0; i < n; i += 3) {
    double along_x = x[i] * per_unit[i], along_y = x[i + 1] * per_unit[i + 1], turned = x[i + 2] * per_unit[i + 2];
    length.square = along_x * along_x + along_y * along_y, turn.square = turned * turned;
    top.bits = length.bits > top.bits ? length.bits : top.bits;
    top.bits = turn.bits > top.bits ? turn.bits : top.bits;
  }
  return sqrt(top.square);
}

/* Ratio of the error of a step of length dt to what is allowed, from the configurations at its start, which is in `saved`, and
   at its end: by what a polynomial through the last configurations does not predict of the step. Negative in the first
   steps. */
HOT double local_error(const Tables *p, const Numbers *s, Work *w, double dt) {
  int n = p->dofs, order = w->control.scheme_order;
  double product = dt, per_age[PAST + 1], *mean = w->scratch, *highest = w->acc, *last = w->control.last, *before = last + n;
  advance_ages(dt, w->control.ages, per_age);
  for (int k = 1; k <= order; ++k) product *= w->control.ages[k];
  for (int i = 0; i < n; ++i) mean[i] = w->state.q[i] - w->saved[i];
  double moved = largest_change(n, mean, s->per_error);
  extend_differences(n, n, mean, per_age, w->control.past, highest);
  const double *now = order < PAST ? w->control.past + order * n : highest;
  double raw = largest_change(n, now, s->per_unit), displaced = largest_change(n, now, s->per_error);
  for (int i = 0; i < n; ++i)
    mean[i] = (now[i] + 2 * last[i] + before[i]) / 4, before[i] = last[i], last[i] = now[i];
  if (++w->control.known < order + AVERAGED) return -1;
  double fine = product * fmax(w->control.limits.smooth * largest_change(n, mean, s->per_error), w->control.limits.raw * raw);
  return fmax(fine, w->control.limits.coarse * (product * displaced - RESOLVED * moved));
}
