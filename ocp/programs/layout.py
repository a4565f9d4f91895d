"""Layout of a vector in named blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Block:
    """A named array within a vector: its shape, its first index, and names of the entries along its last axis."""

    name: str
    shape: tuple[int, ...]
    start: int
    components: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of entries."""
        return int(np.prod(self.shape))

    @property
    def index(self) -> np.ndarray:
        """Indices of the block's entries in the vector, in the shape of the block."""
        return self.start + np.arange(self.size).reshape(self.shape)


class Layout:
    """Consecutive named blocks of a vector."""

    def __init__(self) -> None:
        self.blocks: dict[str, Block] = {}
        self.size = 0

    def add(self, name: str, shape: tuple[int, ...], components: tuple[str, ...] = ()) -> Block:
        """Append a block, which may be empty, and return it."""
        block = Block(name, shape, self.size, components)
        self.blocks[name] = block
        self.size += block.size
        return block

    def __contains__(self, name: str) -> bool:
        return name in self.blocks

    def __getitem__(self, name: str) -> Block:
        return self.blocks[name]

    def pack(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Return the vector made from a mapping of names to blocks; blocks that it lacks are zero."""
        vector = np.zeros(self.size)
        for name, value in values.items():
            block = self.blocks[name]
            vector[block.index] = np.broadcast_to(np.asarray(value, dtype=float), block.shape)
        return vector

    def unpack(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Return a mapping from names to the blocks of a vector."""
        flat = np.asarray(vector, dtype=float).ravel()
        return {name: flat[block.index] for name, block in self.blocks.items()}

    def locate(self, position: int) -> tuple[Block, tuple[int, ...]]:
        """Return the block that contains the index ``position``, and the index inside it; raise IndexError if none."""
        for block in self.blocks.values():
            if block.start <= position < block.start + block.size:
                return block, tuple(int(i) for i in np.unravel_index(position - block.start, block.shape))
        raise IndexError(position)
