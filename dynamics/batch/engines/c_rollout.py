"""C source of rollouts: the step's kernels inside loops over time and inner iterations.

The text does not depend on the horizon, which is an argument. The loops work on blocks of `U`
registers of samples, so that what is stored between the sweeps (states, multipliers, noise) stays in
the first-level cache for problems of ordinary size.
"""

from __future__ import annotations

from dynamics.batch.engines import c_dense, c_random, c_steps
from dynamics.batch.engines.c_prelude import vector_prelude
from dynamics.batch.engines.compiler import Compiler
from dynamics.batch.graphs.step_graphs import RolloutTapes

_MEMORY = """\
#if DENSE && !PER_SAMPLE
typedef const double *weights_at;
#else
typedef V *weights_at;
#endif
typedef struct {
  V *x, *lam, *w, *theta, *p, *gradient, *score, *cost, *after;
  weights_at weights;
  i64 w_step, ts, theta_step;
} memory;
"""

# C code of the forward sweep. Entry k of an array for register j of a block is at index k U + j.
# The stride ts of theta's entries is U, or 1 where all samples share theta; PS is the same for p.
_FORWARD = """\
typedef struct { const char *at, *stop; i64 each; } lines;
INLINE lines lines_of(const double *a, i64 size, i64 row, i64 end, i64 turns) {
  const char *at = (const char *)(a + row * size), *stop = (const char *)(a + end * size);
  if (row >= end) stop = at;
  return (lines){at, stop, ((stop - at) / 64 / turns + 1) * 64};
}
INLINE const char *next_stop(lines f) { return f.at + f.each < f.stop ? f.at + f.each : f.stop; }
#define FETCH(f, write) \\
  for (const char *stop = next_stop(f); f.at < stop; f.at += 64) __builtin_prefetch(f.at, write)
INLINE int all_over(const V *x) {
  M on = x[END_ENTRY * U] > 0.0;
  for (int j = 1; j < U; j++) on |= x[END_ENTRY * U + j] > 0.0;
  return !any(on);
}
/* Returns after how many steps all samples of the block are over; from there on nothing moves. */
static i64 forward(const job *q, const memory *a, i64 live, i64 next, i64 end) {
  (void)live;
  i64 ahead = next + U * W < end ? next + U * W : end, n = q->horizon, ts = a->ts;
  i64 theta_step = a->theta_step, rows = q->shared_theta || DENSE ? next : ahead;
  lines theta_lines = lines_of(q->theta, q->parts * NT, next, rows, n);
  lines noise_lines = lines_of(q->w, n * NU, next, q->noise == 1 ? ahead : next, n);
  V p[NP * PS + 1], cost[U];
  UNROLL for (int k = 0; k < NP * PS; k++) p[k] = a->p[k];
  for (int j = 0; j < U; j++) cost[j] = (V){};
  V *x = a->x, *lam = a->lam;
  const V *theta = a->theta, *w = a->w;
  i64 t = 0;
  for (; t < n; t++, x += NX * U, lam += NL * U, theta += theta_step, w += a->w_step) {
    if (ENDS && all_over(x)) break;
    V *after = q->linearise_along ? a->after : x + NX * U;
    FETCH(theta_lines, 0);
    FETCH(noise_lines, 0);
    choose_actions(a, t);
    EACH for (int j = 0; j < LIVE; j += A) {
      V stage[A];
      const V *before = t ? lam - NL * U + j : 0;
      const V *in[] = {x + j, theta + (ts > 1) * j, w + j, p + (PS > 1) * j, before};
      V *out[] = {after + j, lam + j, stage};
      one_step(in, out, ts);
      UNROLL for (int r = 0; r < A; r++) cost[j + r] += stage[r];
    }
  }
  for (int j = 0; j < LIVE; j += A) {
    V last[A];
    const V *in[] = {x + j, p + (PS > 1) * j};
    V *out[] = {last};
    terminal(in, out);
    UNROLL for (int r = 0; r < A; r++) a->cost[j + r] = cost[j + r] + last[r];
  }
  for (i64 k = NX * U; k < (n - t + 1) * NX * U; k++) x[k] = x[k - NX * U];
  return t;
}
"""

# C code of the adjoint sweep and of the scores.
_ADJOINT = """\
static void backward(const job *q, const memory *a, i64 n, i64 live, i64 row, i64 end) {
  (void)live;
  i64 last = row + U * W < end ? row + U * W : end, ts = a->ts;
  i64 theta_step = a->theta_step;
  lines gradient_lines = lines_of(q->gradient, q->parts * GT, row,
                                  q->want & WANT_MOMENTS ? row : last, n);
  V bars[(NX + 1) * U], p[NP * PS + 1], action_bar[NT * U + 1];
  UNROLL for (int k = 0; k < NP * PS; k++) p[k] = a->p[k];
  V *x = a->x + n * NX * U, *lam = a->lam + n * NL * U, *g = a->gradient + (n - 1) * NT * U;
  const V *theta = a->theta + n * theta_step, *w = a->w + n * a->w_step;
  for (int j = 0; j < LIVE; j += A) {
    const V *in[] = {x + j, p + (PS > 1) * j};
    V *out[] = {bars + j};
    terminal_adjoint(in, out);
  }
  if (q->terminal_gradient)
    for (int j = 0; j < U; j++) {
      V more[NX];
      load_rows(q->terminal_gradient, NX, row + j * W, end, more, 1);
      for (int k = 0; k < NX; k++) bars[k * U + j] += more[k];
    }
  if (q->parts == 1) {
    g = DENSE ? action_bar : a->gradient;
    for (i64 k = 0; k < GT * U; k++) a->gradient[k] = (V){};
  }
  for (i64 t = 0; t < n; t++) {
    x -= NX * U, lam -= NL * U, theta -= theta_step, w -= a->w_step;
    FETCH(gradient_lines, 1);
    EACH for (int j = 0; j < LIVE; j += A) {
      V before[NX * A + 1], part[NT * A + 1];
      const V *in[] = {x + j, theta + (ts > 1) * j, w + j, p + (PS > 1) * j, lam + j, bars + j};
      V *out[] = {before, part};
      adjoint(in, out, ts);
      UNROLL for (int k = 0; k < NX * A; k++) bars[k / A * U + j + k % A] = before[k];
      if (q->parts > 1 || DENSE)
        UNROLL for (int k = 0; k < NT * A; k++) g[k / A * U + j + k % A] = part[k];
      else UNROLL for (int k = 0; k < NT * A; k++) g[k / A * U + j + k % A] += part[k];
    }
    if (q->parts > 1) g -= NT * U;
    if (DENSE) backpropagate(a, n - 1 - t, action_bar, bars, a->gradient);
  }
}
static void scores(const job *q, const memory *a, i64 n, i64 live) {
  (void)live;
  i64 ts = a->ts, theta_step = a->theta_step, to = q->parts > 1 ? NT * U : 0;
  V part[NT * A + 1], weighed[NU * A + 1], action_bar[NT * U + 1];
  for (i64 k = 0; k < q->parts * GT * U; k++) a->score[k] = (V){};
  for (i64 t = 0; t < n; t++) {
    for (int j = 0; j < LIVE; j += A) {
      const V *w = a->w + t * a->w_step + j, *x = a->x + t * NX * U + j;
      V *s = DENSE ? action_bar + j : a->score + t * to + j;
      for (int k = 0; k < NU * A; k++)
        weighed[k] = w[k / A * U + k % A] * q->precision[t * NU + k / A];
      const V *in[] = {x, a->theta + t * theta_step + (ts > 1) * j, weighed};
      V *out[] = {part};
      score(in, out, ts);
      for (int k = 0; k < NT * A; k++)
        s[k / A * U + k % A] = DENSE ? part[k] : s[k / A * U + k % A] + part[k];
    }
    if (DENSE) backpropagate(a, t, action_bar, 0, a->score);
  }
}
"""

# Strides of (x, theta, w, p) between entries in the block's memory: U, or 1 where samples share them.
_ROLLOUT_INPUTS = ("U", "ts", "U", "PS")
_ROLLOUT_STRIDES = {
    "step": (_ROLLOUT_INPUTS, ("U", "U", "A")),
    "opening": (_ROLLOUT_INPUTS, ("A", "A")),
    "closing": ((*_ROLLOUT_INPUTS, "A"), ("U", "U", "A")),
    "warm": (("U", "A"), ("PA",)),
    "adjoint": ((*_ROLLOUT_INPUTS, "U", "U"), ("A", "A")),
    "score": (("U", "ts", "A"), ("A",)),
    "terminal": (("U", "PS"), ("A",)),
    "terminal_adjoint": (("U", "PS"), ("U",)),
    "observe": (("U", "PS"), ("U",)),
    "observe_adjoint": (("U", "PS", "U"), ("A",)),
}

_LOAD = """\
static void load_block(const job *q, const memory *a, i64 row, i64 end) {
  i64 nw = q->horizon * NU, nt = q->parts * GT, nx = (q->horizon + 1) * NX;
#if DERIVATIVES
  Q keys[2 * ROUNDS];
  if (q->noise == 2) schedule(q->key0, q->key1, keys);
#endif
  for (int j = 0; j < U; j++, row += W) {
    if (!q->shared_x0) load_rows(q->x0, NX, row, end, a->x + j, U);
    else for (int k = 0; k < NX; k++) a->x[k * U + j] = SPLAT(q->x0[k]);
    if (q->linearise_along) load_rows(q->linearise_along, nx, row, end, a->x + j, U);
    if (!q->shared_theta)
      load_rows(q->theta, nt, row, end, (DENSE ? (V *)a->weights : a->theta) + j, U);
    if (PS > 1) load_rows(q->p, NP, row, end, a->p + j, U);
    if (q->noise == 1) load_rows(q->w, nw, row, end, a->w + j, U);
#if DERIVATIVES
    if (q->noise == 2)
      for (i64 m = 0; m < nw; m += 4) {
        V z[4];
        four_normals(q->first + row, m / 4, keys, z);
        for (i64 k = 0; k < 4 && m + k < nw; k++)
          a->w[(m + k) * U + j] = z[k] * q->sigma[(m + k) % NU];
      }
#endif
  }
}
"""

_RUN = """\
#if DERIVATIVES
INLINE M inside(i64 row, i64 end) { M m; LANES m[l] = -(i64)(row + l < end); return m; }
#endif
static i64 roll_out(i64 begin, i64 end, i64 chunk, const job *q) {
  i64 N = q->horizon, nt = q->parts * GT;
  int gradient = DERIVATIVES && q->want & WANT_GRADIENT, score = DERIVATIVES && q->want & WANT_SCORE;
  int in_place = !DENSE && !q->shared_theta && q->parts > 1;
  i64 values = 1 + nt * (gradient + score), w_step = q->noise ? NU * U : 0;
  i64 sizes[] = {(N + 1) * NX * U, N * NL * U, w_step ? N * w_step : NU * U,
                 DENSE ? N * NU * U : nt * (q->shared_theta ? 1 : U), NP * PS,
                 in_place ? 0 : nt * U, score ? nt * U : 0, U, q->linearise_along ? NX * U : 0,
                 DENSE && PER_SAMPLE ? nt * U : 0, 3 * values};
  enum { PARTS = sizeof(sizes) / sizeof(sizes[0]) };
  i64 size = 0;
  for (int k = 0; k < PARTS; k++) size += sizes[k];
  V *all = aligned_alloc(sizeof(V), sizeof(V) * size), *parts[PARTS], *top = all;
  if (!all) return -1;
  for (int k = 0; k < PARTS; k++) parts[k] = top, top += sizes[k];
  i64 ts = q->shared_theta && !DENSE ? 1 : U;
  memory a = {parts[0], parts[1], parts[2], parts[3], parts[4], parts[in_place ? 3 : 5],
              parts[6], parts[7], parts[8],
#if DENSE && !PER_SAMPLE
              q->theta,
#else
              parts[9],
#endif
              w_step, ts, DENSE ? NU * U : q->parts > 1 ? NT * ts : 0};
  top = parts[10];
  if (q->shared_theta && !DENSE) load_shared(q->theta, nt, a.theta, 1);
  if (DENSE && PER_SAMPLE && q->shared_theta) load_shared(q->theta, nt, (V *)a.weights, U);
  if (PS == 1) load_shared(q->p, NP, a.p, 1);
  if (!q->noise) for (i64 k = 0; k < NU * U; k++) a.w[k] = (V){};
#if DERIVATIVES
  int moments = (q->want & WANT_MOMENTS) != 0, starting = 1;
  accumulator sums = {top, top + values, top + 2 * values, {}};
  for (i64 k = 0; k < 3 * values; k++) top[k] = (V){};
#endif
  (void)chunk, (void)top;
  i64 bad = 0;
  for (i64 block = begin; block < end; block += U * W) {
    load_block(q, &a, block, end);
    i64 live = end - block < U * W ? (end - block + A * W - 1) / (A * W) * A : U;
    i64 steps = forward(q, &a, live, block + U * W, end);
    (void)steps;
    V total[U];
    for (int j = 0; j < U; j++) total[j] = a.cost[j];
#if DERIVATIVES
    if (score) scores(q, &a, steps, live);
    if (gradient) backward(q, &a, steps, live, block, end);
    if (gradient) add_up(a.gradient, nt, total);
    if (score) add_up(a.score, nt, total);
#endif
    for (int j = 0; j < U && block + j * W < end; j++) {
      i64 row = block + j * W;
      V *cost = a.cost + j;
      M ok = total[j] - total[j] == 0.0;
      bad += count_rows(~ok, row, end);
      if (q->last) store_rows(q->last, NX, row, end, a.x + N * NX * U + j, U);
      if (q->trail) store_rows(q->trail, (N + 1) * NX, row, end, a.x + j, U);
      if (q->lams) store_rows(q->lams, N * NL, row, end, a.lam + j, U);
#if DERIVATIVES
      V *g = a.gradient + j, *s = a.score + j;
      if (!moments) {
        store_rows(q->cost, 1, row, end, cost, U);
        if (gradient) store_rows(q->gradient, nt, row, end, g, U);
        if (score) store_rows(q->score, nt, row, end, s, U);
        continue;
      }
      ok &= inside(row, end);
      V gain = *cost - q->baseline;
      if (score) for (i64 k = 0; k < nt; k++) s[k * U] *= gain;
      sums.count += ok;
      accumulate(&sums, 0, cost, 1, ok, starting);
      if (gradient) accumulate(&sums, 1, g, nt, ok, starting);
      if (score) accumulate(&sums, 1 + gradient * nt, s, nt, ok, starting);
      starting = 0;
#else
      store_rows(q->cost, 1, row, end, cost, U);
#endif
    }
  }
#if DERIVATIVES
  if (moments) finish(&sums, values, q->moments + begin / chunk * (2 * values + 1));
#endif
  free(all);
  return bad;
}
/* Threads draw chunks from one counter until there are none left. */
i64 run(i64 *next, i64 n, i64 chunk, const job *q);
i64 run(i64 *next, i64 n, i64 chunk, const job *q) {
  i64 bad = 0, begin;
  while ((begin = __atomic_fetch_add(next, chunk, __ATOMIC_RELAXED)) < n) {
    i64 lost = roll_out(begin, begin + chunk < n ? begin + chunk : n, chunk, q);
    if (lost < 0) return -1;
    bad += lost;
  }
  return bad;
}
"""


def rollout_source(
    tapes: RolloutTapes,
    block: int,
    machine: Compiler,
    per_sample_p: bool = False,
    per_sample_theta: bool = False,
) -> str:
    """Return the C text of a rollout on this computer, for blocks of about `block` samples.

    Tapes without adjoint give costs and states alone, without noise that the kernel draws, and without moments.
    With `per_sample_p` the parameters p differ between samples; otherwise all samples share them, so that the
    compiler can keep them in registers. `per_sample_theta` does the same for the weights of dense layers.
    """
    layers, adjoint = tapes.layers, tapes.adjoint
    functions = c_steps.forward_graphs(tapes, warm=True) | {"terminal": tapes.terminal}
    if layers is not None:
        functions["observe"] = layers.observe
    if adjoint is not None:
        functions |= {"adjoint": adjoint.step, "score": adjoint.score, "terminal_adjoint": adjoint.terminal}
    if adjoint is not None and adjoint.observe is not None:
        functions["observe_adjoint"] = adjoint.observe
    length, abreast, registers = c_steps.side_by_side(functions, block, machine)
    constants = {
        "DERIVATIVES": int(adjoint is not None),
        "EACH": "UNROLL" if length <= c_steps.MAX_UNROLLED_OPERATIONS else "",
        # For long graphs the unused registers of the last block are skipped.
        "LIVE": "U" if length <= c_steps.MAX_UNROLLED_OPERATIONS else "live",
        "U": registers,
        "PS": "U" if per_sample_p else "1",
        "GT": tapes.n_theta if layers is None else layers.n_weights,
        "ENDS": int(tapes.end_entry is not None),
        "END_ENTRY": tapes.end_entry or 0,
        **c_dense.layer_constants(layers, per_sample_theta),
    }
    return "".join(
        (
            vector_prelude(machine),
            c_steps.step_constants(tapes, abreast, constants),
            *c_steps.step_kernels(tapes, functions, abreast, _ROLLOUT_STRIDES),
            c_steps.one_step(tapes, with_ts=True, warm=True),
            c_steps.JOB,
            _MEMORY,
            c_dense.layer_source(layers, adjoint is not None),
            _FORWARD,
            *([] if adjoint is None else [_ADJOINT, c_random.normals_source(), c_random.MOMENTS_SOURCE]),
            _LOAD,
            _RUN,
        )
    )
