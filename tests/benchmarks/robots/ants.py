"""Rollouts of the ant with gradients in compiled C, and with finite differences in MuJoCo."""

from __future__ import annotations

import time
from importlib import import_module
from pathlib import Path

import casadi as ca
import numpy as np

from dynamics.batch import RolloutFunction, open_loop
from dynamics.contact import Barrier
from dynamics.systems import ParameterTable
from problems.bodies.ant import ant, standing_pose

STEPS, H, SAMPLES, ROUNDS = 20, 0.01, 64, 6


def rollouts(mu: float, backend: str) -> RolloutFunction:
    """Return rollouts of running forwards and staying upright, with a cost mostly of the last state."""
    system = ant().system("ant", ParameterTable(), h=H, friction=1.0)
    step = Barrier(mu=mu).close(system)
    x, u, p = (ca.SX.sym("v", n) for n in (system.nx, system.nu, len(step.p)))
    stage = ca.Function("stage", [x, u, p], [1e-3 * ca.sumsqr(u)])
    end = ca.Function("end", [x, p], [x[2] ** 2 - x[0] + 0.1 * ca.sumsqr(x[15:])])
    policy = open_loop(system.nx, system.nu)
    return RolloutFunction(step, stage, end, STEPS, policy, backend=backend, threads=1)


def draws(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw states (n, 29) near standing_pose and inputs (n, STEPS, 8)."""
    rng = np.random.default_rng(0)
    start = np.tile(np.r_[standing_pose(), np.zeros(14)], (n, 1))
    start[:, 15:] += 0.1 * rng.standard_normal((n, 14))
    return start, 0.1 * rng.standard_normal((n, STEPS, 8))


def ours_ms(f: RolloutFunction) -> float:
    """Return processor milliseconds of one rollout with its gradient, on one thread."""
    start, inputs = draws(SAMPLES)
    best = np.inf
    for _ in range(ROUNDS):
        began = time.process_time()
        found = f(start, inputs)
        best = min(best, (time.process_time() - began) / SAMPLES)
        assert not found.nonfinite
    return 1e3 * best


def theirs_ms(path: Path) -> float:
    """Return processor milliseconds of the steps in MuJoCo, with mjd_transitionFD, on one thread.

    They are one-sided differences of Euler's step, the fastest form: 36 columns per step, which are
    then chained; full differences over all 160 inputs are about 1700 steps. Gymnasium's file has
    RK4, which takes four times as long.
    """
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_EULER, H
    data, best = mujoco.MjData(model), np.inf
    by_x = np.zeros((2 * model.nv, 2 * model.nv))
    by_u = np.zeros((2 * model.nv, model.nu))
    starts, inputs = draws(4)
    for start, rolled in [*zip(starts, inputs, strict=True)] * ROUNDS:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
        began = time.thread_time()
        for u in rolled:
            data.ctrl[:] = u
            mujoco.mjd_transitionFD(model, data, 1e-6, 0, by_x, by_u, None, None)
            mujoco.mj_step(model, data)
        best = min(best, time.thread_time() - began)
    return 1e3 * best
