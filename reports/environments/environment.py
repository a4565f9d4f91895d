"""Tasks as Gymnasium environments: one episode at a time, or many episodes that step together."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from dynamics.settings import read_count
from ocp.errors import InputError
from reports.environments.world import World

if TYPE_CHECKING:
    from reports.environments.renderer import Renderer


RENDER_MODE = "rgb_array"
"""The only render mode: images as arrays of bytes."""
METADATA: dict[str, Any] = {"render_modes": [RENDER_MODE]}
"""Metadata of a single environment, read by Gymnasium."""


class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A task under a contact law as a Gymnasium environment.

    Actions are clipped to [-1, 1] and mapped linearly to the range between the inputs' bounds. An
    episode is *terminated* if the task ends it, if a contact step has no solution
    (``info["unsolved"]``), and after ``horizon`` steps if the task has a final reward; otherwise it is
    *truncated* after ``horizon`` steps. ``info`` also contains the task's measures. A throw is a single action
    that lasts for the whole episode.

    ``contact`` is the name of a law, with settings ``contact_settings``; other keywords are parameters
    of the task, such as ``horizon``. ``render_mode`` may be ``"rgb_array"``.

    Raises :class:`~ocp.errors.InputError` for unknown names and values out of range, and
    :class:`gymnasium.error.ResetNeeded` for a step before :meth:`reset`.
    """

    metadata: dict[str, Any] = METADATA

    def __init__(
        self,
        task: str,
        contact: str = "exact",
        contact_settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **params: Any,
    ) -> None:
        self.render_mode = checked_mode(render_mode)
        self.world = World(task, contact, contact_settings, params)
        self.metadata = {**METADATA, "render_fps": round(1 / self.world.seconds)}
        self.action_space = self.world.action_space
        self.observation_space = self.world.observation_space
        self._trail: list[np.ndarray] = []
        self._t = np.zeros(1, int)
        self._over = False

    @property
    def state(self) -> np.ndarray:
        """State (nx,) of the task's system."""
        return self._trail[-1][0].copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; return the observation (n_o,) and an empty info; ``options`` are ignored."""
        super().reset(seed=seed)
        self._trail = [self.world.start(self.np_random)[None]]
        self._t, self._over = np.zeros(1, int), False
        return self.world.observed(self._trail[-1])[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply an action (nu,); return observation (n_o,), reward, terminated, truncated and info."""
        if not self._trail or self._over:
            reason = "the episode has ended" if self._over else "the environment was not reset"
            raise ResetNeeded(f"{reason}; call reset() before step()")
        world = self.world
        actions = np.asarray(action, float)[None]
        outcome = world.advance(world.alone, self._trail[-1], self._t, actions)
        self._trail, self._t = outcome.trail, outcome.t
        terminated, truncated = bool(outcome.terminated[0]), bool(outcome.truncated[0])
        self._over = terminated or truncated
        observation, names = world.observed(outcome.x)[0], (m.signal.name for m in world.task.measures)
        measures = dict(zip(names, outcome.measures[0].tolist(), strict=True))
        return (
            observation,
            float(outcome.reward[0]),
            terminated,
            truncated,
            {**measures, "unsolved": bool(outcome.unsolved[0])},
        )

    def render(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return an image (height, width, 3) of the state, or a strobe of the last action if it has several steps."""
        check_renders(self.render_mode, self._trail)
        seconds = self.world.seconds / self.world.hold * int(self._t[0])
        return self._renderer.of([x[0] for x in self._trail[-self.world.hold :]], seconds)

    @cached_property
    def _renderer(self) -> Renderer:
        from reports.environments.renderer import Renderer

        return Renderer(self.world.spec, self.world.params)


def checked_mode(mode: str | None) -> str | None:
    """Return the render mode; raise :class:`~ocp.errors.InputError` for an unknown mode."""
    if mode not in (None, RENDER_MODE):
        raise InputError(f"render_mode must be {RENDER_MODE!r} or None, got {mode!r}")
    return mode


def check_renders(mode: str | None, trail: list[np.ndarray]) -> None:
    """Raise InputError if no render mode was chosen, and ResetNeeded before the first reset."""
    if mode is None:
        raise InputError(f"no render mode was chosen; make it with render_mode={RENDER_MODE!r}")
    if not trail:
        raise ResetNeeded("nothing to draw yet; call reset() before render()")


_VECTOR_METADATA = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}
"""Metadata of environments that step together, read by Gymnasium."""


class TaskVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """``num_envs`` episodes of a task under a contact law, solved at once by the batch engine.

    After a reset with ``seed``, the i-th episode equals that of a :class:`~reports.environments.environment.TaskEnv`
    reset with ``seed + i``, for the same actions. An episode that has ended restarts at the next step, which ignores
    its action (``AutoresetMode.NEXT_STEP``). ``backend`` and ``threads`` are those of
    :class:`dynamics.batch.StepFunction`; results do not depend on ``threads``. Raises the errors of ``TaskEnv``.
    """

    metadata: dict[str, Any] = _VECTOR_METADATA

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        contact: str = "exact",
        contact_settings: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        backend: str = "auto",
        threads: int | None = None,
        **params: Any,
    ) -> None:
        self.num_envs = num_envs = read_count("num_envs", num_envs)
        self.render_mode = checked_mode(render_mode)
        self.world = world = World(task, contact, contact_settings, params)
        self.metadata = {**_VECTOR_METADATA, "render_fps": round(1 / world.seconds)}
        self.single_action_space = world.action_space
        self.single_observation_space = world.observation_space
        self.action_space = batch_space(world.action_space, num_envs)
        self.observation_space = batch_space(world.observation_space, num_envs)
        self._solver = world.together(backend=backend, threads=threads)
        self._rngs: list[np.random.Generator] = []
        self._x = np.zeros((0, world.task.system.nx))
        self._trail: list[np.ndarray] = []
        self._t = np.zeros(num_envs, int)
        self._over = np.zeros(num_envs, bool)

    @property
    def state(self) -> np.ndarray:
        """States (num_envs, nx) of the task's system."""
        return self._x.copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start all episodes; return observations (num_envs, n_o) and an empty info; ``options`` are ignored."""
        super().reset(seed=seed)
        if seed is not None or not self._rngs:
            first = self.np_random_seed
            assert first is not None
            self._rngs = [seeding.np_random(first + i)[0] for i in range(self.num_envs)]
        self._x = np.array([self.world.start(rng) for rng in self._rngs])
        self._trail = [self._x]
        self._t[:], self._over[:] = 0, False
        return self.world.observed(self._x), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply actions (num_envs, nu); every result, and every value of ``info``, has num_envs rows."""
        if not len(self._x):
            raise ResetNeeded("the environments were not reset; call reset() before step()")
        action_rows = np.asarray(actions, float)
        if action_rows.shape != self.action_space.shape:
            raise InputError(
                f"actions have shape {action_rows.shape}, expected {self.action_space.shape}: a row for each"
                " environment"
            )
        return self._acted(action_rows, np.flatnonzero(~self._over))

    def _acted(
        self, actions: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply the actions of episodes ``rows``, restart the others, and return the results of :meth:`step`."""
        world, n = self.world, self.num_envs
        outcome = world.advance(self._solver, self._x[rows], self._t[rows], actions[rows])
        restarted = np.flatnonzero(self._over)
        states = self._x.copy()
        for i in restarted:
            states[i] = world.start(self._rngs[i])
        self._trail = [_put(states, rows, x) for x in outcome.trail]
        self._x = self._trail[-1]
        self._t[restarted], self._t[rows] = 0, outcome.t
        reward = _put(np.zeros(n), rows, outcome.reward)
        terminated = _put(np.zeros(n, bool), rows, outcome.terminated)
        truncated = _put(np.zeros(n, bool), rows, outcome.truncated)
        self._over = terminated | truncated
        names = [measure.signal.name for measure in world.task.measures]
        measured = dict(zip([*names, "unsolved"], [*outcome.measures.T, outcome.unsolved], strict=True))
        acted = _put(np.zeros(n, bool), rows, np.ones(len(rows), bool))
        info: dict[str, Any] = {}
        for name, values in measured.items():
            info[name] = _put(np.zeros(n, values.dtype), rows, values)
            info[f"_{name}"] = acted.copy()
        return world.observed(self._x), reward, terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return an image (height, width, 3) of every state, or strobes of the last action if it has several steps."""
        check_renders(self.render_mode, self._trail)
        seconds = self.world.seconds / self.world.hold * self._t
        recent_states = self._trail[-self.world.hold :]
        return tuple(
            picture.of([x[i] for x in recent_states], float(seconds[i])) for i, picture in enumerate(self._renderers)
        )

    @cached_property
    def _renderers(self) -> list[Renderer]:
        from reports.environments.renderer import Renderer

        return [Renderer(self.world.spec, self.world.params) for _ in range(self.num_envs)]


def _put(target: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a copy of ``target`` with ``rows`` replaced by ``values``."""
    copied = target.copy()
    copied[rows] = values
    return copied
