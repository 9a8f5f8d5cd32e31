/* What the scenes of a library have: build.py defines FEATURES, and the compiler leaves out the rest. A tangent is stored
   as a CHAIN, as a BAND, or else in sparse rows. */

#pragma once

enum { CHAIN = 1, BAND = 2, LOOPS = 4, SLIDERS = 8, MEMBERS = 16 };

#ifndef FEATURES
#define FEATURES -1
#endif
#define HAS(feature) ((FEATURES) & (feature))

/* Functions that Python calls: those of steps, or of their derivatives, which are a library of their own. */
#define KEPT __attribute__((externally_visible))
#ifdef DERIVATIVES
#define OF_STEPS
#define OF_DERIVATIVES KEPT
#else
#define OF_STEPS KEPT
#define OF_DERIVATIVES
#endif
