"""Random search for a minimum by covariance matrix adaptation (CMA-ES)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.settings import Configured, setting
from ocp.errors import InputError


@dataclass(frozen=True, eq=False)
class SearchDistribution:
    """Gaussian from which a search draws candidates, and the state of its adaptation, in the notation of CMA-ES.

    The Gaussian has the ``mean`` (n,) and the covariance ``sigma² C``, with the step size ``sigma`` and C (n,
    n). ``p_sigma`` (n,) and ``p_c`` (n,) are the evolution paths of sigma and of C, and ``count`` is the number
    of iterations so far. Each coordinate of a candidate differs from that of ``centre`` (n,) by at most the
    search's ``reach``.
    """

    mean: np.ndarray
    centre: np.ndarray
    sigma: np.ndarray
    C: np.ndarray
    p_sigma: np.ndarray
    p_c: np.ndarray
    count: np.ndarray


@dataclass(frozen=True)
class RandomSearch(Configured):
    """Optimiser without gradients that adapts the mean, step size and covariance of a Gaussian (CMA-ES).

    Candidates are ``mean + sigma y_i`` with y_i ~ N(0, C); the better half is recombined into the next mean.
    Weights and rates are those of Hansen, The CMA evolution strategy: a tutorial, 2016, without negative
    weights. The search starts with ``C = I`` and the standard deviation ``width``. A pass ends after
    ``iterations`` iterations, or when no standard deviation of the Gaussian is above ``narrow``. Coordinates
    with little effect on the loss drift at random while others are far from their optimum. Each of the
    ``passes`` after the first therefore starts at the last mean, with the standard deviation ``width`` for the
    coordinate of least effect, and standard deviations inversely proportional to the effect for the others. No
    coordinate moves farther than ``reach`` from its start. The covariance is adapted because parameters such as
    masses and inertias may have similar effects, so that their estimates are correlated.
    """

    candidates: int = setting(32, "candidates per iteration", least=4)
    width: float = setting(0.3, "initial standard deviation of the candidates", above=0)
    iterations: int = setting(150, "maximum iterations of a pass", least=1)
    narrow: float = setting(1e-3, "standard deviation below which a pass ends", least=0)
    passes: int = setting(2, "passes; each starts where the last one ended", least=1)
    reach: float = setting(3.0, "largest change of a coordinate", above=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.narrow < self.width:
            raise InputError(
                f"the final width of a random search must be below its initial width, got {self.width:g} to"
                f" {self.narrow:g}"
            )
        if not self.width <= self.reach:
            raise InputError(f"reach must be at least the width {self.width:g}, got {self.reach:g}")

    def begin(
        self,
        mean: np.ndarray,
        sensitivity: np.ndarray | None = None,
        centre: np.ndarray | None = None,
    ) -> SearchDistribution:
        """Return the initial search distribution around ``mean`` (n,), wider along less sensitive coordinates.

        ``sensitivity`` (n,) is the effect of each coordinate on the loss (default: the same for all). A value
        that is not finite, because steps could not be solved, is replaced by the largest finite value.
        ``reach`` limits the distance from ``centre`` (n,) in each coordinate (default: ``mean``).
        """
        n = len(mean)
        effects = np.ones(n) if sensitivity is None else np.maximum(sensitivity, 1e-12)
        finite = np.isfinite(effects)
        effects = np.where(finite, effects, np.max(effects[finite], initial=1e-12))
        return SearchDistribution(
            mean=np.array(mean, float),
            centre=np.array(mean if centre is None else centre, float),
            sigma=np.array(self.width),
            C=np.diag((effects.min() / effects) ** 2),
            p_sigma=np.zeros(n),
            p_c=np.zeros(n),
            count=np.array(0),
        )

    def iterate(
        self, distribution: SearchDistribution, losses: Callable[[np.ndarray], np.ndarray], rng: np.random.Generator
    ) -> SearchDistribution:
        """Draw candidates (k, n), evaluate their ``losses`` (k,), and return the updated search distribution."""
        n = len(distribution.mean)
        lengths, axes = np.linalg.eigh(distribution.C)
        lengths = np.sqrt(np.maximum(lengths, 0.0))
        y = (rng.standard_normal((self.candidates, n)) * lengths) @ axes.T
        # The update uses the clipped steps; with unclipped steps the width would grow without effect.
        lower, upper = distribution.centre - self.reach, distribution.centre + self.reach
        z = np.clip(distribution.mean + distribution.sigma * y, lower, upper)
        candidate_losses, y = losses(z), (z - distribution.mean) / distribution.sigma
        ranking = np.argsort(np.where(np.isfinite(candidate_losses), candidate_losses, np.inf), kind="stable")
        weights = self.weights
        y = y[ranking[: len(weights)]]
        step = weights @ y
        # Directions of zero variance are left out of the whitened step.
        white = axes @ (np.divide(1, lengths, out=np.zeros(n), where=lengths > 0) * (axes.T @ step))
        return self.update(distribution, y, step, white)

    @property
    def weights(self) -> np.ndarray:
        """Recombination weights (k,) of the better half of the candidates, best candidate first; their sum is 1."""
        n_parents = self.candidates // 2
        weights = np.log((self.candidates + 1) / 2) - np.log(np.arange(1, n_parents + 1))
        return weights / weights.sum()

    def update(
        self, distribution: SearchDistribution, y: np.ndarray, step: np.ndarray, white: np.ndarray
    ) -> SearchDistribution:
        """Return the distribution updated by best steps ``y`` (k, n), their mean ``step``, and ``C^(-1/2) step``."""
        n, w = len(step), self.weights
        effective_size = 1 / np.sum(w**2)
        c_s = (effective_size + 2) / (n + effective_size + 5)
        damping = 1 + 2 * max(0.0, np.sqrt((effective_size - 1) / (n + 1)) - 1) + c_s
        c_c = (4 + effective_size / n) / (n + 4 + 2 * effective_size / n)
        c_1 = 2 / ((n + 1.3) ** 2 + effective_size)
        c_mu = min(1 - c_1, 2 * (effective_size - 2 + 1 / effective_size) / ((n + 2) ** 2 + effective_size))
        expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
        count = distribution.count + 1
        p_sigma = (1 - c_s) * distribution.p_sigma + np.sqrt(c_s * (2 - c_s) * effective_size) * white
        length = np.linalg.norm(p_sigma)
        # The evolution path of C is not updated while the width grows fast, since C would grow with it.
        path_is_short = length / np.sqrt(1 - (1 - c_s) ** (2 * count)) < (1.4 + 2 / (n + 1)) * expected
        p_c = (1 - c_c) * distribution.p_c + path_is_short * np.sqrt(c_c * (2 - c_c) * effective_size) * step
        decay = 1 - c_1 - c_mu + (not path_is_short) * c_1 * c_c * (2 - c_c)
        C = decay * distribution.C + c_1 * np.outer(p_c, p_c) + c_mu * (y.T * w) @ y
        return SearchDistribution(
            mean=distribution.mean + distribution.sigma * step,
            centre=distribution.centre,
            sigma=distribution.sigma * np.exp(c_s / damping * (length / expected - 1)),
            C=(C + C.T) / 2,
            p_sigma=p_sigma,
            p_c=p_c,
            count=count,
        )

    def deviations(self, distribution: SearchDistribution) -> np.ndarray:
        """Return the standard deviations (n,) of the search distribution."""
        return distribution.sigma * np.sqrt(np.diag(distribution.C))

    def is_done(self, distribution: SearchDistribution) -> bool:
        """Return whether the pass has reached its number of iterations or sufficiently small standard deviations."""
        return bool(distribution.count >= self.iterations or np.max(self.deviations(distribution)) <= self.narrow)
