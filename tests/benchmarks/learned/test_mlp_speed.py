"""Speed of training networks, and of evaluating them with their derivatives."""

from __future__ import annotations

import time
from itertools import islice

import numpy as np
import pytest

from dynamics.learned.mlp import MlpModel
from dynamics.learned.training import Recipe, Training
from dynamics.learned.transitions import DataOrigin, Samples
from dynamics.systems.parameters import Signal
from tests.benchmarks.batch.race import Row, race, tell

pytestmark = pytest.mark.bench
# Sizes of planar-hand, the larger of the two systems in Suh et al. 2023.
NX, NU = 7, 4
STATES = tuple(Signal(f"q{i}", "rad") for i in range(NX))
INPUTS = tuple(Signal(f"u{i}", "rad") for i in range(NU))


def samples(n: int) -> Samples:
    """Return transitions whose next states have kinks."""
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (n, NX + NU))
    y = z[:, :NX] + np.maximum(z[:, NU:] - z[:, :NX], 0.0)
    return Samples(z, y, DataOrigin((*STATES, *INPUTS), STATES))


def test_training_the_default_network_on_1e5_transitions() -> None:
    """Ten epochs are timed after the first, which compiles, and 200 are scaled from them."""
    begin = time.perf_counter()
    training = Training(samples(100_000), 0.2)
    epochs = training.epochs()
    next(epochs)
    ready = time.perf_counter()
    told = list(islice(epochs, 10))
    seconds = time.perf_counter() - ready
    assert told[-1].noised < told[0].noised
    whole = ready - begin + 199 / 10 * seconds
    rows = [
        Row("first epoch, with start and compilation", ready - begin, " s"),
        Row("ten more epochs", seconds, " s"),
        Row("200 epochs, scaled from these", whole, " s", most=180.0),
    ]
    tell("Training 4 x 128 on 1e5 transitions of 11 numbers to 7, noised", rows)


def a_network() -> MlpModel:
    """Return a network of default size, hardly trained, which does not affect its speed."""
    training = Training(samples(1000), 0.2, Recipe(epochs=1))
    list(training.epochs())
    return training.model()


def test_evaluating_twenty_stages() -> None:
    model, rng = a_network(), np.random.default_rng(0)
    z, weights = rng.normal(size=(20, NX + NU)), rng.normal(size=(20, NX))
    runners = {
        "values": lambda: model.values(z),
        "values and Jacobians": lambda: model.jacobians(z),
        "curvatures": lambda: model.curvatures(z, weights),
    }
    rows = [Row(what, 1e3 * seconds.wall, " ms", most=5.0) for what, seconds in race(runners, rounds=51).items()]
    tell("A 4 x 128 network at 20 stages", rows)
