/* Supports and joints alone, for Python (coupling/reduction.py). */

#include "couplings.h"

/* Begins a step of the joints from the state; returns 0 in a singular position. */
KEPT int fx_begin_joints(Problem *p) {
  Work work = work_of(p), *w = &work;
  return begin_couplings(p, w);
}

/* Finds the increments for those z of the columns, of which the ones that close loops are corrected if the loops `close`;
   returns 0 if these cannot be closed. `to` are the increments of nodes and columns, values of T and Tv, and closures. */
KEPT int fx_expand(Problem *p, const double *z, int close, double **to) {
  Work work = work_of(p), *w = &work;
  int closed = 1;
  memcpy(w->z, z, p->columns * sizeof(double));
  if (close) closed = expand(p, w);
  else {
    expand_trees(p, w);
    find_closures(p, w, w->D, w->closure0, w->closure);
  }
  double *results[] = {w->D, w->z, w->values, w->virtual_map, w->closure};
  memcpy(to, results, sizeof results);
  return closed;
}
