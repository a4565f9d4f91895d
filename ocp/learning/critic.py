"""What states are worth where an unroll ends before its episode, learned from the unrolls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.batch import BatchFunction, DensePolicy, Episodes, Gaussian, dense
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Normaliser, Row, State, Trained, first_weights, renormalised, vjp
from ocp.learning.total_propagation import with_jacobians
from ocp.learning.unrolling import adam_step


@dataclass(frozen=True, kw_only=True)
class Critic:
    """``V(x) = N(o(x)) / (1 - d)``, d the discount: the return that is to come, without a limit.

    N is a network of two tanh layers of ``units`` on normalised observations; it starts at 0 and
    has the size of one reward. After every iteration ``steps`` steps of Adam at ``rate``, each on
    ``batch`` of the states that were visited, lessen ``(V - y)²`` (see :meth:`targets`).

    Its part of an algorithm's state is named ``critic.*``. Methods take the algorithm's state, in
    which it, the policy, the normaliser and, where they are learned, the parameters psi are.
    """

    units: int
    rate: float = 3e-3
    steps: int = 16
    batch: int = 128

    def check(self, experiment: Experiment, unroll: int) -> None:
        """Raise :class:`~ocp.errors.InputError` where nothing is to come, or no end of it."""
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
        """The network to start from, which gives 0 everywhere."""
        sizes = self._network(experiment).sizes
        theta = first_weights(sizes, 0.0, experiment.rng(0, "critic weights"))
        none = np.zeros_like(theta)
        return dict(zip(_NAMES, (theta, none, none, np.array(0)), strict=True))

    def value(self, experiment: Experiment, state: State, x: np.ndarray) -> np.ndarray:
        """V (n,) in states (n, nx)."""
        seen, _ = _seen(experiment, state, x)
        action = self._network(experiment).means(state[_THETA], seen)
        return action[:, 0] / (1 - experiment.discount)

    def pull(self, experiment: Experiment, state: State, episodes: Episodes) -> np.ndarray:
        """``d^H a_H dV/dx(x_H)`` (n, nx), the slope of what is to come after H steps.

        Zero where an episode has ended (a_H = 0) or was lost.
        """
        on, weight, x = _going_on(episodes), _weight(episodes), episodes.states[:, -1]
        seen, by_x = _seen(experiment, state, x[on])
        one = np.full((len(seen), 1), 1 / (1 - experiment.discount))
        _, by_o = vjp(self._network(experiment), state[_THETA], seen, one)
        slope = np.zeros_like(x)
        slope[on] = weight[on, None] * np.einsum("no,nox->nx", by_o, by_x)
        return slope

    def targets(self, experiment: Experiment, state: State, episodes: Episodes, noise: Gaussian) -> np.ndarray:
        """``y_t = sum_{j=t}^{H-1} d^{j-t} r_j + d^{H-t} V(x_H)``, (n, H), NaN where nobody is.

        Rewards are of the steps before an episode's end, under inputs with their noise, and V
        counts where the episode goes on at H.
        """
        states, on, ahead = episodes.states, _alive(episodes), _going_on(episodes)
        drawn = noise.draw(len(on), on.shape[1], experiment.task.system.nu)
        x, x_next = states[:, :-1][on], states[:, 1:][on]
        u = experiment.inputs(Trained.of(state), x, drawn[on])
        rewards, togo = np.zeros(on.shape), np.zeros(len(on))
        found = experiment.cached(_rewards)(x, u, x_next, _psi(experiment, state))
        rewards[on] = found[:, 0]
        togo[ahead] = self.value(experiment, state, states[ahead, -1])
        targets = np.empty(on.shape)
        for t in reversed(range(on.shape[1])):
            targets[:, t] = togo = rewards[:, t] + experiment.discount * togo
        return np.where(on, targets, np.nan)

    def learned(
        self,
        experiment: Experiment,
        state: State,
        after: State,
        episodes: Episodes,
        noise: Gaussian,
        k: int,
    ) -> tuple[State, Row]:
        """Entries of the state with V nearer to its targets in what iteration k visited.

        ``episodes`` and their targets are those of ``state``, V is as ``after`` normalises. Tells
        how far V was off before, as the root mean square ``critic_error``.
        """
        goals = self.targets(experiment, state, episodes, noise)
        on, network = np.isfinite(goals), self._network(experiment)
        wanted = (1 - experiment.discount) * goals[on]
        seen, _ = _seen(experiment, after, episodes.states[:, :-1][on])
        theta, m, v, count = (state[name] for name in _NAMES)
        theta = renormalised(network, theta, Normaliser.of(state), Normaliser.of(after))
        off, rng = network.means(theta, seen)[:, 0] - wanted, experiment.rng(k, "critic")
        for _ in range(self.steps):
            rows = rng.integers(len(seen), size=self.batch)
            miss = network.means(theta, seen[rows]) - wanted[rows, None]
            slope = vjp(network, theta, seen[rows], miss)[0].mean(axis=0)
            count = count + 1
            step, m, v = adam_step(slope, m, v, int(count))
            theta = theta - self.rate * step
        error = np.sqrt((off**2).mean()) / (1 - experiment.discount)
        entries: State = dict(zip(_NAMES, (theta, m, v, np.array(count)), strict=True))
        return entries, {"critic_error": float(error)}

    def _network(self, experiment: Experiment) -> DensePolicy:
        return dense(experiment.task.observe, (self.units, self.units), [-1.0], [1.0])


_THETA = "critic.theta"
_NAMES = (_THETA, "critic.m", "critic.v", "critic.count")


def _weight(episodes: Episodes) -> np.ndarray:
    """``d^H a_H`` (n,), 0 where an episode has ended at its last state or before."""
    assert episodes.trail is not None
    return episodes.trail[:, -1, -2]


def _kept(episodes: Episodes) -> np.ndarray:
    """Which samples (n,) stayed finite."""
    return np.asarray(np.isfinite(episodes.states).all(axis=(1, 2)))


def _going_on(episodes: Episodes) -> np.ndarray:
    """Which samples (n,) have neither ended nor been lost."""
    return (_weight(episodes) > 0) & _kept(episodes)


def _alive(episodes: Episodes) -> np.ndarray:
    """Whose steps (n, H) count: before the end, of samples that stayed finite."""
    steps = np.arange(episodes.states.shape[1] - 1)
    return (steps < episodes.lived[:, None]) & _kept(episodes)[:, None]


def _psi(experiment: Experiment, state: State) -> np.ndarray:
    return state.get("psi", experiment.physics)


def _seen(experiment: Experiment, state: State, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normalised observations (n, n_o) in states x (n, nx), and their slopes (n, n_o, nx)."""
    normaliser = Normaliser.of(state)
    seen, by_x = experiment.cached(_observe)(x, _psi(experiment, state))
    columns = by_x.reshape(*x.shape, seen.shape[1]).transpose(0, 2, 1)
    return (seen - normaliser.mean) / normaliser.scale, columns / normaliser.scale[:, None]


def _observe(experiment: Experiment) -> BatchFunction:
    return with_jacobians(experiment.task.observe, 1)


def _rewards(experiment: Experiment) -> BatchFunction:
    return BatchFunction(experiment.task.rewards, "numpy", 1)
