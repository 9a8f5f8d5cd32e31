/* Derivatives of contact with members: of each touch that of its forces and internal variables, by a law that also
   follows the nearest point at the start (laws/member_gap.py). */

#pragma once

#include "blocks.h"
#include "newton.h"

/* Of a touch: weights of the sums at its five points, then the derivatives (fem/compiled_laws.py), of each force and
   internal variable by start, increments, internal variables and numbers. */
enum { FOLLOWED_SUMS = 6, OF_WEIGHTS = 5 * FOLLOWED_SUMS, MOST_FOLLOWED = 60, FOLLOWED_GIVEN = 64 };

static inline int found_by(const FollowedContact *f) { return 2 * f->sums + f->internal; }
static inline int followed_by(const FollowedContact *f) { return 4 * f->sums + f->internal + f->numbers; }

/* Internal variables of a touch among all, or -1. */
static inline int internal_of(const MemberContacts *m, const Touch *e) {
  return m->of[e->contact].internal && e->slot >= 0 ? m->first_internal + IN_SLOT * e->slot + 1 : -1;
}

static void bend_weights(double place, double bends[4]) {
  int k = place > 0.5;
  memset(bends, 0, 4 * sizeof(double));
  bends[k] = bends[k + 2] = 1, bends[k + 1] = -2;
}

/* Weights of all sums at the five points of a touch, and what its law is given, after `move_touch`. */
static void follow_touch(const MemberContacts *m, const Touch *e, const FollowedContact *f, const double *D,
                         double *w, double *given) {
  const MemberContact *c = m->of + e->contact;
  double change[4][2], end[4][2], sums[FOLLOWED_SUMS][4], slope[2];
  double (*start)[2] = (double(*)[2])e->start + 1;
  const double *known = e->given + 3 * c->sums, *numbers = known + 2 + c->internal + c->remembered + (c->internal ? 3 : 1);
  differences(e, D, change);
  for (int k = 0; k < 4; ++k)
    for (int i = 0; i < 2; ++i) end[k][i] = start[k][i] + change[k][i];
  NearPoint first = nearest_point(start, e->begins, e->ends), last = nearest_point(end, e->begins, e->ends);
  for (int k = 0; k < 4; ++k) {
    sums[0][k] = (first.weights[k] + last.weights[k]) / 2, sums[1][k] = last.weights[k] - first.weights[k];
    sums[2][k] = last.slopes[k], sums[3][k] = first.slopes[k];
  }
  bend_weights(first.place, sums[4]), bend_weights(last.place, sums[5]);
  memset(given, 0, FOLLOWED_GIVEN * sizeof(double));
  sums_of(f->sums, sums, start, given), sums_of(f->sums, sums, change, given + 2 * f->sums);
  for (int k = 0; k < f->sums; ++k) {
    fold(sums[k], e->begins, e->ends);
    w[k] = 0;
    for (int j = 0; j < 4; ++j) w[k] -= sums[k][j], w[(j + 1) * FOLLOWED_SUMS + k] = sums[k][j];
  }
  double *to = given + 6 * f->sums;
  memcpy(to, known, (2 + c->internal + c->remembered) * sizeof(double));
  to += 2 + c->internal + c->remembered;
  *to++ = last.per_rate, *to++ = first.per_rate;
  if (c->internal) {
    double before = arc_at(c, e->piece + first.place, slope), after = arc_at(c, e->piece + last.place, slope + 1);
    *to++ = after - before, *to++ = slope[1], *to++ = slope[0];
  }
  memcpy(to, numbers, c->numbers * sizeof(double));
}

/* The tangent of a touch from its derivatives. */
static void tangent_of_touch(const FollowedContact *f, Touch *e, const double *w, const double *slopes) {
  int n = f->sums, wide = followed_by(f);
  double half[2 * FOLLOWED_SUMS][TOUCH_DOFS];
  for (int i = 0; i < 2 * n; ++i)
    for (int j = 0; j < TOUCH_DOFS; ++j) {
      double sum = 0;
      for (int k = 0; k < n; ++k) sum += slopes[i * wide + 2 * n + 2 * k + j % 2] * w[j / 2 * FOLLOWED_SUMS + k];
      half[i][j] = sum;
    }
  for (int i = 0; i < TOUCH_DOFS; ++i)
    for (int j = 0; j < TOUCH_DOFS; ++j) {
      double sum = 0;
      for (int k = 0; k < n; ++k) sum += w[i / 2 * FOLLOWED_SUMS + k] * half[2 * k + i % 2][j];
      e->tangent[i * TOUCH_DOFS + j] = sum;
    }
}

/* Finds the derivatives of all touches with a force, one after the other, and their tangents from these. */
static void find_member_slopes(const Problem *p, const Work *w, const Adjoint *a) {
  MemberContacts *m = p->points->members;
  long most = 0, wide = 0;
  for (int k = 0; k < m->contacts; ++k) {
    long own = OF_WEIGHTS + (long)found_by(a->followed + k) * followed_by(a->followed + k);
    wide = own > wide ? own : wide;
  }
  most = wide * m->touches;
  if (most > m->slope_room) m->slopes = grown(m->slopes, m->slope_room = 2 * most, sizeof(double));
  double given[FOLLOWED_GIVEN], *to = m->slopes;
  for (Touch *e = m->touch; e < m->touch + m->touches; ++e) {
    const FollowedContact *f = a->followed + e->contact;
    if (!e->touching) continue;
    follow_touch(m, e, f, w->D, to, given);
    call(f->slopes, given, to + OF_WEIGHTS, found_by(f) * followed_by(f));
    tangent_of_touch(f, e, to, to + OF_WEIGHTS);
    to += OF_WEIGHTS + found_by(f) * followed_by(f);
  }
}

/* The nodes of the arcs between which a place lies, counted from the first of all contacts. */
static int arc_number(const MemberContact *c, const FollowedContact *f, double place) {
  int i = (int)place;
  return f->first_arc + (i < 0 ? 0 : i > c->nodes - 2 ? c->nodes - 2 : i);
}

/* Adds to derivatives by arcs, from those by the slip and by its slopes at the end and at the start. */
static void pull_arcs(const MemberContacts *m, const Touch *e, const FollowedContact *f, const double *by, double *arcs) {
  const MemberContact *c = m->of + e->contact;
  double places[] = {e->piece + e->end, e->piece + e->place};
  for (int k = 0; k < 2; ++k) {
    int i = arc_number(c, f, places[k]);
    double part = places[k] - (i - f->first_arc), sign = k ? -1 : 1;
    arcs[i] += sign * by[0] * (1 - part) - by[1 + k], arcs[i + 1] += sign * by[0] * part + by[1 + k];
  }
}

/* Adds the derivatives of the forces of all touches and of their internal variables. */
static void pull_members(const Problem *p, const Adjoint *a, const Layout *at, double *x) {
  const MemberContacts *m = p->points->members;
  const double *w = m->slopes;
  for (const Touch *e = m->touch; e < m->touch + m->touches; ++e) {
    const FollowedContact *f = a->followed + e->contact;
    int n = f->sums, wide = followed_by(f), own = internal_of(m, e);
    if (!e->touching) continue;
    double by[MOST_FOLLOWED] = {0};
    const double *slopes = w + OF_WEIGHTS;
    for (int i = 0; i < found_by(f); ++i, slopes += wide) {
      double weight = 0;
      if (i < 2 * n)
        for (int j = 0; j < 5; ++j) weight += w[j * FOLLOWED_SUMS + i / 2] * x[at->r + e->dof[2 * j + i % 2]];
      else if (own >= 0)
        weight = x[at->springs1 + own + i - 2 * n];
      for (int k = 0; k < wide; ++k) by[k] += weight * slopes[k];
    }
    for (int j = 0; j < TOUCH_DOFS; ++j)
      for (int k = 0; k < n; ++k) {
        double weight = w[j / 2 * FOLLOWED_SUMS + k];
        double by_start = weight * by[2 * k + j % 2], by_increment = weight * by[2 * n + 2 * k + j % 2];
        x[at->q + e->dof[j]] += by_start - by_increment, x[at->q1 + e->dof[j]] += by_increment;
        x[at->member_places + e->dof[j]] += by_start;
      }
    for (int i = 0; own >= 0 && i < f->internal; ++i) x[at->spring_internal + own + i] += by[4 * n + i];
    const double *numbers = by + 4 * n + f->internal, *of_law = numbers + f->numbers - m->of[e->contact].numbers;
    long first = f->first_number + (long)e->point * m->of[e->contact].numbers;
    for (int i = 0; i < m->of[e->contact].numbers; ++i) x[at->members + first + i] += of_law[i];
    if (f->internal) pull_arcs(m, e, f, numbers + 2, x + at->arcs);
    w = slopes;
  }
}

/* Adds the changes of their forces and internal variables. */
static void change_members(const Problem *p, const Adjoint *a, const Layout *at, Ways *all) {
  const MemberContacts *m = p->points->members;
  const Ways *place = all + at->member_places, *arcs = all + at->arcs, *q = all + at->q, *end = all + at->q1;
  const double *w = m->slopes;
  for (const Touch *e = m->touch; e < m->touch + m->touches; ++e) {
    const MemberContact *c = m->of + e->contact;
    const FollowedContact *f = a->followed + e->contact;
    int n = f->sums, wide = followed_by(f), own = internal_of(m, e);
    if (!e->touching) continue;
    Ways x[MOST_FOLLOWED] = {{0}}, *numbers = x + 4 * n + f->internal;
    const double *slopes = w + OF_WEIGHTS;
    for (int i = 0; i < TOUCH_DOFS; ++i)
      for (int k = 0; k < n; ++k) {
        double weight = w[i / 2 * FOLLOWED_SUMS + k];
        x[2 * k + i % 2] += weight * (q[e->dof[i]] + place[e->dof[i]]);
        x[2 * n + 2 * k + i % 2] += weight * (end[e->dof[i]] - q[e->dof[i]]);
      }
    for (int i = 0; own >= 0 && i < f->internal; ++i) x[4 * n + i] = all[at->spring_internal + own + i];
    memcpy(numbers + f->numbers - c->numbers, all + at->members + f->first_number + (long)e->point * c->numbers,
           c->numbers * sizeof(Ways));
    double places[] = {e->piece + e->end, e->piece + e->place};
    for (int k = 0; f->internal && k < 2; ++k) {
      int i = arc_number(c, f, places[k]);
      double part = places[k] - (i - f->first_arc);
      Ways change = arcs[i + 1] - arcs[i];
      numbers[3 + k] = change, numbers[2] += (k ? -1 : 1) * (arcs[i] + part * change);
    }
    for (int i = 0; i < found_by(f); ++i, slopes += wide) {
      Ways sum = sum_of_products(wide, slopes, x);
      if (i < 2 * n)
        for (int k = 0; k < 5; ++k) all[at->r + e->dof[2 * k + i % 2]] += w[k * FOLLOWED_SUMS + i / 2] * sum;
      else if (own >= 0)
        all[at->springs1 + own + i - 2 * n] = sum;
    }
    w = slopes;
  }
}

/* Begins a sub-step whose increment is known with all touches in it. */
static void settle_members(Problem *p, const Work *w) {
  MemberContacts *m = p->points->members;
  for (int k = 0; k < SEARCHES_IN_STEP && fx_check_members(m, w->D) == MEMBERS_MOVED; ++k)
    fx_begin_points(p->points, p->q, p->v, p->slides, p->slide_rate, p->t + p->level * w->dt, w->dt, p->spring_internal);
  change_rows(p);
}

/* Where the entries of the transposed tangent, and those of touches, are among the factors. */
static void find_transposed(const Problem *p) {
  ChangingRows *c = p->changing;
  const MemberContacts *m = p->points->members;
  long pairs = 0;
  if (c->transposed_for == c->found) return;
  c->transposed_for = c->found;
  ROOM(c->transposed_at, p->tangent_start[p->unknowns]);
  for (int i = 0; i < p->unknowns; ++i)
    for (int k = p->tangent_start[i]; k < p->tangent_start[i + 1]; ++k)
      c->transposed_at[k] = place_of_pair(c, p->tangent_column[k], i);
  for (int t = 0; t < m->touches; ++t) {
    long many = c->entry_start[t + 1] - c->entry_start[t];
    pairs += many * many;
  }
  ROOM(c->transposed_entry_at, pairs);
  int *to = c->transposed_entry_at;
  for (int t = 0; t < m->touches; ++t)
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a)
      for (int b = c->entry_start[t]; b < c->entry_start[t + 1]; ++b)
        *to++ = place_of_pair(c, c->entry[b].column, c->entry[a].row);
}

/* Factors of the transposed tangent, with that of the touches. */
static int factorise_changing_transposed(const Problem *p, const Work *w) {
  ChangingRows *c = p->changing;
  find_transposed(p);
  memset(c->factors, 0, c->rows.start[p->unknowns] * sizeof(double));
  for (int k = 0; k < p->tangent_start[p->unknowns]; ++k) c->factors[c->transposed_at[k]] = w->tangent[k];
  add_touches(p, w, c->transposed_entry_at);
  return factorise_sparse(&c->rows, c->factors, w->row);
}
