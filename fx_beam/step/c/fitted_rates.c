/* Rates that fit joints and supports (step/fitted_rates.py). */

#include <stdlib.h>
#include "algebra.h"
#include "fitted_rates.h"
#include "slide_relation.h"
#include "track.h"

/* Subtracted from the diagonal of equations, relative to what masses give, as they are singular where
   loops are in line. Repetitions remove the effects of this and of small masses. */
static const double REGULAR = 1e-13, LAST_CHANGE = 1e-12;
enum { REPETITIONS = 20 };

/* Work space: all entries, those in use, what is given, forces on b; right side, solution and correction in
   the order of elimination; factors; multipliers; forces on points, and rates that follow. */
#define FIT_ARRAYS(OF)                                                                                     \
  OF(g, f->all_entries) OF(entry, f->entries) OF(given, f->count) OF(push, 2 * f->count) OF(right, unknowns) \
  OF(x, unknowns) OF(rest, unknowns) OF(factors, f->column_start[unknowns]) OF(multiplier, f->count)       \
  OF(on_point, 3 * f->points) OF(other, f->others)

typedef struct {
  FIT_ARRAYS(NUMBERS)
} FitWork;

static long lay_out_fit(const RateFit *f, FitWork *w, double *at) {
  double *begin = at;
  long unknowns = f->used + f->count;
  FIT_ARRAYS(ALLOCATE)
  return at - begin;
}

static double *work_of(const RateFit *f, FitWork *w) {
  double *space = malloc((lay_out_fit(f, w, 0) + LANES) * sizeof(double));
  if (space) lay_out_fit(f, w, space);
  return space;
}

static void set_row(double *given, double *push, int row, double g, double x, double y) {
  given[row] = g, push[2 * row] = x, push[2 * row + 1] = y;
}

/* Equations of a node on a beam, with their entries from g on; returns their number. */
static int set_on_beam(const BeamRate *b, const double *q, const double *slide, int row, double *g,
                       double *given, double *push) {
  Slider *a = b->path;
  Weight N;
  int n = 1 + b->nodes, rows = 2 - b->free + b->sleeve, last = row + rows - 1;
  double along[3];
  find_axis(a, slide[b->joint], q, &N, along);
  double square = along[0] * along[0] + along[1] * along[1], size = sqrt(square);
  double turned = b->free ? -along[2] / square : 0;
  if (b->free)
    set_row(given, push, row, 0, -along[1] / size, along[0] / size);
  else
    set_row(given, push, row, along[0], 1, 0), set_row(given, push, row + 1, along[1], 0, 1);
  if (b->sleeve) set_row(given, push, last, b->free ? 0 : along[2], turned * along[0], turned * along[1]);
  memset(g, 0, 3L * rows * n * sizeof(double));
  for (int r = row; r < row + rows; ++r, g += 3 * n) {
    double weight[3] = {push[2 * r], push[2 * r + 1], b->sleeve && r == last};
    for (int i = 0; i < 3; ++i) {
      g[i * n] = weight[i];
      for (int k = 0; k < a->width; ++k) g[i * n + 1 + a->first + k] = -weight[i] * N.of[k];
    }
  }
  return rows;
}

/* All equations at q, in the order of rate_equations.py; their entries that are in use. */
static void set_equations(const RateFit *f, const double *q, const double *slide, double *g, double *entry,
                          double *given, double *push) {
  double *all = g;
  for (int r = 0; r < f->plain; ++r, g += 6) {
    const double *p = push + 2 * r, *axis = f->axis + 2 * r;
    set_row(given, push, r, f->constant[r], f->direction[2 * r], f->direction[2 * r + 1]);
    if (axis[0] != 0 || axis[1] != 0) {
      double t[2], d = slide[f->joint[r]];
      Track track = track_of(f->track[r], axis, d, d);
      turn(at(q, f->a[3 * r + 2]), track.chord[0], track.chord[1], t);
      if (f->free[r])
        set_row(given, push, r, 0, -t[1], t[0]);
      else
        given[r] += t[0] * p[0] + t[1] * p[1];
    }
    for (int side = 0; side < 2; ++side) {
      const int *end = f->ends + 6 * r + 3 * side, *b = f->b + 3 * r;
      double *to = g + 3 * side, sign = side ? -1 : 1, arm[2];
      for (int i = 0; i < 2; ++i) arm[i] = f->arms[4 * r + 2 * side + i] + at(q, b[i]) - at(q, end[i]);
      to[0] = sign * p[0], to[1] = sign * p[1];
      to[2] = sign * (f->turning[r] + arm[0] * p[1] - arm[1] * p[0]);
    }
  }
  for (int i = 0, row = f->plain; i < f->beams; ++i) {
    int rows = set_on_beam(f->beam + i, q, slide, row, g, given, push);
    row += rows, g += 3 * rows * (1 + f->beam[i].nodes);
  }
  for (int k = 0; k < f->entries; ++k) entry[k] = all[f->entry[k]];
}

/* Factors of the masses, with small ones of what has none, and of the equations. */
static void factorise_equations(const RateFit *f, const double *entry, const FitWork *w) {
  double *A = w->factors;
  const int *start = f->column_start, *target = f->target;
  int unknowns = f->used + f->count;
  memcpy(A, f->start_of_factors, start[unknowns] * sizeof(double));
  for (int k = 0; k < f->entries; ++k) {
    double g = entry[k];
    A[f->entry_at[k]] += g, A[start[f->entry_multiplier[k]]] -= REGULAR * g * g * f->mobility[k];
  }
  for (int j = 0; j < unknowns; ++j) {
    double *column = A + start[j], pivot = 1 / column[0];
    int below = start[j + 1] - start[j];
    for (int a = 1; a < below; ++a) {
      double factor = column[a] * pivot;
      for (int b = 1; b <= a; ++b) A[*target++] -= factor * column[b];
    }
    for (int a = 1; a < below; ++a) column[a] *= pivot;
    column[0] = pivot;
  }
}

/* Solution of the equations in place of the right side x. */
static void substitute(const RateFit *f, const double *A, double *x) {
  const int *start = f->column_start, *row = f->row_of;
  int unknowns = f->used + f->count;
  for (int j = 0; j < unknowns; ++j) {
    for (int k = start[j] + 1; k < start[j + 1]; ++k) x[row[k]] -= A[k] * x[j];
    x[j] *= A[start[j]];
  }
  for (int j = unknowns - 1; j >= 0; --j)
    for (int k = start[j] + 1; k < start[j + 1]; ++k) x[j] -= A[k] * x[row[k]];
}

/* Solution x of the equations with a right side. */
static void solve_equations(const RateFit *f, const double *entry, const double *right, double *x,
                            const FitWork *w) {
  int unknowns = f->used + f->count;
  double change = INFINITY, size = 0, *rest = w->rest;
  memset(x, 0, unknowns * sizeof(double));
  for (int k = 0; k < REPETITIONS && change > LAST_CHANGE * size; ++k) {
    memcpy(rest, right, unknowns * sizeof(double));
    for (int j = 0; j < f->masses && k; ++j) rest[f->mass_row[j]] -= f->mass[j] * x[f->mass_column[j]];
    for (int j = 0; j < f->entries && k; ++j) {
      int rate = f->entry_rate[j], multiplier = f->entry_multiplier[j];
      rest[rate] -= entry[j] * x[multiplier], rest[multiplier] -= entry[j] * x[rate];
    }
    substitute(f, w->factors, rest);
    for (int i = 0; i < unknowns; ++i) x[i] += rest[i];
    change = size = 0;
    for (int i = 0; i < f->used; ++i) {
      int rate = f->order[i];
      change = fmax(change, fabs(rest[rate])), size = fmax(size, fabs(x[rate]));
    }
  }
}

/* Forces of joints on b (joints, 3), and of driven and fixed columns, by the multipliers. */
static void find_forces(const RateFit *f, const double *push, const double *turning, const double *given,
                        const double *multiplier, double *joints, double *constraints) {
  memset(joints, 0, 3L * f->joints * sizeof(double));
  memset(constraints, 0, f->columns * sizeof(double));
  for (int r = 0; r < f->count; ++r) {
    double m = multiplier[r], *out = joints + 3 * f->joint[r];
    if (f->joint[r] >= 0)
      out[0] += push[2 * r] * m, out[1] += push[2 * r + 1] * m, out[2] += turning[r] * m;
    if (f->column[r] >= 0) constraints[f->column[r]] += given[r] * m;
  }
}

/* Adds a force and a moment, times a sign, at an arm. */
static void add_force(const double *force, double sign, const double *arm, double *to) {
  to[0] += sign * force[0], to[1] += sign * force[1];
  to[2] += sign * (force[2] + arm[0] * force[1] - arm[1] * force[0]);
}

/* The joints of rigid points balance what else acts on these. */
static void balance_points(const RateFit *f, const double *q, const FitWork *w, double *joints) {
  static const double no_arm[2] = {0};
  double arm[2];
  memset(w->on_point, 0, 3 * f->points * sizeof(double));
  for (int r = 0; r < f->plain && f->points; ++r) {
    const int *b = f->b + 3 * r, *a = f->a + 3 * r, *point = f->point_of + 2 * r;
    double m = w->multiplier[r], force[3] = {w->push[2 * r] * m, w->push[2 * r + 1] * m, f->turning[r] * m};
    for (int i = 0; i < 2; ++i) arm[i] = f->apart[2 * r + i] + at(q, b[i]) - at(q, a[i]);
    if (point[0] >= 0) add_force(force, 1, no_arm, w->on_point + 3 * point[0]);
    if (point[1] >= 0) add_force(force, -1, arm, w->on_point + 3 * point[1]);
  }
  for (int k = f->points - 1; k >= 0; --k) {
    const int *a = f->point_a + 3 * k, *b = f->point_b + 3 * k;
    const double *force = w->on_point + 3 * k;
    for (int i = 0; i < 3; ++i) joints[3 * f->point_joint[k] + i] = -force[i];
    for (int i = 0; i < 2; ++i) arm[i] = f->point_apart[2 * k + i] + q[b[i]] - q[a[i]];
    if (f->point_of_point[k] >= 0) add_force(force, 1, arm, w->on_point + 3 * f->point_of_point[k]);
  }
}

/* Rates of all degrees of freedom by the solution. */
static void find_rates(const RateFit *f, const double *q, const double *v, const FitWork *w, double *rates,
                       double *corrections) {
  double *restrict other = w->other;
  memset(corrections, 0, f->size * sizeof(double)), memset(other, 0, f->others * sizeof(double));
  for (int i = 0; i < f->used; ++i) {
    double x = corrections[f->used_dof[i]] = w->x[f->order[i]];
    const double *restrict follow = f->follow + (long)i * f->others;
    for (int k = 0; k < f->others; ++k) other[k] += x * follow[k];
  }
  for (int k = 0; k < f->others; ++k) corrections[f->other_dof[k]] = other[k];
  for (int k = 0; k < f->size; ++k) rates[k] = v[k] + corrections[k];
  for (int k = 0; k < f->points; ++k) {
    const int *a = f->point_carrier + 3 * k, *b = f->point_b + 3 * k;
    const double *apart = f->point_arm + 2 * k;
    rates[b[0]] = rates[a[0]] - rates[a[2]] * (apart[1] + q[b[1]] - q[a[1]]);
    rates[b[1]] = rates[a[1]] + rates[a[2]] * (apart[0] + q[b[0]] - q[a[0]]);
    rates[b[2]] = rates[a[2]];
    for (int i = 0; i < 3; ++i) corrections[b[i]] = rates[b[i]] - v[b[i]];
  }
}

/* Fits the rates of n configurations: displacements and rotations, rates, slides, and driven rates, NaN
   where they are not known; writes rates, their corrections, the impulses of joints and columns, and if they are wanted
   the values of the equations: entries, what is given, forces on b, and multipliers. */
int fx_fit(const RateFit *f, int n, const double *q, const double *v, const double *slide, const double *driven,
           double *rates, double *corrections, double *joints, double *constraints, double *values) {
  FitWork work, *w = &work;
  double *space = work_of(f, w);
  const int *order = f->order + f->used;
  if (!space) return 0;
  for (; n > 0; --n) {
    if (values) {
      w->entry = values, w->given = w->entry + f->entries, w->push = w->given + f->count;
      w->multiplier = w->push + 2 * f->count, values = w->multiplier + f->count;
    }
    set_equations(f, q, slide, w->g, w->entry, w->given, w->push);
    memset(w->right, 0, (f->used + f->count) * sizeof(double));
    for (int k = 0; k < f->entries; ++k) w->right[f->entry_multiplier[k]] -= w->entry[k] * v[f->dof[k]];
    for (int r = 0; r < f->count; ++r) {
      int column = f->column[r];
      if (column >= 0 && column < f->driven) w->right[order[r]] += w->given[r] * driven[column];
      if (isnan(w->right[order[r]])) w->right[order[r]] = 0;
    }
    factorise_equations(f, w->entry, w);
    solve_equations(f, w->entry, w->right, w->x, w);
    for (int r = 0; r < f->count; ++r) w->multiplier[r] = -w->x[order[r]];
    find_forces(f, w->push, f->turning, w->given, w->multiplier, joints, constraints);
    balance_points(f, q, w, joints);
    find_rates(f, q, v, w, rates, corrections);
    q += f->size, v += f->size, rates += f->size, corrections += f->size;
    slide += f->joints, driven += f->driven, joints += 3 * f->joints, constraints += f->columns;
  }
  free(space);
  return 1;
}

int fx_solve_rates(const RateFit *f, int n, int m, const double *entries, const double *right, double *x) {
  FitWork work, *w = &work;
  double *space = work_of(f, w);
  int unknowns = f->used + f->count;
  for (; n > 0 && space; --n, entries += f->entries) {
    factorise_equations(f, entries, w);
    for (int k = 0; k < m; ++k, right += unknowns, x += unknowns) {
      for (int i = 0; i < unknowns; ++i) w->right[f->order[i]] = right[i];
      solve_equations(f, entries, w->right, w->x, w);
      for (int i = 0; i < unknowns; ++i) x[i] = w->x[f->order[i]];
    }
  }
  free(space);
  return space != 0;
}
