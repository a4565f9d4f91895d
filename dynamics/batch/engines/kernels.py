"""Evaluation of graphs for many samples with NumPy or CasADi's virtual machine, and the choice of a backend."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, Protocol, TypeVar

import casadi as ca
import numpy as np

from dynamics.batch.arguments import BatchWarning
from dynamics.batch.engines.compiler import CompilerError
from dynamics.batch.engines.parallel import over_chunks
from dynamics.batch.graphs.tape import (
    BOOLEAN,
    Tape,
    UnsupportedOperation,
    operands_of,
    selection_of,
    share_reciprocals,
    tape_of,
)

EngineT = TypeVar("EngineT")
_reported_reasons: set[str] = set()


def choose_backend(backend: str, makers: Mapping[str, Callable[[], EngineT]], owner: str) -> tuple[str, EngineT]:
    """Build the named backend, or for `auto` the first in `makers` that can be built; return its name and engine.

    `auto` skips a backend that cannot be built; a `BatchWarning` gives the reason and the replacement, once for
    each reason in a process. Raises `ValueError` for an unknown name, and the error of a backend that was
    requested by name and cannot be built.
    """
    if backend != "auto":
        if backend not in makers:
            choices = ", ".join(("auto", *makers))
            raise ValueError(f"unknown backend {backend!r} for {owner}; choose one of {choices}")
        try:
            return backend, makers[backend]()
        except CompilerError as error:
            raise CompilerError(f"{error}; use the numpy or auto backend") from error
    reasons: list[str] = []
    for name, make in makers.items():
        try:
            engine = make()
        except (CompilerError, UnsupportedOperation) as error:
            reasons.append(str(error))
            continue
        if reasons and reasons[0] not in _reported_reasons:
            _reported_reasons.add(reasons[0])
            warnings.warn(f"{reasons[0]}; {owner} runs on the {name} backend", BatchWarning, stacklevel=4)
        return name, engine
    raise UnsupportedOperation("; ".join(dict.fromkeys(reasons)))


Array = np.ndarray
# Operations whose operands are truth values.
_LOGICAL = frozenset({ca.OP_NOT, ca.OP_AND, ca.OP_OR})
# Size of a chunk's live values that fits the second-level cache; with smaller chunks the calls would
# cost more than the arithmetic.
CACHE_BYTES = 1 << 20


class Kernel(Protocol):
    """Interface of a graph's evaluation for m samples, with arrays `(nnz, m)`, samples last."""

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        ...


def _special(name: str, a: Array) -> Array:
    """Return `scipy.special.<name>(a)`; SciPy is imported at the first use."""
    from scipy import special

    return getattr(special, name)(a)


def _remainder(a: Array, b: Array) -> Array:
    """Return the IEEE remainder a - n b, exact as in C; n is the integer nearest to a/b (ties to even)."""
    r = np.fmod(a, b)
    half_divisor = 0.5 * np.abs(b)
    n_odd = np.fmod(np.abs(a), 2.0 * np.abs(b)) >= np.abs(b)
    rounds_up = (np.abs(r) > half_divisor) | ((np.abs(r) == half_divisor) & n_odd)
    return np.where(rounds_up, r - np.copysign(np.abs(b), r), r)


# NumPy's function for each operation of CasADi.
_CALLS: dict[int, Callable[..., Array]] = {
    **{ca.OP_ADD: np.add, ca.OP_SUB: np.subtract, ca.OP_MUL: np.multiply, ca.OP_DIV: np.divide},
    **{ca.OP_NEG: np.negative, ca.OP_SQ: np.square, ca.OP_TWICE: lambda a: a + a},
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
    **{ca.OP_ERF: partial(_special, "erf"), ca.OP_ERFINV: partial(_special, "erfinv")},
    **{ca.OP_REMAINDER: _remainder, ca.OP_INV: lambda a: 1.0 / a},
    # A product would turn 0 * inf into NaN; CasADi's operation does not.
    ca.OP_IF_ELSE_ZERO: lambda condition, value: np.where(condition, value, 0.0),
}


class NumpyKernel:
    """Kernel that evaluates a tape in NumPy, by a generated Python function with one line per operation.

    `run(inputs, outputs)` takes one array `(nnz, m)` per input and fills one `(nnz, m)` per output:
    samples last, so that every operation is one contiguous pass. An input of shape `(nnz, 1)`
    broadcasts. Each value is deleted after its last use; `width` is the maximum number of values stored at once.
    """

    def __init__(self, tape: Tape) -> None:
        self._tape, self.width = tape, 0
        choices = {i: selection_of(tape, operation) for i, operation in enumerate(tape.operations)}
        reads = [choices[i] or operands_of(o) for i, o in enumerate(tape.operations)]
        last_reader = self._last_uses(reads)
        names: dict[str, Any] = {f"f{op}": call for op, call in _CALLS.items()}
        lines, live = [], 0
        for i, operation in enumerate(tape.operations):
            op, args = operation.op, operation.args
            if last_reader[i] < 0:
                continue
            if op == ca.OP_CONST:
                names[f"v{i}"] = np.array(operation.value)
            elif op == ca.OP_INPUT:
                lines.append(f"v{i} = i[{args[0]}][{args[1]}]")
            else:
                call_arguments = [self._argument(op, k, arg) for k, arg in enumerate(args)]
                call = f"f{op}({', '.join(call_arguments)})"
                if choice := choices[i]:
                    call = "where(v{}, v{}, v{})".format(*choice)
                dead_values = [k for k in set(reads[i]) if last_reader[k] == i]
                dead_values = [k for k in dead_values if tape.operations[k].op not in (ca.OP_INPUT, ca.OP_CONST)]
                lines += [f"v{i} = {call}", *(f"del v{k}" for k in dead_values)]
                live += 1 - len(dead_values)
                self.width = max(self.width, live)
        lines += [f"o[{k}][{j}] = v{v}" for k, row in enumerate(tape.outputs) for j, v in enumerate(row)]
        names["where"] = np.where
        text = "\n    ".join(["def program(i, o):", *lines, "return"])
        exec(compile(text, f"<tape {tape.name}>", "exec"), names)
        self._program = names["program"]

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs` for every sample; NaN and infinity follow IEEE arithmetic without a warning."""
        with np.errstate(all="ignore"):
            self._program(inputs, outputs)

    def _last_uses(self, reads: list[tuple[int, ...]]) -> list[int]:
        """Return the index of the last operation that reads each value, n for outputs, -1 for unused values."""
        n = len(reads)
        last_reader = [-1] * n
        for row in self._tape.outputs:
            for value in row:
                last_reader[value] = n
        for i in reversed(range(n)):
            if last_reader[i] >= 0:
                for arg in reads[i]:
                    last_reader[arg] = max(last_reader[arg], i)
        return last_reader

    def _argument(self, op: int, position: int, arg: int) -> str:
        """Return the Python expression of an operand, converted between number and truth value if `op` needs it."""
        wants_mask = op in _LOGICAL or (op == ca.OP_IF_ELSE_ZERO and position == 0)
        if wants_mask == (self._tape.operations[arg].op in BOOLEAN):
            return f"v{arg}"
        return f"v{arg} {'!= 0.0' if wants_mask else '* 1.0'}"


class CasadiKernel:
    """Kernel that evaluates any CasADi function with `Function.map`, on up to `threads` threads.

    It is the reference for the other kernels.
    """

    def __init__(self, fn: ca.Function, threads: int = 1) -> None:
        inputs = [ca.MX.sym(fn.name_in(k), fn.nnz_in(k)) for k in range(fn.n_in())]
        shaped = [ca.MX(fn.sparsity_in(k), v) for k, v in enumerate(inputs)]
        outputs = [ca.vec(v.nz[:]) for v in fn.call(shaped)]
        # Inputs and outputs are dense vectors of nonzeros, like the rows of samples.
        self._flat = ca.Function(f"{fn.name()}_rows", inputs, outputs)
        self._threads = threads

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        m = max(array.shape[-1] for array in (*inputs, *outputs))
        columns = [np.broadcast_to(array, (len(array), m)) for array in inputs]
        threads = min(self._threads, m)
        rows = self._flat.map(m, "thread", threads) if threads > 1 else self._flat.map(m)
        for array, result in zip(outputs, rows.call(columns), strict=True):
            array[...] = np.asarray(result)


class ParameterKernel:
    """Function of parameters that is evaluated once per call: for one row by CasADi, for several rows by NumPy.

    A NumPy program of many operations takes a thousand times as long for one row, and a second to compile. The
    values of the last row are stored, since loops over time call with the same values of those parameters on which the
    function depends.
    """

    def __init__(self, fn: ca.Function) -> None:
        self._fn = fn
        self._last: tuple[bytes, np.ndarray] | None = None

    def __call__(self, parameters: np.ndarray) -> np.ndarray:
        """Return the values (n, n_out) at parameters (n, n_in)."""
        if len(parameters) == 1:
            row, last = parameters[0, self._read].tobytes(), self._last
            if last is None or last[0] != row:
                self._last = last = row, np.array(self._fn.call([ca.DM(parameters[0])])[0]).T
            return last[1]
        values = np.empty((self._fn.numel_out(0), len(parameters)))
        self._columns.run([np.ascontiguousarray(parameters.T)], [values])
        return np.ascontiguousarray(values.T)

    @cached_property
    def _read(self) -> np.ndarray:
        """Indices of the parameters on which the function depends."""
        p = ca.MX.sym("p", self._fn.numel_in(0))
        return np.flatnonzero(ca.which_depends(ca.vec(self._fn.call([p])[0]), p, 1, False))

    @cached_property
    def _columns(self) -> NumpyKernel:
        return NumpyKernel(tape_of(self._fn))


KERNEL_MAKERS: dict[str, Callable[[ca.Function], Kernel]] = {
    "numpy": lambda fn: NumpyKernel(share_reciprocals(tape_of(fn))),
    "casadi": CasadiKernel,
}
"""Mapping from the backend's name to the function that makes a `Kernel` of a graph."""


class ChunkedEngine:
    """Engine that calls a kernel's `run(inputs, outputs)` for consecutive chunks of samples, on several threads."""

    def __init__(self, run: Callable[..., None], chunk: int, threads: int) -> None:
        self._run, self._chunk, self._threads = run, chunk, threads

    def evaluate(self, inputs: list[Array], outputs: list[Array], n: int) -> int:
        """Fill `outputs` for all n samples; return the number of samples that are not finite."""
        bad_counts: list[int] = []

        def work(begin: int, end: int) -> None:
            rows = [np.ascontiguousarray(a[begin:end].T) if len(a) > 1 else a.T for a in inputs]
            results = [np.empty((a.shape[1], end - begin)) for a in outputs]
            self._run(rows, results)
            finite = np.ones(end - begin, dtype=bool)
            for array, result in zip(outputs, results, strict=True):
                array[begin:end] = result.T
                finite &= np.isfinite(result).all(axis=0)
            bad_counts.append(int(np.count_nonzero(~finite)))

        over_chunks(n, self._chunk, self._threads, work)
        return sum(bad_counts)


def chunk_length(n_rows: int, block: int) -> int:
    """Return the samples per chunk, a multiple of `block`, for which `n_rows` rows of values stay in the cache."""
    samples = min(4096, max(256, CACHE_BYTES // (8 * max(n_rows, 1))))
    return block * max(1, samples // block)
