/* LU factorisation in sparse rows (sparse_lu.py), for the loop and for Python (sparse_lu.py); of symmetric matrices L D L^T. */

#pragma once

#include <string.h>
#include "sparse_rows.h"
#include "threads.h"
#include "vectors.h"

static inline int is_pivot(double x) { return fabs(x) > 1e-300; }

/* Three numbers, those of a node. */
INLINED Four three(const double *x) { return (Four){x[0], x[1], x[2], 0}; }

/* Subtracts multiples of three rows from three others, of which most columns are those of nodes. */
INLINED void subtract_rows(int n, double (*f)[3], const double *const *from, double *const *to) {
  int k = 0;
  for (; k + 3 <= n; k += 3) {
    Four a = three(from[0] + k), b = three(from[1] + k), c = three(from[2] + k);
    for (int x = 0; x < 3; ++x)
      put_three(three(to[x] + k) - (f[x][0] * a + f[x][1] * b + f[x][2] * c), to[x] + k);
  }
  for (; k < n; ++k)
    for (int x = 0; x < 3; ++x) to[x][k] -= f[x][0] * from[0][k] + f[x][1] * from[1][k] + f[x][2] * from[2][k];
}

/* A copy, without a call for the most frequent length, that of a node. */
INLINED void copy_run(int length, const double *restrict from, double *restrict to) {
  if (length == 3) to[0] = from[0], to[1] = from[1], to[2] = from[2]; else memcpy(to, from, length * sizeof(double));
}

/* End of the groups before a group of which its stored rows have columns. */
static inline int stored_sources(const SparseRows *p, int g) { return p->source_start[p->symmetric ? g : g + 1]; }

/* Copies stored rows of a group to rows with a place for each column. */
INLINED void unpack(const SparseRows *p, const double *A, int g, int size, double *const *row) {
  const int *first = p->first;
  for (int x = 0; x < size; ++x) {
    const double *from = A + p->start[first[g] + x];
    for (int s = p->source_start[g]; s < stored_sources(p, g); ++s) {
      int column = first[p->source[s]], length = first[p->source[s] + 1] - column;
      copy_run(length, from, row[x] + column);
      from += length;
    }
    for (int y = 0; y < size; ++y) row[x][first[g] + y] = *from++;
    for (int k = p->run_start[g]; k < p->run_start[g + 1]; from += p->run_length[k++])
      copy_run(p->run_length[k], from, row[x] + p->run_column[k]);
  }
}

/* Elimination within a group, from the rows that `unpack` filled, of which the upper part is stored; returns 0 if a
   pivot is zero. */
INLINED int finish(const SparseRows *p, double *A, int g, int size, double *const *row) {
  int i = p->first[g];
  double factor[3][3] = {{0}}, *upper[3];
  for (int x = 0; x < size; ++x) {
    upper[x] = A + p->diagonal[i + x];
    if (!is_pivot(row[x][i + x])) return row[0][0] = i + x, 0; /* the row is told */
    *upper[x]++ = 1 / row[x][i + x];
    for (int z = x + 1; z < size; ++z) {
      factor[z][x] = row[z][i + x] * upper[x][-1];
      A[p->diagonal[i + z] - z + x] = factor[z][x];
      for (int y = x + 1; y < size; ++y) row[z][i + y] -= factor[z][x] * row[x][i + y];
    }
    for (int y = x + 1; y < size; ++y) *upper[x]++ = row[x][i + y];
  }
  for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k) {
    int column = p->run_column[k], end = column + p->run_length[k];
    Four entries[3];
    for (; end - column >= 3; column += 3)
      for (int z = 0; z < size; ++z) {
        entries[z] = three(row[z] + column);
        for (int x = 0; x < z; ++x) entries[z] -= factor[z][x] * entries[x];
        put_three(entries[z], upper[z]), upper[z] += 3;
      }
    for (; column < end; ++column)
      for (int z = 0; z < size; ++z) {
        for (int x = 0; x < z; ++x) row[z][column] -= factor[z][x] * row[x][column];
        *upper[z]++ = row[z][column];
      }
  }
  return 1;
}

/* Subtracts multiples of the rows of an eliminated group of `many` rows from those of a group. */
INLINED void eliminate_source(const SparseRows *p, double *A, int g, int h, int size, int many, int lower, double *const *row) {
  const int *start = p->start, *diagonal = p->diagonal, *first = p->first;
  int i = first[g], at = first[h];
  double f[3][3] = {{0}};
  const double *from[3];
  for (int y = 0; y < 3; ++y) from[y] = A + diagonal[at + (y < many ? y : 0)];
  for (int x = 0; x < size; ++x)
    for (int y = 0; y < many; ++y) {
      f[x][y] = row[x][at + y] * from[y][0];
      for (int z = y + 1; z < many; ++z) row[x][at + z] -= f[x][y] * from[y][z - y];
      A[start[i + x] + lower + y] = f[x][y];
    }
  for (int y = 0; y < 3; ++y) from[y] += y < many ? many - y : many;
  for (int k = p->run_start[h]; k < p->run_start[h + 1]; ++k) {
    int length = p->run_length[k];
    double *to[3];
    for (int x = 0; x < 3; ++x) to[x] = row[x] + p->run_column[k];
    subtract_rows(length, f, from, to);
    for (int y = 0; y < 3; ++y) from[y] += length;
  }
}

COMPILED_ONCE void eliminate_others(const SparseRows *p, double *A, int g, int h, int size, int many, int lower,
                                    double *const *row) {
  eliminate_source(p, A, g, h, size, many, lower, row);
}

/* Run behind an eliminated group in which a later group is, and how many columns are before it. */
INLINED int run_of(const SparseRows *p, int h, int g, int *before) {
  int k = p->run_start[h], column = p->first[g];
  for (*before = 0; p->run_column[k] + p->run_length[k] <= column; ++k) *before += p->run_length[k];
  *before += column - p->run_column[k];
  return k;
}

/* `eliminate_source` of a symmetric matrix, of which only columns from the group on are subtracted. */
INLINED void eliminate_across(const SparseRows *p, double *A, int g, int h, int size, int many, double *const *row) {
  int before, k = run_of(p, h, g, &before), column = p->first[g];
  double f[3][3] = {{0}};
  const double *from[3];
  for (int y = 0; y < 3; ++y) {
    int z = y < many ? y : 0;
    const double *diagonal = A + p->diagonal[p->first[h] + z];
    from[y] = diagonal + many - z + before;
    for (int x = 0; x < size && y < many; ++x) f[x][y] = from[y][x] * diagonal[0];
  }
  for (; k < p->run_start[h + 1]; ++k) {
    column = column > p->run_column[k] ? column : p->run_column[k];
    int length = p->run_column[k] + p->run_length[k] - column;
    double *to[3];
    for (int x = 0; x < 3; ++x) to[x] = row[x] + column;
    subtract_rows(length, f, from, to);
    for (int y = 0; y < 3; ++y) from[y] += length;
  }
}

/* Stores rows that `unpack` filled, from the source number s on, which has this place among the lower factors. */
INLINED void store_rows(const SparseRows *p, double *A, int g, int size, int s, int lower, double *const *row) {
  const int *first = p->first;
  for (int x = 0; x < size; ++x) {
    double *to = A + p->start[first[g] + x] + lower;
    for (int k = s, many; k < stored_sources(p, g); ++k, to += many) {
      many = first[p->source[k] + 1] - first[p->source[k]];
      copy_run(many, row[x] + first[p->source[k]], to);
    }
    for (int y = 0; y < size; ++y) *to++ = row[x][first[g] + y];
    for (int k = p->run_start[g]; k < p->run_start[g + 1]; to += p->run_length[k++])
      copy_run(p->run_length[k], row[x] + p->run_column[k], to);
  }
}

/* Elimination of the rows of a group, by the groups before `end`, after those before `begin`: then, unless more are to come, in
   itself; returns 0 if a pivot is zero. */
INLINED int factorise_group(const SparseRows *p, double *A, int g, int size, int begin, int end, double *const *row) {
  const int *first = p->first, *source = p->source;
  int lower = 0, s = p->source_start[g], last = p->source_start[g + 1];
  for (; s < last && source[s] < begin; ++s) lower += first[source[s] + 1] - first[source[s]];
  if (g >= end && (s == last || source[s] >= end)) return 1;
  unpack(p, A, g, size, row);
  for (; s < last && source[s] < end; ++s) {
    int h = source[s], many = first[h + 1] - first[h];
    if (p->symmetric && size == 3 && many == 3) eliminate_across(p, A, g, h, 3, 3, row);
    else if (p->symmetric) eliminate_across(p, A, g, h, size, many, row);
    else if (size == 3 && many == 3) eliminate_source(p, A, g, h, 3, 3, lower, row);
    else eliminate_others(p, A, g, h, size, many, lower, row);
    lower += many;
  }
  if (g < end) return finish(p, A, g, size, row);
  store_rows(p, A, g, size, s, p->symmetric ? 0 : lower, row);
  return 1;
}

/* The groups from `first` on to `last`; returns 0 if a pivot is zero. */
HOT int factorise_groups(const SparseRows *p, int first, int last, int begin, int end, double *rows) {
  double *row[3] = {rows, rows + p->unknowns, rows + 2 * p->unknowns};
  for (int g = first; g < last; ++g) {
    int size = p->first[g + 1] - p->first[g];
    int regular = size == 3 ? factorise_group(p, p->factors, g, 3, begin, end, row)
                            : factorise_group(p, p->factors, g, size, begin, end, row);
    if (!regular) return 0;
  }
  return 1;
}

/* Rows that threads factorise together, with space for each: by the groups from `begin` to `end`. The row of each part that lacks
   a pivot, or -1. */
typedef struct { const SparseRows *rows; double *space; int begin, end, *singular; } Shared;

/* Groups behind all parts that are taken at once. */
enum { PANEL = 8 };

static void factorise_part(const void *task, int part, int thread) {
  const Shared *t = task;
  const SparseRows *p = t->rows;
  double *space = t->space + 3L * thread * p->unknowns;
  int regular = factorise_groups(p, p->part_start[part], p->part_start[part + 1], 0, p->groups, space);
  t->singular[part] = regular ? -1 : space[0];
}

/* Subtracts rows from those of some of the groups behind them. */
static void subtract_part(const void *task, int part, int thread) {
  const Shared *t = task;
  const SparseRows *p = t->rows;
  int first = t->end + PANEL * part, last = first + PANEL < p->groups ? first + PANEL : p->groups;
  factorise_groups(p, first, last, t->begin, t->end, t->space + 3L * thread * p->unknowns);
}

static int panels_behind(const SparseRows *p, int group) { return (p->groups - group + PANEL - 1) / PANEL; }

/* LU factorisation of sparse rows in place, in groups of up to three with equal columns, usually those
   of a node; returns 0 if a pivot is zero. `rows` is the work space (3, unknowns) for the current group of each thread. */
static int factorise_sparse(const SparseRows *p, double *rows) {
  int singular[SUBTREES], top = p->parts ? p->part_start[SUBTREES] : 0;
  if (!p->parts) return factorise_groups(p, 0, p->groups, 0, p->groups, rows);
  Shared task = {.rows = p, .space = rows, .singular = singular};
  share(p->threads, SUBTREES, factorise_part, &task);
  for (int k = 0; k < SUBTREES; ++k)
    if (singular[k] >= 0) return rows[0] = singular[k], 0;
  for (task.end = top;; task.begin = task.end, task.end += PANEL) {
    share(p->threads, panels_behind(p, task.end), subtract_part, &task);
    if (task.end >= p->groups) return 1;
    int last = task.end + PANEL < p->groups ? task.end + PANEL : p->groups;
    if (!factorise_groups(p, task.end, last, task.end, last, rows)) return 0;
  }
}

/* Subtracts the known unknowns from `size` right sides, by the lower factors of a group. */
INLINED void forward(const SparseRows *p, const double *A, int g, int size, double *b) {
  const int *start = p->start, *first = p->first;
  int i = first[g];
  double sum[3] = {0};
  Four sums[3] = {{0}};
  const double *row[3];
  for (int x = 0; x < size; ++x) row[x] = A + start[i + x];
  for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s) {
    int at = first[p->source[s]], many = first[p->source[s] + 1] - at;
    if (many == 3) {
      Four known = three(b + at);
      for (int x = 0; x < size; ++x) sums[x] += three(row[x]) * known, row[x] += 3;
    } else for (int y = 0; y < many; ++y)
      for (int x = 0; x < size; ++x) sum[x] += *row[x]++ * b[at + y];
  }
  for (int x = 0; x < size; ++x) {
    sum[x] += sums[x][0] + sums[x][1] + sums[x][2];
    for (int z = 0; z < x; ++z) sum[x] += row[x][z] * b[i + z];
    b[i + x] -= sum[x];
  }
}

/* Substitution of a symmetric matrix: after the known unknowns, subtracts those of the group from the right sides behind it. */
INLINED void forward_across(const SparseRows *p, const double *A, int g, int size, double *b) {
  int i = p->first[g];
  double scaled[3];
  const double *row[3];
  for (int x = 0; x < size; ++x) {
    const double *diagonal = A + p->diagonal[i + x];
    for (int z = 0; z < x; ++z) b[i + x] -= diagonal[z - x] * b[i + z];
    scaled[x] = b[i + x] * diagonal[0], row[x] = diagonal + size - x;
  }
  for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k)
    for (int x = 0; x < size; ++x)
      for (double *to = b + p->run_column[k], *end = to + p->run_length[k]; to < end;) *to++ -= *row[x]++ * scaled[x];
}

/* The unknowns of a group from those behind it, by its upper factors. */
INLINED void backward(const SparseRows *p, const double *A, int g, int size, double *b) {
  int i = p->first[g];
  double sum[3] = {0};
  Four sums[3] = {{0}};
  const double *row[3];
  for (int x = 0; x < size; ++x) row[x] = A + p->diagonal[i + x] + size - x;
  for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k) {
    const double *known = b + p->run_column[k], *end = known + p->run_length[k];
    for (; end - known >= 3; known += 3)
      for (int x = 0; x < size; ++x) sums[x] += three(row[x]) * three(known), row[x] += 3;
    for (; known < end; ++known)
      for (int x = 0; x < size; ++x) sum[x] += *row[x]++ * *known;
  }
  for (int x = size - 1; x >= 0; --x) {
    const double *upper = A + p->diagonal[i + x];
    sum[x] += sums[x][0] + sums[x][1] + sums[x][2];
    for (int z = x + 1; z < size; ++z) sum[x] += upper[z - x] * b[i + z];
    b[i + x] = (b[i + x] - sum[x]) * upper[0];
  }
}

HOT void substitute_forward(const SparseRows *p, double *b) {
  const int *first = p->first;
  const double *A = p->factors;
  for (int g = 0; g < p->groups; ++g) {
    int size = first[g + 1] - first[g];
    if (p->symmetric) forward_across(p, A, g, size, b);
    else if (size == 3) forward(p, A, g, 3, b); else forward(p, A, g, size, b);
  }
}

/* Only those that are `reached` or not, if it is given. */
HOT void substitute_backward(const SparseRows *p, double *b, const int *reached, int now) {
  const int *first = p->first;
  const double *A = p->factors;
  for (int g = p->groups - 1; g >= 0; --g) {
    int size = first[g + 1] - first[g];
    if (reached && reached[first[g]] != now) continue;
    if (size == 3) backward(p, A, g, 3, b); else backward(p, A, g, size, b);
  }
}

/* Solution by sparse factors, in the place of b. */
static void substitute_sparse(const SparseRows *p, double *b) {
  substitute_forward(p, b);
  substitute_backward(p, b, 0, 0);
}

int fx_factorise(const SparseRows *rows, int entries, const int *at, const double *values) {
  double *space = malloc(3 * sizeof(double) * rows->unknowns * (rows->threads > 1 ? rows->threads : 1));
  memset(rows->factors, 0, rows->start[rows->unknowns] * sizeof(double));
  for (int k = 0; k < entries; ++k) rows->factors[at[k]] = values[k];
  int regular = space && factorise_sparse(rows, space);
  free(space);
  return regular;
}

void fx_solve(const SparseRows *rows, const int *order, const double *b, double *x) {
  double *y = malloc(sizeof(double) * rows->unknowns);
  for (int i = 0; i < rows->unknowns; ++i) y[order[i]] = b[i];
  substitute_sparse(rows, y);
  for (int i = 0; i < rows->unknowns; ++i) x[i] = y[order[i]];
  free(y);
}
