"""One episode at a time: a task as :class:`gymnasium.Env`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded

from ocp.errors import InputError
from reports.environments.world import StepResult, World

if TYPE_CHECKING:
    from reports.environments.renderer import Renderer

RENDER_MODE = "rgb_array"
METADATA: dict[str, Any] = {"render_modes": [RENDER_MODE]}


class TaskEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A task under a contact law as a Gymnasium environment.

    Actions in [-1, 1] reach from the lower to the upper bounds of the inputs, and are clamped
    there. An episode is *terminated* where the task is done, where its last step gains something of
    its own (then ``horizon`` is the task's end), and where a contact step has no solution
    (``info["unsolved"]``); it is *truncated* after ``horizon`` steps otherwise. ``info`` has
    the task's measures too. A throw is one action: it flies for the whole episode.

    ``contact`` is any law by name with ``contact_settings``; other keywords are parameters of the
    task, such as ``horizon``. ``render_mode`` may be ``"rgb_array"``.

    Raises :class:`~ocp.errors.InputError` for what is unknown or out of range, and
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
        """Start an episode and return the observation (n_o,); ``options`` are ignored."""
        super().reset(seed=seed)
        self._trail = [self.world.start(self.np_random)[None]]
        self._t, self._over = np.zeros(1, int), False
        return self.world.observed(self._trail[-1])[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Act (nu,), and return the observation, the reward, terminated, truncated and info."""
        if not self._trail or self._over:
            why = "the episode has ended" if self._over else "the environment was not reset"
            raise ResetNeeded(f"{why}; call reset() before step()")
        world = self.world
        actions = np.asarray(action, float)[None]
        found = world.advance(world.alone, self._trail[-1], self._t, actions)
        self._trail, self._t = found.trail, found.t
        terminated, truncated = bool(found.terminated[0]), bool(found.truncated[0])
        self._over = terminated or truncated
        seen = world.observed(found.x)[0]
        return seen, float(found.reward[0]), terminated, truncated, self._info(found)

    def _info(self, found: StepResult) -> dict[str, Any]:
        names = (measure.signal.name for measure in self.world.task.measures)
        measures = dict(zip(names, found.measures[0].tolist(), strict=True))
        return {**measures, "unsolved": bool(found.unsolved[0])}

    def render(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the state, (height, width, 3) in bytes; of a flight a strobe."""
        check_renders(self.render_mode, self._trail)
        seconds = self.world.seconds / self.world.hold * int(self._t[0])
        return self._renderer.of([x[0] for x in self._trail[-self.world.hold :]], seconds)

    @cached_property
    def _renderer(self) -> Renderer:
        from reports.environments.renderer import Renderer

        return Renderer(self.world.spec, self.world.params)


def checked_mode(mode: str | None) -> str | None:
    """Return the render mode; raises :class:`~ocp.errors.InputError` for an unknown one."""
    if mode not in (None, RENDER_MODE):
        raise InputError(f"render_mode must be {RENDER_MODE!r} or None, got {mode!r}")
    return mode


def check_renders(mode: str | None, trail: list[np.ndarray]) -> None:
    """Raise InputError where no render mode was chosen, and ResetNeeded before the first reset."""
    if mode is None:
        raise InputError(f"no render mode was chosen; make it with render_mode={RENDER_MODE!r}")
    if not trail:
        raise ResetNeeded("nothing to draw yet; call reset() before render()")
