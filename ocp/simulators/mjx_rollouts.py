"""Rollouts of an MJCF in MJX, which is MuJoCo in JAX, and their derivatives by automatic differentiation."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.simulators.mujoco_rollouts import MujocoRollouts

BLOCK = 64
"""Number of rollouts that are simulated at once, for which functions are compiled."""


class MjxRollouts:
    """Entry ``index`` of the last state (qpos, qvel) of an MJCF, as a function of one parameter theta.

    Rollouts start at ``start + theta by_start``, both (2 nv,), under the constant control ``theta by_control`` (nu,).
    Derivatives are accumulated forwards or, with ``reverse``, backwards. Since MJX does not differentiate the loop of
    its solver backwards, ``reverse`` limits the solver to one iteration, also in rollouts.

    Raises :class:`~ocp.errors.InputError` if MJX is not installed, and as :class:`MujocoRollouts` does.
    """

    def __init__(
        self, mjcf: str, start: np.ndarray, by_start: np.ndarray, by_control: np.ndarray, index: int, reverse: bool
    ) -> None:
        try:
            self._jax, self._mjx = import_module("jax"), import_module("mujoco.mjx")
        except ImportError:
            raise InputError("the world mjx needs the package mujoco-mjx; install 'centralpath[mjx]'") from None
        self._model = MujocoRollouts(mjcf)
        if reverse:
            self._model.model.opt.iterations = 1
        self.versions = {"mujoco": self._model.version, **{name: version(name) for name in ("mujoco-mjx", "jax")}}
        jax, nv = self._jax, self._model.model.nv
        with jax.enable_x64(True):
            model, data = self._mjx.put_model(self._model.model), self._mjx.make_data(self._model.model)

        def last_entry(theta: Any, constants: dict[str, Any], timestep: float, n_steps: int) -> Any:
            changed = model.replace(**constants, opt=model.opt.replace(timestep=timestep))
            state, control = start + theta * by_start, theta * by_control
            first = data.replace(qpos=state[:nv], qvel=state[nv:], ctrl=control)
            last = jax.lax.fori_loop(0, n_steps, lambda _, before: self._mjx.step(changed, before), first)
            return jax.numpy.concatenate([last.qpos, last.qvel])[index]

        def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
            # A loop is differentiated backwards only if its length is known when it is compiled.
            return jax.jit(jax.vmap(function, (0, None, None, None)), static_argnums=3 if reverse else ())

        self._entries = compiled(last_entry)
        self._slopes = compiled(jax.jacrev(last_entry) if reverse else jax.jacfwd(last_entry))
        self._reverse, self._lengths = reverse, set[int]()

    def entries(self, theta: np.ndarray, n_steps: int, timestep: float, solref: float) -> np.ndarray:
        """Return the entry (n,) of the state after ``n_steps`` at theta (n,).

        ``timestep`` and ``solref`` are those of :meth:`MujocoRollouts.set_contacts`.
        """
        return self._in_blocks(self._entries, theta, n_steps, timestep, solref)

    def slopes(self, theta: np.ndarray, n_steps: int, timestep: float, solref: float) -> np.ndarray:
        """Return the derivatives (n,) of :meth:`entries` by theta (n,)."""
        return self._in_blocks(self._slopes, theta, n_steps, timestep, solref)

    def compile(self, note: Callable[[str], None], n_steps: int, timestep: float, solref: float) -> None:
        """Compile rollouts and derivatives, unless they are compiled; call ``note`` before and after."""
        length = n_steps if self._reverse else 0
        if length in self._lengths:
            return
        for name, function in (("rollouts", self.entries), ("derivatives", self.slopes)):
            note(f"JAX compiles {name}")
            begin = time.perf_counter()
            function(np.zeros(1), n_steps, timestep, solref)
            note(f"compiled in {time.perf_counter() - begin:.0f} s")
        self._lengths.add(length)

    def _in_blocks(
        self, function: Callable[..., Any], theta: np.ndarray, n_steps: int, timestep: float, solref: float
    ) -> np.ndarray:
        self._model.set_contacts(timestep, solref)
        constants = {name: getattr(self._model.model, name).copy() for name in ("geom_solref", "jnt_solref")}
        blocks = np.resize(theta, (-(-len(theta) // BLOCK), BLOCK))
        with self._jax.enable_x64(True):
            values = [np.asarray(function(block, constants, timestep, n_steps)) for block in blocks]
        return np.concatenate(values)[: len(theta)]
