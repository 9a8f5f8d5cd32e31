/* Derivatives of the forces of elements, which are found for LANES elements at once: backwards by the work on a weight,
   forwards by slopes that serve all directions; and those of the forces of inertia. */

#pragma once

#include "linearised.h"

/* Derivatives of the forces of elements as pieces of `Vjp`, and whether these are by the configurations at the end
   and at the start, not by increment and start. */
typedef struct {
  double *of_elements[2];
  int by_ends[2];
} Slopes;

/* Room for derivatives by nodes, with that of elements that only fill a block, and for those by forces that friction
   follows. */
typedef struct {
  double *by_increment, *by_start, *by_previous, *of_internal;
  FixedPoint following;
} Backward;

/* Adds the derivatives of the work of elements on the weights `fields`: those by nodes to vectors, with `last` the others to
   the sums of each element. */
static void vjp_elements(const Problem *p, const Vjp *of, const double *const *fields, const Backward *b,
                          const Layout *at, double t, double dt, double *x, int last) {
  const Form *form = &of->form;
  int n = p->cell_dofs, m = of->internal ? p->cell_internal : 0, there[] = {of->increment, of->start, of->q_previous};
  int s = p->cell_natural, strained[] = {of->natural, of->natural_end};
  double A[(1 + 3 * n + m + 2 * s + of->tail) * LANES], *sums = of->sums, *natural[] = {x + at->natural, x + at->natural1};
  double *nodal[] = {b->by_increment, b->by_start, b->by_previous};
  set_time(p, form, t, dt);
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long block = 0; block * LANES < own->cells; ++block, sums += of->tail * LANES) {
      evaluate(p, form, own, block, fields, A);
      const double *rest = A + LANES;
      for (int k = 0; k < 3; rest += there[k++] * n * LANES)
        if (there[k]) add(n, own->to + block * n * LANES, rest, nodal[k]);
      for (int k = 0; k < m; ++k, rest += LANES)
        for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
          x[at->internal + own->internal[(block * m + k) * LANES + l]] += rest[l];
      for (int end = 0; end < 2; ++end)
        for (int k = 0; strained[end] && k < s; ++k, rest += LANES)
          for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
            natural[end][own->natural[(block * s + k) * LANES + l]] += rest[l];
      for (int k = 0; last && k < of->tail * LANES; ++k) sums[k] += rest[k];
      for (int k = 0; last && of->parameters_at >= 0 && k < form->parameters; ++k)
        for (int l = 0; l < LANES && block * LANES + l < own->cells; ++l)
          x[at->parameters + form->parameter[k]] += rest[(of->parameters_at + k) * LANES + l];
    }
  }
}

/* The derivatives of the forces of elements and of inertia, and of internal variables; with `last` also by numbers. */
static void vjp_bodies(const Problem *p, const Work *w, const Adjoint *a, const Layout *at, const Backward *b,
                        double *x, int last) {
  const double *fields[VJP_FIELDS] = {w->D, p->q, p->v, p->a, p->q_previous, p->internal,
                                         p->natural, w->natural_end, x + at->r, b->of_internal};
  double t = p->t + p->level * w->dt, per_dt = rates_per_path(p, w->dt);
  int n = p->dofs, internal = p->cells * p->cell_internal;
  memset(b->by_increment, 0, n * sizeof(double)), memset(b->by_start, 0, n * sizeof(double));
  if (a->internal_forces.q_previous) memset(b->by_previous, 0, n * sizeof(double));
  for (int i = 0; i < internal; ++i) {
    x[at->internal + i] += x[at->internal1 + i];
    b->of_internal[i] = x[at->internal1 + i] * p->per_weight[i % p->cell_internal];
  }
  vjp_elements(p, &a->internal_forces, fields, b, at, t, w->dt, x, last);
  vjp_elements(p, &a->drag, fields, b, at, t, w->dt, x, last);
  times_mass(p, x + at->r, w->scratch);
  for (int i = 0; i < n; ++i) {
    double by_increment = b->by_increment[i] + per_dt * per_dt / 2 * w->slope[i] * w->scratch[i];
    x[at->q1 + i] += by_increment, x[at->q + i] += b->by_start[i] - by_increment;
    x[at->v + i] -= per_dt * w->scratch[i];
  }
  for (int i = 0; a->internal_forces.q_previous && i < n; ++i) x[at->q_previous + i] += b->by_previous[i];
  for (int i = 0; last && i < n; ++i) {
    double weight = x[at->r + i];
    x[at->weight + i] -= acting(p) * weight;
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k) x[at->mass + k] += weight * w->acc[p->mass_column[k]];
  }
}

/* Adds the changes of the forces of inertia and weight. */
static void jvp_inertia(const Problem *p, const Work *w, const Layout *at, int changes_mass, int held, Changes *x) {
  double per_dt = rates_per_path(p, w->dt);
  const Changes *q = x + at->q, *end = x + at->q1, *v = x + at->v;
  Changes *moving = x + at->R; /* which begins afterwards */
  for (int i = 0; i < p->dofs; ++i) {
    Changes increment = held ? -q[i] : end[i] - q[i];
    moving[i] = per_dt * (per_dt / 2 * w->slope[i] * increment - v[i]);
  }
  for (int i = 0; i < p->dofs; ++i) {
    Changes sum = x[at->r + i];
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k) sum += p->mass[k] * moving[p->mass_column[k]];
    for (int k = p->mass_start[i]; changes_mass && k < p->mass_start[i + 1]; ++k)
      sum += x[at->mass + k] * w->acc[p->mass_column[k]];
    x[at->r + i] = changes_mass ? sum - acting(p) * x[at->weight + i] : sum;
  }
}

static int numbers_of_element(const Problem *p, const Vjp *of) {
  return (of->increment + of->start + of->q_previous) * p->cell_dofs + of->internal * p->cell_internal +
         (of->natural + of->natural_end) * p->cell_natural + of->tail;
}

static long blocks_of(const Form *form) {
  long blocks = 0;
  for (int i = 0; i < form->integrals; ++i) blocks += (form->of[i].cells + LANES - 1) / LANES;
  return blocks;
}

static int weights_of_piece(const Problem *p, const Vjp *of, int i) {
  return of->of_internal[i] ? p->cell_internal : p->cell_dofs;
}

/* Where a piece begins in the slopes of a block, behind the work. */
static double *piece_in(const Problem *p, const Vjp *of, int piece, double *slopes) {
  long at = 1;
  for (int i = 0; i < piece; ++i) at += of->piece_size[i] * weights_of_piece(p, of, i);
  return slopes + at * LANES;
}

static int is_by_increment(const Vjp *of, int i) { return of->increment && of->piece_at[i] == 0; }

/* The piece by the start with the weights of one by the increment, or -1. */
static int piece_by_start(const Problem *p, const Vjp *of, int i) {
  for (int k = 0; of->start && k < of->pieces; ++k)
    if (of->piece_at[k] == p->cell_dofs && of->of_internal[k] == of->of_internal[i]) return k;
  return -1;
}

static int can_be_by_ends(const Problem *p, const Vjp *of) {
  for (int i = 0; i < of->pieces; ++i)
    if (is_by_increment(of, i) && piece_by_start(p, of, i) < 0) return 0;
  return of->increment;
}

/* With `by_ends` the slopes by the start become those at a fixed end. */
static void find_slopes(const Problem *p, const Vjp *of, int by_ends, const double *const *fields, double t, double dt,
                        double *to) {
  const Form *form = &of->slopes;
  set_time(p, form, t, dt);
  for (int i = 0; i < form->integrals; ++i)
    for (long block = 0; block * LANES < form->of[i].cells; ++block, to += (long)of->slope_numbers * LANES) {
      evaluate(p, form, form->of + i, block, fields, to);
      for (int k = 0; by_ends && k < of->pieces; ++k) {
        if (!is_by_increment(of, k)) continue;
        double *by_end = piece_in(p, of, k, to), *by_start = piece_in(p, of, piece_by_start(p, of, k), to);
        for (int l = 0; l < of->piece_size[k] * weights_of_piece(p, of, k) * LANES; ++l) by_start[l] -= by_end[l];
      }
    }
}

/* Adds the products of slopes [number][weight][lane], of one lane, and changes. */
INLINED void add_products(int numbers, int weights, const double *slopes, const Changes *x, Changes *sums) {
  for (int q = 0; q < numbers; ++q)
#pragma GCC unroll 12
    for (int k = 0; k < weights; ++k, slopes += LANES) sums[k] += *slopes * x[q];
}

/* The change of the forces of an element, or of the increments of its internal variables, by those of its numbers: those
   before `tail` in x. With `held` the end does not change. */
INLINED void sum_pieces(const Vjp *of, int held, int internal, int weights, const double *slopes, const Changes *x,
                        int before_tail, const Changes *tail, int n, int m, Changes *sums) {
  slopes += LANES; /* behind the work */
  for (int k = 0; k < weights; ++k) sums[k] = (Changes){0};
  for (int i = 0; i < of->pieces; ++i) {
    int numbers = of->piece_size[i], at = of->piece_at[i];
    const Changes *own = at < before_tail ? x + at : tail + (at - before_tail);
    if (of->of_internal[i] == internal && !(held && is_by_increment(of, i)))
      add_products(numbers, weights, slopes, own, sums);
    slopes += (long)numbers * (of->of_internal[i] ? m : n) * LANES;
  }
}

/* Adds the change of the forces of elements with n degrees of freedom, or with `grows` that of their internal variables
   to these. */
INLINED void change_cells(int n, const Problem *p, const Vjp *of, const double *slopes, int by_ends, const Layout *at,
                          int fixed, Changes *changes, const Changes *tail, int grows) {
  const Form *form = &of->slopes;
  int m = p->cell_internal, all = numbers_of_element(p, of), s = p->cell_natural;
  int held = by_ends && fixed, strained[] = {of->natural, of->natural_end};
  const Changes *natural[] = {changes + at->natural, changes + at->natural1}, *end = changes + at->q1, *q = changes + at->q;
  Changes *inner = changes + at->internal;
  Changes x[all], sums[n + m];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *own = form->of + i;
    for (long cell = 0; cell < own->cells; ++cell) {
      long block = cell / LANES, lane = cell % LANES;
      const double *of_cell = slopes + block * of->slope_numbers * LANES + lane;
      const int *dofs = own->dofs + block * n * LANES + lane, *inside = own->internal + block * m * LANES + lane;
      Changes *to = x;
      for (int k = 0; of->increment && k < n; ++k) {
        int dof = dofs[k * LANES];
        to[k] = held ? (Changes){0} : by_ends ? end[dof] : fixed ? -q[dof] : end[dof] - q[dof];
      }
      to += of->increment * n;
      for (int k = 0; of->start && k < n; ++k) *to++ = q[dofs[k * LANES]];
      for (int k = 0; of->q_previous && k < n; ++k) *to++ = changes[at->q_previous + dofs[k * LANES]];
      for (int k = 0; of->internal && k < m; ++k) *to++ = inner[inside[k * LANES]];
      for (int k = 0; k < 2; ++k)
        for (int l = 0; strained[k] && l < s; ++l) *to++ = natural[k][own->natural[(block * s + l) * LANES + lane]];
      const Changes *behind = tail + cell * of->tail;
      if (of->parameters_at >= 0) {
        behind = memcpy(to, behind, of->tail * sizeof(Changes));
        for (int k = 0; k < form->parameters; ++k) to[of->parameters_at + k] = changes[at->parameters + form->parameter[k]];
      }
      if (grows) {
        sum_pieces(of, held, 1, m, of_cell, x, all - of->tail, behind, n, m, sums);
        for (int k = 0; k < m; ++k) inner[inside[k * LANES]] += p->per_weight[k] * sums[k];
        continue;
      }
      sum_pieces(of, held, 0, n, of_cell, x, all - of->tail, behind, n, m, sums);
      for (int k = 0; k < n; ++k) changes[at->r + dofs[k * LANES]] += sums[k];
    }
    slopes += (own->cells + LANES - 1) / LANES * of->slope_numbers * LANES;
    tail += (own->cells + LANES - 1) / LANES * LANES * of->tail;
  }
}

static void change_elements(const Problem *p, const Vjp *of, const double *slopes, int by_ends, const Layout *l,
                            int held, Changes *x, const Changes *tail) {
  if (p->cell_dofs == 6) change_cells(6, p, of, slopes, by_ends, l, held, x, tail, 0); /* sums stay in registers */
  else change_cells(p->cell_dofs, p, of, slopes, by_ends, l, held, x, tail, 0);
}
