/* Gaussian elimination of the reduced tangent of a chain, in groups of three unknowns, usually those of
   a node: each is coupled with the ones before and after it (lu_layout.py). */

#pragma once

#include "algebra.h"
#include "sparse_lu.h"

/* Row of an unknown: three couplings with the group before, with its own and with the group after, each
   followed by a free place. The right side, later the solution, is behind the own ones. */
enum { BEFORE = 0, OWN = 4, AFTER = 8, ROW = 12, GROUP = 3 * ROW, RIGHT = OWN + 3 };

INLINED Four load(const double *from) { return *(const Four *)from; }

/* Solves the equations of a group, with these own rows and right sides, for its unknowns. They depend on
   those of the group with these couplings: its factors, and behind them the part without it, take the
   place of the couplings and are returned in u. Returns 0 if a pivot is zero. */
INLINED int eliminate_group(const Four *own, double *couplings, Four *u) {
  Four a = own[0], b = own[1], c = own[2], row[3];
  for (int i = 0; i < 3; ++i) row[i] = load(couplings + i * ROW), row[i][3] = own[i][3];
  double first = 1 / a[0], in_b = b[0] * first, in_c = c[0] * first;
  double b1 = b[1] - in_b * a[1], b2 = b[2] - in_b * a[2];
  double c1 = c[1] - in_c * a[1], c2 = c[2] - in_c * a[2];
  double second = 1 / b1, b_in_c = c1 * second, last = c2 - b_in_c * b2;
  if (!is_pivot(a[0]) || !is_pivot(b1) || !is_pivot(last)) return 0;
  row[1] -= in_b * row[0];
  row[2] -= in_c * row[0] + b_in_c * row[1];
  u[2] = row[2] * (1 / last);
  u[1] = (row[1] - b2 * u[2]) * second;
  u[0] = (row[0] - a[2] * u[2] - a[1] * u[1]) * first;
  for (int i = 0; i < 3; ++i) *(Four *)(couplings + i * ROW) = u[i];
  return 1;
}

/* Subtracts an eliminated group from the own rows of one that is coupled with it. */
INLINED void subtract_group(Four *own, const double *couplings, const Four *u) {
  for (int i = 0; i < 3; ++i) {
    const double *k = couplings + i * ROW;
    own[i] -= k[0] * u[0] + k[1] * u[1] + k[2] * u[2];
  }
}

/* The unknowns of a group from those of the group on this side, which was eliminated later. */
INLINED void substitute_group(double *group, int side, double *x) {
  double found[3];
  for (int i = 0; i < 3; ++i) {
    const double *row = group + side + i * ROW;
    found[i] = row[3] - row[0] * x[0] - row[1] * x[1] - row[2] * x[2];
  }
  for (int i = 0; i < 3; ++i) group[i * ROW + RIGHT] = x[i] = found[i];
}

INLINED void own_rows(const double *group, Four *own) {
  for (int i = 0; i < 3; ++i) own[i] = load(group + OWN + i * ROW);
}

/* Solution for the right side `reduced`; returns 0 if a pivot is zero. Proceeds from both ends to the
   middle: the processor can overlap the two divisions. */
static int solve_chain(const Problem *p, const Work *w) {
  int middle = p->chain / 2, last = p->chain - 1;
  double *A = w->tangent, none[GROUP] = {0}, x[3], y[3];
  Four down[3], up[3], own[3], u[3], v[3];
  for (int i = 0; i < p->free; ++i) A[p->order[i] * ROW + RIGHT] = w->reduced[i];
  own_rows(A, down), own_rows(A + last * GROUP, up);
  for (int k = 0; k < middle; ++k) {
    double *top = A + k * GROUP, *bottom = A + (last - k) * GROUP;
    if (!eliminate_group(down, top + AFTER, u)) return 0;
    own_rows(top + GROUP, down);
    subtract_group(down, top + GROUP + BEFORE, u);
    if (last - k == middle) break;
    if (!eliminate_group(up, bottom + BEFORE, v)) return 0;
    own_rows(bottom - GROUP, up);
    subtract_group(up, bottom - GROUP + AFTER, v);
  }
  /* Both have the own rows of the group in the middle, with one side's contribution each. */
  own_rows(A + middle * GROUP, own);
  for (int i = 0; i < 3; ++i) own[i] = down[i] + (up[i] - own[i]);
  if (!eliminate_group(own, none, u)) return 0;
  for (int i = 0; i < 3; ++i) A[middle * GROUP + i * ROW + RIGHT] = x[i] = y[i] = u[i][3];
  for (int k = 1; k <= middle; ++k) {
    substitute_group(A + (middle - k) * GROUP, AFTER, x);
    if (middle + k <= last) substitute_group(A + (middle + k) * GROUP, BEFORE, y);
  }
  for (int i = 0; i < p->free; ++i) w->step[i] = A[p->order[i] * ROW + RIGHT];
  return 1;
}
