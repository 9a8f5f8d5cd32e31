/* A scene as the loop takes it, and what the loop is asked to do. Read by problem.py as well. */

#pragma once

/* Elements that one call computes, and increments that are remembered. */
enum { LANES = 8, PAST = 4 };

/* Element tensors from coefficients, constants and coordinates; all but the constants for LANES
   elements, entry k of lane l at [k][l]. */
typedef void Batch(double *, const double *, const double *, const double *);

/* The elements of one integral, in blocks of LANES. The last block repeats the last element, and has
   the results of what is repeated added where nothing reads them: behind the last place, to one place
   a lane, so that no addition waits for another. */
typedef struct {
  Batch *batch;
  int cells;
  int *dofs;           /* [block][cell dof][lane] */
  int *to;             /* the same, as places of a vector */
  int *place;          /* [block][cell dof, cell dof][lane]: places in the tangent */
  double *coordinates; /* [block][coordinate][lane] */
  double *packed;      /* [block][coefficient][lane]; those that move are filled in */
} Integral;

/* A compiled form: one integral for each law. */
typedef struct {
  int integrals, width;
  Integral *of;
  int moving;          /* coefficients that move: 0 increment, 1 path, 2 start, 3 v, 4 a */
  int changing;        /* those that change from iteration to iteration come first */
  int *kind, *offset;
  double *constants;
  int time_at, dt_at;  /* their places among the constants, or -1 */
} Form;

/* A spring and damper on the slide of a joint, or on the angle between its nodes. */
typedef struct {
  int slide, column;   /* number of the joint and column, or -1 */
  int a[3], b[3];      /* degrees of freedom of the nodes; -1 for the ground */
  double axis[2], offset[2];
  double k, rest, c;
  double start, rate, force, lost, slope_a, slope_b; /* in the present step */
} Actuator;

typedef struct {
  int dofs, cell_dofs, cell_coordinates, columns, free, driven;
  int *turns, turning;  /* rotations */
  int *massless, massless_count;
  double *per_unit;     /* one over the size of a unit correction of each degree of freedom */

  Form residual, tangent, path_tangent, energy, backwards, added;
  int has_added;
  double *weight;       /* may be null */
  int loads, *load_start, *load_dof; /* forces of a unit of each load */
  double *load_force;

  /* The full tangent in compressed rows, of which `place` gives the values: entries of unknowns that
     nothing else follows stand among those of the reduced tangent, the others behind them. */
  int places;
  int *row_start, *column_of, *place;
  int reacting, *reacts; /* rows of the others: supports and joints */
  /* Entries of the mass matrix other than zero. */
  int *mass_start, *mass_column, *mass_place;
  double *mass;
  int turning_masses, *turning_column, *turning_place; /* those in columns of rotations */
  double *turning_mass;

  /* Coupling: entries of T and That, the first of which are ones; value 0 is the constant 1. */
  int entries, equal;
  int *entry_row, *entry_column, *entry_value;
  double *entry_sign;
  int joints, slides;
  double *offset, *axis, *joint_sign;
  int *guide, *slide_column, *slide_of; /* rotation (-1: ground), column (-1: none), its slide */
  int followers;
  int *follower, *through;

  /* Reduced tangent, in an order that leaves its factors small: in a band, or in sparse rows. */
  int *order;           /* place of each unknown */
  int band;             /* subdiagonals and superdiagonals; 0 for sparse rows */
  int *factor_start, *factor_column, *factor_diagonal;
  int plain, mixed, second;
  int *plain_to, *plain_from;
  int *mixed_to, *mixed_from, *mixed_hat, *mixed_value;
  double *mixed_sign;
  int *second_to, *second_joint, *second_kind;
  double *second_sign;

  /* Springs and dampers: columns on which they act, their part in the reduced tangent, and in the
     moments of the joints. */
  int actuators, pushes, third, twists;
  Actuator *actuator;
  int *push_column, *push_of;
  double *push_sign;
  int *third_to, *third_of, *third_side;
  double *third_sign;
  int *twist_joint, *twist_of;
  double *twist_sign;

  /* Follower forces: x, y and rotation of their nodes, and places of what they add to the tangent. */
  int thrusts, *thrust_dofs, *thrust_places;

  /* Rates: 0 mid-point, 1 Newmark. */
  int rule;
  double level, beta, gamma, alpha_m;

  /* Newton's method. */
  double tolerance, max_turn, longest_turn, large_turn, energy_floor, energy_tolerance, predictor_error;
  int max_iterations;

  /* Driven columns: prescribed degrees of freedom (-1: a motor), then motors. */
  int *driven_dof, *motor_a, *motor_b, *motor_slide;

  /* Joint forces: sums over the nodes that follow. */
  int scene_joints;
  int *sum_start, *sum_of;
  double *sum_sign;
  int *lever_joint_start, *lever_joint; /* bending joints whose carriers turn with joint j */
  double *lever_sign;
  double *position;     /* (nodes, 2) */
  int nodes, *node_dofs;

  /* State. */
  double t, work, dissipated;
  double *q, *v, *a, *slide, *driven_now, *held, *added_force;
  int steps_done;       /* since the start, 0 before the first */
  double past_dt;       /* length of the steps that are remembered for the next guess */
  int known, order_of_prediction; /* how many they are, and how many differences foretold the last one */
  double *past, *past_y;  /* [PAST] backward differences of increments and unknowns, from the 0th on */

  /* Work space and report. */
  double *scratch;
  int iterations, failure, by_round_off;
  int too_large;        /* parts that turn by more than large_turn per step */
  int inside_out;       /* parts that end with sections that face backwards */
  double out_t, *out_q; /* time and configuration of the first */
  double least_energy;  /* below this strain energy there can be none */
} Problem;

/* Histories, a row for every so many steps and for the last; a null pointer is not recorded. */
typedef struct {
  int every, first, last, rows; /* numbers of the first step of this call and of the last of all */
  int parts, part;              /* in which a step is taken, and how many of the first are done */
  double *before_q, *before_v, *before_a; /* where the last part of a step starts */
  double *q, *v, *a, *held, *slides, *joint_forces, *energies, *momenta;
} Record;

/* What is known ahead of each step; a stride of 0 repeats the first. */
typedef struct {
  double *loads;  /* [step][start, end][load] */
  double *driven; /* [step][driven column], at the end */
  double *thrust; /* [step][thrust][x, y], at the scheme's level */
  long load_stride, thrust_stride;
} Ahead;

int fx_run(Problem *p, int steps, double dt, const Ahead *ahead, Record *to);
long fx_scratch(const Problem *p);
double *fx_phases(void); /* seconds in all phases of phases.h, if they are measured */
