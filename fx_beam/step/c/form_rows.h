/* Element tensors of a form for many rows of its coefficients. */

#pragma once

/* A function that FFCx generates. */
typedef void (*Tabulate)(double *, const double *, const double *, const double *, const int *, const unsigned char *, void *);

/* Lengths of the coefficients, constants, coordinates and tensor of an element. */
typedef struct {
  int width, constants, coordinates, size;
} FormSizes;

void fx_tabulate(Tabulate tabulate, FormSizes of, int rows, int cells, const double *w, const double *c, const double *x, double *A);
const char *fx_missing(void); /* processor.h */
