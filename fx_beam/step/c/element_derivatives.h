/* Derivatives of the forces of elements, by dense Jacobians that are found for LANES elements at once, and of those of
   inertia. */

#pragma once

#include "linearised.h"

/* The Jacobians of a block of elements in a sub-step that has begun. */
static void evaluate_slopes(const Tables *p, const Work *w, const Vjp *elements, const Cells *cells, long block, double *to) {
  evaluate(p, w, &elements->slopes, cells, block, to);
  for (int i = 0; i < elements->pieces; ++i) {
    int end = elements->end_of[i], weights = elements->piece_weights[i], n = elements->piece_numbers[i] * weights * LANES;
    double *piece = to + elements->piece_start[i] * LANES, *end_slopes = end < 0 ? 0 : to + elements->piece_start[end] * LANES;
    if (i >= elements->made) memset(piece, 0, n * sizeof(double));
    else if (elements->weight_at[i])
      for (int k = 0; k < n; ++k) piece[k] *= p->internal.per_weight[k / LANES % weights];
    for (int k = 0; end_slopes && k < n; ++k) piece[k] -= end_slopes[k];
  }
}

/* Jacobians of all elements, or a share of them that is added to a sum. */
static void find_slopes(const Tables *p, const Work *w, const Derivatives *a, const Linear *l) {
  for (int i = 0; i < 2; ++i) {
    const Vjp *elements = work_of_elements(a, i);
    long n = (long)elements->slope_numbers * LANES;
    double *to = l->slopes[i], room[n + 1];
    EACH_BLOCK(cells, block, &elements->slopes) {
      evaluate_slopes(p, w, elements, cells, block, l->share ? room : to);
      for (long k = 0; l->share && k < n; ++k) to[k] = l->share * room[k] + (l->adds ? to[k] : 0);
      to += n;
    }
  }
}

/* Adds the tangent of elements with internal variables, by their slopes. On a yield surface it has a kink: there round-off may
   choose another side of it in the tangent for steps, with which the slopes would not fit. */
static void add_slopes(const Mesh *mesh, const Forms *forms, const Vjp *elements, const double *slopes, double *K) {
  int n = mesh->cell_dofs;
  double A[12 * 12 * LANES];
  EACH_BLOCK(cells, block, &forms->internal_forces) {
    const double *end_slopes = slopes + elements->piece_start[0] * LANES; /* [increment][force][lane] */
    for (int k = 0; k < n * n; ++k) memcpy(A + k * LANES, end_slopes + (k % n * n + k / n) * LANES, LANES * sizeof(double));
    add_tangents(n, cells->of, block, A, K);
    slopes += elements->slope_numbers * LANES;
  }
}

/* Whether the motions of nodes do not depend on the state. */
static int has_constant_map(const Tables *p) {
  return p->map.count == p->map.equal && !p->loops.closures && !p->sliders.count;
}

/* The forces of a sub-step of a tape, and its tangent, if these are read; returns 0 in a singular position. */
static int begin_taped(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, const double *row, Linear *l) {
  double dt = row[1];
  int unread = a->unknown_slopes && has_constant_map(p); /* whether Jacobians are read, but no forces and no tangent */
  take_from_tape(p, s, w, row), stretch_bristles(&w->state, a, l->step);
  w->dt = dt;
  begin_loads(p, s, w);
  if (p->natural.count) begin_natural(p, s, w);
  for (int k = s->points->external; p->scheme.at_rest && k < s->points->nodal; ++k)
    s->points->of[k].numbers[a->numbers[k] - 1] = w->state.ratio; /* the last number of a load is its factor */
  fx_set_parameters(s->points, s->parameters);
  begin_elements(&p->scheme, s, w);
  if (!begin_couplings(p, s, w) && !choose_ahead(p, s, w)) return 0;
  if (!expand(p, s, w)) return 0;
  if (HAS(MEMBERS) && s->points->members) settle_members(p, s->points, w);
  for (int i = 0; i < 2; ++i) begin_form(s, w, &work_of_elements(a, i)->slopes, w->state.t + p->scheme.level * dt);
  if (unread) work_increment(p, w), acceleration(p, &s->frame, w, dt), evaluate_nodes(s->points, w); else balance(p, s, w);
  if (w->slopes_only && !a->unknown_slopes)
    find_slopes(p, w, a, l), add_slopes(&p->mesh, &s->forms, &a->internal_forces, l->slopes[0], w->tangent);
  if (p->at_points.friction_follows) set_axes(p, s, w);
  if (!l->adds) l->of[TOUCHED].count = 0;
  if (HAS(MEMBERS) && s->points->members) put_members(l->of + TOUCHED, s->points, a, &l->at, l->step);
  if (!unread) reduce_tangent(p, s, w);
  if (HAS(LOOPS) && w->transposed) factorise_closures(&p->loops, w, w->G_virtual, 0);
  return 1;
}

/* The forces of driven and fixed columns in the sub-steps of a tape; returns the number of those that are left in a
   singular position. */
KEPT long fx_taped_forces(Problem *problem, const Tape *tape, const Derivatives *a, double *forces) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  Linear l;
  int constrained = p->columns - p->free;
  begin_linear(p, s->points, w, a, &l);
  long row = 0;
  for (; row < tape->rows && begin_taped(p, s, w, a, tape->row + row * tape->size, &l); ++row) {
    project(p, s->points, w, w->r, w->reduced);
    memcpy(forces + row * constrained, w->reduced + p->free, constrained * sizeof(double));
  }
  return end_linear(&w->factors, &l, tape->rows - row);
}

static void scale_entries(Block *b, long first, double share) {
  for (long k = first; k < b->count; ++k) b->entry[k].slope *= share;
}

/* A sub-step of a tape with all its laws, and those of joint forces if these are wanted; returns 0 in a singular position.
   Slopes that are read more than once are stored. */
static int begin_linearised(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, Linear *l, const double *row,
                            int forces, int first, int store) {
  long touched = l->adds ? l->of[TOUCHED].count : 0, forced = l->adds ? l->of[FORCED].count : 0;
  if (!begin_taped(p, s, w, a, row, l)) return 0;
  linearise(p, s, w, a, l, forces, first);
  if (l->share) scale_entries(l->of + TOUCHED, touched, l->share), scale_entries(l->of + FORCED, forced, l->share);
  if (store && (a->unknown_slopes || !w->slopes_only)) find_slopes(p, w, a, l);
  l->stores = store;
  return 1;
}

/* Adds the products of slopes [number][weight][lane], of one lane, and changes. */
INLINED void add_products(int numbers, int weights, const double *slopes, const int *from, const Changes *x, Changes *sums) {
  for (int q = 0; q < numbers; ++q, from += LANES)
#pragma GCC unroll 12
    for (int k = 0; k < weights; ++k, slopes += LANES) sums[k] += *slopes * x[*from];
}

/* Adds the changes of forces of elements, the first `weights`, or with `internal` those of internal variables behind them.
   With `held` the end does not change. */
INLINED void jvp_cells(const Vjp *elements, const double *slopes, int weights, int internal, int held, Changes *x) {
  const int *from = elements->from, *to = elements->to + (internal ? (elements->weights - weights) * LANES : 0);
  EACH_BLOCK(cells, block, &elements->slopes) {
    for (int lane = 0; lane < LANES && block * LANES + lane < cells->of->cells; ++lane) {
      Changes sums[weights];
      for (int k = 0; k < weights; ++k) sums[k] = (Changes){0};
      for (int i = 0; i < elements->pieces; ++i)
        if (!elements->weight_at[i] == !internal && !(held && !elements->number_at[i]))
          add_products(elements->piece_numbers[i], weights, slopes + elements->piece_start[i] * LANES + lane,
                       from + elements->number_at[i] * LANES + lane, x, sums);
      for (int k = 0; k < weights; ++k) x[to[k * LANES + lane]] += sums[k];
    }
    slopes += (long)elements->slope_numbers * LANES, from += elements->numbers * LANES, to += elements->weights * LANES;
  }
}

HOT void jvp_elements(const Mesh *mesh, const Derivatives *a, const Linear *l, int held, Changes *x) {
  for (int i = 0; i < 2; ++i) {
    const Vjp *elements = work_of_elements(a, i);
    if (mesh->cell_dofs == 6) jvp_cells(elements, l->slopes[i], 6, 0, held, x); /* sums stay in registers */
    else jvp_cells(elements, l->slopes[i], mesh->cell_dofs, 0, held, x);
  }
}

/* Adds the products of slopes [number][weight][lane], of all lanes, and weights [weight][lane] to the derivatives by numbers. */
INLINED void add_transposed(int numbers, int weights, const double *slopes, const int *from, const Four *weight, double *x) {
  for (int q = 0; q < numbers; ++q, from += LANES) {
    Four sums[LANES / 4] = {{0}};
#pragma GCC unroll 12
    for (int k = 0; k < weights; ++k, slopes += LANES)
      for (int i = 0; i < LANES / 4; ++i) sums[i] += *(const Four *)(slopes + 4 * i) * weight[k * (LANES / 4) + i];
    for (int lane = 0; lane < LANES; ++lane) x[from[lane]] += sums[lane / 4][lane % 4];
  }
}

/* The derivatives by the numbers of elements, by their slopes if these are stored; without `last` not by those of each
   element itself. */
INLINED void vjp_cells(const Tables *p, const Work *w, const Vjp *elements, const double *stored, int weights, int last,
                       double *x) {
  const int *from = elements->from, *to = elements->to;
  Four weight[elements->weights * (LANES / 4) + 1];
  double room[elements->slope_numbers * LANES + 1];
  EACH_BLOCK(cells, block, &elements->slopes) {
    const double *slopes = stored ? stored : room;
    if (stored) stored += (long)elements->slope_numbers * LANES; else evaluate_slopes(p, w, elements, cells, block, room);
    for (int k = 0; k < elements->weights * LANES; ++k) ((double *)weight)[k] = x[to[k]];
    for (int i = 0; i < elements->pieces; ++i) {
      int internal = elements->weight_at[i], at = elements->number_at[i];
      if (last || at < elements->state_numbers)
        add_transposed(elements->piece_numbers[i], internal ? elements->piece_weights[i] : weights, slopes + elements->piece_start[i] * LANES,
                       from + at * LANES, weight + internal * (LANES / 4), x);
    }
    from += elements->numbers * LANES, to += elements->weights * LANES;
  }
}

HOT void vjp_elements(const Tables *p, const Work *w, const Derivatives *a, const Linear *l, int last, double *x) {
  for (int i = 0; i < 2; ++i) {
    const Vjp *elements = work_of_elements(a, i);
    const double *stored = l->stores ? l->slopes[i] : 0;
    if (p->mesh.cell_dofs == 6) vjp_cells(p, w, elements, stored, 6, last, x);
    else vjp_cells(p, w, elements, stored, p->mesh.cell_dofs, last, x);
  }
}

/* Accelerations by places in a frame that turns. */
static double turning_stiffness(const Scheme *scheme, const Frame *frame, const State *state) {
  return scheme->at_rest ? -state->ratio * frame->spin_squared : 0;
}

/* The derivatives of the forces of elements and of inertia, and of internal variables; with `last` also by numbers. */
HOT void vjp_bodies(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, const Linear *l, double *x, int last) {
  const Layout *at = &l->at;
  double per_dt = rates_per_path(&p->scheme, w->dt), turning = turning_stiffness(&p->scheme, &s->frame, &w->state);
  for (int i = 0; i < p->cells * p->internal.per_cell; ++i) x[at->internal + i] += x[at->internal1 + i];
  vjp_elements(p, w, a, l, last, x);
  for (int i = 0; last && i < p->dofs; ++i) x[at->weight + i] -= acting(&p->scheme, &w->state) * x[at->r + i];
  if (p->scheme.at_rest && !turning) return;
  times_mass(p, s, x + at->r, w->scratch);
  for (int i = 0; i < p->dofs; ++i) {
    double increment_slope = per_dt * per_dt / 2 * w->slope[i] * w->scratch[i];
    x[at->q1 + i] += increment_slope, x[at->q + i] -= increment_slope, x[at->v + i] -= per_dt * w->scratch[i];
  }
  for (int i = 0; turning < 0 && i < p->dofs; ++i) { /* in a frame that turns */
    double place_slope = turning * w->scratch[i];
    x[at->q1 + i] += p->scheme.level * place_slope, x[at->q + i] += (1 - p->scheme.level) * place_slope,
        x[at->member_places + i] += place_slope;
  }
  for (int node = 0; last && node < p->mesh.nodes; ++node)
    for (int k = p->mass.start[node]; k < p->mass.start[node + 1]; ++k)
      for (int i = 0; i < 3; ++i) x[at->mass + 3 * k + i] += x[at->r + 3 * node + i] * w->acc[p->mass.dof[k] + i];
}

/* Sets the changes of the forces of inertia and weight. */
HOT void jvp_inertia(const Tables *p, const Numbers *s, const Work *w, const Layout *at, int changes_mass, int held, Changes *x) {
  double per_dt = rates_per_path(&p->scheme, w->dt), turning = turning_stiffness(&p->scheme, &s->frame, &w->state);
  const Changes *q = x + at->q, *end = x + at->q1, *v = x + at->v, *X = x + at->member_places;
  Changes *moving = x + at->R; /* which begins afterwards */
  if (p->scheme.at_rest) memset(x + at->r, 0, p->dofs * sizeof(Changes));
  if (p->scheme.at_rest && !changes_mass && !turning) return;
  for (int i = 0; i < p->dofs; ++i) {
    Changes increment = held ? -q[i] : end[i] - q[i];
    moving[i] = per_dt * (per_dt / 2 * w->slope[i] * increment - v[i]);
  }
  for (int i = 0; turning < 0 && i < p->dofs; ++i)
    moving[i] += turning * (X[i] + (1 - p->scheme.level) * q[i] + p->scheme.level * end[i]);
  for (int node = 0; node < p->mesh.nodes; ++node) {
    Changes *r = x + at->r + 3 * node, sums[3] = {{0}};
    for (int k = p->mass.start[node]; k < p->mass.start[node + 1]; ++k)
      for (int i = 0; i < 3; ++i) sums[i] += s->mass[3 * k + i] * moving[p->mass.dof[k] + i];
    for (int k = p->mass.start[node]; changes_mass && k < p->mass.start[node + 1]; ++k)
      for (int i = 0; i < 3; ++i) sums[i] += x[at->mass + 3 * k + i] * w->acc[p->mass.dof[k] + i];
    for (int i = 0; i < 3; ++i) r[i] = changes_mass ? sums[i] - acting(&p->scheme, &w->state) * x[at->weight + 3 * node + i] : sums[i];
  }
}
