/* Supports and joints (reduction.py). */

#pragma once

#include "bordering_rows.h"
#include "point_forces.h"

static void begin_points(const Tables *p, const PointForces *points, const Work *w) {
  find_slide_rates(p, points, w);
  double t = w->state.t + p->scheme.level * w->dt;
  fx_begin_points(points, w->state.q, w->state.v, w->state.slides, w->slide_rate, t, w->dt, w->state.spring_internal);
  for (int i = 0; i < p->loads.follower_forces; ++i)
    memcpy(points->of[points->external + i].numbers, w->follower_force + 2 * i, 2 * sizeof(double));
}

/* The values of T of a joint, its arm turned and the tangent of its track, at a rotation of the carrier and a slide. */
INLINED void set_arm(const Joints *joints, const Numbers *s, int j, double *frame, double psi, double d, double *values) {
  Track track = track_of(joints->track[j], s->axis + 2 * j, d, d);
  frame[0] = cos(psi), frame[1] = sin(psi);
  Two arm = turn_by(pair(frame), pair(s->offset + 2 * j) + track.place);
  values[0] = -arm[1], values[1] = arm[0];
  *(Two *)(values + 2) = turn_by(pair(frame), track.chord);
}

/* The track of a joint at an end of a step, with its chord over the step, or its tangent where forces are those at the ends. */
INLINED Track track_at(const Tables *p, const Numbers *s, int j, double d_other, double d) {
  return track_of(p->joints.track[j], s->axis + 2 * j, p->scheme.rule == 0 ? d_other : d, d);
}

/* Derivative of the increment on which forces do work, by the rotation of a joint's carrier. */
static inline double slope_of_turn(const Work *w, int j) { return 1 + w->half_turn[j] * w->half_turn[j]; }

/* Derivatives of the four values of Tv of a joint by the rotation of the carrier (0) and by the slide (1), at the start (0)
   or at the end (1) of a step. Of a joint that does not slide only those of the first two by the rotation. */
static void slopes_of_joint(const Tables *p, const Numbers *s, const Work *w, int j, int end, double by[2][4]) {
  const double *frame = w->frame + 4 * j, *values = (end ? w->values : w->values0) + 1 + 4 * j;
  double shares[] = {1 - p->scheme.level, p->scheme.level}, share = shares[end], slope = slope_of_turn(w, j);
  by[0][0] = -share * values[1], by[0][1] = share * values[0];
  if (p->joints.slide_column[j] < 0) return;
  Two bent = (end ? w->half_turn[j] : -w->half_turn[j]) * pair(w->virtual_map + 3 + 4 * j);
  double d0 = at(w->state.slides, p->joints.number[j]), d1 = d0 + at(w->z, p->joints.slide_column[j]);
  Track track = track_at(p, s, j, end ? d0 : d1, end ? d1 : d0);
  Two end_frame = pair(frame + 2 * end), between = shares[0] * pair(frame) + shares[1] * pair(frame + 2);
  Two chord = turn_by(end_frame, track.chord), bend = turn_by(p->scheme.rule == 0 ? between : 2 * share * end_frame, track.bend);
  by[1][0] = -share * values[3], by[1][1] = share * values[2];
  by[0][2] = bent[0] - slope * share * chord[1], by[0][3] = bent[1] + slope * share * chord[0];
  by[1][2] = slope * bend[0], by[1][3] = slope * bend[1];
}

/* Returns 0 in a singular position. */
static int begin_couplings(const Tables *p, const Numbers *s, const Work *w) {
  w->values0[0] = w->values[0] = w->virtual_map[0] = 1;
  for (int j = 0; HAS(COUPLED) && j < p->joints.count; ++j) {
    double d = at(w->state.slides, p->joints.number[j]);
    set_arm(&p->joints, s, j, w->frame + 4 * j, at(w->state.q, p->joints.carrier[j]), d, w->values0 + 1 + 4 * j);
  }
  for (int t = 0; HAS(LOOPS) && t < p->gears.count; ++t) w->values0[value_of_term(&p->joints, t)] = weight_of_term(s, t);
  begin_points(p, s->points, w);
  return begin_loops(p, s, w);
}

/* Small changes of all degrees of freedom for those z of the columns; without values their increments without arms. */
INLINED void spread_columns(const Tables *p, const Work *w, const double *values, double *z, double *out) {
  const int *start = p->map.run_start;
  if (!HAS(COUPLED) && !p->map.runs) return gather(p->dofs, z, p->map.column, out);
  for (int k = 0; !HAS(COUPLED) && k < p->map.runs; ++k)
    memcpy(out + start[k], z + p->map.run_column[k], (start[k + 1] - start[k]) * sizeof *out);
  if (!HAS(COUPLED)) return;
  if (p->auxiliary.count) change_auxiliaries(p, w, values, z);
  memset(out, 0, p->dofs * sizeof *out);
  for (int k = 0; k < p->map.equal; ++k) out[p->map.row[k]] += z[p->map.column[k]];
  for (int k = p->map.equal; k < p->map.count; ++k)
    if (values || p->map.value[k] == 0)
      out[p->map.row[k]] += p->map.sign[k] * (values ? values[p->map.value[k]] : 1) * z[p->map.column[k]];
}

/* Increment of all degrees of freedom for the columns z, and the values of T and Tv for it. */
HOT void expand_columns(const Tables *p, const Numbers *s, const Work *w) {
  double *D = w->D, level = p->scheme.level;
  spread_columns(p, w, 0, w->z, D); /* first rotations, on which the arms depend */
  if (!HAS(COUPLED)) return;
  for (int j = 0; j < p->joints.count; ++j) {
    double psi = at(w->state.q, p->joints.carrier[j]), Dpsi = at(D, p->joints.carrier[j]);
    double slide = at(w->z, p->joints.slide_column[j]), d0 = at(w->state.slides, p->joints.number[j]), d = d0 + slide;
    set_arm(&p->joints, s, j, w->frame + 4 * j + 2, psi + Dpsi, d, w->values + 1 + 4 * j);
    double tangent = tan(Dpsi / 2);
    w->half_turn[j] = p->scheme.rule == 0 ? tangent : 0;
    double *frame = w->frame + 4 * j, *virtual_map = w->virtual_map + 1 + 4 * j;
    /* R1 x1 - R0 x0 = (1 - R0 R1^T) R1 x1 + R0 (x1 - x0): a difference of arms would have no digits in short steps. */
    double sine = 2 * tangent / (1 + tangent * tangent);
    Two slid = turn_by(pair(frame), slide * track_of(p->joints.track[j], s->axis + 2 * j, d0, d).chord);
    *(Two *)(w->arm_change + 2 * j) = turn_by((Two){tangent * sine, sine}, arm_of(w->values, j)) + slid;
    Two start = turn_by(pair(frame), track_at(p, s, j, d, d0).chord), end = turn_by(pair(frame + 2), track_at(p, s, j, d0, d).chord);
    *(Two *)virtual_map = (1 - level) * pair(w->values0 + 1 + 4 * j) + level * pair(w->values + 1 + 4 * j);
    *(Two *)(virtual_map + 2) = slope_of_turn(w, j) * ((1 - level) * start + level * end);
  }
  if (p->auxiliary.count) spread_columns(p, w, 0, w->z, D);
  for (int k = 0; k < p->joints.followers; ++k)
    D[p->joints.follower[k]] += p->joints.sign[p->joints.through[k]] * w->arm_change[p->joints.through[k]];
  if (HAS(LOOPS)) turn_gears(p, s, w);
}

/* Increments D of all degrees of freedom, with the columns of nodes that slide on beams. */
static void expand_trees(const Tables *p, const Numbers *s, const Work *w) {
  expand_columns(p, s, w);
  for (int i = 0; HAS(SLIDERS) && i < p->sliders.count; ++i) { /* a beam may hang on a node that slides on another one */
    Slider *a = w->slider + i;
    a->s0 = w->state.slides[a->joint], a->slide = w->z[a->column], a->s1 = a->s0 + a->slide;
    slide_on(&p->scheme, &w->state, a, w->D);
    for (int c = 0; c < a->components; ++c) w->z[a->carried[c]] = a->increment[c];
    if (a->carries) expand_columns(p, s, w);
  }
}

/* Chooses the unknowns that close loops by the configuration at the end of a step; returns 0 if it is
   singular. */
static int choose_ahead(const Tables *p, const Numbers *s, const Work *w) {
  expand_trees(p, s, w);
  derive_closures(p, w, w->values, w->G);
  return choose_following(p, w);
}

/* Increments D with corrected unknowns that close loops; returns 0 if loops cannot be closed. */
static int expand(const Tables *p, const Numbers *s, const Work *w) {
  double last = HUGE_VAL;
  int left = CLOSINGS;
  expand_trees(p, s, w);
  if (HAS(LOOPS) && p->loops.closures) {
    for (; left && !correct_loops(p, s, w, &last); --left) expand_trees(p, s, w);
    derive_closures(p, w, w->virtual_map, w->G_virtual);
    factorise_closures(&p->loops, w, w->G_virtual, 1);
  }
  fx_evaluate_points(s->points, s->points->nodal, s->points->all, w->D, w->z); /* on slides */
  return left > 0;
}

/* The columns of sliding nodes in z are set. */
HOT void spread_open(const Tables *p, const Work *w, double *z, double *out) {
  spread_columns(p, w, w->values, z, out);
  for (const Slider *a = w->slider; HAS(SLIDERS) && a < w->slider + p->sliders.count; ++a) {
    for (int c = 0; c < a->components; ++c)
      z[a->carried[c]] = a->T[c][ARC] * z[a->column] + moved_by_beam(a, c, out);
    if (a->carries) spread_columns(p, w, w->values, z, out);
  }
}

/* Small changes of all degrees of freedom for those z of the columns, with unknowns that close loops. */
static void spread(const Tables *p, const Work *w, double *z, double *out) {
  if (HAS(LOOPS)) complete(&p->loops, w, z);
  spread_open(p, w, z, out);
}

/* Adds Tv^T r. */
INLINED void add_rows(const Map *map, const Work *w, const double *r, double *out) {
  const int *row = map->row, *column = map->column, *start = map->run_start, runs = HAS(COUPLED) ? 0 : map->runs;
  for (int k = 0; k < runs; ++k) add_times(start[k + 1] - start[k], 1, r + start[k], out + map->run_column[k]);
#pragma GCC unroll 4
  for (int k = 0; !runs && k < map->equal; ++k) out[column[k]] += r[HAS(COUPLED) ? row[k] : k];
  for (int k = map->equal; HAS(COUPLED) && k < map->count; ++k)
    out[map->column[k]] += map->sign[k] * w->virtual_map[map->value[k]] * r[map->row[k]];
}

/* Adds the forces r on nodes to those on columns, also those of nodes that slide on beams. */
INLINED void collect(const Tables *p, const Work *w, const double *r, double *out) {
  if (HAS(SLIDERS) && p->sliders.count) load_beams(p, w, r, out), r = w->loaded;
  add_rows(&p->map, w, r, out);
  if (HAS(COUPLED) && p->auxiliary.count) collect_auxiliaries(p, w->virtual_map, out);
}

static void project(const Tables *p, const PointForces *points, const Work *w, const double *r, double *out) {
  memset(out, 0, (p->columns + p->auxiliary.count) * sizeof *out);
  push_columns(points, out), collect(p, w, r, out);
  if (HAS(LOOPS) && p->loops.closures) close_residual(&p->loops, w, out);
  if (HAS(SLIDERS) && HAS(LOOPS) && p->loops.carried) carry_in_loops(p, points, w, r);
}

/* Nodal forces of the last residual, with those of sliding nodes on their beams. */
static const double *with_carried(const Sliders *sliders, const Work *w) { return sliders->count ? w->loaded : w->r; }

/* Adds forces on nodes to those of the joints through which they pass, and to the leading nodes. */
static void pass_forces(const Passes *passes, int first, int end, double *node_forces, double *joint_sums) {
  for (int k = first; k < end; ++k) {
    double force = node_forces[passes->dof[k]];
    joint_sums[passes->of[k]] += passes->sign[k] * force;
    if (passes->to[k] >= 0) node_forces[passes->to[k]] += force;
  }
}

/* Forces of the joints on b, but for their moments, after `project` of the last residual; those on nodes are in `passed`. */
static void pass_through_joints(const Tables *p, const Work *w) {
  double *node_forces = memcpy(w->passed, with_carried(&p->sliders, w), p->dofs * sizeof(double));
  memset(w->joint_forces, 0, 3 * p->passes.joints * sizeof(double));
  for (int k = 0; HAS(LOOPS) && k < p->loops.closures; ++k) {
    if (p->loops.b[k] >= 0) node_forces[p->loops.b[k]] -= w->closing[k];
    if (p->loops.a[k] >= 0) node_forces[p->loops.a[k]] += w->closing[k];
    w->joint_forces[p->loops.force[k]] += w->closing[k];
  }
  for (int t = 0; HAS(LOOPS) && t < p->gears.count; ++t) {
    double moment = w->virtual_map[value_of_term(&p->joints, t)] * w->closing[p->gears.closure[t]];
    if (p->gears.b[t] >= 0) node_forces[p->gears.b[t]] -= moment;
    if (p->gears.a[t] >= 0) node_forces[p->gears.a[t]] += moment;
  }
  pass_forces(&p->passes, 0, p->passes.force_count, node_forces, w->joint_forces);
}

/* Completes the reduced tangent, in the storage of its factors, after `project` of the residual. */
HOT void reduce_tangent(const Tables *p, const Numbers *s, const Work *w) {
  double *K = w->tangent, slopes[2][4], most = 0;
  if (HAS(SLIDERS)) turn_beams(&p->sliders, w);
  for (int k = 0; k < p->direct.count; ++k) K[p->direct.to[k]] += K[p->direct.from[k]];
  if (!HAS(COUPLED)) return;
  if (p->geometric.count) pass_through_joints(p, w);
  for (int k = 0; k < p->geometric.count; ++k) {
    int j = p->geometric.joint[k], kind = p->geometric.kind[k], t = j - p->joints.count;
    if (HAS(LOOPS) && t >= 0) K[p->geometric.to[k]] += p->geometric.sign[k] * w->closing[p->gears.closure[t]] * slope_of_term(p, w, t, kind);
    if (t >= 0) continue;
    double *F = w->joint_forces + 3 * p->joints.number[j], *by = slopes[kind % 2] + kind / 2 * 2;
    if (!k || j != p->geometric.joint[k - 1]) slopes_of_joint(p, s, w, j, 1, slopes);
    K[p->geometric.to[k]] += p->geometric.sign[k] * (F[0] * by[0] + F[1] * by[1]);
    if (HAS(LOOPS)) most = fmax(most, fmax(fabs(F[0]), fabs(F[1]))); /* of parallel forces K is round-off */
  }
  for (int k = 0; k < p->coupled.count; ++k) {
    if (HAS(LOOPS) && k == p->coupled.stiffened)
      K[p->coupled.stiffness_at] = fmax(stiffness_of_closures(&p->loops, K), most * s->per_unit[0]);
    K[p->coupled.to[k]] += K[p->coupled.from[k]] * w->virtual_map[p->coupled.virtual[k]] *
                         w->values[p->coupled.value[k]] * p->coupled.sign[k];
  }
  if (HAS(SLIDERS) && p->border.rows) hold_beams(&p->sliders, w), fill_bordering_rows(p, w);
}
