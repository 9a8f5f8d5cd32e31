/* Gathers what forces at points are given, calls their laws, and scatters what they find. */

#pragma once

#include "fixed_point.h"
#include "line_law.h"

/* Numbers of the nodes of a force, or number `at` of slides. */
static inline void coordinates(const PointForce *e, const double *nodes, const double *slides, int at, double *to) {
  for (int k = 0; k < e->size; ++k) to[k] = e->slide >= 0 ? slides[at] : e->dof[k] < 0 ? 0 : nodes[e->dof[k]];
}

/* Place of the force that friction follows among its internal variables. */
enum { FOLLOWED = 2 };

static int values_of(const PointForce *e) { return e->size + e->entries + e->internal + e->iteration_memory; }

void fx_set_parameters(const PointForces *p, const double *values) {
  for (const PointForce *e = p->of; e < p->of + p->all; ++e)
    for (int i = 0; i < e->parameters; ++i) e->parameter_values[i] = values[e->parameter[i]];
}

void fx_begin_points(const PointForces *p, const double *q, const double *v, const double *slide,
                     const double *slide_rate, double t, double dt, const double *internal) {
  for (PointForce *e = p->of; e < p->of + p->all; ++e) {
    int n = e->size;
    double *to = e->given + 3 * n;
    coordinates(e, q, slide, e->slide, e->given);
    coordinates(e, v, slide_rate, e->slide, e->given + 2 * n);
    *to++ = t, *to++ = dt;
    for (int i = 0; i < e->internal; ++i) *to++ = internal[e->first_internal + i];
    for (int i = 0; i < e->iteration_memory; ++i) *to++ = 0;
  }
  if (HAS(MEMBERS) && p->members) begin_members(p->members, q, v, t, dt, internal);
}

void fx_evaluate_points(const PointForces *p, int first, int end, const double *D, const double *z) {
  for (PointForce *e = p->of + first; e < p->of + end; ++e) {
    int values = values_of(e);
    coordinates(e, D, z, e->column, e->given + e->size);
    call_law(e, e->results);
    for (int i = 1; i <= e->iteration_memory; ++i) e->numbers[-i] = e->results[values - i];
  }
}

void fx_add_points(const PointForces *p, int first, int end, double factor, double *f) {
  for (const PointForce *e = p->of + first; e < p->of + end; ++e)
    for (int k = 0; k < e->size; ++k)
      if (e->dof[k] >= 0) f[e->dof[k]] += factor * e->results[k];
}

void fx_add_point_tangents(const PointForces *p, const int *stored_at, double *K) {
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    const int *to = stored_at + e->first_entry;
    for (int i = 0; i < e->entries; ++i)
      if (to[i] >= 0) K[to[i]] += e->results[e->size + i];
  }
}

double fx_lost_at_points(const PointForces *p, const double *D, const double *z) {
  double sum = HAS(MEMBERS) && p->members ? lost_at_members(p->members, D) : 0;
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    if (!e->loss) continue;
    coordinates(e, D, z, e->column, e->given + e->size);
    call_value(e, e->loss, p->probe, 1);
    sum += *p->probe;
  }
  return sum;
}

double fx_stored_at_points(const PointForces *p, const double *q, const double *slide, const double *internal) {
  double sum = HAS(MEMBERS) && p->members ? fx_stored_at_members(p->members, &(Energy){0}, q, internal) : 0;
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    if (!e->energy) continue;
    coordinates(e, q, slide, e->slide, e->given);
    for (int i = 0; i < e->internal; ++i) e->given[3 * e->size + 2 + i] = internal[e->first_internal + i];
    call_value(e, e->energy, p->probe, 1);
    sum += *p->probe;
  }
  return sum;
}

static void evolve_points(const PointForces *p, const double *D, const double *z, double *internal) {
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    if (!e->internal) continue;
    coordinates(e, D, z, e->column, e->given + e->size);
    call_law(e, e->results);
    memcpy(internal + e->first_internal, e->results + e->size + e->entries, e->internal * sizeof(double));
  }
  if (HAS(MEMBERS) && p->members) evolve_members(p->members, D, internal);
}

/* The size of the force of a joint that friction follows, and its derivatives: by x and y of the force, by the
   rotation of the axis, and by x and y of the axis in the reference. */
static double followed_size(const PointForce *e, const double *joints, const double *q, const double *D, double level,
                            double slope[5]) {
  const double *F = joints + 3 * e->load, *a = e->load_axis;
  double size = hypot(F[0], F[1]), turn = e->load_turn < 0 ? 0 : q[e->load_turn] + level * D[e->load_turn];
  slope[2] = slope[3] = slope[4] = 0;
  for (int i = 0; i < 2; ++i) slope[i] = size > 0 ? F[i] / size : 0;
  if (a[0] == 0 && a[1] == 0) return size;
  double c = cos(turn), s = sin(turn), x = c * a[0] - s * a[1], y = s * a[0] + c * a[1];
  double across = x * F[1] - y * F[0], sign = across < 0 ? -1 : 1;
  slope[0] = -sign * y, slope[1] = sign * x, slope[2] = -sign * (y * F[1] + x * F[0]);
  slope[3] = sign * (c * F[1] - s * F[0]), slope[4] = -sign * (s * F[1] + c * F[0]);
  return fabs(across);
}

/* From the forces of joints in the step D from q sets those that friction follows, by which the step is repeated;
   returns 0 if they are known. With `still` the last ones had no effect. */
static int follow_forces(PointForces *p, const double *joints, const double *q, const double *D, double level, int still,
                         double *internal) {
  int n = 0;
  double slope[5], sizes[p->all], trial[p->all];
  for (const PointForce *e = p->of; e < p->of + p->all; ++e)
    if (e->load >= 0) {
      sizes[n] = followed_size(e, joints, q, D, level, slope);
      trial[n++] = internal[e->first_internal + FOLLOWED];
    }
  if (!next_trial(&p->followed, sizes, still, trial)) return 0;
  for (const PointForce *e = p->of + p->all - 1; e >= p->of; --e)
    if (e->load >= 0) --n, internal[e->first_internal + FOLLOWED] = trial[n] > 0 ? trial[n] : sizes[n];
  return 1;
}

void fx_find_switches(const PointForces *p, const double *q, const double *slide, double *out) {
  for (const PointForce *e = p->of; e < p->of + p->all; out += e++->conditions) {
    if (!e->conditions) continue;
    coordinates(e, q, slide, e->slide, e->given);
    call_value(e, e->switches, out, e->conditions);
  }
  if (HAS(MEMBERS) && p->members) member_gaps(p->members, q, out);
}

/* Of forces with functions of a user, and of contact in equilibria: notes the tangent. */
static void note_tangents(const PointForces *p) {
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    if (!e->needs_line_search) continue;
    memcpy(e->tangent_at, e->given + e->size, e->size * sizeof(double));
    memcpy(e->tangent_at + e->size, e->results, (e->size + e->entries) * sizeof(double));
  }
}

/* The work, on a part of the last correction, of what these forces deviate from their tangent. */
static double point_deviation(const PointForces *p, const double *correction, const double *step, double part) {
  double sum = 0;
  for (const PointForce *e = p->of; e < p->of + p->all; ++e) {
    if (!e->needs_line_search) continue;
    int n = e->size, values = values_of(e);
    double *D = e->given + n, *results = p->probe, *along = results + values, *last_D = along + n;
    const double *from = e->tangent_at, *force = from + n, *slope = force + n;
    memcpy(last_D, D, n * sizeof(double));
    coordinates(e, correction, step, e->column, along);
    for (int k = 0; k < n; ++k) D[k] += (1 - part) * along[k];
    call_law(e, results);
    for (int k = 0; k < n; ++k) sum += along[k] * (results[k] - force[k]);
    for (int i = 0; i < e->entries; ++i) {
      int column = e->entry_column[i];
      sum -= along[e->entry_row[i]] * slope[i] * (D[column] - from[column]);
    }
    memcpy(D, last_D, n * sizeof(double));
  }
  return sum;
}
