"""C source of a policy's dense layers, as loops over the entries of weights and activations.

Entry k of an array for register j of samples is at index `k U + j`, as in
:mod:`dynamics.batch.engines.c_rollout`; weights are doubles that all samples share or, with `per_sample`,
registers that differ between samples.
"""

from __future__ import annotations

from itertools import pairwise

from dynamics.batch.graphs.step_graphs import Layers

# Number of outputs of a layer that are summed side by side, to hide the latency of an operation.
_ABREAST = 4

_NO_LAYERS = """\
INLINE void choose_actions(const memory *a, i64 t) { (void)a; (void)t; }
"""
_NO_ADJOINT = """\
INLINE void backpropagate(const memory *a, i64 t, const V *action_bar, V *bars, V *total) {
  (void)a; (void)t; (void)action_bar; (void)bars; (void)total;
}
"""

_LOOPS = """\
#if PER_SAMPLE
typedef V weight;
#define AT(w, k, j) w[(k) * U + (j)]
#else
typedef double weight;
#define AT(w, k, j) SPLAT(w[k])
#endif
enum { LAYERS = %(layers)d, HIDDEN = %(hidden)d };
static const i64 layer_sizes[] = {%(sizes)s};
INLINE void some_rows(const weight *w, const weight *b, i64 n, const V *x, V *y, const int rows) {
  V sum[%(abreast)d * U];
  UNROLL for (int r = 0; r < rows; r++)
    UNROLL for (int j = 0; j < U; j++) sum[r * U + j] = AT(b, r, j);
  for (i64 i = 0; i < n; i++)
    UNROLL for (int r = 0; r < rows; r++)
      UNROLL for (int j = 0; j < U; j++)
        sum[r * U + j] = fused(AT(w, r * n + i, j), x[i * U + j], sum[r * U + j]);
  UNROLL for (int k = 0; k < rows * U; k++) y[k] = sum[k];
}
static NOINLINE void layer(const weight *w, i64 n, i64 m, const V *x, V *y) {
  const i64 S = PER_SAMPLE ? U : 1;
  const weight *b = w + n * m * S;
  i64 o = 0;
  for (; o + %(abreast)d <= m; o += %(abreast)d)
    some_rows(w + o * n * S, b + o * S, n, x, y + o * U, %(abreast)d);
  for (; o < m; o++) some_rows(w + o * n * S, b + o * S, n, x, y + o * U, 1);
}
static void layers_up(const weight *w, V *values, V *action) {
  for (int k = 0; k < LAYERS; k++) {
    i64 n = layer_sizes[k], m = layer_sizes[k + 1];
    V *next = k + 1 < LAYERS ? values + n * U : action;
    layer(w, n, m, values, next);
    if (k + 1 < LAYERS) for (i64 i = 0; i < m * U; i++) next[i] = vtanh(next[i]);
    values = next;
    w += (n + 1) * m * (PER_SAMPLE ? U : 1);
  }
}
INLINE void look(const memory *a, i64 t, V *values, V *action) {
  for (int j = 0; j < U; j += A) {
    const V *in[] = {a->x + t * NX * U + j, a->p + (PS > 1) * j};
    V *out[] = {values + j};
    observe(in, out);
  }
  layers_up(a->weights, values, action);
}
static void choose_actions(const memory *a, i64 t) {
  V values[(NOBS + HIDDEN) * U];
  look(a, t, values, a->theta + t * NU * U);
}
"""

_ADJOINT_LOOPS = """\
static NOINLINE void layer_back(const weight *w, i64 n, i64 m, const V *x, const V *ybar, V *wbar,
                                V *xbar) {
  V *bbar = wbar + n * m * U;
  for (i64 k = 0; k < n * U; k++) xbar[k] = (V){};
  for (i64 o = 0; o < m; o++) {
    V bar[U];
    UNROLL for (int j = 0; j < U; j++) bbar[o * U + j] += bar[j] = ybar[o * U + j];
    for (i64 i = 0; i < n; i++)
      UNROLL for (int j = 0; j < U; j++) {
        i64 k = (o * n + i) * U + j;
        wbar[k] = fused(bar[j], x[i * U + j], wbar[k]);
        xbar[i * U + j] = fused(AT(w, o * n + i, j), bar[j], xbar[i * U + j]);
      }
  }
}
/* Adds D_theta a' bar to wbar; bar, of WIDEST entries, becomes that of the observation. */
static void layers_down(const weight *w, const V *values, V *bar, V *wbar) {
  V other[WIDEST * U];
  i64 at = NOBS + HIDDEN, place = NWEIGHTS;
  for (int k = LAYERS - 1; k >= 0; k--) {
    i64 n = layer_sizes[k], m = layer_sizes[k + 1];
    at -= n, place -= (n + 1) * m;
    layer_back(w + place * (PER_SAMPLE ? U : 1), n, m, values + at * U, bar, wbar + place * U, other);
    for (i64 i = 0; i < n * U; i++) {
      V v = values[at * U + i];
      bar[i] = k ? other[i] * (1.0 - v * v) : other[i];
    }
  }
}
/* Backpropagates the adjoint of the action to the weights, and to the state in `bars`. */
static void backpropagate(const memory *a, i64 t, const V *action_bar, V *bars, V *total) {
  V values[(NOBS + HIDDEN) * U], action[NU * U], bar[WIDEST * U];
  look(a, t, values, action);
  for (int k = 0; k < NU * U; k++) bar[k] = action_bar[k];
  layers_down(a->weights, values, bar, total);
  if (bars)
    for (int j = 0; j < U; j += A) {
      V more[NX * A];
      const V *in[] = {a->x + t * NX * U + j, a->p + (PS > 1) * j, bar + j};
      V *out[] = {more};
      observe_adjoint(in, out);
      for (int k = 0; k < NX * A; k++) bars[k / A * U + j + k % A] += more[k];
    }
}
"""


def layer_constants(layers: Layers | None, per_sample: bool) -> dict[str, object]:
    """Return the preprocessor constants of the layers in the C code of rollouts; sizes are zero without layers."""
    sizes = (0, 0) if layers is None else layers.sizes
    return {
        "DENSE": int(layers is not None),
        "PER_SAMPLE": int(per_sample),
        "NOBS": sizes[0],
        "NWEIGHTS": 0 if layers is None else layers.n_weights,
        "WIDEST": max(sizes),
    }


def layer_source(layers: Layers | None, with_adjoint: bool) -> str:
    """Return the C text of `choose_actions` and, with adjoint, `backpropagate`, which do nothing without layers."""
    if layers is None:
        return _NO_LAYERS + _NO_ADJOINT * with_adjoint
    loops = _LOOPS % {
        "layers": len(list(pairwise(layers.sizes))),
        "hidden": sum(layers.sizes[1:-1]),
        "sizes": ", ".join(map(str, layers.sizes)),
        "abreast": _ABREAST,
    }
    return loops + _ADJOINT_LOOPS * with_adjoint
