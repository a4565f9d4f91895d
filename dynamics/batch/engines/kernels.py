"""Graphs over samples without a compiler: by NumPy, or by CasADi's own virtual machine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np

from dynamics.batch.engines.parallel import over_chunks
from dynamics.batch.graphs.tape import (
    BOOLEAN,
    Operation,
    Tape,
    chosen,
    operands,
    tape_of,
    with_shared_reciprocals,
)

Array = np.ndarray
_LOGICAL = frozenset({ca.OP_NOT, ca.OP_AND, ca.OP_OR})
# A chunk's registers should fit the second-level cache; fewer samples, and calls cost more than
# arithmetic does.
CACHE_BYTES = 1 << 20


class Kernel(Protocol):
    """Evaluates one short graph over samples: arrays `(nnz, m)` in and out, samples last."""

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        ...


def _if_else_zero(condition: Array, value: Array, out: Array) -> None:
    # A product would turn 0 * inf into NaN; CasADi's operation does not.
    out.fill(0.0)
    np.copyto(out, value, where=condition)


def _choose(condition: Array, value: Array, other: Array, out: Array) -> None:
    np.copyto(out, other)
    np.copyto(out, value, where=condition)


def _reciprocal(a: Array, out: Array) -> None:
    np.divide(1.0, a, out=out)


def _twice(a: Array, out: Array) -> None:
    np.add(a, a, out=out)


def _erf(a: Array, out: Array) -> None:
    from scipy import special

    special.erf(a, out=out)


def _erfinv(a: Array, out: Array) -> None:
    from scipy import special

    special.erfinv(a, out=out)


_UFUNCS: dict[int, Callable[..., object]] = {
    **{ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide},
    **{ca.OP_NEG: np.negative, ca.OP_SQ: np.square, ca.OP_TWICE: _twice, ca.OP_INV: _reciprocal},
    **{ca.OP_POW: np.power, ca.OP_CONSTPOW: np.power, ca.OP_SQRT: np.sqrt},
    **{ca.OP_EXP: np.exp, ca.OP_LOG: np.log, ca.OP_LOG1P: np.log1p, ca.OP_EXPM1: np.expm1},
    **{ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan},
    **{ca.OP_ASIN: np.arcsin, ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan},
    **{ca.OP_SINH: np.sinh, ca.OP_COSH: np.cosh, ca.OP_TANH: np.tanh},
    **{ca.OP_ASINH: np.arcsinh, ca.OP_ACOSH: np.arccosh, ca.OP_ATANH: np.arctanh},
    **{ca.OP_ATAN2: np.arctan2, ca.OP_HYPOT: np.hypot, ca.OP_COPYSIGN: np.copysign},
    **{ca.OP_LT: np.less, ca.OP_LE: np.less_equal, ca.OP_EQ: np.equal, ca.OP_NE: np.not_equal},
    **{ca.OP_NOT: np.logical_not, ca.OP_AND: np.logical_and, ca.OP_OR: np.logical_or},
    **{ca.OP_FLOOR: np.floor, ca.OP_CEIL: np.ceil, ca.OP_FABS: np.absolute, ca.OP_SIGN: np.sign},
    **{ca.OP_FMOD: np.fmod, ca.OP_FMIN: np.fmin, ca.OP_FMAX: np.fmax},
    **{ca.OP_ERF: _erf, ca.OP_ERFINV: _erfinv},
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
}


def _remainder(a: Array, b: Array, out: Array) -> None:
    """IEEE remainder a - n b, n the integer nearest a/b (ties to even), exact as in C."""
    r = np.fmod(a, b)
    half = 0.5 * np.abs(b)
    n_odd = np.fmod(np.abs(a), 2.0 * np.abs(b)) >= np.abs(b)
    over = (np.abs(r) > half) | ((np.abs(r) == half) & n_odd)
    out[...] = np.where(over, r - np.copysign(np.abs(b), r), r)


_UFUNCS[ca.OP_REMAINDER] = _remainder


class NumpyKernel:
    """Evaluates a tape over samples in NumPy.

    `run(inputs, outputs)` takes one array `(nnz, m)` per input and fills one `(nnz, m)` per output:
    samples last, so that every operation is one contiguous pass. An input of shape `(nnz, 1)`
    broadcasts. Each thread has registers of its own, kept from call to call.
    """

    def __init__(self, tape: Tape) -> None:
        writer = _Writer(tape)
        calls = {f"f{op}": call for op, call in _UFUNCS.items()} | {"choose": _choose}
        names: dict[str, Any] = {**calls, **writer.constants}
        exec(compile(writer.text(), f"<tape {tape.name}>", "exec"), names)
        self._program = names["program"]
        self.n_registers, self._n_masks = writer.sizes
        self._memory = threading.local()

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate every sample; non-finite values pass through as IEEE arithmetic has them."""
        m = max((row.shape[-1] for row in (*inputs, *outputs)), default=0)
        memory = self._memory
        if getattr(memory, "m", None) != m:
            memory.m = m
            memory.numbers = list(np.empty((self.n_registers, m)))
            memory.masks = list(np.empty((self._n_masks, m), dtype=bool))
            memory.shared = {}
        rows = [
            _shared_rows(memory.shared, k, a) if a.shape[-1] == 1 else list(a)
            for k, a in enumerate(inputs)
        ]
        with np.errstate(all="ignore"):
            self._program(rows, [list(a) for a in outputs], memory.numbers, memory.masks)


def _shared_rows(known: dict[int, tuple[Array, list[Array]]], k: int, array: Array) -> list[Array]:
    """Rows of one number each as views without an axis, which NumPy broadcasts without set-up.

    Those of input k are kept as long as calls pass the same array.
    """
    if k not in known or known[k][0] is not array:
        known[k] = array, [row.reshape(()) for row in array]
    return known[k][1]


class _Writer:
    """Writes a tape as a Python function `program(i, o, r, m)`, one call an operation.

    Registers, `r0, r1, ...` for numbers and `m0, ...` for truth values, are given out by liveness:
    the working set is the width of the graph, not its length.
    """

    def __init__(self, tape: Tape) -> None:
        self.tape = tape
        self.names: dict[int, str] = {}
        self.constants: dict[str, Array] = {}
        self.free: dict[str, list[str]] = {"r": [], "m": []}
        self.count = {"r": 0, "m": 0}
        self.lines: list[str] = []
        self.choices = {
            i: choice
            for i, operation in enumerate(tape.operations)
            if (choice := chosen(tape, operation)) is not None
        }
        self.last = self._last_uses()
        self.direct = self._direct()
        for i, operation in enumerate(tape.operations):
            if self.last[i] >= 0:
                self._write(i, operation)
                self._release(i)
        for k, row in enumerate(tape.outputs):
            for j, v in enumerate(row):
                if self.direct.get(v) != (k, j):
                    self.lines.append(f"o[{k}][{j}][...] = {self.names[v]}")

    def _reads(self, i: int) -> tuple[int, ...]:
        return self.choices.get(i) or operands(self.tape.operations[i])

    def _last_uses(self) -> list[int]:
        """The last reader of each value; -1 for the halves of a choice read only there."""
        n = len(self.tape.operations)
        last = [-1] * n
        for row in self.tape.outputs:
            for value in row:
                last[value] = n
        for i in reversed(range(n)):
            if last[i] >= 0:
                for arg in self._reads(i):
                    last[arg] = max(last[arg], i)
        return last

    def _direct(self) -> dict[int, tuple[int, int]]:
        """Computed numbers that are written straight to an output row."""
        leaves = {ca.OP_INPUT, ca.OP_CONST}
        return {
            value: (k, j)
            for k, row in enumerate(self.tape.outputs)
            for j, value in enumerate(row)
            if self.tape.operations[value].op not in leaves | BOOLEAN
        }

    def _release(self, i: int) -> None:
        for arg in set(self._reads(i)):
            kind = self.names[arg][0]
            if self.last[arg] == i and kind in self.free:
                self.free[kind].append(self.names[arg])

    @property
    def sizes(self) -> tuple[int, int]:
        """How many registers there are for numbers and for truth values."""
        return self.count["r"], self.count["m"]

    def text(self) -> str:
        """The function's source."""
        bind = [
            f"{', '.join(f'{kind}{k}' for k in range(n))}, = {kind}"
            for kind, n in self.count.items()
            if n
        ]
        body = "\n    ".join([*bind, *self.lines, "return"])
        return f"def program(i, o, r, m):\n    {body}\n"

    def _write(self, i: int, operation: Operation) -> None:
        op = operation.op
        if op == ca.OP_INPUT:
            self.names[i] = f"i[{operation.args[0]}][{operation.args[1]}]"
        elif op == ca.OP_CONST:
            self.names[i] = f"k{i}"
            self.constants[f"k{i}"] = np.array(operation.value)
        elif i in self.choices:
            arguments = [self.names[arg] for arg in self.choices[i]]
            self._call(i, "choose", arguments)
        else:
            arguments = [self._argument(op, k, arg) for k, arg in enumerate(operation.args)]
            self._call(i, f"f{op}", arguments)

    def _call(self, i: int, call: str, arguments: list[str]) -> None:
        if i in self.direct:
            k, j = self.direct[i]
            self.names[i] = f"o[{k}][{j}]"
        else:
            boolean = self.tape.operations[i].op in BOOLEAN
            self.names[i] = self._register("m" if boolean else "r")
        self.lines.append(f"{call}({', '.join(arguments)}, {self.names[i]})")

    def _argument(self, op: int, position: int, arg: int) -> str:
        """An operand's name, turned from number to truth value or back where the two do not fit."""
        wants_mask = op in _LOGICAL or (op == ca.OP_IF_ELSE_ZERO and position == 0)
        if wants_mask == (self.tape.operations[arg].op in BOOLEAN):
            return self.names[arg]
        return f"{self.names[arg]} {'!= 0.0' if wants_mask else '* 1.0'}"

    def _register(self, kind: str) -> str:
        if not self.free[kind]:
            self.free[kind].append(f"{kind}{self.count[kind]}")
            self.count[kind] += 1
        return self.free[kind].pop()


class CasadiKernel:
    """Evaluates any CasADi function over samples with `Function.map`, on up to `threads` threads.

    The reference for the other kernels.
    """

    def __init__(self, fn: ca.Function, threads: int = 1) -> None:
        inputs = [ca.MX.sym(fn.name_in(k), fn.nnz_in(k)) for k in range(fn.n_in())]
        shaped = [ca.MX(fn.sparsity_in(k), v) for k, v in enumerate(inputs)]
        outputs = [v.nz[:] for v in fn.call(shaped)]
        # On dense vectors of nonzeros, which is what a row of samples is.
        self._flat = ca.Function(f"{fn.name()}_rows", inputs, outputs)
        self._threads = threads

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        m = max(array.shape[-1] for array in (*inputs, *outputs))
        columns = [np.broadcast_to(array, (len(array), m)) for array in inputs]
        parallel = ("thread", self._threads) if min(self._threads, m) > 1 else ()
        for array, result in zip(outputs, self._flat.map(m, *parallel).call(columns), strict=True):
            array[...] = np.asarray(result)


KERNELS: dict[str, Callable[[ca.Function], Kernel]] = {
    "numpy": lambda fn: NumpyKernel(with_shared_reciprocals(tape_of(fn))),
    "casadi": CasadiKernel,
}
"""Kernels of the graphs of a step, by backend."""


class ChunkedEngine:
    """Evaluates `run(inputs, outputs)`, that of a kernel, over samples, chunk by chunk."""

    def __init__(self, run: Callable[..., None], chunk: int, threads: int) -> None:
        self._run, self._chunk, self._threads = run, chunk, threads

    def evaluate(self, inputs: list[Array], outputs: list[Array], n: int) -> int:
        """Fill `outputs` for all n samples; returns how many of them are not finite."""
        bad: list[int] = []

        def work(begin: int, end: int) -> None:
            rows = [np.ascontiguousarray(a[begin:end].T) if len(a) > 1 else a.T for a in inputs]
            results = [np.empty((a.shape[1], end - begin)) for a in outputs]
            self._run(rows, results)
            finite = np.ones(end - begin, dtype=bool)
            for array, result in zip(outputs, results, strict=True):
                array[begin:end] = result.T
                finite &= np.isfinite(result).all(axis=0)
            bad.append(int(np.count_nonzero(~finite)))

        over_chunks(n, self._chunk, self._threads, work)
        return sum(bad)


def chunk_length(n_rows: int, block: int) -> int:
    """Samples a chunk, a multiple of `block`, for `n_rows` live rows to stay in cache."""
    samples = min(4096, max(256, CACHE_BYTES // (8 * max(n_rows, 1))))
    return block * max(1, samples // block)
