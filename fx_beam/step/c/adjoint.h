/* The derivatives of a run, backwards (docs/theory/derivatives.md): from the derivatives of a function of
   the states at the ends of sub-steps to those by all numbers of the scene. In the comments J is this function,
   and "by x" its derivative by x; the vector x has those by all numbers of a sub-step. */

#pragma once

#include "element_derivatives.h"
#include "reused_factors.h"

/* The transpose of a chain or a band in its place; bordering rows are transposed already. */
static void transpose_tangent(const Tangent *tangent, const int *transposed_at, double *K) {
  for (int i = 0; i < tangent->stored; ++i) {
    double *other = K + transposed_at[i], value = K[i];
    if (other > K + i) K[i] = *other, *other = value;
  }
}

/* Solves with the transposed tangent: `step` from `reduced`; returns 0 if it is singular. */
static int solve_transposed(const Tables *p, const Numbers *s, Work *w, const Derivatives *a) {
  double rest[2];
  Work turned = *w;
  turned.factors.reused.present = 0;
  if (HAS(CHAIN | BAND)) transpose_tangent(&p->tangent, a->transposed_at, w->tangent);
  else if (a->transposed_at) turned.factors.at = a->transposed_at;
  return solve_reduced(p, s, &turned, 0, rest);
}

/* Begins a sub-step with the derivatives by the state at its end, which are those by the start of the next one. */
static void begin_vjp(const Tables *p, const Work *w, const Derivatives *a, const Layout *at, long k, double *x) {
  int n = p->dofs, columns = p->columns + p->auxiliary.count;
  double per_dt = rates_per_path(&p->scheme, w->dt), *q = x + at->q, *q1 = x + at->q1, *v = x + at->v, *previous = x + at->q_previous;
  add_given(&a->states, k + 1, share_of(a, k), x);
  memset(x + at->loads, 0, (at->Y1 - at->loads) * sizeof(double));
  memset(x + at->arms, 0, (at->size - at->arms) * sizeof(double));
  memcpy(x + at->Y1, x + at->Y, columns * sizeof(double)), memset(x + at->Y, 0, columns * sizeof(double));
  memcpy(x + at->natural1, x + at->natural, (at->loads - at->natural) * sizeof(double));
  memset(x + at->natural, 0, (at->loads - at->natural) * sizeof(double));
  for (int i = 0; i < p->mesh.massless_count; ++i) v[p->mesh.massless[i]] /= 2;
  for (int i = 0; i < n; ++i) {
    double path_slope = per_dt * w->slope[i] * v[i];
    q1[i] = q[i] + path_slope, q[i] = previous[i] - path_slope, previous[i] = 0, v[i] = -v[i];
  }
  for (int i = 0; i < p->mesh.massless_count; ++i) v[p->mesh.massless[i]] = 0;
}

/* The derivatives by the forces of driven and fixed columns, and of joints; none by the equations. */
static void begin_forces(const Derivatives *a, const Layout *at, long k, double *x) {
  memset(x + at->R, 0, (at->closing - at->R) * sizeof(double));
  memset(x + at->forces, 0, (at->axes - at->forces) * sizeof(double));
  add_given(&a->forces, k, share_of(a, k), x);
}

static void vjp_places(const Linear *l, double *x) {
  for (int i = PLACED; i >= WEIGHED; --i) vjp(l->of + i, x);
}

/* From the derivatives by all that a sub-step gives to those by all that it reads; with `last` also by the numbers of
   elements and masses. */
static void vjp_laws(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, const Linear *l, double *x, int last) {
  const Layout *at = &l->at;
  vjp(l->of + JOINED, x);
  vjp(l->of + CLOSED, x);
  if (HAS(LOOPS) && p->loops.closures) solve_closures(&p->loops, w, 1, 0, x + at->closing);
  for (int i = 0; i < p->loops.closures; ++i) x[at->R + p->loops.column[w->following[i]]] += x[at->closing + i];
  for (int i = MAPPED; i > LEVERS; --i) vjp(l->of + i, x);
  if (last) vjp(l->of + LEVERS, x);
  for (int i = SLID; i >= TOUCHED; --i) vjp(l->of + i, x);
  vjp_bodies(p, s, w, a, l, x, last);
  vjp_places(l, x);
  for (int i = ARMS; last && i >= 0; --i) vjp(l->of + i, x);
}

/* Adds the derivatives by the equations of a sub-step, as many as make those by the unknowns zero: in `trial` they are found
   without; returns 0 if its tangent is singular. */
static int vjp_solution(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, const Linear *l, int whole, double *x) {
  const Layout *at = &l->at;
  double *trial = l->trial;
  if (whole) memcpy(trial + at->Y, x + at->Y, (at->size - at->Y) * sizeof(double)), vjp_laws(p, s, w, a, l, trial, 0);
  else memcpy(trial + at->Y1, x + at->Y1, (at->natural1 - at->Y1) * sizeof(double)), vjp_places(l, trial);
  memcpy(w->reduced, trial + at->Y1, p->free * sizeof(double));
  if (!solve_transposed(p, s, w, a)) return 0;
  for (int i = 0; i < p->free; ++i) x[at->R + i] -= w->step[i];
  for (int i = 0; i < p->loops.closures; ++i)
    x[at->closures + i] -= w->y[w->factors.order[p->system.unknowns - p->loops.closures + i]];
  return 1;
}

/* Derivatives by the equations and by the forces F that friction follows, which are internal variables. */
static int vjp_followed(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, Linear *l, const double *row, long k,
                        double *x) {
  const Layout *at = &l->at;
  begin_fixed_point(&l->following, 0);
  for (int i = 0; i < MOST_TRIALS; ++i) {
    if (i && !begin_taped(p, s, w, a, row, l)) return 0;
    begin_forces(a, at, k, x);
    if (!vjp_solution(p, s, w, a, l, 1, x)) return 0;
    memcpy(l->trial + at->Y, x + at->Y, (at->size - at->Y) * sizeof(double));
    vjp_laws(p, s, w, a, l, l->trial, 0);
    for (int k = 0; k < l->following.size; ++k) l->followed[k] = l->trial[a->followed[k]];
    if (!next_trial(&l->following, l->followed, 0, x + at->followed)) break;
  }
  return 1;
}

/* The derivatives by the closures of loops, as many as make those by the unknowns that follow zero: in `trial` these are
   found without, by columns Y at the end where the closures have the derivatives G. */
static void vjp_closures(const Loops *loops, const Work *w, int Y, const double *trial, double *closures) {
  factorise_closures(loops, w, w->G, 1);
  for (int i = 0; i < loops->closures; ++i) closures[i] = -trial[Y + loops->column[w->following[i]]];
  solve_closures(loops, w, 1, 1, closures);
}

/* Takes the derivatives from the end of a sub-step to its start; returns 0 if its tangent is singular. */
static int vjp_step(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, Linear *l, const Tape *tape, long number) {
  const Layout *at = &l->at;
  const double *row = tape->row + number * tape->size;
  long k = tape->first + number, steps = at->Y1 - at->loads;
  int forces = !a->unknown_slopes && (a->forces.at[k] >= 0 || p->at_points.friction_follows);
  int closes = HAS(LOOPS) && a->unknown_slopes && p->loops.closures;
  int whole = forces || closes || (!a->unknown_slopes && (p->internal.per_cell || p->at_points.spring_width));
  double *x = a->x, *trial = l->trial;
  long size = (at->size - at->Y) * sizeof(double);
  l->step = k;
  if (!begin_linearised(p, s, w, a, l, row, forces, k == 0 || a->unknown_slopes, whole)) return 0;
  begin_vjp(p, w, a, at, k, x);
  begin_forces(a, at, k, x);
  if (!a->unknown_slopes)
    if (!(p->at_points.friction_follows ? vjp_followed(p, s, w, a, l, row, k, x) : vjp_solution(p, s, w, a, l, whole, x)))
      return 0;
  if (closes) memcpy(trial + at->Y, x + at->Y, size), vjp_laws(p, s, w, a, l, trial, 0);
  if (closes) vjp_closures(&p->loops, w, at->Y1, trial, x + at->closures);
  vjp_laws(p, s, w, a, l, x, 1);
  for (int i = 0; i < l->following.size; ++i) x[a->followed[i]] = 0; /* but a first trial */
  memcpy(a->step_slopes + k * steps, x + at->loads, steps * sizeof(double));
  a->sizes[k] = sqrt(dot(p->dofs, x + at->v, x + at->v));
  if (k && !a->unknown_slopes) return 1;
  if (k == 0) add_given(&a->states, 0, 1, x);
  memset(x + at->arms, 0, (at->natural1 - at->arms) * sizeof(double));
  memset(x + at->closures, 0, p->loops.closures * sizeof(double));
  if (closes) memcpy(trial + at->Y, x + at->Y, size), vjp(l->of + BEGUN, trial);
  if (closes && begin_loops(p, s, w)) vjp_closures(&p->loops, w, at->Y, trial, x + at->closures);
  vjp(l->of + BEGUN, x);
  if (!a->unknown_slopes) return 1;
  for (int i = 0; i < p->free; ++i) a->unknown_slopes[i] += x[at->Y + i] + x[at->Y1 + i];
  for (int i = 0; i < p->driven; ++i) a->step_slopes[k * steps + at->driven - at->loads + i] += x[at->Y + p->free + i];
  return 1;
}

/* Follows a tape backwards; returns the number of sub-steps that are left where a tangent is singular. */
KEPT long fx_vjp(Problem *problem, const Tape *tape, const Derivatives *a) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  Linear l;
  long left = tape->rows;
  begin_linear(p, s->points, w, a, &l);
  w->transposed = 1, w->slopes_only = p->internal.per_cell || a->unknown_slopes, l.following.size = s->points->followed.size;
  for (; left; --left) {
    if (tape->apart) memset(a->x + l.at.Y, 0, (l.at.v - l.at.Y) * sizeof(double));
    if (!vjp_step(p, s, w, a, &l, tape, left - 1)) break;
  }
  return end_linear(&w->factors, &l, left);
}
