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

/* Subtracts multiples of three rows from three others. */
INLINED void subtract_rows(int n, double (*f)[3], const double *const *from, double *const *to) {
  const double *restrict a = from[0], *restrict b = from[1], *restrict c = from[2];
  double *restrict x = to[0], *restrict y = to[1], *restrict z = to[2];
  for (int k = 0; k < n; ++k) {
    double p = a[k], q = b[k], r = c[k];
    x[k] -= f[0][0] * p + f[0][1] * q + f[0][2] * r;
    y[k] -= f[1][0] * p + f[1][1] * q + f[1][2] * r;
    z[k] -= f[2][0] * p + f[2][1] * q + f[2][2] * r;
  }
}

/* The same for sparse rows, in groups of up to three with equal columns, usually those of a node.
   `rows` is the work space (3, free) for the current group. */
static int solve_sparse(const Problem *p, double *A, double *b, double *rows) {
  const int *start = p->factor_start, *column = p->factor_column, *diagonal = p->factor_diagonal;
  const int *first = p->group_first;
  double *row[3] = {rows, rows + p->free, rows + 2 * p->free};
  for (int g = 0; g < p->groups; ++g) {
    int i = first[g], size = first[g + 1] - i;
    for (int x = 0; x < size; ++x)
      for (int k = start[i + x]; k < start[i + x + 1]; ++k) row[x][column[k]] = A[k];
    for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s) {
      int h = p->source[s], at = first[h], many = first[h + 1] - at;
      double f[3][3] = {{0}};
      const double *from[3];
      for (int y = 0; y < 3; ++y) from[y] = A + diagonal[at + (y < many ? y : 0)];
      for (int x = 0; x < size; ++x)
        for (int y = 0; y < many; ++y) {
          f[x][y] = row[x][at + y] * from[y][0];
          for (int z = y + 1; z < many; ++z) row[x][at + z] -= f[x][y] * from[y][z - y];
          b[i + x] -= f[x][y] * b[at + y];
        }
      for (int y = 0; y < 3; ++y) from[y] += y < many ? many - y : many;
      for (int k = p->run_start[h]; k < p->run_start[h + 1]; ++k) {
        int length = p->run_length[k];
        double *to[3];
        for (int x = 0; x < 3; ++x) to[x] = row[x] + p->run_column[k];
        subtract_rows(length, f, from, to);
        for (int y = 0; y < 3; ++y) from[y] += length;
      }
    }
    for (int x = 0; x < size; ++x) {
      if (!is_pivot(row[x][i + x])) return 0;
      double *upper = A + diagonal[i + x];
      upper[0] = 1 / row[x][i + x];
      int entries = start[i + x + 1] - diagonal[i + x];
      for (int k = 1; k < entries; ++k) upper[k] = row[x][column[diagonal[i + x] + k]];
      for (int z = x + 1; z < size; ++z) {
        double factor = row[z][i + x] * upper[0];
        for (int k = 1; k < entries; ++k)
          row[z][column[diagonal[i + x] + k]] -= factor * upper[k];
        b[i + z] -= factor * b[i + x];
      }
    }
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
