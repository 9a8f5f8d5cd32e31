/* The derivatives of a run, backwards (docs/theory/derivatives.md): from the derivatives of a function of
   the states at the ends of sub-steps to those by all numbers of the scene. In the comments J is this function,
   and "by x" its derivative by x; the vector x has those by all numbers of a sub-step. */

#pragma once

#include "element_derivatives.h"
#include "kept_factors.h"

static long lay_out_backward(const Problem *p, const Adjoint *a, Linear *l, Backward *b, double **trial, double *at) {
  double *begin = at;
  long n = p->dofs + LANES;
  lay_out_linear(p, l, &at);
  b->by_increment = allocate(&at, n), b->by_start = allocate(&at, n), b->by_previous = allocate(&at, n);
  b->of_internal = allocate(&at, (long)p->cells * p->cell_internal);
  b->following.size = p->points->followed.size;
  b->following.memory = allocate(&at, FIXED_POINT_ROWS * (long)b->following.size);
  *trial = allocate(&at, fx_layout(p, a).size);
  return at - begin;
}

OF_DERIVATIVES long fx_backward_scratch(const Problem *p, const Adjoint *a) {
  Linear l;
  Backward b;
  double *trial;
  return lay_out_backward(p, a, &l, &b, &trial, 0);
}

/* The transpose of the reduced tangent in its place; sparse factors are made of the transpose, and bordering rows are
   transposed already. */
static void swap(double *x, double *y) {
  double kept = *x;
  *x = *y, *y = kept;
}

static void transpose_tangent(const Problem *p, const Work *w) {
  double *K = w->tangent;
  if (HAS(CHAIN)) {
    for (int g = 0; g < p->chain; ++g)
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          double *own = K + g * GROUP;
          if (i < j) swap(own + i * ROW + OWN + j, own + j * ROW + OWN + i);
          if (g + 1 < p->chain) swap(own + i * ROW + AFTER + j, own + GROUP + j * ROW + BEFORE + i);
        }
  } else {
    long width = 2 * p->band + 1;
    for (int i = 0; i < p->free; ++i)
      for (int j = 1; j <= p->band && i + j < p->free; ++j)
        swap(K + i * width + p->band + j, K + (i + j) * width + p->band - j);
  }
}

/* Solves with the transposed tangent: `step` from `reduced`; returns 0 if it is singular. */
static int solve_transposed(Problem *p, const Work *w, const Adjoint *a) {
  double rest[2];
  Problem turned = *p;
  p->kept.present = 0;
  if (HAS(MEMBERS) && p->changing) {
    if (!factorise_changing_transposed(p, w)) return 0;
    by_factors(p, w, w->reduced, w->step);
    return 1;
  }
  turned.factor_at = a->transposed_at, turned.kept.present = 0;
  if (HAS(CHAIN | BAND)) transpose_tangent(p, w);
  return solve_reduced(&turned, w, 0, rest);
}

/* Adds the derivatives of J by the state at a boundary between sub-steps itself to those by the state. */
static void add_given(const Problem *p, const Adjoint *a, const Layout *at, long boundary, double *x) {
  long k = a->weight_at[boundary], n = p->dofs;
  if (k < 0) return;
  for (int i = 0; i < n; ++i) x[at->q + i] += a->q_weight[k * n + i], x[at->v + i] += a->v_weight[k * n + i];
  for (int j = 0; j < p->joints; ++j)
    if (p->slide_column[j] >= 0) x[at->Y + p->slide_column[j]] += a->slide_weight[k * p->scene_joints + p->slide_of[j]];
  for (const Slider *s = p->slider; s < p->slider + p->sliders; ++s)
    x[at->Y + s->column] += a->slide_weight[k * p->scene_joints + s->joint];
  long m = (long)p->cells * p->cell_internal;
  for (long i = 0; a->internal_weight && i < m; ++i) x[at->internal + i] += a->internal_weight[k * m + i];
  m = p->spring_width;
  for (long i = 0; a->internal_weight && i < m; ++i) x[at->spring_internal + i] += a->spring_weight[k * m + i];
}

/* Begins a sub-step with the derivatives by the state at its end, which are those by the start of the next one. */
static void begin_vjp(const Problem *p, const Work *w, const Adjoint *a, const Layout *at, long k, double *x) {
  int n = p->dofs, columns = p->columns + p->auxiliaries;
  double per_dt = rates_per_path(p, w->dt), *q = x + at->q, *q1 = x + at->q1, *v = x + at->v, *previous = x + at->q_previous;
  add_given(p, a, at, k + 1, x);
  memset(x + at->loads, 0, (at->Y1 - at->loads) * sizeof(double));
  memset(x + at->arms, 0, (at->size - at->arms) * sizeof(double));
  memcpy(x + at->Y1, x + at->Y, columns * sizeof(double)), memset(x + at->Y, 0, columns * sizeof(double));
  memcpy(x + at->internal1, x + at->internal, (at->spring_internal - at->internal) * sizeof(double));
  memcpy(x + at->springs1, x + at->spring_internal, p->spring_width * sizeof(double));
  memcpy(x + at->natural1, x + at->natural, (at->loads - at->natural) * sizeof(double));
  memset(x + at->internal, 0, (at->loads - at->internal) * sizeof(double));
  for (int i = 0; i < p->massless_count; ++i) v[p->massless[i]] /= 2;
  for (int i = 0; i < n; ++i) {
    double of_path = per_dt * w->slope[i] * v[i];
    q1[i] = q[i] + of_path, q[i] = previous[i] - of_path, previous[i] = 0, v[i] = -v[i];
  }
  for (int i = 0; i < p->massless_count; ++i) v[p->massless[i]] = 0;
}

/* The derivatives by the forces of driven and fixed columns, and of joints; none by the equations. */
static void begin_forces(const Problem *p, const Adjoint *a, const Layout *at, long row, double *x) {
  int constrained = p->columns - p->free, joints = 3 * p->scene_joints;
  memset(x + at->R, 0, (at->closing - at->R) * sizeof(double));
  if (row < 0) return;
  memcpy(x + at->R + p->free, a->constraint_weight + row * constrained, constrained * sizeof(double));
  memcpy(x + at->forces, a->joint_weight + row * joints, joints * sizeof(double));
}

static void vjp_places(const Linear *l, double *x) {
  for (int i = PLACED; i >= WEIGHED; --i) vjp(l->of + i, x);
}

/* From the derivatives by all that a sub-step gives to those by all that it reads; with `last` also by the numbers of
   elements and masses. */
static void vjp_laws(const Problem *p, const Work *w, const Adjoint *a, const Linear *l, const Backward *b, double *x,
                      int last) {
  const Layout *at = &l->at;
  vjp(l->of + JOINED, x);
  vjp(l->of + CLOSED, x);
  if (HAS(LOOPS) && p->closures) solve_closures(p, w, w->part_virtual, w->order_virtual, x + at->closing);
  for (int i = 0; i < p->closures; ++i) x[at->R + p->loop_column[p->following[i]]] += x[at->closing + i];
  for (int i = MAPPED; i > LEVERS; --i) vjp(l->of + i, x);
  if (last) vjp(l->of + LEVERS, x);
  for (int i = SLID; i >= TOUCHED; --i) vjp(l->of + i, x);
  vjp_bodies(p, w, a, at, b, x, last);
  vjp_places(l, x);
  for (int i = ARMS; last && i >= 0; --i) vjp(l->of + i, x);
}

/* Adds the derivatives by the equations of a sub-step, as many as make those by the unknowns zero: in `trial` they are found
   without; returns 0 if its tangent is singular. */
static int vjp_solution(Problem *p, const Work *w, const Adjoint *a, const Linear *l, const Backward *b, int whole,
                         double *x, double *trial) {
  const Layout *at = &l->at;
  if (whole) memcpy(trial + at->Y, x + at->Y, (at->size - at->Y) * sizeof(double)), vjp_laws(p, w, a, l, b, trial, 0);
  else memcpy(trial + at->Y1, x + at->Y1, (at->natural1 - at->Y1) * sizeof(double)), vjp_places(l, trial);
  memcpy(w->reduced, trial + at->Y1, p->free * sizeof(double));
  if (!solve_transposed(p, w, a)) return 0;
  for (int i = 0; i < p->free; ++i) x[at->R + i] -= w->step[i];
  for (int i = 0; i < p->closures; ++i) x[at->closures + i] -= w->y[order_now(p)[p->unknowns - p->closures + i]];
  return 1;
}

/* The same with the derivatives by the forces that friction follows: those by internal variables that have them. */
static int vjp_followed(Problem *p, Work *w, const Adjoint *a, Linear *l, Backward *b, const double *row, long k,
                         double *x, double *trial) {
  const Layout *at = &l->at;
  double found[p->points->all];
  begin_fixed_point(&b->following);
  for (int i = 0; i < MOST_TRIALS; ++i) {
    int n = 0;
    if (i && !begin_taped(p, w, a, row, l)) return 0;
    begin_forces(p, a, at, a->force_at[k], x);
    if (!vjp_solution(p, w, a, l, b, 1, x, trial)) return 0;
    memcpy(trial + at->Y, x + at->Y, (at->size - at->Y) * sizeof(double));
    vjp_laws(p, w, a, l, b, trial, 0);
    for (const PointForce *e = p->points->of; e < p->points->of + p->points->all; ++e)
      if (e->load >= 0) found[n++] = trial[at->spring_internal + e->first_internal + FOLLOWED];
    if (!next_trial(&b->following, found, 0, x + at->followed)) break;
  }
  return 1;
}

/* Takes the derivatives from the end of a sub-step to its start; returns 0 if its tangent is singular. */
static int vjp_step(Problem *p, Work *w, const Adjoint *a, Linear *l, Backward *b, double *trial, const Tape *tape,
                     long number) {
  const Layout *at = &l->at;
  const double *row = tape->row + number * tape->size;
  long k = tape->first + number, steps = at->Y1 - at->loads;
  int forces = a->force_at[k] >= 0 || p->friction_follows;
  double *x = a->x;
  if (!begin_taped(p, w, a, row, l)) return 0;
  linearise(p, w, a, l, forces, k == 0);
  begin_vjp(p, w, a, at, k, x);
  begin_forces(p, a, at, a->force_at[k], x);
  if (p->friction_follows) {
    if (!vjp_followed(p, w, a, l, b, row, k, x, trial)) return 0;
  } else if (!vjp_solution(p, w, a, l, b, forces || p->cell_internal || p->spring_width, x, trial)) return 0;
  vjp_laws(p, w, a, l, b, x, 1);
  for (const PointForce *e = p->points->of; e < p->points->of + p->points->all; ++e)
    if (e->load >= 0) x[at->spring_internal + e->first_internal + FOLLOWED] = 0; /* but a first trial */
  memcpy(a->of_steps + k * steps, x + at->loads, steps * sizeof(double));
  a->sizes[k] = sqrt(dot(p->dofs, x + at->v, x + at->v));
  if (k) return 1;
  add_given(p, a, at, 0, x);
  memset(x + at->arms, 0, (at->natural1 - at->arms) * sizeof(double));
  vjp(l->of + BEGUN, x);
  return 1;
}

/* The forces of driven and fixed columns in the sub-steps of a tape; returns the number of those that are left in a
   singular position. */
OF_DERIVATIVES long fx_taped_forces(Problem *p, const Tape *tape, const Adjoint *a, double *forces) {
  Work work, *w = &work;
  Linear l;
  Backward b;
  double *trial;
  int constrained = p->columns - p->free;
  lay_out(p, w, p->scratch), lay_out_backward(p, a, &l, &b, &trial, a->scratch), begin_linear(p, w, a, &l);
  w->dt = NAN;
  long row = 0;
  for (; row < tape->rows && begin_taped(p, w, a, tape->row + row * tape->size, &l); ++row) {
    project(p, w, w->r, w->columns);
    memcpy(forces + row * constrained, w->columns + p->free, constrained * sizeof(double));
  }
  p->kept.present = 0;
  end_linear(&l);
  return tape->rows - row;
}

/* Follows a tape backwards; returns the number of sub-steps that are left where a tangent is singular. */
OF_DERIVATIVES long fx_vjp(Problem *p, const Tape *tape, const Adjoint *a) {
  Work work, *w = &work;
  Linear l;
  Backward b;
  double *trial;
  long left = tape->rows;
  lay_out(p, w, p->scratch), lay_out_backward(p, a, &l, &b, &trial, a->scratch), begin_linear(p, w, a, &l);
  w->dt = NAN, w->transposed = 1;
  for (; left; --left) {
    if (tape->apart) memset(a->x + l.at.Y, 0, (l.at.v - l.at.Y) * sizeof(double));
    if (!vjp_step(p, w, a, &l, &b, trial, tape, left - 1)) break;
  }
  end_linear(&l);
  return left;
}
