/* Sine and cosine of angles side by side: sums, products and choices, which the compiler vectorises, and what both have in common
   is computed once. Errors are below 2e-16; of angles of many turns they are as large as their round-off. */

#pragma once

#include "vectors.h"

/* Sine of x and so many quarter turns; x is n quarter turns and a rest r. A quarter turn has three parts, of which the first ones
   have so few digits that n times them is exact; the polynomials of r are those of fdlibm. */
INLINED double sine_ahead(double x, uint64_t quarters) {
  const double whole = 0x1.8p52; /* next to it numbers have no fractions */
  union { double number; uint64_t bits; } n = {x * 0x1.45f306dc9c883p-1 + whole}, s, c;
  double turns = n.number - whole, first = x - turns * 0x1.921fb544p0, r = first - turns * 0x1.0b4611a6p-34;
  double lost = ((first - r) - turns * 0x1.0b4611a6p-34) - turns * 0x1.3198a2e037073p-69, r2 = r * r, most = 1 - r2 / 2;
  s.number = r + (lost * most + r * r2 * (-1.66666666666666324348e-01 + r2 * (8.33333333332248946124e-03 + r2 * (
      -1.98412698298579493134e-04 + r2 * (2.75573137070700676789e-06 + r2 * (-2.50507602534068634195e-08
      + r2 * 1.58969099521155010221e-10))))));
  c.number = most + ((1 - most - r2 / 2) - r * lost + r2 * r2 * (4.16666666666666019037e-02 + r2 * (-1.38888888888741095749e-03
      + r2 * (2.48015872894767294178e-05 + r2 * (-2.75573143513906633035e-07 + r2 * (2.08757232129817482790e-09
      - r2 * 1.13596475577881948265e-11))))));
  n.bits += quarters;
  s.bits = (n.bits & 1 ? c.bits : s.bits) ^ (n.bits & 2) << 62;
  return s.number;
}

INLINED double sine(double x) { return sine_ahead(x, 0); }
INLINED double cosine(double x) { return sine_ahead(x, 1); }
