/* A fixed point of a few numbers that depend on themselves, by secants (Anderson 1965, doi 10.1145/321296.321305). */

#pragma once

#include "point_force.h"
#include "vectors.h"

/* Most trials, and relative changes below which the numbers agree, and below which round-off may stop them. */
enum { MOST_TRIALS = 40 };
static const double SETTLED = 1e-13, ROUGHLY = 1e-6;
/* Part of a secant that must be new. */
static const double INDEPENDENT = 0.03;

static inline void begin_fixed_point(FixedPoint *f) { f->trials = 0, f->change = HUGE_VAL; }

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
  double *last_change = f->memory, *last_values = last_change + n, size = 0, change = 0;
  for (int i = 0; i < n; ++i) size = fmax(size, fabs(values[i])), change = fmax(change, fabs(values[i] - trial[i]));
  int known = f->trials >= (n < SECANTS ? n : SECANTS);
  int stalls = known && change > 0.5 * f->change && (still || change <= ROUGHLY * size);
  if (change <= SETTLED * size || stalls) return 0;
  double change_and_values[2 * n], *secant = last_values + n + 2 * n * (f->trials % SECANTS);
  for (int i = 0; i < n; ++i) change_and_values[i] = values[i] - trial[i], change_and_values[n + i] = values[i];
  if (f->change < HUGE_VAL) {
    for (int i = 0; i < 2 * n; ++i) secant[i] = change_and_values[i] - last_change[i];
    ++f->trials;
  }
  f->change = change;
  memcpy(f->memory, change_and_values, 2 * n * sizeof(double));
  memcpy(trial, values, n * sizeof(double));
  apply_secants(f, change_and_values, trial);
  return 1;
}
