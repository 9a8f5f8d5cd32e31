/* Order and rows of a sparse matrix for Python (lu_layout.py). */

#include "elimination.h"

void fx_find_rows(Elimination *e, int entries, const int *row, const int *column, int *at) {
  begin_elimination(e);
  find_rows(e);
  for (int k = 0; k < entries; ++k) at[k] = place_of_pair(e, row[k], column[k]);
}

void fx_free_elimination(Elimination *e) { free_elimination(e); }
