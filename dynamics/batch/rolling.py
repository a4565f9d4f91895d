"""Base class of batched rollouts: tapes, engine, checks of arguments, and moments over the samples."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass, replace
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
from dynamics.batch.engines.kernels import KERNEL_MAKERS, ParameterKernel, choose_backend
from dynamics.batch.engines.parallel import checked_threads
from dynamics.batch.engines.rollout_engines import (
    ChunkEngine,
    CompiledRolloutEngine,
    RolloutArrays,
    RolloutRequest,
    find_bad_samples,
)
from dynamics.batch.graphs.objective import Objective
from dynamics.batch.graphs.policy import RolloutPolicy
from dynamics.batch.graphs.rollout_tapes import ClosedStep, parameters_of, with_carried_values
from dynamics.batch.graphs.step_graphs import ModelStepGraphs, RolloutTapes
from dynamics.batch.random import Gaussian
from dynamics.contact import Step
from dynamics.settings import read_count, read_value


@dataclass(frozen=True)
class Moments:
    """Moments of n samples of an array: `n`, `mean` and `m2 = sum (value - mean)^2`.

    `variance` and `standard_error` raise `ValueError` with fewer than two samples.
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
        """Standard error of the mean, sqrt(variance / n)."""
        return np.sqrt(self.variance / self.n)

    def merge_with(self, moments: Moments) -> Moments:
        """Return the moments of the union of both sets of samples (Chan, Golub and LeVeque)."""
        n, mean, m2 = _merge((np.array(self.n), self.mean, self.m2), (np.array(moments.n), moments.mean, moments.m2))
        return Moments(int(n), mean, m2)


def merge_chunks(n: np.ndarray, mean: np.ndarray, m2: np.ndarray) -> Moments:
    """Merge the moments of c chunks, `n` (c,), `mean` and `m2` (c, size), pairwise along a binary tree.

    The tree depends on c alone, so that rounding errors do not depend on the number of threads.
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
"""Arguments (theta, p, noise, n_samples) of a call."""
Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def _merge(left: Triple, right: Triple) -> Triple:
    total = left[0] + right[0]
    share = (right[0] / np.maximum(total, 1))[..., None]
    difference = right[1] - left[1]
    mean = left[1] + difference * share
    m2 = left[2] + right[2] + difference**2 * share * left[0][..., None]
    return total, mean, m2


# Number of samples whose chunks' moments are stored before they are merged into the total.
SAMPLES_PER_STRIDE = 1 << 22


@dataclass(frozen=True)
class RolloutMoments:
    """Moments over the samples: of the cost, or of an episode's return, and of its gradient estimates.

    `gradient` has the moments of d value / d theta, `zeroth` those of (value - baseline) * score, in the
    policy's shape; each is None if it was not requested. Samples with a NaN or an infinity, which
    `nonfinite` lists, are left out of all moments.
    """

    value: Moments
    gradient: Moments | None
    zeroth: Moments | None
    nonfinite: NonFinite


class SampleOptions(TypedDict, total=False):
    """Keyword arguments that only some rollouts accept: `u_before`, or the options of `EpisodeFunction`."""

    u_before: Any
    linearise_along: Any
    terminal_gradient: np.ndarray | None


@dataclass(frozen=True)
class RolloutProgram:
    """The code of a rollout: its ``engine``, and the function that maps parameters to those of the engine."""

    derive: ParameterKernel
    engine: Any


class BatchedRollouts(ABC):
    """Base of rollouts of a step under a policy over `horizon` steps, for many samples.

    Code is compiled at the first call that needs it: code for costs and states alone, or code that also computes
    gradients, scores and moments, and draws noise, which takes twice as long to compile.
    `parameters` are the parameters of the step, then of the objective, then of the policy.
    """

    _value_sign = 1.0
    """Sign of a sample's value relative to the cost that the engines compute."""

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
        self._closed_step, self._backend = ClosedStep(step, objective, policy), backend
        self.tapes = self._closed_step.tapes
        # Copies with another horizon share the programs.
        self._programs: dict[bool, RolloutProgram] = {}

    def with_horizon(self, horizon: int) -> Self:
        """Return a copy with another horizon, which shares the compiled code."""
        copied = copy(self)
        copied.horizon = _checked_horizon(horizon)
        return copied

    def with_starts(self, starts: int) -> Self:
        """Return a copy that tries at most ``starts`` other starts for a step whose path fails."""
        copied = copy(self)
        copied.tapes, copied._programs = self.tapes.with_starts(starts), {}
        return copied

    @property
    def acting(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks of the entries of the noise w_t (horizon, nu) and of theta (in its shape) that can affect the cost."""
        noise = self._closed_step.cost_dependence.masks(self.horizon)[0]
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
        """Return mean and second moment over the samples, computed without storing the samples.

        The arguments are those of a call; with `score`, `zeroth` has the moments of the zeroth-order gradient
        (value - baseline) * score. Raises `ValueError` as a call does.
        """
        cost_baseline, samples = self._value_sign * float(baseline), (theta, p, noise, n_samples)
        request = self._make_request(x0, samples, gradient=gradient, score=score, baseline=cost_baseline, **options)
        return self._moments(request, self._value_sign)

    def compiled(self) -> RolloutProgram | None:
        """Return the compiled program of costs and states, or None with another backend."""
        program = self._program(with_adjoint=False)
        return program if isinstance(program.engine, CompiledRolloutEngine) else None

    @abstractmethod
    def _make_request(self, x0: Any, samples: Samples, **options: Any) -> RolloutRequest:
        """Return the checked request for the engine, made from the arguments of a call."""

    def _program(self, *, with_adjoint: bool) -> RolloutProgram:
        """Return code for costs and states, and for everything else with ``with_adjoint``."""
        with_adjoint = with_adjoint or True in self._programs
        if with_adjoint not in self._programs:
            tapes = with_carried_values(self._closed_step.tapes_with_adjoint) if with_adjoint else self.tapes
            engine = choose_backend(self._backend, self._makers(tapes), "the rollout")[1]
            self._programs[with_adjoint] = RolloutProgram(ParameterKernel(tapes.derived), engine)
        return self._programs[with_adjoint]

    def _makers(self, tapes: RolloutTapes) -> dict[str, Any]:
        threads = self.threads
        makers: dict[str, Any] = {
            name: partial(ChunkEngine, tapes, threads, make) for name, make in KERNEL_MAKERS.items()
        }
        if isinstance(tapes.forward, ModelStepGraphs):
            return makers
        return {"c": lambda: CompiledRolloutEngine(tapes, threads, self.block), **makers}

    def _fill_samples(self, q: RolloutRequest, results: RolloutArrays) -> NonFinite:
        """Fill `results`, warn of samples that are not finite, and return these samples."""
        program = self._program(with_adjoint=q.gradient or q.score or q.gaussian is not None)
        n_bad = program.engine.samples(replace(q, p=program.derive(q.p)), results) if q.n else 0
        nonfinite = results.non_finite() if n_bad else NonFinite()
        if nonfinite:
            warnings.warn(f"rollout: {nonfinite}", BatchWarning, stacklevel=3)
        return nonfinite

    def _moments(self, q: RolloutRequest, sign: float = 1.0) -> RolloutMoments:
        """Return the moments of the requested results, with their means multiplied by `sign`."""
        total: Moments | None = None
        bad_indices: list[np.ndarray] = []
        for begin in range(0, q.n, SAMPLES_PER_STRIDE):
            end = min(begin + SAMPLES_PER_STRIDE, q.n)
            stride_moments, indices = self._stride_moments(q.slice_samples(begin, end))
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

    def _stride_moments(self, q: RolloutRequest) -> tuple[Moments, np.ndarray]:
        program = self._program(with_adjoint=True)
        engine, q = program.engine, replace(q, p=program.derive(q.p))
        chunk = engine.chunk
        table = np.zeros((-(-q.n // chunk), 1 + 2 * q.n_values))
        n_bad = engine.moments(q, table)
        indices = find_bad_samples(engine, q, table[:, 0]) if n_bad else np.empty(0, dtype=np.int64)
        split = 1 + q.n_values
        return merge_chunks(table[:, 0], table[:, 1:split], table[:, split:]), indices

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
        w = None
        gaussian = noise if isinstance(noise, Gaussian) else None
        if score and gaussian is None:
            raise ValueError("a score needs Gaussian noise; give noise=Gaussian(sigma, seed)")
        precision = None
        if gaussian is not None:
            precision = self.acting[0] / gaussian.component_scales(tapes.nu) ** 2
        elif noise is not None:
            w = self._noise_rows(noise)
        batched = {"noise": w, "linearise_along": linearise_along, "terminal_gradient": terminal_gradient}
        lengths = {name: len(a) for name, a in batched.items() if a is not None}
        if n_samples is not None:
            lengths["n_samples"] = read_value("n_samples", n_samples, int, least=0)
        return RolloutRequest(
            n=common_length({"x0": start, "theta": theta_rows, "p": parameters}, owner, lengths),
            horizon=self.horizon,
            parts=self.horizon if self.policy.per_step else 1,
            x0=start,
            theta=theta_rows,
            p=parameters,
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
