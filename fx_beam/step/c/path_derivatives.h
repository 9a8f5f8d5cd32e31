/* What the relation of a node that slides on a beam (slide_relation.h) has of the shape of the beam, for derivatives of
   a run: arc lengths, positions, coefficients and angles of its path, in the order of Path.numbers (path.py). */

#pragma once

#include "blocks.h"

/* What it reads of a path in a sub-step, or derivatives by that: weights of the window's nodes (Weights), their
   positions and angles. */
enum { AT0, AT1, SLOPE0, SLOPE1, QUOTIENT, WEIGHTS_READ, ANGLE = WEIGHTS_READ + 2, READ };
typedef struct {
  double of[READ][WINDOW_NODES]; /* x and y before the angles */
} PathRead;

/* A part of weights: the coefficients of an element times these factors, and those by the arc lengths of its ends. */
typedef struct {
  int element;
  double factor[4], by_begin[4], by_end[4];
} WeightPart;

/* Powers of x, their slopes and bends. */
static void powers_of(double x, double P[3][4]) {
  double own[3][4] = {{1, x, x * x, x * x * x}, {0, 1, 2 * x, 3 * x * x}, {0, 0, 2, 6 * x}};
  memcpy(P, own, sizeof own);
}

/* The part at the coordinate x of an element: value (0) or slope (1). */
static WeightPart part_at(const Slider *a, int element, double x, int order) {
  double P[3][4], h = a->ends[element + 1] - a->ends[element], per = order ? 1 / h : 1;
  WeightPart part = {.element = element};
  powers_of(x, P);
  for (int i = 0; i < 4; ++i) {
    part.factor[i] = per * P[order][i];
    part.by_begin[i] = per * (P[order + 1][i] * (x - 1) + order * P[order][i]) / h;
    part.by_end[i] = -per * (P[order + 1][i] * x + order * P[order][i]) / h;
  }
  return part;
}

/* The parts of the quotient of weights and arc length; returns their number. */
static int parts_of_quotient(const Slider *a, int e0, int e1, WeightPart *parts) {
  const double *s = a->ends;
  double h = s[e0 + 1] - s[e0], x0 = (a->s0 - s[e0]) / h, x1 = (a->s1 - s[e1]) / (s[e1 + 1] - s[e1]);
  int count = 0, way = e1 > e0 ? 1 : -1;
  if (e0 == e1) {
    double mean[] = {0, 1, x0 + x1, x0 * x0 + x0 * x1 + x1 * x1};
    double by0[] = {0, 0, 1, 2 * x0 + x1}, by1[] = {0, 0, 1, x0 + 2 * x1};
    parts->element = e0;
    for (int i = 0; i < 4; ++i) {
      parts->factor[i] = mean[i] / h;
      parts->by_begin[i] = (by0[i] * (x0 - 1) + by1[i] * (x1 - 1) + mean[i]) / (h * h);
      parts->by_end[i] = -(by0[i] * x0 + by1[i] * x1 + mean[i]) / (h * h);
    }
    return 1;
  }
  for (int e = e0; e != e1 + way; e += way, ++count) {
    WeightPart *to = parts + count, from = part_at(a, e, e == e0 ? x0 : way < 0, 0), last = part_at(a, e, e == e1 ? x1 : way > 0, 0);
    to->element = e;
    for (int i = 0; i < 4; ++i) {
      to->factor[i] = (last.factor[i] - from.factor[i]) / (a->s1 - a->s0);
      to->by_begin[i] = ((e == e1) * last.by_begin[i] - (e == e0) * from.by_begin[i]) / (a->s1 - a->s0);
      to->by_end[i] = ((e == e1) * last.by_end[i] - (e == e0) * from.by_end[i]) / (a->s1 - a->s0);
    }
  }
  return count;
}

/* All parts of the weights `of`; returns their number. */
static int weight_parts(const Slider *a, int of, WeightPart *parts) {
  int e0, e1;
  elements_of(a, &e0, &e1);
  if (of == QUOTIENT) return parts_of_quotient(a, e0, e1, parts);
  int e = of == AT0 || of == SLOPE0 ? e0 : e1;
  double x = ((e == e0 && of != AT1 && of != SLOPE1 ? a->s0 : a->s1) - a->ends[e]) / (a->ends[e + 1] - a->ends[e]);
  *parts = part_at(a, e, x, of >= SLOPE0);
  return 1;
}

/* Follows all that the relation reads of a path: adds derivatives by numbers from those by what is read (`read` to
   `numbers`), or else sets the changes of what is read from those of the numbers. */
static void follow_path(const Slider *a, PathRead *read, double *numbers, int pulls) {
  WeightPart parts[WINDOW_NODES];
  int each = 3 * a->degree + 1;
  long nodes = (long)a->degree * a->elements + 1;
  double *position = numbers + a->elements + 1, *coefficients = position + 2 * nodes;
  double *angle = coefficients + 4L * a->elements * each;
  if (!pulls) memset(read, 0, sizeof *read);
  for (int of = 0; of < WEIGHTS_READ; ++of)
    for (int k = 0, count = weight_parts(a, of, parts); k < count; ++k) {
      const WeightPart *part = parts + k;
      int first = a->degree * (part->element - 1) - a->first;
      const double *c = a->coefficients + (long)part->element * 4 * each;
      double *by_c = coefficients + (long)part->element * 4 * each, *end = numbers + part->element;
      for (int i = 0; i < each; ++i, c += 4, by_c += 4) {
        if (first + i < 0 || first + i >= a->width) continue;
        double *value = read->of[of] + first + i;
        for (int m = 0; m < 4; ++m)
          if (pulls) {
            by_c[m] += *value * part->factor[m];
            end[0] += *value * c[m] * part->by_begin[m], end[1] += *value * c[m] * part->by_end[m];
          } else {
            *value += by_c[m] * part->factor[m];
            *value += c[m] * (part->by_begin[m] * end[0] + part->by_end[m] * end[1]);
          }
      }
    }
  for (int k = 0; k < a->width; ++k)
    for (int i = 0; i < 3; ++i) {
      double *own = i < 2 ? position + 2 * (a->first + k) + i : angle + a->first + k, *value = &read->of[WEIGHTS_READ + i][k];
      if (pulls) *own += *value;
      else *value = *own;
    }
}

/* Configurations of the window at both ends: x, y and the angle, [component][node]. */
typedef struct {
  double start[3][WINDOW_NODES], end[3][WINDOW_NODES];
} WindowEnds;

static void find_window_ends(const Slider *a, const double *q, const double *D, WindowEnds *to) {
  for (int k = 0; k < a->width; ++k)
    for (int i = 0; i < 3; ++i) {
      int node = a->first + k, dof = a->dofs[3 * node + i];
      to->start[i][k] = q[dof] + (i < 2 ? a->position[2 * node + i] : a->angle[node]);
      to->end[i][k] = to->start[i][k] + D[dof];
    }
}

/* Adds the derivatives of the product of a force and the place of the node at the start (0) or at the end (1). */
static void place_by_read(const Slider *a, const WindowEnds *ends, int end, const double *force, PathRead *to) {
  Weights w;
  int e0, e1;
  elements_of(a, &e0, &e1), set_weights(a, e0, e1, a->s0, a->s1, &w);
  for (int i = 0; i < a->components; ++i)
    for (int k = 0; k < a->width; ++k) {
      to->of[end ? AT1 : AT0][k] += force[i] * (end ? ends->end : ends->start)[i][k];
      to->of[WEIGHTS_READ + i][k] += force[i] * (end ? w.at1 : w.at0)[k];
    }
}

/* Adds the derivatives of moment times virtual rotation (slide_rotation), for the virtual displacements x. */
static void turn_by_read(const Slider *a, const Weights *w, const WindowEnds *ends, const double *x, PathRead *to) {
  int n = a->width, exact = a->level == 0.5;
  double l = a->level, moment = a->force[2], by_slide = x[3 * n];
  const double *psi0 = ends->start[2], *psi1 = ends->end[2], *turns = x + 2 * n;
  if (!exact || !a->by_tangent) {
    for (int k = 0; k < n; ++k) {
      to->of[AT0][k] += (1 - l) * moment * turns[k], to->of[AT1][k] += l * moment * turns[k];
      if (exact) {
        to->of[QUOTIENT][k] += moment * by_slide * (psi0[k] + psi1[k]) / 2;
        to->of[ANGLE][k] += moment * by_slide * w->quotient[k];
      } else {
        to->of[SLOPE0][k] += (1 - l) * moment * by_slide * psi0[k], to->of[SLOPE1][k] += l * moment * by_slide * psi1[k];
        to->of[ANGLE][k] += moment * by_slide * ((1 - l) * w->slope0[k] + l * w->slope1[k]);
      }
    }
    return;
  }
  double half[WINDOW_NODES], mean[WINDOW_NODES], c[WINDOW_NODES], y = 0, y_c = 0, turn = 0, total = 0, all = 0, by_y = 0;
  for (int k = 0; k < n; ++k) {
    half[k] = (psi1[k] - psi0[k]) / 2, mean[k] = (w->at0[k] + w->at1[k]) / 2;
    y += mean[k] * half[k], y_c += (w->at1[k] * psi1[k] - w->at0[k] * psi0[k]) / 2;
    turn += w->quotient[k] * (psi0[k] + psi1[k]) / 2;
  }
  for (int k = 0; k < n; ++k) {
    c[k] = over_sine(half[k] - y) * cos(half[k]);
    total += mean[k] * c[k], all += mean[k] * c[k] * turns[k];
  }
  for (int k = 0; k < n; ++k) by_y -= mean[k] * over_sine_slope(half[k] - y) * cos(half[k]) * (turns[k] - all / total) / total;
  double u = y_c - y, bend = over_sine_slope(u) / over_sine(u), per_turn = 1 / (over_sine(u) * cos(y_c) * cos(y));
  double beta = turn * per_turn, by_y_c = by_slide * beta * (tan(y_c) - bend) / 2;
  by_y += by_slide * beta * (tan(y) + bend);
  for (int k = 0; k < n; ++k) {
    double by_mean = (c[k] * (turns[k] - all / total) / total + by_y * half[k]) / 2;
    to->of[AT0][k] += moment * (by_mean - by_y_c * psi0[k]), to->of[AT1][k] += moment * (by_mean + by_y_c * psi1[k]);
    to->of[QUOTIENT][k] += moment * by_slide * per_turn * (psi0[k] + psi1[k]) / 2;
    to->of[ANGLE][k] += moment * (by_slide * per_turn * w->quotient[k] + by_y_c * (w->at1[k] - w->at0[k]));
  }
}

/* Adds the derivatives of the work of the force on the virtual displacements x (localise). */
static void work_by_read(const Slider *a, const WindowEnds *ends, const double *x, PathRead *to) {
  int n = a->width, e0, e1, from, till;
  double l = a->level, Ds = a->s1 - a->s0, by_slide = x[a->components * n];
  const double *F = a->force;
  Weights weights, *w = &weights;
  elements_of(a, &e0, &e1), set_weights(a, e0, e1, a->s0, a->s1, w);
  from = a->degree * element_of(a, a->s0) - a->first, till = from + a->degree;
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < n; ++k) {
      to->of[AT0][k] += (1 - l) * F[i] * x[i * n + k], to->of[AT1][k] += l * F[i] * x[i * n + k];
      if (l == 0.5) {
        to->of[QUOTIENT][k] += by_slide * F[i] * (ends->start[i][k] + ends->end[i][k]) / 2;
        to->of[WEIGHTS_READ + i][k] += by_slide * F[i] * w->quotient[k];
      } else {
        to->of[SLOPE0][k] += by_slide * (1 - l) * F[i] * ends->start[i][k];
        to->of[SLOPE1][k] += by_slide * l * F[i] * ends->end[i][k];
        to->of[WEIGHTS_READ + i][k] += by_slide * F[i] * ((1 - l) * w->slope0[k] + l * w->slope1[k]);
      }
    }
  if (l == 0.5) {
    /* The part Z (Ds virtual alpha - virtual s Dalpha), with Z = F . zeta (slide_by_chord). */
    double r[2], omega[2], given[2], square, Z = 0, alpha, G[2] = {F[1] / 4, -F[0] / 4};
    for (int i = 0; i < 2; ++i) {
      const double *x0 = ends->start[i], *x1 = ends->end[i];
      r[i] = (x0[till] + x1[till] - x0[from] - x1[from]) / 2;
      given[i] = Ds * (x[i * n + till] - x[i * n + from]) - by_slide * (x1[till] - x0[till] - x1[from] + x0[from]);
      for (int k = 0; k < n; ++k) Z += G[i] * w->quotient[k] * (x1[k] - x0[k]);
    }
    square = r[0] * r[0] + r[1] * r[1], omega[0] = -r[1] / square, omega[1] = r[0] / square;
    alpha = omega[0] * given[0] + omega[1] * given[1];
    for (int i = 0; i < 2; ++i) {
      double by_r = Z * ((i ? -given[0] : given[1]) - 2 * alpha * r[i]) / square;
      to->of[WEIGHTS_READ + i][till] += by_r, to->of[WEIGHTS_READ + i][from] -= by_r;
      for (int k = 0; k < n; ++k) to->of[QUOTIENT][k] += alpha * G[i] * (ends->end[i][k] - ends->start[i][k]);
    }
  }
  if (a->components == 3) turn_by_read(a, w, ends, x, to);
}

static double product_of_reads(const PathRead *x, const PathRead *y) {
  return dot(READ * WINDOW_NODES, x->of[0], y->of[0]);
}

/* The change of the place of a node at one end, for changes of the numbers of its path. */
static void change_place(const Problem *p, const Work *w, const Slider *a, int end, double *numbers, double *change) {
  PathRead changes;
  WindowEnds ends;
  follow_path(a, &changes, numbers, 0), find_window_ends(a, p->q, w->D, &ends);
  for (int c = 0; c < a->components; ++c) {
    PathRead by = {0};
    place_by_read(a, &ends, end, (double[]){c == 0, c == 1, c == 2}, &by);
    change[c] += product_of_reads(&by, &changes);
  }
}

/* Adds the change of the force that a node exerts on its beam and along it, for changes of the numbers of its path. */
static void change_of_shape(const Problem *p, const Work *w, const Slider *a, double *numbers, double *r, double *out,
                            int apart) {
  int s = a->components * a->width;
  PathRead changes;
  WindowEnds ends;
  follow_path(a, &changes, numbers, 0), find_window_ends(a, p->q, w->D, &ends);
  for (int k = 0; k <= s; ++k) {
    double x[LOCAL] = {0};
    PathRead by = {0};
    x[k] = 1;
    work_by_read(a, &ends, x, &by);
    double change = product_of_reads(&by, &changes);
    if (k < s) r[apart * local_dof(a, k)] += change;
    else out[apart * a->column] += change;
  }
}
