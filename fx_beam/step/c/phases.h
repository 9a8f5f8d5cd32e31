/* Time of each phase of a step. If PHASES is defined, LAP adds the time since the previous LAP to a
   phase; otherwise it does nothing. */

#pragma once

#include "scene_features.h"

enum { FORCES, SOLUTION, COUPLINGS, INERTIA, CHECKS, PREDICTOR, AUDIT, PHASES_IN_ALL };

#ifdef PHASES
#include <time.h>

static double seconds[PHASES_IN_ALL], last;

static void lap(int phase) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  double t = now.tv_sec + 1e-9 * now.tv_nsec;
  if (phase < PHASES_IN_ALL) seconds[phase] += t - last;
  last = t;
}

#define LAP(phase) lap(phase)
OF_STEPS double *fx_phases(void) { return seconds; }
#else
#define LAP(phase) (void)0
OF_STEPS double *fx_phases(void) { return 0; }
#endif
