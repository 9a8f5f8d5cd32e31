/* Closed loops of joints: unknowns that follow others (loop_reduction.py). Loops that share no unknowns are
   blocks for themselves, and the gap of a closure depends on few unknowns, also in long trees. */

#pragma once

#include "sliders.h"
#include "ties.h"

/* Largest number of corrections that close the loops, and least ratio of pivots. */
enum { CLOSINGS = 30 };
static const double LEAST_PIVOT = 1e-6;

/* Derivatives by columns of nodes on beams, by those of the beams and slides. */
static void derive_by_beams(const Problem *p, const Work *w, const double *values, double *row) {
  for (const Slider *a = p->slider + p->sliders - 1; a >= p->slider && p->sliders; --a)
    for (int c = 0, s = a->components * a->width; c < a->components; ++c) {
      const double *T = values == w->virtual_map ? a->virtual_map[c] : a->T[c];
      double of = row[a->carried[c]];
      row[a->carried[c]] = 0;
      row[a->column] += of * T[s];
      for (int l = 0; l < s && of != 0; ++l) {
        int dof = 3 * (a->first + l % a->width) + l / a->width;
        for (int e = a->part_start[dof]; e < a->part_start[dof + 1]; ++e)
          row[a->part_column[e]] += of * T[l] * a->part_sign[e] * values[a->part_value[e]];
      }
    }
}

/* Derivatives G of the gaps by the loops' columns, in compressed rows, for values of T or Tv. */
static void derive_gaps(const Problem *p, const Work *w, const double *values, double *G) {
  double *row = w->gap_row;
  for (int i = 0; i < p->closures; ++i) {
    int first = p->gap_entry_start[i], end = p->gap_entry_start[i + 1];
    int first_tie = p->gap_tie_start[i], last_tie = p->gap_tie_start[i + 1];
    for (int k = first; k < end; ++k) row[p->gap_column[k]] += p->gap_sign[k] * values[p->gap_value[k]];
    if (p->guided) derive_by_beams(p, w, values, row);
    for (int k = first_tie; k < last_tie; ++k) {
      int t = p->gap_tie[k];
      double of_tie = row[p->columns + p->tie_of[t]];
      row[p->tie_column[t]] += p->tie_sign[t] * values[p->tie_value[t]] * of_tie;
    }
    for (int k = p->gap_start[i]; k < p->gap_start[i + 1]; ++k) {
      double *of = row + p->loop_column[p->gap_near[k]];
      G[k] = *of, *of = 0;
    }
    for (int k = first; k < end; ++k) row[p->gap_column[k]] = 0;
    for (int k = first_tie; k < last_tie; ++k) {
      row[p->columns + p->tie_of[p->gap_tie[k]]] = 0;
      row[p->tie_column[p->gap_tie[k]]] = 0;
    }
  }
}

/* LU factors of n rows, with exchange of rows, in place: `row` has their order. Few entries may differ from zero. */
static void factorise_dense(int n, double *A, int *row) {
  for (int i = 0; i < n; ++i) row[i] = i;
  for (int k = 0; k < n; ++k) {
    int best = k;
    for (int i = k + 1; i < n; ++i)
      if (fabs(A[(long)row[i] * n + k]) > fabs(A[(long)row[best] * n + k])) best = i;
    int chosen = row[best];
    row[best] = row[k], row[k] = chosen;
    const double *pivot = A + (long)chosen * n;
    for (int i = k + 1; i < n; ++i) {
      double *other = A + (long)row[i] * n;
      if (other[k] == 0) continue;
      double factor = other[k] /= pivot[k];
      for (int j = k + 1; j < n; ++j) other[j] -= factor * pivot[j];
    }
  }
}

/* Chooses the unknowns that follow by the largest pivots of G, block by block; returns 0 in a singular
   position. Most rows of G have no entry of a pivot's column: they keep their largest entries. */
static int choose_following(const Problem *p, const Work *w) {
  for (int j = 0; j < p->loop_columns; ++j) w->follows[j] = -1;
  for (int b = 0; b < p->blocks; ++b) {
    int begin = p->block_closure[b], m = p->block_closure[b + 1] - begin;
    int from = p->block_column[b], n = p->block_column[b + 1] - from;
    double *M = w->pivoting, *largest = M + (long)m * n, first = 0;
    int *at = w->largest_at;
    memset(M, 0, (long)m * n * sizeof(double));
    for (int i = 0; i < m; ++i) {
      for (int k = p->gap_start[begin + i]; k < p->gap_start[begin + i + 1]; ++k)
        if (p->gap_near[k] < p->loop_free)
          M[i * n + p->gap_near[k] - from] = w->G[k] * p->loop_unit[p->gap_near[k]];
      largest[i] = -1;
      for (int j = 0; j < n; ++j)
        if (fabs(M[i * n + j]) > largest[i]) largest[i] = fabs(M[i * n + j]), at[i] = j;
    }
    for (int k = 0; k < m; ++k) {
      int row = 0;
      for (int i = 1; i < m; ++i)
        if (largest[i] > largest[row]) row = i;
      if (k == 0) first = largest[row];
      if (!(largest[row] > LEAST_PIVOT * first)) return 0;
      int column = at[row];
      const double *pivot = M + (long)row * n;
      p->following[begin + k] = from + column, w->follows[from + column] = begin + k;
      largest[row] = -2; /* done */
      for (int i = 0; i < m; ++i) {
        double *other = M + (long)i * n;
        if (largest[i] < -1 || other[column] == 0) continue;
        double factor = other[column] / pivot[column];
        largest[i] = -1;
        for (int j = 0; j < n; ++j) {
          other[j] = j == column ? 0 : other[j] - factor * pivot[j];
          if (fabs(other[j]) > largest[i]) largest[i] = fabs(other[j]), at[i] = j;
        }
      }
    }
  }
  return 1;
}

/* LU factors of the part of G that belongs to the unknowns that follow, block by block. */
static void factorise_gaps(const Problem *p, const Work *w, const double *G, double *factors, int *order) {
  for (int b = 0; b < p->blocks; ++b) {
    int begin = p->block_closure[b], m = p->block_closure[b + 1] - begin;
    double *A = factors + p->block_part[b];
    memset(A, 0, (long)m * m * sizeof(double));
    for (int i = 0; i < m; ++i)
      for (int k = p->gap_start[begin + i]; k < p->gap_start[begin + i + 1]; ++k) {
        int at = w->follows[p->gap_near[k]];
        if (at >= 0) A[(long)i * m + at - begin] = G[k];
      }
    factorise_dense(m, A, order + begin);
  }
}

/* Solves G_d x = b for the part G_d of the unknowns that follow, in place of b. */
static void solve_gaps(const Problem *p, const Work *w, const double *factors, const int *order, double *x) {
  for (int b = 0; b < p->blocks; ++b) {
    int begin = p->block_closure[b], m = p->block_closure[b + 1] - begin;
    const double *A = factors + p->block_part[b];
    double *y = w->gap_scratch, *of = x + begin;
    for (int i = 0; i < m; ++i) {
      const double *row = A + (long)order[begin + i] * m;
      y[i] = of[order[begin + i]];
      for (int j = 0; j < i; ++j) y[i] -= row[j] * y[j];
    }
    for (int i = m - 1; i >= 0; --i) {
      const double *row = A + (long)order[begin + i] * m;
      for (int j = i + 1; j < m; ++j) y[i] -= row[j] * y[j];
      y[i] /= row[i];
    }
    memcpy(of, y, m * sizeof(double));
  }
}

/* The same for the transposed part. */
static void solve_gaps_transposed(const Problem *p, const Work *w, const double *factors, const int *order,
                                  double *x) {
  for (int b = 0; b < p->blocks; ++b) {
    int begin = p->block_closure[b], m = p->block_closure[b + 1] - begin;
    const double *A = factors + p->block_part[b];
    double *y = w->gap_scratch, *of = x + begin;
    memcpy(y, of, m * sizeof(double));
    for (int i = 0; i < m; ++i) {
      const double *row = A + (long)order[begin + i] * m;
      y[i] /= row[i];
      for (int j = i + 1; j < m; ++j) y[j] -= row[j] * y[i];
    }
    for (int i = m - 1; i >= 0; --i) {
      const double *row = A + (long)order[begin + i] * m;
      for (int j = 0; j < i; ++j) y[j] -= row[j] * y[i];
      of[order[begin + i]] = y[i];
    }
  }
}

/* Gaps of displacements, less the arms of the joints between two configurations. */
static void find_gaps(const Problem *p, const double *u, const double *rho0, const double *rho1,
                      double *gap) {
  for (int k = 0; k < p->closures; ++k) {
    gap[k] = at(u, p->gap_b[k]) - at(u, p->gap_a[k]);
    if (p->gap_arm[k] >= 0) gap[k] -= rho1[p->gap_arm[k]] - rho0[p->gap_arm[k]];
  }
}

/* Start of a step: its gaps, and the unknowns that follow; returns 0 in a singular position. */
static int begin_loops(const Problem *p, const Work *w) {
  if (!p->closures) return 1;
  find_gaps(p, p->q, p->arm_at_rest, w->rho0, w->gap0);
  for (int j = 0; j < p->joints; ++j) {
    double *value = w->values + 1 + 4 * j;
    value[0] = -w->rho0[2 * j + 1], value[1] = w->rho0[2 * j];
    value[2] = w->t0[2 * j], value[3] = w->t0[2 * j + 1];
  }
  if (p->guided) memset(w->D, 0, p->dofs * sizeof(double));
  for (Slider *a = p->slider; p->guided && a < p->slider + p->sliders; ++a) {
    a->s0 = a->s1 = p->slides[a->joint];
    slide_on(a, p->q, w->D);
  }
  derive_gaps(p, w, w->values, w->G);
  return choose_following(p, w);
}

/* Out of a singular position a step goes on with the motion: increments of the loops' unknowns. */
static void go_on(const Problem *p, const Work *w) {
  for (int j = 0; j < p->loop_free; ++j) {
    int dof = p->loop_dof[j];
    if (dof >= 0) w->z[p->loop_column[j]] = w->dt * p->v[dof];
  }
}

/* Corrects the unknowns that follow for the gaps at an increment. Returns whether they are closed. */
static int correct_loops(const Problem *p, const Work *w, double *last) {
  int m = p->closures;
  double *gap = w->gap, size = 0;
  find_gaps(p, w->D, w->rho0, w->rho1, gap);
  for (int k = 0; k < m; ++k) {
    gap[k] += w->gap0[k];
    size = size < fabs(gap[k]) || isnan(gap[k]) ? fabs(gap[k]) : size;
  }
  if (size <= p->gap_closed || (*last < size && size <= 1e3 * p->gap_closed)) return 1;
  *last = size;
  derive_gaps(p, w, w->values, w->G);
  factorise_gaps(p, w, w->G, w->part, w->part_order);
  solve_gaps(p, w, w->part, w->part_order, gap);
  for (int k = 0; k < m; ++k) w->z[p->loop_column[p->following[k]]] -= gap[k];
  return 0;
}

/* Derivatives of the gaps at the present increment. */
static void linearise_loops(const Problem *p, const Work *w) {
  derive_gaps(p, w, w->values, w->G);
  factorise_gaps(p, w, w->G, w->part, w->part_order);
  derive_gaps(p, w, w->virtual_map, w->G_virtual);
  factorise_gaps(p, w, w->G_virtual, w->part_virtual, w->order_virtual);
}

/* Small changes of the unknowns that follow. */
static void complete(const Problem *p, const Work *w, double *z) {
  for (int k = 0; k < p->closures; ++k) z[p->loop_column[p->following[k]]] = 0;
  for (int i = 0; i < p->closures; ++i) {
    w->gap[i] = 0;
    for (int k = p->gap_start[i]; k < p->gap_start[i + 1]; ++k)
      w->gap[i] += w->G[k] * z[p->loop_column[p->gap_near[k]]];
  }
  if (p->closures) solve_gaps(p, w, w->part, w->part_order, w->gap);
  for (int k = 0; k < p->closures; ++k) z[p->loop_column[p->following[k]]] = -w->gap[k];
}

/* Forces of the closing joints, those that leave no residual of the unknowns that follow. */
static void close_residual(const Problem *p, const Work *w, double *R) {
  for (int k = 0; k < p->closures; ++k) w->closing[k] = R[p->loop_column[p->following[k]]];
  solve_gaps_transposed(p, w, w->part_virtual, w->order_virtual, w->closing);
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_start[i]; k < p->gap_start[i + 1]; ++k)
      R[p->loop_column[p->gap_near[k]]] -= w->G_virtual[k] * w->closing[i];
  for (int k = 0; k < p->closures; ++k) R[p->loop_column[p->following[k]]] = 0;
}

/* Forces with those of nodes on beams, to which loops add, after `close_residual` of r. */
static void carry_in_loops(const Problem *p, const Work *w, const double *r) {
  memset(w->columns, 0, (p->columns + p->ties) * sizeof(double));
  push_columns(p, w->columns);
  for (int i = 0; i < p->closures; ++i)
    for (int k = p->gap_entry_start[i]; k < p->gap_entry_start[i + 1]; ++k)
      w->columns[p->gap_column[k]] -= p->gap_sign[k] * w->virtual_map[p->gap_value[k]] * w->closing[i];
  memcpy(w->loaded, r, p->dofs * sizeof(double));
  carry(p, w, w->loaded, w->columns);
}

/* Nodal forces with those of the closing joints, of the last residual. */
static const double *closed(const Problem *p, const Work *w, const double *r) {
  if (!p->closures) return r;
  memcpy(w->closed, r, p->dofs * sizeof(double));
  for (int k = 0; k < p->closures; ++k) {
    if (p->gap_b[k] >= 0) w->closed[p->gap_b[k]] -= w->closing[k];
    if (p->gap_a[k] >= 0) w->closed[p->gap_a[k]] += w->closing[k];
  }
  return w->closed;
}

/* The gaps in the tangent: their derivatives, with the closing forces as unknowns behind all others, and a
   stiffness. It does no work where they are closed, and keeps the tangent of open loops regular. */
static void close_tangent(const Problem *p, const Work *w) {
  double stiff = 0, *K = w->tangent;
  for (int i = 0; i < p->scales; ++i)
    stiff = fmax(stiff, fabs(K[p->scale_at[i]]) / (p->scale_unit[i] * p->scale_unit[i]));
  for (int k = 0; k < p->stiffened; ++k) {
    int a = p->stiff_left[k], b = p->stiff_right[k];
    K[p->stiff_to[k]] += stiff * p->gap_sign[a] * w->virtual_map[p->gap_value[a]] * p->gap_sign[b] *
                         w->values[p->gap_value[b]];
  }
  for (int k = 0; k < p->gap_unknowns; ++k) {
    int e = p->gap_entry[k];
    K[p->gap_equation[k]] += p->gap_sign[e] * w->values[p->gap_value[e]];
    K[p->gap_balance[k]] += p->gap_sign[e] * w->virtual_map[p->gap_value[e]];
  }
}
