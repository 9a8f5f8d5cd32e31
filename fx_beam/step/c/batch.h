/* Evaluates LANES elements at once with a function that FFCx generates for one element. Entry k of
   lane l is at [k][l]: the compiler can then vectorise the loop over lanes. It does so only for code
   without branches and calls: hence the unrolled loops, and sines.h. The code of FFCx is included unchanged;
   declarations before it and a macro for `for` modify it, so its own includes are listed here. */

#include <math.h>
#include <stdalign.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "tables.h"
#include "sines.h"

#define fmax larger
#define fmin smaller
#define sin sine
#define cos cosine

#define UNROLLED _Pragma("GCC unroll 1024")

/* A function of one element: `size` entries of element tensors from `width` coefficients, the
   constants, and `places` coordinates x and y, to which it expects a z of each place. */
#define BATCH(name, function, size, width, places)                                           \
  KEPT void name(double *restrict tensors, const double *restrict coefficients,                   \
            const double *restrict constants, const double *restrict coordinates) {          \
    _Pragma("GCC ivdep")                                                                     \
    for (int l = 0; l < LANES; ++l) {                                                        \
      double A[size], w[width], x[(places) / 2 * 3 + 1];                                     \
      UNROLLED for (int k = 0; k < (size); ++k) A[k] = 0;                                    \
      UNROLLED for (int k = 0; k < (width); ++k) w[k] = coefficients[k * LANES + l];         \
      UNROLLED for (int k = 0; k < (places); ++k) x[k / 2 * 3 + k % 2] = coordinates[k * LANES + l]; \
      UNROLLED for (int k = 2; k < (places) / 2 * 3; k += 3) x[k] = 0;                       \
      function(A, w, constants, x);                                                          \
      UNROLLED for (int k = 0; k < (size); ++k) tensors[k * LANES + l] = A[k];               \
    }                                                                                        \
  }
