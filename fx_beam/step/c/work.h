/* Work space of a run: arrays in the memory `scratch` of Problem. */

#pragma once

#include <string.h>
#include "problem.h"

typedef struct {
  double *D, *path, *slope, *acc, *f, *r, *reduced, *step, *correction, *z;
  double *tangent, *inertia, *values, *virtual_map, *frame, *rho0, *t0, *rho1, *t1, *mean_t, *carrier_slope;
  double *carrier_bend, *passing, *columns, *y, *row, *start, *force, *dead, *scratch;
  double *saved, *rule, *loaded, *factors, *factorised, *residual, *direction, *image, *guess;
  double *G, *G_virtual, *part, *part_virtual, *closure, *closure0, *closure_row, *pivoting; /* of loops */
  double *closing, *closed;
  int *follows, *largest_at, *part_order, *order_virtual; /* closure that each loop column follows, or -1 */
  int *band; /* [blocks, 2] of the factors */
  double *block, *corner, *corner_units, *bordering_right; /* of bordering rows: rows of right sides by position, D, right sides */
  int *corner_order;
  int *reached, *bordering_entries;         /* rows of the block that are not zero; number of entries */
  BorderingEntry *bordering_entry;
  double *passed, *joint_forces;
  double *natural_end;
  const double *fields[FIELDS]; /* by the kinds of Form */
  double dt;
  const double *follower_force;
  int transposed; /* whether bordering rows are those of the transposed tangent */
} Work;

static double *allocate(double **at, long n) {
  double *p = *at;
  *at += (n + LANES - 1) / LANES * LANES;
  return p;
}

static long lay_out(const Problem *p, Work *w, double *at) {
  double *begin = at;
  long n = p->dofs, c = p->columns + p->auxiliaries, j = p->joints, u = p->unknowns;
  w->D = allocate(&at, n), w->path = allocate(&at, n), w->slope = allocate(&at, n);
  w->acc = allocate(&at, n), w->f = allocate(&at, n + LANES), w->r = allocate(&at, n);
  w->correction = allocate(&at, n), w->force = allocate(&at, n), w->dead = allocate(&at, n);
  w->scratch = allocate(&at, n);
  w->reduced = allocate(&at, c), w->step = allocate(&at, c), w->z = allocate(&at, c);
  w->columns = allocate(&at, c);
  w->y = allocate(&at, u), w->row = allocate(&at, p->rows.groups ? 3 * u : 0), w->start = allocate(&at, c);
  w->tangent = allocate(&at, p->stored_values + 4 * LANES), w->inertia = allocate(&at, p->stored_values);
  w->values = allocate(&at, 1 + 4 * j), w->virtual_map = allocate(&at, 1 + 4 * j);
  w->frame = allocate(&at, 4 * j), w->rho0 = allocate(&at, 2 * j), w->t0 = allocate(&at, 2 * j);
  w->rho1 = allocate(&at, 2 * j), w->t1 = allocate(&at, 2 * j), w->mean_t = allocate(&at, 2 * j);
  w->rule = allocate(&at, p->rules ? RULE_VALUES * (long)p->nodes : 0);
  w->saved = allocate(&at, p->memory_size);
  w->factors = allocate(&at, p->factor_size);
  w->factorised = allocate(&at, p->kept.worth && p->bordering_rows ? p->tangent_start[p->free] : 0);
  long d = p->kept.worth || p->changing ? DIRECTIONS : 0;
  u = p->factor_size ? p->free : 0;
  w->residual = allocate(&at, u), w->guess = allocate(&at, u);
  w->direction = allocate(&at, d * u), w->image = allocate(&at, d * u);
  w->loaded = allocate(&at, p->sliders ? n : 0);
  w->carrier_slope = allocate(&at, j), w->carrier_bend = allocate(&at, j), w->passing = allocate(&at, 2 * j);
  long m = p->closures, g = p->closures ? p->closure_start[p->closures] : 0;
  w->G = allocate(&at, g), w->G_virtual = allocate(&at, g);
  w->part = allocate(&at, p->part_size), w->part_virtual = allocate(&at, p->part_size);
  w->closure = allocate(&at, m), w->closure0 = allocate(&at, m), w->closure_row = allocate(&at, m ? c : 0);
  w->pivoting = allocate(&at, p->pivoting_size);
  w->closing = allocate(&at, m), w->closed = allocate(&at, m ? n : 0);
  w->follows = (int *)allocate(&at, p->loop_columns), w->largest_at = (int *)allocate(&at, 3 * m);
  w->band = (int *)allocate(&at, 2 * p->blocks);
  w->part_order = (int *)allocate(&at, m), w->order_virtual = (int *)allocate(&at, m);
  long b = p->bordering_rows;
  w->block = allocate(&at, (long)p->positions * p->block);
  w->corner = allocate(&at, b * b), w->corner_units = allocate(&at, 2 * b), w->bordering_right = allocate(&at, b);
  w->corner_order = (int *)allocate(&at, b);
  w->reached = (int *)allocate(&at, p->positions), w->bordering_entries = (int *)allocate(&at, 1);
  w->bordering_entry = (BorderingEntry *)allocate(&at, 2 * (long)p->most_bordering_entries);
  w->passed = allocate(&at, n), w->joint_forces = allocate(&at, 3 * p->scene_joints);
  w->natural_end = allocate(&at, (long)p->cells * p->cell_natural);
  const double *fields[] = {w->D, p->q, p->v, p->a, p->q_previous, p->internal, p->natural, w->natural_end};
  memcpy(w->fields, fields, sizeof fields);
  w->transposed = 0;
  return at - begin;
}

OF_STEPS long fx_scratch(const Problem *p) {
  Work w;
  return lay_out(p, &w, 0);
}

/* Sets rows of the block to zero that were not yet reached: one, or those of a group of a chain. */
static inline void reach(const Problem *p, const Work *w, int row) {
  int first = HAS(CHAIN) ? row / 3 * 3 : row, end = first + (HAS(CHAIN) ? 3 : 1);
  if (w->reached[row]) return;
  memset(w->block + (long)first * p->block, 0, (long)(end - first) * p->block * sizeof(double));
  for (int i = first; i < end; ++i) w->reached[i] = 1;
}
