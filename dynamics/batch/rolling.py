"""Common part of all kinds of rollouts: tapes, engine, checked arguments, moments merged in order."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Any, Self, TypedDict, Unpack

import numpy as np

from dynamics.batch.arguments import (
    DEFAULT_BLOCK,
    BatchWarning,
    NonFinite,
    as_doubles,
    as_rows,
    common_length,
)
from dynamics.batch.engines.kernels import KERNEL_MAKERS, NumpyKernel, choose_backend
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.engines.rollout_engines import (
    ChunkEngine,
    CompiledRolloutEngine,
    RolloutArrays,
    RolloutRequest,
)
from dynamics.batch.graphs.objective import Objective
from dynamics.batch.graphs.policy import RolloutPolicy
from dynamics.batch.graphs.rollout_tapes import build_tapes, parameters_of
from dynamics.batch.graphs.step_graphs import ModelStepGraphs
from dynamics.batch.graphs.tape import tape_of
from dynamics.batch.random import Gaussian
from dynamics.contact import Step
from dynamics.settings import read_count, read_value


@dataclass(frozen=True)
class Moments:
    """Moments of n samples of a vector: `n`, `mean` and `m2 = sum (value - mean)^2`.

    `variance` is that of one sample, `standard_error` that of the mean; both need two samples and
    raise `ValueError` with fewer.
    """

    n: int
    mean: np.ndarray
    m2: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Unbiased variance of one sample, m2 / (n - 1)."""
        if self.n < 2:
            raise ValueError(f"a variance needs at least 2 finite samples, there are {self.n}")
        return self.m2 / (self.n - 1)

    @property
    def standard_error(self) -> np.ndarray:
        """Standard deviation of the mean, sqrt(variance / n)."""
        return np.sqrt(self.variance / self.n)

    def merge_with(self, other: Moments) -> Moments:
        """Moments of both sets of samples together (Chan, Golub, LeVeque)."""
        n, mean, m2 = _merge((np.array(self.n), self.mean, self.m2), (np.array(other.n), other.mean, other.m2))
        return Moments(int(n), mean, m2)


def merge_chunks(n: np.ndarray, mean: np.ndarray, m2: np.ndarray) -> Moments:
    """Merge chunks `n` (c,), `mean` and `m2` (c, size) by a tree over neighbours.

    The tree depends on c alone, and so do the rounding errors.
    """
    size = mean.shape[1]
    while len(n) > 1:
        if len(n) % 2:
            n = np.append(n, 0)
            mean, m2 = (np.vstack((a, np.zeros((1, size)))) for a in (mean, m2))
        n, mean, m2 = _merge((n[::2], mean[::2], m2[::2]), (n[1::2], mean[1::2], m2[1::2]))
    if not len(n):
        return Moments(0, np.zeros(size), np.zeros(size))
    return Moments(int(n[0]), mean[0], m2[0])


Samples = tuple[Any, Any | None, Any | None, int | None]
"""Parameters theta and p, noise, and number of the samples, as a call takes them."""
Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def _merge(left: Triple, right: Triple) -> Triple:
    total = left[0] + right[0]
    share = (right[0] / np.maximum(total, 1))[..., None]
    difference = right[1] - left[1]
    mean = left[1] + difference * share
    m2 = left[2] + right[2] + difference**2 * share * left[0][..., None]
    return total, mean, m2


# Moments are kept for each chunk until this many samples, and then merged into the total.
STRIDE = 1 << 22


@dataclass(frozen=True)
class RolloutMoments:
    """Moments over samples of the cost, or of an episode's return, and of both its gradients.

    `gradient` is of d value / d theta and `zeroth` of (value - baseline) * score, each None where
    it was not requested; their arrays have the policy's shape. Samples in which any value is NaN or
    infinite are left out of all of them and named by `nonfinite`.
    """

    value: Moments
    gradient: Moments | None
    zeroth: Moments | None
    nonfinite: NonFinite


class SampleOptions(TypedDict, total=False):
    """Further arguments of rollouts, which some kinds of them take."""

    u_before: Any
    linearise_along: Any
    terminal_gradient: np.ndarray | None


class Rolling(ABC):
    """A step under a policy, rolled out over `horizon` steps for many samples.

    `parameters` are those of the step, then the objective's and the policy's own.
    """

    _value_sign = 1.0
    """Sign of a sample's value, of which the engines add up the cost."""

    def __init__(
        self,
        step: Step,
        objective: Objective,
        horizon: int,
        policy: RolloutPolicy,
        backend: str = "auto",
        threads: int | None = None,
        block: int = DEFAULT_BLOCK,
    ) -> None:
        self.horizon, self.policy = _checked_horizon(horizon), policy
        self.threads, self.block = checked_threads(threads), read_count("block", block)
        self.parameters = parameters_of(step, objective, policy)
        self.default_p = self.parameters.values
        self.tapes = build_tapes(step, objective, policy)
        self._derive = NumpyKernel(tape_of(self.tapes.derived))
        self.backend, self._engine = choose_backend(backend, self._makers(), "the rollout")

    def over(self, horizon: int) -> Self:
        """The same over another horizon, with nothing built or compiled again."""
        other = copy(self)
        other.horizon = _checked_horizon(horizon)
        return other

    @property
    def acting(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks of noise w_t (horizon, nu) and of theta, in its shape, that reach the cost."""
        noise = self.tapes.cost_dependence.over(self.horizon)[0]
        return noise, self.policy.acting_parameters(noise)

    def moments(
        self,
        x0: Any,
        theta: Any,
        p: Any | None = None,
        noise: Gaussian | Any | None = None,
        n_samples: int | None = None,
        *,
        gradient: bool = True,
        score: bool = False,
        baseline: float = 0.0,
        **options: Unpack[SampleOptions],
    ) -> RolloutMoments:
        """Mean and second moment over the samples, computed as they come and never stored.

        Arguments as for a call; with `score`, `zeroth` has the moments of the zeroth-order
        gradient (value - baseline) * score. Raises `ValueError` as a call does.
        """
        cost_baseline, samples = self._value_sign * float(baseline), (theta, p, noise, n_samples)
        request = self._asked(x0, samples, gradient=gradient, score=score, baseline=cost_baseline, **options)
        return self._summed(request, self._value_sign)

    @abstractmethod
    def _asked(self, x0: Any, samples: Samples, **options: Any) -> RolloutRequest:
        """Return the request of a call."""

    def _makers(self) -> dict[str, Any]:
        tapes, threads = self.tapes, self.threads
        makers: dict[str, Any] = {
            name: partial(ChunkEngine, tapes, threads, make) for name, make in KERNEL_MAKERS.items()
        }
        if isinstance(tapes.forward, ModelStepGraphs):
            return makers
        return {"c": lambda: CompiledRolloutEngine(tapes, threads, self.block), **makers}

    def _sampled(self, q: RolloutRequest, results: RolloutArrays) -> NonFinite:
        """Fill the results sample by sample, and warn of those that are not finite."""
        n_bad = self._engine.samples(q, results) if q.n else 0
        nonfinite = results.non_finite() if n_bad else NonFinite()
        if nonfinite:
            warnings.warn(f"rollout: {nonfinite}", BatchWarning, stacklevel=3)
        return nonfinite

    def _summed(self, q: RolloutRequest, sign: float = 1.0) -> RolloutMoments:
        """Moments of what was requested, times `sign`."""
        total: Moments | None = None
        bad_indices: list[np.ndarray] = []
        for begin in range(0, q.n, STRIDE):
            end = min(begin + STRIDE, q.n)
            stride_moments, indices = self._stride(q.slice_samples(begin, end))
            bad_indices.append(begin + indices)
            total = stride_moments if total is None else total.merge_with(stride_moments)
        total = total or merge_chunks(*(np.zeros((0, q.n_values)),) * 3)
        indices = np.concatenate([*bad_indices, np.empty(0, dtype=np.int64)])
        nonfinite = NonFinite(len(indices), indices)
        if nonfinite:
            warnings.warn(f"rollout: {nonfinite}; left out", BatchWarning, stacklevel=3)
        shape, size = self.policy.shape(self.horizon), q.theta.shape[1]

        def block(begin: int, end: int, to: tuple[int, ...]) -> Moments:
            mean, m2 = total.mean[begin:end].reshape(to), total.m2[begin:end].reshape(to)
            return Moments(total.n, sign * mean, m2)

        zeroth_start = 1 + size * q.gradient
        gradient = block(1, 1 + size, shape) if q.gradient else None
        zeroth = block(zeroth_start, zeroth_start + size, shape) if q.score else None
        return RolloutMoments(block(0, 1, ()), gradient, zeroth, nonfinite)

    def _stride(self, q: RolloutRequest) -> tuple[Moments, np.ndarray]:
        chunk = self._engine.chunk
        table = np.zeros((-(-q.n // chunk), 1 + 2 * q.n_values))
        n_bad = self._engine.moments(q, table)
        indices = self._find_bad(q, table[:, 0], chunk) if n_bad else np.empty(0, dtype=np.int64)
        split = 1 + q.n_values
        return merge_chunks(table[:, 0], table[:, 1:split], table[:, split:]), indices

    def _find_bad(self, q: RolloutRequest, counts: np.ndarray, chunk: int) -> np.ndarray:
        """Roll out again the chunks with lost samples, to name these samples."""
        bad_indices = []
        for i, count in enumerate(counts):
            begin, end = i * chunk, min((i + 1) * chunk, q.n)
            if count < end - begin:
                chunk_call = q.slice_samples(begin, end)
                results = RolloutArrays.allocate(chunk_call)
                self._engine.samples(chunk_call, results)
                bad_indices.append(begin + results.non_finite().indices)
        return np.concatenate(bad_indices)

    def _request(
        self,
        start: np.ndarray,
        samples: Samples,
        *,
        gradient: bool,
        score: bool,
        linearise_along: np.ndarray | None = None,
        terminal_gradient: np.ndarray | None = None,
        baseline: float = 0.0,
    ) -> RolloutRequest:
        owner, tapes, (theta, p, noise, n_samples) = "the rollout", self.tapes, samples
        theta_rows = self._theta_rows(theta)
        parameters = as_rows(self.default_p if p is None else p, len(self.default_p), "p", owner)
        derived = np.empty((tapes.np, len(parameters)))
        self._derive.run([np.ascontiguousarray(parameters.T)], [derived])
        w = None
        gaussian = noise if isinstance(noise, Gaussian) else None
        if score and gaussian is None:
            raise ValueError("a score needs Gaussian noise; give noise=Gaussian(sigma, seed)")
        precision = None
        if gaussian is not None:
            precision = self.acting[0] / gaussian.component_scales(tapes.nu) ** 2
        elif noise is not None:
            w = self._noise_rows(noise)
        batched = {"noise": w, "along": linearise_along, "pull": terminal_gradient}
        lengths = {name: len(a) for name, a in batched.items() if a is not None}
        if n_samples is not None:
            lengths["n_samples"] = read_value("n_samples", n_samples, int, least=0)
        return RolloutRequest(
            n=common_length({"x0": start, "theta": theta_rows, "p": parameters}, owner, lengths),
            horizon=self.horizon,
            parts=self.horizon if self.policy.per_step else 1,
            x0=start,
            theta=theta_rows,
            p=np.ascontiguousarray(derived.T),
            w=w,
            gaussian=gaussian,
            linearise_along=linearise_along,
            terminal_gradient=terminal_gradient,
            precision=precision,
            gradient=gradient,
            score=score,
            baseline=baseline,
        )

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
                f"noise has shape {array.shape}; expected (n_samples, {shape[0]}, {shape[1]}): samples, steps, inputs"
            )
        return np.ascontiguousarray(array.reshape(len(array), -1))


def _checked_horizon(horizon: int) -> int:
    if isinstance(horizon, bool) or not isinstance(horizon, int) or horizon < 1:
        raise ValueError(f"horizon must be a whole number of steps, at least 1, not {horizon}")
    return horizon
