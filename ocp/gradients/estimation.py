"""Estimation of a gradient by several estimators, with confidence intervals, a reference and verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynamics.batch import Gaussian, Moments
from dynamics.settings import Configured, setting
from ocp.errors import InputError, choose
from ocp.gradients.estimators import RULES, SAMPLED, Choice, Evidence, Rule
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import (
    NOT_SAVED,
    REFERENCE_KINDS,
    CheckpointKey,
    ChunkSource,
    EstimatorRun,
    Progress,
    ReferenceGradient,
    child_seed,
    reference_gradient,
    reference_kind,
    run_estimator,
)
from ocp.gradients.verdict import (
    EmpiricalBias,
    Jump,
    Verdict,
    empirical_bias,
    find_sharpest_change,
    judge_estimate,
)

JUMP_STREAM = 4
"""Index of the random stream that :func:`find_sharpest_change` uses."""
ALPHA_ORDERS = ("zobg-mean", "fobg")
"""Names of the two estimators between which alpha estimators interpolate; their noise is independent."""
REFERENCE_FACTOR = 10
"""Default number of samples for the reference, as a multiple of the number for an estimator."""


@dataclass(frozen=True)
class Estimate:
    """Estimate of an objective's gradient (d,) by one estimator, with its verdict.

    ``moments`` (d,) are mean and variance of single samples, and ``evaluations`` is the number of rollouts.
    ``reference`` is the reference with which the estimate was compared, or None. ``choice`` is the weight of an
    interpolated estimate, ``bias`` the empirical bias of a sampled estimate, and ``nonfinite`` are the indices
    of the samples that were left out.
    """

    estimator: str
    moments: Moments
    evaluations: int
    reference: ReferenceGradient | None
    verdict: Verdict
    bias: EmpiricalBias | None = None
    choice: Choice | None = None
    nonfinite: np.ndarray | None = None

    @property
    def mean(self) -> np.ndarray:
        """Estimated gradient (d,), the mean of the samples."""
        return self.moments.mean

    @property
    def variance(self) -> np.ndarray:
        """Variance (d,) of single samples."""
        return self.moments.variance

    @property
    def standard_error(self) -> np.ndarray:
        """Standard deviation (d,) of the estimated gradient."""
        return self.moments.standard_error

    def interval(self, confidence: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper ends (d,) of the components' normal confidence intervals."""
        from scipy.stats import norm

        half_width = float(norm.ppf(0.5 + confidence / 2)) * self.standard_error
        return self.mean - half_width, self.mean + half_width

    def row(self) -> dict[str, Any]:
        """Return the estimate as a JSON object; a vector is a number if it has one component, else a list."""
        reference, variance = self.reference, self.variance
        return {
            "estimator": self.estimator,
            "mean": number_or_list(self.mean),
            "variance": number_or_list(variance),
            "standard_error": number_or_list(self.standard_error),
            "n_samples": self.moments.n,
            "evaluations": self.evaluations,
            "variance_trace": float(variance.sum()),
            "variance_max": float(variance.max()),
            "variance_mean": float(variance.mean()),
            "interval_95": [number_or_list(end) for end in self.interval()],
            "reference": None if reference is None else number_or_list(reference.gradient),
            "reference_error": None if reference is None else number_or_list(reference.standard_error),
            "reference_source": None if reference is None else reference.source,
            "error": self.verdict.error,
            "verdict": self.verdict.word,
            "wide": self.verdict.wide,
            "explanation": self.verdict.sentence,
            "alpha_reason": getattr(self.choice, "reason", None),
            **{key: getattr(self.choice, key, None) for key in ("alpha", "epsilon", "gamma")},
            "empirical_bias": None if self.bias is None else vars(self.bias),
            "nonfinite": 0 if self.nonfinite is None else len(self.nonfinite),
            "nonfinite_first": [] if self.nonfinite is None else self.nonfinite[:5].tolist(),
        }


def number_or_list(values: np.ndarray) -> float | list[float]:
    """Return an array as a float if it has one element, else as a list of floats."""
    flat = np.asarray(values, dtype=float).ravel()
    return float(flat[0]) if flat.size == 1 else flat.tolist()


MIN_SIGMA = 1e-150
"""Minimum sigma, and reciprocal of the maximum sigma, for which sigma squared neither underflows nor overflows."""


@dataclass(frozen=True)
class Sampling(Configured):
    """Settings of an estimation: names of estimators, number of samples of each, noise and seed.

    ``rules`` replace the default rules by which alpha estimators choose their weights.

    Raises :class:`~ocp.errors.InputError` for an unknown or repeated estimator and for a setting out of range.
    """

    estimators: Sequence[str] = ("zobg", "fobg", "alpha")
    samples: int = setting(100_000, "samples of each estimator", hint="one sample has no variance", least=2)
    sigma: float = setting(
        0.1,
        "standard deviation of the noise",
        hint="its square must neither underflow nor overflow",
        least=MIN_SIGMA,
        most=1 / MIN_SIGMA,
    )
    seed: int = setting(0, "seed of the noise", least=0)
    rules: Sequence[Rule] = ()
    reference: str = setting("auto", "source of the true gradient", words=REFERENCE_KINDS)
    reference_samples: int | None = setting(
        None,
        "samples of a sampled reference; by default ten times those of an estimator",
        hint="one sample has no variance",
        least=2,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        available = {**SAMPLED, **RULES}
        if not self.estimators:
            raise InputError(f"name at least one estimator; there are {', '.join(available)}")
        for name in self.estimators:
            choose("estimator", name, available)
        if len(set(self.estimators)) < len(self.estimators):
            raise InputError("an estimator is named twice; name each once")

    @property
    def sampled(self) -> list[str]:
        """Names of the estimators to sample, including the two between which alpha estimators interpolate."""
        alphas = [name for name in self.estimators if name in RULES]
        names = [name for name in self.estimators if name in SAMPLED]
        return list(dict.fromkeys([*names, *(ALPHA_ORDERS if alphas else ())]))

    @property
    def n_reference_samples(self) -> int:
        """Number of samples for the reference, if it is sampled."""
        return self.reference_samples or REFERENCE_FACTOR * self.samples

    def rule(self, name: str) -> Rule:
        """Return the weighting rule of the alpha estimator ``name``."""
        return next((rule for rule in self.rules if rule.name == name), RULES[name]())


def estimate_gradient(
    objective: SampledObjective,
    estimators: Sequence[str] = ("zobg", "fobg", "alpha"),
    samples: int = 100_000,
    sigma: float = 0.1,
    seed: int | np.random.SeedSequence = 0,
    progress: Progress | None = None,
    **settings: Any,
) -> dict[str, Estimate]:
    """Estimate ``grad F(theta)``, where F is the mean of V(theta, w) over ``w ~ N(0, sigma^2 I)``.

    Return a mapping from names to :class:`Estimate`. Names are ``zobg``, ``zobg-zero-noise``, ``zobg-mean``,
    ``zobg-antithetic``, ``fobg``, ``es``, ``alpha``, ``alpha-variance`` and ``alpha-fixed``. With the same
    seed, sample i is the same for any number of samples. ``settings`` are those of :class:`Sampling`.

    Raises :class:`~ocp.errors.InputError` for settings that :class:`Sampling` rejects, and if too
    few samples were finite.
    """
    sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    sampling = Sampling(tuple(estimators), samples, sigma, **settings)
    return run_sampling(sampling, objective, sequence, progress)


def run_sampling(
    sampling: Sampling,
    objective: SampledObjective,
    seed: np.random.SeedSequence,
    progress: Progress | None = None,
    checkpoint: CheckpointKey = NOT_SAVED,
    workers: ChunkSource | None = None,
) -> dict[str, Estimate]:
    """Estimate the gradient of one objective with the settings ``sampling``; random streams derive from ``seed``.

    ``checkpoint`` is the storage of unfinished sums and the prefix of their keys. ``workers``, if given,
    computes the chunks in other processes.
    """

    def checkpoint_key(name: str) -> CheckpointKey:
        return checkpoint[0], f"{checkpoint[1]}-{name}"

    reference_kind(objective, sampling.sigma, sampling.reference)
    runs: dict[str, EstimatorRun] = {}
    for name in sampling.sampled:
        estimator = SAMPLED[name]
        noise = Gaussian(sampling.sigma, child_seed(seed, estimator.stream))
        runs[name] = run_estimator(
            objective, estimator, noise, sampling.samples, progress, checkpoint_key(name), workers
        )
        _check_finite(objective, name, runs[name])
    reference = reference_gradient(
        objective,
        sampling.sigma,
        seed,
        sampling.n_reference_samples,
        sampling.reference,
        progress,
        checkpoint_key("reference"),
        workers,
    )
    judge = _Judge(objective, sampling, seed, reference)
    estimates = {}
    for name in sampling.estimators:
        if name in SAMPLED:
            estimates[name] = judge.sampled(name, runs[name])
        else:
            estimates[name] = judge.interpolated(name, *(runs[order] for order in ALPHA_ORDERS))
    return estimates


class _Judge:
    """Builder that turns the runs of estimators into estimates with verdicts."""

    def __init__(
        self,
        objective: SampledObjective,
        sampling: Sampling,
        seed: np.random.SeedSequence,
        reference: ReferenceGradient | None,
    ) -> None:
        self._objective, self._sampling, self._seed, self._reference = objective, sampling, seed, reference

    def sampled(self, name: str, run: EstimatorRun) -> Estimate:
        pathwise = name == "fobg"
        mean = None if self._reference is None or not pathwise else self._reference.gradient
        bias = empirical_bias(run.first_samples, mean)
        # Evolution strategies put noise on theta, so the reference applies only if the objective does so too.
        noise_on_decision = len(self._objective.theta) == self._objective.n_noise
        reference = self._reference if name != "es" or noise_on_decision else None
        verdict = self._verdict(reference, run.moments, bias if pathwise else None)
        cost = SAMPLED[name].evaluations * self._sampling.samples
        return Estimate(name, run.moments, cost, reference, verdict, bias, None, run.nonfinite)

    def interpolated(self, name: str, zeroth: EstimatorRun, first: EstimatorRun) -> Estimate:
        choice = self._sampling.rule(name).choose_weight(_evidence(zeroth, first))
        moments = interpolate(choice.alpha, zeroth.moments, first.moments)
        cost = sum(SAMPLED[order].evaluations for order in ALPHA_ORDERS) * self._sampling.samples
        nonfinite = np.union1d(zeroth.nonfinite, first.nonfinite)
        verdict = self._verdict(self._reference, moments, None)
        return Estimate(name, moments, cost, self._reference, verdict, None, choice, nonfinite)

    def _verdict(self, reference: ReferenceGradient | None, moments: Moments, bias: EmpiricalBias | None) -> Verdict:
        verdict = judge_estimate(moments, reference)
        return judge_estimate(moments, reference, self._jump, bias) if verdict.word == "biased" else verdict

    @cached_property
    def _jump(self) -> Jump:
        noise = Gaussian(self._sampling.sigma, child_seed(self._seed, JUMP_STREAM))
        return find_sharpest_change(self._objective, noise)


def _evidence(zeroth: EstimatorRun, first: EstimatorRun) -> Evidence:
    size = float(np.linalg.norm(zeroth.moments.mean))
    return Evidence(
        n=zeroth.moments.n,
        d=len(zeroth.moments.mean),
        first_variance=float(first.moments.variance.sum()),
        zeroth_variance=float(zeroth.moments.variance.sum()),
        distance=float(np.linalg.norm(first.moments.mean - zeroth.moments.mean)),
        gradient_size=size,
        deviation=zeroth.largest + size,
    )


def interpolate(alpha: float, zeroth: Moments, first: Moments) -> Moments:
    """Return the moments of ``alpha first + (1 - alpha) zeroth`` for independent samples of both.

    alpha is treated as a constant. If it was chosen from the same samples, the result is slightly biased.
    """
    n = min(zeroth.n, first.n)
    mean = alpha * first.mean + (1 - alpha) * zeroth.mean
    variance = alpha**2 * first.variance + (1 - alpha) ** 2 * zeroth.variance
    return Moments(n, mean, variance * (n - 1))


def _check_finite(objective: SampledObjective, name: str, run: EstimatorRun) -> None:
    if run.moments.n < 2:
        nonfinite = run.nonfinite
        raise InputError(
            f"{objective.name}: {len(nonfinite)} samples of {name} are not finite (the first at index"
            f" {nonfinite[0]}) and {run.moments.n} are left; a smaller sigma or a shorter horizon may"
            " keep them finite"
        )
    if not np.isfinite([run.moments.mean, run.moments.variance]).all():
        raise InputError(f"{objective.name}: mean or variance of {name} overflows double precision; take another sigma")
