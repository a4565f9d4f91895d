"""C source of an interior-point method for the quadratic program of a horizon, of fixed sizes."""

from __future__ import annotations

from dynamics.batch.engines.c_interior import SWEEPS

START_DISTANCE = 0.1
"""Smallest distance of a constraint from its bound at the first iterate, in characteristic sizes."""
START_PRODUCT = 0.1
"""Product of distance and multiplier of each constraint at the first iterate, in characteristic costs."""
START_SHARE = 0.9
"""Multiplier of each slack's bound at the first iterate, relative to the penalty; the slack is 1 / penalty."""
TO_BOUNDARY = 0.995
"""Share of the way to the boundary that an iterate may take."""
PROXIMAL = 1e-10
"""Curvature of inputs added in each iteration, in characteristic costs per squared characteristic size."""
LEAST_CENTRE = 1e-2
"""Smallest gap that an iteration aims at, relative to the tolerance; below it only rounding errors grow."""
MAX_ROW_VALUE = 1e4
"""Value of a row, in characteristic sizes, above which the row is scaled down."""

_PROGRAM = """\
static double inverse_step(const program *o, const stage *w) {
  double most = 0.0;
  for (i64 k = 0; k < o->N; k++) {
    const stage *a = w + k;
    for (i64 c = 0; c < o->slacks; c++) most = larger(most, larger(-a->ds[c] / a->s[c], -a->dzs[c] / a->zs[c]));
    for (i64 j = 0; j < NC; j++)
      if (!a->absent[j]) most = larger(most, larger(-a->dt[j] / a->t[j], -a->dz[j] / a->z[j]));
  }
  return most;
}
static double gap_after(const program *o, const stage *w, double share) {
  double sum = 0.0;
  for (i64 k = 0; k < o->N; k++) {
    const stage *a = w + k;
    for (i64 c = 0; c < o->slacks; c++) sum += (a->s[c] + share * a->ds[c]) * (a->zs[c] + share * a->dzs[c]);
    for (i64 j = 0; j < NC; j++)
      if (!a->absent[j]) sum += (a->t[j] + share * a->dt[j]) * (a->z[j] + share * a->dz[j]);
  }
  return sum;
}
static void move(const program *o, stage *w, double share) {
  for (i64 k = 0; k <= o->N; k++) {
    stage *a = w + k;
    for (i64 i = 0; i < (k < o->N ? NQ : NX); i++) a->q[i] += share * a->dq[i];
    if (k == o->N) break;
    for (i64 i = 0; i < NX; i++) a->y[i] += share * a->dy[i];
    for (i64 c = 0; c < o->slacks; c++) a->s[c] += share * a->ds[c], a->zs[c] += share * a->dzs[c];
    for (i64 j = 0; j < NC; j++)
      if (!a->absent[j]) a->t[j] += share * a->dt[j], a->z[j] += share * a->dz[j];
  }
}
static void load_rows(stage *a, i64 k, const double *const *in) {
  for (i64 j = 0; j < M; j++) {
    const double *by_x = in[4] + (k * M + j) * NX, *by_u = in[5] + (k * M + j) * NU;
    double value = in[3][k * M + j], first = value;
    for (i64 i = 0; k == 0 && i < NX; i++) first += by_x[i] * in[10][i];
    double scale = a->scale[j] = larger(1.0, first / MAX_ROW_VALUE);
    a->r[j] = value / scale;
    for (i64 i = 0; i < NV; i++) a->R[j][i] = (i < NX ? by_x[i] : by_u[i - NX]) / scale;
  }
  for (i64 i = 0; i < NU; i++) a->r[M + i] = -in[11][k * NU + i], a->r[M + NU + i] = in[12][k * NU + i];
  for (i64 j = 0; j < NC; j++) a->absent[j] = j >= M && __builtin_isinf(a->r[j]);
}
/* Copies the program and chooses the first iterate; returns the number of products of distance and multiplier. */
static i64 load(const program *o, stage *w, const double *const *in, double cost) {
  i64 count = o->N * o->slacks, NW = NX + 2 * NU;
  for (i64 k = 0; k < o->N; k++) {
    stage *a = w + k;
    for (i64 i = 0; i < NQ; i++) {
      i64 row = k * NW + (i < NX || BEFORE ? i : i + NU);
      a->g[i] = in[6][row] / cost;
      for (i64 j = 0; j < NQ; j++) a->H[i][j] = in[7][row * NW + (j < NX || BEFORE ? j : j + NU)] / cost;
      a->q[i] = k == 0 && i < NX ? in[10][i] : 0.0;
    }
    for (i64 i = 0; i < NX; i++) {
      const double *by_x = in[1] + (k * NX + i) * NX, *by_u = in[2] + (k * NX + i) * NU;
      a->b[i] = in[0][k * NX + i];
      a->y[i] = 0.0;
      for (i64 j = 0; j < NV; j++) a->AB[i][j] = j < NX ? by_x[j] : by_u[j - NX];
    }
    load_rows(a, k, in);
    for (i64 c = 0; c < o->slacks; c++) {
      a->s[c] = 1.0 / o->penalty, a->zs[c] = START_SHARE * o->penalty;
      a->ds[c] = a->dzs[c] = 0.0;
    }
    for (i64 j = 0; j < NC; j++) {
      a->dt[j] = a->dz[j] = 0.0;
      if (a->absent[j]) continue;
      a->t[j] = larger(START_DISTANCE, a->r[j] + along(a, j, a->q));
      a->z[j] = START_PRODUCT / a->t[j];
      count++;
    }
  }
  stage *end = w + o->N;
  for (i64 i = 0; i < NX; i++) {
    end->q[i] = 0.0;
    end->g[i] = in[8][i] / cost;
    for (i64 j = 0; j < NX; j++) end->H[i][j] = in[9][i * NX + j] / cost;
  }
  return count;
}
static double store(const program *o, const stage *w, double cost, double *const *out) {
  double violation = 0.0;
  for (i64 k = 0; k <= o->N; k++) {
    const stage *a = w + k;
    for (i64 i = 0; i < NX; i++) out[0][k * NX + i] = a->q[i];
    if (k == o->N) break;
    for (i64 i = 0; i < NU; i++) out[1][k * NU + i] = a->q[NXI + i];
    for (i64 i = 0; i < NX; i++) out[2][k * NX + i] = a->y[i] * cost;
    for (i64 j = 0; j < M; j++) out[3][k * M + j] = a->z[j] / a->scale[j] * cost;
    for (i64 c = 0; c < o->slacks; c++) violation += a->s[c];
  }
  return violation;
}
static void iterate(const program *o, stage *w, i64 count, double gap, double least) {
  stage *end = w + o->N;
  for (i64 i = 0; i < NXI; i++)
    for (i64 j = 0; j < NXI; j++) end->P[i][j] = i < NX && j < NX ? end->H[i][j] : 0.0;
  for (i64 k = o->N - 1; k >= 0; k--) factorise_stage(o, w + k);
  direction(o, w, 0.0, 0.0);
  if (count) {
    double share = 1.0 / larger(1.0, inverse_step(o, w)), ratio = gap_after(o, w, share) / gap;
    direction(o, w, larger(least, gap * ratio * ratio * ratio) / (double)count, 1.0);
  }
  move(o, w, 1.0 / larger(1.0, inverse_step(o, w) / TO_BOUNDARY));
}
i64 stage_bytes(void);
i64 stage_bytes(void) { return sizeof(stage); }
/* Returns 1 for a solution, 0 at the maximum number of iterations, -1 for values that are not finite. */
i64 solve_program(void *work, const i64 *sizes, const double *options, const double *const *in, double *const *out);
i64 solve_program(void *work, const i64 *sizes, const double *options, const double *const *in, double *const *out) {
  stage *w = work;
  double cost = options[0], tolerance = options[3], gap_tolerance = options[4];
  program o = {sizes[0], sizes[2], sizes + 3, options + 5, options[1], options[2]};
  i64 count = load(&o, w, in, cost), status = 0, iteration = 0;
  for (;; iteration++) {
    residuals r = evaluate(&o, w);
    status = r.primal <= tolerance && r.dual <= tolerance && r.gap <= gap_tolerance;
    if (!(r.primal + r.dual + r.gap < __builtin_inf())) status = -1;
    if (status || iteration == sizes[1]) break;
    iterate(&o, w, count, r.gap, LEAST_CENTRE * gap_tolerance);
  }
  out[4][0] = store(&o, w, cost, out);
  out[4][1] = (double)iteration;
  return status;
}
"""


def program_source(nx: int, nu: int, rows: int, slacks: int, before: bool) -> str:
    """Return the C text of the solver of programs with these sizes of a stage."""
    constants = {
        **{"NX": nx, "NU": nu, "M": rows, "SLACKS": slacks, "BEFORE": int(before)},
        **{"START_DISTANCE": START_DISTANCE, "START_PRODUCT": START_PRODUCT, "START_SHARE": START_SHARE},
        **{"TO_BOUNDARY": TO_BOUNDARY, "LEAST_CENTRE": LEAST_CENTRE, "MAX_ROW_VALUE": MAX_ROW_VALUE},
    }
    return "".join((*(f"#define {name} {value}\n" for name, value in constants.items()), SWEEPS, _PROGRAM))
