"""Attempts to disprove certificates by inputs near a plan's, rolled out under the exact law."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch import StepFunction
from ocp.mpc.controller import Controller
from ocp.mpc.stages import Plan

RADII = (1e-3, 1e-4)
"""Steps of the inputs, in characteristic sizes; a disproof needs descent at each."""
_DRAWN, _FLAT, _NOISE, _SLACK = 64, 1e-4, 1e-7, 1e-9


class Check:
    """Search for descent around certified plans of one controller.

    Directions are every input at every step, up and down, random ones, and the sum of all single
    ones that descend. One disproves if its rollout satisfies all constraints, and the cost falls,
    per characteristic size that any state, input, force or gap moves by, by more than counts as
    zero for the certificate: 1e-4 of the cost or of the scaled 1-norm of its gradient, and in total
    1e-7 of the change of cost over characteristic sizes, for which the certificate takes 1e-9.
    """

    def __init__(self, controller: Controller) -> None:
        self.problem = controller.receding.problem
        problem, system, N = self.problem, self.problem.system, self.problem.N
        self.step = StepFunction(problem.exact_step, threads=1)
        self.packed = problem.exact_step.p.pack
        X, U, L = (ca.SX.sym(*of) for of in (("X", system.nx, N + 1), ("U", system.nu, N), ("L", system.nlam, N)))
        before, p, cost = ca.SX.sym("before", system.nu), problem.parameters.vector, ca.SX(0)
        rows, path = (
            [],
            ca.Function(
                "path",
                [system.x, system.u, p],
                [
                    ca.vertcat(
                        ca.SX(0, 1),
                        *(v for c in problem.path for v in (c.lower - c.expression, c.expression - c.upper)),
                    ),
                ],
            ),
        )
        for k in range(N):
            last = U[:, k - 1] if k else before
            cost += problem.cost_terms(X[:, k], U[:, k], U[:, k] - last, L[:, k], p)[0]
            rows.append(path(X[:, k], U[:, k], p))
        cost += problem.cost_terms(X[:, N], U[:, -1], U[:, -1], L[:, -1], p)[1]
        low, high = problem.limits(problem.parameters.values)[2:4]
        rows += [v for k in range(N) for v in (low - U[:, k], U[:, k] - high)]
        sizes = problem.scales
        parts = ((X, sizes.x), (U, sizes.u), (L, np.full(system.nlam, sizes.impulse)))
        slope = sum(ca.sum1(ca.sum2(ca.fabs(ca.gradient(cost, v)) * size)) for v, size in parts)
        given = [X, U, L, before, p]
        physical = [system.x, system.u, system.x_next, system.lam, p]
        self.gap = ca.Function("gap", physical, [system.gap])
        self.values = ca.Function("values", given, [cost, ca.mmax(ca.vertcat(*rows, -1.0))])
        self.slope = ca.Function("slope", given, [slope])

    def disproof(self, plan: Plan, values: dict[str, float]) -> float:
        """Return the steepest descent relative to what counts as zero; 0 if no direction disproves."""
        problem, nu = self.problem, self.problem.system.nu
        before = np.array([values[f"last_input_{i}"] for i in range(nu)])
        p = np.array([values[name] for name in problem.parameters.names])
        own = self.packed({n: values[n] for n in problem.exact_step.p.names if n in values})
        rng, size = np.random.default_rng(0), plan.u.size
        ways = np.concatenate([np.eye(size), -np.eye(size), rng.standard_normal((_DRAWN, size))])
        ways /= np.abs(ways).max(axis=1, keepdims=True)
        worst = np.inf
        for radius in RADII:
            falls = self._falls(plan, ways, radius, before, p, own)
            both = np.maximum(falls[: 2 * size], 0.0) @ ways[: 2 * size]
            if both.any():
                found = self._falls(plan, both[None] / np.abs(both).max(), radius, before, p, own)
                falls = np.append(falls, found)
            worst = min(worst, falls.max())
        return max(float(worst), 0.0) if worst > 1 else 0.0

    def _falls(
        self,
        plan: Plan,
        ways: np.ndarray,
        radius: float,
        before: np.ndarray,
        p: np.ndarray,
        own: np.ndarray,
    ) -> np.ndarray:
        """Return descents (S,) of the cost along directions (S, N nu), relative to what counts as zero."""
        N, sizes, S = self.problem.N, self.problem.scales, len(ways)
        u = plan.u + radius * sizes.u * ways.reshape(S, N, -1)
        u = np.concatenate([plan.u[None], u])
        x, lam = [np.tile(plan.x[0], (S + 1, 1))], []
        for k in range(N):
            found = self.step(x[-1], u[:, k], own)
            x.append(found.x_next)
            lam.append(found.lam[:, : self.problem.system.nlam])
        X, L = np.stack(x, axis=1), np.stack(lam, axis=1)
        ahead = X[:, :-1], u, X[:, 1:], L
        gap = np.array(self.gap(*(v.reshape(-1, v.shape[2]).T for v in ahead), p)).T
        cost, off = (np.array(v).ravel() for v in self._valued(X, u, L, before, p))
        flat = [v[0].T for v in (X, u, L)]
        zero = _FLAT * max(abs(cost[0]), float(self.slope(*flat, before, p)))
        wide = [self._valued(X[:1] + s * sizes.x, u[:1] + s * sizes.u, L[:1], before, p)[0] for s in (-1, 1)]
        least = _NOISE * max(abs(cost[0]), *(abs(float(v) - cost[0]) for v in wide))
        moved = np.max(
            [
                np.abs((v - v[0]) / s).max(axis=(1, 2))
                for v, s in ((X, sizes.x), (u, sizes.u), (L, sizes.impulse), (gap.reshape(L.shape), sizes.gap))
            ],
            axis=0,
        )
        fall = cost[0] - cost[1:]
        sound = np.isfinite(cost) & (off <= max(off[0], 0.0) + _SLACK)
        sound[1:] &= (fall > least) | (radius < RADII[0])
        return np.where(sound[1:], fall / np.maximum(moved[1:], radius) / zero, -np.inf)

    def _valued(
        self, X: np.ndarray, u: np.ndarray, L: np.ndarray, before: np.ndarray, p: np.ndarray
    ) -> tuple[ca.DM, ca.DM]:
        """Return costs and worst violations of trajectories (S, N+1, nx), (S, N, nu), (S, N, nlam)."""
        return self.values(*(v.reshape(-1, v.shape[2]).T for v in (X, u, L)), before, p)
