/* Nodes that slide on beams (sliders.py). */

#pragma once

#include "algebra.h"
#include "point_forces.h"
#include "slide_relation.h"
#include "track.h"

/* Degree of freedom that belongs to a local one. */
static int local_dof(const Slider *a, int local) { return a->dofs[3 * (a->first + local % a->width) + local / a->width]; }

/* Small change of a component of the node with those of the beam, by T. */
static double moved_by_beam(const Slider *a, int c, const double *change) {
  double sum = 0;
  for (int k = 0; k < a->width; ++k) sum += a->T[c][c * a->width + k] * change[a->dofs[3 * (a->first + k) + c]];
  return sum;
}

/* Adds the forces on slides. */
static void push_columns(const PointForces *points, double *out) {
  for (int i = points->nodal; i < points->all; ++i)
    out[points->of[i].column] += points->of[i].results[0];
}

/* Adds the forces of all sliding nodes, for the forces on nodes: those on their columns pass on to their beams, in `loaded`,
   and along these. */
static void load_beams(const Tables *p, const Work *w, const double *node_forces, double *out) {
  double *r = memcpy(w->loaded, node_forces, p->dofs * sizeof(double));
  for (int i = p->sliders.count - 1; i >= 0; --i) {
    Slider *a = w->slider + i;
    for (int c = 0; c < a->components; ++c) {
      a->force[c] = out[a->carried[c]];
      for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
        a->force[c] += a->entry_sign[k] * w->virtual_map[a->entry_value[k]] * r[a->entry_row[k]];
      for (int k = 0; k < a->components * a->width; ++k) r[local_dof(a, k)] += a->force[c] * a->virtual_map[c][k];
      out[a->column] += a->force[c] * a->virtual_map[c][ARC];
    }
  }
}

/* The slide of a joint at the level of a step. */
static double slide_at_level(const Tables *p, const Work *w, int j) {
  return at(w->state.slides, p->joints.number[j]) + p->scheme.level * at(w->z, p->joints.slide_column[j]);
}

/* The axis across which forces on a joint's slide count for friction. */
static void set_axis(const PointForces *points, int joint, Two axis) {
  for (PointForce *e = points->of; e < points->of + points->all; ++e)
    for (int i = 0; e->load == joint && e->slide >= 0 && i < 2; ++i) e->load_axis[i] = axis[i] / hypot(axis[0], axis[1]);
}

/* Sets the axes across which forces on curves count for friction. */
static void set_axes(const Tables *p, const Numbers *s, const Work *w) {
  for (int j = 0; j < p->joints.count; ++j) {
    double d = slide_at_level(p, w, j);
    if (p->joints.track[j])
      set_axis(s->points, p->joints.number[j], track_of(p->joints.track[j], s->axis + 2 * j, d, d).chord);
  }
  for (const Slider *a = w->slider; a < w->slider + p->sliders.count; ++a)
    set_axis(s->points, a->joint, (Two){a->virtual_map[0][ARC], a->virtual_map[1][ARC]});
}

/* Whether a node leaves its beam in the step, or passes too many elements. */
static int leaves_beam(const Sliders *sliders, const Work *w) {
  for (int i = 0; HAS(SLIDERS) && i < sliders->count; ++i) {
    const Slider *a = w->slider + i;
    double length = a->ends[a->elements], off = fmax(-a->s1, a->s1 - length);
    int passed = element_of(a, a->s1) - element_of(a, a->s0);
    if (off > 1e-9 * length || passed > a->most || passed < -a->most) return 1;
  }
  return 0;
}

/* The relations of all nodes on beams at the start of a step. */
static void begin_sliders(const Tables *p, const Work *w) {
  memset(w->D, 0, p->dofs * sizeof(double));
  for (Slider *a = w->slider; a < w->slider + p->sliders.count; ++a) {
    a->s0 = a->s1 = w->state.slides[a->joint], a->slide = 0;
    slide_on(&p->scheme, &w->state, a, w->D);
  }
}

/* The rate of a slide that moves a node with the velocity `apart`, by the tangent of its curve. */
static double rate_along(Two apart, Two tangent) { return dot2(apart, tangent) / dot2(tangent, tangent); }

/* Rates of slides at the start of a step, by the values of T. At mid-step forces depend on mean rates alone. */
static void find_slide_rates(const Tables *p, const PointForces *points, const Work *w) {
  const double *v = w->state.v;
  if (points->all == points->nodal || p->scheme.level == 0.5) return;
  for (int j = 0; j < p->joints.count; ++j) {
    int a = p->joints.carrier[j], b = p->joints.carried_node[j];
    Two apart = {at(v, b - 2) - at(v, a - 2), at(v, b - 1) - at(v, a - 1)}, turned = at(v, a) * pair(w->values0 + 1 + 4 * j);
    if (p->joints.slide_column[j] >= 0)
      w->slide_rate[p->joints.number[j]] = rate_along(apart - turned, pair(w->values0 + 3 + 4 * j));
  }
  if (HAS(SLIDERS)) begin_sliders(p, w);
  for (const Slider *a = w->slider; a < w->slider + p->sliders.count; ++a) {
    Two apart = pair_of(v, a->node) - (Two){moved_by_beam(a, 0, v), moved_by_beam(a, 1, v)};
    w->slide_rate[a->joint] = rate_along(apart, (Two){a->T[0][ARC], a->T[1][ARC]});
  }
}
