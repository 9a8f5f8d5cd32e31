/* Derivatives of the relation of a node that slides on a beam (slide_relation.h) by both ends of a sub-step and by the
   shape of the beam: arc lengths, positions, coefficients and angles of its path, in the order of BeamAxis.numbers
   (sliders.py). */

#pragma once

#include "blocks.h"

/* Where its laws are put, and what they read: configurations and slides at both ends, numbers of its path, its numbers. */
typedef struct { Block *b; const Slider *a; int q[2], slide[2], arcs, positions, coefficients, angles, numbers; } SlideLaws;

static SlideLaws laws_of(Block *b, const Slider *sliders, const Layout *at, int i) {
  const Slider *a = sliders + i;
  int nodes = a->degree * a->elements + 1, arcs = at->paths + a->path, positions = arcs + a->elements + 1;
  int coefficients = positions + 2 * nodes, angles = coefficients + 4 * a->elements * (3 * a->degree + 1);
  return (SlideLaws){b, a, {at->q, at->q1}, {at->Y + a->column, at->Y1 + a->column}, arcs, positions, coefficients, angles,
                     at->slides + i * SLIDE_NUMBERS};
}

static void put_weights(const SlideLaws *s, const Weight *w, int to) {
  const Slider *a = s->a;
  int each = 3 * a->degree + 1;
  for (int k = 0; k < a->width; ++k)
    for (int end = 0; end < 2; ++end) put(s->b, s->slide[end], to + k, w->by[end][k]);
  for (const WeightPart *part = w->part; part < w->part + w->parts; ++part)
    for (int i = 0; i < each; ++i) {
      int k = a->degree * (part->element - 1) - a->first + i, first = 4 * (part->element * each + i);
      if (k < 0 || k >= a->width) continue;
      put(s->b, s->arcs + part->element, to + k, product_of(4, a->coefficients + first, part->begin_slopes));
      put(s->b, s->arcs + part->element + 1, to + k, product_of(4, a->coefficients + first, part->end_slopes));
      for (int m = 0; m < 4; ++m) put(s->b, s->coefficients + first + m, to + k, part->factor[m]);
    }
}

/* A component of the configuration of a node of the window. */
static void put_node(const SlideLaws *s, int end, int i, int k, int to, double slope) {
  int node = s->a->first + k;
  put(s->b, s->q[end] + s->a->dofs[3 * node + i], to, slope);
  put(s->b, i < 2 ? s->positions + 2 * node + i : s->angles + node, to, slope);
}

/* A component at one end, summed with weights. */
static void put_sum(const SlideLaws *s, const Weight *w, int weights, int end, int i, int to, double factor) {
  for (int k = 0; k < s->a->width; ++k) {
    put(s->b, s->numbers + weights + k, to, factor * s->a->relation.x[end][i][k]);
    put_node(s, end, i, k, to, factor * w->of[k]);
  }
}

/* Derivatives by the mean chord and by its increment. */
static void put_chord(const SlideLaws *s, int to, const double *mean_slope, const double *increment_slope) {
  const Relation *o = &s->a->relation;
  for (int i = 0; i < 2; ++i)
    for (int end = 0; end < 2; ++end) {
      double slope = mean_slope[i] / 2 + (end ? increment_slope[i] : -increment_slope[i]);
      put_node(s, end, i, o->to, to, slope), put_node(s, end, i, o->from, to, -slope);
    }
}

/* The weights of a node at the start (0) or at the end (1). */
static void put_weights_at(Block *b, const Slider *sliders, const Layout *at, int i, int end) {
  SlideLaws s = laws_of(b, sliders, at, i);
  put_weights(&s, s.a->relation.at + end, s.numbers + AT + end * WINDOW_NODES);
}

/* Derivatives of the place of a node that slides: of its columns. */
static void put_place(Block *b, const Slider *sliders, const Layout *at, int i, int end) {
  SlideLaws s = laws_of(b, sliders, at, i);
  const Weight *w = s.a->relation.at + end;
  int weights = AT + end * WINDOW_NODES;
  for (int c = 0; c < s.a->components; ++c) {
    int to = (end ? at->Y1 : at->Y) + s.a->carried[c];
    put_sum(&s, w, weights, end, c, to, 1);
    put(b, at->places + 3 * i + c, to, -1);
  }
}

/* The virtual slide of 1, and forces on the chord for the force F of the node. */
static void put_axis(const SlideLaws *s) {
  const Slider *a = s->a;
  const Relation *o = &a->relation;
  int exact = o->exact, axis = s->numbers + AXIS, apart = s->numbers + APART, turn = s->numbers + TURN;
  double F[2] = {a->force[0], a->force[1]}, Z = F[0] * o->z[0] + F[1] * o->z[1], chord_slopes[2], none[2] = {0};
  for (int end = 0; end < (exact ? 1 : 2); ++end) put_weights(s, o->along + end, s->numbers + ALONG + end * WINDOW_NODES);
  for (int i = 0; i < a->components; ++i)
    for (int end = 0; end < 2; ++end)
      put_sum(s, o->along + end, ALONG + (exact ? 0 : end * WINDOW_NODES), end, i, axis + i, o->share[end]);
  if (!exact) return;
  for (int i = 0; i < 2; ++i) {
    put_sum(s, o->along, ALONG, 0, i, apart + i, -1), put_sum(s, o->along, ALONG, 1, i, apart + i, 1);
    chord_slopes[i] = o->turn[0][i] * o->Dr[0] + o->turn[1][i] * o->Dr[1];
  }
  put_chord(s, turn, chord_slopes, o->w);
  put(s->b, apart + 1, axis, o->Dalpha / 4), put(s->b, apart, axis + 1, -o->Dalpha / 4);
  for (int i = 0; i < 2; ++i) {
    int to = s->numbers + ON_CHORD + i;
    double mean_slope[2] = {o->Ds * Z * o->turn[i][0], o->Ds * Z * o->turn[i][1]};
    put(s->b, turn, axis + i, -o->z[i]);
    put(s->b, apart, to, o->Ds * o->w[i] * F[1] / 4), put(s->b, apart + 1, to, -o->Ds * o->w[i] * F[0] / 4);
    put(s->b, s->slide[1], to, Z * o->w[i]), put(s->b, s->slide[0], to, -Z * o->w[i]);
    put_chord(s, to, mean_slope, none);
  }
}

/* The moments on the nodes and along the slide, for a rotation by 2 tan(Dpsi/2). */
static void put_turn(const SlideLaws *s, int r, int along) {
  const Slider *a = s->a;
  const Relation *o = &a->relation;
  int y = s->numbers + MEAN_TURN, y_c = s->numbers + NODE_TURN, total = s->numbers + TOTAL;
  for (int end = 0; end < 2; ++end) {
    double sign = end ? 0.5 : -0.5;
    put_sum(s, o->at + end, AT + end * WINDOW_NODES, end, 2, y_c, sign);
    for (int k = 0; k < a->width; ++k) {
      int weight = s->numbers + AT + end * WINDOW_NODES + k, turned = s->q[end] + local_dof(a, 2 * a->width + k);
      put(s->b, weight, y, o->share[end] * o->half[k]), put(s->b, turned, y, sign * o->mean[k]);
      put(s->b, weight, s->numbers + PARTS + k, o->share[end] * o->per_mean[k]);
      put(s->b, turned, s->numbers + PARTS + k, sign * o->half_slopes[k]);
    }
  }
  for (int k = 0; k < a->width; ++k) {
    put(s->b, y, s->numbers + PARTS + k, o->y_slopes[k]);
    put(s->b, s->numbers + PARTS + k, total, 1);
  }
  for (int k = 0, local = 2 * a->width; k < a->width; ++k, ++local) {
    put(s->b, s->numbers + PARTS + k, r + local_dof(a, local), a->force[2] / o->total);
    put(s->b, total, r + local_dof(a, local), -a->force[2] / o->total * a->virtual_map[2][local]);
  }
  put(s->b, s->numbers + AXIS + 2, along, a->force[2] * o->turn_slopes[0]);
  put(s->b, y_c, along, a->force[2] * o->turn_slopes[1]), put(s->b, y, along, a->force[2] * o->turn_slopes[2]);
}

/* The forces on the beam and along it that a node exerts with the force F, for changes of Tv; its axis. */
static void put_slide(Block *b, const Slider *sliders, const Layout *at, int i) {
  SlideLaws s = laws_of(b, sliders, at, i);
  const Slider *a = s.a;
  const Relation *o = &a->relation;
  int n = a->width, along = at->R + a->column;
  put_axis(&s);
  for (int c = 0; c < a->components; ++c) {
    if (c < 2) put(b, s.numbers + AXIS + c, at->axes + 2 * i + c, 1);
    if (c < 2 && o->exact)
      put(b, s.numbers + ON_CHORD + c, at->r + local_dof(a, c * n + o->to), 1),
          put(b, s.numbers + ON_CHORD + c, at->r + local_dof(a, c * n + o->from), -1);
    if (c == 2 && o->turned) continue;
    put(b, s.numbers + AXIS + c, along, a->force[c]);
    for (int k = 0; k < n; ++k)
      for (int end = 0; end < 2; ++end)
        put(b, s.numbers + AT + end * WINDOW_NODES + k, at->r + local_dof(a, c * n + k), o->share[end] * a->force[c]);
  }
  if (o->turned) put_turn(&s, at->r, along);
}
