/* An order of elimination of minimum degree, and the rows of the factors with their fill-in (sparse_lu.py). */

#pragma once

#include "sparse_rows.h"
#include "vectors.h"

static void add_to(IntList *list, int value) {
  if (list->count == list->room) list->of = realloc(list->of, (list->room = 2 * list->room + 8) * sizeof(int));
  list->of[list->count++] = value;
}

/* Adds a value that a list lacks; values that were added last are asked for most often. */
static void add_once(IntList *list, int value) {
  for (int i = list->count - 1; i >= 0; --i)
    if (list->of[i] == value) return;
  add_to(list, value);
}

void fx_free_elimination(Elimination *e) {
  SparseRows *r = &e->rows;
  for (int g = 0; e->near_to && g < e->groups; ++g) free(e->near_to[g].of);
  free(e->near_to), free(e->order), free(e->work), free(e->position);
  free(r->start), free(r->diagonal), free(r->first), free(r->source_start), free(r->source);
  free(r->run_start), free(r->run_column), free(r->run_length), free(r->factors), free(r->part_start);
}

/* The lists of a scene's graph, to which others may be added. */
static void begin_elimination(Elimination *e) {
  int n = e->groups;
  ROOM(e->work, 5L * n + 2 * (e->first_unknown[n] + 1)), ROOM(e->position, n);
  if (!e->near_to) e->near_to = calloc(n + 1, sizeof(IntList));
  for (int g = 0; g < n; ++g) {
    e->near_to[g].count = 0;
    for (int k = e->graph_start[g]; k < e->graph_start[g + 1]; ++k) add_to(e->near_to + g, e->graph[k]);
  }
}

/* Groups in lists by their degree, the unknowns with which they are coupled, but those that still wait for so many others. */
typedef struct { int *head, *tail, *next, *previous, *mark, *waits, *degree; } Degrees;

static void take_out(Degrees *d, int g) {
  if (d->waits[g]) return;
  if (d->previous[g] >= 0) d->next[d->previous[g]] = d->next[g]; else d->head[d->degree[g]] = d->next[g];
  if (d->next[g] >= 0) d->previous[d->next[g]] = d->previous[g]; else d->tail[d->degree[g]] = d->previous[g];
}

/* Behind those of the same degree, so that several chains are eliminated in turns: the processor overlaps them. Returns the
   least degree, which was another one before. */
static int put_in(const Elimination *e, Degrees *d, int g, int least) {
  const IntList *list = e->near_to + g;
  if (d->waits[g]) return least;
  int degree = 0;
  for (int i = 0; i < list->count; ++i) degree += e->first_unknown[list->of[i] + 1] - e->first_unknown[list->of[i]];
  int last = d->tail[degree];
  d->degree[g] = degree, d->previous[g] = last, d->next[g] = -1, d->tail[degree] = g;
  if (last >= 0) d->next[last] = g; else d->head[degree] = g;
  return degree < least ? degree : least;
}

/* Eliminates the groups in an order of minimum degree; auxiliary unknowns come from the leaves of trees to the roots, and forces
   after what they act on (sparse_lu.py). What each is coupled with then remains in its list; its position is in
   `position`. */
static void eliminate_groups(const Elimination *e) {
  int n = e->groups, all = e->first_unknown[n] + 1, least = 0, *lists = e->work, *links = lists + 2 * all;
  Degrees d = {lists, lists + all, links, links + n, links + 2 * n, links + 3 * n, links + 4 * n};
  memcpy(d.waits, e->waits, n * sizeof(int));
  for (int i = 0; i < all; ++i) d.head[i] = d.tail[i] = -1;
  for (int g = 0; g < n; ++g) d.mark[g] = -1, put_in(e, &d, g, 0);
  for (int k = 0, stamp = 0; k < n; ++k) {
    while (d.head[least] < 0) ++least;
    int g = d.head[least];
    IntList *eliminated = e->near_to + g;
    take_out(&d, g);
    e->position[g] = k;
    for (int i = 0; i < eliminated->count; ++i) {
      int h = eliminated->of[i], others = 0;
      ++stamp;
      IntList *near = e->near_to + h;
      take_out(&d, h);
      for (int j = 0; j < near->count; ++j) {
        int f = near->of[j];
        if (f != g) near->of[others++] = f, d.mark[f] = stamp;
      }
      near->count = others;
      for (int j = 0; j < eliminated->count; ++j)
        if (eliminated->of[j] != h && d.mark[eliminated->of[j]] != stamp) add_to(near, eliminated->of[j]);
      least = put_in(e, &d, h, least);
    }
    for (int i = e->waiting_start[g]; i < e->waiting_start[g + 1]; ++i) {
      int h = e->waiting[i];
      if (!--d.waits[h]) least = put_in(e, &d, h, least);
    }
  }
}

/* Orders the groups once more, by the same tree of elimination: first parts that do not need each other, then what all have in
   common. A part is made of subtrees, each with at most a quarter of all entries. */
static void find_parts(Elimination *e) {
  SparseRows *r = &e->rows;
  int n = e->groups, *group_at = e->work, *parent = group_at + n, *part = parent + n, *count;
  double *weight = calloc(n + 1, sizeof(double)), all = 0, part_weight[SUBTREES] = {0};
  ROOM(r->part_start, SUBTREES), count = memset(r->part_start, 0, (SUBTREES + 1) * sizeof(int));
  for (int g = 0; g < n; ++g) group_at[e->position[g]] = g;
  for (int k = 0; k < n; ++k) {
    const IntList *list = e->near_to + group_at[k];
    int size = e->first_unknown[group_at[k] + 1] - e->first_unknown[group_at[k]], behind = 0;
    parent[k] = n;
    for (int i = 0; i < list->count; ++i) {
      int h = list->of[i];
      if (e->position[h] < parent[k]) parent[k] = e->position[h];
      behind += e->first_unknown[h + 1] - e->first_unknown[h];
    }
    double entries = size * (size + 2.0 * behind);
    all += entries, weight[k] += entries, weight[parent[k]] += weight[k];
  }
  for (int k = n - 1; k >= 0; --k) {
    part[k] = parent[k] < n ? part[parent[k]] : SUBTREES;
    if (part[k] == SUBTREES && weight[k] <= all / 4) {
      part[k] = 0;
      for (int i = 1; i < SUBTREES; ++i)
        if (part_weight[i] < part_weight[part[k]]) part[k] = i;
      part_weight[part[k]] += weight[k];
    }
    if (part[k] < SUBTREES) ++count[part[k] + 1];
  }
  for (int i = 1; i <= SUBTREES; ++i) count[i] += count[i - 1];
  int next[SUBTREES + 1];
  memcpy(next, count, sizeof next);
  for (int k = 0; k < n; ++k) e->position[group_at[k]] = next[part[k]]++;
  free(weight);
}

static int by_value(const void *a, const void *b) { return *(const int *)a - *(const int *)b; }

static int size_at(const SparseRows *r, int group) { return r->first[group + 1] - r->first[group]; }

/* The rows of the factors, from the lists. */
static void find_rows(Elimination *e) {
  int n = e->groups, *position = e->position, *group_at = e->work, sources = 0, runs = 0;
  long couplings = 0, at = 0;
  SparseRows *r = &e->rows;
  eliminate_groups(e);
  if (r->parts) find_parts(e);
  r->groups = n, r->unknowns = e->first_unknown[n];
  ROOM(r->first, n), ROOM(r->source_start, n), ROOM(r->run_start, n);
  ROOM(r->start, r->unknowns), ROOM(r->diagonal, r->unknowns), ROOM(e->order, r->unknowns);
  for (int g = 0; g < n; ++g) {
    IntList *list = e->near_to + g;
    for (int i = 0; i < list->count; ++i) list->of[i] = position[list->of[i]];
    group_at[position[g]] = g, couplings += list->count;
  }
  ROOM(r->source, couplings), ROOM(r->run_column, couplings), ROOM(r->run_length, couplings);
  r->first[0] = 0;
  for (int k = 0; k < n; ++k) r->first[k + 1] = r->first[k] + e->first_unknown[group_at[k] + 1] - e->first_unknown[group_at[k]];
  for (int k = 0; k < n; ++k) {
    int size = size_at(r, k), lower = 0, upper = 0;
    IntList *list = e->near_to + group_at[k];
    int behind = list->count; /* the groups before have added themselves at the end */
    while (behind && list->of[behind - 1] < k) --behind;
    qsort(list->of, behind, sizeof(int), by_value);
    r->source_start[k] = sources, r->run_start[k] = runs;
    for (int i = behind; i < list->count; lower += size_at(r, list->of[i++])) r->source[sources++] = list->of[i];
    for (int i = 0; i < behind; ++i) {
      int other = list->of[i], many = size_at(r, other);
      add_to(e->near_to + group_at[other], k);
      if (i && other == list->of[i - 1] + 1) r->run_length[runs - 1] += many;
      else r->run_column[runs] = r->first[other], r->run_length[runs++] = many;
      upper += many;
    }
    if (r->symmetric) lower = 0;
    for (int i = 0; i < size; ++i, at += lower + size + upper) {
      int row = r->first[k] + i;
      r->start[row] = at, r->diagonal[row] = at + lower + i;
      e->order[e->unknown[e->first_unknown[group_at[k]] + i]] = row;
    }
  }
  r->source_start[n] = sources, r->run_start[n] = runs, r->start[r->unknowns] = at;
}

/* Position among the factors of an unknown's row and a column; -1 if one of them is a bordering row, behind all if it is not
   stored. */
static int place_of_pair(const Elimination *e, int i, int j) {
  if (i < 0 || j < 0) return -1;
  const SparseRows *r = &e->rows;
  int row = e->order[i], column = e->order[j], group = e->position[e->group_of[i]];
  long place = r->start[row];
  if (r->symmetric && column < r->first[group]) return r->start[r->unknowns];
  for (int s = r->source_start[group]; column < r->first[group]; ++s) {
    int beside = column - r->first[r->source[s]], size = size_at(r, r->source[s]);
    if (beside < size) return place + beside;
    place += size;
  }
  if (column < r->first[group + 1]) return r->diagonal[row] + column - row;
  place = r->diagonal[row] + r->first[group + 1] - row;
  for (int k = r->run_start[group];; place += r->run_length[k++])
    if (column < r->run_column[k] + r->run_length[k]) return place + column - r->run_column[k];
}

void fx_find_rows(Elimination *e, int entries, const int *row, const int *column, int *at) {
  begin_elimination(e);
  find_rows(e);
  for (int k = 0; k < entries; ++k) at[k] = place_of_pair(e, row[k], column[k]);
}
