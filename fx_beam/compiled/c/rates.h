/* Nodal rates from the increment over a step (rates.py). */

#pragma once

#include "algebra.h"

static void work_increment(const Problem *p, const Work *w) {
  double *D = w->D, *path = w->path, *slope = w->slope, *tangent = w->left;
  memcpy(path, D, p->dofs * sizeof *D);
  for (int i = 0; i < p->dofs; ++i) slope[i] = 1;
  if (p->rule != 0) return;
  for (int i = 0; i < p->turning; ++i) tangent[i] = D[p->turns[i]] / 2;
  /* A separate loop without indirect addressing, so that it is vectorised. */
  for (int i = 0; i < p->turning; ++i) tangent[i] = sin(tangent[i]) / cos(tangent[i]);
  for (int i = 0; i < p->turning; ++i) {
    int k = p->turns[i];
    path[k] = 2 * tangent[i], slope[k] = 1 + tangent[i] * tangent[i];
  }
}

static double newmark_end(const Problem *p, double D, double v0, double a0, double dt) {
  return (D - dt * v0) / (p->beta * dt * dt) - (1 / (2 * p->beta) - 1) * a0;
}

static void acceleration(const Problem *p, const Work *w, double dt) {
  for (int i = 0; i < p->dofs; ++i)
    if (p->rule == 0)
      w->acc[i] = 2 / dt * (w->path[i] / dt - p->v[i]);
    else {
      double a1 = newmark_end(p, w->D[i], p->v[i], p->a[i], dt);
      w->acc[i] = (1 - p->alpha_m) * a1 + p->alpha_m * p->a[i];
    }
}

/* Derivative of the acceleration with respect to the increment of `work_increment`. */
static double steepness(const Problem *p, double dt) {
  return (p->rule == 0 ? 2 : (1 - p->alpha_m) / p->beta) / (dt * dt);
}

static void advance_rates(Problem *p, const Work *w, double dt) {
  for (int i = 0; i < p->dofs; ++i) {
    double v0 = p->v[i];
    if (p->rule == 0)
      p->v[i] = 2 / dt * w->path[i] - v0, p->a[i] = (p->v[i] - v0) / dt;
    else {
      double a1 = newmark_end(p, w->D[i], v0, p->a[i], dt);
      p->v[i] = v0 + dt * ((1 - p->gamma) * p->a[i] + p->gamma * a1), p->a[i] = a1;
    }
    w->left[i] = v0;
  }
  for (int k = 0; k < p->massless_count; ++k) {
    int i = p->massless[k];
    p->v[i] = w->path[i] / dt, p->a[i] = (p->v[i] - w->left[i]) / dt;
  }
}
