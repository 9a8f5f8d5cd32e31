/* The relation of a node that slides on a beam (coupling/dependent_columns.py), and its path (scene/sliders.py). */

#pragma once

#include <stddef.h>
#include "algebra.h"

static int element_of(const Slider *a, double s) {
  int low = 0, high = a->elements;
  while (high - low > 1) {
    int middle = (low + high) / 2;
    if (s >= a->ends[middle]) low = middle; else high = middle;
  }
  return low;
}

/* Adds the element's polynomials, with these factors of 1, x, x^2 and x^3, to weights. */
static void add_weights(const Slider *a, int element, const double *powers, double factor, double *to) {
  const double *c = a->coefficients + (long)element * 4 * (3 * a->degree + 1);
  int first = a->degree * (element - 1) - a->first;
  for (int k = 0; k <= 3 * a->degree; ++k, c += 4) {
    if (first + k < 0 || first + k >= a->width) continue;
    double sum = c[0] * powers[0] + c[1] * powers[1] + c[2] * powers[2] + c[3] * powers[3];
    to[first + k] += factor * sum;
  }
}

/* The weights at the start (0) or at the end (1) of a step, or with the order 1 their slopes. */
static void weigh_place(const Slider *a, int end, int order, Weight *w) {
  int element = a->element[end];
  double begin = a->ends[element], h = a->ends[element + 1] - begin, x = ((end ? a->s1 : a->s0) - begin) / h;
  double P[3][4] = {{1, x, x * x, x * x * x}, {0, 1, 2 * x, 3 * x * x}, {0, 0, 2, 6 * x}}, per = order ? 1 / h : 1;
  const double *powers = P[order], *slope = P[order + 1];
  WeightPart *part = w->part;
  memset(w, 0, offsetof(Weight, part));
  w->parts = 1, part->element = element;
  for (int i = 0; i < 4; ++i) {
    part->factor[i] = per * powers[i];
    part->begin_slopes[i] = per * (slope[i] * (x - 1) + order * powers[i]) / h;
    part->end_slopes[i] = -per * (slope[i] * x + order * powers[i]) / h;
  }
  add_weights(a, element, powers, per, w->of);
  add_weights(a, element, slope, per / h, w->by[end]);
}

/* The quotient of the change of the weights `at` both ends and the slide between them, element by element, so that no difference of
   equal numbers is taken. */
static void weigh_quotient(const Slider *a, const Weight *at, Weight *w) {
  int e0 = a->element[0], e1 = a->element[1], step = e1 < e0 ? -1 : 1;
  double slide = a->slide;
  memset(w, 0, offsetof(Weight, part));
  for (int e = e0; e != e1 + step; e += step) {
    WeightPart *part = w->part + w->parts++;
    int first = e == e0, last = e == e1, alone = first && last;
    double begin = a->ends[e], h = a->ends[e + 1] - begin, x = first ? (a->s0 - begin) / h : step < 0;
    double y = last ? (a->s1 - begin) / h : step > 0, share = alone ? 1 / h : (y - x) / slide;
    double mean[] = {0, 1, x + y, x * x + x * y + y * y}, by0[] = {0, 0, 1, 2 * x + y}, by1[] = {0, 0, 1, x + 2 * y};
    double grows = alone ? share / h : (last * (y - 1) - first * (x - 1)) / (h * slide);
    double shrinks = alone ? share / h : (last * y - first * x) / (h * slide);
    part->element = e;
    for (int i = 0; i < 4; ++i) {
      part->factor[i] = share * mean[i];
      part->begin_slopes[i] = grows * mean[i] + share * (first * by0[i] * (x - 1) + last * by1[i] * (y - 1)) / h;
      part->end_slopes[i] = -shrinks * mean[i] - share * (first * by0[i] * x + last * by1[i] * y) / h;
    }
    add_weights(a, e, mean, share, w->of);
    if (alone) add_weights(a, e, by0, share / h, w->by[0]), add_weights(a, e, by1, share / h, w->by[1]);
  }
  if (e0 == e1) return;
  for (int k = 0; k < a->width; ++k)
    w->by[0][k] = (w->of[k] - at[0].by[0][k]) / slide, w->by[1][k] = (at[1].by[1][k] - w->of[k]) / slide;
  for (int end = 0; fabs(slide) <= 1e-6 * (a->ends[e0 + 1] - a->ends[e0]) && end < 2; ++end) {
    Weight slopes;
    weigh_place(a, end, 1, &slopes);
    for (int k = 0; k < a->width; ++k) w->by[end][k] = slopes.by[end][k] / 2;
  }
}

/* x / sin(x) and its derivative, smooth at 0. */
static double over_sine(double x) {
  return fabs(x) < 1e-4 ? 1 + x * x / 6 : x / sin(x);
}

static double over_sine_slope(double x) {
  return fabs(x) < 1e-2 ? x / 3 + 7 * x * x * x / 90 : (1 - x / tan(x)) / sin(x);
}

/* Elements of both ends of a step, of which it may pass so many; the first node of the window. */
static void begin_window(Slider *a) {
  int first = element_of(a, a->s0), last = element_of(a, a->s1), limit = a->elements - (a->width - 1) / a->degree;
  last = last > first + a->most ? first + a->most : last < first - a->most ? first - a->most : last;
  int low = (first < last ? first : last) - 1;
  a->element[0] = first, a->element[1] = last;
  a->first = a->degree * (low < 0 ? 0 : low > limit ? limit : low);
}

/* The part of the virtual displacement with the chord, which makes it a rotation for a rotation. */
static void relate_chord(Slider *a, Relation *o) {
  int n = a->width;
  double r[2], square;
  o->from = a->degree * a->element[0] - a->first, o->to = o->from + a->degree;
  for (int i = 0; i < 2; ++i) {
    r[i] = (o->x[0][i][o->to] + o->x[1][i][o->to] - o->x[0][i][o->from] - o->x[1][i][o->from]) / 2;
    o->Dr[i] = o->D[i][o->to] - o->D[i][o->from];
  }
  square = r[0] * r[0] + r[1] * r[1];
  o->Ds = a->slide, o->w[0] = -r[1] / square, o->w[1] = r[0] / square;
  o->z[0] = -product_of(n, o->along->of, o->D[1]) / 4, o->z[1] = product_of(n, o->along->of, o->D[0]) / 4;
  o->Dalpha = o->w[0] * o->Dr[0] + o->w[1] * o->Dr[1];
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      o->turn[i][j] = ((i > j) - (i < j) - 2 * o->w[i] * r[j]) / square;
      a->virtual_map[i][j * n + o->to] += o->Ds * o->z[i] * o->w[j];
      a->virtual_map[i][j * n + o->from] -= o->Ds * o->z[i] * o->w[j];
    }
    a->virtual_map[i][ARC] -= o->z[i] * o->Dalpha;
  }
}

/* The virtual rotation that gives 2 tan(Dpsi_c/2) for that of the nodes. */
static void relate_turn(Slider *a, Relation *o) {
  int n = a->width;
  for (int k = 0; k < n; ++k) o->half[k] = o->D[2][k] / 2;
  double y = product_of(n, o->mean, o->half), y_c = a->increment[2] / 2, u = y_c - y;
  o->total = 0;
  for (int k = 0; k < n; ++k) {
    double x = o->half[k] - y, c = cos(o->half[k]), tilt = o->mean[k] * over_sine_slope(x) * c;
    o->per_mean[k] = over_sine(x) * c, o->y_slopes[k] = -tilt;
    o->half_slopes[k] = tilt - o->mean[k] * over_sine(x) * sin(o->half[k]);
    o->total += o->mean[k] * o->per_mean[k];
  }
  for (int k = 0; k < n; ++k) a->virtual_map[2][2 * n + k] = o->mean[k] * o->per_mean[k] / o->total;
  double bend = over_sine_slope(u) / over_sine(u);
  o->turn_slopes[0] = 1 / (over_sine(u) * cos(y_c) * cos(y)), o->along_turn = o->axis[2] * o->turn_slopes[0];
  o->turn_slopes[1] = o->along_turn * (tan(y_c) - bend), o->turn_slopes[2] = o->along_turn * (tan(y) + bend);
  a->virtual_map[2][ARC] = o->along_turn;
}

/* Increment of the node for that of its beam and of the arc length, its derivatives T and the virtual increment. */
static void slide_on(const Scheme *scheme, const State *state, Slider *a, const double *D) {
  Relation *o = &a->relation;
  int n = a->width, exact = scheme->level == 0.5;
  double change[WINDOW_NODES]; /* of weights by the slide: it keeps the digits of small steps */
  begin_window(a);
  weigh_place(a, 0, 0, o->at), weigh_place(a, 1, 0, o->at + 1);
  weigh_quotient(a, o->at, o->along), memcpy(change, o->along->of, n * sizeof(double));
  if (exact) o->along[1] = o->along[0]; else weigh_place(a, 0, 1, o->along), weigh_place(a, 1, 1, o->along + 1);
  o->exact = exact, o->share[0] = 1 - scheme->level, o->share[1] = scheme->level;
  memset(a->T, 0, sizeof a->T), memset(a->virtual_map, 0, sizeof a->virtual_map);
  for (int k = 0; k < n; ++k) {
    o->mean[k] = o->share[0] * o->at[0].of[k] + o->share[1] * o->at[1].of[k];
    for (int i = 0; i < 3; ++i) {
      int node = a->first + k, dof = a->dofs[3 * node + i];
      o->x[0][i][k] = state->q[dof] + (i < 2 ? a->position[2 * node + i] : a->angle[node]);
      o->D[i][k] = D[dof], o->x[1][i][k] = o->x[0][i][k] + D[dof];
    }
  }
  for (int i = 0; i < a->components; ++i) {
    a->increment[i] = product_of(n, o->at[1].of, o->D[i]) + a->slide * product_of(n, change, o->x[0][i]);
    memcpy(a->T[i] + i * n, o->at[1].of, n * sizeof(double));
    memcpy(a->virtual_map[i] + i * n, o->mean, n * sizeof(double));
    a->T[i][ARC] = product_of(n, o->at[1].by[1], o->x[1][i]);
    o->axis[i] = 0;
    for (int end = 0; end < 2; ++end) o->axis[i] += o->share[end] * product_of(n, o->along[end].of, o->x[end][i]);
    a->virtual_map[i][ARC] = o->axis[i];
  }
  if (exact) relate_chord(a, o);
  o->turned = a->components == 3 && exact && scheme->rule == 0;
  if (o->turned) relate_turn(a, o);
}

/* Derivatives by the end of the step of virtual_map^T F for the force F, after `slide_on`. */
static void find_second(const Slider *a, Second *h) {
  const Relation *o = &a->relation;
  const Weight *last = o->at + 1;
  const double *F = a->force, *Q = o->along->of;
  int n = a->width, turn = 2 * n;
  double axis_s[3], mean_s[WINDOW_NODES], late = o->share[1];
  memset(h, 0, sizeof *h);
  for (int k = 0; k < n; ++k) mean_s[k] = late * last->by[1][k];
  for (int i = 0; i < a->components; ++i) {
    axis_s[i] = 0;
    for (int end = 0; end < 2; ++end) axis_s[i] += o->share[end] * product_of(n, o->along[end].by[1], o->x[end][i]);
    if (i == 2 && o->turned) continue;
    h->square += F[i] * axis_s[i];
    for (int k = 0; k < n; ++k) {
      h->arc_slopes[i * n + k] = F[i] * mean_s[k];
      h->force_slopes[i * n + k] = F[i] * late * o->along[1].of[k];
    }
  }
  if (o->exact) {
    double G[2] = {F[1] / 4, -F[0] / 4}, Z = F[0] * o->z[0] + F[1] * o->z[1], Z_s = 0;
    for (int i = 0; i < 2; ++i) Z_s += G[i] * product_of(n, o->along->by[1], o->D[i]);
    h->square -= o->Dalpha * Z_s;
    for (int i = 0; i < 2; ++i) {
      for (int k = 0; k < n; ++k) {
        h->force_slopes[i * n + k] -= o->Dalpha * G[i] * Q[k];
        for (int j = 0; j < 2; ++j) h->right[i][j * n + k] += o->Ds * o->w[i] * G[j] * Q[k];
      }
      for (int f = 0; f < 2; ++f) {
        int node = i * n + (f ? o->to : o->from);
        double sign = f ? 1 : -1;
        h->left[i][node] = sign;
        h->arc_slopes[node] += sign * o->w[i] * (Z + o->Ds * Z_s);
        h->force_slopes[node] -= sign * Z * (o->w[i] + (o->turn[0][i] * o->Dr[0] + o->turn[1][i] * o->Dr[1]) / 2);
        for (int j = 0; j < 2; ++j) h->right[j][node] += sign * o->Ds * Z * o->turn[j][i] / 2;
      }
    }
  }
  if (!o->turned) return;
  double y_s = product_of(n, mean_s, o->half), y_c_s = product_of(n, last->by[1], o->x[1][2]) / 2, y_slope = 0, total_s = 0;
  double part_s[WINDOW_NODES], total_share = F[2] / o->total;
  for (int k = 0; k < n; ++k) {
    part_s[k] = mean_s[k] * o->per_mean[k] + o->y_slopes[k] * y_s;
    total_s += part_s[k], y_slope += o->y_slopes[k];
  }
  for (int k = 0; k < n; ++k) {
    double share = a->virtual_map[2][turn + k], y_by = o->mean[k] / 2;
    h->force_slopes[turn + k] = F[2] * (o->turn_slopes[0] * late * Q[k] + o->turn_slopes[1] * last->of[k] / 2 + o->turn_slopes[2] * y_by);
    h->arc_slopes[turn + k] = total_share * (part_s[k] - share * total_s);
    h->turn[turn + k] = total_share * o->half_slopes[k] / 2;
    h->left[2][turn + k] = o->y_slopes[k], h->right[2][turn + k] = total_share * y_by;
    h->left[3][turn + k] = share, h->right[3][turn + k] = -total_share * (o->half_slopes[k] / 2 + y_slope * y_by);
  }
  h->square += F[2] * (o->turn_slopes[0] * axis_s[2] + o->turn_slopes[1] * y_c_s + o->turn_slopes[2] * y_s);
}
