"""C backend of a batched function: the tape's kernel and a loop over blocks of samples."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from dynamics.batch import c_source, compiler
from dynamics.batch.c_prelude import prelude
from dynamics.batch.parallel import run_chunks
from dynamics.batch.tape import Tape

CHUNK = 1024
# Shorter functions than elsewhere: with two registers abreast each is twice as long.
PART = 250

_DRIVER = """\
static i64 evaluate(i64 begin, i64 end, const double *const *a, const i64 *shared,
                    double *const *b) {
  static const i64 nx[] = {%(input_sizes)s}, ny[] = {%(output_sizes)s};
  V *memory = aligned_alloc(sizeof(V), sizeof(V) * (U * (%(nx)d + %(ny)d) + 1));
  if (!memory) return -1;
  const V *x[U][%(n_in)d + 1];
  V *y[U][%(n_out)d + 1], *top = memory;
  for (int j = 0; j < U; j++) {
    for (int k = 0; k < %(n_in)d; top += nx[k++]) {
      x[j][k] = top;
      if (shared[k]) load_shared(a[k], nx[k], top);
    }
    for (int k = 0; k < %(n_out)d; top += ny[k++]) y[j][k] = top;
  }
  i64 bad = 0;
  for (i64 block = begin; block < end; block += U * W) {
    int vectors = end - block < U * W ? (int)((end - block + W - 1) / W) : U;
    for (int j = 0; j < vectors; j++)
      for (int k = 0; k < %(n_in)d; k++)
        if (!shared[k]) load_rows(a[k], nx[k], block + j * W, end, (V *)x[j][k], 1);
    /* An odd one out is computed twice, abreast of itself. */
    for (int j = 0; j < vectors; j += 2) {
      int other = j + 1 < vectors ? j + 1 : j;
      kernel(x[j], y[j], x[other], y[other]);
    }
    for (int j = 0; j < vectors; j++) {
      V spoiled = {};
      for (int k = 0; k < %(n_out)d; k++) {
        for (i64 i = 0; i < ny[k]; i++) spoiled += y[j][k][i] - y[j][k][i];
        store_rows(b[k], ny[k], block + j * W, end, y[j][k], 1);
      }
      bad += count_rows(spoiled != 0.0, block + j * W, end);
    }
  }
  free(memory);
  return bad;
}
/* Threads draw chunks from one counter until there are none left. */
i64 run(i64 *next, i64 n, i64 chunk, const double *const *a, const i64 *shared,
        double *const *b) {
  i64 bad = 0, begin;
  while ((begin = __atomic_fetch_add(next, chunk, __ATOMIC_RELAXED)) < n) {
    i64 lost = evaluate(begin, begin + chunk < n ? begin + chunk : n, a, shared, b);
    if (lost < 0) return -1;
    bad += lost;
  }
  return bad;
}
"""


class CompiledEngine:
    """Evaluates a tape over samples by machine code `run(next, n, chunk, a, shared, b)`.

    `evaluate(inputs, outputs)` takes arrays `(n_samples, nnz)` or `(1, nnz)`, fills `outputs`, and
    returns how many samples have a value that is not finite.
    """

    def __init__(self, name: str, tape: Tape, threads: int, run: Any) -> None:
        self.name, self.tape, self.threads, self._run = name, tape, threads, run
        run.restype = ctypes.c_int64
        run.argtypes = [ctypes.c_void_p, *2 * [ctypes.c_int64], *3 * [ctypes.c_void_p]]

    def evaluate(self, inputs: list[np.ndarray], outputs: list[np.ndarray], n: int) -> int:
        """Fill `outputs` for all n samples; returns how many of them are not finite."""
        pointers_in = addresses(inputs)
        pointers_out = addresses(outputs)
        shared = np.array([a.shape[0] == 1 and n != 1 for a in inputs] + [False], dtype=np.int64)
        arguments = pointers_in, shared.ctypes.data, pointers_out
        return run_chunks(self._run, n, CHUNK, self.threads, *arguments)


def c_engine(tape: Tape, threads: int, block: int) -> CompiledEngine:
    """The engine of backend `c`. Raises `CompilerError`."""
    return CompiledEngine("c", tape, threads, compiler.load(source(tape, block)).run)


def addresses(arrays: list[np.ndarray]) -> ctypes.Array[ctypes.c_void_p]:
    """A C array of the arrays' data pointers."""
    return (ctypes.c_void_p * max(len(arrays), 1))(*[a.ctypes.data for a in arrays])


def source(tape: Tape, block: int) -> str:
    """The C text for a tape, working on blocks of about `block` samples."""
    machine = compiler.find_compiler()
    driver = _DRIVER % {
        "input_sizes": ", ".join(map(str, (*tape.input_sizes, 0))),
        "output_sizes": ", ".join(map(str, (*tape.output_sizes, 0))),
        "nx": sum(tape.input_sizes),
        "ny": sum(tape.output_sizes),
        "n_in": len(tape.input_sizes),
        "n_out": len(tape.output_sizes),
    }
    vectors = max(1, block // machine.width)
    return (
        prelude(machine)
        + f"#define U {vectors}\n"
        + c_source.kernel(tape, "kernel", abreast=2, part=PART)
        + driver
    )
