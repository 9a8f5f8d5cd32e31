/* The time loop, for a block of steps; its Python counterpart is step/stepper.py. The beam
   equations are in the functions that FFCx generates from the weak form. */

#include "local_error.h"
#include "recorder.h"
#include "tape.h"

/* Mean of the forces at both ends of a step, from that at the scheme's level; `end` is at the start, then at the end of the
   step: at its level if that is below 0.5, where errors would grow. An equilibrium before the first step has no forces of inertia. */
static double mean_force(const Scheme *scheme, const State *state, double force, double *end) {
  if (scheme->level == 0.5) return force;
  int late = scheme->level > 0.5;
  double part = scheme->at_rest && !state->steps_done ? 0 : (force - *end) / (late ? scheme->level : 1);
  *end = force + late * (1 - scheme->level) * part;
  return force + (0.5 - scheme->level) * part;
}

/* Part of the weight that acts. */
static double acting(const Scheme *scheme, const State *state) { return scheme->at_rest ? state->ratio : 1; }

/* Dead forces with weight at the scheme's level; their mean over the step, which does the work. Python sets those of load
   steps. */
static void begin_loads(const Tables *p, const Numbers *s, const Work *w) {
  const double *start = w->loads, *end = start + p->loads.count;
  memset(w->dead, 0, p->dofs * sizeof(double));
  memset(w->force, 0, p->dofs * sizeof(double));
  for (int i = 0; s->weight && i < p->dofs; ++i) w->force[i] = acting(&p->scheme, &w->state) * s->weight[i];
  for (int k = 0; k < p->loads.count; ++k) {
    double level_load = (1 - p->scheme.level) * start[k] + p->scheme.level * end[k];
    for (int i = p->loads.start[k]; i < p->loads.start[k + 1]; ++i) {
      w->force[p->loads.dof[i]] += s->load_force[i] * level_load;
      w->dead[p->loads.dof[i]] += s->load_force[i] * (start[k] + end[k]) / 2;
    }
  }
  if (w->pushes) add_times(p->dofs, 1, w->pushes, w->force), add_times(p->dofs, 1, w->pushes, w->dead);
}

/* Natural strains at the end of a step, unless Python sets them. */
static void begin_natural(const Tables *p, const Numbers *s, const Work *w) {
  memset(w->natural_end, 0, (long)p->cells * p->natural.per_cell * sizeof(double));
  for (int k = 0; k < p->natural.count; ++k)
    for (int i = p->natural.start[k]; i < p->natural.start[k + 1]; ++i)
      w->natural_end[p->natural.at[i]] += s->natural[i] * w->naturals[k];
}

/* Bound of the strain energy at the end of a step without a row: the energy of the last row, or of where several steps began,
   and what came since, of which nothing is kinetic. Only of forces in mid-step all work and losses are known. */
static double most_strain_energy(const Tables *p, const Numbers *s, const State *state) {
  const double *then = state->energies; /* see `find_energies` */
  if (p->scheme.rule || p->scheme.rules || p->scheme.level != 0.5 || p->scheme.at_rest || s->forms.held_by_scheme.integrals)
    return HUGE_VAL;
  double came = state->work - then[3] - (state->dissipated - then[5]);
  double potential = s->weight ? then[2] + dot(p->dofs, s->weight, state->q) : 0;
  double others = fx_stored_at_points(s->points, state->q, state->slides, state->spring_internal);
  return then[0] + then[1] + came + potential + then[4] - others;
}

/* Counts steps that end with inverted sections (eq. 4), and stores the first configuration. */
static void count_inverted(const Tables *p, const Numbers *s, Work *w) {
  if (!(sum_over_elements(p, s, w, &s->forms.inversion) > 0) || w->counts.inverted++ > 0) return;
  w->counts.inverted_t = w->state.t;
  memcpy(w->inverted.q, w->state.q, p->dofs * sizeof(double));
}

/* Evaluates forms and laws with other values of the parameters. */
static void use_parameters(const Tables *p, const Numbers *s, const double *values) {
  memcpy(s->parameters, values, p->parameters.count * sizeof(double));
  fx_set_parameters(s->points, values);
}

/* Energy that is stored in the present state, with some values of the parameters. */
static double stored(const Tables *p, const Numbers *s, const Work *w, const double *values) {
  use_parameters(p, s, values);
  return sum_over_elements(p, s, w, &s->forms.energy) + fx_stored_at_points(s->points, w->state.q, w->state.slides,
      w->state.spring_internal);
}

/* Work of what changes parameters of stored energies, by these at the start or at the end of a sub-step: up to the level of its
   forces and from there on, or half of all if that is not mid-step. */
static double work_of_change(const Tables *p, const Numbers *s, const Work *w, const double *level, int at_end) {
  const double *end = level + p->parameters.count;
  int half = p->scheme.level != 0.5;
  if (!p->parameters.energies_vary) return 0;
  double after = stored(p, s, w, at_end || half ? end : level);
  double before = stored(p, s, w, at_end && !half ? level : w->state.parameters);
  use_parameters(p, s, level);
  return (after - before) / (1 + half);
}

/* Forces of the last residual without the inertia of the masses of `led_dof` alone. The work on these is the change of their kinetic
   energy, which is added. */
static const double *audit_led(const Tables *p, const Numbers *s, Work *w) {
  double *forces = w->correction, *a = w->scratch, *change = w->path, v0, a0;
  memset(a, 0, p->dofs * sizeof(double)), memset(change, 0, p->dofs * sizeof(double));
  for (int k = 0, i; k < p->motors.led; ++k) {
    i = p->motors.led_dof[k], v0 = w->state.v[i], a0 = w->state.a[i];
    Led end = lead(&p->scheme, &w->state, i, w->D[i], v0, a0, w->dt);
    a[i] = (1 - p->scheme.alpha_m) * end.acceleration + p->scheme.alpha_m * a0, change[i] = end.rate - v0;
  }
  times_mass(p, s, change, w->passed);
  for (int k = 0, i; k < p->motors.led; ++k) i = p->motors.led_dof[k], w->state.work += w->passed[i] * (w->state.v[i] + change[i] / 2);
  times_mass(p, s, a, w->passed);
  memcpy(forces, w->r, p->dofs * sizeof(double)), memcpy(change, w->D, p->dofs * sizeof(double));
  for (int k = 0, i; k < p->motors.led; ++k) i = p->motors.led_dof[k], forces[i] -= w->passed[i];
  return forces;
}

/* Adds the work of dead loads, driven motion and added forces, and the losses of dampers, material,
   drag and contact. */
static void audit(const Tables *p, const Numbers *s, Work *w, const double *change) {
  int n = p->dofs, constrained = p->columns - p->free;
  int led = p->motors.led > 0;
  double *ends = p->scheme.at_rest ? w->state.constraint_forces : w->state.driven_forces;
  w->state.work += dot(n, w->dead, w->path);
  w->state.dissipated += fx_lost_at_points(s->points, w->D, w->z);
  w->state.work += sum_over_elements(p, s, w, &s->forms.actuated);
  double taken = sum_over_elements(p, s, w, &s->forms.taken);
  w->state.dissipated += sum_over_elements(p, s, w, &s->forms.lost) + taken;
  w->state.dissipated += sum_over_elements(p, s, w, &s->forms.lost_to_drag);
  w->state.numerical += taken;
  if (p->parameters.energies_vary && s->forms.held_before.integrals)
    w->state.work += sum_over_elements(p, s, w, &s->forms.held_before) - w->state.algorithmic;
  w->state.algorithmic = sum_over_elements(p, s, w, &s->forms.held_by_scheme);
  project(p, s->points, w, led ? audit_led(p, s, w) : w->r, w->reduced);
  for (int i = 0; i < p->driven; ++i) {
    double along = p->motors.slides[i] ? change[i] : at(w->path, p->motors.b[i]) - at(w->path, p->motors.a[i]);
    w->state.work += mean_force(&p->scheme, &w->state, w->reduced[p->free + i], ends + i) * along;
  }
  if (led) project(p, s->points, w, w->r, w->reduced);
  scale(constrained, w->state.earlier, w->state.constraint_forces);
  add_times(constrained, w->state.share, w->reduced + p->free, w->state.constraint_forces);
  if (p->has_added) {
    memset(w->f, 0, n * sizeof(double));
    assemble_forces(p, s, w, &s->forms.added, 0);
    fx_evaluate_points(s->points, s->points->external, s->points->nodal, w->D, w->z);
    fx_add_points(s->points, s->points->external, s->points->nodal, -1, w->f);
    for (int i = 0; i < n; ++i) w->state.work += mean_force(&p->scheme, &w->state, w->f[i], w->state.added_forces + i) * w->path[i];
  }
}

/* Largest force, and moment by the size of the scene. */
static double largest_force(const Tables *p, const Numbers *s, const double *forces) {
  double most = 0;
  for (int i = 0; i < p->dofs; ++i) most = fmax(most, fabs(forces[i]) / s->per_unit[i]);
  return most * s->per_unit[0];
}

/* Finds the forces of joints that friction follows, and repeats the step with them. */
static int follow_joints(const Tables *p, const Numbers *s, Work *w, const double *driven) {
  /* In free fall forces of joints are what round-off leaves of the loads. */
  begin_fixed_point(&s->points->followed, fmax(largest_force(p, s, w->force), largest_force(p, s, w->f)));
  for (int k = 0, still = 0; k < MOST_TRIALS; ++k) {
    evaluate_nodes(s->points, w);
    find_joint_forces(p, s->points, w);
    set_axes(p, s, w);
    if (!follow_forces(s->points, w->joint_forces, w->state.q, w->D, p->scheme.level, still, w->state.spring_internal))
      return OK;
    long before = w->counts.iterations;
    int failure = newton(p, s, w, driven, GO_ON);
    if (failure) return failure;
    still = w->counts.iterations == before + 1;
  }
  return UNMET_FRICTION;
}

/* Finds the increment of a sub-step; returns why it fails. */
static int find_increment(const Tables *p, const Numbers *s, Work *w, const double *driven, int order) {
  int failure = newton(p, s, w, driven, order);
  if (failure && order) failure = newton(p, s, w, driven, 0);
  if (failure && w->factors.reused.worth && !w->newton.find) {
    w->factors.reused.exact = 1;
    failure = newton(p, s, w, driven, 0);
    w->factors.reused.exact = 0;
  }
  return failure;
}

/* Takes the increment of the columns that is known, and the forces if these are. */
static int take_increment(const Tables *p, const Numbers *s, Work *w, const double *known, const double *forces) {
  memcpy(w->z, known, p->columns * sizeof(double));
  if (!(begin_couplings(p, s, w) || (HAS(LOOPS) && choose_ahead(p, s, w))) || !expand(p, s, w)) return SINGULAR;
  if (!forces) return OK;
  memcpy(w->r, forces + w->run.sub_step * p->dofs, p->dofs * sizeof(double));
  evaluate_nodes(s->points, w);
  return OK;
}

/* Takes a sub-step with the inputs number `k`; returns 0 if it fails. The increment of its columns may be known. */
static int take_step(const Tables *p, const Numbers *s, Work *w, double dt, int sub_step, const Inputs *inputs, long k,
                     const double *known) {
  w->run.sub_step = sub_step;
  const double *target = inputs->driven + k * p->driven;
  double *change = w->start;
  w->dt = dt;
  w->loads = inputs->loads + k * inputs->loads_stride;
  w->follower_force = inputs->follower_force + k * inputs->follower_force_stride;
  w->naturals = inputs->natural + k * inputs->natural_stride;
  if (!p->scheme.at_rest && (k == 0 || inputs->loads_stride)) begin_loads(p, s, w);
  if (inputs->natural && (k == 0 || inputs->natural_stride)) begin_natural(p, s, w);
  for (int i = 0; i < p->driven; ++i)
    change[i] = target[i] - (i < p->motors.prescribed ? w->state.q[p->motors.b[i]] : w->state.driven_now[i]);
  w->state.ratio = p->scheme.at_rest ? inputs->ratio : ratio_of_lengths(&w->state, dt);
  const double *parameters = inputs->parameters + k * 2 * p->parameters.count;
  if (p->parameters.vary) use_parameters(p, s, parameters);
  begin_elements(&p->scheme, s, w);
  int *order = w->predictor.orders + sub_step;
  w->run.failure = known ? take_increment(p, s, w, known, inputs->known_forces) : find_increment(p, s, w, change, *order);
  if (w->run.failure) return 0;
  if (p->at_points.friction_follows && !inputs->known && (w->run.failure = follow_joints(p, s, w, change))) return 0;
  if (!p->scheme.at_rest) *order = update_predictor(p, s, w);
  work_increment(p, w);
  if (w->run.repeats) return 1;
  audit(p, s, w, change);
  if (p->parameters.vary) w->state.work += work_of_change(p, s, w, parameters, 0);
  return 1;
}

/* The state at the end of a sub-step. */
static void advance(const Tables *p, const Numbers *s, Work *w, const Inputs *inputs, long k) {
  const double *driven = inputs->driven + k * p->driven;
  evolve(p, s, w);
  memcpy(w->state.natural, w->natural_end, (long)p->cells * p->natural.per_cell * sizeof(double));
  evolve_points(s->points, w->D, w->z, w->state.spring_internal);
  advance_rates(p, w, w->dt);
  if (p->scheme.keeps_previous) memcpy(w->state.q_previous, w->state.q, p->dofs * sizeof(double));
  w->state.length_before = w->state.length > 0 ? w->state.length : w->dt, w->state.length = w->dt;
  add_times(p->dofs, 1, w->D, w->state.q);
  for (int j = 0; HAS(COUPLED) && j < p->joints.count; ++j)
    if (p->joints.slide_column[j] >= 0) w->state.slides[p->joints.number[j]] += w->z[p->joints.slide_column[j]];
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i)
    w->state.slides[w->slider[i].joint] += w->z[w->slider[i].column];
  memcpy(w->state.driven_now, driven, p->driven * sizeof(double));
  w->state.t += w->dt;
  w->state.steps_done += 1;
  if (p->parameters.vary) {
    const double *level = inputs->parameters + k * 2 * p->parameters.count, *end = level + p->parameters.count;
    w->state.work += work_of_change(p, s, w, level, 1);
    use_parameters(p, s, end);
    memcpy(w->state.parameters, end, p->parameters.count * sizeof(double));
  }
}

/* After the sub-steps of a part of length dt, with others before it: sets the mean acceleration of the step so far, and counts
   a part that turns too far. */
static void summarise(const Tables *p, Work *w, double dt, int before, int parts) {
  const double *q = w->saved, *v = q + p->dofs, *a = v + p->dofs;
  int means = p->scheme.rule == 0 && !p->scheme.rules;
  for (int i = 0; i < p->dofs; ++i) {
    if (means) w->state.a[i] = ((w->state.v[i] - v[i]) / dt + before * a[i]) / (before + 1);
    w->scratch[i] = w->state.q[i] - q[i];
  }
  w->counts.too_large += parts > 1 && widest_turn(&p->mesh, w->scratch) * parts > p->newton.large_turn;
}

/* Shares of a sub-step and of the parts before in the means over the step so far. */
static void set_shares(const Scheme *scheme, State *state, int sub_step, int before) {
  int means = scheme->level == 0.5;
  state->share = means ? scheme->fractions[sub_step] / (before + 1) : 1;
  state->earlier = means ? sub_step > 0 ? 1 : before / (before + 1.0) : 0;
}

/* Energy that losses may give in a step, relative to the energy at its end. */
static const double GIVEN = 1e-8;

/* Whether dampers gave energy in a step, which only happens where a sub-step goes back in time: there they amplify. */
static int amplifies(const Tables *p, const Numbers *s, const Work *w, double lost) {
  double given = lost - w->state.dissipated;
  if (p->scheme.sub_steps == 1 || given <= 1e-14 * fabs(lost)) return 0;
  times_mass(p, s, w->state.v, w->scratch);
  double energy = dot(p->dofs, w->state.v, w->scratch) / 2 + sum_over_elements(p, s, w, &s->forms.energy);
  return given > GIVEN * (energy + fx_stored_at_points(s->points, w->state.q, w->state.slides, w->state.spring_internal));
}

/* Returns to the state before a step that failed; counts of what was seen are kept. */
static void undo(Work *w, Work before) {
  before.run.failure = w->run.failure, before.counts.inverted = w->counts.inverted, before.counts.inverted_t = w->counts.inverted_t;
  before.counts.amplified = w->counts.amplified;
  before.control.ratios[1] = w->control.ratios[1], before.factors.reused = w->factors.reused;
  *w = before;
  memcpy(w->state.memory, w->saved, w->state.size * sizeof(double));
}

/* Whether a value changed its sign since the sub-step before; those now are in the second half. */
static int switched(const PointForces *points, const Work *w) {
  double *before = w->control.sides, *now = before + w->control.switches;
  int any = 0;
  fx_find_switches(points, w->state.q, w->state.slides, now);
  for (int i = 0; i < w->control.switches; ++i) any |= (before[i] < 0) != (now[i] < 0), before[i] = now[i];
  return any;
}

/* Takes steps from a time, and returns how many; from step 0 on, the present state is recorded, from which the first one starts. */
OF_STEPS int fx_run(Problem *problem, int steps, double t, double dt, const Inputs *inputs, const Limits *limits, Record *to) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  w->control.limits = limits ? *limits : (Limits){0};
  w->state.t = t, w->run.failure = w->control.stopped = 0;  // also where no step is to be taken
  if (p->parameters.vary && !p->scheme.at_rest) use_parameters(p, s, w->state.parameters); /* there may be those of a trial */
  if (w->control.limits.watches) fx_find_switches(s->points, w->state.q, w->state.slides, w->control.sides);
  if (to->first == 0) record(p, s, w, to);
  else if (steps > 1) find_energies(p, s, w); /* for one step they cost more than they spare */
  for (int k = 0; k < steps; ++k) {
    int part = (to->part + k) % to->parts, step = to->first + (to->part + k) / to->parts;
    int is_row = step % to->every == 0 || step == to->last, wanted = is_row && part + 1 == to->parts;
    if (part == 0) to->starts = to->complete;
    int starts = to->starts, changed = 0;
    long taped = to->tape ? to->tape->rows : 0;
    double lost = w->state.dissipated;
    Work before; /* of a step that may change the state and fail */
    if (p->scheme.sub_steps > 1 || w->control.limits.controlled || w->control.limits.watches || to->parts > 1) {
      before = *w;
      memcpy(w->saved, w->state.memory, w->state.size * sizeof(double));
    }
    for (int i = 0; i < p->scheme.sub_steps && !w->run.failure; ++i) {
      long number = (long)k * p->scheme.sub_steps + i;
      set_shares(&p->scheme, &w->state, i, part);
      if (p->scheme.level != 0.5) to->starts = to->complete;
      if (is_row && to->stores_starts) record_start(&p->scheme, &w->state, dt * p->scheme.fractions[i], i, to);
      const double *taped = w->run.repeats && to->tape->increments ? to->tape->increments + number * p->columns : 0;
      const double *known = inputs->known ? inputs->known + i * p->columns : taped;
      if (!take_step(p, s, w, dt * p->scheme.fractions[i], i, inputs, number, known)) break;
      changed = 1;
      /* Another run may start from the last step, and then has its forces in row 0. */
      int forces = is_row && (to->forces || step == to->last);
      int joints = p->passes.joints && !w->run.repeats && (w->run.keeps_joint_forces || forces);
      int found = forces || w->run.keeps_joint_forces, again = w->run.repeats;
      int contacts = (again ? forces : found) && s->points->recorded, lines = p->at_points.lines && !again && found;
      w->state.forces_found = found;
      if (joints || contacts) evaluate_nodes(s->points, w);
      if (joints) add_joint_forces(p, s->points, w);
      if (contacts) add_contact_forces(s->points, &w->state);
      if (lines) add_line_forces(p, s->points, w);
      if (to->tape) put_on_tape(p, s, w, to->tape);
      advance(p, s, w, inputs, number);
      if (w->control.limits.watches && switched(s->points, w)) w->run.failure = SWITCHED;
    }
    if (!w->run.failure && amplifies(p, s, w, lost)) w->run.failure = AMPLIFIED, ++w->counts.amplified;
    if (w->control.limits.controlled && !w->run.failure) {
      double ratio = local_error(p, s, w, dt);
      w->control.ratios[0] = w->control.ratios[1], w->control.ratios[1] = ratio;
      int low = ratio >= 0 && fmax(ratio, w->control.ratios[0]) < w->control.limits.lowest;
      if (ratio > 1) w->run.failure = TOO_INACCURATE;
      else if (low || ratio > w->control.limits.highest) steps = k + 1, w->control.stopped = 1;
    }
    if (w->run.failure) { /* nothing of it is recorded */
      if (changed) undo(w, before);
      to->starts = starts;
      if (to->tape) to->tape->rows = taped;
      return k;
    }
    if (p->scheme.sub_steps > 1 || to->parts > 1) summarise(p, w, dt, part, to->parts);
    if (wanted) record(p, s, w, to);
    w->counts.taken += !w->run.repeats;
    double most = wanted ? w->state.energies[1] : steps > 1 ? most_strain_energy(p, s, &w->state) : HUGE_VAL;
    if (most >= w->inverted.least_energy) count_inverted(p, s, w);
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

/* Takes steps again, for their tape alone. */
OF_STEPS int fx_repeat(Problem *problem, int steps, double t, double dt, const Inputs *inputs, Record *to) {
  const Numbers *s = &problem->numbers; Work *w = &problem->work;
  if (HAS(MEMBERS) && s->points->members) w->factors.reused.present = 0;
  w->run.repeats = 1;
  int taken = fx_run(problem, steps, t, dt, inputs, 0, to);
  w->run.repeats = 0;
  return taken;
}

OF_STEPS Counts fx_take_counts(Problem *problem) {
  Work *w = &problem->work;
  Counts counts = w->counts;
  w->counts = (Counts){0};
  return counts;
}
