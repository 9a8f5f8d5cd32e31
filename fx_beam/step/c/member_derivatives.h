/* Derivatives of contact with members: of each contact point those of its forces and internal variables, by a law that also
   follows the nearest point at the start (laws/gaps.py). */

#pragma once

#include "blocks.h"
#include "newton.h"
#include "reversals.h"

/* Numbers by which the law of a contact point is derived (fem/compiled_laws.py): start, increments, internal variables, what is of
   places, and numbers. */
enum { MOST_FOLLOWED = 60 };
static inline int followed_by(const MemberContact *c) {
  return 2 * c->coordinates + c->internal + numbers_at(c) - places_at(c) + c->numbers;
}

/* A force on an entry of a contact point, or an internal variable, by all that its law is given, with the place of its own
   variables or -1; sets the row of the tangent. */
static void put_contact_point_row(Block *b, const MemberContact *c, const ContactPoint *e, const Layout *at, const double *by, int variables,
                          int to, double *tangent) {
  int n = c->coordinates;
  const double *number_slopes = by + followed_by(c) - c->numbers;
  for (int j = 0; j < c->dofs; ++j) {
    double start_slope = j < POSITIONS ? by_entry(e, by, j) : 0;
    double change_slope = by_entry(e, by + n, j) * (j < POSITIONS ? 1 : e->slopes[j - POSITIONS]);
    put(b, at->q + e->dof[j], to, start_slope - change_slope), put(b, at->q1 + e->dof[j], to, change_slope);
    put(b, at->member_places + e->dof[j], to, start_slope);
    if (tangent) tangent[j] = change_slope;
  }
  for (int i = 0; variables >= 0 && i < c->internal; ++i) put(b, at->spring_internal + variables + i, to, by[2 * n + i]);
  for (int i = 0; i < c->numbers; ++i)
    put(b, at->members + c->first_number + e->point * c->numbers + i, to, number_slopes[i]);
}

/* The forces of all contact points, and their internal variables; sets their tangents. */
static void put_members(Block *b, const PointForces *points, const Derivatives *a, const Layout *at, long step) {
  MemberContacts *m = points->members;
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    int n = c->coordinates, wide = followed_by(c), variables = e->slot < 0 ? -1 : stretch_in_slot(m, e->slot);
    double slopes[(COORDINATES + SLOT_WIDTH) * MOST_FOLLOWED];
    if (!e->closed) continue;
    call(c->slopes, e->given, slopes, (n + c->internal) * wide);
    const Reversal *reversal = variables < 0 ? 0 : reversal_at(a, step, variables);
    if (reversal) reverse(reversal, n, wide, wide - 2, 0, slopes);
    for (int i = 0; i < c->dofs; ++i) {
      double by[MOST_FOLLOWED] = {0}, force_slopes[COORDINATES] = {0};
      for (int j = 0; j < wide; ++j) {
        for (int k = 0; k < n; ++k) force_slopes[k] = slopes[k * wide + j];
        by[j] = by_entry(e, force_slopes, i);
      }
      put_contact_point_row(b, c, e, at, by, variables, at->r + e->dof[i], e->tangent + i * ENTRIES);
    }
    for (int i = 0; variables >= 0 && i < c->internal; ++i)
      put_contact_point_row(b, c, e, at, slopes + (n + i) * wide, variables, at->springs1 + variables + i, 0);
  }
}

/* Begins a sub-step whose increment is known with all contact points in it. */
static void settle_members(const Tables *p, const PointForces *points, Work *w) {
  MemberContacts *m = points->members;
  for (int k = 0; k < SEARCHES_IN_STEP && fx_check_members(m, w->D) == MEMBERS_MOVED; ++k)
    begin_points(p, points, w);
  change_rows(&p->system, points, &w->factors);
}
