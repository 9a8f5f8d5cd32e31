/* The derivatives of a run, forwards (docs/theory/derivatives.md): from changes of the numbers of a scene to
   those of the states at the ends of sub-steps. Each direction is a change of all numbers; in the comments "the
   change" of something is that in one direction. */

#pragma once

#include "adjoint.h"

/* Changes in a sub-step: of each direction those of the configuration and of natural strains at the end, of the
   increment, of forces, of columns with ties, residual and arms of joints; of one direction those of values of Tv.
   The block has right sides and solutions of all directions (work.h), behind a column that is zero. */
typedef struct {
  double *end, *increment, *force, *columns, *reduced, *arms, *map, *block, *natural_end;
  double *followed, *found, *trial; /* of each direction the forces of joints that friction follows */
  FixedPoint following;
  double *on_joints, *moments, *closing; /* of one direction: forces of joints, moments of springs, closing forces */
  double *on_borders; /* right sides of borders, and their solutions [border][direction] */
  /* Whether offsets, axes and rests of joints, or places of nodes that slide, change in any; and paths. */
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

/* Columns of the block: a column that is zero, then those of all directions, then those of borders. */
static long width_of_block(const Problem *p, int count) { return 1L + count + p->borders; }

static int numbers_of_element(const Problem *p, const Pulled *of) {
  return (of->increment + of->start + of->before) * p->cell_dofs + of->internal * p->cell_internal +
         (of->natural + of->natural_end) * p->cell_natural + of->tail;
}

static long blocks_of(const Form *form) {
  long blocks = 0;
  for (int i = 0; i < form->integrals; ++i) blocks += (form->of[i].cells + LANES - 1) / LANES;
  return blocks;
}

static long lay_out_forward(const Problem *p, const Adjoint *a, int count, Change *c, Slopes *s, double *at) {
  double *begin = at;
  long n = p->dofs + LANES, columns = p->columns + p->ties, points = 0;
  const Pulled *works[] = {&a->internal_forces, &a->drag};
  c->end = allocate(&at, n * count), c->increment = allocate(&at, n * count), c->force = allocate(&at, n * count);
  c->columns = allocate(&at, columns * count), c->reduced = allocate(&at, columns * count);
  c->arms = allocate(&at, 2L * p->joints * count), c->map = allocate(&at, 1 + 4 * p->joints);
  c->on_joints = allocate(&at, 3 * p->scene_joints), c->moments = allocate(&at, p->scene_joints);
  c->closing = allocate(&at, p->closures);
  c->on_borders = allocate(&at, (long)p->borders * count);
  c->block = allocate(&at, width_of_block(p, count) * p->positions), c->reached = (int *)allocate(&at, p->positions);
  for (int i = 0; i < 2; ++i)
    s->of_elements[i] = allocate(&at, blocks_of(&works[i]->slopes) * works[i]->slope_numbers * LANES);
  for (int k = 0; k < p->points->all; ++k)
    points += (p->points->of[k].size + p->points->of[k].internal) * (long)a->arguments[k];
  s->of_points = allocate(&at, points);
  c->natural_end = allocate(&at, (long)count * p->cells * p->cell_natural);
  c->followed = allocate(&at, (long)count * p->points->all);
  long followed = (long)count * p->points->followed.size;
  c->found = allocate(&at, followed), c->trial = allocate(&at, followed);
  c->following.size = followed, c->following.memory = allocate(&at, FIXED_POINT_ROWS * followed);
  return at - begin;
}

long fx_forward_scratch(const Problem *p, const Adjoint *a, int count) {
  Change c;
  Slopes s;
  return lay_out_forward(p, a, count, &c, &s, 0);
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

/* Adds the products of slopes [number][weight][lane] and changes [number][lane]. */
INLINED void add_products(int numbers, int weights, const double *slopes, const double *x, Lanes *sums) {
  for (int q = 0; q < numbers; ++q, x += LANES) {
    Lanes change = *(const Lanes *)x;
#pragma GCC unroll 12
    for (int k = 0; k < weights; ++k, slopes += LANES) sums[k] += *(const Lanes *)slopes * change;
  }
}

/* The changes of forces of elements, or of the increments of internal variables, by those of their numbers: those
   before `tail` in x. With `held` the end does not change. */
static void sum_pieces(const Pulled *of, int held, int internal, int weights, const double *slopes, const double *x,
                       int before_tail, const double *tail, int n, int m, Lanes *sums) {
  slopes += LANES; /* behind the work */
  for (int k = 0; k < weights; ++k) sums[k] = (Lanes){0};
  for (int i = 0; i < of->pieces; ++i) {
    int numbers = of->piece_size[i];
    int at = of->piece_at[i];
    const double *own = at < before_tail ? x + at * LANES : tail + (at - before_tail) * LANES;
    if (of->of_internal[i] == internal && !(held && is_by_increment(of, i))) {
      if (weights == 6) /* the sums stay in registers */
        add_products(numbers, 6, slopes, own, sums);
      else if (weights == 9)
        add_products(numbers, 9, slopes, own, sums);
      else
        add_products(numbers, weights, slopes, own, sums);
    }
    slopes += (long)numbers * (of->of_internal[i] ? m : n) * LANES;
  }
}

/* Adds the changes of the forces of elements in all directions, or with `grown` those of their internal variables. */
static void change_elements(const Problem *p, const Pulled *of, const double *slopes, int by_ends, const Directions *d,
                            const Change *c, const double *tails, long tail_numbers, long row, long rows,
                            double *grown) {
  const Form *form = &of->slopes;
  int n = p->cell_dofs, m = p->cell_internal, all = numbers_of_element(p, of), s = p->cell_natural;
  int held = by_ends && c->held;
  const double *first = by_ends ? c->end : c->increment;
  int there[] = {of->increment, of->start, of->before}, strained[] = {of->natural, of->natural_end};
  const double *natural[] = {d->natural, c->natural_end};
  long internal = (long)p->cells * m;
  double x[all * LANES];
  Lanes sums[n + m];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long block = 0; block * LANES < own->cells; ++block, slopes += (long)of->slope_numbers * LANES) {
      const int *dofs = own->dofs + block * n * LANES, *to = own->to + block * n * LANES;
      for (int j = 0; j < d->count; ++j) {
        const double *nodal[] = {first + j * (long)(p->dofs + LANES), d->q + (long)j * p->dofs,
                                 d->before + (long)j * p->dofs};
        double *at = held ? x + n * LANES : x;
        for (int k = held; k < 3; ++k)
          for (int l = 0; there[k] && l < n * LANES; l += LANES, at += LANES) *(Lanes *)at = lanes_of(nodal[k], dofs + l);
        if (of->internal) {
          const int *inside = own->internal + block * m * LANES;
          for (int l = 0; l < m * LANES; ++l) at[l] = d->internal[j * internal + inside[l]];
          at += m * LANES;
        }
        for (int end = 0; end < 2; ++end)
          if (strained[end]) {
            const int *inside = own->natural + block * s * LANES;
            for (int l = 0; l < s * LANES; ++l) at[l] = natural[end][(long)j * p->cells * s + inside[l]];
            at += s * LANES;
          }
        const double *tail = tails + j * tail_numbers;
        if (of->parameters_at >= 0) {
          const double *parameters = d->parameters + (j * rows + row) * 2 * p->parameter_count;
          tail = memcpy(at, tail, of->tail * LANES * sizeof(double));
          for (int k = 0; k < form->parameters; ++k)
            for (int l = 0; l < LANES; ++l)
              at[(of->parameters_at + k) * LANES + l] = parameters[form->parameter[k]];
        }
        sum_pieces(of, held, grown != 0, grown ? m : n, slopes, x, all - of->tail, tail, n, m, sums);
        if (!grown) {
          add(n, to, (const double *)sums, c->force + j * (long)(p->dofs + LANES));
          continue;
        }
        for (int k = 0; k < m; ++k)
          for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
            grown[j * internal + own->internal[(block * m + k) * LANES + l]] += p->per_weight[k] * sums[k][l];
      }
      tails += of->tail * LANES;
    }
  }
}

/* Adds the change of the forces at points to nodes, to columns for slides, and to the moments of joints; or with
   `grown` sets that of their internal variables. */
static void change_points(const Problem *p, const Adjoint *a, const double *slopes, const Directions *d, int j,
                          const double *increment, const double *start, const double *y0, const double *y1,
                          const double *thrust, const double *parameters, double *force, double *columns,
                          double *moments, double *grown) {
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
    for (int i = 0; i < e->parameters; ++i) x[all - e->parameters + i] = parameters[e->parameter[i]];
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
      if (i == 1 && e->joint >= 0) moments[e->joint] += sum;
    }
  }
}

/* Sums of columns and arms. */
static void sum_changes(const Problem *p, const double *values, const double *arms, const double *columns, double *q) {
  memset(q, 0, p->dofs * sizeof(double));
  for (int k = 0; k < p->equal; ++k) q[p->entry_row[k]] += columns[p->entry_column[k]];
  for (int k = p->equal; k < p->entries; ++k)
    q[p->entry_row[k]] += p->entry_sign[k] * values[p->entry_value[k]] * columns[p->entry_column[k]];
  for (int k = 0; k < p->followers; ++k) q[p->follower[k]] += p->joint_sign[p->through[k]] * arms[p->through[k]];
}

/* The changes of all paths in one direction; 0 if none change. */
static double *paths_of(const Problem *p, const Directions *d, const Change *c, int j) {
  return c->moves_paths ? d->paths + j * path_start(p, p->sliders) : 0;
}

/* The change of the configuration from that of columns, of which it sets those of ties and sliding nodes, at the
   start (0) or the end (1) of the sub-step. */
static void change_nodes(const Problem *p, const Work *w, const Directions *d, const Change *c, int j, int end,
                         const SlideEnds *slides, const double *values, const double *psi, const double *slide, double *arms,
                         double *columns, double *q) {
  for (int i = 0; i < p->joints; ++i) {
    const double *o = d->offset + 2 * ((long)j * p->joints + i), *e = d->axis + 2 * ((long)j * p->joints + i);
    double rest = d->at_rest[i], now[2], turned[2];
    turn(psi[i], o[0], o[1], now), turn(psi[i], e[0], e[1], turned);
    for (int c = 0; c < 2; ++c)
      arms[2 * i + c] = now[c] - o[c] + slide[i] * turned[c] - rest * e[c] -
                        d->rest[(long)j * p->joints + i] * p->axis[2 * i + c];
  }
  double *tie = columns + p->columns;
  memset(tie, 0, p->ties * sizeof(double));
  for (int k = 0; k < p->tie_arms; ++k) tie[p->tie_arm_of[k]] += p->joint_sign[p->tie_arm[k]] * arms[p->tie_arm[k]];
  for (int k = 0; k < p->tie_entries; ++k)
    tie[p->tie_of[k]] += p->tie_sign[k] * values[p->tie_value[k]] * columns[p->tie_column[k]];
  sum_changes(p, values, arms, columns, q);
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    spread_slider(a, slides[i].T[end], q, columns);
    double change[3] = {0};
    if (c->moves_paths) change_place(p, w, a, end, paths_of(p, d, c, j) + path_start(p, i), change);
    for (int k = 0; k < a->components; ++k)
      columns[a->carried[k]] += change[k] - d->places[3 * ((long)j * p->sliders + i) + k];
    sum_changes(p, values, arms, columns, q);
  }
}

/* The change of the values of Tv. */
static void change_map(const Problem *p, const Work *w, const Directions *d, int j, const Change *c,
                       const double *y0, const double *q0, const double *q1) {
  double late = p->level, early = 1 - p->level;
  for (int i = 0; i < p->joints; ++i) {
    const double *o = d->offset + 2 * ((long)j * p->joints + i), *e = d->axis + 2 * ((long)j * p->joints + i);
    double turns[] = {at(q0, p->guide[i]), at(q1, p->guide[i])}, slides[] = {0, 0};
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
  const double *r = with_carried(p, w);
  for (int k = p->equal; k < p->entries; ++k)
    out[p->entry_column[k]] += p->entry_sign[k] * c->map[p->entry_value[k]] * r[p->entry_row[k]];
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      out[p->gap_column[k]] -= p->gap_sign[k] * c->map[p->gap_value[k]] * w->closing[i];
  for (int k = p->tie_entries - 1; p->ties && k >= 0; --k)
    out[p->tie_column[k]] += p->tie_sign[k] * (c->map[p->tie_value[k]] * on_ties[p->columns + p->tie_of[k]] +
                                               w->virtual_map[p->tie_value[k]] * out[p->columns + p->tie_of[k]]);
}

/* The change of the gap of a loop at the end. */
static double change_of_gap(const Problem *p, const Work *w, const Change *c, const double *q, int k) {
  int i = p->gap_arm[k], j = i / 2;
  double gap = at(q, p->gap_b[k]) - at(q, p->gap_a[k]);
  if (i < 0) return gap;
  gap -= c->arms[i] + (i % 2 ? w->rho1[i - 1] : -w->rho1[i + 1]) * at(q, p->guide[j]);
  return p->slide_column[j] < 0 ? gap : gap - w->t1[i] * c->columns[p->slide_column[j]];
}

/* Copies the columns of the borders behind the right sides. */
static void copy_borders(const Problem *p, const Work *w, const Change *c, int count) {
  long width = width_of_block(p, count);
  for (int i = 0; i < p->positions; ++i)
    if (w->reached[i])
      memcpy(c->block + i * width + 1 + count, w->block + (long)i * p->block + 1, p->borders * sizeof(double));
}

/* Unknowns of the borders in all directions, and the others with them (solve_borders). */
static void change_borders(const Problem *p, const Work *w, const Change *c, int count) {
  int m = p->borders;
  long width = width_of_block(p, count);
  double *g = c->on_borders, *D = w->corner;
  memset(g, 0, (long)m * count * sizeof(double));
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free) /* the slide is an unknown of the other equations that is its right side there */
      memcpy(g + (long)(ON_BORDER - p->row_at[a->column]) * count, c->block + p->order[a->column] * width + 1,
             count * sizeof(double));
  for (const BorderEntry *e = w->border_entry; e < w->border_entry + *w->border_entries; ++e) {
    const double *row = c->block + e->column * width + 1;
    for (int j = 0; j < count; ++j) g[e->border * count + j] -= e->value * row[j];
    for (int k = 0; k < m; ++k) D[e->border * m + k] -= e->value * row[count + k];
  }
  solve_corner(p, count, D, g);
  for (int i = 0; i < p->positions; ++i) {
    double *row = c->block + i * width + 1;
    for (int k = 0; k < m; ++k)
      for (int j = 0; row[count + k] != 0 && j < count; ++j) row[j] -= row[count + k] * g[k * count + j];
  }
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    if (a->column < p->free)
      memcpy(c->block + p->order[a->column] * width + 1, g + (long)(ON_BORDER - p->row_at[a->column]) * count,
             count * sizeof(double));
}

/* Solves for all right sides of the block, by the tangent's factors. */
static int solve_block(Problem *p, const Work *w, const Change *c, int count) {
  Problem all = *p;
  Work own = *w;
  int middle = p->positions / 2, n = p->unknowns;
  Ends of = ends_around(n, p->band, middle);
  all.block = width_of_block(p, count), own.block = c->block, own.reached = c->reached;
  if (p->borders) copy_borders(p, w, c, count);
  for (int i = 0; i < p->positions; ++i) c->reached[i] = 1;
  memset(w->reduced, 0, p->free * sizeof(double)), memset(w->y, 0, n * sizeof(double));
  if (p->changing) all.rows = p->changing->rows, own.factors = p->changing->factors;
  if (p->chain) {
    if (!eliminate_chain(p, w, middle / 3, 1)) return 0;
    solve_chain_block(&all, &own, middle / 3);
  } else if (p->band) {
    if (!eliminate_tangent(p, w, n, of)) return 0;
    solve_band_block(&all, &own, of);
  } else {
    if (!factorise(p, w)) return 0;
    solve_sparse_block(&all, &own, &all.rows, own.factors);
  }
  if (p->borders) change_borders(p, w, c, count);
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
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    d->slide_rows[(k * d->count + j) * p->scene_joints + a->joint] =
        d->columns[j * (long)(p->columns + p->ties) + a->column];
  if (!d->internal_rows) return;
  long m = (long)p->cells * p->cell_internal, s = p->spring_width, row = k * d->count + j;
  memcpy(d->internal_rows + row * m, d->internal + j * m, m * sizeof(double));
  memcpy(d->spring_rows + row * s, d->spring_internal + j * s, s * sizeof(double));
}

/* Rotations of the guides of joints, and slides, at the end. */
static void arms_at_end(const Problem *p, const Work *w, double *psi, double *slide) {
  for (int i = 0; i < p->joints; ++i) {
    psi[i] = w->psi0[i] + at(w->D, p->guide[i]), slide[i] = at(p->slides, p->slide_of[i]);
    if (p->slide_column[i] >= 0) slide[i] += w->z[p->slide_column[i]];
  }
}

/* The change of the configuration at the end, and of the increment, from that of the columns. */
static void change_end(const Problem *p, const Work *w, const Directions *d, const Change *c, const SlideEnds *slides,
                       int j) {
  double psi[p->joints + 1], slide[p->joints + 1], *end = c->end + j * (long)(p->dofs + LANES);
  double *increment = c->increment + j * (long)(p->dofs + LANES);
  const double *q0 = d->q + (long)j * p->dofs;
  arms_at_end(p, w, psi, slide);
  change_nodes(p, w, d, c, j, 1, slides, w->values, psi, slide, c->arms, c->columns, end);
  for (int i = 0; i < p->dofs; ++i) increment[i] = end[i] - q0[i];
}

/* The same with columns, residual and arms of one direction. */
static Change in_direction(const Problem *p, const Change *c, int j) {
  long all = p->columns + p->ties;
  Change own = *c;
  own.columns += j * all, own.reduced += j * all, own.arms += 2L * p->joints * j;
  return own;
}

/* Whether the configuration at the end of a sub-step does not change where the unknowns are held. */
static int is_held(const Problem *p, const Directions *d, const Change *c, long row, long rows) {
  for (int j = 0; j < d->count; ++j)
    if (any(p->driven, d->driven + (j * rows + row) * p->driven)) return 0;
  return !c->moves_joints && !c->moves_paths;
}

/* The changes of the columns at the end: those of driven motions, and with `solved` of the unknowns. And of the
   configuration. */
static void change_ends(const Problem *p, const Work *w, const Directions *d, Change *c, const SlideEnds *slides,
                        long row, long rows, int solved) {
  long all = p->columns + p->ties, width = width_of_block(p, d->count);
  const int *order = order_now(p);
  c->held = !solved && is_held(p, d, c, row, rows);
  memset(c->columns, 0, d->count * all * sizeof(double));
  if (c->held) {
    memset(c->end, 0, d->count * (long)(p->dofs + LANES) * sizeof(double));
    memset(c->arms, 0, 2L * p->joints * d->count * sizeof(double));
    for (int j = 0; j < d->count; ++j)
      for (int i = 0; i < p->dofs; ++i) c->increment[j * (long)(p->dofs + LANES) + i] = -d->q[(long)j * p->dofs + i];
    return;
  }
  for (int i = 0; solved && i < p->free; ++i) {
    const double *found = c->block + order[i] * width + 1;
    for (int j = 0; j < d->count; ++j) c->columns[j * all + i] = -found[j];
  }
  for (int j = 0; j < d->count; ++j) {
    Change own = in_direction(p, c, j);
    memcpy(own.columns + p->free, d->driven + (j * rows + row) * p->driven, p->driven * sizeof(double));
    change_end(p, w, d, &own, slides, j);
  }
}

/* The change of the residual in the columns, and of nodal forces, for that of the columns at the end. Those of
   elements are there already. */
static void change_residual(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Change *c,
                            const Directions *d, const Backward *b, long row, long rows, int j) {
  long n = p->dofs, all = p->columns + p->ties;
  const double *y0 = d->columns + j * all, *q0 = d->q + j * n, *v0 = d->v + j * n;
  const double *loads = d->loads + (j * rows + row) * 2 * p->loads, *given = b->loads;
  const double *mass = d->mass + (long)j * p->mass_start[n], *thrust = d->thrust + (j * rows + row) * 2 * p->thrusts;
  const double *load_force = d->load_force + (long)j * p->load_start[p->loads];
  double per_dt = rates_per_path(p, w->dt), *force = c->force + j * (n + LANES);
  double *increment = c->increment + j * (n + LANES);
  memset(c->reduced, 0, all * sizeof(double)), memset(c->moments, 0, p->scene_joints * sizeof(double));
  const double *parameters = d->parameters + (j * rows + row) * 2 * p->parameter_count;
  change_points(p, a, s->of_points, d, j, increment, q0, y0, c->columns, thrust, parameters, force, c->reduced,
                c->moments, 0);
  if (p->points->members) change_members(p, a, d, j, increment, q0, force, 0);
  for (int i = 0; i < n; ++i) w->scratch[i] = per_dt * (per_dt / 2 * w->slope[i] * increment[i] - v0[i]);
  for (int i = 0; i < n; ++i) {
    double sum = -acting(p) * d->weight[j * n + i];
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k)
      sum += p->mass[k] * w->scratch[p->mass_column[k]];
    for (int k = p->mass_start[i]; d->changes_mass[j] && k < p->mass_start[i + 1]; ++k)
      sum += mass[k] * w->acc[p->mass_column[k]];
    force[i] += sum;
  }
  for (int k = 0; k < p->loads; ++k) {
    double now = (1 - p->level) * given[k] + p->level * given[p->loads + k];
    double more = (1 - p->level) * loads[k] + p->level * loads[p->loads + k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i)
      force[p->load_dof[i]] -= p->load_force[i] * more + load_force[i] * now;
  }
  const double *end = c->end + j * (n + LANES);
  if (p->joints) change_map(p, w, d, j, c, y0, q0, end);
  carry_changes(p, w, b->slides, c->map, (const double *[]){q0, end}, (const double *[]){y0, c->columns},
                paths_of(p, d, c, j), force, c->reduced);
  add_rows(p, w, force, c->reduced);
  if (p->joints) add_change_of_map(p, w, c, b->on_ties, c->reduced);
}

/* The right sides of the block. */
static void set_right_sides(const Problem *p, const Work *w, const Change *c, const Directions *d) {
  long all = p->columns + p->ties, width = width_of_block(p, d->count);
  const int *order = order_now(p);
  memset(c->block, 0, width * p->positions * sizeof(double));
  for (int i = 0; i < p->free; ++i) {
    double *to = c->block + order[i] * width + 1;
    for (int j = 0; j < d->count; ++j) to[j] = c->reduced[j * all + i];
  }
  for (int j = 0; j < d->count; ++j) {
    Change own = in_direction(p, c, j);
    const double *end = c->end + j * (long)(p->dofs + LANES);
    for (int i = 0; i < p->closures; ++i)
      c->block[order[p->unknowns - p->closures + i] * width + 1 + j] = change_of_gap(p, w, &own, end, i);
  }
}

/* The change of a rotation at the scheme's level. */
static double at_level(const Problem *p, const double *q, const double *increment, int dof) {
  return at(q, dof) + p->level * at(increment, dof);
}

/* The changes of the forces of driven and fixed columns, and of joints, from those of the solution. */
static void change_forces(const Problem *p, const Work *w, const Change *c, const Directions *d, long at, int j) {
  long constrained = p->columns - p->free, joints = 3 * p->scene_joints;
  double *closing = c->closing, *on_nodes = c->force + j * (long)(p->dofs + LANES), *on_joints = c->on_joints;
  for (int i = 0; i < p->closures; ++i) closing[i] = c->reduced[p->loop_column[p->following[i]]];
  if (p->closures) solve_gaps_transposed(p, w, w->part_virtual, w->order_virtual, closing);
  for (int i = 0; i < p->closures; ++i) {
    for (int k = p->gap_start[i]; k < p->gap_start[i + 1]; ++k)
      c->reduced[p->loop_column[p->gap_near[k]]] -= w->G_virtual[k] * closing[i];
    if (p->gap_b[i] >= 0) on_nodes[p->gap_b[i]] -= closing[i];
    if (p->gap_a[i] >= 0) on_nodes[p->gap_a[i]] += closing[i];
  }
  if (at >= 0) memcpy(d->constraint_rows + (at * d->count + j) * constrained, c->reduced + p->free, constrained * sizeof(double));
  if (!joints) return;
  memset(on_joints, 0, joints * sizeof(double));
  pass_forces(p, 0, p->passes_of_forces, on_nodes, on_joints);
  for (int k = 0; k < p->closures; ++k) on_joints[p->gap_force[k]] += closing[k];
  for (int i = 0; i < p->joints; ++i) {
    const double *lever = w->virtual_map + 1 + 4 * i, *more = c->map + 1 + 4 * i;
    const double *F = w->joint_forces + 3 * p->slide_of[i], *change = on_joints + 3 * p->slide_of[i];
    for (int k = 0; k < 2 && p->guide[i] >= 0; ++k) on_nodes[p->guide[i]] += lever[k] * change[k] + more[k] * F[k];
  }
  for (int i = 0; i < p->scene_joints; ++i) on_joints[3 * i + 2] -= c->moments[i];
  pass_forces(p, p->passes_of_forces, p->passes, on_nodes, on_joints);
  if (at >= 0) memcpy(d->joint_rows + (at * d->count + j) * joints, on_joints, joints * sizeof(double));
  const double *increment = c->increment + j * (long)(p->dofs + LANES), *q0 = d->q + (long)j * p->dofs;
  for (int k = 0; p->friction_follows && k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    if (e->load < 0) continue;
    double slope[3], turn = at_level(p, q0, increment, e->load_turn), *change = on_joints + 3 * e->load;
    followed_size(e, w->joint_forces, p->q, w->D, p->level, slope);
    double *followed = c->followed + (long)j * p->points->all + k;
    *followed = slope[0] * change[0] + slope[1] * change[1] + slope[2] * turn;
    for (int i = 0; i < p->sliders; ++i) {
      const Slider *a = p->slider + i;
      if (a->joint != e->load) continue;
      const double *nodal[] = {q0, c->end + j * (long)(p->dofs + LANES)};
      const double *columns[] = {d->columns + j * (long)(p->columns + p->ties), c->columns};
      double *paths = paths_of(p, d, c, j);
      slope_of_axis(a, w->joint_forces, slope);
      *followed += change_of_axis(p, w, a, slope, nodal, columns, paths ? paths + path_start(p, i) : 0);
    }
  }
}

/* Sets the changes of the forces that friction follows; returns whether they are others. */
static int change_followed(const Problem *p, Change *c, const Directions *d) {
  int all = p->points->all, changed = 0;
  for (int set = 0; set < 2; ++set) {
    long n = 0;
    if (set) changed = next_trial(&c->following, c->found, 0, c->trial);
    for (int k = 0; k < all; ++k) {
      const PointForce *e = p->points->of + k;
      for (int j = 0; e->load >= 0 && j < d->count; ++j, ++n) {
        double *followed = d->spring_internal + (long)j * p->spring_width + e->first_internal + FOLLOWED;
        if (set) *followed = c->trial[n];
        else c->trial[n] = *followed, c->found[n] = c->followed[(long)j * all + k];
      }
    }
  }
  return changed;
}

/* The changes of the state at the end, from the solution. */
static void change_state(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Change *c,
                         const Directions *d, const Backward *b, long row, long rows, int j) {
  long n = p->dofs, all = p->columns + p->ties;
  double *y0 = d->columns + j * all, *q0 = d->q + j * n, *v0 = d->v + j * n, per_dt = rates_per_path(p, w->dt);
  double *increment = c->increment + j * (n + LANES);
  if (p->spring_width) {
    const double *thrust = d->thrust + (j * rows + row) * 2 * p->thrusts;
    const double *parameters = d->parameters + (j * rows + row) * 2 * p->parameter_count;
    memset(b->lost_springs, 0, p->spring_width * sizeof(double));
    change_points(p, a, s->of_points, d, j, increment, q0, y0, c->columns, thrust, parameters, 0, 0, 0, b->lost_springs);
    if (p->points->members) change_members(p, a, d, j, increment, q0, 0, b->lost_springs);
    memcpy(d->spring_internal + (long)j * p->spring_width, b->lost_springs, p->spring_width * sizeof(double));
  }
  for (int i = 0; i < n; ++i) v0[i] = per_dt * w->slope[i] * increment[i] - v0[i];
  for (int k = 0; k < p->massless_count; ++k) {
    int i = p->massless[k];
    v0[i] = per_dt / 2 * w->slope[i] * increment[i];
  }
  memcpy(y0, c->columns, all * sizeof(double));
}

/* The changes of natural strains at the end. */
static void change_natural(const Problem *p, const Directions *d, const Change *c, const Backward *b, long row,
                           long rows) {
  long size = (long)p->cells * p->cell_natural, values = p->natural_start[p->naturals];
  memset(c->natural_end, 0, d->count * size * sizeof(double));
  for (int j = 0; j < d->count; ++j)
    for (int k = 0; k < p->naturals; ++k)
      for (int i = p->natural_start[k]; i < p->natural_start[k + 1]; ++i)
        c->natural_end[j * size + p->natural_at[i]] += d->natural_value[j * values + i] * b->natural[k] +
                                                       p->natural_value[i] * d->naturals[(j * rows + row) * p->naturals + k];
}

/* The changes of all forces in all directions: with those of the driven motions alone, or of the solution. */
static void change_balance(const Problem *p, const Work *w, const Adjoint *a, const Slopes *s, const Change *c,
                           const Directions *d, const Backward *b, long row, long rows, int solved) {
  long at = d->force_at[row];
  memset(c->force, 0, d->count * (long)(p->dofs + LANES) * sizeof(double));
  change_elements(p, &a->internal_forces, s->of_elements[0], s->by_ends[0], d, c, d->of_elements, d->element_numbers, row, rows, 0);
  change_elements(p, &a->drag, s->of_elements[1], s->by_ends[1], d, c, d->of_drag, d->drag_numbers, row, rows, 0);
  for (int j = 0; j < d->count; ++j) {
    Change own = in_direction(p, c, j);
    change_residual(p, w, a, s, &own, d, b, row, rows, j);
    if (solved) change_forces(p, w, &own, d, at, j);
  }
}

/* All directions through a sub-step; returns 0 if its tangent is singular, and AGAIN if it must be repeated, since
   the changes of the forces that friction follows are others. */
enum { AGAIN = 2 };

static int push_step(Problem *p, const Work *w, const Adjoint *a, const Slopes *s, Change *c,
                     const Directions *d, const Backward *b, long row, long rows, int may_repeat) {
  long n = p->dofs, internal = (long)p->cells * p->cell_internal;
  int forces = d->force_at[row] >= 0 || p->friction_follows;
  if (forces && p->scene_joints) find_joint_forces(p, w);
  if (p->naturals) change_natural(p, d, c, b, row, rows);
  change_ends(p, w, d, c, b->slides, row, rows, 0);
  change_balance(p, w, a, s, c, d, b, row, rows, 0);
  set_right_sides(p, w, c, d);
  if (!solve_block(p, w, c, d->count)) return 0;
  change_ends(p, w, d, c, b->slides, row, rows, 1);
  if (forces) change_balance(p, w, a, s, c, d, b, row, rows, 1);
  if (p->friction_follows && change_followed(p, c, d) && may_repeat) return AGAIN;
  for (int j = 0; j < d->count; ++j) {
    Change own = in_direction(p, c, j);
    change_state(p, w, a, s, &own, d, b, row, rows, j);
  }
  if (internal) {
    double *grown = d->grown;
    memset(grown, 0, d->count * internal * sizeof(double));
    change_elements(p, &a->internal_forces, s->of_elements[0], s->by_ends[0], d, c, d->of_elements, d->element_numbers, row, rows, grown);
    for (long i = 0; i < d->count * internal; ++i) d->internal[i] += grown[i];
  }
  if (p->naturals) memcpy(d->natural, c->natural_end, (long)d->count * p->cells * p->cell_natural * sizeof(double));
  if (a->internal_forces.before) memcpy(d->before, d->q, d->count * n * sizeof(double));
  for (int j = 0; j < d->count; ++j) memcpy(d->q + j * n, c->end + j * (n + LANES), n * sizeof(double));
  return 1;
}

/* A sub-step of a tape with its tangent and the derivatives of its forces; returns 0 in a singular position. */
static int begin_push(Problem *p, Work *w, const Adjoint *a, const Slopes *s, const Backward *b, const double *row) {
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
  return 1;
}

/* The changes of the configuration at the start of the first sub-step, and of equilibria that depend on none before. */
static void begin_changes(const Problem *p, const Work *w, const Directions *d, const Change *c, const Backward *b,
                          int apart, int first) {
  long all = p->columns + p->ties;
  if (apart) {
    memset(d->columns, 0, d->count * all * sizeof(double));
    memset(d->q, 0, d->count * (long)p->dofs * sizeof(double));
  }
  if (!first) return;
  values_at_start(p, w, b);
  double slide[p->joints + 1];
  for (int i = 0; i < p->joints; ++i) slide[i] = at(p->slides, p->slide_of[i]);
  for (int j = 0; j < d->count; ++j)
    change_nodes(p, w, d, c, j, 0, b->slides, b->values, w->psi0, slide, c->arms, d->columns + j * all,
                 d->q + (long)j * p->dofs);
}

/* Follows a tape with changes in several directions; returns the number of sub-steps that are left where a
   tangent is singular. */
long fx_push(Problem *p, const Tape *tape, const Adjoint *a, const Directions *d) {
  Work work, *w = &work;
  Backward b;
  Change c;
  Slopes s;
  lay_out(p, w, p->scratch), lay_out_backward(p, &b, a->scratch), lay_out_forward(p, a, d->count, &c, &s, d->scratch);
  w->dt = NAN;
  c.map[0] = 0;
  long joints = (long)d->count * p->joints;
  c.moves_joints = any(2 * joints, d->offset) || any(2 * joints, d->axis) || any(joints, d->rest) ||
                   any(3L * d->count * p->sliders, d->places);
  c.moves_paths = any(d->count * path_start(p, p->sliders), d->paths);
  s.by_ends[0] = can_be_by_ends(p, &a->internal_forces), s.by_ends[1] = can_be_by_ends(p, &a->drag);
  for (long row = 0; row < tape->rows; ++row) {
    long k = tape->first + row;
    begin_fixed_point(&c.following);
    for (int i = 0, state = AGAIN; state == AGAIN; ++i) {
      if (!begin_push(p, w, a, &s, &b, tape->row + row * tape->size)) return tape->rows - row;
      if (i == 0) begin_changes(p, w, d, &c, &b, tape->apart, k == 0);
      for (int j = 0; i == 0 && row == 0 && j < d->count; ++j) store_change(p, d, k, j);
      state = push_step(p, w, a, &s, &c, d, &b, k, tape->all, i < MOST_TRIALS);
      if (!state) return tape->rows - row;
    }
    for (int j = 0; j < d->count; ++j) store_change(p, d, k + 1, j);
  }
  p->kept.present = 0;
  return 0;
}
