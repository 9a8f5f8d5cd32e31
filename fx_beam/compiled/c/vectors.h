/* What makes compilers write vector instructions, and others ignore. */

#pragma once

#include <math.h>
#include <stdint.h>

#define INLINED static inline __attribute__((always_inline))

#if defined __x86_64__ && defined __GLIBC__ && defined __GNUC__ && !defined __clang__
/* glibc has these for vectors as well, but says so only under -ffast-math. */
#define FOR_VECTORS __attribute__((simd("notinbranch"), const, nothrow, leaf))
FOR_VECTORS double sin(double);
FOR_VECTORS double cos(double);
FOR_VECTORS double exp(double);
FOR_VECTORS double log(double);
#endif
