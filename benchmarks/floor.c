/* Steps of the pinned beam by EnergyMomentum, written for this one problem: two-node elements of equal length and
   section on a line, node 0 pinned. Newton's method with a cubic prediction, an exact tangent, and a block-tridiagonal
   elimination; nothing is checked, recorded or reported. It is the least that a general code could cost. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* x, y and psi of all nodes are stored one behind the other, so that loops over elements are vectorised. */
typedef struct {
  int elements, nodes;
  double length, EA, GA, EI, rhoA, rhoI;
  double *q, *v; /* with room for CHUNK values behind */
} Beam;

enum { CHUNK = 8 };
typedef double Lanes __attribute__((vector_size(8 * CHUNK)));

/* Eliminates a node: its right side becomes what it is without the next node, and its coupling the factor of that. */
static inline void eliminate(const double *a, double *up, double *b) {
  double c0 = a[4] * a[8] - a[5] * a[7], c1 = a[5] * a[6] - a[3] * a[8], c2 = a[3] * a[7] - a[4] * a[6];
  double by = 1 / (a[0] * c0 + a[1] * c1 + a[2] * c2);
  double inverse[9] = {c0 * by, (a[2] * a[7] - a[1] * a[8]) * by, (a[1] * a[5] - a[2] * a[4]) * by,
                       c1 * by, (a[0] * a[8] - a[2] * a[6]) * by, (a[2] * a[3] - a[0] * a[5]) * by,
                       c2 * by, (a[1] * a[6] - a[0] * a[7]) * by, (a[0] * a[4] - a[1] * a[3]) * by};
  double x[3], U[9];
  for (int i = 0; i < 3; ++i) {
    const double *row = inverse + 3 * i;
    x[i] = row[0] * b[0] + row[1] * b[1] + row[2] * b[2];
    for (int j = 0; j < 3; ++j) U[3 * i + j] = row[0] * up[j] + row[1] * up[3 + j] + row[2] * up[6 + j];
  }
  memcpy(b, x, sizeof x), memcpy(up, U, sizeof U);
}

static inline Lanes load(const double *from) {
  Lanes x;
  memcpy(&x, from, sizeof x);
  return x;
}

/* Cosines as sines, as the compiler has no vectors for both at once. */
static inline void sines(Lanes x, Lanes *sine, Lanes *cosine) {
  double both[2 * CHUNK];
  Lanes ahead = x + M_PI / 2;
  memcpy(both, &x, sizeof x), memcpy(both + CHUNK, &ahead, sizeof x);
  for (int e = 0; e < 2 * CHUNK; ++e) both[e] = sin(both[e]);
  *sine = load(both), *cosine = load(both + CHUNK);
}

/* Forces f and tangents K of some elements for the increment D, of x, y, psi of both nodes. */
static inline void elements(const Beam *b, int first, const double *D, Lanes *f, Lanes (*K)[6]) {
  const double *x = b->q + first, *y = x + b->nodes, *psi = y + b->nodes, l = b->length, EA = b->EA, GA = b->GA;
  const double *Dx = D + first, *Dy = Dx + b->nodes, *Dpsi = Dy + b->nodes, EI = b->EI;
  Lanes x0 = 1 + (load(x + 1) - load(x)) / l, y0 = (load(y + 1) - load(y)) / l;
  Lanes x1 = x0 + (load(Dx + 1) - load(Dx)) / l, y1 = y0 + (load(Dy + 1) - load(Dy)) / l;
  Lanes h = (load(Dpsi) + load(Dpsi + 1)) / 4, d = (load(Dpsi + 1) - load(Dpsi)) / 4, Km, c0, s0, sh, ch, sd, cd;
  Km = (load(psi + 1) - load(psi) + 2 * d) / l;
  sines((load(psi) + load(psi + 1)) / 2, &s0, &c0), sines(h, &sh, &ch), sines(d, &sd, &cd);
  Lanes sin2h = 2 * sh * ch, cos2h = ch * ch - sh * sh, c1 = c0 * cos2h - s0 * sin2h, s1 = s0 * cos2h + c0 * sin2h;
  /* mean strains and forces; n . W phi' */
  Lanes Nx = EA * ((c0 * x0 + s0 * y0 + c1 * x1 + s1 * y1) / 2 - 1);
  Lanes Ny = GA * (-s0 * x0 + c0 * y0 - s1 * x1 + c1 * y1) / 2, c = (c0 + c1) / 2, s = (s0 + s1) / 2;
  Lanes nx = c * Nx - s * Ny, ny = s * Nx + c * Ny, xm = (x0 + x1) / 2, ym = (y0 + y1) / 2, turning = ny * xm - nx * ym;
  Lanes th = sh / ch, td = sd / cd, d2 = d * d; /* ratio: 2 d / sin 2 d, and its derivative */
  Lanes ratio = 1 + d2 * (2. / 3 + d2 * (14. / 45 + d2 * (124. / 945)));
  Lanes slope = d * (4. / 3 + d2 * (56. / 45 + d2 * (248. / 315)));
  Lanes both = ch * ch * cd * cd - sh * sh * sd * sd, part = l / 2 * th * td;
  Lanes m = EI * Km * ratio * both + turning * part, half = l / 2 * turning;
  f[0] = -nx, f[1] = -ny, f[2] = -half - m, f[3] = nx, f[4] = ny, f[5] = m - half;
  /* by phi' over the length, and by half of psi at the end */
  Lanes ax = EA / 2 / l * c1, ay = EA / 2 / l * s1, gx = -GA / 2 / l * s1, gy = GA / 2 / l * c1;
  Lanes nxx = c * ax - s * gx, nxy = c * ay - s * gy, nyx = s * ax + c * gx, nyy = s * ay + c * gy;
  Lanes tx = EA / 2 * (c1 * y1 - s1 * x1), ty = -GA / 2 * (c1 * x1 + s1 * y1);
  Lanes nxp = (c * tx - s * ty - (s1 * Nx + c1 * Ny) / 2) / 2, nyp = (s * tx + c * ty + (c1 * Nx - s1 * Ny) / 2) / 2;
  Lanes mx = nyx * xm - nxx * ym + ny / (2 * l), my = nyy * xm - nxy * ym - nx / (2 * l), mp = nyp * xm - nxp * ym;
  Lanes by_h = (half * td / (ch * ch) - EI * Km * ratio * sin2h) / 4;
  Lanes by_d = half * th / (cd * cd) + EI * (2 / l * ratio * both + Km * (slope * both - ratio * 2 * sd * cd));
  Lanes rows[3][6] = {{nxx, nxy, -nxp, -nxx, -nxy, -nxp}, {nyx, nyy, -nyp, -nyx, -nyy, -nyp}};
  Lanes dm[6] = {-part * mx, -part * my, part * mp + by_h - by_d / 4, part * mx, part * my, part * mp + by_h + by_d / 4};
  Lanes dt[6] = {mx, my, -mp, -mx, -my, -mp};
  for (int j = 0; j < 6; ++j) {
    K[0][j] = rows[0][j], K[1][j] = rows[1][j], K[3][j] = -rows[0][j], K[4][j] = -rows[1][j];
    K[2][j] = l / 2 * dt[j] - dm[j], K[5][j] = l / 2 * dt[j] + dm[j];
  }
}

/* Takes steps; returns the number of iterations. Increments are predicted from those of the last `order` steps. */
long fx_floor(int n, double length, const double *section, double *q, double *v, double dt, int steps, int order) {
  int N = n + 1, room = N + CHUNK;
  Beam b = {n, N, length, section[0], section[1], section[2], section[3], section[4], q, v};
  double *past = calloc(31 * room, sizeof(double)), *D = past + 9 * N, *acc = D + 3 * N, *slope = acc + 3 * N;
  double *r = slope + 3 * N, *up = r + 3 * N;
  Lanes f[6], K[6][6];
  long all = 0;
  for (int step = 0; step < steps; ++step) {
    double last = HUGE_VAL, slowest = 0;
    int known = step < order ? step : order;
    for (int i = 0; i < 3 * N; ++i)
      D[i] = known == 3   ? 3 * past[i] - 3 * past[3 * N + i] + past[6 * N + i]
             : known == 2 ? 2 * past[i] - past[3 * N + i]
                          : known * past[i];
    for (int iteration = 1; iteration < 40; ++iteration) {
      ++all;
      for (int i = 0; i < 2 * N; ++i) acc[i] = 2 / dt * (D[i] / dt - v[i]);
      for (int i = 2 * N; i < 3 * N; ++i) {
        double t = tan(D[i] / 2);
        acc[i] = 2 / dt * (2 / dt * t - v[i]), slope[i] = 2 / (dt * dt) * (1 + t * t);
      }
      double own[9] = {0}, right[3] = {0};
      for (int first = 0; first < n; first += CHUNK) {
        elements(&b, first, D, f, K);
        int count = n - first < CHUNK ? n - first : CHUNK;
        for (int k = 0; k < count; ++k) {
          int e = first + k;
          double next[9], down[9], to[3], *U = up + 9 * e, *x = r + 3 * e;
          for (int i = 0; i < 3; ++i) {
            double mass = (i < 2 ? b.rhoA : b.rhoI) * length / 6, one = acc[i * N + e], other = acc[i * N + e + 1];
            x[i] = right[i] + f[i][k] + mass * (2 * one + other);
            to[i] = f[3 + i][k] + mass * (one + 2 * other);
            for (int j = 0; j < 3; ++j) {
              own[3 * i + j] += K[i][j][k], U[3 * i + j] = K[i][3 + j][k];
              down[3 * i + j] = K[3 + i][j][k], next[3 * i + j] = K[3 + i][3 + j][k];
            }
            double at_one = i < 2 ? 2 / (dt * dt) : slope[2 * N + e], at_other = i < 2 ? at_one : slope[2 * N + e + 1];
            own[4 * i] += 2 * mass * at_one, U[4 * i] += mass * at_other;
            down[4 * i] += mass * at_one, next[4 * i] += 2 * mass * at_other;
          }
          for (int i = 0; i < 2 && !e; ++i) { /* the pin */
            for (int j = 0; j < 3; ++j) own[3 * i + j] = i == j, U[3 * i + j] = 0;
            x[i] = 0;
          }
          eliminate(own, U, x);
          for (int i = 0; i < 3; ++i) {
            const double *d = down + 3 * i;
            for (int j = 0; j < 3; ++j) next[3 * i + j] -= d[0] * U[j] + d[1] * U[3 + j] + d[2] * U[6 + j];
            right[i] = to[i] - d[0] * x[0] - d[1] * x[1] - d[2] * x[2];
          }
          memcpy(own, next, sizeof own);
        }
      }
      double none[9] = {0}, size = 0, x[3];
      eliminate(own, none, right);
      memcpy(x, right, sizeof x);
      for (int k = n; k >= 0; --k) {
        for (int i = 0; i < 3 && k < n; ++i) {
          const double *U = up + 9 * k + 3 * i;
          r[3 * k + i] -= U[0] * x[0] + U[1] * x[1] + U[2] * x[2];
        }
        if (k < n) memcpy(x, r + 3 * k, sizeof x);
        for (int i = 0; i < 3; ++i) D[i * N + k] -= x[i];
        size = fmax(size, fmax(fmax(fabs(x[0]), fabs(x[1])) / (n * length), fabs(x[2])));
      }
      slowest = fmax(slowest, size / (last * last)), last = size;
      if (size <= 1e-15 || (iteration > 2 && slowest * size * size <= 1e-15)) break;
    }
    memmove(past + 3 * N, past, 6 * N * sizeof(double)), memcpy(past, D, 3 * N * sizeof(double));
    for (int i = 0; i < 2 * N; ++i) v[i] = 2 / dt * D[i] - v[i], q[i] += D[i];
    for (int i = 2 * N; i < 3 * N; ++i) v[i] = 4 / dt * tan(D[i] / 2) - v[i], q[i] += D[i];
  }
  free(past);
  return all;
}
