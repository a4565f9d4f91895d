"""Total propagation of likelihood-ratio and reparametrised gradients, mixed at each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ocp.errors import InputError, NotConverged
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Row, State
from ocp.learning.total_propagation.particles import Particles, acting_entries, simulate_particles
from ocp.learning.unrolls.unrolled import Clipping
from ocp.learning.unrolls.unrolling import Starts, non_finite_reward, policy_of, with_observations


@dataclass(frozen=True, kw_only=True)
class TotalPropagation(Clipping):
    """Particles ``x_{t+1} = f(x_t, u_t) + sigma e_t``, and one gradient of their mean return.

    Backwards, at each step, the gradient by the mean of x_{t+1} is taken both ways and mixed,
    ``k L + (1 - k) R``, ``k = 1 / (1 + v_L / v_R)``, with the variances over the particles of what
    each gives for the policy's parameters (:func:`total_propagation`). ``sigma`` [units of the
    state] is the same for all entries; the policy has no noise of its own.

    Source: Parmas, Rasmussen, Peters and Doya (ICML 2018), algorithm 1. Their PIPPS is this with a
    learned Gaussian process for f and importance weights over the batch in L, neither of them here.
    """

    name: ClassVar[str] = "total-propagation"
    summary: ClassVar[str] = "both orders mixed at every step backwards, along noisy states"
    contact: ClassVar[str] = "exact"

    sigma: Annotated[float, "deviation of the particles' noise [units of the state]"] = 1e-2
    least: ClassVar[int] = 2

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the gradient of total propagation."""
        starts, steps = Starts.of(state), self.steps(experiment)
        shape = (steps, *starts.x.shape)
        noise = experiment.rng(k, "states").standard_normal(shape)
        found = simulate_particles(experiment, policy_of(state), starts.x, self.sigma * noise)
        lost = np.argwhere(found.good & ~np.isfinite(found.rewards))
        if len(lost):
            step, sample = lost[0].tolist()
            raise InputError(
                non_finite_reward(experiment, step, f"sample {sample} in iteration {k}")
            )
        good = found.good
        if good.sum() < 2:
            raise NotConverged(
                f"{experiment.task.name}: {good.sum()} of {self.samples} particles of iteration {k}"
                " stayed finite; lower the learning rate, sigma or the unroll length"
            )
        part = found.part(good)
        score = acting_entries(experiment, steps)[:, None] * noise[:, good] / self.sigma
        gradients, share = total_propagation(part, score)
        gradients = self.clipped(gradients)
        gradient = gradients.mean(axis=0)
        moved = {
            **self.climb(state, gradient),
            **starts.after(experiment, found.states, found.lived, k).arrays(),
        }
        changed = with_observations(experiment, moved, part.seen[part.alive])
        row = {
            "return_mean": float(part.rewards.sum(axis=0).mean()),
            "nonfinite": float((~good).sum()),
            "gradient_norm": float(np.linalg.norm(gradient)),
            "gradient_variance": float(gradients.var(axis=0, ddof=1).sum()),
            "likelihood_ratio_share": float(share.mean()),
        }
        return changed, row


def total_propagation(particles: Particles, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (n, n_theta) of the return, and the share k (H,) of the likelihood ratio.

    ``score`` (H, n, nx) is that of the mean of x_{t+1}, ``e_t / sigma``, of entries that have a way
    to the return. With G_{t+1} the return from x_{t+1} on and g its gradient by x_{t+1}, the
    gradient of ``r_t + G_{t+1}`` by the mean of x_{t+1} is ``R = dr_t/dx_{t+1} + g`` or
    ``L = (r_t + G_{t+1} - b) score``, b the mean of the other particles that are alive.
    """
    after, togo = particles.final_by_x, particles.final
    total, shares = 0.0, np.zeros(len(particles.alive))
    for t in reversed(range(len(shares))):
        alive = particles.alive[t]
        on = alive[:, None]
        togo = np.where(alive, particles.rewards[t] + togo, 0.0)
        advantage = (togo - _others(togo, alive))[:, None]
        ways = [
            np.where(on, bar, 0.0) for bar in (advantage * score[t], particles.r_by_next[t] + after)
        ]
        by_x, by_u = particles.x_by_x[t], particles.x_by_u[t]
        by_theta = [particles.pulled(t, _times(bar, by_u))[0] for bar in ways]
        v_L, v_R = (float(each.var(axis=0, ddof=1).sum()) for each in by_theta)
        k = shares[t] = v_R / (v_L + v_R) if v_L + v_R > 0 else 0.0
        mixed = k * ways[0] + (1 - k) * ways[1]
        bar_u = np.where(on, _times(mixed, by_u) + particles.r_by_u[t], 0.0)
        change, through = particles.pulled(t, bar_u)
        total = total + change
        after = np.where(on, _times(mixed, by_x) + particles.r_by_x[t] + through, 0.0)
    return np.asarray(total), shares


def _times(bar: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """``bar' slope`` of each sample, (n, a) and (n, a, b)."""
    return np.einsum("na,nab->nb", bar, slope)


def _others(values: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Mean of the other particles that are alive, 0 where there is none."""
    count = alive.sum()
    return (values[alive].sum() - values) / max(count - 1, 1) if count > 1 else 0.0 * values
