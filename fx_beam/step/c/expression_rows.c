/* For values at the Gauss points (point_values.py). */

#include "expression_rows.h"

/* Adds the values A (rows, cells, values), of coefficients w (rows, cells, width), constants c of each row, and
   coordinates x of each cell. */
void fx_tabulate(Tabulate tabulate, Sizes sizes, int rows, int cells, const double *w, const double *c, const double *x, double *A) {
  for (int row = 0; row < rows; ++row, c += sizes.constants)
    for (int cell = 0; cell < cells; ++cell, w += sizes.width, A += sizes.values)
      tabulate(A, w, c, x + (long)cell * sizes.coordinates, 0, 0, 0);
}
