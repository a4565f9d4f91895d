"""Zeroth-order policy gradient: likelihood ratio with a baseline, in antithetic pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from dynamics.batch import Episodes
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Row, State
from ocp.learning.unrolls.unrolling import Clipping, finite_samples, roll


@dataclass(frozen=True, kw_only=True)
class ZOPG(Clipping):
    """``g = mean of (V - b) sum_t D_theta a_t' w_t / sigma²``, the likelihood ratio's gradient.

    Every start is unrolled under noise w and -w, ``samples`` unrolls in all; b is the mean return
    of the others but the pair. The estimate is unbiased, unless ``clip`` cuts it.
    """

    name: ClassVar[str] = "zopg"
    summary: ClassVar[str] = "likelihood-ratio policy gradient, antithetic, with a baseline"
    contact: ClassVar[str] = "exact"

    samples: Annotated[int, "unrolls an iteration, in pairs of noise w and -w"] = 256
    least: ClassVar[int] = 4

    def check(self, experiment: Experiment) -> None:
        """As all, and that samples come in pairs."""
        super().check(experiment)
        if self.samples % 2:
            raise InputError(f"samples come in pairs of w and -w: {self.samples} is odd")

    def starts(self) -> int:
        """One for each pair."""
        return self.samples // 2

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """One step along the mean of the pairs."""
        steps = self.steps(experiment)
        noise = experiment.noise(self.sigma, k, "actions")
        pair = [
            roll(experiment, state, state["starts.x"], steps, noise=each, score=True)
            for each in (noise, noise.mirrored())
        ]
        good = np.logical_and(*(finite_samples(experiment, state, each, k) for each in pair))
        gradients = self.clipped(likelihood_ratio(pair, good))
        return self.stepped(experiment, state, gradients, pair[0], good, k)


def likelihood_ratio(batches: Sequence[Episodes], good: np.ndarray) -> np.ndarray:
    """``mean over batches of (V - b) score``, (n, n_theta), of the samples that are ``good``.

    The baseline b of a sample is the mean return, over the batches, of all others.

    Raises :class:`~ocp.errors.InputError` where fewer than two are left for that.
    """
    values = np.stack([each.value[good] for each in batches])
    if values.shape[1] < 2:
        raise InputError(
            "a likelihood ratio with a baseline needs two samples that stay finite, there are"
            f" {values.shape[1]}; take more samples or less noise"
        )
    means = values.mean(axis=0)
    baseline = (means.sum() - means) / (len(means) - 1)
    scores = np.stack([np.asarray(each.score)[good] for each in batches])
    return ((values - baseline)[..., None] * scores).mean(axis=0)
