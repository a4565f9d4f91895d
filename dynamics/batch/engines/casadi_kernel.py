"""CasADi backend: the function's own virtual machine under `map`. The reference for the others."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

CHUNK = 1024


class CasadiEngine:
    """Evaluates any CasADi function over samples with `Function.map`."""

    name = "casadi"

    def __init__(self, fn: ca.Function, threads: int) -> None:
        flat = _flattened(fn)
        self._map = flat.map(CHUNK, "thread", threads) if threads > 1 else flat.map(CHUNK)
        self._n_in = flat.n_in()

    def evaluate(self, inputs: list[np.ndarray], outputs: list[np.ndarray], n: int) -> int:
        """Fill `outputs` for all n samples; returns how many of them are not finite."""
        bad = 0
        for begin in range(0, n, CHUNK):
            end = min(begin + CHUNK, n)
            columns = [_columns(a, begin, end) for a in inputs]
            results = self._map.call(columns)
            finite = np.ones(end - begin, dtype=bool)
            for array, result in zip(outputs, results, strict=True):
                array[begin:end] = np.asarray(result).T[: end - begin]
                finite &= np.isfinite(array[begin:end]).all(axis=1)
            bad += int(np.count_nonzero(~finite))
        return bad


class CasadiKernel:
    """Evaluates a CasADi function over samples, arrays `(nnz, m)` in and out, samples last."""

    def __init__(self, fn: ca.Function) -> None:
        self._flat = _flattened(fn)

    def run(self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        m = max(array.shape[-1] for array in (*inputs, *outputs))
        columns = [np.broadcast_to(array, (len(array), m)) for array in inputs]
        for array, result in zip(outputs, self._flat.map(m).call(columns), strict=True):
            array[...] = np.asarray(result)


def _columns(array: np.ndarray, begin: int, end: int) -> ca.DM:
    """Samples as columns, the last one repeated to a full chunk."""
    rows = array[begin:end] if len(array) > 1 else array
    padded = np.empty((CHUNK, array.shape[1]))
    padded[: len(rows)] = rows
    padded[len(rows) :] = rows[-1]
    return ca.DM(padded.T)


def _flattened(fn: ca.Function) -> ca.Function:
    """The function on dense vectors of nonzeros, which is what a row of samples is."""
    inputs = [ca.MX.sym(fn.name_in(k), fn.nnz_in(k)) for k in range(fn.n_in())]
    shaped = [ca.MX(fn.sparsity_in(k), v) for k, v in enumerate(inputs)]
    outputs = [v.nz[:] for v in fn.call(shaped)]
    return ca.Function(f"{fn.name()}_rows", inputs, outputs)
