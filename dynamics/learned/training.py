"""Training of networks on clean and on noised data."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.learned.mlp import MlpModel
from dynamics.learned.network import Network, Progress, arrays_of
from dynamics.learned.samples import Samples, split_rows


@dataclass(frozen=True)
class Recipe:
    """How a network is trained. Defaults: the same authors' for 1e5 transitions of pushing.

    ``hidden`` units a layer; ``rate`` of Adam; ``batch`` samples a step, or all where there are
    fewer; at most ``epochs`` passes; the fraction ``held_out`` of the rows is never trained on, and
    after ``patience`` epochs in which its error did not fall, training ends. With held_out = 0 all
    rows are trained on, all epochs run, and the last weights are kept instead of the best.
    """

    hidden: tuple[int, ...] = (128, 128, 128, 128)
    epochs: int = 200
    batch: int = 2048
    rate: float = 1e-3
    held_out: float = 0.1
    patience: int = 30

    def __post_init__(self) -> None:
        whole = {"epochs": self.epochs, "batch": self.batch, "patience": self.patience}
        whole |= {f"hidden layer {i}": size for i, size in enumerate(self.hidden, 1)}
        for name, value in whole.items():
            if value != int(value) or value < 1:
                raise ValueError(f"mlp: {name} must be a whole number of at least 1, got {value}")
        if not self.hidden:
            raise ValueError("mlp: hidden has no layers; give at least one, such as 128")
        if not (self.rate > 0 and math.isfinite(self.rate)):
            raise ValueError(f"mlp: rate must be positive and finite, got {self.rate}")
        if not 0 <= self.held_out < 1:
            raise ValueError(f"mlp: held_out must be at least 0 and below 1, got {self.held_out}")


@dataclass(frozen=True)
class Epoch:
    """After a pass over the data: mean squared errors a coordinate, in units of y's scales.

    ``train`` is the mean over the pass, on inputs noised as trained; ``clean`` and ``noised`` are
    those of held-out rows (NaN where none are held out), ``best`` the least ``noised`` so far.
    """

    number: int
    train: float
    clean: float
    noised: float
    best: float


class Training:
    """Minimise ``E |h(z + sigma w) - y|²``, w ~ N(0, I) fresh in every minibatch, by Adam [eq. 3].

    z and y are normalised; only z is noised, never y. The network predicts the next state as in the
    paper, which makes the minimiser g_sigma itself. An increment, added to the noised state x~, is
    another law: ``x~ + E[y - x | x~]`` keeps the noise and does not pull back to the data.

    Training is in float32; the same seed, data and recipe give the same bits on one computer with
    the same number of processors (how many there are decides in which order sums are taken) and
    settings of JAX.
    ``state``, given back, continues to the bits of an uninterrupted run; it is that of the last
    whole epoch, whatever interrupts one.

    Raises ``ValueError`` for a sigma that is negative, too few rows, a constant column, a state of
    other training, and where the extra ``learn`` is not installed.
    """

    def __init__(self, data: Samples, sigma: float, recipe: Recipe | None = None, seed: int = 0,
                 state: dict[str, np.ndarray] | None = None) -> None:  # fmt: skip
        if not (sigma >= 0 and math.isfinite(sigma)):
            raise ValueError(f"mlp: sigma must be at least 0 and finite, got {sigma}")
        self.data, self.sigma, self.seed = data, float(sigma), seed
        self.recipe = recipe or Recipe()
        self.trained_on, self.held_out = split_rows(len(data.z), self.recipe.held_out, seed)
        if len(self.trained_on) < 2 or (self.recipe.held_out and not len(self.held_out)):
            raise ValueError(
                f"data: {len(data.z)} rows are too few to train on with"
                f" {100 * self.recipe.held_out:g} % of them held out; collect more"
            )
        self._scales = data.scales
        self._network = Network(data.z.shape[1], data.y.shape[1], self.recipe, self.sigma, seed)
        self._now = self._started(state)

    @property
    def epoch(self) -> int:
        """Passes over the data so far."""
        return self._now.number

    @property
    def done(self) -> bool:
        """Whether all epochs are over or the held-out error has stopped to fall."""
        now, recipe = self._now, self.recipe
        stale = len(self.held_out) > 0 and now.number - now.best_at >= recipe.patience
        return now.number >= recipe.epochs or stale

    def epochs(self) -> Iterator[Epoch]:
        """The remaining epochs one by one; the next one is computed on request.

        Raises ``ValueError`` when the weights are no longer finite.
        """
        z, y = (
            scales.normalised(rows).astype(np.float32)
            for scales, rows in zip(self._scales, (self.data.z, self.data.y), strict=True)
        )
        network = self._network
        samples = network.on_device(z[self.trained_on], y[self.trained_on])
        held = network.on_device(z[self.held_out], y[self.held_out])
        while not self.done:
            now, train = network.epoch(self._now, *samples)
            clean = noised = math.nan
            if len(self.held_out):
                clean, noised = network.errors(now.layers, *held)
            if not math.isfinite(train):
                raise ValueError(
                    f"mlp: training diverged in epoch {now.number}; lower rate (now"
                    f" {self.recipe.rate:g})"
                )
            if not len(self.held_out) or noised < now.least:
                now = replace(now, best=now.layers, best_at=now.number, least=noised)
            self._now = now
            yield Epoch(now.number, train, clean, noised, now.least)

    @property
    def state(self) -> dict[str, np.ndarray]:
        """All that continues the training, arrays only: weights now and best, Adam's, the epoch."""
        identity = np.frombuffer(self._identity(), dtype=np.uint8)
        return {"identity": identity, **self._network.arrays(self._now)}

    def _started(self, state: dict[str, np.ndarray] | None) -> Progress:
        if state is None:
            return self._network.start
        if "identity" not in state or bytes(state["identity"]) != self._identity():
            raise ValueError(
                "mlp: the checkpoint has other data, recipe, sigma or seed; start again"
            )
        return self._network.progress(state)

    def _identity(self) -> bytes:
        """What the bits depend on: more epochs or patience continue the same run."""
        recipe = self.recipe
        told = recipe.hidden, recipe.batch, recipe.rate, recipe.held_out, self.sigma, self.seed
        told = (*told, self.data.hash)
        return hashlib.sha256(repr(told).encode()).digest()

    def model(self) -> MlpModel:
        """The network with the best weights so far, or with the last where nothing is held out."""
        weights, biases = arrays_of(self._now.best)
        known = self.data.origin
        origin = replace(known, data_hash=known.data_hash or self.data.hash)
        return MlpModel(weights, biases, *self._scales, self.sigma, origin, self.seed)


def train(data: Samples, sigma: float, seed: int = 0, **recipe: Any) -> MlpModel:
    """Train to the end (:class:`Training`, :class:`Recipe`): h_sigma, or h for sigma = 0."""
    training = Training(data, sigma, Recipe(**recipe), seed)
    for _ in training.epochs():
        pass
    return training.model()
