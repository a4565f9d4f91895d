"""C source of a CasADi function with CasADi's interface; a long function is divided into short C functions.

CasADi itself writes one C function with one statement per operation; gcc needs minutes to compile a function
with tens of thousands of statements.
"""

from __future__ import annotations

import casadi as ca

from dynamics.batch.engines import c_source
from dynamics.batch.engines.c_prelude import scalar_prelude
from dynamics.batch.graphs.tape import tape_of

_BODY = """\
static int casadi_f0(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w,
                     int mem) {
  static const V zero[%(largest)d];
  V unused[%(room)d];
  const V *in[] = {%(inputs)s};
  V *out[] = {%(outputs)s};
  (void)zero, (void)iw, (void)w, (void)mem;
  kernel(in, out);
  return 0;
}
"""


def external_source(function: ca.Function) -> str:
    """Return the C text of ``function`` for ``ca.external``; values equal CasADi's up to rounding."""
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    text = generator.dump()
    if not function.is_a("SXFunction") or function.n_instructions() <= c_source.WHOLE:
        return text
    kernel = c_source.kernel_source(tape_of(function), "kernel")
    n_in, n_out = range(function.n_in()), range(function.n_out())
    body = _BODY % {
        "largest": max(1, *map(function.nnz_in, n_in)),
        "room": max(1, *map(function.nnz_out, n_out)),
        "inputs": ", ".join(f"arg[{k}] ? arg[{k}] : zero" for k in n_in),
        "outputs": ", ".join(f"res[{k}] ? res[{k}] : unused" for k in n_out),
    }
    before_body, _, after_head = text.partition("static int casadi_f0(")
    # Compilation with gcc's optimisation level 2 takes 1.5 times as long, and the code is no faster.
    sections = before_body, "#pragma GCC optimize 1\n", scalar_prelude(kernel), "\n", kernel, body
    return "".join((*sections, after_head.partition("\n}\n")[2]))
