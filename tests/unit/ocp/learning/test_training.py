"""The training loop: evaluated under the exact law, resumed to the last bit, the same for any number of threads."""

from __future__ import annotations

import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import minimize

from dynamics.batch import EpisodeFunction, StepFunction
from dynamics.contact import Barrier
from ocp.errors import InputError, NotConverged
from ocp.learning.experiment import EXACT, Budget
from ocp.learning.protocol import MIN_OBSERVATION_SCALE, Normaliser, TrainedPolicy
from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.training import EVALUATION_SEED, evaluate, train
from ocp.learning.unroll_gradients import ARS, FOPG, ZOPG, AoBG
from ocp.learning.unrolling import Starts
from ocp.store.checkpoint import Checkpoint
from tests.unit.ocp.learning.scalar import A, B, experiment, scalar

SMALL = {
    "fopg": FOPG(samples=4, unroll=3),
    "along": FOPG(samples=4, unroll=3, smoothing="gradient", optimiser="normalised"),
    "critic": FOPG(samples=4, unroll=3, critic=4),
    "zopg": ZOPG(samples=6, unroll=3),
    "ars": ARS(directions=3, top=2),
    "aobg": AoBG(samples=4, unroll=3),
    "total-propagation": TotalPropagation(samples=4, unroll=3),
}
TASK = {"horizon": 7, "done": 1.2}


class Always(Checkpoint):
    """Checkpoint that saves after every iteration."""

    def due(self) -> bool:
        return True


def given_to(name: str) -> dict[str, float]:
    """Return the settings of experiments with the algorithm ``name``."""
    discount = 0.9 if name == "critic" else 1.0
    return {"iterations": 6, "evaluate_every": 2, "discount": discount}


def run(name: str, root: Path | None = None, kill_at: int = -1, stop_at: int = -1, **given) -> xr.Dataset:
    """Train with a checkpoint in ``root``; iteration ``kill_at`` is killed, or ``stop_at`` interrupted."""

    def report(k, _):
        if k == stop_at + 1 > 0:
            raise KeyboardInterrupt
        if k == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    settings = {**given_to(name), "task": scalar(**TASK), **given}
    with Always(root, "scalar", {"name": name}) as checkpoint:
        return train(experiment(SMALL[name], **settings), checkpoint, report)


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Check that two runs are equal to the last bit, except for times."""
    assert set(one) == set(other)
    for name in set(one) - {"wall_s"}:
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=str(name))


@pytest.mark.costly
@pytest.mark.parametrize("name", ["fopg", "critic", "ars", "total-propagation"])
def test_a_killed_training_goes_on_to_the_same_end(name, tmp_path):
    """Training is killed by signal 9 in iteration 3 and resumed by another process."""
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=run, args=(name, tmp_path, 3))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    done = []
    asked = experiment(SMALL[name], **given_to(name), task=scalar(**TASK))
    with Always(tmp_path, "scalar", {"name": name}) as checkpoint:
        resumed = train(asked, checkpoint, lambda k, _: done.append(k))
    assert done == [3, 4, 5, 6], "what was saved is not done again"
    assert_same(resumed, run(name))


@pytest.mark.costly_cases("along", "critic", "total-propagation")
@pytest.mark.parametrize("name", list(SMALL))
def test_threads_do_not_change_a_bit(name):
    assert_same(run(name, threads=1), run(name, threads=2))


@pytest.mark.cheap_cases("fopg", "zopg", "aobg")
@pytest.mark.parametrize("name", list(SMALL))
def test_seeds_change_everything_and_are_kept(name):
    first, again, other = run(name), run(name), run(name, seed=1)
    assert_same(first, again)
    assert not np.array_equal(first["theta_last"], other["theta_last"])


@pytest.mark.costly
@pytest.mark.parametrize("name", list(SMALL))
def test_every_algorithm_goes_most_of_the_way_to_the_best_policy(name):
    """The best affine policy comes from a separate search over its two parameters."""
    task = scalar(horizon=7)
    found = run(name, task=task, iterations=150, evaluate_every=150, initial=1.0)
    first, last = found["evaluation_return"].values[[0, -1]]
    starts = task.reset(4, np.random.default_rng(EVALUATION_SEED))[:, 0]

    def cost(theta):
        x, total = starts, 0.0
        for _ in range(7):
            u = 2 * np.tanh(theta[0] * x + theta[1])
            x = A * x + B * u
            total += ((x - 1) ** 2 + 0.1 * u**2).mean()
        return total

    best = -minimize(cost, [0.0, 0.0], method="Nelder-Mead").fun
    assert first < best
    assert last > best - 0.2 * (best - first)


def test_curves_tell_the_policy_before_each_iteration():
    found = run("fopg")
    assert found.sizes["iteration"] == 7
    judged = np.isfinite(found["evaluation_return"].values)
    assert judged.tolist() == [k % 2 == 0 for k in range(7)]
    assert found["env_steps"].values[0] == 0 and (np.diff(found["env_steps"]) > 0).all()
    assert np.isnan(found["return_mean"].values[-1])
    best = int(found["best_iteration"])
    assert found["evaluation_return"].values[best] == np.nanmax(found["evaluation_return"].values)


@pytest.mark.cheap_cases("fopg", "ars")
@pytest.mark.parametrize("name", list(SMALL))
def test_every_step_that_an_engine_simulates_is_counted(name, monkeypatch):
    """Both batches, mirrored noise and steps of gradients are counted; evaluations are not."""
    engines = []
    rolled, stepped = EpisodeFunction.__call__, StepFunction._evaluate

    def episodes(self, *given, **asked):
        found = rolled(self, *given, **asked)
        engines.append(found.lived.sum())
        return found

    def steps(self, given, n):
        engines.append(n)
        return stepped(self, given, n)

    asked = experiment(SMALL[name], **given_to(name), task=scalar(**TASK))
    state, told = asked.algorithm.begin(asked), []
    with monkeypatch.context() as patched:
        patched.setattr(EpisodeFunction, "__call__", episodes)
        patched.setattr(StepFunction, "_evaluate", steps)
        for k in range(6):
            state, _ = asked.algorithm.iterate(asked, state, k)
            told.append(asked.take_step_count())
            assert told[-1] == sum(engines) > 0
            engines.clear()
    assert run(name)["env_steps"].values.tolist() == [0, *np.cumsum(told)]


@pytest.mark.cheap_cases("ars", "aobg")
@pytest.mark.parametrize("name", list(SMALL))
def test_a_budget_ends_learning_and_sets_its_evaluations(name, tmp_path):
    """Evaluations are at the first iteration past each of five equal distances in steps."""
    found = run(name, budget=Budget(200, 5))
    steps, judged = found["env_steps"].values, np.isfinite(found["evaluation_return"].values)
    assert steps[-2] < 200 <= steps[-1]
    first = [int(np.argmax(steps >= mark)) for mark in (0, 40, 80, 120, 160, 200)]
    assert np.flatnonzero(judged).tolist() == first
    with pytest.raises(KeyboardInterrupt):
        run(name, tmp_path, budget=Budget(200, 5), stop_at=first[2] - 1)
    assert_same(run(name, tmp_path, budget=Budget(200, 5)), found)
    with pytest.raises(InputError, match="the budget's steps must be a whole number"):
        run(name, budget=Budget(0, 5))


def test_other_settings_cannot_go_on(tmp_path):
    run("fopg", tmp_path)
    for given, words in (
        ({"discount": 0.9}, "discount = 1.0 not 0.9"),
        ({"law": Barrier(1e-3)}, "contact.law = exact not barrier"),
        ({"seed": 3}, "seed = 0 not 3"),
    ):
        with pytest.raises(InputError, match=f"other settings: .*{words}"):
            run("fopg", tmp_path, **given)
    with pytest.raises(InputError, match="has 6 iterations already, more than the 2 requested"):
        run("fopg", tmp_path, iterations=2)
    assert_same(run("fopg", tmp_path, iterations=9), run("fopg", iterations=9))


def test_evaluation_by_hand():
    """Returns are sums of rewards until the episode's end; measures are means over the same steps."""
    e = experiment(FOPG(), task=scalar(horizon=6, done=0.9), discount=0.5)
    theta, seen = np.array([0.3, 0.4]), Normaliser(4.0, np.array([0.2]), np.array([1.0]))
    found = evaluate(e, TrainedPolicy(theta, seen), EXACT, 5, seed=3)
    assert len(set(found.lengths)) > 1 and found.lengths.min() < 6
    for i in range(5):
        x, total, visited = found.states[i, 0, 0], 0.0, []
        for t in range(found.lengths[i]):
            u = 2 * np.tanh(0.3 * (x - 0.2) / 0.5 + 0.4)
            assert found.inputs[i, t] == pytest.approx(u)
            x = A * x + B * u
            total -= (x - 1) ** 2 + 0.1 * u**2
            visited.append(x)
        assert found.returns[i] == pytest.approx(total)
        assert found.measures["mean"][i] == pytest.approx(np.mean(visited))
        assert visited[-1] > 0.9 or len(visited) == 6
    assert found.summary()["unsolved"] == 0


def test_running_statistics_are_those_of_all_at_once():
    rng = np.random.default_rng(0)
    parts = [3 + rng.standard_normal((n, 2)) * [1, 1e-4] for n in (5, 1, 0, 40)]
    seen = Normaliser.identity(2)
    assert seen.scale.tolist() == [1, 1]
    for part in parts:
        seen = seen.after(part)
    whole = np.vstack(parts)
    assert seen.mean == pytest.approx(whole.mean(axis=0))
    assert seen.scale == pytest.approx([whole[:, 0].std(), MIN_OBSERVATION_SCALE])


def test_the_buffer_carries_episodes_on():
    """An episode continues from its state; it restarts if it ended, had all its steps, or became NaN."""
    e = experiment(FOPG(), task=scalar(horizon=10))
    states = np.arange(20.0).reshape(4, 5, 1)
    states[3, 4] = np.nan
    before = Starts(np.zeros((4, 1)), np.array([0, 0, 6, 2]))
    after = before.after(e, states, np.array([4, 2, 4, 4]), 0)
    assert after.age.tolist() == [4, 0, 0, 0]
    assert after.x[0, 0] == states[0, 4, 0]
    assert (np.abs(after.x[1:] - 0.5) <= 0.25).all(), "first states of the task"


@pytest.mark.parametrize(
    ("algorithm", "settings", "words"),
    [
        (FOPG, {"samples": 0}, "fopg: samples must be a whole number >= 1, got 0"),
        (FOPG, {"unroll": 0}, "unroll must be a whole number >= 1, got 0"),
        (FOPG, {"sigma": 0.0}, "sigma must be a number > 0, got 0"),
        (FOPG, {"rate": np.inf}, "rate must be a finite number > 0, got inf"),
        (FOPG, {"optimiser": "sgd"}, "optimiser must be 'adam' or 'normalised' or 'plain', got 'sgd'"),
        (FOPG, {"optimiser": "adm"}, r"got 'adm' \(did you mean 'adam'\?\)"),
        (FOPG, {"smoothing": "no"}, "smoothing must be 'rollout' or 'gradient', got 'no'"),
        (ZOPG, {"samples": 2}, "samples must be a whole number >= 4, got 2"),
        (ZOPG, {"samples": 7}, "samples come in pairs of w and -w: 7 is odd"),
        (ARS, {"directions": 0}, "directions must be a whole number >= 1, got 0"),
        (ARS, {"directions": 3, "top": 4}, "top is 4, more than the 3 directions"),
        (AoBG, {"samples": 1}, "samples must be a whole number >= 2, got 1; a variance needs two"),
        (AoBG, {"delta": 1.0}, "delta must be a number > 0 and < 1, got 1"),
        (AoBG, {"gamma": -1.0}, r"gamma must be a number > 0 \[return / unit of theta\], got -1"),
        (TotalPropagation, {"samples": 1}, "samples must be a whole number >= 2, got 1; a variance needs two"),
    ],
)
def test_settings_that_cannot_be_are_refused(algorithm, settings, words):
    with pytest.raises(InputError, match=words):
        algorithm(**settings)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"discount": 1.5}, "discount must be a number > 0 and <= 1, got 1.5"),
        ({"discount": 0.0}, "discount must be a number > 0 and <= 1, got 0; 1 counts all"),
        ({"iterations": 0}, "iterations must be a whole number >= 1, got 0"),
        ({"episodes": 0}, "episodes must be a whole number >= 1, got 0"),
        ({"evaluate_every": 0}, "evaluate_every must be a whole number >= 1, got 0"),
        ({"hidden": (8, 0)}, "hidden must be whole numbers >= 1"),
        ({"seed": -1}, "seed must be a whole number >= 0, got -1"),
        ({"initial": np.nan}, "initial must be a finite number >= 0, got nan"),
        ({"model_params": np.ones(3)}, r"model_params has shape \(3,\), expected \(1,\)"),
    ],
)
def test_experiments_that_cannot_be_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        experiment(FOPG(), **given)


@pytest.mark.costly_cases("fopg", "ars")
@pytest.mark.parametrize("name", ["fopg", "ars", "zopg", "aobg", "total-propagation"])
def test_a_reward_that_is_no_number_is_named(name):
    """Without inputs x is 0.5, 0.45, ..., where the reward is NaN above 0.4."""
    e = experiment(SMALL[name], task=scalar(horizon=3, broken=0.4, width=0.0), initial=0.0)
    state = e.algorithm.begin(e)
    with pytest.raises(InputError, match=r"scalar: the reward of step 0 of sample \d in"):
        e.algorithm.iterate(e, state, 7)


def test_a_reward_that_is_no_number_is_named_by_evaluations():
    """Without inputs x is 0.5, 0.45, 0.405, ..., where the reward is NaN above 0.42."""
    e = experiment(FOPG(), task=scalar(horizon=3, broken=0.42, width=0.0), initial=0.0)
    with pytest.raises(InputError, match="the reward of step 0 of episode 0 of the evaluation is"):
        train(e)


def test_nothing_finite_is_told():
    """Infinite states are reported, and not as an error of the reward."""
    e = experiment(FOPG(samples=4, unroll=3))
    state = {**e.algorithm.begin(e), "starts.x": np.full((4, 1), np.inf)}
    with pytest.raises(NotConverged, match="scalar: no sample of iteration 0 stayed finite"):
        e.algorithm.iterate(e, state, 0)
