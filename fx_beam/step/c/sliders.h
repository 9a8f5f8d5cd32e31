/* Nodes that slide on beams (sliders.py). */

#pragma once

#include "algebra.h"
#include "slide_relation.h"

/* Degree of freedom that belongs to a local one; -1 for the arc length. */
static int local_dof(const Slider *a, int local) {
  int n = a->width;
  return local == a->components * n ? -1 : a->dofs[3 * (a->first + local % n) + local / n];
}

/* Change of the node's columns in z for small changes of all degrees of freedom, by T or Tv. Here and below a number is
   `apart` numbers behind the one before it, if there are others of other directions between. */
static void spread_slider(const Slider *a, const double (*T)[LOCAL], const double *change, double *z, int apart) {
  int s = a->components * a->width;
  for (int c = 0; c < a->components; ++c) {
    double total = T[c][s] * z[apart * a->column];
    for (int k = 0; k < s; ++k) total += T[c][k] * change[apart * local_dof(a, k)];
    z[apart * a->carried[c]] = total;
  }
}

/* The forces on the columns of a node, for values of T or Tv. */
static void find_held_force(const Slider *a, const double *values, const double *r, const double *out, double *force,
                            int apart) {
  for (int c = 0; c < a->components; ++c) {
    force[c] = out[apart * a->carried[c]];
    for (int k = a->entry_start[c]; k < a->entry_start[c + 1]; ++k)
      force[c] += a->entry_sign[k] * values[a->entry_value[k]] * r[apart * a->entry_row[k]];
  }
}

/* Adds a force of a node on its beam to forces r, and on its slide to `out`, by T or Tv. */
static void push_beam(const Slider *a, const double (*T)[LOCAL], const double *force, double *r, double *out, int apart) {
  int s = a->components * a->width;
  for (int c = 0; c < a->components; ++c) {
    for (int k = 0; k < s; ++k) r[apart * local_dof(a, k)] += force[c] * T[c][k];
    out[apart * a->column] += force[c] * T[c][s];
  }
}

/* Adds the forces on slides. */
static void push_columns(const Problem *p, double *out) {
  for (int i = p->points->nodal; i < p->points->all; ++i)
    out[p->points->of[i].column] += p->points->of[i].results[0];
}

/* Adds the forces of all sliding nodes. */
static void carry(const Problem *p, const Work *w, double *r, double *out) {
  for (int i = p->sliders - 1; i >= 0; --i) {
    Slider *a = p->slider + i;
    find_held_force(a, w->virtual_map, r, out, a->force, 1);
    push_beam(a, a->virtual_map, a->force, r, out, 1);
  }
}

/* Sets the axes across which forces of nodes on beams count for friction. */
static void set_axes(const Problem *p) {
  for (const Slider *a = p->slider; a < p->slider + p->sliders; ++a) {
    int s = a->components * a->width;
    fx_set_axis(p->points, a->joint, (double[]){a->virtual_map[0][s], a->virtual_map[1][s]});
  }
}

/* Whether a node leaves its beam in the step, or passes too many elements. */
static int leaves_beam(const Problem *p) {
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    double length = a->ends[a->elements], off = fmax(-a->s1, a->s1 - length);
    int passed = element_of(a, a->s1) - element_of(a, a->s0);
    if (off > 1e-9 * length || passed > a->most || passed < -a->most) return 1;
  }
  return 0;
}

/* Rate of the arc length at the start of the step. */
static double slider_rate(const Problem *p, const Slider *a) {
  double s = p->slides[a->joint], along[2] = {0}, apart[2], square;
  Weights weights;
  Slider at = *a;
  int e = element_of(a, s), low = e - 1, limit = a->elements - a->window;
  at.first = a->degree * (low < 0 ? 0 : low > limit ? limit : low);
  set_weights(&at, e, e, s, s, &weights);
  for (int i = 0; i < 2; ++i) apart[i] = p->v[a->node[i]];
  for (int k = 0; k < a->width; ++k)
    for (int i = 0; i < 2; ++i) {
      int dof = a->dofs[3 * (at.first + k) + i];
      along[i] += weights.slope1[k] * (a->position[2 * (at.first + k) + i] + p->q[dof]);
      apart[i] -= weights.at1[k] * p->v[dof];
    }
  square = along[0] * along[0] + along[1] * along[1];
  return (apart[0] * along[0] + apart[1] * along[1]) / square;
}
