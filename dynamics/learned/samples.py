"""What a map is learned from."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from dynamics.learned.normalisation import Normalisation
from dynamics.learned.origin import Origin


@dataclass(frozen=True)
class Samples:
    """``z`` (n, nz) and ``y = f(z)`` (n, ny) in physical units, a row a sample.

    Raises ``ValueError`` for shapes that disagree with the names, and for rows that are not finite.
    """

    z: np.ndarray
    y: np.ndarray
    origin: Origin

    def __post_init__(self) -> None:
        wanted = (len(self.z), len(self.origin.z)), (len(self.z), len(self.origin.y))
        if (self.z.shape, self.y.shape) != wanted:
            raise ValueError(
                f"data: z has shape {self.z.shape} and y {self.y.shape}, expected {wanted[0]} and"
                f" {wanted[1]} from their names"
            )
        for rows, signals in ((self.z, self.origin.z), (self.y, self.origin.y)):
            broken = ~np.isfinite(rows)
            if broken.any():
                row, column = np.argwhere(broken)[0]
                raise ValueError(
                    f"data: {int(broken.any(axis=1).sum())} rows are not finite, the first is row"
                    f" {row} in {signals[column].name}; leave these rows out"
                )

    @property
    def scales(self) -> tuple[Normalisation, Normalisation]:
        """Of z and of y, over all rows; raises ``ValueError`` for a column that never varies."""
        named = (self.z, "{}", self.origin.z), (self.y, "the next {}", self.origin.y)
        z, y = (
            Normalisation.of(rows, [form.format(signal.name) for signal in signals])
            for rows, form, signals in named
        )
        return z, y

    @property
    def hash(self) -> str:
        """SHA-256 over names, shapes and bytes."""
        digest = hashlib.sha256()
        for rows, signals in ((self.z, self.origin.z), (self.y, self.origin.y)):
            digest.update(repr([signal.name for signal in signals]).encode())
            digest.update(f"{rows.dtype.str}{rows.shape}".encode())
            digest.update(np.ascontiguousarray(rows).tobytes())
        return digest.hexdigest()


def split_rows(n: int, fraction: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Row numbers of the rest and of the random ``fraction`` of n rows held out, each rising.

    Whatever holds rows of the same data out at the same seed holds the same ones out.
    """
    order = np.random.default_rng([seed, 1]).permutation(n)
    held = round(fraction * n)
    return np.sort(order[held:]), np.sort(order[:held])
