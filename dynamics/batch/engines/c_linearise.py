"""C source that prepares a sample: shift of the plan, measured state, active set, elimination of contact, rows, costs.

A `sample` is the structure of :mod:`dynamics.batch.engines.c_sample`, with a plan of `steps` steps. PAIRS is the number
of complementarity pairs, LIMITS that of constraint rows; COLUMNS are value, x, u and the closures' right sides. If
PRODUCT is 0, each pair has one side fixed at zero, else the law `lam gap = mu` is linearised.
"""

LINEARISE = """\
#define COLUMNS (1 + NX + NU + PAIRS)
#define VALUES (NX + 2 * PAIRS + LIMITS)
#define NG (NX + 2 * NU)
#define NF (NG + COSTS_IMPULSES * PAIRS)
static i64 evaluate_plan(sample *s) {
  i64 n = s->steps, next = 0;
  for (i64 i = 0; i < n * NU; i++) s->before[i] = i < NU ? s->u_before[i] : s->u[i - NU];
  const double *a[] = {s->x, s->before, s->u, s->x + NX, s->lam, s->p, s->p + n * PARAMETERS};
  const i64 shared[] = {0, 0, 0, 0, 0, 0, n != 1};
  double *const b[] = {s->values, s->jacobian, s->gradient, s->hessian, s->end_gradients, s->end_hessians};
  if (((batch)s->functions[2])(&next, n, n, a, shared, b) < 0) return -1;
  for (i64 k = 0; k < n; k++) {
    const double *value = s->values + k * VALUES;
    for (i64 i = 0; i < NX; i++) s->residual[k * NX + i] = *value++;
    for (i64 i = 0; i < PAIRS; i++) s->gap[k * PAIRS + i] = *value++;
    for (i64 i = 0; i < PAIRS; i++) s->mu[k * PAIRS + i] = *value++;
    for (i64 i = 0; i < LIMITS; i++) s->limits[k * LIMITS + i] = *value++;
  }
  return 0;
}
/* Closed pairs of a step: those with the larger scaled force. A contact has normal, FRICTION friction and a slip pair,
   and `mpc.active_set` says which are closed. */
static void close_pairs(const sample *s, i64 k, i64 *closed) {
  double dominance[PAIRS + 1];
  for (i64 i = 0; i < PAIRS; i++) {
    dominance[i] = s->lam[k * PAIRS + i] / s->lam_size[i] - s->gap[k * PAIRS + i] / s->gap_size[i];
    closed[i] = dominance[i] > 0.0;
  }
  for (i64 c = 0; c < CONTACTS; c++) {
    const i64 *pair = s->contacts + (FRICTION + 2) * c;
    i64 touches = closed[pair[0]], slip = pair[FRICTION + 1], brake = pair[1];
    for (i64 i = 2; i <= FRICTION; i++) if (dominance[pair[i]] > dominance[brake]) brake = pair[i];
    for (i64 i = 1; i <= FRICTION; i++)
      closed[pair[i]] = pair[i] == brake || (touches && (dominance[slip] <= 0.0 || (FRICTION > 2 && closed[pair[i]])));
    closed[slip] = 1;
  }
}
/* If a contact opens, the pair of one of its friction forces stays closed. */
static void exchange_sides(const sample *s, i64 *closed, const i64 *changed) {
  for (i64 i = 0; i < PAIRS; i++) closed[i] ^= changed[i];
  for (i64 c = 0; c < CONTACTS; c++) {
    const i64 *pair = s->contacts + (FRICTION + 2) * c;
    i64 count = 0;
    for (i64 i = 1; i <= FRICTION; i++) {
      count += closed[pair[i]];
      if (count > 1 && !closed[pair[0]]) closed[pair[i]] = 0;
    }
    if (!count) closed[pair[1]] = 1;
    closed[pair[FRICTION + 1]] = 1;
  }
}
static void choose_active_set(sample *s) {
  i64 size = s->steps * PAIRS;
  s->is_exchanged = 0;
  if (PRODUCT) return;
  for (i64 k = 0; k < s->steps; k++) close_pairs(s, k, s->closed + k * PAIRS);
  for (i64 i = 0; s->has_exchange && i < size; i++) {
    s->changed[i] = s->exchanged[i] && s->closed[i] == s->closed_before[i];
    s->is_exchanged |= s->changed[i];
  }
  for (i64 k = 0; s->is_exchanged && k < s->steps; k++)
    exchange_sides(s, s->closed + k * PAIRS, s->changed + k * PAIRS);
  for (i64 i = 0; i < size; i++) s->frictionless[i] = 0;
  for (i64 first = 0; first < size; first += PAIRS)
    for (i64 c = 0; c < (FRICTION + 2) * CONTACTS; c += FRICTION + 2)
      for (i64 i = 1; i < FRICTION + 2; i++)
        s->frictionless[first + s->contacts[c + i]] = !s->closed[first + s->contacts[c]];
}
/* Closure `a dgap + b dlam - m dmu = c` of pair i, which is entry r of the arrays. */
static void close_pair(const sample *s, i64 i, i64 r, double *a, double *b, double *m, double *c) {
  double lam = s->lam[r], gap = s->gap[r], unit = s->lam_size[i] * s->gap_size[i];
  double L = __builtin_fabs(lam) / s->lam_size[i] + FACTOR_FLOOR;
  double G = __builtin_fabs(gap) / s->gap_size[i] + FACTOR_FLOOR;
  double factor = larger(L, G);
  a[r] = PRODUCT ? L / s->gap_size[i] / factor : (double)s->closed[r];
  b[r] = PRODUCT ? G / s->lam_size[i] / factor : 1.0 - a[r];
  m[r] = PRODUCT ? 1.0 / unit / factor : 0.0;
  c[r] = PRODUCT ? (s->mu[r] - lam * gap) / unit / factor : s->closed[r] ? -gap : -lam;
}
static i64 eliminate_contact(sample *s) {
  const i64 size[] = {s->steps, NX, NU, PAIRS, LIMITS};
  double *a = s->closure, *b = a + HORIZON * PAIRS, *m = b + HORIZON * PAIRS, *c = m + HORIZON * PAIRS;
  for (i64 k = 0; k < s->steps; k++)
    for (i64 i = 0; i < PAIRS; i++) close_pair(s, i, k * PAIRS + i, a, b, m, c);
  const double *in[] = {s->jacobian, s->residual, s->gap, s->limits, a, b, m, c, s->compliance};
  double *out[] = {s->by_step, s->by_gap, s->by_limit, s->matrix};
  return eliminate(size, in, out);
}
/* Row `added + row (1, dx, du)` divided by its size, as row r of the arrays `value`, `by_x` and `by_u`. */
static void copy_affine(const double *row, double added, double size, i64 r, double *value, double *by_x,
                        double *by_u) {
  value[r] = (row[0] + added) / size;
  for (i64 i = 0; i < NX; i++) by_x[r * NX + i] = row[1 + i] / size;
  for (i64 i = 0; i < NU; i++) by_u[r * NU + i] = row[1 + NX + i] / size;
}
/* Dynamics and rows of the program: forces of closed pairs and gaps of open ones, then the constraints. */
static void fill_rows(sample *s) {
  for (i64 k = 0; k < s->steps; k++) {
    const double *z = s->by_step + k * (NX + PAIRS) * COLUMNS, *gap = s->by_gap + k * PAIRS * COLUMNS;
    for (i64 i = 0; i < NX; i++) copy_affine(z + i * COLUMNS, 0.0, 1.0, k * NX + i, s->b, s->A, s->B);
    i64 r = k * M;
    for (i64 i = 0; i < PAIRS && !PRODUCT; i++, r++) {
      static const double unit[COLUMNS] = {1.0};
      i64 at = k * PAIRS + i, closed = s->closed[at];
      const double *row = closed ? z + (NX + i) * COLUMNS : gap + i * COLUMNS;
      if (s->frictionless[at]) copy_affine(unit, 0.0, 1.0, r, s->row, s->row_by_x, s->row_by_u);
      else copy_affine(row, closed ? s->lam[at] : 0.0, closed ? s->lam_size[i] : s->gap_size[i], r, s->row, s->row_by_x,
                       s->row_by_u);
    }
    for (i64 i = 0; i < LIMITS; i++, r++)
      copy_affine(s->by_limit + (k * LIMITS + i) * COLUMNS, 0.0, 1.0, r, s->row, s->row_by_x, s->row_by_u);
  }
}
/* Derivative of multiplier i of a step in entry j of (x, input before, u). */
static double of_multiplier(const double *z, i64 i, i64 j) {
  const double *row = z + (NX + i) * COLUMNS + 1;
  return j < NX ? row[j] : j < NX + NU ? 0.0 : row[j - NU];
}
/* Gradient and Hessian of a stage cost in (x, input before, u), with the multipliers eliminated. */
static void fill_cost(const sample *s, i64 k, double *g, double *H) {
  const double *z = s->by_step + k * (NX + PAIRS) * COLUMNS, *slope = s->gradient + k * NF;
  const double *curvature = s->hessian + k * NF * NF;
  double T[NF][NG], h[NF];
  for (i64 i = 0; i < NF; i++) {
    h[i] = slope[i];
    for (i64 j = 0; j < NG; j++) T[i][j] = curvature[i * NF + j];
    for (i64 l = 0; COSTS_IMPULSES && l < PAIRS; l++) {
      double factor = curvature[i * NF + NG + l];
      h[i] += factor * z[(NX + l) * COLUMNS];
      for (i64 j = 0; j < NG; j++) T[i][j] += factor * of_multiplier(z, l, j);
    }
  }
  for (i64 i = 0; i < NG; i++) {
    g[i] = h[i];
    for (i64 j = 0; j < NG; j++) H[i * NG + j] = T[i][j];
    for (i64 l = 0; COSTS_IMPULSES && l < PAIRS; l++) {
      double factor = of_multiplier(z, l, i);
      g[i] += factor * h[NG + l];
      for (i64 j = 0; j < NG; j++) H[i * NG + j] += factor * T[NG + l][j];
    }
  }
}
/* Rotates rows and columns p < q of the symmetric A (n, n), such that A[p][q] = 0, and the columns of V. */
static void rotate(i64 n, i64 p, i64 q, double *A, double *V) {
  double ratio = (A[q * n + q] - A[p * n + p]) / (2.0 * A[p * n + q]);
  double t = (ratio < 0.0 ? -1.0 : 1.0) / (__builtin_fabs(ratio) + __builtin_sqrt(ratio * ratio + 1.0));
  double c = 1.0 / __builtin_sqrt(t * t + 1.0), s = t * c;
  for (i64 i = 0; i < n; i++) {
    double a = A[i * n + p], b = A[i * n + q];
    A[i * n + p] = c * a - s * b, A[i * n + q] = s * a + c * b;
  }
  for (i64 i = 0; i < n; i++) {
    double a = A[p * n + i], b = A[q * n + i], v = V[i * n + p], w = V[i * n + q];
    A[p * n + i] = c * a - s * b, A[q * n + i] = s * a + c * b;
    V[i * n + p] = c * v - s * w, V[i * n + q] = s * v + c * w;
  }
}
/* Makes the symmetric A (n, n) diagonal by Jacobi's method; the columns of V become its eigenvectors. */
static void diagonalise(i64 n, double *A, double *V) {
  double size = 0.0, rest = 0.0;
  for (i64 i = 0; i < n * n; i++) V[i] = i % (n + 1) == 0, size += A[i] * A[i];
  for (i64 sweep = 0; sweep < MAX_SWEEPS; sweep++, rest = 0.0) {
    for (i64 p = 0; p < n; p++)
      for (i64 q = p + 1; q < n; q++) rest += A[p * n + q] * A[p * n + q];
    if (rest <= 0x1p-104 * size) break;
    for (i64 p = 0; p < n; p++)
      for (i64 q = p + 1; q < n; q++)
        if (A[p * n + q] * A[p * n + q] > 0x1p-120 * size) rotate(n, p, q, A, V);
  }
}
/* Sets negative eigenvalues of H (n, n) to zero; returns 1 if an entry is not finite. */
static i64 project_matrix(i64 n, double *H, double *A, double *V) {
  double spoiled = 0.0;
  if (!indefinite(1, n, EIGENVALUE_ROUNDING, H, A)) return 0;
  for (i64 i = 0; i < n * n; i++) A[i] = H[i], spoiled += H[i] - H[i], H[i] = 0.0;
  if (spoiled != 0.0) return 1;
  diagonalise(n, A, V);
  for (i64 l = 0; l < n; l++)
    for (i64 i = 0; A[l * (n + 1)] > 0.0 && i < n; i++)
      for (i64 j = 0; j < n; j++) H[i * n + j] += A[l * (n + 1)] * V[i * n + l] * V[j * n + l];
  return 0;
}
static i64 fill_costs(sample *s) {
  double A[NG * NG], V[NG * NG];
  const i64 end = s->steps - 1;
  for (i64 k = 0; k <= end; k++) {
    fill_cost(s, k, s->g + k * NG, s->H + k * NG * NG);
    if (project_matrix(NG, s->H + k * NG * NG, A, V)) return 1;
  }
  for (i64 i = 0; i < NX; i++) s->end_g[i] = s->end_gradients[end * NX + i];
  for (i64 i = 0; i < NX * NX; i++) s->end_H[i] = s->end_hessians[end * NX * NX + i];
  return project_matrix(NX, s->end_H, A, V);
}
/* Gains of the regulator; all are zero if one is not finite. */
static void fill_gains(sample *s) {
  const i64 size[] = {s->steps, NX, NU};
  const double *in[] = {s->A, s->B, s->H, s->end_H};
  double *out[] = {s->gains, s->scratch}, spoiled = 0.0;
  i64 singular = riccati(size, INPUT_CURVATURE, in, out);
  for (i64 i = 0; i < s->steps * NU * NX; i++) spoiled += s->gains[i] - s->gains[i];
  for (i64 i = 0; (singular || spoiled != 0.0) && i < s->steps * NU * NX; i++) s->gains[i] = 0.0;
}
/* Next state from s->state under the input u; the state itself if the step has no solution. */
void take_step(sample *s, const double *u, double *x_next);
void take_step(sample *s, const double *u, double *x_next) {
  double theta[NU * (NX + 3)] = {0.0}, trail[2 * NX], lams[MULTIPLIERS + 1], cost, spoiled = 0.0;
  i64 next = 0;
  for (i64 i = 0; i < NU; i++) theta[NU * NX + i] = theta[NU * (NX + 1) + i] = theta[NU * (NX + 2) + i] = u[i];
  job q = {.horizon = 1, .parts = 1, .shared_x0 = 1, .shared_p = 1, .x0 = s->state, .theta = theta, .p = s->p_step,
           .cost = &cost, .trail = trail, .lams = lams};
  i64 lost = ((rollout)s->functions[0])(&next, 1, 1, &q);
  for (i64 i = 0; i < NX; i++) spoiled += trail[NX + i] - trail[NX + i];
  for (i64 i = 0; i < NX; i++) x_next[i] = lost < 0 || spoiled != 0.0 ? s->state[i] : trail[NX + i];
}
/* Shifts the plan by a step, and extends it by a step with the last feedback gain. */
void shift_plan(sample *s);
void shift_plan(sample *s) {
  i64 n = s->steps;
  double last[NU], *x = s->x + n * NX;
  for (i64 i = 0; i < NU; i++) {
    last[i] = s->u[(n - 1) * NU + i];
    for (i64 j = 0; j < NX; j++) last[i] += s->gain[i * NX + j] * (x[j] - x[j - NX]);
    last[i] = clipped(last[i], s->lower[i], s->upper[i]);
  }
  for (i64 i = 0; i < NX; i++) s->state[i] = x[i];
  for (i64 i = 0; i < n * NX; i++) s->x[i] = s->x[i + NX];
  for (i64 i = 0; i < n * NU; i++) s->u[i] = i < (n - 1) * NU ? s->u[i + NU] : last[i - (n - 1) * NU];
  for (i64 i = 0; i < (n - 1) * PAIRS; i++) s->lam[i] = s->lam[i + PAIRS], s->gap[i] = s->gap[i + PAIRS];
  take_step(s, last, x);
}
/* Moves s->state out of contact by the smallest change in characteristic sizes: Gauss-Newton steps dx = J' (J J')^+ d
   at the distances d of penetrating contacts. Eigenvalues below rounding errors belong to redundant contacts. */
void move_out(sample *s);
void move_out(sample *s) {
  double d[DISTANCES + 1], by_x[DISTANCES * NX + 1], A[DISTANCES * DISTANCES + 1], V[DISTANCES * DISTANCES + 1];
  const double *a[] = {s->state, s->physical};
  const i64 shared[] = {0, 0};
  double *const b[] = {d, by_x};
  for (i64 round = 0; round < MAX_PROJECTIONS; round++) {
    i64 next = 0, count = 0;
    if (!DISTANCES || ((batch)s->functions[3])(&next, 1, 1, a, shared, b) < 0) return;
    for (i64 i = 0; i < DISTANCES; i++) {
      if (!(d[i] < -s->ignored)) continue;
      for (i64 j = 0; j < NX; j++) by_x[count * NX + j] = by_x[i * NX + j] * s->x_size[j];
      d[count++] = d[i];
    }
    if (!count) return;
    for (i64 i = 0; i < count; i++)
      for (i64 l = 0; l < count; l++) {
        A[i * count + l] = 0.0;
        for (i64 j = 0; j < NX; j++) A[i * count + l] += by_x[i * NX + j] * by_x[l * NX + j];
      }
    diagonalise(count, A, V);
    double most = 0.0;
    for (i64 l = 0; l < count; l++) most = larger(most, A[l * (count + 1)]);
    for (i64 l = 0; l < count; l++) {
      double value = A[l * (count + 1)], share = 0.0;
      for (i64 i = 0; i < count; i++) share += V[i * count + l] * d[i];
      for (i64 i = 0; value > RANK_TOLERANCE * most && i < count; i++)
        for (i64 j = 0; j < NX; j++) s->state[j] -= s->x_size[j] * by_x[i * NX + j] * V[i * count + l] * share / value;
    }
  }
}
/* Linearises the plan and stores the program; returns 1 if a step has no linearisation, -1 without memory. */
i64 prepare_plan(sample *s);
i64 prepare_plan(sample *s) {
  if (evaluate_plan(s)) return -1;
  choose_active_set(s);
  if (eliminate_contact(s)) return 1;
  fill_rows(s);
  if (fill_costs(s)) return 1;
  fill_gains(s);
  return 0;
}
"""
