/* The time loop, for a block of steps; its Python counterpart is step/stepper.py. The beam
   equations are in the functions that FFCx generates from the weak form. */

#include "local_error.h"
#include "recorder.h"
#include "tape.h"

/* Force in the middle of a step, from those at the scheme's level in it and in the one before. An equilibrium before the
   first step has no forces of inertia. */
static double mid(const Problem *p, double force, double previous) {
  int has_previous = p->scheme.at_rest ? p->state.steps_done > 0 : p->state.length > 0;
  if (p->scheme.level == 0.5 || !has_previous) return force;
  return force + (0.5 - p->scheme.level) * (force - previous);
}

/* Part of the weight that acts. */
static double acting(const Problem *p) { return p->scheme.at_rest ? p->state.ratio : 1; }

/* Dead forces with weight at the scheme's level; their mean over the step, which does the work. Python sets those of load
   steps. */
static void begin_loads(const Problem *p, const Work *w) {
  const double *start = w->loads, *end = start + p->loads.count;
  memset(w->dead, 0, p->dofs * sizeof(double));
  memset(w->force, 0, p->dofs * sizeof(double));
  for (int i = 0; p->loads.weight && i < p->dofs; ++i) w->force[i] = acting(p) * p->loads.weight[i];
  for (int k = 0; k < p->loads.count; ++k) {
    double level_load = (1 - p->scheme.level) * start[k] + p->scheme.level * end[k];
    for (int i = p->loads.start[k]; i < p->loads.start[k + 1]; ++i) {
      w->force[p->loads.dof[i]] += p->loads.force[i] * level_load;
      w->dead[p->loads.dof[i]] += p->loads.force[i] * (start[k] + end[k]) / 2;
    }
  }
}

/* Natural strains at the end of a step, unless Python sets them. */
static void begin_natural(const Problem *p, const Work *w) {
  memset(w->natural_end, 0, (long)p->cells * p->natural.per_cell * sizeof(double));
  for (int k = 0; k < p->natural.count; ++k)
    for (int i = p->natural.start[k]; i < p->natural.start[k + 1]; ++i)
      w->natural_end[p->natural.at[i]] += p->natural.value[i] * w->naturals[k];
}

/* Bound of the strain energy at the end of a step without a row: the energy of the last row, or of where several steps began,
   and what came since, of which nothing is kinetic. Only of forces in mid-step all work and losses are known. */
static double most_strain_energy(const Problem *p) {
  const double *then = p->state.energies; /* see `find_energies` */
  if (p->scheme.rule || p->scheme.rules || p->scheme.level != 0.5 || p->scheme.at_rest || p->forms.held_by_scheme.integrals)
    return HUGE_VAL;
  double came = p->state.work - then[3] - (p->state.dissipated - then[5]);
  double potential = p->loads.weight ? then[2] + dot(p->dofs, p->loads.weight, p->state.q) : 0;
  double others = fx_stored_at_points(p->points, p->state.q, p->state.slides, p->state.spring_internal);
  return then[0] + then[1] + came + potential + then[4] - others;
}

/* Counts steps that end with inverted sections (eq. 4), and stores the first configuration. */
static void count_inverted(Problem *p, const Work *w) {
  if (!(sum_over_elements(p, w, &p->forms.inversion) > 0) || p->counts.inverted++ > 0) return;
  p->counts.inverted_t = p->state.t;
  memcpy(p->inverted.q, p->state.q, p->dofs * sizeof(double));
}

/* Evaluates forms and laws with other values of the parameters. */
static void use_parameters(const Problem *p, const double *values) {
  memcpy(p->parameters.value, values, p->parameters.count * sizeof(double));
  fx_set_parameters(p->points, values);
}

/* Energy that is stored in the present state, with some values of the parameters. */
static double stored(const Problem *p, const Work *w, const double *values) {
  use_parameters(p, values);
  return sum_over_elements(p, w, &p->forms.energy) + fx_stored_at_points(p->points, p->state.q, p->state.slides,
      p->state.spring_internal);
}

/* Work of what changes parameters of stored energies, by these at the start or at the end of a sub-step: up to the level of its
   forces and from there on, or half of all if that is not mid-step. */
static double work_of_change(const Problem *p, const Work *w, const double *level, int at_end) {
  const double *end = level + p->parameters.count;
  int half = p->scheme.level != 0.5;
  if (!p->parameters.energies_vary) return 0;
  double after = stored(p, w, at_end || half ? end : level);
  double before = stored(p, w, at_end && !half ? level : p->state.parameters);
  use_parameters(p, level);
  return (after - before) / (1 + half);
}

/* Adds the work of dead loads, driven motion and added forces, and the losses of dampers, material,
   drag and contact. */
static void audit(Problem *p, const Work *w, const double *change) {
  int n = p->dofs, constrained = p->columns - p->free;
  p->state.work += dot(n, w->dead, w->path);
  p->state.dissipated += fx_lost_at_points(p->points, w->D, w->z);
  p->state.work += sum_over_elements(p, w, &p->forms.actuated);
  double taken = sum_over_elements(p, w, &p->forms.taken);
  p->state.dissipated += sum_over_elements(p, w, &p->forms.lost) + taken;
  p->state.dissipated += sum_over_elements(p, w, &p->forms.lost_to_drag);
  p->state.numerical += taken;
  if (p->parameters.energies_vary && p->forms.held_before.integrals)
    p->state.work += sum_over_elements(p, w, &p->forms.held_before) - p->state.algorithmic;
  p->state.algorithmic = sum_over_elements(p, w, &p->forms.held_by_scheme);
  project(p, w, w->r, w->reduced);
  for (int i = 0; i < p->driven; ++i) {
    double along = p->motors.slides[i] ? change[i] : at(w->path, p->motors.b[i]) - at(w->path, p->motors.a[i]);
    p->state.work += mid(p, w->reduced[p->free + i], p->state.constraint_forces[i]) * along;
  }
  scale(constrained, p->state.earlier, p->state.constraint_forces);
  add_times(constrained, p->state.share, w->reduced + p->free, p->state.constraint_forces);
  if (p->forms.has_added) {
    memset(w->f, 0, n * sizeof(double));
    assemble_forces(p, w, &p->forms.added, 0);
    fx_evaluate_points(p->points, p->points->external, p->points->nodal, w->D, w->z);
    fx_add_points(p->points, p->points->external, p->points->nodal, -1, w->f);
    for (int i = 0; i < n; ++i) p->state.work += mid(p, w->f[i], p->state.added_forces[i]) * w->path[i];
    memcpy(p->state.added_forces, w->f, n * sizeof(double));
  }
}

/* Largest force, and moment by the size of the scene. */
static double largest_force(const Problem *p, const double *forces) {
  double most = 0;
  for (int i = 0; i < p->dofs; ++i) most = fmax(most, fabs(forces[i]) / p->mesh.per_unit[i]);
  return most * p->mesh.per_unit[0];
}

/* Finds the forces of joints that friction follows, and repeats the step with them. */
static int follow_joints(Problem *p, Work *w, const double *driven) {
  /* In free fall forces of joints are what round-off leaves of the loads. */
  begin_fixed_point(&p->points->followed, fmax(largest_force(p, w->force), largest_force(p, w->f)));
  for (int k = 0, still = 0; k < MOST_TRIALS; ++k) {
    evaluate_nodes(p, w);
    find_joint_forces(p, w);
    set_axes(p, w);
    if (!follow_forces(p->points, w->joint_forces, p->state.q, w->D, p->scheme.level, still, p->state.spring_internal))
      return OK;
    long before = p->counts.iterations;
    int failure = newton(p, w, driven, GO_ON);
    if (failure) return failure;
    still = p->counts.iterations == before + 1;
  }
  return UNMET_FRICTION;
}

/* Finds the increment of a sub-step; returns why it fails. */
static int find_increment(Problem *p, const Work *w, const double *driven, int order) {
  int failure = newton(p, w, driven, order);
  if (failure && order) failure = newton(p, w, driven, 0);
  if (failure && p->system.reused.worth && !p->newton.find) {
    p->system.reused.exact = 1;
    failure = newton(p, w, driven, 0);
    p->system.reused.exact = 0;
  }
  return failure;
}

/* Takes the increment of the columns that is known, and the forces if these are. */
static int take_increment(Problem *p, const Work *w, const double *known, const double *forces) {
  memcpy(w->z, known, p->columns * sizeof(double));
  if (!(begin_couplings(p, w) || (HAS(LOOPS) && choose_ahead(p, w))) || !expand(p, w)) return SINGULAR;
  if (!forces) return OK;
  memcpy(w->r, forces + p->run.sub_step * p->dofs, p->dofs * sizeof(double));
  evaluate_nodes(p, w);
  return OK;
}

/* Takes a sub-step with the inputs number `k`; returns 0 if it fails. The increment of its columns may be known. */
static int take_step(Problem *p, Work *w, double dt, int sub_step, const Inputs *inputs, long k, const double *known) {
  p->run.sub_step = sub_step;
  const double *target = inputs->driven + k * p->driven;
  double *change = w->start;
  w->dt = dt;
  w->loads = inputs->loads + k * inputs->loads_stride;
  w->follower_force = inputs->follower_force + k * inputs->follower_force_stride;
  w->naturals = inputs->natural + k * inputs->natural_stride;
  if (!p->scheme.at_rest && (k == 0 || inputs->loads_stride)) begin_loads(p, w);
  if (inputs->natural && (k == 0 || inputs->natural_stride)) begin_natural(p, w);
  for (int i = 0; i < p->driven; ++i)
    change[i] = target[i] - (i < p->motors.prescribed ? p->state.q[p->motors.b[i]] : p->state.driven_now[i]);
  p->state.ratio = p->scheme.at_rest ? inputs->ratio : ratio_of_lengths(p, dt);
  const double *parameters = inputs->parameters + k * 2 * p->parameters.count;
  if (p->parameters.vary) use_parameters(p, parameters);
  begin_elements(p, w);
  int *order = p->predictor.orders + sub_step;
  p->run.failure = known ? take_increment(p, w, known, inputs->known_forces) : find_increment(p, w, change, *order);
  if (p->run.failure) return 0;
  if (p->at_points.friction_follows && !inputs->known && (p->run.failure = follow_joints(p, w, change))) return 0;
  if (!p->scheme.at_rest) *order = update_predictor(p, w);
  work_increment(p, w);
  if (p->run.repeats) return 1;
  audit(p, w, change);
  if (p->parameters.vary) p->state.work += work_of_change(p, w, parameters, 0);
  return 1;
}

/* The state at the end of a sub-step. */
static void advance(Problem *p, const Work *w, const Inputs *inputs, long k) {
  const double *driven = inputs->driven + k * p->driven;
  evolve(p, w);
  memcpy(p->state.natural, w->natural_end, (long)p->cells * p->natural.per_cell * sizeof(double));
  evolve_points(p->points, w->D, w->z, p->state.spring_internal);
  advance_rates(p, w, w->dt);
  if (p->scheme.keeps_previous) memcpy(p->state.q_previous, p->state.q, p->dofs * sizeof(double));
  p->state.length = w->dt;
  add_times(p->dofs, 1, w->D, p->state.q);
  for (int j = 0; HAS(COUPLED) && j < p->joints.count; ++j)
    if (p->joints.slide_column[j] >= 0) p->state.slides[p->joints.number[j]] += w->z[p->joints.slide_column[j]];
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i)
    p->state.slides[p->sliders.slider[i].joint] += w->z[p->sliders.slider[i].column];
  memcpy(p->state.driven_now, driven, p->driven * sizeof(double));
  p->state.t += w->dt;
  p->state.steps_done += 1;
  if (p->parameters.vary) {
    const double *level = inputs->parameters + k * 2 * p->parameters.count, *end = level + p->parameters.count;
    p->state.work += work_of_change(p, w, level, 1);
    use_parameters(p, end);
    memcpy(p->state.parameters, end, p->parameters.count * sizeof(double));
  }
}

/* After the sub-steps of a part of length dt, with others before it: sets the mean acceleration of the step so far, and counts
   a part that turns too far. */
static void summarise(Problem *p, const Work *w, double dt, int before, int parts) {
  const double *q = w->saved, *v = q + p->dofs, *a = v + p->dofs;
  int means = p->scheme.rule == 0 && !p->scheme.rules;
  for (int i = 0; i < p->dofs; ++i) {
    if (means) p->state.a[i] = ((p->state.v[i] - v[i]) / dt + before * a[i]) / (before + 1);
    w->scratch[i] = p->state.q[i] - q[i];
  }
  p->counts.too_large += parts > 1 && widest_turn(p, w->scratch) * parts > p->newton.large_turn;
}

/* Shares of a sub-step and of the parts before in the means over the step so far. */
static void set_shares(Problem *p, int sub_step, int before) {
  int means = p->scheme.level == 0.5;
  p->state.share = means ? p->scheme.fractions[sub_step] / (before + 1) : 1;
  p->state.earlier = means ? sub_step > 0 ? 1 : before / (before + 1.0) : 0;
}

/* Energy that losses may give in a step, relative to the energy at its end. */
static const double GIVEN = 1e-8;

/* Whether dampers gave energy in a step, which only happens where a sub-step goes back in time: there they amplify. */
static int amplifies(const Problem *p, const Work *w, double lost) {
  double given = lost - p->state.dissipated;
  if (p->scheme.sub_steps == 1 || given <= 1e-14 * fabs(lost)) return 0;
  times_mass(p, p->state.v, w->scratch);
  double energy = dot(p->dofs, p->state.v, w->scratch) / 2 + sum_over_elements(p, w, &p->forms.energy);
  return given > GIVEN * (energy + fx_stored_at_points(p->points, p->state.q, p->state.slides, p->state.spring_internal));
}

/* Returns to the state before a step that failed; counts of what was seen are kept. */
static void undo(Problem *p, const Work *w, Problem before) {
  before.run.failure = p->run.failure, before.counts.inverted = p->counts.inverted, before.counts.inverted_t = p->counts.inverted_t;
  before.counts.amplified = p->counts.amplified;
  before.control.ratios[1] = p->control.ratios[1], before.system.reused = p->system.reused;
  *p = before;
  memcpy(p->state.memory, w->saved, p->state.size * sizeof(double));
}

/* Whether a value changed its sign since the sub-step before; those now are in the second half. */
static int switched(const Problem *p) {
  double *before = p->control.sides, *now = before + p->control.switches;
  int any = 0;
  fx_find_switches(p->points, p->state.q, p->state.slides, now);
  for (int i = 0; i < p->control.switches; ++i) any |= (before[i] < 0) != (now[i] < 0), before[i] = now[i];
  return any;
}

/* Takes steps from a time, and returns how many; from step 0 on, the present state is recorded, from which the first one starts. */
OF_STEPS int fx_run(Problem *p, int steps, double t, double dt, const Inputs *inputs, const Limits *limits, Record *to) {
  Work work = work_of(p), *w = &work;
  p->control.limits = limits ? *limits : (Limits){0};
  p->state.t = t, p->run.failure = p->control.stopped = 0;  // also where no step is to be taken
  if (p->parameters.vary && !p->scheme.at_rest) use_parameters(p, p->state.parameters); /* there may be those of a trial */
  if (p->control.limits.watches) fx_find_switches(p->points, p->state.q, p->state.slides, p->control.sides);
  if (to->first == 0) record(p, w, to);
  else if (steps > 1) find_energies(p, w); /* for one step they cost more than they spare */
  for (int k = 0; k < steps; ++k) {
    int part = (to->part + k) % to->parts, step = to->first + (to->part + k) / to->parts;
    int is_row = step % to->every == 0 || step == to->last, wanted = is_row && part + 1 == to->parts;
    if (part == 0) to->starts = to->complete;
    int starts = to->starts, changed = 0;
    long taped = to->tape ? to->tape->rows : 0;
    double lost = p->state.dissipated;
    Problem before; /* of a step that may change the state and fail */
    if (p->scheme.sub_steps > 1 || p->control.limits.controlled || p->control.limits.watches || to->parts > 1) {
      before = *p;
      memcpy(w->saved, p->state.memory, p->state.size * sizeof(double));
    }
    for (int i = 0; i < p->scheme.sub_steps && !p->run.failure; ++i) {
      long number = (long)k * p->scheme.sub_steps + i;
      set_shares(p, i, part);
      if (p->scheme.level != 0.5) to->starts = to->complete;
      if (is_row && to->stores_starts) record_start(p, dt * p->scheme.fractions[i], i, to);
      const double *taped = p->run.repeats && to->tape->increments ? to->tape->increments + number * p->columns : 0;
      const double *known = inputs->known ? inputs->known + i * p->columns : taped;
      if (!take_step(p, w, dt * p->scheme.fractions[i], i, inputs, number, known)) break;
      changed = 1;
      /* Another run may start from the last step, and then has its forces in row 0. */
      int forces = is_row && (to->forces || step == to->last);
      int joints = p->passes.joints && !p->run.repeats && (p->run.keeps_joint_forces || forces);
      int found = forces || p->run.keeps_joint_forces, again = p->run.repeats;
      int contacts = (again ? forces : found) && p->points->recorded, lines = p->at_points.lines && !again && found;
      p->state.forces_found = found;
      if (joints || contacts) evaluate_nodes(p, w);
      if (joints) add_joint_forces(p, w);
      if (contacts) add_contact_forces(p);
      if (lines) add_line_forces(p, w);
      if (to->tape) put_on_tape(p, w, to->tape);
      advance(p, w, inputs, number);
      if (p->control.limits.watches && switched(p)) p->run.failure = SWITCHED;
    }
    if (!p->run.failure && amplifies(p, w, lost)) p->run.failure = AMPLIFIED, ++p->counts.amplified;
    if (p->control.limits.controlled && !p->run.failure) {
      double ratio = local_error(p, w, dt);
      p->control.ratios[0] = p->control.ratios[1], p->control.ratios[1] = ratio;
      int low = ratio >= 0 && fmax(ratio, p->control.ratios[0]) < p->control.limits.lowest;
      if (ratio > 1) p->run.failure = TOO_INACCURATE;
      else if (low || ratio > p->control.limits.highest) steps = k + 1, p->control.stopped = 1;
    }
    if (p->run.failure) { /* nothing of it is recorded */
      if (changed) undo(p, w, before);
      to->starts = starts;
      if (to->tape) to->tape->rows = taped;
      return k;
    }
    if (p->scheme.sub_steps > 1 || to->parts > 1) summarise(p, w, dt, part, to->parts);
    if (wanted) record(p, w, to);
    p->counts.taken += !p->run.repeats;
    double most = wanted ? p->state.energies[1] : steps > 1 ? most_strain_energy(p) : HUGE_VAL;
    if (most >= p->inverted.least_energy) count_inverted(p, w);
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
OF_STEPS int fx_repeat(Problem *p, int steps, double t, double dt, const Inputs *inputs, Record *to) {
  if (HAS(MEMBERS) && p->points->members) p->system.reused.present = 0;
  p->run.repeats = 1;
  int taken = fx_run(p, steps, t, dt, inputs, 0, to);
  p->run.repeats = 0;
  return taken;
}

OF_STEPS Counts fx_take_counts(Problem *p) {
  Counts counts = p->counts;
  p->counts = (Counts){0};
  return counts;
}
