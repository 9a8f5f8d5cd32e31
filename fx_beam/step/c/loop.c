/* The time loop, for a block of steps; its Python counterpart is step/stepper.py. The beam
   equations are in the functions that FFCx generates from the weak form. */

#include "local_error.h"
#include "recorder.h"
#include "tape.h"

/* Force in the middle of a step, from those at the scheme's level in it and in the one before. An equilibrium before the
   first step has no forces of inertia. */
static double mid(const Problem *p, double force, double previous) {
  int has_previous = p->at_rest ? p->steps_done > 0 : p->length > 0;
  if (p->level == 0.5 || !has_previous) return force;
  return force + (0.5 - p->level) * (force - previous);
}

/* Part of the weight that acts. */
static double acting(const Problem *p) { return p->at_rest ? p->ratio : 1; }

/* Dead forces with weight at the scheme's level; their mean over the step, which does the work. Python sets those of load
   steps. */
static void begin_loads(const Problem *p, const Work *w) {
  const double *start = w->loads, *end = start + p->loads;
  memset(w->dead, 0, p->dofs * sizeof(double));
  memset(w->force, 0, p->dofs * sizeof(double));
  for (int i = 0; p->weight && i < p->dofs; ++i) w->force[i] = acting(p) * p->weight[i];
  for (int k = 0; k < p->loads; ++k) {
    double at_level = (1 - p->level) * start[k] + p->level * end[k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i) {
      w->force[p->load_dof[i]] += p->load_force[i] * at_level;
      w->dead[p->load_dof[i]] += p->load_force[i] * (start[k] + end[k]) / 2;
    }
  }
}

/* Natural strains at the end of a step, unless Python sets them. */
static void begin_natural(const Problem *p, const Work *w) {
  memset(w->natural_end, 0, (long)p->cells * p->cell_natural * sizeof(double));
  for (int k = 0; k < p->naturals; ++k)
    for (int i = p->natural_start[k]; i < p->natural_start[k + 1]; ++i)
      w->natural_end[p->natural_at[i]] += p->natural_value[i] * w->naturals[k];
}

/* Bound of the strain energy at the end of a step without a row: the energy of the last row, or of where several steps began,
   and what came since, of which nothing is kinetic. Only of forces in mid-step all work and losses are known. */
static double most_strain_energy(const Problem *p) {
  const double *then = p->energies; /* see `find_energies` */
  if (p->rule || p->rules || p->level != 0.5 || p->at_rest || p->held_by_scheme.integrals) return HUGE_VAL;
  double came = p->work - then[3] - (p->dissipated - then[5]);
  double potential = p->weight ? then[2] + dot(p->dofs, p->weight, p->q) : 0;
  double others = fx_stored_at_points(p->points, p->q, p->slides, p->spring_internal);
  return then[0] + then[1] + came + potential + then[4] - others;
}

/* Counts steps that end with inverted sections (eq. 4), and stores the first configuration. */
static void count_inverted(Problem *p, const Work *w) {
  if (!(sum_over_elements(p, w, &p->inversion) > 0) || p->inverted++ > 0) return;
  p->inverted_t = p->t;
  memcpy(p->inverted_q, p->q, p->dofs * sizeof(double));
}

/* Evaluates forms and laws with other values of the parameters. */
static void use_parameters(const Problem *p, const double *values) {
  memcpy(p->parameter, values, p->parameter_count * sizeof(double));
  fx_set_parameters(p->points, values);
}

/* Energy that is stored in the present state, with some values of the parameters. */
static double stored(const Problem *p, const Work *w, const double *values) {
  use_parameters(p, values);
  return sum_over_elements(p, w, &p->energy) + fx_stored_at_points(p->points, p->q, p->slides, p->spring_internal);
}

/* Work of what changes parameters of stored energies, by these at the start or at the end of a sub-step: up to the level of its
   forces and from there on, or half of all if that is not mid-step. */
static double work_of_change(const Problem *p, const Work *w, const double *level, int at_end) {
  const double *end = level + p->parameter_count;
  int half = p->level != 0.5;
  if (!p->energies_vary) return 0;
  double after = stored(p, w, at_end || half ? end : level), before = stored(p, w, at_end && !half ? level : p->parameters);
  use_parameters(p, level);
  return (after - before) / (1 + half);
}

/* Adds the work of dead loads, driven motion and added forces, and the losses of dampers, material,
   drag and contact. */
static void audit(Problem *p, const Work *w, const double *change) {
  int n = p->dofs, constrained = p->columns - p->free;
  p->work += dot(n, w->dead, w->path);
  p->dissipated += fx_lost_at_points(p->points, w->D, w->z);
  p->work += sum_over_elements(p, w, &p->actuated);
  double taken = sum_over_elements(p, w, &p->taken);
  p->dissipated += sum_over_elements(p, w, &p->lost) + taken;
  p->dissipated += sum_over_elements(p, w, &p->lost_to_drag);
  p->numerical += taken;
  if (p->energies_vary && p->held_before.integrals) p->work += sum_over_elements(p, w, &p->held_before) - p->algorithmic;
  p->algorithmic = sum_over_elements(p, w, &p->held_by_scheme);
  project(p, w, w->r, w->reduced);
  for (int i = 0; i < p->driven; ++i) {
    double along = p->motor_slides[i] ? change[i] : at(w->path, p->driven_b[i]) - at(w->path, p->driven_a[i]);
    p->work += mid(p, w->reduced[p->free + i], p->constraint_forces[i]) * along;
  }
  scale(constrained, p->earlier, p->constraint_forces);
  add_times(constrained, p->share, w->reduced + p->free, p->constraint_forces);
  if (p->has_added) {
    memset(w->f, 0, n * sizeof(double));
    assemble_forces(p, w, &p->added, 0);
    fx_evaluate_points(p->points, p->points->external, p->points->nodal, w->D, w->z);
    fx_add_points(p->points, p->points->external, p->points->nodal, -1, w->f);
    for (int i = 0; i < n; ++i) p->work += mid(p, w->f[i], p->added_forces[i]) * w->path[i];
    memcpy(p->added_forces, w->f, n * sizeof(double));
  }
}

/* Largest force, and moment by the size of the scene. */
static double largest_force(const Problem *p, const double *forces) {
  double most = 0;
  for (int i = 0; i < p->dofs; ++i) most = fmax(most, fabs(forces[i]) / p->per_unit[i]);
  return most * p->per_unit[0];
}

/* Finds the forces of joints that friction follows, and repeats the step with them. */
static int follow_joints(Problem *p, Work *w, const double *driven) {
  /* In free fall forces of joints are what round-off leaves of the loads. */
  begin_fixed_point(&p->points->followed, fmax(largest_force(p, w->force), largest_force(p, w->f)));
  for (int k = 0, still = 0; k < MOST_TRIALS; ++k) {
    evaluate_nodes(p, w);
    find_joint_forces(p, w);
    set_axes(p, w);
    if (!follow_forces(p->points, w->joint_forces, p->q, w->D, p->level, still, p->spring_internal)) return OK;
    long before = p->iterations;
    int failure = newton(p, w, driven, GO_ON);
    if (failure) return failure;
    still = p->iterations == before + 1;
  }
  return UNMET_FRICTION;
}

/* Finds the increment of a sub-step; returns why it fails. */
static int find_increment(Problem *p, const Work *w, const double *driven, int order) {
  int failure = newton(p, w, driven, order);
  if (failure && order) failure = newton(p, w, driven, 0);
  if (failure && p->reused.worth && !p->find) {
    p->reused.exact = 1;
    failure = newton(p, w, driven, 0);
    p->reused.exact = 0;
  }
  return failure;
}

/* Takes the increment of the columns that is known, and the forces with it. */
static int take_increment(Problem *p, const Work *w, const double *known) {
  memcpy(w->z, known, p->columns * sizeof(double));
  if (!(begin_couplings(p, w) || (HAS(LOOPS) && choose_ahead(p, w))) || !expand(p, w)) return SINGULAR;
  if (!p->known_forces) return OK;
  memcpy(w->r, p->known_forces + p->sub_step * p->dofs, p->dofs * sizeof(double));
  evaluate_nodes(p, w);
  return OK;
}

/* Takes a sub-step with the inputs number `k`; returns 0 if it fails. The increment of its columns may be known. */
static int take_step(Problem *p, Work *w, double dt, int sub_step, const Inputs *inputs, long k, const double *known) {
  p->sub_step = sub_step;
  const double *target = inputs->driven + k * p->driven;
  double *change = w->start;
  w->dt = dt;
  w->loads = inputs->loads + k * inputs->loads_stride;
  w->follower_force = inputs->follower_force + k * inputs->follower_force_stride;
  w->naturals = inputs->natural + k * inputs->natural_stride;
  if (!p->at_rest && (k == 0 || inputs->loads_stride)) begin_loads(p, w);
  if (p->naturals && (k == 0 || inputs->natural_stride)) begin_natural(p, w);
  for (int i = 0; i < p->driven; ++i)
    change[i] = target[i] - (i < p->prescribed ? p->q[p->driven_b[i]] : p->driven_now[i]);
  if (!p->at_rest) p->ratio = ratio_of_lengths(p, dt);
  const double *parameters = inputs->parameters + k * 2 * p->parameter_count;
  if (p->parameters_vary) use_parameters(p, parameters);
  begin_elements(p, w);
  int *order = p->orders + sub_step;
  p->failure = known ? take_increment(p, w, known) : find_increment(p, w, change, *order);
  if (p->failure) return 0;
  if (p->friction_follows && !p->known && (p->failure = follow_joints(p, w, change))) return 0;
  if (!p->at_rest) *order = update_predictor(p, w);
  work_increment(p, w);
  if (p->repeats) return 1;
  audit(p, w, change);
  if (p->parameters_vary) p->work += work_of_change(p, w, parameters, 0);
  return 1;
}

/* The state at the end of a sub-step. */
static void advance(Problem *p, const Work *w, const Inputs *inputs, long k) {
  const double *driven = inputs->driven + k * p->driven;
  evolve(p, w);
  memcpy(p->natural, w->natural_end, (long)p->cells * p->cell_natural * sizeof(double));
  evolve_points(p->points, w->D, w->z, p->spring_internal);
  advance_rates(p, w, w->dt);
  if (p->keeps_previous) memcpy(p->q_previous, p->q, p->dofs * sizeof(double));
  p->length = w->dt;
  add_times(p->dofs, 1, w->D, p->q);
  for (int j = 0; HAS(COUPLED) && j < p->joints; ++j)
    if (p->slide_column[j] >= 0) p->slides[p->slide_of[j]] += w->z[p->slide_column[j]];
  for (int i = 0; HAS(SLIDERS) && i < p->sliders; ++i) p->slides[p->slider[i].joint] += w->z[p->slider[i].column];
  memcpy(p->driven_now, driven, p->driven * sizeof(double));
  p->t += w->dt;
  p->steps_done += 1;
  if (p->parameters_vary) {
    const double *level = inputs->parameters + k * 2 * p->parameter_count, *end = level + p->parameter_count;
    p->work += work_of_change(p, w, level, 1);
    use_parameters(p, end);
    memcpy(p->parameters, end, p->parameter_count * sizeof(double));
  }
}

/* After the sub-steps of a part of length dt, with others before it: sets the mean acceleration of the step so far, and counts
   a part that turns too far. */
static void summarise(Problem *p, const Work *w, double dt, int before, int parts) {
  const double *q = w->saved, *v = q + p->dofs, *a = v + p->dofs;
  int means = p->rule == 0 && !p->rules;
  for (int i = 0; i < p->dofs; ++i) {
    if (means) p->a[i] = ((p->v[i] - v[i]) / dt + before * a[i]) / (before + 1);
    w->scratch[i] = p->q[i] - q[i];
  }
  p->too_large += parts > 1 && widest_turn(p, w->scratch) * parts > p->large_turn;
}

/* Shares of a sub-step and of the parts before in the means over the step so far. */
static void set_shares(Problem *p, int sub_step, int before) {
  int means = p->level == 0.5;
  p->share = means ? p->fractions[sub_step] / (before + 1) : 1;
  p->earlier = means ? sub_step > 0 ? 1 : before / (before + 1.0) : 0;
}

/* Energy that losses may give in a step, relative to the energy at its end. */
static const double GIVEN = 1e-8;

/* Whether dampers gave energy in a step, which only happens where a sub-step goes back in time: there they amplify. */
static int amplifies(const Problem *p, const Work *w, double lost) {
  double given = lost - p->dissipated;
  if (p->sub_steps == 1 || given <= 1e-14 * fabs(lost)) return 0;
  times_mass(p, p->v, w->scratch);
  double energy = dot(p->dofs, p->v, w->scratch) / 2 + sum_over_elements(p, w, &p->energy);
  return given > GIVEN * (energy + fx_stored_at_points(p->points, p->q, p->slides, p->spring_internal));
}

/* Returns to the state before a step that failed; counts of what was seen are kept. */
static void undo(Problem *p, const Work *w, Problem before) {
  before.failure = p->failure, before.inverted = p->inverted, before.inverted_t = p->inverted_t;
  before.amplified = p->amplified;
  before.ratios[1] = p->ratios[1], before.reused = p->reused;
  *p = before;
  memcpy(p->memory, w->saved, p->memory_size * sizeof(double));
}

/* Whether a value changed its sign since the sub-step before; those now are in the second half. */
static int switched(const Problem *p) {
  double *before = p->sides, *now = before + p->switches;
  int any = 0;
  fx_find_switches(p->points, p->q, p->slides, now);
  for (int i = 0; i < p->switches; ++i) any |= (before[i] < 0) != (now[i] < 0), before[i] = now[i];
  return any;
}

/* Takes steps, and returns how many; from step 0 on, the present state is recorded, from which the first one starts. */
OF_STEPS int fx_run(Problem *p, int steps, double dt, const Inputs *inputs, Record *to) {
  Work work = work_of(p), *w = &work;
  p->failure = p->stopped = 0;  // also where no step is to be taken
  if (p->parameters_vary && !p->at_rest) use_parameters(p, p->parameters); /* there may be those of a trial */
  if (p->watches) fx_find_switches(p->points, p->q, p->slides, p->sides);
  if (to->first == 0) record(p, w, to);
  else if (steps > 1) find_energies(p, w); /* for one step they cost more than they spare */
  for (int k = 0; k < steps; ++k) {
    int part = (to->part + k) % to->parts, step = to->first + (to->part + k) / to->parts;
    int of_row = step % to->every == 0 || step == to->last, wanted = of_row && part + 1 == to->parts;
    if (part == 0) to->starts = to->complete;
    int starts = to->starts, changed = 0;
    long taped = to->tape ? to->tape->rows : 0;
    double lost = p->dissipated;
    Problem before; /* of a step that may change the state and fail */
    if (p->sub_steps > 1 || p->controlled || p->watches || to->parts > 1) {
      before = *p;
      memcpy(w->saved, p->memory, p->memory_size * sizeof(double));
    }
    for (int i = 0; i < p->sub_steps && !p->failure; ++i) {
      long number = (long)k * p->sub_steps + i;
      set_shares(p, i, part);
      if (p->level != 0.5) to->starts = to->complete;
      if (of_row && to->stores_starts) record_start(p, dt * p->fractions[i], i, to);
      const double *known = p->known ? p->known + i * p->columns : p->repeats && to->tape->increments ? to->tape->increments + number * p->columns : 0;
      if (!take_step(p, w, dt * p->fractions[i], i, inputs, number, known)) break;
      changed = 1;
      /* Another run may start from the last step, and then has its forces in row 0. */
      int forces = of_row && (to->forces || step == to->last);
      int joints = p->scene_joints && !p->repeats && (p->keeps_joint_forces || forces);
      int contacts = forces && p->points->recorded, found = forces || p->keeps_joint_forces;
      int lines = p->lines && !p->repeats && found;
      p->forces_found = found;
      if (joints || contacts) evaluate_nodes(p, w);
      if (joints) add_joint_forces(p, w);
      if (contacts) add_contact_forces(p);
      if (lines) add_line_forces(p, w);
      if (to->tape) put_on_tape(p, w, to->tape);
      advance(p, w, inputs, number);
      if (p->watches && switched(p)) p->failure = SWITCHED;
    }
    if (!p->failure && amplifies(p, w, lost)) p->failure = AMPLIFIED, ++p->amplified;
    if (p->controlled && !p->failure) {
      double ratio = local_error(p, w, dt);
      p->ratios[0] = p->ratios[1], p->ratios[1] = ratio;
      int low = ratio >= 0 && fmax(ratio, p->ratios[0]) < p->lowest;
      if (ratio > 1) p->failure = TOO_INACCURATE;
      else if (low || ratio > p->highest) steps = k + 1, p->stopped = 1;
    }
    if (p->failure) { /* nothing of it is recorded */
      if (changed) undo(p, w, before);
      to->starts = starts;
      if (to->tape) to->tape->rows = taped;
      return k;
    }
    if (p->sub_steps > 1 || to->parts > 1) summarise(p, w, dt, part, to->parts);
    if (wanted) record(p, w, to);
    ++p->completed;
    double most = wanted ? p->energies[1] : steps > 1 ? most_strain_energy(p) : HUGE_VAL;
    if (most >= p->least_energy) count_inverted(p, w);
  }
  return steps;
}

#include "equations.h"

#ifdef VJP
#include "adjoint.h"
#elif defined JVP
#include "forward.h"
#elif defined FIT
#include "fitted_rates.h"
#endif
