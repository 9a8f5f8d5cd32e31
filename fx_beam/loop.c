/* The loop over time steps: Newton's method, factorisation, update, audit and record, on the
   functions that FFCx generates from the weak form. It does what newton.py and stepping.py do,
   name by name; nothing of the physics is written here. */

#include <string.h>

#include "loop.h"
#include "phases.h"
#include "vectors.h"

enum { OK, NO_CONVERGENCE, SINGULAR, TURNED_TOO_FAR };
enum { PAST = 4 };

typedef struct {
  double *D, *path, *slope, *acc, *f, *r, *reduced, *step, *correction, *z;
  double *tangent, *inertia, *values, *hat, *psi0, *rho0, *t0, *rho1, *t1, *mean_t, *guide_slope;
  double *guide_bend, *passing, *columns, *y, *row, *start, *force, *dead, *left;
  double *past[PAST], *past_z[PAST]; /* backward differences of the increments, from the 0th on */
  int known, foretelling;            /* steps taken, and how many differences foretold the last */
  double dt;
  const double *thrust;
} Work;

static double *take(double **at, long n) {
  double *p = *at;
  *at += n;
  return p;
}

static long lay_out(const Problem *p, Work *w, double *at) {
  double *begin = at;
  long n = p->dofs, c = p->columns, j = p->joints;
  w->D = take(&at, n), w->path = take(&at, n), w->slope = take(&at, n);
  w->acc = take(&at, n), w->f = take(&at, n + LANES), w->r = take(&at, n);
  w->correction = take(&at, n), w->force = take(&at, n), w->dead = take(&at, n), w->left = take(&at, n);
  w->reduced = take(&at, c), w->step = take(&at, c), w->z = take(&at, c), w->columns = take(&at, c);
  w->y = take(&at, c), w->row = take(&at, c), w->start = take(&at, c);
  for (int k = 0; k < PAST; ++k) w->past[k] = take(&at, n), w->past_z[k] = take(&at, c);
  w->tangent = take(&at, p->places + LANES), w->inertia = take(&at, p->places);
  w->values = take(&at, 1 + 4 * j), w->hat = take(&at, 1 + 4 * j);
  w->psi0 = take(&at, j), w->rho0 = take(&at, 2 * j), w->t0 = take(&at, 2 * j);
  w->rho1 = take(&at, 2 * j), w->t1 = take(&at, 2 * j), w->mean_t = take(&at, 2 * j);
  w->guide_slope = take(&at, j), w->guide_bend = take(&at, j), w->passing = take(&at, 2 * j);
  return at - begin;
}

long fx_scratch(const Problem *p) {
  Work w;
  return lay_out(p, &w, 0);
}

/* -- Forms ----------------------------------------------------------------------------------- */

static void pack(const Problem *p, const Integral *of, const Form *form, long block,
                 const double *const *fields, int first, int end) {
  int entries = p->cell_dofs * LANES;
  const int *dofs = of->dofs + block * entries;
  for (int m = first; m < end; ++m) {
    const double *field = fields[form->kind[m]];
    double *to = of->packed + (block * form->width + form->offset[m]) * LANES;
    for (int j = 0; j < entries; ++j) to[j] = field[dofs[j]];
  }
}

/* Takes over what moves from step to step only. */
static void begin_form(const Problem *p, Form *form, const double *const *fields, double t, double dt) {
  for (int i = 0; i < form->integrals; ++i)
    for (long block = 0; block * LANES < form->of[i].cells; ++block)
      pack(p, form->of + i, form, block, fields, form->changing, form->moving);
  if (form->integrals && form->time_at >= 0) form->constants[form->time_at] = t;
  if (form->integrals && form->dt_at >= 0) form->constants[form->dt_at] = dt;
}

/* Adds the element tensors of a form to a vector, to matrix entries, of which the columns may have
   factors, or to a number. */
INLINED void assemble(const Problem *p, const Form *form, const double *const *fields, int rank,
                      const double *factor, double *out) {
  int nd = p->cell_dofs, size = rank == 2 ? nd * nd : rank == 1 ? nd : 1;
  double A[12 * 12 * LANES];
  for (int i = 0; i < form->integrals; ++i) {
    const Integral *of = form->of + i;
    for (long block = 0; block * LANES < of->cells; ++block) {
      pack(p, of, form, block, fields, 0, form->changing);
      of->batch(A, of->packed + block * form->width * LANES, form->constants,
                of->coordinates + block * p->cell_coordinates * LANES);
      const int *dofs = of->dofs + block * nd * LANES;
      if (factor)
        for (int j = 0; j < size * LANES; ++j) A[j] *= factor[dofs[j % (nd * LANES)]];
      if (rank == 0) {
        for (int l = 0; l < LANES && block * LANES + l < of->cells; ++l) *out += A[l];
        continue;
      }
      const int *to = (rank == 2 ? of->place : of->to) + block * size * LANES;
      for (int j = 0; j < size; ++j)
#pragma GCC unroll 8
        for (int l = 0; l < LANES; ++l) out[to[j * LANES + l]] += A[j * LANES + l];
    }
  }
}

static void assemble_matrix(const Problem *p, const Form *form, const double *const *fields,
                            const double *factor, double *out) {
  assemble(p, form, fields, 2, factor, out);
}

static void assemble_vector(const Problem *p, const Form *form, const double *const *fields,
                            double *out) {
  assemble(p, form, fields, 1, 0, out);
}

static double assemble_scalar(const Problem *p, const Form *form, const double *const *fields) {
  double sum = 0;
  assemble(p, form, fields, 0, 0, &sum);
  return sum;
}

/* Largest of |x| / unit; NaN if there is one. Side by side, so that it becomes a loop over vectors. */
static double largest(int n, const double *x, const double *per_unit) {
  double top[LANES] = {0}, all[LANES] = {0};
  for (int i = 0; i < n; i += LANES)
    for (int l = 0; l < LANES && i + l < n; ++l) {
      double size = fabs(x[i + l]) * per_unit[i + l];
      top[l] = top[l] < size ? size : top[l];
      all[l] += size;
    }
  double found = 0, sum = 0;
  for (int l = 0; l < LANES; ++l) {
    found = found < top[l] ? top[l] : found;
    sum += all[l];
  }
  return isnan(sum) ? sum : found;
}

static void times_mass(const Problem *p, const double *x, double *out) {
  for (int i = 0; i < p->dofs; ++i) {
    double sum = 0;
    for (int k = p->mass_start[i]; k < p->mass_start[i + 1]; ++k)
      sum += p->mass[k] * x[p->mass_column[k]];
    out[i] = sum;
  }
}

/* Row of the full tangent times a vector. */
static double row_times(const Problem *p, const double *tangent, int row, const double *x) {
  double sum = 0;
  for (int k = p->row_start[row]; k < p->row_start[row + 1]; ++k)
    sum += tangent[p->place[k]] * x[p->column_of[k]];
  return sum;
}

/* -- Rates (rates.py) -------------------------------------------------------------------------- */

static void work_increment(const Problem *p, const Work *w) {
  double *D = w->D, *path = w->path, *slope = w->slope, *tangent = w->left;
  memcpy(path, D, p->dofs * sizeof *D);
  for (int i = 0; i < p->dofs; ++i) slope[i] = 1;
  if (p->rule != 0) return;
  for (int i = 0; i < p->turning; ++i) tangent[i] = D[p->turns[i]] / 2;
  /* Apart from the numbering, so that it becomes a loop over vectors. */
  for (int i = 0; i < p->turning; ++i) tangent[i] = sin(tangent[i]) / cos(tangent[i]);
  for (int i = 0; i < p->turning; ++i) {
    int k = p->turns[i];
    path[k] = 2 * tangent[i], slope[k] = 1 + tangent[i] * tangent[i];
  }
}

static double newmark_end(const Problem *p, double D, double v0, double a0, double dt) {
  return (D - dt * v0) / (p->beta * dt * dt) - (1 / (2 * p->beta) - 1) * a0;
}

static void acceleration(const Problem *p, const Work *w, double dt) {
  for (int i = 0; i < p->dofs; ++i)
    if (p->rule == 0)
      w->acc[i] = 2 / dt * (w->path[i] / dt - p->v[i]);
    else {
      double a1 = newmark_end(p, w->D[i], p->v[i], p->a[i], dt);
      w->acc[i] = (1 - p->alpha_m) * a1 + p->alpha_m * p->a[i];
    }
}

/* Derivative of the acceleration by the increment on which forces do work. */
static double steepness(const Problem *p, double dt) {
  return (p->rule == 0 ? 2 : (1 - p->alpha_m) / p->beta) / (dt * dt);
}

static void advance_rates(Problem *p, const Work *w, double dt) {
  for (int i = 0; i < p->dofs; ++i) {
    double v0 = p->v[i];
    if (p->rule == 0)
      p->v[i] = 2 / dt * w->path[i] - v0, p->a[i] = (p->v[i] - v0) / dt;
    else {
      double a1 = newmark_end(p, w->D[i], v0, p->a[i], dt);
      p->v[i] = v0 + dt * ((1 - p->gamma) * p->a[i] + p->gamma * a1), p->a[i] = a1;
    }
    w->left[i] = v0;
  }
  for (int k = 0; k < p->lacking; ++k) {
    int i = p->massless[k];
    p->v[i] = w->path[i] / dt, p->a[i] = (p->v[i] - w->left[i]) / dt;
  }
}

/* -- Springs and dampers (actuators.py) ------------------------------------------------------- */

/* Value at a degree of freedom; zero where there is none. */
static inline double at(const double *x, int dof) { return dof < 0 ? 0 : x[dof]; }

static void turn(double psi, double x, double y, double *out) {
  double c = cos(psi), s = sin(psi);
  out[0] = c * x - s * y, out[1] = s * x + c * y;
}

static double coordinate(const Problem *p, const Actuator *a) {
  return a->slide >= 0 ? p->slide[a->slide] : at(p->q, a->b[2]) - at(p->q, a->a[2]);
}

/* Of the coordinate, at the start of the step. */
static double rate(const Problem *p, const Actuator *a) {
  double v[3], seen[2];
  for (int i = 0; i < 3; ++i) v[i] = at(p->v, a->b[i]) - at(p->v, a->a[i]);
  if (a->slide < 0) return v[2];
  double d = p->slide[a->slide], spin = at(p->v, a->a[2]);
  turn(-at(p->q, a->a[2]), v[0], v[1], seen);
  seen[0] += spin * (a->offset[1] + d * a->axis[1]);
  seen[1] -= spin * (a->offset[0] + d * a->axis[0]);
  return a->axis[0] * seen[0] + a->axis[1] * seen[1];
}

static void begin_actuators(const Problem *p) {
  for (int i = 0; i < p->actuators; ++i) {
    Actuator *a = p->actuator + i;
    a->start = coordinate(p, a);
    /* In the middle of the step it is the mean one, whatever it was at the start. */
    a->rate = p->level == 0.5 ? 0 : rate(p, a);
  }
}

static double stored(const Problem *p) {
  double sum = 0;
  for (int i = 0; i < p->actuators; ++i) {
    const Actuator *a = p->actuator + i;
    double stretch = coordinate(p, a) - a->rest;
    sum += a->k / 2 * stretch * stretch;
  }
  return sum;
}

static void actuate(const Problem *p, const Work *w) {
  for (int i = 0; i < p->actuators; ++i) {
    Actuator *a = p->actuator + i;
    double change, path, ratio = 1, by_a = 0, by_b = 0, slope_a = 0, slope_b = 1;
    if (a->slide >= 0)
      change = path = w->z[a->column];
    else {
      double Da = at(w->D, a->a[2]), Db = at(w->D, a->b[2]);
      change = path = Db - Da, slope_a = 1;
      if (p->rule == 0) {
        double tan_a = tan(Da / 2), tan_b = tan(Db / 2), x = change / 2;
        path = 2 * (tan_b - tan_a), slope_a = 1 + tan_a * tan_a, slope_b = 1 + tan_b * tan_b;
        ratio = cos(Da / 2) * cos(Db / 2) * (x != 0 ? x / sin(x) : 1);
        double by_x = fabs(x) < 1e-3 ? x / 3 : 1 / x - 1 / tan(x);
        by_a = ratio * (-by_x - tan_a) / 2, by_b = ratio * (by_x - tan_b) / 2;
      }
    }
    double level = p->level, elastic = a->k * (a->start + level * change - a->rest);
    double steep = 2 * level * a->c / w->dt;
    a->force = elastic * ratio + a->c * (a->rate + 2 * level * (path / w->dt - a->rate));
    a->lost = a->c * path * path / w->dt;
    a->slope_a = -a->k * level * ratio + elastic * by_a - steep * slope_a;
    a->slope_b = a->k * level * ratio + elastic * by_b + steep * slope_b;
  }
}

/* -- Couplings (reduction.py) ------------------------------------------------------------------ */

static void begin_couplings(const Problem *p, const Work *w) {
  w->values[0] = w->hat[0] = 1;
  begin_actuators(p);
  for (int j = 0; j < p->joints; ++j) {
    double d = at(p->slide, p->slide_of[j]);
    const double *o = p->offset + 2 * j, *e = p->axis + 2 * j;
    w->psi0[j] = at(p->q, p->guide[j]);
    turn(w->psi0[j], o[0] + d * e[0], o[1] + d * e[1], w->rho0 + 2 * j);
    turn(w->psi0[j], e[0], e[1], w->t0 + 2 * j);
  }
}

/* Increment of all degrees of freedom for the columns z, and the values of T and That there. */
static void expand(const Problem *p, const Work *w) {
  double *D = w->D, level = p->level;
  memset(D, 0, p->dofs * sizeof *D);
  for (int k = 0; k < p->equal; ++k) D[p->entry_row[k]] += w->z[p->entry_column[k]];
  for (int k = p->equal; k < p->entries; ++k)
    if (p->entry_value[k] == 0) D[p->entry_row[k]] += p->entry_sign[k] * w->z[p->entry_column[k]];
  for (int j = 0; j < p->joints; ++j) {
    const double *o = p->offset + 2 * j, *e = p->axis + 2 * j;
    double Dpsi = at(D, p->guide[j]);
    double d = at(p->slide, p->slide_of[j]);
    if (p->slide_column[j] >= 0) d += w->z[p->slide_column[j]];
    double *rho0 = w->rho0 + 2 * j, *rho1 = w->rho1 + 2 * j, *t0 = w->t0 + 2 * j, *t1 = w->t1 + 2 * j;
    turn(w->psi0[j] + Dpsi, o[0] + d * e[0], o[1] + d * e[1], rho1);
    turn(w->psi0[j] + Dpsi, e[0], e[1], t1);
    double tangent = tan(Dpsi / 2), slope = p->rule == 0 ? 1 + tangent * tangent : 1;
    w->guide_slope[j] = slope;
    w->guide_bend[j] = p->rule == 0 ? tangent * slope : 0;
    double mean_rho[2], *mean_t = w->mean_t + 2 * j;
    for (int i = 0; i < 2; ++i) {
      mean_rho[i] = (1 - level) * rho0[i] + level * rho1[i];
      mean_t[i] = (1 - level) * t0[i] + level * t1[i];
    }
    double *value = w->values + 1 + 4 * j, *hat = w->hat + 1 + 4 * j;
    value[0] = -rho1[1], value[1] = rho1[0], value[2] = t1[0], value[3] = t1[1];
    hat[0] = -mean_rho[1], hat[1] = mean_rho[0], hat[2] = slope * mean_t[0], hat[3] = slope * mean_t[1];
  }
  for (int k = 0; k < p->followers; ++k) {
    int j = p->through[k];
    D[p->follower_x[k]] += p->joint_sign[j] * (w->rho1[2 * j] - w->rho0[2 * j]);
    D[p->follower_y[k]] += p->joint_sign[j] * (w->rho1[2 * j + 1] - w->rho0[2 * j + 1]);
  }
  actuate(p, w);
}

static void spread(const Problem *p, const Work *w, const double *z, double *out) {
  memset(out, 0, p->dofs * sizeof *out);
  for (int k = 0; k < p->equal; ++k) out[p->entry_row[k]] += z[p->entry_column[k]];
  for (int k = p->equal; k < p->entries; ++k)
    out[p->entry_row[k]] += p->entry_sign[k] * w->values[p->entry_value[k]] * z[p->entry_column[k]];
}

static void project(const Problem *p, const Work *w, const double *r, double *out) {
  memset(out, 0, p->columns * sizeof *out);
  for (int k = 0; k < p->equal; ++k) out[p->entry_column[k]] += r[p->entry_row[k]];
  for (int k = p->equal; k < p->entries; ++k)
    out[p->entry_column[k]] += p->entry_sign[k] * w->hat[p->entry_value[k]] * r[p->entry_row[k]];
  for (int k = 0; k < p->pushes; ++k)
    out[p->push_column[k]] += p->push_sign[k] * p->actuator[p->push_of[k]].force;
}

static void transmitted(const Problem *p, const Work *w, const double *r) {
  memset(w->passing, 0, 2 * p->joints * sizeof(double));
  for (int k = 0; k < p->followers; ++k) {
    w->passing[2 * p->through[k]] += r[p->follower_x[k]];
    w->passing[2 * p->through[k] + 1] += r[p->follower_y[k]];
  }
}

/* Completes the reduced tangent, where its factors will stand. */
static void reduce_tangent(const Problem *p, const Work *w, const double *r) {
  double *K = w->tangent;
  for (int k = 0; k < p->plain; ++k) K[p->plain_to[k]] += K[p->plain_from[k]];
  for (int k = 0; k < p->mixed; ++k)
    K[p->mixed_to[k]] += K[p->mixed_from[k]] * w->hat[p->mixed_hat[k]] *
                         w->values[p->mixed_value[k]] * p->mixed_sign[k];
  if (p->second) transmitted(p, w, r);
  for (int k = 0; k < p->second; ++k) {
    int j = p->second_joint[k];
    double s = p->joint_sign[j], F0 = s * w->passing[2 * j], F1 = s * w->passing[2 * j + 1];
    double turned = p->level * (F1 * w->t1[2 * j] - F0 * w->t1[2 * j + 1]), term;
    if (p->second_kind[k] == 0)
      term = -p->level * (F0 * w->rho1[2 * j] + F1 * w->rho1[2 * j + 1]);
    else if (p->second_kind[k] == 1)
      term = turned;
    else
      term = w->guide_bend[j] * (F0 * w->mean_t[2 * j] + F1 * w->mean_t[2 * j + 1]) +
             w->guide_slope[j] * turned;
    K[p->second_to[k]] += p->second_sign[k] * term;
  }
  for (int k = 0; k < p->third; ++k) {
    const Actuator *a = p->actuator + p->third_of[k];
    K[p->third_to[k]] += p->third_sign[k] * (p->third_side[k] ? a->slope_b : a->slope_a);
  }
}

/* -- Follower forces (followers.py) ------------------------------------------------------------ */

static void turned_thrust(const Problem *p, const Work *w, int i, double *out) {
  int psi = p->thrust_dofs[3 * i + 2];
  turn(p->q[psi] + p->level * w->D[psi], w->thrust[2 * i], w->thrust[2 * i + 1], out);
}

static void add_thrusts(const Problem *p, const Work *w, double factor, double *out) {
  for (int i = 0; i < p->thrusts; ++i) {
    double F[2];
    turned_thrust(p, w, i, F);
    for (int k = 0; k < 2; ++k) out[p->thrust_dofs[3 * i + k]] += factor * F[k];
  }
}

static void add_thrust_tangent(const Problem *p, const Work *w, double *K) {
  for (int i = 0; i < p->thrusts; ++i) {
    double F[2];
    turned_thrust(p, w, i, F);
    K[p->thrust_places[2 * i]] += p->level * F[1];
    K[p->thrust_places[2 * i + 1]] -= p->level * F[0];
  }
}

/* -- Newton's method (newton.py) --------------------------------------------------------------- */

/* Takes a column out of the rows that follow it, downwards or upwards; `reach` of them have it. */
INLINED void eliminate(int band, int reach, int way, double *restrict pivot, double *restrict b) {
  double inverse = pivot[0] = 1 / pivot[0], above = b[0];
#pragma GCC unroll 12
  for (int i = 1; i <= reach; ++i) {
    double *restrict row = pivot + way * i * 2 * band;
    double factor = row[0] * inverse;
#pragma GCC unroll 12
    for (int j = 1; j <= reach; ++j) row[way * j] -= factor * pivot[way * j];
    b[way * i] -= factor * above;
  }
}

/* Unknown of a row whose `reach` followers are known; the nearest comes last, as it is the newest. */
INLINED void substitute(int reach, int way, const double *restrict row, double *restrict b) {
  double sum = b[0];
#pragma GCC unroll 12
  for (int j = reach; j > 0; --j) sum -= row[way * j] * b[way * j];
  b[0] = sum * row[0];
}

static inline int is_pivot(double x) { return fabs(x) > 1e-300; }

/* LU in place without pivoting, and the solution in place of b; 0 if a pivot vanishes. From both ends
   towards the middle, so that the processor has two pivots to divide by at a time. */
INLINED int solve(int n, int band, double *A, double *b) {
  int half = n > 4 * band ? n / 2 - band : 0, last = n - 1 - half;
  long row = 2 * band + 1;
  double *top = A + band, *bottom = A + band + (n - 1) * row, *end = b + n - 1;
  for (int k = 0; k < half; ++k) {
    if (!is_pivot(top[k * row]) || !is_pivot(bottom[-k * row])) return 0;
    eliminate(band, band, 1, top + k * row, b + k);
    eliminate(band, band, -1, bottom - k * row, end - k);
  }
  for (int k = half; k <= last; ++k) {
    if (!is_pivot(top[k * row])) return 0;
    /* Apart, so that the loops have a constant length but at the end. */
    if (k + band <= last)
      eliminate(band, band, 1, top + k * row, b + k);
    else
      eliminate(band, last - k, 1, top + k * row, b + k);
  }
  for (int k = last; k >= half; --k)
    if (k + band <= last)
      substitute(band, 1, top + k * row, b + k);
    else
      substitute(last - k, 1, top + k * row, b + k);
  for (int k = half - 1; k >= 0; --k) {
    substitute(band, 1, top + k * row, b + k);
    substitute(band, -1, bottom - k * row, end - k);
  }
  return 1;
}

/* The same for sparse rows, one of which `row` holds while those above are taken out of it. */
static int solve_sparse(const Problem *p, double *A, double *b, double *row) {
  const int *start = p->factor_start, *column = p->factor_column, *diagonal = p->factor_diagonal;
  for (int i = 0; i < p->free; ++i) {
    for (int k = start[i]; k < start[i + 1]; ++k) row[column[k]] = A[k];
    for (int k = start[i]; k < diagonal[i]; ++k) {
      int above = column[k];
      double factor = row[above] * A[diagonal[above]];
      for (int m = diagonal[above] + 1; m < start[above + 1]; ++m)
        row[column[m]] -= factor * A[m];
      b[i] -= factor * b[above];
    }
    if (!(fabs(row[i]) > 1e-300)) return 0;
    A[diagonal[i]] = 1 / row[i];
    for (int k = diagonal[i] + 1; k < start[i + 1]; ++k) A[k] = row[column[k]];
  }
  for (int i = p->free - 1; i >= 0; --i) {
    for (int k = diagonal[i] + 1; k < start[i + 1]; ++k) b[i] -= A[k] * b[column[k]];
    b[i] *= A[diagonal[i]];
  }
  return 1;
}

/* The band widths of beams, for which the compiler can unroll the loops. */
static int solve_reduced(const Problem *p, const Work *w) {
  switch (p->band) {
    case 0: return solve_sparse(p, w->tangent, w->y, w->row);
    case 5: return solve(p->free, 5, w->tangent, w->y); /* degree 1 */
    case 6: return solve(p->free, 6, w->tangent, w->y); /* the same with joints */
    case 8: return solve(p->free, 8, w->tangent, w->y); /* degree 2 */
    case 11: return solve(p->free, 11, w->tangent, w->y); /* degree 3 */
    default: return solve(p->free, p->band, w->tangent, w->y);
  }
}

/* Twice the kinetic energy at the start of the step. */
static double kinetic(const Problem *p, const Work *w) {
  double sum = 0;
  times_mass(p, p->v, w->left);
  for (int i = 0; i < p->dofs; ++i) sum += p->v[i] * w->left[i];
  return sum;
}

static void tangent(const Problem *p, const Work *w, const double *const *fields) {
  double *K = w->tangent;
  memcpy(K, w->inertia, p->places * sizeof(double));
  assemble_matrix(p, &p->tangent, fields, 0, K);
  assemble_matrix(p, &p->path_tangent, fields, w->slope, K);
  add_thrust_tangent(p, w, K);
  if (p->rule != 0) return;
  double steep = steepness(p, w->dt);
  for (int k = 0; k < p->turning_masses; ++k)
    K[p->turning_place[k]] += p->turning_mass[k] * steep * (w->slope[p->turning_column[k]] - 1);
}

/* The inertia's part of the tangent, but for what changes with the slope of rotations. */
static void begin_inertia(const Problem *p, const Work *w) {
  memset(w->inertia, 0, p->places * sizeof(double));
  for (int k = 0; k < p->mass_start[p->dofs]; ++k)
    w->inertia[p->mass_place[k]] = p->mass[k] * steepness(p, w->dt);
}

/* Forces of supports and joints after the correction, to first order; elsewhere none are left. */
static void settle(const Problem *p, const Work *w) {
  memset(w->left, 0, p->dofs * sizeof(double));
  for (int k = 0; k < p->reacting; ++k) {
    int i = p->reacts[k];
    w->left[i] = w->r[i] - row_times(p, w->tangent, i, w->correction);
  }
  memcpy(w->r, w->left, p->dofs * sizeof(double));
}

/* Takes the old from the new, and keeps the new in its place. */
static void difference(int n, double *restrict x, double *restrict old) {
  for (int i = 0; i < n; ++i) {
    double now = x[i];
    x[i] = now - old[i], old[i] = now;
  }
}

/* Keeps the increment and its backward differences, and sees how many of them foretold it best. */
static void learn(const Problem *p, Work *w) {
  double best = p->close * largest(p->dofs, w->D, p->per_unit), *left = w->left;
  w->foretelling = 0;
  memcpy(left, w->D, p->dofs * sizeof(double));
  for (int k = 0; k < PAST; ++k) {
    difference(p->dofs, left, w->past[k]);
    double error = k < w->known ? largest(p->dofs, left, p->per_unit) : HUGE_VAL;
    if (error <= best) best = error, w->foretelling = k + 1;
  }
  memcpy(left, w->z, p->free * sizeof(double));
  for (int k = 0; k < PAST; ++k) difference(p->free, left, w->past_z[k]);
  ++w->known;
}

static int newton(Problem *p, const Work *w, double dt, const double *driven) {
  int n = p->dofs, free = p->free, smalls = 0;
  const double *fields[5] = {w->D, w->path, p->q, p->v, p->a};
  double previous = HUGE_VAL, drive = 0;
  memset(w->z, 0, p->columns * sizeof(double));
  for (int i = 0; i < p->driven; ++i) drive += fabs(driven[i]);
  if (w->foretelling) {
    for (int k = 0; k < w->foretelling; ++k)
      for (int i = 0; i < free; ++i) w->z[i] += w->past_z[k][i];
    for (int i = 0; i < p->driven; ++i) w->z[free + i] = driven[i];
  }
  begin_couplings(p, w);
  expand(p, w);
  LAP(COUPLINGS);
  for (int iteration = 1; iteration <= p->max_iterations; ++iteration) {
    work_increment(p, w);
    acceleration(p, w, dt);
    times_mass(p, w->acc, w->r);
    LAP(INERTIA);
    memset(w->f, 0, n * sizeof(double));
    assemble_vector(p, &p->residual, fields, w->f);
    add_thrusts(p, w, -1, w->f);
    LAP(FORCES);
    for (int i = 0; i < n; ++i) w->r[i] += w->f[i] - w->force[i];
    project(p, w, w->r, w->reduced);
    memset(w->step, 0, p->columns * sizeof(double));
    LAP(COUPLINGS);
    tangent(p, w, fields);
    LAP(TANGENT);
    reduce_tangent(p, w, w->r);
    if (iteration == 1 && drive > 0 && !w->foretelling) {
      for (int i = 0; i < p->driven; ++i) w->step[free + i] = -driven[i];
      spread(p, w, w->step, w->correction);
      for (int i = 0; i < n; ++i)
        w->left[i] = w->r[i] - row_times(p, w->tangent, i, w->correction);
      project(p, w, w->left, w->reduced);
    }
    LAP(COUPLINGS);
    for (int i = 0; i < free; ++i) w->y[p->order[i]] = w->reduced[i];
    if (!solve_reduced(p, w)) return SINGULAR;
    for (int i = 0; i < free; ++i) w->step[i] = w->y[p->order[i]];
    LAP(SOLUTION);
    spread(p, w, w->step, w->correction);
    LAP(COUPLINGS);
    double size = largest(n, w->correction, p->per_unit), widest = 0, lack = 0;
    if (!isfinite(size)) return SINGULAR;
    if (size > p->longest_turn)
      for (int i = 0; i < p->turning; ++i) widest = fmax(widest, fabs(w->correction[p->turns[i]]));
    if (widest > p->longest_turn)
      for (int i = 0; i < free; ++i) w->step[i] *= p->longest_turn / widest;
    for (int i = 0; i < free; ++i) {
      w->z[i] -= w->step[i];
      lack += w->reduced[i] * w->step[i];
    }
    for (int i = 0; i < p->driven; ++i) w->z[free + i] = driven[i];
    int small = size <= p->tolerance, floor = 0;
    if (small || size > 0.5 * previous) {
      double energy = kinetic(p, w);
      for (int i = 0; i < n; ++i) energy += fabs(w->f[i]) * fabs(w->D[i]);
      if (small)
        small = ++smalls > 2 || fabs(lack) <= p->energy_tolerance * energy;
      else
        floor = fabs(lack) <= p->energy_floor * energy;
    }
    if (small || floor) settle(p, w);
    LAP(CHECKS);
    expand(p, w);
    LAP(COUPLINGS);
    for (int i = 0; i < p->turning; ++i)
      if (fabs(w->D[p->turns[i]]) > p->max_turn) return TURNED_TOO_FAR;
    if (small || floor) {
      p->iterations += iteration;
      p->by_round_off += floor;
      return OK;
    }
    previous = size;
  }
  return NO_CONVERGENCE;
}

/* -- Steps (stepping.py) ------------------------------------------------------------------------ */

static double mid(const Problem *p, double force, double previous) {
  if (p->level == 0.5 || p->steps_done == 0) return force;
  return force + (0.5 - p->level) * (force - previous);
}

static void joint_forces(const Problem *p, const Work *w, double *out) {
  for (int i = 0; i < 3 * p->scene_joints; ++i) {
    out[i] = 0;
    for (int k = p->sum_start[i]; k < p->sum_start[i + 1]; ++k)
      out[i] += p->sum_sign[k] * w->r[p->sum_of[k]];
  }
  for (int k = 0; k < p->twists; ++k)
    out[3 * p->twist_joint[k] + 2] += p->twist_sign[k] * p->actuator[p->twist_of[k]].force;
  if (!p->joints) return;
  transmitted(p, w, w->r);
  for (int i = 0; i < p->scene_joints; ++i)
    for (int k = p->lever_joint_start[i]; k < p->lever_joint_start[i + 1]; ++k) {
      int j = p->lever_joint[k];
      out[3 * i + 2] += p->lever_sign[k] * p->joint_sign[j] *
                        (w->hat[1 + 4 * j] * w->passing[2 * j] + w->hat[2 + 4 * j] * w->passing[2 * j + 1]);
    }
}

static void record(Problem *p, const Work *w, Record *to) {
  long n = p->dofs, held = p->columns - p->free, k = to->rows++;
  if (to->q) memcpy(to->q + k * n, p->q, n * sizeof(double));
  if (to->v) memcpy(to->v + k * n, p->v, n * sizeof(double));
  if (to->a) memcpy(to->a + k * n, p->a, n * sizeof(double));
  if (to->held) memcpy(to->held + k * held, p->held, held * sizeof(double));
  if (to->slides) memcpy(to->slides + k * p->slides, p->slide, p->slides * sizeof(double));
  if (to->joint_forces) joint_forces(p, w, to->joint_forces + k * 3 * p->scene_joints);
  double *momentum = w->left, *energy = to->energies + 4 * k, *sums = to->momenta + 3 * k;
  times_mass(p, p->v, momentum);
  memset(energy, 0, 4 * sizeof(double)), memset(sums, 0, 3 * sizeof(double));
  for (int i = 0; i < n; ++i) energy[0] += p->v[i] * momentum[i] / 2;
  const double *fields[5] = {w->D, w->path, p->q, p->v, p->a};
  begin_form(p, &p->energy, fields, p->t, 0);
  energy[1] = assemble_scalar(p, &p->energy, fields) + stored(p);
  if (p->weight)
    for (int i = 0; i < n; ++i) energy[2] -= p->weight[i] * p->q[i];
  energy[3] = p->work;
  for (int i = 0; i < p->nodes; ++i) {
    const int *dof = p->node_dofs + 3 * i;
    double x = p->position[2 * i] + p->q[dof[0]], y = p->position[2 * i + 1] + p->q[dof[1]];
    sums[0] += momentum[dof[0]], sums[1] += momentum[dof[1]];
    sums[2] += x * momentum[dof[1]] - y * momentum[dof[0]] + momentum[dof[2]];
  }
}

/* Dead forces at the scheme's level, with the weight, and in the mean, by which they do work. */
static void begin_loads(const Problem *p, const Work *w, const double *loads) {
  const double *start = loads, *end = loads + p->loads;
  memset(w->dead, 0, p->dofs * sizeof(double));
  memset(w->force, 0, p->dofs * sizeof(double));
  if (p->weight) memcpy(w->force, p->weight, p->dofs * sizeof(double));
  for (int k = 0; k < p->loads; ++k) {
    double at_level = (1 - p->level) * start[k] + p->level * end[k];
    for (int i = p->load_start[k]; i < p->load_start[k + 1]; ++i) {
      w->force[p->load_dof[i]] += p->load_force[i] * at_level;
      w->dead[p->load_dof[i]] += p->load_force[i] * (start[k] + end[k]) / 2;
    }
  }
}

int fx_run(Problem *p, int steps, double dt, const Ahead *ahead, Record *to) {
  Work work, *w = &work;
  lay_out(p, w, p->scratch);
  w->known = w->foretelling = 0, w->dt = dt;
  begin_inertia(p, w);
  LAP(PHASES_IN_ALL);
  int n = p->dofs, held = p->columns - p->free;
  const double *fields[5] = {w->D, w->path, p->q, p->v, p->a};
  for (int k = 0; k < steps; ++k) {
    if (k == 0 || ahead->load_stride) begin_loads(p, w, ahead->loads + k * ahead->load_stride);
    const double *target = ahead->driven + (long)k * p->driven;
    w->thrust = ahead->thrust + k * ahead->thrust_stride;
    double level = p->level, *change = w->start;
    for (int i = 0; i < p->driven; ++i) {
      int dof = p->driven_dof[i];
      change[i] = target[i] - (dof >= 0 ? p->q[dof] : p->driven_now[i]);
    }
    Form *forms[4] = {&p->residual, &p->tangent, &p->path_tangent, &p->added};
    for (int i = 0; i < 4; ++i) begin_form(p, forms[i], fields, p->t + level * dt, dt);
    LAP(AUDIT);
    p->failure = newton(p, w, dt, change);
    if (p->failure) return k;
    LAP(CHECKS);
    learn(p, w);
    LAP(GUESS);

    /* Work: dead loads, driven motion, added forces. */
    work_increment(p, w);
    for (int i = 0; i < n; ++i) p->work += w->dead[i] * w->path[i];
    for (int i = 0; i < p->actuators; ++i) p->work -= p->actuator[i].lost;
    project(p, w, w->r, w->columns);
    for (int i = 0; i < p->driven; ++i) {
      double along;
      if (p->driven_dof[i] >= 0)
        along = w->path[p->driven_dof[i]];
      else if (p->motor_slide[i] >= 0)
        along = change[i];
      else
        along = at(w->path, p->motor_b[i]) - at(w->path, p->motor_a[i]);
      p->work += mid(p, w->columns[p->free + i], p->held[i]) * along;
    }
    memcpy(p->held, w->columns + p->free, held * sizeof(double));
    if (p->has_added) {
      memset(w->f, 0, n * sizeof(double));
      assemble_vector(p, &p->added, fields, w->f);
      add_thrusts(p, w, 1, w->f);
      for (int i = 0; i < n; ++i) p->work += mid(p, w->f[i], p->added_force[i]) * w->path[i];
      memcpy(p->added_force, w->f, n * sizeof(double));
    }

    int step = to->first + k, wanted = step % to->every == 0 || step == to->last;
    if (wanted && to->before) memcpy(to->before + (long)to->rows * n, p->q, n * sizeof(double));
    advance_rates(p, w, dt);
    for (int i = 0; i < n; ++i) p->q[i] += w->D[i];
    for (int j = 0; j < p->joints; ++j)
      if (p->slide_column[j] >= 0) p->slide[p->slide_of[j]] += w->z[p->slide_column[j]];
    memcpy(p->driven_now, target, p->driven * sizeof(double));
    p->t += dt;
    p->steps_done += 1;
    if (wanted) record(p, w, to);
    LAP(AUDIT);
  }
  return steps;
}
