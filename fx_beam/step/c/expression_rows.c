/* For values at the Gauss points (point_values.py). */

#include "expression_rows.h"

/* Adds the values A (rows, cells, values), of coefficients w (rows, cells, width), constants c of each row, and
   coordinates x of each cell. */
void fx_tabulate(Tabulate tabulate, Sizes of, int rows, int cells, const double *w, const double *c, const double *x, double *A) {
  for (int row = 0; row < rows; ++row, c += of.constants)
    for (int cell = 0; cell < cells; ++cell, w += of.width, A += of.values)
      tabulate(A, w, c, x + (long)cell * of.coordinates, 0, 0, 0);
}
