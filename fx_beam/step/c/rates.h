/* Nodal rates from the increment over a step (rates.py). */

#pragma once

#include "algebra.h"

/* Rotations of which tangents are computed at once: the arrays have room for nodes behind the last one (room.h). */
enum { TURNS = 4 };

/* Writes x of four nodes, but for their rotations. */
INLINED void put_with_turns(const Four *x, Four turns, double *to) {
  *(Four *)to = PICK(x[0], turns, 0, 1, 4, 3), *(Four *)(to + 4) = PICK(x[1], turns, 0, 5, 2, 3);
  *(Four *)(to + 8) = PICK(x[2], turns, 6, 1, 2, 7);
}

HOT void work_increment(const Tables *p, const Work *w) {
  const double *D = w->D;
  const Four one = {1, 1, 1, 1}, ones[] = {one, one, one};
  for (int i = 0; i < p->dofs; i += 3 * TURNS) {
    const Four x[] = {load(D + i), load(D + i + 4), load(D + i + 8)};
    Four turn = {x[0][2], x[1][1], x[2][0], x[2][3]}, slope = one;
    if (p->scheme.rule == 0) {
      double tangent[TURNS];
      *(Four *)tangent = turn / 2;
      for (int l = 0; l < TURNS; ++l) tangent[l] = tan(tangent[l]);
      turn = 2 * load(tangent), slope = one + load(tangent) * load(tangent);
    }
    put_with_turns(x, turn, w->path + i), put_with_turns(ones, slope, w->slope + i);
  }
}

static double newmark_end(const Scheme *scheme, double D, double v0, double a0, double dt) {
  return (D - dt * v0) / (scheme->beta * dt * dt) - (1 / (2 * scheme->beta) - 1) * a0;
}

/* Rate and acceleration at the end of a step of a degree of freedom that driven motions alone move, and the derivative of the
   acceleration by the increment: by the parabola and the cubic through its last places. Accelerations are as late as those of
   the other masses: that of the equation is at the level of the forces. Newmark's recursion would repeat each error in all
   further steps, with alternating signs. */
typedef struct { double rate, acceleration, slope; } Led;

static Led lead(const Scheme *scheme, const State *state, int i, double D, double v0, double a0, double dt) {
  int starts = !(state->length > 0);
  double before = starts ? dt : state->length, earlier = starts ? dt : state->length_before;
  double rate0 = starts ? v0 - dt / 2 * a0 : (state->q[i] - state->q_previous[i]) / before, rate1 = D / dt;
  double bend0 = (v0 - rate0) / before, bend1 = (rate1 - rate0) / (before + dt);
  double late = (1 - scheme->level - scheme->alpha_m) * dt, reach = (before + 2 * dt - 3 * late) / (earlier + before + dt);
  return (Led){rate1 + dt * bend1, 2 * (bend1 + reach * (bend1 - bend0)), 2 * (1 + reach) / (dt * (before + dt))};
}

/* Values of the user's rule at all nodes (compiled_laws.py): acceleration, its derivatives by the
   increment, and rates and accelerations at the end of the step. */
static void evaluate_rule(const Tables *p, const Work *w, double dt) {
  Law *rule = p->scheme.nodal_rule[w->run.sub_step % p->scheme.rules];
  double in[13] = {[12] = dt};
  for (int i = 0; i < p->mesh.nodes; ++i) {
    for (int c = 0; c < 3; ++c) {
      int k = 3 * i + c;
      in[c] = w->D[k], in[3 + c] = w->state.v[k], in[6 + c] = w->state.a[k], in[9 + c] = w->state.q[k] - w->state.q_previous[k];
    }
    memset(w->rule + RULE_VALUES * i, 0, RULE_VALUES * sizeof(double));
    rule(w->rule + RULE_VALUES * i, 0, in, 0, 0, 0, 0);
  }
}

/* Three of the values, from number `first` on, as a vector. */
static void take_values(const Mesh *mesh, const Work *w, int first, double *to) {
  for (int i = 0; i < mesh->nodes; ++i)
    for (int c = 0; c < 3; ++c) to[3 * i + c] = w->rule[RULE_VALUES * i + first + c];
}

HOT void acceleration(const Tables *p, const Frame *frame, const Work *w, double dt) {
  if (p->scheme.at_rest) { /* in a frame that turns */
    for (int i = 0; frame->spin_squared > 0 && i < p->dofs; ++i)
      w->acc[i] = i % 3 == 2 ? 0 : -w->state.ratio * frame->spin_squared
          * (frame->arm[i] + w->state.q[i] + p->scheme.level * w->D[i]);
    return;
  }
  if (p->scheme.rules) {
    evaluate_rule(p, w, dt);
    take_values(&p->mesh, w, 0, w->acc);
    return;
  }
  const double *restrict path = w->path, *restrict v = w->state.v;
  double *restrict acc = w->acc, per_dt = 1 / dt;
  if (p->scheme.rule == 0)
    for (int i = 0; i < p->dofs; ++i) acc[i] = 2 * per_dt * (path[i] * per_dt - v[i]);
  else
    for (int i = 0; i < p->dofs; ++i) {
      double a1 = newmark_end(&p->scheme, w->D[i], v[i], w->state.a[i], dt);
      acc[i] = (1 - p->scheme.alpha_m) * a1 + p->scheme.alpha_m * w->state.a[i];
    }
  for (int k = 0; k < p->motors.led; ++k) {
    int i = p->motors.led_dof[k];
    Led end = lead(&p->scheme, &w->state, i, w->D[i], v[i], w->state.a[i], dt);
    acc[i] = (1 - p->scheme.alpha_m) * end.acceleration + p->scheme.alpha_m * w->state.a[i];
    w->slope[i] = end.slope * p->scheme.beta * dt * dt; /* relative to `steepness` */
  }
}

/* Derivative of the acceleration with respect to the increment of `work_increment`. */
static double steepness(const Scheme *scheme, const Frame *frame, const State *state, double dt) {
  if (scheme->at_rest) return -state->ratio * frame->spin_squared * scheme->level;
  return (scheme->rule == 0 ? 2 : (1 - scheme->alpha_m) / scheme->beta) / (dt * dt);
}

/* Forces r of the masses, for an `acceleration`, and their derivatives by the increment in the tangent K, but for those that
   elements set with their own. */
HOT void inertia(const Tables *p, const Numbers *s, const Work *w, double *r, double *K) {
  double steep = p->scheme.rules ? 0 : steepness(&p->scheme, &s->frame, &w->state, w->dt);
  multiply_mass(p, s, w->acc, r, K, steep, w->slope, w->slopes_only || w->newton.beam_forces ? 0 : p->mass.by_elements);
  for (int k = 0; p->scheme.rules && k < 9 * p->mass.start[p->mesh.nodes]; ++k)
    K[p->scheme.rule_stored_at[k]] += s->mass[k / 3] * w->rule[RULE_VALUES / 3 * p->mass.dof[k / 9] + 3 + k % 9];
}

HOT void advance_rates(const Tables *p, Work *w, double dt) {
  if (p->scheme.at_rest) return;
  const double *restrict path = w->path;
  double *restrict v = w->state.v, *restrict a = w->state.a, *restrict v0 = w->scratch, *restrict a0 = w->acc, per_dt = 1 / dt;
  int newmark = p->scheme.rule && !p->scheme.rules;
  memcpy(v0, v, p->dofs * sizeof *v);
  if (p->scheme.rules) {
    evaluate_rule(p, w, dt);
    take_values(&p->mesh, w, 12, v), take_values(&p->mesh, w, 15, a);
  } else if (p->scheme.rule == 0)
    for (int i = 0; i < p->dofs; ++i) v[i] = 2 * per_dt * path[i] - v0[i], a[i] = per_dt * (v[i] - v0[i]);
  else
    for (int i = 0; i < p->dofs; ++i) {
      double a1 = newmark_end(&p->scheme, w->D[i], v0[i], a[i], dt);
      v[i] += dt * ((1 - p->scheme.gamma) * a[i] + p->scheme.gamma * a1), a0[i] = a[i], a[i] = a1;
    }
  for (int k = 0; k < p->mesh.massless_count; ++k) {
    int i = p->mesh.massless[k];
    v[i] = per_dt * path[i], a[i] = per_dt * (v[i] - v0[i]);
    /* Newmark's formulas take v as that at the end: the mean, and half a step with the acceleration since the mean before. */
    if (newmark) a[i] = (2 * (v[i] - v0[i]) + w->state.length * a0[i]) / (dt + w->state.length), v[i] += dt / 2 * a[i];
  }
  for (int k = 0; k < p->motors.led; ++k) {
    int i = p->motors.led_dof[k];
    Led end = lead(&p->scheme, &w->state, i, w->D[i], v0[i], a0[i], dt);
    v[i] = end.rate, a[i] = end.acceleration;
  }
}
