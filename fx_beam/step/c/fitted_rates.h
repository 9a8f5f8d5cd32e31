/* Rates that fit joints and supports (step/fitted_rates.py): a sub-step that is linear. Of the rates w of the columns those are
   sought of which the nodal rates u = T w are nearest to given ones v, in the norm of the masses,

       T^T M (u - v) = 0,

   at one configuration. In the vector of a linearised sub-step (blocks.h) w and u are at Y1 and q1, and impulses M (u - v) are
   forces; T depends on the configuration at q and Y, and on numbers. */

#pragma once

#include "linearised.h"

/* How much forces that close loops yield, relative to a stiffness that the masses are: they are not known where bars are in
   line. A second solution removes its effect, and round-off of small masses. */
static const double YIELDING = 1e-13;

/* Blocks in the place of those that sub-steps have: changes of T for auxiliary unknowns and closures, for nodes, and for
   those that slide; impulses by rates, those of small masses, and by masses. */
enum { TIED_BY_MAP = BEGUN, SPREAD_BY_MAP = FORCED, SLID_BY_MAP = TOUCHED, INERT = SLID, LIGHT = STRAINED, INERT_BY_MASS = LEVERS };
enum { FIT_BLOCKS = 21 };

/* Laws that are linear in the rates, and T by the configuration, in the order in which they are evaluated. */
typedef struct { Linear of, shape; Block *block[FIT_BLOCKS]; long size; int solutions; } Fit;

static void begin_fits(const Tables *p, const Numbers *s, Work *w, const Derivatives *a, Fit *f) {
  Linear *l = &f->of, *shape = &f->shape;
  Block *fit = l->of, *shapes = shape->of;
  int equal = p->map.equal, left = p->map.count - equal;
  begin_linear(p, s->points, w, a, l);
  fit[SPREAD_BY_MAP] = (Block){0, left, 0, p->map.value + equal, p->map.row + equal, p->map.column + equal,
                              p->map.sign + equal, w->z, l->at.map, l->at.q1};
  *shape = *l, memset(shapes, 0, sizeof shape->of);
  Layout *at = &shape->at;
  at->q1 = at->q, at->Y1 = at->Y, at->slides = at->size;
  /* Numbers of beams change T alone, not what is linear in the rates: what it would read of them is zero. */
  l->at.places = at->size + SLIDE_NUMBERS * p->sliders.count, l->at.paths = l->at.places + 3 * p->sliders.count;
  f->size = l->at.paths + p->sliders.path_numbers;
  Block *block[] = {fit + DRIVEN, shapes + WEIGHED, shapes + SLID, shapes + LEVERS, shapes + CARRIED, fit + TIED_BY_MAP, fit + SPREAD_BY_MAP,
                    fit + WEIGHED, fit + TIED, fit + EQUAL, fit + SPREAD, fit + SLID_BY_MAP, fit + PLACED, fit + INERT, fit + LIGHT,
                    fit + INERT_BY_MASS, fit + CARRIED, fit + COLLECTED, fit + ROWS, fit + ROWS_BY_MAP, fit + MAPPED};
  memcpy(f->block, block, sizeof block);
  for (int i = 0; i < p->driven; ++i) put(fit + DRIVEN, l->at.driven + i, l->at.Y1 + p->free + i, 1);
  for (int i = 0; i < p->dofs; ++i)
    for (int end = 0; end < 2; ++end) {
      int from = end ? l->at.q1 : l->at.v, sign = end ? 1 : -1;
      for (int k = p->mass.start[i / 3]; k < p->mass.start[i / 3 + 1]; ++k)
        put(fit + INERT, from + p->mass.dof[k] + i % 3, l->at.r + i, sign * s->mass[3 * k + i % 3]);
      put(fit + LIGHT, from + i, l->at.r + i, sign * s->viscous_weight[i]);
    }
  f->solutions = fit[LIGHT].count || p->loops.closures ? 2 : 1;
}

/* Takes the changes of a state, of `count` directions from the `first` on. */
static void load_row(const Derivatives *a, const RowsOfRun *states, long row, long first, int count, Changes *x) {
  for (int j = 0; j < count; ++j)
    for (int i = 0; i < states->size; ++i) x[states->place[i]][j] = states->rows[(row * a->directions + first + j) * states->size + i];
}

/* Rates u of the nodes for w of the columns, in `z`; their impulses, also those of small masses, and in `columns` those on
   columns, with those that close loops. */
static void find_impulses(const Tables *p, const Numbers *s, const Work *w, const double *v, double *u) {
  spread_open(p, w, w->z, u);
  for (int i = 0; i < p->dofs; ++i) w->acc[i] = u[i] - v[i];
  times_mass(p, s, w->acc, w->r);
  for (int i = 0; i < p->dofs; ++i) w->r[i] += s->viscous_weight[i] * w->acc[i];
  memset(w->columns, 0, (p->columns + p->auxiliary.count) * sizeof(double));
  add_closing(&p->loops, w, w->columns), collect(p, w, w->r, w->columns);
}

/* The equations at a configuration; returns whether they are those of the row before, as no arm has turned. */
static int begin_fit(const Tables *p, const Numbers *s, Work *w, const Fits *fits, long row) {
  double *K = w->tangent;
  memcpy(w->state.q, fits->q + row * p->dofs, p->dofs * sizeof(double));
  memcpy(w->state.slides, fits->slides + row * p->passes.joints, p->passes.joints * sizeof(double));
  memset(w->z, 0, (p->columns + p->auxiliary.count) * sizeof(double));
  begin_couplings(p, s, w);
  int same = row > 0 && w->newton.raised == 0 && !(HAS(CHAIN | BAND) || p->sliders.count || p->loops.closures);
  for (int i = 0; i < 4 * p->joints.count; ++i) same &= w->values0[1 + i] == w->values[1 + i];
  expand_trees(p, s, w);
  derive_closures(p, w, w->virtual_map, w->G_virtual);
  for (int i = 0; i < p->dofs; ++i) w->r[i] = 0, w->slope[i] = 1;
  memset(w->closing, 0, p->loops.closures * sizeof(double));
  if (p->sliders.count) memset(w->loaded, 0, p->dofs * sizeof(double));
  for (int i = 0; i < p->sliders.count; ++i) memset(w->slider[i].force, 0, sizeof w->slider->force);
  if (same) return 1;
  begin_tangent(p, K);
  multiply_mass(p, s, w->D, w->scratch, K, 1, w->slope, 0);
  for (int i = 0; i < p->dofs; ++i)
    if (s->viscous_weight[i] > 0) K[w->statics.diagonal_at[i]] += s->viscous_weight[i];
  reduce_tangent(p, s, w);
  double stiff = stiffness_of_closures(&p->loops, K);
  w->statics.yielding = stiff > 0 ? YIELDING / stiff : 0;
  return 0;
}

/* Rates w of the columns, and u of the nodes, with their impulses, and factors if these are `needed` later; returns 0 if the
   equations are singular. With the `same` ones the factors serve again. */
static int find_fit(const Tables *p, const Numbers *s, Work *w, const Linear *l, int solutions, int needed, int same,
                    const double *v, const double *driven, double *u) {
  const int *closing_order = w->factors.order + p->system.unknowns - p->loops.closures;
  double *z = w->z, *right = (double *)l->block, rest[2];
  memcpy(z + p->free, driven, p->driven * sizeof(double));
  int once = solutions == 1 && !needed; /* by the solver of steps, which has one right side */
  if (once) {
    find_impulses(p, s, w, v, u);
    memcpy(w->reduced, w->columns, p->free * sizeof(double));
    if (!(same ? solve_bordered(p, s->points, w, FULL, w->reduced, w->step) : solve_reduced(p, s, w, 0, rest))) return 0;
    add_times(p->free, -1, w->step, z);
  } else if (!factorise_for_directions(p, s->points, w)) return 0;
  for (int k = 0; !once && k < solutions; ++k) {
    find_impulses(p, s, w, v, u);
    memset(right, 0, p->system.positions * sizeof(Changes));
    for (int i = 0; i < p->free; ++i) right[GROUP_SIZE * w->factors.order[i]] = w->columns[i];
    for (int i = 0; i < p->loops.closures; ++i)
      for (int e = p->loops.entry_start[i]; e < p->loops.entry_start[i + 1]; ++e)
        right[GROUP_SIZE * closing_order[i]] += p->loops.entry_sign[e] * w->values[p->loops.entry_value[e]]
            * z[p->loops.entry_column[e]];
    solve_right_sides(p, s->points, w, l);
    for (int i = 0; i < p->free; ++i) z[i] -= right[GROUP_SIZE * w->factors.order[i]];
  }
  for (int i = 0; i < p->loops.closures; ++i) w->closing[i] = right[GROUP_SIZE * closing_order[i]];
  find_impulses(p, s, w, v, u);
  if (p->passes.joints) find_joint_forces(p, s->points, w);
  return 1;
}

/* All other laws, for the impulses that were found. */
static void linearise_fit(const Tables *p, const Numbers *s, const Work *w, Fit *f) {
  Linear *l = &f->of, *shape = &f->shape;
  for (int i = 0; i < BLOCKS; ++i)
    if (!l->of[i].from && i != DRIVEN && i != INERT && i != LIGHT) l->of[i].count = 0;
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i) put_weights_at(l->of + WEIGHED, w->slider, &l->at, i, 1);
  put_auxiliaries(p, l, w->values, l->at.Y1, l->of + TIED), put_places(p, w, l, w->values, 1, l->of + PLACED);
  put_rows(p, w, l), put_forces_on_auxiliaries(p, w, l), put_closures(p, s, w, l, 1, 0, l->of + MAPPED);
  put_closing(p, w, l);
  if (p->passes.joints) put_joint_forces(p, s, w, l);
  for (int i = 0; i < p->dofs; ++i)
    for (int k = p->mass.start[i / 3]; k < p->mass.start[i / 3 + 1]; ++k)
      put(l->of + INERT_BY_MASS, l->at.mass + 3 * k + i % 3, l->at.r + i, w->acc[p->mass.dof[k] + i % 3]);
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i) {
    for (int end = 0; end < 2; ++end) put_weights_at(shape->of + WEIGHED, w->slider, &shape->at, i, end);
    put_slide(shape->of + SLID, w->slider, &shape->at, i);
  }
}

/* The rates u and closures by T, for the rates w and u. */
static void put_moved(const Tables *p, const Work *w, Fit *f, const double *u) {
  Linear *l = &f->of;
  Block *to = l->of + TIED_BY_MAP;
  for (int k = 0; k < p->auxiliary.entries; ++k)
    put(to, l->at.map + p->auxiliary.value[k], l->at.Y1 + p->columns + p->auxiliary.of[k],
        p->auxiliary.value[k] ? p->auxiliary.sign[k] * w->z[p->auxiliary.column[k]] : 0);
  for (int k = 0; k < p->loops.closures; ++k) {
    int i = p->loops.arm[k], map = l->at.map + 1 + 2 * i - i % 2;
    if (i < 0) continue;
    put(to, map, l->at.closures + k, -at(u, p->joints.carrier[i / 2]));
    put(to, map + 2, l->at.closures + k, -at(w->z, p->joints.slide_column[i / 2]));
  }
  for (int t = 0; t < p->gears.count; ++t) {
    int j = p->gears.joint[t];
    double rate = term_motion(&p->gears, t, u, j < 0 ? 0 : at(w->z, p->joints.slide_column[j]));
    put(to, l->at.map + value_of_term(&p->joints, t), l->at.closures + p->gears.closure[t], rate);
  }
  for (int i = 0; i < p->sliders.count; ++i) {
    const Slider *a = w->slider + i;
    int first = f->shape.at.slides + i * SLIDE_NUMBERS;
    for (int c = 0; c < a->components; ++c) {
      for (int k = 0; k < a->width; ++k)
        put(l->of + SLID_BY_MAP, first + AT + k, l->at.Y1 + a->carried[c], u[a->dofs[3 * (a->first + k) + c]]);
      put(l->of + SLID_BY_MAP, first + AXIS + c, l->at.Y1 + a->carried[c], w->z[a->column]);
    }
  }
}

/* The changes of all that depends on the rates w of unknowns. */
static void jvp_fit(const Tables *p, const Fit *f, Changes *x) {
  const Layout *at = &f->of.at;
  memset(x + at->Y1 + p->free, 0, (p->columns + p->auxiliary.count - p->free) * sizeof(Changes));
  memset(x + at->q1, 0, (f->size - at->q1) * sizeof(Changes));
  for (int i = 0; i < FIT_BLOCKS; ++i) jvp(f->block[i], x);
}

/* The changes of rates and impulses in the directions of a group. */
static void fit_group(const Tables *p, const PointForces *points, const Work *w, const Fit *f, Changes *x) {
  const Linear *l = &f->of;
  const Layout *at = &l->at;
  memset(x + at->Y1, 0, p->free * sizeof(Changes));
  for (int k = 0; k < f->solutions; ++k) {
    jvp_fit(p, f, x);
    set_right_sides(p, &w->factors, at, x, l->block);
    solve_right_sides(p, points, w, l);
    for (int i = 0; i < p->free; ++i) x[at->Y1 + i] -= l->block[w->factors.order[i]];
  }
  jvp_fit(p, f, x);
  for (int i = 0; i < p->loops.closures; ++i)
    x[at->closing + i] = l->block[w->factors.order[p->system.unknowns - p->loops.closures + i]];
  jvp(l->of + CLOSED, x), jvp(l->of + JOINED, x);
}

/* From the derivatives by rates and impulses, and by the equations, to those by all else. */
static void vjp_fit(const Fit *f, double *x) {
  vjp(f->of.of + JOINED, x), vjp(f->of.of + CLOSED, x);
  for (int i = FIT_BLOCKS - 1; i >= 0; --i) vjp(f->block[i], x);
}

/* The derivatives by a configuration, from those by its rates and impulses; `trial` is room. */
static void vjp_group(const Tables *p, const PointForces *points, const Work *w, const Fit *f, double *trial, double *x) {
  const Linear *l = &f->of;
  const Layout *at = &l->at;
  const int *closing_order = w->factors.order + p->system.unknowns - p->loops.closures;
  long state = (f->size - at->Y) * sizeof(double);
  for (int k = 0; k < f->solutions; ++k) {
    memcpy(trial + at->Y, x + at->Y, state);
    vjp_fit(f, trial);
    memset(l->block, 0, p->system.positions * sizeof(Changes));
    for (int i = 0; i < p->free; ++i) l->block[w->factors.order[i]][0] = trial[at->Y1 + i];
    for (int i = 0; i < p->loops.closures; ++i) l->block[closing_order[i]][0] = -trial[at->closing + i];
    solve_right_sides(p, points, w, l);
    for (int i = 0; i < p->free; ++i) x[at->R + i] -= l->block[w->factors.order[i]][0];
    for (int i = 0; i < p->loops.closures; ++i) x[at->closures + i] -= l->block[closing_order[i]][0];
  }
  vjp_fit(f, x);
}

/* Rates that fit given ones, and with the `way` BACKWARDS or FORWARDS their derivatives: backwards those of a function of
   rates and impulses, `forces` of Derivatives, by the states `states`; forwards changes. Rows of which the equations are
   singular are left as they are. Returns 0 without memory. */
KEPT int fx_fit(Problem *problem, const Fits *fits, const Derivatives *a, int way) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  Fit f;
  begin_fits(p, s, w, a, &f);
  const Layout *at = &f.of.at;
  long groups = way == FORWARDS ? (a->directions + GROUP_SIZE - 1) / GROUP_SIZE : 0;
  long joints = 3 * p->passes.joints, constrained = p->columns - p->free;
  Changes *x = calloc(f.size, sizeof(Changes));
  double *slopes = calloc(2 * f.size, sizeof(double));
  for (long row = 0; x && slopes && row < fits->rows; ++row) {
    int same = begin_fit(p, s, w, fits, row);
    for (int i = 0; i < BLOCKS; ++i) f.shape.of[i].count = 0;
    for (int j = 0; way && j < p->joints.count; ++j) put_joint(p, s, w, a, &f.shape, 0, j); /* T without the increments to be found */
    if (way) put_gears(p, w, &f.shape);
    const double *v = fits->v + row * p->dofs;
    double *u = fits->rates + row * p->dofs;
    if (!find_fit(p, s, w, &f.of, f.solutions, way, same, v, fits->driven + row * p->driven, u)) continue;
    memcpy(fits->joints + row * joints, w->joint_forces, joints * sizeof(double));
    memcpy(fits->constraints + row * constrained, w->columns + p->free, constrained * sizeof(double));
    if (!way) continue;
    linearise_fit(p, s, w, &f), put_moved(p, w, &f, u);
    for (long i = 0; i < groups; ++i) {
      long first = i * GROUP_SIZE;
      int count = a->directions - first < GROUP_SIZE ? a->directions - first : GROUP_SIZE;
      memcpy(x, (Changes *)a->x + i * at->size, at->size * sizeof(Changes));
      load_row(a, &a->states, row, first, count, x);
      fit_group(p, s->points, w, &f, x);
      add_changes(a, &a->forces, row, 1, x, first, count);
    }
    if (way == FORWARDS) continue;
    memset(slopes + at->Y, 0, (f.size - at->Y) * sizeof(double));
    add_given(&a->forces, row, 1, slopes);
    vjp_group(p, s->points, w, &f, slopes + f.size, slopes);
    for (int i = 0; i < a->states.size; ++i) a->states.rows[row * a->states.size + i] = slopes[a->states.place[i]];
  }
  if (x && slopes && way == BACKWARDS) memcpy(a->x, slopes, at->Y * sizeof(double));
  int lacks = !x || !slopes || end_linear(&w->factors, &f.shape, 0) | end_linear(&w->factors, &f.of, 0);
  free(x), free(slopes);
  return !lacks;
}
