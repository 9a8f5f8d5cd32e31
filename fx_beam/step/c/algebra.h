/* Sums, maxima and rotations. */

#pragma once

#include <string.h>
#include "vectors.h"
#include "room.h"

/* Multiplies a vector by a factor; by zero also if it is not finite. */
HOT void scale(long n, double factor, double *x) {
  if (factor == 0) memset(x, 0, n * sizeof(double));
  for (long i = 0; i < n && factor != 0 && factor != 1; ++i) x[i] *= factor;
}

/* A sum of products, in LANES lanes, which the compiler vectorises. */
INLINED double product_of_all(int n, const double *x, const double *y, int sizes) {
  double sum[LANES] = {0}, rest = 0, all = 0;
  int i = 0;
  for (; i + LANES <= n; i += LANES)
    for (int l = 0; l < LANES; ++l) sum[l] += sizes ? fabs(x[i + l] * y[i + l]) : x[i + l] * y[i + l];
  for (; i < n; ++i) rest += sizes ? fabs(x[i] * y[i]) : x[i] * y[i];
  for (int l = 0; l < LANES; ++l) all += sum[l];
  return rest + all;
}

HOT double dot(int n, const double *x, const double *y) { return product_of_all(n, x, y, 0); }

/* Sum of |x| |y|. */
HOT double dot_of_sizes(int n, const double *x, const double *y) { return product_of_all(n, x, y, 1); }

/* Largest |x| / unit, or |x| without units; not finite if an x is not finite. The bits of sizes are compared as integers, as
   the compiler vectorises that: they are in the same order, and NaN is above all numbers. */
HOT double largest(int n, const double *x, const double *per_unit) {
  union { double size; int64_t bits; } top = {0}, now;
  for (int i = 0; i < n; ++i) {
    now.size = fabs(per_unit ? x[i] * per_unit[i] : x[i]);
    top.bits = now.bits > top.bits ? now.bits : top.bits;
  }
  return top.size;
}

/* The tangent without anything in what masses do not set, and ones where nothing else is. */
static void begin_tangent(const Tables *p, double *K) {
  for (const int *gap = p->tangent.gap; gap < p->tangent.gap + 2 * p->tangent.gaps; gap += 2)
    memset(K + gap[0], 0, (gap[1] - gap[0]) * sizeof(double));
  for (int k = 0; k < p->system.paddings; ++k) K[p->system.padding[k]] = 1;
}

/* Product of the mass matrix and x. With a tangent K, the matrix times `steep` and the slopes of its columns is stored there: in
   a chain with zeros in the other entries of a pair of nodes, where these are in three rows of a group; unless elements are to set
   those of the pair (`by_elements`). */
INLINED void multiply_mass(const Tables *p, const Numbers *s, const double *restrict x, double *restrict out, double *K,
                           double steep, const double *restrict slope, const int *by_elements) {
  const int *end = p->mass.start + 1, *dof = p->mass.dof, *at = p->mass.stored_at;
  const double *mass = s->mass;
  for (int i = 0; i < p->mesh.nodes; ++i, out += 3) {
    Four sum = {0};
    for (const int *last = p->mass.dof + end[i]; dof < last; ++dof, mass += 3, at += 3) {
      Four pair_mass = load(mass);
      sum += pair_mass * load(x + *dof);
      if (!K || (HAS(CHAIN) && by_elements && by_elements[dof - p->mass.dof])) continue;
      pair_mass *= steep * load(slope + *dof);
      if (HAS(CHAIN) && p->system.chain && at[2] == at[0] + 2 * (ROW + 1)) {
        double *row = K + at[0];
        *(Four *)row = PICK(pair_mass, (Four){0}, 0, 5, 6, 7), *(Four *)(row + ROW) = PICK(pair_mass, (Four){0}, 4, 1, 6, 7);
        *(Four *)(row + 2 * ROW) = PICK(pair_mass, (Four){0}, 4, 5, 2, 7);
      } else K[at[0]] = pair_mass[0], K[at[1]] = pair_mass[1], K[at[2]] = pair_mass[2];
    }
    put_three(sum, out);
  }
}

HOT void times_mass(const Tables *p, const Numbers *s, const double *x, double *out) { multiply_mass(p, s, x, out, 0, 0, 0, 0); }

/* Product of a row of the full tangent, or with `sizes` of the sizes of its entries, and a vector. */
static double row_times(const Tangent *tangent, const double *K, int row, int sizes, const double *x) {
  double sum = 0;
  for (int k = tangent->row_start[row]; k < tangent->row_start[row + 1]; ++k) {
    double entry = K[tangent->stored_at[k]];
    sum += (sizes ? fabs(entry) : entry) * x[tangent->column_of[k]];
  }
  return sum;
}

/* Value at a degree of freedom; zero for the ground, -1. */
static inline double at(const double *x, int dof) { return dof < 0 ? 0 : x[dof]; }

/* A vector that turns with a frame, its cosine and sine. */
INLINED Two turn_by(Two frame, Two v) { return (Two){frame[0] * v[0] - frame[1] * v[1], frame[1] * v[0] + frame[0] * v[1]}; }
