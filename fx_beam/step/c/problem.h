/* What the loop reads and writes, its inputs and its output. There are three kinds of data:

   - Tables (tables.h) say how a scene is made: its indices, couplings, layout of factors, joints, and the scheme. All scenes of one
     structure have the same, in all their runs and threads; nothing changes them: all is const.
   - Numbers (numbers.h) are what such scenes differ in: places, masses, loads, arms of joints, properties of beams and of forces.
     Each run has its own. Arrays are const, but for parameters that vary, and for what forms and forces at points are given.
   - Work (work.h) is what a run computes: its state and past, factors, counts, what Newton's method leaves behind, and room.

   A Problem has all three. Functions that others call take it; those behind them take the parts that they need: `p` are the tables
   of a program, `s` the numbers of a scene, `w` the work of a run; or one table, the state, the factors. */

#pragma once

#include "work.h"

/* A scene and a scheme, the present state, and a run of steps from it. Only the functions that Python calls know it. */
typedef struct { const Tables *tables; Numbers numbers; Work work; } Problem;

/* Rows of an array. */
typedef struct { const double *source; double *target; long size; } Rows;

/* A tape (tape.h): rows of numbers, one for each sub-step. If they are `apart`, as
   equilibria are, none depends on those before. They may be a part of a run: there are `all`, and `first` before
   these. A tape without a `row` keeps increments of the columns alone, [sub-step][column], from which steps are
   repeated. */
typedef struct { long size, rows, first, all; int apart; double *row, *increments; } Tape;

/* Histories: a row for every `every`-th step and for the last; so many rows have been recorded. Number of the first step of this
   call, and of the last step of all; parts of a halved step, and those of the first step already taken; arrays of which rows are
   recorded; whether forces of joints and obstacles are among them. */
typedef struct {
  int every, first, last, rows, parts, part, histories, forces, *up_to_row; Rows *history;
  /* Starts of the sub-steps of recorded steps, if they are stored: their number, that of complete rows,
     and up to each row. Their shares of the step, and the ratio of the lengths of steps. */
  int stores_starts, starts, complete, stored; Rows *start; double *share, *memory;
  Tape *tape; /* 0 for none */
} Record;

/* Inputs of each sub-step: [start, end][load]; [driven column] at the end; [follower_force][x, y] at the scheme's level; [level,
   end][parameter]; [natural strain] at the end, 0 if Python sets these. With a stride of 0 all have those of the first. Increments
   of the columns and forces on the nodes, if they are known. In statics the load factor at the end. */
typedef struct {
  double *loads, *driven, *follower_force, *parameters, *natural, *known, *known_forces;
  long loads_stride, follower_force_stride, natural_stride; double ratio;
} Inputs;

/* The forces of elements: dense Jacobians, by the configurations at both ends and all else. Numbers of an element by
   which they are, and weights, its forces and internal variables at the end, in the vector x (blocks.h): [block][number or
   weight][lane]; lanes without an element have places of their own. Slopes are in pieces [number][weight][lane] behind
   the work, of which the first `made` are evaluated: where each begins, its numbers and weights, and of those by the
   start, from which they are taken, the piece by the end, or -1. */
typedef struct {
  int element_numbers, q_previous; /* numbers of each element itself; whether there are derivatives by the configuration before */
  Form slopes;
  int blocks, numbers, state_numbers, weights, slope_numbers, pieces, made; /* the first `state_numbers` numbers are of the state */
  int *piece_start, *number_at, *piece_numbers, *weight_at, *piece_weights, *end_of, *from, *to;
} Vjp;

/* Where the named arrays begin in the vector x of a sub-step that is linearised (blocks.h), each of which ends where the
   next one begins: numbers of the scene; the state at the start; numbers of the sub-step; the state at the end; what
   is between the laws of nodes that slide (slide_derivatives.h), arms of joints, values of Tv; forces on the columns of
   nodes that slide, on nodes and on columns, closures of loops and the forces that close them, what these push on beams;
   moments of springs at joints, forces of joints, axes of beams, and sizes of forces that friction follows. */
typedef struct {
  int mass, weight, columns, points, natural_columns, offset, axis, rest, gears, places, paths, members, member_places, internal_forces, drag;
  int Y, q, v, q_previous, natural, internal, spring_internal; /* the last three as behind the slides at the end */
  int loads, driven, follower_force, parameters, naturals, hold;
  int Y1, q1, arms, slides, natural1, internal1, springs1, map, held, r, R, closures, closing, pushed, carried, moments;
  int forces, axes, followed, nowhere, size;
} Layout;

/* Rows of a run, of states at boundaries between sub-steps or of forces in sub-steps: the number of the row of each, -1 for
   none, the places in x of its numbers, and the rows. */
typedef struct { int *at, size, *place; double *rows; } RowsOfRun;

/* Friction in a sub-step around a reversal of its slip (reversals.h), by the place of the stretch of its spring. Before it the
   derivative of the time of the reversal is `leads` times that of the slip. In it the stretch is far beyond the limit, so that
   the friction is given, and the force of its joint; it changes by `pushes` times its derivative by mu with that time. */
typedef struct { int place; double stretch, force, leads, keeps, pushes, share; } Reversal;

/* A run of which derivatives are followed: backwards (adjoint.h) those of a function of the states at its boundaries, the
   ends of sub-steps, and of forces of driven and fixed columns and of joints; forwards (forward.h) changes of these with those
   of all numbers of a scene, in groups of GROUP_SIZE directions, the last one filled with zeros: [group][number][direction]. */
typedef struct {
  Vjp internal_forces, drag;
  RowsOfRun states, forces; /* forwards with a row for each direction */
  double *x, *step_slopes; /* by the numbers of the scene and the state (Layout), and by those of each sub-step */
  int directions, *changes_mass; /* whether masses or weights change in each group */
  double *sizes;      /* of the derivatives by the rates at the starts of sub-steps */
  /* If it is there, forces on unknowns have given weights, no equations are solved, and these are the derivatives by the
     unknowns at both ends. Rows are sums of those of sub-steps, which have a share of them. */
  double *unknown_slopes, *share;
  double *slide_at_rest; /* in the reference configuration */
  /* Of the laws of forces at points: derivatives of each force and internal variable by start, increments, internal
     variables, numbers and parameters, and room for them; how many numbers each has, and all. */
  Law **slopes; int *numbers, point_numbers; double *point_slopes;
  /* Position among sparse factors of each entry of the transposed tangent; of a chain or a band, of each stored value. */
  int *transposed_at;
  int *followed;      /* places in x of the forces that friction follows */
  int *reversal_start; Reversal *reversal; /* the first of each sub-step, if there are any */
  int member_numbers; /* of contact with members: how many numbers its laws have */
  double *scratch;
} Derivatives;

/* Configurations with rates, slides, and rates of driven columns, in rows; rates that fit joints and supports (fitted_rates.h),
   and the impulses of joints and of driven and fixed columns that make them fit. Derivatives of these may be wanted, too. */
typedef struct { long rows; double *q, *v, *slides, *driven, *rates, *joints, *constraints; } Fits;

enum { VALUES, BACKWARDS, FORWARDS };

int fx_begin_joints(Problem *problem);
int fx_expand(Problem *problem, int close);
int fx_run(Problem *problem, int steps, double t, double dt, const Inputs *inputs, const Limits *limits, Record *to);
int fx_repeat(Problem *problem, int steps, double t, double dt, const Inputs *inputs, Record *to);
Counts fx_take_counts(Problem *problem);
long fx_lay_out(Problem *problem, double *memory);
int fx_renew_factors(Problem *problem);
int fx_judge(Problem *problem, Convergence *c, int iteration, int shortened);
void fx_begin(Problem *problem, double t, double dt, double *follower_force);
void fx_end_at(Problem *problem, double dt, double ratio);
int fx_balance(Problem *problem, double dt);
void fx_change(const Problem *problem, const double *x, int sizes, double *out);
void fx_list_border(Problem *problem, BorderEntries *to);
Layout fx_layout(const Problem *problem, const Derivatives *a);
long fx_linear_scratch(const Problem *problem, const Derivatives *a);
long fx_tape_size(const Problem *problem);
long fx_taped_forces(Problem *problem, const Tape *tape, const Derivatives *a, double *forces);
long fx_vjp(Problem *problem, const Tape *tape, const Derivatives *a);
long fx_jvp(Problem *problem, const Tape *tape, const Derivatives *a);
int fx_fit(Problem *problem, const Fits *of, const Derivatives *a, int way);
void fx_free_rows(ChangingRows *c);
