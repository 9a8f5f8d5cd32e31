/* Solutions by a copy of the sparse factors of a large system in single precision, by several threads. It is read at half the
   cost, in the order in which it is stored, and only proposes corrections: what these leave is found with the exact tangent
   (reused_factors.h). */

#pragma once

#include "work.h"
#include "sparse_lu.h"

/* Work that threads share: with right sides b, or without for the copy. */
typedef struct { const SparseRows *p; const Narrow *narrow; double *b; } Narrowed;

static int group_size(const SparseRows *p, int g) { return p->first[g + 1] - p->first[g]; }

/* Pieces of the copy. */
enum { PIECES = 32 };

HOT void narrow_piece(const void *task, int piece, int thread) {
  const Narrowed *t = task;
  const SparseRows *p = t->p;
  for (int g = (long)p->groups * piece / PIECES; g < (long)p->groups * (piece + 1) / PIECES; ++g) {
    int size = group_size(p, g), i = p->first[g];
    for (int x = 0; x < size; ++x) {
      const double *row = p->factors + p->start[i + x], *own = p->factors + p->diagonal[i + x] - x;
      float *lower = t->narrow->lower + t->narrow->lower_at[g] + x, *upper = t->narrow->upper + t->narrow->upper_at[g] + x;
      for (int s = p->source_start[g]; p->symmetric && s < p->source_start[g + 1]; ++s) {
        int h = p->source[s], many = group_size(p, h), before;
        run_of(p, h, g, &before);
        for (int y = 0; y < many; ++y, lower += size) {
          const double *diagonal = p->factors + p->diagonal[p->first[h] + y];
          *lower = diagonal[many - y + before + x] * diagonal[0];
        }
      }
      for (; row < own; lower += size) *lower = *row++;
      memcpy(t->narrow->own + 9L * g + 3 * x, own, size * sizeof(double));
      for (row += size; row < p->factors + p->start[i + x + 1]; upper += size) *upper = *row++;
    }
  }
}

static void narrow_factors(const SparseRows *p, const Narrow *narrow) {
  Narrowed task = {p, narrow, 0};
  for (int g = 0, lower = 0; g < p->groups; ++g) {
    narrow->lower_at[g] = lower;
    for (int s = p->source_start[g]; s < p->source_start[g + 1]; ++s)
      lower += group_size(p, g) * group_size(p, p->source[s]);
  }
  for (int g = p->groups - 1, upper = 0; g >= 0; --g) {
    int i = p->first[g], size = group_size(p, g);
    narrow->upper_at[g] = upper, upper += size * (p->start[i + 1] - p->diagonal[i] - size);
  }
  share(p->threads, PIECES, narrow_piece, &task);
}

INLINED Four widened(const float *x) {
#if defined __AVX__ && !defined __clang__ /* GCC would make it of two halves */
  return __builtin_ia32_cvtps2pd256(*(const Floats *)x);
#else
  return __builtin_convertvector(*(const Floats *)x, Four);
#endif
}

/* Adds the product of some columns of a group and known unknowns to sums; returns the columns behind them. */
INLINED const float *add_columns(int size, const float *column, const double *known, int many, Four *sums) {
  int k = 0;
  for (; size == 3 && k + 3 <= many; k += 3, column += 9)
    for (int y = 0; y < 3; ++y) sums[y] += widened(column + 3 * y) * known[k + y]; /* the fourth number is not used */
  for (; k < many; ++k, column += size)
    for (int x = 0; x < size; ++x) sums[0][x] += column[x] * known[k];
  return column;
}

/* Subtracts known unknowns from right sides of a group, by the columns of the groups before `end` and not before `begin`; then,
   unless more are to come, those of the group itself. */
INLINED void narrow_forward(const SparseRows *p, const Narrow *narrow, int g, int size, int begin, int end, double *b) {
  const int *first = p->first, *source = p->source;
  const float *column = narrow->lower + narrow->lower_at[g];
  const double *own = narrow->own + 9L * g;
  Four sums[3] = {{0}};
  int i = first[g], s = p->source_start[g], last = p->source_start[g + 1];
  for (; s < last && source[s] < begin; ++s) column += size * group_size(p, source[s]);
  for (; s < last && source[s] < end; ++s)
    column = add_columns(size, column, b + first[source[s]], group_size(p, source[s]), sums);
  sums[0] += sums[1] + sums[2];
  for (int x = 0; x < size; ++x) {
    for (int z = 0; g < end && z < x; ++z) sums[0][x] += own[3 * x + z] * b[i + z];
    b[i + x] -= sums[0][x];
  }
}

/* The unknowns of a group from those behind it. */
INLINED void narrow_backward(const SparseRows *p, const Narrow *narrow, int g, int size, double *b) {
  const float *column = narrow->upper + narrow->upper_at[g];
  const double *own = narrow->own + 9L * g;
  Four sums[3] = {{0}};
  int i = p->first[g];
  for (int k = p->run_start[g]; k < p->run_start[g + 1]; ++k)
    column = add_columns(size, column, b + p->run_column[k], p->run_length[k], sums);
  sums[0] += sums[1] + sums[2];
  for (int x = size - 1; x >= 0; --x) {
    for (int z = x + 1; z < size; ++z) sums[0][x] += own[3 * x + z] * b[i + z];
    b[i + x] = (b[i + x] - sums[0][x]) * own[4 * x];
  }
}

/* Groups from `first` on to `last`, with those from `begin` on to `end`; and back. */
HOT void forward_groups(const Narrowed *t, int first, int last, int begin, int end) {
  for (int g = first; g < last; ++g)
    if (group_size(t->p, g) == 3) narrow_forward(t->p, t->narrow, g, 3, begin, end, t->b);
    else narrow_forward(t->p, t->narrow, g, group_size(t->p, g), begin, end, t->b);
}

HOT void backward_groups(const Narrowed *t, int first, int last) {
  for (int g = last - 1; g >= first; --g)
    if (group_size(t->p, g) == 3) narrow_backward(t->p, t->narrow, g, 3, t->b);
    else narrow_backward(t->p, t->narrow, g, group_size(t->p, g), t->b);
}

static void forward_part(const void *task, int part, int thread) {
  const Narrowed *t = task;
  forward_groups(t, t->p->part_start[part], t->p->part_start[part + 1], 0, t->p->groups);
}

/* Subtracts unknowns of all parts from some right sides behind these. */
static void forward_behind(const void *task, int panel, int thread) {
  const Narrowed *t = task;
  int top = t->p->part_start[SUBTREES], first = top + PANEL * panel, last = first + PANEL;
  forward_groups(t, first, last < t->p->groups ? last : t->p->groups, 0, top);
}

static void backward_part(const void *task, int part, int thread) {
  const Narrowed *t = task;
  backward_groups(t, t->p->part_start[part], t->p->part_start[part + 1]);
}

/* The solution in the place of b. */
static void substitute_narrow(const SparseRows *p, const Narrow *narrow, double *b) {
  Narrowed task = {p, narrow, b};
  int top = p->part_start[SUBTREES];
  share(p->threads, SUBTREES, forward_part, &task);
  share(p->threads, panels_behind(p, top), forward_behind, &task);
  forward_groups(&task, top, p->groups, top, p->groups);
  backward_groups(&task, top, p->groups);
  share(p->threads, SUBTREES, backward_part, &task);
}
