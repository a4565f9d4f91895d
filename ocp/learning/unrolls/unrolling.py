"""Episodes of the policy that is being learned, their gradients, and what is kept of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from dynamics.batch import Episodes, Gaussian
from dynamics.contact import ContactLaw
from ocp.errors import InputError, NotConverged
from ocp.learning.experiment import Experiment
from ocp.learning.network import Normaliser, renormalised
from ocp.learning.protocol import Row, State, Trained

if TYPE_CHECKING:
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


def initial_state(experiment: Experiment) -> State:
    """The policy to start from and its observations, none yet if it comes out of the seed."""
    return {"theta": experiment.first_theta(), **experiment.first_normaliser().arrays()}


def policy_of(state: State) -> Trained:
    """The policy of a state."""
    return Trained(state["theta"], Normaliser.of(state))


def roll(
    experiment: Experiment,
    state: State,
    x0: np.ndarray,
    horizon: int,
    *,
    theta: np.ndarray | None = None,
    law: ContactLaw | None = None,
    noise: Gaussian | None = None,
    gradient: bool = False,
    score: bool = False,
    along: Episodes | None = None,
    pull: np.ndarray | None = None,
) -> Episodes:
    """Unrolls of ``horizon`` steps from ``x0`` (n, nx) under the policy of ``state``.

    ``theta`` (n, n_theta) are other parameters for each sample, ``law`` another contact law than
    the model's; physical parameters are the state's ``psi`` where it has any; states are kept.
    ``pull`` (n, nx) is the slope of what else is gained at the last state, for the gradient.
    Samples that are not finite, where a contact found no solution or a motion overflowed, are left
    to :func:`finite_samples`.
    """
    found = experiment.rollouts(horizon, law)(
        x0,
        state["theta"] if theta is None else theta,
        Normaliser.of(state),
        discount=experiment.discount,
        model_params=state.get("psi", experiment.physics),
        noise=noise,
        n_samples=len(x0),
        gradient=gradient,
        score=score,
        states=True,
        along=along,
        pull=pull,
    )
    experiment.count_steps(found.lived.sum())
    return found


def finite_samples(experiment: Experiment, state: State, episodes: Episodes, k: int) -> np.ndarray:
    """Which samples (n,) count.

    Raises :class:`~ocp.errors.InputError` that names step and sample where states are finite and a
    reward is not, and :class:`~ocp.errors.NotConverged` where no sample is left.
    """
    good = np.isfinite(episodes.value)
    for part in (episodes.gradient, episodes.score):
        if part is not None:
            good &= np.isfinite(part).all(axis=1)
    for sample in np.flatnonzero(~np.isfinite(episodes.value)):
        check_rewards(experiment, policy_of(state), episodes.states[sample], int(sample), k)
    if not good.any():
        raise NotConverged(
            f"{experiment.task.name}: no sample of iteration {k} stayed finite; lower the learning"
            " rate, the noise or the unroll length"
        )
    return good


def check_rewards(
    experiment: Experiment, policy: Trained, states: np.ndarray, sample: int, k: int
) -> None:
    """Raise :class:`~ocp.errors.InputError` where all ``states`` (H+1, nx) are finite: why else?

    The step is the first whose reward is not finite under the inputs without noise, and the last,
    where ``final`` counts, if there is none.
    """
    if not np.isfinite(states).all():
        return
    task, inputs = experiment.task, experiment.inputs(policy, states[:-1])
    step = len(states) - 1
    for t, (x, after) in enumerate(pairwise(states)):
        if not np.isfinite(float(task.rewards(x, inputs[t], after, experiment.physics))):
            step = t
            break
    raise InputError(non_finite_reward(experiment, step, f"sample {sample} in iteration {k}"))


def non_finite_reward(experiment: Experiment, step: int, where: str) -> str:
    """That a reward is not a number, and where."""
    return (
        f"{experiment.task.name}: the reward of step {step} of {where} is NaN or infinite at"
        " finite states; correct the reward or end the episode earlier"
    )


def normalised_state(
    experiment: Experiment, state: State, episodes: Episodes, good: np.ndarray
) -> State:
    """The state with what was seen in its normaliser, and the policy as it was."""
    steps = np.arange(episodes.states.shape[1] - 1)
    alive = good[:, None] & (steps < episodes.lived[:, None])
    seen = experiment.observations(episodes.states[:, :-1][alive])
    return with_observations(experiment, state, seen[np.isfinite(seen).all(axis=1)])


def with_observations(experiment: Experiment, state: State, seen: np.ndarray) -> State:
    """The state with observations (n, n_o) in its normaliser, and the policy as it was."""
    if not experiment.normalise:
        return state
    before = Normaliser.of(state)
    after = before.after(seen)
    theta = renormalised(experiment.policy, state["theta"], before, after)
    return {**state, **after.arrays(), "theta": theta}


def sample_row(episodes: Episodes, good: np.ndarray) -> Row:
    """What every algorithm tells of its samples."""
    return {
        "return_mean": float(episodes.value[good].mean()),
        "nonfinite": float((~good).sum()),
    }


def gradient_row(gradients: np.ndarray) -> Row:
    """Norm of the mean of ``gradients`` (n, n_theta), and the trace of their covariance."""
    row = {"gradient_norm": float(np.linalg.norm(gradients.mean(axis=0)))}
    if len(gradients) > 1:
        row["gradient_variance"] = float(gradients.var(axis=0, ddof=1).sum())
    return row


def next_starts(experiment: Experiment, state: State, episodes: Episodes, k: int) -> State:
    """The buffer's entries, carried on by the unrolls."""
    starts = Starts.of(state)
    return starts.after(experiment, episodes.states, episodes.lived.astype(int), k).arrays()
