/* The time loop, for a block of steps; its Python counterpart is stepping/stepper.py. The beam
   equations are in the functions that FFCx generates from the weak form. */

#include "newton.h"
#include "recorder.h"

static double mid(const Problem *p, double force, double previous) {
  if (p->level == 0.5 || p->steps_done == 0) return force;
  return force + (0.5 - p->level) * (force - previous);
}

/* Dead forces with weight at the scheme's level; their mean over the step, which does the work. */
static void begin_loads(const Problem *p, const Work *w, const double *loads) {
  const double *start = loads, *end = loads + p->loads;
  memset(w->dead, 0, p->dofs * sizeof(double));
  memset(w->force, 0, p->dofs * sizeof(double));
  if (p->weight) memcpy(w->force, p->weight, p->dofs * sizeof(double));
  for (int k = 0; k < p->loads; ++k) {
    double at_level = (1 - p->level) * start[k] + p->level * end[k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i) {
      w->force[p->load_dof[i]] += p->load_force[i] * at_level;
      w->dead[p->load_dof[i]] += p->load_force[i] * (start[k] + end[k]) / 2;
    }
  }
}

/* Counts steps that end with sections facing backwards, and stores the first configuration. */
static void count_inside_out(Problem *p) {
  if (p->inside_out++ > 0) return;
  p->out_t = p->t;
  memcpy(p->out_q, p->q, p->dofs * sizeof(double));
}

int fx_run(Problem *p, int steps, double dt, const Inputs *inputs, Record *to) {
  Work work, *w = &work;
  lay_out(p, w, p->scratch);
  w->dt = dt;
  begin_inertia(p, w);
  LAP(PHASES_IN_ALL);
  int n = p->dofs, held = p->columns - p->free, unchecked = 0;
  const double *fields[] = {w->D, p->q, p->v, p->a};
  for (int k = 0; k < steps; ++k) {
    if (k == 0 || inputs->load_stride) begin_loads(p, w, inputs->loads + k * inputs->load_stride);
    const double *target = inputs->driven + (long)k * p->driven;
    w->thrust = inputs->thrust + k * inputs->thrust_stride;
    double level = p->level, *change = w->start;
    for (int i = 0; i < p->driven; ++i) {
      int dof = p->driven_dof[i];
      change[i] = target[i] - (dof >= 0 ? p->q[dof] : p->driven_now[i]);
    }
    if (begin_internal(p, fields, p->t + level * dt, dt, unchecked)) count_inside_out(p);
    begin_form(p, &p->added, fields, p->t + level * dt, dt);
    LAP(AUDIT);
    p->failure = newton(p, w, dt, change);
    if (p->failure && p->order_of_prediction) {
      p->order_of_prediction = 0;
      p->failure = newton(p, w, dt, change);
    }
    if (p->failure) return k;
    LAP(CHECKS);
    update_predictor(p, w);
    LAP(PREDICTOR);

    /* Work: dead loads, driven motion, added forces. */
    work_increment(p, w);
    for (int i = 0; i < n; ++i) p->work += w->dead[i] * w->path[i];
    for (int i = 0; i < p->actuators; ++i) p->dissipated += p->actuator[i].lost;
    project(p, w, w->r, w->columns);
    for (int i = 0; i < p->driven; ++i) {
      double along;
      if (p->driven_dof[i] >= 0)
        along = w->path[p->driven_dof[i]];
      else if (p->motor_slide[i] >= 0)
        along = change[i];
      else
        along = at(w->path, p->motor_b[i]) - at(w->path, p->motor_a[i]);
      p->work += mid(p, w->columns[p->free + i], p->held[i]) * along;
    }
    memcpy(p->held, w->columns + p->free, held * sizeof(double));
    if (p->has_added) {
      memset(w->f, 0, n * sizeof(double));
      assemble_vector(p, &p->added, fields, w->f);
      add_thrusts(p, w, 1, w->f);
      for (int i = 0; i < n; ++i) p->work += mid(p, w->f[i], p->added_force[i]) * w->path[i];
      memcpy(p->added_force, w->f, n * sizeof(double));
    }

    int part = to->part + k, step = to->first + part / to->parts;
    int wanted = (part + 1) % to->parts == 0 && (step % to->every == 0 || step == to->last);
    if (wanted) record_start(p, to);
    if (to->parts > 1) p->too_large += widest_turn(p, w->D) * to->parts > p->large_turn;
    advance_rates(p, w, dt);
    for (int i = 0; i < n; ++i) p->q[i] += w->D[i];
    for (int j = 0; j < p->joints; ++j)
      if (p->slide_column[j] >= 0) p->slide[p->slide_of[j]] += w->z[p->slide_column[j]];
    memcpy(p->driven_now, target, p->driven * sizeof(double));
    p->t += dt;
    p->steps_done += 1;
    if (wanted) record(p, w, to);
    unchecked = !wanted || to->energies[6 * to->rows - 5] >= p->least_energy;
    LAP(AUDIT);
  }
  if (unchecked && begin_internal(p, fields, p->t, dt, 1)) count_inside_out(p);
  return steps;
}
