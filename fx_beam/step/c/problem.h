/* What the loop reads and writes, its inputs and its output. There are three kinds of data:

   - Tables say how a scene is made: its indices, couplings, layout of factors, joints, and the scheme. All scenes of one structure
     have the same, in all their runs and threads; nothing changes them.
   - Numbers are what such scenes differ in: places, masses, loads, arms of joints, properties of beams and of forces. Each run has
     its own. They stay as they are, but for what varies in time: parameters, and what forms and forces at points are given.
   - Work is what a run computes: its state and past, factors, counts, what Newton's method leaves behind, and room.

   A Problem has all three. Functions that others call take it; those behind them the parts that they need: `p` are Tables of
   a program, `s` numbers of a scene, `w` the work of a run. */

#pragma once

#include "sparse_rows.h"
#include "point_force.h"
#include "slider.h"

/* Sizes of fixed arrays. */
enum {
  LANES = 8,        /* elements that are evaluated at once */
  RULE_VALUES = 18, /* values of a user's rule for the rates of a node */
  PAST = 4,         /* earlier configurations from which the predictor extrapolates; largest order of a scheme */
  SUB_STEPS = 32,   /* most sub-steps of a scheme */
  AVERAGED = 3,     /* differences that are averaged in a local error */
  CORRECTIONS = 8,  /* last corrections of Newton's method whose sizes are stored */
  GROUP_SIZE = 4    /* directions in which derivatives forwards are followed at once */
};

/* The first bordering row (bordering_rows.h) in lists of positions in the elimination; others are below it, and -1 is none. */
enum { ON_BORDER = -2 };

/* Fields that are coefficients of forms, and their number: displacements and rotations (increment in the step, and at its
   start), their rates, accelerations and values a step earlier; internal variables; natural strains at both ends. */
enum { INCREMENT, START, RATE, ACCELERATION, PREVIOUS, INTERNAL, NATURAL, NATURAL_END, FIELDS };

/* Why a step failed. */
enum {
  OK, NO_CONVERGENCE, SINGULAR, TURNED_TOO_FAR, TOO_INACCURATE, SLID_TOO_FAR, SWITCHED, PASSED_THROUGH, OUT_OF_LINE,
  OPEN_LOOP, MOVED_TOO_FAR, UNMET_FRICTION, AMPLIFIED };

/* Element tensors from coefficients, constants and coordinates. All arrays except the constants are
   for LANES elements, with entry k of lane l at [k][l]. */
typedef void Batch(double *, const double *, const double *, const double *);

/* The elements of one integral, in blocks of LANES. The last block is padded with copies of the last
   element. Their results are added behind the end of the vector or matrix, where they are not used;
   each lane has its own index there, so that additions do not wait for each other. */
typedef struct {
  Batch *batch; int cells;
  /* [block][..][lane]: the first degree of freedom of each node, where it is read and added to; of pairs of degrees of freedom of
     a cell indices in the tangent; of internal variables and natural strains those in the ones of all cells. */
  int *dofs, *to, *stored_at, *internal, *natural;
  /* In a chain instead, for pairs of nodes with entries in three rows of a group: [block][row's node, column's node][lane] index
     of the first. Other entries: where those of each block begin, their indices among the element tensors, and in the tangent. */
  int *run, *single_start, *single_from, *single_to;
  /* Of a large scene colours, with the pieces of so many blocks that each has, which have no node in common: threads share them. */
  int colours, *colour_start, *piece;
} Integral;

enum { PIECE = 16 };

/* Of a Form which field each of the `moving` coefficients is, and where it begins among those of an element, `width` in all; where
   each of those that do not move is among these. Indices among the constants, or -1, that of the first parameter last; which ones
   of the scene the parameters are. */
typedef struct {
  int width, moving, *kind, *offset, data_width, *data_column;
  int time_at, dt_at, memory_at, parameters_at, parameters, *parameter;
} FormTables;

/* Nodes and elements of the beams: degrees of freedom without mass; how many threads share the elements. */
typedef struct { int nodes, cell_dofs, cell_coordinates, massless_count, *massless, threads; } Mesh;

/* Internal variables of beams, with a factor for each of a cell. */
typedef struct { int per_cell; double *per_weight; } Internal;

/* Natural strains: their number, and those of a cell; where unit ones have strains, in compressed rows. */
typedef struct { int count, per_cell, *start, *at; } Natural;

/* Where unit loads have forces, in compressed rows; number of follower forces, the first external ones. */
typedef struct { int count, *start, *dof, follower_forces; } Loads;

/* The full tangent in compressed rows; `stored_at` has the storage index of each value. Entries that are
   entries of the reduced tangent share its storage; the others are behind it. */
typedef struct {
  int stored;            /* number of values */
  int *row_start, *column_of, *stored_at;
  int reacting, *reacts; /* rows with forces of supports and joints */
} Tangent;

/* Pattern of the mass matrix, in compressed rows of nodes: the first degree of freedom of each column's node; where the tangent
   has the numbers of each pair of nodes [pair][3]. */
typedef struct { int *start, *dof, *stored_at; } Mass;

/* Displacements and rotations x = g(z) of the columns z, which are unknowns, then driven and fixed ones, with T = dg/dz, and
   Tv for virtual displacements. Each entry of both is a sign times one of the values of the joints: number 0 is the constant 1,
   and joint j has those from 1 + 4 j on. */
typedef struct {
  int count, *row, *column, *value; double *sign;
  int equal;            /* number of the first entries, which are 1: all, one of each row in turn, where nothing is COUPLED */
} Map;

/* Joints whose arms depend on the motion: rotations of the carrier and of the node it carries (-1: ground), column of the
   slide (-1: none), number among all joints, kind of Track; signs of the arm's components in what they move. */
typedef struct {
  int count, *carrier, *carried_node, *slide_column, *number, *track; double *sign;
  int followers, *follower, *through; /* degrees of freedom that arms move; 2 j + i of component i of arm j */
} Joints;

/* Auxiliary unknowns: degrees of freedom in long trees with columns of their own, behind all others (graph.py). Each
   is a sum of entries of T, and of arms. */
typedef struct { int count, entries, arms; int *of, *column, *value, *arm_of, *arm; double *sign; } Auxiliary;

/* How many nodes slide on beams, and how many numbers their paths have (scene/beam_axis.py). */
typedef struct { int count, path_numbers; } Sliders;

/* The reduced tangent, in an order with little fill-in: as a chain, as a band, or in sparse rows. Unknowns, with two of each
   auxiliary one, itself and its force, and forces that close loops; half bandwidth, 0 for sparse rows; groups of three unknowns in
   a row (chain.h), 0 if they are more entangled; positions, more than unknowns where groups of a chain have fewer than three;
   entries that are 1: diagonals of these and of auxiliary unknowns, and another one. */
typedef struct {
  int unknowns, band, chain, positions, paddings, *padding;
  /* The tangent beside sparse rows of factors, in compressed rows of the unknowns. */
  int *tangent_start, *tangent_column;
  /* Of each column of the scene the row of the forces on it, and its unknown: -1 for none, or a bordering row. */
  int *row_of, *unknown_of;
} System;

/* Bordering rows (bordering_rows.h): their number, the first of forces that close loops on beams, columns of a block of right
   sides; whether they are among the sparse rows, and which column is the pivot of each there. */
typedef struct {
  int rows, carriers, block, inside, *pivot;
  int bordered, *bordered_unknown, *bordered_row; /* unknowns of them that stand alone among the others */
  int beside, *beside_row, *beside_column, *beside_at; /* entries of the tangent in them, and where these are stored */
} Border;

/* How the reduced tangent is made of the full one. Entries that are added as they are: */
typedef struct { int count, *to, *from; } Direct;

/* Entries times an entry of Tv and an entry of T. Entries of T and Tv of auxiliary unknowns and of closures, in equations and in
   the balance of what their forces act on, are such products with a stored 1. From number `stiffened` on there are also products
   of two entries of a closure with the stiffness of closures, which is stored at `stiffness_at`. */
typedef struct { int count, *to, *from, *virtual, *value; double *sign; int stiffened, stiffness_at; } Coupled;

/* Derivatives of Tv times the forces of joints: by the rotation of the carrier (kind 0 of the lever, 2 of the slide's force) or
   by the slide (1 and 3). */
typedef struct { int count, *to, *joint, *kind; double *sign; } Geometric;

/* Closures: components of the displacements of b less a and the arm of joints that close loops, which are zero. Loops that
   share unknowns are a block, of which the closures and columns follow each other. Columns on which closures depend, the first of
   which are unknowns; degrees of freedom (-1: ground); arm (-1: none); joint force. */
typedef struct {
  int closures, blocks, columns, *b, *a, *arm, *force;
  /* Derivatives of closures: entries of T or Tv, those of each closure from its start on; entries of auxiliary unknowns on
     which they depend, in the order in which these are collected; which of the loops' columns they have. */
  int *entry_start, *entry_column, *entry_value; double *entry_sign; int *auxiliary_start, *auxiliary; int *start, *near;
  /* Columns of the scene and their units; arms in the reference; what makes lengths of closures, as some are angles; length of a
     closed one; [blocks + 1] where each begins, the last in its factors; room for rows of an elimination in Work. */
  int *column; double *unit, *arm_at_rest, *length, closed;
  int *block_closure, *block_column, *block_part, pivoting_size;
  /* Closures with nodes on beams, whose forces are bordering rows from `carriers` on. The stiffness of closures is from the
     diagonals stored there, with a unit [size] of each unknown. */
  int carried, *carried_closure, scales, *scale_at; double *scale_unit;
} Loops;

/* Gears: terms, two of each, which are a weight times the rotation of b less that of a (-1: ground), or times the slide of a moving
   joint (-1: none), and whose sum is a closure. Term t has the value behind those of joints. */
typedef struct { int count, *closure, *joint, *a, *b; } Gears;

/* Forces at points in the scene: number of their internal variables; lines between points, whose pulls are recorded; whether
   friction follows forces of joints; where the tangent has the entries of theirs, -1 for none. */
typedef struct { int spring_width, lines, friction_follows, *stored_at; } AtPoints;

/* Parameters of the user's functions: whether they vary, and stored energies with them. */
typedef struct { int count, vary, energies_vary; } Parameters;

/* Rule for the rates: 0 mid-point, 1 Newmark. In statics a step has no rates and no inertia, and its `ratio` is
   the load factor at its end. Sub-steps, relative to a step. */
typedef struct {
  int rule, at_rest, keeps_previous, sub_steps; double level, beta, gamma, alpha_m; double fractions[SUB_STEPS];
  /* Rules of a user, of which the sub-steps take turns; where the tangent has all entries of a pair of nodes [pair][3][3]. */
  int rules, *rule_stored_at; Law **nodal_rule;
} Scheme;

/* Options of Newton's method. */
typedef struct {
  double tolerance, negligible, energy_floor, max_turn, longest_turn, large_turn; int max_iterations, may_overshoot;
} NewtonOptions;

/* Driven columns: those of prescribed degrees of freedom, so many, then motors. Degrees of freedom a and b between which their
   forces do work (-1: the ground), b the prescribed one; but for motors on slides. */
typedef struct { int prescribed, *a, *b, *slides; } Motors;

/* How forces of joints pass through these from the nodes that follow to those that lead (-1: none), the former first; first
   displacements, then rotations. `joints` are all of the scene. */
typedef struct { int joints, count, force_count, *dof, *to, *of; double *sign; } Passes;

/* Parts with energies of their own, if there are several: runs of degrees of freedom and of unknowns, and the part of each;
   for each part those whose energies together are its own. */
typedef struct {
  int count, dof_runs, *dof_run_start, *dof_run_part, column_runs, *column_run_start, *column_run_part, *inside_start, *inside;
} Parts;

/* Tables of a program; of the columns the free ones are the unknowns, driven ones follow. */
typedef struct {
  int dofs, cells, columns, free, driven, has_added; /* whether forms have added forces */
  Mesh mesh; Internal internal; Natural natural; Loads loads; Tangent tangent; Mass mass; Map map; Joints joints; Auxiliary auxiliary;
  Sliders sliders; Loops loops; Gears gears; System system; Border border; Direct direct; Coupled coupled; Geometric geometric;
  AtPoints at_points; Parameters parameters; Motors motors; Passes passes; Parts parts; Scheme scheme; NewtonOptions newton;
} Tables;

/* Numbers of the elements of an integral, [block][..][lane]: coordinates x and y of each place. Coefficients that do not move: blocks
   with equal ones share them, so that each has its number among those stored. */
typedef struct { const Integral *of; double *coordinates, *data; int *data_at; } Cells;

/* Compiled forms that are evaluated together: one integral for each law. */
typedef struct { int integrals; const FormTables *tables; Cells *cells; double *constants; } Form;

/* Forms of the beams: internal forces and drag, each with its tangent; energies lost to drag, to the material and to the scheme,
   and held by it, also at the start with the parameters of the step; increments of the internal variables, each times the weight
   of its point; work of natural strains that change. */
typedef struct {
  Form internal_forces, energy, inversion, added, drag, lost_to_drag, lost, taken, held_by_scheme, held_before, evolution, actuated;
} Forms;

/* A frame that turns: arms of the displacements in the reference, and square of its spin. */
typedef struct { double *arm; double spin_squared; } Frame;

/* Numbers of a scene: positions [node][x, y]; 1 / size of a unit correction of each degree of freedom, and the same for errors of
   steps; mass, the same, and rotary inertia of each pair of nodes, with a number behind all; weights with which a viscosity resists
   increments; offset and axis of joints in the frame of the carrier; [gear][weight, weight, sum at rest]; strains of unit natural
   strains, forces of unit loads, and the weight of all nodes; values of parameters with which forms and laws are evaluated, those
   of the state where they do not vary. */
typedef struct {
  double *position, *per_unit, *per_error, *mass, *viscous_weight, *offset, *axis, *gears, *natural, *load_force, *weight, *parameters;
  Forms forms; PointForces *points; Frame frame;
} Numbers;

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
   found; entries of T and Tv of each degree of freedom; whether factors may be kept, and the costs of lu_layout.py; number of the
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

/* Finds the increment of a sub-step of this length in the place of Newton's method here, and counts its iterations: the unknowns, from their predicted values
   on, and the forces on nodes, internal ones and all (`z`, `f` and `r` of Results). Returns why it fails. */
typedef int Find(double dt, int *iterations);

/* What Newton's method leaves behind: largest sizes in units of corrections in the last iterations, of which `tried` were made;
   whether pivots of the last factors were raised, -1 for a singular tangent, and whether they are those of an earlier tangent; the
   first correction of a step, without its sign. Another program that finds increments, if there is one. */
typedef struct { Find *find; double corrections[CORRECTIONS]; int tried, raised, old_factors; double *predicted; } Newton;

/* A sequence that converges quadratically: its last value, and its slowest convergence so far. */
typedef struct { double last, slowest; } Sequence;

/* Convergence of a step, by its corrections: their sizes, roots of their work, and how many were small, or no
   smaller than those before. */
typedef struct { Sequence sizes, errors; int small, stalled; } Convergence;

/* Of statics: holding forces on the unknowns, and the first degrees of freedom of those of which there are derivatives, with
   their number; positions in the tangent and size of a viscosity on increments; a yielding of forces that close loops, in rates that
   fit joints. */
typedef struct { double *hold; int *hold_dof, holds, *diagonal_at; double viscosity, yielding; } Statics;

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
   [PAST] divided differences of configurations and then, if joints couple nodes, of unknowns, from order 1 on; number of previous sub-steps; orders of the
   prediction of each sub-step, 0 for none. */
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

/* Work of a run. Arrays in the same memory (work.h): of degrees of freedom and of nodes; of columns; of joints, at both
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
  const double *fields[FIELDS];                /* by the kinds of Form */
  double dt, *loads, *follower_force, *naturals; /* inputs of a sub-step */
  int transposed;  /* whether bordering rows are those of the transposed tangent */
  int slopes_only; /* whether elements give no tangent: it comes from their slopes (element_derivatives.h), or none is needed */
} Work;

/* A scene and a scheme, the present state, and a run of steps from it. */
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
  int mass, weight, columns, points, natural_columns, offset, axis, rest, gears, places, paths, members, arcs, member_places, internal_forces, drag;
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
  int member_numbers, member_arcs; /* of contact with members: how many numbers and arcs its laws have */
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
