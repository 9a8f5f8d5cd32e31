/* A member as a curve: about its node P_i, for -1/2 <= x <= 1/2,

     c(x) = P_i + (P_i+1 - P_i-1) x / 2 + (P_i-1 - 2 P_i + P_i+1) (x^2 + 1/4) / 2,

   the quadratic spline, which has a continuous tangent. Behind its ends lie mirror images of the next
   nodes, so that it begins and ends at its first and last node, with half of a piece that is straight. */

#pragma once

#include "member_contact.h"
#include "vectors.h"

static inline double dot2(Two a, Two b) { return a[0] * b[0] + a[1] * b[1]; }

static inline Two weighted(const double *n, const Two *r) { return n[0] * r[0] + n[1] * r[1] + n[2] * r[2] + n[3] * r[3]; }

/* Weights of three nodes at a place on a piece, and their slopes. */
static inline void piece_weights(double x, double *n, double *slope) {
  n[0] = (x - 0.5) * (x - 0.5) / 2, n[1] = 0.75 - x * x, n[2] = (x + 0.5) * (x + 0.5) / 2;
  slope[0] = x - 0.5, slope[1] = -2 * x, slope[2] = x + 0.5;
}

/* Weights of images go to the nodes themselves. */
static inline void fold(double *n, int begins, int ends) {
  if (begins) n[1] += 2 * n[0], n[2] -= n[0], n[0] = 0;
  if (ends) n[1] += 2 * n[2], n[0] -= n[2], n[2] = 0;
}

/* A piece as a polynomial, and half the derivative of its squared distance from the origin, f . (1, x, ..). */
typedef struct { Two value, slope, bend; double f[4]; } Piece;

static inline Piece piece_of(Two previous, Two at, Two next) {
  Piece c = {.slope = (next - previous) / 2, .bend = (previous - 2 * at + next) / 2};
  c.value = at + c.bend / 4;
  c.f[0] = dot2(c.value, c.slope), c.f[1] = dot2(c.slope, c.slope) + 2 * dot2(c.value, c.bend);
  c.f[2] = 3 * dot2(c.slope, c.bend), c.f[3] = 2 * dot2(c.bend, c.bend);
  return c;
}

static inline double residual(const Piece *c, double x) {
  return c->f[0] + x * (c->f[1] + x * (c->f[2] + x * c->f[3]));
}

static inline double rate_of_residual(const Piece *c, double x) {
  return c->f[1] + x * (2 * c->f[2] + 3 * x * c->f[3]);
}

/* The place between two others that is nearest to the origin: an end, or a zero by Newton's method. It lies between
   them also for pieces that are not finite. */
static inline double nearest_place(const Piece *c, double low, double high) {
  if (residual(c, low) >= 0) return low;
  if (residual(c, high) <= 0) return high;
  double a = low, b = high, x = -c->f[0] / c->f[1];
  for (int i = 0; i < 60; ++i) {
    if (!(x > a && x < b)) x = (a + b) / 2;
    double value = residual(c, x), rate = rate_of_residual(c, x), step = value / rate;
    if (value < 0) a = x; else b = x;
    x -= step;
    if (fabs(step) < 1e-15 || b - a < 1e-15) break;
  }
  return x > low ? (x < high ? x : high) : low;
}

/* Whether the distance from the origin grows along the member at the joint of the pieces about two nodes. Both
   pieces see the same digits, so that a nearest point there belongs to exactly one of them. */
static inline int grows_at_joint(Two a, Two b) { return dot2(b - a, a + b) > 0; }

/* The nearest point of a piece to the origin, from the arms to its nodes: the first or the second of two (0 or 1). `begins`
   and `ends` say whether its first or last node is an image, which is made here. */
static NearPoint nearest_on(const Two *r, int second, int begins, int ends) {
  NearPoint near = {0};
  Piece c = piece_of(begins ? 2 * r[1] - r[2] : r[0], r[1], ends ? 2 * r[1] - r[0] : r[2]);
  Two arm = {0};
  double *weights[] = {near.weights + second, near.slopes + second};
  double low = begins ? 0 : -0.5, high = ends ? 0 : 0.5, x = nearest_place(&c, low, high);
  int inside = second ? x < high : x > low; /* also at the joint of the pieces */
  piece_weights(x, weights[0], weights[1]);
  for (int k = 0; k < 2; ++k) fold(weights[k], begins, ends);
  for (int j = 0; j < 3; ++j) arm += near.weights[second + j] * r[j];
  near.place = x + second, near.distance = sqrt(dot2(arm, arm));
  near.per_rate = inside ? 1 / rate_of_residual(&c, x) : 0;
  near.left = !second && !begins && x <= low ? -1 : second && !ends && x >= high ? 1 : 0;
  return near;
}

/* The nearest point of two pieces, from the arms to four nodes. */
static NearPoint nearest_point(const Two *r, int begins, int ends) {
  int second = !grows_at_joint(r[1], r[2]);
  return nearest_on(r + second, second, !second && begins, second && ends);
}
