/* Rates that fit joints and supports (coupling/fitted_rates.py). */

#include "algebra.h"
#include "fitted_rates.h"
#include "processor.h"

/* Added to the scaled equations, which are singular where loops are in line; least pivot. Repetitions
   remove the effects of this and of small masses, until corrections are below round-off. */
static const double REGULAR = 1e-13, LEAST_SQUARE = 1e-14, ROUND_OFF = 1e-14;
enum { REPETITIONS = 20 };

/* Work space: entries of all equations, their coefficients of driven rates and forces on b; arms of rigid
   points; factors of the equations that remain; multipliers of all equations; impulses and corrections of
   the degrees of freedom in them. */
typedef struct {
  double *g, *given, *push, *arm, *carried, *left, *factors, *scale, *all;
  double *impulse, *x, *before, *image, *force;
} FitWork;

static long lay_out_fit(const RateFit *f, FitWork *w, double *at) {
  double *begin = at;
  long n = f->count, rows = f->remaining, used = f->used;
  w->g = allocate(&at, f->all_entries), w->given = allocate(&at, n), w->push = allocate(&at, 2 * n);
  w->arm = allocate(&at, 2 * f->points), w->carried = allocate(&at, f->raw + f->carries);
  w->left = allocate(&at, rows), w->factors = allocate(&at, rows * f->width), w->scale = allocate(&at, rows);
  w->all = allocate(&at, n), w->impulse = allocate(&at, used), w->x = allocate(&at, used);
  w->before = allocate(&at, used), w->image = allocate(&at, f->inner ? rows * used : 0);
  w->force = allocate(&at, f->size);
  return at - begin;
}

static void set_row(const FitWork *w, int row, double given, double x, double y) {
  w->given[row] = given, w->push[2 * row] = x, w->push[2 * row + 1] = y;
}

/* Arm and direction of the slide of a joint. */
static void find_arm(const RateFit *f, const double *q, int j, double *arm, double *along) {
  const int *a = f->arm_a + 3 * j, *b = f->arm_b + 3 * j;
  for (int i = 0; i < 2; ++i)
    arm[i] = f->has_arm[j] * (f->apart[2 * j + i] + at(q, b[i]) - at(q, a[i]));
  turn(at(q, a[2]), f->slide_axis[2 * j], f->slide_axis[2 * j + 1], along);
}

/* Equations of a node on a beam, with their entries from g on; returns their number. */
static int set_on_beam(const BeamRate *b, const double *q, const double *slide, int row, double *g,
                       const FitWork *w) {
  int e = 0, n = 1 + b->nodes, rows = 2 - b->free + b->sleeve, last = row + rows - 1;
  double s = slide[b->joint], along[2] = {0}, bend = 0;
  while (e < b->elements - 1 && s >= b->ends[e + 1]) ++e;
  double h = b->ends[e + 1] - b->ends[e], x = (s - b->ends[e]) / h;
  memset(g, 0, 3L * rows * n * sizeof(double));
  for (int k = 0; k <= 3 * b->degree; ++k) {
    int node = b->degree * (e - 1) + k;
    if (node < 0 || node >= b->nodes) continue;
    const double *c = b->coefficients + 4 * (e * (3 * b->degree + 1) + k);
    const int *dof = b->dofs + 3 * node;
    double slope = (c[1] + x * (2 * c[2] + 3 * x * c[3])) / h;
    for (int i = 0; i < 2; ++i) along[i] += slope * (b->position[2 * node + i] + q[dof[i]]);
    bend += slope * (b->angle[node] + q[dof[2]]);
  }
  double square = along[0] * along[0] + along[1] * along[1], size = sqrt(square);
  if (b->free)
    set_row(w, row, 0, -along[1] / size, along[0] / size);
  else
    set_row(w, row, along[0], 1, 0), set_row(w, row + 1, along[1], 0, 1);
  double turned = b->free ? -bend / square : 0;
  if (b->sleeve) set_row(w, last, b->free ? 0 : bend, turned * along[0], turned * along[1]);
  for (int r = 0; r < rows; ++r, g += 3 * n) {
    const double *push = w->push + 2 * (row + r);
    double weight[3] = {push[0], push[1], b->sleeve && row + r == last};
    for (int i = 0; i < 3; ++i) g[i * n] = weight[i];
    for (int k = 0; k <= 3 * b->degree; ++k) {
      int node = b->degree * (e - 1) + k;
      if (node < 0 || node >= b->nodes) continue;
      const double *c = b->coefficients + 4 * (e * (3 * b->degree + 1) + k);
      double N = c[0] + x * (c[1] + x * (c[2] + x * c[3]));
      for (int i = 0; i < 3; ++i) g[i * n + 1 + node] = -weight[i] * N;
    }
  }
  return rows;
}

/* All equations at q, in the order of rate_equations.py. */
static void set_equations(const RateFit *f, const double *q, const double *slide, const FitWork *w) {
  double arm[2], along[2], *g = w->g;
  int n = f->pins, row = 0;
  for (int j = 0; j < n; ++j, row += 2) {
    find_arm(f, q, j, arm, along);
    g[j] = g[3 * n + j] = 1, g[n + j] = g[4 * n + j] = -1;
    g[2 * n + j] = arm[1], g[5 * n + j] = -arm[0];
    set_row(w, row, along[0], 1, 0), set_row(w, row + 1, along[1], 0, 1);
  }
  g += 6 * n, n = f->slots;
  for (int j = 0; j < n; ++j, ++row) {
    find_arm(f, q, f->pins + j, arm, along);
    g[j] = -along[1], g[n + j] = along[0], g[2 * n + j] = along[1], g[3 * n + j] = -along[0];
    g[4 * n + j] = -along[0] * arm[0] - along[1] * arm[1];
    set_row(w, row, 0, -along[1], along[0]);
  }
  g += 5 * n, n = f->turns;
  for (int j = 0; j < n; ++j, ++row) g[j] = 1, g[n + j] = -1, set_row(w, row, f->turned[j], 0, 0);
  g += 2 * n;
  for (int i = 0; i < f->beams; ++i) {
    int rows = set_on_beam(f->beam + i, q, slide, row, g, w);
    row += rows, g += 3 * rows * (1 + f->beam[i].nodes);
  }
  for (; row < f->count; ++row) *g++ = 1, set_row(w, row, 1, 0, 0);
}

/* Arms of massless nodes that move rigidly with others, and the entries without these nodes. */
static void condense(const RateFit *f, const double *q, const FitWork *w) {
  double *x = w->carried;
  for (int k = 0; k < f->points; ++k)
    for (int i = 0; i < 2; ++i)
      w->arm[2 * k + i] = f->point_apart[2 * k + i] + q[f->point_b[3 * k + i]] - q[f->point_a[3 * k + i]];
  for (int k = 0; k < f->raw; ++k) x[k] = w->g[f->raw_entry[k]];
  for (int k = 0; k < f->carries; ++k)
    x[f->raw + k] = f->carry_sign[k] * w->arm[f->carry_arm[k]] * x[f->carry_from[k]];
  memset(f->entry, 0, f->entries * sizeof(double));
  for (int k = 0; k < f->raw + f->carries; ++k) f->entry[f->entry_of[k]] += x[k];
}

/* Cholesky factors of the scaled G M^-1 G^T, column by column of the lower bands. */
static void factorise_equations(const RateFit *f, const FitWork *w) {
  int n = f->remaining, width = f->width;
  double *S = w->factors, *image = w->image;
  memset(S, 0, (long)n * width * sizeof(double));
  for (int k = 0; k < f->pairs; ++k)
    S[f->pair_to[k]] += f->pair_weight[k] * f->entry[f->pair_left[k]] * f->entry[f->pair_right[k]];
  if (f->inner) {
    memset(image, 0, (long)n * f->used * sizeof(double));
    for (int k = 0; k < f->entries; ++k) {
      const double *inner = f->inner + (long)f->used_of[k] * f->used;
      double *to = image + (long)f->row[k] * f->used;
      for (int i = 0; i < f->used; ++i) to[i] += f->entry[k] * inner[i];
    }
    for (int k = 0; k < f->entries; ++k)
      for (int i = 0; i <= f->row[k]; ++i)
        S[i * width + f->row[k] - i] += f->entry[k] * image[(long)i * f->used + f->used_of[k]];
  }
  for (int j = 0; j < n; ++j) w->scale[j] = 1 / sqrt(S[(long)j * width]);
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < width && j + i < n; ++i) S[(long)j * width + i] *= w->scale[j] * w->scale[j + i];
  for (int j = 0; j < n; ++j) {
    double *column = S + (long)j * width;
    int below = n - 1 - j < width - 1 ? n - 1 - j : width - 1;
    double pivot = sqrt(fmax(column[0] + REGULAR, LEAST_SQUARE));
    column[0] = 1 / pivot;
    for (int i = 1; i <= below; ++i) column[i] /= pivot;
    for (int i = 1; i <= below; ++i)
      for (int k = i; k <= below; ++k) column[(long)i * width + k - i] -= column[i] * column[k];
  }
}

/* Solves the scaled equations in place of the right side `left`. */
static void solve_equations(const RateFit *f, const FitWork *w) {
  int n = f->remaining, width = f->width;
  double *b = w->left;
  for (int j = 0; j < n; ++j) b[j] *= w->scale[j];
  for (int j = 0; j < n; ++j) {
    const double *column = w->factors + (long)j * width;
    b[j] *= column[0];
    for (int i = 1; i < width && j + i < n; ++i) b[j + i] -= column[i] * b[j];
  }
  for (int j = n - 1; j >= 0; --j) {
    const double *column = w->factors + (long)j * width;
    for (int i = 1; i < width && j + i < n; ++i) b[j] -= column[i] * b[j + i];
    b[j] *= column[0];
  }
  for (int j = 0; j < n; ++j) b[j] *= w->scale[j];
}

/* Impulses from the multipliers, and x by them, from the rates of massless nodes before. */
static void push_masses(const RateFit *f, const FitWork *w) {
  int n = f->used;
  memset(w->impulse, 0, n * sizeof(double));
  for (int k = 0; k < f->entries; ++k) w->impulse[f->used_of[k]] += f->entry[k] * f->multiplier[f->row[k]];
  for (int i = 0; i < n; ++i) {
    w->x[i] = f->massless[i] ? w->before[i] : 0;
    if (f->inner)
      w->x[i] += dot(n, f->inner + (long)i * n, w->impulse);
    else
      w->x[i] += f->inverse_mass[i] * w->impulse[i];
  }
}

/* Multipliers of the equations that remain, and the corrections x of what is in them. */
static void correct_rates(const RateFit *f, const FitWork *w) {
  int n = f->used, again = 1;
  factorise_equations(f, w);
  memset(w->x, 0, n * sizeof(double));
  for (int k = 0; k < REPETITIONS && again; ++k) {
    double change = 0, size = 0;
    memcpy(w->before, w->x, n * sizeof(double));
    memset(f->multiplier, 0, f->remaining * sizeof(double));
    push_masses(f, w);
    for (int twice = 0; twice < 2; ++twice) { /* the second time against round-off */
      for (int r = 0; r < f->remaining; ++r) w->left[f->number[r]] = f->lacking[r];
      for (int j = 0; j < f->entries; ++j)
        w->left[f->number[f->row[j]]] -= f->entry[j] * w->x[f->used_of[j]];
      solve_equations(f, w);
      for (int r = 0; r < f->remaining; ++r) f->multiplier[r] += w->left[f->number[r]];
      push_masses(f, w);
    }
    again = 0;
    for (int i = 0; i < n; ++i) {
      again |= f->massless[i];
      size = fmax(size, fabs(w->x[i])), change = fmax(change, fabs(w->x[i] - w->before[i]));
    }
    again = again && change > ROUND_OFF * size;
  }
}

/* The multipliers of the joints of rigid points balance what else acts on these. */
static void balance_points(const RateFit *f, const FitWork *w) {
  memset(w->all, 0, f->count * sizeof(double)), memset(w->force, 0, f->size * sizeof(double));
  for (int r = 0; r < f->remaining; ++r) w->all[f->remaining_row[r]] = f->multiplier[r];
  for (int k = 0; k < f->raw; ++k) w->force[f->raw_dof[k]] += w->g[f->raw_entry[k]] * w->all[f->raw_row[k]];
  for (int k = 0; k < f->points; ++k) {
    const int *a = f->point_a + 3 * k, *b = f->point_b + 3 * k;
    double x = w->force[b[0]], y = w->force[b[1]], moment = w->force[b[2]];
    double lever = w->arm[2 * k] * y - w->arm[2 * k + 1] * x;
    for (int i = 0; i < 3; ++i) w->all[f->point_rows[3 * k + i]] = -w->force[b[i]];
    w->force[a[0]] += x, w->force[a[1]] += y, w->force[a[2]] += moment + lever;
  }
}

/* Forces of joints on b (joints, 3), and of driven and fixed columns, by all multipliers. */
static void find_forces(const RateFit *f, const FitWork *w, double *joints, double *constraints) {
  memset(joints, 0, 3L * f->joints * sizeof(double));
  memset(constraints, 0, f->columns * sizeof(double));
  for (int r = 0; r < f->count; ++r) {
    double m = w->all[r], *out = joints + 3 * f->joint[r];
    if (f->joint[r] >= 0)
      out[0] += w->push[2 * r] * m, out[1] += w->push[2 * r + 1] * m, out[2] += f->turning[r] * m;
    if (f->column[r] >= 0) constraints[f->column[r]] += w->given[r] * m;
  }
}

long fx_fit_scratch(const RateFit *f) {
  FitWork work;
  return lay_out_fit(f, &work, 0);
}

static void begin_fit(const RateFit *f, const FitWork *w, const double *q, const double *v,
                      const double *slide, const double *driven) {
  set_equations(f, q, slide, w);
  condense(f, q, w);
  for (int r = 0; r < f->remaining; ++r) {
    int row = f->remaining_row[r], column = f->column[row];
    f->lacking[r] = column >= 0 && column < f->driven ? w->given[row] * driven[column] : 0;
  }
  for (int k = 0; k < f->entries; ++k) f->lacking[f->row[k]] -= f->entry[k] * v[f->dof[k]];
  for (int r = 0; r < f->remaining; ++r)
    if (isnan(f->lacking[r])) f->lacking[r] = 0;
}

static void end_fit(const RateFit *f, const FitWork *w, const double *v, double *rates,
                    double *corrections, double *joints, double *constraints) {
  balance_points(f, w);
  find_forces(f, w, joints, constraints);
  for (int k = 0; k < f->size; ++k) rates[k] = v[k] + corrections[k];
  for (int k = f->points - 1; k >= 0; --k) {
    const int *a = f->point_a + 3 * k, *b = f->point_b + 3 * k;
    rates[b[0]] = rates[a[0]] - rates[a[2]] * w->arm[2 * k + 1];
    rates[b[1]] = rates[a[1]] + rates[a[2]] * w->arm[2 * k];
    rates[b[2]] = rates[a[2]];
  }
  for (int k = 0; k < f->size; ++k) corrections[k] = rates[k] - v[k];
}

void fx_begin_fit(const RateFit *f, const double *q, const double *v, const double *slide,
                  const double *driven) {
  FitWork work;
  lay_out_fit(f, &work, f->scratch);
  begin_fit(f, &work, q, v, slide, driven);
}

void fx_end_fit(const RateFit *f, const double *v, double *rates, double *corrections, double *joints,
                double *constraints) {
  FitWork work;
  lay_out_fit(f, &work, f->scratch);
  end_fit(f, &work, v, rates, corrections, joints, constraints);
}

/* Fits the rates of n configurations: displacements and rotations, rates, slides, and driven rates, NaN
   where they are not known; writes rates, their corrections, and the impulses of joints and columns. */
void fx_fit(const RateFit *f, int n, const double *q, const double *v, const double *slide,
            const double *driven, double *rates, double *corrections, double *joints, double *constraints) {
  FitWork work, *w = &work;
  lay_out_fit(f, w, f->scratch);
  for (; n > 0; --n) {
    begin_fit(f, w, q, v, slide, driven);
    correct_rates(f, w);
    memset(corrections, 0, f->size * sizeof(double));
    if (f->inner)
      for (int i = 0; i < f->used; ++i)
        for (int k = 0; k < f->size; ++k)
          corrections[k] += w->impulse[i] * f->flexible[(long)i * f->size + k];
    for (int i = 0; i < f->used; ++i)
      if (!f->inner || f->massless[i]) corrections[f->used_dof[i]] = w->x[i];
    end_fit(f, w, v, rates, corrections, joints, constraints);
    q += f->size, v += f->size, rates += f->size, corrections += f->size;
    slide += f->joints, driven += f->driven, joints += 3 * f->joints, constraints += f->columns;
  }
}
