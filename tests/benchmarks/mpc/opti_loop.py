"""The peer: a plain Opti loop, warm-started from the solution before, as users write it today."""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.mpc.plants import Plant
from ocp.problem.problem import Problem
from tests.benchmarks.mpc.tasks import SKIP, Task

EPS = 1e-6
"""Largest ``lam gap``, in characteristic sizes."""
OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 300,
    "warm_start_init_point": "yes",
    "mu_init": 1e-4,
    "warm_start_bound_push": 1e-8,
    "warm_start_mult_bound_push": 1e-8,
}


@dataclass(frozen=True)
class PeerLoop:
    """Seconds of each sample but the first ten of a run, and the number of failed solves.

    ``reached`` is whether the task's outcome was reached from all starts.
    """

    seconds: np.ndarray
    failed: int
    reached: bool

    def percentile(self, share: float) -> float:
        """Return a percentile of the seconds."""
        return float(np.percentile(self.seconds, share)) if self.seconds.size else np.nan


class Script:
    """Multiple shooting with variables x, u, lam and gap, ``lam gap <= eps``.

    Measured state, last input and parameters are ``opti.parameter``; the first solve comes from
    eps = 1 downwards, the others from the solution before, shifted by a step.
    """

    def __init__(self, problem: Problem) -> None:
        system, N = problem.system, problem.N
        p = problem.parameters.vector
        law = ca.Function("law", [system.x, system.u, system.x_next, system.lam, p], [system.residual, system.gap])
        path, lower, upper = (
            ca.vertcat(ca.SX(0, 1), *(getattr(c, part) for c in problem.path))
            for part in ("expression", "lower", "upper")
        )
        path = ca.Function("path", [system.x, system.u, p], [path, lower, upper])
        opti = ca.Opti()
        self.X, self.U = opti.variable(system.nx, N + 1), opti.variable(system.nu, N)
        self.L, self.G = opti.variable(system.nlam, N), opti.variable(system.nlam, N)
        self.x0, self.before = opti.parameter(system.nx), opti.parameter(system.nu)
        self.p, self.eps = opti.parameter(p.numel()), opti.parameter()
        sizes = problem.scales.impulse * problem.scales.gap
        low, high = problem.limits(problem.parameters.values)[2:4]
        opti.subject_to(self.X[:, 0] == self.x0)
        cost, u_before = 0, self.before
        for k in range(N):
            x, u, lam, gap = self.X[:, k], self.U[:, k], self.L[:, k], self.G[:, k]
            residual, opening = law(x, u, self.X[:, k + 1], lam, self.p)
            opti.subject_to(residual == 0)
            opti.subject_to(gap == opening)
            opti.subject_to(lam >= 0)
            opti.subject_to(gap >= 0)
            opti.subject_to(lam * gap <= self.eps * sizes)
            if not np.isinf(high).all():
                opti.subject_to(opti.bounded(low, u, high))
            if problem.path:
                kept, least, most = path(x, u, self.p)
                opti.subject_to(opti.bounded(least, kept, most))
            cost += problem.cost_terms(x, u, u - u_before, lam, self.p)[0]
            u_before = u
        end = problem.cost_terms(self.X[:, N], self.U[:, -1], self.U[:, -1], 0, self.p)[1]
        opti.minimize(cost + end)
        opti.solver("ipopt", {"print_time": False, "expand": True}, OPTIONS)
        self.blocks = (self.X, self.U, self.L, self.G)
        self.opti, self.first, self.failed = opti, True, 0

    def step(self, x: np.ndarray, u_before: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the input (nu,) for a measured state."""
        opti = self.opti
        for parameter, value in ((self.x0, x), (self.before, u_before), (self.p, p)):
            opti.set_value(parameter, value)
        if self.first:
            opti.set_initial(self.X, np.tile(x[:, None], self.X.shape[1]))
            opti.set_initial(self.U, np.tile(u_before[:, None], self.U.shape[1]))
        for eps in (1.0, 1e-2, 1e-4, EPS) if self.first else (EPS,):
            opti.set_value(self.eps, eps)
            try:
                opti.solve()
            except RuntimeError:
                self.failed += 1
            x, u, lam, gap, multipliers = (opti.debug.value(v) for v in (*self.blocks, opti.lam_g))
            opti.set_initial(opti.lam_g, multipliers)
            for block, value in zip(self.blocks, (x, u, lam, gap), strict=True):
                given = np.reshape(value, block.shape)
                ahead = np.concatenate([given[:, 1:], given[:, -1:]], axis=1)
                opti.set_initial(block, ahead if eps == EPS else given)
        self.first = False
        return np.reshape(u, self.U.shape)[:, 0]


def run(task: Task, limit: float, starts: np.ndarray, samples: float = np.inf) -> PeerLoop:
    """Control the exact plant from starts of a task, for up to ``samples`` or ``limit`` seconds."""
    problem = task.made()
    plant, names = Plant(problem, "exact", {}), problem.parameters.names
    values = dict(zip(names, problem.parameters.values, strict=True))
    u0 = np.array(problem.limits(problem.parameters.values)[1]).ravel()
    noise = np.array([task.noise.get(one.name, 0.0) for one in problem.system.states])
    rng, seconds, count = np.random.default_rng(0), [], 0
    reached, script, ends = True, Script(problem), time.perf_counter() + limit
    for x0 in starts:
        script.first, u, x = True, u0, np.full((task.steps + 1, x0.size), np.nan)
        x[0] = x0
        for k in range(task.steps):
            if count == samples or time.perf_counter() > ends or not np.isfinite(x[k]).all():
                break
            seen = x[k] + noise * rng.standard_normal(x0.size)
            asked = task.goals(k, seen) if task.goals else {}
            began = time.perf_counter()
            u = script.step(seen, u, problem.parameters.pack(values | asked))
            if k >= SKIP:
                seconds.append(time.perf_counter() - began)
            x[k + 1], count = plant.step(x[k], u)[0], count + 1
        reached &= bool(task.outcome(x[None])[0])
    return PeerLoop(np.array(seconds), script.failed, reached)
