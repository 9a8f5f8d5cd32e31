/* What the compiler may have used, and the processor that runs it does not have. */

#pragma once

#include "scene_features.h"

#if defined __x86_64__
/* Also this function must run on any processor. */
#define EVERYWHERE __attribute__((target("arch=x86-64")))
#define NEEDS(feature, name) \
  if (!__builtin_cpu_supports(feature)) return name;
#elif defined __aarch64__ && defined __linux__
#include <sys/auxv.h>
#define EVERYWHERE
#define NEEDS(bit, name) \
  if (!(getauxval(AT_HWCAP) & 1UL << bit)) return name;
#endif

#ifndef EVERYWHERE
#define EVERYWHERE
#endif

/* Name of a feature, empty if nothing is missing. */
KEPT EVERYWHERE const char *fx_missing(void) {
#ifdef __SSE4_2__
  NEEDS("sse4.2", "SSE4.2")
#endif
#ifdef __AVX__
  NEEDS("avx", "AVX")
#endif
#ifdef __AVX2__
  NEEDS("avx2", "AVX2")
#endif
#ifdef __BMI2__
  NEEDS("bmi2", "BMI2")
#endif
#ifdef __FMA__
  NEEDS("fma", "FMA")
#endif
#ifdef __FMA4__
  NEEDS("fma4", "FMA4")
#endif
#ifdef __XOP__
  NEEDS("xop", "XOP")
#endif
#ifdef __AVX512F__
  NEEDS("avx512f", "AVX-512F")
#endif
#ifdef __AVX512VL__
  NEEDS("avx512vl", "AVX-512VL")
#endif
#ifdef __AVX512DQ__
  NEEDS("avx512dq", "AVX-512DQ")
#endif
#ifdef __AVX512BW__
  NEEDS("avx512bw", "AVX-512BW")
#endif
#ifdef __ARM_FEATURE_ATOMICS
  NEEDS(8, "atomic instructions (LSE)")
#endif
#ifdef __ARM_FEATURE_SVE
  NEEDS(22, "SVE")
#endif
  return "";
}
