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
  double rest[3];
  for (int i = 0; i < 3; ++i) {
    const double *row = group + side + i * ROW;
    rest[i] = row[3] - row[0] * x[0] - row[1] * x[1] - row[2] * x[2];
  }
  for (int i = 0; i < 3; ++i) group[i * ROW + RIGHT] = x[i] = rest[i];
}

INLINED void own_rows(const double *group, Four *own) {
  for (int i = 0; i < 3; ++i) own[i] = load(group + OWN + i * ROW);
}

/* Stores the rows of a group for further right sides, in its own place. */
INLINED void store_own(double *group, const Four *own) {
  for (int i = 0; i < 3; ++i) *(Four *)(group + OWN + i * ROW) = own[i];
}

/* Elimination for the right side `reduced`; returns 0 if a pivot is zero. Proceeds from both ends to the
   group `middle`: the processor can overlap the two divisions. With `keep` for further right sides. */
INLINED int eliminate_chain(const Problem *p, const Work *w, int middle, int keep) {
  int last = p->chain - 1, most = middle > last - middle ? middle : last - middle;
  double *A = w->tangent, none[GROUP] = {0};
  Four down[3], up[3], own[3], u[3], v[3];
  for (int i = 0; i < p->free; ++i) A[p->order[i] * ROW + RIGHT] = w->reduced[i];
  own_rows(A, down), own_rows(A + last * GROUP, up);
  for (int k = 0; k < most; ++k) {
    double *top = A + k * GROUP, *bottom = A + (last - k) * GROUP;
    if (k < middle) {
      if (!eliminate_group(down, top + AFTER, u)) return 0;
      if (keep) store_own(top, down);
      own_rows(top + GROUP, down);
      subtract_group(down, top + GROUP + BEFORE, u);
    }
    if (last - k > middle) {
      if (!eliminate_group(up, bottom + BEFORE, v)) return 0;
      if (keep) store_own(bottom, up);
      own_rows(bottom - GROUP, up);
      subtract_group(up, bottom - GROUP + AFTER, v);
    }
  }
  /* Both have the own rows of the group in the middle, with one side's contribution each. */
  own_rows(A + middle * GROUP, own);
  for (int i = 0; i < 3; ++i) own[i] = down[i] + (up[i] - own[i]);
  if (keep) store_own(A + middle * GROUP, own);
  if (!eliminate_group(own, none, u)) return 0;
  for (int i = 0; i < 3; ++i) A[middle * GROUP + i * ROW + (keep ? AFTER + 3 : RIGHT)] = u[i][3];
  return 1;
}

/* Solution for the right side `reduced`; returns 0 if a pivot is zero. */
HOT int solve_chain(const Problem *p, const Work *w) {
  int middle = p->chain / 2, last = p->chain - 1;
  double *A = w->tangent, x[3], y[3];
  if (!eliminate_chain(p, w, middle, 0)) return 0;
  for (int i = 0; i < 3; ++i) x[i] = y[i] = A[middle * GROUP + i * ROW + RIGHT];
  for (int k = 1; k <= middle; ++k) {
    substitute_group(A + (middle - k) * GROUP, AFTER, x);
    if (middle + k <= last) substitute_group(A + (middle + k) * GROUP, BEFORE, y);
  }
  for (int i = 0; i < p->free; ++i) w->step[i] = A[p->order[i] * ROW + RIGHT];
  return 1;
}

/* Rows of n columns of a group: solves its own equations, which `store_own` kept. */
INLINED void solve_group(int n, const double *group, Four *rows) {
  const double *a = group + OWN, *b = a + ROW, *c = b + ROW;
  double first = 1 / a[0], in_b = b[0] * first, in_c = c[0] * first;
  double b1 = b[1] - in_b * a[1], b2 = b[2] - in_b * a[2];
  double c1 = c[1] - in_c * a[1], c2 = c[2] - in_c * a[2];
  double second = 1 / b1, b_in_c = c1 * second, last = 1 / (c2 - b_in_c * b2);
  Four *x = rows, *y = rows + n, *z = rows + 2 * n;
  for (int j = 0; j < n; ++j) {
    Four q = y[j] - in_b * x[j];
    z[j] = (z[j] - in_c * x[j] - b_in_c * q) * last;
    y[j] = (q - b2 * z[j]) * second;
    x[j] = (x[j] - a[2] * z[j] - a[1] * y[j]) * first;
  }
}

/* Subtracts multiples of three rows of n columns, by couplings, from three others. */
INLINED void subtract_coupled(int n, const double *couplings, const Four *from, Four *to) {
  for (int i = 0; i < 3; ++i) {
    const double *k = couplings + i * ROW;
    Four *row = to + i * n;
    for (int j = 0; j < n; ++j) row[j] -= k[0] * from[j] + k[1] * from[n + j] + k[2] * from[2 * n + j];
  }
}

static int are_coupled(const double *one, const double *other) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += fabs(one[i * ROW + j]) + fabs(other[i * ROW + j]);
  return sum != 0;
}

/* The block (work.h), of n times four columns, from its right sides, after `eliminate_chain` that kept its rows. With
   `known` its first column is solved already. */
INLINED void solve_chain_columns(const Problem *p, const Work *w, int middle, int known, int n) {
  double *A = w->tangent;
  Four *block = (Four *)w->block;
  int last = p->chain - 1, most = middle > last - middle ? middle : last - middle;
  long rows = 3 * (long)n;
  for (int i = 0; i < most; ++i)
    for (int side = 0; side < 2; ++side) { /* which the processor can overlap */
      int k = side ? last - i : i, way = side ? -1 : 1, to_middle = side ? BEFORE : AFTER, back = side ? AFTER : BEFORE;
      double *group = A + k * GROUP, *next = group + way * GROUP;
      if (way * (middle - k) <= 0 || !w->reached[3 * k]) continue;
      solve_group(n, group, block + k * rows);
      for (int x = 0; known && x < 3; ++x) block[k * rows + x * n][0] = group[to_middle + x * ROW + 3];
      if (known && !are_coupled(next + back, group + to_middle)) continue;
      reach(p, w, 3 * (k + way));
      subtract_coupled(n, next + back, block + k * rows, block + (k + way) * rows);
    }
  if (w->reached[3 * middle]) {
    solve_group(n, A + middle * GROUP, block + middle * rows);
    for (int x = 0; known && x < 3; ++x) block[middle * rows + x * n][0] = A[middle * GROUP + x * ROW + AFTER + 3];
  }
  for (int i = 1; i <= most; ++i)
    for (int side = 0; side < 2; ++side) {
      int way = side ? -1 : 1, k = middle - way * i;
      if (k >= 0 && k <= last && w->reached[3 * k] && w->reached[3 * (k + way)])
        subtract_coupled(n, A + k * GROUP + (side ? BEFORE : AFTER), block + (k + way) * rows, block + k * rows);
    }
}

HOT void solve_chain_block(const Problem *p, const Work *w, int middle) {
  solve_chain_columns(p, w, middle, 1, p->block / 4);
}

/* The solution, from the first column of the block as far as it is reached. */
static void finish_chain(const Problem *p, const Work *w, int middle) {
  double *A = w->tangent, x[3];
  int n = p->block, last = p->chain - 1;
  for (int side = 0; side < 2; ++side)
    for (int k = middle; side ? k <= last : k >= 0; k += side ? 1 : -1) {
      double *group = A + k * GROUP;
      if (w->reached[3 * k])
        for (int i = 0; i < 3; ++i) group[i * ROW + RIGHT] = x[i] = w->block[(3L * k + i) * n];
      else if (k == middle)
        for (int i = 0; i < 3; ++i) group[i * ROW + RIGHT] = x[i] = group[AFTER + i * ROW + 3];
      else
        substitute_group(group, side ? BEFORE : AFTER, x);
    }
  for (int i = 0; i < p->free; ++i) w->step[i] = A[p->order[i] * ROW + RIGHT];
}
