/* LU factorisation of the reduced tangent as a band matrix (sparse_lu.py). */

#pragma once

#include "algebra.h"
#include "sparse_lu.h"

/* Eliminates a column from the next `reach` rows, downwards (direction 1) or upwards (direction -1). */
INLINED void eliminate_rows(int band, int reach, int direction, double *restrict pivot, double *restrict b) {
  double inverse = pivot[0] = 1 / pivot[0], above = b[0];
#pragma GCC unroll 12
  for (int i = 1; i <= reach; ++i) {
    double *restrict row = pivot + direction * i * 2 * band;
    double factor = row[0] * inverse;
#pragma GCC unroll 12
    for (int j = 1; j <= reach; ++j) row[direction * j] -= factor * pivot[direction * j];
    b[direction * i] -= factor * above;
  }
}

/* Unknown of a row from the next `reach` unknowns; the nearest last, since it is the latest result. */
INLINED void substitute_row(int reach, int direction, const double *restrict row, double *restrict b) {
  double sum = b[0];
#pragma GCC unroll 12
  for (int j = reach; j > 0; --j) sum -= row[direction * j] * b[direction * j];
  b[0] = sum * row[0];
}

/* Elimination with a reach that the compiler does not know: each once, as unrolled loops take long to compile. */
COMPILED_ONCE void eliminate_any(int band, int reach, int direction, double *restrict pivot, double *restrict b) {
  eliminate_rows(band, reach, direction, pivot, b);
}

COMPILED_ONCE void substitute_any(int reach, int direction, const double *restrict row, double *restrict b) {
  substitute_row(reach, direction, row, b);
}

INLINED void eliminate(int band, int reach, int direction, double *restrict pivot, double *restrict b) {
  if (__builtin_constant_p(reach)) eliminate_rows(band, reach, direction, pivot, b);
  else eliminate_any(band, reach, direction, pivot, b);
}

INLINED void substitute(int reach, int direction, const double *restrict row, double *restrict b) {
  if (__builtin_constant_p(reach)) substitute_row(reach, direction, row, b);
  else substitute_any(reach, direction, row, b);
}

/* Rows of a band matrix that are eliminated downwards from its start, and those that are eliminated upwards
   from its end, around this one; between them are at least twice the bandwidth. */
typedef struct { int top, bottom; } Ends;

INLINED Ends ends_around(int n, int band, int middle) {
  int top = middle - band, bottom = n - middle - band;
  if (n <= 4 * band) return (Ends){0, 0};
  return (Ends){top < 0 ? 0 : top, bottom < 0 ? 0 : bottom};
}

/* LU factorisation in place without pivoting, with the same of a right side b; returns 0 if a pivot is
   zero. Proceeds from both ends to the middle: the processor can overlap the two divisions. */
INLINED int eliminate_band(int n, int band, Ends ends, double *A, double *b) {
  int most = ends.top > ends.bottom ? ends.top : ends.bottom, last = n - 1 - ends.bottom;
  long row = 2 * band + 1;
  double *top = A + band, *bottom = A + band + (n - 1) * row, *end = b + n - 1;
  for (int k = 0; k < most; ++k) {
    if (k < ends.top) {
      if (!is_pivot(top[k * row])) return 0;
      eliminate(band, band, 1, top + k * row, b + k);
    }
    if (k < ends.bottom) {
      if (!is_pivot(bottom[-k * row])) return 0;
      eliminate(band, band, -1, bottom - k * row, end - k);
    }
  }
  for (int k = ends.top; k <= last; ++k) {
    if (!is_pivot(top[k * row])) return 0;
    /* Separate, so that the loops have a constant length except at the end. */
    if (k + band <= last) eliminate(band, band, 1, top + k * row, b + k);
    else eliminate(band, last - k, 1, top + k * row, b + k);
  }
  return 1;
}

/* The solution in place of b: only those that are `reached` or not, if it is given. */
INLINED void substitute_band(int n, int band, Ends ends, const double *A, double *b, const int *reached, int now) {
  int most = ends.top > ends.bottom ? ends.top : ends.bottom, last = n - 1 - ends.bottom;
  long row = 2 * band + 1;
  const double *top = A + band, *bottom = A + band + (n - 1) * row;
  for (int k = last; k >= ends.top; --k) {
    if (reached && reached[k] != now) continue;
    if (k + band <= last) substitute(band, 1, top + k * row, b + k);
    else substitute(last - k, 1, top + k * row, b + k);
  }
  for (int k = most - 1; k >= 0; --k) {
    if (k < ends.top && !(reached && reached[k] != now)) substitute(band, 1, top + k * row, b + k);
    if (k < ends.bottom && !(reached && reached[n - 1 - k] != now))
      substitute(band, -1, bottom - k * row, b + n - 1 - k);
  }
}

/* Subtracts a multiple of a row of the block (room.h), of n times four columns, from another one. */
INLINED void subtract_in_block(const Work *w, int n, int row, double factor, int other) {
  Four *to = (Four *)w->block + (long)row * n, *subtracted = (Four *)w->block + (long)other * n;
  for (int j = 0; j < n; ++j) to[j] -= factor * subtracted[j];
}

/* The block from its right sides and factors of a band matrix. */
INLINED void solve_band_columns(const Tables *p, const Work *w, Ends ends, int columns) {
  int n = p->free, band = p->system.band, last = n - 1 - ends.bottom;
  long width = 2 * band + 1;
  const double *A = w->tangent + band;
  for (int part = 0; part < 2; ++part)
    for (int i = 0; i < (part ? last + 1 : ends.bottom); ++i) {
      int k = part ? i : n - 1 - i, direction = part ? 1 : -1, reach_of = k >= ends.top && part ? last - k : band;
      const double *pivot = A + k * width;
      if (!w->reached[k]) continue;
      for (int j = 1; j <= band && j <= reach_of; ++j) {
        double below = pivot[direction * j * 2 * band];
        if (below == 0 && pivot[direction * j] == 0) continue;
        reach(&p->border, w, k + direction * j);
        subtract_in_block(w, columns, k + direction * j, below * pivot[0], k);
      }
    }
  for (int part = 1; part >= 0; --part)
    for (int i = (part ? last + 1 : ends.bottom) - 1; i >= 0; --i) {
      int k = part ? i : n - 1 - i, direction = part ? 1 : -1, reach_of = k >= ends.top && part ? last - k : band;
      const double *pivot = A + k * width;
      Four *row = (Four *)w->block + (long)k * columns;
      if (!w->reached[k]) continue;
      for (int j = 1; j <= band && j <= reach_of; ++j)
        if (pivot[direction * j] != 0) subtract_in_block(w, columns, k, pivot[direction * j], k + direction * j);
      for (int j = 0; j < columns; ++j) row[j] *= pivot[0];
    }
}

/* A function of a band matrix with constant bandwidths of beams, for which the compiler can unroll the
   loops. */
#define OF_BAND(p, function, n, ...)                       \
  ((p)->system.band == 5    ? function(n, 5, __VA_ARGS__)  /* degree 1 with joints */ \
   : (p)->system.band == 6  ? function(n, 6, __VA_ARGS__)         \
   : (p)->system.band == 8  ? function(n, 8, __VA_ARGS__)  /* degree 2 */ \
   : (p)->system.band == 11 ? function(n, 11, __VA_ARGS__) /* degree 3 */ \
                     : function(n, (p)->system.band, __VA_ARGS__))

/* Both of the tangent and the right side y, whose solution takes its place. */
COMPILED_ONCE int eliminate_tangent(const Tables *p, const Work *w, int n, Ends ends) {
  return OF_BAND(p, eliminate_band, n, ends, w->tangent, w->y);
}

COMPILED_ONCE void substitute_tangent(const Tables *p, const Work *w, int n, Ends ends, const int *reached, int now) {
  OF_BAND(p, substitute_band, n, ends, w->tangent, w->y, reached, now);
}
