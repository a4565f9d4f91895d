"""Rollouts of a step under a policy: costs, gradients, and their moments over many samples."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch.arguments import (
    BLOCK,
    as_doubles,
    as_output,
    as_rows,
    checked_block,
    common_length,
)
from dynamics.batch.engines.casadi_kernel import CasadiKernel
from dynamics.batch.engines.choice import choose
from dynamics.batch.engines.numpy_kernel import NumpyKernel
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.engines.rollout_engines import (
    Call,
    ChunkEngine,
    RolloutEngine,
    c_rollout_engine,
)
from dynamics.batch.graphs.asked import Asked
from dynamics.batch.graphs.policy import RolloutPolicy
from dynamics.batch.graphs.rollout_tapes import build_tapes
from dynamics.batch.graphs.tape import tape_of, with_shared_reciprocals
from dynamics.batch.moments import Moments, merge_chunks
from dynamics.batch.nonfinite import BatchWarning, NonFinite, non_finite_rows
from dynamics.batch.random import Gaussian
from dynamics.contact import Step

# Moments are kept for each chunk until this many samples, and then merged into the total.
STRIDE = 1 << 22


@dataclass(frozen=True)
class Rollouts:
    """Values of n rollouts: `cost` (n,), `gradient` and `score` (n, *policy.shape) or None."""

    cost: np.ndarray
    gradient: np.ndarray | None
    score: np.ndarray | None
    nonfinite: NonFinite


@dataclass(frozen=True)
class RolloutMoments:
    """Moments over samples of the cost, its gradient, and the zeroth-order gradient.

    `gradient` is of d cost / d theta and `zeroth` of (cost - baseline) * score, each None where it
    was not asked for; their arrays have the policy's shape. Samples in which any value is NaN or
    infinite are left out of all of them and named by `nonfinite`.
    """

    cost: Moments
    gradient: Moments | None
    zeroth: Moments | None
    nonfinite: NonFinite


class RolloutFunction:
    """Cost of closed-loop rollouts through contact, and its exact gradient, for many samples.

        cost = sum_{t<N} stage_cost(x_t, u_t, p) + terminal_cost(x_N, p)
        u_t  = policy.law(x_t, theta_t) + w_t,    x_{t+1} = step(x_t, u_t, p)

    A stage cost with four arguments is of (x_t, u_t, u_t - u_{t-1}, p); calls then take `u_before`.

    `step` is a system closed by a contact law, the same that the NLP uses; p are its parameters.
    Backends, threads and block are those of `BatchFunction`; results depend neither on threads nor
    on block, to the last bit. Code size and compile time do not depend on `horizon`.

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
        backend: str = "auto",
        threads: int | None = None,
        block: int = BLOCK,
    ) -> None:
        if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 1:
            raise ValueError(f"horizon must be a whole number of steps, at least 1, not {horizon}")
        self.horizon, self.policy = horizon, policy
        self.threads, self.block = checked_threads(threads), checked_block(block)
        self.default_p = step.p.values
        self.tapes = build_tapes(step, stage_cost, terminal_cost, policy)
        self._derive = NumpyKernel(tape_of(self.tapes.derived))
        self.backend, self._engine = choose(backend, self._makers(), "the rollout")

    def _makers(self) -> dict[str, Any]:
        def chunks(make: Any) -> RolloutEngine:
            return ChunkEngine(self.tapes, self.horizon, self.policy.per_step, self.threads, make)

        makers: dict[str, Any] = {
            "c": lambda: c_rollout_engine(self.tapes, self.threads, self.block),
            "numpy": lambda: chunks(lambda fn: NumpyKernel(with_shared_reciprocals(tape_of(fn)))),
            "casadi": lambda: chunks(CasadiKernel),
        }
        if isinstance(self.tapes.forward, Asked):
            del makers["c"]
        return makers

    def __call__(
        self,
        x0: Any,
        theta: Any,
        p: Any | None = None,
        noise: Gaussian | Any | None = None,
        n_samples: int | None = None,
        *,
        u_before: Any | None = None,
        gradient: bool = True,
        score: bool = False,
        out: Rollouts | None = None,
    ) -> Rollouts:
        """Cost of each sample, with its gradient by theta and its score where asked.

        `x0` (n, nx), `theta` (n, *policy.shape) and `p` (n, np) may each lack the axis of samples
        and are then shared; None for p takes the step's own values. `noise` is `Gaussian`, an array
        (n, horizon, nu), or None. `n_samples` is needed only where no array tells it. The score,
        sum_t D_theta law(x_t, theta_t)' w_t / sigma^2, is the gradient by theta of the
        log-density of the noise. `out` is an earlier answer whose arrays are written over.

        Raises `ValueError` for wrong shapes, and for a score without `Gaussian` noise.
        """
        q = self._request(x0, theta, p, noise, n_samples, u_before, gradient, score)
        shape = (q.n, *self.policy.shape(self.horizon))
        cost = as_output(out and out.cost, (q.n,), "cost")
        parts = [
            as_output(out and getattr(out, name), shape, name) if wanted else None
            for name, wanted in (("gradient", gradient), ("score", score))
        ]
        rows = [None if a is None else a.reshape(q.n, q.theta.shape[1]) for a in parts]
        bad = self._engine.samples(q, cost.reshape(-1, 1), rows[0], rows[1]) if q.n else 0
        nonfinite = NonFinite()
        if bad:
            nonfinite = non_finite_rows([cost, *[a for a in parts if a is not None]])
        if nonfinite:
            warnings.warn(f"rollout: {nonfinite}", BatchWarning, stacklevel=2)
        return Rollouts(cost, parts[0], parts[1], nonfinite)

    def moments(
        self,
        x0: Any,
        theta: Any,
        p: Any | None = None,
        noise: Gaussian | Any | None = None,
        n_samples: int | None = None,
        *,
        u_before: Any | None = None,
        gradient: bool = True,
        score: bool = False,
        baseline: float = 0.0,
    ) -> RolloutMoments:
        """Mean and second moment over the samples, computed as they come and never stored.

        Arguments as for a call; with `score`, `zeroth` has the moments of the zeroth-order
        gradient (cost - baseline) * score. Raises `ValueError` as a call does.
        """
        q = self._request(x0, theta, p, noise, n_samples, u_before, gradient, score)
        q = replace(q, baseline=float(baseline))
        total: Moments | None = None
        bad: list[np.ndarray] = []
        for begin in range(0, q.n, STRIDE):
            part = q.part(begin, min(begin + STRIDE, q.n))
            merged, indices = self._stride(part)
            bad.append(begin + indices)
            total = merged if total is None else total.merged(merged)
        total = total or merge_chunks(*(np.zeros((0, q.n_values)),) * 3)
        indices = np.concatenate([*bad, np.empty(0, dtype=np.int64)])
        nonfinite = NonFinite(len(indices), indices)
        if nonfinite:
            warnings.warn(f"rollout: {nonfinite}; left out", BatchWarning, stacklevel=2)
        return self._named(total, q, nonfinite)

    def _stride(self, q: Call) -> tuple[Moments, np.ndarray]:
        chunk = self._engine.chunk
        table = np.zeros((-(-q.n // chunk), 1 + 2 * q.n_values))
        bad = self._engine.moments(q, table)
        indices = self._find_bad(q, table[:, 0], chunk) if bad else np.empty(0, dtype=np.int64)
        split = 1 + q.n_values
        return merge_chunks(table[:, 0], table[:, 1:split], table[:, split:]), indices

    def _find_bad(self, q: Call, counts: np.ndarray, chunk: int) -> np.ndarray:
        """Roll the chunks that lost samples out again, to say which samples they were."""
        found = []
        for i, count in enumerate(counts):
            begin, end = i * chunk, min((i + 1) * chunk, q.n)
            if count < end - begin:
                part, size = q.part(begin, end), q.theta.shape[1]
                values = [np.empty((part.n, 1)), *np.empty((2, part.n, size))]
                asked = [values[1] if q.gradient else None, values[2] if q.score else None]
                self._engine.samples(part, values[0], asked[0], asked[1])
                rows = non_finite_rows([values[0], *[a for a in asked if a is not None]])
                found.append(begin + rows.indices)
        return np.concatenate(found)

    def _named(self, total: Moments, q: Call, nonfinite: NonFinite) -> RolloutMoments:
        shape, size = self.policy.shape(self.horizon), q.theta.shape[1]

        def block(begin: int, end: int, to: tuple[int, ...]) -> Moments:
            mean, m2 = total.mean[begin:end].reshape(to), total.m2[begin:end].reshape(to)
            return Moments(total.n, mean, m2)

        after = 1 + size * q.gradient
        return RolloutMoments(
            cost=block(0, 1, ()),
            gradient=block(1, 1 + size, shape) if q.gradient else None,
            zeroth=block(after, after + size, shape) if q.score else None,
            nonfinite=nonfinite,
        )

    def _request(
        self,
        x0: Any,
        theta: Any,
        p: Any,
        noise: Any,
        n_samples: int | None,
        u_before: Any | None,
        gradient: bool,
        score: bool,
    ) -> Call:
        what, tapes = "the rollout", self.tapes
        start = self._start(x0, u_before)
        thetas = self._theta_rows(theta)
        parameters = as_rows(self.default_p if p is None else p, len(self.default_p), "p", what)
        derived = np.empty((tapes.np, len(parameters)))
        self._derive.run([np.ascontiguousarray(parameters.T)], [derived])
        w = None
        gaussian = noise if isinstance(noise, Gaussian) else None
        if score and gaussian is None:
            raise ValueError("a score needs Gaussian noise; give noise=Gaussian(sigma, seed)")
        if gaussian is not None:
            gaussian.scales(tapes.nu)
        elif noise is not None:
            w = self._noise_rows(noise)
        n = _sample_count({"x0": start, "theta": thetas, "p": parameters, "noise": w}, n_samples)
        return Call(
            n=n,
            horizon=self.horizon,
            parts=self.horizon if self.policy.per_step else 1,
            x0=start,
            theta=thetas,
            p=np.ascontiguousarray(derived.T),
            w=w,
            gaussian=gaussian,
            gradient=gradient,
            score=score,
        )

    def _start(self, x0: Any, u_before: Any | None) -> np.ndarray:
        """Initial states, with the input before beside them where the cost asks for it."""
        n_before = self.tapes.n_before
        if (u_before is not None) != (n_before > 0):
            raise ValueError(
                "the stage cost is of (x, u, du, p): give u_before, the input before the first"
                if n_before
                else "u_before was given, but the stage cost is of (x, u, p) and has no use for it"
            )
        states = as_rows(x0, self.tapes.nx - n_before, "x0", "the rollout")
        if u_before is None:
            return states
        before = as_rows(u_before, n_before, "u_before", "the rollout")
        n = common_length([states, before], ["x0", "u_before"], "the rollout")
        return np.hstack([np.broadcast_to(a, (n, a.shape[1])) for a in (states, before)])

    def _theta_rows(self, theta: Any) -> np.ndarray:
        shape = self.policy.shape(self.horizon)
        array = as_doubles(theta, "theta", "the rollout")
        if array.shape[-len(shape) :] != shape or array.ndim > len(shape) + 1:
            raise ValueError(
                f"theta has shape {array.shape}; expected {shape}, shared by all samples, "
                f"or (n_samples, {', '.join(map(str, shape))})"
            )
        return np.ascontiguousarray(array.reshape(-1, self.policy.total(self.horizon)))

    def _noise_rows(self, noise: Any) -> np.ndarray:
        shape = (self.horizon, self.tapes.nu)
        array = as_doubles(noise, "noise", "the rollout")
        if array.ndim != 3 or array.shape[1:] != shape:
            raise ValueError(
                f"noise has shape {array.shape}; expected (n_samples, {shape[0]}, {shape[1]}): "
                "samples, steps, inputs"
            )
        return np.ascontiguousarray(array.reshape(len(array), -1))


def _sample_count(rows: dict[str, np.ndarray | None], n_samples: int | None) -> int:
    """How many samples the arrays and `n_samples` agree on; `ValueError` where they do not."""
    lengths = {
        name: len(a)
        for name, a in rows.items()
        if a is not None and (len(a) != 1 or name == "noise")
    }
    if n_samples is not None:
        if isinstance(n_samples, bool) or int(n_samples) != n_samples or n_samples < 0:
            raise ValueError(f"n_samples must be a whole number of at least 0, not {n_samples!r}")
        lengths["n_samples"] = int(n_samples)
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        raise ValueError(f"the rollout's arrays disagree along axis 0 (samples): {told}")
    return next(iter(lengths.values()), 1)
