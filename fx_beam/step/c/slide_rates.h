/* Rates of slides at the start of a step (joint_kinematics.py). */

#pragma once

#include "sliders.h"

static double rate_of_slide(const Problem *p, const SlideRate *a) {
  if (HAS(SLIDERS) && a->slider >= 0) return slider_rate(p, p->slider + a->slider);
  double v[2], seen[2];
  for (int i = 0; i < 2; ++i) v[i] = at(p->v, a->b[i]) - at(p->v, a->a[i]);
  double d = p->slides[a->joint], spin = at(p->v, a->a[2]), *o = p->offset + 2 * a->moving;
  Track track = track_of(p->track[a->moving], p->axis + 2 * a->moving, d, d);
  turn(-at(p->q, a->a[2]), v[0], v[1], seen);
  seen[0] += spin * (o[1] + track.place[1]), seen[1] -= spin * (o[0] + track.place[0]);
  return track.chord[0] * seen[0] + track.chord[1] * seen[1];
}

/* At mid-step forces depend on mean rates alone. */
static void find_slide_rates(const Problem *p) {
  for (int i = 0; i < p->rated && p->level != 0.5; ++i)
    p->slide_rate[p->rated_slide[i].joint] = rate_of_slide(p, p->rated_slide + i);
}
