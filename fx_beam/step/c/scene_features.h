/* Features of the scenes of a library: build.py defines FEATURES, and the compiler leaves out the rest. A tangent is stored
   as a CHAIN, as a BAND, or else in sparse rows. */

#pragma once

enum { CHAIN = 1, BAND = 2, COUPLED = 4, LOOPS = 8, SLIDERS = 16, MEMBERS = 32 };

#ifndef FEATURES
#define FEATURES -1
#endif
#define HAS(feature) ((FEATURES) & (feature))

/* Functions that Python calls, in four libraries: of steps, of their derivatives backwards (VJP) and forwards (JVP), and of
   rates that FIT joints. */
#if __has_attribute(externally_visible)
#define KEPT __attribute__((externally_visible))
#else
#define KEPT
#endif
#if defined FIT || defined VJP || defined JVP
#define OF_STEPS
#else
#define OF_STEPS KEPT
#endif
