"""Gains shared by several scenarios, from quadratic models of their costs along their closed loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ocp.judge.step_size import step_state
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout

RIDGE = 1e-10
"""Multiple of the identity added to the equations of the gains at a step, relative to the mean of their diagonal."""


class Merit(NamedTuple):
    """Failures and cost of a policy; of two, the smaller is better, the first difference counts.

    ``failures`` are those that matter most, ``excess`` is by how much these motions exceed limits, of constraints in
    characteristic sizes and of the cost as a share, ``others`` are all failures, and ``cost`` is that of
    motions that end.
    """

    failures: int
    excess: float
    others: int
    cost: float


class Expansion(NamedTuple):
    """Quadratic model of one scenario's closed loop, along states x (N+1, nx) and inputs u (N, nu).

    ``free`` (N, nu) marks inputs within their limits; others do not depend on the gains. ``dynamics`` (N, nx, nx + nu)
    is the derivative of the next state with respect to (x, u); ``gradient`` (N, nx + nu) and ``hessian`` are those of
    the stage cost, ``end_gradient`` (nx,) and ``end_hessian`` those of the terminal cost.
    """

    x: np.ndarray
    u: np.ndarray
    free: np.ndarray
    dynamics: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    end_gradient: np.ndarray
    end_hessian: np.ndarray


def is_end_bound(problem: Problem) -> bool:
    """Return whether a problem has terminal constraints, or a free start, which may be periodic."""
    return bool(problem.terminal) or problem.start is not None


def with_bound_end(expansion: Expansion, evaluation: Evaluation, plan: Rollout, share: float) -> Expansion:
    """Return an expansion with a penalty of deviations from the plan's end, if this end is bound.

    A deviation of one size costs half of ``share`` times the plan's cost, or of the characteristic cost if that is
    zero. Without the penalty, passes would lower the cost by violating constraints at the end (:func:`is_end_bound`).
    """
    problem = evaluation.problem
    if not is_end_bound(problem):
        return expansion
    unit = abs(plan.cost - evaluation.least_cost) or problem.scales.cost
    weight = share * unit / problem.scales.x**2
    weight[step_state(problem.system)] = 0.0
    gradient = expansion.end_gradient + weight * (expansion.x[-1] - plan.x[0, -1])
    return expansion._replace(end_gradient=gradient, end_hessian=expansion.end_hessian + np.diag(weight))


@dataclass(frozen=True)
class Deviations:
    """Random deviations from the closed loops: covariances (nx, nx) of first states, of measurements, of every step."""

    start: np.ndarray
    measurement: np.ndarray
    step: np.ndarray


def shared_gains(
    expansions: list[Expansion], gains: Gains, deviations: Deviations, damping: np.ndarray, sizes: np.ndarray
) -> Gains:
    """Return gains of lower mean cost over scenarios, by one pass of dynamic programming with shared unknowns.

    At each step, backwards in time, with the Hessian ``Q = H + (A B)' V (A B)`` of a scenario's cost to go, K and k
    minimise the mean over scenarios of the expected cost to go at the scenario's state x, which deviates by dx with
    covariance P and is measured with the error n,

        E[ q' (dx, du) + (dx, du)' Q (dx, du) / 2 ],    du = K (x + dx + n) + k - u,

    plus ``|du|^2 / 2`` with the weight ``damping`` (nu, nu), for the change du of the inputs from those under the
    present ``gains``. P follows the present closed loop. A fixed point is a stationary point of the mean expected cost
    of the linear dynamics and quadratic costs. ``sizes`` (nx,) are characteristic states. One scenario without
    deviations of its measurements gives a step of the iterative linear-quadratic regulator.
    """
    x, u, free, AB, g, H, v, V = (np.stack(parts) for parts in zip(*expansions, strict=True))
    S, N, nu = u.shape
    nx = x.shape[2]
    P = _covariances(AB, free, gains, deviations)
    units = np.append(1 / sizes, 1.0)
    K, k = np.empty((N, nu, nx)), np.empty((N, nu))
    for t in reversed(range(N)):
        Q = H[:, t] + AB[:, t].swapaxes(1, 2) @ V @ AB[:, t]
        q = g[:, t] + np.einsum("sij,si->sj", AB[:, t], v)
        mask = free[:, t].astype(float)
        Quu, Qux, qu = Q[:, nx:, nx:], Q[:, nx:, :nx], q[:, nx:]
        free_Quu = Quu * mask[:, :, None] * mask[:, None]
        measured = np.concatenate([x[:, t], np.ones((S, 1))], axis=1)
        moments = measured[:, :, None] * measured[:, None]
        moments[:, :nx, :nx] += P[t] + deviations.measurement
        present = np.concatenate([gains.K[t], gains.k[t, :, None]], axis=1)
        right = (np.einsum("sij,sj->si", free_Quu, u[:, t]) - qu * mask)[:, :, None] * measured[:, None]
        right[:, :, :nx] -= Qux * mask[:, :, None] @ P[t]
        right = (right + damping @ present @ moments) * units
        solution = _solve_shared(free_Quu + damping, moments * units[:, None] * units, right.sum(axis=0)) * units
        K[t], k[t] = solution[:, :nx], solution[:, nx]
        feedback = mask[:, :, None] * K[t]
        change = mask * (x[:, t] @ K[t].T + k[t] - u[:, t])
        by_input = qu + np.einsum("sij,sj->si", Quu, change)
        v = q[:, :nx] + np.einsum("sij,si->sj", feedback, by_input) + np.einsum("sij,si->sj", Qux, change)
        cross = Qux.swapaxes(1, 2) @ feedback
        V = Q[:, :nx, :nx] + cross + cross.swapaxes(1, 2) + feedback.swapaxes(1, 2) @ Quu @ feedback
    return Gains(K, k)


def _solve_shared(Quu: np.ndarray, moments: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return X (nu, m) with ``sum_s Quu_s X M_s = right`` for Quu (S, nu, nu) and moments M (S, m, m)."""
    nu, m = right.shape
    matrix = np.einsum("sab,sij->aibj", moments, Quu).reshape(nu * m, nu * m)
    matrix += RIDGE * np.trace(matrix) / len(matrix) * np.eye(len(matrix))
    return np.linalg.solve(matrix, right.T.ravel()).reshape(m, nu).T


def _covariances(AB: np.ndarray, free: np.ndarray, gains: Gains, deviations: Deviations) -> np.ndarray:
    """Return covariances (N, S, nx, nx) of the states of closed loops with these gains."""
    S, N, nx, _ = AB.shape
    P = np.empty((N, S, nx, nx))
    P[0] = deviations.start
    for t in range(N - 1):
        by_measured = (AB[:, t, :, nx:] * free[:, t, None]) @ gains.K[t]
        closed = AB[:, t, :, :nx] + by_measured
        noise = by_measured @ deviations.measurement @ by_measured.swapaxes(1, 2)
        P[t + 1] = closed @ P[t] @ closed.swapaxes(1, 2) + noise + deviations.step
    return P
