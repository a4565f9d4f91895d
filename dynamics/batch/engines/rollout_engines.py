"""Backends of rollouts, and the requests and results that they exchange with their callers."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import casadi as ca
import numpy as np

from dynamics.batch.arguments import NonFinite, non_finite_rows
from dynamics.batch.engines import c_rollout, compiler
from dynamics.batch.engines.c_flat import data_address
from dynamics.batch.engines.chunk_rollout import PYTHON_CHUNK, ChunkRollout
from dynamics.batch.engines.kernels import Kernel
from dynamics.batch.engines.parallel import copy_transposed, over_chunks, run_chunks
from dynamics.batch.graphs.step_graphs import RolloutTapes
from dynamics.batch.random import Gaussian, key_of

Array = np.ndarray


@dataclass(frozen=True)
class RolloutRequest:
    """Request to evaluate n rollouts; arrays have n rows, or one row that all samples share.

    `x0` (., nx), `theta` (., parts * n_theta), `p` (., np); `w` (n, horizon * nu) is the noise itself,
    `gaussian` describes noise to be drawn; both are None without noise. `precision` (horizon, nu) is
    1 / sigma^2, the factor of each noise in the score, and 0 for noise that does not affect the cost;
    `baseline` is subtracted from the cost before the cost multiplies the score, in moments. `linearise_along`
    (n, (horizon + 1) * nx) are the states at which the steps start; None means the states of the rollout itself;
    `terminal_gradient` (n, nx) is added to the derivative of the cost with respect to the last state.
    """

    n: int
    horizon: int
    parts: int
    x0: Array
    theta: Array
    p: Array
    w: Array | None = None
    gaussian: Gaussian | None = None
    linearise_along: Array | None = None
    terminal_gradient: Array | None = None
    precision: Array | None = None
    gradient: bool = True
    score: bool = False
    baseline: float = 0.0

    @property
    def n_values(self) -> int:
        """Number of entries of a sample's vector in moments: cost, gradient, and score times cost."""
        return 1 + self.theta.shape[1] * (self.gradient + self.score)

    def slice_samples(self, begin: int, end: int) -> RolloutRequest:
        """Return the same request for the samples `begin <= i < end` alone."""
        names = ("x0", "theta", "p", "w", "linearise_along", "terminal_gradient")
        batched = {name: getattr(self, name) for name in names}
        rows = {k: a[begin:end] for k, a in batched.items() if a is not None and len(a) > 1}
        gaussian = None if self.gaussian is None else self.gaussian.skip_samples(begin)
        return replace(self, n=end - begin, gaussian=gaussian, **rows)


@dataclass(frozen=True)
class RolloutArrays:
    """Arrays that an engine fills with the results of n samples; arrays that were not requested are None.

    `cost` (n, 1), `gradient` and `score` (n, parts * n_theta), `last` (n, nx), the last state, and
    `trail` (n, (horizon + 1) * nx), all states, each with the entries that the objective adds.
    """

    cost: Array
    gradient: Array | None = None
    score: Array | None = None
    last: Array | None = None
    trail: Array | None = None

    @classmethod
    def allocate(cls, q: RolloutRequest, **outputs: Array | None) -> Self:
        """Return new arrays for the cost, and for gradient and score if `q` requests them."""
        size = q.theta.shape[1]
        gradient, score = (np.empty((q.n, size)) if on else None for on in (q.gradient, q.score))
        return cls(np.empty((q.n, 1)), gradient, score, **outputs)

    def non_finite(self) -> NonFinite:
        """Return the samples with a cost, gradient or score that is NaN or infinite."""
        return non_finite_rows([a for a in (self.cost, self.gradient, self.score) if a is not None])


class Job(ctypes.Structure):
    """The C structure `job` of `dynamics.batch.engines.c_rollout`; every field has eight bytes."""

    _fields_ = [
        *(
            (name, ctypes.c_int64)
            for name in (
                *("horizon", "parts", "want", "shared_x0", "shared_theta", "shared_p"),
                *("noise", "key0", "key1", "first"),
            )
        ),
        *(
            (name, ctypes.c_void_p)
            for name in (
                *("x0", "theta", "p", "w", "linearise_along", "terminal_gradient", "sigma", "precision"),
                *("cost", "gradient", "score", "last", "trail", "moments"),
            )
        ),
        ("baseline", ctypes.c_double),
        ("lams", ctypes.c_void_p),
    ]


# Number of samples in the widest SIMD register.
_WIDEST_REGISTER = 8
# Number of chunks of samples for each thread, if there are many samples.
_SHARES_PER_THREAD = 4
# Minimum number of samples in a chunk if every thread gets only one chunk.
_MIN_SHARED_SAMPLES = 32


class CompiledRolloutEngine:
    """Engine of rollouts with a compiled C function `run(next, n, chunk, job)`.

    There is one version for parameters p that all samples share, and another, compiled at its first use, for
    parameters that differ between samples. If the policy has layers, there are also two such versions for theta.
    Raises `CompilerError` if the rollout cannot be compiled.
    """

    chunk = 1024

    def __init__(self, tapes: RolloutTapes, threads: int, block: int) -> None:
        self._tapes, self._threads, self._block = tapes, threads, block
        self._runs = {(False, False): self._compile(False, False)}

    def _compile(self, per_sample_p: bool, per_sample_theta: bool) -> Any:
        machine = compiler.find_compiler()
        text = c_rollout.rollout_source(self._tapes, self._block, machine, per_sample_p, per_sample_theta)
        # Costs alone are often needed for few samples, so that compilation takes longer than the rollouts; at level 1
        # it takes two thirds of the time, and the code is as fast up to a few per cent.
        run = compiler.load_library(text, ["run"], 1 if self._tapes.adjoint is None else 2).run
        run.restype = ctypes.c_int64
        run.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p]
        return run

    @property
    def address(self) -> int | None:
        """Address of the C function for parameters and weights that all samples share."""
        return ctypes.cast(self._runs[False, False], ctypes.c_void_p).value

    @property
    def nlam(self) -> int:
        """Number of multipliers of a step."""
        return self._tapes.nlam

    def samples(self, q: RolloutRequest, results: RolloutArrays) -> int:
        """Fill the arrays `results`; return the number of samples that are not finite."""
        want = (results.gradient is not None) + 2 * (results.score is not None)
        return self._all(q, want, **vars(results))

    def moments(self, q: RolloutRequest, table: Array) -> int:
        """Fill a row `(count, means, sums of squared deviations)` of `table` for each chunk of samples.

        Returns the number of samples that are not finite.
        """
        return self._all(q, q.gradient + 2 * q.score + 4, moments=table)

    def _all(self, q: RolloutRequest, want: int, **results: Array | None) -> int:
        job, _kept_alive = self._job(q, want, results)
        per_sample = len(q.p) > 1, self._tapes.layers is not None and len(q.theta) > 1
        if per_sample not in self._runs:
            self._runs[per_sample] = self._compile(*per_sample)
        chunk = self.chunk if want & 4 else self._share(q.n)
        return run_chunks(self._runs[per_sample], q.n, chunk, self._threads, ctypes.addressof(job))

    def _share(self, n: int) -> int:
        """Return the number of samples in a chunk, such that each thread gets a few chunks; at least one."""
        if self._threads == 1:
            return self.chunk
        one_share, several_shares = (
            _WIDEST_REGISTER * -(-n // (_WIDEST_REGISTER * k * self._threads)) for k in (1, _SHARES_PER_THREAD)
        )
        return min(self.chunk, max(several_shares, min(one_share, _MIN_SHARED_SAMPLES)))

    def _job(self, q: RolloutRequest, want: int, results: dict[str, Array | None]) -> tuple[Job, object]:
        """Return the C structure, and the arrays that it points to; keep them as long as the structure is used."""
        nu = self._tapes.nu
        noise, seed_key, sigma = 0, (0, 0), np.ones(nu)
        if q.w is not None:
            noise = 1
        elif q.gaussian is not None:
            noise, seed_key, sigma = 2, key_of(q.gaussian.seed), q.gaussian.component_scales(nu)
        arrays = {
            **{"x0": q.x0, "theta": q.theta, "p": q.p, "w": q.w, "linearise_along": q.linearise_along},
            **{"terminal_gradient": q.terminal_gradient, "sigma": sigma, "precision": q.precision, **results},
        }
        job = Job(
            horizon=q.horizon,
            parts=q.parts,
            want=want,
            shared_x0=len(q.x0) == 1,
            shared_theta=len(q.theta) == 1,
            shared_p=len(q.p) == 1,
            noise=noise,
            key0=seed_key[0],
            key1=seed_key[1],
            first=0 if q.gaussian is None else q.gaussian.first,
            baseline=q.baseline,
            **{name: data_address(a) for name, a in arrays.items() if a is not None},
        )
        return job, arrays


# Number of operations of the adjoint graph below which chunks are larger.
_SHORT_GRAPH = 300
# Number of samples in a chunk of rollouts of short graphs.
_SHORT_GRAPH_CHUNK = 16384


class ChunkEngine:
    """Engine of rollouts whose loops run in Python, over chunks of samples.

    Chunks are large enough that an operation takes longer than its call from Python, so that threads run
    in parallel, and small enough that the arrays of a long graph stay in the cache.
    """

    def __init__(self, tapes: RolloutTapes, threads: int, make: Callable[[ca.Function], Kernel]) -> None:
        self._tapes, self._threads = tapes, threads
        is_short = tapes.adjoint is not None and tapes.adjoint.step.n_instructions() < _SHORT_GRAPH
        self.chunk = _SHORT_GRAPH_CHUNK if is_short else PYTHON_CHUNK
        self._rollout = ChunkRollout(tapes, make)

    def samples(self, q: RolloutRequest, results: RolloutArrays) -> int:
        """Fill the arrays `results`; see :meth:`CompiledRolloutEngine.samples`."""
        bad_counts: list[int] = []
        targets = results.gradient, results.score, results.last, results.trail

        def work(begin: int, end: int) -> None:
            cost, gradient, score, trail = self._chunk(q.slice_samples(begin, end))
            results.cost[begin:end, 0] = cost
            chunk_results = gradient, score, trail[-1], trail.reshape(-1, trail.shape[-1])
            for target, value in zip(targets, chunk_results, strict=True):
                if target is not None:
                    copy_transposed(value.T, target[begin:end])
            # A sum is finite only if all its terms are.
            total = cost + gradient.sum(axis=0) + score.sum(axis=0)
            bad_counts.append(end - begin - int(np.count_nonzero(np.isfinite(total))))

        over_chunks(q.n, self.chunk, self._threads, work)
        return sum(bad_counts)

    def moments(self, q: RolloutRequest, table: Array) -> int:
        """Fill the table of moments; see :meth:`CompiledRolloutEngine.moments`."""
        bad_counts: list[int] = []

        def work(begin: int, end: int) -> None:
            cost, gradient, score, _ = self._chunk(q.slice_samples(begin, end))
            values = np.vstack((cost[None], gradient, score * (cost - q.baseline)))
            values = values[:, np.isfinite(values).all(axis=0)]
            n = values.shape[1]
            mean = values.sum(axis=1) / max(n, 1)
            m2 = np.square(values - mean[:, None]).sum(axis=1)
            table[begin // self.chunk] = (n, *mean, *m2)
            bad_counts.append(end - begin - n)

        over_chunks(q.n, self.chunk, self._threads, work)
        return sum(bad_counts)

    def _chunk(self, q: RolloutRequest) -> tuple[Array, Array, Array, Array]:
        """Return cost (m,), gradient and score (parts * n_theta or 0, m) and states (N + 1, nx, m) of one chunk.

        The next call overwrites these arrays.
        """
        tapes, m = self._tapes, q.n
        scratch, rollout = self._rollout.scratch, self._rollout
        batched = {"x0": q.x0, "theta": q.theta, "p": q.p, "w": self._noise(q)}
        x0, theta, p, w = (scratch.columns(name, a) for name, a in batched.items())
        theta = theta.reshape(q.parts, -1, theta.shape[-1])
        w = w.reshape(q.horizon, tapes.nu, -1)
        linearise_along = None
        if q.linearise_along is not None:
            linearise_along = scratch.columns("linearise_along", q.linearise_along).reshape(-1, tapes.nx, m)
        x, lam, cost = rollout.forward(x0, theta, p, w, m, q.gradient, linearise_along)
        shape = (q.parts, theta.shape[1], m)
        gradient, score = np.empty((0, m)), np.empty((0, m))
        if q.gradient:
            gradient = scratch.array("gradient", *shape)
            terminal_gradient = None if q.terminal_gradient is None else q.terminal_gradient.T
            rollout.backward(x, lam, theta, p, w, gradient, terminal_gradient)
        if q.score and q.precision is not None:
            score = scratch.array("score", *shape)
            rollout.scores(x, theta, p, w * q.precision[..., None], score)
        return cost, gradient.reshape(-1, m), score.reshape(-1, m), x

    def _noise(self, q: RolloutRequest) -> Array:
        if q.w is not None:
            return q.w
        if q.gaussian is not None:
            return q.gaussian.draw(q.n, q.horizon, self._tapes.nu).reshape(q.n, -1)
        return np.zeros((1, q.horizon * self._tapes.nu))


def find_bad_samples(engine: Any, q: RolloutRequest, counts: Array) -> Array:
    """Return the indices of samples that are not finite: repeat the rollout for chunks whose count is too small."""
    bad_indices = []
    for i, count in enumerate(counts):
        begin, end = i * engine.chunk, min((i + 1) * engine.chunk, q.n)
        if count < end - begin:
            chunk_call = q.slice_samples(begin, end)
            results = RolloutArrays.allocate(chunk_call)
            engine.samples(chunk_call, results)
            bad_indices.append(begin + results.non_finite().indices)
    return np.concatenate(bad_indices)
