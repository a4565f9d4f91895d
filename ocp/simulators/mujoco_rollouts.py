"""Rollouts of an MJCF in MuJoCo for many starts, and derivatives by MuJoCo's finite differences."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ocp.errors import InputError

DIFFERENCE = 1e-6
"""Perturbation of ``mjd_transitionFD``, as in MuJoCo's documentation."""


def load_model(mjcf: str, name: str) -> tuple[Any, Any]:
    """Return the module mujoco and the model of an MJCF, which is called ``name`` in messages.

    Raises :class:`~ocp.errors.InputError` if MuJoCo is not installed, or rejects the MJCF.
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError:
        raise InputError("the world of MuJoCo needs the package mujoco; install 'centralpath[robots]'") from None
    try:
        return mujoco, mujoco.MjModel.from_xml_string(mjcf)
    except (ValueError, mujoco.FatalError) as error:
        obstacle = " ".join(str(error).removeprefix("Error: ").split())
        raise InputError(f"MuJoCo rejects {name}: {obstacle}") from None


class MujocoRollouts:
    """Model of an MJCF, rolled out from many states under constant controls (nu,).

    States are (qpos, qvel); all joints must be hinges or slides, so that both have the same entries. Raises the errors
    of :func:`load_model`.
    """

    def __init__(self, mjcf: str) -> None:
        self._mujoco, self.model = load_model(mjcf, "the model")
        self._rollout: Any = import_module("mujoco.rollout")
        self.data, self.version = self._mujoco.MjData(self.model), self._mujoco.__version__

    def set_contacts(self, timestep: float, solref: float) -> None:
        """Set the time step [s] and the time constant ``solref`` [s] of all contacts and joint limits.

        Contacts with a stiffness k < 0 and a damping b < 0 in place of a time constant get ``k = -1/solref^2`` and keep
        their damping ratio ``-b / (2 sqrt(-k))``.
        """
        self.model.opt.timestep = timestep
        for constants in (self.model.geom_solref, self.model.jnt_solref):
            is_direct = constants[:, 0] < 0
            constants[is_direct, 1] /= np.sqrt(-constants[is_direct, 0]) * solref
            constants[:, 0] = np.where(is_direct, -1 / solref**2, solref)

    def last_states(self, states: np.ndarray, controls: np.ndarray, n_steps: int) -> np.ndarray:
        """Return the states (n, 2 nv) after ``n_steps`` from ``states`` (n, 2 nv) under ``controls`` (n, nu)."""
        nv, kind = self.model.nv, self._mujoco.mjtState
        full = np.zeros((len(states), self._mujoco.mj_stateSize(self.model, kind.mjSTATE_FULLPHYSICS)))
        full[:, 1 : 1 + 2 * nv] = states
        visited, _ = self._rollout.rollout(self.model, [self.data], full, control=controls[:, None, :], nstep=n_steps)
        return visited[:, -1, 1 : 1 + 2 * nv].copy()

    def derivatives(
        self, states: np.ndarray, controls: np.ndarray, n_steps: int, by_start: np.ndarray, by_control: np.ndarray
    ) -> np.ndarray:
        """Return the derivatives (n, 2 nv) of the last states along directions of start (2 nv,) and control (nu,).

        They are products of the Jacobians A and B of all steps, by central differences of ``mjd_transitionFD``.
        """
        mujoco, model, data, nv = self._mujoco, self.model, self.data, self.model.nv
        A, B = np.zeros((2 * nv, 2 * nv)), np.zeros((2 * nv, model.nu))
        changes = np.empty(states.shape)
        for row, (state, control) in enumerate(zip(states, controls, strict=True)):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:], data.ctrl[:] = state[:nv], state[nv:], control
            change = by_start
            for _ in range(n_steps):
                mujoco.mjd_transitionFD(model, data, DIFFERENCE, True, A, B, None, None)
                change = A @ change + B @ by_control
                mujoco.mj_step(model, data)
            changes[row] = change
        return changes
