/* LU factorisation of the reduced tangent as a band matrix (lu_layout.py). */

#pragma once

#include "algebra.h"
#include "sparse_lu.h"

/* Eliminates a column from the next `reach` rows, downwards (way 1) or upwards (way -1). */
INLINED void eliminate(int band, int reach, int way, double *restrict pivot, double *restrict b) {
  double inverse = pivot[0] = 1 / pivot[0], above = b[0];
#pragma GCC unroll 12
  for (int i = 1; i <= reach; ++i) {
    double *restrict row = pivot + way * i * 2 * band;
    double factor = row[0] * inverse;
#pragma GCC unroll 12
    for (int j = 1; j <= reach; ++j) row[way * j] -= factor * pivot[way * j];
    b[way * i] -= factor * above;
  }
}

/* Unknown of a row from the next `reach` unknowns; the nearest last, since it is the latest result. */
INLINED void substitute(int reach, int way, const double *restrict row, double *restrict b) {
  double sum = b[0];
#pragma GCC unroll 12
  for (int j = reach; j > 0; --j) sum -= row[way * j] * b[way * j];
  b[0] = sum * row[0];
}

/* LU factorisation in place without pivoting, and the solution in place of b; returns 0 if a pivot is
   zero. Proceeds from both ends to the middle: the processor can overlap the two divisions. */
INLINED int solve(int n, int band, double *A, double *b) {
  int half = n > 4 * band ? n / 2 - band : 0, last = n - 1 - half;
  long row = 2 * band + 1;
  double *top = A + band, *bottom = A + band + (n - 1) * row, *end = b + n - 1;
  for (int k = 0; k < half; ++k) {
    if (!is_pivot(top[k * row]) || !is_pivot(bottom[-k * row])) return 0;
    eliminate(band, band, 1, top + k * row, b + k);
    eliminate(band, band, -1, bottom - k * row, end - k);
  }
  for (int k = half; k <= last; ++k) {
    if (!is_pivot(top[k * row])) return 0;
    /* Separate, so that the loops have a constant length except at the end. */
    if (k + band <= last)
      eliminate(band, band, 1, top + k * row, b + k);
    else
      eliminate(band, last - k, 1, top + k * row, b + k);
  }
  for (int k = last; k >= half; --k)
    if (k + band <= last)
      substitute(band, 1, top + k * row, b + k);
    else
      substitute(last - k, 1, top + k * row, b + k);
  for (int k = half - 1; k >= 0; --k) {
    substitute(band, 1, top + k * row, b + k);
    substitute(band, -1, bottom - k * row, end - k);
  }
  return 1;
}

/* Solution by a band matrix, with constant bandwidths of beams, for which the compiler can unroll the
   loops. */
static int solve_band(const Problem *p, const Work *w) {
  switch (p->band) {
    case 5: return solve(p->free, 5, w->tangent, w->y); /* degree 1 with joints */
    case 6: return solve(p->free, 6, w->tangent, w->y);
    case 8: return solve(p->free, 8, w->tangent, w->y); /* degree 2 */
    case 11: return solve(p->free, 11, w->tangent, w->y); /* degree 3 */
    default: return solve(p->free, p->band, w->tangent, w->y);
  }
}
