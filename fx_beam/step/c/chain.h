/* Gaussian elimination of the reduced tangent of a chain, in groups of three unknowns, usually those of
   a node: each is coupled with the ones before and after it (sparse_lu.py). */

#pragma once

#include "algebra.h"
#include "sparse_lu.h"

/* Row of an unknown: three couplings with the group before, with its diagonal and with the group after, each
   followed by a free place. */
enum { BEFORE = 0, DIAGONAL = 4, AFTER = 8, GROUP = 3 * ROW };

/* Solves the equations of a group with these diagonal rows, for three rows of right sides. Rows are multiplied by pivots, not
   divided by them, so that no division waits for another one. The solution is not finite if a pivot is zero; what is returned is
   not if a pivot is not finite, to which the solution is zero. */
INLINED double solve_group(const Four *diagonal, Four *rows) {
  Four a = diagonal[0], b = diagonal[1], c = diagonal[2], x = rows[0], y = rows[1], z = rows[2];
  double first = 1 / a[0], b1 = a[0] * b[1] - b[0] * a[1], b2 = a[0] * b[2] - b[0] * a[2];
  double c1 = a[0] * c[1] - c[0] * a[1], c2 = a[0] * c[2] - c[0] * a[2];
  double second = 1 / b1, pivots = b1 * c2 - c1 * b2, third = 1 / pivots;
  y = a[0] * y - b[0] * x, z = a[0] * z - c[0] * x;
  rows[2] = z = (b1 * z - c1 * y) * third;
  rows[1] = y = y * second - b2 * second * z;
  rows[0] = x * first - a[2] * first * z - a[1] * first * y;
  return pivots;
}

/* Solves the equations of a group, with these diagonal rows and right sides, for its unknowns. They depend on
   those of the group with these couplings: its factors, and behind them the part without it, take the
   place of the couplings and are in u. Returns what `solve_group` does. */
INLINED double eliminate_group(const Four *diagonal, double *couplings, Four *u) {
  for (int i = 0; i < 3; ++i) u[i] = PICK(load(couplings + i * ROW), diagonal[i], 0, 1, 2, 7);
  double pivots = solve_group(diagonal, u);
  for (int i = 0; i < 3; ++i) *(Four *)(couplings + i * ROW) = u[i];
  return pivots;
}

/* Subtracts an eliminated group from the diagonal rows of one that is coupled with it. */
INLINED void subtract_group(Four *diagonal, const double *couplings, const Four *u) {
  for (int i = 0; i < 3; ++i) {
    const double *k = couplings + i * ROW;
    diagonal[i] = diagonal[i] - k[2] * u[2] - k[1] * u[1] - k[0] * u[0]; /* in the order in which they are known */
  }
}

/* Own rows of a group, with their right sides. */
INLINED void diagonal_rows(const Work *w, int k, Four *diagonal) {
  const double *y = w->y + 3 * k;
  for (int i = 0; i < 3; ++i) diagonal[i] = PICK(load(w->tangent + k * GROUP + DIAGONAL + i * ROW), (Four){y[i]}, 0, 1, 2, 4);
}

/* Stores the inverse of the rows of a group for further right sides, in its diagonal place. */
INLINED void store_inverse(double *group, const Four *diagonal) {
  Four inverse[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  solve_group(diagonal, inverse);
  for (int i = 0; i < 3; ++i) *(Four *)(group + DIAGONAL + i * ROW) = inverse[i];
}

/* Eliminates a group, whose diagonal rows become those of the next one in this way: 1 down, -1 up. Returns what `solve_group` does. */
INLINED double eliminate_next(const Work *w, int k, int way, int keep, Four *diagonal) {
  double *group = w->tangent + k * GROUP;
  Four u[3];
  if (keep) store_inverse(group, diagonal);
  double pivots = eliminate_group(diagonal, group + (way > 0 ? AFTER : BEFORE), u);
  diagonal_rows(w, k + way, diagonal);
  subtract_group(diagonal, group + way * GROUP + (way > 0 ? BEFORE : AFTER), u);
  return pivots;
}

/* Elimination for the right side y; returns 0 if a pivot is zero. Proceeds from both ends to the group `middle`, of which
   y becomes the solution: the processor can overlap the divisions. With `keep` for further right sides. Zero times all pivots
   is `finite` in Newton's method, not a number if one is infinite. */
INLINED int eliminate_chain(const System *system, Work *w, int middle, int keep) {
  int last = system->chain - 1;
  double finite = 0;
  double none[GROUP] = {0};
  Four down[3], up[3], diagonal[3], u[3];
  diagonal_rows(w, 0, down), diagonal_rows(w, last, up);
  for (int k = 0; k < middle || k < last - middle; ++k) {
    if (k < middle) finite += 0 * eliminate_next(w, k, 1, keep, down);
    if (k < last - middle) finite += 0 * eliminate_next(w, last - k, -1, keep, up);
  }
  /* Both have the diagonal rows of the group in the middle, with one side's contribution each. */
  diagonal_rows(w, middle, diagonal);
  for (int i = 0; i < 3; ++i) diagonal[i] = up[i] + (down[i] - diagonal[i]);
  if (keep) store_inverse(w->tangent + middle * GROUP, diagonal);
  w->newton.finite = finite + 0 * eliminate_group(diagonal, none, u);
  for (int i = 0; i < 3; ++i) w->y[3 * middle + i] = u[i][3];
  return isfinite(u[0][3]); /* any zero pivot comes down to it */
}

/* The unknowns of a group from those x of the group on this side, which was eliminated later; or as they are, as in
   `substitute_chain`. */
INLINED void substitute_group(const Work *w, int k, int side, const int *reached, int now, double *x) {
  const double *row = w->tangent + k * GROUP + side;
  double *y = w->y + 3 * k, rest[3];
  for (int i = 0; i < 3; ++i, row += ROW) rest[i] = row[3] - row[0] * x[0] - (row[1] * x[1] + row[2] * x[2]);
  for (int i = 0; i < 3; ++i) y[i] = x[i] = reached && reached[3 * k] != now ? y[i] : rest[i];
}

/* The solution in place of y, from that of the group in the middle: only of groups that are `reached` or not, if it is given. */
INLINED void substitute_chain(const System *system, const Work *w, int middle, const int *reached, int now) {
  int last = system->chain - 1;
  double x[3], z[3];
  for (int i = 0; i < 3; ++i) x[i] = z[i] = w->y[3 * middle + i];
  for (int k = 1; k <= middle || k <= last - middle; ++k) {
    if (k <= middle) substitute_group(w, middle - k, AFTER, reached, now, x);
    if (k <= last - middle) substitute_group(w, middle + k, BEFORE, reached, now, z);
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

/* Multiplies three rows of n columns by the inverse of a group. */
INLINED void solve_by_inverse(int n, const double *group, Four *rows) {
  Four *x = rows, *y = rows + n, *z = rows + 2 * n;
  const double *a = group + DIAGONAL, *b = a + ROW, *c = b + ROW;
  for (int j = 0; j < n; ++j) {
    Four right[] = {x[j], y[j], z[j]};
    x[j] = a[0] * right[0] + a[1] * right[1] + a[2] * right[2];
    y[j] = b[0] * right[0] + b[1] * right[1] + b[2] * right[2];
    z[j] = c[0] * right[0] + c[1] * right[1] + c[2] * right[2];
  }
}

static int are_coupled(const double *one, const double *other) {
  double sum = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) sum += fabs(one[i * ROW + j]) + fabs(other[i * ROW + j]);
  return sum != 0;
}

/* The block (room.h), of n times four columns, from its right sides, after `eliminate_chain` that kept its rows. */
INLINED void solve_chain_columns(const Tables *p, const Work *w, int middle, int n) {
  double *A = w->tangent;
  Four *block = (Four *)w->block;
  int last = p->system.chain - 1, most = middle > last - middle ? middle : last - middle;
  long rows = 3 * (long)n;
  for (int i = 0; i < most; ++i)
    for (int side = 0; side < 2; ++side) { /* which the processor can overlap */
      int k = side ? last - i : i, way = side ? -1 : 1, to_middle = side ? BEFORE : AFTER, back = side ? AFTER : BEFORE;
      double *group = A + k * GROUP, *next = group + way * GROUP;
      if (way * (middle - k) <= 0 || !w->reached[3 * k]) continue;
      solve_by_inverse(n, group, block + k * rows);
      if (!w->reached[3 * (k + way)] && !are_coupled(next + back, group + to_middle)) continue;
      reach(&p->border, w, 3 * (k + way));
      subtract_coupled(n, next + back, block + k * rows, block + (k + way) * rows);
    }
  if (w->reached[3 * middle]) solve_by_inverse(n, A + middle * GROUP, block + middle * rows);
  for (int i = 1; i <= most; ++i)
    for (int side = 0; side < 2; ++side) {
      int way = side ? -1 : 1, k = middle - way * i;
      if (k >= 0 && k <= last && w->reached[3 * k] && w->reached[3 * (k + way)])
        subtract_coupled(n, A + k * GROUP + (side ? BEFORE : AFTER), block + (k + way) * rows, block + k * rows);
    }
}
