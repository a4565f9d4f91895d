"""Training of networks: seeds, interruptions, noise, held-out rows, and errors."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from dynamics.learned.mlp import MlpModel
from dynamics.learned.training import Network, Recipe, Training, train_network
from dynamics.learned.transitions import Samples, Transitions, split_rows
from tests.unit.dynamics.learned.test_mlp import LINE, PUSH, a_model, pushed, same_weights

TINY = Recipe(hidden=(8, 8), epochs=6, batch=64)


def run(training: Training, epochs: int | None = None) -> MlpModel:
    list(islice(training.epochs(), epochs))
    return training.model()


@pytest.mark.costly
def test_a_seed_fixes_every_bit() -> None:
    data = pushed(500)
    one, again = (run(Training(data, 0.2, TINY, seed=3)) for _ in range(2))
    other = run(Training(data, 0.2, TINY, seed=4))
    assert same_weights(one, again) and not same_weights(one, other)
    assert one.origin.data_hash == "0123" and (one.sigma, one.seed) == (0.2, 3)


@pytest.mark.costly
def test_what_is_resumed_ends_in_the_same_bits(tmp_path: Path) -> None:
    data = pushed(500)
    whole = Training(data, 0.2, TINY)
    told = list(whole.epochs())
    part = Training(data, 0.2, TINY)
    list(islice(part.epochs(), 2))
    np.savez(tmp_path / "state.npz", **part.state)
    with np.load(tmp_path / "state.npz", allow_pickle=False) as file:
        resumed = Training(data, 0.2, TINY, state=dict(file))
    assert resumed.epoch == 2
    assert list(resumed.epochs()) == told[2:]
    assert same_weights(whole.model(), resumed.model()) and resumed.done
    longer = Training(data, 0.2, replace(TINY, epochs=7), state=whole.state)
    assert [epoch.number for epoch in longer.epochs()] == [7]
    with pytest.raises(ValueError, match="checkpoint has other data, recipe"):
        Training(data, 0.3, TINY, state=part.state)
    with pytest.raises(ValueError, match="checkpoint has other data, recipe"):
        Training(pushed(500, seed=1), 0.2, TINY, state=part.state)


@pytest.mark.costly
def test_an_interrupted_epoch_is_done_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes after an epoch has computed its weights and before it ends."""
    data = pushed(500)
    whole, part = Training(data, 0.2, TINY), Training(data, 0.2, TINY)
    told = list(whole.epochs())
    list(islice(part.epochs(), 2))

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Network, "errors", interrupted)
        with pytest.raises(KeyboardInterrupt):
            next(part.epochs())
    resumed = Training(data, 0.2, TINY, state=part.state)
    assert list(resumed.epochs()) == told[2:] and same_weights(whole.model(), resumed.model())


@pytest.mark.costly
def test_noise_is_on_the_inputs_alone() -> None:
    """For x ~ N(0, s²) and y = x the best map of noised inputs is s² x / (s² + sigma²), eq. 7.

    Normalised data have s = 1. If y had the same noise, the slope would be 1; with other noise on y
    the slope would be the same and the error larger by sigma². 8000 samples in 40 epochs of noise
    leave an error of the slope of about sigma/sqrt(8000) = 0.01.
    """
    sigma = 1.0
    x = 0.5 * np.random.default_rng(0).normal(size=(8000, 1))
    recipe = Recipe(hidden=(16,), epochs=40, batch=500, patience=40)
    training = Training(Samples(x, x.copy(), LINE), sigma, recipe)
    last = list(training.epochs())[-1]
    s = x.std()
    queries = np.linspace(-s, s, 21)[:, None]
    slope = np.polyfit(queries[:, 0], training.model().values(queries)[:, 0], 1)[0]
    assert slope == pytest.approx(1.0 / (1.0 + sigma**2), abs=0.03)
    # E[(E[y | noised x] - y)²] = sigma²/(1 + sigma²) of y's variance; the clean error of the same
    # map is (1 - slope)².
    assert last.train == pytest.approx(0.5, abs=0.03)
    assert last.noised == pytest.approx(0.5, abs=0.06)
    assert last.clean == pytest.approx(0.25, abs=0.05)


def g_sigma(x: np.ndarray, data: Samples, sigma: float) -> np.ndarray:
    """Return the weighted average of equation 11 in one dimension, written out."""
    exponents = -0.5 * ((x[:, None] - data.z[:, 0]) / (sigma * data.z.std())) ** 2
    weights = np.exp(exponents - exponents.max(axis=1, keepdims=True))
    return weights @ data.y[:, 0] / weights.sum(axis=1)


@pytest.mark.costly
def test_h_sigma_tends_to_g_sigma() -> None:
    """In training the distance of h_sigma from equation 11 falls where there are data; that of h does not."""
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 1))
    data, sigma = Samples(x, np.maximum(x, 0.0), LINE), 0.3
    queries = np.linspace(-1.0, 1.0, 101)
    recipe = Recipe(hidden=(32, 32), epochs=60, batch=100, held_out=0)

    def distance(training: Training) -> float:
        found = training.model().values(queries[:, None])[:, 0]
        return float(np.sqrt(np.mean((found - g_sigma(queries, data, sigma)) ** 2)))

    noised, clean = Training(data, sigma, recipe), Training(data, 0.0, recipe)
    distances = [distance(noised) for _ in noised.epochs()]
    run(clean)
    assert distances[-1] < 0.2 * distances[0]
    assert distances[-1] < 0.015 < 0.03 < distance(clean)


@pytest.mark.costly
def test_training_stops_when_held_out_error_does_not_fall() -> None:
    """The targets do not depend on z, so that the held-out error does not fall."""
    rng = np.random.default_rng(0)
    data = Samples(rng.normal(size=(100, 1)), rng.normal(size=(100, 1)), LINE)
    training = Training(data, 0.0, Recipe(hidden=(64, 64), epochs=2000, rate=1e-2, patience=5))
    told = list(training.epochs())
    best = min(told, key=lambda epoch: epoch.noised)
    assert told[-1].number == best.number + 5 < 2000
    assert told[-1].best == best.noised < told[-1].noised
    held = training.held_out
    error = (training.model().values(data.z[held]) - data.y[held]) / data.y.std()
    assert np.mean(error**2) == pytest.approx(best.noised, rel=1e-5)


@pytest.mark.costly
def test_held_out_rows_are_never_trained_on() -> None:
    """Other targets of held-out rows give the same weights, if no scale and no stop depends on them."""
    data = pushed(200)
    recipe = replace(TINY, patience=6)
    first = Training(data, 0.1, recipe)
    assert len(first.held_out) == 20 and not set(first.held_out) & set(first.trained_on)
    swapped = data.y.copy()
    swapped[first.held_out] = swapped[np.roll(first.held_out, 1)]
    second = Training(replace(data, y=swapped), 0.1, recipe)
    seen = list(first.epochs()), list(second.epochs())
    assert [epoch.train for epoch in seen[0]] == pytest.approx([e.train for e in seen[1]])
    assert seen[0][-1].clean != pytest.approx(seen[1][-1].clean, rel=1e-2)


def test_training_holds_out_what_transitions_do() -> None:
    """A network and an average of the same data are compared on rows that neither has used."""
    drawn = pushed(100)
    data = Transitions.from_arrays(drawn.z[:, :2], drawn.z[:, 2:], drawn.y, PUSH.y, PUSH.inputs)
    training = Training(data.samples(), 0.1, TINY, seed=5)
    rest, held_out = split_rows(len(data), TINY.held_out, seed=5)
    assert np.array_equal(training.held_out, held_out)
    assert np.array_equal(training.trained_on, rest)
    assert training.model().origin.data_hash == data.hash


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hidden": (8, 0)}, "hidden must be whole numbers >= 1"),
        ({"hidden": ()}, "hidden has no layers"),
        ({"epochs": 0}, "epochs must be a whole number >= 1"),
        ({"batch": 1.5}, "batch must be a whole number >= 1"),
        ({"rate": 0.0}, "rate must be a number > 0"),
        ({"held_out": 1.0}, "held_out must be a number >= 0 and < 1"),
        ({"sigma": -0.1}, "sigma must be a number >= 0, got -0.1"),
        ({"sigma": np.inf}, "sigma must be a finite number >= 0, got inf"),
    ],
)
def test_a_recipe_that_cannot_be_is_said(change: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        train_network(pushed(50), **{"sigma": 0.1, **change})


def test_data_that_cannot_be_learned_from_are_said() -> None:
    data = pushed(50)
    broken = data.z.copy()
    broken[[4, 9], 1] = np.nan
    with pytest.raises(ValueError, match=r"data: 2 of \d+ rows hold .* turn\w* is \S+ in row 4"):
        replace(data, z=broken)
    with pytest.raises(ValueError, match=r"y \(49, 2\), expected \(50, 3\) and \(50, 2\)"):
        replace(data, y=data.y[1:])
    with pytest.raises(ValueError, match="4 rows are too few to train on with 10 % of them"):
        Training(pushed(4), 0.1)
    constant = data.z.copy()
    constant[:, 2] = 3.0
    with pytest.raises(ValueError, match="data: u never varies"):
        Training(replace(data, z=constant), 0.1)
    with pytest.raises(ValueError, match="data: the next q, the next turn never varies"):
        Training(replace(data, y=np.ones((50, 2))), 0.1)


@pytest.mark.costly
def test_training_that_diverges_is_said() -> None:
    with pytest.raises(ValueError, match=r"diverged in epoch \d+; lower rate"):
        train_network(pushed(200), 0.1, rate=1e30, epochs=20, hidden=(8,))


def test_without_the_extra_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "equinox", None)
    with pytest.raises(ValueError, match=r"the extra learn installs.*centralpath\[learn\]"):
        Network(1, 1, TINY, 0.0, 0)
    assert a_model().values(np.zeros((1, 3))).shape == (1, 2)
