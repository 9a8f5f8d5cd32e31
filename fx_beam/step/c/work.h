/* What a run computes, and room for it. */

#pragma once

#include "numbers.h"
#include "slider.h"

/* Sparse factors that serve several steps (reused_factors.h). */
typedef struct {
  int worth;           /* substitutions that cost as much as a factorisation; 0: factors serve one iteration */
  int present, made;   /* whether there are factors; how many have been made */
  int exact;           /* whether to make new ones in each iteration, after a failure */
  int narrow;          /* whether their narrow copy serves (narrow_factors.h) */
  int steps, all, now; /* since they were made: steps, and substitutions in these; substitutions in this step */
  double slowest_size, slowest_error; /* of Newton's quadratic convergence in the last step */
} ReusedFactors;

/* A term of contact in an entry of the linear system: a sign times an entry of the 10 x 10 tangent of a contact point, a value of
   Tv and a value of T. `row` and `column` are of unknowns, or bordering rows; `at` is the position among the factors, or -1. */
typedef struct { short entry, sign; int contact_point, row, column, virtual_value, value, at; } ContactPair;

/* Sparse rows whose pattern changes with the points that are near members (changing_rows.h): the elimination from which they are
   found; entries of T and Tv of each degree of freedom; whether factors may be kept, and the costs of sparse_lu.py; number of the
   search for contact points for which the rows are, and first nodes of the windows of what slides; whether positions among the
   factors are those of the transposed tangent, -1 before there are any; pairs of all contact points, or of what slides: whether
   they are being found, and the next one. */
typedef struct {
  Elimination elimination;
  int *dof_start, *dof_column, *dof_value; double *dof_sign;
  int keep; double row_entry, substitution, least_worth;
  long searches; int *window, placed, pairs, room, finds, next; ContactPair *pair;
} ChangingRows;

/* Sparse rows of factors, with the position of each unknown in the elimination, and in `at` that of each value of the tangent among
   the factors. Where the pattern changes, `rows` are those of `changing`, which sets the positions, too. */
typedef struct { SparseRows *rows; int *order, *at; ChangingRows *changing; ReusedFactors reused; } Factors;

/* Finds the increment of a sub-step of this length in the place of Newton's method here, and counts its iterations: the unknowns,
   from their predicted values on, and the forces on nodes, internal ones and all (`z`, `f` and `r` of Work). Returns why it fails. */
typedef int Find(double dt, int *iterations);

/* What Newton's method leaves behind: largest sizes in units of corrections in the last iterations, of which `tried` were made;
   0 if all pivots of a chain are `finite`; whether pivots of the last factors were raised, -1 for a singular tangent, and whether they are those
   of an earlier tangent; the first correction of a step, without its sign. Another program that finds increments, if there is one. */
typedef struct {
  Find *find; double corrections[CORRECTIONS], finite; int tried, raised, old_factors; double *predicted, *beam_forces, *beam_tangent;
} Newton;

/* A sequence that converges quadratically: its last value, and its slowest convergence so far. */
typedef struct { double last, slowest; } Sequence;

/* Convergence of a step, by its corrections: their sizes, roots of their work, and how many were small, or no
   smaller than those before. */
typedef struct { Sequence sizes, errors; int small, stalled; } Convergence;

/* Of statics: holding forces on the unknowns, and the number of those of which there are derivatives; positions in the tangent
   and size of a viscosity on increments; a yielding of forces that close loops, in rates that fit joints. */
typedef struct { double *hold; int holds, *diagonal_at; double viscosity, yielding; } Statics;

/* The state. Its arrays and those of the predictor are in one piece of memory. */
typedef struct {
  double *memory; long size;
  double STATE_NUMBERS, STATE_ARRAYS; /* by their names in results/state.py */
  double *driven_now;
  /* Forces are means over the step so far, of which the parts before are the share `earlier`, this sub-step
     `share`; values of the last sub-step where forces are not at mid-step. */
  double earlier, share;
  double ratio;         /* of the lengths of the last step and of this one, `memory` of a record */
  double energies[8], momenta[3]; /* of the last row */
  int steps_done;       /* 0 if there is no previous step */
  int forces_found;     /* whether those of joints, obstacles and lines were computed in the last step */
} State;

/* The last configurations, from which the next one is predicted: [PAST + 1] times since those before the last one, the latest first;
   [PAST] divided differences of configurations and then, if joints couple nodes, of unknowns, from order 1 on; number of previous
   sub-steps; orders of the prediction of each sub-step, 0 for none. */
typedef struct { double *ages, *past; int known, orders[SUB_STEPS]; } Predictor;

/* When a run ends: whether errors are controlled, and whether before a step in which a contact or law switches. Factors of averaged
   differences of displacements and of single ones of all, and of these where steps are too coarse for their order; ratios of error
   and limit at which it ends: two below, or one above. */
typedef struct { int controlled, watches; double smooth, raw, coarse, lowest, highest; } Limits;

/* Local errors of whole steps: [PAST + 1] ages, [PAST] divided differences of configurations from order 1 on, [2] the last two of
   the order after that of the scheme; number of previous steps. [2][switches] values whose signs tell that a contact or law
   switches, at both ends of a sub-step. Ratios of the last two steps, negative if unknown; whether the run ended at such a ratio. */
typedef struct {
  Limits limits; int scheme_order, known, switches, stopped;
  double *ages, *past, *last, *sides, ratios[2];
} Control;

/* A run: whether steps are repeated for their tape alone, and whether forces of joints are computed in every step, recorded or
   not; number of the present sub-step; why it failed. */
typedef struct { int repeats, keeps_joint_forces, sub_step, failure; } Run;

/* Counts of the steps or parts since the last ones (fx_take_counts): of those that were taken; iterations; solves that end at
   round-off; steps with rotations above large_turn per step; those that were refused, as dampers gave energy; those that end with
   inverted sections, and the time of the first. Of solves that end at round-off the sum of their last corrections, the largest
   motion, in units, and the largest correction with its degree of freedom. */
typedef struct {
  int taken, iterations, by_round_off, too_large, amplified, inverted, left_at;
  double inverted_t, left, moved, left_most;
} Counts;

/* Inverted sections: the first configuration that has some. With less strain energy no section is inverted. */
typedef struct { double *q, least_energy; } Inverted;

/* Entries of bordering rows and columns: these are behind the unknowns. */
typedef struct { int count, *row, *column; double *value; } BorderEntries;

/* A narrow copy of sparse factors (narrow_factors.h). Columns of each group before it, and behind it from the last group on, each
   of as many numbers as the group has rows; where those of a group begin; the factors of each group itself [group][3][3]. */
typedef struct { float *lower, *upper; int *lower_at, *upper_at; double *own; } Narrow;

/* Work of a run. Arrays in the same memory (room.h): of degrees of freedom and of nodes; of columns; of joints, at both
   ends and over the step; of the linear system; of loops, where `follows` has the closure that each of their columns follows, or
   -1, and pivot rows are sparse; by position bordering columns, and where these are `reached`, and bordering rows, with the first
   and the last position of each; bands [blocks, 2] of factors. */
typedef struct {
  State state; Predictor predictor; Control control; Run run; Counts counts; Inverted inverted; Factors factors; Newton newton;
  Statics statics; Slider *slider;
  int *following;                    /* [closures] the loops' columns that depend on the others, chosen in each step */
  double *slide_rate, *part_energy;  /* of all joints, if forces act on slides; [2][part] work of a correction and energies */
  BorderEntries *listed;             /* where bordering entries are to be listed */
  double *D, *path, *slope, *acc, *f, *r, *correction, *force, *dead, *scratch, *passed, *loaded, *rule, *natural_end, *saved;
  double *reduced, *step, *z, *columns, *start;
  double *values0, *values, *virtual_map, *frame, *arm_change, *half_turn, *joint_forces;
  double *y, *row, *tangent, *residual, *proposed, *factorised;
  double *G, *G_virtual, *part, *closure, *closure0, *closure_row, *pivoting, *closing;
  double *block, *border, *bordering_right, *corner, *corner_units;
  int *follows, *pivot_row, *pivot_column, *touched, *band, *exchanged, *corner_exchanged, *reached, *crossed;
  Narrow narrow;
  const double *fields[FIELDS];                  /* by the kinds of Form */
  double dt, *loads, *follower_force, *naturals; /* inputs of a sub-step */
  const double *pushes;                          /* [dofs] further dead forces, or 0 for none */
  int transposed;  /* whether bordering rows are those of the transposed tangent */
  int slopes_only; /* whether elements give no tangent: it comes from their slopes (element_derivatives.h), or none is needed */
} Work;
