/* Corrections by the sparse factors of an earlier tangent. A factorisation costs as much as many
   substitutions, and the tangent changes little from step to step: the factors are a preconditioner of
   the exact tangent, until new ones would cost less. Costs are counted, not measured, so that a run can
   be repeated exactly. */

#pragma once

#include "changing_rows.h"
#include "couplings.h"
#include "narrow_factors.h"

/* Error of a correction by kept factors, relative to what Newton's method leaves by being quadratic; slowest convergence at
   which factors are good enough to judge an error by them, and bounds of the wanted error of a solution, relative to it. */
static const double SHARE = 0.1, SLOWEST = 0.3, MOST = 1e-3, LEAST = 1e-12;

/* Twice the kinetic energy at the start of the step. */
static double kinetic(const Tables *p, const Numbers *s, const Work *w) {
  times_mass(p, s, w->state.v, w->scratch);
  return dot(p->dofs, w->state.v, w->scratch);
}

/* Twice the kinetic energy at the start of the step, and the forces' work in it. */
static double energy_of_step(const Tables *p, const Work *w, double moving) {
  return moving + dot_of_sizes(p->dofs, w->f, w->D);
}

/* Largest correction of a degree of freedom, for corrections x of the unknowns. */
static double size_of(const Tables *p, const Numbers *s, const Work *w, const double *x) {
  memcpy(w->columns, x, p->free * sizeof(double));
  memset(w->columns + p->free, 0, (p->columns - p->free) * sizeof(double));
  spread(p, w, w->columns, w->scratch);
  return largest(p->dofs, w->scratch, s->per_unit);
}

/* Subtracts from r the product of the tangent and the correction x that the factors propose for r, after `size_of`, which
   leaves the motion of nodes in `scratch`. With bordering rows, whose columns are not there any more, that is r, and the
   product with what A has changed by since its factorisation. */
static void subtract_product(const Tables *p, const PointForces *points, const Work *w, const double *x, double *r) {
  for (int i = 0; i < p->free; ++i) {
    double rest = p->border.rows ? 0 : r[i];
    for (int k = p->system.tangent_start[i]; k < p->system.tangent_start[i + 1]; ++k)
      rest -= (p->border.rows ? w->tangent[k] - w->factorised[k] : w->tangent[k]) * x[p->system.tangent_column[k]];
    r[i] = rest;
  }
  if (!HAS(MEMBERS) || !w->factors.changing) return;
  memset(w->columns, 0, p->columns * sizeof(double));
  add_rows(&p->map, w, times_members(points->members, w->scratch), w->columns);
  add_times(p->free, -1, w->columns, r);
}

/* Right sides of bordering rows from the other equations, which have what slides and forces of carriers as they are; or, to
   these, solutions. */
INLINED void pass_on(const Tables *p, const Factors *factors, int sides, int solutions, double *x, double *g) {
  for (int i = 0; i < p->border.bordered; ++i) {
    int row = p->border.bordered_row[i];
    double *unknown = x + factors->order[p->border.bordered_unknown[i]] * sides;
    double *bordering = p->border.inside ? x + factors->order[p->system.unknowns + row] * sides : g + row * sides;
    memcpy(solutions ? unknown : bordering, solutions ? bordering : unknown, sides * sizeof(double));
  }
}

/* Position in the elimination of the beam about the first node that slides, or the middle. */
static int middle_of_elimination(const Tables *p, const Work *w) {
  const Slider *a = w->slider;
  for (int dof = p->sliders.count ? 3 * (a->first + a->width / 2) : 0; p->sliders.count && dof >= 0; --dof)
    for (int e = a->part_start[dof]; e < a->part_start[dof + 1]; ++e)
      if (p->system.unknown_of[a->part_column[e]] >= 0) return w->factors.order[p->system.unknown_of[a->part_column[e]]];
  return p->system.positions / 2;
}

static Ends ends_of_elimination(const Tables *p, const Work *w) {
  return ends_around(p->system.unknowns, p->system.band, middle_of_elimination(p, w));
}

/* The block of n times four columns from its right sides and factors. */
INLINED void solve_columns(const Tables *p, const Work *w, int n) {
  if (HAS(CHAIN)) solve_chain_columns(p, w, middle_of_elimination(p, w) / 3, n);
  else if (HAS(BAND)) solve_band_columns(p, w, ends_of_elimination(p, w), n); else solve_sparse_columns(&p->border, w, n);
}

/* The block by the factors, which may be those of an earlier A, and the factors of the corner with it. */
static void eliminate_bordering_rows(const Tables *p, const Work *w) {
  solve_columns(p, w, p->border.block / 4);
  factorise_corner(p, w);
}

/* Adds the tangents of all contact points to the factors, or to the bordering rows and columns: those of nodes that slide. */
HOT void add_contact_points(const Tables *p, const PointForces *points, const Work *w, int bordering) {
  const ChangingRows *c = w->factors.changing;
  for (const ContactPair *e = c->pair; e < c->pair + c->pairs; ++e) {
    const ContactPoint *t = points->members->contact_point + e->contact_point;
    if (!t->closed || bordering != (e->at < 0)) continue;
    double value = e->sign * w->virtual_map[e->virtual_value] * w->values[e->value] * t->tangent[e->entry];
    if (bordering) add_at(p, w, e->row, e->column, value); else w->factors.rows->factors[e->at] += value;
  }
}

/* The tangent, or its transpose, with that of the contact points in the place of its factors. */
HOT void fill_factors(const Tables *p, const PointForces *points, const Work *w) {
  double *restrict A = w->factors.rows->factors;
  const double *restrict K = w->tangent;
  int changing = HAS(MEMBERS | SLIDERS) && w->factors.changing, entries = p->system.tangent_start[p->system.unknowns];
  if (changing && w->factors.changing->placed != w->transposed) place_entries(&p->system, &w->factors, w->factors.changing, w->transposed);
  memset(A, 0, w->factors.rows->start[w->factors.rows->unknowns] * sizeof(double));
  for (int k = 0; k < entries; ++k) A[w->factors.at[k]] = K[k];
  if (HAS(MEMBERS) && changing && !p->border.inside) add_contact_points(p, points, w, 0);
  if (HAS(SLIDERS) && p->border.inside) w->factors.changing->next = 0, add_bordering_rows(p, w);
  for (int i = 0, first = p->system.unknowns - p->loops.closures; w->statics.yielding > 0 && i < p->loops.closures; ++i)
    A[w->factors.rows->diagonal[w->factors.order[first + i]]] -= w->statics.yielding / (p->loops.length[i] * p->loops.length[i]);
}

static int factorise(const Tables *p, const PointForces *points, Work *w) {
  w->factors.reused.steps = w->factors.reused.all = w->factors.reused.now = 0, ++w->factors.reused.made;
  if (HAS(SLIDERS) && p->border.inside) change_windows(p, w);
  fill_factors(p, points, w);
  if (w->factors.reused.worth && p->border.rows)
    memcpy(w->factorised, w->tangent, p->system.tangent_start[p->free] * sizeof(double));
  w->factors.reused.present = factorise_sparse(w->factors.rows, w->row);
  w->factors.reused.narrow = w->factors.reused.present && has_narrow(&p->border, &w->factors);
  if (w->factors.reused.narrow) narrow_factors(w->factors.rows, &w->narrow);
  return w->factors.reused.present;
}

/* Factors of the tangent with its bordering rows; returns 0 if it is singular. With `keep` for further right sides. */
INLINED int factorise_tangent(const Tables *p, const PointForces *points, Work *w, int keep) {
  int regular = HAS(CHAIN)  ? eliminate_chain(&p->system, w, middle_of_elimination(p, w) / 3, keep)
                : HAS(BAND) ? eliminate_tangent(p, w, p->system.unknowns, ends_of_elimination(p, w))
                            : factorise(p, points, w);
  if (!regular || !HAS(SLIDERS) || !p->border.rows || p->border.inside) return regular;
  if (HAS(MEMBERS) && w->factors.changing) add_contact_points(p, points, w, 1);
  eliminate_bordering_rows(p, w);
  return 1;
}

/* The solution in place of y from what elimination made of it: only of positions that are `reached` or not, if it is given. */
INLINED void substitute_back(const Tables *p, const Work *w, const int *reached, int now) {
  if (HAS(CHAIN)) substitute_chain(&p->system, w, middle_of_elimination(p, w) / 3, reached, now);
  else if (HAS(BAND)) substitute_tangent(p, w, p->system.unknowns, ends_of_elimination(p, w), reached, now);
  else substitute_backward(w->factors.rows, w->y, reached, now);
}

/* Largest number of pivots that are raised, and ratio of pivots that is zero but for round-off. */
enum { MOST_RAISED = 24 };
static const double NO_PIVOT = 1e-14;

/* Where pivots vanish, which those of a regular matrix may do that is not positive definite: b_i is added to them, a stiffness or
   for forces that close loops what these yield, and

       A x = r + sum b_i e_i x_i,    (A with b_i on the diagonals i)

   gives the solution from those for r and all e_i. In place of right sides x, [position][side]; returns 0 if the matrix is
   singular. */
static int solve_raised(const Tables *p, const PointForces *points, const Work *w, int sides, double *x) {
  int unknowns = p->system.unknowns, n, at[MOST_RAISED], exchanged[MOST_RAISED], many = 0, regular = 0;
  double most = 0, least = HUGE_VAL, S[MOST_RAISED * MOST_RAISED], raised[MOST_RAISED], raised_unknowns[MOST_RAISED];
  const SparseRows *rows = w->factors.rows;
  if (HAS(CHAIN | BAND) || (p->border.rows && !p->border.inside)) return 0;
  double b = largest(p->system.tangent_start[unknowns], w->tangent, 0);
  n = rows->unknowns;
  while (b > 0) {
    fill_factors(p, points, w);
    for (int i = 0; i < many; ++i) rows->factors[rows->diagonal[at[i]]] += raised[i];
    if ((regular = factorise_sparse(rows, w->row)) || many == MOST_RAISED) break;
    at[many] = w->row[0], raised[many] = b;
    for (int i = 0; i < p->loops.closures; ++i)
      if (w->factors.order[unknowns - p->loops.closures + i] == at[many])
        raised[many] = -1 / (b * p->loops.length[i] * p->loops.length[i]);
    ++many;
  }
  double *y = regular ? calloc((long)n * (many + 1), sizeof(double)) : 0, *z = y + n;
  if (!y) return 0;
  for (int j = 0; j < many; ++j) z[(long)j * n + at[j]] = raised[j], substitute_sparse(rows, z + (long)j * n);
  for (int i = 0; i < many; ++i)
    for (int j = 0; j < many; ++j) S[i * many + j] = (i == j) - z[(long)j * n + at[i]];
  BandRows full = band_rows(many, many, many);
  factorise_band(&full, S, exchanged);
  for (int i = 0; i < many; ++i)
    most = fmax(most, fabs(S[i * many + i])), least = fmin(least, fabs(S[i * many + i]));
  for (int side = 0; side < sides; ++side) {
    for (int i = 0; i < n; ++i) y[i] = x[i * sides + side];
    substitute_sparse(rows, y);
    gather(many, y, at, raised_unknowns);
    solve_band_rows(1, &full, S, exchanged, raised_unknowns);
    for (int j = 0; j < many; ++j) add_times(n, raised_unknowns[j], z + (long)j * n, y);
    for (int i = 0; i < n; ++i) x[i * sides + side] = y[i];
  }
  free(y);
  return least > NO_PIVOT * fmax(most, 1);
}

/* Factors by which equations are solved: in full precision, their narrow copy, or those of raised pivots. */
enum { FULL, NARROW, RAISED };

/* Solution x for the right side b, with bordering rows or without: by sparse factors, or by those of a chain or a band that
   are made here; returns 0 if it is singular. Or by the narrow copy of sparse factors, or those with raised pivots. */
HOT int solve_bordered(const Tables *p, const PointForces *points, Work *w, int factors, const double *b, double *x) {
  int inside = HAS(SLIDERS) && p->border.inside, bordered = HAS(SLIDERS) && p->border.rows && !inside;
  const int *reached = bordered ? w->reached : 0;
  memset(w->y, 0, p->system.positions * sizeof(double)); /* also between groups of unknowns: an earlier one may not be finite */
  if (p->system.in_order) memcpy(w->y + w->factors.order[0], b, p->free * sizeof(double));
#pragma GCC unroll 4
  for (int i = 0; !p->system.in_order && i < p->free; ++i) w->y[w->factors.order[i]] = b[i];
  if (factors == NARROW) {
    substitute_narrow(w->factors.rows, &w->narrow, w->y);
    gather(p->free, w->y, w->factors.order, x);
    return 1;
  }
  if (bordered) memset(w->bordering_right, 0, p->border.rows * sizeof(double));
  if (bordered || inside) pass_on(p, &w->factors, 1, 0, w->y, w->bordering_right);
  if (factors == RAISED) {
    if (!solve_raised(p, points, w, 1, w->y)) return 0;
  } else {
    if (!HAS(CHAIN | BAND)) substitute_forward(w->factors.rows, w->y);
    else if (!factorise_tangent(p, points, w, bordered)) return 0;
    if (bordered) substitute_back(p, w, reached, 1);
    if (bordered) solve_bordering_rows(p, w, 1, w->bordering_right, w->y);
    substitute_back(p, w, reached, 0);
  }
  if (bordered || inside) pass_on(p, &w->factors, 1, 1, w->y, w->bordering_right);
  if (p->system.in_order) memcpy(x, w->y + w->factors.order[0], p->free * sizeof(double));
  else gather(p->free, w->y, w->factors.order, x);
  return 1;
}

/* The error that a correction of this size may have, by the slowest convergence in this step and in the last one. */
static double allowed(double slowest, double slowest_before, double size, double negligible) {
  return fmax(SHARE * negligible, fmin(MOST, fmax(SHARE * fmax(slowest, slowest_before) * size, LEAST)) * size);
}

/* Solution by iterative refinement: the sum of the corrections that the factors propose, each for what the ones before leave.
   The error is what the factors propose next, and, whatever the factors are worth, the work of the residual in the step.
   Returns 0 if a factorisation is better. `rest` is the error relative to the correction, in size and root of work. */
static int refine(const Tables *p, const Numbers *s, Work *w, const Convergence *c, double *rest) {
  int n = p->free;
  double first_size = 0, first_error = 0, last_excess = 0, last_length = 0;
  double *x = w->step, *r = w->residual, *proposed = w->proposed;
  double root = sqrt(energy_of_step(p, w, kinetic(p, s, w))); /* as errors are roots of work */
  memset(x, 0, n * sizeof(double));
  memcpy(r, w->reduced, n * sizeof(double));
  for (int k = 0; k <= w->factors.reused.worth; ++k) {
    solve_bordered(p, s->points, w, w->factors.reused.narrow ? NARROW : FULL, r, proposed);
    ++w->factors.reused.now;
    double size = size_of(p, s, w, proposed), error = sqrt(fabs(dot(n, r, proposed))), length = sqrt(dot(n, r, r));
    if (!isfinite(size)) return 0;
    if (k == 0) first_size = size, first_error = error, root = fmax(root, error); /* a load step begins without any energy */
    double fine = allowed(c->sizes.slowest, w->factors.reused.slowest_size, first_size, p->newton.negligible);
    double exact = allowed(c->errors.slowest, w->factors.reused.slowest_error, first_error, p->newton.negligible * root);
    double excess = fmax(fmax(size / fine, error / exact), fabs(dot(n, r, w->z) - dot(n, r, x)) / (exact * root));
    double slowness = fmax(excess / last_excess, length / last_length);
    if (k > 0 && slowness > SLOWEST) return 0;
    add_times(n, 1, proposed, x);
    if (k > 0 && excess <= 1) {
      rest[0] = size / first_size, rest[1] = error / first_error;
      return 1;
    }
    if (k > 0 && k + log(excess) / -log(slowness) > w->factors.reused.worth) return 0;
    last_excess = excess, last_length = length;
    subtract_product(p, s->points, w, proposed, r);
  }
  return 0;
}

/* Before the first correction of a step: the factors go if the last step took longer than the average
   step since they were made, the factorisation included. */
static void begin_reused(ReusedFactors *reused) {
  reused->all += reused->now, reused->steps += 1;
  if ((long)reused->now * reused->steps > reused->worth + reused->all) reused->present = 0;
  reused->now = 0;
}

/* Largest error of a solution by the narrow copy with which this serves. */
static const double NARROW_ERROR = 1e-2;

/* Forgets the narrow copy of new factors if its solution is not nearly theirs: of a matrix that is nearly singular. */
static void judge_narrow(const Tables *p, const PointForces *points, Work *w) {
  solve_bordered(p, points, w, NARROW, w->reduced, w->proposed);
  add_times(p->free, -1, w->step, w->proposed);
  double error = dot(p->free, w->proposed, w->proposed), all = dot(p->free, w->step, w->step);
  w->factors.reused.narrow = error <= NARROW_ERROR * NARROW_ERROR * all;
}

/* The correction `step` of the unknowns for the residual `reduced`; returns 0 if the tangent is
   singular. `rest` is as in `refine`. */
static int solve_reduced(const Tables *p, const Numbers *s, Work *w, const Convergence *c, double *rest) {
  rest[0] = rest[1] = 0;
  if (!p->free) return 1;
  if (HAS(CHAIN | BAND)) return solve_bordered(p, s->points, w, FULL, w->reduced, w->step);
  w->newton.old_factors = w->newton.raised = 0;
  if (w->factors.reused.worth && w->factors.reused.present && !w->factors.reused.exact) {
    if (HAS(SLIDERS) && p->border.rows) eliminate_bordering_rows(p, w);
    if (refine(p, s, w, c, rest)) return w->newton.old_factors = 1;
    if (HAS(SLIDERS) && p->border.rows) fill_bordering_rows(p, w);
  }
  if (!factorise_tangent(p, s->points, w, 0)) {
    w->newton.raised = solve_bordered(p, s->points, w, RAISED, w->reduced, w->step) ? 1 : -1;
    if (w->newton.raised > 0 || !p->scheme.at_rest || largest(p->free, w->reduced, 0) > 0) return w->newton.raised > 0;
    memset(w->step, 0, p->free * sizeof(double)); /* a straight path that bifurcates needs no correction */
    return 1;
  }
  if (!solve_bordered(p, s->points, w, FULL, w->reduced, w->step)) return 0;
  if (w->factors.reused.narrow) judge_narrow(p, s->points, w);
  return 1;
}

/* Factors of the last tangent, where those of a step are older: the next step begins with them, and with a narrow copy if that of
   the older ones served. Returns 0 if it is singular. */
OF_STEPS int fx_renew_factors(Problem *problem) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  int narrow = w->factors.reused.narrow, regular = factorise(p, s->points, w);
  w->factors.reused.narrow &= narrow;
  if (regular) w->newton.old_factors = 0;
  return regular;
}
