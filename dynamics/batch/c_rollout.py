"""C source of rollouts: the step's kernels inside real loops over time and inner iterations.

The text does not depend on the horizon, which is an argument. Work is done on blocks of `U`
registers of samples; what is stored between the sweeps (states, multipliers, noise) stays in the
first-level cache for problems of ordinary size.
"""

from __future__ import annotations

import math

from dynamics.batch import c_source
from dynamics.batch.c_prelude import prelude
from dynamics.batch.compiler import Compiler
from dynamics.batch.inner import NEWTON_ITERATIONS, InnerLoop
from dynamics.batch.random import INCREMENTS, MULTIPLIERS, ROUNDS, taylor
from dynamics.batch.rollout_tapes import RolloutTapes
from dynamics.batch.tape import tape_of, with_shared_reciprocals

_PHILOX = """\
INLINE void philox(i64 sample, i64 quadruple, i64 key0, i64 key1, Q *words) {
  const Q low = (Q){} + 0xffffffffull;
  Q index;
  LANES index[l] = (unsigned long long)(sample + l);
  Q c0 = index & low, c1 = index >> 32, c2 = (Q){} + (unsigned long long)quadruple, c3 = (Q){};
  unsigned k0 = (unsigned)key0, k1 = (unsigned)key1;
  for (int r = 0; r < %(rounds)d; r++) {
    Q p0 = c0 * %(m0)dull, p1 = c2 * %(m1)dull;
    c0 = (p1 >> 32) ^ c1 ^ (unsigned long long)k0;
    c2 = (p0 >> 32) ^ c3 ^ (unsigned long long)k1;
    c1 = p1 & low;
    c3 = p0 & low;
    k0 += %(i0)du;
    k1 += %(i1)du;
  }
  words[0] = c0, words[1] = c1, words[2] = c2, words[3] = c3;
}
"""

# Box and Muller. 32 bits under the exponent of 1 are a number in [1, 2); adding 1.5 * 2^52 rounds
# to the nearest integer and leaves it in the low bits. The angle in quarter turns so splits exactly
# into a quadrant and a rest within pi/4, where Taylor's series reach double precision.
_NORMALS = """\
INLINE V unit(Q word) { return (V)((word << 20) | 0x3ff0000000000000ull) - 1.0; }
INLINE void box_muller(Q a, Q b, V *even, V *odd) {
  V radius = vsqrt(-2.0 * vlog(unit(a) + 0x1p-33));
  V quarters = unit(b) * 4.0, shifted = quarters + 0x1.8p52;
  M quadrant = (M)shifted;
  V y = (quarters - (shifted - 0x1.8p52)) * %(half_pi)s, y2 = y * y, s, c;
%(series)s
  M swap = (quadrant & 1) != 0;
  V sine = pick(swap, c, s * y), cosine = pick(swap, s * y, c);
  *odd = (V)((M)(radius * sine) ^ ((quadrant & 2) << 62));
  *even = (V)((M)(radius * cosine) ^ (((quadrant + 1) & 2) << 62));
}
INLINE void four_normals(i64 sample, i64 quadruple, i64 key0, i64 key1, V *z) {
  Q words[4];
  philox(sample, quadruple, key0, key1, words);
  box_muller(words[0], words[1], z, z + 1);
  box_muller(words[2], words[3], z + 2, z + 3);
}
"""

_JOB = """\
enum { WANT_GRADIENT = 1, WANT_SCORE = 2, WANT_MOMENTS = 4 };
typedef struct {
  i64 horizon, parts, want, shared_x0, shared_theta, shared_p, noise, key0, key1, first;
  const double *x0, *theta, *p, *w, *sigma, *precision;
  double *cost, *gradient, *score, *moments;
  double baseline;
} job;
typedef struct { V *x, *lam, *w, *theta, *p, *gradient, *score, *cost; } lane_memory;
"""

_SWEEPS = """\
INLINE void fetch(const double *a, i64 size, i64 row, i64 end, i64 t, i64 n, const int write) {
  i64 lines = (end - row) * size / 8 + 1, each = lines / n + 1;
  i64 stop = (t + 1) * each < lines ? (t + 1) * each : lines;
  for (i64 k = t * each; k < stop; k++) __builtin_prefetch(a + row * size + 8 * k, write);
}
static void forward(const job *q, const lane_memory *a, int vectors, i64 next, i64 end) {
  i64 ahead = next + U * W < end ? next + U * W : end, n = q->horizon;
  for (int j = 0; j < vectors; j++) a[j].cost[0] = (V){};
  for (i64 t = 0; t < n; t++) {
    if (next < ahead) {
      if (!q->shared_theta) fetch(q->theta, q->parts * NT, next, ahead, t, n, 0);
      if (q->noise == 1) fetch(q->w, n * NU, next, ahead, t, n, 0);
    }
    for (int j = 0; j < vectors; j++) {
      V *x = a[j].x + t * NX, stage;
      const V *theta = a[j].theta + (q->parts > 1 ? t * NT : 0);
      const V *in[] = {x, theta, a[j].w + t * NU, a[j].p};
      V *out[] = {x + NX, a[j].lam + t * NL, &stage};
      one_step(in, out);
      a[j].cost[0] += stage;
    }
  }
  for (int j = 0; j < vectors; j++) {
    V last;
    const V *in[] = {a[j].x + q->horizon * NX, a[j].p};
    V *out[] = {&last};
    terminal(in, out);
    a[j].cost[0] += last;
  }
}
static void backward(const job *q, const lane_memory *a, int vectors, i64 row, i64 end) {
  V bars[U][NX + 1], part[NT + 1], before[NX + 1];
  for (int j = 0; j < vectors; j++) {
    const V *in[] = {a[j].x + q->horizon * NX, a[j].p};
    V *out[] = {bars[j]};
    terminal_adjoint(in, out);
    if (q->parts == 1) for (int k = 0; k < NT; k++) a[j].gradient[k] = (V){};
  }
  i64 last = row + U * W < end ? row + U * W : end;
  for (i64 t = q->horizon - 1; t >= 0; t--) {
    if (!(q->want & WANT_MOMENTS))
      fetch(q->gradient, q->parts * NT, row, last, q->horizon - 1 - t, q->horizon, 1);
    for (int j = 0; j < vectors; j++) {
      i64 at = q->parts > 1 ? t * NT : 0;
      V *g = a[j].gradient + at;
      const V *in[] = {a[j].x + t * NX, a[j].theta + at, a[j].w + t * NU,
                       a[j].p, a[j].lam + t * NL, bars[j]};
      V *out[] = {before, part};
      adjoint(in, out);
      for (int k = 0; k < NX; k++) bars[j][k] = before[k];
      if (q->parts > 1) for (int k = 0; k < NT; k++) g[k] = part[k];
      else for (int k = 0; k < NT; k++) g[k] += part[k];
    }
  }
}
static void scores(const job *q, const lane_memory *a, int vectors) {
  V part[NT + 1], weighed[NU + 1];
  for (int j = 0; j < vectors; j++) {
    for (i64 k = 0; k < q->parts * NT; k++) a[j].score[k] = (V){};
    for (i64 t = 0; t < q->horizon; t++) {
      i64 at = q->parts > 1 ? t * NT : 0;
      for (int k = 0; k < NU; k++) weighed[k] = a[j].w[t * NU + k] * q->precision[k];
      const V *in[] = {a[j].x + t * NX, a[j].theta + at, weighed};
      V *out[] = {part};
      score(in, out);
      for (int k = 0; k < NT; k++) a[j].score[at + k] += part[k];
    }
  }
}
"""

_INNER_GRAPHS = ("opening", "newton", "settled", "path", "followed", "closing")
_CLOSED_FORM = "#define one_step step\n"

# A lane that has come to rest keeps its value, so that a sample does not depend on its neighbours.
# NaN never looks open, and so ends the loop.
_INNER = """\
INLINE int differ(const V *a, const V *b) {
  M changed = {};
  for (int k = 0; k < 2 * NB; k++) changed |= (M)a[k] != (M)b[k];
  return any(changed);
}
static __attribute__((noinline)) void follow_path(const V *data, M open, V *lam) {
  V pair[2 * NB], moved[2 * NB], end[NB], *to[] = {moved}, *out[] = {end};
  const V *from[] = {pair, data};
  for (int k = 0; k < 2 * NB; k++) pair[k] = SPLAT(1.0);
  for (int i = 0; i < %(path_iterations)d; i++) {
    path(from, to);
    if (!differ(pair, moved)) break;
    for (int k = 0; k < 2 * NB; k++) pair[k] = moved[k];
  }
  followed(from, out);
  for (int k = 0; k < NB; k++) lam[k] = pick(open, end[k], lam[k]);
}
INLINE void solve_branch(V *lam, const V *data) {
  V moved[NB], unrest, *to[] = {moved, &unrest}, *out[] = {moved};
  const V *from[] = {lam, data};
  M open = ~(M){};
  for (int i = 0; i < %(newton_iterations)d && any(open); i++) {
    newton(from, to);
    for (int k = 0; k < NB; k++) lam[k] = pick(open, moved[k], lam[k]);
    open &= unrest != 0.0;
  }
  settled(from, out);
  for (int k = 0; k < NB; k++) lam[k] = moved[k];
  if (any(open)) follow_path(data, open, lam);
}
INLINE void one_step(const V *const in[], V *const out[]) {
  V lam[%(branches)d * NB], data[%(branches)d * ND];
  V *opened[] = {lam, data};
  opening(in, opened);
  for (int b = 0; b < %(branches)d; b++) solve_branch(lam + b * NB, data + b * ND);
  const V *all[] = {in[0], in[1], in[2], in[3], lam};
  closing(all, out);
}
"""

_LOAD = """\
static void load_block(const job *q, const lane_memory *a, i64 row, i64 end, int vectors) {
  i64 nw = q->horizon * NU, nt = q->parts * NT;
  for (int j = 0; j < vectors; j++, row += W) {
    if (!q->shared_x0) load_rows(q->x0, NX, row, end, a[j].x, 1);
    else load_shared(q->x0, NX, a[j].x);
    if (!q->shared_theta) load_rows(q->theta, nt, row, end, a[j].theta, 1);
    if (!q->shared_p) load_rows(q->p, NP, row, end, a[j].p, 1);
    if (q->noise == 1) load_rows(q->w, nw, row, end, a[j].w, 1);
    if (q->noise == 2)
      for (i64 m = 0; m < nw; m += 4) {
        V z[4];
        four_normals(q->first + row, m / 4, q->key0, q->key1, z);
        for (i64 k = 0; k < 4 && m + k < nw; k++) a[j].w[m + k] = z[k] * q->sigma[(m + k) %% NU];
      }
  }
}
"""

# One chunk's moments: sums about the first register of samples, lane by lane, then the lanes merged
# in order. Samples that are not finite, and the padding, are left out.
_MOMENTS = """\
/* A sum is finite only if all its terms are; one that overflows counts as not finite too. */
typedef struct { V *pivot, *sum, *square; M count; } accumulator;
INLINE M finite_lanes(V cost, const V *a, const V *b, i64 n, int second) {
  V spoiled[] = {cost, {}, {}, {}};
  for (i64 k = 0; k < n; k++) spoiled[k & 3] += a[k];
  if (second) for (i64 k = 0; k < n; k++) spoiled[k & 3] += b[k];
  V sum = (spoiled[0] + spoiled[1]) + (spoiled[2] + spoiled[3]);
  return sum - sum == 0.0;
}
static void accumulate(accumulator *c, i64 at, const V *value, i64 n, M ok, int starting) {
  if (starting) for (i64 k = 0; k < n; k++) c->pivot[at + k] = keep(ok, value[k]);
  for (i64 k = 0; k < n; k++) {
    V d = keep(ok, value[k] - c->pivot[at + k]);
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

_RUN = """\
INLINE M inside(i64 row, i64 end) { M m; LANES m[l] = -(i64)(row + l < end); return m; }
i64 run(i64 begin, i64 end, i64 chunk, const job *q) {
  i64 N = q->horizon, nt = q->parts * NT;
  int gradient = (q->want & WANT_GRADIENT) != 0, score = (q->want & WANT_SCORE) != 0;
  int moments = (q->want & WANT_MOMENTS) != 0;
  i64 values = 1 + nt * (gradient + score);
  i64 each = (N + 1) * NX + N * (NL + NU) + 3 * nt + NP + 1;
  V *memory = aligned_alloc(sizeof(V), sizeof(V) * (U * each + 3 * values));
  if (!memory) return -1;
  lane_memory a[U];
  V *top = memory;
  for (int j = 0; j < U; j++) {
    a[j].x = top, top += (N + 1) * NX;
    a[j].lam = top, top += N * NL;
    int own_theta = !j || !q->shared_theta, own_p = !j || !q->shared_p, own_w = !j || q->noise;
    a[j].w = own_w ? top : a[0].w, top += own_w * N * NU;
    a[j].theta = own_theta ? top : a[0].theta, top += own_theta * nt;
    a[j].p = own_p ? top : a[0].p, top += own_p * NP;
    a[j].gradient = top, top += nt;
    a[j].score = top, top += nt;
    a[j].cost = top++;
  }
  if (q->shared_theta) load_shared(q->theta, nt, a[0].theta);
  if (q->shared_p) load_shared(q->p, NP, a[0].p);
  if (!q->noise) for (i64 k = 0; k < N * NU; k++) a[0].w[k] = (V){};
  accumulator sums = {top, top + values, top + 2 * values, {}};
  for (i64 k = 0; k < 3 * values; k++) top[k] = (V){};
  i64 bad = 0;
  int starting = 1;
  for (i64 block = begin; block < end; block += U * W) {
    int vectors = end - block < U * W ? (int)((end - block + W - 1) / W) : U;
    load_block(q, a, block, end, vectors);
    forward(q, a, vectors, block + U * W, end);
    if (gradient) backward(q, a, vectors, block, end);
    if (score) scores(q, a, vectors);
    for (int j = 0; j < vectors; j++) {
      i64 row = block + j * W;
      V *g = a[j].gradient, *s = a[j].score;
      M here = inside(row, end);
      M ok = finite_lanes(a[j].cost[0], g, s, gradient ? nt : 0, score);
      if (!gradient && score) ok &= finite_lanes(a[j].cost[0], s, s, nt, 0);
      bad += count_rows(~ok, row, end);
      if (!moments) {
        store_rows(q->cost, 1, row, end, a[j].cost, 1);
        if (gradient) store_rows(q->gradient, nt, row, end, g, 1);
        if (score) store_rows(q->score, nt, row, end, s, 1);
        continue;
      }
      ok &= here;
      V gain = a[j].cost[0] - q->baseline;
      if (score) for (i64 k = 0; k < nt; k++) s[k] *= gain;
      sums.count += ok;
      accumulate(&sums, 0, a[j].cost, 1, ok, starting);
      if (gradient) accumulate(&sums, 1, g, nt, ok, starting);
      if (score) accumulate(&sums, 1 + gradient * nt, s, nt, ok, starting);
      starting = 0;
    }
  }
  if (moments) finish(&sums, values, q->moments + begin / chunk * (2 * values + 1));
  free(memory);
  return bad;
}
"""


def source(tapes: RolloutTapes, block: int, machine: Compiler) -> str:
    """The C text of a rollout on this machine, for blocks of about `block` samples."""
    loop = tapes.forward
    if isinstance(loop, InnerLoop):
        functions = {name: getattr(loop, name) for name in _INNER_GRAPHS}
        sizes = loop.n, loop.n_data
        stepping = _INNER % {
            "newton_iterations": NEWTON_ITERATIONS,
            "path_iterations": loop.path_iterations,
            "branches": loop.branches,
        }
    else:
        functions, sizes, stepping = {"step": loop}, (0, 0), _CLOSED_FORM
    for name in ("adjoint", "score", "terminal", "terminal_adjoint"):
        functions[name] = getattr(tapes, name)
    constants = {
        **{"U": max(1, block // machine.width), "NX": tapes.nx, "NU": tapes.nu, "NP": tapes.np},
        **{"NL": tapes.nlam, "NT": tapes.n_theta, "NB": sizes[0], "ND": sizes[1]},
    }
    return "".join(
        (
            prelude(machine),
            *(f"#define {name} {value}\n" for name, value in constants.items()),
            *(
                c_source.kernel(with_shared_reciprocals(tape_of(fn)), name)
                for name, fn in functions.items()
            ),
            stepping,
            random_source(),
            _JOB,
            _SWEEPS,
            _LOAD % (),
            _MOMENTS,
            _RUN,
        )
    )


def random_source() -> str:
    """C text of `four_normals`, the counter-based normals of `dynamics.batch.random`."""
    return _PHILOX % {
        **{"rounds": ROUNDS, "m0": MULTIPLIERS[0], "m1": MULTIPLIERS[1]},
        **{"i0": INCREMENTS[0], "i1": INCREMENTS[1]},
    } + _NORMALS % {"half_pi": c_source.number(math.pi / 2), "series": _series()}


def _series() -> str:
    """Taylor series in y2 = y^2, by Horner: s = sin(y) / y and c = cos(y)."""
    lines = []
    for name, first in (("s", 1), ("c", 0)):
        coefficients = taylor(first)
        lines.append(f"  {name} = SPLAT({c_source.number(coefficients[0])});")
        lines += [
            f"  {name} = fused({name}, y2, SPLAT({c_source.number(value)}));"
            for value in coefficients[1:]
        ]
    return "\n".join(lines)
