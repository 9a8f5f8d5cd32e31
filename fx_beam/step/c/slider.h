/* A node that slides on a beam (coupling/dependent_columns.py). */

#pragma once

/* Largest numbers of nodes and of local degrees of freedom in a window, of which the last is the arc length, of products in the
   derivatives of its forces, and of elements in a step. */
enum { WINDOW_NODES = 16, LOCAL = 49, ARC = LOCAL - 1, PRODUCTS = 4, MOST_PARTS = 6 };

/* A part of weights of nodes: the coefficients of an element times these factors of 1, x, x^2 and x^3, which have these
   derivatives by the arc lengths of its ends. */
typedef struct { int element; double factor[4], begin_slopes[4], end_slopes[4]; } WeightPart;

/* Weights of the nodes of a window, their derivatives by the arc lengths at the start and at the end of a step, and the
   parts of which they are sums. */
typedef struct { double of[WINDOW_NODES], by[2][WINDOW_NODES]; int parts; WeightPart part[MOST_PARTS]; } Weight;

/* Parts of the relation of a step (slide_relation.h), by the names in coupling/dependent_columns.py; numbers at the start
   and at the end are next to each other. */
typedef struct {
  Weight at[2], along[2];     /* N, and what the virtual slide multiplies: N', or (DN/Ds) at mid-step */
  double share[2];            /* of both ends */
  double x[2][3][WINDOW_NODES], D[3][WINDOW_NODES], mean[WINDOW_NODES]; /* the nodes; means of N */
  double axis[3];             /* for a virtual slide of 1 */
  int exact, from, to;        /* whether forces are those at mid-step; the chord there */
  double Ds, z[2], w[2], turn[2][2], Dr[2], Dalpha; /* w = W rbar / |rbar|^2, and its derivatives */
  /* If the rotation is that of 2 tan(Dpsi/2): x_a; k(x_a - y) cos x_a; of Nbar_a times this the derivatives by x_a and
     by y, and the sum; for a virtual slide of 1 the virtual rotation, and its derivatives by q, y_c and y. */
  int turned; double half[WINDOW_NODES], per_mean[WINDOW_NODES], half_slopes[WINDOW_NODES], y_slopes[WINDOW_NODES], total;
  double along_turn, turn_slopes[3];
} Relation;

/* Derivatives of virtual_map^T F by the local degrees of freedom, for the force F of the node: those by the arc
   length and of the force along it; of the others the products of left and right parts, and entries of
   the diagonal. */
typedef struct {
  double arc_slopes[LOCAL], force_slopes[LOCAL], square, left[PRODUCTS][LOCAL], right[PRODUCTS][LOCAL], turn[LOCAL];
} Second;

/* Columns of the node, which border the reduced tangent (bordering_rows.h). */
typedef struct {
  int joint, column, path; /* number of the joint, column of the arc length, where its path begins among numbers of paths */
  int components, carried[3], node[3]; /* columns of the node, and its degrees of freedom */
  int carries; /* whether the next one needs the motion of all nodes with this one and those before */
  /* The path: degree, elements, those that a step may pass, and nodes of a window. */
  int degree, elements, most, width;
  double *ends, *coefficients; /* arc lengths (elements + 1); [element][3 degree + 1][4] */
  double *position, *angle;    /* of the nodes in the reference configuration */
  int *dofs;                   /* [node][3] */
  /* Entries of its columns: rows, values and signs, from entry_start[component] on. Entries of the beam's degrees of freedom
     [node][3]: columns, values and signs, from part_start on; storage indices of the diagonal of its rotations in the full
     tangent. */
  int *entry_start, *entry_row, *entry_value, *part_start, *part_column, *part_value; double *entry_sign, *part_sign;
  int *turn_stored_at;
  int bordering_row, products; /* first bordering row that is no column; number of products */
  /* Of a beam without mass that only sliding nodes may hold: columns of one of its nodes, and storage indices
     of their diagonals. */
  int anchors, anchor_column[3], anchor_at[3];
  /* In the present iteration: arc lengths and the slide between them, their elements, first node of the window, increment, T and
     Tv, force. */
  double s0, s1, slide; int element[2], first; double increment[3], T[3][LOCAL], virtual_map[3][LOCAL], force[3];
  Relation relation;
  Second second_slopes; /* derivatives of virtual_map^T F by the end of the step */
} Slider;
