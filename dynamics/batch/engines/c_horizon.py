"""C source of a horizon's linear algebra: elimination of contact, test of definiteness, Riccati recursion."""

ALGEBRA = """\
typedef long long i64;
/* Solves A y = B by Gaussian elimination with exchanges of rows; A (n, n) and B (n, k) are overwritten.
   A pivot that is NaN or below the rounding error of the largest entry makes the system singular. */
static i64 solve(i64 n, i64 k, double *restrict A, double *restrict B) {
  double least = 0.0;
  for (i64 i = 0; i < n * n; i++) if (__builtin_fabs(A[i]) > least) least = __builtin_fabs(A[i]);
  least *= 0x1p-53;
  for (i64 j = 0; j < n; j++) {
    i64 pivot = j;
    for (i64 i = j + 1; i < n; i++)
      if (__builtin_fabs(A[i * n + j]) > __builtin_fabs(A[pivot * n + j])) pivot = i;
    double *top = A + j * n, *other = A + pivot * n, *right = B + j * k, *other_right = B + pivot * k;
    if (!(__builtin_fabs(other[j]) > least)) return 1;
    if (pivot != j) {
      for (i64 i = j; i < n; i++) { double t = top[i]; top[i] = other[i]; other[i] = t; }
      for (i64 i = 0; i < k; i++) { double t = right[i]; right[i] = other_right[i]; other_right[i] = t; }
    }
    for (i64 i = j + 1; i < n; i++) {
      double *row = A + i * n, *side = B + i * k, factor = row[j] / top[j];
      if (factor == 0.0) continue;
      for (i64 l = j + 1; l < n; l++) row[l] -= factor * top[l];
      for (i64 l = 0; l < k; l++) side[l] -= factor * right[l];
    }
  }
  for (i64 j = n - 1; j >= 0; j--) {
    double *row = A + j * n, *side = B + j * k;
    for (i64 i = j + 1; i < n; i++) {
      double factor = row[i], *below = B + i * k;
      if (factor == 0.0) continue;
      for (i64 l = 0; l < k; l++) side[l] -= factor * below[l];
    }
    for (i64 l = 0; l < k; l++) side[l] /= row[j];
  }
  return 0;
}
/* A block (rows, nz) of columns xu.. of J, times y (nz, k), plus [value, columns 0..xu of J]. */
static void propagate(i64 rows, i64 xu, i64 nz, i64 k, i64 height, const double *J, const double *value,
                      const double *y, double *out) {
  for (i64 i = 0; i < rows; i++, out += k, J++) {
    for (i64 l = 0; l < k; l++) out[l] = 0.0;
    for (i64 j = 0; j < nz; j++) {
      double factor = J[(xu + j) * height];
      if (factor == 0.0) continue;
      for (i64 l = 0; l < k; l++) out[l] += factor * y[j * k + l];
    }
    out[0] += value[i];
    for (i64 l = 0; l < xu; l++) out[1 + l] += J[l * height];
  }
}
static i64 eliminate(const i64 *size, const double *const *in, double *const *out) {
  i64 N = size[0], nx = size[1], xu = nx + size[2], n = size[3], m = size[4];
  i64 nz = nx + n, k = 1 + xu + n, height = nx + 2 * n + m;
  const double *J = in[0], *residual = in[1], *gap = in[2], *rows = in[3];
  const double *a = in[4], *b = in[5], *by_mu = in[6], *c = in[7], *compliance = in[8];
  double *y = out[0], *A = out[3];
  for (i64 t = 0; t < N; t++, J += (xu + nz) * height, y += nz * k) {
    for (i64 i = 0; i < nz; i++) {
      const double *row = J + i, *mu = J + i + n;
      i64 pair = i - nx;
      double *side = y + i * k, by_gap = pair < 0 ? 1.0 : a[t * n + pair];
      double by = pair < 0 ? 0.0 : by_mu[t * n + pair];
      side[0] = pair < 0 ? -residual[t * nx + i] : c[t * n + pair];
      for (i64 j = 0; j < xu + nz; j++) {
        double entry = by_gap * row[j * height];
        if (by != 0.0) entry -= by * mu[j * height];
        if (j < xu) side[1 + j] = -entry;
        else A[i * nz + j - xu] = entry;
      }
      for (i64 j = 0; j < n; j++) side[1 + xu + j] = j == pair;
      if (pair >= 0) A[i * nz + i] += b[t * n + pair] + compliance[pair];
    }
    if (solve(nz, k, A, y)) return 1;
    propagate(n, xu, nz, k, height, J + nx, gap + t * n, y, out[1] + t * n * k);
    propagate(m, xu, nz, k, height, J + nx + 2 * n, rows + t * m, y, out[2] + t * m * k);
  }
  return 0;
}
/* Whether one of the matrices H (N, n, n), with `share` of its diagonal's 1-norm added, is not positive definite. */
static i64 indefinite(i64 N, i64 n, double share, const double *H, double *L) {
  for (; N > 0; N--, H += n * n) {
    double shift = 0.0;
    for (i64 i = 0; i < n; i++) shift += __builtin_fabs(H[i * n + i]);
    shift = share * shift + 1e-300;
    for (i64 i = 0; i < n; i++)
      for (i64 j = 0; j <= i; j++) {
        double sum = H[i * n + j] + (i == j ? shift : 0.0);
        for (i64 l = 0; l < j; l++) sum -= L[i * n + l] * L[j * n + l];
        if (i > j) L[i * n + j] = sum / L[j * n + j];
        else if (sum > 0.0) L[i * n + i] = __builtin_sqrt(sum);
        else return 1;
      }
  }
  return 0;
}
static i64 riccati(const i64 *size, double share, const double *const *in, double *const *out) {
  i64 N = size[0], nx = size[1], nu = size[2], z = nx + nu, nw = z + nu;
  double *V = out[1], *T = V + nx * nx, *Q = T + nx * z, *U = Q + z * z, *AB = U + z * z;
  for (i64 i = 0; i < nx * nx; i++) V[i] = in[3][i];
  for (i64 t = N - 1; t >= 0; t--) {
    double *K = out[0] + t * nu * nx, trace = 0.0;
    for (i64 l = 0; l < nx; l++)
      for (i64 j = 0; j < z; j++)
        AB[l * z + j] = j < nx ? in[0][(t * nx + l) * nx + j] : in[1][(t * nx + l) * nu + j - nx];
    for (i64 i = 0; i < nx * z; i++) T[i] = 0.0;
    for (i64 i = 0; i < nx; i++)
      for (i64 l = 0; l < nx; l++)
        for (i64 j = 0; j < z; j++) T[i * z + j] += V[i * nx + l] * AB[l * z + j];
    for (i64 i = 0; i < z; i++)
      for (i64 j = 0; j < z; j++)
        Q[i * z + j] = in[2][(t * nw + (i < nx ? i : i + nu)) * nw + (j < nx ? j : j + nu)];
    for (i64 l = 0; l < nx; l++)
      for (i64 i = 0; i < z; i++)
        for (i64 j = 0; j < z; j++) Q[i * z + j] += AB[l * z + i] * T[l * z + j];
    for (i64 i = nx; i < z; i++) trace += Q[i * z + i];
    for (i64 i = 0; i < nu; i++) {
      for (i64 j = 0; j < nu; j++) U[i * nu + j] = Q[(nx + i) * z + nx + j] + (i == j) * share * trace;
      for (i64 j = 0; j < nx; j++) K[i * nx + j] = -Q[(nx + i) * z + j];
    }
    if (solve(nu, nx, U, K)) return 1;
    for (i64 i = 0; i < nx; i++)
      for (i64 j = 0; j < nx; j++) {
        double sum = Q[i * z + j];
        for (i64 l = 0; l < nu; l++) sum += Q[i * z + nx + l] * K[l * nx + j];
        T[i * nx + j] = sum;
      }
    for (i64 i = 0; i < nx; i++)
      for (i64 j = 0; j < nx; j++) V[i * nx + j] = 0.5 * (T[i * nx + j] + T[j * nx + i]);
  }
  return 0;
}
"""
