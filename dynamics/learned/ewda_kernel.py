"""The engine of the weighted average in C, with threads over parts of the points."""

from __future__ import annotations

import ctypes

import numpy as np

from dynamics.batch.engines.compiler import find_compiler, load
from dynamics.batch.engines.parallel import checked_threads, on_threads
from dynamics.learned.ewda_moments import CUTOFF, Cloud
from dynamics.learned.ewda_order import boxes, chunked, neighbourly
from dynamics.learned.ewda_source import CHUNK, FAR, REGISTER, ewda_source

_PARTS = 32
_BATCH = 128
"""Queries that go through the points together."""
_WORTH = 1 << 16
"""Pairs of a point and a query from which a second thread is worth waking."""
_PHASES = 4
_COUNTS = ("n_chunks", "n_boxes", "n_parts", "n_queries", "kind")
_NUMBERS = ("inverse", "cutoff", "reach")
_ARRAYS = (
    *("z", "y", "low", "high", "q", "mean_z", "mean_y", "weights"),
    *("least", "bound", "best", "partial", "sums", "found", "where", "ticket", "done"),
)
_VALUES, _SLOPES, _CURVED = range(3)


class _Job(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in _COUNTS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
    ]


class CompiledMoments:
    """As :class:`~dynamics.learned.ewda_moments.Moments` says; a query's answer has the same bits
    whatever the threads and the other queries.

    Raises ``CompilerError`` where there is no compiler.
    """

    def __init__(self, points: Cloud, threads: int | None = None) -> None:
        n, self._nz = points.z.shape
        self._ny = points.y.shape[1]
        compiler = find_compiler()
        self._run = load(ewda_source(self._nz, self._ny, compiler), ["run"]).run
        self._run.restype = None
        self._threads = checked_threads(threads)
        self._order = neighbourly(points.z, CHUNK, REGISTER)
        rows = points.z[self._order]
        self._n_chunks = -(-n // CHUNK)
        self._n_parts = min(_PARTS, self._n_chunks)
        self._n_boxes = -(-self._n_chunks // compiler.width) * compiler.width
        low, high = boxes(rows, CHUNK, self._n_boxes)
        stored = {
            "z": chunked(rows, CHUNK, FAR),
            "y": chunked(points.y[self._order], CHUNK, 0.0),
            "low": low,
            "high": high,
        }
        self._stored = {name: _aligned(array.shape, array) for name, array in stored.items()}
        self._fixed = {
            "n_chunks": self._n_chunks,
            "n_boxes": self._n_boxes,
            "n_parts": self._n_parts,
            "inverse": 0.5 / points.sigma**2,
            "cutoff": -2 * points.sigma**2 * float(np.log(CUTOFF)),
            "reach": float(np.abs(rows).max(axis=0).sum()),
            **{name: array.ctypes.data for name, array in self._stored.items()},
        }

    def first(self, q: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """As the protocol says."""
        none = np.zeros((len(q), 0))
        size = (1 + self._ny, 1 + self._nz if slopes else 1)
        return self._all(_SLOPES if slopes else _VALUES, size, q, none, none, none)

    def second(
        self, q: np.ndarray, mean_z: np.ndarray, mean_y: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As the protocol says."""
        size = (1 + self._nz, 1 + self._nz)
        _, sums = self._all(_CURVED, size, q, mean_z, mean_y, weights)
        below = np.tril(sums[:, 1:, 1:])
        above = np.tril(sums[:, 1:, 1:], -1).transpose(0, 2, 1)
        return sums[:, 0, 0], below + above

    def _all(
        self, kind: int, size: tuple[int, int], *given: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Index of the nearest point (nq,) and the sums (nq, *size), a batch at a time."""
        count = len(given[0])
        rows = [np.ascontiguousarray(array, dtype=float) for array in given]
        where, sums = np.empty(count, dtype=np.int64), np.empty((count, *size))
        for begin in range(0, count, _BATCH):
            end = min(begin + _BATCH, count)
            batch = [array[begin:end] for array in rows]
            self._batch(kind, batch, where[begin:end], sums[begin:end])
        return self._order[where], sums

    def _batch(
        self, kind: int, given: list[np.ndarray], where: np.ndarray, sums: np.ndarray
    ) -> None:
        n = len(where)
        counters = np.zeros((2, _PHASES), dtype=np.int64)
        arrays = {
            **dict(zip(("q", "mean_z", "mean_y", "weights"), given, strict=True)),
            "least": _aligned((n, self._n_boxes)),
            "bound": np.empty(n),
            "best": np.empty((n, self._n_parts)),
            "found": np.empty((n, self._n_parts), dtype=np.int64),
            "partial": np.empty((n, self._n_parts, sums.shape[1] * sums.shape[2])),
            "where": where,
            "sums": sums,
            "ticket": counters[0],
            "done": counters[1],
        }
        pointers = {name: array.ctypes.data for name, array in arrays.items()}
        job = _Job(**self._fixed, **pointers, n_queries=n, kind=kind)
        work = n * self._n_chunks * CHUNK
        threads = min(self._threads, max(1, work // _WORTH), self._n_parts)
        on_threads(threads, lambda: self._run(ctypes.byref(job)))


def _aligned(shape: tuple[int, ...], values: np.ndarray | None = None) -> np.ndarray:
    """A C-ordered float array at an address that any register can be loaded from."""
    size = int(np.prod(shape))
    raw = np.empty(size + 8)
    begin = -(raw.ctypes.data // 8) % 8
    array = raw[begin : begin + size].reshape(shape)
    if values is not None:
        array[...] = values
    return array
