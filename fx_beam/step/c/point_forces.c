/* For the steps in Python. */

#include "point_forces.h"
