/* The derivatives of a run, forwards (docs/theory/derivatives.md): from changes of the numbers of a scene to
   those of the states at the ends of sub-steps. Each direction is a change of all numbers. A group of WAYS directions
   is followed at once, as all of them need the same numbers of a sub-step; in the comments "the change" of something
   is that in the directions of a group. */

#pragma once

#include "adjoint.h"

/* Changes in a sub-step: those of the configuration and of natural strains at the end, of forces, of columns with
   ties, residual and arms of joints, of values of Tv; `none` is zero. The block has right sides and solutions
   (work.h). */
typedef struct {
  Ways *end, *none, *force, *columns, *reduced, *arms, *map, *block, *natural_end, *springs;
  Ways *followed; /* forces of joints that friction follows */
  Ways *on_joints, *moments, *closing; /* forces of joints, moments of springs, closing forces */
  Ways *on_borders; /* right sides of borders, and their solutions */
  double *found, *trial;
  FixedPoint following;
  /* Whether offsets, axes and rests of joints, or places of nodes that slide, change in any direction; and paths. */
  int moves_joints, moves_paths;
  int held;           /* whether the configuration at the end is held in all directions */
  int *reached;
} Change;

/* Derivatives of the forces: of elements as pieces of `Pulled`, and whether these are by the configurations at the end
   and at the start, not by increment and start; of forces at points [force][weight][given]. */
typedef struct {
  double *of_elements[2], *of_points;
  int by_ends[2];
} Slopes;

static int any(long n, const double *values) {
  for (long i = 0; i < n; ++i)
    if (values[i] != 0) return 1;
  return 0;
}

static int numbers_of_element(const Problem *p, const Pulled *of) {
  return (of->increment + of->start + of->before) * p->cell_dofs + of->internal * p->cell_internal +
         (of->natural + of->natural_end) * p->cell_natural + of->tail;
}

static long blocks_of(const Form *form) {
  long blocks = 0;
  for (int i = 0; i < form->integrals; ++i) blocks += (form->of[i].cells + LANES - 1) / LANES;
  return blocks;
}

static Ways *allocate_ways(double **at, long n) { return (Ways *)allocate(at, n * WAYS); }

static long lay_out_forward(const Problem *p, const Adjoint *a, Change *c, Slopes *s, double *at) {
  double *begin = at;
  long n = p->dofs, columns = p->columns + p->ties, points = 0;
  const Pulled *works[] = {&a->internal_forces, &a->drag};
  long most = n > columns ? n : columns;
  c->end = allocate_ways(&at, n), c->none = allocate_ways(&at, most), c->force = allocate_ways(&at, n);
  c->columns = allocate_ways(&at, columns), c->reduced = allocate_ways(&at, most);
  c->arms = allocate_ways(&at, 2L * p->joints), c->map = allocate_ways(&at, 1 + 4L * p->joints);
  c->on_joints = allocate_ways(&at, 3L * p->scene_joints), c->moments = allocate_ways(&at, p->scene_joints);
  c->closing = allocate_ways(&at, p->closures), c->springs = allocate_ways(&at, p->spring_width);
  c->on_borders = allocate_ways(&at, p->borders);
  c->block = allocate_ways(&at, p->positions), c->reached = (int *)allocate(&at, p->positions);
  for (int i = 0; i < 2; ++i)
    s->of_elements[i] = allocate(&at, blocks_of(&works[i]->slopes) * works[i]->slope_numbers * LANES);
  for (int k = 0; k < p->points->all; ++k)
    points += (p->points->of[k].size + p->points->of[k].internal) * (long)a->arguments[k];
  s->of_points = allocate(&at, points);
  c->natural_end = allocate_ways(&at, (long)p->cells * p->cell_natural);
  c->followed = allocate_ways(&at, p->points->all);
  long followed = (long)WAYS * p->points->followed.size;
  c->found = allocate(&at, followed), c->trial = allocate(&at, followed);
  c->following.size = followed, c->following.memory = allocate(&at, FIXED_POINT_ROWS * followed);
  return at - begin;
}

long fx_forward_scratch(const Problem *p, const Adjoint *a) {
  Change c;
  Slopes s;
  return lay_out_forward(p, a, &c, &s, 0);
}

static int weights_of_piece(const Problem *p, const Pulled *of, int i) {
  return of->of_internal[i] ? p->cell_internal : p->cell_dofs;
}

/* Where a piece begins in the slopes of a block, behind the work. */
static double *piece_in(const Problem *p, const Pulled *of, int piece, double *slopes) {
  long at = 1;
  for (int i = 0; i < piece; ++i) at += of->piece_size[i] * weights_of_piece(p, of, i);
  return slopes + at * LANES;
}

static int is_by_increment(const Pulled *of, int i) { return of->increment && of->piece_at[i] == 0; }

/* The piece by the start with the weights of one by the increment, or -1. */
static int piece_by_start(const Problem *p, const Pulled *of, int i) {
  for (int k = 0; of->start && k < of->pieces; ++k)
    if (of->piece_at[k] == p->cell_dofs && of->of_internal[k] == of->of_internal[i]) return k;
  return -1;
}

static int can_be_by_ends(const Problem *p, const Pulled *of) {
  for (int i = 0; i < of->pieces; ++i)
    if (is_by_increment(of, i) && piece_by_start(p, of, i) < 0) return 0;
  return of->increment;
}

/* With `by_ends` the slopes by the start become those at a fixed end. */
static void find_slopes(const Problem *p, const Pulled *of, int by_ends, const double *const *fields, double t, double dt,
                        double *to) {
  const Form *form = &of->slopes;
  set_time(p, form, t, dt);
  for (int i = 0; i < form->integrals; ++i)
    for (long block = 0; block * LANES < form->of[i].cells; ++block, to += (long)of->slope_numbers * LANES) {
      evaluate(p, form, form->of + i, block, fields, to);
      for (int k = 0; by_ends && k < of->pieces; ++k) {
        if (!is_by_increment(of, k)) continue;
        double *by_end = piece_in(p, of, k, to), *by_start = piece_in(p, of, piece_by_start(p, of, k), to);
        for (int l = 0; l < of->piece_size[k] * weights_of_piece(p, of, k) * LANES; ++l) by_start[l] -= by_end[l];
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

/* Adds the products of slopes [number][weight][lane], of one lane, and changes. */
INLINED void add_products(int numbers, int weights, const double *slopes, const Ways *x, Ways *sums) {
  for (int q = 0; q < numbers; ++q)
#pragma GCC unroll 12
    for (int k = 0; k < weights; ++k, slopes += LANES) sums[k] += *slopes * x[q];
}

/* The change of the forces of an element, or of the increments of its internal variables, by those of its numbers: those
   before `tail` in x. With `held` the end does not change. */
INLINED void sum_pieces(const Pulled *of, int held, int internal, int weights, const double *slopes, const Ways *x,
                        int before_tail, const Ways *tail, int n, int m, Ways *sums) {
  slopes += LANES; /* behind the work */
  for (int k = 0; k < weights; ++k) sums[k] = (Ways){0};
  for (int i = 0; i < of->pieces; ++i) {
    int numbers = of->piece_size[i], at = of->piece_at[i];
    const Ways *own = at < before_tail ? x + at : tail + (at - before_tail);
    if (of->of_internal[i] == internal && !(held && is_by_increment(of, i)))
      add_products(numbers, weights, slopes, own, sums);
    slopes += (long)numbers * (of->of_internal[i] ? m : n) * LANES;
  }
}

/* Adds the change of the forces of elements with n degrees of freedom, or with `grows` that of their internal variables
   to these. */
INLINED void change_cells(int n, const Problem *p, const Pulled *of, const double *slopes, int by_ends, const Group *g,
                          const Change *c, const Ways *tail, int grows) {
  const Form *form = &of->slopes;
  int m = p->cell_internal, all = numbers_of_element(p, of), s = p->cell_natural;
  int held = by_ends && c->held, strained[] = {of->natural, of->natural_end};
  const Ways *natural[] = {g->natural, c->natural_end}, *end = c->end;
  Ways x[all], sums[n + m];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long cell = 0; cell < own->cells; ++cell) {
      long block = cell / LANES, lane = cell % LANES;
      const double *of_cell = slopes + block * of->slope_numbers * LANES + lane;
      const int *dofs = own->dofs + block * n * LANES + lane, *inside = own->internal + block * m * LANES + lane;
      Ways *at = x;
      for (int k = 0; of->increment && k < n; ++k) {
        int dof = dofs[k * LANES];
        at[k] = held ? (Ways){0} : by_ends ? end[dof] : c->held ? -g->q[dof] : end[dof] - g->q[dof];
      }
      at += of->increment * n;
      for (int k = 0; of->start && k < n; ++k) *at++ = g->q[dofs[k * LANES]];
      for (int k = 0; of->before && k < n; ++k) *at++ = g->before[dofs[k * LANES]];
      for (int k = 0; of->internal && k < m; ++k) *at++ = g->internal[inside[k * LANES]];
      for (int k = 0; k < 2; ++k)
        for (int l = 0; strained[k] && l < s; ++l) *at++ = natural[k][own->natural[(block * s + l) * LANES + lane]];
      const Ways *behind = tail + cell * of->tail;
      if (of->parameters_at >= 0) {
        behind = memcpy(at, behind, of->tail * sizeof(Ways));
        for (int k = 0; k < form->parameters; ++k) at[of->parameters_at + k] = g->parameters[form->parameter[k]];
      }
      if (grows) {
        sum_pieces(of, held, 1, m, of_cell, x, all - of->tail, behind, n, m, sums);
        for (int k = 0; k < m; ++k) g->internal[inside[k * LANES]] += p->per_weight[k] * sums[k];
        continue;
      }
      sum_pieces(of, held, 0, n, of_cell, x, all - of->tail, behind, n, m, sums);
      for (int k = 0; k < n; ++k) c->force[dofs[k * LANES]] += sums[k];
    }
    slopes += (own->cells + LANES - 1) / LANES * of->slope_numbers * LANES;
    tail += (own->cells + LANES - 1) / LANES * LANES * of->tail;
  }
}

static void change_elements(const Problem *p, const Pulled *of, const double *slopes, int by_ends, const Group *g,
                            const Change *c, const Ways *tail) {
  if (p->cell_dofs == 6) change_cells(6, p, of, slopes, by_ends, g, c, tail, 0); /* sums stay in registers */
  else change_cells(p->cell_dofs, p, of, slopes, by_ends, g, c, tail, 0);
}

/* The change of a coordinate of a force at points (point_forces.h). */
static Ways change_of(const PointForce *e, int k, const Ways *nodes, const Ways *columns) {
  if (e->slide >= 0) return columns[e->column];
  return e->dof[k] < 0 ? (Ways){0} : nodes[e->dof[k]];
}

/* Adds the change of the forces at points to nodes, to columns for slides, and to the moments of joints; or with
   `grown` sets that of their internal variables. */
static void change_points(const Problem *p, const Adjoint *a, const double *slopes, const Group *g, const Change *c,
                          const Ways *end, const Ways *columns, Ways *grown) {
  const Ways *numbers = g->points, *thrust = g->thrust;
  for (int k = 0; k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    int n = e->size, all = a->arguments[k], before = 3 * n + 2 + e->internal + e->remembered;
    Ways x[all];
    memset(x, 0, sizeof x);
    for (int i = 0; i < n; ++i)
      x[i] = change_of(e, i, g->q, g->columns), x[n + i] = change_of(e, i, end, columns) - x[i];
    for (int i = 0; i < e->internal; ++i) x[3 * n + 2 + i] = g->spring_internal[e->first_internal + i];
    for (int i = before; i < all - e->parameters; ++i) x[i] = *numbers++;
    for (int i = 0; i < e->parameters; ++i) x[all - e->parameters + i] = g->parameters[e->parameter[i]];
    if (k >= p->points->external && k < p->points->external + p->thrusts)
      x[before] = thrust[0], x[before + 1] = thrust[1], thrust += 2;
    for (int i = 0; i < n + e->internal; ++i, slopes += all) {
      if ((i >= n) != (grown != 0)) continue;
      Ways sum = sum_of_products(all, slopes, x);
      if (grown) grown[e->first_internal + i - n] = sum;
      else if (e->slide >= 0) c->reduced[e->column] += sum;
      else if (e->dof[i] >= 0) c->force[e->dof[i]] += sum;
      if (i == 1 && e->joint >= 0 && !grown) c->moments[e->joint] += sum;
    }
  }
}

static void turn_ways(double psi, Ways x, Ways y, Ways *out) {
  double c = cos(psi), s = sin(psi);
  out[0] = c * x - s * y, out[1] = s * x + c * y;
}

/* Sums of columns and arms. */
static void sum_changes(const Problem *p, const Change *c, const double *values, const Ways *columns, Ways *q) {
  memset(q, 0, p->dofs * sizeof *q);
  for (int k = 0; k < p->equal; ++k) q[p->entry_row[k]] += columns[p->entry_column[k]];
  for (int k = p->equal; k < p->entries; ++k)
    q[p->entry_row[k]] += p->entry_sign[k] * values[p->entry_value[k]] * columns[p->entry_column[k]];
  for (int k = 0; k < p->followers; ++k) q[p->follower[k]] += p->joint_sign[p->through[k]] * c->arms[p->through[k]];
}

/* The changes of all paths in one direction; 0 if none change, or if the group has no such direction. */
static double *paths_of(const Problem *p, const Group *g, const Change *c, int way) {
  return c->moves_paths && way < g->count ? g->paths + way * path_start(p, p->sliders) : 0;
}

/* The change of the configuration from that of columns, of which it sets those of ties and sliding nodes, at the
   start (0) or the end (1) of the sub-step. */
static void change_nodes(const Problem *p, const Work *w, const Adjoint *a, const Group *g, const Change *c, int end,
                         const SlideEnds *slides, const double *values, const double *psi, const double *slide,
                         Ways *columns, Ways *q) {
  for (int i = 0; c->moves_joints && i < p->joints; ++i) {
    const Ways *o = g->offset + 2 * i, *e = g->axis + 2 * i;
    double rest = a->slide_at_rest[i];
    Ways now[2], turned[2];
    turn_ways(psi[i], o[0], o[1], now), turn_ways(psi[i], e[0], e[1], turned);
    for (int k = 0; k < 2; ++k)
      c->arms[2 * i + k] = now[k] - o[k] + slide[i] * turned[k] - rest * e[k] - g->rest[i] * p->axis[2 * i + k];
  }
  Ways *tie = columns + p->columns;
  memset(tie, 0, p->ties * sizeof *tie);
  for (int k = 0; k < p->tie_arms; ++k) tie[p->tie_arm_of[k]] += p->joint_sign[p->tie_arm[k]] * c->arms[p->tie_arm[k]];
  for (int k = 0; k < p->tie_entries; ++k)
    tie[p->tie_of[k]] += p->tie_sign[k] * values[p->tie_value[k]] * columns[p->tie_column[k]];
  sum_changes(p, c, values, columns, q);
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *own = p->slider + i;
    for (int j = 0; j < WAYS; ++j) {
      double change[3] = {0}, *paths = paths_of(p, g, c, j);
      spread_slider(own, slides[i].T[end], in_way(q, j), in_way(columns, j), WAYS);
      if (paths) change_place(p, w, own, end, paths + path_start(p, i), change);
      for (int k = 0; k < own->components; ++k) columns[own->carried[k]][j] += change[k] - g->places[3 * i + k][j];
    }
    sum_changes(p, c, values, columns, q);
  }
}

/* The change of the values of Tv. */
static void change_map(const Problem *p, const Work *w, const Group *g, const Change *c, const Ways *end,
                       const Ways *columns) {
  double late = p->level, early = 1 - p->level;
  for (int i = 0; i < p->joints; ++i) {
    const Ways *o = g->offset + 2 * i, *e = g->axis + 2 * i;
    int column = p->slide_column[i];
    Ways turns[] = {change_at(g->q, p->guide[i]), change_at(end, p->guide[i])};
    Ways slides[] = {change_at(g->columns, column), change_at(columns, column)};
    Ways mean[2] = {{0}}, mean_t[2] = {{0}}, own[2] = {{0}}, along[2] = {{0}}, bend = w->guide_bend[i] * (turns[1] - turns[0]);
    double psi = w->psi0[i], d0 = at(p->slides, p->slide_of[i]), slope = w->guide_slope[i];
    for (int side = 0; side < 2; ++side) {
      const double *rho = (side ? w->rho1 : w->rho0) + 2 * i, *t = (side ? w->t1 : w->t0) + 2 * i;
      double share = side ? late : early, length = d0;
      if (side) psi += at(w->D, p->guide[i]), length += at(w->z, column);
      if (c->moves_joints)
        turn_ways(psi, o[0] + length * e[0], o[1] + length * e[1], own), turn_ways(psi, e[0], e[1], along);
      mean[0] += share * (own[0] - rho[1] * turns[side] + t[0] * slides[side]);
      mean[1] += share * (own[1] + rho[0] * turns[side] + t[1] * slides[side]);
      mean_t[0] += share * (along[0] - t[1] * turns[side]), mean_t[1] += share * (along[1] + t[0] * turns[side]);
    }
    Ways *map = c->map + 1 + 4 * i;
    map[0] = -mean[1], map[1] = mean[0];
    for (int k = 0; k < 2; ++k) map[2 + k] = bend * w->mean_t[2 * i + k] + slope * mean_t[k];
  }
}

/* Adds the change of Tv^T r: that of r, and that which Tv has; forces on ties are those of `pull_map`. */
static void change_rows_of_map(const Problem *p, const Work *w, const Change *c, const double *on_ties) {
  const double *r = with_carried(p, w);
  Ways *out = c->reduced;
  for (int k = 0; k < p->equal; ++k) out[p->entry_column[k]] += c->force[p->entry_row[k]];
  for (int k = p->equal; k < p->entries; ++k) {
    int row = p->entry_row[k], value = p->entry_value[k];
    out[p->entry_column[k]] += p->entry_sign[k] * (w->virtual_map[value] * c->force[row] + c->map[value] * r[row]);
  }
  for (int k = p->tie_entries - 1; p->ties && k >= 0; --k)
    out[p->tie_column[k]] += p->tie_sign[k] * (c->map[p->tie_value[k]] * on_ties[p->columns + p->tie_of[k]] +
                                               w->virtual_map[p->tie_value[k]] * out[p->columns + p->tie_of[k]]);
}

/* Those of the configuration and of columns at the end. */
static const Ways *end_of(const Change *c) { return c->held ? c->none : c->end; }
static const Ways *columns_of(const Change *c) { return c->held ? c->none : c->columns; }

/* The change of the gap of a loop at the end. */
static Ways change_of_gap(const Problem *p, const Work *w, const Change *c, const Ways *q, int k) {
  int i = p->gap_arm[k], j = i / 2;
  Ways gap = change_at(q, p->gap_b[k]) - change_at(q, p->gap_a[k]);
  if (i < 0) return gap;
  gap -= c->arms[i] + (i % 2 ? w->rho1[i - 1] : -w->rho1[i + 1]) * change_at(q, p->guide[j]);
  return gap - w->t1[i] * change_at(columns_of(c), p->slide_column[j]);
}

/* Position in the elimination about which a chain or a band is eliminated. */
static int middle_of_tangent(const Problem *p) { return p->borders ? middle_of_elimination(p) : p->positions / 2; }

/* Factors of the tangent with its borders; returns 0 if it is singular. */
static int factorise_tangent(Problem *p, const Work *w) {
  int middle = middle_of_tangent(p), n = p->unknowns;
  Ends of = ends_around(n, p->band, middle);
  memset(w->reduced, 0, p->free * sizeof(double)), memset(w->y, 0, n * sizeof(double));
  if (p->chain && !eliminate_chain(p, w, middle / 3, 1)) return 0;
  if (!p->chain && !(p->band ? eliminate_tangent(p, w, n, of) : factorise(p, w))) return 0;
  if (!p->borders) return 1;
  for (int i = 0; i < p->positions; ++i) reach(p, w, i);
  if (p->chain) solve_chain_block(p, w, middle / 3);
  else if (p->band) solve_band_block(p, w, of);
  else solve_sparse_block(p, w, &p->rows, w->factors);
  factorise_corner(p, w);
  return 1;
}

/* Unknowns of the borders, and the others with them (solve_borders). */
static void change_borders(const Problem *p, const Work *w, const Change *c) {
  int m = p->borders;
  Ways *g = c->on_borders;
  memset(g, 0, m * sizeof *g);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free) /* the slide is an unknown of the other equations that is its right side there */
      g[ON_BORDER - p->row_at[a->column]] = c->block[p->order[a->column]];
  for (int i = 0; i < p->guided; ++i) /* and so are the forces of guides */
    g[p->guide_border + i] = c->block[p->order[p->unknowns - p->closures + p->guided_closure[i]]];
  for (const BorderEntry *e = w->border_entry; e < w->border_entry + *w->border_entries; ++e)
    g[e->border] -= e->value * c->block[e->column];
  solve_corner(p, w, g);
  for (int i = 0; i < p->positions; ++i)
    c->block[i] -= sum_of_products(m, w->block + (long)i * p->block + 1, g);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free) c->block[p->order[a->column]] = g[ON_BORDER - p->row_at[a->column]];
}

/* Solves for the right sides of the block, by the tangent's factors. */
static void solve_right_sides(const Problem *p, const Work *w, const Change *c) {
  int middle = middle_of_tangent(p);
  Work own = *w;
  own.block = (double *)c->block, own.reached = c->reached;
  if (p->chain) solve_chain_columns(p, &own, middle / 3, 0, 1);
  else if (p->band) solve_band_columns(p, &own, ends_around(p->unknowns, p->band, middle), 0, 1);
  else if (p->changing) solve_sparse_columns(p, &own, &p->changing->rows, p->changing->factors, 0, 1);
  else solve_sparse_columns(p, &own, &p->rows, w->factors, 0, 1);
  if (p->borders) change_borders(p, w, c);
}

/* Rows [direction][size] of changes. */
static void store_rows(const Ways *from, long size, int count, double *to) {
  for (long i = 0; i < size; ++i)
    for (int j = 0; j < count; ++j) to[j * size + i] = from[i][j];
}

static void store_state(const Problem *p, const Directions *d, const Group *g, long boundary, long first) {
  long k = d->row_at[boundary], row = k * d->count + first, n = p->dofs;
  if (k < 0) return;
  store_rows(g->q, n, g->count, d->q_rows + row * n);
  store_rows(g->v, n, g->count, d->v_rows + row * n);
  for (int j = 0; j < g->count; ++j) {
    double *slides = d->slide_rows + (row + j) * p->scene_joints;
    for (int i = 0; i < p->joints; ++i)
      if (p->slide_column[i] >= 0) slides[p->slide_of[i]] = g->columns[p->slide_column[i]][j];
    for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) slides[a->joint] = g->columns[a->column][j];
  }
  if (!d->internal_rows) return;
  long m = (long)p->cells * p->cell_internal, s = p->spring_width;
  store_rows(g->internal, m, g->count, d->internal_rows + row * m);
  store_rows(g->spring_internal, s, g->count, d->spring_rows + row * s);
}

/* The change of the configuration at the end from that of the columns. */
static void change_end(const Problem *p, const Work *w, const Adjoint *a, const Group *g, const Change *c,
                       const SlideEnds *slides) {
  double psi[p->joints + 1], slide[p->joints + 1];
  for (int i = 0; i < p->joints; ++i) {
    psi[i] = w->psi0[i] + at(w->D, p->guide[i]);
    slide[i] = at(p->slides, p->slide_of[i]) + at(w->z, p->slide_column[i]);
  }
  change_nodes(p, w, a, g, c, 1, slides, w->values, psi, slide, c->columns, c->end);
}

/* Begins with the changes at the end that driven motions alone give, which are held else. */
static void begin_ends(const Problem *p, const Work *w, const Adjoint *a, const Group *g, Change *c,
                       const SlideEnds *slides) {
  memcpy(c->columns + p->free, g->driven, p->driven * sizeof(Ways));
  c->held = !c->moves_joints && !c->moves_paths && !any((long)p->driven * WAYS, (const double *)g->driven);
  if (c->held) return;
  memset(c->columns, 0, p->free * sizeof(Ways));
  change_end(p, w, a, g, c, slides);
}

/* Adds the change of the forces of inertia and weight. */
static void change_inertia(const Problem *p, const Work *w, const Group *g, const Change *c) {
  double per_dt = rates_per_path(p, w->dt);
  Ways *moving = c->reduced; /* which begins afterwards */
  for (int i = 0; i < p->dofs; ++i) {
    Ways increment = c->held ? -g->q[i] : c->end[i] - g->q[i];
    moving[i] = per_dt * (per_dt / 2 * w->slope[i] * increment - g->v[i]);
  }
  for (int i = 0; i < p->dofs; ++i) {
    Ways sum = c->force[i];
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k) sum += p->mass[k] * moving[p->mass_column[k]];
    for (int k = p->mass_start[i]; g->changes_mass && k < p->mass_start[i + 1]; ++k)
      sum += g->mass[k] * w->acc[p->mass_column[k]];
    c->force[i] = g->changes_mass ? sum - acting(p) * g->weight[i] : sum;
  }
}

/* The change of the residual in the columns, and of nodal forces, for that of the columns at the end. */
static void change_residual(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Group *g,
                            const Change *c, const Backward *b) {
  const Ways *end = end_of(c), *columns = columns_of(c);
  memset(c->force, 0, p->dofs * sizeof(Ways));
  memset(c->moments, 0, p->scene_joints * sizeof(Ways));
  change_elements(p, &a->internal_forces, s->of_elements[0], s->by_ends[0], g, c, g->of_elements);
  change_elements(p, &a->drag, s->of_elements[1], s->by_ends[1], g, c, g->of_drag);
  change_inertia(p, w, g, c);
  memset(c->reduced, 0, (p->columns + p->ties) * sizeof(Ways));
  change_points(p, a, s->of_points, g, c, end, columns, 0);
  if (p->points->members) change_members(p, a, g, end, c->force, 0);
  for (int k = 0; k < p->loads; ++k) {
    double now = (1 - p->level) * b->loads[k] + p->level * b->loads[p->loads + k];
    Ways more = (1 - p->level) * g->loads[k] + p->level * g->loads[p->loads + k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i)
      c->force[p->load_dof[i]] -= p->load_force[i] * more + g->load_force[i] * now;
  }
  if (p->joints) change_map(p, w, g, c, end, columns);
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      c->reduced[p->gap_column[k]] -= p->gap_sign[k] * c->map[p->gap_value[k]] * w->closing[i];
  for (int j = 0; p->sliders && j < WAYS; ++j)
    carry_changes(p, w, b->slides, in_way(c->map, j), (const double *[]){in_way(g->q, j), in_way(end, j)},
                  (const double *[]){in_way(g->columns, j), in_way(columns, j)}, paths_of(p, g, c, j),
                  in_way(c->force, j), in_way(c->reduced, j), WAYS);
  change_rows_of_map(p, w, c, b->on_ties);
}

/* The right sides of the block. */
static void set_right_sides(const Problem *p, const Work *w, const Change *c) {
  const int *order = order_now(p);
  for (int i = 0; i < p->free; ++i) c->block[order[i]] = c->reduced[i];
  for (int i = p->free; i < p->unknowns; ++i) c->block[order[i]] = (Ways){0};
  for (int i = 0; i < p->closures; ++i)
    c->block[order[p->unknowns - p->closures + i]] = change_of_gap(p, w, c, end_of(c), i);
}

/* The change of the configuration at the end with the solution. */
static void finish_ends(const Problem *p, const Work *w, const Adjoint *a, const Group *g, Change *c,
                        const SlideEnds *slides) {
  const int *order = order_now(p);
  for (int i = 0; i < p->free; ++i) c->columns[i] = -c->block[order[i]];
  c->held = 0;
  change_end(p, w, a, g, c, slides);
}

/* The changes of the forces that friction follows, from those of joints. */
static void follow_changes(const Problem *p, const Work *w, const Group *g, const Change *c) {
  for (int k = 0; p->friction_follows && k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    if (e->load < 0) continue;
    double slope[5];
    const Ways *change = c->on_joints + 3 * e->load;
    Ways start = change_at(g->q, e->load_turn), end = change_at(c->end, e->load_turn);
    followed_size(e, w->joint_forces, p->q, w->D, p->level, slope);
    c->followed[k] = slope[0] * change[0] + slope[1] * change[1] + slope[2] * (start + p->level * (end - start));
    for (int i = 0; c->moves_joints && i < p->joints; ++i)
      if (p->slide_of[i] == e->load) c->followed[k] += slope[3] * g->axis[2 * i] + slope[4] * g->axis[2 * i + 1];
    for (int i = 0; i < p->sliders; ++i) {
      const Slider *a = p->slider + i;
      if (a->joint != e->load) continue;
      slope_of_axis(a, w->joint_forces, slope);
      for (int j = 0; j < WAYS; ++j) {
        double *paths = paths_of(p, g, c, j);
        c->followed[k][j] += change_of_axis(p, w, a, slope, (const double *[]){in_way(g->q, j), in_way(c->end, j)},
                                            (const double *[]){in_way(g->columns, j), in_way(c->columns, j)},
                                            paths ? paths + path_start(p, i) : 0, WAYS);
      }
    }
  }
}

/* Adds to forces on nodes what the changes of closing forces add to those of nodes on beams (carry_in_loops). */
static void carry_closing_changes(const Problem *p, const Work *w, const Change *c, Ways *on_nodes) {
  double force[3];
  for (int j = 0; p->guided && j < WAYS; ++j) {
    memset(w->scratch, 0, p->dofs * sizeof(double)), memset(w->columns, 0, (p->columns + p->ties) * sizeof(double));
    for (int i = 0; i < p->closures; ++i)
      for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
        w->columns[p->gap_column[k]] -= p->gap_sign[k] * w->virtual_map[p->gap_value[k]] * c->closing[i][j];
    for (const Slider *a = p->slider + p->sliders - 1; a >= p->slider; --a) {
      find_held_force(a, w->virtual_map, w->scratch, w->columns, force, 1);
      push_beam(a, a->virtual_map, force, w->scratch, w->columns, 1);
    }
    for (int i = 0; i < p->dofs; ++i) on_nodes[i][j] += w->scratch[i];
  }
}

/* The changes of the forces of driven and fixed columns, and of joints, from those of the solution. */
static void change_forces(const Problem *p, const Work *w, const Directions *d, const Group *g, const Change *c,
                          long at, long first) {
  long constrained = p->columns - p->free, joints = 3 * p->scene_joints, row = at * d->count + first;
  Ways *closing = c->closing, *on_nodes = c->force, *on_joints = c->on_joints;
  double *one = w->gap;
  for (int j = 0; p->closures && j < WAYS; ++j) {
    for (int i = 0; i < p->closures; ++i) one[i] = c->reduced[p->loop_column[p->following[i]]][j];
    solve_gaps_transposed(p, w, w->part_virtual, w->order_virtual, one);
    for (int i = 0; i < p->closures; ++i) closing[i][j] = one[i];
  }
  for (int i = 0; i < p->closures; ++i) {
    for (int k = p->gap_start[i]; k < p->gap_start[i + 1]; ++k)
      c->reduced[p->loop_column[p->gap_near[k]]] -= w->G_virtual[k] * closing[i];
    if (p->gap_b[i] >= 0) on_nodes[p->gap_b[i]] -= closing[i];
    if (p->gap_a[i] >= 0) on_nodes[p->gap_a[i]] += closing[i];
  }
  carry_closing_changes(p, w, c, on_nodes);
  if (at >= 0) store_rows(c->reduced + p->free, constrained, g->count, d->constraint_rows + row * constrained);
  if (!joints) return;
  memset(on_joints, 0, joints * sizeof(Ways));
  for (int j = 0; j < WAYS; ++j)
    pass_forces(p, 0, p->passes_of_forces, in_way(on_nodes, j), in_way(on_joints, j), WAYS);
  for (int k = 0; k < p->closures; ++k) on_joints[p->gap_force[k]] += closing[k];
  for (int i = 0; i < p->joints; ++i) {
    const double *lever = w->virtual_map + 1 + 4 * i, *F = w->joint_forces + 3 * p->slide_of[i];
    const Ways *more = c->map + 1 + 4 * i, *change = on_joints + 3 * p->slide_of[i];
    for (int k = 0; k < 2 && p->guide[i] >= 0; ++k) on_nodes[p->guide[i]] += lever[k] * change[k] + more[k] * F[k];
  }
  for (int i = 0; i < p->scene_joints; ++i) on_joints[3 * i + 2] -= c->moments[i];
  for (int j = 0; j < WAYS; ++j)
    pass_forces(p, p->passes_of_forces, p->passes, in_way(on_nodes, j), in_way(on_joints, j), WAYS);
  if (at >= 0) store_rows(on_joints, joints, g->count, d->joint_rows + row * joints);
  follow_changes(p, w, g, c);
}

/* Sets the changes of the forces that friction follows; returns whether they are others. */
static int change_followed(const Problem *p, Change *c, const Group *g) {
  int all = p->points->all, changed = 0;
  for (int set = 0; set < 2; ++set) {
    long n = 0;
    if (set) changed = next_trial(&c->following, c->found, 0, c->trial);
    for (int k = 0; k < all; ++k) {
      const PointForce *e = p->points->of + k;
      for (int j = 0; e->load >= 0 && j < WAYS; ++j, ++n) {
        double *followed = in_way(g->spring_internal + e->first_internal + FOLLOWED, j);
        if (set) *followed = c->trial[n];
        else c->trial[n] = *followed, c->found[n] = c->followed[k][j];
      }
    }
  }
  return changed;
}

/* The changes of natural strains at the end. */
static void change_natural(const Problem *p, const Group *g, const Change *c, const Backward *b) {
  memset(c->natural_end, 0, (long)p->cells * p->cell_natural * sizeof(Ways));
  for (int k = 0; k < p->naturals; ++k)
    for (int i = p->natural_start[k]; i < p->natural_start[k + 1]; ++i)
      c->natural_end[p->natural_at[i]] += g->natural_value[i] * b->natural[k] + p->natural_value[i] * g->naturals[k];
}

/* The changes of the state at the end, from the solution. */
static void change_state(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Group *g,
                         const Change *c) {
  double per_dt = rates_per_path(p, w->dt);
  if (p->spring_width) {
    memset(c->springs, 0, p->spring_width * sizeof(Ways));
    change_points(p, a, s->of_points, g, c, c->end, c->columns, c->springs);
    if (p->points->members) change_members(p, a, g, c->end, 0, c->springs);
    memcpy(g->spring_internal, c->springs, p->spring_width * sizeof(Ways));
  }
  if (p->cell_internal)
    change_cells(p->cell_dofs, p, &a->internal_forces, s->of_elements[0], s->by_ends[0], g, c, g->of_elements, 1);
  if (p->naturals) memcpy(g->natural, c->natural_end, (long)p->cells * p->cell_natural * sizeof(Ways));
  if (a->internal_forces.before) memcpy(g->before, g->q, p->dofs * sizeof(Ways));
  for (int k = 0; k < p->massless_count; ++k) { /* half of their rates */
    int i = p->massless[k];
    g->v[i] = per_dt / 2 * w->slope[i] * (c->end[i] - g->q[i]);
  }
  for (int i = 0; i < p->dofs; ++i) {
    g->v[i] = per_dt * w->slope[i] * (c->end[i] - g->q[i]) - g->v[i];
    g->q[i] = c->end[i];
  }
  if (p->scene_joints) memcpy(g->columns, c->columns, (p->columns + p->ties) * sizeof(Ways));
}

/* A group of directions through a sub-step, which is repeated for the forces that friction follows. */
static void push_group(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, Change *c,
                       const Directions *d, const Group *g, const Backward *b, long at, long first) {
  int forces = at >= 0 || p->friction_follows, again = 1;
  if (p->naturals) change_natural(p, g, c, b);
  begin_fixed_point(&c->following);
  for (int i = 0; again && i <= MOST_TRIALS; ++i) {
    begin_ends(p, w, a, g, c, b->slides);
    change_residual(p, w, a, s, g, c, b);
    set_right_sides(p, w, c);
    solve_right_sides(p, w, c);
    finish_ends(p, w, a, g, c, b->slides);
    if (forces) change_residual(p, w, a, s, g, c, b), change_forces(p, w, d, g, c, at, first);
    again = p->friction_follows && change_followed(p, c, g);
  }
  change_state(p, w, a, s, g, c);
}

/* A sub-step of a tape with the factors of its tangent and the derivatives of its forces; returns 0 in a singular
   position. */
static int begin_push(Problem *p, Work *w, const Adjoint *a, const Slopes *s, const Backward *b, const double *row,
                      int forces) {
  if (!begin_taped(p, w, a, row, b)) return 0;
  memset(b->mu, 0, (p->columns + p->ties) * sizeof(double));
  if (p->joints) pull_map(p, w, b); /* for the forces on ties */
  const double *fields[PULLED_FIELDS] = {w->D, p->q, p->v, p->a, p->before, p->internal,
                                         p->natural, w->natural_end, b->omega, b->of_internal};
  double t = p->t + p->level * w->dt;
  memset(b->omega, 0, p->dofs * sizeof(double));
  memset(b->of_internal, 0, (long)p->cells * p->cell_internal * sizeof(double));
  find_slopes(p, &a->internal_forces, s->by_ends[0], fields, t, w->dt, s->of_elements[0]);
  find_slopes(p, &a->drag, s->by_ends[1], fields, t, w->dt, s->of_elements[1]);
  find_point_slopes(p, a, s->of_points);
  if (forces && p->scene_joints) find_joint_forces(p, w);
  return factorise_tangent(p, w);
}

/* The changes of the configuration at the start of the first sub-step, and of equilibria that depend on none before. */
static void begin_changes(const Problem *p, const Work *w, const Adjoint *a, const Group *g, const Change *c,
                          const Backward *b, int apart, int first) {
  if (apart) {
    memset(g->columns, 0, (p->columns + p->ties) * sizeof(Ways));
    memset(g->q, 0, p->dofs * sizeof(Ways));
  }
  if (!first) return;
  values_at_start(p, w, b);
  double slide[p->joints + 1];
  for (int i = 0; i < p->joints; ++i) slide[i] = at(p->slides, p->slide_of[i]);
  change_nodes(p, w, a, g, c, 0, b->slides, b->values, w->psi0, slide, g->columns, g->q);
}

/* Follows a tape with changes in several directions; returns the number of sub-steps that are left where a
   tangent is singular. */
long fx_push(Problem *p, const Tape *tape, const Adjoint *a, const Directions *d) {
  Work work, *w = &work;
  Backward b;
  Change c;
  Slopes s;
  lay_out(p, w, p->scratch), lay_out_backward(p, &b, a->scratch), lay_out_forward(p, a, &c, &s, d->scratch);
  w->dt = NAN;
  c.map[0] = (Ways){0};
  memset(c.none, 0, (p->dofs > p->columns + p->ties ? p->dofs : p->columns + p->ties) * sizeof(Ways));
  memset(c.arms, 0, 2L * p->joints * sizeof(Ways)), memset(c.block, 0, p->positions * sizeof(Ways));
  for (int i = 0; i < p->positions; ++i) c.reached[i] = 1;
  long groups = groups_of(d), joints = groups * WAYS * p->joints;
  c.moves_joints = any(2 * joints, d->offset) || any(2 * joints, d->axis) || any(joints, d->rest) ||
                   any(groups * WAYS * 3 * p->sliders, d->places);
  c.moves_paths = any(d->count * path_start(p, p->sliders), d->paths);
  s.by_ends[0] = can_be_by_ends(p, &a->internal_forces), s.by_ends[1] = can_be_by_ends(p, &a->drag);
  for (long row = 0; row < tape->rows; ++row) {
    long k = tape->first + row;
    if (!begin_push(p, w, a, &s, &b, tape->row + row * tape->size, d->force_at[k] >= 0 || p->friction_follows))
      return tape->rows - row;
    for (long i = 0; i < groups; ++i) {
      Group g = group_in(p, d, i, k, tape->all);
      begin_changes(p, w, a, &g, &c, &b, tape->apart, k == 0);
      if (row == 0) store_state(p, d, &g, k, i * WAYS);
      push_group(p, w, a, &s, &c, d, &g, &b, d->force_at[k], i * WAYS);
      store_state(p, d, &g, k + 1, i * WAYS);
    }
  }
  p->kept.present = 0;
  return 0;
}
