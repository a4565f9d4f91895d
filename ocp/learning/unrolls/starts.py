"""Where truncated unrolls start: from states of a buffer that is carried on by the unrolls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.learning.experiment import Experiment


@dataclass(frozen=True)
class Starts:
    """The buffer: states ``x`` (n, nx), and how many steps of its episode each has behind it.

    Every unroll carries its episode on from where the one before left it; an episode that has
    ended or is as long as the task's starts again. Unrolls as long as episodes start new ones.
    """

    x: np.ndarray
    age: np.ndarray

    @classmethod
    def first(cls, experiment: Experiment, n: int, unroll: int) -> Starts:
        """First states, counted as of all ages so that episodes do not end at once."""
        rng, horizon = experiment.rng(0, "starts"), experiment.task.horizon
        return cls(
            experiment.first_states(n, rng), unroll * rng.integers(-(-horizon // unroll), size=n)
        )

    def after(
        self, experiment: Experiment, states: np.ndarray, lived: np.ndarray, k: int
    ) -> Starts:
        """Carried on by unrolls through ``states`` (n, H+1, nx) of which ``lived`` (n,) counted."""
        n, unroll = len(states), states.shape[1] - 1
        x, age = states[np.arange(n), lived], self.age + lived
        again = (lived < unroll) | (age >= experiment.task.horizon) | ~np.isfinite(x).all(axis=1)
        fresh = experiment.first_states(n, experiment.rng(k, "starts again"))
        return Starts(np.where(again[:, None], fresh, x), np.where(again, 0, age))

    def arrays(self) -> dict[str, np.ndarray]:
        """As a checkpoint holds it."""
        return {"starts.x": self.x, "starts.age": self.age}

    @classmethod
    def of(cls, state: dict[str, np.ndarray]) -> Starts:
        """Out of a state that holds :meth:`arrays`."""
        return cls(state["starts.x"], state["starts.age"])
