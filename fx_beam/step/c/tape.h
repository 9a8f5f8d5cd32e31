/* What sub-steps were given and found, from which a run can be followed backwards (adjoint.h). */

#pragma once

#include "work.h"

/* Numbers and arrays of a row. */
enum { TAPED_NUMBERS = 5, TAPED = 12 };

typedef struct {
  double *of[TAPED];
  long size[TAPED];
} TapedArrays;

/* Start of a sub-step, loads at both ends, natural strains at its end, follower forces and parameters in it, and
   increments of the columns. */
static TapedArrays taped_arrays(const Problem *p, const Work *w) {
  long n = p->dofs, before = p->keeps_previous ? n : 0, internal = (long)p->cells * p->cell_internal;
  return (TapedArrays){
      {p->q, p->v, p->q_previous, p->slides, p->internal, p->spring_internal, p->natural, w->loads, w->follower_force,
       w->naturals, p->parameter, w->z},
      {n, n, before, p->scene_joints, internal, p->spring_width, (long)p->cells * p->cell_natural, 2L * p->loads,
       2L * p->follower_forces, p->naturals, p->parameter_count, p->columns}};
}

OF_STEPS long fx_tape_size(const Problem *p) {
  Work none = {0};
  TapedArrays arrays = taped_arrays(p, &none);
  long size = TAPED_NUMBERS;
  for (int i = 0; i < TAPED; ++i) size += arrays.size[i];
  return size;
}

/* Adds a sub-step that succeeded, before the state advances. */
static void put_on_tape(const Problem *p, const Work *w, Tape *tape) {
  if (!tape->row) {
    memcpy(tape->increments + tape->rows++ * p->columns, w->z, p->columns * sizeof(double));
    return;
  }
  double *to = tape->row + tape->rows++ * tape->size;
  TapedArrays arrays = taped_arrays(p, w);
  *to++ = p->t, *to++ = w->dt, *to++ = p->ratio, *to++ = p->share, *to++ = p->earlier;
  for (int i = 0; i < TAPED; to += arrays.size[i++])
    if (arrays.size[i]) memcpy(to, arrays.of[i], arrays.size[i] * sizeof(double));
}

/* Takes a row back into the state. */
static void take_from_tape(Problem *p, const Work *w, const double *row) {
  TapedArrays arrays = taped_arrays(p, w);
  p->t = row[0], p->ratio = row[2];
  row += TAPED_NUMBERS;
  for (int i = 0; i < TAPED; row += arrays.size[i++])
    if (arrays.size[i]) memcpy(arrays.of[i], row, arrays.size[i] * sizeof(double));
}
