"""C source of one step: its kernels, in closed form or around the loops that solve for contact."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi as ca

from dynamics.batch.engines import c_source
from dynamics.batch.engines.c_source import Layout
from dynamics.batch.graphs.asked import Asked
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.batch.graphs.step_graphs import RolloutTapes
from dynamics.batch.graphs.tape import UnsupportedOperation, tape_of, with_shared_reciprocals

_INNER_GRAPHS = ("opening", "newton", "settled", "path", "followed", "closing")
_PATH_GRAPHS = ("path", "followed")
# A or PA registers side by side: what a step keeps to itself while it is worked on.
_OWN = {
    "newton": (("A", "A"), ("A", "A")),
    "settled": (("A", "A"), ("A",)),
    "path": (("PA", "A"), ("PA",)),
    "followed": (("PA", "A"), ("PA",)),
}
_CLOSED_FORM = "#define one_step step\n"

# A register that has come to rest keeps its value lane by lane, so that a sample does not depend on
# its neighbours. NaN never looks open, and so ends the loop.
_INNER = """\
INLINE int differ(const V *a, const V *b) {
  M changed = DIFFER(a[0], b[0]);
  for (int k = 1; k < NW * PA; k++) changed |= DIFFER(a[k], b[k]);
  return any(changed);
}
INLINE int some(const M *m, int n) {
  M either = m[0];
  for (int r = 1; r < n; r++) either |= m[r];
  return any(either);
}
static NOINLINE void follow_path(const V *data, const M *open, V *lam) {
  V pair[NW * PA], moved[NW * PA], end[NB * PA], *to[] = {moved}, *out[] = {end};
  const V *from[] = {pair, data};
  if (!some(open, PA)) return;
  for (int k = 0; k < NW * PA; k++) pair[k] = SPLAT(1.0);
  for (int i = 0; i < %(path_iterations)d; i++) {
    path(from, to);
    if (!differ(pair, moved)) break;
    for (int k = 0; k < NW * PA; k++) pair[k] = moved[k];
  }
  followed(from, out);
  for (int k = 0; k < NB; k++)
    for (int r = 0; r < PA; r++) lam[k * A + r] = pick(open[r], end[k * PA + r], lam[k * A + r]);
}
INLINE void solve_branch(V *lam, const V *data) {
  V moved[NB * A], unrest[A], *to[] = {moved, unrest}, *out[] = {moved};
  const V *from[] = {lam, data};
  M open[A];
  for (int r = 0; r < A; r++) open[r] = EVERYWHERE;
  for (int i = 0; i < %(newton_iterations)d && some(open, A); i++) {
    newton(from, to);
    for (int k = 0; k < NB * A; k++) lam[k] = pick(open[k %% A], moved[k], lam[k]);
    for (int r = 0; r < A; r++) open[r] &= unrest[r] != 0.0;
  }
  settled(from, out);
  for (int k = 0; k < NB * A; k++) lam[k] = moved[k];
  for (int r = 0; r < A; r += PA) follow_path(data + r, open + r, lam + r);
}
INLINE void one_step(const V *const in[], V *const out[]%(ts_parameter)s) {
  V lam[%(branches)d * NB * A], data[%(branches)d * ND * A];
  V *opened[] = {lam, data};
  opening(in, opened%(ts)s);
  for (int b = 0; b < %(branches)d; b++) solve_branch(lam + b * NB * A, data + b * ND * A);
  const V *all[] = {in[0], in[1], in[2], in[3], lam};
  closing(all, out%(ts)s);
}
"""


def graphs(tapes: RolloutTapes) -> dict[str, ca.Function]:
    """The graphs that make up the forward step, by the names their kernels have.

    Raises `UnsupportedOperation` for a learned step.
    """
    loop = tapes.forward
    if isinstance(loop, Asked):
        raise UnsupportedOperation("a learned step is data, and has no C; choose another law")
    if isinstance(loop, InnerLoop):
        return {name: getattr(loop, name) for name in _INNER_GRAPHS}
    return {"step": loop}


def kernels(
    tapes: RolloutTapes,
    functions: Mapping[str, ca.Function],
    abreast: int,
    strides: dict[str, tuple[tuple[str, ...], tuple[str, ...]]],
) -> Iterator[str]:
    """C text of each graph, laid out by its strides (inputs, outputs)."""
    for name, fn in functions.items():
        inputs, outputs = (strides | _OWN if abreast > 1 else strides).get(name, ((), ()))
        registers = _path_abreast(tapes, abreast) if name in _PATH_GRAPHS else abreast
        layout = Layout(inputs, outputs, registers)
        yield c_source.kernel(with_shared_reciprocals(tape_of(fn)), name, layout)


def _path_abreast(tapes: RolloutTapes, abreast: int) -> int:
    """Where Newton's method comes first the path is rare, and its text shorter by half."""
    loop = tapes.forward
    return 1 if isinstance(loop, InnerLoop) and loop.newton_iterations else abreast


def constants(tapes: RolloutTapes, abreast: int, more: Mapping[str, object]) -> str:
    """Definitions of the sizes that the text of a step names, and of others."""
    loop = tapes.forward
    inner = (loop.n, loop.n_data, loop.n_pair) if isinstance(loop, InnerLoop) else (0, 0, 0)
    values = {
        **{"A": abreast, "PA": _path_abreast(tapes, abreast)},
        **{"NX": tapes.nx, "NU": tapes.nu, "NP": tapes.np, "NL": tapes.nlam},
        **{"NT": tapes.n_theta, "NB": inner[0], "ND": inner[1], "NW": inner[2]},
        **more,
    }
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


def one_step(tapes: RolloutTapes, with_ts: bool) -> str:
    """C text of `one_step: (x, theta, w, p) -> (x_next, lam, cost)`, after its kernels.

    `with_ts` where the strides of the kernels name `ts`, their last argument.
    """
    loop = tapes.forward
    if not isinstance(loop, InnerLoop):
        return _CLOSED_FORM
    return _INNER % {
        **{"newton_iterations": loop.newton_iterations, "path_iterations": loop.path_iterations},
        **{"branches": loop.branches, "ts": ", ts" * with_ts, "ts_parameter": ", i64 ts" * with_ts},
    }
