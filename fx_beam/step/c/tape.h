/* Inputs and results of sub-steps, from which a run can be followed backwards (adjoint.h). */

#pragma once

#include "room.h"

/* Numbers and arrays of a row. */
enum { TAPED_NUMBERS = 5, TAPED = 12 };

typedef struct { double *of[TAPED]; long size[TAPED]; } TapedArrays;

/* Start of a sub-step, loads at both ends, natural strains at its end, follower forces and parameters in it, and
   increments of the columns. */
static TapedArrays taped_arrays(const Tables *p, const Numbers *s, const Work *w) {
  long n = p->dofs, before = p->scheme.keeps_previous ? n : 0, internal = (long)p->cells * p->internal.per_cell;
  return (TapedArrays){
      {w->state.q, w->state.v, w->state.q_previous, w->state.slides, w->state.internal, w->state.spring_internal,
          w->state.natural, w->loads, w->follower_force, w->naturals, s->parameters, w->z},
      {n, n, before, p->passes.joints, internal, p->at_points.spring_width, (long)p->cells * p->natural.per_cell,
          2L * p->loads.count, 2L * p->loads.follower_forces, p->natural.count, p->parameters.count, p->columns}};
}

OF_STEPS long fx_tape_size(const Problem *problem) {
  TapedArrays arrays = taped_arrays(problem->tables, &problem->numbers, &problem->work);
  long size = TAPED_NUMBERS;
  for (int i = 0; i < TAPED; ++i) size += arrays.size[i];
  return size;
}

/* Adds a sub-step that succeeded, before the state advances. */
static void put_on_tape(const Tables *p, const Numbers *s, const Work *w, Tape *tape) {
  if (!tape->row) {
    memcpy(tape->increments + tape->rows++ * p->columns, w->z, p->columns * sizeof(double));
    return;
  }
  double *to = tape->row + tape->rows++ * tape->size;
  TapedArrays arrays = taped_arrays(p, s, w);
  *to++ = w->state.t, *to++ = w->dt, *to++ = w->state.ratio, *to++ = w->state.share, *to++ = w->state.earlier;
  for (int i = 0; i < TAPED; to += arrays.size[i++])
    if (arrays.size[i]) memcpy(to, arrays.of[i], arrays.size[i] * sizeof(double));
}

/* Takes a row back into the state. */
static void take_from_tape(const Tables *p, const Numbers *s, Work *w, const double *row) {
  TapedArrays arrays = taped_arrays(p, s, w);
  w->state.t = row[0], w->state.ratio = row[2];
  row += TAPED_NUMBERS;
  for (int i = 0; i < TAPED; row += arrays.size[i++])
    if (arrays.size[i]) memcpy(arrays.of[i], row, arrays.size[i] * sizeof(double));
}
