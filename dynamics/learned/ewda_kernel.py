"""NumPy and C engines for the weighted sums of the exponentially weighted distance average."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynamics.batch.engines.compiler import find_compiler, load_library
from dynamics.batch.engines.parallel import checked_threads, on_threads
from dynamics.learned.ewda_source import FAR, POINTS_PER_BOX, REGISTER, ewda_source

CUTOFF = 1e-25
"""Weights below this fraction of the largest are omitted; their sum is less than the rounding error of the total."""
_DISTANCES_PER_BLOCK = 1 << 22
"""Maximum number of distances that are in memory at the same time."""


@dataclass(frozen=True)
class Cloud:
    """Data points z (n, nz) and sigma in normalised units, and targets y (n, ny) in their own units."""

    z: np.ndarray
    y: np.ndarray
    sigma: float


@dataclass(frozen=True)
class NumpyMoments:
    """Weighted sums over data points z_i for queries q, computed with NumPy.

    The weights are ``w_i = exp((|q - c|² - |q - z_i|²) / 2 sigma²)``, which is 1 for c, the point nearest to q.
    Distances are computed as products of matrices, for one block of queries after another.
    """

    points: Cloud

    def first_moments(self, q: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices (nq,) of the nearest points c, and ``sum_i w_i a_i b_i'`` (nq, 1 + ny, 1 or 1 + nz).

        ``a = (1, y_i - y_c)``, and ``b = (1, z_i - z_c)``, or 1 without ``slopes``.
        """
        z, y = self.points.z, self.points.y
        cols = 1 + z.shape[1] if slopes else 1
        nearest = np.empty(len(q), dtype=np.int64)
        sums = np.empty((len(q), 1 + y.shape[1], cols))
        for i, nearest_point, neighbours in self._neighbours(q):
            nearest[i] = nearest_point
            d, w = self._weights(neighbours, q[i], z[nearest_point])
            a = _with_ones(y[neighbours] - y[nearest_point]) * w[:, None]
            sums[i] = a.T @ _with_ones(d)[:, :cols]
        return nearest, sums

    def second_moments(
        self, q: np.ndarray, mean_z: np.ndarray, mean_y: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return ``sum_i w_i`` (nq,) and ``sum_i w_i s_i d_i d_i'`` (nq, nz, nz), symmetric.

        ``d_i = z_i - z_c - mean_z``, ``s_i = weights_y' (y_i - y_c - mean_y) + weights_last``
        with means (nq, nz), (nq, ny) and weights (nq, ny + 1) of every query.
        """
        y, nz = self.points.y, q.shape[1]
        total, sums = np.empty(len(q)), np.empty((len(q), nz, nz))
        for i, nearest_point, neighbours in self._neighbours(q):
            d, w = self._weights(neighbours, q[i], self.points.z[nearest_point])
            d -= mean_z[i]
            level = (y[neighbours] - y[nearest_point] - mean_y[i]) @ weights[i, :-1] + weights[i, -1]
            total[i] = w.sum()
            sums[i] = (d * (w * level)[:, None]).T @ d
        # A product with scaled rows is symmetric only up to rounding.
        return total, 0.5 * (sums + sums.transpose(0, 2, 1))

    def _weights(self, neighbours: np.ndarray, q: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d = self.points.z[neighbours] - c
        exponent = -np.einsum("ik,ik->i", d, d + 2 * (c - q)) / (2 * self.points.sigma**2)
        # The exponent exceeds 0 only by rounding, which has any size far away, where distances are equal.
        return d, np.exp(np.minimum(exponent, 64.0))

    def _neighbours(self, q: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Yield each query's index, the index of its nearest point, and the points whose weight is not omitted."""
        z = self.points.z
        square = np.einsum("ik,ik->i", z, z)
        reach = np.abs(z).max(axis=0).sum()
        cutoff = 2 * self.points.sigma**2 * -np.log(CUTOFF)
        block = max(1, _DISTANCES_PER_BLOCK // len(z))
        for begin in range(0, len(q), block):
            queries = q[begin : begin + block]
            distance = square - 2 * (queries @ z.T)
            size = np.abs(queries).sum(axis=1)
            rounding = (z.shape[1] + 4) * 2.0**-51 * reach * (reach + 2 * size)
            for i, row in enumerate(distance):
                nearest_point = int(np.argmin(row))
                yield begin + i, nearest_point, np.flatnonzero(row <= row[nearest_point] + cutoff + rounding[i])


def _with_ones(rows: np.ndarray) -> np.ndarray:
    return np.hstack((np.ones((len(rows), 1)), rows))


# Maximum number of parts that the points are divided into; the parts' sums are added in order.
_MAX_PARTS = 32
_QUERIES_PER_BATCH = 128
"""Maximum number of queries that the C program processes in one pass over the points."""
_PAIRS_PER_THREAD = 1 << 16
"""Minimum number of pairs of a point and a query for each thread."""
# Number of phases of the C program.
_PHASES = 4
_COUNTS = ("n_chunks", "n_boxes", "n_parts", "n_queries", "kind")
_NUMBERS = ("inverse", "cutoff", "reach")
_ARRAYS = (
    *("z", "y", "low", "high", "q", "mean_z", "mean_y", "weights"),
    *("least", "bound", "best", "partial", "sums", "found", "where", "ticket", "done"),
)
# Codes of the moments in the C program: first moments without and with slopes, and second moments.
_VALUES = 0
_SLOPES = 1
_CURVED = 2


class _Job(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int64) for name in _COUNTS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
    ]


class CompiledMoments:
    """Weighted sums like those of :class:`NumpyMoments`, computed in C.

    A query's result does not depend on the threads or on other queries, to the last bit. Raises
    ``CompilerError`` if there is no compiler.
    """

    def __init__(self, points: Cloud, threads: int | None = None) -> None:
        n, self._nz = points.z.shape
        self._ny = points.y.shape[1]
        compiler = find_compiler()
        self._run = load_library(ewda_source(self._nz, self._ny, compiler), ["run"]).run
        self._run.restype = None
        self._threads = checked_threads(threads)
        self._order = order_by_neighbours(points.z, POINTS_PER_BOX, REGISTER)
        rows = points.z[self._order]
        self._n_chunks = -(-n // POINTS_PER_BOX)
        self._n_parts = min(_MAX_PARTS, self._n_chunks)
        self._n_boxes = -(-self._n_chunks // compiler.width) * compiler.width
        low, high = bounding_boxes(rows, POINTS_PER_BOX, self._n_boxes)
        stored = {
            "z": chunk_rows(rows, POINTS_PER_BOX, FAR),
            "y": chunk_rows(points.y[self._order], POINTS_PER_BOX, 0.0),
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

    def first_moments(self, q: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return nearest points and first moments, see :meth:`NumpyMoments.first_moments`."""
        empty = np.zeros((len(q), 0))
        size = (1 + self._ny, 1 + self._nz if slopes else 1)
        return self._all(_SLOPES if slopes else _VALUES, size, q, empty, empty, empty)

    def second_moments(
        self, q: np.ndarray, mean_z: np.ndarray, mean_y: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return total weights and second moments, see :meth:`NumpyMoments.second_moments`."""
        size = (1 + self._nz, 1 + self._nz)
        _, sums = self._all(_CURVED, size, q, mean_z, mean_y, weights)
        below = np.tril(sums[:, 1:, 1:])
        above = np.tril(sums[:, 1:, 1:], -1).transpose(0, 2, 1)
        return sums[:, 0, 0], below + above

    def _all(self, kind: int, size: tuple[int, int], *arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the index of the nearest point (nq,) and the sums (nq, *size), computed in batches of queries."""
        count = len(arguments[0])
        rows = [np.ascontiguousarray(array, dtype=float) for array in arguments]
        nearest, sums = np.empty(count, dtype=np.int64), np.empty((count, *size))
        for begin in range(0, count, _QUERIES_PER_BATCH):
            end = min(begin + _QUERIES_PER_BATCH, count)
            batch = [array[begin:end] for array in rows]
            self._batch(kind, batch, nearest[begin:end], sums[begin:end])
        return self._order[nearest], sums

    def _batch(self, kind: int, arguments: list[np.ndarray], nearest: np.ndarray, sums: np.ndarray) -> None:
        n = len(nearest)
        counters = np.zeros((2, _PHASES), dtype=np.int64)
        arrays = {
            **dict(zip(("q", "mean_z", "mean_y", "weights"), arguments, strict=True)),
            "least": _aligned((n, self._n_boxes)),
            "bound": np.empty(n),
            "best": np.empty((n, self._n_parts)),
            "found": np.empty((n, self._n_parts), dtype=np.int64),
            "partial": np.empty((n, self._n_parts, sums.shape[1] * sums.shape[2])),
            "where": nearest,
            "sums": sums,
            "ticket": counters[0],
            "done": counters[1],
        }
        pointers = {name: array.ctypes.data for name, array in arrays.items()}
        job = _Job(**self._fixed, **pointers, n_queries=n, kind=kind)
        work = n * self._n_chunks * POINTS_PER_BOX
        threads = min(self._threads, max(1, work // _PAIRS_PER_THREAD), self._n_parts)
        on_threads(threads, lambda: self._run(ctypes.byref(job)))


def _aligned(shape: tuple[int, ...], values: np.ndarray | None = None) -> np.ndarray:
    """Return a C-ordered float array, aligned to 64 bytes for SIMD registers, with ``values`` if given."""
    size = int(np.prod(shape))
    raw = np.empty(size + 8)
    begin = -(raw.ctypes.data // 8) % 8
    array = raw[begin : begin + size].reshape(shape)
    if values is not None:
        array[...] = values
    return array


def order_by_neighbours(points: np.ndarray, chunk: int, finest: int) -> np.ndarray:
    """Return an order (n,) of ``points`` (n, nz) in which each chunk of ``chunk`` consecutive points is close together.

    The points are split recursively at the widest coordinate, at multiples of ``chunk``, as in a k-d
    tree whose leaves, except the last, are full. Full leaves are halved further in the same way, down
    to ``finest`` points; ``chunk / finest`` is a power of 2.
    """
    order = np.arange(len(points))
    pieces = [(0, len(points))]
    while pieces:
        begin, end = pieces.pop()
        n_chunks = -(-(end - begin) // chunk)
        if n_chunks < 2:
            continue
        piece = order[begin:end]
        rows = points[piece]
        column = rows[:, np.argmax(np.ptp(rows, axis=0))]
        middle = n_chunks // 2 * chunk
        order[begin:end] = piece[np.argpartition(column, middle)]
        pieces += [(begin, begin + middle), (begin + middle, end)]
    full = order[: len(points) // chunk * chunk]
    while chunk > finest and full.size:
        groups = full.reshape(-1, chunk)
        rows = points[groups]
        widest = np.argmax(np.ptp(rows, axis=1), axis=1)[:, None, None]
        column = np.take_along_axis(rows, widest, axis=2)[:, :, 0]
        full[:] = np.take_along_axis(groups, np.argsort(column, axis=1), axis=1).ravel()
        chunk //= 2
    return order


def chunk_rows(rows: np.ndarray, chunk: int, filling: float) -> np.ndarray:
    """Return ``rows`` (n, m) as (n_chunks, m, chunk), the last chunk padded with ``filling``."""
    n, m = rows.shape
    n_chunks = -(-n // chunk)
    padded = np.full((n_chunks * chunk, m), filling)
    padded[:n] = rows
    return padded.reshape(n_chunks, chunk, m).transpose(0, 2, 1)


def bounding_boxes(rows: np.ndarray, chunk: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return minimum and maximum coordinates (m, count) of every chunk; the last values are repeated.

    ``rows`` (n, m) are in the order of the chunks.
    """
    starts = np.arange(0, len(rows), chunk)
    of_box = np.minimum(np.arange(count), len(starts) - 1)
    low, high = (f.reduceat(rows, starts, axis=0) for f in (np.minimum, np.maximum))
    return low[of_box].T, high[of_box].T
