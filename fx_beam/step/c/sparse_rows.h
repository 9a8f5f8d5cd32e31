/* Storage of L and U in sparse rows without pivoting (sparse_lu.py). */

#pragma once

/* Factors, and where each row of them and its diagonal begin; groups of up to three successive rows with equal columns:
   their first rows, the groups that are subtracted from them, and the columns behind them in runs of successive ones. Of a
   symmetric matrix, as L D L^T, there are only the groups themselves and what is behind them: D L^T, and 1 / D. Of large
   systems parts of the groups, with where each begins: none needs another one, and the groups behind all need them. How many
   threads share them. */
typedef struct {
  int unknowns, *start, *diagonal; int groups, *first, *source_start, *source, *run_start, *run_column, *run_length;
  int parts, *part_start, threads, symmetric; double *factors;
} SparseRows;

/* Number of the parts, of which some may be empty. */
enum { SUBTREES = 8 };

typedef struct { int *of, count, room; } IntList;

/* Groups of unknowns with equal columns, their graph, and those that wait until others are eliminated. Then what is found from
   them (elimination.h): lists of what each group is coupled with, the order, and the rows. */
typedef struct {
  int groups, *group_of, *first_unknown, *unknown, *graph_start, *graph, *waits, *waiting_start, *waiting; IntList *near_to;
  int *order, *work, *position; SparseRows rows;
} Elimination;

/* The order and the rows of a pattern, and the positions among the factors of its entries, in these rows and columns; behind all,
   where they are those of the transposed position. */
void fx_find_rows(Elimination *e, int entries, const int *row, const int *column, int *at);
void fx_free_elimination(Elimination *e);
/* Factors of a matrix, of which `at` has the positions of the entries among them; returns 0 if a pivot is zero, or without
   memory. Then the solution x for the right side b, where unknown i has the position order[i] among the rows. */
int fx_factorise(const SparseRows *rows, int entries, const int *at, const double *values);
void fx_solve(const SparseRows *rows, const int *order, const double *b, double *x);
