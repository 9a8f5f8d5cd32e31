/* Histories, energies and momenta (recorder.py, records.py). */

#pragma once

#include "assembly.h"
#include "couplings.h"

/* The joint forces of a sub-step; forces at nodes are evaluated. */
static void find_joint_forces(const Tables *p, const PointForces *points, const Work *w) {
  double *node_forces = w->passed, *joint_sums = w->joint_forces;
  pass_through_joints(p, w);
  /* Joints with an offset or a slide exert a moment on their guiding node, which is no moment of another
     joint. */
  for (int j = 0; HAS(COUPLED) && j < p->joints.count; ++j) {
    const double *lever = w->virtual_map + 1 + 4 * j, *F = joint_sums + 3 * p->joints.number[j];
    if (p->joints.carrier[j] >= 0) node_forces[p->joints.carrier[j]] += lever[0] * F[0] + lever[1] * F[1];
  }
  for (const PointForce *e = points->of; e < points->of + points->nodal; ++e)
    if (e->joint >= 0) joint_sums[3 * e->joint + 2] -= e->results[1];
  pass_forces(&p->passes, p->passes.force_count, p->passes.count, node_forces, joint_sums);
}

/* Adds them to their mean over the step. */
static void add_joint_forces(const Tables *p, const PointForces *points, const Work *w) {
  long n = 3 * p->passes.joints;
  find_joint_forces(p, points, w);
  scale(n, w->state.earlier, w->state.joint_forces);
  add_times(n, w->state.share, w->joint_forces, w->state.joint_forces);
}

/* Adds the forces of contact of a sub-step to their mean over the step. */
static void add_contact_forces(const PointForces *points, const State *state) {
  double *out = state->contact_forces;
  scale(2 * points->recorded, state->earlier, out);
  if (HAS(MEMBERS) && points->members)
    record_members(points->members, state->share, out + 2 * points->contacts);
  for (const PointForce *e = points->of; e < points->of + points->contacts; ++e, out += 2)
    for (int i = 0; i < 2 * e->nodes; ++i) out[i % 2] -= state->share * e->results[i];
}

/* Adds the pulls along lines between points of a sub-step to their means over the step. */
static void add_line_forces(const Tables *p, const PointForces *points, const Work *w) {
  scale(p->at_points.lines, w->state.earlier, w->state.line_forces);
  for (const PointForce *e = points->of; e < points->of + points->nodal; ++e) {
    if (!e->pull) continue;
    coordinates(e, w->D, w->z, e->column, e->given + e->size);
    call_value(e, e->pull, points->probe, 1);
    w->state.line_forces[e->line] += w->state.share * *points->probe;
  }
}

static void add_row(const Rows *rows, int count, long k) {
  for (const Rows *r = rows; r < rows + count; ++r)
    memcpy(r->target + k * r->size, r->source, r->size * sizeof(double));
}

/* Start of a sub-step of length dt, for which forces of elements are evaluated. */
static void record_start(const Scheme *scheme, const State *state, double dt, int sub_step, Record *to) {
  long k = to->starts++;
  to->share[k] = scheme->fractions[sub_step] / to->parts;
  if (to->memory) to->memory[k] = ratio_of_lengths(state, dt);
  add_row(to->start, to->stored, k);
}

/* Energies of the present state; the momenta of the nodes are left in `scratch`. */
static void find_energies(const Tables *p, const Numbers *s, Work *w) {
  long n = p->dofs;
  double *momentum = w->scratch, *energy = w->state.energies;
  times_mass(p, s, w->state.v, momentum);
  energy[0] = dot(n, w->state.v, momentum) / 2;
  energy[1] = sum_over_elements(p, s, w, &s->forms.energy);
  energy[2] = s->weight ? -dot(n, s->weight, w->state.q) : 0;
  energy[4] = fx_stored_at_points(s->points, w->state.q, w->state.slides, w->state.spring_internal);
  energy[3] = w->state.work, energy[5] = w->state.dissipated, energy[6] = w->state.algorithmic, energy[7] = w->state.numerical;
}

/* Energies, momenta and the other quantities at the end of a step. */
static void record(const Tables *p, const Numbers *s, Work *w, Record *to) {
  long k = to->rows++;
  to->up_to_row[k] = to->complete = to->starts;
  double *momentum = w->scratch, *sums = memset(w->state.momenta, 0, sizeof w->state.momenta);
  find_energies(p, s, w);
  for (int i = 0; i < p->mesh.nodes; ++i) {
    const double *q = w->state.q + 3 * i, *node_momentum = momentum + 3 * i;
    double x = s->position[2 * i] + q[0], y = s->position[2 * i + 1] + q[1];
    sums[0] += node_momentum[0], sums[1] += node_momentum[1];
    sums[2] += x * node_momentum[1] - y * node_momentum[0] + node_momentum[2];
  }
  add_row(to->history, to->histories, k);
}
