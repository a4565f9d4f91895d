"""The loop of model-based policy optimisation, its state being arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from ocp.learning.explorer import COLUMNS, Buffer, Explorer, random_transitions
from ocp.learning.mbpo_networks import (
    Agent,
    Batch,
    Learner,
    Rates,
    act,
    arrays,
    begin_agent,
    begin_learner,
    drawn_next,
    elites_of,
    member_errors,
    theta_of,
    trainer,
    tree_of,
    updater,
)
from ocp.learning.protocol import Normaliser, Row, State, Trained

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment
    from ocp.learning.mbpo import MBPO


ChooseInputs = Callable[[np.ndarray, int], np.ndarray]
"""Maps states (n, nx) and the step's number to inputs (n, nu)."""

PredictNext = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""Maps states (n, nx), inputs (n, nu) and the step's number to next states (n, nx)."""


def branch_rollouts(
    explorer: Explorer, starts: np.ndarray, length: int, choose: ChooseInputs, predict: PredictNext
) -> Buffer:
    """Transitions of the model: ``length`` steps from each of ``starts`` (n, nx), step after step.

    A branch stops at a state where the task ends, and before one that is not finite. All branches
    are computed at every step, whichever have stopped, so that shapes do not change.
    """
    x, alive = starts, np.ones(len(starts), dtype=bool)
    parts = []
    for step in range(length):
        u = choose(x, step)
        x_next = predict(x, u, step)
        alive = alive & np.isfinite(x_next).all(axis=1)
        parts.append(Buffer(x[alive], u[alive], x_next[alive]))
        x = np.where(alive[:, None], x_next, starts)
        alive = alive & ~explorer.ended(x)
    return Buffer.joined(parts)


def branch_length(k: int, first: int, last: int, grown_at: int) -> int:
    """Steps of a branch in iteration ``k``: from ``first`` linearly to ``last`` at ``grown_at``."""
    share = min(1.0, k / max(grown_at, 1))
    return round(first + share * (last - first))


LEAST_SCALE = 1e-3
"""Of increments of states, below which a coordinate is not blown up to unit size."""


class Walk(NamedTuple):
    """Episodes under way: states (n, nx), ages (n,), rewards so far (n,)."""

    x: np.ndarray
    age: np.ndarray
    gained: np.ndarray


class ObservationScales(NamedTuple):
    """Scales of observations, and of increments of states, from the explored steps."""

    seen: Normaliser
    moved: np.ndarray


class MBPOTrainer:
    """One experiment's compiled functions; all that changes is in the state."""

    def __init__(self, settings: MBPO, experiment: Experiment) -> None:
        self.own, self.experiment, task = settings, experiment, experiment.task
        self.explorer = Explorer(task, count=experiment.count_steps, threads=experiment.threads)
        self.n_o, self.nu = len(task.observations), task.system.nu
        own = settings
        assert experiment.hidden is not None
        self.first_learner = begin_learner(
            experiment.rng(0, "ensemble"),
            own.members,
            self.n_o + self.nu,
            (own.model_units,) * own.model_layers,
            task.system.nx,
            own.model_rate,
        )
        self.first_agent = begin_agent(
            experiment.rng(0, "agent"),
            self.n_o,
            experiment.hidden,
            self.nu,
            (own.critic_units,) * own.critic_layers,
            experiment.initial,
            own.sigma,
            own.alpha,
            own.rate,
        )
        walked = experiment.iterations * own.walkers * own.steps
        self.most_seen = min(own.capacity, own.explored + walked)
        self.train = trainer(own.model_rate)
        self.update = updater(Rates(own.rate, own.critic_discount * experiment.discount, own.slow, own.aim))

    def initial_state(self) -> State:
        """The state before iteration 0."""
        own = self.own
        seeds = [self.experiment.seed, self.experiment.rng(0, "explored").integers(2**31)]
        seen, _ = random_transitions(self.explorer, own.explored, seeds)
        normaliser = Normaliser.identity(self.n_o)
        if self.experiment.normalise:
            normaliser = normaliser.after(self.explorer.observations(seen.x))
        moved = np.maximum((seen.x_next - seen.x).std(axis=0), LEAST_SCALE)
        x, age = self.explorer.first(own.walkers, self.experiment.rng(0, "starts"))
        none = Buffer(seen.x[:0], seen.u[:0], seen.x[:0])
        return {
            **arrays("learner", self.first_learner),
            **arrays("agent", self.first_agent),
            **_kept("seen", seen),
            **_kept("model", none),
            **normaliser.arrays(),
            "moved": moved,
            "branched": np.zeros(0, dtype=int),
            "return_mean": np.array(np.nan),
            "walk.x": x,
            "walk.age": age,
            "walk.gained": np.zeros(len(x)),
        }

    def policy(self, state: State) -> Trained:
        """The policy of a state."""
        agent: Agent = tree_of("agent", state, self.first_agent)
        return Trained(theta_of(agent.networks.actor), Normaliser.of(state))

    def iterate(self, state: State, k: int) -> tuple[State, Row]:
        """One iteration."""
        own = self.own
        learner: Learner = tree_of("learner", state, self.first_learner)
        agent: Agent = tree_of("agent", state, self.first_agent)
        scales = ObservationScales(Normaliser.of(state), state["moved"])
        walk = Walk(*(state[f"walk.{name}"] for name in Walk._fields))
        walk, more, finished = self._walked(agent, scales, walk, k)
        seen = _of("seen", state).with_newest(more, own.capacity)
        learner, errors = self._fitted(learner, scales, seen, k)
        elites = elites_of(errors, own.elites)
        length = branch_length(k, own.shortest, own.longest, max(1, self.experiment.iterations // 2))
        new = self._branched(learner, elites, agent, scales, seen, length, k)
        sizes = np.append(state["branched"], len(new))[-own.kept :]
        model = _of("model", state).with_newest(new, int(sizes.sum()))
        agent, told = self._improved(agent, scales, seen, model, k)
        mean = np.array(np.mean(finished)) if finished else state["return_mean"]
        row = {
            "return_mean": float(mean),
            "model_error": float(errors[elites].mean()),
            "branch": float(length),
            **told,
        }
        return {
            **state,
            **arrays("learner", learner),
            **arrays("agent", agent),
            **_kept("seen", seen),
            **_kept("model", model),
            "branched": sizes,
            "return_mean": mean,
            **{f"walk.{n}": v for n, v in walk._asdict().items()},
        }, row

    def _walked(self, agent: Agent, scales: ObservationScales, walk: Walk, k: int) -> tuple[Walk, Buffer, list[float]]:
        """Episodes carried on, their transitions, and the returns of those that finished."""
        rng, parts, finished = self.experiment.rng(k, "actions"), [], []
        for _ in range(self.own.steps):
            u = self._inputs(agent, scales, rng, walk.x)
            step = self.explorer.step(walk.x, u)
            gained = walk.gained + np.where(step.solved, step.reward, 0.0)
            x, age = self.explorer.advance(step, walk.age, rng)
            finished += gained[age == 0].tolist()
            walk = Walk(x, age, np.where(age == 0, 0.0, gained))
            parts.append(Buffer.solved(step.x, step.u, step.x_next))
        return walk, Buffer.joined(parts), finished

    def _inputs(self, agent: Agent, scales: ObservationScales, rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        """Inputs (n, nu) of the policy with its noise."""
        o = self._normalised(scales, x)
        t, _ = act(agent.networks.actor, o, rng.standard_normal((len(x), self.nu)).astype("f4"))
        task = self.experiment.task
        half = (task.upper - task.lower) / 2
        return (task.upper + task.lower) / 2 + half * np.asarray(t, dtype=float)

    def _normalised(self, scales: ObservationScales, x: np.ndarray) -> np.ndarray:
        found = (self.explorer.observations(x) - scales.seen.mean) / scales.seen.scale
        return found.astype(np.float32)

    def _tanh(self, u: np.ndarray) -> np.ndarray:
        task = self.experiment.task
        middle, half = (task.upper + task.lower) / 2, (task.upper - task.lower) / 2
        return ((u - middle) / half).astype(np.float32)

    def _fitted(self, learner: Learner, scales: ObservationScales, seen: Buffer, k: int) -> tuple[Learner, np.ndarray]:
        """The ensemble after more steps, and its members' errors on rows held out."""
        own, rng = self.own, self.experiment.rng(k, "model")
        z = np.hstack([self._normalised(scales, seen.x), self._tanh(seen.u)])
        y = ((seen.x_next - seen.x) / scales.moved).astype(np.float32)
        order = rng.permutation(len(z))
        held, rest = np.split(order, [max(1, int(own.held_out * len(z)))])
        rows = rest[rng.integers(len(rest), size=(own.model_steps, own.members, own.model_batch))]
        known = np.zeros(self.most_seen, dtype=bool)
        known[held] = True
        z, y = (_padded(rows_of, self.most_seen) for rows_of in (z, y))
        learner, _ = self.train(learner, z, y, rows.astype(np.int32))
        return learner, np.asarray(member_errors(learner.ensemble, z, y, known))

    def _branched(
        self,
        learner: Learner,
        elites: np.ndarray,
        agent: Agent,
        scales: ObservationScales,
        seen: Buffer,
        length: int,
        k: int,
    ) -> Buffer:
        """Branches of the ensemble from states seen, each step by an elite drawn for each row."""
        own, rng = self.own, self.experiment.rng(k, "branches")
        starts = seen.x[rng.integers(len(seen), size=own.branches)]

        def predict(x: np.ndarray, u: np.ndarray, step: int) -> np.ndarray:
            z = np.hstack([self._normalised(scales, x), self._tanh(u)])
            member = elites[rng.integers(len(elites), size=len(x))]
            noise = rng.standard_normal(x.shape).astype(np.float32)
            moved = drawn_next(learner.ensemble, member, z, noise)
            return x + scales.moved * np.asarray(moved, dtype=float)

        def choose(x: np.ndarray, step: int) -> np.ndarray:
            return self._inputs(agent, scales, rng, x)

        return branch_rollouts(self.explorer, starts, length, choose, predict)

    def _improved(
        self, agent: Agent, scales: ObservationScales, seen: Buffer, model: Buffer, k: int
    ) -> tuple[Agent, Row]:
        """The actor-critic after updates on steps seen and of the model."""
        own, rng = self.own, self.experiment.rng(k, "updates")
        real = round(own.real * own.batch) if len(model) else own.batch
        most = own.branches * own.longest * own.kept
        parts = [self._batch(scales, buffer, size) for buffer, size in ((seen, self.most_seen), (model, most))]
        first = len(parts[0].reward)
        data = Batch(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        rows = np.hstack(
            [
                rng.integers(len(seen), size=(own.updates, real)),
                first + rng.integers(max(len(model), 1), size=(own.updates, own.batch - real)),
            ]
        ).astype(np.int32)
        key = jax.random.key(int(rng.integers(2**31)))
        agent, told = self.update(agent, data, rows, key)
        row = {name: float(np.mean(values)) for name, values in told.items()}
        return agent, {**row, "alpha": float(np.exp(agent.networks.log_alpha))}

    def _batch(self, scales: ObservationScales, buffer: Buffer, size: int) -> Batch:
        """All of a buffer as the actor-critic reads it, filled up to ``size`` rows."""
        explorer, normalised = self.explorer, partial(self._normalised, scales)
        rewards = explorer.rewards(buffer.x, buffer.u, buffer.x_next)
        columns = Batch(
            normalised(buffer.x),
            self._tanh(buffer.u),
            np.clip(rewards, -self.own.cut, self.own.cut),
            explorer.ended(buffer.x_next),
            normalised(buffer.x_next),
        )
        return Batch(*(_padded(np.asarray(column, np.float32), size) for column in columns))


def _padded(rows: np.ndarray, size: int) -> np.ndarray:
    """``rows`` and zeros, ``size`` of both: compiled loops should see one shape."""
    return np.concatenate([rows, np.zeros((size - len(rows), *rows.shape[1:]), rows.dtype)])


def _kept(prefix: str, buffer: Buffer) -> State:
    return {f"{prefix}.{name}": getattr(buffer, name) for name in COLUMNS}


def _of(prefix: str, state: State) -> Buffer:
    return Buffer(*(state[f"{prefix}.{name}"] for name in COLUMNS))
