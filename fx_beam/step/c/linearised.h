/* The laws of a sub-step, linearised: couplings, forces at points and loads as blocks, and the forces of elements and of
   inertia, which have stores of their own; linear systems and rows of results in several directions. */

#pragma once

#include "blocks.h"
#include "member_derivatives.h"
#include "recorder.h"
#include "slide_derivatives.h"
#include "tape.h"

/* Blocks in the order in which they are evaluated, the forces of elements before TOUCHED. Changes of offsets, axes and
   rests of joints move ARMS and LEVERS; WEIGHED are the weights of the nodes of beams on which others slide. After
   MAPPED the linear system is solved; CLOSED and JOINED are forces of loops and joints. BEGUN are the places at the
   start, those of a run. EQUAL, SPREAD, COLLECTED, ROWS and ROWS_BY_MAP are tables. */
enum {
  STRAINED, DRIVEN, ARMS, WEIGHED, TIED, EQUAL, SPREAD, PLACED, TOUCHED, FORCED, SLID, LEVERS, CARRIED, COLLECTED, ROWS,
  ROWS_BY_MAP, MAPPED, CLOSED, JOINED, BEGUN, BLOCKS };

/* A sub-step that is linearised, and room for what follows it. */
typedef struct {
  Layout at; Block of[BLOCKS];
  double *slopes[2];                        /* of the forces of elements, and of drag */
  int stores;                               /* whether they are there */
  double share;                             /* with which forces are added to a sum; 0 for none */
  int adds;                                 /* whether this has begun */
  double *trial;                            /* backwards, derivatives without those by the equations */
  Changes *block, *bordering_solutions;       /* forwards, right sides and solutions (room.h), and those of bordering rows */
  /* Whether offsets, axes and rests of joints, or places and paths of nodes that slide, change in any direction. */
  int moves_joints;
  double *followed, *next; /* forces that friction follows */
  FixedPoint following;
  long step; /* its number among all of the run, or -1 */
} Linear;

static const Vjp *work_of_elements(const Derivatives *a, int i) { return i ? &a->drag : &a->internal_forces; }

static long lay_out_linear(const Tables *p, const PointForces *points, Work *w, const Derivatives *a, Linear *l, double *at) {
  double *begin = at;
  long followed = (long)GROUP_SIZE * points->followed.size;
  w->loads = allocate(&at, 2 * p->loads.count), w->follower_force = allocate(&at, 2 * p->loads.follower_forces);
  w->naturals = allocate(&at, p->natural.count), l->trial = allocate(&at, layout_of(p, points, w, a).size);
  l->bordering_solutions = (Changes *)allocate(&at, (long)p->border.rows * GROUP_SIZE);
  l->block = (Changes *)allocate(&at, (long)p->system.positions * GROUP_SIZE);
  l->followed = allocate(&at, followed), l->next = allocate(&at, followed);
  l->following.memory = allocate(&at, FIXED_POINT_ROWS * followed);
  for (int i = 0; i < 2; ++i) {
    const Vjp *of = work_of_elements(a, i);
    l->slopes[i] = allocate(&at, (long)of->blocks * of->slope_numbers * LANES);
  }
  return at - begin;
}

KEPT long fx_linear_scratch(const Problem *problem, const Derivatives *a) {
  Work work = problem->work;
  Linear l;
  return lay_out_linear(problem->tables, problem->numbers.points, &work, a, &l, 0);
}

/* Begins to follow a tape. */
static void begin_linear(const Tables *p, const PointForces *points, Work *w, const Derivatives *a, Linear *l) {
  int equal = p->map.equal, left = p->map.count - equal;
  const int *row = p->map.row, *column = p->map.column, *value = p->map.value + equal;
  const double *sign = p->map.sign + equal;
  lay_out_linear(p, points, w, a, l, a->scratch);
  l->share = 0, l->adds = 0, l->step = -1;
  Layout at = l->at = layout_of(p, points, w, a);
  memset(l->of, 0, sizeof l->of);
  l->of[EQUAL] = (Block){0, equal, 0, column, row, 0, 0, 0, at.Y1, at.q1};
  l->of[COLLECTED] = (Block){0, equal, 0, row, column, 0, 0, 0, at.r, at.R};
  row += equal, column += equal;
  l->of[SPREAD] = (Block){0, left, 0, column, row, value, sign, w->values, at.Y1, at.q1};
  l->of[ROWS] = (Block){0, left, 0, row, column, value, sign, w->virtual_map, at.r, at.R};
  l->of[ROWS_BY_MAP] = (Block){0, left, 0, value, column, row, sign, p->sliders.count ? w->loaded : w->r, at.map, at.R};
}

/* Ends it, and forgets its factors; returns the number of sub-steps that are left, or -1 if there was no memory. */
static long end_linear(Factors *factors, Linear *l, long left) {
  factors->reused.present = 0;
  for (int i = 0; i < BLOCKS; ++i) {
    if (l->of[i].lacks_memory) left = -1;
    free(l->of[i].entry);
  }
  return left;
}

/* Rates at the end for an increment of the path; none in statics. */
static double rates_per_path(const Scheme *scheme, double dt) { return scheme->at_rest ? 0 : 2 / dt; }

/* Adds a share of the given derivatives by a state or by forces themselves. */
static void add_given(const RowsOfRun *run, long k, double share, double *x) {
  if (run->at[k] < 0) return;
  const double *row = run->rows + (long)run->at[k] * run->size;
  for (int i = 0; i < run->size; ++i) x[run->place[i]] += share * row[i];
}

/* Share of a sub-step in the row of its step. */
static double share_of(const Derivatives *a, long k) { return a->unknown_slopes ? a->share[k] : 1; }

/* Natural strains at the end. */
static void put_strains(const Natural *natural, const Numbers *s, const Work *w, Linear *l) {
  for (int k = 0; k < natural->count; ++k)
    for (int i = natural->start[k]; i < natural->start[k + 1]; ++i) {
      int to = l->at.natural1 + natural->at[i];
      put(l->of + STRAINED, l->at.natural_columns + i, to, w->naturals[k]);
      put(l->of + STRAINED, l->at.naturals + k, to, s->natural[i]);
    }
}

/* Arms R(psi) (offset + d axis) of joints at both ends less those at rest, by their numbers (their other derivatives are
   entries of T), and the values of Tv, by all that they depend on. */
static void put_joint(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, Linear *l, int first, int j) {
  const Layout *at_ = &l->at;
  int column = p->joints.slide_column[j], slides = column >= 0, map = at_->map + 1 + 4 * j;
  const double *e = s->axis + 2 * j, rest = a->slide_at_rest[j];
  double d0 = at(w->state.slides, p->joints.number[j]), d1 = d0 + at(w->z, column);
  Track at_rest = track_of(p->joints.track[j], e, rest, rest);
  for (int end = 0; end < 2; ++end) {
    double share = end ? p->scheme.level : 1 - p->scheme.level, slopes[2][4] = {{0}};
    const double *frame = w->frame + 4 * j + 2 * end, R[2][2] = {{frame[0], -frame[1]}, {frame[1], frame[0]}};
    Track track = track_at(p, s, j, end ? d0 : d1, end ? d1 : d0);
    int turn = in(end ? at_->q1 : at_->q, p->joints.carrier[j]), slide = in(end ? at_->Y1 : at_->Y, column);
    Block *arms = end ? l->of + ARMS : first ? l->of + BEGUN : 0, *levers = l->of + LEVERS;
    slopes_of_joint(p, s, w, j, end, slopes);
    for (int i = 0; i < (slides ? 4 : 2); ++i)
      put(l->of + CARRIED, turn, map + i, slopes[0][i]), put(l->of + CARRIED, slide, map + i, slopes[1][i]);
    for (int i = 0; i < 2; ++i) {
      int arm = at_->arms + 2 * j + i, lever = map + 1 - i;
      double lever_share = i ? -share : share;
      for (int k = 0; k < 2; ++k) {
        int offset = at_->offset + 2 * j + k, axis = at_->axis + 2 * j + k;
        double place_by = R[i][0] * track.place_by[0][k] + R[i][1] * track.place_by[1][k];
        double chord_by = R[i][0] * track.chord_by[0][k] + R[i][1] * track.chord_by[1][k];
        if (arms) put(arms, offset, arm, R[i][k] - (i == k)), put(arms, axis, arm, place_by - at_rest.place_by[i][k]);
        put(levers, offset, lever, lever_share * R[i][k]), put(levers, axis, lever, lever_share * place_by);
        if (slides) put(levers, axis, map + 2 + i, slope_of_turn(w, j) * share * chord_by);
      }
      if (arms) put(arms, at_->rest + j, arm, -at_rest.chord[i]);
    }
  }
}

/* Values of Tv of gears, by all that they depend on. */
static void put_gears(const Tables *p, const Work *w, Linear *l) {
  for (int t = 0; t < p->gears.count; ++t) {
    int value = value_of_term(&p->joints, t), weight = l->at.gears + t / 2 * 3 + t % 2;
    put(l->of + LEVERS, weight, l->at.map + value, w->virtual_map[value] / w->values[value]);
    for (int is_a = 0; is_a < 2; ++is_a) {
      int turn = is_a ? p->gears.a[t] : p->gears.b[t];
      double slope = slope_of_term(p, w, t, is_a);
      put(l->of + CARRIED, in(l->at.q1, turn), l->at.map + value, slope), put(l->of + CARRIED, in(l->at.q, turn), l->at.map + value, -slope);
    }
  }
}

/* Columns of auxiliary unknowns, from arms and other columns. */
static void put_auxiliaries(const Tables *p, const Linear *l, const double *values, int Y, Block *to) {
  for (int k = 0; k < p->auxiliary.arms; ++k)
    put(to, l->at.arms + p->auxiliary.arm[k], Y + p->columns + p->auxiliary.arm_of[k], p->joints.sign[p->auxiliary.arm[k]]);
  for (int k = 0; k < p->auxiliary.entries; ++k)
    put(to, Y + p->auxiliary.column[k], Y + p->columns + p->auxiliary.of[k], p->auxiliary.sign[k] * values[p->auxiliary.value[k]]);
}

/* Places q at the start (0) or at the end (1), there besides EQUAL and SPREAD, from columns Y, arms, and the beams on which
   nodes slide. */
static void put_places(const Tables *p, const Work *w, const Linear *l, const double *values, int end, Block *to) {
  int Y = end ? l->at.Y1 : l->at.Y, q = end ? l->at.q1 : l->at.q;
  for (int k = end ? p->map.count : 0; k < p->map.count; ++k)
    put(to, Y + p->map.column[k], q + p->map.row[k], p->map.sign[k] * values[p->map.value[k]]);
  for (int k = 0; k < p->joints.followers; ++k)
    put(to, l->at.arms + p->joints.through[k], q + p->joints.follower[k], p->joints.sign[p->joints.through[k]]);
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i) { /* a beam may hang on a node that slides on another one */
    const Slider *a = w->slider + i;
    put_place(to, w->slider, &l->at, i, end);
    for (int c = 0; c < a->components; ++c)
      for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
        put(to, Y + a->carried[c], q + a->entry_row[k], a->entry_sign[k] * values[a->entry_value[k]]);
  }
}

static void put_loads(const Tables *p, const Numbers *s, const Work *w, Linear *l) {
  for (int k = 0; k < p->loads.count; ++k) {
    double now = (1 - p->scheme.level) * w->loads[k] + p->scheme.level * w->loads[p->loads.count + k];
    for (int i = p->loads.start[k]; i < p->loads.start[k + 1]; ++i) {
      int to = l->at.r + p->loads.dof[i];
      put(l->of + FORCED, l->at.loads + k, to, (p->scheme.level - 1) * s->load_force[i]);
      put(l->of + FORCED, l->at.loads + p->loads.count + k, to, -p->scheme.level * s->load_force[i]);
      put(l->of + FORCED, l->at.columns + i, to, -now);
    }
  }
  for (int i = 0; i < w->statics.holds; ++i) put(l->of + FORCED, l->at.hold + i, l->at.R + i, -1);
}

/* A force or an internal variable of a law of forces at points by all that it is given; returns the slopes of the next. */
static const double *put_point(const Linear *l, const PointForce *e, int numbers, int first, int follower_force,
                               const double *slopes, int to, Block *block) {
  int n = e->size, slides = e->slide >= 0;
  const double *inside = slopes + 2 * n, *number_slopes = inside + e->internal, *parameter_slopes = number_slopes + numbers;
  for (int i = 0; i < n; ++i) {
    int at = slides ? e->column : e->dof[i];
    put(block, in(slides ? l->at.Y : l->at.q, at), to, slopes[i] - slopes[n + i]);
    put(block, in(slides ? l->at.Y1 : l->at.q1, at), to, slopes[n + i]);
  }
  for (int i = 0; i < e->internal; ++i) put(block, l->at.spring_internal + e->first_internal + i, to, inside[i]);
  for (int i = 0; i < numbers; ++i) put(block, follower_force >= 0 && i < 2 ? follower_force + i : first + i, to, number_slopes[i]);
  for (int i = 0; i < e->parameters; ++i) put(block, l->at.parameters + e->parameter[i], to, parameter_slopes[i]);
  return parameter_slopes + e->parameters;
}

static void put_points(const Loads *loads, const PointForces *points, const Derivatives *a, Linear *l) {
  int first = l->at.points, follower_force = l->at.follower_force;
  Block *to = l->of + FORCED;
  for (int k = 0; k < points->all; first += a->numbers[k++]) {
    const PointForce *e = points->of + k;
    int n = e->size, all = n + e->internal, numbers = a->numbers[k];
    int pushed = k >= points->external && k < points->external + loads->follower_forces ? follower_force : -1;
    const double *slopes = a->point_slopes;
    int wide = 2 * n + e->internal + numbers + e->parameters;
    const Reversal *reversal = e->internal ? reversal_at(a, l->step, e->first_internal) : 0;
    call_slopes(e, a->slopes[k], a->point_slopes, wide);
    if (reversal) reverse(reversal, n, wide, 2 * n + e->internal + numbers - 2, e->load >= 0, a->point_slopes);
    for (int i = 0; i < all; ++i) {
      int row = i >= n ? l->at.springs1 + e->first_internal + i - n : e->slide >= 0 ? l->at.R + e->column : in(l->at.r, e->dof[i]);
      if (i == 1 && e->joint >= 0) put_point(l, e, numbers, first, -1, slopes, l->at.moments + e->joint, to);
      slopes = put_point(l, e, numbers, first, pushed, slopes, row, to);
    }
    if (pushed >= 0) follower_force += 2;
  }
}

/* The force of a node that slides, in three places `held`, from forces on its rows, and what it exerts on its beam. */
static void put_carry(Block *to, const Work *w, const Slider *a, const int *held, int r) {
  for (int c = 0; c < a->components; ++c)
    for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
      put(to, r + a->entry_row[k], held[c], a->entry_sign[k] * w->virtual_map[a->entry_value[k]]);
  for (int c = 0; c < a->components; ++c)
    for (int k = 0; k < a->components * a->width; ++k) put(to, held[c], r + local_dof(a, k), a->virtual_map[c][k]);
}

/* Tv^T r, from the forces r and the values of Tv, with those of nodes that slide and of loops. */
static void put_rows(const Tables *p, const Work *w, Linear *l) {
  const double *r = with_carried(&p->sliders, w);
  int R = l->at.R, map = l->at.map;
  Block *to = l->of + CARRIED;
  for (int i = 0; i < p->loops.closures; ++i)
    for (int k = p->loops.entry_start[i]; k < p->loops.entry_start[i + 1]; ++k)
      put(to, map + p->loops.entry_value[k], R + p->loops.entry_column[k], -p->loops.entry_sign[k] * w->closing[i]);
  for (int i = p->sliders.count - 1; i >= 0; --i) {
    const Slider *a = w->slider + i;
    int first = l->at.held + 3 * i, held[] = {first, first + 1, first + 2};
    for (int c = 0; c < a->components; ++c) {
      put(to, R + a->carried[c], held[c], 1);
      for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
        put(to, map + a->entry_value[k], held[c], a->entry_sign[k] * r[a->entry_row[k]]);
    }
    put_carry(to, w, a, held, l->at.r);
    for (int c = 0; c < a->components; ++c) put(to, held[c], R + a->column, a->virtual_map[c][ARC]);
  }
}

/* Forces on auxiliary unknowns, which pass them on. */
static void put_forces_on_auxiliaries(const Tables *p, const Work *w, Linear *l) {
  double *auxiliary_forces = w->columns;
  if (!p->auxiliary.count) return;
  memset(auxiliary_forces, 0, (p->columns + p->auxiliary.count) * sizeof(double));
  add_rows(&p->map, w, with_carried(&p->sliders, w), auxiliary_forces), add_closing(&p->loops, w, auxiliary_forces);
  collect_auxiliaries(p, w->virtual_map, auxiliary_forces);
  for (int k = p->auxiliary.entries - 1; k >= 0; --k) {
    int auxiliary = p->columns + p->auxiliary.of[k], value = p->auxiliary.value[k], to = l->at.R + p->auxiliary.column[k];
    put(l->of + MAPPED, l->at.R + auxiliary, to, p->auxiliary.sign[k] * w->virtual_map[value]);
    if (value) put(l->of + MAPPED, l->at.map + value, to, p->auxiliary.sign[k] * auxiliary_forces[auxiliary]);
  }
}

/* Closures of loops at the start (0) or at the end (1), less the arms of the joints; with `numbers` also by those of gears. */
static void put_closures(const Tables *p, const Numbers *s, const Work *w, const Linear *l, int end, int numbers, Block *to) {
  int Y = end ? l->at.Y1 : l->at.Y, q = end ? l->at.q1 : l->at.q;
  const double *values = end ? w->values : w->values0;
  for (int k = 0; k < p->loops.closures; ++k) {
    int i = p->loops.arm[k], j = i / 2, closure = l->at.closures + k;
    put(to, in(q, p->loops.b[k]), closure, 1), put(to, in(q, p->loops.a[k]), closure, -1);
    if (i < 0) continue;
    put(to, l->at.arms + i, closure, -1);
    put(to, in(q, p->joints.carrier[j]), closure, -values[1 + 4 * j + i % 2]);
    put(to, in(Y, p->joints.slide_column[j]), closure, -values[3 + 4 * j + i % 2]);
  }
  for (int t = 0; t < p->gears.count; ++t) {
    int j = p->gears.joint[t], closure = l->at.closures + p->gears.closure[t], gear = l->at.gears + t / 2 * 3;
    double weight = weight_of_term(s, t);
    put(to, in(q, p->gears.b[t]), closure, weight), put(to, in(q, p->gears.a[t]), closure, -weight);
    if (j >= 0) put(to, in(Y, p->joints.slide_column[j]), closure, weight);
    if (!numbers) continue;
    double motion = term_motion(&p->gears, t, w->state.q, j < 0 ? 0 : w->state.slides[p->joints.number[j]]);
    if (end) motion += term_motion(&p->gears, t, w->D, j < 0 ? 0 : at(w->z, p->joints.slide_column[j]));
    put(to, gear + t % 2, closure, motion), put(to, gear + 2, closure, t % 2 - 1);
  }
}

/* The forces that close loops on columns and nodes, and on the beams of nodes that slide there. */
static void put_closing(const Tables *p, const Work *w, Linear *l) {
  Block *to = l->of + CLOSED;
  for (int i = 0; i < p->loops.closures; ++i) {
    int closing = l->at.closing + i;
    for (int k = p->loops.start[i]; k < p->loops.start[i + 1]; ++k)
      put(to, closing, l->at.R + p->loops.column[p->loops.near[k]], -w->G_virtual[k]);
    put(to, closing, in(l->at.r, p->loops.b[i]), -1), put(to, closing, in(l->at.r, p->loops.a[i]), 1);
    for (int k = p->loops.entry_start[i]; p->loops.carried && k < p->loops.entry_start[i + 1]; ++k)
      put(to, closing, l->at.pushed + p->loops.entry_column[k], -p->loops.entry_sign[k] * w->virtual_map[p->loops.entry_value[k]]);
  }
  for (int t = 0; t < p->gears.count; ++t) {
    int value = value_of_term(&p->joints, t), i = p->gears.closure[t];
    for (int is_a = 0; is_a < 2; ++is_a) {
      int moment = in(l->at.r, is_a ? p->gears.a[t] : p->gears.b[t]), sign = is_a ? 1 : -1;
      put(to, l->at.closing + i, moment, sign * w->virtual_map[value]), put(to, l->at.map + value, moment, sign * w->closing[i]);
    }
  }
  for (const Slider *a = w->slider + p->sliders.count - 1; p->loops.carried && a >= w->slider; --a) {
    int held[3];
    for (int c = 0; c < a->components; ++c) held[c] = l->at.pushed + a->carried[c];
    put_carry(to, w, a, held, l->at.carried);
  }
  for (int i = 0; p->loops.carried && i < p->dofs; ++i) put(to, l->at.carried + i, l->at.r + i, 1);
}

static void put_passes(const Passes *passes, Linear *l, int first, int end) {
  for (int k = first; k < end; ++k) {
    put(l->of + JOINED, l->at.r + passes->dof[k], l->at.forces + passes->of[k], passes->sign[k]);
    put(l->of + JOINED, l->at.r + passes->dof[k], in(l->at.r, passes->to[k]), 1);
  }
}

/* Forces of joints (find_joint_forces), and their sizes that friction follows. */
static void put_joint_forces(const Tables *p, const Numbers *s, const Work *w, Linear *l) {
  Block *to = l->of + JOINED;
  int forces = l->at.forces, followed = l->at.followed;
  put_passes(&p->passes, l, 0, p->passes.force_count);
  for (int k = 0; k < p->loops.closures; ++k) put(to, l->at.closing + k, forces + p->loops.force[k], 1);
  for (int j = 0; j < p->joints.count; ++j)
    for (int i = 0; i < 2; ++i) {
      int lever = 1 + 4 * j + i, force = 3 * p->joints.number[j] + i, turn = in(l->at.r, p->joints.carrier[j]);
      put(to, forces + force, turn, w->virtual_map[lever]), put(to, l->at.map + lever, turn, w->joint_forces[force]);
    }
  for (int i = 0; i < p->passes.joints; ++i) put(to, l->at.moments + i, forces + 3 * i + 2, -1);
  put_passes(&p->passes, l, p->passes.force_count, p->passes.count);
  for (const PointForce *e = s->points->of; e < s->points->of + s->points->all; ++e) {
    double slope[5];
    if (e->load < 0) continue;
    double across = followed_size(e, w->joint_forces, w->state.q, w->D, p->scheme.level, slope);
    for (int i = 0; i < 2; ++i) put(to, forces + 3 * e->load + i, followed, slope[i]);
    put(to, in(l->at.q, e->load_turn), followed, (1 - p->scheme.level) * slope[2]);
    put(to, in(l->at.q1, e->load_turn), followed, p->scheme.level * slope[2]);
    for (int j = 0; j < p->joints.count; ++j) {
      if (p->joints.number[j] != e->load) continue;
      double d = slide_at_level(p, w, j);
      Track track = track_of(p->joints.track[j], s->axis + 2 * j, d, d);
      for (int i = 0; i < 2; ++i) {
        double turned = 2 * track.bend[i] * slope[3 + i];
        for (int k = 0; k < 2; ++k) put(to, l->at.axis + 2 * j + k, followed, slope[3 + i] * track.chord_by[i][k]);
        put(to, in(l->at.Y, p->joints.slide_column[j]), followed, (1 - p->scheme.level) * turned);
        put(to, in(l->at.Y1, p->joints.slide_column[j]), followed, p->scheme.level * turned);
      }
    }
    for (int j = 0; j < p->sliders.count; ++j) {
      const Slider *a = w->slider + j;
      double length = hypot(a->virtual_map[0][ARC], a->virtual_map[1][ARC]);
      for (int i = 0; a->joint == e->load && i < 2; ++i)
        put(to, l->at.axes + 2 * j + i, followed, (slope[3 + i] - across * e->load_axis[i]) / length);
    }
    ++followed;
  }
}

/* All laws of a sub-step that has begun, with `forces` those of joints, and for the first one of a run its start. */
static void linearise(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, Linear *l, int forces, int first) {
  for (int i = 0; i < BLOCKS; ++i)
    if (i != TOUCHED && !(i == FORCED && l->adds) && !l->of[i].from) l->of[i].count = 0;
  for (int i = 0; i < p->driven; ++i) put(l->of + DRIVEN, l->at.driven + i, l->at.Y1 + p->free + i, 1);
  put_strains(&p->natural, s, w, l);
  for (int j = 0; j < p->joints.count; ++j) put_joint(p, s, w, a, l, first, j);
  put_gears(p, w, l);
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i) {
    for (int end = 0; end < 2; ++end) put_weights_at(l->of + WEIGHED, w->slider, &l->at, i, end);
    if (first) put_weights_at(l->of + BEGUN, w->slider, &l->at, i, 0);
    put_slide(l->of + SLID, w->slider, &l->at, i);
  }
  put_auxiliaries(p, l, w->values, l->at.Y1, l->of + TIED), put_places(p, w, l, w->values, 1, l->of + PLACED);
  put_loads(p, s, w, l), put_points(&p->loads, s->points, a, l), put_rows(p, w, l), put_forces_on_auxiliaries(p, w, l);
  put_closures(p, s, w, l, 1, 1, l->of + MAPPED);
  if (first) {
    put_auxiliaries(p, l, w->values0, l->at.Y, l->of + BEGUN), put_places(p, w, l, w->values0, 0, l->of + BEGUN);
    put_closures(p, s, w, l, 0, 1, l->of + BEGUN);
  }
  forces |= p->at_points.friction_follows;
  if (forces || a->unknown_slopes) put_closing(p, w, l);
  if (forces && p->passes.joints) find_joint_forces(p, s->points, w), put_joint_forces(p, s, w, l);
}

/* Factors for right sides in several directions; returns 0 if the tangent is singular. */
static int factorise_for_directions(const Tables *p, const PointForces *points, Work *w) {
  memset(w->y, 0, p->system.positions * sizeof(double));
  for (int i = 0; i < p->system.positions; ++i) reach(&p->border, w, i);
  w->newton.raised = !factorise_tangent(p, points, w, 1);
  return !w->newton.raised || solve_raised(p, points, w, 0, 0);
}

/* Solves for the right sides of the block, by the tangent's factors. */
static void solve_right_sides(const Tables *p, const PointForces *points, const Work *w, const Linear *l) {
  Work block_work = *w;
  double *x = block_work.block = (double *)l->block, *g = (double *)l->bordering_solutions;
  int inside = HAS(SLIDERS) && p->border.inside;
  if (inside) pass_on(p, &w->factors, GROUP_SIZE, 0, x, g);
  if (w->newton.raised) solve_raised(p, points, w, GROUP_SIZE, x); else solve_columns(p, &block_work, 1);
  if (!HAS(SLIDERS) || !p->border.rows) return;
  if (!inside) {
    memset(g, 0, p->border.rows * sizeof(Changes));
    pass_on(p, &w->factors, GROUP_SIZE, 0, x, g);
    solve_bordering_rows(p, w, GROUP_SIZE, g, x);
  }
  pass_on(p, &w->factors, GROUP_SIZE, 1, x, g);
}

/* Adds a share of the changes of a state or of forces, of `count` directions from the `first` on, to a row. */
static void add_changes(const Derivatives *a, const RowsOfRun *run, long k, double share, const Changes *x, long first, int count) {
  if (run->at[k] < 0) return;
  double *row = run->rows + (run->at[k] * (long)a->directions + first) * run->size;
  for (int i = 0; i < run->size; ++i)
    for (int j = 0; j < count; ++j) row[(long)j * run->size + i] += share * x[run->place[i]][j];
}

/* The right sides of the block, from rows, or from forces where nothing is COUPLED. */
static void set_right_sides(const Tables *p, const Factors *factors, const Layout *at, const Changes *x, Changes *block) {
  const int *order = factors->order, *column = p->map.column;
  memset(block, 0, p->system.positions * sizeof(Changes));
  for (int i = 0; HAS(COUPLED) && i < p->free; ++i) block[order[i]] = x[at->R + i];
  for (int i = 0; !HAS(COUPLED) && i < p->dofs; ++i)
    if (column[i] < p->free) block[order[column[i]]] += x[at->r + i];
  for (int i = 0; !HAS(COUPLED) && i < at->Y1 - at->hold; ++i) block[order[i]] -= x[at->hold + i];
  for (int i = 0; i < p->loops.closures; ++i) block[order[p->system.unknowns - p->loops.closures + i]] = x[at->closures + i];
}
