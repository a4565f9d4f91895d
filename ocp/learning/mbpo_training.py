"""Iterations of model-based policy optimisation, as functions of a state that consists of arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from ocp.learning.explorer import BUFFER_ARRAYS, Buffer, Explorer, random_transitions
from ocp.learning.mbpo_networks import (
    Agent,
    Batch,
    Learner,
    Rates,
    begin_agent,
    begin_learner,
    make_trainer,
    make_updater,
    mean_action_parameters,
    member_errors,
    sample_actions_compiled,
    sample_next_states,
    select_elites,
    tree_arrays,
    tree_from_arrays,
)
from ocp.learning.protocol import Normaliser, Row, State, TrainedPolicy

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment
    from ocp.learning.mbpo import MBPO


ChooseInputs = Callable[[np.ndarray, int], np.ndarray]
"""Function from states (n, nx) and the step's number to inputs (n, nu)."""

PredictNext = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""Function from states (n, nx), inputs (n, nu) and the step's number to next states (n, nx)."""


def branch_rollouts(
    explorer: Explorer, starts: np.ndarray, length: int, choose: ChooseInputs, predict: PredictNext
) -> Buffer:
    """Return the transitions of model rollouts of ``length`` steps from each of ``starts`` (n, nx).

    A rollout stops at a state at which the task's episode ends, and before a non-finite state. Stopped rollouts are
    still computed but not recorded, so that array shapes do not change.
    """
    x, alive = starts, np.ones(len(starts), dtype=bool)
    buffers = []
    for step in range(length):
        u = choose(x, step)
        x_next = predict(x, u, step)
        alive = alive & np.isfinite(x_next).all(axis=1)
        buffers.append(Buffer(x[alive], u[alive], x_next[alive]))
        x = np.where(alive[:, None], x_next, starts)
        alive = alive & ~explorer.has_ended(x)
    return Buffer.concatenate(buffers)


def branch_length(k: int, first: int, last: int, grown_at: int) -> int:
    """Return the branch length in iteration ``k``, which grows linearly from ``first`` to ``last`` at ``grown_at``."""
    share = min(1.0, k / max(grown_at, 1))
    return round(first + share * (last - first))


MIN_INCREMENT_SCALE = 1e-3
"""Minimum scale of the increments ``x_next - x`` of a state entry, in its unit."""


class RunningEpisodes(NamedTuple):
    """Episodes in progress: states (n, nx), ages (n,) in steps, and returns so far (n,)."""

    x: np.ndarray
    age: np.ndarray
    returns: np.ndarray


class ObservationScales(NamedTuple):
    """Normaliser of observations and scales (nx,) of state increments, from the steps of random policies."""

    observation: Normaliser
    increment: np.ndarray


class MBPOTrainer:
    """Compiled functions of one experiment; everything that changes between iterations is in the ``state`` argument."""

    def __init__(self, settings: MBPO, experiment: Experiment) -> None:
        self.settings, self.experiment, task = settings, experiment, experiment.task
        self.explorer = Explorer(task, count=experiment.count_steps, threads=experiment.threads)
        self.n_o, self.nu = len(task.observations), task.system.nu
        assert experiment.hidden is not None
        self.first_learner = begin_learner(
            experiment.rng(0, "ensemble"),
            settings.members,
            self.n_o + self.nu,
            (settings.model_units,) * settings.model_layers,
            task.system.nx,
            settings.model_rate,
        )
        self.first_agent = begin_agent(
            experiment.rng(0, "agent"),
            (self.n_o, *experiment.hidden, self.nu),
            (settings.critic_units,) * settings.critic_layers,
            experiment.initial,
            settings.sigma,
            settings.alpha,
            settings.rate,
        )
        exploring_steps = experiment.iterations * settings.n_envs * settings.steps
        self.max_real_steps = min(settings.capacity, settings.random_steps + exploring_steps)
        self.train = make_trainer(settings.model_rate)
        self.update = make_updater(
            Rates(settings.rate, settings.critic_discount * experiment.discount, settings.tau, settings.target_entropy)
        )

    def initial_state(self) -> State:
        """Return the state before iteration 0, with the transitions of random policies."""
        settings = self.settings
        seeds = [self.experiment.seed, self.experiment.rng(0, "explored").integers(2**31)]
        explored, _ = random_transitions(self.explorer, settings.random_steps, seeds)
        normaliser = Normaliser.identity(self.n_o)
        if self.experiment.normalise:
            normaliser = normaliser.after(self.explorer.observations(explored.x))
        increments = np.maximum((explored.x_next - explored.x).std(axis=0), MIN_INCREMENT_SCALE)
        x, age = self.explorer.initial_states(settings.n_envs, self.experiment.rng(0, "starts"))
        no_steps = Buffer(explored.x[:0], explored.u[:0], explored.x[:0])
        return {
            **tree_arrays("learner", self.first_learner),
            **tree_arrays("agent", self.first_agent),
            **_buffer_arrays("real_steps", explored),
            **_buffer_arrays("model_steps", no_steps),
            **normaliser.arrays(),
            "increment_scale": increments,
            "branch_sizes": np.zeros(0, dtype=int),
            "return_mean": np.array(np.nan),
            "episodes.x": x,
            "episodes.age": age,
            "episodes.returns": np.zeros(len(x)),
        }

    def policy(self, state: State) -> TrainedPolicy:
        """Return the policy that applies the mean action of a state's actor."""
        agent: Agent = tree_from_arrays("agent", state, self.first_agent)
        return TrainedPolicy(mean_action_parameters(agent.networks.actor), Normaliser.from_state(state))

    def iterate(self, state: State, k: int) -> tuple[State, Row]:
        """Run iteration ``k``; return the new state and the iteration's row of metrics."""
        settings = self.settings
        learner: Learner = tree_from_arrays("learner", state, self.first_learner)
        agent: Agent = tree_from_arrays("agent", state, self.first_agent)
        scales = ObservationScales(Normaliser.from_state(state), state["increment_scale"])
        episodes = RunningEpisodes(*(state[f"episodes.{name}"] for name in RunningEpisodes._fields))
        episodes, new_steps, finished = self._continue_episodes(agent, scales, episodes, k)
        real_steps = _buffer_from("real_steps", state).with_newest(new_steps, settings.capacity)
        learner, errors = self._fit_model(learner, scales, real_steps, k)
        elites = select_elites(errors, settings.elites)
        length = branch_length(k, settings.min_branch, settings.max_branch, max(1, self.experiment.iterations // 2))
        branch_steps = self._branch_model(learner, elites, agent, scales, real_steps, length, k)
        branch_sizes = np.append(state["branch_sizes"], len(branch_steps))[-settings.branch_iterations :]
        model = _buffer_from("model_steps", state).with_newest(branch_steps, int(branch_sizes.sum()))
        agent, metrics = self._update_agent(agent, scales, real_steps, model, k)
        mean = np.array(np.mean(finished)) if finished else state["return_mean"]
        row = {
            "return_mean": float(mean),
            "model_error": float(errors[elites].mean()),
            "branch": float(length),
            **metrics,
        }
        return {
            **state,
            **tree_arrays("learner", learner),
            **tree_arrays("agent", agent),
            **_buffer_arrays("real_steps", real_steps),
            **_buffer_arrays("model_steps", model),
            "branch_sizes": branch_sizes,
            "return_mean": mean,
            **{f"episodes.{n}": v for n, v in episodes._asdict().items()},
        }, row

    def _continue_episodes(
        self, agent: Agent, scales: ObservationScales, episodes: RunningEpisodes, k: int
    ) -> tuple[RunningEpisodes, Buffer, list[float]]:
        """Continue the episodes; return the new episodes, the transitions, and the returns of finished episodes."""
        rng, buffers, finished = self.experiment.rng(k, "actions"), [], []
        for _ in range(self.settings.steps):
            u = self._inputs(agent, scales, rng, episodes.x)
            step = self.explorer.step(episodes.x, u)
            returns = episodes.returns + np.where(step.solved, step.reward, 0.0)
            x, age = self.explorer.advance(step, episodes.age, rng)
            finished += returns[age == 0].tolist()
            episodes = RunningEpisodes(x, age, np.where(age == 0, 0.0, returns))
            buffers.append(Buffer.from_solved_steps(step.x, step.u, step.x_next))
        return episodes, Buffer.concatenate(buffers), finished

    def _inputs(self, agent: Agent, scales: ObservationScales, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        """Return inputs (n, nu) sampled from the policy in states ``x`` (n, nx)."""
        o = self._normalised_observations(scales, x)
        t, _ = sample_actions_compiled(agent.networks.actor, o, rng.standard_normal((len(x), self.nu)).astype("f4"))
        task = self.experiment.task
        return task.mid_range + task.half_range * np.asarray(t, dtype=float)

    def _normalised_observations(self, scales: ObservationScales, x: np.ndarray) -> np.ndarray:
        observations = (self.explorer.observations(x) - scales.observation.mean) / scales.observation.scale
        return observations.astype(np.float32)

    def _tanh_actions(self, u: np.ndarray) -> np.ndarray:
        task = self.experiment.task
        return ((u - task.mid_range) / task.half_range).astype(np.float32)

    def _fit_model(
        self, learner: Learner, scales: ObservationScales, real_steps: Buffer, k: int
    ) -> tuple[Learner, np.ndarray]:
        """Train the ensemble; return the learner and each member's mean squared error (members,) on held-out steps."""
        settings, rng = self.settings, self.experiment.rng(k, "model")
        z = np.hstack([self._normalised_observations(scales, real_steps.x), self._tanh_actions(real_steps.u)])
        y = ((real_steps.x_next - real_steps.x) / scales.increment).astype(np.float32)
        order = rng.permutation(len(z))
        held_out, training_rows = np.split(order, [max(1, int(settings.held_out * len(z)))])
        rows = training_rows[
            rng.integers(len(training_rows), size=(settings.model_steps, settings.members, settings.model_batch))
        ]
        is_held_out = np.zeros(self.max_real_steps, dtype=bool)
        is_held_out[held_out] = True
        z, y = (_pad_rows(array, self.max_real_steps) for array in (z, y))
        learner, _ = self.train(learner, z, y, rows.astype(np.int32))
        return learner, np.asarray(member_errors(learner.ensemble, z, y, is_held_out))

    def _branch_model(
        self,
        learner: Learner,
        elites: np.ndarray,
        agent: Agent,
        scales: ObservationScales,
        real_steps: Buffer,
        length: int,
        k: int,
    ) -> Buffer:
        """Return the transitions of the ensemble's rollouts from real states; a random elite computes each step."""
        settings, rng = self.settings, self.experiment.rng(k, "branches")
        starts = real_steps.x[rng.integers(len(real_steps), size=settings.branches)]

        def predict(x: np.ndarray, u: np.ndarray, step: int) -> np.ndarray:
            z = np.hstack([self._normalised_observations(scales, x), self._tanh_actions(u)])
            member = elites[rng.integers(len(elites), size=len(x))]
            noise = rng.standard_normal(x.shape).astype(np.float32)
            increments = sample_next_states(learner.ensemble, member, z, noise)
            return x + scales.increment * np.asarray(increments, dtype=float)

        def choose(x: np.ndarray, step: int) -> np.ndarray:
            return self._inputs(agent, scales, rng, x)

        return branch_rollouts(self.explorer, starts, length, choose, predict)

    def _update_agent(
        self, agent: Agent, scales: ObservationScales, real_steps: Buffer, model: Buffer, k: int
    ) -> tuple[Agent, Row]:
        """Update actor, critics and temperature on batches of real and model transitions; return agent and metrics."""
        settings, rng = self.settings, self.experiment.rng(k, "updates")
        n_real = round(settings.real_ratio * settings.batch) if len(model) else settings.batch
        max_model_steps = settings.branches * settings.max_branch * settings.branch_iterations
        batches = [
            self._batch(scales, buffer, size)
            for buffer, size in ((real_steps, self.max_real_steps), (model, max_model_steps))
        ]
        first = len(batches[0].reward)
        data = Batch(*(np.concatenate(columns) for columns in zip(*batches, strict=True)))
        rows = np.hstack(
            [
                rng.integers(len(real_steps), size=(settings.updates, n_real)),
                first + rng.integers(max(len(model), 1), size=(settings.updates, settings.batch - n_real)),
            ]
        ).astype(np.int32)
        key = jax.random.key(int(rng.integers(2**31)))
        agent, metrics = self.update(agent, data, rows, key)
        row = {name: float(np.mean(values)) for name, values in metrics.items()}
        return agent, {**row, "alpha": float(np.exp(agent.networks.log_alpha))}

    def _batch(self, scales: ObservationScales, buffer: Buffer, size: int) -> Batch:
        """Return a buffer's transitions as a batch for the actor-critic, padded to ``size`` rows."""
        explorer, observations = self.explorer, partial(self._normalised_observations, scales)
        rewards = explorer.rewards(buffer.x, buffer.u, buffer.x_next)
        columns = Batch(
            observations(buffer.x),
            self._tanh_actions(buffer.u),
            np.clip(rewards, -self.settings.reward_clip, self.settings.reward_clip),
            explorer.has_ended(buffer.x_next),
            observations(buffer.x_next),
        )
        return Batch(*(_pad_rows(np.asarray(column, np.float32), size) for column in columns))


def _pad_rows(rows: np.ndarray, size: int) -> np.ndarray:
    """Return ``rows`` padded with zeros to ``size`` rows, so that compiled functions always get the same shape."""
    return np.concatenate([rows, np.zeros((size - len(rows), *rows.shape[1:]), rows.dtype)])


def _buffer_arrays(prefix: str, buffer: Buffer) -> State:
    return {f"{prefix}.{name}": getattr(buffer, name) for name in BUFFER_ARRAYS}


def _buffer_from(prefix: str, state: State) -> Buffer:
    return Buffer(*(state[f"{prefix}.{name}"] for name in BUFFER_ARRAYS))
