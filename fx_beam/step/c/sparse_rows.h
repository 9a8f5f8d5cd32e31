/* Storage of L and U in sparse rows without pivoting (lu_layout.py). */

#pragma once

/* Where each row and its diagonal begin; groups of up to three successive rows with equal columns: their
   first rows, the groups that are subtracted from them, and the columns behind them in runs of successive
   ones. */
typedef struct {
  int unknowns, *start, *diagonal;
  int groups, *first, *source_start, *source, *run_start, *run_column, *run_length;
} SparseRows;
