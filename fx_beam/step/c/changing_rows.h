/* Sparse rows whose pattern changes with the points in contact with members, or with what slides: an order of minimum degree, and
   the fill-in, found anew when there are others. */

#pragma once

#include "algebra.h"
#include "elimination.h"
#include "point_forces.h"
#include "sparse_lu.h"

OF_STEPS void fx_free_rows(ChangingRows *c) {
  fx_free_elimination(&c->elimination);
  free(c->pair);
}

/* Steps within which a contact point that closes may do so with the same pattern. */
static const double SOON = 4;

/* Chooses the contact points that the pattern has: those with a force, and those that may soon have one. */
static void count_contact_points(MemberContacts *m) {
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    Two rates[4];
    double fastest = 0, dt = fabs(e->given[3 * c->coordinates + 1]);
    differences(e, m->v, rates);
    for (int k = 0; k < 4; ++k) fastest = larger(dot2(rates[k], rates[k]), fastest);
    e->counted = e->closed || e->first.distance - *number_of(c, e->point) < SOON * dt * sqrt(fastest);
  }
}

/* Adds a pair, and if it is not on a bordering row its groups to the graph. */
static void add_pair(ChangingRows *c, ContactPair pair) {
  const Elimination *e = &c->elimination;
  if (pair.row == -1 || pair.column == -1) return;
  if (c->pairs == c->room) c->pair = realloc(c->pair, (c->room = 2 * c->room + 64) * sizeof(ContactPair));
  c->pair[c->pairs++] = pair;
  if (pair.row < 0 || pair.column < 0) return;
  int g = e->group_of[pair.row], h = e->group_of[pair.column];
  if (g != h) add_once(e->near_to + g, h), add_once(e->near_to + h, g);
}

/* The rows and unknowns on which contact points act. */
static void find_pairs(const System *system, ChangingRows *c, const MemberContacts *m) {
  c->pairs = 0;
  for (int t = 0; t < m->contact_points; ++t)
    for (int i = 0, n = m->of[m->contact_point[t].contact].dofs; m->contact_point[t].counted && i < n * n; ++i) {
      const int *dof = m->contact_point[t].dof, a = dof[i / n], b = dof[i % n];
      for (int e = c->dof_start[a]; e < c->dof_start[a + 1]; ++e)
        for (int f = c->dof_start[b]; f < c->dof_start[b + 1]; ++f)
          add_pair(c, (ContactPair){i / n * ENTRIES + i % n, c->dof_sign[e] * c->dof_sign[f], t, system->row_of[c->dof_column[e]],
                                    system->unknown_of[c->dof_column[f]], c->dof_value[e], c->dof_value[f], -1});
    }
}

/* Substitutions that cost as much as a factorisation (sparse_lu.py). */
static int worth_of(const System *system, const ChangingRows *c) {
  const SparseRows *r = &c->elimination.rows;
  double products = 0, size = r->start[r->unknowns];
  for (int i = 0; i < r->unknowns; ++i) {
    double above = r->start[i + 1] - r->diagonal[i] - 1;
    products += above * (above + 1);
  }
  int worth = (products + c->row_entry * size) / (c->substitution * (size + system->tangent_start[system->unknowns]));
  return worth >= c->least_worth ? worth : 0;
}

/* Whether the pattern has all contact points with a force. */
static int has_contact_points(const ChangingRows *c, const MemberContacts *m) {
  if (c->searches != m->searches) return 0;
  for (const ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e)
    if (e->closed && !e->counted) return 0;
  return 1;
}

/* Places among the factors of the entries of the tangent or of its transpose, and of those of contact points. */
static void place_entries(const System *system, const Factors *factors, ChangingRows *c, int transposed) {
  for (int i = 0; i < system->unknowns; ++i)
    for (int k = system->tangent_start[i]; k < system->tangent_start[i + 1]; ++k) {
      int j = system->tangent_column[k];
      factors->at[k] = place_of_pair(&c->elimination, transposed ? j : i, transposed ? i : j);
    }
  for (ContactPair *e = c->pair; e < c->pair + c->pairs; ++e)
    e->at = place_of_pair(&c->elimination, transposed ? e->column : e->row, transposed ? e->row : e->column);
  c->placed = transposed;
}

/* The rows for the graph with all pairs. */
static void settle_rows(const Factors *factors, ChangingRows *c) {
  find_rows(&c->elimination);
  memcpy(factors->order, c->elimination.order, factors->rows->unknowns * sizeof(int));
  ROOM(factors->rows->factors, factors->rows->start[factors->rows->unknowns]);
  c->placed = -1;
}

/* Finds the pattern for the present contact points, if it lacks one. */
static void change_rows(const System *system, const PointForces *points, Factors *factors) {
  ChangingRows *c = factors->changing;
  MemberContacts *m = points->members;
  if (has_contact_points(c, m)) return;
  c->searches = m->searches;
  count_contact_points(m);
  begin_elimination(&c->elimination), find_pairs(system, c, m);
  settle_rows(factors, c);
  factors->reused.present = 0;
  if (c->keep) factors->reused.worth = worth_of(system, c);
}
