/* Factors of sparse matrices for Python. */

#pragma once

#include "sparse_rows.h"

int fx_factorise(const SparseRows *rows, int entries, const int *at, const double *values);
void fx_solve(const SparseRows *rows, const int *order, const double *b, double *x);
