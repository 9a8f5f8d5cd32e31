/* Supports and joints alone, for Python (coupling/reduction.py). */

#include "couplings.h"

/* Begins a step of the joints from the state; returns 0 in a singular position. */
KEPT int fx_begin_joints(Problem *problem) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  return begin_couplings(p, s, w);
}

/* Finds the increments for those of the columns, of which the ones that close loops are corrected if the loops `close`;
   returns 0 if these cannot be closed. */
KEPT int fx_expand(Problem *problem, int close) {
  const Tables *p = problem->tables; const Numbers *s = &problem->numbers; Work *w = &problem->work;
  if (close) return expand(p, s, w);
  expand_trees(p, s, w);
  find_closures(p, s, w, w->D, w->closure0, w->closure);
  return 1;
}
