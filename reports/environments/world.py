"""A task under a contact law, for any number of episodes at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from gymnasium.spaces import Box

from dynamics.batch import BatchFunction, StepFunction
from dynamics.contact import Step
from ocp.errors import InputError
from ocp.problem.rollout import STEP_TOLERANCE
from ocp.transcription.factories import make_law
from problems.tasks.registry import spec

LARGEST = float(np.finfo(np.float32).max)
"""Largest magnitude of states and observations in any unit; larger values overflow in single precision."""

Solver = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function from states (n, nx) and inputs (n, nu) to next states (n, nx) and a mask (n,) of solved steps."""


@dataclass(frozen=True)
class StepResult:
    """Result of one action in n episodes; every array has n rows.

    ``trail`` contains the states (n, nx) before the action and after each of its steps. ``unsolved`` is a
    mask of episodes that a step without solution ended; these remain at the state before the step. ``measures`` (n, k)
    are the task's measures in the last step.
    """

    trail: list[np.ndarray]
    t: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    unsolved: np.ndarray
    measures: np.ndarray

    @property
    def x(self) -> np.ndarray:
        """States (n, nx) after the action."""
        return self.trail[-1]


class World:
    """The task ``name`` at ``params`` under the contact law ``contact`` with ``settings``.

    Actions are clipped to [-1, 1] and mapped linearly to the range between the inputs' bounds. An action
    lasts one step or, if only the first few inputs of an episode have an effect
    (:attr:`~problems.tasks.registry.TaskSpec.decisions`), until the next decision or the end.

    Raises :class:`~ocp.errors.InputError` for an unknown task or law, bad parameters or settings.
    """

    def __init__(self, name: str, contact: str, settings: Mapping[str, Any] | None, params: Mapping[str, Any]) -> None:
        self.spec = spec(name)
        self.params = self.spec.params(params)
        self.task = task = self.spec.build(self.params)
        self.law = make_law(contact, settings or {}, task.system)
        self.step: Step = self.law.close(task.system)
        self.p = self.step.p.pack(task.parameters.defaults)
        decisions = self.spec.decisions
        self.hold = 1 if decisions is None else -(-task.horizon // decisions)
        self.action_space = Box(-1.0, 1.0, (task.system.nu,), np.float64)
        ends = [self.spec.observation_bounds.get(o.name, (-LARGEST, LARGEST)) for o in task.observations]
        low, high = np.array(ends).T
        self.observation_space = Box(low, high, dtype=np.float64)

    @property
    def seconds(self) -> float:
        """Duration of an action [s]."""
        h = ca.Function("h", [self.task.parameters.vector], [ca.SX(self.task.system.h)])
        return self.hold * float(h(self.task.parameters.values))

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """Return a random initial state (nx,) of an episode."""
        return self.task.reset(1, rng)[0]

    def observed(self, x: np.ndarray) -> np.ndarray:
        """Return observations (n, n_o) at states (n, nx)."""
        return self._observe(x, self.task.parameters.values)

    def inputs(self, actions: np.ndarray) -> np.ndarray:
        """Return the inputs (n, nu) for actions (n, nu).

        Raises :class:`~ocp.errors.InputError` for other shapes, NaN and infinity.
        """
        task, action_rows = self.task, np.asarray(actions, float)
        if action_rows.ndim != 2 or action_rows.shape[1] != task.system.nu:
            raise InputError(
                f"{task.name}: an action has {task.system.nu} entries, got an array of shape {action_rows.shape[1:]}"
            )
        if not np.isfinite(action_rows).all():
            raise InputError(f"{task.name}: actions must be finite numbers from -1 to 1")
        return task.lower + task.half_range + task.half_range * np.clip(action_rows, -1.0, 1.0)

    def advance(self, solver: Solver, x: np.ndarray, t: np.ndarray, actions: np.ndarray) -> StepResult:
        """Apply actions (n, nu) in n episodes at states ``x`` (n, nx), each after ``t`` (n,) steps."""
        task, n = self.task, len(x)
        u, p, trail, t = self.inputs(actions), task.parameters.values, [x], t.copy()
        is_over, unsolved, reward = np.zeros(n, bool), np.zeros(n, bool), np.zeros(n)
        measures = np.zeros((n, len(task.measures)))
        for _ in range(self.hold):
            rows = np.flatnonzero(~is_over & ~unsolved & (t < task.horizon))
            x_next, solved = solver(x[rows], u[rows])
            solved &= (np.abs(x_next) <= LARGEST).all(axis=1)
            unsolved[rows[~solved]] = True
            rows, x_next = rows[solved], x_next[solved]
            rewards, is_end, measures[rows] = self._outcome(x[rows], u[rows], x_next, p)
            reward[rows] += rewards[:, 0]
            is_over[rows] = is_end[:, 0] != 0
            x = x.copy()
            x[rows] = x_next
            t[rows] += 1
            trail.append(x)
        is_full_length = ~is_over & ~unsolved & (t >= task.horizon)
        if self._has_final:
            reward[is_full_length] += self._final(x[is_full_length], p)[:, 0]
        terminated = is_over | unsolved | (is_full_length & self._has_final)
        return StepResult(trail, t, reward, terminated, is_full_length & ~terminated, unsolved, measures)

    def alone(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve the step at each state separately, with further initial guesses if one fails (a :data:`Solver`)."""
        x_next_rows, solved = np.empty_like(x), np.zeros(len(x), bool)
        for i in range(len(x)):
            x_next, _, _, error = self.step.solve(x[i], u[i], self.p)
            x_next_rows[i] = np.array(x_next).ravel()
            solved[i] = np.all(np.array(error) <= STEP_TOLERANCE)
        return x_next_rows, solved

    def together(self, **engine: Any) -> Solver:
        """Return a solver for all states at once; states that the engine cannot solve are passed to :meth:`alone`."""
        steps = StepFunction(self.step, **engine)

        def solved_together(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            batch = steps(x, u, self.p)
            x_next, solved, unsolved = batch.x_next, np.ones(len(x), bool), batch.nonfinite.indices
            x_next[unsolved], solved[unsolved] = self.alone(x[unsolved], u[unsolved])
            return x_next, solved

        return solved_together

    @property
    def _has_final(self) -> bool:
        """Whether the task has a final reward; the horizon then terminates an episode instead of truncating it."""
        return not ca.SX(self.task.final).is_zero()

    @cached_property
    def _outcome(self) -> BatchFunction:
        """Function from (x, u, x_next, p) to the reward, whether the task ends the episode, and the measures."""
        task, system = self.task, self.task.system
        x, u, p = system.x, system.u, task.parameters.vector
        arguments = [x, u, system.x_next, p]
        outputs = [task.rewards(*arguments), task.ends(system.x_next, p), task.measure(*arguments)]
        return BatchFunction(ca.Function("outcome", arguments, outputs), "numpy")

    @cached_property
    def _final(self) -> BatchFunction:
        return BatchFunction(self.task.finals, "numpy")

    @cached_property
    def _observe(self) -> BatchFunction:
        return BatchFunction(self.task.observe, "numpy")
