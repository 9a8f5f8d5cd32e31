/* Where node b is on node a by a slide d: at o + f(d, e) in the frame of a, with the offset o and the axis e of the joint.
   A joint of another kind is a function here, a case of track_of, and a Track in Python (scene/joints.py). */

#pragma once

#include "vectors.h"

/* f at the end d of a step and its derivatives by e; the mean of its derivative by d over the step, which changes by `bend`
   with d, and its derivatives by e. */
typedef struct { Two place, place_by[2], chord, bend, chord_by[2]; } Track;

INLINED Track straight_track(const double *e, double d) {
  return (Track){d * pair(e), {{d, 0}, {0, d}}, pair(e), {0, 0}, {{1, 0}, {0, 1}}};
}

/* With equal ends the chord is the tangent. */
INLINED Track track_of(int kind, const double *e, double d_before, double d) {
  (void)kind, (void)d_before;
  return straight_track(e, d);
}
