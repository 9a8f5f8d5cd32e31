/* A function that FFCx generates for one element, made to run over LANES elements at once. Entry k
   of lane l stands at [k][l], so that the compiler turns the loop over lanes into vector
   instructions. It does so only for straight code: hence the unrolled loops, and no sincos. */

#include "problem.h"
#include "vectors.h"

#define UNROLLED _Pragma("GCC unroll 256")

/* One function of a form: `size` entries of the element tensor from `width` coefficients, the
   constants, and `places` coordinates. */
#define BATCH(name, function, size, width, places)                                           \
  void name(double *restrict tensors, const double *restrict coefficients,                   \
            const double *restrict constants, const double *restrict coordinates) {          \
    _Pragma("GCC ivdep")                                                                     \
    for (int l = 0; l < LANES; ++l) {                                                        \
      double A[size], w[width], x[places];                                                   \
      UNROLLED for (int k = 0; k < (size); ++k) A[k] = 0;                                    \
      UNROLLED for (int k = 0; k < (width); ++k) w[k] = coefficients[k * LANES + l];         \
      UNROLLED for (int k = 0; k < (places); ++k) x[k] = coordinates[k * LANES + l];         \
      function(A, w, constants, x, 0, 0);                                                    \
      UNROLLED for (int k = 0; k < (size); ++k) tensors[k * LANES + l] = A[k];               \
    }                                                                                        \
  }
