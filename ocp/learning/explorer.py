"""Simulator of many episodes of a task at once, and collection of transitions under random policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, StepFunction
from dynamics.contact import Exact
from dynamics.settings import read_count
from ocp.errors import InputError
from ocp.problem.task import Task

BUFFER_ARRAYS = ("x", "u", "x_next")
"""Names of the arrays of a buffer of transitions."""


@dataclass(frozen=True, eq=False)
class Buffer:
    """Buffer of n transitions: states ``x`` (n, nx), inputs ``u`` (n, nu), and next states ``x_next`` (n, nx).

    Raises :class:`~ocp.errors.InputError` if the shapes disagree or a value is not finite.
    """

    x: np.ndarray
    u: np.ndarray
    x_next: np.ndarray

    def __post_init__(self) -> None:
        if self.x.ndim != 2 or self.u.ndim != 2 or self.x.shape != self.x_next.shape:
            raise InputError(
                f"transitions: x has shape {self.x.shape}, u {self.u.shape}, x_next"
                f" {self.x_next.shape}; expected (n, nx), (n, nu), (n, nx)"
            )
        if len(self.u) != len(self.x):
            raise InputError(f"transitions: {len(self.x)} states and {len(self.u)} inputs; pair them")
        rows = np.hstack([self.x, self.u, self.x_next])
        if n_nonfinite := int(np.count_nonzero(~np.isfinite(rows).all(axis=1))):
            raise InputError(f"transitions: {n_nonfinite} of {len(rows)} are not finite; leave them out")

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, rows: np.ndarray | slice) -> Buffer:
        return Buffer(self.x[rows], self.u[rows], self.x_next[rows])

    def with_newest(self, more: Buffer, capacity: int) -> Buffer:
        """Return the last ``capacity`` transitions of this buffer followed by ``more``."""
        return Buffer.concatenate([self, more])[-capacity:]

    @classmethod
    def concatenate(cls, buffers: Sequence[Buffer]) -> Buffer:
        """Return all transitions of ``buffers``, in their order."""
        return cls(*(np.concatenate([getattr(p, name) for p in buffers]) for name in BUFFER_ARRAYS))

    @classmethod
    def from_solved_steps(cls, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> Buffer:
        """Return a buffer of the transitions whose next state is finite (the solved steps)."""
        finite = np.isfinite(x_next).all(axis=1)
        return cls(x[finite], u[finite], x_next[finite])


N_EXPLORED_EPISODES = 50
"""Number of episodes that :func:`random_transitions` simulates at once, each with its own policy."""
CONTACT_DISTANCE_M = 1e-6
"""Signed distance [m] up to which bodies count as touching."""
MIN_ACTION_WIDTH = 0.01
"""Minimum scale of a random policy's actions before tanh."""
MAX_ACTION_WIDTH = 0.5
"""Maximum scale of a random policy's actions before tanh."""

Policy = Callable[[np.ndarray], np.ndarray]
"""Function from observations (n, n_o) of n episodes to inputs (n, nu)."""


@dataclass(frozen=True, eq=False)
class EpisodeSteps:
    """One step of n episodes: the transitions, their ``reward`` (n,), and three masks (n,).

    ``ended`` marks episodes that end at the next state, ``solved`` steps with a finite next state, and
    ``touched`` steps after which bodies touch.
    """

    x: np.ndarray
    u: np.ndarray
    x_next: np.ndarray
    reward: np.ndarray
    ended: np.ndarray
    solved: np.ndarray
    touched: np.ndarray


class Explorer:
    """Simulator of many episodes of a task at once under the exact law.

    ``values`` maps names of parameters to values that replace the values of the task. Episodes that end, have an
    unsolved step, or reach the task's horizon are replaced by new ones from :meth:`Task.reset`. After each simulation
    ``count`` is called with the number of simulated steps. Results do not depend on the number of threads.
    """

    def __init__(
        self,
        task: Task,
        values: Mapping[str, float] | None = None,
        count: Callable[[int], None] | None = None,
        **engine: Any,
    ) -> None:
        self.task, self._count = task, count
        step = Exact().close(task.system)
        self.p = task.parameters.pack(values)
        self._step_p = step.p.pack(task.parameters.unpack(self.p))
        self._step = StepFunction(step, **engine)
        self._observe, self._reward, self._end = (
            BatchFunction(fn, **engine) for fn in (task.observe, task.rewards, task.ends)
        )
        distance = _distance(task)
        self._distance = None if distance is None else BatchFunction(distance, **engine)

    def initial_states(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return random initial states (n, nx) of ``n`` episodes, and the episodes' ages (n,) in steps, all 0."""
        return self.task.reset(n, rng, self.p), np.zeros(n, dtype=int)

    def observations(self, x: np.ndarray) -> np.ndarray:
        """Return the observations (n, n_o) in states (n, nx)."""
        return self._observe(x, self.p)

    def has_ended(self, x: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of the states (n, nx) at which an episode ends."""
        return np.not_equal(self._end(x, self.p)[:, 0], 0)

    def rewards(self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> np.ndarray:
        """Return the rewards (n,) of transitions."""
        return self._reward(x, u, x_next, self.p)[:, 0]

    def step(self, x: np.ndarray, u: np.ndarray) -> EpisodeSteps:
        """Return the simulated step from states (n, nx) under inputs (n, nu)."""
        steps = self._step(x, u, self._step_p)
        if self._count is not None:
            self._count(len(x))
        solved = np.asarray(np.isfinite(steps.x_next).all(axis=1))
        x_next = np.where(solved[:, None], steps.x_next, x)
        touched = np.zeros(len(x), dtype=bool)
        if self._distance is not None:
            touched = solved & (self._distance(x_next, self.p)[:, 0] <= CONTACT_DISTANCE_M)
        reward = np.where(solved, self.rewards(x, u, x_next), np.nan)
        is_over = solved & self.has_ended(x_next)
        return EpisodeSteps(x, u, steps.x_next, reward, is_over, solved, touched)

    def advance(self, steps: EpisodeSteps, age: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, nx) and ages (n,) before the next step, with ended episodes replaced by new episodes."""
        age = age + 1
        restarted = steps.ended | ~steps.solved | (age >= self.task.horizon)
        initial_states, initial_ages = self.initial_states(len(age), rng)
        return np.where(restarted[:, None], initial_states, steps.x_next), np.where(restarted, initial_ages, age)


def random_transitions(explorer: Explorer, n: int, seed: int | Sequence[int]) -> tuple[Buffer, np.ndarray]:
    """Return ``n`` solved transitions of random policies, and a mask (n,) of those after which bodies touch.

    Fifty episodes run at once, each with its own policy ``mid + half tanh(s (G o + w))``. G (nu, n_o) is a
    normal random matrix, w is white noise, and the observations o are divided by their largest values so far
    and by sqrt(n_o). The scale s is log-uniform, because with large inputs only many episodes would end early.

    Raises :class:`~ocp.errors.InputError` if no step was solved or ``n`` is below 1.
    """
    n = read_count("n", n)
    task = explorer.task
    rng = np.random.default_rng(seed)
    sizes = N_EXPLORED_EPISODES, task.system.nu, len(task.observations)
    x, age = explorer.initial_states(N_EXPLORED_EPISODES, rng)
    largest = np.full(sizes[2], 1e-6)
    gains, width = np.zeros(sizes), np.zeros((N_EXPLORED_EPISODES, 1))
    episode_steps: list[EpisodeSteps] = []
    while sum(int(steps.solved.sum()) for steps in episode_steps) < n:
        is_first_step = age == 0
        gains = np.where(is_first_step[:, None, None], rng.standard_normal(sizes), gains)
        new_width = np.exp(rng.uniform(np.log(MIN_ACTION_WIDTH), np.log(MAX_ACTION_WIDTH), width.shape))
        width = np.where(is_first_step[:, None], new_width, width)
        o = explorer.observations(x)
        largest = np.maximum(largest, np.abs(o).max(axis=0))
        a = np.einsum("eij,ej->ei", gains, o / largest) / np.sqrt(sizes[2])
        a = width * (a + rng.standard_normal(a.shape))
        episode_steps.append(explorer.step(x, squash(task, a)))
        x, age = explorer.advance(episode_steps[-1], age, rng)
        if not any(steps.solved.any() for steps in episode_steps):
            raise InputError(f"{task.name}: no step was solved from its starts")
    transitions = Buffer.concatenate(
        [Buffer.from_solved_steps(steps.x, steps.u, steps.x_next) for steps in episode_steps]
    )
    return transitions[:n], np.concatenate([steps.touched[steps.solved] for steps in episode_steps])[:n]


def squash(task: Task, a: np.ndarray) -> np.ndarray:
    """Return inputs ``mid + half tanh(a)`` (n, nu) within the task's bounds, for actions a (n, nu)."""
    return task.mid_range + task.half_range * np.tanh(a)


def _distance(task: Task) -> ca.Function | None:
    """Return a function from ``(x, parameters)`` to the smallest signed distance [m], or None if unknown."""
    phi = task.system.phi
    if phi is None or not phi.numel():
        return None
    arguments = [task.system.x, task.parameters.vector]
    return ca.Function("distance", arguments, [ca.mmin(ca.densify(phi))])
