/* Where the arrays of Work are in one piece of memory. */

#pragma once

#include <string.h>
#include "narrow_factors.h"
#include "problem.h"

/* Number of the values of T or Tv of joints and gears, with the constant 1. */
static inline int values_of_joints(const Tables *p) { return 1 + 4 * p->joints.count + p->gears.count; }

/* Whether factors that serve several steps have a narrow copy: those of large systems. */
static int has_narrow(const Border *border, const Factors *factors) {
  return factors->rows && factors->rows->parts && factors->reused.worth && !border->rows;
}

static void *allocate(double **at, long n) {
  double *memory = *at;
  *at += (n + LANES - 1) / LANES * LANES;
  return memory;
}

/* Places the arrays of Work in memory, or without it only returns how many numbers they need. */
OF_STEPS long fx_lay_out(Problem *problem, double *memory) {
  const Tables *p = problem->tables;
  Work *w = &problem->work, *to = memory ? w : &(Work){0};
  double *at = memory;
  const SparseRows *rows = w->factors.rows;
  long n = p->dofs, c = p->columns + p->auxiliary.count, j = p->joints.count, m = p->loops.closures, positions = p->system.positions;
  long b = p->border.inside ? 0 : p->border.rows, t = values_of_joints(p), k = rows ? p->free : 0, g = m ? p->loops.start[m] : 0;
#define PLACE(name, size) to->name = allocate(&at, size)
  PLACE(D, n + 9), PLACE(path, n + 9), PLACE(slope, n + 9), PLACE(acc, n), PLACE(f, n + 4 * LANES), PLACE(r, n), PLACE(correction, n);
  PLACE(force, n), PLACE(dead, n), PLACE(scratch, n + p->free), PLACE(passed, n), PLACE(loaded, p->sliders.count ? n : 0);
  PLACE(rule, p->scheme.rules ? RULE_VALUES * (long)p->mesh.nodes : 0);
  PLACE(natural_end, (long)p->cells * p->natural.per_cell), PLACE(saved, w->state.size);
  PLACE(reduced, c), PLACE(step, c), PLACE(z, c), PLACE(columns, c), PLACE(start, c), PLACE(values0, t), PLACE(values, t);
  PLACE(virtual_map, t), PLACE(frame, 4 * j), PLACE(arm_change, 2 * j), PLACE(half_turn, j), PLACE(joint_forces, 3 * p->passes.joints);
  PLACE(y, positions), PLACE(row, rows ? 3 * positions * larger(rows->threads, 1) : 0), PLACE(tangent, p->tangent.stored + 36 * LANES);
  PLACE(residual, k), PLACE(proposed, k), PLACE(factorised, w->factors.reused.worth && b ? p->system.tangent_start[p->free] : 0);
  PLACE(G, g), PLACE(G_virtual, g), PLACE(part, m ? 2 * p->loops.block_part[p->loops.blocks] : 0), PLACE(closure, m);
  PLACE(closure0, m), PLACE(closure_row, m ? c : 0), PLACE(pivoting, p->loops.pivoting_size), PLACE(closing, m);
  PLACE(block, positions * p->border.block), PLACE(border, b * positions), PLACE(bordering_right, b);
  PLACE(corner, b * b), PLACE(corner_units, 2 * b);
  PLACE(follows, p->loops.columns), PLACE(pivot_row, m + 1), PLACE(pivot_column, p->loops.pivoting_size);
  PLACE(touched, 2 * p->loops.columns), PLACE(band, 2 * p->loops.blocks), PLACE(exchanged, 2 * m);
  PLACE(corner_exchanged, b), PLACE(reached, positions), PLACE(crossed, 2 * b);
  if (has_narrow(&p->border, &w->factors)) {
    /* Lower columns are less than half of all entries, and so are upper ones: there is room for one more */
    long half = rows->start[rows->unknowns] / (rows->symmetric ? 2 : 4) + 2;
    PLACE(narrow.lower, half), PLACE(narrow.upper, half), PLACE(narrow.lower_at, rows->groups), PLACE(narrow.upper_at, rows->groups);
    PLACE(narrow.own, 9L * rows->groups);
  }
  const double *fields[] = {to->D, w->state.q, w->state.v, w->state.a, w->state.q_previous, w->state.internal, w->state.natural,
      to->natural_end};
  memcpy(to->fields, fields, sizeof fields);
  return at - memory;
}

/* Sets rows of the block to zero that were not yet reached: one, or those of a group of a chain. */
static inline void reach(const Border *border, const Work *w, int row) {
  int first = HAS(CHAIN) ? row / 3 * 3 : row, end = first + (HAS(CHAIN) ? 3 : 1);
  if (w->reached[row]) return;
  memset(w->block + (long)first * border->block, 0, (long)(end - first) * border->block * sizeof(double));
  for (int i = first; i < end; ++i) w->reached[i] = 1;
}
