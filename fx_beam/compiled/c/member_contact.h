/* Contact of nodes with members (mechanics/member_gap.py). */

#pragma once

/* A function as FFCx compiles it: values, and what is given in the place of the constants. */
typedef void Law(double *, const double *, const double *, const double *, const int *,
                 const unsigned char *, void *);

/* Entries of a touch: x and y of the point and of four nodes; coordinates of its law, and room for what it
   is given and finds. */
enum { TOUCH_DOFS = 10, TOUCH_SUMS = 6, TOUCH_GIVEN = 36, TOUCH_RESULTS = 48 };

/* Points, which are nodes, against a member. */
typedef struct {
  Law *law;
  struct { Law *energy; };
  struct { Law *loss; };
  int remembered, entries, *entry_row, *entry_column; /* of its tangent */
  int points, *point_dof;   /* [points][2] */
  double *point_position;   /* [points][2] in the reference */
  int *point_slot;          /* where the force on a point is recorded, or -1 */
  int nodes, *node_dof;     /* of the member, along it */
  double *node_position;
  int *node_slot;
  int numbers;              /* of each point */
  double *number;           /* [points][numbers]: the radii, then those of the law */
  /* Of a member and itself: places of its nodes along it, and how far apart they must be. */
  double apart, *arc;
} MemberContact;

/* A point that is near a member. */
typedef struct {
  int contact, point, piece, dof[TOUCH_DOFS];
  int begins, ends, touching; /* whether the pieces reach the ends of the member; whether there is a force */
  int left;                   /* whether the nearest point has left the two pieces */
  double start[5][2];         /* at the start of the step: the point, then arms to the four nodes */
  double place, weights[4];   /* the nearest point at the start */
  double sums[3][4];          /* weights of the three sums of arms */
  double given[TOUCH_GIVEN], results[TOUCH_RESULTS], tangent[TOUCH_DOFS * TOUCH_DOFS];
} Touch;

typedef struct {
  int contacts, conditions;
  MemberContact *of;
  int dofs, moving, *moves; /* all degrees of freedom; those of all points and members, as pairs */
  double margin, moved, step; /* of the last search; largest motions since then, and in the last step */
  long searches;            /* their number: when it changes, so do the touches */
  int wide;                 /* whether the next search must have a larger margin */
  struct { double *searched_at, *v, *product; }; /* [dofs]: configuration of the last search, room */
  struct { Touch *touch; }; /* [room] */
  int touches, room;
  /* The cells of a search: where the nodes in each begin, and the nodes. */
  struct { int *cell_start, *cell_node, *cell_of; };
  long cells_room, nodes_room;
} MemberContacts;

/* What is wrong at the end of a step: nothing, points have moved further than was searched, or a point has
   passed through a member. */
enum { MEMBERS_FINE, MEMBERS_MOVED, MEMBERS_PASSED };

void fx_free_members(MemberContacts *m);
void fx_begin_members(MemberContacts *m, const double *q, const double *v, double t, double dt);
void fx_evaluate_members(MemberContacts *m, const double *D);
void fx_add_members(const MemberContacts *m, double *f);
/* Adds the product of their tangent and x. */
void fx_times_members(const MemberContacts *m, const double *x, double *out);
int fx_check_members(MemberContacts *m, const double *D);
double fx_lost_at_members(MemberContacts *m, const double *D);
double fx_stored_at_members(MemberContacts *m, const double *q);
/* Of each point the least gap, at most 1. */
void fx_member_gaps(MemberContacts *m, const double *q, double *out);
/* Adds the forces on points to those that are recorded, of each slot x and y. */
void fx_record_members(const MemberContacts *m, double factor, double *out);
