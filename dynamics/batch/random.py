"""Counter-based normal random numbers, the same in NumPy and in compiled kernels.

Philox4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011)
maps a counter of four 32-bit words under a key of two words to four random words. Here

    key     = SeedSequence(seed).generate_state(2)
    counter = (low word of the sample's index, high word, number of the quadruple, 0)

so every sample has its own stream, which does not depend on the number of samples: the first n samples of a
larger run are those of a run with n samples. The Box-Muller transform converts each pair of words to two normals: 32
random bits for the radius, 32 for the angle. The absolute value of a number is therefore at most 6.76. An exact
normal number exceeds this with probability 1 / 7e10; studies of tails beyond it need another generator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

# Multipliers of Philox4x32.
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
# Increments of the two key words in each round of Philox4x32.
INCREMENTS = (0x9E3779B9, 0xBB67AE85)
# Number of rounds of Philox4x32-10.
ROUNDS = 10
# Mask of the lower 32-bit word of a 64-bit index.
_LOW_WORD = np.uint64(0xFFFFFFFF)
# Number of bits of a word.
_WORD_BITS = np.uint64(32)


def philox(counter: Sequence[np.ndarray] | np.ndarray, key: tuple[int, int]) -> np.ndarray:
    """Return the random words of Philox4x32-10, uint64 (4, m), for `counter` (4, m), integers below 2**32."""
    c = [np.asarray(word, dtype=np.uint64) for word in counter]
    k = list(key)
    for _ in range(ROUNDS):
        product = [c[0] * np.uint64(MULTIPLIERS[0]), c[2] * np.uint64(MULTIPLIERS[1])]
        c = [
            (product[1] >> _WORD_BITS) ^ c[1] ^ np.uint64(k[0]),
            product[1] & _LOW_WORD,
            (product[0] >> _WORD_BITS) ^ c[3] ^ np.uint64(k[1]),
            product[0] & _LOW_WORD,
        ]
        k = [(word + step) & 0xFFFFFFFF for word, step in zip(k, INCREMENTS, strict=True)]
    return np.stack(np.broadcast_arrays(*c))


def key_of(seed: int | np.random.SeedSequence) -> tuple[int, int]:
    """Return the two-word Philox key of a seed.

    Raises `ValueError` unless the seed is a non-negative integer or a `SeedSequence`.
    """
    if isinstance(seed, np.random.SeedSequence):
        sequence = seed
    elif isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0:
        sequence = np.random.SeedSequence(int(seed))
    else:
        raise ValueError(f"seed must be a whole number of at least 0, not {seed!r}")
    low, high = sequence.generate_state(2)
    return int(low), int(high)


def standard_normals(key: tuple[int, int], first: int, n: int, size: int) -> np.ndarray:
    """Return independent N(0, 1) numbers `(n, size)` for the samples `first, ..., first + n - 1`.

    Value m of a sample comes from quadruple m // 4: with a = (i + 1/2) / 2**32 and b = j / 2**32,
    (i, j) its first two words or its last two, sqrt(-2 ln a) cos(2 pi b) for even m, sin for odd.
    """
    index = np.arange(first, first + n, dtype=np.uint64)[:, None]
    quadruple = np.arange((size + 3) // 4, dtype=np.uint64)
    zero = np.uint64(0)
    words = philox(np.broadcast_arrays(index & _LOW_WORD, index >> _WORD_BITS, quadruple, zero), key)
    radius = np.sqrt(-2.0 * np.log((words[[0, 2]].astype(np.float64) + 0.5) * 2.0**-32))
    angle = (2.0 * np.pi) * (words[[1, 3]].astype(np.float64) * 2.0**-32)
    four = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=-1)
    return np.ascontiguousarray(np.moveaxis(four, 0, 2).reshape(n, -1)[:, :size])


@dataclass(frozen=True)
class Gaussian:
    """White Gaussian noise w ~ N(0, diag(sigma)^2), drawn inside the rollout's kernel.

    `sigma` > 0 is the standard deviation of all inputs, or has one value for each input; `seed` chooses the
    random numbers; `first` is the index of the first sample, so that a run can be continued from where it stopped.
    With `is_negated` every sample is exactly -w in place of w.
    """

    sigma: float | np.ndarray
    seed: int | np.random.SeedSequence
    first: int = 0
    is_negated: bool = False

    def __post_init__(self) -> None:
        sigma = np.asarray(self.sigma, dtype=np.float64)
        if not (np.isfinite(sigma).all() and (sigma > 0).all()):
            raise ValueError(f"sigma must be positive and finite, not {self.sigma!r}")
        if self.first < 0:
            raise ValueError(f"first must be a sample index of at least 0, not {self.first}")
        key_of(self.seed)

    def negate(self) -> Gaussian:
        """Return the noise -w, for antithetic samples."""
        return replace(self, is_negated=not self.is_negated)

    def skip_samples(self, n: int) -> Gaussian:
        """Return the same noise without its first n samples."""
        return replace(self, first=self.first + n)

    def component_scales(self, nu: int) -> np.ndarray:
        """Return the factors (nu,) that scale N(0, 1) numbers to noise: sigma, or -sigma if `is_negated`.

        Raises `ValueError` if sigma has another length.
        """
        sigma = np.asarray(self.sigma, dtype=np.float64)
        if sigma.shape not in ((), (1,), (nu,)):
            raise ValueError(f"sigma has shape {sigma.shape}; expected one number or shape ({nu},), one for each input")
        return np.array(np.broadcast_to(-sigma if self.is_negated else sigma, (nu,)))

    def draw(self, n_samples: int, horizon: int, nu: int) -> np.ndarray:
        """Return the noise as an array `(n_samples, horizon, nu)`."""
        normals = standard_normals(key_of(self.seed), self.first, n_samples, horizon * nu)
        return normals.reshape(n_samples, horizon, nu) * self.component_scales(nu)
