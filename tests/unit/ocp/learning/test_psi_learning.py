"""Algorithm 1 on a mass on a spring: physical parameters psi and a policy are learned together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.training import train
from ocp.learning.unroll_gradients import FOPG
from ocp.search.random_search import RandomSearch
from tests.unit.ocp.learning.spring_mass import D, K, M, following, spring_task

WRONG = np.array([1.5 * M, 0.6 * K, D, 0.0])
"""Initial psi; its damping is right, and its rest length is not learned."""


@dataclass(frozen=True)
class Told:
    """Algorithm that only records the psi that it gets."""

    name: ClassVar[str] = "told"
    summary: ClassVar[str] = ""

    def settings(self) -> dict[str, Any]:
        return {}

    def check(self, experiment):
        pass

    def begin(self, experiment):
        return {"theta": experiment.first_theta()}

    def iterate(self, experiment, state, k):
        experiment.count_steps(7)
        return {**state, "given": state["psi"]}, {"return_mean": 0.0}

    def policy(self, experiment, state):
        from ocp.learning.protocol import Normaliser, TrainedPolicy

        return TrainedPolicy(state["theta"], Normaliser.identity(2))


def learning(algorithm: Any = None, **changed: Any) -> PsiLearning:
    return PsiLearning(algorithm=algorithm or Told(), names=("m", "k"), sigma=1.0, **changed)


def experiment(algorithm: Any, **changed: Any) -> Experiment:
    settings = {"iterations": 6, "hidden": (), "model_params": WRONG, "episodes": 4, "law": Exact()}
    return Experiment(task=spring_task(horizon=20), algorithm=algorithm, **{**settings, **changed})


def test_psi_comes_to_the_truth_before_each_step_of_the_algorithm_s():
    own = learning(n_envs=8, steps=10, search_iterations=20)
    run = experiment(own)
    state = own.begin(run)
    assert (state["psi"] == WRONG).all()
    errors = []
    for k in range(6):
        state, row = own.iterate(run, state, k)
        assert (state["given"] == state["psi"]).all()
        assert run.take_step_count() == 80 and row["model_steps"] == 7
        errors.append(np.abs(state["psi"][:2] / [M, K] - 1).max())
    assert errors[0] > 1e-3 and errors[-1] < 1e-3 and row["psi_loss"] < 1e-6
    assert (state["psi"][2:] == WRONG[2:]).all()
    transitions = [state[f"psi_transitions.{name}"] for name in ("x", "u", "x_next")]
    assert len(transitions[0]) == 480
    assert transitions[2] == pytest.approx(following(transitions[0], transitions[1], M, K, D), abs=1e-6)
    assert (transitions[1] >= -2).all() and (transitions[1] <= 6).all() and transitions[1].std() > 1


def test_a_run_that_goes_on_from_its_arrays_ends_at_the_same_bits():
    own = learning(n_envs=4, steps=5, search_iterations=3, capacity=30, search=RandomSearch(iterations=4, narrow=0.0))
    run = experiment(own)
    state = own.begin(run)
    for k in range(4):
        state, _ = own.iterate(run, state, k)
    assert int(state["psi_learning.pass"]) == 1 and len(state["psi_transitions.x"]) == 30
    again = experiment(own, threads=1)
    resumed = own.begin(again)
    for k in range(4):
        resumed, _ = own.iterate(again, {name: np.array(a) for name, a in resumed.items()}, k)
    assert [name for name in state if not np.array_equal(state[name], resumed[name])] == []


def test_the_gradient_s_model_is_the_one_learned():
    """FOPG with psi learning reports returns of its model, which tend to those of the true model."""
    inner = FOPG(samples=8, unroll=10, rate=1e-12)
    own = learning(inner, n_envs=8, steps=10, search_iterations=20)
    found = train(experiment(own))
    true, wrong = (train(experiment(inner, model_params=p)) for p in (None, WRONG))
    told = [data["return_mean"].values[:-1] for data in (found, true, wrong)]
    assert np.abs(told[1] - told[2]).min() > 1e-4
    assert told[0][-1] == pytest.approx(told[1][-1], abs=0.02 * abs(told[1][-1] - told[2][-1]))
    assert found["psi"].values[:2] == pytest.approx([M, K], rel=1e-3)


def test_what_cannot_be_learned_is_told():
    own = PsiLearning(algorithm=Told(), names=("mass",))
    with pytest.raises(InputError, match="no parameter 'mass'"):
        own.begin(experiment(own))
    with pytest.raises(InputError, match="psi: n_envs must be a whole number >= 1"):
        learning(n_envs=0)
    assert learning(rows=5).settings()["rows"] == 5 and learning().settings()["of"] == "told"
