/* The derivatives of a run, forwards (docs/theory/derivatives.md): from changes of the numbers of a scene to
   those of the states at the ends of sub-steps. Each direction is a change of all numbers. A group of GROUP_SIZE directions
   is followed at once, as all of them need the same numbers of a sub-step; in the comments "the change" of something
   is that in the directions of a group. */

#pragma once

#include "adjoint.h"

/* Room for changes in a sub-step: right sides and solutions (work.h), and those of bordering rows. */
typedef struct {
  Changes *block, *on_bordering_rows;
  double *found, *trial, *inside;
  FixedPoint following;
  /* Whether offsets, axes and rests of joints, or places and paths of nodes that slide, change in any direction. */
  int moves_joints;
  int *reached;
} Forward;

static int any(long n, const double *values) {
  for (long i = 0; i < n; ++i)
    if (values[i] != 0) return 1;
  return 0;
}

static Changes *allocate_changes(double **at, long n) { return (Changes *)allocate(at, n * GROUP_SIZE); }

static long lay_out_forward(const Problem *p, const Adjoint *a, Forward *c, Slopes *s, double *at) {
  double *begin = at;
  const Vjp *works[] = {&a->internal_forces, &a->drag};
  c->on_bordering_rows = allocate_changes(&at, p->bordering_rows);
  c->block = allocate_changes(&at, p->positions), c->reached = (int *)allocate(&at, p->positions);
  for (int i = 0; i < 2; ++i)
    s->of_elements[i] = allocate(&at, blocks_of(&works[i]->slopes) * works[i]->slope_numbers * LANES);
  long followed = (long)GROUP_SIZE * p->points->followed.size;
  c->found = allocate(&at, followed), c->trial = allocate(&at, followed);
  c->following.size = followed, c->following.memory = allocate(&at, FIXED_POINT_ROWS * followed);
  return at - begin;
}

OF_DERIVATIVES long fx_forward_scratch(const Problem *p, const Adjoint *a) {
  Forward c;
  Slopes s;
  return lay_out_forward(p, a, &c, &s, 0);
}

/* Position in the elimination about which a chain or a band is eliminated. */
static int middle_of_tangent(const Problem *p) { return HAS(SLIDERS) && p->bordering_rows ? middle_of_elimination(p) : p->positions / 2; }

/* Factors of the tangent with its bordering rows; returns 0 if it is singular. */
static int factorise_tangent(Problem *p, const Work *w) {
  int middle = middle_of_tangent(p), n = p->unknowns;
  Ends of = ends_around(n, p->band, middle);
  memset(w->reduced, 0, p->free * sizeof(double)), memset(w->y, 0, n * sizeof(double));
  if (HAS(CHAIN) && !eliminate_chain(p, w, middle / 3, 1)) return 0;
  if (!HAS(CHAIN) && !(HAS(BAND) ? eliminate_tangent(p, w, n, of) : factorise(p, w))) return 0;
  if (!HAS(SLIDERS) || !p->bordering_rows) return 1;
  for (int i = 0; i < p->positions; ++i) reach(p, w, i);
  if (HAS(CHAIN)) solve_chain_block(p, w, middle / 3);
  else if (HAS(BAND)) solve_band_block(p, w, of);
  else solve_sparse_columns(p, w, &p->rows, w->factors, p->block / 4);
  factorise_corner(p, w);
  return 1;
}

/* Unknowns of the bordering rows, and the others with them (solve_bordering_rows). */
static void change_bordering_rows(const Problem *p, const Work *w, const Forward *c) {
  int m = p->bordering_rows;
  Changes *g = c->on_bordering_rows;
  memset(g, 0, m * sizeof *g);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free) /* the slide is an unknown of the other equations that is its right side there */
      g[ON_BORDER - p->row_at[a->column]] = c->block[p->order[a->column]];
  for (int i = 0; i < p->carried; ++i) /* and so are the forces of carriers */
    g[p->carrier_bordering + i] = c->block[p->order[p->unknowns - p->closures + p->carried_closure[i]]];
  for (const BorderingEntry *e = w->bordering_entry; e < w->bordering_entry + *w->bordering_entries; ++e)
    g[e->bordering_row] -= e->value * c->block[e->column];
  solve_corner(p, w, g);
  for (int i = 0; i < p->positions; ++i)
    c->block[i] -= sum_of_products(m, w->block + (long)i * p->block + 1, g);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free) c->block[p->order[a->column]] = g[ON_BORDER - p->row_at[a->column]];
}

/* Solves for the right sides of the block, by the tangent's factors. */
static void solve_right_sides(const Problem *p, const Work *w, const Forward *c) {
  int middle = middle_of_tangent(p);
  Work own = *w;
  own.block = (double *)c->block, own.reached = c->reached;
  if (HAS(CHAIN)) solve_chain_columns(p, &own, middle / 3, 0, 1);
  else if (HAS(BAND)) solve_band_columns(p, &own, ends_around(p->unknowns, p->band, middle), 0, 1);
  else if (HAS(MEMBERS) && p->changing) solve_sparse_columns(p, &own, &p->changing->rows, p->changing->factors, 1);
  else solve_sparse_columns(p, &own, &p->rows, w->factors, 1);
  if (HAS(SLIDERS) && p->bordering_rows) change_bordering_rows(p, w, c);
}

/* Rows [direction][size] of changes. */
static void store_rows(const Changes *from, long size, int count, double *to) {
  for (long i = 0; i < size; ++i)
    for (int j = 0; j < count; ++j) to[j * size + i] = from[i][j];
}

static void store_state(const Problem *p, const Directions *d, const Layout *at, const Changes *x, int count, long boundary,
                        long first) {
  long k = d->row_at[boundary], row = k * d->count + first, n = p->dofs;
  if (k < 0) return;
  store_rows(x + at->q, n, count, d->q_rows + row * n);
  store_rows(x + at->v, n, count, d->v_rows + row * n);
  for (int j = 0; j < count; ++j) {
    double *slides = d->slide_rows + (row + j) * p->scene_joints;
    for (int i = 0; i < p->joints; ++i)
      if (p->slide_column[i] >= 0) slides[p->slide_of[i]] = x[at->Y + p->slide_column[i]][j];
    for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) slides[a->joint] = x[at->Y + a->column][j];
  }
  if (!d->internal_rows) return;
  long m = (long)p->cells * p->cell_internal, s = p->spring_width;
  store_rows(x + at->internal, m, count, d->internal_rows + row * m);
  store_rows(x + at->spring_internal, s, count, d->spring_rows + row * s);
}

/* Whether the unknowns that are held, and nothing else, give the configuration at the end. */
static int holds_ends(const Problem *p, const Layout *at, const Forward *c, const Changes *x) {
  return !c->moves_joints && !any((long)p->driven * GROUP_SIZE, (const double *)(x + at->driven));
}

/* Sets the changes of the configuration at the end, for the solution in the block or with none for held unknowns. */
static void set_ends(const Problem *p, const Linear *l, const Forward *c, int held, const Changes *solution,
                     Changes *x) {
  const Layout *at = &l->at;
  const int *order = order_now(p);
  int first = solution ? p->free : 0, forces = p->points->all || p->points->members;
  for (int i = 0; i < first; ++i) x[at->Y1 + i] = -solution[order[i]];
  if (!held || forces || p->joints || p->closures || p->sliders)
    memset(x + at->Y1 + first, 0, (at->natural1 - at->Y1 - first) * sizeof(Changes));
  memset(x + at->natural1, 0, (at->internal1 - at->natural1) * sizeof(Changes));
  if (held) jvp(l->of + STRAINED, x), jvp(l->of + WEIGHED, x);
  for (int i = STRAINED; !held && i <= PLACED; ++i)
    if (i != ARMS || c->moves_joints) jvp(l->of + i, x);
}

/* The changes of forces and rows for that of the configuration at the end. */
static void jvp_forces(const Problem *p, const Work *w, const Adjoint *a, const Linear *l, const Slopes *s,
                        const Directions *d, const Forward *c, long group, int held, Changes *x) {
  const Layout *at = &l->at;
  memset(x + at->springs1, 0, (at->R - at->springs1) * sizeof(Changes));
  change_elements(p, &a->internal_forces, s->of_elements[0], s->by_ends[0], at, held, x,
                  (Changes *)d->of_elements + group * d->element_numbers);
  change_elements(p, &a->drag, s->of_elements[1], s->by_ends[1], at, held, x,
                  (Changes *)d->of_drag + group * d->drag_numbers);
  jvp_inertia(p, w, at, d->changes_mass[group], held, x);
  memset(x + at->R, 0, (at->size - at->R) * sizeof(Changes)); /* after its use as room */
  for (int i = TOUCHED; i <= SLID; ++i) jvp(l->of + i, x);
  if (c->moves_joints) jvp(l->of + LEVERS, x);
  for (int i = CARRIED; i <= MAPPED; ++i) jvp(l->of + i, x);
}

/* The right sides of the block. */
static void set_right_sides(const Problem *p, const Layout *at, const Changes *x, Changes *block) {
  const int *order = order_now(p);
  for (int i = 0; i < p->free; ++i) block[order[i]] = x[at->R + i];
  for (int i = p->free; i < p->unknowns; ++i) block[order[i]] = (Changes){0};
  for (int i = 0; i < p->closures; ++i) block[order[p->unknowns - p->closures + i]] = x[at->closures + i];
}

/* The changes of closing forces and of forces of joints, and of those that friction follows. */
static void jvp_joints(const Problem *p, const Work *w, const Linear *l, const Forward *c, Changes *x) {
  const Layout *at = &l->at;
  for (int j = 0; p->closures && j < GROUP_SIZE; ++j) {
    for (int i = 0; i < p->closures; ++i) w->closure[i] = x[at->R + p->loop_column[p->following[i]]][j];
    solve_closures_transposed(p, w, w->part_virtual, w->order_virtual, w->closure);
    for (int i = 0; i < p->closures; ++i) x[at->closing + i][j] = w->closure[i];
  }
  jvp(l->of + CLOSED, x);
  jvp(l->of + JOINED, x);
}

/* Sets the changes of the forces that friction follows; returns whether they are others. */
static int change_followed(const Problem *p, Forward *c, const Layout *at, Changes *x) {
  long n = 0;
  for (int set = 0, changed = 0; set < 2; ++set, n = 0) {
    if (set && !(changed = next_trial(&c->following, c->found, 0, c->trial))) return 0;
    for (const PointForce *e = p->points->of; e < p->points->of + p->points->all; ++e) {
      if (e->load < 0) continue;
      Changes *followed = x + at->spring_internal + e->first_internal + FOLLOWED;
      for (int j = 0; j < GROUP_SIZE; ++j, ++n)
        if (set) (*followed)[j] = c->trial[n];
        else c->trial[n] = (*followed)[j], c->found[n] = x[at->followed + n / GROUP_SIZE][j];
    }
  }
  return 1;
}

/* The changes of the state at the end, from the solution. */
static void change_state(const Problem *p, const Work *w, const Adjoint *a, const Layout *at, const Slopes *s,
                         const Changes *numbers, Changes *x) {
  double per_dt = rates_per_path(p, w->dt);
  Changes *q = x + at->q, *v = x + at->v, *end = x + at->q1;
  if (p->cell_internal)
    change_cells(p->cell_dofs, p, &a->internal_forces, s->of_elements[0], s->by_ends[0], at, 0, x, numbers, 1);
  for (int k = 0; k < p->massless_count; ++k) { /* half of their rates */
    int i = p->massless[k];
    v[i] = per_dt / 2 * w->slope[i] * (end[i] - q[i]);
  }
  if (a->internal_forces.q_previous) memcpy(x + at->q_previous, q, p->dofs * sizeof(Changes));
  for (int i = 0; i < p->dofs; ++i) v[i] = per_dt * w->slope[i] * (end[i] - q[i]) - v[i], q[i] = end[i];
  if (p->scene_joints) memcpy(x + at->Y, x + at->Y1, (p->columns + p->auxiliaries) * sizeof(Changes));
  memcpy(x + at->spring_internal, x + at->springs1, p->spring_width * sizeof(Changes));
  memcpy(x + at->natural, x + at->natural1, (at->loads - at->natural) * sizeof(Changes));
}

/* A group of directions through a sub-step, which is repeated for the forces that friction follows. */
static void jvp_group(const Problem *p, const Work *w, const Adjoint *a, const Linear *l, const Slopes *s, Forward *c,
                       const Directions *d, long group, long row, int count, Changes *x) {
  const Layout *at = &l->at;
  int forces = row >= 0 || p->friction_follows, constrained = p->columns - p->free, joints = 3 * p->scene_joints;
  long to = row * d->count + group * GROUP_SIZE;
  begin_fixed_point(&c->following);
  for (int i = 0; i <= MOST_TRIALS; ++i) {
    int held = holds_ends(p, at, c, x);
    set_ends(p, l, c, held, 0, x);
    jvp_forces(p, w, a, l, s, d, c, group, held, x);
    set_right_sides(p, at, x, c->block);
    solve_right_sides(p, w, c);
    set_ends(p, l, c, 0, c->block, x);
    if (forces) jvp_forces(p, w, a, l, s, d, c, group, 0, x), jvp_joints(p, w, l, c, x);
    if (!p->friction_follows || !change_followed(p, c, at, x)) break;
  }
  if (row >= 0) store_rows(x + at->R + p->free, constrained, count, d->constraint_rows + to * constrained);
  if (row >= 0) store_rows(x + at->forces, joints, count, d->joint_rows + to * joints);
  if (!forces && p->spring_width) {
    memset(x + at->springs1, 0, p->spring_width * sizeof(Changes));
    jvp(l->of + TOUCHED, x), jvp(l->of + FORCED, x);
  }
  change_state(p, w, a, at, s, (Changes *)d->of_elements + group * d->element_numbers, x);
}

/* A sub-step of a tape with its laws and the factors of its tangent; returns 0 in a singular position. */
static int begin_jvp(Problem *p, Work *w, const Adjoint *a, Linear *l, const Slopes *s, const Forward *c,
                      const double *row, int forces, int first) {
  if (!begin_taped(p, w, a, row, l)) return 0;
  linearise(p, w, a, l, forces, first);
  memset(w->scratch, 0, p->dofs * sizeof(double));
  const double *fields[VJP_FIELDS] = {w->D, p->q, p->v, p->a, p->q_previous, p->internal,
                                         p->natural, w->natural_end, w->scratch, c->inside};
  double t = p->t + p->level * w->dt;
  find_slopes(p, &a->internal_forces, s->by_ends[0], fields, t, w->dt, s->of_elements[0]);
  find_slopes(p, &a->drag, s->by_ends[1], fields, t, w->dt, s->of_elements[1]);
  return factorise_tangent(p, w);
}

/* Follows a tape with changes in several directions; returns the number of sub-steps that are left where a
   tangent is singular. */
OF_DERIVATIVES long fx_jvp(Problem *p, const Tape *tape, const Adjoint *a, const Directions *d) {
  Work work, *w = &work;
  Linear l;
  Backward b;
  Forward c;
  Slopes s;
  double *trial;
  lay_out(p, w, p->scratch), lay_out_backward(p, a, &l, &b, &trial, a->scratch);
  lay_out_forward(p, a, &c, &s, d->scratch), begin_linear(p, w, a, &l);
  const Layout *at = &l.at;
  long groups = (d->count + GROUP_SIZE - 1) / GROUP_SIZE, steps = at->Y1 - at->loads, left = tape->rows, of_state = at->v - at->Y;
  w->dt = NAN, c.inside = b.of_internal;
  memset(b.of_internal, 0, (long)p->cells * p->cell_internal * sizeof(double));
  memset(c.block, 0, p->positions * sizeof(Changes));
  for (int i = 0; i < p->positions; ++i) c.reached[i] = 1;
  c.moves_joints = 0;
  for (long i = 0; i < groups; ++i) {
    const Changes *x = (Changes *)d->x + i * at->size;
    c.moves_joints |= any((at->members - at->offset) * GROUP_SIZE, (double *)(x + at->offset));
  }
  s.by_ends[0] = can_be_by_ends(p, &a->internal_forces), s.by_ends[1] = can_be_by_ends(p, &a->drag);
  for (; left; --left) {
    long row = tape->rows - left, k = tape->first + row;
    if (!begin_jvp(p, w, a, &l, &s, &c, tape->row + row * tape->size, d->force_at[k] >= 0 || p->friction_follows, !k)) break;
    for (long i = 0; i < groups; ++i) {
      Changes *x = (Changes *)d->x + i * at->size;
      int count = d->count - i * GROUP_SIZE < GROUP_SIZE ? d->count - i * GROUP_SIZE : GROUP_SIZE;
      if (tape->apart) memset(x + at->Y, 0, of_state * sizeof(Changes));
      if (k == 0) {
        memset(x + at->arms, 0, (at->natural1 - at->arms) * sizeof(Changes));
        memset(x + at->q, 0, p->dofs * sizeof(Changes)), jvp(l.of + BEGUN, x);
      }
      if (row == 0) store_state(p, d, at, x, count, k, i * GROUP_SIZE);
      memcpy(x + at->loads, (Changes *)d->of_steps + (i * tape->all + k) * steps, steps * sizeof(Changes));
      jvp_group(p, w, a, &l, &s, &c, d, i, d->force_at[k], count, x);
      store_state(p, d, at, x, count, k + 1, i * GROUP_SIZE);
    }
  }
  p->kept.present = 0;
  end_linear(&l);
  return left;
}
