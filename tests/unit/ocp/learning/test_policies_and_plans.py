"""Study A4 compares policies with plans by the same rewards, and its claims follow the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from dynamics.batch import BatchFunction
from ocp.learning.experiment import EXACT
from ocp.learning.protocol import Normaliser, TrainedPolicy
from ocp.learning.training import evaluate_from
from problems.studies.shared.trainings import interpolate_finite, side_by_side
from problems.studies.study import FinishedParts
from problems.studies.trained_policies import data as trained_policies
from problems.studies.trained_policies.claims import claims
from problems.studies.trained_policies.data import (
    METHODS,
    MODEL_BASED,
    SHOWN,
    STEPS,
    TASKS,
    Params,
    Policy,
    _job,
    initial_states,
)
from problems.tasks import registry
from problems.tasks.training import TrainingJob

REST = ("Total propagation", "AoBG")


@pytest.mark.costly
def test_a_policy_is_measured_over_the_first_steps_of_its_episode():
    task = registry.get("hopper")
    n_o, nu = len(task.observations), task.system.nu
    theta = 0.1 * np.random.default_rng(3).standard_normal(nu * (n_o + 1))
    policy = Policy("hopper", TrainedPolicy(theta, Normaliser.identity(n_o)), ())
    whole = evaluate_from(policy.experiment(task.horizon), policy.trained, EXACT, initial_states("hopper", 2))
    counted = [min(int(lived), STEPS) for lived in whole.lengths]
    rewards = BatchFunction(task.rewards, "numpy", 1)
    expected = [
        rewards(x[:n], u[:n], x[1 : n + 1], task.parameters.values).sum()
        for x, u, n in zip(whole.states, whole.inputs, counted, strict=True)
    ]
    np.testing.assert_allclose(policy.returns(2), expected, rtol=1e-9)


def test_more_starts_begin_with_the_same():
    np.testing.assert_array_equal(initial_states("hopper", 3)[:2], initial_states("hopper", 2))


def doubled(job: float, _: object) -> dict[str, np.ndarray]:
    return {"twice": np.array(2 * job)}


class Kept(FinishedParts):
    """Finished parts that contain the part ``one`` and record which parts are saved."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[str] = []

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        return {"twice": np.array(-1.0)} if key == "one" else None

    def save(self, key: str, made: object) -> dict[str, np.ndarray]:
        self.made.append(key)
        return super().save(key, made)


def test_a_piece_that_was_kept_is_not_made_again():
    pieces = Kept()
    found = side_by_side(doubled, {"one": 1.0, "two": 2.0}, pieces)
    assert (float(found["one"]["twice"]), float(found["two"]["twice"])) == (-1.0, 4.0)
    assert pieces.made == ["two"]


@pytest.mark.costly
def test_every_algorithm_has_the_same_budget_but_the_one_that_stands_beside():
    shown = {"states": np.zeros((2, 14)), "inputs": np.zeros((2, 3))}
    params = Params(kilosteps=7, judged=3, model_based=4)
    for name, method in METHODS.items():
        asked = _job("hopper", replace(method, shown=False), params, 1, [shown])
        if name == MODEL_BASED:
            assert asked.options["iterations"] == 4 and asked.experiment().budget is None
        else:
            assert asked.experiment().budget == (7000, 3)


def test_curves_end_where_steps_were_spent(monkeypatch: pytest.MonkeyPatch):
    """With returns of a hundredth of the steps the curves are that line, up to the steps spent."""

    def made(jobs: dict[str, TrainingJob], _: FinishedParts) -> dict[str, dict[str, np.ndarray]]:
        reached = {key: 60.0 if job.algorithm.name == "mbpo" else 1200.0 for key, job in jobs.items()}
        along = {key: np.array([0.0, end / 3, end]) for key, end in reached.items()}
        names = ("env_steps", "wall_s", "evaluation_speed", "evaluation_length")
        return {key: {**dict.fromkeys(names, steps), "evaluation_return": steps / 100} for key, steps in along.items()}

    monkeypatch.setattr(trained_policies, "training_curves", made)
    monkeypatch.setattr(trained_policies, "_against_plans", lambda *_: {})
    monkeypatch.setattr(trained_policies, "make_plans", lambda *_: {task: [] for task in TASKS})
    monkeypatch.setattr(trained_policies, "fit_network", lambda *_: None)
    found = trained_policies.run(Params(kilosteps=1, runs=2), FinishedParts())
    alone = found.sel(algorithm=MODEL_BASED)
    rest = found.drop_sel(algorithm=MODEL_BASED)
    assert (rest["spent"] == 1200).all() and (alone["spent"] == 60).all()
    line = found["steps"] / 100
    np.testing.assert_allclose(rest["by_steps"] - line, 0 * rest["by_steps"], atol=1e-12)
    assert np.isnan(alone["by_steps"].sel(steps=slice(61, None))).all()
    own = found["model_based"]
    np.testing.assert_allclose(own - found["few"] / 100, 0 * own, atol=1e-12)
    assert found["few"][-1] == 60 and found["steps"][-1] == 1000
    assert np.allclose(np.diff(found["steps"], 2), 0), "linear"


def test_between_evaluations_lines_are_straight_and_beyond_them_there_is_nothing():
    values = np.array([1.0, np.nan, 5.0, np.nan])
    found = interpolate_finite(np.linspace(0, 60, 7), np.array([10.0, 20.0, 50.0, 70.0]), values)
    np.testing.assert_array_equal(found, [np.nan, 1, 2, 3, 4, 5, np.nan])


@pytest.mark.parametrize("first", [1.0, -1.0])
def test_the_mean_is_over_equal_steps_of_those_that_spend_the_same(first: float):
    """A lead early or late in training counts the same, and MBPO is not compared."""
    made = curves_of(3, points=101)
    steps = np.linspace(-1, 1, 101)
    made["by_steps"].loc[{"algorithm": "FOPG-ABS"}] = 5 - first * steps
    made["by_steps"].loc[{"algorithm": MODEL_BASED}] = np.nan
    made["best"].loc[{"algorithm": MODEL_BASED}] = 1e9
    made["best"].loc[{"algorithm": "FOPG-ABS"}] = 2.0
    for others, fastest in ((4.9, True), (5.1, False)):
        made["by_steps"].loc[{"algorithm": ["FOPG", "ZOPG", "ARS", *REST]}] = others
        held = {claim.claim: claim.holds for claim in claims(made)}
        assert held["On hopper FOPG with ABS learns the fastest"] == fastest
        assert held["On hopper FOPG with ABS ends the highest"]


def test_algorithms_that_never_leave_their_initial_policy_are_named():
    """An algorithm is named if in every run its best return is the first one."""
    made = curves_of(3, points=4)
    made["best"][:] = 3.0
    made["best"].loc[{"task": "hopper", "algorithm": ["FOPG", "AoBG"]}] = 0.0
    made["best"].loc[{"task": "hopper", "algorithm": "AoBG"}][1] = 1e-9
    named = {c.claim: c.measured.partition("; ")[2] for c in claims(made) if "with ABS" in c.claim}
    assert {claim.split()[1]: words for claim, words in named.items()} == {
        "hopper": "never above their initial policy: FOPG",
        "half-cheetah": "",
    }


@pytest.mark.parametrize(("reached", "gain"), [(5.0, 1.0), (11.0, -1.0)])
def test_verdicts_on_plans_follow_the_data(reached: float, gain: float):
    made = curves_of(3, points=4)
    made["by_steps"].loc[{"algorithm": SHOWN}] += gain
    made["reached"][:] = reached
    found = [claim for claim in claims(made) if "plan" in claim.claim]
    assert [claim.holds for claim in found] == [gain > 0, reached <= 10.0] * len(TASKS)
    assert f"FOPG-ABS {reached / 10:.0%}" in found[1].measured


def curves_of(runs: int, points: int) -> xr.Dataset:
    """Return data of the study in which all curves rise equally and plans return 10."""
    names = list(METHODS)
    rising = np.arange(points) * np.ones((len(TASKS), len(names), runs, points))
    of = ("task", "algorithm", "run")
    one = np.ones((len(TASKS), len(names), runs))
    planned = (("task", "guess", "start"), np.full((len(TASKS), 2, 2), 10.0))
    return xr.Dataset(
        {
            "by_steps": ((*of, "steps"), rising),
            **{name: (of, one.copy()) for name in ("best", "speed", "length")},
            "planned": planned,
            "replayed": planned,
            "certified": planned,
            "reached": ((*of, "start"), np.ones((*one.shape, 2))),
        },
        {"task": list(TASKS), "algorithm": names, "steps": np.arange(points)},
    )
