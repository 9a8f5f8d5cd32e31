/* Work space of a run: arrays in the memory `scratch` of Problem. */

#pragma once

#include <string.h>
#include "problem.h"

/* Its arrays and their sizes, by numbers of `lay_out`: of degrees of freedom and of nodes; of columns; of joints, at both
   ends and over the step; of unknowns, which factors are made of; of loops, where `follows` has the closure that each of their
   columns follows, or -1; by position bordering columns, and where these are `reached`, and bordering rows, with the first and
   the last position of each. */
#define ARRAYS(OF)                                                                                          \
  OF(D, n + 9) OF(path, n + 9) OF(slope, n + 9) OF(acc, n) OF(f, n + 4 * LANES) OF(r, n) OF(correction, n)  \
  OF(force, n) OF(dead, n) OF(scratch, n + p->free) OF(passed, n) OF(loaded, p->sliders ? n : 0)            \
  OF(rule, p->rules ? RULE_VALUES * (long)p->nodes : 0) OF(natural_end, (long)p->cells * p->cell_natural)   \
  OF(saved, p->memory_size)                                                                                 \
  OF(reduced, c) OF(step, c) OF(z, c) OF(columns, c) OF(start, c)                                           \
  OF(values0, 1 + 4 * j) OF(values, 1 + 4 * j) OF(virtual_map, 1 + 4 * j) OF(frame, 4 * j)                  \
  OF(arm_change, 2 * j) OF(half_turn, j) OF(joint_forces, 3 * p->scene_joints) OF(y, p->positions)          \
  OF(row, p->rows ? 3 * u : 0) OF(tangent, p->stored_values + 4 * LANES) OF(residual, k) OF(proposed, k)    \
  OF(factorised, p->reused.worth && b ? p->tangent_start[p->free] : 0) OF(G, g) OF(G_virtual, g)            \
  OF(part, m ? 2 * p->block_part[p->blocks] : 0) OF(closure, m) OF(closure0, m)                             \
  OF(closure_row, m ? c : 0) OF(pivoting, p->pivoting_size) OF(closing, m)                                  \
  OF(block, (long)p->positions * p->block) OF(border, b * p->positions) OF(bordering_right, b)              \
  OF(corner, b * b) OF(corner_units, 2 * b)
/* Integers: among them the bands [blocks, 2] of factors. */
#define INTEGERS(OF)                                                                                        \
  OF(follows, p->loop_columns) OF(low, 2 * m) OF(band, 2 * p->blocks) OF(part_order, 2 * m)                 \
  OF(corner_order, b) OF(reached, p->positions) OF(crossed, 2 * b)
#define NUMBERS(name, size) double *name;
#define NUMBERED(name, size) int *name;

typedef struct {
  ARRAYS(NUMBERS)
  INTEGERS(NUMBERED)
  const double *fields[FIELDS]; /* by the kinds of Form */
  double dt;
  double *loads, *follower_force, *naturals; /* inputs of a sub-step */
  int transposed; /* whether bordering rows are those of the transposed tangent */
  int by_slopes;  /* whether elements give no tangent: it comes from their slopes (element_derivatives.h), or none is needed */
} Work;

static double *allocate(double **at, long n) {
  double *p = *at;
  *at += (n + LANES - 1) / LANES * LANES;
  return p;
}

static long lay_out(const Problem *p, Work *w, double *at) {
  double *begin = at;
  long n = p->dofs, c = p->columns + p->auxiliaries, j = p->joints, u = p->unknowns, m = p->closures, b = p->bordering_rows;
  long k = p->rows ? p->free : 0, g = m ? p->closure_start[m] : 0;
#define ALLOCATE(name, size) w->name = (void *)allocate(&at, size);
  ARRAYS(ALLOCATE)
  INTEGERS(ALLOCATE)
  const double *fields[] = {w->D, p->q, p->v, p->a, p->q_previous, p->internal, p->natural, w->natural_end};
  memcpy(w->fields, fields, sizeof fields);
  w->dt = w->transposed = w->by_slopes = 0;
  return at - begin;
}

OF_STEPS long fx_scratch(const Problem *p) {
  Work w;
  return lay_out(p, &w, 0);
}

/* The work space that a problem has. */
static Work work_of(const Problem *p) {
  Work w;
  lay_out(p, &w, p->scratch);
  return w;
}

OF_STEPS Results fx_results(const Problem *p) {
  Work w = work_of(p);
  return (Results){w.D, w.z, w.r, w.tangent, w.f, w.reduced, w.step, w.correction, w.block, w.corner, w.border, w.values,
                   w.virtual_map, w.closure, w.force, w.dead, w.natural_end, w.reached, w.crossed};
}

/* Sets rows of the block to zero that were not yet reached: one, or those of a group of a chain. */
static inline void reach(const Problem *p, const Work *w, int row) {
  int first = HAS(CHAIN) ? row / 3 * 3 : row, end = first + (HAS(CHAIN) ? 3 : 1);
  if (w->reached[row]) return;
  memset(w->block + (long)first * p->block, 0, (long)(end - first) * p->block * sizeof(double));
  for (int i = first; i < end; ++i) w->reached[i] = 1;
}
