/* A fixed point of a few numbers that depend on themselves, by secants (Anderson 1965, doi 10.1145/321296.321305). */

#pragma once

#include "point_force.h"
#include "vectors.h"

/* Most trials, and relative changes below which the numbers agree, and below which round-off may stop them. */
enum { MOST_TRIALS = 40 };
static const double SETTLED = 1e-13, ROUGHLY = 1e-6;
/* Part of a secant that must be new. */
static const double INDEPENDENT = 0.03;

static inline void begin_fixed_point(FixedPoint *f, double round_off) {
  f->trials = 0, f->change = HUGE_VAL, f->round_off = round_off;
}

/* Corrects a trial, which is the values of the last one, by what the secants say of their changes, the newest first. */
static inline void apply_secants(const FixedPoint *f, double *change, double *trial) {
  int n = f->size, used = 0, known = f->trials < SECANTS ? f->trials : SECANTS;
  double *secants = f->memory + 2 * n, *rows = secants + 2 * SECANTS * n;
  for (int k = 1; k <= known && used < n; ++k) {
    const double *secant = secants + 2 * n * ((f->trials - k) % SECANTS);
    double *row = rows + 2 * n * used, length = sqrt(product_of(n, secant, secant));
    memcpy(row, secant, 2 * n * sizeof(double));
    for (int i = 0; i < used; ++i) add_times(2 * n, -product_of(n, row, rows + 2 * n * i), rows + 2 * n * i, row);
    double left = sqrt(product_of(n, row, row));
    if (!(left > INDEPENDENT * length)) continue;
    for (int i = 0; i < 2 * n; ++i) row[i] /= left;
    add_times(n, -product_of(n, change, row), row + n, trial);
    ++used;
  }
}

/* From the values with a trial sets the next one. Returns 0 if they are those of the trial, up to SETTLED or to round-off;
   1 if not. With `still`, the last change of the trial had no effect. */
static int next_trial(FixedPoint *f, const double *values, int still, double *trial) {
  int n = f->size;
  double *last = f->memory, *secant = last + 2 * n * (1 + f->trials % SECANTS), size = 0, change = 0;
  for (int i = 0; i < n; ++i) size = fmax(size, fabs(values[i])), change = fmax(change, fabs(values[i] - trial[i]));
  int known = f->trials >= (n < SECANTS ? n : SECANTS);
  int stalls = known && change > 0.5 * f->change && (still || change <= ROUGHLY * size);
  if (change <= SETTLED * fmax(size, f->round_off) || stalls) return 0;
  for (int i = 0; i < 2 * n; ++i) {
    double now = i < n ? values[i] - trial[i] : values[i - n];
    secant[i] = now - last[i], last[i] = now;
  }
  f->trials += f->change < HUGE_VAL; /* the first trial has no secant */
  f->change = change;
  memcpy(trial, values, n * sizeof(double));
  apply_secants(f, last, trial);
  return 1;
}
