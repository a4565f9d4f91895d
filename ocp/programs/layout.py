"""Named blocks of a vector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Block:
    """A named array inside a vector: its shape, where it starts, and the names of its last axis."""

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
        """Positions in the vector, in the block's shape."""
        return self.start + np.arange(self.size).reshape(self.shape)


class Layout:
    """Blocks laid one after the other in one vector."""

    def __init__(self) -> None:
        self.blocks: dict[str, Block] = {}
        self.size = 0

    def add(self, name: str, shape: tuple[int, ...], components: tuple[str, ...] = ()) -> Block:
        """Append a block; an empty one is kept so that its name is known."""
        block = Block(name, shape, self.size, components)
        self.blocks[name] = block
        self.size += block.size
        return block

    def __contains__(self, name: str) -> bool:
        return name in self.blocks

    def __getitem__(self, name: str) -> Block:
        return self.blocks[name]

    def pack(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Write blocks into one vector; a block that is not named stays zero."""
        vector = np.zeros(self.size)
        for name, value in values.items():
            block = self.blocks[name]
            vector[block.index] = np.broadcast_to(np.asarray(value, dtype=float), block.shape)
        return vector

    def unpack(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Read every block out of a vector."""
        flat = np.asarray(vector, dtype=float).ravel()
        return {name: flat[block.index] for name, block in self.blocks.items()}

    def locate(self, position: int) -> tuple[Block, tuple[int, ...]]:
        """Return the block that holds ``position``, and the index inside it."""
        for block in self.blocks.values():
            if block.start <= position < block.start + block.size:
                return block, tuple(int(i) for i in np.unravel_index(position - block.start, block.shape))
        raise IndexError(position)
