/* Sparse rows whose pattern changes with the points in contact with members: an order of minimum degree, and the
   fill-in, found anew when there are others. */

#pragma once

#include "algebra.h"
#include "elimination.h"
#include "point_forces.h"
#include "sparse_lu.h"

OF_STEPS void fx_free_rows(ChangingRows *c) {
  fx_free_elimination(&c->elimination);
  free(c->entry), free(c->entry_at), free(c->entry_start);
}

/* Steps within which a contact point that closes may do so with the same pattern. */
static const double SOON = 4;

/* Chooses the contact points that the pattern has: those with a force, and those that may soon have one. */
static void count_contact_points(MemberContacts *m) {
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    Two rates[4];
    double fastest = 0, dt = fabs(e->given[3 * c->sums + 1]);
    differences(e, m->v, rates);
    for (int k = 0; k < 4; ++k) fastest = fmax(fastest, dot2(rates[k], rates[k]));
    e->counted = e->closed || e->first.distance - *number_of(c, e->point) < SOON * dt * sqrt(fastest);
  }
}

/* The unknowns on which contact points act: for each of their entries those of its degree of freedom; returns the number of
   pairs of a contact point's entries. */
static long find_entries(const Problem *p, ChangingRows *c) {
  const MemberContacts *m = p->points->members;
  long pairs = 0;
  c->entries = 0;
  for (int i = 0; i < m->contact_points; ++i) {
    c->entry_start[i] = c->entries;
    for (int k = 0; m->contact_point[i].counted && k < CONTACT_POINT_DOFS; ++k)
      for (int e = c->dof_start[m->contact_point[i].dof[k]]; e < c->dof_start[m->contact_point[i].dof[k] + 1]; ++e) {
        int column = c->dof_column[e];
        if (c->unknown_of[column] == -1) continue;
        if (c->entries == c->entry_room)
          c->entry = realloc(c->entry, (c->entry_room = 2 * c->entry_room + 64) * sizeof(ContactPointEntry));
        c->entry[c->entries++] =
            (ContactPointEntry){k, c->row_of[column], c->unknown_of[column], c->dof_value[e], c->dof_sign[e]};
      }
    long many = c->entries - c->entry_start[i];
    pairs += many * many;
  }
  c->entry_start[m->contact_points] = c->entries;
  return pairs;
}

/* Adds all pairs of each contact point to the graph of groups. */
static void add_pairs(const ChangingRows *c, int contact_points) {
  const Elimination *g = &c->elimination;
  IntList of = {0};
  for (int i = 0; i < contact_points; ++i) {
    of.count = 0;
    for (int a = c->entry_start[i]; a < c->entry_start[i + 1]; ++a) {
      const ContactPointEntry *e = c->entry + a;
      if (e->row >= 0) add_once(&of, g->group_of[e->row]);
      if (e->column >= 0) add_once(&of, g->group_of[e->column]);
    }
    for (int a = 0; a < of.count; ++a)
      for (int b = 0; b < a; ++b)
        add_once(g->near_to + of.of[a], of.of[b]), add_once(g->near_to + of.of[b], of.of[a]);
  }
  free(of.of);
}

/* Substitutions that cost as much as a factorisation (lu_layout.py). */
static int worth_of(const Problem *p, const ChangingRows *c) {
  const SparseRows *r = &c->elimination.rows;
  double products = 0, size = r->start[r->unknowns];
  for (int i = 0; i < r->unknowns; ++i) {
    double above = r->start[i + 1] - r->diagonal[i] - 1;
    products += above * (above + 1);
  }
  int worth = (products + c->row_entry * size) / (c->substitution * (size + p->tangent_start[p->unknowns]));
  return worth >= c->least_worth ? worth : 0;
}

/* Whether the pattern has all contact points with a force. */
static int has_contact_points(const ChangingRows *c, const MemberContacts *m) {
  if (c->searches != m->searches) return 0;
  for (const ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e)
    if (e->closed && !e->counted) return 0;
  return 1;
}

/* Position in the elimination of an unknown, or its bordering row. */
static int place_of(const Problem *p, int of) { return of < 0 ? of : p->order[of]; }

/* Places of all columns in a new order. */
static void place_columns(Problem *p) {
  const ChangingRows *c = p->changing;
  for (int k = 0; k < p->columns + p->auxiliaries; ++k)
    p->row_at[k] = place_of(p, c->row_of[k]), p->unknown_at[k] = place_of(p, c->unknown_of[k]);
}

/* Places among the factors of the entries of the tangent or of its transpose, and of those of contact points. */
static void place_entries(const Problem *p, ChangingRows *c, int transposed) {
  const MemberContacts *m = p->points->members;
  int *to = c->entry_at;
  for (int i = 0; i < p->unknowns; ++i)
    for (int k = p->tangent_start[i]; k < p->tangent_start[i + 1]; ++k) {
      int j = p->tangent_column[k];
      p->factor_at[k] = transposed ? place_of_pair(&c->elimination, j, i) : place_of_pair(&c->elimination, i, j);
    }
  for (int t = 0; t < m->contact_points; ++t)
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a)
      for (int b = c->entry_start[t]; b < c->entry_start[t + 1]; ++b) {
        int i = c->entry[a].row, j = c->entry[b].column;
        *to++ = transposed ? place_of_pair(&c->elimination, j, i) : place_of_pair(&c->elimination, i, j);
      }
  c->placed = transposed;
}

/* Finds the pattern for the present contact points, if it lacks one. */
static void change_rows(Problem *p) {
  ChangingRows *c = p->changing;
  MemberContacts *m = p->points->members;
  if (has_contact_points(c, m)) return;
  c->searches = m->searches, c->placed = -1;
  count_contact_points(m);
  ROOM(c->entry_start, m->contact_points);
  long pairs = find_entries(p, c);
  ROOM(c->entry_at, pairs);
  begin_elimination(&c->elimination), add_pairs(c, m->contact_points);
  find_rows(&c->elimination);
  memcpy(p->order, c->elimination.order, p->unknowns * sizeof(int));
  ROOM(p->rows->factors, p->rows->start[p->unknowns]);
  if (HAS(SLIDERS) && p->bordering_rows) place_columns(p);
  p->reused.present = 0;
  if (c->keep) p->reused.worth = worth_of(p, c);
}
