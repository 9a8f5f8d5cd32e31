/* Newton's method for the increment over a step. */

#pragma once

#include "assembly.h"
#include "couplings.h"
#include "reused_factors.h"
#include "rates.h"

static void evaluate_nodes(const PointForces *points, const Work *w) {
  fx_evaluate_points(points, 0, points->nodal, w->D, w->z);
  if (HAS(MEMBERS) && points->members) fx_evaluate_members(points->members, w->D);
}

/* Adds forces along beams and their tangent that another program gives. */
static void take_beams(const Tables *p, const Work *w, double *K) {
  for (int i = 0; i < p->dofs; ++i) w->f[i] += w->newton.beam_forces[i];
  for (int i = 0; i < p->tangent.row_start[p->dofs]; ++i) K[p->tangent.stored_at[i]] += w->newton.beam_tangent[i];
}

/* Adds the internal forces to f, and their tangent to K. */
static void assemble(const Tables *p, const Numbers *s, const Work *w, double *K) {
  if (w->newton.beam_forces) take_beams(p, w, K);
  else {
    assemble_forces(p, s, w, &s->forms.internal_forces, w->slopes_only ? 0 : K);
    if (s->forms.drag.integrals) assemble_forces(p, s, w, &s->forms.drag, K);
  }
  evaluate_nodes(s->points, w);
  fx_add_points(s->points, 0, s->points->nodal, 1, w->f);
  fx_add_point_tangents(s->points, p->at_points.stored_at, K);
  if (HAS(MEMBERS) && s->points->members) fx_add_members(s->points->members, w->f);
}

/* The forces r less their change with the last correction, in `scratch`: of some rows, or of all; zero elsewhere. */
static void corrected_forces(const Tables *p, const PointForces *points, const Work *w, int rows, const int *some) {
  const double *member_product = times_members(points->members, w->correction);
  double *out = w->scratch;
  memset(out, 0, p->dofs * sizeof(double));
  for (int k = 0; k < rows; ++k) {
    int i = some ? some[k] : k;
    out[i] = w->r[i] - row_times(&p->tangent, w->tangent, i, 0, w->correction);
    if (member_product) out[i] -= member_product[i];
  }
}

/* The predictor is used up to this relative error in the previous step. */
static const double PREDICTOR_ERROR = 0.4;

/* An increment over dt makes those before older; 1 / each age. */
static inline void advance_ages(double dt, double *ages, double *per_age) {
  for (int k = PAST; k > 0; --k) ages[k] = ages[k - 1] + dt;
  ages[0] = dt;
  for (int k = 0; k <= PAST; ++k) per_age[k] = 1 / ages[k];
}

/* Number of unknowns whose differences are stored: none where each is that of a node. */
static inline int past_unknowns(const Tables *p) { return HAS(COUPLED) ? p->free : 0; }

/* Divided differences of an increment and those before, of orders 1 to PAST in their place, and of the next order. All orders
   at once: in turn, each would wait for what the one before has stored. */
INLINED void extend_differences(int n, int all, const double *restrict increment, const double *restrict per_age,
                                double *restrict past, double *restrict highest) {
#pragma GCC ivdep
  for (int i = 0; i < n; ++i) {
    double x = increment[i] * per_age[0];
#pragma GCC unroll 4
    for (int k = 0; k < PAST; ++k) {
      double now = x;
      x = (x - past[k * all + i]) * per_age[k + 1], past[k * all + i] = now;
    }
    highest[i] = x;
  }
}

/* Adds an increment to the divided differences of the last configurations and unknowns. Returns the order of
   extrapolation with the least error in this step. */
HOT int update_predictor(const Tables *p, const Numbers *s, Work *w) {
  int n = p->dofs, unknowns = past_unknowns(p), all = n + unknowns, order = 0;
  double best = PREDICTOR_ERROR * largest(n, w->D, s->per_unit), product = w->dt, per_age[PAST + 1], *highest = w->scratch;
  advance_ages(w->dt, w->predictor.ages, per_age);
  extend_differences(n, all, w->D, per_age, w->predictor.past, highest);
  extend_differences(unknowns, all, w->z, per_age, w->predictor.past + n, highest + n);
  for (int k = 1; k <= PAST && k <= w->predictor.known; ++k) {
    product *= w->predictor.ages[k];
    double error = largest(n, k < PAST ? w->predictor.past + k * all : highest, s->per_unit) * fabs(product);
    if (error <= best) best = error, order = k;
  }
  ++w->predictor.known;
  return order;
}

static double widest_turn(const Mesh *mesh, const double *D) {
  double widest = 0;
  for (int i = 0; i < mesh->nodes; ++i) widest = larger(fabs(D[3 * i + 2]), widest);
  return widest;
}

/* Adds a value; returns a bound of the one after it. */
static double next_after(Sequence *s, double value) {
  s->slowest = larger(value / (s->last * s->last), s->slowest);
  s->last = value;
  return s->slowest * value * value;
}

/* The residual of the columns from forces on nodes, less what holds the unknowns besides the forces of the model. */
static void reduce_residual(const Tables *p, const PointForces *points, const Work *w, const double *r) {
  project(p, points, w, r, w->reduced);
  for (int i = 0; w->statics.hold && i < p->free; ++i) w->reduced[i] -= w->statics.hold[i];
}

/* A viscous drag on the increments of all nodes. */
static void resist(const Tables *p, const Numbers *s, const Work *w) {
  for (int i = 0; i < p->dofs; ++i) {
    double drag = w->statics.viscosity * s->viscous_weight[i];
    if (drag > 0) w->r[i] += drag * w->D[i], w->tangent[w->statics.diagonal_at[i]] += drag;
  }
}

/* Residual, internal forces and tangent at the unknowns z. */
static void balance(const Tables *p, const Numbers *s, const Work *w) {
  double *K = w->tangent;
  work_increment(p, w);
  acceleration(p, &s->frame, w, w->dt);
  memset(w->f, 0, p->dofs * sizeof(double));
  begin_tangent(p, K);
  inertia(p, s, w, w->r, K);
  assemble(p, s, w, K);
  add_difference(p->dofs, w->f, w->force, w->r);
  if (w->statics.viscosity > 0) resist(p, s, w);
  reduce_residual(p, s->points, w, w->r);
}

static double along_step(const Tables *p, const Work *w) {
  return dot(p->free, w->reduced, w->step);
}

/* Takes another part of the last correction. */
static void retake(const Tables *p, const Numbers *s, const Work *w, double *taken, double part) {
  add_times(p->free, *taken - part, w->step, w->z);
  *taken = part;
  expand(p, s, w);
  balance(p, s, w);
}

/* A correction is too long if the residual does work against it at its end, by more than this part of that at its
   start. At most so many shorter ones are tried. */
static const double OVERSHOOT = 0.1;
enum { SHORTENINGS = 20 };

/* Goes back along a correction that was too long, to where the residual does no more work on it, by
   regula falsi. `gained` is the work at its start. Where only forces at points overshoot, the others are taken as linear. */
static void line_search(const Tables *p, const Numbers *s, const Work *w, double gained) {
  int springs = !p->internal.per_cell && !(HAS(MEMBERS) && w->statics.hold && s->points->members);
  if (springs) { /* the motion of all nodes in the last correction, which may have been shortened */
    memset(w->step + p->free, 0, (p->columns - p->free) * sizeof(double));
    spread(p, w, w->step, w->correction);
  }
  double high_work = springs ? point_deviation(s->points, w->correction, w->step, 1) : along_step(p, w);
  double low = 0, high = 1, low_work = gained, taken = 1, part = 1, work;
  if (gained <= 0 || -high_work <= OVERSHOOT * gained) return;
  for (int k = 0; k < SHORTENINGS; ++k) {
    part = (low * high_work - high * low_work) / (high_work - low_work);
    if (springs) work = gained * (1 - part) + point_deviation(s->points, w->correction, w->step, part);
    else retake(p, s, w, &taken, part), work = along_step(p, w);
    if (fabs(work) <= OVERSHOOT * gained) break;
    if (work > 0) low = part, low_work = work, high_work /= 2; else high = part, high_work = work, low_work /= 2;
  }
  if (springs) retake(p, s, w, &taken, part);
}

/* Largest work of the last correction, relative to the tolerance times the energy of the step. */
static const double ENERGY_SHARE = 1e-4;

/* Corrections that are no smaller than half the one before, after which a step ends: where the work on all parts is round-off,
   and where it is on the whole. At most so many small ones are made for the work on all. */
enum { STALLS = 3, MOST_STALLS = 8, SMALL = 3 };

/* Outcomes of a correction: another one follows, or none, as it was small enough or as small as round-off. */
enum { GOES_ON, CONVERGED, AT_ROUND_OFF };

/* Whether the last correction does at most this share of the energy of the step as work on each part, after `kinetic`; or of
   the kinetic energy of each part that moves. */
HOT int within_parts(const Parts *parts, const Work *w, double share, int moving_only) {
  double *work = w->part_energy, *energy = work + parts->count;
  if (parts->count < 2) return 1;
  memset(work, 0, 2 * parts->count * sizeof(double));
  for (int k = 0; k < parts->column_runs; ++k) {
    double sum = 0;
    for (int i = parts->column_run_start[k]; i < parts->column_run_start[k + 1]; ++i)
      sum += fabs(w->reduced[i] * w->step[i]);
    work[parts->column_run_part[k]] += sum;
  }
  for (int k = 0; k < parts->dof_runs; ++k) {
    double moving = 0, pushed = 0;
    for (int i = parts->dof_run_start[k]; i < parts->dof_run_start[k + 1]; ++i) {
      moving += fabs(w->state.v[i] * w->scratch[i]);
      pushed += (fabs(w->f[i]) + fabs(w->force[i])) * fabs(w->D[i]);
    }
    energy[parts->dof_run_part[k]] += moving_only && moving > 0 ? moving : moving + pushed;
  }
  for (int k = 0; k < parts->count; ++k) {
    double all = 0;
    for (int i = parts->inside_start[k]; i < parts->inside_start[k + 1]; ++i) all += energy[parts->inside[i]];
    if (work[k] > share * all) return 0;
  }
  return 1;
}

static const Convergence NOTHING_KNOWN = {{HUGE_VAL, 0}, {HUGE_VAL, 0}, 0, 0};

/* Judges a correction by its size, its work, and its errors `rest` (reused_factors.h). One that was shortened is far from the
   solution, whatever its work. */
static int judge(const Tables *p, const Numbers *s, const Work *w, Convergence *c, int iteration, double size, int shortened,
                 double work, const double *rest) {
  int small = size <= p->newton.tolerance, stalled = size > 0.5 * c->sizes.last && !shortened;
  double error = sqrt(fabs(work));
  double next_size = larger(next_after(&c->sizes, size), rest[0] * size);
  double next_error = larger(next_after(&c->errors, error), rest[1] * error);
  /* An equilibrium may start a motion: its error would be an acceleration. */
  int final = iteration > 2 && !p->scheme.at_rest && next_size <= p->newton.negligible;
  if (!small && !final && !stalled) return GOES_ON;
  double moving = kinetic(p, s, w), energy = energy_of_step(p, w, moving);
  final = final && next_error <= p->newton.negligible * sqrt(energy);
  /* In very stiff scenes the forces before the correction make the energy far too large. */
  if (final && fabs(work) <= p->newton.tolerance * moving && within_parts(&p->parts, w, p->newton.tolerance, 1)) return CONVERGED;
  if (!small && stalled && fabs(work) <= p->newton.energy_floor * energy)
    return ++c->stalled > (within_parts(&p->parts, w, p->newton.energy_floor, 0) ? STALLS : MOST_STALLS) ? AT_ROUND_OFF : GOES_ON;
  double most = ENERGY_SHARE * p->newton.tolerance;
  small = small && (++c->small >= SMALL || (fabs(work) <= most * energy && within_parts(&p->parts, w, most, 0)));
  return small ? CONVERGED : GOES_ON;
}

/* Counts a solve that rounding errors end, and what is left of it: a correction of this size. */
static void note_rounding(const Tables *p, const Numbers *s, Work *w, double size) {
  ++w->counts.by_round_off;
  w->counts.left += size;
  w->counts.moved = fmax(w->counts.moved, largest(p->dofs, w->state.q, s->per_unit));
  w->counts.moved = fmax(w->counts.moved, largest(p->dofs, w->D, s->per_unit));
  if (size <= w->counts.left_most) return;
  w->counts.left_most = size;
  for (int i = 0; i < p->dofs; ++i)
    if (fabs(w->correction[i] * s->per_unit[i]) == size) w->counts.left_at = i;
}

/* Whether all stiffnesses and forces of the last correction are finite: against an infinite stiffness nothing moves. An infinite
   one in a chain makes a pivot infinite. */
HOT int is_finite(const Tables *p, const Work *w) {
  int eliminated = HAS(CHAIN) ? p->system.chain * GROUP : 0;
  if (eliminated && w->newton.finite != 0) return 0;
  return isfinite(largest(p->tangent.stored - eliminated, w->tangent + eliminated, 0)) && isfinite(largest(p->dofs, w->f, 0));
}

/* Instead of the order of a prediction: from the unknowns as they are. */
enum { GO_ON = -1 };

static void set_driven(const Tables *p, const double *driven, double factor, double *columns) {
  for (int i = 0; i < p->driven; ++i) columns[p->free + i] = factor * driven[i];
}

/* Unknowns from the past increments, by which the motion over dt is extrapolated with an order. */
static void extrapolate(const Tables *p, const Work *w, int order) {
  int n = p->dofs, all = n + past_unknowns(p), size = HAS(COUPLED) ? p->free : n;
  double factor = w->dt, *sum = HAS(COUPLED) ? w->z : w->D; /* D is found anew by the unknowns */
  memset(sum, 0, size * sizeof(double));
  for (int k = 0; k < order; factor *= w->dt + w->predictor.ages[k++])
    add_times(size, factor, w->predictor.past + k * all + (HAS(COUPLED) ? n : 0), sum);
  for (int i = 0; !HAS(COUPLED) && i < n; ++i) w->z[p->map.column[i]] = sum[i];
  memset(w->z + p->free, 0, (p->columns - p->free) * sizeof(double));
}

/* Predicts the unknowns with an order, 0 for none; out of a singular position a step goes on with the last motion. Returns why
   they give no configuration. */
static int predict(const Tables *p, const Numbers *s, Work *w, const double *driven, int *order) {
  int singular = !begin_couplings(p, s, w);
  if (singular && !*order) *order = 1;
  if (*order > 0) extrapolate(p, w, *order);
  else if (*order != GO_ON) memset(w->z, 0, p->columns * sizeof(double));
  if (*order > 0) set_driven(p, driven, 1, w->z);
  if (HAS(LOOPS) && singular && !choose_ahead(p, s, w)) return OUT_OF_LINE;
  return expand(p, s, w) ? OK : OPEN_LOOP;
}

/* The residual that driven columns leave to the unknowns, which were not predicted. */
static void drive(const Tables *p, const PointForces *points, const Work *w, const double *driven) {
  memset(w->step, 0, p->free * sizeof(double));
  set_driven(p, driven, -1, w->step);
  spread(p, w, w->step, w->correction);
  corrected_forces(p, points, w, p->dofs, 0);
  reduce_residual(p, points, w, w->scratch);
}

static int iterations_of(const Tables *p, const Numbers *s, Work *w, const double *driven, int order) {
  int n = p->dofs, free = p->free, failure;
  Convergence convergence = NOTHING_KNOWN;
  double work = 0, rest[2];
  w->newton.tried = 0;
  if (w->factors.reused.worth) begin_reused(&w->factors.reused);
  if ((failure = predict(p, s, w, driven, &order))) return failure;
  for (int iteration = 1; iteration <= p->newton.max_iterations; ++iteration) {
    balance(p, s, w);
    if (iteration > 1 && p->newton.may_overshoot) line_search(p, s, w, work);
    if (p->newton.may_overshoot) note_tangents(s->points);
    if (HAS(MEMBERS) && w->factors.changing) change_rows(&p->system, s->points, &w->factors);
    for (int i = free; i < p->columns; ++i) w->step[i] = 0;
    reduce_tangent(p, s, w);
    if (iteration == 1 && !order && largest(p->driven, driven, 0) > 0) drive(p, s->points, w, driven);
    if (!solve_reduced(p, s, w, &convergence, rest)) return SINGULAR;
    spread(p, w, w->step, w->correction);
    for (int i = 0; iteration == 1 && w->newton.predicted && i < n; ++i) w->newton.predicted[i] = -w->correction[i];
    double size = largest(n, w->correction, s->per_unit);
    if (!isfinite(size)) return SINGULAR;
    w->newton.corrections[w->newton.tried++ % CORRECTIONS] = size;
    double widest = size > p->newton.longest_turn ? widest_turn(&p->mesh, w->correction) : 0;
    int shortened = widest > p->newton.longest_turn;
    if (shortened) scale(free, p->newton.longest_turn / widest, w->step);
    add_times(free, -1, w->step, w->z);
    set_driven(p, driven, 1, w->z);
    work = along_step(p, w);
    int end = judge(p, s, w, &convergence, iteration, size, shortened, work, rest);
    if (end) { /* forces of supports and joints, to first order */
      if (!is_finite(p, w)) return SINGULAR;
      corrected_forces(p, s->points, w, p->tangent.reacting, p->tangent.reacts);
      memcpy(w->r, w->scratch, n * sizeof(double));
    }
    if (!expand(p, s, w)) return OPEN_LOOP;
    if (widest_turn(&p->mesh, w->D) > p->newton.max_turn) return TURNED_TOO_FAR;
    if (end) {
      if (leaves_beam(&p->sliders, w)) return SLID_TOO_FAR;
      w->counts.iterations += iteration;
      if (end == AT_ROUND_OFF) note_rounding(p, s, w, size);
      w->factors.reused.slowest_size = convergence.sizes.slowest, w->factors.reused.slowest_error = convergence.errors.slowest;
      return OK;
    }
  }
  return NO_CONVERGENCE;
}

/* Judges a correction that another program finds (Find), and sets: `step` with the residual `reduced` before it, and how it
   moves nodes, `correction`; D and f behind it. Returns whether it is the last one. */
OF_STEPS int fx_judge(Problem *problem, Convergence *c, int iteration, int shortened) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  double exact[2] = {0}, size = largest(p->dofs, w->correction, s->per_unit);
  if (iteration == 1) *c = NOTHING_KNOWN;
  w->newton.corrections[w->newton.tried++ % CORRECTIONS] = size;
  int end = judge(p, s, w, c, iteration, size, shortened, along_step(p, w), exact);
  if (end == AT_ROUND_OFF) note_rounding(p, s, w, size);
  return end != GOES_ON;
}

/* Lets another program find the unknowns and the forces. */
static int find_elsewhere(const Tables *p, const Numbers *s, Work *w, const double *driven, int order) {
  int failure = predict(p, s, w, driven, &order), iterations = 0;
  if (failure) return failure;
  set_driven(p, driven, 1, w->z), w->newton.tried = 0;
  if ((failure = w->newton.find(w->dt, &iterations))) return failure;
  if (!expand(p, s, w)) return OPEN_LOOP;
  if (leaves_beam(&p->sliders, w)) return SLID_TOO_FAR;
  w->counts.iterations += iterations;
  evaluate_nodes(s->points, w);
  reduce_residual(p, s->points, w, w->r);
  return OK;
}

/* Largest number of searches for the members that points come near in a step. */
enum { SEARCHES_IN_STEP = 8 };

/* Newton's method with all points that come near members, which may be more than were expected. */
static int newton(const Tables *p, const Numbers *s, Work *w, const double *driven, int order) {
  for (int k = 0; k < SEARCHES_IN_STEP; ++k) {
    int failure = w->newton.find ? find_elsewhere(p, s, w, driven, order) : iterations_of(p, s, w, driven, order);
    if (failure || !HAS(MEMBERS) || !s->points->members) return failure;
    int state = fx_check_members(s->points->members, w->D);
    if (state == MEMBERS_PASSED) return PASSED_THROUGH;
    if (state == MEMBERS_SLID) return MOVED_TOO_FAR;
    if (state == MEMBERS_FINE) return OK;
  }
  return MOVED_TOO_FAR;
}
