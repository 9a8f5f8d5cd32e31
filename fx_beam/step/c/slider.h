/* A node that slides on a beam, for the loop and for Python (coupling/sliding.py). */

#pragma once

/* Largest numbers of nodes and of local degrees of freedom in a window, and of products in the derivatives
   of its forces. */
enum { WINDOW_NODES = 16, LOCAL = 49, PRODUCTS = 4 };

/* Derivatives of virtual_map^T F by the local degrees of freedom, for the force F of the node: those by the arc
   length and of the force along it; of the others the products of left and right parts, and entries of
   the diagonal. */
typedef struct {
  double by_s[LOCAL], of_s[LOCAL], square, left[PRODUCTS][LOCAL], right[PRODUCTS][LOCAL], turn[LOCAL];
} Second;

/* Its columns border the reduced tangent (borders.h). */
typedef struct {
  int joint, column;    /* number of the joint, and column of the arc length */
  int components, carried[3], node[3]; /* columns of the node, and its degrees of freedom */
  /* The path: degree, elements, those of a window, those that a step may pass, and nodes of a window. */
  int degree, elements, window, most, width;
  double *ends, *coefficients; /* arc lengths (elements + 1); [element][3 degree + 1][4] */
  double *position, *angle;    /* of the nodes in the reference configuration */
  /* Level of the step at which forces are evaluated; whether the virtual rotation is that of tan(Dpsi/2). */
  double level;
  int by_tangent;
  int *dofs;                   /* [node][3] */
  /* Entries of its columns: rows, values and signs, from entry_start[component] on. */
  int *entry_start, *entry_row, *entry_value;
  double *entry_sign;
  /* Entries of the beam's degrees of freedom [node][3]: columns, values and signs, from part_start on;
     storage indices of the diagonal of its rotations in the full tangent. */
  int *part_start, *part_column, *part_value, *turn_stored_at;
  double *part_sign;
  int border, products; /* first border that is no column; number of products */
  /* Of a beam without mass that only sliding nodes may hold: columns of one of its nodes, and storage indices
     of their diagonals. */
  int anchors, anchor_column[3], anchor_at[3];
  /* In the present iteration: arc lengths, first node of the window, increment, T and Tv, force. */
  double s0, s1;
  int first;
  double increment[3], T[3][LOCAL], virtual_map[3][LOCAL], force[3];
  Second of_force; /* derivatives of virtual_map^T F */
} Slider;
