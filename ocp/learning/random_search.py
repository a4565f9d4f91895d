"""Random search for a minimum by covariance matrix adaptation (CMA-ES)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.settings import Configured, setting
from ocp.errors import InputError

Cloud = dict[str, np.ndarray]
"""``mean``, ``centre`` (n,), ``width``, ``shape`` (n, n), two means of steps (n,), ``count``."""


@dataclass(frozen=True)
class RandomSearch(Configured):
    """Evolution of a Gaussian cloud's mean, width and covariance (CMA-ES), without gradients.

    Hansen, The CMA evolution strategy: a tutorial, 2016, with its weights and rates, negative
    weights left out: ``candidates`` y_i ~ N(0, C) at ``mean + width y_i``, the better half
    recombined. Begun with ``C = I`` and ``width``, a standard deviation; a pass ends after
    ``iterations`` or when no standard deviation of the cloud is above ``narrow``.

    What moves the loss little is carried along by chance while other parameters are far off. So
    there are ``passes``: each but the first begins where the last ended, with ``width`` for what
    moves the model least, and for the others as much less as they move it more.

    No coordinate goes farther than ``reach`` from where the search began.

    Candidates that follow a fixed N(0, I) with a width that decays, the best kept, are what the
    cloud is when its covariance never learns; masses and inertias that move alike need it.
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
                f"random search ends at a width below that of its start, got {self.width:g} to {self.narrow:g}"
            )
        if not self.width <= self.reach:
            raise InputError(f"reach must be at least the width {self.width:g}, got {self.reach:g}")

    def begin(
        self,
        mean: np.ndarray,
        sensitivity: np.ndarray | None = None,
        centre: np.ndarray | None = None,
    ) -> Cloud:
        """Return the cloud around ``mean`` (n,), wider along less sensitive (n,) coordinates.

        ``centre`` (n,) is where reach is measured from, by default the mean. A sensitivity that is
        not finite, where steps can no longer be solved, is that of the most sensitive.
        """
        n = len(mean)
        moves = np.ones(n) if sensitivity is None else np.maximum(sensitivity, 1e-12)
        finite = np.isfinite(moves)
        moves = np.where(finite, moves, np.max(moves[finite], initial=1e-12))
        return {
            "mean": np.array(mean, float),
            "centre": np.array(mean if centre is None else centre, float),
            "width": np.array(self.width),
            "shape": np.diag((moves.min() / moves) ** 2),
            "turn": np.zeros(n),
            "drift": np.zeros(n),
            "count": np.array(0),
        }

    def iterate(self, cloud: Cloud, losses: Callable[[np.ndarray], np.ndarray], rng: np.random.Generator) -> Cloud:
        """Draw candidates (k, n), evaluate their ``losses`` (k,), and update the cloud."""
        n = len(cloud["mean"])
        lengths, axes = np.linalg.eigh(cloud["shape"])
        lengths = np.sqrt(np.maximum(lengths, 0.0))
        y = (rng.standard_normal((self.candidates, n)) * lengths) @ axes.T
        # Clipped candidates count as drawn at the bound: else the cloud would grow without effect.
        lower, upper = cloud["centre"] - self.reach, cloud["centre"] + self.reach
        z = np.clip(cloud["mean"] + cloud["width"] * y, lower, upper)
        candidate_losses, y = losses(z), (z - cloud["mean"]) / cloud["width"]
        ranking = np.argsort(np.where(np.isfinite(candidate_losses), candidate_losses, np.inf), kind="stable")
        weights = self.weights
        y = y[ranking[: len(weights)]]
        step = weights @ y
        # A direction of no length gives no whitened step either.
        white = axes @ (np.divide(1, lengths, out=np.zeros(n), where=lengths > 0) * (axes.T @ step))
        return self.updated_cloud(cloud, y, step, white)

    @property
    def weights(self) -> np.ndarray:
        """Weights of the better half, best first; their sum is 1."""
        n_parents = self.candidates // 2
        weights = np.log((self.candidates + 1) / 2) - np.log(np.arange(1, n_parents + 1))
        return weights / weights.sum()

    def updated_cloud(self, cloud: Cloud, y: np.ndarray, step: np.ndarray, white: np.ndarray) -> Cloud:
        """Return the cloud after a recombined ``step`` (n,), with ``white`` its ``C^(-1/2) step``."""
        n, w = len(step), self.weights
        effective_size = 1 / np.sum(w**2)
        c_s = (effective_size + 2) / (n + effective_size + 5)
        damping = 1 + 2 * max(0.0, np.sqrt((effective_size - 1) / (n + 1)) - 1) + c_s
        c_c = (4 + effective_size / n) / (n + 4 + 2 * effective_size / n)
        c_1 = 2 / ((n + 1.3) ** 2 + effective_size)
        c_mu = min(1 - c_1, 2 * (effective_size - 2 + 1 / effective_size) / ((n + 2) ** 2 + effective_size))
        expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
        count = cloud["count"] + 1
        turn = (1 - c_s) * cloud["turn"] + np.sqrt(c_s * (2 - c_s) * effective_size) * white
        length = np.linalg.norm(turn)
        # While the width still grows fast the evolution path of C stalls, else C would grow with it.
        path_is_short = length / np.sqrt(1 - (1 - c_s) ** (2 * count)) < (1.4 + 2 / (n + 1)) * expected
        drift = (1 - c_c) * cloud["drift"] + path_is_short * np.sqrt(c_c * (2 - c_c) * effective_size) * step
        decay = 1 - c_1 - c_mu + (not path_is_short) * c_1 * c_c * (2 - c_c)
        shape = decay * cloud["shape"] + c_1 * np.outer(drift, drift) + c_mu * (y.T * w) @ y
        return {
            "centre": cloud["centre"],
            "mean": cloud["mean"] + cloud["width"] * step,
            "width": cloud["width"] * np.exp(c_s / damping * (length / expected - 1)),
            "shape": (shape + shape.T) / 2,
            "turn": turn,
            "drift": drift,
            "count": count,
        }

    def deviations(self, cloud: Cloud) -> np.ndarray:
        """Return the standard deviations (n,) of the cloud."""
        return cloud["width"] * np.sqrt(np.diag(cloud["shape"]))

    def is_done(self, cloud: Cloud) -> bool:
        """Return whether a pass has ended."""
        return bool(cloud["count"] >= self.iterations or np.max(self.deviations(cloud)) <= self.narrow)
