/* Factors of sparse matrices for Python (sparse_lu.py). */

#include <stdlib.h>
#include "lu.h"
#include "sparse_lu.h"

/* Factors of a matrix, of which `at` has the positions of the entries among them; returns 0 if a pivot is
   zero, or without memory. */
int fx_factorise(const SparseRows *rows, int entries, const int *at, const double *values) {
  double *space = malloc(3 * sizeof(double) * rows->unknowns);
  memset(rows->factors, 0, rows->start[rows->unknowns] * sizeof(double));
  for (int k = 0; k < entries; ++k) rows->factors[at[k]] = values[k];
  int regular = space && factorise_sparse(rows, space);
  free(space);
  return regular;
}

/* Solution x for the right side b, where unknown i has the position order[i] among the rows. */
void fx_solve(const SparseRows *rows, const int *order, const double *b, double *x) {
  double *y = malloc(sizeof(double) * rows->unknowns);
  for (int i = 0; i < rows->unknowns; ++i) y[order[i]] = b[i];
  substitute_sparse(rows, y);
  for (int i = 0; i < rows->unknowns; ++i) x[i] = y[order[i]];
  free(y);
}
