/* Closed loops of joints: unknowns that follow others (loop_reduction.py). */

#pragma once

#include "ties.h"

/* Largest number of corrections that close the loops, and least ratio of pivots. */
enum { CLOSINGS = 30 };
static const double LEAST_PIVOT = 1e-6;

static void derive_gaps_along_ties(const Problem *p, const Work *w, const double *values, double *G) {
  double *row = w->columns;
  for (int i = 0, k = 0; i < p->closures; ++i) {
    memset(row, 0, (p->columns + p->ties) * sizeof *row);
    for (; k < p->gap_entries && p->gap_row[k] == i; ++k)
      row[p->gap_column[k]] += p->gap_sign[k] * values[p->gap_value[k]];
    collect_ties(p, values, row);
    for (int j = 0; j < p->loop_columns; ++j) G[(long)i * p->loop_columns + j] = row[p->loop_column[j]];
  }
}

/* Derivatives of the gaps [closure][loop column], for values of T or That. */
static void derive_gaps(const Problem *p, const Work *w, const double *values, double *G) {
  int n = p->loop_columns;
  if (p->ties) {
    derive_gaps_along_ties(p, w, values, G);
    return;
  }
  memset(G, 0, (long)p->closures * n * sizeof(double));
  for (int k = 0; k < p->gap_entries; ++k)
    G[p->gap_row[k] * n + p->gap_at[k]] += p->gap_sign[k] * values[p->gap_value[k]];
}

/* Solves A x = B for n rows, with columns of B in place, by elimination with row exchange. */
static void solve_dense(int n, double *A, int columns, double *B) {
  for (int k = 0; k < n; ++k) {
    int best = k;
    for (int i = k + 1; i < n; ++i)
      if (fabs(A[i * n + k]) > fabs(A[best * n + k])) best = i;
    for (int j = 0; j < n; ++j) {
      double x = A[k * n + j];
      A[k * n + j] = A[best * n + j], A[best * n + j] = x;
    }
    for (int j = 0; j < columns; ++j) {
      double x = B[k * columns + j];
      B[k * columns + j] = B[best * columns + j], B[best * columns + j] = x;
    }
    double pivot = 1 / A[k * n + k];
    for (int i = 0; i < n; ++i) {
      if (i == k) continue;
      double factor = A[i * n + k] * pivot;
      for (int j = k; j < n; ++j) A[i * n + j] -= factor * A[k * n + j];
      for (int j = 0; j < columns; ++j) B[i * columns + j] -= factor * B[k * columns + j];
    }
    for (int j = k; j < n; ++j) A[k * n + j] *= pivot;
    for (int j = 0; j < columns; ++j) B[k * columns + j] *= pivot;
  }
}

/* The columns of G of the unknowns that follow. */
static void following_part(const Problem *p, const double *G, double *part) {
  int m = p->closures;
  for (int k = 0; k < m; ++k)
    for (int j = 0; j < m; ++j) part[k * m + j] = G[k * p->loop_columns + p->following[j]];
}

/* Chooses the unknowns that follow by the largest pivots of G; returns 0 in a singular position. */
static int choose_following(const Problem *p, double *G) {
  int m = p->closures, n = p->loop_columns;
  double first = 0;
  for (int k = 0; k < m; ++k)
    for (int j = 0; j < p->loop_free; ++j) G[k * n + j] *= p->loop_unit[j];
  for (int k = 0; k < m; ++k) {
    int row = k, column = 0;
    double largest = -1;
    for (int i = k; i < m; ++i)
      for (int j = 0; j < p->loop_free; ++j)
        if (fabs(G[i * n + j]) > largest) largest = fabs(G[i * n + j]), row = i, column = j;
    if (k == 0) first = largest;
    if (!(largest > LEAST_PIVOT * first)) return 0;
    p->following[k] = column;
    for (int j = 0; j < p->loop_free; ++j) {
      double x = G[k * n + j];
      G[k * n + j] = G[row * n + j], G[row * n + j] = x;
    }
    for (int i = k + 1; i < m; ++i) {
      double factor = G[i * n + column] / G[k * n + column];
      for (int j = 0; j < p->loop_free; ++j) G[i * n + j] -= factor * G[k * n + j];
      G[i * n + column] = 0;
    }
  }
  return 1;
}

/* Gaps of displacements, less the arms of the joints between two places. */
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
  derive_gaps(p, w, w->values, w->G);
  return choose_following(p, w->G);
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
  following_part(p, w->G, w->part);
  solve_dense(m, w->part, 1, gap);
  for (int k = 0; k < m; ++k) w->z[p->loop_column[p->following[k]]] -= gap[k];
  return 0;
}

/* Changes W [closure][loop column] of the unknowns that follow, for values of T or That. The inverse
   of the part of G that belongs to them is stored as well if it is asked for. */
static void find_ratios(const Problem *p, const Work *w, const double *values, double *W, double *inverse) {
  int m = p->closures, n = p->loop_columns;
  derive_gaps(p, w, values, W);
  if (inverse) {
    following_part(p, W, w->part);
    memset(inverse, 0, (long)m * m * sizeof(double));
    for (int k = 0; k < m; ++k) inverse[k * m + k] = 1;
    solve_dense(m, w->part, m, inverse);
  }
  following_part(p, W, w->part);
  solve_dense(m, w->part, n, W);
  for (int k = 0; k < m * n; ++k) W[k] = -W[k];
  for (int k = 0; k < m; ++k)
    for (int j = 0; j < m; ++j) W[k * n + p->following[j]] = 0;
}

/* Small changes of the unknowns that follow. */
static void complete(const Problem *p, const Work *w, double *z) {
  for (int k = 0; k < p->closures; ++k) {
    double sum = 0;
    for (int j = 0; j < p->loop_columns; ++j)
      sum += w->W[k * p->loop_columns + j] * z[p->loop_column[j]];
    w->gap[k] = sum;
  }
  for (int k = 0; k < p->closures; ++k) z[p->loop_column[p->following[k]]] = w->gap[k];
}

/* Forces of the closing joints, those that leave no residual of the unknowns that follow. */
static void close_residual(const Problem *p, const Work *w, double *R) {
  int m = p->closures, n = p->loop_columns;
  for (int k = 0; k < m; ++k) w->gap[k] = R[p->loop_column[p->following[k]]];
  for (int j = 0; j < m; ++j) {
    w->closing[j] = 0;
    for (int k = 0; k < m; ++k) w->closing[j] += w->inverse[k * m + j] * w->gap[k];
  }
  for (int k = 0; k < m; ++k)
    for (int j = 0; j < n; ++j) R[p->loop_column[j]] += w->What[k * n + j] * w->gap[k];
  for (int k = 0; k < m; ++k) R[p->loop_column[p->following[k]]] = 0;
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

/* The tangent of the independent unknowns; rows of the others say that they follow. `near` rows and
   columns have entries of the loops' unknowns. */
static void reduce_loops(const Problem *p, const Work *w) {
  int m = p->closures, n = p->loop_columns, f = p->loop_free;
  double *K = w->tangent;
  for (int i = 0; i < p->near; ++i) {
    const int *row = p->near_loop + (long)i * f;
    for (int k = 0; k < m; ++k) {
      double x = K[row[p->following[k]]];
      for (int j = 0; j < f; ++j) K[row[j]] += x * w->W[k * n + j];
      K[row[p->following[k]]] = 0;
    }
  }
  for (int i = 0; i < p->near; ++i) {
    const int *column = p->loop_near + (long)i * f;
    for (int k = 0; k < m; ++k) {
      double x = K[column[p->following[k]]];
      for (int j = 0; j < f; ++j) K[column[j]] += x * w->What[k * n + j];
      K[column[p->following[k]]] = 0;
    }
  }
  for (int k = 0; k < m; ++k) {
    const int *row = p->loop_loop + (long)p->following[k] * f;
    for (int j = 0; j < f; ++j) K[row[j]] = -w->W[k * n + j];
    K[row[p->following[k]]] = 1;
  }
}

/* Adds to a tangent with ties a stiffness of the gaps. It does no work where they are closed, and keeps
   the tangent of open loops regular. */
static void stiffen_loops(const Problem *p, const Work *w) {
  double stiff = 0, *K = w->tangent;
  for (int i = 0; i < p->scales; ++i)
    stiff = fmax(stiff, fabs(K[p->scale_at[i]]) / (p->scale_unit[i] * p->scale_unit[i]));
  for (int k = 0; k < p->stiffened; ++k) {
    int a = p->stiff_left[k], b = p->stiff_right[k];
    K[p->stiff_to[k]] += stiff * p->gap_sign[a] * w->virtual_map[p->gap_value[a]] * p->gap_sign[b] *
                         w->values[p->gap_value[b]];
  }
}
