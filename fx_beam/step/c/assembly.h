/* Assembly of vectors, matrices and scalars from element tensors (beam_forms.py). */

#pragma once

#include "chain.h"
#include "rates.h"
#include "threads.h"

/* A number of each of LANES elements, stored at once: the functions of elements load them at once, and would
   wait for numbers that are stored one by one. */
typedef double Lanes __attribute__((vector_size(8 * LANES), aligned(8)));

INLINED Lanes lanes_of(const double *x, const int *at) {
  return (Lanes){x[at[0]], x[at[1]], x[at[2]], x[at[3]], x[at[4]], x[at[5]], x[at[6]], x[at[7]]};
}

INLINED void put_lanes(Four a, Four b, double *to) { *(Four *)to = a, *(Four *)(to + 4) = b; }

/* Displacements of the nodes of LANES elements, then rotations. */
INLINED void pack_nodes(int nodes, const double *x, const int *at, double *to) {
  for (int node = 0; node < nodes; ++node, at += LANES) {
    Four a[4], b[4];
    transpose(load(x + at[0]), load(x + at[1]), load(x + at[2]), load(x + at[3]), a);
    transpose(load(x + at[4]), load(x + at[5]), load(x + at[6]), load(x + at[7]), b);
    put_lanes(a[0], b[0], to + 2 * node * LANES), put_lanes(a[1], b[1], to + (2 * node + 1) * LANES);
    put_lanes(a[2], b[2], to + (2 * nodes + node) * LANES);
  }
}

/* The same of elements in a row, from that of the first node on. */
INLINED void pack_row(const double *x, double *to) {
  Four a[4], b[4], last = load(x + 24);
  transpose(load(x), load(x + 3), load(x + 6), load(x + 9), a);
  transpose(load(x + 12), load(x + 15), load(x + 18), load(x + 21), b);
  for (int c = 0; c < 3; ++c) {
    double *first = to + (c < 2 ? c : 4) * LANES, *second = to + (c < 2 ? 2 + c : 5) * LANES;
    put_lanes(a[c], b[c], first), put_lanes(PICK(a[c], b[c], 1, 2, 3, 4), PICK(b[c], (Four){last[c]}, 1, 2, 3, 4), second);
  }
}

/* Each block of LANES elements of a form. */
#define EACH_BLOCK(elements, block, form)                                                                    \
  for (const Cells *elements = (form)->cells; elements < (form)->cells + (form)->integrals; ++elements)      \
    for (long block = 0; block * LANES < elements->of->cells; ++block)

/* The coefficients of a block of elements, [coefficient][lane]. */
HOT void pack(const Tables *p, const Work *w, const FormTables *form, const Cells *cells, long block, double *coefficients) {
  const double *data = cells->data + (long)cells->data_at[block] * form->data_width * LANES;
  for (int k = 0; k < form->data_width; ++k, data += LANES)
    *(Lanes *)(coefficients + form->data_column[k] * LANES) = *(const Lanes *)data;
  for (int m = 0; m < form->moving; ++m) {
    int kind = form->kind[m], nodes = p->mesh.cell_dofs / 3;
    int entries = kind == INTERNAL ? p->internal.per_cell : p->natural.per_cell;
    double *to = coefficients + form->offset[m] * LANES;
    const int *at = (kind == INTERNAL ? cells->of->internal : cells->of->natural) + block * entries * LANES;
    if (kind < INTERNAL && cells->of->in_row[block] >= 0) pack_row(w->fields[kind] + cells->of->in_row[block], to);
    else if (kind < INTERNAL) pack_nodes(nodes, w->fields[kind], cells->of->dofs + block * nodes * LANES, to);
    else
      for (int j = 0; j < entries * LANES; j += LANES) *(Lanes *)(to + j) = lanes_of(w->fields[kind], at + j);
  }
}

/* Length of a sub-step relative to the step before, at most 1; 0 without one. */
static double ratio_of_lengths(const State *state, double dt) {
  return state->length > 0 ? fmin(1, dt / state->length) : 0;
}

/* Apart from what each step passes, of which the compiler would make a loop with vectors. */
static __attribute__((noinline)) void set_parameters(const Numbers *s, const Form *form) {
  const FormTables *t = form->tables;
  for (int i = 0; i < t->parameters; ++i) form->constants[t->parameters_at + i] = s->parameters[t->parameter[i]];
}

/* Sets the time and all else that elements have in common. */
static void begin_form(const Numbers *s, const Work *w, const Form *form, double t) {
  if (!form->integrals) return;
  if (form->tables->time_at >= 0) form->constants[form->tables->time_at] = t;
  if (form->tables->dt_at >= 0) form->constants[form->tables->dt_at] = w->dt;
  if (form->tables->memory_at >= 0) form->constants[form->tables->memory_at] = w->state.ratio;
  if (form->tables->parameters) set_parameters(s, form);
}

/* Begins the forms of forces of elements, at the level of a sub-step. */
static void begin_elements(const Scheme *scheme, const Numbers *s, const Work *w) {
  double t = w->state.t + scheme->level * w->dt;
  begin_form(s, w, &s->forms.internal_forces, t);
  begin_form(s, w, &s->forms.drag, t);
  begin_form(s, w, &s->forms.added, t);
}

/* Adds the entries of an element tensor, for LANES elements. */
INLINED void add(int entries, const int *to, const double *tensors, double *out) {
  for (int j = 0; j < entries * LANES; j += LANES)
#pragma GCC unroll 8
    for (int l = 0; l < LANES; ++l) out[to[j + l]] += tensors[j + l];
}

/* Adds forces on nodes of LANES elements, two entries at once. */
INLINED void add_forces(int nodes, const int *to, const double *tensors, double *out) {
  for (int node = 0; node < nodes; ++node)
    for (int half = 0; half < LANES; half += 4, to += 4) {
      const double *x = tensors + 2 * node * LANES + half, *turn = tensors + (2 * nodes + node) * LANES + half;
      Four even = PICK(load(x), load(x + LANES), 0, 4, 2, 6), odd = PICK(load(x), load(x + LANES), 1, 5, 3, 7);
      *(Two *)(out + to[0]) += (Two){even[0], even[1]}, *(Two *)(out + to[1]) += (Two){odd[0], odd[1]};
      *(Two *)(out + to[2]) += (Two){even[2], even[3]}, *(Two *)(out + to[3]) += (Two){odd[2], odd[3]};
#pragma GCC unroll 4
      for (int l = 0; l < 4; ++l) out[to[l] + 2] += turn[l];
    }
}

/* Entries of the second nodes of four elements in a row, from `half` on, and of the first nodes of the elements behind them in the
   same block: where two elements meet, both at once. */
INLINED Four where_two_meet(const double *second, const double *first, int half) {
  return load(second + half) + PICK(load(first + half), half ? (Four){0} : load(first + 4), 1, 2, 3, 4);
}

/* Adds forces on nodes of elements in a row, from those on the first node on. */
INLINED void add_row_forces(const double *tensors, double *out) {
  for (int c = 0; c < 3; ++c) out[c] += tensors[(c < 2 ? c : 4) * LANES];
  for (int half = 0; half < LANES; half += 4, out += 12) {
    Four sums[3], nodes[4];
    for (int c = 0; c < 3; ++c)
      sums[c] = where_two_meet(tensors + (c < 2 ? 2 + c : 5) * LANES, tensors + (c < 2 ? c : 4) * LANES, half);
    transpose(sums[0], sums[1], sums[2], (Four){0}, nodes);
    *(Four *)(out + 3) += PICK(nodes[0], nodes[1], 0, 1, 2, 4), *(Four *)(out + 7) += PICK(nodes[1], nodes[2], 1, 2, 4, 5);
    *(Four *)(out + 11) += PICK(nodes[2], nodes[3], 2, 4, 5, 6);
  }
}

/* Adds the element tangents of a block to a chain. Three entries of a node are added at once, with a zero
   for the free place behind them. */
INLINED void add_to_chain(int n, const Integral *integral, long block, const double *tensors, double *K) {
  const int nodes = n / 3, *run = integral->run + block * nodes * nodes * LANES;
  for (int pair = 0; pair < nodes * nodes; ++pair)
    for (int half = 0; half < LANES; half += 4, run += 4)
      for (int c = 0; c < 3; ++c) { /* rows of displacements and of the rotation */
        int node = pair / nodes, other = pair % nodes;
        const double *row = tensors + (c < 2 ? 2 * node + c : 2 * nodes + node) * n * LANES + half;
        const double *x = row + 2 * other * LANES, *turn = row + (2 * nodes + other) * LANES;
        Four rows[4];
        transpose(load(x), load(x + LANES), load(turn), (Four){0}, rows);
#pragma GCC unroll 4
        for (int l = 0; l < 4; ++l) *(Four *)(K + run[l] + c * ROW) += rows[l];
      }
  for (int k = integral->single_start[block]; k < integral->single_start[block + 1]; ++k)
    K[integral->single_to[k]] += tensors[integral->single_from[k]];
}

/* Sets three entries in a row of each of four groups, `step` apart, with masses in number c. */
INLINED void set_rows(Four x, Four y, Four turn, int c, Four masses, long step, double *row) {
  Four columns[] = {x, y, turn}, rows[4];
  columns[c] += masses, transpose(columns[0], columns[1], columns[2], (Four){0}, rows);
  for (int l = 0; l < 4; ++l) *(Four *)(row + l * step) = rows[l];
}

/* Sets the rows of a chain for a block of elements in a row, with masses times `steep` and slopes; what is the first node's own is
   added. Groups follow each other upwards or downwards. */
INLINED void set_in_chain(const Numbers *s, const Work *w, const Integral *integral, long block, double steep,
                          const double *tensors, double *K) {
  const int *run = integral->run + (block * 4 + 3) * LANES; /* of second nodes alone */
  const double *mass = s->mass + 3 * integral->mass_pair[block], *slope = w->slope + integral->in_row[block];
  const long step = run[1] - run[0], next = step > 0 ? AFTER - DIAGONAL : BEFORE - DIAGONAL;
  const int first[] = {0, LANES, 4 * LANES}, second[] = {2 * LANES, 3 * LANES, 5 * LANES};
  K += run[0];
  for (int c = 0; c < 3; ++c)
    for (int j = 0; j < 3; ++j) K[c * ROW + j - step] += tensors[6 * first[c] + first[j]];
  for (int half = 0; half < LANES; half += 4, mass += 36, slope += 12, K += 4 * step) {
    Four masses[3][4], pairs[4]; /* between both nodes, in rows of first and second ones, and of second nodes */
    for (int k = 0; k < 3; ++k) {
      for (int l = 0; l < 4; ++l) pairs[l] = load(mass + 9 * l + 3 * k) * (steep * load(slope + 3 * l + 3 * (k != 1)));
      transpose(pairs[0], pairs[1], pairs[2], pairs[3], masses[k]);
    }
#pragma GCC unroll 3
    for (int c = 0; c < 3; ++c) {
      const double *a = tensors + 6 * first[c], *b = tensors + 6 * second[c], *ab = a + half, *ba = b + half; double *row = K + c * ROW;
      set_rows(load(ab + second[0]), load(ab + second[1]), load(ab + second[2]), c, masses[0][c], step, row - step + next);
      set_rows(load(ba + first[0]), load(ba + first[1]), load(ba + first[2]), c, masses[1][c], step, row - next);
      set_rows(where_two_meet(b + second[0], a + first[0], half), where_two_meet(b + second[1], a + first[1], half),
               where_two_meet(b + second[2], a + first[2], half), c, masses[2][c], step, row);
    }
  }
}

static void evaluate(const Tables *p, const Work *w, const Form *form, const Cells *cells, long block, double *tensors) {
  double coefficients[(form->tables->width + 1) * LANES] __attribute__((aligned(64)));
  pack(p, w, form->tables, cells, block, coefficients);
  cells->of->batch(tensors, coefficients, form->constants, cells->coordinates + block * p->mesh.cell_coordinates * LANES);
}

/* Adds the tangents of a block of elements with n degrees of freedom to matrix entries. */
INLINED void add_tangents(int n, const Integral *integral, long block, const double *tensors, double *K) {
  if (HAS(CHAIN) && integral->run) add_to_chain(n, integral, block, tensors, K);
  else add(n * n, integral->stored_at + block * n * n * LANES, tensors, K);
}

/* Adds forces of some blocks of elements with n degrees of freedom to f and, unless K is 0, their tangent to matrix entries. */
INLINED void assemble_elements(const Tables *p, const Numbers *s, const Work *w, int n, const Form *form, const Cells *cells,
                               long first, long last, double *K) {
  double A[(12 + 12 * 12) * LANES], steep = steepness(&p->scheme, &s->frame, &w->state, w->dt);
  for (long block = first; block < last && block * LANES < cells->of->cells; ++block) {
    evaluate(p, w, form, cells, block, A);
    if (n == 6 && cells->of->in_row[block] >= 0) add_row_forces(A, w->f + cells->of->in_row[block]);
    else add_forces(n / 3, cells->of->to + block * n / 3 * LANES, A, w->f);
    if (K && HAS(CHAIN) && n == 6 && cells->of->mass_pair && cells->of->mass_pair[block] >= 0)
      set_in_chain(s, w, cells->of, block, steep, A + n * LANES, K);
    else if (K) add_tangents(n, cells->of, block, A + n * LANES, K);
  }
}

HOT void assemble_blocks(const Tables *p, const Numbers *s, const Work *w, const Form *form, const Cells *cells, long first,
                         long last, double *K) {
  if (p->mesh.cell_dofs == 6) assemble_elements(p, s, w, 6, form, cells, first, last, K); /* whose loops are unrolled */
  else assemble_elements(p, s, w, p->mesh.cell_dofs, form, cells, first, last, K);
}

/* Pieces of an integral that have no node in common. */
typedef struct {
  const Tables *p; const Numbers *s; const Work *w; const Form *form; const Cells *cells; const int *piece; double *K;
} Assembly;

static void assemble_piece(const void *task, int part, int thread) {
  const Assembly *t = task;
  long first = (long)PIECE * t->piece[part];
  assemble_blocks(t->p, t->s, t->w, t->form, t->cells, first, first + PIECE, t->K);
}

static void assemble_forces(const Tables *p, const Numbers *s, const Work *w, const Form *form, double *K) {
  for (const Cells *cells = form->cells; cells < form->cells + form->integrals; ++cells) {
    const Integral *integral = cells->of;
    if (!integral->colours) assemble_blocks(p, s, w, form, cells, 0, integral->cells, K);
    for (int k = 0; k < integral->colours; ++k) {
      Assembly task = {p, s, w, form, cells, integral->piece + integral->colour_start[k], K};
      share(p->mesh.threads, integral->colour_start[k + 1] - integral->colour_start[k], assemble_piece, &task);
    }
  }
}

/* An energy of the step, or another sum over elements; zero without a form for it. */
static double sum_over_elements(const Tables *p, const Numbers *s, const Work *w, const Form *form) {
  double sum = 0, A[LANES];
  if (!form->integrals) return 0;
  begin_form(s, w, form, w->state.t);
  EACH_BLOCK(cells, block, form) {
    evaluate(p, w, form, cells, block, A);
    for (int l = 0; l < LANES && block * LANES + l < cells->of->cells; ++l) sum += A[l];
  }
  return sum;
}

/* The internal variables at the end of the step. */
static void evolve(const Tables *p, const Numbers *s, const Work *w) {
  const Form *form = &s->forms.evolution;
  int n = p->internal.per_cell;
  double A[n * LANES];
  begin_form(s, w, form, w->state.t + p->scheme.level * w->dt);
  EACH_BLOCK(cells, block, form) {
    evaluate(p, w, form, cells, block, A);
    for (int l = 0; l < LANES && block * LANES + l < cells->of->cells; ++l)
      for (int k = 0; k < n; ++k)
        w->state.internal[cells->of->internal[(block * n + k) * LANES + l]] += p->internal.per_weight[k] * A[k * LANES + l];
  }
}
