/* Forces at points, by laws in UFL (point_laws.py). The steps in Python and in C call them here. */

#pragma once

#include "member_contact.h"

/* A force at nodes, or on the slide of a joint. */
typedef struct {
  Law *law;           /* forces, entries of their tangent, internal variables, what is remembered */
  Law *energy;        /* stored at the start */
  Law *loss;          /* lost in the step */
  Law *switches;      /* values that change their sign where it switches */
  Law *pull;          /* along a line between points */
  int size, entries, internal, iteration_memory, conditions, needs_line_search;
  int *dof;           /* [size] degrees of freedom; -1 for the ground */
  int slide, column;  /* joint of a slide and its column, or -1 */
  int joint;          /* to whose moment it belongs, or -1 */
  int load, load_turn; /* joint whose force limits it, or -1; rotation of the axis */
  double load_axis[2]; /* across which the force counts; zero for all of it */
  int line;           /* number of the line between points to which it belongs, or -1 */
  int nodes;          /* of a contact: on which the force on its point acts, the first ones */
  int first_internal, first_entry; /* among those of all forces */
  int *entry_row, *entry_column;   /* [entries] */
  /* Given: start, increment and rate [size], t, dt, internal variables, iteration memory, numbers of the law,
     values of parameters. */
  double *given, *numbers, *results;
  int parameters, *parameter; /* which ones of the scene it needs */
  double *parameter_values;
  /* Of a line over points, whose law is one of its length: its pieces, or 0; where the coordinates of each point begin, or
     -1; entries of the tangent of that law, and its numbers and parameters; the scheme's level. */
  int pieces, *moves, length_entries, others;
  double level;
  double *tangent_at; /* increment and results where the tangent is evaluated, if `needs_line_search` */
} PointForce;

/* Largest number of secants of a fixed point. */
enum { SECANTS = 8, FIXED_POINT_ROWS = 4 * SECANTS + 2 };

/* Numbers that depend on themselves (fixed_point.h). */
typedef struct {
  int size, trials; /* numbers; secants so far */
  double change;    /* the largest of the last trial */
  double round_off; /* size of the loads, whose rounding errors they have */
  double *memory;   /* [FIXED_POINT_ROWS][size] */
} FixedPoint;

/* Forces at nodes: those of contact, others, external ones; then those on slides. */
typedef struct {
  int contacts, external, nodal, all;
  int recorded;         /* points whose forces are recorded: of contacts, then slots of members */
  PointForce *of;
  double *probe;        /* room for results of one force, and for a correction */
  MemberContacts *members;
  FixedPoint followed;  /* forces of joints that limit friction */
} PointForces;


/* The values of all parameters of the scene. */
void fx_set_parameters(const PointForces *p, const double *values);
/* The start of a step, its length, and the time of its forces. Slides and their rates are those of all
   joints. */
void fx_begin_points(const PointForces *p, const double *q, const double *v, const double *slide,
                     const double *slide_rate, double t, double dt, const double *internal);
/* Forces at the increments D of nodes and z of columns. */
void fx_evaluate_points(const PointForces *p, int first, int end, const double *D, const double *z);
void fx_add_points(const PointForces *p, int first, int end, double factor, double *f);
void fx_add_point_tangents(const PointForces *p, const int *stored_at, double *K);
double fx_lost_at_points(const PointForces *p, const double *D, const double *z);
double fx_stored_at_points(const PointForces *p, const double *q, const double *slide, const double *internal);
void fx_find_switches(const PointForces *p, const double *q, const double *slide, double *out);
