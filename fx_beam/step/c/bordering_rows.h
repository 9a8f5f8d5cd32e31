/* Unknowns that border the factorised matrix A: what slides on beams (sliders.h). With their rows C and
   columns B, which have few entries,

       [A  B] [x]   [b]
       [C  D] [y] = [g],    (D - C A^-1 B) y = g - C A^-1 b,    A x = b - B y.

   A stays what it is without them: what slides changes no order of elimination. Of A^-1 B only the part is
   computed that C and B reach on the way of the elimination.

   Where many nodes slide, the border is as large as A. Then all are sparse rows with a pattern that changes with the elements on
   which the nodes are (changing_rows.h). A node's columns and the forces that hold it come first, each with its pivot in a row of
   the other, which is 1 until then: what is left couples its slide with the nodes of the beam. */

#pragma once

#include "band.h"
#include "chain.h"
#include "changing_rows.h"
#include "loops.h"

/* Lists a number, if there is room, with its row and column. */
static void list_entry(const System *system, const Work *w, int row, int column, double x) {
  BorderEntries *e = w->listed;
  int behind = system->unknowns + ON_BORDER, k = e->count++;
  if (!e->row) return;
  e->row[k] = row < 0 ? behind - row : row, e->column[k] = column < 0 ? behind - column : column, e->value[k] = x;
}

/* Adds a number among the sparse rows, or finds its place in their pattern. */
static void add_inside(const Tables *p, const Factors *factors, int i, int j, double x) {
  ChangingRows *c = factors->changing;
  int n = p->system.unknowns, row = i < 0 ? n + p->border.pivot[ON_BORDER - i] : i, column = j < 0 ? n + ON_BORDER - j : j;
  if (c->finds) add_pair(c, (ContactPair){.row = row, .column = column});
  else factors->rows->factors[c->pair[c->next++].at] += x;
}

/* Extends the part of a row that may differ from zero, from `low` to `high`, to a position. */
static void widen(double *row, int *low, int *high, int position) {
  if (*low > *high) *low = position, *high = position - 1;
  for (; *low > position;) row[--*low] = 0;
  for (; *high < position;) row[++*high] = 0;
}

/* Adds a number in a row and a column of the system, or of its transpose: unknowns, or ON_BORDER less the number of a bordering
   row. Nothing for -1, and nothing is added to A. */
INLINED void add_at(const Tables *p, const Work *w, int i, int j, double x) {
  int row = w->transposed ? j : i, column = w->transposed ? i : j;
  if (row == -1 || column == -1) return;
  if (w->listed) return list_entry(&p->system, w, row, column, x);
  if (!HAS(CHAIN | BAND) && p->border.inside) return add_inside(p, &w->factors, i, j, x);
  if (x == 0) return;
  if (row >= 0) {
    int at = w->factors.order[row];
    reach(&p->border, w, at);
    w->block[(long)at * p->border.block + ON_BORDER - column] += x;
  } else if (column >= 0) {
    int at = w->factors.order[column], *crossed = w->crossed + 2 * (ON_BORDER - row);
    double *border = w->border + (long)(ON_BORDER - row) * p->system.positions;
    reach(&p->border, w, at);
    widen(border, crossed, crossed + 1, at);
    border[at] += x;
  } else {
    w->corner[(ON_BORDER - row) * p->border.rows + ON_BORDER - column] += x;
  }
}

/* The derivatives of the forces F of sliding nodes, and their part on the diagonal of the full tangent. */
static void turn_beams(const Sliders *sliders, const Work *w) {
  for (int i = 0; i < sliders->count; ++i) {
    Slider *a = w->slider + i;
    int turns = 2 * a->width, node = a->first;
    find_second(a, &a->second_slopes);
    for (; a->components == 3 && turns < 3 * a->width; ++turns, ++node)
      w->tangent[a->turn_stored_at[node]] += a->second_slopes.turn[turns];
  }
}

/* A node that slides: its columns c, the forces f that hold it on the beam, and the products of which the
   derivatives of Tv consist. */
static void bordering_slider(const Tables *p, const Work *w, Slider *a) {
  int n = a->width, m = a->components, force = ON_BORDER - a->bordering_row, product = force - m;
  int row_s = p->system.row_of[a->column], column_s = p->system.unknown_of[a->column];
  const Second *h = &a->second_slopes;
  for (int l = 0; l < m * n; ++l) {
    int dof = 3 * (a->first + l % n) + l / n;
    for (int e = a->part_start[dof]; e < a->part_start[dof + 1]; ++e) {
      int column = a->part_column[e];
      double T_slope = a->part_sign[e] * w->values[a->part_value[e]];
      double virtual_slope = a->part_sign[e] * w->virtual_map[a->part_value[e]];
      for (int c = 0; c < m; ++c) {
        add_at(p, w, force - c, p->system.unknown_of[column], -T_slope * a->T[c][l]);
        add_at(p, w, p->system.row_of[column], force - c, -virtual_slope * a->virtual_map[c][l]);
      }
      add_at(p, w, p->system.row_of[column], column_s, virtual_slope * h->arc_slopes[l]);
      add_at(p, w, row_s, p->system.unknown_of[column], T_slope * h->force_slopes[l]);
      for (int r = 0; r < a->products; ++r) {
        add_at(p, w, p->system.row_of[column], product - r, virtual_slope * h->left[r][l]);
        add_at(p, w, product - r, p->system.unknown_of[column], T_slope * h->right[r][l]);
      }
    }
  }
  for (int c = 0; c < m; ++c) {
    add_at(p, w, force - c, column_s, -a->T[c][ARC]);
    add_at(p, w, row_s, force - c, -a->virtual_map[c][ARC]);
    add_at(p, w, force - c, p->system.unknown_of[a->carried[c]], 1);
    add_at(p, w, p->system.row_of[a->carried[c]], force - c, 1);
  }
  add_at(p, w, row_s, column_s, h->square);
  for (int r = 0; r < a->products; ++r) add_at(p, w, product - r, product - r, -1);
}

/* A node of the beam is held in A, twice as stiff, and set free by bordering rows: otherwise A may be singular. */
static void hold_beams(const Sliders *sliders, const Work *w) {
  for (const Slider *a = w->slider; a < w->slider + sliders->count; ++a)
    for (int i = 0; i < a->anchors; ++i) w->tangent[a->anchor_at[i]] *= 2;
}

static void anchor_beam(const Tables *p, const Work *w, const Slider *a) {
  for (int i = 0; i < a->anchors; ++i) {
    int bordering_row = ON_BORDER - a->bordering_row - a->components - a->products - i, column = a->anchor_column[i];
    double k = w->tangent[a->anchor_at[i]] / 2;
    add_at(p, w, p->system.row_of[column], bordering_row, -k);
    add_at(p, w, bordering_row, p->system.unknown_of[column], 1);
    add_at(p, w, bordering_row, bordering_row, -1);
  }
}

HOT void add_bordering_rows(const Tables *p, const Work *w) {
  for (int i = 0; i < p->sliders.count; ++i)
    bordering_slider(p, w, w->slider + i), anchor_beam(p, w, w->slider + i);
  for (int k = 0; k < p->border.beside; ++k)
    add_at(p, w, p->system.row_of[p->border.beside_row[k]], p->system.unknown_of[p->border.beside_column[k]],
        w->tangent[p->border.beside_at[k]]);
}

/* Counts the entries of the last tangent's bordering rows and columns, and lists them if there is room. */
OF_STEPS void fx_list_border(Problem *problem, BorderEntries *to) {
  const Tables *p = problem->tables; Work *w = &problem->work;
  w->listed = to, to->count = 0;
  add_bordering_rows(p, w);
  w->listed = 0;
}

/* The bordering rows for the tangent of a step. */
static void fill_bordering_rows(const Tables *p, const Work *w) {
  if (p->border.inside) return;
  memset(w->reached, 0, p->system.positions * sizeof *w->reached);
  for (int i = 0; i < p->border.rows; ++i) w->crossed[2 * i] = p->system.positions, w->crossed[2 * i + 1] = -1;
  memset(w->corner, 0, (long)p->border.rows * p->border.rows * sizeof(double));
  add_bordering_rows(p, w);
}

/* Finds the pattern for the elements on which nodes slide, if it is that of others. */
static void change_windows(const Tables *p, const Work *w) {
  ChangingRows *c = w->factors.changing;
  int same = 1;
  for (int i = 0; i < p->sliders.count; ++i)
    same &= c->window[i] == w->slider[i].first, c->window[i] = w->slider[i].first;
  if (same) return;
  begin_elimination(&c->elimination);
  c->pairs = 0, c->finds = 1;
  add_bordering_rows(p, w);
  c->finds = 0;
  settle_rows(&w->factors, c);
}

/* The block of n times four columns from its right sides and sparse factors. */
INLINED void solve_sparse_columns(const Border *border, const Work *w, int n) {
  const SparseRows *rows = w->factors.rows;
  const int *first = rows->first;
  const double *A = rows->factors;
  for (int g = 0; g < rows->groups; ++g) {
    int at = first[g], size = first[g + 1] - at, any = 0;
    for (int x = 0; x < size; ++x) any |= w->reached[at + x];
    for (int s = rows->source_start[g]; !any && s < stored_sources(rows, g); ++s)
      any = w->reached[first[rows->source[s]]];
    for (int x = 0; any && x < size; ++x) {
      const double *row = A + rows->start[at + x];
      reach(border, w, at + x);
      for (int s = rows->source_start[g]; s < stored_sources(rows, g); ++s)
        for (int k = first[rows->source[s]]; k < first[rows->source[s] + 1]; ++k, ++row)
          if (w->reached[k] && *row != 0) subtract_in_block(w, n, at + x, *row, k);
      for (int z = 0; z < x; ++z) subtract_in_block(w, n, at + x, row[z], at + z);
      row += size;
      for (int k = rows->run_start[g]; rows->symmetric && k < rows->run_start[g + 1]; row += rows->run_length[k++])
        for (int j = 0; j < rows->run_length[k]; ++j) {
          if (row[j] == 0) continue;
          reach(border, w, rows->run_column[k] + j);
          subtract_in_block(w, n, rows->run_column[k] + j, row[j] * A[rows->diagonal[at + x]], at + x);
        }
    }
  }
  for (int g = rows->groups - 1; g >= 0; --g) {
    int at = first[g], size = first[g + 1] - at;
    for (int x = size - 1; w->reached[at] && x >= 0; --x) {
      const double *upper = A + rows->diagonal[at + x], *right = upper + size - x;
      Four *row = (Four *)w->block + (long)(at + x) * n;
      for (int z = x + 1; z < size; ++z) subtract_in_block(w, n, at + x, upper[z - x], at + z);
      for (int k = rows->run_start[g]; k < rows->run_start[g + 1]; right += rows->run_length[k++])
        for (int j = 0; j < rows->run_length[k]; ++j)
          if (right[j] != 0) subtract_in_block(w, n, at + x, right[j], rows->run_column[k] + j);
      for (int j = 0; j < n; ++j) row[j] *= upper[0];
    }
  }
}

/* Factors of D - C A^-1 B, from D. Equations are divided by their largest entries, and forces and moments counted in
   stiffnesses of their own: otherwise the units would choose the pivots. */
HOT void factorise_corner(const Tables *p, const Work *w) {
  int m = p->border.rows;
  double stiff[2] = {0}, *D = w->corner, *unit = w->corner_units, *per_most = unit + m;
  for (int i = 0; i < m; ++i)
    for (long k = w->crossed[2 * i]; k <= w->crossed[2 * i + 1]; ++k) {
      double c = w->border[i * p->system.positions + k];
      for (int j = 0; c != 0 && j < m; ++j) D[i * m + j] -= c * w->block[k * p->border.block + j];
    }
  for (int i = 0; i < m; ++i) unit[i] = 1;
  for (const Slider *a = w->slider; a < w->slider + p->sliders.count; ++a)
    for (int c = 0, j = a->bordering_row; c < a->components; ++c, ++j) stiff[c == 2] = fmax(stiff[c == 2], fabs(D[j * m + j]));
  for (int k = 0; k < 2; ++k) stiff[k] = stiff[k] > 0 ? 1 / stiff[k] : 1;
  for (const Slider *a = w->slider; a < w->slider + p->sliders.count; ++a)
    for (int c = 0; c < a->components + a->products; ++c) unit[a->bordering_row + c] = stiff[c == 2 && a->components == 3];
  for (int j = p->border.carriers; j < m; ++j)
    unit[j] = stiff[p->loops.force[p->loops.carried_closure[j - p->border.carriers]] % 3 == 2];
  for (int i = 0; i < m; ++i) {
    double most = 0;
    for (int j = 0; j < m; ++j) most = fmax(most, fabs(D[i * m + j] *= unit[j]));
    per_most[i] = most > 0 ? 1 / most : 1;
    for (int j = 0; j < m; ++j) D[i * m + j] *= per_most[i];
  }
  BandRows rows = band_rows(m, m, m);
  factorise_band(&rows, D, w->corner_exchanged);
}

/* Unknowns y of the bordering rows from their right sides g, in the place of these, and A^-1 b in x, of one or GROUP_SIZE
   right sides; the block has A^-1 B. x becomes the solution, as far as the bordering rows reach. */
INLINED void solve_bordering_rows(const Tables *p, const Work *w, int sides, double *g, double *x) {
  int m = p->border.rows;
  for (int j = 0; j < m; ++j)
    for (long i = w->crossed[2 * j]; i <= w->crossed[2 * j + 1]; ++i)
      for (int k = 0; k < sides; ++k) g[j * sides + k] -= w->border[j * p->system.positions + i] * x[i * sides + k];
  for (int i = 0; i < m * sides; ++i) g[i] *= w->corner_units[m + i / sides];
  BandRows rows = band_rows(m, m, m);
  solve_band_rows(sides, &rows, w->corner, w->corner_exchanged, g);
  for (int i = 0; i < m * sides; ++i) g[i] *= w->corner_units[i / sides];
  for (long i = 0; i < p->system.positions; ++i)
    for (int j = 0; w->reached[i] && j < m; ++j)
      for (int k = 0; k < sides; ++k) x[i * sides + k] -= w->block[i * p->border.block + j] * g[j * sides + k];
}
