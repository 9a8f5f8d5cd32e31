/* Forces along a line over points: a law of its length alone gives the pull (laws/scalar_laws.py), and its pieces the rest. */

#pragma once

#include "member_contacts.h"

/* A piece of a line: lengths and unit vectors at both ends of a step; the vector along which the pull does exact work, and
   the length by which it is one. */
typedef struct { double size[2], unit[2][2], along[2], mean, rate; } LinePiece;

static LinePiece line_piece(const PointForce *e, int k) {
  LinePiece p;
  int n = e->size;
  double r[2][2], v[2];
  for (int i = 0; i < 2; ++i) {
    const double *to = e->moves[k + 1] < 0 ? 0 : e->given + e->moves[k + 1] + i, *from = e->moves[k] < 0 ? 0 : e->given + e->moves[k] + i;
    r[0][i] = e->numbers[2 * k + i] + (to ? *to : 0) - (from ? *from : 0);
    r[1][i] = r[0][i] + (to ? to[n] : 0) - (from ? from[n] : 0);
    v[i] = (to ? to[2 * n] : 0) - (from ? from[2 * n] : 0);
  }
  for (int i = 0; i < 2; ++i) {
    p.size[i] = sqrt(r[i][0] * r[i][0] + r[i][1] * r[i][1] + 1e-300);
    for (int j = 0; j < 2; ++j) p.unit[i][j] = r[i][j] / p.size[i];
  }
  p.mean = (1 - e->level) * p.size[0] + e->level * p.size[1];
  for (int j = 0; j < 2; ++j) p.along[j] = ((1 - e->level) * r[0][j] + e->level * r[1][j]) / p.mean;
  p.rate = p.unit[0][0] * v[0] + p.unit[0][1] * v[1];
  return p;
}

/* Arguments of the law of the length: the length, its increment and rate, and the rest as it is; sets all pieces. */
static int given_of_length(const PointForce *e, LinePiece *piece, double *to) {
  int middle = 2 + e->internal + e->iteration_memory;
  memset(to, 0, 3 * sizeof(double));
  for (int k = 0; k < e->pieces; ++k) {
    LinePiece p = piece[k] = line_piece(e, k);
    to[0] += p.size[0], to[1] += p.size[1] - p.size[0], to[2] += p.rate;
  }
  memcpy(to + 3, e->given + 3 * e->size, middle * sizeof(double));
  memcpy(to + 3 + middle, e->numbers + 2 * e->pieces, e->others * sizeof(double));
  return 3 + middle + e->others;
}

static inline int most_given(const PointForce *e) { return 5 + e->internal + e->iteration_memory + e->others; }

/* Values of a function of a force besides its law: of a line one of its length. */
static inline void call_value(const PointForce *e, Law *law, double *results, int values) {
  if (!e->pieces) { call(law, e->given, results, values); return; }
  double given[most_given(e)];
  LinePiece piece[e->pieces];
  given_of_length(e, piece, given);
  call(law, given, results, values);
}

/* Adds a vector of a piece to those of its two points, with its sign. */
static inline void add_ends(const PointForce *e, int k, const double *vector, double *to) {
  for (int end = 0; end < 2; ++end)
    for (int i = 0; i < 2 && e->moves[k + end] >= 0; ++i) to[e->moves[k + end] + i] += (end ? vector[i] : -vector[i]);
}

/* Derivative of the vector along a piece by its vector at one end of the step. */
static inline double turning(const PointForce *e, const LinePiece *p, int end, int i, int j) {
  double part = end ? e->level : 1 - e->level;
  return part * ((i == j) - p->along[i] * p->unit[end][j]) / p->mean;
}

/* Forces of a law, entries of their tangent, internal variables and what is remembered. */
static inline void call_law(const PointForce *e, double *results) {
  int n = e->size, more = e->internal + e->iteration_memory;
  if (!e->pieces) { call(e->law, e->given, results, n + e->entries + more); return; }
  double given[most_given(e)], scalar[2 + more], along[n], unit[n], *tangent = results + n;
  LinePiece piece[e->pieces];
  given_of_length(e, piece, given);
  call(e->law, given, scalar, 1 + e->length_entries + more);
  double pull = scalar[0], slope = e->length_entries ? scalar[1] : 0;
  memset(along, 0, sizeof along), memset(unit, 0, sizeof unit);
  for (int k = 0; k < e->pieces; ++k) add_ends(e, k, piece[k].along, along), add_ends(e, k, piece[k].unit[1], unit);
  for (int i = 0; i < n; ++i) {
    results[i] = pull * along[i];
    for (int j = 0; j < n; ++j) tangent[i * n + j] = slope * along[i] * unit[j];
  }
  for (int k = 0; k < e->pieces; ++k)
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b) {
        int row = e->moves[k + a], column = e->moves[k + b];
        for (int i = 0; i < 4 && row >= 0 && column >= 0; ++i)
          tangent[(row + i / 2) * n + column + i % 2] += (a == b ? pull : -pull) * turning(e, piece + k, 1, i / 2, i % 2);
      }
  memcpy(results + n + e->entries, scalar + 1 + e->length_entries, more * sizeof(double));
}

/* Slopes of forces and internal variables, `wide` of each: by start, increments, internal variables, numbers and parameters. */
static inline void call_slopes(const PointForce *e, Law *law, double *results, int wide) {
  int n = e->size, m = e->internal, all = n + m, pieces = e->pieces, length_numbers = 2 + m + e->others;
  if (!pieces) { call(law, e->given, results, all * wide); return; }
  double given[most_given(e)], scalar[2 + m + e->iteration_memory], slopes[(1 + m) * length_numbers], along[n];
  LinePiece piece[pieces];
  given_of_length(e, piece, given);
  call(e->law, given, scalar, 1 + e->length_entries + m + e->iteration_memory);
  call(law, given, slopes, (1 + m) * length_numbers);
  memset(along, 0, sizeof along), memset(results, 0, all * wide * sizeof(double));
  for (int k = 0; k < pieces; ++k) add_ends(e, k, piece[k].along, along);
  for (int row = 0; row < all; ++row) {
    const double *by = slopes + (row < n ? 0 : row - n + 1) * length_numbers;
    double factor = row < n ? along[row] : 1, *to = results + row * wide;
    for (int k = 0; k < pieces; ++k) {
      double start[2], end[2];
      for (int j = 0; j < 2; ++j) {
        end[j] = factor * by[1] * piece[k].unit[1][j];
        start[j] = factor * (by[0] - by[1]) * piece[k].unit[0][j] + end[j];
        to[2 * n + m + 2 * k + j] += start[j];
      }
      add_ends(e, k, start, to), add_ends(e, k, end, to + n);
    }
    for (int i = 0; i < m; ++i) to[2 * n + i] = factor * by[2 + i];
    for (int i = 0; i < e->others; ++i) to[2 * n + m + 2 * pieces + i] = factor * by[2 + m + i];
  }
  for (int k = 0; k < pieces; ++k)
    for (int a = 0; a < 2; ++a)
      for (int i = 0; i < 2 && e->moves[k + a] >= 0; ++i) {
        double *to = results + (e->moves[k + a] + i) * wide, start[2], end[2], pull = a ? *scalar : -*scalar;
        for (int j = 0; j < 2; ++j) {
          end[j] = pull * turning(e, piece + k, 1, i, j);
          start[j] = pull * turning(e, piece + k, 0, i, j) + end[j];
          to[2 * n + m + 2 * k + j] += start[j];
        }
        add_ends(e, k, start, to), add_ends(e, k, end, to + n);
      }
}
