"""A4's measure of policies by plans: the same rewards, and claims that can come out either way."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from dynamics.batch import BatchFunction
from ocp.learning.evaluation import evaluate_from
from ocp.learning.experiment import EXACT
from ocp.learning.normaliser import Normaliser
from ocp.learning.protocol import Trained
from problems.studies.shared.trainings import side_by_side
from problems.studies.study import Pieces
from problems.studies.trained_policies.claims import claims
from problems.studies.trained_policies.data import METHODS, TASKS
from problems.studies.trained_policies.plans import STEPS, Policy, starts
from problems.tasks import registry


def test_a_policy_is_measured_over_the_first_steps_of_its_episode():
    task = registry.get("hopper")
    n_o, nu = len(task.observations), task.system.nu
    theta = 0.1 * np.random.default_rng(3).standard_normal(nu * (n_o + 1))
    policy = Policy("hopper", Trained(theta, Normaliser.identity(n_o)), ())
    whole = evaluate_from(policy.over(task.horizon), policy.trained, EXACT, starts("hopper", 2))
    counted = [min(int(lived), STEPS) for lived in whole.lengths]
    rewards = BatchFunction(task.rewards, "numpy", 1)
    expected = [
        rewards(x[:n], u[:n], x[1 : n + 1], task.parameters.values).sum()
        for x, u, n in zip(whole.states, whole.inputs, counted, strict=True)
    ]
    np.testing.assert_allclose(policy.returns(2), expected, rtol=1e-9)


def test_more_starts_begin_with_the_same():
    np.testing.assert_array_equal(starts("hopper", 3)[:2], starts("hopper", 2))


def doubled(job: float, _: object) -> dict[str, np.ndarray]:
    return {"twice": np.array(2 * job)}


class Kept(Pieces):
    """Has the piece ``one``, and counts what it is asked to keep."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[str] = []

    def kept(self, key: str) -> dict[str, np.ndarray] | None:
        return {"twice": np.array(-1.0)} if key == "one" else None

    def keep(self, key: str, made: object) -> dict[str, np.ndarray]:
        self.made.append(key)
        return super().keep(key, made)


def test_a_piece_that_was_kept_is_not_made_again():
    pieces = Kept()
    found = side_by_side(doubled, {"one": 1.0, "two": 2.0}, pieces)
    assert (float(found["one"]["twice"]), float(found["two"]["twice"])) == (-1.0, 4.0)
    assert pieces.made == ["two"]


@pytest.mark.parametrize(("reached", "gain"), [(5.0, 1.0), (11.0, -1.0)])
def test_verdicts_on_plans_follow_the_data(reached: float, gain: float):
    runs, points, names = 3, 4, list(METHODS)
    rising = np.arange(points) * np.ones((len(TASKS), len(names), runs, points))
    rising[:, names.index("the same, from plans")] += gain
    of = ("task", "algorithm", "run")
    one = np.ones((len(TASKS), len(names), runs))
    planned = (("task", "guess", "start"), np.full((len(TASKS), 2, 2), 10.0))
    data = xr.Dataset(
        {
            "by_steps": ((*of, "steps"), rising),
            **dict.fromkeys(("best", "speed", "length"), (of, one)),
            "planned": planned,
            "replayed": planned,
            "certified": planned,
            "reached": ((*of, "start"), np.full((*one.shape, 2), reached)),
        },
        {"task": list(TASKS), "algorithm": names, "steps": np.arange(points)},
    )
    found = [claim for claim in claims(data) if "plan" in claim.claim]
    assert [claim.holds for claim in found] == [gain > 0, reached <= 10.0] * len(TASKS)
    assert f"FOPG-ABS {reached / 10:.0%}" in found[1].measured
