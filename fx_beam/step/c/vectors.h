/* Declarations for vectorisation; other compilers ignore them. */

#pragma once

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "scene_features.h"

#define INLINED static inline __attribute__((always_inline))
/* Four numbers side by side. */
typedef double Four __attribute__((vector_size(32), aligned(8)));

/* Four numbers of single precision. */
typedef float Floats __attribute__((vector_size(16), aligned(4)));

typedef double Two __attribute__((vector_size(16), aligned(8)));

/* Numbers with these places in a and b behind it. */
#if __has_builtin(__builtin_shufflevector)
#define PICK(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else /* GCC before 12 */
typedef int64_t Places __attribute__((vector_size(32)));
#define PICK(a, b, ...) __builtin_shuffle(a, b, (Places){__VA_ARGS__})
#endif

INLINED Four load(const double *from) { return *(const Four *)from; }

INLINED Two pair(const double *from) { return *(const Two *)from; }

INLINED void transpose(Four a, Four b, Four c, Four d, Four *columns) {
  Four p = PICK(a, b, 0, 4, 2, 6), q = PICK(c, d, 0, 4, 2, 6), r = PICK(a, b, 1, 5, 3, 7), s = PICK(c, d, 1, 5, 3, 7);
  columns[0] = PICK(p, q, 0, 1, 4, 5), columns[1] = PICK(r, s, 0, 1, 4, 5);
  columns[2] = PICK(p, q, 2, 3, 6, 7), columns[3] = PICK(r, s, 2, 3, 6, 7);
}

/* Stores three of them, those of a node. */
INLINED void put_three(Four v, double *x) { x[0] = v[0], x[1] = v[1], x[2] = v[2]; }

/* For what takes the time of steps: all else is compiled in half the time, and as fast (build.py). */
#if __has_attribute(optimize)
#define HOT static __attribute__((optimize("O3")))
#else
#define HOT static
#endif
/* For large functions with several callers, each copy of which would take its time to compile. */
#define COMPILED_ONCE HOT __attribute__((noinline))

#if defined __x86_64__ && defined __GLIBC__ && defined __GNUC__ && !defined __clang__
/* glibc has vector versions of these, but declares them only with -ffast-math. */
#define FOR_VECTORS __attribute__((simd("notinbranch"), const, nothrow, leaf))
FOR_VECTORS double exp(double);
FOR_VECTORS double log(double);
#if __GLIBC_PREREQ(2, 35)
FOR_VECTORS double tan(double);
#endif
#endif

/* fmax and fmin without a function call, so that the compiler can vectorise them. If a or b is NaN, the
   result is b: a value that may be NaN must be the first one. */
INLINED double larger(double a, double b) { return a > b ? a : b; }
INLINED double smaller(double a, double b) { return a < b ? a : b; }

/* Room for so many entries of an array, and for one more, so that it has an address. */
#define ROOM(array, count) array = realloc(array, ((count) + 1) * sizeof *(array))

/* The numbers at some places: one by one, as an instruction for many places takes longer. */
INLINED void gather(int n, const double *x, const int *at, double *out) {
#pragma GCC unroll 4
  for (int i = 0; i < n; ++i) out[i] = x[at[i]];
}

/* Sum of the products of few numbers. */
static inline double product_of(int n, const double *x, const double *y) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += x[i] * y[i];
  return sum;
}

/* x += a - b */
HOT void add_difference(int n, const double *restrict a, const double *restrict b, double *restrict x) {
  for (int i = 0; i < n; ++i) x[i] += a[i] - b[i];
}

/* x += factor y */
HOT void add_times(int n, double factor, const double *restrict y, double *restrict x) {
  for (int i = 0; i < n; ++i) x[i] += factor * y[i];
}
