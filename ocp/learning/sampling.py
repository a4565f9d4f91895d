"""Episodes of the policy that is being learned, their gradients, and what is kept of them."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from dynamics.batch import BatchWarning, Episodes, Gaussian
from dynamics.contact import ContactLaw
from ocp.errors import InputError, NotConverged
from ocp.learning.normaliser import Normaliser
from ocp.learning.protocol import Row, State, Trained
from ocp.learning.starts import Starts

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment


def begun(experiment: Experiment) -> State:
    """The policy to start from and its observations, none yet."""
    size = len(experiment.task.observations)
    return {"theta": experiment.first_theta(), **Normaliser.identity(size).arrays()}


def trained(state: State) -> Trained:
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
) -> Episodes:
    """Unrolls of ``horizon`` steps from ``x0`` (n, nx) under the policy of ``state``.

    ``theta`` (n, n_theta) are other parameters for each sample, ``law`` another contact law than
    the model's; states are kept. Samples that are not finite, where a contact found no solution or
    a motion overflowed, are left to :func:`finite`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        return experiment.rollouts(horizon, law)(
            x0,
            state["theta"] if theta is None else theta,
            Normaliser.of(state),
            discount=experiment.discount,
            psi=experiment.psi,
            noise=noise,
            n_samples=len(x0),
            gradient=gradient,
            score=score,
            states=True,
            along=along,
        )


def finite(experiment: Experiment, episodes: Episodes, k: int) -> np.ndarray:
    """Which samples (n,) count.

    Raises :class:`~ocp.errors.InputError` that names step and sample where states are finite and a
    reward is not, and :class:`~ocp.errors.NotConverged` where no sample is left.
    """
    good = np.isfinite(episodes.value)
    for part in (episodes.gradient, episodes.score):
        if part is not None:
            good &= np.isfinite(part).all(axis=1)
    for sample in np.flatnonzero(~np.isfinite(episodes.value)):
        states = episodes.states[sample]
        if np.isfinite(states).all():
            step = _step_without_reward(experiment, states)
            raise InputError(
                f"{experiment.task.name}: the reward of step {step} of sample {sample} in"
                f" iteration {k} is not a number, though its states are; mend the reward"
            )
    if not good.any():
        raise NotConverged(
            f"{experiment.task.name}: no sample of iteration {k} stayed finite; lower the learning"
            " rate, the noise or the unroll length"
        )
    return good


def _step_without_reward(experiment: Experiment, states: np.ndarray) -> int | str:
    """The first step whose reward is not finite without input, or the last, that of ``final``."""
    task, p = experiment.task, experiment.task.parameters.values
    for t, (x, after) in enumerate(zip(states[:-1], states[1:], strict=True)):
        if not np.isfinite(float(task.rewards(x, (task.lower + task.upper) / 2, after, p))):
            return t
    return len(states) - 1


def remembered(experiment: Experiment, state: State, episodes: Episodes, good: np.ndarray) -> State:
    """Entries of the state that change by what was seen: the normaliser's."""
    if not experiment.normalise:
        return {}
    steps = np.arange(episodes.states.shape[1] - 1)
    alive = good[:, None] & (steps < episodes.lived[:, None])
    seen = experiment.observations(episodes.states[:, :-1][alive])
    seen = seen[np.isfinite(seen).all(axis=1)]
    return Normaliser.of(state).after(seen).arrays()


def told(episodes: Episodes, good: np.ndarray) -> Row:
    """What every algorithm tells of its samples."""
    return {
        "return_mean": float(episodes.value[good].mean()),
        "env_steps": float(episodes.lived.sum()),
        "nonfinite": float((~good).sum()),
    }


def told_gradient(gradients: np.ndarray) -> Row:
    """Norm of the mean of ``gradients`` (n, n_theta), and the trace of their covariance."""
    row = {"gradient_norm": float(np.linalg.norm(gradients.mean(axis=0)))}
    if len(gradients) > 1:
        row["gradient_variance"] = float(gradients.var(axis=0, ddof=1).sum())
    return row


def next_starts(experiment: Experiment, state: State, episodes: Episodes, k: int) -> State:
    """The buffer's entries, carried on by the unrolls."""
    starts = Starts.of(state)
    return starts.after(experiment, episodes.states, episodes.lived.astype(int), k).arrays()
