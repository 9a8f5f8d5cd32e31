/* The relation of a node that slides on a beam, for Python (coupling/sliding.py). */

#pragma once

#include "slider.h"

/* For displacements and rotations q at the start, and increments D, of the beam: the increment of the node
   with its derivatives. */
void fx_slide(Slider *a, const double *q, const double *D);
