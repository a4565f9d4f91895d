"""Export of one step, its derivatives and a policy as one C11 file that needs only C's <math.h>.

The C code is the code of compiled rollouts with one sample per block: kernels over single doubles, and the
loops around these kernels that solve for contact.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from dynamics.batch.engines import c_source, c_steps
from dynamics.batch.engines.c_prelude import scalar_prelude
from dynamics.batch.graphs.objective import free_of_cost
from dynamics.batch.graphs.policy import open_loop
from dynamics.batch.graphs.rollout_tapes import ClosedStep
from dynamics.batch.graphs.tape import tape_of
from dynamics.contact import Step
from dynamics.systems import Signal

# Maximum number of characters in a line of the C file.
_LINE_WIDTH = 96


@dataclass(frozen=True)
class TabulatedPolicy:
    """Affine policy u_t = K_t x_t + k_t: k (N, nu), and K (N, nu, nx), or None for open-loop inputs.

    `lower` and `upper` (nu,) clip the input of a feedback policy, as an actuator would. Steps t >= N
    use the last row.
    """

    k: np.ndarray
    K: np.ndarray | None = None
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None


_HEADER = """\
/* {about}

   Freestanding C11: it needs the mathematical library and no other; cc -std=c11 -O2 -c, link -lm.

   state x[{nx}], x_next[{nx}]
{states}
   input u[{nu}]
{inputs}
   contact multiplier lam[{nlam}]
{contacts}
   parameter p[{np}], with the values of {name}_parameters
{parameters}
*/
#ifndef {name}_h
#define {name}_h
#ifdef __cplusplus
extern "C" {{
#endif
enum {{ {name}_nx = {nx}, {name}_nu = {nu}, {name}_nlam = {nlam}, {name}_np = {np} }};
extern const double {name}_parameters[{room}];

/* One step: x_next and, unless that pointer is 0, the contact multipliers lam. Where p is 0 the
   values are {name}_parameters. x and x_next may be the same array. Returns 0, or 1 where
   the step was not solved or is not finite. */
int {name}_step(const double *x, const double *u, const double *p, double *x_next, double *lam);

/* The same, and the derivatives A[{nx}*{nx}] = d x_next / d x, B[{nx}*{nu}] = d x_next / d u at the
   solved contact, each row by row: A[i*{nx} + j] = d x_next[i] / d x[j]. */
int {name}_derivatives(const double *x, const double *u, const double *p, double *x_next,
                       double *lam, double *A, double *B);
"""
_GUARD_END = """
#ifdef __cplusplus
}
#endif
#endif
"""
_POLICY_HEADER = """
/* The input u at step t = 0, 1, ..., {last} and state x{law}; later steps take the last row. */
void {name}_policy(int t, const double *x, double *u);
"""

_STEP = """\
static int advance(const double *x, const double *u, const double *p, double *q, double *x_next,
                   double *lam) {
  static const double still[NU + 1];
  double cost;
  if (!p) p = %(name)s_parameters;
  const V *given[] = {p}, *in[] = {x, u, still, q};
  V *derivation[] = {q}, *out[] = {x_next, lam, &cost};
  derived(given, derivation);
  one_step(in, out);
  int lost = 0;
  for (int k = 0; k < NX; k++) lost |= !isfinite(x_next[k]);
  for (int k = 0; k < %(nlam)d; k++) lost |= !isfinite(lam[k]);
  return lost;
}
int %(name)s_step(const double *x, const double *u, const double *p, double *x_next, double *lam) {
  double from[NX], all[NL + 1], q[NP + 1];
  for (int k = 0; k < NX; k++) from[k] = x[k];
  int lost = advance(from, u, p, q, x_next, all);
  for (int k = 0; lam && k < %(nlam)d; k++) lam[k] = all[k];
  return lost;
}
int %(name)s_derivatives(const double *x, const double *u, const double *p, double *x_next,
                         double *lam, double *by_x, double *by_u) {
  static const double still[NU + 1];
  double from[NX], all[NL + 1], q[NP + 1], bar[NX] = {0};
  for (int k = 0; k < NX; k++) from[k] = x[k];
  int lost = advance(from, u, p, q, x_next, all);
  const V *in[] = {from, u, still, q, all, bar};
  for (int i = 0; i < NX; i++) {
    V *out[] = {by_x + i * NX, by_u + i * NU};
    bar[i] = 1.0;
    adjoint(in, out);
    bar[i] = 0.0;
  }
  for (int k = 0; lam && k < %(nlam)d; k++) lam[k] = all[k];
  return lost;
}
"""


def export_step(
    step: Step,
    values: np.ndarray,
    name: str,
    about: Sequence[str] = (),
    policy: TabulatedPolicy | None = None,
) -> tuple[str, str]:
    """Return a C file and its header, with `<name>_step`, `<name>_derivatives`, and `<name>_policy` for a policy.

    The C file begins with a copy of its header; a program may include both files. `values` (np,) are those of
    the parameters `step.p`; `name` is converted to a C identifier, and the file begins with the lines `about`
    as a comment. The derivatives go through the contact by the implicit function theorem, with mu constant if the
    law's gradient is frozen.

    Raises `ValueError` if sizes do not fit.
    """
    system, name = step.system, c_identifier(name)
    tapes = ClosedStep(step, free_of_cost(step), open_loop(system.nx, system.nu)).tapes_with_adjoint
    assert tapes.adjoint is not None
    functions = {**c_steps.forward_graphs(tapes), "adjoint": tapes.adjoint.step}
    body = "".join(
        (
            c_steps.step_constants(tapes, 1, {}),
            c_source.kernel_source(tape_of(tapes.derived), "derived"),
            *c_steps.step_kernels(tapes, functions, 1, {}),
            c_steps.one_step(tapes, with_ts=False),
            _STEP % {"name": name, "nlam": step.n},
        )
    )
    declared = "" if policy is None else _policy_header(name, policy)
    header = _header(step, name, about, values) + declared + _GUARD_END
    tables = _table(f"{name}_parameters", values, "")
    acts = "" if policy is None else _policy(name, policy, system.nx)
    text = "\n".join((tables, body, acts))
    text = f"{header}\n{scalar_prelude(text)}\n{text}".rstrip()
    # Files that include this file may define the same macros.
    defined = re.findall(r"^#define (\w+)", text, re.MULTILINE)
    undone = (f"#undef {word}" for word in defined if word != f"{name}_h")
    return "\n".join((text, *undone, "")), header


def c_identifier(name: str) -> str:
    """Return `name`, with an underscore in place of every character that a C identifier may not contain."""
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII)
    return identifier if identifier[:1].isalpha() else f"c_{identifier}"


def _header(step: Step, name: str, about: Sequence[str], values: np.ndarray) -> str:
    system = step.system
    parameters = [
        Signal(f"{p.name} = {float(value)!r}", p.unit, p.description) for p, value in zip(step.p, values, strict=True)
    ]
    return _HEADER.format(
        about="\n   ".join(line for text in about or (name,) for line in wrap(_harmless(text), _LINE_WIDTH) or [""]),
        name=name,
        **{"nx": system.nx, "nu": system.nu, "nlam": step.n},
        **{"np": len(values), "room": max(len(values), 1)},
        states=_listed(system.states),
        inputs=_listed(system.inputs),
        contacts=_listed(step.contacts),
        parameters=_listed(parameters),
    )


def _listed(signals: Iterable[Signal]) -> str:
    """Return one comment line for each entry: index, name, unit, meaning."""
    return "\n".join(
        f"     {i}: {_harmless(f'{s.name} [{s.unit}] {s.description}')}".rstrip() for i, s in enumerate(signals)
    )


def _harmless(text: str) -> str:
    """Return `text` with blanks inserted so that it is safe in a C comment: without `*/`, `/*` and trigraphs."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


def _policy_header(name: str, policy: TabulatedPolicy) -> str:
    law = "" if policy.K is None else ", K_t x + k_t"
    if policy.K is not None and policy.lower is not None:
        law += " within the bounds of the actuators"
    if policy.K is None:
        law = ", which open-loop inputs do not look at"
    return _POLICY_HEADER.format(name=name, last=len(policy.k) - 1, law=law)


def _table(name: str, values: np.ndarray, kind: str) -> str:
    numbers = [c_source.c_double(value).strip("()") for value in np.ravel(values)] or ["0.0"]
    text = "\n".join(wrap(", ".join(numbers), _LINE_WIDTH, initial_indent="  ", subsequent_indent="  "))
    return f"{kind}const double {name}[{len(numbers)}] = {{\n{text}\n}};\n"


def _policy(name: str, policy: TabulatedPolicy, nx: int) -> str:
    steps, nu = policy.k.shape
    tables = [_table("policy_k", policy.k, "static ")]
    lines = [f"  const double *k = policy_k + (t < {steps} ? t : {steps - 1}) * {nu};"]
    if policy.K is None:
        lines += ["  (void)x;", f"  for (int i = 0; i < {nu}; i++) u[i] = k[i];"]
    else:
        tables.append(_table("policy_K", policy.K, "static "))
        lines += [
            f"  const double *K = policy_K + (t < {steps} ? t : {steps - 1}) * {nu * nx};",
            f"  for (int i = 0; i < {nu}; i++) {{",
            "    u[i] = k[i];",
            f"    for (int j = 0; j < {nx}; j++) u[i] += K[i * {nx} + j] * x[j];",
            *_clipping(policy, tables),
            "  }",
        ]
    head = f"void {name}_policy(int t, const double *x, double *u) {{"
    return "".join(tables) + "\n".join((head, *lines, "}\n"))


def _clipping(policy: TabulatedPolicy, tables: list[str]) -> list[str]:
    lines = []
    for bound, sign in (("lower", "<"), ("upper", ">")):
        values = getattr(policy, bound)
        if values is not None:
            tables.append(_table(f"policy_{bound}", values, "static "))
            lines.append(f"    if (u[i] {sign} policy_{bound}[i]) u[i] = policy_{bound}[i];")
    return lines
