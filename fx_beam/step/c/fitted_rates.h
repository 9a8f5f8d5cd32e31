/* Equations of rates, for Python (fitted_rates.py). Members in a `struct { };` either all are set or
   none; all other pointers are always set. */

#pragma once

/* A node that slides on a beam, in equations of rates: whether it slides freely and turns with the beam;
   the path as in Slider of problem.h. */
typedef struct {
  int joint, free, sleeve, degree, elements, nodes, *dofs;
  double *ends, *coefficients, *position, *angle;
} BeamRate;

/* The equations G v = g of a scene. */
typedef struct {
  int size, joints, columns, driven; /* degrees of freedom, joints, driven and fixed columns, driven ones */
  /* Pins, slots, joints that turn together, nodes on beams; all equations and their entries. */
  int pins, slots, turns, beams, count, all_entries;
  int *arm_a, *arm_b;   /* [pin or slot][3] degrees of freedom; -1 for the ground */
  double *apart, *slide_axis, *has_arm;
  double *turned;       /* [turn] whether a motor drives the angle */
  BeamRate *beam;
  int *joint, *column;  /* of each equation, or -1 */
  double *turning;      /* whether the multiplier of an equation is a moment */
  /* Massless points that move rigidly with other nodes, those first that carry no other. */
  int points, *point_a, *point_b, *point_rows;
  double *point_apart;
  /* Equations that remain: rows; their entries among all, with degrees of freedom; entries that move to
     nodes a with an arm; the entry to which each adds. */
  int remaining, raw, carries, *remaining_row, *raw_entry, *raw_row, *raw_dof;
  int *carry_from, *carry_arm, *entry_of;
  double *carry_sign;
  int entries, *row, *dof;
  double *entry, *lacking, *multiplier; /* their values, what each lacks, and the solution */
  /* Degrees of freedom in them; for each entry its number among these, and whether they are massless. */
  int used, *used_dof, *used_of, *massless;
  int width, *number;   /* width of their bands, and position of each equation */
  /* With lumped masses: their inverse, and products of two entries in the bands. */
  struct { int pairs, *pair_left, *pair_right, *pair_to; double *pair_weight, *inverse_mass; };
  struct { double *flexible, *inner; }; /* or: all and used rates from unit impulses; else as below */
  double *scratch;
} RateFit;

long fx_fit_scratch(const RateFit *f);
void fx_fit(const RateFit *f, int n, const double *q, const double *v, const double *slide,
            const double *driven, double *rates, double *corrections, double *joints, double *constraints);
/* The same for one configuration in two parts: the equations, and all that follows from the multipliers
   and corrections, which are given then. */
void fx_begin_fit(const RateFit *f, const double *q, const double *v, const double *slide,
                  const double *driven);
void fx_end_fit(const RateFit *f, const double *v, double *rates, double *corrections, double *joints,
                double *constraints);
const char *fx_missing(void); /* processor.h */
