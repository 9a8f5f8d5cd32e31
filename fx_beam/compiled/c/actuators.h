/* Springs, dampers, friction and stops (spring_dampers.py). */

#pragma once

#include "impact.h"
#include "sliders.h"

static double coordinate(const Problem *p, const Actuator *a) {
  return a->slide >= 0 ? p->slide[a->slide] : at(p->q, a->b[2]) - at(p->q, a->a[2]);
}

/* Rate of the coordinate at the start of the step. */
static double rate(const Problem *p, const Actuator *a) {
  if (a->slider >= 0) return slider_rate(p, p->slider + a->slider);
  double v[3], seen[2];
  for (int i = 0; i < 3; ++i) v[i] = at(p->v, a->b[i]) - at(p->v, a->a[i]);
  if (a->slide < 0) return v[2];
  double d = p->slide[a->slide], spin = at(p->v, a->a[2]);
  turn(-at(p->q, a->a[2]), v[0], v[1], seen);
  seen[0] += spin * (a->offset[1] + d * a->axis[1]);
  seen[1] -= spin * (a->offset[0] + d * a->axis[0]);
  return a->axis[0] * seen[0] + a->axis[1] * seen[1];
}

static void begin_actuators(const Problem *p) {
  for (int i = 0; i < p->actuators; ++i) {
    Actuator *a = p->actuator + i;
    a->start = coordinate(p, a), a->last.repeated = a->last_stop.repeated = 0;
    /* At mid-step the rate is the mean rate; it does not depend on the rate at the start. */
    a->rate = p->level == 0.5 ? 0 : rate(p, a);
    if (a->variables)
      memcpy(a->given + 3, p->spring_internals + a->first, a->variables * sizeof(double));
  }
}

/* What a spring's own energy gives over a step from x0 to x1, both since its rest. */
static void stretch(const Actuator *a, double x0, double x1, double dt) {
  a->given[0] = x0, a->given[1] = x1, a->given[2] = dt;
  memset(a->found, 0, (4 + a->variables) * sizeof(double));
  a->elastic(a->found, 0, a->given, 0, 0, 0, 0);
}

/* The internal variables at the end of the step. */
static void evolve_springs(const Problem *p) {
  for (int i = 0; i < p->actuators; ++i) {
    const Actuator *a = p->actuator + i;
    if (a->variables)
      memcpy(p->spring_internals + a->first, a->found + 4, a->variables * sizeof(double));
  }
}

static double stored(const Problem *p) {
  double sum = 0;
  for (int i = 0; i < p->actuators; ++i) {
    const Actuator *a = p->actuator + i;
    double x = coordinate(p, a) - a->rest;
    sum += a->k / 2 * x * x;
    if (a->stop != 0) {
      double place = x + a->rest, deep = fmax(a->limit[0] - place, place - a->limit[1]);
      if (deep > 0) sum += a->stop / 2 * deep * deep;
    }
    if (!a->elastic) continue;
    memcpy(a->given + 3, p->spring_internals + a->first, a->variables * sizeof(double));
    stretch(a, x, x, 1);
    sum += a->found[3];
  }
  return sum;
}

/* Force of damper and friction at a rate; `slope` is the derivative without friction. */
static double resistance(const Actuator *a, double rate, double *slope) {
  double force = a->c * rate, own[2] = {0};
  *slope = a->c;
  if (a->law) a->law(own, 0, &rate, 0, 0, 0, 0), force += own[0], *slope += own[1];
  return a->friction != 0 ? force + a->friction * tanh(rate / a->speed) : force;
}

/* Adds the forces of the stops and their slopes; returns the sum of both forces, and its slope. */
static double block(const Problem *p, const Actuator *a, double change, double *force, double *stiff,
                    double *grows) {
  double sum = 0;
  *grows = 0;
  for (int i = 0; i < 2; ++i) {
    double sign = i ? -1 : 1, g0 = sign * (a->start - a->limit[i]), by_gap;
    double pushed = push(a->stop, g0, g0 + sign * change, p->level, &by_gap);
    sum += pushed, *grows += sign * by_gap;
    *force -= sign * pushed, *stiff -= by_gap;
  }
  return sum;
}

static void actuate(const Problem *p, const Work *w) {
  for (int i = 0; i < p->actuators; ++i) {
    Actuator *a = p->actuator + i;
    double change, path, ratio = 1, by_a = 0, by_b = 0, slope_a = 0, slope_b = 1;
    if (a->slide >= 0)
      change = path = w->z[a->column];
    else {
      double Da = at(w->D, a->a[2]), Db = at(w->D, a->b[2]);
      change = path = Db - Da, slope_a = 1;
      if (p->rule == 0) {
        double tan_a = tan(Da / 2), tan_b = tan(Db / 2), x = change / 2;
        path = 2 * (tan_b - tan_a), slope_a = 1 + tan_a * tan_a, slope_b = 1 + tan_b * tan_b;
        ratio = cos(Da / 2) * cos(Db / 2) * (x != 0 ? x / sin(x) : 1);
        double by_x = fabs(x) < 1e-3 ? x / 3 : 1 / x - 1 / tan(x);
        by_a = ratio * (-by_x - tan_a) / 2, by_b = ratio * (by_x - tan_b) / 2;
      }
    }
    double level = p->level, elastic = a->k * (a->start + level * change - a->rest), slope;
    double stiff = a->k * level, taken = 0, x0 = a->start - a->rest;
    double pushing = 0, grows = 0;
    a->change = change;
    if (a->stop != 0) pushing = block(p, a, change, &elastic, &stiff, &grows);
    if (a->elastic) {
      stretch(a, x0, x0 + change, w->dt);
      elastic += a->found[0], stiff += a->found[1], taken = a->found[2];
    }
    double rate = a->rate + 2 * level * (path / w->dt - a->rate);
    a->lost = resistance(a, path / w->dt, &slope) * path + taken;
    a->force = elastic * ratio + resistance(a, rate, &slope);
    if (a->friction != 0)
      slope += a->friction / a->speed * friction_slope(&a->last, rate / a->speed);
    if (a->loss != 0) {
      double x = rate / a->stop_speed, lossy = a->loss * pushing;
      a->lost += lossy * tanh(path / w->dt / a->stop_speed) * path;
      a->force += lossy * tanh(x), grows *= a->loss * tanh(x);
      slope += lossy / a->stop_speed * friction_slope(&a->last_stop, x);
    } else
      grows = 0;
    double steep = 2 * level * slope / w->dt;
    a->slope_a = -stiff * ratio + elastic * by_a - steep * slope_a - grows;
    a->slope_b = stiff * ratio + elastic * by_b + steep * slope_b + grows;
  }
}

/* Keeps the tangents of the springs' own energies. */
static void remember_tangents(const Problem *p) {
  for (int i = 0; i < p->actuators; ++i) {
    Actuator *a = p->actuator + i;
    if (a->elastic) a->tangent[0] = a->change, a->tangent[1] = a->found[0], a->tangent[2] = a->found[1];
  }
}

/* The way of each coordinate in a correction. */
static void begin_deviation(const Problem *p, const Work *w) {
  for (int i = 0; i < p->actuators; ++i) p->actuator[i].along = 0;
  for (int k = 0; k < p->pushes; ++k)
    if (p->push_column[k] < p->free)
      p->actuator[p->push_of[k]].along += p->push_sign[k] * w->step[p->push_column[k]];
}

/* Work on a part of the last correction of what the springs' forces deviate from the tangent. */
static double deviation(const Problem *p, const Work *w, double part) {
  double sum = 0;
  for (int i = 0; i < p->actuators; ++i) {
    const Actuator *a = p->actuator + i;
    if (!a->elastic) continue;
    double x0 = a->start - a->rest, now = a->change + (1 - part) * a->along;
    stretch(a, x0, x0 + now, w->dt);
    sum += a->along * (a->found[0] - a->tangent[1] - a->tangent[2] * (now - a->tangent[0]));
  }
  return sum;
}
