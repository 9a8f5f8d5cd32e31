/* Nodes that slide on beams (sliders.py). */

#pragma once

#include "algebra.h"
#include "point_forces.h"
#include "slide_relation.h"
#include "track.h"

/* Degree of freedom that belongs to a local one; -1 for the arc length. */
static int local_dof(const Slider *a, int local) {
  int n = a->width;
  return local == a->components * n ? -1 : a->dofs[3 * (a->first + local % n) + local / n];
}

/* Change of the node's columns in z for small changes of all degrees of freedom, by T or Tv. */
static void spread_slider(const Slider *a, const double (*T)[LOCAL], const double *change, double *z) {
  int s = a->components * a->width;
  for (int c = 0; c < a->components; ++c) {
    double total = T[c][s] * z[a->column];
    for (int k = 0; k < s; ++k) total += T[c][k] * change[local_dof(a, k)];
    z[a->carried[c]] = total;
  }
}

/* Adds the forces on slides. */
static void push_columns(const Problem *p, double *out) {
  for (int i = p->points->nodal; i < p->points->all; ++i)
    out[p->points->of[i].column] += p->points->of[i].results[0];
}

/* Adds the forces of all sliding nodes, for the forces on nodes: those on their columns pass on to their beams, in `loaded`,
   and along these. */
static void load_beams(const Problem *p, const Work *w, const double *on_nodes, double *out) {
  double *r = memcpy(w->loaded, on_nodes, p->dofs * sizeof(double));
  for (int i = p->sliders - 1; i >= 0; --i) {
    Slider *a = p->slider + i;
    int s = a->components * a->width;
    for (int c = 0; c < a->components; ++c) {
      a->force[c] = out[a->carried[c]];
      for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
        a->force[c] += a->entry_sign[k] * w->virtual_map[a->entry_value[k]] * r[a->entry_row[k]];
    }
    for (int c = 0; c < a->components; ++c) {
      for (int k = 0; k < s; ++k) r[local_dof(a, k)] += a->force[c] * a->virtual_map[c][k];
      out[a->column] += a->force[c] * a->virtual_map[c][s];
    }
  }
}

/* The slide of a joint at the level of a step. */
static double slide_at_level(const Problem *p, const Work *w, int j) {
  return at(p->slides, p->slide_of[j]) + p->level * at(w->z, p->slide_column[j]);
}

/* The axis across which forces on a joint's slide count for friction. */
static void set_axis(const PointForces *points, int joint, Two axis) {
  for (PointForce *e = points->of; e < points->of + points->all; ++e)
    for (int i = 0; e->load == joint && e->slide >= 0 && i < 2; ++i) e->load_axis[i] = axis[i] / hypot(axis[0], axis[1]);
}

/* Sets the axes across which forces on curves count for friction. */
static void set_axes(const Problem *p, const Work *w) {
  for (int j = 0; j < p->joints; ++j) {
    double d = slide_at_level(p, w, j);
    if (p->track[j]) set_axis(p->points, p->slide_of[j], track_of(p->track[j], p->axis + 2 * j, d, d).chord);
  }
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) {
    int s = a->components * a->width;
    set_axis(p->points, a->joint, (Two){a->virtual_map[0][s], a->virtual_map[1][s]});
  }
}

/* Whether a node leaves its beam in the step, or passes too many elements. */
static int leaves_beam(const Problem *p) {
  for (int i = 0; HAS(SLIDERS) && i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    double length = a->ends[a->elements], off = fmax(-a->s1, a->s1 - length);
    int passed = element_of(a, a->s1) - element_of(a, a->s0);
    if (off > 1e-9 * length || passed > a->most || passed < -a->most) return 1;
  }
  return 0;
}

/* The relations of all nodes on beams at the start of a step. */
static void begin_sliders(const Problem *p, const Work *w) {
  memset(w->D, 0, p->dofs * sizeof(double));
  for (Slider *a = p->slider; a < p->slider + p->sliders; ++a) {
    a->s0 = a->s1 = p->slides[a->joint], a->slide = 0;
    slide_on(a, p->q, w->D);
  }
}

/* Rate of the arc length at the start of the step, after `begin_sliders`. */
static double slider_rate(const Problem *p, const Slider *a) {
  int s = a->components * a->width;
  Two along = {a->T[0][s], a->T[1][s]}, apart = pair_of(p->v, a->node);
  for (int k = 0; k < 2 * a->width; ++k) apart -= (Two){a->T[0][k], a->T[1][k]} * p->v[local_dof(a, k)];
  return dot2(apart, along) / dot2(along, along);
}

/* Rate of a slide at the start of a step (scene/joints.py). */
static double rate_of_slide(const Problem *p, int j) {
  int a = p->carrier[j], b = p->carried_node[j];
  Two v = {at(p->v, b - 2) - at(p->v, a - 2), at(p->v, b - 1) - at(p->v, a - 1)};
  double d = p->slides[p->slide_of[j]], spin = at(p->v, a), turn = at(p->q, a);
  Track track = track_of(p->track[j], p->axis + 2 * j, d, d);
  Two arm = pair(p->offset + 2 * j) + track.place, seen = turn_by((Two){cos(turn), -sin(turn)}, v);
  return dot2(track.chord, seen + spin * (Two){arm[1], -arm[0]});
}

/* At mid-step forces depend on mean rates alone. */
static void find_slide_rates(const Problem *p, const Work *w) {
  if (p->points->all == p->points->nodal || p->level == 0.5) return;
  for (int j = 0; j < p->joints; ++j)
    if (p->slide_column[j] >= 0) p->slide_rate[p->slide_of[j]] = rate_of_slide(p, j);
  if (HAS(SLIDERS)) begin_sliders(p, w);
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) p->slide_rate[a->joint] = slider_rate(p, a);
}
