/* Assembly of vectors, matrices and scalars from element tensors (forms.py). */

#pragma once

#include "algebra.h"

static void pack(const Problem *p, const Integral *of, const Form *form, long block,
                 const double *const *fields, int first, int end) {
  int entries = p->cell_dofs * LANES;
  const int *dofs = of->dofs + block * entries;
  for (int m = first; m < end; ++m) {
    const double *field = fields[form->kind[m]];
    double *to = of->packed + (block * form->width + form->offset[m]) * LANES;
    for (int j = 0; j < entries; ++j) to[j] = field[dofs[j]];
  }
}

/* Sets the time, and the coefficients that change only from step to step. */
static void begin_form(const Problem *p, Form *form, const double *const *fields, double t, double dt) {
  for (int i = 0; i < form->integrals; ++i)
    for (long block = 0; block * LANES < form->of[i].cells; ++block)
      pack(p, form->of + i, form, block, fields, form->changing, form->moving);
  if (form->integrals && form->time_at >= 0) form->constants[form->time_at] = t;
  if (form->integrals && form->dt_at >= 0) form->constants[form->dt_at] = dt;
}

/* Adds the element tensors of a form to a scalar, a vector or matrix entries (rank 0, 1, 2). */
INLINED void assemble(const Problem *p, const Form *form, const double *const *fields, int rank,
                      double *out) {
  int nd = p->cell_dofs, size = rank == 2 ? nd * nd : rank == 1 ? nd : 1;
  double A[12 * 12 * LANES];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *of = form->of + i;
    for (long block = 0; block * LANES < of->cells; ++block) {
      pack(p, of, form, block, fields, 0, form->changing);
      of->batch(A, of->packed + block * form->width * LANES, form->constants,
                of->coordinates + block * p->cell_coordinates * LANES);
      if (rank == 0) {
        for (int l = 0; l < LANES && block * LANES + l < of->cells; ++l) *out += A[l];
        continue;
      }
      const int *to = (rank == 2 ? of->place : of->to) + block * size * LANES;
      for (int j = 0; j < size; ++j)
#pragma GCC unroll 8
        for (int l = 0; l < LANES; ++l) out[to[j * LANES + l]] += A[j * LANES + l];
    }
  }
}

static void assemble_matrix(const Problem *p, const Form *form, const double *const *fields,
                            double *out) {
  assemble(p, form, fields, 2, out);
}

static void assemble_vector(const Problem *p, const Form *form, const double *const *fields,
                            double *out) {
  assemble(p, form, fields, 1, out);
}

/* Whether a non-negative functional is positive on any element. The padding of the last block
   repeats an element and has no effect. */
static int any_positive(const Problem *p, const Form *form, const double *const *fields) {
  double sums[LANES] = {0}, A[LANES], sum = 0;
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *of = form->of + i;
    for (long block = 0; block * LANES < of->cells; ++block) {
      pack(p, of, form, block, fields, 0, form->moving);
      of->batch(A, of->packed + block * form->width * LANES, form->constants,
                of->coordinates + block * p->cell_coordinates * LANES);
      for (int l = 0; l < LANES; ++l) sums[l] += A[l];
    }
  }
  for (int l = 0; l < LANES; ++l) sum += sums[l];
  return sum > 0;
}

static double assemble_scalar(const Problem *p, const Form *form, const double *const *fields) {
  double sum = 0;
  assemble(p, form, fields, 0, &sum);
  return sum;
}
