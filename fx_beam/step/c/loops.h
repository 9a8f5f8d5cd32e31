/* Closed loops of joints: unknowns that follow others (coupling/dependent_columns.py). Loops that share no unknowns are
   blocks for themselves, and each closure depends on few unknowns, also in long trees. */

#pragma once

#include "sliders.h"
#include "auxiliaries.h"

/* Largest number of corrections that close the loops, and least pivot, relative to the largest entry of G. */
enum { CLOSINGS = 30 };
static const double LEAST_PIVOT = 1e-6;

/* Derivatives by columns of nodes on beams, by those of the beams and slides. */
static void derive_by_beams(const Sliders *sliders, const Work *w, const double *values, double *row) {
  for (const Slider *a = w->slider + sliders->count - 1; a >= w->slider && sliders->count; --a)
    for (int c = 0; c < a->components; ++c) {
      const double *T = values == w->virtual_map ? a->virtual_map[c] : a->T[c];
      double slope = row[a->carried[c]];
      row[a->carried[c]] = 0;
      row[a->column] += slope * T[ARC];
      for (int l = 0; l < a->components * a->width && slope != 0; ++l) {
        int dof = 3 * (a->first + l % a->width) + l / a->width;
        for (int e = a->part_start[dof]; e < a->part_start[dof + 1]; ++e)
          row[a->part_column[e]] += slope * T[l] * a->part_sign[e] * values[a->part_value[e]];
      }
    }
}

/* Derivatives G of the closures by the loops' columns, in compressed rows, for values of T or Tv. */
static void derive_closures(const Tables *p, const Work *w, const double *values, double *G) {
  double *row = w->closure_row;
  for (int i = 0; i < p->loops.closures; ++i) {
    int first = p->loops.entry_start[i], end = p->loops.entry_start[i + 1];
    int first_auxiliary = p->loops.auxiliary_start[i], last_auxiliary = p->loops.auxiliary_start[i + 1];
    for (int k = first; k < end; ++k)
      row[p->loops.entry_column[k]] += p->loops.entry_sign[k] * values[p->loops.entry_value[k]];
    if (HAS(SLIDERS) && p->loops.carried) derive_by_beams(&p->sliders, w, values, row);
    for (int k = first_auxiliary; k < last_auxiliary; ++k) {
      int t = p->loops.auxiliary[k];
      double auxiliary_slope = row[p->columns + p->auxiliary.of[t]];
      row[p->auxiliary.column[t]] += p->auxiliary.sign[t] * values[p->auxiliary.value[t]] * auxiliary_slope;
    }
    for (int k = p->loops.start[i]; k < p->loops.start[i + 1]; ++k) {
      double *entry = row + p->loops.column[p->loops.near[k]];
      G[k] = *entry, *entry = 0;
    }
    for (int k = first; k < end; ++k) row[p->loops.entry_column[k]] = 0;
    for (int k = first_auxiliary; k < last_auxiliary; ++k) {
      row[p->columns + p->auxiliary.of[p->loops.auxiliary[k]]] = 0;
      row[p->auxiliary.column[p->loops.auxiliary[k]]] = 0;
    }
  }
}

/* Rows of n equations in a band, with `lower` columns before the diagonal, `upper` behind it, and so many more as rows are
   exchanged; in a wide band they are those of a full matrix. Column j of row i is at [i * stride + shift + j]. */
typedef struct { int n, lower, upper; long stride, shift, size; } BandRows;

INLINED BandRows band_rows(int n, int lower, int upper) {
  int width = 2 * lower + upper + 1;
  return width < n ? (BandRows){n, lower, upper, width - 1, lower, (long)n * width}
                   : (BandRows){n, lower, upper, n, 0, (long)n * n};
}

static inline int least_of(int a, int b) { return a < b ? a : b; }

/* LU factors in place; row k was exchanged with row `exchanged[k]`. */
HOT void factorise_band(const BandRows *b, double *A, int *exchanged) {
  for (int k = 0; k < b->n; ++k) {
    int best = k, last = least_of(k + b->lower, b->n - 1), end = least_of(k + b->lower + b->upper, b->n - 1);
    double *pivot = A + b->shift + k * b->stride;
    for (int i = k + 1; i <= last; ++i)
      if (fabs(A[b->shift + i * b->stride + k]) > fabs(A[b->shift + best * b->stride + k])) best = i;
    double *chosen = A + b->shift + best * b->stride;
    exchanged[k] = best;
    for (int j = k; best != k && j <= end; ++j) {
      double number = pivot[j];
      pivot[j] = chosen[j], chosen[j] = number;
    }
    for (int i = k + 1; i <= last; ++i) {
      double *other = A + b->shift + i * b->stride;
      if (other[k] == 0) continue;
      double factor = other[k] /= pivot[k];
      for (int j = k + 1; j <= end; ++j) other[j] -= factor * pivot[j];
    }
  }
}

/* Solves the equations of `factorise_band` for one or GROUP_SIZE right sides x, [row][right side], in their place. */
INLINED void solve_band_rows(int sides, const BandRows *b, const double *A, const int *exchanged, double *x) {
  Four y[b->n];
  for (int i = 0; i < b->n; ++i) y[i] = sides == 1 ? (Four){x[i]} : *(const Four *)(x + i * sides);
  for (int k = 0; k < b->n; ++k) {
    Four top = y[exchanged[k]];
    y[exchanged[k]] = y[k], y[k] = top;
    for (int i = k + 1; i <= k + b->lower && i < b->n; ++i) y[i] -= A[b->shift + i * b->stride + k] * top;
  }
  for (int i = b->n - 1; i >= 0; --i) {
    const double *row = A + b->shift + i * b->stride;
    for (int j = i + 1; j < b->n && j <= i + b->lower + b->upper; ++j) y[i] -= row[j] * y[j];
    y[i] *= 1 / row[i];
    for (int k = 0; k < sides; ++k) x[i * sides + k] = y[i][k];
  }
}

/* A sparse row: numbers by column, and the columns of those that may differ from zero, each once. */
typedef struct { double *number; int count, *column, *is_in; } SparseRow;

static inline double *entry_of(SparseRow *row, int column) {
  if (!row->is_in[column]) row->column[row->count++] = column, row->is_in[column] = 1;
  return row->number + column;
}

/* First row behind `before` whose pivot is in a column where this row is not zero; -1 for none. */
static int next_pivot(const SparseRow *row, const int *pivots, int before) {
  int next = -1;
  for (int k = 0; k < row->count; ++k) {
    int pivot = pivots[row->column[k]];
    if (pivot > before && (next < 0 || pivot < next) && row->number[row->column[k]] != 0) next = pivot;
  }
  return next;
}

/* Moves the numbers of a row that are not zero to an array, its pivot first; returns how many there are. */
static int take_row(SparseRow *row, int pivot, double *number, int *column) {
  int count = 1;
  column[0] = pivot, number[0] = row->number[pivot], row->number[pivot] = 0;
  for (int k = 0; k < row->count; ++k) {
    int j = row->column[k];
    if (row->number[j] != 0) column[count] = j, number[count++] = row->number[j];
    row->number[j] = 0, row->is_in[j] = 0;
  }
  row->count = 0;
  return count;
}

/* Rows by which others are eliminated, the pivot of each first; in `own` memory if they need more room than Work has. */
typedef struct { double *number, *own; int *column; long room; } PivotRows;

/* Returns 0 without memory. */
static int make_room(PivotRows *rows, long used, long more) {
  if (used + more <= rows->room) return 1;
  long room = 2 * (used + more);
  double *number = malloc(room * (sizeof(double) + sizeof(int)));
  if (!number) return 0;
  rows->room = room;
  int *column = memcpy(number + room, rows->column, used * sizeof(int));
  memcpy(number, rows->number, used * sizeof(double));
  free(rows->own);
  rows->number = rows->own = number, rows->column = column;
  return 1;
}

/* Chooses the unknowns of a block that follow: of each row of G the largest entry, after those before are eliminated. Returns the
   least of these relative to the largest entry of G, or 0. */
static double choose_in_block(const Tables *p, const Work *w, int begin, int m, SparseRow *row, PivotRows *rows) {
  double most = 0, least = HUGE_VAL;
  int *row_start = w->pivot_row;
  for (int i = row_start[0] = 0; i < m; ++i) {
    double size = 0, length = p->loops.length[begin + i];
    int column = -1;
    for (int k = p->loops.start[begin + i]; k < p->loops.start[begin + i + 1]; ++k) {
      int near = p->loops.near[k];
      if (p->loops.column[near] >= p->free) continue; /* and has no unit */
      double number = w->G[k] * p->loops.unit[near];
      *entry_of(row, near) = number, most = fmax(most, fabs(number) * length);
    }
    for (int before = -1, k; (k = next_pivot(row, w->follows, before)) >= 0; before = k) {
      int first = row_start[k], pivot = rows->column[first];
      double factor = row->number[pivot] / rows->number[first];
      for (int e = first; e < row_start[k + 1]; ++e) *entry_of(row, rows->column[e]) -= factor * rows->number[e];
      row->number[pivot] = 0;
    }
    for (int k = 0; k < row->count; ++k) {
      int j = row->column[k];
      double now = fabs(row->number[j]);
      if (now > size || (now == size && now > 0 && j < column)) size = now, column = j;
    }
    if (!make_room(rows, row_start[i], row->count + 1)) return 0;
    row_start[i + 1] = row_start[i] + take_row(row, column < 0 ? 0 : column, rows->number + row_start[i], rows->column + row_start[i]);
    if (column < 0) return 0;
    least = fmin(least, size * length);
    w->following[begin + i] = column, w->follows[column] = i;
  }
  return least / most; /* of all: it must not depend on the order of closures */
}

/* Chooses the unknowns that follow, block by block; returns 0 in a singular position. */
static int choose_following(const Tables *p, const Work *w) {
  SparseRow row = {w->closure_row, 0, w->touched, w->touched + p->loops.columns};
  PivotRows rows = {w->pivoting, 0, w->pivot_column, p->loops.pivoting_size};
  int regular = 1;
  memset(row.is_in, 0, p->loops.columns * sizeof(int));
  for (int j = 0; j < p->loops.columns; ++j) w->follows[j] = -1;
  for (int b = 0; b < p->loops.blocks; ++b) {
    int begin = p->loops.block_closure[b], end = p->loops.block_closure[b + 1];
    if (!(regular = !(choose_in_block(p, w, begin, end - begin, &row, &rows) <= LEAST_PIVOT))) break;
    /* In the order of their columns, near to the diagonal. */
    int *lower = w->band + 2 * b, *upper = lower + 1;
    for (int j = p->loops.block_column[b], k = begin; j < p->loops.block_column[b + 1]; ++j)
      if (w->follows[j] >= 0) w->following[k] = j, w->follows[j] = k++;
    *lower = *upper = 0;
    for (int i = begin; i < end; ++i)
      for (int k = p->loops.start[i]; k < p->loops.start[i + 1]; ++k) {
        int beside = w->follows[p->loops.near[k]] - i;
        if (w->follows[p->loops.near[k]] < 0) continue;
        if (-beside > *lower) *lower = -beside;
        if (beside > *upper) *upper = beside;
      }
  }
  free(rows.own);
  return regular;
}

/* Rows of a block of closures, or of their transpose, by the unknowns that follow. */
static BandRows rows_of_block(const Loops *loops, const Work *w, int block, int transposed) {
  const int *band = w->band + 2 * block, *begin = loops->block_closure + block;
  return band_rows(begin[1] - begin[0], band[transposed], band[!transposed]);
}

/* LU factors of the part of G that belongs to the unknowns that follow, or of its transpose, block by block. */
static void factorise_closures(const Loops *loops, const Work *w, const double *G, int transposed) {
  for (int b = 0; b < loops->blocks; ++b) {
    BandRows rows = rows_of_block(loops, w, b, transposed);
    int begin = loops->block_closure[b];
    double *A = w->part + transposed * loops->block_part[loops->blocks] + loops->block_part[b];
    memset(A, 0, rows.size * sizeof(double));
    for (int i = 0; i < rows.n; ++i)
      for (int k = loops->start[begin + i]; k < loops->start[begin + i + 1]; ++k) {
        int j = w->follows[loops->near[k]] - begin, row = transposed ? j : i, column = transposed ? i : j;
        if (w->follows[loops->near[k]] >= 0) A[rows.shift + row * rows.stride + column] = G[k];
      }
    factorise_band(&rows, A, w->exchanged + transposed * loops->closures + begin);
  }
}

/* Solves for the unknowns that follow, in the place of one or GROUP_SIZE right sides x. */
HOT void solve_closures(const Loops *loops, const Work *w, int sides, int transposed, double *x) {
  const int *exchanged = w->exchanged + transposed * loops->closures;
  for (int b = 0; b < loops->blocks; ++b) {
    BandRows rows = rows_of_block(loops, w, b, transposed);
    int begin = loops->block_closure[b];
    const double *factors = w->part + transposed * loops->block_part[loops->blocks] + loops->block_part[b];
    solve_band_rows(sides, &rows, factors, exchanged + begin, x + begin * sides);
  }
}

/* The arm of a joint, by the values of T, which are its derivatives. */
static inline Two arm_of(const double *values, int j) { return (Two){values[4 * j + 2], -values[4 * j + 1]}; }

/* Of term t of gears the number of its value, its weight, and the rotation or slide for nodal values u and a slide of its joint. */
static inline int value_of_term(const Joints *joints, int t) { return 1 + 4 * joints->count + t; }
static inline double weight_of_term(const Numbers *s, int t) { return s->gears[t / 2 * 3 + t % 2]; }
static inline double term_motion(const Gears *gears, int t, const double *u, double slide) {
  return gears->joint[t] < 0 ? at(u, gears->b[t]) - at(u, gears->a[t]) : slide;
}

/* x = Dpsi_b / 2 - Dpsi_a / 2 of a term in a step, and both halves. */
static inline double half_turns_of_term(const Gears *gears, const Work *w, int t, double half[2]) {
  half[0] = at(w->D, gears->b[t]) / 2, half[1] = at(w->D, gears->a[t]) / 2;
  return half[0] - half[1];
}

/* Whether couples of a term do work on 2 tan(Dpsi / 2). */
static inline int bends(const Tables *p, int t) { return p->scheme.rule == 0 && p->gears.joint[t] < 0; }

/* Values of T and Tv of gears: virtual rotations are those of couples times (Dpsi_b - Dpsi_a) / (Dtheta_b - Dtheta_a), which is
   x / sin(x) cos(Dpsi_a / 2) cos(Dpsi_b / 2), so that gears do no work. */
static void turn_gears(const Tables *p, const Numbers *s, const Work *w) {
  double half[2];
  for (int t = 0; t < p->gears.count; ++t) {
    double x = half_turns_of_term(&p->gears, w, t, half), weight = weight_of_term(s, t);
    w->values[value_of_term(&p->joints, t)] = weight;
    w->virtual_map[value_of_term(&p->joints, t)] = weight * (bends(p, t) ? over_sine(x) * cos(half[0]) * cos(half[1]) : 1);
  }
}

/* Derivative of a value of Tv by the increment of the rotation of b (0) or a (1). */
static double slope_of_term(const Tables *p, const Work *w, int t, int is_a) {
  double half[2], x = half_turns_of_term(&p->gears, w, t, half), along = over_sine_slope(x) / over_sine(x);
  return bends(p, t) ? w->virtual_map[value_of_term(&p->joints, t)] * ((is_a ? -along : along) - tan(half[is_a])) / 2 : 0;
}

/* Closures of displacements, less the changes of the joints' arms, with those before if there are any, and of gears. */
static void find_closures(const Tables *p, const Numbers *s, const Work *w, const double *u, const double *before,
                          double *closure) {
  for (int k = 0; k < p->loops.closures; ++k) {
    closure[k] = at(u, p->loops.b[k]) - at(u, p->loops.a[k]) - at(w->arm_change, p->loops.arm[k]);
    if (before) closure[k] += before[k];
  }
  for (int t = 0; t < p->gears.count; ++t) {
    int j = p->gears.joint[t], k = p->gears.closure[t];
    double slide = j < 0 ? 0 : before ? at(w->z, p->joints.slide_column[j]) : w->state.slides[p->joints.number[j]];
    closure[k] += weight_of_term(s, t) * term_motion(&p->gears, t, u, slide) - (before || t % 2 ? 0 : s->gears[t / 2 * 3 + 2]);
  }
}

/* Start of a step: its closures, and the unknowns that follow; returns 0 in a singular position. */
static int begin_loops(const Tables *p, const Numbers *s, const Work *w) {
  if (!HAS(LOOPS) || !p->loops.closures) return 1;
  for (int j = 0; j < p->joints.count; ++j)
    *(Two *)(w->arm_change + 2 * j) = arm_of(w->values0, j) - pair(p->loops.arm_at_rest + 2 * j);
  find_closures(p, s, w, w->state.q, 0, w->closure0);
  if (HAS(SLIDERS) && p->loops.carried) begin_sliders(p, w);
  derive_closures(p, w, w->values0, w->G);
  return choose_following(p, w);
}

/* The derivatives of the closures at an increment, for which the unknowns that follow are corrected. Returns whether they are
   closed. */
static int correct_loops(const Tables *p, const Numbers *s, const Work *w, double *last) {
  int m = p->loops.closures;
  double *closure = w->closure, size;
  derive_closures(p, w, w->values, w->G);
  factorise_closures(&p->loops, w, w->G, 0);
  find_closures(p, s, w, w->D, w->closure0, closure);
  size = largest(m, closure, p->loops.length);
  if (size <= p->loops.closed || (*last < size && size <= 1e3 * p->loops.closed)) return 1;
  *last = size;
  solve_closures(&p->loops, w, 1, 0, closure);
  for (int k = 0; k < m; ++k) w->z[p->loops.column[w->following[k]]] -= closure[k];
  return 0;
}

/* Small changes of the unknowns that follow. */
static void complete(const Loops *loops, const Work *w, double *z) {
  for (int k = 0; k < loops->closures; ++k) z[loops->column[w->following[k]]] = 0;
  for (int i = 0; i < loops->closures; ++i) {
    w->closure[i] = 0;
    for (int k = loops->start[i]; k < loops->start[i + 1]; ++k)
      w->closure[i] += w->G[k] * z[loops->column[loops->near[k]]];
  }
  solve_closures(loops, w, 1, 0, w->closure);
  for (int k = 0; k < loops->closures; ++k) z[loops->column[w->following[k]]] = -w->closure[k];
}

/* Forces of the closing joints, those that leave no residual of the unknowns that follow. */
static void close_residual(const Loops *loops, const Work *w, double *R) {
  for (int k = 0; k < loops->closures; ++k) w->closing[k] = R[loops->column[w->following[k]]];
  solve_closures(loops, w, 1, 1, w->closing);
  for (int i = 0; i < loops->closures; ++i)
    for (int k = loops->start[i]; k < loops->start[i + 1]; ++k)
      R[loops->column[loops->near[k]]] -= w->G_virtual[k] * w->closing[i];
  for (int k = 0; k < loops->closures; ++k) R[loops->column[w->following[k]]] = 0;
}

/* Adds the forces of the closing joints on columns. */
static void add_closing(const Loops *loops, const Work *w, double *out) {
  for (int i = 0; i < loops->closures; ++i)
    for (int k = loops->entry_start[i]; k < loops->entry_start[i + 1]; ++k)
      out[loops->entry_column[k]] -= loops->entry_sign[k] * w->virtual_map[loops->entry_value[k]] * w->closing[i];
}

/* Forces with those of nodes on beams, to which loops add, after `close_residual` of r. */
static void carry_in_loops(const Tables *p, const PointForces *points, const Work *w, const double *r) {
  memset(w->columns, 0, (p->columns + p->auxiliary.count) * sizeof(double));
  push_columns(points, w->columns), add_closing(&p->loops, w, w->columns);
  load_beams(p, w, r, w->columns);
}

/* The stiffness of closures as lengths, by the size of the tangent. It does no work where they are closed, and keeps the
   tangent of open loops regular, also without what borders it. */
static double stiffness_of_closures(const Loops *loops, const double *K) {
  double stiff = 0;
  for (int i = 0; i < loops->scales; ++i)
    stiff = fmax(stiff, fabs(K[loops->scale_at[i]]) * loops->scale_unit[i] * loops->scale_unit[i]);
  return stiff;
}
