"""Rollouts, from the measured state, of candidates for the next plan."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.batch import Episode, EpisodeFunction, RolloutPolicy, StepFunction
from ocp.judge.constraints import Broken
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel

MAX_INPUT = 1e6
"""Bound on inputs without a finite bound, in characteristic inputs."""


class Rolled(NamedTuple):
    """Rollouts of candidates: plan and merit of the best one, its number, its violated constraints, and all states.

    ``states`` is (S, N+1, nx).
    """

    plan: Plan
    merit: float
    best: int
    violated: list[Broken]
    states: np.ndarray


class CandidateRollouts:
    """Compiled rollouts with feedback ``u_k = clip(K_k x_k + k_k)`` under the contact law of a stage model."""

    def __init__(self, model: StageModel) -> None:
        self.model = model
        step, nx, nu = model.step, model.nx, model.nu
        x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", nu * (nx + 3))
        K, k = ca.reshape(theta[: nu * nx], nx, nu).T, theta[nu * nx : nu * nx + nu]
        low, high = theta[nu * (nx + 1) : nu * (nx + 2)], theta[nu * (nx + 2) :]
        law = ca.Function("clipped", [x, theta], [ca.fmin(ca.fmax(K @ x + k, low), high)])
        u, p = ca.SX.sym("u", nu), ca.SX.sym("p", 0)
        none = ca.Function("none", [x, p], [ca.SX.zeros(1)])
        reward = ca.Function("reward", [x, u, ca.SX.sym("x_next", nx), p], [ca.SX.zeros(1)])
        objective = Episode(reward, none, none)
        policy = RolloutPolicy(law, per_step=True)
        self._roll = EpisodeFunction(step, objective, model.N, policy, threads=1)
        self._step = StepFunction(step, threads=1)

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the next states (n, nx) from states x (n, nx) and inputs u (n, nu)."""
        return self._step(x, u, p[0, self.model.of_step]).x_next

    def roll_out(
        self,
        x0: np.ndarray,
        K: np.ndarray,
        k: np.ndarray,
        u_before: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        p: np.ndarray,
        penalty: float = MIN_PENALTY,
    ) -> Rolled:
        """Return the rollouts of candidates and the one with the lowest merit.

        K (S, N, nu, nx) and k (S, N, nu) are the gains of S candidates; N may be less than the model's. A
        candidate with an unsolved step has infinite merit.
        """
        model, (S, N) = self.model, K.shape[:2]
        input_limit = MAX_INPUT * model.problem.scales.u
        lower, upper = np.maximum(bounds[0], -input_limit), np.minimum(bounds[1], input_limit)
        ends = np.broadcast_to(np.concatenate([lower, upper]), (S, N, 2 * model.nu))
        theta = np.concatenate([K.reshape(S, N, -1), k, ends], axis=2)
        theta = np.pad(theta, ((0, 0), (0, model.N - N), (0, 0)), "edge")
        step_parameters = p[0, model.of_step]
        x = self._roll(x0, theta, np.append(step_parameters, 1.0), states=True).states[:, : N + 1]
        u = np.clip(np.einsum("skij,skj->ski", K, x[:, :-1]) + k, lower, upper)
        flattened = x[:, :-1].reshape(S * N, -1), u.reshape(S * N, -1)
        lam = self._step(*flattened, step_parameters).lam[:, : model.n].reshape(S, N, -1)
        merit, violations, gap = model.merits(x, u, lam, u_before, p, penalty)
        finite = np.isfinite(merit) & np.isfinite(x).all(axis=(1, 2)) & np.isfinite(lam).all(axis=(1, 2))
        merit = np.where(finite, merit, np.inf)
        best = int(np.argmin(merit))
        plan = Plan(x[best], u[best], lam[best], gap[best])
        return Rolled(plan, float(merit[best]), best, model.violations(violations[[best]]), x)
