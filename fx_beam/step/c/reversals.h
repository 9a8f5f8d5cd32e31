/* Reversals of the slip of friction in so few sub-steps that their derivatives say nothing of its time (step/tape_derivatives.py). */

#pragma once

#include "point_forces.h"

/* Reversal with which a sub-step has to do, by the place of the stretch of the spring; 0 for none. */
static const Reversal *reversal_at(const Derivatives *a, long step, int place) {
  if (!a->reversal || step < 0) return 0;
  for (int i = a->reversal_start[step]; i < a->reversal_start[step + 1]; ++i)
    if (a->reversal[i].place == place) return a->reversal + i;
  return 0;
}

/* Stretches springs of friction at the start of a sub-step beyond their limit. */
static void stretch_bristles(const State *state, const Derivatives *a, long step) {
  if (!a->reversal || step < 0) return;
  for (int i = a->reversal_start[step]; i < a->reversal_start[step + 1]; ++i) {
    const Reversal *r = a->reversal + i;
    if (r->stretch) state->spring_internal[r->place] = r->stretch;
    if (r->force) state->spring_internal[r->place + FOLLOWED] = r->force;
  }
}

/* Changes the derivatives [force, internal variable][wide] of a law with n coordinates: its stretch is that of the time of the
   reversal, before it by the slip, then zero, and its friction in it depends on this alone. */
static void reverse(const Reversal *r, int n, int wide, int mu, int follows, double *slopes) {
  double *stretch_slopes = slopes + n * wide, *slip_slopes = stretch_slopes + wide;
  for (int k = 0; k < wide; ++k) stretch_slopes[k] = r->leads * slip_slopes[k];
  stretch_slopes[2 * n + 1] -= r->leads, stretch_slopes[2 * n] += r->keeps;
  for (int i = 0; r->stretch && i < n; ++i) {
    double *by = slopes + i * wide;
    by[2 * n] = r->pushes * by[mu], by[mu] *= r->share;
    if (follows) by[2 * n + FOLLOWED] = 0;
  }
}
