/* Values of a UFL expression on elements, for many rows of its coefficients. */

#pragma once

/* A function that FFCx generates; later versions give the last argument a meaning. */
typedef void (*Tabulate)(double *, const double *, const double *, const double *, const int *, const unsigned char *, void *);

/* Numbers of coefficients, constants, coordinates and values of an element. */
typedef struct { int width, constants, coordinates, values; } Sizes;

void fx_tabulate(Tabulate tabulate, Sizes sizes, int rows, int cells, const double *w, const double *c, const double *x, double *A);
