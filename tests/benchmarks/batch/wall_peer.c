/* What a person would write by hand for the problem wall-1d: rollouts of a mass before a wall under
   the barrier law, cost and gradient by the inputs, many samples at once.

       v' = v + (u + lam)/m,  x' = x + h v',  lam x' = mu,
       cost = sum w_x (x - goal)^2 + w_v v^2 + w_u u^2  +  w_end (x_N - goal)^2

   Samples are the innermost axis of every work array and the loops over them are SIMD loops;
   threads take blocks. inputs and gradient are (n, N) row by row, cost is (n), n a multiple of B.
   p is m, h, x0, v0, goal, w_x, w_v, w_u, w_end, mu. */
#include <math.h>
#include <stdlib.h>

#define B 32

static void block(long N, const double *p, const double *u, double *cost, double *gradient,
                  double *work) {
  const double im = 1 / p[0], h = p[1], goal = p[4], wx = p[5], wv = p[6], wu = p[7], we = p[8];
  const double mu = p[9], F = h * im;
  double *U = work, *X = U + N * B, *R = X + N * B, *LAM = R + N * B, *V = LAM + N * B;
  double x[B], v[B], J[B], xb[B], vb[B];
  for (long i = 0; i < B; i++)
    for (long t = 0; t < N; t++) U[t * B + i] = u[i * N + t];
  for (int i = 0; i < B; i++) x[i] = p[2], v[i] = p[3], J[i] = 0;
  for (long t = 0; t < N; t++) {
    double *ut = U + t * B, *xt = X + t * B, *rt = R + t * B, *lt = LAM + t * B, *vt = V + t * B;
#pragma omp simd
    for (int i = 0; i < B; i++) {
      double off = x[i] - goal;
      J[i] += wx * off * off + wv * v[i] * v[i] + wu * ut[i] * ut[i];
      xt[i] = off;
      vt[i] = v[i];
      double w = v[i] + im * ut[i], z = x[i] + h * w;
      double r = sqrt(z * z + 4 * F * mu), q = r + fabs(z);
      double lam = (z > 0 ? 2 * mu : q) / (z > 0 ? q : 2 * F);
      rt[i] = r;
      lt[i] = lam;
      v[i] = w + im * lam;
      x[i] = x[i] + h * v[i];
    }
  }
#pragma omp simd
  for (int i = 0; i < B; i++) {
    double off = x[i] - goal;
    cost[i] = J[i] + we * off * off;
    xb[i] = 2 * we * off;
    vb[i] = 0;
  }
  for (long t = N - 1; t >= 0; t--) {
    double *ut = U + t * B, *xt = X + t * B, *rt = R + t * B, *lt = LAM + t * B, *vt = V + t * B;
#pragma omp simd
    for (int i = 0; i < B; i++) {
      double wb = vb[i] + h * xb[i], zb = -im * wb * lt[i] / rt[i];
      wb += h * zb;
      ut[i] = 2 * wu * ut[i] + im * wb;
      xb[i] += zb + 2 * wx * xt[i];
      vb[i] = wb + 2 * wv * vt[i];
    }
  }
  for (long i = 0; i < B; i++)
    for (long t = 0; t < N; t++) gradient[i * N + t] = U[t * B + i];
}

int wall(long n, long N, const double *p, const double *u, double *cost, double *gradient,
         int threads) {
#pragma omp parallel num_threads(threads)
  {
    double *work = aligned_alloc(64, sizeof(double) * 5 * N * B);
#pragma omp for schedule(static)
    for (long i = 0; i < n / B; i++)
      block(N, p, u + i * B * N, cost + i * B, gradient + i * B * N, work);
    free(work);
  }
  return 0;
}
