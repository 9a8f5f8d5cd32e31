/* Follower forces (follower_loads.py). */

#pragma once

#include "algebra.h"

static void turned_thrust(const Problem *p, const Work *w, int i, double *out) {
  int psi = p->thrust_dofs[3 * i + 2];
  turn(p->q[psi] + p->level * w->D[psi], w->thrust[2 * i], w->thrust[2 * i + 1], out);
}

static void add_thrusts(const Problem *p, const Work *w, double factor, double *out) {
  for (int i = 0; i < p->thrusts; ++i) {
    double F[2];
    turned_thrust(p, w, i, F);
    for (int k = 0; k < 2; ++k) out[p->thrust_dofs[3 * i + k]] += factor * F[k];
  }
}

static void add_thrust_tangent(const Problem *p, const Work *w, double *K) {
  for (int i = 0; i < p->thrusts; ++i) {
    double F[2];
    turned_thrust(p, w, i, F);
    K[p->thrust_places[2 * i]] += p->level * F[1];
    K[p->thrust_places[2 * i + 1]] -= p->level * F[0];
  }
}
