"""Points in chunks of near neighbours, with the box around each."""

from __future__ import annotations

import numpy as np


def neighbourly(points: np.ndarray, chunk: int, finest: int) -> np.ndarray:
    """An order of ``points`` (n, nz) in which every ``chunk`` consecutive ones lie close together.

    Halves at the widest coordinate, again and again, at a multiple of ``chunk``: the leaves of a
    k-d tree, of which only the last is not full. Those that are full are halved on in the same
    way, down to ``finest`` points; ``chunk / finest`` is a power of 2.
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


def chunked(rows: np.ndarray, chunk: int, filling: float) -> np.ndarray:
    """``rows`` (n, m) as (n_chunks, m, chunk), the last chunk filled up with ``filling``."""
    n, m = rows.shape
    n_chunks = -(-n // chunk)
    padded = np.full((n_chunks * chunk, m), filling)
    padded[:n] = rows
    return padded.reshape(n_chunks, chunk, m).transpose(0, 2, 1)


def boxes(rows: np.ndarray, chunk: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest coordinates (m, count) of every chunk; past the last chunk, of the last.

    ``rows`` (n, m) in the order of the chunks.
    """
    starts = np.arange(0, len(rows), chunk)
    of_box = np.minimum(np.arange(count), len(starts) - 1)
    low, high = (f.reduceat(rows, starts, axis=0) for f in (np.minimum, np.maximum))
    return low[of_box].T, high[of_box].T
