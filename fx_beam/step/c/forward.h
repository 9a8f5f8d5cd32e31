/* The derivatives of a run, forwards (docs/theory/derivatives.md): from changes of the numbers of a scene to
   those of the states at the ends of sub-steps. Each direction is a change of all numbers. A group of GROUP_SIZE directions
   is followed at once, as all of them need the same numbers of a sub-step; in the comments "the change" of something
   is that in the directions of a group. */

#pragma once

#include "element_derivatives.h"

/* Sets the changes of the configuration at the end, for the solution in the block or with none for held unknowns. Where
   nothing is COUPLED it does not go through columns. */
static void set_ends(const Tables *p, const PointForces *points, const Factors *factors, const Linear *l, int held,
                     const Changes *solution, Changes *x) {
  const Layout *at = &l->at;
  const int *order = factors->order;
  int first = solution ? p->free : 0, forces = points->all || points->members;
  long end = HAS(COUPLED) || held ? at->natural1 : at->q1;
  for (int i = 0; HAS(COUPLED) && i < first; ++i) x[at->Y1 + i] = -solution[order[i]];
  if (!held || forces || p->joints.count || p->loops.closures || p->sliders.count)
    memset(x + at->Y1 + first, 0, (end - at->Y1 - first) * sizeof(Changes));
  memset(x + at->natural1, 0, (at->internal1 - at->natural1) * sizeof(Changes));
  if (held) jvp(l->of + STRAINED, x), jvp(l->of + WEIGHED, x);
  for (int i = STRAINED; !held && i <= PLACED; ++i)
    if ((i != ARMS || l->moves_joints) && (i != EQUAL || HAS(COUPLED))) jvp(l->of + i, x);
  for (int i = 0; !HAS(COUPLED) && !held && i < p->dofs; ++i) {
    int column = p->map.column[i];
    x[at->q1 + i] = column < first ? -solution[order[column]] : x[at->Y1 + column];
  }
}

/* The changes of forces for that of the configuration at the end. */
static void jvp_forces(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, const Linear *l,
                       int changes_mass, int held, Changes *x) {
  const Layout *at = &l->at;
  int first = HAS(COUPLED) ? at->R : at->closures; /* others set the rows first, which were used as room */
  memset(x + at->springs1, 0, (at->held + 3 * p->sliders.count - at->springs1) * sizeof(Changes));
  jvp_inertia(p, s, w, at, changes_mass, held, x);
  jvp_elements(&p->mesh, a, l, held, x);
  memset(x + first, 0, (at->size - first) * sizeof(Changes));
  for (int i = TOUCHED; i <= SLID; ++i) jvp(l->of + i, x);
  if (l->moves_joints) jvp(l->of + LEVERS, x);
  jvp(l->of + CARRIED, x);
}

/* The changes of rows for those of forces. */
static void jvp_rows(const Linear *l, Changes *x) {
  if (!HAS(COUPLED)) memset(x + l->at.R, 0, (l->at.closures - l->at.R) * sizeof(Changes));
  for (int i = COLLECTED; i <= MAPPED; ++i) jvp(l->of + i, x);
}

/* The changes of closing forces, and of what they leave of rows. */
static void jvp_closing(const Loops *loops, const Work *w, const Linear *l, Changes *x) {
  const Layout *at = &l->at;
  for (int i = 0; i < loops->closures; ++i) x[at->closing + i] = x[at->R + loops->column[w->following[i]]];
  if (loops->closures) solve_closures(loops, w, GROUP_SIZE, 1, (double *)(x + at->closing));
  jvp(l->of + CLOSED, x);
}

/* Sets the changes of the forces that friction follows; returns whether they are others. */
static int change_followed(const Derivatives *a, Linear *l, Changes *x) {
  Changes *next = (Changes *)l->next, *followed = (Changes *)l->followed;
  int n = l->following.size / GROUP_SIZE;
  for (int i = 0; i < n; ++i) next[i] = x[a->followed[i]], followed[i] = x[l->at.followed + i];
  int changed = next_trial(&l->following, l->followed, 0, l->next);
  for (int i = 0; i < n; ++i) x[a->followed[i]] = next[i];
  return changed;
}

/* The changes of the forces on unknowns where both ends of a sub-step change by the columns at its start. */
static void jvp_equations(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, const Linear *l,
                          int changes_mass, Changes *x) {
  for (int i = 0; i < p->free; ++i) l->block[w->factors.order[i]] = -x[l->at.Y + i];
  set_ends(p, s->points, &w->factors, l, 0, l->block, x);
  jvp_forces(p, s, w, a, l, changes_mass, 0, x), jvp_rows(l, x), jvp_closing(&p->loops, w, l, x);
}

/* The changes of the state at the end, from the solution. */
static void change_state(const Tables *p, const Work *w, const Derivatives *a, const Linear *l, Changes *x) {
  const Layout *at = &l->at;
  double per_dt = rates_per_path(&p->scheme, w->dt);
  Changes *q = x + at->q, *v = x + at->v, *end = x + at->q1;
  memcpy(x + at->internal1, x + at->internal, (at->spring_internal - at->internal) * sizeof(Changes));
  if (p->internal.per_cell) jvp_cells(&a->internal_forces, l->slopes[0], p->internal.per_cell, 1, 0, x);
  for (int k = 0; k < p->mesh.massless_count; ++k) { /* half of their rates */
    int i = p->mesh.massless[k];
    v[i] = per_dt / 2 * w->slope[i] * (end[i] - q[i]);
  }
  if (a->internal_forces.q_previous) memcpy(x + at->q_previous, q, p->dofs * sizeof(Changes));
  for (int i = 0; i < p->dofs; ++i) v[i] = per_dt * w->slope[i] * (end[i] - q[i]) - v[i], q[i] = end[i];
  if (p->passes.joints) memcpy(x + at->Y, x + at->Y1, (p->columns + p->auxiliary.count) * sizeof(Changes));
  memcpy(x + at->natural, x + at->natural1, (at->loads - at->natural) * sizeof(Changes));
}

/* A group of directions through a sub-step, which is repeated for the forces that friction follows. */
static void jvp_group(const Tables *p, const Numbers *s, const Work *w, const Derivatives *a, Linear *l, int changes_mass,
                      int forces, Changes *x) {
  const Layout *at = &l->at;
  forces |= p->at_points.friction_follows;
  begin_fixed_point(&l->following, 0);
  for (int i = 0; i <= MOST_TRIALS; ++i) {
    /* Whether the unknowns that are held, and nothing else, give the configuration at the end. */
    int held = !l->moves_joints && largest(p->driven * GROUP_SIZE, (const double *)(x + at->driven), 0) == 0;
    set_ends(p, s->points, &w->factors, l, held, 0, x);
    jvp_forces(p, s, w, a, l, changes_mass, held, x);
    if (HAS(COUPLED)) jvp_rows(l, x);
    set_right_sides(p, &w->factors, at, x, l->block);
    solve_right_sides(p, s->points, w, l);
    set_ends(p, s->points, &w->factors, l, 0, l->block, x);
    if (forces) jvp_forces(p, s, w, a, l, changes_mass, 0, x), jvp_rows(l, x), jvp_closing(&p->loops, w, l, x), jvp(l->of + JOINED, x);
    if (!p->at_points.friction_follows || !change_followed(a, l, x)) break;
  }
  if (!forces && p->at_points.spring_width) {
    memset(x + at->springs1, 0, p->at_points.spring_width * sizeof(Changes));
    jvp(l->of + TOUCHED, x), jvp(l->of + FORCED, x);
  }
  change_state(p, w, a, l, x);
}

/* Whether load steps are in the same row, in which the Jacobians of their forces may be added up, since the motions of nodes
   do not depend on the state. Their shares are those of a difference, with the sum zero. */
static int are_added(const Tables *p, const Frame *frame, const Derivatives *a, long k, long next, long end) {
  if (!a->unknown_slopes || !has_constant_map(p) || frame->spin_squared) return 0;
  return next >= 0 && next < end && a->forces.at[k] == a->forces.at[next];
}

/* Follows a tape with changes in several directions; returns the number of sub-steps that are left where a
   tangent is singular. */
KEPT long fx_jvp(Problem *problem, const Tape *tape, const Derivatives *a) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  Linear l;
  begin_linear(p, s->points, w, a, &l);
  const Layout *at = &l.at;
  long groups = (a->directions + GROUP_SIZE - 1) / GROUP_SIZE, steps = at->Y1 - at->loads, left = tape->rows, state_numbers = at->v - at->Y;
  l.following.size = GROUP_SIZE * s->points->followed.size, l.moves_joints = 0;
  w->slopes_only = p->internal.per_cell || a->unknown_slopes;
  for (long i = 0; i < groups; ++i) {
    const Changes *x = (Changes *)a->x + i * at->size;
    l.moves_joints |= largest((at->members - at->offset) * GROUP_SIZE, (double *)(x + at->offset), 0) != 0;
  }
  for (; left; --left) {
    long row = tape->rows - left, k = tape->first + row;
    int forces = !a->unknown_slopes && a->forces.at[k] >= 0, more = are_added(p, &s->frame, a, k, k + 1, tape->all);
    l.step = k, l.adds = are_added(p, &s->frame, a, k, k - 1, tape->all), l.share = l.adds || more ? a->share[k] : 0;
    if (!begin_linearised(p, s, w, a, &l, tape->row + row * tape->size, forces, !k, 1)) break;
    if (!a->unknown_slopes && !factorise_for_directions(p, s->points, w)) break;
    for (long i = 0; i < groups; ++i) {
      Changes *x = (Changes *)a->x + i * at->size;
      int count = a->directions - i * GROUP_SIZE < GROUP_SIZE ? a->directions - i * GROUP_SIZE : GROUP_SIZE;
      if (tape->apart && !a->unknown_slopes) memset(x + at->Y, 0, state_numbers * sizeof(Changes));
      if (k == 0) {
        memset(x + at->arms, 0, (at->natural1 - at->arms) * sizeof(Changes));
        memset(x + at->q, 0, p->dofs * sizeof(Changes)), jvp(l.of + BEGUN, x);
      }
      if (more) continue;
      if (row == 0) add_changes(a, &a->states, k, !a->unknown_slopes, x, i * GROUP_SIZE, count);
      memcpy(x + at->loads, (Changes *)a->step_slopes + (i * tape->all + k) * steps, steps * sizeof(Changes));
      double share = l.share ? 1 : share_of(a, k);
      if (a->unknown_slopes) jvp_equations(p, s, w, a, &l, a->changes_mass[i] && !l.share, x);
      else jvp_group(p, s, w, a, &l, a->changes_mass[i], forces, x);
      add_changes(a, &a->forces, k, share, x, i * GROUP_SIZE, count), add_changes(a, &a->states, k + 1, share, x, i * GROUP_SIZE, count);
    }
  }
  return end_linear(&w->factors, &l, left);
}
