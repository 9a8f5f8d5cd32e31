/* Directions of derivatives, changes of all numbers of a scene, of which WAYS are followed at once: what they multiply is
   computed and read once for all of them. "The change" of something is that in each direction of such a group. */

#pragma once

#include "path_derivatives.h"

/* Changes in WAYS directions. */
typedef Four Ways;

/* Changes of the numbers of a scene, those of a sub-step, and changes of the state (Directions). */
typedef struct {
  int count, changes_mass; /* directions; whether masses or weights change */
  const Ways *of_elements, *of_drag, *mass, *weight, *load_force, *points, *offset, *axis, *rest, *places;
  const Ways *natural_value, *member_number, *member_place, *member_arc;
  double *paths;
  const Ways *loads, *driven, *thrust, *parameters, *naturals;
  Ways *columns, *q, *v, *before, *internal, *spring_internal, *natural;
} Group;

static long groups_of(const Directions *d) { return (d->count + WAYS - 1) / WAYS; }

static Ways *ways_of(double *all, long size, long group) { return (Ways *)all + size * group; }

/* A group of directions in a sub-step. */
static Group group_in(const Problem *p, const Directions *d, long k, long row, long rows) {
  long n = p->dofs, step = k * rows + row, left = d->count - k * WAYS, joints = p->joints;
  return (Group){
      .count = left < WAYS ? left : WAYS,
      .changes_mass = d->changes_mass[k],
      .of_elements = ways_of(d->of_elements, d->element_numbers, k),
      .of_drag = ways_of(d->of_drag, d->drag_numbers, k),
      .mass = ways_of(d->mass, p->mass_start[n], k),
      .weight = ways_of(d->weight, n, k),
      .load_force = ways_of(d->load_force, p->load_start[p->loads], k),
      .points = ways_of(d->points, d->point_numbers, k),
      .offset = ways_of(d->offset, 2 * joints, k),
      .axis = ways_of(d->axis, 2 * joints, k),
      .rest = ways_of(d->rest, joints, k),
      .places = ways_of(d->places, 3L * p->sliders, k),
      .natural_value = ways_of(d->natural_value, p->naturals ? p->natural_start[p->naturals] : 0, k),
      .member_number = ways_of(d->member_number, d->member_numbers, k),
      .member_place = ways_of(d->member_place, n, k),
      .member_arc = ways_of(d->member_arc, d->member_arcs, k),
      .paths = d->paths + k * WAYS * path_start(p, p->sliders),
      .loads = ways_of(d->loads, 2L * p->loads, step),
      .driven = ways_of(d->driven, p->driven, step),
      .thrust = ways_of(d->thrust, 2L * p->thrusts, step),
      .parameters = ways_of(d->parameters, 2L * p->parameter_count, step),
      .naturals = ways_of(d->naturals, p->naturals, step),
      .columns = ways_of(d->columns, p->columns + p->ties, k),
      .q = ways_of(d->q, n, k),
      .v = ways_of(d->v, n, k),
      .before = ways_of(d->before, n, k),
      .internal = ways_of(d->internal, (long)p->cells * p->cell_internal, k),
      .spring_internal = ways_of(d->spring_internal, p->spring_width, k),
      .natural = ways_of(d->natural, (long)p->cells * p->cell_natural, k),
  };
}

static Ways sum_of_products(int n, const double *slopes, const Ways *x) {
  Ways sum = {0};
  for (int i = 0; i < n; ++i) sum += slopes[i] * x[i];
  return sum;
}

static Ways change_at(const Ways *q, int dof) { return dof < 0 ? (Ways){0} : q[dof]; }

/* One direction of the changes, with WAYS numbers from one change to the next. */
static double *in_way(const Ways *changes, int way) { return (double *)changes + way; }
