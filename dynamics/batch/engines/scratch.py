"""Memory that is written over again and again."""

from __future__ import annotations

import math
import threading

import numpy as np

# Samples that are transposed at once: their rows should still be in cache for the next column.
_TILE = 256


class Scratch(threading.local):
    """Work arrays by name, each thread its own; fresh memory would cost a page fault every 4 KiB.

    What an array holds is lost once its name is asked for again.
    """

    def __init__(self) -> None:
        self._memory: dict[str, np.ndarray] = {}

    def array(self, name: str, *shape: int) -> np.ndarray:
        """An array of this shape, with whatever was left in it."""
        size = math.prod(shape)
        memory = self._memory.get(name)
        if memory is None or len(memory) < size:
            memory = self._memory[name] = np.empty(size)
        return memory[:size].reshape(shape)

    def columns(self, name: str, rows: np.ndarray) -> np.ndarray:
        """The transpose of (n_samples, size) as an array of its own, samples last."""
        columns = self.array(name, *rows.shape[::-1])
        transpose(rows, columns.T)
        return columns


def transpose(source: np.ndarray, target: np.ndarray) -> None:
    """Copy between (n_samples, size) arrays of which one is the transpose of a contiguous array."""
    for begin in range(0, len(source), _TILE):
        target[begin : begin + _TILE] = source[begin : begin + _TILE]
