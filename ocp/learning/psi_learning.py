"""Joint learning of a policy and its model's physical parameters (Zhang, Jin and Wang 2023, algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from dynamics.settings import setting
from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.explorer import Buffer, Explorer
from ocp.learning.identify import OneStepLoss, search_iteration
from ocp.learning.protocol import Algorithm, Row, State, TrainedPolicy, with_prefix, without_prefix
from ocp.search.random_search import RandomSearch, SearchDistribution

PSI_PREFIX = "psi_learning."
"""Prefix of the algorithm's entries in the state, as opposed to those of the wrapped algorithm."""
SEARCH_PREFIX = "psi_search."
"""Prefix of the search distribution's entries in the state."""
TRANSITIONS_PREFIX = "psi_transitions."
"""Prefix of the stored transitions' entries in the state."""


@dataclass(frozen=True, kw_only=True)
class PsiLearning(Algorithm):
    """Algorithm that runs another ``algorithm`` and also learns the parameters ``names`` of its model.

    Every iteration first continues ``n_envs`` episodes for ``steps`` steps under the exact law with the task's
    own parameters. The inputs are those of the policy plus noise of ``sigma`` half ranges, and the newest ``capacity``
    transitions are stored. Then the random search for psi performs ``search_iterations`` iterations; each compares
    candidates by the one-step loss (eq. 4.1) on ``rows`` of the stored transitions. Finally ``algorithm`` does
    one iteration on the model with the resulting parameters, which are stored as ``psi`` in the state. The
    search starts at the experiment's model parameters. In the rows, ``env_steps`` is the number of steps under
    the exact law, and ``model_steps`` the number of steps that ``algorithm`` simulates.
    """

    name: ClassVar[str] = "psi"
    summary: ClassVar[str] = "any algorithm, which also learns the model's parameters"
    contact: ClassVar[str] = "adaptive"

    algorithm: Algorithm
    names: tuple[str, ...]
    n_envs: int = setting(16, "episodes continued under the exact law in each iteration", least=1)
    steps: int = setting(16, "steps of each continued episode", least=1)
    sigma: float = setting(0.1, "noise on the inputs, in half ranges", least=0)
    capacity: int = setting(2000, "transitions that are stored", least=1)
    rows: int = setting(128, "transitions on which a search iteration compares candidates", least=1)
    search_iterations: int = setting(10, "search iterations per policy iteration", least=1)
    search: RandomSearch = field(default_factory=RandomSearch)

    def settings(self) -> dict[str, Any]:
        """Return the settings of this algorithm, of its search, and of the algorithm that it runs."""
        settings = {k: v for k, v in vars(self).items() if k not in ("algorithm", "search")}
        search, algorithm_settings = with_prefix("search.", vars(self.search)), self.algorithm.settings()
        return {**settings, **search, "of": self.algorithm.name, **with_prefix("of.", algorithm_settings)}

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` if the wrapped algorithm's settings do not fit the experiment."""
        self.algorithm.check(experiment)

    def begin(self, experiment: Experiment) -> State:
        """Return the initial state: the wrapped algorithm's state, first states of episodes, and no transitions."""
        self.check(experiment)
        loss, explorer = experiment.cached(self._loss), experiment.cached(_explorer)
        start = loss.start(experiment.task.parameters.unpack(experiment.physics))
        x, age = explorer.initial_states(self.n_envs, experiment.rng(0, "psi starts"))
        no_states = np.zeros((0, experiment.task.system.nx))
        transitions = Buffer(no_states, np.zeros((0, experiment.task.system.nu)), no_states)
        return {
            **self.algorithm.begin(experiment),
            "psi": experiment.physics,
            PSI_PREFIX + "x": x,
            PSI_PREFIX + "age": age,
            PSI_PREFIX + "start": start,
            PSI_PREFIX + "pass": np.array(0),
            **with_prefix(SEARCH_PREFIX, vars(self.search.begin(start))),
            **with_prefix(TRANSITIONS_PREFIX, vars(transitions)),
        }

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Collect transitions, then update psi, and finally update the policy."""
        state = self._collect_transitions(experiment, state, k)
        exact_steps = experiment.take_step_count()
        state, loss = self._update_psi(experiment, state)
        changed, row = self.algorithm.iterate(experiment, state, k)
        psi_row = {"psi_loss": loss, "model_steps": experiment.take_step_count()}
        experiment.count_steps(exact_steps)
        return {**state, **changed}, {**row, **psi_row}

    def policy(self, experiment: Experiment, state: State) -> TrainedPolicy:
        """Return the policy of the wrapped algorithm."""
        return self.algorithm.policy(experiment, state)

    def _collect_transitions(self, experiment: Experiment, state: State, k: int) -> State:
        """Continue the episodes for ``steps`` steps; return the state with the new transitions added."""
        explorer, rng = experiment.cached(_explorer), experiment.rng(k, "psi transitions")
        policy = self.algorithm.policy(experiment, state)
        task = experiment.task
        x, age, transitions = (
            state[PSI_PREFIX + "x"],
            state[PSI_PREFIX + "age"],
            Buffer(**without_prefix(TRANSITIONS_PREFIX, state)),
        )
        for _ in range(self.steps):
            u = experiment.inputs(policy, x)
            u += self.sigma * task.half_range * rng.standard_normal(u.shape)
            step = explorer.step(x, np.clip(u, task.lower, task.upper))
            transitions = transitions.with_newest(Buffer.from_solved_steps(step.x, step.u, step.x_next), self.capacity)
            x, age = explorer.advance(step, age, rng)
        return {
            **state,
            **with_prefix(TRANSITIONS_PREFIX, vars(transitions)),
            PSI_PREFIX + "x": x,
            PSI_PREFIX + "age": age,
        }

    def _update_psi(self, experiment: Experiment, state: State) -> tuple[State, float]:
        """Continue the search for psi; return the new state, and the loss per transition at the new psi."""
        transitions = Buffer(**without_prefix(TRANSITIONS_PREFIX, state))
        if not len(transitions):
            raise InputError(f"{experiment.task.name}: no step of its episodes was solved")
        loss = experiment.cached(self._loss).in_scales_of(transitions)
        distribution = SearchDistribution(**without_prefix(SEARCH_PREFIX, state))
        number = int(state[PSI_PREFIX + "pass"])
        for _ in range(self.search_iterations):
            if self.search.is_done(distribution):
                if number + 1 >= self.search.passes:
                    break
                number += 1
                sensitivity = loss.sensitivity(distribution.mean, self.search.width, transitions)
                distribution = self.search.begin(distribution.mean, sensitivity, state[PSI_PREFIX + "start"])
            seeds = [experiment.seed, number]
            distribution = search_iteration(loss, transitions, self.search, distribution, seeds, self.rows)
        psi = loss.parameters(distribution.mean[None])[0, : len(experiment.physics)]
        changes = {"psi": psi, PSI_PREFIX + "pass": np.array(number), **with_prefix(SEARCH_PREFIX, vars(distribution))}
        return {**state, **changes}, float(loss(distribution.mean, transitions)[0]) / len(transitions)

    def _loss(self, experiment: Experiment) -> OneStepLoss:
        """Return the one-step loss as a function of the parameters ``names``; others have the experiment's values."""
        values = experiment.task.parameters.unpack(experiment.physics)
        task = experiment.task
        step = EXACT.close(replace(task.system, parameters=task.parameters))
        return OneStepLoss(step, self.names, values, threads=experiment.threads)


def _explorer(experiment: Experiment) -> Explorer:
    return Explorer(experiment.task, count=experiment.count_steps, threads=experiment.threads)
