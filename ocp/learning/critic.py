"""Learned value function that estimates the remaining return after an unroll that ends before its episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.batch import BatchFunction, DensePolicy, Episodes, Gaussian, dense_policy
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Normaliser, Row, State, TrainedPolicy, first_weights, policy_vjp, renormalise_policy
from ocp.learning.total_propagation import with_jacobians
from ocp.learning.unrolling import adam_step


@dataclass(frozen=True, kw_only=True)
class Critic:
    """Value function ``V(x) = N(o(x)) / (1 - d)`` with discount d, an estimate of the return from state x.

    N is a network with two tanh layers of ``units`` units on normalised observations. Its output is 0 initially
    and has the magnitude of a single reward. After every iteration ``(V - y)²`` is reduced by ``steps`` steps
    of Adam with rate ``rate``, each on ``batch`` of the visited states (see :meth:`targets`). The critic's
    entries in an algorithm's state are named ``critic.*``. Methods take the whole state of the algorithm, which
    also contains the policy, the normaliser and, if they are learned, the parameters psi.
    """

    units: int
    rate: float = 3e-3
    steps: int = 16
    batch: int = 128

    def check(self, experiment: Experiment, unroll: int) -> None:
        """Raise :class:`~ocp.errors.InputError` if an ``unroll`` [steps] is a whole episode or the discount is 1."""
        if experiment.discount == 1:
            raise InputError(
                "a critic needs a discount below 1, got 1, where the return is unbounded;"
                " give a discount such as 0.99, or critic 0 for none"
            )
        if unroll >= experiment.task.horizon:
            raise InputError(
                f"a critic estimates the return after an unroll, but unrolls of {unroll} steps are"
                f" whole episodes of {experiment.task.name}; shorten them, or give critic 0 for"
                " none"
            )

    def begin(self, experiment: Experiment) -> State:
        """Return the initial state of a critic whose output is 0 everywhere."""
        sizes = self._network(experiment).sizes
        theta = first_weights(sizes, 0.0, experiment.rng(0, "critic weights"))
        zeros = np.zeros_like(theta)
        return dict(zip(CRITIC_ARRAYS, (theta, zeros, zeros, np.array(0)), strict=True))

    def value(self, experiment: Experiment, state: State, x: np.ndarray) -> np.ndarray:
        """Return the values V (n,) of states (n, nx)."""
        observations, _ = _normalised_observations(experiment, state, x)
        action = self._network(experiment).mean_actions(state[CRITIC_THETA], observations)
        return action[:, 0] / (1 - experiment.discount)

    def terminal_gradient(self, experiment: Experiment, state: State, episodes: Episodes) -> np.ndarray:
        """Return ``d^H a_H dV/dx(x_H)`` (n, nx), the gradient of the discounted return after H steps.

        The factor a_H is 0 if the episode has ended by then, else 1. The gradient is also zero for samples with
        non-finite states.
        """
        running, weight, x = _running_samples(episodes), _terminal_weights(episodes), episodes.states[:, -1]
        observations, observation_jacobian = _normalised_observations(experiment, state, x[running])
        seeds = np.full((len(observations), 1), 1 / (1 - experiment.discount))
        _, value_gradient = policy_vjp(self._network(experiment), state[CRITIC_THETA], observations, seeds)
        gradient = np.zeros_like(x)
        gradient[running] = weight[running, None] * np.einsum("no,nox->nx", value_gradient, observation_jacobian)
        return gradient

    def targets(self, experiment: Experiment, state: State, episodes: Episodes, noise: Gaussian) -> np.ndarray:
        """Return targets ``y_t = sum_{j=t}^{H-1} d^{j-t} r_j + d^{H-t} V(x_H)``, (n, H), NaN after the end.

        The rewards r_j are computed with the noisy inputs, up to the end of the episode. The term with V is
        added only if the episode has not ended after H steps.
        """
        states, alive, running = episodes.states, _live_steps(episodes), _running_samples(episodes)
        noise_samples = noise.draw(len(alive), alive.shape[1], experiment.task.system.nu)
        x, x_next = states[:, :-1][alive], states[:, 1:][alive]
        u = experiment.inputs(TrainedPolicy.from_state(state), x, noise_samples[alive])
        rewards, returns_to_go = np.zeros(alive.shape), np.zeros(len(alive))
        step_rewards = experiment.cached(_rewards)(x, u, x_next, _model_parameters(experiment, state))
        rewards[alive] = step_rewards[:, 0]
        returns_to_go[running] = self.value(experiment, state, states[running, -1])
        targets = np.empty(alive.shape)
        for t in reversed(range(alive.shape[1])):
            targets[:, t] = returns_to_go = rewards[:, t] + experiment.discount * returns_to_go
        return np.where(alive, targets, np.nan)

    def learn(
        self,
        experiment: Experiment,
        state: State,
        new_state: State,
        episodes: Episodes,
        noise: Gaussian,
        k: int,
    ) -> tuple[State, Row]:
        """Fit V to its targets in the states visited in iteration k; return the critic's new entries of the state.

        ``episodes`` were simulated from ``state``, which also gives the targets; the fitted V uses the
        normaliser of ``new_state``. The returned row contains ``critic_error``, the root mean square error of V
        before the fit.
        """
        targets = self.targets(experiment, state, episodes, noise)
        valid, network = np.isfinite(targets), self._network(experiment)
        scaled_targets = (1 - experiment.discount) * targets[valid]
        observations, _ = _normalised_observations(experiment, new_state, episodes.states[:, :-1][valid])
        theta, m, v, count = (state[name] for name in CRITIC_ARRAYS)
        theta = renormalise_policy(network, theta, Normaliser.from_state(state), Normaliser.from_state(new_state))
        errors, rng = network.mean_actions(theta, observations)[:, 0] - scaled_targets, experiment.rng(k, "critic")
        for _ in range(self.steps):
            rows = rng.integers(len(observations), size=self.batch)
            residual = network.mean_actions(theta, observations[rows]) - scaled_targets[rows, None]
            gradient = policy_vjp(network, theta, observations[rows], residual)[0].mean(axis=0)
            count = count + 1
            step, m, v = adam_step(gradient, m, v, int(count))
            theta = theta - self.rate * step
        error = np.sqrt((errors**2).mean()) / (1 - experiment.discount)
        entries: State = dict(zip(CRITIC_ARRAYS, (theta, m, v, np.array(count)), strict=True))
        return entries, {"critic_error": float(error)}

    def _network(self, experiment: Experiment) -> DensePolicy:
        return dense_policy(experiment.task.observe, (self.units, self.units), [-1.0], [1.0])


CRITIC_THETA = "critic.theta"
"""Name of the critic's network parameters in an algorithm's state."""
CRITIC_ARRAYS = (CRITIC_THETA, "critic.m", "critic.v", "critic.count")
"""Names of an algorithm's state entries for the critic: network parameters, Adam's moments m and v, and step count."""


def _terminal_weights(episodes: Episodes) -> np.ndarray:
    """Return ``d^H a_H`` (n,): the discount at the last state, or 0 if the episode has ended by then."""
    assert episodes.trail is not None
    return episodes.trail[:, -1, -2]


def _finite_samples(episodes: Episodes) -> np.ndarray:
    """Return a mask (n,) of the samples whose states are all finite."""
    return np.asarray(np.isfinite(episodes.states).all(axis=(1, 2)))


def _running_samples(episodes: Episodes) -> np.ndarray:
    """Return a mask (n,) of the samples whose states are all finite and whose episode has not ended."""
    return (_terminal_weights(episodes) > 0) & _finite_samples(episodes)


def _live_steps(episodes: Episodes) -> np.ndarray:
    """Return a mask (n, H) of the steps before the end of each episode, empty for samples with non-finite states."""
    steps = np.arange(episodes.states.shape[1] - 1)
    return (steps < episodes.lived[:, None]) & _finite_samples(episodes)[:, None]


def _model_parameters(experiment: Experiment, state: State) -> np.ndarray:
    return state.get("psi", experiment.physics)


def _normalised_observations(experiment: Experiment, state: State, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the normalised observations (n, n_o) in states x (n, nx), and their Jacobians (n, n_o, nx)."""
    normaliser = Normaliser.from_state(state)
    observations, jacobians = experiment.cached(_observe)(x, _model_parameters(experiment, state))
    columns = jacobians.reshape(*x.shape, observations.shape[1]).transpose(0, 2, 1)
    return (observations - normaliser.mean) / normaliser.scale, columns / normaliser.scale[:, None]


def _observe(experiment: Experiment) -> BatchFunction:
    return with_jacobians(experiment.task.observe, 1)


def _rewards(experiment: Experiment) -> BatchFunction:
    return BatchFunction(experiment.task.rewards, "numpy", 1)
