/* Contact of nodes with members (laws/gaps.py). */

#pragma once

/* A function as FFCx compiles it: values, and what is given in the place of the constants. */
typedef void Law(double *, const double *, const double *, const double *, const int *, const unsigned char *, void *);

/* Entries of a contact point: x and y of the point and of four nodes, with friction then their rotations. The law has sums of
   arms, with friction then the rotation of the point and sums of rotations; room for what it is given and finds. */
enum { POSITIONS = 10, ENTRIES = 15, SUMS = 4, TURN_SUMS = 1 + SUMS, COORDINATES = 2 * SUMS + TURN_SUMS };
enum { CONTACT_POINT_GIVEN = 64, CONTACT_POINT_RESULTS = 128 };
/* Memory of friction: at most so many contact points of a point; of each its place on the member, counted from 1,
   and the two internal variables of its law. */
enum { SLOTS = 2, SLOT_WIDTH = 3 };

/* Points, which are nodes, against a member. */
typedef struct {
  Law *law; Law *energy, *loss;
  int coordinates, dofs, iteration_memory; /* coordinates of its law; entries of its contact points */
  int entries, *entry_row, *entry_column; /* of its tangent */
  int internal, first_slot; /* internal variables; its first slot of memory, in which a point has SLOTS */
  int points, *point_dof;   /* [points][2] */
  int first_point;          /* number of the first of them among those of all contacts */
  int *point_slot;          /* where the force on a point is recorded, or -1 */
  int nodes, *node_dof;     /* of the member, along it; of a closed one some beside its seam are there twice */
  int turn, first_node, end_node; /* pieces once around a closed one, else 0; the nodes that are there once */
  int *node_slot;
  int numbers;              /* of each point */
  double *number;           /* [points][numbers]: the radii, then those of the law */
  double *arc;              /* of a member and itself: places of its nodes along it */
  /* For derivatives: forces and internal variables by start, increments, internal variables and numbers; the first
     of its numbers among those of all contacts. */
  Law *slopes; int first_number;
  double apart;             /* of a member and itself: how far apart they must be */
} MemberContact;

/* A point of two successive pieces: weights of four nodes and their slopes by the place, 1 / the second derivative of half the
   squared distance (0 at an end of the member), the distance; at which of their ends it has left them, -1 or 1. */
typedef struct { double place, weights[4], slopes[4], per_rate, distance; int left; } NearPoint;

/* A point that is near a member. */
typedef struct {
  int contact, point, piece, dof[ENTRIES];
  int begins, ends, closed; /* whether the pieces reach the ends of the member; whether there is a force */
  int slot;                   /* of its friction, or -1 */
  int left, leans;            /* whether the nearest point has left the two pieces; to which side they should go */
  int passed;                 /* whether the point is on the other side of the member at the end */
  int counted;                /* whether the pattern of the tangent has it */
  double start[5][2];         /* at the start of the step: the point, then arms to the four nodes */
  NearPoint first;            /* the nearest point at the start */
  double end, motion;         /* its place at the end; how far it moves along the member in a step */
  double sums[5][SUMS], turns[5][TURN_SUMS]; /* weights of the sums at the point and at the nodes */
  double slopes[5];           /* of the increments with which couples do work, by those of the rotations */
  double given[CONTACT_POINT_GIVEN], results[CONTACT_POINT_RESULTS], tangent[ENTRIES * ENTRIES];
} ContactPoint;

/* A place on a piece of a member that is near a point, and their distance. */
typedef struct { int contact, point, piece; double place, distance; } NearPlace;

typedef struct {
  int contacts, conditions; MemberContact *of;
  int turning;              /* whether couples do work on 2 tan(Dpsi/2) */
  int dofs, moving, *moves; /* all degrees of freedom; those of all points and members, as pairs */
  double *reference;        /* [dofs] positions in the reference configuration */
  double margin, moved, step; /* of the last search, below 0 without one; largest motions since then, and in the last step */
  long searches;            /* their number: when it changes, so do the contact points */
  int slots, first_internal; /* of friction; where they begin among all internal variables */
  int *has_slot;            /* [slots] whether a contact point has it */
  /* [dofs]: positions of the last search and of the start of the step, rates there, room; its slots */
  double *searched_at, *start, *v, *product, *memory; ContactPoint *contact_point;
  int contact_points, near_places, near_room;
  NearPlace *near; /* [near_room] places of the last search */
} MemberContacts;

/* The stored energy; if there are functions `by`, of each contact that of the derivatives of its energy by all that its law is
   given, also the derivatives by degrees of freedom, internal variables and all numbers. */
typedef struct { Law **by; double sum, *q_slopes, *internal_slopes, *number_slopes; } Energy;

/* Faults at the end of a step: none, points have moved further than was expected, a point has passed through
   a member, or has moved further along one than its contact point can. */
enum { MEMBERS_FINE, MEMBERS_MOVED, MEMBERS_PASSED, MEMBERS_SLID };

void fx_free_members(MemberContacts *m);
void fx_evaluate_members(MemberContacts *m, const double *D);
void fx_add_members(const MemberContacts *m, double *f);
int fx_check_members(MemberContacts *m, const double *D);
double fx_stored_at_members(MemberContacts *m, Energy *to, const double *q, const double *internal);
