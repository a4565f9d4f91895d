"""C source of an interior-point method for a horizon's quadratic program: sweeps over the stages of one iteration.

The sizes NX, NU, M (rows of a stage) and BEFORE (1 if the cost has the input before, which is then part of the
state) are constants, so that the compiler unrolls the loops. The variables of a stage are q = (x, input before, u).
Constraints j < M are rows with a slack that relaxes them; further ones are the lower and upper bounds on u. Each has
a distance t and a multiplier z.
"""

SWEEPS = """\
typedef long long i64;
#define NV (NX + NU)
#define NXI (NX + BEFORE * NU)
#define NQ (NXI + NU)
#define NC (M + 2 * NU)
/* Entry of q that is entry i of (x, u), or of the next state that is input i. */
#define AT(i) ((i) < NX ? (i) : (i) + BEFORE * NU)
#define HELD(i) (NX + BEFORE * (i))
typedef double lane __attribute__((vector_size(32), aligned(8), may_alias));
typedef struct {
  double H[NQ][NQ], g[NQ], AB[NX][NV], b[NX], R[M + 1][NV], r[NC], scale[M + 1];
  i64 absent[NC];
  double q[NQ], s[SLACKS], zs[SLACKS], t[NC], z[NC], y[NX];
  double dq[NQ], ds[SLACKS], dzs[SLACKS], dt[NC], dz[NC], dy[NX];
  double slope[NQ], rb[NX], rs[SLACKS], rp[NC], W[NC], D[SLACKS], h[SLACKS][NV];
  double P[NXI][NXI], p[NXI], Q[NQ][NQ], L[NU][NU], K[NU][NXI], k[NU];
} stage;
typedef struct { i64 N, slacks; const i64 *slack_of; const double *proximal; double penalty, curvature; } program;
typedef struct { double primal, dual, gap; } residuals;
/* The larger number; NaN if one of both is. */
static inline double larger(double a, double b) { return a != a || b <= a ? a : b; }
/* The linear part of constraint j, and its addition to a gradient. */
static inline double along(const stage *a, i64 j, const double *q) {
  if (j >= M) return j < M + NU ? q[NXI + j - M] : -q[NXI + j - M - NU];
  double sum = 0.0;
  for (i64 i = 0; i < NV; i++) sum += a->R[j][i] * q[AT(i)];
  return sum;
}
static inline void add_row(const stage *a, i64 j, double factor, double *q) {
  if (j >= M + NU) q[NXI + j - M - NU] -= factor;
  else if (j >= M) q[NXI + j - M] += factor;
  else for (i64 i = 0; i < NV; i++) q[AT(i)] += factor * a->R[j][i];
}
static void evaluate_stage(const program *o, stage *a, residuals *worst) {
  for (i64 i = 0; i < NX; i++) {
    double sum = a->b[i] - a[1].q[i];
    for (i64 j = 0; j < NV; j++) sum += a->AB[i][j] * a->q[AT(j)];
    a->rb[i] = sum;
    worst->primal = larger(worst->primal, __builtin_fabs(sum));
  }
  for (i64 i = 0; i < o->slacks; i++) {
    a->rs[i] = o->penalty + o->curvature * a->s[i] - a->zs[i];
    worst->gap += a->s[i] * a->zs[i];
  }
  for (i64 j = 0; j < NC; j++) {
    if (a->absent[j]) continue;
    a->rp[j] = a->r[j] + along(a, j, a->q) - a->t[j];
    if (j < M) a->rp[j] += a->s[o->slack_of[j]], a->rs[o->slack_of[j]] -= a->z[j];
    add_row(a, j, -a->z[j], a->slope);
    worst->primal = larger(worst->primal, __builtin_fabs(a->rp[j]));
    worst->gap += a->t[j] * a->z[j];
  }
  for (i64 i = 0; i < o->slacks; i++) worst->dual = larger(worst->dual, __builtin_fabs(a->rs[i]));
}
static residuals evaluate(const program *o, stage *w) {
  residuals worst = {0.0, 0.0, 0.0};
  for (i64 k = 0; k <= o->N; k++) {
    stage *a = w + k;
    i64 size = k < o->N ? NQ : NX;
    for (i64 i = 0; i < size; i++) {
      a->slope[i] = a->g[i];
      for (i64 j = 0; j < size; j++) a->slope[i] += a->H[i][j] * a->q[j];
    }
    if (k < o->N) evaluate_stage(o, a, &worst);
  }
  for (i64 k = 0; k < o->N; k++)
    for (i64 i = k ? 0 : NX; i < NV; i++) {
      stage *a = w + k;
      double sum = a->slope[AT(i)];
      for (i64 l = 0; l < NX; l++) sum -= a->AB[l][i] * a->y[l];
      if (i < NX) sum += a[-1].y[i];
      else if (BEFORE && k + 1 < o->N) sum += a[1].slope[i];
      worst.dual = larger(worst.dual, __builtin_fabs(sum));
    }
  for (i64 i = 0; i < NX; i++)
    worst.dual = larger(worst.dual, __builtin_fabs(w[o->N].slope[i] + w[o->N - 1].y[i]));
  return worst;
}
/* Adds the sum over l < n of a[l] B[l], in this order, to a row (NV,), of which blocks stay in registers. */
static inline void add_rows(i64 n, const double *a, const double *B, double *row) {
  i64 j = 0;
  for (; j + 16 <= NV; j += 16) {
    lane *to = (lane *)(row + j), s = to[0], t = to[1], v = to[2], w = to[3];
    for (i64 l = 0; l < n; l++) {
      const lane *from = (const lane *)(B + l * NV + j);
      s += a[l] * from[0], t += a[l] * from[1], v += a[l] * from[2], w += a[l] * from[3];
    }
    to[0] = s, to[1] = t, to[2] = v, to[3] = w;
  }
  for (i64 l = 0; l < n; l++)
    for (i64 i = j; i < NV; i++) row[i] += a[l] * B[l * NV + i];
}
/* The constraints' share of the Hessian in (x, u), with the slacks eliminated. */
static void add_curvature(const program *o, stage *a, double S[NV][NV]) {
  double factors[NV][M + 1];
  for (i64 i = 0; i < o->slacks; i++) {
    a->D[i] = o->curvature + a->zs[i] / a->s[i];
    for (i64 j = 0; j < NV; j++) a->h[i][j] = 0.0;
  }
  for (i64 j = 0; j < NC; j++) {
    if (a->absent[j]) continue;
    double W = a->W[j] = a->z[j] / a->t[j];
    if (j >= M) continue;
    a->D[o->slack_of[j]] += W;
    for (i64 i = 0; i < NV; i++) a->h[o->slack_of[j]][i] += factors[i][j] = W * a->R[j][i];
  }
  for (i64 i = 0; i < NV; i++) add_rows(M, factors[i], a->R[0], S[i]);
  for (i64 j = M; j < NC; j++)
    if (!a->absent[j]) S[NX + (j - M) % NU][NX + (j - M) % NU] += a->W[j];
  for (i64 c = 0; c < o->slacks; c++)
    for (i64 i = 0; i < NV; i++)
      for (i64 l = 0; l < NV; l++) S[i][l] -= a->h[c][i] / a->D[c] * a->h[c][l];
}
/* The cost-to-go's share of the Hessian in (x, u). */
static void add_future(const stage *a, double S[NV][NV]) {
  const double (*P)[NXI] = (const double (*)[NXI])a[1].P;
  double T[NXI][NV] = {{0.0}}, column[NX];
  for (i64 i = 0; i < NXI; i++) add_rows(NX, P[i], a->AB[0], T[i]);
  for (i64 i = 0; i < NV; i++) {
    for (i64 l = 0; l < NX; l++) column[l] = a->AB[l][i];
    add_rows(NX, column, T[0], S[i]);
  }
  for (i64 i = 0; BEFORE && i < NU; i++) {
    for (i64 j = 0; j < NV; j++) S[NX + i][j] += T[HELD(i)][j], S[j][NX + i] += T[HELD(i)][j];
    for (i64 j = 0; j < NU; j++) S[NX + i][NX + j] += P[HELD(i)][HELD(j)];
  }
}
/* v becomes minus the solution of L L' x = v. */
static inline void solve_factors(const double L[NU][NU], double v[NU]) {
  for (i64 i = 0; i < NU; i++) {
    for (i64 l = 0; l < i; l++) v[i] -= L[i][l] * v[l];
    v[i] /= L[i][i];
  }
  for (i64 i = NU - 1; i >= 0; i--) {
    for (i64 l = i + 1; l < NU; l++) v[i] -= L[l][i] * v[l];
    v[i] /= L[i][i];
  }
  for (i64 i = 0; i < NU; i++) v[i] = -v[i];
}
static void factorise_stage(const program *o, stage *a) {
  double S[NV][NV] = {{0.0}}, (*L)[NU] = a->L;
  add_curvature(o, a, S);
  add_future(a, S);
  for (i64 i = 0; i < NQ; i++)
    for (i64 j = 0; j < NQ; j++) a->Q[i][j] = a->H[i][j];
  for (i64 i = 0; i < NV; i++)
    for (i64 j = 0; j < NV; j++) a->Q[AT(i)][AT(j)] += S[i][j];
  for (i64 i = 0; i < NU; i++)
    for (i64 j = 0; j <= i; j++) {
      double sum = a->Q[NXI + i][NXI + j] + (i == j ? o->proximal[i] : 0.0);
      for (i64 l = 0; l < j; l++) sum -= L[i][l] * L[j][l];
      L[i][j] = i > j ? sum / L[j][j] : __builtin_sqrt(larger(o->proximal[i], sum));
    }
  for (i64 j = 0; j < NXI; j++) {
    double v[NU];
    for (i64 i = 0; i < NU; i++) v[i] = a->Q[NXI + i][j];
    solve_factors((const double (*)[NU])L, v);
    for (i64 i = 0; i < NU; i++) a->K[i][j] = v[i];
  }
  for (i64 i = 0; i < NXI; i++)
    for (i64 j = 0; j <= i; j++) {
      double sum = a->Q[i][j];
      for (i64 l = 0; l < NU; l++) sum += a->Q[i][NXI + l] * a->K[l][j];
      a->P[i][j] = a->P[j][i] = sum;
    }
}
/* Complementarity residuals `centre - t z - second dt dz`, divided by t, are stored in dz until the forward sweep. */
static void go_backward(const program *o, stage *a, double centre, double second) {
  double m[NQ], rs[SLACKS], c[NXI];
  for (i64 i = 0; i < NQ; i++) m[i] = a->slope[i];
  for (i64 c = 0; c < o->slacks; c++) {
    a->dzs[c] = (centre - a->s[c] * a->zs[c] - second * a->ds[c] * a->dzs[c]) / a->s[c];
    rs[c] = a->dzs[c] - a->rs[c];
  }
  for (i64 j = 0; j < NC; j++) {
    if (a->absent[j]) continue;
    a->dz[j] = (centre - a->t[j] * a->z[j] - second * a->dt[j] * a->dz[j]) / a->t[j] - a->W[j] * a->rp[j];
    if (j < M) rs[o->slack_of[j]] += a->dz[j];
    add_row(a, j, -a->dz[j], m);
  }
  for (i64 c = 0; c < o->slacks; c++) {
    a->ds[c] = rs[c] / a->D[c];
    for (i64 i = 0; i < NV; i++) m[AT(i)] += a->h[c][i] * a->ds[c];
  }
  for (i64 i = 0; i < NXI; i++) {
    c[i] = a[1].p[i];
    for (i64 l = 0; l < NX; l++) c[i] += a[1].P[i][l] * a->rb[l];
  }
  for (i64 l = 0; l < NX; l++)
    for (i64 j = 0; j < NV; j++) m[AT(j)] += a->AB[l][j] * c[l];
  for (i64 i = 0; BEFORE && i < NU; i++) m[NXI + i] += c[HELD(i)];
  for (i64 i = 0; i < NU; i++) a->k[i] = m[NXI + i];
  solve_factors((const double (*)[NU])a->L, a->k);
  for (i64 i = 0; i < NXI; i++) {
    a->p[i] = m[i];
    for (i64 l = 0; l < NU; l++) a->p[i] += a->K[l][i] * m[NXI + l];
  }
}
static void go_forward(const program *o, stage *a) {
  for (i64 i = 0; i < NU; i++) {
    a->dq[NXI + i] = a->k[i];
    for (i64 j = 0; j < NXI; j++) a->dq[NXI + i] += a->K[i][j] * a->dq[j];
  }
  for (i64 i = 0; i < NX; i++) {
    double sum = a->rb[i];
    for (i64 j = 0; j < NV; j++) sum += a->AB[i][j] * a->dq[AT(j)];
    a[1].dq[i] = sum;
  }
  for (i64 i = 0; BEFORE && i < NU; i++) a[1].dq[HELD(i)] = a->dq[NXI + i];
  for (i64 i = 0; i < NX; i++) {
    double sum = a[1].p[i];
    for (i64 j = 0; j < NXI; j++) sum += a[1].P[i][j] * a[1].dq[j];
    a->dy[i] = -sum - a->y[i];
  }
  for (i64 c = 0; c < o->slacks; c++) {
    double sum = 0.0;
    for (i64 i = 0; i < NV; i++) sum += a->h[c][i] * a->dq[AT(i)];
    a->ds[c] -= sum / a->D[c];
    a->dzs[c] -= a->zs[c] / a->s[c] * a->ds[c];
  }
  for (i64 j = 0; j < NC; j++) {
    if (a->absent[j]) continue;
    double change = along(a, j, a->dq) + (j < M ? a->ds[o->slack_of[j]] : 0.0);
    a->dt[j] = a->rp[j] + change;
    a->dz[j] -= a->W[j] * change;
  }
}
/* Newton's direction; `slope` has no multipliers of the dynamics, so that y + dy are the new ones. */
static void direction(const program *o, stage *w, double centre, double second) {
  for (i64 i = 0; i < NXI; i++) w[o->N].p[i] = i < NX ? w[o->N].slope[i] : 0.0;
  for (i64 k = o->N - 1; k >= 0; k--) go_backward(o, w + k, centre, second);
  for (i64 i = 0; i < NXI; i++) w[0].dq[i] = 0.0;
  for (i64 k = 0; k < o->N; k++) go_forward(o, w + k);
}
"""
