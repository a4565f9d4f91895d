"""Batched rollouts of a step under a policy: costs or returns, gradients, and moments over samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Unpack

import casadi as ca
import numpy as np

from dynamics.batch.arguments import NonFinite, as_output, as_rows, common_length
from dynamics.batch.engines.rollout_engines import RolloutArrays, RolloutRequest
from dynamics.batch.graphs.objective import Costs
from dynamics.batch.graphs.policy import RolloutPolicy
from dynamics.batch.random import Gaussian
from dynamics.batch.rolling import BatchedRollouts, SampleOptions, Samples
from dynamics.contact import Step


@dataclass(frozen=True)
class Rollouts:
    """Results of n rollouts: `cost` (n,) and, if requested, `gradient` and `score` (n, *policy.shape) and `states`.

    `states` (n, horizon + 1, nx) start with the initial states.
    """

    cost: np.ndarray
    gradient: np.ndarray | None
    score: np.ndarray | None
    states: np.ndarray | None
    nonfinite: NonFinite


class RolloutFunction(BatchedRollouts):
    """Cost of closed-loop rollouts through contact, and its exact gradient, for many samples.

        cost = sum_{t<N} stage_cost(x_t, u_t, p) + terminal_cost(x_N, p)
        u_t  = policy.law(x_t, theta_t) + w_t,    x_{t+1} = step(x_t, u_t, p)

    A stage cost of four arguments takes (x_t, u_t, u_t - u_{t-1}, p); calls then need `u_before`, u_{-1}.

    `step` is a system closed by a contact law; p are the step's parameters. `engine` takes backend, threads and block
    as `BatchFunction` does; results depend neither on threads nor on block, to the last bit. Code size and compile
    time do not depend on `horizon`.

        f = RolloutFunction(step, stage_cost, terminal_cost, 40, open_loop(nx, nu))
        r = f(x0, theta, noise=Gaussian(0.1, seed=0), n_samples=1000)
        m = f.moments(x0, theta, noise=Gaussian(0.1, seed=0), n_samples=1_000_000)

    Raises `ValueError` for dimensions that do not fit, `UnsupportedOperation` and `CompilerError`
    as `BatchFunction` does.
    """

    def __init__(
        self,
        step: Step,
        stage_cost: ca.Function,
        terminal_cost: ca.Function,
        horizon: int,
        policy: RolloutPolicy,
        **engine: Any,
    ) -> None:
        super().__init__(step, Costs(stage_cost, terminal_cost), horizon, policy, **engine)

    def __call__(
        self,
        x0: Any,
        theta: Any,
        p: Any | None = None,
        noise: Gaussian | Any | None = None,
        n_samples: int | None = None,
        *,
        gradient: bool = True,
        score: bool = False,
        states: bool = False,
        out: Rollouts | None = None,
        **options: Unpack[SampleOptions],
    ) -> Rollouts:
        """Return the cost of each sample, and on request its gradient with respect to theta and its score.

        `x0` (n, nx), `theta` (n, *policy.shape) and `p` (n, np) may each lack the axis of samples
        and are then shared; if p is None, the default values of the step's parameters are used. `noise` is
        `Gaussian`, an array (n, horizon, nu), or None. `n_samples` is needed only if no array implies it. The
        score, sum_t D_theta law(x_t, theta_t)' w_t / sigma^2, is the gradient with respect to theta of the
        log-density of those entries of the noise that can affect the cost (see `dynamics.batch.graphs.step_graphs`).
        `out` is an earlier result, whose arrays are overwritten.

        Raises `ValueError` for wrong shapes, and for a score without `Gaussian` noise.
        """
        q = self._make_request(x0, (theta, p, noise, n_samples), gradient=gradient, score=score, **options)
        shape = (q.n, *self.policy.shape(self.horizon))
        cost = as_output(out and out.cost, (q.n,), "cost")
        requested = [
            as_output(out and getattr(out, name), shape, name) if is_requested else None
            for name, is_requested in (("gradient", gradient), ("score", score))
        ]
        slopes, scores = (None if a is None else a.reshape(q.n, q.theta.shape[1]) for a in requested)
        nx, n_before = self.tapes.nx, self.tapes.n_carried
        trail = np.empty((q.n, (self.horizon + 1) * nx)) if states else None
        nonfinite = self._fill_samples(q, RolloutArrays(cost.reshape(-1, 1), slopes, scores, trail=trail))
        visited = None if trail is None else trail.reshape(q.n, -1, nx)[..., : nx - n_before]
        return Rollouts(cost, requested[0], requested[1], visited, nonfinite)

    def _make_request(self, x0: Any, samples: Samples, u_before: Any | None = None, **options: Any) -> RolloutRequest:
        return self._request(self._start(x0, u_before), samples, **options)

    def _start(self, x0: Any, u_before: Any | None) -> np.ndarray:
        """Return the initial states (n, nx), followed by u_{-1} if the stage cost depends on changes of input."""
        n_before = self.tapes.n_carried
        if (u_before is not None) != (n_before > 0):
            raise ValueError(
                "the stage cost is of (x, u, du, p): give u_before, the input before the first"
                if n_before
                else "u_before was given, but the stage cost is of (x, u, p) and does not use it"
            )
        states = as_rows(x0, self.tapes.nx - n_before, "x0", "the rollout")
        if u_before is None:
            return states
        input_before = as_rows(u_before, n_before, "u_before", "the rollout")
        n = common_length({"x0": states, "u_before": input_before}, "the rollout")
        return np.hstack([np.broadcast_to(a, (n, a.shape[1])) for a in (states, input_before)])


@dataclass(frozen=True)
class Episodes:
    """Results of n episodes of H steps: returns `value` (n,), and numbers of steps before the end, `lived` (n,).

    `gradient` and `score` (n, *policy.shape), and `trail` (n, H + 1, nx + 2), the states followed by
    the weight of a reward and the number of steps so far, are None if not requested.
    """

    value: np.ndarray
    lived: np.ndarray
    gradient: np.ndarray | None
    score: np.ndarray | None
    trail: np.ndarray | None
    nonfinite: NonFinite

    @property
    def states(self) -> np.ndarray:
        """States (n, H + 1, nx); an episode that has ended repeats its last state.

        Raises `ValueError` if states were not requested.
        """
        if self.trail is None:
            raise ValueError("the states were not kept; pass states=True")
        return self.trail[..., :-2]


class EpisodeFunction(BatchedRollouts):
    """Return of episodes through contact under a policy, and its exact gradient.

        V(theta, w) = sum_{t<H} d^t a_t reward(x_t, u_t, x_{t+1}, p) + d^H a_H final(x_H, p)

    d is the `discount`; a_t is 1 until the first state that is `done` and 0 from then on. An episode that is over
    adds nothing to return or gradient, and its state does not change.

        f = EpisodeFunction(step, Episode(reward, final, done), 40, dense_policy(observe, (64, 64), -1, 1))
        r = f(x0, theta, noise=Gaussian(0.1, seed=0), gradient=True)
        m = f.moments(x0, theta, noise=Gaussian(0.1, seed=0), n_samples=1_000_000)

    `parameters` are the step's, then `discount`, then the policy's; `f.parameters.pack` makes the p
    of a call. Backends, threads, block and errors are those of `RolloutFunction`.
    """

    _value_sign = -1.0

    def __call__(
        self,
        x0: Any,
        theta: Any,
        p: Any | None = None,
        noise: Gaussian | Any | None = None,
        n_samples: int | None = None,
        *,
        gradient: bool = False,
        score: bool = False,
        states: bool = False,
        **options: Unpack[SampleOptions],
    ) -> Episodes:
        """Compute the return of each sample and, on request, its gradient by theta, its score and its states.

        Shapes are those of `RolloutFunction`. The score, `sum_t a_t D_theta law(x_t)' w_t / sigma^2`, includes
        only steps before the end, and only noise that can affect the return. `linearise_along` are episodes of
        the same samples whose states were requested: every step then starts at the state of these episodes, and
        the gradient is chained along these states. If the episodes were simulated under the exact law and
        this function's step is smoothed, only the gradient is smoothed (algorithm 2 of adaptive barrier
        smoothing). `terminal_gradient` (n, nx) is the gradient of a further terminal reward with respect to the
        last state, such as a critic's discounted value, and zero for episodes that ended before; `gradient`
        then includes it.

        Raises `ValueError` for wrong shapes, and for a score without `Gaussian` noise.
        """
        q = self._make_request(x0, (theta, p, noise, n_samples), gradient=gradient, score=score, **options)
        shape = (q.n, *self.policy.shape(self.horizon))
        nx, last = self.tapes.nx, np.empty((q.n, self.tapes.nx))
        trail = np.empty((q.n, self.horizon + 1, nx)) if states else None
        flat = None if trail is None else trail.reshape(q.n, -1)
        results = RolloutArrays.allocate(q, last=last, trail=flat)
        nonfinite = self._fill_samples(q, results)
        if results.gradient is not None:
            np.negative(results.gradient, out=results.gradient)
        return Episodes(
            value=-results.cost[:, 0],
            lived=last[:, -1],
            gradient=None if results.gradient is None else results.gradient.reshape(shape),
            score=None if results.score is None else results.score.reshape(shape),
            trail=trail,
            nonfinite=nonfinite,
        )

    def _make_request(
        self,
        x0: Any,
        samples: Samples,
        linearise_along: Episodes | None = None,
        terminal_gradient: Any = None,
        **options: Any,
    ) -> RolloutRequest:
        states = as_rows(x0, self.tapes.nx - 2, "x0", "the rollout")
        start = np.hstack([states, np.ones((len(states), 1)), np.zeros((len(states), 1))])
        states_along = None
        if linearise_along is not None:
            shape = (self.horizon + 1, self.tapes.nx)
            if linearise_along.trail is None or linearise_along.trail.shape[1:] != shape:
                raise ValueError(
                    f"linearise_along needs episodes of {self.horizon} steps of the same system whose states"
                    " were kept; pass states=True"
                )
            states_along = linearise_along.trail.reshape(len(linearise_along.trail), -1)
        end_gradient = None
        if terminal_gradient is not None:
            rows = as_rows(terminal_gradient, self.tapes.nx - 2, "terminal_gradient", "the rollout")
            end_gradient = np.hstack([-rows, np.zeros((len(rows), 2))])
        return self._request(start, samples, linearise_along=states_along, terminal_gradient=end_gradient, **options)
