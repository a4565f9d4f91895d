"""One-dimensional contact systems and their averages over noisy data; sigma is in metres, and data are not normalised.

The systems are those of Suh et al. 2023, sec. IV: a block moved by a pusher, and a block between two walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfcx
from scipy.stats import norm

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.mlp import MlpModel
from dynamics.learned.training import train_network
from dynamics.learned.transitions import DataOrigin, Normalisation, Samples
from dynamics.systems.parameters import Signal
from ocp.errors import InputError

ORIGIN = DataOrigin((Signal("z", "m"),), (Signal("y", "m"),))
"""Input z and output y of a model along the line, both [m]."""
_METRES = Normalisation(np.zeros(1), np.ones(1))
"""Normalisation that does not change data in metres."""


@dataclass(frozen=True)
class LinePusher:
    """Block on a line, moved in one step by a pusher commanded to u: ``q+ = q + rho max(0, u - c)``.

    The pusher touches the block at c; ``rho = h² K/(m + h² K)`` for a block of mass m, a pusher of
    stiffness K and a step h. This solves eq. 13 of Suh et al. 2023 without friction.
    """

    rho: float = 0.99
    q: float = 0.0
    c: float = 0.0

    def step(self, u: ArrayLike) -> np.ndarray:
        """Return the block's next position f(u) [m] at the command u [m]."""
        return self.q + self.rho * np.maximum(0, np.asarray(u) - self.c)

    def smoothed(self, u: ArrayLike, sigma: float) -> np.ndarray:
        """Return the smoothed step f_sigma(u) = E f(u + w) [m], w ~ N(0, sigma²); Suh et al. 2023, eq. 2."""
        scaled_distance = (np.asarray(u) - self.c) / sigma
        return self.q + self.rho * sigma * (scaled_distance * norm.cdf(scaled_distance) + norm.pdf(scaled_distance))

    def noised(self, u: ArrayLike, sigma: float, low: float, high: float) -> np.ndarray:
        """Return g_sigma(u) [m]: the mean of f over a Gaussian around u, truncated to [low, high].

        This is g_sigma for data uniform on [low, high], where low <= c <= high; Suh et al. 2023, eq. 7.
        """
        u = np.asarray(u)
        ends = [(end - u) / sigma for end in (low, self.c, high)]
        below, kink, above = norm.cdf(ends)
        bells = norm.pdf(ends)
        moment = (u - self.c) * (above - kink) + sigma * (bells[1] - bells[2])
        return self.q + self.rho * moment / (above - below)


@dataclass(frozen=True)
class Walls:
    """Block that does not move, ``f(x) = x``, between walls at ``low`` and ``high`` [m]."""

    low: float = -1.0
    high: float = 1.0

    def noised(self, x: ArrayLike, sigma: float) -> np.ndarray:
        """Return g_sigma(x) [m] for data uniform between the walls: the mean of a truncated normal."""
        return np.asarray(x) + self.displacement(x, sigma)

    def displacement(self, x: ArrayLike, sigma: float) -> np.ndarray:
        """Return ``g_sigma(x) - x = sigma (pdf(a) - pdf(b))/(cdf(b) - cdf(a))``, a, b = (walls - x)/sigma."""
        side, ratio, mass, _, _ = self._relative_to_walls(x, sigma)
        return -side * sigma * (1 - ratio) / mass

    def slope(self, x: ArrayLike, sigma: float) -> np.ndarray:
        """Return ``dg_sigma/dx``: the variance of the truncated normal over sigma²."""
        _, ratio, mass, near_wall, far_wall = self._relative_to_walls(x, sigma)
        return 1 + (near_wall - far_wall * ratio) / mass - ((1 - ratio) / mass) ** 2

    def _relative_to_walls(self, x: ArrayLike, sigma: float) -> tuple[np.ndarray, ...]:
        """Return the side of x, the ratio of densities at the walls, the mass, and distances from both walls.

        The side is the sign of x from the middle. Densities are those of N(x, sigma²). The mass is the probability
        between the walls divided by the density at the nearer wall; distances are those of x from the walls in units
        of sigma.
        """
        # Relative to the density at the nearer wall nothing underflows, at any distance of x from the walls.
        from_middle = np.asarray(x) - 0.5 * (self.low + self.high)
        half_width, distance = 0.5 * (self.high - self.low), np.abs(from_middle)
        near_wall, far_wall = (distance - half_width) / sigma, (distance + half_width) / sigma
        ratio = np.exp(0.5 * (near_wall - far_wall) * (near_wall + far_wall))
        mass = _mills(near_wall) - ratio * _mills(far_wall)
        return np.sign(from_middle), ratio, mass, near_wall, far_wall


def _mills(s: np.ndarray) -> np.ndarray:
    """Return the Mills ratio at s: the upper tail probability of the standard normal divided by its density."""
    return np.sqrt(np.pi / 2) * erfcx(s / np.sqrt(2))


def average_of(z: np.ndarray, y: np.ndarray, sigma: float) -> EwdaModel:
    """Build the distance-weighted average g_sigma of pairs z, y (n,) [m]; Suh et al. 2023, eq. 11."""
    return EwdaModel(z[:, None], y[:, None], _METRES, sigma, ORIGIN)


def network_of(z: np.ndarray, y: np.ndarray, sigma: float, seed: int, **recipe: Any) -> MlpModel:
    """Train a network h_sigma on pairs z, y (n,) [m] with noise sigma [m] on z; Suh et al. 2023, eq. 3.

    ``recipe`` are fields of :class:`~dynamics.learned.training.Recipe`. Raises
    :class:`~ocp.errors.InputError` if the libraries for training are not installed.
    """
    pairs = Samples(z[:, None], y[:, None], ORIGIN)
    try:
        # Training expects noise in units of the inputs' standard deviation.
        return train_network(pairs, sigma / float(z.std()), seed, **recipe)
    except ValueError as error:
        raise InputError(f"this figure trains networks: {error}") from error


def model_values(model: EwdaModel | MlpModel, z: ArrayLike) -> np.ndarray:
    """Return the model's output y (n,) [m] at inputs z (n,) [m]."""
    return model.values(np.asarray(z, dtype=float).reshape(-1, 1))[:, 0]
