/* The relation of a node that slides on a beam (coupling/sliding.py), and its path (scene/path.py). */

#pragma once

#include <string.h>
#include "slider.h"
#include "vectors.h"

/* Weights of the nodes of a window in a step from s0 to s1 (path.py). */
typedef struct {
  double at0[WINDOW_NODES], at1[WINDOW_NODES], slope0[WINDOW_NODES], slope1[WINDOW_NODES];
  double bend1[WINDOW_NODES], quotient[WINDOW_NODES], quotient_slope[WINDOW_NODES];
} Weights;

static int element_of(const Slider *a, double s) {
  int low = 0, high = a->elements;
  while (high - low > 1) {
    int middle = (low + high) / 2;
    if (s >= a->ends[middle]) low = middle;
    else high = middle;
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

static void set_weights(const Slider *a, int e0, int e1, double s0, double s1, Weights *w) {
  const double *s = a->ends;
  double h0 = s[e0 + 1] - s[e0], h1 = s[e1 + 1] - s[e1];
  double x0 = (s0 - s[e0]) / h0, x1 = (s1 - s[e1]) / h1;
  memset(w, 0, sizeof *w);
  add_weights(a, e0, (double[]){1, x0, x0 * x0, x0 * x0 * x0}, 1, w->at0);
  add_weights(a, e1, (double[]){1, x1, x1 * x1, x1 * x1 * x1}, 1, w->at1);
  add_weights(a, e0, (double[]){0, 1, 2 * x0, 3 * x0 * x0}, 1 / h0, w->slope0);
  add_weights(a, e1, (double[]){0, 1, 2 * x1, 3 * x1 * x1}, 1 / h1, w->slope1);
  add_weights(a, e1, (double[]){0, 0, 2, 6 * x1}, 1 / (h1 * h1), w->bend1);
  if (e0 == e1) {
    add_weights(a, e0, (double[]){0, 1, x0 + x1, x0 * x0 + x0 * x1 + x1 * x1}, 1 / h0, w->quotient);
    add_weights(a, e0, (double[]){0, 0, 1, x0 + 2 * x1}, 1 / (h0 * h0), w->quotient_slope);
    return;
  }
  /* Element by element, so that no difference of equal numbers is taken. */
  int way = e1 > e0 ? 1 : -1, n = a->width;
  double length = s1 - s0;
  for (int e = e0; e != e1 + way; e += way) {
    double h = s[e + 1] - s[e], x = e == e0 ? x0 : way < 0, y = e == e1 ? x1 : way > 0;
    double mean[WINDOW_NODES] = {0}, share = (y - x) * h / length;
    add_weights(a, e, (double[]){0, 1, x + y, x * x + x * y + y * y}, 1 / h, mean);
    for (int k = 0; k < n; ++k) {
      w->quotient[k] += share * mean[k];
      w->quotient_slope[k] += share * (w->slope1[k] - mean[k]) / length;
    }
  }
  if (fabs(length) <= 1e-6 * h0)
    for (int k = 0; k < n; ++k) w->quotient_slope[k] = w->bend1[k] / 2;
}

/* x / sin(x) and its derivative, smooth at 0. */
static double over_sine(double x) {
  return fabs(x) < 1e-4 ? 1 + x * x / 6 : x / sin(x);
}

static double over_sine_slope(double x) {
  return fabs(x) < 1e-2 ? x / 3 + 7 * x * x * x / 90 : (1 - x / tan(x)) / sin(x);
}

/* Positions, relative to a node of the window, at the start, and increments, of the window. */
static void nodes_of(const Slider *a, const double *q, const double *D, double (*p0)[2], double (*Dp)[2]) {
  for (int k = 0; k < a->width; ++k)
    for (int i = 0; i < 2; ++i) {
      int dof = a->dofs[3 * (a->first + k) + i];
      p0[k][i] = a->position[2 * (a->first + k) + i] + q[dof];
      Dp[k][i] = D[dof];
    }
}

static double weigh(int n, const double *weights, double (*x)[2], int i) {
  double total = 0;
  for (int k = 0; k < n; ++k) total += weights[k] * x[k][i];
  return total;
}

static double product_of(int n, const double *a, const double *b) {
  double total = 0;
  for (int k = 0; k < n; ++k) total += a[k] * b[k];
  return total;
}

/* Rotation of the node: increment, its derivatives, virtual ones, and with h the derivatives of
   these, times the moment (sliding.py). */
static void slide_rotation(Slider *a, const Weights *w, const double *q, const double *D, double moment,
                           Second *h) {
  int n = a->width, o = 2 * n, s = 3 * n, exact = a->level == 0.5;
  double psi0[WINDOW_NODES], psi1[WINDOW_NODES], psibar[WINDOW_NODES], x[WINDOW_NODES];
  double mean[WINDOW_NODES], Ds = a->s1 - a->s0, l = a->level;
  for (int k = 0; k < n; ++k) {
    int dof = a->dofs[3 * (a->first + k) + 2];
    psi0[k] = a->angle[a->first + k] + q[dof], psi1[k] = psi0[k] + D[dof], x[k] = D[dof] / 2;
    psibar[k] = (psi0[k] + psi1[k]) / 2, mean[k] = (1 - l) * w->at0[k] + l * w->at1[k];
  }
  double Dpsi = product_of(n, w->at1, psi1) - product_of(n, w->at0, psi0);
  double turn = product_of(n, w->quotient, psibar);
  double turn_s = product_of(n, w->quotient_slope, psibar);
  if (!h) {
    a->increment[2] = Dpsi, a->T[2][s] = product_of(n, w->slope1, psi1);
    memcpy(a->T[2] + o, w->at1, n * sizeof(double));
    memcpy(a->virtual_map[2] + o, mean, n * sizeof(double));
    a->virtual_map[2][s] = exact ? turn : (1 - l) * product_of(n, w->slope0, psi0) + l * a->T[2][s];
  } else if (!exact || !a->by_tangent) {
    for (int k = 0; k < n; ++k) {
      h->by_s[o + k] = l * moment * w->slope1[k];
      h->of_s[o + k] = l * moment * (exact ? w->quotient[k] : w->slope1[k]);
    }
    h->square += moment * (exact ? turn_s : l * product_of(n, w->bend1, psi1));
  }
  if (!exact || !a->by_tangent) return;
  double y = product_of(n, mean, x), y_c = Dpsi / 2, u = y_c - y, c[WINDOW_NODES];
  for (int k = 0; k < n; ++k) c[k] = over_sine(x[k] - y) * cos(x[k]);
  double total = product_of(n, mean, c), cosines = cos(y_c) * cos(y), beta = turn / over_sine(u) / cosines;
  if (!h) {
    for (int k = 0; k < n; ++k) a->virtual_map[2][o + k] = mean[k] * c[k] / total;
    a->virtual_map[2][s] = beta;
    return;
  }
  double tilt[WINDOW_NODES], x_part[WINDOW_NODES], all = 0, bend = over_sine_slope(u) / over_sine(u);
  for (int k = 0; k < n; ++k) {
    tilt[k] = mean[k] * over_sine_slope(x[k] - y) * cos(x[k]);
    x_part[k] = (tilt[k] - mean[k] * over_sine(x[k] - y) * sin(x[k])) / 2;
    all += tilt[k];
  }
  double by_length = product_of(n, w->slope1, x) / 2;
  double all_by_length = product_of(n, w->slope1, c) / 2 - all * by_length;
  for (int k = 0; k < n; ++k) {
    double y_by = mean[k] / 2, q_by = w->quotient[k] / 2, u_by = Ds / 2 * q_by, share = mean[k] * c[k] / total;
    double of_k = q_by / (over_sine(u) * cosines) - beta * bend * u_by;
    h->of_s[o + k] = moment * (of_k + beta * (tan(y_c) * (y_by + u_by) + tan(y) * y_by));
    h->turn[o + k] = moment * x_part[k] / total;
    h->left[2][o + k] = tilt[k], h->right[2][o + k] = -moment * y_by / total;
    h->left[3][o + k] = share, h->right[3][o + k] = -moment * (x_part[k] - all * y_by) / total;
    double by_s = w->slope1[k] * c[k] / 2 - tilt[k] * by_length;
    h->by_s[o + k] = moment * (by_s - share * all_by_length) / total;
  }
  double u_by = Ds / 2 * turn_s + turn / 2, beta_by = turn_s / (over_sine(u) * cosines) - beta * bend * u_by;
  beta_by += beta * (tan(y_c) * (by_length + u_by) + tan(y) * by_length);
  h->square += moment * beta_by;
}

/* Elements of both ends of a step, of which it may pass so many. */
static void elements_of(const Slider *a, int *e0, int *e1) {
  int first = element_of(a, a->s0), last = element_of(a, a->s1);
  *e0 = first, *e1 = last > first + a->most ? first + a->most : last < first - a->most ? first - a->most : last;
}

/* Increment of the node for that of its beam and of the arc length, the derivatives T and the virtual
   increment, with the chord of an element. With h: the derivatives of virtual_map^T F for the force F of the
   node. */
static void slide_by_chord(Slider *a, int chord, const double *q, const double *D, Second *h) {
  int n = a->width, s = a->components * n, e0, e1, low, limit = a->elements - a->window;
  elements_of(a, &e0, &e1);
  low = (e0 < e1 ? e0 : e1) - 1;
  a->first = a->degree * (low < 0 ? 0 : low > limit ? limit : low);
  Weights weights, *w = &weights;
  set_weights(a, e0, e1, a->s0, a->s1, w);
  double p0[WINDOW_NODES][2], Dp[WINDOW_NODES][2], mean[WINDOW_NODES], Ds = a->s1 - a->s0, l = a->level;
  double p1[WINDOW_NODES][2], pbar[WINDOW_NODES][2];
  nodes_of(a, q, D, p0, Dp);
  for (int k = 0; k < n; ++k) {
    mean[k] = (1 - l) * w->at0[k] + l * w->at1[k];
    for (int i = 0; i < 2; ++i) p1[k][i] = p0[k][i] + Dp[k][i], pbar[k][i] = p0[k][i] + Dp[k][i] / 2;
  }
  if (!h) {
    memset(a->T, 0, sizeof a->T), memset(a->virtual_map, 0, sizeof a->virtual_map);
    for (int i = 0; i < 2; ++i) {
      a->increment[i] = weigh(n, w->at1, p1, i) - weigh(n, w->at0, p0, i);
      memcpy(a->T[i] + i * n, w->at1, n * sizeof(double));
      memcpy(a->virtual_map[i] + i * n, mean, n * sizeof(double));
      a->T[i][s] = weigh(n, w->slope1, p1, i);
      a->virtual_map[i][s] = (1 - l) * weigh(n, w->slope0, p0, i) + l * a->T[i][s];
    }
  } else {
    memset(h, 0, sizeof *h);
    for (int i = 0; i < 2; ++i)
      for (int k = 0; k < n; ++k) h->by_s[i * n + k] = l * a->force[i] * w->slope1[k];
  }
  if (l != 0.5) {
    for (int i = 0; h && i < 2; ++i) {
      for (int k = 0; k < n; ++k) h->of_s[i * n + k] = l * a->force[i] * w->slope1[k];
      h->square += l * a->force[i] * weigh(n, w->bend1, p1, i);
    }
  } else {
    int from = a->degree * chord - a->first, to = from + a->degree, end[2] = {from, to};
    double r[2], Dr[2], omega[2], turn[2][2], zeta[2], square, Dalpha;
    for (int i = 0; i < 2; ++i) r[i] = pbar[to][i] - pbar[from][i], Dr[i] = Dp[to][i] - Dp[from][i];
    square = r[0] * r[0] + r[1] * r[1];
    omega[0] = -r[1] / square, omega[1] = r[0] / square;
    Dalpha = omega[0] * Dr[0] + omega[1] * Dr[1];
    zeta[0] = -weigh(n, w->quotient, Dp, 1) / 4, zeta[1] = weigh(n, w->quotient, Dp, 0) / 4;
    if (!h)
      for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) {
          a->virtual_map[i][j * n + to] += Ds * zeta[i] * omega[j];
          a->virtual_map[i][j * n + from] -= Ds * zeta[i] * omega[j];
        }
        a->virtual_map[i][s] = weigh(n, w->quotient, pbar, i) - zeta[i] * Dalpha;
      }
    else {
      const double *F = a->force;
      double G[2] = {F[1] / 4, -F[0] / 4}, by_r[2], Z = F[0] * zeta[0] + F[1] * zeta[1], Z_s = 0;
      for (int i = 0; i < 2; ++i) Z_s += G[i] * weigh(n, w->quotient_slope, Dp, i);
      for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 2; ++j)
          turn[i][j] = ((i > j) * 0.5 - (i < j) * 0.5 - omega[i] * r[j]) / square;
      for (int j = 0; j < 2; ++j) by_r[j] = omega[j] + turn[0][j] * Dr[0] + turn[1][j] * Dr[1];
      for (int i = 0; i < 2; ++i) {
        for (int k = 0; k < n; ++k) h->of_s[i * n + k] = (F[i] / 2 - G[i] * Dalpha) * w->quotient[k];
        h->square += F[i] * weigh(n, w->quotient_slope, pbar, i);
        for (int f = 0; f < 2; ++f) {
          double sign = f ? 1 : -1;
          h->of_s[i * n + end[f]] -= sign * Z * by_r[i];
          h->by_s[i * n + end[f]] += sign * omega[i] * (Z + Ds * Z_s);
          h->left[i][i * n + end[f]] = sign;
        }
        for (int j = 0; j < 2; ++j) {
          for (int k = 0; k < n; ++k) h->right[i][j * n + k] = Ds * omega[i] * G[j] * w->quotient[k];
          h->right[i][j * n + to] += Ds * Z * turn[i][j];
          h->right[i][j * n + from] -= Ds * Z * turn[i][j];
        }
      }
      h->square -= Dalpha * Z_s;
    }
  }
  if (a->components == 3) slide_rotation(a, w, q, D, a->force[2], h);
}

/* The same with the chord of the element in which the step begins. */
static void slide_on(Slider *a, const double *q, const double *D, Second *h) {
  slide_by_chord(a, element_of(a, a->s0), q, D, h);
}
