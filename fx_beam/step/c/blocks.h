/* A sub-step that is linearised (docs/theory/derivatives.md): one vector x of named arrays (Layout), and the local
   Jacobians of all laws between them, in the order in which they are evaluated. Changes go through them forwards,
   derivatives backwards: a law is derived once, by a function that puts its Jacobian into a block. */

#pragma once

#include <stdlib.h>
#include "sliders.h"

/* Changes in GROUP_SIZE directions. */
typedef Four Changes;

/* An entry of a Jacobian: the number `to` changes by `slope` times the change of `from`. */
typedef struct { int from, to; double slope; } Entry;

/* Laws that are evaluated one after the other: entries, or tables that a scene has already, of which slopes are signs times
   `values`, or 1 for copies. */
typedef struct {
  Entry *entry; long count, room; const int *from, *to, *value; const double *sign, *values;
  int source_array, target_array; /* where the arrays of `from` and `to` begin */
  int lacks_memory;
} Block;

/* Index of a number of an array; -1 of none, for the ground. */
static inline int in(int array, int i) { return i < 0 ? -1 : array + i; }

static inline void put(Block *b, int from, int to, double slope) {
  if (from < 0 || to < 0 || slope == 0) return;
  if (b->count == b->room) {
    Entry *longer = realloc(b->entry, (2 * b->room + 64) * sizeof(Entry));
    if (!longer) b->lacks_memory = 1;
    if (!longer) return;
    b->entry = longer, b->room = 2 * b->room + 64;
  }
  b->entry[b->count++] = (Entry){from, to, slope};
}

static inline double slope_in(const Block *b, long k) { return b->value ? b->sign[k] * b->values[b->value[k]] : 1; }

static void jvp(const Block *b, Changes *x) {
  Changes *to = x + b->target_array, *from = x + b->source_array;
  if (b->from) for (long k = 0; k < b->count; ++k) to[b->to[k]] += slope_in(b, k) * from[b->from[k]];
  else for (const Entry *e = b->entry; e < b->entry + b->count; ++e) x[e->to] += e->slope * x[e->from];
}

static void vjp(const Block *b, double *x) {
  double *to = x + b->target_array, *from = x + b->source_array;
  if (b->from) for (long k = b->count; k-- > 0;) from[b->from[k]] += slope_in(b, k) * to[b->to[k]];
  else for (const Entry *e = b->entry + b->count; e-- > b->entry;) x[e->from] += e->slope * x[e->to];
}

/* Room between large arrays, so that their distance is no multiple of a page of memory: a read waits for an earlier write at
   the same place of another page. */
enum { SPACING = 40 };

/* Numbers of a node that slides between its laws: weights N at both ends, those of the virtual slide,
   Nbar_a k(x_a - y) cos x_a; of these the sum; the axis; differences with the weights of the virtual slide, Dalpha, forces
   on the chord; y and y_c. */
enum {
  AT, ALONG = AT + 2 * WINDOW_NODES, PARTS = ALONG + 2 * WINDOW_NODES, TOTAL = PARTS + WINDOW_NODES, AXIS,
  APART = AXIS + 3, TURN = APART + 2, ON_CHORD, MEAN_TURN = ON_CHORD + 2, NODE_TURN, SLIDE_NUMBERS };

static Layout layout_of(const Tables *p, const PointForces *points, const Work *w, const Derivatives *a) {
  Layout l;
  int next = 0, n = p->dofs, joints = p->joints.count;
  int columns = p->columns + p->auxiliary.count;
  int internal = p->cells * p->internal.per_cell, natural = p->cells * p->natural.per_cell;
#define ARRAY(name, size) l.name = next, next += size
  ARRAY(mass, 3 * p->mass.start[p->mesh.nodes]), ARRAY(weight, n), ARRAY(columns, p->loads.start[p->loads.count]),
      ARRAY(points, a->point_numbers);
  ARRAY(natural_columns, p->natural.count ? p->natural.start[p->natural.count] : 0), ARRAY(offset, 2 * joints);
  ARRAY(axis, 2 * joints), ARRAY(rest, joints), ARRAY(gears, p->gears.count / 2 * 3), ARRAY(places, 3 * p->sliders.count), ARRAY(paths, p->sliders.path_numbers);
  ARRAY(members, a->member_numbers), ARRAY(member_places, n);
  ARRAY(internal_forces, p->cells * a->internal_forces.element_numbers), ARRAY(drag, p->cells * a->drag.element_numbers);
  ARRAY(Y, columns), ARRAY(q, n), ARRAY(v, n), ARRAY(q_previous, n);
  ARRAY(natural, natural), ARRAY(internal, internal), ARRAY(spring_internal, p->at_points.spring_width);
  ARRAY(loads, 2 * p->loads.count), ARRAY(driven, p->driven), ARRAY(follower_force, 2 * p->loads.follower_forces);
  ARRAY(parameters, 2 * p->parameters.count), ARRAY(naturals, p->natural.count), ARRAY(hold, w->statics.holds);
  ARRAY(Y1, columns + SPACING), ARRAY(q1, n), ARRAY(arms, 2 * joints), ARRAY(slides, SLIDE_NUMBERS * p->sliders.count);
  ARRAY(natural1, natural), ARRAY(internal1, internal), ARRAY(springs1, p->at_points.spring_width), ARRAY(map, values_of_joints(p));
  ARRAY(held, 3 * p->sliders.count), next += SPACING, ARRAY(r, n), next += SPACING, ARRAY(R, columns > n ? columns : n);
  ARRAY(closures, p->loops.closures), ARRAY(closing, p->loops.closures);
  ARRAY(pushed, p->loops.carried ? columns : 0), ARRAY(carried, p->loops.carried ? n : 0);
  ARRAY(moments, p->passes.joints), ARRAY(forces, 3 * p->passes.joints), ARRAY(axes, 2 * p->sliders.count);
  ARRAY(followed, points->followed.size), ARRAY(nowhere, 4 * LANES), ARRAY(size, 0);
#undef ARRAY
  return l;
}

KEPT Layout fx_layout(const Problem *problem, const Derivatives *a) {
  return layout_of(problem->tables, problem->numbers.points, &problem->work, a);
}
