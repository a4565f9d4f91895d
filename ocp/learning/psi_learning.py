"""A policy and the physical parameters of its model, learned side by side (abs, algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment, at_least, not_below
from ocp.learning.explorer import Buffer, Explorer
from ocp.learning.identify import OneStepLoss, search_iteration
from ocp.learning.protocol import Algorithm, Row, State, Trained, prefixed, under
from ocp.learning.random_search import Cloud, RandomSearch

_OWN, _CLOUD, _SEEN = "psi_learning.", "psi_cloud.", "psi_seen."


@dataclass(frozen=True, kw_only=True)
class PsiLearning(Algorithm):
    """Any ``algorithm``, on a model whose parameters ``names`` are learned as the policy is.

    In every iteration ``walkers`` episodes go ``steps`` steps on under the exact law at the task's
    own parameters, inputs being the policy's and noise of ``sigma`` half ranges; of the last
    ``capacity`` transitions ``rows`` judge each of ``searched`` iterations of the random search
    (eq. 4.1), passes after one another; and the algorithm does its own iteration at the psi found,
    the state's ``psi``. The search begins at the experiment's psi.

    ``env_steps`` counts those under the exact law, ``model_steps`` those of the algorithm.
    """

    name: ClassVar[str] = "psi"
    summary: ClassVar[str] = "any algorithm; it also learns the model's parameters"
    contact: ClassVar[str] = "adaptive"

    algorithm: Algorithm
    names: tuple[str, ...]
    walkers: Annotated[int, "episodes continued under the exact law in each iteration"] = 16
    steps: Annotated[int, "steps of each continued episode"] = 16
    sigma: Annotated[float, "noise on the inputs, in half ranges"] = 0.1
    capacity: Annotated[int, "transitions kept"] = 2000
    rows: Annotated[int, "transitions that judge an iteration of the search"] = 128
    searched: Annotated[int, "search iterations per policy iteration"] = 10
    search: RandomSearch = field(default_factory=RandomSearch)

    def settings(self) -> dict[str, Any]:
        """Its own, and the algorithm's."""
        own = {k: v for k, v in vars(self).items() if k not in ("algorithm", "search")}
        search, inner = prefixed("search.", vars(self.search)), self.algorithm.settings()
        return {**own, **search, "of": self.algorithm.name, **prefixed("of.", inner)}

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` for settings that cannot be."""
        self.algorithm.check(experiment)
        for name in ("walkers", "steps", "capacity", "rows", "searched"):
            at_least(1, name, getattr(self, name))
        not_below(0, "sigma", self.sigma)

    def begin(self, experiment: Experiment) -> State:
        """The algorithm's state, episodes at their starts, and no transitions yet."""
        self.check(experiment)
        loss, explorer = experiment.cached(self._loss), experiment.cached(_explorer)
        start = loss.start(experiment.task.parameters.unpack(experiment.physics))
        x, age = explorer.first(self.walkers, experiment.rng(0, "psi starts"))
        none = np.zeros((0, experiment.task.system.nx))
        seen = Buffer(none, np.zeros((0, experiment.task.system.nu)), none)
        return {
            **self.algorithm.begin(experiment),
            "psi": experiment.physics,
            _OWN + "x": x,
            _OWN + "age": age,
            _OWN + "start": start,
            _OWN + "pass": np.array(0),
            **prefixed(_CLOUD, self.search.begin(start)),
            **prefixed(_SEEN, vars(seen)),
        }

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Transitions, then psi, then the policy."""
        state = self._walked(experiment, state, k)
        walked = experiment.take_step_count()
        state, loss = self._searched(experiment, state)
        changed, row = self.algorithm.iterate(experiment, state, k)
        told = {"psi_loss": loss, "model_steps": experiment.take_step_count()}
        experiment.count_steps(walked)
        return {**state, **changed}, {**row, **told}

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The algorithm's."""
        return self.algorithm.policy(experiment, state)

    def _walked(self, experiment: Experiment, state: State, k: int) -> State:
        """The state after more transitions of the policy."""
        explorer, rng = experiment.cached(_explorer), experiment.rng(k, "psi transitions")
        policy = self.algorithm.policy(experiment, state)
        task = experiment.task
        x, age, seen = state[_OWN + "x"], state[_OWN + "age"], Buffer(**under(_SEEN, state))
        for _ in range(self.steps):
            u = experiment.inputs(policy, x)
            u += self.sigma * (task.upper - task.lower) / 2 * rng.standard_normal(u.shape)
            step = explorer.step(x, np.clip(u, task.lower, task.upper))
            seen = seen.with_newest(Buffer.solved(step.x, step.u, step.x_next), self.capacity)
            x, age = explorer.advance(step, age, rng)
        return {**state, **prefixed(_SEEN, vars(seen)), _OWN + "x": x, _OWN + "age": age}

    def _searched(self, experiment: Experiment, state: State) -> tuple[State, float]:
        """The state after the search went on, and the loss a transition at its psi."""
        seen = Buffer(**under(_SEEN, state))
        if not len(seen):
            raise InputError(f"{experiment.task.name}: no step of its episodes was solved")
        loss = experiment.cached(self._loss).in_scales_of(seen)
        cloud: Cloud = under(_CLOUD, state)
        number = int(state[_OWN + "pass"])
        for _ in range(self.searched):
            if self.search.done(cloud):
                if number + 1 >= self.search.passes:
                    break
                number += 1
                moves = loss.sensitivity(cloud["mean"], self.search.width, seen)
                cloud = self.search.begin(cloud["mean"], moves, state[_OWN + "start"])
            seeds = [experiment.seed, number]
            cloud = search_iteration(loss, seen, self.search, cloud, seeds, self.rows)
        psi = loss.parameters(cloud["mean"][None])[0, : len(experiment.physics)]
        found = {"psi": psi, _OWN + "pass": np.array(number), **prefixed(_CLOUD, cloud)}
        return {**state, **found}, float(loss(cloud["mean"], seen)[0]) / len(seen)

    def _loss(self, experiment: Experiment) -> OneStepLoss:
        """Loss of the model, at the experiment's psi but for the names."""
        values = experiment.task.parameters.unpack(experiment.physics)
        task = experiment.task
        step = EXACT.close(replace(task.system, parameters=task.parameters))
        return OneStepLoss(step, self.names, values, threads=experiment.threads)


def _explorer(experiment: Experiment) -> Explorer:
    return Explorer(experiment.task, count=experiment.count_steps, threads=experiment.threads)
