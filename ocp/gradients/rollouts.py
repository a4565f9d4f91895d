"""Cost of a problem along rollouts, as an objective in the inputs or the feedback gains."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.batch import Gaussian, Moments, RolloutFunction, RolloutPolicy, affine_policy, open_loop
from dynamics.contact import ContactLaw
from dynamics.systems import Signal
from ocp.gradients.objective import Bulk, CostSamples, Order, SampledObjective, without_warnings
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.policy import Feedback, OpenLoop, Policy
from ocp.problem.problem import Problem


class RolloutObjective(SampledObjective):
    """Cost of a problem's rollout under a contact law, with noise added to the input of every step.

        V(theta, w) = sum_k l(x_k, u_k, du_k) + l_N(x_N),   u_k = pi(x_k, theta) + w_k

    (Suh, Simchowitz, Zhang et al. 2022, eq. 1). ``theta`` contains the inputs of all steps or, for feedback,
    the rows of K followed by k for every step (for a single step if the feedback is stationary). Its default is
    the problem's initial guess, with K = 0. Inputs are not clipped to their bounds, since the estimators'
    theory assumes an unclipped policy. With several scenarios, sample i starts in scenario i modulo their
    number, so that the mean over samples is also a mean over scenarios. ``parameters`` are those of the problem
    and of the law, such as ``contact.mu``.

    Raises ``ValueError`` if the law cannot close the system.
    """

    def __init__(
        self,
        problem: Problem,
        law: ContactLaw,
        policy: Policy | None = None,
        theta: np.ndarray | None = None,
        **engine: Any,
    ) -> None:
        policy = OpenLoop() if policy is None else policy
        self.problem, self.policy = problem, policy
        self.step = law.close(replace(problem.system, parameters=problem.parameters))
        self.name, self.n_noise = problem.name, problem.N * problem.system.nu
        # The list is shared by all copies that differ only in values, so that functions are compiled once.
        self._compiled: list[RolloutFunction] = []
        self._engine = engine
        self.parameters = self.step.p.defaults
        shape = self._policy.shape(problem.N)
        self.theta = (self._guess(shape) if theta is None else np.asarray(theta, float).reshape(shape)).ravel()
        self.decision = _decision(problem, policy, shape)

    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Return the costs (n,) at the noise (n, N nu); the first nu columns are for step 0, the next nu for step 1."""
        n, system = len(noise), self.problem.system
        noise_per_step = np.ascontiguousarray(noise.reshape(n, self.problem.N, system.nu))
        return self._roll_out(n, 0, noise=noise_per_step, gradient=False).cost

    def nominal_cost(self) -> float:
        """Return the mean cost over the scenarios without noise."""
        return float(self.costs(np.zeros((self.problem.scenarios.n, self.n_noise))).mean())

    def cost_and_gradient(self, theta: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the mean cost over the scenarios at ``theta`` (d,) without noise, and its gradient (d,)."""
        costs, gradients = self.costs_and_gradients(theta[None])
        return float(costs[0]), gradients[0]

    def costs_and_gradients(self, theta: np.ndarray, gradient: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean costs (n,) over scenarios at ``theta`` (n, d) and gradients (n, d), zero if not requested."""
        (n, d), scenarios = theta.shape, self.problem.scenarios.n
        shaped = np.repeat(theta, scenarios, axis=0).reshape(-1, *self._policy.shape(self.problem.N))
        rollouts = self._roll_out(n * scenarios, 0, theta=shaped, gradient=gradient)
        gradients = rollouts.gradient if gradient else np.zeros((n * scenarios, d))
        means = rollouts.cost.reshape(n, scenarios).mean(axis=1)
        return means, gradients.reshape(n, scenarios, d).mean(axis=1)

    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) and scores ``sum_t D_theta pi(x_t)' w_t / sigma^2`` (n, d) of n samples."""
        rollouts = self._roll_out(n, noise.first, noise=noise, gradient=False, score=True)
        return CostSamples(rollouts.cost, rollouts.score.reshape(n, -1))

    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) of n samples and their exact gradients (n, d) through contact."""
        rollouts = self._roll_out(n, noise.first, noise=noise)
        return CostSamples(rollouts.cost, rollouts.gradient.reshape(n, -1))

    def sample_perturbed(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) of policies with noise on parameters instead of inputs, and the scores (n, d)."""
        d = len(self.theta)
        disturbance = noise.draw(n, 1, d)[:, 0]
        theta = (self.theta + disturbance).reshape(n, *self._policy.shape(self.problem.N))
        rollouts = self._roll_out(n, noise.first, theta=theta, gradient=False)
        acts = self._forward.acting[1].ravel()
        return CostSamples(rollouts.cost, acts * disturbance / noise.component_scales(d) ** 2)

    def moments(self, noise: Gaussian, n: int, order: Order, baseline: float = 0.0) -> Bulk | None:
        """Return moments over n samples, computed in the compiled function that draws the noise and simulates."""
        sums = without_warnings(
            self._forward.moments,
            **self._arguments(n, noise.first),
            noise=noise,
            gradient=order == "first",
            score=order == "zeroth",
            baseline=baseline,
        )
        moments = {"cost": sums.value, "zeroth": sums.zeroth, "first": sums.gradient}[order]
        flat = Moments(moments.n, np.ravel(moments.mean), np.ravel(moments.m2))
        return flat, sums.nonfinite.indices

    def _roll_out(self, n: int, first: int, **options: Any) -> Any:
        return without_warnings(self._forward, **self._arguments(n, first) | options)

    def _arguments(self, n: int, first: int) -> dict[str, Any]:
        problem = self.problem
        physical = problem.parameters.pack(self.parameters)
        x0 = problem.initial_states(physical)
        rows = (first + np.arange(n)) % len(x0)
        arguments: dict[str, Any] = {
            "n_samples": n,
            "x0": x0[rows] if len(x0) > 1 else x0[0],
            "theta": self.theta.reshape(self._policy.shape(problem.N)),
            "p": self.values,
        }
        if problem.uses_du:
            arguments["u_before"] = np.array(problem.limits(physical)[1]).ravel()
        return arguments

    def _guess(self, shape: tuple[int, ...]) -> np.ndarray:
        physical = self.problem.parameters.pack(self.parameters)
        inputs = self.problem.initial_guess(physical)[1]
        if isinstance(self.policy, OpenLoop):
            return inputs
        theta = np.zeros(shape)
        theta[..., -self.problem.system.nu :] = inputs if self._policy.per_step else inputs[0]
        return theta

    @cached_property
    def _policy(self) -> RolloutPolicy:
        nx, nu = self.problem.system.nx, self.problem.system.nu
        if isinstance(self.policy, Feedback):
            return affine_policy(nx, nu, per_step=not self.policy.stationary)
        return open_loop(nx, nu)

    @property
    def _forward(self) -> RolloutFunction:
        if not self._compiled:
            self._compiled.append(batch_rollouts(self.problem, self.step, self._policy, **self._engine))
        return self._compiled[0]


def _decision(problem: Problem, policy: Policy, shape: tuple[int, ...]) -> tuple[Signal, ...]:
    """Return the names and units of theta's components, such as ``u[3]``, ``K[3].u.x`` and ``k[3].u``."""
    system = problem.system
    if isinstance(policy, OpenLoop):
        input_units = [(s.name, s.unit) for s in system.inputs]
        return tuple(Signal(f"{n}[{t}]", unit) for t in range(shape[0]) for n, unit in input_units)
    gains = [(f".{u.name}.{x.name}", f"{u.unit}/({x.unit})") for u in system.inputs for x in system.states]
    offsets = [(f".{u.name}", u.unit) for u in system.inputs]
    steps = [f"[{t}]" for t in range(shape[0])] if len(shape) == 2 else [""]
    return tuple(
        Signal(f"{symbol}{step}{suffix}", unit)
        for step in steps
        for symbol, entries in (("K", gains), ("k", offsets))
        for suffix, unit in entries
    )
