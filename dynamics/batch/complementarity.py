"""Solver of many small linear complementarity problems, by Mehrotra's predictor-corrector method."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numpy as np

from dynamics.batch.engines.c_flat import data_address
from dynamics.batch.engines.compiler import CompilerError, load_library

_ITERATIONS, _TO_EDGE, _LEAST = 40, 0.995, 1e-12
"""Maximum number of iterations, fraction of the longest step with positive variables, and regularisation."""
_SOLVED, _COMPLEMENTARY = 1e-9, 1e-8
"""Residual and largest product of a pair below which a problem is solved."""
_SOURCE = """\
#include <math.h>
#include <stdint.h>
typedef int64_t i64;
static int factorise(i64 m, double *A, i64 *order) {
  for (i64 k = 0; k < m; k++) {
    i64 p = k;
    for (i64 i = k + 1; i < m; i++) if (fabs(A[i * m + k]) > fabs(A[p * m + k])) p = i;
    if (!(fabs(A[p * m + k]) > 0)) return 0;
    order[k] = p;
    if (p != k) for (i64 j = 0; j < m; j++) { double a = A[k * m + j]; A[k * m + j] = A[p * m + j]; A[p * m + j] = a; }
    for (i64 i = k + 1; i < m; i++) {
      double l = A[i * m + k] /= A[k * m + k];
      if (l != 0) for (i64 j = k + 1; j < m; j++) A[i * m + j] -= l * A[k * m + j];
    }
  }
  return 1;
}
static void solve(i64 m, const double *A, const i64 *order, double *b) {
  for (i64 k = 0; k < m; k++) { double v = b[order[k]]; b[order[k]] = b[k]; b[k] = v; }
  for (i64 i = 1; i < m; i++) for (i64 j = 0; j < i; j++) b[i] -= A[i * m + j] * b[j];
  for (i64 i = m - 1; i >= 0; i--) {
    for (i64 j = i + 1; j < m; j++) b[i] -= A[i * m + j] * b[j];
    b[i] /= A[i * m + i];
  }
}
static void multiply(i64 m, const double *F, const double *v, const double *c, double *out) {
  for (i64 i = 0; i < m; i++) {
    double sum = c[i];
    for (i64 j = 0; j < m; j++) sum += F[i * m + j] * v[j];
    out[i] = sum;
  }
}
static double to_edge(i64 m, const double *lam, const double *dl, const double *s, const double *ds, double share) {
  double step = INFINITY;
  for (i64 i = 0; i < m; i++) {
    if (dl[i] < 0) step = fmin(step, -lam[i] / dl[i]);
    if (ds[i] < 0) step = fmin(step, -s[i] / ds[i]);
  }
  return fmin(1.0, share * step);
}
static int one(i64 m, const double *F, const double *z, double *w, i64 *order, const double *o, double *lam) {
  double *A = w, *s = A + m * m, *r = s + m, *dl = r + m, *ds = dl + m;
  const double tolerance = o[0], product_tolerance = o[1], share = o[2], least = o[3];
  for (i64 i = 0; i < m; i++) lam[i] = 1;
  multiply(m, F, lam, z, s);
  for (i64 i = 0; i < m; i++) s[i] = fmax(s[i], 1.0);
  for (i64 k = 0; k < (i64)o[4]; k++) {
    double worst = 0, largest = 0, mean = 0;
    multiply(m, F, lam, z, r);
    for (i64 i = 0; i < m; i++) {
      r[i] -= s[i];
      if (!isfinite(r[i]) || !isfinite(lam[i])) return 0;
      worst = fmax(worst, fabs(r[i]));
      largest = fmax(largest, lam[i] * s[i]);
      mean += lam[i] * s[i] / (double)m;
    }
    if (worst < tolerance && largest < product_tolerance) return 1;
    for (i64 i = 0; i < m; i++) {
      for (i64 j = 0; j < m; j++) A[i * m + j] = F[i * m + j];
      A[i * m + i] += s[i] / lam[i] + least;
      dl[i] = -s[i] - r[i];
    }
    if (!factorise(m, A, order)) return 0;
    solve(m, A, order, dl);
    multiply(m, F, dl, r, ds);
    double step = to_edge(m, lam, dl, s, ds, share), predicted = 0;
    for (i64 i = 0; i < m; i++) predicted += (lam[i] + step * dl[i]) * (s[i] + step * ds[i]) / (double)m;
    double ratio = predicted / mean, mu = mean * fmin(fmax(ratio * ratio * ratio, 1e-6), 1.0);
    for (i64 i = 0; i < m; i++) dl[i] = (mu - dl[i] * ds[i]) / lam[i] - s[i] - r[i];
    solve(m, A, order, dl);
    multiply(m, F, dl, r, ds);
    step = to_edge(m, lam, dl, s, ds, share);
    for (i64 i = 0; i < m; i++) { lam[i] += step * dl[i]; s[i] += step * ds[i]; }
  }
  return 0;
}
void solve_problems(i64 S, i64 n, const double *F, const double *z, const unsigned char *is_pair, const double *o,
                    double *w, i64 *index, double *lam) {
  double *dense = w, *offset = dense + n * n, *impulse = offset + n, *rest = impulse + n;
  for (i64 k = 0; k < S; k++) {
    i64 m = 0;
    for (i64 i = 0; i < n; i++) if (is_pair[k * n + i]) index[m++] = i;
    for (i64 i = 0; i < m; i++) {
      offset[i] = z[k * n + index[i]];
      for (i64 j = 0; j < m; j++) dense[i * m + j] = F[(k * n + index[i]) * n + index[j]];
    }
    int solved = one(m, dense, offset, rest, index + n, o, impulse);
    for (i64 i = 0; i < n; i++) lam[k * n + i] = solved ? 0.0 : NAN;
    if (solved) for (i64 i = 0; i < m; i++) lam[k * n + index[i]] = impulse[i];
  }
}
"""


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    """Return the compiled library, or None without a C compiler."""
    try:
        library = load_library(_SOURCE, ["solve_problems"], level=3)
    except CompilerError:
        return None
    library.solve_problems.argtypes = [ctypes.c_int64] * 2 + [ctypes.c_void_p] * 7
    library.solve_problems.restype = None
    return library


def linear_complementarity(F: np.ndarray, z: np.ndarray, is_pair: np.ndarray) -> np.ndarray:
    """Return lam (S, n) with ``0 <= lam ⟂ z + F lam >= 0``, F (S, n, n), z (S, n); NaN if that fails.

    Pairs for which ``is_pair`` (S, n) is False are ignored, and their lam is zero. The solver is compiled if there is a
    C compiler.
    """
    library = _library() if z.size else None
    if library is None:
        return interpreted_complementarity(F, z, is_pair)
    (S, n), options = z.shape, np.array([_SOLVED, _COMPLEMENTARY, _TO_EDGE, _LEAST, _ITERATIONS], float)
    inputs = [np.ascontiguousarray(F, float), np.ascontiguousarray(z, float), np.ascontiguousarray(is_pair, np.uint8)]
    work, index, lam = np.empty(2 * n * n + 6 * n), np.empty(2 * n, np.int64), np.empty((S, n))
    # Every array has a name, so that its memory lives until the call returns.
    library.solve_problems(S, n, *map(data_address, [*inputs, options, work, index, lam]))
    return lam


def interpreted_complementarity(F: np.ndarray, z: np.ndarray, is_pair: np.ndarray) -> np.ndarray:
    """Return what :func:`linear_complementarity` does, by NumPy."""
    lam = np.where(is_pair, 1.0, 0.0)
    slack = np.maximum(z + (F @ lam[:, :, None])[:, :, 0], 1.0)
    multipliers, unsolved = np.full(z.shape, np.nan), np.arange(len(z))
    for _ in range(_ITERATIONS):
        m, s, is_real, matrix = lam[unsolved], slack[unsolved], is_pair[unsolved], F[unsolved]
        residual = np.where(is_real, z[unsolved] + (matrix @ m[:, :, None])[:, :, 0] - s, 0.0)
        product = np.where(is_real, m * s, 0.0)
        solved = (np.abs(residual).max(axis=1) < _SOLVED) & (product.max(axis=1) < _COMPLEMENTARY)
        multipliers[unsolved[solved]] = m[solved]
        if (solved | ~np.isfinite(m).all(axis=1)).all():
            break
        is_running = ~solved & np.isfinite(m).all(axis=1)
        unsolved, m, s, is_real, matrix, residual, product = (
            array[is_running] for array in (unsolved, m, s, is_real, matrix, residual, product)
        )
        count = np.maximum(is_real.sum(axis=1), 1)[:, None]
        mean = product.sum(axis=1)[:, None] / count
        dl, ds = _direction(m, s, matrix, residual, np.zeros_like(mean), is_real)
        step = _to_edge(m, dl, s, ds, is_real)
        predicted_mean = np.where(is_real, (m + step * dl) * (s + step * ds), 0).sum(axis=1)[:, None] / count
        mu = mean * np.clip((predicted_mean / mean) ** 3, 1e-6, 1.0)
        dl, ds = _direction(m, s, matrix, residual, mu - dl * ds, is_real)
        step = _to_edge(m, dl, s, ds, is_real)
        lam[unsolved], slack[unsolved] = m + step * dl, s + step * ds
    return multipliers


def _direction(
    lam: np.ndarray,
    slack: np.ndarray,
    F: np.ndarray,
    residual: np.ndarray,
    mu: np.ndarray,
    is_real: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Newton direction of multipliers and gaps, (S, n) each."""
    matrix, n = F.copy(), np.arange(lam.shape[1])
    safe = np.where(is_real, lam, 1.0)
    matrix[:, n, n] += np.where(is_real, slack / safe + _LEAST, 1.0)
    right = np.where(is_real, mu / safe - slack - residual, 0.0)
    try:
        dl = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        # NumPy solves no system if one matrix is singular: solve the others without this one.
        regular = np.linalg.cond(matrix) < 1 / np.finfo(float).eps
        dl = np.full(lam.shape, np.nan)
        dl[regular] = np.linalg.solve(matrix[regular], right[regular][:, :, None])[:, :, 0]
    return dl, np.where(is_real, (F @ dl[:, :, None])[:, :, 0] + residual, 0.0)


def _to_edge(lam: np.ndarray, dl: np.ndarray, slack: np.ndarray, ds: np.ndarray, is_real: np.ndarray) -> np.ndarray:
    """Return the longest step (S, 1), at most 1, that keeps multipliers and slacks positive."""
    edge_steps = [np.where(is_real & (d < 0), -v / np.where(d < 0, d, -1), np.inf) for v, d in ((lam, dl), (slack, ds))]
    return np.minimum(1.0, _TO_EDGE * np.minimum(*edge_steps).min(axis=1))[:, None]
