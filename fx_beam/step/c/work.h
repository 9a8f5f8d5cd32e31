/* Work space of a run: arrays in the memory `scratch` of Problem. */

#pragma once

#include <string.h>
#include "narrow_factors.h"
#include "problem.h"

/* Arrays of Work and their sizes, by numbers of `lay_out`: of degrees of freedom and of nodes; of columns; of joints, at both
   ends and over the step; of loops, where `follows` has the closure that each of their
   columns follows, or -1, and pivot rows are sparse; by position bordering columns, and where these are `reached`, and bordering rows, with the first and
   the last position of each. */
#define ARRAYS(OF)                                                                                               \
  OF(D, n + 9) OF(path, n + 9) OF(slope, n + 9) OF(acc, n) OF(f, n + 4 * LANES) OF(r, n) OF(correction, n)       \
  OF(force, n) OF(dead, n) OF(scratch, n + p->free) OF(passed, n) OF(loaded, p->sliders.count ? n : 0)           \
  OF(rule, p->scheme.rules ? RULE_VALUES * (long)p->mesh.nodes : 0)                                              \
  OF(natural_end, (long)p->cells * p->natural.per_cell)                                                          \
  OF(saved, p->state.size)                                                                                       \
  OF(reduced, c) OF(step, c) OF(z, c) OF(columns, c) OF(start, c)                                                \
  OF(values0, t) OF(values, t) OF(virtual_map, t) OF(frame, 4 * j)                                               \
  OF(arm_change, 2 * j) OF(half_turn, j) OF(joint_forces, 3 * p->passes.joints) OF(y, p->system.positions)       \
  OF(row, p->system.rows ? 3 * p->system.positions * larger(p->system.rows->threads, 1) : 0)                      \
  OF(tangent, p->tangent.stored + 36 * LANES) OF(residual, k) OF(proposed, k)                                     \
  OF(factorised, p->system.reused.worth && b ? p->system.tangent_start[p->free] : 0) OF(G, g) OF(G_virtual, g)   \
  OF(part, m ? 2 * p->loops.block_part[p->loops.blocks] : 0) OF(closure, m) OF(closure0, m)                      \
  OF(closure_row, m ? c : 0) OF(pivoting, p->loops.pivoting_size) OF(closing, m)                                 \
  OF(block, (long)p->system.positions * p->border.block) OF(border, b * p->system.positions)                     \
  OF(bordering_right, b)                                                                                         \
  OF(corner, b * b) OF(corner_units, 2 * b)
/* Number of the values of T or Tv of joints and gears, with the constant 1. */
static inline int values_of_joints(const Problem *p) { return 1 + 4 * p->joints.count + p->gears.count; }

/* Integers: among them the bands [blocks, 2] of factors. */
#define INTEGERS(OF)                                                                                             \
  OF(follows, p->loops.columns) OF(pivot_row, m + 1) OF(pivot_column, p->loops.pivoting_size)                    \
  OF(touched, 2 * p->loops.columns) OF(band, 2 * p->loops.blocks) OF(exchanged, 2 * m)                            \
  OF(corner_exchanged, b) OF(reached, p->system.positions) OF(crossed, 2 * b)
#define NUMBERS(name, size) double *name;
#define NUMBERED(name, size) int *name;

typedef struct {
  ARRAYS(NUMBERS)
  INTEGERS(NUMBERED)
  Narrow narrow;
  const double *fields[FIELDS]; /* by the kinds of Form */
  double dt;
  double *loads, *follower_force, *naturals; /* inputs of a sub-step */
  int transposed; /* whether bordering rows are those of the transposed tangent */
  int slopes_only;  /* whether elements give no tangent: it comes from their slopes (element_derivatives.h), or none is needed */
} Work;

/* Whether factors that serve several steps have a narrow copy: those of large systems. */
static int has_narrow(const Problem *p) {
  return p->system.rows && p->system.rows->parts && p->system.reused.worth && !p->border.rows;
}

static double *allocate(double **at, long n) {
  double *p = *at;
  *at += (n + LANES - 1) / LANES * LANES;
  return p;
}

static long lay_out(const Problem *p, Work *w, double *at) {
  double *begin = at;
  long n = p->dofs, c = p->columns + p->auxiliary.count, j = p->joints.count,
      m = p->loops.closures, b = p->border.inside ? 0 : p->border.rows, t = values_of_joints(p);
  long k = p->system.rows ? p->free : 0, g = m ? p->loops.start[m] : 0;
#define ALLOCATE(name, size) w->name = (void *)allocate(&at, size);
  ARRAYS(ALLOCATE)
  INTEGERS(ALLOCATE)
  if (has_narrow(p)) { /* lower columns are less than half of all entries, and so are upper ones: there is room for one more */
    const SparseRows *rows = p->system.rows;
    long half = rows->start[rows->unknowns] / (rows->symmetric ? 2 : 4) + 2;
    w->narrow.lower = (float *)allocate(&at, half), w->narrow.upper = (float *)allocate(&at, half);
    w->narrow.lower_at = (int *)allocate(&at, rows->groups), w->narrow.upper_at = (int *)allocate(&at, rows->groups);
    w->narrow.own = allocate(&at, 9L * rows->groups);
  }
  const double *fields[] = {w->D, p->state.q, p->state.v, p->state.a, p->state.q_previous, p->state.internal,
      p->state.natural, w->natural_end};
  memcpy(w->fields, fields, sizeof fields);
  w->dt = w->transposed = w->slopes_only = 0;
  return at - begin;
}

OF_STEPS long fx_scratch(const Problem *p) {
  Work w;
  return lay_out(p, &w, 0);
}

/* The work space that a problem has. */
static Work work_of(const Problem *p) {
  Work w;
  lay_out(p, &w, p->run.scratch);
  return w;
}

OF_STEPS Results fx_results(const Problem *p) {
  Work w = work_of(p);
  return (Results){w.D, w.z, w.r, w.tangent, w.f, w.reduced, w.step, w.correction, w.values, w.virtual_map, w.closure,
                   w.force, w.dead, w.natural_end};
}

/* Sets rows of the block to zero that were not yet reached: one, or those of a group of a chain. */
static inline void reach(const Problem *p, const Work *w, int row) {
  int first = HAS(CHAIN) ? row / 3 * 3 : row, end = first + (HAS(CHAIN) ? 3 : 1);
  if (w->reached[row]) return;
  memset(w->block + (long)first * p->border.block, 0, (long)(end - first) * p->border.block * sizeof(double));
  for (int i = first; i < end; ++i) w->reached[i] = 1;
}
