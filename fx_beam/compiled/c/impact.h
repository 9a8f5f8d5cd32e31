/* One-sided springs, and friction that depends on a rate (impact.py). */

#pragma once

#include "problem.h"

/* Force of a one-sided spring that opens from the gap g0 to g1, and its slope by g1. */
static double push(double k, double g0, double g1, double level, double *slope) {
  double deep0 = fmax(-g0, 0), deep1 = fmax(-g1, 0), part = 1, by_part = 1;
  if (level != 0.5) {
    double deep = fmax(-(g0 + level * (g1 - g0)), 0);
    *slope = deep > 0 ? -level * k : 0;
    return k * deep;
  }
  if (g0 >= 0 && g1 >= 0) return *slope = 0;
  if (g0 >= 0)
    part = deep1 / (g0 - g1), by_part = part * (2 - part);
  else if (g1 >= 0)
    part = deep0 / (g1 - g0), by_part = part * part;
  *slope = -k / 2 * by_part;
  return k * part * (deep0 + deep1) / 2;
}

/* Derivative of tanh(x) with which Newton's method does not jump to and fro. */
static double friction_slope(Rubbing *last, double x) {
  double y = tanh(x), s = 1, bend = 2 * x / 3;
  if (fabs(x) >= 1e-4) s = x / y, bend = (1 - (1 - y * y) * s) / y;
  double expected = last->y + last->slope * (x - last->x);
  expected = last->repeated ? fmin(1, fmax(-1, expected)) : y;
  last->repeated = 1, last->x = x, last->y = y, last->slope = (1 - expected * bend) / s;
  return last->slope;
}
