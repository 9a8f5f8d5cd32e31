/* LU factorisation of the reduced tangent, as a band matrix or in sparse rows (lu_layout.py). */

#pragma once

#include "algebra.h"

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

static inline int is_pivot(double x) { return fabs(x) > 1e-300; }

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

/* The same for sparse rows; `row` is the work space (free) for the current row. */
static int solve_sparse(const Problem *p, double *A, double *b, double *row) {
  const int *start = p->factor_start, *column = p->factor_column, *diagonal = p->factor_diagonal;
  for (int i = 0; i < p->free; ++i) {
    for (int k = start[i]; k < start[i + 1]; ++k) row[column[k]] = A[k];
    for (int k = start[i]; k < diagonal[i]; ++k) {
      int above = column[k];
      double factor = row[above] * A[diagonal[above]];
      for (int m = diagonal[above] + 1; m < start[above + 1]; ++m)
        row[column[m]] -= factor * A[m];
      b[i] -= factor * b[above];
    }
    if (!(fabs(row[i]) > 1e-300)) return 0;
    A[diagonal[i]] = 1 / row[i];
    for (int k = diagonal[i] + 1; k < start[i + 1]; ++k) A[k] = row[column[k]];
  }
  for (int i = p->free - 1; i >= 0; --i) {
    for (int k = diagonal[i] + 1; k < start[i + 1]; ++k) b[i] -= A[k] * b[column[k]];
    b[i] *= A[diagonal[i]];
  }
  return 1;
}

/* Constant bandwidths of beams, for which the compiler can unroll the loops. */
static int solve_reduced(const Problem *p, const Work *w) {
  switch (p->band) {
    case 0: return solve_sparse(p, w->tangent, w->y, w->row);
    case 5: return solve(p->free, 5, w->tangent, w->y); /* degree 1 */
    case 6: return solve(p->free, 6, w->tangent, w->y); /* the same with joints */
    case 8: return solve(p->free, 8, w->tangent, w->y); /* degree 2 */
    case 11: return solve(p->free, 11, w->tangent, w->y); /* degree 3 */
    default: return solve(p->free, p->band, w->tangent, w->y);
  }
}
