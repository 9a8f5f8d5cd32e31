/* LU factorisation in sparse rows (lu_layout.py). */

#pragma once

#include <string.h>
#include "sparse_rows.h"
#include "vectors.h"

static inline int is_pivot(double x) { return fabs(x) > 1e-300; }

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

/* A copy, without a call for the most frequent length, that of a node. */
INLINED void copy_run(int length, const double *restrict from, double *restrict to) {
  if (length == 3) to[0] = from[0], to[1] = from[1], to[2] = from[2];
  else memcpy(to, from, length * sizeof(double));
}

/* Copies stored rows of a group to rows with a place for each column, or their upper part back. */
INLINED void unpack(const SparseRows *p, const double *A, int g, int size, double *const *row) {
  const int *first = p->first;
  for (int x = 0; x < size; ++x) {
    const double *from = A + p->start[first[g] + x];
    for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s)
      for (int k = first[p->source[s]]; k < first[p->source[s] + 1]; ++k) row[x][k] = *from++;
    for (int y = 0; y < size; ++y) row[x][first[g] + y] = *from++;
    for (int k = p->run_start[g]; k < p->run_start[g + 1]; from += p->run_length[k++])
      copy_run(p->run_length[k], from, row[x] + p->run_column[k]);
  }
}

/* Elimination within a group, from the rows that `unpack` filled; returns 0 if a pivot is zero. */
INLINED int finish(const SparseRows *p, double *A, int g, int size, double *const *row) {
  int i = p->first[g];
  for (int x = 0; x < size; ++x) {
    double *upper = A + p->diagonal[i + x], factor[3];
    if (!is_pivot(row[x][i + x])) return 0;
    *upper++ = 1 / row[x][i + x];
    for (int z = x + 1; z < size; ++z) {
      factor[z] = row[z][i + x] * upper[-1];
      A[p->diagonal[i + z] - z + x] = factor[z];
      for (int y = x + 1; y < size; ++y) row[z][i + y] -= factor[z] * row[x][i + y];
    }
    for (int y = x + 1; y < size; ++y) *upper++ = row[x][i + y];
    for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k) {
      int column = p->run_column[k], length = p->run_length[k];
      const double *restrict from = row[x] + column;
      for (int z = x + 1; z < size; ++z) {
        double *restrict to = row[z] + column;
        for (int j = 0; j < length; ++j) to[j] -= factor[z] * from[j];
      }
      copy_run(length, from, upper);
      upper += length;
    }
  }
  return 1;
}

/* Subtracts multiples of the rows of an eliminated group of `many` rows from those of a group. */
INLINED void eliminate_source(const SparseRows *p, double *A, int g, int h, int size, int many, int lower,
                              double *const *row) {
  const int *start = p->start, *diagonal = p->diagonal, *first = p->first;
  int i = first[g], at = first[h];
  double f[3][3] = {{0}};
  const double *from[3];
  for (int y = 0; y < 3; ++y) from[y] = A + diagonal[at + (y < many ? y : 0)];
  for (int x = 0; x < size; ++x)
    for (int y = 0; y < many; ++y) {
      f[x][y] = row[x][at + y] * from[y][0];
      for (int z = y + 1; z < many; ++z) row[x][at + z] -= f[x][y] * from[y][z - y];
      A[start[i + x] + lower + y] = f[x][y];
    }
  for (int y = 0; y < 3; ++y) from[y] += y < many ? many - y : many;
  for (int k = p->run_start[h]; k < p->run_start[h + 1]; ++k) {
    int length = p->run_length[k];
    double *to[3];
    for (int x = 0; x < 3; ++x) to[x] = row[x] + p->run_column[k];
    if (length == 3) subtract_rows(3, f, from, to); else subtract_rows(length, f, from, to);
    for (int y = 0; y < 3; ++y) from[y] += length;
  }
}

/* Elimination of the rows of a group; returns 0 if a pivot is zero. */
INLINED int factorise_group(const SparseRows *p, double *A, int g, int size, double *const *row) {
  const int *first = p->first;
  int lower = 0;
  unpack(p, A, g, size, row);
  for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s) {
    int h = p->source[s], many = first[h + 1] - first[h];
    if (many == 3) eliminate_source(p, A, g, h, size, 3, lower, row);
    else eliminate_source(p, A, g, h, size, many, lower, row);
    lower += many;
  }
  return finish(p, A, g, size, row);
}

/* LU factorisation of sparse rows in place, in groups of up to three with equal columns, usually those
   of a node; returns 0 if a pivot is zero. `rows` is the work space (3, unknowns) for the current group. */
static int factorise_sparse(const SparseRows *p, double *A, double *rows) {
  double *row[3] = {rows, rows + p->unknowns, rows + 2 * p->unknowns};
  for (int g = 0; g < p->groups; ++g) {
    int size = p->first[g + 1] - p->first[g];
    if (!(size == 3 ? factorise_group(p, A, g, 3, row) : factorise_group(p, A, g, size, row))) return 0;
  }
  return 1;
}

/* Subtracts the known unknowns from `size` right sides, by the lower factors of a group. */
INLINED void forward(const SparseRows *p, const double *A, int g, int size, double *b) {
  const int *start = p->start, *first = p->first;
  int i = first[g];
  double sum[3] = {0};
  const double *row[3];
  for (int x = 0; x < size; ++x) row[x] = A + start[i + x];
  for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s) {
    int at = first[p->source[s]], many = first[p->source[s] + 1] - at;
    for (int y = 0; y < many; ++y)
      for (int x = 0; x < size; ++x) sum[x] += *row[x]++ * b[at + y];
  }
  for (int x = 0; x < size; ++x) {
    for (int z = 0; z < x; ++z) sum[x] += row[x][z] * b[i + z];
    b[i + x] -= sum[x];
  }
}

/* The unknowns of a group from those behind it, by its upper factors. */
INLINED void backward(const SparseRows *p, const double *A, int g, int size, double *b) {
  int i = p->first[g];
  double sum[3] = {0};
  const double *row[3];
  for (int x = 0; x < size; ++x) row[x] = A + p->diagonal[i + x] + size - x;
  for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k) {
    const double *known = b + p->run_column[k];
    for (int j = 0; j < p->run_length[k]; ++j)
      for (int x = 0; x < size; ++x) sum[x] += *row[x]++ * known[j];
  }
  for (int x = size - 1; x >= 0; --x) {
    const double *upper = A + p->diagonal[i + x];
    for (int z = x + 1; z < size; ++z) sum[x] += upper[z - x] * b[i + z];
    b[i + x] = (b[i + x] - sum[x]) * upper[0];
  }
}

static void substitute_forward(const SparseRows *p, const double *A, double *b) {
  const int *first = p->first;
  for (int g = 0; g < p->groups; ++g) {
    int size = first[g + 1] - first[g];
    if (size == 3) forward(p, A, g, 3, b); else forward(p, A, g, size, b);
  }
}

/* Those that are `reached` are known already. */
static void substitute_backward(const SparseRows *p, const double *A, double *b, const int *reached) {
  const int *first = p->first;
  for (int g = p->groups - 1; g >= 0; --g) {
    int size = first[g + 1] - first[g];
    if (reached && reached[first[g]]) continue;
    if (size == 3) backward(p, A, g, 3, b); else backward(p, A, g, size, b);
  }
}

/* Solution by sparse factors, in the place of b. */
static void substitute_sparse(const SparseRows *p, const double *A, double *b) {
  substitute_forward(p, A, b);
  substitute_backward(p, A, b, 0);
}
