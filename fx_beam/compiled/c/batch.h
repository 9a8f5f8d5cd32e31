/* A function that FFCx generates for one element, made to run over LANES elements at once. Entry k
   of lane l stands at [k][l], so that the compiler turns the loop over lanes into vector
   instructions. It does so only for straight code: hence the unrolled loops, and no sincos. What
   FFCx writes is included as it is, and changed by declarations before it and by a macro for `for`;
   so all that it includes itself stands here. */

#include <math.h>
#include <stdalign.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <ufcx.h>

#include "problem.h"
#include "vectors.h"

#define KEPT __attribute__((externally_visible))
#define UNROLLED _Pragma("GCC unroll 256")

/* One function of a form: `size` entries of the element tensor from `width` coefficients, the
   constants, and `places` coordinates. What it takes besides means nothing on cells. */
#define BATCH(name, function, size, width, places, ...)                                      \
  KEPT void name(double *restrict tensors, const double *restrict coefficients,                   \
            const double *restrict constants, const double *restrict coordinates) {          \
    _Pragma("GCC ivdep")                                                                     \
    for (int l = 0; l < LANES; ++l) {                                                        \
      double A[size], w[width], x[places];                                                   \
      UNROLLED for (int k = 0; k < (size); ++k) A[k] = 0;                                    \
      UNROLLED for (int k = 0; k < (width); ++k) w[k] = coefficients[k * LANES + l];         \
      UNROLLED for (int k = 0; k < (places); ++k) x[k] = coordinates[k * LANES + l];         \
      function(A, w, constants, x, __VA_ARGS__);                                             \
      UNROLLED for (int k = 0; k < (size); ++k) tensors[k * LANES + l] = A[k];               \
    }                                                                                        \
  }
