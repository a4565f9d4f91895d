"""Augmented random search: finite differences of the return along the best random directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ocp.errors import InputError
from ocp.learning.experiment import Experiment, at_least, positive
from ocp.learning.protocol import Algorithm, Row, State
from ocp.learning.unrolls.unrolling import finite_samples, normalised_state, roll, sample_row


@dataclass(frozen=True, kw_only=True)
class ARS(Algorithm):
    """V2-t of Mania, Guy and Recht (2018): normalised observations, top directions, sigma_R.

    ``theta <- theta + rate / (top sigma_R) sum_i (r_i+ - r_i-) delta_i`` over the ``top`` of
    ``directions`` delta_i ~ N(0, 1) by max(r_i+, r_i-), with returns r_i± of whole episodes at
    ``theta ± spread delta_i`` from the same start, and sigma_R their standard deviation over the 2
    top used. Parameters without a way to the return stay as they are. An episode that is not finite
    counts as the worst finite one.
    """

    name: ClassVar[str] = "ars"
    summary: ClassVar[str] = "augmented random search, V2-t"
    contact: ClassVar[str] = "exact"

    directions: Annotated[int, "random directions an iteration"] = 16
    top: Annotated[int, "best directions that count"] = 8
    spread: Annotated[float, "distance gone along each direction"] = 0.1
    rate: Annotated[float, "length of a step"] = 0.05

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` for settings that cannot be."""
        at_least(1, "directions", self.directions)
        at_least(1, "top", self.top)
        if self.top > self.directions:
            raise InputError(
                f"top is {self.top}, more than the {self.directions} directions; take fewer"
            )
        positive("spread", self.spread)
        positive("rate", self.rate)

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the best directions."""
        theta, n = state["theta"], self.directions
        acts = experiment.rollouts(experiment.task.horizon).function.acting[1]
        delta = acts * experiment.rng(k, "directions").standard_normal((n, theta.size))
        starts = experiment.first_states(n, experiment.rng(k, "starts"))
        found = roll(
            experiment,
            state,
            np.vstack([starts, starts]),
            experiment.task.horizon,
            theta=theta + self.spread * np.vstack([delta, -delta]),
        )
        good = finite_samples(experiment, state, found, k)
        returns = np.where(good, found.value, found.value[good].min()).reshape(2, n)
        change = self.rate * search_direction(returns, delta, self.top)
        row = {
            **sample_row(found, good),
            "gradient_norm": float(np.linalg.norm(change)) / self.rate,
        }
        moved = {**state, "theta": theta + change}
        return normalised_state(experiment, moved, found, good), row


def search_direction(returns: np.ndarray, delta: np.ndarray, top: int) -> np.ndarray:
    """``sum (r+ - r-) delta / (top sigma_R)`` of returns (2, n) and directions (n, n_theta)."""
    chosen = np.argsort(-returns.max(axis=0), kind="stable")[:top]
    used = returns[:, chosen]
    deviation = used.std()
    if deviation == 0:
        return np.zeros(delta.shape[1])
    return (used[0] - used[1]) @ delta[chosen] / (top * deviation)
