"""C source of the exponentially weighted distance average: weighted moments of the data for each query.

Chunks of `C` neighbouring points are stored coordinate by coordinate, in normalised units; the last
chunk is padded with points that are so far away that their weights are 0. With D = z'(z - 2q), which is
|z - q|² - |q|², the work on a query q has four phases, each distributed among the threads:

1. `opening`: a lower bound of D over every chunk's bounding box, and the minimum of D in the chunk
   with the lowest bound;
2. `nearest`: the point c with minimum D, in the chunks whose bound is below the minimum so far;
3. `moments`: sum_i w_i a_i b_i' over the registers with a point within the cutoff, for each part of
   the chunks;
4. `total`: the sum over the parts, in order.

The parts depend only on the number of points, and the order of every sum is fixed, so that results do not
depend on the threads or on other queries. The exponent of a weight is relative to c, |q - c|² - |q - z_i|² = -d'(d +
2(c - q)) with d = z_i - c, which does not cancel far away. Cancellation in the moments about c costs at most a
factor n of precision, since no point has a larger weight than c.
"""

from __future__ import annotations

from dynamics.batch.engines.c_prelude import vector_prelude
from dynamics.batch.engines.compiler import Compiler

POINTS_PER_BOX = 128
"""Number of points with a common bounding box; with 18 columns they fill half of the first-level cache."""
REGISTER = 8
"""Number of points in the widest SIMD register; these are the closest neighbours within a chunk."""
FAR = 1e200
"""Coordinate of padding points: its square is infinite, and its product with a weight of 0 is 0."""

_WORDS = """\
#define C {chunk}
#define VC (C / W)
#define NZ {nz}
#define NY {ny}
int sched_yield(void);
double log(double);
typedef struct {{
  i64 n_chunks, n_boxes, n_parts, n_queries, kind;
  double inverse, cutoff, reach;
  const double *z, *y, *low, *high;
  const double *q, *mean_z, *mean_y, *weights;
  double *least, *bound, *best, *partial, *sums;
  i64 *found, *where, *ticket, *done;
}} Job;
"""

# C code of exp: Cody and Waite's reduction by log(2) in two parts, the first short enough for exact
# products, and the Taylor polynomial to r^13, |r| <= log(2) / 2, whose remainder is 5e-18. Weights
# below exp(-700) are 0.
_WEIGHT = """\
INLINE V weight(V x) {
  V top = SPLAT(64.0);
  x = pick(x < top, x, top);
  V t = fused(x, SPLAT(0x1.71547652b82fep0), SPLAT(0x1.8p52)), n = t - SPLAT(0x1.8p52);
  V r = fused(n, SPLAT(-0x1.62e42feep-1), x);
  r = fused(n, SPLAT(-0x1.a39ef35793c76p-33), r);
  V p = SPLAT(1.0 / 6227020800.0);
  p = fused(p, r, SPLAT(1.0 / 479001600.0));
  p = fused(p, r, SPLAT(1.0 / 39916800.0));
  p = fused(p, r, SPLAT(1.0 / 3628800.0));
  p = fused(p, r, SPLAT(1.0 / 362880.0));
  p = fused(p, r, SPLAT(1.0 / 40320.0));
  p = fused(p, r, SPLAT(1.0 / 5040.0));
  p = fused(p, r, SPLAT(1.0 / 720.0));
  p = fused(p, r, SPLAT(1.0 / 120.0));
  p = fused(p, r, SPLAT(1.0 / 24.0));
  p = fused(p, r, SPLAT(1.0 / 6.0));
  p = fused(p, r, SPLAT(0.5));
  p = fused(p, r, SPLAT(1.0));
  p = fused(p, r, SPLAT(1.0));
  return keep(x > -700.0, (V)((Q)p + ((Q)t << 52)));
}
"""

_SEARCH = """\
INLINE V distances(const V *z, const double *q, int v) {
  V d = {0};
  UNROLL for (int k = 0; k < NZ; k++) {
    V x = z[k * VC + v];
    d = fused(x, x - SPLAT(2.0 * q[k]), d);
  }
  return d;
}
INLINE double least_of(V a) {
  double r = a[0];
  LANES r = a[l] < r ? a[l] : r;
  return r;
}
static double nearest_in(const V *z, const double *q) {
  V r = SPLAT(INFINITE);
  for (int v = 0; v < VC; v++) {
    V d = distances(z, q, v);
    r = pick(d < r, d, r);
  }
  return least_of(r);
}
static i64 place_of(const V *z, const double *q, double least) {
  for (int v = 0; v < VC; v++) {
    V d = distances(z, q, v);
    for (int l = 0; l < W; l++) if (d[l] == least) return v * W + l;
  }
  return 0;
}
INLINE const V *chunk_of(const double *data, i64 chunk, i64 size) {
  return (const V *)(data + chunk * size * C);
}
/* What rounding may have taken from D or added to it. */
INLINE double lost(const Job *j, const double *q) {
  double far = 0.0;
  for (int k = 0; k < NZ; k++) far += __builtin_fabs(q[k]);
  return (NZ + 4) * 0x1p-51 * j->reach * (j->reach + 2.0 * far);
}
static void opening(const Job *j, i64 i) {
  const double *q = j->q + i * NZ;
  V *bound = (V *)(j->least + i * j->n_boxes);
  i64 first = 0;
  for (i64 b = 0; b < j->n_boxes / W; b++) {
    V d = {0};
    UNROLL for (int k = 0; k < NZ; k++) {
      V low = ((const V *)(j->low + k * j->n_boxes))[b], at = SPLAT(q[k]);
      V high = ((const V *)(j->high + k * j->n_boxes))[b];
      at = pick(at < low, low, at);
      at = pick(at > high, high, at);
      d = fused(at, at - SPLAT(2.0 * q[k]), d);
    }
    bound[b] = d;
  }
  const double *each = j->least + i * j->n_boxes;
  for (i64 c = 1; c < j->n_chunks; c++) if (each[c] < each[first]) first = c;
  j->bound[i] = nearest_in(chunk_of(j->z, first, NZ), q);
}
static void nearest(const Job *j, i64 part) {
  i64 begin = part * j->n_chunks / j->n_parts, end = (part + 1) * j->n_chunks / j->n_parts;
  for (i64 i = 0; i < j->n_queries; i++) j->best[i * j->n_parts + part] = INFINITE;
  for (i64 c = begin; c < end; c++)
    for (i64 i = 0; i < j->n_queries; i++) {
      double *best = j->best + i * j->n_parts + part;
      double ahead = *best < j->bound[i] ? *best : j->bound[i];
      if (j->least[i * j->n_boxes + c] > ahead + lost(j, j->q + i * NZ)) continue;
      double least = nearest_in(chunk_of(j->z, c, NZ), j->q + i * NZ);
      if (least < *best) { *best = least; j->found[i * j->n_parts + part] = c; }
    }
}
"""

_MOMENTS = """\
INLINE i64 next_chunk(const double *least, i64 c, i64 end, double limit) {
  while (c < end && least[c] > limit) c++;
  return c;
}
/* The next chunk is on its way while this one is worked on. */
INLINE void fetch(const void *data, i64 size) {
  for (i64 k = 0; k < 8 * size; k += 64) __builtin_prefetch((const char *)data + k);
}
/* The registers of points of which one counts, one after the other; returns how many there are. */
INLINE int near_points(const Job *j, const double *q, const V *z, const double *cz, V *d, V *e,
                       int *from, const int kind) {
  int n = 0;
  for (int v = 0; v < VC; v++) {
    V s = {0};
    UNROLL for (int k = 0; k < NZ; k++) {
      V x = z[k * VC + v] - SPLAT(cz[k]);
      if (kind) d[k * VC + n] = x;
      s = fused(x, x + SPLAT(2.0 * (cz[k] - q[k])), s);
    }
    e[n] = s;
    from[n] = v;
    n += any(s <= j->cutoff);
  }
  return n;
}
INLINE void fill(const Job *j, i64 i, const V *y, const double *cy, const V *e, const int *from,
                 V *a, V *b, int n, const int kind) {
  const double *mz = j->mean_z + i * NZ, *my = j->mean_y + i * NY;
  const double *nu = j->weights + i * (NY + 1);
  for (int v = 0; v < n; v++) {
    V w = weight(e[v] * SPLAT(-j->inverse)), level = {0};
    a[v] = w;
    b[v] = SPLAT(1.0);
    UNROLL for (int k = 0; k < NY; k++) {
      V x = y[k * VC + from[v]] - SPLAT(cy[k]);
      if (kind < 2) a[(1 + k) * VC + v] = w * x;
      else level = fused(SPLAT(nu[k]), x - SPLAT(my[k]), level);
    }
    if (kind == 2) {
      level = w * (level + SPLAT(nu[NY]));
      UNROLL for (int k = 0; k < NZ; k++) {
        V x = b[(1 + k) * VC + v] - SPLAT(mz[k]);
        b[(1 + k) * VC + v] = x;
        a[(1 + k) * VC + v] = level * x;
      }
    }
  }
}
INLINE void gather(const Job *j, i64 part, const int kind, const int rows, const int cols,
                   void (*product)(const V *, const V *, V *, int)) {
  i64 begin = part * j->n_chunks / j->n_parts, end = (part + 1) * j->n_chunks / j->n_parts;
  int from[VC];
  V e[VC], a[(1 + (NY > NZ ? NY : NZ)) * VC], b[(1 + NZ) * VC], s[rows * cols];
  for (i64 i = 0; i < j->n_queries; i++) {
    const double *best = j->best + i * j->n_parts, *q = j->q + i * NZ;
    double *sums = j->partial + (i * j->n_parts + part) * rows * cols;
    i64 first = 0;
    for (i64 p = 1; p < j->n_parts; p++) if (best[p] < best[first]) first = p;
    i64 home = j->found[i * j->n_parts + first];
    i64 at = place_of(chunk_of(j->z, home, NZ), q, best[first]);
    double cz[NZ], cy[NY], limit = best[first] + j->cutoff + lost(j, q);
    for (int k = 0; k < NZ; k++) cz[k] = j->z[(home * NZ + k) * C + at];
    for (int k = 0; k < NY; k++) cy[k] = j->y[(home * NY + k) * C + at];
    if (part == 0) j->where[i] = home * C + at;
    for (int k = 0; k < rows * cols; k++) { s[k] = (V){0}; sums[k] = 0.0; }
    const double *least = j->least + i * j->n_boxes;
    for (i64 c = next_chunk(least, begin, end, limit), next; c < end; c = next) {
      next = next_chunk(least, c + 1, end, limit);
      if (next < end) fetch(chunk_of(j->z, next, NZ), NZ * C);
      int n = near_points(j, q, chunk_of(j->z, c, NZ), cz, b + VC, e, from, kind);
      if (!n) continue;
      if (next < end) fetch(chunk_of(j->y, next, NY), NY * C);
      fill(j, i, chunk_of(j->y, c, NY), cy, e, from, a, b, n, kind);
      product(a, b, s, n);
    }
    for (int k = 0; k < rows * cols; k++) LANES sums[k] += s[k][l];
  }
}
static void moments(const Job *j, i64 part) {
  if (j->kind == 0) gather(j, part, 0, 1 + NY, 1, product_values);
  else if (j->kind == 1) gather(j, part, 1, 1 + NY, 1 + NZ, product_slopes);
  else gather(j, part, 2, 1 + NZ, 1 + NZ, product_curved);
}
static void total(const Job *j, i64 i) {
  i64 size = j->kind == 0 ? 1 + NY : j->kind == 1 ? (1 + NY) * (1 + NZ) : (1 + NZ) * (1 + NZ);
  const double *parts = j->partial + i * j->n_parts * size;
  for (i64 k = 0; k < size; k++) j->sums[i * size + k] = parts[k];
  for (i64 p = 1; p < j->n_parts; p++)
    for (i64 k = 0; k < size; k++) j->sums[i * size + k] += parts[p * size + k];
}
"""

# C code of the four phases. A thread without work in a phase waits for the threads that still
# work on it; a thread that starts late finds no work in any phase.
_RUN = """\
INLINE void phase(const Job *j, int number, i64 n, void (*work)(const Job *, i64)) {
  i64 i;
  while ((i = __atomic_fetch_add(j->ticket + number, 1, __ATOMIC_RELAXED)) < n) {
    work(j, i);
    __atomic_fetch_add(j->done + number, 1, __ATOMIC_RELEASE);
  }
  while (__atomic_load_n(j->done + number, __ATOMIC_ACQUIRE) < n) sched_yield();
}
void run(const Job *j) {
  phase(j, 0, j->n_queries, opening);
  phase(j, 1, j->n_parts, nearest);
  phase(j, 2, j->n_parts, moments);
  phase(j, 3, j->n_queries, total);
}
"""


def ewda_source(nz: int, ny: int, compiler: Compiler) -> str:
    """Return the C text for points with ``nz`` coordinates and ``ny`` targets, for this compiler and CPU."""
    edge = 4 if compiler.width == 8 else 2
    products = (
        _product("values", 1 + ny, 1, edge, lower=False),
        _product("slopes", 1 + ny, 1 + nz, edge, lower=False),
        _product("curved", 1 + nz, 1 + nz, edge, lower=True),
    )
    blocks = [_block(rows, cols) for rows in range(1, edge + 1) for cols in range(1, edge + 1)]
    words = _WORDS.format(chunk=POINTS_PER_BOX, nz=nz, ny=ny)
    return "".join((vector_prelude(compiler), words, _WEIGHT, _SEARCH, *blocks, *products, _MOMENTS, _RUN))


def _block(rows: int, cols: int) -> str:
    """Return a C function ``s[r, c] += sum over a chunk of a[r] b[c]``, with ``rows x cols`` sums in registers."""
    pairs = [(r, c) for r in range(rows) for c in range(cols)]
    lines = [
        f"INLINE void block_{rows}_{cols}(const V *a, const V *b, V *s, int n, const int step) {{",
        *(f"  V s{r}_{c} = {{0}};" for r, c in pairs),
        "  for (int v = 0; v < n; v++) {",
        *(f"    V a{r} = a[{r} * VC + v];" for r in range(rows)),
        *(f"    V b{c} = b[{c} * VC + v];" for c in range(cols)),
        *(f"    s{r}_{c} = fused(a{r}, b{c}, s{r}_{c});" for r, c in pairs),
        "  }",
        *(f"  s[{r} * step + {c}] += s{r}_{c};" for r, c in pairs),
        "}\n",
    ]
    return "\n".join(lines)


def _product(name: str, rows: int, cols: int, edge: int, *, lower: bool) -> str:
    """Return a C function ``s += a b'`` (rows, cols) over a chunk; ``lower`` omits blocks above the diagonal."""
    lines = [f"static void product_{name}(const V *a, const V *b, V *s, int n) {{"]
    for r in range(0, rows, edge):
        for c in range(0, r + edge if lower else cols, edge):
            if c < cols:
                block = f"block_{min(edge, rows - r)}_{min(edge, cols - c)}"
                offset = r * cols + c
                lines.append(f"  {block}(a + {r} * VC, b + {c} * VC, s + {offset}, n, {cols});")
    return "\n".join((*lines, "}\n"))
