"""C source that rolls out candidate plans with their merits, by compiled rollouts and stage costs."""

CANDIDATES = """\
typedef i64 (*rollout)(i64 *next, i64 n, i64 chunk, const job *q);
typedef i64 (*batch)(i64 *next, i64 n, i64 chunk, const double *const *a, const i64 *shared, double *const *b);
typedef struct { i64 S, N, nx, nu, n, nl, m, np; } counts;
static double clipped(double v, double low, double high) { return v < low ? low : v > high ? high : v; }
/* Rows (K, k, low, high) of each step; every candidate has its own. */
static void fill_policy(const counts *z, const double *const *in, double *theta) {
  for (i64 r = 0; r < z->S * z->N; r++) {
    for (i64 i = 0; i < z->nu * z->nx; i++) *theta++ = in[1][r * z->nu * z->nx + i];
    for (i64 i = 0; i < z->nu; i++) *theta++ = in[2][r * z->nu + i];
    for (i64 side = 3; side < 5; side++)
      for (i64 i = 0; i < z->nu; i++) *theta++ = in[side][i];
  }
}
/* Arguments (x, input before, u, x_next, lam, p) of the stage costs at every step of every candidate. */
static void fill_stages(const counts *z, const double *const *in, const double *x, const double *lam, double **to) {
  for (i64 r = 0; r < z->S * z->N; r++) {
    i64 k = r % z->N;
    const double *now = x + (r + r / z->N) * z->nx, *K = in[1] + r * z->nu * z->nx;
    for (i64 i = 0; i < z->nx; i++) to[0][r * z->nx + i] = now[i], to[3][r * z->nx + i] = now[z->nx + i];
    for (i64 i = 0; i < z->nu; i++) {
      double u = 0.0;
      for (i64 j = 0; j < z->nx; j++) u += K[i * z->nx + j] * now[j];
      to[2][r * z->nu + i] = clipped(u + in[2][r * z->nu + i], in[3][i], in[4][i]);
      to[1][r * z->nu + i] = k ? to[2][(r - 1) * z->nu + i] : in[5][i];
    }
    for (i64 i = 0; i < z->n; i++) to[4][r * z->n + i] = lam[r * z->nl + i];
    for (i64 i = 0; i < z->np; i++) to[5][r * z->np + i] = in[6][k * z->np + i];
  }
}
/* Candidates `u + share du + K (x - x_plan - share dx)`; the first one has K = 0. in: K, x, u, dx, du, shares. */
static void steer_candidates(const counts *z, const double *const *in, double *const *out) {
  i64 rows = z->N * z->nu;
  for (i64 s = 0; s < z->S; s++)
    for (i64 r = 0; r < rows; r++) {
      const double *K = in[0] + r * z->nx, *x = in[1] + r / z->nu * z->nx, *dx = in[3] + r / z->nu * z->nx;
      double fed_x = 0.0, fed_dx = 0.0, *gains = out[0] + (s * rows + r) * z->nx;
      for (i64 i = 0; i < z->nx; i++) gains[i] = s ? K[i] : 0.0, fed_x += K[i] * x[i], fed_dx += K[i] * dx[i];
      out[1][s * rows + r] = s ? in[2][r] - fed_x + in[5][s] * (in[4][r] - fed_dx) : in[2][r];
    }
}
/* in: x0, K, k, lower, upper, input before, parameters of the stages (N+1), parameters of the step.
   out: states, merits, u, lam, violations, gaps, work. Returns -1 without memory. */
static i64 roll_candidates(const counts *z, void *const *functions, double penalty, const double *const *in,
                           double *const *out) {
  i64 rows = z->S * z->N, next = 0;
  double *top = out[6], *theta = top, *lam = theta + rows * z->nu * (z->nx + 3), *total = lam + rows * z->nl;
  double *x = total + z->S, *before = x + rows * z->nx, *x_next = before + rows * z->nu;
  double *p = x_next + rows * z->nx, *cost = p + rows * z->np, *end = cost + rows;
  fill_policy(z, in, theta);
  job q = {.horizon = z->N, .parts = z->N, .shared_x0 = 1, .shared_p = 1, .x0 = in[0], .theta = theta, .p = in[7],
           .cost = total, .trail = out[0], .lams = lam};
  if (((rollout)functions[0])(&next, z->S, z->S, &q) < 0) return -1;
  double *arguments[] = {x, before, out[2], x_next, out[3], p};
  fill_stages(z, in, out[0], lam, arguments);
  const double *a[] = {x, before, out[2], x_next, out[3], p, in[6] + z->N * z->np};
  const i64 shared[] = {0, 0, 0, 0, 0, 0, rows != 1, 0};
  double *const b[] = {cost, out[4], out[5], end};
  next = 0;
  if (((batch)functions[1])(&next, rows, rows, a, shared, b) < 0) return -1;
  for (i64 s = 0; s < z->S; s++) {
    double violation = 0.0, spoiled = 0.0, sum = end[(s + 1) * z->N - 1];
    for (i64 i = s * (z->N + 1) * z->nx; i < (s + 1) * (z->N + 1) * z->nx; i++) spoiled += out[0][i] - out[0][i];
    for (i64 i = s * z->N * z->n; i < (s + 1) * z->N * z->n; i++) spoiled += out[3][i] - out[3][i];
    for (i64 i = s * z->N * z->m; i < (s + 1) * z->N * z->m; i++) violation += out[4][i];
    for (i64 k = s * z->N; k < (s + 1) * z->N; k++) sum += cost[k];
    sum += penalty * violation;
    out[1][s] = spoiled == 0.0 && sum - sum == 0.0 ? sum : __builtin_inf();
  }
  return 0;
}
"""
