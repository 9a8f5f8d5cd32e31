/* Nodes that slide on beams, for Python. */

#include "slide_relation.h"
#include "sliding.h"

void fx_slide(Slider *a, const double *q, const double *D) { slide_on(a, q, D); }
