/* Work space of a run: arrays in the memory `scratch` of Problem. */

#pragma once

#include "problem.h"

typedef struct {
  double *D, *path, *slope, *acc, *f, *r, *reduced, *step, *correction, *z;
  double *tangent, *inertia, *values, *hat, *psi0, *rho0, *t0, *rho1, *t1, *mean_t, *guide_slope;
  double *guide_bend, *passing, *columns, *y, *row, *start, *force, *dead, *left;
  double *saved, *rule, *loaded, *factors, *residual, *direction, *image, *guess;
  double *G, *W, *What, *part, *inverse, *gap, *gap0, *closing, *closed, *borders; /* of loops */
  double *passed, *joint_forces;
  const double *fields[6]; /* by the kinds of Form */
  double dt;
  const double *thrust;
} Work;

static double *take(double **at, long n) {
  double *p = *at;
  *at += (n + LANES - 1) / LANES * LANES;
  return p;
}

static long lay_out(const Problem *p, Work *w, double *at) {
  double *begin = at;
  long n = p->dofs, c = p->columns + p->ties, j = p->joints, u = p->unknowns;
  w->D = take(&at, n), w->path = take(&at, n), w->slope = take(&at, n);
  w->acc = take(&at, n), w->f = take(&at, n + LANES), w->r = take(&at, n);
  w->correction = take(&at, n), w->force = take(&at, n), w->dead = take(&at, n), w->left = take(&at, n);
  w->reduced = take(&at, c), w->step = take(&at, c), w->z = take(&at, c), w->columns = take(&at, c);
  w->y = take(&at, u), w->row = take(&at, p->groups ? 3 * u : 0), w->start = take(&at, c);
  w->tangent = take(&at, p->places + 4 * LANES), w->inertia = take(&at, p->places);
  w->values = take(&at, 1 + 4 * j), w->hat = take(&at, 1 + 4 * j);
  w->psi0 = take(&at, j), w->rho0 = take(&at, 2 * j), w->t0 = take(&at, 2 * j);
  w->rho1 = take(&at, 2 * j), w->t1 = take(&at, 2 * j), w->mean_t = take(&at, 2 * j);
  w->rule = take(&at, p->rules ? RULE_VALUES * (long)p->nodes : 0);
  w->saved = take(&at, p->memory_size);
  w->factors = take(&at, p->factor_size);
  long d = p->kept.worth ? DIRECTIONS : 0;
  u = p->factor_size ? p->free : 0;
  w->residual = take(&at, u), w->guess = take(&at, u);
  w->direction = take(&at, d * u), w->image = take(&at, d * u);
  w->loaded = take(&at, p->sliders ? n : 0);
  w->guide_slope = take(&at, j), w->guide_bend = take(&at, j), w->passing = take(&at, 2 * j);
  long m = p->closures, loop = m * p->loop_columns;
  w->G = take(&at, loop), w->W = take(&at, loop), w->What = take(&at, loop);
  w->part = take(&at, m * m), w->inverse = take(&at, m * m), w->gap = take(&at, m);
  w->gap0 = take(&at, m), w->closing = take(&at, m), w->closed = take(&at, m ? n : 0);
  w->borders = take(&at, p->ties ? m * p->unknowns : 0);
  w->passed = take(&at, n), w->joint_forces = take(&at, 3 * p->scene_joints);
  const double *fields[] = {w->D, p->q, p->v, p->a, p->before, p->internals};
  memcpy(w->fields, fields, sizeof fields);
  return at - begin;
}

long fx_scratch(const Problem *p) {
  Work w;
  return lay_out(p, &w, 0);
}
