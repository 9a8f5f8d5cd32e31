/* What the relation of a node that slides on a beam (slide_relation.h) depends on at both ends of a sub-step, for
   derivatives of a run. It is the same backwards in time, with the same chord: so the derivatives by the start are
   those by the end of this step. */

#pragma once

#include "couplings.h"
#include "path_derivatives.h"

/* At the start (0) and at the end (1): T, and the derivatives of Tv^T F by the local degrees of freedom there. */
typedef struct {
  double T[2][3][LOCAL];
  Second of_force[2];
} SlideEnds;

/* The configuration at the end in w->scratch, and the increments backwards in w->correction. */
static void turn_back(const Problem *p, const Work *w) {
  for (int i = 0; i < p->dofs && p->sliders; ++i)
    w->scratch[i] = p->q[i] + w->D[i], w->correction[i] = -w->D[i];
}

/* The derivatives of Tv^T F by both ends for the force in a slider, after `turn_back`. */
static void find_second(const Problem *p, const Work *w, const Slider *a, Second of_force[2]) {
  Slider own = *a, reversed = *a;
  slide_on(&own, p->q, w->D, &of_force[1]);
  reversed.s0 = a->s1, reversed.s1 = a->s0;
  /* At other levels Tv depends on the end alone. */
  if (p->level == 0.5) slide_by_chord(&reversed, element_of(a, a->s0), w->scratch, w->correction, &of_force[0]);
  else memset(&of_force[0], 0, sizeof(Second));
}

/* The derivatives of all nodes, for the forces F of the last `project`. */
static void find_slide_ends(const Problem *p, const Work *w, SlideEnds *ends) {
  turn_back(p, w);
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    Slider reversed = *a;
    memcpy(ends[i].T[1], a->T, sizeof a->T);
    reversed.s0 = a->s1, reversed.s1 = a->s0;
    slide_by_chord(&reversed, element_of(a, a->s0), w->scratch, w->correction, 0);
    memcpy(ends[i].T[0], reversed.T, sizeof a->T);
    find_second(p, w, a, ends[i].of_force);
  }
}

/* The column of the slide in Tv is the axis of the beam A, and w . A the work of a force w on a slide of 1: a node with
   this force. */
static Slider with_weight(const Slider *a, const double *weight) {
  Slider own = *a;
  memset(own.force, 0, sizeof own.force);
  memcpy(own.force, weight, 2 * sizeof(double));
  return own;
}

/* Adds the derivatives of the weighted axes [node][2] by both ends, after `turn_back`. */
static void pull_axes(const Problem *p, const Work *w, const double *weights, double *const nodal[2],
                      double *const columns[2]) {
  Second of_force[2];
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    int s = a->components * a->width;
    if (weights[2 * i] == 0 && weights[2 * i + 1] == 0) continue;
    Slider own = with_weight(a, weights + 2 * i);
    find_second(p, w, &own, of_force);
    for (int end = 0; end < 2; ++end) {
      for (int k = 0; k < s; ++k) nodal[end][local_dof(a, k)] += of_force[end].of_s[k];
      columns[end][a->column] += of_force[end].square;
    }
  }
}

/* The change of a weighted axis for those at both ends (`apart`: spread_slider), and of the numbers of its path if they
   change. */
static double change_of_axis(const Problem *p, const Work *w, const Slider *a, const double *weight,
                             const double *const nodal[2], const double *const columns[2], double *numbers, int apart) {
  int s = a->components * a->width;
  Slider own = with_weight(a, weight);
  Second of_force[2];
  double change = 0, along[LOCAL] = {0};
  turn_back(p, w), find_second(p, w, &own, of_force);
  for (int end = 0; end < 2; ++end) {
    for (int k = 0; k < s; ++k) change += of_force[end].of_s[k] * nodal[end][apart * local_dof(a, k)];
    change += of_force[end].square * columns[end][apart * a->column];
  }
  if (!numbers) return change;
  PathRead changes, by = {0};
  WindowEnds ends;
  along[s] = 1;
  follow_path(a, &changes, numbers, 0), find_window_ends(a, p->q, w->D, &ends);
  work_by_read(&own, &ends, along, &by);
  return change + product_of_reads(&by, &changes);
}

/* Sets y = H x for these derivatives H, or y = H^T x. */
static void times_second(const Slider *a, const Second *h, int transposed, const double *x, double *y) {
  int s = a->components * a->width;
  const double *of_s = transposed ? h->by_s : h->of_s, *by_s = transposed ? h->of_s : h->by_s;
  y[s] = h->square * x[s];
  for (int k = 0; k < s; ++k) y[s] += of_s[k] * x[k], y[k] = by_s[k] * x[s] + h->turn[k] * x[k];
  for (int r = 0; r < a->products; ++r) {
    const double *left = transposed ? h->right[r] : h->left[r], *right = transposed ? h->left[r] : h->right[r];
    double sum = dot(s, right, x);
    for (int k = 0; k < s; ++k) y[k] += left[k] * sum;
  }
}

/* Local ones of all degrees of freedom and columns. */
static void localise(const Slider *a, const double *nodal, const double *columns, int apart, double *x) {
  int s = a->components * a->width;
  for (int k = 0; k < s; ++k) x[k] = nodal[apart * local_dof(a, k)];
  x[s] = columns[apart * a->column];
}

/* Adds the derivatives by both ends of the work of the forces F on virtual displacements. */
static void pull_slides(const Problem *p, const SlideEnds *ends, const double *omega, const double *mu,
                        double *const nodal[2], double *const columns[2]) {
  double x[LOCAL], y[LOCAL];
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    int s = a->components * a->width;
    localise(a, omega, mu, 1, x);
    for (int end = 0; end < 2; ++end) {
      times_second(a, &ends[i].of_force[end], 1, x, y);
      for (int k = 0; k < s; ++k) nodal[end][local_dof(a, k)] += y[k];
      columns[end][a->column] += y[s];
    }
  }
}

/* Adds to the derivatives by paths those that the places of nodes on beams have, at one end of a sub-step, for forces
   [node][3] on them, and with omega those of their forces' work, and of weighted axes [node][2]. */
static void pull_paths(const Problem *p, const Work *w, int end, const double *forces, const double *omega,
                       const double *mu, const double *axes, double *to) {
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    PathRead by = {0};
    WindowEnds ends;
    double x[LOCAL];
    find_window_ends(a, p->q, w->D, &ends);
    if (omega) {
      localise(a, omega, mu, 1, x);
      work_by_read(a, &ends, x, &by);
      Slider own = with_weight(a, axes + 2 * i);
      memset(x, 0, sizeof x), x[a->components * a->width] = 1;
      work_by_read(&own, &ends, x, &by);
    }
    place_by_read(a, &ends, end, forces + 3 * i, &by);
    follow_path(a, &by, to + path_start(p, i), 1);
  }
}

/* Adds to the changes of forces r and of those on columns what Tv gives by the changes of the configuration and the
   columns at both ends, and of `paths` if they change. */
static void change_slides(const Problem *p, const Work *w, const SlideEnds *ends, const double *const nodal[2],
                          const double *const columns[2], double *paths, double *r, double *out, int apart) {
  double x[LOCAL], y[LOCAL];
  for (int i = 0; i < p->sliders; ++i) {
    const Slider *a = p->slider + i;
    int s = a->components * a->width;
    if (paths) change_of_shape(p, w, a, paths + path_start(p, i), r, out, apart);
    for (int end = 0; end < 2; ++end) {
      localise(a, nodal[end], columns[end], apart, x);
      times_second(a, &ends[i].of_force[end], 0, x, y);
      for (int k = 0; k < s; ++k) r[apart * local_dof(a, k)] += y[k];
      out[apart * a->column] += y[s];
    }
  }
}
