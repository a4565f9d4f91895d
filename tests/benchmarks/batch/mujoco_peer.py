"""The machines in MuJoCo: the same tables as MJCF, with its parallel rollouts and its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import Any

import numpy as np

from dynamics.systems.planar.links import Link
from problems.machines.machine import PublishedMachine

_EPS = 1e-6


def mjcf(machine: PublishedMachine) -> str:
    """Return the machine on its ground as MJCF, in the plane y = 0, at its own step size.

    Springs, dampers, gears, limits, spheres and friction are those of the machine; contacts of
    MuJoCo are soft, with its own defaults.
    """
    children: dict[str | None, list[Link]] = {}
    for link in machine.links:
        children.setdefault(link.parent, []).append(link)
    motors = "".join(
        f'<motor joint="{link.name}" gear="{link.gear}"/>' for link in machine.links if link.gear is not None
    )
    bodies = "".join(_body(machine, children, link) for link in children[None])
    return (
        f'<mujoco><compiler angle="radian"/>'
        f'<option timestep="{machine.h}" integrator="implicitfast" gravity="0 0 -9.81"/>'
        f'<default><geom contype="0" conaffinity="1" friction="{machine.friction}"/></default>'
        '<worldbody><geom type="plane" size="0 0 1" contype="1" conaffinity="0"/>'
        f"{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def _body(machine: PublishedMachine, children: dict[str | None, list[Link]], link: Link) -> str:
    (x, z), (cx, cz), half = link.anchor, link.com, float(link.offset) / 2
    about = f'mass="{link.mass}" diaginertia="{link.inertia} {link.inertia} {link.inertia}"'
    spheres = "".join(
        f'<geom type="sphere" size="{s.radius}" pos="{s.centre[0]} 0 {s.centre[1]}"/>'
        for s in machine.spheres
        if s.link == link.name
    )
    below = "".join(_body(machine, children, child) for child in children.get(link.name, []))
    return (
        f'<body name="{link.name}" pos="{x} 0 {z}" quat="{np.cos(half)} 0 {np.sin(half)} 0">'
        f'{_joints(machine, link)}<inertial pos="{cx} 0 {cz}" {about}/>{spheres}{below}</body>'
    )


def _joints(machine: PublishedMachine, link: Link) -> str:
    """Return the link's joints, with springs made implicit by added damping, since MuJoCo's are explicit.

    Their force is then ``spring (q + h v+) + damping v+``, as in the machine.
    """
    if link.joint == "free":
        slides = "".join(f'<joint type="slide" axis="{a}"/>' for a in ("1 0 0", "0 0 1"))
        return f'{slides}<joint type="hinge" axis="0 1 0"/>'
    damping = link.damping + machine.h * link.spring
    limits = f' range="{link.limits[0]} {link.limits[1]}" limited="true"' if link.limits else ""
    return (
        f'<joint name="{link.name}" type="hinge" axis="0 1 0" stiffness="{link.spring}" damping="{damping}"{limits}/>'
    )


def _mujoco(name: str) -> Any:
    return import_module(name)


def forward(model: Any, x0: np.ndarray, inputs: np.ndarray, threads: int) -> Callable[[], Any]:
    """Return a call of `mujoco.rollout` from x0 (nx,) under inputs (n, H, nu)."""
    mujoco, rollout = _mujoco("mujoco"), _mujoco("mujoco.rollout")
    data = [mujoco.MjData(model) for _ in range(threads)]
    start = np.tile(np.concatenate([[0.0], x0]), (len(inputs), 1))
    pool = rollout.Rollout(nthread=threads)
    return lambda: pool.rollout(model, data, start, inputs)


def derivatives(model: Any, x0: np.ndarray, inputs: np.ndarray, threads: int) -> Callable[[], Any]:
    """Return a call for the gradients (n, H, nu) of the last x[0] by the inputs (n, H, nu).

    They are chained backwards from one-sided `mjd_transitionFD` at every step, its fastest form.
    """
    mujoco, (_, horizon, nu) = _mujoco("mujoco"), inputs.shape
    nq, nx = model.nq, model.nq + model.nv

    def some(samples: np.ndarray) -> np.ndarray:
        data, gradients = mujoco.MjData(model), np.empty((len(samples), horizon, nu))
        by_x, by_u = np.empty((horizon, nx, nx)), np.empty((horizon, nx, nu))
        for plan, gradient in zip(samples, gradients, strict=True):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = x0[:nq], x0[nq:]
            for t in range(horizon):
                data.ctrl[:] = plan[t]
                mujoco.mjd_transitionFD(model, data, _EPS, False, by_x[t], by_u[t], None, None)
                mujoco.mj_step(model, data)
            bar = np.eye(nx)[0]
            for t in reversed(range(horizon)):
                gradient[t] = bar @ by_u[t]
                bar = bar @ by_x[t]
        return gradients

    shares = np.array_split(inputs, threads)
    pool = ThreadPoolExecutor(threads)
    return lambda: np.vstack(list(pool.map(some, shares)))
