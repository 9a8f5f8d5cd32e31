/* Supports and joints alone, for Python (coupling/reduction.py). */

#include "couplings.h"

/* Begins a step of the joints from the state; returns 0 in a singular position. */
KEPT int fx_begin_joints(Problem *p) {
  Work work = work_of(p), *w = &work;
  return begin_couplings(p, w);
}

/* Finds the increments for those of the columns, of which the ones that close loops are corrected if the loops `close`;
   returns 0 if these cannot be closed. */
KEPT int fx_expand(Problem *p, int close) {
  Work work = work_of(p), *w = &work;
  if (close) return expand(p, w);
  expand_trees(p, w);
  find_closures(p, w, w->D, w->closure0, w->closure);
  return 1;
}
