/* The derivatives of a run, backwards (docs/theory/derivatives.md): from the derivatives of a function of
   the states at the ends of sub-steps to those by all numbers of the scene. In the comments J is this function,
   and "by x" its derivative by x. */

#pragma once

#include "kept_factors.h"
#include "member_derivatives.h"
#include "recorder.h"
#include "slide_derivatives.h"
#include "tape.h"

/* Work space of a sub-step. `end` and `start` are by the configurations at both ends, columns with those of
   ties behind them. */
typedef struct {
  double *end, *start, *by_increment, *by_start, *by_before, *omega, *momentum; /* of nodes */
  double *end_columns, *start_columns, *mu, *on_ties;                           /* of columns and ties */
  double *values, *of_map, *at_start, *at_end;                                  /* of joints */
  double *of_internal, *lost_internal, *of_springs, *lost_springs, *loads, *thrust, *of_gaps;
  double *forced, *of_forces, *of_levers, *of_joints, *kept; /* what weights of forces give */
  double *carried; /* [node that slides][3] derivatives by its columns */
  double *of_axes; /* [node that slides][2] by the axis of its beam there */
  double *by_natural, *by_natural_end, *natural; /* the last are those of a sub-step */
  /* Of friction that follows joints: by their forces, and by the rotation of their axes. */
  double *of_followed, *of_turn;
  FixedPoint following;
  SlideEnds *slides;
} Backward;

static long lay_out_backward(const Problem *p, Backward *b, double *at) {
  double *begin = at;
  long n = p->dofs + LANES, c = p->columns + p->ties, internal = (long)p->cells * p->cell_internal;
  b->end = allocate(&at, n), b->start = allocate(&at, n), b->by_increment = allocate(&at, n);
  b->by_start = allocate(&at, n), b->by_before = allocate(&at, n);
  b->omega = allocate(&at, n), b->momentum = allocate(&at, n);
  b->end_columns = allocate(&at, c), b->start_columns = allocate(&at, c), b->mu = allocate(&at, c);
  b->on_ties = allocate(&at, c);
  b->values = allocate(&at, 1 + 4 * p->joints), b->of_map = allocate(&at, 1 + 4 * p->joints);
  b->at_start = allocate(&at, 2 * p->joints), b->at_end = allocate(&at, 2 * p->joints);
  b->of_internal = allocate(&at, internal), b->lost_internal = allocate(&at, internal);
  b->of_springs = allocate(&at, p->spring_width), b->lost_springs = allocate(&at, p->spring_width);
  b->loads = allocate(&at, 2 * p->loads), b->thrust = allocate(&at, 2 * p->thrusts);
  b->of_gaps = allocate(&at, p->closures);
  b->forced = allocate(&at, c), b->of_forces = allocate(&at, n), b->of_levers = allocate(&at, 1 + 4 * p->joints);
  b->of_joints = allocate(&at, 3 * p->scene_joints), b->kept = allocate(&at, n);
  long natural = (long)p->cells * p->cell_natural;
  b->by_natural = allocate(&at, natural), b->by_natural_end = allocate(&at, natural);
  b->natural = allocate(&at, p->naturals);
  b->of_followed = allocate(&at, p->points->all), b->of_turn = allocate(&at, p->points->all);
  b->following.size = p->points->followed.size;
  b->following.memory = allocate(&at, FIXED_POINT_ROWS * (long)b->following.size);
  b->carried = allocate(&at, 3 * p->sliders), b->of_axes = allocate(&at, 2 * p->sliders);
  b->slides = (SlideEnds *)allocate(&at, p->sliders * (sizeof(SlideEnds) / sizeof(double)));
  return at - begin;
}

long fx_backward_scratch(const Problem *p) {
  Backward b;
  return lay_out_backward(p, &b, 0);
}

/* The transpose of the reduced tangent in its place; sparse factors are made of the transpose, and borders are
   transposed already. */
static void swap(double *x, double *y) {
  double kept = *x;
  *x = *y, *y = kept;
}

static void transpose_tangent(const Problem *p, const Work *w) {
  double *K = w->tangent;
  if (p->chain) {
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
  if (p->changing) {
    if (!factorise_changing_transposed(p, w)) return 0;
    by_factors(p, w, w->reduced, w->step);
    return 1;
  }
  turned.factor_at = a->transposed_at, turned.kept.present = 0;
  if (p->band) transpose_tangent(p, w);
  return solve_reduced(&turned, w, 0, rest);
}

/* Adds T^T x at the start (0) or at the end (1) to columns, for its values, and what ties collect; they keep what
   they have. Sliding nodes pass theirs on to x and to slides. */
static void gather(const Problem *p, const Backward *b, int end, const double *values, double *x, double *columns) {
  memset(columns + p->columns, 0, p->ties * sizeof(double));
  for (int i = p->sliders - 1; i >= 0; --i) {
    const Slider *a = p->slider + i;
    find_held_force(a, values, x, columns, b->carried + 3 * i, 1);
    push_beam(a, b->slides[i].T[end], b->carried + 3 * i, x, columns, 1);
  }
  for (int k = 0; k < p->equal; ++k) columns[p->entry_column[k]] += x[p->entry_row[k]];
  for (int k = p->equal; k < p->entries; ++k)
    columns[p->entry_column[k]] += p->entry_sign[k] * values[p->entry_value[k]] * x[p->entry_row[k]];
  if (p->ties) collect_ties(p, values, columns);
  for (int i = 0; i < p->sliders; ++i)
    for (int c = 0; c < p->slider[i].components; ++c) columns[p->slider[i].carried[c]] = 0;
}

/* Derivatives by the places of sliding nodes in the reference configuration, and by the paths, after `gather` at the
   start (0) or at the end (1), with which those by Tv are counted. */
static void pull_places(const Problem *p, const Work *w, const Adjoint *a, const Backward *b, int end) {
  pull_paths(p, w, end, b->carried, end ? b->omega : 0, b->mu, b->of_axes, a->paths);
  for (int i = 0; i < p->sliders; ++i)
    for (int c = 0; c < p->slider[i].components; ++c) a->places[3 * i + c] -= b->carried[3 * i + c];
}

/* omega = Tv mu, with the columns of ties and of sliding nodes in mu. */
static void spread_virtual(const Problem *p, const Work *w, double *mu, double *omega) {
  spread_columns(p, w->virtual_map, mu, omega);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) {
    spread_slider(a, a->virtual_map, omega, mu, 1);
    spread_columns(p, w->virtual_map, mu, omega);
  }
}

/* Adds the derivatives of the work of elements on omega: nodal ones to vectors, with `last` the others to the
   sums of each element. */
static void pull_elements(const Problem *p, const Pulled *of, const double *const *fields, const Backward *b,
                          double t, double dt, double *parameters, int last) {
  const Form *form = &of->form;
  int n = p->cell_dofs, m = of->internal ? p->cell_internal : 0, there[] = {of->increment, of->start, of->before};
  int s = p->cell_natural, strained[] = {of->natural, of->natural_end};
  double A[(1 + 3 * n + m + 2 * s + of->tail) * LANES], *sums = of->sums, *natural[] = {b->by_natural, b->by_natural_end};
  double *nodal[] = {b->by_increment, b->by_start, b->by_before};
  set_time(p, form, t, dt);
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long block = 0; block * LANES < own->cells; ++block, sums += of->tail * LANES) {
      evaluate(p, form, own, block, fields, A);
      const double *rest = A + LANES;
      for (int k = 0; k < 3; rest += there[k++] * n * LANES)
        if (there[k]) add(n, own->to + block * n * LANES, rest, nodal[k]);
      for (int k = 0; k < m; ++k, rest += LANES)
        for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
          b->lost_internal[own->internal[(block * m + k) * LANES + l]] += rest[l];
      for (int end = 0; end < 2; ++end)
        for (int k = 0; strained[end] && k < s; ++k, rest += LANES)
          for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
            natural[end][own->natural[(block * s + k) * LANES + l]] += rest[l];
      for (int k = 0; last && k < of->tail * LANES; ++k) sums[k] += rest[k];
      for (int k = 0; last && of->parameters_at >= 0 && k < form->parameters; ++k)
        for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
          parameters[form->parameter[k]] -= rest[(of->parameters_at + k) * LANES + l];
    }
  }
}

/* The same for forces at points, and for those on slides with mu; the columns of these are by Y1 and by Y0. */
static void pull_points(const Problem *p, const Adjoint *a, const Backward *b, double *thrust, double *parameters,
                        int last) {
  const PointForces *points = p->points;
  double *numbers = a->points;
  int thrusts = 0;
  for (int k = 0; k < points->all; ++k) {
    const PointForce *e = points->of + k;
    int n = e->size, all = a->arguments[k], before = 3 * n + 2 + e->internal + e->remembered;
    double *given = a->given, *found = a->found, *weights = given + all;
    memcpy(given, e->given, all * sizeof(double));
    for (int i = 0; i < n; ++i) weights[i] = coordinate(e, i, b->omega, b->mu, e->column);
    if (e->joint >= 0) weights[1] += b->of_joints[3 * e->joint + 2];
    for (int i = 0; i < e->internal; ++i) weights[n + i] = b->of_springs[e->first_internal + i];
    call(a->pull[k], given, found, all);
    for (int i = 0; i < n; ++i)
      if (e->slide >= 0) {
        b->end_columns[e->column] -= found[n + i];
        b->start_columns[e->column] -= found[i] - found[n + i];
      } else if (e->dof[i] >= 0) {
        b->by_start[e->dof[i]] += found[i], b->by_increment[e->dof[i]] += found[n + i];
      }
    for (int i = 0; i < e->internal; ++i) b->lost_springs[e->first_internal + i] += found[3 * n + 2 + i];
    if (!last) continue;
    if (k >= points->external && k < points->external + p->thrusts)
      for (int i = 0; i < 2; ++i) thrust[thrusts++] -= found[before + i], found[before + i] = 0;
    for (int i = before; i < all - e->parameters; ++i) *numbers++ -= found[i];
    for (int i = 0; i < e->parameters; ++i) parameters[e->parameter[i]] -= found[all - e->parameters + i];
  }
}

/* By the rotations of the axes across which forces of joints count for friction. */
static void pull_turns(const Problem *p, const Backward *b) {
  for (int k = 0; k < p->points->all; ++k) {
    int dof = p->points->of[k].load < 0 ? -1 : p->points->of[k].load_turn;
    if (dof >= 0) b->by_start[dof] -= b->of_turn[k], b->by_increment[dof] -= p->level * b->of_turn[k];
  }
}

/* All that has a work on omega. The vectors of a Backward begin at zero. */
static void pull_forces(const Problem *p, const Work *w, const Adjoint *a, const Backward *b, double *thrust,
                        double *parameters, int last) {
  const double *fields[PULLED_FIELDS] = {w->D, p->q, p->v, p->a, p->before, p->internal,
                                         p->natural, w->natural_end, b->omega, b->of_internal};
  double t = p->t + p->level * w->dt;
  memset(b->by_increment, 0, p->dofs * sizeof(double));
  memset(b->by_start, 0, p->dofs * sizeof(double));
  memset(b->by_before, 0, p->dofs * sizeof(double));
  memset(b->lost_internal, 0, (long)p->cells * p->cell_internal * sizeof(double));
  memset(b->lost_springs, 0, p->spring_width * sizeof(double));
  memset(b->by_natural, 0, (long)p->cells * p->cell_natural * sizeof(double));
  memset(b->by_natural_end, 0, (long)p->cells * p->cell_natural * sizeof(double));
  pull_elements(p, &a->internal_forces, fields, b, t, w->dt, parameters, last);
  pull_elements(p, &a->drag, fields, b, t, w->dt, parameters, last);
  if (p->points->all) pull_points(p, a, b, thrust, parameters, last);
  if (p->friction_follows) pull_turns(p, b);
  if (p->points->members) pull_members(p, a, b->omega, b->of_springs, b->by_start, b->by_increment, b->lost_springs, last);
}

/* The derivatives of mu Tv^T r by the values of Tv, also in the gaps of loops and in ties; less those that weights
   of joint forces give. */
static void pull_map(const Problem *p, const Work *w, const Backward *b) {
  double *on_ties = b->on_ties, *to = b->of_map;
  const double *r = with_carried(p, w);
  for (int i = 0; i < 1 + 4 * p->joints; ++i) to[i] = -b->of_levers[i];
  for (int k = p->equal; k < p->entries; ++k)
    to[p->entry_value[k]] += p->entry_sign[k] * b->mu[p->entry_column[k]] * r[p->entry_row[k]];
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      to[p->gap_value[k]] -= p->gap_sign[k] * b->mu[p->gap_column[k]] * w->closing[i];
  if (!p->ties) return;
  memset(on_ties, 0, (p->columns + p->ties) * sizeof(double));
  add_rows(p, w, r, on_ties);
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      on_ties[p->gap_column[k]] -= p->gap_sign[k] * w->virtual_map[p->gap_value[k]] * w->closing[i];
  collect_ties(p, w->virtual_map, on_ties);
  for (int k = 0; k < p->tie_entries; ++k)
    to[p->tie_value[k]] += p->tie_sign[k] * b->mu[p->tie_column[k]] * on_ties[p->columns + p->tie_of[k]];
}

/* From these to those by rotations and slides at both ends, which Tv depends on. */
static void pull_arms(const Problem *p, const Work *w, const Backward *b) {
  double late = p->level, early = 1 - p->level;
  for (int j = 0; j < p->joints; ++j) {
    const double *m = b->of_map + 1 + 4 * j, *mean = w->mean_t + 2 * j;
    const double *rho0 = w->rho0 + 2 * j, *rho1 = w->rho1 + 2 * j, *t0 = w->t0 + 2 * j, *t1 = w->t1 + 2 * j;
    double slope = w->guide_slope[j], bend = w->guide_bend[j] * (m[2] * mean[0] + m[3] * mean[1]);
    if (p->guide[j] >= 0) {
      b->end[p->guide[j]] -= bend - late * (m[0] * rho1[0] + m[1] * rho1[1]) +
                             slope * late * (m[3] * t1[0] - m[2] * t1[1]);
      b->start[p->guide[j]] -= -bend - early * (m[0] * rho0[0] + m[1] * rho0[1]) +
                               slope * early * (m[3] * t0[0] - m[2] * t0[1]);
    }
    if (p->slide_column[j] < 0) continue;
    b->end_columns[p->slide_column[j]] -= late * (m[1] * t1[0] - m[0] * t1[1]);
    b->start_columns[p->slide_column[j]] -= early * (m[1] * t0[0] - m[0] * t0[1]);
  }
}

/* Adds forces on what follows through the arms of joints. */
static void add_followers(const Problem *p, const double *x, const double *columns, double *to) {
  memset(to, 0, 2 * p->joints * sizeof(double));
  for (int k = 0; k < p->followers; ++k) to[p->through[k]] += p->joint_sign[p->through[k]] * x[p->follower[k]];
  for (int k = 0; k < p->tie_arms; ++k)
    to[p->tie_arm[k]] += p->joint_sign[p->tie_arm[k]] * columns[p->columns + p->tie_arm_of[k]];
}

/* Adds a force on an arm R(psi) (offset + d axis), turned back, to derivatives by offset and axis. */
static void pull_arm(double psi, double d, double x, double y, double *offset, double *axis) {
  double back[2];
  turn(-psi, x, y, back);
  for (int i = 0; i < 2; ++i) offset[i] += back[i], axis[i] += d * back[i];
}

/* Derivatives by offsets and axes of the joints: by the arms of what follows, from the reference configuration
   on, and by Tv. */
static void pull_offsets(const Problem *p, const Work *w, const Adjoint *a, const Backward *b) {
  for (int j = 0; j < p->joints; ++j) {
    const double *m = b->of_map + 1 + 4 * j, *first = b->at_start + 2 * j, *last = b->at_end + 2 * j;
    double *offset = a->offset + 2 * j, *axis = a->axis + 2 * j, back[2], slope = w->guide_slope[j];
    double d0 = at(p->slides, p->slide_of[j]), d1 = d0, rest = a->slide_at_rest[j];
    double psi0 = w->psi0[j], psi1 = psi0 + at(w->D, p->guide[j]), early = 1 - p->level, late = p->level;
    if (p->slide_column[j] >= 0) d1 += w->z[p->slide_column[j]];
    pull_arm(psi0, d0, first[0] - early * m[1], first[1] + early * m[0], offset, axis);
    pull_arm(psi1, d1, last[0] - late * m[1], last[1] + late * m[0], offset, axis);
    pull_arm(0, rest, -first[0] - last[0], -first[1] - last[1], offset, axis);
    a->rest[j] -= (first[0] + last[0]) * p->axis[2 * j] + (first[1] + last[1]) * p->axis[2 * j + 1];
    for (int side = 0; side < 2; ++side) {
      turn(side ? -psi1 : -psi0, m[2], m[3], back);
      for (int i = 0; i < 2; ++i) axis[i] -= (side ? late : early) * slope * back[i];
    }
  }
}

/* By the axes across which forces of joints count for friction. */
static void pull_axes_of_friction(const Problem *p, const Work *w, const Adjoint *a, const Backward *b) {
  for (int k = 0; k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    double slope[5];
    if (e->load < 0) continue;
    followed_size(e, w->joint_forces, p->q, w->D, p->level, slope);
    for (int j = 0; j < p->joints; ++j)
      for (int i = 0; p->slide_of[j] == e->load && i < 2; ++i) a->axis[2 * j + i] += b->of_followed[k] * slope[3 + i];
  }
}

/* By the gaps of loops: they hold at the end of the step. */
static void pull_gaps(const Problem *p, const Work *w, const Backward *b) {
  for (int k = 0; k < p->closures; ++k) {
    double nu = b->of_gaps[k];
    int i = p->gap_arm[k], j = i / 2;
    if (p->gap_b[k] >= 0) b->end[p->gap_b[k]] -= nu;
    if (p->gap_a[k] >= 0) b->end[p->gap_a[k]] += nu;
    if (i < 0) continue;
    if (p->guide[j] >= 0) b->end[p->guide[j]] += nu * (i % 2 ? w->rho1[i - 1] : -w->rho1[i + 1]);
    if (p->slide_column[j] >= 0) b->end_columns[p->slide_column[j]] += nu * w->t1[i];
  }
}

/* By masses, weights and loads. */
static void pull_loads(const Problem *p, const Work *w, const Adjoint *a, const Backward *b, double *loads) {
  const double *omega = b->omega, *given = b->loads;
  for (int i = 0; i < p->dofs; ++i) {
    a->weight[i] += acting(p) * omega[i];
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k)
      a->mass[k] -= omega[i] * w->acc[p->mass_column[k]];
  }
  for (int k = 0; k < p->loads; ++k) {
    double at_level = (1 - p->level) * given[k] + p->level * given[p->loads + k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i) {
      double along = omega[p->load_dof[i]];
      a->load_force[i] += along * at_level;
      loads[k] += (1 - p->level) * along * p->load_force[i];
      loads[p->loads + k] += p->level * along * p->load_force[i];
    }
  }
}

/* By natural strains: those at the end are also those at the start of the next sub-step. */
static void pull_natural(const Problem *p, const Adjoint *a, const Backward *b, double *naturals) {
  long size = (long)p->cells * p->cell_natural;
  for (long i = 0; i < size; ++i) a->natural[i] -= b->by_natural_end[i];
  for (int k = 0; k < p->naturals; ++k)
    for (int i = p->natural_start[k]; i < p->natural_start[k + 1]; ++i) {
      double of_strain = a->natural[p->natural_at[i]];
      a->natural_value[i] += of_strain * b->natural[k], naturals[k] += of_strain * p->natural_value[i];
    }
  for (long i = 0; i < size; ++i) a->natural[i] = -b->by_natural[i];
}

/* Adds the derivatives of J by the state at a boundary between sub-steps itself. */
static void add_given(const Problem *p, const Adjoint *a, long boundary, double *q) {
  long k = a->weight_at[boundary], n = p->dofs;
  if (k < 0) return;
  for (int i = 0; i < n; ++i) q[i] += a->q_weight[k * n + i], a->v[i] += a->v_weight[k * n + i];
  for (int j = 0; j < p->joints; ++j)
    if (p->slide_column[j] >= 0)
      a->columns[p->slide_column[j]] += a->slide_weight[k * p->scene_joints + p->slide_of[j]];
  for (const Slider *s = p->slider; s < p->slider + p->sliders; ++s)
    a->columns[s->column] += a->slide_weight[k * p->scene_joints + s->joint];
  long m = (long)p->cells * p->cell_internal;
  for (long i = 0; a->internal_weight && i < m; ++i) a->internal[i] += a->internal_weight[k * m + i];
  m = p->spring_width;
  for (long i = 0; a->internal_weight && i < m; ++i) a->spring_internal[i] += a->spring_weight[k * m + i];
}

/* Of follower forces and others that are loads it is the last number. */
static void set_load_factor(const Problem *p, const Adjoint *a) {
  for (int k = p->points->external; k < p->points->nodal; ++k) {
    const PointForce *e = p->points->of + k;
    e->given[a->arguments[k] - e->parameters - 1] = p->ratio;
  }
}

/* Rates at the end for an increment of the path; none in statics. */
static double rates_per_path(const Problem *p, double dt) { return p->at_rest ? 0 : 2 / dt; }

/* The forces of a sub-step of a tape, and its tangent; returns 0 in a singular position. */
static int begin_taped(Problem *p, Work *w, const Adjoint *a, const double *row, const Backward *b) {
  double dt = row[1], level;
  take_from_tape(p, w, row, b->loads, b->thrust, b->natural);
  level = p->t + p->level * dt;
  if (dt != w->dt) w->dt = dt, begin_inertia(p, w);
  begin_loads(p, w, b->loads);
  if (p->naturals) begin_natural(p, w, b->natural);
  w->thrust = b->thrust;
  if (p->at_rest) set_load_factor(p, a);
  fx_set_parameters(p->points, p->parameter);
  begin_internal(p, w->fields, level, dt, 0);
  begin_form(p, &p->drag, w->fields, level, dt);
  if (!begin_couplings(p, w) && !choose_ahead(p, w)) return 0;
  if (!expand(p, w)) return 0;
  if (p->points->members) settle_members(p, w);
  balance(p, w);
  if (p->friction_follows) set_axes(p);
  if (p->points->members) find_member_slopes(p, w, a);
  reduce_tangent(p, w, w->r);
  find_slide_ends(p, w, b->slides);
  return 1;
}

/* The values of T at the start. */
static void values_at_start(const Problem *p, const Work *w, const Backward *b) {
  b->values[0] = 1;
  for (int j = 0; j < p->joints; ++j) {
    double *value = b->values + 1 + 4 * j;
    value[0] = -w->rho0[2 * j + 1], value[1] = w->rho0[2 * j], value[2] = w->t0[2 * j], value[3] = w->t0[2 * j + 1];
  }
}

/* The transpose of `pass_forces`. */
static void return_forces(const Problem *p, int first, int end, double *on_nodes, const double *on_joints) {
  for (int k = end - 1; k >= first; --k) {
    double to = p->pass_to[k] >= 0 ? on_nodes[p->pass_to[k]] : 0;
    on_nodes[p->pass_dof[k]] += p->pass_sign[k] * on_joints[p->pass_of[k]] + to;
  }
}

/* From derivatives of J by nodal forces with those that sliding nodes exert, to those by nodal forces, levers and
   closing forces. */
static void pull_carried(const Problem *p, const Work *w, const Backward *b, double *closing) {
  double *nodes = b->of_forces;
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a)
    for (int c = 0; c < a->components; ++c) {
      double by_force = 0;
      for (int k = 0; k < a->components * a->width; ++k) by_force += a->virtual_map[c][k] * nodes[local_dof(a, k)];
      for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k) {
        int row = a->entry_row[k], value = a->entry_value[k];
        b->of_levers[value] += a->entry_sign[k] * by_force * w->loaded[row];
        nodes[row] += a->entry_sign[k] * by_force * w->virtual_map[value];
      }
      for (int i = 0; i < p->guided; ++i) {
        int of = p->guided_closure[i];
        for (int k = p->gap_entry_start[of]; k < p->gap_entry_start[of + 1]; ++k) {
          if (p->gap_column[k] != a->carried[c]) continue;
          closing[of] -= p->gap_sign[k] * by_force * w->virtual_map[p->gap_value[k]];
          b->of_levers[p->gap_value[k]] -= p->gap_sign[k] * by_force * w->closing[of];
        }
      }
    }
}

/* From derivatives of J by the forces of joints, in `of_joints`, to those by nodal forces, levers and closing forces
   (find_joint_forces). */
static void pull_joint_forces(const Problem *p, const Work *w, const Backward *b, double *closing) {
  double *nodes = b->of_forces, *joints = b->of_joints;
  return_forces(p, p->passes_of_forces, p->passes, nodes, joints);
  for (int j = 0; j < p->joints; ++j) {
    const double *lever = w->virtual_map + 1 + 4 * j, *F = w->joint_forces + 3 * p->slide_of[j];
    for (int i = 0; i < 2 && p->guide[j] >= 0; ++i) {
      b->of_levers[1 + 4 * j + i] += F[i] * nodes[p->guide[j]];
      joints[3 * p->slide_of[j] + i] += lever[i] * nodes[p->guide[j]];
    }
  }
  return_forces(p, 0, p->passes_of_forces, nodes, joints);
  for (int k = 0; k < p->closures; ++k) {
    closing[k] = joints[p->gap_force[k]];
    if (p->gap_b[k] >= 0) closing[k] -= nodes[p->gap_b[k]];
    if (p->gap_a[k] >= 0) closing[k] += nodes[p->gap_a[k]];
  }
  pull_carried(p, w, b, closing);
}

/* The derivatives of the force across the axis of a beam (followed_size) by the axis. */
static void slope_of_axis(const Slider *a, const double *joints, double slope[2]) {
  int s = a->components * a->width;
  double axis[] = {a->virtual_map[0][s], a->virtual_map[1][s]};
  const double *F = joints + 3 * a->joint;
  double length = hypot(axis[0], axis[1]), across = (axis[0] * F[1] - axis[1] * F[0]) / length;
  for (int i = 0; i < 2; ++i)
    slope[i] = (across < 0 ? -1 : 1) * ((i ? -F[0] : F[1]) - across * axis[i] / length) / length;
}

/* Friction has as an internal variable the force of its joint in this sub-step (fx_follow_joints). */
static void pull_followed(const Problem *p, const Work *w, const Backward *b) {
  for (int k = 0; k < p->points->all; ++k) {
    const PointForce *e = p->points->of + k;
    if (e->load < 0) continue;
    double slope[5], weight = b->of_followed[k];
    followed_size(e, w->joint_forces, p->q, w->D, p->level, slope);
    for (int i = 0; i < 2; ++i) b->of_joints[3 * e->load + i] += weight * slope[i];
    b->of_turn[k] = weight * slope[2];
    for (int i = 0; i < p->sliders; ++i) {
      if (p->slider[i].joint != e->load) continue;
      slope_of_axis(p->slider + i, w->joint_forces, slope);
      b->of_axes[2 * i] = weight * slope[0], b->of_axes[2 * i + 1] = weight * slope[1];
    }
  }
}

/* Sets the derivatives by the forces that friction follows from those by internal variables; returns whether they
   changed. */
static int change_of_followed(const Problem *p, Backward *b) {
  const PointForces *points = p->points;
  double found[points->all], trial[points->all];
  int n = 0, changed;
  for (int k = 0; k < points->all; ++k) {
    const PointForce *e = points->of + k;
    if (e->load >= 0) trial[n] = b->of_followed[k], found[n++] = -b->lost_springs[e->first_internal + FOLLOWED];
  }
  changed = next_trial(&b->following, found, 0, trial);
  for (int k = points->all - 1; k >= 0; --k)
    if (points->of[k].load >= 0) b->of_followed[k] = trial[--n];
  return changed;
}

/* What weights of the forces of a sub-step add to mu and omega: a force of a column is a row of Tv^T r, as those of
   the unknowns are, and closing forces follow from the rows of the unknowns that follow. Returns 0 without weights. */
static int begin_forces(const Problem *p, const Work *w, const Adjoint *a, const Backward *b, long k) {
  long row = a->force_at[k], constrained = p->columns - p->free, joints = 3 * p->scene_joints;
  memset(b->omega, 0, p->dofs * sizeof(double)), memset(b->mu, 0, (p->columns + p->ties) * sizeof(double));
  memset(b->forced, 0, p->columns * sizeof(double)), memset(b->of_forces, 0, p->dofs * sizeof(double));
  memset(b->of_levers, 0, (1 + 4 * p->joints) * sizeof(double)), memset(b->of_joints, 0, joints * sizeof(double));
  if (row < 0 && !p->friction_follows) return 0;
  for (int i = 0; row >= 0 && i < constrained; ++i)
    b->forced[p->free + i] = -a->constraint_weight[row * constrained + i];
  memset(b->of_gaps, 0, p->closures * sizeof(double));
  if (joints) {
    find_joint_forces(p, w);
    if (row >= 0) memcpy(b->of_joints, a->joint_weight + row * joints, joints * sizeof(double));
    if (p->friction_follows) pull_followed(p, w, b);
    pull_joint_forces(p, w, b, b->of_gaps);
  }
  for (int i = 0; i < p->closures; ++i) {
    b->of_gaps[i] = -b->of_gaps[i];
    for (int g = p->gap_start[i]; g < p->gap_start[i + 1]; ++g)
      b->of_gaps[i] -= w->G_virtual[g] * b->forced[p->loop_column[p->gap_near[g]]];
  }
  if (p->closures) solve_gaps(p, w, w->part_virtual, w->order_virtual, b->of_gaps);
  for (int i = 0; i < p->closures; ++i) b->forced[p->loop_column[p->following[i]]] += b->of_gaps[i];
  memcpy(b->mu, b->forced, p->columns * sizeof(double));
  spread_virtual(p, w, b->mu, b->omega);
  for (int i = 0; i < p->dofs; ++i) b->omega[i] -= b->of_forces[i];
  return 1;
}

/* Adds to the derivatives by the configuration at the end what forces and masses, and with mu Tv, have of it. */
static void pull_end(const Problem *p, const Work *w, const Backward *b) {
  double per_dt = rates_per_path(p, w->dt), stiff = per_dt * per_dt / 2;
  double *nodal[] = {b->start, b->end}, *columns[] = {b->start_columns, b->end_columns};
  if (p->friction_follows) turn_back(p, w), pull_axes(p, w, b->of_axes, nodal, columns);
  times_mass(p, b->omega, w->scratch);
  for (int i = 0; i < p->dofs; ++i) b->end[i] -= b->by_increment[i] + stiff * w->slope[i] * w->scratch[i];
  if (p->joints) pull_map(p, w, b), pull_arms(p, w, b);
  pull_slides(p, b->slides, b->omega, b->mu, nodal, columns);
}

/* Finds mu and omega of a sub-step; returns 0 if its tangent is singular. */
static int find_weights(Problem *p, Work *w, const Adjoint *a, const Backward *b, long k) {
  int n = p->dofs;
  long internal = (long)p->cells * p->cell_internal;
  memcpy(b->end, b->kept, n * sizeof(double));
  memcpy(b->end_columns, a->columns, p->columns * sizeof(double));
  memset(b->start_columns, 0, (p->columns + p->ties) * sizeof(double));
  for (int i = 0; i < p->spring_width; ++i) b->of_springs[i] = -a->spring_internal[i];
  for (long i = 0; i < internal; ++i) b->of_internal[i] = -a->internal[i] * p->per_weight[i % p->cell_internal];
  int forced = begin_forces(p, w, a, b, k);
  if (forced || internal || p->spring_width) pull_forces(p, w, a, b, 0, 0, 0), pull_end(p, w, b);
  memcpy(w->columns, b->end_columns, p->columns * sizeof(double));
  gather(p, b, 1, w->values, b->end, w->columns);
  memcpy(w->reduced, w->columns, p->free * sizeof(double));
  memcpy(b->end, b->kept, n * sizeof(double));
  if (!solve_transposed(p, w, a)) return 0;
  memcpy(b->mu, b->forced, p->columns * sizeof(double));
  for (int i = 0; i < p->free; ++i) b->mu[i] += w->step[i];
  for (int i = 0; i < p->closures; ++i) b->of_gaps[i] = w->y[order_now(p)[p->unknowns - p->closures + i]];
  spread_virtual(p, w, b->mu, b->omega);
  for (int i = 0; i < n; ++i) b->omega[i] -= b->of_forces[i];
  return 1;
}

/* Takes the derivatives from the end of a sub-step to its start; returns 0 if its tangent is singular. */
static int pull_step(Problem *p, Work *w, const Adjoint *a, Backward *b, const Tape *tape, long row) {
  int n = p->dofs, all = p->columns + p->ties;
  long k = tape->first + row;
  if (!begin_taped(p, w, a, tape->row + row * tape->size, b)) return 0;
  double per_dt = rates_per_path(p, w->dt), *path_bar = b->momentum;

  /* By the increment through rates and internal variables, and through what the state itself counts. */
  memset(b->end, 0, n * sizeof(double));
  add_given(p, a, k + 1, b->end);
  for (int i = 0; i < n; ++i) path_bar[i] = per_dt * w->slope[i] * a->v[i];
  for (int i = 0; i < p->massless_count; ++i) path_bar[p->massless[i]] /= 2;
  for (int i = 0; i < n; ++i) b->kept[i] = b->end[i] + path_bar[i];
  memset(b->of_followed, 0, p->points->all * sizeof(double)), memset(b->of_axes, 0, 2 * p->sliders * sizeof(double));
  begin_fixed_point(&b->following);
  if (!find_weights(p, w, a, b, k)) return 0;
  for (int i = 0; p->friction_follows && i < MOST_TRIALS; ++i) {
    pull_forces(p, w, a, b, 0, 0, 0);
    if (!change_of_followed(p, b)) break;
    if (!begin_taped(p, w, a, tape->row + row * tape->size, b) || !find_weights(p, w, a, b, k)) return 0;
  }
  memcpy(b->end_columns, a->columns, p->columns * sizeof(double));
  memset(b->start_columns, 0, all * sizeof(double));
  pull_forces(p, w, a, b, a->thrust + 2L * k * p->thrusts, a->parameters + 2L * k * p->parameter_count, 1);
  pull_loads(p, w, a, b, a->loads + 2L * k * p->loads);
  if (p->naturals) pull_natural(p, a, b, a->naturals + k * p->naturals);
  for (int i = 0; i < n; ++i) b->start[i] = a->before[i] - path_bar[i] + b->by_increment[i] - b->by_start[i];
  memcpy(a->before, b->by_before, n * sizeof(double)), scale(n, -1, a->before);
  pull_end(p, w, b);
  for (int i = 0; i < n; ++i) {
    b->start[i] += per_dt * per_dt / 2 * w->slope[i] * w->scratch[i];
    a->v[i] = per_dt * w->scratch[i] - a->v[i];
  }
  for (int i = 0; i < p->massless_count; ++i) a->v[p->massless[i]] = 0;
  a->sizes[k] = sqrt(dot(n, a->v, a->v));
  for (long i = 0, internal = (long)p->cells * p->cell_internal; i < internal; ++i) a->internal[i] -= b->lost_internal[i];
  for (int i = 0; i < p->spring_width; ++i) a->spring_internal[i] = -b->lost_springs[i];
  for (const PointForce *e = p->points->of; e < p->points->of + p->points->all; ++e)
    if (e->load >= 0) a->spring_internal[e->first_internal + FOLLOWED] = 0; /* but a first trial */

  if (p->closures) pull_gaps(p, w, b);
  gather(p, b, 1, w->values, b->end, b->end_columns);
  pull_places(p, w, a, b, 1);
  if (p->joints) add_followers(p, b->end, b->end_columns, b->at_end);
  for (int i = 0; i < p->closures; ++i)
    if (p->gap_arm[i] >= 0) b->at_end[p->gap_arm[i]] += b->of_gaps[i];
  for (int i = 0; i < p->driven; ++i) a->driven[k * p->driven + i] += b->end_columns[p->free + i];
  if (k == 0) {
    memset(a->columns, 0, p->columns * sizeof(double));
    add_given(p, a, 0, b->start);
    for (int i = 0; i < p->columns; ++i) b->start_columns[i] += a->columns[i];
  }
  values_at_start(p, w, b);
  gather(p, b, 0, b->values, b->start, b->start_columns);
  pull_places(p, w, a, b, 0);
  if (p->joints) {
    add_followers(p, b->start, b->start_columns, b->at_start);
    pull_offsets(p, w, a, b);
    if (p->friction_follows) pull_axes_of_friction(p, w, a, b);
  }
  memcpy(a->columns, b->start_columns, p->columns * sizeof(double));
  return 1;
}

/* The forces of driven and fixed columns in the sub-steps of a tape; returns the number of those that are left in a
   singular position. */
long fx_taped_forces(Problem *p, const Tape *tape, const Adjoint *a, double *forces) {
  Work work, *w = &work;
  Backward b;
  int constrained = p->columns - p->free;
  lay_out(p, w, p->scratch), lay_out_backward(p, &b, a->scratch);
  w->dt = NAN;
  for (long row = 0; row < tape->rows; ++row) {
    if (!begin_taped(p, w, a, tape->row + row * tape->size, &b)) return tape->rows - row;
    project(p, w, w->r, w->columns);
    memcpy(forces + row * constrained, w->columns + p->free, constrained * sizeof(double));
  }
  p->kept.present = 0;
  return 0;
}

/* Follows a tape backwards; returns the number of sub-steps that are left where a tangent is singular. */
long fx_pull(Problem *p, const Tape *tape, const Adjoint *a) {
  Work work, *w = &work;
  Backward b;
  lay_out(p, w, p->scratch), lay_out_backward(p, &b, a->scratch);
  w->dt = NAN, w->transposed = 1;
  for (long k = tape->rows - 1; k >= 0; --k) {
    if (tape->apart) memset(a->columns, 0, (p->columns + p->ties) * sizeof(double));
    if (!pull_step(p, w, a, &b, tape, k)) return k + 1;
  }
  return 0;
}
