"""C source that computes the moments (count, mean, m2) of one chunk of samples."""

from __future__ import annotations

# C code of one chunk's moments: sums of differences from the first register of samples, lane by lane;
# then the lanes are merged in order. Samples that are not finite, and the padding, are left out.
MOMENTS_SOURCE = """\
/* A sum is finite only if all its terms are; one that overflows counts as not finite too. */
typedef struct { V *pivot, *sum, *square; M count; } accumulator;
INLINE void add_up(const V *a, i64 n, V *sum) {
  for (i64 k = 0; k < n; k++)
    UNROLL for (int j = 0; j < U; j++) sum[j] += a[k * U + j];
}
static void accumulate(accumulator *c, i64 at, const V *value, i64 n, M ok, int starting) {
  if (starting) for (i64 k = 0; k < n; k++) c->pivot[at + k] = keep(ok, value[k * U]);
  for (i64 k = 0; k < n; k++) {
    V d = keep(ok, value[k * U] - c->pivot[at + k]);
    c->sum[at + k] += d;
    c->square[at + k] = fused(d, d, c->square[at + k]);
  }
}
static void finish(const accumulator *c, i64 n, double *out) {
  i64 total = 0;
  LANES total += -c->count[l];
  out[0] = (double)total;
  for (i64 k = 0; k < n; k++) {
    double mean = 0.0, m2 = 0.0, count = 0.0;
    for (int l = 0; l < W; l++) {
      double more = (double)-c->count[l];
      if (more == 0.0) continue;
      double sum = c->sum[k][l], here = c->square[k][l] - sum * sum / more;
      double difference = c->pivot[k][l] + sum / more - mean, all = count + more;
      mean += difference * (more / all);
      m2 += (here > 0.0 ? here : 0.0) + difference * difference * (count * more / all);
      count = all;
    }
    out[1 + k] = mean;
    out[1 + n + k] = m2;
  }
}
"""
