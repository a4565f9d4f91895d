"""Rollouts, from the measured state, of candidates for the next plan."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.batch import RolloutFunction, RolloutPolicy, StepFunction
from dynamics.batch.rolling import RolloutProgram
from ocp.judge.constraints import Broken
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel

OTHER_STARTS = 16
"""Maximum number of other starts for a step of a candidate; a candidate without solution is dropped, others remain."""
FULL_STEP = 2
"""Index of the candidate with step size 1, after the plan without and with the regulator's feedback."""
STEP_SHARES = np.array([0.0] * FULL_STEP + [1.0, 0.5, 0.25, 0.06])
"""Step sizes of the candidates that are rolled out, all but the first with the regulator's feedback."""
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
    """Rollouts with feedback ``u_k = clip(K_k x_k + k_k)`` under the contact law of a stage model.

    ``input_limit`` (nu,) bounds inputs without a finite bound.
    """

    def __init__(self, model: StageModel) -> None:
        self.model = model
        step, nx, nu = model.step, model.nx, model.nu
        x, theta = ca.SX.sym("x", nx), ca.SX.sym("theta", nu * (nx + 3))
        K, k = ca.reshape(theta[: nu * nx], nx, nu).T, theta[nu * nx : nu * nx + nu]
        low, high = theta[nu * (nx + 1) : nu * (nx + 2)], theta[nu * (nx + 2) :]
        law = ca.Function("clipped", [x, theta], [ca.fmin(ca.fmax(K @ x + k, low), high)])
        u, p = ca.SX.sym("u", nu), ca.SX.sym("p", len(step.p.values))
        free, end = (ca.Function("free", arguments, [ca.SX.zeros(1)]) for arguments in ([x, u, p], [x, p]))
        rolled = RolloutFunction(step, free, end, model.N, RolloutPolicy(law, per_step=True), threads=1)
        self._roll = rolled.with_starts(OTHER_STARTS)
        self._step = StepFunction(step, threads=1)
        self.input_limit = MAX_INPUT * model.problem.scales.u

    @property
    def compiled(self) -> RolloutProgram | None:
        """Compiled rollouts, or None on a computer without a C compiler."""
        return self._roll.compiled()

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the next states (n, nx) from states x (n, nx) and inputs u (n, nu)."""
        return self._step(x, u, p[0, self.model.of_step]).x_next

    def steer(self, *arrays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return K (S, N, nu, nx) and k (S, N, nu) of the candidates ``u + share du + K (x - x_plan - share dx)``.

        ``arrays`` are K (N, nu, nx), x_plan (N+1, nx), u (N, nu), dx, du and the shares (S,). The first candidate has
        no feedback.
        """
        gains, x, u, dx, du, shares = arrays
        K = np.broadcast_to(gains, (len(shares), *gains.shape)).copy()
        K[0] = 0.0
        fed_back = np.einsum("kij,kjs->ski", gains, np.stack([x[:-1], dx[:-1]], axis=2))
        k = u - fed_back[0] + shares[:, None, None] * (du - fed_back[1])
        k[0] = u
        return K, k

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
        lower, upper = np.maximum(bounds[0], -self.input_limit), np.minimum(bounds[1], self.input_limit)
        p_step = p[0, self.model.of_step]
        model, (S, N) = self.model, K.shape[:2]
        ends = np.broadcast_to(np.concatenate([lower, upper]), (S, N, 2 * model.nu))
        theta = np.concatenate([K.reshape(S, N, -1), k, ends], axis=2)
        x = self._roll.with_horizon(N)(x0, theta, p_step, gradient=False, states=True).states
        assert x is not None
        u = np.clip(np.einsum("skij,skj->ski", K, x[:, :-1]) + k, lower, upper)
        flattened = x[:, :-1].reshape(S * N, -1), u.reshape(S * N, -1)
        lam = self._step(*flattened, p_step).lam[:, : model.n].reshape(S, N, -1)
        merit, violations, gap = model.merits(x, u, lam, u_before, p, penalty)
        finite = np.isfinite(merit) & np.isfinite(x).all(axis=(1, 2)) & np.isfinite(lam).all(axis=(1, 2))
        merit = np.where(finite, merit, np.inf)
        best = int(merit.argmin())
        plan = Plan(x[best], u[best], lam[best], gap[best])
        return Rolled(plan, float(merit[best]), best, self.model.violations(violations[[best]]), x)
