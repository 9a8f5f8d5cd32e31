/* The derivatives of a run, forwards (docs/theory/derivatives.md): from changes of the numbers of a scene to
   those of the states at the ends of sub-steps. Each direction is a change of all numbers; in the comments "the
   change" of something is that in one direction. */

#pragma once

#include "adjoint.h"

/* What a direction has at both ends of a sub-step: of nodes, of columns with those of ties, of arms of joints. */
typedef struct {
  double *start, *end, *force, *columns, *reduced, *arms, *map, *increment, *values, *tangent;
} Change;

/* Derivatives of the forces, their work on unit weights: of elements [block][weight][number][lane], of forces at
   points [force][weight][given]. */
typedef struct {
  double *of_elements[2], *of_points;
} Slopes;

static int numbers_of_element(const Problem *p, const Pulled *of) {
  return (of->increment + of->start + of->before) * p->cell_dofs + of->internal * p->cell_internal + of->tail;
}

static long blocks_of(const Form *form) {
  long blocks = 0;
  for (int i = 0; i < form->integrals; ++i) blocks += (form->of[i].cells + LANES - 1) / LANES;
  return blocks;
}

static int weights_of(const Problem *p, const Pulled *of) {
  return p->cell_dofs + (of->internal ? p->cell_internal : 0);
}

static long lay_out_forward(const Problem *p, const Adjoint *a, Change *c, Slopes *s, double *at) {
  double *begin = at;
  long n = p->dofs + LANES, columns = p->columns + p->ties, points = 0;
  const Pulled *works[] = {&a->internal_forces, &a->drag};
  c->start = allocate(&at, n), c->end = allocate(&at, n), c->force = allocate(&at, n);
  c->increment = allocate(&at, n), c->columns = allocate(&at, columns), c->reduced = allocate(&at, columns);
  c->arms = allocate(&at, 2 * p->joints), c->map = allocate(&at, 1 + 4 * p->joints);
  c->values = allocate(&at, 1 + 4 * p->joints), c->tangent = allocate(&at, p->stored_values + 4 * LANES);
  for (int i = 0; i < 2; ++i)
    s->of_elements[i] =
        allocate(&at, blocks_of(&works[i]->form) * weights_of(p, works[i]) * numbers_of_element(p, works[i]) * LANES);
  for (int k = 0; k < p->points->all; ++k)
    points += (p->points->of[k].size + p->points->of[k].internal) * (long)a->arguments[k];
  s->of_points = allocate(&at, points);
  return at - begin;
}

long fx_forward_scratch(const Problem *p, const Adjoint *a) {
  Change c;
  Slopes s;
  return lay_out_forward(p, a, &c, &s, 0);
}

/* The coefficients of a block are packed; its weights are set to one unit after the other. */
static void find_slopes(const Problem *p, const Pulled *of, const double *const *fields, double t, double dt,
                        double *to) {
  const Form *form = &of->form;
  int n = p->cell_dofs, all = numbers_of_element(p, of), weights = weights_of(p, of), at[2] = {0, 0};
  double A[(1 + all) * LANES];
  set_time(p, form, t, dt);
  for (int m = 0; m < form->moving; ++m)
    if (form->kind[m] > INTERNAL) at[form->kind[m] - INTERNAL - 1] = form->offset[m];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long block = 0; block * LANES < own->cells; ++block) {
      double *packed = own->packed + block * form->width * LANES;
      pack(p, own, form, block, fields, 0, form->moving);
      for (int k = 0; k < weights; ++k, to += all * LANES) {
        double *weight = packed + (k < n ? at[0] + k : at[1] + k - n) * LANES;
        for (int l = 0; l < LANES; ++l) weight[l] = 1;
        own->batch(A, packed, form->constants, own->coordinates + block * p->cell_coordinates * LANES);
        for (int l = 0; l < LANES; ++l) weight[l] = 0;
        memcpy(to, A + LANES, all * LANES * sizeof(double));
      }
    }
  }
}

static void find_point_slopes(const Problem *p, const Adjoint *a, double *to) {
  for (int k = 0; k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    int all = a->arguments[k], weights = e->size + e->internal;
    memcpy(a->given, e->given, all * sizeof(double));
    memset(a->given + all, 0, weights * sizeof(double));
    for (int i = 0; i < weights; ++i, to += all) {
      a->given[all + i] = 1;
      call(a->pull[k], a->given, to, all);
      a->given[all + i] = 0;
    }
  }
}

/* Adds the change of the forces of elements, or with `grown` that of their internal variables. */
static void change_elements(const Problem *p, const Pulled *of, const double *slopes, const double *increment,
                            const double *start, const double *before, const double *internal, const double *tail,
                            double *force, double *grown) {
  const Form *form = &of->form;
  int n = p->cell_dofs, m = p->cell_internal, all = numbers_of_element(p, of), weights = weights_of(p, of);
  double x[all * LANES];
  const double *nodal[] = {increment, start, before};
  int there[] = {of->increment, of->start, of->before};
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long block = 0; block * LANES < own->cells; ++block, slopes += (long)weights * all * LANES) {
      const int *dofs = own->dofs + block * n * LANES, *to = own->to + block * n * LANES;
      double *at = x;
      for (int k = 0; k < 3; ++k)
        if (there[k]) {
          for (int j = 0; j < n * LANES; ++j) at[j] = nodal[k][dofs[j]];
          at += n * LANES;
        }
      if (of->internal) {
        for (int j = 0; j < m * LANES; ++j) at[j] = internal[own->internal[block * m * LANES + j]];
        at += m * LANES;
      }
      memcpy(at, tail, of->tail * LANES * sizeof(double));
      tail += of->tail * LANES;
      for (int k = grown ? n : 0; k < (grown ? weights : n); ++k) {
        double sum[LANES] = {0};
        const double *slope = slopes + (long)k * all * LANES;
        for (int j = 0; j < all; ++j)
          for (int l = 0; l < LANES; ++l) sum[l] += slope[j * LANES + l] * x[j * LANES + l];
        for (int l = 0; l < LANES; ++l)
          if (!grown)
            force[to[k * LANES + l]] += sum[l];
          else if (block * LANES + l < own->cells)
            grown[own->internal[(block * m + k - n) * LANES + l]] += p->per_weight[k - n] * sum[l];
      }
    }
  }
}

/* Adds the change of the forces at points to nodes, and to columns for slides; or with `grown` sets that of their
   internal variables. */
static void change_points(const Problem *p, const Adjoint *a, const double *slopes, const Directions *d, int j,
                          const double *increment, const double *start, const double *y0, const double *y1,
                          const double *thrust, double *force, double *columns, double *grown) {
  const double *numbers = d->points + (long)j * d->point_numbers, *internal = d->spring_internal + (long)j * p->spring_width;
  double *x = a->found;
  for (int k = 0; k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    int n = e->size, all = a->arguments[k], before = 3 * n + 2 + e->internal + e->remembered;
    memset(x, 0, all * sizeof(double));
    for (int i = 0; i < n; ++i) {
      x[i] = coordinate(e, i, start, y0, e->column);
      x[n + i] = e->slide >= 0 ? y1[e->column] - y0[e->column] : coordinate(e, i, increment, y0, e->column);
    }
    for (int i = 0; i < e->internal; ++i) x[3 * n + 2 + i] = internal[e->first_internal + i];
    for (int i = before; i < all - e->parameters; ++i) x[i] = *numbers++;
    if (k >= p->points->external && k < p->points->external + p->thrusts)
      x[before] = thrust[0], x[before + 1] = thrust[1], thrust += 2;
    for (int i = 0; i < n + e->internal; ++i, slopes += all) {
      double sum = dot(all, slopes, x);
      if (i >= n) {
        if (grown) grown[e->first_internal + i - n] = sum;
      } else if (grown) {
        continue;
      } else if (e->slide >= 0) {
        columns[e->column] += sum;
      } else if (e->dof[i] >= 0) {
        force[e->dof[i]] += sum;
      }
    }
  }
}

/* The change of the configuration from that of columns, whose ties it sets, at one end of the sub-step. */
static void change_nodes(const Problem *p, const Directions *d, int j, const double *values, const double *psi,
                         const double *slide, double *arms, double *columns, double *q) {
  for (int i = 0; i < p->joints; ++i) {
    const double *o = d->offset + 2 * ((long)j * p->joints + i), *e = d->axis + 2 * ((long)j * p->joints + i);
    double rest = d->at_rest[i], now[2], turned[2];
    turn(psi[i], o[0], o[1], now), turn(psi[i], e[0], e[1], turned);
    for (int c = 0; c < 2; ++c)
      arms[2 * i + c] = now[c] - o[c] + slide[i] * turned[c] - rest * e[c] -
                        d->rest[(long)j * p->joints + i] * p->axis[2 * i + c];
  }
  double *tie = columns + p->columns;
  memset(tie, 0, p->ties * sizeof(double)), memset(q, 0, p->dofs * sizeof(double));
  for (int k = 0; k < p->tie_arms; ++k) tie[p->tie_arm_of[k]] += p->joint_sign[p->tie_arm[k]] * arms[p->tie_arm[k]];
  for (int k = 0; k < p->tie_entries; ++k)
    tie[p->tie_of[k]] += p->tie_sign[k] * values[p->tie_value[k]] * columns[p->tie_column[k]];
  for (int k = 0; k < p->equal; ++k) q[p->entry_row[k]] += columns[p->entry_column[k]];
  for (int k = p->equal; k < p->entries; ++k)
    q[p->entry_row[k]] += p->entry_sign[k] * values[p->entry_value[k]] * columns[p->entry_column[k]];
  for (int k = 0; k < p->followers; ++k) q[p->follower[k]] += p->joint_sign[p->through[k]] * arms[p->through[k]];
}

/* The change of the values of Tv. */
static void change_map(const Problem *p, const Work *w, const Directions *d, int j, const Change *c,
                       const double *y0) {
  double late = p->level, early = 1 - p->level;
  for (int i = 0; i < p->joints; ++i) {
    const double *o = d->offset + 2 * ((long)j * p->joints + i), *e = d->axis + 2 * ((long)j * p->joints + i);
    double turns[] = {at(c->start, p->guide[i]), at(c->end, p->guide[i])}, slides[] = {0, 0};
    double psi = w->psi0[i], d0 = at(p->slides, p->slide_of[i]), mean[2] = {0}, mean_t[2] = {0}, own[2], along[2];
    double slope = w->guide_slope[i], bend = w->guide_bend[i] * (turns[1] - turns[0]);
    if (p->slide_column[i] >= 0) slides[0] = y0[p->slide_column[i]], slides[1] = c->columns[p->slide_column[i]];
    for (int side = 0; side < 2; ++side) {
      const double *rho = (side ? w->rho1 : w->rho0) + 2 * i, *t = (side ? w->t1 : w->t0) + 2 * i;
      double share = side ? late : early, length = d0;
      if (side) {
        psi += at(w->D, p->guide[i]);
        if (p->slide_column[i] >= 0) length += w->z[p->slide_column[i]];
      }
      turn(psi, o[0] + length * e[0], o[1] + length * e[1], own), turn(psi, e[0], e[1], along);
      mean[0] += share * (own[0] - rho[1] * turns[side] + t[0] * slides[side]);
      mean[1] += share * (own[1] + rho[0] * turns[side] + t[1] * slides[side]);
      mean_t[0] += share * (along[0] - t[1] * turns[side]), mean_t[1] += share * (along[1] + t[0] * turns[side]);
    }
    double *map = c->map + 1 + 4 * i;
    map[0] = -mean[1], map[1] = mean[0];
    for (int k = 0; k < 2; ++k) map[2 + k] = bend * w->mean_t[2 * i + k] + slope * mean_t[k];
  }
}

/* Adds the change of Tv^T r that Tv has; forces on ties are those of `pull_map`. */
static void add_change_of_map(const Problem *p, const Work *w, const Change *c, const double *on_ties, double *out) {
  for (int k = p->equal; k < p->entries; ++k)
    out[p->entry_column[k]] += p->entry_sign[k] * c->map[p->entry_value[k]] * w->r[p->entry_row[k]];
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      out[p->gap_column[k]] -= p->gap_sign[k] * c->map[p->gap_value[k]] * w->closing[i];
  for (int k = p->tie_entries - 1; p->ties && k >= 0; --k)
    out[p->tie_column[k]] += p->tie_sign[k] * (c->map[p->tie_value[k]] * on_ties[p->columns + p->tie_of[k]] +
                                               w->virtual_map[p->tie_value[k]] * out[p->columns + p->tie_of[k]]);
}

/* The change of the gap of a loop at the end. */
static double change_of_gap(const Problem *p, const Work *w, const Change *c, int k) {
  int i = p->gap_arm[k], j = i / 2;
  double gap = at(c->end, p->gap_b[k]) - at(c->end, p->gap_a[k]);
  if (i < 0) return gap;
  gap -= c->arms[i] + (i % 2 ? w->rho1[i - 1] : -w->rho1[i + 1]) * at(c->end, p->guide[j]);
  return p->slide_column[j] < 0 ? gap : gap - w->t1[i] * c->columns[p->slide_column[j]];
}

/* The changes of the unknowns from that of the residual, and of gaps. Chains and bands are eliminated anew. */
static int solve_change(Problem *p, const Work *w, const Change *c) {
  if (p->band) {
    double rest[2];
    for (int i = 0; i < p->free; ++i) w->reduced[i] = c->reduced[i];
    memcpy(w->tangent, c->tangent, p->stored_values * sizeof(double));
    return solve_reduced(p, w, 0, rest);
  }
  for (int i = 0; i < p->unknowns; ++i) w->y[p->order[i]] = i < p->free ? c->reduced[i] : 0;
  for (int i = 0; i < p->closures; ++i)
    w->y[p->order[p->unknowns - p->closures + i]] = change_of_gap(p, w, c, i);
  substitute_sparse(&p->rows, w->factors, w->y);
  for (int i = 0; i < p->free; ++i) w->step[i] = w->y[p->order[i]];
  return 1;
}

static void store_change(const Problem *p, const Directions *d, long boundary, int j) {
  long k = d->row_at[boundary], n = p->dofs;
  if (k < 0) return;
  memcpy(d->q_rows + (k * d->count + j) * n, d->q + j * n, n * sizeof(double));
  memcpy(d->v_rows + (k * d->count + j) * n, d->v + j * n, n * sizeof(double));
  for (int i = 0; i < p->joints; ++i)
    if (p->slide_column[i] >= 0)
      d->slide_rows[(k * d->count + j) * p->scene_joints + p->slide_of[i]] =
          d->columns[j * (long)(p->columns + p->ties) + p->slide_column[i]];
}

/* One direction through a sub-step. */
static int push_direction(Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Change *c,
                          const Directions *d, const Backward *b, long row, long rows, int j) {
  long n = p->dofs, all = p->columns + p->ties, internal = (long)p->cells * p->cell_internal;
  double *y0 = d->columns + j * all, *q0 = d->q + j * n, *v0 = d->v + j * n, *before = d->before + j * n;
  double *inside = d->internal + j * internal, *springs = d->spring_internal + (long)j * p->spring_width;
  const Pulled *works[] = {&a->internal_forces, &a->drag};
  const double *tails[] = {d->of_elements + j * d->element_numbers, d->of_drag + j * d->drag_numbers};
  const double *loads = d->loads + (j * rows + row) * 2 * p->loads, *given = b->loads;
  const double *driven = d->driven + (j * rows + row) * p->driven, *mass = d->mass + (long)j * p->mass_start[n];
  const double *load_force = d->load_force + (long)j * p->load_start[p->loads];
  const double *thrust = d->thrust + (j * rows + row) * 2 * p->thrusts;
  double psi[p->joints + 1], slide[p->joints + 1], dt = w->dt;
  for (int i = 0; i < p->joints; ++i) {
    psi[i] = w->psi0[i] + at(w->D, p->guide[i]), slide[i] = at(p->slides, p->slide_of[i]);
    if (p->slide_column[i] >= 0) slide[i] += w->z[p->slide_column[i]];
  }
  memcpy(c->start, q0, n * sizeof(double));
  memset(c->columns, 0, all * sizeof(double));
  memcpy(c->columns + p->free, driven, p->driven * sizeof(double));
  change_nodes(p, d, j, w->values, psi, slide, c->arms, c->columns, c->end);

  /* With the unknowns of the end as they are. */
  for (int i = 0; i < n; ++i) c->increment[i] = c->end[i] - c->start[i];
  memset(c->force, 0, n * sizeof(double)), memset(c->reduced, 0, all * sizeof(double));
  for (int k = 0; k < 2; ++k)
    change_elements(p, works[k], s->of_elements[k], c->increment, c->start, before, inside, tails[k], c->force, 0);
  change_points(p, a, s->of_points, d, j, c->increment, c->start, y0, c->columns, thrust, c->force, c->reduced, 0);
  for (int i = 0; i < n; ++i) w->scratch[i] = 2 / dt * (w->slope[i] * c->increment[i] / dt - v0[i]);
  for (int i = 0; i < n; ++i) {
    double sum = -d->weight[j * n + i];
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k)
      sum += p->mass[k] * w->scratch[p->mass_column[k]] + mass[k] * w->acc[p->mass_column[k]];
    c->force[i] += sum;
  }
  for (int k = 0; k < p->loads; ++k) {
    double now = (1 - p->level) * given[k] + p->level * given[p->loads + k];
    double more = (1 - p->level) * loads[k] + p->level * loads[p->loads + k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i)
      c->force[p->load_dof[i]] -= p->load_force[i] * more + load_force[i] * now;
  }
  add_rows(p, w, c->force, c->reduced);
  if (p->joints) change_map(p, w, d, j, c, y0), add_change_of_map(p, w, c, b->on_ties, c->reduced);
  else if (p->ties) collect_ties(p, w->virtual_map, c->reduced);
  if (!solve_change(p, w, c)) return 0;
  for (int i = 0; i < p->free; ++i) c->columns[i] = -w->step[i];
  change_nodes(p, d, j, w->values, psi, slide, c->arms, c->columns, c->end);

  for (int i = 0; i < n; ++i) c->increment[i] = c->end[i] - c->start[i];
  if (p->cell_internal) {
    memset(b->lost_internal, 0, internal * sizeof(double));
    change_elements(p, works[0], s->of_elements[0], c->increment, c->start, before, inside, tails[0], 0, b->lost_internal);
    for (long i = 0; i < internal; ++i) inside[i] += b->lost_internal[i];
  }
  if (p->spring_width) {
    change_points(p, a, s->of_points, d, j, c->increment, c->start, y0, c->columns, thrust, 0, 0, b->lost_springs);
    memcpy(springs, b->lost_springs, p->spring_width * sizeof(double));
  }
  for (int i = 0; i < n; ++i) v0[i] = 2 / dt * w->slope[i] * c->increment[i] - v0[i];
  for (int k = 0; k < p->massless_count; ++k) {
    int i = p->massless[k];
    v0[i] = w->slope[i] * c->increment[i] / dt;
  }
  memcpy(before, q0, n * sizeof(double)), memcpy(q0, c->end, n * sizeof(double));
  memcpy(y0, c->columns, all * sizeof(double));
  return 1;
}

/* Follows a tape with changes in several directions; returns the number of sub-steps that are left where a
   tangent is singular. */
long fx_push(Problem *p, const Tape *tape, const Adjoint *a, const Directions *d) {
  Work work, *w = &work;
  Backward b;
  Change c;
  Slopes s;
  long all = p->columns + p->ties;
  lay_out(p, w, p->scratch), lay_out_backward(p, &b, a->scratch), lay_out_forward(p, a, &c, &s, d->scratch);
  w->dt = 0;
  c.map[0] = 0;
  for (long k = 0; k < tape->rows; ++k) {
    if (!begin_taped(p, w, tape->row + k * tape->size, &b)) return tape->rows - k;
    if (k == 0) {
      values_at_start(p, w, &b);
      double slide[p->joints + 1];
      for (int i = 0; i < p->joints; ++i) slide[i] = at(p->slides, p->slide_of[i]);
      for (int j = 0; j < d->count; ++j) {
        change_nodes(p, d, j, b.values, w->psi0, slide, c.arms, d->columns + j * all, d->q + (long)j * p->dofs);
        store_change(p, d, 0, j);
      }
    }
    memset(b.mu, 0, all * sizeof(double));
    if (p->joints) pull_map(p, w, &b); /* for the forces on ties */
    const double *fields[PULLED_FIELDS] = {w->D, p->q, p->v, p->a, p->before, p->internal, b.omega, b.of_internal};
    double t = p->t + p->level * w->dt;
    memset(b.omega, 0, p->dofs * sizeof(double));
    memset(b.of_internal, 0, (long)p->cells * p->cell_internal * sizeof(double));
    find_slopes(p, &a->internal_forces, fields, t, w->dt, s.of_elements[0]);
    find_slopes(p, &a->drag, fields, t, w->dt, s.of_elements[1]);
    find_point_slopes(p, a, s.of_points);
    memcpy(c.tangent, w->tangent, p->stored_values * sizeof(double));
    if (!p->band && !factorise(p, w)) return tape->rows - k;
    for (int j = 0; j < d->count; ++j) {
      if (!push_direction(p, w, a, &s, &c, d, &b, k, tape->rows, j)) return tape->rows - k;
      store_change(p, d, k + 1, j);
    }
  }
  p->kept.present = 0;
  return 0;
}
