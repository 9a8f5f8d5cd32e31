/* Contact of nodes with lines and circles (node_contact.py). */

#pragma once

#include "algebra.h"
#include "impact.h"

/* Gap of a node at r from the point of the line, or from the centre; its gradient. */
static double gap_of(const Contact *c, const double *r, double *gradient) {
  double size = c->side != 0 ? hypot(r[0], r[1]) : 1;
  for (int i = 0; i < 2; ++i) gradient[i] = c->normal[i] + c->side / (size > 0 ? size : 1) * r[i];
  return c->normal[0] * r[0] + c->normal[1] * r[1] + c->side * (size - c->radius);
}

static void begin_contacts(const Problem *p) {
  for (int i = 0; i < p->contacts; ++i) {
    Contact *c = p->contact + i;
    double gradient[2];
    for (int k = 0; k < 2; ++k) c->r0[k] = c->X[k] + p->q[c->dof[k]] - c->point[k];
    c->g0 = gap_of(c, c->r0, gradient), c->last.repeated = 0, c->rate0 = 0;
    if (p->level != 0.5) c->rate0 = -gradient[0] * p->v[c->dof[0]] - gradient[1] * p->v[c->dof[1]];
  }
}

/* The contact at the increment D. */
typedef struct {
  double force, slope, factor, along[2], distance, normal[2], way, rate, lost;
} Push;

static Push touch(const Problem *p, const Work *w, const Contact *c) {
  double level = p->level, r1[2];
  Push f = {.factor = 1, .distance = 1};
  for (int i = 0; i < 2; ++i) r1[i] = c->r0[i] + w->D[c->dof[i]];
  double g1 = gap_of(c, r1, f.normal), mean = 0;
  f.force = push(c->k, c->g0, g1, level, &f.slope), f.way = c->g0 - g1;
  if (c->loss != 0) {
    f.rate = c->rate0 + 2 * level * (f.way / w->dt - c->rate0);
    f.factor = 1 + c->loss * tanh(f.rate / c->speed);
    f.lost = c->loss * f.force * tanh(f.way / w->dt / c->speed) * f.way;
    f.force *= f.factor;
  }
  if (c->side != 0) mean = (1 - level) * hypot(c->r0[0], c->r0[1]) + level * hypot(r1[0], r1[1]);
  if (mean > 0) f.distance = mean;
  for (int i = 0; i < 2; ++i)
    f.along[i] = c->normal[i] + c->side / f.distance * ((1 - level) * c->r0[i] + level * r1[i]);
  return f;
}

static void add_contacts(const Problem *p, const Work *w, double *out, double *K) {
  for (int n = 0; n < p->contacts; ++n) {
    Contact *c = p->contact + n;
    Push f = touch(p, w, c);
    double grows = f.slope * f.factor, bend = c->side * p->level * f.force / f.distance;
    if (c->loss != 0)
      grows -= f.force / f.factor * c->loss / c->speed * friction_slope(&c->last, f.rate / c->speed) *
               2 * p->level / w->dt;
    for (int i = 0; i < 2; ++i) {
      out[c->dof[i]] -= f.force * f.along[i];
      for (int k = 0; k < 2; ++k)
        K[c->place[2 * i + k]] -= (grows - bend) * f.along[i] * f.normal[k] + (i == k ? bend : 0);
    }
  }
}

static double lost_in_contacts(const Problem *p, const Work *w) {
  double sum = 0;
  for (int i = 0; i < p->contacts; ++i) sum += touch(p, w, p->contact + i).lost;
  return sum;
}

static double stored_in_contacts(const Problem *p) {
  double sum = 0, gradient[2];
  for (int i = 0; i < p->contacts; ++i) {
    const Contact *c = p->contact + i;
    double r[2];
    for (int k = 0; k < 2; ++k) r[k] = c->X[k] + p->q[c->dof[k]] - c->point[k];
    double g = fmin(gap_of(c, r, gradient), 0);
    sum += c->k / 2 * g * g;
  }
  return sum;
}

/* Adds the forces of a sub-step to their mean over the step. */
static void add_contact_forces(const Problem *p, const Work *w) {
  double *out = p->contact_forces;
  scale(2 * p->contacts, p->earlier, out);
  for (int i = 0; i < p->contacts; ++i) {
    Push f = touch(p, w, p->contact + i);
    for (int k = 0; k < 2; ++k) out[2 * i + k] += p->share * f.force * f.along[k];
  }
}
