/* Tables: how a scene is made. All scenes of one structure have the same, in all their runs and threads. */

#pragma once

#include "sparse_rows.h"
#include "point_force.h"

/* Sizes of fixed arrays. */
enum {
  LANES = 8,        /* elements that are evaluated at once */
  RULE_VALUES = 18, /* values of a user's rule for the rates of a node */
  PAST = 4,         /* earlier configurations from which the predictor extrapolates; largest order of a scheme */
  SUB_STEPS = 32,   /* most sub-steps of a scheme */
  AVERAGED = 3,     /* differences that are averaged in a local error */
  CORRECTIONS = 8,  /* last corrections of Newton's method whose sizes are stored */
  GROUP_SIZE = 4,   /* directions in which derivatives forwards are followed at once */
  ROW = 12          /* numbers of an unknown's row in the tangent of a chain (chain.h) */
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
     a cell indices in the tangent; of internal variables and natural strains those in the ones of all cells. Of each block the first
     degree of freedom if its elements have two nodes each, which all follow each other, else -1. */
  const int *dofs, *to, *stored_at, *internal, *natural, *in_row;
  /* In a chain instead, for pairs of nodes with entries in three rows of a group: [block][row's node, column's node][lane] index
     of the first. Other entries: where those of each block begin, their indices among the element tensors, and in the tangent. */
  const int *run, *single_start, *single_from, *single_to;
  /* Of those blocks in a row that set their rows of a chain, with masses, the first pair of masses: of the first node and the
     second one; else -1. */
  const int *mass_pair;
  /* Of a large scene colours, with the pieces of so many blocks that each has, which have no node in common: threads share them. */
  int colours; const int *colour_start, *piece;
} Integral;

enum { PIECE = 16 };

/* Of a Form which field each of the `moving` coefficients is, and where it begins among those of an element, `width` in all; where
   each of those that do not move is among these. Indices among the constants, or -1, that of the first parameter last; which ones
   of the scene the parameters are. */
typedef struct {
  int width, moving, data_width; const int *kind, *offset, *data_column;
  int time_at, dt_at, memory_at, parameters_at, parameters; const int *parameter;
} FormTables;

/* Nodes and elements of the beams: how many threads share the elements; degrees of freedom without mass. */
typedef struct { int nodes, cell_dofs, cell_coordinates, massless_count, threads; const int *massless; } Mesh;

/* Internal variables of beams, with a factor for each of a cell. */
typedef struct { int per_cell; const double *per_weight; } Internal;

/* Natural strains: their number, and those of a cell; where unit ones have strains, in compressed rows. */
typedef struct { int count, per_cell; const int *start, *at; } Natural;

/* Number of follower forces, the first external ones; where unit loads have forces, in compressed rows. */
typedef struct { int count, follower_forces; const int *start, *dof; } Loads;

/* The full tangent in compressed rows; `stored_at` has the storage index of each value. Entries that are
   entries of the reduced tangent share its storage; the others are behind it. Masses set all but some gaps. */
typedef struct {
  int stored;            /* number of values */
  const int *row_start, *column_of, *stored_at;
  int gaps; const int *gap; /* [gaps][start, end] */
  int reacting; const int *reacts; /* rows with forces of supports and joints */
} Tangent;

/* Pattern of the mass matrix, in compressed rows of nodes: the first degree of freedom of each column's node; where the tangent
   has the numbers of each pair of nodes [pair][3]; if elements set some pairs with their own entries, whether they set each. */
typedef struct { const int *start, *dof, *stored_at, *by_elements; } Mass;

/* Displacements and rotations x = g(z) of the columns z, which are unknowns, then driven and fixed ones, with T = dg/dz, and
   Tv for virtual displacements. Each entry of both is a sign times one of the values of the joints: number 0 is the constant 1,
   and joint j has those from 1 + 4 j on. */
typedef struct {
  int count; const int *row, *column, *value; const double *sign;
  int equal;            /* number of the first entries, which are 1: all, one of each row in turn, where nothing is COUPLED */
  /* Where nothing is COUPLED, runs of entries whose columns follow each other: where each begins, with its column; none if they
     are short. */
  int runs; const int *run_start, *run_column;
} Map;

/* Joints whose arms depend on the motion: rotations of the carrier and of the node it carries (-1: ground), column of the
   slide (-1: none), number among all joints, kind of Track; signs of the arm's components in what they move. */
typedef struct {
  int count; const int *carrier, *carried_node, *slide_column, *number, *track; const double *sign;
  int followers; const int *follower, *through; /* degrees of freedom that arms move; 2 j + i of component i of arm j */
} Joints;

/* Auxiliary unknowns: degrees of freedom in long trees with columns of their own, behind all others (graph.py). Each
   is a sum of entries of T, and of arms. */
typedef struct { int count, entries, arms; const int *of, *column, *value, *arm_of, *arm; const double *sign; } Auxiliary;

/* How many nodes slide on beams, and how many numbers their paths have (scene/sliders.py). */
typedef struct { int count, path_numbers; } Sliders;

/* The reduced tangent, in an order with little fill-in: as a chain, as a band, or in sparse rows. Unknowns, with two of each
   auxiliary one, itself and its force, and forces that close loops; half bandwidth, 0 for sparse rows; groups of three unknowns in
   a row (chain.h), 0 if they are more entangled; positions, more than unknowns where groups of a chain have fewer than three;
   entries that are 1: diagonals of these and of auxiliary unknowns, and another one; whether positions in a chain or a band follow
   each other as the unknowns. */
typedef struct {
  int unknowns, band, chain, positions, in_order, paddings; const int *padding;
  /* The tangent beside sparse rows of factors, in compressed rows of the unknowns. */
  const int *tangent_start, *tangent_column;
  /* Of each column of the scene the row of the forces on it, and its unknown: -1 for none, or a bordering row. */
  const int *row_of, *unknown_of;
} System;

/* Bordering rows (bordering_rows.h): their number, the first of forces that close loops on beams, columns of a block of right
   sides; whether they are among the sparse rows, and which column is the pivot of each there. */
typedef struct {
  int rows, carriers, block, inside; const int *pivot;
  int bordered; const int *bordered_unknown, *bordered_row; /* unknowns of them that stand alone among the others */
  int beside; const int *beside_row, *beside_column, *beside_at; /* entries of the tangent in them, and where these are stored */
} Border;

/* How the reduced tangent is made of the full one. Entries that are added as they are: */
typedef struct { int count; const int *to, *from; } Direct;

/* Entries times an entry of Tv and an entry of T. Entries of T and Tv of auxiliary unknowns and of closures, in equations and in
   the balance of what their forces act on, are such products with a stored 1. From number `stiffened` on there are also products
   of two entries of a closure with the stiffness of closures, which is stored at `stiffness_at`. */
typedef struct { int count; const int *to, *from, *virtual, *value; const double *sign; int stiffened, stiffness_at; } Coupled;

/* Derivatives of Tv times the forces of joints: by the rotation of the carrier (kind 0 of the lever, 2 of the slide's force) or
   by the slide (1 and 3). */
typedef struct { int count; const int *to, *joint, *kind; const double *sign; } Geometric;

/* Closures: components of the displacements of b less a and the arm of joints that close loops, which are zero. Loops that
   share unknowns are a block, of which the closures and columns follow each other. Columns on which closures depend, the first of
   which are unknowns; degrees of freedom (-1: ground); arm (-1: none); joint force. */
typedef struct {
  int closures, blocks, columns; const int *b, *a, *arm, *force;
  /* Derivatives of closures: entries of T or Tv, those of each closure from its start on; entries of auxiliary unknowns on
     which they depend, in the order in which these are collected; which of the loops' columns they have. */
  const int *entry_start, *entry_column, *entry_value, *auxiliary_start, *auxiliary, *start, *near; const double *entry_sign;
  /* Columns of the scene and their units; arms in the reference; what makes lengths of closures, as some are angles; length of a
     closed one; [blocks + 1] where each begins, the last in its factors; room for rows of an elimination in Work. */
  const int *column; double closed; const double *unit, *arm_at_rest, *length;
  int pivoting_size; const int *block_closure, *block_column, *block_part;
  /* Closures with nodes on beams, whose forces are bordering rows from `carriers` on. The stiffness of closures is from the
     diagonals stored there, with a unit [size] of each unknown. */
  int carried, scales; const int *carried_closure, *scale_at; const double *scale_unit;
} Loops;

/* Gears: terms, two of each, which are a weight times the rotation of b less that of a (-1: ground), or times the slide of a moving
   joint (-1: none), and whose sum is a closure. Term t has the value behind those of joints. */
typedef struct { int count; const int *closure, *joint, *a, *b; } Gears;

/* Forces at points in the scene: number of their internal variables; lines between points, whose pulls are recorded; whether
   friction follows forces of joints; where the tangent has the entries of theirs, -1 for none. */
typedef struct { int spring_width, lines, friction_follows; const int *stored_at; } AtPoints;

/* Parameters of the user's functions: whether they vary, and stored energies with them. */
typedef struct { int count, vary, energies_vary; } Parameters;

/* Rule for the rates: 0 mid-point, 1 Newmark. In statics a step has no rates and no inertia, and its `ratio` is
   the load factor at its end. Sub-steps, relative to a step. */
typedef struct {
  int rule, at_rest, keeps_previous, sub_steps; double level, beta, gamma, alpha_m; double fractions[SUB_STEPS];
  /* Rules of a user, of which the sub-steps take turns; where the tangent has all entries of a pair of nodes [pair][3][3]. */
  int rules; const int *rule_stored_at; Law **nodal_rule;
} Scheme;

/* Options of Newton's method. */
typedef struct {
  double tolerance, negligible, energy_floor, max_turn, longest_turn, large_turn; int max_iterations, may_overshoot;
} NewtonOptions;

/* Driven columns: those of prescribed degrees of freedom, so many, then motors. Degrees of freedom a and b between which their
   forces do work (-1: the ground), b the prescribed one; but for motors on slides. Degrees of freedom that Newmark's family leads
   by the rates of driven motions, which alone move them. */
typedef struct { int prescribed, led; const int *a, *b, *slides, *led_dof; } Motors;

/* How forces of joints pass through these from the nodes that follow to those that lead (-1: none), the former first; first
   displacements, then rotations. `joints` are all of the scene. */
typedef struct { int joints, count, force_count; const int *dof, *to, *of; const double *sign; } Passes;

/* Parts with energies of their own, if there are several: runs of degrees of freedom and of unknowns, and the part of each;
   for each part those whose energies together are its own. */
typedef struct {
  int count, dof_runs, column_runs; const int *dof_run_start, *dof_run_part, *column_run_start, *column_run_part, *inside_start, *inside;
} Parts;

/* Tables of a program; of the columns the free ones are the unknowns, driven ones follow. */
typedef struct {
  int dofs, cells, columns, free, driven, has_added; /* whether forms have added forces */
  Mesh mesh; Internal internal; Natural natural; Loads loads; Tangent tangent; Mass mass; Map map; Joints joints; Auxiliary auxiliary;
  Sliders sliders; Loops loops; Gears gears; System system; Border border; Direct direct; Coupled coupled; Geometric geometric;
  AtPoints at_points; Parameters parameters; Motors motors; Passes passes; Parts parts; Scheme scheme; NewtonOptions newton;
} Tables;
