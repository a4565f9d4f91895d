"""C source of one step: kernels in closed form, or kernels and the loops that solve for contact."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi as ca

from dynamics.batch.engines import c_source
from dynamics.batch.engines.c_flat import batch_driver
from dynamics.batch.engines.c_prelude import vector_prelude
from dynamics.batch.engines.c_source import RegisterLayout
from dynamics.batch.engines.compiler import Compiler
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.batch.graphs.step_graphs import ModelStepGraphs, RolloutTapes
from dynamics.batch.graphs.tape import UnsupportedOperation, share_reciprocals, tape_of
from dynamics.contact.path import ARRIVED

# Maximum number of operations for which the loop over the registers of a block is unrolled; longer
# code would exceed the CPU's registers and compile slowly.
MAX_UNROLLED_OPERATIONS = 200
# Maximum number of operations for which a kernel works on two registers at once, which doubles the text.
MAX_ABREAST_OPERATIONS = 6000
_PATH_GRAPHS = ("path", "path_solution")
_STEP_INPUTS = ("U",) * 4
_STEP_STRIDES = {
    "step": (_STEP_INPUTS, ("U",) * 3),
    "opening": (_STEP_INPUTS, ("A", "A")),
    "closing": ((*_STEP_INPUTS, "A"), ("U",) * 3),
}
# Strides of kernels whose inputs and outputs are local to one step: A or PA registers side by side.
_LOCAL_STRIDES = {
    "newton": (("A", "A"), ("A", "A")),
    "newton_solution": (("A", "A"), ("A",)),
    "other_start": (("PA", "A"), ("PA",)),
    "path": (("PA", "A"), ("PA",)),
    "path_solution": (("PA", "A"), ("PA",)),
}
_CLOSED_FORM = "#define one_step step\n"

# C structure of a call of rollouts, which :class:`dynamics.batch.engines.rollout_engines.Job` fills.
JOB = """\
enum { WANT_GRADIENT = 1, WANT_SCORE = 2, WANT_MOMENTS = 4 };
typedef struct {
  i64 horizon, parts, want, shared_x0, shared_theta, shared_p, noise, key0, key1, first;
  const double *x0, *theta, *p, *w, *linearise_along, *terminal_gradient, *sigma, *precision;
  double *cost, *gradient, *score, *last, *trail, *moments;
  double baseline;
  double *lams;
} job;
"""

# C code of the iteration along the path. A lane that has converged keeps its value, so that a sample
# does not depend on its neighbours. NaN does not count as open, so it ends the loop.
_FOLLOW = """\
INLINE int some(const M *m, int n) {
  M either = m[0];
  for (int r = 1; r < n; r++) either |= m[r];
  return any(either);
}
INLINE int still_open(const V *pair) {
  M open[PA];
  for (int r = 0; r < PA; r++) open[r] = pair[(NW - 1) * PA + r] < %(arrived)s;
  return some(open, PA);
}
static NOINLINE void follow_path(const V *data, V *pair, int max_iterations) {
  V moved[NW * PA], *to[] = {moved};
  const V *from[] = {pair, data};
  for (int i = 0; i < max_iterations && still_open(pair); i++) {
    path(from, to);
    for (int k = 0; k < NW * PA; k++) pair[k] = moved[k];
  }
}
"""
_NEWTON = """\
static NOINLINE void path_instead(const V *data, const M *open, V *lam) {
  V pair[NW * PA], end[NB * PA], *out[] = {end};
  const V *from[] = {pair, data};
  for (int k = 0; k < NW * PA; k++) pair[k] = SPLAT(1.0);
  follow_path(data, pair, %(max_iterations)d);
  path_solution(from, out);
  for (int k = 0; k < NB; k++)
    for (int r = 0; r < PA; r++) lam[k * A + r] = pick(open[r], end[k * PA + r], lam[k * A + r]);
}
INLINE void solve_branch(V *lam, const V *data, const V *before) {
  V moved[NB * A], unrest[A], *to[] = {moved, unrest}, *out[] = {moved};
  const V *from[] = {lam, data};
  M open[A];
  (void)before;
  for (int r = 0; r < A; r++) open[r] = EVERYWHERE;
  for (int i = 0; i < %(newton_iterations)d && some(open, A); i++) {
    newton(from, to);
    for (int k = 0; k < NB * A; k++) lam[k] = pick(open[k %% A], moved[k], lam[k]);
    for (int r = 0; r < A; r++) open[r] &= unrest[r] != 0.0;
  }
  newton_solution(from, out);
  for (int k = 0; k < NB * A; k++) lam[k] = moved[k];
  for (int r = 0; r < A; r += PA)
    if (some(open + r, PA)) path_instead(data + r, open + r, lam + r);
}
"""
_STARTS = """\
/* Whether the first of the starts that leads anywhere has arrived. */
INLINE int decided(const V *pair) {
  for (int r = 0; r < A; r++)
    for (int l = 0; l < W; l++) {
      double phase = LANE(pair[(NW - 1) * A + r], l);
      if (phase <= %(arrived)s) return phase == %(arrived)s;
    }
  return 1;
}
/* Other starts side by side for what one lane has; the first that leads to a solution counts. */
static NOINLINE void search(const V *data, int lane, V *lam) {
  V own[ND * A], number[A], pair[NW * A], moved[NW * A], end[NB * A];
  V *first[] = {pair}, *to[] = {moved}, *out[] = {end};
  const V *inputs[] = {number, own}, *from[] = {pair, own};
  double total = 0.0;
  for (int k = 0; k < ND; k++) {
    double value = LANE(data[k * A], lane);
    total += value;
    for (int r = 0; r < A; r++) own[k * A + r] = SPLAT(value);
  }
  if (total - total != 0.0) return;
  for (int begin = 0; begin < %(starts)d; begin += A * W) {
    for (int r = 0; r < A; r++)
      for (int l = 0; l < W; l++) SET_LANE(number[r], l, (double)(begin + r * W + l));
    other_start(inputs, first);
    for (int i = 0; i < %(max_other_iterations)d && !decided(pair); i++) {
      path(from, to);
      for (int k = 0; k < NW * A; k++) pair[k] = moved[k];
    }
    path_solution(from, out);
    for (int r = 0; r < A; r++) {
      V sum = end[r];
      for (int k = 1; k < NB; k++) sum += end[k * A + r];
      for (int l = 0; l < W; l++) {
        double all = LANE(sum, l);
        if (all - all != 0.0) continue;
        for (int k = 0; k < NB; k++) SET_LANE(lam[k * A], lane, LANE(end[k * A + r], l));
        return;
      }
    }
  }
}
static NOINLINE void solve_branch(V *lam, const V *data, const V *before) {
  V pair[NW * A], *first[] = {pair}, *out[] = {lam};
  const V *from[] = {pair, data};
  %(warm)s
  follow_path(data, pair, %(max_iterations)d);
  path_solution(from, out);
  for (int r = 0; r < A; r++) {
    V phase = pair[(NW - 1) * A + r], sum = phase - %(arrived)s;
    for (int k = 0; k < NB; k++) {
      sum += lam[k * A + r];
      lam[k * A + r] = pick(phase == %(arrived)s, lam[k * A + r], SPLAT(INFINITE));
    }
    M lost = (phase != %(arrived)s) | (sum - sum != 0.0);
    for (int l = 0; l < W && any(lost); l++)
      if (LANE(lost, l)) search(data + r, l, lam + r);
  }
}
"""
_WARM = """\
if (before) {
    const V *inputs[] = {before, data};
    warm(inputs, first);
  } else
    for (int k = 0; k < NW * A; k++) pair[k] = SPLAT(1.0);"""
_COLD = """\
(void)first;
  for (int k = 0; k < NW * A; k++) pair[k] = SPLAT(1.0);"""
_STEP = """\
INLINE void one_step(const V *const in[], V *const out[]%(ts_parameter)s) {
  V lam[%(branches)d * NB * A], data[%(branches)d * ND * A];
  V *opened[] = {lam, data};
  const V *before = %(before)s;
  opening(in, opened%(ts)s);
  for (int b = 0; b < %(branches)d; b++)
    solve_branch(lam + b * NB * A, data + b * ND * A, before ? before + b * NB * %(apart)s : 0);
  const V *all[] = {in[0], in[1], in[2], in[3], lam};
  closing(all, out%(ts)s);
}
"""


def step_source(tapes: RolloutTapes, block: int, machine: Compiler) -> str:
    """Return the C text that evaluates one step of many samples, in blocks of about `block` samples.

    Raises `UnsupportedOperation` for a learned step.
    """
    functions = forward_graphs(tapes)
    _, abreast, registers = side_by_side(functions, block, machine)
    return "".join(
        (
            vector_prelude(machine),
            step_constants(tapes, abreast, {"U": registers}),
            *step_kernels(tapes, functions, abreast, _STEP_STRIDES),
            one_step(tapes, with_ts=False),
            "#define kernel one_step\n",
            batch_driver((tapes.nx, tapes.n_theta, tapes.nu, tapes.np), (tapes.nx, tapes.nlam, 1)),
        )
    )


def side_by_side(functions: Mapping[str, ca.Function], block: int, machine: Compiler) -> tuple[int, int, int]:
    """Return three counts: operations in all graphs, registers per kernel call, and registers per block."""
    length = sum(fn.n_instructions() for fn in functions.values())
    abreast = 2 if MAX_UNROLLED_OPERATIONS < length <= MAX_ABREAST_OPERATIONS else 1
    return length, abreast, abreast * max(1, block // (abreast * machine.width))


def forward_graphs(tapes: RolloutTapes, warm: bool = False) -> dict[str, ca.Function]:
    """Return the graphs of the forward step, as a dict from the kernel's name to the function.

    The graph of the warm start from the previous step is included only with ``warm``.

    Raises `UnsupportedOperation` for a learned step.
    """
    loop = tapes.forward
    if isinstance(loop, ModelStepGraphs):
        raise UnsupportedOperation("a learned step has no C code; choose another law")
    if isinstance(loop, InnerLoop):
        return {name: graph for name, graph in loop.graphs().items() if warm or name != "warm"}
    return {"step": loop}


def step_kernels(
    tapes: RolloutTapes,
    functions: Mapping[str, ca.Function],
    abreast: int,
    strides: dict[str, tuple[tuple[str, ...], tuple[str, ...]]],
) -> Iterator[str]:
    """Yield the C text of each graph's kernel; `strides` maps its name to strides of inputs and outputs."""
    for name, fn in functions.items():
        inputs, outputs = (strides | _LOCAL_STRIDES if abreast > 1 else strides).get(name, ((), ()))
        registers = _path_abreast(tapes, abreast) if name in _PATH_GRAPHS else abreast
        layout = RegisterLayout(inputs, outputs, registers, name == "path")
        yield c_source.kernel_source(share_reciprocals(tape_of(fn)), name, layout)


def _path_abreast(tapes: RolloutTapes, abreast: int) -> int:
    """Return the number of registers that the path's kernels work on at once.

    The number is 1 if Newton's method comes first: the path is then rarely needed, and its C text is half as long.
    """
    loop = tapes.forward
    return 1 if isinstance(loop, InnerLoop) and loop.newton else abreast


def step_constants(tapes: RolloutTapes, abreast: int, more: Mapping[str, object]) -> str:
    """Return preprocessor definitions of the sizes in the C text of a step, followed by the constants `more`."""
    loop = tapes.forward
    inner = (loop.n, loop.n_data, loop.n_pair) if isinstance(loop, InnerLoop) else (0, 0, 0)
    values = {
        **{"A": abreast, "PA": _path_abreast(tapes, abreast)},
        **{"NX": tapes.nx, "NU": tapes.nu, "NP": tapes.np, "NL": tapes.nlam},
        **{"NT": tapes.n_theta, "NB": inner[0], "ND": inner[1], "NW": inner[2]},
        **more,
    }
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


def one_step(tapes: RolloutTapes, with_ts: bool, warm: bool = False) -> str:
    """Return the C text of `one_step: (x, theta, w, p) -> (x_next, lam, cost)`, to be placed after its kernels.

    `with_ts` says that the kernels have `ts` as their last argument. With `warm` the function has one more
    argument, `lam` of the previous step, or a null pointer.
    """
    loop = tapes.forward
    if not isinstance(loop, InnerLoop):
        return _CLOSED_FORM
    solve = _NEWTON if loop.newton else _STARTS
    return (_FOLLOW + solve + _STEP) % {
        **{"newton_iterations": loop.newton_iterations, "starts": loop.starts},
        **{"max_iterations": loop.max_iterations, "max_other_iterations": loop.max_other_iterations},
        **{"branches": loop.branches, "ts": ", ts" * with_ts, "ts_parameter": ", i64 ts" * with_ts},
        **{"arrived": ARRIVED, "warm": _WARM if warm else _COLD},
        **{"before": "in[4]" if warm else "0", "apart": "U" if warm else "1"},
    }
