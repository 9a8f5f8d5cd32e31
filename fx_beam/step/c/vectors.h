/* Declarations for vectorisation; other compilers ignore them. */

#pragma once

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include "scene_features.h"

#define INLINED static inline __attribute__((always_inline))
/* Four numbers side by side. */
typedef double Four __attribute__((vector_size(32), aligned(8)));
/* For what takes the time of steps: all else is compiled in half the time, and as fast (build.py). */
#define HOT static __attribute__((optimize("O3")))
/* For large functions with several callers, each copy of which would take its time to compile. */
#define COMPILED_ONCE HOT __attribute__((noinline))

#if defined __x86_64__ && defined __GLIBC__ && defined __GNUC__ && !defined __clang__
/* glibc has vector versions of these, but declares them only with -ffast-math. */
#define FOR_VECTORS __attribute__((simd("notinbranch"), const, nothrow, leaf))
FOR_VECTORS double sin(double);
FOR_VECTORS double cos(double);
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

/* Sum of the products of few numbers. */
static inline double product_of(int n, const double *x, const double *y) {
  double sum = 0;
  for (int i = 0; i < n; ++i) sum += x[i] * y[i];
  return sum;
}

/* x += factor y */
static void add_times(int n, double factor, const double *restrict y, double *restrict x) {
  for (int i = 0; i < n; ++i) x[i] += factor * y[i];
}
