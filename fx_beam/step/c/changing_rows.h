/* Sparse rows whose pattern changes with the points that touch members: an order of minimum degree, and the
   fill-in, found anew when there are others. */

#pragma once

#include <stdlib.h>
#include "algebra.h"
#include "point_forces.h"
#include "sparse_lu.h"

OF_STEPS void fx_free_rows(ChangingRows *c) {
  for (int g = 0; c->near_to && g < c->groups; ++g) free(c->near_to[g].of);
  SparseRows *r = &c->rows;
  free(r->start), free(r->diagonal), free(r->first), free(r->source_start), free(r->source);
  free(r->run_start), free(r->run_column), free(r->run_length);
  free(c->near_to), free(c->order), free(c->at), free(c->factors), free(c->work), free(c->entry), free(c->entry_at), free(c->entry_start);
  free(c->position), free(c->bordering_entry);
}

static void add_to(IntList *list, int value) {
  if (list->count == list->room) list->of = realloc(list->of, (list->room = 2 * list->room + 8) * sizeof(int));
  list->of[list->count++] = value;
}

static void add_once(IntList *list, int value) {
  for (int i = 0; i < list->count; ++i)
    if (list->of[i] == value) return;
  add_to(list, value);
}

/* Steps within which a contact point that closes may do so with the same pattern. */
static const double SOON = 4;

/* Chooses the contact points that the pattern has: those with a force, and those that may soon have one. */
static void count_contact_points(MemberContacts *m) {
  for (ContactPoint *e = m->contact_point; e < m->contact_point + m->contact_points; ++e) {
    const MemberContact *c = m->of + e->contact;
    double rates[4][2], fastest = 0, dt = fabs(e->given[3 * c->sums + 1]);
    differences(e, m->v, rates);
    for (int k = 0; k < 4; ++k) fastest = fmax(fastest, dot2(rates[k], rates[k]));
    e->counted = e->closed || e->first.distance - *number_of(c, e->point) < SOON * dt * sqrt(fastest);
  }
}

/* The unknowns on which contact points act: for each of their entries those of its degree of freedom. */
static void find_entries(const Problem *p, ChangingRows *c) {
  const MemberContacts *m = p->points->members;
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
  }
  c->entry_start[m->contact_points] = c->entries;
}

/* The graph of groups: that of the scene, and all pairs of each touch. */
static void make_graph(const ChangingRows *c, int contact_points) {
  IntList of = {0};
  for (int g = 0; g < c->groups; ++g) {
    c->near_to[g].count = 0;
    for (int k = c->graph_start[g]; k < c->graph_start[g + 1]; ++k) add_to(c->near_to + g, c->graph[k]);
  }
  for (int i = 0; i < contact_points; ++i) {
    of.count = 0;
    for (int a = c->entry_start[i]; a < c->entry_start[i + 1]; ++a) {
      const ContactPointEntry *e = c->entry + a;
      if (e->row >= 0) add_once(&of, c->group_of[e->row]);
      if (e->column >= 0) add_once(&of, c->group_of[e->column]);
    }
    for (int a = 0; a < of.count; ++a)
      for (int b = 0; b < a; ++b)
        add_once(c->near_to + of.of[a], of.of[b]), add_once(c->near_to + of.of[b], of.of[a]);
  }
  free(of.of);
}

/* Groups in lists by their degree, but those that still wait for so many others. */
typedef struct {
  int *head, *tail, *next, *before, *mark, *waits;
} Degrees;

static void take_out(Degrees *d, int g, int degree) {
  if (d->waits[g]) return;
  if (d->before[g] >= 0) d->next[d->before[g]] = d->next[g]; else d->head[degree] = d->next[g];
  if (d->next[g] >= 0) d->before[d->next[g]] = d->before[g]; else d->tail[degree] = d->before[g];
}

/* Behind those of the same degree, so that several chains are eliminated in turns: the processor overlaps them. */
static void put_in(Degrees *d, int g, int degree) {
  if (d->waits[g]) return;
  int last = d->tail[degree];
  d->before[g] = last, d->next[g] = -1, d->tail[degree] = g;
  if (last >= 0) d->next[last] = g; else d->head[degree] = g;
}

/* Eliminates the groups in an order of minimum degree; auxiliary unknowns come from the leaves of trees to the roots, and forces
   after what they act on (lu_layout.py). What each is coupled with then remains in its list; its position is in
   `position`. */
static void eliminate_groups(const ChangingRows *c) {
  int n = c->groups, least = 0, *room = c->work;
  Degrees d = {room, room + n, room + 2 * n, room + 3 * n, room + 4 * n, room + 5 * n};
  memcpy(d.waits, c->waits, n * sizeof(int));
  for (int g = 0; g < n; ++g) d.head[g] = d.tail[g] = d.mark[g] = -1;
  for (int g = 0; g < n; ++g) put_in(&d, g, c->near_to[g].count);
  for (int k = 0, stamp = 0; k < n; ++k) {
    while (d.head[least] < 0) ++least;
    int g = d.head[least];
    IntList *own = c->near_to + g;
    take_out(&d, g, least);
    c->position[g] = k;
    for (int i = 0; i < own->count; ++i) {
      int h = own->of[i], kept = 0;
      ++stamp;
      IntList *other = c->near_to + h;
      take_out(&d, h, other->count);
      for (int j = 0; j < other->count; ++j) {
        int f = other->of[j];
        if (f != g) other->of[kept++] = f, d.mark[f] = stamp;
      }
      other->count = kept;
      for (int j = 0; j < own->count; ++j)
        if (own->of[j] != h && d.mark[own->of[j]] != stamp) add_to(other, own->of[j]);
      put_in(&d, h, other->count);
      if (other->count < least) least = other->count;
    }
    for (int i = c->waiting_start[g]; i < c->waiting_start[g + 1]; ++i) {
      int h = c->waiting[i], degree = c->near_to[h].count;
      if (--d.waits[h]) continue;
      put_in(&d, h, degree);
      if (degree < least) least = degree;
    }
  }
}

static int by_value(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

/* Position among the factors of a row and a column of the elimination, in groups at these positions. */
static long place_in(const ChangingRows *c, int group, int column_group, int row, int column) {
  const SparseRows *r = &c->rows;
  long offset = r->start[row];
  if (column_group < group) {
    for (int s = r->source_start[group]; r->source[s] != column_group; ++s)
      offset += r->first[r->source[s] + 1] - r->first[r->source[s]];
    return offset + column - r->first[column_group];
  }
  if (column_group == group) return r->diagonal[row] + column - row;
  offset = r->diagonal[row] + r->first[group + 1] - row;
  for (int k = r->run_start[group];; offset += r->run_length[k++])
    if (column < r->run_column[k] + r->run_length[k]) return offset + column - r->run_column[k];
}

#define ROOM(array, count) array = realloc(array, ((count) + 1) * sizeof *(array))

/* Rows of the factors, from the groups in their order. */
static void lay_out_rows(ChangingRows *c) {
  int n = c->groups, *position = c->position, *size = c->work, *group_at = c->work + n;
  SparseRows *r = &c->rows;
  ROOM(r->first, n), ROOM(r->source_start, n), ROOM(r->run_start, n);
  for (int g = 0; g < n; ++g) size[position[g]] = c->first_unknown[g + 1] - c->first_unknown[g], group_at[position[g]] = g;
  r->first[0] = 0;
  for (int k = 0; k < n; ++k) r->first[k + 1] = r->first[k] + size[k];
  long couplings = 0;
  for (int k = 0; k <= n; ++k) r->source_start[k] = 0;
  for (int k = 0; k < n; ++k) {
    IntList *list = c->near_to + group_at[k];
    for (int i = 0; i < list->count; ++i) list->of[i] = position[list->of[i]], ++r->source_start[list->of[i] + 1];
    qsort(list->of, list->count, sizeof(int), by_value);
    couplings += list->count;
  }
  ROOM(r->source, couplings), ROOM(r->run_column, couplings), ROOM(r->run_length, couplings);
  for (int k = 0; k < n; ++k) r->source_start[k + 1] += r->source_start[k];
  int runs = 0, *filled = c->work + 2 * n;
  memset(filled, 0, n * sizeof(int));
  for (int k = 0; k < n; ++k) {
    IntList *list = c->near_to + group_at[k];
    r->run_start[k] = runs;
    for (int i = 0; i < list->count; ++i) {
      int to = list->of[i];
      r->source[r->source_start[to] + filled[to]++] = k;
      if (i && to == list->of[i - 1] + 1)
        r->run_length[runs - 1] += size[to];
      else
        r->run_column[runs] = r->first[to], r->run_length[runs++] = size[to];
    }
  }
  r->run_start[n] = runs, r->groups = n;
  ROOM(r->start, r->unknowns), ROOM(r->diagonal, r->unknowns), ROOM(c->order, r->unknowns);
  long at = 0;
  for (int k = 0; k < n; ++k) {
    int lower = 0, upper = 0, g = group_at[k];
    for (int s = r->source_start[k]; s < r->source_start[k + 1]; ++s) lower += size[r->source[s]];
    for (int s = r->run_start[k]; s < r->run_start[k + 1]; ++s) upper += r->run_length[s];
    for (int i = 0; i < size[k]; ++i) {
      int row = r->first[k] + i;
      r->start[row] = at, r->diagonal[row] = at + lower + i;
      at += lower + size[k] + upper;
      c->order[c->unknown[c->first_unknown[g] + i]] = row;
    }
  }
  r->start[r->unknowns] = at;
}

/* Substitutions that cost as much as a factorisation (lu_layout.py). */
static int worth_of(const Problem *p, const ChangingRows *c) {
  const SparseRows *r = &c->rows;
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

/* The same of an unknown's row and a column; -1 if one of them is a bordering row. */
static int place_of_pair(const ChangingRows *c, int i, int j) {
  if (i < 0 || j < 0) return -1;
  return place_in(c, c->position[c->group_of[i]], c->position[c->group_of[j]], c->order[i], c->order[j]);
}

/* Position in the elimination of an unknown, or its bordering row. */
static int place_now(const ChangingRows *c, int of) { return of < 0 ? of : c->order[of]; }

/* Places of all columns in a new order, and room for the entries of contact points in the bordering rows. */
static void place_bordering_rows(Problem *p, int contact_points) {
  ChangingRows *c = p->changing;
  long most = p->most_bordering_entries;
  for (int k = 0; k < p->columns + p->auxiliaries; ++k)
    p->row_at[k] = place_now(c, c->row_of[k]), p->unknown_at[k] = place_now(c, c->unknown_of[k]);
  for (int t = 0; t < contact_points; ++t) {
    long rows = 0;
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a) rows += c->entry[a].row < 0;
    most += rows * (c->entry_start[t + 1] - c->entry_start[t]);
  }
  ROOM(c->bordering_entry, most);
}

/* Places among the factors of the entries of the tangent or of its transpose, and of those of contact points. */
static void place_entries(const Problem *p, ChangingRows *c, int transposed) {
  const MemberContacts *m = p->points->members;
  int *to = c->entry_at;
  for (int i = 0; i < p->unknowns; ++i)
    for (int k = p->tangent_start[i]; k < p->tangent_start[i + 1]; ++k) {
      int j = p->tangent_column[k];
      c->at[k] = transposed ? place_of_pair(c, j, i) : place_of_pair(c, i, j);
    }
  for (int t = 0; t < m->contact_points; ++t)
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a)
      for (int b = c->entry_start[t]; b < c->entry_start[t + 1]; ++b) {
        int i = c->entry[a].row, j = c->entry[b].column;
        *to++ = transposed ? place_of_pair(c, j, i) : place_of_pair(c, i, j);
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
  int n = c->groups;
  ROOM(c->work, 6L * n), ROOM(c->position, n), ROOM(c->entry_start, m->contact_points);
  if (!c->near_to) c->near_to = calloc(n, sizeof(IntList));
  find_entries(p, c);
  make_graph(c, m->contact_points);
  long pairs = 0;
  for (int i = 0; i < m->contact_points; ++i) {
    long many = c->entry_start[i + 1] - c->entry_start[i];
    pairs += many * many;
  }
  ROOM(c->entry_at, pairs), ROOM(c->at, p->tangent_start[p->unknowns]);
  c->rows.unknowns = p->unknowns;
  eliminate_groups(c);
  lay_out_rows(c);
  ROOM(c->factors, c->rows.start[p->unknowns]);
  if (HAS(SLIDERS) && p->bordering_rows) place_bordering_rows(p, m->contact_points);
  p->kept.present = 0;
  if (c->keep) p->kept.worth = worth_of(p, c);
}

/* Adds the tangents of all contact points to the factors, with the places of their entries. */
static void add_contact_points(const Problem *p, const Work *w) {
  const ChangingRows *c = p->changing;
  const int *to = c->entry_at;
  const MemberContacts *m = p->points->members;
  for (int t = 0; t < m->contact_points; ++t) {
    const ContactPoint *e = m->contact_point + t;
    int first = c->entry_start[t], end = c->entry_start[t + 1];
    if (e->closed)
      for (int a = first; a < end; ++a) {
        const ContactPointEntry *row = c->entry + a;
        double factor = row->sign * w->virtual_map[row->value];
        const double *K = e->tangent + row->of * CONTACT_POINT_DOFS;
        for (int b = first; b < end; ++b) {
          const ContactPointEntry *column = c->entry + b;
          int at = to[(long)(a - first) * (end - first) + b - first];
          if (at >= 0) c->factors[at] += factor * K[column->of] * column->sign * w->values[column->value];
        }
      }
    to += (long)(end - first) * (end - first);
  }
}

/* Adds the product of their tangents and a vector of unknowns. */
static void times_contact_points(const Problem *p, const Work *w, const double *x, double *out) {
  const ChangingRows *c = p->changing;
  const MemberContacts *m = p->points->members;
  for (int t = 0; t < m->contact_points; ++t) {
    const ContactPoint *e = m->contact_point + t;
    if (!e->closed) continue;
    double along[CONTACT_POINT_DOFS] = {0}, force[CONTACT_POINT_DOFS] = {0};
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a) {
      const ContactPointEntry *column = c->entry + a;
      along[column->of] += column->sign * w->values[column->value] * x[column->column];
    }
    for (int i = 0; i < CONTACT_POINT_DOFS; ++i)
      for (int j = 0; j < CONTACT_POINT_DOFS; ++j) force[i] += e->tangent[i * CONTACT_POINT_DOFS + j] * along[j];
    for (int a = c->entry_start[t]; a < c->entry_start[t + 1]; ++a) {
      const ContactPointEntry *row = c->entry + a;
      out[row->column] += row->sign * w->virtual_map[row->value] * force[row->of];
    }
  }
}

static void fill_changing(const Problem *p, const Work *w) {
  ChangingRows *c = p->changing;
  if (c->placed != w->transposed) place_entries(p, c, w->transposed);
  memset(c->factors, 0, c->rows.start[p->unknowns] * sizeof(double));
  for (int k = 0; k < p->tangent_start[p->unknowns]; ++k) c->factors[c->at[k]] = w->tangent[k];
  add_contact_points(p, w);
}

/* Factors of the tangent, or of its transpose, with that of the contact points. */
static int factorise_changing(const Problem *p, const Work *w) {
  fill_changing(p, w);
  return factorise_sparse(&p->changing->rows, p->changing->factors, w->row);
}
